"""The regression of all joints in frequency, with some groups of effects."""

import copy
import functools
import itertools
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy import fft, linalg
from scipy.linalg import lapack

from sklearn_vbjfa._core._groups import Groups, Overdispersion
from sklearn_vbjfa.diagnosis.search._cosines import Cosines, Spectrum
from sklearn_vbjfa.diagnosis.search._view import root_mean_square, variants
from sklearn_vbjfa.effects import Effect, Shaped


def products(edges, one, other):
    """Products of columns (n, ...) and (n, ...) in each band, (n_bands, p, q)."""
    one, other = one.reshape(len(one), -1), other.reshape(len(other), -1)
    return np.array([one[a:b].T @ other[a:b] for a, b in itertools.pairwise(edges)])


class _Torques:
    """What products with some torques are known by."""


class Declared:
    """Declared columns and torques of all joints, in bands or blocks."""

    # Z (nv, n, r) and y (nv, n) are sorted by band; edges (n_bands + 1,): where each
    # begins, and the last one ends.

    def __init__(self, Z, y, edges):
        self.Z, self.y, self.edges = Z, y, edges
        self.columns_known, self.torques_known = _Torques(), _Torques()

    @functools.cached_property
    def gram(self):
        """Products of the columns by joint and band, (nv, n_bands, r, r)."""
        return np.array([products(self.edges, Z, Z) for Z in self.Z])

    @functools.cached_property
    def right(self):
        """Products of these with the torques, (nv, n_bands, r)."""
        pairs = zip(self.Z, self.y)
        return np.array([products(self.edges, Z, y)[:, :, 0] for Z, y in pairs])

    @functools.cached_property
    def power(self):
        """Square sums of the torques, (nv, n_bands)."""
        return np.add.reduceat(self.y**2, self.edges[:-1], axis=1)

    def with_torques(self, y):
        """Return the same columns with other torques."""
        made = copy.copy(self)
        made.y, made.torques_known = y, _Torques()
        # What is made of the columns alone stays.
        for name in ("right", "power"):
            made.__dict__.pop(name, None)
        return made


class Moments:
    """Products of c groups of k columns with others, made when they are asked for."""

    # columns (nj, n, c, k), sorted by band, act on `joints`; edges: see `Declared`.

    def __init__(self, joints, columns, edges):
        self.joints, self.columns, self.edges = joints, columns, edges
        self._declared, self._right = WeakKeyDictionary(), WeakKeyDictionary()
        self._groups = {}

    def of(self, columns):
        """Return those of other columns of the same joints."""
        return Moments(self.joints, columns, self.edges)

    def group(self, c, k):
        """Return those of the first k columns of one group."""
        if (c, k) not in self._groups:
            own = np.ascontiguousarray(self.columns[:, :, c : c + 1, :k])
            self._groups[c, k] = self.of(own)
        return self._groups[c, k]

    @functools.cached_property
    def gram(self):
        """With themselves, group by group, (nj, n_bands, c, k, k)."""
        k = self.columns.shape[3]
        found = np.empty((len(self.joints), self.edges.size - 1, *self.shape, k))
        for a, b in itertools.product(range(k), repeat=2):
            square = self.columns[..., a] * self.columns[..., b]
            found[..., a, b] = np.add.reduceat(square, self.edges[:-1], axis=1)
        return found

    @property
    def shape(self):
        """Number of groups, and of columns in each, (c, k)."""
        return self.columns.shape[2:]

    def declared(self, of):
        """With the `Declared` columns of their joints, (nj, n_bands, r, c * k)."""
        if of.columns_known not in self._declared:
            pairs = zip(self.joints, self.columns)
            self._declared[of.columns_known] = np.array(
                [products(self.edges, of.Z[j], own) for j, own in pairs]
            )
        return self._declared[of.columns_known]

    def right(self, of):
        """With the torques of their joints, (nj, n_bands, c * k)."""
        if of.torques_known not in self._right:
            pairs = zip(self.joints, self.columns)
            self._right[of.torques_known] = np.array(
                [products(self.edges, of.y[j], own)[:, 0] for j, own in pairs]
            )
        return self._right[of.torques_known]


