"""Frequency-domain regression against dense least squares and densities."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.fft import dct
from scipy.signal import lfilter

from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.search._cosines import Spectrum
from sklearn_vbjfa.diagnosis.search._problem import (
    Columns,
    DeclaredFit,
    Fit,
    Problem,
    SelectedEffect,
    _chance_limit,
    _joint_columns,
    spectral_fit,
    spectrum_of,
)
from sklearn_vbjfa.effects import Coulomb, Drift, JointZero, Offset, Payload, Spring
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import CLEAN, coulomb, search, spring

NV, N, R = 3, 60, 4
ZERO = JointZero(1, 0.3)
SPECTRUM = Spectrum(variance=np.ones((NV, N)), log_prior=-1.5)


class Synthetic(Problem):
    """Random equations; each cosine is one band."""

    def __init__(self, Z, y, heard):
        self.edges = bands = np.arange(N + 1)
        self.Z, self.y, self.used_joints = Z, y, heard
        self.view = SimpleNamespace(one_sided=np.zeros((NV, 1, R)))
        self.at_zero, self.joint_columns = np.zeros((NV, 1), dtype=bool), _joint_columns
        self.cosines = SimpleNamespace(
            fill=np.ones(NV), band=bands[:-1], edges=bands, octave=bands[:-1]
        )


def problem(seed=0, loud=1.0):
    """Equations of three joints, the last of which is unused, and weights.

    `loud` : ratio of the largest to the smallest column, and of the weights.
    """
    rng = np.random.default_rng(seed)
    Z = rng.normal(size=(NV, N, R)) * np.geomspace(1, loud, R)
    y = Z @ (rng.normal(size=R) / np.geomspace(1, loud, R)) + rng.normal(size=(NV, N))
    weights = rng.uniform(0.2, 2.0, size=(NV, N)) * np.geomspace(loud, 1, N)
    heard = np.array([True, True, False])
    Z[2] = y[2] = weights[2] = 0.0
    return Synthetic(Z, y, heard), weights


def member(effect, joints, k, seed, scale=0.5):
    """Make a model member with random columns on some joints."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(len(joints), N, 1, k))
    unit, edges = np.linspace(0.5, 2.0, k)[None], np.arange(N + 1)
    return Columns([effect], joints, values, unit, edges).member(scale=scale)


MEMBERS = (
    member(Spring(0), (0,), 2, 1),
    member(Coulomb(1), (1,), 1, 2, scale=3.0),
    member(ZERO, (0, 1, 2), 1, 3),
)


def of(members, seed=0, loud=1.0):
    made, weights = problem(seed, loud)
    return Fit(DeclaredFit(made, weights, SPECTRUM), members)


def dense(fit):
    """Weighted rows of all joints (A, b), precision and mean of the prior."""
    blocks = [fit.problem.Z]
    precision, mean = [np.zeros(fit.problem.Z.shape[2])], [np.zeros(R)]
    for member in fit.members:
        X = np.zeros((NV, N, member.width))
        X[list(member.joints)] = member.columns.values[:, :, 0]
        blocks.append(X)
        precision.append(1.0 / (member.scale * member.unit) ** 2)
        mean.append(-member.applied)
    root = np.sqrt(fit.base.weights)
    A = (np.concatenate(blocks, axis=2) * root[:, :, None]).reshape(NV * N, -1)
    return A, (fit.problem.y * root).ravel(), np.concatenate(precision), np.hstack(mean)


def solution(fit):
    """Posterior mean and covariance by stacked least squares."""
    A, b, precision, mean = dense(fit)
    rows = np.vstack([A, np.diag(np.sqrt(precision))])
    values = np.r_[b, np.sqrt(precision) * mean]
    estimate = np.linalg.lstsq(rows, values, rcond=None)[0]
    return estimate, np.linalg.inv(rows.T @ rows)


SUBSETS = [c for k in range(4) for c in itertools.combinations(MEMBERS, k)]


@pytest.mark.parametrize("members", SUBSETS, ids=len)
def test_fit_matches_regularised_least_squares(members):
    fit = of(members)
    mean, _ = solution(fit)
    assert_allclose(fit.theta, mean[:R], rtol=1e-6)
    for i, place in enumerate(fit.slices):
        columns = slice(R + place.start, R + place.stop)
        assert_allclose(fit.coefficients(i), mean[columns], rtol=1e-6)
    A, b, *_ = dense(fit)
    residual = ((b - A @ mean) / np.sqrt(fit.base.weights.ravel() + 1e-300))[: 2 * N]
    assert_allclose(fit.residual[:2].ravel(), residual, atol=1e-6)


