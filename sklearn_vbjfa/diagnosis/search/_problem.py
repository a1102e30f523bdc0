"""Regression of all joints in the frequency domain, with groups of effects."""

import copy
import functools
import itertools
from collections import namedtuple
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy import fft, linalg
from scipy.linalg import lapack

from sklearn_vbjfa._core._groups import Groups, Overdispersion
from sklearn_vbjfa._core._linear_systems import or_one
from sklearn_vbjfa.diagnosis.search._cosines import Cosines, Spectrum
from sklearn_vbjfa.effects import Bank, InModel


def band_products(edges, left, right):
    """Compute products of columns (n, ...) in each frequency band, (n_bands, p, q)."""
    left, right = left.reshape(len(left), -1), right.reshape(len(right), -1)
    return np.array([left[a:b].T @ right[a:b] for a, b in itertools.pairwise(edges)])


# The slowest quarter of a score's cosines counts as slow; number of the slowest ones.
_SLOW, _SLOWEST = 4, 4
_TINY = np.finfo(float).tiny
# Ridge of the declared columns, relative to their squared norms, against rounding.
_RIDGE = 1e-9
# Prior precision of a term fixed at zero, relative to its precision by the data.
_ZERO_PRECISION = 1e6


class Columns:
    """Columns of an effect with c shapes, as cosines; up to k columns per shape."""

    # effects (c,): the effect with each shape; joints: those it acts on; values (nj, n,
    # c, k): cosines, sorted by band; unit (c, k): see `Groups`, zero for columns of
    # zeros; shape: (c, k); edges: see `Problem`; load: motion with their load.

    def __init__(self, effects, joints, values, unit, edges, load=None):
        self.effects, self.joints, self.load = tuple(effects), tuple(joints), load
        self.values, self.unit, self.edges = values, unit, edges
        self.shape = unit.shape
        # by the number of dimensions of the argument of `products`: it, and the result
        self._products = {}

    @functools.cached_property
    def gram(self):
        """Gram matrices by band and shape, (nj, n_bands, c, k, k)."""
        X = np.ascontiguousarray(self.values.swapaxes(1, 2))
        bands = [X[:, :, a:b] for a, b in itertools.pairwise(self.edges)]
        return np.stack([x.swapaxes(-1, -2) @ x for x in bands], axis=1)

    def products(self, target):
        """Compute products with cosines (nv, n, ...), (nj, n_bands, ..., c * k)."""
        # Cached, as targets are the declared columns or the torques of the problem.
        known, products = self._products.get(target.ndim, (None, None))
        if known is not target:
            pairs = zip(self.joints, self.values)
            products = [band_products(self.edges, target[j], X) for j, X in pairs]
            products = np.array(products)
            self._products[target.ndim] = target, products
        return products

    @functools.cached_property
    def keys(self):
        """Keys of the effects."""
        return tuple(effect.key() for effect in self.effects)

    @functools.cached_property
    def simple(self):
        """Which shapes are preferred to others that are not more probable, (c,)."""
        return np.array([effect.simple for effect in self.effects])

    def member(self, c=0, scale=1.0):
        """Return one of the shapes as a `SelectedEffect`."""
        k, columns = len(self.effects[c].coefficients), self
        if self.shape != (1, k):
            values = np.ascontiguousarray(self.values[:, :, c : c + 1, :k])
            unit = self.unit[c : c + 1, :k]
            arguments = self.joints, values, unit, self.edges, self.load
            columns = Columns(self.effects[c : c + 1], *arguments)
        return SelectedEffect(columns=columns, scale=scale)


@dataclass(kw_only=True, eq=False)
class SelectedEffect:
    """An effect of the model (a member), with one shape."""

    # joints on which it acts; unit (k,): coefficients for which each column is as large
    # as the joint torque; width: number k of columns
    columns: Columns
    scale: float = 1.0  # prior standard deviation of its coefficients over `unit`

    def __post_init__(self):
        columns = self.columns
        self.effect, self.joints = columns.effects[0], columns.joints
        self.unit, self.width = columns.unit[0], columns.unit[0].size

    @functools.cached_property
    def applied(self):
        """Part of its coefficients that the robot model already contains, (k,)."""
        if not isinstance(self.effect, InModel):
            return np.zeros(self.width)
        return self.effect.values - np.asarray(self.effect.nominal)


