"""Prior of the bodies around their description, with a scale for each body."""

import functools
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from scipy import linalg
from scipy.special import logsumexp, softmax

from sklearn_vbjfa._core._groups import Groups
from sklearn_vbjfa._core._linear_systems import components, scaled_eigen, solve_spd
from sklearn_vbjfa.model import joint_names, nominal_parameters, solid_bodies
from sklearn_vbjfa.physical import pseudo_inertia

# Expected relative error of a description: scale of the half-Cauchy distribution of a
# body's distance from it in each of ten directions; its heavy tail permits outliers.
DESCRIBED = 0.2
# A parameter comes from the description if its posterior deviation exceeds this share
# of its prior deviation.
_NOT_LEARNED = 0.7
# Bodies within this log evidence [nats] of the most probable departure are its rivals.
RIVALS = 3.0
# Prior probability that the description of a body is worse than none.
_WRONG = 0.01
# Grid of scales for integration (at 1 a body may become inconsistent), and minimum
# precision of a site relative to the usual one.
SCALES, _MIN_PRECISION = np.geomspace(1e-4, 1.0, 81), 1e-4
# The common size of the bodies differs from one beyond so many standard deviations.
_SIZE_DEVIATIONS = 3.0
# Beyond this factor a different unit is more probable than one body that differs.
_MAX_BODY_FACTOR = 20.0
# Mass that replaces zero, as between two joints, relative to the mean mass.
_MASSLESS = 1e-3
# Second moments of the ball of an unknown body over those of a quarter of a link's
# length, and scale of a body above which it may be one.
_UNKNOWN_EXTENT, _UNKNOWN_SCALE = 10.0, 0.5
# Maximum number of passes, and change of a mean, in deviations, at convergence.
_MAX_PASSES, _MAX_CHANGE = 100, 1e-3
# Maximum rescalings of the description by the common size, relative change of that
# size that requires one, and factor beyond which it is no unit.
_MAX_RESCALINGS, _CONTRADICTED, _MAX_SIZE = 20, 0.5, 1e9
# Relative eigenvalue of the Gram matrix below which directions are never used.
_RANK_TOLERANCE = 1e-12
# Relative floor for the variances of a body, which are rounding below.
_ROUNDING = 1e-15
OPTIONS = ("prior", "free", "fixed")


@dataclass(frozen=True)
class Departure:
    """A body that differs from its description, with indistinguishable candidates."""

    # joints that carry the candidates, the most probable first; their log evidence
    # differs by less than three nats
    bodies: tuple[str, ...]
    # size of each candidate over the described body
    factors: tuple[float, ...]
    stds: tuple[float, ...]  # standard deviations of the factors
    # log odds that the first candidate differs by more than descriptions usually do,
    # against no such difference
    log_odds: float


def _thickened(P):
    """Return pseudo-inertias with the mean extension on all sides."""
    # So that a small error of the centre of a thin rod is a small distance.
    first_moment, mass = P[:, :3, 3], P[:, 3, 3]
    second_moments = np.trace(P[:, :3, :3], axis1=1, axis2=2)
    second_moments -= (first_moment**2).sum(axis=1) / mass
    thickened = P.copy()
    thickened[:, :3, :3] += second_moments[:, None, None] / 3.0 * np.eye(3)
    return thickened


def _metric_roots(P):
    """Return upper triangular roots (n, 10, 10) of the metric at pseudo-inertias."""
    relative = np.linalg.solve(P[:, None], pseudo_inertia(np.eye(10)))
    metric = np.einsum("niab,njba->nij", relative, relative)
    metric = 0.5 * (metric + np.swapaxes(metric, 1, 2))
    return np.swapaxes(np.linalg.cholesky(metric), 1, 2)


