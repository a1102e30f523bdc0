"""Friction of velocity and load, and friction and play with a memory."""

import itertools

import numpy as np

from sklearn_vbjfa.effects._base import (
    POSITION,
    SPEED,
    STIFFNESS,
    TORQUE,
    VISCOSITY,
    Effect,
    InFiles,
    JointEffect,
    Shaped,
    Stateful,
)

# Smoothing and Stribeck speeds to try, as shares of the joint's fastest speed.
_SMOOTHINGS = (0.0, 0.02, 0.05, 0.1, 0.2)
_STRIBECK = (0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.6)


class _Smoothed(Shaped):
    """Dry friction, with a sign that may be smoothed."""

    continuous = ("smoothing",)
    neutral = (("smoothing", 0.0),)
    shape_units = (("smoothing", SPEED),)

    def __init__(self, joint=0, smoothing=0.0):
        super().__init__(joint)
        self.smoothing = smoothing

    def shapes(self, motion):
        fast = motion.speed(self.joint)
        return [{"smoothing": s * fast} for s in _SMOOTHINGS]


class Viscous(JointEffect):
    """Viscous friction, tau = Fv v.

    Part of the model of [1]_, the eleventh parameter of each joint there.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Viscous
    >>> Viscous().fit_transform([[0.1, 2.0, 0.0]])
    array([[2.]])
    """

    name = "viscous"
    alike = True
    label = "viscous friction"
    formula = r"F_v\,v"
    coefficients = ("Fv",)
    nonnegative = ("Fv",)
    units = (VISCOSITY,)
    depends = ("speed",)
    seen_over = "speed"
    visible = "motion at several speeds"
    record = "motion at several speeds"
    files = InFiles(parameter="viscous", urdf="", mjcf="")
    terms = (("viscous", "Fv"),)

    def law(self, maths):
        j = self.joint
        return lambda state: (state.v[j],)


class Coulomb(_Smoothed, JointEffect):
    """Coulomb friction, tau = Fc sign(v), or Fc tanh(v / smoothing).

    Equation of [1]_; the smoothed sign stands for the rounded characteristic of
    lubricated gears.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    smoothing : float, default=0.0
        Speed [rad/s or m/s] over which the sign turns; zero is the sign itself.

    References
    ----------
    .. [1] B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, "A survey of models,
       analysis tools and compensation methods for the control of machines with
       friction", Automatica 30(7), 1994. :doi:`10.1016/0005-1098(94)90209-7`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Coulomb
    >>> Coulomb().fit_transform([[0.1, -2.0, 0.0]])
    array([[-1.]])
    """

    name = "coulomb"
    alike = True
    label = "Coulomb friction"
    formula = (
        r"F_c\,\mathrm{sign}(v) \quad\text{or}\quad"
        r" F_c \tanh(v / \mathrm{smoothing})"
    )
    coefficients = ("Fc",)
    nonnegative = ("Fc",)
    units = (TORQUE,)
    depends = ("direction",)
    seen_over = "speed"
    visible = "the joint reverses"
    record = "many reversals"
    files = InFiles(parameter="coulomb", urdf="", mjcf="")
    terms = (("coulomb", "Fc", "smoothing"),)

    def law(self, maths):
        j, sign = self.joint, maths.sign(self.joint, smoothing=self.smoothing)
        return lambda state: (sign(state.v[j], state.a[j]),)


class AsymmetricFriction(Effect):
    """Friction that differs between the directions of motion.

    tau = dFc abs(sign(v)) + dFv abs(v): half the difference between the Coulomb and
    viscous coefficients for v > 0 and for v < 0, beside the symmetric `Coulomb` and
    `Viscous` halves. Without dFv it equals an `Offset`.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.

    Notes
    -----
    Usual in screw drives and where gravity loads the gear flanks, see [1]_.

    References
    ----------
    .. [1] A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS",
       Nonlinear System Identification Benchmarks, 2019.

    Examples
    --------
    >>> from sklearn_vbjfa.effects import AsymmetricFriction
    >>> AsymmetricFriction().fit_transform([[0.1, -2.0, 0.0]])
    array([[1., 2.]])
    """

    name = "asymmetric_friction"
    label = "friction that differs with direction"
    formula = r"\Delta F_c\,|\mathrm{sign}(v)| + \Delta F_v\,|v|"
    coefficients = ("dFc", "dFv")
    units = (TORQUE, VISCOSITY)
    negative = (
        ("dFc", "more friction backward than forward"),
        ("dFv", "more friction backward than forward"),
    )
    contains = ("coulomb", "viscous")
    depends = ("speed", "direction")
    seen_over = "speed"
    visible = "both directions of motion, at several speeds"
    record = "both directions at several speeds"
    # Half the difference of dry friction is a constant, at rest as well.
    terms = (("constant", "dFc"), ("absolute", "dFv"))
    files = InFiles(
        urdf="friction in URDF is the same in both directions",
        mjcf="damping in MJCF is the same in both directions",
        places=(("constant", "dFc"),),
    )

    def law(self, maths):
        j = self.joint
        # At rest friction is anywhere between its values of the two directions, whose
        # mean is the same constant as in motion.
        if maths.rest is not None:
            return lambda state: (1.0, abs(state.v[j]))
        return lambda state: (1.0 * (state.v[j] != 0), abs(state.v[j]))


