"""Bodies around their description: a prior whose scale is found body by body."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.special import softmax

from sklearn_vbjfa._core._groups import Groups
from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.model import joint_names, nominal_parameters, solid_bodies
from sklearn_vbjfa.physical import pseudo_inertia

# How far a description is expected to be off: a body's distance from it in each of ten
# directions, as a share of the body; half-Cauchy, so that a body may be off by much.
DESCRIBED = 0.2
# A parameter is from the description if its deviation is more than this share of that
# before the data.
_LITTLE = 0.7
# What departs as probably as the most probable body, within so many nats, is its rival.
RIVALS = 3.0
# Scales that are summed over, up to that at which a body is no longer consistent, and
# the share of the usual precision that a body keeps.
SCALES, _LEAST = np.geomspace(1e-4, 1.0, 81), 1e-4
# Deviations by which the common size of the bodies is another than one.
_FAR_OFF = 3.0
# From this factor on, another unit is more probable than one body that differs.
_OF_ONE = 20.0
# Mass of a body without mass, such as the frame between two hinges of one body, as a
# share of the mean one.
_MASSLESS = 1e-3
# Passes over all bodies, and the change of a mean in deviations that ends them.
_PASSES, _STAYS = 100, 1e-3
# Times that the common size of the bodies is asked for, and the change of it from which
# on they contradict it.
_TURNS, _CONTRADICTED = 20, 0.5
# Directions of the Gram matrix below this are never used.
_RANK = 1e-12
# Variances of a body below this share of its largest are rounding.
_ROUNDING = 1e-15
WAYS = ("prior", "free", "fixed")


@dataclass(frozen=True)
class Departure:
    """Bodies of which one is not as described."""

    # joints (that carry the bodies), the most probable first: another value of any of
    # them explains the torques about as well, within three nats
    bodies: tuple[str, ...]
    # how many times the body of the description each of them would be
    factors: tuple[float, ...]
    stds: tuple[float, ...]  # standard deviations of the factors
    # logarithm of the odds that the first of them departs further than descriptions
    # usually do, over that none does
    log_odds: float


def _rounder(P):
    """Pseudo-inertia of a body to which its mean extension is added on all sides."""
    # A thin rod whose description has its centre a little beside it is not far off.
    first, mass = P[:3, 3], P[3, 3]
    about = P[:3, :3] - np.outer(first, first) / mass
    out = P.copy()
    out[:3, :3] += np.trace(about) / 3.0 * np.eye(3)
    return out


def complete(model, bodies):
    """Bodies (n, 10) of a model, with balls in place of those that are not solid."""
    distances = [np.linalg.norm(x.translation) for x in model.jointPlacements[1:]]
    distances = [d for d in distances if d > 0]
    radius = 0.25 * (np.mean(distances) if distances else 1.0)
    solid, balls = solid_bodies(bodies), np.zeros(bodies.shape)
    balls[:, [4, 6, 9]] = 0.4 * radius**2
    balls[:, 0] = 1.0
    balls *= bodies[solid, 0].mean() if solid.any() else 1.0
    balls[bodies[:, 0] <= 0] *= _MASSLESS
    return np.where(solid[:, None], bodies, balls)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyPrior:
    """Bodies of a description as the centre of a prior."""

    # The distance of a body from its description is tr((P0^-1 dP)^2) with its
    # pseudo-inertia P0, the metric of Lee, Wensing and Park (IEEE Trans. Robotics
    # 36(2), 2020, doi:10.1109/TRO.2019.2926491) at P0; below one, the body is
    # consistent.

    names: tuple[str, ...]  # joints that carry the bodies
    places: np.ndarray  # (n, 10): where their parameters are among all
    centre: np.ndarray  # (n, 10): their parameters
    # (n, 10, 10): upper triangular R with distance |R d|^2 for a change d of a body
    root: np.ndarray

    @classmethod
    def of(cls, model, per_joint, followers=()):
        """Take the bodies of a model; None if none has mass and extension."""
        # What has no mass is near none, in comparison with a mean body; a mass without
        # extension is left free. followers: `FollowingBody` of the model, whose
        # parameters are behind those of its joints.
        names, starts = joint_names(model), per_joint * np.arange(model.nv)
        names = [*names, *(body.name for body in followers)]
        starts = np.r_[starts, per_joint * model.nv + 10 * np.arange(len(followers))]
        bodies = [*nominal_parameters(model), *(body.parameters for body in followers)]
        bodies = np.array(bodies)
        solid, massless = solid_bodies(bodies), bodies[:, 0] <= 0
        if not solid.any():
            return None
        centre = complete(model, bodies)
        bodies = np.where(massless[:, None], centre / _MASSLESS, centre)
        solid = np.flatnonzero(solid | massless)
        directions = pseudo_inertia(np.eye(10))
        roots = []
        for body in bodies[solid]:
            made = np.linalg.solve(_rounder(pseudo_inertia(body)), directions)
            metric = np.einsum("iab,jba->ij", made, made)
            roots.append(linalg.cholesky(0.5 * (metric + metric.T)))
        return cls(
            names=tuple(names[k] for k in solid),
            places=starts[solid, None] + np.arange(10),
            centre=centre[solid],
            root=np.array(roots),
        )

    def vector(self, p):
        """Parameters (p,) with the description in their places, zero elsewhere."""
        out = np.zeros(p)
        out[self.places] = self.centre
        return out

    def scaled(self, factor):
        """Return the same bodies larger, by one factor or one for each."""
        size = np.reshape(factor, (-1, 1, 1))
        return replace(self, centre=size[:, 0] * self.centre, root=self.root / size)

    def deviation(self, sites):
        """Deviations (n, 10) of the parameters at the scales of sites."""
        size = np.sqrt((np.linalg.inv(self.root) ** 2).sum(axis=2))
        return size * np.array([[site.scale] for site in sites])


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyPosterior:
    """Parameters that torques and a description determine together."""

    theta: np.ndarray  # (p,): posterior mean
    # (p, p): posterior; infinite on the diagonal where nothing tells a parameter
    covariance: np.ndarray
    prior: np.ndarray  # (p, p): precision of the prior
    # (p,): deviations of the prior, at the scales that bodies turned out to have; nan
    # for what the description does not say
    prior_std: np.ndarray
    centre: np.ndarray  # (p,): mean of the prior
    # bodies not as described, or what they cannot be told apart from
    departures: tuple[Departure, ...] = ()
    noise: float = 1.0  # variance that the normal equations were divided by
    common: float = 1.0  # size of all bodies together over the description
    # size of all torques over those that the bodies require, and its relative error
    torque_size: tuple[float, float] = (1.0, np.inf)


def little_learned(std, before):
    """Whether data leave most of the deviation that a description has."""
    with np.errstate(invalid="ignore"):
        return std >= _LITTLE * before


@dataclass(frozen=True, eq=False)
class Site:
    """What the prior of a body, or of alike joints, says in a Gaussian model."""

    # Its precision, the product of that with its mean, and the root mean square of the
    # scale that it turned out to have.

    precision: np.ndarray
    right: np.ndarray
    scale: float = DESCRIBED

    @classmethod
    def of_scale(cls, scale, size=10):
        return cls(np.eye(size) / scale**2, np.zeros(size), scale)


def _along(description, A, b):
    """Return the normal equation of the size of all bodies together, all else free."""
    # Its two sides, 0 first where nothing tells the size.
    centre = description.vector(b.size)
    rest = np.ones(b.size, dtype=bool)
    rest[description.places] = False
    across = A[rest] @ centre
    others = scaled_eigen(A[np.ix_(rest, rest)], _RANK)
    seen = centre @ A @ centre
    own = seen - across @ others.solve(across)
    product = centre @ b - across @ others.solve(b[rest])
    return own if own > _RANK * seen else 0.0, product


@dataclass(frozen=True, eq=False)
class _BodyProblem:
    """Normal equations A theta = b in units of the noise, with a description."""

    # Bodies are seen in coordinates in which their prior is round. `sized`: their
    # common size is that of the description.

    description: BodyPrior
    A: np.ndarray
    b: np.ndarray
    sized: bool = False

    def precision(self, sites):
        """Precision (p, p) of the prior with some sites."""
        out, root = np.zeros(self.A.shape), self.description.root
        own = np.array([site.precision for site in sites])
        at = self.description.places
        out[at[:, :, None], at[:, None, :]] = root.transpose(0, 2, 1) @ own @ root
        return 0.5 * (out + out.T)

    @property
    def centre(self):
        """The description among all parameters, (p,)."""
        return self.description.vector(self.b.size)

    def solved(self, sites):
        """Mean and root of the covariance of the change from the description."""
        # The last entry is the share by which all of its bodies together are larger.
        # The size of all bodies together is known to the usual share from `common`:
        # what a torque channel calls a newton metre is sometimes not known at all. It
        # is the last unknown, beside a matrix in which branches are apart.
        p, centre = self.b.size, self.centre
        across = self.A @ centre
        right = self.b - across
        of_size = centre @ right
        own = np.array([site.right for site in sites])
        root = self.description.root
        right[self.description.places] += np.einsum("kij,ki->kj", root, own)
        # A direction that neither torques nor description tell stays where it is.
        eigen = scaled_eigen(self.A + self.precision(sites), _RANK)
        mean, root = np.zeros(p + 1), np.zeros((p + 1, eigen.rank + 1))
        mean[:p], root[:p, :-1] = eigen.solve(right), eigen.inverse_root()
        if not self.sized:
            moved = np.append(-eigen.solve(across), 1.0)
            precision = centre @ across + DESCRIBED**-2 + across @ moved[:p]
            mean += moved * (of_size - across @ mean[:p]) / precision
            root[:, -1] = moved / np.sqrt(precision)
        return mean, root

    def marginals(self, sites):
        """Precisions (n, 10, 10) of bodies, and products with the means (n, 10)."""
        # Everything is in them.
        own, (mean, root) = self.description.root, self.solved(sites)
        around = own @ root[self.description.places]
        inverse = inverse_of(around @ around.transpose(0, 2, 1))
        mean = own @ mean[self.description.places][:, :, None]
        return inverse, (inverse @ mean)[:, :, 0]

    def log_evidence(self, sites):
        """Logarithm of the evidence at the scales of sites, up to a constant."""
        scale = np.array([site.scale for site in sites])
        # Mean and root of the covariance, of bodies and common size, in deviations.
        both = np.column_stack(self.solved([Site.of_scale(own) for own in scale]))
        theta = self.centre + both[:-1, 0] + both[-1, 0] * self.centre
        own = self.description.root / scale[:, None, None]
        own = (own @ both[self.description.places]).reshape(-1, both.shape[1])
        own = np.vstack([own, both[-1] / DESCRIBED])
        width = np.linalg.slogdet(own[:, 1:] @ own[:, 1:].T)[1]
        ratio = scale / DESCRIBED
        prior = np.log(ratio / (1 + ratio**2)).sum()
        explained = theta @ (self.b - 0.5 * self.A @ theta)
        return explained + 0.5 * (width - own[:, 0] @ own[:, 0]) + prior

    def sites(self):
        """Sites of the bodies, see `propagated`."""
        usual = [Site.of_scale(DESCRIBED)] * len(self.description.names)
        return propagated(usual, lambda sites: zip(*self.marginals(sites)))

    def departures(self):
        """Bodies larger or smaller than descriptions usually err, one by one."""
        # Everything else is as far off as usual: where all scales are open, each body
        # takes over a part of what another one lacks.
        names, root = self.description.names, self.description.root
        # The direction of a body that is more or less of the same.
        size = np.einsum("kij,kj->ki", root, self.description.centre)
        length = np.linalg.norm(size, axis=1)
        size /= length[:, None]
        # What has no mass is not a multiple of it.
        open_ = (length > 100 * _MASSLESS).astype(float)
        sites = [Site.of_scale(DESCRIBED)] * len(names)
        found = []
        while open_.any():
            precision, product = self.marginals(sites)
            both = np.stack([size, product], axis=2)
            both = np.einsum("ki,kij->kj", size, np.linalg.solve(precision, both))
            variance, q = both[:, 0], both[:, 1:] / both[:, :1]
            own = [x @ site.precision @ x for x, site in zip(size, sites)]
            H = np.maximum(1.0 / variance - own, 0.0)[:, None, None]
            groups = Groups(H=H, q=q, own=H[:, 0], unit=np.ones(q.shape))
            odds = groups.integrated(DESCRIBED, DESCRIBED) - np.log(len(names))
            wide = groups.best_scale(DESCRIBED)
            left = H[:, 0, 0] + wide**-2
            factors = 1.0 + q[:, 0] / left / length
            # No body weighs less than nothing: what asks for it is something else.
            odds = np.where((open_ > 0) & (factors > 0), odds, -np.inf)
            first = int(np.argmax(odds))
            if odds[first] <= 0:
                break
            near = np.flatnonzero(odds > odds[first] - RIVALS)
            near = near[np.argsort(-odds[near], kind="stable")]
            found.append(
                Departure(
                    bodies=tuple(names[k] for k in near),
                    factors=tuple(factors[near].tolist()),
                    stds=tuple((1.0 / np.sqrt(left) / length)[near].tolist()),
                    log_odds=float(odds[first]),
                )
            )
            along = size[first]
            opened = np.outer(along, along) * (wide[first] ** -2 - DESCRIBED**-2)
            usual = sites[first]
            sites[first] = Site(usual.precision + opened, usual.right)
            open_[near] = 0.0
        return tuple(found)


def inverse_of(covariance):
    """Inverses of covariances (..., k, k), the smallest deviations perhaps rounding."""
    size, axes = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    size = np.maximum(size, _ROUNDING * size[..., -1:])
    return (axes / size[..., None, :]) @ np.swapaxes(axes, -1, -2)


def propagated(sites, marginals):
    """Sites by expectation propagation: they match mean and covariance."""
    # T. Minka, UAI 2001; for scale mixtures M. Seeger, J. Machine Learning Research 9,
    # 2008. marginals: from sites to the precision and product of each, everything in.
    for number in range(_PASSES):
        share, moved, new = (0.5 if number else 1.0), 0.0, list(sites)
        every, alike = list(marginals(sites)), {}
        for k, (_, product) in enumerate(every):
            alike.setdefault(product.size, []).append(k)
        # Those of one size together.
        for places in alike.values():
            precision, product = (np.array(x) for x in zip(*[every[k] for k in places]))
            found, step = _matched(precision, product, [sites[k] for k in places])
            moved = max(moved, step)
            for k, one in zip(places, found):
                site = sites[k]
                new[k] = Site(
                    site.precision + share * (one.precision - site.precision),
                    site.right + share * (one.right - site.right),
                    one.scale,
                )
        sites = new
        if moved < _STAYS:
            break
    return sites


def _matched(precision, product, sites):
    """Sites with which bodies have the mean and covariance of their scale mixtures."""
    # precision (n, k, k), product (n, k): of the bodies with their present sites.
    # Returns the sites and how far a mean moves at most, in deviations.
    before, aim = (
        np.array([getattr(site, name) for site in sites])
        for name in ("precision", "right")
    )
    value, vectors = np.linalg.eigh(precision - before)
    back = np.swapaxes(vectors, 1, 2)
    value = np.maximum(value, 0.0)
    rest = _times(back, product - aim)
    s2, ratio = (SCALES**2)[:, None], SCALES / DESCRIBED
    spread = 1 + s2 * value[:, None]
    along = 0.5 * rest[:, None] ** 2 * s2 / spread - 0.5 * np.log(spread)
    prior = ratio / (1 + ratio**2)
    prior[[0, -1]] *= 0.5  # the trapezoidal rule
    weight = softmax(along.sum(axis=2) + np.log(prior), axis=1)
    variance = s2 / spread
    means = rest[:, None] * variance
    mean = _times(np.swapaxes(means, 1, 2), weight)
    away = means - mean[:, None]
    every = np.arange(mean.shape[1])
    covariance = np.swapaxes(away, 1, 2) @ (away * weight[:, :, None])
    covariance[:, every, every] += _times(np.swapaxes(variance, 1, 2), weight)
    data = np.zeros_like(covariance)
    data[:, every, every] = value
    # A prior takes no precision away.
    left, turned = np.linalg.eigh(inverse_of(covariance) - data)
    left = np.maximum(left, _LEAST / DESCRIBED**2)
    own = (turned * left[:, None]) @ np.swapaxes(turned, 1, 2)
    right = _times(own + data, mean) - rest
    moved = mean - _times(back, np.linalg.solve(precision, product[:, :, None])[..., 0])
    step = np.abs(moved) / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    scale = np.sqrt(weight @ s2[:, 0]).tolist()
    made = map(Site, vectors @ own @ back, _times(vectors, right), scale)
    return list(made), float(step.max())


def _times(matrices, vectors):
    """Products of matrices (n, i, j) and vectors (n, j), one by one."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def _one_differs(description, A, b, factor):
    """Find the body that differs most probably by a factor, all others as described."""
    # Returns the logarithm of the evidence, the problem and its sites. The logarithm of
    # the factor has a Cauchy distribution, in place of the body's own in the evidence.
    n, found = len(description.names), []
    for k in range(n):
        factors = np.where(np.arange(n) == k, factor, 1.0)
        problem = _BodyProblem(description.scaled(factors), A, b)
        sites = problem.sites()
        own = sites[k].scale / (np.sqrt(2 * np.pi) * DESCRIBED * n)
        found.append((problem.log_evidence(sites) + np.log(own), problem, sites))
    best = max(found, key=lambda one: one[0])
    return best[0] - np.log1p((np.log(factor) / DESCRIBED) ** 2), *best[1:]


