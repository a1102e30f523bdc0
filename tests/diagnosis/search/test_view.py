"""Filtered and reduced equations of the search."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import effects
from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.diagnosis.search._view import reduced
from sklearn_vbjfa.equations import Equations
from tests.diagnosis._recordings import DT
from tests.diagnosis.search._searches import CLEAN, search


def test_columns_are_filtered_like_torques():
    torque = CLEAN.torque()
    problem = search(torque, ["coulomb"])
    view, robot = problem.view, problem.view.robot
    lowpass = _lowpass.design(DT, robot.cutoff_)
    motion = view.motion(None)
    for effect in (effects.Coulomb(1), effects.Counterbalance(0)):
        columns = view.columns([effect], motion)
        assert columns.shape == (1, view.index.size, 1, len(effect.coefficients))
        expected = lowpass(effect.columns(motion)) * view.root[:, [effect.joint]]
        assert_allclose(columns[0, :, 0], expected, atol=1e-12)
    residuals = robot.residuals(CLEAN.position, torque)
    assert_array_equal(view.index, residuals.index)
    assert_allclose(view.target.T, residuals.torque * view.root, atol=1e-12)
    assert_allclose(view.equations.weight, residuals.weight, atol=1e-12)


def test_whole_robot_effects_have_columns_on_every_joint():
    problem = search(CLEAN.torque(), ["payload"])
    payload = effects.Payload(joint=1, instant=10.0)
    columns = problem.view.columns([payload], problem.view.motion(None))
    assert columns.shape == (2, problem.view.index.size, 1, 5)
    before = CLEAN.t[problem.view.index] < 9.0
    assert_array_equal(columns[:, before], 0.0)
    assert np.abs(columns[:, ~before]).max() > 0


def test_filter_and_blocks_respect_recordings():
    groups = np.repeat([0, 1], [500, CLEAN.t.size - 500])
    view = search(CLEAN.torque(), ["coulomb"], groups=groups).view
    half = _lowpass.design(DT, view.robot.cutoff_).half
    assert np.all((view.index < 500 - half) | (view.index >= 500 + half))
    first = np.flatnonzero(view.index >= 500)[0]
    assert_array_equal(view.starts, [0, first])
    assert view.blocks.label[first] == view.blocks.label[first - 1] + 1
    # The sign of an axis does not matter.
    order, view.states = view._content_order(), -view.states
    assert view._content_order() == order


def test_reduced_coordinates_give_the_same_torques():
    rng = np.random.default_rng(0)
    m, precision = 240, np.array([1.0, 7.0])
    Phi = rng.normal(size=(m, 2, 6)) * np.geomspace(1e-3, 1e3, 6)
    Phi[:, :, 4] = 2 * Phi[:, :, 0] - Phi[:, :, 1]  # not determined
    Phi[:, :, 5] = 0.0  # not excited
    weight = rng.uniform(0, 1, size=(m, 2))
    weight[::9] = 0.0
    tau = rng.normal(size=(m, 2))
    Z, back, known = reduced(Equations(Phi=Phi, tau=tau, weight=weight), precision)
    assert Z.shape == (2, m, 4)
    assert back.shape == (6, 4)
    u = rng.normal(size=4)
    root = np.sqrt(weight)
    assert_allclose((root * (Phi @ (back @ u))).T, Z @ u, atol=1e-9)
    assert_array_equal(back[5], 0.0)
    assert_array_equal(known, [False, False, True, True, False, False])
    # The Gram matrix is diagonal.
    G = np.einsum("j,jma,jmb->ab", precision, Z, Z)
    assert_allclose(G, np.diag(np.diagonal(G)), atol=1e-6 * np.diagonal(G).max())
    # Least squares in reduced coordinates is least squares.
    own = np.sqrt(precision)[:, None, None]
    small = np.linalg.lstsq(
        (Z * own).reshape(-1, 4), ((root * tau).T * own[:, :, 0]).ravel(), rcond=None
    )[0]
    rows = (Phi * (root * np.sqrt(precision))[:, :, None]).reshape(-1, 6)
    unit = np.sqrt((rows**2).sum(axis=0))
    unit[5] = 1.0
    full = np.linalg.lstsq(
        rows / unit, (root * np.sqrt(precision) * tau).ravel(), rcond=1e-10
    )[0]
    assert_allclose(Phi @ (back @ small), Phi @ (full / unit), atol=1e-8)
