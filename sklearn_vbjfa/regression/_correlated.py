"""How the model with correlated latents is fitted: dependencies, relevance, noise.

Tags such as [C15] are equations of the guide.
"""

from collections import namedtuple
from dataclasses import replace

import numpy as np
from scipy import linalg, optimize
from scipy.linalg import lapack
from scipy.special import expit

from sklearn_vbjfa._core._correlated import (
    direct_share,
    infer_latent,
    posterior_covariance,
    solve_correlated,
)
from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa._core._moments import OUTPUT_FLOOR
from sklearn_vbjfa._core._updates import LinearModel
from sklearn_vbjfa.regression._base import standard_noise, warn_of_excess

# An input is relevant when its coefficient is more than this many posterior standard
# deviations away from zero.
RELEVANT_DEVIATIONS = 2.0
# Largest fraction of an input's variance that the prior takes for noise: an input that
# someone measured in order to predict with it is signal for two thirds at least.
LARGEST_FRACTION = 1 / 3
# Samples per input from which on each input has a precision of its own, and second
# moments say something of the inputs' noise.
SAMPLES_PER_INPUT = 2


# What the bound has less for each further precision, whose prior spreads over fourteen
# units of its logarithm, than it has for a prior over two.
PRECISION_COST = float(-np.log(1e-6)) - 2.0
# What it lacks for each coefficient beyond the number of samples, whose posterior is
# its prior: q(beta) q(alpha) loses 0.6 of it, and half a unit tells best.
UNDETERMINED = 0.5


# In standardised units, over all active columns: linear models for the two kinds of
# queries, the solutions that they come from, relevant inputs (d,), input noise (d, d).
CorrelatedFit = namedtuple(
    "CorrelatedFit", "noisy noiseless noisy_solution noiseless_solution relevant psi"
)


def largest_noise_fraction(R, r):
    """Largest input-noise fraction that correlations R (d, d), r (d,) admit, [C15]."""
    given_output = R - np.outer(r, r)
    smallest = linalg.eigvalsh(given_output, subset_by_index=[0, 0])[0]
    return float(min(LARGEST_FRACTION, max(smallest, 0.0)))  # [C15]


def fit_correlated(data, noise, labels, *, max_iter, tol, cross=None, dof=np.inf):
    """Fit the model to standardised data and its moments as a scatter matrix."""
    # noise: the user's, validated; None estimates it, `dof` are the degrees of freedom
    # with which it was; cross (d,): its covariance with that of y. With a selection,
    # for noiseless queries, exactly dependent inputs are reduced to their generators
    # and only relevant ones are fitted, with one precision in common; noisy queries are
    # then answered by all inputs as they are, see `_average`.
    m = data.moments
    d = m.xx.size

    def solve(m, psi, **options):
        return solve_correlated(m, psi, max_iter=max_iter, tol=tol, **options)

    psi = standard_noise(noise, data)
    if psi is not None:
        excess = np.diagonal(psi) / np.diagonal(m.S / m.n) > 1 + 1e-9
        warn_of_excess(data, excess, labels)
    if m.n <= SAMPLES_PER_INPUT * d:
        return _fit_few(m, psi, solve, cross, dof)
    # Zero noise is Bayesian ARD regression; a covariance is taken at its word.
    if noise is not None and (np.ndim(noise) == 2 or not np.any(noise)):
        return _fit_all(m, psi, solve, cross, dof)
    R, r = m.S / m.n, m.xy / m.n
    exact = np.zeros((d, d))
    as_they_are, in_common = solve(m, exact), solve(m, exact, common=True)
    found = find_dependencies(R)
    basis = found.basis
    kept = _relevant_inputs(m, basis, as_they_are, solve)
    at = basis[kept]
    given = psi is not None
    if not given:
        psi = np.zeros((d, d))
        psi[at, at] = 0.5 * largest_noise_fraction(R[np.ix_(at, at)], r[at])
    if cross is None:
        cross = np.zeros(d)

    def solve_of(chosen, psi):
        return solve(m.columns(chosen), psi, common=True, cross=cross[chosen])

    solution = solve_of(at, psi[np.ix_(at, at)])
    coef = np.zeros(basis.size)
    coef[kept] = solution.state.beta_mean
    # The inputs that were switched off belong to what is not known.
    of_basis, of_end = m.columns(basis), psi[np.ix_(basis, basis)]
    if not given:
        of_end = _largest_admissible(of_basis) * np.eye(basis.size)
    cov = _uncertainty(of_basis, of_end, coef, solve_of(basis, of_end), dof)
    if not given:
        none = np.zeros_like(of_end)
        other = in_common if basis.size == d else solve_of(basis, none)
        cov = 0.5 * (cov + _uncertainty(of_basis, none, coef, other, dof))  # [C17]
    spread = _spread(R, basis, found.copies)
    coef, cov = spread @ coef, spread @ cov @ spread.T
    # How dependent inputs share a coefficient is known from the prior alone.
    null = scaled_eigen(R, _DEPENDENT, scale=1.0).null_space
    split = null @ null.T
    cov += split @ _uncertainty(m, exact, coef, in_common) @ split
    relevant = np.zeros(d, dtype=bool)
    relevant[np.concatenate([found.copies[k] for k in np.flatnonzero(kept)])] = True
    noisy = _average(m, as_they_are, in_common)
    noise = _output_noise(psi[np.ix_(at, at)], solution)
    return CorrelatedFit(
        noisy=noisy,
        noiseless=LinearModel(
            coef,
            cov,
            noise,
            # Of exact inputs, the other end, y has the noise that it has of noisy ones.
            open_noise=0.0 if given else max(noisy.noise - noise, 0.0),
        ),
        noisy_solution=as_they_are,
        noiseless_solution=solution,
        relevant=relevant,
        psi=psi,
    )


