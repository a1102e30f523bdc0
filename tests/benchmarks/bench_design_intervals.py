"""Width of parameter intervals after a designed motion over a random one.

Run ``python tests/benchmarks/bench_design_intervals.py --seeds FIRST LAST [--jobs N]
[--out FILE] [--write]``; both seeds are included, 0 to 99 are for work, 100 to 199 to
confirm, once.

Data: robots, limits, controller, noise and motions as in ``bench_design_rivals.py``,
with three or four joints, as there is time for them here, and without the undeclared
effect: the declared model is right, and every motion leaves the same noise.
`RobotIdentifier` is fitted to the poor first recording; ``design_motion(identifier,
...)``, without a report, makes the designed motion from it, within the limits that the
random one touches. Both are executed by the low-gain controller for 20 s, and what is
compared is

- both recordings: fitted to the first and the second together, as one would;
- the second alone.

Of every parameter that stands on its own in both fits (`identifiable_`), the width of
the 90 % interval after the designed motion over that after the random one; both
intervals have the same form, 1.64 standard deviations to each side. Beside it, how
often the intervals hold the truth: a narrow interval that does not is worth nothing.

Target, fixed before the design was written: the median of all parameters of all robots
at most 0.5, fitted to both recordings.
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
from _design_robots import HARMONICS, POOR, draw_robot, execute
from _ledger import Ledger, results_of
from _report import parser, publish, rst_table
from bench_design_rivals import (
    DT,
    DURATION,
    KEYS,
    add_arguments,
    seeds_of,
    task_of,
)
from scipy import stats

from sklearn_vbjfa import RobotIdentifier

TARGET = 0.5
JOINTS = (3, 4)
NINETY = stats.norm.ppf(0.95)
STUDIES = {"both": "both recordings", "alone": "the second alone"}


def designed(identifier, limits, duration, dt, seed):
    """Design the second motion; how many harmonics it has."""
    from sklearn_vbjfa.design import design_motion

    made = design_motion(
        identifier,
        duration=duration,
        dt=dt,
        limits=limits.of_package(),
        random_state=seed,
    )
    motion = Designed(made)
    return motion, top_harmonic(motion, duration)


def fitted(robot, executions, dt):
    """Identify a robot from recordings."""
    identifier = RobotIdentifier(robot.nominal, dt=dt, friction=robot.declared)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return identifier.fit(
            np.concatenate([x.q for x in executions]),
            np.concatenate([x.tau for x in executions]),
            groups=np.repeat(
                np.arange(len(executions)), [len(x.q) for x in executions]
            ),
        )


def true_parameters(robot):
    """Return the true parameters in the order of the identifier."""
    bodies = [body.toDynamicParameters() for body in robot.model.inertias[1:]]
    friction = [robot.friction[name] for name in robot.declared]
    return np.column_stack([bodies, *friction]).ravel()


def compare(robot, designed_fit, random_fit):
    """Ratios of widths, and which intervals hold the truth, as lists."""
    truth = true_parameters(robot)
    own = designed_fit.identifiable_ & random_fit.identifiable_
    widths, inside = [], []
    for fit in (designed_fit, random_fit):
        deviation = fit.theta_std_[own]
        error = np.abs(fit.theta_unconstrained_[own] - truth[own])
        widths.append(deviation)
        inside.append((error <= NINETY * deviation).tolist())
    return {
        "ratio": (widths[0] / widths[1]).tolist(),
        "names": [n for n, one in zip(designed_fit.parameter_names_, own) if one],
        "designed_holds": inside[0],
        "random_holds": inside[1],
    }


def run(task, design=designed, duration=DURATION, dt=DT):
    """Compare the intervals of one robot after both motions.

    Parameters
    ----------
    task : dict
        Of ``bench_design_rivals.task_of``.
    design : callable, default=designed
        (identifier, limits, duration, dt, seed) -> motion, number of harmonics.
    duration, dt : float
        Length and sample period of each motion [s].

    Returns
    -------
    dict
        The task and its result, as plain numbers and lists.
    """
    seed, started = task["seed"], time.perf_counter()
    robot = draw_robot(task["kind"], task["size"], seed, n_joints=JOINTS)
    result = {"seed": seed, "n_joints": robot.model.nv}
    draws = np.random.default_rng([seed, 3]).spawn(5)

    def recorded(motion, rng):
        return execute(robot, motion, duration, dt, rng, undeclared=False)

    try:
        poor = robot.limits.part(**POOR)
        motion = random_motion(
            rigid(robot.nominal), poor, duration, HARMONICS, draws[0]
        )
        first = recorded(motion, draws[1])
        identifier = fitted(robot, [first], dt)
        begun = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            motion, harmonics = design(identifier, robot.limits, duration, dt, seed)
        result["design_seconds"] = time.perf_counter() - begun
        ours = recorded(motion, draws[2])
        motion = random_motion(
            identified(identifier), robot.limits, duration, harmonics, draws[3]
        )
        theirs = recorded(motion, draws[4])
        for study, before in (("both", [first]), ("alone", [])):
            result[study] = compare(
                robot,
                fitted(robot, [*before, ours], dt),
                fitted(robot, [*before, theirs], dt),
            )
    except Exception:
        result["error"] = traceback.format_exc()
    return {**result, "seconds": time.perf_counter() - started}


def line(result):
    """One line about one robot."""
    start = f"seed {result['seed']}, {result['n_joints']} joints: "
    if "error" in result:
        return start + result["error"]
    ratios = [
        f"{STUDIES[study]} {np.median(result[study]['ratio']):.2f}"
        f" of {len(result[study]['ratio'])}"
        for study in STUDIES
        if result[study]["ratio"]
    ]
    return start + f"median ratio {', '.join(ratios)}; {result['seconds']:.0f} s"


def report(results):
    """Text with the table of the results that there are."""
    done = [r for r in results if "error" not in r]
    rows, medians = [], {}
    for study, label in STUDIES.items():
        ratio = np.concatenate([r[study]["ratio"] for r in done])
        quartiles = np.quantile(ratio, [0.25, 0.5, 0.75])
        medians[study] = float(quartiles[1])
        holds = [
            100 * np.mean(np.concatenate([r[study][f"{arm}_holds"] for r in done]))
            for arm in ("designed", "random")
        ]
        rows.append(
            [
                label,
                str(len(done)),
                str(ratio.size),
                f"{medians[study]:.2f}",
                f"{quartiles[0]:.2f} to {quartiles[2]:.2f}",
                *(f"{x:.0f} %" for x in holds),
            ]
        )
    headers = [
        "fitted to",
        "robots",
        "parameters",
        "median ratio",
        "quartiles",
        "hold the truth, designed",
        "random",
    ]
    verdict = "reached" if medians["both"] <= TARGET else "not reached"
    seconds = np.median([r["design_seconds"] for r in done])
    parts = [
        f"Seeds {results[0]['seed']} to {results[-1]['seed']}, {DURATION:g} s at "
        f"{1 / DT:.0f} Hz a motion. Width of the interval after the designed motion "
        "over that after the random one.",
        rst_table(rows, headers),
        f"Target: a median of {TARGET:g} for both recordings: {verdict} "
        f"({medians['both']:.2f}). Median time of a design: {seconds:.1f} s.",
    ]
    failed = [str(r["seed"]) for r in results if "error" in r]
    if failed:
        parts.append(f"Ended with an error: {', '.join(failed)}.")
    return "\n\n".join(parts)


def main(argv=None):
    """Print the table."""
    arguments = add_arguments(parser(__doc__.splitlines()[0])).parse_args(argv)
    seeds, suffix = seeds_of(arguments)
    tasks = [task_of(seed) for seed in seeds]
    ledger = Ledger(arguments.out, KEYS)
    for result in results_of(run, ledger.missing(tasks), arguments.jobs):
        ledger.add(result)
        print(line(result), flush=True)
    command = "python tests/benchmarks/bench_design_intervals.py"
    command += f" --seeds {seeds[0]} {seeds[-1]}"
    publish(
        f"design_intervals{suffix}",
        report(ledger.of(tasks)),
        write=arguments.write,
        command=command,
        states=ledger.states(tasks),
    )


if __name__ == "__main__":
    main()
