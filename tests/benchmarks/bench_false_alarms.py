"""False alarms and power of closing the loop where the residual is no white noise.

Run ``python tests/benchmarks/bench_false_alarms.py [--joints 1 6] [--trials N]
[--effects N] [--seed S] [--out FILE ...] [--write]``.
One joint (40 s at 50 Hz, viscous friction declared and there) or a serial arm of six
(60 s at 100 Hz, all four plain terms declared and there, residuals of one kind on all
joints, each joint its own), the declared model right, and a torque residual that is
none of the library's effects: noise of many colours; noise that grows with the speed or
the torque; friction and gains that wander; ripple too fine to be looked for; a tone;
steps in time; far outliers; a torque in steps. The same recordings with one effect put
in, whose kind, joint and size are drawn with the seed, tell the power.

Counted: recordings with any name, with any effect that is given as perhaps, and of the
recordings with an effect those in which it was found. Of all that was given as perhaps,
with and without an effect, the share that is right stands beside the probability that
was stated.

Targets: any name in at most 2 % of the recordings pooled and 5 % of a cell. Seeds below
200 are for work, the table uses 2000 and above.
"""

import time
import warnings
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from _perhaps import calibration, stated
from _report import parser, publish, rst_table, run_study
from _undeclared_effects import ADDED, World, can_carry
from _undeclared_robots import (
    draw_motion,
    feels_gravity,
    inverse_dynamics,
    nominal_robot,
    true_robot,
)
from _undeclared_span import DeclaredSpan
from bench_single_effects import judge as judge_names
from scipy.signal import lfilter

# What tells one verdict from another.
KEYS = ("residual", "joints", "seed", "study")
# Joints -> length and sample period [s], declared friction.
DURATIONS = {1: 40.0, 6: 60.0}
DT = {1: 0.02, 6: 0.01}
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
DECLARED = {1: ("viscous",), 6: PLAIN}
ALPHA = 0.05
# Root mean square of the residual in shares of the torque's standard deviation, and
# the encoder's noise [rad].
RESIDUAL, ENCODER = 0.05, 2e-5
# Friction of the one joint, which is declared [N m s/rad]; of six joints each plain
# term's share of the typical torque of a joint.
VISCOUS = 0.5
SHARES = (0.05, 0.25)
# Highest frequency of the motion of six joints [Hz].
TOP = 0.9
# Steps of a coarse torque, and the white noise below them, in shares of its spread.
COARSE = "steps of 0.1 of the spread"
STEP, BELOW = 0.1, 0.02
# Size of an effect: root mean square of what the declared model cannot mimic of it,
# in units of the residual's; drawn evenly in the logarithm.
SIZES = (0.5, 8.0)
# All of the simulator's effects, and those that one joint can show.
ALL = tuple(k for k in ADDED if k not in PLAIN)
KINDS = {1: tuple(k for k in ALL if k != "coupling"), 6: ALL}


# -- residuals of mean square one ------------------------------------------------------


class Seen(NamedTuple):
    """A joint in motion: arrays of shape (n,)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    torque: np.ndarray


def white(seen, rng):
    """Every sample on its own."""
    return rng.normal(size=seen.t.size)


def autoregression(time_constant):
    """AR(1) process: a correlation that falls by e in a time constant [s]."""

    def draw(seen, rng):
        keep = np.exp(-(seen.t[1] - seen.t[0]) / time_constant)
        steps = np.sqrt(1.0 - keep**2) * rng.normal(size=seen.t.size)
        return lfilter([1.0], [1.0, -keep], steps, zi=[keep * rng.normal()])[0]

    return draw


def power_law(exponent):
    """Noise of a power 1/f^exponent, from a quarter of the lowest frequency on."""

    def draw(seen, rng):
        n = 4 * seen.t.size
        f = np.fft.rfftfreq(n)[1:]
        size = f ** (-0.5 * exponent)
        half = size * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size))
        x = np.fft.irfft(np.r_[0.0, half], n)
        return x[: seen.t.size] / np.sqrt(np.sum(2.0 * size**2) * 2.0 / n**2)

    return draw


def random_walk(seen, rng):
    """Sum of white noise, about its mean."""
    n = seen.t.size
    x = np.cumsum(rng.normal(size=n))
    return (x - x.mean()) / np.sqrt((n**2 - 1) / (6 * n))


def bursts(seen, rng):
    """Bump at each reversal, of random size and direction, and a little white."""
    t = seen.t
    reversals = t[np.flatnonzero(np.diff(np.sign(seen.v)))]
    width = rng.uniform(0.05, 0.2, size=reversals.size)
    bumps = np.exp(-0.5 * ((t[:, None] - reversals) / width) ** 2)
    x = bumps @ rng.normal(size=reversals.size)
    x /= np.sqrt(np.mean((bumps**2).sum(axis=1)))
    return _with_white(x, rng)


def proportional(to, draw):
    """Noise times a signal of the joint, such as its speed."""

    def product(seen, rng):
        size = to(seen)
        return size / np.sqrt(np.mean(size**2)) * draw(seen, rng)

    return product


def wave(of, angular_frequency):
    """Sine of a signal of the joint, of any phase, and a little white."""

    def draw(seen, rng):
        angle = angular_frequency * of(seen) + rng.uniform(0, 2 * np.pi)
        return _with_white(np.sqrt(2.0) * np.sin(angle), rng)

    return draw


def random_steps(seen, rng):
    """Eight steps in time, between levels drawn at random, and a little white."""
    instants = np.sort(rng.uniform(seen.t[0], seen.t[-1], size=8))
    levels = rng.normal(size=9)
    return _with_white(levels[np.searchsorted(instants, seen.t)], rng)


def far_outliers(seen, rng):
    """Student's t with 2.2 degrees of freedom, over its own root mean square."""
    x = rng.standard_t(2.2, size=seen.t.size)
    return x / np.sqrt(np.mean(x**2))


