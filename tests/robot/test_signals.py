"""Recorded signals on their way into a fit and a prediction, and what is refused."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.effects import Signal

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
    import pandas

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


@pytest.mark.parametrize("call", ["predict", "residuals", "score"])
def test_one_error_names_the_missing_column(found, call):
    args = (ARM.q, TAU) if call in {"residuals", "score"} else (ARM.q,)
    with pytest.raises(ValueError, match="signal 'temperature', which an effect needs"):
        getattr(found, call)(*args)
    with pytest.raises(ValueError, match="signal 'temperature', which an effect needs"):
        getattr(found, call)(*args, signals={"voltage": WARM})


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


@pytest.mark.parametrize("signals", [WARM, "temperature", [WARM]])
def test_signals_have_names(signals):
    with pytest.raises(ValueError, match="signals must be a mapping of names"):
        fitted(signals=signals)
    with pytest.raises(ValueError, match="names that are text"):
        fitted(signals={3: WARM})
