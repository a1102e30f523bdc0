"""Windows of a recording, simulated one by one from measured states."""

import warnings
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from scipy import special

from sklearn_vbjfa.effects import OfChannel
from sklearn_vbjfa.model import DoubtWarning, is_prismatic
from sklearn_vbjfa.recording import check_dt, torques_in_order
from sklearn_vbjfa.recording._drives import velocity_lags
from sklearn_vbjfa.simulation import SimulationError, simulate_controlled

# Level of the one-sided test by which an error is clearly smaller than another.
_CLEARLY = 0.05


@dataclass(frozen=True, kw_only=True)
class FailedWindow:
    """A window whose simulation ended before its end."""

    window: int  # its number, from zero
    time: float  # at which it was given up [s]; that of its start if it did not begin
    message: str


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SimulatedWindows:
    """Measured and simulated motion over windows of equal length.

    Printed, they say how many windows failed, and on which joints they are not clearly
    better than a robot without a model.

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
    velocities : ndarray of shape (n_windows, m, nv)
        Of the smoothed positions [rad/s or m/s].
    start_positions : ndarray of shape (n_windows, nv)
        Smoothed positions that the simulations begin at.
    simulated : ndarray of shape (n_windows, m, 3 * nv)
        Simulated states [q | v | a]; nan in windows that failed.
    failures : tuple of FailedWindow
        Outcome of these.
    commanded : ndarray of shape (n_windows, m, nv) or None, default=None
        Commanded positions [rad or m], where these alone drove the robot under its
        drive; None where torques did.
    """

    joint_names: tuple
    prismatic: np.ndarray
    starts: np.ndarray
    t: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    start_positions: np.ndarray
    simulated: np.ndarray
    failures: tuple = ()
    commanded: np.ndarray | None = None

    def __repr__(self):
        """Tell the windows, those that failed, and whether a model was needed."""
        seconds = self.t[0, -1] - self.t[0, 0]
        return (
            f"<SimulatedWindows: {self.n_windows} windows of {seconds:g} s, "
            f"{self.failed.sum()} failed, {self.verdict()}>"
        )

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
        nv = len(self.joint_names)
        return _rms(self.simulated[..., :nv] - self.positions, 1)

    @property
    def velocity_errors(self):
        """Root mean square velocity error of each window, (n_windows, nv)."""
        nv = len(self.joint_names)
        return _rms(self.simulated[..., nv : 2 * nv] - self.velocities, 1)

    @property
    def run_away(self):
        """Joints (n_windows, nv) further off than `rivals` are in any window, bool."""
        worst = [rival.errors.max(axis=0) for rival in self.rivals.values()]
        return self.errors > np.max(worst, axis=0)

    @property
    def clearly_better(self):
        """Joints (nv,) on which it is clearly better than each of `rivals`.

        The mean of the windows' errors is smaller, by Student's t of their differences
        at a level of 5 %; a window that failed counts as the worst error of `rivals`.
        """
        rivals = [one.errors for one in self.rivals.values()]
        worst = np.max(rivals, axis=(0, 1))
        own = np.where(self.failed[:, None], worst, self.errors)
        return np.all([clearly_smaller(own, other) for other in rivals], axis=0)

    def verdict(self):
        """Say whether it is clearly better than all robots without a model."""
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
        """The same windows of robots without a model, by what they do."""
        # Driven by torques, of one at rest and one with constant velocity; driven by
        # positions, of one that follows at once.
        if self.commanded is None:
            v = self.velocities[:, 0]
            rest = self._moving(0.0 * v)
            return {"at rest": rest, "constant velocity": self._moving(v)}
        v = np.gradient(self.commanded, self.t[0, 1] - self.t[0, 0], axis=1)
        states = np.concatenate([self.commanded, v, np.zeros_like(v)], axis=2)
        return {"as commanded": replace(self, simulated=states, failures=())}

    @property
    def scales(self):
        """Factors (nv,) of errors, and the units that they are then in."""
        # Millimetres where joints slide; else degrees, and mrad for robots with
        # position commands.
        factor, unit = (180 / np.pi, "degrees")
        if self.commanded is not None:
            factor, unit = 1e3, "mrad"
        units = tuple("mm" if slides else unit for slides in self.prismatic)
        return np.where(self.prismatic, 1e3, factor), units

    def _moving(self, v0):
        since = self.t - self.t[:, :1]
        q = self.start_positions[:, None] + since[:, :, None] * v0[:, None]
        v = np.broadcast_to(v0[:, None], q.shape)
        states = np.concatenate([q, v, np.zeros_like(q)], axis=2)
        return replace(self, simulated=states, failures=())


