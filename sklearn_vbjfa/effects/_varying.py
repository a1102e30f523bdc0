"""Effects that vary with time or with a recorded signal."""

import itertools
import math

import numpy as np

from sklearn_vbjfa.effects._base import (
    TIME,
    TORQUE,
    VISCOSITY,
    InFiles,
    OfSignals,
    OfTime,
    OnAllJoints,
    Shaped,
    Sudden,
)
from sklearn_vbjfa.effects._motion import Floats, State

# Declared terms that may vary, and units of the coefficient.
_VARIED = {"coulomb": TORQUE, "offset": TORQUE, "viscous": VISCOSITY}
# Time constants to try, as shares of the recording's length.
_CONSTANTS = (0.1, 0.2, 0.4, 0.8, 3.0, 30.0)
# Number of instants to try; intervals begin and end at every fourth one.
_INSTANTS, _INTERVALS = 20, 4
# Largest distance of a payload's centre of mass from the body's frame [m].
_FARTHEST = 1.0


class Varied(Shaped):
    """Friction or offset times `_factor`, a function of a `State`."""

    contains = ("offset", "coulomb", "viscous")
    choices = (("of", tuple(_VARIED)),)

    def law(self, maths):
        j, factor, sign = self.joint, self._factor(maths), maths.sign(self.joint)
        return {
            "coulomb": lambda state: (factor(state) * sign(state.v[j], state.a[j]),),
            "offset": lambda state: (factor(state),),
            "viscous": lambda state: (factor(state) * state.v[j],),
        }[self.of]

    def simulated(self, table, size):
        factor = self._factor(Floats(None))

        def level(t, signals):
            clipped_t = t if table.since is None else max(t, table.since)
            values = {name: signals(name, t) for name in getattr(self, "recorded", ())}
            return size * factor(State(clipped_t=clipped_t, signals=values))

        return table.add_level(self.joint, self.of, level)


class Drift(Varied, OfTime):
    """Friction or offset that changes while the robot warms up.

    tau = D (exp(-s) / (1 - exp(-S)) - 1 / S) times 1, sign(v) or v, s = (t - begin) / T
    and S = (end - begin) / T: the grease gets thinner, the strain gauge warmer. D is
    the decrease from `begin` to `end`, linear if T is long; the mean between them is
    that of `Offset`, `Coulomb` and `Viscous`. After the last time of the fit it
    continues to decay, before the first it is constant. Source: Carvalho Bittencourt
    and Gunnarsson (2012), :doi:`10.1115/1.4006589`.

    Parameters
    ----------
    of : {"coulomb", "offset", "viscous"}, default="coulomb"
        What drifts.
    time_constant : float, default=100.0
        T [s] of the decay.
    begin, end : float, default=0.0 and infinity
        Times [s] between which its mean is zero; with infinity D exp(-(t - begin) / T).
        A search uses the first and the last time that it fits.
    """

    name = "drift"
    label = "drift with time"
    formula = (
        r"D \left(\frac{e^{-s}}{1 - e^{-S}} - \frac{1}{S}\right) f, \quad"
        r" f = \mathrm{sign}(v),\ 1\ \text{or}\ v"
    )
    coefficients = ("D",)
    shape_units = (("time_constant", TIME), ("begin", TIME), ("end", TIME))
    continuous = positive = ("time_constant",)
    tuned = ("time_constant", "begin", "end")
    record = "the same motion cold and warm"
    files = InFiles.nowhere("varies with time; the file has the mean from begin to end")

    def __init__(
        self, joint=0, of="coulomb", time_constant=100.0, begin=0.0, end=np.inf
    ):
        super().__init__(joint)
        self.of = of
        self.time_constant = time_constant
        self.begin = begin
        self.end = end

    def check(self):
        super().check()
        if not -np.inf < self.begin < self.end:
            raise ValueError(f"begin must be below end; got {self.begin}, {self.end}.")

    units = property(lambda self: (_VARIED[self.of],))

    def _factor(self, maths):
        exp, constant, begin = maths.exp, self.time_constant, self.begin
        length = (self.end - begin) / constant
        size, mean = -1.0 / math.expm1(-length), 1.0 / length
        return lambda state: size * exp((begin - state.clipped_t) / constant) - mean

    def shapes(self, motion):
        """Time constants from a tenth of the recording to a linear change."""
        begin, end = self.begin, self.end
        if not np.isfinite(end):
            begin, end = float(motion.t[0]), float(motion.t[-1])
        return [
            {"of": of, "time_constant": s * (end - begin), "begin": begin, "end": end}
            for of in _VARIED
            for s in _CONSTANTS
        ]


