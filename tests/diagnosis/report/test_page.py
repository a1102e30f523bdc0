"""The page: pictures of effects, units, provenance, links; all escaped, and small."""

import base64
import importlib.metadata
import json
import re
from dataclasses import replace
from html import escape

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import (
    CommandsAlone,
    FrictionCurves,
    ParameterValue,
    Provenance,
    RecordedMotion,
    SpectrumCurves,
    TimeLine,
    TorqueCurves,
    cloud_size,
    curve_size,
    curves_over,
)
from sklearn_vbjfa.diagnosis.report import (
    WIDTH,
    about_effect,
    documentation_of,
    mathml,
    packed,
    ticks,
    torque_figures,
)
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.effects import Ripple, resolve
from tests.diagnosis.report._outcomes import make_outcome
from tests.diagnosis.report.test_report import parsed

HOSTILE = '</script><script>alert("x")</script>'
FILES = ("report.json", "parameters.csv", "identified.urdf")


def made(nv=3, names=None, n_effects=2, rows=3000, **changes):
    """Make an outcome with all that a page draws."""
    outcome = make_outcome(nv=nv, names=names, n_effects=n_effects)
    names = outcome.joint_names
    rng = np.random.default_rng(0)
    curves = []
    for effect in outcome.effects:
        x, noise = rng.standard_normal((2, rows))
        curves.append(
            curves_over(
                x,
                0.1 * noise,
                2.0 * x,
                np.ones(rows),
                joint=effect.joint,
                kind="load",
                signal="",
                unit="N m",
                with_motion=True,
                most=cloud_size(n_effects),
            )
        )
    seconds = np.linspace(0.0, 20.0, curve_size(nv))
    torques = tuple(
        TorqueCurves(
            joint=j,
            seconds=seconds,
            measured=np.sin(seconds),
            before=0.9 * np.sin(seconds),
            after=np.where(seconds < 10, np.sin(seconds), np.nan),
            counts=seconds > 1.0,
        )
        for j in range(nv)
    )
    speed = rng.standard_normal(rows)
    friction = tuple(
        FrictionCurves(
            joint=j,
            **{
                name: curves_over(
                    speed,
                    0.1 * rng.standard_normal(rows),
                    size * np.sign(speed) + speed,
                    np.ones(rows),
                    joint=j,
                    kind="speed",
                    signal="",
                    unit="rad/s",
                    with_motion=False,
                    most=400,
                )
                for name, size in (("before", 0.5), ("after", 1.0))
            },
        )
        for j in range(nv)
    )
    hertz = np.linspace(0.5, 40.0, 80)
    spectra = tuple(
        SpectrumCurves(
            joint=j, cutoff=10.0, hertz=hertz, before=1.0 / hertz, after=0.1 / hertz
        )
        for j in range(nv)
    )
    line = TimeLine(
        torques=torques, borders=(12.0,), untouched=((3.0, 5.0),), in_seconds=True
    )
    drawn = {"effects": tuple(curves), "line": line}
    drawn |= {"friction": friction, "spectra": spectra}
    values = {
        "effects": tuple(
            replace(e, effect=Ripple(joint=e.joint)) for e in outcome.effects
        ),
        "curves": outcome.curves | drawn,
        "parameters": tuple(
            ParameterValue(
                name=f"{name}:{symbol}",
                value=1.5,
                interval=(1.25, 1.75),
                unit="kg",
                nominal=nominal,
                known=known,
            )
            for name in names
            for symbol, nominal, known in (
                ("m", 1.25, "yes"),
                ("viscous", np.nan, "in combination"),
            )
        ),
        "recorded": RecordedMotion(samples=4000, seconds=20.0, rate=200.0),
        "recordings": ("slow", "fast"),
        "provenance": Provenance(
            file="logs/arm.csv",
            description="arm.urdf",
            held=("finger_left",),
            warnings=("Torque of joint 1 is coarse.", "Another warning."),
            files=FILES,
        ),
    }
    return replace(outcome, **(values | changes))


