"""Sections 5.2 and 5.3 of the paper in simulation: a head and an arm under control.

Run as ``python tests/benchmarks/bench_paper_robots.py [--full] [--draws 3] [--robots
head arm] [--methods ...] [--state-cutoff auto 60] [--write]``. A robot that differs
from its URDF in its inertias, with cables, protective shells, nonlinear friction, rotor
inertias and lagging actuators, moves under a low-gain controller; from encoders and
noisy torques each method identifies rigid bodies with viscous friction. The model,
saved to a file and read back as a controller would, then feeds torques forward while
the robot, as it is, follows new motions: what counts is how well, and how much the
feedback has to add. --full takes 500,000 samples, the paper's number, instead of one
minute.

By default all methods share the package's smoothing and low-pass, which leave little
input noise. With --state-cutoff the states are smoothed to that frequency [Hz] alone
and nothing is filtered afterwards, nearer to the differentiated encoder readings of the
paper; methods that need the equations themselves then hold all of them in memory.
"""

import multiprocessing
import resource
import shlex
import sys
import tempfile
import time
import warnings
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from _paper_robots import (
    draw_motion,
    make_closed_loop_recording,
    simulate_tracking,
)
from _report import add_root_to_path, parser, publish, rst_table, rst_title
from sklearn.linear_model import LassoCV, RidgeCV
from sklearn.model_selection import KFold

from sklearn_vbjfa import (
    EffectDiscovery,
    PhysicalProjector,
    RigidBodyFeatures,
    RobotIdentifier,
    StateEstimator,
    StepwiseRegressor,
    VBJFARegressor,
    load_identified,
)
from sklearn_vbjfa._core._lowpass import BlockFilter, Lowpass
from sklearn_vbjfa.datasets import rigid_torques
from sklearn_vbjfa.physical import ProjectionError
from sklearn_vbjfa.robot import JointMoments
from sklearn_vbjfa.robot import _fit as course
from sklearn_vbjfa.robot._states import SplineStates

FRICTION = ("viscous",)
FULL_SAMPLES = 500_000
OURS = "VB, correlated inputs"
COMPLETED = "completed by EffectDiscovery"
# Seeds of the motions that no method sees.
NEW_MOTIONS = (1001, 1002, 1003)
STAGES = ("states", "features", "statistics", "fit", "projection", "other")
# Which calls make up a stage; time counts for the innermost.
CALLS = (
    ("states", StateEstimator, ("fit", "transform", "split_transform")),
    ("states", SplineStates, ("__getitem__", "derivative")),
    ("features", RigidBodyFeatures, ("matrices", "entries")),
    ("statistics", Lowpass, ("__call__",)),
    ("statistics", BlockFilter, ("add",)),
    ("statistics", course, ("accumulate",)),
    ("statistics", JointMoments, ("__add__",)),
    ("fit", course, ("estimate",)),
    ("projection", PhysicalProjector, ("fit", "transform")),
)


def methods():
    """Return name -> settings of `RobotIdentifier`; the paper's, then ours.

    What a method has to choose it chooses by five blocks of time. The paper tuned its
    ridge by hand.
    """
    blocks = KFold(5)
    ridge = RidgeCV(alphas=np.geomspace(1e-4, 1e4, 17), cv=blocks)
    lasso = LassoCV(cv=blocks, alphas=30, eps=1e-5, max_iter=20_000, tol=1e-3)
    add_root_to_path()
    from tests.reference.descent_projector import DescentProjector

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


@contextmanager
def stopwatch():
    """Time the stages of a fit; yields stage -> seconds, filled at the end."""
    seconds, running, originals = dict.fromkeys(STAGES, 0.0), [], []

    def timed(stage, function):
        def wrapper(*args, **kwargs):
            now = time.perf_counter()
            if running:
                seconds[running[-1][0]] += now - running[-1][1]
            running.append([stage, now])
            try:
                return function(*args, **kwargs)
            finally:
                now = time.perf_counter()
                seconds[stage] += now - running.pop()[1]
                if running:
                    running[-1][1] = now

        return wrapper

    for stage, owner, names in CALLS:
        for name in names:
            originals.append((owner, name, owner.__dict__.get(name)))
            setattr(owner, name, timed(stage, getattr(owner, name)))
    started = time.perf_counter()
    try:
        yield seconds
    finally:
        total = time.perf_counter() - started
        seconds["other"] = total - sum(seconds.values())
        for owner, name, function in originals:
            if function is None:
                delattr(owner, name)
            else:
                setattr(owner, name, function)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """What a fit gave and took.

    Attributes
    ----------
    model : RobotIdentifier or None
        The fitted identifier; None if there is no answer.
    message : str
        Why there is none.
    seconds : dict of str to float
        Time of each stage [s].
    memory : float
        Memory beyond what the data take [MB].
    """

    model: object
    message: str
    seconds: dict
    memory: float


