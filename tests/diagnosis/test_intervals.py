"""Intervals: how often they hold the truth."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pinocchio")

from sklearn_vbjfa.diagnosis._blocks import Blocks
from sklearn_vbjfa.diagnosis._intervals import bootstrap_errors, effect_covariances
from sklearn_vbjfa.diagnosis._regression import BlockRegression
from sklearn_vbjfa.effects import Coulomb, Ripple
from sklearn_vbjfa.robot._residuals import TorqueResiduals

M, NV = 400, 2


def coloured(rng, m=M, rho=0.8):
    """Noise that is correlated over some samples, of unit variance."""
    x = np.zeros(m)
    for i in range(1, m):
        x[i] = rho * x[i - 1] + np.sqrt(1 - rho**2) * rng.normal()
    return x


class Equations:
    """Just what of a search the covariances look at, made from given columns."""

    def __init__(self, effects, make, truth, noise, seed=0):
        rng = np.random.default_rng(seed)
        Z = rng.normal(size=(NV, M, 2))
        own = [make(effect)[:, None] for effect in effects]
        extra = np.zeros((NV, M, len(own)))
        for i, (effect, columns) in enumerate(zip(effects, own)):
            extra[effect.joint, :, i] = columns[:, 0]
        all_columns = np.concatenate([Z, extra], axis=2)
        y = all_columns @ np.r_[1.0, -2.0, truth] + noise
        label = np.arange(M) * 40 // M
        blocks = Blocks(label=label, fold=label % 8, length=1.0)
        self.make = make
        self.accepted = list(effects)
        self.motion = None
        self.base = BlockRegression(all_columns, y, np.ones(NV), blocks, 1e-10)
        self.view = SimpleNamespace(
            Z=Z,
            nv=NV,
            precision=np.ones(NV),
            blocks=blocks,
            joints_of=lambda effect: [effect.joint],
            columns=lambda found, _motion: np.stack(
                [make(effect)[None, :, None] for effect in found], axis=2
            ),
        )

    def coefficients(self, effect):
        at = self.accepted.index(effect)
        return self.base.theta[2 + at : 3 + at]


def slow_signal(seed=1):
    return coloured(np.random.default_rng(seed), rho=0.9)


def noisy(seed, rho):
    rng = np.random.default_rng(seed)
    return np.array([coloured(rng, rho=rho) for _ in range(NV)])


def test_covariance_of_white_noise_is_that_of_least_squares():
    x = slow_signal()
    noise = noisy(3, 0.0)
    now = Equations([Coulomb(1)], lambda effect: x, [2.0], noise)
    (found,) = effect_covariances(now)
    assert found.shape == (2, 2)
    # the smoothing speed has no part in columns that do not depend on it
    expected = 1.0 / (x @ x)
    assert found[0, 0] == pytest.approx(expected, rel=0.5)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_ninety_per_cent_hold_the_truth(rho):
    """Coefficients in noise that is correlated as the signal is."""
    inside = white = 0
    count = 150
    x = slow_signal()
    for seed in range(count):
        now = Equations([Coulomb(1)], lambda effect: x, [2.0], noisy(seed, rho))
        (covariance,) = effect_covariances(now)
        error = abs(now.coefficients(now.accepted[0])[0] - 2.0)
        inside += error < 1.6449 * np.sqrt(covariance[0, 0])
        white += error < 1.6449 / np.sqrt(x @ x)
    # three deviations of a binomial, and some per cent for forty blocks
    assert 0.9 - 0.12 < inside / count <= 0.97
    if rho:
        assert white / count < 0.75


def test_shape_parameters_have_a_variance_as_well():
    """Period of a ripple: against the scatter of fits that search it."""
    q = np.cumsum(slow_signal()) * 0.02
    period, size = 0.5, 1.5

    def cosine(effect):
        return np.cos(2 * np.pi * q / effect.period)

    deviations, estimates = [], []
    trials = period * np.linspace(0.97, 1.03, 61)
    for seed in range(30):
        noise = 0.5 * noisy(seed, 0.5)
        now = Equations([Ripple(1, period=period)], cosine, [size], noise)
        left = []
        for trial in trials:
            A = np.column_stack([now.view.Z[1], np.cos(2 * np.pi * q / trial)])
            y = now.base.y[1]
            rest = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
            left.append(rest @ rest)
        estimates.append(trials[np.argmin(left)])
        (covariance,) = effect_covariances(now)
        assert covariance.shape == (2, 2)
        deviations.append(np.sqrt(covariance[1, 1]))
    assert np.std(estimates) == pytest.approx(np.mean(deviations), rel=0.5)


def test_two_effects_have_a_covariance_each():
    x, z = slow_signal(1), slow_signal(2)
    made = {0: x, 1: z}
    now = Equations(
        [Coulomb(0), Coulomb(1)], lambda e: made[e.joint], [2.0, 3.0], noisy(0, 0.5)
    )
    found = effect_covariances(now)
    assert [c.shape for c in found] == [(2, 2), (2, 2)]
    assert all(c[0, 0] > 0 for c in found)


def test_no_effects_no_covariances():
    now = Equations([], lambda effect: None, [], noisy(0, 0.0))
    assert effect_covariances(now) == []


# -- errors


def residuals(seed, size, m=600, rho=0.7):
    rng = np.random.default_rng(seed)
    rest = size * np.column_stack([coloured(rng, m, rho) for _ in range(NV)])
    torque = 3 * np.column_stack([np.sin(np.arange(m) / 9), np.cos(np.arange(m) / 7)])
    return TorqueResiduals(
        index=np.arange(m),
        torque=torque + rest,
        predicted=torque,
        weight=np.ones((m, NV)),
    )


def draw(before, after, seed=0, **given):
    given = {"block_seconds": 2.0, "step": 0.1, **given}
    rng = np.random.RandomState(seed)
    return bootstrap_errors(before, after, random_state=rng, **given)


def test_bootstrap_surrounds_the_errors():
    before, after = residuals(0, 1.0), residuals(1, 0.3)
    found = draw(before, after)
    assert set(found) == {"before", "after", "difference"}
    scale = before.torque.std(axis=0)
    for key, one in (("before", before), ("after", after)):
        low, high = found[key]
        value = one.rms() / scale
        assert np.all(low < value)
        assert np.all(value < high)
    assert np.all(found["difference"][1] < 0)
    assert np.all(found["difference"][0] < found["difference"][1])


def test_bootstrap_of_equal_models_has_no_difference():
    before = residuals(0, 1.0)
    found = draw(before, before)
    assert_allclose(found["difference"], 0.0)
    assert_allclose(found["before"], found["after"])


def test_bootstrap_repeats_itself_and_follows_the_seed():
    before, after = residuals(0, 1.0), residuals(1, 0.3)
    one, two, other = (draw(before, after, seed) for seed in (0, 0, 1))
    for key in one:
        assert_allclose(one[key], two[key])
        assert not np.array_equal(one[key], other[key])


def test_bootstrap_covers():
    """The error of a long record lies in the intervals of nine tenths of short ones."""
    truth = np.sqrt(1.0 / (4.5 + 1.0))
    inside = []
    for seed in range(60):
        before = residuals(seed, 1.0, m=500)
        low, high = draw(before, before, n_draws=300)["before"]
        spread = before.torque.std(axis=0)
        value = truth * np.sqrt(5.5) / spread
        inside += list((low < value) & (value < high))
    assert 0.75 < np.mean(inside) <= 0.98


def test_joints_without_samples_have_no_interval():
    before = residuals(0, 1.0)
    before.weight[:, 1] = 0.0
    found = draw(before, before)
    assert np.isfinite(found["before"][:, 0]).all()
    assert np.isnan(found["before"][:, 1]).all()