def alone(nv=3, **changes):
    """Make an outcome of a robot that was told positions, its last joint slides."""
    outcome = made(nv=nv, n_effects=0)
    before = np.linspace(0.02, 0.04, nv)
    found = CommandsAlone(
        before=before,
        plain=0.5 * before,
        after=0.1 * before,
        told=10 * before,
        units=(*(nv - 1) * ("rad",), "m"),
        seconds=12.34,
        n_stretches=3,
    )
    found = replace(found, **changes)
    line = replace(outcome.curves["line"], untouched=())
    curves = outcome.curves | {"positions": line}
    return replace(outcome, commands_alone=found, curves=curves)


def test_positions_from_commands_alone_have_a_table_and_pictures():
    outcome = alone()
    report = Report(outcome)
    said = (
        "From the commands of 12.3 s of held-out motion alone, positions of the "
        "declared model are off by 25.0 mrad and 40.0 mm, those of the completed one "
        "by 2.50 mrad and 4.00 mm (mean of the joints); a robot that is where it is "
        "told to be is off by 250 mrad and 400 mm."
    )
    text = report.to_markdown()
    assert said in " ".join(text.split())
    short = "positions are off by 25.0 mrad and 40.0 mm before, 2.50 mrad and 4.00 mm"
    assert f"{short} after." in " ".join(str(report).split())
    assert "| joint | unit | declared model | completed model | as told |" in text
    assert "| joint 1 | mrad | 20.0 | 2.00 | 200 |" in text
    assert "| joint 3 | mm | 40.0 | 4.00 | 400 |" in text
    html = report.to_html()
    own = [x for x in figures(html) if "held-out time, its stretches joined" in x]
    assert len(own) == outcome.error_after.size
    assert "position [rad]" in own[0]
    assert "error [mrad]" in own[0]
    assert "position [m]" in own[2]
    assert "error [mm]" in own[2]
    assert "next stretch" in html
    # Of an axis of positions zero is no part unless they are near.
    line = outcome.curves["positions"]
    high = [
        replace(x, measured=x.measured + 9, before=x.before + 9, after=x.after + 9)
        for x in line.torques
    ]
    curves = {"positions": replace(line, torques=tuple(high))}
    far = replace(outcome, curves=outcome.curves | curves)
    top = figures(Report(far).to_html())[0].partition("error [mrad]")[0]
    ticks = re.findall(r'style="top:[\d.]+%">(\S+?)</span>', top)
    assert "9" in ticks
    assert "0" not in ticks
    added = replace(outcome, added=("offset",))
    text = Report(added).to_markdown()
    assert "| joint 1 | mrad | 20.0 | 10.0 | 2.00 | 200 |" in text
    data = report.to_dict()["commands_alone"]
    assert data["before"] == pytest.approx([0.02, 0.03, 0.04])
    assert data["n_stretches"] == 3
    assert made().commands_alone is None
    assert "commands alone" not in Report(made()).to_html()


def test_a_model_that_is_not_simulated_to_its_end_is_told():
    """Its error is unknown, and of its curve nothing is drawn."""
    nothing = np.full(3, np.nan)
    why = {"before": "It diverges.", "plain": "It diverges too."}
    outcome = alone(before=nothing, plain=nothing, failed=why)
    line = outcome.curves["positions"]
    torques = [replace(x, before=np.full(x.seconds.size, np.nan)) for x in line.torques]
    curves = {"positions": replace(line, torques=tuple(torques))}
    report = Report(replace(outcome, curves=outcome.curves | curves))
    text = " ".join(report.to_markdown().split())
    assert "The declared model was not simulated to its end: It diverges." in text
    short = "positions are off by an unknown distance and an unknown distance before"
    assert short in " ".join(str(report).split())
    assert "It diverges too" not in text
    assert "Simulated without" not in text
    some = replace(outcome.commands_alone, left_out=("jerk on a (why)", "b"))
    text = " ".join(Report(replace(outcome, commands_alone=some)).to_markdown().split())
    assert "Simulated without jerk on a (why) and b." in text
    assert "declared model are off by an unknown distance" in text
    assert "joint 1 | mrad | ? | 2.00 | 200" in report.to_markdown()
    assert report.to_dict()["commands_alone"]["before"] == [None] * 3
    (own, *_) = figures(report.to_html())
    assert 'class="line-after"' in own
    assert 'class="line-before"' not in own


