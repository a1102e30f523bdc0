"""Labels and number formats of a report."""

import functools
import math
import re

import numpy as np

from sklearn_vbjfa.effects import Bank, OfRobot

_MIN_P = 1e-12
# Logarithm of the odds of a million to one.
_MAX_LOG_ODDS = math.log(1e6)
# Intervals whose centre differs by more than this share of the half-width have no sign.
_SKEWED = 0.1


def joint_label(names, joint):
    """Return the name of a joint for a sentence, or its number, counted from 1."""
    name = " ".join(names[joint].split()) if joint < len(names) else ""
    counted = re.fullmatch(r"joint[ _]?(\d+)", name)
    if not name or name.isdigit() or (counted and int(counted[1]) == joint + 1):
        return f"joint {joint + 1}"
    labelled = re.search("joint|axis", name, re.IGNORECASE)
    return name if labelled else f"joint {joint + 1} ({name})"


def joint_list(names, joints, most=3):
    """Format several joints, by number if possible; most: maximum of names."""
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
    """Return the label of a signal, such as "speed of joint2", for a joint."""
    kind, _, name = signal.partition(" of ")
    if not name or name not in names:
        return signal
    other = list(names).index(name)
    return f"its {kind}" if other == joint else f"{kind} of {joint_label(names, other)}"


def effect_label(outcome, name, shape=None):
    """Describe an effect of an outcome in plain English, with its shape."""
    joint = functools.partial(joint_label, outcome.robot["joints"])
    return outcome.robot["library"][name].describe(shape or {}, joint)


def place_label(outcome, name, joint):
    """Return the place of an effect: its joint, or the robot."""
    if isinstance(outcome.robot["library"][name], OfRobot):
        return "robot"
    return joint_label(outcome.robot["joints"], joint)


def effect_at(outcome, name, joint, shape=None):
    """Describe an effect with its joint, if it has one."""
    label, place = effect_label(outcome, name, shape), place_label(outcome, name, joint)
    return label if place == "robot" else f"{label} on {place}"


def rival_labels(outcome, effect):
    """Describe the rivals of an effect, with their joints if these differ."""
    here = place_label(outcome, effect.name, effect.joint)
    labels = (effect_at(outcome, **rival) for rival in effect.trials)
    return list(dict.fromkeys(x.removesuffix(f" on {here}") for x in labels))


def number(value, digits=3):
    """Format a number briefly, with an exponent only if necessary."""
    if value is None or not math.isfinite(value):
        return "?"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if -5 <= int(exponent) < 5:
        rounded = float(f"{mantissa}e{exponent}")
        return np.format_float_positional(rounded, trim="-")
    return f"{float(mantissa):g}e{int(exponent)}"


def percent(value, digits=1):
    """Format a share in per cent, with one decimal if it is below 100 %."""
    if value is None or not math.isfinite(value):
        return "?"
    return f"{100 * value:.{digits * (abs(value) < 0.9995)}f} %"


def bare_percent(value):
    """Format a share in per cent without the sign, for a table."""
    return "-" if value is None or not math.isfinite(value) else f"{100 * value:.1f}"


whole_percent = functools.partial(percent, digits=0)


def p_text(value):
    if value < _MIN_P:
        return "p < 1e-12"
    return f"p = {number(value, 1 if value < 0.01 else 2)}"


def odds_text(log_odds):
    """Format odds, given their logarithm: "350 : 1"."""
    if abs(log_odds) > _MAX_LOG_ODDS:
        return "> 1e6 : 1" if log_odds > 0 else "< 1 : 1e6"
    odds = f"{number(math.exp(abs(log_odds)), 2)}"
    return f"{odds} : 1" if log_odds >= 0 else f"1 : {odds}"


def with_error(value, interval=None, unit=""):
    """Format a value with its 90 % interval, by the half-width if symmetric."""
    unit = f" {unit}" if unit else ""
    if isinstance(value, str):
        return value
    finite = interval is not None and all(map(math.isfinite, (value, *interval)))
    half = 0.5 * (interval[1] - interval[0]) if finite else 0.0
    if not half > 0:
        return number(value) + unit
    if interval[0] == 0:
        return f"< {number(interval[1], 2)}{unit}"
    if interval[0] > 0 and abs(0.5 * sum(interval) - value) > _SKEWED * half:
        return f"{number(value)} ({' to '.join(number(x, 2) for x in interval)}){unit}"
    size = math.floor(math.log10(half))
    # A leading 1 gets a second digit: rounding it would change the value by up to half.
    size -= half / 10**size < 1.95
    largest = max(abs(value), half)
    if largest >= 1e5 or largest < 1e-4:
        power = math.floor(math.log10(largest))
        digits = max(power - size, 0)
        scale = 10.0**power
        pair = f"{value / scale:.{digits}f} +- {half / scale:.{digits}f}"
        return f"({pair})e{power}{unit}"
    digits = max(-size, 0)
    return f"{round(value, -size):.{digits}f} +- {round(half, -size):.{digits}f}{unit}"


def parameter_text(effect):
    """Return "Fc = 1.2 +- 0.1 N m" for each scalar parameter."""
    texts, hidden, determined = [], [], effect.is_determined
    intervals = effect.intervals if determined else effect.intervals_given_shape
    shape = effect.parameters if effect.effect is None else effect.effect.shape()
    omitted = {"of", "other", "signal"}
    if isinstance(effect.effect, Bank):
        # Elements that may be absent, and the Stribeck speed without any that fall.
        omitted |= {key for key, (low, high) in intervals.items() if low < 0 < high}
        omitted |= {"vs"} if "Fs" in omitted else set()
    for key, value in effect.parameters.items():
        if key in omitted or isinstance(value, tuple):
            continue
        if value != value or not (key in intervals or key in shape):
            hidden.append(key)
            continue
        # Ratios are written without a unit.
        unit = effect.units.get(key, "").removeprefix("1")
        text = with_error(value, intervals.get(key), unit)
        texts.append(f"{key} {'' if text.startswith('<') else '= '}{text}")
    texts += [f"{join(hidden)} not identifiable"] * bool(hidden)
    if effect.effect is not None and effect.effect.constant:
        texts.append("torque offset included")
    if not determined:
        texts.append("its form is not determined (intervals for this form)")
    return texts


def join(parts, most=3, word="and"):
    """Join a list for a sentence; items beyond the maximum, if any, are counted."""
    parts = list(parts)
    if most is not None and len(parts) > most + 1:
        parts = [*parts[:most], f"{len(parts) - most} more"]
    if len(parts) <= 1:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def plural(count, noun):
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def capital(text):
    """Capitalise the first letter of a sentence, unless it is a joint name."""
    first = re.match(r"\S*", text)[0].rstrip(",:.")
    if re.search("joint|axis", first) and first not in ("joint", "joints", "axis"):
        return text
    return text[:1].upper() + text[1:]
