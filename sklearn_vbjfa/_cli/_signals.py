"""What a run does when it is told to stop."""

import contextlib
import signal
import threading

# Of these, SIGINT raises KeyboardInterrupt already; Windows has no SIGHUP.
_STOPS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
]


class Stopped(BaseException):
    """The process was told to end.

    Parameters
    ----------
    number : int
        Signal.
    """

    def __init__(self, number):
        super().__init__(signal.Signals(number).name)
        self.number = int(number)


@contextlib.contextmanager
def _handlers(handle):
    """Let a function answer all signals to stop; other threads have no say."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # A signal that is ignored, as under nohup, stays so.
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


def _stop(number, frame):
    raise Stopped(number)


def stoppable():
    """Let signals end a run as an exception does, so that it tidies up."""
    return _handlers(_stop)


@contextlib.contextmanager
def undisturbed():
    """Put off signals until a few files are written."""
    waiting = []
    with _handlers(lambda number, frame: waiting.append(number)):
        yield
    if waiting:
        signal.raise_signal(waiting[0])
