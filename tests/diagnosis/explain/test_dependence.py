"""Dependence of residuals on signals."""

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis.explain import dependences, motion_signals
from tests.diagnosis.search._searches import CLEAN, search

VIEW = search(CLEAN.torque(), ["coulomb"]).view
NAMES = ("base", "elbow")


def signals():
    motion = VIEW.motion(None)
    return {
        name: VIEW.filtered(values[:, None])[:, 0]
        for name, values in motion_signals(motion, NAMES).items()
    }


def noise(seed=0):
    return np.random.default_rng(seed).normal(size=VIEW.index.size)


def test_strongest_dependence_is_listed_first():
    inputs = signals()
    position = inputs["position of elbow"]
    bend = np.cos(3 * position / np.abs(position).max())
    residual = (bend - bend.mean()) / bend.std() + noise()
    first, *_ = dependences(residual, VIEW.equations.weight[:, 1], inputs, VIEW.blocks)
    assert first.signal == "position of elbow"
    assert first.share == pytest.approx(0.5, abs=0.1)
    assert first.p_value < 0.01 / len(inputs)


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_depends_on_no_signal(seed):
    weight = VIEW.equations.weight[:, 0]
    assert dependences(noise(seed), weight, signals(), VIEW.blocks) == ()
