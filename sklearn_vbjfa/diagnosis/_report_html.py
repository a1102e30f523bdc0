"""A report as one self-contained page."""

from html import escape

import numpy as np

from sklearn_vbjfa.diagnosis import _report_lines as lines
from sklearn_vbjfa.diagnosis import _report_words as words
from sklearn_vbjfa.diagnosis import _verdict
from sklearn_vbjfa.diagnosis._report_pictures import residual_picture, time_axis
from sklearn_vbjfa.diagnosis._report_style import STYLE

_COLOURS = {
    "complete": "good",
    "nothing": "good",
    "partial": "warn",
    "exhausted": "warn",
    "unsettled": "warn",
    "unknown": "warn",
    "worse": "bad",
    "failed": "bad",
    "no data": "bad",
    "doubtful": "bad",
}
_JOINT_COLOURS = {"floor": "good", "worse": "bad", "failed": "bad", "no data": "bad"}
_ACTIONS = {
    "add": "added",
    "replace": "replaced",
    "drop": "dropped as superfluous",
    "refuse": "refused: does not hold on later data",
    "withdraw": "withdrawn: does harm on motion that it was not fitted to",
}
# Columns that are not broken, and names, which may be long.
_CELLS = dict.fromkeys(
    ("p", "parameters (90 %)", "saved", "squared error saved"), ' class="n"'
)
_CELLS |= dict.fromkeys(("joint", "effect"), ' class="name"')
# Candidates of a round that are listed; to_dict() has all.
_TRIED = 8


def page(report):
    """Return the whole page."""
    robot = escape(str(report.outcome.declared.get("robot", "robot")))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>What the model of {robot} lacks</title>\n"
        f"<style>body{{margin:0}}{STYLE}</style>\n</head>\n"
        f'<body class="vbjfa">\n{_main(report)}\n</body>\n</html>\n'
    )


def fragment(report):
    """Return the page's content with its style, for notebooks."""
    return f'<div class="vbjfa"><style>{STYLE}</style>{_main(report)}</div>'


def _main(report):
    parts = [
        _header(report),
        _joints(report),
        _effects(report),
        _open_questions(report),
        _pictures(report),
        _rounds(report),
        _settings(report),
    ]
    return f"<main>{''.join(parts)}</main>"


def _header(report):
    outcome = report.outcome
    before, after, floor = _verdict.mean_errors(outcome)
    totals = [
        (words.percent(before), "mean error before"),
        (words.percent(after), "after, on untouched data"),
    ]
    wide = _verdict.mean(np.where(outcome.enough, outcome.wide_after, np.nan))
    if np.isfinite(wide):
        band = words.number(outcome.wide_cutoff, 2)
        totals.append((words.percent(wide), f"after, up to {band} Hz"))
    if np.isfinite(floor):
        totals.append((words.percent(floor), "noise floor"))
    boxes = "".join(
        f"<div><b>{value}</b><span>{name}</span></div>" for value, name in totals
    )
    robot = outcome.declared.get("robot", "")
    return (
        f'<header class="{_COLOURS[report.status]}"><p class="kicker">'
        f"{_text(f'What the declared model of {robot} lacks')}</p>"
        f"<h1>{_text(report.headline)}</h1>"
        f'<div class="totals">{boxes}</div>{_causes(report)}</header>'
    )


def _causes(report):
    text = lines.causes_line(report.joints)
    return f'<p class="causes">{_text(text)}</p>' if text else ""


def _joints(report):
    outcome = report.outcome
    errors = np.r_[outcome.error_before, outcome.error_after, outcome.floor]
    errors = np.r_[errors, np.ravel(outcome.intervals.get("after", []))]
    errors = errors[np.isfinite(errors)]
    scale = float(errors.max()) if errors.size and errors.max() > 0 else 1.0
    rows = "".join(_joint(outcome, v, scale) for v in report.joints)
    key = (
        '<p class="note"><i class="key" style="background:var(--before)"></i>before'
        '<i class="key" style="background:var(--after)"></i>after; interval: '
        f"{_text(lines.interval_text(outcome.settings))}"
        '<i class="key" style="background:var(--floor);width:3px"></i>'
        "noise floor. Root mean square of the torque residual on data that was not "
        "touched before, over the standard deviation of the torque in the moving time "
        f"of the whole recording{_text(_band(outcome))}.</p>"
    )
    return f'<h2>Error of each joint</h2><div class="card">{rows}</div>{key}'


