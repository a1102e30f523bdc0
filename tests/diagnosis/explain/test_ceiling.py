"""What functions of any form explain of a residual, and what they must not."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import signal

pytest.importorskip("pinocchio")

from sklearn_vbjfa.diagnosis.explain import Signals, Stretches, ceilings, since_reversal
from sklearn_vbjfa.diagnosis.search import RecordingView
from sklearn_vbjfa.recording import take_arrays
from tests._quick import checkered
from tests.diagnosis._recordings import named, record
from tests.diagnosis.search._searches import Search

NAMES = ("base", "elbow")
JOINT = 1


@dataclass
class Left:
    """A model whose residual is made up."""

    view: object
    motion: object
    torque: np.ndarray

    @property
    def residual(self):
        return self.torque * self.view.root.T


def viewed(seeds, duration, weight=1.0):
    """Fit a declared model to one or several recordings."""
    parts = [record("ZY", seed=seed, duration=duration) for seed in seeds]
    q = np.concatenate([part.position for part in parts])
    torque = np.concatenate([part.torque() for part in parts])
    groups = np.repeat(np.arange(len(parts)), [part.t.size for part in parts])
    robot = parts[0].robot(cutoff=8.0, standstill=None).fit(q, torque, groups=groups)
    recording = take_arrays(
        q,
        torque,
        groups,
        weight * np.ones_like(torque),
        robot.dt * np.arange(len(q)),
        dt=robot.dt,
        joint_names=robot.joint_names_,
    )
    return Search(view=RecordingView(robot, recording), library=()).run().model


ONE = viewed((2,), 40.0)
TWO = viewed((2, 3), 24.0)


def filtered(model, x):
    """Of unit size behind the low-pass."""
    x = model.view.filtered(x[:, None])[:, 0]
    return (x - x.mean()) / x.std()


def noise(model, seed, kind="white"):
    """White, with a memory, or a random walk that begins anew in each recording."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=model.view.states.shape[0])
    rho = {"white": 0.0, "memory": 0.95, "drift": 1.0}[kind]
    parts = [
        signal.lfilter([1.0], [1.0, -rho], white[part]) for part in model.view.parts
    ]
    return filtered(model, np.concatenate(parts))


def bent(model):
    """Return a function of speed and load that is not linear in either."""
    v, load = model.motion.v[:, JOINT], model.motion.load[:, JOINT]
    return filtered(model, np.cos(1.5 * v / v.std()) * (2 + np.tanh(load / load.std())))


def measured(model, residual, seed=0, joint=JOINT):
    """Ceiling of one joint, with its map."""
    everything = np.zeros((model.view.nv, residual.size))
    everything[joint] = residual
    left = Left(model.view, model.motion, everything)
    (found,), maps = ceilings(left, [joint], NAMES, 0.05, seed)
    return found, maps.get(joint)


@pytest.mark.parametrize(
    ("kind", "model"), checkered(["white", "memory", "drift"], [ONE, TWO])
)
def test_noise_is_not_explained(model, kind):
    for seed in range(2):
        found, _ = measured(model, noise(model, seed, kind))
        assert max(found.share) < 0.03


@pytest.mark.parametrize("kind", ["white", "memory"])
def test_a_function_of_speed_and_load_is_explained(kind):
    residual = np.sqrt(0.6) * bent(ONE) + np.sqrt(0.4) * noise(ONE, 0, kind)
    found, drawn = measured(ONE, residual)
    assert np.isnan(found.across).all()
    assert found.share == found.within
    assert found.share[0] == pytest.approx(0.6, abs=0.15)
    assert found.share[0] <= found.share[1] <= found.share[2]
    seen = np.isfinite(drawn.measured)
    alike = np.corrcoef(drawn.measured[seen], drawn.function[seen])[0, 1]
    assert alike > 0.8


def test_what_repeats_in_the_next_recording_is_told_from_what_does_not():
    same = np.sqrt(0.8) * bent(TWO) + np.sqrt(0.2) * noise(TWO, 0)
    found, _ = measured(TWO, same)
    assert min(*found.within, *found.across) > 0.5
    # The other way round in the other recording.
    turned = np.where(TWO.view.origin == 0, 1.0, -1.0) * same
    found, drawn = measured(TWO, turned)
    assert found.share == (0.0, 0.0, 0.0)
    assert drawn is None


def test_what_another_joint_does_is_no_function_of_the_own_speed():
    v = ONE.motion.v[:, 0]
    residual = filtered(ONE, np.cos(2 * v / v.std())) + 0.5 * noise(ONE, 0)
    found, _ = measured(ONE, residual)
    own, _, everything = found.share
    assert everything > 0.4
    assert everything > 2 * own


def test_history_explains_what_follows_a_reversal():
    q, v = ONE.motion.q[:, JOINT], ONE.motion.v[:, JOINT]
    way, _ = since_reversal(q, v, 0.0, ONE.view.parts)
    residual = filtered(ONE, np.exp(-np.nan_to_num(way) / 0.1))
    found, _ = measured(ONE, residual + 0.5 * noise(ONE, 0))
    speed, history, _ = found.share
    assert history > speed + 0.1


def test_seeds_agree_and_the_same_seed_repeats_itself():
    residual = bent(ONE) + noise(ONE, 0)
    first, again, other = (measured(ONE, residual, seed)[0] for seed in (None, 0, 1))
    assert first.within == again.within
    assert other.share == pytest.approx(first.share, abs=0.1)


