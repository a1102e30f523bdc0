"""Recordings that show little or are beyond all sizes, options, and folders."""

import numpy as np

from tests.hostile._case import (
    DT,
    Case,
    N,
    argv,
    cells,
    clean_text,
    columns,
    table_case,
)

REST = 400


def _only(joint):
    """Return a change that holds all joints but one."""

    def change(table, rng):
        for other in (1, 2):
            if other != joint:
                table[f"q{other}"] = np.full_like(table["t"], 0.3)
        return table

    return change


def _in_turn(table, rng):
    half = len(table["t"]) // 2
    table["q2"][:half] = table["q2"][half]
    table["q1"][half:] = table["q1"][half - 1]
    return table


def _mostly_rest(table, rng):
    """Two seconds of motion between rests of twenty-nine."""
    rows = np.r_[np.zeros(5800, int), np.arange(REST), np.full(5800, REST - 1)]
    noise = 1e-4 * rng.normal(size=(2, rows.size))
    return {
        "t": DT * np.arange(rows.size),
        "q1": table["q1"][rows] + noise[0],
        "q2": table["q2"][rows] + noise[1],
        "tau1": table["tau1"][rows],
        "tau2": table["tau2"][rows],
    }


def _all(kind, value):
    def change(table, rng):
        for name in (f"{kind}1", f"{kind}2"):
            table[name] = np.full_like(table["t"], value)
        return table

    return change


def _times(kind, factor):
    def change(table, rng):
        for name in table:
            if name.startswith(kind):
                table[name] = table[name] * factor
        return table

    return change


def _digits(kind, step):
    def change(table, rng):
        for name in table:
            if name.startswith(kind):
                table[name] = np.round(table[name] / step) * step
        return table

    return change


def _signs(kind):
    def change(table, rng):
        for name in table:
            if name.startswith(kind):
                table[name] = np.where(table[name] > 0, 1.0, -1.0)
        return table

    return change


def _sizes(kind):
    def change(table, rng):
        return {k: abs(x) if k.startswith(kind) else x for k, x in table.items()}

    return change


def _steps(kind, share):
    def change(table, rng):
        for name, x in table.items():
            if name.startswith(kind):
                step = share * x.std()
                table[name] = np.round(x / step) * step
        return table

    return change


def _first(n):
    return lambda table, rng: {name: x[:n] for name, x in table.items()}


