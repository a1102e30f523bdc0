"""Ranges for simulators: whether left-out recordings are in them.

Run as ``python tests/benchmarks/bench_ranges.py [--trials 200] [--write]``. A joint
whose viscous and dry friction, offset and armature are drawn anew for each recording,
normal with a known share of the value as deviation, is identified from some recordings;
the table has how often the values of one more are in their ranges of 90 %, and how
often they are within 1.645 standard deviations of the fit alone, which says nothing of
how recordings differ.
"""

import sys
import warnings

import numpy as np
from _report import ROOT, parser, publish, rst_table

RECORDINGS, SHARES = (2, 4, 8, 16), (0.1, 0.3)
HEADERS = [
    "recordings",
    "scatter [% of the value]",
    "armature [%]",
    "damping [%]",
    "dry friction [%]",
    "offset, about zero [%]",
    "all, by the noise alone [%]",
]
# viscous, coulomb, offset and rotor inertia, as the table has them
_ORDER = [3, 0, 1, 2]


def measure(urdf, n, share, trials):
    """Return how often each value is in its range (4,), and in that of noise alone."""
    sys.path.append(str(ROOT))
    from tests.robot._differing import covers, share_of

    with warnings.catch_warnings():
        # States are drawn one by one.
        warnings.filterwarnings("ignore", message="The rows are not in the order")
        done = [covers(urdf, 5000 + k, n, share_of(share)) for k in range(trials)]
    inside, noise = (np.array(one) for one in zip(*done))
    return inside.mean(axis=0)[_ORDER], noise.mean()


def report(trials=200, recordings=RECORDINGS, shares=SHARES):
    """Table of the guide."""
    import tempfile
    from pathlib import Path

    sys.path.append(str(ROOT))
    from tests.robot._differing import URDF

    table = []
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder, "one.urdf")
        urdf.write_text(URDF)
        for share in shares:
            for n in recordings:
                inside, noise = measure(str(urdf), n, share, trials)
                cells = [f"{100 * x:.0f}" for x in (*inside, noise)]
                table.append([n, f"{100 * share:.0f}", *cells])
    return rst_table(table, HEADERS)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=200)
    arguments = arguments.parse_args(argv)
    publish("ranges", report(4 if arguments.quick else arguments.trials), arguments)


if __name__ == "__main__":
    main()
