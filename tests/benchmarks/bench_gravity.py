"""Gravity correction from poses: error at other poses, coverage, payloads.

Run ``python tests/benchmarks/bench_gravity.py [--seeds FIRST LAST] [--data-home DIR]
[--write]``.

Data: arms of five to seven joints, simulated by Pinocchio (`_posed_arms.py`); Coulomb
friction of 5 to 30 % of the gravity torque, torque noise of 1 % and quantisation. Two
bodies of the description are off by 20 to 50 %; in the row "tool" the description is
right and carries 1 kg that it does not know. 20 poses, each held for a second, from
both sides or from one. Judged at 200 other poses against Pinocchio's gravity torque.
Measured sets (with ``--data-home``): their poses and slow motion, in four folds that
are contiguous in time, each judged by the fit to the others.
"""

import tempfile
from pathlib import Path

import numpy as np
from _posed_arms import Arm, gravity, pin, record, visit
from _report import fixed, parser, publish, rst_table, run_study

from sklearn_vbjfa import datasets
from sklearn_vbjfa.gravity import correct_gravity

ROWS = ("both sides", "one side", "tool")
TOOL = 1.0


def run(task):
    """Correct the description of one arm."""
    row, seed = task["row"], task["seed"]
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 8))
    arm = Arm.drawn(n, rng)
    described = arm if row == "tool" else arm.misdescribed(rng)
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder, "described.urdf"), Path(folder, "out.urdf")
        true, before = arm.write(Path(folder, "true.urdf")), described.write(path)
        if row == "tool":
            tool = pin.Inertia(TOOL, np.array([0.02, 0.0, 0.1]), 1e-3 * np.eye(3))
            true.inertias[n] += tool
        other = rng.uniform(-2.0, 2.0, (200, n))
        torque = gravity(true, other)
        size = np.sqrt((torque**2).mean(axis=0))
        friction = rng.uniform(0.05, 0.3, n) * np.maximum(size, 0.1 * size.max())
        poses = rng.uniform(-2.0, 2.0, (20, n))
        if row == "one side":
            poses = rng.uniform(0.06, 0.3, (20, n)).cumsum(axis=0) - 2.0
        q = visit(poses, row != "one side")
        found = correct_gravity(record(true, q, friction, rng), path)
        found.identifier.to_urdf(out)
        after = pin.buildModelFromUrdf(str(out))
    errors = [gravity(model, other) - torque for model in (before, after)]
    size = [float(np.sqrt((e**2).mean())) for e in errors]
    feels = found.gravity > 0
    held = np.abs(errors[1])[:, feels] <= found.interval_at(other)[:, feels]
    return {
        **task,
        "ratio": size[1] / size[0],
        "held": float(held.mean()),
        "payload": None if found.payload is None else found.payload[0],
        "said": (found.friction_known == (row != "one side")).all().item(),
    }


SETS = ("franka_panda", "kuka_lbr_med7", "ur5", "kuka_kr300", "tiago")
SETS += ("unitree_go2", "dfki_double_pendulum", "staubli_tx40")


def measured(data_home):
    """Text of the table of measured sets."""
    rows = []
    for name in SETS:
        recording = getattr(datasets, f"fetch_{name}")(data_home=data_home)
        found = correct_gravity(recording, recording.robot_model())
        before, after = found.error_before, found.error_after
        size = [np.sqrt((x**2).mean()) for x in (before, after)]
        better = f"{(after < 0.8 * before).sum()} of {before.size}"
        cells = [str(found.n_samples), *fixed(size, 3)]
        rows.append([name, *cells, *fixed([size[1] / size[0]], 2), better])
    heads = ["set", "samples", "described [N m]", "corrected [N m]", "ratio"]
    return rst_table(rows, [*heads, "joints better by 20 %"])


def report(results):
    """Text of the table."""
    rows = []
    for row in ROWS:
        some = [r for r in results if r["row"] == row]
        if not some:
            continue
        ratio = np.array([r["ratio"] for r in some])
        mass = [r["payload"] for r in some if r["payload"] is not None]
        numbers = [
            np.median(ratio),
            ratio.max(),
            100 * np.mean([r["held"] for r in some]),
            100 * len(mass) / len(some),
            np.median(mass) if mass else np.nan,
        ]
        rows.append([row, str(len(some)), *fixed(numbers, 2)])
    heads = [
        "poses",
        "arms",
        "error after / before, median",
        "largest",
        "inside 90 % intervals [%]",
        "payload named [%]",
        "its mass [kg], median",
    ]
    return rst_table(rows, heads)


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, data=True, out=True, jobs=True, seeds=(5000, 5049))
    arguments = arguments.parse_args(argv)
    first, last = arguments.seeds
    rows = ROWS[:1] if arguments.quick else ROWS
    seeds = range(first, first + 1 if arguments.quick else last + 1)
    tasks = [{"row": row, "seed": seed} for seed in seeds for row in rows]
    ledger = run_study(
        run, tasks, ("row", "seed"), out=arguments.out, jobs=arguments.jobs
    )
    text = f"Seeds {seeds[0]} to {seeds[-1]}.\n\n{report(ledger.of(tasks))}"
    if arguments.data_home:
        text += f"\n\nMeasured sets.\n\n{measured(arguments.data_home)}"
    publish(
        "gravity",
        text,
        arguments,
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
