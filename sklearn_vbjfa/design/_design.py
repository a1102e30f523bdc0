"""Design of exciting trajectories."""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.utils import check_random_state

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.design._collisions import Clearance
from sklearn_vbjfa.design._criterion import (
    Questions,
    condition_number,
    information_of,
    promise,
    worth,
)
from sklearn_vbjfa.design._equations import IN_SPAN, EquationModel
from sklearn_vbjfa.design._known_robot import KnownRobot
from sklearn_vbjfa.design._limits import (
    POSES,
    MotionLimits,
    MotionRefused,
    rounded_up,
)
from sklearn_vbjfa.design._motion import DesignedMotion, FourierCurve
from sklearn_vbjfa.design._open_questions import (
    asked_effects,
    is_steered,
    open_effects,
    read_report,
)
from sklearn_vbjfa.design._optimise import INSIDE, Problem, excess, optimise, shrunk
from sklearn_vbjfa.recording import check_dt

# Harmonics: few keep the motion smooth, many give it slow and fast parts.
_FEWEST, _MOST = 5, 25
# Frequency of the motion over that at which speed and acceleration are at their limits
# together.
_SPREAD = 2.0
# The low-pass of the fit, at five times the bandwidth, needs that many samples.
_PER_SAMPLE = 0.06
# Random motions of which the best is improved, and states at which columns are
# compared.
_DRAWN, _STARTS, _REFERENCE = 40, 3, 600
# Share of the torque limits that may go into holding a start.
_HELD = 0.85
# Share of the limits within which motions are drawn.
_DRAWN_INSIDE = 0.95
# Margin to all limits at ten times the sampling of the design.
MARGIN, _FINER = 0.02, 10
# Smallest distance between bodies of a motion [m].
ROOM = 0.01


def design_motion(
    model,
    *,
    duration,
    dt,
    limits=None,
    effects=(),
    report=None,
    start=None,
    random_state=None,
):
    r"""Design an exciting trajectory.

    The trajectory is a finite Fourier series in each joint, periodic, at rest at its
    start and end, within limits of position, velocity, acceleration and torque, and
    free of self-collision if the description has collision geometry. It maximises the
    determinant of the information matrix of base parameters and friction, with a
    penalty on the condition number [1]_ [2]_. With `report` or `effects` it also
    separates effects that are not distinguishable yet [3]_.

    Parameters
    ----------
    model : str, os.PathLike, pinocchio.Model, RobotIdentifier or IdentifiedRobot
        URDF file or model, or a robot that was identified from earlier recordings,
        which provides torques and noise.
    duration : float
        Length of the motion, one period [s].
    dt : float
        Sample period of motion and recording [s].
    limits : MotionLimits, default=None
        Limits; None uses those of the description.
    effects : sequence of str or Effect, default=()
        Effects to excite and to distinguish; a name means the effect on every joint.
    report : EffectDiscovery, Report, str or os.PathLike, default=None
        Open questions: a fitted search, its report, or the folder that the command
        ``identify`` wrote.
    start : array-like of shape (nv,), default=None
        Positions at the start and end [rad or m]; None chooses them.
    random_state : int, RandomState instance or None, default=None
        Seed of the initial motions.

    Returns
    -------
    DesignedMotion
        The motion, its margins, and the effects that it excites.

    Raises
    ------
    TypeError
        If `limits` is not a `MotionLimits`, or `report` is not a report.
    ValueError
        If the limits are missing or infeasible, `start` is outside them, or `duration`
        is too short for the slowest joint.

    Warns
    -----
    UserWarning
        If the encoder noise of an identified robot is unknown; it counts as zero.

    Notes
    -----
    With the columns :math:`x` of the model and the noise :math:`\sigma_j` of joint j in
    the band of the fit, the information matrix is :math:`M = \sum x x^T / \sigma_j^2`
    over joints and independent samples, without those at standstill. The objective is
    :math:`\tfrac12 \log\det M_{AA} - 2 n \log \kappa(M_{AA}^{1/2})` for the n columns
    of the model, scaled by their size at random states within the limits, with a smooth
    condition number :math:`\kappa`. For each pair of effects to distinguish, the
    remaining evidence is added; see ``docs/design.rst``. The gradient is exact, and the
    optimum is local.

    References
    ----------
    .. [1] J. Swevers, C. Ganseman, D. B. Tukel, J. De Schutter, H. Van Brussel,
       "Optimal robot excitation and identification", IEEE Trans. Robot. Autom. 13(5),
       1997. :doi:`10.1109/70.631234`
    .. [2] M. Gautier, W. Khalil, "Exciting trajectories for the identification of base
       inertial parameters of robots", Int. J. Robot. Res. 11(4), 1992.
       :doi:`10.1177/027836499201100408`
    .. [3] A. C. Atkinson, V. V. Fedorov, "The design of experiments for discriminating
       between two rival models", Biometrika 62(1), 1975.
       :doi:`10.1093/biomet/62.1.57`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.design import design_motion
    >>> urdf = load_demo_recording().urdf
    >>> motion = design_motion(urdf, duration=3.0, dt=0.05, random_state=0)
    >>> motion.q.shape, motion.within_limits
    ((60, 6), True)
    """
    rng = check_random_state(random_state)
    task = pose(
        model,
        duration=duration,
        dt=dt,
        limits=limits,
        effects=effects,
        report=report,
        start=start,
        rng=rng,
    )
    problem = task.problem
    fine = np.arange(_FINER * problem.times().size) * (problem.times()[1] / _FINER)
    found, first = optimise(problem, best_drawn(problem, rng), fine, 1.0 - MARGIN)
    z = shrunk(problem, found, fine, 1.0 - MARGIN)
    return _made(task, z, first, fine)


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignTask:
    """A motion that is asked for."""

    problem: Problem
    robot: KnownRobot
    noise: np.ndarray  # (nv,): deviation in the band of the fit
    dt: float
    no_clearance: str  # why nothing is known of the distance between bodies


