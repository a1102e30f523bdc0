"""Bags, sheets, MATLAB files, packed text; mappings, presets, gains that cannot be."""

import gzip
import io
import json
import sqlite3
import zipfile

import numpy as np

from tests.hostile._case import Case, argv, cells, clean_text, columns, table_case

DT = 0.005
JOINTS = ("shoulder", "elbow")


def _matrices():
    table = columns()
    q = np.column_stack([table["q1"], table["q2"]])
    return table["t"], q, np.column_stack([table["tau1"], table["tau2"]])


def _bag(folder, joints=JOINTS, topics=("/joint_states",), plugin="MCAP"):
    from tests.recording._bags import states, write_ros2

    t, q, tau = _matrices()
    written = [states(t, joints, q, tau, topic=topic) for topic in topics]
    return write_ros2(folder / "bag", written, plugin)


def _mat():
    from scipy.io import savemat

    stream = io.BytesIO()
    t, q, tau = _matrices()
    savemat(stream, {"t": t, "q": q, "tau": tau}, do_compression=True)
    return stream.getvalue()


def _xlsx():
    from openpyxl import Workbook

    book = Workbook()
    for k, row in enumerate(cells(columns())):
        book.active.append(row if k == 0 else [float(x) for x in row])
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _json():
    t, q, tau = _matrices()
    arrays = {"t": t.tolist(), "q": q.tolist(), "tau": tau.tolist()}
    return json.dumps(arrays).encode()


def _json_rows():
    """Return an object of each row."""
    table = columns()
    return [
        dict(zip(table, map(float, row))) for row in np.column_stack([*table.values()])
    ]


def _json_list():
    return json.dumps(_json_rows()).encode()


def _json_lines():
    return "\n".join(map(json.dumps, _json_rows())).encode()


def _packed(content):
    return gzip.compress(content, 1, mtime=0)


def _sqlite():
    """Return a database that is not a bag."""
    database = sqlite3.connect(":memory:")
    database.execute("CREATE TABLE messages (id INTEGER, data BLOB)")
    return database.serialize()


def _cut(rng, content):
    return content[: rng.integers(len(content))]


def _flipped(rng, content):
    changed = bytearray(content)
    for at in rng.integers(len(content), size=rng.integers(1, 30)):
        changed[at] = rng.integers(256)
    return bytes(changed)


def _written(name, make, change=None, *options):
    """Write what `make` returns, changed, to a file of this name."""

    def build(folder, rng):
        content = make()
        (folder / name).write_bytes(change(rng, content) if change else content)
        return argv(name, *options)

    return build


def _bagged(change=None, options=(), **how):
    """Write a bag of joint states, changed."""

    def build(folder, rng):
        file = _bag(folder, **how)
        if change:
            file.write_bytes(change(rng, file.read_bytes()))
        return argv(str(file.relative_to(folder)), *options)

    return build


def _bomb(name, content):
    """Return a sheet or a packed file that is mostly zeros."""

    def build(folder, rng):
        if name.endswith(".gz"):
            with gzip.open(folder / name, "wb", 1) as file:
                for _ in range(1100):
                    file.write(content)
        else:
            with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as archive:
                with archive.open("xl/worksheets/sheet1.xml", "w") as member:
                    for _ in range(1100):
                        member.write(content)
        return argv(name)

    return build


def _loop(folder, rng):
    """Make a link to itself."""
    (folder / "arm.csv").symlink_to(folder / "arm.csv")
    return argv()


