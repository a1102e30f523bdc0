"""A part of the runs in which any two of their factors meet as in all of them."""

import re
from collections import Counter
from itertools import combinations

# Levels of fewer runs are one level, "other": a sample cannot hold every one-off.
FEWEST = 3


def _written(word):
    """Return a word of a case's name without the value in it."""
    if word[:1] in {"'", '"'}:
        return "text"
    return re.sub(r"[-+]?\d[\d.,]*(e[-+]?\d+)?", "#", word)


def factors(case, command):
    """Return the levels of the factors of a run.

    They are the family of the case, what is wrong (the first word of its name), where
    or how (the last), what is expected, whether a message is, and the command.
    """
    family, rest = case.name.split(": ", 1)
    words = [_written(word) for word in rest.split()]
    return {
        "family": family,
        "what": (family, words[0] if words else ""),
        "where": (family, words[-1] if len(words) > 1 else ""),
        "expect": case.expect,
        "told": bool(case.message),
        "command": command,
    }


def pairs_of(runs):
    """Return of each run the pairs of levels that meet in it."""
    rows = [factors(*run) for run in runs]
    count = Counter(item for row in rows for item in row.items())
    return [
        {
            *combinations(
                [
                    (name, level if count[name, level] >= FEWEST else "other")
                    for name, level in row.items()
                ],
                2,
            )
        }
        for row in rows
    ]


def pairwise(runs):
    """Choose so many runs that any two levels that meet somewhere meet in one of them.

    Parameters
    ----------
    runs : list of (Case, str)
        Cases with the command that reads them.

    Returns
    -------
    list of int
        Which ones, in order; the same at every call.
    """
    pairs = pairs_of(runs)
    missing, chosen = set().union(*pairs), []
    while missing:
        best = max(range(len(runs)), key=lambda k: (len(pairs[k] & missing), -k))
        missing -= pairs[best]
        chosen.append(best)
    return sorted(chosen)
