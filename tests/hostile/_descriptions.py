"""Descriptions of robots: damaged, impossible and hostile."""

from tests.hostile._case import URDF, Case, argv, clean_text

_INERTIA = '<inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>'
_HAND = """
<link name="hand">{inertial}</link>
<joint name="{name}" type="{kind}"><parent link="lower"/><child link="hand"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{more}</joint>
"""


def _case(name, text, expect="either", message="", *, options=(), slow=False):
    """Return a case of the recording without fault and this description."""

    def build(folder, rng):
        content = text(rng) if callable(text) else text
        if isinstance(content, str):
            content = content.encode("utf-8", "surrogatepass")
        (folder / "arm.urdf").write_bytes(content)
        (folder / "arm.csv").write_text(clean_text())
        return argv("arm.csv", *options)

    return Case(name=f"robot: {name}", build=build, expect=expect, message=message)


def _with(old, new, count=1):
    assert old in URDF, old
    return URDF.replace(old, new, count)


def _plus(more):
    return URDF.replace("</robot>", more + "</robot>")


def _hand(kind, *, name="grip", more="", inertial=""):
    return _plus(_HAND.format(kind=kind, name=name, more=more, inertial=inertial))


def _deep(n):
    return "<robot>" + "<a>" * n + "</a>" * n + "</robot>"


def _laughs(levels):
    entities = ['<!ENTITY e0 "ha">']
    for k in range(1, levels):
        value = f"&e{k - 1};" * 10
        entities.append(f'<!ENTITY e{k} "{value}">')
    head = f"<?xml version='1.0'?><!DOCTYPE robot [{''.join(entities)}]>"
    return head + _with('name="arm"', f'name="&e{levels - 1};"')


def _chain(n):
    links = "".join(
        f'<link name="l{k}"><inertial><mass value="1"/>{_INERTIA}</inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/>'
        f'<child link="l{k}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for k in range(1, n)
    )
    return f'<robot name="chain"><link name="l0"/>{links}</robot>'


def _flipped(rng):
    content = bytearray(URDF.encode())
    for at in rng.integers(len(content), size=rng.integers(1, 4)):
        content[at] = rng.integers(256)
    return bytes(content)


