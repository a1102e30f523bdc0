"""Recordings that contradict each other: no one robot has the torques of both.

What is wrong with one of several recordings (another payload, friction, or gain of a
torque) is spread over all by a common fit. A fit to that recording alone then predicts
its other blocks better than the common one, which has seen more; where all recordings
are of one robot it cannot, except by chance.
"""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.diagnosis.explain._evidence import p_value
from sklearn_vbjfa.effects import Coulomb, Offset, Payload, Viscous

# Parts into which a recording is divided, each predicted without it, and the fewest.
_PARTS, _FEWEST_PARTS = 8, 4
# Share of the squared error that has to come from the other recordings: most of it.
_MOST = 0.5
# Recordings by which a culprit and a cause are judged: those that suffer most.
_JUDGED = 3
# What explains nearly as much as the best of the causes, and is simpler, is taken.
_AS_GOOD = 0.9
# Directions that the data tell less about than this share are left alone.
_KNOWN = 1e-9


@dataclass(frozen=True, kw_only=True)
class Cause:
    """What may be another in one of the recordings.

    Attributes
    ----------
    recording : int
        That recording, from zero.
    name : {"offset", "gain", "friction", "payload"}
        Of a torque, of friction, or of the last body.
    joints : tuple of int
        Joints, from zero.
    value : float
        Of one offset: how much larger it is [N m or N]; of one gain: how many times as
        large the torque is; nan otherwise.
    """

    recording: int
    name: str
    joints: tuple
    value: float = np.nan


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A recording whose torques on a joint are not those of the robot of the others.

    Attributes
    ----------
    recording : int
        Recording, from zero.
    joint : int
        Joint, from zero.
    alone, together : float
        Error on parts of the recording that were not fitted, over the spread of the
        torque: by a fit to the rest of this recording, and by one to the rest of all.
    p_value : float
        How likely blocks of time would favour the fit to it alone so much by chance.
    """

    recording: int
    joint: int
    alone: float
    together: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class Contradictions:
    """What contradicts what, and why.

    Attributes
    ----------
    found : tuple of Contradiction
        Recordings and joints.
    culprit : int or None
        Recording, from zero, without which the others contradict each other no more;
        None if there is no such one, or only two.
    cause : Cause or None
        What accounts for most of the difference, on all joints together, if it is
        another in one recording; None if nothing that was tried does.
    """

    found: tuple = ()
    culprit: int | None = None
    cause: Cause | None = None


def contradictions(parts, spread, alpha):
    """Compare the recordings of a fit with each other, as `Contradictions`.

    Parameters
    ----------
    parts : Parts or None
        Of the completed model on all recordings; None for a single one.
    spread : ndarray of shape (nv,)
        Spread of the torque [N m or N].
    alpha : float
        Significance level over all recordings and joints.
    """
    if parts is None:
        return Contradictions()
    fit = parts.fit
    checked = [k for k in parts.recordings if parts.count(k) >= _FEWEST_PARTS]
    level = alpha / max(len(checked) * fit.view.nv, 1)
    found, victims = [], []
    for recording in checked:
        alone = parts.squares(recording, others=False)
        together = parts.squares(recording, others=True)
        own = _compared(parts, recording, alone, together, spread, level)
        if own:
            found += own
            weight = np.zeros(fit.view.nv)
            joints = [one.joint for one in own]
            weight[joints] = parts.precision[joints]
            victims.append(
                _Victim(
                    recording=recording,
                    weight=weight,
                    together=together.sum(axis=0) @ weight,
                    saved=(together - alone).sum(axis=0) @ weight,
                )
            )
    if not found:
        return Contradictions()
    victims = sorted(victims, key=lambda one: -one.saved)[:_JUDGED]
    culprit = _culprit(parts, victims)
    suspects = [one.recording for one in victims] if culprit is None else [culprit]
    if parts.recordings.size == 2:
        suspects = parts.recordings
    joints = sorted({one.joint for one in found})
    cause = _cause(parts, suspects, joints, victims)
    return Contradictions(found=tuple(found), culprit=culprit, cause=cause)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Victim:
    """A recording that the others are fitted at the expense of.

    Attributes
    ----------
    recording : int
        Recording.
    weight : ndarray of shape (nv,)
        Weights of the joints that suffer, zero elsewhere.
    together, saved : float
        Weighted squared error if all are fitted, and what a fit to this one alone takes
        off it.
    """

    recording: int
    weight: np.ndarray
    together: float
    saved: float


def _compared(parts, recording, alone, together, spread, level):
    """Return the contradictions of one recording with the others, a list."""
    rows = parts.weight(recording)
    found = []
    for joint in np.flatnonzero(parts.precision > 0):
        one, both = alone[:, joint], together[:, joint]
        used = rows[:, joint] > 0
        if not used.any() or one.sum() > _MOST * both.sum():
            continue
        chance = p_value(both[used], one[used])
        if chance < level:
            size = spread[joint] * np.sqrt(rows[:, joint].sum())
            found.append(
                Contradiction(
                    recording=int(recording),
                    joint=int(joint),
                    alone=float(np.sqrt(one.sum()) / size),
                    together=float(np.sqrt(both.sum()) / size),
                    p_value=chance,
                )
            )
    return found


def _culprit(parts, victims):
    """Return the recording without which the others suffer no more, or None."""
    if parts.recordings.size == 2:
        return None
    left = {}
    for suspect in parts.recordings:
        others = [one for one in victims if one.recording != suspect]
        # If nobody else suffers, it is the one.
        gone, whole = 0.0, sum(one.saved for one in others)
        for one in others:
            squares = parts.squares(one.recording, others=True, without=suspect)
            gone += one.together - squares.sum(axis=0) @ one.weight
        left[int(suspect)] = 1.0 - gone / whole if others else 0.0
    best = min(left, key=left.get)
    return best if left[best] < 1.0 - _MOST else None


def _cause(parts, suspects, joints, victims):
    """Return what accounts for most of the difference, the simplest, or None."""
    # It is looked for in the suspected recordings and on some of the joints.
    judged = [one.recording for one in victims]
    whole = sum(one.saved for one in victims)
    tried = []
    for suspect in suspects:
        for cause, extra in _candidates(parts, suspect, joints):
            squares, coef = parts.squares_beside(suspect, extra, judged)
            gone = sum(
                one.together - squares[one.recording] @ one.weight for one in victims
            )
            if coef.size == 1:
                value = float(coef[0]) + (cause.name == "gain")
                cause = replace(cause, value=value)
            tried.append((gone / whole, extra.shape[2], cause))
    best = max(share for share, _, _ in tried)
    if best < _MOST:
        return None
    good = [one for one in tried if one[0] >= _AS_GOOD * best]
    return min(good, key=lambda one: (one[1], -one[0]))[2]


def _candidates(parts, recording, joints):
    """Yield causes and their columns (m, nv, k), which count in one recording only."""
    fit = parts.fit
    view, nv = fit.view, fit.view.nv
    offset, viscous, coulomb = (
        [fit.in_equations(clone(e).set_params(joint=j)) for j in range(nv)]
        for e in (Offset(), Viscous(), Coulomb())
    )
    modelled = parts.torques(parts.without(recording))
    gain = [(modelled * (np.arange(nv) == j))[:, :, None] for j in range(nv)]
    friction = [np.concatenate(pair, axis=2) for pair in zip(viscous, coulomb)]

    def cause(name, *where):
        return Cause(recording=int(recording), name=name, joints=where)

    kinds = ((Offset.name, offset), ("gain", gain), ("friction", friction))
    for name, columns in kinds:
        for j in joints:
            yield cause(name, j), columns[j]
    if nv > 1:
        for name, columns in kinds[1:]:
            yield cause(name, *range(nv)), np.concatenate(columns, axis=2)
    features = view.robot.features_
    last = features.n_parameters_ - features.n_parameters_ // nv
    yield cause(Payload.name, nv - 1), view.equations.Phi[:, :, last : last + 10]


class Parts:
    """Equations by recordings and parts of them, and fits to all but some of them.

    Parameters
    ----------
    fit : FinalFit
        Completed model on all recordings.

    Attributes
    ----------
    fit : FinalFit
        As given.
    recordings : ndarray of int
        Recordings.
    precision : ndarray of shape (nv,)
        Weights of the joints.
    """

    @classmethod
    def of(cls, fit):
        """Take a fit apart; None for a single recording."""
        return cls(fit) if np.unique(fit.view.origin).size > 1 else None

    def __init__(self, fit):
        view = fit.view
        self.fit, self.precision = fit, view.precision
        label = view.spans.label
        starts = np.r_[0, np.flatnonzero(np.diff(label)) + 1]
        self._edges = np.r_[starts, label.size]
        # Recording of each block, and which part of it the block is in.
        self._origin = view.origin[starts]
        self.recordings = np.unique(self._origin)
        self._part = np.empty(starts.size, dtype=int)
        for recording in self.recordings:
            own = np.flatnonzero(self._origin == recording)
            # Not in turns: slow noise would be known from both neighbours.
            count = min(_PARTS, own.size)
            self._part[own] = np.arange(own.size) * count // own.size
        self._weights = view.spans.sums(view.equations.weight)
        self._moments = [self._moments_of(b) for b in range(starts.size)]
        self._prior = self._prior_of(fit.identifier)

    def _prior_of(self, identifier):
        """Return what the description says of the bodies, as moments (p, p), (p,)."""
        p, rigid = self._moments[0][1].size, identifier.features_.n_parameters_
        G, g = np.zeros((p, p)), np.zeros(p)
        if identifier._prior is not None:
            heard = self.precision > 0
            own = identifier.estimator_.joint_weights_[heard]
            metric, centre = identifier._prior
            metric = metric[:rigid, :rigid] * np.mean(self.precision[heard] / own)
            G[:rigid, :rigid], g[:rigid] = metric, metric @ centre[:rigid]
        return G, g

    def _rows(self, block):
        """Rows of a block."""
        return slice(self._edges[block], self._edges[block + 1])

    def _moments_of(self, block, extra=None):
        """Second moments (p, p) and (p,) of a block, perhaps with extra columns."""
        G, g = 0.0, 0.0
        rows = self._rows(block)
        Phi = self._design(rows, extra)
        weight = self.fit.view.equations.weight[rows] * self.precision
        for j in range(Phi.shape[1]):
            own = Phi[:, j] * weight[:, j, None]
            G = G + own.T @ Phi[:, j]
            g = g + own.T @ self.fit.view.equations.tau[rows, j]
        return G, g

    def _design(self, rows, extra=None):
        """Columns (n, nv, p) of the completed model, perhaps with extra ones."""
        Phi = self.fit.columns(rows)
        return Phi if extra is None else np.concatenate([Phi, extra[rows]], axis=2)

    def count(self, recording):
        """Count the parts of a recording."""
        return np.unique(self._part[self._origin == recording]).size

    def weight(self, recording):
        """Weight of the rows of each block of a recording, (n_blocks, nv)."""
        return self._weights[self._origin == recording]

    def _solve(self, blocks, moments=None):
        """Fit to some blocks, beside the description, (p,)."""
        moments = self._moments if moments is None else moments
        G = sum(moments[b][0] for b in blocks)
        g = sum(moments[b][1] for b in blocks)
        known, pulled = self._prior
        p = pulled.size
        G[:p, :p] += known
        g[:p] += pulled
        return scaled_eigen(G, _KNOWN).solve(g)

    def without(self, recording):
        """Fit to all recordings but one, (p,)."""
        return self._solve(np.flatnonzero(self._origin != recording))

    def left_out(self, spread):
        """Errors (r, nv) on each recording of fits to the others, over the spread.

        Recordings of one motion are left out together: none of them is another one.
        """
        repetition = self.fit.view.repetition
        motion = repetition.motion if repetition else np.arange(self.recordings.size)
        names = np.unique(motion)
        if names.size < 2:
            return np.empty((0, spread.size))
        out = np.full((names.size, spread.size), np.nan)
        for row, name in zip(out, names):
            own = np.isin(self._origin, self.recordings[motion == name])
            theta = self._solve(np.flatnonzero(~own))
            weight = self._weights[own].sum(axis=0)
            squares = sum(self._error(b, theta) for b in np.flatnonzero(own))
            used = (weight > 0) & (self.precision > 0)
            row[used] = np.sqrt(squares[used] / weight[used]) / spread[used]
        return out

    def torques(self, theta):
        """Torques (m, nv) of the model with some parameters."""
        blocks = range(self._origin.size)
        return np.concatenate([self._design(self._rows(b)) @ theta for b in blocks])

    def _folds(self, recording):
        """Yield the blocks of each part of a recording."""
        own = np.flatnonzero(self._origin == recording)
        for part in np.unique(self._part[own]):
            yield own[self._part[own] == part]

    def squares(self, recording, *, others, without=None):
        """Squared errors (n_blocks, nv) on each part of a recording, fitted without it.

        others : whether the other recordings are fitted as well, except for the one
        `without`.
        """
        own = np.flatnonzero(self._origin == recording)
        pool = np.flatnonzero(self._origin != without) if others else own
        out = {}
        for left_out in self._folds(recording):
            theta = self._solve(np.setdiff1d(pool, left_out))
            out.update({b: self._error(b, theta) for b in left_out})
        return np.array([out[b] for b in own])

    def squares_beside(self, recording, extra, judged):
        """Squared errors (nv,) on recordings with extra columns in one of them.

        A dict of the judged recordings; the others are fitted as well. And the
        coefficients (k,) of the columns (m, nv, k) in a fit to all.
        """
        k = extra.shape[2]
        moments = [(np.pad(G, (0, k)), np.pad(g, (0, k))) for G, g in self._moments]
        for b in np.flatnonzero(self._origin == recording):
            moments[b] = self._moments_of(b, extra)
        pool, out = np.arange(self._origin.size), {}
        for one in judged:
            out[one] = 0.0
            for left_out in self._folds(one):
                theta = self._solve(np.setdiff1d(pool, left_out), moments)
                own = (theta, extra) if one == recording else (theta[:-k],)
                out[one] = out[one] + sum(self._error(b, *own) for b in left_out)
        return out, self._solve(pool, moments)[-k:]

    def _error(self, block, theta, extra=None):
        """Weighted squared errors of a block, (nv,)."""
        rows, equations = self._rows(block), self.fit.view.equations
        residual = equations.tau[rows] - self._design(rows, extra) @ theta
        return (equations.weight[rows] * residual**2).sum(axis=0)
