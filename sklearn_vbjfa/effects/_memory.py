"""Dry friction and play that depend on earlier positions of the joint."""

import functools
import math
from numbers import Real

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.effects._base import (
    POSITION,
    RATIO,
    SPEED,
    STIFFNESS,
    TORQUE,
    Bank,
    Converted,
    InFiles,
    Shaped,
    Stateful,
)

# Widths of play to try, as shares of half of the joint's range.
_WIDTHS = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.13)
# Displacements of a bank, besides zero, as shares of the joint's range: their number,
# and the smallest and the largest one.
_COUNT, _SMALLEST, _LARGEST = 13, 3e-5, 0.125
# Stribeck speeds of a bank to try, as shares of the joint's largest speed.
_SPEEDS = (0.04, 0.08, 0.16, 0.32)
# Step of a finer bank [log]; factors on the speed, and shifts of the displacements in
# such steps, over which intervals are averaged.
_REFINED = math.log(_LARGEST / _SMALLEST) / (3 * (_COUNT - 1))
_FACTORS, _SHIFTS = 2.0 ** np.linspace(-1.0, 1.0, 7), (0.0, 1 / 3, 2 / 3)
# Banks of elements, with symbols and units of their sizes.
_BANKS = {
    "displacements": ("F", TORQUE),
    "loaded": ("mu", RATIO),
    "falling": ("S", TORQUE),
}
_AT_ONCE = (
    "turns round at once: stiffness before sliding, and friction that depends on load "
    "or speed"
)
# Points of the curve from which the displacement at half of the friction is read.
_CURVE = 200


@functools.cache
def _compiled(function):
    """Compile a recursion over samples at its first use."""
    # Numba takes a second to import.
    from sklearn_vbjfa._core._compiler import compiler

    return compiler(__file__)(function)


def elements(q, d, level=1.0, falls=False, creeps=False, before=(), widths=(0, 0)):
    """Return states (n, k) of elements that slip at, or creep towards, a level."""
    # d (k,): displacements; level (n,): of the elements marked in `falls`, bool (k,),
    # that of the others is 1; before: earlier positions, z is zero at the first one;
    # widths: plays of elements without, and of those with a displacement.
    d = np.asarray(d, dtype=float)
    z, path = np.zeros((q.size, d.size)), np.append(before, q)
    paths = np.column_stack([play(path, width) for width in widths])[len(before) :]
    if len(before):
        # At a constant level the states depend on the reversals alone.
        ends = _compiled(_reversals)(np.append(before, q[0]))
        z[0] = elements(ends, d, creeps=creeps, widths=widths)[-1]
    level, falls = np.broadcast_to(level, q.shape), np.broadcast_to(falls, d.shape)
    arrays = (np.ascontiguousarray(x) for x in (paths, d, level, falls))
    _compiled(_elements)(*arrays, creeps, 0.5 * widths[0], z)
    return z


def _elements(paths, d, level, falls, creeps, least, z):
    """Compute states z (n, k) from that of the first row."""
    # least: displacement from which a relaxed element turns, as the first position may
    # be an outlier.
    for i in range(len(paths)):
        previous = max(i - 1, 0)
        turn = paths[i, 0] - paths[previous, 0]
        step = paths[i, 1] - paths[previous, 1]
        direction = -1.0 if step < 0 else 1.0
        for k in range(d.size):
            limit = level[i] if falls[k] else 1.0
            if d[k] == 0:
                moved = z[previous, k] != 0 or abs(paths[i, 0] - paths[0, 0]) > least
                side = turn if turn != 0 and moved else z[previous, k]
                z[i, k] = np.sign(side) * limit
                continue
            aligned, travel = direction * z[previous, k], direction * step / d[k]
            if creeps:
                aligned = limit + (aligned - limit) * math.exp(-travel / limit)
            else:
                aligned = min(aligned + travel, limit)
            z[i, k] = direction * aligned


def _reversals(q):
    """Return the positions at which a motion (n,) begins, reverses and ends."""
    positions = [q[0]]
    for i in range(1, q.size - 1):
        if (q[i] - positions[-1]) * (q[i + 1] - q[i]) < 0:
            positions.append(q[i])
    positions.append(q[-1])
    return np.array(positions)


def earlier_reversals(before):
    """Return `Motion.before`, from the positions (k, nv) before each part."""

    @functools.cache
    def ends(joint):
        paths = (np.ascontiguousarray(q[:, joint]) for q in before)
        return [_compiled(_reversals)(q) if q.size else q for q in paths]

    return ends if before else None


def play(q, width):
    """Apply the play operator: the position follows q within half the width."""
    out = np.array(q, dtype=float)
    _compiled(_play)(out, 0.5 * width)
    return out


