"""Unknown gains of torque channels, relative to one of them."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg, optimize

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.equations._joint_moments import JointMoments
from sklearn_vbjfa.fit import _fit
from sklearn_vbjfa.fit._gains import RelativeGains, _maximise_likelihood
from sklearn_vbjfa.robot import FitOptions
from tests.effects._arms import arm, inverse_dynamics, motion
from tests.robot import EXACT
from tests.robot.test_model_values import literal_regressor

DT = 0.02
ARM = arm("ZYYX")
NV = 4
VISCOUS = np.array([0.8, 0.5, 0.3, 0.4])
_, STATES = motion(NV, duration=16.0, dt=DT, seed=1)
GAINS = np.array([2.0, 0.6, 1.7, 1.1])


def torques(noise=0.02, gains=GAINS, seed=0, states=STATES, model=ARM):
    """Return measured torques; noise is a share of each channel's deviation."""
    exact = inverse_dynamics(model, states)
    nv = model.nv
    exact = gains * (exact + VISCOUS[:nv] * states[:, nv : 2 * nv])
    white = np.random.default_rng(seed).normal(size=exact.shape)
    return exact + noise * exact.std(axis=0) * white


def fit(tau, states=STATES, model=ARM, **settings):
    settings = {"gains": "unknown", **EXACT, **settings}
    return RobotIdentifier(model, dt=DT, **settings).fit(states, tau)


def relative(gains, estimate):
    return gains / gains[estimate.reference]


def test_gains_match_nonlinear_least_squares():
    tau = torques()
    options = FitOptions(standstill=None, joint_weights=None)
    robot = fit(tau, options=options, input_noise=None)
    estimate = robot.gains_
    (reference,) = estimate.references
    # Base parameters by a singular value decomposition.
    Phi = literal_regressor(ARM, [], STATES)
    flat = Phi.reshape(-1, Phi.shape[2])
    base = linalg.svd(flat, full_matrices=False)[2]
    base = base[: np.linalg.matrix_rank(flat, tol=1e-9 * np.abs(flat).max() * 100)]
    rows = Phi @ base.T
    others = np.delete(np.arange(NV), reference)

    def residual(x):
        gains = np.ones(NV)
        gains[others] = x[: NV - 1]
        return (tau - gains * (rows @ x[NV - 1 :])).ravel()

    start = np.r_[np.ones(NV - 1), np.zeros(base.shape[0])]
    best = optimize.least_squares(residual, start, x_scale="jac", xtol=1e-12)
    covariance = linalg.pinvh(best.jac.T @ best.jac)
    covariance *= 2 * best.cost / (best.fun.size - start.size)
    std = np.sqrt(np.diagonal(covariance))[: NV - 1]
    assert np.all(np.abs(estimate.gain[others] - best.x[: NV - 1]) < 0.12 * std)
    assert_allclose(estimate.std[others], std, rtol=0.5)
    # Standard errors of friction include the uncertainty of the gains.
    viscous = [k for k, x in enumerate(robot.parameter_names_) if x.endswith("viscous")]
    within = base.T[viscous] @ covariance[NV - 1 :, NV - 1 :] @ base[:, viscous]
    std = np.sqrt(np.diagonal(within))
    assert_allclose(robot.theta_std_[viscous], std, rtol=0.6)
    assert_allclose(estimate.gain[reference], 1.0)
    assert estimate.std[reference] == 0.0
    assert not estimate.hidden


def test_gains_start_at_the_maximum_likelihood():
    rng, gains = np.random.default_rng(0), np.array([2.0, 0.5, 1.0])
    rows, theta = rng.normal(size=(3, 400, 2)), np.array([1.0, -2.0])
    tau = gains[:, None] * (rows @ theta) + 1e-3 * rng.normal(size=(3, 400))
    moments = JointMoments(
        n=np.full(3, 400.0),
        n_rows=np.full(3, 400),
        G=tuple((slice(0, 2), block.T @ block) for block in rows),
        g=np.einsum("jnp,jn->jp", rows, tau),
        yy=(tau**2).sum(axis=1),
    )
    logs, _ = _maximise_likelihood(moments, np.arange(3))
    assert_allclose(np.exp(logs - logs[2]), gains, rtol=1e-3)


