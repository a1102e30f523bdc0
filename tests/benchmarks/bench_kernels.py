"""What the kernels of the linear algebra change in an identified robot.

Run as ``python tests/benchmarks/bench_kernels.py --data-home DIR``. Each recording is
fitted, as in ``bench_measured_robots.py``, in a process of its own for each kernel of
OpenBLAS (the environment variable OPENBLAS_CORETYPE), and the parameters and the
torques predicted for the held-out part are compared. A kernel that does not take effect
is refused.
"""

import json
import os
import subprocess
import sys
import tempfile
import warnings
from itertools import combinations
from pathlib import Path

import numpy as np
from _report import parser, publish, rst_table
from threadpoolctl import threadpool_info, threadpool_limits

SETS = ("demo", "ur5", "staubli_tx40")
# OpenBLAS calls its kernels for processors of the Prescott generation Katmai.
KERNELS = {
    "Haswell": ("Haswell",),
    "SkylakeX": ("SkylakeX",),
    "Prescott": ("Prescott", "Katmai"),
}
# Largest difference of a predicted torque over the spread of the joint's torque.
TARGET = 1e-9


def available():
    """Kernels that this processor can run; SkylakeX needs AVX-512."""
    flags = Path("/proc/cpuinfo")
    wide = flags.is_file() and "avx512f" in flags.read_text(encoding="utf-8")
    return [name for name in KERNELS if wide or name != "SkylakeX"]


def fit(name, data_home, path):
    """Fit a recording in this process and keep what is compared (the child's part)."""
    from bench_measured_robots import load

    _, _, identifier, ((X, y, groups), (X_test, y_test, groups_test)) = load(
        name, data_home
    )
    with threadpool_limits(limits=1), warnings.catch_warnings():
        # Of the recordings, and the same under every kernel.
        warnings.simplefilter("ignore", UserWarning)
        identifier.fit(X, y, groups=groups)
        predicted = identifier.predict(X_test, groups=groups_test)
    np.savez(
        path,
        estimate=identifier.theta_unconstrained_,
        projected=identifier.theta_,
        predicted=predicted,
        spread=y_test.std(axis=0),
    )
    blas = [one for one in threadpool_info() if one["user_api"] == "blas"]
    print(json.dumps([one.get("architecture", "unknown") for one in blas]))


def fit_under(kernel, name, data_home, folder):
    """Fit in a process with a kernel; return what it kept as a dict of arrays."""
    path = Path(folder) / f"{name}_{kernel}.npz"
    command = [sys.executable, __file__, "--fit", name, "--out", str(path)]
    if data_home is not None:
        command += ["--data-home", str(data_home)]
    answer = subprocess.run(
        command,
        env={**os.environ, "OPENBLAS_CORETYPE": kernel},
        capture_output=True,
        text=True,
        check=False,
    )
    if answer.returncode:
        raise RuntimeError(f"The fit of {name} with {kernel} failed:\n{answer.stderr}")
    found = json.loads(answer.stdout.splitlines()[-1])
    if not found or any(one not in KERNELS[kernel] for one in found):
        raise RuntimeError(
            f"OPENBLAS_CORETYPE={kernel} did not take effect, the linear algebra runs "
            f"on {found}; install NumPy and SciPy from PyPI, on x86-64."
        )
    with np.load(path) as kept:
        return dict(kept)


def differences(fits):
    """Largest difference between any two fits: estimate, projected, torque.

    Parameters relative to the largest, torques to the spread of the joint's.
    """
    worst = np.zeros(3)
    for a, b in combinations(fits, 2):
        worst = np.maximum(
            worst,
            [
                np.abs(a["estimate"] - b["estimate"]).max()
                / np.abs(a["estimate"]).max(),
                np.abs(a["projected"] - b["projected"]).max()
                / np.abs(a["projected"]).max(),
                (np.abs(a["predicted"] - b["predicted"]) / a["spread"]).max(),
            ],
        )
    return worst


def report(names=SETS, data_home=None, kernels=None):
    """Table of sets, and whether all are within the target."""
    kernels = available() if kernels is None else kernels
    rows, within = [], True
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            fits = [fit_under(kernel, name, data_home, folder) for kernel in kernels]
            worst = differences(fits)
            within &= bool(worst[2] <= TARGET)
            rows.append([name, *(f"{value:.0e}" for value in worst)])
    table = rst_table(rows, ["set", "estimate", "projected", "predicted torque"])
    return (
        f"{table}\n\nLargest differences between any two of the kernels "
        f"{', '.join(kernels)}: of the parameters before and after the projection, "
        "relative to the largest, and of the torques predicted for the held-out part, "
        f"over the spread of the joint's torque. Asked for are {TARGET:.0e} of that: "
        f"{'kept' if within else 'NOT KEPT'}."
    )


def main(argv=None):
    """Print the table, or do one fit for it."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, help="folder of the sets")
    arguments.add_argument("--sets", nargs="+", default=SETS, help="which sets")
    arguments.add_argument("--fit", help="a set to fit in this process")
    arguments.add_argument("--out", help="where that fit is kept")
    arguments = arguments.parse_args(argv)
    if arguments.fit:
        fit(arguments.fit, arguments.data_home, arguments.out)
        return
    text = report(arguments.sets, arguments.data_home)
    command = "python tests/benchmarks/bench_kernels.py --data-home DIR"
    publish("kernels", text, write=arguments.write, command=command)


if __name__ == "__main__":
    main()
