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

Ways: ``package, drive`` (RobotIdentifier with ``drive=``, which includes the hold of
the drive, `PDDrive.period`), least squares with four terms at no delay and with the
delay on a grid, instrumental variables with the motion simulated from the commands
(``_commanded_rivals.py``), and CMA-ES on simulated positions (bodies as described, as
PACE has them; every eighth robot).

- armature, damping, Coulomb: median of the error over the true value.
- in interval: share of the true values in the 90 % intervals of the package.
- torque: error in the other motion, along its true states, behind 15 Hz, over its
  spread.
- positions: error of the simulation of the other motion from its commands alone [mrad];
  none where bodies are not physical.
- seconds: of one processor, for one robot.

Seeds 0 to 19 are for work, from 5000 on to confirm, each once.

``--measured``: the ten runs of the Go2 itself, one motion. Fitted on runs 0 to 6,
judged on runs 7 to 9, by torque and by positions in windows of 1 s that begin with a
measured state; nothing there tells a right value from one that repeats. The torque of a
way is as late as the way says, and a late one varies less: what is missed stands over
the spread of that torque and over that of the torque at no delay.
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
    evolution,
    instruments,
    late_torque,
    least_squares,
    lowpass,
    moving,
    numbers_of,
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
from _report import fixed, parser, publish, rst_table, run_study
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


def draw(seed, described, gains, centre):
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
    logs = [
        recorded(described, numbers, gains, made(rng, centre), DURATION, **settings)
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


def package(described, gains, log):
    """Fit the package, which sees the log."""
    recording = Recording(
        name="commands",
        q=log.q,
        v=log.v,
        tau=gains.torque(log.wanted, log.q, log.v),
        t=DT * np.arange(len(log.q)),
        dt=DT,
        groups=np.zeros(len(log.q), dtype=int),
        group_names=("run",),
        joint_names=tuple(described.names)[1:],
        position_units=("rad",) * described.nv,
        torque_units=("N m",) * described.nv,
        signals={"q_desired": log.wanted},
    )
    drive = PDDrive(gains.kp, gains.kd, period=TICK)
    robot = RobotIdentifier(described, dt=DT, drive=drive)
    return found_by(robot.fit_recording(drive.driven(recording)), described)


def found_by(robot, described):
    """Numbers of an identifier, by the names of its parameters."""
    at = {name: k for k, name in enumerate(robot.parameter_names_)}
    joints = list(described.names)[1:]
    terms = ("rotor_inertia", "viscous", "coulomb", "offset")
    columns = [[at[f"{joint}:{term}"] for term in terms] for joint in joints]
    first = [at[f"{joint}:m"] for joint in joints]
    theta = robot.theta_
    delay = at["drive:delay"]
    numbers = numbers_of(
        described,
        theta[np.array(columns)],
        theta[delay],
        np.array([theta[k : k + 10] for k in first]),
    )
    ranges = list(robot.ranges(level=0.9))
    ends = np.array([(one.lower, one.upper) for one in ranges])
    intervals = dict(zip(VALUES, ends[np.array(columns)].transpose(1, 2, 0)))
    intervals["delay"] = ends[delay]
    return Found(numbers=numbers, intervals=intervals)


CMA = "CMA-ES"
WAYS = {
    "package, drive": package,
    "least squares, no delay": least_squares,
    "least squares, grid": functools.partial(least_squares, delays=DELAYS),
    "instrumental variables": instruments,
    CMA: functools.partial(evolution, population=POPULATION, generations=GENERATIONS),
}


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


def judge(case, found):
    """Figures of what was found."""
    truth, numbers = case["numbers"], found.numbers
    log = case["judged"]
    out = {}
    for name in VALUES:
        true = getattr(truth, name)
        out[name] = ((getattr(numbers, name) - true) / true).tolist()
    out["delay"] = 1e3 * (numbers.delay - truth.delay)
    held = [
        np.atleast_1d((lower <= getattr(truth, name)) & (getattr(truth, name) <= upper))
        for name, (lower, upper) in found.intervals.items()
    ]
    out["held"] = np.concatenate(held).tolist() if held else []
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
        way = WAYS[task["way"]]
        found = way(case["described"], case["gains"], case["fitted"])
    seconds = time.process_time() - started
    kept = {key: task[key] for key in KEYS}
    return {**kept, "seconds": seconds, **judge(case, found)}


# -- the tables ------------------------------------------------------------------------


def _median(results, key):
    return float(np.median([np.abs(x) for r in results for x in np.atleast_1d(r[key])]))


def overall(results):
    """Table of the ways on all robots."""
    rows = []
    for way in dict.fromkeys(r["way"] for r in results):
        own = [r for r in results if r["way"] == way]
        simulated = [r["positions"] for r in own if r["positions"] == r["positions"]]
        held = [inside for r in own for inside in r["held"]]
        rows.append(
            [
                way,
                str(len(own)),
                *fixed([100 * _median(own, name) for name in VALUES], 1),
                *fixed([_median(own, "delay")], 2),
                *fixed([100 * np.mean(held) if held else np.nan], 0),
                *fixed([100 * _median(own, "torque")], 1),
                *fixed([np.median(simulated) if simulated else np.nan], 1),
                str(len(simulated)),
                *fixed([_median(own, "seconds")], 1),
            ]
        )
    headers = ["way", "robots", "armature [%]", "damping [%]", "Coulomb [%]"]
    headers += ["delay [ms]", "in interval [%]", "torque [%]", "positions [mrad]"]
    return rst_table(rows, [*headers, "simulated", "s"])


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
    return logs, Found(numbers=numbers_of(model, terms, 0.0, vectors(model)))


def mean_of(found):
    """Mean of what was found in several runs."""
    names = [x.name for x in fields(Numbers)]
    means = {n: np.mean([getattr(f.numbers, n) for f in found], axis=0) for n in names}
    return Found(numbers=Numbers(**means))


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


def measured(data_home, ways):
    """Table of the ways on the measured robot."""
    _, described, gains = go2(data_home)
    logs, own = measured_logs(data_home)
    judged = [logs[k] for k in JUDGED]
    rows = [measured_row("MJCF's values", [], own, described, gains, judged, np.nan)]
    for label in ways:
        runs = SEARCHED if label == CMA else range(len(logs))
        started = time.process_time()
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
    still = np.concatenate([log.wanted - log.q for log in judged])
    note = (
        "Each run is fitted alone; judged on runs 7 to 9 is the mean of the fits of "
        f"runs 0 to 6 ({CMA}: runs 0, 3, 6, {POPULATION} x {GENERATIONS} simulations "
        "each). The torque is that of the PD law as late as each way says. The "
        f"commands themselves are {1e3 * np.sqrt(np.mean(still**2)):.0f} mrad from the "
        "positions."
    )
    return f"{note}\n\n{rst_table(rows, headers)}"


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True, out=True, jobs=True, seeds=(0, 19))
    arguments.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    arguments.add_argument("--measured", action="store_true", help="the measured Go2")
    arguments = arguments.parse_args(argv)
    (first, last), ways = arguments.seeds, arguments.ways
    if arguments.measured:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            text = measured(arguments.data_home, ways)
        command = "commands.py --measured"
        publish("commands_measured", text, arguments, command=command)
        return
    if arguments.quick:
        last, ways = first, ("package, drive", "least squares, grid")
    tasks = [
        {"seed": seed, "way": way, "data_home": arguments.data_home}
        for seed in range(first, last + 1)
        for way in WAYS
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
        f"Seeds {first} to {last}.\n\n{overall(ledger.of(tasks))}",
        arguments,
        command=f"commands.py --seeds {first} {last}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
