"""Words and numbers of a report: what an effect is called, how an error is written."""

import functools
import importlib.metadata
import math
import re

import numpy as np

from sklearn_vbjfa.effects import OfRobot, available

_TINY = 1e-12
# Logarithm of the odds of a million to one.
_SURE = math.log(1e6)


def joint_label(names, joint):
    """Name of a joint for a sentence: its own if that is one, else counted from 1."""
    name = " ".join(names[joint].split()) if joint < len(names) else ""
    if not name or name.isdigit():
        return f"joint {joint + 1}"
    counted = re.fullmatch(r"joint[ _]?(\d+)", name)
    if counted and int(counted[1]) == joint + 1:
        return f"joint {joint + 1}"
    if re.search("joint|axis", name, re.IGNORECASE):
        return name
    return f"joint {joint + 1} ({name})"


def joint_list(names, joints, most=3):
    """Write several joints, by number where they are numbered; most: names of them."""
    joints = sorted(set(joints))
    if len(joints) == len(names) > 1:
        return "all joints"
    labels = [joint_label(names, j) for j in joints]
    numbers = [label.removeprefix("joint ") for label in labels]
    if len(joints) < 2:
        return "".join(labels)
    if all(number.isdigit() for number in numbers):
        return f"joints {join(numbers, 6)}"
    return join(labels, most) if most else plural(len(joints), "joint")


def signal_label(signal, names, joint):
    """Return the label of a signal such as "speed of joint2" for a joint."""
    kind, _, name = signal.partition(" of ")
    if not name or name not in names:
        return signal
    other = list(names).index(name)
    return f"its {kind}" if other == joint else f"{kind} of {joint_label(names, other)}"


def effect_label(outcome, name, shape=None):
    """Plain English for an effect of an outcome, with what matters of its shape."""
    joint = functools.partial(joint_label, outcome.robot["joints"])
    return outcome.robot["library"][name].describe(shape or {}, joint)


def place_label(outcome, name, joint):
    """Where an effect is: its joint, or the robot for one that belongs to none."""
    if isinstance(outcome.robot["library"][name], OfRobot):
        return "robot"
    return joint_label(outcome.robot["joints"], joint)


def effect_at(outcome, name, joint, shape=None):
    """Name an effect with its joint, if it belongs to one."""
    label, place = effect_label(outcome, name, shape), place_label(outcome, name, joint)
    return label if place == "robot" else f"{label} on {place}"


def rival_labels(outcome, effect):
    """Name the rivals of an effect, with the joints of those that are on others."""
    here = place_label(outcome, effect.name, effect.joint)
    labels = (effect_at(outcome, **one) for one in effect.trials)
    return list(dict.fromkeys(x.removesuffix(f" on {here}") for x in labels))


def documentation_of(name):
    """Address of an effect's page; empty where the package names no documentation."""
    try:
        given = importlib.metadata.metadata("sklearn-vbjfa").get_all("Project-URL", [])
    except importlib.metadata.PackageNotFoundError:
        return ""
    pairs = (entry.partition(",") for entry in given)
    found = {label.strip().lower(): address.strip() for label, _, address in pairs}
    if name not in available() or "documentation" not in found:
        return ""
    return f"{found['documentation'].rstrip('/')}/effects/{name}.html"


def number(value, digits=3):
    """Write a number short, without an exponent where it is not needed."""
    if value is None or not math.isfinite(value):
        return "?"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if -5 <= int(exponent) < 5:
        rounded = float(f"{mantissa}e{exponent}")
        return np.format_float_positional(rounded, trim="-")
    return f"{float(mantissa):g}e{int(exponent)}"


def percent(value):
    """Write a share in per cent, one decimal."""
    if value is None or not math.isfinite(value):
        return "?"
    return f"{100 * value:.0f} %" if abs(value) >= 0.9995 else f"{100 * value:.1f} %"


def bare_percent(value):
    """Write a share in per cent without the sign, for a table."""
    return "-" if value is None or not math.isfinite(value) else f"{100 * value:.1f}"


def whole_percent(value):
    """Write a share in whole per cent."""
    return "?" if value is None or not math.isfinite(value) else f"{100 * value:.0f} %"


def p_text(value):
    """Write a p-value."""
    if value is None or not math.isfinite(value):
        return "p unknown"
    if value < _TINY:
        return "p < 1e-12"
    return f"p = {number(value, 1 if value < 0.01 else 2)}"


def odds_text(log_odds):
    """Write odds for or against, by their logarithm: "350 : 1"."""
    if not math.isfinite(log_odds):
        return "unknown"
    if abs(log_odds) > _SURE:
        return "> 1e6 : 1" if log_odds > 0 else "< 1 : 1e6"
    odds = f"{number(math.exp(abs(log_odds)), 2)}"
    return f"{odds} : 1" if log_odds >= 0 else f"1 : {odds}"


def with_error(value, interval=None, unit=""):
    """Write a value with half its 90 % interval, rounded to what the latter means."""
    unit = f" {unit}" if unit else ""
    if isinstance(value, str):
        return value
    known = interval is not None and all(map(math.isfinite, (value, *interval)))
    half = 0.5 * (interval[1] - interval[0]) if known else 0.0
    if not half > 0:
        return number(value) + unit
    size = math.floor(math.log10(half))
    # A leading 1 is given a second digit, which rounding would change by up to half.
    size -= half / 10**size < 1.95
    largest = max(abs(value), half)
    if largest >= 1e5 or largest < 1e-4:
        power = math.floor(math.log10(largest))
        digits = max(power - size, 0)
        scale = 10.0**power
        return (
            f"({value / scale:.{digits}f} +- {half / scale:.{digits}f})e{power}{unit}"
        )
    digits = max(-size, 0)
    return f"{round(value, -size):.{digits}f} +- {round(half, -size):.{digits}f}{unit}"


def parameter_text(effect):
    """Return "Fc = 1.2 +- 0.1 N m" for each parameter worth reading."""
    found = []
    for key, value in effect.parameters.items():
        if key in ("of", "other", "signal") or isinstance(value, tuple):
            continue
        interval = effect.intervals.get(key)
        # A share has no unit that anyone would write.
        unit = effect.units.get(key, "")
        unit = "" if unit == "1" else unit
        found.append(f"{key} = {with_error(value, interval, unit)}")
    return found


def join(parts, most=3, word="and"):
    """Write a list as a sentence does; what is beyond the most, if any, is counted."""
    parts = list(parts)
    if most is not None and len(parts) > most + 1:
        parts = [*parts[:most], f"{len(parts) - most} more"]
    if len(parts) <= 1:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def plural(count, noun):
    """Write a count with its noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def capital(text):
    """Begin a sentence; the name of a joint is not changed."""
    first = re.match(r"\S*", text)[0].rstrip(",:.")
    if re.search("joint|axis", first) and first not in ("joint", "joints", "axis"):
        return text
    return text[:1].upper() + text[1:]
