"""The recording as the search sees it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa._core import _lowpass
from tests.diagnosis._recordings import DT
from tests.diagnosis.search._searches import CLEAN, search


def test_columns_pass_the_filter_of_the_torques():
    torque = CLEAN.torque()
    now = search(torque, ["coulomb"])
    view, robot = now.view, now.view.robot
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
    now = search(CLEAN.torque(), ["payload"])
    payload = effects.Payload(joint=1, instant=10.0)
    columns = now.view.columns([payload], now.view.motion(None))
    assert columns.shape == (2, now.view.index.size, 1, 5)
    before = CLEAN.t[now.view.index] < 9.0
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


def test_families_are_told_apart_by_their_key():
    now = search(CLEAN.torque(), ["drift"])
    family = now.view.family(effects.Drift(0), now.view.motion(None))
    warm = family.like(effects.Drift(0, of="viscous"))
    assert {e.of for e in warm.effects} == {"viscous"}
    assert warm.columns.shape[2] == len(warm.effects) < len(family.effects)
    chosen = [k for k, e in enumerate(family.effects) if e.of == "viscous"]
    assert_array_equal(warm.columns, family.columns[:, :, chosen])
    assert family.where(lambda effect: True) is family
    assert family.like(effects.Offset(0)).effects == ()
