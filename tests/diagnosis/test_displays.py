import sys

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa.diagnosis import ResidualDisplay, TorqueDisplay
from sklearn_vbjfa.diagnosis._displays import running_median
from tests.diagnosis._recordings import SPRINGY

SIGNALS = ["velocity [rad/s]", "position [rad]", "rigid-body torque [N m]", "time [s]"]


@pytest.fixture(name="pyplot")
def fixture_pyplot():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield pyplot
    pyplot.close("all")


# Positions and torques of a recording, and a search in it.
GIVEN = SPRINGY.position, SPRINGY.torque


@pytest.fixture(name="loop")
def fixture_loop(springy):
    return springy


def make_display(**changes):
    rng = np.random.default_rng(0)
    values = {
        "residual_before": rng.standard_normal((300, 2)),
        "residual_after": 0.2 * rng.standard_normal((300, 2)),
        "signals": {"v": rng.standard_normal((300, 2)), "time": np.arange(300.0)},
        "joint_names": ("a", "b"),
        "units": ("N m", "N"),
        "floor": np.array([0.2, np.nan]),
    }
    return ResidualDisplay(**(values | changes))


def test_a_discovery_shows_before_and_after(loop):
    display = ResidualDisplay.from_estimator(loop, *GIVEN, joints=[1, 0])
    assert list(display.signals) == SIGNALS
    assert display.residual_before.shape == display.residual_after.shape
    assert display.residual_before.shape[1] == 2
    assert display.joint_names == tuple(loop.declared_.joint_names_[j] for j in (1, 0))
    np.testing.assert_array_equal(display.floor, loop.identifier_.noise_floor_[[1, 0]])
    before, after = (
        np.nanstd(r, axis=0) for r in (display.residual_before, display.residual_after)
    )
    assert (after < before)[1]


def test_an_identifier_shows_its_own_residuals(loop):
    robot = loop.declared_
    display = ResidualDisplay.from_estimator(robot, *GIVEN)
    assert display.residual_after is None
    found = robot.residuals(*GIVEN)
    expected = np.where(found.weight > 0, found.residual, np.nan)
    np.testing.assert_array_equal(display.residual_before, expected)
    np.testing.assert_allclose(display.signals["time [s]"], found.index * robot.dt)


def test_states_velocity_is_that_of_the_model(loop):
    robot = loop.declared_
    display = ResidualDisplay.from_estimator(robot, *GIVEN)
    index = robot.residuals(*GIVEN).index
    velocity = np.gradient(GIVEN[0], robot.dt, axis=0)[index]
    error = display.signals["velocity [rad/s]"] - velocity
    assert np.median(np.abs(error)) < 0.1 * velocity.std()


def test_the_wrong_kind_of_estimator_is_refused():
    plain = LinearRegression().fit(*GIVEN)
    message = "shows a RobotIdentifier or an EffectDiscovery; got LinearRegression"
    with pytest.raises(ValueError, match=message):
        ResidualDisplay.from_estimator(plain, *GIVEN)


@pytest.mark.parametrize("joints", [[], [2], [-1]])
def test_joints_are_checked(loop, joints):
    with pytest.raises(ValueError, match="joints must be some of 0 to 1"):
        ResidualDisplay.from_estimator(loop, *GIVEN, joints=joints)


def test_plot_makes_a_row_for_each_joint(pyplot):
    display = make_display().plot()
    assert display.axes_.shape == (2, 2)
    assert display.figure_ is display.axes_[0, 0].figure
    assert display.axes_[0, 0].get_ylabel() == "a [N m]"
    assert display.axes_[1, 1].get_xlabel() == "time"
    assert len(display.figure_.legends) == 1
    low, high = display.axes_[0, 0].get_ylim()
    assert low == -high
    assert pyplot.get_fignums() == [display.figure_.number]


def test_plot_into_given_axes(pyplot):
    figure, axes = pyplot.subplots(1, 2)
    names = {"joint_names": ("a",), "units": ("N m",), "floor": None}
    display = make_display(residual_after=None, **names).plot(axes)
    assert display.figure_ is figure
    assert pyplot.get_fignums() == [figure.number]
    with pytest.raises(ValueError, match="2 x 2 axes"):
        make_display().plot(axes)


def test_artists_are_kept(pyplot):
    display = make_display().plot()
    assert len(display.lines_) == len(display.median_lines_) == 8
    assert display.axes_[0, 0] is display.lines_[0].axes


def test_plot_bears_joints_without_samples(pyplot):
    nothing = np.full((300, 2), np.nan)
    display = make_display(residual_before=nothing, residual_after=nothing).plot()
    display.figure_.canvas.draw()
    assert pyplot.get_fignums()


def test_plot_without_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match="needs matplotlib"):
        make_display().plot()


def test_running_median_follows_the_signal():
    x = np.linspace(-1, 1, 501)
    y = np.where(np.arange(501) % 50 == 0, 100.0, np.sign(x))
    x[3], y[4] = np.nan, np.nan
    centres, medians = running_median(x, y)
    assert (np.diff(centres) > 0).all()
    np.testing.assert_allclose(medians[centres < -0.1], -1)
    np.testing.assert_allclose(medians[centres > 0.1], 1)
    assert running_median(np.full(9, np.nan), x[:9])[0].size == 0


def test_torques_are_those_measured_and_predicted(loop, pyplot):
    display = TorqueDisplay.from_estimator(loop, *GIVEN, joints=[1, 0]).plot()
    found = [m.residuals(*GIVEN) for m in (loop.declared_, loop.identifier_)]
    np.testing.assert_allclose(display.time, found[0].index * loop.identifier.dt)
    shown = [line.get_ydata() for line in display.lines_]
    assert len(shown) == 6
    step = -(-len(display.time) // len(shown[0]))
    for k, joint in enumerate((1, 0)):
        expected = [found[0].torque, *(r.predicted for r in found)]
        for values, own in zip(expected, shown[3 * k : 3 * k + 3]):
            np.testing.assert_allclose(own, values[::step, joint])
    alone = TorqueDisplay.from_estimator(loop.declared_, *GIVEN)
    assert alone.after is None
    assert len(alone.plot().lines_) == 4
