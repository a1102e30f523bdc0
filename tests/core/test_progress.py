"""Progress bars: on terminals alone, with the stage, its counts and its note."""

import io
from types import SimpleNamespace

import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa._core import _progress
from sklearn_vbjfa._core._progress import counted, say, show_progress, stage
from sklearn_vbjfa.datasets import load_demo_recording
from sklearn_vbjfa.robot import FitOptions


class Terminal(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self):
        return True


def replace_stderr(monkeypatch, stream):
    """Show bars on a stream; pytest captures that of `sys` itself."""
    monkeypatch.setattr(_progress, "sys", SimpleNamespace(stderr=stream))
    return stream


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.delenv("TQDM_DISABLE", raising=False)
    return replace_stderr(monkeypatch, Terminal())


def run_stages(verbose=1):
    """Run stages of every kind; return the items that were counted."""
    with show_progress(verbose), stage("outer"):
        say("joint 2")
        items = list(counted([5, 6], "reading", "files"))
        list(counted(iter("ab"), "states", "rows", [1, 29]))
    return items


def test_bars_show_stages_counts_and_notes(terminal):
    assert run_stages() == [5, 6]
    shown = terminal.getvalue()
    for text in ("outer", "joint 2", "reading: 0 of 2 files", "states: 0 of 30 rows"):
        assert text in shown


def test_bars_end_with_an_error(terminal):
    with pytest.raises(RuntimeError), show_progress(), stage("states", 3):
        raise RuntimeError
    before = terminal.getvalue()
    run_stages(verbose=0)
    assert terminal.getvalue() == before


@pytest.mark.parametrize("silent", ["piped", "disabled", "verbose=0", "no stderr"])
def test_silence(silent, terminal, monkeypatch):
    streams = {"piped": io.StringIO(), "no stderr": None}
    stream = replace_stderr(monkeypatch, streams.get(silent, terminal))
    if silent == "disabled":
        monkeypatch.setenv("TQDM_DISABLE", "1")
    assert run_stages(verbose=silent != "verbose=0") == [5, 6]
    assert stream is None or stream.getvalue() == ""


def test_stages_of_a_fit(terminal):
    pytest.importorskip("pinocchio")
    recording = load_demo_recording().select(0)
    robot = RobotIdentifier(
        recording.urdf, dt=recording.dt, options=FitOptions(verbose=1)
    )
    robot.fit(recording.q, recording.tau)
    for text in ("states", "equations", "consistent bodies"):
        assert text in terminal.getvalue()
