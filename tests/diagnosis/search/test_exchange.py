"""Pairs, swaps and the last pass backwards, where single steps come out otherwise."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa.diagnosis.search import _exchange
from sklearn_vbjfa.diagnosis.search._evidence import Rule, Step, compare
from sklearn_vbjfa.effects import Effect
from tests.diagnosis.search._searches import CLEAN, found, search

TORQUE = (("N m", "N"),)
# A slow signal that nothing has, and one that hides it.
N = CLEAN.t.size
SIGNAL = np.sin(2 * np.pi * 0.31 * CLEAN.t)
COVER = 5.0 * np.sin(2 * np.pi * 0.47 * CLEAN.t + 1.0)
OTHER = np.sin(2 * np.pi * 0.23 * CLEAN.t + 0.5)


def effect(kind, signal):
    """Make an effect whose column is a signal (n,) of the recording."""

    class Given(Effect):
        name = kind
        coefficients = ("x",)
        units = TORQUE

        def columns(self, motion):
            return signal[: motion.q.shape[0], None]

    return Given


def torque_of(signal):
    return CLEAN.torque(joint_1=lambda r: signal[: r.t.size])


def actions(now):
    return [(s.action, s.effect.name, s.rule.name) for s in now.steps]


def test_two_effects_that_are_worth_nothing_alone():
    """The difference of two that hide each other."""
    library = [effect("covered", SIGNAL + COVER), effect("cover", COVER)]
    now = search(torque_of(0.12 * SIGNAL), library)
    now.accept(())
    assert all(c.evidence.gain < 0.1 for c in now.scored(0, now.model, -np.inf))
    result = now.run()
    assert sorted(found(result)) == [("cover", 0), ("covered", 0)]
    pair = [s for s in result.steps if s.rule.name == _exchange.PAIR]
    assert {s.effect.name for s in pair} == {"cover", "covered"}
    assert pair[0].evidence.gain > 0.5
    assert pair[0].evidence.p_value < pair[0].rule.level < 0.05
    assert pair[0].rule.n_tests == 1


def test_no_pair_in_what_has_no_effect():
    library = [effect("covered", SIGNAL + COVER), effect("cover", COVER)]
    assert search(torque_of(0.12 * OTHER), library).run().effects == ()


def test_two_in_place_of_one_that_was_taken_for_them():
    """What came first is a mixture in a wrong proportion."""
    mixture = effect("mixture", SIGNAL + 0.5 * OTHER)
    library = [mixture, effect("first", SIGNAL + COVER), effect("second", COVER)]
    now = search(torque_of(SIGNAL), library)
    taken = mixture(0)
    now.accept([taken])
    assert _exchange._pair(now, 0, taken)
    assert sorted(e.name for e in now.model.effects) == ["first", "second"]
    (swap, added) = now.steps
    assert (swap.action, swap.replaced, added.action) == ("replace", taken, "add")
    assert swap.rule.name == added.rule.name == _exchange.FOR_TWO
    assert swap.evidence.p_value < swap.rule.level
    # The whole search ends there as well, by whatever way.
    result = search(torque_of(SIGNAL), library).run()
    assert sorted(found(result)) == [("first", 0), ("second", 0)]


def test_one_that_does_as_well_is_not_swapped_for_two():
    library = [effect("right", SIGNAL), effect("one", OTHER), effect("two", COVER)]
    now = search(torque_of(SIGNAL), library)
    taken = library[0](0)
    now.accept([taken])
    assert not _exchange._pair(now, 0, taken)
    assert now.model.effects == (taken,)


def test_one_in_place_of_two():
    """Two that together are the third."""
    whole = effect("whole", SIGNAL + OTHER)
    library = [effect("first", SIGNAL), effect("second", OTHER), whole]
    now = search(torque_of(SIGNAL + OTHER), library)
    own = [kind(0) for kind in (e for e in library[:2])]
    now.accept(own)
    assert _exchange.exchange(now)
    assert [e.name for e in now.model.effects] == ["whole"]
    assert actions(now) == [
        ("replace", "whole", _exchange.FOR_ONE),
        ("drop", "second", _exchange.FOR_ONE),
    ]
    # Not where both are needed.
    now = search(torque_of(SIGNAL - OTHER), library)
    now.accept(own)
    assert not _exchange.exchange(now)
    assert now.model.effects == tuple(own)


def test_the_last_pass_takes_back_what_was_dropped_too_early():
    library = [effect("first", SIGNAL), effect("second", OTHER)]
    now = search(torque_of(SIGNAL + OTHER), library)
    first, second = (kind(0) for kind in library)
    now.accept([first])
    now.steps.append(
        Step(
            action="drop",
            effect=second,
            evidence=compare(np.ones(3), np.ones(3)),
            rule=Rule(name="earlier"),
            squares_before=np.zeros(2),
            squares_after=np.zeros(2),
        )
    )
    _exchange.backwards(now)
    assert sorted(e.name for e in now.model.effects) == ["first", "second"]
    assert actions(now)[1:] == [("add", "second", _exchange.BACKWARDS)]


def test_the_last_pass_leaves_out_what_is_not_needed():
    library = [effect("first", SIGNAL), effect("second", OTHER)]
    now = search(torque_of(SIGNAL), library)
    first = library[0](0)
    now.accept([first])
    before = now.model
    _exchange.backwards(now)
    assert now.model is before
    assert now.steps == []
