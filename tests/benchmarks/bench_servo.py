"""A position servo by its drive, beside BAM's friction models M1 to M6.

Run ``python tests/benchmarks/bench_servo.py --data-home DIR [--write]`` (CMA-ES:
``pip install cma``).

Data: `fetch_bam_xl330`, a Dynamixel XL330-M288-T that swings a load of 0.49 kg at
0.10 m, four trajectories at each of three firmware gains (100, 400, 800). Pairs: each
gain is left out, fitted are the two others.

The servo's law is its firmware's: duty cycle = 4096 / (2 pi 256 885) kp (goal - q),
within one, and its voltage is that times the supply. So kp [V/rad] is known, and
"torques" are volts, R / kt times those in N m; bodies are free for that reason.

- package: `RobotIdentifier` with ``PDDrive``, goals and gains in, a delay found, four
  plain terms; samples at full duty, which the law does not tell, count nothing.
- package, duty: the same on the logged duty cycle times the supply (`VoltageDrive`).
- package, completed: `EffectDiscovery` of the first, which names what is missing.
- package, load and Stribeck: the same terms that M4 has, declared.
- M1 to M6, published: the parameters that BAM's authors give for this servo, found on
  all logs of it, those that are judged here included (`_servo_models.py`).
- M1, M6, fitted: the same forms, fitted as BAM does, by CMA-ES on simulated positions
  of the fitted recordings.

Judged, for all alike:

- volts: voltages along the measured motion beside duty times supply as logged, behind
  12 Hz, where the joint moves, over their spread. States are those of the package.
- whole: mean absolute error of positions simulated from the goals of a recording
  alone (BAM's measure) [mrad].
- windows: root mean square of positions simulated from the goals of one second, from
  the measured state at its begin [mrad].

Simulations know a supply of 7.4 V, its nominal value, and not its sag, for all.
"""

import importlib.util
import time
import warnings
from dataclasses import replace

import joblib
import numpy as np
from _report import fixed, parser, publish, rst_table
from _servo_models import DUTY, PUBLISHED, fitted, swing, voltage
from scipy import signal

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import fetch_bam_xl330
from sklearn_vbjfa.effects import LoadFriction, Stribeck
from sklearn_vbjfa.robot import PDDrive, VoltageDrive

SUPPLY, CUTOFF, WINDOW, SLOWEST = 7.4, 12.0, 1.0, 0.05
GAINS = (100, 400, 800)
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
EVALUATIONS = {"M1": 4000, "M6": 12000}
STEPS = 6  # of the physics of BAM's models in a row


def prepared(recording):
    """Return the recording as one of goals and gains, and of voltages beside."""
    signals = recording.signals
    volts = signals["duty"] * signals["supply_volts"]
    full = np.abs(DUTY * signals["kp"] * (signals["q_ref"] - recording.q)[:, 0]) >= 1
    return replace(
        recording,
        v=None,
        tau=volts[:, None],
        weight=np.where(full, 0.0, 1.0)[:, None],
        signals={
            "q_desired": signals["q_ref"],
            "kp": (DUTY * signals["kp"] * signals["supply_volts"])[:, None],
            "kd": np.zeros((recording.n_samples, 1)),
            "firmware": signals["kp"],
        },
    )


def split(recording, gain):
    """Fitted and judged recordings of a left-out gain."""
    names = recording.group_names
    left = [k for k, name in enumerate(names) if name.startswith(f"kp{gain}_")]
    kept = [k for k in range(len(names)) if k not in left]
    return chosen(recording, kept), chosen(recording, left)


def chosen(recording, runs):
    """Return some recordings as one."""
    rows = np.concatenate([np.flatnonzero(recording.groups == k) for k in runs])
    number = {k: at for at, k in enumerate(runs)}
    return replace(
        recording,
        q=recording.q[rows],
        tau=recording.tau[rows],
        t=recording.t[rows],
        weight=recording.weight[rows],
        groups=np.array([number[k] for k in recording.groups[rows]]),
        group_names=tuple(recording.group_names[k] for k in runs),
        signals={name: x[rows] for name, x in recording.signals.items()},
    )


# -- the ways --------------------------------------------------------------------------


def identifier(recording, drive, effects=()):
    """Return an identifier of the servo."""
    return RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=PLAIN,
        effects=effects,
        bodies="free",
        cutoff=CUTOFF,
        drive=drive,
    )


def by_commands(recording):
    """Fit to goals and gains."""
    return identifier(recording, PDDrive()).fit_recording(recording), ""


def by_duty(recording):
    """Fit to voltages."""
    told = replace(
        recording, weight=None, signals={"voltage": recording.tau}, command=None
    )
    return identifier(recording, VoltageDrive()).fit_recording(told), ""


def completed(recording):
    """Find what is missing, and name it."""
    loop = EffectDiscovery(identifier(recording, PDDrive()), random_state=0)
    loop.fit_recording(recording)
    names = [effect.name for effect in loop.identifier_.effects_]
    return loop.identifier_, ", ".join(x for x in names if x != "command_delay")


def declared(recording):
    """Fit with friction that depends on load and speed."""
    effects = [LoadFriction(), Stribeck(vs=0.12)]
    return identifier(recording, PDDrive(), effects).fit_recording(recording), ""


PACKAGE = {
    "package": by_commands,
    "package, duty": by_duty,
    "package, completed": completed,
    "package, load and Stribeck": declared,
}


# -- the judgement ---------------------------------------------------------------------


