"""Recorded signals on their way into a fit and a prediction, and what is refused."""

import warnings

import numpy as np
import pytest
import sklearn
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.model_selection import GroupKFold, cross_validate

pytest.importorskip("pinocchio")

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import LoadFriction, Signal

ARM = make_robot_recording(duration=12.0, dt=0.01, n_recordings=2, random_state=3)
NAMES = ARM.joint_names
TIME = ARM.dt * np.arange(ARM.n_samples)
WARM = 30 + 10 * np.sin(0.9 * TIME)
SPEED = np.gradient(ARM.q, ARM.dt, axis=0)
SLOPE, JOINT = -1.5, 1
TAU = ARM.tau.copy()
TAU[:, JOINT] += SLOPE * (WARM - 30) * SPEED[:, JOINT]
EFFECT = Signal(joint=JOINT, signal="temperature", of="viscous", reference=30.0)
GIVEN = {"temperature": WARM}


def robot(*effects, **given):
    given = {"friction": ("viscous", "coulomb"), **given}
    return RobotIdentifier(ARM.urdf, dt=ARM.dt, effects=effects, **given)


def fitted(X=ARM.q, *effects, **given):
    given = {"groups": ARM.groups, **given}
    return robot(*(effects or (EFFECT,))).fit(X, TAU, **given)


@pytest.fixture(scope="module", name="found")
def fixture_found():
    return fitted(signals=GIVEN)


def frame(**columns):
    pandas = pytest.importorskip("pandas")
    made = pandas.DataFrame(ARM.q, columns=[f"q_{name}" for name in NAMES])
    return made.assign(**columns)


def test_the_coefficient_is_found_per_unit_of_the_signal(found):
    assert found.parameter_names_[-1] == f"{NAMES[JOINT]}:signal:k"
    assert found.parameter_units_[-1] == "N m s/rad per unit of temperature"
    std = found.theta_std_[-1]
    assert std < 0.1
    assert abs(found.theta_[-1] - SLOPE) < 4 * std
    plain = robot().fit(ARM.q, TAU, groups=ARM.groups)
    args = ARM.q, TAU, ARM.groups
    with_it = found.residuals(*args, signals=GIVEN).rms()[JOINT]
    assert with_it < 0.5 * plain.residuals(*args).rms()[JOINT]


def test_a_prediction_takes_the_signal_of_its_own_motion(found):
    states = found.state_estimator_.transform(ARM.q[:400])
    cold, warm = (
        found.predict(states, signals={"temperature": np.full(400, degrees)})
        for degrees in (20.0, 40.0)
    )
    difference = warm - cold
    assert_array_equal(np.delete(difference, JOINT, axis=1), 0.0)
    speed = states[:, ARM.nv + JOINT]
    assert_allclose(difference[:, JOINT], 20.0 * found.theta_[-1] * speed, atol=1e-9)


