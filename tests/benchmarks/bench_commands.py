"""Armature, damping, friction and delay from commands: simulated Go2s, and the Go2.

Run ``python tests/benchmarks/bench_commands.py --out FILE --data-home DIR [--seeds
FIRST LAST] [--ways WAY ...] [--write]``.

Data: the description is the MJCF of the measured Go2 (`fetch_unitree_go2`), its base
held. The truth is not as described: masses and shapes off by 20 % and one body by a
factor of two (as in ``bench_bodies.py``); armature, damping and Coulomb friction drawn
for hip, thigh and calf, those of the four legs alike within 5 %; commands late by a
constant delay, each held until the next row of the log. It is stepped by MuJoCo at 20
kHz under a PD law at 1 kHz that holds its torque (`_commanded_robots.py`): nothing of
it comes from the package. Encoders are read with white noise; speeds are true but for
that noise, differentiated behind 40 Hz. The log has 20 s at 200 Hz: positions and
speeds as read, positions as commanded. Every joint has a chirp of its own; judged on
another motion, sums of four sines.

Cells, by the seed: noise of .1, 1 and 3 mrad (seed modulo 3), which the drive sees or
only the log (next), delays of 0 to 5, 5 to 10 and 10 to 15 ms (next): 18 seeds have
every cell once.

Ways: ``package`` (RobotIdentifier on the torque of the PD law without a delay),
``package, drive`` (with ``drive=``), ``package, bodies as described`` (with the
parameters that CMA-ES fits), least squares with four
terms at no delay and with the delay on a grid, bodies free as well, instrumental
variables with the motion simulated from the commands (``_commanded_rivals.py``), CMA-ES
on simulated positions (bodies as described, as PACE has them; every eighth robot),
least squares on the same positions (``output error``, as mujoco.sysid has it), and
``oracle``: least squares with true states, true delay, true bodies and the hold of the
drive, which says how well anybody could know the values. Its intervals take residuals
for white in the band; those of ``oracle, blocks``, the same fit, are by the scatter of
blocks of half a second, as the friction of the simulator is nothing white, and have one
of the delay beside the four terms. ``oracle, described bodies`` is told all but the
bodies, of which it knows from draws how far robots are from their description: nobody
tells an armature from the inertia of a leg better than that. ``package, drive`` knows
of the hold as well (`PDDrive.period`), the others do not: half a millisecond of the
feedback is some 2 % of the armature and 4 % of the damping.

- armature, damping, Coulomb: median of the error over the true value.
- held: share of the intervals of 90 % that hold the true value.
- width: of these intervals, as a share of that of each oracle, term by term (median);
  a fair scale is an oracle whose own intervals hold what they say.
- torque: error in the other motion, along its true states, behind 15 Hz, over its
  spread.
- positions: error of the simulation of the other motion from its commands alone [mrad];
  none where bodies are not physical.
- seconds: of one processor, for one robot.

A cell "proves nothing" where least squares without a delay is within 1 % of the truth.
Seeds 0 to 19 are for work, from 5000 on to confirm, each once; those from another first
seed on are another table.

``--measured``: the ten runs of the Go2 itself, one motion. Fitted on runs 0 to 6,
judged on runs 7 to 9, by torque and by positions in windows of 1 s that begin with a
measured state; nothing there tells a right value from one that repeats. The torque of a
way is as late as the way says, and a late one varies less: what is missed stands over
the spread of that torque and over that of the torque at no delay. ``package, drive,
together`` is one fit of runs 0 to 6, with the low-pass of this script (10 Hz).
"""

import functools
import time
import warnings
import xml.etree.ElementTree as ET
from dataclasses import fields, replace

import numpy as np
from _commanded_rivals import (
    DELAYS,
    DT,
    VALUES,
    Found,
    described_bodies,
    evolution,
    free_least_squares,
    instruments,
    late_torque,
    least_squares,
    lowpass,
    moving,
    numbers_of,
    output_error,
    own_columns,
    states,
    vectors,
)
from _commanded_robots import (
    TICK,
    ClosedLoop,
    Gains,
    Log,
    Numbers,
    is_physical,
    recorded,
)
from _report import fixed, parser, publish, rst_table, rst_title, run_study
from _undeclared_robots import inverse_dynamics
from bench_bodies import changed

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import Recording, fetch_unitree_go2
from sklearn_vbjfa.robot import PDDrive