def nominal(recording):
    """Return the recording at the nominal supply."""
    kp = DUTY * recording.signals["firmware"] * SUPPLY
    return replace(recording, signals={**recording.signals, "kp": kp[:, None]})


def windows_of(part, dt, window):
    """Rows of the windows of a recording, so many seconds each."""
    length = round(window / dt)
    return [
        slice(first, min(first + length, part.stop))
        for first in range(part.start, part.stop, length)
    ]


def behind(x, dt):
    """Low-pass of a signal (n,)."""
    sos = signal.butter(4, CUTOFF, fs=1 / dt, output="sos")
    return signal.sosfiltfilt(sos, x)


def volts_missed(said, recording, states):
    """Squares missed and squares of the spread, over all rows that count."""
    missed, spread = [], []
    for part in recording.segments:
        moving = np.abs(states[part, 1]) > SLOWEST
        true = behind(recording.tau[part, 0], recording.dt)
        missed.append((behind(said[part], recording.dt) - true)[moving])
        spread.append(true[moving])
    return float(
        np.sqrt(np.mean(np.concatenate(missed) ** 2)) / np.concatenate(spread).std()
    )


def judge(said, whole, windows, recording, states):
    """Three figures: volts [%], whole [mrad], windows [mrad]."""
    q = recording.q[:, 0]
    return (
        100 * volts_missed(said, recording, states),
        1e3
        * np.mean(
            [np.abs(whole[part] - q[part]).mean() for part in recording.segments]
        ),
        1e3 * np.sqrt(np.mean((windows - q) ** 2)),
    )


def judge_package(robot, recording, states):
    """Figures of an identified servo."""
    drive = PDDrive(saturation=SUPPLY)
    told = nominal(recording)
    whole, windows = (
        robot.follow(told, drive, window=window)[:, 0] for window in (None, WINDOW)
    )
    said = robot.predict(states, groups=recording.groups)[:, 0]
    return judge(said, whole, windows, recording, states)


def swung(p, recording, states, window=None):
    """Positions (n,) of one of BAM's models from its goals, whole or in windows [s]."""
    found, dt = np.empty(recording.n_samples), recording.dt
    goal, gain = recording.signals["q_desired"][:, 0], recording.signals["firmware"]
    for part in recording.segments:
        for rows in [part] if window is None else windows_of(part, dt, window):
            q0, v0 = states[rows.start, :2]
            known = gain[rows.start], SUPPLY, q0, v0, dt, STEPS
            found[rows] = swing(p, goal[rows], *known)
    return found


def judge_model(p, recording, states):
    """Figures of one of BAM's models."""
    whole, windows = (swung(p, recording, states, x) for x in (None, WINDOW))
    return judge(voltage(p, *states.T), whole, windows, recording, states)


def told_to(recording, states):
    """Return recordings as `fitted` takes them."""
    goal, gain = recording.signals["q_desired"][:, 0], recording.signals["firmware"]
    return [
        (
            goal[part],
            gain[part.start],
            SUPPLY,
            recording.q[part, 0],
            states[part.start, 1],
        )
        for part in recording.segments
    ]


def rows_of(recording, gain, ways):
    """Figures of all ways where a gain is left out, and what was found."""
    fitted_to, judged = split(recording, gain)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain, _ = by_commands(fitted_to)
        states, own = (
            plain.robot_.query(one.inputs, one.groups)[0] for one in (judged, fitted_to)
        )
        results, named = {}, ""
        for label in ways:
            started = time.process_time()
            if label in PACKAGE:
                robot, names = PACKAGE[label](fitted_to)
                seconds = time.process_time() - started
                found = judge_package(robot, judged, states)
                if names:
                    named = f"gain {gain} left out: {names}"
            else:
                name, kind = label.split(", ")
                p = PUBLISHED[name]
                if kind == "fitted":
                    known = told_to(fitted_to, own), fitted_to.dt
                    p = fitted(name, *known, evaluations=EVALUATIONS[name])
                seconds = time.process_time() - started
                found = judge_model(p, judged, states)
            results[label] = (*found, seconds)
            print(gain, label, *np.round(found, 1), f"{seconds:.1f} s", flush=True)
    return results, named


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None)
    arguments.add_argument("--ways", nargs="+", default=None)
    arguments.add_argument("--jobs", type=int, default=1)
    arguments = arguments.parse_args(argv)
    ways = [*PACKAGE, *(f"{name}, published" for name in PUBLISHED)]
    if importlib.util.find_spec("cma"):
        ways += [f"{name}, fitted" for name in EVALUATIONS]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recording = prepared(fetch_bam_xl330(data_home=arguments.data_home))
    ways = arguments.ways or ways
    done = joblib.Parallel(n_jobs=arguments.jobs)(
        joblib.delayed(rows_of)(recording, gain, ways) for gain in GAINS
    )
    named, rows = [names for _, names in done if names], []
    for label in ways:
        volts, whole, windows, seconds = np.array([one[label] for one, _ in done]).T
        cells = [*volts, volts.mean(), *whole, whole.mean(), *windows, windows.mean()]
        usual = "–" if label.endswith("published") else fixed([seconds.mean()], 1)[0]
        rows.append([label, *fixed(cells, 1), usual])
    heads = ["way"]
    for what in ("volts [%]", "whole [mrad]", "windows [mrad]"):
        heads += [*(f"{what}, gain {gain}" for gain in GAINS), f"{what}, mean"]
    text = rst_table(rows, [*heads, "fit [s]"])
    if named:
        text += "\n\nNamed: " + "; ".join(named) + "."
    publish("servo", text, write=arguments.write)


if __name__ == "__main__":
    main()
