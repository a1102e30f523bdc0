"""The ranges that effects were fitted on, in words, and the section on leaving them."""

from sklearn_vbjfa.diagnosis.report import _words as words

_WHERE = {"position": "positions", "speed": "speeds", "load": "loads"}
# A speed below this share of the fastest is that of a reversal.
_SLOW = 0.1
# An end that is this small a share of the other is zero.
_ZERO = 1e-3
_UNITS = {"position": ("rad", "m"), "speed": ("rad/s", "m/s"), "load": ("N m", "N")}


def range_text(outcome, joint, quantity, pair):
    """Write a range with its unit, "-1.2 to 1.3 rad"."""
    unit = _UNITS[quantity][int(outcome.torque_units[joint] == "N")]
    width = max(map(abs, pair))
    low, high = (words.number(0.0 if abs(x) < _ZERO * width else x) for x in pair)
    if quantity == "speed" and pair[0] < _SLOW * pair[1]:
        return f"up to {high} {unit}"
    return f"{low} to {high} {unit}"


def _one_way(known):
    """Say which way a joint moved; empty if both ways."""
    low, high = known.direction
    if low >= 0:
        return "forward motion only"
    return "backward motion only" if high <= 0 else ""


def known_for(outcome, effect):
    """Say for which motion an effect is known; empty where it does not matter."""
    known = effect.ranges
    if known is None:
        return ""
    told = [
        f"{_WHERE[quantity]} of "
        f"{range_text(outcome, effect.joint, quantity, getattr(known, quantity))}"
        for quantity in known.depends
        if quantity in _UNITS
        if getattr(known, quantity)[0] <= getattr(known, quantity)[1]
    ]
    if "direction" in known.depends:
        told += filter(None, [_one_way(known)])
    return f"fitted on {words.join(told)}" if told else ""


def outside_sentences(outcome):
    """Say where the untouched part leaves what effects were fitted on."""
    found = []
    for one in outcome.outside:
        labels = [words.effect_label(outcome, name) for name in one.names]
        if one.quantity == "direction":
            way = "forward" if one.reached > 0 else "backward"
            what = f"moves {way}, fitted on the other direction only"
        else:
            fitted = range_text(outcome, one.joint, one.quantity, one.fitted)
            reached = words.number(one.reached)
            what = f"{one.quantity} reaches {reached}, fitted on {fitted}"
        found.append(
            f"{words.joint_label(outcome.joint_names, one.joint)}: {what} "
            f"({words.percent(one.share)} of the rows; {words.join(labels)})"
        )
    return tuple(found)


def afterwards_text(effect):
    """Say what an effect of time is taken to do after the recording; else empty."""
    known = effect.afterwards
    if known is None:
        return ""
    when = f"after {words.number(known.seconds)} s"
    left = [
        words.with_error(value, known.intervals.get(name), effect.units.get(name, ""))
        for name, value in known.left.items()
    ]
    return f"{when} it {known.how}" + (f" from {words.join(left)}" if left else "")
