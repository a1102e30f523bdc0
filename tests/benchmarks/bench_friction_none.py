"""The loop from no declared friction, on robots like the demo: what is left over.

Run ``python tests/benchmarks/bench_friction_none.py [--robots N] [--write]``.

Data: ``make_robot_recording`` with the settings of ``load_demo_recording`` drawn
around its values (two motions of 20 s at 200 Hz of the demo arm; highest frequency 0.7
to 1.2 Hz, encoder noise 3e-5 to 3e-4 rad, torque noise 3 to 6 %, inertias that differ
by 10 to 40 %, friction of 0.06 to 0.16 times the load on a random joint beside viscous
and Coulomb friction in all); the demo itself; and the first recording of the demo alone
(4,000 rows). Seeds 0 to 99 are for work.

Split: that of `EffectDiscovery`; the held-out part is looked at once.

What is judged, in the report's own words: a joint is at the floor if its verdict is
"floor" (near the floor included) and it is not among the unexplained. Beside it, the
largest error after over the noise floor. Every joint of every recording is to be at the
floor.
"""

import time
import warnings

import numpy as np
from _ledger import Ledger, results_of
from _report import parser, publish, rst_table

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording, make_robot_recording

DEMO, FIRST = "demo", "demo, first recording"


def draw(seed, duration=20.0):
    """Draw a recording like the demo.

    Parameters
    ----------
    seed : int
        Seed.
    duration : float, default=20.0
        Length of each of its two motions [s].

    Returns
    -------
    SimulatedRecording
        Recording.
    """
    rng = np.random.default_rng([seed, 23])
    return make_robot_recording(
        duration=duration,
        dt=0.005,
        frequency=rng.uniform(0.7, 1.2),
        n_recordings=2,
        encoder_noise=np.exp(rng.uniform(np.log(3e-5), np.log(3e-4))),
        torque_noise=rng.uniform(0.03, 0.06),
        perturbation=rng.uniform(0.1, 0.4),
        undeclared={"load_friction": (int(rng.integers(6)), rng.uniform(0.06, 0.16))},
        random_state=seed,
    )


def recording_of(case):
    """Return the recording of a case: a seed, or one of the names of the demo."""
    if case == DEMO:
        return load_demo_recording()
    if case == FIRST:
        return load_demo_recording().select(0)
    return draw(case)


def judge(recording):
    """Close the loop on a recording with no declared friction; a dict of results."""
    identifier = RobotIdentifier(recording.robot_model(), dt=recording.dt, friction=())
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(recording.q, recording.tau, groups=recording.groups)
    seconds = time.perf_counter() - started
    unexplained = {u.joint for u in loop.unexplained_}
    verdicts = loop.report_.joints
    above = [
        [v.joint, v.text]
        for v in verdicts
        if v.status != "floor" or v.joint in unexplained
    ]
    found = [[e.name, e.joint] for e in loop.effects_]
    return {
        "joints": len(verdicts),
        "above": above,
        "unexplained": sorted(unexplained),
        "ratio": float(np.nanmax(loop.error_after_ / loop.report_.outcome.floor)),
        "error_after": loop.error_after_.tolist(),
        "found": found,
        "seconds": seconds,
    }


def run(task):
    """Judge one case."""
    return {**task, **judge(recording_of(task["case"]))}


HEADERS = [
    "recording",
    "joints at the floor",
    "others, joint from 1",
    "largest error / floor",
    "effects found",
    "s",
]


def row(result):
    """Row of the table: one recording."""
    count = result["joints"]
    case = result["case"]
    return [
        case if isinstance(case, str) else f"seed {case}",
        f"{count - len(result['above'])} of {count}",
        "; ".join(f"{j + 1}: {text}" for j, text in result["above"]) or "none",
        f"{result['ratio']:.2f}",
        ", ".join(f"{name} {j + 1}" for name, j in result["found"]) or "none",
        f"{result['seconds']:.0f}",
    ]


def report(results):
    """Text with the table."""
    clear = sum(not result["above"] for result in results)
    joints = sum(result["joints"] for result in results)
    above = sum(len(result["above"]) for result in results)
    return (
        rst_table([row(result) for result in results], HEADERS, n_labels=3)
        + f"\n\nAll joints at the floor: {clear} of {len(results)} recordings, "
        f"{joints - above} of {joints} joints (target: all)."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--robots", type=int, default=20)
    arguments.add_argument("--seed", type=int, default=0, help="seed of the first")
    arguments.add_argument(
        "--no-demo", action="store_true", help="leave the demo itself out"
    )
    arguments.add_argument("--jobs", type=int, default=1)
    arguments.add_argument(
        "--out", default=None, metavar="FILE", help="results so far, as JSON lines"
    )
    arguments = arguments.parse_args(argv)
    cases = [] if arguments.no_demo else [DEMO, FIRST]
    cases += range(arguments.seed, arguments.seed + arguments.robots)
    tasks = [{"case": case} for case in cases]
    ledger = Ledger(arguments.out, ("case",))
    for result in results_of(run, ledger.missing(tasks), arguments.jobs):
        ledger.add(result)
        print(" | ".join(map(str, row(result))), flush=True)
    publish(
        "friction_none",
        report(ledger.of(tasks)),
        write=arguments.write,
        states=ledger.states(tasks),
    )


if __name__ == "__main__":
    main()
