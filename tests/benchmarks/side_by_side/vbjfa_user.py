"""Identify a robot with RobotIdentifier.

Run in a folder with robot.urdf, fitted.npz, held_out.npz and settings.json; writes
predicted.npy.
"""

import json
from pathlib import Path

import numpy as np

from sklearn_vbjfa import RobotIdentifier

fitted, held_out = np.load("fitted.npz"), np.load("held_out.npz")
settings = json.loads(Path("settings.json").read_text(encoding="utf-8"))
robot = RobotIdentifier("robot.urdf", dt=float(fitted["dt"]), **settings)
robot.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
left = robot.residuals(held_out["q"], held_out["tau"], groups=held_out["groups"]).rms()
for name, times in zip(robot.joint_names_, left / robot.noise_floor_):
    print(f"{name}: residual on held-out data is {times:.1f} times the noise floor")
np.save("predicted.npy", robot.predict(held_out["q"], groups=held_out["groups"]))