def _balls(model, masses):
    """Return bodies (n, 10) of given masses and a quarter of a link's mean length."""
    lengths = [np.linalg.norm(x.translation) for x in model.jointPlacements[1:]]
    lengths = [d for d in lengths if d > 0]
    radius = 0.25 * (np.mean(lengths) if lengths else 1.0)
    inertia = 0.4 * radius**2
    return np.outer(masses, [1.0, 0, 0, 0, inertia, 0, inertia, 0, 0, inertia])


def force_solid(model, bodies):
    """Return the bodies (n, 10) of a model with non-solid ones replaced by balls."""
    solid = solid_bodies(bodies)
    mean = bodies[solid, 0].mean() if solid.any() else 1.0
    balls = _balls(model, np.where(bodies[:, 0] <= 0, _MASSLESS * mean, mean))
    return np.where(solid[:, None], bodies, balls)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyPrior:
    """Prior of the bodies, centred at their description."""

    # The distance of a body from its description is tr((P0^-1 dP)^2) with its
    # pseudo-inertia P0, the metric of Lee, Wensing and Park (IEEE Trans. Robotics
    # 36(2), 2020, doi:10.1109/TRO.2019.2926491) at P0; below one, the body is
    # consistent.

    names: tuple[str, ...]  # joints that carry the bodies
    indices: np.ndarray  # (n, 10): indices of their parameters
    centre: np.ndarray  # (n, 10): their parameters
    # (n, 10, 10): upper triangular R; |R d|^2 is the distance of a change d of a body
    root: np.ndarray
    loose: np.ndarray  # (n, 10, 10): roots of bodies of unknown mass and centre

    @classmethod
    def of(cls, model, per_joint, followers=()):
        """Build the prior from a model; None if no body has mass and extension."""
        # Massless bodies have a wide prior around almost none; those with mass but no
        # extension are free. followers: `FollowingBody`, which come last.
        names, starts = joint_names(model), per_joint * np.arange(model.nv)
        names = [*names, *(body.name for body in followers)]
        starts = np.r_[starts, per_joint * model.nv + 10 * np.arange(len(followers))]
        bodies = [*nominal_parameters(model), *(body.parameters for body in followers)]
        bodies = np.array(bodies)
        solid, massless = solid_bodies(bodies), bodies[:, 0] <= 0
        if not solid.any():
            return None
        centre = force_solid(model, bodies)
        ball = _balls(model, np.where(massless, 1.0 / _MASSLESS, 1.0) * centre[:, 0])
        ball[:, 4:] *= _UNKNOWN_EXTENT
        P = _thickened(pseudo_inertia(centre))
        loose = DESCRIBED * _metric_roots(P + _thickened(pseudo_inertia(ball)))
        bodies = cls(
            names=tuple(names),
            indices=starts[:, None] + np.arange(10),
            centre=centre,
            root=np.where(massless[:, None, None], loose, _metric_roots(P)),
            loose=loose,
        )
        return bodies.part(solid | massless)

    def part(self, chosen):
        """Select bodies by a mask (n,)."""
        values = {x: getattr(self, x)[chosen] for x in vars(self) if x != "names"}
        return replace(self, names=tuple(compress(self.names, chosen)), **values)

    def loosened(self, chosen):
        """Replace the prior of bodies, a mask (n,), by that of unknown ones."""
        chosen = np.reshape(chosen, (-1, 1, 1))
        return replace(self, root=np.where(chosen, self.loose, self.root))

    def vector(self, p):
        """Return the description among all parameters (p,), zero elsewhere."""
        out = np.zeros(p)
        out[self.indices] = self.centre
        return out

    def scaled(self, factor):
        """Scale the bodies by a common factor or by one factor each."""
        size = np.reshape(factor, (-1, 1, 1))
        roots = {"root": self.root / size, "loose": self.loose / size}
        return replace(self, centre=size[:, 0] * self.centre, **roots)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyPosterior:
    """Posterior of the parameters, from torques and a description."""

    theta: np.ndarray  # (p,): posterior mean
    # (p, p): posterior; infinite on the diagonal of undetermined parameters
    covariance: np.ndarray
    prior: np.ndarray  # (p, p): precision of the prior
    # (p,): standard deviations of the prior at the estimated scales of the bodies; nan
    # for parameters without prior, infinite for bodies whose description is wrong
    prior_std: np.ndarray
    centre: np.ndarray  # (p,): mean of the prior
    # bodies that differ from the description, with indistinguishable candidates
    departures: tuple[Departure, ...] = ()
    noise: float = 1.0  # variance by which the normal equations were divided
    common_size: float = 1.0  # common factor of all bodies over the description
    # common factor of all torques over those of the description, its relative error
    torque_size: tuple[float, float] = (1.0, np.inf)

    @property
    def weighted_prior(self):
        """`prior` in the units of the weighted equations, (p, p)."""
        return self.noise * self.prior


