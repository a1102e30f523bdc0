"""Effects that vary with what was recorded beside the motion."""

import numpy as np

from sklearn_vbjfa.effects._base import TORQUE, VISCOSITY, Effect
from sklearn_vbjfa.effects._friction import Coulomb, Viscous

# What a signal may vary: in words, and the units of its coefficient.
_VARIED = {
    "coulomb": (Coulomb.label, TORQUE),
    "offset": ("offset", TORQUE),
    "viscous": (Viscous.label, VISCOSITY),
}


class Signal(Effect):
    """Friction or offset that varies with a recorded signal.

    tau = k (s - reference) times 1, sign(v) or v: s is a column that was recorded
    beside the motion, such as the temperature of a gear [1]_, the supply voltage, a
    load cell, or the state of a tool. To first order, whatever the law: what there is
    at the reference is left to `Offset`, `Coulomb` and `Viscous`.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    signal : str, default=""
        Name of the recorded column s. A search tries all columns that it is given.
    of : {"coulomb", "offset", "viscous"}, default="coulomb"
        What varies.
    reference : float, default=0.0
        Value of the signal, in its own unit, around which it varies. A search takes the
        mean over the recording; it is not tuned.

    Notes
    -----
    It shows where the signal takes several values in like motion. It is hidden where
    the signal only rises or falls, as then a drift with time explains as much, and
    where it follows the state of the joint.

    References
    ----------
    .. [1] A. Carvalho Bittencourt, S. Gunnarsson, "Static friction in a robot joint:
       modeling and identification of load and temperature effects", J. Dyn. Sys.,
       Meas., Control 134(5), 2012. :doi:`10.1115/1.4006589`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Signal
    >>> warm = Signal(signal="temperature", of="viscous", reference=30.0)
    >>> X = [[0.0, 2.0, 0.0], [0.0, 2.0, 0.0]]
    >>> warm.fit(X).transform(X, signals={"temperature": [30.0, 35.0]}).ravel()
    array([ 0., 10.])
    """

    name = "signal"
    label = "variation with a recorded signal"
    formula = (
        r"k\,(s - \mathrm{reference})\,f, \quad"
        r" f = \mathrm{sign}(v),\ 1\ \text{or}\ v"
    )
    coefficients = ("k",)
    contains = ("offset", "coulomb", "viscous")
    needs = ("signals",)
    apart = ("signal", "of")
    seen_over = "signal"
    visible = "the same motion at several values of the signal, which rises and falls"
    record = "the same motion at several values of the signal, in mixed order"

    def __init__(self, joint=0, signal="", of="coulomb", reference=0.0):
        super().__init__(joint)
        self.signal = signal
        self.of = of
        self.reference = reference

    @property
    def units(self):
        """Units of k, for a revolute and for a prismatic joint."""
        _, units = self._varied()
        of = self.signal or "the signal"
        return (tuple(f"{unit} per unit of {of}" for unit in units),)

    @property
    def trend(self):
        """Whether the signal alone is a torque; see `Effect.trend`."""
        return self.of == "offset"

    @property
    def with_motion(self):
        """Whether what varies is a friction; see `Effect.with_motion`."""
        return self.of != "offset"

    @property
    def recorded(self):
        """The signal, if it is set; see `Effect.recorded`."""
        return (self.signal,) if self.signal else ()

    @classmethod
    def describe(cls, shape, joint_label):
        """Say what varies with which signal; see `Effect.describe`."""
        signal, of = shape.get("signal"), shape.get("of")
        if not signal:
            return cls.label
        if of not in _VARIED:
            return f"variation with {signal}"
        return f"{_VARIED[of][0]} that varies with {signal}"

    def told_beside(self, other):
        """Name the signal, and what varies if that differs; see `Effect`."""
        told = f"{self.name}: {self.signal}"
        alike = isinstance(other, Signal) and other.of == self.of
        return told if alike else f"{told}, {self.of}"

    def key(self):
        """Tell two uses of the effect apart; see `Effect.key`.

        With another reference it is the same but for the plainer effect.
        """
        return (self.name, self.joint, (("of", self.of), ("signal", self.signal)))

    def check(self):
        """Refuse what cannot vary; see `Effect.check`."""
        super().check()
        self._varied()

    def applies(self, motion):
        """Say which signal is missing; see `Effect.applies`.

        That of a recording without signals is no reason to record some.
        """
        if not self.signal:
            return "" if motion.signals else "no signals were recorded beside it"
        if self.signal in motion.signals:
            return ""
        return (
            f"needs the recorded signal {self.signal!r}; give it in signals, one value "
            "per row, or as a column of X"
        )

    def columns(self, motion):
        """Torque in proportion to the signal; see `Effect.columns`."""
        self._varied()
        if self.signal not in motion.signals:
            raise ValueError(
                f"signal must name a recorded signal; got {self.signal!r}, expected "
                f"one of {', '.join(motion.signals) or '(none is there)'}."
            )
        varied = {
            "coulomb": lambda: motion.sign(self.joint)[:, 0],
            "offset": lambda: 1.0,
            "viscous": lambda: motion.v[:, self.joint],
        }[self.of]()
        excess = motion.signals[self.signal] - self.reference
        return (excess * varied)[:, None]

    def shapes(self, motion):
        """All signals that vary, and all that may vary with them."""
        return [
            {"signal": name, "of": of, "reference": float(np.mean(values))}
            for name, values in motion.signals.items()
            if np.ptp(values) > 0
            for of in _VARIED
        ]

    def _varied(self):
        """Words and units of what varies."""
        if self.of not in _VARIED:
            raise ValueError(f"of must be one of {list(_VARIED)}; got {self.of!r}.")
        return _VARIED[self.of]
