"""Samples and ranges of identified robots, by closed forms and left-out motion."""

import dataclasses
import json

import numpy as np
import pytest
from scipy import optimize, stats
from sklearn.linear_model import Ridge
from sklearn.utils import check_random_state

from sklearn_vbjfa import RobotIdentifier, load_identified
from sklearn_vbjfa.fit._pooling import _RecordingEffects
from sklearn_vbjfa.physical import min_eigenvalue
from sklearn_vbjfa.robot import BetweenRecordings, Marginal, Posterior
from tests.model._mujoco import drive_torques, moving_states
from tests.model.test_mjcf import assert_same
from tests.robot._differing import NAMES, URDF, held, recordings, share_of

# States are drawn one by one.
pytestmark = pytest.mark.filterwarnings("ignore:The rows are not in the order of time")


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "one.urdf"
    path.write_text(URDF)
    return str(path)


def fitted(urdf, seed, n, off, labelled=True, **changes):
    """Identify a robot from n recordings that differ."""
    X, y, labels, _ = recordings(urdf, seed, n, off=off, **changes)
    robot = RobotIdentifier(urdf, bodies="fixed")
    return robot.fit(X, y, groups=labels if labelled else None)


@pytest.fixture(scope="module")
def several(urdf):
    return fitted(urdf, 0, 6, share_of(0.3))


# -- one value -------------------------------------------------------------------------

MIXTURES = [
    (2.0, [0.3], [1.0]),
    (0.1, [0.3], [1.0]),
    (-2.4, [0.3], [1.0]),
    (0.2, [0.1, 0.3, 2.0], [0.5, 0.3, 0.2]),
    (-0.5, [0.1, 0.3], [0.6, 0.4]),
]


