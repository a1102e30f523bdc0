"""What the displays of noise, parameters and convergence draw is what the model has."""

import itertools
import subprocess
import sys

import numpy as np
import pytest
from scipy import stats
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_vbjfa import (
    EffectDiscovery,
    JFARegressor,
    RigidBodyFeatures,
    RobotIdentifier,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.diagnosis import (
    ConvergenceDisplay,
    NoiseDisplay,
    ParameterDisplay,
)

DISPLAYS = [ConvergenceDisplay, NoiseDisplay, ParameterDisplay]


@pytest.fixture(name="pyplot")
def fixture_pyplot():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    pyplot = pytest.importorskip("matplotlib.pyplot")
    yield pyplot
    pyplot.close("all")


@pytest.fixture(scope="module", name="recording")
def fixture_recording():
    pytest.importorskip("pinocchio")
    return load_demo_recording()


@pytest.fixture(scope="module", name="robot")
def fixture_robot(recording):
    robot = RobotIdentifier(
        recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
    )
    return robot.fit(recording.q, recording.tau, groups=recording.groups)


@pytest.fixture(scope="module", name="data")
def fixture_data():
    """Four inputs of which a fifth is noise; the last one has no effect."""
    rng = np.random.default_rng(0)
    t = rng.normal(size=(2000, 4)) * [1.0, 10.0, 0.1, 1.0]
    y = t @ [1.0, -0.2, 30.0, 0.0] + 0.1 * rng.normal(size=2000)
    return t + 0.5 * t.std(axis=0) * rng.normal(size=t.shape), y


@pytest.fixture(scope="module", name="regressor", params=["correlated", "independent"])
def fixture_regressor(request, data):
    return VBJFARegressor(latent=request.param, input_noise=0.2).fit(*data)


def drawn(ax, label):
    """Horizontal values and rows of the marks with a label, in the order of rows."""
    lines = [line for line in ax.get_lines() if line.get_label() == label]
    x = np.concatenate([line.get_xdata() for line in lines])
    y = np.concatenate([line.get_ydata() for line in lines])
    order = np.argsort(y, kind="stable")
    return np.asarray(x)[order], np.rint(y[order]).astype(int)


def intervals(ax):
    """Read the ends of the intervals, ndarray of shape (rows, 2)."""
    segments = [s for c in ax.collections for s in c.get_segments()]
    return np.array([segment[:, 0] for segment in segments])


def row_names(ax):
    return [label.get_text() for label in ax.get_yticklabels()]


# -- noise ----------------------------------------------------------------------------


def test_noise_of_a_robot_is_drawn_as_it_is(robot, pyplot):
    display = NoiseDisplay.from_estimator(robot).plot()
    torque, position = display.axes_
    for label, attribute in (
        ("output noise", "output_noise_"),
        ("noise floor", "noise_floor_"),
        ("torque noise", "torque_noise_"),
        ("input noise", "input_noise_torque_"),
    ):
        values, rows = drawn(torque, label)
        np.testing.assert_array_equal(values, getattr(robot, attribute))
        np.testing.assert_array_equal(rows, np.arange(6))
    values, _ = drawn(position, "position noise")
    np.testing.assert_allclose(values**2, robot.state_estimator_.noise_variance_)
    # the recording's encoders have 1e-4 rad
    np.testing.assert_allclose(values, 1e-4, rtol=0.1)
    assert row_names(torque) == list(robot.joint_names_)
    assert torque.get_xlabel() == "standard deviation [N m]"
    assert position.get_xlabel() == "standard deviation [rad]"
    assert torque.get_xscale() == "log"
    assert display.figure_ is torque.figure


def test_noise_of_a_robot_fitted_to_states_has_no_positions(recording, pyplot):
    rows = recording.groups == 0
    robot = RobotIdentifier(recording.urdf, friction=("viscous",))
    robot.fit(recording.states[rows], recording.tau[rows])
    display = NoiseDisplay.from_estimator(robot).plot()
    assert list(display.panels) == ["N m"]
    assert "position noise" not in display.noise


def test_noise_of_a_regressor_is_a_share_of_the_variance(regressor, data, pyplot):
    X, y = data
    display = NoiseDisplay.from_estimator(regressor).plot()
    (ax,) = display.axes_
    values, _ = drawn(ax, "noise")
    np.testing.assert_allclose(values[:4], 0.2, rtol=1e-6)
    assert values[4] == pytest.approx(regressor.output_noise_ / y.var())
    assert row_names(ax) == ["x0", "x1", "x2", "x3", "output"]
    noise = np.asarray(regressor.input_noise_)
    noise = np.diagonal(noise) if noise.ndim == 2 else noise
    np.testing.assert_allclose(values[:4] * X.var(axis=0), noise)


def test_noise_of_a_regressor_in_units(regressor, pyplot):
    units = ["m", "V", "m", "V", "N"]
    display = NoiseDisplay.from_estimator(regressor, units=units).plot(log=False)
    noise = np.asarray(regressor.input_noise_)
    noise = np.diagonal(noise) if noise.ndim == 2 else noise
    expected = {"m": noise[[0, 2]], "V": noise[[1, 3]], "N": regressor.output_noise_}
    assert len(display.axes_) == 3
    for ax, (unit, variance) in zip(display.axes_, expected.items()):
        np.testing.assert_allclose(drawn(ax, "noise")[0] ** 2, variance)
        assert ax.get_xlabel() == f"standard deviation [{unit}]"
        assert ax.get_xscale() == "linear"


def test_uncentred_noise_is_a_share_of_the_mean_square(data):
    X, y = data[0] + 3.0, data[1]
    model = JFARegressor(fit_intercept=False, input_noise=0.1).fit(X, y)
    shares = NoiseDisplay.from_estimator(model).noise["noise"]
    np.testing.assert_allclose(shares[:4], model.input_noise_ / np.mean(X**2, axis=0))


def test_joints_of_both_kinds_are_in_panels_of_their_own(pyplot):
    pin = pytest.importorskip("pinocchio")
    model = pin.Model()
    for kind, name in ((pin.JointModelRY(), "turns"), (pin.JointModelPX(), "slides")):
        number = model.addJoint(model.njoints - 1, kind, pin.SE3.Identity(), name)
        model.inertias[number] = pin.Inertia(
            2.0, np.array([0.1, 0.0, 0.3]), np.diag([0.1, 0.1, 0.05])
        )
    rng = np.random.default_rng(0)
    states = rng.normal(size=(400, 6))
    features = RigidBodyFeatures(model).fit(states)
    theta = rng.uniform(1.0, 2.0, size=22)
    tau = features.transform(states).reshape(400, 2, 22) @ theta
    robot = RobotIdentifier(model, projector=None, friction=("viscous",))
    robot.fit(states, tau + [0.1, 5.0] * rng.normal(size=(400, 2)))
    display = NoiseDisplay.from_estimator(robot).plot()
    assert {unit: rows.tolist() for unit, rows in display.panels.items()} == {
        "N m": [0],
        "N": [1],
    }
    for j, ax in enumerate(display.axes_):
        assert row_names(ax) == [("turns", "slides")[j]]
        np.testing.assert_array_equal(
            drawn(ax, "output noise")[0], robot.output_noise_[[j]]
        )
    np.testing.assert_allclose(robot.output_noise_, [0.1, 5.0], rtol=0.15)
    shown = ParameterDisplay.from_estimator(robot).panels
    assert [unit for joint, unit, _ in shown if joint == "slides"][-1] == "N s/m"


def test_noise_that_is_not_known_is_not_drawn(pyplot):
    display = NoiseDisplay(
        noise={"a": [np.nan, np.nan], "b": [0.0, 0.2]},
        units={"a": ["N", "N"], "b": ["N", "N"]},
        names=["one", "two"],
    ).plot()
    display.figure_.canvas.draw()
    low, high = display.axes_[0].get_xlim()
    assert low < 0 < 0.2 < high


# -- parameters -----------------------------------------------------------------------


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_parameters_of_a_robot_are_drawn_as_they_are(robot, recording, level, pyplot):
    truth = recording.theta(robot.friction)
    display = ParameterDisplay.from_estimator(robot, nominal=truth).plot(level=level)
    assert len(display.axes_) == 30  # six joints, five units
    shown = []
    width = stats.norm.ppf(0.5 + level / 2)
    for ax, (joint, unit, rows) in zip(display.axes_, display.panels):
        shown += rows
        assert {robot.parameter_units_[i] for i in rows} == {unit}
        assert ax.get_xlabel() == f"[{unit}]"
        assert ax.get_title(loc="left") == joint
        assert [f"{joint}:{name}" for name in row_names(ax)] == [
            robot.parameter_names_[i] for i in rows
        ]
        open_ = ~robot.identifiable_[rows]
        for key, label, values in (
            ("estimate", "projected", robot.theta_),
            ("second", "before the projection", robot.theta_unconstrained_),
        ):
            for hollow, chosen in ((False, ~open_), (True, open_)):
                if not chosen.any():
                    continue
                found, place = drawn(ax, "_hollow " + key if hollow else label)
                np.testing.assert_array_equal(found, values[rows][chosen])
                np.testing.assert_array_equal(place, np.flatnonzero(chosen))
        np.testing.assert_array_equal(drawn(ax, "nominal")[0], truth[rows])
        half = width * robot.theta_std_[rows]
        known = np.isfinite(half)
        middle = robot.theta_unconstrained_[rows][known]
        expected = np.column_stack([middle - half[known], middle + half[known]])
        found = intervals(ax)
        np.testing.assert_allclose(found.reshape(-1, 2), expected)
        colours = [label.get_color() for label in ax.get_yticklabels()]
        assert [colour == "0.55" for colour in colours] == open_.tolist()
    assert sorted(shown) == list(range(72))


def test_hollow_marks_are_hollow(robot, pyplot):
    display = ParameterDisplay.from_estimator(robot, parameters=["joint_2"]).plot()
    ax = display.axes_[2]
    faces = {
        line.get_label(): line.get_markerfacecolor()
        for line in ax.get_lines()
        if "projected" in line.get_label() or "estimate" in line.get_label()
    }
    assert faces["_hollow estimate"] == "white"
    assert faces["projected"] != "white"
    texts = [text.get_text() for text in display.figure_.legends[0].get_texts()]
    assert "not identifiable alone" in texts
    assert len(texts) == len(set(texts)) == 4  # no nominal values were given


def test_an_identifier_without_projection_has_one_estimate(recording, pyplot):
    rows = recording.groups == 0
    robot = RobotIdentifier(recording.urdf, projector=None, friction=("viscous",))
    robot.fit(recording.states[rows], recording.tau[rows])
    display = ParameterDisplay.from_estimator(robot).plot()
    assert display.second is None
    np.testing.assert_array_equal(display.estimate, robot.theta_)
    ax = display.axes_[3]  # viscous friction of the first joint
    (low, high), middle = intervals(ax)[0], robot.theta_[10]
    assert (low + high) / 2 == pytest.approx(middle)


def test_parameters_of_a_regressor(regressor, pyplot):
    display = ParameterDisplay.from_estimator(regressor, nominal=[1, -0.2, 30, np.nan])
    assert display.panels == [("", "", [0, 1, 2, 3])]
    display.plot()
    (ax,) = display.axes_
    relevant = regressor.relevant_
    assert relevant.tolist() == [True, True, True, False]
    found, _ = drawn(ax, "noiseless queries")
    np.testing.assert_array_equal(found, regressor.coef_[relevant])
    found, _ = drawn(ax, "noisy queries")
    np.testing.assert_array_equal(found, regressor.coef_noisy_[relevant])
    found, _ = drawn(ax, "_hollow estimate")
    np.testing.assert_array_equal(found, regressor.coef_[~relevant])
    half = stats.norm.ppf(0.975) * regressor.coef_std_
    expected = np.column_stack([regressor.coef_ - half, regressor.coef_ + half])
    np.testing.assert_allclose(intervals(ax), expected)
    assert ax.get_xlabel() == "coefficient"


def test_coefficients_in_units_have_panels_of_their_own(regressor):
    display = ParameterDisplay.from_estimator(regressor, units=["a", "b", "a", "c"])
    assert display.panels == [("", "a", [0, 2]), ("", "b", [1]), ("", "c", [3])]


def test_any_linear_regressor_has_parameters(data, pyplot):
    model = Ridge().fit(*data)
    display = ParameterDisplay.from_estimator(model).plot()
    np.testing.assert_array_equal(
        drawn(display.axes_[0], "coefficient")[0], model.coef_
    )
    assert not display.axes_[0].collections


def test_many_parameters_go_on_in_further_axes(pyplot):
    display = ParameterDisplay(
        estimate=np.arange(100.0),
        names=[f"a long name of the input number {i}" for i in range(100)],
        units=[""] * 100,
    ).plot()
    assert len(display.axes_) == 3
    found = [drawn(ax, "estimate")[0] for ax in display.axes_]
    np.testing.assert_array_equal(np.concatenate(found), np.arange(100))
    assert len({ax.get_xlim() for ax in display.axes_}) == 1
    display.figure_.canvas.draw()
    # no axes is squeezed away by the names
    assert min(ax.get_window_extent().width for ax in display.axes_) > 50


def test_names_do_not_overlap(robot, pyplot):
    display = ParameterDisplay.from_estimator(robot).plot()
    display.figure_.canvas.draw()
    for ax in display.axes_:
        boxes = [t.get_window_extent() for t in ax.get_yticklabels()]
        boxes.sort(key=lambda box: box.y0)
        for below, above in itertools.pairwise(boxes):
            assert below.y1 <= above.y0 + 1


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ("joint_2:m", [12]),
        (["joint_1"], list(range(12))),
        ([3, 1], [1, 3]),
        (7, [7]),
        (np.arange(72) == 5, [5]),
    ],
)
def test_parameters_are_chosen(robot, parameters, expected):
    display = ParameterDisplay.from_estimator(robot, parameters=parameters)
    np.testing.assert_array_equal(display.estimate, robot.theta_[expected])
    assert display.names == tuple(robot.parameter_names_[i] for i in expected)