def pose(model, *, duration, dt, limits, effects, report, start, rng):
    """Return the `DesignTask` of arguments as those of `design_motion`."""
    robot = KnownRobot.of(model)
    dt, names = check_dt(dt), robot.joint_names
    duration = _checked_duration(duration, dt)
    if limits is None:
        limits = MotionLimits.of(robot.features.model_)
    elif not isinstance(limits, MotionLimits):
        raise TypeError(f"limits must be MotionLimits; got {type(limits).__name__}.")
    limits.check_for(names)
    limits.check_duration(duration, names)
    if start is not None:
        start = limits.check_start(start, names)
    n_harmonics = _harmonics(robot, limits, duration, dt)
    curve = FourierCurve(duration, n_harmonics, robot.n_joints, start)
    reference = _reference(robot, limits, curve.highest, rng)
    noise = robot.noise(limits, reference, curve.highest, dt)
    asked = asked_effects(effects, robot.n_joints)
    if report is not None:
        asked += open_effects(read_report(report), names)
    members, candidates = _parted(robot, asked)
    band = robot.band(curve.highest, dt)

    equations = EquationModel(
        robot.features,
        robot.inertial,
        [effect for effect, _ in members] + [one.effect for one in candidates],
        n_own=len(members),
        still=robot.still(limits),
        reference=reference,
        bandwidth=band,
    )
    clearance, no_clearance = _clearance(robot)
    problem = Problem(
        curve=curve,
        model=equations,
        questions=_questions(equations, candidates, reference, noise),
        limits=limits,
        coefficients=_coefficients(robot, equations, members, reference),
        precision=2 * band / noise**2,
        still=robot.still(limits),
        clearance=clearance,
        room=ROOM,
    )
    _check_held(problem, names, rng)
    return DesignTask(
        problem=problem,
        robot=robot,
        noise=noise,
        dt=dt,
        no_clearance=no_clearance,
    )


def _clearance(robot):
    """Return the distances between bodies, or None and why they are not known."""
    if robot.description is None:
        return None, "no URDF file was given, so that nothing is known of its shapes"
    return Clearance.of(robot.description, model=robot.features.model_, margin=ROOM)


def _checked_duration(duration, dt):
    """Return the duration, a whole number of samples."""
    duration = float(duration)
    if not (np.isfinite(duration) and duration >= 10 * dt):
        raise ValueError(
            f"duration must be ten samples of dt={dt:g} s at least; got {duration:g}."
        )
    return round(duration / dt) * dt


