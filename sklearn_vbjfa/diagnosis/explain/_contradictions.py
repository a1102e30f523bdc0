"""Recordings that differ: the parameter that is another in one of them, or in each."""

import functools
from dataclasses import dataclass

import numpy as np
from scipy import stats

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.diagnosis.explain._gaps import SMALLEST_GAIN
from sklearn_vbjfa.effects import Coulomb, Offset, Payload, Viscous

# Parts of a recording: they tell how much one robot differs from itself.
_PARTS = 3
# A recording suffers if most of its squared error comes from the other recordings.
_MOST = 0.5
# Inertial parameters of a body, which a payload changes.
_INERTIAL = 10
# Directions that the data tell less about than this share are left alone.
_KNOWN = 1e-9
# Parameters of a joint that may differ, and recordings from which they may scatter.
_PLAIN = (Offset.name, "gain", "friction")
_SCATTER = 3
# Most parameters that are named.
_MOST_FOUND = 8
# Times that gains are made anew of the torque that recordings share, until it stays.
_TURNS, _STAYS = 30, 1e-4


# tau_r = Phi theta + E_g u_rg + noise: deviations u_rg of a recording r in the columns
# E_g of a group g. They are compared with the deviations of parts of single recordings
# in the same columns, as in a nested analysis of variance (H. Scheffe, "The Analysis of
# Variance", 1959, section 5.3): F = (explained by recordings) / (explained by parts).


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """A parameter that differs in one of the recordings, or in each of them."""

    # that may be the one, from zero, the most probable first; all of them where each
    # has another value
    recordings: tuple
    # offset, gain (of a torque), friction, payload (of the last body), or the model:
    # everything
    name: str
    joints: tuple  # from zero
    # of one offset: how much larger it is [N m or N]; of one gain: how many times as
    # large the torque is; where each differs, their deviation; else nan
    value: float = np.nan
    # of the F test, times the number of parameters that were tested
    p_value: float = np.nan
    scatters: bool = False  # whether each recording has another value
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
    deviations: tuple = ()  # the clearest first


def contradictions(parts, spread, alpha, rivals):
    """Compare the recordings of a fit, `Parts` or None; rivals: nats between them."""
    suffering = [] if parts is None else parts.suffering(spread)
    if not suffering:
        return Contradictions()
    joints = sorted({one.joint for one in suffering})
    # Of two, the one that does not suffer may be the one that differs.
    suspects = range(parts.count)
    if parts.count > 2:
        suspects = sorted({one.recording for one in suffering})
    deviations = _Comparison(parts, rivals).found(suspects, joints, alpha)
    of_joints = {j for one in deviations for j in one.joints}
    found = tuple(one for one in suffering if one.joint in of_joints)
    return Contradictions(found=found, deviations=deviations if found else ())


@dataclass(frozen=True)
class _Group:
    """Parameters that may differ: in one recording, or in each."""

    name: str
    joints: tuple
    recordings: tuple

    @property
    def scatters(self):
        """Whether each recording has another value."""
        return len(self.recordings) > 1


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """A group beside those that were found before."""

    group: _Group
    columns: list  # pairs of the coefficients of each joint's design, and parts
    coef: np.ndarray  # of all columns, those of the groups before first
    theta: np.ndarray
    gain: float  # squares that it explains, over those of the noise
    # the same of parts of single recordings, for each parameter, and what a recording
    # may have
    size: float
    limit: float
    rank: int  # number of parameters
    p_value: float


