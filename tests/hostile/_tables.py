"""Text files: damaged, oddly written, and with cells that are not numbers."""

import gzip

import numpy as np

from tests.hostile._case import (
    Case,
    argv,
    cells,
    clean_lines,
    clean_text,
    columns,
    table_case,
    text_case,
)


def _truncated(rng):
    content = clean_text()
    return content[: rng.integers(60, len(content))]


def _flipped(rng):
    content = bytearray(clean_text().encode())
    for at in rng.integers(len(content), size=rng.integers(1, 6)):
        content[at] = rng.integers(256)
    return bytes(content)


def _with_nul(rng):
    content = bytearray(clean_text().encode())
    content[rng.integers(len(content))] = 0
    return bytes(content)


def _mixed_separators(rng):
    lines = clean_lines()
    for k in rng.integers(1, len(lines), size=rng.integers(1, 50)):
        lines[k] = lines[k].replace(",", ";\t "[rng.integers(3)])
    return "\n".join(lines)


def _cell(word, column):
    def change(rng):
        rows = cells(columns())
        row = rng.integers(1, len(rows))
        rows[row][rows[0].index(column)] = word
        return "\n".join(",".join(row) for row in rows)

    return change


def _joined(separator, lines=None, end="\n"):
    def change(rng):
        rows = cells(columns()) if lines is None else lines
        return end.join(separator.join(row) for row in rows) + end

    return change


def _lines(edit):
    """Return a change of the list of lines in place."""

    def change(rng):
        lines = clean_lines()
        edit(lines, rng)
        return "\n".join(lines) + "\n"

    return change


def _renamed(**names):
    def change(table, rng):
        return {names.get(name, name): x for name, x in table.items()}

    return change


WORDS = (
    ("nan", "NaN", "inf", "-inf", "Infinity", "NA", "N/A", "null", "None", "-", "?")
    + ("#N/A", "#DIV/0!", "True", "1e400", "-1e400", "0x1F", "1_000", "１２", "9" * 400)
    + ("1.2.3", "1e", "--1", "1 2", "'", '"', "=A1", "12:30", "1e1000000000", "½", "5%")
    + ("off", "\u200b", "1\u00a0000", "\ufeff1", "1,5", "")
)


def _wide(n):
    def build(folder, rng):
        names = ",".join(f"x{k}" for k in range(n))
        values = ",".join(["0.5"] * n)
        lines = clean_lines()
        with (folder / "arm.csv").open("w") as file:
            file.write(f"{lines[0]},{names}\n")
            for line in lines[1:400] if n < 20_000 else lines[1:40]:
                file.write(f"{line},{values}\n")
        return argv()

    return build


