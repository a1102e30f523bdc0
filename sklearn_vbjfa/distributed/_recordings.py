"""Identification of a robot from recordings in many files.

The passes are those of `RobotIdentifier.fit`, each of them a sum over recordings: their
lengths; the spectra, for the cut-offs; the speeds, for the standstill mask; the second
moments of the filtered equations; the noise of the torques. Every pass reads the files
again, so that no worker holds more than the recordings that it is working on.
"""

import operator
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path

import numpy as np

from sklearn_vbjfa._core import _lowpass, _smoothing
from sklearn_vbjfa.datasets import read_recording
from sklearn_vbjfa.distributed._merging import import_dask, merge_tree
from sklearn_vbjfa.recording._recording import check_dt, contiguous_groups
from sklearn_vbjfa.robot import _torque_noise
from sklearn_vbjfa.robot._equations import accumulate
from sklearn_vbjfa.robot._identifier import _CHUNK_BYTES, smooth_recording
from sklearn_vbjfa.robot._joint_moments import Numbering
from sklearn_vbjfa.robot._plan import (
    MotionFacts,
    check_channels,
    check_input_noise,
    check_length,
    check_widths,
    merge_all,
    n_fastest,
    resolve_cutoff,
    resolve_standstill,
)
from sklearn_vbjfa.robot._states import StateEstimator, lighter

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
    identifier._load_robot()
    _check_settings(identifier)
    urdf = identifier.model if isinstance(identifier.model, (str, PathLike)) else None
    load = partial(
        _load, dt=dt, urdf=urdf and fspath(urdf), names=identifier.joint_names_
    )

    def sums(function, merge, *arguments):
        """Run a pass over the files; its other arguments are sent once."""
        task = dask.delayed(function, pure=False)
        shared = [dask.delayed(x, traverse=False, pure=False) for x in arguments]
        return merge_tree(merge, [task(load, file, *shared) for file in files])

    (extent,) = dask.compute(sums(_measure, _merge_extents))
    longest = max(extent["lengths"])
    n_fft = _smoothing.fft_length(max(longest, _smoothing.MIN_SPECTRUM))
    (power,) = dask.compute(sums(_spectra, _add_pairs, dt, n_fft))
    identifier.n_features_in_ = identifier._nv
    estimator = StateEstimator(dt, cutoff=identifier.state_cutoff)
    estimator.n_features_in_ = identifier._nv
    spectra = _smoothing.spectrum(*power, n_fft, dt) if power[1] else None
    estimator._choose(longest, extent["moving"], spectra)
    identifier.state_estimator_ = estimator = lighter(estimator)
    stops = np.cumsum(extent["lengths"]).tolist()
    parts = [slice(a, b) for a, b in zip([0, *stops], stops)]
    identifier.cutoff_ = resolve_cutoff(identifier.cutoff, parts, dt, estimator)
    lowpass = _lowpass.design(dt, identifier.cutoff_)
    check_length(parts, lowpass, identifier.cutoff_)
    keep = n_fastest(stops[-1])
    merge = partial(MotionFacts.merge, keep=keep)
    (motion,) = dask.compute(sums(_summarise, merge, estimator, keep))
    ranges = np.stack([motion.lowest, motion.highest])
    check_channels(identifier.joint_names_, ranges, extent["torques"])
    identifier.standstill_ = resolve_standstill(identifier.standstill, motion.fast())
    identifier.torque_noise_ = _torque_noise.given_noise(
        identifier.torque_noise, identifier._nv, dt, identifier.cutoff_
    )
    numbering = Numbering.of([lowpass.centres(n).size for n in extent["lengths"]])
    numbers = _first_numbers(files, extent["recordings"])
    (stats,) = dask.compute(
        sums(_statistics, _add, identifier, lowpass, numbering, numbers)
    )
    identifier._fit_statistics(stats)
    if identifier.torque_noise is None:
        (noise,) = dask.compute(sums(_noise, operator.add, identifier))
        identifier._tell_noise(noise)
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
        "block_noise or regressor": not identifier._takes_statistics(),
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
    """Positions and torques of each recording in a file."""
    # A period passed to the reader would override the file's own, which is to agree.
    given = None if _has_period(file) else dt
    recording = read_recording(file, dt=given, urdf=urdf)
    if abs(recording.dt / dt - 1) > _DT_TOLERANCE:
        raise ValueError(
            f"{file} has a sample period of {recording.dt:.6g} s, the identifier "
            f"dt={dt:.6g} s. Resample it, or leave it out."
        )
    check_widths(names, recording.q, recording.tau)
    parts = contiguous_groups(recording.groups, recording.n_samples)
    return [(recording.q[part], recording.tau[part]) for part in parts]


