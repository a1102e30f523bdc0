"""What a user gives to the command line, refused in one line where it is wrong.

What a run does when it is told to stop.
"""

import contextlib
import math
import os
import signal
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

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


# Fewer samples in a row show nothing.
_MIN_SAMPLES = 64


def robot(urdf, joints, folder):
    """Check a description, hold at zero the joints that were not recorded.

    Parameters
    ----------
    urdf : Path
        Description; one that cannot be read, or whose inertias would be lost, is
        refused.
    joints : tuple of str
        Joints that were recorded; none for all.
    folder : Path
        Where a description of the robot with the other joints held is written.

    Returns
    -------
    urdf : Path
        Description in which only the recorded joints move.
    held : tuple of str
        The other joints.
    """
    from sklearn_vbjfa.model import _loading

    if not urdf.is_file():
        raise FileNotFoundError(f"{urdf}: no such robot description; give --urdf FILE.")
    said = []
    try:
        with _parser_messages(said):
            if joints:
                _loading.load_reduced(urdf, joints)
            else:
                _loading.load_model(urdf)
    except ValueError as error:
        where = "" if repr(str(urdf)) in str(error) else f"{urdf}: "
        reason = f" ({said[0]})" if said else ""
        raise ValueError(f"{where}{error}{reason}") from error
    # The parser goes on without an inertia that it cannot read.
    lost = [line for line in said if "nerti" in line]
    if lost:
        raise ValueError(f"{urdf}: {'; '.join(lost)}; correct the description.")
    if not joints:
        return urdf, ()
    reduced = folder / urdf.name
    held = _loading.write_reduced(urdf, reduced, joints)
    # What is written from this copy is as readable as the original.
    reduced.chmod(urdf.stat().st_mode & 0o666)
    return reduced, held


def joint_names(text):
    """Return the names in a list with commas, none for None."""
    if text is None:
        return ()
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise ValueError(
            f"--joints has an empty name in {text!r}; expected names of the URDF's "
            "joints with commas between them, in the order of the columns."
        )
    _refuse_twice("--joints", found)
    return found


@contextlib.contextmanager
def _parser_messages(said):
    """Collect what the URDF parser, which is no Python, writes to stderr."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        stderr = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            file.seek(0)
            text = file.read().decode("utf-8", "replace")
            lines = [" ".join(line.split()) for line in text.splitlines()]
            errors = [x[len("Error: ") :] for x in lines if x.startswith("Error: ")]
            said += dict.fromkeys(errors)


def read(source, dt, urdf, joints):
    """Read a recording that is long enough."""
    from sklearn_vbjfa.datasets import read_recording

    recording = read_recording(
        source, dt=dt, urdf=str(urdf), joint_names=joints or None
    )
    longest = int(np.bincount(recording.groups).max())
    if longest < _MIN_SAMPLES:
        raise ValueError(
            f"{source}: the longest recording has {longest} samples in a row "
            f"({longest * recording.dt:.3g} s), too few; record some tens of seconds "
            "of motion."
        )
    if not np.ptp(recording.q, axis=0).any():
        raise ValueError(
            f"{source}: no joint moves in any row; expected a motion. Check the "
            "columns of positions."
        )
    return recording


def check_folder(out):
    """Refuse a folder that cannot be made, before the work is done."""
    for folder in (out, *out.parents):
        if folder.exists():
            if not folder.is_dir():
                raise ValueError(f"{folder} is a file; --out must name a folder.")
            if not os.access(folder, os.W_OK):
                raise ValueError(f"{folder} cannot be written to; give another --out.")
            return


def names(option, text, known):
    """Return the names in a list with commas; "none" is none of them."""
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if found == ("none",):
        return ()
    unknown = [name for name in found if name not in known]
    if unknown or not found:
        raise ValueError(
            f"{option} does not know {unknown[0] if unknown else text!r}; expected "
            f"names with commas between them, of {', '.join(known)}."
        )
    _refuse_twice(option, found)
    return found


def _refuse_twice(option, found):
    twice = [name for k, name in enumerate(found) if name in found[:k]]
    if twice:
        raise ValueError(f"{option} has {twice[0]} twice; name it once.")


def cutoff(text):
    """Return the cutoff frequency [Hz], "auto", or None for no low-pass."""
    if text in ("auto", "none"):
        return None if text == "none" else text
    try:
        frequency = float(text)
    except ValueError:
        frequency = math.nan
    if not 0 < frequency < math.inf:
        raise ValueError(
            f"--cutoff must be a positive frequency in Hz, auto or none; got {text}."
        )
    return frequency


def check_nyquist(frequency, recording, source):
    """Refuse a cutoff that the sample period has no room for."""
    highest = 0.5 / recording.dt
    if isinstance(frequency, float) and frequency >= highest:
        raise ValueError(
            f"--cutoff must be below {highest:.4g} Hz, half the sample rate of "
            f"{source}; got {frequency:g}."
        )


def seed(number):
    """Return a seed that numpy takes."""
    if not 0 <= number < 2**32:
        raise ValueError(f"--seed must be from 0 to 2**32 - 1; got {number}.")
    return number


def default_folder(source):
    """Folder for the files if none is named."""
    return Path(f"{source.stem or 'recording'}-report")
