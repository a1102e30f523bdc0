"""Whether fits on several processes are those in memory, with one that dies as well.

Run ``python tests/benchmarks/bench_dask.py [--quick] [--write]``.

Data: the demonstration's arm of six joints (``make_robot_recording``, seed 0), eight
recordings of 15 s at 100 Hz in a file each, with a spring on joint 2 that is not
declared. ``RobotIdentifier.fit`` and ``EffectDiscovery.fit`` on all of them in memory
are the reference; ``fit_recordings`` reads the files

- in threads of one process, without a cluster,
- with one and with two processes of a ``LocalCluster``,
- with two, one of which is killed when it has done its first task and before it can
  tell: of the second moments (identifier), or of any fit of the loop.

Differences are the largest of all parameters, over the largest parameter, and of the
joints' torque noise (identifier) or held-out errors (loop), over the largest of them.
Target: 1e-9.
"""

import contextlib
import os
import signal
import tempfile
from dataclasses import replace
from pathlib import Path
from unittest import mock

import distributed
import numpy as np
from _report import parser, publish, rst_table

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.distributed import _passes, fit_recordings

SECONDS, RECORDINGS, DT = 15.0, 8, 0.01
STIFFNESS = 4.0
TARGET = 1e-9
# Processes, and whether one is killed.
WAYS = {
    "threads of one process": (0, False),
    "1 worker": (1, False),
    "2 workers": (2, False),
    "2 workers, one killed": (2, True),
}
HEADERS = ["estimator", "computed by", "parameters", "noise or errors", "the same"]


def recording(count):
    """Return recordings of a robot with a spring on joint 2, which nothing declares."""
    found = make_robot_recording(
        duration=count * SECONDS, dt=DT, n_recordings=count, random_state=0
    )
    tau = found.tau.copy()
    tau[:, 1] += STIFFNESS * found.q[:, 1]
    return replace(found, tau=tau)


def save(whole, folder):
    """Write a file for each recording."""
    for k, part in enumerate(whole.segments):
        np.savez(
            folder / f"{k:02d}.npz", q=whole.q[part], tau=whole.tau[part], dt=whole.dt
        )


def identifier(whole):
    """Return the identifier."""
    return RobotIdentifier(whole.urdf, dt=whole.dt)


def loop(whole):
    """Return the loop, with springs as its only effects."""
    return EffectDiscovery(identifier(whole), effects=["spring"])


def dying(function, marker):
    """Let the process that first has done a task die before it can tell."""

    def run(*arguments):
        result = function(*arguments)
        try:
            marker.touch(exist_ok=False)
        except FileExistsError:
            return result
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError("the process must have died")

    return run


def numbers(fitted):
    """Parameters, and noise or errors, of an identifier or a loop."""
    if isinstance(fitted, EffectDiscovery):
        own = np.concatenate([fitted.error_before_, fitted.error_after_])
        return fitted.identifier_.theta_, own
    return fitted.theta_, fitted.torque_noise_


def differences(found, expected):
    """Largest differences over the largest value: parameters, noise or errors."""
    return [
        float(np.abs(one - other).max() / np.abs(other).max())
        for one, other in zip(numbers(found), numbers(expected), strict=True)
    ]


@contextlib.contextmanager
def computed(processes, function, killed):
    """Compute with so many processes; one dies after its first call of a function."""
    if not processes:
        yield
        return
    own = {"n_workers": processes, "threads_per_worker": 1, "dashboard_address": None}
    with (
        tempfile.TemporaryDirectory() as folder,
        distributed.LocalCluster(processes=True, **own) as local,
        distributed.Client(local),
        contextlib.ExitStack() as stack,
    ):
        marker = Path(folder, "marker")
        if killed:
            patched = dying(getattr(_passes, function), marker)
            stack.enter_context(mock.patch.object(_passes, function, patched))
        yield
        if marker.exists() != killed:
            raise RuntimeError(f"a worker {'lived' if killed else 'died'}")


def report(count, ways):
    """Table of the largest differences."""
    whole, rows = recording(count), []
    with tempfile.TemporaryDirectory() as folder:
        save(whole, Path(folder))
        for make, function in ((identifier, "_moments"), (loop, "_alone")):
            expected = make(whole).fit(whole.q, whole.tau, groups=whole.groups)
            for way, (processes, killed) in ways.items():
                with computed(processes, function, killed):
                    found = fit_recordings(make(whole), folder)
                own = differences(found, expected)
                rows.append(
                    [
                        type(found).__name__,
                        way,
                        *(f"{x:.1g}" for x in own),
                        "yes" if max(own) <= TARGET else "no",
                    ]
                )
    return rst_table(rows, HEADERS, n_labels=2)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument(
        "--quick", action="store_true", help="two recordings and one way, a smoke test"
    )
    arguments = arguments.parse_args(argv)
    chosen = list(WAYS)[-1:] if arguments.quick else list(WAYS)
    text = report(
        2 if arguments.quick else RECORDINGS, {way: WAYS[way] for way in chosen}
    )
    publish("dask", text, write=arguments.write)


if __name__ == "__main__":
    main()