@pytest.mark.parametrize(
    "parameters", ["joint_7", [72], [-1], [True], ["joint_1", "mass"]]
)
def test_parameters_that_do_not_exist_are_refused(robot, parameters):
    with pytest.raises(ValueError, match="names, joints, numbers from 0 to 71"):
        ParameterDisplay.from_estimator(robot, parameters=parameters)


def test_no_parameters_are_refused(robot):
    with pytest.raises(ValueError, match="at least one"):
        ParameterDisplay.from_estimator(robot, parameters=[])


# -- convergence ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "quantity"),
    [
        (VBJFARegressor(latent="correlated"), "lower bound"),
        (VBJFARegressor(latent="independent"), "lower bound"),
        (JFARegressor(input_noise=0.2), "log-likelihood"),
    ],
    ids=["correlated", "independent", "em"],
)
def test_convergence_is_drawn_as_it_was(model, quantity, data, pyplot):
    model.fit(*data)
    display = ConvergenceDisplay.from_estimator(model).plot()
    assert display.quantity == quantity
    bound, gain = display.axes_
    (line,) = bound.get_lines()
    np.testing.assert_array_equal(line.get_ydata(), model.elbo_history_)
    np.testing.assert_array_equal(
        line.get_xdata(), np.arange(1, model.elbo_history_.size + 1)
    )
    assert line.get_label() == (
        f"{type(model).__name__}, {model.n_iter_} iterations, converged"
    )
    curve, limit = gain.get_lines()
    gains = np.diff(model.elbo_history_) / 2000
    np.testing.assert_allclose(curve.get_ydata(), gains[gains > 0])
    assert set(limit.get_ydata()) == {model.tol}
    assert gain.get_yscale() == "log"


