"""The HTML page: structure, escaping, size, figures, provenance and links."""

import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.report import HEIGHT, WIDTH
from tests.diagnosis.report._outcomes import finding, make_outcome
from tests.diagnosis.report._pages import FILES, figures, made, parsed, section_of

# Patterns of terms, and their entries in the list of terms.
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


@pytest.mark.parametrize("drawn", [True, False])
def test_page_is_valid_and_loads_nothing(drawn):
    page = Report(made() if drawn else make_outcome()).to_html()
    elements = parsed(page)
    assert elements.open == []
    assert not {"src", "srcset"} & {name for name, _ in elements.attributes}
    assert "@import" not in page
    assert "url(" not in page
    assert "<script" not in page
    assert not re.findall("https?://", page)
    anchors = [value for name, value in elements.attributes if name == "id"]
    assert len(set(anchors)) == len(anchors)


def test_contents_link_to_every_section(html, outcome):
    nav = re.search("<nav>.*?</nav>", html, re.DOTALL)[0]
    links = re.findall('<a href="#([^"]+)">([^<]+)</a>', nav)
    assert links == re.findall('<h2 id="([^"]+)">([^<]+)</h2>', html)
    assert len({heading for _, heading in links}) == len(links) >= 9


def test_notebook_html_is_a_fragment_with_figures(outcome, html):
    fragment = Report(outcome)._repr_html_()
    for mark in ("<html", "<body", "<script", "<nav>"):
        assert mark not in fragment
    assert len(figures(fragment)) == len(figures(html))
    assert parsed(fragment).open == []
    # The style must not affect other elements of the notebook.
    sheet = re.search(r"<style>(.*?)</style>", fragment, re.DOTALL)[1]
    rules = re.findall(r"(?:^|[{}])\s*([^{}@]+)\{", sheet)
    selectors = [x.strip() for rule in rules for x in rule.split(",")]
    assert selectors
    assert all(x.startswith(".vbjfa") for x in selectors), selectors


@pytest.mark.parametrize("call", ["to_html", "_repr_html_"])
def test_names_are_escaped(call):
    names = (HOSTILE, "'\"><img src=x onerror=alert(1)>")
    result = made(
        nv=2,
        names=names,
        channels=(finding(HOSTILE),),
        name=HOSTILE,
        recordings=(HOSTILE, HOSTILE),
    )
    source = dict.fromkeys(("file", "description", "date"), HOSTILE)
    source |= {"held": (HOSTILE,), "warnings": (HOSTILE,)}
    source["files"] = ('x" onclick="alert(1).csv', "javascript:alert(1)")
    result = replace(result, provenance=result.provenance | source)
    page = getattr(Report(result), call)()
    assert "<script>alert" not in page
    assert "<img" not in page
    tags = parsed(page)
    assert tags.open == []
    assert not {"onclick", "onerror", "src"} & {name for name, _ in tags.attributes}
    links = [value for name, value in tags.attributes if name == "href"]
    assert not any(link.startswith("javascript:") for link in links)


@pytest.mark.parametrize(("nv", "n_effects"), [(6, 6), (30, 40)])
def test_page_size_is_bounded(nv, n_effects):
    page = Report(made(nv=nv, n_effects=n_effects)).to_html()
    assert len(page.encode("utf-8")) < 3_000_000


@pytest.mark.parametrize("case", [{}, {"n_effects": 0}])
def test_terms_are_explained_at_their_first_use(case):
    page = Report(made(**case)).to_html().replace("\u00a0", " ")
    page = re.sub(r"<(style|script)\b.*?</\1>", "", page, flags=re.DOTALL)
    parts = re.split("(?=<h2)", page)
    for form, name in TERMS:
        first = next((part for part in parts if re.search(form, read(part))), None)
        where = [part for part in parts if f"<dt>{name}</dt>" in part]
        assert where == ([] if first is None else [first]), name


def read(part):
    """Return the text of a part of a page without explanations of terms."""
    part = re.sub(r"<(nav|dl)\b.*?</\1>", "", part, flags=re.DOTALL)
    labels = re.sub('aria-label="[^"]*"', "", part)
    return re.sub("<[^>]*>", "\n", labels).strip()


def test_figures_of_torques_and_residuals(outcome, html, monkeypatch):
    charts = figures(html)
    assert len(charts) == 3 + 3
    kinds = ("line-before", "line-after", "zero")
    for figure in charts[:3]:
        torque, residual = figure.split('<div class="chart"')[1:]
        for chart in (torque, residual):
            assert all(f'<path class="{kind}" d="M' in chart for kind in kinds)
        # Both charts have the same time axis.
        axes = re.findall('class="x-axis">(.*?)</div>', figure, re.DOTALL)
        assert len(axes) == 2
        assert axes[0] == axes[1]
        # The residual is omitted at standstill, the first of 20 s.
        path = re.search('class="line-before" d="M([0-9.]+) ', residual)[1]
        assert float(path) == pytest.approx(WIDTH / 20, abs=1)
    # Figures need neither scripts nor matplotlib.
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    page = re.sub("<script.*?</script>", "", Report(outcome).to_html(), flags=re.S)
    assert page.count("<svg") == 3 * 4


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
                ticks = re.findall(r">([^<>]+)</span>", axis)
                assert 2 <= len(ticks) <= 7
                assert np.all(np.diff([float(x) for x in ticks]) > 0)


def test_outliers_are_cut_off_and_noted():
    data = made(nv=1, n_effects=0)
    (torque,) = data.curves["torques"]
    torque.measured[300:310] = 500.0
    page = Report(data).to_html()
    (spiked, *_) = figures(page)
    axis = re.search('class="y-axis">(.*?)</div>', spiked, re.DOTALL)[1]
    assert max(float(x) for x in re.findall(r">([^<>]+)</span>", axis)) <= 4
    assert "values to 500" in spiked


def test_page_shows_the_provenance(html):
    files = ("logs/slow.csv", "logs/<fast>.csv")
    result = made()
    result = replace(result, provenance=result.provenance | {"file": files})
    text = section_of(Report(result), "Provenance and method")
    facts = "4000 samples, 20 s, 2 recordings (slow and fast)", "200 Hz", "arm.urdf"
    more = "finger_left", "Torque of joint 1 is coarse.", "Another warning."
    for fact in (*files, *facts, *more):
        assert fact in text
    for name in FILES:
        assert f'<a href="{name}">{name}</a>' in html
    data = Report(result).to_dict()
    assert data["provenance"]["file"] == list(files)
    assert data["provenance"]["rate"] == 200.0


def test_parameters_are_compared_with_the_description():
    page = Report(made(nv=1)).to_html()
    text = page[page.index("Identified parameters</h2>") :]
    rows = re.findall(r"<tr>(<td>.*?)</tr>", text)
    cells = [re.findall("<td>(.*?)</td>", row) for row in rows][:2]
    assert cells[0] == ["m", "1.5 ± 0.2", "1.25", "kg", "yes"]
    # Parameters identified in combination have no interval.
    assert cells[1] == ["viscous", "1.5", "", "kg", "in combination"]
