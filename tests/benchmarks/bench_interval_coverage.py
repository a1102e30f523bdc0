"""How often 90 % intervals hold what they are intervals of.

Run ``python tests/benchmarks/bench_interval_coverage.py [--trials N] [--seed S]
[--study NAME] [--write]``. Small simulated arms (tests/effects/_arms.py, which shares
no code with the package), a new motion and new noise in every trial; trial k of every
cell has the seed S + k. Bodies are described with errors that are drawn in every trial.

``parameters``: `RobotIdentifier`, its estimate and standard deviations, all parameters
that the data determine on their own; torque noise white or AR(1).
``effects``: `EffectDiscovery`, one undeclared effect that is looked for, coefficients
and shape parameters.
``errors``: `EffectDiscovery`, the error after and its interval, against the error of
the same model over the next 50 s of the same motion.
"""

import sys
import warnings
from dataclasses import dataclass, field

import numpy as np
from _report import ROOT, parser, publish, rst_table
from scipy import signal, stats

sys.path.append(str(ROOT))

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from tests.effects._arms import arm, inverse_dynamics, motion

DT = 0.02
VISCOUS = (0.8, 0.5, 0.3)
TORQUE_NOISE = 0.05
ENCODER_NOISE = 2e-5
OFF = 0.2  # relative errors of the description
NEXT = 50.0  # s
MARGIN = 2.0  # s, more than the low-pass takes away at both ends
NINETY = stats.norm.ppf(0.95)
# Lag-one correlation of the torque noise, at 50 Hz.
NOISES = {"white": 0.0, "AR(0.9)": 0.9, "AR, 1.5 s": float(np.exp(-DT / 1.5))}
TARGETS = "each cell 85 to 95 %, pooled 88 to 92 %"


@dataclass
class Cell:
    """Answers of one setting."""

    label: tuple
    unit: str
    inside: list = field(default_factory=list)
    width: list = field(default_factory=list)
    trials: int = 0

    def add(self, low, high, truth, size):
        """Take in an interval."""
        self.inside.append(bool(low <= truth <= high))
        self.width.append((high - low) / abs(size))

    @property
    def coverage(self):
        """Share of intervals that held the truth."""
        return float(np.mean(self.inside)) if self.inside else np.nan

    def tell(self):
        """Say that it is done; return it."""
        print(" | ".join(map(str, self.row())), file=sys.stderr, flush=True)
        return self

    def row(self):
        """Row of the table."""
        width = f"{np.median(self.width):.3g}" if self.width else "–"
        coverage = f"{100 * self.coverage:.1f} %" if self.inside else "–"
        return [*self.label, self.trials, len(self.inside), coverage, width, self.unit]


def coloured(rng, shape, rho):
    """AR(1) noise of unit variance along the first axis, stationary from the start."""
    drawn = rng.normal(size=shape)
    if rho == 0:
        return drawn
    drawn[0] /= np.sqrt(1 - rho**2)
    return signal.lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], drawn, axis=0)


@dataclass(frozen=True, eq=False)
class Arm:
    """One simulated recording."""

    model: object  # as described
    true: object
    q: np.ndarray
    tau: np.ndarray


def described(true, rng):
    """Draw the description of an arm: each body off by a fifth or so."""
    model = true.copy()
    for body in list(model.inertias)[1:]:
        shift = OFF / 2 * np.abs(body.lever).max() * rng.normal(size=3)
        mass, inertia = np.exp(OFF * rng.normal(size=2))
        body.lever = body.lever + shift
        body.inertia = mass * inertia * body.inertia
        body.mass = mass * body.mass
    return model


def simulate(axes, duration, rho, seed, effect=None, friction=()):
    """Simulate an arm with an effect (q, v, load) -> torque of one joint."""
    model = arm(axes)
    nv = model.nv
    _, states = motion(nv, duration=duration, dt=DT, seed=seed)
    q, v, _ = np.split(states, 3, axis=1)
    rng = np.random.default_rng(10_000 + seed)
    load = inverse_dynamics(model, states)
    tau = load + np.array(VISCOUS[:nv]) * v
    for joint, size in enumerate(friction):
        tau[:, joint] += size * np.sign(v[:, joint])
    if effect is not None:
        joint, torque = effect
        tau[:, joint] += torque(q[:, joint], v[:, joint], load[:, joint])
    tau += TORQUE_NOISE * coloured(rng, tau.shape, rho)
    q = q + ENCODER_NOISE * rng.normal(size=q.shape)
    return Arm(described(model, rng), model, q, tau)


# -- parameters


COULOMB = (0.3, 0.2, 0.1)


def parameters(trials, seed, robots=(("Z", 40.0), ("ZY", 40.0), ("ZYX", 60.0))):
    """Cells of `RobotIdentifier`."""
    cells = []
    for axes, duration in robots:
        for noise in ("white", "AR(0.9)"):
            joints = f"{len(axes)} joint{'s' if len(axes) > 1 else ''}, {duration:g} s"
            cell = Cell(("parameters", joints, noise), "true value")
            for k in range(trials):
                _one_fit(cell, axes, duration, NOISES[noise], seed + k)
                cell.trials += 1
            cells.append(cell.tell())
    return cells


