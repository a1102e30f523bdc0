"""Reading MJCF, the description of MuJoCo, as a tree of joints for Pinocchio.

Pinocchio has a reader of its own, which keeps one body below the world and takes no
notice of equality constraints. This one keeps all bodies, in the order of MuJoCo's
coordinates, and names what it cannot keep.
"""

import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sklearn_vbjfa.model._mjcf_document import DEEPEST, Document, masses_of
from sklearn_vbjfa.model._trees import Link, check_number, import_pinocchio
from sklearn_vbjfa.model._xml import number, numbers, write_tree

_WORLD = -1
# Elements that MuJoCo's compiler turns into bodies of their own.
_MACROS = ("composite", "flexcomp", "replicate", "attach")
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


@dataclass(frozen=True, kw_only=True)
class Beside:
    """What a file has beside bodies, joints and constraints."""

    tendons: list  # names
    n_actuators: int
    weightless: list  # bodies whose weight is compensated
    nameless: list  # names given to joints that have none
    unknown: list  # bodies with a mass that is not known, that of a mesh


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
    beside: Beside

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
        found, words, beside = [], [], self.beside
        for what in _PASSIVE.values():
            having = [joint.name for joint in self.joints if what in joint.passive]
            if having:
                every = len(having) == len(self.joints) > 1
                listed = "all joints" if every else ", ".join(having)
                words.append(f"the {what} of {listed}")
        if beside.tendons:
            words.append(f"the tendon(s) {', '.join(beside.tendons)}")
        if beside.weightless:
            listed = ", ".join(beside.weightless)
            words.append(f"that gravity is compensated on {listed} (gravcomp)")
        if beside.n_actuators:
            words.append(
                f"the {beside.n_actuators} actuator(s) with their gains and biases"
            )
        if words:
            found.append(
                "not taken over is what MuJoCo simulates beside the bodies: "
                f"{', '.join(words)} (friction and effects identify what the recording "
                "shows of it)"
            )
        if not self.gravity.any():
            found.append("there is no gravity in it (option), and so none in the model")
        if beside.nameless:
            found.append(
                f"joints without a name are called {', '.join(beside.nameless)}"
            )
        if beside.unknown:
            found.append(
                f"the mass of {', '.join(beside.unknown)} is that of a mesh, which is "
                f"not read (give it an <inertial>, or {_SAVE})"
            )
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
        bodies = list(self.bodies)
        at = next(k for k, x in enumerate(bodies) if name in [j.name for j in x.joints])
        base, above = bodies[at], np.eye(3)
        parent = base.parent
        while parent != _WORLD:
            above = bodies[parent].placement.rotation @ above
            parent = bodies[parent].parent
        if turn is not None:
            placement = base.placement.copy()
            placement.rotation = above.T @ turn
            base = bodies[at] = replace(base, placement=placement)
        moving = {joint.name for joint in self.joints} - {name}
        robot = replace(self, bodies=tuple(bodies))._fixed(moving)
        return robot, above @ base.placement.rotation

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


def read_mjcf(root, path, parse):
    """Read all bodies and joints of an MJCF file; the tree of `root` is changed."""
    # parse: function of a path to an `ElementTree`, for included files. A ValueError
    # names the file.
    try:
        return _BodyReader(Document(root, path, parse)).robot()
    except ValueError as error:
        raise ValueError(
            f"{str(path)!r} is not readable as MJCF: {error}; correct the description."
        ) from error


