"""Sections 5.2 and 5.3 of the paper in simulation: a head and an arm under control.

Run as ``python tests/benchmarks/bench_paper_robots.py [--draws 3] [--robots
head arm] [--state-cutoff auto 60] [--write]``. A robot that differs
from its URDF in its inertias, with cables, protective shells, nonlinear friction, rotor
inertias and lagging actuators, moves under a low-gain controller; from encoders and
noisy torques each method identifies rigid bodies with viscous friction. The model,
saved to a file and read back as a controller would, then feeds torques forward while
the robot, as it is, follows new motions: what counts is how well, and how much the
feedback has to add.

By default all methods share the package's smoothing and low-pass, which leave little
input noise. With --state-cutoff the states are smoothed to that frequency [Hz] alone
and nothing is filtered afterwards, nearer to the differentiated encoder readings of the
paper; methods that need the equations themselves then hold all of them in memory.
"""

import sys
import tempfile
import time
import warnings

import numpy as np
from _paper_robots import draw_motion, make_closed_loop_recording, simulate_tracking
from _report import ROOT, fixed, parser, publish, rst_table, rst_title
from sklearn.linear_model import LassoCV, RidgeCV
from sklearn.model_selection import KFold

from sklearn_vbjfa import (
    EffectDiscovery,
    PhysicalProjector,
    RobotIdentifier,
    StepwiseRegressor,
    VBJFARegressor,
    load_identified,
)
from sklearn_vbjfa.datasets import rigid_torques
from sklearn_vbjfa.physical import ProjectionError
from sklearn_vbjfa.robot import FitOptions

FRICTION = ("viscous",)
OURS = "VB, correlated inputs"
COMPLETED = "completed by EffectDiscovery"
URDF, TRUTH = "URDF, not identified", "the robot itself"
ROBOTS = ("head", "arm")
# Seeds of the motions that no method sees.
NEW_MOTIONS = (1001, 1002, 1003)


def methods():
    """Return name -> settings of `RobotIdentifier`; the paper's, then ours."""
    blocks = KFold(5)
    ridge = RidgeCV(alphas=np.geomspace(1e-4, 1e4, 17), cv=blocks)
    lasso = LassoCV(cv=blocks, alphas=30, eps=1e-5, max_iter=20_000, tol=1e-3)
    sys.path.append(str(ROOT))
    from _descent import DescentProjector

    descent = DescentProjector(constraint="eq30")
    plain = {
        "input_noise": None,
        "projector": PhysicalProjector(constraint="eq30"),
    }
    bayes = {
        "VB-JFA, the paper's": VBJFARegressor(
            latent="independent", prior="paper", query="noiseless"
        ),
        "VB-JFA, prior by noise": VBJFARegressor(
            latent="independent", query="noiseless"
        ),
    }
    return {
        # Gradient descent may end above the minimum, and then gives no answer; the
        # convex programme for the same minimum always does.
        "ridge": {**plain, "regressor": ridge},
        "ridge, gradient descent": {**plain, "regressor": ridge, "projector": descent},
        "stepwise": {**plain, "regressor": StepwiseRegressor()},
        "LASSO": {**plain, "regressor": lasso},
        **{name: {**plain, "regressor": model} for name, model in bayes.items()},
        OURS: {},
    }


def identify(recording, settings, search=False):
    """Return the fitted identifier, or None and the reason, and processor seconds."""
    robot = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=FRICTION, **settings
    )
    fitted = EffectDiscovery(robot, random_state=0) if search else robot
    started, reason = time.process_time(), ""
    with warnings.catch_warnings():
        # Convergence, and singular regressions that the projection completes.
        warnings.simplefilter("ignore")
        try:
            fitted.fit(recording.q, recording.tau, groups=recording.groups)
        except (ValueError, ProjectionError) as error:
            fitted, reason = None, str(error).rstrip(".")
    if search and fitted is not None:
        fitted = fitted.identifier_
    return fitted, reason, time.process_time() - started


def read_back(model):
    """Return the robot of a fitted identifier, saved to a file and read."""
    with tempfile.TemporaryDirectory() as folder:
        model.save(f"{folder}/robot.json")
        return load_identified(f"{folder}/robot.json")


def control(recording, feedforward, duration):
    """Follow the new motions; return averages and the share of torque missed [%]."""
    figures, reason = [], ""
    for seed in NEW_MOTIONS:
        rng = np.random.RandomState(seed)
        motion = draw_motion(recording.nominal, 1.0, 3, rng)
        result = simulate_tracking(
            recording.plant,
            motion,
            feedforward,
            duration=duration,
            dt=recording.dt,
            random_state=seed,
        )
        reason = reason or result.failure
        states = motion.states(np.arange(0.0, duration, 0.02))
        needed = recording.plant.inverse_dynamics(states)
        missed = np.sqrt(np.mean((feedforward(states) - needed) ** 2, axis=0))
        share = 100 * np.mean(missed / recording.plant.torque_size)
        figures.append((*result.averages(), share))
    return np.mean(figures, axis=0), reason


