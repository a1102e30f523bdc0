"""Regressor rows of a robot with effects beside its rigid bodies."""

import functools

import numpy as np

from sklearn_vbjfa.effects import Effect, Motion, resolve
from sklearn_vbjfa.robot import _friction
from sklearn_vbjfa.robot._model import is_prismatic, joint_names

# Rows of the feature matrix that are in memory at once while loads are computed.
_LOAD_BYTES = 64 << 20
# Fits until the load in the effects' columns agrees with the parameters: the load is
# mostly gravity and inertia, which a first fit without those effects knows well.
_LOAD_PASSES = 3


def check_effects(effects, nv):
    """Return the effects as a tuple of instances, refusing what cannot be."""
    if isinstance(effects, (str, Effect)):
        effects = (effects,)
    found = tuple(resolve([effect])[0] for effect in effects)
    for effect in found:
        effect.check()
        if not 0 <= effect.joint < nv:
            raise ValueError(
                f"effects names joint {effect.joint} for {effect.name}; expected 0 to "
                f"{nv - 1}, for {nv} joint(s)."
            )
    keys = [(effect.key(), tuple(sorted(effect.shape().items()))) for effect in found]
    for key in keys:
        if keys.count(key) > 1:
            raise ValueError(f"effects holds {key[0][0]} on joint {key[0][1]} twice.")
    return found


def needs_load(effects):
    """Whether the columns depend on the parameters, through the load."""
    return any("load" in effect.needs for effect in effects)


def fit_passes(effects):
    """Effects of each fit: what asks for the load comes after a fit without."""
    if not needs_load(effects):
        return [effects]
    plain = tuple(e for e in effects if "load" not in e.needs)
    return [plain] + (_LOAD_PASSES - 1) * [effects]


def effect_names(effects, model):
    """Names and units of the effects' coefficients, two tuples of str."""
    joints, kinds = joint_names(model), is_prismatic(model)
    names, units = [], []
    for effect in effects:
        kind = int(kinds[effect.joint])
        names += [
            f"{joints[effect.joint]}:{effect.name}:{c}" for c in effect.coefficients
        ]
        units += [unit[kind] for unit in effect.units]
    return tuple(names), tuple(units)


def make_motion(features, states, t, parts, theta=None, bandwidth=np.inf, rest=None):
    """Signals that effects are made from.

    Parameters
    ----------
    features : RigidBodyFeatures
        Loaded features.
    states : ndarray of shape (n, 3 * nv)
        States.
    t : ndarray of shape (n,) or None
        Time [s].
    parts : list of slice
        Recordings.
    theta : ndarray of shape (p,) or None
        Parameters of the features, for the load; None for none.
    bandwidth : float
        Cut-off of the low-pass [Hz].
    rest : Rest or None
        What to take for the sign of velocities, see `Motion`.
    """
    nv = features.n_joints_
    load = torque = rigid = None
    if theta is not None:
        parameters = theta.reshape(nv, -1)
        inertial = np.ascontiguousarray(parameters[:, :10])
        tree = features._regressor
        q, v, a = np.split(states, 3, axis=1)
        load = tree.torques(q, v, a, inertial)
        friction = _friction.columns(features._friction, v, a, rest)
        torque = load + np.einsum("njk,jk->nj", friction, parameters[:, 10:])

        def rigid(q, v, a):
            return tree.torques(q, v, a, inertial)

    @functools.cache
    def last_body():
        out = np.empty((states.shape[0], nv, 10))
        for piece in _pieces(features, states.shape[0]):
            Phi = features._compute(states[piece]).reshape(-1, nv, nv, _width(features))
            out[piece] = Phi[:, :, -1, :10]
        return out

    return Motion(
        q=states[:, :nv],
        v=states[:, nv : 2 * nv],
        a=states[:, 2 * nv :],
        t=t,
        load=load,
        torque=torque,
        parts=tuple(parts),
        prismatic=np.asarray(is_prismatic(features._model), dtype=bool),
        rigid=rigid,
        last_body=last_body,
        bandwidth=float(bandwidth),
        rest=rest,
    )


def _width(features):
    return features.n_parameters_ // features.n_joints_


def _pieces(features, n):
    rows = max(1, _LOAD_BYTES // (8 * features.n_joints_ * features.n_parameters_))
    return [slice(i, min(i + rows, n)) for i in range(0, n, rows)]


def _rigid_support(features):
    """Entries of the features that some motion makes, (nv, p), bool."""
    nv = features.n_joints_
    entries = np.zeros((nv, nv, _width(features)), dtype=bool)
    entries[:, :, :10] = features._regressor.carried[:, :, None] & ~features._zeros
    entries[np.arange(nv), np.arange(nv), 10:] = True
    return entries.reshape(nv, -1)


class RegressorRows:
    """Regressor matrices of any stretch of rows, with the effects' columns appended.

    The effects remember (hysteresis, time), so that their columns are made once for
    the whole recordings; the rigid-body regressor is made where it is asked for.

    Parameters
    ----------
    features : RigidBodyFeatures
        Loaded features.
    states : ndarray of shape (n, 3 * nv) or SplineStates
        States.
    effects : tuple of Effect
        Effects.
    motion : Motion or None
        Their signals; None without effects.
    rest : Rest or None
        What to take for the sign of velocities, see `Motion`.

    Attributes
    ----------
    n_joints, n_parameters : int
        Size of a regressor matrix.
    support : ndarray of shape (n_joints, n_parameters), bool
        Entries that are not zero in every motion.
    """

    def __init__(self, features, states, effects=(), motion=None, rest=None):
        self._features = features
        self._states = states
        self._rest = rest
        for effect in effects:
            reason = effect.applies(motion)
            if reason:
                raise ValueError(
                    f"effects holds {effect.name} on joint {effect.joint}: {reason}."
                )
        self._set_columns([(effect, effect.columns(motion)) for effect in effects])

    def _set_columns(self, columns):
        self._columns = columns
        features = self._features
        extra = sum(len(effect.coefficients) for effect, _ in columns)
        self.n_joints = features.n_joints_
        self.n_parameters = features.n_parameters_ + extra
        self.support = np.zeros((self.n_joints, self.n_parameters), dtype=bool)
        self.support[:, : features.n_parameters_] = _rigid_support(features)
        at = features.n_parameters_
        for effect, values in columns:
            stop = at + values.shape[-1]
            joints = slice(None) if effect.whole_robot else effect.joint
            self.support[joints, at:stop] = True
            at = stop

    def part(self, rows):
        """Regressor matrices of one recording alone, numbered from zero."""
        other = object.__new__(RegressorRows)
        other._features, other._states = self._features, self._states[rows]
        other._rest = self._rest
        other._set_columns([(effect, values[rows]) for effect, values in self._columns])
        return other

    def __call__(self, piece):
        """Regressor matrices (n, nv, p) of a slice of rows."""
        Phi = self._features._compute(self._states[piece], self._rest)
        if not self._columns:
            return Phi
        out = np.zeros((*Phi.shape[:2], self.n_parameters))
        at = Phi.shape[2]
        out[:, :, :at] = Phi
        for effect, columns in self._columns:
            stop = at + columns.shape[-1]
            if effect.whole_robot:
                out[:, :, at:stop] = columns[piece]
            else:
                out[:, effect.joint, at:stop] = columns[piece]
            at = stop
        return out