def _has_period(file):
    if Path(file).suffix.lower() != ".npz":
        return False
    with np.load(file) as arrays:
        return "dt" in arrays.files


def _measure(load, file):
    """Lengths, range of torques, which joints move."""
    recordings = load(file)
    torques = [tau for _, tau in recordings]
    whole = np.concatenate(torques)
    return {
        "lengths": [len(tau) for tau in torques],
        "recordings": [len(torques)],
        "torques": np.stack([whole.min(axis=0), whole.max(axis=0)]),
        "moving": np.any([np.ptp(q, axis=0) > 0 for q, _ in recordings], axis=0),
    }


def _merge_extents(first, second):
    low, high = np.stack([first["torques"], second["torques"]], axis=1)
    return {
        "lengths": first["lengths"] + second["lengths"],
        "recordings": first["recordings"] + second["recordings"],
        "torques": np.stack([low.min(axis=0), high.max(axis=0)]),
        "moving": first["moving"] | second["moving"],
    }


def _spectra(load, file, dt, n_fft):
    powers = [_smoothing.acceleration_power(q, dt, n_fft) for q, _ in load(file)]
    power, energy = zip(*powers)
    return sum(power), sum(energy)


def _add_pairs(first, second):
    return first[0] + second[0], first[1] + second[1]


def _summarise(load, file, estimator, keep):
    """Motion of the recordings of one file."""
    facts = [
        smooth_recording(q, 0, estimator, keep, halves=False)[2] for q, _ in load(file)
    ]
    return merge_all(facts, keep)


def _noise(load, file, identifier):
    """Noise of the torques of one file's recordings, a list."""
    found = []
    for q, tau in load(file):
        rows = _torque_noise.rows_looked_at(slice(0, len(q)))
        found.append(identifier._noise_facts(q[rows], tau[rows]))
    return found


def _first_numbers(files, counts):
    """Return file -> number of its first recording."""
    return dict(zip(files, np.cumsum([0, *counts[:-1]]).tolist()))


def _statistics(load, file, identifier, lowpass, numbering, numbers):
    """Second moments of the filtered equations of one file; None if it has none."""
    recordings = load(file)
    halves = identifier.input_noise is not None
    made = [
        smooth_recording(q, 0, identifier.state_estimator_, 1, halves=halves)
        for q, _ in recordings
    ]
    states, both, _ = map(list, zip(*made))
    stops = np.cumsum([len(q) for q, _ in recordings]).tolist()
    parts = [slice(a, b) for a, b in zip([0, *stops], stops)]
    torque = np.concatenate([tau for _, tau in recordings])
    stretches = identifier._stretches(
        states,
        torque,
        np.ones(torque.shape),
        parts,
        tuple(map(list, zip(*both))) if halves else None,
    )
    stretches = [
        replace(stretch, number=numbers[file] + stretch.number) for stretch in stretches
    ]
    return accumulate(stretches, lowpass, chunk_bytes=_CHUNK_BYTES, numbering=numbering)


def _add(first, second):
    if first is None or second is None:
        return second if first is None else first
    return operator.add(first, second)
