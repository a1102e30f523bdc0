"""The shape of an effect that comes into a model: smooth, of a bank, or of a jump."""

from dataclasses import replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._problem import Fit
from sklearn_vbjfa.diagnosis.search._refine import instant, stepped

# Instants of a jump that are looked at more closely.
_JUMPS = 3


def best_shape(fit, effect, family, scale):
    """Return an effect of a family, its shape searched between the grid's."""
    # Smooth parameters are left to the steps with all that comes beside it.
    if effect.bank:
        return bank(fit, effect, scale)
    if getattr(effect, "jumping", ()):
        return jump(fit, effect, family, scale)
    return effect


def bank(fit, effect, scale, again=False):
    """Return a bank with the elements of positive size given a fit."""
    family = fit.problem.shaped(fit.problem.variants(effect, again))
    groups = fit.groups(family)
    best = int(np.argmax(groups.evidence(scale)))
    found, coef = family.effects[best], groups.coefficients()[best]
    used = coef[: len(found.coefficients)] > 0
    if not used.any():
        return effect
    found = found.only(used).finer()
    coef = fit.groups(fit.problem.shaped([found])).coefficients()[0]
    return found.only(coef > 0)


def jump(fit, effect, family, scale, near=False):
    """Return an effect that jumps with its most probable instant, or one near it."""

    def evidence(effects):
        return fit.groups(fit.problem.shaped(effects)).evidence(scale)

    tried = [effect, *_instants(fit, effect, family, scale)]
    if near:
        return tried[int(np.argmax(evidence(tried)))]
    return instant(tried, evidence, fit.problem.motion)


def _instants(fit, effect, family, scale):
    """Return an effect that jumps with the most probable instants of all rows."""
    # What its columns have in common with the residual is a sum over the rows after
    # the jump; their Gram matrix hardly changes between two instants of the grid.
    (name,) = effect.jumping
    view, motion = fit.problem.view, fit.problem.motion
    grid = np.array([getattr(e, name) for e in family.effects])
    order, beside = np.argsort(grid), fit.groups(family)
    always = clone(effect).set_params(**{name: -np.inf})
    columns = view.columns([always], motion)[:, :, 0]
    rest = fit.weighted_rows[list(view.joints_of(effect))]
    products = np.einsum("jmk,jm->mk", columns, rest)
    after = np.cumsum(products[::-1], axis=0)[::-1]
    t = motion.t[view.index]
    at = np.interp(t, grid[order], np.arange(order.size))
    low = np.minimum(at.astype(int), max(order.size - 2, 0))
    share = (at - low)[:, None, None]
    H = beside.H[order]
    H = (1 - share) * H[low] + share * H[np.minimum(low + 1, order.size - 1)]
    near = order[np.round(at).astype(int)]
    own = {"own": beside.own[near], "unit": beside.unit[near]}
    evidence = replace(beside, H=H, q=after, **own).evidence(scale)
    found, apart = [], np.diff(grid[order]).max(initial=0.0) / 4
    for _ in range(_JUMPS):
        best = int(np.argmax(evidence))
        found.append(clone(effect).set_params(**{name: float(t[best])}))
        evidence = np.where(np.abs(t - t[best]) < apart, -np.inf, evidence)
    return found


def searched(fit, numbers, scale):
    """Search the shapes of members again, all at once or one by one."""
    fit = stepped(fit, numbers)
    for i in numbers:
        effect, rest = fit.members[i].effect, fit.without(i)
        if effect.bank:
            found = bank(rest, effect, scale, again=True)
        elif getattr(effect, "jumping", ()):
            grid = fit.problem.shaped(fit.problem.variants(effect))
            found = jump(rest, effect, grid, scale)
        else:
            continue
        members = list(fit.members)
        members[i] = fit.problem.shaped([found]).member(0, members[i].scale)
        fit = Fit(fit.base, members)
    return fit
