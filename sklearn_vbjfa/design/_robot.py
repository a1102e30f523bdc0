"""A robot before the design of a motion: parameters, noise, and its equations.

The torque of a joint is a sum of columns: of the bodies, and of effects, those that the
model has and those that it may lack. All are functions of the states; their derivatives
by the states, contracted with what a criterion says of each entry, are its gradient.
"""

from collections import namedtuple
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.effects import InModel, Motion, Rest, RotorInertia, Stateful, resolve
from sklearn_vbjfa.equations._features import RigidBodyFeatures
from sklearn_vbjfa.equations._plan import cutoff_of
from sklearn_vbjfa.model import is_prismatic, joint_names, nominal_parameters

# Friction of a robot of which only the description is known.
_FRICTION = ("viscous", "coulomb")
# Noise of a torque that nobody has measured, over the torque limit.
_GUESSED_NOISE = 0.01
# Smoothed states end at about three times the bandwidth of the motion: twice that of
# least acceleration error would attenuate it, half would let noise through.
_STATE_BAND = 3.0
# Step of positions [rad or m]; velocities and accelerations take steps of one, by which
# the bodies' columns have exact differences: they are of second and of first degree.
_STEP = 1e-4
# Relative step of what effects depend on.
_RELATIVE_STEP = 1e-5
# Power outside the span of other columns below which a column is in it.
IN_SPAN = 1e-6
# Rows by which is probed what a column depends on.
_PROBES = 60


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownRobot:
    """A robot, identified or only described."""

    # bodies alone, without friction, as effects correct the robot
    features: RigidBodyFeatures
    inertial: np.ndarray  # (nv, 10): of the bodies
    effects: tuple  # friction and effects of the model, each on its joint
    coefficients: tuple
    joint_names: tuple
    # (nv,): deviation in the band of the fit [N m or N]; nan if not known
    torque_noise: np.ndarray
    cutoff: float  # that band [Hz]
    # (nv,): deviation of one sample of the positions [rad or m]; 0 if unknown
    encoder_noise: np.ndarray
    description: object = None  # with the geometry, if it is a URDF file

    @classmethod
    def of(cls, model):
        """Make it of a path, a model or an identified robot."""
        if isinstance(model, cls):
            return model
        if hasattr(type(model), "robot_"):
            return cls._identified(model.robot_)
        features = RigidBodyFeatures(model, friction=()).load()
        nv = features.n_joints_
        effects = _on_all_joints(_FRICTION, nv)
        return cls(
            features=features,
            inertial=nominal_parameters(features.model_),
            effects=effects,
            coefficients=tuple(np.zeros(1) for _ in effects),
            joint_names=joint_names(features.model_),
            torque_noise=np.full(nv, np.nan),
            cutoff=np.inf,
            encoder_noise=np.zeros(nv),
            description=model,
        )

    @classmethod
    def _identified(cls, robot):
        full = robot.features_
        nv = full.n_joints_
        friction = robot.bodies(robot.theta_)[:, 10:].T
        effects = [*_on_all_joints(full.friction_, nv)]
        coefficients = list(friction.reshape(-1, 1))
        for effect, values in zip(robot.effects_, robot.split(robot.theta_)):
            # Effects in the model are part of `model_`.
            if not isinstance(effect, InModel):
                effects.append(effect)
                coefficients.append(np.atleast_1d(values))
        variance = getattr(robot.plan.state_estimator, "noise_variance_", np.zeros(nv))
        encoder = np.sqrt(np.broadcast_to(variance, (nv,)))
        # The noise floor also has encoder noise, which depends on the motion; the
        # residual of the model, if neither is known, is larger.
        floor, residual = robot.noise_floor_, robot.output_noise_
        noise = np.array(floor if robot.torque_noise_ is None else robot.torque_noise_)
        residual = np.full(nv, np.nan) if residual is None else residual
        return cls(
            features=RigidBodyFeatures(full.model_, friction=()).load(),
            inertial=robot.bodies(robot.theta_)[:, :10],
            effects=tuple(effects),
            coefficients=tuple(coefficients),
            joint_names=robot.joint_names_,
            torque_noise=np.where(np.isfinite(noise), noise, residual)
            / np.abs(full.gains_),
            cutoff=float(robot.cutoff_),
            encoder_noise=np.where(np.isnan(encoder), 0.0, encoder),
            description=robot.source,
        )

    def band(self, highest, dt):
        """Band of a fit to a motion up to a frequency [Hz]; see `resolve_cutoff`."""
        return min(cutoff_of(highest, dt), 0.4 / dt)

    def noise(self, limits, reference, highest, dt):
        """Noise deviation of each joint's equations in the band (nv,)."""
        # Torque noise is assumed white, and so is encoder noise, which enters through
        # the inertia: white position noise with deviation s has in a band B an
        # acceleration of variance 2 dt s^2 (2 pi)^4 B^5 / 5.
        band = self.band(highest, dt)
        size = np.abs(self.features.torques(*np.split(reference, 3, 1), self.inertial))
        largest = np.where(np.isinf(limits.torque), size.max(axis=0), limits.torque)
        ratio = band / self.cutoff if np.isfinite(self.cutoff) else 1.0
        measured = self.torque_noise * np.sqrt(ratio)
        torque = np.where(measured > 0, measured, _GUESSED_NOISE * largest)
        states = min(_STATE_BAND * highest, band)
        acceleration = 2 * dt * self.encoder_noise**2 * (2 * np.pi) ** 4
        acceleration = acceleration * states**5 / 5
        inertia = self.inertia(reference[:100, : largest.size])
        return np.sqrt(torque**2 + inertia**2 @ acceleration)

    def inertia(self, q):
        """Root mean squares of the mass matrix over poses (nv, nv), rotors included."""
        nv = q.shape[1]
        still, inertial = np.zeros_like(q), np.ascontiguousarray(self.inertial)
        at_rest = self.features.torques(q, still, still, inertial)
        mass = np.empty((len(q), nv, nv))
        for k, unit in enumerate(np.eye(nv)):
            moved = self.features.torques(q, still, still + unit, inertial)
            mass[:, :, k] = moved - at_rest
        for effect, values in zip(self.effects, self.coefficients):
            if isinstance(effect, RotorInertia):
                mass[:, effect.joint, effect.joint] += values[0]
        return np.sqrt((mass**2).mean(axis=0))


