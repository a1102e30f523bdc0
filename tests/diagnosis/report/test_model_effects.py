"""Effects of the robot model, as reports tell them: in degrees, mm and per cent."""

import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import DiscoveredEffect, Hidden
from sklearn_vbjfa.diagnosis.explain._identified import ParameterValue
from sklearn_vbjfa.diagnosis.report import _plain
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, TorqueGain
from sklearn_vbjfa.robot import (
    AxisCorrection,
    Corrections,
    GainCorrection,
    TiltCorrection,
    ZeroCorrection,
)
from tests.diagnosis.report._outcomes import EVIDENCE, make_outcome, make_round

NAMES = tuple(f"joint_{j + 1}" for j in range(6))


def found(effect, values, half, rivals=()):
    """Make a finding with values in SI units, each known to `half`."""
    units = effect.parameter_units()
    return DiscoveredEffect(
        name=effect.name,
        joint=effect.joint,
        joint_name=NAMES[effect.joint],
        scope=effect.scope,
        parameters=values,
        units={key: units[key] for key in values},
        intervals={key: (x - half, x + half) for key, x in values.items()},
        evidence=EVIDENCE,
        rivals=rivals,
        effect=effect,
    )


def degrees(*angles):
    return tuple(float(np.deg2rad(angle)) for angle in angles)


TILT = found(
    BaseTilt(),
    dict(zip(("roll", "pitch"), degrees(4.0, 2.0))),
    np.deg2rad(0.02),
    ("joint_axis",),
)
ZERO = found(
    JointZero(2),
    {"zero": np.deg2rad(4.04)},
    np.deg2rad(0.06),
    ("joint_axis on joint_5",),
)
AXIS = found(
    JointAxis(3),
    dict(zip(("about_x", "about_y"), degrees(3.0, -0.5))),
    np.deg2rad(0.1),
)
GAIN = found(TorqueGain(1), {"gain": 1.148}, 0.002)
CORRECTIONS = Corrections(
    tilt=TiltCorrection(
        roll=TILT.parameters["roll"],
        pitch=TILT.parameters["pitch"],
        roll_degrees=4.0,
        pitch_degrees=2.0,
        gravity=(-0.34, 0.68, -9.78),
        lean_rpy=(-0.0698, -0.0348, 0.0024),
        lean_rpy_degrees=(-4.0, -1.995, 0.14),
    ),
    zeros=(
        ZeroCorrection(
            joint=2,
            joint_name="joint_3",
            subtract=ZERO.parameters["zero"],
            plain=4.04,
            plain_unit="degrees",
        ),
    ),
    axes=(
        AxisCorrection(
            joint=3,
            joint_name="joint_4",
            about_x=AXIS.parameters["about_x"],
            about_y=AXIS.parameters["about_y"],
            about_x_degrees=3.0,
            about_y_degrees=-0.5,
            about=("x axis", "z axis"),
            old_rpy=(0.0, 1.5708, 0.0),
            new_rpy=(0.05, 1.5, 0.1),
        ),
    ),
    gains=(GainCorrection(joint=1, joint_name="joint_2", gain=1.148, percent=14.8),),
)


def outcome_of(*effects, **changes):
    """Make an outcome of a robot with these effects and no other."""
    rounds = tuple(make_round(effect) for effect in effects)
    return make_outcome(
        **{
            "effects": effects,
            "rounds": rounds,
            "corrections": CORRECTIONS,
            "names": NAMES,
            "hidden": (),
            "channels": (),
            **changes,
        }
    )


def only(effect):
    """Leave what is to be corrected because of one effect."""
    kind = {
        "base_tilt": "tilt",
        "joint_zero": "zeros",
        "joint_axis": "axes",
        "torque_gain": "gains",
    }[effect.name]
    return Corrections(**{kind: getattr(CORRECTIONS, kind)})


def formats(report):
    """Text, Markdown and page without breaks, signs and escapes."""
    texts = (str(report), report.to_markdown().replace("\\", ""), report.to_html())
    return [
        " ".join(text.replace("\u00a0", " ").replace("±", "+-").split())
        for text in texts
    ]