# One in so many cosines of the scores is slow; and the slowest of them.
_SLOW, _SLOWEST = 4, 4
_TINY = np.finfo(float).tiny
# Ridge of the rigid bodies and plain terms, over the square sum of a column: rounding.
_RIDGE = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """Columns of an effect in frequency."""

    moments: Moments  # (nj, n, c, k): of them, not weighted
    # see `Groups`, of one shape (k,) or of each (c, k); zero for columns of zeros
    unit: np.ndarray

    @property
    def joints(self):
        """Joints that they act on, tuple of int."""
        return self.moments.joints

    @property
    def columns(self):
        """Their cosines (nj, n, c, k)."""
        return self.moments.columns


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectedEffect(Columns):
    """An effect in the model, with one shape."""

    effect: Effect  # with its shape
    scale: float = 1.0  # prior deviation of its coefficients, in units

    @property
    def width(self):
        """Number of columns."""
        return self.unit.size

    @functools.cached_property
    def done(self):
        """What of its coefficients the equations have already, (k,)."""
        if not self.effect.in_model:
            return np.zeros(self.width)
        return self.effect.values - np.asarray(self.effect.nominal)


class Problem(Declared):
    """Weighted equations of all joints in frequency."""

    # cosines: of the rows of `view`, where they are there already; Z, y, (nv, n, r) and
    # (nv, n): those of the declared columns and of the torques; torque (nv,): root mean
    # square of the varying torque in weighted rows.

    # motion: signals from which columns are made, with the load; None before a fit.

    motion = None

    def __init__(self, view, cosines=None):
        self.view = view
        self.cosines = Cosines(view) if cosines is None else cosines
        joints = range(view.nv)
        Z, y = self.cosines(view.Z, joints), self.cosines(view.target, joints)
        super().__init__(Z, y, self.cosines.edges)
        rows = np.maximum(view.rows, np.finfo(float).tiny)
        mean = (view.target * view.root.T).sum(axis=1) / rows
        rest = view.target - mean[:, None] * view.root.T
        self.torque = np.sqrt((rest**2).sum(axis=1) / view.target.shape[1])
        self.used_joints = view.precision > 0

    def with_motion(self, motion):
        """Return the same equations with other signals."""
        made = copy.copy(self)
        made.motion = motion
        return made

    def family(self, effect):
        """Return an effect with the shapes to begin with; None if there are none."""
        effects, cosines, size = self.view.family(effect, self.motion, self.cosines)
        if not effects:
            return None
        joints = tuple(self.view.joints_of(effect))
        moments = Moments(joints, cosines, self.edges)
        return Family.in_frequency(self, effects, moments, size)

    def variants(self, effect, first=False):
        """Return an effect with each shape of its grid, or the first ones, list."""
        shapes = effect.first_shapes if first else effect.shapes
        return variants(effect, shapes(self.motion))

    def shaped(self, effects):
        """Return some shapes of an effect as a `Family`."""
        joints = tuple(self.view.joints_of(effects[0]))

        def made(columns):
            cosines = self.cosines(columns, joints)
            return Moments(joints, cosines, self.edges), root_mean_square(columns)

        found = self.view.shaped(effects, self.motion, made)
        return Family.in_frequency(self, effects, *found)


