"""What remains unexplained, and what the data cannot show."""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._blocks import FEWEST
from sklearn_vbjfa.diagnosis.search._dependence import dependences, motion_signals
from sklearn_vbjfa.diagnosis.search._evidence import closure
from sklearn_vbjfa.diagnosis.search._findings import Hidden, Unexplained
from sklearn_vbjfa.robot._equations import make_motion

# A joint whose residual is this far above its noise floor has something unexplained:
# by the first factor if it varies with a signal, by the second in any case. (What
# smoothing takes from the motion leaves some per cent above the floor.)
ABOVE_FLOOR = (1.1, 1.5)
# Share of a column's power outside the span of the others below which it cannot be
# seen in this recording, and below which no motion can show it.
_UNSEEN, _IN_SPAN = 1e-3, 1e-6
_PLAIN = ("viscous", "coulomb", "offset", "spring")


def unexplained(search, names, spread, floors, errors):
    """Joints above their floor, with the signals that the rest varies with.

    Parameters
    ----------
    search : EffectSearch
        After its run.
    names : sequence of str
        Joints.
    spread : ndarray of shape (nv,)
        Spread of the torques [N m or N].
    floors : ndarray of shape (nv,)
        Noise floors of the completed model [N m or N]; nan where unknown. What a
        declared model lacks may hide its own.
    errors : ndarray of shape (nv,)
        Errors on the untouched part over the spread; nan where there is none.
    """
    view, motion = search.view, search.motion
    residual = search.base.residuals() / np.where(view.root.T > 0, view.root.T, np.inf)
    signals = motion_signals(motion, names)
    seen = {key: view.filtered(value[:, None])[:, 0] for key, value in signals.items()}
    found = []
    for j, name in enumerate(names):
        weight = view.equations.weight[:, j]
        total = weight.sum()
        if total == 0:
            continue
        rms = float(np.sqrt((weight * residual[j] ** 2).sum() / total))
        floor = float(floors[j])
        if not np.isnan(floor) and rms <= ABOVE_FLOOR[0] * floor:
            continue
        signs = dependences(residual[j], weight, seen, view)[:4]
        if not np.isnan(floor) and not signs and rms <= ABOVE_FLOOR[1] * floor:
            continue
        found.append(
            Unexplained(
                joint=j,
                joint_name=name,
                rms=rms,
                floor=floor,
                share=1.0 if np.isnan(floor) else float(1 - (floor / rms) ** 2),
                of_torque=_above(floor / spread[j], rms / spread[j], float(errors[j])),
                signals=signs,
            )
        )
    return tuple(found)


def _above(floor, searched, untouched):
    """Share of the torque above the floor: of the untouched part, if it shows one."""
    floor = np.nan_to_num(floor)
    error = untouched if untouched > floor else searched
    return float(np.sqrt(max(error**2 - floor**2, 0.0)))


def memory_seconds(search):
    """How long the residual of each joint stays correlated at the end, list [s]."""
    view = search.view
    memories = view.whitening(search.base.residuals()).memory
    return [memory.time for memory in memories]


def too_short(search, seconds):
    """Joints whose residual is too few independent values, with its memory [s]."""
    view = search.view
    total = view.blocks.length * view.blocks.n_blocks
    for j, time in enumerate(seconds):
        if view.precision[j] > 0 and FEWEST * time > total:
            yield j, float(time)


def hidden(search, names):
    """Effects of the library that this robot or this recording cannot show."""
    view = search.view
    found = []
    probe = _probe(view)
    for j, name in enumerate(names):
        if view.precision[j] == 0:
            continue
        own = search.candidates_of(j)
        held = [e for e in search.accepted if e.joint == j]
        present = set(search.declared).union(
            *({e.name} | closure(e, search.library) for e in held)
        )
        plain = [e for e in own if e.name in _PLAIN and e.name not in present]
        bases = {}
        for effect in search.library:
            one = clone(effect).set_params(joint=j)
            if effect.name in present:
                continue
            reason = one.applies(search.motion)
            if reason:
                if reason.startswith("needs"):
                    found.append(
                        Hidden(
                            name=effect.name,
                            joint=j,
                            joint_name=name,
                            reason="signal",
                            remedy=reason,
                        )
                    )
                continue
            beside = tuple(p.name for p in plain if p.name in one.contains)
            if beside not in bases:
                more = [p for p in plain if p.name in beside]
                bases[beside] = search.regression([*search.accepted, *more])
            variants, columns = view.family(one, search.motion)
            if not variants:
                continue
            joints = view.joints_of(one)
            if bases[beside].outside(joints, columns).max() > _UNSEEN:
                continue
            structural = probe is not None and _in_span(one, *probe)
            found.append(
                Hidden(
                    name=effect.name,
                    joint=j,
                    joint_name=name,
                    reason="span" if structural else "excitation",
                    remedy="" if structural else effect.visible,
                )
            )
    return tuple(found)


def _probe(view):
    """Regressor and signals of random states, which excite everything there is."""
    features = view.robot.features_
    nv = view.nv
    rng = np.random.default_rng(0)
    n = 20 * features.n_parameters_ // nv + 200
    # Whole turns, whatever the recording did: what a small motion hides is no property
    # of the robot.
    scale = np.repeat([np.pi, 2.0, 10.0], nv)
    states = rng.uniform(-1, 1, size=(n, 3 * nv)) * scale
    return features.matrices(states), make_motion(
        features, states, None, [slice(0, n)], None
    )


def _in_span(effect, Phi, motion):
    """Whether columns of the state alone lie in the regressor's span."""
    if effect.needs or effect.continuous or effect.whole_robot or effect.shape():
        return False
    columns = effect.columns(motion)
    scale = np.sqrt((Phi**2).sum(axis=(0, 1)))
    A = Phi / np.where(scale > 0, scale, 1.0)
    target = np.zeros((*Phi.shape[:2], columns.shape[1]))
    target[:, effect.joint] = columns
    flat = A.reshape(-1, A.shape[2])
    solution, *_ = np.linalg.lstsq(
        flat, target.reshape(-1, columns.shape[1]), rcond=1e-10
    )
    rest = target.reshape(-1, columns.shape[1]) - flat @ solution
    return bool(np.all((rest**2).sum(0) <= _IN_SPAN * (columns**2).sum(0)))
