"""Custom effects with unusual columns."""

import numpy as np
import pytest

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.effects import Effect
from tests._quick import one_in
from tests.diagnosis._recordings import SPRINGY, named, record

ARM, TORQUE = SPRINGY.parts[0], SPRINGY.torque
SPRING = [("spring", 0)]


def custom(kind, columns, width=1):
    """Define an effect class by a function (motion, joint) -> columns."""

    class Own(Effect):
        name = kind
        coefficients = tuple("abc"[:width])
        units = (("N m", "N"),) * width

        def columns(self, motion):
            return columns(motion, self.joint)

    return Own


def discover(library, torque=TORQUE, **options):
    return ARM.discover(torque, library, **options)


INERT = {
    "constant": lambda m, j: np.ones((len(m.q), 1)),
    "zero": lambda m, j: np.zeros((len(m.q), 1)),
    "speed": lambda m, j: 3.0 * m.v[:, [j]],
    "acceleration": lambda m, j: m.a[:, [j]],
    "weight": lambda m, j: np.cos(m.q[:, [1]]) * (j == 1),
    "tiny": lambda m, j: 1e-200 * m.q[:, [j]] ** 3,
}


@pytest.mark.slow
def test_effects_of_the_baseline_are_never_named(springy):
    inert = [custom(kind, columns) for kind, columns in INERT.items()]
    loop = discover([*inert, "spring"])
    assert named(loop) == SPRING
    assert loop.possible_ == ()
    k, expected = (x.effects_[0].parameters["k"] for x in (loop, springy))
    assert k == pytest.approx(expected, rel=1e-3)
    assert set(INERT) <= {h.name for h in loop.not_identifiable_}
    assert discover(inert).effects_ == ()


def test_a_column_of_the_regressor_itself_is_never_named():
    robot = ARM.robot().fit(ARM.position, TORQUE)

    def column(motion, joint):
        states = np.hstack([motion.q, motion.v, motion.a])
        # First moment of mass along x, in the equation of the joint.
        return robot.features_.matrices(states)[:, joint, 11:12]

    loop = discover([custom("of_a_body", column), "spring"])
    assert named(loop) == SPRING
    assert "of_a_body" not in {e.name for e in loop.possible_}


def test_a_duplicate_column_is_handled():
    twice = custom("twice", lambda m, j: np.repeat(m.q[:, [j]], 2, axis=1), width=2)
    loop = discover([twice])
    assert named(loop) == [("twice", 0)]
    assert sum(loop.effects_[0].parameters.values()) == pytest.approx(4.0, rel=0.05)


@pytest.mark.slow
def test_evidence_is_independent_of_column_scale():
    odds = []
    for factor in (1.0, 1e6):
        scaled = custom("scaled", lambda m, j, factor=factor: factor * m.q[:, [j]])
        loop = discover([scaled])
        assert named(loop) == [("scaled", 0)]
        assert factor * loop.effects_[0].parameters["a"] == pytest.approx(4.0, rel=0.05)
        odds.append(loop.effects_[0].log_odds)
    assert odds[1] == pytest.approx(odds[0], rel=1e-6)


@pytest.mark.parametrize("bad", one_in(3, [np.nan, np.inf, -np.inf]))
def test_non_finite_columns_are_rejected(bad):
    broken = custom("broken", lambda m, j: np.where(m.q[:, [j]] > 0.3, bad, 1.0))
    message = r"'broken' on joint_1 has columns that are not finite in \d+ of \d+"
    for library in ([broken], ["spring", broken]):
        with pytest.raises(ValueError, match=message):
            discover(library)


@pytest.mark.parametrize(
    "columns",
    [
        lambda m, j: m.q[:, j],
        lambda m, j: m.q,
        lambda m, j: m.q[:-1, [j]],
        lambda m, j: np.ones((3, 1)),
        lambda m, j: 1.0,
    ],
    ids=["flat", "of all joints", "short", "three rows", "scalar"],
)
def test_columns_of_wrong_shape_are_rejected(columns):
    message = r"'odd' on joint_1 must have columns of shape \(\d+, 1\).*got \("
    with pytest.raises(ValueError, match=message):
        discover([custom("odd", columns)])


def test_two_seconds_cause_no_false_positives():
    short = record("ZY", seed=0, duration=2.0)
    loop = short.discover(short.torque(joint_1=lambda r: 4.0 * r.q[:, 0] + 1.0))
    assert set(named(loop)) <= set(SPRING)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_joints_at_rest_are_not_searched():
    """A constant or noisy encoder of one joint; only the other one is searched."""
    noise = 2e-5 * np.random.default_rng(0).normal(size=len(ARM.position))
    for reading in (0.0 * noise, noise):
        q = ARM.position.copy()
        q[:, 1] = 0.3 + reading
        loop = EffectDiscovery(ARM.robot(), effects=["spring", "coupling"])
        loop.fit(q, TORQUE)
        assert {e.joint for e in (*loop.effects_, *loop.possible_)} <= {0}
        assert loop.report_.outcome.column("searched").tolist() == [True, False]