def run(name, seed, *, duration=60.0, tracked=10.0, names=None, state_cutoff=None):
    """Identify one drawn robot by every method and control it."""
    recording = make_closed_loop_recording(
        name, duration=duration / 6, n_recordings=6, random_state=seed
    )
    plant, nominal = recording.plant, recording.nominal
    shared = {}
    if state_cutoff is not None:
        options = FitOptions(state_cutoff=state_cutoff)
        shared = {"options": options, "cutoff": None}
    chosen = {**methods(), COMPLETED: {}}
    rows = {}

    def add(label, feedforward, seconds=np.nan):
        rows[label] = (*control(recording, feedforward, tracked), seconds)
        print(label, np.round(rows[label][0], 4), rows[label][1], flush=True)

    add(URDF, lambda states: rigid_torques(nominal, states))
    for label in names or chosen:
        settings = {**chosen[label], **shared}
        model, reason, seconds = identify(recording, settings, label == COMPLETED)
        if model is None:
            rows[label] = (np.full(4, np.nan), reason, seconds)
        else:
            add(label, read_back(model).predict, seconds)
    # Without the actuators' lag: the best that a model of torques can reach.
    add(TRUTH, plant.inverse_dynamics)
    return rows


HEADERS = ["method", "position [rad]", "velocity [rad/s]", "feedback [N m]"]
HEADERS += ["torque missed [%]", "failed", "processor [s]"]


def table(draws):
    """Return the table of several robots, and the reasons of failures."""
    rows, notes = [], []
    for label in draws[0]:
        own = [draw[label] for draw in draws]
        reasons = [reason for _, reason, _ in own if reason]
        notes += [f"{label}: {reason}." for reason in sorted(set(reasons))]
        average = np.mean([figures for figures, *_ in own], axis=0)
        stop = f"{len(reasons)} of {len(own)}" if reasons else "no"
        seconds = np.mean([seconds for *_, seconds in own])
        cells = [*fixed(average[:3], 4), *fixed(average[3:]), stop, *fixed([seconds])]
        rows.append([label, *cells])
    return rst_table(rows, HEADERS), *notes


def comparison(draws):
    """Compare the feedback with that of the best rival and the best without effects."""
    feedback = {x: np.mean([draw[x][0][2] for draw in draws]) for x in draws[0]}
    rivals = {x: feedback[x] for x in methods() if x in feedback and x != OURS}
    rivals = {x: value for x, value in rivals.items() if value == value}
    lines = []
    if rivals and OURS in feedback:
        best = min(rivals, key=rivals.get)
        change = 100 * (feedback[OURS] / rivals[best] - 1)
        lines.append(f"{OURS}: {change:+.1f} % feedback against {best}, the best rival")
        rivals[OURS] = feedback[OURS]
    if rivals and COMPLETED in feedback:
        share = feedback[COMPLETED] / min(rivals.values())
        lines.append(f"{COMPLETED}: {share:.2f} of the best feedback without effects")
    return [f"{'; '.join(lines)}."] if lines else []


def report(robots, n_draws=1, state_cutoffs=(None,), duration=60.0, **options):
    """Sections, one for each smoothing and robot; `options` are those of `run`."""
    paragraphs = []
    for cutoff in state_cutoffs:
        states = "automatic" if cutoff is None else f"{cutoff:.0f} Hz"
        for name in robots:
            draws = [
                run(name, seed, state_cutoff=cutoff, duration=duration, **options)
                for seed in range(n_draws)
            ]
            title = f"{name.capitalize()}: {duration:.0f} s, smoothing {states}, "
            paragraphs.append(rst_title(f"{title}{n_draws} drawn", "~"))
            paragraphs += [*table(draws), *comparison(draws)]
    return "\n\n".join(paragraphs)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__)
    arguments.add_argument("--draws", type=int, default=1, help="robots of each kind")
    arguments.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS)
    arguments.add_argument(
        "--state-cutoff",
        nargs="+",
        type=lambda text: None if text == "auto" else float(text),
        default=[None],
        help="smooth to this [Hz] and filter nothing; auto: the package's choice",
    )
    arguments = arguments.parse_args(argv)
    if arguments.quick:
        text = report(["head"], duration=12.0, tracked=3.0, names=["ridge", OURS])
    else:
        text = report(arguments.robots, arguments.draws, arguments.state_cutoff)
    command = f"paper_robots.py --draws {arguments.draws}"
    publish("paper_robots", text, arguments, command=command)


if __name__ == "__main__":
    main()
