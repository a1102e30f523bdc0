"""The report of a search for effects: verdict first, then the evidence.

A report as plain data.
"""

import dataclasses
import math
import numbers
import textwrap

import numpy as np
from sklearn.base import BaseEstimator
from tabulate import tabulate

from sklearn_vbjfa.diagnosis.report import _lines as lines
from sklearn_vbjfa.diagnosis.report import _verdict
from sklearn_vbjfa.diagnosis.report import _words as words

SCHEMA_VERSION = 3


def as_data(report):
    """Everything in a report but its curves, as JSON knows it."""
    outcome = report.outcome
    data = {
        "schema_version": SCHEMA_VERSION,
        "status": report.status,
        "headline": report.headline,
        "verdict": report.verdict,
        "joints": plain(report.joints),
    }
    for field in dataclasses.fields(outcome):
        if field.name != "curves":
            data[field.name] = plain(getattr(outcome, field.name))
    return data


def plain(value):
    """Turn a value into what JSON knows; nan and infinity become None."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(one) for one in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    if isinstance(value, BaseEstimator):
        parameters = value.get_params(deep=False)
        return {"class": type(value).__name__, "parameters": plain(parameters)}
    return str(value)


_WIDTH, _HEIGHT = 100, 25
# Lines of a list that are shown before any other list gets more.
_FEWEST = {"joints": 6, "effects": 3, "unexplained": 2}
_SEE = "see to_dict()"


class Report:
    """What a robot model lacked, what that was worth, and what is still open.

    ``print(report)`` is for a terminal, at most 25 lines; a notebook shows the page
    of `to_html`.

    Parameters
    ----------
    outcome : Outcome
        What the search found.

    Attributes
    ----------
    outcome : Outcome
        The same.
    joints : tuple of JointVerdict
        Verdict on each joint.
    status : {"complete", "nothing", "partial", "exhausted", "unsettled", "unknown", \
            "worse", "failed", "no data", "doubtful"}
        Effects found and only noise left; nothing was missing; effects found and
        something remains; nothing found though something is missing; at the noise
        floor in the search but not on untouched data; no noise floor to compare with;
        a joint got worse on untouched data; a joint is predicted worse than by its
        mean torque; nothing to judge by; a channel of the recording is wrong.
    headline, verdict : str
        The same in words, without and with the mean errors.

    See Also
    --------
    sklearn_vbjfa.EffectDiscovery : Makes reports.
    """

    def __init__(self, outcome):
        self.outcome = outcome
        self.joints = _verdict.joint_verdicts(outcome)
        self.status = _verdict.status(outcome, self.joints)
        self.headline = _verdict.headline(outcome, self.joints)
        self.verdict = f"{self.headline} {_verdict.errors_text(outcome)}".rstrip()

    def __repr__(self):
        before, after, _ = _verdict.mean_errors(self.outcome)
        count = words.plural(len(self.outcome.effects), "effect")
        return (
            f"<Report: {self.status}, {count}, mean error {words.percent(before)} "
            f"before, {words.percent(after)} after>"
        )

    def __str__(self):
        head = textwrap.wrap(self.verdict, _WIDTH)
        if len(head) > 5 and self.status != "doubtful":
            errors = _verdict.errors_text(self.outcome)
            head = _wrapped(self.headline, 3) + _wrapped(errors, 2)
        tail, _ = self._closing(0)
        lists = {
            "joints": self._joint_order(),
            "effects": list(self.outcome.effects),
            "unexplained": lines.unexplained_groups(self._unexplained_order()),
        }
        room = _HEIGHT - len(head) - len(tail) - 1
        share = _share_out({k: len(v) for k, v in lists.items()}, room)
        # A second line for what does not fit one, as long as there is room.
        spare = room - sum(share.values()) - 2
        tail, spare = self._closing(spare)
        effects, spare = self._effect_lines(lists["effects"], share["effects"], spare)
        unexplained, _ = self._unexplained_lines(
            lists["unexplained"], share["unexplained"], spare
        )
        table = self._joint_table(lists["joints"], share["joints"])
        body = [table, effects, unexplained]
        return "\n".join(_spaced([head, *body, tail]))

    # -- parts of the text ----------------------------------------------------------

    def _joint_order(self):
        """Joints, those with something to say first where not all can be shown."""
        rank = ("failed", "worse", "unexplained", "above", "unknown", "few", "no data")
        first = {status: k for k, status in enumerate(rank)}
        return sorted(
            self.joints,
            key=lambda v: (first.get(v.status, len(rank)), -v.n_effects, v.joint),
        )

    def _unexplained_order(self):
        return sorted(
            self.outcome.unexplained, key=lambda u: (not u.floor > 0, -u.of_torque)
        )

    def _joint_table(self, order, count):
        rest = order[count:] if count < len(order) else []
        if rest:
            order, rest = order[: count - 1], order[count - 1 :]
        rows = [self._row(v) for v in sorted(order, key=lambda v: v.joint)]
        outcome = self.outcome
        units = "/".join(dict.fromkeys(outcome.torque_units))
        headers = ["untouched error, %", "before", "after [90 %]", units, "floor"]
        if np.isfinite(outcome.wide_cutoff):
            headers.append(f"to {words.number(outcome.wide_cutoff, 2)} Hz")
        table = tabulate(
            rows,
            headers=[*headers, ""],
            tablefmt="plain",
            disable_numparse=True,
            colalign=("left", *["right"] * (len(headers) - 1), "left"),
        ).splitlines()
        table = [words.clip(line.rstrip(), _WIDTH) for line in table]
        if rest:
            kinds = sorted({v.text for v in rest})
            table.append(
                words.clip(
                    f"... and {len(rest)} more ({words.join(kinds, 2)}), {_SEE}", _WIDTH
                )
            )
        return table

    def _row(self, verdict):
        outcome, j = self.outcome, verdict.joint
        low, high = _verdict.interval(outcome, "after", j)
        after = words.bare_percent(outcome.error_after[j])
        if np.isfinite(low) and np.isfinite(high):
            after += f" [{words.bare_percent(low)}, {words.bare_percent(high)}]"
        wide = []
        if np.isfinite(outcome.wide_cutoff):
            wide = [words.bare_percent(outcome.wide_after[j])]
        return [
            words.clip(verdict.label, 24),
            words.bare_percent(outcome.error_before[j]),
            after,
            words.number(outcome.error_after[j] * outcome.spread[j], 2),
            words.bare_percent(outcome.floor[j]),
            *wide,
            verdict.text,
        ]

    def _effect_lines(self, effects, count, spare):
        shown, rest = _cut(effects, count)
        names = self.outcome.joint_names
        out = []
        for e in shown:
            forms = [f"- {form}" for form in lines.effect_forms(e, names)]
            fitting = [form for form in forms if len(form) <= _WIDTH]
            complete = fitting and fitting[0] in forms[: lines.COMPLETE]
            both = [
                textwrap.wrap(form, _WIDTH, subsequent_indent="    ")
                for form in forms[:2]
            ]
            both = [pieces for pieces in both if len(pieces) == 2]
            if not complete and both and spare > 0:
                spare -= 1
                out += both[0]
            else:
                out.append((fitting or [words.clip(forms[-1], _WIDTH)])[0])
        if rest:
            where = words.joint_list(names, [e.joint for e in rest])
            out.append(
                words.clip(f"... and {len(rest)} more on {where}, {_SEE}", _WIDTH)
            )
        return out, spare

    def _unexplained_lines(self, groups, count, spare):
        shown, rest = _cut(groups, count)
        out = []
        for group in shown:
            full = f"? {lines.unexplained_line(group, self.outcome.joint_names)}"
            pieces = textwrap.wrap(full, _WIDTH, subsequent_indent="    ")
            if len(pieces) == 2 and spare > 0:
                spare -= 1
                out += pieces
            else:
                out.append(words.clip(full, _WIDTH))
        if rest:
            more = words.plural(sum(map(len, rest)), "more joint")
            out.append(f"... and {more}, {_SEE}")
        return out, spare

    def _closing(self, spare):
        """Say what to record next, what is wrong with channels, what was split.

        Lines that are to spare go to what would be cut, what matters most first;
        returned are the lines and what is still to spare.
        """
        # Doubts are in the headline.
        found = [c.message for c in self.outcome.channels if c.severity != "doubt"]
        channels, more = " ".join(found[:1]).split(), len(found) - 1
        advice = lines.next_recording(self.outcome)
        hidden = lines.hidden_lines(self.outcome.hidden, self.outcome.joint_names)
        # Text, the lines it has at least, and its rank.
        entries = [
            (lines.causes_line(self.joints), 2, 0),
            (f"Record next: {words.join(advice, 3)}." if advice else "", 2, 2),
            (" ".join(hidden), 2, 3),
            (lines.short_line(self.outcome), 1, 2),
            (lines.refused_line(self.outcome), 1, 4),
            (
                (f"Channel ({more} more): " if more > 0 else "Channel: ")
                + " ".join(channels)
                if channels
                else "",
                1,
                1,
            ),
            *((line, 1, 5) for line in lines.settings_lines(self.outcome.settings)),
        ]
        most = [least for _, least, _ in entries]
        for k in sorted(range(len(entries)), key=lambda k: entries[k][2]):
            short = len(textwrap.wrap(entries[k][0], _WIDTH)) - most[k]
            extra = min(max(short, 0), max(spare, 0))
            most[k] += extra
            spare -= extra
        out = [
            line
            for (text, *_), count in zip(entries, most)
            for line in _wrapped(text, count)
        ]
        return out, spare

    # -- other forms ----------------------------------------------------------------

    def to_dict(self):
        """Return everything but the curves, ready for `json.dumps`.

        Returns
        -------
        dict
            Lists instead of arrays, None instead of nan, joints from zero;
            ``"schema_version"`` changes when keys do.
        """
        return as_data(self)

    def to_markdown(self):
        """Return the report as Markdown.

        Returns
        -------
        str
            Tables and lists.
        """
        from sklearn_vbjfa.diagnosis.report._markdown import markdown

        return markdown(self)

    def to_html(self):
        """Return the report as one self-contained page.

        Returns
        -------
        str
            HTML with its style and pictures inside; nothing is loaded from elsewhere.
        """
        from sklearn_vbjfa.diagnosis.report._html import page

        return page(self)

    def _repr_html_(self):
        from sklearn_vbjfa.diagnosis.report._html import fragment

        return fragment(self)


def _wrapped(text, most):
    """Wrap a text to at most some lines."""
    if not text:
        return []
    found = textwrap.wrap(text, _WIDTH)
    if len(found) > most:
        last = words.clip(" ".join(found[most - 1 :]), _WIDTH)
        found = [*found[: most - 1], last]
    return found


def _cut(items, count):
    """Split a list at a number of lines, one of which says how many are missing."""
    if len(items) <= count:
        return items, []
    return items[: max(count - 1, 0)], items[max(count - 1, 0) :]


def _share_out(wanted, room):
    """Lines for each list: the fewest first, then what is left, one at a time."""
    share = {k: min(n, _FEWEST[k]) for k, n in wanted.items()}
    while sum(share.values()) > room:
        # Only when the closing lines are many.
        most = max(share, key=share.get)
        share[most] -= 1
    while sum(share.values()) < room:
        short = [
            k for k in ("joints", "effects", "unexplained") if share[k] < wanted[k]
        ]
        if not short:
            break
        for k in short:
            if sum(share.values()) < room:
                share[k] += 1
    return share


def _spaced(parts):
    """Put empty lines between the parts, as far as there is room."""
    parts = [p for p in parts if p]
    spare = _HEIGHT - sum(map(len, parts))
    out = list(parts[0])
    # The verdict and the closing lines are set off first.
    gaps = [i for i in (1, len(parts) - 1, *range(2, len(parts) - 1)) if 0 < i]
    empty = set(list(dict.fromkeys(gaps))[: max(spare, 0)])
    for i, part in enumerate(parts[1:], 1):
        out += [""] * (i in empty) + part
    return out
