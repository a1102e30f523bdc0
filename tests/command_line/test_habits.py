"""Command line: suggested commands, closed output and imports."""

import subprocess
import sys
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa._cli import main
from sklearn_vbjfa._cli._parser import command_line, parse
from tests.hostile._case import URDF


class Refusal(ValueError):
    """Error of a reader, with options that would work."""

    def __init__(self, reason, options=None):
        super().__init__(reason)
        self.options = options


@pytest.fixture
def failing_reader(monkeypatch, tmp_path):
    """Return a function that sets the exception that the reader raises."""
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(URDF)

    def fail_with(error):
        def fail(*arguments, **keywords):
            raise error

        monkeypatch.setattr("sklearn_vbjfa.datasets.read_recording", fail)

    return fail_with


@pytest.mark.parametrize("option", [["--out", "full"], ["--out=full"]])
def test_the_suggested_command_replaces_the_option(
    option, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t,q1,tau1\n")
    Path("full").mkdir()
    Path("full/mine").write_text("")
    argv = ["identify", "log.csv", "--urdf", "arm.urdf", *option, "--quiet"]
    assert main(argv) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(
        "or --force to write to it; this would work: python -m sklearn_vbjfa identify "
        "log.csv --urdf arm.urdf --out full-2 --quiet"
    )


def test_options_of_the_suggested_command(failing_reader, capsys):
    argv = ["inspect", "a b.csv", "--urdf", "arm.urdf", "--preset=ur", "--gain", "8"]
    options = {"preset": None, "gains": (8.0, 8.0), "joint_names": ("a", "b")}
    line = command_line(parse(argv), options | {"columns": "q=q {i}"})
    assert line == (
        "python -m sklearn_vbjfa inspect 'a b.csv' --urdf arm.urdf --gain 8,8 "
        "--joints a,b --columns 'q=q {i}'"
    )
    # A command that fails as well is not suggested.
    failing_reader(Refusal("no join=True", options))
    assert main(argv) == 2
    assert capsys.readouterr().err == "sklearn-vbjfa: no --join\n"


def test_closed_output_is_no_error():
    script = "import sys; sys.stdin.read(); from sklearn_vbjfa._cli import main; "
    words = [sys.executable, "-c", f"{script}sys.exit(main(['effects']))"]
    pipes = {name: subprocess.PIPE for name in ("stdin", "stdout", "stderr")}
    with subprocess.Popen(words, text=True, **pipes) as process:
        process.stdout.close()
        process.stdin.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


def test_the_command_line_imports_no_libraries():
    """An early interrupt is handled by the command line."""
    code = "import sys, sklearn_vbjfa._cli; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert not loaded & {"numpy", "scipy", "sklearn", "pinocchio"}


def test_public_names_are_found():
    assert set(sklearn_vbjfa.__all__) <= set(dir(sklearn_vbjfa))
    for name in sklearn_vbjfa.__all__:
        assert getattr(sklearn_vbjfa, name).__name__ == name
        assert name in dir(sklearn_vbjfa)
    for module in sklearn_vbjfa._SUBPACKAGES.split():
        assert getattr(sklearn_vbjfa, module).__name__ == f"sklearn_vbjfa.{module}"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        sklearn_vbjfa.nothing  # noqa: B018
