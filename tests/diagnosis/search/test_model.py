"""The declared model with effects, as the search fits it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from tests.diagnosis.search._searches import CLEAN, coulomb, search, spring


def test_load_is_that_of_the_bodies():
    now = search(CLEAN.torque(), ["load_friction"]).run()
    inside = slice(50, -50)
    error = (now.model.motion.load - CLEAN.load)[inside]
    assert np.all(error.std(axis=0) < 0.03 * CLEAN.load.std(axis=0))


def test_coefficients_are_in_the_effects_own_units():
    torque = CLEAN.torque(joint_2=coulomb(1.5), joint_1=spring(4.0, 1.0))
    now = search(torque, ["coulomb", "spring"]).run()
    by_name = {e.name: now.model.coefficients(e) for e in now.effects}
    assert_allclose(by_name["coulomb"], [1.5], rtol=0.02)
    assert_allclose(by_name["spring"], [4.0, 1.0], rtol=0.05)
    with pytest.raises(ValueError, match="not among the accepted"):
        now.model.coefficients(effects.Offset(0))


def test_a_model_beside_another_has_its_weights_and_load():
    now = search(CLEAN.torque(joint_2=coulomb(1.0)), ["coulomb"])
    now.accept(())
    plain = now.model
    other = plain.beside([effects.Coulomb(1)])
    assert_array_equal(other.precision, plain.precision)
    assert other.motion is plain.motion
    assert other.ridge == plain.ridge
    assert other.squares[:, 1].sum() < 0.2 * plain.squares[:, 1].sum()
    now.accept(other.effects)
    # On its own it weighs the joint by what is left of its residual.
    assert now.model.precision[1] > 4 * plain.precision[1]
    assert plain.effects == ()