KEYS = ("seed", "way")
NOISES = (1e-4, 1e-3, 3e-3)
PLACES = ("loop", "log")
LATE = ((0.0, 5e-3), (5e-3, 10e-3), (10e-3, 15e-3))
DURATION = 20.0
ALIKE = 0.05
# Of hip, thigh, calf: limits between which the values of a robot are drawn.
DRAWN = {
    "armature": ((0.008, 0.03), (0.008, 0.03), (0.015, 0.05)),
    "damping": ((0.1, 0.4), (0.1, 0.4), (0.1, 0.5)),
    "coulomb": ((0.1, 0.4), (0.1, 0.4), (0.3, 1.0)),
}
AMPLITUDES = (0.2, 0.5)
POPULATION, GENERATIONS = 16, 120
CMA_EVERY = 8
PACKAGE, DRIVE = "package", "package, drive"
ORACLE, BLOCKS = "oracle", "oracle, blocks"
DESCRIBED = "oracle, described bodies"
ORACLES = ORACLE, BLOCKS, DESCRIBED
DRAWS = 2000
CMA, SIMULATED = "CMA-ES", "output error"
FIXED = "package, bodies as described"
Z90 = 1.645
# One fit of several runs of the measured robot, behind a low-pass [Hz].
TOGETHER, BAND = "package, drive, together", 10.0
# Of the measured robot's runs.
FITTED, JUDGED, SEARCHED = range(7), range(7, 10), (0, 3, 6)
WINDOW = 1.0  # [s]


# -- the robots ------------------------------------------------------------------------


