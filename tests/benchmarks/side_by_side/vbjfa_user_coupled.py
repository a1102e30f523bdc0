"""Identify the TX40 with RobotIdentifier and its coupled wrist declared.

Run in a folder with robot.urdf, fitted.npz, held_out.npz and settings.json; writes
predicted.npy.
"""

import json
from pathlib import Path

import numpy as np

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.effects import Coupling

fitted, held_out = np.load("fitted.npz"), np.load("held_out.npz")
settings = json.loads(Path("settings.json").read_text(encoding="utf-8"))
wrist = (Coupling(4, 5, of="sum"), Coupling(5, 4, of="sum"))
robot = RobotIdentifier("robot.urdf", dt=float(fitted["dt"]), effects=wrist, **settings)
robot.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
np.save("predicted.npy", robot.predict(held_out["q"], groups=held_out["groups"]))
