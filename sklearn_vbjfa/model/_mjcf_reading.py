"""Reading MJCF with MuJoCo's compiler, as a tree of joints for Pinocchio.

Pinocchio's reader keeps one body below the world and ignores equality constraints. This
one keeps all bodies, in the order of MuJoCo's coordinates, and reports what it omits.
"""

import re

import numpy as np

from sklearn_vbjfa.model._trees import Closure, Description, Mimic, import_pinocchio

# Elements that need files or plugins, and do not affect the joints.
_UNUSED = ("actuators", "hfields", "keys", "materials", "sensors", "skins", "textures")
# Arrays of a compiled model that must be finite.
_FINITE = ("body_pos", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "qpos0")
_LOOP = "closes a loop, and only trees of joints can be identified"


def import_mujoco():
    """Import mujoco, or raise an error with the command that installs it."""
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
        _remove_unused(mujoco, spec)
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
    closures, mimics = _equalities(mujoco, model, names)
    tree = _tree(mujoco, model, names, motors)
    tree.name = name
    return Description(
        model=tree,
        label=repr(str(path)),
        mimics=mimics,
        closures=tuple(closures),
        left_out=tuple(_left_out(model, tree, n_actuators, nameless)),
    )


def _motors(mujoco, spec):
    """Return torque limits of joints with a single actuator, by name."""
    joint, limits = mujoco.mjtTrn.mjTRN_JOINT, {}
    for actuator in spec.actuators:
        ranges = [(actuator.forcelimited, actuator.forcerange, 1.0)]
        if not any(actuator.biasprm):
            # A motor; controls of servos are positions or velocities.
            ranges.append(
                (actuator.ctrllimited, actuator.ctrlrange, abs(actuator.gainprm[0]))
            )
        # Limits that are not declared (auto) apply if there is a range.
        limit = [
            k * min(-x[0], x[1]) for on, x, k in ranges if int(on) and x[0] < 0 < x[1]
        ]
        limit = abs(actuator.gear[0]) * min(limit, default=np.inf)
        if actuator.trntype == joint:
            limits.setdefault(actuator.target, []).append(limit)
    return {name: limit[0] for name, limit in limits.items() if len(limit) == 1}


def _remove_unused(mujoco, spec):
    """Remove elements that need files and do not contribute to masses."""
    mesh, kinds = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtInertiaFromGeom
    setting = spec.compiler.inertiafromgeom
    low, high = spec.compiler.inertiagrouprange
    used = set()
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
            spec.delete(geom)
        elif geom.type == mesh or geom.meshname:
            explicit = setting == kinds.mjINERTIAFROMGEOM_FALSE
            explicit |= (
                setting == kinds.mjINERTIAFROMGEOM_AUTO and geom.parent.explicitinertial
            )
            massless = geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0)
            if explicit or massless or not low <= geom.group <= high:
                spec.delete(geom)
            else:
                used.add(geom.meshname)
    for element in list(spec.meshes):
        if element.name not in used:
            spec.delete(element)
    for kind in _UNUSED:
        for element in list(getattr(spec, kind)):
            spec.delete(element)


def _left_out(model, tree, n_actuators, nameless):
    """Yield messages about contents of the file that are not modelled."""
    contents = {
        "springs": model.jnt_stiffness.any(),
        "damping": model.dof_damping.any(),
        "dry friction": model.dof_frictionloss.any(),
        "tendons": model.ntendon,
        "forces of a fluid": model.opt.density or model.opt.viscosity,
        "compensation of gravity (gravcomp)": model.body_gravcomp.any(),
        "actuators": n_actuators,
    }
    words = [word for word, present in contents.items() if present]
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
    """Build a Pinocchio model of all bodies and joints, in MuJoCo's order."""
    pin = import_pinocchio()
    tree = pin.Model()
    gravity = tree.gravity.copy()
    has_gravity = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity.linear = has_gravity * model.opt.gravity
    tree.gravity = gravity
    # For each body: its joint, the frame of that joint, and the placement in it.
    bodies = [(0, 0, pin.SE3.Identity())]
    for k in range(1, model.nbody):
        joint, frame, placement = bodies[model.body_parentid[k]]
        placement = placement * _placement(model.body_pos[k], model.body_quat[k])
        first = model.body_jntadr[k]
        for j in range(first, first + model.body_jntnum[k]):
            # At zero, the axes of the joint are parallel to those of the body.
            origin = placement * _at_zero(mujoco, model, j)
            joint = tree.addJoint(
                joint,
                _joint(mujoco, model, j),
                origin,
                names["joint"][j],
                *_limits(model, j, motors),
            )
            tree.armature[tree.idx_vs[joint]] = model.dof_armature[model.jnt_dofadr[j]]
            frame = tree.addJointFrame(joint, frame)
            placement = pin.SE3(np.eye(3), model.jnt_pos[j]).inverse()
        com = _placement(model.body_ipos[k], model.body_iquat[k])
        moments = com.rotation @ np.diag(model.body_inertia[k]) @ com.rotation.T
        inertia = pin.Inertia(float(model.body_mass[k]), com.translation, moments)
        if inertia.mass > 0 or inertia.inertia.any():
            tree.appendBodyToJoint(joint, inertia, placement)
        tree.addBodyFrame(names["body"][k], joint, placement, frame)
        bodies.append((joint, frame, placement))
    return tree


