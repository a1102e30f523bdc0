"""Designed motions against the best of 1,000 random ones: condition, information.

Run ``python tests/benchmarks/bench_design_condition.py [--robots NAME ...]
[--motions N] [--data-home DIR] [--write]``. ``DIR`` is the folder of the measured sets,
of which only the descriptions of LBR Med 7 and UR5 are read; that of the KR300 comes
with the package. A robot whose description is not there is left out.

Motions of 20 s that stand still where they begin and end. Limits (`LIMITS`) of
position, speed and torque are those of the descriptions, written down here so that they
stay; no description and no data sheet states accelerations, so every joint may reach
its full speed in half a second (`RUN_UP`), which is 3.4 to 6.4 rad/s^2. The torque is
that of the rigid bodies of the description.

- designed: ``design_motion(description, duration=20, dt=0.01, limits=...,
  random_state=0)``;
- random: Fourier series with as many harmonics as the designed motion has, seeds 0 to
  999, each joint stretched to its nearest limit of position, speed or acceleration, all
  shrunk together where a torque limit is passed. Nobody looks at their margins, and at
  collisions of neither kind.

Regressor: columns of all bodies' inertial parameters, viscous and Coulomb friction of
every joint; base columns are chosen once for each robot, by a QR decomposition with
pivoting of 1,000 states drawn evenly within the limits. Rows every 20 ms. The condition
is that of the base columns scaled to unit norm, of rows as they are and of rows over
the joints' noise, 1 % of their torque limits; beside them stands that of weighted rows
with columns over their sizes at the 1,000 states, which sees a column that a motion
does not excite ("scaled alike"). The D-criterion is half the logarithm of
the determinant of the information matrix of the weighted rows [nats], in which scales
of columns cancel between motions. Random motions are ranked by each figure anew.

Targets, fixed before the design was written: condition at most half of the best random
one, D at least 3 nats above the best, every limit kept with a margin of 2 % at ten
times the sampling of the design, 2 minutes on two cores.
"""

import os
import time
import warnings
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from _design_motions import Designed, Limits, random_motion, rigid, top_harmonic
from _report import ROOT, parser, publish, rst_table
from _undeclared_robots import inverse_dynamics, regressor
from scipy.linalg import qr

DURATION = 20.0
DT = 0.01
ROWS = 0.02  # s between rows of the information matrix
FINER = 10
N_MOTIONS = 1000
RUN_UP = 0.5  # s
NOISE_SHARE = 0.01
N_STATES = 1000
# Diagonal of R over its largest below which a column is none of the base.
RANK = 1e-8
CONDITION_TARGET, NATS_TARGET, MARGIN_TARGET, SECONDS_TARGET = 0.5, 3.0, 0.02, 120.0