@pytest.mark.parametrize(
    ("effect", "sentence", "remedy"),
    [
        (
            TILT,
            "the base is not level: gravity is turned by roll 4.00 +- 0.02 and pitch "
            "2.00 +- 0.02 degrees",
            "level the base, which leans the opposite way (roll -4.00, pitch -2.00 "
            'degrees), or mount it so in the robot description (rpy "-0.06980 -0.03480 '
            '0.00240")',
        ),
        (
            ZERO,
            "joint 3: the encoder's zero is off by 4.04 +- 0.06 degrees",
            "subtract 4.04 degrees from what the encoder of joint 3 reads",
        ),
        (
            AXIS,
            "joint 4: the axis is turned by 3.00 +- 0.10 degrees about the x axis and "
            "-0.50 +- 0.10 degrees about the z axis of its frame",
            "take the rpy of the origin of joint 4 from the URDF that is written "
            '("0.05000 1.50000 0.10000" instead of "0.00000 1.57080 0.00000")',
        ),
        (
            GAIN,
            "joint 2: the torque channel reads 14.8 +- 0.2 % too much",
            "divide the torque of joint 2 by 1.148",
        ),
    ],
    ids=lambda given: getattr(given, "name", None),
)
def test_effects_are_told_with_what_to_do(effect, sentence, remedy):
    outcome = outcome_of(effect, corrections=only(effect))
    assert _plain.statement(outcome, effect) == sentence
    (own,) = _plain.remedies(outcome)
    assert (own.name, own.joint, own.text) == (effect.name, effect.joint, remedy)
    text, marked, page = formats(Report(outcome))
    assert f"- {sentence}; saves 46 %" in text
    assert f"To correct: {remedy}." in text
    # The other formats have the values in a table.
    value = re.search(r"-?\d+\.\d+ \+- \d+\.\d+", sentence)[0]
    for shown in (marked, page.replace("&#34;", '"')):
        assert remedy[1:] in shown
        assert value in shown
        assert "What to do next" in shown


def test_what_was_declared_is_to_be_corrected_as_well():
    # A declared effect is none that was missing.
    outcome = make_outcome(names=NAMES, corrections=only(ZERO), channels=())
    for shown in formats(Report(outcome)):
        text = "ubtract 4.04 degrees from what the encoder of joint 3 reads."
        assert text in shown
        assert "zero is off by" not in shown


@pytest.mark.parametrize("declared", [ZERO, AXIS, GAIN, TILT])
def test_nothing_is_to_be_corrected_that_may_be_nothing(declared):
    """Of declared effects: those that are found have values away from nothing."""
    joint = "" if declared is TILT else f"{NAMES[declared.joint]}:"

    def shown(reach):
        values = tuple(
            ParameterValue(
                name=f"{joint}{declared.name}:{name}",
                value=value,
                interval=(value - reach, value + reach),
                unit="",
                nominal=np.nan,
                known="yes",
            )
            for name, value in declared.parameters.items()
        )
        outcome = outcome_of(corrections=only(declared), parameters=values)
        return formats(Report(outcome))[0]

    assert "To correct: " in shown(0.001)
    assert "To correct: " not in shown(1.0)


def test_an_effect_that_held_out_data_do_not_confirm_is_not_told_as_missing():
    outcome = make_outcome(n_effects=1)
    assert " was missing; " in Report(outcome).headline
    same = replace(outcome, error_after=outcome.error_before * 1.01)
    headline = Report(same).headline
    assert "missing" not in headline
    assert " was found, though the held-out error did not fall; " in headline


def test_a_tilt_belongs_to_no_joint():
    report = Report(outcome_of(TILT))
    assert report.headline.startswith("Tilted base was missing; ")
    assert [joint.n_effects for joint in report.joints] == [0] * 6
    for shown in formats(report):
        assert "tilted base on joint 1" not in shown.lower()
        assert "joint 1: the base" not in shown
        assert "turned joint axis on joint 1" in shown
    step = replace(make_round(TILT, "drop"), rivals=())
    shown = Report(outcome_of(rounds=(step,))).to_markdown()
    assert "| 1 | robot | tilted base | dropped" in " ".join(shown.split())


def test_headlines_name_the_joint_of_what_has_one():
    headline = Report(outcome_of(TILT, ZERO)).headline
    assert headline.startswith(
        "Tilted base and shifted encoder zero on joint 3 were missing"
    )
    # Many are counted, as they are listed below.
    headline = Report(outcome_of(TILT, ZERO, GAIN)).headline
    assert headline.startswith("3 effects were missing")


def test_rivals_of_other_joints_are_named_with_them():
    for shown in formats(Report(outcome_of(ZERO))):
        assert "turned joint axis on joint 5" in shown
        assert "joint axis on joint_5" not in shown
    # What to record to tell them apart is that of both.
    text = formats(Report(outcome_of(ZERO)))[1]
    for effect in (JointZero, JointAxis):
        assert f"{effect.record} (joint 3)" in text


def test_a_name_with_on_in_it_stays_whole():
    outcome = outcome_of(replace(ZERO, rivals=("friction on wet days",)))
    assert "friction on wet days" in " ".join(str(Report(outcome)).split())


def test_too_little_is_told_as_such():
    low = found(TorqueGain(1), {"gain": 0.93}, 0.004)
    text = _plain.statement(outcome_of(low), low)
    assert text == "joint 2: the torque channel reads 7.0 +- 0.4 % too little"


