"""Rendering of the page in a browser, if one is installed."""

import json
import re
import shutil
import subprocess

import pytest

from sklearn_vbjfa.diagnosis import Report
from tests.diagnosis.report._pages import made

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
# Script that reports script errors, elements beyond the window and empty charts.
PROBE = """
<script>
window.addEventListener("load", async function () {
  var told = {errors: window.failures, width: innerWidth, wide: [], empty: 0, named: 0,
              charts: document.querySelectorAll(".chart svg").length};
  document.querySelectorAll("main *").forEach(function (one) {
    var scrolls = one.closest(".scroll, .formula"), box = one.getBoundingClientRect();
    if (box.right > innerWidth + 1 && (!scrolls || scrolls === one)) {
      told.wide.push(one.tagName + "." + one.getAttribute("class"));
    }
  });
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
  parent.postMessage(JSON.stringify(told), "*");
});
</script>
</body>
"""
# Windows are at least 500 px wide, so that narrower pages need a frame. The result is
# sent as a message, since local files cannot access each other.
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
FAILURES = """<head><script>
window.failures = [];
window.addEventListener("error", function (e) { window.failures.push(e.message); });
</script>
"""


def browse(path, *options):
    """Return a page as a headless browser renders it; skip if none is installed."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"none of {', '.join(BROWSERS)} is installed")
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu"]
    flags.append(f"--user-data-dir={path.parent / 'profile'}")
    command = [browser, *flags, *options, path.as_uri()]
    return subprocess.check_output(command, text=True, timeout=300)


@pytest.fixture(scope="module", params=[3, 7], ids=["three joints", "long names"])
def html(request):
    n, names = request.param, None
    if n == 7:
        names = tuple(f"left_arm_shoulder_{'pitch' * 6}_joint_{j}" for j in range(n))
    return Report(made(nv=n, n_effects=n, names=names)).to_html()


@pytest.mark.slow
@pytest.mark.parametrize("look", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1000, 1600])
def test_page_renders_without_errors_or_overflow(html, width, look, tmp_path):
    text = html.replace("<head>\n", FAILURES, 1).replace("</body>\n", PROBE, 1)
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.format(width=width), encoding="utf-8")
    page = browse(
        frame,
        f"--window-size={max(width, 500) + 50},900",
        f"--blink-settings=preferredColorScheme={int(look == 'light')}",
        "--virtual-time-budget=5000",
        "--dump-dom",
    )
    probe = json.loads(re.search(r'<pre id="probe">(.*?)</pre>', page)[1])
    assert probe["errors"] == probe["wide"] == []
    assert probe["width"] == width
    assert probe["named"] == 0, "cells with a name and nothing behind it"
    assert probe["scroll"] <= probe["width"]
    assert probe["charts"] == html.count('<div class="chart"')
    assert probe["empty"] == 0
