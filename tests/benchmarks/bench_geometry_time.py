"""What looking for faults of the geometry and of the channels costs in time.

Run ``python tests/benchmarks/bench_geometry_time.py --data-home DIR [--cases NAME ...]
[--write]``.

Data: the demo arm and a whole robot of ``bench_loop_time.py``, 60 s each at 200 Hz;
UR5 and TX40 as in `MANIPULATED_SETS`. The loop is closed with all effects of the
library and with all but ``base_tilt``, ``joint_zero``, ``joint_axis``, ``torque_gain``
and ``signal``, in turns, in a process that has fitted a short recording before; of
``--repeat`` times the smallest counts, and it is the processor's, which a busy machine
leaves as it is. Target: a ratio of at most 1.5.
"""

import sys
import time
import warnings

import numpy as np
from _protocol_sets import MANIPULATED_SETS
from _report import parser, publish, rst_table
from bench_loop_time import CASES, DT, demo, measure
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.effects import available

NEW = ("base_tilt", "joint_zero", "joint_axis", "torque_gain", "signal")
SIMULATED = ("demo", "whole robot")
MEASURED = ("ur5", "staubli_tx40")
TARGET = 1.5


def without():
    """Return names of all effects but the new ones."""
    return [name for name in available() if name not in NEW]


def load(name, data_home=None, seconds=60.0):
    """Load a recording.

    Returns
    -------
    identifier : RobotIdentifier
        Declared model.
    q, tau, groups : ndarray
        Recording.
    """
    if name in SIMULATED:
        case = CASES[name](seconds)
        identifier = RobotIdentifier(case.model, dt=DT, friction=case.friction)
        return identifier, case.q, case.tau, case.groups
    frozen = MANIPULATED_SETS[name]
    recording = frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    return identifier, recording.q, recording.tau, recording.groups


def timed(identifier, q, tau, groups, effects):
    """Close the loop once.

    Returns
    -------
    loop : EffectDiscovery
        Fitted.
    processor, seconds : float
        Processor time and time [s].
    """
    loop = EffectDiscovery(clone(identifier), effects=effects, random_state=0)
    started, used = time.perf_counter(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(q, tau, groups=groups)
    return loop, time.process_time() - used, time.perf_counter() - started


HEADERS = [
    "recording",
    "found without the five",
    "found with them",
    "joints",
    "samples",
    "processor time without [s]",
    "with",
    "ratio",
    "target",
    "time without [s]",
    "with",
]


def row(name, recording, repeat=1, old=None, new="all"):
    """Row of the table, the loops closed `repeat` times in turns.

    Parameters
    ----------
    name : str
        What it is called.
    recording : tuple
        Of `load`.
    repeat : int, default=1
        How often each loop is closed.
    old, new : list of str or "all", default=None, "all"
        Effects of the two loops; None takes all but the new ones.
    """
    old = without() if old is None else old
    runs = {"old": [], "new": []}
    for _ in range(repeat):
        for key, effects in (("old", old), ("new", new)):
            loop, processor, seconds = timed(*recording, effects)
            runs[key].append((processor, seconds, _words(loop)))
    best = {key: min(found) for key, found in runs.items()}
    ratio = best["new"][0] / best["old"][0]
    q = recording[1]
    return [
        name,
        best["old"][2],
        best["new"][2],
        str(q.shape[1]),
        str(len(q)),
        f"{best['old'][0]:.1f}",
        f"{best['new'][0]:.1f}",
        f"{ratio:.2f}",
        f"{TARGET:g}",
        f"{best['old'][1]:.1f}",
        f"{best['new'][1]:.1f}",
    ]


def _words(loop):
    pairs = [f"{e.name} {e.joint + 1}" for e in loop.effects_]
    return ", ".join(pairs) or "nothing"


def main(argv=None):
    """Print the table."""
    names = [*SIMULATED, *MEASURED]
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--cases", nargs="+", choices=names, default=names)
    arguments.add_argument("--repeat", type=int, default=1)
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments = arguments.parse_args(argv)
    # what is imported or compiled once is not the loop's time
    measure(demo(4.0), effects=["coulomb"], max_effects=1)
    rows = []
    for name in arguments.cases:
        rows.append(row(name, load(name, arguments.data_home), arguments.repeat))
        print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    ratios = [float(x[HEADERS.index("ratio")]) for x in rows]
    text = f"Largest ratio {max(ratios):.2f}, geometric mean "
    text += f"{np.exp(np.mean(np.log(ratios))):.2f}; target at most {TARGET:g}."
    table = rst_table(rows, HEADERS, n_labels=3)
    publish("geometry_time", f"{text}\n\n{table}", write=arguments.write)


if __name__ == "__main__":
    main()
