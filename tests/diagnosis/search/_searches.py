"""Searches on simulated recordings, for tests of their parts."""

from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.search._posterior import search as posterior
from sklearn_vbjfa.diagnosis.search._stepwise import StepwiseSearch
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.recording import take_arrays
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


@dataclass(frozen=True, eq=False)
class Search:
    """Inputs of a search."""

    view: RecordingView
    library: tuple
    settings: SearchSettings = field(default_factory=SearchSettings)
    alpha: float = 0.05
    max_effects: int | None = None

    def path(self):
        """Return the path to the most probable model."""
        return StepwiseSearch(self.view, self.library, self.settings, self.max_effects)

    def run(self):
        """Run the search and return its result."""
        return posterior(
            self.view, self.library, self.settings, self.alpha, self.max_effects
        )


def view_of(torque, recording=CLEAN, robot=None, groups=None):
    """Return the filtered equations of a recording."""
    robot = recording.robot() if robot is None else robot
    groups = np.zeros(torque.shape[0], int) if groups is None else groups
    robot.fit(recording.position, torque, groups=groups)
    measured = take_arrays(
        recording.position,
        torque,
        groups,
        np.ones_like(torque),
        recording.t,
        dt=robot.dt,
        joint_names=robot.joint_names_,
    )
    return RecordingView(robot, measured)


def search(torque, library, recording=CLEAN, robot=None, groups=None, **options):
    view = view_of(torque, recording, robot, groups)
    return Search(view=view, library=effects.resolve(library), **options)


def found(run):
    """Return name and joint of each reported effect."""
    return [(f.effect.name, f.effect.joint) for f in run.findings if not f.warning]
