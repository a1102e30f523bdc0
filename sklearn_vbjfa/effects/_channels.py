"""Effects of the channels: positions and torques that passed different filters."""

from numbers import Real

import numpy as np
import scipy
from sklearn.base import clone

from sklearn_vbjfa.effects._base import TIME, Converted, InFiles, Shaped, Stateful

# Delays to try [s].
_DELAYS = (0.001, 0.002, 0.004, 0.008, 0.016, 0.03)
# Time constants to try, in periods of the low-pass over 2 pi.
_CONSTANTS = (0.2, 0.6, 1.8, 5.4)
# Fastest that a filter can be and still show between samples: its time constant, in
# samples.
_SAMPLES = 0.5
# Without a low-pass, this share of the sample rate is what is let through.
_SLOWEST = 0.1
# A normal weight function is cut off after this many standard deviations.
_TAIL = 4.0
# A coefficient may differ by this factor from what the columns were made with: beyond,
# they stand for something else.
_FACTOR = 2.0


def model_torque(motion, joint):
    """Torque of the model on a joint (n,), or of its rigid bodies where unknown."""
    torque = motion.load if motion.torque is None else motion.torque
    return torque[:, joint]


def low_pass(x, dt, time_constant):
    """First-order low-pass of a signal (n,) between whose samples it is straight."""
    # T dy/dt = x - y, solved exactly, from the state that the first sample would keep.
    left = np.exp(-dt / time_constant)
    mean = time_constant / dt * (1 - left)
    return scipy.signal.lfilter(
        [1 - mean, mean - left], [1, -left], x, zi=mean * x[:1]
    )[0]


