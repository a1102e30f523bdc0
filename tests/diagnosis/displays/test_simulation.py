"""What the display of simulated windows draws is what was simulated."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, load_identified
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis import (
    FailedWindow,
    SimulationDisplay,
    simulate_windows,
)

pytest.importorskip("pinocchio")


@pytest.fixture(name="pyplot")
def fixture_pyplot():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield pyplot
    pyplot.close("all")


@pytest.fixture(scope="module", name="recording")
def fixture_recording():
    return make_robot_recording(
        duration=8.0, dt=0.01, undeclared={"spring": (0, 6.0)}, random_state=2
    )


@pytest.fixture(scope="module", name="loop")
def fixture_loop(recording):
    robot = RobotIdentifier(
        recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
    )
    loop = EffectDiscovery(robot, effects=["spring"], random_state=0, alpha=0.9)
    return loop.fit(recording.q, recording.tau)


@pytest.fixture(scope="module", name="windows")
def fixture_windows(loop, recording):
    found = simulate_windows(loop.declared_, *part_of(recording), window=0.15)
    assert not found.failed.any()
    return found


def part_of(recording):
    """Positions and torques of some seconds."""
    return recording.q[:350], recording.tau[:350]


def points(line):
    """Finite points of a line, and how many pieces it has."""
    x, y = line.get_xdata(), line.get_ydata()
    known = np.isfinite(y)
    return x[known], y[known], np.count_nonzero(~known)


def test_lines_are_the_positions_in_degrees(windows, pyplot):
    display = SimulationDisplay(windows={"simulated": windows})
    assert display.plot(shown=slice(0, 3)) is display
    names = windows.joint_names
    assert len(display.axes_) == len(display.lines_) == len(names)
    assert len(display.measured_lines_) == len(names)
    for j, (ax, line) in enumerate(zip(display.axes_, display.lines_)):
        for drawn, values in (
            (line, windows.simulated),
            (display.measured_lines_[j], windows.positions),
        ):
            x, y, gaps = points(drawn)
            np.testing.assert_allclose(x, windows.t[:3].ravel())
            np.testing.assert_allclose(y, np.rad2deg(values[:3, :, j].ravel()))
            assert gaps == 3
        assert ax.get_title(loc="left") == names[j]
        assert ax.get_ylabel() == "[degrees]"
        error = np.rad2deg(np.sqrt(np.mean(windows.errors[:, j] ** 2)))
        star = "" if windows.clearly_better[j] else "*"
        title = f"rms error: {error:.3g} degrees{star}"
        assert ax.get_title(loc="right") == title
        starts = [x.get_xdata()[0] for x in ax.get_lines() if len(x.get_xdata()) == 2]
        np.testing.assert_allclose(starts, windows.t[:3, 0])
    told = display.axes_[-1].get_xlabel()
    assert told.startswith("time [s]")
    assert ("* not clearly better" in told) == (not windows.clearly_better.all())
    # One that is always right is better than both wherever they move.
    exact = windows.simulated.copy()
    exact[..., : len(names)] = windows.positions
    exact = replace(windows, simulated=exact)
    display = SimulationDisplay(windows={"exact": exact}).plot()
    assert exact.clearly_better.all()
    assert display.axes_[-1].get_xlabel() == "time [s]"
    both = SimulationDisplay(windows={"stays": windows.staying(), "exact": exact})
    titles = [ax.get_title(loc="right") for ax in both.plot().axes_]
    assert all(x.count("*") == 1 and "*, exact" in x for x in titles)
    assert "* not clearly better" in both.axes_[-1].get_xlabel()
    display = SimulationDisplay(windows={"simulated": windows}).plot()
    labels = [text.get_text() for text in display.figure_.legends[0].get_texts()]
    assert labels == ["measured", "simulated"]


def test_prismatic_joints_are_in_mm(windows, pyplot):
    slides = np.zeros(len(windows.joint_names), dtype=bool)
    slides[1] = True
    windows = replace(windows, prismatic=slides)
    display = SimulationDisplay(windows={"simulated": windows}).plot()
    assert [ax.get_ylabel() for ax in display.axes_][:3] == [
        "[degrees]",
        "[mm]",
        "[degrees]",
    ]
    _, y, _ = points(display.measured_lines_[1])
    np.testing.assert_allclose(y, 1e3 * windows.positions[:, :, 1][:16].ravel())


def test_a_discovery_shows_its_three_models(loop, recording, windows, pyplot):
    display = SimulationDisplay.from_estimator(loop, *part_of(recording), window=0.15)
    models = ["declared model", "with the four plain terms", "completed model"]
    assert list(display.windows) == models
    np.testing.assert_array_equal(
        display.windows["declared model"].simulated, windows.simulated
    )
    display.plot(line_kwargs={"lw": 3.0}, measured_kwargs={"color": "black"})
    assert len(display.lines_) == 3 * len(display.axes_)
    assert {line.get_linewidth() for line in display.lines_} == {3.0}
    assert {line.get_color() for line in display.measured_lines_} == {"black"}
    title = display.axes_[0].get_title(loc="right")
    assert all(model in title for model in models)


def test_a_robot_from_a_file_is_shown(loop, recording, windows, tmp_path):
    loop.declared_.save(tmp_path / "arm.json")
    display = SimulationDisplay.from_estimator(
        load_identified(tmp_path / "arm.json"), *part_of(recording), window=0.15
    )
    (own,) = display.windows.values()
    np.testing.assert_array_equal(own.simulated, windows.simulated)


def failing(windows):
    """Let the second window fail, and the third run away."""
    simulated = windows.simulated.copy()
    simulated[1] = np.nan
    simulated[2, -5:] = 1e6
    failure = FailedWindow(window=1, time=0.5, message="it diverges")
    return replace(windows, simulated=simulated, failures=(failure,))


def test_windows_that_failed_are_shaded_and_no_part_of_the_error(windows, pyplot):
    windows = failing(windows)
    display = SimulationDisplay(windows={"simulated": windows}).plot()
    kept = windows.errors[~windows.failed]
    for j, ax in enumerate(display.axes_):
        (span,) = ax.patches
        left, right = span.get_extents().transformed(ax.transData.inverted()).intervalx
        np.testing.assert_allclose([left, right], windows.t[1, [0, -1]])
        error = np.rad2deg(np.sqrt(np.mean(kept[:, j] ** 2)))
        assert f"{error:.3g}" in ax.get_title(loc="right")
        # What runs away does not flatten the measured motion.
        low, high = ax.get_ylim()
        shown = np.ptp(np.rad2deg(windows.positions[:16, :, j]))
        assert shown < high - low < 2.5 * shown
    labels = [text.get_text() for text in display.figure_.legends[0].get_texts()]
    assert labels == ["measured", "simulated", "simulation failed"]
    told = f"1 of {windows.n_windows} windows failed, not in these errors"
    assert told in display.axes_[-1].get_xlabel()


def test_nothing_but_failures_has_no_error(windows, pyplot):
    windows = replace(windows, simulated=np.full_like(windows.simulated, np.nan))
    display = SimulationDisplay(windows={"simulated": windows}).plot()
    assert display.axes_[0].get_title(loc="right") == "rms error: none"


def test_axes_may_be_given(windows, pyplot):
    figure, axes = pyplot.subplots(3, 2)
    display = SimulationDisplay(windows={"simulated": windows}).plot(ax=axes)
    assert display.figure_ is figure
    with pytest.raises(ValueError, match="ax must hold 6 axes, one for each joint"):
        display.plot(ax=axes[0])


@pytest.mark.parametrize("shown", [[], [-1], [1000], slice(900, 910)])
def test_windows_that_are_not_there_are_refused(shown, windows, pyplot):
    display = SimulationDisplay(windows={"simulated": windows})
    with pytest.raises(ValueError, match="shown must choose some of the windows 0 to"):
        display.plot(shown=shown)


def test_what_is_no_robot_is_refused(recording):
    with pytest.raises(TypeError, match="SimulationDisplay shows a RobotIdentifier"):
        SimulationDisplay.from_estimator(LinearRegression(), recording.q, recording.tau)
    with pytest.raises(NotFittedError):
        SimulationDisplay.from_estimator(
            RobotIdentifier(recording.urdf, friction=("viscous",)),
            recording.q,
            recording.tau,
        )