def little_learned(std, prior_std):
    """Return whether data leave most of the prior deviation."""
    with np.errstate(invalid="ignore"):
        return std >= _NOT_LEARNED * prior_std


@dataclass(frozen=True, eq=False)
class Site:
    """Gaussian approximation of the prior of a body, or of joints with one drive."""

    # Its precision, product of precision and mean, and the RMS of its posterior scale.

    precision: np.ndarray
    right: np.ndarray
    scale: float = DESCRIBED

    @classmethod
    def of_scale(cls, scale, size=10):
        return cls(np.eye(size) / scale**2, np.zeros(size), scale)


@dataclass(frozen=True, eq=False)
class _BodyProblem:
    """Normal equations A theta = b in units of the noise, with a description."""

    # Sites are in coordinates in which the prior is isotropic. `fixed_size`: the common
    # size equals the described one.

    description: BodyPrior
    A: np.ndarray
    b: np.ndarray
    fixed_size: bool = False

    def precision(self, sites):
        """Return the precision (p, p) of the prior with some sites."""
        out, root = np.zeros(self.A.shape), self.description.root
        inner = np.array([site.precision for site in sites])
        at = self.description.indices
        out[at[:, :, None], at[:, None, :]] = root.transpose(0, 2, 1) @ inner @ root
        return 0.5 * (out + out.T)

    @property
    def centre(self):
        """The description among all parameters, (p,)."""
        return self.description.vector(self.b.size)

    @functools.cached_property
    def _whitened(self):
        """Equations H z = q of the bodies' changes alone, description, branches."""
        # In coordinates (10 n,) in which the prior is isotropic; other parameters are
        # eliminated. Branches: indices of equations that data or priors couple, a list.
        root, A = linalg.block_diag(*self.description.root), self.A
        places, free = (
            self.description.indices.ravel(),
            np.ones(self.b.size, dtype=bool),
        )
        free[places] = False
        system = np.column_stack([A[:, places], self.b - A @ self.centre])
        eigen = scaled_eigen(A[np.ix_(free, free)], _RANK_TOLERANCE)
        system = system[places] - A[np.ix_(places, free)] @ eigen.solve(system[free])
        system = linalg.solve_triangular(root, system, trans=1)
        H = linalg.solve_triangular(root, system[:, :-1].T, trans=1)
        n = len(self.description.names)
        coupled = H.reshape(n, 10, n, 10).any(axis=(1, 3)) | np.eye(n, dtype=bool)
        branches = components(np.kron(coupled, np.ones((10, 10))))
        return H, system[:, -1], root @ self.description.centre.ravel(), branches

    def size_equation(self):
        """Return the normal equation H size = q of the common size of all bodies."""
        # Other parameters are eliminated. H is 0 if the size is not identifiable.
        H, q, centre, _ = self._whitened
        total, size = self.centre @ self.A @ self.centre, centre @ H @ centre
        return size if size > _RANK_TOLERANCE * total else 0.0, centre @ q + size

    def solve(self, sites):
        """Return mean and covariance root of the change from the description."""
        # The last entry is the relative change of the common size of all bodies, with
        # the usual prior around the scaled description (the unit of a torque channel
        # may be unknown). It borders a matrix in which branches are uncoupled.
        p, centre = self.b.size, self.centre
        A_centre = self.A @ centre
        right = self.b - A_centre
        size_product = centre @ right
        products = np.array([site.right for site in sites])
        root = self.description.root
        right[self.description.indices] += np.einsum("kij,ki->kj", root, products)
        # Directions without data and prior do not change.
        eigen = scaled_eigen(self.A + self.precision(sites), _RANK_TOLERANCE)
        mean, root = np.zeros(p + 1), np.zeros((p + 1, eigen.rank + 1))
        mean[:p], root[:p, :-1] = eigen.solve(right), eigen.inverse_root()
        if not self.fixed_size:
            response = np.append(-eigen.solve(A_centre), 1.0)
            precision = max(A_centre @ (centre + response[:p]), 0.0) + DESCRIBED**-2
            mean += response * (size_product - A_centre @ mean[:p]) / precision
            root[:, -1] = response / np.sqrt(precision)
        return mean, root

    def marginals(self, sites):
        """Return marginal precisions (n, 10, 10) of bodies, and products with means."""
        H, q, centre, branches = self._whitened
        product = H @ centre
        right = np.column_stack([q + np.ravel([x.right for x in sites]), product])
        system = H + linalg.block_diag(*(site.precision for site in sites))
        least, bodies = _MIN_PRECISION / DESCRIBED**2, np.arange(len(sites))
        solution, inverse, _ = solve_spd(system, right, least, branches)
        covariance = inverse.reshape(bodies.size, 10, -1, 10)[bodies, :, bodies]
        mean, response = solution.T
        if not self.fixed_size:
            precision = max((centre - response) @ product, 0.0) + DESCRIBED**-2
            mean -= response * (centre @ q - product @ mean) / precision
            response = response.reshape(-1, 10, 1)
            covariance += response @ response.transpose(0, 2, 1) / precision
        precision = floored_inverse(covariance)
        return precision, _matvec(precision, mean.reshape(-1, 10))

    def log_evidence(self, sites):
        """Return the log evidence at the scales of sites, up to a constant."""
        scale = np.array([site.scale for site in sites])
        # Mean and covariance root, then in deviations for bodies and common size.
        joint = np.column_stack(self.solve([Site.of_scale(x) for x in scale]))
        theta = self.centre + joint[:-1, 0] + joint[-1, 0] * self.centre
        z = self.description.root / scale[:, None, None]
        z = (z @ joint[self.description.indices]).reshape(-1, joint.shape[1])
        z = np.vstack([z, joint[-1] / DESCRIBED])
        log_det = np.linalg.slogdet(z[:, 1:] @ z[:, 1:].T)[1]
        ratio = scale / DESCRIBED
        prior = np.log(ratio / (1 + ratio**2)).sum()
        explained = theta @ (self.b - 0.5 * self.A @ theta)
        return explained + 0.5 * (log_det - z[:, 0] @ z[:, 0]) + prior

    def sites(self):
        """Return the sites of the bodies, see `propagate_sites`."""
        initial = [Site.of_scale(DESCRIBED)] * len(self.description.names)
        return propagate_sites(initial, lambda sites: zip(*self.marginals(sites)))

    def departures(self, sizes, stds):
        """Yield indices, factors, their deviations, and log odds of departures."""
        # Bodies whose size differs by more than usual, one by one. The others keep the
        # usual scale: with all scales free, the difference of one body would be
        # distributed over several. sizes, stds: fitted masses, (n,).
        root = self.description.root
        # Direction of a change in size only.
        direction = np.einsum("kij,kj->ki", root, self.description.centre)
        length = np.linalg.norm(direction, axis=1)
        direction /= length[:, None]
        # A factor of a massless or unknown body is meaningless.
        candidates = (length > 0.5).astype(float)
        sites = [Site.of_scale(DESCRIBED)] * len(root)
        while candidates.any():
            precision, product = self.marginals(sites)
            pair = np.stack([direction, product], axis=2)
            pair = np.einsum("ki,kij->kj", direction, np.linalg.solve(precision, pair))
            variance, q = pair[:, 0], pair[:, 1:] / pair[:, :1]
            from_sites = [x @ site.precision @ x for x, site in zip(direction, sites)]
            H = np.maximum(1.0 / variance - from_sites, 0.0)[:, None, None]
            groups = Groups(H=H, q=q, norms=H[:, 0], unit=np.ones(q.shape))
            odds = groups.integrated(DESCRIBED, DESCRIBED) - np.log(len(root))
            scale = groups.best_scale(DESCRIBED)
            total = H[:, 0, 0] + scale**-2
            factors = 1.0 + q[:, 0] / total / length
            deviations = 1.0 / np.sqrt(total) / length
            # A negative size is not a body: some other effect explains it. So it does
            # if the fitted mass contradicts the factor, and is as described.
            sign = np.sign(factors - 1.0)
            contradicted = sign * (factors - sizes) > 2 * np.hypot(stds, deviations)
            possible = ~contradicted | (sign * (sizes - 1.0) > 2 * stds)
            odds = np.where((candidates > 0) & (factors > 0) & possible, odds, -np.inf)
            best = int(np.argmax(odds))
            if odds[best] <= 0:
                break
            rivals = np.flatnonzero(odds > odds[best] - RIVALS)
            rivals = rivals[np.argsort(-odds[rivals], kind="stable")]
            factors = np.where(contradicted, sizes, factors)
            yield rivals, factors, np.where(contradicted, stds, deviations), odds[best]
            axis = direction[best]
            widening = np.outer(axis, axis) * (scale[best] ** -2 - DESCRIBED**-2)
            site = sites[best]
            sites[best] = Site(site.precision + widening, site.right)
            candidates[rivals] = 0.0


