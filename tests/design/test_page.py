"""The page of a motion and its summary: all that is known, all escaped."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.design import (
    Background,
    ExpectedInterval,
    Invisible,
    MotionLimits,
    Parted,
    Visible,
    decisions,
    design_motion,
    effect_label,
    exceeded,
    invisible_sentences,
    page,
    summary,
)
from sklearn_vbjfa.diagnosis.report import line_figure
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


def test_without_a_limit_there_is_no_bar(motion):
    free = replace(motion.limits, acceleration=None)
    html = page(replace(motion, limits=free), background())
    fastest = np.abs(motion.a[:, 1]).max()
    assert f"{fastest:.3g} m/s², no limit" in html
    assert len(re.findall(r'class="fill ', html)) == 6
    assert "- " in "\n".join(summary(replace(motion, limits=free), background()))


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


def test_levels_far_from_a_line_are_said():
    t = np.linspace(0.0, 4.0, 401)
    near = line_figure(t, np.sin(t), title="a", y_label="b", levels=(-2.0, 2.0))
    (chart,) = near.charts
    (path,) = [x.path for x in chart.shapes if x.kind == "limit"]
    assert path.count("M0 ") == 2
    assert near.keys == (("limit", "limit"),)
    far = line_figure(t, np.sin(t), title="a", y_label="b", levels=(-50.0, 2.0))
    assert far.keys[1] == ("limit", "beyond the picture: -50")
    (path,) = [x.path for x in far.charts[0].shapes if x.kind == "limit"]
    assert path.count("M0 ") == 1
    still = line_figure(t, np.zeros(401), title="a", y_label="b", levels=(-1.0, 1.0))
    assert "nan" not in "".join(x.path for x in still.charts[0].shapes)


def test_intervals_of_both_recordings(motion):
    told = ("I", 0.5, 2.0), ("turn:viscous", 0.3, 1.0), ("slide:ripple", 4.0, 7.0)
    motion = replace(
        motion,
        expected_intervals=tuple(
            ExpectedInterval(name=name, unit="kg", half_width=half, value=value)
            for name, half, value in told
        ),
    )
    found = {
        "parameters": [
            {"name": "turn:viscous", "value": 1.0, "interval": [0.6, 1.4]}
            | {"known": "yes"},
            # one coefficient, which the report names
            {"name": "slide:ripple:amplitude", "value": 7.0, "interval": [6.0, 8.0]}
            | {"known": "yes"},
            {"name": "I", "value": 2.0, "interval": [1.0, 3.0]}
            | {"known": "in combination"},
        ]
    }
    html = page(motion, background(found=found))
    cells = re.findall(r"<td>(.*?)</td>", html)
    viscous = cells[cells.index("viscous") + 1 :][:5]
    # 1 / hypot(1 / 0.4, 1 / 0.3) = 0.24
    assert viscous == ["1.0 ± 0.4", "± 0.3", "± 0.24", "kg", "1.7 times narrower"]
    ripple = cells[cells.index("ripple") + 1 :][:5]
    assert ripple == ["7.0 ± 1.0", "± 4", "± 0.97", "kg", "as now"]
    body = cells[cells.index("I") + 1 :][:5]
    assert body == ["2", "± 0.5", "-", "kg", "a combination"]
    text = "\n".join(summary(motion, background(found=found)))
    assert "1 of 2 intervals become narrower" in text


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


def test_what_it_shows_is_said_although_nobody_asked(tmp_path):
    urdf = tmp_path / "crane.urdf"
    urdf.write_text(URDF)
    limits = MotionLimits.of(urdf, acceleration=[4.0, 2.0])
    made = design_motion(
        str(urdf), duration=4.0, dt=0.02, limits=limits, random_state=0
    )
    assert not made.parts
    shown = {(one.name, one.joint) for one in made.shows}
    assert {("stribeck", 0), ("ripple", 1)} <= shown
    assert all(0 < one.least < np.inf for one in made.shows)
    assert ("rotor_inertia", 0) in {(one.name, one.joint) for one in made.invisible}
    text = "\n".join(summary(made, background()))
    assert "It shows effects that exceed these torques\n- joint 1 (turn): " in text
    assert "Which causes it tells apart" not in page(made, background())


def test_what_no_motion_shows_has_its_reason(motion):
    (sentence,) = invisible_sentences(motion, background())
    assert sentence.startswith(
        "Not identifiable by any motion: rotor inertia (joint 1 (turn))"
    )
    found = {
        "hidden": [
            {"name": "rotor_inertia", "joint": 0, "reason": "span", "remedy": ""},
            {"name": "joint_axis", "joint": 0, "reason": "together"}
            | {"remedy": "base_tilt"},
            {"name": "ripple", "joint": 0, "reason": "excitation", "remedy": "faster"},
        ]
    }
    (both,) = invisible_sentences(motion, background(found=found))
    together = "; turned joint axis (joint 1 (turn)) (only together with tilted base)."
    assert both == sentence.removesuffix(".") + together
    (first,) = invisible_sentences(motion, background(found=found), most=1)
    assert first == sentence


def test_noise_that_was_not_measured_is_said(motion):
    assert "Noise was not measured" in page(motion, background())
    known = background(measured=np.array([True, True]))
    assert "Noise was not measured" not in page(motion, known)
    assert "Noise was not measured" not in "\n".join(summary(motion, known))


def test_clearance_or_why_it_is_not_known(motion):
    text = " ".join(summary(motion, background()))
    assert "no collision geometry" in text
    near = replace(
        motion, margins=motion.margins | {"clearance": 0.0234}, no_clearance=""
    )
    html = page(near, background())
    assert "Bodies stay 23.4 mm apart" in html
    assert "no collision geometry" not in html
    assert "23.4 mm apart" in " ".join(summary(near, background()))


def test_limits_that_are_exceeded_are_named(motion):
    margins = {key: np.full(2, 0.5) for key in motion.margins}
    over = replace(motion, margins=margins | {"torque": np.array([0.5, -0.1])})
    assert (
        exceeded(over) == "the limit of torque of joint 2 (slide) is exceeded by 10.0 %"
    )
    tight = replace(motion, margins=margins | {"position": np.array([0.011, 0.5])})
    assert exceeded(tight).endswith("is kept with 1.1 % to spare, not 2%")
    near = replace(motion, margins=margins | {"clearance": 0.004})
    assert exceeded(near) == "bodies come as near as 4 mm, where 10 mm are kept"
    html = page(replace(over, within_limits=False), background())
    assert '<header class="bad">' in html
    assert "is exceeded by" in html


@pytest.mark.parametrize("repeats", [False, True])
@pytest.mark.parametrize("nv", [1, 6, 7, 20])
def test_a_summary_fits_a_screen(nv, repeats, motion):
    repeated = [{"seconds": 23.55, "count": 10.0, "recordings": [0]}]
    told = background(
        measured=np.zeros(nv, dtype=bool),
        report="a-report",
        found={"hidden": [], "parameters": [], "repeated": repeated * repeats},
    )
    lines = summary(many(motion, nv), told)
    assert any("10 times 23.6 s" in line for line in lines) == repeats
    # What to do next and what was written takes five lines more.
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 88
    assert all(line or lines[k + 1] for k, line in enumerate(lines[:-1]))
    # A condition number means nothing without the units of the columns.
    (conditions,) = (line for line in lines if "condition number" in line)
    assert "columns over their sizes at random states" in conditions
    assert f"{motion.condition_number:.2g}"[:2] in conditions
    assert "condition" not in repr(motion)


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


def test_smaller_intervals_need_a_positive_width(motion):
    zero = ExpectedInterval(name="a", unit="", half_width=math.inf, value=1.0)
    html = page(replace(motion, expected_intervals=(zero,)), background())
    assert "<td>-</td>" in html
    assert "inf" not in re.findall(r"<td>(.*?)</td>", html)