def test_convergence_of_a_robot_is_that_of_its_regressor(robot, pyplot):
    history = robot.estimator_.regressor_.elbo_history_
    display = ConvergenceDisplay.from_estimator(robot, name="arm")
    np.testing.assert_array_equal(display.history, history)
    _, ax = pyplot.subplots()
    display.plot(ax)
    assert display.axes_.tolist() == [ax]
    assert ax.get_lines()[0].get_label().startswith("arm, ")


def test_convergence_says_when_it_stopped_early(data):
    with pytest.warns(match="stopped after max_iter=1"):
        model = VBJFARegressor(max_iter=1).fit(*data)
    display = ConvergenceDisplay.from_estimator(model)
    assert display.converged is False
    assert display.gains().size == 0


def test_a_single_iteration_can_be_drawn(pyplot):
    display = ConvergenceDisplay(history=[-3.0], n_samples=5.0, tol=1e-3).plot()
    display.figure_.canvas.draw()
    assert display.axes_[1].get_yscale() == "linear"


def test_convergence_of_a_constant_output_is_refused(data):
    model = VBJFARegressor().fit(data[0], np.ones(2000))
    with pytest.raises(ValueError, match="did not iterate"):
        ConvergenceDisplay.from_estimator(model)


# -- what they share ------------------------------------------------------------------