def _band(outcome):
    """Say which bands the errors are of."""
    if not np.isfinite(outcome.wide_cutoff):
        return ""
    fit = words.number(outcome.declared.get("cutoff", np.nan))
    return (
        f"; in the band of the fit, up to {fit} Hz. In the wider one, up to "
        f"{words.number(outcome.wide_cutoff, 2)} Hz, nothing was identified"
    )


def _joint(outcome, verdict, scale):
    j = verdict.joint
    before, after, floor = (
        float(x[j]) for x in (outcome.error_before, outcome.error_after, outcome.floor)
    )
    low, high = _verdict.interval(outcome, "after", j)

    def place(value):
        return f"{100 * min(max(value, 0.0) / scale, 1.0):.1f}%"

    tick = ""
    if np.isfinite(floor):
        tick = f'<i class="tick" style="left:{place(floor)}"></i>'
    span, reach = "", ""
    if np.isfinite(low) and np.isfinite(high):
        width = f"{100 * max(high - low, 0.0) / scale:.1f}%"
        reach = f'<i class="range" style="left:{place(low)};width:{width}"></i>'
        span = f" [{words.bare_percent(low)}, {words.bare_percent(high)}]"
    bars = ""
    for kind, value, extra, text in (
        ("before", before, "", ""),
        ("after", after, reach, span),
    ):
        fill = ""
        if np.isfinite(value):
            fill = f'<i class="fill {kind}" style="width:{place(value)}"></i>'
        bars += (
            f'<div class="bar"><div class="track">{fill}{extra}{tick}</div>'
            f"<span>{words.percent(value)}{text}</span></div>"
        )
    if np.isfinite(after):
        told = f"{words.number(after * outcome.spread[j], 2)} {outcome.torque_units[j]}"
        if np.isfinite(outcome.wide_after[j]):
            band = words.number(outcome.wide_cutoff, 2)
            told += f"; up to {band} Hz {words.percent(outcome.wide_after[j])}"
        bars += f'<p class="note">after: {_text(told)}</p>'
    colour = _JOINT_COLOURS.get(verdict.status, "warn")
    return (
        f'<div class="joint"><b>{_text(verdict.label)}</b>'
        f'<div class="bars">{bars}</div>'
        f'<span class="{colour}-text">{_text(verdict.text)}</span></div>'
    )


def _effects(report):
    outcome = report.outcome
    if not outcome.effects:
        return ""
    rows = []
    for e in outcome.effects:
        rivals = [words.PLAIN_NAMES.get(r, r) for r in e.rivals]
        parameters = "<br>".join(map(_text, words.parameter_text(e)))
        gain = words.whole_percent(e.evidence.gain)
        rows.append(
            [
                _text(words.joint_label(outcome.joint_names, e.joint)),
                _text(words.effect_label(e.name, e.parameters, outcome.joint_names)),
                parameters,
                f"{gain} +- {words.whole_percent(e.evidence.gain_std)}",
                _text(words.p_cell(e.evidence.p_value)),
                _text(words.join(rivals, 4, "or")),
            ]
        )
    heads = [
        "joint",
        "effect",
        "parameters (90 %)",
        "squared error saved",
        "p",
        "cannot be told from",
    ]
    table = _table(heads, rows)
    return f'<h2>Effects that were missing</h2><div class="card">{table}</div>'


def _open_questions(report):
    outcome = report.outcome
    names = outcome.joint_names
    groups = lines.unexplained_groups(outcome.unexplained)
    rest = [lines.unexplained_line(group, names) for group in groups]
    advice = lines.next_recording(outcome)
    hidden = lines.hidden_lines(outcome.hidden, names, most=20)
    out = ""
    for title, items in (
        ("Unexplained", rest),
        ("Record next", advice),
        ("Not visible in this recording", hidden),
        ("Channels", [c.message for c in outcome.channels]),
    ):
        if items:
            entries = "".join(f"<li>{_text(item)}</li>" for item in items)
            out += f'<h2>{title}</h2><div class="card"><ul>{entries}</ul></div>'
    return out