def _fit_all(m, psi, solve, cross, dof):
    """Fit all inputs with a known noise covariance (d, d), for both queries."""
    solution = solve(m, psi, cross=cross)
    state, latent = solution.state, solution.latent
    in_common = solve(m, psi, common=True, cross=cross)
    cov = _uncertainty(m, psi, state.beta_mean, in_common, dof)
    noiseless = LinearModel(
        coef=state.beta_mean, cov=cov, noise=_output_noise(psi, solution)
    )
    noisy = noiseless
    if not latent.exact:
        noisy = _noisy_model(m, solution, solve, cross)
    variance = np.diagonal(posterior_covariance(m.n, psi, solution, dof))
    relevant = state.beta_mean**2 > RELEVANT_DEVIATIONS**2 * variance
    return CorrelatedFit(noisy, noiseless, solution, solution, relevant, psi)


def _fit_few(m, psi, solve, cross, dof):
    """Fit few samples per input, whose smallest eigenvalues are those of chance."""
    # These would decide on dependencies, and bound an unknown noise.
    exact = np.zeros_like(m.S)
    # Interpolation leaves no noise but rounding, which must not decide.
    solution, in_common = (
        solve(m, exact, common=one, floor=OUTPUT_FLOOR) for one in (False, True)
    )
    state = solution.state
    variance = np.diagonal(state.beta_cov)
    noisy = noiseless = _average(m, solution, in_common, evidence=0.0)
    if psi is not None and psi.any():
        noiseless = _calibrated(m, psi, solve, cross, dof)
    relevant = state.beta_mean**2 > RELEVANT_DEVIATIONS**2 * variance
    psi = exact if psi is None else psi
    return CorrelatedFit(noisy, noiseless, solution, solution, relevant, psi)


