"""MJCF as input: the torques are those of MuJoCo, and what cannot be kept is named."""

import warnings

import numpy as np
import pytest

from sklearn_vbjfa.model import (
    JointDynamics,
    body_names,
    joint_names,
    load_folded,
    load_model,
    load_reduced,
    movable_joints,
    write_mjcf,
    write_reduced,
)
from tests.effects._arms import inverse_dynamics
from tests.model._mujoco import moving_states
from tests.model._robots import random_tree

# Every way of placing things that MJCF has, several joints of one body, branches, and
# two bodies below the world.
ODD = """
<mujoco model="odd">
  <include file="part.xml"/>
  <compiler eulerseq="XYz" inertiagrouprange="0 3"/>
  <option gravity="1 2 -9" density="1.2"/>
  <default>
    <geom density="500"/>
    <joint damping="1"/>
    <default class="arm">
      <joint axis="0 1 0" range="-90 90" armature="0.1"/>
      <geom type="capsule" size=".03 .1"/>
      <default class="tip">
        <joint type="slide" axis="1 0 1" range="-1 2"/>
        <geom type="box" size=".1 .2 .3" euler="10 20 30"/>
      </default>
    </default>
  </default>
  <worldbody>
    <body name="stand" pos="0 0 1" euler="20 40 60">
      <geom type="sphere" size=".2"/>
      <body name="a" childclass="arm" pos="0.1 0.2 0.3" axisangle="1 1 0 30">
        <joint name="a1" pos="0.1 0 0" ref="20"/>
        <joint name="a2" axis="1 0 0" pos="0 0.2 0" limited="false"/>
        <joint name="a3" class="tip" axis="0 1 1" ref="0.1"/>
        <geom/>
        <geom class="tip" pos=".1 .1 .1"/>
        <geom type="ellipsoid" size=".1 .2 .3" group="4"/>
        <geom type="cylinder" fromto="0 0 0 .3 .2 .1" size=".05" mass="2"/>
        <frame pos="0 .1 0" euler="0 0 90">
          <joint name="a4" axis="1 0 0" pos=".1 .1 0"/>
          <geom type="ellipsoid" size=".1 .2 .3"/>
          <body name="b" pos="0 0 .3" xyaxes="1 1 0 0 1 1">
            <joint name="b1" class="tip"/>
            <inertial pos=".1 0 .1" quat="1 2 3 4" mass="3"
                      diaginertia=".1 .2 .15"/>
          </body>
          <frame zaxis="1 1 1">
            <body name="c" pos="0 0 .3">
              <joint name="c1"/>
              <inertial pos=".1 0 .1" mass="3"
                        fullinertia=".1 .2 .15 .01 .02 .03"/>
              <body name="d" pos="0 0 .2">
                <geom type="box" fromto="0 0 0 .1 .1 .4" size=".05"/>
              </body>
            </body>
          </frame>
        </frame>
        <body name="e" pos="1 0 0" zaxis="0 0 -1"><joint/><geom/></body>
      </body>
    </body>
    <body name="second" pos="2 0 0">
      <joint name="s1" type="slide" axis="1 0 1" range="-1 2"/>
      <geom size=".1" type="sphere"/>
    </body>
  </worldbody>
  <actuator><motor joint="s1" gear="-30" ctrlrange="-1 2"/></actuator>
</mujoco>
"""
PART = '<mujocoinclude><compiler angle="degree"/></mujocoinclude>'
JOINTS = ("a1", "a2", "a3", "a4", "b1", "c1", "e_joint", "s1")


def quiet(function, *arguments):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return function(*arguments)


