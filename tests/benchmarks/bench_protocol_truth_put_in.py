"""Truth put into real recordings: real noise, real friction, known answer.

Run as ``python tests/benchmarks/bench_protocol_truth_put_in.py --data-home DIR``.
Each case changes one thing in a recording of a TX40, a UR5 or a Panda, and the loop is
closed on the result. What it then names in addition to what it names on the recording
as it is should be what was put in.
"""

import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import _manipulations as put
import numpy as np
from _protocol_sets import MANIPULATED_SETS
from _report import fixed, parser, publish, rst_table, rst_title
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.physical import ProjectionError

SEED = 0
UNTOUCHED = "as recorded"
TILTS = (1.0, 2.0, 4.0)  # degrees about x of the base
SHIFTS = (0.5, 1.0, 4.0)  # degrees
GAINS = (0.8, 0.9, 1.1, 1.25)
JITTER = 0.2  # of the period, standard deviation
LOST = 0.05  # of the rows
SLOPE = -0.02  # of the friction, per degree
# Joints from zero: of the shifted position and scaled torque, and of the friction,
# which on the Panda is small but in its wrist.
JOINT = 2
FRICTION_JOINT = {"franka_panda": 4}
# A value counts as found within this share of what was put in.
TOLERANCE = 0.2


@dataclass(frozen=True, kw_only=True)
class Case:
    """A recording with one thing changed, and what a report should say of it."""

    kind: str
    label: str
    q: np.ndarray
    tau: np.ndarray
    groups: np.ndarray
    model: object
    joint: int | None = None
    value: float = np.nan
    signals: dict = field(default_factory=dict)


def _angle(parameters):
    return float(np.hypot(parameters["roll"], parameters["pitch"]))


# What should be named, and its value from the effect's parameters (SI units). A name
# of None: nothing that is not named on the recording as it is. Signs of angles depend
# on what counts as turned, so that their sizes are compared.
EXPECTED = {
    "tilt": ("base_tilt", _angle),
    "zero": ("joint_zero", lambda parameters: abs(float(parameters["zero"]))),
    "gain": ("torque_gain", lambda parameters: float(parameters["gain"])),
    "temperature": ("signal", lambda parameters: None),
    "stamps": (None, None),
    "rows": (None, None),
}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What the loop said of a case."""

    case: Case
    effects: tuple = ()
    before: np.ndarray = None
    after: np.ndarray = None
    spread: np.ndarray = None
    seconds: float = 0.0
    message: str = ""

    def names(self):
        """Return what was named, with the joint from zero."""
        return [(effect.name, effect.joint) for effect in self.effects]


def through_a_file(recording, t, rows):
    """Write rows of a recording with other stamps, and read it as a user would."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.npz"
        np.savez(
            path,
            t=t[rows],
            q=recording.q[rows],
            tau=recording.tau[rows],
            segment=recording.groups[rows],
        )
        return read_recording(
            path,
            dt=recording.dt,
            urdf=recording.urdf,
            joint_names=recording.joint_names,
        )


def cases(recording, declared, friction_joint=1, kinds=None):
    """Yield the recording as it is, then every case."""
    model = recording.robot_model()
    same = {
        "q": recording.q,
        "tau": recording.tau,
        "groups": recording.groups,
        "model": model,
    }
    wanted = EXPECTED if kinds is None else kinds
    yield Case(kind=UNTOUCHED, label=UNTOUCHED, **same)
    if "tilt" in wanted:
        for degrees in TILTS:
            yield Case(
                kind="tilt",
                label=f"gravity of the model rotated by {degrees:g} degrees",
                **{**same, "model": put.rotate_gravity(model, degrees)},
                value=np.deg2rad(degrees),
            )
    if "zero" in wanted:
        for degrees in SHIFTS:
            yield Case(
                kind="zero",
                label=f"position {JOINT + 1} shifted by {degrees:g} degrees",
                **{**same, "q": put.shift_zero(recording.q, JOINT, degrees)},
                joint=JOINT,
                value=np.deg2rad(degrees),
            )
    if "gain" in wanted:
        for gain in GAINS:
            yield Case(
                kind="gain",
                label=f"torque {JOINT + 1} times {gain:g}",
                **{**same, "tau": put.scale_channel(recording.tau, JOINT, gain)},
                joint=JOINT,
                value=gain,
            )
    if "temperature" in wanted:
        yield _heated(recording, declared, friction_joint, same)
    rng = np.random.default_rng(SEED)
    everything = np.arange(recording.n_samples)
    uniform = _uniform_time(recording)
    if "stamps" in wanted:
        t = put.jitter_stamps(uniform, recording.dt, JITTER, rng)
        yield _read(
            "stamps", f"stamps off by {JITTER:g} periods", recording, t, everything
        )
    if "rows" in wanted:
        rows = put.keep_rows(recording.groups, LOST, rng)
        share = 100 * (1 - rows.size / recording.n_samples)
        yield _read("rows", f"{share:.1f} % of the rows lost", recording, uniform, rows)


