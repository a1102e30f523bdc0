"""Friction laws with memory, and what is named instead, on simulated arms.

Run as ``python tests/benchmarks/bench_friction_memory.py [--laws lugre]``.
The generator shares no code with the package: rigid bodies are those of Pinocchio, the
laws of friction are integrated on a grid twenty times finer than the samples. The
masses of the description are 20 % off. 40 s at 100 Hz; the 40 s after are predicted.
"stops": both joints stop where they reverse, and their friction turns meanwhile. Errors
without any law are weighted as in a fit.
"""

import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
from _report import fixed, parser, publish, rst_table, run_study
from scipy.interpolate import CubicSpline

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

# Names that are right for each law, on the joint that has it; `also` on the others.
# A law that the library does not have may be named as what it is closest to.
ACCEPTED = {
    "maxwell_slip": {"maxwell_slip"},
    "gms": {"maxwell_slip", "stribeck"},
    "elasto_plastic": {"maxwell_slip", "stribeck"},
    "lugre": {"maxwell_slip", "stribeck"},
    "friction_by_position": {"friction_by_position"},
    "tendon_friction": {"coupling"},
    "tendon_spring": {"coupling_spring"},
    "gear_loss": {"gear_loss", "load_friction", "maxwell_slip", "torque_gain"},
    "warm_up": {"drift"},
    "two_coggings": {"ripple"},
    "nothing": set(),
    "stops": set(),
}
MEMORY = ("maxwell_slip", "gms", "elasto_plastic", "lugre")
# Laws between two joints: both may have the name.
BOTH = ("tendon_friction", "tendon_spring")
SECONDS, DT, FINE, NOISE = 40.0, 0.01, 20, 0.03


class Arm:
    """A planar or spatial arm of two joints with random bodies."""

    def __init__(self, rng):
        self.axes = [np.array([0.0, 1.0, 0.0]), rng.normal(size=3)]
        self.axes[1] /= np.linalg.norm(self.axes[1])
        self.offset = rng.uniform([0.2, -0.1, -0.1], [0.5, 0.1, 0.1])
        self.bodies = [self._body(rng, scale) for scale in (1.0, 0.6)]
        self.viscous = rng.uniform(0.2, 1.0, 2)
        self.dry = rng.uniform(0.3, 1.0, 2)
        self.rotor = rng.uniform(0.02, 0.1, 2)

    @staticmethod
    def _body(rng, scale):
        """Mass, centre and inertia about it of a cloud of points."""
        points = rng.normal(size=(9, 3)) * [0.12, 0.05, 0.05] + [0.2, 0.0, 0.0]
        share = rng.dirichlet(np.ones(9)) * scale * rng.uniform(1.5, 4.0)
        mass, centre = share.sum(), share @ points / share.sum()
        away = points - centre
        inertia = sum(
            m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(share, away)
        )
        return mass, centre, inertia + 1e-4 * mass * np.eye(3)

    def described(self, rng):
        """Return bodies whose masses are off by 20 %."""
        factors = np.exp(0.2 * rng.normal(size=2))
        return [(f * m, c, f * J) for f, (m, c, J) in zip(factors, self.bodies)]

    def urdf(self, bodies):
        """Return a description with some bodies."""
        parts, parent = ['<robot name="arm"><link name="base"/>'], "base"
        for j, (mass, c, J) in enumerate(bodies):
            xyz = (0, 0, 0) if j == 0 else self.offset
            text = [" ".join(f"{x:.12g}" for x in v) for v in (c, xyz, self.axes[j])]
            moments = "".join(
                f'i{a}{b}="{J["xyz".index(a), "xyz".index(b)]:.12g}" '
                for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
            )
            parts.append(
                f'<link name="l{j}"><inertial><origin xyz="{text[0]}"/>'
                f'<mass value="{mass:.12g}"/><inertia {moments}/></inertial></link>'
                f'<joint name="j{j}" type="revolute"><parent link="{parent}"/>'
                f'<child link="l{j}"/><origin xyz="{text[1]}"/><axis xyz="{text[2]}"/>'
                '<limit lower="-6" upper="6" effort="500" velocity="20"/></joint>'
            )
            parent = f"l{j}"
        return "".join(parts) + "</robot>"

    def rigid(self, q, v, a):
        """Torques of the bodies, by Pinocchio."""
        model = pin.buildModelFromXML(self.urdf(self.bodies))
        data = model.createData()
        return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a)])


def motion(rng, n):
    """Draw six sines for each joint: time, positions, velocities, accelerations."""
    t = np.arange(n) * DT
    states = np.zeros((3, n, 2))
    for j in range(2):
        w = 2 * np.pi * rng.uniform(0.05, 0.45, 6)
        size = rng.uniform(0.15, 0.4, 6) / (1 + w / 1.3)
        phase = np.outer(t, w) + rng.uniform(0, 2 * np.pi, 6)
        states[0, :, j] = np.sin(phase) @ size
        states[1, :, j] = np.cos(phase) @ (size * w)
        states[2, :, j] = -np.sin(phase) @ (size * w**2)
    return t, *states


