"""
=========================================
What do the models of real robots lack?
=========================================

Four measured robots: a slide (EMPS), a UR5, a Staubli TX40 and a KUKA KR300. Their
models include friction and still lack something; the loop says on which joint, and how
much that lowers the error on held-out data.

To take seconds and not minutes, it looks only for a few effects that the publications
of the sets make likely, in parts of the recordings or in means of neighbouring samples.
``docs/evidence.md`` has the whole library on ten sets.
"""

# %%
# The recordings
# --------------
# They are not part of the package. The environment variable SKLEARN_VBJFA_DATA names
# the folder that holds them, by default scikit-learn's data folder. Nothing is
# downloaded here.

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import (
    fetch_emps,
    fetch_kuka_kr300,
    fetch_staubli_tx40,
    fetch_ur5,
)

DATA_HOME = os.environ.get("SKLEARN_VBJFA_DATA")

# %%
# For each set: recordings used (all, if none is named), number of samples averaged,
# low-pass [Hz], speed at or below which a joint stands still [rad/s], and the effects
# looked for. Declared are the four plain terms.

PLANS = {
    "emps": dict(
        fetch=fetch_emps,
        select=("DATA_EMPS",),
        average=1,
        cutoff=20.0,
        standstill="auto",
        effects=["asymmetric_friction", "stribeck"],
    ),
    "ur5": dict(
        fetch=fetch_ur5,
        select=("No6",),
        average=2,
        cutoff=8.0,
        standstill=0.03,
        effects=["load_friction", "stribeck"],
    ),
    "staubli_tx40": dict(
        fetch=fetch_staubli_tx40,
        select=(),
        average=10,
        cutoff=25.0,
        standstill="auto",
        effects=["coupling", "load_friction"],
    ),
    "kuka_kr300": dict(
        fetch=fetch_kuka_kr300,
        select=(),
        average=1,
        cutoff=12.0,
        standstill=0.02,
        effects=["counterbalance", "spring", "load_friction"],
    ),
}


def load(plan):
    """Return (recording, model); None if a file of the set is not here."""
    try:
        recording = plan["fetch"](data_home=DATA_HOME, download_if_missing=False)
        if plan["select"]:
            recording = recording.select(*plan["select"])
        return recording, recording.robot_model()
    except FileNotFoundError:
        return None


loaded = {name: load(plan) for name, plan in PLANS.items()}
missing = [name for name, found in loaded.items() if found is None]

# %%
# The loop
# --------
# A mean of neighbouring samples is one sample of a slower clock; incomplete means at
# the end of a recording are left out.


def averaged(recording, count):
    """Positions, torques and labels (n // count, ...) of each recording."""
    parts = []
    for label in range(len(recording.group_names)):
        rows = np.flatnonzero(recording.groups == label)
        n = rows.size // count
        rows = rows[: n * count].reshape(n, count)
        parts.append(
            (
                recording.q[rows].mean(axis=1),
                recording.tau[rows].mean(axis=1),
                np.full(n, label),
            )
        )
    return [np.concatenate(columns) for columns in zip(*parts)]


def close_loop(plan, recording, model):
    """Look for the effects of a plan."""
    declared = RobotIdentifier(
        model,
        dt=recording.dt * plan["average"],
        cutoff=plan["cutoff"],
        standstill=plan["standstill"],
    )
    loop = EffectDiscovery(declared, effects=plan["effects"], random_state=0)
    q, tau, groups = averaged(recording, plan["average"])
    return loop.fit(q, tau, groups)


errors = {}
for name, found in loaded.items():
    if found is None:
        continue
    loop = close_loop(PLANS[name], *found)
    errors[name] = loop.error_before_, loop.error_after_
    print(f"--- {name}: {loop.report_.headline}")
    for effect in loop.effects_:
        saved = 100 * effect.evidence.gain
        values = ", ".join(
            f"{symbol} = {effect.parameters[symbol]:.3g} {effect.units[symbol]}".strip()
            for symbol in effect.intervals
        )
        print(f"{effect.joint_name}: {effect.name}, {values}; saves {saved:.0f} %")

# %%
# Without the recordings
# ----------------------
# The table of the benchmark stands in for them: another declared model (viscous
# friction alone), the whole library, the whole recordings.

if missing:
    tables = [
        Path("docs", "tables", f"measured_sets_{stage}.rst")
        for stage in ("development", "confirmation")
    ]
    print(
        f"not here: {', '.join(missing)}; get them with the loaders of "
        f"sklearn_vbjfa.datasets, or name their folder in SKLEARN_VBJFA_DATA. Shown "
        f"for them: {' and '.join(map(str, tables))}, declared with viscous friction "
        "alone."
    )
    # Above the script in a checkout (no __file__ where the gallery is built), or here.
    for folder in (*Path(sys.argv[0]).resolve().parents, Path.cwd()):
        if all((folder / table).is_file() for table in tables):
            texts = [(folder / table).read_text(encoding="utf-8") for table in tables]
            print("\n".join(texts))
            rows = [line.split() for line in "\n".join(texts).splitlines()]
            for name in missing:
                errors[name] = [
                    np.array(row[2:], dtype=float) / 100
                    for model in ("declared", "completed")
                    for row in rows
                    if row[:2] == [name, model]
                ]
            break
    else:
        print("They are part of the repository, and not here either.")

# %%
# Before and after
# ----------------
# Root mean square of the residual on stretches that took no part in the fit or the
# search, over the standard deviation of the torque in the moving time of the whole
# recording. Above the dashed line the mean of the torque would have been a better
# prediction; do not trust the model there.

figure, axes = plt.subplots(2, 2, sharey=True, layout="constrained", figsize=(8, 6))
for axis, name in zip(axes.flat, PLANS):
    axis.set_title(name)
    if name not in errors:
        continue
    before, after = errors[name]
    joints = 1 + np.arange(len(before))
    axis.vlines(joints, 100 * after, 100 * before, color="0.8", lw=3.0)
    axis.plot(joints, 100 * before, "o", color="0.6", label="declared model")
    axis.plot(joints, 100 * after, "o", color="C0", label="completed model")
    axis.axhline(100.0, color="C3", lw=1.0, ls="--", label="mean of the torque")
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:g}")
    axis.set_xticks(joints)
    axis.set_xlim(0.5, len(joints) + 0.5)
    axis.set_xlabel("joint")
    axis.set_ylabel("error [%]")
drawn = [axis for axis in axes.flat if axis.lines]
if drawn:
    drawn[0].legend()
plt.show()