def _motion_cases():
    found = []

    def add(name, change, *rest, **options):
        found.append(table_case(f"motion: {name}", change, *rest, **options))

    add(
        "all at zero",
        lambda x, rng: {k: 0 * v if k != "t" else v for k, v in x.items()},
        "refused",
    )
    add("positions constant", _all("q", 0.5), "refused", "o joint moves")
    add("torques constant", _all("tau", 0.5), "refused", "constant")
    add("torques of 2 values", _signs("tau"), "refused", "two values only")
    add("torques without signs", _sizes("tau"), "refused", "drive 'current signed=no'")
    for share in (0.05, 0.3, 0.5):
        add(f"torques in steps of {share:g} spreads", _steps("tau", share), "read")
    add(
        "noise only",
        lambda x, rng: {
            k: rng.normal(size=v.size) if k != "t" else v for k, v in x.items()
        },
    )
    add(
        "rest with noise",
        lambda x, rng: {
            k: 1e-4 * rng.normal(size=v.size) if k != "t" else v for k, v in x.items()
        },
        "refused",
        "No joint moves",
    )
    add("only joint 1", _only(1))
    add("only joint 2", _only(2))
    add("one joint at a time", _in_turn)
    add("2 s of motion in 60 s", _mostly_rest)
    for n in (1, 2, 3, 9, 10, 16, 40, 63):
        add(f"{n} rows", _first(n), "refused")
    for n in (64, 100, 200, 400):
        add(f"{n} rows", _first(n))
    for factor in (1e300, 1e150, 1e30, 1e-30, 1e-300, -1.0, 1e-320):
        add(f"torques times {factor:g}", _times("tau", factor))
        add(f"positions times {factor:g}", _times("q", factor))
    add("one torque 1e300", lambda x, rng: x | {"tau1": np.r_[1e300, x["tau1"][1:]]})
    add(
        "one torque 1e308 at the end",
        lambda x, rng: x | {"tau1": np.r_[x["tau1"][1:], -1e308]},
    )
    add("one position 1e200", lambda x, rng: x | {"q1": np.r_[x["q1"][1:], 1e200]})
    add("torques as integers", _digits("tau", 1.0))
    add("positions as integers", _digits("q", 1.0))
    add("positions of 2 values", lambda x, rng: x | {"q1": np.sign(x["q1"])})
    add("ramp", lambda x, rng: x | {"q1": x["t"], "q2": -x["t"]})
    add(
        "jumps of a turn",
        lambda x, rng: x | {"q1": (4 * x["q1"] + np.pi) % (2 * np.pi)},
    )
    add("equal joints", lambda x, rng: x | {"q2": x["q1"]})
    add("equal torques", lambda x, rng: x | {"tau2": x["tau1"]})
    add("torque is the position", lambda x, rng: x | {"tau1": x["q1"], "tau2": x["q2"]})
    add(
        "v and a beside",
        lambda x, rng: x | {"v1": x["q1"], "v2": x["q2"], "a1": x["q1"], "a2": x["q2"]},
        "same",
    )
    add("a for one joint", lambda x, rng: x | {"a1": x["q1"]}, "refused", "a")
    for n in (2, 6, 12, 60, N // 2):

        def cut(table, rng, n=n):
            return table | {"segment": np.arange(N) * n // N}

        add(f"{n} segments", cut)
    add("a segment per row", lambda x, rng: x | {"segment": np.arange(N)}, "refused")
    add("segment of reals", lambda x, rng: x | {"segment": x["t"] // 1.7 + 0.5}, "read")
    add(
        "segments interleaved",
        lambda x, rng: x | {"segment": np.arange(N) % 2},
        "refused",
    )
    return found


# -- options ---------------------------------------------------------------------------

# Values of options that are no names, and what becomes of them.
_OPTIONS = (
    ("--dt", ("0.005",), "same"),
    ("--dt", ("0", "-1", "nan", "inf", "x", "", "1e-400", "1e400", "-0"), "refused"),
    ("--dt", ("0.006", "5", "200", "5000", "1", "0,005", "5ms", "0.0001"), "refused"),
    ("--cutoff", ("none", "8", "1e1"), "read"),
    ("--cutoff", ("0", "-1", "nan", "inf", "low", "", "100", "1e9", "5Hz"), "refused"),
    ("--cutoff", ("0.001", "0.05"), "refused"),
    ("--cutoff", ("99.99", "1e-300", "0.3"), "either"),
    ("--seed", ("1", "4294967295"), "same"),
    ("--seed", ("-1", "4294967296", "1.5", "x", "", "9" * 5000), "refused"),
    ("--friction", ("viscous", "none", "viscous,coulomb,offset,rotor_inertia"), "read"),
    (
        "--friction",
        ("", ",", "all", "viscous,viscous", "Viscous", "x;y", "💥"),
        "refused",
    ),
    ("--effects", ("spring", "none", " spring , offset "), "read"),
    (
        "--effects",
        ("", ",", "rust", "spring,spring", "all,spring", "SPRING"),
        "refused",
    ),
    ("--joints", ("shoulder,elbow",), "same"),
    ("--joints", ("", ",", "shoulder", "a,b", "shoulder,shoulder", "1,2"), "refused"),
    ("--joints", ("x" * 100_000,), "refused"),
    ("--urdf", ("none.urdf", "", ".", "arm.csv", "/dev/null", "a\nb"), "refused"),
)


def _option_cases():
    found = []

    def add(name, options, expect):
        def build(folder, rng):
            (folder / "arm.csv").write_text(clean_text())
            return argv("arm.csv", *options)

        found.append(Case(name=f"option: {name}", build=build, expect=expect))

    for option, values, expect in _OPTIONS:
        for value in values:
            shown = ascii(value[:25])
            add(f"{option} {shown}", (f"{option}={value}",), expect)
    add("--dt missing", ("--dt",), "refused")
    add("unknown", ("--colour", "red"), "refused")
    add("second recording", ("other.csv",), "refused")
    for source in (
        "",
        ".",
        "none.csv",
        "/dev/null",
        "/dev/zero",
        "a\nb.csv",
        "~/x.csv",
    ):

        def build(folder, rng, source=source):
            return argv(source)

        found.append(Case(name=f"option: {source!a}", build=build, expect="refused"))
    for source in ("arm\x00.csv", "x" * 5000 + ".csv"):

        def build_long(folder, rng, source=source):
            return argv(source)

        shown = ascii(source[:9])
        found.append(
            Case(name=f"option: name {shown}", build=build_long, expect="refused")
        )
    for dt in ("4", "5", "250", "200", "5000", "1000", "1e6"):

        def build_dt(folder, rng, dt=dt):
            lines = [line.split(",", 1)[1] for line in clean_text().splitlines()]
            (folder / "arm.csv").write_text("\n".join(lines))
            return argv("arm.csv", "--dt", dt)

        name = f"option: --dt {dt} alone"
        found.append(
            Case(name=name, build=build_dt, expect="refused", message=r"\bs\b")
        )

    def build_fast(folder, rng):
        fine = columns(np.arange(10_000))
        rows = [row[1:] for row in cells(fine)]
        (folder / "arm.csv").write_text("\n".join(map(",".join, rows)))
        return argv("arm.csv", "--dt", "0.25")

    name = "option: --dt 0.25 alone, 4 kHz"
    ms = "give 0.00025|in milliseconds it would be 0.00025 s"
    found.append(Case(name=name, build=build_fast, expect="refused", message=ms))
    return found


# -- folders ---------------------------------------------------------------------------


def _folder_case(name, prepare, expect, message="", *options):
    def build(folder, rng):
        (folder / "arm.csv").write_text(clean_text())
        prepare(folder)
        return argv("arm.csv", *options)

    return Case(name=f"folder: {name}", build=build, expect=expect, message=message)


def _report_there(folder):
    (folder / "out").mkdir()
    (folder / "out" / "report.json").write_text("{}")


def _folder_in_its_place(folder):
    (folder / "out" / "report.html").mkdir(parents=True)


def _link_to_nothing(folder):
    (folder / "out").symlink_to(folder / "nowhere" / "deep")


def _link_in_a_circle(folder):
    (folder / "out").symlink_to(folder / "out")


def _folder_cases():
    return [
        _folder_case("a report there", _report_there, "refused", "--out out-2$"),
        _folder_case("a report there, by force", _report_there, "same", "", "--force"),
        _folder_case("there, empty", lambda x: (x / "out").mkdir(), "same"),
        _folder_case(
            "a file there", lambda x: (x / "out").touch(), "refused", "a file"
        ),
        _folder_case("file above", lambda x: None, "refused", "", "--out", "arm.csv/a"),
        _folder_case("a folder named report.html", _folder_in_its_place, "refused"),
        _folder_case("a link to nothing", _link_to_nothing, "either"),
        _folder_case("a link to itself", _link_in_a_circle, "refused"),
        _folder_case(
            "read-only",
            lambda x: None,
            "refused",
            "/proc cannot be written to",
            "--out",
            "/proc/a",
        ),
        _folder_case("a device", lambda x: None, "refused", "", "--out", "/dev/null"),
        _folder_case("NUL", lambda x: None, "refused", "", "--out", "a\0b"),
        _folder_case("long", lambda x: None, "refused", "", "--out", "x" * 5000),
        _folder_case("blank", lambda x: None, "either", "", "--out", " "),
        _folder_case("Unicode", lambda x: None, "read", "", "--out", "報告"),
        _folder_case("deep", lambda x: None, "read", "", "--out", "a/b/c/d/e"),
        _folder_case("here", lambda x: None, "refused", "--force", "--out", "."),
        _folder_case(
            "here, by force", lambda x: None, "read", "", "--out", ".", "--force"
        ),
    ]


def cases():
    """Return all cases of recordings, options and folders."""
    return _motion_cases() + _option_cases() + _folder_cases()
