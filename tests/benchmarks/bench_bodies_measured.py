"""Measured robots with bodies around their description: torque, masses, departures.

Run ``python tests/benchmarks/bench_bodies_measured.py --data-home DIR [--data SET ...]
[--write]``.

Ten measured sets, cut-offs and masks frozen. Sets of several motions: all pairs of
`PAIRED_SETS`, fitted to some recordings and judged on the one that is left out; sets of
one motion: fitted to the first three quarters of every recording, judged on the last.
Four plain terms on every joint, no search. Errors are root mean squares over the spread
of the judged torque, mean of the joints and pairs.
"""

import warnings

import numpy as np
from _protocol_sets import PAIRED_SETS, pairs
from _report import fixed, parser, publish, rst_table
from bench_leave_one_set_out import PLAIN, UNTOUCHED_SETS
from bench_measured_sets import load
from sklearn.base import clone

SETS = (*PAIRED_SETS, *UNTOUCHED_SETS)
BODIES = ("free", "prior", "fixed")


def cases_of(name, data_home=None):
    """Return the identifier of a set, and (fitted, judged) of each of its cases."""
    if name in UNTOUCHED_SETS:
        recording, rows, identifier = load(name, data_home)
        parts = recording.q[rows], recording.tau[rows], recording.groups[rows]
        label = parts[2]
        last = np.zeros(label.size, dtype=bool)
        for one in np.unique(label):
            own = np.flatnonzero(label == one)
            last[own[3 * own.size // 4 :]] = True
        split = [tuple(x[where] for x in parts) for where in (~last, last)]
        return identifier, [split]
    frozen = PAIRED_SETS[name]
    recording = frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    cases = []
    for _, *sides in pairs(recording.group_names, frozen.leave_out):
        chosen = [recording.select(*names) for names in sides]
        cases.append([(one.q, one.tau, one.groups) for one in chosen])
    return identifier, cases


def judge(identifier, fitted, judged, bodies):
    """Fit one way; mean error, masses, and what is said to depart."""
    model = clone(identifier).set_params(friction=PLAIN, bodies=bodies)
    model.fit(fitted[0], fitted[1], groups=fitted[2])
    left = model.residuals(judged[0], judged[1], groups=judged[2])
    rows = left.weight > 0
    spread = np.array([left.torque[r, j].std() for j, r in enumerate(rows.T)])
    nv = spread.size
    theta = model.theta_.reshape(nv, -1)
    return float(np.nanmean(left.rms() / spread)), theta[:, 0], model


def row_of(name, data_home=None):
    """Row of the table of one set."""
    identifier, cases = cases_of(name, data_home)
    errors, masses, departures = {b: [] for b in BODIES}, {}, []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for bodies in BODIES:
            for fitted, judged in cases:
                try:
                    error, mass, model = judge(identifier, fitted, judged, bodies)
                except ValueError:  # nothing is described
                    if bodies != "fixed":
                        raise
                    error, mass = np.nan, np.full(mass.shape, np.nan)
                errors[bodies].append(error)
            masses[bodies] = mass
            if bodies == "prior":
                departures = model.mass_deviations_
                common = model.common_size_
    mean = {b: 100 * float(np.mean(e)) for b, e in errors.items()}
    said = "; ".join(f"{'/'.join(d.bodies)} x {d.factors[0]:.2f}" for d in departures)
    return [
        name,
        str(len(cases)),
        *fixed([mean[b] for b in BODIES], 2),
        *fixed([mean["prior"] / mean["free"]], 3),
        *(" ".join(fixed(masses[b], 1)) for b in BODIES),
        *fixed([common], 3),
        said or "none",
    ]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--data", nargs="+", choices=SETS, default=SETS)
    arguments = arguments.parse_args(argv)
    rows = []
    for name in arguments.data:
        rows.append(row_of(name, arguments.data_home))
        print(" | ".join(rows[-1]), flush=True)
    headers = [
        "set",
        "cases",
        *(f"{b} [%]" for b in BODIES),
        "prior / free",
        *(f"masses, {b} [kg]" for b in BODIES),
        "common size",
        "departs",
    ]
    publish("bodies_measured", rst_table(rows, headers), write=arguments.write)


if __name__ == "__main__":
    main()
