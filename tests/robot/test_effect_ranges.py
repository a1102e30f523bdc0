"""Ranges of effects and what lies outside of them, against hand-made cases."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import effects
from sklearn_vbjfa.equations import EffectRange, OutsideRange, outside
from tests.effects.test_effects import NAMES, V, library_effect, signals

SPRING = EffectRange(
    name="spring",
    joint=1,
    position=(-1.0, 3.0),
    speed=(0.5, 2.0),
    load=(-4.0, 6.0),
    depends=("position",),
)


@pytest.mark.parametrize(
    ("depends", "name", "low", "high", "width"),
    [
        (("position",), "q", -1.0, 3.0, 4.0),
        (("speed",), "v", -2.0, 2.0, 2 * 1.5),
        (("load", "direction"), "load", -6.0, 6.0, 10.0),
    ],
)
def test_a_motion_is_held_within_range_and_margin(depends, name, low, high, width):
    margin = 0.2 * width
    inside = [low - 0.99 * margin, 0.5, high + 0.99 * margin]
    x = np.repeat([[-19.0], *([value] for value in inside), [19.0]], 2, axis=1)
    given = x.copy()
    motion = effects.Motion(q=x, v=x, a=x, load=x, torque=x)
    own = dataclasses.replace(SPRING, depends=depends)
    held = own.within(motion)
    for other in ("q", "v", "a", "load", "torque"):
        values = getattr(held, other)
        assert_array_equal(values[:, 0], x[:, 0])
        if other != name:
            assert_array_equal(values[:, 1], x[:, 1])
            continue
        assert_array_equal(values[1:-1, 1], inside)
        assert_allclose(values[[0, -1], 1], [low - margin, high + margin], rtol=1e-8)
    assert_array_equal(x, given)
    assert held.speed(1) == np.quantile(np.abs(held.v[:, 1]), 0.995)


def test_what_is_outside_is_told_with_its_size():
    values = np.r_[np.zeros(75), np.full(25, -2.0)]
    # The other joint is far outside.
    signals = {("position", 0): np.full(100, 1e3), ("position", 1): values}
    assert outside([SPRING], signals, [True]) == (
        OutsideRange(
            names=("spring",),
            joint=1,
            quantity="position",
            fitted=(-1.0, 3.0),
            reached=-2.0,
            share=0.25,
            clipped=("spring",),
        ),
    )


# -- what effects say of themselves


QUANTITIES = {"position": "q", "speed": "v", "load": "load"}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("coulomb", True),
        ("stribeck", True),
        ("load_friction", True),
        ("viscous", False),
        ("viscous_quadratic", False),
        ("offset", False),
        ("spring", False),
        ("rotor_inertia", False),
    ],
)
def test_what_jumps_at_a_reversal_depends_on_the_direction(name, expected):
    effect, motion = library_effect(name), signals()
    forth, back = (
        effect.columns(dataclasses.replace(motion, v=np.full_like(V, v)))
        for v in (1e-9, -1e-9)
    )
    assert (np.abs(forth - back).max() > 1e-6) == expected
    assert ("direction" in effect.depends) == expected


def motion_over(x):
    """Motion of two joints with positions, speeds and loads of the same size."""
    x = np.column_stack([x, x])
    return effects.Motion(q=x, v=x, a=x, load=x, torque=x)


TURN = np.linspace(-np.pi, np.pi, 2001)
# Largest column of each bounded effect: that of a sine, and by the law of sines that of
# sin x / l in a triangle with the sides 1 and l, the sine of the angle opposite to 1.
LARGEST = {
    "ripple": [({"period": period}, [1, 1]) for period in (0.04, 0.7)],
    "friction_by_position": [({"period": 0.7}, [1, 1])],
    "counterbalance": [
        ({}, [1, 1, 1, 1, 1]),
        *(
            ({"form": "linkage", "ratio": ratio, "angle": 0.4}, [1, 1])
            for ratio in (0.1, 0.9)
        ),
    ],
}


@pytest.mark.parametrize("name", NAMES)
def test_what_depends_on_the_motion_is_bounded_or_held(name):
    (effect,) = effects.resolve(name)
    moves = set(effect.depends) & set(QUANTITIES)
    # What differs with direction is as straight as what does not.
    straight = name == "asymmetric_friction"
    assert effect.bounded == (name in LARGEST or straight)
    assert moves or not effect.bounded
    if straight or not moves:
        return
    for shape, largest in LARGEST.get(name, [({}, None)]):
        own = effect.set_params(joint=0, **shape)
        # A hundred times wider, and not on the same angles.
        turn, wide = (own.columns(motion_over(x)) for x in (TURN, 100.3 * TURN))
        if effect.bounded:
            assert_allclose(abs(turn).max(axis=0), largest, rtol=0.01)
            assert (abs(wide).max(axis=0) <= np.array(largest) + 1e-9).all()
            continue
        assert abs(wide).max() > 50 * abs(turn).max()
        ends = (-np.pi, np.pi)
        known = dataclasses.replace(
            SPRING,
            joint=0,
            position=ends,
            load=ends,
            speed=(0.0, np.pi),
            depends=effect.depends,
        )
        held = own.columns(known.within(motion_over(100.3 * TURN)))
        # A fifth of two widths from zero on either side.
        most = own.columns(motion_over(1.4 * TURN))
        assert_allclose(abs(held).max(axis=0), abs(most).max(axis=0), rtol=1e-8)
