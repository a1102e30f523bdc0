"""Subsampling of long recordings in the search."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_vbjfa import EffectDiscovery, effects
from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis.search import _view as _thinned
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.fit import FitOptions, RobotIdentifier
from tests.diagnosis.report._pages import text_of

LOWPASS = _lowpass.design(0.001, 5.0)


def moving(n, joints=2):
    return np.ones((n, joints), dtype=bool)


@pytest.fixture
def few(monkeypatch):
    """Subsample recordings of more than 1500 samples."""
    monkeypatch.setattr(_thinned, "_MAX_SAMPLES", 1500)


@pytest.fixture(scope="module")
def recorded():
    return make_robot_recording(
        duration=40.0, dt=0.005, undeclared={"load_friction": (1, 0.3)}, random_state=0
    )


def identifier(recorded):
    return RobotIdentifier(
        recorded.robot_model(),
        dt=recorded.dt,
        friction=("viscous", "coulomb", "offset", "rotor_inertia"),
    )


@pytest.mark.parametrize("every", [2, 5, 10])
def test_coarser_filters_have_the_same_output(every):
    sizes = [700, 726, 727, 728, 1400, 5003]
    edges = np.cumsum([0, *sizes])
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    t = 0.001 * np.arange(edges[-1])
    slow = np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.cos(2 * np.pi * 2.9 * t)
    rows, pieces = _lowpass.coarser_rows(parts, LOWPASS, every)
    coarser = _lowpass.coarser(LOWPASS, every)
    for part, cut in zip(parts, pieces):
        n = part.stop - part.start
        expected = part.start + LOWPASS.centres(n)
        assert_array_equal(rows[cut][coarser.centres(cut.stop - cut.start)], expected)
        assert rows[cut].min(initial=part.start) >= part.start
        assert rows[cut].max(initial=part.start) < part.stop
        outputs = LOWPASS(slow[part]), coarser(slow[rows[cut]])
        assert_allclose(*outputs, atol=2e-3)


def test_number_of_used_samples_is_bounded():
    counts = []
    for n in (10**6, 4 * 10**6):
        rows, label = _thinned.stretches([slice(0, n)], moving(n), LOWPASS)
        most = _thinned._MAX_SAMPLES * _lowpass.stride(LOWPASS)
        assert 0.9 * most < rows.size <= most
        counts.append(label.max())
        # Each is much longer than the filter.
        assert np.bincount(label).min() > 20 * LOWPASS.half
        # They cover the whole recording and are contiguous.
        assert rows[0] < 0.1 * n
        assert rows[-1] > 0.9 * n
        inside = np.diff(label) == 0
        assert (np.diff(rows)[inside] == 1).all()
        assert (np.diff(rows) >= 1).all()
    assert counts[0] == counts[1]


def test_short_recordings_are_searched():
    n, short = 2 * _thinned._MAX_SAMPLES * _lowpass.stride(LOWPASS), 30 * LOWPASS.half
    parts = [slice(0, short), slice(short, n)]
    assert _thinned.stretches(parts, moving(n), LOWPASS)[0].min() < short


def test_subsampled_columns_are_close_to_full_columns(recorded):
    robot = identifier(recorded).fit(recorded.q, recorded.tau)
    data = replace(recorded, weight=np.ones(recorded.tau.shape))
    coarse = RecordingView(robot, data)
    fine = RecordingView(robot, data, all_samples=True)
    assert coarse.states.shape[0] <= 0.5 * fine.states.shape[0]
    assert_array_equal(coarse.recorded, fine.index)
    assert_array_equal(coarse.clock[coarse.index], fine.clock[fine.index])
    assert_array_equal(coarse.Z, fine.Z)
    for effect in (
        effects.LoadFriction(1),
        effects.Stribeck(0, vs=0.5),
        effects.MaxwellSlip(1),
    ):
        rows = [
            view.columns([effect], view.motion_of(robot.theta_))
            for view in (coarse, fine)
        ]
        size = np.sqrt((rows[1] ** 2).mean())
        assert np.sqrt(((rows[0] - rows[1]) ** 2).mean()) < 0.1 * size


@pytest.mark.slow
def test_subsampling_keeps_effects_and_errors(few, recorded):
    loop = EffectDiscovery(
        identifier(recorded), effects=["load_friction", "spring"], random_state=0
    )
    thinned = loop.fit(recorded.q, recorded.tau)
    assert [(e.name, e.joint) for e in thinned.effects_] == [("load_friction", 1)]
    used = thinned.report_.outcome.provenance["looked_at"]
    assert 0 < used < 0.6 * recorded.n_samples
    text = f"The search used {used:,} of {recorded.n_samples:,} samples;"
    assert text in text_of(thinned.report_)
    assert text in thinned.report_.to_html()
    # Parameters are fitted to all rows.
    full = identifier(recorded).set_params(effects=[thinned.effects_[0].effect])
    full.set_params(cutoff=thinned.identifier_.cutoff_)
    standstill = thinned.identifier_.standstill_
    full.set_params(options=FitOptions(standstill=standstill))
    full.fit(recorded.q, recorded.tau)
    n = [x.estimate_.moments.n for x in (full, thinned.identifier_)]
    assert_array_equal(*n)
    torques = [x.predict(recorded.q) for x in (full, thinned.identifier_)]
    change = np.abs(np.subtract(*torques)).max(axis=0)
    assert (change < 1e-3 * torques[0].std(axis=0)).all()
