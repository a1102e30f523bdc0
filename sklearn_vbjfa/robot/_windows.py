"""Simulation of windows of a recording from measured states."""

import warnings
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np
from scipy import special
from sklearn.utils import check_consistent_length

from sklearn_vbjfa.effects import OfChannel
from sklearn_vbjfa.equations._checks import check_widths
from sklearn_vbjfa.model import is_prismatic
from sklearn_vbjfa.recording import check_dt, torques_in_order
from sklearn_vbjfa.recording._drives import velocity_lags
from sklearn_vbjfa.simulation import SimulationError, simulate_controlled
from sklearn_vbjfa.simulation._simulate import warn_left_out

# Level of the one-sided test by which an error is clearly smaller than another.
_CLEARLY = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedWindows:
    """Measured and simulated motion over windows of equal length.

    Attributes
    ----------
    joint_names : tuple of str
        Joints.
    prismatic : ndarray of shape (nv,), bool
        Joints whose positions are in m; those of the others are in rad.
    starts : ndarray of shape (n_windows,), int
        First row of each window.
    t : ndarray of shape (n_windows, m)
        Times of the rows [s].
    positions : ndarray of shape (n_windows, m, nv)
        As measured [rad or m].
    start_states : ndarray of shape (n_windows, 2 * nv)
        Smoothed positions and velocities that the simulations begin at.
    simulated : ndarray of shape (n_windows, m, 3 * nv)
        Simulated states [q | v | a]; nan in windows that failed.
    failures : dict of int to str
        Messages of windows that failed.
    commanded : ndarray of shape (n_windows, m, nv) or None, default=None
        Commanded positions [rad or m], where these alone drove the robot under its
        drive; None where torques did.
    """

    joint_names: tuple
    prismatic: np.ndarray
    starts: np.ndarray
    t: np.ndarray
    positions: np.ndarray
    start_states: np.ndarray
    simulated: np.ndarray
    failures: dict = field(default_factory=dict)
    commanded: np.ndarray | None = None

    @property
    def n_windows(self):
        """Number of windows."""
        return self.starts.size

    @property
    def failed(self):
        """Windows whose simulation ended before their end, (n_windows,), bool."""
        return np.isnan(self.simulated).any(axis=(1, 2))

    @property
    def errors(self):
        """Root mean square position errors (n_windows, nv), nan where one failed."""
        away = self.simulated[..., : len(self.joint_names)] - self.positions
        return np.sqrt(np.mean(away**2, axis=1))

    @property
    def clearly_better(self):
        """Joints (nv,) on which it is clearly better than each of `rivals`.

        The mean of the windows' errors is smaller, by Student's t of their differences
        at a level of 5 %; a window that failed counts as the worst error of `rivals`.
        """
        rivals = [rival.errors for rival in self.rivals.values()]
        worst = np.max(rivals, axis=(0, 1))
        errors = np.where(self.failed[:, None], worst, self.errors)
        return np.all([clearly_smaller(errors, other) for other in rivals], axis=0)

    def verdict(self):
        """Return in words whether it is clearly better than the `rivals`."""
        better = self.clearly_better
        without = "a robot at rest and one with constant velocity"
        if self.commanded is not None:
            without = "a robot at its commanded positions"
        if better.all():
            return f"clearly better than {without} on every joint"
        names = [n for n, good in zip(self.joint_names, better) if not good]
        where = "any joint" if not better.any() else ", ".join(names)
        return f"not clearly better than {without} on {where}"

    @property
    def rivals(self):
        """Predictions without a model for the same windows, by name."""
        # For torque inputs a robot at rest and one with constant velocity; for position
        # commands a robot that follows without error.
        if self.commanded is not None:
            return {"as commanded": self._moving(self.commanded)}
        q, v = np.split(self.start_states[:, None], 2, axis=2)
        since = (self.t - self.t[:, :1])[:, :, None]
        ways = {"at rest": q + 0.0 * since, "constant velocity": q + since * v}
        return {name: self._moving(way) for name, way in ways.items()}

    @property
    def scales(self):
        """Factors (nv,) that convert errors for display, and their units."""
        # Millimetres for prismatic joints, else degrees, or mrad for position commands.
        by_torque = self.commanded is None
        factor, unit = (180 / np.pi, "degrees") if by_torque else (1e3, "mrad")
        units = tuple("mm" if slides else unit for slides in self.prismatic)
        return np.where(self.prismatic, 1e3, factor), units

    def _moving(self, q):
        """Return the windows with other positions, without velocities."""
        states = np.concatenate([q, np.zeros_like(q), np.zeros_like(q)], axis=2)
        return replace(self, simulated=states, failures={})


