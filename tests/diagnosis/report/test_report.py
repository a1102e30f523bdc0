import json
import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import Hidden
from sklearn_vbjfa.diagnosis.report import (
    _report,
    judge,
    plain_text,
    sections,
)
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.search import SMALL
from sklearn_vbjfa.effects import (
    Coulomb,
    Effect,
    OutsideRange,
    ViscousQuadratic,
    available,
)
from tests.diagnosis.report._outcomes import (
    EVIDENCE,
    finding,
    make_effect,
    make_outcome,
    make_possible,
    make_round,
)

# Lines of a terminal that sections take for six joints and six effects; one that is not
# named here takes none.
LINES = {
    "What the declared model of arm lacks": 3,
    "Error of each joint on held-out data": 7,
    "Effects that were missing": 6,
    "What to do next": 5,
}
SUCCESS = ("Nothing is missing", "what remains is")
NAMES = tuple(f"joint{j + 1}" for j in range(6))
CASES = {
    "clean": {"nv": 1, "n_effects": 0, "hidden": (), "channels": ()},
    "one joint": {"nv": 1, "n_effects": 1},
    "six joints": {"nv": 6, "n_effects": 2, "unexplained": (4,)},
    "twelve joints": {"nv": 12, "n_effects": 20, "unexplained": (1, 4, 5, 6, 7)},
    "thirty joints": {"nv": 30, "n_effects": 20, "unexplained": range(30)},
    "long names": {
        "nv": 7,
        "n_effects": 7,
        "unexplained": (0, 3),
        "names": tuple(f"left\narm {'x' * 70} joint_{j}" for j in range(7)),
    },
    "no settings": {"settings": {}, "declared": {}, "curves": {}, "rounds": ()},
}


@pytest.fixture(params=CASES, name="outcome")
def fixture_outcome(request):
    return make_outcome(**CASES[request.param])


def test_joints_that_vary_with_nothing_share_a_line():
    outcome = make_outcome(nv=6, n_effects=0, unexplained=(0, 1, 2, 4))
    shares = (0.018, 0.021, 0.075, 0.015)
    rest = [
        replace(u, of_torque=share, signals=u.signals if share == 0.075 else ())
        for u, share in zip(outcome.unexplained, shares)
    ]
    report = Report(replace(outcome, unexplained=tuple(rest)))
    for text in (report.to_markdown(), report.to_html()):
        flat = re.sub(r"\s+", " ", text)
        said = "of the torque remains unexplained"
        assert flat.count(f"{said};") == 2
        assert f"joints 1, 2 and 5: 1.5 % to 2.1 % {said}; not correlated with" in flat
        assert f"joint 3: 7.5 % {said}; correlated with speed of" in flat


def test_text_fits_a_terminal(outcome):
    lines = str(Report(outcome)).splitlines()
    assert max(map(len, lines)) <= 80
    assert all(line == line.rstrip() for line in lines)
    assert all(lines[0 :: len(lines) - 1])
    assert not any(line.endswith("...") for line in lines)


def test_a_terminal_has_verdict_table_effects_and_what_to_do_next():
    effects = tuple(make_effect(i, i % 6, NAMES) for i in range(12))
    few, many = (make_outcome(effects=effects[:count]) for count in (6, 12))
    shown = sections(few, judge(few))
    for section in shown:
        lines = plain_text((section,)).splitlines()
        assert len(lines) <= LINES.get(section.heading, 0), section.heading
    assert set(LINES) <= {section.heading for section in shown}
    few, many = (str(Report(outcome)).splitlines() for outcome in (few, many))
    assert len(few) <= 16 + 6
    # Each effect in a line.
    assert len(many) == len(few) + 6
    one = make_outcome(effects=effects[:1], channels=())
    assert len(str(Report(one)).splitlines()) <= 16


def test_sections_are_made_once_for_all_formats(monkeypatch):
    made = []

    def counted(*known):
        made.append(known)
        return sections(*known)

    monkeypatch.setattr(_report, "sections", counted)
    report = Report(make_outcome())
    assert all([str(report), report.to_html(), report.to_markdown()])
    assert len(made) == 1


