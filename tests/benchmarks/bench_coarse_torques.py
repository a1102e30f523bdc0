"""Torques recorded in coarse steps: whether the loop ends, and what it names.

Run ``python tests/benchmarks/bench_coarse_torques.py [--trials N] [--seed S]
[--out FILE] [--write]``. Simulated arms of one to six joints with viscous and Coulomb
friction, encoder noise and white torque noise; the torque of every joint is rounded to
steps of 0.05 to 0.5 of its spread. Nothing is missing beyond the four plain terms. Each
recording declares another set of them, so that every cell has all sixteen.

Asked for: no exception, no name.
"""

import itertools
import time
import warnings

import numpy as np
from _ledger import Ledger
from _report import parser, publish, rst_table
from _undeclared_robots import draw_motion, inverse_dynamics, nominal_robot

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

DT, SECONDS = 0.02, 40.0
STEPS = (0.05, 0.1, 0.2, 0.3, 0.5)
JOINTS = (1, 2, 3, 4, 5, 6)
# Friction, torque noise in shares of the rigid bodies' torque; encoder noise [rad].
VISCOUS, COULOMB, NOISE, ENCODER = 0.1, 0.1, 0.02, 2e-5
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
DECLARED = tuple(
    chosen for k in range(5) for chosen in itertools.combinations(PLAIN, k)
)


def arm(n_joints, rng):
    """Random arm of some joints; a single one turns about a horizontal axis."""
    import pinocchio as pin

    if n_joints > 1:
        return nominal_robot("serial", rng, n_joints)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint_1")
    centre = pin.SE3(np.eye(3), rng.uniform(0.05, 0.15, size=3))
    model.inertias[joint] = centre.act(pin.Inertia.FromBox(4.0, 0.1, 0.15, 0.3))
    return model


def record(n_joints, step, seed):
    """Simulate a recording: model, positions and torques (n, nv)."""
    rng = np.random.default_rng([n_joints, seed])
    model = arm(n_joints, rng)
    t = np.arange(0.0, SECONDS, DT)
    motion = draw_motion(np.ones(model.nv), 0.9, t, rng)
    q, v, a = motion.at(t)
    load = inverse_dynamics(model, q, v, a)
    spread = load.std(axis=0) + 1e-3
    tau = load + spread * VISCOUS * v / v.std(axis=0) + spread * COULOMB * np.sign(v)
    tau = tau + spread * NOISE * rng.normal(size=tau.shape)
    size = step * tau.std(axis=0)
    return model, q + ENCODER * rng.normal(size=q.shape), size * np.round(tau / size)


def run(task):
    """Close the loop on one recording, as a dict."""
    model, q, tau = record(task["joints"], task["step"], task["seed"])
    declared = DECLARED[task["seed"] % len(DECLARED)]
    identifier = RobotIdentifier(model, dt=DT, friction=declared)
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.perf_counter()
    result = {**task, "declared": declared, "names": [], "error": "", "status": ""}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            loop.fit(q, tau)
    except Exception as error:  # counted and shown: the table is about it
        result["error"] = f"{type(error).__name__}: {error}"
    else:
        result["names"] = [[e.name, e.joint] for e in loop.effects_]
        result["status"] = loop.report_.status
        result["unsearched"] = len(loop.report_.outcome.unsearched)
    return {**result, "seconds": time.perf_counter() - started}


def report(results):
    """Text with the table."""
    rows = []
    for joints, step in itertools.product(JOINTS, STEPS):
        own = [r for r in results if (r["joints"], r["step"]) == (joints, step)]
        if not own:
            continue
        rows.append(
            [
                str(joints),
                f"{step:g}",
                len(own),
                len({tuple(r["declared"]) for r in own}),
                sum(bool(r["error"]) for r in own),
                sum(bool(r["names"]) for r in own),
                f"{sum(r.get('unsearched', 0) for r in own) / len(own):.1f}",
                f"{np.median([r['seconds'] for r in own]):.1f}",
            ]
        )
    heads = ["joints", "step / spread", "recordings", "declared sets", "exceptions"]
    heads += ["with a name", "joints not searched", "s, median"]
    told = [
        f"{r['joints']} joints, step {r['step']:g}, seed {r['seed']}: "
        + (r["error"] or ", ".join(f"{n} {j + 1}" for n, j in r["names"]))
        for r in results
        if r["error"] or r["names"]
    ]
    total = len(results)
    failed, named = (sum(bool(r[key]) for r in results) for key in ("error", "names"))
    return "\n\n".join(
        [
            f"{total} recordings of {SECONDS:g} s at {1 / DT:g} Hz: {failed} "
            f"exceptions, {named} with a name.",
            rst_table(rows, heads, n_labels=2),
            *told,
        ]
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=20)
    arguments.add_argument("--seed", type=int, default=0, help="first seed")
    arguments.add_argument("--out", default=None, metavar="FILE")
    arguments = arguments.parse_args(argv)
    seeds = range(arguments.seed, arguments.seed + arguments.trials)
    tasks = [
        {"joints": joints, "step": step, "seed": seed}
        for joints, step, seed in itertools.product(JOINTS, STEPS, seeds)
    ]
    ledger = Ledger(arguments.out, ("joints", "step", "seed"))
    for task in ledger.missing(tasks):
        ledger.add(run(task))
    publish("coarse_torques", report(ledger.of(tasks)), write=arguments.write)


if __name__ == "__main__":
    main()
