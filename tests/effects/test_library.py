"""What the library says of its effects."""

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import closure


def plain_label(joint):
    return f"joint {joint + 1}"


def test_every_effect_says_what_reports_and_guide_need():
    for effect in effects.resolve():
        assert effect.label
        assert effect.formula
        assert effect.describe({}, plain_label) == effect.label


def test_closure_follows_what_is_contained():
    library = effects.resolve()
    assert closure(effects.Viscous(), library) == set()
    assert closure(effects.Backlash(), library) == {"spring", "coulomb", "offset"}
    # Of what the library does not hold nothing more is known.
    assert closure(effects.Backlash(), ()) == {"spring", "coulomb"}