class Signal(Varied, OfSignals):
    """Friction or offset that varies with a recorded signal.

    tau = k (s - reference) times 1, sign(v) or v: s is a recorded column, such as the
    temperature of a gear, the supply voltage, a load cell, or the state of a tool. The
    value at the reference is that of `Offset`, `Coulomb` and `Viscous`. It is not
    identifiable if the signal only rises or falls, as a drift with time does, or if it
    is a function of the joint's state. Source: Carvalho Bittencourt and Gunnarsson
    (2012), :doi:`10.1115/1.4006589`.

    Parameters
    ----------
    signal : str, default=""
        Name of the recorded column s. A search tries all recorded signals.
    of : {"coulomb", "offset", "viscous"}, default="coulomb"
        What varies.
    reference : float, default=0.0
        Value of the signal, in its unit, around which it varies; its mean in a search.
    """

    name = "signal"
    label = "variation with a recorded signal"
    formula = (
        r"k\,(s - \mathrm{reference})\,f, \quad"
        r" f = \mathrm{sign}(v),\ 1\ \text{or}\ v"
    )
    coefficients = ("k",)
    split_by = ("signal", "of")
    tuned = ("reference",)  # its value only changes the coefficient of the plain term
    record = "the same motion at several values of the signal, rising and falling"
    files = InFiles.nowhere(
        "varies with a recorded signal; the file has what holds at its reference"
    )

    def __init__(self, joint=0, signal="", of="coulomb", reference=0.0):
        super().__init__(joint)
        self.signal = signal
        self.of = of
        self.reference = reference

    @property
    def units(self):
        of = self.signal or "the signal"
        return (tuple(f"{unit} per unit of {of}" for unit in _VARIED[self.of]),)

    @property
    def slow(self):
        """Whether the torque is proportional to the signal alone."""
        return self.of == "offset"

    recorded = property(lambda self: (self.signal,) if self.signal else ())

    def applies(self, motion):
        if not self.signal:
            # Not "needs": reports do not advise to record signals.
            return "" if motion.signals else "the recording has no signals"
        if self.signal in motion.signals:
            return ""
        return (
            f"needs the recorded signal {self.signal!r}; give it in signals, one value "
            "per row, or as a column of X"
        )

    def _factor(self, maths):
        name, reference = self.signal, self.reference
        return lambda state: state.signals[name] - reference

    def shapes(self, motion):
        """All signals that vary, with each term that they may change."""
        return [
            {"signal": name, "of": of, "reference": float(np.mean(values))}
            for name, values in motion.signals.items()
            if np.ptp(values) > 0
            for of in _VARIED
        ]