def _with_white(x, rng):
    return np.sqrt(0.9) * x + np.sqrt(0.1) * rng.normal(size=x.size)


def _speed(seen):
    return np.abs(seen.v)


# The numbers of the kinds are part of the seeds.
RESIDUALS = {
    "white": white,
    "AR(1), 0.05 s": autoregression(0.05),
    "AR(1), 0.5 s": autoregression(0.5),
    "AR(1), 1.5 s": autoregression(1.5),
    "AR(1), 5 s": autoregression(5.0),
    "1/f": power_law(1.0),
    "bursts at reversals": bursts,
    "random walk": random_walk,
    "1/f^1.5": power_law(1.5),
    "speed times white": proportional(_speed, white),
    "speed times AR(1) of 0.5 s": proportional(_speed, autoregression(0.5)),
    "torque times white": proportional(lambda seen: seen.torque, white),
    "torque times AR(1) of 1 s": proportional(
        lambda seen: seen.torque, autoregression(1.0)
    ),
    "torque times AR(1) of 8 s": proportional(
        lambda seen: seen.torque, autoregression(8.0)
    ),
    "v times AR(1) of 8 s": proportional(lambda seen: seen.v, autoregression(8.0)),
    "sign(v) times AR(1) of 8 s": proportional(
        lambda seen: np.sign(seen.v), autoregression(8.0)
    ),
    "ripple of 1100 per rad": wave(lambda seen: seen.q, 1100.0),
    "ripple of 1900 per rad": wave(lambda seen: seen.q, 1900.0),
    "tone of 3.3 Hz": wave(lambda seen: seen.t, 2 * np.pi * 3.3),
    "8 random steps": random_steps,
    "Student's t, 2.2": far_outliers,
    COARSE: white,
}


# -- recordings ------------------------------------------------------------------------


def robot():
    """Make a pendulum on a horizontal axis."""
    import pinocchio as pin

    model = pin.Model()
    model.name = "pendulum"
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint_1")
    centre = pin.SE3(np.eye(3), np.array([0.12, 0.03, 0.15]))
    model.inertias[joint] = centre.act(pin.Inertia.FromBox(4.0, 0.1, 0.15, 0.3))
    return model


def motion(duration, dt, rng):
    """Sum of five sines: time (n,), states [q | v | a] (n, 3)."""
    t = np.arange(0.0, duration - 0.5 * dt, dt)
    states = np.zeros((t.size, 3))
    for f in rng.uniform(0.1, 0.9, size=5):
        w, phase = 2 * np.pi * f, rng.uniform(0, 2 * np.pi)
        wave = 0.25 / np.sqrt(f) * np.exp(1j * (w * t + phase))
        for k in range(3):
            states[:, k] += ((1j * w) ** k * wave).imag
    return t, states


def pendulum(rng):
    """Return model, time, states and torques of one joint with viscous friction."""
    model = robot()
    t, states = motion(DURATIONS[1], DT[1], rng)
    q, v, a = np.split(states, 3, axis=1)
    rigid = inverse_dynamics(model, q, v, a)
    return model, model, t, states, rigid, rigid + VISCOUS * v