def test_every_format_shows_the_same_sections(outcome):
    report = Report(outcome)
    shown = sections(outcome, judge(outcome))
    text, page = (" ".join(x.split()) for x in (str(report), report.to_html()))
    marked = " ".join(report.to_markdown().replace("\\", "").split())
    for section in shown:
        assert escape(section.heading) in page
        if section.sentences or section.table:
            assert f"# {section.heading}" in marked
        for sentence in section.sentences[1 if section is shown[0] else 0 :]:
            assert " ".join(sentence.split()).replace("+-", "±") in marked
        for line in section.terminal:
            if isinstance(line, str):
                assert "".join(line.split()) in "".join(text.split())
    headings = re.findall("<h2[^>]*>(.*?)</h2>", page)
    assert headings == [section.heading for section in shown[1:]]


def test_text_begins_with_the_verdict(outcome):
    report = Report(outcome)
    text = " ".join(str(report).split())
    assert text.startswith(" ".join(report.verdict.split())[:100])


def test_rounds_are_no_matter_for_a_terminal():
    outcome = make_outcome()
    added, replaced, dropped = (
        make_round(outcome.effects[0], action) for action in ("add", "replace", "drop")
    )
    none, often = (
        Report(make_outcome(rounds=(added, replaced, dropped) * count))
        for count in (0, 50)
    )
    assert str(none) == str(often)
    for text in (often.to_markdown(), often.to_html()):
        flat = " ".join(text.split())
        assert "7300 : 1" in flat
        assert "1 : 5.5" in flat
        assert "dropped: improbable beside the others" in flat
        assert "replaced Coulomb friction" in flat


def test_a_page_leaves_nothing_out_and_a_terminal_the_middle_of_many_joints():
    report = Report(make_outcome(**CASES["twelve joints"]))
    text = str(report)
    shown = re.findall(r"^joint (\d+) ", text, re.M)
    assert len(shown) == 5
    assert re.search(r"^7 more \(page\)$", text, re.M)
    assert len(re.findall("^- ", text, re.M)) == 20
    page = report.to_markdown()
    first = {k: page.index(f"| joint {k} |") for k in range(1, 13)}
    # Those that gain most come first, those that gain least last.
    order = sorted(first, key=first.get)
    assert [int(x) for x in shown] == [*order[:3], *order[-2:]]
    for verdict in report.joints:
        assert verdict.text in page


def test_an_effect_is_named_with_value_gain_and_rivals():
    text = str(Report(make_outcome(nv=3, n_effects=1)))
    line = text[text.index("- joint") :].split("\nChannel")[0]
    assert " ".join(line.split()) == (
        "- joint 2: load-dependent friction, mu = 0.112 +- 0.011; saves 46 %, "
        "odds 3600 : 1; this data cannot tell it from hysteresis after reversals "
        "(presliding)"
    )


def test_a_negative_coefficient_says_what_it_means():
    effect = make_effect(0, 0, NAMES)
    for value, told in ((-0.4, True), (0.4, False)):
        own = replace(
            effect,
            name="viscous_quadratic",
            parameters={"F2": value},
            intervals={"F2": (value - 0.1, value + 0.1)},
            effect=ViscousQuadratic(),
        )
        report = Report(make_outcome(effects=(own,)))
        for text in (str(report), report.to_markdown(), report.to_html()):
            meaning = "(negative: friction that flattens at high speed)"
            assert (meaning in " ".join(text.split())) == told


