"""Effects that depend on the position."""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.effects._base import (
    ANGLE,
    POSITION,
    RATIO,
    STIFFNESS,
    TORQUE,
    Converted,
    InFiles,
    Shaped,
)

# Longest and shortest period of a ripple to try on a revolute joint [rad], the shortest
# of a peak above the low-pass (twice the teeth of a harmonic drive), and the largest
# number of periods in the range of the motion, of a ripple and of friction.
_LONGEST, _SHORTEST, _FINEST = np.radians([75.0, 2.0, 0.5])
_MOST_RIPPLES, _MOST_FRICTION = 60.0, 6.0
# Linkages to try: ratios of the distances from the axis, and angles [degrees].
_RATIOS = (0.2, 0.5, 0.85)
_ANGLES = tuple(range(0, 360, 15))
# Difference of adjacent periods of the grid, in cycles over the range of the motion.
_CYCLES = 0.3


class Spring(Converted):
    """Linear spring, tau = k (q - q0): balancing springs, hoses, cables, flexures.

    This is the torque of the drive; the spring's own torque is -k (q - q0). The torque
    offset of the joint is part of k q0. Source: Khalil and Dombre (2004), chapter 9.
    """

    name = "spring"
    label = "spring"
    formula = r"k\,(q - q_0)"
    coefficients = ("k", "c")
    units = (STIFFNESS, TORQUE)
    named_units = (("k", STIFFNESS), ("q0", POSITION))
    contains = ("offset",)
    depends = ("position",)
    record = "a wide range of positions"
    terms = (("spring", "k"), ("constant", "c"))
    files = InFiles(urdf="URDF has no spring", mjcf="", places=terms)

    def law(self, maths):
        j = self.joint
        return lambda state: (state.q[j], 1.0)

    def parameters(self, coef):
        k, c = (float(x) for x in coef)
        return {"k": k, "q0": -c / k if k else np.nan}


class Counterbalance(Shaped):
    """Counterbalance: hydraulic, gas spring, coil spring or weight on a linkage.

    The balancer pulls between a point of the link, at the distance r from the joint's
    axis, and a fixed point at the distance L. With x = q - angle, such that the points
    are nearest at x = 0, and ratio = r / L, its length is L l(x) and the drive must
    produce tau = (Fr / l + krL) sin x, l = sqrt(1 + ratio^2 - 2 ratio cos x): Fr
    for the part of the force that does not depend on the length, times r, and krL for
    the stiffness, times r and L. A gas spring pushes (Fr < 0).

    Any other balancer that turns with the joint is a periodic function of the angle.
    Two harmonics are kept: tau = a cos q + b sin q + c cos 2q + d sin 2q + e. Source:
    Khalil and Dombre (2004), chapter 9 (harmonics); law of cosines (linkage).

    Parameters
    ----------
    form : {"harmonics", "linkage"}, default="harmonics"
        Two harmonics, or the geometry of a linkage.
    ratio : float, default=0.5
        Shorter distance from the axis over the longer one, for a linkage.
    angle : float, default=0.0
        Position [rad] in which the two points are nearest, for a linkage.
    """

    name = "counterbalance"
    label = "counterbalance"
    formula = (
        r"(F_r / l + k_{rL}) \sin x, \quad x = q - \mathrm{angle},"
        r" \quad l^2 = 1 + \mathrm{ratio}^2 - 2\,\mathrm{ratio} \cos x"
        r"\quad \text{or} \quad a \cos q + b \sin q + c \cos 2q + d \sin 2q + e"
    )
    shape_units = (("ratio", RATIO), ("angle", ANGLE))
    contains = ("offset", "spring")
    choices = (("form", ("harmonics", "linkage")),)
    cyclic = ("angle",)
    depends = ("position",)
    bounded = True
    record = "a range of positions of 60 degrees or more"

    def __init__(self, joint=0, form="harmonics", ratio=0.5, angle=0.0):
        super().__init__(joint)
        self.form = form
        self.ratio = ratio
        self.angle = angle

    @property
    def coefficients(self):
        return ("Fr", "krL") if self.form == "linkage" else ("a", "b", "c", "d", "e")

    @property
    def terms(self):
        if self.form == "linkage":
            return (("linkage", "Fr", "krL", "ratio", "angle"),)
        return (("harmonics", "a", "b", "c", "d"), ("constant", "e"))

    units = property(lambda self: (TORQUE,) * len(self.coefficients))
    continuous = property(lambda self: ("ratio", "angle") * (self.form == "linkage"))

    def check(self):
        super().check()
        if not 0 < self.ratio < 1:
            raise ValueError(
                f"ratio of {self.name} must lie between 0 and 1; got {self.ratio!r}."
            )

    def shape(self):
        return {"form": self.form} | {n: getattr(self, n) for n in self.continuous}

    def excludes(self):
        ((_, forms),) = self.choices
        return {clone(self).set_params(form=form).key() for form in forms}

    def applies(self, motion):
        if motion.prismatic[self.joint]:
            return "a prismatic joint has no angle"
        return super().applies(motion)

    def law(self, maths):
        self.check()
        j, ratio, angle = self.joint, self.ratio, self.angle
        cos, sin, sqrt = maths.cos, maths.sin, maths.sqrt

        def linkage(state):
            x = state.q[j] - angle
            s = sin(x)
            return s / sqrt(1 + ratio**2 - 2 * ratio * cos(x)), s

        def harmonics(state):
            q = state.q[j]
            return cos(q), sin(q), cos(2 * q), sin(2 * q), 1.0

        return linkage if self.form == "linkage" else harmonics

    def shapes(self, motion):
        """Linkages at all angles, and the harmonics."""
        linkages = [
            {"form": "linkage", "ratio": ratio, "angle": float(angle)}
            for ratio in _RATIOS
            for angle in np.radians(_ANGLES)
        ]
        return [{"form": "harmonics"}, *linkages]


