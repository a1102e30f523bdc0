"""Identification of a robot from recordings in many files.

The passes are those of `RobotIdentifier.fit`, each a sum over recordings: their
lengths; the spectra, for the cut-offs; the speeds, for the standstill mask; the second
moments of the filtered equations; the noise of the torques. Every pass reads the files
again, so that no worker holds more than the recordings that it is working on.
"""

import operator
from functools import partial
from os import PathLike, fspath
from pathlib import Path

import numpy as np

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa.distributed._merging import import_dask, merge_tree
from sklearn_vbjfa.recording import check_dt, levels, read_recording
from sklearn_vbjfa.robot._equations import accumulate, segments
from sklearn_vbjfa.robot._identifier import conclude, declare, noise_of, tell_noise
from sklearn_vbjfa.robot._joint_moments import Numbering
from sklearn_vbjfa.robot._plan import (
    MotionFacts,
    make_plan,
    n_fastest,
    smooth,
    takes_moments,
)
from sklearn_vbjfa.robot._recording_checks import (
    check_channels,
    check_input_noise,
    check_length,
    check_widths,
)
from sklearn_vbjfa.robot._states import choose_states

_SUFFIXES = (".csv", ".npz", ".parquet", ".txt")
# Sample periods that differ by more than this share are not the same.
_DT_TOLERANCE = 0.002


def fit_recordings(identifier, source):
    """Identify a robot from recordings in files, with Dask.

    The result is that of `RobotIdentifier.fit` on all recordings in memory, one group
    each, in the order of the files' names, up to rounding.

    Parameters
    ----------
    identifier : RobotIdentifier
        Identifier with `dt`; it is fitted in place.
    source : str, os.PathLike or sequence of those
        Folder with CSV, npz or parquet files as `read_recording` reads them, or a list
        of files, under paths that the workers can read. Each file holds one recording,
        or several if it has a column `segment`.

    Returns
    -------
    identifier : RobotIdentifier
        The fitted identifier.

    Raises
    ------
    ImportError
        If Dask is not installed.
    FileNotFoundError
        If the folder holds no recording.
    ValueError
        If a file cannot be read or has another sample period or number of joints, or
        if settings need more than second moments (effects, `period`, `block_noise`,
        other regressors).

    Notes
    -----
    The computation runs where Dask is configured to: on the cluster of the current
    `distributed.Client`, otherwise in threads. A task returns its own sums and changes
    nothing else, so that one lost with its worker is run again and counts once.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.distributed import fit_recordings
    >>> recording = load_demo_recording()
    >>> robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in recording.group_names:
    ...         part = recording.select(name)
    ...         file = pathlib.Path(folder) / f"{part.groups[0]}-{name}.npz"
    ...         np.savez(file, q=part.q, tau=part.tau, dt=part.dt)
    ...     robot = fit_recordings(robot, folder)
    >>> bool((robot.min_eigenvalues_ > 0).all())
    True
    """
    dask = import_dask()
    files = _files(source)
    dt = check_dt(identifier.dt)
    check_input_noise(identifier.input_noise)
    declare(identifier)
    _check_settings(identifier)
    urdf = identifier.model if isinstance(identifier.model, (str, PathLike)) else None
    names, nv = identifier.joint_names_, len(identifier.joint_names_)
    load = partial(_load, dt=dt, urdf=urdf and fspath(urdf), names=names)

    def sums(function, merge, *arguments):
        """Run a pass over the files; its other arguments are sent once."""
        task = dask.delayed(function, pure=False)
        shared = [dask.delayed(x, traverse=False, pure=False) for x in arguments]
        (total,) = dask.compute(
            merge_tree(merge, [task(load, file, *shared) for file in files])
        )
        return total

    extent = sums(_measure, _merge_extents)
    longest = max(extent["lengths"])
    n_fft = _smoothing.fft_length(max(longest, _smoothing.MIN_SPECTRUM), dt)
    power = sums(_spectra, _add_pairs, dt, n_fft)
    spectra = _smoothing.spectrum(*power, n_fft, dt) if power[1] else None
    estimator = choose_states(
        dt, identifier.state_cutoff, longest, extent["moving"], spectra
    )
    keep = n_fastest(sum(extent["lengths"]))
    merge = partial(MotionFacts.merge, keep=keep)
    motion = sums(_summarise, merge, estimator, keep)
    plan = make_plan(identifier, (), extent["lengths"], estimator, motion)
    stops = np.cumsum(extent["lengths"]).tolist()
    parts = [slice(a, b) for a, b in zip([0, *stops], stops)]
    check_length(parts, plan.lowpass, plan.cutoff)
    ranges = np.stack([motion.lowest, motion.highest])
    check_channels(names, ranges, extent["torques"], sum(extent["lengths"]))
    numbering = Numbering.of([plan.lowpass.centres(n).size for n in extent["lengths"]])
    numbers = _first_numbers(files, extent["recordings"])
    halves = identifier.input_noise is not None
    moments = sums(
        _moments, _add, plan, identifier.features_, halves, numbering, numbers
    )
    identifier.n_features_in_ = nv
    conclude(identifier, plan, moments)
    if identifier.torque_noise is None:
        tell_noise(identifier, sums(_noise, operator.add, identifier))
    return identifier