TURN = 2.0 * np.pi
_LBR_RANGE = (2.96706, 2.09440, 2.96706, 2.09440, 2.96706, 2.09440, 3.05433)
# Lower and upper positions [rad], speeds [rad/s], torques [N m]: of the descriptions.
LIMITS = {
    "lbr_med7": (
        [(-x, x) for x in _LBR_RANGE],
        (1.71042, 1.71042, 1.74533, 2.26893, 2.44346, 3.14159, 3.14159),
        (200.0,) * 7,
    ),
    "ur5": (
        [(-TURN, TURN)] * 2 + [(-np.pi, np.pi)] + [(-TURN, TURN)] * 3,
        (3.15, 3.15, 3.15, 3.2, 3.2, 3.2),
        (150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    ),
    "kr300": (
        [
            (-2.565634, 2.565634),
            (-2.443461, -0.087266),
            (-1.954769, 2.670354),
            (-6.108652, 6.108652),
            (-2.138028, 2.138028),
            (-6.108652, 6.108652),
        ],
        (3.0,) * 6,
        (12842.9, 13371.4, 12616.7, 11050.0, 11981.0, 7716.2),
    ),
}
FILES = {
    "lbr_med7": "kuka_lbr_med7/med7dock.urdf",
    "ur5": "ur5/ur5_robot.urdf",
}
TITLES = {"lbr_med7": "LBR Med 7", "ur5": "UR5", "kr300": "KR300"}


def description(name, data_home):
    """Path of a robot's description; None where it is not there."""
    if name == "kr300":
        folder = resources.files("sklearn_vbjfa.datasets").joinpath("robots")
        return str(folder.joinpath("kr300_nominal.urdf"))
    path = Path(data_home) / FILES[name]
    return str(path) if path.is_file() else None


def limits_of(name):
    """Frozen limits of a robot."""
    position, velocity, torque = LIMITS[name]
    velocity = np.array(velocity)
    return Limits(
        position=np.array(position),
        velocity=velocity,
        acceleration=velocity / RUN_UP,
        torque=np.array(torque),
    )


def columns(model, q, v, a):
    """Columns of bodies, viscous and Coulomb friction, (n, nv, 12 nv)."""
    unit = np.eye(model.nv)
    friction = [v[:, :, None] * unit, np.sign(v)[:, :, None] * unit]
    return np.concatenate([regressor(model, q, v, a), *friction], axis=2)


@dataclass(frozen=True, eq=False)
class Base:
    """Base columns of a robot.

    Parameters
    ----------
    columns : ndarray of int
        Their places.
    size : ndarray of shape (n_base,)
        Root mean squares of the weighted columns at the drawn states.
    """

    columns: np.ndarray
    size: np.ndarray


def base_columns(model, limits, rng):
    """Choose base columns by states drawn evenly within the limits.

    Returns
    -------
    Base
        Base.
    """
    x = rng.uniform(-1.0, 1.0, size=(3, N_STATES, model.nv))
    low, high = limits.position.T
    q = 0.5 * (low + high) + 0.5 * (high - low) * x[0]
    W = columns(model, q, limits.velocity * x[1], limits.acceleration * x[2])
    W = W.reshape(-1, W.shape[2])
    length = np.linalg.norm(W, axis=0)
    seen = np.flatnonzero(length > RANK * length.max())
    _, R, order = qr(W[:, seen] / length[seen], mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    chosen = np.sort(seen[order[: np.sum(size > RANK * size[0])]])
    weighted = W[:, chosen].reshape(N_STATES, model.nv, -1)
    weighted = weighted / (NOISE_SHARE * limits.torque)[:, None]
    return Base(chosen, np.sqrt(np.mean(weighted**2, axis=(0, 1))))


@dataclass(frozen=True)
class Figures:
    """What a motion is worth.

    Parameters
    ----------
    plain, weighted : float
        Condition of the scaled base columns, of rows as they are and over the noise.
    alike : float
        Condition of weighted rows with the columns over their norms at the drawn
        states, which are the same for all motions.
    nats : float
        Half the logarithm of the determinant of the information matrix.
    """

    plain: float
    weighted: float
    alike: float
    nats: float


def figures(model, limits, base, motion, duration=DURATION):
    """Condition and information of a motion."""
    t = np.arange(round(duration / ROWS)) * ROWS
    W = columns(model, *motion.at(t))[:, :, base.columns]
    noise = NOISE_SHARE * limits.torque
    plain = W.reshape(-1, W.shape[2])
    weighted = (W / noise[:, None]).reshape(plain.shape)
    length = np.linalg.norm(weighted, axis=0)
    sizes = np.linalg.svd(weighted / length, compute_uv=False)
    return Figures(
        plain=float(np.linalg.cond(plain / np.linalg.norm(plain, axis=0))),
        weighted=float(sizes[0] / sizes[-1]),
        alike=float(np.linalg.cond(weighted / base.size)),
        nats=float(np.log(sizes).sum() + np.log(length).sum()),
    )


def worst_margin(model, limits, motion, duration=DURATION):
    """Smallest margin of each limit at ten times the sampling, dict of float."""
    t = np.arange(round(FINER * duration / DT) + 1) * DT / FINER
    q, v, a = motion.at(t)
    margins = limits.margins(q, v, a, inverse_dynamics(model, q, v, a))
    return {name: float(margin.min()) for name, margin in margins.items()}


def designed(urdf, limits):
    """Design the motion; how many harmonics it has."""
    from sklearn_vbjfa.design import design_motion

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        made = design_motion(
            urdf, duration=DURATION, dt=DT, limits=limits.of_package(), random_state=0
        )
    motion = Designed(made)
    return motion, top_harmonic(motion, DURATION)


def run(name, urdf, n_motions=N_MOTIONS, design=designed):
    """Compare the designed motion of a robot with random ones.

    Parameters
    ----------
    name : str
        Key of `LIMITS`.
    urdf : str
        Description.
    n_motions : int
        Number of random motions.
    design : callable
        (urdf, limits) -> motion, number of harmonics.

    Returns
    -------
    dict
        Figures of the designed motion and of the best random ones, margins, seconds.
    """
    import pinocchio as pin

    model, limits = pin.buildModelFromUrdf(urdf), limits_of(name)
    base = base_columns(model, limits, np.random.default_rng(0))
    started = time.perf_counter()
    motion, harmonics = design(urdf, limits)
    seconds = time.perf_counter() - started
    rivals = []
    for seed in range(n_motions):
        rng = np.random.default_rng(seed)
        rival = random_motion(rigid(model), limits, DURATION, harmonics, rng)
        rivals.append(figures(model, limits, base, rival))
    return {
        "name": name,
        "harmonics": harmonics,
        "n_base": int(base.columns.size),
        "n_motions": n_motions,
        "designed": figures(model, limits, base, motion),
        "best": Figures(
            plain=min(r.plain for r in rivals),
            weighted=min(r.weighted for r in rivals),
            alike=min(r.alike for r in rivals),
            nats=max(r.nats for r in rivals),
        ),
        "median": Figures(
            *(
                float(np.median([getattr(r, key) for r in rivals]))
                for key in ("plain", "weighted", "alike", "nats")
            )
        ),
        "margins": worst_margin(model, limits, motion),
        "seconds": seconds,
    }


def line(result):
    """One line about one robot."""
    ours, best = result["designed"], result["best"]
    return (
        f"{TITLES[result['name']]}: "
        f"condition {ours.plain:.1f} against {best.plain:.1f}, "
        f"weighted {ours.weighted:.1f} against {best.weighted:.1f}, "
        f"scaled alike {ours.alike:.1f} against {best.alike:.1f}, "
        f"{ours.nats - best.nats:+.1f} nats, margins "
        f"{ {k: round(x, 4) for k, x in result['margins'].items()} }, "
        f"{result['harmonics']} harmonics, {result['seconds']:.0f} s"
    )


def _verdicts(result):
    ours, best = result["designed"], result["best"]
    return (
        ours.plain <= CONDITION_TARGET * best.plain,
        ours.weighted <= CONDITION_TARGET * best.weighted,
        ours.alike <= CONDITION_TARGET * best.alike,
        ours.nats - best.nats >= NATS_TARGET,
        min(result["margins"].values()) >= MARGIN_TARGET,
        result["seconds"] <= SECONDS_TARGET,
    )


def report(results):
    """Text with the tables of the results that there are."""
    rows, missed = [], []
    names = (
        "condition",
        "weighted condition",
        "condition scaled alike",
        "information",
        "margin",
        "time",
    )
    for result in results:
        ours, best, usual = result["designed"], result["best"], result["median"]
        margin = min(result["margins"], key=result["margins"].get)
        rows.append(
            [
                TITLES[result["name"]],
                str(result["harmonics"]),
                str(result["n_base"]),
                *(
                    " / ".join(f"{getattr(x, key):.1f}" for x in (ours, best, usual))
                    for key in ("plain", "weighted", "alike")
                ),
                f"{ours.nats - best.nats:+.1f} / {ours.nats - usual.nats:+.1f}",
                f"{100 * result['margins'][margin]:.1f} % ({margin})",
                f"{result['seconds']:.0f} s",
            ]
        )
        kept = _verdicts(result)
        missed += [
            f"{TITLES[result['name']]} {name}"
            for name, ok in zip(names, kept)
            if not ok
        ]
    headers = [
        "robot",
        "harmonics",
        "base",
        "condition",
        "weighted",
        "scaled alike",
        "nats over best / median",
        "least margin",
        "time",
    ]
    targets = (
        f"Targets: condition at most {CONDITION_TARGET:g} of the best, {NATS_TARGET:g} "
        f"nats, a margin of {100 * MARGIN_TARGET:g} %, {SECONDS_TARGET:g} s: "
    )
    targets += f"not reached: {', '.join(missed)}." if missed else "all reached."
    return "\n\n".join(
        [
            f"{results[0]['n_motions']} random motions (seeds 0 to "
            f"{results[0]['n_motions'] - 1}), {DURATION:g} s. "
            "Conditions are those of the designed motion / of the best / of the median "
            "random one, by each figure anew.",
            rst_table(rows, headers),
            targets,
        ]
    )


def data_folder(named=None):
    """Folder of the measured sets: as named, by the environment, or beside."""
    named = named or os.environ.get("SKLEARN_VBJFA_DATA")
    return Path(named) if named else ROOT.parent / "shared" / "data"


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--robots", nargs="+", choices=LIMITS, default=list(LIMITS))
    arguments.add_argument("--motions", type=int, default=N_MOTIONS)
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments = arguments.parse_args(argv)
    results = []
    for name in arguments.robots:
        urdf = description(name, data_folder(arguments.data_home))
        if urdf is None:
            print(f"{TITLES[name]}: no description, left out")
            continue
        results.append(run(name, urdf, arguments.motions))
        print(line(results[-1]), flush=True)
    if results:
        publish("design_condition", report(results), write=arguments.write)


if __name__ == "__main__":
    main()