def stopping(v):
    """Motion that stops at reversals, and the direction of its friction."""
    moves = np.sign(v) * np.maximum(np.abs(v) - 0.1 * np.abs(v).max(axis=0), 0.0)
    turns = np.sign(np.gradient(v, axis=0))
    direction = np.where(moves == 0, turns, np.sign(moves))
    return (
        # The trapezoidal rule: sums alone are half a sample ahead of the torques.
        (np.cumsum(moves, axis=0) - 0.5 * moves) * DT,
        moves,
        np.gradient(moves, DT, axis=0),
        direction,
    )


# -- laws, integrated on a fine grid ---------------------------------------------------


def fine(q):
    """Positions on the fine grid, with the velocities of their spline."""
    t = np.arange(q.size)
    spline = CubicSpline(t, q)
    grid = np.arange((q.size - 1) * FINE + 1) / FINE
    return spline(grid), spline(grid, 1) / DT


def stribeck_size(v, size, fast, rise):
    """Sliding friction at each velocity."""
    return size * (1 + rise * np.exp(-((v / (0.09 * fast)) ** 2)))


def maxwell_slip(q, size, reach, fast):
    """Four springs that slip at forces of their own."""
    x, _ = fine(q)
    share = np.array([0.35, 0.3, 0.2, 0.15])
    slip = reach * np.array([0.004, 0.015, 0.05, 0.14])
    z, out = np.zeros(4), np.empty(x.size)
    out[0] = 0.0
    for i, step in enumerate(np.diff(x)):
        z = np.minimum(np.maximum(z + step / slip, -1.0), 1.0)
        out[i + 1] = share @ z
    return size * out[::FINE]


def gms(q, size, reach, fast):
    """Generalised Maxwell slip: sliding elements approach the curve of Stribeck."""
    x, v = fine(q)
    share = np.array([0.4, 0.3, 0.2, 0.1])
    k = share * size / (reach * np.array([0.004, 0.012, 0.03, 0.07]))
    force, slides, out = np.zeros(4), np.zeros(4, bool), np.empty(x.size)
    level, h = stribeck_size(v, size, fast, 0.4), DT / FINE
    for i in range(x.size):
        way = np.sign(v[i])
        slides &= way * force > 0
        drawn = h * way * 20 * size * (share - way * force / level[i])
        force = force + np.where(slides, drawn, h * k * v[i])
        over = ~slides & (np.abs(force) >= share * level[i])
        force = np.where(over, np.sign(force) * share * level[i], force)
        slides |= over
        out[i] = force.sum()
    return out[::FINE]


def elasto_plastic(q, size, reach, fast):
    """Bristles that yield beyond 60 % of their deflection (Dupont and others 2002)."""
    x, v = fine(q)
    stiffness, z, out = size / (0.015 * reach), 0.0, np.empty(x.size)
    level = stribeck_size(v, size, fast, 0.3) / stiffness
    for i in range(x.size):
        most, share = level[i], 0.0
        if np.sign(z) == np.sign(v[i]) and abs(z) > 0.6 * most:
            phase = (abs(z) - 0.8 * most) / (0.4 * most)
            share = 0.5 + 0.5 * np.sin(np.pi * np.clip(phase, -0.5, 0.5))
        z += DT / FINE * v[i] * (1 - share * np.sign(v[i]) * z / most)
        out[i] = stiffness * z
    return out[::FINE]


def lugre(q, size, reach, fast):
    """Bristles of the LuGre model, by exponential steps."""
    x, v = fine(q)
    stiffness, z, out = size / (0.012 * reach), 0.0, np.empty(x.size)
    level = stribeck_size(v, size, fast, 0.5) / stiffness
    for i in range(x.size):
        end = level[i] * np.sign(v[i])
        z = end + (z - end) * np.exp(-abs(v[i]) * DT / FINE / level[i])
        out[i] = stiffness * z
    return out[::FINE]


LAWS = {f.__name__: f for f in (maxwell_slip, gms, elasto_plastic, lugre)}


