"""Posterior samples and ranges of identified robots."""

import dataclasses
import json

import numpy as np
import pytest
from scipy import optimize, stats
from sklearn.linear_model import Ridge
from sklearn.utils import check_random_state

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.fit._between_recordings import _RecordingEffects
from sklearn_vbjfa.physical import min_eigenvalue
from sklearn_vbjfa.robot import BetweenRecordings, Marginal, Posterior
from tests.model._mujoco import drive_torques, moving_states
from tests.model.test_mjcf import assert_same
from tests.robot._differing import NAMES, URDF, covers, recordings, share_of

# States are drawn independently.
pytestmark = pytest.mark.filterwarnings("ignore:The rows are not in the order of time")


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "one.urdf"
    path.write_text(URDF)
    return str(path)


def fitted(urdf, seed, n, off, labelled=True, **changes):
    """Identify a robot from n recordings of different parameters."""
    X, y, labels, _ = recordings(urdf, seed, n, off=off, **changes)
    robot = RobotIdentifier(urdf, bodies="fixed")
    return robot.fit(X, y, groups=labels if labelled else None)


@pytest.fixture(scope="module")
def several(urdf):
    return fitted(urdf, 0, 6, share_of(0.3))


# -- marginals -------------------------------------------------------------------------

MIXTURES = [
    (2.0, [0.3], [1.0]),
    (0.1, [0.3], [1.0]),
    (-2.4, [0.3], [1.0]),
    (0.2, [0.1, 0.3, 2.0], [0.5, 0.3, 0.2]),
    (-0.5, [0.1, 0.3], [0.6, 0.4]),
]


@pytest.mark.parametrize(("centre", "deviations", "weights"), MIXTURES)
@pytest.mark.parametrize("lowest", [-np.inf, 0.0])
def test_marginal_quantiles_match_scipy(centre, deviations, weights, lowest):
    marginal = Marginal(
        centre=centre,
        deviations=np.array(deviations),
        weights=np.array(weights),
        lowest=lowest,
    )
    parts = [stats.norm(centre, s) for s in deviations]
    total = sum(w * p.sf(lowest) for w, p in zip(weights, parts))

    def above(x):
        return sum(w * p.sf(x) for w, p in zip(weights, parts)) / total

    for share in (0.05, 0.5, 0.95):
        start = max(lowest, centre - 30 * max(deviations))
        expected = optimize.brentq(
            lambda x, share=share: above(x) - (1 - share), start, 40.0, xtol=1e-14
        )
        (quantile,) = marginal.quantiles([share])
        assert quantile == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_ranges_of_one_recording_use_the_standard_errors(urdf):
    robot = fitted(urdf, 3, 1, share_of(0.0), labelled=False, noise=1.0)
    # Without the variance between its segments.
    alone = dataclasses.replace(robot.robot_, recording_variance=None)
    ranges = alone.ranges(level=0.8)
    assert ranges.recordings == 1
    for k, name in enumerate(robot.parameter_names_[10:], start=10):
        row, centre = ranges[name], robot.theta_unconstrained_[k]
        std = robot.theta_std_[k]
        cut = stats.truncnorm(-centre / std, np.inf, centre, std)
        law = stats.norm(centre, std) if name == "hip:offset" else cut
        np.testing.assert_allclose([row.lower, row.upper], law.ppf([0.1, 0.9]), 1e-9)
        assert row.within == std
        assert row.between == 0.0


def test_single_recording_is_split_into_segments(urdf):
    """Compare four differing recordings, as one group, with four equal ones."""

    def ranges(share, labelled):
        return fitted(urdf, 4, 4, share_of(share), labelled, noise=0.1).ranges()

    joined, separate, equal = ranges(0.3, False), ranges(0.3, True), ranges(0.0, False)
    assert (joined.recordings, separate.recordings, equal.recordings) == (1, 4, 1)
    for name in NAMES:
        assert joined[name].between == pytest.approx(separate[name].between, rel=0.3)
        assert equal[name].between < 0.3 * joined[name].between