def arm(nv, rng):
    """Return an arm as declared and as it is, time, states and torques."""
    t = np.arange(round(DURATIONS[nv] / DT[nv])) * DT[nv]
    while True:
        nominal = nominal_robot("serial", rng, nv)
        moved = draw_motion(np.ones(nv), TOP, t, rng)
        if feels_gravity(nominal, moved.at(t[::20])[0]):
            break
    model = true_robot(nominal, rng)
    q, v, a = moved.at(t)
    rigid = inverse_dynamics(model, q, v, a)
    typical = np.sqrt(np.mean(rigid**2, axis=0))
    torque = rigid.copy()
    for shape in (v, np.sign(v), np.ones_like(v), a):
        share = rng.uniform(*SHARES, size=nv)
        torque += share * typical * shape / np.sqrt(np.mean(shape**2, axis=0))
    return nominal, model, t, np.hstack([q, v, a]), rigid, torque


class Made(NamedTuple):
    """A recording and what is in it."""

    model: object
    dt: float
    q: np.ndarray
    tau: np.ndarray
    truth: tuple = ()
    joint: int = 0
    size: float = 0.0


def recording(kind, joints, seed, with_effect):
    """Simulate one recording."""
    place = list(RESIDUALS).index(kind)
    rng = np.random.default_rng([seed, place, int(DURATIONS[joints])])
    drawn = pendulum(rng) if joints == 1 else arm(joints, rng)
    nominal, model, t, states, rigid, plain = drawn
    q, v, a = np.split(states, 3, axis=1)
    spread = plain.std(axis=0)
    columns = [
        RESIDUALS[kind](Seen(t, q[:, j], v[:, j], plain[:, j]), rng)
        for j in range(joints)
    ]
    scale = (BELOW if kind == COARSE else RESIDUAL) * spread
    tau = plain + scale * np.column_stack(columns)
    position = q + ENCODER * rng.normal(size=q.shape)
    step = STEP * spread
    made = Made(nominal, DT[joints], position, tau)
    if with_effect:
        if kind == COARSE:
            scale = np.hypot(scale, step / np.sqrt(12.0))
        world = World(
            model=model,
            q=q,
            v=v,
            a=a,
            t=t,
            dt=DT[joints],
            groups=np.zeros(t.size, int),
            rigid=rigid,
            declared_torque=plain,
            declared=PLAIN,
            unit=np.ones(joints),
        )
        made = _put_in(made, world, states, scale, seed, rng)
    if kind == COARSE:
        made = made._replace(tau=step * np.round(made.tau / step))
    return made


def _put_in(made, world, states, scale, seed, rng):
    """Put an effect into a recording, `scale` (nv,) being the size of its residual."""
    nv = scale.size
    # Every kind comes up equally often within a cell.
    name = KINDS[nv][seed % len(KINDS[nv])]
    size = float(np.exp(rng.uniform(*np.log(SIZES))))
    able = [j for j in range(nv) if can_carry(name, world, j)]
    joint = able[int(rng.integers(len(able)))] if len(able) > 1 else able[0]
    drawn = ADDED[name](world, joint, rng)
    torque = drawn.torque
    if torque.ndim == 1:
        torque = torque[:, None] * (np.arange(nv) == joint)
    span = DeclaredSpan(made.model, states, PLAIN, scale)
    whole = np.sqrt(np.mean((torque / scale) ** 2, axis=0).sum())
    tau = made.tau + size / (span.share(torque) * whole) * torque
    truth = (name, *drawn.contains)
    return made._replace(tau=tau, truth=truth, joint=joint, size=size)


def run(task):
    """Close the loop on one recording, plain data for JSON."""
    from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

    kind, joints, seed, which = (task[key] for key in KEYS)
    made = recording(kind, joints, seed, which == "power")
    name, contains = made.truth[:1], made.truth[1:]
    verdict = {
        **{key: task[key] for key in KEYS},
        "truth": list(made.truth),
        "joint": made.joint,
        "size": made.size,
    }
    identifier = RobotIdentifier(made.model, dt=made.dt, friction=DECLARED[joints])
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            loop.fit(made.q, made.tau)
    except Exception as error:  # counted and shown, the study goes on
        return {**verdict, "error": f"{type(error).__name__}: {error}"}
    truth = SimpleNamespace(
        truth=[
            SimpleNamespace(name=n, joint=made.joint, contains=contains) for n in name
        ]
    )
    # The effect itself, by name or as a rival of the one named.
    found, _, wrong = judge_names(truth, loop.effects_)
    perhaps, _, wrong_perhaps = judge_names(truth, loop.possible_)
    return {
        **verdict,
        "names": stated(loop.effects_, wrong),
        "perhaps": stated(loop.possible_, wrong_perhaps),
        "found": any(found),
        "found or perhaps": any(found) or any(perhaps),
        "seconds": time.process_time() - started,
    }


# -- studies ---------------------------------------------------------------------------


def _of(verdicts, which):
    return [v for v in verdicts if v["study"] == which and "error" not in v]