def clearly_smaller(errors, others):
    """Whether the means of errors (n, ...) are clearly smaller than those of others."""
    # Student's t of the differences row by row, one-sided at a level of 5 %. Rows
    # follow one another in time: the variance of their mean is that of independent rows
    # times 1 + 2 r, r being the correlation of neighbours, if positive.
    difference = np.asarray(errors) - np.asarray(others)
    n = len(difference)
    if n < 2:
        return np.zeros(difference.shape[1:], dtype=bool)
    mean = difference.mean(axis=0)
    about = difference - mean
    neighbours = np.maximum((about[1:] * about[:-1]).sum(axis=0), 0.0)
    variance = ((about**2).sum(axis=0) + 2.0 * neighbours) / (n - 1)
    return mean < special.stdtrit(n - 1, _CLEARLY) * np.sqrt(variance / n)


def simulate_windows(robot, X, y, groups=None, t=None, *, window=1.0, signals=None):
    """Simulate windows of a recording, each from the measured state at its start.

    Windows follow one another without gap, within each recording, where the smoother
    sees both sides.

    Parameters
    ----------
    robot : RobotIdentifier or IdentifiedRobot
        Fitted.
    X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
        Measured joint positions [rad or m], which are smoothed as `robot` does; or
        states [q | v | a].
    y : array-like of shape (n_samples, nv)
        Measured torques [N m or N] that drive the simulation.
    groups : array-like of shape (n_samples,), default=None
        Labels of separate recordings.
    t : array-like of shape (n_samples,), default=None
        Time of each row [s], on the clock of the fit if effects vary with time. None
        counts from the beginning of the fit.
    window : float, default=1.0
        Length of a window [s].
    signals : mapping of str to array-like of shape (n_samples,), default=None
        Recorded signals, for effects that vary with them.

    Returns
    -------
    SimulatedWindows
        Measured and simulated motion, errors, and windows that failed; their errors
        are nan, and `failures` has the messages.

    Raises
    ------
    ValueError
        If arguments do not suit the robot, or no recording is as long as a window.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.diagnosis import simulate_windows
    >>> recording = load_demo_recording().select(0)
    >>> robot = RobotIdentifier(
    ...     recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
    ... )
    >>> robot = robot.fit(recording.q[:3000], recording.tau[:3000])
    >>> found = simulate_windows(robot, recording.q[3000:], recording.tau[3000:])
    >>> found.errors.shape
    (4, 6)
    >>> print(found.verdict())
    not clearly better than a robot at rest and one with constant velocity on joint_5, \
joint_6
    """
    robot = robot.robot_
    X, signals = robot.checked(X, signals)
    y = np.asarray(torques_in_order(y, robot.joint_names_), dtype=float)
    y = y[:, None] if y.ndim == 1 else y
    check_consistent_length(X, y)
    check_widths(robot.joint_names_, X, y)
    windows = _measured(robot, X, groups, t, signals, window)

    def simulated(rows, start, t):
        part = {name: x[rows] for name, x in (signals or {}).items()}
        q0, v0 = np.split(start, 2)
        return robot.simulate(y[rows], q0, v0, t, signals=part or None)

    return _run(windows, simulated)


