"""Reading MJCF by MuJoCo's own compiler, as a tree of joints for Pinocchio.

Pinocchio has a reader of its own, which keeps one body below the world and takes no
notice of equality constraints. This one keeps all bodies, in the order of MuJoCo's
coordinates, and names what it cannot keep.
"""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._trees import Link, check_number, import_pinocchio
from sklearn_vbjfa.model._xml import number, numbers, write_tree

_WORLD = -1
# Files that one robot may include, and elements inside elements.
_MOST_FILES, _DEEPEST = 100, 300
# Elements that MuJoCo's compiler turns into bodies of their own: few characters make
# any number of them.
_MACROS = ("composite", "flexcomp", "replicate", "attach")
# What is read of a file; the rest needs files or memory that joints have no use for.
_READ = ("compiler", "option", "default", "worldbody", "tendon", "equality")
# What joints do by themselves, in MuJoCo.
_PASSIVE = {
    "stiffness": "springs",
    "damping": "damping",
    "frictionloss": "dry friction",
    "armature": "rotor inertia (armature)",
}
_LOOP = "closes a loop, and only trees of joints can be identified"
_SAVE = (
    "load the file with MuJoCo, save what it made of it (mujoco.mj_saveLastXML), and "
    "give that file"
)


def import_mujoco():
    """Import mujoco, or say in one line how to get it."""
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(
            "MJCF files are read by MuJoCo, which is not installed: "
            'pip install "sklearn-vbjfa[mujoco]"'
        ) from error
    return mujoco


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """A joint of a body."""

    # the kind is "hinge", "slide", "ball" or "free"
    name: str
    kind: str
    # (3,) in the axes of the body; the anchor is a point of hinges
    axis: np.ndarray
    anchor: np.ndarray
    ref: float = 0.0  # its position where the body is as described [rad or m]
    low: float = -np.inf
    high: float = np.inf
    passive: tuple = ()  # what it does by itself in MuJoCo, in words

    def moved(self, position):
        """Motion of the body from where it is described, pinocchio.SE3."""
        pin, way = import_pinocchio(), position - self.ref
        if self.kind == "slide":
            return pin.SE3(np.eye(3), way * self.axis)
        if self.kind != "hinge":
            return pin.SE3.Identity()
        turn = pin.exp3(way * self.axis)
        return pin.SE3(turn, self.anchor - turn @ self.anchor)


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A body."""

    name: str
    parent: int  # number of the body that carries it, -1 for the world
    placement: object  # where it is in its parent
    joints: tuple  # its joints, the one next to the parent first
    inertia: object  # in its axes; zero without mass


@dataclass(frozen=True, kw_only=True)
class Constraint:
    """An equality constraint."""

    # "connect", "weld", "tendon" or "joint", and how messages call it
    kind: str
    name: str
    bodies: tuple = ()  # bodies that it joins; empty for other kinds
    joints: tuple = ()  # joints that it couples; empty for other kinds


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfRobot:
    """What an MJCF file says of a robot."""

    name: str
    path: Path  # what messages name
    bodies: tuple  # parents before children, in MuJoCo's order
    gravity: np.ndarray  # (3,) [m/s^2]
    # what is to hold between bodies or joints, except followers
    constraints: tuple
    links: dict  # joints that follow others, name -> `Link`
    beside: tuple  # what the file has beside bodies and joints, in words
    nameless: tuple  # names given to joints that have none

    @property
    def joints(self):
        """All joints in order, a list of `Joint`."""
        return [joint for body in self.bodies for joint in body.joints]

    @property
    def massless(self):
        """Names of joints that move the next joint of the same body and no mass."""
        return [joint.name for body in self.bodies for joint in body.joints[:-1]]

    def left_out(self):
        """Sentences on what is in the file and does not enter the model."""
        found, words = [], []
        for what in _PASSIVE.values():
            having = [joint.name for joint in self.joints if what in joint.passive]
            if having:
                every = len(having) == len(self.joints) > 1
                listed = "all joints" if every else ", ".join(having)
                words.append(f"the {what} of {listed}")
        words += self.beside
        if words:
            found.append(
                "not taken over is what MuJoCo simulates beside the bodies: "
                f"{', '.join(words)} (friction and effects identify what the recording "
                "shows of it)"
            )
        if not self.gravity.any():
            found.append("there is no gravity in it (option), and so none in the model")
        if self.nameless:
            found.append(f"joints without a name are called {', '.join(self.nameless)}")
        return found

    @property
    def names(self):
        """Names of the joints, a list."""
        return [joint.name for joint in self.joints]

    @property
    def free(self):
        """Names of the joints that let a body float freely."""
        return [joint.name for joint in self.joints if joint.kind == "free"]

    @property
    def carriers(self):
        """Name of the joint that carries each joint, name -> name or None."""
        joints, found = self.joints, {}
        of_bodies = self._moved_by()
        for body in self.bodies:
            above = of_bodies[body.parent]
            name = joints[above].name if above >= 0 else None
            for joint in body.joints:
                found[joint.name] = name
                name = joint.name
        return found

    def _moved_by(self):
        """Return the number of the joint that moves each body, by the body's number."""
        found, count = {_WORLD: -1}, 0
        for k, body in enumerate(self.bodies):
            count += len(body.joints)
            found[k] = count - 1 if body.joints else found[body.parent]
        return found

    def held(self, moving, follow):
        """Return the robot, whose joints that neither move nor follow stay at zero."""
        return replace(
            self._fixed({*moving, *follow}),
            links={name: self.links[name] for name in self.links if name in follow},
        )

    def settled(self):
        """Return the robot, whose followers of what is held are held already."""
        return self

    def _fixed(self, moving):
        """Return the robot with all joints at zero but those that are named."""
        bodies = []
        for body in self.bodies:
            placement, kept = body.placement, []
            for joint in body.joints:
                if joint.name in moving:
                    kept.append(joint)
                    continue
                # What is fixed behind a joint turns it into other axes of the body.
                fixed = joint.moved(0.0)
                placement = placement * fixed
                kept = [
                    replace(
                        one,
                        axis=fixed.rotation.T @ one.axis,
                        anchor=fixed.actInv(one.anchor),
                    )
                    for one in kept
                ]
            bodies.append(replace(body, placement=placement, joints=tuple(kept)))
        return replace(self, bodies=tuple(bodies))

    def with_base(self, name, turn=None):
        """Return the robot without its free joint, and the axes (3, 3) of its base."""
        # turn: those in the world; None for those of the file.
        # MuJoCo has such a joint on bodies of the world alone.
        bodies = list(self.bodies)
        at = next(k for k, x in enumerate(bodies) if name in [j.name for j in x.joints])
        if turn is not None:
            placement = bodies[at].placement.copy()
            placement.rotation = turn
            bodies[at] = replace(bodies[at], placement=placement)
        moving = {joint.name for joint in self.joints} - {name}
        robot = replace(self, bodies=tuple(bodies))._fixed(moving)
        return robot, bodies[at].placement.rotation

    def check(self):
        """Refuse more joints than robots have, and what is not a tree of joints."""
        check_number(len(self.joints), self.path)
        self._check_tree()

    def _check_tree(self):
        """Refuse joints of other than one degree of freedom, and what closes loops."""
        moving = {joint.name for joint in self.joints}
        carried_by = self._moved_by()
        wrong = []
        for joint in self.joints:
            if joint.kind == "free":
                wrong.append(
                    f"joint {joint.name!r} lets its body float freely (a free joint "
                    "is held only if there is no other one and it carries all other "
                    "joints; take it out of the file if the body stands firm)"
                )
            elif joint.kind == "ball":
                wrong.append(
                    f"joint {joint.name!r} is a ball joint (write three hinges with "
                    "axes at right angles in its place)"
                )
        for one in self.constraints:
            if one.bodies and carried_by[one.bodies[0]] == carried_by[one.bodies[1]]:
                # Held joints made one body of both.
                continue
            if not one.bodies and not moving.intersection(one.joints):
                continue
            why = _LOOP if one.bodies else _why_not(one, moving)
            wrong.append(f"{one.name} {why}")
        if wrong:
            raise ValueError(
                f"{str(self.path)!r} does not describe a tree of hinges and slides: "
                f"{'; '.join(wrong)}. What is not recorded can be held at zero: name "
                "the joints that are (--joints in the command line, joint_names in "
                "Python)."
            )

    def build(self):
        """Build the model of a robot whose joints are hinges and slides."""
        pin = import_pinocchio()
        model = pin.Model()
        model.name = self.name
        gravity = model.gravity.copy()
        gravity.linear = self.gravity
        model.gravity = gravity
        # Of a body: the joint that moves it, that joint's frame, and its place there.
        places = {_WORLD: (0, 0, pin.SE3.Identity())}
        for k, body in enumerate(self.bodies):
            number_, frame, place = places[body.parent]
            place = place * body.placement
            for joint in body.joints:
                anchor = pin.SE3(np.eye(3), joint.anchor)
                # With its axes parallel to the body's where the joint is at zero.
                zero = place * joint.moved(0.0) * anchor
                number_ = model.addJoint(
                    number_,
                    _pinocchio_joint(joint),
                    zero,
                    joint.name,
                    *(np.array([x]) for x in (np.inf, np.inf, joint.low, joint.high)),
                )
                frame = model.addJointFrame(number_, frame)
                place = anchor.inverse()
            if _has_mass(body.inertia):
                model.appendBodyToJoint(number_, body.inertia, place)
            model.addBodyFrame(body.name, number_, place, frame)
            places[k] = number_, frame, place
        return model

    def write(self, target):
        """Write the robot as MJCF, its bodies and joints alone, to be read again."""
        self._check_tree()
        root = ElementTree.Element("mujoco", model=self.name)
        ElementTree.SubElement(
            root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false"
        )
        ElementTree.SubElement(root, "option", gravity=numbers(self.gravity))
        elements = {_WORLD: ElementTree.SubElement(root, "worldbody")}
        for k, body in enumerate(self.bodies):
            elements[k] = ElementTree.SubElement(
                elements[body.parent], "body", name=body.name, **_placed(body.placement)
            )
            _write_mass(elements[k], body.inertia)
            for joint in body.joints:
                _write_joint(elements[k], joint)
        if self.links:
            _write_followers(ElementTree.SubElement(root, "equality"), self)
        write_tree(ElementTree.ElementTree(root), target)