def _fit(identifier, recording, search):
    """Identify; with `search` also look for what the model lacks."""
    with warnings.catch_warnings():
        # Convergence, and what a singular regression leaves to the projection.
        warnings.simplefilter("ignore")
        if search is None:
            return identifier.fit(recording.q, recording.tau, groups=recording.groups)
        search.fit(recording.q, recording.tau, groups=recording.groups)
        return search.identifier_


def _peak():
    """Largest memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _child(sender, identifier, recording, search):
    before, model, message = _peak(), None, ""
    with stopwatch() as seconds:
        try:
            model = _fit(identifier, recording, search)
        except (ValueError, ProjectionError) as error:
            message = str(error).rstrip(".")
    sender.send((model, message, seconds, _peak() - before))
    sender.close()


def identify(recording, settings, search=None):
    """Fit in a process of its own, whose peak memory is then the fit's."""
    identifier = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=FRICTION, **settings
    )
    if search is not None:
        search = search(identifier)
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(sender, identifier, recording, search))
    child.start()
    sender.close()
    model, message, seconds, memory = receiver.recv()
    child.join()
    return Identification(model=model, message=message, seconds=seconds, memory=memory)


def effect_discovery(identifier):
    """Search for undeclared effects; the last quarter of the data is not fitted."""
    return EffectDiscovery(identifier, random_state=0)


def read_back(model):
    """Return the robot of a fitted identifier, saved to a file and read."""
    with tempfile.TemporaryDirectory() as folder:
        model.save(f"{folder}/robot.json")
        return load_identified(f"{folder}/robot.json")


def control(recording, feedforward, duration):
    """Follow the new motions; return averages and the share of torque missed [%].

    The averages are those of the paper, over joints, here over motions too; nan where
    the robot had to be stopped, with the reason.
    """
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


def bare_loop(recording):
    """Seconds of Pinocchio in a loop that computes the regressors and nothing else.

    On the positions as they are, with velocities and accelerations of the same size.
    """
    import pinocchio as pin

    model = recording.robot_model()
    data, q = model.createData(), recording.q
    v = np.gradient(q, recording.dt, axis=0)
    started = time.perf_counter()
    for i in range(q.shape[0]):
        pin.computeJointTorqueRegressor(model, data, q[i], v[i], v[i])
    return time.perf_counter() - started


def record(name, seed, full=False, duration=60.0):
    """Record one drawn robot; six or twenty motions side by side."""
    rate = {"head": 420.0, "arm": 480.0}[name]
    n_recordings = 20 if full else 6
    length = FULL_SAMPLES / rate if full else duration
    return make_closed_loop_recording(
        name,
        duration=length / n_recordings,
        n_recordings=n_recordings,
        random_state=seed,
    )


def run(
    name,
    *,
    seed=0,
    full=False,
    duration=60.0,
    tracked=10.0,
    names=None,
    state_cutoff=None,
    on_row=None,
):
    """Identify one drawn robot by every method and control it.

    Parameters
    ----------
    name : {"head", "arm"}
        Robot.
    seed : int
        Which robot and recording is drawn.
    full : bool
        500,000 samples instead of `duration`.
    duration : float
        Length of the recordings together [s].
    tracked : float
        Length of each motion that is followed [s].
    names : sequence of str
        Methods; None is all.
    state_cutoff : float
        Cut-off of the states [Hz], without a low-pass of the equations; None is the
        package's choice of both.
    on_row : callable
        Called with each row once it is there.

    Returns
    -------
    rows : dict of str to tuple
        Name -> averages, reason of a stop, `Identification` or None.
    seconds : tuple of float
        Time of a simulated sample [microseconds], and of the regressors of all samples
        in a bare loop [s].
    """
    started = time.perf_counter()
    recording = record(name, seed, full, duration)
    per_sample = 1e6 * (time.perf_counter() - started) / recording.n_samples
    plant, nominal = recording.plant, recording.nominal
    loop, rows = bare_loop(recording), {}

    def add(label, feedforward, fit=None):
        rows[label] = (*control(recording, feedforward, tracked), fit)
        if on_row is not None:
            on_row(label, rows[label])

    add("URDF, not identified", lambda states: rigid_torques(nominal, states))
    chosen = [(label, settings, None) for label, settings in methods().items()]
    chosen.append((COMPLETED, {}, effect_discovery))
    shared = {}
    if state_cutoff is not None:
        shared = {"state_cutoff": state_cutoff, "cutoff": None}
    for label, settings, extra in chosen:
        if names is not None and label not in names:
            continue
        fit = identify(recording, {**settings, **shared}, extra)
        if fit.model is None:
            rows[label] = (np.full(4, np.nan), fit.message, fit)
            continue
        add(label, read_back(fit.model).predict, fit)
    # Without the actuators' lag: what a model of torques can reach at best.
    add("the robot itself", plant.inverse_dynamics)
    return rows, (per_sample, loop)


HEADERS = [
    "method",
    "position [rad]",
    "velocity [rad/s]",
    "feedback [N m]",
    "torque missed [%]",
    "failed",
]
TIME_HEADERS = ["method", *[f"{stage} [s]" for stage in STAGES], "memory [MB]"]


