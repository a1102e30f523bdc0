"""Time of a simulation over the time that it simulates, and of one predicted state.

Run as ``python tests/benchmarks/bench_simulation_speed.py``. The arm that comes with
the package, six joints, is simulated at 1 kHz along ten seconds of motion: in windows
of a second, started on the motion, and in one go; with viscous and Coulomb friction,
and with five more effects; with Numba, and in a process that cannot import it. Below,
`step` of an identified robot of seven joints that was saved and loaded.
"""

import json
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from _report import parser, publish, rst_table
from _simulated_models import simulated, torque_model, torques
from threadpoolctl import threadpool_limits

SEED = 0
PERIOD, SECONDS, WINDOW = 0.001, 10.0, 1.0  # s
ROUNDS = 3
# Times real time that were asked for, with and without Numba.
ASKED = {True: 20.0, False: 5.0}
# Microseconds for a state that were asked for: with friction, with all effects.
STEPS = {"viscous and Coulomb friction": 20.0, "with all effects": 100.0}
FRICTION, FIVE = "viscous and Coulomb friction", "with five more effects"
_HERE = Path(__file__).resolve().parent
_WITHOUT = """
import json, sys
sys.modules["numba"] = None
sys.path.insert(0, {folder!r})
import bench_simulation_speed as bench
print(json.dumps(bench.measure({seconds}, {rounds})))
"""


def five_effects(size):
    """Five effects with their coefficients, of arms with torques of a `size` (6,)."""
    from sklearn_vbjfa import effects

    return {
        effects.LoadFriction(joint=1): (0.08,),
        effects.Stribeck(joint=0, vs=0.1): (0.1 * size[0],),
        effects.Presliding(joint=3, displacement=0.01): (0.1 * size[3],),
        effects.Coupling(joint=4, other=5): (0.02, 0.05 * size[4], 0.001),
        effects.Ripple(joint=2, period=0.2): (0.05 * size[2], 0.02 * size[2]),
    }


def robots(seconds=SECONDS, dt=PERIOD):
    """Return label -> robot, and the motion (n, 18) that it makes."""
    from sklearn_vbjfa.datasets import make_robot_recording

    recording = make_robot_recording(
        duration=seconds + dt, dt=dt, encoder_noise=0.0, random_state=SEED
    )
    model = recording.robot_model()
    plain = {
        "bodies": recording.inertial,
        "friction": recording.friction,
        "dt": dt,
    }
    size = recording.tau_clean.std(axis=0)
    return {
        FRICTION: torque_model(model, **plain),
        FIVE: torque_model(model, effects=five_effects(size), **plain),
    }, recording.states


def measure(seconds=SECONDS, rounds=ROUNDS):
    """Time the simulations, by the processor: other processes do not count.

    Parameters
    ----------
    seconds : float
        Length of the motion [s].
    rounds : int
        Rounds, after a first one that compiles.

    Returns
    -------
    dict
        Label -> seconds of motion for one of computing, ``windows`` and ``whole``, and
        the largest error at the end of a window, ``error`` [rad]; or ``message``.
    """
    found = {}
    made, motion = robots(seconds)
    for label, robot in made.items():
        q, v, a = np.split(motion, 3, axis=1)
        try:
            with threadpool_limits(1), warnings.catch_warnings():
                # The whole motion may leave the limits: nothing holds it to its path.
                warnings.simplefilter("ignore", UserWarning)
                found[label] = _timed(robot, (q, v, a), rounds)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            found[label] = {"message": f"{type(error).__name__}: {error}"}
    return found


def _timed(robot, motion, rounds):
    q, v, _ = motion
    length = round(WINDOW / robot.dt)
    cut = [
        slice(first, first + length + 1) for first in range(0, len(q) - length, length)
    ]
    tau = torques(robot, *motion)
    # A bristle remembers the motion before a window, which a simulation does not know.
    own = [torques(robot, *(x[rows] for x in motion)) for rows in cut]
    times = {"windows": [], "whole": []}
    for _ in range(rounds + 1):
        error, started = 0.0, time.process_time()
        for rows, torque in zip(cut, own):
            states = simulated(robot, torque, q[rows][0], v[rows][0])
            missed = np.abs(states[-1, : q.shape[1]] - q[rows][-1])
            error = max(error, float(missed.max()))
        times["windows"].append(time.process_time() - started)
        started = time.process_time()
        simulated(robot, tau, q[0], v[0])
        times["whole"].append(time.process_time() - started)
    moved = {"windows": WINDOW * len(cut), "whole": robot.dt * (len(q) - 1)}
    # the first round compiles
    fast = {key: moved[key] / np.median(times[key][1:]) for key in times}
    return {**fast, "error": error}


def measure_without(seconds=SECONDS, rounds=ROUNDS):
    """Call `measure` in a process that cannot import Numba."""
    code = _WITHOUT.format(folder=str(_HERE), seconds=seconds, rounds=rounds)
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return json.loads(answer.stdout.splitlines()[-1])


HEADERS = [
    "robot",
    "Numba",
    "times real time, windows",
    "in one go",
    "asked",
    "met",
    "error after 1 s [mrad]",
]