def _calibrated(m, psi, solve, cross, dof):
    """Model of y given noiseless inputs: regression of few samples on E[t | x]."""
    n, d = m.n, m.xx.size
    # Correlations of few samples are shrunk (Chen, Wiesel, Eldar and Hero, 2010).
    squares = np.vdot(m.S, m.S) / n**2
    share = (squares + d**2) / max(squares + d**2, (n + 1) * (squares - d))
    shrunk = (1 - share) * m.S + share * n * np.eye(d)
    latent = infer_latent(shrunk, n, psi)
    P = latent.P
    direct = np.zeros(d) if cross is None else direct_share(psi, cross)
    expected = replace(m, R=m.R @ latent.H.T, z=m.z - m.R @ direct)
    found, exact = [], np.zeros_like(psi)
    for common in (False, True):
        beta = solve(expected, exact, common=common).state.beta_mean
        # The noise of y given x is at least that of beta't.
        least = beta @ P @ beta
        found.append(solve(expected, exact, common=common, floor=least))
    # As with many samples, relevant inputs have one precision in common.
    ard, coef = found[0], np.zeros(d)
    kept = _relevant_inputs(expected, np.arange(d), ard, solve)
    least = ard.state.beta_mean @ P @ ard.state.beta_mean
    none = exact[np.ix_(kept, kept)]
    few = solve(expected.columns(kept), none, common=True, floor=least).state
    coef[kept] = few.beta_mean
    found[0] = replace(ard, state=replace(few, beta_mean=coef))
    model = _average(m, *found, evidence=UNDETERMINED * max(d - n, 0))
    beta, state = model.coef, found[1].state
    noise = max(model.noise - beta @ P @ beta, 0.0)
    # Errors of both covariances: that of the inputs is known from n samples, see [C14].
    A, moved = n * state.beta_cov @ latent.H / state.psi_y, psi @ beta
    through, size = beta @ moved, (beta - latent.H.T @ beta) @ moved
    middle = (size * shrunk / n + _square(moved)) / n
    v = noise + through if direct.any() else through
    middle += (v * psi + _square(moved)) / dof
    return LinearModel(
        coef=beta + direct,
        cov=model.cov + A @ middle @ A.T,
        noise=noise + direct @ psi @ direct,
    )


def _uncertainty(m, psi, coef, in_common, dof=np.inf):
    """Second moment (d, d) about `coef` of the posterior with one common precision."""
    # A posterior under automatic relevance determination takes the precisions for
    # known: of a coefficient that it has switched off, or nearly, it says that it is
    # zero. One precision, known from all coefficients together, does not. What both
    # disagree in belongs to what is not known.
    cov = posterior_covariance(m.n, psi, in_common, dof)
    return cov + _square(in_common.state.beta_mean - coef)


def _noisy_model(m, solution, solve, cross):
    """Model of y given noisy inputs: c = H'beta, its variance v and uncertainty."""
    # v is psi_y + beta'P beta, less what noise of the inputs does to y directly. That
    # of c is what a regression on the inputs as they are
    # leaves open, see `_uncertainty`.
    beta, latent = solution.beyond, solution.latent
    coef = latent.H.T @ beta + solution.direct  # [C5]
    exact = np.zeros_like(m.S)
    in_common = solve(m, exact, common=True, cross=cross)
    return LinearModel(
        coef=coef,
        cov=_uncertainty(m, exact, coef, in_common),
        noise=solution.state.psi_y + beta @ latent.P @ beta,  # [C5]
    )


def _output_noise(psi, solution):
    """Variance of y given noiseless inputs."""
    b = solution.direct
    return solution.state.psi_y + float(b @ psi @ b)


def _square(x):
    return np.outer(x, x)


def _largest_admissible(m):
    """Largest fraction of noise, f of [C16], that moments `m` admit."""
    n, d = m.n, m.xx.size
    R, r = m.S / n, m.xy / n
    # The smallest eigenvalue of n rows is too small by (n - d) / n in the mean, for d
    # coefficients were fitted to find it. Beyond that of R there is no signal left.
    largest = largest_noise_fraction(R, r) * n / max(n - d, 1)
    no_signal = max(float(linalg.eigvalsh(R, subset_by_index=[0, 0])[0]), 0.0)
    return min(largest, LARGEST_FRACTION, no_signal)


def _average(m, solution, other, *, evidence=None):
    """Answer to noisy queries: the mean of two regressions on the noisy inputs."""
    # One gives each input a precision of its own, which suits few relevant inputs;
    # the other one precision to all, which suits many. With many samples nothing tells
    # beforehand which suits; their mean is nearly as good as the better one, and what
    # they differ in is not known. Few samples fit the wrong one badly.
    share = 0.5
    if evidence is not None:
        gain = solution.history[-1] - other.history[-1] + evidence
        share = float(expit(gain + (m.xx.size - 1) * PRECISION_COST))
    first, second = solution.state, other.state
    coef = share * first.beta_mean + (1 - share) * second.beta_mean
    cov = second.beta_cov + _square(second.beta_mean - coef)
    return LinearModel(
        coef=coef, cov=cov, noise=share * first.psi_y + (1 - share) * second.psi_y
    )


