"""The refusal of a motion that cannot be, with what would do instead."""

import math


class MotionRefused(ValueError):
    """Limits, a start or a duration that leave no motion.

    Attributes
    ----------
    reason : str
        The message, without a full stop.
    wrong : str
        The message, without what to give as an argument.
    lacks : str
        The argument that is lacking, if one is: ``"position"``, ``"velocity"``,
        ``"torque"``.
    options : dict of str to float or tuple of float
        What would do, by the names of arguments: ``"duration"``, ``"start"``,
        ``"velocity"``, ``"torque"``.
    """

    def __init__(self, wrong, options, *, lacks="", advice=""):
        message = f"{wrong} {advice}".strip()
        super().__init__(message)
        self.reason = message.removesuffix(".")
        self.wrong, self.lacks, self.options = wrong, lacks, options


def rounded_up(limits):
    """Return limits with three digits that are no smaller, for a message."""
    found = []
    for limit in map(float, limits):
        size = 10.0 ** (math.floor(math.log10(limit)) - 2) if 0 < limit < 1e12 else 0.0
        rounded = math.ceil(limit / size - 1e-9) * size if size else limit
        found.append(float(f"{rounded:.6g}"))
    return tuple(found)