def test_a_prediction_outside_the_fitted_signal_is_told_of(found):
    X = ARM.q[:300]
    with pytest.warns(UserWarning, match=r"signal temperature: to 60, fitted on 20 to"):
        found.predict(X, signals={"temperature": np.full(300, 60.0)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for degrees in (17.0, 30.0, 43.0):
            found.predict(X, signals={"temperature": np.full(300, degrees)})


@pytest.mark.parametrize("call", ["predict", "residuals", "effects_of_time", "score"])
def test_one_error_names_the_missing_column(found, call):
    args = (ARM.q, TAU) if call in {"residuals", "score"} else (ARM.q,)
    with pytest.raises(ValueError, match="varies with the recorded signal 'temperatu"):
        getattr(found, call)(*args)
    with pytest.raises(ValueError, match="varies with the recorded signal 'temperatu"):
        getattr(found, call)(*args, signals={"voltage": WARM})


def test_a_missing_column_is_named_in_a_fit():
    with pytest.raises(ValueError, match="the recorded signal 'temperature', which"):
        fitted()
    both = EFFECT, Signal(signal="voltage")
    with pytest.raises(ValueError, match="the recorded signal 'voltage', which"):
        fitted(ARM.q, *both, signals=GIVEN)


def test_extra_columns_of_a_frame_are_signals(found):
    X = frame(temperature=WARM, operator="me", t=TIME)[
        ["operator", *frame().columns[::-1], "temperature", "t"]
    ]
    again = fitted(X)
    assert_allclose(again.theta_, found.theta_, rtol=1e-9)
    assert again.n_features_in_ == ARM.nv
    assert_array_equal(
        again.predict(X[:300]),
        found.predict(ARM.q[:300], signals={"temperature": WARM[:300]}),
    )
    together = fitted(frame(), signals=frame(temperature=WARM)[["temperature"]])
    assert_array_equal(together.theta_, again.theta_)


def test_states_in_a_frame_leave_their_signals(found):
    pandas = pytest.importorskip("pandas")
    states = found.state_estimator_.transform(ARM.q, groups=ARM.groups)
    names = [f"{kind}_{name}" for kind in "qva" for name in NAMES]
    X = pandas.DataFrame(states, columns=names).assign(temperature=WARM)
    plain = fitted(states, signals=GIVEN)
    assert_allclose(fitted(X).theta_, plain.theta_, rtol=1e-9)


def test_it_goes_beside_an_effect_of_the_load():
    one = fitted(ARM.q, EFFECT, LoadFriction(joint=JOINT), signals=GIVEN)
    assert abs(one.theta_[-2] - SLOPE) < 0.1


def test_a_signal_in_other_units_changes_its_coefficient_alone(found):
    fahrenheit = {"temperature": 1.8 * WARM + 32}
    other = clone(EFFECT).set_params(reference=86.0)
    scaled = fitted(ARM.q, other, signals=fahrenheit)
    assert_allclose(1.8 * scaled.theta_[-1], found.theta_[-1], rtol=1e-5)
    assert_allclose(scaled.theta_[:-1], found.theta_[:-1], rtol=1e-4, atol=1e-6)


def bad_signals():
    text = np.where(TIME > 1, "warm", "cold")
    return {
        "constant": (np.full(ARM.n_samples, 21.5), r"is constant \(21\.5 in all"),
        "gaps": (np.where(TIME < 1, np.nan, WARM), "has gaps: 100 of 2400 values"),
        "infinite": (np.where(TIME < 1, np.inf, WARM), "has gaps"),
        "short": (WARM[1:], r"one value per row, \(2400,\)"),
        "wide": (np.column_stack([WARM, WARM]), "one value per row"),
        "text": (text, "holds 'cold' and not numbers"),
        "position": (
            3 - 2 * ARM.q[:, 2],
            f"is the position of {NAMES[2]} under another name: 100 %",
        ),
        "velocity": (0.1 * SPEED[:, 0] + 4, f"is the velocity of {NAMES[0]}"),
        "torque": (
            TAU[:, 3] / 7.2 + np.random.default_rng(0).normal(size=ARM.n_samples) / 50,
            f"is the torque of {NAMES[3]} under another name: 9",
        ),
        "clock": (1e3 * TIME + 1.7e12, "is a clock"),
        "rows": (np.arange(ARM.n_samples), "is a clock"),
        "time of each recording": (ARM.t, "is a clock"),
    }


@pytest.mark.parametrize("kind", bad_signals())
def test_what_is_no_condition_of_the_robot_is_refused(kind):
    values, message = bad_signals()[kind]
    with pytest.raises(ValueError, match=message):
        fitted(signals={**GIVEN, "other": values})
    with pytest.raises(ValueError, match=f"signals: 'other' .*{message}"):
        robot().fit(ARM.q, TAU, groups=ARM.groups, signals={"other": values})


def test_what_nobody_asks_for_stands_in_no_ones_way(found):
    X = frame(temperature=WARM, voltage=np.nan, label="a", copy=ARM.q[:, 0])
    assert_allclose(fitted(X).theta_, found.theta_, rtol=1e-9)
    with pytest.raises(ValueError, match="The column 'voltage' has gaps: 2400 of 2400"):
        fitted(X, Signal(signal="voltage"))
    with pytest.raises(ValueError, match="'temperature', which is a column of X"):
        fitted(X, signals=GIVEN)


@pytest.mark.parametrize("signals", [WARM, "temperature", [WARM]])
def test_signals_have_names(signals):
    with pytest.raises(ValueError, match="signals must be a mapping of names"):
        fitted(signals=signals)
    with pytest.raises(ValueError, match="names that are text"):
        fitted(signals={3: WARM})


def test_what_varies_steadily_or_with_a_period_is_accepted():
    for values in (
        WARM,
        25 + 0.3 * TIME,
        np.sign(WARM - 30),
        24 - 0.01 * TAU[:, 1] ** 2,
    ):
        robot().fit(ARM.q, TAU, groups=ARM.groups, signals={"other": values})


def test_a_frame_of_signals_is_routed_and_cut_with_the_rows(found):
    """Each fold is fitted and scored with its own rows of the frame."""
    pandas = pytest.importorskip("pandas")
    signals = pandas.DataFrame(GIVEN)
    with sklearn.config_context(enable_metadata_routing=True):
        asked = robot(EFFECT).set_fit_request(groups=True, signals=True)
        asked.set_score_request(groups=True, signals=True)
        result = cross_validate(
            asked,
            ARM.q,
            TAU,
            cv=GroupKFold(2),
            params={"groups": ARM.groups, "signals": signals},
            return_estimator=True,
            error_score="raise",
        )
    for one, score in zip(result["estimator"], result["test_score"]):
        assert one.theta_[-1] == pytest.approx(found.theta_[-1], abs=0.2)
        assert score > 0.9
