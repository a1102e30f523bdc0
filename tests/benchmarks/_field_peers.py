"""The peers of ``bench_field.py``: what a user writes, and what comes back.

Every peer is told the four plain terms of each joint (`PLAIN`), whatever the set: who
has no viscous or Coulomb friction, offset or rotor inertia is not compared with here.
"""

import contextlib
import io
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import _servo as servo
import bench_commands as commands
import numpy as np
import pinocchio as pin
from _commanded_rivals import (
    HIGHEST,
    LATEST,
    SLOW_STEP,
    VALUES,
    Found,
    evolution,
    late_torque,
    numbers_of,
    states,
    vectors,
)
from _commanded_robots import DT, ClosedLoop, Log, is_physical, mjcf
from _figaroh import SCRIPTS, recordings, run_figaroh
from _rivals import settings_of
from _undeclared_robots import inverse_dynamics

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, StateEstimator
from sklearn_vbjfa.robot import FitOptions, PDDrive

PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
OURS, SEARCH, FIGAROH = "RobotIdentifier", "EffectDiscovery", "FIGAROH"
SYSID, CMA = "mujoco.sysid", "CMA-ES"
# Budgets: simulations of CMA-ES for a run (and evaluations for the servo), iterations
# of mujoco.sysid.
POPULATION, GENERATIONS, EVALUATIONS, ITERATIONS = 16, 120, 4000, 10
# Of the torque-driven simulations that mujoco.sysid is fitted to.
RUNS, LENGTH, LONGEST_STEP = 8, 0.5, 2e-3  # number, [s], [s]
LARGEST_BIAS = 5.0  # of the Go2's joints [N m]
THICKNESS = 1e-2  # [m]
SERVO = "bam_xl330"


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A set: what is fitted and judged, and on what terms."""

    name: str
    cutoff: float
    standstill: float | str
    recording: object
    fitted: dict
    held_out: dict
    gains: object = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a peer says."""

    predicted: np.ndarray
    seconds: float
    consistent: str
    named: str = "nothing"
    told: np.ndarray | None = None
    simulate: Callable | None = None
    follow: Callable | None = None


# -- what a user writes ----------------------------------------------------------------


def declared(model, case, part, **more):
    """Declare a robot to this package, as a user does."""
    return RobotIdentifier(
        model,
        dt=part["dt"],
        friction=PLAIN,
        cutoff=case.cutoff,
        drive=PDDrive() if case.gains else None,
        **more,
    )


def fit(robot, part):
    """Fit to arrays, or to a recording whose drive is told commands."""
    drive = getattr(robot, "identifier", robot).drive
    if drive is not None:
        return robot.fit_recording(drive.driven(part["recording"]))
    return robot.fit(part["q"], part["tau"], groups=part["groups"])


# -- this package, and regressors on its columns ---------------------------------------


def identified(case, part, peer):
    """Answer of this package, or of a regressor on its columns."""
    model = case.recording.robot_model()
    started = time.process_time()
    options = FitOptions(standstill=case.standstill)
    more = {"options": options}
    if peer not in (OURS, SEARCH):
        more = settings_of(peer, options)
    robot = declared(model, case, part, **more)
    if peer == SEARCH:
        robot = EffectDiscovery(robot, random_state=0)
    robot = fit(robot, part)
    held_out = case.held_out
    predicted = robot.predict(held_out["q"], groups=held_out["groups"])
    seconds = time.process_time() - started
    loop, robot = robot, robot.identifier_ if peer == SEARCH else robot
    effects = loop.effects_ if peer == SEARCH else ()
    told = None
    if case.gains:
        delay = robot.theta_[list(robot.parameter_names_).index("drive:delay")]
        told = delayed(case, delay)
    return Answer(
        predicted=predicted,
        told=told,
        seconds=seconds,
        consistent=_yes((robot.min_eigenvalues_ > 0).all()),
        named=names_of(effects, case.recording.joint_names),
        simulate=robot.simulate,
        follow=_followed(case, robot),
    )


def names_of(effects, joints):
    """Names of effects, each with the number of joints that have it."""
    found = [effect.name for effect in effects if effect.name != "command_delay"]
    counts = {name: found.count(name) for name in found}
    if len(joints) == 1:
        return ", ".join(counts) or "nothing"
    return ", ".join(f"{name} ({n})" for name, n in counts.items()) or "nothing"


