"""The guide, the README and the code say the same, and their examples run."""

import ast
import importlib.metadata
import importlib.util
import inspect
import math
import os
import re
import subprocess
import sys
import textwrap
from collections import Counter
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa import (
    datasets,
    design,
    diagnosis,
    distributed,
    effects,
    inspection,
    physical,
    robot,
    simulation,
)
from tests.test_imports import APART, ROOMS

PUBLIC_MODULES = (
    sklearn_vbjfa,
    datasets,
    design,
    diagnosis,
    distributed,
    effects,
    inspection,
    physical,
    robot,
    simulation,
)
ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
SETUP = [
    'pip install ".[robot]" && python -m sklearn_vbjfa',
    'pip install ".[test]" && pytest',
]


def read(path):
    return path.read_text(encoding="utf-8")


def tagged_equations(text):
    """Numbers of the paper's equations in tags such as [eq. 12] or [eqs. 17-25]."""
    numbers = set()
    for tag in re.findall(r"\[eqs?\. ([^\]]+)\]", text):
        for first, last in re.findall(r"(\d+)(?:-(\d+))?", tag.split(", line")[0]):
            numbers.update(range(int(first), int(last or first) + 1))
    return numbers


def own_tags(text):
    """Numbers of the guide's own equations, such as [C3] in the code, in order."""
    return re.findall(r"\[([BC]\d+)\]", text)


def code_blocks(path):
    """Python examples of a page, in order, with the line at which each begins."""
    text = read(path)
    if path.suffix == ".md":
        pattern = r"^```python\n(.*?)^```"
    else:
        # A block inside a list is indented with the list.
        pattern = r"^ *\.\. code-block:: python\n\n((?:    .*\n|\n)+)"
    blocks = []
    for match in re.finditer(
        pattern, text, flags=re.DOTALL * (path.suffix == ".md") | re.M
    ):
        line = text[: match.start(1)].count("\n")
        blocks.append("\n" * line + textwrap.dedent(match.group(1)))
    return blocks


PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.rst"))]
EXAMPLES = [page for page in PAGES if code_blocks(page)]


def test_tags_are_read():
    text = "a # [eq. 4]\nb # [eqs. 8, 9] [eqs. 17-19]\nc # [eq. 30, line 11]"
    assert tagged_equations(text) == {4, 8, 9, 17, 18, 19, 30}


@pytest.mark.parametrize(
    ("folder", "pages"),
    [("_core", ["model.rst"]), ("", ["model.rst", "robots.rst"])],
)
def test_every_equation_tag_is_in_the_guide(folder, pages):
    source = ROOT / "sklearn_vbjfa" / folder
    used = tagged_equations("\n".join(read(path) for path in source.rglob("*.py")))
    explained = tagged_equations("\n".join(read(DOCS / page) for page in pages))
    assert used, "no tags found"
    assert used <= explained, f"not in the guide: {sorted(used - explained)}"
    here = explained - tagged_equations(read(DOCS / "robots.rst"))
    assert here <= used, f"not in the code: {sorted(here - used)}"


def test_own_equations_are_in_the_guide_and_in_the_code():
    guide = read(DOCS / "model.rst")
    printed = re.findall(r"\\tag\{(\w+)\}", guide)
    for letter in "BC":
        numbers = [int(tag[1:]) for tag in printed if tag[0] == letter]
        assert numbers == list(range(1, len(numbers) + 1)), letter
        assert numbers, f"no equation {letter}1"
    source = ROOT / "sklearn_vbjfa"
    used = {tag for path in source.rglob("*.py") for tag in own_tags(read(path))}
    assert used == set(printed)
    assert set(own_tags(guide)) <= set(printed)


def test_own_tags_are_read():
    assert own_tags("q = s2 + 1  # [C5]\nx[B] + c[C2]  # [B1], [C12]") == [
        "C5",
        "C2",
        "B1",
        "C12",
    ]


def test_every_public_name_is_in_api_once():
    modules = PUBLIC_MODULES
    public = {name for module in modules for name in module.__all__}
    blocks = re.findall(
        r"\.\. autosummary::\n(?:    :.*\n)*\n((?:    \S+\n)+)", read(DOCS / "api.rst")
    )
    listed = Counter(name for block in blocks for name in block.split())
    assert {name for name, count in listed.items() if count > 1} == set()
    assert set(listed) == public


