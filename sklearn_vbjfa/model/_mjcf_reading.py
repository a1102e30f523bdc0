"""Reading MJCF by MuJoCo's own compiler, as a tree of joints for Pinocchio.

Pinocchio's reader keeps one body below the world and takes no
notice of equality constraints. This one keeps all bodies, in the order of MuJoCo's
coordinates, and names what it cannot keep.
"""

import re

import numpy as np

from sklearn_vbjfa.model._trees import Closure, Description, Link, import_pinocchio

# Elements that need files or plugins, and that joints have no use for.
_UNUSED = ("actuators", "hfields", "keys", "materials", "sensors", "skins", "textures")
# What of a compiled model must be finite.
_FINITE = ("body_pos", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "qpos0")
_LOOP = "closes a loop, and only trees of joints can be identified"


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


def read_mjcf(path, name):
    """Read all bodies and joints of an MJCF file."""
    mujoco = import_mujoco()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        n_actuators, motors = len(spec.actuators), _motors(mujoco, spec)
        _drop_what_is_not_read(mujoco, spec)
        model = spec.compile()
        for key in _FINITE:
            if not np.isfinite(getattr(model, key)).all():
                raise ValueError(f"{key} has a number that is not finite")
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        words = re.sub(r"(XML )?Error: |,? line \d+", " ", str(error))
        raise ValueError(
            f"{str(path)!r} is not readable as MJCF: {' '.join(words.split())}; "
            "correct the description."
        ) from error
    names, nameless = _names(model)
    closures, links = _equalities(mujoco, model, names)
    tree = _tree(mujoco, model, names, motors)
    tree.name = name
    return Description(
        model=tree,
        called=repr(str(path)),
        links=links,
        closures=tuple(closures),
        left_out=tuple(_left_out(model, tree, n_actuators, nameless)),
    )


def _motors(mujoco, spec):
    """Return the largest torques of joints that a single actuator moves, by name."""
    joint, found = mujoco.mjtTrn.mjTRN_JOINT, {}
    for one in spec.actuators:
        ends = [(one.forcelimited, one.forcerange, 1.0)]
        if not any(one.biasprm):
            # Of a motor, not of a servo, whose controls are positions or velocities.
            ends.append((one.ctrllimited, one.ctrlrange, abs(one.gainprm[0])))
        # Limits that are not declared hold where there is a range.
        most = [
            k * min(-x[0], x[1]) for on, x, k in ends if int(on) and x[0] < 0 < x[1]
        ]
        most = abs(one.gear[0]) * min(most, default=np.inf)
        if one.trntype == joint:
            found.setdefault(one.target, []).append(most)
    return {name: most[0] for name, most in found.items() if len(most) == 1}


def _drop_what_is_not_read(mujoco, spec):
    """Take out what needs files and has no part in the masses."""
    mesh, kinds = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtInertiaFromGeom
    how = spec.compiler.inertiafromgeom
    low, high = spec.compiler.inertiagrouprange
    used = set()
    for geom in list(spec.geoms):
        geom.material = ""
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
    for kind in _UNUSED:
        for one in list(getattr(spec, kind)):
            spec.delete(one)


def _left_out(model, tree, n_actuators, nameless):
    """Sentences on what is in the file and does not enter the model."""
    there = {
        "springs": model.jnt_stiffness.any(),
        "damping": model.dof_damping.any(),
        "dry friction": model.dof_frictionloss.any(),
        "tendons": model.ntendon,
        "forces of a fluid": model.opt.density or model.opt.viscosity,
        "compensation of gravity (gravcomp)": model.body_gravcomp.any(),
        "actuators": n_actuators,
    }
    words = [word for word, found in there.items() if found]
    if words:
        yield (
            f"not taken over (simulated by MuJoCo only): {', '.join(words)} (friction "
            "and effects identify what the recording shows of it)"
        )
    if not tree.gravity.linear.any():
        yield "there is no gravity in it (option), and so none in the model"
    if nameless:
        yield f"joints without a name are called {', '.join(nameless)}"


def _tree(mujoco, model, names, motors):
    """Build Pinocchio's model of all bodies and joints, in MuJoCo's order."""
    pin = import_pinocchio()
    made = pin.Model()
    gravity = made.gravity.copy()
    falls = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity.linear = falls * model.opt.gravity
    made.gravity = gravity
    # Of a body: the joint that moves it, that joint's frame, and its place there.
    places = [(0, 0, pin.SE3.Identity())]
    for k in range(1, model.nbody):
        at, frame, place = places[model.body_parentid[k]]
        place = place * _placement(model.body_pos[k], model.body_quat[k])
        first = model.body_jntadr[k]
        for j in range(first, first + model.body_jntnum[k]):
            # With its axes parallel to the body's where the joint is at zero.
            zero = place * _at_zero(mujoco, model, j)
            at = made.addJoint(
                at,
                _joint(mujoco, model, j),
                zero,
                names["joint"][j],
                *_limits(model, j, motors),
            )
            dof = made.idx_vs[at]
            made.armature[dof] = model.dof_armature[model.jnt_dofadr[j]]
            frame = made.addJointFrame(at, frame)
            place = pin.SE3(np.eye(3), model.jnt_pos[j]).inverse()
        placed = _placement(model.body_ipos[k], model.body_iquat[k])
        turned = placed.rotation @ np.diag(model.body_inertia[k]) @ placed.rotation.T
        mass = float(model.body_mass[k])
        inertia = pin.Inertia(mass, placed.translation, turned)
        if inertia.mass > 0 or inertia.inertia.any():
            made.appendBodyToJoint(at, inertia, place)
        made.addBodyFrame(names["body"][k], at, place, frame)
        places.append((at, frame, place))
    return made