@pytest.mark.parametrize("display", DISPLAYS)
def test_a_discovery_shows_its_completed_model(display, robot, pyplot):
    loop = EffectDiscovery(robot)
    loop.identifier_ = robot  # what fit leaves
    one, other = map(display.from_estimator, (loop, robot))
    for name, value in vars(other).items():
        np.testing.assert_equal(getattr(one, name), value)


@pytest.mark.parametrize("display", DISPLAYS)
@pytest.mark.parametrize(
    "estimator",
    [
        VBJFARegressor(),
        RobotIdentifier("arm.urdf", friction=("viscous",)),
        LinearRegression(),
    ],
    ids=lambda e: type(e).__name__,
)
def test_not_fitted(display, estimator):
    with pytest.raises(NotFittedError, match="not fitted yet"):
        display.from_estimator(estimator)


@pytest.mark.parametrize("display", DISPLAYS)
def test_wrong_kind(display, data):
    pipeline = make_pipeline(StandardScaler(), VBJFARegressor()).fit(*data)
    message = f"^{display.__name__} shows .*; got Pipeline, which has no "
    with pytest.raises(ValueError, match=message):
        display.from_estimator(pipeline)
    with pytest.raises(TypeError, match="not an estimator"):
        display.from_estimator("model")


def test_wrong_kind_that_is_a_regressor(data):
    plain = LinearRegression().fit(*data)
    for display in (NoiseDisplay, ConvergenceDisplay):
        with pytest.raises(ValueError, match="got LinearRegression, which has no"):
            display.from_estimator(plain)
    several = LinearRegression().fit(data[0], np.column_stack([data[1]] * 2))
    with pytest.raises(ValueError, match=r"one output, shape \(4,\); got \(2, 4\)"):
        ParameterDisplay.from_estimator(several)


