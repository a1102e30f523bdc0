"""Export to URDF and MJCF: omitted effects, and their approximation."""

import warnings
from dataclasses import replace
from itertools import compress

import numpy as np
from scipy.optimize import lsq_linear

from sklearn_vbjfa.effects import (
    INERTIA,
    TORQUE,
    CommandDelay,
    CouplingSpring,
    Drift,
    InModel,
    OfChannel,
    OfSignals,
    OfTime,
    OnAllJoints,
    ToAnother,
    TorqueLag,
)
from sklearn_vbjfa.equations._features import follower_parameters, following_joints
from sklearn_vbjfa.equations._plan import effect_indices
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.model._dynamics import CorrectedModel
from sklearn_vbjfa.model._mjcf import JointDynamics, write_mjcf
from sklearn_vbjfa.model._trees import is_prismatic, with_bodies
from sklearn_vbjfa.model._urdf import check_possible, write_urdf
from sklearn_vbjfa.simulation import LeftOut, SimulationError, simulate


def plain_totals(robot):
    """Return the coefficients of `TERMS` in a file, (nv, 3)."""
    account = _Account(robot)
    return np.column_stack([account.passive(name) for name in TERMS])


def to_mjcf(path, robot, min_eigenvalues, notes=(), servo=None, added=None):
    """Write a `TorqueModel` as MJCF; return what is left out, `LeftOut` each."""
    # notes: more comments; servo: of position-controlled motors; added: see `refitted`.
    check_possible(robot.model, min_eigenvalues, "an MJCF file")
    account = _Account(robot, added)
    dynamics = _mjcf_dynamics(account, servo)
    level = CorrectedModel(robot.model)
    for j in np.flatnonzero(dynamics.ref):
        # The file states the zero by `ref` instead of the joint placement.
        level.move_zero(int(j), -float(dynamics.ref[j]))
    lines = [*_notes_of_mjcf(robot, dynamics, servo), *filter(None, notes)]
    write_mjcf(
        path,
        level.model,
        robot.bodies,
        dynamics,
        dt=robot.dt,
        note=_note(lines, account.left),
        followers=following_joints(robot),
        servo=servo,
    )
    return tuple(account.left)


def to_urdf(path, text, robot, min_eigenvalues, notes=(), turned_joints=None):
    """Write a `TorqueModel` into a copy of its URDF; see `to_mjcf`."""
    # text: of the description; turned_joints: see `write_urdf`.
    account = _Account(robot)
    joints = np.column_stack([account.passive("viscous"), account.passive("coulomb")])
    slides = is_prismatic(robot.model).tolist()
    lost = ("offset", "constant torque", TORQUE), ("rotor_inertia", "armature", INERTIA)
    for name, what, units in lost:
        for j, size in enumerate(account.total(name)):
            if size:
                reason = f"URDF has no {what} ({size:.3g} {units[slides[j]]})"
                account.leave(name, j, reason)
    for effect, coef in account.uses:
        if effect.files.urdf:
            account.leave_effect(effect, coef, effect.files.urdf)
    check_possible(robot.model, min_eigenvalues, "a URDF")
    write_urdf(
        text,
        path,
        robot.model,
        np.hstack([robot.bodies, joints]),
        _note(list(filter(None, notes)), account.left),
        turned_joints,
        follower_parameters(robot.effects, robot.coefficients),
    )
    return tuple(account.left)


def _note(lines, left):
    if left:
        listed = "".join(f"\n- {item}" for item in dict.fromkeys(map(str, left)))
        lines = [*lines, f"This file does not have:{listed}"]
    return "\n".join(lines)


def _notes_of_mjcf(robot, dynamics, servo):
    lines = [
        "The control of a motor is the reading of its torque channel [N m or N], and "
        "qpos that of the encoder [rad or m]; their order is that of the recording.",
    ]
    if servo is not None:
        lines = [
            "Controls of the motors, in the order of the recording, are commanded "
            "positions; these and positions are what the encoders read [rad or m]. "
            "With the gains kp and kd of a joint, a commanded velocity v and a torque "
            "ahead t count as (kd v + t) / kp of its position.",
        ]
        if servo.delay > 0:
            lines.append(
                f"Commands act {servo.delay:.4g} s late (delay, for MuJoCo 3.5 and "
                "newer). The history suits time steps from that of the file on, and "
                "begins with controls of zero: mj_initCtrlHistory takes others."
            )
    lines += [
        f"The encoder of {robot.joint_names[j]} reads {dynamics.ref[j]:.6g} at the "
        "zero of the description (ref)."
        for j in np.flatnonzero(dynamics.ref)
    ]
    lines += [
        f"The torque channel of {robot.joint_names[j]} reads {dynamics.gain[j]:.5g} "
        "times the torque (gainprm of its motor is the inverse)."
        for j in np.flatnonzero(dynamics.gain != 1)
    ]
    if dynamics.constant.any() or dynamics.slope.any():
        lines.append(
            "Constant torques, and springs without a stable rest, are biases of the "
            "motors (biasprm): they act in forward dynamics, and inverse dynamics "
            "leaves them to qfrc_actuator."
        )
    return lines


