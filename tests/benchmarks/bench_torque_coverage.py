"""How often measured torques of another motion lie within predicted deviations.

Run ``python tests/benchmarks/bench_torque_coverage.py --data-home DIR [--trials N]
[--seed S] [--write]``. `RobotIdentifier` is fitted to one motion; on another one it is
counted how often a torque lies within 1.645 deviations of ``predict(return_std=True)``,
measured and predicted torque both behind the low-pass of the fit, in moving time.

Simulated: the arms of ``bench_interval_coverage.py``, viscous and Coulomb friction true
and declared; trial k has the seed S + k, its other motion one that no trial fits. Seeds
from 100 on have not been worked with. Measured: the sets, filters, masks and declared
models of the frozen protocols, each motion left out once.
"""

import warnings

import numpy as np
from _protocol_sets import MANIPULATED_SETS, PAIRED_SETS, pairs
from _report import fixed, parser, publish, rst_table
from bench_interval_coverage import COULOMB, DT, NINETY, NOISES, simulate
from bench_protocol_tx40 import FITTED, JUDGED
from bench_simulation_windows import UR5_FITTED

from sklearn_vbjfa import RobotIdentifier

ARMS = (("Z", 40.0), ("ZY", 40.0), ("ZYX", 60.0))
SETS = ("emps", "ur5", "staubli_tx40", "kuka_kr300", "dfki_double_pendulum")
# Motions that are judged have seeds that far beyond those that are fitted.
OTHER_MOTION = 50_000


def judged(robot, q, tau, groups=None):
    """Shares (nv,) of torques within the interval, and mean squares (nv,) in it.

    The mean squares are those of the error over its deviation: one if the deviation is
    right, whatever the shape of the distribution.
    """
    found = robot.residuals(q, tau, groups)
    with warnings.catch_warnings():
        # A motion that leaves what was fitted is judged all the same.
        warnings.simplefilter("ignore", UserWarning)
        std = robot.predict(q, groups, return_std=True)[1][found.index]
    moves = found.weight > 0
    count = np.where(moves.any(axis=0), moves.sum(axis=0), np.nan)
    score = np.abs(found.residual) / std
    inside = (score <= NINETY) & moves
    squares = np.where(moves, score**2, 0.0)
    return inside.sum(axis=0) / count, squares.sum(axis=0) / count


def simulated(trials, seed, arms=ARMS, noises=tuple(NOISES)):
    """Rows of the first table, and shares (n_cells,)."""
    rows, shares = [], []
    for axes, duration in arms:
        friction = COULOMB[: len(axes)]
        for noise in noises:
            own = []
            for k in range(seed, seed + trials):
                fitted, other = (
                    simulate(axes, duration, NOISES[noise], motion, friction=friction)
                    for motion in (k, k + OTHER_MOTION)
                )
                robot = RobotIdentifier(
                    fitted.model, dt=DT, friction=("viscous", "coulomb")
                )
                robot.fit(fitted.q, fitted.tau)
                own.append(np.mean(judged(robot, other.q, other.tau), axis=1))
            inside, squares = np.array(own).T
            error = 100 * inside.std() / np.sqrt(trials)
            shares.append(inside.mean())
            rows.append(
                [
                    f"{len(axes)} of {duration:g} s",
                    noise,
                    str(trials),
                    f"{100 * inside.mean():.1f} ± {error:.1f}",
                    *fixed([np.sqrt(squares.mean())], 2),
                ]
            )
    return rows, np.array(shares)


def splits_of(name, recording):
    """List (label, rows fitted, rows judged) of a measured set."""
    if name == "staubli_tx40":
        rows = np.arange(recording.n_samples)
        return [(f"rows {JUDGED.start}:{JUDGED.stop}", rows[FITTED], rows[JUDGED])]
    names, rows_of = recording.group_names, {}
    for one, part in zip(names, recording.segments):
        rows_of[one] = np.r_[part]
    if name == "ur5":
        others = tuple(one for one in names if one not in UR5_FITTED)
        named = [("the other six", UR5_FITTED, others)]
    else:
        named = pairs(names, PAIRED_SETS[name].leave_out)
    return [
        (label, *(np.concatenate([rows_of[one] for one in own]) for own in both))
        for label, *both in named
    ]


def measured(name, data_home=None):
    """Rows of the second table, of one set."""
    frozen = {**MANIPULATED_SETS, **PAIRED_SETS}[name]
    recording = frozen.recording(data_home)
    rows = []
    for label, fitted, other in splits_of(name, recording):
        robot = frozen.identifier(recording.robot_model(), recording.dt)
        parts = recording.q, recording.tau, recording.groups
        q, tau, groups = (x[fitted] for x in parts)
        robot.fit(q, tau, groups=groups)
        inside, squares = judged(robot, *(x[other] for x in parts))
        again, _ = judged(robot, q, tau, groups)
        rows.append(
            [
                name,
                label,
                *fixed([100 * np.nanmean(again), 100 * np.nanmean(inside)]),
                " ".join(fixed(100 * inside, 0)),
                *fixed([np.sqrt(np.nanmean(squares))], 2),
            ]
        )
    return rows


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=30)
    arguments.add_argument("--seed", type=int, default=100)
    arguments.add_argument("--data-home", default=None)
    arguments = arguments.parse_args(argv)
    ours, _ = simulated(arguments.trials, arguments.seed)
    theirs = [
        row for name in SETS for row in measured(name, data_home=arguments.data_home)
    ]
    error = "rms of error / deviation"
    text = (
        f"Simulated arms, {arguments.trials} data sets a cell, seeds from "
        f"{arguments.seed}: share of the torques of another motion within 1.645 "
        "deviations, with the standard error of the data sets. Ninety is right.\n\n"
        + rst_table(
            ours, ["joints", "torque noise", "data sets", "within [%]", error], 2
        )
        + "\n\nMeasured robots, the mean of the joints and each joint:\n\n"
        + rst_table(
            theirs,
            ["set", "judged", "fitted motion [%]", "other [%]", "joints [%]", error],
            2,
        )
    )
    publish("torque_coverage", text, write=arguments.write)


if __name__ == "__main__":
    main()