def figures(html):
    return re.findall(r'<figure class="wide"[^>]*>.*?</figure>', html, re.DOTALL)


def numbers(figure):
    text = re.search(r'class="numbers">(.*?)</script>', figure, re.DOTALL)[1]
    return json.loads(text)


def test_every_effect_and_every_torque_has_its_picture():
    outcome = made(nv=3, n_effects=3)
    shown = figures(Report(outcome).to_html())
    assert len(shown) == 3 + 3 * 3
    for effect, figure in zip(outcome.effects, shown):
        called = words.effect_at(outcome, effect.name, effect.joint, effect.parameters)
        assert words.capital(called) in figure
        assert figure.count("<svg") == 2
        for kind in ("cloud", "spread", "mean-before", "mean-after", "law"):
            assert f'<path class="{kind}" d="M' in figure
        assert "without the effect" in figure
        assert "What it is" in figure
    for figure in shown[3:6]:
        torque, residual = figure.split('<div class="chart"')[1:]
        for kind in ("line-before", "line-after", "untouched", "border", "zero"):
            for chart in (torque, residual):
                assert f'<path class="{kind}" d="M' in chart
        assert '<path class="measured" d="M' in torque
        assert '<path class="floor" d="M' in residual
    for figure in shown[6:9]:
        for kind in ("cloud", "law", "mean-after", "zero"):
            assert f'<path class="{kind}" d="M' in figure
    for figure in shown[9:]:
        for kind in ("line-before", "line-after", "untouched"):
            assert f'<path class="{kind}" d="M' in figure


def test_a_residual_is_below_its_torque_on_the_same_axis_of_time():
    figure = figures(Report(made()).to_html())[2]
    assert '<div class="stacked">' in figure
    torque, residual = figure.split('<div class="chart"')[1:]
    for part in ("x-axis", "x-name"):
        found = [
            re.search(rf'class="{part}">(.*?)</div>', chart, re.DOTALL)[1]
            for chart in (torque, residual)
        ]
        assert found[0] == found[1]
    # Nothing is drawn where the joint stands still: before 1 s of 20 s.
    path = re.search('class="line-before" d="M([0-9.]+) ', residual)[1]
    assert float(path) == pytest.approx(WIDTH / 20, abs=1)


def test_outliers_do_not_flatten_a_picture_and_are_told():
    outcome = made(nv=1, n_effects=0)
    line = outcome.curves["line"]
    (one,) = line.torques
    spikes = one.measured.copy()
    spikes[300:310] = 500.0
    curves = dict(outcome.curves)
    curves["line"] = replace(line, torques=(replace(one, measured=spikes),))
    (plain,), (spiked,) = (
        torque_figures(replace(outcome, curves=own))["figures"]
        for own in (outcome.curves, curves)
    )
    heights = [
        [float(text) for _, text in figure.charts[0].y_ticks]
        for figure in (plain, spiked)
    ]
    assert max(heights[1]) <= 2 * max(heights[0])
    assert plain.note == ""
    assert spiked.note.startswith("Cut off: values to 500.")


def test_a_spectrum_is_in_decades_and_shows_the_band():
    figure = figures(Report(made(nv=1, n_effects=0)).to_html())[-1]
    axis = re.search('class="y-axis">(.*?)</div>', figure, re.DOTALL)[1]
    found = [float(text) for text in re.findall(r">([^<>]+)</span>", axis)]
    assert found == [0.01, 0.1, 1.0]
    # The band ends at 10 of 40 Hz.
    path = re.search('class="untouched" d="M0.0 0H([0-9.]+)', figure)[1]
    assert float(path) == pytest.approx(WIDTH / 4)
    assert numbers(figure)["spans"] == [[0.0, 10.0]]


