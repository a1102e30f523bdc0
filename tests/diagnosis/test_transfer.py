"""Effects are tried on motion that they were not fitted to."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("pinocchio")

from sklearn_vbjfa import JointTorqueRegressor, PhysicalProjector, effects
from sklearn_vbjfa.diagnosis._blocks import Blocks
from sklearn_vbjfa.diagnosis._transfer import Transfer, stretches
from tests.diagnosis._recordings import record
from tests.diagnosis.test_search import coulomb, found, search, spring

ARM = record("ZY", seed=2, duration=30.0)
HALVES = np.repeat([0, 1], ARM.t.size // 2)


def blocks_of(label):
    return Blocks(label=label, fold=label % 8, length=1.0)


def test_stretches_are_recordings_or_thirds():
    label = np.repeat(np.arange(12), 5)
    assert_array_equal(stretches(blocks_of(label), [0]), np.repeat([0, 1, 2], 20))
    two = stretches(blocks_of(label), np.array([0, 25]))
    assert_array_equal(two, np.repeat([0, 1], [25, 35]))
    # Neighbouring recordings stay together where there are many.
    eight = stretches(blocks_of(label), np.array([0, 5, 10, 15, 20, 25, 30, 40]))
    assert_array_equal(eight, np.repeat([0, 1, 2, 3], [10, 10, 10, 30]))


def test_squares_are_those_of_models_that_did_not_see_the_stretch():
    torque = ARM.torque(joint_2=coulomb(1.0), joint_1=spring(4.0, 1.0))
    robot = ARM.robot(projector=None, input_noise=None)
    now = search(torque, ["coulomb"], ARM, robot, groups=HALVES)
    view, motion = now.view, now.view.motion(None)
    one, other = effects.Coulomb(1), effects.Spring(0)
    found = Transfer(view, motion, [one, other])
    both, alone = found.squares([one, other]), found.squares([other])
    assert both.shape == (2, 2)
    assert np.all(both[:, 1] < 0.1 * alone[:, 1])

    # The same with rows.
    columns = view.filtered(other.columns(motion))
    extra = np.zeros((columns.shape[0], 2, columns.shape[1]))
    extra[:, 0] = columns
    Phi = np.concatenate([view.equations.Phi, extra], axis=2)
    tau, weight = view.equations.tau, view.equations.weight
    border = view.starts[1]
    for k, kept in enumerate((slice(None, border), slice(border, None))):
        rest = slice(border, None) if k == 0 else slice(None, border)
        model = JointTorqueRegressor(joint_weights=view.precision)
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
    Transfer(now.view, now.view.motion(None), []).squares([])
    assert len(made) == 2


def test_what_holds_on_one_motion_only_is_withdrawn():
    """A spring that acts in the first recording and not in the second."""
    first = HALVES == 0
    torque = ARM.torque(joint_2=coulomb(1.0))
    torque[first, 0] += 4.0 * ARM.q[first, 0]
    friction = effects.Coulomb(1)

    def withdrawn(torque):
        now = search(torque, ["spring", "coulomb"], ARM, groups=HALVES)
        now._refresh()
        now.accepted = [effects.Spring(0), friction]
        now._refresh()
        now._withdraw()
        return now

    now = withdrawn(torque)
    assert now.accepted == [friction]
    (step,) = now.steps
    assert (step.action, step.effect.name, step.replaced) == (
        "withdraw",
        "spring",
        None,
    )
    assert step.evidence.gain < 0
    # It explains what it was fitted to all the same.
    assert np.sum(step.squares_after[0]) > np.sum(step.squares_before[0])

    # One that acts in both stays, and a search leaves it in peace.
    always = ARM.torque(joint_2=coulomb(1.0), joint_1=spring(4.0))
    assert len(withdrawn(always).accepted) == 2
    now = search(always, ["spring", "coulomb"], ARM, groups=HALVES).run()
    assert sorted(found(now)) == [("coulomb", 1), ("spring", 0)]
    assert "withdraw" not in [s.action for s in now.steps]