@pytest.mark.parametrize(("centre", "deviations", "weights"), MIXTURES)
@pytest.mark.parametrize("lowest", [-np.inf, 0.0])
def test_a_value_is_as_scipy_has_it(centre, deviations, weights, lowest):
    found = Marginal(
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
        (quantile,) = found.quantiles([share])
        assert quantile == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_one_recording_has_the_deviations_of_the_fit(urdf):
    robot = fitted(urdf, 3, 1, share_of(0.0), labelled=False, noise=1.0)
    # without what its stretches differ by
    alone = dataclasses.replace(robot.robot_, recording_variance=None)
    found = alone.ranges(level=0.8)
    assert found.recordings == 1
    for k, name in enumerate(robot.parameter_names_[10:], start=10):
        one, centre = found[name], robot.theta_unconstrained_[k]
        std = robot.theta_std_[k]
        cut = stats.truncnorm(-centre / std, np.inf, centre, std)
        law = stats.norm(centre, std) if name == "hip:offset" else cut
        np.testing.assert_allclose([one.lower, one.upper], law.ppf([0.1, 0.9]), 1e-9)
        assert one.within == std
        assert one.between == 0.0


def test_a_single_recording_is_judged_by_its_stretches(urdf):
    """Four recordings that differ, told as one, against four that do not."""

    def ranges(share, labelled):
        return fitted(urdf, 4, 4, share_of(share), labelled, noise=0.1).ranges()

    one, several, same = ranges(0.3, False), ranges(0.3, True), ranges(0.0, False)
    assert (one.recordings, several.recordings, same.recordings) == (1, 4, 1)
    for name in NAMES:
        assert one[name].between == pytest.approx(several[name].between, rel=0.3)
        assert same[name].between < 0.3 * one[name].between


# -- from recording to recording -------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_the_scale_of_a_single_value_is_the_exact_one(seed):
    """Its posterior is that of y_r ~ N(theta, s^2 + v_r) with theta integrated."""
    rng = np.random.default_rng(seed)
    power = rng.uniform(20.0, 200.0, 7)
    y = 1.0 + 0.3 * rng.standard_normal(7) + rng.standard_normal(7) / np.sqrt(power)
    theta = power @ y / power.sum()
    places = np.array([0])
    effects = _RecordingEffects(
        power[:, None, None],
        (power * (y - theta))[:, None],
        np.array([theta]),
        0.0,
        places,
    )
    weights = effects.solve()[:, 0]
    scales = np.geomspace(1e-4, 2.0, weights.size)
    expected = []
    for s in scales * effects.unit[0]:
        own = 1.0 / (s**2 + 1.0 / power)
        left = own @ (y - own @ y / own.sum()) ** 2
        prior = s / (1.0 + (s / (0.2 * effects.unit[0])) ** 2)
        density = np.sqrt(np.prod(own) / own.sum()) * np.exp(-0.5 * left)
        expected.append(density * prior)
    expected = np.array(expected)
    expected[[0, -1]] *= 0.5
    np.testing.assert_allclose(
        weights, expected / expected.sum(), rtol=1e-6, atol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("n", [4, 8, 16])
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_left_out_recordings_are_in_their_ranges(n, share, urdf):
    seeds = range(1000, 1600)
    done = [held(urdf, seed, n, share_of(share))[0] for seed in seeds]
    inside = np.mean(done, axis=0)
    assert 0.86 <= inside.mean() <= 0.94
    # of few recordings, what scatters about nothing is in its range less often
    assert (inside > 0.82).all()


@pytest.mark.parametrize("n", [2, 8])
def test_the_fitted_value_is_off_as_the_mean_of_its_recordings(urdf, n):
    """Deviations of the next recording are s sqrt(1 + 1/n), of n that tell as much."""
    robot = fitted(urdf, 5, n, share_of(0.0), noise=1e-3)
    found = robot.robot_.recording_variance
    place = robot.parameter_names_.index("hip:viscous")
    size = found.size[list(found.places).index(place)]
    assert size / robot.theta_[place] == pytest.approx(np.sqrt(1 + 1 / n), rel=0.01)


def test_the_scatter_is_found(urdf):
    off = share_of(0.3)
    found = fitted(urdf, 2, 30, off).ranges()
    between = np.array([found[name].between for name in NAMES])
    # the deviation of a deviation of thirty is 13 %
    np.testing.assert_allclose(between, off, rtol=0.4)


# -- samples ---------------------------------------------------------------------------


def posterior(centre, covariance, between=None, nonnegative=()):
    """Posterior of values without bodies."""
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
def test_samples_have_the_distributions_of_the_ranges(centre, nonnegative, between):
    known = posterior(centre, CORRELATED, between, nonnegative)
    drawn = known.sample(0, range(3000))
    assert (drawn[:, known.nonnegative] >= 0).all()
    for k in nonnegative or range(3):
        shares = np.linspace(0.02, 0.98, 49)
        found = [(drawn[:, k] <= x).mean() for x in known.marginal(k).quantiles(shares)]
        # Kolmogorov and Smirnov's difference, at a level of 1e-3
        np.testing.assert_allclose(found, shares, atol=1.95 / np.sqrt(3000))


def test_what_is_cut_off_takes_the_others_along():
    """Samples without anything to cut are normal, and have their covariance."""
    known = posterior((5.0, 9.0, 7.0), CORRELATED, None, (0, 1, 2))
    drawn = known.sample(0, range(3000))
    np.testing.assert_allclose(np.cov(drawn.T), CORRELATED, atol=0.12)


def test_far_below_zero_is_drawn_as_well():
    """Refusing would take 1e16 draws each."""
    known = posterior([-8.0, 1.0], [[1.0, 0.5], [0.5, 1.0]], None, (0,))
    drawn = known.sample(0, range(2000))
    exact = Marginal(centre=-8.0, deviations=np.ones(1), weights=np.ones(1), lowest=0.0)
    shares = np.linspace(0.02, 0.98, 25)
    np.testing.assert_allclose(
        np.quantile(drawn[:, 0], shares), exact.quantiles(shares), atol=0.05
    )
    # the other one follows: E[y | x] = 1 + 0.5 (x + 8)
    left = drawn[:, 1] - 1.0 - 0.5 * (drawn[:, 0] + 8.0)
    assert abs(left.mean()) < 4 * np.sqrt(0.75 / 2000)
    assert left.std() == pytest.approx(np.sqrt(0.75), rel=0.06)


def test_a_row_of_a_seed_is_the_same_one_for_every_number(several):
    many = several.sample(30, random_state=4)
    np.testing.assert_allclose(several.sample(7, random_state=4), many[:7], rtol=1e-9)
    assert not np.allclose(several.sample(7, random_state=5), many[:7])
    state = check_random_state(3)
    first = several.sample(3, random_state=state)
    assert not np.allclose(several.sample(3, random_state=state), first)
    again = several.sample(3, random_state=check_random_state(3))
    np.testing.assert_array_equal(again, first)
    # Without a seed it is the one of NumPy.
    assert not np.allclose(several.sample(3), several.sample(3))


@pytest.mark.parametrize("bodies", ["prior", "free"])
def test_samples_are_robots(bodies, simulated):
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, bodies=bodies)
    robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
    drawn = robot.sample(12, random_state=0)
    nv = len(robot.joint_names_)
    parts = drawn.reshape(12, nv, -1)
    assert min_eigenvalue(parts[:, :, :10].reshape(-1, 10)).min() > 0
    # viscous, coulomb and rotor inertia; an offset has either sign
    assert parts[:, :, [10, 11, 13]].min() >= 0
    assert (parts[:, :, 12] < 0).any()
    # They are as good as the robot itself, but for how far recordings differ.
    within = dataclasses.replace(robot.robot_, recording_variance=None)
    states = robot.state_estimator_.transform(simulated.q, groups=simulated.groups)
    rows = states[::50]
    torque, std = robot.predict(rows), robot.output_noise_
    one = dataclasses.replace(robot.robot_, theta_=within.sample(3, random_state=0)[2])
    assert (np.abs(one.predict(rows) - torque) / std).mean() < 1.0


# -- files -----------------------------------------------------------------------------


def test_a_saved_robot_has_the_same_ranges(several, tmp_path):
    several.save(tmp_path / "one.json")
    read = load_identified(tmp_path / "one.json")
    assert read.ranges(0.8).parameters == several.ranges(0.8).parameters
    np.testing.assert_array_equal(
        read.sample(4, random_state=0), several.sample(4, random_state=0)
    )


def test_ranges_are_written_by_joint(several, tmp_path):
    found = several.ranges(level=0.9)
    found.save(tmp_path / "ranges.json")
    content = json.loads((tmp_path / "ranges.json").read_text())
    assert (content["format"], content["level"]) == ("sklearn_vbjfa ranges", 0.9)
    assert content["recordings"] == 6
    # The bodies are those of the description.
    values = {one["name"]: one for one in content["values"]}
    assert list(values) == NAMES
    armature, one = values["hip:rotor_inertia"], found["hip:rotor_inertia"]
    assert (armature["joint"], armature["unit"]) == ("hip", "kg m^2")
    assert (armature["lower"], armature["upper"]) == (one.lower, one.upper)
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
    one = dataclasses.replace(robot.robot_, theta_=drawn)
    states = moving_states(np.random.default_rng(0), 50, len(robot.joint_names_))
    assert_same(drive_torques(path, states), one.predict(states), 1e-6)
    # It is not the identified robot.
    away = np.abs(robot.predict(states) - one.predict(states)).max()
    assert away > 1e-3 * np.abs(robot.predict(states)).max()


# -- bad input -------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0, 1, -0.1, 1.5, np.nan, "90 %", None, True])
def test_levels_that_are_none(level, several):
    with pytest.raises(ValueError, match="between 0 and 1, such as 0"):
        several.ranges(level)


def test_a_regressor_without_a_covariance(urdf):
    X, y, labels, _ = recordings(urdf, 0, 2, off=share_of(0.0))
    robot = RobotIdentifier(urdf, regressor=Ridge()).fit(X, y, groups=labels)
    for ask in (robot.ranges, lambda: robot.sample(1)):
        with pytest.raises(ValueError, match="its regressor gives none"):
            ask()
