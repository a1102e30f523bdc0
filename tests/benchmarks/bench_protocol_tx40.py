"""The TX40 by FIGAROH's protocol: torque as recorded, standstill included.

Run as ``python tests/benchmarks/bench_protocol_tx40.py --data-home DIR``.
Rows 0:24750 are fitted
with viscous and Coulomb friction, offset and rotor inertia declared, low-pass 25 Hz;
the model predicts rows 29250:45000 from the measured positions, and 600 of those rows
are compared with the torque as it was recorded.
"""

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
    """Torques (n, nv) of the model's columns behind its low-pass, not of `predict`."""
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


def report(recording, loop):
    """Text of the table."""
    rows = {"FIGAROH, as published": PUBLISHED, **measure(recording, loop)}
    cells = [
        [label, *fixed(values, 2), *fixed([values.mean()], 2)]
        for label, values in rows.items()
    ]
    found = ", ".join(f"{e.name} {e.joint + 1}" for e in loop.effects_) or "nothing"
    return "\n\n".join(
        [
            f"Rows {FITTED.start}:{FITTED.stop} of the 5 kHz recording fitted, "
            f"declared friction {', '.join(FRICTION)}, low-pass {CUTOFF:g} Hz. Judged: "
            f"{COMPARED.size} rows, equally spaced from {COMPARED[0]} to "
            f"{COMPARED[-1]} of rows {JUDGED.start}:{JUDGED.stop}, against the torque "
            "as recorded, standstill included; prediction from the measured positions. "
            "Root mean square [N m]. The row of FIGAROH is the published one.",
            rst_table(
                cells,
                ["error [N m]", *(f"j{j + 1}" for j in range(recording.nv)), "mean"],
            ),
            f"Found, joint from 1, in order: {found}.",
        ]
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, data=True).parse_args(argv)
    recording = fetch_staubli_tx40(data_home=arguments.data_home)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        text = report(recording, fit_loop(recording))
    publish("protocol_tx40", text, arguments)


if __name__ == "__main__":
    main()