def bodies_by_mujoco(path, states):
    """Torques (n, nv) of bodies and rotors alone, by MuJoCo."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    for what in ("damping", "frictionloss"):
        getattr(model, f"dof_{what}")[:] = 0.0
        getattr(model, f"tendon_{what}")[:] = 0.0
    model.tendon_armature[:] = 0.0
    model.jnt_stiffness[:] = model.tendon_stiffness[:] = 0.0
    model.body_gravcomp[:] = 0.0
    model.opt.density = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, found = mujoco.MjData(model), []
    for row in states:
        data.qpos[:], data.qvel[:], data.qacc[:] = row.reshape(3, -1)
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    return np.array(found)


@pytest.fixture(autouse=True)
def part(write):
    """Write what some of the files include."""
    write(PART, "part.xml")


def arm(inside="", joint='<joint name="j"/>', before="", after=""):
    """Return a robot of one body."""
    return (
        f"<mujoco>{before}<worldbody><body name='b' pos='1 2 3'>{joint}{inside}</body>"
        f"</worldbody>{after}</mujoco>"
    )


MASS = '<inertial pos=".1 .2 0" mass="2" diaginertia=".1 .2 .15"/>'


def test_every_way_of_placing_things(write):
    path = write(ODD)
    model = quiet(load_model, path)
    states = moving_states(np.random.default_rng(0), 30, model.nv)
    expected = bodies_by_mujoco(path, states)
    worst = np.abs(inverse_dynamics(model, states) - expected).max()
    assert worst < 1e-11 * np.abs(expected).max()
    assert joint_names(model) == movable_joints(path) == JOINTS
    assert body_names(model)[3:] == ("a", "b", "c", "e", "second")
    degrees = np.deg2rad(90)
    low = [-degrees, -np.inf, -1.0, -degrees, -1.0, -degrees, -degrees, -1.0]
    np.testing.assert_allclose(model.lowerPositionLimit, low)
    np.testing.assert_allclose(model.effortLimit, [*[np.inf] * 7, 30.0])
    np.testing.assert_allclose(model.gravity.linear, [1, 2, -9])


def test_what_is_left_out_is_said_once(write):
    with pytest.warns(UserWarning, match="'robot.xml': not taken over") as said:
        load_model(write(ODD))
    (text,) = [str(one.message) for one in said]
    for words in (
        "'robot.xml'",
        "(simulated by MuJoCo only): damping, forces of a fluid, actuators (friction",
        "joints without a name are called e_joint",
        "the body of a1, a2, a3 has no mass",
    ):
        assert words in text
    # The rotor inertias are in the model.
    assert "armature" not in text


@pytest.mark.parametrize("seed", range(3))
def test_written_robots_are_read_again(seed, tmp_path):
    """Trees as this package exports them, with all that joints do by themselves."""
    rng = np.random.default_rng(seed)
    nv = int(rng.integers(2, 9))
    model, bodies = random_tree(rng, nv)
    model.gravity.linear = rng.normal(size=3) * 5.0
    own = {
        name: rng.uniform(0.5, 2.0, size=nv)
        for name in ("damping", "frictionloss", "armature", "stiffness", "gain")
    }
    own |= {
        name: rng.normal(size=nv) for name in ("springref", "ref", "constant", "slope")
    }
    path = tmp_path / "identified.xml"
    write_mjcf(path, model, bodies, JointDynamics(**own))
    first, *_, last = joint_names(model)
    both = "".join(f'<joint joint="{name}" coef="1"/>' for name in (first, last))
    tendon = f'<tendon><fixed damping="0.7">{both}</fixed></tendon></mujoco>'
    path.write_text(path.read_text().replace("</mujoco>", tendon))
    with pytest.warns(UserWarning, match="not taken over") as said:
        read = load_model(path)
    text = str(said[0].message)
    assert "springs, damping, dry friction, tendons, actuators" in text
    assert sorted(joint_names(read)) == sorted(joint_names(model))
    # MuJoCo's order is that of the file, the columns are found by name.
    order = [joint_names(model).index(name) for name in joint_names(read)]
    states = moving_states(rng, 20, nv)
    q, v, a = np.split(states, 3, axis=1)
    moved = np.hstack([q - own["ref"], v, a])
    columns = np.concatenate([np.array(order) + k * nv for k in range(3)])
    found = inverse_dynamics(read, states[:, columns])
    model.armature = own["armature"]
    expected = inverse_dynamics(model, moved)[:, order]
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(
        bodies_by_mujoco(path, states[:, columns]),
        expected,
        atol=1e-10 * np.abs(expected).max(),
    )


def test_held_joints_are_at_zero(write, tmp_path):
    """What moves feels what MuJoCo computes with the others at zero, ref or not."""
    with pytest.raises(ValueError, match="another gravity than"):
        write_reduced(write(ODD), tmp_path / "reduced.urdf", ["s1"])
    path = write(ODD.replace("1 2 -9", "0 0 -9.81"))
    moving = ("s1", "c1", "a2")
    own = [name for name in JOINTS if name in moving]
    model = quiet(load_reduced, path, moving)
    assert joint_names(model) == tuple(own)
    at = np.array([JOINTS.index(name) for name in own])
    states = moving_states(np.random.default_rng(0), 30, 3)
    full = np.zeros((30, 3, 8))
    full[:, :, at] = states.reshape(30, 3, 3)
    expected = bodies_by_mujoco(path, full.reshape(30, 24))[:, at]
    np.testing.assert_allclose(inverse_dynamics(model, states), expected, atol=1e-9)
    reduced = tmp_path / "reduced.urdf"
    held = write_reduced(path, reduced, moving)
    assert held == tuple(name for name in JOINTS if name not in moving)
    again = quiet(load_model, reduced)
    assert joint_names(again) == movable_joints(reduced) == tuple(own)
    np.testing.assert_allclose(inverse_dynamics(again, states), expected, atol=1e-9)
    limits = model.lowerPositionLimit, model.upperPositionLimit
    np.testing.assert_array_equal(
        [again.lowerPositionLimit, again.upperPositionLimit],
        np.clip(limits, -1e12, 1e12),
    )
    with pytest.raises(ValueError, match=r"no movable joint 'wheel'; it has a1, a2"):
        load_reduced(path, ["wheel"])


def test_joint_equalities_of_mujoco_are_followers(write, tmp_path):
    """q_f - ref_f = o + k (q_l - ref_l), however the file counts."""
    after = (
        '<equality><joint joint1="k" joint2="j" polycoef="0.3 -2 0 0 0"/>'
        '<joint joint1="j" active="false"/></equality>'
    )
    inside = f'{MASS}<body><joint name="k" ref="10" armature="0.1"/>{MASS}</body>'
    path = write(arm(inside, '<joint name="j" ref="20"/>', after=after))
    (body,) = load_folded(path).followers
    # The rotor of the follower turns twice as fast as the joint that leads it.
    np.testing.assert_allclose(load_model(path).armature, 4 * 0.1)
    assert joint_names(load_model(path)) == movable_joints(path) == ("j",)
    step = body.chain[-1]
    assert (body.name, body.leader, step.joint, step.rate) == ("k", 0, 0, -2.0)
    assert step.offset == pytest.approx(0.3 + np.deg2rad(10 + 2 * 20))
    write_reduced(path, tmp_path / "again.urdf", ["j"])
    (again,) = load_folded(tmp_path / "again.urdf").followers
    assert again.chain[-1].offset == pytest.approx(step.offset)
    # One that is named has columns of its own.
    assert joint_names(load_reduced(path, ["k", "j"])) == ("j", "k")


LEADS = MASS + f"<body><joint name='k'/>{MASS}</body>"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (arm(MASS, '<freejoint name="f"/>'), "f .JointModelFreeFlyer"),
        (
            arm(MASS, after='<equality><weld body1="b"/></equality>'),
            "<weld> of <equality>, between b and world, closes a loop",
        ),
        (
            arm(MASS, after='<equality><joint joint1="j"/></equality>'),
            "ties j, locks a joint",
        ),
        (
            arm(
                LEADS,
                after='<equality><joint joint1="j" joint2="k" polycoef="0 1 2"/>'
                "</equality>",
            ),
            "ties j to k, is not linear",
        ),
        (arm(MASS, ""), "no moving joint"),
        (arm(MASS, '<joint name="j" ref="nan"/>'), "qpos0 has a number that is not"),
        (arm(MASS, before='<include file="gone.xml"/>'), "gone.xml"),
        ("<sdf/>", "outermost element is <sdf>; expected <robot>"),
    ],
)
def test_refuses_in_one_line(write, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        load_model(write(text))
    assert "\n" not in str(caught.value)


def test_a_loop_among_held_joints_is_no_loop(write):
    """A gripper with a four-bar linkage on an arm that is identified."""
    gripper = "".join(
        f'<body name="f{k}"><joint name="g{k}"/>{MASS}</body>' for k in (1, 2)
    )
    rod = '<connect name="rod" body1="f1" body2="f2" anchor="0 0 0"/>'
    after = f"<equality>{rod}</equality>"
    path = write(arm(MASS + gripper, after=after))
    with pytest.raises(ValueError, match="'rod' of <equality>, between f1 and f2,"):
        load_model(path)
    model = load_reduced(path, ["j"])
    assert joint_names(model) == ("j",)
    assert model.inertias[1].mass == pytest.approx(6.0)


def test_meshes_are_read_where_they_have_the_mass(write, tmp_path):
    mesh = '<asset><mesh name="m" file="m.obj"/><mesh file="gone.stl"/></asset>'
    mesh += '<option><flag gravity="enable"/></option>'
    shape = '<geom type="mesh" mesh="m" material="gold"/>'
    path = write(arm(shape, before=mesh))
    with pytest.raises(ValueError, match=r"m\.obj"):
        load_model(path)
    # With masses of its own a body needs no mesh, nor anything that looks good.
    light = write(arm(MASS + shape, before=mesh), "light.xml")
    assert load_model(light).inertias[1].mass == 2.0
    corners = "".join(
        f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 2) for z in (0, 3)
    )
    faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    (tmp_path / "m.obj").write_text(corners + "".join(f"f {x}\n" for x in faces))
    body = load_model(path).inertias[1]
    assert body.mass == pytest.approx(6000.0)
    np.testing.assert_allclose(body.lever, [0.5, 1.0, 1.5])
    moments = 500.0 * np.array([4 + 9, 1 + 9, 1 + 4])
    np.testing.assert_allclose(body.inertia, np.diag(moments), atol=1e-9 * 6500)


def test_files_that_are_too_deep_end_in_words(write):
    deep = "<body>" * 1000 + "</body>" * 1000
    with pytest.raises(ValueError, match="recursion depth"):
        load_model(write(f"<mujoco><worldbody>{deep}</worldbody></mujoco>"))


def test_macros_and_files_inside_are_mujocos(write):
    bodies = f"<body name='b'><joint name='j' axis='0 1 0'/>{MASS}</body>"
    inside = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    write(inside, "part.xml")
    path = write(
        '<mujoco><include file="part.xml"/><worldbody><replicate count="2" sep="-">'
        f"<body name='c'><joint name='k'/>{MASS}</body></replicate></worldbody>"
        "</mujoco>"
    )
    assert joint_names(quiet(load_model, path)) == ("j", "k-0", "k-1")
