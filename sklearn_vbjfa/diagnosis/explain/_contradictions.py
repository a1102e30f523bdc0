"""Recordings that differ: the parameter that is another in one of them."""

import functools
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.diagnosis.explain._gaps import SMALLEST_GAIN
from sklearn_vbjfa.effects import Coulomb, Offset, Payload, Viscous

# Parts of a recording: they show how much one robot differs from itself.
_PARTS = 3
# A recording suffers if most of its squared error comes from the other recordings.
_MOST = 0.5
# Inertial parameters of a body, which a payload changes.
_INERTIAL = 10
# Directions that the data tell less about than this share are left alone.
_KNOWN = 1e-9
# Parameters of a joint that may differ.
_PLAIN = (Offset.name, "gain", "friction")
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
    """A parameter that differs in one of the recordings."""

    recordings: tuple  # that may be the one, from zero, the most probable first
    # offset, gain (of a torque), friction, payload (of the last body), or the model:
    # everything
    name: str
    joints: tuple  # from zero
    # of one offset: how much larger it is [N m or N]; of one gain: how many times as
    # large the torque is; else nan
    value: float = np.nan
    # of the F test, times the number of parameters that were tested
    p_value: float = np.nan
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
    deviations = _Comparison(parts, suspects, joints, rivals).found(alpha)
    of_joints = {j for one in deviations for j in one.joints}
    found = tuple(one for one in suffering if one.joint in of_joints)
    return Contradictions(found=found, deviations=deviations if found else ())


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """Parameters that differ in a recording, beside those that were found before."""

    group: tuple  # name, joints and recording
    columns: list  # pairs of the coefficients of each joint's design, and parts
    coef: np.ndarray
    theta: np.ndarray
    gain: float  # squares that it explains, over those of the noise
    # the same of parts of single recordings, for each parameter
    size: float
    p_value: float

    @property
    def rank(self):
        """Number of parameters."""
        return len(self.columns)

    @property
    def limit(self):
        """What a recording may differ by, for each parameter."""
        # By what its thirds differ by: it is no mean over them.
        return 1.0 + _PARTS * (self.size - 1.0)


class _Comparison:
    """Search for the parameters that differ between recordings."""

    def __init__(self, parts, suspects, joints, rivals):
        self.parts, self.rivals = parts, rivals
        every = tuple(np.flatnonzero(parts.used).tolist())
        wide = ("gain", "friction") if len(every) > 1 else ()
        self.groups = [
            (name, own, int(r))
            for name, own in (
                *((name, (j,)) for name in _PLAIN for j in joints),
                *((name, every) for name in (*wide, Payload.name, "model")),
            )
            for r in suspects
        ]
        self.count = parts.count * (len(_PLAIN) * parts.nv + len(wide) + 2)

    def found(self, alpha):
        """Return the deviations, added one by one while they are significant."""
        chosen = []
        for _ in range(_MOST_FOUND):
            best = self._best(chosen, alpha)
            if best is None:
                break
            chosen.append(best)
            # An earlier one may have stood in for the last, or for several.
            for one in chosen[:-1]:
                again = self._best(_without(chosen, one), alpha)
                at = chosen.index(one)
                chosen[at : at + 1] = [] if again is None else [again]
            for k, one in enumerate(chosen):
                chosen[k] = self._tried(_without(chosen, one), one.group)
        return tuple(self._deviation(one, _without(chosen, one)) for one in chosen)

    def _trials(self, others, alpha):
        """Return the significant trials beside others, fewest parameters first."""
        taken = [one.group for one in others]
        found = [self._tried(others, g) for g in self.groups if g not in taken]
        least = SMALLEST_GAIN * sum(one.gain for one in others)
        found = [x for x in found if x.p_value < alpha and x.gain > least]
        return sorted(found, key=lambda one: (one.rank, -one.gain))

    def _best(self, others, alpha):
        """Return the trial that none with more parameters explains much more than."""
        best = None
        for one in self._trials(others, alpha):
            best = one if best is None or self._lead(one, best) > self.rivals else best
        return best

    def _lead(self, one, other, size="limit"):
        """Log Bayes factor (Schwarz) of a trial over another one."""
        # In units of what thirds differ by beside the one with more parameters.
        unit = getattr(max(one, other, key=lambda trial: trial.rank), size)
        penalty = (one.rank - other.rank) * np.log(self.parts.n_blocks)
        return 0.5 * ((one.gain - other.gain) / unit - penalty)

    def _tried(self, others, group):
        """Fit a group beside other trials, and test it."""
        parts, (name, _, recording) = self.parts, group
        kept = [column for one in others for column in one.columns]
        before, theta, _ = parts.fitted(kept)
        if name == "gain":
            # What is shared is best known from the others.
            theta = parts.solve(parts.recording != recording)
        for _ in range(_TURNS if name == "gain" else 1):
            designs = self._designs(group, theta)
            columns = [(a, parts.recording == recording) for a in designs]
            after, again, coef = parts.fitted([*kept, *columns])
            change, theta = parts.size(again - theta), again
            if change <= _STAYS * parts.size(theta):
                break
        designs = self._designs(group, theta)
        size, freedom = parts.within(designs, [*kept, *columns], coef, theta)
        trial = _Trial(
            group=group,
            columns=columns,
            coef=coef[-len(columns) :],
            theta=theta,
            gain=max(after - before, 0.0),
            size=max(size, 1.0),
            p_value=1.0,
        )
        F = trial.gain / trial.limit / trial.rank
        p_value = float(stats.f.sf(F, trial.rank, freedom)) * self.count
        return replace(trial, p_value=min(p_value, 1.0))

    def _deviation(self, trial, others):
        """Return the `Deviation` of a trial beside others, and its rivals."""
        (name, joints, recording), value = trial.group, np.nan
        # All of them, significant or not.
        trials = self._trials(others, np.inf)
        leads = [(self._lead(trial, one, "size"), k) for k, one in enumerate(trials)]
        near = [trials[k].group for lead, k in sorted(leads) if lead < self.rivals]
        if len(joints) == 1 and name in (Offset.name, "gain"):
            value = float(trial.coef[0]) + (name == "gain")
        same = [g[2] for g in near if g[:2] == (name, joints)]
        return Deviation(
            recordings=tuple(dict.fromkeys([recording, *same])),
            name=name,
            joints=joints,
            value=value,
            p_value=trial.p_value,
            rivals=tuple(dict.fromkeys(g[0] for g in near if g[0] != name)),
        )

    def _designs(self, group, theta):
        """Return the columns of a group as coefficients of the joints' designs."""
        parts, (name, joints, _) = self.parts, group
        if name == Payload.name:
            return [parts.of_parameter(k) for k in parts.last_body]
        if name == "model":
            every = [parts.of_parameter(k) for k in range(parts.width)]
            return every + [parts.of_term(j, k) for j in joints for k in range(3)]
        if name == "gain":
            return [parts.of_torque(j, theta) for j in joints]
        terms = (0,) if name == Offset.name else (1, 2)
        return [parts.of_term(j, k) for j in joints for k in terms]


