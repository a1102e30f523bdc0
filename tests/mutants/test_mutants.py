"""The wrong changes still fit the package, and the tests that notice them exist."""

import ast
import difflib
import functools
import tomllib

import pytest

from tests.mutants import run
from tests.mutants.run import ROOT, mutants


@functools.cache
def functions_of(file):
    """Functions of a test module by name."""
    body = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    return {one.name: one for one in body if isinstance(one, ast.FunctionDef)}


def function_of(test):
    """Return the function of a test, which may be one of many cases, or None."""
    file, name = test.partition("[")[0].split("::")
    return functions_of(file).get(name)


@pytest.mark.parametrize("mutant", mutants(), ids=lambda one: one.name)
def test_a_mutant_applies_and_its_test_is_of_the_quick_run(mutant):
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    changed = mutant.applied(text)
    if mutant.file.endswith(".py"):
        ast.parse(changed)
    else:
        tomllib.loads(changed)
    # One line for another, or one line less.
    lines = difflib.ndiff(mutant.before.splitlines(), mutant.after.splitlines())
    signs = [line[0] for line in lines if line[0] in "+-"]
    assert signs in (["-", "+"], ["-"])
    function = function_of(mutant.test)
    assert function is not None, f"{mutant.test} does not exist"
    marks = [ast.unparse(one) for one in function.decorator_list]
    assert not any("slow" in mark for mark in marks)


def test_there_are_many_and_no_two_are_alike():
    every = mutants()
    assert len(every) >= 30
    assert len({(one.file, one.before, one.after) for one in every}) == len(every)


@pytest.mark.slow
def test_one_that_nobody_notices_is_told(tmp_path, capsys):
    # Changes of a file that the named test looks at, and of one that it does not.
    test = "tests/mutants/test_mutants.py::test_there_are_many_and_no_two_are_alike"
    entries = (
        (
            "killed",
            "tests/mutants/run.py",
            "in entries.items()]",
            "in 2 * [*entries.items()]]",
        ),
        ("alive", "sklearn_vbjfa/__main__.py", "import sys", "import os, sys"),
        ("gone", "sklearn_vbjfa/__main__.py", "import nothing", "import sys"),
    )
    table = "".join(
        f"[{name}]\ntest = '{test}'\nfile = '{file}'\n"
        f"before = '{old}'\nafter = '{new}'\n"
        for name, file, old, new in entries
    )
    (tmp_path / "three.toml").write_text(table, encoding="utf-8")
    given = ["--table", str(tmp_path / "three.toml"), "--jobs", "1"]
    assert run.main(given) == 1
    told = {row.split()[0]: row for row in capsys.readouterr().out.splitlines()}
    assert "killed by" in told["killed"]
    assert "survives" in told["alive"]
    assert "no longer applies" in told["gone"]
    assert run.main([*given, "killed"]) == 0
