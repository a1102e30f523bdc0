"""Effects of a user, which the simulator knows by their columns alone.

What a class says of its torque anew takes back what its base says of it elsewhere.
"""

import numpy as np
import pytest

from sklearn_vbjfa.effects import (
    Coulomb,
    Effect,
    LoadFriction,
    MaxwellSlip,
    Signal,
    Spring,
    Viscous,
)
from sklearn_vbjfa.simulation import simulate
from tests.simulation._machines import Arm, wheel


class OwnSpring(Spring):
    """A spring that the library does not know."""

    law = Spring.law


class OwnCoulomb(Coulomb):
    """Dry friction that the library does not know."""

    law = Coulomb.law


class OwnLoadFriction(LoadFriction):
    """Friction over the load that the library does not know."""

    law = LoadFriction.law


class OwnSignal(Signal):
    """A signal that the library does not know."""

    law = Signal.law


class OwnMemory(MaxwellSlip):
    """Hysteresis that the library does not know."""

    columns = MaxwellSlip.columns


class Everywhere(Effect):
    """Viscous friction of all joints, with one coefficient."""

    name = "everywhere"
    coefficients = ("F",)
    units = (("", ""),)
    whole_robot = True

    def columns(self, motion):
        return motion.v[:, :, None]


def same(one, other, exact=1e-10, **keywords):
    """Compare the arm with effects of its own and with those of the library."""
    t = 0.01 * np.arange(101)
    tau = np.column_stack([4 * np.sin(6 * t), 2 * np.cos(9 * t)])
    friction = {"viscous": [0.3, 0.1]}
    found = [
        simulate(Arm().robot(friction, own), tau, [0.4, -0.6], [1.0, -2.0], **keywords)
        for own in (one, other)
    ]
    found = [states[:, :4] for states in found]
    np.testing.assert_allclose(*found, rtol=0, atol=exact)
    return found[0]


def test_spring():
    same([(OwnSpring(1), [3.0, 0.2])], [(Spring(1), [3.0, 0.2])])


def test_whole_robot():
    same([(Everywhere(), [0.2])], [(Viscous(j), [0.2]) for j in range(2)])


def test_signal():
    signals = {"grease": np.linspace(1.0, 2.0, 101)}
    own = OwnSignal(1, "grease", "offset"), Signal(1, "grease", "offset")
    same(*[[(one, [0.4])] for one in own], 1e-9, signals=signals)


def test_signal_that_is_missing():
    robot = wheel(effects=[(OwnSignal(0, "grease", "offset"), [0.4])])
    with pytest.raises(ValueError, match="needs the recorded signal 'grease'"):
        simulate(robot, np.zeros((10, 1)), [0.0])


@pytest.mark.parametrize(
    ("left", "why"),
    [
        ((OwnMemory(displacements=(0.1,)), [0.5]), "depends on more than position"),
        ((OwnLoadFriction(0), [0.3]), "depends on more than position"),
        ((OwnCoulomb(0), [4.0]), "jumps where the joint turns"),
    ],
)
def test_others_are_left_out_with_a_warning(left, why):
    robot = wheel(effects=[left, (OwnSpring(), [2.0, 0.0])])
    with pytest.warns(UserWarning, match=f"leaves out .* on wheel .*{why}"):
        states = simulate(robot, np.zeros((20, 1)), [0.1])
    bare = simulate(wheel(effects=[(Spring(), [2.0, 0.0])]), np.zeros((20, 1)), [0.1])
    np.testing.assert_allclose(states, bare, rtol=0, atol=1e-12)