def test_the_contents_lead_to_every_section():
    html = Report(made()).to_html()
    nav = re.search("<nav>.*?</nav>", html, re.DOTALL)[0]
    links = re.findall('<a href="#([^"]+)">([^<]+)</a>', nav)
    assert links == re.findall('<h2 id="([^"]+)">([^<]+)</h2>', html)
    headings = [heading for _, heading in links]
    assert headings[:3] == [
        "Error of each joint on held-out data",
        "Effects that were missing",
        "What to do next",
    ]
    assert headings[-1] == "Method"
    # Pages in one notebook would have the same places.
    assert "<nav>" not in Report(made())._repr_html_()


@pytest.mark.parametrize("case", [{}, {"n_effects": 0}, {"unexplained": (1,)}])
def test_terms_are_explained_where_they_come_first(case):
    outcome = made(**case) if "unexplained" not in case else make_outcome(**case)
    html = Report(outcome).to_html().replace("\u00a0", " ")
    html = re.sub(r"<(style|script)\b.*?</\1>", "", html, flags=re.DOTALL)
    parts = re.split("(?=<h2)", html)
    for form, name, meaning in words.TERMS:
        first = next((part for part in parts if re.search(form, read(part))), None)
        told = [part for part in parts if f"<dt>{name}</dt>" in part]
        assert told == ([] if first is None else [first]), name
        assert first is None or escape(meaning) in first


def read(part):
    """Return what is read of a part of a page but for what terms mean."""
    part = re.sub(r"<(nav|dl)\b.*?</\1>", "", part, flags=re.DOTALL)
    what = r"<details><summary>What it is.*?</details>"
    part = re.sub(what, "", part, flags=re.DOTALL)
    labels = re.sub('aria-label="[^"]*"', "", part)
    return re.sub("<[^>]*>", "\n", labels).strip()


def test_the_table_of_errors_begins_with_the_largest_gain():
    outcome = make_outcome(nv=3, n_effects=0)
    before = outcome.error_after + np.array([0.01, 0.05, 0.0])
    report = Report(replace(outcome, error_before=before))
    names = re.findall('<tr class="joint"><td><b>(.*?)</b>', report.to_html())
    assert names == ["joint 2", "joint 1", "joint 3"]
    assert re.findall(r"^joint \d", str(report), re.MULTILINE) == names
    assert [one.joint for one in report.joints] == [0, 1, 2]


def test_names_of_joints_are_not_capitalised():
    names = ("shoulder_pan_joint", "elbow_joint", "wrist_axis")
    outcome = made(names=names, nv=3)
    worse = replace(outcome, error_after=np.full(3, 1.5), intervals={})
    for report in (Report(outcome), Report(worse)):
        for text in (str(report), report.to_html(), report.to_markdown()):
            for name in names:
                assert name in text.replace("\\", "")
                assert name.capitalize() not in text


def test_axes_have_names_units_and_numbers():
    outcome = made()
    for figure in figures(Report(outcome).to_html()):
        for chart in figure.split('<div class="chart"')[1:]:
            for name in ("y-name", "x-name"):
                label = re.search(rf'class="{name}">(?:<span>)?([^<]+)<', chart)[1]
                known = r"\[(N m|N|s|rad|rad/s|Hz|N m/√Hz)\]$"
                assert re.search(known, label.strip()), label
            for name in ("y-axis", "x-axis"):
                axis = re.search(rf'class="{name}">(.*?)</div>', chart, re.DOTALL)[1]
                ticks = re.findall(r">([^<>]+)</span>", axis)
                assert 2 <= len(ticks) <= 7
                assert np.all(np.diff([float(x) for x in ticks]) > 0)


