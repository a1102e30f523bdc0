"""Recorded signals in fits and predictions, and invalid signals."""

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


def robot(*effects, **settings):
    settings = {"friction": ("viscous", "coulomb"), **settings}
    return RobotIdentifier(ARM.urdf, dt=ARM.dt, effects=effects, **settings)


def fitted(X=ARM.q, *effects, **settings):
    settings = {"groups": ARM.groups, **settings}
    return robot(*(effects or (EFFECT,))).fit(X, TAU, **settings)


@pytest.fixture(scope="module", name="model")
def fixture_model():
    return fitted(signals=GIVEN)


def frame(**columns):
    import pandas

    positions = pandas.DataFrame(ARM.q, columns=[f"q_{name}" for name in NAMES])
    return positions.assign(**columns)


def test_coefficient_per_unit_of_the_signal(model):
    assert model.parameter_names_[-1] == f"{NAMES[JOINT]}:signal:k"
    assert model.parameter_units_[-1] == "N m s/rad per unit of temperature"
    std = model.theta_std_[-1]
    assert std < 0.1
    assert abs(model.theta_[-1] - SLOPE) < 4 * std
    plain = robot().fit(ARM.q, TAU, groups=ARM.groups)
    args = ARM.q, TAU, ARM.groups
    with_it = model.residuals(*args, signals=GIVEN).rms()[JOINT]
    assert with_it < 0.5 * plain.residuals(*args).rms()[JOINT]


def test_predictions_use_the_given_signals(model):
    states = model.state_estimator_.transform(ARM.q[:400])
    cold, warm = (
        model.predict(states, signals={"temperature": np.full(400, degrees)})
        for degrees in (20.0, 40.0)
    )
    difference = warm - cold
    assert_array_equal(np.delete(difference, JOINT, axis=1), 0.0)
    speed = states[:, ARM.nv + JOINT]
    assert_allclose(difference[:, JOINT], 20.0 * model.theta_[-1] * speed, atol=1e-9)


@pytest.mark.parametrize("call", ["predict", "residuals", "score"])
def test_missing_signal_is_named(model, call):
    args = (ARM.q, TAU) if call in {"residuals", "score"} else (ARM.q,)
    with pytest.raises(ValueError, match="signal 'temperature', which an effect needs"):
        getattr(model, call)(*args)
    with pytest.raises(ValueError, match="signal 'temperature', which an effect needs"):
        getattr(model, call)(*args, signals={"voltage": WARM})


def test_extra_data_frame_columns_are_signals(model):
    X = frame(temperature=WARM, operator="me", t=TIME)[
        ["operator", *frame().columns[::-1], "temperature", "t"]
    ]
    other = fitted(X)
    assert_allclose(other.theta_, model.theta_, rtol=1e-9)
    assert other.n_features_in_ == ARM.nv
    assert_array_equal(
        other.predict(X[:300]),
        model.predict(ARM.q[:300], signals={"temperature": WARM[:300]}),
    )
    separate = fitted(frame(), signals=frame(temperature=WARM)[["temperature"]])
    assert_array_equal(separate.theta_, other.theta_)


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
def test_channels_and_clocks_are_refused_as_signals(kind):
    values, message = bad_signals()[kind]
    with pytest.raises(ValueError, match=message):
        fitted(signals={**GIVEN, "other": values})
    with pytest.raises(ValueError, match=f"signals: 'other' .*{message}"):
        robot().fit(ARM.q, TAU, groups=ARM.groups, signals={"other": values})


@pytest.mark.parametrize("signals", [WARM, "temperature", [WARM]])
def test_signals_need_names(signals):
    with pytest.raises(ValueError, match="signals must be a mapping of names"):
        fitted(signals=signals)
    with pytest.raises(ValueError, match="names that are text"):
        fitted(signals={3: WARM})
