"""A robot that is running: what a row and what a refit cost.

Run as ``python tests/benchmarks/bench_online.py [--rows 4000] [--refits 20]
[--write]``. An arm moves; row by row `RobotIdentifier.partial_fit` takes its states and
torques in with ``refit=False``, as a control loop would, and now and then it estimates
and projects the parameters. Every call is timed, by the clock and by the processor: a
process that is not alone waits for the others, which a robot's computer does not let
happen. At 1 kHz a cycle has 1000 microseconds.
"""

import time

import numpy as np
import pinocchio as pin
from _report import parser, publish, rst_table

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording

JOINTS = (6, 7, 10)
MEMORY = 2000
HEADERS = [
    "joints",
    "parameters",
    "row, median [us]",
    "99 % [us]",
    "99 %, processor [us]",
    "refit, median [ms]",
    "99 % [ms]",
    "99 %, processor [ms]",
]


def arm(n_joints):
    """Make a serial arm whose axes alternate, with bodies of one kilogram."""
    model = pin.Model()
    parent = 0
    for j in range(n_joints):
        joint = (pin.JointModelRZ, pin.JointModelRY)[j % 2]()
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
        parent = model.addJoint(parent, joint, place, f"joint_{j + 1}")
        body = pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.2)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


def timed(function, *args, **kwargs):
    """Time of a call by the clock and by the processor [s]."""
    clock, processor = time.perf_counter(), time.process_time()
    function(*args, **kwargs)
    return time.perf_counter() - clock, time.process_time() - processor


def measure(n_joints, n_rows, n_refits):
    """Return times of rows and refits [s], (n, 2), and the number of parameters."""
    model = arm(n_joints)
    recording = make_robot_recording(
        model, duration=0.002 * n_rows, dt=0.002, random_state=0
    )
    robot = RobotIdentifier(
        model, standstill=0.01, forgetting=1 - 1 / MEMORY, friction=("viscous",)
    )
    rows, refits = [], []
    every = max(1, n_rows // (2 * n_refits))
    for i, (x, tau) in enumerate(zip(recording.states, recording.tau)):
        rows.append(timed(robot.partial_fit, x, tau, refit=False))
        # The first half of the rows fills the memory.
        if 2 * i >= n_rows and i % every == 0:
            refits.append(timed(robot.partial_fit, x, tau))
    # The first row loads the model.
    return rows[1:], refits, robot.theta_.size


def report(joints=JOINTS, n_rows=4000, n_refits=20):
    """Table of the guide."""
    table = []
    for n_joints in joints:
        rows, refits, p = measure(n_joints, n_rows, n_refits)
        cells = [*_quantiles(rows, 1e6), *_quantiles(refits, 1e3)]
        table.append([n_joints, p, *cells])
    return rst_table(table, HEADERS, n_labels=0)


def _quantiles(times, unit):
    """Median and 99th percentile by the clock, the latter by the processor too."""
    clock, processor = np.transpose(times)
    figures = *np.quantile(clock, [0.5, 0.99]), np.quantile(processor, 0.99)
    return [f"{unit * x:.0f}" for x in figures]


def main():
    """Run from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument("--rows", type=int, default=4000)
    arguments.add_argument("--refits", type=int, default=20)
    arguments = arguments.parse_args()
    text = report(n_rows=arguments.rows, n_refits=arguments.refits)
    publish("online", text, write=arguments.write)


if __name__ == "__main__":
    main()
