"""Fits to more recordings than the memory of one machine holds, with Dask.

A fit needs only second moments, and those of disjoint rows add up: each worker reduces
the files that it reads to matrices whose size depends on the number of parameters
alone. Requires Dask (``pip install "sklearn-vbjfa[dask]"``).
"""

import contextvars
import functools
import warnings
from dataclasses import replace
from functools import partial
from os import PathLike, fspath

import numpy as np

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa._core._runtime import counted, one_blas_thread, show_progress
from sklearn_vbjfa.equations._checks import check_channels, check_length, check_widths
from sklearn_vbjfa.equations._equations import accumulate, build_segments
from sklearn_vbjfa.equations._joint_moments import BlockAssignment, sum_moments
from sklearn_vbjfa.equations._motion_facts import (
    MotionFacts,
    n_fastest,
    smooth_recording,
)
from sklearn_vbjfa.equations._plan import make_plan
from sklearn_vbjfa.equations._states import choose_states
from sklearn_vbjfa.fit._estimate import from_moments
from sklearn_vbjfa.recording import check_dt, expand, read_recording, recordings_in
from sklearn_vbjfa.recording._recording import take_arrays, with_torques_shifted

__all__ = ["fit_recordings"]
# Number of results that are in memory at the same time.
_BATCH_SIZE = 8
# Most rows and files in which channels are inspected.
_EXCERPT, _FILES = 50_000, 50


def fit_recordings(identifier, source):
    """Identify a robot from recordings in files, with Dask.

    The result is that of the identifier's `fit` on all recordings in memory, one group
    each, in the order of the files' names, up to rounding. Channels are inspected,
    and a lag of all torques is estimated, in an excerpt: at most 50,000 rows, the first
    ones of at most 50 files.

    Parameters
    ----------
    identifier : RobotIdentifier
        Identifier with `dt`; it is fitted in place.
    source : str, os.PathLike or sequence of those
        Folder with tables, bags and LeRobot data sets as `read_recording` reads them,
        or a list of these, under paths that the workers can read. Each holds one
        recording, or several if it has a column `segment`.

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
        if settings need more than second moments (effects, drives, other regressors).

    Notes
    -----
    The computation runs where Dask is configured to run: on the cluster of the current
    `distributed.Client`, otherwise in threads. The files are read once for each of six
    passes, and a process holds only those that it is working on.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.distributed import fit_recordings
    >>> part = load_demo_recording().select("motion_1")
    >>> robot = RobotIdentifier(part.urdf, dt=part.dt)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(pathlib.Path(folder) / "1.npz", q=part.q, tau=part.tau, dt=part.dt)
    ...     robot = fit_recordings(robot, folder)
    >>> bool((robot.min_eigenvalues_ > 0).all())
    True
    """
    _import_dask()
    paths = _paths(source)
    with show_progress():
        return _identify(identifier, paths)