@functools.lru_cache(maxsize=1)
def go2(data_home):
    """Return recording, description and drive of the measured robot."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recording = fetch_unitree_go2(data_home=data_home)
        model = recording.robot_model()
    gains = Gains(kp=np.tile([20.0, 20.0, 40.0], 4), kd=np.tile([1.0, 1.0, 2.0], 4))
    return recording, model, gains


def chirps(rng, centre):
    """Draw a chirp of every joint, from a tenth to five hertz, up or down."""
    nv = len(centre)
    size = rng.uniform(*AMPLITUDES, size=nv) * rng.choice([-1, 1], size=nv)
    slow, fast = rng.uniform(0.1, 0.5, size=nv), rng.uniform(2.0, 5.0, size=nv)
    down, phase = rng.random(nv) < 0.5, rng.uniform(0, 2 * np.pi, size=nv)
    first, last = np.where(down, fast, slow), np.where(down, slow, fast)

    def at(t):
        turns = first * t[:, None] + (last - first) * t[:, None] ** 2 / (2 * DURATION)
        # Fast ones are smaller: the motors could not follow.
        now = first + (last - first) * t[:, None] / DURATION
        now = size / (1 + now / 3.0)
        rise = np.clip(t[:, None], 0, 1) ** 2
        return centre + rise * now * np.sin(2 * np.pi * turns + phase)

    return at


def sines(rng, centre):
    """Draw a sum of four sines of every joint."""
    nv = len(centre)
    f = rng.uniform(0.2, 3.0, size=(4, nv))
    size = rng.uniform(*AMPLITUDES, size=(4, nv)) / (1 + f)
    phase = rng.uniform(0, 2 * np.pi, size=(4, nv))

    def at(t):
        rise = np.clip(t[:, None], 0, 1) ** 2
        waves = np.sin(2 * np.pi * t[:, None, None] * f + phase)
        return centre + rise * (size * waves).sum(axis=1)

    return at


def cell_of(seed):
    """Noise [rad], where it is, limits of the delay [s]."""
    return NOISES[seed % 3], PLACES[seed // 3 % 2], LATE[seed // 6 % 3]


def draw(seed, described, gains, centre, duration=DURATION, undeclared=None):
    """Draw a robot that is not as described and log two motions of it."""
    rng = np.random.default_rng([seed, 53])
    real, _ = changed(described, rng)
    nv = described.nv
    drawn = {}
    for name, limits in DRAWN.items():
        kinds = [np.exp(rng.uniform(*np.log(pair))) for pair in limits]
        scatter = np.exp(ALIKE * rng.standard_normal(nv))
        drawn[name] = np.array([kinds[j % 3] for j in range(nv)]) * scatter
    noise, place, late = cell_of(seed)
    numbers = Numbers(
        bodies=vectors(real),
        **drawn,
        offset=np.zeros(nv),
        delay=float(rng.uniform(*late)),
    )
    settings = {"deviation": noise, "in_loop": place == "loop", "rng": rng}
    settings["undeclared"] = undeclared
    logs = [
        recorded(described, numbers, gains, made(rng, centre), duration, **settings)
        for made in (chirps, sines)
    ]
    return {
        "described": described,
        "real": real,
        "gains": gains,
        "numbers": numbers,
        "fitted": logs[0],
        "judged": logs[1],
    }


@functools.lru_cache(maxsize=1)
def simulated(seed, data_home):
    """Return the case of a seed."""
    recording, model, gains = go2(data_home)
    return draw(seed, model, gains, 0.5 * (recording.q.max(0) + recording.q.min(0)))


# -- the ways --------------------------------------------------------------------------


def recording_of(described, gains, *logs):
    """Return logs as a recording: torque of the PD law without a delay, commands."""
    nv, lengths = described.nv, [len(log.q) for log in logs]
    q, v, wanted = (
        np.concatenate([getattr(log, name) for log in logs])
        for name in ("q", "v", "wanted")
    )
    return Recording(
        name="commands",
        q=q,
        v=v,
        tau=gains.torque(wanted, q, v),
        t=np.concatenate([DT * np.arange(n) for n in lengths]),
        dt=DT,
        groups=np.repeat(np.arange(len(logs)), lengths),
        group_names=tuple(f"run_{k}" for k in range(len(logs))),
        joint_names=tuple(described.names)[1:],
        position_units=("rad",) * nv,
        torque_units=("N m",) * nv,
        signals={"q_desired": wanted},
    )


def package(described, gains, *logs, drive=False, **settings):
    """Fit the package, which sees the log, or several of the same robot."""
    if drive:
        settings["drive"] = PDDrive(gains.kp, gains.kd, period=TICK)
    robot = RobotIdentifier(described, dt=DT, **settings)
    recording = recording_of(described, gains, *logs)
    robot.fit_recording(settings["drive"].driven(recording) if drive else recording)
    return found_by(robot, described)


def found_by(robot, described):
    """Numbers of an identifier, by the names of its parameters."""
    at = {name: k for k, name in enumerate(robot.parameter_names_)}
    joints = list(described.names)[1:]
    terms = ("rotor_inertia", "viscous", "coulomb", "offset")
    columns = [[at[f"{joint}:{term}"] for term in terms] for joint in joints]
    first = [at[f"{joint}:m"] for joint in joints]
    theta = robot.theta_
    delay = at.get("drive:delay")
    numbers = numbers_of(
        described,
        theta[np.array(columns)],
        0.0 if delay is None else theta[delay],
        np.array([theta[k : k + 10] for k in first]),
    )
    ranges = list(robot.ranges(level=0.9))
    ends = np.array([(one.lower, one.upper) for one in ranges])
    intervals = dict(zip(VALUES, ends[np.array(columns)].transpose(1, 2, 0)))
    if delay is not None:
        intervals["delay"] = ends[delay]
    return Found(numbers=numbers, deviations={}, intervals=intervals)


def oracle(case, *, by_blocks=False):
    """Least squares of who knows the states, the delay and the bodies."""
    log = case["fitted"]
    return least_squares(
        case["real"],
        case["gains"],
        log,
        delays=[case["numbers"].delay],
        held=0.5 * TICK,
        motion=(log.true_q, log.true_v, log.true_a),
        by_blocks=by_blocks,
    )


def oracle_of_bodies(case):
    """Posterior of who knows the states, the delay, and what bodies may be."""
    log, described = case["fitted"], case["described"]
    rng = np.random.default_rng(0)
    return described_bodies(
        described,
        case["gains"],
        log,
        case["numbers"].delay,
        0.5 * TICK,
        (log.true_q, log.true_v, log.true_a),
        np.array([vectors(changed(described, rng)[0]) for _ in range(DRAWS)]),
    )


WAYS = {
    PACKAGE: package,
    DRIVE: functools.partial(package, drive=True),
    "least squares, no delay": least_squares,
    "least squares, grid": functools.partial(least_squares, delays=DELAYS),
    "least squares, bodies free": free_least_squares,
    "instrumental variables": instruments,
    SIMULATED: output_error,
    CMA: functools.partial(evolution, population=POPULATION, generations=GENERATIONS),
}
# What CMA-ES fits: armature, damping, friction, a constant, and a delay.
WAYS[FIXED] = functools.partial(package, drive=True, bodies="fixed")


# -- the judgement ---------------------------------------------------------------------


def torques(numbers, described, motion):
    """Torques (n, nv) of a robot's numbers along a motion, q, v and a each (n, nv)."""
    import pinocchio as pin

    q, v, a = motion
    model = described.copy()
    for k, values in enumerate(numbers.bodies):
        model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(values)
    terms = np.array([*(getattr(numbers, name) for name in VALUES), numbers.offset])
    own = np.einsum("njk,kj->nj", own_columns(v, a), terms)
    return inverse_dynamics(model, q, v, a) + own


