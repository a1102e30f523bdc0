"""Corrections of the robot model: values with units, and remedies."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import DiscoveredEffect, Fact, NotIdentifiable
from sklearn_vbjfa.effects import BaseTilt, JointAxis, JointZero, OfRobot, TorqueGain
from sklearn_vbjfa.robot import Correction
from tests.diagnosis.report import _outcomes
from tests.diagnosis.report._outcomes import EVIDENCE, make_outcome, make_trials
from tests.diagnosis.report._pages import line_of, section_of, text_of

NAMES = tuple(f"joint_{j + 1}" for j in range(6))
MISSING = "Effects that were missing"


def discovered(effect, values, half, trials=()):
    """Make an effect with values in SI units and intervals of half-width `half`."""
    units = effect.parameter_units()
    return DiscoveredEffect(
        name=effect.name,
        joint=effect.joint,
        joint_name=NAMES[effect.joint],
        scope="robot" if isinstance(effect, OfRobot) else "joint",
        parameters=values,
        units={key: units[key] for key in values},
        intervals={key: (x - half, x + half) for key, x in values.items()},
        evidence=EVIDENCE,
        trials=trials,
        effect=effect,
    )


def degrees(*angles):
    return tuple(float(np.deg2rad(angle)) for angle in angles)


TILT = discovered(
    BaseTilt(),
    dict(zip(("roll", "pitch"), degrees(4.0, 2.0))),
    np.deg2rad(0.02),
    make_trials(0, ("joint_axis",)),
)
ZERO = discovered(
    JointZero(2),
    {"zero": np.deg2rad(4.04)},
    np.deg2rad(0.06),
    make_trials(4, ("joint_axis",)),
)
AXIS = discovered(
    JointAxis(3), dict(zip(("about_x", "about_y"), degrees(3.0, -0.5))), np.deg2rad(0.1)
)
GAIN = discovered(TorqueGain(1), {"gain": 1.148}, 0.002)
VALUES = {
    "base_tilt": {
        "roll": 4.0,
        "pitch": 2.0,
        "lean_degrees": (-4.0, -1.995, 0.14),
        "lean_rpy": (-0.0698, -0.0348, 0.0024),
        "gravity": (-0.34, 0.68, -9.78),
    },
    "joint_zero": {
        "subtract": ZERO.parameters["zero"],
        "plain": 4.04,
        "unit": "degrees",
    },
    "joint_axis": {
        "turns": (3.0, -0.5),
        "about": ("x axis", "z axis"),
        "old_rpy": (0.0, 1.5708, 0.0),
        "new_rpy": (0.05, 1.5, 0.1),
    },
    "torque_gain": {"gain": 1.148},
}


def correction(effect):
    """Correction of the robot that belongs to an effect."""
    return Correction(
        name=effect.name,
        joint=effect.joint,
        joint_name=f"joint_{effect.joint + 1}",
        values=VALUES[effect.name],
    )


def report_of(*effects, **changes):
    """Report of a robot with these effects only."""
    defaults = {
        "effects": effects,
        "corrections": tuple(map(correction, effects)),
        "names": NAMES,
        "not_identifiable": (),
        "channels": (),
    }
    return Report(make_outcome(**(defaults | changes)))


@pytest.mark.parametrize(
    ("effect", "values", "remedy"),
    [
        (TILT, ("4.00 +- 0.02", "2.00 +- 0.02"), '"-0.06980 -0.03480 0.00240"'),
        (ZERO, ("joint 3", "4.04 +- 0.06"), "ubtract 4.04 degrees"),
        (AXIS, ("joint 4", "3.00 +- 0.10", "-0.50 +- 0.10"), '"0.05000 1.50000 0.100'),
        (GAIN, ("joint 2", "14.8 +- 0.2 %"), "ivide the torque of joint 2 by 1.148"),
    ],
    ids=lambda given: getattr(given, "name", None),
)
def test_effects_have_values_and_remedies(effect, values, remedy):
    report = report_of(effect)
    for value in (*values, remedy):
        assert value in line_of(report)
        assert value in text_of(report)
    assert remedy in section_of(report, "Next steps")
    # A declared effect also has a remedy, but is not listed as missing.
    declared = report_of(effects=(), corrections=report.outcome.robot["corrections"])
    assert remedy in section_of(declared, "Next steps")
    assert section_of(declared, MISSING) == ""
    # A possible effect has no remedy, and a log that must be corrected first has none.
    possible = {"effects": (), "possible": (replace(effect, warning="undecided"),)}
    faulty = {"channels": (_outcomes.finding("Joint 2 is swapped.", "warning"),)}
    for report in (report_of(effect, **possible), report_of(effect, **faulty)):
        assert remedy not in text_of(report) + line_of(report)


@pytest.mark.parametrize("declared", [ZERO, AXIS, GAIN, TILT])
def test_insignificant_corrections_are_not_suggested(declared):
    """Declared effects have a remedy only if their interval excludes zero."""
    joint = "" if declared is TILT else f"{NAMES[declared.joint]}:"
    known = {"kind": "parameter", "joint": declared.joint}

    def text(half):
        values = tuple(
            Fact(name=f"{joint}{declared.name}:{k}", value=x, interval=ends, **known)
            for k, x in declared.parameters.items()
            for ends in [(x - half, x + half)]
        )
        return str(report_of(declared, effects=(), facts=values))

    assert "To correct: " in text(0.001)
    assert "To correct: " not in text(1.0)
    assert "To correct: " not in str(Report(make_outcome()))


def test_a_wrong_gain_of_a_control_law_forbids_its_use():
    assert "gains of the drive" not in line_of(report_of(GAIN))
    for logged, left, wrong in ((0, (), "kp"), (1, (), "kp and kd"), (1, (1,), "kp")):
        drive = {"kind": "PDDrive", "delay": None, "v_desired": bool(logged)}
        text = line_of(report_of(GAIN, drive=drive, unexplained=left))
        assert "gains of the drive need correction" in text
        assert f"divide {wrong} of joint 2 in --drive by 1.148" in text


def test_a_tilt_belongs_to_no_joint():
    report = report_of(TILT, ZERO)
    assert "ilted base and shifted encoder zero on joint 3" in report.headline
    assert "tilted base on joint" not in text_of(report).lower()


def test_rivals_are_named_with_their_joints():
    text = text_of(report_of(ZERO))
    assert "turned joint axis on joint 5" in text
    for effect in (JointZero, JointAxis):
        assert f"{effect.record} (joint 3)" in text


def test_gains_below_one_and_prismatic_zeros():
    low = discovered(TorqueGain(1), {"gain": 0.93}, 0.004)
    assert "7.0 +- 0.4 % too little" in str(report_of(low))
    slide = replace(ZERO, parameters={"zero": 0.0123}, units={"zero": "m"})
    slide = replace(slide, intervals={"zero": (0.0118, 0.0128)})
    assert "12.3 +- 0.5 mm" in str(report_of(slide))


def test_values_in_both_units():
    report = report_of(TILT, ZERO, AXIS, GAIN)
    steps = section_of(report, "Next steps")
    assert "roll 4.00 +- 0.02 degrees" in steps
    assert "roll = 0.0698 +- 0.0003 rad" in steps
    data = report.to_dict()
    tilt = data["effects"][0]
    assert tilt["parameters"]["roll"] == np.deg2rad(4.0)
    assert tilt["scope"] == "robot"
    listed = data["robot"]["corrections"]
    tilt, zero, axis, gain = (x["values"] for x in listed)
    assert tilt["lean_degrees"] == [-4.0, -1.995, 0.14]
    assert zero["subtract"] == ZERO.parameters["zero"]
    assert axis["new_rpy"] == [0.05, 1.5, 0.1]
    assert gain["gain"] == 1.148


def hidden(name, joints, reason, remedy=""):
    return tuple(
        NotIdentifiable(
            name=name, joint=j, joint_name=NAMES[j], reason=reason, remedy=remedy
        )
        for j in joints
    )


@pytest.mark.parametrize(
    ("effects", "facts"),
    [
        (hidden("joint_zero", (0, 5), "span"), ("zero on joints 1 and 6",)),
        (
            hidden("joint_axis", (0,), "excitation", "more moves"),
            ("axis on joint 1", "more moves"),
        ),
        (hidden("base_tilt", (0,), "excitation", "weight"), ("ilted base", "weight")),
        (hidden("torque_gain", range(6), "excitation", "x"), ("on all joints",)),
    ],
)
def test_hidden_effects_are_listed(effects, facts):
    text = section_of(
        report_of(not_identifiable=effects), "Not identifiable from this recording"
    )
    for fact in facts:
        assert fact in text
