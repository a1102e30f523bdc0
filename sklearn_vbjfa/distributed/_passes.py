"""Fits to Dask arrays and to recordings in many files: sums that workers make.

The passes over files are those of `RobotIdentifier.fit`, each a sum over recordings:
their lengths; the spectra, for the cut-offs; the speeds, for the standstill mask; the
second moments of the filtered equations; the noise of the torques. Every pass reads the
files again, so that no worker holds more than the recordings that it is working on.
"""

import contextvars
import functools
import hashlib
import operator
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from os import PathLike, fspath

import numpy as np
from sklearn.utils.validation import check_array

from sklearn_vbjfa._core import _smoothing
from sklearn_vbjfa._core._moments import from_data
from sklearn_vbjfa._core._progress import counted, show_progress
from sklearn_vbjfa.diagnosis import EffectDiscovery
from sklearn_vbjfa.model import DoubtWarning, joint_names, load_model
from sklearn_vbjfa.physical import one_blas_thread
from sklearn_vbjfa.recording import (
    OfferedSignals,
    as_one,
    check_dt,
    check_on_bad_files,
    expanded,
    levels,
    read_recording,
    recordings_in,
    said_of_bad,
    said_of_copies,
    without_repeats,
)
from sklearn_vbjfa.regression import (
    BaseJointFactorRegressor,
    check_sample_weight,
    fit_moments,
)
from sklearn_vbjfa.robot._equations import accumulate, segments
from sklearn_vbjfa.robot._estimate import from_moments
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._joint_moments import Numbering
from sklearn_vbjfa.robot._parallel import run_elsewhere
from sklearn_vbjfa.robot._plan import (
    MotionFacts,
    make_plan,
    n_fastest,
    smooth,
)
from sklearn_vbjfa.robot._recording_checks import (
    check_channels,
    check_input_noise,
    check_length,
    check_widths,
)
from sklearn_vbjfa.robot._states import choose_states

# How long [s] a scheduler may take to answer.
_ANSWERS = 10
_MISSING = "Fits on several machines need Dask: pip install 'dask[array]' distributed."
# Results that come back together: of many tasks to tell of each.
_AT_ONCE = 8
# Results that are merged in one task: few enough to be in memory together.
_FAN_IN = 8


