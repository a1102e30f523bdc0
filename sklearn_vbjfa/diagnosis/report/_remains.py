"""What is said of what remains: at the floor, of a form without a name, or neither.

There is one statement on each joint. Those on joints above their floor are drawn from
what functions of any form explain, see `Ceiling`.
"""

import math
from dataclasses import dataclass

from sklearn_vbjfa.diagnosis.report import _words as words

# A share below this is hardly worth an effect.
_LITTLE = 0.1
# Fewer signals are named if they explain this share of what more explain.
_MOST = 0.8
_FORMS = (
    "a function of speed and load",
    "a function of its own state and history",
    "the motion of other joints",
)


@dataclass(frozen=True, kw_only=True)
class Remains:
    """What remains of a joint's residual."""

    # whether a function explains it, one does within a recording only, or none does
    kind: str
    source: int  # fewest signals that do, as an index of a `Ceiling`'s shares
    share: float  # share of the squared residual that they explain


def remains(outcome, joint):
    """Return what remains of a joint above its floor; None if it is not known."""
    own = next((c for c in outcome.ceiling if c.joint == joint), None)
    if own is None or math.isnan(own.share[-1]):
        # Too short to be judged.
        return None
    kind, shares = "form", own.share
    if shares[-1] < _LITTLE:
        again = not math.isnan(own.across[-1]) and own.within[-1] >= _LITTLE
        kind = "recording" if again else "nothing"
        shares = own.within if again else shares
    source = next(k for k, x in enumerate(shares) if x >= _MOST * shares[-1])
    return Remains(kind=kind, source=source, share=shares[source])


def has_picture(found):
    """Whether a map over speed and load shows what remains."""
    return found is not None and found.kind == "form" and found.source == 0


def statement(alike, floor):
    """Say in a sentence what remains."""
    # alike: `Remains` of joints of which the same is said; one alone if it is a form.
    # floor: noise floor of one of them, nan if unknown.
    first = alike[0]
    if first.kind == "form":
        return (
            f"{_FORMS[first.source]} explains {words.whole_percent(first.share)} of "
            "what remains: no effect of the library has that form"
        )
    shares = sorted(found.share for found in alike)
    if first.kind == "recording":
        ends = dict.fromkeys(words.whole_percent(x) for x in (shares[0], shares[-1]))
        return (
            f"{' to '.join(ends)} of what remains repeats within a recording, nothing "
            "in the next one: temperature, or what else changed in between"
        )
    repeats = "does not repeat" if shares[-1] == 0 else "hardly repeats"
    if floor > 0:
        return f"what remains {repeats}: temperature, unmeasured load, or noise"
    return f"what remains {repeats}; whether it is noise is not known"


def short_statement(alike):
    """Say the same in a few words, for a row of a table."""
    first = alike[0]
    if first.kind == "form":
        return f"{_FORMS[first.source]} ({words.whole_percent(first.share)})"
    if first.kind == "recording":
        return "repeats within a recording only"
    return "does not repeat" if first.share == 0 else "hardly repeats"


def of_joint(outcome, joint, text):
    """Return the statement on a joint, `text` for one that has no ceiling."""
    found = remains(outcome, joint)
    if found is None:
        return text
    floor = next(u.floor for u in outcome.unexplained if u.joint == joint)
    return statement([found], floor)


def record_next(outcome):
    """Return what to record where what remains does not repeat, joints by advice."""
    advice = words.record_for_signal("time")
    found = [u.joint for u in outcome.unexplained if _changes(outcome, u)]
    return {advice: found} if found else {}


def _changes(outcome, rest):
    """Whether what remains of a joint is there, and changes with time."""
    found = remains(outcome, rest.joint)
    if found is None or found.kind == "form":
        return False
    return found.kind == "recording" or rest.floor > 0