class _Account:
    """Parts of a `TorqueModel` that are written, and parts that are left out."""

    def __init__(self, robot, added=None):
        # added (nv, 3): to `TERMS`, see `refitted`.
        self.robot, self.left = robot, []
        self.uses = [
            (e, e.values - e.nominal if isinstance(e, InModel) else coef)
            for e, coef in zip(robot.effects, robot.coefficients)
        ]
        self._added = np.zeros((robot.n_joints, 3)) if added is None else added

    def leave(self, name, j, reason):
        where = self.robot.joint_names[j]
        item = LeftOut(name=name, joint=int(j), joint_name=where, reason=reason)
        self.left.append(item)

    def leave_effect(self, effect, coef, reason):
        """List an effect as left out unless its coefficients are zero."""
        if not np.any(coef):
            return
        fitted = self._added[effect.joint].any()
        if fitted and without_place(effect, np.asarray(coef)).any():
            reason = f"{reason} (friction of the file is fitted to it)"
        self.left.append(LeftOut.of(effect, self.robot.joint_names, reason))

    def total(self, name):
        """Sum of a declared coefficient and the effects of the same law, (nv,)."""
        total = np.zeros(self.robot.n_joints)
        if name in self.robot.friction_names:
            total += self.robot.friction[:, self.robot.friction_names.index(name)]
        for effect, coef in self.uses:
            if effect.files.parameter == name:
                total[effect.joint] += effect.in_file(coef).sum()
        if name in TERMS:
            total += self._added[:, TERMS.index(name)]
        return total

    def passive(self, name):
        """Total of a coefficient; negative ones are listed as left out."""
        total = self.total(name)
        for j in np.flatnonzero(total < 0):
            why = f"its coefficient is negative ({total[j]:.4g}), which would drive"
            self.leave(name, j, why)
        return np.maximum(total, 0.0)


def as_pinocchio(robot):
    """Return the `pin.Model` of a `TorqueModel`, with friction and rotor inertia."""
    account = _Account(robot)
    model = with_bodies(robot.model, robot.bodies, account.passive("rotor_inertia"))
    model.damping = account.passive("viscous")
    dry = account.passive("coulomb")
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -dry, dry
    return model


# -- MJCF ------------------------------------------------------------------------------


def _mjcf_dynamics(account, servo):
    robot, nv = account.robot, account.robot.n_joints
    damping, frictionloss, armature = (
        account.passive(name) for name in ("viscous", "coulomb", "rotor_inertia")
    )
    # Constant torque, stiffness about zero, and encoder reading at the described zero.
    constant, (spring, ref) = account.total("offset"), np.zeros((2, nv))
    joints = {"constant": constant, "spring": spring, "ref": ref}
    for effect, coef in account.uses:
        # Others are in the sums, the model, the gains, or are separate bodies.
        if not (effect.files.mjcf or effect.files.places):
            continue
        if isinstance(effect, CommandDelay) and servo is not None:
            if servo.delay < 0:
                why = "a file cannot say that commands act before they are given"
                account.leave_effect(effect, coef, why)
            continue
        left = dict(zip(effect.coefficients, map(float, coef)))
        for place, name in effect.files.places:
            joints[place][effect.joint] += left.pop(name)
        if left:
            rest = [left.get(name, 0.0) for name in effect.coefficients]
            account.leave_effect(effect, rest, effect.files.mjcf)
    stable = spring > 0
    springref = np.where(stable, -constant / np.where(stable, spring, 1.0), 0.0)
    return JointDynamics(
        damping=damping,
        frictionloss=frictionloss,
        armature=armature,
        stiffness=np.where(stable, spring, 0.0),
        springref=springref,
        ref=ref,
        constant=np.where(stable, 0.0, constant),
        slope=np.where(stable, 0.0, spring),
        gain=robot.gains,
        tendons=tuple(
            (*effect.joints, effect.ratio, *coef)
            for effect, coef in account.uses
            if isinstance(effect, CouplingSpring) and coef[0]
        ),
    )


