"""Design of exciting trajectories."""

import json
import os
from collections import namedtuple
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_random_state

from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.design._collisions import Clearance
from sklearn_vbjfa.design._motion import (
    POSES,
    DesignedMotion,
    FourierCurve,
    MotionLimits,
)
from sklearn_vbjfa.design._optimise import (
    DECIDED,
    INSIDE,
    ROOM,
    DesignProblem,
    Questions,
    information_of,
    optimise,
    shrunk,
    worth,
)
from sklearn_vbjfa.design._robot import IN_SPAN, EquationModel, KnownRobot
from sklearn_vbjfa.effects import resolve
from sklearn_vbjfa.equations._motion_facts import STANDSTILL_SHARE
from sklearn_vbjfa.recording import check_dt

# Range of the number of harmonics.
_FEWEST, _MOST = 5, 25
# Highest frequency over that where speed and acceleration reach their limits together.
_SPREAD = 2.0
# Highest frequency times the sample period, for a low-pass at five times the bandwidth.
_PER_SAMPLE = 0.06
# Random initial motions, number of these that are optimised, share of the limits within
# which they are drawn, and number of states at which columns are compared.
_DRAWN, _STARTS, _DRAWN_INSIDE, _REFERENCE = 40, 3, 0.95, 600
# Share of the torque limits that the static torque at the start may take.
_HELD = 0.85
# Margin to all limits at ten times the sampling of the design.
MARGIN, _FINER = 0.02, 10
# Reason why no motion excites an effect.
SAME_COLUMNS = "absorbed by other parameters"
# Weights of effects in the report, and of other effects that a joint may have.
_ASKED, _POSSIBLE = 1.0, 0.2
# Effects of the geometry or of time, which are not part of the objective.
_NOT_STEERED = (
    "base_tilt joint_zero joint_axis payload drift signal torque_gain delay "
    "torque_filter jerk elastic"
).split()
# Effects that any joint may have and that a motion can distinguish.
_COMMON = (
    "viscous coulomb asymmetric_friction stribeck viscous_quadratic load_friction "
    "spring ripple rotor_inertia offset"
).split()


@dataclass(frozen=True, kw_only=True)
class ShownEffect:
    """An effect that a motion excites, or the reason why no motion does."""

    name: str
    joint: int  # from zero
    joint_name: str
    # smallest root mean square of its torque, in the most active conditions, that
    # is distinguishable from the model and its nearest rival [N m or N]
    least: float = np.inf
    rival: str = ""  # empty if there is none
    is_asked: bool = False  # whether the report or the caller asks for both
    reason: str = ""