def _without(trials, one):
    return [other for other in trials if other is not one]


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
        self.nv, self.used = view.nv, view.precision > 0
        names, recording = np.unique(view.origin, return_inverse=True)
        self.count = names.size
        # Thirds of the blocks, not in turns: slow noise would be known from both
        # neighbours.
        block = np.r_[0, np.cumsum(np.diff(view.spans.label) != 0)]
        self.n_blocks = int(block[-1]) + 1
        part = np.zeros(recording.size, dtype=int)
        for r in range(self.count):
            own = recording == r
            place = np.unique(block[own], return_inverse=True)[1]
            part[own] = _PARTS * r + place * _PARTS // max(place[-1] + 1, _PARTS)
        _, first, part = np.unique(part, return_index=True, return_inverse=True)
        self.recording = recording[first]
        features = fit.identifier.features_
        last = features.n_parameters_ - features.n_parameters_ // features.n_joints_
        self.last_body = range(last, last + _INERTIAL)
        Phi, weight = fit.columns(), view.equations.weight
        states = view.states[view.index]
        self.width, self.columns, self._weights = Phi.shape[2], [], []
        # By thirds of time; by positions and by speeds of the joint, over which the
        # parameters of a model differ that does not hold.
        self._moments = [], [], []
        for j in range(self.nv):
            terms = [e(joint=j) for e in (Offset, Viscous, Coulomb)]
            terms = [fit.in_equations(e)[:, j, 0] for e in terms]
            self.columns.append(np.flatnonzero((Phi[:, j] != 0).any(axis=0)))
            rows = np.column_stack([Phi[:, j, self.columns[j]], *terms])
            rows = np.column_stack([rows, view.equations.tau[:, j]])
            own, speed = weight[:, j], np.abs(states[:, self.nv + j])
            for kept, label in (
                (self._moments[0], part),
                (self._moments[1], _sorted(recording, states[:, j], own)),
                (self._moments[2], _sorted(recording, speed, own)),
            ):
                places = (label == p for p in range(label.max() + 1))
                kept.append(
                    np.array([(rows[x] * own[x, None]).T @ rows[x] for x in places])
                )
            self._weights.append(np.bincount(part, own, first.size))
        self._weights = np.array(self._weights).T
        self._prior = self._prior_of(fit.identifier)
        self.noise = self._noise()

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
            own = self.recording == r
            squares += self._squares(own, self.solve(own))
        total = self._weights.sum(axis=0)
        known = self.used & (squares > 0)
        return np.where(known, total / np.where(known, squares, 1.0), 0.0)

    # -- fits --------------------------------------------------------------------------

    def _system(self, chosen, precision):
        """Return the normal equations of some parts, (p, p) and (p,)."""
        G, g = (values.copy() for values in self._prior)
        for j in np.flatnonzero(self.used):
            own, n = self.columns[j], self.columns[j].size
            moments = precision[j] * self._moments[0][j][chosen].sum(axis=0)
            G[np.ix_(own, own)] += moments[:n, :n]
            g[own] += moments[:n, -1]
        return G, g

    def solve(self, chosen):
        """Fit to some parts with the description as prior, (p,)."""
        G, g = self._system(chosen, self._view.precision)
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
            moments = self.noise[j] * self._moments[0][j]
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
        """Return what designs explain of parts of single recordings, per parameter."""
        # And the number of these: of the partition whose parts differ most.
        thirds = np.repeat(np.arange(self.count), _PARTS)
        known = designs, columns, coef, theta
        return max(
            self._within(moments, parts, *known)
            for moments, parts in zip(self._moments, (self.recording, thirds, thirds))
        )

    def _within(self, moments, recording, designs, columns, coef, theta):
        """Do the same for one partition of the rows of each joint."""
        K = len(designs)
        scores, grams = np.zeros((recording.size, K)), np.zeros((recording.size, K, K))
        first = [int(np.argmax(self.recording == r)) for r in range(self.count)]
        for j in np.flatnonzero(self.used):
            A = np.column_stack([a[j] for a in designs])
            known = np.zeros((self.count, A.shape[0]))
            known[:, : self.columns[j].size] = theta[self.columns[j]]
            for (a, at), value in zip(columns, coef):
                known += np.outer(at[first], value * a[j])
            M = self.noise[j] * moments[j]
            left = M[:, :-1, -1] - (M[:, :-1, :-1] @ known[recording, :, None])[..., 0]
            scores += left @ A
            grams += A.T @ M[:, :-1, :-1] @ A
        total, freedom = 0.0, 0

        def explained(h, H):
            eigen = scaled_eigen(H, _KNOWN)
            return np.array([float(h @ eigen.solve(h)), eigen.rank])

        for r in range(self.count):
            own = recording == r
            parts = sum(explained(*pair) for pair in zip(scores[own], grams[own]))
            parts -= explained(scores[own].sum(axis=0), grams[own].sum(axis=0))
            total, freedom = total + parts[0], freedom + parts[1]
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

    def _squares(self, chosen, theta):
        """Weighted squared errors of some parts by joint, (nv,)."""
        found = []
        for own, moments in zip(self.columns, self._moments[0]):
            left = np.zeros(own.size + 4)
            left[: own.size], left[-1] = -theta[own], 1.0
            found.append(left @ moments[chosen].sum(axis=0) @ left)
        return np.maximum(found, 0.0)

    def suffering(self, spread):
        """List joints of recordings that a fit to these alone predicts much better."""
        found = []
        for r in range(self.count):
            here = self.recording == r
            if here.sum() < _PARTS:
                continue
            alone, together = np.zeros((2, self.nv))
            for p in np.flatnonzero(here):
                out = np.arange(len(here)) == p
                alone += self._squares(out, self.solve(here & ~out))
                together += self._squares(out, self.solve(~out))
            rows = self._weights[here].sum(axis=0)
            for joint in np.flatnonzero(self.used & (rows > 0)).tolist():
                if alone[joint] <= _MOST * together[joint]:
                    size = spread[joint] * np.sqrt(rows[joint])
                    found.append(
                        Contradiction(
                            recording=r,
                            joint=joint,
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
            squares = self._squares(own, self.solve(~own))
            weight = self._weights[own].sum(axis=0)
            used = (weight > 0) & self.used
            row[used] = np.sqrt(squares[used] / weight[used]) / spread[used]
        return out


def _sorted(recording, values, weight):
    """Divide rows of recordings (m,) into thirds by the size of a signal."""
    part = np.zeros(values.size, dtype=int)
    for number in range(recording.max() + 1):
        own = np.flatnonzero(recording == number)
        order = own[np.argsort(values[own], kind="stable")]
        done = np.cumsum(weight[order])
        share = done / done[-1] if done[-1] > 0 else np.linspace(0, 1, own.size)
        place = np.minimum((_PARTS * share).astype(int), _PARTS - 1)
        part[order] = _PARTS * number + place
    return part