def test_negative_friction_is_fixed_at_zero():
    free = of(MEMBERS)
    row = np.array([0.0, 1.0, -2.0, 0.5])
    row *= -np.sign(row @ free.theta)
    free.problem.view.one_sided[1, 0] = row
    held = free.with_valid_signs(3.0)
    assert held.with_valid_signs(3.0) is held
    # Least squares in the subspace where this friction is zero.
    A, b, precision, mean = dense(free)
    basis = np.eye(A.shape[1])[:, 1:]
    basis[:R, : R - 1] = np.linalg.svd(row[None])[2][1:].T
    X = np.vstack([A, np.diag(np.sqrt(precision))]) @ basis
    reduced = np.linalg.lstsq(X, np.r_[b, np.sqrt(precision) * mean], rcond=None)[0]
    assert_allclose(held.theta, (basis @ reduced)[:R], atol=1e-4)
    free.problem.view.one_sided[:] *= -1
    assert_allclose(held.with_valid_signs(3.0).theta, free.theta, rtol=1e-9)


def test_insignificantly_negative_friction_stays_free():
    free = of(MEMBERS)
    row = np.array([0.0, 1.0, -2.0, 0.5])
    errors = row @ free.theta / np.sqrt(row @ solution(free)[1][:R, :R] @ row)
    free.problem.view.one_sided[0, 0] = -np.sign(errors) * row
    assert free.with_valid_signs(1.01 * abs(errors)) is free
    assert free.with_valid_signs(0.99 * abs(errors)) is not free


def log_density(fit):
    """Log density of the torques orthogonal to the declared columns.

    Computed with the dense covariance.
    """
    A, b, precision, mean = dense(fit)
    heard = np.repeat(fit.problem.used_joints, N)
    A, b = A[heard], b[heard]
    basis, _, _ = np.linalg.svd(A[:, :R])
    K = basis[:, R:]
    X = K.T @ A[:, R:]
    covariance = np.eye(K.shape[1]) + X / precision[R:] @ X.T
    residual = K.T @ b - X @ mean[R:]
    power = residual @ np.linalg.solve(covariance, residual)
    return -0.5 * (power + np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("loud", [1.0, 1e3])
def test_log_evidence_matches_the_dense_density(loud):
    """Up to a constant that is common to models with the same weights."""
    fits = [of(members, loud=loud) for members in SUBSETS]
    logs = np.array([fit.log_evidence() for fit in fits])
    expected = np.array([log_density(fit) for fit in fits])
    assert_allclose(logs - logs[0], expected - expected[0], atol=1e-4)


def test_log_evidence_includes_the_prior_of_the_spectrum():
    """Changes of the log-log slope between bands have a standard normal prior."""
    octave = np.array([0.5, 1.0, 1.5, 2.5, 3.0])
    power = np.random.default_rng(0).gamma(5.0, size=(1, 5)) * np.geomspace(9, 1, 5)
    spectrum = Spectrum.of(power, np.full((1, 5), 10.0), octave, 1.0)
    slopes = np.diff(np.log(spectrum.variance[0])) / np.diff(octave)
    expected = -0.5 * ((0.5 * np.diff(slopes)) ** 2).sum()
    assert expected < -0.01
    equations, weights = problem()
    logs = [
        Fit(DeclaredFit(equations, weights, s)).log_evidence()
        for s in (spectrum, SPECTRUM)
    ]
    assert logs[0] - logs[1] == pytest.approx(expected - SPECTRUM.log_prior)


def test_the_ridge_is_negligible_for_badly_scaled_columns():
    """Columns of very different scale must not be regularised by the ridge."""
    equations, weights = problem(loud=1e6)
    fit = Fit(DeclaredFit(equations, weights))
    A, b, *_ = dense(fit)
    size = np.sqrt((A**2).sum(axis=0))
    exact = np.linalg.lstsq(A / size, b, rcond=None)[0] / size
    assert_allclose(fit.theta, exact, rtol=1e-5)


@pytest.mark.parametrize("i", range(3))
def test_member_groups_match_a_refit_without_the_member(i):
    """The correction of the third member is already in the equations."""
    fit = of(MEMBERS)
    group, refit = fit.member_groups[i], fit.without(i).groups(MEMBERS[i].columns)
    assert_allclose(group.H, refit.H, rtol=1e-6)
    assert_allclose(group.q, refit.q, rtol=1e-6)
    assert_allclose(group.evidence(0.1), refit.evidence(0.1), rtol=1e-6)
    # Without prior on the group, its coefficients are those of least squares.
    A, b, precision, mean = dense(fit)
    columns = slice(R + fit.slices[i].start, R + fit.slices[i].stop)
    precision[columns] = 0.0
    rows = np.vstack([A, np.diag(np.sqrt(precision))])
    values = np.r_[b, np.sqrt(precision) * mean]
    free = np.linalg.lstsq(rows, values, rcond=None)[0]
    expected = free[columns] + MEMBERS[i].applied
    assert_allclose(group.coefficients()[0], expected, rtol=1e-5)


def test_removing_a_member_matches_a_refit():
    fit = of(MEMBERS)
    for i in (0, 1):
        less = fit.without(i)
        expected = of([m for k, m in enumerate(MEMBERS) if k != i])
        assert_allclose(less.theta, expected.theta, rtol=1e-9)
        assert less.log_evidence() == pytest.approx(expected.log_evidence(), abs=1e-6)
    more = of(MEMBERS[:2]).with_member(MEMBERS[2])
    assert_allclose(more.theta, fit.theta, rtol=1e-9)


def test_removing_a_correction_restores_the_equations():
    fit = of(MEMBERS)
    made, weights = problem()
    columns = MEMBERS[2].columns.values[:, :, 0, 0]
    made = Synthetic(made.Z, made.y + 0.3 * columns, made.used_joints)
    expected = Fit(DeclaredFit(made, weights, SPECTRUM), MEMBERS[:2])
    without = fit.without(2)
    assert_allclose(without.theta, expected.theta, rtol=1e-8)
    assert_allclose(without.residual, expected.residual, atol=1e-8)
    gain = fit.log_evidence() - without.log_evidence()
    # Same gain as for an effect that is not yet applied to the equations.
    zero = MEMBERS[2].columns
    uncorrected = Columns([Offset(1)], zero.joints, zero.values, zero.unit, zero.edges)
    uncorrected = uncorrected.member(scale=MEMBERS[2].scale)
    more = expected.with_member(uncorrected)
    assert more.log_evidence() - expected.log_evidence() == pytest.approx(
        gain, abs=1e-6
    )
    assert_allclose(more.coefficients(2) - 0.3, fit.coefficients(2), rtol=1e-6)
    # The problem itself is not modified.
    assert_allclose(fit.problem.y, problem()[0].y)


def test_evidence_integrates_over_the_scale():
    """Integrate the evidence of separate fits over a grid of scales."""
    group = MEMBERS[0]
    base = of(MEMBERS[1:])
    scales = np.geomspace(1e-4, 1e2, 200)
    ratio = scales / 0.1
    prior = ratio / (1 + ratio**2)
    logs = [
        base.with_member(
            SelectedEffect(columns=group.columns, scale=scale)
        ).log_evidence()
        for scale in scales
    ]
    logs = np.array(logs) - base.log_evidence()
    expected = np.log((prior * np.exp(logs)).sum() / prior.sum())
    assert_allclose(base.groups(group.columns).evidence(0.1), [expected], atol=0.02)


# -- on a recording


TORQUE = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))


