"""Expected sign of an uncertain velocity near standstill."""

import numpy as np
import pytest
from scipy.special import erf

from sklearn_vbjfa import effects
from sklearn_vbjfa.effects import Motion, Rest

V = np.linspace(-0.3, 0.3, 61)[:, None]


def rest(speed=0.05, time=0.0, noise=0.0, nv=1):
    return Rest(
        speed=np.full(nv, speed), time=np.full(nv, time), noise=np.full(nv, noise)
    )


def test_sign_with_noise_alone_is_the_error_function():
    sign = rest(speed=0.0, noise=0.1).sign(V, 0 * V)
    np.testing.assert_allclose(sign, erf(V / (np.sqrt(2) * 0.1)), rtol=1e-12)


def test_sign_without_noise_is_a_clipped_ramp():
    sign = rest().sign(V, 0 * V)
    np.testing.assert_allclose(sign, np.clip(V / 0.05, -1, 1), rtol=1e-14)
    # Exactly the sign at higher speeds.
    np.testing.assert_array_equal(np.abs(sign[np.abs(V) > 0.0501]), 1.0)


@pytest.mark.parametrize("a", [0.0, 3.0])
@pytest.mark.parametrize("noise", [1e-6, 0.01, 0.04, 0.5])
def test_sign_is_the_mean_over_the_uncertain_velocity(noise, a):
    speed, time = 0.05, 0.02
    width = speed / (1 + a * time / speed)
    rng = np.random.default_rng(0)
    n = 200_000
    velocities = V[::6] + rng.uniform(-width, width, n) + noise * rng.normal(size=n)
    sign = rest(speed, time, noise).sign(V[::6], np.full_like(V[::6], a))
    np.testing.assert_allclose(sign[:, 0], np.sign(velocities).mean(axis=1), atol=0.012)


def test_a_fast_reversal_is_not_treated_as_rest():
    v = np.array([[0.01]])
    slow, fast = (rest(time=1.0).sign(v, np.array([[a]]))[0, 0] for a in (0.0, 5.0))
    assert slow == pytest.approx(0.2)
    assert fast == 1.0


def motion(rest_model, nv=2, n=200):
    """Return two joints at rest with noise in their velocities."""
    rng = np.random.default_rng(1)
    return Motion(
        q=1.0 + 1e-9 * rng.normal(size=(n, nv)),
        v=1e-3 * rng.normal(size=(n, nv)),
        a=np.zeros((n, nv)),
        t=0.01 * np.arange(n),
        load=np.ones((n, nv)),
        rest=rest_model,
    )


@pytest.mark.parametrize(
    "effect",
    [
        effects.Coulomb(),
        effects.LoadFriction(),
        effects.Stribeck(vs=0.05),
        effects.AsymmetricFriction(),
        effects.Drift(of="coulomb"),
        effects.Coupling(0, 1),
        effects.Coupling(0, 1, ratio=1.0),
        effects.Coupling(0, 1, ratio=-0.6),
    ],
    ids=repr,
)
def test_columns_do_not_chatter_at_rest(effect):
    before, after = (
        np.abs(np.diff(effect.columns(motion(rest_model)), axis=0)).max(axis=0)
        for rest_model in (None, rest(noise=1e-3, nv=2))
    )
    if effect.name != "asymmetric_friction":
        assert before.max() > 0.5
    assert after.max() < 0.2


def test_asymmetric_friction_keeps_its_constant_at_rest():
    standing = motion(rest(nv=2))
    standing.v[:] = 0.0
    column = effects.AsymmetricFriction().columns(standing)[:, 0]
    np.testing.assert_array_equal(column, 1.0)
