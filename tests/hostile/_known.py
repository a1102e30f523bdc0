"""Cases with a known result."""

import zipfile

import numpy as np

from tests.hostile._case import (
    URDF,
    Case,
    N,
    argv,
    clean_lines,
    clean_text,
    columns,
    csv_text,
)
from tests.hostile._mutations import FILES, matrices, npz


def _units(rng):
    heads, *rows = clean_lines()
    return "\n".join([heads, "s,rad,rad,Nm,Nm", *rows])


def _header_twice(rng):
    lines = clean_lines()
    return "\n".join([*lines[:500], lines[0], *lines[500:]])


def _commented(comment, encoding="utf-8"):
    return lambda rng: f"# {comment}\n{clean_text()}".encode(encoding)


def _replaced(*pairs):
    def text(rng):
        content = clean_text()
        for old, new in pairs:
            content = content.replace(old, new)
        return content

    return text


TEXTS = {
    "latin-1": (_commented("in °", "latin-1"), "same", "cp1252"),
    "decimal commas": (_replaced((",", ";"), (".", ",")), "same"),
    "row of units": (_units, "same"),
    "header twice": (_header_twice, "refused", "is not a number"),
    "last line cut": (lambda rng: clean_text()[:-12], "read", "the last line is cut"),
    "header only": (lambda rng: "t,q1,q2,tau1,tau2\n", "refused", "only a header"),
    "NUL": (lambda rng: clean_text()[:900] + "\0", "refused", "binary"),
    "long comment": (_commented("x" * 3_000_000), "same"),
    "escape codes": (lambda rng: "\x1b[31mt,q1,tau1\n1,2,3\n", "refused"),
}

TABLES = {
    "torques without signs": (
        lambda x, rng: x | {k: np.abs(x[k]) for k in ("tau1", "tau2")},
        "refused",
        "have one sign only",
    ),
    "Chinese name": (lambda x, rng: x | {"温度": x["q1"]}, "same"),
    "column of text": (lambda x, rng: x | {"mode": ["run"] * len(x["t"])}, "same"),
    "rows shuffled": (
        lambda x, rng: {
            k: v[np.random.default_rng(0).permutation(N)] for k, v in x.items()
        },
        "refused",
        "time runs backwards",
    ),
    "columns shuffled": (lambda x, rng: {k: x[k] for k in sorted(x)[::-1]}, "same"),
    "no torques": (
        lambda x, rng: {k: x[k] for k in ("t", "q1", "q2")},
        "refused",
        "no torques",
    ),
}

ARRAYS = {
    "big-endian": ({"q": lambda x: x.astype(">f8")}, "same"),
    "objects": ({"q": lambda x: x.astype(object)}, "refused", "allow_pickle"),
    "three axes": ({"q": lambda x: x[:, :, None]}, "refused", "no positions"),
}


def _laughs(levels):
    entities = ['<!ENTITY e0 "ha">']
    entities += [f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, levels)]
    head = f"<?xml version='1.0'?><!DOCTYPE robot [{''.join(entities)}]>"
    return head + URDF.replace('name="arm"', f'name="&e{levels - 1};"')


OUTSIDE = "<!DOCTYPE robot [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>"
ROBOTS = {
    "name with HTML": (
        lambda: URDF.replace('name="shoulder"', 'name="&lt;script&gt;"'),
        "same",
    ),
    "billion laughs": (lambda: _laughs(10), "refused"),
    "external entity": (
        lambda: OUTSIDE + URDF.replace('name="arm"', 'name="&a;"'),
        "refused",
    ),
    "nested": (lambda: "<robot>" + "<a>" * 100_000 + "</a>" * 100_000, "refused"),
    "many links": (
        lambda: URDF.replace(
            "</robot>",
            "".join(f'<link name="x{k}"/>' for k in range(2000)) + "</robot>",
        ),
        "refused",
    ),
    "heavy mass": (
        lambda: URDF.replace('value="3"', 'value="heavy"'),
        "refused",
        "mass",
    ),
}
QUICK = {"latin-1", "decimal commas", "header twice", "last line cut", "NUL"}
QUICK |= {"torques without signs", "rows shuffled", "objects"}
QUICK |= {"billion laughs", "external entity", "heavy mass", "name with HTML"}


def _bomb(n_bytes):
    """Write an archive of zeros compressed by a factor of 1000."""

    def build(folder, rng):
        shape = (n_bytes // 16, 2)
        text = str({"descr": "<f8", "fortran_order": False, "shape": shape})
        head = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
        zeros = bytes(1 << 24)
        with zipfile.ZipFile(
            folder / "arm.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1
        ) as archive:
            for name in ("q", "tau"):
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    member.write(head)
                    for _ in range(n_bytes // len(zeros)):
                        member.write(zeros)
        return argv("arm.npz", "--dt", "0.005")

    return build


def _rows_at_rest(n):
    def build(folder, rng):
        block = "0.1234567,-1.1234567,3.25,-0.75\n" * 10_000
        with (folder / "arm.csv").open("w") as file:
            file.write("q1,q2,tau1,tau2\n")
            for _ in range(n // 10_000):
                file.write(block)
        return argv("arm.csv", "--dt", "0.005")

    return build


def _wide(n):
    def build(folder, rng):
        names = ",".join(f"x{k}" for k in range(n))
        values = ",".join(["0.5"] * n)
        heads, *rows = clean_lines()
        lines = [f"{heads},{names}", *(f"{row},{values}" for row in rows[:100])]
        (folder / "arm.csv").write_text("\n".join(lines))
        return argv()

    return build


def _text(change):
    """Write text or bytes `change(rng)`."""

    def build(folder, rng):
        content = change(rng)
        content = content.encode() if isinstance(content, str) else content
        (folder / "arm.csv").write_bytes(content)
        return argv()

    return build


def _table(change):
    return _text(lambda rng: csv_text(change(columns(), rng)))


def _arrays(changes):
    def build(folder, rng):
        arrays = matrices()
        arrays |= {key: change(arrays[key]) for key, change in changes.items()}
        (folder / "arm.npz").write_bytes(npz(arrays))
        return argv("arm.npz")

    return build


def _robot(text):
    def build(folder, rng):
        (folder / "arm.urdf").write_text(text(), encoding="utf-8")
        (folder / "arm.csv").write_text(clean_text())
        return argv()

    return build


def _whole(name):
    def build(folder, rng):
        (folder / name).write_bytes(FILES[name]())
        return argv(name)

    return Case(name=f"whole: {name}", build=build, expect="same", slow=True)


def cases():
    """Return all cases."""
    found = [_whole(name) for name in FILES if name != "arm.urdf"]
    tables = (
        ("text", TEXTS, _text),
        ("table", TABLES, _table),
        ("npz", ARRAYS, _arrays),
        ("robot", ROBOTS, _robot),
    )
    for kind, changes, builder in tables:
        for name, (change, expect, *message) in changes.items():
            fields = {"expect": expect, "message": "".join(message)}
            fields |= {"build": builder(change), "slow": name not in QUICK}
            found.append(Case(name=f"{kind}: {name}", **fields))
    large = {
        "npz: bomb of 400 MB": (_bomb(400 << 20), "refused"),
        "text: 2,000 columns": (_wide(2000), "read"),
        "text: 200,000 columns": (_wide(200_000), "either"),
        "text: 10,000,000 rows at rest": (_rows_at_rest(10_000_000), "refused"),
    }
    for name, (build, expect) in large.items():
        found.append(Case(name=name, build=build, expect=expect, slow=True))
    return found