def test_names_in_api_are_where_it_says():
    modules = PUBLIC_MODULES
    module = None
    for line in read(DOCS / "api.rst").splitlines():
        if line.startswith(".. currentmodule:: "):
            name = line.removeprefix(".. currentmodule:: ")
            module = {m.__name__: m for m in modules}[name]
        elif re.fullmatch(r"    \w+", line):
            assert line.strip() in module.__all__


def constants_of_the_loop():
    """Phrases of the guide with the numbers that the code has."""
    from sklearn_vbjfa.diagnosis.explain import _gaps, _judgement, _split
    from sklearn_vbjfa.diagnosis.explain import _intervals as intervals
    from sklearn_vbjfa.diagnosis.search import (
        _blocks,
        _cosines,
        _held_out,
        _path,
        _problem,
        _refine,
    )
    from sklearn_vbjfa.effects import FAST
    from sklearn_vbjfa.robot import _joint_moments

    own = sklearn_vbjfa.diagnosis.SearchSettings()
    defaults = inspect.signature(sklearn_vbjfa.EffectDiscovery).parameters
    alpha = defaults["alpha"].default
    few, many = _blocks._WANTED
    varies, any_case = _gaps.ABOVE_FLOOR
    small = {2: "two", 3: "three", 4: "four", 10: "ten"}
    share = {2: "half an", 4: "quarter"}
    return [
        f"{100 * defaults['test_size'].default:g} % of the motion (``test_size``)",
        f"or {small[_split._STRETCHES]} stretches of a single one",
        f"an error takes {small[int(_split.FEWEST_VALUES)]} values that are",
        f"reaches {small[int(_judgement._WIDER)]} times as far (at least to "
        f"{_judgement._CONTROL:g} Hz)",
        f"{math.log((1 - alpha) / alpha):.2f} is a probability of "
        f"{100 * (1 - alpha):g} %",
        f"m are expected to be there ({own.expected:g} by default)",
        rf"\qquad s_0 = {own.scale:g},",
        f"in bands of {share[_cosines._PER_OCTAVE]} octave",
        f"up to {own.most} a joint",
        f"the slowest {share[_problem._SLOW]} of its cosines",
        f"the {_problem._SLOWEST} slowest changes alone",
        f"goes on, up to {small[_path._TURNS]} times",
        f"made anew, {small[_path._TURNS]} times over",
        f"{_held_out._FOLDS} stretches, one after the other, are predicted",
        f"With {_held_out._RECORDINGS} or more recordings, whole recordings are left",
        f"the other way round saves more than {100 * _path._MIRROR:g} % of what",
        f"stays zero unless it gains {_refine._NEUTRAL:g} nats",
        f"larger than with both by more than {100 * own.worth:g} %, what it contains",
        f"more than {own.chance:g} standard errors, and by at least "
        f"{100 * own.worth:g} %",
        f"value of the geometry is at least {own.known:g} deviations away",
        f"above {own.above_motion:g} times the frequency below which "
        f"{100 * _path._MOTION:g} % of the power",
        f"within {own.rivals:g} nats (a factor of {math.exp(own.rivals):.0f})",
        f"fewer than {_blocks.FEWEST} times that",
        f"{_blocks._CORRELATION_TIMES:g} times as long as the residual of the declared",
        f"{few} to {many} blocks are aimed at, and {_blocks.FEWEST} are the fewest",
        f"above {varies:g} times the floor if it varies with any, above {any_case:g} t",
        f"({100 * FAST:g} % of its speeds are slower)",
        f"hold the true value in {200 * intervals._UPPER_END - 100:g} % of cases",
        f"its residuals between {_joint_moments._BLOCKS} blocks of time",
        f"holds the error over the next {intervals.NEXT_SECONDS:g} s",
        f"the {intervals._COSINES} slowest cosines of time",
    ]


