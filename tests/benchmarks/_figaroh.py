"""FIGAROH 1.x on a set: its user script in a process of another environment."""

import json
import os
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from scipy import signal

SCRIPTS = Path(__file__).resolve().parent / "side_by_side"
FILES = ("figaroh_user.py", "figaroh_user_kept.py")
# Imported before the clock starts.
MODULES = "figaroh,pinocchio,scipy.signal,pandas,picos,cvxopt"
_START = """
import importlib, json, runpy, sys, time
modules, *sys.argv = sys.argv[1:]
for name in modules.split(","):
    importlib.import_module(name)
started = time.perf_counter()
runpy.run_path(sys.argv[0], run_name="__main__")
with open("seconds.json", "w") as file:
    json.dump(time.perf_counter() - started, file)
"""


def speeds(part, sos):
    """Absolute speeds [rad/s], (n_samples, nv), of smoothed positions."""
    result = np.empty_like(part["q"])
    for rows in recordings(part):
        smooth = signal.sosfiltfilt(sos, part["q"][rows], axis=0)
        result[rows] = np.abs(np.gradient(smooth, part["dt"], axis=0))
    return result


def recordings(part):
    """Row numbers of each recording."""
    return [np.flatnonzero(part["groups"] == x) for x in np.unique(part["groups"])]


def held_out_error(predicted, part, fitted, cutoff, standstill):
    """Root mean square of the torque residual over the deviation of the torque."""
    sos = signal.butter(4, cutoff, fs=1 / part["dt"], output="sos")
    if isinstance(standstill, str):
        standstill = 0.02 * np.quantile(speeds(fitted, sos), 0.995, axis=0)
    counted = speeds(part, sos) > standstill
    torque = np.empty_like(part["tau"])
    residual = np.empty_like(torque)
    margin = round(2 / cutoff / part["dt"])
    for rows in recordings(part):
        torque[rows] = signal.sosfiltfilt(sos, part["tau"][rows], axis=0)
        missed = part["tau"][rows] - predicted[rows]
        residual[rows] = signal.sosfiltfilt(sos, missed, axis=0)
        counted[rows[:margin]] = counted[rows[len(rows) - margin :]] = False
    error = [
        np.sqrt(np.mean(missed[which] ** 2)) / true[which].std()
        for missed, true, which in zip(residual.T, torque.T, counted.T)
    ]
    return np.array(error), counted.sum(axis=0)


def write_description(source, target):
    """Copy a URDF without its shapes: FIGAROH asks for the mesh files they name."""
    tree = ET.parse(source)
    for link in tree.getroot().iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    tree.write(target, encoding="utf-8", xml_declaration=True)


def run_figaroh(python, urdf, parts, settings, arguments):
    """Return predicted torques, whether it refused a physical fit, seconds, parameters.

    parts : fitted and held-out mappings; settings : text of its YAML file.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write_description(urdf, folder / "robot.urdf")
        for key, part in zip(("fitted", "held_out"), parts):
            arrays = {k: part[k] for k in ("q", "tau", "groups", "dt")}
            np.savez(folder / f"{key}.npz", **arrays)
        (folder / "settings.yaml").write_text(settings, encoding="utf-8")
        for file in FILES:
            shutil.copy(SCRIPTS / file, folder)
        threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        answer = subprocess.run(
            [python, "-c", _START, MODULES, FILES[-1], *arguments],
            cwd=folder,
            env={**os.environ, **dict.fromkeys(threads, "1"), "MPLBACKEND": "Agg"},
            capture_output=True,
            encoding="utf-8",
            check=False,
        )
        if answer.returncode != 0:
            last = answer.stderr.strip().splitlines()[-1]
            raise RuntimeError(f"FIGAROH ended with an error: {last}")
        kept = folder / "parameters.json"
        return (
            np.load(folder / "predicted.npy"),
            "Reported estimate: none" in answer.stdout,
            json.loads((folder / "seconds.json").read_text(encoding="utf-8")),
            json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else None,
        )
