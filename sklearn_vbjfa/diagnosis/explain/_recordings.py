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
# What may differ on joints, with its columns: offset, viscous and Coulomb friction, and
# the torque of the robot of the other recordings.
_CAUSES = {"offset": [0], "gain": [3], "friction": [1, 2], "model": [0, 1, 2, 3]}
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
    # of an offset: how much larger it is [N m or N]; of a gain: how many times as large
    # the torque is; of a payload: its mass [kg]; else nan
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

    @functools.cached_property
    def own_squares(self):
        """Squares of errors of fits to each recording alone, (r, nv)."""
        each = [self.recording == r for r in range(self.count)]
        return np.array([self.squares(own, own) for own in each])

    @functools.cached_property
    def partitions(self):
        """Moments in thirds of time, positions and speeds, with their recordings."""
        # The parameters of a wrong model vary with position and speed.
        nv, states = self.nv, self.view.states[self.view.index]
        weight, found = self.view.equations.weight, [(self.moments, self.recording)]
        for values in (states[:, :nv], np.abs(states[:, nv : 2 * nv])):
            moments = [
                self.moments_of(j, _thirds(self.origin, values[:, j], weight[:, j]))
                for j in range(nv)
            ]
            found.append((moments, np.repeat(np.arange(self.count), _PARTS)))
        return found

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
                pair = np.sqrt(np.array([alone[j], together[j]]) / rows[j]) / spread[j]
                found[r, j] = dict(zip(("alone", "together"), pair.tolist()))
        return found


# -- contradictions --------------------------------------------------------------------


def contradictions(parts, spread, alpha):
    """Return the `Contradiction`s of `Parts` or None, by recordings."""
    suffering = {} if parts is None else parts.suffering(spread)
    if not suffering:
        return ()
    # Of two, the one that does not suffer may be the one that differs.
    suspects = range(parts.count)
    if parts.count > 2:
        suspects = sorted({r for r, _ in suffering})
    joints = sorted({j for _, j in suffering})
    left = list(range(parts.count))
    while suspects := [r for r in suspects if r in left]:
        # Others suffer from the one that differs until it is left out.
        trials = {r: _Deviations(parts, r, left) for r in suspects}
        tested = {(r, j): one.test(j) for r, one in trials.items() for j in joints}
        r, j = max(tested, key=lambda key: tested[key][0])
        if not tested[r, j][1] < alpha:
            break
        left.remove(r)
    apart = [r for r in range(parts.count) if r not in left]
    each = (_Deviations(parts, r, [*left, r]) for r in apart)
    return tuple(x for one in each for x in one.named(joints, alpha, suffering))


