"""What the library says of its effects."""

import pytest

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import closure


def plain_label(joint):
    return f"joint {joint + 1}"


def test_every_effect_says_what_reports_and_guide_need():
    for effect in effects.resolve():
        assert effect.label
        assert effect.record
        assert effect.formula
        assert effect.describe({}, plain_label) == effect.label
        # What a sign means is said of parameters that the effect has.
        named = {name for name, _ in effect.named_units} or set(effect.coefficients)
        assert {name for name, _ in effect.negative} <= named


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        (effects.Drift(of="coulomb"), "drift of the Coulomb friction with time"),
        (effects.Drift(of="viscous"), "drift of the viscous friction with time"),
        (effects.Drift(of="offset"), "drift of the offset with time"),
        (effects.Coupling(other=1), "coupling to joint 2"),
        (effects.Coupling(other=2, of="sum"), "coupling to joint 3 (sum)"),
        (
            effects.Coupling(other=0, of="difference"),
            "coupling to joint 1 (difference)",
        ),
        (effects.Ripple(period=0.2), "torque ripple"),
        (effects.Counterbalance(), "counterbalance"),
        (
            effects.Counterbalance(form="linkage"),
            "counterbalance (gas or coil spring on a linkage)",
        ),
        (effects.Delay(delay=0.004), "delay: torque lags position by 4 ms"),
        (effects.Delay(delay=-0.0123), "delay: position lags torque by 12 ms"),
        (
            effects.TorqueFilter(time_constant=0.005),
            "filter: torque lags position by a low-pass of 5 ms",
        ),
        (
            effects.TorqueFilter(of="position", time_constant=0.005),
            "filter: position lags torque by a low-pass of 5 ms",
        ),
        (
            effects.TorqueFilter(kind="smooth", time_constant=0.022),
            "filter: the torque was smoothed with about 6 Hz",
        ),
        (
            effects.TorqueFilter(kind="smooth", of="position", time_constant=0.022),
            "filter: the position was smoothed with about 6 Hz, the torque was not",
        ),
    ],
)
def test_labels_say_what_matters_of_the_shape(effect, expected):
    assert effect.describe(effect.shape(), plain_label) == expected


def test_an_effect_of_ones_own_is_called_by_its_name():
    class Leak(effects.Effect):
        name = "oil_leak"

    assert Leak.describe({}, plain_label) == "oil leak"


def test_closure_follows_what_is_contained():
    library = effects.resolve()
    assert closure(effects.Viscous(), library) == set()
    assert closure(effects.Backlash(), library) == {"spring", "coulomb", "offset"}
    # Of what the library does not hold nothing more is known.
    assert closure(effects.Backlash(), ()) == {"spring", "coulomb"}
