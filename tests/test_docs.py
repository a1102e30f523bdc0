"""The guide, the README and the code say the same, and their examples run."""

import importlib.metadata
import re
import textwrap
from collections import Counter
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa import datasets, diagnosis, effects, physical

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


def code_blocks(path):
    """Python examples of a page, in order, with the line at which each begins."""
    text = read(path)
    if path.suffix == ".md":
        pattern = r"^```python\n(.*?)^```"
    else:
        pattern = r"^\.\. code-block:: python\n\n((?:    .*\n|\n)+)"
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


def test_every_public_name_is_in_api_once():
    modules = (sklearn_vbjfa, datasets, diagnosis, effects, physical)
    public = {name for module in modules for name in module.__all__}
    blocks = re.findall(
        r"\.\. autosummary::\n(?:    :.*\n)*\n((?:    \S+\n)+)", read(DOCS / "api.rst")
    )
    listed = Counter(name for block in blocks for name in block.split())
    assert {name for name, count in listed.items() if count > 1} == set()
    assert set(listed) == public


def test_names_in_api_are_where_it_says():
    modules = (sklearn_vbjfa, datasets, diagnosis, effects, physical)
    module = None
    for line in read(DOCS / "api.rst").splitlines():
        if line.startswith(".. currentmodule:: "):
            name = line.removeprefix(".. currentmodule:: ")
            module = {m.__name__: m for m in modules}[name]
        elif re.fullmatch(r"    \w+", line):
            assert line.strip() in module.__all__


def test_table_of_effects_agrees_with_the_classes():
    rows = re.findall(
        r"    \* - ``(\w+)``\n      - (.+(?:\n {8}.+)*)\n      - (.+)\n      -(.*)\n",
        read(DOCS / "effects.rst"),
    )
    assert [row[0] for row in rows] == list(effects.available())
    for (name, torque, visible, contains), effect in zip(rows, effects.resolve()):
        assert effect.name == name
        assert visible == effect.visible, name
        assert contains.strip() == ", ".join(effect.contains), name
        for symbol in effect.parameters([1.0] * len(effect.coefficients)):
            assert re.search(rf"\b{symbol}\b", torque), (name, symbol)


def test_setup_is_two_commands():
    commands = re.search(r"```bash\n(.*?)```", read(ROOT / "README.md"), re.DOTALL)
    assert commands.group(1).splitlines() == SETUP


def test_ci_runs_the_test_command_of_the_readme():
    lines = read(ROOT / ".ci" / "run").splitlines()
    install, command = SETUP[1].split(" && ")
    assert command in lines
    assert install.replace("install", "install -q") in lines


def test_every_dependency_is_explained():
    text = read(DOCS / "dependencies.rst")
    for requirement in importlib.metadata.requires("sklearn-vbjfa"):
        name = re.match(r"[\w.-]+", requirement).group()
        assert re.search(rf"^(\w+ +)?{re.escape(name)} ", text, flags=re.M), name


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


@pytest.mark.parametrize("page", EXAMPLES, ids=lambda page: page.name)
def test_examples_run(page, tmp_path, monkeypatch):
    pytest.importorskip("pinocchio")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    for block in code_blocks(page):
        exec(compile(block, str(page), "exec"), namespace)
