"""Closing the loop on the measured robots: error before and after, what was found.

Run ``python tests/benchmarks/bench_discovery_measured.py --data-home DIR [--write]``.
The declared model is the paper's, ten inertial parameters and viscous friction per
joint; the untouched part of every recording is looked at once. Filters and masks are
those of ``bench_measured_robots.py``, but for EMPS (20 Hz).
"""

import sys
import time
import warnings

import numpy as np
from _report import parser, publish, rst_table

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets._catalogue import protocols

# Recordings used, where a set has several and the others are another motion's; and
# cut-offs [Hz] of the low-pass where they differ from the comparison of methods.
RECORDINGS = {"emps": ("DATA_EMPS",), "ur5": ("No6",), "kuka_kr300": ("A",)}
CUTOFFS = {"emps": 20.0}
# Seconds of a long recording that are used.
LENGTHS = {"tflex_1dof": 80.0}


def load(name, data_home):
    """Return the recording, its rows in use, and the declared model."""
    protocol = protocols()[name]
    recording = protocol.load(data_home=data_home)
    if name in RECORDINGS:
        recording = recording.select(*RECORDINGS[name])
    rows = np.flatnonzero(recording.t < LENGTHS.get(name, np.inf))
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        cutoff=CUTOFFS.get(name, protocol.cutoff),
        standstill=protocol.standstill,
    )
    return recording, rows, identifier


def measure(name, data_home, **settings):
    """Close the loop on one set."""
    recording, rows, identifier = load(name, data_home)
    loop = EffectDiscovery(identifier, ceiling=False, random_state=0, **settings)
    return loop.fit(recording.q[rows], recording.tau[rows], recording.groups[rows])


def row(name, loop, seconds):
    """Row of the table."""
    before, after = 100 * loop.error_before_, 100 * loop.error_after_
    found = ", ".join(f"{e.name} {e.joint + 1}" for e in loop.effects_)
    width = loop.report_.outcome.intervals["difference"]
    worse = [str(j + 1) for j in np.flatnonzero(width[0] > 0)]
    return [
        name,
        " ".join(f"{x:.1f}" for x in before),
        " ".join(f"{x:.1f}" for x in after),
        f"{np.nanmean(before):.1f}",
        f"{np.nanmean(after):.1f}",
        ", ".join(worse) or "none",
        found or "nothing",
        f"{seconds:.0f}",
    ]


HEADERS = [
    "set",
    "before, each joint [%]",
    "after, each joint [%]",
    "mean before",
    "mean after",
    "joints surely worse",
    "found, joint from 1, in order",
    "s",
]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--data", nargs="*", default=None)
    arguments.add_argument(
        "--report", action="store_true", help="print the report of each set"
    )
    arguments = arguments.parse_args(argv)
    rows = []
    for name in arguments.data or [name for name in protocols() if name != "demo"]:
        started = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            loop = measure(name, arguments.data_home)
        rows.append(row(name, loop, time.perf_counter() - started))
        if arguments.report:
            print(loop.report_)
        print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    text = (
        "Root mean square of the residual over the standard deviation of the torque, "
        "on the untouched part, over the spread of the torque in the moving time of "
        "the whole recording.\n\n" + rst_table(rows, HEADERS, n_labels=3)
    )
    publish("discovery_measured", text, write=arguments.write)


if __name__ == "__main__":
    main()