def delayed(case, delay):
    """Torque that a drive with a delay sets on the held-out part, (n, nv)."""
    logs = logs_of(case.held_out["recording"])
    return np.concatenate([late_torque(log, case.gains, delay) for log in logs])


def logs_of(recording):
    """Return the runs of a recording of commands as logs."""
    wanted = recording.signals["q_desired"]
    return [
        Log(q=recording.q[part], v=recording.v[part], wanted=wanted[part])
        for part in recording.segments
    ]


def _followed(case, robot):
    told, drive = case.held_out.get("recording"), None
    if told is None:
        return None
    if case.gains is None:
        told, drive = servo.nominal(told), PDDrive(saturation=servo.SUPPLY)
    nv = case.recording.nv
    return lambda window: robot.follow(told, drive, window=window)[:, :nv]


def _yes(condition):
    return "yes" if condition else "no"


# -- FIGAROH ---------------------------------------------------------------------------


def figaroh_settings(case):
    """Return FIGAROH's settings of a set, made of those of the UR5."""
    text = (SCRIPTS / "figaroh_ur5.yaml").read_text(encoding="utf-8")
    head, rest = text.split("active_joints:\n")
    rest = rest[rest.index("    coupling:") :]
    names = "".join(f"        - {joint}\n" for joint in case.recording.joint_names)
    text = f"{head}active_joints:\n{names}{rest}"
    text = text.replace("125.0", f"{1 / case.recording.dt:.6g}")
    return text.replace("12.5", f"{1.5 * case.cutoff:.6g}")


def figaroh(case, part, python):
    """Answer of FIGAROH, in a process of its own."""
    recording = case.recording
    if recording.urdf is None or not str(recording.urdf).endswith(".urdf"):
        raise RuntimeError("it reads URDFs, and the set has none")
    if any(unit != "rad" for unit in recording.position_units):
        raise RuntimeError("its script is for joints that turn")
    standing = 0.02 if isinstance(case.standstill, str) else case.standstill
    text, parts = figaroh_settings(case), (part, case.held_out)
    given = python, recording.urdf, parts
    words = "10", str(standing)
    predicted, refused, seconds, kept = run_figaroh(*given, text, words)
    if refused:
        text = text.replace("select_stage: physical_fit", "select_stage: fit")
        predicted, _, seconds, _ = run_figaroh(*given, text, words)
        kept = None
    return Answer(
        predicted=predicted,
        seconds=seconds,
        consistent=_yes(not refused),
        simulate=figaroh_robot(recording, kept) if kept else None,
    )


def figaroh_robot(recording, values):
    """Return the simulation of a robot with the parameters that FIGAROH names."""
    model = recording.robot_model()
    words = "m mx my mz Ixx Ixy Iyy Ixz Iyz Izz".split()
    joints = recording.joint_names
    bodies = np.array([[values[f"{w}_{j}"] for w in words] for j in joints])
    terms = {"viscous": "fv", "coulomb": "fs", "offset": "off", "rotor_inertia": "Ia"}
    friction = {
        name: np.array([values[f"{word}_{j}"] for j in joints])
        for name, word in terms.items()
    }
    robot = torque_model(model, bodies, friction, recording.dt)
    return lambda tau, q0, v0: simulated(robot, tau, q0, v0)


# -- mujoco.sysid ----------------------------------------------------------------------


def sysid_user():
    """Return the user's script of mujoco.sysid, where that is installed."""
    if str(SCRIPTS) not in sys.path:
        sys.path.append(str(SCRIPTS))
    import mujoco_sysid_user

    if not hasattr(mujoco_sysid_user.sysid, "optimize"):
        raise RuntimeError('it needs pip install "mujoco[sysid]"')
    return mujoco_sysid_user


