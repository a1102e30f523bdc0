"""Comparison of recordings: fits with recordings left out, and contradictions."""

import functools
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
    # Coulomb friction, the encoder zeros of all joints, and the torque. `partitions` is
    # a list over joints of moments (n_parts, k, k) for thirds of time, position and
    # speed, `moments` of those of time; `recording` (n_parts,) is that of each part.

    @classmethod
    def of(cls, fit):
        """Divide a `FinalFit`; None for one recording, or if no joint has a weight."""
        several = np.unique(fit.view.origin).size > 1
        return cls(fit) if several and fit.view.precision.any() else None

    def __init__(self, fit):
        self.view, self.features = fit.view, fit.identifier.features_
        self.nv, self.used = self.view.nv, self.view.precision > 0
        self.further = 3 + self.nv  # columns of each design, besides the regressor's
        weight, tau = self.view.equations.weight, self.view.equations.tau
        Phi = np.concatenate([self.view.equations.Phi, fit.added], axis=2)
        # numbers: those of the recordings of which rows were selected.
        self.numbers, origin = np.unique(self.view.origin, return_inverse=True)
        self.count = self.numbers.size
        self.recording = np.repeat(np.arange(self.count), _PARTS)
        self.columns = [np.flatnonzero(row) for row in (Phi != 0).any(axis=0)]
        # Contiguous thirds: slow noise would correlate interleaved blocks.
        part = _thirds(origin, np.arange(origin.size), weight.sum(axis=1))
        q, v, _ = np.split(self.view.states[self.view.index], 3, axis=1)
        motion, self.partitions = self.view.motion_of(fit.identifier.theta_), []
        zeros = [self.view.in_equations(JointZero(k), motion) for k in range(self.nv)]
        for j, at in enumerate(self.columns):
            terms = [fit.in_equations(e(joint=j)) for e in (Offset, Viscous, Coulomb)]
            columns = Phi[:, :, at], *terms, *zeros, tau[:, :, None]
            design = np.concatenate([x[:, j] for x in columns], axis=1)
            # Parameters fitted with an incomplete model vary with position and speed.
            signals, w = (q[:, j], np.abs(v[:, j])), weight[:, j]
            parts = part, *(_thirds(origin, x, w) for x in signals)
            self.partitions.append([self._moments(design, w, x) for x in parts])
        self.moments = [moments for moments, *_ in self.partitions]
        masks = (part == p for p in range(self.recording.size))
        self.weights = np.array([weight[m].sum(axis=0) for m in masks])
        # Prior of the bodies, from the description: precision (p, p), times mean (p,).
        p, rigid = Phi.shape[2], slice(self.features.n_parameters_)
        self._prior = np.zeros((p, p)), np.zeros(p)
        if (bodies := fit.identifier.estimate_.bodies) is not None:
            fitted = fit.identifier.robot_.joint_weights[self.used]
            ratio = np.mean(self.view.precision[self.used] / fitted)
            metric = bodies.weighted_prior[rigid, rigid] * ratio
            self._prior[0][rigid, rigid] = metric
            self._prior[1][rigid] = metric @ bodies.centre[rigid]

    def _moments(self, rows, weight, part):
        """Compute moments of weighted rows, for each part (n_parts, k, k)."""
        weighted = rows * weight[:, None]
        masks = (part == p for p in range(self.recording.size))
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
            v = np.r_[-theta[columns], np.zeros(self.further), 1.0]
            errors.append(v @ moments[chosen].sum(axis=0) @ v)
        return np.maximum(errors, 0.0)

    def left_out(self, spread):
        """Return errors (r, nv) on each recording of fits to the other recordings."""
        # Recordings of the same motion are left out together.
        repetition = self.view.repetition
        motion = repetition.motion[self.numbers] if repetition else self.numbers
        names, errors = np.unique(motion), []
        for name in names if names.size > 1 else ():
            test = motion[self.recording] == name
            rows = self.weights[test].sum(axis=0)
            errors.append(_relative(self.squares(test, ~test), rows, spread))
        return np.reshape(errors, (-1, self.nv))

    @functools.cached_property
    def _held_out_squares(self):
        """Squared errors on held-out parts of each recording, (2, r, nv)."""
        # Of fits to the rest of the recording, and to the rest of all recordings.
        squares = np.zeros((2, self.count, self.nv))
        for test, r in zip(np.eye(self.recording.size, dtype=bool), self.recording):
            squares[0, r] += self.squares(test, (self.recording == r) & ~test)
            squares[1, r] += self.squares(test, ~test)
        return squares

    @functools.cached_property
    def separate_squares(self):
        """Squared errors of a separate fit to each recording, (r, nv)."""
        masks = [self.recording == r for r in range(self.count)]
        return np.array([self.squares(m, m) for m in masks])

    def alone(self, spread):
        """Return errors (nv,) on held-out parts, of fits within recordings."""
        squares = self._held_out_squares[0].sum(axis=0)
        return _relative(squares, self.weights.sum(axis=0), spread)

    def inconsistent(self, spread):
        """Return errors (2, r, nv) of both fits, nan unless the common one is worse."""
        squares = self._held_out_squares
        rows = self.weights.reshape(self.count, _PARTS, -1).sum(axis=1)
        errors = _relative(squares, rows, spread)
        better = (errors[1] > 0) & (squares[0] <= _RATIO * squares[1])
        return np.where(better, errors, np.nan)


