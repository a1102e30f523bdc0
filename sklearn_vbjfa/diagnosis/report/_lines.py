"""Sentences of a report, one for each thing that was found."""

import math

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.search._gaps import ABOVE_FLOOR

# Forms of an effect's sentence that hold all parameters and rivals.
COMPLETE = 3


def effect_forms(effect, names):
    """Sentences on an effect, ever shorter.

    The first ones leave out nothing but the p-value, which is below the threshold
    anyway.
    """
    head = (
        f"{words.joint_label(names, effect.joint)}: "
        f"{words.effect_label(effect.name, effect.parameters, names)}"
    )
    gain = f"saves {words.whole_percent(effect.evidence.gain)}"
    p = words.p_text(effect.evidence.p_value)
    parameters = words.parameter_text(effect)
    count = len(parameters)
    rivals = _rivals(effect.rivals)

    def line(shown, rival, evidence=f"{gain}, {p}"):
        more = ["..."] * (shown < count)
        return "; ".join(
            x
            for x in (", ".join([head, *parameters[:shown], *more]), evidence, rival)
            if x
        )

    forms = [line(count, r) for r in rivals[:2]]
    forms += [line(count, rivals[1], gain)]
    forms += [line(count, r) for r in rivals[2:]]
    forms += [line(min(2, count), r) for r in rivals[1:]]
    forms += [
        line(min(1, count), r, e) for e in (f"{gain}, {p}", gain) for r in rivals[1:]
    ]
    forms += [line(0, rivals[-1], gain)]
    return forms


def _rivals(rivals):
    """Name the rivals, at length and ever shorter."""
    if not rivals:
        return ["", ""]
    plain = [words.PLAIN_NAMES.get(r, r) for r in rivals]
    short = [r.replace("_", " ") for r in rivals]
    noun = "rival" if len(rivals) == 1 else "rivals"
    forms = [
        f"this data cannot tell it from {words.join(plain, 4, 'or')}",
        f"{noun} {', '.join(short)}",
    ]
    if len(short) > 1:
        forms.append(f"{noun} {short[0]} and {len(short) - 1} more")
    return [*forms, words.plural(len(rivals), "rival")]


def unexplained_groups(unexplained):
    """Put joints together of which one thing is to say: nothing, beyond how much."""
    silent = [u for u in unexplained if u.floor > 0 and not u.signals]
    groups = [[u] for u in unexplained if u not in silent[1:]]
    return [silent if group == silent[:1] else group for group in groups]


def unexplained_line(group, names):
    """Say what remains of joints' residuals and what it varies with."""
    rest = group[0]
    label = words.joint_list(names, [u.joint for u in group])
    shares = [words.percent(share) for share in sorted(u.of_torque for u in group)]
    share = " to ".join(dict.fromkeys([shares[0], shares[-1]]))
    if not rest.floor > 0:
        head = f"{label}: {share} of the torque remains, noise floor unknown"
    else:
        head = f"{label}: {share} of the torque has no name"
    signals = [
        f"{words.signal_label(s.signal, names, rest.joint)} "
        f"({words.whole_percent(s.share)})"
        for s in rest.signals
    ]
    if not signals:
        return f"{head}; it varies with no signal alone"
    return f"{head}; varies with {words.join(signals, 3)}"


def hidden_lines(hidden, names, most=4):
    """Say what could not be looked for, one line for each reason."""
    titles = {
        "excitation": "This recording cannot show",
        "signal": "Not looked for",
        "span": "No motion can show (inside the declared parameters)",
    }
    lines = []
    for reason, title in titles.items():
        own = [h for h in hidden if h.reason == reason]
        if own:
            by_effect = {}
            for h in own:
                by_effect.setdefault(h.name, []).append(h.joint)
            parts = [
                f"{words.effect_label(name)} ({words.joint_list(names, joints)})"
                for name, joints in by_effect.items()
            ]
            more = sorted({h.remedy for h in own}) if reason == "signal" else []
            because = f": {words.join(more, 2)}" if more else ""
            lines.append(f"{title} {words.join(parts, most)}{because}.")
    return lines


def next_recording(outcome):
    """Return what to record next, what matters most first, without repetition."""
    wanted = {}
    for rest in outcome.unexplained:
        for signal in rest.signals:
            wanted.setdefault(words.record_for_signal(signal.signal), []).append(
                rest.joint
            )
    for effect in outcome.effects:
        for name in (effect.name, *effect.rivals) if effect.rivals else ():
            wanted.setdefault(words.record_for(name), []).append(effect.joint)
    for h in outcome.hidden:
        if h.reason == "excitation":
            advice = words.record_for(h.name) or h.remedy
            wanted.setdefault(advice, []).append(h.joint)
    names = outcome.joint_names
    return [
        f"{advice} ({words.joint_list(names, joints)})"
        for advice, joints in wanted.items()
        if advice
    ]