def _harmonics(robot, limits, duration, dt):
    """Return the number of harmonics that limits and sampling allow."""
    inertia = np.diag(robot.inertia(_at_rest(limits, robot.n_joints)))
    with np.errstate(divide="ignore"):
        by_torque = limits.torque / np.maximum(inertia, 1e-12)
    reach = np.minimum(limits.acceleration, by_torque)
    turn = np.median(reach / (2 * np.pi * limits.velocity))
    highest = min(_SPREAD * turn, _PER_SAMPLE / dt)
    return int(np.clip(highest * duration, _FEWEST, _MOST))


def _at_rest(limits, nv):
    """States of rest in random poses (100, 3 nv)."""
    low, high = limits.position.T
    q = np.random.default_rng(0).uniform(low, high, size=(100, nv))
    return np.hstack([q, np.zeros((100, 2 * nv))])


def _reference(robot, limits, highest, rng):
    """States as the limits allow them (n, 3 nv)."""
    low, high = limits.position.T
    shape = (_REFERENCE, robot.n_joints)
    fastest = np.minimum(limits.velocity, np.pi * highest * (high - low))
    quickest = np.minimum(limits.acceleration, 2 * np.pi * highest * fastest)
    return np.hstack(
        [
            rng.uniform(low, high, size=shape),
            fastest * rng.uniform(-1, 1, size=shape),
            quickest * rng.uniform(-1, 1, size=shape),
        ]
    )


def _parted(robot, asked):
    """Split effects into those of the model and further candidates."""
    # What a report found is a candidate again: the next recording may say otherwise.
    doubted = {(one.effect.name, one.effect.joint) for one in asked if one.doubted}
    members = [
        (effect, coef)
        for effect, coef in zip(robot.effects, robot.coefficients)
        if (effect.name, effect.joint) not in doubted and is_steered(effect)
    ]
    taken = {effect.key() for effect, _ in members}
    found = {(effect.name, effect.joint): effect for effect in robot.effects}
    candidates = []
    for one in asked:
        if one.doubted:
            # in the shape that it has in the model
            known = found.get((one.effect.name, one.effect.joint), one.effect)
            one = replace(one, effect=known)
        if one.effect.key() not in taken:
            taken.add(one.effect.key())
            candidates.append(one)
    return members, candidates


def _questions(equations, candidates, reference, noise):
    """Return the questions: each candidate against the model and against its rivals."""
    rows = equations(reference)
    weight = np.broadcast_to(1.0 / (len(reference) * noise**2), rows.motion.q.shape)
    M = information_of(rows, equations.places, equations.n_columns, weight)
    power = np.diag(M)
    scale = np.where(power > 0, 1.0 / np.sqrt(or_one(power)), 1.0)
    spans = tuple(equations.spans[equations.n_own :])
    m = len(spans)
    blank = Questions(equations.n_model, scale, spans, np.zeros(m), np.zeros((m, m)))
    # What no motion shows, and nested effects, are no questions.
    seen = worth(M, blank)
    weight = np.array([one.weight for one in candidates])
    joint = np.array([one.effect.joint for one in candidates])
    shown = seen.alone > IN_SPAN
    apart = (seen.beside > IN_SPAN) & (joint[:, None] == joint) & shown & shown[:, None]
    np.fill_diagonal(apart, False)
    return replace(blank, alone=weight * shown, beside=np.outer(weight, weight) * apart)


def _coefficients(robot, equations, members, reference):
    """Coefficients of all columns (n_columns,), which give the robot's torques."""
    # Zero are those of effects that it may have; those that it has count, also where
    # they are in doubt.
    rows = equations(reference)
    n = equations.n_model
    A, y = [], []
    load = rows.motion.load
    coefs = [np.atleast_1d(coef) for _, coef in members]
    effects = np.concatenate([np.zeros(len(equations.base)), *coefs])
    for j, (part, place) in enumerate(zip(rows.rows, equations.places)):
        full = np.zeros((part.shape[1], n))
        mine = place < n
        full[:, place[mine]] = part[mine].T
        A.append(full)
        y.append(load[:, j] + full @ effects)
    A, y = np.concatenate(A), np.concatenate(y)
    size = np.sqrt((A**2).mean(axis=0))
    size[size == 0] = 1.0
    found = np.zeros(equations.n_columns)
    found[:n] = np.linalg.lstsq(A / size, y, rcond=None)[0] / size
    known = {
        effect.key(): np.atleast_1d(coef)
        for effect, coef in zip(robot.effects, robot.coefficients)
    }
    for span, one in zip(
        equations.spans[len(members) :], equations.effects[len(members) :]
    ):
        found[span] = known.get(one.effect.key(), 0.0)
    return found