def _on_all_joints(names, nv):
    return tuple(
        clone(effect).set_params(joint=j)
        for effect in (resolve(names) if names else ())
        for j in range(nv)
    )


# -- equations -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Columns of an effect and what they depend on."""

    effect: object  # at its joint
    inputs: tuple  # signals that its columns depend on, such as ("v", 2)

    @classmethod
    def of(cls, effect, motion):
        """Find the inputs of an effect from a motion in which all signals vary."""
        before, inputs = effect.columns(motion), []
        for name in ("q", "v", "a", "load", "torque"):
            for joint, values in enumerate(getattr(motion, name).T):
                moved = _moved(motion, name, joint, np.ptp(values) * 1e-2 + 1e-6)
                if not np.array_equal(effect.columns(moved), before):
                    inputs.append((name, joint))
        return cls(effect, tuple(inputs))

    def everywhere(self, motion):
        """Columns on all joints (n, nv, k)."""
        return self.effect.in_all(self.effect.columns(motion), motion.n_joints)

    def contracted(self, motion, slopes):
        """Sum of the columns times derivatives by rows (n_joints, k, n), (n,)."""
        columns = self.effect.columns(motion)
        columns = columns[:, None] if columns.ndim == 2 else columns
        return np.einsum("njk,jkn->n", columns, slopes)


def _moved(motion, name, joint, step):
    values = getattr(motion, name).copy()
    values[:, joint] += step
    return replace(motion, **{name: values}, _speeds={})


# States (n, 3 nv) of a motion, columns (k_j, n) that act on each joint, and the
# `Motion` from which effects were computed.
MotionEquations = namedtuple("MotionEquations", "states rows motion")


