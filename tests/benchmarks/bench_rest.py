"""What `predict` says of a joint that stands still, on simulated and measured robots.

Run ``python tests/benchmarks/bench_rest.py [--data-home DIR] [--write]``. Simulated
arms with quantised encoders are identified on a motion that never rests and predict
other motions, which rest in different ways. The torque to be met is the noise-free one:
while a joint stands, its dry friction is a value drawn from its whole band for each
rest, as a controller with an integral part leaves it. Seeds 0 to 99 are for work, 100
and above to confirm.
"""

import sys
import time
import warnings
from dataclasses import replace

import numpy as np
from _report import fixed, parser, publish, rst_table

SEEDS = range(0, 2)
ROBOTS = ("demo_arm", "head", "kr300")
MOTIONS = (
    "never rests",
    "stops between moves",
    "one joint at a time",
    "2 s of 60 s",
)
# Encoders: step [rad or m], and white noise before the rounding in units of the step.
ENCODERS = {"fine": (2e-5, 0.0), "coarse": (5e-4, 0.0), "coarse, noisy": (5e-4, 0.7)}
FRICTIONS = ("sign", "presliding")
DT = 0.004  # s
FITTED = 24.0  # s
# Presliding friction turns round over this displacement [rad or m].
DISPLACEMENT = 2e-3
# Time in which friction goes from its moving value to that of a rest [s].
SETTLING = 0.05
DEVELOPMENT = ("emps", "ur5", "staubli_tx40", "tflex_1dof", "bam_xl330")


# -- simulated motions


def _model(robot):
    """Model of a robot by name."""
    from importlib import resources

    from _paper_robots import load_paper_robot

    from sklearn_vbjfa.model import load_model

    if robot == "head":
        return load_paper_robot("head")
    name = "demo_arm.urdf" if robot == "demo_arm" else "kr300_nominal.urdf"
    return load_model(str(resources.files("sklearn_vbjfa.datasets") / "robots" / name))


def _moves(kind, model, rng):
    """Positions, velocities, accelerations of moves from pose to pose with rests."""
    from sklearn_vbjfa.datasets import joint_range

    middle, reach = joint_range(model)
    pieces, here, nv = [], middle.copy(), model.nv
    rests = {"2 s of 60 s": 29.0}.get(kind, 0.6)
    for k in range({"2 s of 60 s": 2, "one joint at a time": 2 * nv}.get(kind, 12)):
        goal = middle + 0.6 * reach * rng.uniform(-1, 1, size=nv)
        if kind == "one joint at a time":
            kept = np.arange(nv) != k % nv
            goal[kept] = here[kept]
        took = 1.0 if kind == "2 s of 60 s" else rng.uniform(0.8, 2.0)
        s = np.arange(0.0, 1.0, DT / took)[:, None]
        # minimum jerk
        way = goal - here
        pieces.append(
            np.hstack(
                [
                    here + way * s**3 * (10 - 15 * s + 6 * s**2),
                    way * 30 * s**2 * (1 - s) ** 2 / took,
                    way * 60 * s * (1 - s) * (1 - 2 * s) / took**2,
                ]
            )
        )
        stands = np.hstack([goal, np.zeros(2 * nv)])
        pieces.append(np.tile(stands, (int(rests / DT), 1)))
        here = goal
    return np.concatenate(pieces)


def _dry_friction(q, v, kind, rng):
    """Dry friction of unit size of one joint, at rest anywhere in its band."""
    from sklearn_vbjfa.effects import dahl

    moves = v != 0
    unit = np.sign(v) if kind == "sign" else dahl(q, DISPLACEMENT)
    edges = np.flatnonzero(np.diff(moves.astype(int))) + 1
    for a, b in zip(np.r_[0, edges], np.r_[edges, v.size]):
        if not moves[a] and b - a > 1:
            before = unit[a - 1] if a else 0.0
            level, since = rng.uniform(-1, 1), np.arange(b - a) * DT
            unit[a:b] = level + (before - level) * np.exp(-since / SETTLING)
    return unit


