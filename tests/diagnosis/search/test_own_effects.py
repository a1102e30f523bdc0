"""Effects of one's own, whatever their columns are."""

import time

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.effects import Effect
from tests._quick import one_in
from tests.diagnosis._recordings import named, record

ARM = record("ZY", seed=0, duration=20.0)
TORQUE = ARM.torque(joint_1=lambda r: 4.0 * r.q[:, 0] + 1.0)
SPRING = [("spring", 0)]


def own(kind, columns, width=1):
    """Make the class of an effect from a function (motion, joint) -> columns."""

    class Own(Effect):
        name = kind
        coefficients = tuple("abc"[:width])
        units = (("N m", "N"),) * width

        def columns(self, motion):
            return columns(motion, self.joint)

    return Own


def close(library, torque=TORQUE, **given):
    return ARM.discover(torque, library, **given)


@pytest.fixture(scope="module")
def alone():
    """Search for a spring, and nothing else."""
    return close(["spring"])


def test_a_library_of_one_effect(alone):
    assert named(alone) == SPRING
    assert alone.possible_ == ()
    assert alone.report_.outcome.settings["n_candidates"] == 2


INERT = {
    "constant": lambda m, j: np.ones((len(m.q), 1)),
    "zero": lambda m, j: np.zeros((len(m.q), 1)),
    "speed": lambda m, j: 3.0 * m.v[:, [j]],
    "acceleration": lambda m, j: m.a[:, [j]],
    "weight": lambda m, j: np.cos(m.q[:, [1]]) * (j == 1),
    "tiny": lambda m, j: 1e-200 * m.q[:, [j]] ** 3,
}


@pytest.mark.parametrize("kind", one_in(3, INERT))
def test_what_the_model_has_already_is_never_named(kind, alone):
    """Offset, friction, inertia and weight are fitted anyway."""
    inert = own(kind, INERT[kind])
    loop = close([inert, "spring"])
    assert named(loop) == SPRING
    assert kind not in {e.name for e in loop.possible_}
    found = loop.effects_[0].parameters["k"]
    assert found == pytest.approx(alone.effects_[0].parameters["k"], rel=1e-6)
    assert kind in {h.name for h in loop.hidden_}
    assert close([inert]).effects_ == ()


def test_a_column_of_the_regressor_itself_is_never_named():
    """One that nobody gave a name, of the second joint's body."""
    robot = ARM.robot().fit(ARM.position, TORQUE)

    def column(motion, joint):
        states = np.hstack([motion.q, motion.v, motion.a])
        # First moment of mass along x, as the second joint feels it.
        return robot.features_.matrices(states)[:, joint, 11:12]

    loop = close([own("of_a_body", column), "spring"])
    assert named(loop) == SPRING
    assert "of_a_body" not in {e.name for e in loop.possible_}


def test_a_column_twice_is_that_column():
    twice = own("twice", lambda m, j: np.repeat(m.q[:, [j]], 2, axis=1), width=2)
    loop = close([twice])
    assert named(loop) == [("twice", 0)]
    assert sum(loop.effects_[0].parameters.values()) == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("factor", one_in(2, [1e6, 1e-6]))
def test_the_size_of_a_column_does_not_matter(factor, alone):
    scaled = own("scaled", lambda m, j: factor * m.q[:, [j]])
    loop = close([scaled])
    assert named(loop) == [("scaled", 0)]
    assert factor * loop.effects_[0].parameters["a"] == pytest.approx(4.0, rel=0.05)
    unscaled = close([own("scaled", lambda m, j: m.q[:, [j]])])
    odds = [one.effects_[0].log_odds for one in (loop, unscaled)]
    assert odds[0] == pytest.approx(odds[1], rel=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_columns_that_are_not_finite_are_refused_by_name(bad):
    broken = own("broken", lambda m, j: np.where(m.q[:, [j]] > 0.3, bad, 1.0))
    message = r"'broken' on joint_1 has columns that are not finite in \d+ of \d+"
    for library in ([broken], ["spring", broken]):
        with pytest.raises(ValueError, match=message):
            close(library)


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
def test_columns_of_another_shape_are_refused_by_name(columns):
    message = r"'odd' on joint_1 must have columns of shape \(\d+, 1\).*got \("
    with pytest.raises(ValueError, match=message):
        close([own("odd", columns)])


@pytest.mark.slow
def test_two_hundred_effects_are_searched_in_little_time(alone):
    library = [
        own(f"wave_{i}", lambda m, j, i=i: np.sin((1 + 0.1 * i) * m.q[:, [j]] + i))
        for i in range(200)
    ]
    begin = time.process_time()
    loop = close([*library, "spring"])
    assert time.process_time() - begin < 30.0
    assert named(loop) == SPRING
    assert loop.report_.outcome.settings["n_candidates"] == 402
    # Of more candidates each is less expected.
    assert loop.effects_[0].log_odds < alone.effects_[0].log_odds


@pytest.mark.filterwarnings("ignore")
def test_a_joint_that_never_moves_has_nothing():
    """Its encoder reads one value, or that and noise: the other joint is searched."""
    noise = 2e-5 * np.random.default_rng(0).normal(size=len(ARM.position))
    for reading in (0.0 * noise, noise):
        q = ARM.position.copy()
        q[:, 1] = 0.3 + reading
        loop = EffectDiscovery(ARM.robot(), effects=["spring", "coupling"])
        loop.fit(q, TORQUE)
        assert {e.joint for e in (*loop.effects_, *loop.possible_)} <= {0}
        assert loop.report_.outcome.unsearched == (1,)


@pytest.mark.parametrize("duration", one_in(2, [1.0, 3.0, 5.0, 8.0]))
def test_a_recording_of_a_few_seconds_names_what_is_there_or_nothing(duration):
    short = record("ZY", seed=0, duration=duration)
    loop = short.discover(short.torque(joint_1=lambda r: 4.0 * r.q[:, 0] + 1.0))
    assert set(named(loop)) <= set(SPRING)
