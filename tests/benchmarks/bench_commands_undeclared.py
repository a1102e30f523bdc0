"""Simulated Go2s with a friction that nobody declared: CMA-ES, drive, and its search.

Run ``python tests/benchmarks/bench_commands_undeclared.py --out FILE --data-home DIR
[--seeds FIRST LAST] [--ways WAY ...] [--write]`` (CMA-ES: ``pip install cma``).

Robots, motions and cells are those of ``bench_commands.py``, by the same seeds. The
four hips, thighs or calves of each robot have one friction more: in proportion to the
torque of their bodies (even seeds), or of Stribeck's form (odd ones), by a formula of
its own (`_commanded_robots.Undeclared`).

- CMA-ES: armature, damping, Coulomb friction, offset and delay, bodies as described, by
  simulated positions, 16 x 120 simulations of the recording; on seeds 0, 1, 8, 9 and
  so on.
- package, bodies as described: the same parameters, from the torque of the PD law.
- package, drive: bodies near the description.
- package, drive, completed: the same, with `EffectDiscovery`.

- positions: error of the simulation of the other motion from its commands alone [mrad]:
  the package's by `RobotIdentifier.follow`, with what it has found, that of CMA-ES by
  MuJoCo, which made the truth.
- armature, damping, Coulomb: median of the error over the true value. (Coulomb takes
  what is not declared.)
- named: joints with the friction that were named, by its name and on that joint, of
  those that have it; beside them effects that were named and are none.
- seconds: of one processor, for one robot.

The last columns compare with CMA-ES on the robots that it was fitted to: error of the
positions over its own, and seconds over its own, medians.

Seeds 0 to 17 are for work, from 5000 on to confirm, each once.
"""

import functools
import time
import warnings

import bench_commands as commands
import numpy as np
from _commanded_robots import DT, TICK, Undeclared
from _ledger import Ledger, results_of
from _report import fixed, parser, publish, rst_table

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.robot import PDDrive

KEYS = ("seed", "way")
COMPLETED = "package, drive, completed"
WAYS = (commands.CMA, commands.FIXED, commands.DRIVE, COMPLETED)
KINDS = ("load_friction", "stribeck")
# Limits between which sizes are drawn: a share of the load; N m and rad/s.
SHARES, SIZES, SPEEDS = (0.1, 0.3), (0.3, 1.0), (0.1, 0.5)


def undeclared_of(seed, nv):
    """Friction that the robot of a seed has beside what is declared."""
    rng = np.random.default_rng([seed, 71])
    name, joint = KINDS[seed % 2], rng.integers(3)
    size = np.where(np.arange(nv) % 3 == joint, 1.0, 0.0)
    if name == "load_friction":
        return Undeclared(name=name, size=rng.uniform(*SHARES) * size)
    size *= np.exp(rng.uniform(*np.log(SIZES)))
    return Undeclared(name=name, size=size, speed=float(rng.uniform(*SPEEDS)))


@functools.lru_cache(maxsize=1)
def case_of(seed, data_home):
    """Return the case of a seed, and its undeclared friction."""
    recording, model, gains = commands.go2(data_home)
    centre = 0.5 * (recording.q.max(0) + recording.q.min(0))
    undeclared = undeclared_of(seed, model.nv)
    case = commands.draw(seed, model, gains, centre, undeclared=undeclared)
    return case, undeclared


def fitted_by(way, case):
    """Return a robot of the package, and the effects that it names."""
    gains = case["gains"]
    bodies = {"bodies": "fixed"} if way == commands.FIXED else {}
    robot = RobotIdentifier(
        case["described"],
        dt=DT,
        drive=PDDrive(gains.kp, gains.kd, period=TICK),
        **bodies,
    )
    recording = commands.recording_of(case["described"], gains, case["fitted"])
    if way != COMPLETED:
        return robot.fit_recording(recording), ()
    loop = EffectDiscovery(robot, random_state=0)
    loop.fit_recording(recording)
    return loop.identifier_, loop.effects_


def followed(robot, case):
    """Error of positions (nv,) of the other motion [rad], from its commands alone."""
    log = case["judged"]
    recording = commands.recording_of(case["described"], case["gains"], log)
    found = robot.follow(recording)[:, : case["described"].nv]
    return np.sqrt(((found - log.true_q) ** 2).mean(axis=0))