def test_table_of_rooms_is_that_of_the_imports():
    rows = re.findall(
        r"    \* - ``(\w+)``\n      - .+(?:\n {8}.+)*\n      - (.+)\n",
        read(DOCS / "architecture.rst"),
    )
    assert tuple(room for room, _ in rows) == ROOMS
    for room, imports in rows:
        above = set(ROOMS[: ROOMS.index(room)])
        told = above if imports == "all above" else set(re.findall(r"\w+", imports))
        assert told - {"none"} == APART.get(room, above), room


def test_numbers_of_the_loop_are_those_of_the_code():
    text = " ".join(read(DOCS / "effects.rst").split())
    for phrase in constants_of_the_loop():
        assert phrase in text, phrase


def test_shapes_in_the_guide_are_those_that_are_tried():
    from sklearn_vbjfa.effects import (
        _channels,
        _friction,
        _hysteresis,
        _position,
        _varying,
    )

    degrees = [
        round(math.degrees(x), 9) for x in (_position._SHORTEST, _position._LONGEST)
    ]
    tried = {
        "smoothing": _friction._SMOOTHINGS,
        "vs": _friction._STRIBECK,
        "displacement": _hysteresis._DISPLACEMENTS,
        "period": degrees,
        "ratio": _position._RATIOS,
        "angle": [_position._ANGLES[1]],
        "delay": _channels._DELAYS,
        "time_constant": _channels._CONSTANTS,
        "T": _varying._CONSTANTS,
        "payload": [_varying._INSTANTS],
    }
    text = read(DOCS / "effects.rst")
    table = text[text.index("* - shape parameter") : text.index("Numbers on this page")]
    rows = re.findall(r"\* - ([^*]+?)\n {6}- ([^\n]+)\n", table)
    rows = dict(rows[1:])
    for name, values in tried.items():
        (own,) = [row for what, row in rows.items() if f"``{name}``" in what]
        assert [float(x) for x in re.split(", | to ", own)] == list(values), name
    assert len(rows) == len(tried)


def test_setup_is_two_commands():
    commands = re.search(r"```bash\n(.*?)```", read(ROOT / "README.md"), re.DOTALL)
    assert commands.group(1).splitlines() == SETUP


def test_the_readme_is_short_and_says_what_it_is_first():
    lines = read(ROOT / "README.md").splitlines()
    assert len(lines) < 150
    first = "\n".join(lines[:15])
    for words in (
        "Python 3.11 or later",
        "BSD 3-Clause",
        "demo-report.html",
        "Version",
    ):
        assert words in first


def test_ci_runs_the_test_command_of_the_readme():
    # Each is a stage, whose seconds are printed.
    text = read(ROOT / ".ci" / "run")
    lines = re.sub(r'^stage "[^"]*" ', "", text, flags=re.M).splitlines()
    install, command = SETUP[1].split(" && ")
    assert command in lines
    assert install.replace("install", "install -q") in lines


def test_every_dependency_is_explained():
    text = read(DOCS / "dependencies.rst")
    for requirement in importlib.metadata.requires("sklearn-vbjfa"):
        # Builders may write one name with any of the three.
        name = re.sub(r"[._-]+", "[._-]", re.match(r"[\w.-]+", requirement).group())
        assert re.search(rf"^(\w+ +)?{name} ", text, flags=re.M), name


def test_errata_name_existing_tests():
    named = set(re.findall(r"``(test_\w+)``", read(DOCS / "errata.rst")))
    tests = "\n".join(read(path) for path in (ROOT / "tests").rglob("test_*.py"))
    assert named
    assert named <= set(re.findall(r"^def (test_\w+)", tests, flags=re.M))


def test_files_named_in_the_guide_exist():
    pattern = r"``?((?:docs|tests|examples|sklearn_vbjfa)/[\w/.]+\.\w+)``?"
    for page in PAGES:
        for name in re.findall(pattern, read(page)):
            assert (ROOT / name).is_file(), f"{page.name} names {name}"


def test_included_tables_exist():
    text = read(DOCS / "benchmarks.rst")
    for name in re.findall(r"\.\. include:: (\S+)", text):
        assert (DOCS / name).is_file()