def cases():
    """Return all cases of descriptions."""
    found = []

    def add(name, text, *rest, **options):
        found.append(_case(name, text, *rest, **options))

    for k in range(15):
        add(f"truncated {k}", lambda rng: URDF[: rng.integers(len(URDF))], "refused")
    for k in range(15):
        add(f"flipped bytes {k}", _flipped)
    add("empty", "", "refused")
    add("blank", "\n\n", "refused")
    add("not XML", "robot: arm", "refused", "not readable as URDF")
    add("binary", lambda rng: rng.bytes(4000), "refused", "not readable as URDF")
    add("html", "<html><body/></html>", "refused")
    add("sdf", '<sdf version="1.7"><model name="arm"/></sdf>', "refused")
    add("no links", '<robot name="arm"/>', "refused")
    add("one link", '<robot name="arm"><link name="a"/></robot>', "refused", "joint")
    add("two roots", URDF + URDF, "refused", "not readable as URDF")
    xacro = _with("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ')
    add("namespace", xacro, "same")
    add("xacro", _with('value="3"', 'value="${mass}"'), "refused", "mass|xacro")
    add("default namespace", _with("<robot ", '<robot xmlns="urn:a" '), "refused")
    add("UTF-16", URDF.encode("utf-16"))
    latin = '<?xml version="1.0" encoding="latin-1"?>' + _with("shoulder", "sch\xfc")
    add("latin-1", latin.encode("latin-1"), "same")
    add("unknown encoding", '<?xml version="1.0" encoding="x-y"?>' + URDF, "refused")
    add("wrong encoding", '<?xml version="1.0" encoding="utf-16"?>' + URDF, "refused")
    add("surrogates", _with("shoulder", "\ud800"), "refused")
    add("Unicode names", _with("shoulder", "肩関節"), "same")
    add("names with blanks", _with('name="shoulder"', 'name="left shoulder"'), "same")
    add("name with a comma", _with('name="shoulder"', 'name="a,b"'), "same")
    add("name with a line end", _with('name="shoulder"', 'name="a&#10;b"'))
    add("name with a path", _with('name="shoulder"', 'name="../../a"'), "same")
    add("name with HTML", _with('name="shoulder"', 'name="&lt;script&gt;"'), "same")
    add("long name", _with('name="shoulder"', f'name="{"x" * 100_000}"'))
    add("empty name", _with('name="shoulder"', 'name=""'))
    add("no name", _with('name="shoulder"', ""), "refused")
    add("no robot name", _with(' name="arm"', ""), "refused")

    for depth in (50, 1000, 20_000, 100_000):
        add(f"nested {depth}", _deep(depth), "refused")
    outer = '<visual><origin xyz="0 0 0"/>' * 5000 + "</visual>" * 5000
    add(
        "nested in a link",
        _with('<link name="base"/>', f'<link name="base">{outer}</link>'),
    )
    add("entities", _laughs(3), "refused")
    add("billion laughs", _laughs(10), "refused")
    big = "<!DOCTYPE robot [<!ENTITY a '" + "x" * 100_000 + "'>]>"
    quadratic = big + _with('name="arm"', f'name="{"&a;" * 20_000}"')
    add("quadratic entities", quadratic, "refused")
    outside = "<!DOCTYPE robot [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>"
    add("external entity", outside + _with('name="arm"', 'name="&a;"'), "refused")
    add("external entity in text", outside + _plus("<x>&a;</x>"), "refused")
    remote = "<!DOCTYPE robot SYSTEM 'http://192.0.2.1/robot.dtd'>"
    add("external DTD", remote + URDF)
    add(
        "many attributes",
        _with("<robot ", "<robot " + "".join(f'a{k}="" ' for k in range(50_000))),
    )
    add("many comments", _plus("<!-- x -->" * 100_000), "same")
    add(
        "many links",
        _plus("".join(f'<link name="x{k}"/>' for k in range(2000))),
        "refused",
    )

    add(
        "axis zero",
        _with('axis xyz="0 1 0"', 'axis xyz="0 0 0"'),
        "refused",
        "shoulder",
    )
    add("axis nan", _with('axis xyz="0 1 0"', 'axis xyz="nan 1 0"'), "refused")
    add("axis infinite", _with('axis xyz="0 1 0"', 'axis xyz="inf 1 0"'), "refused")
    add("axis of two", _with('axis xyz="0 1 0"', 'axis xyz="0 1"'), "refused")
    add("axis words", _with('axis xyz="0 1 0"', 'axis xyz="a b c"'), "refused")
    add("axis long", _with('axis xyz="0 1 0"', 'axis xyz="0 7 0"'), "same")
    add("axis tiny", _with('axis xyz="0 1 0"', 'axis xyz="0 1e-300 0"'))
    add("axis missing", _with('<axis xyz="0 1 0"/>', ""))
    add("origin nan", _with('origin xyz="0.4', 'origin xyz="nan'), "refused")
    add("origin infinite", _with('origin xyz="0.4', 'origin xyz="inf'), "refused")
    add("origin huge", _with('origin xyz="0.4', 'origin xyz="1e300'))
    add(
        "rpy nan",
        _with('origin xyz="0.4 0 0"', 'origin xyz="0 0 0" rpy="nan 0 0"'),
        "refused",
    )
    for value in ("nan", "inf", "-3", "heavy", "", "1e400", "-1e-9"):
        add(
            f"mass {value}",
            _with('mass value="3"', f'mass value="{value}"'),
            "refused",
            "mass",
        )
    for value in ("0", "1e300", "1e-300"):
        add(f"mass {value}", _with('mass value="3"', f'mass value="{value}"'))
    for value in ("nan", "inf", "1e400", "x", ""):
        add(f"inertia {value}", _with('ixx="0.01"', f'ixx="{value}"'), "refused")
    for value in ("-1", "1e300", "0"):
        add(f"inertia {value}", _with('ixx="0.01"', f'ixx="{value}"'))
    add("inertia missing", _with(_INERTIA, ""))
    add(
        "no inertial",
        _with(URDF[URDF.index("<inertial>") : URDF.index("</inertial>") + 11], ""),
    )
    add("centre nan", _with('xyz="0.2', 'xyz="nan'), "refused")

    for kind in (
        "floating",
        "planar",
        "spherical",
        "ball",
        "",
        "REVOLUTE",
        "universal",
    ):
        add(f"joint {kind}", _hand(kind), "refused")
        held = ("--joints", "shoulder,elbow")
        add(f"joint {kind} held", _hand(kind), "either", options=held)
    add("first joint of no type", _with('type="revolute"', ""), "refused")
    add("fixed", _hand("fixed"), "same")
    add(
        "all fixed", _with('type="revolute"', 'type="fixed"', 2), "refused", "no moving"
    )
    # It follows without a column of its own.
    add("mimic", _hand("revolute", more='<mimic joint="elbow"/>'), "read")
    two = _with('<limit lower="-3"', '<mimic joint="shoulder"/><limit lower="-3"', 2)
    add("mimic itself", two)
    add(
        "mimic nobody",
        _with('<limit lower="-3"', '<mimic joint="x"/><limit lower="-3"'),
    )
    add("limits reversed", _with('lower="-3" upper="3"', 'lower="3" upper="-3"'))
    add("limits nan", _with('upper="3"', 'upper="nan"'))
    add("velocity zero", _with('velocity="10"', 'velocity="0"', 2), "same")
    add("velocity nan", _with('velocity="10"', 'velocity="nan"', 2))
    add("velocity missing", _with(' velocity="10"', "", 2))
    add(
        "no limit",
        _with('<limit lower="-3" upper="3" effort="100" velocity="10"/>', ""),
    )
    add("link twice", _plus('<link name="upper"/>'), "refused")
    add("joint twice", _hand("revolute", name="elbow"), "refused")
    add(
        "two parents",
        _plus(
            '<joint name="x" type="fixed">'
            '<parent link="base"/><child link="lower"/></joint>'
        ),
        "refused",
    )
    add("cycle", _with('<parent link="base"/>', '<parent link="lower"/>'), "refused")
    add(
        "own parent",
        _with('<parent link="base"/>', '<parent link="upper"/>'),
        "refused",
    )
    add("no parent", _with('<parent link="base"/>', ""), "refused")
    add("no child", _with('<child link="upper"/>', ""), "refused")
    add(
        "parent unknown",
        _with('<parent link="base"/>', '<parent link="x"/>'),
        "refused",
    )
    add("two trees", _plus('<link name="island"/>'))
    mesh = (
        '<visual><geometry><mesh filename="package://none/a.stl"/></geometry></visual>'
    )
    add(
        "mesh missing",
        _with('<link name="base"/>', f'<link name="base">{mesh}</link>'),
        "same",
    )
    sphere = '<visual><geometry><sphere radius="x"/></geometry></visual>'
    add(
        "bad geometry",
        _with('<link name="base"/>', f'<link name="base">{sphere}</link>'),
    )
    add("60 joints", _chain(61), "refused", "column")
    add("2,000 joints", _chain(2001), "refused")
    add("transmission", _plus('<transmission name="t"/><gazebo/>'), "same")
    for names in ("shoulder", "elbow,shoulder", "shoulder,elbow", "hip,knee", "", ","):
        add(f"--joints {names!r}", URDF, options=("--joints", names))
    return found