def test_status():
    def status(**changes):
        return Report(make_outcome(**changes)).status

    floor = make_outcome().floor
    assert status(n_effects=0) == "nothing"
    assert status(n_effects=2) == "complete"
    assert status(n_effects=2, unexplained=(1,)) == "partial"
    assert status(n_effects=0, unexplained=(1,)) == "exhausted"
    assert status(floor=np.full(6, np.nan)) == "unknown"
    double = {"error_before": 3 * floor, "error_after": 2 * floor}
    assert status(**double, intervals={}) == "unsettled"
    sure = {"after": np.array([1.9 * floor, 2.1 * floor])}
    assert status(**double, intervals=sure) == "unsettled"
    unsure = {"after": np.array([0.8 * floor, 3.0 * floor])}
    assert status(**double, intervals=unsure) == "complete"
    assert status(error_before=0.5 * floor, intervals={}) == "worse"
    nothing = np.full(6, np.nan)
    assert status(error_before=nothing, error_after=nothing) == "no data"


def test_worse_than_the_mean_torque_is_said_with_its_causes():
    outcome = make_outcome(nv=3, n_effects=0)
    after = np.array([0.05, 1.0, 1.3])
    report = Report(
        make_outcome(
            nv=3,
            n_effects=0,
            error_before=after,
            error_after=after,
            # even where the noise floor is as high
            floor=np.array([0.05, 1.0, 1.3]),
            intervals={},
            channels=(),
        )
    )
    assert report.status == "failed"
    assert [v.status for v in report.joints] == ["floor", "failed", "failed"]
    assert "oints 2 and 3 are predicted worse than by their mean" in report.headline
    for text in (str(report), report.to_markdown(), report.to_html()):
        text = " ".join(text.split())
        assert not any(claim in text for claim in SUCCESS)
        for cause in ("sign", "order", "unit", "coupling", "slow", "noise"):
            assert cause in text[text.index("Likely causes") :]
    assert "Likely causes" not in str(Report(outcome))
    almost = make_outcome(nv=1, n_effects=0, error_after=np.array([0.999]))
    assert Report(almost).status != "failed"


def test_what_to_do_about_a_channel_is_not_cut_off():
    message = f"The torque of joint 1 is {'very ' * 30}wrong: multiply it by -1."
    doubts = finding("Joint 2 stands still.", "doubt"), finding(message, "doubt")
    text = str(Report(make_outcome(nv=2, n_effects=1, channels=doubts)))
    assert f"Channel: {message}" in " ".join(text.split())
    # Of a warning a terminal has the first clause.
    many = " ".join(str(Report(make_outcome(channels=(finding(message),) * 3))).split())
    assert many.count("very wrong. Channel: The torque of joint 1") == 1
    assert "very wrong. Channel: 1 more (page)." in many
    assert "multiply" not in many


def test_a_doubt_comes_first_and_above_everything():
    message = "The torque of joint 1 is 0.1 times what the model asks for."
    doubts = (finding("Joint 2 stands still."), finding(message, "doubt"))
    for case in CASES.values():
        report = Report(make_outcome(**(case | {"channels": doubts})))
        assert report.status == "faulty"
        assert report.headline.startswith(f"Fix the recording first. {message}")
        assert str(report).startswith("Fix the recording first.")
        page = report.to_html()
        assert page.index(message) < page.index("Error of each joint")
        assert '<header class="bad">' in page
        for text in (str(report), report.to_markdown(), page):
            assert not any(claim in " ".join(text.split()) for claim in SUCCESS)
    two = Report(make_outcome(channels=(*doubts, finding("Wrapped.", "doubt"))))
    assert "(1 more doubt below.)" in two.headline
    assert "Wrapped." in two.to_html()


def test_a_joint_that_hardly_moves_gets_no_verdict():
    enough = np.array([True, True, False])
    seconds = np.array([9.0, 9.0, 0.31])
    after = np.array([0.05, 0.05, 3.0])
    report = Report(
        make_outcome(
            nv=3,
            n_effects=0,
            enough=enough,
            seconds=seconds,
            error_after=after,
            error_before=after,
            floor=np.full(3, 0.05),
            intervals={},
        )
    )
    assert [v.status for v in report.joints] == ["floor", "floor", "few"]
    assert report.joints[2].text == "no verdict: moves for 0.31 s only"
    assert report.status == "nothing"
    assert "Joint 3 moves too little for a verdict." in report.headline
    # What is judged by a handful of rows is not part of the mean.
    assert "data 5.0 %" in report.verdict
    none = Report(make_outcome(nv=3, enough=np.zeros(3, bool)))
    assert none.status == "no data"
    assert "record more motion" in none.headline


