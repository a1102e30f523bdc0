"""Small recordings of robots with faults in their geometry and channels."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa.effects import TorqueGain
from tests.diagnosis._recordings import VISCOUS, record
from tests.effects._faults import measured

PLAIN = record("ZYX", seed=2)


def with_faults(truth, recording=PLAIN):
    """Record the same motion, as encoders read it, on a robot with faults.

    Its `torque` is that of the faulty robot; gains are on what other effects add too.
    """
    nv = recording.q.shape[1]
    states = np.hstack([recording.q, recording.v, recording.a])
    gains = np.ones(nv)
    for effect in truth:
        if isinstance(effect, TorqueGain):
            gains[effect.joint] = effect.gain
    friction = np.array(VISCOUS[:nv]) * recording.v
    # `Recording.torque` adds the friction that passes channels without a gain.
    load = measured(recording.model, states, truth) + (gains - 1) * friction
    return replace(recording, load=load)