def alarms(verdicts, what="names"):
    """Share of recordings without an effect in which one was named, or perhaps."""
    own = [bool(v[what]) for v in _of(verdicts, "null")]
    return float(np.mean(own)) if own else np.nan


def power(verdicts, what="found"):
    """Share of recordings with an effect in which it was found."""
    own = [v[what] for v in _of(verdicts, "power")]
    return float(np.mean(own)) if own else np.nan


def _percent(x):
    return "–" if np.isnan(x) else f"{100 * x:.1f}"


def rows(verdicts):
    """Rows of the table: cells, then all of them for each number of joints, and all."""
    out = []
    cells = [(kind, nv) for kind in RESIDUALS for nv in DURATIONS]
    cells += [(None, nv) for nv in DURATIONS] + [(None, None)]
    for kind, nv in cells:
        own = [
            v
            for v in verdicts
            if kind in (None, v["residual"]) and nv in (None, v["joints"])
        ]
        if own:
            out.append(
                [
                    "all" if nv is None else f"{kind or 'all'}, {DURATIONS[nv]:.0f} s",
                    nv or "",
                    len(_of(own, "null")),
                    _percent(alarms(own)),
                    _percent(alarms(own, "perhaps")),
                    len(_of(own, "power")),
                    _percent(power(own)),
                    _percent(power(own, "found or perhaps")),
                ]
            )
    return out


HEADERS = ["residual", "joints", "recordings", "false alarms, %", "any perhaps, %"]
HEADERS += ["with an effect", "found, %", "or perhaps, %"]


def by_kind(verdicts):
    """Rows of power by effect."""
    effects = {name: [] for name in ALL}
    for v in _of(verdicts, "power"):
        effects[v["truth"][0]].append(v)
    return [[k, len(own), _percent(power(own))] for k, own in effects.items() if own]


def report(verdicts):
    """Text with the tables."""
    seeds = [v["seed"] for v in verdicts]
    seconds = []
    for nv in DURATIONS:
        own = [v["seconds"] for v in verdicts if v["joints"] == nv and "seconds" in v]
        if own:
            seconds.append(f"{np.mean(own):.2f} ({nv} joint{'s' * (nv > 1)})")
    text = (
        f"Whole library, alpha = {ALPHA:g}; false alarms: recordings with nothing "
        "missing that get any name; any perhaps: those of them with an effect left "
        f"open; sizes of {SIZES[0]:g} to {SIZES[1]:g} times the residual's root mean "
        "square outside what the declared model can mimic; found: by name or as a "
        f"rival of the one named. Seeds {min(seeds)} to {max(seeds)}; seconds of a "
        f"recording: {', '.join(seconds)}. Targets: at most 2 % false alarms pooled "
        "and 5 % in a cell."
    )
    parts = [text, rst_table(rows(verdicts), HEADERS)]
    kinds = by_kind(verdicts)
    if kinds:
        headers = ["effect", "recordings", "found, %"]
        parts += ["The power by effect:", rst_table(kinds, headers)]
    parts += [
        calibration(verdicts),
        "Of all recordings, with and without an effect. Right: in the recording, "
        "contained in what is, or with it among the rivals.",
    ]
    failed = [v for v in verdicts if "error" in v]
    parts += [
        f"Ended in an error: {v['residual']}, {DURATIONS[v['joints']]:.0f} s, seed "
        f"{v['seed']}, {v['study']}: {v['error']}"
        for v in failed
    ]
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, out=True, jobs=True)
    arguments.add_argument(
        "--joints", nargs="+", type=int, choices=DURATIONS, default=list(DURATIONS)
    )
    arguments.add_argument(
        "--residuals", nargs="+", choices=RESIDUALS, default=list(RESIDUALS)
    )
    arguments.add_argument("--trials", type=int, default=200, help="of each cell")
    arguments.add_argument("--effects", type=int, help="of them also with an effect")
    arguments.add_argument("--seed", type=int, default=2000, help="seed of the first")
    arguments = arguments.parse_args(argv)
    joints, residuals = arguments.joints, arguments.residuals
    trials = arguments.trials
    effects = trials if arguments.effects is None else arguments.effects
    if arguments.quick:
        joints, residuals, trials = [1], residuals[:2], 1
    # Seed by seed, so that a study cut short is balanced.
    tasks = [
        dict(zip(KEYS, (kind, nv, seed, which), strict=True))
        for seed in range(arguments.seed, arguments.seed + trials)
        for kind in residuals
        for nv in joints
        for which in ("null", "power")
        if which == "null" or seed < arguments.seed + effects
    ]
    ledger = run_study(run, tasks, KEYS, out=arguments.out, jobs=arguments.jobs)
    publish("false_alarms", report(ledger.results), arguments, commits=ledger.commits())


if __name__ == "__main__":
    main()
