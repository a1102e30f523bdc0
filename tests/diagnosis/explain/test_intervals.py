"""Coverage of the intervals of errors and of parameters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, effects
from sklearn_vbjfa.diagnosis.explain import (
    NEXT_SECONDS,
    EffectEstimate,
    discovered_effects,
    error_intervals,
    named_values,
)
from sklearn_vbjfa.diagnosis.report import words
from sklearn_vbjfa.effects import AsymmetricFriction, Spring, Stribeck
from sklearn_vbjfa.equations import TorqueResiduals
from sklearn_vbjfa.robot import FitOptions
from tests.core._problems import coloured
from tests.diagnosis._recordings import named, record
from tests.effects._arms import arm, inverse_dynamics, motion

NV, DT = 2, 0.1


# -- errors


TORQUE = 3.0
SPREAD = np.full(NV, TORQUE)


def residuals(rng, seconds, size=1.0, rho=0.0, share=1.0, torque=TORQUE):
    """Simulate residuals of a segment; the torque is coloured noise."""
    m = round(seconds / DT)
    predicted = torque * coloured(rng, (m, NV), 0.8)
    return TorqueResiduals(
        index=np.arange(m),
        torque=predicted + size * coloured(rng, (m, NV), rho),
        predicted=predicted,
        weight=(rng.uniform(size=(m, NV)) < share).astype(float),
    )


def intervals_of(searched, held_out):
    return error_intervals(later(2 * (held_out,)), 2 * (searched,), SPREAD, DT)


def later(parts):
    """Shift the row indices beyond all other parts."""
    return tuple(replace(part, index=part.index + 10**6) for part in parts)


@pytest.mark.parametrize(
    ("seconds", "rho", "share"), [(50.0, 0.0, 1.0), (20.0, 0.9, 1.0), (30.0, 0.5, 0.4)]
)
def test_coverage_of_error_intervals(seconds, rho, share):
    """For white and autocorrelated residuals, and a joint that mostly rests."""
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(300):
        settings = {"rho": rho, "share": share}
        searched = residuals(rng, 3 * seconds, **settings)
        held_out = residuals(rng, seconds, **settings)
        interval = intervals_of(searched, held_out)["after"]
        assert_allclose(interval[0] * interval[1], held_out.relative_error(SPREAD) ** 2)
        error = residuals(rng, NEXT_SECONDS, **settings).relative_error(SPREAD)
        inside.append((interval[0] < error) & (error < interval[1]))
    # 600 intervals: the standard deviation of the coverage is 1.2 %.
    assert 0.87 < np.mean(inside) < 0.93


def test_coverage_of_error_difference_intervals():
    rng, inside = np.random.default_rng(1), []

    def fits(seconds):
        before = residuals(rng, seconds, size=1.0, rho=0.5)
        smaller = before.torque - 0.6 * before.residual
        return before, replace(before, predicted=smaller)

    for _ in range(300):
        searched, held_out, following = fits(90.0), fits(30.0), fits(NEXT_SECONDS)
        intervals = error_intervals(later(held_out), searched, SPREAD, DT)
        low, high = intervals["difference"]
        gain = following[1].relative_error(SPREAD) - following[0].relative_error(SPREAD)
        inside.append((low < gain) & (gain < high))
    assert 0.87 < np.mean(inside) < 0.93


def test_error_intervals_use_the_order_in_time():
    """Held-out rows in the middle of a residual that grows over time."""
    rng = np.random.default_rng(2)
    whole = residuals(rng, 200.0)
    torque = whole.predicted + np.linspace(0.1, 2.0, 2000)[:, None] * whole.residual
    growing = replace(whole, torque=torque)

    def rows(chosen):
        values = {name: x[chosen] for name, x in vars(growing).items()}
        return TorqueResiduals(**values)

    middle = np.isin(np.arange(2000) // 500, [1])
    parts = rows(~middle), rows(middle)
    # The same rows in another order.
    mirror = rows(np.flatnonzero(~middle)[::-1]), rows(middle)
    # Shuffled indices hide the slow growth, so the interval is narrower.
    shuffled = rng.permutation(2000)
    mixed = [replace(part, index=shuffled[part.index]) for part in parts]
    ends, same, wrong = (
        error_intervals((held_out,) * 2, (searched,) * 2, SPREAD, DT)["after"]
        for searched, held_out in (parts, mirror, mixed)
    )
    assert_allclose(ends, same, rtol=1e-9)
    assert np.all(np.log(ends[1] / ends[0]) > 1.5 * np.log(wrong[1] / wrong[0]))


# -- effects found by EffectDiscovery

STEP = 0.02
STATES = {"friction": ("viscous",), "dt": STEP, "cutoff": None}
STATES["options"] = FitOptions(standstill=None)


def pendulum(seed, rho=0.0, duration=60.0):
    """States of one joint, torques with an undeclared spring, regressor columns."""
    model = arm("Z")
    _, states = motion(1, duration=duration, dt=STEP, seed=seed)
    q, v, a = states.T
    rng = np.random.default_rng(seed)
    tau = inverse_dynamics(model, states)[:, 0] + 0.8 * v + 0.3 * np.sign(v)
    tau = tau + 0.6 * (q - 0.5) + 0.05 * coloured(rng, v.size, rho)
    columns = np.column_stack([a, v, np.sign(v), np.ones_like(v), q])
    return model, states, tau[:, None], columns


def loop_on(model, states, tau, effects=("spring",)):
    loop = EffectDiscovery(RobotIdentifier(model, **STATES), effects=list(effects))
    return loop.fit(states, tau)


@pytest.mark.slow
def test_half_widths_match_least_squares():
    ratios = []
    for seed in range(6):
        model, states, tau, columns = pendulum(seed)
        (effect,) = loop_on(model, states, tau).effects_
        covariance = 0.05**2 * np.linalg.inv(columns.T @ columns)
        # The constant term belongs to the spring: k (q - q0).
        coef = covariance @ columns.T @ tau[:, 0] / 0.05**2
        k, q0 = coef[4], -coef[3] / coef[4]
        slopes = {"k": [0.0, 1.0], "q0": [-1.0 / k, -q0 / k]}
        for name, value in (("k", k), ("q0", q0)):
            slope = np.array(slopes[name])
            expected = np.sqrt(slope @ covariance[3:, 3:] @ slope)
            assert effect.parameters[name] == pytest.approx(value, abs=0.01 * expected)
            low, high = effect.intervals[name]
            assert 0.5 * (low + high) == pytest.approx(effect.parameters[name])
            ratios.append(0.5 * (high - low) / expected)
    # 1.645 for 90 %, a few per cent more for Student's t with forty blocks. The ratio
    # scatters by 13 %; 80 % and 95 % intervals would have 1.28 and 1.96.
    assert all(1.5 < np.mean(value) < 1.9 for value in (ratios[::2], ratios[1::2]))


def test_undefined_variances_affect_dependent_parameters_only():
    covariance = np.array([[4.0, np.nan], [np.nan, np.nan]])
    keywords = {"coef": np.array([2.0, 1.0]), "shape": (), "freedom": 20.0}
    estimate = EffectEstimate(**keywords, covariance=covariance)
    values, stds = named_values(AsymmetricFriction(0), estimate)
    assert list(values.values()) == [2.0, 1.0]
    assert_allclose([*stds.values()], [2.0, np.nan])


def test_slow_residuals_widen_the_intervals():
    widths = {}
    for rho in (0.0, 0.9):
        model, states, tau, _ = pendulum(3, rho)
        (effect,) = loop_on(model, states, tau).effects_
        widths[rho] = np.ptp(effect.intervals["k"])
    # A slow regressor would give sqrt(19).
    assert 1.5 < widths[0.9] / widths[0.0] < 5.0


def test_intervals_are_centred_on_the_completed_model():
    """Also if the projection changes them, here negative viscous friction."""
    recording = record("ZY", duration=40.0, seed=1)
    tau = recording.torque(
        quadratic_1=lambda r: (0.3 * np.abs(r.v[:, 0]) - 0.9) * r.v[:, 0],
        spring_2=lambda r: 0.8 * (r.q[:, 1] - 0.2),
    )
    loop = recording.discover(tau, ["viscous_quadratic", "spring"])
    assert named(loop) == [("spring", 1), ("viscous_quadratic", 0)]
    robot = loop.identifier_
    names = ("joint_1:viscous_quadratic:F2", "joint_2:offset")
    names += ("joint_2:spring:k", "joint_2:spring:c")
    quadratic, offset, k, c = map(list(robot.parameter_names_).index, names)
    assert abs(robot.theta_[quadratic] - robot.theta_unconstrained_[quadratic]) > 1e-3
    by_name = {effect.name: effect for effect in loop.effects_}
    assert by_name["viscous_quadratic"].parameters["F2"] == robot.theta_[quadratic]
    assert by_name["spring"].parameters["k"] == robot.theta_[k]
    assert robot.theta_[offset] == pytest.approx(0.0, abs=1e-9)
    q0 = -robot.theta_[c] / robot.theta_[k]
    assert by_name["spring"].parameters["q0"] == pytest.approx(q0)
    for effect in loop.effects_:
        for key, (low, high) in effect.intervals.items():
            assert 0.5 * (low + high) == pytest.approx(effect.parameters[key])


def test_a_shared_constant_is_reported_for_one_effect():
    """A spring and asymmetric friction on one joint share one constant term."""
    recording = record("ZY", seed=0)
    torque = recording.torque(
        joint_2=lambda r: 0.4 + 0.3 * np.abs(r.v[:, 1]) + 2.0 * (r.q[:, 1] - 0.5)
    )
    loop = recording.discover(torque, ["asymmetric_friction", "spring"])
    assert sorted(e.name for e in loop.effects_) == ["asymmetric_friction", "spring"]
    by_name = {e.name: e for e in loop.effects_}
    reported = {(name, key) for name, e in by_name.items() for key in e.intervals}
    constants = {("spring", "q0"), ("asymmetric_friction", "dFc")}
    ((name, key),) = reported & constants
    low, high = by_name[name].intervals[key]
    truth = {"q0": 0.3, "dFc": -0.6}[key]
    assert low - 0.5 * (high - low) < truth < high + 0.5 * (high - low)
    ((other, omitted),) = constants - {(name, key)}
    assert f"{omitted} not identifiable" in words.parameter_text(by_name[other])


@pytest.mark.parametrize("bodies", ["prior", "free"])
def test_rest_position_of_a_spring_includes_the_uncertainty_of_the_weight(bodies):
    """A vertical slider of 3.2 kg, described with 4 kg: one constant force."""
    recording = record("z", seed=1)
    force = recording.torque(
        joint_1=lambda r: 250.0 * (r.q[:, 0] - 0.1) - 0.8 * (9.81 + r.a[:, 0])
    )
    robot = recording.robot(bodies=bodies)
    (spring,) = recording.discover(force, ["spring"], robot=robot).effects_
    low, high = spring.intervals["k"]
    assert low - 1.0 < 250.0 < high + 1.0
    assert high - low < 10.0
    if bodies == "free":
        # Accelerations determine the sum of mass and rotor inertia only.
        assert "q0" not in spring.intervals
        assert "+-" not in words.parameter_text(spring)[1]
    else:
        low, high = spring.intervals["q0"]
        assert low < 0.1 < high


def test_derived_value_of_an_undetermined_coefficient():
    keywords = {"coef": np.array([4.0, -2.0]), "shape": (), "freedom": 30.0}
    keywords["covariance"] = np.diag([0.1, 0.2]) ** 2
    effect, found = Spring(), []
    for of_prior in (0.0, np.diag([0.0, 0.6]) ** 2, np.diag([0.0, np.nan])):
        estimate = EffectEstimate(**keywords, of_prior=of_prior)
        found += (
            named_values(effect, x)[1] for x in (estimate, estimate.given_shape())
        )
    assert_allclose([one["k"] for one in found], 0.1, rtol=1e-6)
    alone, both = (np.hypot(0.1 * 0.5, c) / 4.0 for c in (0.2, np.hypot(0.2, 0.6)))
    expected = [alone, alone, both, alone, np.nan, np.nan]
    assert_allclose([one["q0"] for one in found], expected, rtol=1e-6)


def test_alternative_forms_widen_intervals():
    keywords = {"coef": np.array([0.3]), "shape": ("vs",), "freedom": 30.0}
    keywords["covariance"] = np.diag([0.03, 0.04]) ** 2
    effect = Stribeck(vs=0.2)
    alone = named_values(effect, EffectEstimate(**keywords))[1]
    forms = ((0.25, {"Fs": 0.22, "vs": 0.26}),)
    with_forms = named_values(effect, EffectEstimate(**keywords, forms=forms))[1]
    assert_allclose(alone["Fs"], 0.03, rtol=1e-6)
    assert_allclose(with_forms["Fs"], np.sqrt(0.03**2 + 0.25 * 0.08**2), rtol=1e-6)
    assert_allclose(with_forms["vs"], np.sqrt(0.04**2 + 0.25 * 0.06**2), rtol=1e-6)


@pytest.mark.parametrize("identifiable", [True, False])
def test_a_fixed_shape_narrows_coefficient_intervals(identifiable):
    # Depth and width of the Stribeck dip are strongly correlated.
    covariance = np.linalg.inv([[900.0, 850.0], [850.0, 900.0]])
    if not identifiable:
        covariance[1] = covariance[:, 1] = np.nan
    keywords = {"coef": np.array([0.15]), "shape": ("vs",), "freedom": 30.0}
    estimate = EffectEstimate(**keywords, covariance=covariance, forms=((0.5, {}),))
    stds = named_values(Stribeck(vs=0.2), estimate.given_shape())[1]
    expected = 1 / 30.0 if identifiable else np.sqrt(covariance[0, 0])
    assert_allclose(stds["Fs"], expected, rtol=1e-6)


def discovered(effect, rising=0.0, hidden=(), library=(), coef=(0.5,), noise=np.nan):
    """Discover an effect whose parameters have a standard deviation of 0.1."""
    shape = getattr(effect, "continuous", ())
    covariance = 0.01 * np.eye(len(coef) + len(shape))
    keywords = {"covariance": covariance, "freedom": 30.0, "position_noise": noise}
    estimate = EffectEstimate(coef=np.array(coef), shape=shape, **keywords)
    found = SimpleNamespace(warning="", rivals=(), evidence=None)
    search = SimpleNamespace(findings=[found], library=library)
    final = SimpleNamespace(effects=[effect], effect_estimates=[estimate])
    doubts = set(), np.array([rising]), hidden
    return next(discovered_effects(search, final, ["j1"], [False], *doubts))


def test_positive_shapes_have_positive_intervals_and_a_rise_is_a_warning():
    for rising in (0.0, 0.1):
        effect = discovered(Stribeck(joint=0, vs=0.05), rising)
        low, high = effect.intervals["vs"]
        assert 0 < low < 0.05 < high
        assert low * high == pytest.approx(0.05**2)
        assert ("rose" in effect.warning) == bool(rising)
    assert any(" to " in text for text in words.parameter_text(effect))


def test_absent_elements_and_unresolved_presliding_are_not_printed():
    bank = effects.MaxwellSlip(displacements=(0.0, 1e-4), falling=(0.01,))
    for noise, half in ((1e-6, "half = "), (1e-4, "half < 0.0006 rad")):
        effect = discovered(bank, coef=(1.0, 1.0, 0.05), noise=noise)
        texts = words.parameter_text(effect)
        assert [text.split()[0] for text in texts] == ["Fc", "half", "element"]
        assert texts[1].startswith(half)


def test_an_unexcited_effect_that_contains_another_is_its_rival():
    hidden = SimpleNamespace(name="gear_loss", joint=0, reason="excitation")
    for some in ((), (hidden,)):
        effect = discovered(effects.LoadFriction(), 0.0, some, [effects.GearLoss()])
        assert effect.rivals == ("gear_loss",) * len(some)


def test_the_phase_of_an_amplitude_does_not_show_that_it_exists():
    for amplitude in (-0.1, -1.0):
        effect = discovered(effects.Ripple(), coef=(amplitude, 0.1 * amplitude))
        assert effect.intervals["phase"][1] < 0.0
        assert bool(effect.warning) == (amplitude == -0.1)


def test_the_largest_of_two_sizes_must_be_significant_for_two():
    for size in (0.19, 0.22):  # 1.70 deviations for one size, 2.04 for two
        effect = discovered(AsymmetricFriction(0), coef=(size, 0.0))
        assert effect.intervals["dFc"][0] > 0.0
        assert bool(effect.warning) == (size < 0.2)