def test_errors_are_given_in_newton_metres_and_in_a_wider_band():
    outcome = make_outcome(nv=2, n_effects=1, channels=())
    report = Report(outcome)
    newton_metres = f"{outcome.error_after[0] * outcome.spread[0]:.2g}"
    for text in (str(report), report.to_markdown(), report.to_html()):
        assert newton_metres in text
        assert "up to 40 Hz" in " ".join(text.split())
    bare = Report(
        make_outcome(
            nv=2,
            wide_cutoff=np.nan,
            wide_before=np.full(2, np.nan),
            wide_after=np.full(2, np.nan),
        )
    )
    assert "Hz" not in bare.verdict
    assert "? %" not in bare.to_html()


def test_a_long_name_is_whole():
    long = f"left_arm_{'x' * 70}"
    assert words.joint_label(("first", long), 1) == f"joint 2 ({long})"
    report = Report(make_outcome(nv=2, names=("first", long)))
    for text in (str(report), report.to_html()):
        assert long in "".join(text.split())


@pytest.mark.parametrize(
    "changes",
    [
        {"n_effects": 0, "unexplained": (2,)},
        {"n_effects": 3, "unexplained": (2,)},
        {"floor": np.full(6, np.nan)},
        {"floor": np.r_[0.1, np.full(5, np.nan)]},
        {"error_before": np.full(6, 0.01), "intervals": {}},
        {"error_after": np.full(6, np.nan)},
    ],
)
def test_success_is_never_claimed_while_something_is_open(changes):
    report = Report(make_outcome(**changes))
    for text in (str(report), report.to_markdown(), report.to_html(), report.verdict):
        assert not any(claim in " ".join(text.split()) for claim in SUCCESS)
    assert 'class="good"' not in report.to_html()


def test_verdict_names_the_joints_that_stay_above_the_floor():
    report = Report(make_outcome(n_effects=0, unexplained=(1, 4)))
    noise = words.percent(report.outcome.floor[1])
    told = (
        "4.3 % of the torque of joints 2 and 5 remains unexplained "
        f"(joint 2; its noise: {noise})"
    )
    assert f"No known effect is missing, but up to {told}." in report.verdict
    named = make_outcome(
        nv=2, n_effects=0, unexplained=(1,), names=("shoulder", "elbow")
    )
    verdict = Report(named).verdict
    told = "4.3 % of the torque of joint 2 (elbow) remains unexplained (noise: "
    assert f"but {told}" in verdict


def test_verdict_says_when_held_out_data_got_worse():
    outcome = make_outcome(nv=2, n_effects=1)
    sure = {"difference": np.array([[-0.1, 0.01], [0.1, 0.05]])}
    before = 0.5 * outcome.error_after
    report = Report(
        make_outcome(nv=2, n_effects=1, intervals=sure, error_before=before)
    )
    assert report.status == "worse"
    assert "joint 2 predicts held-out data worse" in report.verdict


def test_plain_terms_are_told_as_added_with_an_error_of_their_own():
    outcome = make_outcome(nv=2, n_effects=1)
    plain = np.sqrt(outcome.error_before * outcome.error_after)
    added = ("offset", "rotor_inertia")
    more = {"added": added, "error_plain": plain, "wide_plain": plain}
    report = Report(make_outcome(nv=2, n_effects=1, **more))
    errors = [words.percent(e.mean()) for e in (outcome.error_before, plain)]
    assert f"{errors[0]} before, {errors[1]} with the four plain terms" in (
        " ".join(report.verdict.split())
    )
    for text in (str(report), report.to_markdown(), report.to_html()):
        assert words.bare_percent(plain[1]) in " ".join(text.split())
    for text in (report.to_markdown(), report.to_html()):
        flat = " ".join(text.split())
        assert "as not declared: constant offset and rotor inertia" in flat
    assert max(map(len, str(report).splitlines())) <= 80
    assert report.to_html().count('class="fill plain"') == 2
    assert report.to_dict()["added"] == list(added)
    assert "four plain" not in Report(outcome).to_html()
    none = Report(
        make_outcome(nv=2, n_effects=0, unexplained=(), **more, error_after=plain)
    )
    assert none.headline.startswith("Constant offset and rotor inertia were added; ")
    assert "beyond these nothing is missing" in none.headline