def fit_recordings(estimator, source, *, on_bad_files="raise"):
    """Identify a robot, or close the loop, from recordings in files, with Dask.

    The result is that of the estimator's `fit` on all recordings in memory, one group
    each, in the order of the files' names, up to rounding.

    Parameters
    ----------
    estimator : RobotIdentifier or EffectDiscovery
        Identifier with `dt`, or a loop around one; it is fitted in place.
    source : str, os.PathLike or sequence of those
        Folder with tables, bags and LeRobot data sets as `read_recording` reads them,
        or a list of these, under paths that the workers can read. Each holds one
        recording, or several if it has a column `segment`.
    on_bad_files : {"raise", "warn"}, default="raise"
        What becomes of files that cannot be read, or have another sample period or
        number of joints. ``"warn"`` leaves them out; a file that does not exist is an
        error all the same.

    Returns
    -------
    estimator : RobotIdentifier or EffectDiscovery
        The fitted estimator.

    Raises
    ------
    ImportError
        If Dask is not installed.
    FileNotFoundError
        If the folder holds no recording.
    ValueError
        If a file cannot be read or has another sample period or number of joints, if
        all have with ``on_bad_files="warn"``, if a file changes while the passes over
        the files go on, or if settings of an identifier need more than second moments
        (effects, other regressors).

    Warns
    -----
    UserWarning
        If a file is given twice, or is a copy of another: it is taken once. With
        ``on_bad_files="warn"``, which files are left out, and why.

    Notes
    -----
    The computation runs where Dask is configured to: on the cluster of the current
    `distributed.Client`, otherwise in threads. A task returns its own sums and changes
    nothing else, so that one lost with its worker is run again and counts once.

    An identifier is fitted to sums, and no process holds more than the files that it is
    working on. `EffectDiscovery` looks at the motion itself: the workers read the
    files, smooth the positions and form the moments of all its fits, and this process
    holds the positions and torques of all files, and searches. Other columns of the
    files are signals that effects may vary with, as far as all files have them.

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
    dask = _import_dask()
    check_on_bad_files(on_bad_files)
    sources, again = _sources(source)
    fits = {RobotIdentifier: _identify, EffectDiscovery: _close_loop}
    fit = next((fits[kind] for kind in fits if isinstance(estimator, kind)), None)
    if fit is None:
        raise TypeError(
            "estimator must be a RobotIdentifier or an EffectDiscovery; got "
            f"{type(estimator).__name__}."
        )
    taken = _Taken(bad={} if on_bad_files == "warn" else None, copies=again)
    with show_progress(estimator.verbose):
        return fit(estimator, sources, taken, dask)


@dataclass(frozen=True)
class _Source:
    """A file, or the folder of a bag or data set, and its digest when measured."""

    path: str
    digest: bytes | None = None


@dataclass(kw_only=True, eq=False)
class _Taken:
    """Which files are taken, and which are left out."""

    # why files are left out, by path; None if that is an error
    bad: dict | None
    copies: list  # (path, first path) of what is there twice
    digests: dict = field(default_factory=dict)  # path by what the recording is

    @property
    def lenient(self):
        """Whether bad files are left out."""
        return self.bad is not None

    def takes(self, path, found):
        """Whether a recording is taken, by its digest, or an error for it."""
        if isinstance(found, Exception):
            self.bad[path] = found
            return False
        first = self.digests.setdefault(found, path)
        if first != path:
            self.copies.append((path, first))
        return first == path

    def check(self):
        """Refuse bad files alone, for the reason of the first."""
        if not self.digests:
            raise next(iter(self.bad.values()))

    def say(self):
        """Warn of what is left out."""
        notes = said_of_bad(self.bad or {})
        notes += [said_of_copies(self.copies)] if self.copies else []
        for note in notes:
            warnings.warn(note, DoubtWarning, stacklevel=4)


def _identify(identifier, sources, taken, dask):
    """Fit an identifier to files, to sums that workers make of them."""
    dt = check_dt(identifier.dt)
    check_input_noise(identifier.input_noise)
    identifier.load()
    _check_settings(identifier)
    names = identifier.joint_names_
    load = _loader(identifier, names)

    def sums(text, function, merge, *arguments):
        """Run a pass over the files; its other arguments are sent once."""
        task = dask.delayed(function, pure=False)
        shared = [dask.delayed(x, traverse=False, pure=False) for x in arguments]
        some = [sources[i : i + _AT_ONCE] for i in range(0, len(sources), _AT_ONCE)]
        totals = []
        for own in counted(some, text, "files", list(map(len, some))):
            tasks = [task(load, one, *shared) for one in own]
            totals += dask.compute(_merged(merge, tasks))
        return _reduce(merge, totals)

    measured = sums("lengths", _measure, operator.add, taken.lenient)
    measured = [one for one in measured if taken.takes(one["path"], one["digest"])]
    taken.check()
    taken.say()
    # Further passes read these files alone, as long as they are what they were.
    sources = [_Source(one["path"], one["digest"]) for one in measured]
    extent = functools.reduce(_merge_extents, measured)
    longest = max(extent["lengths"])
    n_fft = _smoothing.fft_length(max(longest, _smoothing.MIN_SPECTRUM), dt)
    power = sums("spectra", _spectra, _add_pairs, dt, n_fft)
    spectra = _smoothing.spectrum(*power, n_fft, dt) if power[1] else None
    estimator = choose_states(
        dt, identifier.state_cutoff, longest, extent["moving"], spectra
    )
    keep = n_fastest(sum(extent["lengths"]))
    merge = partial(MotionFacts.merge, keep=keep)
    motion = sums("speeds", _summarise, merge, estimator, keep)
    plan = make_plan(identifier, (), extent["lengths"], estimator, motion)
    stops = np.cumsum(extent["lengths"]).tolist()
    parts = [slice(a, b) for a, b in zip([0, *stops], stops)]
    check_length(parts, plan.lowpass, plan.cutoff)
    ranges = np.stack([motion.lowest, motion.highest])
    check_channels(names, ranges, extent["torques"], sum(extent["lengths"]))
    numbering = Numbering.of([plan.lowpass.centres(n).size for n in extent["lengths"]])
    numbers = _first_numbers(sources, extent["recordings"])
    halves = identifier.input_noise is not None
    given = plan, identifier.features_, halves, numbering, numbers
    moments = sums("equations", _moments, _add, *given)
    noise = partial(sums, "noise", _noise, operator.add)
    return identifier.fit_moments(plan, moments, noise)


def _loader(identifier, names):
    """Return the function with which workers read a file."""
    urdf = identifier.model if isinstance(identifier.model, (str, PathLike)) else None
    dt = check_dt(identifier.dt)
    return partial(_load, dt=dt, urdf=urdf and fspath(urdf), names=names)


def _close_loop(discovery, sources, taken, dask):
    """Fit an `EffectDiscovery` to files that workers read, its fits on workers."""
    names = joint_names(load_model(discovery.identifier.model))
    load = _loader(discovery.identifier, names)
    # What a file takes while it is read is several times what it holds.
    tasks = [(load, one, taken.lenient) for one in sources]
    read = counted(
        _on_workers(dask, _tried, tasks, at_once=1),
        "reading",
        "files",
        len(tasks) * [1],
    )

    def recordings():
        # The stage of reading ends with its last item.
        for (found, digest), one in zip(read, sources):
            if taken.takes(one.path, digest):
                yield found
        taken.check()

    whole = as_one(list(recordings()))
    taken.say()
    with workers():
        offered = OfferedSignals(columns=whole.signals)
        return discovery.fit_recording(whole, offered)


@contextmanager
def workers(where=None):
    """Let Dask compute the fits of this context, those of a loop as well.

    States and second moments of all recordings, or pieces of long ones, are formed by
    workers. Results are those without them, up to rounding.

    Parameters
    ----------
    where : None, int or str, default=None
        None: where Dask is configured to compute, by the workers of the current
        `distributed.Client`, otherwise in threads. A number of processes that are
        started on this machine for the context; or the address of a scheduler, such as
        ``"tcp://host:8786"``.

    Raises
    ------
    ImportError
        If Dask is not installed.
    ValueError
        If no scheduler answers at the address, or the number is not positive.

    See Also
    --------
    fit_recordings : The workers read the files as well.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.distributed import workers
    >>> recording = load_demo_recording()
    >>> robot = RobotIdentifier(recording.urdf, dt=recording.dt)
    >>> with workers():
    ...     robot = robot.fit(recording.q, recording.tau, groups=recording.groups)
    >>> bool((robot.min_eigenvalues_ > 0).all())
    True
    """
    dask = _import_dask()
    with _client(where), run_elsewhere(partial(_on_workers, dask)):
        yield


@contextmanager
def _client(where):
    """Connect to workers, see `workers`."""
    if where is None:
        yield
        return
    if isinstance(where, int) and where < 1:
        raise ValueError(f"where must be at least one process; got {where}.")
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise ImportError(_MISSING) from error
    if isinstance(where, int):
        own = {"n_workers": where, "threads_per_worker": 1, "dashboard_address": None}
        with LocalCluster(processes=True, **own) as local, Client(local):
            yield
        return
    try:
        client = Client(where, timeout=_ANSWERS)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"no Dask scheduler answers at {where!r}; expected an address such as "
            "tcp://host:8786, or a number of processes."
        ) from error
    with client:
        yield


def _on_workers(dask, function, tasks, at_once=_AT_ONCE):
    """Yield ``function(*task)`` for each task, wherever Dask computes."""
    # Arguments go with the task, so that one lost with its worker can be run again:
    # data that are sent ahead of it would be lost as well.
    task = dask.delayed(_alone, pure=False, traverse=False)
    for first in range(0, len(tasks), at_once):
        some = [task(function, *one) for one in tasks[first : first + at_once]]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sending large graph")
            yield from dask.compute(*some, traverse=False)


def _alone(function, *arguments):
    """Call a function with one thread of the linear algebra."""
    # Without listeners, as on another machine: who asked for it counts it.
    with one_blas_thread():
        return contextvars.Context().run(function, *arguments)


def _sources(source):
    """Return what is to be read, and (path, first path) of what is given again."""
    if isinstance(source, (str, PathLike)):
        folder = expanded(source)
        if not folder.is_dir():
            raise FileNotFoundError(
                f"source must be a folder or a list of files; {folder} is not a folder."
            )
        paths = recordings_in(folder)
        if not paths:
            raise FileNotFoundError(
                f"No recording in {folder}; expected tables or bags that "
                "read_recording reads."
            )
    else:
        paths = list(source)
        if not paths:
            raise ValueError("source must name at least one file; got none.")
    paths, again = without_repeats(paths)
    return [_Source(str(path)) for path in paths], again


def _check_settings(identifier):
    asked = {
        "effects": len(identifier.effects_) > 0,
        "regressor": not from_moments(identifier.regressor),
    }
    refused = [name for name, is_asked in asked.items() if is_asked]
    if refused:
        raise ValueError(
            f"fit_recordings does not support {', '.join(refused)}: the workers return "
            "second moments of the rigid bodies and their friction only. Use "
            "effects=() and a VBJFARegressor or JFARegressor, or fit in memory."
        )


# -- what a worker does with one file --------------------------------------------------


def _load(source, *, dt, urdf, names):
    """Read the `Recording` in a file, which still has the source's rows."""
    file = source.path
    try:
        recording = read_recording(file, dt=dt, urdf=urdf)
    except ValueError as error:
        if source.digest is None:
            raise
        raise _changed(file) from error
    # Copies of a file on several machines differ in their times, not in their rows.
    if source.digest not in (None, _digest(recording)):
        raise _changed(file)
    try:
        check_widths(names, recording.q, recording.tau)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    return recording


