"""Effects of measurement channels: delays and filters of positions or torques."""

from numbers import Real

import numpy as np
import scipy
from sklearn.base import clone

from sklearn_vbjfa.effects._base import TIME, Converted, InFiles, Shaped, Stateful

# Delays to try [s].
_DELAYS = (0.001, 0.002, 0.004, 0.008, 0.016, 0.03)
# Time constants to try, in units of 1 / (2 pi cut-off of the low-pass).
_CONSTANTS = (0.2, 0.6, 1.8, 5.4)
# Smallest time constant of a filter that samples identify, in sample periods.
_SMALLEST = 0.5
# Largest bandwidth of the motion, as a share of the sample rate.
_BANDWIDTH = 0.1
# Gaussian weights are truncated after this many standard deviations.
_TAIL = 4.0
# Largest plausible ratio of a coefficient to the value with which its columns were
# computed, and of the reverse.
_FACTOR = 2.0


def model_torque(motion, joint):
    """Torque of the whole model on a joint (n,), or else of its rigid bodies."""
    torque = motion.load if motion.torque is None else motion.torque
    return torque[:, joint]


def low_pass(x, dt, time_constant):
    """First-order low-pass of a signal (n,) that is linear between its samples."""
    # Exact solution of T dy/dt = x - y, with the steady state of the first sample.
    decay = np.exp(-dt / time_constant)
    mean = time_constant / dt * (1 - decay)
    return scipy.signal.lfilter(
        [1 - mean, mean - decay], [1, -decay], x, zi=mean * x[:1]
    )[0]


def smooth(x, dt, time_constant):
    """Average a signal (n,) with Gaussian weights of a standard deviation [s]."""
    # The signal is extended by its first and last value.
    sigma = time_constant / dt
    half_width = int(np.ceil(_TAIL * sigma))
    weights = np.exp(-0.5 * (np.arange(-half_width, half_width + 1) / sigma) ** 2)
    return scipy.ndimage.correlate1d(x, weights / weights.sum(), mode="nearest")


class OfChannel(Shaped, Converted, Stateful):
    """Error of a torque channel that does not measure the torque of the robot.

    The column is its change of the model's torque over its shape parameter, a time [s],
    so that its coefficient is an estimate of the same time.
    """

    units = (TIME,)
    needs: tuple[str, ...] = ("load", "time")
    # Cut-off frequency of a filter [Hz]; None for other effects.
    corner: float | None = None

    _time = property(lambda self: getattr(self, self.continuous[0]))

    def change(self, torque, t):
        """Return the change of torques (n,) at times t (n,) by the channel."""
        raise NotImplementedError(f"{type(self).__name__} must define change.")

    def columns(self, motion):
        self.check()
        torque = model_torque(motion, self.joint)
        parts = [self.change(torque[part], motion.t[part]) for part in motion.parts]
        return np.concatenate(parts)[:, None] / self._time

    def plausible(self, coef):
        estimate = self.parameters(coef)[self.continuous[0]]
        return 1 / _FACTOR < estimate / self._time < _FACTOR

    def corrected(self, coef, torque, t):
        """Remove the effect from recorded torques (n,) at times t (n,)."""
        # The channel records y = x + B x for the torque x. The first terms of the
        # series of the inverse, x = y - B y + B^2 y, restore the pass-band of a filter
        # without amplifying the noise above it.
        scale = coef[0] / self._time
        change = scale * self.change(torque, t)
        return torque + (scale * self.change(change, t) - change)


class Delay(OfChannel):
    """The torque signal lags behind the positions, tau(t - delay).

    To first order the column is -dtau/dt. Source: Ljung (1999), section 10.3.

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
        # Columns of short delays are nearly proportional, so that the coefficient may
        # differ much from the delay with which the column was computed.
        estimate = float(coef[0])
        return estimate / self.delay > 0 and abs(estimate) < _FACTOR * _DELAYS[-1]

    def opposite(self):
        return clone(self).set_params(delay=-self.delay)

    def key(self):
        return (self.name, self.joint, bool(self.delay > 0))

    def change(self, torque, t):
        return np.interp(t - self.delay, t, torque) - torque

    def corrected(self, coef, torque, t):
        return np.interp(t + coef[0], t, torque)

    def shapes(self, motion):
        """Delays up to 30 ms, of either signal."""
        return [{"delay": sign * d} for d in _DELAYS for sign in (1, -1)]

    def parameters(self, coef):
        return {"delay": float(coef[0])}


class TorqueFilter(OfChannel):
    """The torque was filtered and the positions were not, or the reverse.

    The filter F acts on the model's torque, F tau - tau. If the positions were
    filtered, the measured torque is the inverse filter's, to second order tau + (1 - F)
    tau + (1 - F)^2 tau. If T is short compared with the motion, the lag equals a
    `Delay` by T, and an `Elastic` joint or a `Jerk` may have the same torque. Source:
    Ljung (1999), section 14.4.

    Parameters
    ----------
    kind : {"lag", "smooth"}, default="lag"
        A causal first-order low-pass, T dy/dt = x - y, or an average with Gaussian
        weights of standard deviation T, which has no delay and half the power at
        sqrt(log 2) / (2 pi T).
    of : {"torque", "position"}, default="torque"
        Channel that was filtered.
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
        # The gain of a filter is at most 1 at all frequencies.
        return 0.0 <= float(coef[0]) <= 2.0 * self.time_constant

    def opposite(self):
        other = "torque" if self.of == "position" else "position"
        return clone(self).set_params(of=other)

    def change(self, torque, t):
        if t.size < 2:
            return np.zeros_like(torque)
        dt = (t[-1] - t[0]) / (t.size - 1)
        apply_filter, _ = _FILTERS[self.kind]
        change = apply_filter(torque, dt, self.time_constant) - torque
        if self.of == "torque":
            return change
        # 1 / F = 1 / (1 - (1 - F))
        return apply_filter(change, dt, self.time_constant) - 2 * change

    def shapes(self, motion):
        """Time constants around that of the low-pass."""
        if motion.t.size < 2:
            return []
        dt = np.median(np.diff(motion.t))
        band = min(motion.bandwidth, _BANDWIDTH / dt)
        return [
            {"kind": kind, "of": of, "time_constant": float(T)}
            for kind in _FILTERS
            for of in ("torque", "position")
            for T in (s / (2 * np.pi * band) for s in _CONSTANTS)
            if T >= _SMALLEST * dt
        ]

    def parameters(self, coef):
        T = float(coef[0])
        if self.kind == "smooth":
            # The column is proportional to the square of the time constant.
            T = float(np.sqrt(max(T, 0.0) * self.time_constant))
        cutoff = _FILTERS[self.kind][1]
        return {"time_constant": T, "cutoff": float(cutoff / T) if T else np.inf}


# Filters, and their half-power frequencies at a time constant of 1 s [Hz].
_FILTERS = {
    "lag": (low_pass, 1 / (2 * np.pi)),
    "smooth": (smooth, np.sqrt(np.log(2.0)) / (2 * np.pi)),
}


class Jerk(Stateful):
    """Torque proportional to the third derivative of the position, tau = J da/dt.

    Rigid bodies have no such torque. Positions that lag by a time T cause it, with J =
    T times the inertia: the inertial torque leads by T da/dt, while friction in the
    drive need not reverse earlier. A torque that lags causes it with J < 0, as does a
    flexible drive with a damped spring. Source:
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