def test_effects_that_do_harm_beside_the_plain_terms_are_told():
    outcome = make_outcome(nv=2, n_effects=1)
    worse = {"added": np.array([[-0.1, 0.01], [0.1, 0.05]])}
    report = Report(
        make_outcome(
            nv=2,
            n_effects=1,
            added=("offset",),
            error_plain=0.5 * outcome.error_after,
            wide_plain=outcome.wide_after,
            intervals=outcome.intervals | worse,
        )
    )
    assert report.status == "worse"
    assert "joint 2 predicts held-out data worse than with the plain terms alone" in (
        report.headline
    )


def test_joints_that_were_not_searched_are_no_success():
    every = Report(make_outcome(nv=2, n_effects=0, unexplained=(), unsearched=(0, 1)))
    assert every.status == "unsearched"
    assert every.headline.startswith("Nothing was searched: the channels of all joints")
    for text in (str(every), every.to_markdown(), every.to_html()):
        assert not any(claim in " ".join(text.split()) for claim in SUCCESS)
    one = Report(make_outcome(nv=3, n_effects=0, unexplained=(), unsearched=(2,)))
    assert one.status == "nothing"
    assert one.joints[2].text == "not searched: see its channels"
    assert "Joint 3 was not searched." in one.headline


def test_a_little_worse_is_not_worse():
    # A refit moves the errors of all joints a little, and paired blocks notice.
    outcome = make_outcome(n_effects=1)
    after = 1.01 * outcome.error_before
    sure = {"difference": np.array([0.005, 0.015])[:, None] * outcome.error_before}
    report = Report(make_outcome(n_effects=1, error_after=after, intervals=sure))
    assert report.status != "worse"


def test_dict_round_trip(outcome):
    data = Report(outcome).to_dict()
    text = json.dumps(data, allow_nan=False)
    assert json.loads(text) == data
    assert data["schema_version"] == 11
    assert "curves" not in data
    assert len(data["effects"]) == len(outcome.effects)
    assert len(data["error_before"]) == len(outcome.joint_names)


def test_dict_has_the_effect_and_no_nan():
    effect = make_effect(0, 0, ("a",))
    object.__setattr__(effect, "effect", Coulomb(joint=0))
    values = {"floor": np.array([np.nan]), "effects": (effect,)}
    data = Report(make_outcome(nv=1, **values)).to_dict()
    assert data["floor"] == [None]
    assert data["effects"][0]["effect"]["class"] == "Coulomb"
    assert data["effects"][0]["effect"]["parameters"]["joint"] == 0


class _Page(HTMLParser):
    VOID = frozenset({"meta", "br"})

    def __init__(self):
        super().__init__()
        self.open, self.seen, self.attributes = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.attributes += attrs
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def parsed(html):
    page = _Page()
    page.feed(html)
    page.close()
    return page


def test_page_is_whole_and_loads_nothing(outcome):
    html = Report(outcome).to_html()
    page = parsed(html)
    assert page.open == []
    assert "script" not in page.seen
    assert not {"src", "srcset"} & {name for name, _ in page.attributes}
    places = [value for name, value in page.attributes if name == "id"]
    links = [value for name, value in page.attributes if name == "href"]
    assert links == [f"#{place}" for place in places]
    assert "url(" not in html
    assert "@import" not in html
    assert "http" not in html
    assert "prefers-color-scheme" in html


def test_page_shows_every_joint_and_effect():
    outcome = make_outcome(**CASES["twelve joints"])
    html = Report(outcome).to_html()
    assert html.count('class="joint"') == 12
    assert html.index("<h1>") < html.index("<nav>") < html.index('class="joint"')
    assert len(html) < 400_000


