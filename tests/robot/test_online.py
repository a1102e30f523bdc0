"""A robot that is running: rows one by one, forgotten with time."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import Ridge

pytest.importorskip("pinocchio")

import pinocchio as pin

from sklearn_vbjfa import RigidBodyFeatures, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import Ripple
from sklearn_vbjfa.robot._online import _FADED
from tests.model._robots import random_tree, swing

FRICTION = ("viscous", "coulomb", "offset", "rotor_inertia")


@pytest.fixture(scope="module")
def recording():
    return make_robot_recording(duration=6.0, dt=0.01, frequency=1.0, random_state=3)


def running(recording, **settings):
    settings = {"friction": FRICTION, "standstill": 0.01, "bodies": "free", **settings}
    return RobotIdentifier(recording.urdf, **settings)


def assert_equal_statistics(robot, other, rtol=1e-10):
    for name in ("n", "yy", "g", "G"):
        values = getattr(robot.estimator_.statistics_, name)
        expected = getattr(other.estimator_.statistics_, name)
        size = np.abs(expected).max()
        assert_allclose(values, expected, rtol=0, atol=rtol * size, err_msg=name)
    assert_array_equal(
        robot.estimator_.statistics_.n_rows, other.estimator_.statistics_.n_rows
    )


@pytest.mark.parametrize("forgetting", [1.0, 0.995])
@pytest.mark.parametrize("chunk", [1, 7, 8, 9, 150, 600])
def test_equals_a_fit_that_weighs_by_age(recording, forgetting, chunk):
    X, y = recording.states, recording.tau
    n = X.shape[0]
    weight = np.random.default_rng(0).uniform(0.5, 2.0, y.shape)
    weight[100:120, 2] = 0.0
    robot = running(recording, forgetting=forgetting)
    for i in range(0, n, chunk):
        rows = slice(i, i + chunk)
        robot.partial_fit(X[rows], y[rows], weight[rows], refit=i + chunk >= n)
    age = np.arange(n - 1.0, -1.0, -1.0)[:, None]
    whole = running(recording).fit(X, y, sample_weight=weight * forgetting**age)
    assert_equal_statistics(robot, whole)
    size = np.abs(whole.theta_unconstrained_).max()
    assert_allclose(
        robot.theta_unconstrained_, whole.theta_unconstrained_, atol=1e-8 * size
    )
    assert_allclose(robot.theta_, whole.theta_, rtol=0, atol=1e-7 * size)
    assert np.all(robot.min_eigenvalues_ > 0)
    assert_allclose(robot.predict(X[:5]), whole.predict(X[:5]), rtol=1e-6)


def test_a_tree_and_one_joint():
    model, _ = random_tree(np.random.default_rng(8), 4)
    for robot_model in (model, swing()):
        recording = make_robot_recording(robot_model, duration=6.0, random_state=0)
        settings = {"standstill": None, "friction": ("viscous",)}
        robot = RobotIdentifier(robot_model, **settings)
        X, y = recording.states, recording.tau
        for x, tau in zip(X, y):
            robot.partial_fit(x, tau, refit=False)
        robot.partial_fit(X[:3], y[:3])
        again = RobotIdentifier(robot_model, **settings)
        again.fit(np.r_[X, X[:3]], np.r_[y, y[:3]])
        assert_equal_statistics(robot, again)


def test_a_long_memory_of_short_weights_stays_finite(recording):
    # 0.5 ** 600 lies below what the sums are scaled by
    assert 0.5**recording.n_samples < _FADED
    robot = running(recording, forgetting=0.5, standstill=None)
    for x, tau in zip(recording.states, recording.tau):
        robot.partial_fit(x, tau, refit=False)
    assert_allclose(robot._online.moments().n, 2.0, rtol=1e-12)
    last = recording.tau[-60:]
    weight = 0.5 ** np.arange(59.0, -1.0, -1.0)
    assert_allclose(robot._online.moments().yy, weight @ last**2, rtol=1e-12)


def test_goes_on_after_pickling(recording):
    X, y = recording.states, recording.tau
    robot = running(recording, forgetting=0.999)
    robot.partial_fit(X[:301], y[:301], refit=False)
    copy = pickle.loads(pickle.dumps(robot))
    for own in (robot, copy):
        for x, tau in zip(X[301:], y[301:]):
            own.partial_fit(x, tau, refit=False)
    for name in ("n", "g", "G"):
        assert_array_equal(
            getattr(robot._online.moments(), name),
            getattr(copy._online.moments(), name),
        )


def test_follows_a_payload_with_the_time_constant_of_the_memory():
    """A load is picked up: the model moves to it as 1 - forgetting ** rows."""
    rng = np.random.default_rng(8)
    model, bodies = random_tree(rng, 4)
    # Half a kilogram at (0.1, 0.05, -0.2) m of the last body.
    load = pin.Inertia(0.5, np.array([0.1, 0.05, -0.2]), np.zeros((3, 3)))
    heavier = bodies.copy()
    heavier[-1] += load.toDynamicParameters()
    features = RigidBodyFeatures(model, friction=())
    # The same states again and again: past and present weigh them alike.
    states = rng.normal(size=(50, 12))
    Phi = features.fit_transform(states).reshape(50, 4, 40)
    before, after = Phi @ bodies.ravel(), Phi @ heavier.ravel()
    memory = 200
    robot = RobotIdentifier(
        model,
        standstill=None,
        friction=(),
        forgetting=1 - 1 / memory,
        bodies="free",
    )
    for _ in range(100):
        robot.partial_fit(states, before, refit=False)
    robot.set_params(projector=None).partial_fit(states, before)
    size = np.abs(after - before).max()
    assert_allclose(robot.predict(states), before, rtol=0, atol=1e-4 * size)
    for rounds in range(1, 41):
        robot.partial_fit(states, after, refit=rounds % 4 == 0)
        if rounds % 4 == 0:
            gone = 1 - robot.forgetting ** (50 * rounds)
            expected = before + gone * (after - before)
            found = robot.predict(states)
            # Two robots in one memory are noise to a single model, and with noise
            # relevance determination shrinks a little.
            assert_allclose(found, expected, rtol=0, atol=0.02 * size)
    robot.set_params(projector="default").partial_fit(states, after)
    assert np.all(robot.min_eigenvalues_ > 0)
    # The projection is nearest in what all torques together feel.
    whole = np.abs(after).max()
    assert_allclose(robot.predict(states), after, rtol=0, atol=1e-3 * whole)


def test_begins_anew_after_a_fit_and_keeps_the_standstill(recording):
    robot = running(recording, standstill="auto", dt=recording.dt)
    robot.fit(recording.q, recording.tau)
    speeds = robot.standstill_.copy()
    robot.partial_fit(recording.states, recording.tau)
    assert_array_equal(robot.standstill_, speeds)
    given = running(recording, standstill=speeds, dt=recording.dt)
    given.partial_fit(recording.states, recording.tau)
    assert_array_equal(robot.theta_, given.theta_)
    # and a fit forgets what was running
    theta = running(recording, standstill="auto", dt=recording.dt)
    theta.fit(recording.q, recording.tau)
    robot.fit(recording.q, recording.tau)
    assert_array_equal(robot.theta_, theta.theta_)


def test_accumulating_does_not_touch_the_parameters(recording):
    robot = running(recording).partial_fit(recording.states, recording.tau)
    theta = robot.theta_.copy()
    for x, tau in zip(recording.states[:20], recording.tau[:20]):
        robot.partial_fit(x, 2 * tau, refit=False)
    assert_array_equal(robot.theta_, theta)
    robot.partial_fit(recording.states[:1], recording.tau[:1])
    assert not np.array_equal(robot.theta_, theta)


# -- refusals


@pytest.mark.parametrize("forgetting", [0.0, 1.5, -1, np.nan, [0.9]])
def test_what_is_no_weight_is_refused(recording, forgetting):
    with pytest.raises(ValueError, match=r"forgetting must be a number in \(0, 1\]"):
        running(recording, forgetting=forgetting).partial_fit(
            recording.states, recording.tau
        )


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"effects": (Ripple(joint=1),)}, "effects"),
        ({"regressor": Ridge()}, "regressor"),
    ],
)
def test_what_needs_more_than_moments_is_refused(recording, settings, name):
    with pytest.raises(ValueError, match=f"partial_fit does not support {name}"):
        running(recording, **settings).partial_fit(recording.states, recording.tau)


def test_automatic_standstill_needs_a_recording(recording):
    robot = running(recording, standstill="auto")
    with pytest.raises(ValueError, match="needs the speeds of a whole recording"):
        robot.partial_fit(recording.states, recording.tau)


def test_bad_rows_are_refused_and_leave_no_trace(recording):
    X, y = recording.states, recording.tau
    robot = running(recording).partial_fit(X, y, refit=False)
    before = robot._online.moments()
    with pytest.raises(ValueError, match="positions cannot be differentiated"):
        robot.partial_fit(recording.q[0], y[0])
    with pytest.raises(ValueError, match="y must have 6 column"):
        robot.partial_fit(X[:2], y[:2, :5])
    with pytest.raises(ValueError, match="y must hold torques of shape"):
        robot.partial_fit(X[:2], y[:3])
    bad = X[:1].copy()
    bad[0, 4] = np.nan
    with pytest.raises(ValueError, match="must be finite"):
        robot.partial_fit(bad, y[:1])
    assert_array_equal(robot._online.moments().G, before.G)
    with pytest.raises(ValueError, match="fewer than the"):
        clone(robot).partial_fit(X[:2], y[:2])