def rows_of(found, numba):
    """Rows of the table, of what `measure` returned."""
    asked = ASKED[numba]
    rows = []
    for label, figures in found.items():
        start = [label, "yes" if numba else "no"]
        if "message" in figures:
            rows.append([*start, figures["message"].splitlines()[0], *["–"] * 4])
            continue
        slowest = min(figures["windows"], figures["whole"])
        rows.append(
            [
                *start,
                f"{figures['windows']:.1f}",
                f"{figures['whole']:.1f}",
                f"{asked:g}",
                "yes" if slowest >= asked else "no",
                f"{1e3 * figures['error']:.2g}",
            ]
        )
    return rows


# -- one state at a time ---------------------------------------------------------------


def every_effect(nv):
    """One effect of each kind that needs no recorded signal, joint after joint."""
    from sklearn_vbjfa.effects import Shaped, resolve

    found, fixed_joints = [], {"base_tilt": 0, "payload": nv - 1}
    for effect in resolve("all"):
        if effect.name in ("viscous", "coulomb") or "signals" in effect.needs:
            continue
        # a tilt is the robot's, a payload is carried by the last body
        joint = fixed_joints.get(effect.name, len(found) % nv)
        names = effect.partners if isinstance(effect, Shaped) else ()
        partners = dict.fromkeys(names, (joint + 1) % nv)
        found.append(type(effect)(joint=joint).set_params(**partners))
    return found


def saved(label, folder, seconds=4.0, dt=0.002):
    """Identify the head, save it, and return the loaded robot and its motion (n, 21).

    Parameters
    ----------
    label : str
        Of `STEPS`.
    folder : str
        Where to save it.
    seconds, dt : float
        Length of the motion and sample period [s].
    """
    from _paper_robots import load_paper_robot

    from sklearn_vbjfa import RobotIdentifier, load_identified
    from sklearn_vbjfa.datasets import make_robot_recording

    model = load_paper_robot("head")
    recording = make_robot_recording(
        model, duration=seconds, dt=dt, encoder_noise=0.0, random_state=SEED
    )
    own = every_effect(model.nv) if label == "with all effects" else ()
    identifier = RobotIdentifier(
        model, dt=dt, friction=("viscous", "coulomb"), effects=own
    )
    identifier.fit(recording.states, recording.tau)
    path = Path(folder, "head.json")
    identifier.save(path)
    return load_identified(path), recording.states


def time_steps(robot, motion, rounds=ROUNDS):
    """Microseconds that `step` takes for a state, the median of rounds."""
    nv = motion.shape[1] // 3
    q, v, a = (np.ascontiguousarray(x) for x in np.split(motion, 3, axis=1))
    t = robot.dt * np.arange(len(q))
    taken = []
    for _ in range(rounds + 1):
        robot.reset()
        started = time.process_time()
        for row in zip(q, v, a, t):
            torque = robot.step(*row)
        taken.append((time.process_time() - started) / len(q))
    if np.shape(torque) != (nv,):
        raise ValueError(f"step returned the shape {np.shape(torque)}, not ({nv},).")
    # the first round compiles
    return 1e6 * np.median(taken[1:])


STEP_HEADERS = ["robot", "us/state", "asked", "met", "effects left out"]


def step_rows(rounds=ROUNDS):
    """Rows of the table of single states; none where robots do not step."""
    import sklearn_vbjfa

    if not hasattr(getattr(sklearn_vbjfa, "IdentifiedRobot", None), "step"):
        return []
    rows = []
    for label, asked in STEPS.items():
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                robot, motion = saved(label, folder)
                taken = time_steps(robot, motion, rounds)
            except (ValueError, ArithmeticError, RuntimeError) as error:
                message = f"{type(error).__name__}: {error}".splitlines()[0]
                rows.append([label, "–", f"{asked:g}", "no", message])
                continue
        left = ", ".join(getattr(e, "name", str(e)) for e in robot.left_out_)
        met = "yes" if taken <= asked else "no"
        rows.append([label, f"{taken:.1f}", f"{asked:g}", met, left or "none"])
    return rows


def report(seconds=SECONDS, rounds=ROUNDS, without=True):
    """Text with the tables."""
    rows = rows_of(measure(seconds, rounds), numba=True)
    if without:
        rows += rows_of(measure_without(seconds, rounds), numba=False)
    parts = [
        rst_table(rows, HEADERS, n_labels=2),
        f"Six joints at {1 / PERIOD:g} Hz, {seconds:g} s of motion, seed {SEED}, on "
        f"one core; processor time, medians of {rounds} rounds after one that "
        "compiles. Torques are those of the motion; the error is that of the positions "
        "at the end of a window, the largest. Met counts the slower of both.",
    ]
    steps = step_rows(rounds)
    if steps:
        parts += [
            rst_table(steps, STEP_HEADERS),
            "Seven joints, identified, saved and loaded; microseconds for a state.",
        ]
    return "\n\n".join(parts)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--rounds", type=int, default=ROUNDS)
    arguments.add_argument("--seconds", type=float, default=SECONDS)
    arguments = arguments.parse_args(argv)
    text = report(arguments.seconds, arguments.rounds)
    publish("simulation_speed", text, write=arguments.write)


if __name__ == "__main__":
    main()
