"""Archives of arrays and parquet files: damaged, of other types, and bombs."""

import io
import struct
import zipfile

import numpy as np

from tests.hostile._case import Case, N, argv, columns


def _matrices():
    table = columns()
    return {
        "t": table["t"],
        "q": np.column_stack([table["q1"], table["q2"]]),
        "tau": np.column_stack([table["tau1"], table["tau2"]]),
    }


def _npz(arrays, *, compressed=False):
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)
    return stream.getvalue()


def _case(name, change, expect="either", message="", *, options=(), ending="npz"):
    """Return a case of a file with the bytes of ``change(rng)``."""

    def build(folder, rng):
        path = folder / f"arm.{ending}"
        path.write_bytes(change(rng))
        return argv(path.name, *options)

    return Case(name=name, build=build, expect=expect, message=message)


def _changed(**changes):
    """Return the bytes with some arrays changed, by functions, or replaced."""

    def change(rng):
        arrays = _matrices()
        for key, value in changes.items():
            if value is None:
                del arrays[key]
            else:
                arrays[key] = value(arrays.get(key)) if callable(value) else value
        return _npz(arrays)

    return change


def _truncated(rng):
    content = _npz(_matrices(), compressed=bool(rng.integers(2)))
    return content[: rng.integers(len(content))]


def _flipped(rng):
    content = bytearray(_npz(_matrices(), compressed=bool(rng.integers(2))))
    for at in rng.integers(400, size=4) * rng.choice([1, -1]):
        content[at] = rng.integers(256)
    return bytes(content)