def test_wrong_units_and_nominal_values(robot, regressor):
    with pytest.raises(ValueError, match="units must hold 5 strings"):
        NoiseDisplay.from_estimator(regressor, units=["m"] * 4)
    with pytest.raises(ValueError, match="units must hold 4 strings"):
        ParameterDisplay.from_estimator(regressor, units="m")
    for display in (NoiseDisplay, ParameterDisplay):
        with pytest.raises(ValueError, match="units must be None for RobotIdentifier"):
            display.from_estimator(robot, units=["N"] * 6)
    with pytest.raises(ValueError, match="nominal must hold 72 values"):
        ParameterDisplay.from_estimator(robot, nominal=np.ones(71))


def test_noise_without_variances_asks_for_units():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(20, 300))
    model = JFARegressor(input_noise=0.1, tol=1e-4)
    model.fit(X, X[:, 0] + rng.normal(size=20))
    assert model.statistics_ is None
    with pytest.raises(ValueError, match="give units"):
        NoiseDisplay.from_estimator(model)
    display = NoiseDisplay.from_estimator(model, units=["1"] * 301)
    np.testing.assert_allclose(display.noise["noise"][:300] ** 2, model.input_noise_)


@pytest.mark.parametrize("level", [0.0, 1.0, 95])
def test_level_is_a_probability(robot, level):
    with pytest.raises(ValueError, match="level must be between 0 and 1"):
        ParameterDisplay.from_estimator(robot).plot(level=level)


