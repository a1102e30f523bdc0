"""Robots that are told positions: gains, commands, delays and limits that are wrong."""

import numpy as np

from tests.hostile._case import DT, table_case

KP, KD = 60.0, 2.0
_DRIVE = f"pd kp={KP:g} kd={KD:g}"


def _commanded(late=0.0):
    """Replace torques by the positions whose law makes them, `late` [s] later."""

    def change(table, rng):
        out = {name: x for name, x in table.items() if not name.startswith("tau")}
        for j in "12":
            q, tau = table[f"q{j}"], table[f"tau{j}"]
            wanted = q + (tau + KD * np.gradient(q, DT)) / KP
            t = table["t"]
            out[f"q_desired{j}"] = np.interp(t + late, t, wanted)
        return out

    return change


def _changed(**columns):
    """Change commands by functions of them and a generator."""

    def change(table, rng):
        out = _commanded()(table, rng)
        for name, made in columns.items():
            out[name] = made(out.get(name, out["q1"]), rng)
        return out

    return change


def _still(x, rng):
    return np.full(x.size, 0.3)


def _with(word):
    def made(x, rng):
        return [*x[:99], word, *x[100:]]

    return made


def cases():
    """Return all cases of drives."""
    found = []

    def case(name, change, drive, *rest):
        options = ("--drive", drive)
        found.append(table_case(f"drive: {name}", change, *rest, options=options))

    plain = _commanded()
    case("commands", plain, _DRIVE, "read", "v_desired")
    case("commands late by 12 ms", _commanded(0.012), _DRIVE, "read")
    for name, drive in (("all", "pd"), ("kp", "pd kd=2"), ("kd", "pd kp=60")):
        missing = "kd" if name == "kd" else "kp"
        case(f"gains missing {name}", plain, drive, "refused", f"{missing} is missing")
    for name, factor in (("large", 1e3), ("small", 1e-3)):
        drive = f"pd kp={factor * KP:g} kd={factor * KD:g}"
        case(f"gains too {name}", plain, drive, "either", "kp")
    case("gains negative", plain, "pd kp=-60 kd=2", "refused", "kp is negative")
    case("gains three", plain, "pd kp=60,60,60 kd=2", "refused", "one finite number or")
    case("gains words", plain, "pd kp=stiff kd=2", "refused", "finite number")
    still = {f"q_desired{j}": _still for j in "12"}
    case("constant both", _changed(**still), _DRIVE, "refused", "constant on every")
    one = _changed(q_desired2=_still)
    case("constant one", one, _DRIVE, "either", "constant on joints that move: elbow")
    long = "for more than a tenth"
    case("delay given of 2 s", plain, f"{_DRIVE} delay=2", "refused", long)
    case("delay given in ms", plain, f"{_DRIVE} delay=12", "refused", long)
    case("delay given as word", plain, f"{_DRIVE} delay=late", "refused", "'auto'")
    case("delay of 300 ms", _commanded(0.3), _DRIVE, "either")
    limit = "at its limit of"
    case("saturation half", plain, f"{_DRIVE} saturation=1", "refused", limit)
    case("saturation of zero", plain, f"{_DRIVE} saturation=0", "refused", limit)
    case("commands none", lambda table, rng: table, _DRIVE, "refused", "q_desired")
    for word in ("off", "1e400", "nan"):
        # A command that is missing is the one before.
        told = ("read", "holds until") if word == "nan" else ("refused", r"line \d+")
        case(f"commands with {word}", _changed(q_desired1=_with(word)), _DRIVE, *told)
    case("kind unknown", plain, "servo kp=1", "refused", "one of pd, current, voltage")
    return found