class Stribeck(Shaped):
    """Stribeck friction, tau = Fs exp(-abs(v / vs)^k) sign(v).

    What friction has at low speed above its Coulomb level, section 2 of [1]_.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    vs : float, default=0.1
        Stribeck speed [rad/s or m/s].
    k : {1, 2}, default=1
        Exponent.

    References
    ----------
    .. [1] B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, "A survey of models,
       analysis tools and compensation methods for the control of machines with
       friction", Automatica 30(7), 1994. :doi:`10.1016/0005-1098(94)90209-7`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Stribeck
    >>> Stribeck(vs=1.0).fit_transform([[0.1, -1.0, 0.0]]).round(3)
    array([[-0.368]])
    """

    name = "stribeck"
    alike = True
    label = "Stribeck friction"
    formula = r"F_s\,e^{-|v/v_s|^k}\,\mathrm{sign}(v)"
    coefficients = ("Fs",)
    nonnegative = ("Fs",)
    units = (TORQUE,)
    contains = ("coulomb", "viscous")
    continuous = ("vs",)
    shape_units = (("vs", SPEED), ("k", ("", "")))
    positive = ("vs",)
    depends = ("direction",)
    seen_over = "speed"
    visible = "slow motion without standing still, and fast motion"
    record = "slow and fast motion"
    files = InFiles.nowhere("friction that falls with speed")
    terms = (("stribeck", "Fs", "vs", "k"),)

    def __init__(self, joint=0, vs=0.1, k=1):
        super().__init__(joint)
        self.vs = vs
        self.k = k

    def law(self, maths):
        j, vs, k = self.joint, self.vs, self.k
        exp, sign = maths.exp, maths.sign(j)

        def torque(state):
            v = state.v[j]
            return (exp(-(abs(v / vs) ** k)) * sign(v, state.a[j]),)

        return torque

    def shapes(self, motion):
        """Speeds up to two thirds of the fastest, both exponents."""
        fast = motion.speed(self.joint)
        return [{"vs": s * fast, "k": k} for k in (1, 2) for s in _STRIBECK]

    def key(self):
        """Both exponents are one use of the effect."""
        return (self.name, self.joint, ())


class ViscousQuadratic(Effect):
    """Quadratic viscous friction, tau = F2 v abs(v).

    Drag of fans and fluids; its negative, friction that grows less than in proportion
    to speed, as in lubricated gears [1]_.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.

    References
    ----------
    .. [1] A. Carvalho Bittencourt, S. Gunnarsson, "Static friction in a robot joint:
       modeling and identification of load and temperature effects", J. Dyn. Sys.,
       Meas., Control 134(5), 2012. :doi:`10.1115/1.4006589`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import ViscousQuadratic
    >>> ViscousQuadratic().fit_transform([[0.1, -2.0, 0.0]])
    array([[-4.]])
    """

    name = "viscous_quadratic"
    alike = True
    label = "friction with the square of speed"
    formula = r"F_2\,v\,|v|"
    coefficients = ("F2",)
    units = (("N m s^2/rad^2", "N s^2/m^2"),)
    negative = (("F2", "friction that flattens at high speed"),)
    contains = ("viscous", "coulomb")
    depends = ("speed",)
    growth = "curved"
    seen_over = "speed"
    visible = "slow and fast motion"
    record = "slow and fast motion"
    files = InFiles(
        urdf="friction with the square of speed",
        mjcf="friction with the square of speed; MuJoCo 4 takes it as "
        'damping="{damping:.6g} {F2:.6g}" of the joint, which older versions do not '
        "read",
    )
    terms = (("quadratic", "F2"),)

    def law(self, maths):
        j = self.joint
        return lambda state: (state.v[j] * abs(state.v[j]),)


class LoadFriction(_Smoothed):
    """Friction in proportion to the load, tau = mu abs(tau_load) sign(v).

    Gears and bearings press harder under load; section 3 of [1]_. The load is the
    torque of the rigid bodies of the model.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    smoothing : float, default=0.0
        Speed [rad/s or m/s] over which the sign turns; zero is the sign itself.

    References
    ----------
    .. [1] P. Hamon, M. Gautier, P. Garrec, "Dynamic identification of robots with a
       dry friction model depending on load and velocity", IROS, 2010.
       :doi:`10.1109/IROS.2010.5649189`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import LoadFriction
    >>> LoadFriction().fit([[0, 1.0, 0]]).transform([[0, 1.0, 0]], load=[[-3.0]])
    array([[3.]])
    """

    name = "load_friction"
    alike = True
    label = "load-dependent friction"
    formula = (
        r"\mu\,|\tau_\mathrm{load}|\,\mathrm{sign}(v) \quad\text{or}\quad"
        r" \mu\,|\tau_\mathrm{load}| \tanh(v / \mathrm{smoothing})"
    )
    coefficients = ("mu",)
    nonnegative = ("mu",)
    units = (("", ""),)
    contains = ("coulomb", "viscous")
    needs = ("load",)
    depends = ("load", "direction")
    seen_over = "load"
    with_motion = True
    visible = "reversals under different loads"
    record = "reversals at two loads"
    files = InFiles.nowhere("friction in proportion to the load")
    terms = (("load_friction", "mu", "smoothing"),)

    def law(self, maths):
        j, sign = self.joint, maths.sign(self.joint, smoothing=self.smoothing)
        return lambda state: (abs(state.load[j]) * sign(state.v[j], state.a[j]),)


# -- friction and play with a memory ---------------------------------------------------

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