def causes_line(verdicts):
    """Say what makes a fit worse than the mean torque; empty if none is."""
    if all(v.status != "failed" for v in verdicts):
        return ""
    return (
        "Likely causes of an error of 100 % or more: wrong sign, order or unit of the "
        "columns; a coupling between joints that is not in the model; motion too slow "
        "or too small, so that noise outweighs the torques, or that ends at rest."
    )


def declared_line(declared):
    """Say what the model had before the search."""
    parts = []
    if declared.get("robot"):
        parts.append(str(declared["robot"]))
    if "friction" in declared:
        names = ", ".join(map(str, declared["friction"])) or "none"
        parts.append(f"friction: {names}")
    if "n_parameters" in declared:
        parts.append(f"{declared['n_parameters']} parameters")
    if "cutoff" in declared:
        cutoff = declared["cutoff"]
        parts.append(
            f"low-pass {words.number(cutoff)} Hz"
            if math.isfinite(cutoff)
            else "no low-pass"
        )
    return "; ".join(parts)


def refused_line(outcome):
    """Say which steps were taken back; empty if none was."""
    names = outcome.joint_names
    parts = []
    for action, what in (
        ("refuse", "Refused, as it did not hold on later data"),
        ("drop", "Dropped as superfluous"),
        ("withdraw", "Withdrawn, as it did harm on motion that it was not fitted to"),
    ):
        own = [
            f"{words.effect_label(r.name, r.shape, names)} on "
            f"{words.joint_label(names, r.joint)}"
            for r in outcome.rounds
            if r.action == action
        ]
        if own:
            parts.append(f"{what}: {words.join(own, 3)}.")
    return " ".join(parts)


def interval_text(settings):
    """Say what the interval of an error holds."""
    if "error_seconds" not in settings:
        return "90 %"
    seconds = words.number(settings["error_seconds"], 2)
    return f"90 % of errors over the next {seconds} s of such motion"


def settings_lines(settings):
    """Return lines on the split and the thresholds."""
    lines = []
    get = settings.get
    if "test_size" in settings:
        text = f"Untouched: {words.whole_percent(get('test_size'))} of the motion"
        if "untouched_stretches" in settings:
            count = words.plural(get("untouched_stretches"), "stretch")
            text += f" ({count.replace('stretchs', 'stretches')}"
            text += f", {words.number(get('untouched_seconds'))} s)"
            if get("undecided_stretches"):
                text += ", without what a change of payload falls into"
        if "n_blocks" in settings:
            seconds = words.number(get("block_seconds", float("nan")))
            text += (
                f"; search: {get('n_blocks')} blocks of {seconds} s, "
                f"{get('n_folds', '?')} folds"
            )
        if "correlation_seconds" in settings:
            seconds = words.number(get("correlation_seconds"), 2)
            text += f"; correlated {seconds} s"
        lines.append(text + ".")
    if "rule" in settings:
        text = (
            f"Named: {get('rule')}, alpha {words.number(get('alpha'))}{_last(settings)}"
        )
        lines.append(
            f"{text}; saves >= {words.whole_percent(get('smallest_gain', math.nan))} "
            f"of squared error; unexplained: > {ABOVE_FLOOR[0]} x floor."
        )
    if "error_seconds" in settings:
        lines.append(
            f"+-: 90 % of a parameter; [ ]: {interval_text(settings)}. Files and "
            "parameters: fitted to all data after the errors were taken."
        )
    return lines


def _last(settings):
    """Level of the round that ended the search."""
    level, count = settings.get("last_level"), settings.get("last_n_tests")
    if not level or not count:
        return ""
    tests = words.plural(count, "test")
    return f" (last round: p < {words.number(level, 2)}, {tests})"


def short_line(outcome):
    """Say where the recording is too short for a slow residual; empty if nowhere."""
    joints = outcome.settings.get("too_short", ())
    if not joints:
        return ""
    where = words.joint_list(outcome.joint_names, [j for j, _ in joints])
    times = [seconds for _, seconds in joints]
    longest = max(times)
    stays = "stays correlated throughout"
    if math.isfinite(longest):
        up_to = "up to " if len(times) > 1 else ""
        stays = f"stays correlated for {up_to}{words.number(longest, 2)} s"
    return (
        f"Too short for the residual of {where}, which {stays}: slow effects cannot be "
        "told from it."
    )


def rule_text(step):
    """Say by which rule a step was taken, with the level that applied."""
    if not math.isfinite(step.level):
        return step.rule
    tests = f", {step.n_tests} tests" if step.n_tests > 1 else ""
    return f"{step.rule} (p < {words.number(step.level, 2)}{tests})"