def _identify(identifier, paths):
    """Fit an identifier to sums of second moments over files."""
    dt = check_dt(identifier.dt)
    identifier.build_model()
    extra = len(identifier.effects_) or identifier.drive is not None
    if extra or not from_moments(identifier.regressor):
        raise ValueError(
            "fit_recordings supports no effects, no drive, nor a regressor that needs "
            "rows: "
            "workers return second moments of bodies and friction; fit in memory."
        )
    names = identifier.joint_names_
    model = identifier.model
    urdf = fspath(model) if isinstance(model, (str, PathLike)) else None
    read = partial(_read, dt=dt, urdf=urdf, names=names)

    def reduce_files(label, function, *arguments, paths=paths):
        tasks = [(read, function, path, *arguments) for path in paths]
        return counted(_on_workers(tasks), label, len(tasks))

    by_file, torques, moving = zip(*reduce_files("lengths", _extent))
    lengths = [n for each in by_file for n in each]
    chosen = paths[:: -(-len(paths) // _FILES)]
    heads = reduce_files("channels", _head, _EXCERPT // len(chosen), paths=chosen)
    q, tau, labels = map(np.concatenate, zip(*heads))
    excerpt = take_arrays(q, tau, labels, dt=dt, joint_names=names)
    excerpt = replace(excerpt, group_names=tuple(dict.fromkeys(labels.tolist())))
    late, std = identifier.lag_from(excerpt, identifier.warned_lag(excerpt))
    read = partial(read, lag=sum(effect.lag for effect in late))
    longest = max(lengths)
    n_fft = _smoothing.fft_length(max(longest, _smoothing.MIN_SPECTRUM), dt)
    sums = [sum(x) for x in zip(*reduce_files("spectra", _spectra, dt, n_fft))]
    spectra = _smoothing.spectrum(*sums, n_fft, dt) if sums[-1] else None
    cutoff = identifier.fit_options.state_cutoff
    estimator = choose_states(dt, cutoff, longest, np.any(moving, axis=0), spectra)
    keep = n_fastest(sum(lengths))
    merge = partial(MotionFacts.merge, keep=keep)
    motion = functools.reduce(merge, reduce_files("speeds", _motion, estimator, keep))
    plan = make_plan(identifier, (), lengths, estimator, motion)
    parts = [slice(0, n) for n in lengths]
    check_length(parts, plan.lowpass, plan.cutoff, range(len(parts)))
    ranges = np.stack([motion.lowest, motion.highest])
    check_channels(names, ranges, np.concatenate(torques))
    first = np.cumsum([0, *map(len, by_file)]).tolist()
    blocks = BlockAssignment.of([plan.lowpass.centres(n).size for n in lengths])
    halves = identifier.input_noise is not None
    offsets = dict(zip(paths, first))
    sums = reduce_files(
        "equations", _moments, plan, identifier.features_, halves, blocks, offsets
    )
    moments = (x for x in sums if x is not None)

    def noise(robot):
        return [x for facts in reduce_files("noise", _noise, robot) for x in facts]

    identifier.fit_moments(plan, sum_moments(moments), noise)
    vars(identifier).update(vars(identifier.extended_by(late, std)))
    return identifier


def _on_workers(tasks):
    """Yield the results of tasks in order, computed by Dask."""
    dask = _import_dask()
    # Arguments are part of the task: if they were sent ahead of it, they would be lost
    # with the worker that holds them.
    task = dask.delayed(_reduce_file, pure=False, traverse=False)
    for start in range(0, len(tasks), _BATCH_SIZE):
        batch = [task(*arguments) for arguments in tasks[start : start + _BATCH_SIZE]]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sending large graph")
            yield from dask.compute(*batch, traverse=False)


def _paths(source):
    """Return the files of a folder or list, without duplicates."""
    if isinstance(source, (str, PathLike)):
        folder = expand(source)
        source = recordings_in(folder) if folder.is_dir() else ()
    paths = list(dict.fromkeys(map(str, source)))
    if not paths:
        raise FileNotFoundError(
            "source must be a folder that contains recordings, or a list of at least "
            "one file."
        )
    return paths


def _read(path, *, dt, urdf, names, lag=0.0):
    recording = read_recording(path, dt=dt, urdf=urdf)
    try:
        check_widths(names, recording.q, recording.tau)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return with_torques_shifted(recording, lag)


def _reduce_file(read, function, path, *arguments):
    """Read a file and reduce it, with one BLAS thread and without progress output."""
    with one_blas_thread():
        return contextvars.Context().run(lambda: function(read(path), path, *arguments))


def _extent(recording, path):
    parts, tau = recording.segments, recording.tau
    moving = np.any([np.ptp(recording.q[p], axis=0) > 0 for p in parts], axis=0)
    lengths = [part.stop - part.start for part in parts]
    return lengths, (tau.min(axis=0), tau.max(axis=0)), moving


def _head(recording, path, rows):
    """Return the first positions and torques of a file, and names of recordings."""
    several = len(recording.group_names) > 1
    names = np.array([path + f", {x}" * several for x in recording.group_names])
    return recording.q[:rows], recording.tau[:rows], names[recording.groups[:rows]]


def _spectra(recording, path, dt, n_fft):
    powers = [
        _smoothing.acceleration_power(recording.q[part], dt, n_fft)
        for part in recording.segments
    ]
    return tuple(map(sum, zip(*powers)))


def _motion(recording, path, estimator, keep):
    return smooth_recording(recording, estimator, False, keep, None)[1]


def _noise(recording, path, robot):
    return robot.noise_facts(recording)


def _moments(recording, path, plan, features, halves, blocks, offsets):
    states, _ = smooth_recording(recording, plan.state_estimator, halves, 1, None)
    segments = build_segments(recording, states, plan, features, first=offsets[path])
    return accumulate(segments, plan.lowpass, blocks=blocks)


def _import_dask():
    """Import Dask, or raise an error that says what to install."""
    try:
        import dask
    except ImportError as error:
        raise ImportError(
            'Fits on several machines need Dask: pip install "sklearn-vbjfa[dask]".'
        ) from error
    return dask
