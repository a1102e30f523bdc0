"""Moments accumulated in chunks against those of the whole regressor matrix."""

import joblib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import RigidBodyFeatures
from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.effects import Ripple
from sklearn_vbjfa.equations import _equations
from sklearn_vbjfa.robot import FitOptions
from tests.robot.test_identifier import FRICTION, identify

MOMENTS = ("n", "n_rows", "yy", "g")


def statistics(robot):
    stats = robot.estimate_.moments
    joints, moments = np.eye(stats.n.size), {x: getattr(stats, x) for x in MOMENTS}
    moments["G"] = np.array([stats.gram(row) for row in joints])
    if stats.noise is not None:
        moments["noise"] = np.array([stats.total_noise(row) for row in joints])
    return moments


def assert_same(robot, other, rtol=1e-10):
    """Compare moments and parameters, each relative to its largest entry."""
    expected, actual = statistics(other), statistics(robot)
    assert actual.keys() == expected.keys()
    for name, values in actual.items():
        size = np.abs(expected[name]).max()
        assert_allclose(values, expected[name], rtol=0, atol=rtol * size, err_msg=name)
    for name in ("cutoff_", "noise_floor_", "standstill_", "torque_noise_"):
        values, reference = getattr(robot, name), getattr(other, name)
        size = np.abs(reference).max()
        assert_allclose(values, reference, rtol=0, atol=rtol * size, err_msg=name)
    # Rounding may move poorly identifiable parameters, but not the torques that all
    # parameters make together.
    metric = other.estimate_.metric
    for name in ("theta_unconstrained_", "theta_"):
        values, reference = getattr(robot, name), getattr(other, name)
        difference = values - reference
        torque = reference @ metric @ reference
        assert abs(difference @ metric @ difference) <= (10 * rtol) ** 2 * torque, name
        assert_allclose(values, reference, rtol=0, atol=1e-6, err_msg=name)
    free = other.identifiable_
    values, reference = robot.theta_std_[free], other.theta_std_[free]
    assert_allclose(values, reference, rtol=1e-6, err_msg="theta_std_")


def matrix_statistics(robot, simulated):
    """Return the moments of one matrix of all equations, not in chunks.

    The matrices are from Pinocchio via `RigidBodyFeatures.transform`, the filter is
    from SciPy.
    """
    nv = 6
    lowpass = robot.robot_.plan.lowpass
    features = RigidBodyFeatures(simulated.urdf, friction=FRICTION)
    states = robot.state_estimator_.transform(simulated.q, groups=simulated.groups)
    parts = [simulated.q[simulated.groups == k] for k in np.unique(simulated.groups)]
    halves = zip(*[robot.state_estimator_.smooth_halves(q, 0) for q in parts])
    halves = [np.concatenate([own[:] for own in half]) for half in halves]
    even, odd = (features.fit_transform(half).reshape(-1, nv, 72) for half in halves)
    moves = np.abs(states[:, nv : 2 * nv]) > robot.standstill_
    rows = []
    assert not robot.robot_.plan.stops.any()
    edge = int(1.0 / (robot.state_estimator_.cutoff_.min() * simulated.dt))
    for label in np.unique(simulated.groups):
        own = simulated.groups == label
        counts = moves[own].astype(float)
        short = min(edge, len(counts) // 20)
        counts[:short] = counts[len(counts) - short :] = 0.0
        kept = lowpass.average(counts)
        each = lowpass.step * (lowpass.taps @ lowpass.taps)
        weight = np.where(kept >= 0.5, each * kept, 0.0)
        mean, apart = lowpass(0.5 * (even + odd)[own]), lowpass((even - odd)[own])
        rows.append((mean, apart, lowpass(simulated.tau[own]), weight))
    Phi, apart, tau, w = (np.concatenate(x) for x in zip(*rows))
    return {
        "n": w.sum(axis=0),
        "n_rows": (w > 0).sum(axis=0),
        "yy": (w * tau**2).sum(axis=0),
        "g": np.einsum("nj,njp,nj->jp", w, Phi, tau),
        "G": np.einsum("nj,njp,njr->jpr", w, Phi, Phi),
        "noise": 0.25 * np.einsum("nj,njp,njr->jpr", w / w.sum(axis=0), apart, apart),
    }


def test_moments_equal_those_of_the_whole_matrix(identified, simulated):
    expected = matrix_statistics(identified, simulated)
    for name, values in statistics(identified).items():
        size = np.abs(expected[name]).max()
        assert_allclose(values, expected[name], rtol=0, atol=1e-10 * size, err_msg=name)


@settings(max_examples=2, derandomize=True, deadline=None)
@given(chunk=st.integers(1 << 18, 1 << 22), block=st.integers(1 << 16, 1 << 20))
def test_chunk_and_block_sizes_do_not_matter(simulated, chunk, block):
    with pytest.MonkeyPatch.context() as patch:
        # Without a low-pass, the memory limit sets the block length.
        settings = {"cutoff": None, "options": FitOptions(state_cutoff=10.0)}
        expected = identify(simulated, **settings)
        patch.setattr(_equations, "CHUNK_BYTES", chunk)
        patch.setattr(_lowpass, "_BLOCK_BYTES", block)
        assert_same(identify(simulated, **settings), expected)


@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_parallel_fits_are_bitwise_equal(simulated, identified, backend):
    with joblib.parallel_config(backend=backend, n_jobs=2):
        parallel = identify(simulated)
    for name, values in statistics(parallel).items():
        assert_array_equal(values, statistics(identified)[name], err_msg=name)
    assert_array_equal(parallel.theta_, identified.theta_)
    assert_array_equal(parallel.noise_floor_, identified.noise_floor_)


def test_effects_are_accumulated_in_chunks(monkeypatch, simulated):
    settings = {"effects": (Ripple(joint=1),)}
    expected = identify(simulated, **settings)
    monkeypatch.setattr(_equations, "CHUNK_BYTES", 1 << 20)
    assert_same(identify(simulated, n_jobs=2, **settings), expected)