def around(description, A, b):
    """Estimate parameters from normal equations A theta = b and a description."""
    # A (p, p) and b (p,) are in units of the noise; parameters without a prior are
    # free.
    # A description in other units, or torques in others, is thousands of times off. By
    # least squares one body that is heard well decides for all, until these contradict.
    own, product = _along(description, A, b)
    first = product / own if own > 0 and product > 0 else 1.0
    for _ in range(_TURNS):
        problem = _BodyProblem(description.scaled(first), A, b)
        sites = problem.sites()
        mean, root = problem.solved(sites)
        if abs(mean[-1]) < _CONTRADICTED:
            break
        first *= max(1.0 + mean[-1], _CONTRADICTED)
    common, std = first * (1.0 + mean[-1]), first * np.linalg.norm(root[-1])
    far_off = abs(common - 1.0) >= _FAR_OFF * std
    if far_off and 1 / _OF_ONE < common < _OF_ONE and len(sites) > 1:
        one = _one_differs(description, A, b, common)
        # Where both explain as much the unit of the torques is in doubt.
        if one[0] > problem.log_evidence(sites) + RIVALS:
            _, problem, sites = one
            first, (mean, root) = 1.0, problem.solved(sites)
    precision = problem.precision(sites)
    every = root @ root.T
    centre = problem.centre
    cross = np.outer(every[:-1, -1], centre)
    covariance = every[:-1, :-1] + cross + cross.T
    covariance = covariance + every[-1, -1] * np.outer(centre, centre)
    # The common size takes what the prior says of it.
    of_size = precision @ centre
    share = centre @ of_size + DESCRIBED**-2
    prior = precision - np.outer(of_size, of_size) / share
    seen = np.diagonal(A) + np.diagonal(prior) > 0
    covariance[~seen, ~seen] = np.inf
    before = np.full(b.size, np.nan)
    before[description.places] = problem.description.deviation(sites)
    common, common_std = first * (1.0 + mean[-1]), first * np.linalg.norm(root[-1])
    # Whether a body departs is asked of a description in the unit of the torques.
    if abs(common - 1.0) < _FAR_OFF * common_std:
        asked = _BodyProblem(description, A, b, sized=True)
    else:
        asked = problem
    return BodyPosterior(
        theta=centre + (mean[:-1] + mean[-1] * centre),
        covariance=covariance,
        prior=prior,
        prior_std=before,
        centre=centre + mean[-1] * centre,
        departures=asked.departures(),
        common=common,
        torque_size=(common, common_std / abs(common)),
    )