class Payload(Sudden, OnAllJoints):
    """Mass and first moments of the last body of a branch change at an instant.

    tau = Phi_n(q, v, a) (dm, dmcx, dmcy, dmcz, dI) for instant <= t < until, with the
    columns of that body's regressor: something was picked up or put down. It is
    modelled as a ball at its centre of mass c = dmc / dm, whose inertia in the body's
    frame is dm (c'c 1 - c c') + d 1: the first part follows from mass and moments, to
    first order around `centre`; d, about the centre, is a coefficient. Source: Khalil,
    Gautier and Lemoine (2007), :doi:`10.1109/ROBOT.2007.364241`.

    Parameters
    ----------
    instant : float, default=0.0
        Time of the change [s].
    until : float, default=None
        Time at which the body is as before again [s]; None for never.
    centre : tuple of three floats, default=(0.0, 0.0, 0.0)
        Centre of mass [m] in the body's frame where the inertia is linearised.
    """

    name = "payload"
    label = "change of payload"
    formula = (
        r"\Phi_n(q, v, a)\,\Delta\pi(dm, dmc_x, dmc_y, dmc_z, d) \quad"
        r" \text{for}\ \mathrm{until} > t \ge \mathrm{instant}"
    )
    coefficients = ("dm", "dmcx", "dmcy", "dmcz", "d")
    units = (("kg", "kg"),) + (("kg m", "kg m"),) * 3 + (("kg m^2", "kg m^2"),)
    needs = ("end_bodies", "time")
    record = "motion against gravity with and without payload"
    files = InFiles.nowhere("a change at an instant; the file has the robot before it")

    def __init__(self, joint=0, instant=0.0, until=None, centre=(0.0, 0.0, 0.0)):
        super().__init__(joint)
        self.instant = instant
        self.until = until
        self.centre = centre

    def shape(self):
        """Return the times; the centre is only the point of linearisation."""
        return dict(zip(("instant", "until"), (t for t, _ in self.changes)))

    def applies(self, motion):
        ends = motion.end_bodies or (self.joint,)
        wrong = "" if self.joint in ends else "only the last body of a branch has one"
        return super().applies(motion) or wrong

    def columns(self, motion):
        carried = sum(sign * (motion.t >= t) for t, sign in self.changes)
        columns = motion.end_bodies[self.joint]() @ _jacobian(self.centre)
        return columns * carried[:, None, None]

    def inertial(self, coef):
        """Return the changes (10,) of the body's inertial parameters."""
        return _jacobian(self.centre) @ np.asarray(coef)

    def simulated(self, table, *coef):
        for t, sign in self.changes:
            table.payloads.append((float(t), self.joint, sign * self.inertial(coef)))
        return True

    def linearised_at(self, coef):
        """Linearise the inertia at the estimated centre of mass."""
        mass, *moments = coef[:4]
        centre = np.array(moments) / mass if mass else np.zeros(3)
        # A centre farther out means that mass and moments are hardly determined.
        if not np.linalg.norm(centre) <= _FARTHEST:
            return self
        return Payload(self.joint, self.instant, self.until, tuple(map(float, centre)))

    def shapes(self, motion):
        """Instants that cover the recording, and intervals between some of these."""
        t, starts = motion.t, motion.later
        grid = np.linspace(t[0], t[-1], _INSTANTS + 2)[1:-1]
        # All instants between two recordings are equivalent to the second one's start.
        between = np.isin(np.searchsorted(t, grid), np.searchsorted(t, starts))
        instants = np.unique(np.concatenate([grid[~between], starts]))
        pairs = itertools.combinations(grid[1::_INTERVALS].tolist(), 2)
        intervals = [{"instant": begin, "until": end} for begin, end in pairs]
        return [{"instant": float(s)} for s in instants] + intervals


def _jacobian(c):
    """Inertial parameters (10, 5) by mass, first moments and inertia of a ball."""
    # The inertia (s's 1 - s s') / m of a point is homogeneous in mass m and moments
    # s, so that its tangent at s = m c passes through zero.
    c, eye, out = np.asarray(c, dtype=float), np.eye(3), np.zeros((10, 5))
    out[:4, :4] = np.eye(4)
    slopes = [np.outer(c, c) - (c @ c) * eye]
    slopes += [2 * x * eye - np.outer(e, c) - np.outer(c, e) for x, e in zip(c, eye)]
    for column, slope in enumerate([*slopes, eye]):
        # Ixx, Ixy, Iyy, Ixz, Iyz, Izz
        out[4:, column] = slope[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return out
