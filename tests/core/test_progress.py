"""Progress: on terminals only, with stage and count."""

import io
import sys

import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa._core._runtime import show_progress
from sklearn_vbjfa.datasets import load_demo_recording


class Terminal(io.StringIO):
    """A terminal that stores its output."""

    def isatty(self):
        return True


@pytest.fixture(scope="module")
def recording():
    return load_demo_recording().select(0)


def fit(recording, verbose=1):
    with show_progress(verbose):
        robot = RobotIdentifier(recording.urdf, dt=recording.dt)
        return robot.fit(recording.q, recording.tau)


def show_on(monkeypatch, stream):
    """Replace stderr; pytest replaces the one of `sys` before each test."""
    monkeypatch.delenv("TQDM_DISABLE", raising=False)
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


def test_stages_of_a_fit_are_shown_with_counts(recording, monkeypatch):
    terminal = show_on(monkeypatch, Terminal())
    fit(recording)
    assert "states: 1 of" in terminal.getvalue()


@pytest.mark.parametrize("silent", ["piped", "verbose=0", "no stderr"])
def test_progress_is_not_shown(silent, recording, monkeypatch):
    streams = {"piped": io.StringIO(), "no stderr": None}
    stream = show_on(monkeypatch, streams.get(silent, Terminal()))
    fit(recording, verbose=silent != "verbose=0")
    assert stream is None or stream.getvalue() == ""
