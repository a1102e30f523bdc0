"""Shape parameters of effects: between the points of the grid, beside each other."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._evidence import SMALLEST_GAIN, no_worse
from sklearn_vbjfa.diagnosis.search._model import SearchModel
from sklearn_vbjfa.diagnosis.search._regression import LEAST_RIDGE, BlockRegression
from sklearn_vbjfa.diagnosis.search._symmetry import one_sided
from sklearn_vbjfa.diagnosis.search._view import variants

# Times that what is linearised is linearised again; effects that are in the model until
# they stay within this share of their standard error, for independent rows.
_TANGENTS, _MOST_TANGENTS, _STAYS = 2, 6, 0.1
# Search of several shape parameters: it ends where the weighted squared error, in units
# of noise, falls by less than this, or after this many trials.
_WORTH, _MOST_TRIALS = 0.01, 100
# Points of the grid from which several parameters are searched: two of them may trade
# against each other.
_STARTS = 3
# Shapes between the neighbours of a tuned one, from which each fold takes its own.
_FINER = 9


@dataclass(frozen=True, kw_only=True)
class Bracket:
    """A shape parameter between the grid's next points on both sides.

    Attributes
    ----------
    low, high : float
        Bounds; of the logarithm where that is searched.
    logarithmic : bool
        Whether the logarithm is searched.
    lowest, highest : float
        Ends of the whole grid; infinite for an angle.
    turn : float
        Period of an angle; zero for what is none.
    """

    low: float
    high: float
    logarithmic: bool
    lowest: float
    highest: float
    turn: float = 0.0

    @classmethod
    def of(cls, effect, name, motion):
        """Return the bounds of a parameter; None where the grid has no neighbours."""
        value = getattr(effect, name)
        same = [v for v in variants(effect, motion) if v.key() == effect.key()]
        values = np.unique([getattr(v, name) for v in same])
        if name in effect.cyclic and values.size > 1:
            turn = 2 * np.pi
            around = np.concatenate([values - turn, values, values + turn])
            at = int(np.argmin(np.abs(around - value)))
            low, high = around[at - 1], around[at + 1]
            return cls(
                low=low,
                high=high,
                logarithmic=False,
                lowest=-np.inf,
                highest=np.inf,
                turn=turn,
            )
        values = values[np.sign(values) == np.sign(value)]
        if value == 0 or values.size < 2:
            return None
        at = int(np.argmin(np.abs(values - value)))
        positive = bool((values > 0).all())
        scaled = np.log(values) if positive else values
        low, high = scaled[max(at - 1, 0)], scaled[min(at + 1, values.size - 1)]
        return cls(
            low=low,
            high=high,
            logarithmic=positive,
            lowest=scaled[0],
            highest=scaled[-1],
        )

    def value(self, u):
        """Return the parameter at a place between the bounds."""
        if self.turn:
            return float(u % self.turn)
        return float(np.exp(u) if self.logarithmic else u)

    def place(self, value):
        """Return the place of a parameter."""
        return np.log(value) if self.logarithmic else value


def plainest(base, effect, family, finely=True):
    """Return the plainest form of an effect that is no worse than any, and its score.

    Forms differ in complexity. Within one, the shape is chosen by the score alone; a
    plainer form is searched between the points of its grid unless it is not `finely`.
    """
    joints = base.view.joints_of(effect)

    def scored(own):
        return own, base.fitted.score(joints, own.columns)

    def errors(form):
        return base.relevant(effect, form[1].squares)[0]

    forms = [scored(own) for own in family.forms()]
    best = min(forms, key=lambda form: errors(form).sum())
    before = base.relevant(effect, base.squares)[0].sum()
    if errors(best).sum() > (1 - SMALLEST_GAIN) * before:
        return best
    for own, score in forms:
        if own is best[0]:
            break
        if no_worse(errors(best), errors((own, score))):
            return own, score
        if not finely:
            continue
        # A grid of several parameters is coarse: between its points it may do as well.
        finer = tuned(own.effects[score.best], base)
        form = scored(own.extended(finer, base.columns_of(finer)))
        if no_worse(errors(best), errors(form)):
            return form
    return best


def refined(effect, base, rows=None):
    """Search an effect's shape parameters on between the points of the grid.

    It comes beside a model, which was fitted to some rows (m,) only if they are given.
    """
    brackets = {n: Bracket.of(effect, n, base.motion) for n in effect.continuous}
    brackets = {n: bracket for n, bracket in brackets.items() if bracket is not None}
    if not brackets:
        return effect
    joints = base.view.joints_of(effect)

    def at(places):
        values = {n: b.value(u) for (n, b), u in zip(brackets.items(), places)}
        return clone(effect).set_params(**values)

    def cost(effect):
        columns = base.view.columns([effect], base.motion)
        if rows is not None:
            columns *= rows[:, None, None]
        return -base.fitted.drop(joints, columns)

    search = _along if len(brackets) == 1 else _downhill
    start = [b.place(getattr(effect, n)) for n, b in brackets.items()]
    place, value = search(lambda u: cost(at(u)), start, list(brackets.values()))
    return at(place) if value < cost(effect) else effect


def _along(cost, start, brackets):
    """Search one parameter between its bounds: where, and the cost there."""
    (bracket,) = brackets
    low, high = bracket.low, bracket.high
    found = optimize.minimize_scalar(
        lambda u: cost([u]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-3 * (high - low)},
    )
    return [found.x], found.fun


def _downhill(cost, start, brackets):
    """Search several parameters, which may trade against each other, as `_along`."""
    # Nelder and Mead's simplex follows a narrow valley; it may leave the neighbours
    # of the start behind, but not what the parameter can be.
    width = np.array([b.high - b.low for b in brackets])
    simplex = np.vstack([start, start + 0.25 * np.diag(width)])
    found = optimize.minimize(
        cost,
        start,
        method="Nelder-Mead",
        bounds=[(b.lowest, b.highest) for b in brackets],
        options={
            "initial_simplex": simplex,
            "xatol": 1e-3 * width.min(),
            "fatol": _WORTH,
            "maxfev": _MOST_TRIALS,
        },
    )
    return found.x, found.fun


def _settings(effect):
    """Shape parameters of an effect that no search between grid points tunes."""
    tuned = {*effect.continuous, *effect.tangent}
    shape = effect.shape().items()
    return tuple(sorted((key, value) for key, value in shape if key not in tuned))


def _starts(effects, drops):
    """Return the shapes of a grid to search on from: its best, or its peaks."""
    # A single parameter is searched around its best value; two may trade against each
    # other, with several peaks, none of which lies beside a better one.
    order = np.argsort(drops)[::-1]
    names = effects[0].continuous
    if len(names) < 2:
        return [effects[order[0]]]
    apart = []
    for name in names:
        values, place = np.unique(
            [getattr(e, name) for e in effects], return_inverse=True
        )
        steps = np.abs(place[:, None] - place)
        if name in effects[0].cyclic:
            steps = np.minimum(steps, values.size - steps)
        apart.append(steps)
    near = np.max(apart, axis=0) <= 1
    found = []
    for i in order:
        if not near[i, found].any():
            found.append(i)
    return [effects[i] for i in found[:_STARTS]]


def tuned(effect, base):
    """Return the effect with the shape that suits a model best, or its own.

    The grid is searched first, and then between its points: for each of the settings
    (exponents) under which the effect is one and the same, since the best point of the
    grid need not be near the best shape.
    """
    same = base.family(effect).like(effect)
    if not same.effects:
        return refined(effect, base)
    joints = base.view.joints_of(effect)
    drops = base.fitted.score(joints, same.columns).drop
    settings = {}
    for one, drop in zip(same.effects, drops):
        settings.setdefault(_settings(one), []).append((one, drop))
    offers = [effect]
    for members in settings.values():
        offers += _starts(*zip(*members))

    def drop(one):
        return base.fitted.drop(joints, base.view.columns([one], base.motion))

    found = max((refined(one, base) for one in offers), key=drop)
    if effect.neutral:
        # A parameter costs what it costs elsewhere (Schwarz's criterion).
        plain = clone(found).set_params(**dict(effect.neutral))
        rows = base.view.rows[joints].sum()
        if drop(found) - drop(plain) < len(effect.neutral) * np.log(max(rows, 2.0)):
            return plain
    return found


def tuned_before(effect, base, early):
    """Return the effect with the shape that suits some rows (m,) best."""
    same = base.family(effect).like(effect)
    if not same.effects:
        return effect
    fitted = base.fitted
    there = replace(
        base,
        fitted=BlockRegression(
            fitted.Z * early[:, None],
            fitted.y * early,
            fitted.precision,
            fitted.blocks,
            fitted.ridge,
        ),
    )
    masked = same.columns * early[:, None, None]
    drops = there.fitted.score(base.view.joints_of(effect), masked).drop
    return refined(same.effects[int(np.argmax(drops))], there, early)


def tuned_family(effect, model):
    """Columns (nj, m, c, k) of the grid of shapes, finer around the tuned one."""
    own = model.columns_of(effect)[:, :, None]
    if not effect.continuous:
        return own
    same = model.family(effect).like(effect)
    name = effect.continuous[0]
    bracket = Bracket.of(effect, name, model.motion)
    if not same.effects:
        return own
    if bracket is None:
        return np.concatenate([same.columns, own], axis=2)
    places = np.linspace(bracket.low, bracket.high, _FINER + 2)[1:-1]
    finer = [
        model.columns_of(clone(effect).set_params(**{name: bracket.value(u)}))
        for u in places
    ]
    return np.concatenate([same.columns, np.stack(finer, axis=2)], axis=2)


def _sided(effect, rest, base, model):
    """Yield the model with the plausible direction of an effect, as `absorbing`."""
    joints, family = model.view.joints_of(effect), base.family(effect)
    score = base.fitted.score(joints, family.columns)
    own, score = one_sided(base, family, joints, score)
    if own is not None:
        alone = tuned(own.effects[score.best], base)
        yield SearchModel.of(model.view, [*rest, alone], model)


def absorbing(effect, plain, model):
    """Yield models without plainer effects, for each form of one that contains them.

    Its shape was found beside them, where it stood for what they had left over, and
    with the ridge of a model that lacked it, which takes part of what it is to explain:
    both are found anew, with hardly a ridge, the plainest form first.
    """
    gone = {id(effect), *map(id, plain)}
    rest = tuple(one for one in model.effects if id(one) not in gone)
    base, forms = model.beside(rest, LEAST_RIDGE), effect.excludes()
    if effect.opposite() is not None:
        yield from _sided(effect, rest, base, model)
        return
    joints = model.view.joints_of(effect)
    family = base.family(effect).where(lambda one: one.key() in forms)
    for own in family.forms():
        best = base.fitted.score(joints, own.columns).best
        alone = tuned(own.effects[best], base)
        yield SearchModel.of(model.view, [*rest, alone], model)


def retuned(model, joint):
    """Search the shapes of a joint's effects again, each beside the others."""
    effects = list(model.effects)
    chosen = [i for i, e in enumerate(effects) if e.joint == joint and e.continuous]
    for i in chosen:
        base = model.beside(e for k, e in enumerate(effects) if k != i)
        effects[i] = tuned(effects[i], base)
    if chosen:
        model = SearchModel.of(model.view, effects, model)
    return linearised(model, joint)