def _digest(recording):
    """Return what tells the rows of a recording from others, bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for values in (recording.q, recording.tau):
        digest.update(np.ascontiguousarray(values))
    return digest.digest()


def _changed(file):
    return ValueError(
        f"{file} has changed since it was first read; wait until the recording has "
        "ended, and give all workers the same file."
    )


def _tried(load, source, lenient):
    """Read a file; the recording and its digest, or None and the error if lenient."""
    try:
        recording = load(source)
    except (FileNotFoundError, ImportError):
        raise
    except (ValueError, OSError) as error:
        if not lenient:
            raise
        return None, error
    return recording, _digest(recording)


def _measure(load, source, lenient):
    """Lengths, levels of torques, which joints move: of one file, in a list."""
    recording, digest = _tried(load, source, lenient)
    found = {"path": source.path, "digest": digest}
    if recording is None:
        return [found]
    parts, tau = recording.segments, recording.tau
    moving = [np.ptp(recording.q[part], axis=0) > 0 for part in parts]
    found |= {
        "lengths": [part.stop - part.start for part in parts],
        "recordings": [len(parts)],
        "torques": levels(tau),
        "moving": np.any(moving, axis=0),
    }
    return [found]


def _merge_extents(first, second):
    return {
        "lengths": first["lengths"] + second["lengths"],
        "recordings": first["recordings"] + second["recordings"],
        "torques": levels(np.concatenate([first["torques"], second["torques"]])),
        "moving": first["moving"] | second["moving"],
    }


def _spectra(load, source, dt, n_fft):
    recording = load(source)
    powers = [
        _smoothing.acceleration_power(recording.q[part], dt, n_fft)
        for part in recording.segments
    ]
    power, energy = zip(*powers)
    return sum(power), sum(energy)


def _add_pairs(first, second):
    return first[0] + second[0], first[1] + second[1]


def _summarise(load, source, estimator, keep):
    """Motion of the recordings of one file."""
    return smooth(load(source), estimator, False, keep, None)[1]


def _noise(load, source, robot):
    """Noise of the torques of one file's recordings, a list."""
    return robot.noise_facts(load(source))


