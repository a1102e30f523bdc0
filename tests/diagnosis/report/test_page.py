"""The page: pictures, provenance, links; whole, safe and small."""

import importlib.metadata
import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.report import HEIGHT, WIDTH, documentation_of
from tests.diagnosis.report._outcomes import finding, make_outcome
from tests.diagnosis.report._pages import FILES, figures, made, parsed, section_of

# Terms of which some are read on any page, and where they come first.
TERMS = (
    ("[Dd]eclared model", "Declared model"),
    ("[Ee]rror", "Error"),
    ("[Rr]esidual", "Residual"),
    ("[Hh]eld-out", "Held-out data"),
    ("odds", "Odds"),
)
HOSTILE = '</script><script>alert("x")</script>'


@pytest.fixture(scope="module")
def outcome():
    return made(nv=3, n_effects=3)


@pytest.fixture(scope="module")
def html(outcome):
    return Report(outcome).to_html()


# -- the whole


@pytest.mark.parametrize("drawn", [True, False])
def test_a_page_is_whole_and_loads_nothing(drawn):
    page = Report(made() if drawn else make_outcome()).to_html()
    seen = parsed(page)
    assert seen.open == []
    assert not {"src", "srcset"} & {name for name, _ in seen.attributes}
    assert "@import" not in page
    assert "url(" not in page
    assert "<script" not in page
    assert not re.findall("https?://", page)
    places = [value for name, value in seen.attributes if name == "id"]
    assert len(set(places)) == len(places)


def test_the_contents_lead_to_every_section(html, outcome):
    nav = re.search("<nav>.*?</nav>", html, re.DOTALL)[0]
    links = re.findall('<a href="#([^"]+)">([^<]+)</a>', nav)
    assert links == re.findall('<h2 id="([^"]+)">([^<]+)</h2>', html)
    assert len({heading for _, heading in links}) == len(links) >= 9


def test_a_notebook_gets_the_pictures_and_no_document(outcome, html):
    shown = Report(outcome)._repr_html_()
    for mark in ("<html", "<body", "<script", "<nav>"):
        assert mark not in shown
    assert len(figures(shown)) == len(figures(html))
    assert parsed(shown).open == []
    # The style must not reach the notebook's own elements.
    sheet = re.search(r"<style>(.*?)</style>", shown, re.DOTALL)[1]
    rules = re.findall(r"(?:^|[{}])\s*([^{}@]+)\{", sheet)
    selectors = [x.strip() for rule in rules for x in rule.split(",")]
    assert selectors
    assert all(x.startswith(".vbjfa") for x in selectors), selectors


@pytest.mark.parametrize("call", ["to_html", "_repr_html_"])
def test_whatever_a_name_is_it_is_text(call):
    names = (HOSTILE, "'\"><img src=x onerror=alert(1)>")
    given = made(
        nv=2,
        names=names,
        channels=(finding(HOSTILE),),
        name=HOSTILE,
        recordings=(HOSTILE, HOSTILE),
    )
    source = dict.fromkeys(("file", "description", "date"), HOSTILE)
    source |= {"held": (HOSTILE,), "warnings": (HOSTILE,)}
    source["files"] = ('x" onclick="alert(1).csv', "javascript:alert(1)")
    given = replace(given, provenance=given.provenance | source)
    page = getattr(Report(given), call)()
    assert "<script>alert" not in page
    assert "<img" not in page
    seen = parsed(page)
    assert seen.open == []
    assert not {"onclick", "onerror", "src"} & {name for name, _ in seen.attributes}
    links = [value for name, value in seen.attributes if name == "href"]
    assert not any(link.startswith("javascript:") for link in links)


@pytest.mark.parametrize(("nv", "n_effects"), [(6, 6), (30, 40)])
def test_a_page_stays_small(nv, n_effects):
    page = Report(made(nv=nv, n_effects=n_effects)).to_html()
    assert len(page.encode("utf-8")) < 3_000_000


@pytest.mark.parametrize("case", [{}, {"n_effects": 0}])
def test_terms_are_explained_where_they_come_first(case):
    page = Report(made(**case)).to_html().replace("\u00a0", " ")
    page = re.sub(r"<(style|script)\b.*?</\1>", "", page, flags=re.DOTALL)
    parts = re.split("(?=<h2)", page)
    for form, name in TERMS:
        first = next((part for part in parts if re.search(form, read(part))), None)
        told = [part for part in parts if f"<dt>{name}</dt>" in part]
        assert told == ([] if first is None else [first]), name


def read(part):
    """Return what is read of a part of a page but for what terms mean."""
    part = re.sub(r"<(nav|dl)\b.*?</\1>", "", part, flags=re.DOTALL)
    labels = re.sub('aria-label="[^"]*"', "", part)
    return re.sub("<[^>]*>", "\n", labels).strip()


# -- pictures