def _why_not(constraint, moving):
    """Say why a constraint on joints or tendons cannot be kept."""
    if constraint.kind != "joint":
        return f"is a constraint of the kind {constraint.kind!r}, which is not modelled"
    if len(constraint.joints) == 1:
        return "locks a joint (take the joint or the constraint out of the file)"
    return (
        "is not linear in the other joint's position (only a polycoef of the form o k "
        "0 0 0 is)"
    )


def _has_mass(inertia):
    """Whether a body has a mass, or moments of inertia without one."""
    return inertia.mass > 0 or inertia.inertia.any()


def _pinocchio_joint(joint):
    """Return Pinocchio's joint of an axis, an aligned one where it is one."""
    pin = import_pinocchio()
    kind = "P" if joint.kind == "slide" else "R"
    for letter, axis in zip("XYZ", np.eye(3)):
        if (joint.axis == axis).all():
            return getattr(pin, f"JointModel{kind}{letter}")()
    long = "Prismatic" if joint.kind == "slide" else "Revolute"
    return getattr(pin, f"JointModel{long}Unaligned")(joint.axis)


def _placed(placement):
    """Attributes of a place and axes."""
    turn = import_pinocchio().Quaternion(placement.rotation)
    return {
        "pos": numbers(placement.translation),
        "quat": numbers([turn.w, turn.x, turn.y, turn.z]),
    }