def _relevant_inputs(m, basis, as_they_are, solve):
    """Find inputs that help to predict y: ARD on noisy inputs, 2 deviations."""
    # Asked of the noisy inputs on purpose: an input that has nothing to do with y has
    # a zero coefficient there too, and the test has not lost power to the correction.
    state = as_they_are.state
    if basis.size < m.xx.size:
        exact = np.zeros((basis.size, basis.size))
        state = solve(m.columns(basis), exact).state
    score = state.beta_mean**2 / np.diagonal(state.beta_cov)
    kept = score > RELEVANT_DEVIATIONS**2
    if not kept.any():
        kept[np.argmax(score)] = True
    return kept


def _spread(R, at, copies):
    """Matrix (d, k) that gives the columns `at` and their exact copies their shares."""
    # Nothing tells copies apart: in standardised columns each takes the same part,
    # with the sign of its correlation.
    spread = np.zeros((R.shape[0], at.size))
    for k, (j, group) in enumerate(zip(at, copies)):
        sign = np.ones(1) if group.size == 1 else np.sign(R[j, group])
        spread[group, k] = sign / group.size
    return spread


# -- exactly dependent inputs ----------------------------------------------------------

# Share of a standardised column's variance below which a dependency counts as exact:
# a generous bound on the rounding of second moments.
_DEPENDENT = 1e-9
# Beyond this many dependent columns the search for extreme rays is not worth its cost.
_MOST_RAYS = 500


# Columns that generate all others, ascending, and each with its exact copies.
Dependencies = namedtuple("Dependencies", "basis copies")


def find_dependencies(R):
    """Find the generating columns from the correlation matrix R (d, d)."""
    # Second moments do not determine which columns generate the rest, but two unit-free
    # rules do: the extreme rays of the cone of all, if these are as few as the span has
    # dimensions; else, one by one, the column farthest from the span.
    d = R.shape[0]
    eigen = scaled_eigen(R, _DEPENDENT, scale=1.0)
    if eigen.rank == d:
        return Dependencies(np.arange(d), tuple(np.arange(d)[:, None]))
    involved = eigen.lost(1e-6)
    groups, free = _copies(R, np.flatnonzero(involved)), np.flatnonzero(~involved)
    first = np.array([group[0] for group in groups])
    rank = eigen.rank - free.size
    # Columns as points: F'F = R without the null space.
    rays = _extreme_rays(eigen.root(), first) if first.size <= _MOST_RAYS else None
    chosen = rays
    if rays is None or rays.size != rank:
        chosen = _largest_volume(R, first, rank)
    members = {int(group[0]): group for group in [*groups, *free[:, None]]}
    basis = np.sort(np.concatenate([free, chosen]))
    return Dependencies(basis, tuple(members[int(j)] for j in basis))


def _copies(R, columns):
    """Group columns that are multiples of each other."""
    waiting, groups = list(columns), []
    while waiting:
        j = waiting[0]
        same = [k for k in waiting if abs(R[j, k]) > 1 - _DEPENDENT]
        groups.append(np.array(same))
        waiting = [k for k in waiting if k not in same]
    return groups


def _extreme_rays(F, columns):
    """Columns that are not non-negative combinations of the others."""
    kept = list(columns)
    for j in columns:
        others = [k for k in kept if k != j]
        if not others:
            break
        _, distance = optimize.nnls(F[:, others], F[:, j])
        if distance < np.sqrt(_DEPENDENT):
            kept.remove(j)
    return np.array(kept)


def _largest_volume(R, columns, rank):
    """Columns that pivoting takes first, each the farthest from those before."""
    # Rounded: the first of those that rounding does not tell apart.
    S = np.round(R[np.ix_(columns, columns)] / _DEPENDENT)
    pivots = lapack.dpstrf(S * _DEPENDENT, tol=0.0)[1]
    return columns[pivots[:rank] - 1]