def test_every_torque_and_every_residual_has_its_picture(outcome, html, monkeypatch):
    shown = figures(html)
    assert len(shown) == 3 + 3
    kinds = ("line-before", "line-after", "zero")
    for figure in shown[:3]:
        torque, residual = figure.split('<div class="chart"')[1:]
        for chart in (torque, residual):
            assert all(f'<path class="{kind}" d="M' in chart for kind in kinds)
        # Below each other, on the same axis of time.
        axes = re.findall('class="x-axis">(.*?)</div>', figure, re.DOTALL)
        assert len(axes) == 2
        assert axes[0] == axes[1]
        # Nothing is drawn where the joint stands still: before 1 s of 20 s.
        path = re.search('class="line-before" d="M([0-9.]+) ', residual)[1]
        assert float(path) == pytest.approx(WIDTH / 20, abs=1)
    # They are drawn without the library, and without matplotlib.
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    still = re.sub("<script.*?</script>", "", Report(outcome).to_html(), flags=re.S)
    assert still.count("<svg") == 3 * 4


def test_curves_stay_inside_their_frames(html):
    svgs = re.findall(r"<svg (.*?)</svg>", html, re.DOTALL)
    assert len(svgs) == html.count('<div class="chart"')
    for svg in svgs:
        paths = re.findall(r'<path class="([^"]+)"[^>]* d="([^"]*)"', svg)
        curves = [path for kind, path in paths if kind != "zero"]
        assert curves
        for path in curves:
            points = re.findall(r"[ML]([-0-9.]+) ([-0-9.]+)", path)
            x, y = np.array(points, dtype=float).T
            assert (-1 <= x).all()
            assert (x <= WIDTH + 1).all()
            assert (np.abs(y / HEIGHT - 0.5) <= 0.53).all()


def test_axes_have_units_and_rising_numbers(html):
    units = r"\[(N m|N|s|rad|rad/s|Hz|N m/√Hz|1)\]$"
    for figure in figures(html):
        for chart in figure.split('<div class="chart"')[1:]:
            for side in "yx":
                name = rf'class="{side}-name">(?:<span>)?([^<]+)<'
                assert re.search(units, re.search(name, chart)[1].strip())
                axis = rf'class="{side}-axis">(.*?)</div>'
                axis = re.search(axis, chart, re.DOTALL)[1]
                found = re.findall(r">([^<>]+)</span>", axis)
                assert 2 <= len(found) <= 7
                assert np.all(np.diff([float(x) for x in found]) > 0)


def test_outliers_are_cut_off_and_noted():
    given = made(nv=1, n_effects=0)
    (one,) = given.curves["torques"]
    one.measured[300:310] = 500.0
    page = Report(given).to_html()
    (spiked, *_) = figures(page)
    axis = re.search('class="y-axis">(.*?)</div>', spiked, re.DOTALL)[1]
    assert max(float(x) for x in re.findall(r">([^<>]+)</span>", axis)) <= 4
    assert "values to 500" in spiked


def test_effects_link_to_their_documentation(monkeypatch):
    class Metadata:
        def get_all(self, key, default):
            return ["Homepage, https://h.org", *urls]

    monkeypatch.setattr(importlib.metadata, "metadata", lambda name: Metadata())
    urls = []
    assert documentation_of("ripple") == ""
    urls = ["Documentation, https://docs.example.org/"]
    address = "https://docs.example.org/effects/ripple.html"
    assert documentation_of("ripple") == address
    assert documentation_of("my_own_effect") == ""
    assert f'<a href="{address}">' in Report(made(n_effects=3)).to_html()


# -- what stands in tables


def test_the_page_says_where_it_comes_from(html):
    files = ("logs/slow.csv", "logs/<fast>.csv")
    given = made()
    given = replace(given, provenance=given.provenance | {"file": files})
    shown = section_of(Report(given), "Provenance and method")
    for said in (
        *files,
        "4000 samples, 20 s, 2 recordings (slow and fast)",
        "200 Hz",
        "arm.urdf",
        "finger_left",
        "Torque of joint 1 is coarse.",
        "Another warning.",
    ):
        assert said in shown
    for name in FILES:
        assert f'<a href="{name}">{name}</a>' in html
    data = Report(given).to_dict()
    assert data["provenance"]["file"] == list(files)
    assert data["provenance"]["rate"] == 200.0


def test_parameters_stand_beside_those_of_the_description():
    page = Report(made(nv=1)).to_html()
    text = page[page.index("Identified parameters</h2>") :]
    rows = re.findall(r"<tr>(<td>.*?)</tr>", text)
    cells = [re.findall("<td>(.*?)</td>", row) for row in rows][:2]
    assert cells[0] == ["m", "1.5 ± 0.2", "1.25", "kg", "yes"]
    # One of many values has no interval.
    assert cells[1] == ["viscous", "1.5", "", "kg", "in combination"]
