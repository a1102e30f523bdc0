"""What a search over the pipeline chooses, and what the choice is worth.

Run as ``python tests/benchmarks/bench_pipeline.py``; ``--seeds 0 20`` by default, some
six minutes. A simulated arm for a few seconds; `GridSearchCV` over regressor and
projection by blocks of time; error of another motion of the same robot, along the
motion as planned and without noise in the torque. `plot_pipeline.py` of the gallery is
the first robot.
"""

import sys
import time
from dataclasses import dataclass

import numpy as np
import sklearn
from _report import fixed, parser, publish, rst_table
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import Lasso, LinearRegression
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.pipeline import Pipeline

from sklearn_vbjfa import (
    JointTorqueRegressor,
    PhysicalProjector,
    RigidBodyFeatures,
    StateEstimator,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_robot_recording

SEEDS = (0, 20)
# Seed of the other motion of the robot of seed 0, and so on.
OTHER = 50
DT, BLOCK, CUTOFF, TORQUE_NOISE = 0.01, 1.0, 10.0, 0.05
# Duration [s] and noise of the encoders [rad].
SETTINGS = {
    "2 s, 5 mrad": (2.0, 5e-3),
    "2 s, 0.1 mrad": (2.0, 1e-4),
    "3 s, 5 mrad": (3.0, 5e-3),
}
FRICTION = ("viscous", "coulomb")
REGRESSORS = {
    "least squares": {"torque__regressor": [LinearRegression()]},
    "PLS": {
        "torque__regressor": [PLSRegression()],
        "torque__regressor__n_components": [10, 15, 20, 25, 30],
    },
    "Lasso": {
        "torque__regressor": [Lasso(max_iter=10_000)],
        "torque__regressor__alpha": [1e-4, 3e-4, 1e-3, 3e-3, 1e-2],
    },
    "VB-JFA": {
        "torque__regressor": [VBJFARegressor(latent="correlated", query="noiseless")],
        "torque__regressor__input_noise": [0.0, 1e-3, 1e-2, 1e-1],
    },
}
PROJECTORS = {"as fitted": None, "projected": PhysicalProjector()}
KINDS = [(name, kind) for name in REGRESSORS for kind in PROJECTORS]
HEADERS = (
    "recording",
    "regressor",
    "projection",
    "error, median [%]",
    "10 % of robots below",
    "90 % below",
    "chosen",
    "best",
)


@dataclass(frozen=True, kw_only=True)
class Searched:
    """One kind of pipeline on one robot.

    Attributes
    ----------
    score : float
        Mean R^2 of the blocks held out, of the best setting.
    error : float
        Error of the other motion of that setting, fitted to all blocks [%].
    """

    score: float
    error: float


def recordings(seed, duration, encoder_noise):
    """Return a short recording, and another motion of the same robot."""
    motion = {"dt": DT, "frequency": 1.0}
    short = make_robot_recording(
        duration=duration,
        encoder_noise=encoder_noise,
        torque_noise=TORQUE_NOISE,
        random_state=seed,
        **motion,
    )
    other = make_robot_recording(
        duration=10.0,
        inertial=short.inertial,
        friction=short.friction,
        random_state=OTHER + seed,
        **motion,
    )
    return short, other


def error_of(model, other):
    """Error of the predicted torque over its spread, mean over the joints [%]."""
    missed = model.predict(other.states) - other.tau_clean
    size = np.sqrt(np.mean(missed**2, axis=0))
    return 100 * np.mean(size / other.tau_clean.std(axis=0))


def study(seed, duration, encoder_noise, kinds=KINDS):
    """Search each kind on one robot: kind -> `Searched`."""
    short, other = recordings(seed, duration, encoder_noise)
    states = StateEstimator(DT).fit_transform(short.q)
    blocks = (short.t / BLOCK).astype(int)
    pipeline = Pipeline(
        [
            ("features", RigidBodyFeatures(short.urdf, friction=FRICTION)),
            ("torque", JointTorqueRegressor(dt=DT, cutoff=CUTOFF)),
        ]
    ).set_output(transform="pandas")
    found = {}
    with sklearn.config_context(enable_metadata_routing=True):
        for name, kind in kinds:
            grid = {**REGRESSORS[name], "torque__projector": [PROJECTORS[kind]]}
            search = GridSearchCV(
                pipeline, grid, cv=LeaveOneGroupOut(), error_score="raise"
            ).fit(states, short.tau, groups=blocks)
            found[name, kind] = Searched(
                score=search.best_score_, error=error_of(search, other)
            )
    return found


def rows_of(label, results):
    """Lines of the table: every kind, what was chosen, what was best."""
    kinds = list(results[0])
    errors = np.array([[found[kind].error for kind in kinds] for found in results])
    scores = np.array([[found[kind].score for kind in kinds] for found in results])
    chosen, best = scores.argmax(axis=1), errors.argmin(axis=1)

    def cells(values):
        return fixed([np.median(values), *np.quantile(values, [0.1, 0.9])])

    rows = [
        [
            label if k == 0 else "",
            *kind,
            *cells(errors[:, k]),
            np.count_nonzero(chosen == k),
            np.count_nonzero(best == k),
        ]
        for k, kind in enumerate(kinds)
    ]
    robot = np.arange(len(results))
    rows.append(["", "as the blocks choose", "", *cells(errors[robot, chosen]), "", ""])
    rows.append(["", "best in hindsight", "", *cells(errors[robot, best]), "", ""])
    return rows


def report(seeds, settings=SETTINGS, kinds=KINDS):
    """Text of the table for a range of seeds."""
    rows = []
    for label, setting in settings.items():
        started = time.perf_counter()
        rows += rows_of(label, [study(seed, *setting, kinds) for seed in seeds])
        print(f"{label}: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    lead = (
        f"Simulated arms of six joints, seeds {seeds[0]} to {seeds[-1]}, "
        f"{1 / DT:g} Hz, {100 * TORQUE_NOISE:g} % of noise in the torques; duration "
        "and deviation of the encoders' noise on the left. Settings by blocks of "
        f"{BLOCK:g} s, each held out once; low-pass of {CUTOFF:g} Hz. "
        "Error of another motion of 10 s along the true states, root mean square over "
        "the spread of the noise-free torque, mean over the joints. *Chosen*: robots "
        "on which the blocks held out preferred this line to the others; *best*: on "
        "which its error was the lowest."
    )
    return lead + "\n\n" + rst_table(rows, HEADERS, n_labels=3)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--seeds", nargs=2, type=int, default=SEEDS)
    arguments = arguments.parse_args(argv)
    publish("pipeline", report(range(*arguments.seeds)), write=arguments.write)


if __name__ == "__main__":
    main()