def test_links_of_the_readme_lead_to_files():
    links = re.findall(r"\]\(([^)]+)\)", read(ROOT / "README.md"))
    local = [link for link in links if not link.startswith("https://")]
    assert "docs/images/residual.png" in local
    for link in local:
        assert (ROOT / link).is_file(), link


def script(path, patch):
    """Import a script of the documentation for as long as `patch` holds."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    # Data classes look their module up.
    patch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def recorded():
    with pytest.MonkeyPatch.context() as patch:
        yield script(DOCS / "_ext" / "recorded.py", patch)


WRITTEN = """Of two robots.

=======  ===========
robot      error [%]
=======  ===========
one              1.5
two, b
=======  ===========

Pooled: 1.5 %.
"""


def test_recorded_tables_are_read(recorded):
    (table,) = recorded.tables_in(WRITTEN)
    assert table.headers == ("robot", "error [%]")
    assert table.rows == (("one", "1.5"), ("two, b", ""))
    assert table.column("robot") == ("one", "two, b")
    assert table.chosen(["error [%]"], ["one"]).rows == (("1.5",),)
    assert recorded.paragraph_in(WRITTEN, "Pooled") == "Pooled: 1.5 %."


def test_what_is_not_recorded_is_refused(recorded):
    (table,) = recorded.tables_in(WRITTEN)
    with pytest.raises(KeyError, match="no column 'seconds', there are robot, error"):
        table.column("seconds")
    with pytest.raises(KeyError, match=r"no rows \['three'\], there are one, two, b"):
        table.chosen(rows=["three"])
    with pytest.raises(ValueError, match="0 paragraphs begin with 'Mean'"):
        recorded.paragraph_in(WRITTEN, "Mean")
    with pytest.raises(ValueError, match="three lines of equals signs"):
        recorded.tables_in("==  ==\na   b\n==  ==\n")


def test_every_recorded_table_can_be_read(recorded):
    for path in sorted((DOCS / "tables").glob("*.rst")):
        assert recorded.tables_in(read(path)), path.name


def test_evidence_shows_what_was_recorded(recorded):
    text = read(DOCS / "evidence.rst")
    shown = re.findall(r"\.\. recorded-table:: (\w+)\n((?:    :.*\n)*)", text)
    assert len(shown) >= 6
    for name, options in shown:
        given = dict(re.findall(r":(\w+): (.*)", options))
        parts = {
            key: given[key].split(" | ") for key in ("columns", "rows") if key in given
        }
        table = recorded.tables_in(recorded.read(name))[0]
        assert table.chosen(**parts).rows, name
    for name, words in re.findall(
        r"\.\. recorded-line:: (\w+)\n    :begins: (.*)", text
    ):
        assert recorded.paragraph_in(recorded.read(name), words)


def test_growth_is_drawn_from_its_table(recorded, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(sys, "path", list(sys.path))
    growth = script(DOCS / "images" / "growth.py", monkeypatch)
    found = growth.figures_of(recorded.read("growth"))
    axes = growth.draw(found).axes
    (table, _, _) = recorded.tables_in(recorded.read("growth"))
    (row,) = (row for row in table.rows if row[0] == "Ridge")
    heights = [float(re.search(r"([\d.]+) s", cell)[1]) for cell in row[1:]]
    drawn = [list(line.get_ydata()) for line in axes[0].lines]
    assert heights in drawn
    assert [len(axis.lines) for axis in axes] == [len(p.lines) for p in growth.PANELS]
    assert found["joints"]["RobotIdentifier"].keys() == {1, 6, 12, 25}  # 50 was not run


def test_growth_of_long_recordings_is_drawn_from_its_table(recorded, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(sys, "path", list(sys.path))
    drawing = script(DOCS / "images" / "long_recordings.py", monkeypatch)
    text = recorded.read("long_recordings")
    minutes, _ = drawing.draw(drawing.figures_of(text), drawing.with_powers(text)).axes
    (table,) = recorded.tables_in(text)
    lengths = [row for row in table.rows if row[0].endswith(" min")]
    seconds, gigabytes = (list(line.get_ydata()) for line in minutes.lines)
    place = table.headers.index("time [s]")
    assert seconds == [float(row[place]) for row in lengths]
    place = table.headers.index("memory [GB]")
    assert gigabytes == [float(row[place]) for row in lengths]
    said = recorded.paragraph_in(text, "With the length").rstrip(".")
    powers = re.findall(r"to the power of ([\d.]+)", said)
    labels = [words.get_text() for words in minutes.texts]
    assert [re.search(r"\{(.*)\}", label)[1] for label in labels] == powers


@pytest.mark.slow
def test_picture_of_the_residual_is_of_what_was_found(monkeypatch):
    pytest.importorskip("pinocchio")
    pytest.importorskip("matplotlib")
    residual = script(DOCS / "images" / "residual.py", monkeypatch)
    recording = datasets.load_demo_recording()
    loop = residual.identify(recording, recording.groups == 0)
    before, after = residual.draw(recording, loop, recording.groups == 1).axes
    left = [axis.lines[0].get_ydata().std() for axis in (before, after)]
    assert left[1] < 0.25 * left[0]
    # The law follows the points: its kink lies at no load.
    line = before.lines[-1]
    assert line.get_xdata()[1] == 0.0
    size = recording.undeclared["load_friction"][1]
    slope = (line.get_ydata()[2] - line.get_ydata()[1]) / line.get_xdata()[2]
    assert slope == pytest.approx(size, rel=0.1)


# What is said here in another way, or is no package anywhere.
NOT_SAID = re.compile(
    r"\buntouched (part|data|row)|that (is|was) untouched|other people's|"
    r"were set apart|no effect of the library explains|varies with no |"
    r"Errors are taken up to|A controller meets|physically possible cost|"
    r"[Nn]o motion can show|does the same, whatever|stands? for both|belongs? into|"
    r"It decides, from|estimators that know it|"
    # "There is no" is English, "it is no file" is not.
    r"(?<![Tt]here )\b(is|are) no (whole|UTF-8|JSON|text|table|number|bag|folder|part|"
    r"date|known|channel|function|linear|property|condition|mass|multiple)s?\b",
)
NO_NAME = re.compile(r"has (a|no) name")  # of columns it is said


def not_said(text):
    """Return the words of a text that are said in another way here, None without."""
    return NOT_SAID.search(" ".join(text.split()))


@pytest.mark.parametrize(
    "page",
    [
        *PAGES,
        ROOT / "CONTRIBUTING.md",
        ROOT / "CHANGELOG.md",
        *sorted((DOCS / "effects").glob("*.rst")),
        *sorted((DOCS / "tables").glob("*.rst")),
        *sorted((ROOT / "examples").rglob("*.py")),
        *sorted((ROOT / "sklearn_vbjfa").rglob("*.j2")),
    ],
    ids=lambda page: page.name,
)
def test_pages_use_one_word_for_one_thing(page):
    # What is printed is quoted as it is.
    text = re.sub(r"^```text\n.*?^```", "", read(page), flags=re.DOTALL | re.M)
    assert not not_said(text)
    assert not NO_NAME.search(" ".join(text.split()))


def literals(source):
    """Texts of a module with the lines that they are on, values in them as braces."""
    tree = ast.parse(source)
    inner = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            inner.update(map(id, node.values))
            parts = (
                x.value if isinstance(x, ast.Constant) else "{}" for x in node.values
            )
            yield node.lineno, "".join(parts)
    for node in ast.walk(tree):
        own = isinstance(node, ast.Constant) and id(node) not in inner
        if own and isinstance(node.value, str):
            yield node.lineno, node.value


def test_texts_of_a_module_are_read():
    found = dict(
        literals('a = f"x is no "\\\n  f"{b} file"\nc = ("is no"\n " whole x")')
    )
    assert found == {1: "x is no {} file", 3: "is no whole x"}
    assert not_said(found[3])[0] == "is no whole"
    assert not_said("There is no table") is None


def test_messages_use_one_word_for_one_thing():
    found = [
        f"{path.relative_to(ROOT)}:{line}: {not_said(text)[0]}"
        for path in sorted((ROOT / "sklearn_vbjfa").rglob("*.py"))
        for line, text in literals(read(path))
        if not_said(text)
    ]
    assert not found


@pytest.mark.slow
def test_report_to_click_is_what_the_package_writes(monkeypatch):
    pytest.importorskip("pinocchio")
    demo = script(DOCS / "demo_report.py", monkeypatch)
    # Words, not figures: other libraries and processors move a last digit.
    shown, made = (
        re.findall(r">([^<>\d]*[a-z][^<>\d]*)<", text)
        for text in (read(demo.PAGE), demo.page())
    )
    assert shown == made


def test_first_numbers_of_the_readme_and_the_first_page_are_measured(recorded):
    (models, *_) = recorded.tables_in(recorded.read("protocol_emps"))
    judged = {
        tuple(row[:2]): row[-1] for row in models.rows
    }  # model and states -> error
    published = judged["published, least squares", "theirs"]
    completed = judged["EffectDiscovery, completed model", "positions"]
    ratios = []
    for stage in ("development", "confirmation"):
        (table, *_) = recorded.tables_in(recorded.read(f"measured_sets_{stage}"))
        rows = table.chosen(["set", "four terms", "completed"]).rows
        ratios += [
            float(completed) / float(plain)
            for name, plain, completed in rows
            if name != "mean"
        ]
    assert len(ratios) == 10
    assert sum(ratio < 0.9 for ratio in ratios) == 7
    *_, one, two, three = sorted(ratios)
    assert round(100 * (1 - one)) == 6
    assert min(two, three) > 0.99
    for page in (ROOT / "README.md", DOCS / "index.rst"):
        text = " ".join(read(page).split())
        assert f"{published} %" in text
        assert f"{completed} %" in text
        said = "more than a tenth on seven, by 6 % on one and by less than 1 % on two"
        assert said in text


def test_first_page_shows_the_commands_of_the_readme():
    text = read(DOCS / "index.rst")
    block = re.search(r"\.\. code-block:: bash\n\n((?:    .*\n)+)", text)[1]
    assert textwrap.dedent(block).splitlines() == SETUP[0].split(" && ")
    assert "literalinclude:: ../README.md" in text
    assert read(ROOT / "README.md").count("```text") == 1


def test_every_page_is_in_one_menu():
    listed = Counter()
    for page in DOCS.rglob("*.rst"):
        for block in re.findall(
            r"\.\. toctree::\n(?:    :.*\n)*\n((?:    .*\n)+)", read(page)
        ):
            names = (
                re.sub(r".*<(.*)>", r"\1", line).strip() for line in block.split("\n")
            )
            folder = page.parent.relative_to(DOCS)
            listed.update((folder / name).as_posix() for name in names if name)
    pages = {page.stem for page in DOCS.glob("*.rst")} - {"index"}
    assert pages <= set(listed)
    assert {name for name, count in listed.items() if count > 1} == set()


# Their examples simulate many times, which other tests do with smaller robots.
LONG = {"output_error.rst", "design.rst", "effects.rst"}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page, marks=[pytest.mark.slow] if page.name in LONG else [], id=page.name
        )
        for page in EXAMPLES
        if page.name != "README.md"  # the test below
    ],
)
def test_examples_run(page, tmp_path, monkeypatch):
    pytest.importorskip("pinocchio")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    for block in code_blocks(page):
        exec(compile(block, str(page), "exec"), namespace)


def test_the_readme_needs_no_more_than_it_installs(tmp_path):
    pytest.importorskip("pinocchio")
    # Of other extras, and no dependency of what `pip install ".[robot]"` installs.
    absent = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("matplotlib", "pandas", "pyarrow"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
"""
    code = absent + "\n".join(code_blocks(ROOT / "README.md"))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_examples_that_come_first_exist(monkeypatch):
    order = script(DOCS / "_ext" / "gallery_order.py", monkeypatch)
    there = [path.name for path in (ROOT / "examples").rglob("plot_*.py")]
    assert set(order.FIRST) <= set(there)
    key = order.MostWantedFirst("examples")
    assert sorted([*there, "plot_another.py"], key=key)[: len(order.FIRST)] == list(
        order.FIRST
    )
