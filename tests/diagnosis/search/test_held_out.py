"""What is left out, against fits that never saw it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.search import CrossValidatedGain, HeldOut, fold_of
from sklearn_vbjfa.diagnosis.search._held_out import HeldOutFit
from sklearn_vbjfa.effects import Coulomb, Spring
from tests.diagnosis.search._searches import CLEAN, coulomb, search, spring

TORQUE = CLEAN.torque(joint_2=coulomb(0.5), joint_1=spring(2.0, 1.0))
EFFECTS = [Spring(0), Coulomb(1), Spring(1)]
THREE = np.repeat([0, 1, 2], CLEAN.t.size // 3)


def made(groups=None):
    """Fit three effects, of which the last is not there, to one recording or three."""
    now = search(TORQUE, ["coulomb", "spring"], groups=groups)
    return now.path().fit_effects(EFFECTS)


@pytest.fixture(scope="module", params=[None, THREE], ids=["one", "three"])
def fitted(request):
    fit = made(request.param)
    return fit, HeldOut(fit.problem.view).validate(fit)


def literal(fit, left_out, members, block_fold=None, studentised=False, counted=1):
    """Squared errors of blocks (n_blocks, nj) of refits without each fold."""
    # studentised: over what noise and the refit's uncertainty let expect; counted: of
    # which rows (nv, m), all by default
    view = fit.problem.view
    columns = [view.Z]
    precision = [np.zeros(view.Z.shape[2])]
    for i in members:
        own = fit.members[i]
        X = np.zeros((view.nv, view.index.size, own.width))
        (joint,) = own.joints
        X[joint] = view.columns([own.effect], left_out.data.motion)[0, :, 0]
        columns.append(X)
        precision.append(1.0 / (own.scale * own.unit) ** 2)
    A = np.concatenate(columns, axis=2)
    root = np.sqrt(left_out.weight)[:, None]
    penalty = np.diag(np.sqrt(np.concatenate(precision)))
    zero = 1e5 * view.one_sided[fit.problem.held]
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
        wrong = np.where(out, view.target - A @ theta, 0.0) ** 2
        if studentised:
            inverse = np.linalg.pinv(
                rows.T @ rows + penalty.T @ penalty, hermitian=True
            )
            expected = 1.0 + np.einsum("jmp,pq,jmq->jm", A, inverse, A) * root**2
            wrong = wrong / expected
        squares += view.blocks.sums((wrong * counted).T)
    return squares


def test_squares_are_those_of_refits_without_each_fold(fitted):
    fit, found = fitted
    assert_allclose(found.squares, literal(fit, found, [0, 1, 2]), rtol=3e-4)


@pytest.mark.parametrize("i", [0, 1, 2])
def test_what_an_effect_is_worth_is_what_refits_without_it_lose(fitted, i):
    fit, found = fitted
    rest = [k for k in range(3) if k != i]
    joint = fit.members[i].effect.joint
    before = literal(fit, found, rest)[:, joint]
    after = literal(fit, found, [0, 1, 2])[:, joint]
    expected, worth = CrossValidatedGain.of(before, after), found.gain_of(i)
    assert worth.gain == pytest.approx(expected.gain, rel=3e-4, abs=1e-6)
    assert worth.gain_std == pytest.approx(expected.gain_std, rel=1e-3, abs=1e-6)
    assert worth.n_blocks == expected.n_blocks
    # The first two are there.
    assert (worth.gain > 0.5) == (i < 2)
    settings = SearchSettings()
    told = worth.errors > settings.significance and worth.gain > settings.min_gain
    assert told == (i < 2)


def test_residuals_are_over_the_deviation_of_their_prediction(fitted):
    fit, found = fitted
    squares = fit.problem.view.blocks.sums((found.residual**2).T)
    expected = literal(fit, found, [0, 1, 2], studentised=True)
    assert_allclose(squares, expected, rtol=1e-3)
    assert (squares < found.squares).all()


def test_friction_that_is_held_at_zero_is_so_in_each_fold():
    fit = made()
    free = HeldOut(fit.problem.view).validate(fit).squares
    fit = fit.with_held([[True], [False]])
    found = HeldOut(fit.problem.view).validate(fit)
    assert_allclose(found.squares, literal(fit, found, [0, 1, 2]), rtol=1e-3)
    assert found.squares[:, 0].sum() > 2.0 * free[:, 0].sum()


def test_folds_may_be_given():
    """Blocks between which the motion is alike, for what is left of the whole."""
    fit = made()
    view = fit.problem.view
    found = HeldOut(view, view.blocks.fold).validate(fit)
    assert_allclose(found.squares, literal(fit, found, [0, 1, 2]), rtol=3e-4)
    assert_array_equal(found.data.fold, view.blocks.fold)


def test_what_was_fitted_is_not_shrunk_by_the_noise_of_what_lacked_it(fitted):
    """At a noise floor the model is there between other blocks as well."""
    fit, found = fitted
    view = fit.problem.view
    found = HeldOut(view, view.blocks.fold).validate(fit)
    rms = np.sqrt((found.residual**2).sum(axis=1) / view.rows)
    left = view.filtered(CLEAN.noise).std(axis=0)
    assert_allclose(rms, left, rtol=0.3)


def test_what_helps_in_too_few_blocks_is_not_possible_either(monkeypatch):
    """In the sum of the blocks it saves much; 84 % is less than what is asked for."""
    gain_of = HeldOutFit.gain_of

    def unsure(self, i, absent=()):
        return replace(gain_of(self, i, absent), errors=1.0)

    monkeypatch.setattr(HeldOutFit, "gain_of", unsure)
    for undecided, count in ((0.8, 2), (0.9, 0)):
        settings = SearchSettings(min_probability=undecided)
        run = search(TORQUE, ["coulomb", "spring"], settings=settings).run()
        assert len(run.effects) == count


def test_what_ends_with_a_sign_that_it_cannot_have_is_dropped(monkeypatch):
    """Beside all others a value may be another one than that which was offered."""
    monkeypatch.setattr(Coulomb, "plausible", lambda self, coef: True)
    monkeypatch.setattr(Coulomb, "natural", lambda self, coef: False)
    run = search(TORQUE, ["coulomb", "spring"]).run()
    assert [type(effect) for effect in run.effects] == [Spring]


def test_three_recordings_are_left_out_as_a_whole():
    view = made(THREE).problem.view
    assert_array_equal(fold_of(view), view.origin)


@pytest.mark.parametrize("groups", [None, np.repeat([0, 1], CLEAN.t.size // 2)])
def test_fewer_are_left_out_in_stretches(groups):
    view = made(groups).problem.view
    fold = fold_of(view)
    # One after the other, of about equal length.
    assert (np.diff(fold) >= 0).all()
    assert np.unique(fold).size == 8
    count = np.bincount(fold)
    assert count.max() < 1.2 * count.min()
    for own in np.unique(fold):
        assert np.unique(view.origin[fold == own]).size == 1


def test_worth_by_hand():
    before, after = np.array([4.0, 6.0, 10.0, 5.0]), np.array([3.0, 6.0, 5.0, 6.0])
    worth = CrossValidatedGain.of(before, after)
    saved = np.array([1.0, 0.0, 5.0, -1.0])
    assert worth.gain == pytest.approx(5 / 25)
    assert worth.gain_std == pytest.approx(2 * saved.std() / 25)
    ratio = np.log([4 / 3, 2.0, 5 / 6])
    expected = ratio.mean() / (ratio.std(ddof=1) / np.sqrt(3))
    assert worth.errors == pytest.approx(expected, rel=1e-4)
    assert worth.n_blocks == 3
    nothing = CrossValidatedGain.of(before, before)
    assert (nothing.gain, nothing.errors, nothing.n_blocks) == (0.0, 0.0, 0)
    assert CrossValidatedGain.of(np.zeros(4), np.zeros(4)).gain == 0.0
