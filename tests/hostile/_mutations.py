"""Random mutations of files, descriptions, columns, time stamps and options."""

import gzip
import io
import json
import re
import xml.etree.ElementTree as ElementTree
from functools import cache

import numpy as np

from tests.hostile._case import DT, URDF, Case, argv, cells, clean_text, columns

# Replacements of cells, of attributes, or of values of options.
WORDS = ("nan", "inf", "-1", "0", "1e400", "1e300", "1e-300", "", "x", "1,5", "१२")
WORDS += ("9" * 400, "#DIV/0!", "0x1F", "=A1", "\u200b", '"', "-", "../../a", "<b>")

# -- valid files ---------------------------------------------------------------------


def matrices():
    """Return t (n,), q (n, 2) and tau (n, 2) of the valid recording."""
    table = columns()
    q = np.column_stack([table["q1"], table["q2"]])
    return {
        "t": table["t"],
        "q": q,
        "tau": np.column_stack([table["tau1"], table["tau2"]]),
    }


def npz(arrays, save=np.savez):
    """Return the bytes of an archive of arrays."""
    stream = io.BytesIO()
    save(stream, **arrays)
    return stream.getvalue()


def _mat():
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, matrices(), do_compression=True)
    return stream.getvalue()


def _xlsx():
    from openpyxl import Workbook

    book = Workbook()
    for k, row in enumerate(cells(columns())):
        book.active.append(row if k == 0 else [float(x) for x in row])
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _parquet():
    import pyarrow
    from pyarrow import parquet

    stream = io.BytesIO()
    parquet.write_table(pyarrow.table(columns()), stream)
    return stream.getvalue()


def _json():
    return json.dumps({name: x.tolist() for name, x in matrices().items()}).encode()


def _json_lines():
    heads, *rows = cells(columns())
    rows = [dict(zip(heads, map(float, row))) for row in rows]
    return "\n".join(map(json.dumps, rows)).encode()


@cache
def _bag(plugin):
    import tempfile
    from pathlib import Path

    from tests.recording._bags import states, write_ros2

    table, joints = matrices(), ("shoulder", "elbow")
    written = states(table["t"], joints, table["q"], table["tau"])
    with tempfile.TemporaryDirectory() as folder:
        return write_ros2(Path(folder) / "bag", [written], plugin).read_bytes()


FILES = {
    "arm.csv": lambda: clean_text().encode(),
    "arm.csv.gz": lambda: gzip.compress(clean_text().encode(), 1, mtime=0),
    "arm.json": _json,
    "arm.jsonl": _json_lines,
    "arm.npz": lambda: npz(matrices(), np.savez_compressed),
    "arm.mat": _mat,
    "arm.xlsx": _xlsx,
    "arm.parquet": _parquet,
    "arm.mcap": lambda: _bag("MCAP"),
    "arm.db3": lambda: _bag("SQLITE3"),
    "arm.urdf": URDF.encode,
}

# -- mutations of bytes ----------------------------------------------------------------


def _truncated(content, rng):
    return content[: rng.integers(len(content))]


def _flipped(content, rng):
    changed = bytearray(content)
    for at in rng.integers(len(content), size=rng.integers(1, 30)):
        changed[at] = rng.integers(256)
    return bytes(changed)


def _head_flipped(content, rng):
    changed = bytearray(content)
    for at in rng.integers(min(400, len(content)), size=4) * rng.choice([1, -1]):
        changed[at] = rng.integers(256)
    return bytes(changed)


def _block(content, rng):
    first = int(rng.integers(len(content)))
    return first, min(first + int(rng.integers(1, 2000)), len(content))


def _zeroed(content, rng):
    first, last = _block(content, rng)
    return content[:first] + bytes(last - first) + content[last:]


def _removed(content, rng):
    first, last = _block(content, rng)
    return content[:first] + content[last:]


def _doubled(content, rng):
    first, last = _block(content, rng)
    return content[:last] + content[first:]


def _replaced(content, rng):
    return rng.bytes(5000)