def simulate(robot, encoder, friction, seed):
    """Return a fitted-on recording and label -> (q, clean torque, moves, friction).

    `friction` (nv,) is the size of the dry friction; `moves` (n, nv) says when.
    """
    from sklearn_vbjfa.datasets import (
        make_robot_recording,
        rigid_torques,
        with_inertias,
    )

    model, rng = _model(robot), np.random.default_rng(seed)
    settings = {"dt": DT, "encoder_noise": 0.0, "torque_noise": 0.0}
    fitted = make_robot_recording(
        model, duration=FITTED, frequency=0.8, random_state=seed, **settings
    )
    other = make_robot_recording(
        model,
        duration=12.0,
        frequency=0.8,
        inertial=fitted.inertial,
        friction=fitted.friction,
        random_state=1000 + seed,
        **settings,
    )
    nv, (step, noise) = model.nv, ENCODERS[encoder]
    size = fitted.friction["coulomb"]

    def read(q):
        return step * np.round(q / step + noise * rng.normal(size=q.shape))

    def torque(states):
        q, v, _ = np.split(states, 3, axis=1)
        dry = [_dry_friction(q[:, j], v[:, j], friction, rng) for j in range(nv)]
        rigid = rigid_torques(with_inertias(model, fitted.inertial), states)
        return rigid + fitted.friction["viscous"] * v + size * np.column_stack(dry)

    clean = torque(fitted.states)
    recording = replace(
        fitted,
        q=read(fitted.q),
        tau=clean + 0.02 * clean.std(axis=0) * rng.normal(size=clean.shape),
        tau_clean=clean,
    )
    judged = {}
    for kind in MOTIONS:
        moved = other.states if kind == MOTIONS[0] else _moves(kind, model, rng)
        judged[kind] = (
            read(moved[:, :nv]),
            torque(moved),
            moved[:, nv : 2 * nv] != 0,
            moved,
        )
    return recording, size, judged


# -- judging


def filtered_prediction(model, q, tau):
    """Torques (n, nv) of the model's columns behind its low-pass."""
    found = model.residuals(q, tau)
    rows = np.arange(len(q))
    return np.column_stack([np.interp(rows, found.index, x) for x in found.predicted.T])


def shares(missed, moves, scale):
    """Root mean squares while joints move and while they rest, over `scale` [%]."""
    found = []
    for which in (moves, ~moves):
        own = [
            np.sqrt((missed[which[:, j], j] ** 2).mean()) / scale[j]
            for j in range(moves.shape[1])
            if which[:, j].any()
        ]
        found.append(100 * np.mean(own) if own else np.nan)
    return found


def measure(seeds, robots=ROBOTS, encoders=tuple(ENCODERS), frictions=FRICTIONS):
    """(friction, encoder, motion) -> mean figures over robots and seeds."""
    from sklearn_vbjfa import RobotIdentifier

    found = {}
    for robot in robots:
        for seed in seeds:
            for encoder in encoders:
                for friction in frictions:
                    fitted, size, judged = simulate(robot, encoder, friction, seed)
                    model = RobotIdentifier(
                        _model(robot), dt=DT, friction=("viscous", "coulomb")
                    ).fit(fitted.q, fitted.tau)
                    scale = fitted.tau_clean.std(axis=0)
                    for kind, (q, clean, moves, states) in judged.items():
                        row = _figures(model, q, clean, moves, states, scale, size)
                        found.setdefault((friction, encoder, kind), []).append(row)
    # A figure that a motion does not have is missing from all of its rows.
    return {key: np.mean(rows, axis=0) for key, rows in found.items()}


def _figures(model, q, clean, moves, states, scale, size):
    predicted = model.predict(q)
    rattle = np.diff(predicted, axis=0)
    still = moves[1:] | moves[:-1]
    # What a model that knows all but friction at rest would miss.
    known = np.where(moves, 0.0, clean - _without_friction(model, states, clean, moves))
    return [
        *shares(predicted - clean, moves, scale),
        *shares(filtered_prediction(model, q, clean) - clean, moves, scale),
        *shares(model.predict(states) - clean, moves, scale),
        shares(known, moves, scale)[1],
        shares(rattle, still, size)[1],
    ]


