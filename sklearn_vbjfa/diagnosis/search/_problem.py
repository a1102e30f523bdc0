"""The regression of all joints in frequency, with some groups of effects."""

import copy
import functools
import itertools
from collections import namedtuple
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy import fft, linalg
from scipy.linalg import lapack

from sklearn_vbjfa._core._groups import Groups, Overdispersion
from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.diagnosis.search._cosines import Cosines, Spectrum
from sklearn_vbjfa.effects import Bank, InModel


def band_products(edges, one, other):
    """Products of columns (n, ...) and (n, ...) in each band, (n_bands, p, q)."""
    one, other = one.reshape(len(one), -1), other.reshape(len(other), -1)
    return np.array([one[a:b].T @ other[a:b] for a, b in itertools.pairwise(edges)])


# One in so many cosines of the scores is slow; and the slowest of them.
_SLOW, _SLOWEST = 4, 4
_TINY = np.finfo(float).tiny
# Ridge of the rigid bodies and plain terms, over the square sum of a column: rounding.
_RIDGE = 1e-9
# How much better than by the data a term is known that is held at zero.
_ZERO_PRECISION = 1e6


class Columns:
    """Columns of an effect with c shapes in frequency, up to k for each of them."""

    # effects (c,): one for each shape; joints: those that they act on; values (nj, n,
    # c, k): cosines, sorted by band; unit (c, k): see `Groups`, zero for columns of
    # zeros; edges: see `Problem`; load: motion with the load that they depend on.

    def __init__(self, effects, joints, values, unit, edges, load=None):
        self.effects, self.joints, self.load = tuple(effects), tuple(joints), load
        self.values, self.unit, self.edges = values, unit, edges
        # with which columns and torques products were made last, and these
        self._declared = self._right = None, None

    @property
    def shape(self):
        """Number of shapes, and of columns of each, (c, k)."""
        return self.unit.shape

    @functools.cached_property
    def gram(self):
        """Products with themselves by band, shape by shape, (nj, n_bands, c, k, k)."""
        X = np.ascontiguousarray(self.values.swapaxes(1, 2))
        bands = [X[:, :, a:b] for a, b in itertools.pairwise(self.edges)]
        return np.stack([x.swapaxes(-1, -2) @ x for x in bands], axis=1)

    def declared(self, Z):
        """Products with columns Z (nv, n, r) by band, (nj, n_bands, r, c * k)."""
        if self._declared[0] is not Z:
            self._declared = Z, self._products(Z)
        return self._declared[1]

    def right(self, y):
        """Products with torques y (nv, n) by band, (nj, n_bands, c * k)."""
        if self._right[0] is not y:
            self._right = y, self._products(y)[:, :, 0]
        return self._right[1]

    def _products(self, of):
        pairs = zip(self.joints, self.values)
        return np.array([band_products(self.edges, of[j], own) for j, own in pairs])

    def member(self, c=0, scale=1.0):
        """Return one of the shapes as a `SelectedEffect`."""
        k, columns = len(self.effects[c].coefficients), self
        if self.shape != (1, k):
            own = np.ascontiguousarray(self.values[:, :, c : c + 1, :k])
            unit = self.unit[c : c + 1, :k]
            known = self.joints, own, unit, self.edges, self.load
            columns = Columns(self.effects[c : c + 1], *known)
        return SelectedEffect(columns=columns, scale=scale)


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectedEffect:
    """An effect in the model, with one shape."""

    columns: Columns
    scale: float = 1.0  # prior deviation of its coefficients, in units

    @property
    def effect(self):
        """Effect with its shape."""
        return self.columns.effects[0]

    @property
    def joints(self):
        """Joints that it acts on, tuple of int."""
        return self.columns.joints

    @property
    def unit(self):
        """Coefficients with which each column has the torque of its joint, (k,)."""
        return self.columns.unit[0]

    @property
    def width(self):
        """Number of columns."""
        return self.unit.size

    @functools.cached_property
    def applied(self):
        """What of its coefficients the equations have already, (k,)."""
        if not isinstance(self.effect, InModel):
            return np.zeros(self.width)
        return self.effect.values - np.asarray(self.effect.nominal)