def _write_mass(parent, inertia):
    if not _has_mass(inertia):
        return
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia
    ElementTree.SubElement(
        parent,
        "inertial",
        pos=numbers(inertia.lever),
        mass=number(inertia.mass),
        fullinertia=numbers([xx, yy, zz, xy, xz, yz]),
    )


def _write_joint(parent, joint):
    element = ElementTree.SubElement(
        parent,
        "joint",
        name=joint.name,
        type=joint.kind,
        axis=numbers(joint.axis),
        pos=numbers(joint.anchor),
        ref=number(joint.ref),
    )
    if np.isfinite([joint.low, joint.high]).all():
        element.set("range", numbers([joint.low, joint.high]))


def _write_followers(parent, robot):
    refs = {joint.name: joint.ref for joint in robot.joints}
    for name, link in robot.links.items():
        shift = link.offset - refs[name] + link.multiplier * refs[link.leader]
        ElementTree.SubElement(
            parent,
            "joint",
            joint1=name,
            joint2=link.leader,
            polycoef=numbers([shift, link.multiplier, 0.0, 0.0, 0.0]),
        )


# -- reading ---------------------------------------------------------------------------


def read_mjcf(root, path, parse):
    """Read all bodies and joints of an MJCF file; the tree of `root` is changed."""
    # parse: function of a path to an `ElementTree`, for included files. A ValueError
    # names the file.
    mujoco = import_mujoco()
    try:
        _include(root, path, parse, {path.resolve()})
        n_actuators = sum(map(len, root.findall("actuator")))
        _keep_what_is_read(root)
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, "unicode"))
        spec.modelfiledir = str(path.parent)
        _drop_meshes(mujoco, spec)
        model = spec.compile()
        return _robot(mujoco, model, root.get("model", "robot"), path, n_actuators)
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        words = re.sub(r"(XML )?Error: |,? line \d+", " ", str(error))
        raise ValueError(
            f"{str(path)!r} is not readable as MJCF: {' '.join(words.split())}; "
            "correct the description."
        ) from error