def clearly_smaller(errors, others):
    """Whether the means of errors (n, ...) are clearly smaller than those of others."""
    # Student's t of the differences row by row, one-sided at a level of 5 %. Rows
    # follow one another in time: their mean has the variance of independent ones times
    # 1 + 2 r, with the correlation r of neighbours where it is positive.
    difference = np.asarray(errors) - np.asarray(others)
    n = len(difference)
    if n < 2:
        return np.zeros(difference.shape[1:], dtype=bool)
    mean = difference.mean(axis=0)
    about = difference - mean
    variance = (about**2).sum(axis=0) / (n - 1)
    neighbours = (about[1:] * about[:-1]).sum(axis=0) / (n - 1)
    variance = variance + 2.0 * np.maximum(neighbours, 0.0)
    return mean < special.stdtrit(n - 1, _CLEARLY) * np.sqrt(variance / n)


def simulate_windows(
    robot, X, y, groups=None, t=None, *, window=1.0, signals=None, beside=None
):
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
    beside : SimulatedWindows, default=None
        The same rows simulated with another robot, to compare both: its windows, times
        and start states are taken over, and `window` and `t` are not used. Robots that
        were fitted one by one smooth a little differently.

    Returns
    -------
    SimulatedWindows
        Measured and simulated motion, errors, and windows that failed; their errors
        are nan, and `failures` names them.

    Raises
    ------
    ValueError
        If arguments do not suit the robot, no recording is as long as a window, or no
        window can be begun.

    Warns
    -----
    UserWarning
        Once for all windows, what `RobotIdentifier.simulate` warns of.

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
    predictor = robot.robot_
    names = predictor.joint_names_
    X, signals = predictor.checked(X, signals)
    y = _torques(y, names, len(X))
    if predictor.plan.dt is None:
        raise ValueError(
            "The robot was identified without a sample period; give dt to "
            "RobotIdentifier."
        )
    if beside is None:
        made = _measured(predictor, X, groups, t, signals, window)
    else:
        made = _taken_over(beside, X, names)

    def simulated(k, rows):
        return robot.simulate(
            y[rows],
            made.start_positions[k],
            made.velocities[k, 0],
            made.t[k],
            signals={name: x[rows] for name, x in (signals or {}).items()} or None,
        )

    return _run(made, simulated)


def follow_windows(
    robot, drive, recording, t=None, *, window=1.0, signals=None, beside=None
):
    # drive: `PDDrive`, whose channels are in the recording; window: None simulates a
    # single recording as a whole. The rest is that of `simulate_windows`.
    predictor = robot.robot_
    X, signals = predictor.checked(recording.inputs, signals)
    own = {**recording.signals, **(signals or {})}
    follower = CommandFollower(predictor, drive, replace(recording, signals=own))
    follower.warn_left_out(stacklevel=2)
    if beside is None:
        made = _measured(predictor, X, recording.groups, t, signals, window)
        commanded = recording.signals[drive.told].reshape(recording.q.shape)
        made = replace(made, commanded=commanded[_rows_of(made)])
    else:
        made = _taken_over(beside, X, predictor.joint_names_)

    def simulated(k, rows):
        start = np.r_[made.start_positions[k], made.velocities[k, 0]]
        return follower.run(slice(rows[0], rows[-1] + 1), start, made.t[k])

    return _run(made, simulated)


def _rows_of(made):
    return made.starts[:, None] + np.arange(made.t.shape[1])


