"""A recording as the search for effects sees it: filtered rows, blocks, columns."""

from dataclasses import replace

import numpy as np

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._blocks import (
    Whitening,
    correlation_time,
    make_blocks,
)
from sklearn_vbjfa.diagnosis.search._regression import Equations, FoldMoments
from sklearn_vbjfa.recording._recording import check_clock, contiguous_groups
from sklearn_vbjfa.robot._equations import make_motion
from sklearn_vbjfa.robot._identifier import equations_of, states_of

# Full-rate columns that are in memory at once.
_COLUMN_BYTES = 128 << 20


class RecordingView:
    """Filtered equations of a recording, and effects' columns behind the same filter.

    Parameters
    ----------
    robot : RobotIdentifier
        Fitted to the recording with the declared model.
    X, y : ndarray
        Positions or states, torques.
    groups : array-like or None
        Labels of recordings.
    sample_weight : ndarray of shape (n, nv)
        Weights.
    t : ndarray or None
        Time [s].
    leave_out : sequence of int
        Joints whose torque channel tells nothing.
    recording : ndarray of shape (n,) or None
        Number of the recording that each row is from, where `groups` cut recordings in
        pieces; None where they do not.
    begins : tuple of float or None
        When recordings begin [s], if their first rows are not given.
    """

    def __init__(
        self,
        robot,
        X,
        y,
        groups,
        sample_weight,
        t,
        leave_out=(),
        recording=None,
        begins=None,
    ):
        self.robot = robot
        sample_weight = np.array(sample_weight, dtype=float)
        sample_weight[:, list(leave_out)] = 0.0
        self.parts = contiguous_groups(groups, X.shape[0])
        self.clock = check_clock(t, X.shape[0], robot.dt)
        self.states = states_of(robot, X, groups)
        self.lowpass = _lowpass.design(robot.dt or 1.0, robot.cutoff_)
        made = equations_of(robot, X, y, groups, sample_weight, self.clock)
        index, Phi, tau, weight = made.index, made.Phi, made.tau, made.weight
        self.index = index
        self.equations = Equations(Phi=Phi, tau=tau, weight=weight)
        self.root = np.sqrt(weight)
        self.target = (tau * self.root).T
        self.nv = tau.shape[1]
        self.step = (robot.dt or 1.0) * self.lowpass.step
        edges = np.array([part.start for part in self.parts])
        self.starts = np.unique(np.searchsorted(index, edges))
        self.starts = self.starts[self.starts < index.size]
        if recording is None:
            sizes = [part.stop - part.start for part in self.parts]
            recording = np.repeat(np.arange(len(self.parts)), sizes)
        self.recording = recording[index]
        self._begins = begins
        self._cache = {}
        self._first_fit()

    def _first_fit(self):
        """Blocks, joint weights and reduced coordinates from the declared model."""
        robot = self.robot
        weights = robot.estimator_.joint_weights_
        self.precision = np.where(self.root.any(axis=0), weights, 0.0)
        residual = self.equations.tau - self.equations.Phi @ robot.theta_unconstrained_
        correlation = correlation_time(
            residual, self.equations.weight, self.step, self.starts
        )
        # What the low-pass spreads in time: the width of its main lobe.
        length = max(1.0 / robot.cutoff_, self.step)
        self.correlation_time = correlation
        self.blocks = make_blocks(
            self.index * (robot.dt or 1.0), self.starts, correlation, length
        )
        self.Z, self.back = self.equations.reduce(self.precision)
        self.moments = FoldMoments(self.Z, self.target, self.blocks.folds())
        # Effects' columns are brought to the size of the declared ones.
        self.size = np.sqrt(np.mean(self.Z**2) * self.Z.shape[0]) or 1.0
        self.ridge = None

    def whitening(self, residual, root=None):
        """Return what takes the memory of residuals (nv, m) out of rows.

        They are scaled by the root of their weights (m, nv), the recording's own
        unless given.
        """
        root = self.root if root is None else root
        return Whitening(residual, root, self.starts, self.step, self.robot.cutoff_)

    def motion(self, theta):
        """Signals at the full rate; the load from reduced coordinates or None."""
        rigid = self.robot.features_.n_parameters_
        parameters = None if theta is None else (self.back @ theta)[:rigid]
        motion = make_motion(
            self.robot.features_,
            self.states,
            self.clock,
            self.parts,
            parameters,
            self.robot.cutoff_,
        )
        return replace(motion, begins=self._begins)

    def filtered(self, columns):
        """Filter full-rate columns (n, ...) as the torques were."""
        return np.concatenate([self.lowpass(columns[part]) for part in self.parts])

    def joints_of(self, effect):
        """Joints whose torque an effect changes."""
        return list(range(self.nv)) if effect.whole_robot else [effect.joint]

    def columns(self, effects, motion):
        """Columns of a family of effects, ndarray of shape (nj, m, c, k).

        Parameters
        ----------
        effects : list of Effect
            One effect with different shape parameters.
        motion : Motion
            Signals.
        """
        joints = self.joints_of(effects[0])
        k = len(effects[0].coefficients)
        out = np.empty((len(joints), self.index.size, len(effects), k))
        for c, effect in enumerate(effects):
            filtered = self.filtered(effect.columns(motion))
            for i, j in enumerate(joints):
                own = filtered[:, j] if effect.whole_robot else filtered
                out[i, :, c] = own * self.root[:, j, None]
        return out

    def family(self, effect, motion):
        """Shapes of an effect and their columns; kept unless they follow the load."""
        key = (effect.name, effect.joint)
        if key not in self._cache:
            shapes = effect.shapes(motion)
            variants = [_shaped(effect, shape) for shape in shapes]
            if not variants:
                return [], None
            columns = self.columns(variants, motion)
            if "load" in effect.needs:
                return variants, columns
            self._cache[key] = variants, columns
        return self._cache[key]


def _shaped(effect, shape):
    from sklearn.base import clone

    return clone(effect).set_params(**shape)
