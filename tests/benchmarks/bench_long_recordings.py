"""How time and memory of the loop grow with the length of a recording and the joints.

Run ``python tests/benchmarks/bench_long_recordings.py [--cases NAME ...] [--quick]
[--out FILE] [--write]``.

Data, simulated without the code of the library (``_undeclared_robots.py``), seed 0:

- ``7 joints``: a random serial arm in one motion (five sines in each joint, 0.1 to
  1 Hz) of 1, 3, 10 and 30 minutes at 1 kHz. Every joint has viscous and Coulomb
  friction, which are declared, and torque noise of 10 % of its spread; joint 3 also has
  a Stribeck friction of 15 % of its torque, which is not declared.
- ``3 joints`` to ``23 joints``: arms of up to seven joints on one base (23: three arms
  and a pair), 165,014 rows at 1 kHz, the same friction and noise.

``EffectDiscovery.fit`` with all its effects and its defaults, fits in two threads
(``n_jobs=2``), and the report's text, each in a process of its own; the data are made
in another one and read from a file, so that the peak memory (``ru_maxrss``) is that of
reading, the loop and the report.
Exponents are slopes of logarithms, from 3 minutes or 7 joints on.
Targets: 30 minutes in 120 s with 2 GB and the right name; 23 joints in 60 s.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from _report import Ledger, parser, publish, rst_table
from _undeclared_robots import Motion, inverse_dynamics, nominal_robot, true_robot

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

DT = 0.001
SEED = 0
NOISE, FRICTION, UNDECLARED = 0.1, 0.15, 0.15
JOINT = 2
STRIBECK = 0.05
# Rows of which a robot's torques are made at once.
CHUNK = 50_000
MINUTES = (1, 3, 10, 30)
ARMS = ((3,), (7,), (7, 7), (7, 7, 7, 2))
MANY_ROWS = 165_014
# What grows, by the names of the cases.
LENGTHS = {f"7 joints, {m} min": m for m in MINUTES}
JOINTS = {f"{sum(arms)} joints": sum(arms) for arms in ARMS}
CASES = {name: ((7,), m * 60_000) for name, m in LENGTHS.items()}
CASES |= {name: (arms, MANY_ROWS) for name, arms in zip(JOINTS, ARMS, strict=True)}
QUICK = {"2 joints, 40 s": ((2,), 40_000), "4 joints, 40 s": ((2, 2), 40_000)}
TARGETS = {"7 joints, 30 min": (120.0, 2.0), "23 joints": (60.0, np.inf)}


def robot(arms):
    """Return serial arms of so many joints each on one base."""
    import pinocchio as pin

    rng, model = np.random.default_rng(SEED), pin.Model()
    for k, joints in enumerate(arms):
        arm = nominal_robot("serial", rng, joints)
        last = 0
        for i in range(1, arm.njoints):
            name = f"arm_{k}_{arm.names[i]}"
            last = model.addJoint(last, arm.joints[i], arm.jointPlacements[i], name)
            inertia = arm.inertias[i]
            model.appendBodyToJoint(last, inertia, pin.SE3.Identity())
    return model


def recording(arms, rows, first=0):
    """Positions and torques of the arms, (rows, nv) each, from a row of the motion."""
    rng, nominal = np.random.default_rng(SEED), robot(arms)
    model, nv = true_robot(nominal, rng), nominal.nv
    joint = min(JOINT, nv - 1)
    frequency = rng.uniform(0.1, 1.0, size=(nv, 5))
    amplitude = 0.1 / frequency * rng.uniform(0.5, 1.0, size=(nv, 5))
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(nv, 5))
    motion = Motion(rng.uniform(-1, 1, size=nv), amplitude, frequency, phase)
    q, tau = np.empty((2, rows, nv))
    at, v, a = motion.at(DT * np.arange(min(CHUNK, rows)))
    spread, fast = inverse_dynamics(model, at, v, a).std(axis=0), v.std(axis=0)
    if first:
        rng = np.random.default_rng((SEED, first))
    for begin in range(0, rows, CHUNK):
        some = slice(begin, min(begin + CHUNK, rows))
        q[some], v, a = motion.at(DT * np.arange(first + some.start, first + some.stop))
        own = inverse_dynamics(model, q[some], v, a)
        own += FRICTION * spread * (v / fast + np.tanh(v / 0.002))
        slow = np.exp(-np.abs(v[:, joint]) / (STRIBECK * fast[joint]))
        own[:, joint] += UNDECLARED * spread[joint] * np.sign(v[:, joint]) * slow
        tau[some] = own + NOISE * spread * rng.normal(size=own.shape)
        q[some] += 1e-5 * rng.normal(size=own.shape)
    return q, tau


def peak_gigabytes():
    """Peak memory of this process so far [GB, 1e9 bytes]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # 1024 bytes each, but on macOS bytes.
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e9


