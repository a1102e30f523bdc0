"""Files of one robot as one recording: what must agree, copies, names, time grid."""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median_low

import numpy as np

from sklearn_vbjfa.recording._files import expanded
from sklearn_vbjfa.recording._quoting import listed
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._resample import distinct, on_one_grid
from sklearn_vbjfa.recording._table import Loss

# Relative difference between the periods of two files that is refused: accelerations
# go with its square.
_DT_TOLERANCE = 0.01
# Files of which a note is told that are named; more are counted.
_NAMED = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedFile:
    """A file as it was read, with what its recording no longer tells."""

    path: Path  # as messages name it
    recording: Recording  # what it holds
    notes: tuple[str, ...]  # what a user should know of it
    stamped: bool  # whether it has time stamps
    torque_units: tuple[str, ...]  # before they were multiplied by gains


def without_repeats(paths):
    """Return each file's first path, and (path, first path) of those given again."""
    first, again = {}, []
    for path in map(Path, paths):
        try:
            found = expanded(path).stat()
            key = found.st_dev, found.st_ino
        except OSError:
            # Standard input, or what the reader will refuse.
            key = str(path)
        if key in first:
            again.append((path, first[key]))
        first.setdefault(key, path)
    return list(first.values()), again


def common_folder(paths):
    """Return the name of the folder that holds all files, "" if there is none."""
    folders = {expanded(path).parent.resolve() for path in paths}
    return folders.pop().name if len(folders) == 1 else ""


def concatenate(files, again=(), name=None):
    """Return the recording of all files, and what to say of it."""
    # again: (path, first path) of files that were given twice and read once.
    _check_agreement(files)
    files, copies = _without_copies(files)
    copies = [*again, *copies]
    notes = [_said_of_copies(copies)] if copies else []
    notes += said(files)
    common, left_out, missing = _signals(files)
    if missing:
        notes.append(
            f"column(s) {listed(missing)} are not in all files and are left out."
        )
    recordings = [
        replace(x.recording, signals={key: x.recording.signals[key] for key in common})
        for x in files
    ]
    dt = median_low([x.dt for x in recordings])
    fields, moved = on_one_grid(recordings, _group_names(files), dt)
    if moved:
        paths = [files[k].path for k in moved]
        notes.append(
            f"{_named(paths)}: interpolated to the sample period of the others, "
            f"{dt:.6g} s."
        )
    first = recordings[0]
    whole = replace(
        first,
        name=name or common_folder([x.path for x in files]) or first.name,
        left_out=left_out,
        description=f"Read from {listed([x.path.name for x in files])}.",
        **fields,
    )
    return whole, notes


def said(files):
    """Return the notes of files with their paths before them, equal ones in one."""
    paths = {}
    for file in files:
        for note in file.notes:
            paths.setdefault((type(note), str(note)), {})[str(file.path)] = None
    return [kind(f"{_named(of)}: {note}") for (kind, note), of in paths.items()]


def _named(paths):
    """Name files; of many the first."""
    shown = [str(path) for path in paths][:_NAMED]
    more = len(paths) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")


# -- what must agree -------------------------------------------------------------------


def _check_agreement(files):
    """Refuse files that cannot be of one robot, or were not recorded alike."""
    first = files[0]
    for other in files[1:]:
        for one, two in zip(_traits(first), _traits(other)):
            if one != two:
                raise ValueError(
                    f"{first.path} has {one} and {other.path} has {two}; expected "
                    "files with the same joints and channels: mend one of them, or "
                    "take them one by one."
                )
    fast = min(files, key=lambda x: x.recording.dt)
    slow = max(files, key=lambda x: x.recording.dt)
    if slow.recording.dt > (1 + _DT_TOLERANCE) * fast.recording.dt:
        raise ValueError(
            f"{fast.path} has a sample period of {fast.recording.dt:.6g} s and "
            f"{slow.path} one of {slow.recording.dt:.6g} s; expected periods that "
            f"differ by {100 * _DT_TOLERANCE:g} % at most: resample one of the files, "
            "or take them one by one."
        )


def _traits(file):
    """Yield what must be the same in all files, in words."""
    recording = file.recording
    yield f"the joints {listed(recording.joint_names)}"
    yield f"positions in {_units(recording.position_units)}"
    yield f"torques in {_units(file.torque_units)}"
    for what, there in (
        ("velocities", recording.v is not None),
        ("accelerations", "a" in recording.signals),
        ("time stamps", file.stamped),
    ):
        yield what if there else f"no {what}"


def _units(units):
    return listed(units[:1] if len(set(units)) == 1 else units)


# -- copies ----------------------------------------------------------------------------


def _without_copies(files):
    """Return files whose motion is in none before, and (path, of which) of copies."""
    kept, copies = [], []
    for file in files:
        of = next((x for x in kept if _is_copy(x.recording, file.recording)), None)
        if of is None:
            kept.append(file)
        else:
            copies.append((file.path, of.path))
    return kept, copies


def _is_copy(one, other):
    return np.array_equal(one.q, other.q) and np.array_equal(one.tau, other.tau)


def _said_of_copies(copies):
    """Name all copies, in one line."""
    of = {}
    for path, first in copies:
        of.setdefault(str(first), {})[str(path)] = None
    parts = []
    for first, found in of.items():
        others = [path for path in found if path != first]
        if len(others) < len(found):
            parts.append(f"{first} is given more than once")
        if others:
            names = " and ".join(filter(None, [", ".join(others[:-1]), others[-1]]))
            are = "is a copy" if len(others) == 1 else "are copies"
            parts.append(f"{names} {are} of {first}")
    return Loss(f"{'; '.join(parts)}: {'each ' * (len(of) > 1)}taken once.")


# -- names and signals -----------------------------------------------------------------


def _group_names(files):
    """Call recordings after their files, and their own names where there are more."""
    stems = Counter(x.recording.name for x in files)
    names = []
    for file in files:
        stem = file.recording.name
        label = stem if stems[stem] == 1 else str(file.path)
        own = file.recording.group_names
        # What a file calls "recording" has no name of its own.
        suffixes = [x.removeprefix("recording").strip() for x in own]
        names += (
            [label] if len(own) == 1 else [f"{label} {x}".strip() for x in suffixes]
        )
    return distinct(names)


def _signals(files):
    """Return names of the signals in all files, and what is wrong with the others."""
    # The third are the names of those that are missing somewhere.
    left_out, missing = {}, []
    for file in files:
        for key, reason in file.recording.left_out.items():
            left_out.setdefault(key, f"{reason} ({file.path})")
    names = dict.fromkeys(key for x in files for key in x.recording.signals)
    for key in [key for key in names if key not in left_out]:
        without = [x.path for x in files if key not in x.recording.signals]
        if without:
            missing.append(key)
            left_out[key] = f"is missing in {_named(without)}"
    return [key for key in names if key not in left_out], left_out, missing