def torque_error(predicted, true, v):
    """Share of the spread of a torque (n, nv) that is missed in motion, (nv,)."""
    missed, true, rows = lowpass(predicted - true), lowpass(true), moving(v)
    pairs = zip(missed.T, true.T, rows.T)
    return np.array([np.sqrt(np.mean(m[k] ** 2)) / t[k].std() for m, t, k in pairs])


def position_errors(numbers, described, gains, log):
    """Error of simulated positions from commands alone [rad], (nv,)."""
    if not is_physical(numbers.bodies):
        return np.full(described.nv, np.nan)
    floor = {name: np.maximum(getattr(numbers, name), 1e-5) for name in VALUES}
    robot = replace(numbers, **floor)
    loop = ClosedLoop(described, gains, numbers.bodies)
    found = loop.positions([robot], log)[0, 0]
    return np.sqrt(((found - log.true_q) ** 2).mean(axis=0))


def intervals(found):
    """Intervals of 90 % by name, of normal distributions where a method has no own."""
    own = {
        name: getattr(found.numbers, name) + Z90 * np.outer([-1, 1], deviation)
        for name, deviation in found.deviations.items()
    }
    return {**own, **found.intervals}


def judge(case, found):
    """Figures of what was found."""
    truth, numbers = case["numbers"], found.numbers
    log = case["judged"]
    out = {}
    for name in VALUES:
        true = getattr(truth, name)
        out[name] = ((getattr(numbers, name) - true) / true).tolist()
    out["delay"] = 1e3 * (numbers.delay - truth.delay)
    for name, (lower, upper) in intervals(found).items():
        true = getattr(truth, name)
        held = (lower <= true) & (true <= upper)
        out[f"{name}_held"] = np.atleast_1d(held).tolist()
        out[f"{name}_width"] = np.atleast_1d((upper - lower) / (2 * Z90)).tolist()
    motion = log.true_q, log.true_v, log.true_a
    said, true = (torques(x, case["described"], motion) for x in (numbers, truth))
    error = torque_error(said, true, log.true_v)
    out["torque"] = float(error.mean())
    missed = position_errors(numbers, case["described"], case["gains"], log)
    out["positions"] = 1e3 * float(missed.mean())
    return out


def run(task):
    """Fit one robot in one way and judge it."""
    case = simulated(task["seed"], task["data_home"])
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if task["way"] == DESCRIBED:
            found = oracle_of_bodies(case)
        elif task["way"] in ORACLES:
            found = oracle(case, by_blocks=task["way"] == BLOCKS)
        else:
            way = WAYS[task["way"]]
            found = way(case["described"], case["gains"], case["fitted"])
    seconds = time.process_time() - started
    kept = {key: task[key] for key in KEYS}
    return {**kept, "seconds": seconds, **judge(case, found)}