def floored_inverse(covariance):
    """Invert covariances (..., k, k), with a floor for rounded variances."""
    value, axes = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    value = np.maximum(value, _ROUNDING * value[..., -1:])
    return (axes / value[..., None, :]) @ np.swapaxes(axes, -1, -2)


def propagate_sites(sites, marginals):
    """Approximate the priors by Gaussian sites with expectation propagation."""
    # T. Minka, UAI 2001; for scale mixtures M. Seeger, J. Machine Learning Research 9,
    # 2008. marginals: function from sites to each marginal's precision and product.
    for iteration in range(_MAX_PASSES):
        damping, change, updated = (0.5 if iteration else 1.0), 0.0, list(sites)
        pairs, by_size = list(marginals(sites)), {}
        for k, (_, product) in enumerate(pairs):
            by_size.setdefault(product.size, []).append(k)
        # Vectorised over sites of one size.
        for places in by_size.values():
            precision, product = (np.array(x) for x in zip(*[pairs[k] for k in places]))
            matched, step = _match_sites(precision, product, [sites[k] for k in places])
            change = max(change, step)
            for k, target in zip(places, matched):
                site = sites[k]
                updated[k] = Site(
                    site.precision + damping * (target.precision - site.precision),
                    site.right + damping * (target.right - site.right),
                    target.scale,
                )
        sites = updated
        if change < _MAX_CHANGE:
            break
    return sites