class Ripple(Shaped, Converted):
    """Periodic torque, tau = A cos(2 pi q / period - phase).

    Cogging of motors, teeth of gears, waves of a harmonic drive. A joint may have
    several, whose periods differ by more than half an octave. Source: Tuttle and
    Seering (1996), a model of the harmonic drive.

    Parameters
    ----------
    period : float, default=0.1
        Period [rad or m].
    """

    name = "ripple"
    label = "torque ripple"
    formula = r"A \cos(2 \pi q / \mathrm{period} - \mathrm{phase})"
    coefficients = ("c", "s")
    units = (TORQUE, TORQUE)
    named_units = (("A", TORQUE), ("phase", ANGLE))
    shape_units = (("period", POSITION),)
    contains = ("offset",)
    continuous = positive = ("period",)
    depends: tuple[str, ...] = ("position",)
    bounded = True
    record = "slow motion across several periods"
    terms = (("ripple", "c", "s", "period"),)

    def __init__(self, joint=0, period=0.1):
        super().__init__(joint)
        self.period = period

    def law(self, maths):
        j, scale, cos, sin = self.joint, 2 * np.pi / self.period, maths.cos, maths.sin

        def torque(state):
            angle = scale * state.q[j]
            return cos(angle), sin(angle)

        return torque

    @property
    def _octave(self):
        """Index of the half octave that holds the period."""
        return int(np.floor(2 * np.log2(self.period)))

    def key(self):
        """All periods of a half octave are one effect of the joint."""
        return (self.name, self.joint, self._octave)

    def excludes(self):
        return {(self.name, self.joint, self._octave + step) for step in (-1, 0, 1)}

    def shapes(self, motion):
        """Periods that the motion covers and the low-pass transmits."""
        reach = motion.range(self.joint)
        if not reach > 0:
            return []
        revolute = not motion.prismatic[self.joint]
        longest, shortest = self._period_limits(reach, revolute)
        # In the slowest fifth of the motion, its frequency must be below the low-pass.
        speed = np.abs(motion.v[:, self.joint])
        slow = np.quantile(speed[speed > 0.02 * motion.speed(self.joint)], 0.2)
        shortest = max(shortest, slow / motion.bandwidth)
        frequencies = np.arange(1 / longest, 1 / shortest, _CYCLES / reach)
        peaks = np.zeros(0) if motion.waves is None else motion.waves[self.joint]
        peaks = peaks[(peaks * longest > 1) & (peaks * _FINEST * revolute < 1)]
        around = peaks[:, None] + np.array([-1, 0, 1]) * _CYCLES / reach
        return [{"period": float(1 / f)} for f in (*frequencies, *around.ravel())]

    @staticmethod
    def _period_limits(reach, revolute):
        """Return the longest and the shortest period for a range of positions."""
        if revolute:
            return min(reach, _LONGEST), max(reach / _MOST_RIPPLES, _SHORTEST)
        return reach, reach / _MOST_RIPPLES

    def parameters(self, coef):
        c, s = (float(x) for x in coef)
        return {"A": float(np.hypot(c, s)), "phase": float(np.arctan2(s, c))}


class FrictionByPosition(Ripple):
    """Dry friction whose level varies with the position, A cos(...) sign(v).

    An eccentric wheel, a bent screw, or a seal with uneven friction. The mean
    is that of `Coulomb`; the longest period is a turn. Source: Armstrong-Helouvry,
    Dupont and Canudas de Wit (1994), section 2, :doi:`10.1016/0005-1098(94)90209-7`.

    Parameters
    ----------
    period : float, default=0.1
        Period [rad or m].
    """

    name = "friction_by_position"
    label = "friction that varies with position"
    formula = r"A \cos(2 \pi q / \mathrm{period} - \mathrm{phase})\,\mathrm{sign}(v)"
    contains = ("coulomb",)
    depends = ("position", "direction")
    record = "motion back and forth over the whole range"
    terms = (("dry_ripple", "c", "s", "period"),)

    def key(self):
        """All periods are one effect of the joint."""
        return (self.name, self.joint, ())

    def excludes(self):
        return {self.key()}

    def law(self, maths):
        j, ripple, sign = self.joint, super().law(maths), maths.sign(self.joint)

        def torque(state):
            direction = sign(state.v[j], state.a[j])
            return tuple(direction * column for column in ripple(state))

        return torque

    @staticmethod
    def _period_limits(reach, revolute):
        return (2 * np.pi if revolute else 2 * reach), reach / _MOST_FRICTION