def _run(made, simulated_window):
    # simulated_window: of the number of a window and its rows, the states (m, 3 nv).
    rows = _rows_of(made)
    simulated = np.full((*rows.shape, 3 * len(made.joint_names)), np.nan)
    failures, refusals = [], []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for k, own in enumerate(rows):
            try:
                simulated[k] = simulated_window(k, own)
            except SimulationError as error:
                failures.append(
                    FailedWindow(window=k, time=error.time, message=str(error))
                )
            except ValueError as error:
                # A start that cannot be: this window's fault, unless it is everyone's.
                refusals.append(error)
                failures.append(
                    FailedWindow(window=k, time=float(made.t[k, 0]), message=str(error))
                )
    if len(refusals) == len(rows):
        raise refusals[0]
    warn_once(caught, "windows", stacklevel=4)
    return replace(made, simulated=simulated, failures=tuple(failures))


def _measured(predictor, X, groups, t, signals, window):
    """Cut a recording into windows that nothing has been simulated in yet."""
    nv, dt = len(predictor.joint_names_), check_dt(predictor.plan.dt)
    asked = predictor.prepare(X, groups, t, signals=signals)
    clock = _times(t, len(X))
    if clock is None:
        clock = predictor.clock(None, len(X))
    states = predictor.states(X, groups)
    length = None if window is None else _length(window, dt)
    rows = _rows(asked, predictor.plan.standstill, length, dt)
    return SimulatedWindows(
        joint_names=predictor.joint_names_,
        prismatic=np.array(is_prismatic(predictor.features_.model_)),
        starts=rows[:, 0],
        t=clock[rows],
        positions=X[rows][..., :nv],
        velocities=states[rows][..., nv : 2 * nv],
        start_positions=states[rows[:, 0], :nv],
        simulated=np.full((*rows.shape, 3 * nv), np.nan),
    )


def _taken_over(beside, X, names):
    rows, nv = _rows_of(beside), len(names)
    same = beside.joint_names == names and rows.max() < len(X)
    if not (same and np.array_equal(beside.positions, X[rows][..., :nv])):
        raise ValueError(
            "beside must be windows of the same joints and rows of X; it holds "
            f"{beside.n_windows} windows of {', '.join(beside.joint_names)} with other "
            "positions."
        )
    return beside


def _torques(y, names, n_samples):
    """Check measured torques, (n, nv); a window names what is no number."""
    y = np.asarray(torques_in_order(y, names), dtype=float)
    y = y[:, None] if y.ndim == 1 and len(names) == 1 else y
    if y.shape != (n_samples, len(names)):
        raise ValueError(
            f"y must hold one row of torques for each of the {n_samples} rows of X and "
            f"one column for each joint ({', '.join(names)}); got shape {y.shape}."
        )
    return y


def _times(t, n_samples):
    """Check times of the rows (n,), which each window is simulated with; or None."""
    if t is None:
        return None
    t = np.asarray(t, dtype=float)
    if t.shape != (n_samples,):
        raise ValueError(
            f"t must hold one time per row, shape ({n_samples},); got {t.shape}."
        )
    return t


def _length(window, dt):
    if not (isinstance(window, Real) and dt <= window < np.inf):
        raise ValueError(
            f"window must be a time in seconds, at least the sample period {dt:g} s; "
            f"got {window!r}."
        )
    return round(window / dt)


def _rows(asked, standstill, length, dt):
    """Rows of the windows, (n_windows, length + 1); None as length is one of all."""
    inner = asked.counts(standstill)["position"]
    if length is None:
        return np.arange(int(np.argmax(inner.any(axis=1))), len(inner))[None]
    found = []
    for part in asked.recording.segments:
        first = part.start + int(np.argmax(inner[part].any(axis=1)))
        found += range(first, part.stop - length, length)
    if not found:
        longest = max(part.stop - part.start for part in asked.recording.segments)
        raise ValueError(
            f"No recording is as long as a window of {length * dt:g} s: the longest "
            f"has {longest} rows, {longest * dt:g} s, of which the ends are left out. "
            "Give shorter windows."
        )
    return np.array(found)[:, None] + np.arange(length + 1)