def named_by(effects, undeclared):
    """Return how many of the undeclared are named, and how many effects are none."""
    true = {(undeclared.name, int(j)) for j in np.flatnonzero(undeclared.size)}
    said = {(one.name, int(one.joint)) for one in effects}
    said = {(name, j) for name, j in said if name != "command_delay"}
    return len(true & said), len(said - true)


def run(task):
    """Fit one robot in one way and judge it."""
    case, undeclared = case_of(task["seed"], task["data_home"])
    truth, way = case["numbers"], task["way"]
    effects, started = (), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if way == commands.CMA:
            known = case["described"], case["gains"]
            found = commands.WAYS[way](*known, case["fitted"])
            seconds = time.process_time() - started
            missed = commands.position_errors(found.numbers, *known, case["judged"])
        else:
            robot, effects = fitted_by(way, case)
            seconds = time.process_time() - started
            found = commands.found_by(robot, case["described"])
            missed = followed(robot, case)
    named, others = named_by(effects, undeclared)
    result = {
        "seed": task["seed"],
        "way": way,
        "undeclared": undeclared.name,
        "positions": 1e3 * float(missed.mean()),
        "delay": 1e3 * (found.numbers.delay - truth.delay),
        "named": named,
        "others": others,
        "seconds": seconds,
    }
    for name in commands.VALUES:
        true = getattr(truth, name)
        result[name] = ((getattr(found.numbers, name) - true) / true).tolist()
    return result


def report(results):
    """Table of the ways, by the friction that is not declared."""
    rows = []
    for kind in KINDS:
        own = [r for r in results if r["undeclared"] == kind]
        rival = {r["seed"]: r for r in own if r["way"] == commands.CMA}
        for way in WAYS:
            done = [r for r in own if r["way"] == way]
            if not done:
                continue
            beside = [(r, rival[r["seed"]]) for r in done if r["seed"] in rival]
            ratios = [
                np.median([r[key] / other[key] for r, other in beside])
                if beside
                else np.nan
                for key in ("positions", "seconds")
            ]
            errors = [
                100 * np.median(np.abs(np.concatenate([r[name] for r in done])))
                for name in commands.VALUES
            ]
            has = 4 * len(done)
            named = f"{sum(r['named'] for r in done)} of {has}"
            others = str(sum(r["others"] for r in done))
            rows.append(
                [
                    kind,
                    way,
                    str(len(done)),
                    *fixed(errors, 1),
                    *fixed([np.median([abs(r["delay"]) for r in done])], 2),
                    *fixed([np.median([r["positions"] for r in done])], 2),
                    named if way == COMPLETED else "–",
                    others if way == COMPLETED else "–",
                    *fixed([np.median([r["seconds"] for r in done])], 1),
                    *fixed(ratios[:1], 3),
                    *fixed(ratios[1:], 4),
                ]
            )
    headers = [
        "undeclared",
        "way",
        "robots",
        *(f"{name} [%]" for name in ("armature", "damping", "Coulomb")),
        "delay [ms]",
        "positions [mrad]",
        "named",
        "other names",
        "s",
        "positions / CMA-ES's",
        "s / CMA-ES's",
    ]
    return rst_table(rows, headers, n_labels=2)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--out", nargs="+", default=None, metavar="FILE")
    arguments.add_argument("--seeds", type=int, nargs=2, default=(0, 17))
    arguments.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    arguments.add_argument("--jobs", type=int, default=1)
    arguments = arguments.parse_args(argv)
    first, last = arguments.seeds
    every = [
        {"seed": seed, "way": way, "data_home": arguments.data_home}
        for seed in range(first, last + 1)
        for way in WAYS
        # Both frictions: 0, 1, 8, 9 and so on.
        if way != commands.CMA or (seed - first) % commands.CMA_EVERY < 2
    ]
    ledger = Ledger(arguments.out, KEYS)
    asked = [task for task in every if task["way"] in arguments.ways]
    for result in results_of(run, ledger.missing(asked), arguments.jobs):
        ledger.add(result)
        print(
            result["seed"], result["way"], f"{result['positions']:.2f} mrad,", end=" "
        )
        print(f"{result['seconds']:.1f} s", flush=True)
    name = "commands_undeclared"
    publish(
        name if first < 5000 else f"{name}_confirmation",
        f"Seeds {first} to {last}.\n\n{report(ledger.of(every))}",
        write=arguments.write,
        command=f"python tests/benchmarks/bench_{name}.py --seeds {first} {last}",
        states=ledger.states(every),
    )


if __name__ == "__main__":
    main()