# Joint attributes of MJCF, by the names of declared friction.
TERMS = ("coulomb", "viscous", "rotor_inertia")
_FITTED = TERMS[:2]
# Rows of the motion, relative frequencies of its sines, and the share of a joint's top
# speed below which its dry friction is indeterminate.
_ROWS, _FREQUENCIES, _REST = 6000, (0.35, 0.7, 1.0, 1.6), 0.02
# Number of windows in which the file is simulated, their length [s], and least rows.
_WINDOWS, _SECONDS, _LEAST = 6, 1.0, 20
# Largest change of the simulated positions, over their standard deviation.
_CHANGED = 0.02
# Range of a term of the file, over its identified value.
_FACTORS = np.array([0.5, 2.0])
UNSTABLE = "The identified robot cannot be simulated from torques without feedback"
# Effects that a motion without log does not have.
_APART = (OfChannel, OfSignals, OfTime, TorqueLag)
# A torque below this share of the joint's whole torque is rounding.
_ROUNDING = 1e-9


def without_place(effect, coef):
    """Coefficients (k,) of a law of motion that MJCF lacks, zero elsewhere."""
    others = isinstance(effect, (InModel, *_APART))
    others |= isinstance(effect, OnAllJoints) and bool(effect.files.simulation)
    if others or not effect.files.mjcf:
        return np.zeros(len(coef))
    written = [name for _, name in effect.files.places]
    return np.where(np.isin(effect.coefficients, written), 0.0, coef)


def typical_motion(ranges, nv, dt):
    """Return states (n, 3 nv) within the ranges of a fit, and the joints that move."""
    # ranges: `EffectRange` of at least one effect or friction term of each joint.
    t, by_joint = dt * np.arange(_ROWS), {r.joint: r for r in ranges}
    states, moves = np.zeros((3, _ROWS, nv)), np.zeros(nv, dtype=bool)
    rng = np.random.default_rng(0)
    for j, fitted in by_joint.items():
        low, high = fitted.position
        size, speed = 0.5 * (high - low), fitted.speed[1]
        phase = rng.uniform(0, 2 * np.pi, len(_FREQUENCIES))
        if not (size > 0 and speed > 0):
            continue
        moves[j] = True
        amplitude = size / len(_FREQUENCIES)
        omega = speed / (amplitude * np.sum(_FREQUENCIES)) * np.array(_FREQUENCIES)
        angle = np.multiply.outer(t, omega) + phase
        states[0, :, j] = 0.5 * (low + high) + amplitude * np.sin(angle).sum(axis=1)
        states[1, :, j] = amplitude * np.cos(angle) @ omega
        states[2, :, j] = -amplitude * np.sin(angle) @ omega**2
    return np.hstack(list(states)), moves


def refitted(robot, totals):
    """Fit friction of a file to the effects that it leaves out, changes (nv, 3)."""
    # totals (nv, 3): of `TERMS` in the file. Friction changes by a factor of two at
    # most, and armature never: what happens to correlate with the acceleration would
    # make a different plant for a controller. Torques by other joints are not fitted.
    nv, added = len(totals), np.zeros(totals.shape)
    free = _without_log(robot)
    left = [without_place(*x) for x in zip(free.effects_, free.split(free.theta_))]
    if not _is_known(robot) or not any(coef.any() for coef in left):
        return added
    states, moves = typical_motion(robot.effect_ranges_, nv, robot.plan.dt)
    # There and back, so that torques by position alone change no friction.
    back = states[::-1] * np.repeat([1, -1, 1], nv)
    states = np.vstack([states, back])
    v, a = states[:, nv : 2 * nv], states[:, 2 * nv :]
    plain = {"coulomb": np.sign(v), "viscous": v, "rotor_inertia": a}
    lacking = np.zeros(v.shape)
    inputs = free.prepare(states)
    (rows,) = free.regressors(inputs.recording, inputs.states, inputs.rest)
    for (effect, columns), coef in zip(rows.columns, left):
        if coef.any() and not isinstance(effect, (OnAllJoints, ToAnother)):
            j, name = effect.joint, effect.files.parameter
            lacking[:, j] += columns @ coef
            if name in plain:
                lacking[:, j] -= plain[name][:, j] * effect.in_file(coef).sum()
    for j in np.flatnonzero(moves & lacking.any(axis=0)):
        rows = np.abs(v[:, j]) > _REST * np.abs(v[:, j]).max()
        X = np.column_stack([plain[name][rows, j] for name in _FITTED])
        size, y = np.sqrt((X**2).mean(axis=0)), lacking[rows, j]
        total = np.maximum(totals[j, : len(_FITTED)], 0.0)
        least, most = (_FACTORS - 1.0)[:, None] * total
        ends = least * size - _ROUNDING, most * size + _ROUNDING
        change = np.clip(lsq_linear(X / size, y, ends).x / size, least, most)
        if ((y - X @ change) ** 2).sum() < (y**2).sum():
            added[j, : len(_FITTED)] = change
    return added