def test_page_escapes_what_it_is_given():
    bad = '<script>alert("x")</script>'
    outcome = make_outcome(
        nv=1,
        names=(bad,),
        channels=(finding(bad),),
        declared={"robot": bad},
        settings={"effects": (bad,), "versions": {bad: bad}},
    )
    for html in (Report(outcome).to_html(), Report(outcome)._repr_html_()):
        assert "<script" not in html
        assert "&lt;script&gt;" in html


def test_notebook_shows_the_same_without_a_document():
    html = Report(make_outcome())._repr_html_()
    assert "<html" not in html
    assert "<body" not in html
    assert parsed(html).open == []
    # The style must not reach the notebook's own elements.
    style = re.search(r"<style>(.*?)</style>", html, re.DOTALL)[1]
    rules = re.findall(r"(?:^|[{}])\s*([^{}@]+)\{", style)
    selectors = [x.strip() for rule in rules for x in rule.split(",")]
    assert selectors
    assert all(x.startswith(".vbjfa") for x in selectors), selectors


def test_markdown_tables_are_rectangular(outcome):
    text = Report(outcome).to_markdown()
    assert text.startswith("# ")
    widths = []
    for line in text.splitlines():
        if line.startswith("|"):
            widths.append(len(re.findall(r"(?<!\\)\|", line)))
        elif widths:
            assert len(set(widths)) == 1
            widths = []


def test_markdown_escapes_table_borders():
    text = Report(make_outcome(nv=1, names=("a|b",))).to_markdown()
    assert "a\\|b" in text


def test_repr_is_short():
    text = repr(Report(make_outcome()))
    assert len(text) < 100
    assert "\n" not in text


def test_next_recording_is_named():
    text = str(Report(make_outcome(nv=2, n_effects=0, unexplained=(1,))))
    assert "Record next: slow and fast motion (joint 2)" in text
    marked = Report(make_outcome(nv=2, n_effects=0)).to_markdown()
    assert "cannot show counterbalance" in marked


def test_every_effect_has_a_plain_name_and_a_remedy():
    outcome = make_outcome()
    for name in available():
        assert words.effect_label(outcome, name)
        assert words.record_for(outcome, name)


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


@pytest.mark.parametrize("call", [str, Report.to_markdown, Report.to_html])
def test_an_effect_of_ones_own_is_called_by_the_label_of_its_class(call):
    found = replace(make_effect(0, 0, NAMES), name=Gasket.name, rivals=(Hose.name,))
    step = replace(make_round(found, "replace"), name=Hose.name, replaced=Gasket.name)
    hidden = Hidden(
        name=Hose.name, joint=2, joint_name=NAMES[2], reason="excitation", remedy="?"
    )
    outcome = make_outcome(
        nv=6,
        effects=(found,),
        rounds=(step,),
        hidden=(hidden,),
        library={effect.name: effect for effect in (Gasket(), Hose())},
    )
    text = " ".join(call(Report(outcome)).split())
    verdict, rest = text.split("missing", 1)
    assert Gasket.label in verdict.replace("Squeeze", "squeeze")
    assert Gasket.label in rest
    # Rival; hidden, and a step as well, of which a terminal shows none.
    assert rest.count(Hose.label) >= (1 if call is str else 3)
    assert f"{Gasket.record} (joint 1)" in text
    if call is not str:
        assert f"{Hose.record} (joints 1 and 3)" in text
    assert "own gasket" not in text
    assert "own hose" not in text
    assert "library" not in Report(outcome).to_dict()


