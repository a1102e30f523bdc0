"""Robots with collision shapes, written as URDF."""

BALL = '<sphere radius="{0}"/>'
ROD = '<cylinder radius="{0}" length="{1}"/>'
BLOCK = '<box size="{0} {1} {2}"/>'
MESH = '<mesh filename="{0}" scale="{1} {1} {1}"/>'

# Corners of a cube of unit edge, and its faces.
CUBE = "\n".join(
    [f"v {x} {y} {z}" for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    + ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
)


def link(name, *shapes):
    """Link with (shape, xyz, rpy) as collision geometry."""
    collisions = "".join(
        f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry>'
        "</collision>"
        for shape, xyz, rpy in shapes
    )
    return (
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" '
        f'ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>{collisions}</link>'
    )


def joint(name, parent, child, *, xyz="0 0 0", axis="0 0 1", kind="revolute", to=3.0):
    """Joint with limits -to and to."""
    motion = f'<axis xyz="{axis}"/><limit lower="-{to}" upper="{to}" effort="9" '
    motion = "" if kind == "fixed" else motion + 'velocity="3"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}"/>{motion}</joint>'
    )


def write(folder, *parts):
    """Write a robot of links and joints; return the path of its URDF."""
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="shaped">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def two_bars(folder, *, base=0.3, tip=0.1, to=3.0):
    """Bars of 0.5 m and 0.4 m in a plane; a ball at the base and one at the tip."""
    return write(
        folder,
        link("base", (BALL.format(base), "0 0 0", "0 0 0")),
        link("upper"),
        link("lower", (BALL.format(tip), "0.4 0 0", "0 0 0")),
        joint("shoulder", "base", "upper", to=to),
        joint("elbow", "upper", "lower", xyz="0.5 0 0", to=to),
    )


def arm(folder, *, size=1.0, mesh=None):
    """Arm of six joints with blocks, rods, balls and, where given, a mesh."""

    def scaled(text):
        return " ".join(str(size * float(x)) for x in text.split())

    def block(*edges):
        return BLOCK.format(*(size * x for x in edges))

    def rod(radius, length):
        return ROD.format(size * radius, size * length)

    hand = BALL.format(size * 0.06) if mesh is None else MESH.format(mesh, size * 0.1)
    return write(
        folder,
        link("base", (rod(0.12, 0.2), scaled("0 0 0.1"), "0 0 0")),
        link("one", (block(0.15, 0.18, 0.2), scaled("0 0 0.1"), "0 0 0.2")),
        link("two", (rod(0.06, 0.5), scaled("0 0.12 0.25"), "0.05 0 0")),
        link("three", (block(0.1, 0.09, 0.45), scaled("0 0 0.2"), "0 0.03 0")),
        link("four", (rod(0.05, 0.12), scaled("0 0.05 0"), "1.57 0 0")),
        link(
            "five",
            (block(0.08, 0.1, 0.08), scaled("0 0 0.05"), "0.1 0 0"),
            (BALL.format(size * 0.05), scaled("0 0.06 0.05"), "0 0 0"),
        ),
        link("six"),
        link("hand", (hand, scaled("0 0 0.03"), "0.3 0.2 0.1")),
        joint("j1", "base", "one", xyz=scaled("0 0 0.22")),
        joint("j2", "one", "two", xyz=scaled("0 0.02 0.12"), axis="0 1 0"),
        joint("j3", "two", "three", xyz=scaled("0 0 0.5"), axis="0 1 0"),
        joint("j4", "three", "four", xyz=scaled("0 0 0.45"), axis="0 1 0"),
        joint("j5", "four", "five", xyz=scaled("0 0.1 0"), axis="0 0 1"),
        joint("j6", "five", "six", xyz=scaled("0 0 0.12"), axis="0.6 0 0.8"),
        joint("flange", "six", "hand", xyz=scaled("0 0 0.06"), kind="fixed"),
    )