def _relative(squares, rows, spread):
    """Return errors over a spread from squared ones; nan where no row has a weight."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squares / rows) / spread


def contradictions(parts, spread, alpha):
    """Find each `Contradiction` between recordings; none if parts is None."""
    if parts is None:
        return ()
    errors = parts.inconsistent(spread)
    joints = np.flatnonzero(np.isfinite(errors[1]).any(axis=0)).tolist()
    # A deviating recording makes others inconsistent, and need not fit itself well.
    remaining, removed = list(range(parts.count)), []
    while joints and remaining:
        trials = {r: _Deviations(parts, r, remaining) for r in remaining}
        r = max(trials, key=lambda r: trials[r].gain(joints))
        if not any(trials[r].test(j)[1] < alpha for j in joints):
            break
        remaining.remove(r)
        removed.append(r)
    deviations = (_Deviations(parts, r, [*remaining, r]) for r in sorted(removed))
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
        self._rows = parts.recording == recording
        chosen = np.isin(parts.recording, recordings)
        # Joint weights from separate fits: in a common fit, differences between
        # recordings would count as noise.
        squares = parts.separate_squares[recordings].sum(axis=0)
        used, total = parts.used & (squares > 0), parts.weights[chosen].sum(axis=0)
        self._noise = np.where(used, total / or_one(squares), 0.0)
        self._eigen, self._theta = parts.solve(chosen, self._noise)
        others = parts.solve(chosen & ~self._rows)[1]
        self._columns = []
        for at in parts.columns:
            terms = np.eye(at.size + parts.further, 3, -at.size)
            torque = np.pad(others[at], (0, parts.further))
            self._columns.append(np.column_stack([terms, torque]))

    def _fitted(self, added, shared=False):
        """Fit added columns by joints; return the gain, theta and coefficients."""
        # shared: whether all joints have the same coefficients.
        blocks = np.ones((len(added), 1)) if shared else np.eye(len(added))
        added = {j: np.kron(x, A) for x, (j, A) in zip(blocks, added.items())}
        k = max((A.shape[1] for A in added.values()), default=0)
        cross, H, h = np.zeros((self._theta.size, k)), np.zeros((k, k)), np.zeros(k)
        for j, A in added.items():
            columns = self._parts.columns[j]
            moments = self._noise[j] * self._parts.moments[j][self._rows].sum(axis=0)
            GA = moments[:-1, :-1] @ A
            cross[columns] += GA[: columns.size]
            H += A.T @ GA
            h += A.T @ moments[:-1, -1]
        # Schur complement: theta is eliminated.
        solution = self._eigen.solve(cross)
        H, h = H - cross.T @ solution, h - cross.T @ self._theta
        coef = scaled_eigen(H, _RANK_TOL).solve(h)
        return float(coef @ h), self._theta - solution @ coef, coef

    def gain(self, joints):
        """Return by how much squared errors fall if some joints deviate."""
        return self._fitted({j: self._columns[j] for j in joints})[0]

    def _within(self, j, coef, theta):
        """Squares per parameter that thirds of recordings explain on a joint."""
        # With the degrees of freedom, for the partition with the largest variance.
        A, n, sizes = self._columns[j], self._parts.columns[j].size, []
        fitted = np.zeros((self._rows.size, A.shape[0], 1))
        fitted[:, :n, 0] = theta[self._parts.columns[j]]
        fitted[self._rows, :, 0] += A @ coef
        for moments in self._parts.partitions[j]:
            M = self._noise[j] * moments
            scores = (M[:, :-1, -1:] - M[:, :-1, :-1] @ fitted)[:, :, 0] @ A
            grams, total = A.T @ M[:, :-1, :-1] @ A, np.zeros(2)
            for rows in (self._parts.recording == r for r in self._recordings):
                total += sum(map(_gain, scores[rows], grams[rows]))
                total -= _gain(scores[rows].sum(axis=0), grams[rows].sum(axis=0))
            squares, freedom = total if total[1] > 0 else (np.inf, 1.0)
            sizes.append((squares / freedom, freedom))
        return max(sizes)

    def test(self, j, joints=()):
        """Return F statistic, p-value and variance unit of the deviation on a joint."""
        # joints: others that may deviate as well.
        added = {k: self._columns[k] for k in (j, *(k for k in joints if k != j))}
        gain, theta, coef = self._fitted(added)
        size, freedom = self._within(j, coef[:_COLUMNS], theta)
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
        cause, of, values = self._cause(tested, unit)
        number = int(self._parts.numbers[self._recording])
        for j, (_, p_value, _) in tested.items():
            alone, together = errors[:, self._recording, j].tolist()
            about = {"alone": alone, "together": together, "cause": cause, "of": of}
            about |= {"joint": j, "value": values.get(j, np.nan), "p_value": p_value}
            yield Contradiction(recording=number, **about)

    def _cause(self, joints, unit):
        """Choose the cause of highest evidence (Schwarz), with values by joints."""
        parts, trials, pad = self._parts, [], (0, self._parts.further)
        for name, chosen in _CAUSES.items():
            own = {j: self._columns[j][:, chosen] for j in joints}
            trials.append((name, None, own))
        # A shifted encoder zero, and a payload on the last body of a branch act on
        # several joints.
        every = [np.pad(x, pad, constant_values=-1) for x in parts.columns]
        for k in range(parts.nv):
            zero = [np.eye(x.size, 1, parts.nv - k - x.size) for x in every]
            trials.append(("zero", k, dict(enumerate(zero))))
        for body in end_joints(parts.features.model_):
            indices = parts.features.n_parameters_ // parts.nv * body + np.arange(10)
            load = (np.equal.outer(x, indices).astype(float) for x in every)
            trials.append(("payload", None, dict(enumerate(load))))
        best, choice = -np.inf, None
        for name, joint, columns in trials:
            gain, _, coef = self._fitted(columns, shared=name not in _CAUSES)
            score = 0.5 * (gain / unit - coef.size * np.log(parts.view.spans.n_blocks))
            if (score := score - _MARGIN * (name == "model")) > best:
                best, choice = score, (name, joint, columns, gain, coef)
        cause, of, columns, gain, coef = choice
        # The mass of a payload on the joint axis exerts no torque.
        no_mass = {j: A[:, 1:] for j, A in columns.items() if cause == "payload"}
        unknown = no_mass and gain - self._fitted(no_mass, True)[0] < 2 * _MARGIN * unit
        if unknown or cause in ("friction", "model"):
            return cause, of, {}
        values = coef if cause in _CAUSES else np.full(len(joints), coef[0])
        return cause, of, dict(zip(joints, (values + (cause == "gain")).tolist()))


def _gain(h, H):
    """Return squares that columns explain, and the rank of these."""
    eigen = scaled_eigen(H, _RANK_TOL)
    return np.array([float(h @ eigen.solve(h)), eigen.rank])


def _thirds(recording, values, weight):
    """Divide the rows of recordings (m,) into thirds by the values of a signal."""
    order, part = np.lexsort((values, recording)), np.empty(values.size, dtype=int)
    cumulative, total = np.cumsum(weight[order]), np.bincount(recording, weight)
    before = np.cumsum(total) - total
    share = (cumulative - before[recording[order]]) / or_one(total)[recording[order]]
    third = np.minimum((_PARTS * share).astype(int), _PARTS - 1)
    part[order] = _PARTS * recording[order] + third
    return part
