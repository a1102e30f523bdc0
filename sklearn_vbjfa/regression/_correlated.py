"""Fit of the model with correlated latents: dependencies, relevance, noise.

Tags such as [C15] are equations of ``docs/theory.rst``.
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
# Largest noise fraction of an input's variance under the prior: inputs that were chosen
# as predictors are assumed to be signal for at least two thirds.
LARGEST_FRACTION = 1 / 3
# Samples per input from which each input has a separate precision, and second moments
# bound the inputs' noise.
SAMPLES_PER_INPUT = 2

# Options of the two regressions for few samples. With the Gamma shape 0.5 coefficients
# have a Cauchy prior: an input must improve the fit by more than the best of many do by
# chance.
PRIORS = {"ard_shape": 0.5}, {"common": True}
# Corrections of the bound, for each coefficient and once, that separate few from many
# relevant inputs best: q(beta) q(alpha) loses 0.4 for a pruned coefficient, and the
# prior of a common precision spans fourteen units of its logarithm.
UNKNOWN, KNOWN = (0.55, -6.0), (0.4, -11.8)


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
    # noise: validated input noise, None if unknown; dof: degrees of freedom of its
    # estimate; cross (d,): its covariance with the noise of y. For noiseless queries
    # exactly dependent inputs are reduced to their generators and only relevant ones
    # are fitted, with a common precision; noisy queries use all inputs, see `_average`.
    m = data.moments
    d = m.xx.size

    def solve(m, psi, **options):
        return solve_correlated(m, psi, max_iter=max_iter, tol=tol, **options)

    psi = standard_noise(noise, data)
    if psi is not None:
        warn_of_excess(data, psi, labels, cross=cross, dof=dof)
    if m.n <= SAMPLES_PER_INPUT * d:
        return _fit_few(m, psi, solve, cross, dof)
    # Zero noise is Bayesian ARD regression; a full covariance uses all inputs.
    if noise is not None and (np.ndim(noise) == 2 or not np.any(noise)):
        return _fit_all(m, psi, solve, cross, dof)
    R, r = m.S / m.n, m.xy / m.n
    exact = np.zeros((d, d))
    ard, in_common = solve(m, exact), solve(m, exact, common=True)
    dependencies = find_dependencies(R)
    basis = dependencies.basis
    kept = _relevant_inputs(m, basis, ard, solve)
    at = basis[kept]
    is_known = psi is not None
    if not is_known:
        psi = np.zeros((d, d))
        psi[at, at] = 0.5 * largest_noise_fraction(R[np.ix_(at, at)], r[at])
    if cross is None:
        cross = np.zeros(d)

    def solve_of(chosen, psi):
        return solve(m.columns(chosen), psi, common=True, cross=cross[chosen])

    solution = solve_of(at, psi[np.ix_(at, at)])
    coef = np.zeros(basis.size)
    coef[kept] = solution.state.beta_mean
    # The covariance includes the inputs that were not selected.
    of_basis, of_end = m.columns(basis), psi[np.ix_(basis, basis)]
    if not is_known:
        of_end = _largest_admissible(of_basis) * np.eye(basis.size)
    cov = _uncertainty(of_basis, of_end, coef, solve_of(basis, of_end), dof)
    if not is_known:
        none = np.zeros_like(of_end)
        other = in_common if basis.size == d else solve_of(basis, none)
        cov = 0.5 * (cov + _uncertainty(of_basis, none, coef, other, dof))  # [C17]
    spread = _spread(R, basis, dependencies.copies)
    coef, cov = spread @ coef, spread @ cov @ spread.T
    # Only the prior determines how dependent inputs share a coefficient.
    null = scaled_eigen(R, _DEPENDENT, scale=1.0).null_space
    split = null @ null.T
    cov += split @ _uncertainty(m, exact, coef, in_common) @ split
    relevant = np.zeros(d, dtype=bool)
    copies = [dependencies.copies[k] for k in np.flatnonzero(kept)]
    relevant[np.concatenate(copies)] = True
    noisy = _average(m, ard, in_common)
    noise = _output_noise(psi[np.ix_(at, at)], solution)
    return CorrelatedFit(
        noisy=noisy,
        noiseless=LinearModel(
            coef,
            cov,
            noise,
            # At the other end, exact inputs, y has the noise of noisy queries.
            open_noise=0.0 if is_known else max(noisy.noise - noise, 0.0),
        ),
        noisy_solution=ard,
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
    """Fit few samples per input, whose smallest eigenvalues are due to chance."""
    # They can neither show dependencies nor bound an unknown noise.
    exact = np.zeros_like(m.S)
    # The floor keeps the rounding errors of an interpolation from counting as noise.
    solution, in_common = (
        solve(m, exact, floor=OUTPUT_FLOOR, **prior) for prior in PRIORS
    )
    state = solution.state
    noisy = noiseless = _average(m, solution, in_common, evidence=UNKNOWN)
    if psi is not None and psi.any():
        noiseless = _calibrated(m, psi, solve, cross, dof)
    relevant = state.beta_mean**2 > RELEVANT_DEVIATIONS**2 * np.diagonal(state.beta_cov)
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
    solutions, exact = [], np.zeros_like(psi)
    for prior in PRIORS:
        beta = solve(expected, exact, **prior).state.beta_mean
        # The noise of y given x is at least that of beta't.
        least = beta @ P @ beta
        solutions.append(solve(expected, exact, floor=least, **prior))
    # As with many samples, relevant inputs have a common precision.
    ard, coef = solutions[0], np.zeros(d)
    kept = _relevant_inputs(expected, np.arange(d), ard, solve)
    least = ard.state.beta_mean @ P @ ard.state.beta_mean
    none = exact[np.ix_(kept, kept)]
    few = solve(expected.columns(kept), none, common=True, floor=least).state
    coef[kept] = few.beta_mean
    solutions[0] = replace(ard, state=replace(few, beta_mean=coef))
    model = _average(m, *solutions, evidence=KNOWN)
    beta, state = model.coef, solutions[1].state
    noise = max(model.noise - beta @ P @ beta, 0.0)
    # Sampling errors of the input covariance (n samples) and of psi, see [C14].
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
    # The ARD posterior conditions on the precisions, so that pruned coefficients get
    # almost no variance. A common precision, estimated from all coefficients, avoids
    # that; the difference of both estimates is added to the covariance.
    cov = posterior_covariance(m.n, psi, in_common, dof)
    return cov + _square(in_common.state.beta_mean - coef)


def _noisy_model(m, solution, solve, cross):
    """Model of y given noisy inputs: c = H'beta, its variance v and uncertainty."""
    # v is psi_y + beta'P beta, without the direct gain from the noise of the inputs.
    # The covariance of c is that of a regression on the noisy inputs, see
    # `_uncertainty`.
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
    # The smallest eigenvalue of n rows is biased by (n - d) / n, since d coefficients
    # were fitted to find it. Above the smallest eigenvalue of R no signal is left.
    largest = largest_noise_fraction(R, r) * n / max(n - d, 1)
    no_signal = max(float(linalg.eigvalsh(R, subset_by_index=[0, 0])[0]), 0.0)
    return min(largest, LARGEST_FRACTION, no_signal)


