"""Stages of a long run: what is told of them, and what is shown."""

import contextlib
import io
import threading

import numpy as np
import pytest
from joblib import Parallel, delayed
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, Progress, RobotIdentifier
from sklearn_vbjfa._core import _progress
from sklearn_vbjfa._core._progress import counted, say, stage, telling


class Terminal(io.StringIO):
    """A terminal, of what is written to it."""

    def isatty(self):
        return True


class Clock:
    """A clock that stands still unless it is told [s]."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def heard():
    """Return what is told while the test runs."""
    told = []
    with telling(tell=told.append):
        yield told


@pytest.fixture
def drawn(monkeypatch):
    """Draw by hand, on a clock of one's own; (clock, display of a stream)."""
    clock = Clock()

    @contextlib.contextmanager
    def shown(stream):
        run = _progress._Run(clock=clock)
        token = _progress._RUN.set(run)
        display = _progress._Display(run, stream)
        yield display
        display.clear()
        _progress._RUN.reset(token)

    return clock, shown


def last_picture(terminal):
    """Return what a terminal shows in its last line."""
    return terminal.getvalue().split("\r")[-1]


# -- what is told ----------------------------------------------------------------------


def test_nobody_listens():
    with stage("a", 3) as step:
        step()
        say("b")
    assert list(counted([1, 2], "a")) == [1, 2]


def test_a_stage_and_its_steps(heard):
    with stage("states", 30, "rows") as step:
        step(10)
        say("joint 2")
        step(20)
    told = [(one.stage, one.done, one.total, one.unit) for one in heard]
    assert told == [
        ("states", 0, 30, "rows"),
        ("states", 10, 30, "rows"),
        ("states, joint 2", 10, 30, "rows"),
        ("states, joint 2", 30, 30, "rows"),
    ]
    assert heard[-1].remaining == 0


def test_items_are_counted_when_they_are_done(heard):
    for k in counted([5, 6], "reading", "files"):
        assert heard[-1].done == k - 5
    assert str(heard[-1]).startswith("reading, 2 of 2 files, ")


def test_a_single_item_is_not_counted(heard):
    list(counted(["a"], "reading", "files"))
    assert {one.total for one in heard} == {None}
    assert heard[-1].told == "reading"


def test_sizes_are_counted(heard):
    list(counted(iter("ab"), "states", "rows", [1_000_000, 800_000]))
    told = [one.told for one in heard]
    assert told[1] == "states, 1,000,000 of 1,800,000 rows"


def test_a_stage_within_a_stage(heard):
    with stage("comparing", 4, "methods") as step:
        step()
        with stage("equations", 9, "rows"):
            pass
    # What holds the others says how much is left.
    assert heard[-1].told == "comparing: equations, 1 of 4 methods"


def test_what_is_left(drawn):
    clock, shown = drawn
    with shown(io.StringIO()) as display, stage("states", 300, "rows") as step:
        assert display.run.now().remaining is None
        clock.now += 60.0
        step(100)
        now = display.run.now()
    assert (now.seconds, now.remaining) == (60.0, 120.0)
    assert str(now) == "states, 100 of 300 rows, 1 min 0 s, about 2 min 0 s left"


def test_what_is_left_at_most(drawn):
    clock, shown = drawn
    with (
        shown(io.StringIO()) as display,
        stage("improving", 12, "rounds", at_most=True) as step,
    ):
        clock.now += 30.0
        step(3)
        now = display.run.now()
    assert (
        str(now) == "improving, 3 of at most 12 rounds, 30 s, at most 1 min 30 s left"
    )


def test_more_than_expected_leaves_nothing_to_say(drawn):
    _, shown = drawn
    with shown(io.StringIO()) as display, stage("states", 10) as step:
        step(11)
        assert display.run.now().remaining is None


def test_listeners_beside_each_other(heard):
    inner = []
    with stage("final model"), telling(tell=inner.append), stage("states"):
        pass
    assert [one.stage for one in inner] == ["final model: states"]
    assert [one.stage for one in heard] == ["final model", "final model: states"]


def test_an_error_ends_its_stages(heard):
    with pytest.raises(KeyError), stage("a"), stage("b"):
        raise KeyError("c")
    with stage("d"):
        pass
    assert heard[-1].stage == "d"


def test_threads_count_for_what_started_them(heard):
    def work(step):
        with stage("inner"):
            say("nobody hears this")
            step()

    with stage("outer", 200) as step:
        Parallel(n_jobs=4, backend="threading")(delayed(work)(step) for _ in range(200))
    assert {one.stage for one in heard} == {"outer"}
    assert max(one.done for one in heard) == 200


def test_only_functions_are_told():
    with pytest.raises(TypeError, match=r"progress must be a function.*got 3"):
        telling(tell=3).__enter__()


# -- what is shown ---------------------------------------------------------------------


