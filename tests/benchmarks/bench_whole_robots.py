"""Whole simulated robots: the right names from every start, and the next motion.

Run ``python tests/benchmarks/bench_whole_robots.py [--seeds FIRST LAST] [--write]``.

Data: ``_undeclared_whole.py``, which shares no code with the library of effects.
Serial robots of six joints drawn at random; viscous and Coulomb friction in every
joint; bristles (LuGre or Maxwell slip) or a Stribeck hump on one to three joints; three
further effects on random joints, each 2 to 8 times the torque noise, or up to four
times that where the declared columns would take over more than half of it; positions of
encoders of 17 bits; torque noise of 2 % of each joint's spread, an autoregression with
0.8 from sample to sample, at 200 Hz.

Split: two motions of 30 s are fitted, a third one of 30 s within the same limits of
position and speed is predicted from its true states and compared with its torque
without noise, unfiltered.

What is judged:

- Error: root mean square over the standard deviation of the joint's torque in the third
  motion, over the samples where the joint moves faster than `MOVING`. Below that speed
  the sign of the speed is a matter of definition (the simulated friction turns smoothly
  within 0.01 rad/s, that of a model may turn at once); the error over all samples,
  reversals included, is given beside it. The truth is the smooth one in both.
- Recall: share of the visible effects, friction included, that are named on their
  joint; what is declared counts as found. Visible: the part outside the span of the
  bodies, the friction and all other effects of the robot is at least half the torque
  noise. Precision: share of the names that the search gave that are right: in the
  robot (visible or not), or contained in the simulated effect (`contains` of its
  entry, as the offset of a spring).
- A compound name counts for a plainer effect of the joint that it contains
  (`CONTAINED`) only if the 90 % intervals of all of its own parameters that have one
  exclude zero. If it is not in the robot it is wrong all the same. A name that contains
  nothing (coupling) counts for itself only.
- The same set: the names with their joints, beyond the plain terms that every model
  has, are equal from all starts. Beside it: equal but for names that another name of
  the joint contains.
- What the loop gives as perhaps is right or wrong as a name is, and counted apart: it
  changes neither recall nor precision.

Seeds 0 to 99 are for work, those from 300 on to confirm.
"""

import time
import warnings
from itertools import combinations

import numpy as np
from _perhaps import PERHAPS, calibration, counts, gathered, stated
from _report import parser, publish, rst_table, run_study
from _undeclared import PLAIN
from _undeclared_whole import NV, whole_robot

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

STARTS = {
    "none": (),
    "viscous": ("viscous",),
    "viscous+coulomb": ("viscous", "coulomb"),
}
# Speed above which a sample counts as moving [rad/s].
MOVING = 0.03
# Errors with the shares of joints that are to stay below them.
LIMITS = ((0.01, 0.95), (0.03, 1.0))
NAMED = 0.95
SAME = 0.9
CONFIRMATION = range(100, 130)


# Plainer effects that a compound becomes at an end of its own parameters, such as a
# gap of no width.
CONTAINED = {"counterbalance": {"spring"}, "backlash": {"spring"}}


def surplus_is_real(effect):
    """Whether the intervals of an effect's parameters all exclude zero."""
    known = [x for x in effect.intervals.values() if np.all(np.isfinite(x))]
    return bool(known) and all(low > 0 or high < 0 for low, high in known)


def judge_names(truth, effects):
    """Compare the names that were found with the truth."""
    there = {(e.name, e.joint) for e in truth}
    allowed = there | {(name, e.joint) for e in truth for name in e.contains}
    # What every model has is neither found nor missed.
    found = {(name, j) for name in PLAIN for j in range(NV)}
    extra = []
    for effect in effects:
        here = (effect.name, effect.joint)
        found.add(here)
        if surplus_is_real(effect):
            found |= {(name, effect.joint) for name in CONTAINED.get(effect.name, ())}
        if here not in allowed:
            extra.append(here)
    visible = {(e.name, e.joint) for e in truth if e.visible}
    return sorted(visible - found), sorted(extra), len(effects) - len(extra)