# -- the tables ------------------------------------------------------------------------


def _median(results, key):
    values = [np.abs(r[key]) for r in results if key in r]
    return (
        float(np.median(np.concatenate(list(map(np.atleast_1d, values)))))
        if values
        else np.nan
    )


def _held(results, names):
    held = [h for r in results for n in names for h in r.get(f"{n}_held", ())]
    return 100 * float(np.mean(held)) if held else np.nan


def _width(results, oracles, name):
    """Median of the widths of a value's intervals over those of an oracle."""
    key, ratios = f"{name}_width", []
    for r in results:
        theirs = oracles.get(r["seed"], {})
        if key in r and key in theirs:
            ratios += list(np.array(r[key]) / theirs[key])
    return float(np.median(ratios)) if ratios else np.nan


TERMS = (*VALUES, "delay")
CALLED = ("armature", "damping", "Coulomb", "delay")


def overall(results):
    """Table of the ways on all robots."""
    rows = []
    hidden = BLOCKS, DESCRIBED
    for way in dict.fromkeys(r["way"] for r in results if r["way"] not in hidden):
        own = [r for r in results if r["way"] == way]
        simulated = [r["positions"] for r in own if r["positions"] == r["positions"]]
        rows.append(
            [
                way,
                str(len(own)),
                *fixed([100 * _median(own, name) for name in VALUES], 1),
                *fixed([_median(own, "delay") if way != ORACLE else np.nan], 2),
                *fixed([100 * np.median([r["torque"] for r in own])], 1),
                *fixed([np.median(simulated) if simulated else np.nan], 1),
                str(len(simulated)),
                *fixed([np.median([r["seconds"] for r in own])], 1),
            ]
        )
    headers = [
        "way",
        "robots",
        *(f"{name} [%]" for name in CALLED[:-1]),
        "delay [ms]",
        "torque [%]",
        "positions [mrad]",
        "simulated",
        "s",
    ]
    return rst_table(rows, headers)


def of_intervals(results):
    """Table of the intervals of 90 %: what they hold, and how wide they are."""
    oracles = [{r["seed"]: r for r in results if r["way"] == way} for way in ORACLES]
    rows = []
    for way in dict.fromkeys(r["way"] for r in results):
        own = [r for r in results if r["way"] == way]
        held = [_held(own, [name]) for name in TERMS]
        if way in ORACLES:
            # It is told the delay.
            held[-1] = np.nan
        if not np.isfinite(held).any():
            continue
        plain, blocks, bodies = (
            [_width(own, theirs, name) for name in TERMS] for theirs in oracles
        )
        rows.append(
            [
                way,
                *fixed(held, 0),
                *fixed(plain[:-1], 2),
                *fixed(blocks, 2),
                *fixed(bodies[:1], 2),
            ]
        )
    headers = [
        "way",
        *(f"held, {name} [%]" for name in CALLED),
        *(f"width / {ORACLE}'s, {name}" for name in CALLED[:-1]),
        *(f"/ {BLOCKS}, {name}" for name in CALLED),
        f"/ {DESCRIBED}, armature",
    ]
    return rst_table(rows, headers)


PLAIN = "least squares, no delay"


def by_cell(results, name):
    """Table of one value's error by cell, a column for each way."""
    ways = list(dict.fromkeys(r["way"] for r in results if r["way"] not in ORACLES))
    rows = []
    for late in LATE:
        for place in PLACES:
            for noise in NOISES:
                own = [r for r in results if cell_of(r["seed"]) == (noise, place, late)]
                errors = {
                    way: _median([r for r in own if r["way"] == way], name)
                    for way in ways
                }
                scale, digits = (1, 2) if name == "delay" else (100, 1)
                plain = errors.get(PLAIN, np.nan)
                rows.append(
                    [
                        f"{1e3 * noise:g}",
                        place,
                        f"{1e3 * late[0]:g} to {1e3 * late[1]:g}",
                        *fixed([scale * errors[way] for way in ways], digits),
                        "proves nothing" if name != "delay" and plain < 0.01 else "",
                    ]
                )
    headers = ["noise [mrad]", "in", "delay [ms]", *ways, ""]
    return rst_table(rows, headers, n_labels=3)