def _heated(recording, declared, joint, same):
    n = recording.n_samples
    temperature = put.made_up_temperature(n)
    states = declared.state_estimator_.transform(recording.q, groups=recording.groups)
    value = dict(zip(declared.parameter_names_, declared.theta_))
    name = declared.joint_names_[joint]
    coulomb = value[f"{name}:coulomb"]
    friction = put.friction_of_speed(
        states[:, recording.nv + joint],
        value[f"{name}:viscous"],
        coulomb,
        declared.standstill_[joint],
    )
    tau = put.heat_friction(recording.tau, joint, friction, temperature, SLOPE)
    return Case(
        kind="temperature",
        label=f"friction {joint + 1} {100 * SLOPE:+g} % per degree, made-up",
        **{**same, "tau": tau},
        joint=joint,
        value=SLOPE * coulomb,
        signals={"temperature": temperature},
    )


def _read(kind, label, recording, t, rows):
    found = through_a_file(recording, t, rows)
    return Case(
        kind=kind,
        label=label,
        q=found.q,
        tau=found.tau,
        groups=found.groups,
        model=recording.robot_model(),
    )


def _uniform_time(recording):
    """Stamps from zero in every recording, (n,)."""
    first = np.r_[0, np.flatnonzero(np.diff(recording.groups)) + 1]
    start = np.repeat(first, np.diff(np.r_[first, recording.n_samples]))
    return recording.dt * (np.arange(recording.n_samples) - start)


def close(case, identifier):
    """Close the loop on a case."""
    robot = clone(identifier).set_params(model=case.model)
    loop = EffectDiscovery(robot, random_state=0)
    started = time.perf_counter()
    try:
        given = {"groups": case.groups, "signals": case.signals or None}
        loop.fit(case.q, case.tau, **given)
    except (ValueError, ProjectionError) as error:
        return Answer(
            case=case, message=str(error), seconds=time.perf_counter() - started
        )
    seconds = time.perf_counter() - started
    return Answer(
        case=case,
        effects=loop.effects_,
        before=loop.error_before_ * loop.torque_std_,
        after=loop.error_after_ * loop.torque_std_,
        spread=loop.torque_std_,
        seconds=seconds,
    )


def verdict(answer, reference):
    """Judge an answer: "named", "named, value off", or what is wrong with it."""
    case = answer.case
    if answer.message:
        return "refused", np.nan
    if case.kind == UNTOUCHED:
        return "–", np.nan
    expected, read = EXPECTED[case.kind]
    if expected is None:
        if added(answer, reference):
            return "other names", np.nan
        lost = gone(answer, reference)
        return ("names gone" if lost else "nothing added"), np.nan
    for effect in answer.effects:
        there = case.joint is None or effect.joint == case.joint
        if effect.name != expected or not there:
            continue
        value = read(effect.parameters)
        if value is None:
            return "named", np.nan
        # A gain is off from 1, an angle from 0.
        neutral = 1.0 if case.kind == "gain" else 0.0
        close_by = abs(value - case.value) <= TOLERANCE * abs(case.value - neutral)
        return ("named" if close_by else "named, value off"), value
    return ("misnamed" if added(answer, reference) else "not named"), np.nan


def added(answer, reference):
    """Return what is named and is not on the recording as it is."""
    return [pair for pair in answer.names() if pair not in reference.names()]


def gone(answer, reference):
    """Return what is named on the recording as it is and no longer is."""
    return [pair for pair in reference.names() if pair not in answer.names()]


HEADERS = [
    "put in",
    "expected, value",
    "verdict",
    "value",
    "added, joint from 1",
    "gone",
    "before, that joint [N m]",
    "after",
    "as recorded, before",
    "as recorded, after",
    "before, mean [%]",
    "after",
    "s",
]