# -- variance between recordings -------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_scale_posterior_of_a_single_value_is_exact(seed):
    """The posterior is that of y_r ~ N(theta, s^2 + v_r), with theta integrated."""
    rng = np.random.default_rng(seed)
    power = rng.uniform(20.0, 200.0, 7)
    y = 1.0 + 0.3 * rng.standard_normal(7) + rng.standard_normal(7) / np.sqrt(power)
    theta = power @ y / power.sum()
    indices = np.array([0])
    effects = _RecordingEffects(
        power[:, None, None],
        (power * (y - theta))[:, None],
        np.array([theta]),
        0.0,
        indices,
    )
    weights = effects.solve()[:, 0]
    scales = np.geomspace(1e-4, 2.0, weights.size)
    expected = []
    for s in scales * effects.unit[0]:
        precision = 1.0 / (s**2 + 1.0 / power)
        misfit = precision @ (y - precision @ y / precision.sum()) ** 2
        prior = s / (1.0 + (s / (0.2 * effects.unit[0])) ** 2)
        density = np.sqrt(np.prod(precision) / precision.sum()) * np.exp(-0.5 * misfit)
        expected.append(density * prior)
    expected = np.array(expected)
    expected[[0, -1]] *= 0.5
    np.testing.assert_allclose(
        weights, expected / expected.sum(), rtol=1e-6, atol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("n", [4, 8, 16])
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_held_out_recordings_are_covered_by_the_ranges(n, share, urdf):
    seeds = range(1000, 1600)
    results = [covers(urdf, seed, n, share_of(share))[0] for seed in seeds]
    inside = np.mean(results, axis=0)
    assert 0.86 <= inside.mean() <= 0.94
    # With few recordings, values that scatter around zero are covered less often.
    assert (inside > 0.82).all()


@pytest.mark.parametrize("n", [2, 8])
def test_prediction_variance_includes_the_error_of_the_mean(urdf, n):
    """The next recording deviates by s sqrt(1 + 1/n) if all n are equally precise."""
    robot = fitted(urdf, 5, n, share_of(0.0), noise=1e-3)
    variance = robot.robot_.recording_variance
    index = robot.parameter_names_.index("hip:viscous")
    size = variance.size[list(variance.places).index(index)]
    assert size / robot.theta_[index] == pytest.approx(np.sqrt(1 + 1 / n), rel=0.01)


def test_variance_between_recordings_is_estimated(urdf):
    off = share_of(0.3)
    ranges = fitted(urdf, 2, 30, off).ranges()
    between = np.array([ranges[name].between for name in NAMES])
    # The standard deviation of 30 values is known to 13 %.
    np.testing.assert_allclose(between, off, rtol=0.4)


# -- samples ---------------------------------------------------------------------------


def posterior(centre, covariance, between=None, nonnegative=()):
    """Return the posterior of values without bodies."""
    centre = np.array(centre, dtype=float)
    mask = np.zeros(centre.size, dtype=bool)
    mask[list(nonnegative)] = True
    return Posterior(
        theta=np.maximum(centre, 0.0),
        centre=centre,
        std=np.sqrt(np.diagonal(covariance)),
        covariance=np.array(covariance, dtype=float),
        between=between,
        bodies=np.empty((0, 10), dtype=int),
        nonnegative=mask,
    )


CORRELATED = [[1.0, 0.6, -0.3], [0.6, 2.0, 0.2], [-0.3, 0.2, 0.5]]
OFF = BetweenRecordings(
    count=3,
    places=np.array([1, 2]),
    size=np.array([1.0, 0.5]),
    weights=np.array([[0.2, 0.5], [0.5, 0.3], [0.3, 0.2]]),
    scales=np.array([0.1, 0.7, 2.0]),
)


@pytest.mark.parametrize("between", [None, OFF])
@pytest.mark.parametrize(
    ("centre", "nonnegative"),
    [((5.0, 9.0, 7.0), ()), ((-0.8, 0.3, 0.4), (0, 1)), ((-1.0, -2.0, 9.0), (0, 1, 2))],
)
def test_samples_follow_the_marginals(centre, nonnegative, between):
    joint = posterior(centre, CORRELATED, between, nonnegative)
    drawn = joint.sample(0, range(3000))
    assert (drawn[:, joint.nonnegative] >= 0).all()
    for k in nonnegative or range(3):
        shares = np.linspace(0.02, 0.98, 49)
        found = [(drawn[:, k] <= x).mean() for x in joint.marginal(k).quantiles(shares)]
        # Kolmogorov-Smirnov statistic at a level of 1e-3
        np.testing.assert_allclose(found, shares, atol=1.95 / np.sqrt(3000))


def test_samples_without_truncation_have_the_covariance():
    joint = posterior((5.0, 9.0, 7.0), CORRELATED, None, (0, 1, 2))
    drawn = joint.sample(0, range(3000))
    np.testing.assert_allclose(np.cov(drawn.T), CORRELATED, atol=0.12)


def test_samples_from_a_far_truncated_tail():
    """Rejection sampling would need 1e16 draws for each sample."""
    joint = posterior([-8.0, 1.0], [[1.0, 0.5], [0.5, 1.0]], None, (0,))
    drawn = joint.sample(0, range(2000))
    exact = Marginal(centre=-8.0, deviations=np.ones(1), weights=np.ones(1), lowest=0.0)
    shares = np.linspace(0.02, 0.98, 25)
    np.testing.assert_allclose(
        np.quantile(drawn[:, 0], shares), exact.quantiles(shares), atol=0.05
    )
    # Conditional mean of the other value: E[y | x] = 1 + 0.5 (x + 8)
    residual = drawn[:, 1] - 1.0 - 0.5 * (drawn[:, 0] + 8.0)
    assert abs(residual.mean()) < 4 * np.sqrt(0.75 / 2000)
    assert residual.std() == pytest.approx(np.sqrt(0.75), rel=0.06)


def test_samples_of_a_seed_do_not_depend_on_their_number(several):
    many = several.sample(30, random_state=4)
    np.testing.assert_allclose(several.sample(7, random_state=4), many[:7], rtol=1e-9)
    assert not np.allclose(several.sample(7, random_state=5), many[:7])
    state = check_random_state(3)
    first = several.sample(3, random_state=state)
    assert not np.allclose(several.sample(3, random_state=state), first)
    again = several.sample(3, random_state=check_random_state(3))
    np.testing.assert_array_equal(again, first)
    # Without a seed, samples differ.
    assert not np.allclose(several.sample(3), several.sample(3))


@pytest.mark.parametrize("bodies", ["prior", "free"])
def test_samples_are_consistent_and_predict_well(bodies, simulated):
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, bodies=bodies)
    robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
    drawn = robot.sample(12, random_state=0)
    nv = len(robot.joint_names_)
    parts = drawn.reshape(12, nv, -1)
    assert min_eigenvalue(parts[:, :, :10].reshape(-1, 10)).min() > 0
    # Viscous and Coulomb friction, rotor inertia; offsets have either sign.
    assert parts[:, :, [10, 11, 13]].min() >= 0
    assert (parts[:, :, 12] < 0).any()
    # Without the variance between recordings, samples predict like the fit.
    within = dataclasses.replace(robot.robot_, recording_variance=None)
    states = robot.state_estimator_.transform(simulated.q, groups=simulated.groups)
    rows = states[::50]
    torque, std = robot.predict(rows), robot.output_noise_
    one = dataclasses.replace(robot.robot_, theta_=within.sample(3, random_state=0)[2])
    assert (np.abs(one.predict(rows) - torque) / std).mean() < 1.0


