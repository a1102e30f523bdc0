"""Channels that contradict the robot: signs, orders, units, delays, zeros."""

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