def sysid_by_torque(case, part):
    """Answer of mujoco.sysid: joints and bodies, by positions that torques make."""
    user, recording = sysid_user(), case.recording
    if set(recording.torque_units) - {"N m", "N"}:
        raise RuntimeError(f"bodies are in kg, and torques in {unit_of(recording)}")
    model, dt = recording.robot_model(), part["dt"]
    motion = StateEstimator(dt).fit_transform(part["q"], groups=part["groups"])
    q, v, a = np.split(motion, 3, axis=1)
    started = time.process_time()
    largest = part["tau"].std(axis=0)
    most = {
        "armature": largest / a.std(axis=0),
        "damping": largest / v.std(axis=0),
        "frictionloss": largest,
        "bias": 2 * largest,
    }
    # Of very fast logs every fifth, say, is enough.
    every = max(1, int(LONGEST_STEP / dt))
    step = every * dt / max(1, int(np.ceil(every * dt / LONGEST_STEP)))
    runs = []
    for rows in stretches(part, round(LENGTH / dt), RUNS):
        rows = rows[::every]
        t = dt * every * np.arange(len(rows))
        runs.append((t, part["tau"][rows], q[rows], v[rows[0]]))
    terms = np.zeros((model.nv, 4))
    numbers = numbers_of(model, terms, 0.0, vectors(model))
    # Points and rods become bodies: these inertias have to be some body's.
    bodies = numbers.bodies.copy()
    bodies[:, (4, 6, 9)] += THICKNESS**2 * bodies[:, :1]
    numbers = replace(numbers, bodies=bodies, coulomb=0.1 * largest)
    with contextlib.redirect_stdout(io.StringIO()):
        found, values = user.identify(
            mjcf(model, numbers, step=step),
            runs,
            most,
            bodies=True,
            delay=None,
            iterations=ITERATIONS,
        )
    armature, viscous, coulomb, offset = friction_of(found, values).values()
    friction = dict(zip(PLAIN, (viscous, coulomb, offset, armature)))
    bodies = user.dynamic_parameters(found)
    robot = torque_model(model, bodies, friction, dt)
    predicted = torques_of_model(robot, case)
    return Answer(
        predicted=predicted,
        seconds=time.process_time() - started,
        consistent=_yes(is_physical(bodies)),
        simulate=lambda tau, q0, v0: simulated(robot, tau, q0, v0),
    )


def friction_of(model, values):
    """Armature, damping, Coulomb friction, offset, each (nv,), of what was fitted."""
    joints = [model.joint(j).name for j in range(model.njnt)]
    return {
        "armature": model.dof_armature.copy(),
        "damping": model.dof_damping.reshape(model.nv, -1)[:, 0].copy(),
        "coulomb": model.dof_frictionloss.copy(),
        # The actuator adds it, and the joint's torque lacks it.
        "offset": np.array([-values[f"{joint} bias"].value[0] for joint in joints]),
    }


def unit_of(recording):
    """Name the unit of the torques of a set."""
    return ", ".join(dict.fromkeys(recording.torque_units))


def stretches(part, length, number):
    """Rows of stretches of a length, evenly over a part: at most so many."""
    found = []
    for rows in recordings(part):
        found += [rows[k : k + length] for k in range(0, len(rows) - length, length)]
    chosen = np.unique(np.linspace(0, len(found) - 1, number).astype(int))
    return [found[k] for k in chosen]


def torque_model(model, bodies, friction, dt):
    """Return a robot with bodies (nv, 10) and coefficients (nv,) of the plain terms."""
    from sklearn_vbjfa.simulation import TorqueModel

    return TorqueModel(
        model=model,
        bodies=bodies,
        friction_names=tuple(friction),
        friction=np.transpose(list(friction.values())),
        effects=(),
        coefficients=(),
        gains=np.ones(model.nv),
        dt=dt,
    )


def simulated(robot, tau, q0, v0):
    """States (n, 3 nv) of a `TorqueModel`."""
    from sklearn_vbjfa.simulation import simulate

    return np.asarray(simulate(robot, tau, q0, v0, None))


def torques_of_model(robot, case):
    """Torques (n, nv) of a `TorqueModel` on the held-out part."""
    q, v, a = np.split(held_out_states(case), 3, axis=1)
    columns = (v, np.sign(v), np.ones_like(v), a)
    columns = dict(zip(PLAIN, columns, strict=True))
    model = robot.model.copy()
    for k, values in enumerate(robot.bodies):
        model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(values)
    terms = zip(robot.friction_names, robot.friction.T)
    friction = sum(columns[name] * values for name, values in terms)
    return inverse_dynamics(model, q, v, a) + friction


def held_out_states(case):
    """States (n, 3 nv) of the held-out part, smoothed as the fitted one asks for."""
    smoother = StateEstimator(case.fitted["dt"])
    smoother.fit(case.fitted["q"], groups=case.fitted["groups"])
    return smoother.transform(case.held_out["q"], groups=case.held_out["groups"])


