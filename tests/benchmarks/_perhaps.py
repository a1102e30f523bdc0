"""What a loop says with a probability, and whether that share of it is right.

A loop that decides everything has no `possible_`, and its effects no `probability`: the
same study runs on a version from before there were any.
"""

import itertools

import numpy as np
from _report import rst_table, rst_title

# Headers of `counts`.
PERHAPS = ("perhaps, right", "perhaps, wrong")
# Ends of the cells of the table of stated probabilities.
STATED = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


def undecided(loop):
    """Effects that a fitted `EffectDiscovery` gives as perhaps."""
    return tuple(getattr(loop, "possible_", ()))


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


def gathered(results, what):
    """List what results have under "names" or "perhaps", old ones perhaps nothing."""
    return [entry for result in results for entry in result.get(what, ())]


def counts(results):
    """Count what is given as perhaps, right and wrong, as cells of a table."""
    right = [entry["right"] for entry in gathered(results, "perhaps")]
    return [str(sum(right)), str(len(right) - sum(right))]


def calibration(results):
    """Section of a report: stated probability beside the share that is right.

    Parameters
    ----------
    results : list of dict
        With "names" and "perhaps" as `stated` makes them.
    """
    named, perhaps = (gathered(results, what) for what in ("names", "perhaps"))
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
    title = rst_title("Whether what is left open is as often right as it says")
    return f"{title}\n\n{rst_table(rows, heads)}"


def _stated(entry):
    return entry["probability"] is not None
