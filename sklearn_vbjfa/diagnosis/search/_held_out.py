"""What each effect is worth on stretches of time that were not fitted."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """What an effect saves on stretches of time that were not fitted.

    Attributes
    ----------
    gain : float
        Share of the squared error in rows as recorded that it saves; of its joint, or
        of the robot in units of noise for what acts on all.
    gain_std : float
        Its standard error, from the scatter between stretches.
    errors : float
        What it saves in whitened rows, over its standard error.
    helped : float
        Share of the stretches in which it helps.
    n_blocks : int
        Number of stretches in which it changes anything.
    """

    gain: float
    gain_std: float
    errors: float
    helped: float
    n_blocks: int

    @classmethod
    def of(cls, before, after, white_before, white_after):
        """Compare squared errors (n_blocks,), as recorded and whitened."""
        saved, white = before - after, white_before - white_after
        used = white != 0
        total, count = before.sum(), int(used.sum())
        if count < 2 or total == 0:
            return cls(gain=0.0, gain_std=0.0, errors=0.0, helped=0.0, n_blocks=count)
        scatter = white[used].std(ddof=1) * np.sqrt(count)
        return cls(
            gain=float(saved.sum() / total),
            gain_std=float(saved.std() * np.sqrt(saved.size) / total),
            errors=float(white.sum() / scatter) if scatter > 0 else 0.0,
            helped=float((white[used] > 0).mean()),
            n_blocks=count,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldOutFit:
    """A model on stretches of time that were not fitted.

    Attributes
    ----------
    members : list of HeldOut
        What each of its effects is worth there.
    residual : ndarray of shape (nv, m)
        Its residuals there, scaled by the root of the weights.
    """

    members: list
    residual: np.ndarray


def held_out(fit, motion):
    """Leave out folds of time, and say what each member of a `Fit` is worth there."""
    problem = fit.problem
    view, cosines = problem.view, problem.cosines
    heard = np.flatnonzero(problem.heard)
    if heard.size == 0:
        return HeldOutFit(members=[], residual=np.zeros_like(view.target))
    r, p = problem.Z.shape[2], problem.Z.shape[2] + fit.n_coefficients
    raw, white = [], []
    columns = [view.columns([m.effect], motion)[:, :, 0] for m in fit.members]
    for j in heard:
        X = np.column_stack([problem.Z[j], fit.rows_of(j), problem.y[j]])
        X *= np.sqrt(fit.base.weights[j])[:, None]
        used = view.root[:, j, None] > 0
        white.append(np.where(used, cosines.rows(X[None])[0], 0.0))
        own = np.zeros((view.index.size, fit.n_coefficients))
        for place, member, made in zip(fit.places, fit.members, columns):
            if j in member.joints:
                own[:, place] = made[member.joints.index(j)]
        raw.append(np.column_stack([view.Z[j], own, view.target[j]]))
    raw, white = np.array(raw), np.array(white)
    penalty = np.r_[np.zeros(r), fit.prior]
    total = np.einsum("jma,jmb->ab", white, white, optimize=True)
    penalty[:r] = 1e-9 * np.maximum(np.diagonal(total)[:r], 1.0)
    done = np.r_[np.zeros(r), fit.done]
    pull = penalty * done
    n_members = len(fit.members)
    squares = np.zeros((2, n_members + 1, heard.size, view.index.size))
    residual = np.zeros((view.nv, view.index.size))
    for rows in view.blocks.folds():
        part = white[:, rows].reshape(-1, p + 1)
        left = total - part.T @ part
        G, g = left[:p, :p] + np.diag(penalty), left[:p, p] - pull
        factor = linalg.cho_factor(G)
        theta = [linalg.cho_solve(factor, g)]
        for place in fit.places:
            # What leaving columns out does to the others, by the block inverse.
            own = slice(r + place.start, r + place.stop)
            unit = np.eye(p)[:, own]
            inverse = linalg.cho_solve(factor, unit)
            shift = inverse @ np.linalg.solve(inverse[own], theta[0][own] + done[own])
            theta.append(theta[0] - shift)
        theta = np.array(theta).T
        for kind, made in enumerate((raw, white)):
            wrong = made[:, rows, p, None] - made[:, rows, :p] @ theta
            squares[kind][:, :, rows] = (wrong**2).transpose(2, 0, 1)
            if kind == 0:
                residual[np.ix_(heard, rows)] = wrong[:, :, 0]
    blocks = view.blocks.sums(np.moveaxis(squares, -1, 0)).transpose(1, 2, 0, 3)
    found = []
    for i, member in enumerate(fit.members):
        own = slice(None)
        scale = view.precision[heard]
        if not member.effect.everywhere:
            own = heard == member.effect.joint
            scale = np.ones(1)
        after, before = blocks[:, 0][..., own], blocks[:, i + 1][..., own]
        found.append(
            HeldOut.of(
                before[0] @ scale,
                after[0] @ scale,
                before[1].sum(axis=1),
                after[1].sum(axis=1),
            )
        )
    return HeldOutFit(members=found, residual=residual)


def held_out_rows(view):
    """Residuals (nv, m) of the declared model on folds of time that were not fitted.

    Scaled by the root of the weights; the coefficients of all rows (r,) beside them.
    """
    weight = view.precision[:, None, None]
    root = np.sqrt(weight)
    rows, right = view.Z * root, view.target * root[:, :, 0]
    total = np.einsum("jma,jmb->ab", rows, rows, optimize=True)
    total += 1e-9 * max(np.trace(total) / max(len(total), 1), 1.0) * np.eye(len(total))
    g = np.einsum("jma,jm->a", rows, right, optimize=True)
    residual = np.empty_like(view.target)
    for fold in view.blocks.folds():
        part, own = rows[:, fold], right[:, fold]
        left = total - np.einsum("jma,jmb->ab", part, part, optimize=True)
        theta = np.linalg.solve(left, g - np.einsum("jma,jm->a", part, own))
        residual[:, fold] = view.target[:, fold] - view.Z[:, fold] @ theta
    return residual, np.linalg.solve(total, g)