def _joint_columns(joint, columns):
    """Stack the columns (n, p) of members on a joint, with Gram matrices by band."""
    X = np.hstack([x.values[x.joints.index(joint), :, 0] for x in columns])
    return X, band_products(columns[0].edges, X, X)


class Problem:
    """Equations of all joints as cosines: declared columns and torques."""

    # Z (nv, n, r), y (nv, n): cosines of the declared columns and of the torques,
    # sorted by band; edges (n_bands + 1,): bounds of the bands; torque (nv,): standard
    # deviation of the torque in weighted rows; motion: signals from which columns are
    # computed; at_zero (nv, n_terms): nonnegative friction terms that are fixed at 0.

    motion = None

    def __init__(self, view, cosines=None):
        self.view = view
        self.cosines = Cosines(view) if cosines is None else cosines
        self.edges = self.cosines.edges
        joints = range(view.nv)
        self.Z, self.y = self.cosines(view.Z, joints), self.cosines(view.target, joints)
        rows = np.maximum(view.rows, _TINY)
        mean = (view.target * view.root.T).sum(axis=1) / rows
        varying = view.target - mean[:, None] * view.root.T
        self.torque = np.sqrt((varying**2).sum(axis=1) / view.target.shape[1])
        self.used_joints = view.precision > 0
        self.at_zero = np.zeros(view.one_sided.shape[:2], dtype=bool)
        # Cached: most joints of consecutive fits have the same members.
        self.joint_columns = functools.lru_cache(_joint_columns)

    @functools.cached_property
    def gram(self):
        """Gram matrices of the declared columns, (nv, n_bands, r, r)."""
        return np.array([band_products(self.edges, Z, Z) for Z in self.Z])

    @functools.cached_property
    def rhs(self):
        """Products of the declared columns with the torques, (nv, n_bands, r)."""
        pairs = zip(self.Z, self.y)
        return np.array([band_products(self.edges, Z, y)[:, :, 0] for Z, y in pairs])

    @functools.cached_property
    def power(self):
        """Sums of squared torques, (nv, n_bands)."""
        return np.add.reduceat(self.y**2, self.edges[:-1], axis=1)

    def changed(self, **values):
        """Return a copy with other torques `y`, `motion` or terms `at_zero`."""
        problem = copy.copy(self)
        vars(problem).update(values)
        # Products that depend on the torques become invalid.
        for name in ("rhs", "power") if "y" in values else ():
            vars(problem).pop(name, None)
        return problem

    def columns(self, effects):
        """Return `Columns` of an effect with several shapes, list of Effect."""
        view, joints = self.view, effects[0].acts_on(self.view.nv)
        # All that the columns depend on except the load.
        uses = ((type(e), *sorted(e.get_params(deep=False).items())) for e in effects)
        key = *view.gains[joints], *self.torque[joints], *uses
        load = self.motion if any("load" in e.needs for e in effects) else None
        columns = view.cache.get(key)
        if columns is None or columns.load is not load:
            rows = view.columns(effects, self.motion)
            size = np.sqrt((rows**2).mean(axis=1)).transpose(1, 2, 0)
            # The unit of an effect on several joints is that of the most affected one.
            torque = self.torque[joints]
            largest = (size * ((torque > 0) / or_one(torque))).max(axis=2)
            unit = (largest > 0) / or_one(largest)
            values = self.cosines(rows, joints)
            columns = Columns(effects, joints, values, unit, self.edges, load)
        return view.keep(key, columns)

    def shapes(self, effect, first=False):
        """Return an effect with all shapes of its grid, or the first ones to try."""
        shapes = effect.first_shapes if first else effect.shapes
        kind, parameters = type(effect), effect.get_params(deep=False)
        return [kind(**parameters | shape) for shape in shapes(self.motion)]


