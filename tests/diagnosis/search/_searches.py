"""Searches on recordings whose torques are known, for the tests of their parts."""

import numpy as np

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search._search import EffectSearch
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.recording._recording import take_arrays
from tests.diagnosis._recordings import record

CLEAN = record("ZY", seed=2)


def coulomb(size):
    return lambda r: size * np.sign(r.v[:, 1])


def spring(k, c=0.0):
    return lambda r: k * r.q[:, 0] + c


def stribeck(size):
    def torque(r):
        v = r.v[:, 1]
        return (1.0 + size * np.exp(-np.abs(v / 0.3))) * np.sign(v)

    return torque


def search(torque, library, recording=CLEAN, robot=None, groups=None, **given):
    robot = recording.robot() if robot is None else robot
    groups = np.zeros(torque.shape[0], int) if groups is None else groups
    robot.fit(recording.position, torque, groups=groups)
    weight = np.ones_like(torque)
    measured = take_arrays(
        recording.position,
        torque,
        groups,
        weight,
        recording.t,
        dt=robot.dt,
        joint_names=robot.joint_names_,
    )
    return EffectSearch(
        view=RecordingView(robot, measured),
        library=effects.resolve(library),
        **{"alpha": 0.05, **given},
    )


def found(run):
    return [(e.name, e.joint) for e in run.effects]
