"""Channels that contradict the robot: signs, orders, units, delays, zeros."""
