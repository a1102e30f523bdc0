"""Second motions, random or designed: which of them leave the right single name.

Run ``python tests/benchmarks/bench_design_rivals.py --seeds FIRST LAST [--jobs N]
[--out FILE] [--write]``; both seeds are included, 0 to 99 are for work, 100 to 199 to
confirm, once.

Data: ``_design_robots.py``. Robot s has two or three joints, inertias that differ from
those declared, viscous friction (half of the robots Coulomb friction too, declared)
and one undeclared effect, of the kind s modulo 13. Along a random reference motion
within all limits, the part of the effect that the declared columns cannot absorb has a
root mean square of 2 to 6 times the torque noise, even in the logarithm; the noise of
the torque is 2 to 5 % of its spread there, white, that of the encoders 0.03 mrad. An
elastic joint, a delay, a payload and a drift are left out, for the reasons given there.

Motions, 20 s each, at 100 Hz:

- first: a random Fourier series within half of the range, a quarter of the speed and a
  tenth of the acceleration;
- random: another one within all limits, which it touches, that of the torque by the
  first loop's identified robot, as for the designed one; as many harmonics as that has,
  and amplitudes that fall with their order in three ways;
- designed: ``design_motion(identifier_, report=loop, ...)`` of the first loop, within
  the same limits.

All are executed by forward dynamics with the nominal model fed forward and low gains:
0.1 rad of error give a joint's typical torque. Each is recorded with new noise.
``EffectDiscovery`` looks for all effects of the library in the first recording, then in
the first and the second together.

Right single name: the undeclared effect on its joint, nothing else but effects that it
contains (as in ``bench_single_effects.py``), and no other rivals left. Beside it stands
the share that is named at all, itself or as a rival, with nothing wrong. Lower bounds
are one-sided, 90 % (Clopper and Pearson).

Targets, fixed before the design was written: right single name after the designed
motion at least 95 %, and at most a third of the failures after the random one.
"""

import time
import traceback
import warnings

import numpy as np
from _design_motions import (
    Designed,
    identified,
    random_motion,
    rigid,
    top_harmonic,
)
from _design_robots import HARMONICS, KINDS, POOR, draw_robot, execute
from _ledger import Ledger, results_of
from _report import parser, publish, rst_table, rst_title
from bench_single_effects import lower_bound

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

DURATION = 20.0
DT = 0.01
SIZES = (2.0, 6.0)
ARMS = ("first", "random", "designed")
LABELS = {
    "first": "first motion alone",
    "random": "and a random one",
    "designed": "and the designed one",
}
TARGET = 0.95
FAILURES = 1 / 3
KEYS = ("seed",)


def task_of(seed):
    """Task of a seed: effect and size."""
    low, high = np.log(SIZES)
    size = float(np.exp(np.random.default_rng([seed, 7]).uniform(low, high)))
    return {"seed": seed, "kind": KINDS[seed % len(KINDS)], "size": round(size, 4)}


def designed(loop, limits, duration, dt, seed):
    """Design the second motion; how many harmonics it has, what it says of itself."""
    from sklearn_vbjfa.design import design_motion

    made = design_motion(
        loop.identifier_,
        report=loop,
        duration=duration,
        dt=dt,
        limits=limits.of_package(),
        random_state=seed,
    )
    facts = {
        "within_limits": bool(made.within_limits),
        "margin": float(min(np.min(x) for x in made.margins.values())),
        "condition": float(made.condition_number),
    }
    motion = Designed(made)
    return motion, top_harmonic(motion, duration), facts


def judge(truth, effects):
    """Compare what was found with the truth.

    Parameters
    ----------
    truth : Truth
        Undeclared effect.
    effects : sequence of DiscoveredEffect
        What was found.

    Returns
    -------
    single : bool
        Whether it is the right single name.
    named : bool
        Whether it is named, itself or as a rival, and nothing is wrong.
    """
    right = (truth.name, truth.joint)
    allowed = {right, *((name, truth.joint) for name in truth.contains)}
    found = {(e.name, e.joint) for e in effects}
    rivals = {(name, e.joint) for e in effects for name in e.rivals}
    excused = {
        (e.name, e.joint)
        for e in effects
        if right in {(name, e.joint) for name in e.rivals}
    }
    single = right in found and found <= allowed and rivals <= allowed
    named = right in found | rivals and found <= allowed | excused
    return single, named


