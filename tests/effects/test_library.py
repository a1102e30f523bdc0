"""Texts and containment of the library's effects."""

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import closure


def test_every_effect_has_a_label_and_a_formula():
    for effect in effects.resolve():
        assert effect.label
        assert effect.formula
        assert effect.describe({}, str) == effect.label


def test_closure_of_contained_effects():
    library = effects.resolve()
    assert closure(effects.Viscous(), library) == set()
    assert closure(effects.Backlash(), library) == {"spring", "coulomb", "offset"}
    # Effects that are not in the library contribute only their own names.
    assert closure(effects.Backlash(), ()) == {"spring", "coulomb"}
