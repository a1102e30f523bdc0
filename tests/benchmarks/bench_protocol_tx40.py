"""The TX40 by FIGAROH's protocol: torque as recorded, standstill included.

Run as ``python tests/benchmarks/bench_protocol_tx40.py --data-home DIR``, with
``--figaroh-python PYTHON`` where an interpreter has FIGAROH. Rows 0:24750 are fitted
with viscous and Coulomb friction, offset and rotor inertia declared, low-pass 25 Hz;
the model predicts rows 29250:45000 from the measured positions, and 600 of those rows
are compared with the torque as it was recorded.
"""

import sys
import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import fetch_staubli_tx40

FITTED = slice(0, 24750)
JUDGED = slice(29250, 45000)
# Of the judged rows.
COMPARED = np.linspace(100, 15649, 600).astype(int)
CUTOFF = 25.0  # Hz
FRICTION = ("viscous", "coulomb", "offset", "rotor_inertia")
# FIGAROH's direct fit by linear matrix inequalities, the coupling of the wrist put in
# by hand.
PUBLISHED = np.array([6.40, 8.21, 4.13, 1.72, 2.71, 1.73])  # N m


def errors(torque, predicted):
    """Root mean square of the error on the compared rows, (nv,) of (n, nv) [N m]."""
    missed = (torque - predicted)[COMPARED]
    return np.sqrt((missed**2).mean(axis=0))


def filtered_prediction(model, q, tau):
    """Torques (n, nv) of the model's columns behind its low-pass, not of `predict`.

    At rest the sign of a speed is that of encoder noise; behind the low-pass it becomes
    its mean. Between the filtered samples straight lines, beyond them the last value.
    """
    found = model.residuals(q, tau)
    rows = np.arange(len(q))
    return np.column_stack([np.interp(rows, found.index, x) for x in found.predicted.T])


def fit_loop(recording, **settings):
    """Close the loop on the fitted rows; arguments go to `EffectDiscovery`."""
    robot = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=FRICTION, cutoff=CUTOFF
    )
    loop = EffectDiscovery(robot, random_state=0, **settings)
    return loop.fit(recording.q[FITTED], recording.tau[FITTED])


def measure(recording, loop):
    """Label -> error of each joint [N m]."""
    q, tau = recording.q[JUDGED], recording.tau[JUDGED]
    rows = {}
    for label, model in (
        ("declared model", loop.declared_),
        ("completed by EffectDiscovery", loop.identifier_),
    ):
        rows[label] = errors(tau, model.predict(q))
        rows[f"{label}, its columns low-passed"] = errors(
            tau, filtered_prediction(model, q, tau)
        )
    return rows


def measure_figaroh(recording, python):
    """Label -> error of each joint [N m] of FIGAROH's user scripts, coupled wrist."""
    import bench_figaroh

    parts = [
        {
            "q": recording.q[rows],
            "tau": recording.tau[rows],
            "groups": np.zeros(rows.stop - rows.start, dtype=int),
            "dt": recording.dt,
        }
        for rows in (FITTED, JUDGED)
    ]
    found = {}
    for row in bench_figaroh.contestants("staubli_tx40", CUTOFF, recording.dt):
        if row.tool != "figaroh" or "coupled" not in row.label:
            continue
        outcome = bench_figaroh.run_script(
            row,
            python,
            recording.urdf,
            parts,
            bench_figaroh.SCRIPTS / "figaroh_staubli_tx40.yaml",
        )
        print(f"{row.label}: {outcome.seconds:.1f} s", file=sys.stderr)
        found[row.label] = errors(recording.tau[JUDGED], outcome.predicted)
    return found


def report(recording, loop, figaroh=None):
    """Text of the table; `figaroh` is what `measure_figaroh` gave, None without."""
    rows = {"FIGAROH, as published": PUBLISHED, **(figaroh or {})}
    rows.update(measure(recording, loop))
    cells = [
        [label, *fixed(values, 2), *fixed([values.mean()], 2)]
        for label, values in rows.items()
    ]
    found = ", ".join(f"{e.name} {e.joint + 1}" for e in loop.effects_) or "nothing"
    note = "" if figaroh else " FIGAROH was not run: its row is what was published."
    return "\n\n".join(
        [
            f"Rows {FITTED.start}:{FITTED.stop} of the 5 kHz recording fitted, "
            f"declared friction {', '.join(FRICTION)}, low-pass {CUTOFF:g} Hz. Judged: "
            f"{COMPARED.size} rows, equally spaced from {COMPARED[0]} to "
            f"{COMPARED[-1]} of rows {JUDGED.start}:{JUDGED.stop}, against the torque "
            "as recorded, standstill included; prediction from the measured positions. "
            f"Root mean square [N m].{note}",
            rst_table(
                cells,
                ["error [N m]", *(f"j{j + 1}" for j in range(recording.nv)), "mean"],
            ),
            f"Found, joint from 1, in order: {found}.",
        ]
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--figaroh-python", default=None, metavar="PYTHON")
    arguments = arguments.parse_args(argv)
    recording = fetch_staubli_tx40(data_home=arguments.data_home)
    figaroh = None
    if arguments.figaroh_python:
        figaroh = measure_figaroh(recording, arguments.figaroh_python)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        text = report(recording, fit_loop(recording), figaroh)
    publish("protocol_tx40", text, write=arguments.write)


if __name__ == "__main__":
    main()
