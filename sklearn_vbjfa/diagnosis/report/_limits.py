"""What the figures of a report hold for: their band, and what cannot be known.

Each function returns sentences on an outcome, none where there is nothing to say.
"""

import numpy as np

from sklearn_vbjfa.diagnosis.report import _words as words

# Share of a value that rounding leaves of it.
_ZERO = 1e-9
# Masses of which one is less than this share of the other do not agree.
_OTHER_MASS = 0.5
# Half width of a 90 % interval in standard deviations.
_HALF_WIDTH = 1.645

# -- the band ---------------------------------------------------------------------


def band_sentences(outcome, errors):
    """Say what the band of the errors is, why, what lies in it, and what above it.

    errors : mean errors of the verdict.
    """
    band = outcome.band
    if band is None:
        return ()
    return tuple(
        filter(None, (_reason(outcome, band), _content(band), _above(outcome, errors)))
    )


def _reason(outcome, band):
    """Say what the cut-off is and what decided it."""
    fastest = words.joint_label(outcome.joint_names, band.fastest)
    cutoff, bandwidth = words.number(band.cutoff, 2), words.number(band.bandwidth, 2)
    motion = (
        f"{bandwidth} Hz, below which 99 % of the power of the speed of {fastest} lies"
    )
    noise = ""
    if np.isfinite(band.smoothed_at):
        noise = f"; its position is smoothed at {words.number(band.smoothed_at, 2)} Hz"
        noise += ", where the motion meets the encoder noise"
    asked = f"; the motion asks for {words.number(band.automatic, 2)} Hz"
    if np.isnan(band.automatic):
        asked = ""
    elif np.isinf(band.automatic):
        asked = "; the motion asks for no low-pass"
    return {
        "motion": f"Errors are taken up to {cutoff} Hz: five times {motion} (the "
        f"fastest joint{noise}).",
        "length": f"Errors are taken up to {cutoff} Hz, as the low-pass has to be "
        f"short beside the recording; five times {motion}, would be less.",
        "given": f"Errors are taken up to {cutoff} Hz, as was asked for{asked}.",
        "none": f"Nothing is filtered, as was asked for{asked}; errors are those of "
        "the torque as recorded, and there is no wider band.",
        "states": "States were given, which are not filtered; errors are those of the "
        "torque as recorded, and there is no wider band.",
        "sample rate": f"Nothing is filtered, as five times {motion}, is too close to "
        "half the sample rate; errors are those of the torque as recorded, and there "
        "is no wider band.",
    }[band.decided_by]


def _content(band):
    """Say how much of speeds and torques lies in the band."""
    if not np.isfinite(band.cutoff):
        return ""
    shares = [
        _range(share)
        for share in (band.speed_share, band.torque_share)
        if np.isfinite(share).any()
    ]
    if len(shares) < 2:
        return ""
    return (
        f"That band holds {shares[0]} of the power of the speeds and {shares[1]} of "
        "that of the torques."
    )


def _range(shares):
    """Write the least and the largest of shares (nv,)."""
    known = np.sort(shares[np.isfinite(shares)])
    ends = [_share(value) for value in (known[0], known[-1])]
    return " to ".join(dict.fromkeys(ends))


def _share(value):
    """Write a share so that what is nearly all does not look like all."""
    if 0.999 <= value < 1.0:
        return "over 99.9 %"
    return words.percent(value)


def _above(outcome, errors):
    """Say what a controller meets above the band."""
    band = outcome.band
    if not np.isfinite(band.cutoff):
        return ""
    if not np.isfinite(outcome.wide_cutoff):
        rate = words.number(band.sample_rate)
        return f"{rate} samples a second leave no room for a wider band."
    wide = words.number(outcome.wide_cutoff, 2)
    text = f"A controller meets what lies above as well: up to {wide} Hz"
    if not (np.isfinite(errors.wide) and np.isfinite(errors.after)):
        return f"{text} nothing was identified."
    return (
        f"{text}, where nothing was identified, the mean error is "
        f"{words.percent(errors.wide)} instead of {words.percent(errors.after)}."
    )


