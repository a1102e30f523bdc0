"""The page fits its screen: by its paths and its style, and in a browser if one is."""

import json
import re
import shutil
import subprocess
from collections import Counter
from html import unescape

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.report import HEIGHT, WIDTH, style
from tests.diagnosis.report.test_page import made
from tests.diagnosis.report.test_report import parsed

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
# What a page says of itself once it is drawn: the errors of its scripts, what reaches
# beyond the window, pictures that are empty, and what the zoom of each figure draws.
PROBE = """
<script>
window.addEventListener("load", async function () {
  var told = {errors: window.failures, width: innerWidth, wide: [], empty: 0,
              charts: document.querySelectorAll(".chart svg").length, zoomed: 0};
  document.querySelectorAll("main *").forEach(function (one) {
    var scrolls = one.closest(".scroll, .formula"), box = one.getBoundingClientRect();
    if (box.right > innerWidth + 1 && (!scrolls || scrolls === one)) {
      told.wide.push(one.tagName + "." + one.getAttribute("class"));
    }
  });
  told.named = 0;
  document.querySelectorAll(".stack td").forEach(function (one) {
    var name = getComputedStyle(one, "::before").content;
    told.named += !one.textContent.trim() && !["none", "normal"].includes(name);
  });
  told.scroll = document.documentElement.scrollWidth;
  document.querySelectorAll(".chart svg").forEach(function (svg) {
    var size = svg.getBoundingClientRect(), drawn = 0;
    svg.querySelectorAll("path").forEach(function (path) {
      var box = path.getBBox();
      drawn += box.width > 0 && (box.height > 0 || box.width === 400);
    });
    told.empty += !(size.width > 80 && size.height > 40 && drawn > 1);
  });
  for (const tools of document.querySelectorAll("figure .tools")) {
    tools.querySelector("button").click();
    await new Promise(function (done) { setTimeout(done, 50); });
    var canvas = document.querySelector("dialog canvas");
    var pixels = canvas.getContext("2d")
      .getImageData(0, 0, canvas.width, canvas.height).data;
    told.zoomed += pixels.some(function (x) { return x !== 0; });
    document.querySelector("dialog").close();
    await new Promise(function (done) { setTimeout(done, 10); });
  }
  var out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify(told);
  document.body.replaceChildren(out);
  parent.postMessage(out.textContent, "*");
});
</script>
</body>
"""
# A window is at least 500 px wide; what it frames may be narrower. Its answer is passed
# on by a message, since files may not look into each other.
FRAME = """<!DOCTYPE html>
<iframe src="report.html" style="width:{width}px;height:900px;border:0"></iframe>
<script>
addEventListener("message", function (e) {{
  var out = document.createElement("pre");
  out.id = "probe";
  out.textContent = e.data;
  document.body.replaceChildren(out);
}});
</script>
"""
FAILURES = """<head>
<script>
window.failures = [];
window.addEventListener("error", function (e) { window.failures.push(e.message); });
</script>
"""