def warn_once(caught, where, stacklevel):
    """Pass on each kind of recorded warning once, and how often it came up."""
    # Texts that begin alike, up to a colon, are of one kind; where: what was repeated.
    kinds = {}
    for one in caught:
        kind = str(one.message).partition(":")[0]
        kinds.setdefault((one.category, kind), []).append(str(one.message))
    for (category, _), texts in kinds.items():
        many = f" (first of {len(texts)} {where})" if len(texts) > 1 else ""
        text = f"{texts[0].rstrip('.')}{many}."
        warnings.warn(text, category, stacklevel=stacklevel + 1)


def _rms(errors, axis):
    return np.sqrt(np.mean(errors**2, axis=axis))


# Why an effect of a torque channel is not simulated under a drive.
_AT_ONCE = "torques of the drive act at once"
# Share of a row by which rounding may move a time.
_JITTER = 1e-9
# Drives set their torque at least so often, in simulation [s].
_DRIVE_PERIOD = 1e-3


def unfollowed(effect):
    """Why a simulation under a drive goes without an effect; "" if it does not."""
    return effect.not_simulated or (_AT_ONCE if isinstance(effect, OfChannel) else "")


class CommandFollower:
    """A robot under its drive, with the commands of a recording as its only input."""

    # robot: `IdentifiedRobot`.

    def __init__(self, robot, drive, recording):
        names = recording.joint_names
        self._command = drive.commands(recording)
        self._late = (robot.plan.delay + (drive.waits or 0.0)) / recording.dt
        self._begins = np.array([part.start for part in recording.segments])
        self._gains = [
            np.broadcast_to(x, self._command.shape) for x in drive.law(names, recording)
        ]
        self._most = drive.most(names)
        self._model, self._dt = robot.torque_model(), recording.dt
        self._updates = drive.updates(recording.dt, _DRIVE_PERIOD)
        self._lags = np.maximum(velocity_lags(recording), 0.0)
        self._signals = {k: x for k, x in recording.signals.items() if x.ndim == 1}
        # effects that a simulation goes without, in words
        self.left_out = tuple(
            f"{one.name} on {names[one.joint]} ({unfollowed(one)})"
            for one in robot.effects_
            if unfollowed(one)
        )

    def warn_left_out(self, stacklevel):
        if self.left_out:
            warnings.warn(
                f"The simulation leaves out {'; '.join(self.left_out)}.",
                DoubtWarning,
                stacklevel=stacklevel + 1,
            )

    def run(self, rows, start, t):
        """Simulate rows, a slice, from a state (3 nv,) on; t (n,) is their time."""
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
    """Simulate a robot from its commands, from the states of a recording on."""
    # robot: `IdentifiedRobot`; window: length [s] after which it starts from the
    # recorded state again, None for whole recordings. Returns states (n, 3 nv).
    follower, clock = CommandFollower(robot, drive, recording), recording.clock()
    follower.warn_left_out(stacklevel=3)
    measured = robot.states(recording.inputs, recording.groups)
    length = recording.n_samples
    if window is not None:
        length = max(round(window / recording.dt), 2)
    parts = [
        slice(first, min(first + length, part.stop))
        for part in recording.segments
        for first in range(part.start, part.stop, length)
    ]
    found = [follower.run(rows, measured[rows.start], clock[rows]) for rows in parts]
    return np.concatenate(found)


def _seen_late(control, lags, dt, updates):
    """Let a controller see velocities that are late by lags (nv,) [s]."""
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
    """Let a drive follow commands (n, nv), each held until the next one."""
    # first: row that the simulation begins with; late: delay of the commands, in rows.
    kp, kd = (np.broadcast_to(x, command.shape) for x in (kp, kd))

    def control(row, q, v):
        i = min(int(first + row), len(command) - 1)
        k = min(max(int(np.floor(first + row - late + _JITTER)), 0), len(command) - 1)
        return np.clip(command[k] - kp[i] * q - kd[i] * v, -most, most)

    return control
