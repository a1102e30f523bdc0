"""The `Recording` class and its validation, selection and resampling."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sklearn_vbjfa._core._smoothing import contiguous_groups, interpolate

if TYPE_CHECKING:
    import pinocchio as pin


def _to_float(value):
    try:
        return np.nan if isinstance(value, str) else float(value)
    except (TypeError, ValueError):
        return np.nan


def check_dt(dt):
    """Return the sample period as a positive finite float."""
    value = _to_float(dt)
    if not 0 < value < np.inf:
        raise ValueError(
            f"dt must be the sample period in seconds, positive and finite; got {dt!r}."
        )
    return value


def check_cutoff(cutoff, dt):
    """Return a cut-off in Hz as a float; infinity for None."""
    value = np.inf if cutoff is None else _to_float(cutoff)
    if not value > 0:
        raise ValueError(
            "cutoff must be a positive frequency in Hz, 'auto', or None for no "
            f"low-pass; got {cutoff!r}."
        )
    if np.isfinite(value) and value >= 0.5 / dt:
        raise ValueError(
            f"cutoff must lie below the Nyquist frequency {0.5 / dt:.6g} Hz of "
            f"dt={dt:.6g} s; got {value:.6g} Hz. Give None for no low-pass."
        )
    return value


def check_clock(t, n_samples, dt):
    """Return the increasing times of all rows [s], multiples of dt if t is None."""
    if t is None:
        return None if dt is None else np.arange(n_samples) * check_dt(dt)
    time = np.asarray(t, dtype=float)
    if time.shape != (n_samples,):
        raise ValueError(
            f"t must hold one time per row, shape ({n_samples},); got {time.shape}."
        )
    bad = np.flatnonzero(~(np.diff(time) > 0))
    if bad.size:
        raise ValueError(
            "t must rise from row to row, over all recordings; it does not at row "
            f"{bad[0] + 1} ({time[bad[0]]:.6g} s, then {time[bad[0] + 1]:.6g} s)."
        )
    return time


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Recording:
    """Joint positions and torques of a robot, with metadata.

    May hold several recordings in sequence, labelled by `groups`. Nothing may be
    differentiated, filtered or remembered across a change of label.

    Parameters
    ----------
    name : str
        Short name of the data set.
    q : ndarray of shape (n_samples, nv)
        Joint positions [rad or m, see `position_units`], in the joint order, zero and
        sign of `robot_model`.
    tau : ndarray of shape (n_samples, nv)
        Joint torques or forces [see `torque_units`], same order and sign.
    t : ndarray of shape (n_samples,) or None
        Time since the start of each recording [s]; the logger's stamps if the data were
        not resampled. None counts `dt` from the first row.
    dt : float or None
        Sample period [s]; the median one if `t` is not uniform. None only with
        `states`, whose rows need not be uniformly sampled.
    groups : ndarray of shape (n_samples,)
        Labels of the recordings: 0, 1, 2, ... in order of the rows.
    group_names, joint_names : tuple of str
        Names of the recordings by label, and of the joints as in `robot_model`.
    position_units : tuple of {"rad", "m"}
        Unit of each joint.
    torque_units : tuple of {"N m", "N", "A", "V", "count"}
        Unit of each joint; other than "N m" and "N", a motor quantity proportional to
        the torque by an unknown factor.
    v : ndarray of shape (n_samples, nv) or None, default=None
        The robot's own velocities [rad/s or m/s], if recorded.
    states : ndarray of shape (n_samples, 3 * nv) or None, default=None
        States [q | v | a] if given; None if they are to be estimated from positions.
    weight : ndarray of shape (n_samples, nv) or None, default=None
        Weights of each joint's samples, zero to leave one out; None is unit weights.
    torque_noise : ndarray of shape (nv,) or None, default=None
        Standard deviation of the white noise of a torque sample [see `torque_units`],
        measured before rows were interpolated; None if no row was.
    command : ndarray of shape (n_samples, nv) or None, default=None
        The part of `tau` that a drive computed from commands alone; see `PDDrive`.
    feedback : ndarray of shape (2, nv) or None, default=None
        Gains of the feedback part of `tau` on measured positions and velocities, which
        amplify the noise of positions.
    signals : mapping of str to ndarray, default={}
        Other channels on the same rows; the loader gives their units.
    before : tuple of ndarray of shape (k, nv), default=()
        Positions before each segment, if these are pieces of longer recordings, on
        which friction with memory depends. Empty if they are unknown.
    joints_named : bool, default=False
        Whether the columns of the file carry the names of the joints.
    urdf : str or None, default=None
        File with a description of the robot, URDF or MJCF.
    source, licence, citation, description : str, default=""
        Origin of the data, licence, citation, and notes on their use.

    Raises
    ------
    ValueError
        If shapes disagree, a value is not finite, `dt` is not positive or
        the labels are not 0, 1, 2, ... in contiguous blocks.
    """

    name: str
    q: np.ndarray
    tau: np.ndarray
    t: np.ndarray | None
    dt: float | None
    groups: np.ndarray
    group_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    position_units: tuple[str, ...]
    torque_units: tuple[str, ...]
    v: np.ndarray | None = None
    states: np.ndarray | None = None
    weight: np.ndarray | None = None
    torque_noise: np.ndarray | None = None
    command: np.ndarray | None = None
    feedback: np.ndarray | None = None
    signals: Mapping[str, np.ndarray] = field(default_factory=dict)
    before: tuple[np.ndarray, ...] = ()
    joints_named: bool = False
    urdf: str | None = None
    source: str = ""
    licence: str = ""
    citation: str = ""
    description: str = ""

    # Fields with a value per row: number of columns per joint, 0 for one-dimensional.
    WIDTHS: ClassVar = {"t": 0, "states": 3} | dict.fromkeys(
        ("q", "tau", "v", "weight", "command"), 1
    )

    def __post_init__(self):
        if self.dt is not None or self.states is None:
            check_dt(self.dt)
        _check("q", self.q, np.shape(self.q))
        if self.q.ndim != 2 or self.q.size == 0:
            raise ValueError(
                f"q must have shape (n_samples, nv), got {self.q.shape}; for one joint "
                "use q.reshape(-1, 1)."
            )
        n_samples, nv = self.q.shape
        for key, width in self.WIDTHS.items():
            values = getattr(self, key)
            if values is not None or key == "tau":
                _check(key, values, (n_samples, width * nv) if width else (n_samples,))
        for key, values in self.signals.items():
            _check(f"signals[{key!r}]", values, (n_samples, *np.shape(values)[1:]))
        for key in ("joint_names", "position_units", "torque_units"):
            if len(getattr(self, key)) != nv:
                raise ValueError(f"{key} must have {nv} entries, as q has columns.")
        _check("groups", self.groups, (n_samples,))
        labels = self.groups[[part.start for part in self.segments]]
        names = [*dict.fromkeys(self.group_names)]
        valid = len(names) == len(self.group_names) and self.groups.dtype.kind in "iu"
        if not valid or labels.tolist() != [*range(len(names))]:
            raise ValueError(
                "groups must hold the integers from 0 on in contiguous blocks, one for "
                f"each of the different group_names {self.group_names}; got blocks "
                f"{labels[:10].tolist()}."
            )

    def __repr__(self) -> str:
        facts = [f"{self.n_samples} samples", f"{self.nv} joint{'s' * (self.nv > 1)}"]
        facts.append(f"dt = {'unknown' if self.dt is None else f'{self.dt:.6g} s'}")
        if len(self.group_names) > 1:
            facts.append(f"{len(self.group_names)} recordings")
        return f"Recording {self.name!r}: {', '.join(facts)}"

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return self.q.shape[0]

    @property
    def nv(self) -> int:
        """Number of joints."""
        return self.q.shape[1]

    @property
    def inputs(self) -> np.ndarray:
        """Input X of a fit: states if given, else positions."""
        return self.q if self.states is None else self.states

    @cached_property
    def segments(self) -> tuple[slice, ...]:
        """Rows of each recording; nothing is filtered across their boundaries."""
        return tuple(contiguous_groups(self.groups, self.n_samples))

    @property
    def clock(self) -> np.ndarray | None:
        """Time of each row [s], multiples of `dt`, rising over all recordings."""
        return check_clock(None, self.n_samples, self.dt)

    def torques(self, delay: float = 0.0) -> np.ndarray:
        """Return the torques if commands act later than assumed in `tau`.

        Parameters
        ----------
        delay : float, default=0.0
            Additional delay of the commands [s].

        Returns
        -------
        ndarray of shape (n_samples, nv)
            `tau` itself if the delay is zero.

        Raises
        ------
        ValueError
            If the delay is not zero and the recording has no commands.
        """
        if not delay:
            return self.tau
        if self.command is None:
            raise ValueError(
                f"The robot has a command delay of {delay:.4g} s, and the recording "
                "has no commands: give them as in the fit (drive=PDDrive(...)), or "
                "predict torques without measured ones."
            )
        delayed = interpolate(self.command, self.segments, self.clock, delay)
        return self.tau + (delayed - self.command)

    def select(self, *names_or_labels: str | int) -> "Recording":
        """Keep some of the recordings.

        Parameters
        ----------
        *names_or_labels : str or int
            Entries of `group_names`, or labels of `groups`.

        Returns
        -------
        recording : Recording
            These recordings in their original order, relabelled 0, 1, 2, ...

        Raises
        ------
        ValueError
            If a name or label does not exist, or none is given.
        """
        names = self.group_names
        labels = {x: k for k, name in enumerate(names) for x in (k, name)}
        if not names_or_labels or not labels.keys() >= {*names_or_labels}:
            raise ValueError(
                f"No recordings {names_or_labels} in {self.name!r}; choose from the "
                f"names {names} or the labels 0 to {len(names) - 1}."
            )
        kept = sorted({labels[x] for x in names_or_labels})
        selected = take_rows(self, [self.segments[label] for label in kept], kept)
        names = tuple(names[label] for label in kept)
        before = tuple(self.before[label] for label in kept) if self.before else ()
        return replace(selected, group_names=names, before=before)

    def robot_model(self) -> "pin.Model":
        """Nominal model of the robot, with one degree of freedom per joint.

        Joints of the description that were not recorded (fingers, wheels,
        head) are locked at zero.

        Returns
        -------
        model : pinocchio.Model
            `nq == nv == len(joint_names)`, joints in the order of `joint_names`.

        Raises
        ------
        ImportError
            If Pinocchio is not installed.
        FileNotFoundError
            If no description of the robot was found.
        ValueError
            If the description lacks a recorded joint or has another joint order.
        """
        from sklearn_vbjfa.model import build_model

        return build_model(self.name, self.urdf, self.joint_names)


def bridged(recording):
    """Interpolate torques of zero weight linearly, since filters need all samples."""
    if recording.weight is None or (recording.weight > 0).all():
        return recording
    tau, rows = recording.tau.copy(), np.arange(recording.n_samples)
    for part in recording.segments:
        for y, weighted in zip(tau[part].T, recording.weight[part].T > 0):
            if weighted.any():
                y[:] = np.interp(rows[part], rows[part][weighted], y[weighted])
    return replace(recording, tau=tau)


def with_torques_shifted(recording, lag):
    """Return a recording with torques read at times later by a lag [s]."""
    # Between rows, the smaller weight applies; outside the recording, it is zero.
    if not lag:
        return bridged(recording)
    parts, old_weight = recording.segments, recording.weight
    tau = interpolate(bridged(recording).tau, parts, recording.clock, -lag)
    old_weight = np.ones(tau.shape) if old_weight is None else old_weight
    weight = np.zeros(tau.shape)
    for part in parts:
        index = np.arange(part.stop - part.start) + lag / recording.dt
        inside = (index >= 0) & (index <= index.size - 1)
        near = (rounded(index[inside]).astype(int) for rounded in (np.floor, np.ceil))
        weight[part][inside] = np.minimum(*(old_weight[part][rows] for rows in near))
    return replace(recording, tau=tau, weight=weight)


def take_arrays(
    X, y, groups=None, weight=None, t=None, *, dt, joint_names, signals=None
):
    """Build a recording from the validated arguments of a fit or a prediction."""
    # X: positions (n_samples, nv) or states (n_samples, 3 nv); y: None for no torques;
    # groups: labels in any form; signals (n_samples,) by name.
    nv, segments = len(joint_names), contiguous_groups(groups, X.shape[0])
    return Recording(
        name="",
        q=X[:, :nv],
        tau=np.zeros((len(X), nv)) if y is None else y,
        t=None if t is None else np.asarray(t, dtype=float),
        dt=None if dt is None else check_dt(dt),
        **_segment_labels(segments),
        joint_names=tuple(joint_names),
        position_units=nv * ("",),
        torque_units=nv * ("",),
        states=X if X.shape[1] == 3 * nv else None,
        weight=weight,
        signals=signals or {},
    )


def recording_names(groups, starts):
    """Return the name of each recording: its label, by default its number from 0."""
    labels = range(len(starts)) if groups is None else np.asarray(groups)[starts]
    return tuple(map(str, labels))


def _segment_labels(segments):
    """Return the fields `groups` and `group_names` of consecutive segments."""
    names = tuple(str(k) for k in range(len(segments)))
    lengths = [part.stop - part.start for part in segments]
    return {"groups": np.repeat(np.arange(len(names)), lengths), "group_names": names}


def take_rows(recording, rows, groups):
    """Return a recording of some rows (ascending), in new segments."""
    # rows: (n_kept,) or slices; groups: segment labels in any form, (n_kept,) or one
    # per slice.
    if not isinstance(rows, np.ndarray):
        groups = np.repeat(list(groups), [part.stop - part.start for part in rows])
        rows = np.concatenate([np.arange(part.start, part.stop) for part in rows])
    segments = contiguous_groups(groups, rows.size)

    def select(x):
        if x is not None and not x.strides[0]:
            # A value broadcast over all rows needs no memory: keep it a view.
            return np.broadcast_to(x[0], (rows.size, *x.shape[1:]))
        return None if x is None else x[rows]

    return replace(
        recording,
        **{key: select(getattr(recording, key)) for key in recording.WIDTHS},
        **_segment_labels(segments),
        signals={key: values[rows] for key, values in recording.signals.items()},
        before=tuple(_positions_before(recording, rows[x.start]) for x in segments),
    )


def _positions_before(recording, row):
    """Return the positions (k, nv) that precede a row in its recording."""
    k = int(recording.groups[row])
    before = recording.q[recording.segments[k].start : row]
    return np.concatenate([recording.before[k], before]) if recording.before else before


def _check(name: str, values: Any, shape: tuple[int, ...]) -> None:
    """Raise an error unless values are a finite numeric array of the given shape."""
    is_array = isinstance(values, np.ndarray) and values.dtype.kind in "biuf"
    if not is_array or not np.isfinite(values).all():
        kind = getattr(values, "dtype", type(values).__name__)
        raise ValueError(
            f"{name} must be an ndarray of finite numbers, got {kind} or other values; "
            "drop or interpolate those rows first."
        )
    if values.shape != shape:
        raise ValueError(
            f"{name} must have shape {shape} to agree with q, got {values.shape}."
        )
