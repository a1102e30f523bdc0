"""What a long run is at: stages under way, shown or told to a function.

Inner code says ``with stage("states", n, "rows") as step``, calls ``step(count)`` or
``say("round 2")``, and knows of nobody that listens. A context variable holds who does,
so that no function needs a parameter for it. Threads that a stage starts have contexts
of their own: they are silent, and what started them counts for them.
"""

import contextlib
import contextvars
import functools
import os
import sys
import threading
import time
from dataclasses import dataclass, field, replace

# A stage that lasts less is not shown [s].
_SILENT = 2.0
# Between two pictures on a terminal, and two lines in a file [s].
_PICTURES, _LINES = 0.25, 10.0
# Characters of a bar.
_WIDTH = 20

_RUN = contextvars.ContextVar("sklearn_vbjfa_run", default=None)


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What a long fit is at, as the function gets it that is given as ``progress``.

    Attributes
    ----------
    stage : str
        What is done, such as "final model: states".
    done : int
        How much of it is, in `unit`.
    total : int or None
        How much there is; None if that is not known.
    unit : str
        What is counted, such as "rows".
    seconds : float
        Since the stage began [s].
    remaining : float or None
        Until it ends if it goes on as before [s]; None if that is not known.
    at_most : bool
        Whether `total` is a bound, which a stage may end before.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> recording = load_demo_recording().select(0)
    >>> stages = []
    >>> robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    >>> robot = robot.fit(
    ...     recording.q, recording.tau, progress=lambda now: stages.append(now.stage)
    ... )
    >>> list(dict.fromkeys(stages))
    ['states', 'equations', 'consistent bodies']
    """

    stage: str
    done: int = 0
    total: int | None = None
    unit: str = ""
    seconds: float = 0.0
    remaining: float | None = None
    at_most: bool = False

    def __str__(self):
        return f"{self.told}, {self.times}"

    @property
    def told(self):
        """The stage and how much of it is done, a text."""
        if self.total is None:
            return self.stage
        total = f"{'at most ' * self.at_most}{self.total:,} {self.unit}"
        return f"{self.stage}, {self.done:,} of {total}".rstrip()

    @property
    def times(self):
        """Time since the stage began and what is left, a text."""
        text = _duration(self.seconds)
        if self.remaining is None:
            return text
        about = "at most" if self.at_most else "about"
        return f"{text}, {about} {_duration(self.remaining)} left"


def _duration(seconds):
    """Return seconds as a text."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


# -- stages ----------------------------------------------------------------------------


@contextlib.contextmanager
def stage(text, total=None, unit="", *, at_most=False):
    """Name what is done within a ``with``, of `total` units; yields ``step(count)``."""
    # at_most: whether it may end before.
    run = _RUN.get()
    if run is None:
        yield _unheard
        return
    # A single one is not counted.
    total = None if total == 1 else total
    begun = run.clock()
    own = run.begin(
        _Stage(text=text, total=total, unit=unit, begun=begun, at_most=at_most)
    )
    try:
        yield functools.partial(run.step, own)
    finally:
        run.end(own)


def counted(items, text, unit="", sizes=None):
    """Yield items, as a stage of its own that counts them, or their sizes."""
    sizes = len(items) * [1] if sizes is None else sizes
    with stage(text, sum(sizes), unit) as step:
        for one, size in zip(items, sizes):
            yield one
            step(size)


def say(note):
    """Say more of the innermost stage: what of it is done now."""
    run = _RUN.get()
    if run is not None:
        run.say(note)


def _unheard(count=1):
    """Do what a step does if nobody listens: nothing."""


@contextlib.contextmanager
def telling(verbose=0, tell=None):
    """Within a ``with``, show stages on stderr if `verbose`, or tell a function."""
    # What is shown already is not shown twice.
    outer = _RUN.get()
    if tell is not None and not callable(tell):
        raise TypeError(
            "progress must be a function, which is called with a Progress, or None; "
            f"got {tell!r}."
        )
    if not (verbose or tell):
        yield
        return
    # Further listeners of the same stages.
    run = _Run() if outer is None else replace(outer)
    if tell is not None:
        run.listeners = (*run.listeners, tell)
    silenced = os.environ.get("TQDM_DISABLE", "") not in ("", "0")
    shows = verbose and not run.shown and not silenced
    run.shown = run.shown or bool(verbose)
    token = _RUN.set(run)
    try:
        with _Display(run, sys.stderr) if shows else contextlib.nullcontext():
            yield
    finally:
        _RUN.reset(token)


