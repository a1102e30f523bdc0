"""Command line: files of others stay, runs that are stopped end in one line."""

import csv
import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import sklearn_vbjfa
from sklearn_vbjfa._cli import main, one_line, program
from sklearn_vbjfa._cli._close_loop import write_parameters
from sklearn_vbjfa._cli._input import (
    check_folder,
    check_overwriting,
    no_formula,
    sources,
)
from tests._quick import checkered
from tests.hostile._case import URDF

pytest.importorskip("pinocchio")

OURS = ("report.html", "parameters.csv")


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


class Refusal(ValueError):
    """What a reader says of a file, with options that would do."""

    def __init__(self, reason, options=None):
        super().__init__(reason)
        self.options = options


@pytest.fixture
def refused(monkeypatch, tmp_path):
    """Let the reader of recordings end with an exception."""
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(URDF)

    def let(error):
        def fail(*arguments, **given):
            raise error

        monkeypatch.setattr("sklearn_vbjfa.datasets.read_recording", fail)

    return let


# -- what is overwritten ---------------------------------------------------------------


def test_a_folder_of_ones_own_is_written_to_again(out):
    for name in (*OURS, ".DS_Store"):
        (out / name).write_text("")
    check_overwriting(out, OURS, [])
    check_overwriting(out / "new", OURS, [])


@pytest.mark.parametrize("names", [["notes.txt"], [*OURS, "notes.txt"]])
def test_files_of_others_are_refused_by_name(out, names):
    for name in names:
        (out / name).write_text("")
    with pytest.raises(ValueError, match=r"out holds notes\.txt, which no run") as told:
        check_overwriting(out, OURS, [])
    assert "--force" in str(told.value)
    assert told.value.options == {"out": str(out / "report")}


def test_many_files_of_others_are_counted(out):
    for k in range(9):
        (out / f"{k}.txt").write_text("")
    with pytest.raises(ValueError, match=r"holds 0\.txt, 1\.txt, 2\.txt and 6 more,"):
        check_overwriting(out, OURS, [])


def test_pictures_are_ours_where_our_table_is(out):
    (out / "motion.png").write_text("")
    with pytest.raises(ValueError, match=r"motion\.png"):
        check_overwriting(out, ("simulation.csv",), [], (".png",))
    (out / "simulation.csv").write_text("")
    check_overwriting(out, ("simulation.csv",), [], (".png",))


