"""Cross-validated errors against explicit refits without each fold."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.search._held_out import (
    CrossValidatedGain,
    HeldOut,
    HeldOutFit,
    fold_of,
)
from sklearn_vbjfa.effects import Coulomb, Spring
from tests.diagnosis.search._searches import CLEAN, coulomb, search, spring

TORQUE = CLEAN.torque(joint_2=coulomb(0.5), joint_1=spring(2.0, 1.0))
EFFECTS = [Spring(0), Coulomb(1), Spring(1)]
THREE = np.repeat([0, 1, 2], CLEAN.t.size // 3)


def fit_three(groups=None):
    """Fit two true effects and a false one to one recording or three."""
    problem = search(TORQUE, ["coulomb", "spring"], groups=groups)
    return problem.path().fit_effects(EFFECTS)


@pytest.fixture(scope="module", params=[None, THREE], ids=["one", "three"])
def fitted(request):
    fit = fit_three(request.param)
    return fit, HeldOutFit(HeldOut(fit.problem.view), fit)


def refits(fit, left_out, members, block_fold=None, studentised=False, counted=1):
    """Squared errors of blocks (n_blocks, nj) of refits without each fold."""
    # studentised: divide by the predictive variance; counted: mask of rows (nv, m).
    view = fit.problem.view
    columns = [view.Z]
    precision = [np.zeros(view.Z.shape[2])]
    for i in members:
        member = fit.members[i]
        X = np.zeros((view.nv, view.index.size, member.width))
        (joint,) = member.joints
        X[joint] = view.columns([member.effect], fit.problem.motion)[0, :, 0]
        columns.append(X)
        precision.append(1.0 / (member.scale * member.unit) ** 2)
    A = np.concatenate(columns, axis=2)
    root = np.sqrt(left_out.weight)[:, None]
    penalty = np.diag(np.sqrt(np.concatenate(precision)))
    zero = 1e5 * view.one_sided[fit.problem.at_zero]
    zero = np.pad(zero, ((0, 0), (0, len(penalty) - zero.shape[1])))
    penalty = np.vstack([penalty, zero])
    squares = np.zeros((view.blocks.n_blocks, view.nv))
    if block_fold is None:
        firsts = [np.argmax(view.blocks.label == b) for b in range(len(squares))]
        block_fold = left_out.data.fold[firsts]
    for fold in np.unique(block_fold):
        out = np.isin(view.blocks.label, np.flatnonzero(block_fold == fold))
        rows = (A[:, ~out] * root[:, :, None]).reshape(-1, A.shape[2])
        values = (view.target[:, ~out] * root).ravel()
        theta = np.linalg.lstsq(
            np.vstack([rows, penalty]),
            np.r_[values, np.zeros(len(penalty))],
            rcond=None,
        )[0]
        errors = np.where(out, view.target - A @ theta, 0.0) ** 2
        if studentised:
            inverse = np.linalg.pinv(
                rows.T @ rows + penalty.T @ penalty, hermitian=True
            )
            expected = 1.0 + np.einsum("jmp,pq,jmq->jm", A, inverse, A) * root**2
            errors = errors / expected
        squares += view.blocks.sums((errors * counted).T)
    return squares


def test_held_out_squares_match_refits(fitted):
    fit, cv = fitted
    assert_allclose(cv.squares, refits(fit, cv, [0, 1, 2]), rtol=3e-4)


@pytest.mark.parametrize("i", [0, 1, 2])
def test_gain_of_an_effect_matches_refits(fitted, i):
    fit, cv = fitted
    others = [k for k in range(3) if k != i]
    joint = fit.members[i].effect.joint
    before = refits(fit, cv, others)[:, joint]
    after = refits(fit, cv, [0, 1, 2])[:, joint]
    expected, gain = CrossValidatedGain.of(before, after), cv.gain_of(i)
    assert gain.gain == pytest.approx(expected.gain, rel=3e-4, abs=1e-6)
    assert gain.gain_std == pytest.approx(expected.gain_std, rel=1e-3, abs=1e-6)
    assert gain.n_blocks == expected.n_blocks
    # The first two effects are true.
    assert (gain.gain > 0.5) == (i < 2)
    settings = SearchSettings()
    named = gain.errors > settings.significance and gain.gain > settings.min_gain
    assert named == (i < 2)


def test_held_out_residuals_are_studentised(fitted):
    fit, cv = fitted
    squares = fit.problem.view.blocks.sums((cv.residual**2).T)
    expected = refits(fit, cv, [0, 1, 2], studentised=True)
    assert_allclose(squares, expected, rtol=1e-3)
    assert (squares < cv.squares).all()


def test_friction_fixed_at_zero_is_fixed_in_each_fold():
    fit = fit_three()
    free = HeldOutFit(HeldOut(fit.problem.view), fit).squares
    fit = fit.with_zeros([[True], [False]])
    cv = HeldOutFit(HeldOut(fit.problem.view), fit)
    assert_allclose(cv.squares, refits(fit, cv, [0, 1, 2]), rtol=1e-3)
    assert cv.squares[:, 0].sum() > 2.0 * free[:, 0].sum()


def test_folds_can_be_passed():
    fit = fit_three()
    view = fit.problem.view
    cv = HeldOutFit(HeldOut(view, view.blocks.fold), fit)
    assert_allclose(cv.squares, refits(fit, cv, [0, 1, 2]), rtol=3e-4)
    assert_array_equal(cv.data.fold, view.blocks.fold)


def test_held_out_residual_reaches_the_noise_floor(fitted):
    fit, cv = fitted
    view = fit.problem.view
    cv = HeldOutFit(HeldOut(view, view.blocks.fold), fit)
    rms = np.sqrt((cv.residual**2).sum(axis=1) / view.rows)
    noise = view.filtered(CLEAN.noise).std(axis=0)
    assert_allclose(rms, noise, rtol=0.3)


def test_insignificant_effects_are_not_possible(monkeypatch):
    """A gain of one standard deviation (84 %) is below the required probability."""
    gain_of = HeldOutFit.gain_of

    def unsure(self, i, absent=()):
        return replace(gain_of(self, i, absent), errors=1.0)

    monkeypatch.setattr(HeldOutFit, "gain_of", unsure)
    for undecided, count in ((0.8, 2), (0.9, 0)):
        settings = SearchSettings(min_probability=undecided)
        run = search(TORQUE, ["coulomb", "spring"], settings=settings).run()
        assert len(run.effects) == count


def test_effects_with_implausible_sign_are_dropped(monkeypatch):
    """The value in the full model may differ from that of the candidate."""
    monkeypatch.setattr(Coulomb, "plausible", lambda self, coef: True)
    monkeypatch.setattr(Coulomb, "natural", lambda self, coef: False)
    run = search(TORQUE, ["coulomb", "spring"]).run()
    assert [type(effect) for effect in run.effects] == [Spring]


def test_three_recordings_are_separate_folds():
    view = fit_three(THREE).problem.view
    assert_array_equal(fold_of(view), view.origin)


@pytest.mark.parametrize("groups", [None, np.repeat([0, 1], CLEAN.t.size // 2)])
def test_one_or_two_recordings_are_split_into_folds(groups):
    view = fit_three(groups).problem.view
    fold = fold_of(view)
    # Consecutive and of similar length.
    assert (np.diff(fold) >= 0).all()
    assert np.unique(fold).size == 8
    count = np.bincount(fold)
    assert count.max() < 1.2 * count.min()
    for k in np.unique(fold):
        assert np.unique(view.origin[fold == k]).size == 1


def test_cross_validated_gain_by_hand():
    before, after = np.array([4.0, 6.0, 10.0, 5.0]), np.array([3.0, 6.0, 5.0, 6.0])
    result = CrossValidatedGain.of(before, after)
    saved = np.array([1.0, 0.0, 5.0, -1.0])
    assert result.gain == pytest.approx(5 / 25)
    assert result.gain_std == pytest.approx(2 * saved.std() / 25)
    ratio = np.log([4 / 3, 2.0, 5 / 6])
    expected = ratio.mean() / (ratio.std(ddof=1) / np.sqrt(3))
    assert result.errors == pytest.approx(expected, rel=1e-4)
    assert result.n_blocks == 3
    nothing = CrossValidatedGain.of(before, before)
    assert (nothing.gain, nothing.errors, nothing.n_blocks) == (0.0, 0.0, 0)
    assert CrossValidatedGain.of(np.zeros(4), np.zeros(4)).gain == 0.0