def _long(n):
    """Return a recording of a robot that was left on: it never moves."""

    def build(folder, rng):
        with (folder / "arm.csv").open("w") as file:
            file.write("q1,q2,tau1,tau2\n")
            block = "0.1234567,-1.1234567,3.25,-0.75\n" * 10_000
            for _ in range(n // 10_000):
                file.write(block)
        return argv("arm.csv", "--dt", "0.005")

    return build


def cases():
    """Return all cases of text."""
    found = []

    def text(name, change, *rest, **options):
        found.append(text_case(f"text: {name}", change, *rest, **options))

    def table(name, change, *rest, **options):
        found.append(table_case(f"text: {name}", change, *rest, **options))

    for k in range(12):
        text(f"truncated {k}", _truncated)
    for k in (0, 1, 2, 5, 9, 17):
        text(f"cut in the header at {k}", lambda rng, k=k: clean_text()[:k], "refused")
    for k in range(15):
        text(f"flipped bytes {k}", _flipped)
    for k in range(3):
        text(f"NUL {k}", _with_nul, "refused", "binary")
    for k in range(5):
        text(f"random bytes {k}", lambda rng: rng.bytes(5000), "refused")
        text(f"mixed separators {k}", _mixed_separators, "refused", r"line \d+")
    text("gzip", lambda rng: gzip.compress(clean_text().encode()), "refused", "UTF-8")
    text("png", lambda rng: b"\x89PNG\r\n\x1a\n" + rng.bytes(999), "refused")

    plain = clean_text()
    text("byte order mark", lambda rng: plain.encode("utf-8-sig"), "same")
    for encoding in ("utf-16", "utf-32"):
        text(encoding, lambda rng, e=encoding: plain.encode(e), "same")
    for encoding in ("utf-16-le", "utf-16-be"):
        text(encoding, lambda rng, e=encoding: plain.encode(e), "refused", "UTF-8")
    degrees = plain.replace("t,", "# in °\nt,", 1)
    text("latin-1", lambda rng: degrees.encode("latin-1"), "same", "cp1252")
    both = degrees.encode() + b"# \xb0\n"
    text("latin-1 in UTF-8", lambda rng: both, "refused", "UTF-8")
    text("separator told", lambda rng: "sep=,\n" + plain, "same")
    for name, mark in (("comma", ","), ("semicolon", ";"), ("tab", "\t"), ("2", "  ")):
        text(f"separated by {name}", _joined(mark), "same")
    text("blanks after commas", _joined(",  "), "same")
    text("blanks around semicolons", _joined(" ; "), "same")
    for name, mark in (("bar", "|"), ("colon", ":"), ("slash", "/"), ("two", "::")):
        text(f"separated by {name}", _joined(mark), "refused", "separate the columns")
    for name, end in (("CRLF", "\r\n"), ("CR", "\r"), ("blank lines", "\n\n")):
        text(f"line ends {name}", _joined(",", end=end), "same")

    def mixed_ends(rng):
        return "".join(line + ("\n", "\r\n")[rng.integers(2)] for line in clean_lines())

    text("line ends mixed", mixed_ends, "same")
    text("no last line end", lambda rng: plain.rstrip("\n"), "same")
    comma = [[x.replace(".", ",") for x in row] for row in cells(columns())]
    text("decimal commas, semicolons", _joined(";", comma), "same")
    text("decimal commas, tabs", _joined("\t", comma), "same")
    text("decimal commas, commas", _joined(",", comma), "refused", "need ; as sep")
    quoted = [[f'"{x}"' for x in row] for row in cells(columns())]
    text("all in quotes", _joined(",", quoted), "same")
    text(
        "decimal commas in quotes", _joined(",", [[f'"{x}"' for x in r] for r in comma])
    )
    text("upper case ending", lambda rng: plain, "same", ending="CSV")
    text("ending txt", lambda rng: plain, "same", ending="txt")
    text("unknown ending", lambda rng: plain, "refused", "ending", ending="log")
    text("spreadsheet", lambda rng: b"PK\3\4" + rng.bytes(99), "refused", ending="xlsx")

    for word in WORDS:
        for column in ("t", "q2", "tau1"):
            shown = ascii(word if len(word) < 20 else f"{len(word)} digits")
            text(f"{shown} in {column}", _cell(word, column), "refused", r"line \d+")
    text("1e-400 in q2", _cell("1e-400", "q2"), "read")
    text("+ in q2", _cell("+0.5", "q2"), "read")

    text(
        "a cell less", _lines(lambda x, rng: x.__setitem__(9, "0.04,1,1,1")), "refused"
    )
    text("a cell more", _lines(lambda x, rng: x.__setitem__(9, x[9] + ",1")), "refused")
    for k in range(4):

        def ragged(lines, rng):
            for at in rng.integers(1, len(lines), size=20):
                lines[at] = lines[at].rsplit(",", rng.integers(1, 4))[0]

        text(f"ragged {k}", _lines(ragged), "refused", r"line \d+ has \d cells")

    def every(mark, header=True):
        def edit(lines, rng):
            lines[not header :] = [x + mark for x in lines[not header :]]

        return _lines(edit)

    text("separator at every end", every(","), "same")
    text("separator at the ends of data", every(",", header=False), "same")
    text("blank at every end", every("  "), "same")
    text("header twice", _lines(lambda x, rng: x.insert(500, x[0])), "refused", "501")
    text("header at the end", _lines(lambda x, rng: x.append(x[0])), "refused")
    text("row of units", _lines(lambda x, rng: x.insert(1, "s,rad,rad,Nm,Nm")), "same")
    strange = "s,rad,parsec,Nm,Nm"
    text("row of strange units", _lines(lambda x, rng: x.insert(1, strange)), "refused")
    text("end of log", _lines(lambda x, rng: x.append("end of log")), "refused")
    places = "no names of columns, only 5 .*--columns t=1,q=2-3,tau=4-5$"
    text("header missing", _lines(lambda x, rng: x.pop(0)), "refused", places)
    for k in (7, 12, 25):
        cut = "the last line is cut"
        text(f"last line cut by {k}", lambda rng, k=k: plain[:-k], "read", cut)
    text("two logs", lambda rng: plain + plain, "refused")
    text("header only", lambda rng: "t,q1,q2,tau1,tau2\n", "refused", "only a header")
    text("one row", lambda rng: "\n".join(clean_lines()[:2]), "refused")
    text("two rows", lambda rng: "\n".join(clean_lines()[:3]), "refused")
    text("blank lines only", lambda rng: "\n \n\t\n", "refused", "no rows")
    text("comments only", lambda rng: "# t,q1,q2,tau1,tau2\n# none\n", "refused")
    text("comments between", _lines(lambda x, rng: x.insert(99, "# pause")), "same")
    text("comments behind", every(" # fine", header=False), "same")
    text("header commented", lambda rng: "# " + plain, "same")
    text("long comment", lambda rng: "# " + "x" * 3_000_000 + "\n" + plain, "same")
    text(
        "long name",
        lambda rng: plain.replace("tau2", "tau2," + "x" * 99_999, 1),
        "refused",
    )
    text("long cell", _cell("1." + "0" * 200_000, "q1"), "read")
    text(
        "unclosed quote", _lines(lambda x, rng: x.__setitem__(5, '"' + x[5])), "refused"
    )
    text("unclosed quote in header", lambda rng: '"' + plain, "refused")
    text(
        "quoted line end in a cell",
        _lines(lambda x, rng: x.__setitem__(5, x[5].rsplit(",", 1)[0] + ',"1\n2"')),
        "refused",
        r"line \d+",
    )
    text(
        "quoted line end in the header",
        lambda rng: plain.replace("tau2", '"tau2\n[Nm]"', 1),
        "refused",
    )
    text("one long line", lambda rng: plain.replace("\n", ","), "refused")
    text("one column", lambda rng: "t\n" + "0.1\n" * 99, "refused")
    text("html", lambda rng: "<html><body>404</body></html>", "refused")
    text("json", lambda rng: '{"q1": [1, 2], "tau1": [1, 2]}', "refused")
    text("format characters", lambda rng: "%s,%d,{0},{q1}\n1,2,3,4\n", "refused")
    text("escape codes", lambda rng: "\x1b[31mt,q1,tau1\n1,2,3\n", "refused")

    table(
        "upper case",
        _renamed(t="T", q1="Q1", q2="Q2", tau1="TAU1", tau2="Tau2"),
        "same",
    )
    table("units in names", _renamed(t="t [s]", q1="q1 [rad]"), "same")
    table("strange unit", _renamed(q1="q1 [ell]"), "refused", "in 'ell', which is no")
    table("wrong unit", _renamed(q1="q1 [mm]"), "refused", "shoulder turns; expected")
    table("other names", _renamed(q1="pos_1", q2="pos_2"), "refused", "no positions")
    table("no torques", lambda x, rng: {k: x[k] for k in ("t", "q1", "q2")}, "refused")
    table("no positions", lambda x, rng: {k: x[k] for k in ("t", "tau1")}, "refused")
    table(
        "no joint 2", lambda x, rng: {k: x[k] for k in ("t", "q1", "tau1")}, "refused"
    )
    table("no q1", lambda x, rng: {k: x[k] for k in x if k != "q1"}, "refused", "q1")
    table("counted from 2", _renamed(q1="q2", q2="q3"), "refused", "'q1'")
    table("a hole in the count", _renamed(q2="q3"), "refused", "'q2'")
    table("a far number", _renamed(q2="q999999999999"), "refused", "'q2'")
    table("Chinese name", lambda x, rng: x | {"温度": x["q1"]}, "same")
    table("column of text", lambda x, rng: x | {"mode": ["run"] * len(x["t"])}, "same")
    holes = lambda x, rng: x | {"I": np.where(x["q1"] > 0, np.nan, 1.0)}  # noqa: E731
    table("holes beside", holes, "same", "column")

    def mixed(x, rng):
        order = rng.permutation(len(x["t"]))
        return {name: values[order] for name, values in x.items()}

    table("rows shuffled", mixed, "same", "sorted by it")
    table("columns shuffled", lambda x, rng: {k: x[k] for k in sorted(x)[::-1]}, "same")
    found.append(Case(name="text: 2,000 columns", build=_wide(2000), expect="read"))
    found.append(Case(name="text: 200,000 columns", build=_wide(200_000), slow=True))
    found.append(
        Case(name="text: 100,000 rows at rest", build=_long(100_000), expect="refused")
    )
    found.append(
        Case(
            name="text: 10,000,000 rows at rest",
            build=_long(10_000_000),
            expect="refused",
            slow=True,
        )
    )
    return found