# -- the projection ---------------------------------------------------------------


def projection_sentences(outcome):
    """Say what physically consistent parameters cost, and where that comes from."""
    price = outcome.projection
    if price is None or not price.costs.any():
        return ()
    names = outcome.joint_names
    costs = [
        f"{words.joint_label(names, j)} {words.percent(price.price[j])} of its torque "
        f"({words.bare_percent(price.free[j])} to {words.percent(price.held[j])})"
        for j in np.flatnonzero(price.costs)
    ]
    text = f"Bodies that are physically possible cost {words.join(costs, 6)}"
    pushed = [_pushed(one, names) for one in price.pushed]
    if pushed:
        text += f": {words.join(pushed, 3, 'or')}"
    cause = "a wrong gain of the torque channel, a wrong geometry or a missing effect"
    if price.channel is None:
        return f"{text}.", f"{words.capital(cause)} does that."
    channel = words.joint_label(names, price.channel)
    share = words.whole_percent(price.channel_share)
    return (
        f"{text}.",
        f"Of that, {share} goes if the torque of {channel} is left out: {cause} there "
        "does that.",
    )


def _pushed(one, names):
    """Say what is held back of a body or of a joint's friction."""
    joint = words.joint_label(names, one.joint)
    if one.kind == "body":
        text = f"{one.name} (the body of {joint}) is held at the border"
    else:
        text = f"the friction of {joint} is held at zero"
    if not one.parameter:
        return text
    # What is held at zero is there but for rounding.
    held = one.held if abs(one.held) > _ZERO * abs(one.free) else 0.0
    values = f"{words.number(one.free)} to {words.number(held)} {one.unit}"
    return f"{text} ({one.parameter} {values.rstrip()})"


# -- masses -----------------------------------------------------------------------


def mass_sentences(outcome):
    """Say which masses are not measured, and which are not those of the description."""
    return tuple(filter(None, (_unknown(outcome.bodies), _other(outcome.bodies))))


def _unknown(bodies):
    """Name the masses that the recording does not determine."""
    alone = [b for b in bodies if b.known == "no"]
    together = [b for b in bodies if b.known == "in combination"]
    if not alone and not together:
        return ""
    parts = []
    if alone:
        parts.append(f"{_names(alone, bodies)} (not at all)")
    if together:
        parts.append(f"{_names(together, bodies)} (only together with others)")
    text = f"Masses that this recording does not determine: {'; '.join(parts)}."
    text += " The files hold values that agree with the torques, not measured ones"
    odd = [b for b in bodies if b.known != "yes" and not _alike(b.mass, b.nominal)]
    odd.sort(key=lambda b: min(b.mass, b.nominal) / max(b.mass, b.nominal))
    values = [
        f"{b.name} {words.number(b.mass)} kg, where the robot description has "
        f"{words.number(b.nominal)} kg"
        for b in odd
    ]
    return f"{text}: {words.join(values)}." if values else f"{text}."


def _names(bodies, all_of_them):
    """Write the names of bodies; one word for all."""
    if len(bodies) == len(all_of_them) > 1:
        return "all bodies"
    return words.join([b.name for b in bodies], 6)


def _alike(mass, nominal):
    """Whether a mass may pass for that of the robot description."""
    return min(mass, nominal) >= _OTHER_MASS * max(mass, nominal)


def _other(bodies):
    """Name masses that are measured and are not those of the robot description."""
    heavy, light = [], []
    for body in bodies:
        off = body.mass - body.nominal
        half = _HALF_WIDTH * body.std
        if body.known == "yes" and abs(off) > half:
            value = words.with_error(body.mass, (body.mass - half, body.mass + half))
            text = f"{body.name} {value} kg instead of {words.number(body.nominal)} kg"
            (heavy if off > 0 else light).append(text)
    parts = [
        f"{way} than in the robot description: {words.join(found, 6)}"
        for way, found in (("heavier", heavy), ("lighter", light))
        if found
    ]
    return f"{words.capital('; '.join(parts))}." if parts else ""