@pytest.mark.parametrize("scale", [(3.0, 0.5, 1.0, 2.0), (1e-3, 5.0, 1.0, 1e6)])
def test_gains_are_equivariant_to_units(scale):
    tau, scale = torques(), np.array(scale)
    estimate, scaled = fit(tau).gains_, fit(tau * scale).gains_
    assert_array_equal(estimate.reference, scaled.reference)
    expected = estimate.gain * relative(scale, estimate)
    assert_allclose(scaled.gain, expected, rtol=1e-5)
    assert_allclose(scaled.std / scaled.gain, estimate.std / estimate.gain, rtol=1e-3)


def test_reference_joint_option():
    robot = fit(torques(), gains=("joint_4",))
    assert robot.gains_.references == (3,)
    assert_allclose(robot.gains_.gain, GAINS / GAINS[3], rtol=0.03)


def two_trees():
    """Return a chain of two joints and a separate joint."""
    model = arm("YY")
    body = model.inertias[1]
    single = model.addJoint(
        0, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0])), "lone"
    )
    model.inertias[single] = body
    return model


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.filterwarnings("error")
def test_gain_of_a_separate_joint_is_not_identifiable(noise):
    model = two_trees()
    _, states = motion(3, duration=16.0, dt=DT, seed=2)
    gains = np.array([2.0, 0.7, 3.0])
    robot = fit(torques(noise, gains, 0, states, model), states, model)
    estimate = robot.gains_
    assert estimate.hidden == (2,)
    assert estimate.gain[2] == 1.0
    assert np.isnan(estimate.std[2])
    (reference,) = estimate.references
    assert_allclose(estimate.gain[:2], gains[:2] / gains[reference], rtol=0.03)
    index = robot.parameter_names_.index("lone:torque_gain:gain")
    assert not robot.identifiable_[index]


def test_parameters_of_joints_with_a_vague_gain_are_not_identifiable(monkeypatch):
    model, (_, states) = two_trees(), motion(3, duration=16.0, dt=DT, seed=2)
    start = RelativeGains(gains=np.ones(3), reference=np.zeros(3, dtype=int))
    monkeypatch.setattr(_fit, "relative_gains", lambda *_: start)
    robot = fit(torques(0.02, np.ones(3), 0, states, model), states, model)
    assert robot.gains_.hidden == (2,)
    known = dict(zip(robot.parameter_names_, robot.robot_.known_))
    assert known["joint_2:viscous"] == "yes"
    assert known["lone:viscous"] == "in combination"


def test_predictions_are_in_units_of_the_channels():
    tau = torques(noise=0.0)
    robot = fit(tau)
    assert_allclose(robot.predict(STATES), tau, atol=1e-3 * tau.std())
    names = [f"joint_{j + 1}:torque_gain:gain" for j in range(NV)]
    assert robot.parameter_names_[-NV:] == tuple(names)
    assert [e.gain for e in robot.effects_] == robot.gains_.gain.tolist()
    assert robot.effects == ()


@pytest.mark.parametrize("gains", ["known", ("elbow",), ()])
def test_invalid_gains_are_refused(gains):
    with pytest.raises(ValueError, match=r"gains is .*of joint_1, joint_2"):
        fit(torques(), gains=gains)


def test_single_joint_has_no_relative_gain():
    _, states = motion(1, duration=8.0, dt=DT, seed=1)
    model = arm("Y")
    tau = torques(0.0, np.ones(1), 0, states, model)
    with pytest.raises(ValueError, match=r"the gain of joint_1 alone is not"):
        fit(tau, states, model)
