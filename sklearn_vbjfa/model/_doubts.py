"""Warnings that put a result in doubt, unlike those that only tell of something."""


class DoubtWarning(UserWarning):
    """Part of what was given is left out of a result, or the result may be wrong."""