def _first_numbers(sources, counts):
    """Return source -> number of its first recording."""
    return dict(zip(sources, np.cumsum([0, *counts[:-1]]).tolist()))


def _moments(load, source, plan, features, halves, numbering, numbers):
    """Second moments of the filtered equations of one file; None if it has none."""
    recording = load(source)
    states, _ = smooth(recording, plan.state_estimator, halves, 1, None)
    made = segments(recording, states, plan, features, first=numbers[source])
    return accumulate(made, plan.lowpass, numbering=numbering)


def _add(first, second):
    if first is None or second is None:
        return second if first is None else first
    return operator.add(first, second)


def fit_array(estimator, X, y, sample_weight=None):
    """Fit a joint factor analysis regressor to Dask arrays.

    Each worker reduces its blocks of rows to count, means and scatter. The result is
    that of `fit` on the same rows in memory, up to rounding.

    Parameters
    ----------
    estimator : VBJFARegressor or JFARegressor
        Estimator; it is fitted in place.
    X : dask.array.Array of shape (n_samples, n_features)
        Inputs.
    y : dask.array.Array of shape (n_samples,)
        Output.
    sample_weight : dask.array.Array of shape (n_samples,), default=None
        Weights.

    Returns
    -------
    estimator
        The fitted estimator.

    Raises
    ------
    ImportError
        If Dask is not installed.
    TypeError
        If the estimator needs more than second moments, or an argument is not a Dask
        array.
    ValueError
        If shapes disagree, a value is not finite, or there are fewer than two rows.

    Notes
    -----
    Fewer samples than features are fitted from the scatter matrix here, whereas `fit`
    keeps the rows. The computation runs where Dask is configured to: on the cluster of
    the current `distributed.Client`, otherwise in threads.

    Examples
    --------
    >>> import numpy as np
    >>> import dask.array as da
    >>> from sklearn_vbjfa import JFARegressor
    >>> from sklearn_vbjfa.distributed import fit_array
    >>> rng = np.random.default_rng(0)
    >>> X = rng.normal(size=(1000, 2))
    >>> y = X @ [1.0, -2.0]
    >>> model = JFARegressor(input_noise=0.0)
    >>> blocks = da.from_array(X, chunks=(100, 2)), da.from_array(y, chunks=100)
    >>> fit_array(model, *blocks).coef_.round(6)
    array([ 1., -2.])
    """
    dask = _import_dask()
    if not isinstance(estimator, BaseJointFactorRegressor):
        raise TypeError(
            "estimator must be a VBJFARegressor or JFARegressor, for which second "
            f"moments suffice; got {type(estimator).__name__}."
        )
    arrays = {"X": X, "y": y}
    if sample_weight is not None:
        arrays["sample_weight"] = sample_weight
    for name, array in arrays.items():
        if not dask.is_dask_collection(array) or not hasattr(array, "to_delayed"):
            raise TypeError(
                f"{name} must be a Dask array, got {type(array).__name__}; use "
                "dask.array.from_array, or fit for data in memory."
            )
    _check_shapes(arrays)
    estimator._validate_params()
    X = X.rechunk({1: -1}) if X.numblocks[1] > 1 else X
    blocks = [list(X.to_delayed().ravel())]
    for name in list(arrays)[1:]:
        array = arrays[name]
        if array.chunks[0] != X.chunks[0] and not np.isnan(array.chunks[0]).any():
            array = array.rechunk((X.chunks[0],))
        blocks.append(list(array.to_delayed().ravel()))
    if len({len(parts) for parts in blocks}) > 1:
        raise ValueError(
            "Arrays of unknown length must have the same number of blocks; got "
            f"{[len(parts) for parts in blocks]} for {', '.join(arrays)}. Call "
            "compute_chunk_sizes on them."
        )
    block_statistics = dask.delayed(_block_statistics, pure=False)
    total = _merged(_add, [block_statistics(*parts) for parts in zip(*blocks)])
    (total,) = dask.compute(total)
    if total is None or total.n_rows < 2:
        raise ValueError(
            "X must have at least 2 rows that count, got "
            f"{0 if total is None else total.n_rows}."
        )
    return fit_moments(estimator, total)