def _include(element, path, parse, files, depth=0):
    """Put the content of included files in the place of what names them."""
    if depth > _DEEPEST:
        raise ValueError(f"elements are nested more than {_DEEPEST} deep")
    children = []
    for child in list(element):
        if child.tag != "include":
            _include(child, path, parse, files, depth + 1)
            children.append(child)
            continue
        name = child.get("file", "")
        target = path.parent / name
        if not name or not target.is_file():
            raise ValueError(
                f"it includes {name[:60]!r}, and there is no file {str(target)!r}"
            )
        if target.resolve() in files:
            raise ValueError(f"it includes {name[:60]!r} twice")
        if len(files) > _MOST_FILES:
            raise ValueError(f"it includes more than {_MOST_FILES} files")
        files.add(target.resolve())
        included = parse(target).getroot()
        _include(included, path, parse, files, depth)
        children += included
    element[:] = children


def _keep_what_is_read(root):
    """Keep bodies, constraints and meshes; refuse macros and numbers that are none."""
    if root.find("worldbody") is None:
        raise ValueError("it has no <worldbody>")
    for assets in root.findall("asset"):
        assets[:] = assets.findall("mesh")
    root[:] = [one for one in root if one.tag in (*_READ, "asset")]
    for element in root.iter():
        if element.tag in _MACROS:
            raise ValueError(
                f"<{element.tag}> makes bodies of its own, which is not done here: "
                f"{_SAVE}"
            )
        element.attrib.pop("material", None)
        for key, text in element.attrib.items():
            if not _is_possible(key, text):
                raise ValueError(
                    f"<{element.tag}> has {key}={text[:60]!r}, expected finite numbers"
                )


def _is_possible(key, text):
    """Whether an attribute is not a list of numbers with an infinite one or none."""
    try:
        values = np.array([float(x) for x in text.split()])
    except ValueError:
        return True
    wrong = np.isnan(values) if key == "range" else ~np.isfinite(values)
    return not wrong.any()


def _drop_meshes(mujoco, spec):
    """Take out shapes that need files and have no part in the masses."""
    mesh, kinds = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtInertiaFromGeom
    how = spec.compiler.inertiafromgeom
    low, high = spec.compiler.inertiagrouprange
    used = set()
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
            spec.delete(geom)
        elif geom.type == mesh or geom.meshname:
            given = how == kinds.mjINERTIAFROMGEOM_FALSE
            given |= (
                how == kinds.mjINERTIAFROMGEOM_AUTO and geom.parent.explicitinertial
            )
            light = geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0)
            if given or light or not low <= geom.group <= high:
                spec.delete(geom)
            else:
                used.add(geom.meshname)
    for one in list(spec.meshes):
        if one.name not in used:
            spec.delete(one)


def _robot(mujoco, model, name, path, n_actuators):
    """Return the `MjcfRobot` of a model that MuJoCo made."""
    names, nameless = _names(model)
    joints = [_joint(mujoco, model, j, names["joint"][j]) for j in range(model.njnt)]
    of_body = model.jnt_bodyid
    bodies = tuple(
        Body(
            name=names["body"][k],
            parent=int(model.body_parentid[k]) - 1,
            placement=_placement(model.body_pos[k], model.body_quat[k]),
            joints=tuple(one for one, at in zip(joints, of_body) if at == k),
            inertia=_inertia(model, k),
        )
        for k in range(1, model.nbody)
    )
    constraints, links = _equalities(mujoco, model, names, joints)
    beside = []
    if model.ntendon:
        tendons = [model.tendon(k).name or "tendon" for k in range(model.ntendon)]
        beside.append(f"the tendon(s) {', '.join(tendons)}")
    if model.body_gravcomp.any():
        listed = ", ".join(
            names["body"][k] for k in np.flatnonzero(model.body_gravcomp)
        )
        beside.append(f"that gravity is compensated on {listed} (gravcomp)")
    if n_actuators:
        beside.append(f"the {n_actuators} actuator(s) with their gains and biases")
    falls = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return MjcfRobot(
        name=name,
        path=path,
        bodies=bodies,
        gravity=falls * model.opt.gravity,
        constraints=tuple(constraints),
        links=links,
        beside=tuple(beside),
        nameless=nameless,
    )