def record(law, seed):
    """Arm, joint with the law, positions, torques and their noise."""
    rng = np.random.default_rng([20261126, list(ACCEPTED).index(law), seed])
    arm = Arm(rng)
    n = round(2 * SECONDS / DT)
    t, q, v, a = motion(rng, n)
    direction = np.sign(v)
    if law == "stops":
        q, v, a, direction = stopping(v)
    load = arm.rigid(q, v, a)
    friction = arm.viscous * v + arm.dry * direction
    j = int(rng.integers(2))
    size, fast, reach = 0.15 * load[:, j].std() + 0.3, np.abs(v[:, j]).max(), None
    reach = np.ptp(q[:, j])
    if law in LAWS:
        own = LAWS[law](q[:, j], size, reach, fast)
        friction[:, j] = arm.viscous[j] * v[:, j] + own
    elif law == "friction_by_position":
        friction[:, j] += size * (1 + 0.7 * np.sin(3 * q[:, j])) * np.sign(v[:, j])
    elif law == "tendon_friction":
        own = 0.7 * size * np.sign(v[:, 0] + 0.8 * v[:, 1])
        friction += np.outer(own, [1.0, 0.8])
    elif law == "tendon_spring":
        own = 1.5 * size * (q[:, 0] - 0.7 * q[:, 1])
        friction += np.outer(own, [1.0, -0.7])
    elif law == "gear_loss":
        drives = load[:, j] * v[:, j] > 0
        friction[:, j] += np.where(drives, 0.15, -0.1) * load[:, j]
    elif law == "warm_up":
        factor = 1 + 0.6 * np.exp(-t / 15.0)
        friction[:, j] = (friction[:, j] + size * np.sign(v[:, j])) * factor
    elif law == "two_coggings":
        phase = 2 * np.pi * q[:, j] / np.deg2rad([[23.0], [6.7]])
        friction[:, j] += size * (0.3 * np.sin(phase[0] + 1) + 0.25 * np.sin(phase[1]))
    tau = load + friction + arm.rotor * a
    noise = NOISE * tau.std(axis=0) * rng.normal(size=tau.shape)
    q = q + 2e-5 * rng.normal(size=q.shape)
    return arm, rng, j, q, tau + noise, noise


def judged(task):
    """Return the error over the noise on the joint of the law, names, wrong ones."""
    law, seed = task["law"], task["seed"]
    warnings.simplefilter("ignore")
    arm, rng, j, q, tau, noise = record(law, seed)
    n = len(q) // 2
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(arm.urdf(arm.described(rng)))
        start = time.process_time()
        loop = EffectDiscovery(RobotIdentifier(path, dt=DT), random_state=0)
        try:
            loop.fit(q[:n], tau[:n])
        except ValueError as error:
            print(f"{law} {seed} is refused: {error}")
            return task | {"ratio": np.inf, "names": [], "wrong": [], "seconds": np.nan}
        seconds = time.process_time() - start
    robot = loop.identifier_
    # The same rows and filter for the residual and the noise.
    seen, quiet = (robot.residuals(q, y) for y in (tau, tau - noise))
    later = slice(len(seen.residual) // 2, -20)
    left, quiet = seen.residual[later], quiet.residual[later]
    weight = 1.0 if ACCEPTED[law] else seen.weight[later]
    ratio = np.sqrt((weight * left**2).sum(0) / (weight * (left - quiet) ** 2).sum(0))
    names = [(e.name, e.joint) for e in loop.effects_]
    joints = (0, 1) if law in BOTH else (j,)
    wrong = [
        one for one in names if one[0] not in ACCEPTED[law] or one[1] not in joints
    ]
    found = {"ratio": ratio[j], "names": names, "wrong": wrong, "seconds": seconds}
    return task | found


def line(one):
    names = ", ".join(f"{name} {joint + 1}" for name, joint in one["names"])
    wrong = f"; {len(one['wrong'])} wrong" if one["wrong"] else ""
    return f"{one['law']} {one['seed']}: {one['ratio']:.2f}; {names}{wrong}"


def row(label, found):
    ratios = [one["ratio"] for one in found]
    counts = [sum(len(one[key]) for one in found) for key in ("names", "wrong")]
    seconds = np.nanmedian([one["seconds"] for one in found])
    figures = fixed([np.median(ratios), max(ratios)], 2)
    return [label, len(found), *figures, *counts, f"{seconds:.1f}"]


def main(argv=None):
    arguments = parser(__doc__, out=True, jobs=True, seeds=(11, 20))
    arguments.add_argument("--laws", nargs="+", choices=ACCEPTED, default=[*ACCEPTED])
    arguments = arguments.parse_args(argv)
    first, last = arguments.seeds
    laws = arguments.laws
    if arguments.quick:
        laws, last = ["maxwell_slip"], first
    tasks = [{"law": x, "seed": k} for x in laws for k in range(first, last + 1)]
    keys, out, jobs = ("law", "seed"), arguments.out, arguments.jobs
    ledger = run_study(judged, tasks, keys, out=out, jobs=jobs, line=line)
    groups = {x: [x] for x in laws}
    groups |= {"the four with memory": [x for x in MEMORY if x in laws], "all": laws}
    rows = [
        row(label, ledger.of([task for task in tasks if task["law"] in names]))
        for label, names in groups.items()
        if names
    ]
    headers = ["law", "cases", "error over the noise, median", "worst", "names"]
    headers += ["wrong names", "seconds"]
    text = (
        f"{rst_table(rows, headers)}\n\nArms of two joints, descriptions 20 % off, "
        "40 s fitted and the next 40 s predicted; seconds of processor time, median."
    )
    command = f"friction_memory.py --seeds {first} {last}"
    commits = ledger.commits(tasks)
    publish("friction_memory", text, arguments, command=command, commits=commits)


if __name__ == "__main__":
    main()
