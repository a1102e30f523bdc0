"""Consistency of the documentation, the README and the code; examples run."""

import importlib.util
import json
import os
import re
import subprocess
import sys
import textwrap
import tomllib
from collections import Counter
from pathlib import Path

import pytest

import sklearn_vbjfa
from tests.test_imports import RESTRICTED, ROOMS

ALL_ROOMS = [importlib.import_module(f"sklearn_vbjfa.{x}") for x in ROOMS if x != "top"]
PUBLIC_MODULES = [x for x in (sklearn_vbjfa, *ALL_ROOMS) if hasattr(x, "__all__")]
ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"


def read(path):
    return path.read_text(encoding="utf-8")


def tagged_equations(text):
    """Equation numbers in tags such as [eq. 12] or [eqs. 17-25]."""
    numbers = set()
    for tag in re.findall(r"\[eqs?\. ([^\]]+)\]", text):
        for first, last in re.findall(r"(\d+)(?:-(\d+))?", tag.split(", line")[0]):
            numbers.update(range(int(first), int(last or first) + 1))
    return numbers


def code_blocks(path):
    """Python examples of a page, padded so that tracebacks show the right line."""
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


PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.rst")), DOCS / "evidence.md"]
EXAMPLES = [page for page in PAGES if code_blocks(page)]


def test_every_equation_tag_is_in_the_guide():
    source = ROOT / "sklearn_vbjfa"
    used = tagged_equations("\n".join(read(path) for path in source.rglob("*.py")))
    explained = tagged_equations(read(DOCS / "theory.rst"))
    assert used, "no tags found"
    assert used <= explained, f"not in the guide: {sorted(used - explained)}"
    assert explained <= used, f"not in the code: {sorted(explained - used)}"


def test_new_equations_are_in_the_guide_and_in_the_code():
    guide = read(DOCS / "theory.rst")
    printed = re.findall(r"\\tag\{(\w+)\}", guide)
    for letter in "BC":
        numbers = [int(tag[1:]) for tag in printed if tag[0] == letter]
        assert numbers == list(range(1, len(numbers) + 1)), letter
        assert numbers, f"no equation {letter}1"
    source = ROOT / "sklearn_vbjfa"
    pattern = re.compile(r"\[([BC]\d+)\]")
    used = {tag for path in source.rglob("*.py") for tag in pattern.findall(read(path))}
    assert used == set(printed)
    assert set(pattern.findall(guide)) <= set(printed)


def test_every_public_name_is_in_api_once():
    for module in PUBLIC_MODULES:
        assert list(module.__all__) == sorted(set(module.__all__)), module
        assert set(module.__all__) <= set(dir(module)), module
    public = {name for module in PUBLIC_MODULES for name in module.__all__}
    blocks = re.findall(
        r"\.\. autosummary::\n(?:    :.*\n)*\n((?:    \S+\n)+)", read(DOCS / "api.rst")
    )
    listed = Counter(name for block in blocks for name in block.split())
    assert {name for name, count in listed.items() if count > 1} == set()
    assert set(listed) == public


def test_documented_imports_match_the_allowed_imports():
    rows = re.findall(
        r"    \* - ``(\w+)``\n      - .+(?:\n {8}.+)*\n      - (.+)\n",
        read(DOCS / "contributing.rst"),
    )
    assert [room for room, _ in rows] == ROOMS
    for room, imports in rows:
        above = set(ROOMS[: ROOMS.index(room)])
        names = above if imports == "all above" else set(re.findall(r"\w+", imports))
        assert names - {"none"} == RESTRICTED.get(room, above), room


def test_every_dependency_is_explained():
    text = read(DOCS / "contributing.rst")
    project = tomllib.loads(read(ROOT / "pyproject.toml"))["project"]
    extras = project["optional-dependencies"].values()
    for requirement in sum(extras, project["dependencies"]):
        # The three separators are equivalent in names of packages.
        name = re.sub(r"[._-]+", "[._-]", re.match(r"[\w.-]+", requirement).group())
        assert re.search(rf"^(\w+ +)?{name} ", text, flags=re.M), name


def test_errata_name_existing_tests():
    errata = read(DOCS / "theory.rst").partition("Errata of the paper")[2]
    named = set(re.findall(r"``(test_\w+)``", errata))
    tests = "\n".join(read(path) for path in (ROOT / "tests").rglob("test_*.py"))
    assert set() < named <= set(re.findall(r"^def (test_\w+)", tests, flags=re.M))


