"""Channels that contradict the robot: signs, orders, units, delays, zeros."""

from sklearn_vbjfa import lazy_names
from sklearn_vbjfa.inspection._inspect import (
    ChannelFinding,
    inspect_channels,
    inspect_recording,
)
from sklearn_vbjfa.inspection._overview import JointMotion, motion_of

__all__ = [
    "ChannelFinding",
    "JointMotion",
    "inspect_channels",
    "inspect_recording",
    "motion_of",
]

# For other rooms, and for the tests.
_NAMES = {
    "ChannelEquations": "_rivals",
    "channel_signals": "_rivals",
    "fits_of": "_rivals",
    "one_speed": "_overview",
}
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