def _cavities(precision, product, sites):
    """Return precisions (n, k, k) and products (n, k) of marginals without sites."""
    precision = precision - np.array([site.precision for site in sites])
    return precision, product - np.array([site.right for site in sites])


def _log_scale_weights(precision, product):
    """Return eigenvalues, vectors, products, and log evidence of each scale (n, s)."""
    # precision (n, k, k), product (n, k): of the data, where the prior is isotropic.
    value, vectors = np.linalg.eigh(precision)
    value = np.maximum(value, 0.0)
    product = _matvec(np.swapaxes(vectors, 1, 2), product)
    s2, ratio = (SCALES**2)[:, None], SCALES / DESCRIBED
    growth = 1 + s2 * value[:, None]
    log_weight = 0.5 * product[:, None] ** 2 * s2 / growth - 0.5 * np.log(growth)
    prior = ratio / (1 + ratio**2)
    prior[[0, -1]] *= 0.5  # the trapezoidal rule
    return value, vectors, product, log_weight.sum(axis=2) + np.log(prior)


def _match_sites(precision, product, sites):
    """Match the mean and covariance of scale mixtures by sites."""
    # precision (n, k, k), product (n, k): marginals with the present sites. Returns the
    # sites and the largest change of a mean, in deviations.
    cavity = _cavities(precision, product, sites)
    value, vectors, cavity_product, log_weight = _log_scale_weights(*cavity)
    Vt, s2 = np.swapaxes(vectors, 1, 2), (SCALES**2)[:, None]
    growth, weight = 1 + s2 * value[:, None], softmax(log_weight, axis=1)
    variance = s2 / growth
    means = cavity_product[:, None] * variance
    mean = _matvec(np.swapaxes(means, 1, 2), weight)
    centred = means - mean[:, None]
    diagonal = np.arange(mean.shape[1])
    covariance = np.swapaxes(centred, 1, 2) @ (centred * weight[:, :, None])
    covariance[:, diagonal, diagonal] += _matvec(np.swapaxes(variance, 1, 2), weight)
    cavity_precision = np.zeros_like(covariance)
    cavity_precision[:, diagonal, diagonal] = value
    # The precision of a prior is not negative.
    values, axes = np.linalg.eigh(floored_inverse(covariance) - cavity_precision)
    values = np.maximum(values, _MIN_PRECISION / DESCRIBED**2)
    new_precision = (axes * values[:, None]) @ np.swapaxes(axes, 1, 2)
    right = _matvec(new_precision + cavity_precision, mean) - cavity_product
    shift = mean - _matvec(Vt, np.linalg.solve(precision, product[:, :, None])[..., 0])
    step = np.abs(shift) / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    scale = np.sqrt(weight @ s2[:, 0]).tolist()
    matched = map(Site, vectors @ new_precision @ Vt, _matvec(vectors, right), scale)
    return list(matched), float(step.max())


