"""Detection of repeated motion from the positions."""

import numpy as np
import pytest

from sklearn_vbjfa.equations import find_repetition

DT = 0.01


def wave(t, frequencies, seed=0):
    """Return the motion of two joints as a sum of sines (n, 2)."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, size=(2, len(frequencies)))
    angle = 2 * np.pi * t[:, None, None] * np.asarray(frequencies) + phase
    return np.sin(angle).sum(axis=2) * [1.0, 0.4]


def find(*recordings, gap=0.0, dt=DT):
    """Find repetition in consecutive recordings."""
    q = np.concatenate(recordings)
    ends = np.cumsum([len(x) for x in recordings])
    parts = [slice(b - len(x), b) for x, b in zip(recordings, ends)]
    t = dt * np.arange(len(q))
    for k, part in enumerate(parts):
        t[part] += k * gap
    return find_repetition(q, t, parts), t, parts


def test_period_and_phase_are_found():
    t = DT * np.arange(3700)
    q = wave(t, np.array([1, 3, 7]) / 8.3)
    repetition, t, _ = find(q)
    assert repetition
    (motion,) = repetition.repeated
    assert motion["seconds"] == pytest.approx(8.3, abs=0.002)
    assert motion["count"] == pytest.approx(37.0 / 8.3, rel=0.01)
    _, phase = repetition.phase(np.zeros(t.size, int), t)
    order = np.argsort(phase)
    assert np.abs(np.diff(q[order], axis=0)).max() < 0.1
    assert phase.max() < 8.31
    # A row at the end of a period begins the next one in spite of rounding.
    for period in (8.3, np.nextafter(8.3, 9)):
        repetition.period[0] = period
        _, phase = repetition.phase(np.zeros(4, int), 8.3 * np.arange(4))
        np.testing.assert_array_equal(phase, 0.0)


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.04])
def test_period_does_not_depend_on_the_sample_period(dt):
    t = np.arange(0, 40.0, dt)
    (motion,) = find(wave(t, np.array([1, 2, 5]) / 10.0), dt=dt)[0].repeated
    assert motion["seconds"] == pytest.approx(10.0, abs=0.02)


def test_incommensurate_frequencies_do_not_repeat():
    t = DT * np.arange(6000)
    q = wave(t, [0.131, 0.277, 0.433, 0.619, np.sqrt(0.5)])
    repetition = find(q)[0]
    assert not repetition
    assert repetition.repeated == ()


def test_one_non_repeating_joint_makes_another_motion():
    t = DT * np.arange(6000)
    q = wave(t, np.array([1, 3, 7]) / 10.0)
    q[:, 1] = wave(t, [0.131, 0.277, 0.433, 0.619])[:, 1]
    assert not find(q)[0]
    # A joint at rest does not count as another motion.
    q[:, 1] = 1e-5 * np.random.default_rng(0).normal(size=t.size)
    assert find(q)[0]


def test_repeated_recordings_are_found_at_any_start():
    t = DT * np.arange(4000)
    q = wave(t, [0.131, 0.277, 0.433, 0.619])
    other = wave(t[:2000], [0.17, 0.31, 0.53], seed=1)
    repetition, t, parts = find(q[:3000], other, q[137:3137], gap=5.0)
    (repeated,) = repetition.repeated
    assert repeated["recordings"] == (0, 2)
    assert repeated["count"] == pytest.approx(2.0, rel=0.05)
    assert repetition.delay[2] == pytest.approx(1.37, abs=0.005)
    label = np.repeat(np.arange(3), [3000, 2000, 3000])
    motion, phase = repetition.phase(label, t)
    np.testing.assert_array_equal(np.unique(motion), [0, 1])
    assert motion[parts[0]].max() == motion[parts[2]].min() == 0
    np.testing.assert_allclose(
        phase[parts[2]][:100], phase[parts[0]][137:237], atol=0.005
    )
