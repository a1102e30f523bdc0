"""Recordings that differ: what is another in one of them, or in each.

The model of all recordings has a deviation of each recording r in each group g of
columns E_g, tau_r = Phi theta + sum_g E_g u_rg + noise: an offset, the friction or the
gain of a joint, of all joints, the load of the last body, or everything. One of them
may be another in one recording alone (it contradicts the others), or in each with one
common scale (they scatter); scales are half-Cauchy and integrated, as those of effects.
"""

from dataclasses import dataclass

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._scaled_eigen import scaled_eigen
from sklearn_vbjfa.diagnosis.search._moments import Moments
from sklearn_vbjfa.diagnosis.search._problem import (
    Family,
    Fit,
    Member,
    declared_alone,
    rescaled,
    spectrum_of,
)
from sklearn_vbjfa.effects import Coulomb, Offset, Payload, Viscous

# Parts into which a recording is divided, each predicted without it, and the fewest.
_PARTS, _FEWEST_PARTS = 8, 4
# A recording suffers if most of its squared error comes from the other recordings.
_MOST = 0.5
# Directions that the data tell less about than this share are left alone.
_KNOWN = 1e-9
# What may scatter from one recording of a joint to the next, and from how many on.
_PLAIN = ("offset", "gain", "friction")
_SCATTER = 3


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """What is another in one of the recordings, or in each of them.

    Attributes
    ----------
    recordings : tuple of int
        Recordings that may be the one, from zero, the most probable first; all of them
        where each has its own.
    name : {"offset", "gain", "friction", "payload", "model"}
        Of a torque, of friction, of the last body, or everything.
    joints : tuple of int
        Joints, from zero.
    value : float
        Of one offset: how much larger it is [N m or N]; of one gain: how many times as
        large the torque is; where each has its own, their deviation; else nan.
    log_odds : float
        Logarithm of the posterior odds that it is another.
    scatters : bool
        Whether each recording has its own.
    rivals : tuple of str
        Names of what explains it within the rivals' nats, the best first.
    """

    recordings: tuple
    name: str
    joints: tuple
    value: float = np.nan
    log_odds: float = np.nan
    scatters: bool = False
    rivals: tuple = ()


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
    """

    recording: int
    joint: int
    alone: float
    together: float


@dataclass(frozen=True, kw_only=True)
class Contradictions:
    """What contradicts what, and why.

    Attributes
    ----------
    found : tuple of Contradiction
        Recordings and joints.
    culprit : int or None
        Recording, from zero, that alone is another; None if it is not known which, or
        if several are.
    deviations : tuple of Deviation
        What is another, the most probable first.
    """

    found: tuple = ()
    culprit: int | None = None
    deviations: tuple = ()


def contradictions(parts, spread, alpha, settings):
    """Compare the recordings of a fit with each other, as `Contradictions`.

    Parameters
    ----------
    parts : Parts or None
        Of the completed model on all recordings; None for a single one.
    spread : ndarray of shape (nv,)
        Spread of the torque [N m or N].
    alpha : float
        Share of robots whose recordings agree that get any.
    settings : SearchSettings
        Prior and rivals, as of effects.
    """
    suffering = [] if parts is None else _suffering(parts, spread)
    if not suffering:
        return Contradictions()
    joints = sorted({one.joint for one in suffering})
    # Of two, the one that does not suffer may be the one that is another.
    suspects = parts.recordings
    if suspects.size > 2:
        suspects = np.unique([one.recording for one in suffering])
    needed = float(np.log((1.0 - alpha) / alpha))
    deviations = _Deviations(parts.fit, settings).found(suspects, joints, needed)
    of_joints = {j for one in deviations for j in one.joints}
    found = tuple(one for one in suffering if one.joint in of_joints)
    if not found:
        return Contradictions()
    others = {r for one in deviations for r in one.recordings}
    culprit = others.pop() if len(others) == 1 else None
    return Contradictions(found=found, culprit=culprit, deviations=deviations)


def _suffering(parts, spread):
    """List joints of recordings that a fit to these alone predicts much better."""
    found = []
    for recording in parts.recordings:
        if parts.count(recording) < _FEWEST_PARTS:
            continue
        rows = parts.weight(recording).sum(axis=0)
        alone = parts.squares(recording, others=False).sum(axis=0)
        together = parts.squares(recording, others=True).sum(axis=0)
        for joint in np.flatnonzero((parts.precision > 0) & (rows > 0)):
            if alone[joint] <= _MOST * together[joint]:
                size = spread[joint] * np.sqrt(rows[joint])
                found.append(
                    Contradiction(
                        recording=int(recording),
                        joint=int(joint),
                        alone=float(np.sqrt(alone[joint]) / size),
                        together=float(np.sqrt(together[joint]) / size),
                    )
                )
    return found


@dataclass(frozen=True)
class _Group:
    """What may be another: in place of an effect in the search's regression."""

    name: str
    joints: tuple
    recordings: tuple
    whole_robot: bool = False
    in_model = slow = trend = False
    jumping = ()

    @property
    def joint(self):
        """First joint."""
        return self.joints[0]


