"""Limits stated in the report: figures and keywords, not the wording."""

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


def section(heading, **changes):
    return section_of(Report(make_outcome(nv=3, **changes)), heading)


def contains(text, *facts):
    for fact in facts:
        assert fact in text, text


def test_masses_with_their_identifiability():
    text = section(
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
    contains(text, "base (not at all)", "upper and fore (in combination only)")
    # Each with the described mass, and with an interval if it is identified.
    contains(text, "same 5.00 +- 0.16 kg, described 5.1 kg", "base 9 kg")
    assert section("Masses") == ""


def test_bodies_that_differ_from_the_description():
    one = Departure(bodies=("j2",), factors=(1.98,), stds=(0.03,), log_odds=9.0)
    contains(section("Masses", departures=(one,)), "j2 (1.98 +- 0.05 times)")
    ambiguous = Departure(
        bodies=("j2", "j3"), factors=(1.98, 3.0), stds=(0.03, 0.6), log_odds=9.0
    )
    text = section("Masses", departures=(ambiguous,), common_size=0.001)
    contains(text, "j2 (1.98 +- 0.05 times) or j3 (3.0 +- 1.0 times)", "0.001 times")
    assert section("Masses", common_size=1.2) == ""
    contains(section("Masses", common_size=1.2, drive={"kind": "PDDrive"}), "check kp")
    for size, expected in ((0.5, False), (0.3, True), (3.1, True)):
        warnings = Report(make_outcome(nv=3, common_size=size)).warnings
        assert any("times as heavy" in one for one in warnings) == expected


def test_values_of_joints_with_shared_drives():
    def shared(parameter, joints=("j1", "j2", "j3"), scatter=0.04):
        return AlikeValue(
            group="hip",
            parameter=parameter,
            joints=joints,
            indices=(),
            scatter=scatter,
            std=0.0003 / 1.645,
            unit="kg m^2",
            value=0.0105,
        )

    values = (shared("rotor_inertia"), shared("my_own_effect:k", scatter=np.nan))
    text = section("Joints with the same drive", alike=values)
    contains(text, "hip rotor inertia 0.0105 +- 0.0003 kg m² 4 % 3")
    contains(text, "hip my own effect 0.0105")
    assert section("Joints with the same drive") == ""


def test_excitation_and_suggested_motion():
    joint = JointMotion(
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
    both = (joint, joint)
    given = make_outcome(nv=2, not_identifiable=(hidden,), motion=both, limits=limits)
    report = Report(given)
    text = section_of(report, "Excitation")
    contains(text, "poor on all", "it reverses 3 times", "-1 to 1.5 rad", "25 %")
    steps = section_of(report, "Next steps")
    contains(steps, "a wide range of positions (joint 1)", "-2 to 2 rad")
    contains(steps, "0.3 to 3 rad/s", "60 s")
    # Without limits: the recorded range.
    free = Report(changed(given, not_identifiable=(replace(hidden, joint=1),)))
    contains(section_of(free, "Next steps"), "-1 to 1.5 rad", "0.08 to 0.8 rad/s")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "o further recording is needed"),
        ({"settings": {"effects": ()}}, "dentify without --no-search"),
        ({"enough": [True, False]}, "ecord more motion of joint 2."),
        ({"channels": [finding("Wrong.", "warning")]}, "orrect the recording, then"),
    ],
)
def test_next_steps(changes, text):
    outcome = changed(make_outcome(nv=2, n_effects=0, not_identifiable=()), **changes)
    report = Report(outcome)
    contains(section_of(report, "Next steps"), text)
    assert text in line_of(report)


@pytest.mark.parametrize(
    ("cause", "value", "phrase"),
    [
        ("offset", -0.5, "An offset of -0.5 N m on joint 2"),
        ("gain", 1.2, "A torque of joint 2 that is 1.2 times as large"),
        ("friction", np.nan, "Different friction of joint 2"),
        ("zero", 0.05, "The encoder zero of joint 2 shifted by 0.05 rad"),
        ("payload", 1.3, "A load of 1.3 kg on the last link"),
        ("payload", -0.8, "0.8 kg less on the last link"),
        ("model", np.nan, "friction or a load on the last link"),
    ],
)
def test_contradictions_are_reported(cause, value, phrase):
    errors = {"alone": 0.011, "together": 0.072, "p_value": 1e-5}
    one = Contradiction(recording=0, joint=1, cause=cause, value=value, of=1, **errors)
    names = ("slow", "fast", "last")
    report = Report(make_outcome(nv=3, contradictions=(one,), recordings=names))
    assert "Recording slow contradicts the others" in report.headline
    text = section_of(report, "Limits of the recordings")
    contains(text, "1.1 %", "7.2 %", "p = 0.00001", "in recording slow", phrase)


