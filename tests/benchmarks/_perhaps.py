"""What a loop says with a probability, and whether that share of it is right.

A loop that decides everything has no `perhaps_`, and its effects no `probability`: the
same study runs on a version from before there were any.
"""

import itertools

import numpy as np
from _report import rst_table

# Ends of the cells of the table.
STATED = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


def undecided(loop):
    """Effects that a fitted `EffectDiscovery` gives as perhaps."""
    return tuple(getattr(loop, "perhaps_", ()))


def stated(effects, wrong):
    """Effects as dicts: name, joint, probability (or None), and whether it is right.

    Parameters
    ----------
    effects : sequence of DiscoveredEffect
        Named, or perhaps.
    wrong : collection of (str, int)
        Names and joints of those that are not right.
    """
    entries = []
    for e in effects:
        probability = float(getattr(e, "probability", np.nan))
        entries.append(
            {
                "name": e.name,
                "joint": e.joint,
                "probability": None if np.isnan(probability) else probability,
                "right": (e.name, e.joint) not in wrong,
            }
        )
    return entries


def counts(entries):
    """Count the right and the wrong ones, as cells of a table."""
    right = sum(e["right"] for e in entries)
    return [str(right), str(len(entries) - right)]


def calibration(named, perhaps):
    """Table: stated probability beside the share that is right.

    Parameters
    ----------
    named, perhaps : list of dict
        Of all recordings, as `stated` makes them.
    """
    edges = [0.0, *STATED, np.inf]
    cells = []
    for low, high in itertools.pairwise(edges):
        label = f"{low:g} to {high:g}"
        if low == 0.0:
            label = f"below {high:g}"
        elif high == np.inf:
            label = f"{low:g} and above"
        own = [e for e in perhaps if _stated(e) and low <= e["probability"] < high]
        if own or (low, high) in itertools.pairwise(STATED):
            cells.append((f"perhaps, {label}", own))
    unknown = [e for e in perhaps if not _stated(e)]
    cells += [("perhaps, not stated", unknown)] if unknown else []
    cells += [("perhaps, all", perhaps), ("named", named)]
    rows = []
    for label, own in cells:
        told = [e["probability"] for e in own if _stated(e)]
        right = [e["right"] for e in own]
        mean, share = (f"{100 * np.mean(x):.0f}" if x else "–" for x in (told, right))
        rows.append([label, len(own), mean, share])
    heads = ["stated probability", "effects", "mean stated, %", "right, %"]
    return rst_table(rows, heads)


def _stated(entry):
    return entry["probability"] is not None