def smooth(x, dt, time_constant):
    """Average a signal (n,) with normal weights of a standard deviation [s]."""
    # Beyond its ends the signal keeps its first and last value.
    sigma = time_constant / dt
    reach = int(np.ceil(_TAIL * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return scipy.ndimage.correlate1d(x, weights / weights.sum(), mode="nearest")


class OfChannel(Shaped, Converted, Stateful):
    """What a torque channel reads of another torque than that of the robot.

    The column is its change of the model's torque over its shape parameter, a time [s],
    so that its coefficient is that time again.
    """

    units = (TIME,)
    needs: tuple[str, ...] = ("load", "time")
    # Frequency above which it filters the channel [Hz]; None if it is not a filter.
    corner: float | None = None

    @property
    def _time(self):
        return getattr(self, self.continuous[0])

    def change(self, torque, t):
        """Return what the channel adds to torques (n,) at times t (n,)."""
        raise NotImplementedError(f"{type(self).__name__} must define change.")

    def columns(self, motion):
        self.check()
        torque = model_torque(motion, self.joint)
        parts = [self.change(torque[part], motion.t[part]) for part in motion.parts]
        return np.concatenate(parts)[:, None] / self._time

    def plausible(self, coef):
        found = self.parameters(coef)[self.continuous[0]]
        return 1 / _FACTOR < found / self._time < _FACTOR

    def taken_back(self, coef, torque, t):
        """Take it out of what the channel read, (n,) at times t (n,)."""
        # It reads y = x + B x for the torque x; taken back by the first terms of the
        # series of its inverse, x = y - B y + B^2 y: that restores what a filter lets
        # through without blowing up the noise above.
        share = coef[0] / self._time
        once = share * self.change(torque, t)
        return torque + (share * self.change(once, t) - once)


class Delay(OfChannel):
    """The torque signal lags behind the positions, tau(t - delay).

    To first order the column is -dtau/dt. A smoothing of the torque looks like a delay
    of either signal: where the opposite delay saves nearly as much, a search finds
    none. Source: Ljung (1999), section 10.3.

    Parameters
    ----------
    delay : float, default=0.001
        Shift [s]; negative if the positions lag.
    """

    name = "delay"
    label = "delay of the torque signal"
    formula = r"\tau(t - \mathrm{delay}) - \tau(t)"
    coefficients = ("delay_estimate",)
    named_units = shape_units = (("delay", TIME),)
    continuous = ("delay",)
    record = "fast changes of the torque"
    files = InFiles.nowhere("a channel's time shift; it is not a property of the robot")

    def __init__(self, joint=0, delay=0.001):
        super().__init__(joint)
        self.delay = delay

    def check(self):
        super().check()
        if not (isinstance(self.delay, Real) and 0 < abs(self.delay) < np.inf):
            raise ValueError(f"delay must be finite and not zero; got {self.delay!r}.")

    def natural(self, coef):
        # Short delays differ in the coefficient, and hardly in the shift that the
        # column is made with: the one may be far from the other.
        found = float(coef[0])
        return found / self.delay > 0 and abs(found) < _FACTOR * _DELAYS[-1]

    def opposite(self):
        return clone(self).set_params(delay=-self.delay)

    def key(self):
        return (self.name, self.joint, bool(self.delay > 0))

    def change(self, torque, t):
        return np.interp(t - self.delay, t, torque) - torque

    def taken_back(self, coef, torque, t):
        return np.interp(t + coef[0], t, torque)

    def shapes(self, motion):
        """Delays up to 30 ms, of either signal."""
        return [{"delay": way * d} for d in _DELAYS for way in (1, -1)]

    def parameters(self, coef):
        return {"delay": float(coef[0])}


class TorqueFilter(OfChannel):
    """The torque passed a filter that the positions did not pass, or the reverse.

    The filter F acts on the model's torque, F tau - tau. Where the positions passed it,
    the measured torque is the inverse filter's, to second order tau + (1 - F) tau + (1
    - F)^2 tau. If T is short compared with the motion, the lag is a `Delay` by T, and
    the torque of an `Elastic` joint or a `Jerk` can be the same. Source: Ljung (1999),
    section 14.4.

    Parameters
    ----------
    kind : {"lag", "smooth"}, default="lag"
        A causal low-pass of the first order, T dy/dt = x - y, or an average with normal
        weights of standard deviation T, which delays nothing and leaves half the power
        at sqrt(log 2) / (2 pi T).
    of : {"torque", "position"}, default="torque"
        Which channel passed it.
    time_constant : float, default=0.01
        T [s].
    """

    name = "torque_filter"
    label = "filter of the torque signal"
    formula = (
        r"F\,\tau - \tau, \quad"
        r" F(\omega) = \frac{1}{1 + i\,\omega\,\mathrm{time\_constant}}"
        r" \quad\text{or}\quad e^{-(\omega\,\mathrm{time\_constant})^2 / 2}"
    )
    coefficients = nonnegative = ("time_constant_estimate",)
    named_units = (("time_constant", TIME), ("cutoff", ("Hz", "Hz")))
    shape_units = (("time_constant", TIME),)
    contains = ("delay",)
    choices = (("kind", ("lag", "smooth")), ("of", ("torque", "position")))
    continuous = positive = ("time_constant",)
    record = "fast changes of the torque, both channels unfiltered"
    files = InFiles.nowhere("a channel's filter; it is not a property of the robot")

    def __init__(self, joint=0, kind="lag", of="torque", time_constant=0.01):
        super().__init__(joint)
        self.kind = kind
        self.of = of
        self.time_constant = time_constant

    @property
    def corner(self):
        return _FILTERS[self.kind][1] / self.time_constant

    def natural(self, coef):
        # No frequency leaves a filter larger than it came.
        return 0.0 <= float(coef[0]) <= 2.0 * self.time_constant

    def opposite(self):
        other = "torque" if self.of == "position" else "position"
        return clone(self).set_params(of=other)

    def change(self, torque, t):
        if t.size < 2:
            return np.zeros_like(torque)
        dt = (t[-1] - t[0]) / (t.size - 1)
        filtered, _ = _FILTERS[self.kind]
        change = filtered(torque, dt, self.time_constant) - torque
        if self.of == "torque":
            return change
        # 1 / F = 1 / (1 - (1 - F))
        return filtered(change, dt, self.time_constant) - 2 * change

    def shapes(self, motion):
        """Time constants around what the low-pass lets through."""
        if motion.t.size < 2:
            return []
        dt = np.median(np.diff(motion.t))
        band = min(motion.bandwidth, _SLOWEST / dt)
        return [
            {"kind": kind, "of": of, "time_constant": float(T)}
            for kind in _FILTERS
            for of in ("torque", "position")
            for T in (s / (2 * np.pi * band) for s in _CONSTANTS)
            if T >= _SAMPLES * dt
        ]

    def parameters(self, coef):
        T = float(coef[0])
        if self.kind == "smooth":
            # The column goes with the square of the time constant.
            T = float(np.sqrt(max(T, 0.0) * self.time_constant))
        cutoff = _FILTERS[self.kind][1]
        return {"time_constant": T, "cutoff": float(cutoff / T) if T else np.inf}


# Filters, and the frequency at which 1 s leaves half of the power [Hz].
_FILTERS = {
    "lag": (low_pass, 1 / (2 * np.pi)),
    "smooth": (smooth, np.sqrt(np.log(2.0)) / (2 * np.pi)),
}


class Jerk(Stateful):
    """Torque in proportion to the third derivative of the position, tau = J da/dt.

    Nothing in a rigid body has it. Positions that lag by a time T make it, with J = T
    times the inertia: the torque of the inertia is ahead of them by T da/dt, while the
    reversal of the friction need not be, where it is the drive's own. A torque that
    lags makes it with J < 0, and so does a flexible drive with a damped spring. Source:
    Janot, Gautier and Brunot (2019), data set and models of EMPS.
    """

    name = "jerk"
    label = "third derivative of the position"
    formula = r"J\,\dot a"
    coefficients = ("J",)
    units = (("N m s^3/rad", "N s^3/m"),)
    needs = ("time",)
    record = "fast changes of the acceleration"
    files = InFiles(simulation="it represents a lag of a channel or flexibility")

    def columns(self, motion):
        return motion.derivative(motion.a[:, [self.joint]])
