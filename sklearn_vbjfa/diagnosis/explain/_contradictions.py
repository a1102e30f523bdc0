"""Recordings that differ: what is another in one of them, or in each."""

from dataclasses import dataclass

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.diagnosis.search._problem import (
    Family,
    Fit,
    Moments,
    SelectedEffect,
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
_PLAIN = (Offset.name, "gain", "friction")
_SCATTER = 3
# Times that gains are made anew of the torque that recordings share, until it stays.
_TURNS, _STAYS = 20, 1e-4


# tau_r = Phi theta + sum_g E_g u_rg + noise: deviations u_rg of each recording r in
# each group g of columns E_g, with a half-Cauchy scale that is integrated.


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """What is another in one of the recordings, or in each of them."""

    # that may be the one, from zero, the most probable first; all of them where each
    # has its own
    recordings: tuple
    # offset, gain (of a torque), friction, payload (of the last body), or the model:
    # everything
    name: str
    joints: tuple  # from zero
    # of one offset: how much larger it is [N m or N]; of one gain: how many times as
    # large the torque is; where each has its own, their deviation; else nan
    value: float = np.nan
    log_odds: float = np.nan  # posterior, that it is another
    scatters: bool = False  # whether each recording has its own
    # names of what explains it within the rivals' nats, the best first
    rivals: tuple = ()


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A recording whose torques on a joint are not those of the robot of the others."""

    recording: int  # from zero
    joint: int  # from zero
    # error on parts of the recording that were not fitted, over the spread of the
    # torque: by a fit to the rest of this recording, and by one to the rest of all
    alone: float
    together: float


@dataclass(frozen=True, kw_only=True)
class Contradictions:
    """What contradicts what, and why."""

    found: tuple = ()  # recordings and joints
    deviations: tuple = ()  # what is another, the most probable first


def contradictions(parts, spread, alpha, settings):
    """Compare the recordings of a fit with each other, as `Contradictions`."""
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
    return Contradictions(found=found, deviations=deviations)


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
    whole_robot: bool
    in_model = slow = bank = False
    jumping = ()

    @property
    def joint(self):
        """First joint."""
        return self.joints[0]

    @property
    def scatters(self):
        """Whether each recording has its own."""
        return len(self.recordings) > 1


class _Deviations:
    """Posterior of differences between recordings given the completed model."""

    def __init__(self, fit, settings):
        self.fit, self.scale, self.rivals = fit, settings.scale, settings.rivals
        self.settings, self.view = settings, fit.view
        base = declared_alone(fit.view).base
        self.problem = base.problem
        self.used_joints = np.flatnonzero(self.problem.used_joints)
        self.recordings = np.unique(fit.view.origin)
        effects = [
            Family.of(self.problem, (e,), fit.view.columns([e], fit.motion))
            for e in fit.effects
        ]
        members = [family.member(0, self.scale) for family in effects]
        start = rescaled(Fit(base, members), self.scale)
        self.regression, self.n_effects = spectrum_of(start, settings), len(members)
        self._mirrors, self._families = set(), {}
        self._still = {name: self._kind(name) for name in (Offset.name, "friction")}

    def found(self, suspects, joints, needed):
        """Deviations with enough odds, added one by one, a tuple of `Deviation`."""
        regression, out = self.regression, []
        open_ = list(self._groups(suspects, joints))
        nv, R = self.view.nv, self.recordings.size
        # Each joint and recording counts, whether it suffers or not.
        count = R * (len(_PLAIN) * nv + 4) + len(_PLAIN) * nv * (R >= _SCATTER)
        prior = np.log(self.settings.expected / count)
        while open_:
            torque = self._shared(regression)
            families = [self._family(group, torque) for group in open_]
            odds = [self._evidence(regression, own) + prior for own in families]
            best = int(np.argmax(odds))
            if odds[best] < needed:
                break
            near = [
                open_[k]
                for k in np.argsort(odds)[::-1]
                if odds[k] > odds[best] - self.rivals
            ]
            scale = regression.groups(families[best]).best_scale(self.scale)[0]
            regression = self._beside(regression, families[best], float(scale))
            out.append((open_.pop(best), near, odds[best]))
        members = range(self.n_effects, len(regression.members))
        return tuple(self._told(regression, i, *own) for i, own in zip(members, out))

    def _groups(self, suspects, joints):
        """Yield what may be another, in each suspect or from recording to recording."""
        every = tuple(self.recordings.tolist())
        for name in _PLAIN:
            for j in joints:
                for r in suspects:
                    yield _Group(name, (j,), (int(r),), False)
                if len(every) >= _SCATTER:
                    yield _Group(name, (j,), every, False)
        wide = ("gain", "friction") if self.used_joints.size > 1 else ()
        for name in (*wide, Payload.name, "model"):
            for r in suspects:
                yield _Group(name, tuple(self.used_joints.tolist()), (int(r),), True)

    def _evidence(self, regression, family):
        """Log Bayes factor of a group, tempered by its scatter in time."""
        groups = regression.groups(family)
        if not groups.shown().any():
            return -np.inf
        coef = groups.coefficients()[0]
        excess = regression.excess(family, 0, coef, regression)
        return float(groups.discounted(excess).evidence(self.scale)[0])

    def _beside(self, regression, family, scale):
        """Regression with one more group; gains are of the torque that all share."""
        before, group = regression, family.effects[0]
        regression = before.beside(_member(family, scale))
        if _turned(regression, len(before.members)):
            before = self._mirrored(before, group)
            family = self._family(group, self._shared(before))
            regression = before.beside(_member(family, scale))
        for _ in range(_TURNS):
            torque = self._shared(regression)
            groups = [
                _member(self._family(one.effect, torque), one.scale)
                for one in regression.members[self.n_effects :]
            ]
            members = [*regression.members[: self.n_effects], *groups]
            again = rescaled(Fit(regression.base, members), self.scale)
            regression = spectrum_of(again, self.settings, 1)
            change = self._shared(regression) - torque
            if (change**2).sum() <= _STAYS**2 * (torque**2).sum():
                break
        return regression

    def _mirrored(self, regression, group):
        """Regression on torques of the other sign, for a gain that is negative."""
        problem, j = regression.problem, group.joint
        own = np.isin(self.view.origin, group.recordings)
        rows = problem.cosines.rows(problem.y[[j]]) * np.where(own, -1.0, 1.0)
        y = problem.y.copy()
        y[j] = problem.cosines(rows, [j])[0]
        self._mirrors.add(group)
        base = regression.base.on(problem.with_torques(y))
        return spectrum_of(Fit(base, regression.members), self.settings)

    def _told(self, regression, i, group, near, log_odds):
        """Collect a group that was found, the i-th member."""
        member, value = regression.members[i], np.nan
        if len(group.joints) == 1 and group.name in (Offset.name, "gain"):
            value = float(regression.coefficients(i)[0])
            if group.scatters:
                value = float(member.scale * member.unit[0])
            elif group.name == "gain":
                value = (1.0 + value) * (-1.0 if group in self._mirrors else 1.0)
        alike = (o for o in near if (o.name, o.joints) == (group.name, group.joints))
        recordings = dict.fromkeys(o.recordings[0] for o in alike if not o.scatters)
        others = dict.fromkeys(o.name for o in near if o.name != group.name)
        return Deviation(
            recordings=group.recordings if group.scatters else tuple(recordings),
            name=group.name,
            joints=group.joints,
            value=value,
            log_odds=float(log_odds),
            scatters=group.scatters,
            rivals=tuple(others),
        )

    # -- columns --------------------------------------------------------------------

    def _shared(self, regression):
        """Weighted torque of what all recordings share, (nv, m)."""
        shared = self.problem.Z @ regression.theta
        for i, member in enumerate(regression.members[: self.n_effects]):
            for own, j in zip(member.columns, member.joints):
                shared[j] += own[:, 0] @ regression.coefficients(i)
        return self.problem.cosines.rows(shared)

    def _kind(self, name, torque=None):
        """Columns of each joint that is heard, a dict of (m, k)."""
        if name == "gain":
            return {int(j): torque[j][:, None] for j in self.used_joints}
        effects = (Offset(),) if name == Offset.name else (Viscous(), Coulomb())
        out = {}
        for j in self.used_joints:
            own = [clone(e).set_params(joint=int(j)) for e in effects]
            made = [self.view.columns([e], self.fit.motion)[0, :, 0] for e in own]
            out[int(j)] = np.concatenate(made, axis=1)
        return out

    def _columns(self, group, torque):
        """Columns (nj, m, 1, k) of a group in all recordings."""
        view = self.view
        if group.name == Payload.name:
            features = view.robot.features_
            last = features.n_parameters_ - features.n_parameters_ // view.nv
            body = view.equations.Phi[:, :, last : last + 10] * view.root[:, :, None]
            return body.transpose(1, 0, 2)[:, :, None]
        if group.name == "model":
            every = [_wide(self._still[name], view) for name in self._still]
            return np.concatenate([view.Z[:, :, None], *every], axis=3)
        own = self._still.get(group.name) or self._kind(group.name, torque)
        return (
            _wide(own, view) if group.whole_robot else own[group.joint][None, :, None]
        )

    def _family(self, group, torque):
        """Group in its recordings; but for gains it is made once."""
        if group.name == "gain":
            return self._made(group, torque)
        if group not in self._families:
            self._families[group] = self._made(group, torque)
        return self._families[group]

    def _made(self, group, torque):
        """Group in its recordings, or in each of several with separate columns."""
        columns = self._columns(group, torque)
        unit = Family.of(self.problem, (group,), columns).unit
        joints = tuple(self.view.joints_of(group))
        made = [
            self.problem.cosines(
                columns * (self.view.origin == r)[:, None, None], joints
            )
            for r in group.recordings
        ]
        return Family(
            effects=(group,),
            moments=Moments(joints, np.concatenate(made, axis=3), self.problem.edges),
            unit=np.tile(unit, len(made)),
        )


def _wide(columns, view):
    """Columns (m, k) of joints as those of all joints, (nv, m, 1, k * joints)."""
    width = [own.shape[1] for own in columns.values()]
    out = np.zeros((view.nv, view.index.size, 1, sum(width)))
    for j, own, end in zip(columns, columns.values(), np.cumsum(width)):
        out[j, :, 0, end - own.shape[1] : end] = own
    return out


def _turned(regression, i):
    """Whether a member is the negative gain of a joint in one recording."""
    group = regression.members[i].effect
    single = group.name == "gain" and not (group.whole_robot or group.scatters)
    return single and regression.coefficients(i)[0] < -1.0


def _member(family, scale):
    """Group as a member of a fit."""
    return SelectedEffect(
        effect=family.effects[0],
        moments=family.moments,
        unit=family.unit[0],
        scale=scale,
    )


class Parts:
    """Equations by recordings and parts of them, and fits to all but some of them."""

    # fit: `FinalFit`, the completed model on all recordings; recordings; precision
    # (nv,): weights of the joints.

    @classmethod
    def of(cls, fit):
        """Take a fit apart; None for a single recording, or if no channel counts."""
        several = np.unique(fit.view.origin).size > 1
        return cls(fit) if several and fit.view.precision.any() else None

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
        described = identifier.described()
        if described is not None:
            heard = self.precision > 0
            own = identifier.estimator_.joint_weights_[heard]
            metric, centre = described
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
        """Fit to some blocks with the description as prior, (p,)."""
        known, pulled = self._prior
        G = known + sum(self._moments[b][0] for b in blocks)
        g = pulled + sum(self._moments[b][1] for b in blocks)
        return scaled_eigen(G, _KNOWN).solve(g)

    def left_out(self, spread):
        """Errors (r, nv) on each recording of fits to the others, over the spread."""
        # Recordings of one motion are left out together: none of them is another one.
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
        """Squared errors (n_blocks, nv) on parts of a recording, without them."""
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