def _solve(L, rhs, transposed=False):
    """Solve a lower triangular system (r, ...), or the transposed one."""
    # The checks of `linalg.solve_triangular` take longer than such small systems.
    if not rhs.size:
        # LAPACK rejects empty systems.
        return np.zeros(rhs.shape)
    solution, _ = lapack.dtrtrs(L, rhs, lower=1, trans=int(transposed))
    return solution if rhs.ndim > 1 else solution.ravel()


def precision_at_zero(gram, rows):
    """Return the prior precision (r, r) that fixes sums `rows` (h, r) at zero."""
    # gram (r, r): precision of the coefficients by the data.
    power = (_solve(linalg.cholesky(gram, lower=True), rows.T) ** 2).sum(axis=0)
    return (_ZERO_PRECISION / power * rows.T) @ rows


class DeclaredFit:
    """Weighted regression on the declared columns, and moments of effects given it."""

    # density (nv, n_bands): weights of the cosines of each band, by the power `share`
    # of `spectrum` if that is not None; L (r, r): lower Cholesky factor of the Gram
    # matrix; t (r,): L^-1 times the products with the torques.

    def __init__(self, problem, density, spectrum=None, share=1.0):
        self.problem, self.density = problem, density
        self.spectrum, self.share = spectrum, share
        G = np.tensordot(density, problem.gram, 2)
        # Relative to each column: weights scale some a thousand times more than others.
        G += np.diag(_RIDGE * np.maximum(np.diagonal(G), 1.0))
        if problem.at_zero.any():
            G += precision_at_zero(G, problem.view.one_sided[problem.at_zero])
        self.L = linalg.cholesky(G, lower=True)
        self.t = _solve(self.L, np.tensordot(density, problem.rhs, 2))
        self._cache, self._cross_cache = WeakKeyDictionary(), WeakKeyDictionary()

    @property
    def log_prior(self):
        """Log prior density of the spectrum, up to a constant."""
        return 0.0 if self.spectrum is None else self.spectrum.log_prior

    def on(self, problem):
        """Apply the weights to other equations."""
        kept = ("Z", "y", "at_zero")
        if any(getattr(problem, x) is not getattr(self.problem, x) for x in kept):
            return DeclaredFit(problem, self.density, self.spectrum, self.share)
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
        """Return the score variance by the spectrum relative to the weights."""
        # white (nv, n): weighted columns.
        if self.spectrum is None:
            return 1.0
        power = np.add.reduceat(white**2, self.problem.edges[:-1], axis=1)
        noise = self.density * self.spectrum.noise(self.problem.cosines)
        return (noise * power).sum() / max(power.sum(), _TINY)

    def without_correction(self, member):
        """Undo a member's correction of the torques, to first order."""
        applied = member.applied
        if not applied.any():
            return self
        y = self.problem.y.copy()
        for j, values in zip(member.joints, member.columns.values):
            y[j] += values[:, 0] @ applied
        return self.on(self.problem.changed(y=y))

    def weighted(self, joints, products):
        """Sum products (nj, n_bands, ...) over joints and bands with their weights."""
        density = self.density[list(joints)].ravel()
        total = density @ products.reshape(density.size, -1)
        return total.reshape(products.shape[2:])

    def reduced_moments(self, columns):
        """Return the moments of `Columns` given the declared ones."""
        if columns not in self._cache:
            joints, (c, k) = columns.joints, columns.shape
            T = _solve(self.L, self.weighted(joints, columns.products(self.problem.Z)))
            rhs = self.weighted(joints, columns.products(self.problem.y))[0]
            gram = self.weighted(joints, columns.gram)
            H, q = gram - _blocks(T, c, k), (rhs - self.t @ T).reshape(c, k)
            self._cache[columns] = ReducedMoments(T=T, gram=gram, H=H, q=q)
        return self._cache[columns]

    def cross_products(self, members, columns):
        """Compute weighted products of members' columns with others, (p, c * k)."""
        cache = self._cross_cache.setdefault(columns, WeakKeyDictionary())
        for left in (m.columns for m in members if m.columns not in cache):
            cache[left] = np.zeros((left.unit.size, columns.unit.size))
            for j in set(left.joints).intersection(columns.joints):
                X = left.values[left.joints.index(j), :, 0] * self.weights[j][:, None]
                other = columns.values[columns.joints.index(j)]
                cache[left] += X.T @ other.reshape(len(other), -1)
        empty = np.zeros((0, columns.unit.size))
        return np.vstack([empty, *(cache[m.columns] for m in members)])


