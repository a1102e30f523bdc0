"""What reports say of the limits of their figures: the facts, not the sentences."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import Contradiction, Fact, NotIdentifiable
from sklearn_vbjfa.fit import AlikeValue, Departure
from sklearn_vbjfa.inspection import JointMotion
from sklearn_vbjfa.robot import ChannelGains, CommonGain
from tests.diagnosis.report._outcomes import changed, finding, make_outcome
from tests.diagnosis.report._pages import line_of, make_mass, section_of, text_of


def shown(heading, **changes):
    return section_of(Report(make_outcome(nv=3, **changes)), heading)


def assert_said(text, *facts):
    for fact in facts:
        assert fact in text, text


# -- masses


def test_masses_that_are_measured_and_that_are_not():
    text = shown(
        "Masses",
        facts=(
            make_mass("base", 9.0, 10.0, "no"),
            make_mass("upper", 257.0, 339.0, "in combination", 80.0),
            make_mass("fore", 902.0, 339.0, "in combination", 300.0),
            make_mass("slide", 94.3, 95.1, "yes", 0.175),
            make_mass("tool", 3.0, 2.0, "yes", 0.1),
            make_mass("same", 5.0, 5.1, "yes", 0.1),
        ),
    )
    assert_said(text, "base (not at all)", "upper and fore (in combination only)")
    # All are drawn beside the description, with an interval if they are identified.
    assert_said(text, "same 5.00 +- 0.16 kg, described 5.1 kg", "base 9 kg")
    assert shown("Masses") == ""


def test_bodies_that_are_not_as_described():
    one = Departure(bodies=("j2",), factors=(1.98,), stds=(0.03,), log_odds=9.0)
    assert_said(shown("Masses", departures=(one,)), "j2 (1.98 +- 0.05 times)")
    both = Departure(
        bodies=("j2", "j3"), factors=(1.98, 3.0), stds=(0.03, 0.6), log_odds=9.0
    )
    text = shown("Masses", departures=(both,), common_size=0.001)
    assert_said(text, "j2 (1.98 +- 0.05 times) or j3 (3.0 +- 1.0 times)", "0.001 times")
    assert shown("Masses", common_size=0.9) == ""
    for size, expected in ((0.5, False), (0.3, True), (3.1, True)):
        warnings = Report(make_outcome(nv=3, common_size=size)).warnings
        assert any("times as heavy" in one for one in warnings) == expected


def test_alike_joints_share_values():
    def shared(parameter, joints=("j1", "j2", "j3"), scatter=0.04):
        return AlikeValue(
            group="hip",
            parameter=parameter,
            joints=joints,
            places=(),
            scatter=scatter,
            std=0.0003 / 1.645,
            unit="kg m^2",
            value=0.0105,
        )

    given = (shared("rotor_inertia"), shared("my_own_effect:k", scatter=np.nan))
    text = shown("Joints with the same drive", alike=given)
    assert_said(text, "hip rotor inertia 0.0105 +- 0.0003 kg m² 4 % 3")
    assert_said(text, "hip my own effect 0.0105")
    assert shown("Joints with the same drive") == ""


# -- recordings


def test_the_motion_of_each_joint_and_what_it_does_not_show():
    one = JointMotion(
        name="joint2",
        slides=False,
        lowest=-1.0,
        highest=1.5,
        fastest=0.8,
        reversals=3,
        resting=0.25,
        torques=(-5.0, 5.0),
        shows=(),
        hides=("hysteresis: it reverses 3 times",),
    )
    limits = np.array([[-2.0, 2.0, 3.0], [np.inf, np.inf, np.inf]])
    hidden = NotIdentifiable(
        name="spring", joint=0, joint_name="joint1", reason="excitation", remedy="x"
    )
    both = (one, one)
    given = make_outcome(nv=2, not_identifiable=(hidden,), motion=both, limits=limits)
    report = Report(given)
    text = section_of(report, "Excitation")
    assert_said(text, "poor on all", "it reverses 3 times", "-1 to 1.5 rad", "25 %")
    steps = section_of(report, "Next steps")
    assert_said(steps, "a wide range of positions (joint 1)", "-2 to 2 rad")
    assert_said(steps, "0.3 to 3 rad/s", "60 s")
    # Without limits: what was recorded.
    free = Report(changed(given, not_identifiable=(replace(hidden, joint=1),)))
    assert_said(section_of(free, "Next steps"), "-1 to 1.5 rad", "0.08 to 0.8 rad/s")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "o further recording is needed"),
        ({"settings": {"effects": ()}}, "dentify without --no-search"),
        ({"enough": [True, False]}, "ecord more motion of joint 2."),
        ({"channels": [finding("Wrong.", "warning")]}, "orrect the recording, then"),
    ],
)
def test_next_steps_have_an_action_or_say_that_none_is_needed(given, said):
    outcome = changed(make_outcome(nv=2, n_effects=0, not_identifiable=()), **given)
    report = Report(outcome)
    assert_said(section_of(report, "Next steps"), said)
    assert said in line_of(report)


@pytest.mark.parametrize(
    ("cause", "value", "said"),
    [
        ("offset", -0.5, "An offset of -0.5 N m on joint 2"),
        ("gain", 1.2, "A torque of joint 2 that is 1.2 times as large"),
        ("friction", np.nan, "Different friction of joint 2"),
        ("payload", 1.3, "A load of 1.3 kg on the last link"),
        ("payload", -0.8, "0.8 kg less on the last link"),
        ("model", np.nan, "friction or a load on the last link"),
    ],
)
def test_recordings_that_contradict_each_other(cause, value, said):
    errors = {"alone": 0.011, "together": 0.072, "p_value": 1e-5}
    one = Contradiction(recording=0, joint=1, cause=cause, value=value, **errors)
    names = ("slow", "fast", "last")
    report = Report(make_outcome(nv=3, contradictions=(one,), recordings=names))
    assert "Recording slow contradicts the others" in report.headline
    text = section_of(report, "Limits of the recordings")
    assert_said(text, "1.1 %", "7.2 %", "p = 0.00001", "in recording slow", said)


def test_a_motion_that_repeats_in_some_recordings():
    one = SimpleNamespace(seconds=2.0, count=3.0, recordings=(0, 2))
    names = ("slow", "fast", "last")
    text = shown("Limits of the recordings", recordings=names, repeated=(one,))
    assert "Repeated motion: 2 s, 3 times in recordings slow and last." in text


def test_sound_recordings_need_no_words():
    assert shown("Limits of the recordings", recordings=("1", "2")) == ""


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("assumed", "record a second motion"),
        ("partly measured", "recordings partly measured, from 4 recordings"),
        ("measured", "recordings measured, from 4 recordings"),
    ],
)
def test_the_next_recording_says_what_it_rests_on(source, said):
    known = {"kind": "next recording", "name": "", "joint": None, "source": source}
    one = Fact(value=0.05, interval=(0.03, 0.09), **known)
    left_out = 0 if source == "assumed" else 4
    report = Report(make_outcome(facts=(one,), left_out=left_out))
    text = section_of(report, "Next steps")
    expected = "5.0 % (90 %: 3.0 to 9.0 %"
    assert_said(text, expected, said)
    assert_said(line_of(report), expected, said)
    wide = Report(make_outcome(facts=(replace(one, interval=(0.003, 0.09)),)))
    assert ("unknown, at least 0.3 %" in line_of(wide)) == (source == "assumed")


def test_the_worst_joint_is_named_and_gets_a_motion():
    outcome = make_outcome(nv=3, n_effects=0, unexplained=(0, 2))
    left = outcome.findings["unexplained"]
    left = [replace(one, signals=(), of_torque=0.1 + one.joint) for one in left]
    report = Report(changed(outcome, unexplained=left))
    facts = "210 % of the torque of joint 3 remains", "; less on joint 1."
    assert_said(report.headline, *facts)
    text = section_of(report, "Next steps")
    assert_said(text, "slow and fast motion over the whole range (joints 1 and 3)")


def test_one_effect_on_two_joints_is_named_once():
    outcome = make_outcome(nv=3, n_effects=1)
    (one,) = outcome.findings["effects"]
    both = one, replace(one, joint=2, joint_name=outcome.robot["joints"][2])
    report = Report(changed(outcome, effects=both))
    assert " on joints 2 and 3 was missing" in report.headline


# -- unknown gains


def gains_of(reference=(1, 1, 1), common=None, first=0.5, **changes):
    names = tuple(f"joint{j + 1}" for j in range(3))
    gains = ChannelGains(
        joint_names=names,
        gain=np.array([first, 1.0, 2.0]),
        std=np.array([0.01, 0.0, 0.02]),
        reference=np.array(reference),
        common=common or CommonGain(),
    )
    return Report(make_outcome(nv=3, names=names, gains=gains, **changes))


def test_gains_are_relative_to_a_channel():
    report = gains_of()
    text = text_of(report)
    assert_said(text, "relative to the channel of joint 2")
    assert_said(
        text, "joint 1 0.500 +- 0.016 relative to joint 2", "joint 2 1 the unit"
    )
    hidden = gains_of((1, 1, 2))
    assert_said(text_of(hidden), "joint 3 not identifiable")
    assert_said(line_of(hidden), "in units of that channel; not identifiable: joint 3")
    assert Report(make_outcome()).to_dict()["robot"]["gains"] is None


def test_a_known_mass_fixes_the_common_gain():
    common = CommonGain(factor=8.0, std=0.08, masses={"payload": 1.5})
    text = text_of(gains_of(common=common))
    assert_said(text, "payload of 1.5 kg", "1.6 %", "0.500 +- 0.016 per N m")


def test_a_mass_that_fixes_nothing_is_named():
    text = text_of(gains_of(common=CommonGain(masses={"hand": 1.5})))
    assert_said(text, "The mass of hand (1.5 kg) cannot fix the common gain")
