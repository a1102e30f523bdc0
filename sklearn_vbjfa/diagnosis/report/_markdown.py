"""A report as Markdown."""

import re

from sklearn_vbjfa.diagnosis.report import _lines as lines
from sklearn_vbjfa.diagnosis.report import _verdict
from sklearn_vbjfa.diagnosis.report import _words as words


def markdown(report):
    """Return headings, tables and lists."""
    outcome = report.outcome
    names = outcome.joint_names
    robot = outcome.declared.get("robot", "robot")
    out = [
        f"# What the model of {_safe(robot)} lacks",
        "",
        f"**{_safe(report.verdict)}**",
    ]
    out += ["", "## Error of each joint on untouched data", ""]
    rows = []
    for v in report.joints:
        low, high = _verdict.interval(outcome, "after", v.joint)
        rows.append(
            [
                v.label,
                words.percent(outcome.error_before[v.joint]),
                words.percent(outcome.error_after[v.joint]),
                f"{words.bare_percent(low)} to {words.bare_percent(high)} %",
                words.number(outcome.error_after[v.joint] * outcome.spread[v.joint], 2)
                + f" {outcome.torque_units[v.joint]}",
                words.percent(outcome.wide_after[v.joint]),
                words.percent(outcome.floor[v.joint]),
                v.text,
            ]
        )
    wide = f"after, up to {words.number(outcome.wide_cutoff, 2)} Hz"
    heads = ["joint", "before", "after", "90 %", "after", wide, "noise floor"]
    out += _table([*heads, "verdict"], rows)
    if outcome.effects:
        out += ["", "## Effects that were missing", ""]
        rows = [
            [
                words.joint_label(names, e.joint),
                words.effect_label(e.name, e.parameters, names),
                ", ".join(words.parameter_text(e)),
                words.whole_percent(e.evidence.gain),
                words.p_cell(e.evidence.p_value),
                words.join([words.PLAIN_NAMES.get(r, r) for r in e.rivals], 4, "or"),
            ]
            for e in outcome.effects
        ]
        heads = ["joint", "effect", "parameters", "saved", "p", "cannot be told from"]
        out += _table(heads, rows)
    causes = lines.causes_line(report.joints)
    if causes:
        out += ["", _safe(causes)]
    for title, items in (
        (
            "Unexplained",
            [
                lines.unexplained_line(group, names)
                for group in lines.unexplained_groups(outcome.unexplained)
            ],
        ),
        ("Record next", lines.next_recording(outcome)),
        (
            "Not visible in this recording",
            lines.hidden_lines(outcome.hidden, names, 20),
        ),
        ("Channels", [c.message for c in outcome.channels]),
    ):
        if items:
            out += ["", f"## {title}", "", *(f"- {_safe(item)}" for item in items)]
    if outcome.rounds:
        out += ["", "## Steps of the search", ""]
        rows = [
            [
                str(i),
                r.action,
                words.joint_label(names, r.joint),
                words.effect_label(r.name, r.shape, names),
                words.whole_percent(r.evidence.gain),
                words.p_cell(r.evidence.p_value),
                lines.rule_text(r),
                words.join(
                    [words.PLAIN_NAMES.get(t.name, t.name) for t in r.rivals], 4
                ),
            ]
            for i, r in enumerate(outcome.rounds, 1)
        ]
        out += _table(
            ["", "step", "joint", "effect", "saved", "p", "rule", "rivals"], rows
        )
    closing = [
        lines.short_line(outcome),
        lines.refused_line(outcome),
        *lines.settings_lines(outcome.settings),
    ]
    out += ["", "## Settings", "", *(f"- {_safe(line)}" for line in closing if line)]
    versions = outcome.settings.get("versions", {})
    if versions:
        out.append("- " + _safe(", ".join(f"{k} {v}" for k, v in versions.items())))
    return "\n".join(out) + "\n"


def _table(heads, rows):
    out = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    return out + [f"| {' | '.join(map(_safe, row))} |" for row in rows]


def _safe(text):
    """Escape what Markdown would read as markup."""
    return re.sub(r"([\\`*_|<>])", r"\\\1", str(text)).replace("+-", "±")
