"""What a report says of what remains, one statement on each joint."""

import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import Ceiling, Map
from sklearn_vbjfa.diagnosis.report import HEIGHT, WIDTH, map_picture
from tests.diagnosis.report._outcomes import make_outcome

NAN = float("nan")
ONLY = (NAN, NAN, NAN)
FORM = "a function of speed and load explains 60 % of what remains: no effect of the"
CASES = {
    "speed and load": ((0.6, 0.61, 0.7), ONLY, FORM),
    "two recordings": (
        (0.7, 0.7, 0.7),
        (0.5, 0.5, 0.5),
        "a function of speed and load explains 50 % of what remains: no effect of the "
        "library has that form",
    ),
    "history": (
        (0.2, 0.55, 0.55),
        ONLY,
        "a function of its own state and history explains 55 % of what remains: no",
    ),
    "others": (
        (0.0, 0.1, 0.4),
        (0.0, 0.1, 0.4),
        "the motion of other joints explains 40 % of what remains: no effect of the",
    ),
    "not in the next": (
        (0.7, 0.75, 0.8),
        (0.0, 0.0, 0.02),
        "70 % of what remains repeats within a recording, nothing in the next one: "
        "temperature, or what else changed in between",
    ),
    "nothing": (
        (0.0, 0.0, 0.0),
        ONLY,
        "what remains does not repeat: temperature, unmeasured load, or noise",
    ),
    "little": (
        (0.0, 0.0, 0.06),
        ONLY,
        "what remains hardly repeats: temperature, unmeasured load, or noise",
    ),
}


def ceiling(joint, within, across=ONLY):
    return Ceiling(
        joint=joint, joint_name=f"joint{joint + 1}", within=within, across=across
    )


def drawn():
    """Make a map of four cells, one of them empty."""
    measured = np.array([[1.0, -2.0], [np.nan, 0.5]])
    return Map(
        speed=(-1.5, 1.5), load=(-20.0, 30.0), measured=measured, function=measured / 2
    )


def formats(report):
    """Markdown and page without breaks and escapes."""
    texts = report.to_markdown().replace("\\", ""), report.to_html()
    return [re.sub(r"\s+", " ", text.replace("&#39;", "'")) for text in texts]


def without_signals(outcome, **changes):
    """Return the joints above their floor, which vary with no signal."""
    return tuple(replace(u, signals=(), **changes) for u in outcome.unexplained)


@pytest.mark.parametrize("case", CASES)
def test_one_statement_on_a_joint(case):
    within, across, said = CASES[case]
    outcome = make_outcome(unexplained=(4,), ceiling=(ceiling(4, within, across),))
    report = Report(outcome)
    for text in formats(report):
        assert text.count(said) == 1
        assert "correlated with" not in text
    data = report.to_dict()
    assert data["joints"][4]["remains"].startswith(said)
    assert [joint["remains"] for joint in data["joints"][:4]] == [
        joint["text"] for joint in data["joints"][:4]
    ]
    (own,) = data["ceiling"]
    assert own["within"] == list(within)
    assert own["across"] == [None if x != x else x for x in across]
    assert own["share"] == [min(w, a) if a == a else w for w, a in zip(within, across)]


@pytest.mark.parametrize("case", ["speed and load", "not in the next", "nothing"])
def test_an_unknown_floor_is_not_called_noise(case):
    within, across, _ = CASES[case]
    outcome = make_outcome(unexplained=(4,), ceiling=(ceiling(4, within, across),))
    rest = without_signals(outcome, floor=NAN)
    report = Report(outcome)
    unknown = Report(replace(outcome, unexplained=rest))
    assert "or noise" in report.to_markdown() or case != "nothing"
    for text in formats(unknown):
        assert "noise floor unknown" in text
        assert "or noise" not in text
        assert ("whether it is noise is not known" in text) == (case == "nothing")


def test_joints_of_which_nothing_repeats_share_a_line():
    nothing = (0.0, 0.0, 0.0)
    outcome = make_outcome(
        unexplained=(0, 1, 3), ceiling=tuple(ceiling(j, nothing) for j in (0, 1, 3))
    )
    text = formats(Report(outcome))[0]
    assert text.count("what remains does not repeat") == 1
    assert "- joints 1, 2 and 4: " in text


def test_joints_that_repeat_in_no_other_recording_share_a_line():
    found = tuple(ceiling(j, (x,) * 3, (0.0,) * 3) for j, x in ((1, 0.5), (2, 0.3)))
    outcome = make_outcome(unexplained=(1, 2), ceiling=found)
    text = formats(Report(outcome))[0]
    assert (
        "- joints 2 and 3: 4.3 % of the torque remains unexplained; 30 % to 50 % of"
        in text
    )
    assert text.count("repeats within a recording") == 1


def test_what_changes_is_recorded_cold_and_warm():
    outcome = make_outcome(unexplained=(4,), hidden=(), n_effects=0)
    rest = without_signals(outcome)
    advice = "the same motion cold and warm (joint 5)"
    for within, across, wanted in (
        ((0.0, 0.0, 0.0), ONLY, True),
        ((0.6, 0.6, 0.6), (0.0, 0.0, 0.0), True),
        ((0.6, 0.6, 0.6), ONLY, False),
    ):
        own = (ceiling(4, within, across),)
        report = Report(replace(outcome, unexplained=rest, ceiling=own))
        assert (advice in formats(report)[0]) == wanted


def test_a_function_of_speed_and_load_has_its_picture():
    shown = ceiling(4, (0.6, 0.6, 0.6))
    hidden = ceiling(2, (0.2, 0.6, 0.6))
    outcome = make_outcome(unexplained=(2, 4), ceiling=(hidden, shown))
    outcome.curves["maps"] = {2: drawn(), 4: drawn()}
    page = Report(outcome).to_html()
    maps = page[page.index('<div class="pictures maps">') :]
    maps = maps[: maps.index("more torque than predicted")]
    assert maps.count("<figure>") == 1
    assert maps.count("<svg") == 2
    assert "<b>joint 5</b>" in maps
    assert "right: speed -1.5 to 1.5 rad/s; up: load -20 to 30 N m" in maps
    assert "curves" not in Report(outcome).to_dict()


def test_cells_of_a_map_lie_where_their_signals_are():
    picture = map_picture(drawn())
    assert picture.limit == pytest.approx(np.quantile([1.0, 2.0, 0.5], 0.95))
    cells = {one.path: (one.kind, one.opacity) for one in picture.measured}
    width, height = WIDTH / 2, HEIGHT / 2

    def cell(column, row):
        return f"M{column * width:.1f} {row * height:.1f}h{width:.1f}v{height:.1f}"

    # Loads rise upwards: the first row is the lower one.
    at = {path[: path.index("h-")]: look for path, look in cells.items()}
    assert set(at) == {cell(0, 1), cell(1, 1), cell(1, 0)}
    assert at[cell(0, 1)][0] == at[cell(1, 0)][0] == "up"
    assert at[cell(1, 1)] == ("down", 1.0)
    assert at[cell(1, 0)][1] < at[cell(0, 1)][1] < 1.0