class _Deviations:
    """Deviations of a recording from one robot, by joints."""

    # tau = Phi theta + E_j u_j + noise: deviations u_j of the recording in four columns
    # E_j of a joint. F = (explained by the recording) / (explained by parts of single
    # recordings) in the same columns, as in a nested analysis of variance (H. Scheffe,
    # "The Analysis of Variance", 1959, section 5.3).

    def __init__(self, parts, recording, recordings):
        # recordings: that are fitted, with this one.
        self._parts, self._recording, self._recordings = parts, recording, recordings
        kept = np.isin(parts.recording, recordings)
        self._own = parts.recording == recording
        # Weights of the joints by fits to each recording alone: in a common fit the
        # differences would count as noise.
        squares = parts.own_squares[recordings].sum(axis=0)
        known, total = parts.used & (squares > 0), parts.weights[kept].sum(axis=0)
        self._noise = np.where(known, total / or_one(squares), 0.0)
        self._eigen, self._theta = parts.solve(kept, self._noise)
        others, self._columns = parts.solve(kept & ~self._own)[1], []
        for own in parts.columns:
            columns = np.eye(own.size + 3, _COLUMNS, -own.size)
            columns[: own.size, 3] = others[own]
            self._columns.append(columns)

    def _fitted(self, added, shared=False):
        """Fit columns by joints; return the gain, theta and the coefficients."""
        # shared: whether those of all joints are the same.
        edges = np.cumsum([0, *(A.shape[1] for A in added.values())])
        places = [slice(a, b) for a, b in itertools.pairwise(edges)]
        if shared:
            edges, places = edges[:2], places[:1] * len(places)
        cross, h = np.zeros((self._theta.size, edges[-1])), np.zeros(edges[-1])
        H = np.zeros((edges[-1], edges[-1]))
        for (j, A), at in zip(added.items(), places):
            own = self._parts.columns[j]
            moments = self._noise[j] * self._parts.moments[j][self._own].sum(axis=0)
            made = moments[:-1, :-1] @ A
            cross[own, at] += made[: own.size]
            h[at] += A.T @ moments[:-1, -1]
            H[at, at] += A.T @ made
        left = self._eigen.solve(cross)
        H, h = H - cross.T @ left, h - cross.T @ self._theta
        coef = scaled_eigen(H, _KNOWN).solve(h)
        coefs = {j: coef[at] for j, at in zip(added, places)}
        return float(coef @ h), self._theta - left @ coef, coefs

    def _within(self, j, coef, theta):
        """Squares that columns of a joint explain of parts of single recordings."""
        # Per parameter, with their number, of the partition whose parts differ most.
        A, n, found = self._columns[j], self._parts.columns[j].size, []
        known = np.zeros((self._parts.count, A.shape[0]))
        known[:, :n] = theta[self._parts.columns[j]]
        known[self._recording] += A @ coef
        for moments, recording in self._parts.partitions:
            M = self._noise[j] * moments[j]
            left = M[:, :-1, -1] - (M[:, :-1, :-1] @ known[recording, :, None])[..., 0]
            scores, grams = left @ A, A.T @ M[:, :-1, :-1] @ A
            total = np.zeros(2)
            for own in (recording == r for r in self._recordings):
                total += sum(map(_gain, scores[own], grams[own]))
                total -= _gain(scores[own].sum(axis=0), grams[own].sum(axis=0))
            size = total[0] / total[1] if total[1] > 0 else np.inf
            found.append((size, total[1] if total[1] > 0 else 1))
        return max(found)

    def test(self, j, joints=()):
        """F statistic of the deviation on a joint, its p-value and unit."""
        # joints: others that may differ as well.
        added = {k: self._columns[k] for k in {*joints, j}}
        gain, theta, coefs = self._fitted(added)
        size, freedom = self._within(j, coefs[j], theta)
        del added[j]
        # A recording may differ by what its thirds differ by: it is no mean over them.
        unit = 1.0 + _PARTS * (max(size, 1.0) - 1.0)
        F = (gain - self._fitted(added)[0]) / unit / _COLUMNS
        count = self._parts.count * self._parts.nv
        return F, min(float(stats.f.sf(F, _COLUMNS, freedom)) * count, 1.0), unit

    def named(self, joints, alpha, suffering):
        """Yield the `Contradiction` of each joint that differs."""
        tested = {j: self.test(j, joints) for j in joints}
        tested = {j: one for j, one in tested.items() if one[1] < alpha}
        unit = max((unit for *_, unit in tested.values()), default=1.0)
        cause, values = self._cause(tested, unit)
        for j, (_, p_value, _) in tested.items():
            r, value = self._recording, values.get(j, np.nan)
            known = {"alone": np.nan, "together": np.nan, "p_value": p_value}
            known |= suffering.get((r, j), {})
            yield Contradiction(recording=r, joint=j, cause=cause, value=value, **known)

    def _cause(self, joints, unit):
        """Name the simplest difference that explains nearly all; values by joints."""
        parts, trials, model = self._parts, [], self._parts.features.model_
        for name, own in _CAUSES.items():
            trials.append((name, {j: self._columns[j][:, own] for j in joints}))
        # A load on the last body of a branch acts on several joints.
        for body in np.setdiff1d(np.arange(parts.nv), np.subtract(model.parents, 1)):
            own = parts.features.n_parameters_ // parts.nv * body + np.arange(10)
            load = [np.equal.outer(np.r_[x, [-1] * 3], own) for x in parts.columns]
            trials.append(("payload", dict(enumerate(map(np.float64, load)))))
        best, found = -np.inf, None
        for name, columns in trials:
            shared = name == "payload"
            gain, _, coefs = self._fitted(columns, shared)
            count = 10 if shared else sum(A.shape[1] for A in columns.values())
            score = 0.5 * (gain / unit - count * np.log(parts.n_blocks))
            if (score := score - _NATS * (name == "model")) <= best:
                continue
            # Of a load on an axis the mass has no torque.
            rest = {j: A[:, 1:] for j, A in columns.items()} if shared else {}
            unknown = shared and gain - self._fitted(rest, True)[0] < 2 * _NATS * unit
            if unknown or name in ("friction", "model"):
                coefs = {}
            values = {j: float(x[0]) + (name == "gain") for j, x in coefs.items()}
            best, found = score, (name, values)
        return found


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
