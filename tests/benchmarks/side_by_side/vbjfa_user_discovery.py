"""Find what a robot's model lacks with EffectDiscovery, and identify it with that.

Run in a folder with robot.urdf, fitted.npz, held_out.npz and settings.json; writes
predicted.npy.
"""

import json
from pathlib import Path

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

fitted, held_out = np.load("fitted.npz"), np.load("held_out.npz")
settings = json.loads(Path("settings.json").read_text(encoding="utf-8"))
declared = RobotIdentifier("robot.urdf", dt=float(fitted["dt"]), **settings)
loop = EffectDiscovery(declared, random_state=0)
loop.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
print(loop.report_)
# The search keeps a quarter of the data for its own check.
robot = clone(loop.identifier_)
robot.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
np.save("predicted.npy", robot.predict(held_out["q"], groups=held_out["groups"]))