def _one_fit(cell, axes, duration, rho, seed):
    made = simulate(axes, duration, rho, seed, friction=COULOMB[: len(axes)])
    robot = RobotIdentifier(made.model, dt=DT, friction=("viscous", "coulomb"))
    robot.fit(made.q, made.tau)
    nv = made.model.nv
    truth = np.array(
        [
            [*made.true.inertias[j + 1].toDynamicParameters(), VISCOUS[j], COULOMB[j]]
            for j in range(nv)
        ]
    ).ravel()
    estimate, deviation = robot.theta_unconstrained_, robot.theta_std_
    for i in np.flatnonzero(robot.identifiable_):
        half = NINETY * deviation[i]
        cell.add(estimate[i] - half, estimate[i] + half, truth[i], truth[i] or 1.0)


# -- effects


def _coulomb(q, v, load):
    return 0.3 * np.sign(v)


def _spring(q, v, load):
    return 0.8 * (q - 0.2)


def _load_friction(q, v, load):
    return 0.06 * np.abs(load) * np.sign(v)


def _quadratic(q, v, load):
    return 0.15 * v * np.abs(v)


def _ripple(q, v, load):
    return 0.3 * np.cos(2 * np.pi * q / 0.9 - 0.5)


# label: name in the library, joint, torque, truth of its parameters
EFFECTS = {
    "spring": ("spring", 0, _spring, {"k": 0.8, "q0": 0.2}),
    "load_friction": ("load_friction", 1, _load_friction, {"mu": 0.06}),
    "viscous_quadratic": ("viscous_quadratic", 1, _quadratic, {"F2": 0.15}),
    "ripple": ("ripple", 0, _ripple, {"A": 0.3, "period": 0.9, "phase": 0.5}),
}


def effects(trials, seed, chosen=tuple(EFFECTS), duration=67.0):
    """Cells of the effects' parameters."""
    cells = []
    for label in chosen:
        name, joint, torque, truth = EFFECTS[label]
        for noise in ("white", "AR(0.9)"):
            own = {
                key: Cell(("effects", f"{label}: {key}", noise), "true value")
                for key in truth
            }
            for k in range(trials):
                made = simulate(
                    "ZY", duration, NOISES[noise], seed + k, (joint, torque)
                )
                loop = discover(made, [name])
                for found in loop.effects_:
                    if (found.name, found.joint) == (name, joint):
                        _take(own, found, truth)
                for cell in own.values():
                    cell.trials += 1
            cells += [cell.tell() for cell in own.values()]
    return cells


def _take(cells, found, truth):
    for key, value in truth.items():
        low, high = found.intervals.get(key, (np.nan, np.nan))
        cells[key].add(low, high, value, value)


def discover(made, names, n=None):
    """Close the loop on the first n rows."""
    loop = EffectDiscovery(
        RobotIdentifier(made.model, dt=DT, friction=("viscous",)),
        effects=names,
        random_state=0,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return loop.fit(made.q[:n], made.tau[:n])


# -- errors


def errors(trials, seed, durations=(67.0, 200.0), noises=tuple(NOISES)):
    """Cells of the error after, on the next stretch of the same motion."""
    cells = []
    for duration in durations:
        for noise in noises:
            cell = Cell(
                ("error after", f"held-out {duration / 4:.0f} s", noise), "error after"
            )
            for k in range(trials):
                _next_error(cell, duration, NOISES[noise], seed + k)
                cell.trials += 1
            cells.append(cell.tell())
    return cells


def _next_error(cell, duration, rho, seed):
    whole = duration + NEXT + MARGIN
    made = simulate("ZY", whole, rho, seed, (0, _coulomb))
    n = round(duration / DT)
    loop = discover(made, ["coulomb"], n)
    # The interval is of the model that was judged.
    rest = loop.validation_model_.residuals(made.q[n:], made.tau[n:])
    later = rest.relative_error(loop.torque_std_)
    ends = [one.intervals["after"] for one in loop.report_.outcome.errors]
    low, high = np.transpose(ends)
    for j, error in enumerate(later):
        cell.add(low[j], high[j], error, loop.error_after_[j])


STUDIES = {"parameters": parameters, "effects": effects, "errors": errors}
HEADERS = [
    "interval of",
    "setting",
    "torque noise",
    "data sets",
    "intervals",
    "hold the truth",
    "median width",
    "in units of",
]


def report(cells):
    """Table and the pooled coverage of each study."""
    text = (
        f"Torque noise {TORQUE_NOISE} N m, encoder noise {ENCODER_NOISE} rad, "
        f"{1 / DT:.0f} samples a second. AR(0.9) has a time constant of 0.19 s. "
        f"Targets: {TARGETS}.\n\n" + rst_table([c.row() for c in cells], HEADERS, 3)
    )
    pooled = []
    for study in dict.fromkeys(c.label[0] for c in cells):
        inside = np.concatenate([c.inside for c in cells if c.label[0] == study])
        if inside.size:
            pooled.append(f"{study} {100 * inside.mean():.1f} %")
    return f"{text}\n\nPooled: {'; '.join(pooled)}."


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=200)
    arguments.add_argument("--seed", type=int, default=100)
    arguments.add_argument("--study", choices=STUDIES, action="append")
    arguments = arguments.parse_args(argv)
    cells = []
    for name in arguments.study or STUDIES:
        trials = 2 if arguments.quick else arguments.trials
        cells += STUDIES[name](trials, arguments.seed)
    publish("interval_coverage", report(cells), arguments)


if __name__ == "__main__":
    main()