@dataclass(frozen=True, kw_only=True, eq=False)
class Family(Columns):
    """An effect with the shapes of its grid, in frequency."""

    effects: tuple  # one for each shape
    # beside other families of the same joints, at these places of their shapes
    stack: "Family | None" = None
    at: slice | None = None

    @functools.cached_property
    def keys(self):
        """Keys of the effects."""
        return tuple(effect.key() for effect in self.effects)

    @functools.cached_property
    def opposite_keys(self):
        """Keys of their opposites, empty where they have none."""
        if self.effects[0].opposite() is None:
            return ()
        return tuple(effect.opposite().key() for effect in self.effects)

    @classmethod
    def in_frequency(cls, problem, effects, moments, size):
        """Take moments of the cosines of columns, and the size (nj, c, k) of these."""
        torque = problem.torque[list(moments.joints)][:, None, None]
        # An effect of all joints has the torque of that which it moves the most.
        share = np.where(torque > 0, size / np.where(torque > 0, torque, 1.0), 0.0)
        largest = share.max(axis=0)
        unit = np.where(largest > 0, 1.0 / np.where(largest > 0, largest, 1.0), 0.0)
        return cls(effects=tuple(effects), moments=moments, unit=unit)

    def split(self):
        """Return a family for each separate use, see `Shaped.split_by`."""
        first = self.effects[0]
        names = first.split_by if isinstance(first, Shaped) else ()
        uses = {}
        for c, effect in enumerate(self.effects):
            use = tuple(getattr(effect, name) for name in names)
            uses.setdefault(use, []).append(c)
        if len(uses) < 2:
            return [self]
        return [
            Family(
                effects=tuple(self.effects[c] for c in own),
                moments=self.moments.of(np.ascontiguousarray(self.columns[:, :, own])),
                unit=self.unit[own],
            )
            for own in uses.values()
        ]

    def member(self, c, scale=1.0):
        """Return one of the shapes as a `SelectedEffect`."""
        k = len(self.effects[c].coefficients)
        return SelectedEffect(
            effect=self.effects[c],
            moments=self.moments.group(c, k),
            unit=self.unit[c, :k],
            scale=scale,
        )


def stacked(families):
    """Return the same families with the columns of all side by side."""
    # Moments beside a model are then made at once.
    kinds = {}
    for i, family in enumerate(families):
        kind = family.joints, family.unit.shape[1], family.effects[0].bank
        kinds.setdefault(kind, []).append(i)
    found = list(families)
    for (joints, *_), places in kinds.items():
        own = [families[i] for i in places]
        columns = np.concatenate([family.columns for family in own], axis=2)
        stack = Family(
            effects=tuple(itertools.chain(*(family.effects for family in own))),
            moments=Moments(joints, columns, own[0].moments.edges),
            unit=np.concatenate([family.unit for family in own]),
        )
        ends = np.cumsum([len(family.effects) for family in own]).tolist()
        for i, end in zip(places, ends):
            at = slice(end - len(families[i].effects), end)
            moments = stack.moments.of(columns[:, :, at])
            known = {"moments": moments, "stack": stack, "at": at}
            found[i] = replace(families[i], **known)
    return found


def _lower(L, right, turned=False):
    """Solve a lower triangular system (r, ...), or that of its transpose."""
    # SciPy's own function checks for longer than such small systems take.
    if not right.size:
        # What LAPACK calls illegal.
        return np.zeros(right.shape)
    found, _ = lapack.dtrtrs(L, right, lower=1, trans=int(turned))
    return found if right.ndim > 1 else found.ravel()


