import sys

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import ResidualDisplay, TorqueDisplay
from tests.diagnosis._recordings import SPRINGY


@pytest.fixture(name="pyplot")
def fixture_pyplot():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as pyplot

    yield pyplot
    pyplot.close("all")


# Positions and torques of the searched recording.
DATA = SPRINGY.position, SPRINGY.torque


def make_display(kind=TorqueDisplay, **changes):
    rng = np.random.default_rng(0)
    values = {
        "time": np.arange(300.0),
        "measured": rng.standard_normal((300, 2)),
        "before": rng.standard_normal((300, 2)),
        "after": rng.standard_normal((300, 2)),
        "joint_names": ("a", "b"),
        "units": ("N m", "N"),
    }
    return kind(**(values | changes))


@pytest.mark.parametrize("kind", [ResidualDisplay, TorqueDisplay])
def test_displays_show_before_and_after(kind, springy, pyplot):
    display = kind.from_estimator(springy, *DATA, joints=[1, 0]).plot()
    assert display.joint_names == ("joint_2", "joint_1")
    results = [m.residuals(*DATA) for m in (springy.declared_, springy.identifier_)]
    expected = [(r.predicted, r.residual) for r in results]
    if kind is TorqueDisplay:
        time = results[0].index * springy.identifier.dt
        torques = (results[0].torque, *(r.predicted for r in results))
        expected = [(time[:, None] + 0.0 * x, x) for x in torques]
    shown = [line.get_data() for line in display.lines_]
    assert len(shown) == 2 * len(expected)
    step = -(-len(display.time) // len(shown[0][0]))
    for k, joint in enumerate((1, 0)):
        for values, lines in zip(expected, shown[k * len(expected) :]):
            for value, drawn in zip(values, lines):
                np.testing.assert_allclose(drawn, value[::step, joint], atol=1e-12)


def test_display_of_an_identifier_shows_one_model(springy, pyplot):
    display = ResidualDisplay.from_estimator(springy.declared_, *DATA)
    assert display.after is None
    assert len(display.plot().lines_) == 2


def test_plot_draws_one_row_per_joint(pyplot):
    display = make_display(ResidualDisplay).plot()
    assert display.axes_.shape == (2,)
    assert display.axes_[0].get_ylabel() == "a [N m]"
    assert display.axes_[1].get_xlabel() == "predicted torque"
    assert pyplot.get_fignums() == [display.figure_.number]


def test_plot_into_given_axes(pyplot):
    figure, axes = pyplot.subplots(1, 2)
    display = make_display().plot(axes)
    assert display.figure_ is figure
    assert display.axes_[0] is display.lines_[0].axes
    assert pyplot.get_fignums() == [figure.number]
    with pytest.raises(ValueError, match="2 axes, one a joint; got 1"):
        make_display().plot(axes[0])


def test_plot_without_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match="needs matplotlib"):
        make_display().plot()