@pytest.mark.parametrize(
    ("value", "interval", "unit", "expected"),
    [
        (0.1123, (0.1023, 0.1223), "", "0.112 +- 0.010"),
        (0.1123, (0.08, 0.14), "", "0.11 +- 0.03"),
        (13.0145, (12.683, 13.346), "N m", "13.0 +- 0.3 N m"),
        (1234.5, (1000.0, 1469.0), "N", "1200 +- 200 N"),
        (2e-7, (1.8e-7, 2.2e-7), "", "(2.0 +- 0.2)e-7"),
        (0.5, None, "s", "0.5 s"),
        (0.5, (0.5, 0.5), "s", "0.5 s"),
        (np.nan, (0.0, 1.0), "s", "? s"),
    ],
)
def test_values_are_rounded_to_what_the_interval_means(value, interval, unit, expected):
    assert words.with_error(value, interval, unit) == expected


# -- odds


@pytest.mark.parametrize(
    ("log_odds", "expected"),
    [
        (np.log(19.0), "19 : 1"),
        (np.log(350.0), "350 : 1"),
        (8.2, "3600 : 1"),
        (np.log(0.02), "1 : 50"),
        (0.0, "1 : 1"),
        (50.0, "> 1e6 : 1"),
        (-50.0, "< 1 : 1e6"),
        (np.nan, "unknown"),
        (np.inf, "unknown"),
    ],
)
def test_odds_are_written_as_bets(log_odds, expected):
    assert words.odds_text(log_odds) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.5, "50 %"), (0.876, "88 %"), (0.9999, "99 %"), (1e-9, "1 %")],
)
def test_nothing_is_certain(value, expected):
    assert words.probability_text(value) == expected


# -- perhaps


@pytest.fixture(name="open_question")
def fixture_open_question():
    """One name, and two that are possible."""
    possible = (
        make_possible(2, 3, NAMES),
        make_possible(1, 4, NAMES, warning=SMALL, evidence=EVIDENCE),
    )
    return make_outcome(n_effects=1, possible=possible)


def test_what_is_perhaps_missing_is_told_with_its_probability(open_question):
    report = Report(open_question)
    text = str(report)
    # No heading says so in a terminal.
    assert "\n- perhaps torque ripple on joint 4 (80 %) and 1 more (page)\n" in text
    for shown in formats(report)[1:]:
        assert "probability" in shown
        assert "80 %" in shown
        assert "why not named" in shown
        assert "undecided" in shown
    data = report.to_dict()
    assert [e["warning"] for e in data["effects"]] == [""]
    assert [e["warning"] for e in data["possible"]] == ["undecided", SMALL]
    assert data["possible"][0]["probability"] == pytest.approx(0.8, abs=0.001)
    assert data["possible"][0]["log_odds"] == pytest.approx(1.386)
    assert data["effects"][0]["log_odds"] == pytest.approx(8.2)


def test_what_is_perhaps_missing_is_no_name(open_question):
    without = Report(replace(open_question, possible=()))
    report = Report(open_question)
    assert report.headline == without.headline
    assert report.status == without.status
    assert [v.n_effects for v in report.joints] == [0, 1, 0, 0, 0, 0]
    assert "Perhaps" not in without.to_markdown()


def test_with_something_perhaps_nothing_is_not_said_to_be_missing():
    possible = (make_possible(2, 3, NAMES),)
    outcome = make_outcome(n_effects=0, possible=possible)
    after = outcome.error_after
    report = Report(replace(outcome, error_before=3 * after, error_plain=3 * after))
    assert report.status == "nothing"
    assert "Nothing is missing" not in report.headline
    assert "perhaps torque ripple on joint 4" in report.headline
    # The errors are those of the models with and without it.
    mean = outcome.error_after.mean()
    said = f"{words.percent(3 * mean)} before, {words.percent(mean)} after"
    assert said in " ".join(report.verdict.split())


def test_what_is_perhaps_missing_and_does_harm_is_told():
    outcome = make_outcome(n_effects=0, possible=(make_possible(2, 3, NAMES),))
    worse = replace(outcome, error_before=0.5 * outcome.error_after, intervals={})
    report = Report(worse)
    assert report.status == "worse"
    assert "perhaps missing" in report.headline.lower()
    assert "worse than before" in report.headline


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0, "0"), (250.0, "250"), (0.00012, "0.00012"), (3.2e-9, "3.2e-9"), (1e7, "1e7")],
)
def test_numbers_are_short(value, expected):
    assert words.number(value) == expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("joint2", "joint 2"),
        ("joint_2", "joint 2"),
        ("joint1", "joint1"),
        ("panda_joint2", "panda_joint2"),
        ("elbow", "joint 2 (elbow)"),
        ("2", "joint 2"),
        ("", "joint 2"),
    ],
)
def test_joints_are_counted_from_one_or_named(name, expected):
    assert words.joint_label(("first", name), 1) == expected