def _average(m, solution, other, *, evidence=None):
    """Model for noisy queries: the mean of two regressions on the noisy inputs."""
    # Separate precisions suit few relevant inputs, a common precision suits many. With
    # many samples their mean is nearly as good as the better one, and their difference
    # is added to the covariance. With few samples the evidence weights them, since the
    # wrong one fits badly.
    share = 0.5
    if evidence is not None:
        gain = solution.history[-1] - other.history[-1]
        share = float(expit(gain + evidence[0] * m.xx.size + evidence[1]))
    first, second = solution.state, other.state
    coef = share * first.beta_mean + (1 - share) * second.beta_mean
    cov = second.beta_cov + _square(second.beta_mean - coef)
    return LinearModel(
        coef=coef, cov=cov, noise=share * first.psi_y + (1 - share) * second.psi_y
    )


def _relevant_inputs(m, basis, ard, solve):
    """Find inputs that help to predict y: ARD on noisy inputs, 2 deviations."""
    # Noisy inputs suffice: an input that is independent of y has a zero coefficient
    # there too, and the correction for noise would cost power.
    state = ard.state
    if basis.size < m.xx.size:
        exact = np.zeros((basis.size, basis.size))
        state = solve(m.columns(basis), exact).state
    score = state.beta_mean**2 / np.diagonal(state.beta_cov)
    kept = score > RELEVANT_DEVIATIONS**2
    if not kept.any():
        kept[np.argmax(score)] = True
    return kept


def _spread(R, at, copies):
    """Matrix (d, k) that divides coefficients of columns `at` among exact copies."""
    # Copies are indistinguishable: each standardised column gets the same share, with
    # the sign of its correlation.
    spread = np.zeros((R.shape[0], at.size))
    for k, (j, group) in enumerate(zip(at, copies)):
        sign = np.ones(1) if group.size == 1 else np.sign(R[j, group])
        spread[group, k] = sign / group.size
    return spread


# -- exactly dependent inputs ----------------------------------------------------------

# Share of a standardised column's variance below which a dependency counts as exact:
# a generous bound on the rounding of second moments.
_DEPENDENT = 1e-9
# Largest number of dependent columns for the search for extreme rays.
_MOST_RAYS = 500


# Columns that generate all others, ascending, and the exact copies of each.
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
    remaining, groups = list(columns), []
    while remaining:
        j = remaining[0]
        same = [k for k in remaining if abs(R[j, k]) > 1 - _DEPENDENT]
        groups.append(np.array(same))
        remaining = [k for k in remaining if k not in same]
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
    """Columns that pivoting takes first, each the farthest from the previous ones."""
    # Rounded, so that ties are resolved by the order of the columns.
    S = np.round(R[np.ix_(columns, columns)] / _DEPENDENT)
    pivots = lapack.dpstrf(S * _DEPENDENT, tol=0.0)[1]
    return columns[pivots[:rank] - 1]
