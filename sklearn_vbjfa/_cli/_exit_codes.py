"""Exit codes of all commands, and the doubts that decide between them.

A command puts its doubts into ``arguments.doubts`` before it prints, as the reader of
its output may leave; `main` makes the exit code of them. Nothing is imported with this
module but the standard library.
"""

# Nothing stands against using the result; nothing was done; done with a stated doubt.
USABLE, REFUSED, DOUBTFUL = 0, 2, 3

# What is shown below the help of every command.
EPILOG = (
    "exit code: 0 if the result can be used; 2 if nothing was done, and one line on "
    "stderr says why; 3 if it was done with a doubt that is stated: something was left "
    "out, failed, could not be judged, or is not to be trusted; 128 plus the number of "
    "a signal that ended the run, 130 for an interrupt"
)

# Doubts that the last line names; all of them are in what was printed before.
_NAMED = 3
# Verdicts on a joint that answer nothing, or say not to trust the model.
_NO_ANSWER = ("no data", "few", "unknown", "failed", "worse")
# Warnings about channels that are left out of what was asked for.
_LEFT_OUT = ("coarse_torque", "still_joint", "unusable_signal")


def line(doubts):
    """Say in a line why the exit code is what it is."""
    named = [" ".join(one.split()).rstrip(".") for one in doubts[:_NAMED]]
    more = len(doubts) - len(named)
    return f"exit code {DOUBTFUL}: {'; '.join(named)}" + (
        f"; and {more} more" if more else ""
    )


def of_channels(findings):
    """Messages of the findings on channels that are doubts, a list of str."""
    return [
        one.message
        for one in findings
        if one.severity != "warning" or one.kind in _LEFT_OUT
    ]


def of_warnings(caught):
    """Texts of the warnings that state a doubt, each once, a list of str."""
    from sklearn_vbjfa.model import DoubtWarning

    texts = [
        str(one.message) for one in caught if issubclass(one.category, DoubtWarning)
    ]
    return list(dict.fromkeys(texts))


def of_report(report):
    """Doubts that a report states, a list of str."""
    from sklearn_vbjfa.diagnosis.report._gains import gain_doubts
    from sklearn_vbjfa.diagnosis.report._limits import contradiction

    outcome = report.outcome
    joints = [
        f"{one.label}: {one.text}" for one in report.joints if one.status in _NO_ANSWER
    ]
    # What the recording itself is doubted for comes first, what is left out last.
    doubted = [one for one in outcome.channels if one.severity != "warning"]
    others = [one for one in outcome.channels if one.severity == "warning"]
    return [
        *filter(None, [contradiction(outcome)]),
        *of_channels(doubted),
        *joints,
        *gain_doubts(outcome),
        *of_channels(others),
    ]