def _matvec(matrices, vectors):
    """Multiply matrices (n, i, j) by vectors (n, j)."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def _single_departure(description, A, b, factor):
    """Find the body that most probably differs by a factor, all others as described."""
    # Returns the log evidence, the problem and its sites. In the evidence, a Cauchy
    # prior of the log factor replaces the prior of the body's scale. Candidates are
    # chosen in closed form, with scales as described.
    n, results = len(description.names), []
    usual = [Site.of_scale(DESCRIBED)] * n
    problem = _BodyProblem(description, A, b, fixed_size=True)
    precision, product = _cavities(*problem.marginals(usual), usual)
    change = (factor - 1.0) * _matvec(description.root, description.centre)
    shifted = product - _matvec(precision, change)
    pair = (factor**2 * precision, factor * shifted), (precision, product)
    after, before = (_log_scale_weights(*equations)[3] for equations in pair)
    evidence = (after - before)[:, np.argmin(np.abs(SCALES - DESCRIBED))]
    evidence += 0.5 * np.einsum("ki,ki->k", change, product + shifted)
    for k in np.flatnonzero(evidence >= evidence.max() - RIVALS):
        factors = np.where(np.arange(n) == k, factor, 1.0)
        problem = _BodyProblem(description.scaled(factors), A, b)
        sites = problem.sites()
        prior = sites[k].scale / (np.sqrt(2 * np.pi) * DESCRIBED * n)
        results.append((problem.log_evidence(sites) + np.log(prior), problem, sites))
    best = max(results, key=lambda item: item[0])
    return best[0] - np.log1p((np.log(factor) / DESCRIBED) ** 2), *best[1:]


def _loosen(problem, sites):
    """Find bodies whose description is worse than none, greedily."""
    # As with a counterweight: in the metric at the described body, a first moment that
    # falls makes the mass fall. Returns the problem, its sites, the indices and log
    # evidence of the bodies found in each step, and a mask of all.
    found, unknown = [], np.zeros(len(sites), dtype=bool)
    while True:
        description = problem.description
        precision, product = _cavities(*problem.marginals(sites), sites)
        change = description.root @ np.linalg.inv(description.loose)
        back = np.swapaxes(change, 1, 2)
        loose = back @ precision @ change, _matvec(back, product)
        pair = (_log_scale_weights(*x)[3] for x in (loose, (precision, product)))
        gains = np.subtract(*(logsumexp(x, axis=1) for x in pair))
        possible = ~unknown & [x.scale > _UNKNOWN_SCALE for x in sites]
        gains = np.where(possible, gains, 0.0)
        best = gains.max()
        if not best > RIVALS - np.log(_WRONG):
            return problem, sites, found, unknown
        # Its rivals are unknown, too.
        order = np.argsort(-gains, kind="stable")
        found.append((order[gains[order] >= best - RIVALS], best))
        unknown[found[-1][0]] = True
        description = problem.description.loosened(unknown)
        problem = replace(problem, description=description)
        sites = problem.sites()


def _rescaled(description, A, b):
    """Scale a description to the torques; return the factor, problem and sites."""
    # If description and torques have different units, their ratio may be thousands. The
    # description is first scaled by least squares, in which one well excited body may
    # dominate, then rescaled while the posterior common size contradicts it.
    H, q = _BodyProblem(description, A, b).size_equation()
    scale = q / H if H > 0 and q > 0 else 1.0
    for k in range(_MAX_RESCALINGS):
        # Equations may contradict each other if the input noise is overestimated.
        diverges = max(scale, 1 / scale) > _MAX_SIZE or k + 1 == _MAX_RESCALINGS
        scale = 1.0 if diverges else scale
        problem = _BodyProblem(description.scaled(scale), A, b)
        sites = problem.sites()
        mean, root = problem.solve(sites)
        if diverges or abs(mean[-1]) < _CONTRADICTED:
            break
        scale *= max(1.0 + mean[-1], _CONTRADICTED)
    common, std = scale * (1.0 + mean[-1]), scale * np.linalg.norm(root[-1])
    far_off = abs(common - 1.0) >= _SIZE_DEVIATIONS * std
    if far_off and 1 / _MAX_BODY_FACTOR < common < _MAX_BODY_FACTOR and len(sites) > 1:
        departure = _single_departure(description, A, b, common)
        # If both explain the torques equally well, the unit is uncertain.
        if departure[0] > problem.log_evidence(sites) + RIVALS:
            return 1.0, *departure[1:]
    return scale, problem, sites


def around(description, A, b):
    """Estimate parameters from normal equations A theta = b and a description."""
    # A (p, p) and b (p,) are in units of the noise; parameters without prior are free.
    scale, problem, sites = _rescaled(description, A, b)
    problem, sites, found, unknown = _loosen(problem, sites)
    mean, root = problem.solve(sites)
    description = description.loosened(unknown)
    precision = problem.precision(sites)
    centre = problem.centre
    # A shape that is described exactly does not make the mass certain: for the
    # covariance, no scale is below half of the usual one.
    scales = np.maximum([site.scale for site in sites], 0.5 * DESCRIBED)
    _, wide = problem.solve([Site.of_scale(scale) for scale in scales])
    parameter_root = wide[:-1] + np.outer(centre, wide[-1])
    covariance = parameter_root @ parameter_root.T
    # Marginalise the prior over the common size.
    size_direction = precision @ centre
    share = centre @ size_direction + DESCRIBED**-2
    prior = precision - np.outer(size_direction, size_direction) / share
    determined = np.diagonal(A) + np.diagonal(prior) > 0
    covariance[~determined, ~determined] = np.inf
    prior_std = np.full(b.size, np.nan)
    deviations = np.sqrt((np.linalg.inv(problem.description.root) ** 2).sum(axis=2))
    prior_std[description.indices] = deviations * scales[:, None]
    prior_std[description.indices[unknown]] = np.inf
    common, common_std = scale * (1.0 + mean[-1]), scale * np.linalg.norm(root[-1])
    # Search for departures at the described size, unless the unit differs.
    same_unit = abs(common - 1.0) < _SIZE_DEVIATIONS * common_std
    tested = _BodyProblem(description, A, b, fixed_size=True) if same_unit else problem
    theta, mass = centre + (mean[:-1] + mean[-1] * centre), description.indices[:, 0]
    similar = _CONTRADICTED < common < 1.0 / _CONTRADICTED
    described = (1.0 if similar else scale) * description.centre[:, 0]
    sizes, stds = theta[mass] / described, np.sqrt(covariance[mass, mass]) / described
    names = np.array(description.names, dtype=object)
    departures = [(group, names, sizes, stds, gain) for group, gain in found]
    departures += ((x[0], names, *x[1:]) for x in tested.departures(sizes, stds))
    return BodyPosterior(
        theta=theta,
        covariance=covariance,
        prior=prior,
        prior_std=prior_std,
        centre=centre + mean[-1] * centre,
        departures=tuple(
            Departure(*(tuple(x[group].tolist()) for x in values), float(log_odds))
            for group, *values, log_odds in departures
        ),
        common_size=common,
        torque_size=(common, common_std / abs(common)),
    )


def fix_bodies(description, A, b):
    """Estimate all other parameters with the bodies fixed to the description."""
    # Parameters and result as for `around`.
    p = b.size
    free = ~np.isin(np.arange(p), description.indices)
    theta = description.vector(p)
    eigen = scaled_eigen(A[np.ix_(free, free)], _RANK_TOLERANCE)
    theta[free] = eigen.solve((b - A @ theta)[free])
    covariance = np.zeros((p, p))
    covariance[np.ix_(free, free)] = eigen.inverse()
    undetermined = np.flatnonzero(free)[np.diagonal(A)[free] <= 0]
    H, q = _BodyProblem(description, A, b).size_equation()
    size = (q / H, np.sqrt(H) / q) if q > 0 < H else (1, np.inf)
    covariance[undetermined, undetermined] = np.inf
    return BodyPosterior(
        theta=theta,
        covariance=covariance,
        prior=np.zeros((p, p)),
        prior_std=np.where(free, np.nan, 0.0),
        centre=description.vector(p),
        torque_size=size,
    )


def body_prior_of(identifier):
    """Return the `BodyPrior` of an identifier; None if its bodies are free."""
    bodies, features = identifier.bodies, identifier.features_
    if not isinstance(bodies, str) or bodies not in OPTIONS:
        raise ValueError(
            f"bodies must be one of {', '.join(map(repr, OPTIONS))}; got {bodies!r}."
        )
    prior = None
    if bodies != "free" and identifier.regressor is None:
        per_joint = features.n_parameters_ // features.n_joints_
        prior = BodyPrior.of(features.model_, per_joint, features.followers_)
    if bodies == "fixed" and (prior is None or identifier.used_gains is not None):
        raise ValueError(
            "bodies='fixed' cannot be combined with unknown gains, a regressor, or a "
            "description in which no body has mass and extension; use 'prior' or "
            "'free'."
        )
    return prior
