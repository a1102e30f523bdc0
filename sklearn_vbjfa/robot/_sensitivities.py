"""Derivatives of simulated positions by parameters and by the start of the motion."""

# Along a simulated motion the torques that the drives produce, tau(q, v, a, theta), do
# not change. A small change of parameters therefore moves it by s with
#
#     M d2s/dt2 + D ds/dt + K s = -Phi dtheta,
#     M = dtau/da,  D = dtau/dv,  K = dtau/dq,
#
# where Phi is the regressor, columns of friction and effects among them. The equation
# is integrated by the implicit midpoint rule, which is stable for friction and springs
# of any steepness. For a joint that sticks it is replaced by zero velocity. Where a
# joint turns round, dry friction jumps by c, an impulse c delta(v) of D. In a step of
# length h with the mean acceleration a it has the mean c / (h abs(a)), and the midpoint
# rule then gives the jump of s that a shifted instant of turning causes, the ratio of
# the accelerations after and before.

from dataclasses import dataclass
from itertools import compress

import numpy as np

from sklearn_vbjfa.effects import OfChannel, declared_columns, own_motions
from sklearn_vbjfa.model import import_pinocchio
from sklearn_vbjfa.robot._equations import motion_of, regressor_rows
from sklearn_vbjfa.simulation import with_bodies

# Differences are taken over this share of a joint's range, top speed and acceleration.
_SHARE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Slopes:
    """Derivatives of the torques along a motion."""

    # (n, nv, nv): by accelerations, velocities and positions
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    # (n, nv): rise of the torque of a joint where its velocity passes through zero
    jump: np.ndarray
    Phi: np.ndarray  # (n, nv, p): by parameters


def slopes(predictor, recording, states):
    """Differentiate the torques of a robot along motions."""
    # predictor: `IdentifiedRobot`; recording: `Recording` with the segments and clock
    # of the motions; states (n, 3 nv). Returns `Slopes`, of true torques.
    mass, damping, stiffness = _of_bodies(predictor, states)
    extra = _differences(predictor, recording, states)
    rows = regressor_rows(
        recording,
        [states[part] for part in recording.segments],
        predictor.prediction_plan,
        predictor.features_,
        theta=predictor.load_parameters,
    )
    Phi = np.concatenate([one(slice(None)) for one in rows])
    Phi /= predictor.features_.gains_[:, None]
    Phi[:, :, held_parameters(predictor)] = 0.0
    return Slopes(
        mass=mass + extra.mass,
        damping=damping + extra.damping,
        stiffness=stiffness + extra.stiffness,
        jump=extra.jump,
        Phi=Phi,
    )


def held_parameters(predictor):
    """Return which parameters (p,) a simulation does not depend on as columns."""
    # Values of effects in the model, and effects that a simulation leaves out.
    held = [np.zeros(predictor.features_.n_parameters_, dtype=bool)]
    for effect in predictor.effects_:
        out = effect.in_model or bool(effect.not_simulated)
        held.append(np.full(len(effect.coefficients), out))
    return np.concatenate(held)


def _of_bodies(predictor, states):
    """Differentiate the rigid bodies' torques, three arrays (n, nv, nv)."""
    pin = import_pinocchio()
    model = with_bodies(predictor.features_.model_, predictor.inertial())
    data, nv = model.createData(), model.nv
    out = np.empty((3, states.shape[0], nv, nv))
    for i, (q, v, a) in enumerate(states.reshape(-1, 3, nv)):
        pin.computeRNEADerivatives(model, data, q, v, a)
        mass = np.triu(data.M)
        out[0, i] = mass + np.triu(mass, 1).T
        out[1, i], out[2, i] = data.dtau_dv, data.dtau_dq
    return out


def _beside_bodies(predictor, recording, states):
    """Torques (n, nv) of friction and effects, without those of the channels."""
    features, nv = predictor.features_, predictor.features_.n_joints_
    _, v, a = np.split(states, 3, axis=1)
    own = predictor.bodies(predictor.theta_)[:, 10:]
    columns = declared_columns(features.friction_, v, a)
    torque = np.einsum("njk,jk->nj", columns, own)
    # Effects whose torque depends on the state alone.
    moving = [
        not (e.in_model or isinstance(e, OfChannel) or e.not_simulated)
        for e in predictor.effects_
    ]
    if any(moving):
        known = {"theta": predictor.load_parameters}
        motion = motion_of(
            recording, states, predictor.prediction_plan, features, **known
        )
        held = own_motions(predictor.effects_, predictor.held, motion)
        coefs = predictor.split(predictor.theta_)
        for effect, coef, one in compress(zip(predictor.effects_, coefs, held), moving):
            which = slice(0, nv) if effect.whole_robot else effect.joint
            torque[:, which] += effect.columns(one) @ coef
    return torque


