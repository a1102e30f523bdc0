"""Fourier series: closed forms, derivatives, rest at both ends."""

import numpy as np
import pytest

from sklearn_vbjfa.design import FourierCurve

PERIOD = 7.0


def drawn(n_harmonics=6, n_joints=3):
    curve = FourierCurve(PERIOD, n_harmonics)
    return curve, np.random.default_rng(0).normal(size=(n_joints, curve.size))


def parts(curve, z, t):
    return np.split(curve.states(z, curve.basis(t)), 3, axis=1)


def test_states_match_the_fourier_series():
    curve, z = drawn()
    t = np.linspace(0, PERIOD, 400, endpoint=False)
    q, v, a = parts(curve, z, t)
    # The coefficients, by projection on each harmonic.
    w = 2 * np.pi / PERIOD
    built, speed, second = np.zeros_like(q), np.zeros_like(q), np.zeros_like(q)
    for k in range(1, 7):
        c, s = np.cos(k * w * t)[:, None], np.sin(k * w * t)[:, None]
        A, B = 2 * (c * q).mean(axis=0), 2 * (s * q).mean(axis=0)
        built += A * c + B * s
        speed += k * w * (B * c - A * s)
        second -= (k * w) ** 2 * (A * c + B * s)
    np.testing.assert_allclose(q - q.mean(axis=0), built, atol=1e-11)
    np.testing.assert_allclose(v, speed, atol=1e-11)
    np.testing.assert_allclose(a, second, atol=1e-10)


def test_curve_is_periodic_and_at_rest_at_its_ends():
    curve, z = drawn()
    q, v, a = parts(curve, z, np.array([0.0, PERIOD, 5 * PERIOD]))
    np.testing.assert_allclose(v, 0, atol=1e-11)
    np.testing.assert_allclose(a, 0, atol=1e-10)
    np.testing.assert_allclose(q, q[:1] * np.ones((3, 1)), atol=1e-11)
    np.testing.assert_allclose(q[0], z[:, -1], atol=1e-12)
    t = np.linspace(0, PERIOD, 11)
    for now, later in zip(parts(curve, z, t), parts(curve, z, t + PERIOD)):
        np.testing.assert_allclose(later, now, atol=1e-10)


def test_pulled_back_gradients_match_the_linear_map():
    curve, z = drawn()
    basis = curve.basis(np.linspace(0, PERIOD, 20))
    by = np.random.default_rng(1).normal(size=(20, 9))
    gradient = curve.pulled_back(by, basis)
    for j in range(3):
        for k in range(curve.size):
            step = np.zeros_like(z)
            step[j, k] = 1.0
            change = curve.states(z + step, basis) - curve.states(z, basis)
            assert gradient[j, k] == pytest.approx((by * change).sum())
