"""What could not be seen of the robot model, grouped, in a sentence for each effect."""

from sklearn_vbjfa.diagnosis.report import _words as words


def is_of_model(outcome, hidden):
    """Whether what is hidden is an effect of the robot model."""
    known = outcome.library.get(hidden.name)
    return known is not None and known.in_model


def model_sentences(outcome):
    """Say which effects of the robot model could not be seen, a tuple of sentences."""
    # Those that no motion can show are reported elsewhere: `model_parts`.
    groups = {}
    for one in outcome.hidden:
        if is_of_model(outcome, one) and one.reason != "span":
            # Partners are several, one for each joint.
            why = "" if one.reason == "together" else one.remedy
            groups.setdefault((one.reason, one.name, why), []).append(one)
    return tuple(
        _sentence(outcome, reason, name, why, own)
        for (reason, name, why), own in groups.items()
    )


def model_parts(outcome, reason):
    """Name the effects of the robot model that are hidden for a reason, a list."""
    groups = {}
    for one in outcome.hidden:
        if is_of_model(outcome, one) and one.reason == reason:
            groups.setdefault(one.name, []).append(one)
    return [_what(outcome, name, own) for name, own in groups.items()]


def _sentence(outcome, reason, name, why, own):
    """Say why one effect could not be seen on some joints."""
    what = words.capital(_what(outcome, name, own))
    if reason == "signal":
        return f"{what} could not be looked for: {why}."
    if reason == "together":
        partners = dict.fromkeys(
            words.other_label(outcome, one.remedy, name) for one in own
        )
        return (
            f"{what} can be seen only together with {words.join(partners, 4)}: one of "
            "them stands for both."
        )
    needed = f": that takes {why}" if why else ""
    return f"{what} cannot be seen in this recording{needed}."


def _what(outcome, name, own):
    """Name an effect on some joints as the subject of a sentence."""
    joints = [one.joint for one in own]
    where = words.joint_list(outcome.joint_names, joints)
    subject = outcome.library[name].subject
    if subject:
        return subject[len(set(joints)) > 1].format(where)
    label = words.effect_label(outcome, name)
    if words.place_label(outcome, name, joints[0]) == "robot":
        return label
    return f"{label} on {where}"


def together_sentences(outcome, hidden):
    """Say which other effects show only together with another one; a list."""
    found = {}
    for one in hidden:
        if one.reason == "together":
            key = (one.name, words.other_label(outcome, one.remedy, one.name))
            found.setdefault(key, []).append(one.joint)
    parts = [
        f"{words.effect_label(outcome, name)} "
        f"({words.joint_list(outcome.joint_names, joints)}) with {partner}"
        for (name, partner), joints in found.items()
    ]
    if not parts:
        return []
    return [f"Visible only together: {words.join(parts, len(parts))}."]
