"""Effects are tried on motion that they were not fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("pinocchio")

from sklearn_vbjfa import JointTorqueRegressor, PhysicalProjector, effects
from sklearn_vbjfa.diagnosis.search._blocks import Blocks
from sklearn_vbjfa.diagnosis.search._model import SearchModel
from sklearn_vbjfa.diagnosis.search._transfer import Transfer, stretches
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import coulomb, found, search, spring

ARM = record("ZY", seed=2, duration=30.0)
HALVES = np.repeat([0, 1], ARM.t.size // 2)


def blocks_of(label):
    return Blocks(label=label, fold=label % 8, length=1.0)


def test_stretches_are_thirds_of_every_recording():
    label = np.repeat(np.arange(12), 5)
    one = stretches(blocks_of(label), np.zeros(60, int))
    assert_array_equal(one, np.repeat([0, 1, 2], 20))
    two = stretches(blocks_of(label), np.repeat([0, 1], [30, 30]))
    assert_array_equal(two, np.tile(np.repeat([0, 1, 2], 10), 2))
    # A recording of two blocks cannot be cut in three.
    short = stretches(blocks_of(label), np.repeat([0, 1], [50, 10]))
    assert_array_equal(short[50:], 1)


def test_squares_are_those_of_models_that_did_not_see_the_stretch():
    torque = ARM.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    robot = ARM.robot(projector=None, input_noise=None)
    now = search(torque, ["coulomb"], ARM, robot, groups=HALVES)
    view, motion = now.view, now.view.motion(None)
    one, other = effects.Coulomb(1), effects.Spring(0)
    both = replace(SearchModel.of(view).beside([one, other]), motion=motion)
    precision, found = both.precision, Transfer(both)
    both, alone = found.squares([one, other]), found.squares([other])
    assert both.shape == (3, 2)
    assert np.all(both[:, 1] < 0.1 * alone[:, 1])

    # The same with rows.
    columns = view.filtered(other.columns(motion))
    extra = np.zeros((columns.shape[0], 2, columns.shape[1]))
    extra[:, 0] = columns
    Phi = np.concatenate([view.equations.Phi, extra], axis=2)
    tau, weight = view.equations.tau, view.equations.weight
    third = stretches(view.blocks, view.origin)
    for k in range(3):
        kept, rest = third == k, third != k
        model = JointTorqueRegressor(joint_weights=precision)
        model.fit(
            Phi[rest].reshape(tau[rest].shape[0], -1),
            tau[rest],
            sample_weight=weight[rest],
        )
        residual = tau[kept] - Phi[kept] @ model.theta_
        expected = (weight[kept] * residual**2).sum(axis=0)
        assert_allclose(alone[k], expected, rtol=1e-6)


def test_bodies_of_every_stretch_are_physically_consistent(monkeypatch):
    made = []
    transform = PhysicalProjector.transform

    def spy(self, X):
        made.append(transform(self, X))
        return made[-1]

    monkeypatch.setattr(PhysicalProjector, "transform", spy)
    now = search(ARM.torque(), ["coulomb"], ARM, groups=HALVES)
    made.clear()
    Transfer(SearchModel.of(now.view)).squares([])
    assert len(made) == 3


def accepted_of(torque, candidates, chosen, groups=None):
    """Return a search that accepted some effects, after the withdrawal."""
    now = search(torque, candidates, ARM, groups=groups)
    now.accept(())
    now.accept(chosen)
    now.withdraw()
    return now


def test_what_holds_on_one_stretch_only_is_withdrawn():
    """A spring that acts in the first third and not in the others."""
    first = ARM.t < ARM.t[-1] / 3
    torque = ARM.torque(joint_2=coulomb(1.0))
    torque[first, 0] += 4.0 * ARM.q[first, 0]
    friction = effects.Coulomb(1)
    now = accepted_of(torque, ["spring", "coulomb"], [effects.Spring(0), friction])
    assert now.model.effects == (friction,)
    step = now.steps[0]
    assert (step.action, step.effect.name, step.replaced) == (
        "withdraw",
        "spring",
        None,
    )
    assert step.evidence.gain < 0
    # It explains what it was fitted to all the same.
    assert np.sum(step.squares_after[0]) > np.sum(step.squares_before[0])


@pytest.mark.parametrize("groups", [None, HALVES])
def test_what_acts_everywhere_stays(groups):
    always = ARM.torque(joint_2=coulomb(1.0), joint_1=spring(4.0))
    chosen = [effects.Spring(0), effects.Coulomb(1)]
    kept = accepted_of(always, ["spring", "coulomb"], chosen, groups)
    assert kept.model.effects == tuple(chosen)
    now = search(always, ["spring", "coulomb"], ARM, groups=groups).run()
    assert sorted(found(now)) == [("coulomb", 1), ("spring", 0)]
    assert "withdraw" not in [s.action for s in now.steps]


def test_what_only_one_recording_has_is_judged_inside_it():
    """A load that the second of two recordings carries throughout."""
    carried = 1.5 * (HALVES == 1)
    torque = ARM.torque(joint_2=coulomb(1.0))
    torque[:, 1] += carried * np.cos(ARM.q[:, 1])

    class Carried(effects.Effect):
        """Weight from an instant on."""

        name = "carried"
        coefficients = ("mgl",)
        units = (("N m", "N m"),)
        needs = ("time",)

        def columns(self, motion):
            after = motion.t >= ARM.t[ARM.t.size // 2]
            return (np.cos(motion.q[:, self.joint]) * after)[:, None]

    chosen = [Carried(1), effects.Coulomb(1)]
    now = accepted_of(torque, ["coulomb"], chosen, HALVES)
    assert now.model.effects == tuple(chosen)
    # Left out as a whole it could not be known.
    assert now.evidence_of(chosen[0]).gain > 0.3


def test_nothing_useless_is_left_behind_a_withdrawal():
    """Whatever stays pays for itself beside what stays."""
    first = ARM.t < ARM.t[-1] / 3
    torque = ARM.torque(joint_2=coulomb(1.0))
    torque[first, 0] += 4.0 * ARM.q[first, 0]
    useless = effects.Offset(1)
    chosen = [effects.Spring(0), effects.Coulomb(1), useless]
    now = accepted_of(torque, ["spring", "coulomb", "offset"], chosen)
    assert useless not in now.model.effects
    for effect in now.model.effects:
        case = now.evidence_of(effect)
        assert case.gain > 0
        assert case.p_value < 0.05
