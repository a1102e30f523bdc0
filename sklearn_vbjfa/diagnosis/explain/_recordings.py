"""Recordings against each other: fits without some of them, and contradictions."""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from scipy import stats

from sklearn_vbjfa._core._linear_systems import or_one, scaled_eigen
from sklearn_vbjfa.effects import Coulomb, Offset, Viscous

# Parts of a recording: they show how much one robot differs from itself.
_PARTS = 3
# A recording suffers if most of its squared error comes from the other recordings.
_MOST = 0.5
# Directions that the data determine less than this share are left alone.
_KNOWN = 1e-9
# Most deviations that are named.
_MOST_FOUND = 8
# What may differ on a joint, with its columns: offset, viscous and Coulomb friction,
# and the torques of the robot of the other recordings and of its last body.
_CAUSES = {"offset": [0], "gain": [3], "friction": [1, 2], "payload": [4]}
# The first of these columns find a difference; the last body's only names it.
_COLUMNS = 4
# Nats by which all columns must explain more than the best cause to be one.
_NATS = 3.0


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A recording whose torques on a joint are not those of the robot of the others."""

    recording: int  # from zero
    joint: int  # from zero
    # errors over the deviation of the torque, on parts of the recording that were not
    # fitted: by a fit to the rest of this recording, and by one to the rest of all
    alone: float
    together: float
    # what differs: "offset", "gain" (of the torque), "friction" or "payload"; "model"
    # for more
    cause: str
    # of an offset: how much larger it is [N m or N]; of a gain or a payload: how many
    # times as large the torque is, or that of the last body; else nan
    value: float
    p_value: float  # of the F test, times the number of tests


class Parts:
    """Second moments of the equations of each joint, by recordings and their thirds."""

    # The design of a joint has the parameters that move it, an offset, viscous and
    # Coulomb friction, and the torque. Moments are a list over joints of (n_parts, k,
    # k); `recording` names the recording of each part.

    @classmethod
    def of(cls, fit):
        """Divide a `FinalFit`; None for a single recording, or if no channel counts."""
        several = np.unique(fit.view.origin).size > 1
        return cls(fit) if several and fit.view.precision.any() else None

    def __init__(self, fit):
        self.view, self.features = fit.view, fit.identifier.features_
        self.nv, self.used = self.view.nv, self.view.precision > 0
        names, self.origin = np.unique(self.view.origin, return_inverse=True)
        self.count = names.size
        Phi, tau = fit.columns(), self.view.equations.tau
        self.columns = [np.flatnonzero(own) for own in (Phi != 0).any(axis=0)]
        self._designs = []
        for j, own in enumerate(self.columns):
            terms = [fit.in_equations(e(joint=j)) for e in (Offset, Viscous, Coulomb)]
            terms = [term[:, j, 0] for term in terms]
            self._designs.append(np.column_stack([Phi[:, j, own], *terms, tau[:, j]]))
        # Thirds of the blocks of time, and not blocks in turns: slow noise would be
        # known from both neighbours.
        block = np.r_[0, np.cumsum(np.diff(self.view.spans.label) != 0)]
        self.n_blocks = int(block[-1]) + 1
        part = np.zeros(block.size, dtype=int)
        for r in range(self.count):
            own = self.origin == r
            place = np.unique(block[own], return_inverse=True)[1]
            part[own] = _PARTS * r + place * _PARTS // max(place[-1] + 1, _PARTS)
        _, first, part = np.unique(part, return_index=True, return_inverse=True)
        self.recording = self.origin[first]
        self.moments = [self.moments_of(j, part) for j in range(self.nv)]
        weights = self.view.equations.weight.T
        self.weights = np.array([np.bincount(part, w, first.size) for w in weights]).T
        # The description of the bodies, as moments (p, p), (p,).
        p, rigid = Phi.shape[2], self.features.n_parameters_
        self._prior = np.zeros((p, p)), np.zeros(p)
        described = fit.identifier.described()
        if described is not None:
            own = fit.identifier.robot_.joint_weights[self.used]
            ratio = np.mean(self.view.precision[self.used] / own)
            metric, centre = described[0][:rigid, :rigid] * ratio, described[1][:rigid]
            self._prior[0][:rigid, :rigid] = metric
            self._prior[1][:rigid] = metric @ centre

    def moments_of(self, j, part):
        """Moments of the design of a joint in each part of the rows (n_parts, k, k)."""
        rows = self._designs[j]
        weighted = rows * self.view.equations.weight[:, [j]]
        parts = (part == p for p in range(part.max() + 1))
        return np.array([weighted[own].T @ rows[own] for own in parts])

    def solve(self, chosen, precision=None):
        """Fit to some parts with the description as prior: matrix and solution (p,)."""
        precision = self.view.precision if precision is None else precision
        G, g = (values.copy() for values in self._prior)
        for j in np.flatnonzero(self.used):
            own, n = self.columns[j], self.columns[j].size
            moments = precision[j] * self.moments[j][chosen].sum(axis=0)
            G[np.ix_(own, own)] += moments[:n, :n]
            g[own] += moments[:n, -1]
        eigen = scaled_eigen(G, _KNOWN)
        return eigen, eigen.solve(g)

    def squares(self, chosen, fitted):
        """Weighted squared errors of some parts by a fit to others, by joint, (nv,)."""
        found, (_, theta) = [], self.solve(fitted)
        for own, moments in zip(self.columns, self.moments):
            left = np.r_[-theta[own], 0.0, 0.0, 0.0, 1.0]
            found.append(left @ moments[chosen].sum(axis=0) @ left)
        return np.maximum(found, 0.0)

    def left_out(self, spread):
        """Errors (r, nv) on each recording of fits to the others, over the spread."""
        # Recordings of one motion are left out together.
        repetition = self.view.repetition
        motion = repetition.motion if repetition else np.arange(self.count)
        names = np.unique(motion)
        if names.size < 2:
            return np.empty((0, spread.size))
        out = np.full((names.size, spread.size), np.nan)
        for row, name in zip(out, names):
            own = np.isin(self.recording, np.flatnonzero(motion == name))
            squares = self.squares(own, ~own)
            weight = self.weights[own].sum(axis=0)
            used = (weight > 0) & self.used
            row[used] = np.sqrt(squares[used] / weight[used]) / spread[used]
        return out

    @functools.cached_property
    def _errors(self):
        """Squares of errors on the parts of each recording, (r, nv) twice."""
        # Of fits to the rest of the recording, and to the rest of all.
        squares = np.zeros((2, self.count, self.nv))
        for r in range(self.count):
            here = self.recording == r
            for p in np.flatnonzero(here) if here.sum() >= _PARTS else ():
                out = np.arange(here.size) == p
                squares[0, r] += self.squares(out, here & ~out)
                squares[1, r] += self.squares(out, ~out)
        return squares

    def alone(self, spread):
        """Errors (nv,) on parts of recordings of fits to their rest, nan for none."""
        whole = self._errors[0].any(axis=1)
        rows = self.weights[whole[self.recording]].sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(self._errors[0].sum(axis=0) / rows) / spread

    def suffering(self, spread):
        """Joints of recordings that a fit to these alone predicts better, a dict."""
        found = {}
        for r, (alone, together) in enumerate(zip(*self._errors)):
            rows = self.weights[self.recording == r].sum(axis=0) * self.used
            better = (rows > 0) & (together > 0) & (alone <= _MOST * together)
            for j in np.flatnonzero(better).tolist():
                pair = np.sqrt([alone[j], together[j]]) / np.sqrt(rows[j])
                found[r, j] = tuple((pair / spread[j]).tolist())
        return found


# -- contradictions --------------------------------------------------------------------


def contradictions(parts, spread, alpha):
    """Return the `Contradiction`s of `Parts` or None, the clearest first."""
    suffering = {} if parts is None else parts.suffering(spread)
    if not suffering:
        return ()
    # Of two, the one that does not suffer may be the one that differs.
    suspects = range(parts.count)
    if parts.count > 2:
        suspects = sorted({r for r, _ in suffering})
    joints = sorted({j for _, j in suffering})
    deviations = _Deviations(parts)
    keys, chosen = list(itertools.product(suspects, joints)), []
    while len(chosen) < min(_MOST_FOUND, len(keys)):
        trials = {k: deviations.test(k, chosen) for k in keys if k not in chosen}
        key = max(trials, key=lambda key: trials[key][0])
        if not trials[key][1] < alpha:
            break
        chosen.append(key)
    found = []
    for key in chosen:
        others = [other for other in chosen if other != key]
        _, p_value, unit = deviations.test(key, others)
        cause, value = deviations.cause(key, others, unit)
        alone, together = suffering.get(key, (np.nan, np.nan))
        found.append(
            Contradiction(
                recording=key[0],
                joint=key[1],
                alone=alone,
                together=together,
                cause=cause,
                value=value,
                p_value=p_value,
            )
        )
    return tuple(found)


class _Deviations:
    """Deviations of recordings from one robot, on a joint each."""

    # tau_r = Phi theta + E_j u_rj + noise: deviations u_rj of a recording r in four
    # columns E_j of a joint, named by both. F = (explained by recordings) / (explained
    # by parts of single recordings) in the same columns, as in a nested analysis of
    # variance (H. Scheffe, "The Analysis of Variance", 1959, section 5.3).

    def __init__(self, parts):
        self._parts, count = parts, parts.count
        self._columns = functools.cache(self._columns_of)
        # Weights of the joints by fits to each recording alone: in a common fit the
        # differences would count as noise.
        each = (parts.recording == r for r in range(count))
        squares = sum(parts.squares(own, own) for own in each)
        known, total = parts.used & (squares > 0), parts.weights.sum(axis=0)
        self._noise = np.where(known, total / or_one(squares), 0.0)
        self._eigen, self._theta = parts.solve(slice(None), self._noise)
        # Moments in thirds of time, positions and speeds, with their recordings: the
        # parameters of a wrong model vary with position and speed.
        view, nv = parts.view, parts.nv
        states, weight = view.states[view.index], view.equations.weight
        self._partitions = [(parts.moments, parts.recording)]
        for values in (states[:, :nv], np.abs(states[:, nv : 2 * nv])):
            moments = [
                parts.moments_of(j, _thirds(parts.origin, values[:, j], weight[:, j]))
                for j in range(nv)
            ]
            of = np.repeat(np.arange(count), _PARTS)
            self._partitions.append((moments, of))

    def _columns_of(self, key):
        """Columns of what may differ on a joint of a recording, (k, 5)."""
        (r, j), parts = key, self._parts
        own, n = parts.columns[j], parts.columns[j].size
        columns = np.zeros((n + 3, _COLUMNS + 1))
        columns[n:, :3] = np.eye(3)
        columns[:n, 3] = parts.solve(parts.recording != r)[1][own]
        last = parts.features.n_parameters_ // parts.nv * (parts.nv - 1)
        columns[:n, 4] = columns[:n, 3] * ((own >= last) & (own < last + 10))
        return columns

    def _fitted(self, added):
        """Fit the columns of deviations, a dict; return the gain, theta and theirs."""
        edges = np.cumsum([0, *(A.shape[1] for A in added.values())])
        places = [slice(a, b) for a, b in itertools.pairwise(edges)]
        cross, h = np.zeros((self._theta.size, edges[-1])), np.zeros(edges[-1])
        H = np.zeros((edges[-1], edges[-1]))
        for ((r, j), A), at in zip(added.items(), places):
            parts = self._parts
            own, of = parts.columns[j], parts.recording == r
            moments = self._noise[j] * parts.moments[j][of].sum(axis=0)
            made = moments[:-1, :-1] @ A
            cross[own, at], h[at] = made[: own.size], A.T @ moments[:-1, -1]
            H[at, at] = A.T @ made
        left = self._eigen.solve(cross)
        H, h = H - cross.T @ left, h - cross.T @ self._theta
        coef = scaled_eigen(H, _KNOWN).solve(h)
        return float(coef @ h), self._theta - left @ coef, [coef[at] for at in places]

    def _within(self, j, A, added, coefs, theta):
        """Squares that columns of a joint explain of parts of single recordings."""
        # Per parameter, with their number, of the partition whose parts differ most.
        count, n = self._parts.count, self._parts.columns[j].size
        known = np.zeros((count, A.shape[0]))
        known[:, :n] = theta[self._parts.columns[j]]
        for ((r, k), B), coef in zip(added.items(), coefs):
            known[r] += B @ coef if k == j else 0.0
        found = []
        for moments, recording in self._partitions:
            M = self._noise[j] * moments[j]
            left = M[:, :-1, -1] - (M[:, :-1, :-1] @ known[recording, :, None])[..., 0]
            scores, grams = left @ A, A.T @ M[:, :-1, :-1] @ A
            total = np.zeros(2)
            for own in (recording == r for r in range(count)):
                total += sum(map(_gain, scores[own], grams[own]))
                total -= _gain(scores[own].sum(axis=0), grams[own].sum(axis=0))
            size = total[0] / total[1] if total[1] > 0 else np.inf
            found.append((size, total[1] if total[1] > 0 else 1))
        return max(found)

    def test(self, key, others):
        """F statistic of a deviation next to others, its p-value and unit."""
        added = {one: self._columns(one)[:, :_COLUMNS] for one in (*others, key)}
        gain, theta, coefs = self._fitted(added)
        A = added.pop(key)
        size, freedom = self._within(key[1], A, added | {key: A}, coefs, theta)
        # A recording may differ by what its thirds differ by: it is no mean over them.
        unit = 1.0 + _PARTS * (max(size, 1.0) - 1.0)
        F = (gain - self._fitted(added)[0]) / unit / _COLUMNS
        count = self._parts.count * self._parts.nv
        return F, min(float(stats.f.sf(F, _COLUMNS, freedom)) * count, 1.0), unit

    def cause(self, key, others, unit):
        """Name what differs, and its value: the simplest that explains nearly all."""
        scores, A = {}, self._columns(key)
        known = {one: self._columns(one)[:, :_COLUMNS] for one in others}
        for name, own in {**_CAUSES, "model": range(_COLUMNS)}.items():
            gain, _, coefs = self._fitted(known | {key: A[:, list(own)]})
            score = 0.5 * (gain / unit - len(own) * np.log(self._parts.n_blocks))
            scores[name] = score - _NATS * (name == "model"), float(coefs[-1][0])
        name = max(scores, key=lambda name: scores[name][0])
        value = scores[name][1] + (name in ("gain", "payload"))
        return name, np.nan if name in ("friction", "model") else value


def _gain(h, H):
    """Squares that columns explain, and how many of these are determined."""
    eigen = scaled_eigen(H, _KNOWN)
    return np.array([float(h @ eigen.solve(h)), eigen.rank])


def _thirds(recording, values, weight):
    """Divide rows of recordings (m,) into thirds by the size of a signal."""
    part = np.zeros(values.size, dtype=int)
    for number in range(recording.max() + 1):
        own = np.flatnonzero(recording == number)
        order = own[np.argsort(values[own], kind="stable")]
        done = np.cumsum(weight[order])
        share = done / or_one(done[-1])
        third = np.minimum((_PARTS * share).astype(int), _PARTS - 1)
        part[order] = _PARTS * number + third
    return part