def test_units_do_not_matter():
    residual = bent(ONE) + noise(ONE, 0)
    found, _ = measured(ONE, residual)
    motion = ONE.motion
    scaled = replace(
        motion, q=50 * motion.q, v=50 * motion.v, a=50 * motion.a, load=7 * motion.load
    )
    other, _ = measured(Left(ONE.view, scaled, None), 7 * residual)
    assert other.share == pytest.approx(found.share, abs=1e-6)


def test_the_order_of_joints_does_not_matter():
    v = ONE.motion.v[:, 0]
    residual = bent(ONE) + filtered(ONE, np.abs(v)) + noise(ONE, 0)
    everything = np.array([noise(ONE, 1), residual])
    motion = ONE.motion
    swapped = replace(
        motion, **{k: getattr(motion, k)[:, ::-1] for k in ("q", "v", "a", "load")}
    )
    (base, elbow), _ = ceilings(Left(ONE.view, motion, everything), [0, 1], NAMES, 0.05)
    (first, second), _ = ceilings(
        Left(ONE.view, swapped, everything[::-1]), [0, 1], NAMES[::-1], 0.05
    )
    assert (first.joint_name, second.joint_name) == ("elbow", "base")
    assert first.share == pytest.approx(elbow.share, abs=1e-6)
    assert second.share == pytest.approx(base.share, abs=1e-6)


def test_rows_without_weight_do_not_count():
    weight = np.ones((2000, 2))
    weight[600:1000, JOINT] = 0.0
    model = viewed((2,), 40.0, weight)
    residual = bent(model) + noise(model, 0)
    found, _ = measured(model, residual)
    out = model.view.equations.weight[:, JOINT] == 0
    assert out.any()
    spoilt, _ = measured(model, np.where(out, 100.0, residual))
    assert spoilt.within == found.within


def test_no_row_is_judged_by_its_neighbours():
    seconds = 0.2
    for model in (ONE, TWO):
        stretches = Stretches.of(model.view, seconds, np.random.RandomState(0))
        folds = stretches.other_blocks()
        tested = np.sum([fold.test for fold in folds], axis=0)
        assert (tested == 1).all()
        apart = np.arange(1, int(2 * seconds / model.view.step))
        for fold in folds:
            pairs = [(fold.train, fold.test), *fold.trials]
            pairs += [(train, fold.test) for train, _ in fold.trials]
            pairs += [(valid, fold.test) for _, valid in fold.trials]
            for fitted, judged in pairs:
                assert not (fitted & judged).any()
                assert all(
                    not (fitted[k:] & judged[:-k]).any()
                    and not (fitted[:-k] & judged[k:]).any()
                    for k in apart
                )


@pytest.mark.parametrize("count", [2, 3, 7])
def test_recordings_are_judged_by_others(count):
    origin = np.repeat(np.arange(count), 50)
    stretches = Stretches(label=np.arange(origin.size) // 10 % 4, gap=2)
    folds = stretches.other_recordings(origin)
    assert (np.sum([fold.test for fold in folds], axis=0) == 1).all()
    for fold in folds:
        own = set(origin[fold.test])
        assert not own & set(origin[fold.train])
        for train, valid in fold.trials:
            assert not own & set(origin[train | valid])
            assert not (train & valid).any()
    assert stretches.other_recordings(np.zeros(50, int)) is None


def test_way_and_time_since_a_reversal():
    q = np.array([0.0, 1.0, 2.0, 1.5, 0.5, 0.5, 0.6, 1.0, 3.0, 2.0, 1.0])
    v = np.array([1.0, 1.0, 1.0, -1.0, -1.0, 0.0, 0.1, 1.0, 1.0, -1.0, -1.0])
    way, since = since_reversal(q, v, 0.2, [slice(0, 9), slice(9, 11)])
    known = [np.nan] * 3
    np.testing.assert_array_equal(way[:9], [*known, 0, 1, 1, 0.9, 0, 2])
    np.testing.assert_array_equal(since[:9], [*known, 0, 1, 2, 3, 0, 1])
    assert np.isnan([way[9:], since[9:]]).all()


def test_a_joint_that_hardly_moves_has_no_ceiling():
    weight = np.ones((2000, 2))
    weight[300:, JOINT] = 0.0
    model = viewed((2,), 40.0, weight)
    everything = np.array([bent(model)] * 2)
    left = Left(model.view, model.motion, everything)
    found, maps = ceilings(left, [0, 1], NAMES, 0.05)
    assert [one.joint for one in found] == [0]
    assert JOINT not in maps


def test_each_source_has_the_signals_of_the_one_before():
    tables = Signals.of(ONE).tables(JOINT)
    for fewer, more in itertools.pairwise(tables):
        np.testing.assert_array_equal(more[:, : fewer.shape[1]], fewer)
    assert len(tables[2].T) == len(tables[1].T) + 5
    np.testing.assert_allclose(
        tables[2][:, -2],
        ONE.view.filtered(ONE.motion.q[:, [0]])[:, 0],
    )


def test_a_loop_has_it_for_joints_above_their_floor():
    recording = record("ZY", seed=2, duration=40.0)
    v = recording.v[:, 1]
    torque = recording.torque(joint_2=lambda r: 0.6 * np.cos(3 * v / v.std()))
    given = {"effects": ["coulomb"], "robot": recording.robot(torque_noise=0.05)}
    loop = recording.discover(torque, **given)
    assert named(loop) == []
    above = [u.joint for u in loop.unexplained_]
    assert above == [1]
    assert loop.ceiling_.shape == (2, 3)
    assert np.isnan(loop.ceiling_[0]).all()
    assert (loop.ceiling_[1] > 0.5).all()
    without = recording.discover(torque, ceiling=False, **given)
    assert np.isnan(without.ceiling_).all()
    assert without.unexplained_ == loop.unexplained_
