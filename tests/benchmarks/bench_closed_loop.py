"""Robots under their drives in two simulators, from commands alone, and as recorded.

Run ``python tests/benchmarks/bench_closed_loop.py --data-home DIR [--write]``.

Data: `fetch_unitree_go2`, ten runs of one motion of twelve motors, the base held.
`RobotIdentifier` with ``PDDrive`` and the gains of the log, low-pass 10 Hz, fitted on
runs 0 to 6, once with the delay found and once without any. The MJCF file of
`to_mjcf` is run by MuJoCo: commands of runs 7 to 9 go to its motors, whose gains,
delay and limit are the file's, and `follow` of the package does the same with the
identified robot. Both begin where the recording does and see nothing else of it.

- MuJoCo - follow: root mean square of the difference of simulated positions.
- follow - recorded, MuJoCo - recorded: the same against the recorded positions.
- command - recorded: what a robot that does as told would have.

All in mrad, the mean over joints of a kind and the runs. The base was held by hand or
a stand, and is taken for fixed and level: what it moved is in the last columns.
"""

import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from _report import add_root_to_path, fixed, parser, publish, rst_table

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import fetch_unitree_go2
from sklearn_vbjfa.robot import PDDrive

add_root_to_path()

from tests.model._mujoco import followed  # noqa: E402

CUTOFF, PERIOD = 10.0, 1e-3
FITTED, JUDGED = range(7), range(7, 10)
MOTORS = ("hip", "thigh", "calf")


def commanded(recording):
    """Return the recording as one of commands: positions told, gains of the log."""
    return replace(
        recording,
        tau=0.0 * recording.q,
        signals={"q_desired": recording.signals["q_desired"]},
    )


def chosen(recording, runs):
    """Return some runs as one recording."""
    inside = np.isin(recording.groups, list(runs))
    first, last = np.flatnonzero(inside)[[0, -1]]
    rows = slice(first, last + 1)
    return replace(
        recording,
        q=recording.q[rows],
        v=recording.v[rows],
        tau=recording.tau[rows],
        t=recording.t[rows],
        groups=recording.groups[rows] - runs[0],
        group_names=tuple(recording.group_names[k] for k in runs),
        signals={name: x[rows] for name, x in recording.signals.items()},
    )


def simulated(robot, recording, path):
    """Positions (n, nv) of runs by MuJoCo and by the package."""
    robot.to_mjcf(path)
    starts, _ = robot.robot_.query(recording.inputs, recording.groups)
    nv = recording.nv
    parts = [
        followed(
            path,
            starts[part.start, : 2 * nv],
            recording.signals["q_desired"][part],
            recording.dt,
        )
        for part in recording.segments
    ]
    return np.concatenate(parts), robot.follow(recording)[:, :nv]


def row_of(label, robot, recording, seconds):
    """Cells of a robot, a list for each kind of motor."""
    with tempfile.TemporaryDirectory() as folder:
        mujoco, own = simulated(robot, recording, Path(folder) / "go2.xml")
    pairs = (
        (mujoco, own),
        (own, recording.q),
        (mujoco, recording.q),
        (recording.signals["q_desired"], recording.q),
    )
    sizes = [1e3 * np.sqrt(((a - b) ** 2).mean(axis=0)).reshape(4, 3) for a, b in pairs]
    return [
        [
            label,
            name,
            *fixed([one[:, k].mean() for one in sizes], 1),
            *fixed([seconds], 1),
        ]
        for k, name in enumerate(MOTORS)
    ]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None)
    arguments = arguments.parse_args(argv)
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recording = fetch_unitree_go2(data_home=arguments.data_home)
        kp, kd = np.tile([20.0, 20.0, 40.0], 4), np.tile([1.0, 1.0, 2.0], 4)
        whole = commanded(recording)
        for label, delay in (("found", "auto"), ("none", 0.0)):
            drive = PDDrive(kp, kd, delay=delay, period=PERIOD)
            robot = RobotIdentifier(
                recording.robot_model(), dt=recording.dt, cutoff=CUTOFF, drive=drive
            )
            started = time.process_time()
            robot.fit_recording(chosen(whole, FITTED))
            seconds = time.process_time() - started
            late = dict(zip(robot.parameter_names_, robot.theta_)).get("drive:delay")
            if late is not None:
                label = f"{label}, {1e3 * late:.1f} ms"
            rows += row_of(label, robot, chosen(whole, JUDGED), seconds)
    heads = [
        "delay",
        "motor",
        "MuJoCo - follow [mrad]",
        "follow - recorded [mrad]",
        "MuJoCo - recorded [mrad]",
        "command - recorded [mrad]",
        "fit [s]",
    ]
    publish("closed_loop", rst_table(rows, heads, n_labels=2), write=arguments.write)


if __name__ == "__main__":
    main()