class EquationModel:
    """Columns of a robot and of effects, for any motion."""

    # inertial (nv, 10): for the load; still (nv,): speeds below which a joint may be at
    # rest; reference (n, 3 nv): states at which columns are compared; bandwidth: of the
    # fit [Hz]; base: parameters whose columns span the model; places: columns that act
    # on each joint; n_model, n_columns: without and with further effects.

    def __init__(
        self, features, inertial, effects, *, n_members, still, reference, bandwidth
    ):
        self.features, self.bandwidth = features, bandwidth
        self._theta = np.ascontiguousarray(inertial).ravel()
        nv = self.nv = features.n_joints_
        self._rest = Rest(speed=np.zeros(nv), time=np.zeros(nv), noise=still)
        self.prismatic = np.asarray(is_prismatic(features.model_), dtype=bool)
        self._of_joint, self._of_parameter = np.nonzero(features.support_)
        entries = features.entries(reference).T
        probe = self._motion(reference[:_PROBES], entries[:, :_PROBES])
        self.effects = [EffectColumns.of(effect, probe) for effect in effects]
        self.n_members = n_members
        self._choose_base(entries, self._motion(reference, entries))
        self._number()

    def _choose_base(self, entries, motion):
        """Select the bodies' columns that are independent of the model's effects."""
        n, nv = motion.q.shape
        friction = [x.everywhere(motion) for x in self.effects[: self.n_members]]
        friction = np.concatenate([np.zeros((n, nv, 0)), *friction], axis=2)
        bodies = np.zeros((n, nv, self._theta.size))
        bodies[:, self._of_joint, self._of_parameter] = entries.T
        # Torques and forces have different units: scale rows by the joint's load.
        unit = or_one(np.sqrt((motion.load**2).mean(axis=0)))[:, None]
        A, B = (x.reshape(n * nv, -1) for x in (friction / unit, bodies / unit))
        size = np.linalg.norm(B, axis=0)
        seen = np.flatnonzero(size > 1e-9 * size.max(initial=0.0))
        B = B[:, seen] / size[seen]
        Q, _ = np.linalg.qr(A / or_one(np.linalg.norm(A, axis=0)))
        B = B - Q @ (Q.T @ B)
        R, pivots = qr(B, mode="r", pivoting=True)
        rank = np.count_nonzero(np.diag(R) ** 2 > IN_SPAN**2)
        self.base = np.sort(seen[pivots[:rank]])

    def _number(self):
        """Assign numbers to the columns of the bodies, and then of the effects."""
        place = np.full(self._theta.size, -1)
        place[self.base] = np.arange(self.base.size)
        kept = np.flatnonzero(place[self._of_parameter] >= 0)
        joints = self._of_joint[kept]
        self._kept_of = [kept[joints == j] for j in range(self.nv)]
        places = [list(place[self._of_parameter[k]]) for k in self._kept_of]
        self.spans, first = [], self.base.size
        for columns in self.effects:
            span = range(first, first + len(columns.effect.coefficients))
            self.spans.append(slice(span.start, span.stop))
            for j in columns.effect.acts_on(self.nv):
                places[j] += span
            first = span.stop
        ends = [self.base.size, *(span.stop for span in self.spans)]
        self.n_model, self.n_columns = ends[self.n_members], ends[-1]
        self.places = tuple(np.array(numbers, dtype=int) for numbers in places)

    def _motion(self, states, entries, t=None):
        """Signals of states, with the load of the bodies."""
        q, v, a = np.split(states, 3, axis=1)
        load, inertial = np.zeros_like(q), self._theta.reshape(self.nv, -1)
        weighted = entries * self._theta[self._of_parameter][:, None]
        for j in range(self.nv):
            load[:, j] = weighted[self._of_joint == j].sum(axis=0)
        return Motion(
            q=q,
            v=v,
            a=a,
            t=np.arange(len(q)) / (20.0 * self.bandwidth) if t is None else t,
            load=load,
            torque=load,
            prismatic=self.prismatic,
            rigid=lambda q, v, a: self.features.torques(q, v, a, inertial),
            bandwidth=self.bandwidth,
            rest=self._rest,
        )

    def __call__(self, states, t=None):
        """Return the `MotionEquations` of states (n, 3 nv) at times (n,) [s]."""
        entries = self.features.entries(states).T
        motion = self._motion(states, entries, t)
        rows = [[entries[kept]] for kept in self._kept_of]
        for columns in self.effects:
            values = columns.everywhere(motion)
            for j in columns.effect.acts_on(self.nv):
                rows[j].append(values[:, j].T)
        return MotionEquations(states, tuple(map(np.concatenate, rows)), motion)

    def pulled_back(self, equations, by_rows, z, basis):
        """Gradients by the states (n, 3 nv), and by coordinates of the curve."""
        # by_rows: derivatives of a criterion by the entries of the rows, nv of (k_j,
        # n). The second gradient (nv, size) is that of columns with memory, which are
        # differentiated along the motion (z, basis).
        motion = equations.motion
        by_states, by_z = np.zeros_like(equations.states), np.zeros_like(z)
        by_load = np.zeros((len(motion.q), self.nv))
        row = [len(kept) for kept in self._kept_of]
        for columns in self.effects:
            effect = columns.effect
            joints, width = effect.acts_on(self.nv), len(effect.coefficients)
            slopes = np.array([by_rows[j][row[j] : row[j] + width] for j in joints])
            for j in joints:
                row[j] += width
            if not slopes.any():
                continue
            if isinstance(effect, Stateful):
                _add_along(columns, slopes, motion, z, basis, by_z)
            else:
                self._add_by_signals(columns, slopes, motion, by_states, by_load)
        by_entries = (
            self._theta[self._of_parameter][:, None] * by_load.T[self._of_joint]
        )
        for j, kept in enumerate(self._kept_of):
            by_entries[kept] += by_rows[j][: len(kept)]
        self._add_by_bodies(equations.states, by_entries, by_states)
        return by_states, by_z

    def _add_by_signals(self, columns, slopes, motion, by_states, by_load):
        """Add derivatives of an effect's columns by central differences."""
        places = {"q": 0, "v": 1, "a": 2}
        for name, joint in columns.inputs:
            h = _RELATIVE_STEP * max(np.ptp(getattr(motion, name)[:, joint]), _STEP)
            ends = (_moved(motion, name, joint, step) for step in (h, -h))
            ahead, behind = (columns.contracted(end, slopes) for end in ends)
            change = (ahead - behind) / (2 * h)
            if name in places:
                by_states[:, places[name] * self.nv + joint] += change
            else:
                # For effects, the load is also the torque of the whole model.
                by_load[:, joint] += change

    def _add_by_bodies(self, states, by_entries, by_states):
        """Add derivatives of the bodies' columns, contracted, to (n, 3 nv)."""
        nv = self.nv
        h = np.repeat([_STEP, 1.0], [nv, 2 * nv])
        k = np.arange(3 * nv)
        # All steps are evaluated in one call, since calls cost more than samples.
        # Columns are linear in the accelerations.
        moved = np.repeat(states[None], 5 * nv + 1, axis=0)
        moved[k, :, k] += h[:, None]
        both = k[: 2 * nv]
        moved[3 * nv + both, :, both] = moved[both, :, both] - 2 * h[both, None]
        entries = self.features.entries(moved.reshape(-1, 3 * nv)).T
        entries = entries.reshape(len(entries), len(moved), -1)
        for i in k:
            if i < 2 * nv:
                change = (entries[:, i] - entries[:, 3 * nv + i]) / (2 * h[i])
            else:
                change = entries[:, i] - entries[:, -1]
            by_states[:, i] += np.einsum("en,en->n", change, by_entries)


def _add_along(columns, slopes, motion, z, basis, by_z):
    """Add derivatives of columns with memory by the coordinates of their joint."""
    j = columns.effect.joint
    now = columns.contracted(motion, slopes).sum()
    h = _RELATIVE_STEP * max(np.abs(z[j]).max(), 1e-3)
    for i in range(z.shape[1]):
        moved = {}
        for name, part in zip("qva", basis):
            moved[name] = getattr(motion, name).copy()
            moved[name][:, j] += h * part[:, i]
        ahead = columns.contracted(replace(motion, **moved, _speeds={}), slopes)
        by_z[j, i] += (ahead.sum() - now) / h