def _play(q, half):
    """Apply the play operator to positions (n,) in place."""
    for i in range(1, q.size):
        q[i] = min(max(q[i - 1], q[i] - half), q[i] + half)


class MaxwellSlip(Shaped, Converted, Bank):
    """Dry friction with memory, tau = sum_k F_k z_k of elements that stick and slip.

    Each element sticks up to a displacement d_k and then slips at its level g,
    z' = s min(s z + abs(dq) / d, g), s = sign(dq): the Maxwell slip model. Or it creeps
    towards its level, s z' = g + (s z - g) exp(-abs(dq) / (d g)), as bristles do. The
    level is 1, or falls with speed, g = 1 + exp(-(v / vs)^2). An element without
    displacement is Coulomb friction, z = g sign(v). The torque persists at rest.
    Source: Al-Bender, Lampaert and Swevers (2005), :doi:`10.1109/TAC.2005.858676`;
    Canudas de Wit, Olsson, Astrom and Lischinsky (1995), :doi:`10.1109/9.376053`.

    Parameters
    ----------
    displacements : tuple of float, default=(0.001, 0.01, 0.1)
        Displacements [rad or m] at which elements of constant size slip.
    loaded : tuple of float, default=()
        Displacements of elements of size mu_k abs(tau_load), proportional to the load.
    falling : tuple of float, default=()
        Displacements of elements S_k whose level falls with speed, from 2 to 1.
    vs : float, default=0.1
        Stribeck speed [rad/s or m/s] of the falling elements.
    element : {"stop", "bristle"}, default="stop"
        Whether elements slip (Maxwell slip, GMS) or creep (Dahl, LuGre).
    at_rest : bool, default=True
        Whether a fit uses samples of the joint at rest. A joint may be held by another
        torque, such as that of a state from before the recording.

    Notes
    -----
    The elements are assumed to be relaxed, z = 0, in the first row of each recording.
    An element does not depend on that after the joint has moved by twice its
    displacement without reversal.
    """

    name = "maxwell_slip"
    label = "dry friction with memory"
    formula = (
        r"\sum_k (F_k + \mu_k|\tau_\mathrm{load}|)\,z_k(q; 1)"
        r" + S_k\,z_k(q; 1 + e^{-(v/v_s)^2}),"
        r" \quad z_k(q; g) = s \min(s z_k + |\Delta q| / d_k, g),"
        r" \quad s = \mathrm{sign}(\Delta q)"
    )
    shape_units = (*((name, POSITION) for name in _BANKS), ("vs", SPEED))
    positive = ("vs",)
    tuned = (*_BANKS, "vs", "element")
    choices = (("element", ("stop", "bristle")),)
    # Standard deviation of the logarithm of a displacement between two shifts.
    spacing = _REFINED * (_SHIFTS[1] - _SHIFTS[0]) / math.sqrt(12.0)
    record = "many reversals, after short and long moves"
    files = InFiles(
        parameter="coulomb",
        urdf=f"friction in URDF {_AT_ONCE}",
        mjcf=f"frictionloss in MJCF {_AT_ONCE}",
    )

    def __init__(
        self,
        joint=0,
        displacements=(0.001, 0.01, 0.1),
        loaded=(),
        falling=(),
        vs=0.1,
        element="stop",
        at_rest=True,
    ):
        super().__init__(joint)
        self.displacements = displacements
        self.loaded = loaded
        self.falling = falling
        self.vs = vs
        self.element = element
        self.at_rest = at_rest

    _creeps = property(lambda self: self.element == "bristle")
    _banks = property(lambda self: tuple(getattr(self, name) for name in _BANKS))

    @property
    def coefficients(self):
        """Sizes of the elements: F1, F2, ..., mu1, ..., S1, ..."""
        pairs = zip(_BANKS.values(), self._banks)
        return tuple(f"{x}{k + 1}" for (x, _), bank in pairs for k in range(len(bank)))

    nonnegative = coefficients

    @property
    def contains(self):
        """Names of the effects that elements without displacement are equal to."""
        return ("coulomb", "load_friction") if self.loaded else ("coulomb",)

    @property
    def units(self):
        pairs = zip(_BANKS.values(), self._banks)
        return tuple(unit for (_, unit), bank in pairs for _ in bank)

    continuous = property(lambda self: ("vs",) if self.falling else ())
    needs = property(lambda self: ("load",) if self.loaded else ())
    depends = property(lambda self: ("direction", *self.needs))

    def shape(self):
        left_out = {"at_rest"} if self.falling else {"at_rest", "vs"}
        return {k: x for k, x in super().shape().items() if k not in left_out}

    @property
    def named_units(self):
        units = {"Fc": TORQUE, "half": POSITION, "mu": RATIO, "Fs": TORQUE}
        symbols = self.parameters(np.ones(len(self.coefficients)))
        return tuple((name, units[name]) for name in symbols)

    def check(self):
        super().check()
        if not self.coefficients:
            raise ValueError(
                f"{self.name} must have at least one element; got no displacements."
            )
        for name, bank in zip(_BANKS, self._banks):
            if not all(isinstance(d, Real) and 0 <= d < np.inf for d in bank):
                raise ValueError(
                    f"{name} of {self.name} must be finite and not negative; got "
                    f"{bank!r}."
                )

    def columns(self, motion):
        j, d = self.joint, np.concatenate(self._banks)
        constant, loaded, _ = self._split(np.arange(d.size))
        falls = np.arange(d.size) >= constant.size + loaded.size
        level = 1.0 + np.exp(-((motion.v[:, j] / self.vs) ** 2))
        widths = motion.rest.plays(j) if motion.rest else (0.0, 0.0)
        before = motion.before(j) if motion.before else [()] * len(motion.parts)
        z = np.empty((level.size, d.size))
        for part, earlier in zip(motion.parts, before, strict=True):
            arguments = level[part], falls, self._creeps, earlier, widths
            z[part] = elements(motion.q[part, j], d, *arguments)
        if loaded.size:
            z[:, loaded] *= np.abs(motion.load[:, [j]])
        return z

    def _split(self, values):
        """Split values of the elements (k, ...) by banks."""
        edges = np.cumsum([len(bank) for bank in self._banks])
        return np.split(values, edges[:-1])

    def law(self, maths):
        j, vs, exp, creeps = self.joint, self.vs, maths.exp, self._creeps
        constant, loaded, falling = self._banks
        d = [float(x) for x in (*constant, *loaded, *falling)]
        first, second = len(constant), len(constant) + len(loaded)
        paths, side, z, origin = (), 0.0, [0.0] * len(d), None
        halves = [x / 2 for x in (maths.rest.plays(j) if maths.rest else (0.0, 0.0))]

        def torque(state):
            nonlocal paths, side, origin
            q, old = state.q[j], paths or 2 * (state.q[j],)
            origin = q if origin is None else origin
            paths = [min(max(p, q - h), q + h) for p, h in zip(old, halves)]
            turn, step = (p - last for p, last in zip(paths, old))
            direction = -1.0 if step < 0 else 1.0
            if turn and (side or abs(paths[0] - origin) > halves[0]):
                side = 1.0 if turn > 0 else -1.0
            falling_level = 1.0 + exp(-((state.v[j] / vs) ** 2)) if falling else 1.0
            for k, displacement in enumerate(d):
                level = falling_level if k >= second else 1.0
                if displacement == 0:
                    z[k] = side * level
                    continue
                aligned, travel = direction * z[k], direction * step / displacement
                if creeps:
                    aligned = level + (aligned - level) * exp(-travel / level)
                else:
                    aligned = min(aligned + travel, level)
                z[k] = direction * aligned
            load = abs(state.load[j]) if loaded else 0.0
            return *z[:first], *(load * x for x in z[first:second]), *z[second:]

        return torque

    def simulated(self, table, *coef):
        """Add each element to a `TermTable`."""
        coef = self._split(np.asarray(coef, dtype=float))
        kinds = zip(self._banks, coef, (0.0, 0.0, self.vs), (0.0, 1.0, 0.0))
        for bank, sizes, vs, of_load in kinds:
            for d, size in zip(bank, sizes.tolist()):
                if d > 0:
                    table.add(self.element, self.joint, size, d, vs, of_load)
                    continue
                table.add("load_dry" if of_load else "dry", self.joint, size)
                if vs:
                    table.add("stribeck", self.joint, size, vs, 2)
        return True

    def shapes(self, motion):
        """Banks of displacements up to an eighth of the range."""
        reach, fast = motion.range(self.joint), motion.speed(self.joint)
        bank = tuple(reach * np.geomspace(_SMALLEST, _LARGEST, _COUNT))
        if not (reach > 0 and fast > 0):
            return []
        # Loaded or falling elements without displacement are other effects.
        base = {"displacements": (0.0, *bank), "loaded": (), "falling": ()}
        base |= {"vs": _SPEEDS[0] * fast, "element": "stop"}
        others = [
            base | {"falling": bank, "vs": s * fast, "element": element}
            for element in ("stop", "bristle")
            for s in _SPEEDS
        ]
        if motion.load is not None:
            others.append(base | {"loaded": bank})
        return [base, *others]

    def first_shapes(self, motion):
        """Return the banks of slipping elements; creeping ones follow if they help."""
        shapes = self.shapes(motion)
        return [shape for shape in shapes if self._creeps or shape["element"] == "stop"]

    def natural(self, coef):
        # Without displacement it would be Coulomb friction.
        has_memory = np.any(np.concatenate(self._banks) * coef)
        return bool(super().natural(coef) and has_memory)

    def only(self, used):
        """Return the effect with the elements in a mask (k,)."""
        pairs = zip(self._banks, self._split(used))
        return self._of_banks(np.asarray(bank)[mask] for bank, mask in pairs)

    def forms(self):
        """Return the effect with other displacements and Stribeck speeds, a list."""
        speeds = self.vs * _FACTORS if self.falling else [self.vs]
        banks = [self.finer(shift) for shift in _SHIFTS]
        return [clone(x).set_params(vs=float(vs)) for x in banks for vs in speeds]

    def finer(self, shift=0.0):
        """Return the effect with further elements around each element."""
        steps = np.exp(_REFINED * (np.arange(-2, 3) + shift))
        return self._of_banks(
            np.unique(np.outer(bank, steps).round(12)) for bank in self._banks
        )

    def _of_banks(self, banks):
        """Return the effect with other displacements."""
        changes = {name: tuple(bank.tolist()) for name, bank in zip(_BANKS, banks)}
        return type(self)(**self.get_params(deep=False) | changes)

    def completed(self):
        """Return the effect with an element of no displacement, Coulomb friction."""
        d = (0.0, *(x for x in self.displacements if x > 0))
        return type(self)(**self.get_params(deep=False) | {"displacements": d})

    def in_file(self, coef):
        """Return the sizes of the elements at high speed, zero for the loaded ones."""
        constant, loaded, falling = self._split(np.array(coef, dtype=float))
        return np.concatenate([constant, 0.0 * loaded, falling])

    def virgin_curve(self, coef, displacement):
        """Torque (n,) of a relaxed joint moved by displacements (n,) [rad or m].

        Without the loaded elements, and well above the Stribeck speed.
        """
        constant, _, falling = self._split(np.asarray(coef, dtype=float))
        d = np.concatenate([self.displacements, self.falling])
        x = np.asarray(displacement, dtype=float)[:, None]
        travel = np.where(d > 0, x / or_one(d), np.inf)
        curve = 1.0 - np.exp(-travel) if self._creeps else np.minimum(travel, 1.0)
        return curve @ np.concatenate([constant, falling])

    def parameters(self, coef):
        """Total friction Fc, displacement `half`, and sums mu and Fs."""
        # Fc holds well above the Stribeck speed, Fs is added at very low speed; `half`
        # is the displacement at which half of the torque's increase is reached.
        constant, loaded, falling = self._split(np.asarray(coef, dtype=float))
        values = {}
        if constant.size or falling.size:
            d = np.concatenate([self.displacements, self.falling])
            smallest = d[d > 0].min(initial=np.inf)
            fine = np.geomspace(smallest / 10, d.max() * 10, _CURVE) if d.any() else d
            ends = np.unique(np.r_[0.0, d, fine])
            curve = self.virgin_curve(coef, ends)
            middle, increases = 0.5 * (curve[0] + curve[-1]), curve[-1] > curve[0]
            half = np.interp(middle, curve, ends) if increases else 0.0
            values |= {"Fc": float(constant.sum() + falling.sum()), "half": float(half)}
        sums = {"mu": loaded, "Fs": falling}
        return values | {key: float(x.sum()) for key, x in sums.items() if x.size}


class Backlash(Shaped, Stateful):
    """Play in series with a spring, tau = k play(q; width) + c.

    The play operator follows the position at a distance of at most half the width and
    rests while the gap is crossed. Source: Brokate and Sprekels (1996),
    :doi:`10.1007/978-1-4612-4048-8`.

    Parameters
    ----------
    width : float, default=0.01
        Width of the gap [rad or m].
    """

    name = "backlash"
    label = "backlash"
    formula = r"k\,\mathrm{play}(q;\,\mathrm{width}) + c"
    coefficients = ("k", "c")
    nonnegative = ("k",)
    units = (STIFFNESS, TORQUE)
    shape_units = (("width", POSITION),)
    contains = ("spring", "coulomb")
    continuous = positive = ("width",)
    depends = ("position",)
    record = "many reversals, at several positions"
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
        p = None

        def torque(state):
            nonlocal p
            q = state.q[j]
            p = q if p is None else min(max(p, q - half), q + half)
            return p, 1.0

        return torque

    def shapes(self, motion):
        """Widths up to a quarter of the range."""
        reach = motion.range(self.joint)
        return [{"width": 2 * s * reach} for s in _WIDTHS]