@pytest.fixture(scope="module")
def fitted():
    path = search(TORQUE, ["coulomb", "spring", "ripple"]).path()
    return spectrum_of(path.fit_effects([Spring(0), Coulomb(1)]), SearchSettings())


@pytest.mark.parametrize("repeats", [1.0, 3.0])
def test_degrees_of_freedom_by_band(monkeypatch, fitted, repeats):
    """Trace of the hat matrix by band; repetitions do not add degrees of freedom."""
    monkeypatch.setattr(fitted.problem.view, "repeats", repeats)
    power, freedom = fitted.powers()
    made, cosines = fitted.problem, fitted.problem.cosines
    n = cosines.band.size
    root = np.sqrt(fitted.base.weights)
    A = [np.column_stack([made.Z[j], rows_of(fitted, j)]) for j in range(2)]
    A = np.concatenate([own * r[:, None] for own, r in zip(A, root)])
    penalty = np.r_[np.zeros(made.Z.shape[2]), fitted.prior]
    hat = np.einsum("ij,jk,ik->i", A, np.linalg.inv(A.T @ A + np.diag(penalty)), A)
    for j in range(2):
        own = hat[j * n : (j + 1) * n]
        fill = cosines.fill[j] / repeats
        rest = fill * np.bincount(cosines.band) - np.bincount(cosines.band, own)
        assert_allclose(freedom[j], np.maximum(rest, 0.0), atol=1e-4)
        squares = np.bincount(cosines.band, fitted.residual[j] ** 2)
        assert_allclose(power[j], fill * squares, rtol=1e-9)


