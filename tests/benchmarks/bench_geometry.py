"""Faults of the geometry and of the channels: named rightly, with the right values.

Run ``python tests/benchmarks/bench_geometry.py --out FILE [--kinds tilt zero ...]
[--cases N] [--jobs N] [--write]``.

Data: ``_undeclared_geometry.py``, which shares no code with the package: arms of six
and seven joints of six builds, 60 to 120 s at 100 to 500 Hz in one or two recordings;
viscous, Coulomb and offset friction in every joint, declared; torque noise of 2 %,
encoders of 17 to 20 bits or with white noise. A tilt of the base, a zero of an
encoder, an axis (1.5 to 8 degrees) or a gain (0.6 to 1.6) adds at least three times
the torque noise on some joint, and at least half the noise of it is left when bodies,
friction and the other faults have taken over what they can.

What is judged:

- Named: the right name on the right joint, or one of its class, or an effect whose
  declared rivals have it, or a set of as many faults that explains as much. A class
  is of faults that the likelihood with a known noise would confuse in more than 5 %
  of recordings (``_undeclared_told_apart.py``).
- Values: share of the parameters whose 90 % interval holds the truth; for a name of
  the class, the value that explains the torque without noise best. A parameter that
  the noise leaves open to more than a third of its value is not counted.
- Floor: error on the held-out part of the declared model with the right geometry,
  zeros and gains, and without the other effect's torque, fitted by the same loop to
  the same rows with nothing looked for. Beside it: joints within 10 % of it.
- Wrong names: faults that are not there, and other effects that are not there.
- ``signal``: friction that falls by 40 % over a recorded temperature, named with that
  signal.
- ``none``: no fault may be named.

Beside every share stands its lower bound at 90 % (Clopper and Pearson 1934).

Seeds 0 to 99 are for work, those from 310 on to confirm (``--seed``).
"""

import time
import warnings
from collections import Counter

import numpy as np
from _report import parser, publish, rst_table, rst_title, run_study
from _undeclared_faults import PARAMETERS
from _undeclared_geometry import FRICTION, KINDS, simulate
from _undeclared_told_apart import SEPARATE
from bench_single_effects import lower_bound

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

KEYS = ("kind", "seed")
# Part of the seeds.
NUMBERS = dict(zip(KINDS, (0, 1, 2, 3, 4, 5, 7, 8)))
# Standard error over value above which a parameter is not judged.
OPEN = 1.0 / 3.0
AT_FLOOR = 1.1


def tasks_of(kinds, seed, n_cases):
    """Tasks as dicts with `KEYS`, seeds outermost, so that a part is a sample."""
    seeds = range(seed, seed + n_cases)
    return [{"kind": kind, "seed": s} for s in seeds for kind in kinds]


def draw(task):
    """Draw the recording of a task."""
    return simulate(task["kind"], seed=(task["seed"], NUMBERS[task["kind"]]))


def is_fault(pair):
    """Whether a name with a joint is one of the geometry or of a channel."""
    return pair[0] in PARAMETERS


def judge(recording, found):
    """Compare what was found with the truth."""
    joints = list(recording.model.names)[1:]
    names = {(e.name, e.joint): set(rivals_of(e, joints)) for e in found}
    faults = {pair for pair in names if is_fault(pair)}
    taken, named, by_class = set(), [], []
    for entry in recording.truth:
        here = (entry.name, entry.joint)
        same = {pair for pair in faults if pair in entry.rivals}
        rival = {pair for pair, rivals in names.items() if here in rivals}
        options = [here] if here in names else sorted((same | rival) - taken)
        named.append(bool(options))
        by_class.append(bool(options) and options[0] != here)
        taken |= set(options[:1])
    teller = recording.teller()
    known = {fault.key: fault for fault in recording.faults}
    if faults - taken and 0 < len(faults) <= len(known):
        # another set that is no larger and explains as much is as good
        told = teller.explain(sorted(faults))
        if told.distance < SEPARATE:
            taken |= faults
            for i, entry in enumerate(recording.truth):
                if (entry.name, entry.joint) in known and not named[i]:
                    named[i] = by_class[i] = True
    wrong = set(names) - taken
    right = sorted(faults & taken)
    standing = {}
    if right:
        told = teller.explain(right, start=list(known.values()))
        standing = {fault.key: fault for fault in told.faults}
        if told.distance >= SEPARATE:
            # not all of them are found; those that are have their own values
            standing = {key: known[key] for key in right if key in known}
    return (
        named,
        by_class,
        sorted(pair for pair in wrong if is_fault(pair)),
        sorted(pair for pair in wrong if not is_fault(pair)),
        standing,
    )


