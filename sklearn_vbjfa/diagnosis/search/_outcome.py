"""From the search to what is reported."""

import platform

import numpy as np
import scipy
import sklearn

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._evidence import SMALLEST_GAIN
from sklearn_vbjfa.diagnosis.search._findings import (
    DiscoveredEffect,
    Outcome,
    Round,
    Trial,
)
from sklearn_vbjfa.diagnosis.search._gaps import memory_seconds, too_short
from sklearn_vbjfa.diagnosis.search._intervals import NEXT_SECONDS, quantile
from sklearn_vbjfa.diagnosis.search._search import STEP_UP
from sklearn_vbjfa.model._loading import import_pinocchio, is_prismatic

# Points of a picture.
_POINTS = 4000


def make_outcome(loop, search, final, judgement, floor, channels, library):
    """Collect what `Report` shows.

    Parameters
    ----------
    loop : EffectDiscovery
        With the fitted models and the errors.
    search : EffectSearch
        After its run.
    final : FinalFit
        The completed model on all rows.
    judgement : Judgement
        Of the untouched part.
    floor : ndarray of shape (nv,)
        Noise floors [N m or N].
    channels : tuple of ChannelFinding
        What is wrong with channels.
    library : tuple of Effect
        What was looked for.
    """
    robot = loop.declared_
    names = robot.joint_names_
    prismatic = is_prismatic(robot.features_.model_)
    spread = judgement.spread
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = floor / spread
        wide = np.array(judgement.wide or np.full((2, spread.size), np.nan)) / spread
    return Outcome(
        declared={
            "robot": robot.features_.model_.name,
            "joints": names,
            "friction": robot.features_.friction_,
            "n_parameters": robot.features_.n_parameters_,
            "cutoff": float(robot.cutoff_),
            "standstill": robot.standstill_.tolist(),
        },
        effects=tuple(_effects(search, final, names, prismatic)),
        rounds=tuple(_rounds(search, names)),
        unexplained=loop.unexplained_,
        hidden=loop.hidden_,
        channels=channels,
        joint_names=names,
        torque_units=tuple("N" if p else "N m" for p in prismatic),
        error_before=loop.error_before_,
        error_after=loop.error_after_,
        spread=spread,
        wide_before=wide[0],
        wide_after=wide[1],
        wide_cutoff=judgement.wide_cutoff,
        seconds=judgement.seconds,
        enough=judgement.enough,
        intervals=judgement.intervals,
        floor=floor,
        settings=_settings(loop, search, judgement, library),
        curves=_curves(loop, judgement.before, judgement.after),
    )


def _effects(search, final, names, prismatic):
    rivals = {}
    for step in search.steps:
        if step.action not in {"drop", "withdraw"}:
            rivals[step.effect.key()] = tuple(c.effect.name for c in step.rivals)
    for one, effect, estimate in zip(
        search.accepted, final.effects, final.effect_estimates()
    ):
        evidence = search.evidence_of(one)
        values, deviations = _named(effect, estimate)
        half = quantile(estimate.freedom)
        units = effect.parameter_units(prismatic[effect.joint])
        yield DiscoveredEffect(
            name=effect.name,
            joint=effect.joint,
            joint_name=names[effect.joint],
            parameters=values,
            units={key: units.get(key, "") for key in values},
            intervals={
                key: (
                    values[key] - half * deviations[key],
                    values[key] + half * deviations[key],
                )
                for key in deviations
                # Of what no column tells there is no interval.
                if deviations[key] != 0
            },
            evidence=evidence,
            rivals=rivals.get(one.key(), ()),
            effect=effect,
        )


