"""Recordings against each other: fits without some of them, and contradictions."""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from scipy import stats

from sklearn_vbjfa._core._linear_systems import scaled_eigen
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

    # fit: `FinalFit`, the completed model on all recordings. The design of a joint has
    # the parameters that move it, an offset, viscous and Coulomb friction, and the
    # torque.

    @classmethod
    def of(cls, fit):
        """Divide a fit; None for a single recording, or if no channel counts."""
        several = np.unique(fit.view.origin).size > 1
        return cls(fit) if several and fit.view.precision.any() else None

    def __init__(self, fit):
        self._fit, self._view, self._Phi = fit, fit.view, fit.columns()
        self.nv, self.used = self._view.nv, self._view.precision > 0
        names, self._origin = np.unique(self._view.origin, return_inverse=True)
        self.count = names.size
        columns = (self._Phi != 0).any(axis=0)
        self._columns = [np.flatnonzero(own) for own in columns]
        # Thirds of the blocks of time, and not blocks in turns: slow noise would be
        # known from both neighbours.
        block = np.r_[0, np.cumsum(np.diff(self._view.spans.label) != 0)]
        self.n_blocks = int(block[-1]) + 1
        part = np.zeros(block.size, dtype=int)
        for r in range(self.count):
            own = self._origin == r
            place = np.unique(block[own], return_inverse=True)[1]
            part[own] = _PARTS * r + place * _PARTS // max(place[-1] + 1, _PARTS)
        _, first, part = np.unique(part, return_index=True, return_inverse=True)
        self.recording = self._origin[first]
        self._moments = [self._moments_of(j, part) for j in range(self.nv)]
        weights = self._view.equations.weight.T
        self._weights = np.array([np.bincount(part, w, first.size) for w in weights]).T
        self._prior = self._prior_of(fit.identifier)

    def _moments_of(self, j, part):
        """Moments of the design of a joint in each part of the rows (n_parts, k, k)."""
        equations = self._view.equations
        terms = [self._fit.in_equations(e(joint=j)) for e in (Offset, Viscous, Coulomb)]
        terms = [*(term[:, j, 0] for term in terms), equations.tau[:, j]]
        rows = np.column_stack([self._Phi[:, j, self._columns[j]], *terms])
        weighted = rows * equations.weight[:, [j]]
        parts = (part == p for p in range(part.max() + 1))
        return np.array([weighted[own].T @ rows[own] for own in parts])

    def _prior_of(self, identifier):
        """Return the description of the bodies, as moments (p, p), (p,)."""
        p, rigid = self._Phi.shape[2], identifier.features_.n_parameters_
        G, g = np.zeros((p, p)), np.zeros(p)
        described = identifier.described()
        if described is not None:
            own = identifier.robot_.joint_weights[self.used]
            metric, centre = described
            ratio = np.mean(self._view.precision[self.used] / own)
            metric = metric[:rigid, :rigid] * ratio
            G[:rigid, :rigid], g[:rigid] = metric, metric @ centre[:rigid]
        return G, g

    # -- fits and their errors ---------------------------------------------------------

    def _system(self, chosen, precision):
        """Return the normal equations of some parts, (p, p) and (p,)."""
        G, g = (values.copy() for values in self._prior)
        for j in np.flatnonzero(self.used):
            own, n = self._columns[j], self._columns[j].size
            moments = precision[j] * self._moments[j][chosen].sum(axis=0)
            G[np.ix_(own, own)] += moments[:n, :n]
            g[own] += moments[:n, -1]
        return G, g

    def solve(self, chosen):
        """Fit to some parts with the description as prior, (p,)."""
        G, g = self._system(chosen, self._view.precision)
        return scaled_eigen(G, _KNOWN).solve(g)

    def _squares(self, chosen, theta):
        """Weighted squared errors of some parts by joint, (nv,)."""
        found = []
        for own, moments in zip(self._columns, self._moments):
            left = np.zeros(own.size + 4)
            left[: own.size], left[-1] = -theta[own], 1.0
            found.append(left @ moments[chosen].sum(axis=0) @ left)
        return np.maximum(found, 0.0)

    def left_out(self, spread):
        """Errors (r, nv) on each recording of fits to the others, over the spread."""
        # Recordings of one motion are left out together.
        repetition = self._view.repetition
        motion = repetition.motion if repetition else np.arange(self.count)
        names = np.unique(motion)
        if names.size < 2:
            return np.empty((0, spread.size))
        out = np.full((names.size, spread.size), np.nan)
        for row, name in zip(out, names):
            own = np.isin(self.recording, np.flatnonzero(motion == name))
            squares = self._squares(own, self.solve(~own))
            weight = self._weights[own].sum(axis=0)
            used = (weight > 0) & self.used
            row[used] = np.sqrt(squares[used] / weight[used]) / spread[used]
        return out

    def suffering(self, spread):
        """Joints of recordings that a fit to these alone predicts much better.

        A dict of recording and joint to the errors of the fits to the rest of the
        recording and to the rest of all, on its parts, each left out in turn.
        """
        found = {}
        for r in range(self.count):
            here = self.recording == r
            if here.sum() < _PARTS:
                continue
            alone, together = np.zeros((2, self.nv))
            for p in np.flatnonzero(here):
                out = np.arange(len(here)) == p
                alone += self._squares(out, self.solve(here & ~out))
                together += self._squares(out, self.solve(~out))
            rows = self._weights[here].sum(axis=0) * self.used
            for j in np.flatnonzero((rows > 0) & (alone <= _MOST * together)).tolist():
                pair = np.sqrt([alone[j], together[j]]) / np.sqrt(rows[j])
                found[r, j] = tuple((pair / spread[j]).tolist())
        return found

    # -- deviations of recordings ------------------------------------------------------
    #
    # tau_r = Phi theta + E_j u_rj + noise: deviations u_rj of a recording r in four
    # columns E_j of a joint. They are compared with those of parts of single
    # recordings in the same columns, as in a nested analysis of variance (H. Scheffe,
    # "The Analysis of Variance", 1959, section 5.3): F = (explained by recordings) /
    # (explained by parts).

    @functools.cached_property
    def noise(self):
        """Weights of the joints by fits to each recording alone, (nv,)."""
        # In a common fit the differences would count as noise.
        squares = np.zeros(self.nv)
        for r in range(self.count):
            own = self.recording == r
            squares += self._squares(own, self.solve(own))
        known = self.used & (squares > 0)
        total, squares = self._weights.sum(axis=0), np.where(known, squares, 1.0)
        return np.where(known, total / squares, 0.0)

    @functools.cached_property
    def _whole(self):
        """Decomposition of the normal equations of all parts, and the solution."""
        G, g = self._system(np.ones(len(self.recording), dtype=bool), self.noise)
        eigen = scaled_eigen(G, _KNOWN)
        return eigen, eigen.solve(g)

    @functools.cached_property
    def _partitions(self):
        """Moments in thirds of time, positions and speeds, with their recordings."""
        # The parameters of a wrong model vary with position and speed.
        states, weight = (
            self._view.states[self._view.index],
            self._view.equations.weight,
        )
        found = [(self._moments, self.recording)]
        for values in (states[:, : self.nv], np.abs(states[:, self.nv : 2 * self.nv])):
            moments = [
                self._moments_of(j, _thirds(self._origin, values[:, j], weight[:, j]))
                for j in range(self.nv)
            ]
            found.append((moments, np.repeat(np.arange(self.count), _PARTS)))
        return found

    def columns_of(self, r, j):
        """Columns of what may differ on a joint of a recording, (k, 5)."""
        n = self._columns[j].size
        columns = np.zeros((n + 3, _COLUMNS + 1))
        columns[n:, :3] = np.eye(3)
        theta = self.solve(self.recording != r)
        columns[:n, 3] = theta[self._columns[j]]
        features = self._fit.identifier.features_
        last = features.n_parameters_ // self.nv * (self.nv - 1)
        of_last = np.isin(self._columns[j], np.arange(last, last + 10))
        columns[:n, 4] = columns[:n, 3] * of_last
        return columns

    def fitted(self, added):
        """Fit added columns; return the gain, theta and their coefficients."""
        # added: recording and joint -> columns
        eigen, theta = self._whole
        if not added:
            return 0.0, theta, []
        edges = np.cumsum([0, *(A.shape[1] for A in added.values())])
        cross, h = np.zeros((theta.size, edges[-1])), np.zeros(edges[-1])
        H = np.zeros((edges[-1], edges[-1]))
        places = [slice(a, b) for a, b in itertools.pairwise(edges)]
        for ((r, j), A), at in zip(added.items(), places):
            moments = self.noise[j] * self._moments[j][self.recording == r].sum(axis=0)
            made = moments[:-1, :-1] @ A
            cross[self._columns[j], at] = made[: self._columns[j].size]
            h[at] = A.T @ moments[:-1, -1]
            for ((s, k), B), to in zip(added.items(), places):
                if (s, k) == (r, j):
                    H[to, at] = B.T @ made
        left = eigen.solve(cross)
        H, h = H - cross.T @ left, h - cross.T @ theta
        coef = scaled_eigen(H, _KNOWN).solve(h)
        return float(coef @ h), theta - left @ coef, [coef[at] for at in places]

    def within(self, j, A, added, coefs, theta):
        """Squares that columns of a joint explain of parts of single recordings."""
        # Per parameter, with their number, of the partition whose parts differ most.
        known = np.zeros((self.count, A.shape[0]))
        known[:, : self._columns[j].size] = theta[self._columns[j]]
        for ((r, k), B), coef in zip(added.items(), coefs):
            known[r] += B @ coef if k == j else 0.0
        found = []
        for moments, recording in self._partitions:
            M = self.noise[j] * moments[j]
            left = M[:, :-1, -1] - (M[:, :-1, :-1] @ known[recording, :, None])[..., 0]
            scores, grams = left @ A, A.T @ M[:, :-1, :-1] @ A
            total = np.zeros(2)
            for r in range(self.count):
                own = recording == r
                total += sum(_gain(*pair) for pair in zip(scores[own], grams[own]))
                total -= _gain(scores[own].sum(axis=0), grams[own].sum(axis=0))
            found.append(
                (total[0] / total[1], total[1]) if total[1] > 0 else (np.inf, 1)
            )
        return max(found)


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
        share = done / done[-1] if done[-1] > 0 else np.linspace(0, 1, own.size)
        third = np.minimum((_PARTS * share).astype(int), _PARTS - 1)
        part[order] = _PARTS * number + third
    return part


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
    columns = {(r, j): parts.columns_of(r, j) for r in suspects for j in joints}
    candidates = {key: A[:, :_COLUMNS] for key, A in columns.items()}
    chosen = {}
    while candidates and len(chosen) < _MOST_FOUND:
        trials = {key: _tested(parts, chosen, key, A) for key, A in candidates.items()}
        key = max(trials, key=lambda key: trials[key][0])
        if not trials[key][1] < alpha:
            break
        chosen[key] = candidates.pop(key)
    found = []
    for key, A in chosen.items():
        others = {other: own for other, own in chosen.items() if other != key}
        _, p_value, unit = _tested(parts, others, key, A)
        cause, value = _cause(parts, others, key, columns[key], unit)
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