def _joint_columns(joint, columns):
    """Columns (n, p) of members on a joint, and their products by band."""
    X = np.hstack([x.values[x.joints.index(joint), :, 0] for x in columns])
    return X, band_products(columns[0].edges, X, X)


class Problem:
    """Equations of all joints in frequency: declared columns and torques."""

    # Z, y, (nv, n, r) and (nv, n): cosines of the declared columns and of the torques,
    # sorted by band; edges (n_bands + 1,): where each begins, and the last one ends;
    # torque (nv,): root mean square of the varying torque in weighted rows; motion:
    # signals from which columns are made; held (nv, n): terms of one sign that are
    # zero.

    motion = None

    def __init__(self, view, cosines=None):
        self.view = view
        self.cosines = Cosines(view) if cosines is None else cosines
        joints = range(view.nv)
        self.Z, self.y = self.cosines(view.Z, joints), self.cosines(view.target, joints)
        rows = np.maximum(view.rows, _TINY)
        mean = (view.target * view.root.T).sum(axis=1) / rows
        rest = view.target - mean[:, None] * view.root.T
        self.torque = np.sqrt((rest**2).sum(axis=1) / view.target.shape[1])
        self._per_torque = (self.torque > 0) / or_one(self.torque)
        self.used_joints = view.precision > 0
        self.held = np.zeros(view.one_sided.shape[:2], dtype=bool)
        # Most joints of a fit have the members that they had in one before.
        self.joint_columns = functools.lru_cache(_joint_columns)

    @property
    def edges(self):
        """Where each band of cosines begins, and the last one ends."""
        return self.cosines.edges

    @functools.cached_property
    def gram(self):
        """Products of the columns by joint and band, (nv, n_bands, r, r)."""
        return np.array([band_products(self.edges, Z, Z) for Z in self.Z])

    @functools.cached_property
    def right(self):
        """Products of these with the torques, (nv, n_bands, r)."""
        pairs = zip(self.Z, self.y)
        return np.array([band_products(self.edges, Z, y)[:, :, 0] for Z, y in pairs])

    @functools.cached_property
    def power(self):
        """Square sums of the torques, (nv, n_bands)."""
        return np.add.reduceat(self.y**2, self.edges[:-1], axis=1)

    def changed(self, **values):
        """Return the same columns with other torques `y`, `motion` or terms `held`."""
        made = copy.copy(self)
        vars(made).update(values)
        # What is made of the columns alone stays.
        for name in ("right", "power") if "y" in values else ():
            vars(made).pop(name, None)
        return made

    def shaped(self, effects):
        """Return `Columns` of an effect with some shapes, list of Effect."""
        key, joints = self._key(effects), effects[0].acts_on(self.view.nv)
        load = self.motion if any("load" in e.needs for e in effects) else None
        found = self.view.cache.get(key)
        if found is None or found.load is not load:
            values, size = self.view.shaped(effects, self.motion, self.cosines)
            # An effect of all joints has the torque of that which it moves the most.
            largest = (size * self._per_torque[joints][:, None, None]).max(axis=0)
            unit = (largest > 0) / or_one(largest)
            found = Columns(effects, joints, values, unit, self.edges, load)
        return self.view.keep(key, found)

    def only(self, columns, used):
        """Return `Columns` with some elements (k,) of a bank with one shape."""
        effects = [columns.effects[0].only(used)]
        values, unit = columns.values[..., used], columns.unit[:, used]
        load = columns.load if "load" in effects[0].needs else None
        found = Columns(effects, columns.joints, values, unit, self.edges, load)
        return self.view.keep(self._key(effects), found)

    def _key(self, effects):
        """Return what columns of effects depend on, but for the load."""
        joints = effects[0].acts_on(self.view.nv)
        uses = ((type(e), e.joint, *sorted(e.shape().items())) for e in effects)
        return *self.view.gains[joints], *self.torque[joints], *uses

    def shapes(self, effect, first=False):
        """Return an effect with all shapes of its grid, or those to begin with."""
        shapes = effect.first_shapes if first else effect.shapes
        kind, known = type(effect), effect.get_params(deep=False)
        return [kind(**known | shape) for shape in shapes(self.motion)]