def as_described(description, A, b):
    """Estimate what is not in a description, with its bodies as they are in it."""
    # Parameters and result as of `around`.
    p = b.size
    free = np.ones(p, dtype=bool)
    free[description.places] = False
    theta = description.vector(p)
    found = scaled_eigen(A[np.ix_(free, free)], _RANK)
    theta[free] = found.solve((b - A @ theta)[free])
    covariance = np.zeros((p, p))
    covariance[np.ix_(free, free)] = found.inverse()
    lost = np.flatnonzero(free)[np.diagonal(A)[free] <= 0]
    own, product = _along(description, A, b)
    size = (product / own, np.sqrt(own) / product) if product > 0 < own else (1, np.inf)
    covariance[lost, lost] = np.inf
    return BodyPosterior(
        theta=theta,
        covariance=covariance,
        prior=np.zeros((p, p)),
        prior_std=np.where(free, np.nan, 0.0),
        centre=description.vector(p),
        torque_size=size,
    )


def described_bodies(settings):
    """Return the `BodyPrior` that an identifier's bodies are near; None if free."""
    bodies, features = settings.bodies, settings.features_
    if not isinstance(bodies, str) or bodies not in WAYS:
        raise ValueError(
            f"bodies must be one of {', '.join(map(repr, WAYS))}; got {bodies!r}."
        )
    found = None
    if bodies != "free" and settings.asked_gains is None and settings.regressor is None:
        per_joint = features.n_parameters_ // features.n_joints_
        found = BodyPrior.of(features.model_, per_joint, features.followers_)
    if bodies == "fixed" and found is None:
        raise ValueError(
            "bodies='fixed' cannot be combined with unknown gains, a regressor, or a "
            "description in which no body has mass and extension; use 'prior' or "
            "'free'."
        )
    return found