def design_motion(
    model, *, duration, dt, limits=None, effects=(), report=None, random_state=None
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
        If the limits are missing or infeasible, or `duration` is too short for the
        slowest joint.

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
    >>> import numpy as np
    >>> import pinocchio
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.design import design_motion
    >>> arm = load_demo_recording().robot_model()
    >>> arm = pinocchio.buildReducedModel(arm, [3, 4, 5, 6], np.zeros(6))
    >>> motion = design_motion(arm, duration=3.0, dt=0.05, random_state=0)
    >>> motion.q.shape, motion.within_limits
    ((60, 2), True)
    """
    rng = check_random_state(random_state)
    problem = pose(model, duration, dt, limits, effects, report, rng)
    times = problem.times()
    fine = np.arange(_FINER * times.size) * (times[1] / _FINER)
    best, first = optimise(problem, best_drawn(problem, rng))
    z = shrunk(problem, best, fine, 1.0 - MARGIN)
    return _finished(problem, z, first, fine)


def pose(model, duration, dt, limits, effects, report, rng):
    """Return the `DesignProblem` for the arguments of `design_motion`."""
    robot = KnownRobot.of(model)
    dt, names = check_dt(dt), robot.joint_names
    duration = float(duration)
    if not (np.isfinite(duration) and duration >= 10 * dt):
        raise ValueError(
            f"duration must be ten samples of dt={dt:g} s at least; got {duration:g}."
        )
    duration = round(duration / dt) * dt
    if limits is None:
        limits = MotionLimits.of(robot.features.model_)
    elif not isinstance(limits, MotionLimits):
        raise TypeError(f"limits must be MotionLimits; got {type(limits).__name__}.")
    limits.check_for(names, duration)
    curve = FourierCurve(duration, _harmonics(robot, limits, duration, dt))
    reference = _reference(limits, curve.highest, rng)
    noise = robot.noise(limits, reference, curve.highest, dt)
    asked = asked_effects(effects, len(names))
    if report is not None:
        asked += open_effects(read_report(report), names)
    members, candidates = _split(robot, asked)
    band, still = robot.band(curve.highest, dt), STANDSTILL_SHARE * limits.velocity
    equations = EquationModel(
        robot.features,
        robot.inertial,
        [effect for effect, _ in members] + [x.effect for x in candidates],
        n_members=len(members),
        still=still,
        reference=reference,
        bandwidth=band,
    )
    rows = equations(reference)
    clearance, reason = Clearance.of(robot.description, robot.features.model_, ROOM)
    problem = DesignProblem(
        curve=curve,
        model=equations,
        robot=robot,
        dt=dt,
        questions=_questions(equations, rows, candidates, noise),
        limits=limits,
        coefficients=_coefficients(robot, equations, rows, members),
        noise=noise,
        band=band,
        still=still,
        clearance=clearance,
        no_clearance=reason,
    )
    _check_static(problem, names, rng)
    return problem


def _harmonics(robot, limits, duration, dt):
    """Return the number of harmonics that limits and sampling allow."""
    low, high = limits.position.T
    poses = np.random.default_rng(0).uniform(low, high, size=(100, low.size))
    inertia = np.maximum(np.diag(robot.inertia(poses)), 1e-12)
    reach = np.minimum(limits.acceleration, limits.torque / inertia)
    turn = np.median(reach / (2 * np.pi * limits.velocity))
    highest = min(_SPREAD * turn, _PER_SAMPLE / dt)
    return int(np.clip(highest * duration, _FEWEST, _MOST))


def _reference(limits, highest, rng):
    low, high = limits.position.T
    shape = (_REFERENCE, low.size)
    fastest = np.minimum(limits.velocity, np.pi * highest * (high - low))
    quickest = np.minimum(limits.acceleration, 2 * np.pi * highest * fastest)
    q = rng.uniform(low, high, size=shape)
    v, a = (size * rng.uniform(-1, 1, size=shape) for size in (fastest, quickest))
    return np.hstack([q, v, a])


def _split(robot, asked):
    """Split effects into effects of the model and further candidates."""
    # An effect of a report is a candidate again, with its shape in the model: the next
    # recording has to confirm it.
    in_model = {(effect.name, effect.joint): effect for effect in robot.effects}
    doubted = {(x.effect.name, x.effect.joint) for x in asked if x.doubted}
    members = [
        (effect, np.atleast_1d(coef))
        for effect, coef in zip(robot.effects, robot.coefficients)
        if (effect.name, effect.joint) not in doubted
        and effect.name not in _NOT_STEERED
    ]
    taken = {effect.key() for effect, _ in members}
    candidates = []
    for item in asked:
        if item.doubted:
            key = item.effect.name, item.effect.joint
            effect = in_model.get(key, item.effect)
            item = OpenEffect(effect, item.weight, doubted=True)
        if item.effect.key() not in taken:
            taken.add(item.effect.key())
            candidates.append(item)
    return members, candidates


def _questions(equations, rows, candidates, noise):
    """Return the `Questions`: each candidate against the model and its rivals."""
    n, nv = rows.motion.q.shape
    weight = np.broadcast_to(1.0 / (n * noise**2), (n, nv))
    M = information_of(rows, equations.places, equations.n_columns, weight)
    power = np.diag(M)
    scale = np.where(power > 0, 1.0 / np.sqrt(or_one(power)), 1.0)
    spans = tuple(equations.spans[equations.n_members :])
    m = len(spans)
    blank = Questions(equations.n_model, scale, spans, np.zeros(m), np.zeros((m, m)))
    # Effects that no motion excites, and nested effects, are no questions.
    judged = worth(M, blank)
    weight = np.array([x.weight for x in candidates])
    joint = np.array([x.effect.joint for x in candidates])
    shown = judged.alone > IN_SPAN
    same = joint[:, None] == joint
    rivals = (judged.beside > IN_SPAN) & same & shown & shown[:, None]
    np.fill_diagonal(rivals, False)
    beside = np.outer(weight, weight) * rivals
    return Questions(*blank[:3], weight * shown, beside)


def _coefficients(robot, equations, rows, members):
    """Coefficients of all columns (n_columns,), which give the robot's torques."""
    # Effects of the robot keep their coefficients, possible ones have zero.
    n, load = equations.n_model, rows.motion.load
    effects = np.zeros(n)
    if members:
        effects[len(equations.base) :] = np.concatenate([coef for _, coef in members])
    A, y = [], []
    for j, (part, place) in enumerate(zip(rows.rows, equations.places)):
        full = np.zeros((part.shape[1], n))
        in_model = place < n
        full[:, place[in_model]] = part[in_model].T
        A.append(full)
        y.append(load[:, j] + full @ effects)
    A, y = np.concatenate(A), np.concatenate(y)
    size = or_one(np.sqrt((A**2).mean(axis=0)))
    coefficients = np.zeros(equations.n_columns)
    coefficients[:n] = np.linalg.lstsq(A / size, y, rcond=None)[0] / size
    by_key = {e.key(): coef for e, coef in zip(robot.effects, robot.coefficients)}
    further = equations.effects[len(members) :]
    for span, columns in zip(equations.spans[len(members) :], further):
        coefficients[span] = by_key.get(columns.effect.key(), 0.0)
    return coefficients


# -- initial motions -------------------------------------------------------------------


def best_drawn(problem, rng):
    """Draw motions that reach a limit, and return the best by the criterion, a list."""
    t = problem.times()
    basis = problem.curve.basis(t)
    drawn = []
    for k in range(_DRAWN):
        z = _drawn(problem, rng, basis, t)
        # Motions about a pose whose static torque exceeds the limits do not move.
        if (basis[1] @ z.T).any():
            M = problem.information(problem.curve.states(z, basis), t[1])
            drawn.append((-worth(M, problem.questions).value, k, z))
    if not drawn:
        raise ValueError(
            "Infeasible torque limits: static torques exceed them at the start of all "
            f"{_DRAWN} random motions. Raise the torque limits."
        )
    return [z for _, _, z in sorted(drawn, key=lambda x: x[:2])[:_STARTS]]


def _drawn(problem, rng, basis, t):
    """Draw a motion that reaches the limits of each joint, then scale all joints."""
    limits, (low, high) = problem.limits, problem.limits.position.T
    margin = 0.5 * (1.0 - _DRAWN_INSIDE) * (high - low)
    low, high = low + margin, high - margin
    z = rng.normal(size=(problem.model.nv, problem.curve.size))
    z[:, -1] = 0.0
    q, v, a = basis @ z.T
    sizes = np.ptp(q, axis=0), np.abs(v).max(axis=0), np.abs(a).max(axis=0)
    largest = high - low, limits.velocity, limits.acceleration
    ratios = [x / np.maximum(y, 1e-12) for x, y in zip(largest, sizes)]
    z *= 0.9 * np.min(ratios, axis=0)[:, None]
    q = basis[0] @ z.T
    z[:, -1] = _held_pose(problem, low - q.min(axis=0), high - q.max(axis=0), rng)
    return shrunk(problem, z, t, _DRAWN_INSIDE, apart=False)


def _held_pose(problem, low, high, rng):
    """Draw a pose between two poses that torques hold, or within the limits."""
    for ends in ((low, high), problem.limits.position.T):
        poses = rng.uniform(*ends, size=(POSES, low.size))
        held, strain = _strain(problem, poses)
        if held.any():
            return poses[np.flatnonzero(held)[0]]
    return poses[np.argmin(strain.max(axis=1))]


def _strain(problem, poses):
    """Poses (n, nv) that can be held, and static torques over limits (n, nv)."""
    # Poses with collisions cannot be held.
    states = np.hstack([poses, np.zeros((len(poses), 2 * poses.shape[1]))])
    strain = np.abs(problem.torques(problem.model(states))) / problem.limits.torque
    held = (strain < _HELD).all(axis=1)
    if problem.clearance is not None:
        room = ROOM / INSIDE
        held &= (problem.clearance(poses, within=room)[0] >= room).all(axis=1)
    return held, strain


def _check_static(problem, names, rng):
    limits = problem.limits
    poses = rng.uniform(*limits.position.T, size=(POSES, len(names)))
    held, strain = _strain(problem, poses)
    if held.any():
        return
    best = strain[np.argmin(strain.max(axis=1))]
    j = int(np.argmax(best))
    if best[j] < _HELD:
        distance, links = problem.clearance.nearest(poses[:1])
        raise ValueError(
            f"Infeasible position limits: self-collision in all {POSES} random poses; "
            f"{' and '.join(links)} are {1e3 * distance:.0f} mm apart "
            f"({1e3 * ROOM:.0f} mm required). Change the position limits."
        )
    needed = best[j] * limits.torque[j]
    raise ValueError(
        f"The limits leave no room: to hold the robot still at any of {POSES} random "
        f"poses, {names[j]} needs {needed:.3g} of at most {limits.torque[j]:.3g}. Give "
        f"a torque limit of {1.01 * needed / _HELD:.3g} or more."
    )


# -- the motion ------------------------------------------------------------------------


def _finished(problem, z, first, fine):
    curve, samples, dt = problem.curve, problem.times(), problem.dt
    t = np.arange(round(curve.period / dt)) * dt
    states = curve.states(z, curve.basis(t))
    q, v, a = np.split(states, 3, axis=1)
    margins, within = _margins(problem, curve.states(z, curve.basis(fine)), fine)
    design, start = (curve.states(x, curve.basis(samples)) for x in (z, first))
    shows, invisible = _shown(problem, design, samples[1])
    return DesignedMotion(
        t=t,
        q=q,
        v=v,
        a=a,
        tau=problem.torques(problem.model(states, t)),
        joint_names=problem.robot.joint_names,
        slides=tuple(map(bool, problem.model.prismatic)),
        dt=dt,
        duration=curve.period,
        limits=problem.limits,
        condition_number=_condition_number(problem, design),
        start_condition_number=_condition_number(problem, start),
        within_limits=within,
        margins=margins,
        no_clearance=problem.no_clearance,
        noise=problem.noise,
        band=problem.band,
        shows=shows,
        invisible=invisible,
        curve=curve,
        coordinates=z,
    )


def _margins(problem, states, t):
    """Smallest relative distances to the limits, and whether all are respected."""
    over, _ = problem.excess(states, problem.torques(problem.model(states, t)), 1.0)
    margins = -over.max(axis=(1, 2))
    margins = dict(zip(("position", "velocity", "acceleration", "torque"), margins))
    within = all((value >= MARGIN - 1e-6).all() for value in margins.values())
    if problem.clearance is not None:
        nearest = problem.clearance.nearest(states[:, : problem.model.nv])[0]
        margins["clearance"] = nearest
        within &= nearest >= ROOM - 1e-6
    return margins, within


def _condition_number(problem, states):
    """Condition number of the model's columns, rows scaled by their noise."""
    # Scaled by the columns' sizes at random states within the limits, for all motions.
    n = problem.model.n_model
    scale = problem.questions.scale[:n]
    M = problem.information(states, 1.0)[:n, :n] * np.outer(scale, scale)
    values = np.linalg.eigvalsh(M)
    if not values[0] > 1e-14 * values[-1]:
        return float("inf")
    return float(np.sqrt(values[-1] / values[0]))


def _shown(problem, states, step):
    questions, noise = problem.questions, problem.noise
    judged = worth(problem.information(states, step), questions)
    effects = [x.effect for x in problem.model.effects[problem.model.n_members :]]
    shows, invisible = [], []
    for k, effect in enumerate(effects):
        joint, names = effect.joint, problem.robot.joint_names
        shown = ShownEffect(name=effect.name, joint=joint, joint_name=names[joint])
        if not questions.alone[k] > 0:
            invisible.append(replace(shown, reason=SAME_COLUMNS))
            continue
        evidence, rival = judged.alone[k], ""
        # Rivals in the report have priority over other possible effects.
        asked = bool((questions.beside[k] >= _ASKED).any())
        pool = questions.beside[k] >= _ASKED if asked else questions.beside[k] > 0
        beside = np.where(pool, judged.beside[k], np.inf)
        i = int(np.argmin(beside))
        if beside[i] < evidence:
            evidence, rival = beside[i], effects[i].name
        # `evidence` is that of a torque as large as the noise.
        least = float(noise[joint] * np.sqrt(DECIDED / max(evidence, 1e-12)))
        shows.append(replace(shown, least=least, rival=rival, is_asked=asked))
    return tuple(shows), tuple(invisible)


# -- open questions of a report --------------------------------------------------------


# An effect that the robot may have, at its joint; its weight; and whether the model has
# it, so that the next recording has to confirm it.
OpenEffect = namedtuple("OpenEffect", "effect weight doubted")


def read_report(report):
    """Return a report, also of a search or in a file, as a dict of `to_dict`."""
    report = getattr(report, "report_", report)
    if hasattr(report, "to_dict"):
        return report.to_dict()
    if isinstance(report, dict) and "effects" in report:
        return report
    if not isinstance(report, (str, os.PathLike)):
        raise TypeError(
            "report must be a fitted EffectDiscovery, its report_, or the folder that "
            f"identify wrote; got {type(report).__name__}."
        )
    file = Path(report) / "report.json" if Path(report).is_dir() else Path(report)
    if not file.is_file():
        raise FileNotFoundError(
            f"No report at {str(file)!r}; expected the folder that identify wrote, "
            "with report.json in it."
        )
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{str(file)!r} is not readable as JSON: {error}.") from error
    if not isinstance(data, dict) or not {"effects", "joint_names"} <= set(data):
        raise ValueError(
            f"{str(file)!r} is not a report of identify: it lacks 'effects' or "
            "'joint_names'."
        )
    return data


def asked_effects(effects, nv):
    """Return the `OpenEffect`s of the caller; names and classes mean all joints."""
    items = []
    if isinstance(effects, str) or not hasattr(effects, "__iter__"):
        effects = (effects,)
    for given in effects:
        (effect,) = resolve((given,))
        if effect.name in _NOT_STEERED:
            raise ValueError(
                f"No motion is designed for {effect.name!r}: it follows the robot's "
                "geometry, the time or the whole torque, and shows in any motion that "
                "shows the rest. Leave it out of effects."
            )
        everywhere = isinstance(given, (str, type))
        for joint in range(nv) if everywhere else [effect.joint]:
            if not 0 <= joint < nv:
                raise ValueError(
                    f"{effect.name} is on joint {joint}, counted from zero; the robot "
                    f"has {nv} joints."
                )
            placed = clone(effect).set_params(joint=joint)
            items.append(OpenEffect(placed, _ASKED, doubted=False))
    return items


def open_effects(data, names):
    """Return the open questions of a report, then other possible effects."""
    if list(data["joint_names"]) != list(names):
        raise ValueError(
            f"The report is of joints {', '.join(data['joint_names'])}; the robot has "
            f"{', '.join(names)}. Give the robot that the report was made with."
        )
    completed = (*data["effects"], *data.get("possible", ()))
    # Weights and shapes by effect and joint, identified effects first, with shapes.
    doubted = {(x["name"], x["joint"]): x.get("parameters") for x in completed}
    trials = [trial for x in completed for trial in x.get("trials", ())]
    shapes = {(x["name"], x["joint"]): x["shape"] for x in trials} | doubted
    hidden = [
        x for x in data.get("not_identifiable", ()) if x["reason"] == "excitation"
    ]
    weights = dict.fromkeys([*doubted, *shapes], _ASKED)
    weights |= {(x["name"], x["joint"]): _ASKED for x in hidden}
    above = {x["joint"] for x in data.get("unexplained", ())}
    for joint in range(len(names)):
        for name in _COMMON:
            weights.setdefault((name, joint), _ASKED if joint in above else _POSSIBLE)
    items = []
    for key, weight in weights.items():
        effect = None if key[0] in _NOT_STEERED else _make(*key, shapes.get(key) or {})
        if effect is not None:
            items.append(OpenEffect(effect, weight, key in doubted))
    return sorted(items, key=lambda x: -x.weight)


def _make(name, joint, shape):
    """Make an effect of the library; None for a custom class."""
    try:
        (effect,) = resolve((name,))
    except ValueError:
        return None
    parameters = {
        k: v for k, v in shape.items() if k in effect.get_params() and v is not None
    }
    return clone(effect).set_params(joint=joint, **parameters)
