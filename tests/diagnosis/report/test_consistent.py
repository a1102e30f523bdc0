"""Reports that contradict themselves are noticed."""

from dataclasses import replace

import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.effects import JointZero, TorqueGain
from sklearn_vbjfa.robot import Corrections, ZeroCorrection
from tests.diagnosis.report._consistent import assert_consistent
from tests.diagnosis.report._outcomes import (
    EVIDENCE,
    POSSIBLE,
    make_effect,
    make_outcome,
    make_possible,
)

NAMES = tuple(f"joint{j + 1}" for j in range(6))
NAMED, OPEN = make_effect(0, 1, NAMES), make_possible(2, 3, NAMES)


def told(effects=(NAMED,), possible=(OPEN,), **given):
    return Report(make_outcome(effects=effects, possible=possible, **given))


@pytest.mark.parametrize("count", [0, 1, 4])
def test_what_agrees_is_left_alone(count):
    effects = tuple(make_effect(i, i, NAMES) for i in range(count))
    assert_consistent(told(effects, ()))
    assert_consistent(told(effects, (make_possible(3, 5, NAMES),)))


@pytest.mark.parametrize(
    "effect",
    [
        replace(NAMED, evidence=replace(EVIDENCE, log_odds=2.9)),
        replace(NAMED, evidence=replace(EVIDENCE, errors=1.6)),
        replace(NAMED, evidence=replace(EVIDENCE, gain=0.019)),
        replace(NAMED, intervals={"mu": (-0.1, 0.324)}),
        replace(NAMED, warning="undecided"),
        replace(NAMED, intervals={"mu": (0.2, 0.3)}),
    ],
    ids=["improbable", "chance", "small", "unknown", "doubted", "outside"],
)
def test_names_that_are_none_are_noticed(effect):
    with pytest.raises(AssertionError):
        assert_consistent(told((effect,)))


@pytest.mark.parametrize(
    "effect",
    [
        replace(OPEN, warning=""),
        replace(OPEN, evidence=replace(POSSIBLE, log_odds=-0.1)),
        replace(NAMED, warning="undecided"),
    ],
    ids=["no doubt", "improbable", "twice"],
)
def test_possible_effects_that_are_none_are_noticed(effect):
    with pytest.raises(AssertionError):
        assert_consistent(told(possible=(effect,)))


def zero_of(value, half, **given):
    return replace(
        NAMED,
        name="joint_zero",
        joint=2,
        parameters={"zero": value},
        units={"zero": "rad"},
        intervals={"zero": (value - half, value + half)},
        effect=JointZero(2),
        rivals=(),
        **given,
    )


def test_values_in_the_model_are_known_from_what_changes_nothing():
    assert_consistent(told((zero_of(0.05, 0.01),)))
    with pytest.raises(AssertionError):
        assert_consistent(told((zero_of(0.05, 0.06),)))
    gain = replace(
        NAMED,
        name="torque_gain",
        parameters={"gain": 1.02},
        units={"gain": "1"},
        intervals={"gain": (0.99, 1.05)},
        effect=TorqueGain(1),
        rivals=(),
    )
    # Far from zero, and not from one.
    with pytest.raises(AssertionError):
        assert_consistent(told((gain,)))


def test_nothing_is_corrected_on_a_possible_effect():
    zero = zero_of(0.05, 0.01, warning="undecided", evidence=POSSIBLE)
    correction = ZeroCorrection(
        joint=2, joint_name="joint3", subtract=0.05, plain=2.86, plain_unit="degrees"
    )
    report = told(possible=(zero,), corrections=Corrections(zeros=(correction,)))
    assert_consistent(report)
    for text in (str(report), report.to_html()):
        assert "ubtract" not in text
    named = told((zero_of(0.05, 0.01),), corrections=Corrections(zeros=(correction,)))
    assert "ubtract" in str(named)