def rivals_of(effect, joint_names):
    """List name and joint of what cannot be told from an effect."""
    pairs = []
    for rival in effect.rivals:
        name, _, where = rival.partition(" on ")
        own = 0 if name == "base_tilt" else effect.joint
        pairs.append((name, list(joint_names).index(where) if where else own))
    return pairs


def judge_values(recording, found, standing):
    """Say for each parameter whether its interval holds what it should."""
    rows = []
    if not standing:
        return rows
    faults = list(standing.values())
    told = recording.teller().explain(list(standing), start=faults)
    spreads = dict(zip([fault.key for fault in told.faults], told.std))
    for effect in found:
        fault = standing.get((effect.name, effect.joint))
        if fault is None:
            continue
        for (name, true), std in zip(fault.parameters.items(), spreads[fault.key]):
            neutral = 1.0 if fault.name == "torque_gain" else 0.0
            if not std <= OPEN * abs(true - neutral):
                continue
            low, high = effect.intervals.get(name, (np.nan, np.nan))
            rows.append(
                {
                    "name": fault.name,
                    "joint": fault.joint,
                    "parameter": name,
                    "true": float(true),
                    "value": float(effect.parameters.get(name, np.nan)),
                    "low": float(low),
                    "high": float(high),
                    "inside": bool(low <= true <= high),
                }
            )
    return rows


def floor_of(recording):
    """Error on the held-out part with all that is wrong put right, (nv,)."""
    model, q, tau = recording.put_right()
    identifier = RobotIdentifier(model, dt=recording.dt, friction=FRICTION)
    loop = EffectDiscovery(identifier, effects=[], random_state=0)
    loop.fit(q, tau, groups=recording.groups)
    return loop.error_before_


def run(task):
    """Close the loop on one case."""
    recording = draw(task)
    result = {
        **task,
        "arm": recording.arm,
        "rate": round(1.0 / recording.dt),
        "rows": len(recording.q),
        "recordings": int(np.unique(recording.groups).size),
        "visible": recording.visible,
        "truth": [
            {
                "name": e.name,
                "joint": e.joint,
                "parameters": {k: round(float(x), 6) for k, x in e.parameters.items()},
                "size": round(e.size, 3),
                "outside": round(e.outside, 3),
                "rivals": [list(pair) for pair in e.rivals],
                "std": list(map(float, e.std)),
            }
            for e in recording.truth
        ],
    }
    if not recording.visible:
        return result
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return {**result, **_run_loop(recording)}


def _run_loop(recording):
    identifier = RobotIdentifier(recording.model, dt=recording.dt, friction=FRICTION)
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.process_time()
    given = {"groups": recording.groups, "signals": recording.signals or None}
    loop.fit(recording.q, recording.tau, **given)
    seconds = time.process_time() - started
    named, by_class, faults, others, standing = judge(recording, loop.effects_)
    return {
        "named": named,
        "by_class": by_class,
        "wrong_faults": [list(pair) for pair in faults],
        "wrong_others": [list(pair) for pair in others],
        "values": judge_values(recording, loop.effects_, standing),
        "found": [_described(effect) for effect in loop.effects_],
        "before": loop.error_before_.tolist(),
        "after": loop.error_after_.tolist(),
        "floor": floor_of(recording).tolist(),
        "seconds": seconds,
    }


def _described(effect):
    numbers = {
        name: round(float(x), 6)
        for name, x in effect.parameters.items()
        if isinstance(x, int | float | np.number)
    }
    return {
        "name": effect.name,
        "joint": effect.joint,
        "parameters": numbers,
        "rivals": [str(rival) for rival in effect.rivals],
        "gain": float(effect.evidence.gain),
        "log_odds": float(effect.log_odds),
    }


def _words(pairs):
    return ", ".join(f"{name} {joint + 1}" for name, joint in pairs) or "nothing"


def line(result):
    """One line about one case, joints from one."""
    truth = _words((e["name"], e["joint"]) for e in result["truth"])
    start = f"{result['kind']} seed {result['seed']} ({result['arm']}): {truth}"
    if not result["visible"]:
        return f"{start}: not visible in any robot"
    found = _words((e["name"], e["joint"]) for e in result["found"])
    verdict = "named" if all(result["named"]) else "MISSED"
    wrong = result["wrong_faults"] + result["wrong_others"]
    after, floor = np.array(result["after"]), np.array(result["floor"])
    inside = [row["inside"] for row in result["values"]]
    return (
        f"{start}: {verdict}; found {found}; wrong {_words(wrong)}; values "
        f"{sum(inside)} of {len(inside)}; over floor {np.nanmax(after / floor):.2f}; "
        f"{result['seconds']:.0f} s"
    )


