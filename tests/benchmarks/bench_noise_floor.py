"""Residual of the measured robots against what noise alone would leave.

Run ``python tests/benchmarks/bench_noise_floor.py --data-home DIR [--write]``. Fits,
splits, filters and masks are those of ``bench_measured_robots.py``, the estimator is
`RobotIdentifier` with its defaults.
"""

import sys
import time
import warnings

import numpy as np
from _report import parser, publish, rst_table
from bench_measured_robots import load

from sklearn_vbjfa.datasets._protocols import protocols

HEADERS = [
    "set",
    "joint",
    "unit",
    "fitted",
    "held out",
    "noise floor",
    "torque noise",
    "input noise",
    "output noise",
    "fitted / floor",
]


def _figures(values):
    """Numbers with three digits; a dash for what does not exist."""
    return [f"{v:.3g}" if np.isfinite(v) else "–" for v in values]


def measure(name, data_home):
    """Return the rows of one set, one per joint."""
    recording, _, identifier, (train, test) = load(name, data_home)
    robot = identifier.fit(*train[:2], groups=train[2])
    fitted, held_out = (
        robot.residuals(*part[:2], groups=part[2]).rms() for part in (train, test)
    )
    columns = np.column_stack(
        [
            fitted,
            held_out,
            robot.noise_floor_,
            robot.torque_noise_,
            robot.input_noise_torque_,
            robot.output_noise_,
            fitted / robot.noise_floor_,
        ]
    )
    return [
        [name, joint, unit, *_figures(values)]
        for joint, unit, values in zip(
            robot.joint_names_, recording.torque_units, columns
        )
    ]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--data", nargs="*", default=None, help="sets; by default all measured ones"
    )
    arguments = arguments.parse_args(argv)
    rows = []
    for name in arguments.data or [name for name in protocols() if name != "demo"]:
        started = time.perf_counter()
        with warnings.catch_warnings():
            # Joints that stand still are told of by the fit.
            warnings.simplefilter("ignore", UserWarning)
            rows += measure(name, arguments.data_home)
        seconds = time.perf_counter() - started
        print(f"{name}: {seconds:.0f} s", file=sys.stderr, flush=True)
    text = (
        "Root mean squares behind the low-pass and the mask, in the unit of the "
        "joint's torque.\n\n" + rst_table(rows, HEADERS, n_labels=3)
    )
    publish("noise_floor", text, write=arguments.write)


if __name__ == "__main__":
    main()