def test_the_numbers_of_a_picture_are_those_that_were_drawn():
    outcome = made(nv=1, n_effects=1)
    effect, torque, *_ = map(numbers, figures(Report(outcome).to_html()))
    curves = outcome.curves["effects"][0]
    x = np.frombuffer(base64.b64decode(effect["x"]), "<f4")
    np.testing.assert_allclose(x, curves.x, rtol=1e-6)
    told = dict(zip((s["kind"] for s in effect["series"]), effect["series"]))
    assert set(told) == {
        "cloud before",
        "cloud after",
        "mean-before",
        "mean-after",
        "law",
    }
    for kind, values in (
        ("cloud before", curves.without),
        ("cloud after", curves.after),
    ):
        found = np.frombuffer(base64.b64decode(told[kind]["y"]), "<i2")
        size = np.abs(values).max()
        np.testing.assert_allclose(
            found * told[kind]["scale"], values, atol=2e-5 * size
        )
    assert torque["borders"] == [12.0]
    assert torque["spans"] == [[3.0, 5.0]]
    after = next(s for s in torque["series"] if s["kind"] == "line-after")
    whole = np.frombuffer(base64.b64decode(after["y"]), "<i2")
    np.testing.assert_array_equal(
        whole == -32768, np.isnan(outcome.curves["line"].torques[0].after)
    )


@pytest.mark.parametrize("values", [[0.0, 0.0], [np.nan], [], [1e-30, -1e-30], [1e30]])
def test_numbers_of_any_size_are_packed(values):
    found = packed(values)
    scale, found = (
        found["scale"],
        np.frombuffer(base64.b64decode(found["y"]), "<i2").astype(float),
    )
    found[found == -32768] = np.nan
    np.testing.assert_allclose(found * scale, values, rtol=1e-4)


@pytest.mark.parametrize("low", [-7.3, 0.0, 1e-6, 3e5, -1e-9])
@pytest.mark.parametrize("length", [1e-8, 0.37, 9.0, 1e6])
def test_ticks_are_round_and_inside(low, length):
    values = np.array([value for value, _ in ticks(low, low + length)])
    assert 1 <= values.size <= 6
    slack = 1e-6 * length
    assert low - slack <= values[0]
    assert values[-1] <= low + length + slack


def test_the_page_says_where_it_comes_from():
    html = Report(made()).to_html()
    text = html[html.index("Provenance</h2>") :]
    for said in (
        "logs/arm.csv",
        "4000 samples, 20 s, 2 recordings (slow and fast)",
        "200 Hz",
        "arm.urdf",
        "finger_left",
        "Torque of joint 1 is coarse.",
        "Another warning.",
    ):
        assert said in text
    for name in FILES:
        assert html.count(f'<a href="{name}">{name}</a>') == 2


def test_all_files_are_named():
    outcome = made()
    files = ("logs/slow.csv", "logs/<fast>.csv")
    report = Report(
        replace(outcome, provenance=replace(outcome.provenance, file=files))
    )
    assert report.to_dict()["provenance"]["file"] == list(files)
    html = report.to_html()
    text = html[html.index("Provenance</h2>") :]
    for told in ("Recordings", "logs/slow.csv", "logs/&lt;fast&gt;.csv"):
        assert told in text
    assert "- Recordings: logs/slow.csv, logs/\\<fast\\>.csv" in report.to_markdown()


def test_provenance_is_in_the_dict_and_not_on_the_terminal():
    report = Report(made())
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert data["provenance"]["file"] == "logs/arm.csv"
    expected = {"samples": 4000, "seconds": 20.0, "rate": 200.0, "looked_at": 0}
    assert data["recorded"] == expected
    assert data["parameters"][0]["name"] == "joint1:m"
    assert data["parameters"][1]["nominal"] is None
    bare = made(provenance=None, parameters=(), recorded=None)
    assert str(report) == str(Report(bare))