def _share(flags):
    n, k = len(flags), sum(flags)
    if not n:
        return ["0", "–", "–"]
    return [str(n), f"{100 * k / n:.0f} %", f"{100 * lower_bound(k, n):.0f} %"]


NAMES_HEADERS = [
    "kind",
    "cases",
    "all named",
    "lower bound",
    "as one of the class",
    "no wrong fault",
    "lower bound",
    "with another wrong name",
    "not visible",
    "median processor time [s]",
]


def _names_row(kind, results):
    counted = [r for r in results if r["visible"]]
    named = [all(r["named"]) for r in counted]
    clean = [not r["wrong_faults"] for r in counted]
    cells = [kind, *_share(named)]
    if kind == "none":
        cells[2:] = ["–", "–"]
    times = [r["seconds"] for r in counted]
    return [
        *cells,
        str(sum(any(r["by_class"]) for r in counted)),
        *_share(clean)[1:],
        str(sum(bool(r["wrong_others"]) for r in counted)),
        str(len(results) - len(counted)),
        f"{np.median(times):.0f}" if times else "–",
    ]


FIGURES_HEADERS = [
    "kind",
    "values",
    "in their interval",
    "lower bound",
    "before over floor, largest joint, median",
    "after over floor, largest joint, median",
    "largest",
    f"joints within {AT_FLOOR:g} of the floor",
]


def _figures_row(kind, results):
    counted = [r for r in results if r["visible"]]
    inside = [row["inside"] for r in counted for row in r["values"]]
    ratios = {
        key: [np.array(r[key]) / np.array(r["floor"]) for r in counted]
        for key in ("before", "after")
    }
    largest = {key: [np.nanmax(x) for x in rows] for key, rows in ratios.items()}
    if not counted:
        return [kind, *_share(inside), *["–"] * 4]
    joints = np.concatenate(ratios["after"])
    joints = joints[np.isfinite(joints)]
    return [
        kind,
        *_share(inside),
        f"{np.median(largest['before']):.2f}",
        f"{np.median(largest['after']):.2f}",
        f"{max(largest['after']):.2f}",
        f"{100 * np.mean(joints <= AT_FLOOR):.0f} %",
    ]


def _found_instead(results):
    counts = Counter(
        name
        for r in results
        if r["visible"] and not all(r["named"])
        for name in {e["name"] for e in r["found"]} or {"nothing"}
    )
    return ", ".join(f"{name} {n}" for name, n in counts.most_common(5)) or "–"


def report(results):
    """Text with the tables of the results that there are."""
    kinds = [k for k in KINDS if any(r["kind"] == k for r in results)]
    by_kind = {k: [r for r in results if r["kind"] == k] for k in kinds}
    names = [_names_row(kind, rows) for kind, rows in by_kind.items()]
    figures = [_figures_row(kind, rows) for kind, rows in by_kind.items()]
    instead = [[kind, _found_instead(rows)] for kind, rows in by_kind.items()]
    parts = [
        rst_title("Names", "~"),
        rst_table(names, NAMES_HEADERS),
        rst_title("Values and errors", "~"),
        rst_table(figures, FIGURES_HEADERS),
        rst_title("Found where a name is missed", "~"),
        rst_table(instead, ["kind", "found, in cases"], n_labels=2),
    ]
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, out=True, jobs=True)
    arguments.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    arguments.add_argument("--seed", type=int, default=0, help="seed of the first")
    arguments.add_argument("--cases", type=int, default=10, help="of each kind")
    arguments = arguments.parse_args(argv)
    kinds, first, cases = arguments.kinds, arguments.seed, arguments.cases
    if arguments.quick:
        kinds, cases = ("tilt",), 1
    tasks = tasks_of(kinds, first, cases)
    ledger = run_study(
        run, tasks, KEYS, out=arguments.out, jobs=arguments.jobs, line=line
    )
    publish(
        "geometry" + ("" if first < 100 else "_confirmation"),
        f"Seeds {first} to {first + cases - 1}.\n\n{report(ledger.of(tasks))}",
        arguments,
        command=f"geometry.py --seed {first} --cases {cases}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