class Base:
    """The declared columns under given weights, and families given these."""

    # density (nv, n_bands): weights of the cosines of each band; spectrum: what they
    # are from, a power `share` of it (see `Spectrum.weights`), or None; L (r, r): lower
    # Cholesky factor of the Gram matrix; t (r,): L^-1 times the products with the
    # torques.

    def __init__(self, problem, density, spectrum=None, share=1.0):
        self.problem, self.density = problem, density
        self.spectrum, self.share = spectrum, share
        G = np.tensordot(density, problem.gram, 2)
        # Of each column itself: weights make some of them a thousand times the others.
        G += np.diag(_RIDGE * np.maximum(np.diagonal(G), 1.0))
        self.L = linalg.cholesky(G, lower=True)
        self.t = self.solved(np.tensordot(density, problem.right, 2))
        self._known = WeakKeyDictionary()

    @property
    def log_prior(self):
        """Logarithm of the prior density of the spectrum, but for a constant."""
        return 0.0 if self.spectrum is None else self.spectrum.log_prior

    def on(self, problem):
        """Return the same weights on other equations."""
        return Base(problem, self.density, self.spectrum, self.share)

    @functools.cached_property
    def weights(self):
        """Weights of the cosines, (nv, n)."""
        return self.density[:, self.problem.cosines.band]

    @functools.cached_property
    def inverse(self):
        """Inverse of the Gram matrix, (r, r)."""
        return linalg.cho_solve((self.L, True), np.eye(self.L.shape[0]))

    def promised_less(self, columns):
        """How much less than the variance of a score the weights promise of it."""
        if self.spectrum is None:
            return 1.0
        cosines, power = self.problem.cosines, columns**2 * self.weights
        noise = self.spectrum.noise(cosines)[:, cosines.band]
        return (power * self.weights * noise).sum() / power.sum()

    def solved(self, right):
        """L^-1 times a right-hand side (r, ...)."""
        return _lower(self.L, right)

    def undone(self, member):
        """Return the same before a member's corrections, as far as these are linear."""
        done = member.done
        if not done.any():
            return self
        y, other = self.problem.y.copy(), copy.copy(self)
        for i, j in enumerate(member.joints):
            y[j] += member.columns[i, :, 0] @ done
        other.problem = self.problem.with_torques(y)
        other._known = WeakKeyDictionary()
        other.t = self.t + self.beside(member.moments).T @ done
        return other

    def over(self, joints, products):
        """Sum products by joint and band (nj, n_bands, ...) with their weights."""
        density = self.density[list(joints)].ravel()
        found = density @ products.reshape(density.size, -1)
        return found.reshape(products.shape[2:])

    def beside(self, moments):
        """Moments of groups of columns and the declared ones, `Beside`."""
        if moments not in self._known:
            own, problem = moments.joints, self.problem
            c, k = moments.shape
            T = self.solved(self.over(own, moments.declared(problem)))
            right = self.over(own, moments.right(problem))
            gram = self.over(own, moments.gram)
            self._known[moments] = Beside(
                T=T,
                gram=gram,
                H=gram - _blocks(T, c, k),
                q=(right - self.t @ T).reshape(c, k),
            )
        return self._known[moments]