def _tested(parts, others, key, A):
    """F statistic of the columns of a joint of a recording, its p-value and unit."""
    gain, theta, coefs = parts.fitted(others | {key: A})
    size, freedom = parts.within(key[1], A, others | {key: A}, coefs, theta)
    # A recording may differ by what its thirds differ by: it is no mean over them.
    unit = 1.0 + _PARTS * (max(size, 1.0) - 1.0)
    F = (gain - parts.fitted(others)[0]) / unit / _COLUMNS
    p_value = float(stats.f.sf(F, _COLUMNS, freedom)) * parts.count * parts.nv
    return F, min(p_value, 1.0), unit


def _cause(parts, others, key, A, unit):
    """Name what differs, and its value: the simplest that explains nearly as much."""
    scores = {}
    for name, own in {**_CAUSES, "model": range(_COLUMNS)}.items():
        gain, _, coefs = parts.fitted(others | {key: A[:, list(own)]})
        score = 0.5 * (gain / unit - len(own) * np.log(parts.n_blocks))
        scores[name] = score - _NATS * (name == "model"), float(coefs[-1][0])
    name = max(scores, key=lambda name: scores[name][0])
    value = scores[name][1] + (name in ("gain", "payload"))
    return name, np.nan if name in ("friction", "model") else value