def _is_known(robot):
    return robot.plan.dt is not None and len(robot.effect_ranges_) > 0


def _without_log(robot):
    """Return the robot without effects that a motion without log does not have."""
    effects, ranges = robot.effects_, robot.effect_ranges_
    kept = [isinstance(x, Drift) or not isinstance(x, _APART) for x in effects]
    if all(kept):
        return robot
    pairs = zip(effect_indices(effects, robot.features_.n_parameters_), kept)
    gone = [i for (_, columns), keep in pairs if not keep for i in columns]
    n = len(ranges) - len(effects)
    out = replace(
        robot,
        plan=replace(robot.plan, effects=tuple(compress(effects, kept))),
        theta_=np.delete(robot.theta_, gone),
        effect_ranges_=(*ranges[:n], *compress(ranges[n:], kept)),
    )
    load = None if robot.load_parameters is None else out.next_load_parameters()
    return replace(out, load_parameters=load)


def warn_of_motion(robot, added, file_name):
    """Warn of joints that move differently in simulations of an MJCF file."""
    model = _without_log(robot).torque_model()
    left = [
        coef if isinstance(effect, Drift) else without_place(effect, coef)
        for effect, coef in zip(model.effects, model.coefficients)
    ]
    if not _is_known(robot) or not any(coef.any() for coef in left):
        return
    # Declared friction of the file.
    account = _Account(model, added)
    joints = {name: account.passive(name) for name in TERMS}
    joints["offset"] = account.total("offset")
    file = replace(
        model,
        friction_names=tuple(joints),
        friction=np.column_stack(list(joints.values())),
        coefficients=tuple(
            (x - gone) * (effect.files.parameter not in joints)
            for effect, x, gone in zip(model.effects, model.coefficients, left)
        ),
    )
    try:
        shares = changed_motion(robot, model, file)
    except ValueError as error:
        warnings.warn(f"{UNSTABLE}: {error}", DoubtWarning, stacklevel=3)
        return
    sizes = [
        f"{robot.joint_names_[j]} "
        + (f"{100 * shares[j]:.0f} %" if shares[j] <= 1 else "over 100 %")
        for j in np.argsort(-shares, kind="stable")
        if shares[j] > _CHANGED
    ]
    if sizes:
        warnings.warn(
            f"{file_name} moves differently from the identified robot "
            f"({', '.join(sizes)}). "
            "Percentages: difference of the positions within a second over their "
            "standard deviation. MuJoCo lacks such effects: simulate the saved robot "
            "(identified.json).",
            DoubtWarning,
            stacklevel=3,
        )


def changed_motion(robot, model, other):
    """Return the RMS change (nv,) of simulated positions, over their deviation."""
    # model, other: `TorqueModel`, both driven by the torques of the first in a typical
    # motion; infinite if the other diverges, `SimulationError` if the first diverges.
    nv, dt = model.n_joints, robot.plan.dt
    states, moves = typical_motion(robot.effect_ranges_, nv, dt)
    length, t = min(max(round(_SECONDS / dt), _LEAST), _ROWS), robot.clock(None, _ROWS)
    # A drift is compared within the log.
    _, end = robot.plan.time or (0.0, np.inf)
    n = max(length, np.searchsorted(t, end))
    starts = np.linspace(0, n - length, min(_WINDOWS, n // length)).astype(int)
    free = _without_log(robot)
    tau = free.torques(free.prepare(states))
    changes, spread = [], states[:, :nv].std(axis=0)
    for rows in (slice(start, start + length) for start in starts):
        q, v, _ = np.split(states[rows.start], 3)
        expected = _simulated(model, tau[rows], q, v, t[rows])
        try:
            changes.append(_simulated(other, tau[rows], q, v, t[rows]) - expected)
        except SimulationError:
            changes.append(np.full_like(expected, np.inf))
    squares = np.mean(np.square(changes), axis=(0, 1))
    return np.where(moves, np.sqrt(squares) / np.where(moves, spread, 1.0), 0.0)


def _simulated(model, tau, q, v, t):
    with warnings.catch_warnings():
        # Both simulations leave out the same effects.
        warnings.simplefilter("ignore")
        return simulate(model, tau, q, v, t)[:, : q.size]
