"""Channels that contradict the robot: signs, orders, units, delays, zeros."""

from sklearn_vbjfa import _lazily
from sklearn_vbjfa.inspection._inspect import (
    ChannelFinding,
    JointMotion,
    inspect_channels,
    inspect_recording,
    motion_of,
)

__all__ = [
    "ChannelFinding",
    "JointMotion",
    "inspect_channels",
    "inspect_recording",
    "motion_of",
]

# For other rooms, and for the tests.
_MODULES = {
    "_inspect": ("one_speed", "refusal"),
    "_units": ("OF_SIZE",),
    "_rivals": ("ChannelEquations", "channel_signals", "fits_of"),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