def test_parameters_stand_beside_those_of_the_description():
    html = Report(made(nv=1)).to_html()
    text = html[html.index("Identified parameters</h2>") :]
    rows = re.findall(r"<tr>(<td>.*?)</tr>", text)
    cells = [re.findall("<td>(.*?)</td>", row) for row in rows][:2]
    assert cells[0] == ["m", "1.5 ± 0.2", "1.25", "kg", "yes", ""]
    # one of many values has no interval of its own
    assert cells[1] == ["viscous", "1.5", "", "kg", "only with others", ""]
    assert "1 of 2 determined by the recording" in text


def test_a_parameter_belongs_to_the_joint_of_the_longest_name():
    one = made(nv=1).parameters[0]
    names = ("a:m", "a:b:m", "a:b:mc", "base_tilt:roll")
    own = tuple(replace(one, name=name) for name in names)
    html = Report(made(nv=2, names=("a", "a:b"), parameters=own)).to_html()
    text = html[html.index("Identified parameters</h2>") :]
    groups = re.findall(r"<b>(.*?)</b>.*?</details>", text, re.DOTALL)
    rows = [part.count("<tr><td>") for part in text.split("<details")[1:4]]
    assert groups[:3] == ["joint 1 (a)", "joint 2 (a:b)", "robot"]
    assert rows == [1, 2, 1]


@pytest.mark.parametrize("report", ["to_html", "_repr_html_"])
def test_whatever_a_name_is_it_is_text(report):
    names = (HOSTILE, "'\"><img src=x onerror=alert(1)>")
    outcome = made(
        nv=2,
        names=names,
        provenance=Provenance(
            file=HOSTILE,
            description=HOSTILE,
            held=(HOSTILE,),
            warnings=(HOSTILE,),
            files=('x" onclick="alert(1).csv', "javascript:alert(1)"),
        ),
        recordings=(HOSTILE, HOSTILE),
    )
    html = getattr(Report(outcome), report)()
    assert "<script>alert" not in html
    assert "<img" not in html
    page = parsed(html)
    assert page.open == []
    names = {name for name, _ in page.attributes}
    assert not {"onclick", "onerror", "src"} & names
    links = [value for name, value in page.attributes if name == "href"]
    assert not any(link.startswith("javascript:") for link in links)


def test_the_page_works_without_a_network():
    html = Report(made()).to_html()
    page = parsed(html)
    assert page.open == []
    names = {name for name, _ in page.attributes}
    assert not {"src", "srcset"} & names
    assert "@import" not in html
    assert "url(" not in html
    # the comment of the library says where it is from; MathML has a name space
    assert len(re.findall(r"https?://(?!www\.w3\.org/1998/Math)", html)) == 1
    # its licence goes with it
    assert "Permission is hereby granted" in html


def test_a_page_without_figures_needs_no_library():
    html = Report(make_outcome()).to_html()
    assert "<script" not in html
    assert "uPlot" not in html


def test_a_notebook_gets_the_pictures_and_no_scripts():
    html = Report(made())._repr_html_()
    assert len(figures(html)) == 2 + 3 * 3
    assert "<script" not in html


def test_pictures_are_there_without_the_library_and_without_matplotlib(monkeypatch):
    """What moves them is added by a script; they are drawn without one."""
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    outcome = made()
    html = Report(outcome).to_html()
    still = re.sub("<script.*?</script>", "", html, flags=re.DOTALL)
    assert still.count("<svg") == 2 * 2 + 3 * 4
    assert "<button" not in still


@pytest.mark.parametrize(("nv", "n_effects"), [(6, 6), (30, 40)])
def test_a_page_stays_small(nv, n_effects):
    html = Report(made(nv=nv, n_effects=n_effects)).to_html()
    assert len(html.encode("utf-8")) < 3_000_000
    bare = Report(made(nv=nv, n_effects=n_effects))._repr_html_()
    assert len(html) - len(bare) < 1_500_000