def report(results, first, last):
    """Text of the tables."""
    parts = [f"Seeds {first} to {last}.", overall(results)]
    parts += [rst_title("Intervals of 90 %", "~"), of_intervals(results)]
    titles = {
        "armature": "Armature, error [%]",
        "damping": "Damping, error [%]",
        "coulomb": "Coulomb friction, error [%]",
        "delay": "Delay, error [ms]",
    }
    for name, title in titles.items():
        parts += [rst_title(title, "~"), by_cell(results, name)]
    return "\n\n".join(parts)


# -- the measured robot ----------------------------------------------------------------


def measured_logs(data_home):
    """Return logs of the ten runs, and the values that the robot's MJCF has."""
    recording, model, _ = go2(data_home)
    logs = []
    for name in recording.group_names:
        run = recording.select(name)
        logs.append(Log(q=run.q, v=run.v, wanted=run.signals["q_desired"]))
    joints = {x.get("name"): x for x in ET.parse(recording.urdf).iter("joint")}
    own = [joints[name] for name in recording.joint_names]
    words = ("armature", "damping", "frictionloss")
    terms = [[float(joint.get(word)) for word in words] + [0.0] for joint in own]
    return logs, Found(
        numbers=numbers_of(model, terms, 0.0, vectors(model)), deviations={}
    )


def mean_of(found):
    """Mean of what was found in several runs."""
    names = [x.name for x in fields(Numbers)]
    means = {n: np.mean([getattr(f.numbers, n) for f in found], axis=0) for n in names}
    return Found(numbers=Numbers(**means), deviations={})


def window_error(numbers, described, gains, logs):
    """Error of windows of `WINDOW` seconds [mrad], the mean over joints."""
    if not is_physical(numbers.bodies):
        return np.nan
    floor = {name: np.maximum(getattr(numbers, name), 1e-5) for name in VALUES}
    loop = ClosedLoop(described, gains, numbers.bodies)
    rows = round(WINDOW / DT) + 1
    squares = []
    for log in logs:
        # A second before the first window, so that late commands are there.
        starts = range(round(1.0 / DT), len(log.q) - rows, rows - 1)
        robot = replace(numbers, **floor)
        found = loop.positions([robot], log, starts, rows)[0]
        measured = np.array([log.q[k : k + rows] for k in starts])
        squares.append(((found - measured) ** 2).mean(axis=1))
    return 1e3 * float(np.sqrt(np.concatenate(squares).mean(axis=0)).mean())


def measured_torque_errors(numbers, described, gains, logs):
    """Measure what is missed of the torque, as late as the way has it [%]."""
    errors = []
    for log in logs:
        motion = states(log.q)
        told = late_torque(log, gains, numbers.delay)
        missed = torques(numbers, described, motion) - told
        spreads = told, late_torque(log, gains, 0.0)
        errors.append([torque_error(x + missed, x, motion[1]) for x in spreads])
    return 100 * np.mean(errors, axis=(0, 2))


def measured_row(label, singles, together, described, gains, judged, seconds):
    """Cells of a way on the measured robot."""
    numbers = together.numbers
    scatter, between = np.nan, np.nan
    if len(singles) > 1:
        armatures = np.array([one.numbers.armature for one in singles])
        mean = np.abs(armatures.mean(axis=0))
        scatter = 100 * np.median(armatures.std(axis=0, ddof=1) / mean)
    legs = numbers.armature.reshape(4, 3)
    between = 100 * np.mean(legs.std(axis=0) / np.abs(legs.mean(axis=0)))
    return [
        label,
        str(len(singles)),
        *fixed(legs.mean(axis=0), 4),
        *fixed([scatter, between], 0),
        *fixed([1e3 * numbers.delay], 1),
        *fixed(measured_torque_errors(numbers, described, gains, judged), 1),
        *fixed([window_error(numbers, described, gains, judged)], 1),
        *fixed([seconds], 1),
    ]