class _Deviations:
    """Posterior of what is another in recordings, beside the completed model."""

    def __init__(self, fit, settings):
        self.fit, self.settings, view = fit, settings, fit.view
        base = declared_alone(view).base
        self.problem = base.problem
        members = [self._member(effect) for effect in fit.effects]
        start = rescaled(Fit(base, members), settings.scale)
        self.regression = spectrum_of(start, settings)
        self.recordings = np.unique(view.origin)

    def _member(self, effect):
        """Effect of the completed model as a member (nj, n, 1, k)."""
        columns = self.fit.view.columns([effect], self.fit.motion)
        made = Family.of(self.problem, (effect,), columns)
        return made.member(0, self.settings.scale)

    def found(self, suspects, joints, needed):
        """Deviations with enough odds, added one by one, a tuple of `Deviation`."""
        regression, out = self.regression, []
        offered = list(self._families(suspects, joints))
        nv, R = self.fit.view.nv, self.recordings.size
        # Each joint counts, whether it suffers or not.
        count = R * (3 * nv + 4) + 3 * nv * (R >= _SCATTER)
        prior = np.log(self.settings.expected / count)
        while offered:
            odds = [self._evidence(regression, own) + prior for own in offered]
            best = int(np.argmax(odds))
            if odds[best] < needed:
                break
            order = np.argsort(odds)[::-1]
            near = [
                offered[k].effects[0]
                for k in order
                if odds[k] > odds[best] - self.settings.rivals
            ]
            family = offered.pop(best)
            scale = regression.groups(family).best_scale(self.settings.scale)[0]
            regression = spectrum_of(
                regression.beside(_whole(family, float(scale))), self.settings
            )
            out.append((family, near, odds[best]))
        places = regression.places[len(regression.members) - len(out) :]
        return tuple(
            self._deviation(regression, place, *own) for place, own in zip(places, out)
        )

    def _evidence(self, regression, family):
        """Log Bayes factor of a group, tempered by its scatter in time."""
        groups = regression.groups(family)
        if not groups.shown().any():
            return -np.inf
        coef = groups.coefficients()[0]
        excess = regression.excess(family, 0, coef, regression.scores)
        return float(groups.tempered(excess).evidence(self.settings.scale)[0])

    def _deviation(self, regression, place, family, near, log_odds):
        """Collect a group that was found."""
        group = family.effects[0]
        alike = [o for o in near if (o.name, o.joints) == (group.name, group.joints)]
        recordings = group.recordings
        scatters = len(recordings) > 1
        if not scatters:
            recordings = tuple(dict.fromkeys(o.recordings[0] for o in alike))
        value = np.nan
        if scatters and group.name != "friction":
            member = regression.members[regression.places.index(place)]
            value = float(member.scale * member.unit[0])
        elif len(group.joints) == 1 and group.name in ("offset", "gain"):
            value = float(regression.coefficients(regression.places.index(place))[0])
            if group.name == "gain":
                value = 1.0 + value * self._share(regression, group)
        others = dict.fromkeys(o.name for o in near if o.name != group.name)
        return Deviation(
            recordings=recordings,
            name=group.name,
            joints=group.joints,
            value=value,
            log_odds=float(log_odds),
            scatters=scatters,
            rivals=tuple(others),
        )

    def _share(self, regression, group):
        """Torque of the completed model over that which the others share."""
        problem, j = self.problem, group.joint
        shared = problem.Z[j] @ regression.theta
        for place, member in zip(regression.places, regression.members):
            if isinstance(member.effect, _Group) or j not in member.joints:
                continue
            own = member.columns[member.joints.index(j), :, 0]
            shared = shared + own @ regression.coefficients(
                regression.places.index(place)
            )
        fitted = self._cosines([j], self._torque(j), self._rows(group.recordings))
        own = self._cosines([j], problem.cosines.rows(shared[None])[..., None, None])
        return float((fitted * own).sum() / (own**2 * (fitted != 0)).sum())

    # -- columns --------------------------------------------------------------------

    def _rows(self, recordings):
        """Rows of some recordings, (m,)."""
        return np.isin(self.fit.view.origin, recordings)

    def _cosines(self, joints, columns, rows=None):
        """Cosines of columns (nj, m, 1, k), of some rows."""
        if rows is not None:
            columns = columns * rows[:, None, None]
        return self.problem.cosines(columns, joints)

    def _torque(self, j):
        """Torque of the completed model on a joint as a column, (1, m, 1, 1)."""
        view = self.fit.view
        residual = self.fit.residuals_of(self.fit.identifier.theta_).residual
        torque = (view.equations.tau - residual)[:, j] * view.root[:, j]
        return torque[None, :, None, None]

    def _kinds(self, joints):
        """Yield (name, joints, columns (nj, m, 1, k)) of what may be another."""
        view, nv = self.fit.view, self.fit.view.nv

        def of(effect, j):
            effect = clone(effect).set_params(joint=int(j))
            return view.columns([effect], self.fit.motion)

        single = {name: {} for name in _PLAIN}
        heard = np.flatnonzero(self.problem.heard)
        for j in heard:
            single["offset"][j] = of(Offset(), j)
            single["gain"][j] = self._torque(j)
            both = [of(Viscous(), j), of(Coulomb(), j)]
            single["friction"][j] = np.concatenate(both, axis=3)
        for name, columns in single.items():
            for j in joints:
                yield name, (int(j),), columns[j]
        if heard.size > 1:
            for name in ("gain", "friction"):
                k = single[name][heard[0]].shape[3]
                wide = np.zeros((nv, view.index.size, 1, k * heard.size))
                for i, j in enumerate(heard):
                    wide[j, :, :, k * i : k * i + k] = single[name][j][0]
                yield name, tuple(heard.tolist()), wide
        features = view.robot.features_
        last = features.n_parameters_ - features.n_parameters_ // nv
        body = view.equations.Phi[:, :, last : last + 10] * view.root[:, :, None]
        yield Payload.name, tuple(range(nv)), body.transpose(1, 0, 2)[:, :, None]
        yield "model", tuple(range(nv)), view.Z[:, :, None]

    def _families(self, suspects, joints):
        """Yield each of them in each suspect, and the plain ones in all recordings."""
        for name, own, columns in self._kinds(joints):
            whole = len(own) > 1 or columns.shape[0] > 1
            at = tuple(range(self.fit.view.nv)) if whole else own
            group = _Group(name, own, (), whole_robot=whole)
            unit = Family.of(self.problem, (group,), columns).unit
            made = {}
            scatters = name in _PLAIN and self.recordings.size >= _SCATTER and not whole
            for r in self.recordings if scatters else suspects:
                made[r] = self._cosines(list(at), columns, self._rows(r))
            for r in suspects:
                group = _Group(name, own, (int(r),), whole)
                yield self._family(group, at, made[r], unit)
            if scatters:
                every = tuple(self.recordings.tolist())
                group = _Group(name, own, every, whole)
                unit = np.tile(unit, len(made))
                cosines = np.concatenate(list(made.values()), axis=3)
                yield self._family(group, at, cosines, unit)

    def _family(self, group, joints, cosines, unit):
        moments = Moments(joints, cosines, self.problem.edges)
        return Family(effects=(group,), moments=moments, unit=unit)