def make(arms, rows, path):
    """Write a file."""
    q, tau = recording(arms, rows)
    np.savez(path, q=q, tau=tau)


def run_here(arms, path):
    """Figures of the loop on a file, in this process."""
    started, used = time.perf_counter(), time.process_time()
    declared = {"friction": ("viscous", "coulomb"), "n_jobs": 2}
    identifier = RobotIdentifier(robot(arms), dt=DT, **declared)
    loop = EffectDiscovery(identifier, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with np.load(path) as file:
            loop.fit(file["q"], file["tau"])
    text = str(loop.report_)
    return {
        "seconds": time.perf_counter() - started,
        "processor": time.process_time() - used,
        "gigabytes": peak_gigabytes(),
        "named": [[e.name, int(e.joint)] for e in loop.effects_],
        "error": [
            float(np.mean(loop.error_before_)),
            float(np.mean(loop.error_after_)),
        ],
        "lines": text.count("\n"),
    }


def measure(name, arms, rows, folder):
    """Figures of the loop in a process of its own, the data made in another one."""
    path = Path(folder, "recording.npz")
    given = {"arms": arms, "rows": rows, "path": str(path)}
    given = json.dumps(given)
    for what in ("--make", "--run"):
        command = [sys.executable, __file__, what, given]
        environment = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment = {**environment, **os.environ}
        answer = subprocess.run(
            command, capture_output=True, text=True, env=environment
        )
        if answer.returncode:
            raise RuntimeError(f"{name} failed:\n{answer.stderr}")
    return json.loads(answer.stdout.splitlines()[-1])


def exponents(found, sizes):
    """Exponents of seconds and gigabytes against sizes but the smallest, or nan."""
    names = [name for name in sorted(sizes, key=sizes.get)[1:] if name in found]
    if len(names) < 2:
        return np.nan, np.nan
    size = np.log([sizes[name] for name in names])
    figures = (np.log([found[name][of] for name in names]) for of in FIGURES)
    return tuple(float(np.polyfit(size, y, 1)[0]) for y in figures)


def growth(found):
    """Sentences on how time and memory grow, those of which there are figures."""
    of = {
        "length, seven joints, from 3 minutes on": LENGTHS,
        "joints, from 7 on": JOINTS,
    }
    powers = {words: exponents(found, sizes) for words, sizes in of.items()}
    return [
        f"With the {words}: time to the power of {seconds:.2f}, memory to the power of "
        f"{memory:.2f}."
        for words, (seconds, memory) in powers.items()
        if np.isfinite(seconds)
    ]


FIGURES = ("seconds", "gigabytes")
HEADERS = ["recording", "rows", "time [s]", "processor time", "memory [GB]"]
HEADERS += ["named", "mean before [%]", "mean after", "target"]


def row(name, rows, figures):
    """Row of the table."""
    named = ", ".join(f"{effect} {joint + 1}" for effect, joint in figures["named"])
    seconds, memory = TARGETS.get(name, (np.nan, np.nan))
    target = [] if np.isnan(seconds) else [f"{seconds:.0f} s"]
    target += [f"{memory:.0f} GB"] if np.isfinite(memory) else []
    return [
        name,
        rows,
        f"{figures['seconds']:.0f}",
        f"{figures['processor']:.0f}",
        f"{figures['gigabytes']:.2f}",
        named or "nothing",
        *(f"{100 * error:.1f}" for error in figures["error"]),
        ", ".join(target),
    ]


def report(cases, chosen, ledger):
    """Table of the cases that a ledger has, the chosen ones run if it lacks them."""
    for task in ledger.missing([{"case": name} for name in chosen]):
        arms, n = cases[task["case"]]
        with tempfile.TemporaryDirectory() as folder:
            ledger.add(task | measure(task["case"], arms, n, folder))
        print(json.dumps(ledger.results[-1]), file=sys.stderr, flush=True)
    found = {one["case"]: one for one in ledger.of([{"case": name} for name in cases])}
    rows = [row(name, cases[name][1], figures) for name, figures in found.items()]
    return "\n\n".join([rst_table(rows, HEADERS), *growth(found)])


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, out=True)
    arguments.add_argument("--cases", nargs="+", help="names of the table")
    # what the script starts itself with
    arguments.add_argument("--make", help=argparse.SUPPRESS)
    arguments.add_argument("--run", help=argparse.SUPPRESS)
    arguments = arguments.parse_args(argv)
    if arguments.make:
        make(**json.loads(arguments.make))
        return
    if arguments.run:
        given = json.loads(arguments.run)
        print(json.dumps(run_here(given["arms"], given["path"])))
        return
    cases = QUICK if arguments.quick else CASES
    ledger = Ledger(arguments.out, ("case",))
    text = report(cases, arguments.cases or list(cases), ledger)
    publish("long_recordings", text, arguments, commits=ledger.commits())


if __name__ == "__main__":
    main()
