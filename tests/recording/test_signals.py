"""Selection of recorded signals: columns accepted as conditions, and rejections."""

import numpy as np
import pytest

from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.effects import OfSignals
from sklearn_vbjfa.recording import (
    OfferedSignals,
    fault,
    positions_and_signals,
    scan_signals,
    take_arrays,
)

DT, N = 0.01, 2000
T = DT * np.arange(N)
HIP, KNEE = 2 * T, 3.1 * T + 1
Q = np.column_stack(
    [np.sin(HIP) + 0.4 * np.cos(7.3 * T), np.sin(KNEE) + 0.2 * np.sin(9 * T)]
)
V = np.column_stack(
    [2 * np.cos(HIP) - 2.92 * np.sin(7.3 * T), 3.1 * np.cos(KNEE) + 1.8 * np.cos(9 * T)]
)
A = np.gradient(V, DT, axis=0)
TAU = 0.3 * A + 4 * np.sign(V) + 5 * np.sin(Q)
GROUPS = np.repeat([0, 1], N // 2)
RNG = np.random.default_rng(0)
NOISE = RNG.normal(size=N)
WARM = 30 + 10 * np.sin(0.5 * T)


def record(**changed):
    X = changed.pop("X", Q)
    keywords = {"dt": DT, "joint_names": ("hip", "knee"), **changed}
    return take_arrays(X, TAU, GROUPS, **keywords)


STATES = record(X=np.hstack([Q, V, A]))
MEASURED = record()
CHANNELS = {
    "position of knee": Q[:, 1],
    "velocity of hip": V[:, 0],
    "acceleration of knee": A[:, 1],
    "torque of hip": TAU[:, 0],
}


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("recording", [MEASURED, STATES], ids=["positions", "states"])
def test_copies_of_channels_are_rejected(channel, recording):
    message = f"is the {channel} under another name"
    assert message in fault(CHANNELS[channel], recording)
    assert message in fault(-7e3 * CHANNELS[channel] + 1e4, recording)
    noisy = CHANNELS[channel] + 0.1 * CHANNELS[channel].std() * NOISE
    assert message in fault(noisy, recording)


@pytest.mark.parametrize("channel", CHANNELS)
def test_correlated_signals_are_rejected_unless_requested(channel):
    values = CHANNELS[channel]
    correlated = values + 0.5 * values.std() * np.sin(23 * T)
    if channel.startswith(("velocity", "acceleration")):
        correlated = values + 0.5 * values.std() * np.sin(1.1 * T)
    message = fault(correlated, STATES, 0.8)
    assert f"follows the {channel}" in message
    assert "ask for it by name" in message
    assert fault(correlated, STATES) == ""


SIGNALS = {
    "cycles": WARM,
    "ramp": 20 + 0.4 * T + 0.1 * NOISE,
    "warming": 40 - 20 * np.exp(-T / 5),
    "steps": np.floor(T / 3) % 2,
    "recording": GROUPS.astype(float),
    "sag": 24 - 0.02 * (TAU * V).sum(axis=1),
    "noise": NOISE,
}


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("recording", [MEASURED, STATES], ids=["positions", "states"])
def test_conditions_of_a_robot_are_accepted(name, recording):
    assert fault(SIGNALS[name], recording, 0.8) == ""


@pytest.mark.parametrize(
    "values",
    [
        T,
        T + 1.7e9,
        1e3 * T,
        1e9 * T,
        T / 60,
        np.arange(N),
        np.tile(T[: N // 2], 2),
        T + 0.2 * DT * NOISE.clip(-2, 2),
    ],
    ids=["s", "epoch", "ms", "ns", "min", "rows", "each", "jitter"],
)
def test_clocks_are_rejected(values):
    assert fault(np.asarray(values, dtype=float), MEASURED).startswith("is a clock")


class Uses(OfSignals):
    """An effect that varies with some signals."""

    def __init__(self, *recorded):
        self.recorded = recorded


def test_offered_signals_are_used_or_reported():
    offered = OfferedSignals(
        label=np.full(N, "a"),
        warm=WARM,
        torque=TAU[:, 0],
        gap=np.where(T > 1, T, np.nan),
    )
    signals, findings = scan_signals(None, offered, MEASURED, (Uses(),))
    assert list(signals) == ["warm"]
    (one,) = findings
    names = "Column(s) 'label', 'torque', 'gap' are not used as signals: "
    assert one.message.startswith(names + "'label' holds 'a' and not numbers; 'torque'")
    assert (one.kind, one.joints, one.severity) == ("unusable_signal", (), "note")
    many = OfferedSignals({f"c{k}": np.ones(N) for k in range(30)})
    _, (one,) = scan_signals(None, many, MEASURED, (Uses(),))
    assert "'c4' and 25 more are not" in one.message
    assert len(one.message) < 400
    chosen, _ = scan_signals({"tool": SIGNALS["steps"]}, offered, MEASURED, (Uses(),))
    assert set(chosen) == {"tool", "warm"}
    one, _ = scan_signals(None, offered, MEASURED, (Uses("warm"),))
    assert list(one) == ["warm"]
    for name in ("label", "gap"):
        with pytest.raises(ValueError, match=f"The column '{name}' "):
            scan_signals(None, offered, MEASURED, (Uses(name),))
    with pytest.raises(ValueError, match="'torque' is the torque of hip"):
        scan_signals(None, offered, MEASURED, (Uses("torque"),))
    with pytest.raises(ValueError, match="'warm', which is a column of X as well"):
        scan_signals({"warm": WARM}, offered, MEASURED, ())


def test_data_frame_columns_are_split_into_positions_and_signals():
    import pandas

    names = ("hip", "knee")
    columns = {"q_knee": Q[:, 1], "warm": WARM, "q_hip": Q[:, 0], "t": T}
    X = pandas.DataFrame({**columns, "tau_hip": T, "tau_knee": T, "v_hip": T})
    positions, signals = positions_and_signals(X, names)
    np.testing.assert_array_equal(positions, Q)
    assert list(signals) == ["warm", "v_hip"]
    states = pandas.DataFrame(
        {f"{kind}{j}": x[:, j] for kind, x in zip("qva", (Q, V, A)) for j in (0, 1)}
    ).assign(warm=WARM)
    positions, signals = positions_and_signals(states, names)
    assert list(signals) == ["warm"]
    np.testing.assert_array_equal(positions, STATES.states)


@pytest.mark.parametrize("kind", ["csv", "npz", "parquet"])
def test_other_columns_of_a_file_are_named_signals(kind, tmp_path):
    source = tmp_path / f"arm.{kind}"
    columns = {"t": T, "q1": Q[:, 0], "tau1": TAU[:, 0], "a1": A[:, 0], "Temp °C": WARM}
    if kind == "npz":
        np.savez(source, **columns)
    else:
        import pandas

        frame = pandas.DataFrame(columns)
        if kind == "csv":
            frame.to_csv(source, index=False)
        else:
            frame.to_parquet(source)
    recording = read_recording(source)
    offered = OfferedSignals.from_recording(recording)
    assert list(offered) == ["Temp °C"]
    np.testing.assert_allclose(offered["Temp °C"], WARM, rtol=1e-9)