def prediction_errors(identifier, robot):
    """Return errors of the third motion in moving and in all samples, each (nv,)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        predicted = identifier.predict(robot.states)
    wrong = (predicted - robot.tau_clean) / robot.tau_clean.std(axis=0)
    moving = np.abs(robot.states[:, NV : 2 * NV]) > MOVING
    rows = np.where(moving, wrong**2, 0.0).sum(axis=0) / moving.sum(axis=0)
    return np.sqrt(rows), np.sqrt(np.mean(wrong**2, axis=0))


def run(task, duration=30.0, **settings):
    """Close the loop on one robot from one start."""
    robot = whole_robot(task["seed"], duration)
    declared = STARTS[task["start"]]
    identifier = RobotIdentifier(robot.model, dt=robot.dt, friction=declared)
    loop = EffectDiscovery(identifier, random_state=0, **settings)
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(robot.q, robot.tau, groups=robot.groups)
    seconds = time.perf_counter() - started
    moving, whole = prediction_errors(loop.identifier_, robot)
    missed, extra, right = judge_names(robot.truth, loop.effects_)
    wrong = judge_names(robot.truth, loop.possible_)[1]
    seen = [e for e in robot.truth if e.visible and e.name not in PLAIN]
    return {
        **task,
        "errors": moving.tolist(),
        "errors_all_samples": whole.tolist(),
        "reported": loop.error_after_.tolist(),
        "floor": loop.report_.outcome.column("floor").tolist(),
        "cutoff": float(loop.identifier_.cutoff_),
        "truth": [[e.name, e.joint, round(e.distinct, 3)] for e in robot.truth],
        "visible": len(seen),
        "found": [[e.name, e.joint, list(e.rivals)] for e in loop.effects_],
        "missed": [list(pair) for pair in missed],
        "extra": [list(pair) for pair in extra],
        "right": right,
        "names": stated(loop.effects_, extra),
        "perhaps": stated(loop.possible_, wrong),
        "seconds": seconds,
    }


def set_of(result):
    """Names with joints that a model ends with, beyond what every model has."""
    return {(name, joint) for name, joint, _ in result["found"] if name not in PLAIN}


def without_contained(pairs):
    """Leave out what another name of the same joint contains."""
    covered = {(n, j) for name, j in pairs for n in CONTAINED.get(name, ())}
    return pairs - covered


def differences(results):
    """Names that some starts of one robot end with and others do not, sorted."""
    sets = [set_of(result) for result in results]
    return sorted(set.union(*sets) - set.intersection(*sets))


def words(pairs):
    """List names with joints, counted from one."""
    return ", ".join(f"{name} {joint + 1}" for name, joint in pairs) or "none"


def line(result):
    """One line about one robot from one start."""
    return (
        f"seed {result['seed']} start {result['start']}: "
        f"worst error {100 * max(result['errors']):.2f} %, "
        f"missed {words(result['missed'])}; extra {words(result['extra'])}; "
        f"perhaps {words((e['name'], e['joint']) for e in result['perhaps'])}; "
        f"{result['seconds']:.0f} s"
    )


def _percent(share, digits=0):
    return f"{100 * share:.{digits}f} %"


def row(label, results):
    """Row of the table: one start."""
    errors = np.array([result["errors"] for result in results])
    every = np.array([result["errors_all_samples"] for result in results])
    visible = sum(result["visible"] for result in results)
    missed = sum(len(result["missed"]) for result in results)
    right = sum(result["right"] for result in results)
    extra = sum(len(result["extra"]) for result in results)
    within = [_percent(np.mean(errors <= limit), 1) for limit, _ in LIMITS]
    return [
        label,
        len(results),
        *within,
        _percent(np.median(errors), 2),
        _percent(errors.max(), 2),
        _percent(np.median(every), 2),
        _percent(1.0 - missed / max(visible, 1), 1),
        _percent(right / (right + extra), 1) if right + extra else "–",
        *counts(results),
        f"{np.median([result['seconds'] for result in results]):.0f}",
    ]


HEADERS = [
    "declared friction",
    "robots",
    *(f"joints within {_percent(limit)}" for limit, _ in LIMITS),
    "median error",
    "largest",
    "median, all samples",
    "effects named",
    "names right",
    *PERHAPS,
    "s",
]


def same_sets(results):
    """Robots seen from all starts, and how many have one set, strictly and roughly."""
    by_seed = {}
    for result in results:
        by_seed.setdefault(result["seed"], []).append(result)
    whole = [rs for rs in by_seed.values() if len(rs) > 1]
    strict = sum(not differences(rs) for rs in whole)
    rough = sum(
        all(
            without_contained(set_of(a)) == without_contained(set_of(b))
            for a, b in combinations(rs, 2)
        )
        for rs in whole
    )
    return len(whole), strict, rough


def report(results, starts, seeds):
    """Text with the table."""
    rows = []
    for start in starts:
        own = [result for result in results if result["start"] == start]
        if own:
            rows.append(row(start.replace("+", " and "), own))
    targets = [f"target {_percent(share)}" for _, share in LIMITS]
    rows.append(["target", "", *targets, *[""] * 3, *[_percent(NAMED)] * 2, *[""] * 3])
    count, strict, rough = same_sets(results)
    lost, wrong = {}, {}
    for result in results:
        for total, pairs in ((lost, result["missed"]), (wrong, result["extra"])):
            for name, _ in pairs:
                total[name] = total.get(name, 0) + 1
    return (
        f"Seeds {seeds[0]} to {seeds[-1]}. "
        f"Errors on a third motion, over the spread of its torque, in samples faster "
        f"than {MOVING} rad/s.\n\n"
        + rst_table(rows, HEADERS)
        + f"\n\nThe same names on the same joints from all starts: {strict} of {count} "
        f"robots (target: {_percent(SAME)}); but for names that another one contains: "
        f"{rough}.\n\nMissed by name: {_counted(lost)}; of these perhaps: "
        f"{_missed_perhaps(results)}. Wrong by name: {_counted(wrong)}.\n\n"
        + calibration(results)
    )


def _missed_perhaps(results):
    """Count what was missed and is given as perhaps."""
    return sum(
        [name, joint] in [[e["name"], e["joint"]] for e in gathered([r], "perhaps")]
        for r in results
        for name, joint in r["missed"]
    )


def _counted(counts):
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {n}" for name, n in ordered) or "none"


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, out=True, jobs=True, seeds=(0, 29))
    arguments.add_argument("--starts", nargs="+", choices=STARTS, default=list(STARTS))
    arguments = arguments.parse_args(argv)
    (first, last), starts = arguments.seeds, arguments.starts
    if arguments.quick:
        last, starts = first, starts[-1:]
    seeds = range(first, last + 1)
    tasks = [{"seed": seed, "start": start} for seed in seeds for start in starts]
    ledger = run_study(
        run,
        tasks,
        ("seed", "start"),
        out=arguments.out,
        jobs=arguments.jobs,
        line=line,
    )
    publish(
        "whole_robots" + ("" if first < 100 else "_confirmation"),
        report(ledger.of(tasks), starts, seeds),
        arguments,
        command=f"whole_robots.py --seeds {first} {last}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