def _joint(mujoco, model, j):
    """Return Pinocchio's joint, an aligned one where its axis is one."""
    pin, kinds = import_pinocchio(), mujoco.mjtJoint
    if model.jnt_type[j] == kinds.mjJNT_FREE:
        return pin.JointModelFreeFlyer()
    if model.jnt_type[j] == kinds.mjJNT_BALL:
        return pin.JointModelSpherical()
    slides = model.jnt_type[j] == kinds.mjJNT_SLIDE
    for letter, axis in zip("XYZ", np.eye(3)):
        if (model.jnt_axis[j] == axis).all():
            return getattr(pin, f"JointModel{'P' if slides else 'R'}{letter}")()
    long = "Prismatic" if slides else "Revolute"
    return getattr(pin, f"JointModel{long}Unaligned")(model.jnt_axis[j])


def _at_zero(mujoco, model, j):
    """Place of a joint in its body where it is at zero, pinocchio.SE3."""
    # The body is described with the joint at `ref`.
    pin, kinds = import_pinocchio(), mujoco.mjtJoint
    turn, anchor = np.eye(3), model.jnt_pos[j]
    way = -model.qpos0[model.jnt_qposadr[j]] * model.jnt_axis[j]
    if model.jnt_type[j] == kinds.mjJNT_SLIDE:
        anchor = anchor + way
    elif model.jnt_type[j] == kinds.mjJNT_HINGE:
        turn = pin.exp3(way)
    return pin.SE3(turn, anchor)


def _limits(model, j, motors):
    """Limits of a joint of one degree of freedom, as Pinocchio adds them."""
    if model.jnt_type[j] < 2:
        return ()
    low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
    most = motors.get(model.joint(j).name, np.inf)
    if model.jnt_actfrclimited[j] and model.jnt_actfrcrange[j, 0] < 0:
        most = min(most, np.abs(model.jnt_actfrcrange[j]).min() or np.inf)
    return tuple(np.array([x]) for x in (most, np.inf, low, high))


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


def _placement(place, turn):
    """Return pinocchio.SE3 of a position and a quaternion w, x, y, z."""
    pin = import_pinocchio()
    w, x, y, z = turn
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), place)


def _equalities(mujoco, model, names):
    """Return what closes loops, a list of `Closure`, and how joints follow others."""
    closures, links = [], {}
    bodies = [None, *names["body"][1:]]
    for k in np.flatnonzero(model.eq_active0):
        kind = mujoco.mjtEq(int(model.eq_type[k])).name[5:].lower()
        ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        name = model.eq(k).name
        called = (
            f"<{kind}> {name!r} of <equality>" if name else f"<{kind}> of <equality>"
        )
        if kind in ("connect", "weld"):
            if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                ends = [int(model.site_bodyid[at]) for at in ends]
            words = " and ".join(names["body"][at] for at in ends)
            said = f"{called}, between {words}, {_LOOP}"
            closures.append(Closure(said, bodies=tuple(bodies[at] for at in ends)))
        elif kind == "joint":
            ends = [at for at in ends if at >= 0]
            tied = tuple(names["joint"][at] for at in ends)
            offset, rate, *bent = model.eq_data[k, :5]
            if len(ends) == 2 and rate != 0 and not any(bent):
                # Both count from where the file puts them.
                here, leader = model.qpos0[model.jnt_qposadr[ends]]
                links[tied[0]] = Link(
                    leader=tied[1],
                    multiplier=float(rate),
                    offset=float(offset + here - rate * leader),
                )
                continue
            why = (
                "locks a joint (take the joint or the constraint out of the file)"
                if len(ends) == 1
                else "is not linear in the other joint's position (only a polycoef of "
                "the form o k 0 0 0 is)"
            )
            said = f"{called}, which ties {' to '.join(tied)}, {why}"
            closures.append(Closure(said, joints=tied))
        else:
            said = (
                f"{called} is a constraint of the kind {kind!r}, which is not modelled"
            )
            closures.append(Closure(said, joints=tuple(names["joint"])))
    return closures, links
