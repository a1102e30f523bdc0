"""Ten runs of a quadruped's motors: what repeats, bodies and motors in several ways.

Run ``python tests/benchmarks/bench_unitree_go2.py --data-home DIR [--write]``.

Data: `fetch_unitree_go2`, ten runs of one motion of twelve motors, the base held. The
torque is that of the PD law that the motors were told, 10 ms before they act: it is
shifted by two samples. Low-pass 10 Hz, four plain terms on every joint, no search.
Every run is fitted alone for the scatter of rotor inertias, and runs 0 to 6 together,
judged on runs 7 to 9, which are the same motion again: nothing here tells a right value
from one that repeats. Of ranges for simulators, three runs in a row are left out in
turn: how often their values, each fitted alone, are in the ranges of the others, or in
these and its own deviation; width and interval score over the scatter of the runs.
Bodies are free, near or as described; ``alike``: the motors of the four hips, thighs
and calves have values near each other (``alike="auto"``). The seconds are those of the
processor, of the fit to runs 0 to 6.
"""

import time
import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import fetch_unitree_go2
from sklearn_vbjfa.robot import FitOptions

PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
CUTOFF, DELAY = 10.0, 2
FITTED, JUDGED = range(7), range(7, 10)
LEVEL, KINDS = 0.9, ("rotor_inertia", "viscous", "coulomb")
MOTORS = ("hip", "thigh", "calf")
WAYS = tuple((way, alike) for way in ("free", "prior", "fixed") for alike in (0, 1))


def taken(recording, runs):
    """Positions, torques, and labels of some runs, the torque in time."""
    parts = [recording.select(k) for k in runs]
    q = [one.q[DELAY:] for one in parts]
    tau = [one.tau[:-DELAY] for one in parts]
    groups = np.repeat(np.arange(len(parts)), [len(x) for x in q])
    return np.concatenate(q), np.concatenate(tau), groups


def row_of(bodies, alike, recording, runs=range(10)):
    """Cells of a way."""
    model = recording.robot_model()
    settings = {"dt": recording.dt, "friction": PLAIN, "cutoff": CUTOFF}
    settings["options"] = FitOptions(alike="auto" if alike else None)
    robot = RobotIdentifier(model, bodies=bodies, **settings)

    def fit(runs):
        q, tau, groups = taken(recording, runs)
        return robot.fit(q, tau, groups=groups)

    def values(robot):
        """Parameters of each joint, without those of the whole robot."""
        return robot.theta_[: robot.features_.n_parameters_].reshape(12, -1)

    rotors, masses = [], []
    for k in runs:
        theta = values(fit([k]))
        rotors.append(theta[:, 13])
        masses.append(theta[:, 0].sum())
    rotors = np.array(rotors)
    scatter = 100 * rotors.std(axis=0) / np.abs(rotors.mean(axis=0))
    started = time.process_time()
    theta = values(fit(FITTED))
    seconds = time.process_time() - started
    legs = theta[:, 13].reshape(4, 3)
    between = 100 * legs.std(axis=0) / legs.mean(axis=0)
    q, tau, groups = taken(recording, JUDGED)
    left = robot.residuals(q, tau, groups=groups)
    return [
        bodies,
        "yes" if alike else "no",
        *fixed([np.nanmedian(scatter), np.nanmax(scatter), *between], 0),
        *fixed([min(masses), max(masses), theta[:, 0].sum()], 1),
        *fixed([100 * np.nanmean(left.normalised_error()), seconds], 1),
    ]


def ranges(recording, runs=range(10)):
    """Rows of how often values of runs that were left out are in their ranges."""
    # Three runs in a row are left out in turn.
    settings = {"dt": recording.dt, "friction": PLAIN, "cutoff": CUTOFF}
    robot = RobotIdentifier(recording.robot_model(), **settings)

    def fit(runs):
        q, tau, groups = taken(recording, runs)
        return robot.fit(q, tau, groups=groups)

    alone = [(one.theta_, one.theta_std_) for one in (fit([k]) for k in runs)]
    alone, names = np.array(alone), list(robot.parameter_names_)
    left_out = np.array([[(k + i) % len(runs) for i in range(3)] for k in runs])
    found = [fit(np.setdiff1d(runs, out)).ranges(LEVEL) for out in left_out]
    rows = []
    for kind in KINDS:
        own = [i for i, name in enumerate(names) if name.endswith(f":{kind}")]
        ends = [[(x[names[i]].lower, x[names[i]].upper) for i in own] for x in found]
        low, high = np.moveaxis(ends, -1, 0)[:, :, None]
        values, deviations = (alone[left_out, k][:, :, own] for k in (0, 1))
        missed = np.maximum(low - values, 0.0) + np.maximum(values - high, 0.0)
        # The value of a run is known to its own deviation.
        own_range = np.hypot((high - low) / 2, 1.645 * deviations)
        held = [missed == 0, np.abs(values - (low + high) / 2) <= own_range]
        scatter = alone[:, 0, own].std(axis=0, ddof=1)
        score = (high - low + 2 / (1 - LEVEL) * missed) / scatter
        held = fixed([100 * one.mean() for one in held], 0)
        width = fixed([((high - low) / scatter).mean(), score.mean()], 1)
        rows.append([kind.replace("_", " "), str(missed.size), *held, *width])
    return rows


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, data=True).parse_args(argv)
    ways, runs = (WAYS[2:3], range(2)) if arguments.quick else (WAYS, range(10))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recording = fetch_unitree_go2(data_home=arguments.data_home)
        rows = [row_of(*way, recording, runs) for way in ways]
        repeated = ranges(recording, range(4) if arguments.quick else runs)
        described = sum(
            one.mass for one in recording.robot_model().inertias.tolist()[1:]
        )
    heads = [
        "bodies",
        "alike",
        "rotor inertia, scatter between runs, median [%]",
        "largest [%]",
        *(f"between legs, {name} [%]" for name in MOTORS),
        "masses, least run [kg]",
        "largest run [kg]",
        "runs 0 to 6 [kg]",
        "torque of runs 7 to 9 [%]",
        "fit [s]",
    ]
    text = f"Masses of the description: {described:.1f} kg."
    table = rst_table(rows, heads, n_labels=2)
    heads = ["values", "cases", "in their ranges [%]", "and deviations [%]"]
    heads += ["width / scatter of runs", "interval score / scatter"]
    held = rst_table(repeated, heads)
    publish("unitree_go2", f"{text}\n\n{table}\n\n{held}", arguments)


if __name__ == "__main__":
    main()