def follow_windows(robot, drive, recording, t=None, *, window=1.0, signals=None):
    # drive: `PDDrive` with recorded channels. Other parameters: see `simulate_windows`.
    robot = robot.robot_
    X, signals = robot.checked(recording.inputs, signals)
    channels = {**recording.signals, **(signals or {})}
    follower = CommandFollower(robot, drive, replace(recording, signals=channels))
    warn_left_out(robot.joint_names_, follower.left_out, stacklevel=3)
    windows = _measured(robot, X, recording.groups, t, signals, window)
    commanded = recording.signals[drive.channel].reshape(recording.q.shape)
    windows = replace(windows, commanded=commanded[_rows_of(windows)])
    return _run(windows, follower.run)


def _rows_of(windows):
    return windows.starts[:, None] + np.arange(windows.t.shape[1])


def _run(windows, simulated_window):
    # simulated_window: function of the rows of a window, its start and its times that
    # returns states (m, 3 nv).
    rows, failures = _rows_of(windows), {}
    simulated = np.full((*rows.shape, 3 * len(windows.joint_names)), np.nan)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for k, (first, *_, last) in enumerate(rows):
            part, start = slice(first, last + 1), windows.start_states[k]
            try:
                simulated[k] = simulated_window(part, start, windows.t[k])
            except SimulationError as error:
                failures[k] = str(error)
    warn_once(caught, "windows", stacklevel=4)
    return replace(windows, simulated=simulated, failures=failures)


def _measured(robot, X, groups, t, signals, window):
    """Divide a recording into windows, before the simulation."""
    nv, dt = len(robot.joint_names_), check_dt(robot.plan.dt)
    inputs = robot.prepare(X, groups, t, signals=signals)
    robot.warn_outside(inputs, stacklevel=4)
    clock = robot.clock(None, len(X)) if t is None else np.asarray(t, dtype=float)
    check_consistent_length(X, clock)
    states = robot.states(X, groups)
    if not (isinstance(window, Real) and dt <= window < np.inf):
        raise ValueError(
            f"window must be a time in seconds, at least the sample period {dt:g} s; "
            f"got {window!r}."
        )
    rows = _rows(inputs, robot.plan.standstill, round(window / dt), dt)
    return SimulatedWindows(
        joint_names=robot.joint_names_,
        prismatic=np.array(is_prismatic(robot.features_.model_)),
        starts=rows[:, 0],
        t=clock[rows],
        positions=X[rows][..., :nv],
        start_states=states[rows[:, 0], : 2 * nv],
        simulated=np.full((*rows.shape, 3 * nv), np.nan),
    )


def _rows(inputs, standstill, length, dt):
    """Rows of the windows, (n_windows, length + 1)."""
    inner, starts = inputs.valid_rows(standstill)["position"], []
    for part in inputs.recording.segments:
        first = part.start + int(np.argmax(inner[part].any(axis=1)))
        starts += range(first, part.stop - length, length)
    if not starts:
        longest = max(part.stop - part.start for part in inputs.recording.segments)
        raise ValueError(
            f"No recording is as long as a window of {length * dt:g} s: the longest "
            f"has {longest} rows, {longest * dt:g} s, of which the ends are left out. "
            "Give shorter windows."
        )
    return np.array(starts)[:, None] + np.arange(length + 1)


def warn_once(caught, where, stacklevel):
    """Repeat each kind of recorded warning once, with its count."""
    # Texts that agree up to the colon are of one kind; where: noun for the repetitions.
    kinds = {}
    for warning in caught:
        kind = str(warning.message).partition(":")[0]
        kinds.setdefault((warning.category, kind), []).append(str(warning.message))
    for (category, _), texts in kinds.items():
        many = f" (first of {len(texts)} {where})" if len(texts) > 1 else ""
        text = f"{texts[0].rstrip('.')}{many}."
        warnings.warn(text, category, stacklevel=stacklevel + 1)