def _header(shape, descr="<f8"):
    """Return the bytes of an .npy file that has a header only."""
    text = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def _archive(**members):
    """Return a zip archive of these bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "."), content)
    return stream.getvalue()


def _bomb(n_bytes):
    """Write an archive that is a thousandth of the zeros that it holds."""

    def build(folder, rng):
        with zipfile.ZipFile(
            folder / "arm.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1
        ) as archive:
            n = n_bytes // 16
            zeros = bytes(1 << 24)
            for name in ("q", "tau"):
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    member.write(_header((n // 2, 2)))
                    for _ in range(8 * n // len(zeros)):
                        member.write(zeros)
        return argv("arm.npz", "--dt", "0.005")

    return build


def _nested_names(q):
    return np.array([["hip"], ["knee"]])


def _twice(rng):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in ("q", "tau", "q"):
            file = io.BytesIO()
            np.save(file, _matrices()[name])
            archive.writestr(f"{name}.npy", file.getvalue())
    return stream.getvalue()


def _npz_cases():
    found = []

    def add(name, change, *rest, **options):
        found.append(_case(f"npz: {name}", change, *rest, **options))

    for k in range(15):
        add(f"truncated {k}", _truncated, "refused", "not a complete npz")
    for k in range(20):
        add(f"flipped bytes {k}", _flipped)
    add("as it should be", _changed(), "same")
    add("compressed", lambda rng: _npz(_matrices(), compressed=True), "same")
    add("columns", lambda rng: _npz(columns()), "same")
    dt = ("--dt", "0.005")
    add("no time", _changed(t=None), "refused", "no column t and no dt")
    add("no time, dt", _changed(t=None), "same", options=dt)
    add("dt in the file", _changed(t=None, dt=np.float64(0.005)), "same")
    add("Fortran order", _changed(q=np.asfortranarray), "same")
    add("big-endian", _changed(q=lambda x: x.astype(">f8")), "same")
    add("32 bits", _changed(q=lambda x: x.astype("f4")), "same")
    add("128 bits", _changed(q=lambda x: x.astype(np.longdouble)), "same")
    add("16 bits", _changed(tau=lambda x: x.astype("f2")), "read")
    add("16 bits overflow", _changed(tau=np.full((N, 2), np.inf, "f2")), "refused")
    add("integers", _changed(q=lambda x: x.astype(int)))
    add("unsigned", _changed(q=lambda x: x.astype(np.uint64)))
    add("bool", _changed(q=lambda x: x > 0))
    add("complex", _changed(q=lambda x: x + 1j), "refused", "numbers")
    add("complex torque", _changed(tau=lambda x: x + 0j), "refused", "numbers")
    add("text", _changed(q=lambda x: x.astype(str)), "refused", "numbers")
    add("bytes", _changed(q=lambda x: x.astype("S9")), "refused", "numbers")
    add("dates", _changed(q=lambda x: x.astype("M8[s]")), "refused", "numbers")
    seconds = lambda t: (1e9 * t).astype("M8[ns]")  # noqa: E731
    add("dates as time", _changed(t=seconds), "same")
    add("no dates as time", _changed(t=np.full(N, "NaT", "M8[ns]")), "refused")
    add("durations as time", _changed(t=lambda t: (1e9 * t).astype("m8[ns]")))
    add("records", _changed(q=np.zeros(N, [("a", float)])), "refused")
    add("objects", _changed(q=lambda x: x.astype(object)), "refused", "Python objects")
    add("object beside", _changed(x=np.array([{}])), "refused", "Python objects")
    add("nan", _changed(q=lambda x: x * np.where(x > 0.5, np.nan, 1)), "refused")
    add("infinity", _changed(tau=lambda x: x / (x > 0)), "refused")
    add("transposed", _changed(q=np.transpose), "refused")
    add("all transposed", _changed(t=None, q=np.transpose, tau=np.transpose), "refused")
    add("three axes", _changed(q=lambda x: x[:, :, None]), "refused", "no positions")
    add(
        "three axes both",
        _changed(q=lambda x: x[None], tau=lambda x: x[None]),
        "refused",
    )
    add("one axis", _changed(q=lambda x: x[:, 0], tau=lambda x: x[:, 0]), "refused")
    add("flat", _changed(q=np.ravel), "refused")
    add("no rows", _changed(q=lambda x: x[:0], tau=lambda x: x[:0], t=None), "refused")
    add("no columns", _changed(q=lambda x: x[:, :0]), "refused")
    add("a number", _changed(q=np.float64(3.0)), "refused")
    add("lengths", _changed(tau=lambda x: x[:-1]), "refused", "1599 rows")
    add("t longer", _changed(t=lambda x: np.append(x, 9.0)), "refused", "'t'")
    add("t of two columns", _changed(t=lambda x: np.column_stack([x, x])), "refused")
    add("t of one column", _changed(t=lambda x: x[:, None]), "same")
    add("v of another length", _changed(v=np.zeros((9, 2))), "refused", "'v'")
    add("v of three", _changed(v=np.zeros((N, 3))), "refused")
    add("segment as text", _changed(segment=np.repeat(["a", "b"], N // 2)), "read")
    add("segment nan", _changed(segment=np.full(N, np.nan)), "refused")
    add("no torque", _changed(tau=None), "refused", "no torques")
    add("nothing", lambda rng: _npz({}), "refused")
    for value in ("fast", -0.01, 0, np.nan, [0.01, 0.02], None, True, 1 + 0j):
        array = np.array(value)
        add(f"dt {value}", _changed(t=None, dt=array), "refused", "dt|objects")
    for names in (["a"], ["a", "a"], [1, 2], "shoulder", ["", ""], [b"a", b"b"]):
        add(f"joint_names {names}", _changed(joint_names=np.array(names)), "refused")
    add("joint_names nested", _changed(joint_names=_nested_names), "refused")
    add("matrix beside a column", _changed(q1=np.zeros(N)), "refused", "q1")
    add("array twice", _twice)
    add("other files", lambda rng: _archive(a__txt="q1,tau1\n1,2"), "refused")
    add("spreadsheet", lambda rng: _archive(q="1", tau="2"), "refused")
    add("no arrays", lambda rng: _archive(q__npy="", tau__npy=""), "refused")
    add("path in a name", lambda rng: _archive(**{"../../q__npy": "x"}), "refused")
    for shape in ((10**9, 2), (10**15, 2), (-1, 2), (2**63, 1), (1,) * 70):
        member = _header(shape)
        content = _archive(q__npy=member, tau__npy=member)
        add(f"claims {str(shape)[:30]}", lambda rng, x=content: x, "refused")
    deep = _header("(" * 5000 + ")" * 5000)
    add("claims parentheses", lambda rng: _archive(q__npy=deep), "refused")
    evil = _header((1,), "__import__('os').abort()")
    add("claims code", lambda rng: _archive(q__npy=evil), "refused")
    add("npy", lambda rng: _header((3, 2)), "refused")
    found.append(
        Case(name="npz: bomb of 400 MB", build=_bomb(400 << 20), expect="refused")
    )
    found.append(
        Case(
            name="npz: bomb of 4 GB", build=_bomb(4 << 30), expect="refused", slow=True
        )
    )
    return found


def _parquet(change):
    def content(rng):
        import pyarrow
        from pyarrow import parquet

        stream = io.BytesIO()
        parquet.write_table(pyarrow.table(change(columns(), rng)), stream)
        return stream.getvalue()

    return content


def _parquet_cases():
    try:
        import pyarrow
    except ImportError:
        return []
    found = []

    def add(name, change, *rest):
        found.append(_case(f"parquet: {name}", change, *rest, ending="parquet"))

    whole = _parquet(lambda x, rng: x)
    add("as it should be", whole, "same")
    for k in range(5):

        def truncated(rng):
            content = whole(rng)
            return content[: rng.integers(len(content))]

        add(f"truncated {k}", truncated, "refused", "not a complete parquet")

        def flipped(rng):
            content = bytearray(whole(rng))
            for at in rng.integers(400, size=4) * rng.choice([1, -1]):
                content[at] = rng.integers(256)
            return bytes(content)

        add(f"flipped bytes {k}", flipped)
    add("text", _parquet(lambda x, rng: x | {"q1": x["q1"].astype(str)}), "refused")
    hole = lambda x, rng: x | {"q1": [None, *x["q1"][1:]]}  # noqa: E731
    add("hole", _parquet(hole), "refused", "'q1'")
    lists = lambda x, rng: x | {"q1": [[v] for v in x["q1"]]}  # noqa: E731
    add("lists", _parquet(lists), "refused", "'q1'")
    none = lambda x, rng: x | {"q1": pyarrow.nulls(len(x["t"]))}  # noqa: E731
    add("nothing", _parquet(none), "refused", "'q1'")
    no_rows = lambda x, rng: {k: v[:0] for k, v in x.items()}  # noqa: E731
    add("no rows", _parquet(no_rows), "refused", "no rows")
    add("ambiguous", _parquet(lambda x, rng: x | {"q_1": x["q2"]}), "refused", "q_1")
    dates = lambda x, rng: x | {"t": (1e9 * x["t"]).astype("M8[ns]")}  # noqa: E731
    add("dates as time", _parquet(dates), "same")
    flags = lambda x, rng: x | {"q1": x["q1"] > 0}  # noqa: E731
    add("flags", _parquet(flags))
    words = lambda x, rng: x | {"m": pyarrow.array(["a"] * N).dictionary_encode()}  # noqa: E731
    add("words", _parquet(words), "same", "column")
    add("csv", lambda rng: b"t,q1\n0,1\n", "refused", "not a complete parquet")
    return found


def cases():
    """Return all cases of archives."""
    return _npz_cases() + _parquet_cases()
