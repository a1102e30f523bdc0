"""Channels that contradict the robot: signs, orders, units, delays, zeros."""

from sklearn_vbjfa.inspection._inspect import (
    ChannelFinding,
    inspect_channels,
    inspect_recording,
)

__all__ = ["ChannelFinding", "inspect_channels", "inspect_recording"]