def test_one_bad_joint_does_not_flatten_the_bars():
    outcome = make_outcome(nv=6, n_effects=0)
    after = np.full(6, 0.02)
    bad = after.copy()
    bad[4] = 3.0
    one = replace(outcome, error_before=bad, error_after=bad, floor=after, intervals={})
    html = Report(one).to_html()
    # the scale ends at eight times the error of the middle joint
    assert html.count('fill after" style="width:12.5%"') == 5
    assert html.count('fill before cut"') == 1
    assert "jagged" in html
    # alike errors fill the scale
    alike = replace(one, error_before=after, error_after=after)
    html = Report(alike).to_html()
    assert html.count('fill after" style="width:100.0%"') == 6
    assert "jagged" not in html


@pytest.mark.parametrize("given", [[], ["Homepage, https://h.org"]])
def test_no_documentation_no_link(given, monkeypatch):
    class Metadata:
        def get_all(self, key, default):
            return given

    metadata = importlib.metadata
    monkeypatch.setattr(metadata, "metadata", lambda name: Metadata())
    assert documentation_of("ripple") == ""


def test_effects_link_to_their_documentation(monkeypatch):
    class Metadata:
        def get_all(self, key, default):
            return ["Documentation, https://docs.example.org/"]

    metadata = importlib.metadata
    monkeypatch.setattr(metadata, "metadata", lambda name: Metadata())
    address = "https://docs.example.org/effects/ripple.html"
    assert documentation_of("ripple") == address
    assert documentation_of("my_own_effect") == ""
    assert f'<a href="{address}">' in Report(made(n_effects=3)).to_html()


def test_what_a_class_says_is_shown_without_markup():
    for effect in resolve("all"):
        about = about_effect(effect)
        assert len(about.paragraphs) >= 2
        assert not any("`" in text or "]_" in text for text in about.paragraphs)
        assert not any("Parameters" in text for text in about.paragraphs)
        # What a text cites stands below it.
        assert about.paragraphs[-1].startswith("[1] ")


def test_a_figure_explains_its_effect_without_a_network():
    html = Report(made()).to_html()
    for figure in figures(html)[:2]:
        details = re.search("<details>.*</details>", figure, re.DOTALL)[0]
        assert mathml(r"\Delta\tau = " + Ripple.formula) in details
        assert "Cogging of motors" in details
        assert "Tuttle" in details
        assert "href" not in details


def test_an_effect_without_a_picture_is_explained_all_the_same():
    outcome = made()
    _, second = outcome.curves["effects"]
    curves = outcome.curves | {"effects": (None, second)}
    html = Report(replace(outcome, curves=curves)).to_html()
    shown = figures(html)
    assert len(shown) == 2 + 3 * 3
    assert "Too few rows for a picture." in shown[0]
    assert "Cogging of motors" in shown[0]
    assert "<svg" not in shown[0]
    assert 'class="numbers"' not in shown[0]
    assert parsed(html).open == []


def test_the_table_leads_to_what_each_effect_is():
    outcome = made(nv=3, n_effects=3)
    html = Report(outcome).to_html()
    page = parsed(html)
    links = [v for name, v in page.attributes if name == "href"]
    links = [link for link in links if link.startswith("#effect-")]
    places = [value for name, value in page.attributes if name == "id"]
    assert links == [f"#{place}" for place in places if place.startswith("effect-")]
    assert len(links) == 3
    for effect, figure in zip(outcome.effects, figures(html)):
        label = words.effect_label(outcome, effect.name, effect.parameters)
        anchor = re.search('id="([^"]+)"', figure)[1]
        assert f'<a href="#{anchor}">{label}</a>' in html
    # Nothing to lead to, and pages in one notebook whose places would be the same.
    for other in (
        Report(make_outcome(nv=3, n_effects=3)).to_html(),
        Report(outcome)._repr_html_(),
    ):
        assert "#effect-" not in other
        assert 'id="effect-' not in other