def _whole(family, scale):
    """Family of one group as a member of a fit."""
    return Member(
        effect=family.effects[0],
        moments=family.moments,
        unit=family.unit[0],
        scale=scale,
    )


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

    def _moments_of(self, block):
        """Second moments (p, p) and (p,) of a block."""
        G, g = 0.0, 0.0
        rows = self._rows(block)
        Phi = self.fit.columns(rows)
        weight = self.fit.view.equations.weight[rows] * self.precision
        for j in range(Phi.shape[1]):
            own = Phi[:, j] * weight[:, j, None]
            G = G + own.T @ Phi[:, j]
            g = g + own.T @ self.fit.view.equations.tau[rows, j]
        return G, g

    def count(self, recording):
        """Count the parts of a recording."""
        return np.unique(self._part[self._origin == recording]).size

    def weight(self, recording):
        """Weight of the rows of each block of a recording, (n_blocks, nv)."""
        return self._weights[self._origin == recording]

    def _solve(self, blocks):
        """Fit to some blocks, beside the description, (p,)."""
        known, pulled = self._prior
        G = known + sum(self._moments[b][0] for b in blocks)
        g = pulled + sum(self._moments[b][1] for b in blocks)
        return scaled_eigen(G, _KNOWN).solve(g)

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

    def _folds(self, recording):
        """Yield the blocks of each part of a recording."""
        own = np.flatnonzero(self._origin == recording)
        for part in np.unique(self._part[own]):
            yield own[self._part[own] == part]

    def squares(self, recording, *, others):
        """Squared errors (n_blocks, nv) on each part of a recording, fitted without it.

        others : whether the other recordings are fitted as well.
        """
        own = np.flatnonzero(self._origin == recording)
        pool = np.arange(self._origin.size) if others else own
        out = {}
        for left_out in self._folds(recording):
            theta = self._solve(np.setdiff1d(pool, left_out))
            out.update({b: self._error(b, theta) for b in left_out})
        return np.array([out[b] for b in own])

    def _error(self, block, theta):
        """Weighted squared errors of a block, (nv,)."""
        rows, equations = self._rows(block), self.fit.view.equations
        residual = equations.tau[rows] - self.fit.columns(rows) @ theta
        return (equations.weight[rows] * residual**2).sum(axis=0)
