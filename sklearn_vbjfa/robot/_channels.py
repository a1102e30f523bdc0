"""Gains of torque channels of an identified robot, and their common factor."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

# Gains are plausible within this factor of those of the other channels, and known if
# their 90 % interval is narrower than that ...
LIMIT = 5.0
# Half width of a 90 % interval in standard deviations.
HALF_WIDTH = 1.645


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelGains:
    """Gains of the torque channels of an identified robot."""

    joint_names: tuple[str, ...]
    # (nv,): what each channel reads over the torque: in units of the reference channel,
    # or [recorded unit / (N m or N)] where a known mass says how much that is. 1
    # (relative) where the recording does not show it
    gain: np.ndarray
    # (nv,): 0 for a reference, which is the unit, nan where the gain is not shown
    std: np.ndarray
    # (nv,): joint whose channel each is relative to: itself for a reference and for a
    # joint whose gain is not shown relative to any other
    reference: np.ndarray
    common: "CommonGain"  # what fixes the common factor
    # (2, nv): ends of the 90 % intervals; nan where the gain is not shown
    intervals: np.ndarray = field(init=False)

    def __post_init__(self):
        half = HALF_WIDTH * self.std
        ends = np.stack([self.gain - half, self.gain + half])
        object.__setattr__(self, "intervals", ends)

    @property
    def references(self):
        own = np.arange(self.reference.size)
        return tuple(np.unique(self.reference[self.reference != own]).tolist())

    @property
    def hidden(self):
        """Joints (tuple of int) whose gain is not shown relative to any other."""
        own = np.arange(self.reference.size)
        alone = own[self.reference == own]
        return tuple(np.setdiff1d(alone, self.references).tolist())

    @property
    def absolute(self):
        """Whether a known mass fixes what a gain of 1 is."""
        return self.common.factor is not None


@dataclass(frozen=True, kw_only=True)
class CommonGain:
    """What fixes the common factor of all gains."""

    # gain of the reference channel [recorded unit / (N m or N)]; None where nothing
    # fixes it. Parameters were divided by it
    factor: float | None = None
    std: float = float("nan")  # nan where nothing fixes it
    # known masses [kg] by body, or "payload"
    masses: Mapping[str, float] = field(default_factory=dict)

    def widened(self, theta, std, units, gains, covariance):
        """Deviations (p,) of parameters with that of the common gain."""
        # theta: parameters in kg and N m (p,); std: deviations of the same with the
        # factor as it is, gains relative to a reference; units: of the parameters;
        # gains: places of gains among them; covariance: see `common_gain`.
        power = np.array([_power(unit) for unit in units])
        power[gains] = 1
        # A parameter is what it was in relative units times this power of the factor.
        scale = float(self.factor) ** power
        std = np.where(np.isin(np.arange(std.size), gains), std * scale, std)
        share = self.std / self.factor
        both = 2 * power * theta / self.factor * scale * covariance
        return np.sqrt(np.maximum(std**2 + (power * theta * share) ** 2 + both, 0.0))


def _power(unit):
    """Return how a parameter of some unit depends on the gain of torques."""
    if unit.startswith(("N", "kg")):
        return -1
    return int(unit.endswith(("N", "(N m)")))


def note_of_gains(gains):
    """Say what channels read over the torque in a written file; empty if known."""
    if gains is None:
        return ""
    each = ", ".join(
        f"{name} {gain:.5g}" for name, gain in zip(gains.joint_names, gains.gain)
    )
    text = f"Divide what the torque channels read by: {each}."
    return " ".join(filter(None, [text, note_of_units(gains)]))


def note_of_units(gains):
    """Say what units a written file is in; empty where they are kg and N m."""
    if gains is None or gains.absolute:
        return ""
    names = [gains.joint_names[j] for j in gains.references]
    unit = f"that of {' or '.join(names)}" if names else "each channel"
    return (
        "These gains are relative: masses, inertias and friction in this file are in "
        f"units of {unit}, not in kg and N m."
    )