def linearised(model, joint):
    """Linearise a joint's effects at the coefficients that they have."""
    for i in range(_MOST_TANGENTS):
        moving = {
            id(e)
            for e in model.effects
            if e.joint == joint and e.tangent and _moves(e, model, i)
        }
        if not moving:
            break
        effects = [
            e.at(model.coefficients(e)) if id(e) in moving else e for e in model.effects
        ]
        model = SearchModel.of(model.view, effects, model)
    return model


def settled(effect, others, model):
    """Fit an effect behind others, linearised until it stays, from a model to start."""
    trial = SearchModel.of(model.view, [*others, effect], model)
    return linearised(trial, effect.joint)


def _moves(effect, model, i):
    """Whether an effect is to be linearised once more, after i times."""
    if not effect.in_model:
        return i < _TANGENTS
    step = model.coefficients(effect)
    # What has left the plausible values is dropped as it is.
    still = (np.abs(step) <= _STAYS * model.deviations(effect)).all()
    return not still and effect.natural(step)


def tuned_on(view, effects):
    """Return effects with shapes that suit another recording, tuple of Effect."""
    if not effects:
        return ()
    # The load of the declared model first, which that of the whole needs.
    model = SearchModel.of(view, effects, SearchModel.of(view))
    found = list(effects)
    for i, effect in enumerate(effects):
        base = model.beside(e for k, e in enumerate(found) if k != i)
        # An instant may lie in a stretch that was not searched.
        found[i] = (tuned if effect.jumping else refined)(effect, base)
    model = SearchModel.of(view, found, model)
    for joint in sorted({effect.joint for effect in found}):
        model = linearised(model, joint)
    return model.effects