def _joint(mujoco, model, j):
    """Return Pinocchio's joint, an aligned one if its axis is a coordinate axis."""
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
    """Return the placement of a joint at zero in its body, pinocchio.SE3."""
    # The file describes the body with the joint at `ref`.
    pin, kinds = import_pinocchio(), mujoco.mjtJoint
    rotation, anchor = np.eye(3), model.jnt_pos[j]
    displacement = -model.qpos0[model.jnt_qposadr[j]] * model.jnt_axis[j]
    if model.jnt_type[j] == kinds.mjJNT_SLIDE:
        anchor = anchor + displacement
    elif model.jnt_type[j] == kinds.mjJNT_HINGE:
        rotation = pin.exp3(displacement)
    return pin.SE3(rotation, anchor)


def _limits(model, j, motors):
    """Return the limits of a joint as arguments of Pinocchio's `addJoint`."""
    if model.jnt_type[j] < 2:
        return ()
    low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
    effort = motors.get(model.joint(j).name, np.inf)
    if model.jnt_actfrclimited[j] and model.jnt_actfrcrange[j, 0] < 0:
        effort = min(effort, np.abs(model.jnt_actfrcrange[j]).min() or np.inf)
    return tuple(np.array([x]) for x in (effort, np.inf, low, high))


def _names(model):
    """Return names of bodies and joints, and which joint names are generated."""
    bodies = _fill_names(
        [model.body(k).name for k in range(model.nbody)],
        [f"body_{k}" for k in range(model.nbody)],
    )
    first = model.body_jntadr
    defaults = [
        f"{bodies[body]}_joint{f'_{j - first[body] + 1}' if j > first[body] else ''}"
        for j, body in enumerate(model.jnt_bodyid)
    ]
    joint_names = [model.joint(j).name for j in range(model.njnt)]
    joints = _fill_names(joint_names, defaults)
    generated = tuple(joint for joint, name in zip(joints, joint_names) if not name)
    return {"body": bodies, "joint": joints}, generated


def _fill_names(names, defaults):
    taken, filled = set(names), []
    for name, default in zip(names, defaults):
        while not name and default in taken:
            default = f"{default}_"
        taken.add(name or default)
        filled.append(name or default)
    return filled


def _placement(position, quaternion):
    """Return pinocchio.SE3 of a position and a quaternion w, x, y, z."""
    pin = import_pinocchio()
    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), position)


def _equalities(mujoco, model, names):
    """Return loop closures, a list of `Closure`, and followers, name -> `Mimic`."""
    closures, mimics = [], {}
    bodies = [None, *names["body"][1:]]
    for k in np.flatnonzero(model.eq_active0):
        kind = mujoco.mjtEq(int(model.eq_type[k])).name[5:].lower()
        ids = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        name = model.eq(k).name
        label = (
            f"<{kind}> {name!r} of <equality>" if name else f"<{kind}> of <equality>"
        )
        if kind in ("connect", "weld"):
            if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                ids = [int(model.site_bodyid[i]) for i in ids]
            words = " and ".join(names["body"][i] for i in ids)
            message = f"{label}, between {words}, {_LOOP}"
            closures.append(Closure(message, bodies=tuple(bodies[i] for i in ids)))
        elif kind == "joint":
            ids = [i for i in ids if i >= 0]
            joints = tuple(names["joint"][i] for i in ids)
            offset, rate, *higher = model.eq_data[k, :5]
            if len(ids) == 2 and rate != 0 and not any(higher):
                # Both positions are relative to those in the file.
                follower, leader = model.qpos0[model.jnt_qposadr[ids]]
                mimics[joints[0]] = Mimic(
                    leader=joints[1],
                    multiplier=float(rate),
                    offset=float(offset + follower - rate * leader),
                )
                continue
            reason = (
                "locks a joint (take the joint or the constraint out of the file)"
                if len(ids) == 1
                else "is not linear in the other joint's position (only a polycoef of "
                "the form o k 0 0 0 is)"
            )
            message = f"{label}, which ties {' to '.join(joints)}, {reason}"
            closures.append(Closure(message, joints=joints))
        else:
            message = (
                f"{label} is a constraint of the kind {kind!r}, which is not modelled"
            )
            closures.append(Closure(message, joints=tuple(names["joint"])))
    return closures, mimics