def browse(path, *options):
    """Run a browser without a window on a page; skip where there is none."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"none of {', '.join(BROWSERS)} is installed")
    own = ["--headless=new", "--no-sandbox", "--disable-gpu"]
    own.append(f"--user-data-dir={path.parent / 'profile'}")
    return subprocess.run(
        [browser, *own, *options, path.as_uri()],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )


def pages():
    """Pages of a few joints, and of many with long names."""
    names = tuple(f"left_arm_shoulder_{'pitch' * 6}_joint_{j}" for j in range(7))
    return {
        "three joints": Report(made(nv=3, n_effects=3)).to_html(),
        "long names": Report(made(nv=7, n_effects=7, names=names)).to_html(),
    }


@pytest.fixture(scope="module", params=["three joints", "long names"])
def html(request):
    return pages()[request.param]


def test_every_chart_has_something_drawn_inside_its_frame(html):
    svgs = re.findall(r"<svg (.*?)</svg>", html, re.DOTALL)
    assert len(svgs) == html.count('<div class="chart"')
    for svg in svgs:
        paths = re.findall(r'<path class="([^"]+)"[^>]* d="([^"]*)"', svg)
        curves = [path for kind, path in paths if kind not in ("zero", "untouched")]
        assert curves
        for path in curves:
            assert re.fullmatch(r"[-0-9.MLHVZh ]+", path), path[:80]
            points = re.findall(r"[ML]([-0-9.]+) ([-0-9.]+)", path)
            x, y = np.array(points, dtype=float).T
            assert (x >= -1).all()
            assert (x <= WIDTH + 1).all()
            assert (y >= -0.03 * HEIGHT).all()
            assert (y <= 1.03 * HEIGHT).all()


def test_a_table_is_stacked_or_scrolls_where_it_is_too_wide(html):
    tables = re.findall(r'(<div class="[^"]*">)\s*<table( class="[^"]*")?>', html)
    assert len(tables) == html.count("<table")
    assert all("scroll" in box for box, _ in tables)


def test_nothing_asks_for_more_room_than_a_phone_has():
    sheet = re.sub(r"@media print\{.*?\}\}", "", style(), flags=re.DOTALL)
    sheet = "".join(rule for rule in sheet.splitlines(True) if "dialog" not in rule)
    # Columns may shrink to nothing, or are no wider than the page.
    for least in re.findall(r"minmax\(([^,()]*(?:\([^)]*\))?[^,()]*),", sheet):
        assert least == "0" or least.startswith("min(100%,"), least
    widths = re.findall(r"[;{](?:min-)?width:(\d+)px", sheet)
    assert widths
    assert max(map(int, widths)) <= 200
    assert "@media screen and (max-width:760px)" in sheet


def test_the_marks_of_a_page_are_closed_and_its_places_are_different(html):
    page = parsed(html)
    assert page.open == []
    places = [value for name, value in page.attributes if name == "id"]
    assert len(set(places)) == len(places)


@pytest.mark.slow
@pytest.mark.parametrize("look", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1000, 1600])
def test_a_browser_draws_the_page_without_errors_or_overflow(
    html, width, look, tmp_path
):
    text = html.replace("<head>\n", FAILURES, 1).replace("</body>\n", PROBE, 1)
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.format(width=width), encoding="utf-8")
    run = browse(
        frame,
        f"--window-size={max(width, 500) + 50},900",
        f"--blink-settings=preferredColorScheme={int(look == 'light')}",
        "--virtual-time-budget=5000",
        "--dump-dom",
    )
    told = json.loads(re.search(r'<pre id="probe">(.*?)</pre>', run.stdout)[1])
    assert told["errors"] == []
    assert told["width"] == width
    assert told["wide"] == []
    assert told["named"] == 0, "cells with a name and nothing behind it"
    assert told["scroll"] <= told["width"]
    assert told["charts"] == html.count('<div class="chart"')
    assert told["empty"] == 0
    assert told["zoomed"] == html.count('class="numbers"')


def words(text):
    """Count the words of a text that no line is too short for."""
    return Counter(one for one in re.findall(r"\w+", text) if 4 <= len(one) <= 20)


# Points that a printed page leaves empty on each side.
MARGIN = 20


@pytest.mark.slow
def test_a_page_is_printed_whole(html, tmp_path):
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext (poppler) is not installed")
    path, printed = tmp_path / "report.html", tmp_path / "report.pdf"
    path.write_text(html, encoding="utf-8")
    browse(path, "--no-pdf-header-footer", f"--print-to-pdf={printed}")
    run = ["pdftotext", "-bbox", str(printed), "-"]
    told = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    pages = told.split("<page ")[1:]
    joints = html.count("determined by the recording")
    # Three pictures and two sheets of parameters a joint, about.
    assert 3 + joints // 2 <= len(pages) <= 8 + 3 * joints
    found = ""
    for page in pages:
        size = re.match(r'width="(.*?)" height="(.*?)"', page)
        width, height = map(float, size.groups())
        boxes = re.findall(r'xMin="(.*?)" yMin="(.*?)" xMax="(.*?)" yMax="(.*?)"', page)
        assert boxes, "an empty page"
        left, top, right, bottom = np.array(boxes, dtype=float).T
        # What a frame cuts off would reach into the margins of 29 points.
        assert min(left.min(), top.min()) >= MARGIN
        assert right.max() <= width - MARGIN
        assert bottom.max() <= height - MARGIN
        found += " " + " ".join(re.findall(r">([^<]*)</word>", page))
    # What is folded on a screen is there too: the parameters of every joint.
    cells = re.findall(r"<(?:h2|td)[^>]*>\s*([^<]+?)\s*</(?:h2|td)>", html)
    assert len(cells) > 20 * joints
    assert words(unescape(" ".join(cells))) - words(unescape(found)) == Counter()
