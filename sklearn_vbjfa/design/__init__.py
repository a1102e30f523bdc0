"""Motions that are worth recording, within a robot's limits."""