def _names(model):
    """Names of bodies and joints, made up where there are none; and those of joints."""
    bodies = _completed(
        [model.body(k).name for k in range(model.nbody)],
        [f"body_{k}" for k in range(model.nbody)],
    )
    first = model.body_jntadr
    wanted = [
        f"{bodies[at]}_joint{f'_{j - first[at] + 1}' if j > first[at] else ''}"
        for j, at in enumerate(model.jnt_bodyid)
    ]
    given = [model.joint(j).name for j in range(model.njnt)]
    joints = _completed(given, wanted)
    nameless = tuple(made for made, name in zip(joints, given) if not name)
    return {"body": bodies, "joint": joints}, nameless


def _completed(names, wanted):
    """Return names, with others that nothing has in place of empty ones."""
    taken, found = set(names), []
    for name, other in zip(names, wanted):
        while not name and other in taken:
            other = f"{other}_"
        taken.add(name or other)
        found.append(name or other)
    return found


def _joint(mujoco, model, j, name):
    """Return a joint."""
    kind = mujoco.mjtJoint(int(model.jnt_type[j])).name[6:].lower()
    if kind in ("ball", "free"):
        return Joint(name=name, kind=kind, axis=np.zeros(3), anchor=np.zeros(3))
    low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
    dof = model.jnt_dofadr[j]
    does = {
        key: getattr(model, f"dof_{key}")[dof]
        for key in ("damping", "frictionloss", "armature")
    }
    does["stiffness"] = model.jnt_stiffness[j]
    return Joint(
        name=name,
        kind=kind,
        axis=model.jnt_axis[j].copy(),
        anchor=model.jnt_pos[j].copy(),
        ref=float(model.qpos0[model.jnt_qposadr[j]]),
        low=float(low),
        high=float(high),
        passive=tuple(what for key, what in _PASSIVE.items() if does[key]),
    )


def _placement(place, turn):
    """Return pinocchio.SE3 of a position and a quaternion w, x, y, z."""
    pin = import_pinocchio()
    w, x, y, z = turn
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), place)


def _inertia(model, k):
    """Return the inertia of a body in its axes."""
    placed = _placement(model.body_ipos[k], model.body_iquat[k])
    turned = placed.rotation @ np.diag(model.body_inertia[k]) @ placed.rotation.T
    return import_pinocchio().Inertia(
        float(model.body_mass[k]), placed.translation, turned
    )


def _equalities(mujoco, model, names, joints):
    """Return the constraints, and how joints follow others."""
    constraints, links = [], {}
    for k in np.flatnonzero(model.eq_active0):
        kind = mujoco.mjtEq(int(model.eq_type[k])).name[5:].lower()
        ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        own = model.eq(k).name
        called = f"<{kind}> {own!r} of <equality>" if own else f"<{kind}> of <equality>"
        if kind in ("connect", "weld"):
            if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                ends = [int(model.site_bodyid[at]) for at in ends]
            words = " and ".join(names["body"][at] for at in ends)
            found = Constraint(
                kind=kind,
                name=f"{called}, between {words},",
                bodies=tuple(at - 1 for at in ends),
            )
        elif kind == "joint":
            own, *leader = [joints[at] for at in ends if at >= 0]
            offset, rate, *bent = model.eq_data[k, :5]
            hinged = {own.kind, *(one.kind for one in leader)} <= {"hinge", "slide"}
            if leader and hinged and rate != 0 and not any(bent):
                # Both count from where the file puts them.
                links[own.name] = Link(
                    leader=leader[0].name,
                    multiplier=float(rate),
                    offset=float(offset + own.ref - rate * leader[0].ref),
                )
                continue
            tied = [one.name for one in (own, *leader)]
            found = Constraint(
                kind=kind,
                name=f"{called}, which ties {' to '.join(tied)},",
                joints=tuple(tied),
            )
        else:
            found = Constraint(kind=kind, name=called, joints=tuple(names["joint"]))
        constraints.append(found)
    return constraints, links
