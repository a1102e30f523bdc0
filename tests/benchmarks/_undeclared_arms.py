"""Arms with six and seven joints, built in several ways, with drawn sizes and masses.

Nothing here uses the code of the package: what is judged must not make its own exam.
"""

from dataclasses import dataclass

import numpy as np

# Shares by which an arm's lengths and masses differ from those written here.
LENGTHS = (0.8, 1.25)
MASSES = (0.7, 1.4)
# Right angle; placements are given in quarter turns about x.
QUARTER = 0.5 * np.pi


@dataclass(frozen=True)
class Link:
    """A joint and what it carries, in metres and kilogrammes."""

    axis: object
    at: tuple
    mass: float
    along: tuple
    turn: float = 0.0


_UR = (
    Link("z", (0.0, 0.0, 0.09), 3.7, (0.0, 0.12, 0.0)),
    Link("y", (0.0, 0.136, 0.0), 8.4, (0.0, 0.0, 0.425)),
    Link("y", (0.0, -0.12, 0.425), 2.8, (0.0, 0.0, 0.39)),
    Link("y", (0.0, 0.0, 0.392), 1.6, (0.0, 0.1, 0.0)),
    Link("z", (0.0, 0.093, 0.0), 1.5, (0.0, 0.0, 0.1)),
    Link("y", (0.0, 0.0, 0.095), 0.9, (0.04, 0.1, 0.02)),
)
_ANTHROPOMORPHIC = (
    Link("z", (0.0, 0.0, 0.3), 4.0, (0.0, -0.05, 0.12)),
    Link("z", (0.0, 0.0, 0.0), 4.0, (0.0, -0.2, 0.06), turn=-1.0),
    Link("z", (0.0, -0.4, 0.0), 3.2, (0.05, 0.06, 0.12), turn=1.0),
    Link("z", (0.05, 0.0, 0.0), 2.8, (-0.05, 0.2, 0.05), turn=1.0),
    Link("z", (-0.05, 0.38, 0.0), 2.0, (0.0, 0.07, -0.1), turn=-1.0),
    Link("z", (0.0, 0.0, 0.0), 1.7, (0.08, -0.02, 0.05), turn=1.0),
    Link("z", (0.088, 0.0, 0.0), 1.0, (0.04, 0.04, 0.12), turn=1.0),
)
_STAUBLI = (
    Link("z", (0.0, 0.0, 0.32), 4.5, (0.03, 0.1, 0.0)),
    Link("y", (0.0, 0.035, 0.0), 7.0, (0.0, 0.1, 0.225)),
    Link("y", (0.0, 0.0, 0.225), 3.5, (0.0, -0.04, 0.1)),
    Link("z", (0.0, -0.035, 0.0), 2.0, (0.02, 0.0, 0.225)),
    Link("y", (0.0, 0.0, 0.225), 1.2, (0.0, 0.03, 0.07)),
    Link("z", (0.0, 0.0, 0.065), 0.8, (0.05, 0.02, 0.08)),
)
# An arm at the side of a trunk: the first axis is horizontal and the arm hangs.
_SHOULDER = (
    Link("y", (0.0, 0.2, 0.4), 2.5, (0.0, 0.1, 0.0)),
    Link("x", (0.0, 0.1, 0.0), 2.5, (0.03, 0.0, -0.12)),
    Link("z", (0.0, 0.0, -0.1), 2.5, (0.03, 0.02, -0.25)),
    Link("y", (0.0, 0.0, -0.25), 2.0, (0.0, 0.03, -0.12)),
    Link("z", (0.0, 0.0, -0.1), 1.6, (0.02, 0.0, -0.18)),
    Link("y", (0.0, 0.0, -0.18), 1.0, (0.03, 0.0, -0.06)),
    Link("x", (0.0, 0.0, -0.05), 1.0, (0.03, 0.05, -0.12)),
)
# Joints 3 and 5 turn about axes that are not those of their frames.
_SKEWED = (
    *_STAUBLI[:2],
    Link((0.2, 0.95, 0.24), (0.0, 0.0, 0.225), 3.5, (0.0, -0.04, 0.1)),
    _STAUBLI[3],
    Link((0.9, 0.1, 0.42), (0.0, 0.0, 0.225), 1.2, (0.0, 0.03, 0.07)),
    _STAUBLI[5],
)
# Links, and roll, pitch and yaw of the first joint's frame in the base [rad].
ARMS = {
    "ur": (_UR, (0.0, 0.0, 0.0)),
    "anthropomorphic": (_ANTHROPOMORPHIC, (0.0, 0.0, 0.0)),
    "staubli": (_STAUBLI, (0.0, 0.0, 0.0)),
    "on a wall": (_UR, (0.0, QUARTER, 0.0)),
    "shoulder": (_SHOULDER, (0.0, 0.0, 0.0)),
    "skewed": (_SKEWED, (0.3, 0.0, 0.5)),
}


def is_aligned(model, joint):
    """Whether a joint turns about an axis of its own frame; joints from zero."""
    return not model.joints[joint + 1].shortname().endswith("Unaligned")


def axes_across(model, joint):
    """Directions about which the axis of a joint can be wrong, in its frame, (2, 3)."""
    name = model.joints[joint + 1].shortname()
    if is_aligned(model, joint):
        return np.delete(np.eye(3), "XYZ".index(name[-1]), axis=0)
    axis = np.asarray(model.joints[joint + 1].extract().axis)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first)])


def _body(mass, along, rng):
    import pinocchio as pin

    along = np.asarray(along)
    length = np.linalg.norm(along)
    box = pin.Inertia.FromBox(mass, *rng.uniform(0.35, 0.7, size=2) * length, length)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    centre = 0.5 * along + rng.uniform(-0.15, 0.15, size=3) * length
    return pin.SE3(turn, centre).act(box)


def arm(name, rng):
    """Build an arm as its data sheet has it."""
    import pinocchio as pin

    links, base = ARMS[name]
    scale = rng.uniform(*LENGTHS)
    model, last = pin.Model(), 0
    for j, link in enumerate(links):
        angles = base if j == 0 else (QUARTER * link.turn, 0.0, 0.0)
        place = pin.SE3(pin.rpy.rpyToMatrix(*angles), scale * np.asarray(link.at))
        if isinstance(link.axis, str):
            joint = getattr(pin, f"JointModelR{link.axis.upper()}")()
        else:
            axis = np.asarray(link.axis)
            joint = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        last = model.addJoint(last, joint, place, f"joint_{j + 1}")
        body = _body(
            link.mass * rng.uniform(*MASSES), scale * np.asarray(link.along), rng
        )
        model.appendBodyToJoint(last, body, pin.SE3.Identity())
    return model
