"""Signals and streams of the process: a run that is stopped ends in one line.

A signal ends a run like an exception, so that files are written completely or not at
all. Nothing is imported here but the standard library: it has to be in place before
what takes its time to import.
"""

import contextlib
import os
import signal
import sys
import threading

# Of these, SIGINT raises KeyboardInterrupt already; Windows has no SIGHUP.
_STOPS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
]


class Stopped(BaseException):
    """The process was asked to end by a signal, whose number is given."""

    def __init__(self, number):
        super().__init__(signal.Signals(number).name)
        self.number = int(number)


@contextlib.contextmanager
def _handlers(handle):
    """Handle all stop signals by a function; possible in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # A signal that is ignored, as under nohup, stays ignored.
    before = {
        number: signal.getsignal(number)
        for number in _STOPS
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    for number in before:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


# Signals that came since a run began.
_CAME = []


def _stop(number, frame):
    _CAME.append(number)
    raise Stopped(number)


def stopped_by():
    """Return the number of the signal that has stopped the run, or None."""
    # Compiled modules may turn the exception into an error of their own.
    return _CAME[0] if _CAME else None


def stoppable():
    """Let signals end a run like an exception, so that it tidies up."""
    _CAME.clear()
    return _handlers(_stop)


def ignore_stops():
    """Let a process that has done its work end in peace."""
    for number in _STOPS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def undisturbed():
    """Postpone signals until a few files are written."""
    waiting = []
    with _handlers(lambda number, frame: waiting.append(number)):
        yield
    if waiting:
        signal.raise_signal(waiting[0])


def open_streams():
    """Give the process the standard streams that it was started without."""
    # Otherwise the next file that is opened would take the place of one, and its
    # messages would go there.
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # The lowest number that is free, which is this one.
            os.open(os.devnull, os.O_RDWR)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
