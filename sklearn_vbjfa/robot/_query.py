"""Motion whose torques are asked for: its states, and which rows can be judged."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.effects import Rest
from sklearn_vbjfa.recording._recording import Recording

# Periods of the cut-off at each end in which the smoother sees one side only, ...
_EDGE_PERIODS = 1.0
# ... but at most this share of a recording.
_EDGE_SHARE = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class Query:
    """Rows of a recording without torques.

    Attributes
    ----------
    recording : Recording
        The rows, with their clock.
    states : ndarray of shape (n, 3 * nv)
        States in the band of the fit.
    rest : Rest
        Velocity signs at rest.
    smoother : StateEstimator or None
        What the states come from; None if they were given.
    """

    recording: Recording
    states: np.ndarray
    rest: Rest
    smoother: object = None

    def noiseless(self, plan):
        """Return the same query, its states taken for those of the robot."""
        nothing = np.zeros(self.recording.nv)
        return replace(self, rest=plan.rest(nothing))

    def signals(self, features, inertial=None):
        """Return positions, speeds, directions and, with inertial parameters, loads.

        Arrays of shape (n, nv) by their names in `EffectRange`.
        """
        q, v, a = np.split(self.states, 3, axis=1)
        found = {"position": q, "speed": np.abs(v), "direction": np.sign(v)}
        if inertial is not None:
            found["load"] = features.torques(q, v, a, inertial)
        return found

    def counts(self, standstill):
        """Rows in which each signal can be judged, (n, nv), bool, by its name.

        Not those in which the smoother sees one side only, nor those without weight; a
        joint at rest has no speed, as in the fit.
        """
        shape = self.states.shape[0], self.recording.nv
        inner = np.zeros(shape, dtype=bool)
        for part in self.recording.segments:
            edge = self._edge(part.stop - part.start)
            inner[part.start + edge : part.stop - edge] = True
        if self.recording.weight is not None:
            inner &= self.recording.weight > 0
        speeds = np.abs(self.states[:, shape[1] : 2 * shape[1]])
        moves = inner & (speeds > standstill)
        return {"position": inner, "speed": moves, "load": inner, "direction": moves}

    def _edge(self, n):
        if self.smoother is None:
            return 0
        slowest = self.smoother.cutoff_.min()
        if not np.isfinite(slowest):
            return 0
        rows = int(_EDGE_PERIODS / (slowest * self.smoother.dt))
        return min(rows, int(_EDGE_SHARE * n))