def _solve(L, right, turned=False):
    """Solve a lower triangular system (r, ...), or that of its transpose."""
    # SciPy's own function checks for longer than such small systems take.
    if not right.size:
        # What LAPACK calls illegal.
        return np.zeros(right.shape)
    found, _ = lapack.dtrtrs(L, right, lower=1, trans=int(turned))
    return found if right.ndim > 1 else found.ravel()


def precision_at_zero(gram, rows):
    """Precision (r, r) with which sums `rows` (h, r) of coefficients are zero."""
    # gram (r, r): precision of the coefficients by the data.
    power = (_solve(linalg.cholesky(gram, lower=True), rows.T) ** 2).sum(axis=0)
    return (_ZERO_PRECISION / power * rows.T) @ rows


class Base:
    """The declared columns under given weights, and families given these."""

    # density (nv, n_bands): weights of the cosines of each band; spectrum: what they
    # are from, a power `share` of it, or None; L (r, r): lower Cholesky factor of the
    # Gram matrix; t (r,): L^-1 times the products with the torques.

    def __init__(self, problem, density, spectrum=None, share=1.0):
        self.problem, self.density = problem, density
        self.spectrum, self.share = spectrum, share
        G = np.tensordot(density, problem.gram, 2)
        # Of each column itself: weights make some of them a thousand times the others.
        G += np.diag(_RIDGE * np.maximum(np.diagonal(G), 1.0))
        if problem.held.any():
            G += precision_at_zero(G, problem.view.one_sided[problem.held])
        self.L = linalg.cholesky(G, lower=True)
        self.t = _solve(self.L, np.tensordot(density, problem.right, 2))
        self._cache, self._cross_cache = WeakKeyDictionary(), WeakKeyDictionary()

    @property
    def log_prior(self):
        """Logarithm of the prior density of the spectrum, but for a constant."""
        return 0.0 if self.spectrum is None else self.spectrum.log_prior

    def on(self, problem):
        """Return the same weights on other equations."""
        kept = ("Z", "y", "held")
        if any(getattr(problem, x) is not getattr(self.problem, x) for x in kept):
            return Base(problem, self.density, self.spectrum, self.share)
        other = copy.copy(self)
        other.problem = problem
        return other

    @functools.cached_property
    def weights(self):
        """Weights of the cosines, (nv, n)."""
        return self.density[:, self.problem.cosines.band]

    @functools.cached_property
    def inverse(self):
        """Inverse of the Gram matrix, (r, r)."""
        return linalg.cho_solve((self.L, True), np.eye(self.L.shape[0]))

    def score_variance_ratio(self, white):
        """How much less than the variance of whitened scores the weights promise."""
        # white (nv, n, c).
        if self.spectrum is None:
            return np.ones(white.shape[2])
        power = np.add.reduceat(white**2, self.problem.edges[:-1], axis=1)
        noise = self.density * self.spectrum.noise(self.problem.cosines)
        return np.tensordot(noise, power, 2) / np.maximum(power.sum((0, 1)), _TINY)

    def without_correction(self, member):
        """Return the same before a member's corrections, as far as these are linear."""
        done = member.applied
        if not done.any():
            return self
        y, other = self.problem.y.copy(), copy.copy(self)
        for j, own in zip(member.joints, member.columns.values):
            y[j] += own[:, 0] @ done
        other.problem = self.problem.changed(y=y)
        other._cache = WeakKeyDictionary()
        other.t = self.t + self.beside(member.columns).T @ done
        return other

    def weighted(self, joints, products):
        """Sum products by joint and band (nj, n_bands, ...) with their weights."""
        density = self.density[list(joints)].ravel()
        found = density @ products.reshape(density.size, -1)
        return found.reshape(products.shape[2:])

    def beside(self, columns):
        """Moments of `Columns` and the declared ones, `ReducedMoments`."""
        if columns not in self._cache:
            own, (c, k) = columns.joints, columns.shape
            T = _solve(self.L, self.weighted(own, columns.declared(self.problem.Z)))
            right = self.weighted(own, columns.right(self.problem.y))
            gram = self.weighted(own, columns.gram)
            H, q = gram - _blocks(T, c, k), (right - self.t @ T).reshape(c, k)
            self._cache[columns] = ReducedMoments(T=T, gram=gram, H=H, q=q)
        return self._cache[columns]

    def cross_products(self, members, columns):
        """Weighted products of members' columns with others, (p, c * k)."""
        known = self._cross_cache.setdefault(columns, WeakKeyDictionary())
        for one in (m.columns for m in members if m.columns not in known):
            known[one] = np.zeros((one.unit.size, columns.unit.size))
            for j in set(one.joints).intersection(columns.joints):
                own = one.values[one.joints.index(j), :, 0] * self.weights[j][:, None]
                other = columns.values[columns.joints.index(j)]
                known[one] += own.T @ other.reshape(len(other), -1)
        none = np.zeros((0, columns.unit.size))
        return np.vstack([none, *(known[m.columns] for m in members)])


