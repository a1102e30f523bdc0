"""Gains of torque channels of an identified robot, and their common factor."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtri

# Usual factor between gains if the channels are scaled to equal size. A gain is known
# if its 90 % interval is narrower than this factor.
LIMIT = 5.0
# Half width of a 90 % interval in standard deviations.
HALF_WIDTH = float(ndtri(0.95))


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelGains:
    """Gains of the torque channels of an identified robot."""

    joint_names: tuple[str, ...]
    # (nv,): reading of each channel over the torque: relative to the reference channel,
    # or [recorded unit / (N m or N)] if a known mass sets it
    gain: np.ndarray
    # (nv,): 0 for a reference, nan if the gain is not identifiable
    std: np.ndarray
    # (nv,): joint whose channel is the reference: itself for a reference and for a
    # joint whose gain is not identifiable
    reference: np.ndarray
    common: "CommonGain"
    # (2, nv): ends of the 90 % intervals; nan if the gain is not identifiable
    intervals: np.ndarray = field(init=False)

    def __post_init__(self):
        half = HALF_WIDTH * self.std
        ends = np.stack([self.gain - half, self.gain + half])
        object.__setattr__(self, "intervals", ends)

    @property
    def references(self):
        joints = np.arange(self.reference.size)
        return tuple(np.unique(self.reference[self.reference != joints]).tolist())

    @property
    def hidden(self):
        """Joints (tuple of int) whose gain is not identifiable."""
        joints = np.arange(self.reference.size)
        hidden = (self.reference == joints) | np.isnan(self.std)
        return tuple(np.setdiff1d(joints[hidden], self.references).tolist())

    @property
    def absolute(self):
        """Whether a known mass determines the common factor."""
        return self.common.factor is not None


@dataclass(frozen=True, kw_only=True)
class CommonGain:
    """Common factor of all gains, and the masses that determine it."""

    # gain of the reference channel [recorded unit / (N m or N)], by which parameters
    # were divided; None if it is unknown
    factor: float | None = None
    std: float = float("nan")  # nan if it is unknown
    # known masses [kg] by body, or "payload"
    masses: Mapping[str, float] = field(default_factory=dict)

    def widened(self, theta, std, units, gains, covariance):
        """Return deviations (p,) that include the uncertainty of the common gain."""
        # theta: parameters in kg and N m (p,); std: their deviations for a fixed
        # factor, gains relative to a reference; units: of the parameters; gains:
        # indices of gains among them; covariance: see `common_gain`.
        power = np.array([_power(unit) for unit in units])
        power[gains] = 1
        # A parameter is its value in relative units times this power of the factor.
        scale = float(self.factor) ** power
        std = np.where(np.isin(np.arange(std.size), gains), std * scale, std)
        share = self.std / self.factor
        cross = 2 * power * theta / self.factor * scale * covariance
        return np.sqrt(np.maximum(std**2 + (power * theta * share) ** 2 + cross, 0.0))


def _power(unit):
    """Return the power of the torque gain in a parameter with this unit."""
    if unit.startswith(("N", "kg")):
        return -1
    return int(unit.endswith(("N", "(N m)")))


def note_of_gains(gains):
    """Return the note of a file on channel gains; empty if they are known."""
    if gains is None:
        return ""
    each = ", ".join(
        f"{name} {gain:.5g}{' (not identifiable)' * (j in gains.hidden)}"
        for j, (name, gain) in enumerate(zip(gains.joint_names, gains.gain))
    )
    text = f"Divide what the torque channels read by: {each}."
    return " ".join(filter(None, [text, note_of_units(gains)]))


def note_of_units(gains):
    """Return the note of a file on units; empty for kg and N m."""
    if gains is None or gains.absolute:
        return ""
    names = [gains.joint_names[j] for j in gains.references]
    unit = f"that of {' or '.join(names)}" if names else "each channel"
    return (
        "These gains are relative: masses, inertias and friction in this file are in "
        f"units of {unit}, not in kg and N m."
    )