def rows_of(fit, j):
    """Columns of the members in the equations of a joint, (n, p)."""
    columns = np.zeros((fit.problem.y.shape[1], fit.n_coefficients))
    for place, member in zip(fit.slices, fit.members):
        if j in member.joints:
            columns[:, place] = member.columns.values[member.joints.index(j), :, 0]
    return columns


def stub_of(scores):
    """Return a stub of a fit with the given scores."""
    return SimpleNamespace(scores=scores, n_coefficients=0)


def literal_scores(fit, own, coef, noise=None):
    """Block scores of a direction given a fit, and their expected variance."""
    made, view = fit.problem, fit.problem.view
    nv, n = made.y.shape
    root = np.sqrt(fit.base.weights)
    x = np.zeros((nv, n))
    x[list(own.joints)] = own.columns.values[:, :, 0] @ coef
    A = [np.column_stack([made.Z[j], rows_of(fit, j)]) for j in range(nv)]
    A = np.array([block * r[:, None] for block, r in zip(A, root)])
    flat = A.reshape(nv * n, -1)
    penalty = np.diag(np.r_[np.zeros(made.Z.shape[2]), fit.prior])
    right = flat.T @ (x * root).ravel()
    left = (x * root) - A @ np.linalg.solve(flat.T @ flat + penalty, right)
    used = view.root.T > 0
    rows = np.where(used, made.cosines.rows(left), 0.0)
    if noise is None:
        noise = np.where(used, made.cosines.rows(fit.residual * root), 0.0)
    # Remove the part of the noise that the direction explains.
    noise = noise - rows * (rows * noise).sum() / (rows**2).sum()
    product = (rows * noise).sum(axis=0)
    label = view.blocks.label
    scores = np.array([product[label == b].sum() for b in range(label.max() + 1)])
    return scores, (rows**2).sum()


def test_overdispersion_is_estimated_from_block_scores(fitted):
    """Ratio of the sandwich to the Hessian for overdispersed block scores."""
    group = fitted.problem.columns([Spring(1)])
    coef = np.array([1.0, 0.2])
    scores, promised = literal_scores(fitted, group.member(), coef)
    plain = scores.var(ddof=1) * scores.size / promised
    result = fitted.overdispersion(group, 0, coef, fitted)
    assert result.ratio >= max(1.0, plain) * (1 - 1e-6)
    # White noise has little overdispersion.
    assert result.ratio < 3.0
    # The ratio does not depend on the scale of the direction.
    scaled = fitted.overdispersion(group, 0, 1e3 * coef, fitted)
    assert scaled.ratio == pytest.approx(result.ratio, rel=1e-6)
    # Ten times the noise has a hundred times the variance.
    loud, louder = (
        fitted.overdispersion(group, 0, coef, stub_of(size * fitted.scores)).ratio
        for size in (10, 100)
    )
    assert louder == pytest.approx(100 * loud, rel=1e-6)


def test_overdispersion_of_intermittent_effects(fitted):
    """A score with slowly changing sign is overdispersed."""
    own, coef = fitted.problem.columns([Spring(1)]), np.array([1.0, 0.2])
    rows = fitted.scores
    sign = np.sign(np.sin(2 * np.pi * np.arange(rows.shape[1]) / rows.shape[1]))
    direction = own.values[0, :, 0] @ coef * np.sqrt(fitted.base.weights[1])
    slow = np.zeros_like(rows)
    shape = np.zeros((2, direction.size))
    shape[1] = direction
    slow[1] = sign * fitted.problem.cosines.rows(shape)[1]
    slow *= rows.std() / slow[1].std()
    white = fitted.overdispersion(own, 0, coef, stub_of(rows))
    assert fitted.overdispersion(own, 0, coef, stub_of(slow)).ratio > 3.0 * white.ratio


def test_columns_of_a_payload_depend_on_its_centre(fitted):
    centres = [(0.0, 0.0, 0.0), (0.1, 0.2, 0.3)]
    first, second = (
        fitted.problem.columns([Payload(1, instant=9.0, centre=x)]) for x in centres
    )
    assert np.abs(first.values - second.values).max() > 0


