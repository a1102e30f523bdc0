"""Effects that depend on the position."""

import numpy as np

from sklearn_vbjfa.effects._base import POSITION, STIFFNESS, TORQUE, Effect, JointEffect

# Longest and shortest period to try: of a revolute joint [rad], and as shares of the
# range of a prismatic one.
_LONGEST, _SHORTEST = np.radians(75.0), np.radians(2.0)
# Neighbouring periods differ by this many cycles over the range of the motion.
_CYCLES = 0.3


class Offset(JointEffect):
    """Constant torque, tau = c: a sensor's zero, a drive's bias.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.

    References
    ----------
    .. [1] W. Khalil, E. Dombre, "Modeling, Identification and Control of Robots",
       Butterworth-Heinemann, 2004, chapter 12.

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Offset
    >>> Offset().fit_transform([[0.1, -2.0, 0.0]])
    array([[1.]])
    """

    name = "offset"
    label = "constant offset"
    formula = r"c"
    coefficients = ("c",)
    units = (TORQUE,)
    visible = "any motion, unless gravity is constant on the joint as well"
    record = "motion with and against gravity"

    def column(self, v, a, rest=None):
        """Return ones; see `JointEffect.column`."""
        return np.ones_like(v)


class Spring(Effect):
    """Linear spring, tau = k (q - q0): balancing springs, hoses, cables, flexures.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.

    Notes
    -----
    The torque that the drive must produce; the spring's own is -k (q - q0).

    References
    ----------
    .. [1] W. Khalil, E. Dombre, "Modeling, Identification and Control of Robots",
       Butterworth-Heinemann, 2004, chapter 9.

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Spring
    >>> Spring().fit_transform([[0.1, -2.0, 0.0]])
    array([[0.1, 1. ]])
    >>> Spring().parameters([2.0, -1.0])
    {'k': 2.0, 'q0': 0.5}
    """

    name = "spring"
    label = "spring"
    formula = r"k\,(q - q_0)"
    coefficients = ("k", "c")
    units = (STIFFNESS, TORQUE)
    named_units = (("k", STIFFNESS), ("q0", POSITION))
    contains = ("offset",)
    depends = ("position",)
    visible = "a wide range of positions"
    record = "a wide range of positions"

    def columns(self, motion):
        """Position and one; see `Effect.columns`."""
        q = motion.q[:, [self.joint]]
        return np.hstack([q, np.ones_like(q)])

    def parameters(self, coef):
        """Stiffness and position at rest; see `Effect.parameters`."""
        k, c = (float(x) for x in coef)
        return {"k": k, "q0": -c / k if k else np.nan}


class Counterbalance(Effect):
    """Counterbalance, tau = a cos q + b sin q + c cos 2q + d sin 2q + e.

    Hydraulic, gas-spring and weight balancers between a link and a fixed point: the
    force times its lever arm is a periodic function of the angle, of which two
    harmonics are kept [1]_.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.

    References
    ----------
    .. [1] W. Khalil, E. Dombre, "Modeling, Identification and Control of Robots",
       Butterworth-Heinemann, 2004, chapter 9.

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Counterbalance
    >>> Counterbalance().fit_transform([[0.0, -2.0, 0.0]])
    array([[1., 0., 1., 0., 1.]])
    """

    name = "counterbalance"
    label = "counterbalance"
    formula = r"a \cos q + b \sin q + c \cos 2q + d \sin 2q + e"
    coefficients = ("a", "b", "c", "d", "e")
    units = (TORQUE,) * 5
    contains = ("offset", "spring")
    depends = ("position",)
    curved = True
    visible = "a range of positions of some 60 degrees"
    record = "a wide range of positions"

    def applies(self, motion):
        """Only a revolute joint has an angle; see `Effect.applies`."""
        if motion.prismatic[self.joint]:
            return "a prismatic joint has no angle"
        return super().applies(motion)

    def columns(self, motion):
        """Two harmonics of the angle, and one; see `Effect.columns`."""
        q = motion.q[:, [self.joint]]
        harmonics = [np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)]
        return np.hstack([*harmonics, np.ones_like(q)])


class Ripple(Effect):
    """Periodic torque, tau = A cos(2 pi q / period - phase).

    Cogging of motors, teeth of gears, the waves of a harmonic drive [1]_.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    period : float, default=0.1
        Period [rad or m].

    References
    ----------
    .. [1] T. D. Tuttle, W. P. Seering, "A nonlinear model of a harmonic drive gear
       transmission", IEEE Trans. Robotics and Automation 12(3), 1996.

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Ripple
    >>> Ripple(period=0.4).fit_transform([[0.2, -2.0, 0.0]]).round(9)
    array([[-1.,  0.]])
    """

    name = "ripple"
    label = "torque ripple"
    formula = r"A \cos(2 \pi q / \mathrm{period} - \mathrm{phase})"
    coefficients = ("c", "s")
    units = (TORQUE, TORQUE)
    named_units = (("A", TORQUE), ("phase", ("rad", "rad")))
    shape_units = (("period", POSITION),)
    contains = ("offset",)
    continuous = ("period",)
    positive = ("period",)
    depends = ("position",)
    curved = True
    visible = "motion across several periods, slow enough for the low-pass"
    record = "slow motion over the whole range"

    def __init__(self, joint=0, period=0.1):
        super().__init__(joint)
        self.period = period

    def columns(self, motion):
        """Cosine and sine; see `Effect.columns`."""
        angle = 2 * np.pi / self.period * motion.q[:, [self.joint]]
        return np.hstack([np.cos(angle), np.sin(angle)])

    def shapes(self, motion):
        """Periods that the motion crosses and the low-pass lets through."""
        reach = motion.range(self.joint)
        if not reach > 0:
            return []
        # Two periods are a bend of the spring, and no ripple.
        longest = reach / 2.5
        shortest = reach / 60.0
        if not motion.prismatic[self.joint]:
            longest = min(longest, _LONGEST)
            shortest = max(shortest, _SHORTEST)
        # The slower fifth of the motion must take longer for a period than what the
        # low-pass lets through.
        moving = np.abs(motion.v[:, self.joint])
        slow = np.quantile(moving[moving > 0.02 * motion.speed(self.joint)], 0.2)
        shortest = max(shortest, slow / motion.bandwidth)
        if not shortest < longest:
            return []
        waves = np.arange(1 / longest, 1 / shortest, _CYCLES / reach)
        return [{"period": float(1 / w)} for w in waves]

    def parameters(self, coef):
        """Amplitude and phase; see `Effect.parameters`."""
        c, s = (float(x) for x in coef)
        return {"A": float(np.hypot(c, s)), "phase": float(np.arctan2(s, c))}