def row(answer, reference):
    """Row of the table."""
    case = answer.case
    text, value = verdict(answer, reference)
    expected = EXPECTED.get(case.kind, (None, None))[0]
    should = "nothing more" if case.kind in EXPECTED else "–"
    if expected:
        where = "" if case.joint is None else f" {case.joint + 1}"
        should = f"{expected}{where}, {case.value:.4g}"
    named = [_words(found(answer, reference)) for found in (added, gone)]
    if case.kind == UNTOUCHED:
        named = [_words(answer.names()), "–"]
    cells = [case.label, should, text, *fixed([value], 4), *named]
    if answer.message:
        return [*cells[:4], answer.message, *["–"] * 7, f"{answer.seconds:.0f}"]
    own = [np.nan] * 4
    if case.joint is not None and not reference.message:
        errors = answer.before, answer.after, reference.before, reference.after
        own = [error[case.joint] for error in errors]
    mean = [100 * np.nanmean(x / answer.spread) for x in (answer.before, answer.after)]
    return [*cells, *fixed(own, 3), *fixed(mean), f"{answer.seconds:.0f}"]


def _words(pairs):
    return ", ".join(f"{name} {joint + 1}" for name, joint in pairs) or "nothing"


def run_set(name, data_home=None, kinds=None):
    """Answers of one robot, that of the recording as it is first; and the recording."""
    frozen = MANIPULATED_SETS[name]
    recording = frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    declared = frozen.identifier(recording.robot_model(), recording.dt)
    declared.fit(recording.q, recording.tau, groups=recording.groups)
    answers = []
    joint = FRICTION_JOINT.get(name, 1)
    for case in cases(recording, declared, joint, kinds):
        answers.append(close(case, identifier))
        print(
            f"{name}: {' | '.join(row(answers[-1], answers[0]))}",
            file=sys.stderr,
            flush=True,
        )
    return answers, recording


def section(name, answers, recording, part=""):
    """Paragraphs of one robot."""
    rows = [row(answer, answers[0]) for answer in answers]
    return [
        rst_title(name, "~"),
        f"{recording}: {', '.join(recording.group_names)}. "
        f"{MANIPULATED_SETS[name].describe()}.{part}",
        INTRODUCTION,
        rst_table(rows, HEADERS, n_labels=6),
    ]


INTRODUCTION = f"""Positions, torques or model of the recording with one thing
changed. Verdict: named is the right effect on the right joint with its value within
{100 * TOLERANCE:.0f} % of what was put in. Added and gone: against what is named on the
recording as it is. Errors: root mean square on the held-out part as the report
gives it, in N m on the joint that was changed, and the mean of all joints in per cent
of the torque's spread in the moving time of the whole recording.
"As recorded" are the errors of the same joint where nothing was put in.
Stamps are off by white noise, rows are lost at random, never two in a row; both then
come through a file, as a user's recording does. Seed {SEED}."""


def totals(counts):
    """Table of verdicts by what was put in, from pairs of kind and verdict."""
    verdicts = list(dict.fromkeys(text for _, text in counts))
    rows = [
        [kind, str(EXPECTED[kind][0] or "nothing"), *map(str, numbers)]
        for kind in dict.fromkeys(kind for kind, _ in counts)
        for numbers in [[counts.count((kind, text)) for text in verdicts]]
    ]
    return rst_table(rows, ["put in", "should be named", *verdicts], n_labels=2)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True)
    arguments.add_argument("--data", nargs="*", choices=MANIPULATED_SETS)
    arguments.add_argument("--put-in", nargs="*", choices=EXPECTED, help="some kinds")
    arguments = arguments.parse_args(argv)
    names = arguments.data or [n for n in MANIPULATED_SETS if n != "demo"]
    put_in = arguments.put_in
    if arguments.quick:
        names, put_in = ["demo"], ["gain"]
    part = f" Only: {', '.join(put_in)}." if put_in else ""
    for name in names:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            answers, recording = run_set(name, arguments.data_home, put_in)
        counts = [(a.case.kind, verdict(a, answers[0])[0]) for a in answers[1:]]
        # A table for each robot, as a run takes its time.
        publish(
            f"protocol_truth_put_in_{name}",
            "\n\n".join([*section(name, answers, recording, part), totals(counts)]),
            arguments,
            command=f"protocol_truth_put_in.py --data {name}",
        )


if __name__ == "__main__":
    main()