# -- by simulation from commands -------------------------------------------------------


def by_commands(case, part, peer):
    """Answers of CMA-ES or mujoco.sysid on the Go2: of two runs together, and of each.

    The first and the last run of the part are fitted alone, as each takes minutes; the
    first answer has the means of both.
    """
    described, gains = case.recording.robot_model(), case.gains
    logs, found, seconds = logs_of(part["recording"]), [], []
    for log in (logs[0], logs[-1]):
        started = time.process_time()
        if peer == CMA:
            budget = {"population": POPULATION, "generations": GENERATIONS}
            found.append(evolution(described, gains, log, **budget))
        else:
            found.append(sysid_by_commands(described, gains, log))
        seconds.append(time.process_time() - started)
    robots = [commands.mean_of(found), *found]
    times = [sum(seconds), *seconds]
    return [
        Answer(
            predicted=np.concatenate(
                [
                    commands.torques(one.numbers, described, states(log.q))
                    for log in logs_of(case.held_out["recording"])
                ]
            ),
            told=delayed(case, one.numbers.delay),
            seconds=time_taken,
            consistent=_yes(is_physical(one.numbers.bodies)),
            follow=_in_loop(case, described, one.numbers),
        )
        for one, time_taken in zip(robots, times)
    ]


def _in_loop(case, described, numbers):
    """Return what gives positions of windows by MuJoCo, from commands alone."""

    def follow(window):
        floor = {name: np.maximum(getattr(numbers, name), 1e-5) for name in VALUES}
        robot = replace(numbers, **floor)
        loop = ClosedLoop(described, case.gains, numbers.bodies)
        length, pieces = round(window / DT), []
        for log in logs_of(case.held_out["recording"]):
            n = len(log.q)
            out = np.full((n, described.nv), np.nan)
            starts = range(0, n - length + 1, length)
            out[: len(starts) * length] = np.concatenate(
                loop.positions([robot], log, starts, length)[0]
            )
            pieces.append(out)
        return np.concatenate(pieces)

    return follow


def sysid_by_commands(described, gains, log):
    """Fit joints and delay to one run with mujoco.sysid, the bodies as described."""
    user, nv = sysid_user(), described.nv
    numbers = numbers_of(described, np.zeros((nv, 4)), 0.0, vectors(described))
    numbers = replace(numbers, coulomb=np.full(nv, 0.1))
    words = "armature", "damping", "frictionloss"
    most = {word: np.full(nv, limit) for word, limit in zip(words, HIGHEST)}
    most["bias"] = np.full(nv, LARGEST_BIAS)
    with contextlib.redirect_stdout(io.StringIO()):
        found, values = user.identify(
            mjcf(described, numbers, gains, SLOW_STEP),
            [(DT * np.arange(len(log.q)), log.wanted, log.q, log.v[0])],
            most,
            bodies=False,
            delay=LATEST,
            iterations=ITERATIONS,
        )
    terms = np.transpose(list(friction_of(found, values).values()))
    delay = values["delay"].value[0]
    return Found(numbers=numbers_of(described, terms, delay, vectors(described)))


def servo_by_commands(case, part):
    """Answer of CMA-ES on the servo: the model M1 of BAM, from its goals."""
    fitted, held_out = part["recording"], case.held_out["recording"]
    smoother = StateEstimator(part["dt"])
    smoother.fit(case.fitted["q"], groups=case.fitted["groups"])
    own = smoother.transform(part["q"], groups=part["groups"])
    started = time.process_time()
    p = servo.fitted(fitted, own, EVALUATIONS)
    seconds = time.process_time() - started
    later = held_out_states(case)
    return Answer(
        predicted=servo.voltage(p, *later.T)[:, None],
        seconds=seconds,
        consistent="yes",
        follow=lambda window: servo.swung(p, held_out, later, window)[:, None],
    )


# -- all of them -----------------------------------------------------------------------


def answer(case, part, peer, python=None):
    """Answer of a peer that was fitted to a part."""
    if peer == FIGAROH:
        return figaroh(case, part, python)
    if peer == SYSID:
        return sysid_by_torque(case, part)
    if peer == CMA:
        if case.name != SERVO:
            raise RuntimeError("the set has no commands with known gains")
        return servo_by_commands(case, part)
    return identified(case, part, peer)