# -- files -----------------------------------------------------------------------------


def test_a_saved_robot_has_the_same_ranges(several, tmp_path):
    several.save(tmp_path / "one.json")
    loaded = load_identified(tmp_path / "one.json")
    assert loaded.ranges(0.8).parameters == several.ranges(0.8).parameters
    np.testing.assert_array_equal(
        loaded.sample(4, random_state=0), several.sample(4, random_state=0)
    )


def test_saved_ranges(several, tmp_path):
    ranges = several.ranges(level=0.9)
    ranges.save(tmp_path / "ranges.json")
    content = json.loads((tmp_path / "ranges.json").read_text())
    assert (content["format"], content["level"]) == ("sklearn_vbjfa ranges", 0.9)
    assert content["recordings"] == 6
    # The bodies are fixed.
    values = {row["name"]: row for row in content["values"]}
    assert list(values) == NAMES
    armature, row = values["hip:rotor_inertia"], ranges["hip:rotor_inertia"]
    assert (armature["joint"], armature["unit"]) == ("hip", "kg m^2")
    assert (armature["lower"], armature["upper"]) == (row.lower, row.upper)
    assert armature["lower"] < armature["value"] < armature["upper"]


@pytest.mark.slow
def test_mujoco_computes_the_torques_of_a_sample(simulated, tmp_path):
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt)
    robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
    path = tmp_path / "sample.xml"
    assert robot.to_mjcf(path, sample=3, random_state=7) == ()
    assert "Sample 3 of the posterior" in path.read_text()
    assert "random_state=7" in path.read_text()
    drawn = robot.sample(4, random_state=7)[3]
    sample = dataclasses.replace(robot.robot_, theta_=drawn)
    states = moving_states(np.random.default_rng(0), 50, len(robot.joint_names_))
    assert_same(drive_torques(path, states), sample.predict(states), 1e-6)
    # The sample differs from the identified robot.
    difference = np.abs(robot.predict(states) - sample.predict(states)).max()
    assert difference > 1e-3 * np.abs(robot.predict(states)).max()


# -- bad input -------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0, 1, -0.1, 1.5, np.nan, "90 %", None, True])
def test_invalid_levels_are_refused(level, several):
    with pytest.raises(ValueError, match="between 0 and 1, such as 0"):
        several.ranges(level)


def test_ranges_need_a_covariance(urdf):
    X, y, labels, _ = recordings(urdf, 0, 2, off=share_of(0.0))
    robot = RobotIdentifier(urdf, regressor=Ridge()).fit(X, y, groups=labels)
    for method in (robot.ranges, lambda: robot.sample(1)):
        with pytest.raises(ValueError, match="its regressor gives none"):
            method()