@dataclass(frozen=True, kw_only=True, eq=False)
class Beside:
    """Moments of c groups of k columns and the declared ones."""

    T: np.ndarray  # (r, c * k): L^-1 times their products with these
    # (c, k, k): their Gram matrices, and what is left of them
    gram: np.ndarray
    H: np.ndarray
    q: np.ndarray  # (c, k): their products with what is left of the torques


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

    # base: declared columns under these weights; theta (r,): posterior mean of those,
    # in reduced coordinates; places: coefficients of each member; prior (p,): precision
    # of these.

    def __init__(self, base, members=()):
        self.base, self.members = base, tuple(members)
        edges = np.cumsum([0, *(m.width for m in self.members)])
        self.places = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        p, r = int(edges[-1]), base.L.shape[0]
        self._B, right, self.prior = np.zeros((r, p)), np.zeros(p), np.zeros(p)
        for place, member in zip(self.places, self.members):
            own = base.beside(member.moments)
            self._B[:, place] = own.T
            used = member.unit > 0
            deviation = np.where(used, member.scale * member.unit, 1.0)
            self.prior[place] = 1.0 / deviation**2
            right[place] = own.q[0] - self.prior[place] * member.done
        S = np.diag(self.prior) - self._B.T @ self._B
        for j, (at, X) in self._acting.items():
            S[np.ix_(at, at)] += (X * base.weights[j][:, None]).T @ X
        self._factor = linalg.cholesky(S, lower=True) if p else S
        self._t = self._reduced(right)
        self._coef = _lower(self._factor, self._t, turned=True) if p else right
        self.theta = _lower(base.L, base.t - self._B @ self._coef, turned=True)
        self._beside, self._evidence = WeakKeyDictionary(), WeakKeyDictionary()

    @functools.cached_property
    def _acting(self):
        """Coefficients that act on each joint, and their columns (n, p_j), a dict."""
        found = {}
        for place, member in zip(self.places, self.members):
            for j, own in zip(member.joints, member.columns[:, :, 0]):
                found.setdefault(j, []).append(
                    (np.arange(place.start, place.stop), own)
                )
        return {
            j: (np.concatenate([x[0] for x in own]), np.hstack([x[1] for x in own]))
            for j, own in found.items()
        }

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

    def _reduced(self, right):
        """Solve the members' factor for a right-hand side (p, ...)."""
        return _lower(self._factor, right) if self.members else right

    @functools.cached_property
    def residual(self):
        """Residuals of the cosines, (nv, n)."""
        return self.problem.y - self._sum(self.theta, self._coef)

    def _sum(self, theta, coef):
        """Sum of the columns with coefficients (r, ...) and (p, ...), (nv, n, ...)."""
        out = self.problem.Z @ theta
        for j, (at, X) in self._acting.items():
            out[j] += X @ coef[at]
        return out

    def rows_of(self, j):
        """Columns of the members in a joint's equations, (n, p)."""
        found = np.zeros((self.problem.y.shape[1], self._coef.size))
        if j in self._acting:
            at, X = self._acting[j]
            found[:, at] = X
        return found

    @property
    def done(self):
        """What of the coefficients the equations have already, (p,)."""
        return np.concatenate([np.zeros(0), *(m.done for m in self.members)])

    def powers(self):
        """Residual powers and freedom left by joint and band, two (nv, n_bands)."""
        problem, base = self.problem, self.base
        cosines = problem.cosines
        edges, fill = cosines.edges, cosines.fill[:, None]
        power = np.add.reduceat(self.residual**2, edges[:-1], axis=1)
        # What the fit takes: products by band with the covariance of all coefficients.
        covariance, cross = self.covariance, np.zeros((base.L.shape[0], 0))
        if self.members:
            E = _lower(base.L, self._B, turned=True)
            cross = E @ covariance
            whole = base.inverse + cross @ E.T
        else:
            whole = base.inverse
        taken = np.tensordot(problem.gram, whole, 2)
        for j, (at, X) in self._acting.items():
            rows = X @ covariance[np.ix_(at, at)] - 2.0 * (problem.Z[j] @ cross[:, at])
            taken[j] += np.add.reduceat((rows * X).sum(axis=1), edges[:-1])
        taken *= base.density
        # What comes again with each phase is known no better for it.
        fill = fill / problem.view.repeats
        return fill * power, np.maximum(fill * np.diff(edges) - taken, 0.0)

    def groups(self, family):
        """Second moments of a family's shapes beside this model, `Groups`."""
        if family.stack is not None:
            return self.groups(family.stack).part(family.at)
        if family.moments not in self._beside:
            own, (c, k) = self.base.beside(family.moments), family.moments.shape
            H, q, D = own.H, own.q, np.zeros((0, c * k))
            if self.members:
                D = self._reduced(self._products(family.moments) - self._B.T @ own.T)
                H = H - _blocks(D, c, k)
                q = q - (self._t @ D).reshape(c, k)
            diagonal = np.diagonal(own.gram, axis1=1, axis2=2)
            positive = family.effects[0].bank
            groups = Groups(H=H, q=q, own=diagonal, unit=family.unit, positive=positive)
            self._beside[family.moments] = groups, D
        return self._beside[family.moments][0]

    def evidence(self, family, scale):
        """Log evidence (c,) of a family's shapes beside this model; of a bank, most."""
        if family.stack is not None:
            return self.evidence(family.stack, scale)[family.at]
        if family.moments not in self._evidence:
            self._evidence[family.moments] = self.groups(family).most_evidence(scale)
        return self._evidence[family.moments]

    def _products(self, moments):
        """Weighted products of the members' columns with others, (p, c * k)."""
        found = np.zeros((self._coef.size, np.prod(moments.shape)))
        for j, columns in zip(moments.joints, moments.columns):
            if j in self._acting:
                at, X = self._acting[j]
                weighted = X * self.base.weights[j][:, None]
                found[at] += weighted.T @ columns.reshape(len(columns), -1)
        return found

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

    def excess(self, family, c, coef, noise):
        """Overdispersion of one shape's score beside this model.

        `coef` (k,) is the direction of its coefficients that counts, `noise` the fit
        under the same weights that leaves the noise.
        """
        if family.stack is not None:
            return self.excess(family.stack, family.at.start + c, coef, noise)
        self.groups(family)
        k = family.moments.shape[1]
        columns = slice(c * k, (c + 1) * k)
        T = self.base.beside(family.moments).T[:, columns] @ coef
        D = self._beside[family.moments][1][:, columns] @ coef
        members = _lower(self._factor, D, turned=True) if self.members else D
        declared = _lower(self.base.L, T - self._B @ members, turned=True)
        left = -self._sum(declared, members)
        left[list(family.joints)] += family.columns[:, :, c] @ coef
        return self._scattered(left[:, :, None], [family.effects[c]], noise)[0]

    def excesses(self, noise):
        """Overdispersion of each member's score given the others, a list."""
        if not self.members:
            return []
        # Their columns, less what the others explain of them, by the block inverse.
        C, directions = self.covariance, np.zeros((self._coef.size, len(self.members)))
        for i, (place, member) in enumerate(zip(self.places, self.members)):
            coef = self._coef[place] + member.done
            directions[:, i] = C[:, place] @ np.linalg.solve(C[place, place], coef)
        theta = -_lower(self.base.L, self._B @ directions, turned=True)
        left = self._sum(theta, directions)
        return self._scattered(left, [m.effect for m in self.members], noise)

    def _scattered(self, left, effects, noise):
        """Overdispersion of scores by columns (nv, n, c) beside everything else."""
        # The variance of a score between blocks of time over that which its second
        # moments promise (the sandwich over the Hessian), at least one, with the
        # degrees of freedom that it is known with. The variance of slow changes of the
        # score counts where it is larger: that of independent blocks is as large at all
        # frequencies.
        rows = self._rows(left * np.sqrt(self.base.weights)[:, :, None])
        promised = (rows**2).sum(axis=(0, 1))
        # What the column itself explains of the noise is none.
        own = np.einsum("jmc,jm->c", rows, noise.scores) / np.maximum(promised, _TINY)
        products = np.einsum("jmc,jm->mc", rows, noise.scores)
        products -= own * (rows**2).sum(axis=0)
        view = self.problem.view
        spans = view.spans.sums(products)[view.span_order]
        phases = view.blocks.sums(products) if view.repetition else None
        found = []
        for c, effect in enumerate(effects):
            if not promised[c] > 0:
                found.append(Overdispersion())
                continue
            least = max(1.0, self.base.promised_less(left[:, :, c]))
            again = None if phases is None else phases[:, c] / np.sqrt(promised[c])
            scores = spans[:, c] / np.sqrt(promised[c])
            found.append(self._dispersion(scores, again, effect, noise, least))
        return found

    def _dispersion(self, scores, again, effect, noise, least):
        """Overdispersion of scores of blocks, and of phases `again` if any."""
        power, slow = _score_powers(scores)
        usual, freedom = max(least, slow.mean(), power.mean()), np.inf
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
        shaped = isinstance(effect, Shaped)
        taken = 1 + (shaped and bool({*effect.continuous} - {*effect.jumping}))
        left = power[:_SLOWEST].sum() / max(_SLOWEST - taken, 1)
        freedom = float(max(slow.size - taken, 1))
        return Overdispersion(
            ratio=float(max(usual, left)), freedom=freedom, usual=usual
        )

    @functools.cached_property
    def covariance(self):
        """Posterior covariance of the members' coefficients."""
        return linalg.cho_solve((self._factor, True), np.eye(self._coef.size))

    @functools.cached_property
    def _by_width(self):
        """Second moments of members given the others: numbers, `Groups`, by width."""
        # By the block inverse, without another fit.
        widths, found = np.array([m.width for m in self.members]), []
        for k in np.unique(widths):
            numbers = np.flatnonzero(widths == k)
            places = [self.places[i] for i in numbers]
            members = [self.members[i] for i in numbers]
            inverse = np.linalg.inv([self.covariance[p, p] for p in places])
            values = np.array([self._coef[p] for p in places])
            values += [m.done for m in members]
            gram = [self.base.beside(m.moments).gram[0] for m in members]
            found.append(
                (
                    numbers,
                    Groups(
                        H=inverse - [np.diag(self.prior[p]) for p in places],
                        q=(inverse @ values[:, :, None])[:, :, 0],
                        own=np.diagonal(gram, axis1=1, axis2=2),
                        unit=np.array([m.unit for m in members]),
                    ),
                )
            )
        return found

    def own_groups(self):
        """Second moments of each member given the others, list of `Groups`."""
        found = [None] * len(self.members)
        for numbers, groups in self._by_width:
            for at, i in enumerate(numbers):
                found[i] = groups.part(slice(at, at + 1))
        return found

    def rescaled(self, scale):
        """Return the same with the most probable scale of each member."""
        members = list(self.members)
        for numbers, groups in self._by_width:
            for i, own in zip(numbers, groups.best_scale(scale)):
                members[i] = replace(members[i], scale=float(own))
        return Fit(self.base, members)

    def log_evidence(self):
        """Logarithm of the evidence, but for a constant of the recording."""
        # Of members with their scales, and of the spectrum that the weights are from.
        problem, density = self.problem, self.base.density
        heard, cosines = problem.used_joints, problem.cosines
        count = cosines.fill[heard, None] * np.diff(cosines.edges)
        volume_of_noise = 0.5 * (count * np.log(density[heard])).sum()
        power = (density[heard] * problem.power[heard]).sum()
        power -= self.base.t @ self.base.t + self._t @ self._t
        power += self.prior @ self.done**2
        volume = np.log(np.diagonal(self.base.L)).sum()
        if self.members:
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
        base = self.base.undone(self.members[i])
        return Fit(base, (*self.members[:i], *self.members[i + 1 :]))


