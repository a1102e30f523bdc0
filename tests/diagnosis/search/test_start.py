"""The same effects from every start: plain friction, order, sample period."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search._common_start import PLAIN, plain_terms
from sklearn_vbjfa.diagnosis.search._left_out import can_be_left_out, left_out
from sklearn_vbjfa.diagnosis.search._model import Judge
from sklearn_vbjfa.effects import resolve
from tests.diagnosis._recordings import DT, named, record
from tests.diagnosis.search._searches import CLEAN, coulomb, search, spring, stribeck

ARM = record("ZY", seed=4, duration=30.0)
STARTS = (
    (),
    ("viscous",),
    ("viscous", "coulomb"),
    ("viscous", "coulomb", "offset", "rotor_inertia"),
)


def lacking():
    """Friction on both joints, a hump on the second, a spring on the first."""
    return ARM.torque(
        joint_1=lambda r: 0.8 * np.sign(r.v[:, 0]) + 3.0 * r.q[:, 0],
        joint_2=stribeck(1.5),
    )


def everything(loop, friction):
    """Names on joints, those declared included."""
    nv = ARM.q.shape[1]
    return {(name, j) for name in friction for j in range(nv)} | set(named(loop))


@pytest.fixture(scope="module")
def loops():
    torque = lacking()
    return {
        friction: ARM.discover(torque, robot=ARM.robot(friction=friction))
        for friction in STARTS
    }


# -- starts


def test_every_start_ends_at_the_same_effects(loops):
    truth = {(n, j) for n in ("viscous", "coulomb") for j in (0, 1)}
    truth |= {("stribeck", 1), ("spring", 0)}
    for friction, loop in loops.items():
        asked = {(name, j) for name in friction for j in (0, 1)}
        assert everything(loop, friction) == truth | asked, friction


def test_every_start_ends_at_the_same_errors(loops):
    errors = [loop.error_after_ for loop in loops.values()]
    # The last has an offset and a rotor inertia in addition, fitted to noise.
    for error in errors[1:]:
        assert_allclose(error, errors[0], rtol=0.03)


def test_plain_terms_come_first_with_their_own_rule(loops):
    rounds = loops[()].rounds_
    plain = [r for r in rounds if r.rule == PLAIN]
    assert list(rounds[: len(plain)]) == plain
    assert {(r.name, r.joint) for r in plain} == {
        (n, j) for n in ("viscous", "coulomb") for j in (0, 1)
    }
    gains = [r.evidence.gain for r in plain]
    assert gains == sorted(gains, reverse=True)
    for r in plain:
        assert r.evidence.p_value < r.level <= 0.05
        assert r.error_after[r.joint] < r.error_before[r.joint]


def test_a_library_without_friction_starts_from_what_is_declared():
    loop = ARM.discover(
        ARM.torque(joint_1=lambda r: 3.0 * r.q[:, 0]),
        ["spring"],
        robot=ARM.robot(friction=()),
    )
    # Viscous friction is there, but nobody asked for it.
    assert named(loop) == [("spring", 0)]
    assert plain_terms((), resolve(["spring", "offset"])) == ("offset",)
    assert plain_terms(("offset",), resolve(["spring", "offset"])) == ()


# -- what is not the robot's


def test_the_order_of_recordings_does_not_matter():
    torque = lacking()
    parts = np.array_split(np.arange(ARM.t.size), 3)
    sets = []
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        rows = np.concatenate([parts[k] for k in order])
        labels = np.concatenate([np.full(parts[k].size, k) for k in order])
        loop = ARM.robot()
        loop = effects_of(loop, ARM.position[rows], torque[rows], labels)
        sets.append(loop)
    for other in sets[1:]:
        assert named(other) == named(sets[0])
        assert_allclose(other.error_after_, sets[0].error_after_, rtol=1e-6)


def test_a_sample_period_that_is_off_by_two_per_cent_does_not_matter():
    """Speeds, forces of inertia and the band are off; what the robot has is not."""
    torque = lacking()
    for factor in (0.98, 1.02):
        loop = ARM.discover(torque, robot=ARM.robot(dt=factor * DT))
        assert {("stribeck", 1), ("spring", 0)} <= set(named(loop))
        assert set(named(loop)) <= {
            ("stribeck", 1),
            ("spring", 0),
            ("coulomb", 0),
            ("coulomb", 1),
        }


def effects_of(robot, position, torque, labels):
    from sklearn_vbjfa import EffectDiscovery

    names = ["coulomb", "offset", "rotor_inertia", "stribeck", "spring", "presliding"]
    loop = EffectDiscovery(robot, effects=names, ceiling=False)
    return loop.fit(position, torque, groups=labels)


# -- leaving out, against fits written out


@pytest.fixture(scope="module")
def full():
    """Accept plain terms of which some are there."""
    torque = CLEAN.torque(joint_2=coulomb(1.0), joint_1=spring(2.0, 0.5))
    now = search(torque, ["coulomb", "offset", "spring"])
    own = [
        effects.Coulomb(0),
        effects.Coulomb(1),
        effects.Offset(1),
        effects.Spring(0),
    ]
    now.accept(own)
    return now


def test_what_is_left_out_is_what_a_fit_without_it_gives(full):
    model = full.model
    for one in left_out(model, list(model.effects)):
        rest = model.beside(model.without(one.effect))
        joint = one.effect.joint
        # The ridge is relative to the mean of the columns, of which one is gone.
        assert_allclose(
            one.squares[0][joint], rest.squares.sum(axis=0)[joint], rtol=1e-3
        )
        assert_allclose(one.squares[1], model.squares.sum(axis=0), rtol=1e-12)
        share = 1 - one.squares[1][joint] / one.squares[0][joint]
        assert one.evidence.gain == pytest.approx(share, rel=1e-8)


def test_whitened_rows_are_those_of_the_whole_model(full):
    """Of several columns at once as well."""
    model = full.model
    judge = Judge(model, model.residuals())
    (place,) = [p for e, p in zip(model.effects, model.places()) if e.name == "spring"]
    columns = np.arange(place.start, place.stop)
    white = judge.without(0, [columns])[:, 0]
    assert white.sum() > 5 * judge.squares[:, 0].sum()
    # Whatever is left out together costs at least what either costs alone.
    alone = judge.without(0, [columns[:1], columns[1:]])
    assert (white.sum() >= alone.sum(axis=0) * (1 - 1e-9)).all()


def test_what_is_there_costs_most_and_what_is_not_is_no_loss(full):
    cases = {
        (x.effect.name, x.effect.joint): x.evidence
        for x in left_out(full.model, list(full.model.effects))
    }
    assert cases["coulomb", 1].gain > 0.9
    assert cases["spring", 0].gain > 0.9
    for name in (("coulomb", 0), ("offset", 1)):
        assert cases[name].gain < 0.02
        assert not cases[name].significant(0.01)


def test_effects_with_shapes_are_not_left_out_linearly():
    assert can_be_left_out(effects.Offset(0))
    assert can_be_left_out(effects.Spring(0))
    assert not can_be_left_out(effects.Ripple(0))
    assert not can_be_left_out(effects.Elastic(0))


def test_nothing_is_left_out_of_nothing(full):
    assert left_out(full.model, []) == []
