"""A report as one self-contained page.

Style sheet of the report's page; every rule stays inside the report.

Pictures of a report as inline SVG, coloured by the page that holds them.
"""

from html import escape

import numpy as np

from sklearn_vbjfa.diagnosis.report import _lines as lines
from sklearn_vbjfa.diagnosis.report import _verdict
from sklearn_vbjfa.diagnosis.report import _words as words

STYLE = """
.vbjfa{--ink:#1c2430;--soft:#5b6675;--line:#dde2e9;--card:#fff;--page:#f5f7fa;
--before:#a9b2bf;--after:#1f6feb;--floor:#f0b429;--good:#1a7f4b;--warn:#b45309;
--bad:#c2273b;color:var(--ink);background:var(--page);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;
padding:clamp(12px,3vw,32px);text-align:left}
@media (prefers-color-scheme:dark){.vbjfa{--ink:#e6eaf0;--soft:#9aa6b5;
--line:#333c48;--card:#1b212a;--page:#12161c;--before:#67717f;--after:#58a6ff;
--floor:#c9971c;--good:#4ac585;--warn:#e8a33d;--bad:#ff7b88}}
.vbjfa *{box-sizing:border-box}
.vbjfa main{max-width:1080px;margin:0 auto}
.vbjfa header{background:var(--card);border:1px solid var(--line);
border-left:6px solid var(--soft);border-radius:10px;padding:16px 20px}
.vbjfa header.good{border-left-color:var(--good)}
.vbjfa header.warn{border-left-color:var(--warn)}
.vbjfa header.bad{border-left-color:var(--bad)}
.vbjfa .kicker{color:var(--soft);font-size:13px;margin:0}
.vbjfa h1{font-size:clamp(18px,2.6vw,23px);line-height:1.35;margin:4px 0 0;
font-weight:650;overflow-wrap:anywhere}
.vbjfa h2{font-size:17px;margin:28px 0 8px;font-weight:650}
.vbjfa p{margin:6px 0}
.vbjfa .note{color:var(--soft);font-size:13px}
.vbjfa .card{background:var(--card);border:1px solid var(--line);border-radius:10px;
padding:12px 16px}
.vbjfa .totals{display:flex;flex-wrap:wrap;gap:8px 28px;margin:12px 0 0}
.vbjfa .totals b{display:block;font-size:22px;font-weight:650;
font-variant-numeric:tabular-nums}
.vbjfa .totals span{color:var(--soft);font-size:13px}
.vbjfa .joint{display:grid;grid-template-columns:minmax(80px,140px) 1fr 180px;
gap:4px 16px;align-items:center;padding:9px 0;border-bottom:1px solid var(--line)}
.vbjfa .joint:last-child{border-bottom:0}
.vbjfa .joint b{overflow-wrap:anywhere;font-weight:600}
.vbjfa .bars{position:relative;min-width:0}
.vbjfa .bar{display:grid;grid-template-columns:1fr 132px;gap:10px;align-items:center;
font-size:13px;font-variant-numeric:tabular-nums}
.vbjfa .track{position:relative;height:9px}
.vbjfa .fill{position:absolute;inset:0 auto 0 0;border-radius:2px;min-width:2px}
.vbjfa .fill.before{background:var(--before)}
.vbjfa .fill.after{background:var(--after)}
.vbjfa .range{position:absolute;top:3px;height:3px;background:var(--ink);opacity:.55}
.vbjfa .tick{position:absolute;top:-3px;bottom:-3px;width:2px;background:var(--floor)}
.vbjfa .key{display:inline-block;width:12px;height:9px;border-radius:2px;
margin:0 5px 0 12px}
.vbjfa .key:first-child{margin-left:0}
.vbjfa .good-text{color:var(--good)}
.vbjfa .warn-text{color:var(--warn)}
.vbjfa .bad-text{color:var(--bad);font-weight:600}
.vbjfa .scroll{overflow-x:auto}
.vbjfa table{border-collapse:collapse;width:100%;font-size:14px;background:none}
.vbjfa th,.vbjfa td{text-align:left;padding:7px 14px 7px 0;vertical-align:top;
border-bottom:1px solid var(--line);background:none;color:inherit}
.vbjfa tr:last-child td{border-bottom:0}
.vbjfa th{color:var(--soft);font-weight:500;font-size:13px}
.vbjfa td.n{font-variant-numeric:tabular-nums;white-space:nowrap}
.vbjfa td.name{min-width:5.5em;max-width:16em;overflow-wrap:anywhere}
.vbjfa ul{margin:6px 0;padding-left:20px}
.vbjfa .pictures{display:grid;gap:12px;
grid-template-columns:repeat(auto-fill,minmax(min(100%,300px),1fr))}
.vbjfa figure{margin:0;background:var(--card);border:1px solid var(--line);
border-radius:10px;padding:10px 12px}
.vbjfa figcaption{display:flex;justify-content:space-between;gap:8px;font-size:13px}
.vbjfa figcaption span{color:var(--soft);white-space:nowrap}
.vbjfa svg{display:block;width:100%;height:110px;margin-top:6px}
.vbjfa svg path,.vbjfa svg rect{vector-effect:non-scaling-stroke}
.vbjfa .line{fill:none;stroke-width:1.2}
.vbjfa .line.before{stroke:var(--before)}
.vbjfa .line.after{stroke:var(--after)}
.vbjfa .area.before{fill:var(--before)}
.vbjfa .area.after{fill:var(--after);fill-opacity:.85}
.vbjfa .floor{fill:var(--floor);fill-opacity:.3}
.vbjfa .axis{position:relative;height:16px;margin-top:2px;color:var(--soft);
font-size:11px;line-height:16px;font-variant-numeric:tabular-nums}
.vbjfa .axis span{position:absolute;white-space:nowrap;transform:translateX(-50%)}
.vbjfa .axis span:first-child{transform:none}
.vbjfa .axis span:last-child{transform:translateX(-100%)}
.vbjfa .causes{color:var(--bad);margin:12px 0 0}
.vbjfa .zero{stroke:var(--soft);stroke-width:.6;fill:none}
.vbjfa details{margin:8px 0}
.vbjfa summary{cursor:pointer;color:var(--soft)}
.vbjfa dl{display:grid;grid-template-columns:max-content 1fr;gap:4px 16px;margin:0;
font-size:14px}
.vbjfa dt{color:var(--soft)}
.vbjfa dd{margin:0;overflow-wrap:anywhere}
@media (max-width:760px){.vbjfa .joint{grid-template-columns:1fr}
.vbjfa .bar{grid-template-columns:1fr 148px}
.vbjfa table.stack,.vbjfa .stack tbody,.vbjfa .stack tr,.vbjfa .stack td{display:block}
.vbjfa .stack thead{display:none}
.vbjfa .stack tr{padding:8px 0;border-bottom:1px solid var(--line)}
.vbjfa .stack tr:last-child{border-bottom:0}
.vbjfa .stack td{border:0;padding:1px 0;white-space:normal;max-width:none}
.vbjfa .stack td[data-name]:not(:empty)::before{content:attr(data-name) ": ";
color:var(--soft)}
.vbjfa dl{grid-template-columns:1fr}.vbjfa dd{margin-bottom:4px}}
"""