class _Comparison:
    """Search for the parameters that differ between recordings."""

    def __init__(self, parts, rivals):
        self.parts, self.rivals = parts, rivals
        nv = parts.nv
        self._all = tuple(np.flatnonzero(parts.used).tolist())
        self.count = parts.count * (len(_PLAIN) * nv + 4) + len(_PLAIN) * nv

    def found(self, suspects, joints, alpha):
        """Return the deviations, added one by one while they are significant."""
        groups = list(self._groups(suspects, joints))
        chosen = []
        for _ in range(_MOST_FOUND):
            best = self._best(chosen, groups, alpha)
            if best is None:
                break
            chosen.append(best)
            # An earlier one may have stood in for the last, or for several.
            for one in chosen[:-1]:
                at = chosen.index(one)
                again = self._best(chosen[:at] + chosen[at + 1 :], groups, alpha)
                chosen[at : at + 1] = [] if again is None else [again]
            for k, one in enumerate(chosen):
                kept = _columns_of(chosen[:k] + chosen[k + 1 :])
                chosen[k] = self._tried(kept, one.group)
        return tuple(
            self._deviation(one, chosen[:k] + chosen[k + 1 :], groups)
            for k, one in enumerate(chosen)
        )

    def _trials(self, others, groups, alpha):
        """Return the significant trials beside others, fewest parameters first."""
        kept = _columns_of(others)
        taken = [one.group for one in others]
        found = [self._tried(kept, group) for group in groups if group not in taken]
        least = SMALLEST_GAIN * sum(one.gain for one in others)
        found = [x for x in found if x.p_value * self.count < alpha and x.gain > least]
        return sorted(found, key=lambda one: (one.rank, -one.gain))

    def _best(self, others, groups, alpha):
        """Return the trial that none with more parameters explains much more than."""
        best = None
        for one in self._trials(others, groups, alpha):
            best = one if best is None or self._lead(one, best) > self.rivals else best
        return best

    def _lead(self, one, other, size="limit"):
        """Log Bayes factor (Schwarz) of a trial over another one."""
        # In units of what thirds differ by beside the one with more parameters.
        unit = getattr(max(one, other, key=lambda trial: trial.rank), size)
        penalty = (one.rank - other.rank) * np.log(self.parts.n_blocks)
        return 0.5 * ((one.gain - other.gain) / unit - penalty)

    def _groups(self, suspects, joints):
        """Yield the parameters that may differ in each suspect, or scatter."""
        every = tuple(range(self.parts.count))
        for name in _PLAIN:
            for j in joints:
                for r in suspects:
                    yield _Group(name, (j,), (int(r),))
                if len(every) >= _SCATTER:
                    yield _Group(name, (j,), every)
        wide = ("gain", "friction") if len(self._all) > 1 else ()
        for name in (*wide, Payload.name, "model"):
            for r in suspects:
                yield _Group(name, self._all, (int(r),))

    def _tried(self, kept, group):
        """Fit a group beside the columns that are kept, and test it."""
        parts, is_gain = self.parts, group.name == "gain"
        before, theta, _ = parts.fitted(kept)
        if is_gain and not group.scatters:
            # What is shared is best known from the others.
            theta = parts.solve(~np.isin(parts.recording, group.recordings))
        for _ in range(_TURNS if is_gain else 1):
            columns = self._columns(group, theta)
            after, again, coef = parts.fitted([*kept, *columns])
            change, theta = parts.size(again - theta), again
            if change <= _STAYS * parts.size(theta):
                break
        made = [a for a, _ in self._columns(group, theta)]
        made = made[: len(made) // len(group.recordings)]
        size, freedom = parts.within(made, [*kept, *columns], coef, theta)
        rank = len(columns) - (len(made) if group.scatters else 0)
        # A recording may differ by what its thirds differ by: it is no mean over them.
        size = max(size, 1.0)
        limit = 1.0 + _PARTS * (size - 1.0)
        gain = max(after - before, 0.0)
        return _Trial(
            group=group,
            columns=columns,
            coef=coef,
            theta=theta,
            gain=gain,
            size=size,
            limit=limit,
            rank=rank,
            p_value=float(stats.f.sf(gain / limit / rank, rank, freedom)),
        )

    def _deviation(self, trial, others, groups):
        """Return the `Deviation` of a trial beside others, and its rivals."""
        group, value = trial.group, np.nan
        trials = self._trials(others, groups, 1.0)
        leads = [(self._lead(trial, one, "size"), k) for k, one in enumerate(trials)]
        near = [trials[k].group for lead, k in sorted(leads) if lead < self.rivals]
        if len(group.joints) == 1 and group.name in (Offset.name, "gain"):
            own = trial.coef[-len(trial.columns) :]
            value = float(own[0])
            if group.scatters:
                value = float(own.std())
            elif group.name == "gain":
                value += 1.0
        same = [g for g in near if (g.name, g.joints) == (group.name, group.joints)]
        near_by = (g.recordings[0] for g in same if not g.scatters)
        recordings = dict.fromkeys([group.recordings[0], *near_by])
        return Deviation(
            recordings=group.recordings if group.scatters else tuple(recordings),
            name=group.name,
            joints=group.joints,
            value=value,
            p_value=min(trial.p_value * self.count, 1.0),
            scatters=group.scatters,
            rivals=tuple(dict.fromkeys(g.name for g in near if g.name != group.name)),
        )

    def _columns(self, group, theta):
        """Return the columns of a group in each of its recordings."""
        designs = self._designs(group, theta)
        recording = self.parts.recording
        return [(a, recording == r) for r in group.recordings for a in designs]

    def _designs(self, group, theta):
        """Return the columns of a group as coefficients of the joints' designs."""
        parts = self.parts
        if group.name == Payload.name:
            return [parts.of_parameter(k) for k in parts.last_body]
        if group.name == "model":
            every = [parts.of_parameter(k) for k in range(parts.width)]
            return every + [parts.of_term(j, k) for j in self._all for k in range(3)]
        if group.name == "gain":
            return [parts.of_torque(j, theta) for j in group.joints]
        terms = (0,) if group.name == Offset.name else (1, 2)
        return [parts.of_term(j, k) for j in group.joints for k in terms]


def _columns_of(trials):
    """Return the columns of several trials."""
    return [column for one in trials for column in one.columns]


class Parts:
    """Second moments of the equations of each joint, by recordings and their parts."""

    # fit: `FinalFit`, the completed model on all recordings. The design of a joint has
    # the parameters that move it, and an offset, viscous and Coulomb friction.

    @classmethod
    def of(cls, fit):
        """Take a fit apart; None for a single recording, or if no channel counts."""
        several = np.unique(fit.view.origin).size > 1
        return cls(fit) if several and fit.view.precision.any() else None

    def __init__(self, fit):
        view = self._view = fit.view
        self.precision, self.nv = view.precision, view.nv
        self.used = view.precision > 0
        self._number(view)
        weight = view.equations.weight
        Phi = fit.columns()
        self.width = Phi.shape[2]
        features = fit.identifier.features_
        last = features.n_parameters_ - features.n_parameters_ // features.n_joints_
        self.last_body = range(last, last + _INERTIAL)
        self.columns, self._weights = [], []
        # By thirds of time; by positions and by speeds of the joint, over which the
        # parameters of a model differ that does not hold.
        self._moments, self._by_state = [], ([], [])
        states = view.states[view.index]
        for j in range(self.nv):
            terms = [e(joint=j) for e in (Offset, Viscous, Coulomb)]
            terms = [fit.in_equations(e)[:, j, 0] for e in terms]
            self.columns.append(np.flatnonzero((Phi[:, j] != 0).any(axis=0)))
            rows = np.column_stack([Phi[:, j, self.columns[j]], *terms])
            rows = np.column_stack([rows, view.equations.tau[:, j]])
            own = weight[:, j]
            position, speed = states[:, j], np.abs(states[:, self.nv + j])
            for kept, part in (
                (self._moments, self._part),
                (self._by_state[0], self._sorted(view.origin, position, own)),
                (self._by_state[1], self._sorted(view.origin, speed, own)),
            ):
                places = (part == p for p in range(part.max() + 1))
                kept.append(
                    np.array([(rows[x] * own[x, None]).T @ rows[x] for x in places])
                )
            self._weights.append(np.bincount(self._part, own, len(self.recording)))
        self._weights = np.array(self._weights).T
        self._prior = self._prior_of(fit.identifier)
        self.noise = self._noise()

    def _number(self, view):
        """Count parts of the rows, thirds of the blocks of each recording."""
        label = view.spans.label
        starts = np.r_[0, np.flatnonzero(np.diff(label)) + 1]
        origin = view.origin[starts]
        part, recording = np.empty(starts.size, dtype=int), []
        for number, name in enumerate(np.unique(origin)):
            own = np.flatnonzero(origin == name)
            count = min(_PARTS, own.size)
            # Not in turns: slow noise would be known from both neighbours.
            part[own] = len(recording) + np.arange(own.size) * count // own.size
            recording += [number] * count
        self.recording, self.n_blocks = np.array(recording), starts.size
        self.count = int(self.recording[-1]) + 1
        self._part = np.repeat(part, np.diff(np.r_[starts, label.size]))

    def _sorted(self, origin, values, weight):
        """Return parts of each recording by the size of a signal, (m,)."""
        part = np.zeros(values.size, dtype=int)
        for number, name in enumerate(np.unique(origin)):
            own = np.flatnonzero(origin == name)
            order = own[np.argsort(values[own], kind="stable")]
            done = np.cumsum(weight[order])
            share = done / done[-1] if done[-1] > 0 else np.linspace(0, 1, own.size)
            place = np.minimum((_PARTS * share).astype(int), _PARTS - 1)
            part[order] = _PARTS * number + place
        return part

    def _prior_of(self, identifier):
        """Return what the description says of the bodies, as moments (p, p), (p,)."""
        p, rigid = self.width, identifier.features_.n_parameters_
        G, g = np.zeros((p, p)), np.zeros(p)
        described = identifier.described()
        if described is not None:
            own = identifier.estimator_.joint_weights_[self.used]
            metric, centre = described
            ratio = np.mean(self._view.precision[self.used] / own)
            metric = metric[:rigid, :rigid] * ratio
            G[:rigid, :rigid], g[:rigid] = metric, metric @ centre[:rigid]
        return G, g

    def _noise(self):
        """Return weights of the joints by fits to each recording alone, (nv,)."""
        # Of what recordings share, differences between them would count as noise.
        squares = np.zeros(self.nv)
        for r in range(self.count):
            theta = self.solve(self.recording == r)
            own = np.flatnonzero(self.recording == r)
            squares += sum(self._squares(p, theta) for p in own)
        total = self._weights.sum(axis=0)
        known = self.used & (squares > 0)
        return np.where(known, total / np.where(known, squares, 1.0), 0.0)

    # -- fits --------------------------------------------------------------------------

    def _system(self, chosen, precision):
        """Return the normal equations of some parts, (p, p) and (p,)."""
        G, g = (values.copy() for values in self._prior)
        for j in np.flatnonzero(self.used):
            own, n = self.columns[j], self.columns[j].size
            moments = precision[j] * self._moments[j][chosen].sum(axis=0)
            G[np.ix_(own, own)] += moments[:n, :n]
            g[own] += moments[:n, -1]
        return G, g

    def solve(self, chosen):
        """Fit to some parts with the description as prior, (p,)."""
        G, g = self._system(chosen, self.precision)
        return scaled_eigen(G, _KNOWN).solve(g)

    @functools.cached_property
    def _whole(self):
        """Normal equations of all parts, their decomposition, and the solution."""
        G, g = self._system(np.ones(len(self.recording), dtype=bool), self.noise)
        eigen = scaled_eigen(G, _KNOWN)
        return G, eigen, eigen.solve(g)

    def fitted(self, columns):
        """Fit further columns; returns what they explain, theta and coefficients."""
        _, eigen, theta = self._whole
        if not columns:
            return 0.0, theta, np.empty(0)
        K = len(columns)
        cross, H, h = np.zeros((self.width, K)), np.zeros((K, K)), np.zeros(K)
        where = np.array([at for _, at in columns], dtype=float)
        for j in np.flatnonzero(self.used):
            A = np.column_stack([a[j] for a, _ in columns])
            moments = self.noise[j] * self._moments[j]
            made = (moments[:, :-1, :-1] @ A) * where.T[:, None]
            cross[self.columns[j]] += made[:, : self.columns[j].size].sum(axis=0)
            H += ((A.T @ made) * where.T[:, :, None]).sum(axis=0)
            h += (where * (A.T @ moments[:, :-1, -1].T)).sum(axis=1)
        left = eigen.solve(cross)
        H, h = H - cross.T @ left, h - cross.T @ theta
        coef = scaled_eigen(H, _KNOWN).solve(h)
        return float(coef @ h), theta - left @ coef, coef

    def size(self, theta):
        """Root of the squared torques of some parameters."""
        return float(np.sqrt(max(theta @ self._whole[0] @ theta, 0.0)))

    def within(self, designs, columns, coef, theta):
        """Return what designs explain of parts of recordings, over their number."""
        # And the freedom: of the partition whose parts differ most.
        thirds = np.repeat(np.arange(self.count), _PARTS)
        found = [
            self._within(self._moments, self.recording, designs, columns, coef, theta)
        ]
        for moments in self._by_state:
            found.append(self._within(moments, thirds, designs, columns, coef, theta))
        return max(found)

    def _within(self, moments, recording, designs, columns, coef, theta):
        """Do the same for one partition of the rows of each joint."""
        K = len(designs)
        scores, grams = np.zeros((recording.size, K)), np.zeros((recording.size, K, K))
        active = [
            [
                (a, x)
                for (a, at), x in zip(columns, coef)
                if at[self.recording == r].any()
            ]
            for r in range(self.count)
        ]
        for j in np.flatnonzero(self.used):
            A = np.column_stack([a[j] for a in designs])
            known = np.zeros((self.count, A.shape[0]))
            known[:, : self.columns[j].size] = theta[self.columns[j]]
            for r, own in enumerate(active):
                known[r] += sum(value * a[j] for a, value in own)
            M = self.noise[j] * moments[j]
            left = M[:, :-1, -1] - (M[:, :-1, :-1] @ known[recording, :, None])[..., 0]
            scores += left @ A
            grams += A.T @ M[:, :-1, :-1] @ A
        total, freedom = 0.0, 0
        for r in range(self.count):
            own = recording == r
            pairs = [*zip(scores[own], grams[own])]
            for sign, (h, H) in (
                *((1, pair) for pair in pairs),
                (-1, (scores[own].sum(axis=0), grams[own].sum(axis=0))),
            ):
                eigen = scaled_eigen(H, _KNOWN)
                total += sign * float(h @ eigen.solve(h))
                freedom += sign * eigen.rank
        return (total / freedom, freedom) if freedom > 0 else (np.inf, 1)

    # -- columns, as coefficients of the designs of the joints -------------------------

    def of_parameter(self, k):
        """Column of a parameter in the torques of all joints."""
        return [np.r_[(own == k).astype(float), 0.0, 0.0, 0.0] for own in self.columns]

    def of_term(self, joint, k):
        """Column of the offset or a friction term of a joint."""
        found = [np.zeros(own.size + 3) for own in self.columns]
        found[joint][self.columns[joint].size + k] = 1.0
        return found

    def of_torque(self, joint, theta):
        """Column of the torque of a joint."""
        found = [np.zeros(own.size + 3) for own in self.columns]
        own = self.columns[joint]
        found[joint][: own.size] = theta[own]
        return found

    # -- errors ------------------------------------------------------------------------

    def _squares(self, p, theta):
        """Weighted squared errors of a part by joint, (nv,)."""
        found = []
        for own, moments in zip(self.columns, self._moments):
            left = np.zeros(own.size + 4)
            left[: own.size], left[-1] = -theta[own], 1.0
            found.append(left @ moments[p] @ left)
        return np.maximum(found, 0.0)

    def suffering(self, spread):
        """List joints of recordings that a fit to these alone predicts much better."""
        found = []
        for r in range(self.count):
            own = np.flatnonzero(self.recording == r)
            if own.size < _PARTS:
                continue
            here, squares = self.recording == r, np.zeros((2, self.nv))
            for p in own:
                others = np.arange(len(self.recording)) != p
                for k, chosen in enumerate((here & others, others)):
                    squares[k] += self._squares(p, self.solve(chosen))
            rows = self._weights[own].sum(axis=0)
            alone, together = squares
            for joint in np.flatnonzero(self.used & (rows > 0)):
                if alone[joint] <= _MOST * together[joint]:
                    size = spread[joint] * np.sqrt(rows[joint])
                    found.append(
                        Contradiction(
                            recording=r,
                            joint=int(joint),
                            alone=float(np.sqrt(alone[joint]) / size),
                            together=float(np.sqrt(together[joint]) / size),
                        )
                    )
        return found

    def left_out(self, spread):
        """Errors (r, nv) on each recording of fits to the others, over the spread."""
        # Recordings of one motion are left out together: none of them is another one.
        repetition = self._view.repetition
        motion = repetition.motion if repetition else np.arange(self.count)
        names = np.unique(motion)
        if names.size < 2:
            return np.empty((0, spread.size))
        out = np.full((names.size, spread.size), np.nan)
        for row, name in zip(out, names):
            own = np.isin(self.recording, np.flatnonzero(motion == name))
            theta = self.solve(~own)
            weight = self._weights[own].sum(axis=0)
            squares = sum(self._squares(p, theta) for p in np.flatnonzero(own))
            used = (weight > 0) & self.used
            row[used] = np.sqrt(squares[used] / weight[used]) / spread[used]
        return out