@dataclass(eq=False)
class _Stage:
    """A stage under way."""

    text: str
    total: int | None
    unit: str
    begun: float  # on the clock of the run
    at_most: bool = False
    done: int = 0
    note: str = ""


@dataclass(eq=False)
class _Run:
    """Stages under way, the outermost first, and who is told of them."""

    clock: object = time.monotonic
    listeners: tuple = ()
    shown: bool = False
    stages: list = field(default_factory=list)
    # Steps may come from several threads.
    lock: object = field(default_factory=threading.RLock)
    # What is shown between stages goes.
    displays: list = field(default_factory=list)

    def begin(self, own):
        """Begin a stage within those under way."""
        with self.lock:
            self.stages.append(own)
        self._tell()
        return own

    def step(self, own, count=1):
        """Count what is done of a stage."""
        with self.lock:
            own.done += count
        self._tell()

    def say(self, note):
        """Note what is done of the innermost stage."""
        with self.lock:
            if not self.stages:
                return
            self.stages[-1].note = note
        self._tell()

    def end(self, own):
        """End a stage."""
        with self.lock:
            self.stages.remove(own)
            idle = not self.stages
        for display in self.displays if idle else ():
            display.clear()

    def _tell(self):
        for tell in self.listeners:
            tell(self.now())

    def lasted(self):
        """Return for how long the outermost stage has been under way [s]."""
        with self.lock:
            return self.clock() - self.stages[0].begun if self.stages else 0.0

    def now(self):
        """Return the `Progress` of what is under way, None if nothing is."""
        with self.lock:
            if not self.stages:
                return None
            # What counts and holds the others says best how much is left.
            counting = (one for one in self.stages if one.total is not None)
            one, remaining = next(counting, self.stages[-1]), None
            seconds = self.clock() - one.begun
            if one.total is not None and 0 < one.done <= one.total:
                remaining = seconds * (one.total - one.done) / one.done
            return Progress(
                stage=": ".join(
                    ", ".join(filter(None, [x.text, x.note])) for x in self.stages
                ),
                done=one.done,
                total=one.total,
                unit=one.unit,
                seconds=seconds,
                remaining=remaining,
                at_most=one.at_most,
            )


# -- what is shown ---------------------------------------------------------------------


class _Display:
    """A bar on a terminal, a line now and then in a file; drawn by a thread."""

    # A stage need not step to be shown, and steps cost nothing.

    def __init__(self, run, stream):
        self.run, self.stream = run, stream
        self._bar, self._closed, self._lock = None, threading.Event(), threading.RLock()
        self.terminal = stream is not None and stream.isatty()
        run.displays.append(self)

    def __enter__(self):
        if self.stream is not None:
            self._thread = threading.Thread(target=self._go_on, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *error):
        self._closed.set()
        if self.stream is not None:
            self._thread.join()
        self.clear()

    def _go_on(self):
        while not self._closed.wait(_PICTURES if self.terminal else _LINES):
            # What nobody can read is no error of its own.
            with contextlib.suppress(OSError, ValueError):
                self.draw()

    def draw(self):
        """Show what is under way, if it has lasted a while."""
        with self._lock:
            now = self.run.now()
            if now is None or self.run.lasted() < _SILENT:
                self.clear()
            elif self.terminal:
                self._draw_bar(now)
            else:
                print(now, file=self.stream, flush=True)

    def _draw_bar(self, now):
        from tqdm import tqdm

        bar, told = f"|{{bar:{_WIDTH}}}| " if now.total else "", _literally(now.told)
        form = f"{told}  {bar}{now.times}"
        if self._bar is None:
            self._bar = tqdm(
                file=self.stream,
                disable=False,
                leave=False,
                dynamic_ncols=True,
                bar_format=form,
                total=now.total,
                initial=now.done,
            )
        self._bar.bar_format, self._bar.total = form, now.total
        self._bar.n = now.done
        self._bar.refresh()

    def clear(self):
        """Take away from a terminal what was drawn."""
        with self._lock, contextlib.suppress(OSError, ValueError):
            bar, self._bar = self._bar, None
            if bar is not None:
                bar.close()
                # What the terminal echoed behind it, such as ^C.
                print("\r\033[K", end="", file=self.stream, flush=True)


def _literally(text):
    """Return a text as a format that stands for it."""
    return text.replace("{", "{{").replace("}", "}}")
