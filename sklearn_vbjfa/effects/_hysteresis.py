"""Effects with a memory of where the joint came from."""

import itertools

import numpy as np

from sklearn_vbjfa.effects._base import (
    POSITION,
    STIFFNESS,
    TORQUE,
    InFiles,
    Shaped,
    Stateful,
)

# Displacements to try, as shares of the joint's range.
_DISPLACEMENTS = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.13)


def _turning_points(q):
    """Find the samples at which a position turns, with both ends."""
    step = np.diff(q)
    moving = np.flatnonzero(step)
    if moving.size == 0:
        return np.array([0, q.size - 1])
    way = np.sign(step[moving])
    turns = moving[1:][way[1:] != way[:-1]]
    return np.unique(np.r_[0, turns, q.size - 1])


def dahl(q, displacement):
    """Dahl's hysteresis of unit size, dz = (sign(dq) - z) abs(dq) / displacement."""
    # Solved exactly from turning point to turning point; starts at rest, z = 0.
    z = np.zeros_like(q)
    turns = _turning_points(q)
    for a, b in itertools.pairwise(turns):
        way = np.sign(q[b] - q[a])
        travelled = np.abs(q[a : b + 1] - q[a])
        z[a : b + 1] = way + (z[a] - way) * np.exp(-travelled / displacement)
    return z


def play(q, width):
    """Play operator: what follows q at a distance of at most half the width."""
    out = np.empty_like(q)
    half = 0.5 * width
    turns = _turning_points(q)
    out[0] = q[0]
    for a, b in itertools.pairwise(turns):
        if q[b] >= q[a]:
            out[a : b + 1] = np.maximum(out[a], q[a : b + 1] - half)
        else:
            out[a : b + 1] = np.minimum(out[a], q[a : b + 1] + half)
    return out


class Presliding(Shaped, Stateful):
    """Presliding friction after a reversal, tau = Fp z(q) with Dahl's hysteresis.

    dz/dt = (v - abs(v) z) / displacement [1]_: before it slides a contact yields like
    a spring, so that friction builds up over a displacement and not at once. LuGre
    and Maxwell slip models describe the same.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    displacement : float, default=0.01
        Displacement [rad or m] over which friction builds up to 63 %.

    References
    ----------
    .. [1] P. R. Dahl, "A solid friction model", Aerospace Corporation TOR-0158, 1968;
       C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, "A new model for
       control of systems with friction", IEEE Trans. Automatic Control 40(3), 1995.
       :doi:`10.1109/9.376053`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Presliding
    >>> states = [[0.0, 1, 0], [0.01, 1, 0], [0.1, 1, 0]]
    >>> Presliding(displacement=0.01).fit_transform(states).ravel().round(2)
    array([0.  , 0.63, 1.  ])
    """

    name = "presliding"
    label = "hysteresis after reversals (presliding)"
    formula = r"F_p\,z, \quad \dot z = (v - |v|\,z) / \mathrm{displacement}"
    coefficients = ("Fp",)
    nonnegative = ("Fp",)
    units = (TORQUE,)
    shape_units = (("displacement", POSITION),)
    contains = ("coulomb", "viscous")
    continuous = ("displacement",)
    positive = ("displacement",)
    depends = ("direction",)
    visible = "many reversals"
    record = "many reversals"
    files = InFiles.nowhere("friction with a memory of where the joint came from")
    terms = (("presliding", "Fp", "displacement"),)

    def __init__(self, joint=0, displacement=0.01):
        super().__init__(joint)
        self.displacement = displacement

    def columns(self, motion):
        q = motion.q[:, self.joint]
        z = [dahl(q[part], self.displacement) for part in motion.parts]
        return np.concatenate(z)[:, None]

    def law(self, maths):
        j, displacement, exp = self.joint, self.displacement, maths.exp
        # Last position and state, those of the last turning point, and the way since.
        last = z = turned = begin = None
        way = 0.0

        def torque(state):
            nonlocal last, z, turned, begin, way
            q = state.q[j]
            if last is None:
                last = turned = q
                z = begin = 0.0
                return (0.0,)
            step = q - last
            if step:
                new = 1.0 if step > 0 else -1.0
                if new != way:
                    turned, begin, way = last, z, new
                decay = exp(-abs(q - turned) / displacement)
                z, last = way + (begin - way) * decay, q
            return (z,)

        return torque

    def shapes(self, motion):
        """Displacements up to an eighth of the range."""
        reach = motion.range(self.joint)
        return [{"displacement": s * reach} for s in _DISPLACEMENTS]


class Backlash(Shaped, Stateful):
    """Play in series with a spring, tau = k play(q; width) + c.

    The play operator follows the position at a distance of at most half the width
    and rests while the gap is crossed [1]_.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    width : float, default=0.01
        Width of the gap [rad or m].

    References
    ----------
    .. [1] M. Brokate, J. Sprekels, "Hysteresis and Phase Transitions", Springer, 1996.
       :doi:`10.1007/978-1-4612-4048-8`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Backlash
    >>> states = [[0.0, 1, 0], [0.01, 1, 0], [0.1, 1, 0], [0.09, -1, 0]]
    >>> Backlash(width=0.04).fit_transform(states)[:, 0]
    array([0.  , 0.  , 0.08, 0.08])
    """

    name = "backlash"
    label = "backlash"
    formula = r"k\,\mathrm{play}(q;\,\mathrm{width}) + c"
    coefficients = ("k", "c")
    units = (STIFFNESS, TORQUE)
    shape_units = (("width", POSITION),)
    contains = ("spring", "coulomb")
    continuous = ("width",)
    positive = ("width",)
    depends = ("position",)
    seen_over = "position"
    visible = "many reversals, at several positions"
    record = "reversals at several positions"
    files = InFiles.nowhere("play with a memory of where the joint came from")
    terms = (("backlash", "k", "width"), ("constant", "c"))

    def __init__(self, joint=0, width=0.01):
        super().__init__(joint)
        self.width = width

    def columns(self, motion):
        q = motion.q[:, self.joint]
        p = np.concatenate([play(q[part], self.width) for part in motion.parts])
        return np.column_stack([p, np.ones_like(p)])

    def law(self, maths):
        j, half = self.joint, 0.5 * self.width
        last = p = None

        def torque(state):
            nonlocal last, p
            q = state.q[j]
            if p is None:
                p = q
            elif q > last:
                p = max(p, q - half)
            elif q < last:
                p = min(p, q + half)
            last = q
            return p, 1.0

        return torque

    def shapes(self, motion):
        """Widths up to a quarter of the range."""
        reach = motion.range(self.joint)
        return [{"width": 2 * s * reach} for s in _DISPLACEMENTS]
