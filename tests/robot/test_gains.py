"""Unknown gains of torque channels, relative to one of them."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg, optimize

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.equations._joint_moments import JointMoments
from sklearn_vbjfa.fit._gains import _maximise_likelihood
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
    """Compute what the channels read: noise is a share of each channel's spread."""
    exact = inverse_dynamics(model, states)
    nv = model.nv
    exact = gains * (exact + VISCOUS[:nv] * states[:, nv : 2 * nv])
    white = np.random.default_rng(seed).normal(size=exact.shape)
    return exact + noise * exact.std(axis=0) * white


def fit(tau, states=STATES, model=ARM, **given):
    given = {"gains": "unknown", **EXACT, **given}
    return RobotIdentifier(model, dt=DT, **given).fit(states, tau)


def relative(gains, found):
    return gains / gains[found.reference]


# -- the estimate


def test_gains_are_those_of_nonlinear_least_squares():
    tau = torques()
    options = FitOptions(standstill=None, joint_weights=None)
    robot = fit(tau, options=options, input_noise=None)
    found = robot.gains_
    (first,) = found.references
    # Base parameters by a singular value decomposition.
    Phi = literal_regressor(ARM, [], STATES)
    flat = Phi.reshape(-1, Phi.shape[2])
    base = linalg.svd(flat, full_matrices=False)[2]
    base = base[: np.linalg.matrix_rank(flat, tol=1e-9 * np.abs(flat).max() * 100)]
    rows = Phi @ base.T
    others = np.delete(np.arange(NV), first)

    def residual(x):
        gains = np.ones(NV)
        gains[others] = x[: NV - 1]
        return (tau - gains * (rows @ x[NV - 1 :])).ravel()

    start = np.r_[np.ones(NV - 1), np.zeros(base.shape[0])]
    best = optimize.least_squares(residual, start, x_scale="jac", xtol=1e-12)
    covariance = linalg.pinvh(best.jac.T @ best.jac)
    covariance *= 2 * best.cost / (best.fun.size - start.size)
    std = np.sqrt(np.diagonal(covariance))[: NV - 1]
    assert np.all(np.abs(found.gain[others] - best.x[: NV - 1]) < 0.12 * std)
    assert_allclose(found.std[others], std, rtol=0.5)
    # What the gains leave unknown of friction is in its deviation.
    viscous = [k for k, x in enumerate(robot.parameter_names_) if x.endswith("viscous")]
    within = base.T[viscous] @ covariance[NV - 1 :, NV - 1 :] @ base[:, viscous]
    std = np.sqrt(np.diagonal(within))
    assert_allclose(robot.theta_std_[viscous], std, rtol=0.6)
    assert_allclose(found.gain[first], 1.0)
    assert found.std[first] == 0.0
    assert not found.hidden


def test_gains_begin_at_the_most_likely_ones():
    rng, gains = np.random.default_rng(0), np.array([2.0, 0.5, 1.0])
    rows, theta = rng.normal(size=(3, 400, 2)), np.array([1.0, -2.0])
    tau = gains[:, None] * (rows @ theta) + 1e-3 * rng.normal(size=(3, 400))
    moments = JointMoments(
        n=np.full(3, 400.0),
        n_rows=np.full(3, 400),
        G=tuple((slice(0, 2), own.T @ own) for own in rows),
        g=np.einsum("jnp,jn->jp", rows, tau),
        yy=(tau**2).sum(axis=1),
    )
    logs, _ = _maximise_likelihood(moments, np.arange(3))
    assert_allclose(np.exp(logs - logs[2]), gains, rtol=1e-3)


def test_gains_do_not_depend_on_units():
    tau, scale = torques(), np.array([3.0, 0.5, 1.0, 2.0])
    one, other = fit(tau).gains_, fit(tau * scale).gains_
    assert_array_equal(one.reference, other.reference)
    assert_allclose(other.gain, one.gain * relative(scale, one), rtol=1e-4)


def test_a_reference_may_be_given():
    robot = fit(torques(), gains=("joint_4",))
    assert robot.gains_.references == (3,)
    assert_allclose(robot.gains_.gain, GAINS / GAINS[3], rtol=0.03)


# -- what the data do not show


def two_trees():
    """Two joints that carry each other, and one beside them."""
    model = arm("YY")
    body = model.inertias[1]
    lone = model.addJoint(
        0, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0])), "lone"
    )
    model.inertias[lone] = body
    return model


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.filterwarnings("error")
def test_a_joint_that_shares_no_body_is_hidden(noise):
    model = two_trees()
    _, states = motion(3, duration=16.0, dt=DT, seed=2)
    gains = np.array([2.0, 0.7, 3.0])
    robot = fit(torques(noise, gains, 0, states, model), states, model)
    found = robot.gains_
    assert found.hidden == (2,)
    assert found.gain[2] == 1.0
    assert np.isnan(found.std[2])
    (first,) = found.references
    assert_allclose(found.gain[:2], gains[:2] / gains[first], rtol=0.03)
    place = robot.parameter_names_.index("lone:torque_gain:gain")
    assert not robot.identifiable_[place]


# -- in the house


def test_predictions_are_what_channels_read():
    tau = torques(noise=0.0)
    robot = fit(tau)
    assert_allclose(robot.predict(STATES), tau, atol=1e-3 * tau.std())
    names = [f"joint_{j + 1}:torque_gain:gain" for j in range(NV)]
    assert robot.parameter_names_[-NV:] == tuple(names)
    assert [e.gain for e in robot.effects_] == robot.gains_.gain.tolist()
    assert robot.effects == ()


@pytest.mark.parametrize("gains", ["known", ("elbow",), ()])
def test_other_gains_are_refused(gains):
    with pytest.raises(ValueError, match=r"gains is .*of joint_1, joint_2"):
        fit(torques(), gains=gains)


def test_one_joint_has_no_relative_gain():
    _, states = motion(1, duration=8.0, dt=DT, seed=1)
    model = arm("Y")
    tau = torques(0.0, np.ones(1), 0, states, model)
    with pytest.raises(ValueError, match=r"the gain of joint_1 alone is not"):
        fit(tau, states, model)
