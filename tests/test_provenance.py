"""Tables know the code that they were made from, and pages say what has changed."""

import importlib.util
import re
import shutil
import sys
import textwrap
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording

ROOT = Path(__file__).resolve().parents[1]
TABLES = ROOT / "docs" / "tables"


@pytest.fixture(scope="module")
def provenance():
    with pytest.MonkeyPatch.context() as patch:
        path = ROOT / "docs" / "_ext" / "provenance.py"
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        patch.setitem(sys.modules, path.stem, module)
        spec.loader.exec_module(module)
        yield module


@pytest.fixture(scope="module")
def texts(provenance):
    return provenance.sources()


CODE = '''"""What it does."""

LIMIT = 0.05  # of the spread


class One:
    """One."""

    def two(self, x, *, y=None):
        """Two."""
        return f"{x!r:>4}", x[1:], y
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""What it does."""\n\n', ""),
        ('"""Two."""\n        ', ""),
        ("  # of the spread", ""),
        ("LIMIT = 0.05", "LIMIT = (\n    5e-2\n)"),
        ("x, *, y=None", "x,\n        *,\n        y=None,\n    "),
        ('    """One."""\n', '    """The first."""\n'),
    ],
)
def test_the_form_of_code_does_not_count(provenance, old, new):
    assert old in CODE
    assert provenance.digest(CODE.replace(old, new)) == provenance.digest(CODE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.05", "0.051"),
        ("0.05", "None"),
        ("LIMIT", "BOUND"),
        ("y=None", "y=0"),
        ("x[1:]", "x[:1]"),
        ("!r:>4", "!r:>5"),
        ("!r", ""),
        ("x, *, y", "x, y"),
        # not a docstring: somebody may read it
        ('"""What it does."""', '__doc__ = """What it does."""'),
    ],
)
def test_what_code_says_counts(provenance, old, new):
    assert provenance.digest(CODE.replace(old, new)) != provenance.digest(CODE)


# A package whose __init__.py has names of other files, and scripts that use it.
SMALL = {
    "sklearn_vbjfa/__init__.py": """
        from typing import TYPE_CHECKING
        if TYPE_CHECKING:
            from sklearn_vbjfa.a._one import One
            from sklearn_vbjfa.b import Two
        __version__ = "1"
    """,
    "sklearn_vbjfa/a/__init__.py": "",
    "sklearn_vbjfa/a/_one.py": """
        from typing import TYPE_CHECKING
        if TYPE_CHECKING:
            from sklearn_vbjfa.b._two import Two
        def One():
            from sklearn_vbjfa.a import _lazy
            return _lazy.f()
    """,
    "sklearn_vbjfa/a/_lazy.py": "from sklearn_vbjfa import __version__",
    "sklearn_vbjfa/b/__init__.py": "from sklearn_vbjfa.b._two import Two, three",
    "sklearn_vbjfa/c/__init__.py": '_MODULES = {"_five": ("five",), "_six": ("six",)}',
    "sklearn_vbjfa/c/_five.py": "five = 5",
    "sklearn_vbjfa/c/_six.py": "six = 6",
    "sklearn_vbjfa/b/_two.py": "import sklearn_vbjfa.a._lazy",
    "sklearn_vbjfa/b/_four.py": "",
    "tests/x/_help.py": """
        from sklearn_vbjfa.b._four import four
        from sklearn_vbjfa import Two
        SIZE = 3
        def easy():
            return SIZE
        def hard():
            return easy() + other()
        def other():
            return Two()
        if __name__ == "__main__":
            four()
    """,
}
ONE = ["sklearn_vbjfa/a/_lazy.py", "sklearn_vbjfa/a/_one.py"]
TWO = ["sklearn_vbjfa/a/_lazy.py", "sklearn_vbjfa/b/_two.py"]


@pytest.mark.parametrize(
    ("script", "files"),
    [
        ("from sklearn_vbjfa import One", ONE),
        ("def main():\n    from sklearn_vbjfa import One", ONE),
        ("import sklearn_vbjfa\nprint(sklearn_vbjfa.__file__)", []),
        ("import sklearn_vbjfa\nsklearn_vbjfa.One()", ONE),
        ("import sklearn_vbjfa\ngetattr(sklearn_vbjfa, 'Two', None)", TWO),
        ("from sklearn_vbjfa import b\nb.three()", TWO),
        (
            "from sklearn_vbjfa import b\nprint(b)",
            ["sklearn_vbjfa/b/__init__.py", *TWO],
        ),
        ("from sklearn_vbjfa.b._four import x", ["sklearn_vbjfa/b/_four.py"]),
        ("from _help import easy", []),
        ("from sklearn_vbjfa.c import five", ["sklearn_vbjfa/c/_five.py"]),
        ("from _help import hard", TWO),
        ("import _help as h\nh.other()", TWO),
        ("from tests.x._help import hard", TWO),
        ("import subprocess\nENTERS = ('sklearn_vbjfa.One',)", ONE),
        ("ENTERS = ('_help',)", ["sklearn_vbjfa/b/_four.py", *TWO]),
        ("from _help import easy\nfrom sklearn_vbjfa import One", ONE),
    ],
)
def test_files_that_a_script_enters(provenance, script, files):
    texts = {path: textwrap.dedent(text) for path, text in SMALL.items()}
    texts["tests/x/bench.py"] = script
    assert provenance.entered("tests/x/bench.py", texts) == sorted(files)


def test_a_script_that_is_not_there_is_refused(provenance):
    with pytest.raises(ValueError, match=r"there is no script tests/x/bench\.py"):
        provenance.entered("tests/x/bench.py", {})


def test_scripts_of_regression_do_not_enter_the_search(provenance, texts):
    def rooms(name):
        files = provenance.entered(f"tests/benchmarks/bench_{name}.py", texts)
        return {path.split("/")[1] for path in files}

    assert rooms("speed") == {"_core", "regression"}
    assert "diagnosis" not in rooms("measured_robots")
    assert {"diagnosis", "effects", "robot"} <= rooms("measured_sets")
    assert "_cli" in rooms("first_report")  # in processes of its own


def test_what_runs_is_among_the_files_that_are_entered(provenance, texts):
    pytest.importorskip("pinocchio")
    script = (
        "from sklearn_vbjfa import RobotIdentifier\n"
        "from sklearn_vbjfa.datasets import make_robot_recording\n"
    )
    texts = {**texts, "tests/bench.py": script}
    entered = set(provenance.entered("tests/bench.py", texts))
    package = Path(sklearn_vbjfa.__file__).parent
    ran = set()

    def record(frame, event, argument):
        # functions: what a module or a class does when it is imported does not count
        if event == "call" and frame.f_code.co_flags & 1:
            ran.add(frame.f_code.co_filename)

    sys.setprofile(record)
    try:
        recording = make_robot_recording(duration=4.0, dt=0.01, random_state=0)
        robot = RobotIdentifier(recording.urdf, dt=0.01, friction=("viscous",))
        robot.fit(recording.q, recording.tau).predict(recording.q)
    finally:
        sys.setprofile(None)
    paths = {Path(name) for name in ran}
    own = {
        path.relative_to(package.parent) for path in paths if package in path.parents
    }
    own = {path.as_posix() for path in own if path.name != "__init__.py"}
    assert len(own) > 20
    assert own <= entered


def record_of(provenance, texts, *files, **changes):
    state = provenance.state("1a2b3c4", {**texts, **changes}, list(files))
    return {"script": "tests/x/bench.py", "states": [state]}


def test_age_of_a_table(provenance):
    files = ["sklearn_vbjfa/a/_one.py", "sklearn_vbjfa/b/_two.py"]
    old = dict.fromkeys(files, "x = 1")
    record = record_of(provenance, old, *files)
    same = provenance.age(record, {path: "x = 1  # one" for path in files})
    assert same.changed == ()
    assert same.sentence() == (
        "Made at 1a2b3c4; none of the 2 files of the package that its script enters "
        "has changed since."
    )
    new = {files[0]: "x = 2", "sklearn_vbjfa/c.py": ""}
    assert provenance.age(record, new).changed == tuple(files)  # one is gone
    new = {files[0]: "x = 1", files[1]: "x = 2"}
    age = provenance.age(record, new)
    assert age.changed == (files[1],)
    assert age.sentence() == (
        "Made at 1a2b3c4; since then 1 of the 2 files of the package that its script "
        "enters has changed"
    )
    # Of a table made at two commits, what differs from either has changed.
    second = provenance.state("5d6e7f8", new, files)
    both = {**record, "states": [*record["states"], second]}
    for now in (old, new):
        assert provenance.age(both, now).changed == (files[1],)
    assert provenance.made(both) == "made at 1a2b3c4 and 5d6e7f8"
    unknown = {**record, "states": [{"commit": "unknown", "files": {}}]}
    assert "is not known" in provenance.age(unknown, old).sentence()


@pytest.mark.parametrize("path", sorted(TABLES.glob("*.rst")), ids=lambda p: p.stem)
def test_every_table_says_what_it_was_made_from(provenance, path):
    record = provenance.read(path.stem)
    text = path.read_text(encoding="utf-8")
    last = text.rstrip().split("\n\n")[-1]
    assert record["script"] in last
    assert provenance.made(record).removeprefix("made ") in last
    files = provenance.age(record, {}).files
    # A reference that is written out takes nothing of the package.
    script = ROOT.joinpath(record["script"]).read_text(encoding="utf-8")
    assert files or "sklearn_vbjfa" not in script
    assert all(re.fullmatch(r"sklearn_vbjfa/[\w/]+\.py", name) for name in files)
    for state in record["states"]:
        for found in state["files"].values():
            assert re.fullmatch("[0-9a-f]{12}", found)
    search = any("diagnosis/" in name and "search" in name for name in files)
    early = record.get("words") == "committed with"
    assert ("of" in record) >= (search and early)
    # its script is still there
    assert (ROOT / record["script"]).is_file()


def test_nothing_is_said_of_tables_that_are_gone():
    made = {path.stem for path in TABLES.glob("*.json")}
    assert made == {path.stem for path in TABLES.glob("*.rst")}


def test_a_table_without_provenance_is_refused(provenance, tmp_path):
    with pytest.raises(ValueError, match=r"no one\.json beside it.*--write"):
        provenance.read("one", tmp_path)


TABLE = "Made of {0}.\n\n===  ===\na    b\n===  ===\n1    2\n===  ===\n\nMade by me.\n"
PAGES = {
    "index": """
        Page
        ====

        .. toctree::

            other

        .. include:: tables/old.rst

        .. include:: tables/new.rst

        .. recorded-line:: old
            :begins: Made of

        After.
    """,
    "other": """
        Other
        =====

        .. recorded-table:: old
            :columns: b

        Between.

        .. recorded-table:: old
            :columns: a

        .. recorded-line:: new
            :begins: Made of
    """,
}


@pytest.fixture
def built(provenance, tmp_path, monkeypatch):
    """Return a function that builds small pages: their texts, and complaints."""
    pytest.importorskip("sphinx_design")
    application = pytest.importorskip("sphinx.application")
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    for name in ("recorded", "recorded_directives"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    docs = tmp_path / "docs"
    (docs / "tables").mkdir(parents=True)
    for path in ("sklearn_vbjfa/a/_one.py", "sklearn_vbjfa/b/_two.py"):
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_text("SIZE = 1\n")
    texts = provenance.sources(tmp_path, ["sklearn_vbjfa"])
    for name in ("old", "new"):
        (docs / "tables" / f"{name}.rst").write_text(TABLE.format(name))
    older = {**texts, "sklearn_vbjfa/b/_two.py": "SIZE = 2"}
    for name, then in (("old", older), ("new", texts)):
        provenance.write(
            name,
            "tests/x/bench.py",
            [provenance.state("1a2b3c4", then)],
            list(texts),
            folder=docs / "tables",
        )
    for name, text in PAGES.items():
        (docs / f"{name}.rst").write_text(textwrap.dedent(text))

    def build():
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        with (tmp_path / "said").open("w") as said:
            app = application.Sphinx(
                srcdir=docs,
                confdir=None,
                outdir=tmp_path / "out",
                doctreedir=tmp_path / "out" / "trees",
                buildername="text",
                confoverrides={
                    "extensions": ["recorded_directives", "sphinx_design"],
                    "exclude_patterns": ["tables"],
                },
                status=None,
                warning=said,
            )
            app.build()
        pages = [(tmp_path / "out" / f"{name}.txt").read_text() for name in PAGES]
        return [" ".join(p.split()) for p in pages], (tmp_path / "said").read_text()

    return build


STALE = (
    "Made at 1a2b3c4; since then 1 of the 2 files of the package that its script "
    "enters has changed"
)
FRESH = (
    "Made at 1a2b3c4; none of the 2 files of the package that its script enters has "
    "changed since."
)


def test_pages_say_which_files_have_changed(built):
    (page, other), said = built()
    assert said == ""
    assert page.count(STALE) == page.count(FRESH) == 1
    # below the table, not below the line that is quoted from it
    assert page.index(STALE) < page.index("Made of new") < page.index(FRESH)
    assert page.index(FRESH) < page.rindex("Made of old") < page.index("After.")
    assert '"sklearn_vbjfa/b": "_two.py"' in page
    assert "_one.py" not in page
    # once for a table that is shown in pieces, and for a line where no table is
    assert other.count(STALE) == other.count(FRESH) == 1
    assert other.index("Between.") < other.index(STALE) < other.index(FRESH)


def test_a_page_with_a_table_without_provenance_is_an_error(built, tmp_path):
    (tmp_path / "docs" / "tables" / "new.json").unlink()
    _, said = built()
    assert "nobody knows what docs/tables/new.rst was made from" in said
