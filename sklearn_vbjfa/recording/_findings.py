"""What is said of the channels of a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

# From worst to least.
SEVERITIES = ("error", "doubt", "warning")


@dataclass(frozen=True)
class ChannelFinding:
    """A fault of some channels of a recording.

    Attributes
    ----------
    kind : str
        Name of the fault, such as "torque_sign"; see `inspect_channels`.
    joints : tuple of int
        Affected joints, counted from 0.
    severity : {"error", "doubt", "warning"}
        "error": a fit would be wrong and identify the fault. "doubt": a fit may be
        wrong and supports no favourable verdict, but the evidence has another
        explanation or the harm is limited. "warning": a fit would be needlessly
        inaccurate, or something cannot be verified.
    message : str
        One line: the channel by name, the evidence in numbers, the remedy.
    value : float, default=nan
        Size of the fault in SI units, where it has one: the lag [s] of a "delay".
    remedy : mapping
        Options of `read_recording` that undo the fault; empty for none.
    """

    kind: str
    joints: tuple[int, ...]
    severity: str
    message: str
    value: float = np.nan
    remedy: Mapping = field(default_factory=dict)


def in_order(findings):
    """Return findings as a tuple, worst first."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def listed_joints(names, joints):
    """List joints by name, or as "all joints"."""
    if len(joints) == len(names) > 1:
        return "all joints"
    return ", ".join(names[j] for j in joints)