class _BodyReader:
    """Bodies and constraints of a document."""

    def __init__(self, document):
        self._document = document
        self._bodies, self._unknown, self._weightless = [], [], []
        self._sites, self._nameless = {}, []
        self._taken = {
            tag: {
                element.get("name")
                for world in document.sections("worldbody")
                for element in world.iter()
                if element.tag in tags
            }
            for tag, tags in (("body", ("body",)), ("joint", ("joint", "freejoint")))
        }

    def robot(self):
        """Return the `MjcfRobot`."""
        worlds = self._document.sections("worldbody")
        if not worlds:
            raise ValueError("it has no <worldbody>")
        for world in worlds:
            self._content(world, _WORLD, world.get("childclass"), 0)
        bodies = tuple(self._bodies)
        self._check_names(bodies)
        constraints, links = self._equalities(bodies)
        gravity = self._document.merged("option").numbers(
            "gravity", [0.0, 0.0, -9.81], 3
        )
        if self._document.merged("option/flag").text("gravity") == "disable":
            gravity = np.zeros(3)
        total = self._document.compiler.number("settotalmass", -1.0)
        if total > 0:
            bodies = _scaled(bodies, total)
        return MjcfRobot(
            name=self._document.name,
            path=self._document.path,
            bodies=bodies,
            gravity=gravity,
            constraints=tuple(constraints),
            links=links,
            beside=self._beside(),
        )

    # -- bodies --

    def _children(self, element, number, childclass, frame, joints, shapes, depth):
        """Read what is in a body, the world or a frame: fill `joints` and `shapes`."""
        # Returns the bodies in it, with their class of defaults and frame.
        if depth > DEEPEST:
            raise ValueError(f"bodies are nested more than {DEEPEST} deep")
        carried = []
        for child in element:
            if child.tag in _MACROS:
                raise ValueError(
                    f"<{child.tag}> makes bodies of its own, which is not done here: "
                    f"{_SAVE}"
                )
            attributes = self._document.attributes
            if child.tag in ("joint", "freejoint"):
                joints.append(self._joint(child, childclass, frame, number, joints))
            elif child.tag == "geom":
                shapes.append((attributes(child, childclass), frame))
            elif child.tag == "site" and child.get("name"):
                self._sites[child.get("name")] = number
            elif child.tag == "body":
                carried.append((child, child.get("childclass", childclass), frame))
            elif child.tag == "frame":
                carried += self._children(
                    child,
                    number,
                    child.get("childclass", childclass),
                    frame * self._document.placement(attributes(child)),
                    joints,
                    shapes,
                    depth + 1,
                )
        return carried

    def _content(self, element, number, childclass, depth):
        """Read what a body or the world consists of, then the bodies inside."""
        identity, joints, shapes = import_pinocchio().SE3.Identity(), [], []
        carried = self._children(
            element, number, childclass, identity, joints, shapes, depth
        )
        if number != _WORLD:
            self._finish(number, element, joints, shapes)
        for child, own, frame in carried:
            self._body(child, number, own, frame, depth)

    def _body(self, element, parent, childclass, frame, depth):
        """Read a body and all that it carries."""
        attributes = self._document.attributes(element)
        number = len(self._bodies)
        name = element.get("name") or self._free_name("body", f"body_{number + 1}")
        self._bodies.append(
            Body(
                name=name,
                parent=parent,
                placement=frame * self._document.placement(attributes),
                joints=(),
                inertia=None,
            )
        )
        if attributes.number("gravcomp") != 0:
            self._weightless.append(name)
        self._content(element, number, childclass, depth + 1)

    def _finish(self, number, element, joints, shapes):
        """Put joints and masses into a body."""
        body = self._bodies[number]
        try:
            masses = masses_of(self._document, element, shapes)
        except ValueError as error:
            raise ValueError(f"body {body.name!r}: {error}") from error
        if masses.unknown:
            self._unknown.append(body.name)
        self._bodies[number] = replace(
            body, joints=tuple(joints), inertia=masses.inertia
        )

    def _free_name(self, tag, name):
        """Return a name that nothing of the kind has, and take it."""
        while name in self._taken[tag]:
            name = f"{name}_"
        self._taken[tag].add(name)
        return name

    def _joint(self, element, childclass, frame, body, before):
        """Read a joint of a body; before : those that the body has already."""
        if body == _WORLD:
            raise ValueError("a joint is outside of any body")
        free = element.tag == "freejoint"
        attributes = self._document.attributes(element, childclass)
        kind = "free" if free else attributes.text("type", "hinge")
        name = element.get("name")
        if not name:
            # Joints are called by their bodies where they have no name.
            more = f"_{len(before) + 1}" if before else ""
            name = self._free_name("joint", f"{self._bodies[body].name}_joint{more}")
            self._nameless.append(name)
        if kind not in ("hinge", "slide", "ball", "free"):
            raise ValueError(f"{attributes.what} is of a type {kind[:60]!r}")
        if kind in ("ball", "free"):
            return Joint(name=name, kind=kind, axis=np.zeros(3), anchor=np.zeros(3))
        angle = self._document.angle if kind == "hinge" else float
        low, high = self._limits(attributes, angle)
        place = attributes.numbers("pos", np.zeros(3), 3)
        axis = attributes.direction("axis", [0.0, 0.0, 1.0])
        return Joint(
            name=name,
            kind=kind,
            axis=frame.rotation @ axis,
            anchor=frame.act(place),
            ref=float(angle(attributes.number("ref"))),
            low=low,
            high=high,
            passive=tuple(
                what
                for key, what in _PASSIVE.items()
                if attributes.numbers(key, [0.0]).any()
            ),
        )

    def _limits(self, attributes, angle):
        """Return the ends of a joint's positions."""
        ends = attributes.numbers("range", None, 2)
        given = ends is not None and self._document.compiler.truth("autolimits", True)
        if not attributes.truth("limited", given) or ends is None:
            return -np.inf, np.inf
        return float(angle(ends[0])), float(angle(ends[1]))

    def _check_names(self, bodies):
        """Refuse names that bodies or joints share."""
        for kind, names in (
            ("bodies", [body.name for body in bodies]),
            ("joints", [joint.name for body in bodies for joint in body.joints]),
        ):
            name, times = Counter(names).most_common(1)[0] if names else ("", 0)
            if times > 1:
                raise ValueError(f"{times} {kind} are called {name!r}")

    # -- constraints --

    def _equalities(self, bodies):
        """Return the constraints, and how joints follow others."""
        numbers_of = {body.name: k for k, body in enumerate(bodies)}
        numbers_of["world"] = _WORLD
        joints = {joint.name: joint for body in bodies for joint in body.joints}
        constraints, links = [], {}
        for section in self._document.sections("equality"):
            for element in section:
                attributes = self._document.attributes(element)
                if not attributes.truth("active", True):
                    continue
                if element.tag in ("connect", "weld"):
                    found = self._between(attributes, element.tag, numbers_of)
                elif element.tag == "joint":
                    found = self._coupled(attributes, joints, links)
                else:
                    found = Constraint(
                        kind=element.tag,
                        name=f"{attributes.what} of <equality>",
                        joints=tuple(joints),
                    )
                constraints += [found] if found else []
        return constraints, links

    def _between(self, attributes, kind, numbers_of):
        """Return a constraint between two bodies."""
        ends, words = [], []
        for k in "12":
            body, site = attributes.text(f"body{k}"), attributes.text(f"site{k}")
            known, name = (numbers_of, body) if site is None else (self._sites, site)
            if name is None and k == "2":
                name = "world"
            if name not in known:
                raise ValueError(
                    f"{attributes.what} of <equality> joins {name!r}, which is not in "
                    "the file"
                )
            ends.append(known[name])
            words.append(name)
        return Constraint(
            kind=kind,
            name=f"{attributes.what} of <equality>, between {' and '.join(words)},",
            bodies=tuple(ends),
        )

    def _coupled(self, attributes, joints, links):
        """Return the constraint of an equality of joints; a linear one is a link."""
        names = [attributes.text(f"joint{k}") for k in "12"]
        names = names[:1] if names[1] is None else names
        for name in names:
            if name not in joints:
                raise ValueError(
                    f"{attributes.what} of <equality> couples {name!r}, which is "
                    "not a joint"
                )
        given = attributes.numbers("polycoef", [0.0, 1.0, 0.0, 0.0, 0.0], least=1)
        if given.size > 5:
            raise ValueError(f"{attributes.what} of <equality> has six polycoef")
        poly = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
        poly[: given.size] = given
        linear = not poly[2:].any() and poly[1] != 0
        if len(names) == 2 and linear:
            own, leader = (joints[name] for name in names)
            if {own.kind, leader.kind} <= {"hinge", "slide"}:
                # Both count from where the file puts them.
                offset = float(poly[0] + own.ref - poly[1] * leader.ref)
                links[own.name] = Link(
                    leader=leader.name, multiplier=float(poly[1]), offset=offset
                )
                return None
        return Constraint(
            kind="joint",
            name=f"{attributes.what} of <equality>, which ties {' to '.join(names)},",
            joints=tuple(names),
        )

    def _beside(self):
        """Return what the file has beside bodies and joints."""
        document = self._document
        return Beside(
            tendons=[
                element.get("name") or element.tag
                for section in document.sections("tendon")
                for element in section
            ],
            n_actuators=sum(map(len, document.sections("actuator"))),
            weightless=self._weightless,
            nameless=self._nameless,
            unknown=self._unknown,
        )


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


def _scaled(bodies, total):
    """Scale the masses of bodies to a total [kg]."""
    own = sum(body.inertia.mass for body in bodies)
    if not own > 0:
        return bodies
    return tuple(
        replace(body, inertia=_times(body.inertia, total / own)) for body in bodies
    )


def _times(inertia, factor):
    """Scale a mass and its moments of inertia."""
    return import_pinocchio().Inertia(
        factor * inertia.mass, inertia.lever, factor * inertia.inertia
    )
