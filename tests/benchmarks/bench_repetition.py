"""Motion that repeats, with a disturbance that repeats with it: false names and power.

Run ``python tests/benchmarks/bench_repetition.py --out FILE [--trials N] [--seed S]
[--write]``.

Data: nothing of the package. Robots as in ``bench_false_alarms.py`` (a pendulum, arms
of two and six joints). The motion is six sines of multiples of 0.1 Hz up to 0.9 Hz: it
repeats after 10 s, without a pause, or once in each of several recordings. Nothing is
missing (``null``): the residual is some per cent of the torque's spread, 90 % of its
power a random function of the phase, harmonics of 0.1 Hz up to the one that is named,
the rest white. ``control``: the same disturbance beside a motion that does not repeat.
``power``: one effect of twice the noise (root mean square outside of what the declared
model can mimic) in white noise of 5 %, on repeated motion. 100 samples a second,
encoder noise 2e-5 rad, four plain terms declared.

Seeds 0 to 99 are for work, from 2000 on to confirm.
"""

import time
import warnings
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from _perhaps import stated
from _report import fixed, parser, publish, rst_table, run_study
from _undeclared_effects import ADDED, World, can_carry
from _undeclared_robots import (
    feels_gravity,
    inverse_dynamics,
    nominal_robot,
    true_robot,
)
from _undeclared_span import DeclaredSpan
from bench_false_alarms import ENCODER, PLAIN, SHARES, robot
from bench_single_effects import judge as judge_names