def test_files_named_in_the_guide_exist():
    pattern = r"``?((?:docs|tests|examples|sklearn_vbjfa)/[\w/.]+\.\w+)``?"
    for page in PAGES:
        for name in re.findall(pattern, read(page)):
            assert (ROOT / name).is_file(), f"{page.name} names {name}"


def test_readme_links_exist():
    links = re.findall(r"\]\(([^)]+)\)", read(ROOT / "README.md"))
    local = [link for link in links if not link.startswith("https://")]
    assert "docs/images/residual.png" in local
    for link in local:
        assert (ROOT / link).is_file(), link


def script(path, patch):
    """Import a script of the documentation; `patch` removes the module again."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    # dataclasses looks the module up in sys.modules.
    patch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def recorded():
    with pytest.MonkeyPatch.context() as patch:
        yield script(DOCS / "_ext" / "recorded.py", patch)


TABLES = sorted((DOCS / "tables").glob("*.rst"))


@pytest.mark.parametrize("path", TABLES, ids=lambda path: path.stem)
def test_tables_match_their_data(path, recorded):
    record = json.loads(read(path.with_suffix(".json")))
    tables = [
        {"headers": [*x.headers], "rows": [*map(list, x.rows)]}
        for x in recorded.tables_in(read(path))
    ]
    assert tables
    assert record["tables"] == tables
    assert (ROOT / record["script"]).is_file()
    assert record["script"] in " ".join(read(path).split())
    for commit in record["commits"]:
        assert commit in read(path)
    assert record["commits"][0] in recorded.made(path.stem)


@pytest.mark.slow
def test_example_report_is_up_to_date(monkeypatch):
    demo = script(DOCS / "demo_report.py", monkeypatch)
    # Compare words only: last digits depend on libraries and processors.
    committed, generated = (
        re.findall(r">([^<>\d]*[a-z][^<>\d]*)<", text)
        for text in (read(demo.PAGE), demo.page())
    )
    assert committed == generated


def test_headline_figures_match_the_measured_tables(recorded):
    (models, *_) = recorded.tables_in(recorded.read("protocol_emps"))
    # model and states -> error
    errors = {tuple(row[:2]): row[-1] for row in models.rows}
    published = errors["published, least squares", "theirs"]
    completed = errors["EffectDiscovery, completed model", "positions"]
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
    assert sum(ratio < 0.9 for ratio in ratios) == 8
    assert [round(100 * (1 - ratio)) for ratio in sorted(ratios)[8:]] == [5, 1]
    for page in (ROOT / "README.md", DOCS / "index.rst"):
        text = " ".join(read(page).split())
        assert f"{published} %" in text
        assert f"{completed} %" in text
        assert "more than a tenth on eight, by 5 % on the ninth (KUKA LBR)" in text


# Slow examples (simulation, search, compilation), which other tests cover.
LONG = {"design.rst", "effects.rst", "simulation.rst"}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page, marks=[pytest.mark.slow] if page.name in LONG else [], id=page.name
        )
        for page in EXAMPLES
        if page.name != "README.md"  # tested below
    ],
)
def test_examples_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    for block in code_blocks(page):
        exec(compile(block, str(page), "exec"), namespace)
        printed = capsys.readouterr().out
        for result in re.findall(r"print\(.*# (\[.*?\])", block):
            assert result in printed


@pytest.mark.slow
def test_readme_examples_run_without_optional_packages(tmp_path):
    # Optional packages that `pip install ".[robot]"` does not install.
    absent = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("matplotlib", "pandas", "pyarrow"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
"""
    code = absent + "\n".join(code_blocks(ROOT / "README.md"))
    process = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr


def test_tables_are_stale_after_code_changes(recorded, tmp_path):
    package, folder = tmp_path / "package", tmp_path / "tables"
    (package / "room").mkdir(parents=True)
    code = package / "room" / "_code.py"
    code.write_text('"""Text."""\n\nx = 1\n')
    record = {"rooms": ["room"], "digest": recorded.digest(["room"], package)}
    folder.mkdir()
    (folder / "made.json").write_text(json.dumps(record))
    (folder / "old.json").write_text("{}")
    assert recorded.stale(folder, package) == ["old"]
    code.write_text('"""Another text."""\n\nx = 1  # a comment\n')
    assert recorded.stale(folder, package) == ["old"]
    code.write_text('"""Text."""\n\nx = 2\n')
    assert recorded.stale(folder, package) == ["made", "old"]
