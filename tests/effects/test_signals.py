"""Effects that vary with a recorded signal: columns, units and shapes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import Motion
from tests.effects._arms import motion

T, X = motion(2, duration=4.0, seed=5)
Q, V, A = np.split(X, 3, axis=1)
WARM = 25 + 10 * np.sin(0.8 * T)
SIGNALS = {"temperature": WARM, "voltage": 24 - 0.02 * WARM**2}


def moved(**changed):
    return Motion(**{"q": Q, "v": V, "a": A, "t": T, "signals": SIGNALS, **changed})


@pytest.mark.parametrize("of", ["offset", "coulomb", "viscous"])
def test_reference_changes_only_the_share_of_the_base_effect(of):
    """Check k (s - r) f = k (s - r') f + k (r' - r) f."""
    plain = {"offset": 1.0, "coulomb": np.sign(V[:, 1]), "viscous": V[:, 1]}[of]
    given = {"joint": 1, "signal": "temperature", "of": of}
    low, high = (
        effects.Signal(**given, reference=r).columns(moved())[:, 0] for r in (20.0, 31)
    )
    assert_allclose(low - high, (31 - 20) * plain * np.ones(T.size), atol=1e-12)


def test_signal_units_only_scale_the_columns():
    celsius = effects.Signal(signal="temperature", reference=25.0)
    kelvin = effects.Signal(signal="temperature", reference=298.15)
    fahrenheit = effects.Signal(signal="temperature", reference=77.0)
    base = celsius.columns(moved())
    shifted = moved(signals={"temperature": WARM + 273.15})
    assert_allclose(kelvin.columns(shifted), base, atol=1e-10)
    scaled = moved(signals={"temperature": 1.8 * WARM + 32})
    assert_allclose(fahrenheit.columns(scaled), 1.8 * base, atol=1e-10)


def test_shapes_cover_all_varying_signals_about_their_mean():
    flat = {**SIGNALS, "humidity": np.full(T.size, 40.0)}
    shapes = effects.Signal(joint=1).shapes(moved(signals=flat))
    assert {(s["signal"], s["of"]) for s in shapes} == {
        (name, of) for name in SIGNALS for of in ("offset", "coulomb", "viscous")
    }
    for shape in shapes:
        assert shape["reference"] == pytest.approx(SIGNALS[shape["signal"]].mean())
    assert effects.Signal().shapes(moved(signals={})) == []


def test_signals_as_a_data_frame():
    import pandas

    effect = effects.Signal(signal="voltage").fit(X)
    expected = effect.transform(X, signals=SIGNALS)
    assert_array_equal(effect.transform(X, signals=pandas.DataFrame(SIGNALS)), expected)