# -- ranges


def outside(joint=1, quantity="position", **given):
    return OutsideRange(
        **{
            "names": ("ripple", "spring"),
            "joint": joint,
            "quantity": quantity,
            "fitted": (-1.25, 1.5),
            "reached": 2.04,
            "share": 0.125,
            "held": ("spring",),
            **given,
        }
    )


def formats(report):
    texts = (str(report), report.to_markdown().replace("\\", ""), report.to_html())
    return [" ".join(text.replace("\u00a0", " ").split()) for text in texts]


def test_effects_say_what_they_were_fitted_on():
    effects = (make_effect(2, 1, NAMES), make_effect(0, 0, NAMES))
    report = Report(make_outcome(effects=effects))
    text, *others = formats(report)
    # What an effect does not depend on is left to the dictionary.
    for shown in (text, *others):
        assert shown.count("fitted on") == 1
        before = shown[: shown.index("fitted on positions of -1.25 to 1.5 rad")]
        assert "ripple" in before
        assert "up to 2 rad/s" not in shown
    data = report.to_dict()["effects"][0]["ranges"]
    assert data["position"] == [-1.25, 1.5]
    assert data["depends"] == ["position"]


def test_one_direction_only_is_told():
    (effect,) = make_outcome(n_effects=1).effects
    ranges = replace(effect.ranges, direction=(0.0, 1.0), depends=("direction",))
    backward = {"fitted": (0.0, 1.0), "reached": -1.0}
    found = outside(0, "direction", names=("coulomb",), held=(), **backward)
    changed = {"effects": (replace(effect, ranges=ranges),), "outside": (found,)}
    text, *others = formats(Report(make_outcome(**changed)))
    assert "fitted on forward motion only" in text
    for shown in others:
        assert "forward motion only" in shown
        assert "joint 1: moves backward, fitted on the other direction only" in shown
        assert "by the law" not in shown


def test_ranges_of_a_slider_are_in_metres():
    effects = (make_effect(2, 0, NAMES),)
    outcome = make_outcome(nv=1, effects=effects, torque_units=("N",))
    for shown in formats(Report(outcome)):
        assert "-1.25 to 1.5 m" in shown
        assert " rad" not in shown.split("fitted on")[1][:60]


def test_ranges_that_are_not_known_are_not_shown():
    (effect,) = make_outcome(n_effects=1).effects
    for ranges in (None, replace(effect.ranges, position=(np.nan,) * 2)):
        report = Report(make_outcome(effects=(replace(effect, ranges=ranges),)))
        for shown in formats(report):
            assert "nan" not in shown
            assert "-1.25 to 1.5" not in shown


def test_held_out_data_outside_of_the_fit_are_marked():
    viscous = {"fitted": (0.5, 1.0), "names": ("viscous",), "held": ()}
    found = (outside(), outside(0, "speed", **viscous))
    report = Report(make_outcome(outside=found))
    for shown in formats(report)[1:]:
        assert (
            "joint 2: position reaches 2.04, fitted on -1.25 to 1.5 rad "
            "(12.5 % of the rows; torque ripple and spring)"
        ) in shown
        assert "joint 1: speed reaches 2.04, fitted on 0.5 to 1 rad/s" in shown
    for page in formats(report)[1:]:
        assert "Held beyond the margin: spring. Going on by the law: " in page
        assert "by the law: torque ripple, viscous friction." in page
    assert report.to_dict()["outside"][0]["reached"] == 2.04
    inside = formats(Report(make_outcome()))
    assert not any("Outside the range" in shown for shown in inside)
