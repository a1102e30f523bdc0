"""Comparison of recordings: fits with recordings left out, and contradictions."""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from scipy import stats

from sklearn_vbjfa._core._linear_systems import or_one, scaled_eigen
from sklearn_vbjfa.effects import Coulomb, JointZero, Offset, Viscous
from sklearn_vbjfa.model import end_joints

# Parts of a recording, between which the variation of a single robot is estimated.
_PARTS = 3
# Largest ratio of squared errors, separate over common fit, of inconsistent recordings.
_RATIO = 0.5
# Relative eigenvalue threshold for the rank of Gram matrices.
_RANK_TOL = 1e-9
# Possible causes of a deviation, with the columns that they use: offset, viscous and
# Coulomb friction, and the torque predicted from the other recordings.
_CAUSES = {"offset": [0], "gain": [3], "friction": [1, 2], "model": [0, 1, 2, 3]}
_COLUMNS = 4
# Log evidence by which "model" must exceed every other cause [nats].
_MARGIN = 3.0


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A recording whose torques on a joint are inconsistent with the others."""

    recording: int  # from zero
    joint: int  # from zero
    # errors over the standard deviation of the torque, on held-out parts of the
    # recording: of a fit to its other parts, and of a fit to all other data
    alone: float
    together: float
    # "offset", "gain" (of the torque), "friction", "zero", "payload"; else "model"
    cause: str
    # difference of the offset [N m or N] or the encoder zero [rad or m], ratio of the
    # torques of a gain, or mass of a payload [kg]; else nan
    value: float
    p_value: float  # of the F test, times the number of tests
    of: int | None = None  # joint of the encoder zero


class RecordingMoments:
    """Second moments of the equations of each joint, by thirds of recordings."""

    # The design matrix of a joint holds its nonzero columns, an offset, viscous and
    # Coulomb friction, and the torque. `moments` is a list over joints of (n_parts, k,
    # k); `recording` (n_parts,) is the recording of each part.

    @classmethod
    def of(cls, fit):
        """Divide a `FinalFit`; None for one recording, or if no joint has a weight."""
        several = np.unique(fit.view.origin).size > 1
        return cls(fit) if several and fit.view.precision.any() else None

    def __init__(self, fit):
        self.view, self.features = fit.view, fit.identifier.features_
        self.nv, self.used = self.view.nv, self.view.precision > 0
        self._theta = fit.identifier.theta_
        names, self.origin = np.unique(self.view.origin, return_inverse=True)
        self.count = names.size
        Phi, tau = fit.columns(), self.view.equations.tau
        self.columns = [np.flatnonzero(row) for row in (Phi != 0).any(axis=0)]
        self._designs = []
        for j, at in enumerate(self.columns):
            terms = [fit.in_equations(e(joint=j)) for e in (Offset, Viscous, Coulomb)]
            terms = [term[:, j, 0] for term in terms]
            self._designs.append(np.column_stack([Phi[:, j, at], *terms, tau[:, j]]))
        # Contiguous thirds: slow noise would correlate interleaved blocks.
        block = np.r_[0, np.cumsum(np.diff(self.view.spans.label) != 0)]
        self.n_blocks = int(block[-1]) + 1
        part = np.zeros(block.size, dtype=int)
        for r in range(self.count):
            rows = self.origin == r
            place = np.unique(block[rows], return_inverse=True)[1]
            part[rows] = _PARTS * r + place * _PARTS // max(place[-1] + 1, _PARTS)
        _, first, part = np.unique(part, return_index=True, return_inverse=True)
        self.recording = self.origin[first]
        self.moments = [self.moments_of(j, part) for j in range(self.nv)]
        weights = self.view.equations.weight.T
        self.weights = np.array([np.bincount(part, w, first.size) for w in weights]).T
        # Prior of the bodies, from the description: precision (p, p), times mean (p,).
        p, rigid = Phi.shape[2], self.features.n_parameters_
        self._prior = np.zeros((p, p)), np.zeros(p)
        described = fit.identifier.body_prior()
        if described is not None:
            fitted = fit.identifier.robot_.joint_weights[self.used]
            ratio = np.mean(self.view.precision[self.used] / fitted)
            metric, centre = described[0][:rigid, :rigid] * ratio, described[1][:rigid]
            self._prior[0][:rigid, :rigid] = metric
            self._prior[1][:rigid] = metric @ centre

    @functools.cached_property
    def with_zeros(self):
        """Moments of recordings by joint; columns of encoder zeros precede torques."""
        motion, zeros = self.view.motion_of(self._theta), map(JointZero, range(self.nv))
        zeros = np.dstack([self.view.in_equations(e, motion) for e in zeros])
        pairs = enumerate(zip(self._designs, zeros.transpose(1, 0, 2)))
        wider = {j: np.insert(x, [-1] * self.nv, z, axis=1) for j, (x, z) in pairs}
        return [self.moments_of(j, self.origin, x) for j, x in wider.items()]

    def moments_of(self, j, part, rows=None):
        """Compute moments of the design of a joint, for each part (n_parts, k, k)."""
        rows = self._designs[j] if rows is None else rows
        weighted = rows * self.view.equations.weight[:, [j]]
        masks = (part == p for p in range(part.max() + 1))
        return np.array([weighted[m].T @ rows[m] for m in masks])

    def solve(self, chosen, precision=None):
        """Fit chosen parts, with the prior; return the eigensystem and theta (p,)."""
        precision = self.view.precision if precision is None else precision
        G, g = (values.copy() for values in self._prior)
        for j in np.flatnonzero(self.used):
            columns, n = self.columns[j], self.columns[j].size
            moments = precision[j] * self.moments[j][chosen].sum(axis=0)
            G[np.ix_(columns, columns)] += moments[:n, :n]
            g[columns] += moments[:n, -1]
        eigen = scaled_eigen(G, _RANK_TOL)
        return eigen, eigen.solve(g)

    def squares(self, chosen, fitted):
        """Return weighted squared errors (nv,) on chosen parts, of a fit to others."""
        errors, (_, theta) = [], self.solve(fitted)
        for columns, moments in zip(self.columns, self.moments):
            v = np.r_[-theta[columns], 0.0, 0.0, 0.0, 1.0]
            errors.append(v @ moments[chosen].sum(axis=0) @ v)
        return np.maximum(errors, 0.0)

    def left_out(self, spread):
        """Return errors (r, nv) on each recording of fits to the other recordings."""
        # Recordings of the same motion are left out together.
        repetition = self.view.repetition
        motion = repetition.motion if repetition else np.arange(self.count)
        names = np.unique(motion)
        if names.size < 2:
            return np.empty((0, spread.size))
        out = np.full((names.size, spread.size), np.nan)
        for row, name in zip(out, names):
            test = np.isin(self.recording, np.flatnonzero(motion == name))
            squares = self.squares(test, ~test)
            weight = self.weights[test].sum(axis=0)
            used = (weight > 0) & self.used
            row[used] = np.sqrt(squares[used] / weight[used]) / spread[used]
        return out

    @functools.cached_property
    def _errors(self):
        """Squared errors on held-out parts of each recording, (2, r, nv)."""
        # Of fits to the rest of the recording, and to the rest of all recordings.
        squares = np.zeros((2, self.count, self.nv))
        for r in range(self.count):
            same = self.recording == r
            for p in np.flatnonzero(same) if same.sum() >= _PARTS else ():
                test = np.arange(same.size) == p
                squares[0, r] += self.squares(test, same & ~test)
                squares[1, r] += self.squares(test, ~test)
        return squares

    @functools.cached_property
    def separate_squares(self):
        """Squared errors of a separate fit to each recording, (r, nv)."""
        masks = [self.recording == r for r in range(self.count)]
        return np.array([self.squares(m, m) for m in masks])

    @functools.cached_property
    def partitions(self):
        """Pairs of moments and recordings, for thirds of time, position and speed."""
        # Parameters fitted with an incomplete model vary with position and speed.
        nv, states = self.nv, self.view.states[self.view.index]
        weight, pairs = self.view.equations.weight, [(self.moments, self.recording)]
        for values in (states[:, :nv], np.abs(states[:, nv : 2 * nv])):
            moments = [
                self.moments_of(j, _thirds(self.origin, values[:, j], weight[:, j]))
                for j in range(nv)
            ]
            pairs.append((moments, np.repeat(np.arange(self.count), _PARTS)))
        return pairs

    def alone(self, spread):
        """Return errors (nv,) on held-out parts, of fits within recordings."""
        whole = self._errors[0].any(axis=1)
        rows = self.weights[whole[self.recording]].sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(self._errors[0].sum(axis=0) / rows) / spread

    def inconsistent(self, spread):
        """Return errors of both fits, by (recording, joint) with a worse common fit."""
        errors = {}
        for r, (alone, together) in enumerate(zip(*self._errors)):
            rows = self.weights[self.recording == r].sum(axis=0) * self.used
            better = (rows > 0) & (together > 0) & (alone <= _RATIO * together)
            for j in np.flatnonzero(better).tolist():
                pair = np.sqrt(np.array([alone[j], together[j]]) / rows[j]) / spread[j]
                errors[r, j] = dict(zip(("alone", "together"), pair.tolist()))
        return errors


def contradictions(parts, spread, alpha):
    """Find each `Contradiction` between recordings; none if parts is None."""
    errors = {} if parts is None else parts.inconsistent(spread)
    if not errors:
        return ()
    # Of two recordings, either may be the one that deviates.
    some = parts.count > 2
    suspects = sorted({r for r, _ in errors}) if some else range(parts.count)
    joints = sorted({j for _, j in errors})
    remaining = list(range(parts.count))
    while suspects := [r for r in suspects if r in remaining]:
        # A deviating recording also makes others inconsistent until it is left out.
        trials = {r: _Deviations(parts, r, remaining) for r in suspects}
        tested = {(r, j): x.test(j) for r, x in trials.items() for j in joints}
        r, j = max(tested, key=lambda key: tested[key][0])
        if not tested[r, j][1] < alpha:
            break
        remaining.remove(r)
    removed = [r for r in range(parts.count) if r not in remaining]
    deviations = (_Deviations(parts, r, [*remaining, r]) for r in removed)
    return tuple(x for d in deviations for x in d.significant(joints, alpha, errors))


class _Deviations:
    """Deviations of a recording from the robot of other recordings, by joints."""

    # tau = Phi theta + E_j u_j + noise: deviations u_j of the recording in four columns
    # E_j of a joint. F = (explained by the recording) / (explained by parts of single
    # recordings) in the same columns, as in a nested analysis of variance (H. Scheffe,
    # "The Analysis of Variance", 1959, section 5.3).

    def __init__(self, parts, recording, recordings):
        # recordings: the fitted ones, including this one.
        self._parts, self._recording, self._recordings = parts, recording, recordings
        chosen = np.isin(parts.recording, recordings)
        self._rows = parts.recording == recording
        # Joint weights from separate fits: in a common fit, differences between
        # recordings would count as noise.
        squares = parts.separate_squares[recordings].sum(axis=0)
        used, total = parts.used & (squares > 0), parts.weights[chosen].sum(axis=0)
        self._noise = np.where(used, total / or_one(squares), 0.0)
        self._eigen, self._theta = parts.solve(chosen, self._noise)
        others, self._columns = parts.solve(chosen & ~self._rows)[1], []
        for places in parts.columns:
            columns = np.eye(places.size + 3, _COLUMNS, -places.size)
            columns[: places.size, 3] = others[places]
            self._columns.append(columns)

    def _fitted(self, added, shared=False):
        """Fit added columns by joints; return the gain, theta and the coefficients."""
        # shared: whether all joints have the same coefficients.
        edges = np.cumsum([0, *(A.shape[1] for A in added.values())])
        places = [slice(a, b) for a, b in itertools.pairwise(edges)]
        if shared:
            edges, places = edges[:2], places[:1] * len(places)
        cross, h = np.zeros((self._theta.size, edges[-1])), np.zeros(edges[-1])
        H = np.zeros((edges[-1], edges[-1]))
        for (j, A), at in zip(added.items(), places):
            columns, n = self._parts.columns[j], len(A)
            moments = self._noise[j] * self._parts.with_zeros[j][self._recording]
            GA = moments[:, :n] @ A
            cross[columns, at] += GA[: columns.size]
            h[at] += A.T @ moments[:n, -1]
            H[at, at] += A.T @ GA[:n]
        # Schur complement: theta is eliminated.
        solution = self._eigen.solve(cross)
        H, h = H - cross.T @ solution, h - cross.T @ self._theta
        coef = scaled_eigen(H, _RANK_TOL).solve(h)
        coefs = {j: coef[at] for j, at in zip(added, places)}
        return float(coef @ h), self._theta - solution @ coef, coefs

    def _within(self, j, coef, theta):
        """Squares per parameter that thirds of recordings explain on a joint."""
        # With the degrees of freedom, for the partition with the largest variance.
        A, n, sizes = self._columns[j], self._parts.columns[j].size, []
        fitted = np.zeros((self._parts.count, A.shape[0]))
        fitted[:, :n] = theta[self._parts.columns[j]]
        fitted[self._recording] += A @ coef
        for moments, recording in self._parts.partitions:
            M = self._noise[j] * moments[j]
            e = M[:, :-1, -1] - (M[:, :-1, :-1] @ fitted[recording, :, None])[..., 0]
            scores, grams = e @ A, A.T @ M[:, :-1, :-1] @ A
            total = np.zeros(2)
            for rows in (recording == r for r in self._recordings):
                total += sum(map(_gain, scores[rows], grams[rows]))
                total -= _gain(scores[rows].sum(axis=0), grams[rows].sum(axis=0))
            size = total[0] / total[1] if total[1] > 0 else np.inf
            sizes.append((size, total[1] if total[1] > 0 else 1))
        return max(sizes)

    def test(self, j, joints=()):
        """Return F statistic, p-value and variance unit of the deviation on a joint."""
        # joints: others that may deviate as well.
        added = {k: self._columns[k] for k in {*joints, j}}
        gain, theta, coefs = self._fitted(added)
        size, freedom = self._within(j, coefs[j], theta)
        del added[j]
        # Recordings may differ as much as single thirds, more than means of thirds do.
        unit = 1.0 + _PARTS * (max(size, 1.0) - 1.0)
        F = (gain - self._fitted(added)[0]) / unit / _COLUMNS
        count = self._parts.count * self._parts.nv
        return F, min(float(stats.f.sf(F, _COLUMNS, freedom)) * count, 1.0), unit

    def significant(self, joints, alpha, errors):
        """Yield the `Contradiction` of each joint with a significant deviation."""
        tested = {j: self.test(j, joints) for j in joints}
        tested = {j: x for j, x in tested.items() if x[1] < alpha}
        unit = max((unit for *_, unit in tested.values()), default=1.0)
        cause, values = self._cause(tested, unit)
        of, cause = (cause, "zero") if isinstance(cause, int) else (None, cause)
        for j, (_, p_value, _) in tested.items():
            r, value = self._recording, values.get(j, np.nan)
            about = {"alone": np.nan, "together": np.nan, "p_value": p_value, "of": of}
            about |= errors.get((r, j), {})
            yield Contradiction(recording=r, joint=j, cause=cause, value=value, **about)

    def _cause(self, joints, unit):
        """Choose the cause of highest evidence (Schwarz), with values by joints."""
        parts, trials = self._parts, []
        for name, chosen in _CAUSES.items():
            trials.append((name, {j: self._columns[j][:, chosen] for j in joints}))
        # A shifted encoder zero (by its joint), and a payload on the last body of a
        # branch act on several joints.
        for k in range(parts.nv):
            zero = [np.eye(x.size + 4 + k, 1, -x.size - 3 - k) for x in parts.columns]
            trials.append((k, dict(enumerate(zero))))
        for body in end_joints(parts.features.model_):
            indices = parts.features.n_parameters_ // parts.nv * body + np.arange(10)
            load = [np.equal.outer(np.r_[x, [-1] * 3], indices) for x in parts.columns]
            trials.append(("payload", dict(enumerate(map(np.float64, load)))))
        best, choice = -np.inf, None
        for name, columns in trials:
            shared = name not in _CAUSES
            gain, _, coefs = self._fitted(columns, shared)
            count = coefs[0].size if shared else sum(map(np.size, coefs.values()))
            score = 0.5 * (gain / unit - count * np.log(parts.n_blocks))
            if (score := score - _MARGIN * (name == "model")) <= best:
                continue
            # The mass of a payload on the joint axis exerts no torque.
            no_m = {j: A[:, 1:] for j, A in columns.items() if name == "payload"}
            unknown = no_m and gain - self._fitted(no_m, True)[0] < 2 * _MARGIN * unit
            if unknown or name in ("friction", "model"):
                coefs = {}
            values = {j: float(x[0]) + (name == "gain") for j, x in coefs.items()}
            best, choice = score, (name, values)
        return choice


def _gain(h, H):
    """Return squares that columns explain, and the rank of these."""
    eigen = scaled_eigen(H, _RANK_TOL)
    return np.array([float(h @ eigen.solve(h)), eigen.rank])


def _thirds(recording, values, weight):
    """Divide the rows of recordings (m,) into thirds by the values of a signal."""
    part = np.zeros(values.size, dtype=int)
    for number in range(recording.max() + 1):
        rows = np.flatnonzero(recording == number)
        order = rows[np.argsort(values[rows], kind="stable")]
        cumulative = np.cumsum(weight[order])
        share = cumulative / or_one(cumulative[-1])
        third = np.minimum((_PARTS * share).astype(int), _PARTS - 1)
        part[order] = _PARTS * number + third
    return part