def _check_shapes(arrays):
    X = arrays["X"]
    if X.ndim != 2:
        raise ValueError(f"X must have two axes, got shape {X.shape}.")
    for name, array in list(arrays.items())[1:]:
        known = not np.isnan([array.shape[0], X.shape[0]]).any()
        if array.ndim != 1 or (known and array.shape[0] != X.shape[0]):
            raise ValueError(
                f"{name} must have the shape {X.shape[:1]}, one value a row of X; got "
                f"{array.shape}."
            )


def _block_statistics(X, y, weight=None):
    """Statistics of one block of rows, None of an empty one."""
    if X.shape[0] == 0:
        return None
    X = check_array(X, dtype=np.float64)
    y = check_array(y, dtype=np.float64, ensure_2d=False)
    if weight is not None:
        # A block may have no weight, but not all of them together.
        if not np.any(weight):
            return None
        weight = check_sample_weight(weight, X)
    return from_data(X, y, weight)


def _import_dask():
    """Import Dask, or say what to install."""
    try:
        import dask
    except ImportError as error:
        raise ImportError(_MISSING) from error
    return dask


def _merged(merge, values):
    """Merge delayed values pairwise, in an order that depends only on their number."""
    dask = _import_dask()
    reduce = dask.delayed(functools.partial(_reduce, merge), pure=False)
    while len(values) > 1:
        values = [
            reduce(values[i : i + _FAN_IN]) for i in range(0, len(values), _FAN_IN)
        ]
    return values[0]


def _reduce(merge, values):
    return functools.reduce(merge, values)