def tables(draws):
    """Tables of control and of cost, and what failed, of one or several robots.

    Parameters
    ----------
    draws : list of dict
        Rows of `run`; averages are over the draws.
    """
    control_rows, cost_rows, notes = [], [], []
    for label in draws[0]:
        rows = [draw[label] for draw in draws]
        reasons = [reason for _, reason, _ in rows if reason]
        notes += [f"{label}: {reason}." for reason in sorted(set(reasons))]
        average = np.mean([figures for figures, *_ in rows], axis=0)
        cells = [f"{x:.4f}" if x == x else "–" for x in average[:3]]
        missed = f"{average[3]:.1f}" if average[3] == average[3] else "–"
        stop = f"{len(reasons)} of {len(rows)}" if reasons else "no"
        control_rows.append([label, *cells, missed, stop])
        fits = [fit for *_, fit in rows if fit is not None]
        if fits:
            seconds = [
                f"{np.mean([fit.seconds[stage] for fit in fits]):.2f}"
                for stage in STAGES
            ]
            memory = f"{np.max([fit.memory for fit in fits]):.0f}"
            cost_rows.append([label, *seconds, memory])
    return rst_table(control_rows, HEADERS), *notes, rst_table(cost_rows, TIME_HEADERS)


def comparison(draws):
    """Say how the feedback compares, ours with the rivals' and completed with all."""

    def feedback(label):
        return (
            np.mean([draw[label][0][2] for draw in draws]) if label in draws[0] else 0
        )

    rivals = {label: feedback(label) for label in methods() if label != OURS}
    rivals = {label: value for label, value in rivals.items() if value > 0}
    said, ours, best = [], feedback(OURS), min(rivals, key=rivals.get, default=None)
    if best is not None and ours > 0:
        change = 100 * (ours / rivals[best] - 1)
        said.append(f"{OURS}: {change:+.1f} % feedback against {best}, the best rival")
        rivals[OURS] = ours
    if feedback(COMPLETED) > 0 and rivals:
        share = feedback(COMPLETED) / min(rivals.values())
        said.append(f"{COMPLETED}: {share:.2f} of the best feedback without effects")
    return "; ".join(said) + "." if said else ""


def section(name, draws, times, *, full=False, duration=60.0, state_cutoff=None):
    """Section of the guide about one robot: what `run` gave, draw by draw."""
    size = f"{FULL_SAMPLES:,} samples" if full else f"{duration:.0f} s"
    states = "automatic" if state_cutoff is None else f"{state_cutoff:.0f} Hz"
    drawn = f"{len(draws)} drawn"
    return [
        rst_title(f"{name.capitalize()}: {size}, smoothing {states}, {drawn}", "~"),
        *tables(draws),
        *filter(None, [comparison(draws)]),
        "Simulation: {:.0f} microseconds a sample. A bare loop over the samples with "
        "Pinocchio's regressor: {:.1f} s.".format(*np.mean(times, axis=0)),
    ]


def report(robots, *, n_draws=1, state_cutoffs=(None,), on_row=None, **options):
    """Sections of the guide, one a smoothing and robot; `options` are those of `run`.

    The methods of `options` may be None, all of them.
    """
    names, paragraphs = options.pop("names", None), []
    for cutoff in state_cutoffs:
        for name in robots:
            draws, times = [], []
            for seed in range(n_draws):
                rows, per_sample = run(
                    name,
                    seed=seed,
                    names=names,
                    state_cutoff=cutoff,
                    on_row=on_row,
                    **options,
                )
                draws.append(rows)
                times.append(per_sample)
            paragraphs += section(name, draws, times, state_cutoff=cutoff, **options)
    return "\n\n".join(paragraphs)


def main():
    """Run from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument(
        "--full", action="store_true", help="500,000 samples instead of 60 s"
    )
    arguments.add_argument(
        "--draws", type=int, default=1, help="robots drawn of each kind"
    )
    arguments.add_argument(
        "--robots", nargs="+", choices=("head", "arm"), default=("head", "arm")
    )
    arguments.add_argument(
        "--methods", nargs="+", choices=(*methods(), COMPLETED), help="default: all"
    )
    arguments.add_argument(
        "--state-cutoff",
        nargs="+",
        type=lambda text: None if text == "auto" else float(text),
        default=[None],
        help="smooth to this [Hz] and filter nothing; auto: the package's choice",
    )
    arguments = arguments.parse_args()
    given = [word for word in sys.argv[1:] if word != "--write"]

    def show(label, row):
        print(label, np.round(row[0], 4), row[1], flush=True)

    text = report(
        arguments.robots,
        n_draws=arguments.draws,
        full=arguments.full,
        names=arguments.methods,
        state_cutoffs=arguments.state_cutoff,
        on_row=show,
    )
    name = "paper_robots_full" if arguments.full else "paper_robots"
    command = shlex.join(["python", "tests/benchmarks/bench_paper_robots.py", *given])
    publish(name, text, write=arguments.write, command=command)


if __name__ == "__main__":
    main()
