"""What checks of a recording have to say."""

from dataclasses import dataclass

# From worst to least.
SEVERITIES = ("error", "doubt", "warning")


@dataclass(frozen=True)
class ChannelFinding:
    """What is wrong with some channels of a recording.

    Attributes
    ----------
    kind : str
        Name of the fault, such as "torque_sign"; see `inspect_channels`.
    joints : tuple of int
        Joints concerned, counted from 0.
    severity : {"error", "doubt", "warning"}
        "error": a fit would be wrong, what would be found is the fault. "doubt": a
        fit may be wrong, no favourable verdict can be built on it, but the evidence
        has another explanation or the harm is limited. "warning": a fit would be
        worse than need be.
    message : str
        One line: the channel by name, the evidence in numbers, the remedy.
    """

    kind: str
    joints: tuple[int, ...]
    severity: str
    message: str


def in_order(findings):
    """Return findings as a tuple, the worst first."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def listed(names, joints):
    """Name some joints; all of several are called so."""
    if len(joints) == len(names) > 1:
        return "all joints"
    return ", ".join(names[j] for j in joints)