def _tell_collision(problem, poses, is_start):
    """Refuse a start in which bodies meet."""
    one = problem.clearance.nearest(poses[:1])
    where = "the start" if is_start else f"all of {len(poses)} random poses"
    raise ValueError(
        f"The limits leave no room: bodies meet in {where}; {one.first} and "
        f"{one.second} are {1e3 * one.distance:.0f} mm apart, where "
        f"{1e3 * problem.room:.0f} mm are kept. Give "
        + ("another start." if is_start else "other limits of position.")
    )


def best_drawn(problem, rng):
    """Draw motions that touch a limit, and return the best by the criterion, a list."""
    t = problem.times()
    basis = problem.curve.basis(t)
    found = []
    for k in range(_DRAWN):
        z = _drawn(problem, rng, basis, t)
        if not (basis[1] @ z.T).any():
            # drawn about a pose that torques do not hold
            continue
        M = problem.information(problem.curve.states(z, basis), t[1])
        found.append((-worth(M, problem.questions).value, k, z))
    if not found:
        raise ValueError(
            f"The limits leave no room: torques hold the robot in few poses, and none "
            f"of {_DRAWN} random motions starts in one. Give larger torque limits, or "
            "a start."
        )
    return [z for _, _, z in sorted(found, key=lambda one: one[:2])[:_STARTS]]


def _drawn(problem, rng, basis, t):
    """Draw a motion, each joint as large as its limits allow, all as large together."""
    curve, limits = problem.curve, problem.limits
    z = rng.normal(size=(problem.model.nv, curve.size))
    if curve.start is None:
        low, high = _inner(limits)
        z[:, -1] = 0.0
        tops, bottoms = _ends(basis, z)
        room = (high - low) / np.maximum(tops - bottoms, 1e-12)
        z *= (0.9 * _reach(limits, basis, z, room))[:, None]
        tops, bottoms = _ends(basis, z)
        z[:, -1] = _held_pose(problem, low - bottoms, high - tops, rng)
    else:
        z = _about_start(problem, z, basis, t)
    return shrunk(problem, z, t, _DRAWN_INSIDE, apart=False)


def _inner(limits):
    """Range of positions (nv,), (nv,) within which motions are drawn."""
    low, high = limits.position.T
    left = 0.5 * (1.0 - _DRAWN_INSIDE) * (high - low)
    return low + left, high - left


def _ends(basis, z):
    """Highest and lowest positions of motions, (nv,) each."""
    q = basis[0] @ z.T
    return q.max(axis=0), q.min(axis=0)


def _reach(limits, basis, z, room):
    """Factors (nv,) by which motions may grow, of which `room` positions allow."""
    fastest, quickest = np.abs(basis[1:] @ z.T).max(axis=1)
    return np.minimum(
        room,
        np.minimum(
            limits.velocity / np.maximum(fastest, 1e-12),
            limits.acceleration / np.maximum(quickest, 1e-12),
        ),
    )


def _about_start(problem, z, basis, t):
    """Scale motions about a given start, half of them, and half to the wider side."""
    start, limits = problem.curve.start, problem.limits
    low, high = limits.position.T
    tops, bottoms = _ends(basis, z)
    room = np.minimum(
        (high - start) / np.maximum(tops, 1e-12),
        (low - start) / np.minimum(bottoms, -1e-12),
    )
    z = z * (0.45 * _reach(limits, basis, z, room))[:, None]
    # There and back, at rest at both ends: it has room even if the start is a limit.
    way = np.sin(np.pi * t / problem.curve.period) ** 4
    way = np.linalg.lstsq(basis[0], way, rcond=None)[0][None]
    aside = np.where(high - start > start - low, high - start, low - start)
    grown = way * np.sign(aside)[:, None]
    grown *= (0.45 * _reach(limits, basis, grown, np.abs(aside)))[:, None]
    return z + grown


