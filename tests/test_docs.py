"""The guide, the README and the code say the same, and their examples run."""

import importlib.metadata
import inspect
import math
import re
import textwrap
from collections import Counter
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa import (
    datasets,
    diagnosis,
    distributed,
    effects,
    inspection,
    physical,
    simulation,
)
from tests.test_imports import APART, ROOMS

PUBLIC_MODULES = (
    sklearn_vbjfa,
    datasets,
    diagnosis,
    distributed,
    effects,
    inspection,
    physical,
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
    from sklearn_vbjfa.diagnosis.search import (
        _blocks,
        _evidence,
        _exchange,
        _gaps,
        _judgement,
        _search,
        _shapes,
        _split,
        _symmetry,
        _transfer,
    )
    from sklearn_vbjfa.diagnosis.search import _intervals as intervals
    from sklearn_vbjfa.effects import _base
    from sklearn_vbjfa.robot import _joint_moments

    defaults = inspect.signature(sklearn_vbjfa.EffectDiscovery).parameters
    few, many = _blocks._WANTED
    words = {8: "eight", 9: "nine", 10: "ten"}
    varies, any_case = _gaps.ABOVE_FLOOR
    third = ("whole", "half", "third", "quarter")[_transfer._STRETCHES - 1]
    small = {3: "three", 4: "four", 10: "ten"}
    return [
        f"fitted to the first {100 * _search._FORWARD:g} % of the search data",
        f"the first {third} of every recording is predicted from the other two",
        f"{100 * defaults['test_size'].default:g} % of the motion (``test_size``)",
        f"or {small[_split._STRETCHES]} stretches of a single one",
        f"an error takes {small[int(_split.FEWEST_VALUES)]} values that are",
        f"reaches {small[int(_judgement._WIDER)]} times as far (at least to "
        f"{_judgement._CONTROL:g} Hz)",
        f"p-values of at most ``alpha`` ({defaults['alpha'].default:g}) times k / m",
        f"fewer than {_blocks.FEWEST} times what the residual stays correlated for",
        f"fitted to the first {100 * _search._LATE:g} % of where it acts",
        f"acts in fewer than {2 * _search._ACTIVE} blocks",
        f"acts in fewer than {_search._ACTIVE} blocks after the middle",
        f"(with less than {100 * _search._FADED:g} % of its largest power)",
        f"and {words[_shapes._FINER]} finer steps around the tuned one",
        f"{_blocks._CORRELATION_TIMES:g} times as long as the residual stays corr",
        f"{few} to {many} blocks are aimed at, and {_blocks.FEWEST} are the fewest",
        f"Every {_blocks._FOLDS}th block is predicted from the others",
        f"save at least {100 * _evidence.SMALLEST_GAIN:g} % of the joint's squared",
        f"at most {_search.AT_FLOOR:g} of its standard deviations above the noise",
        f"saves more than {100 * _search._CONTAINED:g} % of what the candidate saves",
        f"The {small[_search._ANEW]} best candidates of a joint are judged once more",
        f"more than {_exchange._ABOVE:g} times above their noise floor",
        f"each effect beside the {small[_exchange._FIRST]} best ones",
        f"the other way round saves more than {100 * _symmetry._SHARE:g} % of what",
        f"costs less than {100 * _search._SUPERFLUOUS:g} % of the squared error",
        f"above {varies:g} times the floor if it varies with any, above {any_case:g} t",
        f"({100 * _base._FAST:g} % of its speeds are slower)",
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
        _time,
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
        "T": _time._CONSTANTS,
        "payload": [_time._INSTANTS],
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