# Moments of c groups of k columns and the declared ones: T (r, c * k), L^-1 times their
# products; the groups' Gram matrices, and H, what is left of them, (c, k, k); q (c, k),
# products with what is left of the torques.
ReducedMoments = namedtuple("ReducedMoments", "T gram H q")


def _blocks(T, c, k):
    """Blocks on the diagonal of T' T, (c, k, k)."""
    by_group = T.reshape(-1, c, k).transpose(1, 2, 0)
    return by_group @ by_group.transpose(0, 2, 1)


def _score_powers(scores):
    """Powers of the changes of scores in time, from the slowest, and the slow ones."""
    power = fft.dct(scores, norm="ortho")[1:] ** 2 * scores.size
    return power, power[: max(power.size // _SLOW, 1)]


class Fit:
    """A model of all joints' torques with some members, under given weights."""

    # base: declared columns under these weights; theta (r,): posterior mean of those;
    # places: coefficients of each member; prior (p,): precision of these. B (r, p), H
    # (p, p), q (p,): products of the members' columns with the declared ones, and with
    # each other and the torques as far as those leave them; `reduced` where another fit
    # has made them.

    def __init__(self, base, members=(), reduced=None):
        self.base, self.members = base, tuple(members)
        edges = np.cumsum([0, *(m.width for m in self.members)])
        self.places = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        deviation = [np.where(m.unit > 0, m.scale * m.unit, 1.0) for m in self.members]
        self.prior = np.concatenate([np.zeros(0), *deviation]) ** -2.0
        self._B, self._H, self._q = self._moments() if reduced is None else reduced
        right = self._q - self.prior * self.applied
        S = self._H + np.diag(self.prior)
        self._factor = linalg.cholesky(S, lower=True) if right.size else S
        self._t = _solve(self._factor, right)
        self._coef = _solve(self._factor, self._t, turned=True)
        self.theta = _solve(base.L, base.t - self._B @ self._coef, turned=True)
        self._groups, self._evidence = WeakKeyDictionary(), WeakKeyDictionary()

    def _moments(self):
        """Products of the members' columns: B, H, and q."""
        own = [self.base.beside(m.columns) for m in self.members]
        B = np.hstack([np.zeros((self.base.L.shape[0], 0)), *(x.T for x in own)])
        H = -B.T @ B
        for j, (at, _, gram) in self._joint_terms.items():
            H[at[:, None], at] += np.tensordot(self.base.density[j], gram, 1)
        return B, H, np.concatenate([np.zeros(0), *(x.q[0] for x in own)])

    @functools.cached_property
    def _joint_terms(self):
        """Coefficients that act on each joint, and see `_joint_columns`, a dict."""
        found, numbers = {}, np.arange(len(self.prior))
        for place, member in zip(self.places, self.members):
            for j in member.joints:
                found.setdefault(j, []).append((numbers[place], member.columns))
        for j, own in found.items():
            places, columns = zip(*own)
            found[j] = np.concatenate(places), *self.problem.joint_columns(j, columns)
        return found

    @property
    def problem(self):
        """Equations."""
        return self.base.problem

    @property
    def explained(self):
        """What the members take off the error, priors included [nats]."""
        return 0.5 * float(self._t @ self._t)

    @functools.cached_property
    def excluded(self):
        """Keys of effects that exclude the members, a set."""
        return set().union(*(m.effect.excludes() for m in self.members))

    @property
    def n_coefficients(self):
        """Number of the members' coefficients."""
        return self._coef.size

    @functools.cached_property
    def residual(self):
        """Residuals of the cosines, (nv, n)."""
        return self.problem.y - self._sum(self.theta, self._coef)

    def _sum(self, theta, coef):
        """Sum of the columns with coefficients (r, ...) and (p, ...), (nv, n, ...)."""
        out = self.problem.Z @ theta
        for j, (at, X, _) in self._joint_terms.items():
            out[j] += X @ coef[at]
        return out

    @property
    def applied(self):
        """What of the coefficients the equations have already, (p,)."""
        return np.concatenate([np.zeros(0), *(m.applied for m in self.members)])

    def powers(self):
        """Residual powers and freedom left by joint and band, two (nv, n_bands)."""
        problem, base = self.problem, self.base
        cosines = problem.cosines
        edges, fill = cosines.edges, cosines.fill[:, None]
        power = np.add.reduceat(self.residual**2, edges[:-1], axis=1)
        # What the fit takes: products by band with the covariance of all coefficients.
        E = _solve(base.L, self._B, turned=True)
        covariance, cross = self.covariance, E @ self.covariance
        whole = base.inverse + cross @ E.T
        taken = np.tensordot(problem.gram, whole, 2)
        for j, (at, _, gram) in self._joint_terms.items():
            taken[j] += np.tensordot(gram, covariance[at[:, None], at], 2)
        for place, member in zip(self.places, self.members):
            own = member.columns.declared(problem.Z)
            taken[list(member.joints)] -= 2.0 * np.tensordot(own, cross[:, place], 2)
        taken *= base.density
        # What comes again with each phase is known no better for it.
        fill = fill / problem.view.repeats
        return fill * power, np.maximum(fill * np.diff(edges) - taken, 0.0)

    def groups(self, columns):
        """Second moments of the shapes of `Columns` beside this model, `Groups`."""
        if columns not in self._groups:
            own, (c, k) = self.base.beside(columns), columns.shape
            cross = self.base.cross_products(self.members, columns)
            D = _solve(self._factor, cross - self._B.T @ own.T)
            groups = Groups(
                H=own.H - _blocks(D, c, k),
                q=own.q - (self._t @ D).reshape(c, k),
                own=np.diagonal(own.gram, axis1=1, axis2=2),
                unit=columns.unit,
                positive=isinstance(columns.effects[0], Bank),
            )
            self._groups[columns] = groups, D
        return self._groups[columns][0]

    def evidence(self, columns, scale):
        """Log evidence (c,) of shapes beside this model; of a bank, at the most."""
        if columns not in self._evidence:
            self._evidence[columns] = self.groups(columns).most_evidence(scale)
        return self._evidence[columns]

    @functools.cached_property
    def scores(self):
        """Residuals in whitened rows (nv, m), with which scores are made."""
        white = self.residual * np.sqrt(self.base.weights)
        return self._rows(white)

    @property
    def weighted_rows(self):
        """Residuals times their precision (nv, m): products with rows are scores."""
        return self._rows(self.residual * self.base.weights)

    def _rows(self, cosines):
        """Rows of whitened cosines (nv, n, ...), zero where rows do not count."""
        found = self.problem.cosines.rows(cosines)
        used = (self.problem.view.root.T > 0) & self.problem.used_joints[:, None]
        return np.where(used.reshape(*used.shape, *(1,) * (found.ndim - 2)), found, 0.0)

    def overdispersion(self, columns, c, coef, noise):
        """Overdispersion of one shape's score beside this model."""
        # coef (k,): direction of its coefficients that counts; noise: the fit under the
        # same weights that leaves the noise.
        self.groups(columns)
        k = columns.shape[1]
        place = slice(c * k, (c + 1) * k)
        T = self.base.beside(columns).T[:, place] @ coef
        D = self._groups[columns][1][:, place] @ coef
        members = _solve(self._factor, D, turned=True)
        declared = _solve(self.base.L, T - self._B @ members, turned=True)
        left = -self._sum(declared, members)
        left[list(columns.joints)] += columns.values[:, :, c] @ coef
        return self._score_dispersions(left[:, :, None], [columns.effects[c]], noise)[0]

    def overdispersions(self, noise):
        """Overdispersion of each member's score given the others, a list."""
        if not self.members:
            return []
        # Their columns, less what the others explain of them, by the block inverse.
        C, directions = self.covariance, np.zeros((self._coef.size, len(self.members)))
        for i, (place, member) in enumerate(zip(self.places, self.members)):
            coef = self._coef[place] + member.applied
            directions[:, i] = C[:, place] @ np.linalg.solve(C[place, place], coef)
        theta = -_solve(self.base.L, self._B @ directions, turned=True)
        left = self._sum(theta, directions)
        return self._score_dispersions(left, [m.effect for m in self.members], noise)

    def _score_dispersions(self, left, effects, noise):
        """Overdispersion of scores by columns (nv, n, c) beside everything else."""
        # The variance of a score between blocks of time over that which its second
        # moments promise (the sandwich over the Hessian), at least one, with its
        # degrees of freedom. The variance of slow changes of the score counts where it
        # is larger: that of independent blocks is as large at all frequencies.
        white = left * np.sqrt(self.base.weights)[:, :, None]
        rows, less = self._rows(white), self.base.score_variance_ratio(white)
        power = np.einsum("jmc,jmc->mc", rows, rows)
        promised = power.sum(axis=0)
        products = np.einsum("jmc,jm->mc", rows, noise.scores)
        # What the column itself explains of the noise is none.
        products -= products.sum(axis=0) / np.maximum(promised, _TINY) * power
        view = self.problem.view
        spans = view.spans.sums(products)[view.span_order]
        phases = view.blocks.sums(products) if view.repetition else None
        found = []
        for c, effect in enumerate(effects):
            if not promised[c] > 0:
                found.append(Overdispersion())
                continue
            again = None if phases is None else phases[:, c] / np.sqrt(promised[c])
            scores = spans[:, c] / np.sqrt(promised[c])
            found.append(self._dispersion(scores, again, effect, noise, less[c]))
        return found

    def _dispersion(self, scores, again, effect, noise, least):
        """Overdispersion of scores of blocks, and of phases `again` if any."""
        power, slow = _score_powers(scores)
        usual, freedom = max(1.0, least, slow.mean(), power.mean()), np.inf
        if again is not None:
            # What is not modelled comes again with each phase, and there are few, of
            # which the fit that leaves the noise has taken as many as its parameters.
            again, late = _score_powers(again)
            used = self.problem.used_joints.sum()
            taken = (self.base.L.shape[0] + noise.n_coefficients) / used
            freedom = float(max(again.size - taken, 1.0))
            fewer = again.size / freedom
            usual = max(usual, fewer * late.mean(), fewer * again.mean())
        usual = float(usual)
        if not effect.slow:
            return Overdispersion(ratio=usual, freedom=freedom, usual=usual)
        # What changes with time is told by slow changes alone, and there are few.
        # Of these the effect has taken one, and one more if its course was searched.
        taken = 1 + bool(effect.continuous)
        left = power[:_SLOWEST].sum() / max(_SLOWEST - taken, 1)
        freedom = float(max(slow.size - taken, 1))
        ratio = float(max(usual, left))
        return Overdispersion(ratio=ratio, freedom=freedom, usual=usual)

    def with_held(self, held):
        """Return the same with other declared friction at zero, see `Problem`."""
        problem = self.problem
        made = problem.changed(held=np.broadcast_to(held, problem.held.shape))
        return Fit(self.base.on(made), self.members)

    def with_valid_signs(self, errors):
        """Return the same with declared friction at zero that would drive."""
        # errors: standard errors by which it is negative before it is held; once held,
        # what is left of it says which sign it would have.
        held, rows = self.problem.held, self.problem.view.one_sided
        ways = _solve(self.base.L, rows.reshape(held.size, -1).T)
        ties = _solve(self._factor, self._B.T @ ways)
        variance = (ways**2).sum(axis=0) + (ties**2).sum(axis=0)
        least = errors * np.sqrt(variance).reshape(held.shape)
        wrong = rows @ self.theta < np.where(held, 0.0, -least)
        # The elements of a bank stand for dry friction as well.
        banks = (m.effect for m in self.members if isinstance(m.effect, Bank))
        wrong[[bank.joint for bank in banks]] = False
        return self if (wrong == held).all() else self.with_held(wrong)

    @functools.cached_property
    def covariance(self):
        """Posterior covariance of the members' coefficients."""
        half = _solve(self._factor, np.eye(self._coef.size))
        return half.T @ half

    @functools.cached_property
    def member_groups(self):
        """Second moments of each member given the others, list of `Groups`."""
        # By the block inverse, without another fit.
        found = []
        for member, place in zip(self.members, self.places):
            inverse = np.linalg.inv(self.covariance[place, place])
            gram = self.base.beside(member.columns).gram
            groups = Groups(
                H=inverse[None] - np.diag(self.prior[place]),
                q=(inverse @ (self._coef[place] + member.applied))[None],
                own=np.diagonal(gram, axis1=1, axis2=2),
                unit=member.unit[None],
            )
            found.append(groups)
        return found

    def rescaled(self, scale):
        """Return the same with the most probable scale of each member."""
        scales = [float(own.best_scale(scale)[0]) for own in self.member_groups]
        members = [replace(m, scale=own) for m, own in zip(self.members, scales)]
        return Fit(self.base, members, (self._B, self._H, self._q))

    def log_evidence(self):
        """Logarithm of the evidence, but for a constant of the recording."""
        # Of members with their scales, and of the spectrum that the weights are from.
        problem, density = self.problem, self.base.density
        heard, cosines = problem.used_joints, problem.cosines
        count = cosines.fill[heard, None] * np.diff(cosines.edges)
        volume_of_noise = 0.5 * (count * np.log(density[heard])).sum()
        power = (density[heard] * problem.power[heard]).sum()
        power -= self.base.t @ self.base.t + self._t @ self._t
        power += self.prior @ self.applied**2
        volume = np.log(np.diagonal(self.base.L)).sum()
        volume += np.log(np.diagonal(self._factor)).sum()
        volume -= 0.5 * np.log(self.prior).sum()
        rest = 0.5 * power + volume - self.base.log_prior
        return float(volume_of_noise - rest)

    def coefficients(self, i):
        """Posterior mean of a member's coefficients, (k,)."""
        return self._coef[self.places[i]]

    def beside(self, member):
        """Fit with one more member."""
        return Fit(self.base, (*self.members, member))

    def without(self, i):
        """Fit without a member, to a robot that it has not corrected."""
        rest = *self.members[:i], *self.members[i + 1 :]
        base = self.base.without_correction(self.members[i])
        if base is not self.base:
            return Fit(base, rest)
        kept = np.delete(np.arange(self.n_coefficients), self.places[i])
        reduced = self._B[:, kept], self._H[np.ix_(kept, kept)], self._q[kept]
        return Fit(base, rest, reduced)


def declared_weights(problem):
    """Make the base under the weights of the joints in the fit of the robot."""
    return _uniform_base(problem, problem.view.precision * problem.cosines.fill)


def _uniform_base(problem, weights):
    """Make the base under one weight for each joint (nv,)."""
    bands = problem.cosines.octave.size
    return Base(problem, np.repeat(weights[:, None], bands, axis=1))


# Powers of the spectrum that weights may follow, from all of it to none.
_SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)


def spectrum_of(fit, settings, rounds=3, share=None):
    """Return a fit under weights by the spectrum of its residual."""
    # Such weights are best where the model is right. Where it is not, they follow the
    # largest power `share` (None: found) of the spectrum with which no joint's torque
    # differs from that by plain weights more than by chance (after J. Hausman,
    # Econometrica 46(6), 1978, doi 10.2307/1913827).
    if share is not None:
        return _spectral_fit(fit, settings, rounds, share)
    problem = fit.problem
    plain = with_joint_weights(Fit(declared_weights(problem), fit.members))
    most = _chance_limit(plain.base, _spectrum(plain, settings), settings.significance)
    for start, share in ((fit, 1.0), *((plain, own) for own in _SHARES)):
        found = _spectral_fit(start, settings, rounds, share)
        away = ((found.residual - plain.residual) ** 2).sum(axis=1)
        if (away <= most)[problem.used_joints].all():
            break
    return found


def _spectral_fit(fit, settings, rounds, share):
    """Return a fit under weights by a power of the spectrum of its residual."""
    problem = fit.problem
    for _ in range(rounds):
        spectrum = _spectrum(fit, settings)
        weights = spectrum.weights(problem.cosines, share)
        new = Fit(Base(problem, weights, spectrum, share), fit.members)
        # A band that the fit follows ever closer would weigh ever more.
        if fit.base.share == share and new.log_evidence() < fit.log_evidence():
            break
        fit = new
    return fit


def _spectrum(fit, settings):
    """Spectrum of the residual of a fit."""
    power, freedom = fit.powers()
    octave = fit.problem.cosines.octave
    return Spectrum.of(power, freedom, octave, settings.spectrum_roughness)


def _chance_limit(plain, spectrum, chance):
    """How far (nv,) right weights lead from plain ones by chance, a square sum."""
    # They scatter less than plain ones, from which they differ by less than these do:
    # the mean of that, and so many deviations.
    problem = plain.problem
    power = plain.density**2 * spectrum.noise(problem.cosines)
    scatter = plain.inverse @ np.tensordot(power, problem.gram, 2) @ plain.inverse
    own = problem.gram.sum(axis=1) @ scatter
    deviation = np.sqrt(2.0 * np.einsum("jpq,jqp->j", own, own))
    return np.einsum("jpp->j", own) + chance * deviation


def with_joint_weights(fit):
    """Return a fit under one weight for each joint, by its residual."""
    problem = fit.problem
    power = (fit.residual**2).mean(axis=1)
    heard = problem.used_joints & (power > 0)
    own = np.where(heard, problem.cosines.fill / np.where(heard, power, 1.0), 0.0)
    return Fit(_uniform_base(problem, own), fit.members)
