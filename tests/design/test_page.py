"""The page of a motion and its summary: all that is known, all escaped."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.design import (
    Background,
    Invisible,
    MotionLimits,
    Parted,
    Visible,
    decisions,
    design_motion,
    effect_label,
    page,
    summary,
)
from sklearn_vbjfa.effects import available
from tests.diagnosis.report._pages import figures, numbers, parsed

pytest.importorskip("pinocchio")

HOSTILE = '</script><script>alert("x")</script>'
URDF = """
<robot name="crane"><link name="base"/>
<link name="beam"><inertial><origin xyz="0.3 0 0"/><mass value="4"/>
  <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="trolley"><inertial><origin xyz="0 0 0"/><mass value="2"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="beam"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="60" velocity="3"/></joint>
<joint name="slide" type="prismatic"><parent link="beam"/><child link="trolley"/>
  <axis xyz="1 0 0"/><limit lower="0.1" upper="0.6" effort="40" velocity="1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    """Motion of a joint that turns and one that slides."""
    urdf = tmp_path_factory.mktemp("crane") / "crane.urdf"
    urdf.write_text(URDF)
    limits = MotionLimits.of(urdf, acceleration=[4.0, 2.0])
    return design_motion(
        str(urdf),
        duration=4.0,
        dt=0.01,
        limits=limits,
        effects=("stribeck", "spring", "rotor_inertia"),
        random_state=0,
    )


def background(**changes):
    """Make up what a motion was designed from."""
    given = {
        "robot": "crane.urdf",
        "description": "robots/crane.urdf",
        "measured": np.array([True, False]),
        "file": "motion.csv",
        "commands": ("Run it.", "python -m sklearn_vbjfa close-loop old.csv new.csv"),
    }
    return Background(**(given | changes))


def many(motion, nv):
    """Make a motion of many joints."""
    names = tuple(f"joint_{j + 1}" for j in range(nv))
    wide = {
        key: np.resize(getattr(motion, key).T, (nv, motion.t.size)).T
        for key in ("q", "v", "a", "tau")
    }
    limits = MotionLimits(
        np.tile([-9.0, 9.0], (nv, 1)), *(np.full(nv, 99.0) for _ in range(3))
    )
    margins = {
        key: np.linspace(0.02, 0.9, nv)
        for key in ("position", "velocity", "acceleration", "torque")
    }
    at = {"rival": "spring", "least": 0.5}
    pairs = tuple(
        Parted(names=("stribeck", "ripple"), joint=j, joint_name=names[j], least=0.2)
        for j in range(nv)
    )
    effects = tuple(
        Visible(name="stribeck", joint=j, joint_name=names[j], **at) for j in range(nv)
    )
    why = ("one reason.", "another", "a third")
    hidden = tuple(
        Invisible(name="ripple", joint=j, joint_name=names[j], reason=why[j % 3])
        for j in range(nv)
    )
    return replace(
        motion,
        **wide,
        joint_names=names,
        slides=(False,) * nv,
        noise=np.full(nv, 0.1),
        limits=limits,
        margins=margins,
        shows=effects,
        parts=pairs,
        invisible=hidden,
    )


def test_every_limit_has_its_bar(motion):
    html = page(motion, background())
    widths = [
        float(x) for x in re.findall(r'class="fill \w+" style="width:(.*?)%', html)
    ]
    used = [
        100 * (1 - motion.margins[name][j])
        for j in range(2)
        for name in ("position", "velocity", "acceleration", "torque")
    ]
    np.testing.assert_allclose(widths, used, atol=0.06)
    text = " ".join(re.sub("<[^>]*>", " ", html).replace("\u00a0", " ").split())
    assert f"{used[4]:.0f} % of 0.1 to 0.6 m" in text
    assert f"{used[7]:.0f} % of 40 N" in text
    assert f"{used[3]:.0f} % of 60 N m" in text


def test_pictures_are_the_motion_with_its_limits(motion):
    html = page(motion, background())
    found = figures(html)
    titles = [numbers(one)["title"] for one in found]
    assert titles[:2] == ["Position of joint 1 (turn)", "Velocity of joint 1 (turn)"]
    assert titles[-1] == "Force of joint 2 (slide)"
    position = numbers(found[4])
    assert position["yLabel"] == "position [m]"
    kinds = [one["kind"] for one in position["series"]]
    assert kinds == ["line-after", "limit", "limit"]


def test_rivals_of_the_report_come_first(motion):
    def pair(first, second, joint, least):
        name = motion.joint_names[joint]
        return Parted(names=(first, second), joint=joint, joint_name=name, least=least)

    parts = (
        pair("spring", "ripple", 0, 0.1),
        pair("spring", "stribeck", 0, 0.3),
        pair("ripple", "stribeck", 0, 0.2),
        pair("spring", "ripple", 1, 0.7),
        pair("spring", "stribeck", 1, 0.8),
        pair("viscous_quadratic", "stribeck", 1, 0.9),
    )
    motion = replace(motion, parts=parts)
    rounds = [
        {"name": "stribeck", "joint": 1, "rivals": [{"name": "spring", "joint": 1}]},
        {"name": "spring", "joint": 0, "rivals": []},
    ]
    effects = [
        {"name": "stribeck", "joint": 1, "rivals": ["viscous_quadratic on slide"]}
    ]
    found = {"rounds": rounds, "effects": effects, "joint_names": motion.joint_names}
    told = decisions(motion, background(found=found))
    assert [(one.joint, one.least) for one in told] == [
        (1, 0.8),
        (1, 0.9),
        (0, 0.3),
        (1, 0.7),
    ]
    assert told[0].causes == "spring or Stribeck friction"
    assert told[2].causes == "spring, torque ripple and Stribeck friction"
    assert told[2].hardest == "spring or Stribeck friction"
    html = page(motion, background(found=found))
    assert "spring or Stribeck friction on joint 2 (slide); and 3 further" in html
    lines = summary(motion, background(found=found))
    assert "- joint 2 (slide), from 0.8 N: spring or Stribeck friction" in lines
    assert "- 1 more on the page" in lines


def test_names_are_escaped(motion):
    names = (HOSTILE, "slide")
    bad = replace(motion, joint_names=names, no_clearance=HOSTILE)
    told = background(robot=HOSTILE, description=HOSTILE, commands=(HOSTILE,))
    html = page(bad, told)
    assert HOSTILE not in html
    assert html.count("<script>") == 2
    parsed(html)
    for one in figures(html):
        assert json.loads(json.dumps(numbers(one)))


def test_a_page_is_whole_and_small(motion):
    html = page(many(motion, 7), background(measured=np.ones(7, dtype=bool)))
    assert "src=" not in html
    assert "@import" not in html
    assert len(html) < 1_000_000
    assert not re.search(r"\bnan\b", re.sub("<script.*?</script>", "", html, flags=16))


def test_every_effect_has_a_name_in_words():
    for name in available():
        assert "_" not in effect_label(name)
    assert effect_label("my_own") == "my own"