# Tolerance for rounding of times, in rows.
_JITTER = 1e-9


def unfollowed(effect):
    """Reason why a simulation under a drive leaves out an effect, "" if it does not."""
    at_once = "torques of the drive act at once" * isinstance(effect, OfChannel)
    return effect.files.simulation or at_once


class CommandFollower:
    """Closed loop of a robot and its drive, with recorded commands as input."""

    # robot: `IdentifiedRobot`.

    def __init__(self, robot, drive, recording):
        names = recording.joint_names
        self._command = drive.commands(recording)
        given = drive.known_delay
        self._late = (robot.plan.delay if given is None else given) / recording.dt
        self._begins = np.array([part.start for part in recording.segments])
        self._gains = [
            np.broadcast_to(x, self._command.shape) for x in drive.law(names, recording)
        ]
        self._most = drive.torque_limits(names)
        self._model, self._dt = robot.torque_model(), recording.dt
        self._updates = drive.updates_per_sample(recording.dt)
        self._lags = np.maximum(velocity_lags(recording), 0.0)
        self._signals = {k: x for k, x in recording.signals.items() if x.ndim == 1}
        # effects that are left out, with the reason
        self.left_out = [(e, unfollowed(e)) for e in robot.effects_ if unfollowed(e)]

    def run(self, rows, start, t):
        """Simulate rows, a slice, from a state (3 nv,); t (n,): their times [s]."""
        nv, late = self._command.shape[1], self._late - 0.5 / self._updates
        begin = self._begins[self._begins <= rows.start][-1]
        parts = (x[begin : rows.stop] for x in (self._command, *self._gains))
        law = law_of(*parts, self._most, rows.start - begin, late)
        return simulate_controlled(
            self._model,
            _seen_late(law, self._lags, self._dt, self._updates),
            start[:nv],
            start[nv : 2 * nv],
            t,
            {name: x[rows] for name, x in self._signals.items()},
            self._updates,
        )


def follow(robot, drive, recording, window=None):
    # robot: `IdentifiedRobot`; window: time [s] between restarts from the recorded
    # state, None for whole recordings. Returns states (n, 3 nv).
    follower, clock = CommandFollower(robot, drive, recording), recording.clock
    warn_left_out(robot.joint_names_, follower.left_out, stacklevel=4)
    measured = robot.states(recording.inputs, recording.groups)
    length = recording.n_samples
    if window is not None:
        length = max(round(window / recording.dt), 2)
    parts = [
        slice(first, min(first + length, part.stop))
        for part in recording.segments
        for first in range(part.start, part.stop, length)
    ]
    states = [follower.run(rows, measured[rows.start], clock[rows]) for rows in parts]
    return np.concatenate(states)


def _seen_late(control, lags, dt, updates):
    """Delay the velocities that a controller reads by lags (nv,) [s]."""
    if not lags.any():
        return control
    back, past, joints = lags * updates / dt, [], np.arange(lags.size)

    def late(row, q, v):
        past.append(np.array(v))
        ago = np.clip(len(past) - 1 - back, 0.0, None)
        first = ago.astype(int)
        second = np.minimum(first + 1, len(past) - 1)
        velocities = np.array(past[int(first.min()) :])
        first, second, share = first - first.min(), second - first.min(), ago % 1.0
        seen = velocities[first, joints]
        return control(row, q, seen + share * (velocities[second, joints] - seen))

    return late


def law_of(command, kp, kd, most, first=0, late=0.0):
    """Return the PD control law for commands (n, nv) with zero-order hold."""

    # first: first row of the simulation; late: delay of the commands, in rows.
    def control(row, q, v):
        i = min(int(first + row), len(command) - 1)
        k = min(max(int(np.floor(first + row - late + _JITTER)), 0), len(command) - 1)
        return np.clip(command[k] - kp[i] * q - kd[i] * v, -most, most)

    return control