def _named(effect, estimate):
    """Parameters as an engineer calls them, and standard deviations (delta method)."""
    coef, covariance = estimate.coef, estimate.covariance
    k = len(coef)
    values = effect.parameters(coef)
    scale = np.sqrt(np.maximum(np.diagonal(covariance)[:k], 0.0))
    slopes = {key: np.zeros(k) for key in values}
    for i in range(k):
        step = 1e-4 * scale[i] or 1e-9
        moved = np.array(coef, dtype=float)
        moved[i] += step
        for key, value in effect.parameters(moved).items():
            slopes[key][i] = (value - values[key]) / step
    own = covariance[:k, :k]
    deviations = {
        key: float(np.sqrt(max(slope @ own @ slope, 0.0)))
        for key, slope in slopes.items()
    }
    for i, name in enumerate(estimate.shape):
        if name not in values:
            values[name] = float(getattr(effect, name))
            deviations[name] = float(np.sqrt(max(covariance[k + i, k + i], 0.0)))
    for name, value in effect.shape().items():
        if name not in effect.tangent:
            values.setdefault(name, value)
    return values, deviations


def _rounds(search, names):
    rows = (search.view.root.T**2).sum(axis=1)
    torque = search.view.equations.tau
    weight = search.view.equations.weight
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (weight * torque).sum(axis=0) / rows
        spread = np.sqrt((weight * (torque - mean) ** 2).sum(axis=0) / rows)

        def error(squares):
            return np.sqrt(squares / rows) / spread

        for step in search.steps:
            yield Round(
                action=step.action,
                name=step.effect.name,
                joint=step.effect.joint,
                joint_name=names[step.effect.joint],
                shape=step.effect.shape(),
                replaced="" if step.replaced is None else step.replaced.name,
                evidence=step.evidence,
                rule=step.rule.name,
                level=step.rule.level,
                n_tests=step.rule.n_tests,
                rivals=tuple(_trial(c) for c in step.rivals),
                tried=tuple(_trial(c) for c in step.tried),
                error_before=error(step.squares_before),
                error_after=error(step.squares_after),
            )


def _trial(candidate):
    effect = candidate.effect
    return Trial(
        name=effect.name,
        joint=effect.joint,
        shape=effect.shape(),
        evidence=candidate.evidence,
    )


def _settings(loop, search, judgement, library):
    from sklearn_vbjfa import __version__

    view = search.view
    seconds = memory_seconds(search)
    return {
        "test_size": float(loop.test_size),
        "untouched_stretches": judgement.n_stretches,
        "undecided_stretches": judgement.n_undecided,
        "untouched_seconds": judgement.before.weight.shape[0] * float(view.step),
        "guard_seconds": judgement.guard,
        "alpha": float(loop.alpha),
        "rule": STEP_UP,
        "last_level": float(search.threshold) if search.n_tests else None,
        "last_n_tests": int(search.n_tests),
        "smallest_gain": SMALLEST_GAIN,
        "effects": tuple(e.name for e in library),
        "n_blocks": view.blocks.n_blocks,
        "block_seconds": float(view.blocks.length),
        "n_folds": view.blocks.n_folds,
        "correlation_seconds": max(seconds, default=0.0),
        "too_short": tuple(too_short(search, seconds)),
        "error_seconds": NEXT_SECONDS,
        "search_rows": int(view.states.shape[0]),
        "random_state": loop.random_state
        if isinstance(loop.random_state, (int, type(None)))
        else "given",
        "versions": {
            "sklearn_vbjfa": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "scikit-learn": sklearn.__version__,
            "pinocchio": import_pinocchio().__version__,
            "python": platform.python_version(),
        },
    }


def _curves(loop, before, after):
    """Residuals of the untouched part with their signals, thinned for pictures."""
    m = before.torque.shape[0]
    rows = np.arange(0, m, max(1, m // _POINTS))
    # Without a sample period, rows need not be equidistant.
    dt = loop.judged_.dt
    lowpass = _lowpass.design(dt or 1.0, loop.judged_.cutoff_)
    return {
        "index": before.index[rows],
        # Stretches one after the other.
        **({} if dt is None else {"seconds": rows * dt * lowpass.step}),
        "before": before.residual[rows],
        "after": after.residual[rows],
        "weight": before.weight[rows],
        "torque": before.torque[rows],
    }