def test_short_stages_are_not_shown(drawn):
    clock, shown = drawn
    for stream in (io.StringIO(), Terminal()):
        with shown(stream) as display, stage("states", 10, "rows"):
            clock.now += 1.9
            display.draw()
        assert stream.getvalue() == ""


def test_a_line_in_a_file(drawn):
    clock, shown = drawn
    with shown(io.StringIO()) as display, stage("states", 10, "rows") as step:
        step(4)
        clock.now += 12.0
        display.draw()
    assert display.stream.getvalue() == (
        "states, 4 of 10 rows, 12 s, about 18 s left\n"
    )


def test_a_bar_on_a_terminal(drawn, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    clock, shown = drawn
    with shown(Terminal()) as display, stage("states {0}", 10, "rows") as step:
        step(5)
        clock.now += 12.0
        display.draw()
        picture = last_picture(display.stream)
        assert picture.startswith("states {0}, 5 of 10 rows  |")
        assert picture.rstrip().endswith("| 12 s, about 12 s left")
        step(5)
        display.draw()
        assert "10 of 10 rows" in last_picture(display.stream)


def test_a_stage_without_a_count_has_no_bar(drawn):
    clock, shown = drawn
    with shown(Terminal()) as display, stage("explaining"):
        clock.now += 75.0
        display.draw()
        assert last_picture(display.stream).strip() == "explaining  1 min 15 s"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_what_follows_begins_on_a_clean_line(drawn, error):
    clock, shown = drawn
    with shown(Terminal()) as display, contextlib.suppress(error):
        with stage("search"):
            clock.now += 5.0
            display.draw()
            assert "search" in last_picture(display.stream)
            raise error
    assert last_picture(display.stream) == "\033[K"
    written = display.stream.getvalue()
    display.draw()
    assert display.stream.getvalue() == written


def test_a_stage_in_a_long_one_is_shown_at_once(drawn):
    clock, shown = drawn
    with shown(io.StringIO()) as display, stage("search"):
        clock.now += 60.0
        with stage("candidates", 3):
            display.draw()
    assert display.stream.getvalue() == "search: candidates, 0 of 3, 0 s\n"


def test_a_stream_that_nobody_reads_is_no_error(monkeypatch):
    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    monkeypatch.setattr(_progress, "_SILENT", 0.0)
    display = _progress._Display(_progress._Run(), Gone())
    display.run.begin(_progress._Stage(text="a", total=None, unit="", begun=0.0))
    turns = iter([False, False, True])
    monkeypatch.setattr(display._closed, "wait", lambda seconds: next(turns))
    display._go_on()
    assert next(turns, None) is None


def test_what_is_shown_is_shown_once(monkeypatch):
    monkeypatch.delenv("TQDM_DISABLE")
    opened = []
    monkeypatch.setattr(
        _progress,
        "_Display",
        lambda run, stream: opened.append(run) or contextlib.nullcontext(),
    )
    with telling(verbose=1), telling(verbose=1), telling(tell=print):
        pass
    assert len(opened) == 1
    with telling(verbose=0):
        pass
    assert len(opened) == 1


@pytest.mark.parametrize("value", ["1", ""])
def test_the_environment_silences(monkeypatch, value):
    monkeypatch.setenv("TQDM_DISABLE", value)
    before = threading.active_count()
    with telling(verbose=1):
        assert threading.active_count() == before + (value == "")
    assert threading.active_count() == before


# -- estimators ------------------------------------------------------------------------


def test_a_fit_tells_its_stages(simulated):
    told = []
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, verbose=1)
    robot.fit(simulated.q, simulated.tau, simulated.groups, progress=told.append)
    assert all(isinstance(one, Progress) for one in told)
    rows = simulated.n_samples
    ends = {one.stage: (one.done, one.total, one.unit) for one in told}
    assert ends["states"] == (rows, rows, "rows")
    done, total, unit = ends["equations"]
    assert done == total
    assert 0.9 * rows < total <= rows
    assert unit == "rows"
    silent = clone(robot).set_params(verbose=0)
    silent.fit(simulated.q, simulated.tau, simulated.groups)
    np.testing.assert_array_equal(silent.theta_, robot.theta_)


def test_a_function_may_end_a_fit(simulated):
    def stop(now):
        raise InterruptedError(now.stage)

    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt)
    with pytest.raises(InterruptedError, match="states"):
        robot.fit(simulated.q, simulated.tau, simulated.groups, progress=stop)


def test_a_loop_tells_its_stages(simulated):
    told = []
    robot = RobotIdentifier(simulated.urdf, dt=simulated.dt, friction=("viscous",))
    loop = EffectDiscovery(robot, effects=["spring"], ceiling=False)
    loop.fit(simulated.q, simulated.tau, simulated.groups, progress=told.append)
    stages = [one.stage.split(":")[0].split(",")[0] for one in told]
    assert list(dict.fromkeys(stages)) == [
        "channels",
        "declared model",
        "search",
        "held-out judgement",
        "final model",
        "explaining",
    ]
    assert "final model: states" in {one.stage for one in told}