@pytest.mark.parametrize(
    ("effect", "used"), [(Drift(1), 2), (Payload(1, instant=9.0), 1)], ids=["D", "P"]
)
def test_overdispersion_of_time_effects_uses_low_frequencies(fitted, effect, used):
    """Mean power of the lowest frequencies, without the degrees of freedom used."""
    group = fitted.problem.columns([effect])
    coef = np.ones(len(effect.coefficients))
    shape = np.zeros((2, group.values.shape[1]))
    shape[list(group.joints)] = group.values[:, :, 0] @ coef
    rows = fitted.problem.cosines.rows(shape * np.sqrt(fitted.base.weights))
    # A score with a few sign changes.
    turns = np.cos(1.5 * np.pi * np.arange(rows.shape[1]) / rows.shape[1])
    noise = fitted.scores + 9.0 * rows * turns * fitted.scores.std() / rows.std()
    result = fitted.overdispersion(group, 0, coef, stub_of(noise))
    scores, promised = literal_scores(fitted, group.member(), coef, noise)
    order = fitted.problem.view.spans.sequence
    power = dct(scores[order], norm="ortho")[1:] ** 2 * scores.size / promised
    slow = max(power.size // 4, 1)
    usual = max(1.0, power.mean(), power[:slow].mean())
    assert result.usual == pytest.approx(usual, rel=1e-6)
    expected = power[:4].sum() / (4 - used)
    assert expected > usual
    assert result.ratio == pytest.approx(expected, rel=1e-6)
    assert result.freedom == slow - used


# -- weights by a power of the spectrum


def coloured(share):
    """Weights by a power of a spectrum of two joints, and its variances (NV, N)."""
    made, _ = problem()
    variance = np.full((NV, N), np.inf)
    variance[:2] = np.geomspace(50.0, 0.02, N) * np.array([[1.0], [3.0]])
    spectrum = Spectrum(variance=variance, log_prior=0.0)
    base = DeclaredFit(made, spectrum.weights(made.cosines, share), spectrum, share)
    return base, np.where(np.isfinite(variance), variance, 0.0)


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
def test_score_variance_ratio_of_flattened_weights(share):
    """With the full spectrum the ratio is one."""
    base, variance = coloured(share)
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(NV, N)) / np.arange(1, N + 1)
    noise = np.sqrt(variance) * rng.normal(size=(20000, NV, N))
    scores = np.einsum("sjn,jn->s", noise, columns * base.weights)
    promised = (columns**2 * base.weights).sum()
    ratio = base.score_variance_ratio(columns * np.sqrt(base.weights))
    assert ratio == pytest.approx(np.mean(scores**2) / promised, rel=0.05)
    assert ratio == pytest.approx(1.0) if share == 1.0 else ratio > 2.0


def test_chance_limit_bounds_the_change_of_the_estimate():
    base, variance = coloured(1.0)
    made, rng = base.problem, np.random.default_rng(4)
    mean = variance.mean(axis=1, keepdims=True)
    plain = DeclaredFit(made, np.where(variance > 0, 1.0 / np.maximum(mean, 1e-9), 0.0))
    noise = np.sqrt(variance) * rng.normal(size=(2000, NV, N))
    made = [made.changed(y=y) for y in noise]
    thetas = np.array([[Fit(b.on(y)).theta for b in (plain, base)] for y in made])
    change = thetas[:, 0] - thetas[:, 1]
    scatter, moved = (
        ((base.problem.Z @ x.T) ** 2).sum(axis=1)[:2] for x in (thetas[:, 0], change)
    )
    for chance in (0.0, 1.645):
        most = _chance_limit(plain, base.spectrum, chance)[:2]
        expected = scatter.mean(axis=1) + chance * scatter.std(axis=1)
        assert_allclose(most, expected, rtol=0.1)
    assert (moved.mean(axis=1) < scatter.mean(axis=1)).all()
    assert ((moved.T > most).mean(axis=0) < 0.1).all()


@pytest.mark.parametrize("late", [0, 8])
def test_model_errors_in_fast_motion_flatten_the_weights(late):
    """Delayed friction agrees with the model in slow motion only."""
    recording = record("Y", seed=0, duration=40.0)
    torque = recording.torque(joint_1=lambda r: 2.0 * np.sign(r.v[:, 0]))
    torque = np.vstack([torque[:late], torque[: torque.shape[0] - late]])
    white = np.random.default_rng(0).normal(size=2000)
    slow = lfilter([np.sqrt(1 - 0.98**2)], [1, -0.98], white)
    robot = recording.robot(friction=("viscous", "coulomb"))
    path = search(torque + 0.3 * slow[:, None], [], recording, robot).path()
    plain = path.fit_declared()
    chosen = spectrum_of(plain, SearchSettings())
    whole = spectral_fit(plain, SearchSettings(), 1.0)
    k = list(robot.parameter_names_).index("joint_1:coulomb")
    value, by_all = ((path.view.back @ fit.theta)[k] for fit in (chosen, whole))
    if late:
        assert chosen.base.share <= 0.5
        assert by_all + 0.6 < value < 2.0
    else:
        assert chosen.base.share >= 0.75
        assert value == pytest.approx(2.0, abs=0.05)