_WIDTH, _HEIGHT = 360, 110
# Residuals beyond this quantile are cut off, or a spike would flatten the rest.
_QUANTILE = 0.998
# A step of this many usual ones, as between recordings, interrupts a line.
_BREAK = 1.5
# Most steps of a time axis.
_TICKS = 5


def residual_picture(curves, joint, floor):
    """Draw a joint's residual before and after over the untouched part.

    Parameters
    ----------
    curves : dict of str to ndarray
        ``"before"``, ``"after"``, ``"weight"``, ``"torque"``: arrays (m, nv);
        ``"seconds"``, where it is known: (m,), rising.
    joint : int
        Joint, from zero.
    floor : float
        Noise floor over the standard deviation of the torque; may be nan.

    Returns
    -------
    svg : str
        Picture; empty if there is nothing to draw.
    limit : float
        Torque at its upper edge, the lower one is its negative [N m or N].
    """
    before, after = (
        np.asarray(curves[key], dtype=float)[:, joint] for key in ("before", "after")
    )
    used = np.asarray(curves["weight"], dtype=float)[:, joint] > 0
    used &= np.isfinite(before) & np.isfinite(after)
    if used.sum() < 2:
        return "", np.nan
    sizes = np.abs(np.r_[before[used], after[used]])
    limit = float(np.quantile(sizes, _QUANTILE)) * 1.05
    if not limit > 0:
        return "", np.nan
    torque = np.asarray(curves["torque"], dtype=float)[used, joint]
    band = _floor_band(floor * torque.std(), limit)
    x = _places(curves, before.size)
    grey, colour = (
        _shape(x, np.where(used, values, np.nan), limit, kind)
        for values, kind in ((before, "before"), (after, "after"))
    )
    middle = _HEIGHT / 2
    svg = (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" preserveAspectRatio="none" '
        f'aria-hidden="true">{grey}{band}'
        f'<path class="zero" d="M0 {middle}H{_WIDTH}"/>{colour}</svg>'
    )
    return svg, limit