def _differences(predictor, recording, states):
    """`Slopes` of friction and effects, without `Phi`."""
    n, nv = states.shape[0], states.shape[1] // 3
    sizes = np.ptp(states, axis=0)
    sizes[nv:] = np.abs(states[:, nv:]).max(axis=0)
    steps = _SHARE * np.where(sizes > 0, sizes, 1.0)
    found = np.empty((3, n, nv, nv))
    jump = np.zeros((n, nv))

    def torque(column, values):
        other = states.copy()
        other[:, column] = values
        return _beside_bodies(predictor, recording, other)

    for column, step in enumerate(steps):
        kind, k = divmod(column, nv)
        here = states[:, column]
        rise = torque(column, here + step) - torque(column, here - step)
        found[kind, :, :, k] = rise / (2 * step)
        if kind == 1:
            # Across zero the difference is that of the jump, which is told apart.
            found[kind, np.abs(here) <= step, :, k] = 0.0
            both = np.full(n, step), np.full(n, -step)
            jump[:, k] = (torque(column, both[0]) - torque(column, both[1]))[:, k]
    stiffness, damping, mass = found
    return Slopes(mass=mass, damping=damping, stiffness=stiffness, jump=jump, Phi=None)


def propagate(found, states, dt):
    """Sensitivities of positions (L, W, nv, p + 2 nv) along W motions of L rows."""
    # By parameters, start positions and velocities. found: along one motion after the
    # other (n = W L); states (W, L, 3 nv); dt [s].
    W, L = states.shape[:2]
    nv = states.shape[2] // 3
    p = found.Phi.shape[2]
    shape = (W, L, nv, -1)
    v, a = states[:, :, nv : 2 * nv], states[:, :, 2 * nv :]
    stuck = (v == 0) & (a == 0)
    free = ~stuck[..., None]

    def middle(values):
        values = values.reshape(shape)
        return 0.5 * (values[:, :-1] + values[:, 1:])

    def moved(values):
        # Friction of a joint that sticks balances every change.
        return middle(np.where(free, values.reshape(shape), 0.0))

    M, D, K = middle(found.mass), moved(found.damping), moved(found.stiffness)
    # One that turns round in a row moves the new way there.
    way = np.where(v != 0, np.sign(v), np.sign(a))
    turns = way[:, :-1] * way[:, 1:] < 0
    if turns.any():
        mean = 0.5 * np.abs(a[:, :-1] + a[:, 1:])
        jump = middle(found.jump[..., None])[..., 0]
        own = np.einsum("wljj->wlj", M)
        # Its friction cannot send a joint back the way that it came.
        most = 2.0 * own / dt
        slope = np.divide(jump, dt * mean, out=most.copy(), where=dt * mean > 0)
        impulse = np.where(turns, np.clip(slope, 0.0, most), 0.0)
        D = D + impulse[..., None] * np.eye(nv)
    half = 0.5 * dt * D + 0.25 * dt**2 * K
    left, right = M + half, M - half
    ends = np.broadcast_to(stuck[:, 1:, :, None], left.shape)
    left = np.where(ends, np.eye(nv), left)
    drive = np.concatenate(
        [np.where(ends, 0.0, right), np.where(ends, 0.0, -dt * K)], axis=-1
    )
    push = np.where(stuck[:, 1:, :, None], 0.0, -dt * moved(found.Phi))
    drive, push = np.linalg.solve(left, drive), np.linalg.solve(left, push)
    out = np.zeros((L, W, nv, p + 2 * nv))
    position, velocity = np.zeros((2, W, nv, p + 2 * nv))
    position[:, :, p : p + nv] = np.eye(nv)
    velocity[:, :, p + nv :] = np.eye(nv) * ~stuck[:, 0, :, None]
    out[0] = position
    for k in range(L - 1):
        both = np.concatenate([velocity, position], axis=1)
        after = drive[:, k] @ both
        after[:, :, :p] += push[:, k]
        position = position + 0.5 * dt * (velocity + after)
        velocity = after
        out[k + 1] = position
    return out