def test_repeated_motions_are_reported():
    repetition = SimpleNamespace(seconds=2.0, count=3.0, recordings=(0, 2))
    names = ("slow", "fast", "last")
    text = section("Limits of the recordings", recordings=names, repeated=(repetition,))
    assert "Repeated motion: 2 s, 3 times in recordings slow and last." in text
    assert section("Limits of the recordings", recordings=("1", "2")) == ""


@pytest.mark.parametrize(
    ("source", "phrase"),
    [
        ("assumed", "record a second motion"),
        ("partly measured", "recordings partly measured, from 4 recordings"),
        ("measured", "recordings measured, from 4 recordings"),
    ],
)
def test_source_of_the_error_of_the_next_recording(source, phrase):
    keywords = {"kind": "next recording", "name": "", "joint": None, "source": source}
    fact = Fact(value=0.05, interval=(0.03, 0.09), **keywords)
    left_out = 0 if source == "assumed" else 4
    report = Report(make_outcome(facts=(fact,), left_out=left_out))
    text = section_of(report, "Next steps")
    expected = "5.0 % (90 %: 3.0 to 9.0 %"
    contains(text, expected, phrase)
    contains(line_of(report), expected, phrase)
    wide = Report(make_outcome(facts=(replace(fact, interval=(0.003, 0.09)),)))
    assert ("unknown, at least 0.3 %" in line_of(wide)) == (source == "assumed")


def test_the_worst_joint_is_named_with_a_suggested_motion():
    outcome = make_outcome(nv=3, n_effects=0, unexplained=(0, 2))
    unexplained = outcome.findings["unexplained"]
    unexplained = [replace(x, signals=(), of_torque=0.1 + x.joint) for x in unexplained]
    report = Report(changed(outcome, unexplained=unexplained))
    facts = "210 % of the torque of joint 3 remains", "; less on joint 1."
    contains(report.headline, *facts)
    text = section_of(report, "Next steps")
    contains(text, "slow and fast motion over the whole range (joints 1 and 3)")


def test_one_effect_on_two_joints_is_named_once():
    outcome = make_outcome(nv=3, n_effects=1)
    (effect,) = outcome.findings["effects"]
    effects = effect, replace(effect, joint=2, joint_name=outcome.robot["joints"][2])
    report = Report(changed(outcome, effects=effects))
    assert " on joints 2 and 3 was missing" in report.headline


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


def test_relative_gains_are_reported():
    report = gains_of()
    text = text_of(report)
    contains(text, "relative to the channel of joint 2")
    contains(text, "joint 1 0.500 +- 0.016 relative to joint 2", "joint 2 1 the unit")
    hidden = gains_of((1, 1, 2))
    contains(text_of(hidden), "joint 3 not identifiable")
    contains(line_of(hidden), "in units of that channel; not identifiable: joint 3")
    assert Report(make_outcome()).to_dict()["robot"]["gains"] is None
    readings = gains_of(units=3 * ("A",))
    assert "after [90 %] A noise" in " ".join(str(readings).split())


def test_a_known_mass_fixes_the_common_gain():
    common = CommonGain(factor=8.0, std=0.08, masses={"payload": 1.5})
    text = text_of(gains_of(common=common))
    contains(text, "payload of 1.5 kg", "1.6 %", "0.500 +- 0.016 per N m")
    assert "as heavy as described" not in text
    report = gains_of(common=common, common_size=4.0)
    contains(report.warnings[0], "4 times as heavy as described: check the payload of")
    # A mass without effect on the torques.
    text = text_of(gains_of(common=CommonGain(masses={"hand": 1.5})))
    contains(text, "The mass of hand (1.5 kg) cannot fix the common gain")
