"""Torques state by state: what a state of a control loop costs.

Run as ``python tests/benchmarks/bench_step.py [--states 20000] [--write]``. Robots with
random bodies get the torques of a random motion one state at a time, with friction
(viscous, Coulomb, offset, rotor inertia) and with one of every effect of the library
that has no need of the future. Beside the time stand that of Pinocchio's inverse
dynamics alone, and the largest difference from the torques of all rows together.
"""

import time

import numpy as np
from _report import add_root_to_path, parser, publish, rst_table

from sklearn_vbjfa import effects
from sklearn_vbjfa.simulation import Stepper

JOINTS = (1, 6, 7, 12)
HEADERS = [
    "robot",
    "joints",
    "effects",
    "state, median [us]",
    "99 % [us]",
    "inverse dynamics alone [us]",
    "off, of the torque's spread",
]


def each(function, rows):
    """Return times of calls [s], and what the calls return."""
    times, found = [], []
    for row in rows:
        started = time.perf_counter()
        made = function(*row)
        times.append(time.perf_counter() - started)
        found.append(made.copy())
    return times, np.array(found)


def measure(n_joints, names, n_states):
    """Return effects in use, times of states and of inverse dynamics, and how far off.

    names : effects of the library; the last number is a share of the torque's spread.
    """
    import pinocchio as pin

    add_root_to_path()
    from tests.simulation._random_robots import random_motion, random_predictor, without

    rng = np.random.default_rng(0)
    predictor = random_predictor(rng, n_joints, names, length=n_states)
    stepper = Stepper(predictor.torque_model())
    left = {(one.name, one.joint) for one in stepper.left_out_}
    kept = without(
        predictor,
        [k for k, e in enumerate(predictor.effects_) if (e.name, e.joint) in left],
    )
    X = random_motion(rng, n_joints, n_states)
    warmth = rng.normal(size=n_states)
    rows = [(*np.split(x, 3), None, {"warmth": w}) for x, w in zip(X, warmth.tolist())]
    times, torque = each(stepper.step, rows)
    used = {name for effect in kept.effects_ for name in effect.recorded}
    signals = {name: warmth for name in used}
    expected = kept.torques(kept.prepare(X, signals=signals))
    off = np.abs(torque - expected).max() / expected.std(axis=0).max()
    model = predictor.features_.model_
    data = model.createData()
    alone, _ = each(
        lambda q, v, a: pin.rnea(model, data, q, v, a), [r[:3] for r in rows]
    )
    return len(kept.effects_), times, alone, off


def report(joints=JOINTS, n_states=20_000):
    """Table of the guide."""
    table = []
    for label, names in (("friction", ()), ("whole library", effects.available())):
        for n_joints in joints:
            n, times, alone, off = measure(n_joints, names, n_states)
            median, slow = 1e6 * np.quantile(times, [0.5, 0.99])
            bare = 1e6 * np.median(alone)
            cells = [f"{median:.1f}", f"{slow:.1f}", f"{bare:.1f}", f"{off:.0e}"]
            table.append([label, n_joints, n, *cells])
    return rst_table(table, HEADERS)


def main():
    """Run from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument("--states", type=int, default=20_000)
    arguments = arguments.parse_args()
    publish("step", report(n_states=arguments.states), write=arguments.write)


if __name__ == "__main__":
    main()
