"""A made-up robot with two legs on a base that is free: MJCF, URDF, and a model."""

JOINTS = ("L_hip", "L_thigh", "L_calf", "R_hip", "R_thigh", "R_calf")
# Each link: joint, place, axis, mass, centre of mass.
_LEG = (
    ("hip", "0 {side}0.05 0", "1 0 0", 0.7, "0.01 {side}0.02 0"),
    ("thigh", "0.01 {side}0.1 0", "0 1 0", 1.2, "0 {side}0.01 -0.05"),
    ("calf", "0 0 -0.2", "0 1 0", 0.3, "0.01 0 -0.12"),
)
_MOMENTS = (2e-3, 3e-3, 1.5e-3)


def _legs(open_link, close_link):
    """Text of both legs, links inside each other."""
    text = ""
    for name, side in (("L", ""), ("R", "-")):
        for joint, place, axis, mass, centre in _LEG:
            text += open_link.format(
                name=f"{name}_{joint}",
                place=place.format(side=side),
                axis=axis,
                mass=mass,
                centre=centre.format(side=side),
            )
        text += 3 * close_link
    return text


def legs_mjcf(quat="1 0 0 0", more="", base='<freejoint name="root"/>'):
    """Text of an MJCF file; more : bodies beside the robot."""
    moments = " ".join(map(str, _MOMENTS))
    legs = _legs(
        '<body name="{name}_link" pos="{place}">'
        '<joint name="{name}" axis="{axis}" range="-2 2"/>'
        f'<inertial pos="{{centre}}" mass="{{mass}}" diaginertia="{moments}"/>',
        "</body>",
    )
    return (
        '<mujoco model="legs"><compiler angle="radian"/><worldbody>'
        f'<body name="base" pos="0 0 0.4" quat="{quat}">{base}'
        '<inertial pos="0.02 0 0" mass="6" diaginertia="0.1 0.1 0.03"/>'
        f"{legs}</body>{more}</worldbody></mujoco>"
    )


def legs_urdf(rpy="0 0 0", kind="floating", mount="0 0 0"):
    """Text of a URDF; kind None leaves the base as the root; mount : of the world."""
    xx, yy, zz = _MOMENTS
    base = (
        '<link name="base"><inertial><origin xyz="0.02 0 0"/><mass value="6"/><inertia '
        'ixx="0.1" iyy="0.1" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    if kind is not None:
        base += (
            '<link name="world"/><link name="stand"/>'
            '<joint name="mount" type="fixed"><parent link="world"/>'
            f'<child link="stand"/><origin rpy="{mount}"/></joint>'
            f'<joint name="root" type="{kind}"><parent link="stand"/>'
            f'<child link="base"/><origin xyz="0 0 0.4" rpy="{rpy}"/></joint>'
        )
    for name, side in (("L", ""), ("R", "-")):
        parent = "base"
        for joint, place, axis, mass, centre in _LEG:
            link = f"{name}_{joint}_link"
            base += (
                f'<joint name="{name}_{joint}" type="revolute">'
                f'<parent link="{parent}"/><child link="{link}"/>'
                f'<origin xyz="{place.format(side=side)}"/><axis xyz="{axis}"/>'
                '<limit lower="-2" upper="2" effort="20" velocity="20"/></joint>'
                f'<link name="{link}"><inertial>'
                f'<origin xyz="{centre.format(side=side)}"/><mass value="{mass}"/>'
                f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'
                "</inertial></link>"
            )
            parent = link
    return f'<robot name="legs">{base}</robot>'


def legs_model():
    """Pinocchio model with a free joint at the root."""
    import pinocchio as pin

    return pin.buildModelFromXML(legs_urdf(kind=None), pin.JointModelFreeFlyer())
