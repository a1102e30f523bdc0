"""Processor seconds of the whole loop, each recording in a process of its own.

Run ``python tests/benchmarks/bench_search_seconds.py [--cases NAME ...] [--quick]
[--data-home DIR] [--out FILE] [--write]``.

Data: the demonstration; one run of the quadruped (`fetch_unitree_go2`, 4,781 rows of
twelve motors); the first two motions of the KR300 of the Nonlinear Benchmark (7,260
rows at 10 Hz, folder ``kuka_kr300_benchmark``); and simulated robots, seed 0: an arm of
six joints, 50 s at 100 Hz, on the command line; seven joints, 28,000 rows at 200 Hz,
and six joints, 20,000 rows, whose torques are those of a PD law, both with four effects
that the description lacks; ten arms of six joints on one base, 60 s; the 30 minutes of
``bench_long_recordings.py``.

``EffectDiscovery.fit`` with its defaults and the text of its report, one thread, user
and system time of the process after its imports.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import warnings
from importlib import resources
from pathlib import Path

import numpy as np
from _report import Ledger, fixed, parser, publish, rst_table
from _undeclared_robots import nominal_robot

# Target of each case [s].
CASES = {
    "demo": np.nan,
    "go2": 8.0,
    "kr300": 12.0,
    "arm, command line": 10.0,
    "7 joints, 28,000 rows": 30.0,
    "6 joints, pd": 60.0,
    "60 joints": 30.0,
    "7 joints, 30 min": 45.0,
}
QUICK = {"2 joints": np.nan}
LACKING = {
    "load_friction": (1, 0.15),
    "stribeck": (0, 2.0),
    "ripple": (2, 0.6),
    "spring": (3, 2.0),
}
# Gears from motor to joint of the KR300.
GEARS = np.array([1798 / 7, 1872 / 7, 757 / 3, 221, 5032 / 21, 206793 / 1340])
ROWS_OF_A_MOTION = 3630


def identified(model, recording, **settings):
    """Close the loop on a recording."""
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

    groups = settings.pop("groups", None)
    settings = {"dt": recording["dt"], **settings}
    loop = EffectDiscovery(RobotIdentifier(model, **settings), random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(recording["q"], recording["tau"], groups=groups)
    str(loop.report_)
    return loop.effects_, loop.possible_


def simulated(joints, rows, dt, undeclared):
    """Make a recording of a serial arm."""
    from sklearn_vbjfa.datasets import make_robot_recording

    model = nominal_robot("serial", np.random.default_rng(0), joints)
    return model, make_robot_recording(
        model, duration=rows * dt, dt=dt, undeclared=undeclared, random_state=0
    )


def demo(data_home):
    from sklearn_vbjfa.datasets import load_demo_recording

    one = load_demo_recording()
    given = {"q": one.q, "tau": one.tau, "dt": one.dt}
    return lambda: identified(one.robot_model(), given, groups=one.groups)


def go2(data_home):
    from sklearn_vbjfa.datasets import fetch_unitree_go2

    whole = fetch_unitree_go2(data_home=data_home, download_if_missing=False)
    one = whole.select(0)
    given = {"q": one.q, "tau": one.tau, "dt": one.dt}
    return lambda: identified(one.robot_model(), given)


def kr300(data_home):
    folder = Path(data_home)
    rows = slice(2 * ROWS_OF_A_MOTION)
    with np.load(folder / "kuka_kr300_benchmark" / "train.npz") as file:
        q = np.deg2rad(file["q_deg"][rows].astype(float))
        tau = file["tau_motor_Nm"][rows].astype(float) * GEARS
    groups = np.arange(len(q)) // ROWS_OF_A_MOTION
    model = str(folder / "kuka_kr300" / "kr300_nominal.urdf")
    given = {"q": q, "tau": tau, "dt": 0.1}
    return lambda: identified(model, given, groups=groups)


def command_line(data_home):
    from sklearn_vbjfa._cli import main
    from sklearn_vbjfa.datasets import make_robot_recording

    folder = Path(tempfile.mkdtemp())
    table = folder / "six.csv"
    urdf = resources.files("sklearn_vbjfa.datasets") / "robots" / "demo_arm.urdf"
    lacking = {"load_friction": (1, 0.15), "stribeck": (2, 4.0), "spring": (3, 3.0)}
    made = {"duration": 50.0, "dt": 0.01, "undeclared": lacking, "random_state": 0}
    one = make_robot_recording(str(urdf), **made)
    names = ["t", *(f"q{j + 1}" for j in range(6)), *(f"tau{j + 1}" for j in range(6))]
    columns = np.column_stack([one.t, one.q, one.tau])
    np.savetxt(table, columns, delimiter=",", header=",".join(names), comments="")

    def run():
        words = [str(table), "--urdf", str(urdf), "--out", str(folder / "out")]
        main(["close-loop", *words])
        report = json.loads((folder / "out" / "report.json").read_text())
        return [argparse.Namespace(**e) for e in report["effects"]], ()

    return run


def seven_joints(data_home):
    model, one = simulated(7, 28_000, 0.005, LACKING)
    given = {"q": one.q, "tau": one.tau, "dt": one.dt}
    return lambda: identified(model, given)


def commanded(data_home):
    from sklearn_vbjfa.robot import PDDrive

    model, one = simulated(6, 20_000, 0.005, LACKING)
    stiffness, damping = 50.0 * np.ptp(one.tau, axis=0), 2.0 * np.ptp(one.tau, axis=0)
    wanted = one.q + (one.tau + damping * one.states[:, 6:12]) / stiffness
    given = {"q": one.q, "tau": wanted, "dt": one.dt}
    drive = PDDrive(stiffness, damping)
    return lambda: identified(model, given, drive=drive)


def sixty_joints(data_home):
    from bench_long_recordings import DT, recording, robot

    arms = 10 * (6,)
    q, tau = recording(arms, 60_000)
    given = {"q": q[::5], "tau": tau[::5], "dt": 5 * DT}
    return lambda: identified(robot(arms), given, friction=("viscous", "coulomb"))


def half_an_hour(data_home, joints=7, rows=1_800_000):
    from bench_long_recordings import DT, recording, robot

    q, tau = recording((joints,), rows)
    given = {"q": q, "tau": tau, "dt": DT}
    declared = {"friction": ("viscous", "coulomb")}
    return lambda: identified(robot((joints,)), given, **declared)


RUNS = (demo, go2, kr300, command_line, seven_joints, commanded, sixty_joints)
MADE = dict(zip(CASES, (*RUNS, half_an_hour), strict=True))
MADE["2 joints"] = lambda data_home: half_an_hour(data_home, 2, 20_000)


def processor():
    """Processor seconds of this process and its children."""
    used = [resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN]
    used = [resource.getrusage(who) for who in used]
    return sum(one.ru_utime + one.ru_stime for one in used)


def run_here(case, data_home):
    """Figures of a case, in this process."""
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier  # noqa: F401

    run = MADE[case](data_home)
    started = processor()
    named, possible = run()
    seconds = processor() - started
    names = [[e.name, int(e.joint)] for e in named]
    return {"seconds": seconds, "named": names, "possible": len(possible)}


def measure(case, data_home):
    """Figures of a case in a process of its own."""
    command = [sys.executable, __file__, "--run", case]
    command += ["--data-home", str(data_home)] if data_home else []
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    answer = subprocess.run(command, capture_output=True, text=True, env=environment)
    if answer.returncode:
        raise RuntimeError(f"{case} failed:\n{answer.stderr}")
    return json.loads(answer.stdout.splitlines()[-1])


HEADERS = ["recording", "seconds", "target", "names"]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, data=True, out=True)
    arguments.add_argument("--cases", nargs="+", help="names of the table")
    # what the script starts itself with
    arguments.add_argument("--run", help=argparse.SUPPRESS)
    arguments = arguments.parse_args(argv)
    if arguments.run:
        print(json.dumps(run_here(arguments.run, arguments.data_home)))
        return
    cases = QUICK if arguments.quick else CASES
    ledger = Ledger(arguments.out, ("case",))
    asked = [{"case": name} for name in arguments.cases or cases]
    for task in ledger.missing(asked):
        ledger.add(task | measure(task["case"], arguments.data_home))
    rows = [
        [
            x["case"],
            f"{x['seconds']:.1f}",
            *fixed([cases[x["case"]]], 0),
            len(x["named"]),
        ]
        for x in ledger.of(asked)
    ]
    commits = ledger.commits()
    publish("search_seconds", rst_table(rows, HEADERS), arguments, commits=commits)


if __name__ == "__main__":
    main()
