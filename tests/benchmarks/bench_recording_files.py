"""Recordings out of files whose stamps have faults, and the verdict of clean ones.

Run as ``python tests/benchmarks/bench_recording_files.py``. Robots whose model lacks
nothing are simulated, written as CSV with steady stamps and with faulty ones, read, and
the loop is closed on each. The sampling is really at the time of the stamps where it
says "sampled", else steady.
"""

import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from _report import add_root_to_path, parser, publish, rst_table

add_root_to_path()

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier  # noqa: E402
from sklearn_vbjfa.datasets import (  # noqa: E402
    make_robot_recording,
    read_recording,
)
from tests.hostile import _times as faults  # noqa: E402
from tests.hostile._case import URDF  # noqa: E402

DT = 0.004
FINE = 20
FRICTION = ("viscous", "coulomb")


def stamped(change):
    """Return a fault of the stamps alone: rows of the fine recording, and stamps."""

    def fault(t, fine, rng):
        rows = np.arange(0, fine, FINE)
        return rows, change(t, rng)

    return fault


def sampled(when):
    """Return a fault of the sampling: rows at the time of the stamps, and stamps."""

    def fault(t, fine, rng):
        rows = np.clip(np.rint(when(t, rng) / (DT / FINE)).astype(int), 0, fine - 1)
        rows = np.unique(rows)
        return rows, rows * (DT / FINE)

    return fault


def kept(choose):
    """Return a fault of the logger: rows that are lost, or written twice."""

    def fault(t, fine, rng):
        keep = choose(t.size, rng)
        return np.arange(0, fine, FINE)[keep], t[keep]

    return fault


def other_samples(t, fine, rng):
    """Return rows half a period later: another noise, and no fault."""
    rows = np.arange(FINE // 2, fine, FINE)
    return rows, t[: rows.size]


FAULTS = {
    "steady": stamped(lambda t, rng: t),
    "steady, other samples": other_samples,
    "written late, 0.1": stamped(faults.late(0.1, DT)),
    "written late, 0.3": stamped(faults.late(0.3, DT)),
    "sampled late, 0.1": sampled(faults.late(0.1, DT)),
    "sampled late, 0.3": sampled(faults.late(0.3, DT)),
    "2 % of rows lost": kept(faults.lost(0.02)),
    "5 % of rows lost": kept(faults.lost(0.05)),
    "2 % of rows twice": kept(faults.repeated(0.02)),
    "2 % of stamps stale": stamped(faults.stale(0.02)),
    "three gaps": kept(faults.gaps(3, 200)),
    "packets of 5": stamped(faults.packets(5)),
    "clock drifts by 2 %": stamped(faults.drift(0.02)),
    "clock 2 % fast": stamped(lambda t, rng: 1.02 * t),
}


def write(path, fine, rows, t):
    """Write rows of a recording as CSV, with these stamps."""
    nv = fine.nv
    names = [f"{kind}{j + 1}" for kind in ("q", "tau") for j in range(nv)]
    table = np.column_stack([t, fine.q[rows], fine.tau[rows]])
    header = ",".join(["t", *names])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")


def close(path, urdf, effects):
    """Read a file and close the loop on it; the report, and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, urdf=urdf)
        identifier = RobotIdentifier(urdf, dt=recording.dt, friction=FRICTION)
        if getattr(recording, "torque_noise", None) is not None:
            identifier.set_params(torque_noise=recording.torque_noise)
        loop = EffectDiscovery(identifier, effects=effects)
        loop.fit(recording.q, recording.tau, groups=recording.groups)
    return recording, loop, [str(w.message) for w in caught]


def study(seeds, duration, effects, log):
    """Close the loop on all robots, seeds and faults; rows of a table."""
    with tempfile.TemporaryDirectory() as folder:
        two = Path(folder) / "arm.urdf"
        two.write_text(URDF)
        found = {name: [] for name in FAULTS}
        for robot in (str(two), None):
            for seed in seeds:
                fine = make_robot_recording(
                    robot, duration=duration, dt=DT / FINE, random_state=seed
                )
                t = DT * np.arange(round(duration / DT))
                clean = None
                for name, fault in FAULTS.items():
                    rng = np.random.default_rng([seed, len(name)])
                    rows, stamps = fault(t, fine.n_samples, rng)
                    path = Path(folder) / "recording.csv"
                    write(path, fine, rows, stamps)
                    begun = time.perf_counter()
                    try:
                        recording, loop, said = close(path, fine.urdf, effects)
                    except ValueError as error:
                        print(f"{name}: {error}", file=log, flush=True)
                        nothing = np.full(fine.nv, np.nan)
                        found[name].append((False, False, np.nan, nothing))
                        continue
                    report = loop.report_.to_dict()
                    answer = (
                        sorted((e["name"], e["joint"]) for e in report["effects"]),
                        [joint["status"] for joint in report["joints"]],
                        loop.identifier_.noise_floor_,
                        np.asarray(report["error_after"]),
                    )
                    clean = answer if clean is None else clean
                    floor = answer[2] / clean[2] - 1
                    error = answer[3] / clean[3] - 1
                    same = answer[0] == clean[0], answer[1] == clean[1]
                    found[name].append((*same, np.abs(floor).max(), error))
                    print(
                        f"{Path(fine.urdf).stem} {seed} {name}: dt {recording.dt:.6g}, "
                        f"effects {same[0]}, joints {same[1]}, "
                        f"floor {np.round(100 * floor, 1)} %, "
                        f"error {np.round(100 * error, 1)} %, {answer[0]} {answer[1]}, "
                        f"{time.perf_counter() - begun:.0f} s; {said[:1]}",
                        file=log,
                        flush=True,
                    )
    return [
        [
            name,
            f"{sum(x[0] for x in rows)} of {len(rows)}",
            f"{sum(x[1] for x in rows)} of {len(rows)}",
            f"{100 * np.max([x[2] for x in rows]):.1f}",
            f"{100 * np.median(np.concatenate([x[3] for x in rows])):+.1f}",
            f"{100 * np.abs(np.concatenate([x[3] for x in rows])).max():.1f}",
        ]
        for name, rows in found.items()
    ]


def main():
    """Run the benchmark."""
    arguments = parser(__doc__)
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--duration", type=float, default=20.0)
    arguments.add_argument("--effects", default="spring,offset,delay,stribeck")
    given = arguments.parse_args()
    effects = "all" if given.effects == "all" else given.effects.split(",")
    rows = study(range(given.seeds), given.duration, effects, sys.stderr)
    headers = [
        "stamps",
        "same effects",
        "same joints' verdicts",
        "floor off by at most [%]",
        "error, median [%]",
        "error off by at most [%]",
    ]
    text = (
        "Two robots (2 and 6 joints) whose models lack nothing, "
        f"{given.seeds} motions each of {given.duration:g} s at 250 Hz; "
        f"effects looked for: {given.effects}. Floors and errors "
        "relative to the recording with steady stamps.\n\n"
    )
    publish("recording_files", text + rst_table(rows, headers), write=given.write)


if __name__ == "__main__":
    main()