def test_plot_into_given_axes(robot, pyplot):
    figure, axes = pyplot.subplots(1, 2)
    display = NoiseDisplay.from_estimator(robot).plot(axes)
    assert display.figure_ is figure
    assert display.axes_.tolist() == axes.tolist()
    with pytest.raises(ValueError, match=r"ax must hold 30 axes.*got 2"):
        ParameterDisplay.from_estimator(robot).plot(axes)
    with pytest.raises(ValueError, match=r"2 axes, one a unit \(N m, rad\); got 1"):
        NoiseDisplay.from_estimator(robot).plot(axes[0])
    with pytest.raises(ValueError, match="1 or 2 axes, the bound and its gains; got 3"):
        ConvergenceDisplay.from_estimator(robot).plot([*axes, axes[0]])
    assert pyplot.get_fignums() == [figure.number]


def test_artists_are_kept_and_take_styles(robot, pyplot):
    style = {"color": "red"}
    noise = NoiseDisplay.from_estimator(robot).plot(line_kwargs=style)
    assert [line.get_label() for line in noise.lines_] == list(noise.noise)
    assert {line.get_color() for line in noise.lines_} == {"red"}
    convergence = ConvergenceDisplay.from_estimator(robot).plot(line_kwargs=style)
    bound, gains = convergence.axes_
    assert convergence.line_.axes is bound
    assert convergence.gain_line_.axes is convergence.tol_line_.axes is gains
    assert convergence.line_.get_color() == convergence.gain_line_.get_color() == "red"
    _, ax = pyplot.subplots()
    assert ConvergenceDisplay(history=[1.0, 2.0]).plot(ax).gain_line_ is None
    parameters = ParameterDisplay.from_estimator(robot, parameters="joint_2").plot(
        line_kwargs={"ms": 9}, interval_kwargs={"lw": 4}
    )
    assert {line.get_markersize() for line in parameters.lines_} == {9}
    widths = [lines.get_linewidth() for lines in parameters.intervals_]
    assert set(np.concatenate(widths)) == {4}


def test_what_is_unknown_everywhere_has_no_legend(pyplot):
    display = NoiseDisplay(
        noise={"a": [np.nan, np.nan], "b": [0.1, 0.2], "c": [0.3, np.nan]},
        units={key: ["N", "N"] for key in "abc"},
        names=["one", "two"],
    ).plot()
    (legend,) = display.figure_.legends
    assert [text.get_text() for text in legend.get_texts()] == ["b", "c"]


@pytest.mark.parametrize("display", DISPLAYS)
def test_plot_without_matplotlib(display, robot, monkeypatch):
    shown = display.from_estimator(robot)
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match=f"{display.__name__}.plot needs matplotlib"):
        shown.plot()


def test_importing_the_displays_loads_no_matplotlib():
    code = (
        "import sys, sklearn_vbjfa.diagnosis as d; d.NoiseDisplay; "
        "print(*({'matplotlib', 'pinocchio'} & sys.modules.keys()))"
    )
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stdout.strip()) == (0, ""), result.stderr