def _without_friction(model, states, clean, moves):
    """Torque at rest as the model has it on the true states, which stand exactly."""
    stands = states.copy()
    nv = moves.shape[1]
    stands[:, nv : 2 * nv][~moves] = 0.0
    return model.predict(stands)


def simulated_table(found):
    """Text of the table of simulated robots."""
    rows = [
        [friction, encoder, kind, *fixed(values[:7], 1), *fixed(values[7:], 2)]
        for (friction, encoder, kind), values in found.items()
    ]
    return rst_table(
        rows,
        [
            "dry friction",
            "encoder",
            "motion",
            "predict, moving",
            "at rest",
            "low-passed, moving",
            "at rest",
            "true states, moving",
            "at rest",
            "friction's mean, at rest",
            "rattle",
        ],
        n_labels=3,
    )


# -- measured robots


def measure_set(name, data_home):
    """One row a joint: errors against the torque as recorded, moving and at rest."""
    from bench_measured_robots import load

    *_, identifier, (train, test) = load(name, data_home)
    identifier.set_params(friction=("viscous", "coulomb", "offset"))
    robot = identifier.fit(*train[:2], groups=train[2])
    q, tau, groups = test
    states = robot._states(q, groups)
    nv = tau.shape[1]
    moves = np.abs(states[:, nv : 2 * nv]) > robot.standstill_
    predicted = robot.predict(q, groups=groups)
    missed = tau - predicted
    found = robot.residuals(q, tau, groups=groups)
    behind = np.full(tau.shape, np.nan)
    inside = slice(found.index[0], found.index[-1] + 1)
    for j in range(nv):
        rows = np.arange(inside.start, inside.stop)
        behind[inside, j] = np.interp(rows, found.index, found.predicted[:, j])
    rows = []
    for j, joint in enumerate(robot.joint_names_):
        figures = [
            np.sqrt(np.nanmean(x[which[:, j], j] ** 2)) if which[:, j].any() else np.nan
            for x in (missed, tau - behind)
            for which in (moves, ~moves)
        ]
        share = f"{100 * (~moves[:, j]).mean():.0f}"
        rows.append([name, joint, share, *(f"{v:.3g}" for v in figures)])
    return rows


def measured_table(rows):
    """Text of the table of measured robots."""
    return rst_table(
        rows,
        [
            "set",
            "joint",
            "at rest [%]",
            "predict, moving",
            "at rest",
            "low-passed, moving",
            "at rest",
        ],
        n_labels=2,
    )


def report(found, rows, seeds):
    """Text of both tables."""
    parts = [
        f"Simulated robots ({', '.join(ROBOTS)}), seeds {seeds[0]} to {seeds[-1]}, "
        f"recorded every {1e3 * DT:g} ms. Root mean square of the error against the "
        "noise-free torque, over the torque's standard deviation in the fitted motion "
        "[%]. *friction's mean*: what would be left at rest if friction counted with "
        "the middle of its band there. *rattle*: how much the prediction changes from "
        "row to row at rest, over the size of the dry friction [%]. Encoders: "
        + "; ".join(
            f"{k} steps of {s:g}, noise {n:g} of a step"
            for k, (s, n) in ENCODERS.items()
        )
        + ".",
        simulated_table(found),
    ]
    if rows:
        parts += [
            "Measured robots, the held-out recordings or rows of "
            "``bench_measured_robots.py``, viscous and Coulomb friction and offset "
            "declared. Root mean square of the error against the torque as recorded, "
            "in the unit of the joint's torque; at rest: at or below the standstill "
            "speed of the fit.",
            measured_table(rows),
        ]
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--seeds", nargs=2, type=int, default=None)
    arguments = arguments.parse_args(argv)
    seeds = range(*arguments.seeds) if arguments.seeds else SEEDS
    rows = []
    with warnings.catch_warnings():
        # Joints that stand still are told of by the fit.
        warnings.simplefilter("ignore", UserWarning)
        started = time.perf_counter()
        found = measure(seeds)
        print(f"simulated: {time.perf_counter() - started:.0f} s", file=sys.stderr)
        for name in DEVELOPMENT if arguments.data_home else ():
            rows += measure_set(name, arguments.data_home)
    publish("rest", report(found, rows, seeds), write=arguments.write)


if __name__ == "__main__":
    main()