def _emptied(content, rng):
    return b""


BYTES = (_truncated, _flipped, _head_flipped, _zeroed, _removed, _doubled)
BYTES += (_replaced, _emptied)

# -- mutations of text -----------------------------------------------------------------


def _word(text, rng):
    """Replace a number."""
    places = list(re.finditer(r"[-\d.]+", text))
    at = places[rng.integers(len(places))]
    return text[: at.start()] + str(rng.choice(WORDS)) + text[at.end() :]


def _line_lost(text, rng):
    lines = text.split("\n")
    lines.pop(rng.integers(len(lines)))
    return "\n".join(lines)


def _line_doubled(text, rng):
    lines = text.split("\n")
    lines.insert(rng.integers(len(lines)), lines[rng.integers(len(lines))])
    return "\n".join(lines)


def _ragged(text, rng):
    lines = text.split("\n")
    for at in rng.integers(1, len(lines), size=20):
        lines[at] = lines[at].rsplit(",", rng.integers(1, 4))[0]
    return "\n".join(lines)


def _separated(text, rng):
    return text.replace(",", str(rng.choice([";", "\t", "|", "::", " ", ",,"])))


def _ended(text, rng):
    return text.replace("\n", str(rng.choice(["\r", "\r\n", "\n\n", " \n", ",\n"])))


def _renamed(text, rng):
    name = str(rng.choice(["t", "q1", "q2", "tau1", "tau2"]))
    word = str(rng.choice([*WORDS, "Q1", "q3", "q1 [ell]", "q1 [mm]", "x" * 99_999]))
    return text.replace(name, word, 1)


TEXT = (_word, _line_lost, _line_doubled, _ragged, _separated, _ended, _renamed)

# -- mutations of descriptions ---------------------------------------------------------


def _any(found, rng):
    found = list(found)
    return found[rng.integers(len(found))]


def _attribute(root, rng):
    one = _any((x for x in root.iter() if x.attrib), rng)
    one.set(_any(one.attrib, rng), _any(WORDS, rng))


def _attribute_lost(root, rng):
    one = _any((x for x in root.iter() if x.attrib), rng)
    del one.attrib[_any(one.attrib, rng)]


def _element(root, rng):
    """Return a parent and one of its children."""
    parent = _any((x for x in root.iter() if len(x)), rng)
    return parent, _any(parent, rng)


def _element_lost(root, rng):
    parent, child = _element(root, rng)
    parent.remove(child)


def _element_doubled(root, rng):
    parent, child = _element(root, rng)
    parent.append(child)


def _element_moved(root, rng):
    parent, child = _element(root, rng)
    parent.remove(child)
    _any(root.iter(), rng).append(child)


def _tag_changed(root, rng):
    _any(root.iter(), rng).tag = _any(("link", "joint", "mimic", "a"), rng)


def _type_changed(root, rng):
    kinds = ("fixed", "floating", "planar", "ball", "REVOLUTE", "prismatic", "")
    _any(root.findall("joint"), rng).set("type", _any(kinds, rng))


XML = (_attribute, _attribute_lost, _element_lost, _element_doubled, _element_moved)
XML += (_tag_changed, _type_changed)

# -- mutations of columns --------------------------------------------------------------


def _channel(table, rng):
    return str(rng.choice(["q1", "q2", "tau1", "tau2"]))


def _scaled(table, rng):
    name = _channel(table, rng)
    return table | {name: table[name] * 10.0 ** rng.integers(-8, 9)}


def _constant(table, rng):
    name = _channel(table, rng)
    return table | {name: np.full_like(table[name], table[name][0])}


def _spiked(table, rng):
    name, column = _channel(table, rng), None
    column = table[name].copy()
    at = rng.integers(len(column), size=rng.integers(1, 20))
    column[at] = rng.choice([0.0, 1e3, 1e200, np.nan, np.inf])
    return table | {name: column}


def _short(table, rng):
    n = int(rng.choice([0, 1, 2, 15, 63, 64, 100, 300]))
    return {key: x[:n] for key, x in table.items()}