# Moments of c groups of k columns: T (r, c * k), L^-1 times products with the declared
# columns; Gram matrices, and their Schur complements H, (c, k, k); q (c, k), products
# with the residual of the declared columns.
ReducedMoments = namedtuple("ReducedMoments", "T gram H q")


def _blocks(T, c, k):
    """Compute the diagonal blocks of T' T, (c, k, k)."""
    by_group = T.reshape(-1, c, k).transpose(1, 2, 0)
    return by_group @ by_group.transpose(0, 2, 1)


def _score_powers(scores):
    """Return the power spectrum of scores (n,) without mean, and its slow part."""
    power = fft.dct(scores, norm="ortho")[1:] ** 2 * len(scores)
    return power, power[: max(len(power) // _SLOW, 1)]


class Fit:
    """Model of all joints' torques with effects as members, under given weights."""

    # base: declared columns under these weights; theta (r,): their posterior mean;
    # slices: coefficients of each member; prior (p,): their prior precision; applied
    # (p,): part in the robot model. B (r, p), H (p, p), q (p,): see `ReducedMoments`,
    # of the members' columns.

    def __init__(self, base, members=()):
        self.base, self.problem, self.members = base, base.problem, tuple(members)
        edges = np.cumsum([0, *(m.width for m in self.members)])
        self.slices = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        deviation = [np.where(m.unit > 0, m.scale * m.unit, 1.0) for m in self.members]
        self.prior = np.concatenate([np.zeros(0), *deviation]) ** -2.0
        applied = (m.applied for m in self.members)
        self.applied = np.concatenate([np.zeros(0), *applied])
        self._B, self._H, self._q = self._moments()
        rhs = self._q - self.prior * self.applied
        S = self._H + np.diag(self.prior)
        self._factor = linalg.cholesky(S, lower=True) if rhs.size else S
        self._t = _solve(self._factor, rhs)
        self._coef = _solve(self._factor, self._t, transposed=True)
        self.theta = _solve(base.L, base.t - self._B @ self._coef, transposed=True)
        self._groups = WeakKeyDictionary()

    def _moments(self):
        """Compute B, H and q of the members' columns."""
        moments = [self.base.reduced_moments(m.columns) for m in self.members]
        B = np.hstack([np.zeros((self.base.L.shape[0], 0)), *(x.T for x in moments)])
        H = -B.T @ B
        for j, (at, _, gram) in self._joint_terms.items():
            H[at[:, None], at] += np.tensordot(self.base.density[j], gram, 1)
        return B, H, np.concatenate([np.zeros(0), *(x.q[0] for x in moments)])

    @functools.cached_property
    def _joint_terms(self):
        """Indices of coefficients, columns and Gram matrices by joint, a dict."""
        terms, indices = {}, np.arange(len(self.prior))
        for place, member in zip(self.slices, self.members):
            for j in member.joints:
                terms.setdefault(j, []).append((indices[place], member.columns))
        for j, columns_of in terms.items():
            parts, columns = zip(*columns_of)
            terms[j] = np.concatenate(parts), *self.problem.joint_columns(j, columns)
        return terms

    @property
    def explained(self):
        """Reduction of the penalised squared error by the members [nats]."""
        return 0.5 * float(self._t @ self._t)

    @functools.cached_property
    def excluded(self):
        """Keys of effects that are incompatible with the members, a set."""
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
        """Multiply columns by coefficients (r, ...) and (p, ...), (nv, n, ...)."""
        out = self.problem.Z @ theta
        for j, (at, X, _) in self._joint_terms.items():
            out[j] += X @ coef[at]
        return out

    def powers(self):
        """Compute residual powers and degrees of freedom, two arrays (nv, n_bands)."""
        problem, base = self.problem, self.base
        cosines = problem.cosines
        edges, fill = cosines.edges, cosines.fill[:, None]
        power = np.add.reduceat(self.residual**2, edges[:-1], axis=1)
        # Effective parameters by band: trace of Gram matrix times covariance.
        E = _solve(base.L, self._B, transposed=True)
        covariance, cross = self.covariance, E @ self.covariance
        theta_covariance = base.inverse + cross @ E.T
        dof = np.tensordot(problem.gram, theta_covariance, 2)
        for j, (at, _, gram) in self._joint_terms.items():
            dof[j] += np.tensordot(gram, covariance[at[:, None], at], 2)
        for index, member in zip(self.slices, self.members):
            ZX = member.columns.products(problem.Z)
            dof[list(member.joints)] -= 2.0 * np.tensordot(ZX, cross[:, index], 2)
        dof *= base.density
        # Repetitions of a motion add no information on unmodelled torque.
        fill = fill / problem.view.repeats
        return fill * power, np.maximum(fill * np.diff(edges) - dof, 0.0)

    def groups(self, columns):
        """Return second moments of shapes (`Columns`) given the model, `Groups`."""
        if columns not in self._groups:
            moments, (c, k) = self.base.reduced_moments(columns), columns.shape
            cross = self.base.cross_products(self.members, columns)
            D = _solve(self._factor, cross - self._B.T @ moments.T)
            groups = Groups(
                H=moments.H - _blocks(D, c, k),
                q=moments.q - (self._t @ D).reshape(c, k),
                norms=np.diagonal(moments.gram, axis1=1, axis2=2),
                unit=columns.unit,
                positive=isinstance(columns.effects[0], Bank),
            )
            self._groups[columns] = groups, D
        return self._groups[columns][0]

    @functools.cached_property
    def scores(self):
        """Whitened residuals in time (nv, m), for the scores."""
        white = self.residual * np.sqrt(self.base.weights)
        return self._rows(white)

    @property
    def weighted_rows(self):
        """Residuals times weights in time (nv, m); products with rows are scores."""
        return self._rows(self.residual * self.base.weights)

    def _rows(self, cosines):
        """Transform cosines (nv, n) to rows in time, zero where unweighted."""
        used = (self.problem.view.root.T > 0) & self.problem.used_joints[:, None]
        return np.where(used, self.problem.cosines.rows(cosines), 0.0)

    def overdispersion(self, columns, c, coef, noise):
        """Compute the overdispersion of one shape's score given the model."""
        # coef (k,): direction of its coefficients; noise: the fit under the same
        # weights whose residual is the noise.
        self.groups(columns)
        k = columns.shape[1]
        at = slice(c * k, (c + 1) * k)
        T = self.base.reduced_moments(columns).T[:, at] @ coef
        D = self._groups[columns][1][:, at] @ coef
        member_coef = _solve(self._factor, D, transposed=True)
        theta = _solve(self.base.L, T - self._B @ member_coef, transposed=True)
        X = -self._sum(theta, member_coef)
        X[list(columns.joints)] += columns.values[:, :, c] @ coef
        return self._overdispersion(X, columns.effects[c], noise)

    def overdispersions(self, noise):
        """Compute the overdispersion of each member's score given the others."""
        # Residuals of their columns given the others, by the block inverse.
        C, directions = self.covariance, np.zeros((self._coef.size, len(self.members)))
        for i, (at, member) in enumerate(zip(self.slices, self.members)):
            coef = self._coef[at] + member.applied
            directions[:, i] = C[:, at] @ np.linalg.solve(C[at, at], coef)
        theta = -_solve(self.base.L, self._B @ directions, transposed=True)
        pairs = zip(np.moveaxis(self._sum(theta, directions), 2, 0), self.members)
        return [self._overdispersion(X, m.effect, noise) for X, m in pairs]

    def _overdispersion(self, column, effect, noise):
        """Compute the overdispersion of the score of a residualised column (nv, n)."""
        # The variance of the score between blocks of time over its expectation by the
        # second moments (the sandwich over the Hessian), at least one, with its degrees
        # of freedom. The variance at low frequencies counts if it is larger;
        # independent blocks have a white spectrum.
        white = column * np.sqrt(self.base.weights)
        rows, ratio = self._rows(white), self.base.score_variance_ratio(white)
        power = (rows**2).sum(axis=0)
        expected = max(power.sum(), _TINY)
        products = (rows * noise.scores).sum(axis=0)
        # Remove the part of the noise that the column itself explains.
        products -= products.sum() / expected * power
        products /= np.sqrt(expected)
        view, freedom = self.problem.view, np.inf
        power, slow = _score_powers(view.spans.sums(products)[view.spans.sequence])
        usual = max(1.0, ratio, power.mean(), slow.mean())
        if view.repetition:
            # Unmodelled torque repeats with the phase; the noise fit used up as many of
            # the few phases as it has parameters.
            phases, slow_phases = _score_powers(view.blocks.sums(products))
            n_used = self.problem.used_joints.sum()
            used_dof = (self.base.L.shape[0] + noise.n_coefficients) / n_used
            freedom = float(max(len(phases) - used_dof, 1.0))
            repeated = max(phases.mean(), slow_phases.mean())
            usual = max(usual, len(phases) / freedom * repeated)
        ratio = usual
        if effect.slow:
            # Functions of time compete with the few slowest changes, of which the
            # effect used one, and one more if its time course was searched.
            used_dof = 1 + bool(effect.continuous)
            slowest = power[:_SLOWEST].sum() / max(_SLOWEST - used_dof, 1)
            ratio, freedom = max(usual, slowest), max(len(slow) - used_dof, 1)
        values = {"ratio": ratio, "freedom": freedom, "usual": usual}
        return Overdispersion(**{name: float(x) for name, x in values.items()})

    def with_zeros(self, mask):
        """Fix other declared friction terms at zero, see `Problem`."""
        problem = self.problem
        mask = np.broadcast_to(mask, problem.at_zero.shape)
        changed = problem.changed(at_zero=mask)
        return Fit(self.base.on(changed), self.members)

    def with_valid_signs(self, errors):
        """Fix declared friction terms at zero that would be negative."""
        # errors: standard errors below zero from which a term is fixed; the small
        # remainder of a fixed term shows the sign that it would have.
        at_zero, rows = self.problem.at_zero, self.problem.view.one_sided
        declared = _solve(self.base.L, rows.reshape(at_zero.size, -1).T)
        coupled = _solve(self._factor, self._B.T @ declared)
        variance = (declared**2).sum(axis=0) + (coupled**2).sum(axis=0)
        tolerance = errors * np.sqrt(variance).reshape(at_zero.shape)
        wrong = rows @ self.theta < np.where(at_zero, 0.0, -tolerance)
        # Elements of a bank include the dry friction of their joint.
        banks = (m.effect for m in self.members if isinstance(m.effect, Bank))
        wrong[[bank.joint for bank in banks]] = False
        return self if (wrong == at_zero).all() else self.with_zeros(wrong)

    @functools.cached_property
    def covariance(self):
        """Posterior covariance of the members' coefficients."""
        half = _solve(self._factor, np.eye(self._coef.size))
        return half.T @ half

    @functools.cached_property
    def member_groups(self):
        """Second moments of each member given the others, list of `Groups`."""
        # The block inverse replaces a fit without each member.
        result = []
        for member, at in zip(self.members, self.slices):
            inverse = np.linalg.inv(self.covariance[at, at])
            gram = self.base.reduced_moments(member.columns).gram
            groups = Groups(
                H=inverse[None] - np.diag(self.prior[at]),
                q=(inverse @ (self._coef[at] + member.applied))[None],
                norms=np.diagonal(gram, axis1=1, axis2=2),
                unit=member.unit[None],
            )
            result.append(groups)
        return result

    def log_evidence(self):
        """Compute the log evidence, up to a constant of the recording."""
        # Given the members' scales; includes the prior of the spectrum.
        problem, density = self.problem, self.base.density
        used, cosines = problem.used_joints, problem.cosines
        count = cosines.fill[used, None] * np.diff(cosines.edges)
        log_det_noise = 0.5 * (count * np.log(density[used])).sum()
        power = (density[used] * problem.power[used]).sum()
        power -= self.base.t @ self.base.t + self._t @ self._t
        power += self.prior @ self.applied**2
        log_det = np.log(np.diagonal(self.base.L)).sum()
        log_det += np.log(np.diagonal(self._factor)).sum()
        log_det -= 0.5 * np.log(self.prior).sum()
        cost = 0.5 * power + log_det - self.base.log_prior
        return float(log_det_noise - cost)

    def coefficients(self, i):
        """Return the posterior mean of a member's coefficients, (k,)."""
        return self._coef[self.slices[i]]

    def with_member(self, member):
        """Return the fit with one more member."""
        return Fit(self.base, (*self.members, member))

    def without(self, i):
        """Return the fit without a member, and without its correction of the robot."""
        members = *self.members[:i], *self.members[i + 1 :]
        return Fit(self.base.without_correction(self.members[i]), members)


def fit_uniform(problem, weights, members=()):
    """Fit under one weight per joint (nv,), for rows that all have weight."""
    density = (weights * problem.cosines.fill)[:, None]
    bands = problem.cosines.octave.size
    return Fit(DeclaredFit(problem, np.repeat(density, bands, axis=1)), members)


def with_joint_weights(fit):
    """Refit under one weight per joint, by its residual."""
    problem = fit.problem
    power = (fit.residual**2).mean(axis=1)
    used = problem.used_joints & (power > 0)
    weights = np.where(used, 1.0 / np.where(used, power, 1.0), 0.0)
    return fit_uniform(problem, weights, fit.members)


# Exponents of the spectrum for the weights, from full to no spectral weighting.
_SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)


def spectrum_of(fit, settings):
    """Refit under weights by the spectrum of the residual."""
    # Spectral weights are efficient if the model is correct. Otherwise use the largest
    # exponent for which no joint's predicted torque differs from that by flat weights
    # more than by chance (after J. Hausman, Econometrica 46(6), 1978, doi
    # 10.2307/1913827).
    problem = fit.problem
    flat = fit_uniform(problem, problem.view.precision, fit.members)
    flat = with_joint_weights(flat)
    limit = _chance_limit(flat.base, _spectrum(flat, settings), settings.significance)
    for start, share in ((fit, 1.0), *((flat, x) for x in _SHARES)):
        estimate = spectral_fit(start, settings, share)
        distance = ((estimate.residual - flat.residual) ** 2).sum(axis=1)
        if (distance <= limit)[problem.used_joints].all():
            break
    return estimate


def spectral_fit(fit, settings, share, rounds=3):
    """Refit under weights by a power of the residual's spectrum."""
    problem = fit.problem
    for _ in range(rounds):
        spectrum = _spectrum(fit, settings)
        weights = spectrum.weights(problem.cosines, share)
        new = Fit(DeclaredFit(problem, weights, spectrum, share), fit.members)
        # Stop: a band that is fitted ever closer would get ever more weight.
        if fit.base.share == share and new.log_evidence() < fit.log_evidence():
            break
        fit = new
    return fit


def _spectrum(fit, settings):
    """Estimate the spectrum of a fit's residual."""
    power, freedom = fit.powers()
    octave = fit.problem.cosines.octave
    return Spectrum.of(power, freedom, octave, settings.spectrum_roughness)


def _chance_limit(flat, spectrum, significance):
    """Bound the squared torque differences (nv,) of weightings by chance."""
    # Efficient estimates differ from those by flat weights by less than the latter
    # scatter: the mean of that scatter plus `significance` standard deviations.
    problem = flat.problem
    power = flat.density**2 * spectrum.noise(problem.cosines)
    C = flat.inverse @ np.tensordot(power, problem.gram, 2) @ flat.inverse
    M = problem.gram.sum(axis=1) @ C
    deviation = np.sqrt(2.0 * np.einsum("jpq,jqp->j", M, M))
    return np.einsum("jpp->j", M) + significance * deviation