@pytest.mark.parametrize("command", ["close-loop", "simulate"])
def test_an_input_is_not_written_over(command, out, tmp_path, capsys):
    table = out / {"close-loop": "parameters.csv"}.get(command, "simulation.csv")
    table.write_text("t,q1,tau1\n")
    # the same file by another path
    other = tmp_path / "log.csv"
    other.symlink_to(table)
    robot = tmp_path / "arm.urdf"
    robot.write_text("<robot/>")
    argv = [command, str(other), "--urdf", str(robot), "--out", str(out)]
    assert main(argv) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "log.csv is read by this run, which would write over it" in line
    assert "--force" in line
    assert main([*argv, "--force"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "write over" not in line
    assert table.read_text() == "t,q1,tau1\n"


def test_an_output_folder_that_is_a_file_names_one_that_works(tmp_path):
    (tmp_path / "log.csv").write_text("")
    for name in ("log-report", "log-report-2"):
        with pytest.raises(
            ValueError, match=r"log\.csv is a file, where --out"
        ) as told:
            check_folder(tmp_path / "log.csv" / "deeper")
        assert told.value.options == {"out": str(tmp_path / name)}
        (tmp_path / name).mkdir()


@pytest.mark.parametrize("given", [["--out", "log.csv"], ["--out=log.csv"]])
def test_the_command_that_would_work_replaces_the_option(
    given, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t,q1,tau1\n")
    Path("arm.urdf").write_text("<robot/>")
    argv = ["close-loop", "log.csv", "--urdf", "arm.urdf", *given, "--seed", "3"]
    assert main(argv) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(
        "log.csv is a file, where --out must name a folder; this would work: python -m "
        "sklearn_vbjfa close-loop log.csv --urdf arm.urdf --seed 3 --out log-report"
    )


@pytest.mark.parametrize(
    ("options", "command"),
    [
        (
            {"preset": None, "gains": (8.0, 8.0), "joint_names": ("a", "b")}
            | {"columns": "q=q {i}"},
            "; this would work: python -m sklearn_vbjfa inspect 'a b.csv' "
            "--urdf arm.urdf "
            "--gain 8,8 --joints a,b --columns 'q=q {i}'",
        ),
        ({}, ""),
    ],
)
def test_options_in_a_command(options, command, refused, capsys):
    refused(Refusal("no", options))
    argv = ["inspect", "a b.csv", "--urdf", "arm.urdf", "--preset=ur", "--gain", "8"]
    assert main(argv) == 2
    assert capsys.readouterr().err == f"sklearn-vbjfa: no{command}\n"


def test_the_home_folder_is_known(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    there = sources(["~/log.csv", "a~b", "~no_such_user_here/x"])
    assert there == (tmp_path / "log.csv", Path("a~b"), Path("~no_such_user_here/x"))


# -- the end of a process --------------------------------------------------------------


def test_what_has_done_its_work_ends_in_peace(monkeypatch, capsys):
    stops = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in stops]
    monkeypatch.setattr(sys, "argv", ["sklearn-vbjfa", "--version"])
    try:
        with pytest.raises(SystemExit):
            program()
        for number in stops:
            assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        for number, handle in zip(stops, before):
            signal.signal(number, handle)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a full device")
@pytest.mark.parametrize(
    ("argv", "stream", "code", "said"),
    [
        (["effects"], "stdout", 2, "the standard output: No space left on device"),
        (["inspect", "none.csv", "--urdf", "none.urdf"], "stderr", 2, ""),
    ],
)
def test_a_full_disk(argv, stream, code, said):
    with open("/dev/full", "w") as full:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: full}
        result = subprocess.run(
            [sys.executable, "-m", "sklearn_vbjfa", *argv],
            text=True,
            check=False,
            **streams,
        )
    assert result.returncode == code
    assert said in (result.stderr or "")
    assert "Traceback" not in (result.stderr or "")


# -- tables ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("=cmd|' /C calc'!A0:m", "'=cmd|' /C calc'!A0:m"),
        ("@sum:m", "'@sum:m"),
        ("+joint:m", "'+joint:m"),
        ("-joint:m", "'-joint:m"),
        ("\tjoint", "'\tjoint"),
        ("joint_1:m", "joint_1:m"),
        ("-1.5e-3", "-1.5e-3"),
        (-2.0, "-2.0"),
        ("", ""),
    ],
)
def test_no_cell_is_a_formula(cell, expected):
    assert no_formula(cell) == expected


def test_a_joint_that_is_called_like_a_formula_is_none_in_the_table(tmp_path):
    from types import SimpleNamespace

    import numpy as np

    told = {"nominal": np.nan, "before": np.nan, "learned": np.nan, "known": "yes"}
    values = (
        SimpleNamespace(name="=cmd:m", value=-1.0, unit="kg", **told),
        SimpleNamespace(name="=cmd:viscous", value=2.0, unit="N m s/rad", **told),
    )
    robot = SimpleNamespace(
        theta_std_=np.array([0.1, np.nan]),
        identifiable_=np.array([True, False]),
        gains_=None,
        alike_=(),
    )
    path = tmp_path / "parameters.csv"
    write_parameters(robot, values, path)
    rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"))))
    assert [row[0] for row in rows[1:]] == ["'=cmd:m", "'=cmd:viscous"]
    assert [float(row[1]) for row in rows[1:]] == [-1.0, 2.0]
    assert not any(cell.startswith("=") for row in rows for cell in row)


# -- texts -----------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_refusal_is_wrapped_on_a_terminal_and_one_line_elsewhere(
    monkeypatch, refused
):
    message = "a word and " * 40
    refused(ValueError(message.strip()))
    monkeypatch.setenv("COLUMNS", "70")
    for stream, several in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        assert main(["inspect", "a.csv", "--urdf", "arm.urdf"]) == 2
        lines = stream.getvalue().splitlines()
        assert (len(lines) > 1) == several
        assert all(len(line) <= 70 for line in lines) == several
        assert " ".join(lines) == f"sklearn-vbjfa: {message.strip()}"


