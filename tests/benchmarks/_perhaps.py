"""What a loop says with a probability, and whether that share of it is right."""

import itertools

import numpy as np
from _report import rst_table, rst_title

# Headers of `counts`.
PERHAPS = ("perhaps, right", "perhaps, wrong")
# Ends of the cells of the table of stated probabilities.
STATED = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


def stated(effects, wrong):
    """Effects as dicts: name, joint, probability, and whether it is not in `wrong`."""
    return [
        {
            "name": e.name,
            "joint": e.joint,
            "probability": float(e.probability),
            "right": (e.name, e.joint) not in wrong,
        }
        for e in effects
    ]


def gathered(results, what):
    """List what results have under "names" or "perhaps"; those not judged nothing."""
    return [entry for result in results for entry in result.get(what, ())]


def counts(results):
    """Count what is given as perhaps, right and wrong, as cells of a table."""
    right = [entry["right"] for entry in gathered(results, "perhaps")]
    return [str(sum(right)), str(len(right) - sum(right))]


def calibration(results):
    """Section of a report: stated probability beside the share that is right."""
    named, perhaps = (gathered(results, what) for what in ("names", "perhaps"))
    edges = [0.0, *STATED, np.inf]
    cells = []
    for low, high in itertools.pairwise(edges):
        label = f"{low:g} to {high:g}"
        if low == 0.0:
            label = f"below {high:g}"
        elif high == np.inf:
            label = f"{low:g} and above"
        own = [e for e in perhaps if low <= e["probability"] < high]
        if own or (low, high) in itertools.pairwise(STATED):
            cells.append((f"perhaps, {label}", own))
    cells += [("perhaps, all", perhaps), ("named", named)]
    rows = []
    for label, own in cells:
        told = [e["probability"] for e in own]
        right = [e["right"] for e in own]
        mean, share = (f"{100 * np.mean(x):.0f}" if x else "–" for x in (told, right))
        rows.append([label, len(own), mean, share])
    heads = ["stated probability", "effects", "mean stated, %", "right, %"]
    title = rst_title("Whether what is left open is as often right as it says")
    return f"{title}\n\n{rst_table(rows, heads)}"