def _listed(runs):
    return f"run{'s' * (len(runs) > 1)} {', '.join(map(str, runs))}"


def measured(data_home, ways, cma_runs=SEARCHED):
    """Table of the ways on the measured robot."""
    _, described, gains = go2(data_home)
    logs, own = measured_logs(data_home)
    judged = [logs[k] for k in JUDGED]
    rows = [measured_row("MJCF's values", [], own, described, gains, judged, np.nan)]
    for label in ways:
        runs = {CMA: cma_runs, SIMULATED: SEARCHED}.get(label, range(len(logs)))
        started = time.process_time()
        if label == TOGETHER:
            runs, several = FITTED[:1], [logs[k] for k in FITTED]
            singles = [package(described, gains, *several, drive=True, cutoff=BAND)]
        else:
            singles = [WAYS[label](described, gains, logs[k]) for k in runs]
        seconds = (time.process_time() - started) / len(singles)
        together = mean_of([one for k, one in zip(runs, singles) if k in FITTED])
        rows.append(
            measured_row(label, singles, together, described, gains, judged, seconds)
        )
        print(" | ".join(rows[-1]), flush=True)
    headers = [
        "way",
        "fits",
        *(f"armature, {name} [kg m²]" for name in ("hip", "thigh", "calf")),
        "scatter between runs [%]",
        "between legs [%]",
        "delay [ms]",
        "torque [%]",
        "at no delay [%]",
        f"windows of {WINDOW:g} s [mrad]",
        "s per fit",
    ]
    still = [log.wanted - log.q for log in judged]
    of_some = {SIMULATED: _listed(SEARCHED)}
    budget = f"{POPULATION} x {GENERATIONS} simulations each"
    of_some[CMA] = f"{_listed(cma_runs)}, {budget}"
    said = "; ".join(f"{way}: {of_some[way]}" for way in ways if way in of_some)
    note = (
        "Each run is fitted alone, but for those fitted together; judged on runs 7 to "
        "9 is the mean of the fits of "
        f"runs 0 to 6{f' ({said})' if said else ''}. The torque is that of the PD law "
        "as late as each way says. The commands themselves are "
        f"{1e3 * np.sqrt(np.mean(np.concatenate(still) ** 2)):.0f} mrad from the "
        "positions."
    )
    return f"{note}\n\n{rst_table(rows, headers)}"


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True, out=True, jobs=True, seeds=(0, 19))
    known = [*WAYS, *ORACLES, TOGETHER]
    arguments.add_argument("--ways", nargs="+", choices=known)
    arguments.add_argument("--measured", action="store_true", help="the measured Go2")
    arguments.add_argument(
        "--cma-runs",
        type=int,
        nargs="+",
        default=SEARCHED,
        help="runs of the measured robot that CMA-ES fits, some minutes each",
    )
    arguments = arguments.parse_args(argv)
    first, last = arguments.seeds
    if arguments.measured:
        asked = arguments.ways or (*WAYS, TOGETHER)
        chosen = [way for way in (*WAYS, TOGETHER) if way in asked]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            text = measured(arguments.data_home, chosen, arguments.cma_runs)
        command = "commands.py --measured"
        publish("commands_measured", text, arguments, command=command)
        return
    ways = arguments.ways or (*ORACLES, *WAYS)
    if arguments.quick:
        last, ways = first, (*ORACLES, DRIVE, "least squares, grid")
    tasks = [
        {"seed": seed, "way": way, "data_home": arguments.data_home}
        for seed in range(first, last + 1)
        for way in (*ORACLES, *WAYS)
        if way in ways and (way != CMA or (seed - first) % CMA_EVERY == 0)
    ]
    ledger = run_study(
        run,
        tasks,
        KEYS,
        out=arguments.out,
        jobs=arguments.jobs,
        line=lambda one: f"{one['seed']} {one['way']} {one['seconds']:.1f} s",
    )
    publish(
        f"commands_confirmation_{first}" if first >= 5000 else "commands",
        report(ledger.of(tasks), first, last),
        arguments,
        command=f"commands.py --seeds {first} {last}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