def close_loop(robot, executions, dt, **settings):
    """Look for effects in recordings of a robot."""
    identifier = RobotIdentifier(robot.nominal, dt=dt, friction=robot.declared)
    loop = EffectDiscovery(identifier, random_state=0, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return loop.fit(
            np.concatenate([x.q for x in executions]),
            np.concatenate([x.tau for x in executions]),
            groups=np.repeat(
                np.arange(len(executions)), [len(x.q) for x in executions]
            ),
        )


def motions_of(robot, seed, duration, identifier, design):
    """Yield first, random and designed motion, each when it is asked for.

    `identifier` returns what the first loop identified, which says whether a random
    motion keeps the torque limits, as it does for the designed one; `design` returns
    that, the number of its harmonics, and facts.
    """
    first, second = np.random.default_rng([seed, 1]).spawn(2)
    poor = robot.limits.part(**POOR)
    yield random_motion(rigid(robot.nominal), poor, duration, HARMONICS, first), {}
    error = None
    try:
        motion, harmonics, facts = design()
    except Exception as found:
        # the random motion is judged all the same
        error, harmonics = found, HARMONICS
    torque = identified(identifier())
    yield (
        random_motion(torque, robot.limits, duration, harmonics, second),
        {"harmonics": harmonics},
    )
    if error is not None:
        raise error
    yield motion, facts


def run(task, design=designed, duration=DURATION, dt=DT, **settings):
    """Close the loop after each of the motions.

    Parameters
    ----------
    task : dict
        Of `task_of`.
    design : callable, default=designed
        (loop, limits, duration, dt, seed) -> motion, number of harmonics, facts.
    duration, dt : float
        Length and sample period of each motion [s].
    **settings
        Further parameters of `EffectDiscovery`.

    Returns
    -------
    dict
        The task and its result, as plain numbers and lists.
    """
    seed, started = task["seed"], time.perf_counter()
    robot = draw_robot(task["kind"], task["size"], seed)
    result = {
        **task,
        "n_joints": robot.model.nv,
        "declared": list(robot.declared),
        "truth": [robot.truth.name, robot.truth.joint],
        "arms": {},
    }
    noises = dict(zip(ARMS, np.random.default_rng([seed, 2]).spawn(3)))
    loops = {}

    def made():
        begun = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found = design(loops["first"], robot.limits, duration, dt, seed)
        result["design_seconds"] = time.perf_counter() - begun
        return found

    try:
        executions = []
        parts = motions_of(
            robot, seed, duration, lambda: loops["first"].identifier_, made
        )
        for arm, (motion, facts) in zip(ARMS, parts):
            executed = execute(robot, motion, duration, dt, noises[arm])
            begun = time.perf_counter()
            loops[arm] = close_loop(robot, [*executions, executed], dt, **settings)
            result["arms"][arm] = _answer(robot, loops[arm], executed) | {
                "seconds": time.perf_counter() - begun,
                **facts,
            }
            if arm == "first":
                executions = [executed]
    except Exception:
        # counted as a failure of all arms that have no answer, and told
        result["error"] = traceback.format_exc()
    return {**result, "seconds": time.perf_counter() - started}


def _answer(robot, loop, executed):
    single, named = judge(robot.truth, loop.effects_)
    return {
        "single": single,
        "named": named,
        "found": [[e.name, e.joint, list(e.rivals)] for e in loop.effects_],
        "tracking": executed.tracking,
        "saturated": executed.saturated,
    }


def line(result):
    """One line about one robot."""
    name, joint = result["truth"]
    parts = [f"seed {result['seed']}: {name} {joint + 1} ({result['size']:.1f})"]
    for arm in ARMS:
        answer = result["arms"].get(arm)
        if answer is None:
            parts.append(f"{arm} FAILED")
            continue
        found = ", ".join(
            f"{n} {j + 1}" + (f" or {'/'.join(r)}" if r else "")
            for n, j, r in answer["found"]
        )
        verdict = "right" if answer["single"] else "wrong"
        parts.append(f"{arm} {verdict} ({found or 'nothing'})")
    text = "; ".join(parts) + f"; {result['seconds']:.0f} s"
    return f"{text}\n{result['error']}" if "error" in result else text


def _flags(results, arm, key):
    return [r["arms"].get(arm, {}).get(key, False) for r in results]


def _median(results, arm, key):
    found = [r["arms"][arm][key] for r in results if arm in r["arms"]]
    return float(np.median(found)) if found else np.nan


def report(results):
    """Text with the tables of the results that there are."""
    rows, wrong = [], {}
    for arm in ARMS:
        single = _flags(results, arm, "single")
        n, k = len(single), sum(single)
        wrong[arm] = n - k
        rows.append(
            [
                LABELS[arm],
                str(n),
                f"{100 * k / n:.0f} %",
                f"{100 * lower_bound(k, n):.0f} %",
                f"{100 * np.mean(_flags(results, arm, 'named')):.0f} %",
                str(n - k),
            ]
        )
    headers = [
        "motions",
        "robots",
        "right single name",
        "lower bound",
        "named, rivals allowed",
        "failures",
    ]
    share = 1.0 - wrong["designed"] / len(results)
    reached = share >= TARGET, wrong["designed"] <= FAILURES * wrong["random"]
    yes = {True: "reached", False: "not reached"}
    kinds = []
    for kind in KINDS:
        own = [r for r in results if r["kind"] == kind]
        if own:
            counts = [f"{sum(_flags(own, arm, 'single'))}" for arm in ARMS]
            kinds.append([kind, str(len(own)), *counts])
    outside = [
        r["seed"]
        for r in results
        if not r["arms"].get("designed", {}).get("within_limits", True)
    ]
    seconds = [r["design_seconds"] for r in results if "design_seconds" in r]
    errors = [str(r["seed"]) for r in results if "error" in r]
    tracking = [f"{1e3 * _median(results, arm, 'tracking'):.0f}" for arm in ARMS]
    saturated = [f"{100 * _median(results, arm, 'saturated'):.1f}" for arm in ARMS]
    parts = [
        f"Seeds {results[0]['seed']} to {results[-1]['seed']}, {DURATION:g} s at "
        f"{1 / DT:.0f} Hz a motion; one undeclared effect of {SIZES[0]:g} to "
        f"{SIZES[1]:g} times the torque noise along a random reference motion.",
        rst_table(rows, headers),
        f"Targets: {100 * TARGET:.0f} % after the designed motion: {yes[reached[0]]} "
        f"({100 * share:.0f} %); at most a third of random's failures: "
        f"{yes[reached[1]]} ({wrong['designed']} against {wrong['random']}).",
        rst_title("Right single names by kind"),
        rst_table(kinds, ["kind", "robots", *(LABELS[arm] for arm in ARMS)]),
        f"Median tracking error of the motions: {', '.join(tracking)} mrad; drives at "
        f"their peak {', '.join(saturated)} % of the time. "
        f"Designed motions outside their limits: {len(outside)}. Median time of a "
        f"design: {np.median(seconds) if seconds else float('nan'):.1f} s.",
    ]
    if errors:
        parts.append(f"Ended with an error, counted as failures: {', '.join(errors)}.")
    return "\n\n".join(parts)


def seeds_of(arguments):
    """Seeds that were asked for, and what their table is called by."""
    first, last = arguments.seeds
    if last < first:
        raise SystemExit(f"--seeds {first} {last}: the last comes before the first.")
    if first < 100 <= last:
        raise SystemExit("--seeds: 0 to 99 are for work and 100 to 199 to confirm.")
    return range(first, last + 1), "" if last < 100 else "_confirmation"


def add_arguments(arguments):
    """Arguments of both studies of executed motions."""
    arguments.add_argument(
        "--seeds", nargs=2, type=int, default=(0, 99), metavar=("FIRST", "LAST")
    )
    arguments.add_argument("--jobs", type=int, default=1)
    arguments.add_argument(
        "--out", default=None, metavar="FILE", help="results so far, as JSON lines"
    )
    return arguments


def main(argv=None):
    """Print the tables."""
    arguments = add_arguments(parser(__doc__.splitlines()[0])).parse_args(argv)
    seeds, suffix = seeds_of(arguments)
    tasks = [task_of(seed) for seed in seeds]
    ledger = Ledger(arguments.out, KEYS)
    for result in results_of(run, ledger.missing(tasks), arguments.jobs):
        ledger.add(result)
        print(line(result), flush=True)
    command = "python tests/benchmarks/bench_design_rivals.py"
    command += f" --seeds {seeds[0]} {seeds[-1]}"
    publish(
        f"design_rivals{suffix}",
        report(ledger.of(tasks)),
        write=arguments.write,
        command=command,
        states=ledger.states(tasks),
    )


if __name__ == "__main__":
    main()