def _pictures(report):
    outcome = report.outcome
    if not {"before", "after", "weight", "torque"} <= set(outcome.curves):
        return ""
    figures = []
    axis = time_axis(outcome.curves)
    time = (
        "Untouched part, one stretch after the other, over time in seconds"
        if axis
        else "Untouched part in the order of its samples"
    )
    for v in report.joints:
        svg, limit = residual_picture(outcome.curves, v.joint, outcome.floor[v.joint])
        if svg:
            unit = outcome.torque_units[v.joint]
            figures.append(
                f"<figure><figcaption><b>{_text(v.label)}</b>"
                f"<span>&#177;{words.number(limit, 2)} {_text(unit)}</span>"
                f"</figcaption>{svg}{axis}</figure>"
            )
    if not figures:
        return ""
    return (
        f'<h2>Torque residuals</h2><div class="pictures">{"".join(figures)}</div>'
        '<p class="note"><i class="key" style="background:var(--before)"></i>before'
        '<i class="key" style="background:var(--after)"></i>after'
        '<i class="key" style="background:var(--floor);opacity:.5"></i>noise floor, '
        f"one standard deviation. {time}; gaps where the joint stands still.</p>"
    )


def _rounds(report):
    outcome = report.outcome
    names = outcome.joint_names
    if not outcome.rounds:
        return ""
    rows = []
    for i, r in enumerate(outcome.rounds, 1):
        label = words.effect_label(r.name, r.shape, names)
        action = _ACTIONS.get(r.action, r.action)
        if r.replaced:
            action = f"replaced {words.PLAIN_NAMES.get(r.replaced, r.replaced)}"
        j = r.joint
        rivals = words.join(
            [words.PLAIN_NAMES.get(t.name, t.name) for t in r.rivals], 4
        )
        rows.append(
            [
                str(i),
                _text(words.joint_label(names, j)),
                _text(label),
                _text(action),
                words.whole_percent(r.evidence.gain),
                _text(words.p_cell(r.evidence.p_value)),
                _text(lines.rule_text(r)),
                f"{words.whole_percent(r.evidence.helped)} of {r.evidence.n_blocks}",
                f"{words.bare_percent(r.error_before[j])} to "
                f"{words.bare_percent(r.error_after[j])} %",
                _text(rivals) + _tried(r, names),
            ]
        )
    heads = [
        "no.",
        "joint",
        "effect",
        "step",
        "saved",
        "p",
        "rule",
        "blocks helped",
        "error in the search part",
        "rivals",
    ]
    table = _table(heads, rows)
    return f'<h2>Steps of the search</h2><div class="card">{table}</div>'


def _tried(step, names):
    if not step.tried:
        return ""
    entries = "".join(
        f"<li>{_text(words.effect_label(t.name, t.shape, names))}: "
        f"{words.whole_percent(t.evidence.gain)}</li>"
        for t in step.tried[:_TRIED]
    )
    more = len(step.tried) - _TRIED
    if more > 0:
        entries += f"<li>{more} more</li>"
    return f"<details><summary>tried</summary><ul>{entries}</ul></details>"


def _settings(report):
    outcome = report.outcome
    settings = outcome.settings
    items = {
        "Split and thresholds": " ".join(
            [lines.short_line(outcome), *lines.settings_lines(settings)]
        ),
        "Declared model": lines.declared_line(outcome.declared),
        "Looked for": _short(settings.get("effects", ())),
        "Model in the files": "fitted to all data after the errors were taken, in the "
        "same band",
        "Seed": settings.get("random_state", ""),
        "Versions": ", ".join(
            f"{name} {version}"
            for name, version in settings.get("versions", {}).items()
        ),
    }
    entries = "".join(
        f"<dt>{key}</dt><dd>{_text(value)}</dd>"
        for key, value in items.items()
        if value not in ("", None)
    )
    return f'<h2>Settings</h2><div class="card"><dl>{entries}</dl></div>'


def _short(value):
    if isinstance(value, (list, tuple)):
        return ", ".join(map(str, value)) or "none"
    return words.number(value) if isinstance(value, float) else str(value)


def _table(heads, rows):
    """Return a table that becomes a list of entries on a narrow screen."""
    head = "".join(f"<th>{h}</th>" for h in heads)
    body = ""
    for row in rows:
        cells = "".join(
            f'<td{_CELLS.get(h, "")} data-name="{h}">{_nice(cell)}</td>'
            for h, cell in zip(heads, row)
        )
        body += f"<tr>{cells}</tr>"
    return (
        f'<div class="scroll"><table class="stack"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _text(value):
    return _nice(escape(str(value)))


def _nice(text):
    for plain, sign in (
        ("+-", "&#177;"),
        ("^2", "&#178;"),
        ("^3", "&#179;"),
        # A number and its sign stay on one line.
        (" %", "\u00a0%"),
    ):
        text = text.replace(plain, sign)
    return text