def _floor_band(half, limit):
    """Noise floor as a band of one standard deviation to each side."""
    if not np.isfinite(half) or half <= 0:
        return ""
    top = _HEIGHT / 2 * (1 - min(half / limit, 1.0))
    height = _HEIGHT - 2 * top
    return (
        f'<rect class="floor" x="0" width="{_WIDTH}" y="{top:.1f}" '
        f'height="{height:.1f}"/>'
    )


def time_axis(curves):
    """Return the seconds below a picture as HTML; empty if they are not known."""
    seconds = np.asarray(curves.get("seconds", ()), dtype=float)
    if seconds.size < 2:
        return ""
    length = seconds[-1] - seconds[0]
    power = 10.0 ** np.floor(np.log10(length / _TICKS))
    # The finest of 1, 2, 5, 10, ... with no more ticks than there is room for.
    step = next(
        k * power for k in (1, 2, 5, 10) if length / (k * power) <= _TICKS + 1e-9
    )
    ticks = step * np.arange(int(length / step + 1e-9) + 1)
    # The end says the unit; a tick close to it would be overwritten.
    ticks = ticks[ticks < length - 0.75 * step]
    places = [(100 * tick / length, words.number(tick, 4)) for tick in ticks]
    places.append((100.0, f"{words.number(length)} s"))
    spans = "".join(
        f'<span style="left:{place:.1f}%">{text}</span>' for place, text in places
    )
    return f'<div class="axis">{spans}</div>'


def _places(curves, count):
    """Horizontal places of the samples, in proportion to time where it is known."""
    seconds = np.asarray(curves.get("seconds", np.arange(count)), dtype=float)
    return _WIDTH * (seconds - seconds[0]) / (seconds[-1] - seconds[0])


def _shape(x, values, limit, kind):
    """Draw a line, or the envelope of one with more points than the picture has."""
    y = _HEIGHT / 2 * (1 - np.clip(values / limit, -1, 1))
    if y.size <= _WIDTH:
        steps = np.diff(x)
        breaks = np.flatnonzero(steps > _BREAK * np.median(steps)) + 1
        runs = zip(np.split(x, breaks), np.split(y, breaks))
        path = "".join(_path(*run) for run in runs)
        return f'<path class="line {kind}" d="{path}"/>'
    label = np.minimum(x.astype(int), _WIDTH - 1)
    starts = np.flatnonzero(np.r_[True, np.diff(label) > 0])
    column = label[starts]
    top = np.fmin.reduceat(y, starts)
    bottom = np.fmax.reduceat(y, starts)
    pieces = []
    seen = np.isfinite(top)
    # Neither where nothing counts nor where nothing was recorded.
    ends = np.flatnonzero((np.diff(seen) != 0) | (np.diff(column) > 1)) + 1
    for run in np.split(np.arange(seen.size), ends):
        if seen[run[0]]:
            at = column[run]
            edge = np.r_[
                top[run] - 0.4, top[run[-1]] - 0.4, bottom[run[-1]], bottom[run[::-1]]
            ]
            outline = np.r_[at, at[-1] + 1, at[-1] + 1, at[::-1]]
            pieces.append(_path(outline, edge) + "Z")
    return f'<path class="area {kind}" d="{"".join(pieces)}"/>'


def _path(x, y):
    """Return path data; points that are nan interrupt the line."""
    out, pen = [], "M"
    for a, b in zip(x, y):
        if np.isfinite(b):
            out.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(out)


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