def _files(source):
    """Return the paths of the files, sorted if a folder is given."""
    if isinstance(source, (str, PathLike)):
        folder = Path(source)
        if not folder.is_dir():
            raise FileNotFoundError(
                f"source must be a folder or a list of files; {folder} is no folder."
            )
        files = sorted(p for p in folder.iterdir() if p.suffix.lower() in _SUFFIXES)
        if not files:
            raise FileNotFoundError(
                f"No recording in {folder}; expected files {', '.join(_SUFFIXES)}."
            )
    else:
        files = [Path(p) for p in source]
        if not files:
            raise ValueError("source must name at least one file; got none.")
    return [str(p) for p in files]


def _check_settings(identifier):
    asked = {
        "effects": len(identifier.effects_) > 0,
        "period": identifier.period is not None,
        "block_noise or regressor": not takes_moments(
            identifier.regressor, identifier.block_noise
        ),
    }
    refused = [name for name, is_asked in asked.items() if is_asked]
    if refused:
        raise ValueError(
            f"fit_recordings cannot do with {', '.join(refused)}: the workers return "
            "second moments of the rigid bodies and their friction only. Use "
            "effects=(), period=None, block_noise=False and a VBJFARegressor or "
            "JFARegressor, or fit in memory."
        )


# -- what a worker does with one file --------------------------------------------------


def _load(file, *, dt, urdf, names):
    """Read the `Recording` in a file."""
    # A period passed to the reader would override the file's own, which is to agree.
    given = None if _has_period(file) else dt
    recording = read_recording(file, dt=given, urdf=urdf)
    if abs(recording.dt / dt - 1) > _DT_TOLERANCE:
        raise ValueError(
            f"{file} has a sample period of {recording.dt:.6g} s, the identifier "
            f"dt={dt:.6g} s. Resample it, or leave it out."
        )
    check_widths(names, recording.q, recording.tau)
    return recording


def _has_period(file):
    if Path(file).suffix.lower() != ".npz":
        return False
    with np.load(file) as arrays:
        return "dt" in arrays.files


def _measure(load, file):
    """Lengths, levels of torques, which joints move."""
    recording = load(file)
    parts, tau = recording.segments, recording.tau
    return {
        "lengths": [part.stop - part.start for part in parts],
        "recordings": [len(parts)],
        "torques": levels(tau),
        "moving": np.any([np.ptp(recording.q[p], axis=0) > 0 for p in parts], axis=0),
    }


def _merge_extents(first, second):
    return {
        "lengths": first["lengths"] + second["lengths"],
        "recordings": first["recordings"] + second["recordings"],
        "torques": levels(np.concatenate([first["torques"], second["torques"]])),
        "moving": first["moving"] | second["moving"],
    }


def _spectra(load, file, dt, n_fft):
    recording = load(file)
    powers = [
        _smoothing.acceleration_power(recording.q[part], dt, n_fft)
        for part in recording.segments
    ]
    power, energy = zip(*powers)
    return sum(power), sum(energy)


def _add_pairs(first, second):
    return first[0] + second[0], first[1] + second[1]


def _summarise(load, file, estimator, keep):
    """Motion of the recordings of one file."""
    return smooth(load(file), estimator, False, keep, None)[1]


def _noise(load, file, identifier):
    """Noise of the torques of one file's recordings, a list."""
    recording = load(file)
    return noise_of(identifier, recording.q, recording.tau, recording.segments)


def _first_numbers(files, counts):
    """Return file -> number of its first recording."""
    return dict(zip(files, np.cumsum([0, *counts[:-1]]).tolist()))


def _moments(load, file, plan, features, halves, numbering, numbers):
    """Second moments of the filtered equations of one file; None if it has none."""
    recording = load(file)
    states, _ = smooth(recording, plan.state_estimator, halves, 1, None)
    made = segments(recording, states, plan, features, first=numbers[file])
    return accumulate(made, plan.lowpass, numbering=numbering)


def _add(first, second):
    if first is None or second is None:
        return second if first is None else first
    return operator.add(first, second)