def cases():
    """Return all cases."""
    found = []

    def add(name, build, expect="either", message=""):
        found.append(
            Case(name=f"formats: {name}", build=build, expect=expect, message=message)
        )

    makers = {
        "arm.mat": _mat,
        "arm.xlsx": _xlsx,
        "arm.json": _json,
        "rows.json": _json_list,
        "arm.csv.gz": lambda: _packed(clean_text().encode()),
    }
    for name, make in makers.items():
        add(f"{name} as it should be", _written(name, make), "same")
        for k in range(6):
            add(f"{name} cut {k}", _written(name, make, _cut), "refused")
            add(f"{name} flipped bytes {k}", _written(name, make, _flipped))
    name = "arm.jsonl"
    add(f"{name} as it should be", _written(name, _json_lines), "same")
    for k in range(6):
        # A logger that was killed leaves half a line, the rows before it are whole.
        add(f"{name} cut {k}", _written(name, _json_lines, _cut))
        add(f"{name} flipped bytes {k}", _written(name, _json_lines, _flipped))
    noise = lambda rng, content: rng.bytes(5000)  # noqa: E731
    endings = (
        "mat",
        "npy",
        "xlsx",
        "xls",
        "ods",
        "db3",
        "mcap",
        "bag",
        "json",
        "csv.gz",
    )
    for ending in (*endings, "csv.bz2", "csv.xz", "csv.zst", "parquet.gz"):
        name = f"arm.{ending}"
        add(f"{name} of noise", _written(name, bytes, noise), "refused")
        add(f"{name} of nothing", _written(name, bytes), "refused")
    for ending in ("csv.zip", "csv.7z", "tar", "bag.lz4"):
        name = f"arm.{ending}"
        add(f"{name}", _written(name, bytes, noise), "refused", "unpack it first: ")
    add("a database", _written("arm.db3", _sqlite), "refused", "is not a complete bag")
    add("zeros packed", _bomb("arm.csv.gz", bytes(1 << 20)), "refused", "too large")
    add("zeros in a sheet", _bomb("arm.xlsx", bytes(1 << 20)), "refused", "too large")
    for plugin in ("MCAP", "SQLITE3"):
        add(f"bag, {plugin}", _bagged(plugin=plugin), "same", "read from /joint_states")
        for k in range(4):
            how = {"plugin": plugin}
            add(
                f"bag cut {plugin} {k}",
                _bagged(_cut, **how),
                "refused",
                "not a complete bag",
            )
            add(f"bag flipped {plugin} {k}", _bagged(_flipped, **how))
    two = ("/joint_states", "/left/joint_states")
    add(
        "two topics", _bagged(topics=two), "refused", "would work: .* --topic /joint_st"
    )
    chosen = ("--topic", "/left/joint_states")
    add("a topic of two", _bagged(topics=two, options=chosen), "same")
    strange = _bagged(options=("--topic", "/x"))
    add("no such topic", strange, "refused", "has no topic /x; it holds /joint_states")
    add("no topics", _bagged(topics=()), "refused", "no joint states: expected a topic")
    other = _bagged(joints=("a_shoulder", "a_elbow"))
    add("joints of another robot", other, "refused", "would work: .* --columns")
    one = _bagged(joints=("shoulder", "sensor"))
    add("a sensor, and a joint that is not there", one, "read", "elbow: held at zero")
    add("a file that is a link to itself", _loop, "refused")

    def options(name, message, *given, change=None, expect="refused"):
        change = change or (lambda table, rng: table)
        found.append(
            table_case(f"options: {name}", change, expect, message, options=given)
        )

    def angles(table, rng):
        names = {"q1": "pos_a", "q2": "pos_b", "t": "clock"}
        return {names.get(name, name): x for name, x in table.items()}

    def currents(table, rng):
        return {f"{k} [A]" if "tau" in k else k: x for k, x in table.items()}

    mapping = "q1=pos_a,q2=pos_b,t=clock"
    options("mapping", "", "--columns", mapping, change=angles, expect="same")
    twice = "q=q{i},tau=q{i}"
    options("a column twice", "names 'q1' twice", "--columns", twice)
    options("a channel twice", "'q' twice", "--columns", "q=q{i},q=tau{i}")
    options("no pair", "expected pairs", "--columns", "q{i}")
    options("unknown channel", "'x'; expected q, tau", "--columns", "x=q1")
    options("missing column", "has no column p", "--columns", "q=p{i}")
    options("a pattern", "", "--columns", "q=(q+)+{i}")
    options("preset", "does not fit the preset 'ur'", "--preset", "ur")
    options("unknown preset", "must be one of ros, ur", "--preset", "kuka")
    both = ("--preset", "ur", "--columns", "q=q{i}")
    options("preset and mapping", "not both", *both)
    options("a topic of text", "is not a bag, so it", "--topic", "/joint_states")
    options("time unit", "must be one of s, ms, us, ns", "--time-unit", "h")
    options("wrong time unit", "", "--time-unit", "ns", expect="refused")
    options("too many gains", r"3 gain\(s\) for 2 joint", "--gain", "1,1,1")
    options("gains of one", "", "--gain", "1,1", expect="same")
    options("nan as gain", "--gain must be a factor", "--gain", "1,nan")
    options("currents", "would work: .* --gain unknown", change=currents)
    return found