def declared_alone(view):
    """Fit the declared columns, joints weighted as in the fit of the robot."""
    return Fit(declared_weights(Problem(view)))


def declared_weights(problem):
    """Make the base under the weights of the joints in the fit of the robot."""
    return _flat(problem, problem.view.precision * problem.cosines.fill)


def _flat(problem, weights):
    """Make the base under one weight for each joint (nv,)."""
    bands = problem.cosines.octave.size
    return Base(problem, np.repeat(weights[:, None], bands, axis=1))


# Powers of the spectrum that weights may follow, from all of it to none.
_SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)


def spectrum_of(fit, settings, rounds=3, share=None):
    """Return a fit under weights by the spectrum of its residual."""
    # Such weights are best where the model is right. Where it is not, frequencies in
    # which it is wrong can decide everything. So they follow the largest power `share`
    # (None: found) of the spectrum with which no joint's torque differs from that by
    # plain weights more than by chance (after J. Hausman, Econometrica 46(6), 1978, doi
    # 10.2307/1913827).
    if share is not None:
        return _following(fit, settings, rounds, share)
    problem = fit.problem
    plain = weighed(Fit(declared_weights(problem), fit.members))
    most = _by_chance(plain.base, _spectrum(plain, settings), settings.significance)
    for start, share in ((fit, 1.0), *((plain, own) for own in _SHARES)):
        found = _following(start, settings, rounds, share)
        away = ((found.residual - plain.residual) ** 2).sum(axis=1)
        if (away <= most)[problem.used_joints].all():
            break
    return found


def _following(fit, settings, rounds, share):
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


def _by_chance(plain, spectrum, chance):
    """How far (nv,) right weights lead from plain ones by chance, a square sum."""
    # They scatter less than plain ones, from which they differ by less than these do:
    # the mean of that, and so many deviations.
    problem = plain.problem
    power = plain.density**2 * spectrum.noise(problem.cosines)
    scatter = plain.inverse @ np.tensordot(power, problem.gram, 2) @ plain.inverse
    own = problem.gram.sum(axis=1) @ scatter
    deviation = np.sqrt(2.0 * np.einsum("jpq,jqp->j", own, own))
    return np.einsum("jpp->j", own) + chance * deviation


def weighed(fit):
    """Return a fit under one weight for each joint, by its residual."""
    problem = fit.problem
    power = (fit.residual**2).mean(axis=1)
    heard = problem.used_joints & (power > 0)
    own = np.where(heard, problem.cosines.fill / np.where(heard, power, 1.0), 0.0)
    return Fit(_flat(problem, own), fit.members)
