"""Status, headline, terminal text and dictionary of synthetic outcomes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import NotIdentifiable
from sklearn_vbjfa.diagnosis.report import words
from sklearn_vbjfa.diagnosis.search._posterior import SMALL
from sklearn_vbjfa.effects import Coulomb, Effect
from tests.diagnosis.report._outcomes import (
    EVIDENCE,
    changed,
    finding,
    make_effect,
    make_outcome,
    make_possible,
    make_trials,
)
from tests.diagnosis.report._pages import line_of, section_of, text_of

NAMES = tuple(f"joint{j + 1}" for j in range(6))
UNKNOWN, FLOOR = np.full(6, np.nan), make_outcome().column("floor")
CASES = {
    "clean": {"nv": 1, "n_effects": 0, "not_identifiable": (), "channels": ()},
    "six joints": {"nv": 6, "n_effects": 2, "unexplained": (4,)},
    "twelve joints": {"nv": 12, "n_effects": 20, "unexplained": (1, 4, 5, 6, 7)},
    "thirty joints": {"nv": 30, "n_effects": 20, "unexplained": range(30)},
    "long names": {
        "nv": 7,
        "n_effects": 7,
        "unexplained": (0, 3),
        "names": tuple(f"left\narm {'x' * 70} joint_{j}" for j in range(7)),
    },
    "no settings": {"settings": {}},
}


@pytest.fixture(params=CASES, name="outcome")
def fixture_outcome(request):
    return make_outcome(**CASES[request.param])


# -- the verdict


STATUS = {
    "nothing": {"n_effects": 0},
    "complete": {"n_effects": 2},
    "partial": {"n_effects": 2, "unexplained": (1,)},
    "exhausted": {"n_effects": 0, "unexplained": (1,)},
    "unknown": {"floor": UNKNOWN},
    "unsettled": {
        "before": 3 * FLOOR,
        "after": 2 * FLOOR,
        "intervals": {"after": np.array([1.9 * FLOOR, 2.1 * FLOOR])},
    },
    "worse": {"before": FLOOR, "after": 1.2 * FLOOR, "intervals": {}},
    "failed": {"after": np.full(6, 1.0)},
    "no data": {"before": UNKNOWN, "after": UNKNOWN},
    "unsearched": {"n_effects": 0, "searched": np.zeros(6, dtype=bool)},
    "faulty": {"channels": (finding("Joint 2 is swapped.", "warning"),)},
}


@pytest.mark.parametrize("status", STATUS)
def test_status(status):
    report = Report(make_outcome(**STATUS[status]))
    assert report.status == status
    assert report.to_dict()["status"] == status
    good = status in ("nothing", "complete")
    assert ('<header class="good">' in report.to_html()) == good
    for text in (str(report), report.headline, text_of(report)):
        text = " ".join(text.split())
        assert good or "othing is missing" not in text
        assert good or "the residual is" not in text


def test_insignificant_differences_keep_the_status():
    # An interval that includes the noise floor is not significant.
    unsure = {"after": np.array([0.8 * FLOOR, 3.0 * FLOOR])}
    double = {"before": 3 * FLOOR, "after": 2 * FLOOR}
    report = Report(make_outcome(**double, intervals=unsure))
    assert report.status == "complete"
    assert "above it, not significantly" in report.headline
    assert "not significantly" in report.uses[2].reason
    # A refit changes all errors slightly, and paired blocks make that significant.
    before = make_outcome(n_effects=1).column("before")
    sure = {"difference": np.array([0.005, 0.015])[:, None] * before}
    report = Report(make_outcome(n_effects=1, after=1.01 * before, intervals=sure))
    assert report.status != "worse"
    error, sure = np.array([0.999]), {"after": np.array([[0.9], [1.1]])}
    almost = Report(make_outcome(nv=1, n_effects=0, after=error, intervals=sure))
    assert almost.status != "failed"
    assert almost.warnings
    assert not almost.uses[0].allowed


def test_each_joint_has_a_verdict():
    after = np.array([0.05, 1.3, 3.0, 0.05])
    changes = {"nv": 4, "n_effects": 0, "intervals": {}, "floor": np.full(4, 0.05)}
    changes |= {"before": after, "after": after, "seconds": [9.0, 9.0, 0.31, 9.0]}
    enough, searched = [True, True, False, True], [True, True, True, False]
    report = Report(make_outcome(enough=enough, searched=searched, **changes))
    kinds = ["floor", "failed", "few", "unsearched"]
    assert [v.status for v in report.joints] == kinds
    assert "0.31 s" in report.joints[2].text
    # Joints with too few samples are not part of the mean.
    mean = words.percent(after[[0, 1, 3]].mean())
    assert f"Mean error of joints 1, 2 and 4 on held-out data {mean}" in report.verdict
    assert "too little motion for a verdict (joint 3)" in report.warnings


def test_a_faulty_channel_comes_first():
    message = "The torque of joint 1 is 0.1 times what the model asks for."
    faults = (finding("Joint 2 stands still."), finding(message, "warning"))
    for case in CASES.values():
        report = Report(make_outcome(**(case | {"channels": faults})))
        assert message in report.headline[:100]
        assert line_of(report).startswith(report.headline[:60])
        page = text_of(report)
        assert page.index(message) < page.index("Error of each joint")


def test_error_of_the_baseline_is_reported():
    outcome = make_outcome(nv=2, n_effects=1)
    plain = np.sqrt(outcome.column("before") * outcome.column("after"))
    added = ("offset", "rotor_inertia")
    report = Report(changed(outcome, added=added, plain=plain))
    errors = [outcome.column("before"), plain, outcome.column("after")]
    for error in errors:
        assert words.percent(error.mean()) in report.verdict
        assert words.bare_percent(error[1]) in line_of(report)
        assert words.bare_percent(error[1]) in text_of(report)
    assert report.to_html().count('class="fill plain"') == 2
    assert report.to_dict()["robot"]["added"] == list(added)
    assert "four plain" not in text_of(Report(outcome))


# -- terminal text


def test_text_fits_a_terminal(outcome):
    report = Report(outcome)
    lines = str(report).splitlines()
    assert max(map(len, lines)) <= 80
    assert all(line == line.rstrip() for line in lines)
    verdict = " ".join(report.verdict.split())[:100]
    assert line_of(report).startswith(verdict)
    assert len(repr(report)) < 100


def test_terminal_text_is_truncated_and_the_page_is_complete():
    effects = tuple(make_effect(i, i % 6, NAMES) for i in range(12))
    few, many = (
        str(Report(make_outcome(effects=effects[:count]))).splitlines()
        for count in (6, 12)
    )
    assert len(many) <= len(few) + 1
    assert "and 6 more (page)" in " ".join(many)
    report = Report(make_outcome(**CASES["twelve joints"]))
    rows = [x for x in str(report).splitlines() if x.startswith("joint ")]
    assert len(rows) == 5
    assert "7 more (page)" in str(report)
    html = report.to_html()
    assert html.count('class="joint"') == 12
    for verdict in report.joints:
        assert verdict.text in text_of(report)


def test_effects_of_undetermined_form_are_marked():
    (effect,) = make_outcome(nv=3, n_effects=1).findings["effects"]
    keywords = {"parameters": {"A": 0.8}, "units": {"A": "N m"}, "name": "ripple"}
    keywords["intervals_given_shape"] = {"A": (0.7, 0.9)}
    for low, expected in ((0.2, False), (-0.2, True)):
        one = replace(effect, **keywords, intervals={"A": (low, 1.4)})
        text = line_of(Report(make_outcome(effects=(one,))))
        assert ("A = 0.80 +- 0.10 N m, its form is not" in text) == expected
        one = replace(one, effect=Coulomb(), parameters={"A": 0.8, "k": 2.0})
        assert words.parameter_text(one)[1:] == ["k not identifiable"]


@pytest.mark.parametrize("render", [line_of, text_of])
def test_an_effect_has_value_gain_odds_and_rivals(render):
    text = render(Report(make_outcome(nv=3, n_effects=1)))
    facts = "load-dependent friction", "joint 2", "mu = 0.112 +- 0.011", "46 %"
    for fact in (*facts, "3600 : 1", "friction with memory"):
        assert fact in text


def test_rows_of_the_error_table():
    outcome = make_outcome(nv=3, n_effects=0)
    after = outcome.column("after") * np.array([1.0, 3.0, 0.3])
    report = Report(changed(outcome, after=after))
    # Rows are sorted by error, also on the page.
    first = [x[:7] for x in str(report).splitlines() if x.startswith("joint ")]
    assert first == ["joint 2", "joint 1", "joint 3"]
    table = section_of(report, "Error of each joint on held-out data")
    assert table.index("joint 2") < table.index("joint 1") < table.index("joint 3")
    # Also in N m.
    size = f"{outcome.errors[0].after * outcome.errors[0].spread:.2g}"
    assert size in line_of(report)


# -- possible effects


def test_possible_effects_have_a_reason():
    possible = (
        make_possible(2, 3, NAMES),
        make_possible(1, 4, NAMES, warning=SMALL, evidence=EVIDENCE),
    )
    report = Report(make_outcome(n_effects=1, possible=possible))
    without = Report(changed(report.outcome, possible=()))
    assert report.headline == without.headline
    assert report.status == without.status
    assert "torque ripple on joint 4 (undecided)" in str(report)
    text = section_of(report, "Possible effects")
    for fact in ("undecided", SMALL, "joint 4", "joint 5"):
        assert fact in text
    data = report.to_dict()
    assert [e["warning"] for e in data["effects"]] == [""]
    assert [e["warning"] for e in data["possible"]] == ["undecided", SMALL]
    assert all(e["probability"] <= 0.2 for e in data["possible"])
    assert data["effects"][0]["log_odds"] == pytest.approx(8.2)
    assert section_of(without, "Possible effects") == ""


def test_possible_effects_prevent_the_verdict_nothing_is_missing():
    outcome = make_outcome(n_effects=0, possible=(make_possible(2, 3, NAMES),))
    after = outcome.column("after")
    report = Report(changed(outcome, before=3 * after, plain=3 * after))
    assert report.status == "nothing"
    assert "othing is missing" not in report.headline
    assert "torque ripple on joint 4" in report.headline
    # Errors of the models with and without the effect.
    for error in (after, 3 * after):
        assert words.percent(error.mean()) in report.verdict
    half = {"before": 0.5 * after, "intervals": {}}
    assert Report(changed(outcome, **half, floor=0.5 * after)).status == "worse"
    # Not above the noise floor by more than smoothing explains.
    assert Report(changed(outcome, **half)).status == "nothing"


# -- custom effects


class Gasket(Effect):
    """A seal that is squeezed."""

    name = "own_gasket"
    label = "squeeze of the gasket"
    record = "slow motion with the gasket dry"


class Hose(Effect):
    """A hose that is dragged along."""

    name = "own_hose"
    label = "drag of the hose pack"
    record = "the same motion without the hose pack"


@pytest.mark.parametrize("render", [line_of, text_of])
def test_custom_effects_are_named_by_their_label(render):
    trials = make_trials(0, (Hose.name,))
    match = replace(make_effect(0, 0, NAMES), name=Gasket.name, trials=trials)
    hidden = NotIdentifiable(
        name=Hose.name, joint=2, joint_name=NAMES[2], reason="excitation", remedy="?"
    )
    outcome = make_outcome(
        nv=6,
        effects=(match,),
        not_identifiable=(hidden,),
        library={effect.name: effect for effect in (Gasket(), Hose())},
    )
    text = render(Report(outcome))
    for label in (Gasket.label, Hose.label, f"{Gasket.record} (joint 1)"):
        assert label in text
    assert "own gasket" not in text
    assert "own hose" not in text


# -- the dictionary


def test_dictionary_is_valid_json(outcome):
    data = Report(outcome).to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert "curves" not in data
    assert "library" not in data["robot"]
    assert len(data["effects"]) == len(outcome.findings["effects"])
    assert [row["name"] for row in data["errors"]] == list(outcome.robot["joints"])
    for j, row in enumerate(data["errors"]):
        assert row["before"] == outcome.errors[j].before
        assert row["intervals"]["after"][1] == pytest.approx(1.1 * row["after"])


def test_dictionary_replaces_nan_by_none():
    effect = replace(make_effect(0, 0, ("a",)), effect=Coulomb(joint=0))
    values = {"floor": np.array([np.nan]), "effects": (effect,)}
    data = Report(make_outcome(nv=1, **values)).to_dict()
    assert data["errors"][0]["floor"] is None
    assert data["effects"][0]["effect"]["class"] == "Coulomb"
    assert data["effects"][0]["effect"]["parameters"]["joint"] == 0


# -- numbers and names


@pytest.mark.parametrize(
    ("value", "interval", "unit", "expected"),
    [
        (0.1123, (0.1023, 0.1223), "", "0.112 +- 0.010"),
        (0.1123, (0.08, 0.14), "", "0.11 +- 0.03"),
        (1234.5, (1000.0, 1469.0), "N", "1200 +- 200 N"),
        (2e-7, (1.8e-7, 2.2e-7), "", "(2.0 +- 0.2)e-7"),
        (3e-5, (0.0, 1.2e-4), "rad", "< 0.00012 rad"),
        (0.5, (0.5, 0.5), "s", "0.5 s"),
        (np.nan, (0.0, 1.0), "s", "? s"),
    ],
)
def test_values_are_rounded_by_their_interval(value, interval, unit, expected):
    assert words.with_error(value, interval, unit) == expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("joint_2", "joint 2"),
        ("joint1", "joint1"),
        ("panda_joint2", "panda_joint2"),
        ("elbow", "joint 2 (elbow)"),
        ("2", "joint 2"),
        ("", "joint 2"),
    ],
)
def test_joint_labels(name, expected):
    assert words.joint_label(("first", name), 1) == expected


# -- wording


def test_headline_without_a_search():
    for status in ({}, {"unexplained": (1,)}):
        outcome = make_outcome(n_effects=0, channels=(), **status)
        settings = outcome.provenance["settings"] | {"effects": ()}
        headline = Report(changed(outcome, settings=settings)).headline
        assert "o search was made" in headline
        assert "missing" not in headline


def test_gain_has_a_90_percent_interval():
    assert "46 % (39 to 53 %)" in text_of(Report(make_outcome()))