def test_what_is_left_out_of_a_huge_message_is_counted():
    text = one_line("x" * 5000 + " end")
    assert "..." not in text
    assert "(and 4104 characters more)" in text
    assert text.endswith(" end")
    assert len(text) < 1000


# -- being stopped ---------------------------------------------------------------------

# Sends an interrupt to itself while a module is imported for the first time.
INTERRUPTED = """
import builtins, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
module, number = sys.argv.pop(1), int(sys.argv.pop(1))
original = builtins.__import__
def importing(name, *arguments, **given):
    if name == module:
        builtins.__import__ = original
        os.kill(os.getpid(), number)
    return original(name, *arguments, **given)
from sklearn_vbjfa._cli import program
builtins.__import__ = importing
sys.exit(program())
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize(
    "module", ["numpy", "tempfile", "sklearn_vbjfa.physical._solver"]
)
def test_imports_can_be_interrupted(module, name):
    number = getattr(signal, name)
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, module, str(int(number))],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    how = "interrupted" if name == "SIGINT" else "stopped (SIGTERM)"
    assert done.stderr == f"sklearn-vbjfa: {how}, nothing was written\n"
    assert done.returncode == 128 + number


def test_the_package_is_there_before_its_libraries():
    """Whoever stops a program early meets the command line, not an import."""
    code = "import sys, sklearn_vbjfa._cli; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert not loaded & {"numpy", "scipy", "sklearn", "pinocchio"}


def test_every_name_of_the_package_is_found_where_it_is_said_to_be():
    assert set(sklearn_vbjfa.__all__) <= set(dir(sklearn_vbjfa))
    for name in sklearn_vbjfa.__all__:
        assert getattr(sklearn_vbjfa, name).__name__ == name
        assert name in dir(sklearn_vbjfa)
    for room in sklearn_vbjfa._ROOMS:
        assert getattr(sklearn_vbjfa, room).__name__ == f"sklearn_vbjfa.{room}"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        sklearn_vbjfa.nothing  # noqa: B018


@pytest.mark.skipif(os.name == "nt", reason="descriptors of POSIX")
@pytest.mark.parametrize(
    ("argv", "closed"),
    checkered([["--help"], ["effects"], ["--version"]], [(1,), (2,), (0, 1, 2)]),
)
def test_streams_that_are_closed_are_no_error(argv, closed):
    read, write = os.pipe()
    command = [sys.executable, "-m", "sklearn_vbjfa", *argv]

    def close():
        for number in closed:
            os.close(number)

    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stdout=write if 1 not in closed else subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=close,
        check=False,
        timeout=600,
    )
    os.close(write)
    os.close(read)
    assert done.returncode == 0
    assert done.stderr == b""


def test_a_reader_that_leaves_before_the_help_is_no_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as gone:
        done = subprocess.run(
            [sys.executable, "-m", "sklearn_vbjfa", "close-loop", "--help"],
            stdout=gone,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 0
    assert done.stderr == ""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_library_that_turns_a_stop_into_an_error_of_its_own(monkeypatch, capsys):
    def run(names):
        try:
            signal.raise_signal(signal.SIGTERM)
        except BaseException:
            # As compiled modules do while they are imported.
            raise ImportError("a library is missing") from None

    monkeypatch.setattr("sklearn_vbjfa.effects.resolve", run)
    assert main(["effects"]) == 128 + signal.SIGTERM
    told = "sklearn-vbjfa: stopped (SIGTERM), nothing was written\n"
    assert capsys.readouterr().err == told
    # the next run has not been stopped
    monkeypatch.undo()
    assert main(["effects"]) == 0


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("seconds", [0.15, 0.4])
def test_an_interrupt_soon_after_the_start_is_one_line(seconds):
    # Seconds of the processor: a busy machine is interrupted at the same place.
    code = (
        "import signal, sys\n"
        "from sklearn_vbjfa._cli import program\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "interrupt = lambda *_: signal.raise_signal(signal.SIGINT)\n"
        "signal.signal(signal.SIGPROF, interrupt)\n"
        "signal.setitimer(signal.ITIMER_PROF, float(sys.argv.pop()))\n"
        "sys.exit(program())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(seconds)],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.stderr == "sklearn-vbjfa: interrupted, nothing was written\n"
    assert done.returncode == 130