def test_a_slider_is_told_in_millimetres():
    slide = replace(ZERO, parameters={"zero": 0.0123}, units={"zero": "m"})
    slide = replace(slide, intervals={"zero": (0.0118, 0.0128)})
    text = _plain.statement(outcome_of(slide), slide)
    assert text == "joint 3: the encoder's zero is off by 12.3 +- 0.5 mm"


def test_plain_values_stand_beside_those_in_si_units():
    data = Report(outcome_of(TILT, ZERO, AXIS, GAIN)).to_dict()
    tilt, zero, axis, gain = data["effects"]
    assert tilt["parameters"]["roll"] == np.deg2rad(4.0)
    assert tilt["scope"] == "robot"
    assert tilt["plain"]["roll"]["unit"] == "degrees"
    assert tilt["plain"]["roll"]["value"] == pytest.approx(4.0)
    assert tilt["plain"]["roll"]["interval"] == pytest.approx([3.98, 4.02])
    assert zero["plain"]["zero"]["interval"] == pytest.approx([3.98, 4.10])
    assert axis["plain"]["about_y"]["value"] == pytest.approx(-0.5)
    assert gain["plain"]["gain"]["value"] == pytest.approx(14.8)
    assert gain["plain"]["gain"]["interval"] == pytest.approx([14.6, 15.0])
    assert gain["plain"]["gain"]["unit"] == "%"
    told = data["corrections"]
    assert told["tilt"]["lean_rpy_degrees"] == [-4.0, -1.995, 0.14]
    assert told["zeros"][0]["subtract"] == ZERO.parameters["zero"]
    assert told["axes"][0]["new_rpy"] == [0.05, 1.5, 0.1]
    assert told["gains"][0]["gain"] == 1.148


def test_where_nothing_is_to_be_corrected_nothing_is_said():
    report = Report(make_outcome())
    for shown in formats(report):
        assert "correct" not in shown.replace("corrected", "")
    data = report.to_dict()
    none = {"tilt": None, "zeros": [], "axes": [], "gains": []}
    assert data["corrections"] == none
    assert not any("plain" in effect for effect in data["effects"])


def test_the_table_has_both_units():
    marked = formats(Report(outcome_of(TILT)))[1]
    assert "roll 4.00 +- 0.02 degrees" in marked
    assert "roll = 0.0698 +- 0.0003 rad" in marked


# -- what is hidden


def hidden(name, joints, reason, remedy=""):
    return tuple(
        Hidden(name=name, joint=j, joint_name=NAMES[j], reason=reason, remedy=remedy)
        for j in joints
    )


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        (
            hidden("joint_zero", (0, 5), "span"),
            "Not identifiable by any motion: the zeros of joints 1 and 6 (absorbed by "
            "other parameters).",
        ),
        (
            hidden("joint_axis", (0,), "excitation", "more moves"),
            "The axis of joint 1 cannot be seen in this recording: that takes more "
            "moves.",
        ),
        (
            hidden("base_tilt", (0,), "excitation", "weight in several poses"),
            "A tilt of the base cannot be seen in this recording: that takes weight in "
            "several poses.",
        ),
        (
            hidden("torque_gain", range(6), "excitation", "shared bodies"),
            "The gains of all joints cannot be seen in this recording: that takes "
            "shared bodies.",
        ),
        (
            hidden("joint_zero", (1,), "together", "joint_zero on joint_3"),
            "The zero of joint 2 can be seen only together with shifted encoder zero "
            "on joint 3: only their sum is identifiable.",
        ),
        (
            hidden("joint_axis", (0, 3), "together", "base_tilt"),
            "The axes of joints 1 and 4 can be seen only together with tilted base: "
            "only their sum is identifiable.",
        ),
        (
            hidden("spring", (1,), "together", "offset"),
            "Only their sum is identifiable: spring (joint 2) with constant offset.",
        ),
    ],
)
def test_what_is_hidden_is_told_in_a_sentence(told, expected):
    for shown in formats(Report(outcome_of(hidden=told)))[1:]:
        assert expected in shown


def test_hidden_effects_take_a_sentence_each_and_not_one_a_joint():
    told = (
        *hidden("joint_zero", range(5), "excitation", "weight"),
        *hidden("joint_zero", (5,), "span"),
        *hidden("joint_axis", range(6), "together", "base_tilt"),
        *hidden("counterbalance", range(6), "excitation"),
    )
    marked = Report(outcome_of(hidden=told)).to_markdown()
    part = marked.split("## What this recording does not show")[1].split("##")[0]
    assert part.count("\n- ") == 4


def test_a_hidden_tilt_is_recorded_on_no_joint():
    told = hidden("base_tilt", (0,), "excitation", "weight")
    text = formats(Report(outcome_of(hidden=told)))[0]
    assert "Record next: the base measured with a level." in text
    assert f"Record {BaseTilt.record}." in formats(Report(outcome_of(hidden=told)))[1]