def _cut_in_parts(table, rng):
    labels = np.arange(len(table["t"])) // rng.choice([1, 5, 100, 400, 800])
    return table | {"segment": labels}


COLUMNS = (_scaled, _constant, _spiked, _short, _cut_in_parts)

# -- mutations of time stamps ----------------------------------------------------------


def _at(table, rows):
    return {name: x[rows] for name, x in table.items()}


def _jittered(table, rng):
    late = DT * rng.uniform(0.05, 3.0) * rng.normal(size=len(table["t"]))
    return table | {"t": table["t"] + late}


def _gapped(table, rng):
    keep = np.ones(len(table["t"]), dtype=bool)
    for start in rng.integers(50, len(keep) - 250, size=rng.integers(1, 6)):
        keep[start : start + rng.integers(2, 200)] = False
    return _at(table, keep)


def _restarted(table, rng):
    first = rng.integers(100, len(table["t"]) - 100)
    return table | {"t": np.r_[table["t"][:first], table["t"][:-first]]}


def _other_unit(table, rng):
    factor = float(rng.choice([1e3, 1e6, 1e9, 1 / 60, -1.0, 0.0]))
    return table | {"t": table["t"] * factor + rng.choice([0.0, 1.7e9])}


STAMPS = (_jittered, _gapped, _restarted, _other_unit)

# -- options ---------------------------------------------------------------------------

OPTIONS = ("--dt", "--columns", "--preset", "--topic", "--time-unit", "--gain")
OPTIONS += ("--drive", "--signals", "--friction", "--known-mass", "--bodies")
OPTIONS += ("--effects", "--joints")
OPTIONS += ("--out", "--ranges", "--join", "--unknown", "--base-orientation")
VALUES = (*WORDS, "auto", "none", "unknown", "1,1", "q=q{i},tau=q{i}", "pd kp=1 kd=1")

# -- cases -----------------------------------------------------------------------------


def _file(name, mutate):
    """Return a builder of a file whose bytes are changed."""

    def build(folder, rng):
        (folder / "arm.csv").write_text(clean_text())
        (folder / name).write_bytes(mutate(FILES[name](), rng))
        return argv("arm.csv" if name == "arm.urdf" else name)

    return build


def _of_text(mutate):
    def change(content, rng):
        return mutate(content.decode(), rng).encode("utf-8", "surrogatepass")

    return change


def _of_xml(mutate):
    def change(content, rng):
        root = ElementTree.fromstring(content)
        mutate(root, rng)
        return ElementTree.tostring(root)

    return change


def _of_table(mutate):
    def change(content, rng):
        rows = cells(mutate(columns(), rng))
        return "\n".join(map(",".join, rows)).encode()

    return change


def _typed(option):
    def build(folder, rng):
        (folder / "arm.csv").write_text(clean_text())
        return argv("arm.csv", f"{option}={rng.choice(VALUES)}")

    return build


def cases():
    """Return all cases; the first ones of each kind are in the quick sample."""
    found = []

    def add(name, build, count, quick):
        for k in range(count):
            found.append(Case(name=f"{name} {k}", build=build, slow=k >= quick))

    for i, name in enumerate(FILES):
        for j, mutate in enumerate(BYTES):
            # The sample contains each mutation and each file.
            quick = int((i + 3 * j) % 8 == 0)
            add(f"{name}{mutate.__name__}", _file(name, mutate), 5, quick)
    kinds = ((TEXT, _of_text, "arm.csv"), (XML, _of_xml, "arm.urdf"))
    kinds += ((COLUMNS, _of_table, "arm.csv"), (STAMPS, _of_table, "arm.csv"))
    for mutations, wrap, name in kinds:
        for mutate in mutations:
            build = _file(name, wrap(mutate))
            add(f"{name}{mutate.__name__}", build, 12, 1)
    for k, option in enumerate(OPTIONS):
        add(option, _typed(option), 6, int(k % 6 == 0))
    return found