def _held_pose(problem, lowest, highest, rng):
    """Draw a pose between two that the torques hold against gravity, or anywhere."""
    for low, high in ((lowest, highest), _inner(problem.limits)):
        poses = rng.uniform(low, high, size=(POSES, lowest.size))
        held, strain = _strain(problem, poses)
        if held.any():
            return poses[np.flatnonzero(held)[0]]
    return poses[np.argmin(strain.max(axis=1))]


def _strain(problem, poses):
    """Which poses (n, nv) can be held, and the shares of the torque limits (n, nv)."""
    # Bodies keep their distance in a pose that can be held.
    states = np.hstack([poses, np.zeros((len(poses), 2 * poses.shape[1]))])
    strain = np.abs(problem.torques(problem.model(states))) / problem.limits.torque
    held = (strain < _HELD).all(axis=1)
    if problem.clearance is not None:
        room = problem.room / INSIDE
        distances = problem.clearance(poses, within=room).distance
        held &= (distances >= room).all(axis=1)
    return held, strain


def _check_held(problem, names, rng):
    """Refuse torque limits that do not hold the robot where the motion may start."""
    start, limits = problem.curve.start, problem.limits
    low, high = limits.position.T
    poses = rng.uniform(low, high, size=(POSES, len(names)))
    poses = poses if start is None else start[None]
    held, strain = _strain(problem, poses)
    if held.any():
        return
    best = strain[np.argmin(strain.max(axis=1))]
    j = int(np.argmax(best))
    if best[j] < _HELD:
        _tell_collision(problem, poses, start is not None)
    where = f"any of {POSES} random poses" if start is None else "the start"
    enough = np.maximum(limits.torque, best * limits.torque / _HELD)
    raise MotionRefused(
        f"The limits leave no room: to hold the robot still at {where}, {names[j]} "
        f"needs {best[j] * limits.torque[j]:.3g} of at most {limits.torque[j]:.3g}. "
        f"Give a torque limit of {rounded_up(enough)[j]:g} or more"
        + ("." if start is None else ", or another start."),
        {"torque": rounded_up(enough)},
    )


def _made(task, z, first, fine):
    """Collect the motion and what it promises."""
    problem, robot, dt = task.problem, task.robot, task.dt
    curve, limits = problem.curve, problem.limits
    t = np.arange(round(curve.period / dt)) * dt
    states = curve.states(z, curve.basis(t))
    equations = problem.model(states, t)
    nv = robot.n_joints
    dense = curve.states(z, curve.basis(fine))
    margins, within = _margins(problem, dense, fine)
    samples = problem.times()
    design = curve.states(z, curve.basis(samples))
    start = curve.states(first, curve.basis(samples))
    return DesignedMotion(
        t=t,
        q=states[:, :nv],
        v=states[:, nv : 2 * nv],
        a=states[:, 2 * nv :],
        tau=problem.torques(equations),
        joint_names=robot.joint_names,
        slides=tuple(map(bool, problem.model.prismatic)),
        dt=dt,
        duration=curve.period,
        limits=limits,
        condition_number=condition_number(problem, design),
        start_condition_number=condition_number(problem, start),
        within_limits=within,
        margins=margins,
        no_clearance=task.no_clearance,
        noise=task.noise,
        band=robot.band(curve.highest, dt),
        **promise(problem, robot, design, samples[1], task.noise),
        curve=curve,
        coordinates=z,
    )


def _margins(problem, states, t):
    """Smallest distances to the limits over the limits, and whether all are kept."""
    torques = problem.torques(problem.model(states, t))
    sides = [g for g, _ in excess(problem, states, torques, 1.0)]
    margins = {}
    for k, name in enumerate(("position", "velocity", "acceleration", "torque")):
        over = np.maximum(sides[2 * k].max(axis=0), sides[2 * k + 1].max(axis=0))
        margins[name] = -over
    within = all((value >= MARGIN - 1e-6).all() for value in margins.values())
    if problem.clearance is not None:
        nearest = problem.clearance.smallest(states[:, : problem.model.nv])
        margins["clearance"] = nearest
        within &= nearest >= problem.room - 1e-6
    return margins, within