KEYS = ("row", "seed")
PERIOD, DT = 10.0, 0.01
SIZE = 2.0


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of the table."""

    joints: int
    seconds: float
    share: float
    harmonics: int
    repeats: str = "periods"
    effect: bool = False


ROWS = {
    "1 joint, harmonics 1-10, 60 s": Row(
        joints=1, seconds=60, share=0.05, harmonics=10
    ),
    "1 joint, harmonics 1-30, 60 s": Row(
        joints=1, seconds=60, share=0.05, harmonics=30
    ),
    "2 joints, harmonics 1-20, 60 s": Row(
        joints=2, seconds=60, share=0.03, harmonics=20
    ),
    "1 joint, harmonics 1-40, 40 s": Row(
        joints=1, seconds=40, share=0.05, harmonics=40
    ),
    "2 joints, harmonics 1-40, 40 s": Row(
        joints=2, seconds=40, share=0.05, harmonics=40
    ),
    "6 joints, harmonics 1-20, 60 s": Row(
        joints=6, seconds=60, share=0.03, harmonics=20
    ),
    "1 joint, 6 recordings, harmonics 1-30": Row(
        joints=1, seconds=60, share=0.05, harmonics=30, repeats="recordings"
    ),
    "2 joints, 6 recordings, harmonics 1-20": Row(
        joints=2, seconds=60, share=0.03, harmonics=20, repeats="recordings"
    ),
    "control, 1 joint, harmonics 1-30, 60 s": Row(
        joints=1, seconds=60, share=0.05, harmonics=30, repeats="no"
    ),
    "control, 2 joints, harmonics 1-20, 60 s": Row(
        joints=2, seconds=60, share=0.03, harmonics=20, repeats="no"
    ),
    "power, 1 joint, 60 s": Row(
        joints=1, seconds=60, share=0.05, harmonics=0, effect=True
    ),
    "power, 2 joints, 60 s": Row(
        joints=2, seconds=60, share=0.05, harmonics=0, effect=True
    ),
}


def motion(row, t, rng):
    """Positions, velocities, accelerations (n, nv) of a motion that may repeat."""
    out = np.zeros((3, t.size, row.joints))
    for j in range(row.joints):
        if row.repeats == "no":
            frequency = rng.uniform(0.1, 0.9, size=6)
        else:
            frequency = rng.choice(np.arange(1, 10), size=6, replace=False) / PERIOD
        for f in frequency:
            w, phase = 2 * np.pi * f, rng.uniform(0, 2 * np.pi)
            wave = 0.25 / np.sqrt(f) * np.exp(1j * (w * t + phase))
            for k in range(3):
                out[k, :, j] += ((1j * w) ** k * wave).imag
    return out


def disturbance(row, t, rng):
    """Residual of mean square one, (n,)."""
    noise = rng.normal(size=t.size)
    if not row.harmonics:
        return noise
    orders = np.arange(1, row.harmonics + 1)
    size = rng.normal(size=orders.size) + 1j * rng.normal(size=orders.size)
    wave = (size[:, None] * np.exp(2j * np.pi * orders[:, None] * t / PERIOD)).real
    curve = wave.sum(axis=0)
    return np.sqrt(0.9) * curve / curve.std() + np.sqrt(0.1) * noise


def recording(row, seed):
    """Simulate one: model, positions, torques, groups, what is in it, its joint."""
    rng = np.random.default_rng([seed, row.joints, int(row.seconds), row.harmonics])
    t = np.arange(round(row.seconds / DT)) * DT
    groups = np.zeros(t.size, dtype=int)
    while True:
        nominal = (
            robot() if row.joints == 1 else nominal_robot("serial", rng, row.joints)
        )
        q, v, a = motion(row, t, rng)
        if row.joints == 1 or feels_gravity(nominal, q[::20]):
            break
    if row.repeats == "recordings":
        groups = (t / PERIOD).astype(int)
    model = nominal if row.joints == 1 else true_robot(nominal, rng)
    rigid = inverse_dynamics(model, q, v, a)
    typical = np.sqrt(np.mean(rigid**2, axis=0))
    plain = rigid.copy()
    for shape in (v, np.sign(v), np.ones_like(v), a):
        share = rng.uniform(*SHARES, size=row.joints)
        plain += share * typical * shape / np.sqrt(np.mean(shape**2, axis=0))
    scale = row.share * plain.std(axis=0)
    residual = np.column_stack([disturbance(row, t, rng) for _ in range(row.joints)])
    tau, truth, joint = plain + scale * residual, (), 0
    if row.effect:
        states = np.hstack([q, v, a])
        world = World(
            model=model,
            q=q,
            v=v,
            a=a,
            t=t,
            dt=DT,
            groups=groups,
            rigid=rigid,
            declared_torque=plain,
            declared=PLAIN,
            unit=np.ones(row.joints),
        )
        kinds = [
            k for k in ADDED if k not in PLAIN and (row.joints > 1 or k != "coupling")
        ]
        name = kinds[seed % len(kinds)]
        able = [j for j in range(row.joints) if can_carry(name, world, j)]
        joint = able[int(rng.integers(len(able)))]
        drawn = ADDED[name](world, joint, rng)
        torque = drawn.torque
        if torque.ndim == 1:
            torque = torque[:, None] * (np.arange(row.joints) == joint)
        span = DeclaredSpan(nominal, states, PLAIN, scale)
        whole = np.sqrt(np.mean((torque / scale) ** 2, axis=0).sum())
        tau = tau + SIZE / (span.share(torque) * whole) * torque
        truth = (name, *drawn.contains)
    position = q + ENCODER * rng.normal(size=q.shape)
    return nominal, position, tau, groups, truth, joint


def run(task):
    """Close the loop on one recording, plain data for JSON."""
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

    name, seed = task["row"], task["seed"]
    row = ROWS[name]
    model, q, tau, groups, truth, joint = recording(row, seed)
    identifier = RobotIdentifier(model, dt=DT, friction=PLAIN)
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(q, tau, groups=groups)
    real = [SimpleNamespace(name=n, joint=joint, contains=truth[1:]) for n in truth[:1]]
    found, _, wrong = judge_names(SimpleNamespace(truth=real), loop.effects_)
    _, _, wrong_perhaps = judge_names(SimpleNamespace(truth=real), loop.possible_)
    return {
        "row": name,
        "seed": seed,
        "truth": list(truth),
        "joint": joint,
        "found": bool(found) and all(found),
        "names": stated(loop.effects_, wrong),
        "perhaps": stated(loop.possible_, wrong_perhaps),
        "repeats": bool(loop.report_.outcome.findings["repeated"]),
        "seconds": time.process_time() - started,
    }


def report(results):
    """Text of the table."""
    rows = []
    for name, row in ROWS.items():
        own = [r for r in results if r["row"] == name]
        if not own:
            continue
        share = [
            100 * np.mean([bool(r[key]) for r in own]) for key in ("names", "perhaps")
        ]
        found = 100 * np.mean([r["found"] for r in own]) if row.effect else np.nan
        seen = 100 * np.mean([r["repeats"] for r in own])
        seconds = np.mean([r["seconds"] for r in own])
        rows.append([name, str(len(own)), *fixed([*share, found, seen, seconds], 1)])
    heads = [
        "row",
        "recordings",
        "any name [%]",
        "any perhaps [%]",
        "effect named [%]",
        "said to repeat [%]",
        "s",
    ]
    return rst_table(rows, heads)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, out=True, jobs=True)
    arguments.add_argument("--trials", type=int, default=10)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--rows", nargs="+", choices=ROWS, default=tuple(ROWS))
    arguments = arguments.parse_args(argv)
    rows, trials, first = arguments.rows, arguments.trials, arguments.seed
    if arguments.quick:
        rows, trials = rows[:1], 1
    seeds = range(first, first + trials)
    tasks = [{"row": row, "seed": seed} for seed in seeds for row in rows]
    ledger = run_study(run, tasks, KEYS, out=arguments.out, jobs=arguments.jobs)
    publish(
        "repetition",
        f"Seeds {seeds[0]} to {seeds[-1]}.\n\n{report(ledger.of(tasks))}",
        arguments,
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
