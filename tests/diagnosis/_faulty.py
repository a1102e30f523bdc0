"""Small simulated recordings of robots with faulty geometry or torque channels."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.effects import TorqueGain
from tests.diagnosis._recordings import VISCOUS, record
from tests.effects._faults import measured

PLAIN = record("ZYX", seed=2)


def with_faults(faults, recording=PLAIN):
    """Record the same encoder readings on a robot with faults.

    Gains also scale the torques of other effects.
    """
    nv = recording.q.shape[1]
    states = np.hstack([recording.q, recording.v, recording.a])
    gains = np.ones(nv)
    for effect in faults:
        if isinstance(effect, TorqueGain):
            gains[effect.joint] = effect.gain
    friction = np.array(VISCOUS[:nv]) * recording.v
    # `Recording.torque` adds the friction again, without a gain.
    load = measured(recording.model, states, faults) + (gains - 1) * friction
    return replace(recording, load=load)
