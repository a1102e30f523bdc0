"""Drives: what a robot is told in place of torques, and the torques that follow.

A drive turns a recording of commands into one of torques. Of what it was told, the part
that follows from commands alone is kept as `Recording.command`: a delay moves that part
and not the one that the drive makes of the positions it measures.
"""

from collections.abc import Mapping
from dataclasses import replace
from numbers import Real

import numpy as np
from sklearn.base import BaseEstimator

from sklearn_vbjfa._core._between import between
from sklearn_vbjfa.recording._recording import check_dt

# Channels of joints that are commands, by their names in `Recording.signals`.
COMMANDS = ("q_desired", "v_desired", "tau_ff", "kp", "kd")
# A joint that is at its limit of torque for a larger share of the rows shows nothing
# of what it would do.
_MOSTLY = 0.5
# Commands that vary less than this share of the motion do not move the joint.
_STILL = 1e-6


class Drive(BaseEstimator):
    """What a robot is told in place of torques, one object for all joints.

    Attributes
    ----------
    told : str
        Name of the channel that `RobotIdentifier.fit` takes as y.
    beside : tuple of str
        Names of further channels of joints that it takes in `signals`.
    """

    told = ""
    beside = ()

    def driven(self, recording):
        """Return a recording whose torques are what the drive was told.

        Parameters
        ----------
        recording : Recording
            Positions, and in `signals` the channels (n_samples, nv) of the drive.

        Returns
        -------
        Recording
            With `tau`, at no delay, and `command`.

        Raises
        ------
        ValueError
            If channels are missing, or do not suit the drive.
        """
        raise NotImplementedError(
            f"{type(self).__name__} must define driven(recording)."
        )

    def taken(self, y, signals):
        """Split signals that were given for a fit, with y, into those of the drive."""
        signals = {} if signals is None else dict(signals)
        own = {name: signals.pop(name) for name in self.beside if name in signals}
        return {self.told: y, **own}, signals

    def _channel(self, recording, name, needed=False):
        """Channel (n, nv) of a recording; None if it has none."""
        values = recording.signals.get(name)
        if values is None:
            if needed:
                raise ValueError(
                    f"{type(self).__name__} needs the channel {name!r} of each joint: "
                    f"give y={name} to fit, or columns {name}_<joint> to the reader."
                )
            return None
        values = np.asarray(values, dtype=float)
        if values.ndim == 1:
            values = values[:, None]
        shape = (recording.n_samples, recording.nv)
        if values.shape != shape:
            raise ValueError(
                f"{name} must have one row per sample and one column per joint, shape "
                f"{shape}; got {values.shape}."
            )
        bad = np.argwhere(~np.isfinite(values))
        if bad.size:
            raise ValueError(
                f"{name} holds {values[tuple(bad[0])]} in row {bad[0][0]}, joint "
                f"{recording.joint_names[bad[0][1]]}; leave such rows out."
            )
        return values


class PDDrive(Drive):
    r"""Position command with gains: motors of legged robots, position servos.

    .. math::

        \tau(t) = K_p\,(q_d(t - d) - q(t)) + K_d\,(v_d(t - d) - v(t))
                  + \tau_{ff}(t - d),

    whose gains are known and whose delay d is found: `RobotIdentifier` has it as a
    parameter ``drive:delay`` of the robot. With measured torques beside it, as
    `controller`, it closes the simulated loop.

    Parameters
    ----------
    kp : float, array-like of shape (nv,), dict or None, default=None
        Gain of the position [N m/rad or N/m]; as dict by parts of the joints' names,
        ``{"hip": 20, "thigh": 20, "calf": 40}``. None takes the channel ``kp`` of the
        recording.
    kd : float, array-like of shape (nv,), dict or None, default=None
        Gain of the velocity [N m s/rad or N s/m]. None takes the channel ``kd``.
    delay : "auto" or float, default="auto"
        Time [s] from the log's command to its effect. ``"auto"`` estimates it.
    saturation : float, array-like of shape (nv,), dict or None, default=None
        Largest torque of a joint [N m or N]. Samples that reach it are left out.
    gear : float or array-like of shape (nv,), default=1.0
        Factor of the law's torque, where gains are those of the motor.
    feedforward : bool, default=False
        Whether a drive without ``v_desired`` takes the slope of ``q_desired`` for it,
        and not zero.
    period : float, default=None
        Time [s] for which the drive holds a torque in simulation, at most the sample
        period; None is that. A loop that is stable at its own rate need not be so at
        that of a slow recording.

    See Also
    --------
    RobotIdentifier : Takes it as `drive`, or as `controller`.
    sklearn_vbjfa.effects.CommandDelay : The delay.

    Notes
    -----
    The velocity is that of the recording (`Recording.v`, the drive's own estimate), or
    the slope of the positions. The log's commands are taken as exact.

    References
    ----------
    .. [1] M. Brunot, A. Janot, P. C. Young, F. Carrillo, "An improved instrumental
       variable method for industrial robot model identification", Control Engineering
       Practice 74, 2018. :doi:`10.1016/j.conengprac.2018.02.010`
    .. [2] M. Gautier, A. Janot, P.-O. Vandanjon, "A new closed-loop output error method
       for parameter identification of robot dynamics", IEEE Trans. Control Syst.
       Technol. 21(2), 2013. :doi:`10.1109/TCST.2012.2185697`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.robot import PDDrive
    >>> drive = PDDrive(kp=100.0, kd=5.0)
    >>> drive.torque(np.array([0.2]), np.array([0.0]), np.array([0.1]),
    ...              np.array([1.0]))
    array([5.])
    """

    told = "q_desired"
    beside = COMMANDS[1:]

    def __init__(
        self,
        kp=None,
        kd=None,
        *,
        delay="auto",
        saturation=None,
        gear=1.0,
        feedforward=False,
        period=None,
    ):
        self.kp = kp
        self.kd = kd
        self.delay = delay
        self.saturation = saturation
        self.gear = gear
        self.feedforward = feedforward
        self.period = period

    @property
    def waits(self):
        """Known delay [s]; None if it is to be found."""
        if isinstance(self.delay, str) and self.delay == "auto":
            return None
        if not (isinstance(self.delay, Real) and np.isfinite(self.delay)):
            raise ValueError(
                f"PDDrive: delay must be 'auto' or a time in s; got {self.delay!r}."
            )
        return float(self.delay)

    def driven(self, recording):
        """Return a recording of the torques that the law asks for; see `Drive`."""
        if recording.command is not None and self.waits is None:
            return recording
        names = recording.joint_names
        aim = self._channel(recording, "q_desired", needed=True)
        self._check_aim(aim, recording)
        kp, kd = (
            self._recorded(recording, name, getattr(self, name))
            for name in ("kp", "kd")
        )
        gear = _by_joint("gear", self.gear, names, least=None)
        dt = check_dt(recording.dt)
        parts = recording.segments
        clock = dt * np.arange(recording.n_samples)
        rate = self._channel(recording, "v_desired")
        if rate is None:
            rate = between(aim, parts, clock, order=1) if self.feedforward else 0.0
        ahead = self._channel(recording, "tau_ff")
        command = gear * (kp * aim + kd * rate + (0.0 if ahead is None else ahead))
        if self.waits is not None:
            command = between(command, parts, clock, self.waits)
        v = recording.v
        if v is None and recording.states is not None:
            v = recording.states[:, recording.nv : 2 * recording.nv]
        if v is None:
            v = between(recording.q, parts, clock, order=1)
        tau = command - gear * (kp * recording.q + kd * v)
        made = replace(recording, tau=tau, command=command)
        made = made if self.waits is None else replace(made, command=None)
        return made if self.saturation is None else self._saturated(made)

    def _recorded(self, recording, name, given):
        """Gain, (nv,) or (n, nv), from the drive or the recording."""
        if given is not None:
            return _by_joint(name, given, recording.joint_names)
        values = self._channel(recording, name)
        if values is None:
            raise ValueError(
                f"PDDrive: {name} is missing: give {name}=, a number for each joint "
                f"({', '.join(recording.joint_names)}), or record columns "
                f"{name}_<joint>. Gains of the firmware stand in the robot's "
                "configuration; in other units, torques are in those."
            )
        if (values < 0).any():
            raise ValueError(f"PDDrive: {name} of the recording is negative.")
        return values

    def _check_aim(self, aim, recording):
        """Refuse commands that do not vary where the joints move."""
        still = np.ptp(aim, axis=0) <= _STILL * np.ptp(recording.q, axis=0)
        moving = np.ptp(recording.q, axis=0) > 0
        if moving.any() and still[moving].all():
            raise ValueError(
                "q_desired is constant on every joint that moves: commands of another "
                "time, or of another mode of the drive. Record the commands that the "
                "robot followed."
            )

    def _saturated(self, recording):
        """Mark samples at the limit of torque, which the law does not tell."""
        names = recording.joint_names
        most = _by_joint("saturation", self.saturation, names)
        full = np.abs(recording.tau) >= most
        share = full.mean(axis=0)
        j = int(np.argmax(share))
        if share[j] > _MOSTLY:
            raise ValueError(
                f"{names[j]} is at its limit of {most[j]:.4g} for "
                f"{100 * share[j]:.0f} % of the samples: its law says little of its "
                "torque. Check the limit, or record a gentler motion."
            )
        weight = np.ones(full.shape) if recording.weight is None else recording.weight
        return replace(
            recording,
            tau=np.clip(recording.tau, -most, most),
            weight=np.where(full, 0.0, weight),
        )

    # -- in simulation -----------------------------------------------------------------

    def updates(self, dt):
        """Return how often torques are set in a sample period.

        Parameters
        ----------
        dt : float
            Sample period of the recording [s].

        Returns
        -------
        int
            Number of updates, at least one.

        Raises
        ------
        ValueError
            If `period` is no positive time, or longer than the sample period.
        """
        if self.period is None:
            return 1
        try:
            period = float(self.period)
        except (TypeError, ValueError):
            period = np.nan
        # A hundredth of a period is the jitter of clocks.
        if not 0 < period <= 1.01 * dt:
            raise ValueError(
                "PDDrive: period must be a positive time in s, at most the sample "
                f"period of {dt:g} s; got {self.period!r}."
            )
        return max(round(dt / period), 1)

    def gains(self, names):
        """Gains of position and velocity of joints, with the gear.

        Parameters
        ----------
        names : sequence of str
            Names of the joints.

        Returns
        -------
        kp, kd : ndarray of shape (nv,)
            Gains.

        Raises
        ------
        ValueError
            If they are missing, not finite, negative, or of another number of joints.
        """
        for name in ("kp", "kd"):
            if getattr(self, name) is None:
                raise ValueError(
                    f"PDDrive: {name} is missing: give {name}=, one for each joint."
                )
        gear = _by_joint("gear", self.gear, names, least=None)
        return tuple(
            gear * _by_joint(name, getattr(self, name), names) for name in ("kp", "kd")
        )

    def torque(self, q_desired, v_desired, q, v, names=None):
        """Torques of the law at no delay.

        Parameters
        ----------
        q_desired, v_desired : ndarray of shape (..., nv)
            Command [rad or m, and per s].
        q, v : ndarray of shape (..., nv)
            State.
        names : sequence of str, default=None
            Names of the joints, for gains by name.

        Returns
        -------
        ndarray of shape (..., nv)
            Torques, in the unit of the gains, within `saturation`.
        """
        nv = np.shape(q)[-1]
        names = [str(j) for j in range(nv)] if names is None else names
        kp, kd = self.gains(names)
        tau = kp * (q_desired - q) + kd * (v_desired - v)
        if self.saturation is not None:
            most = _by_joint("saturation", self.saturation, names)
            tau = np.clip(tau, -most, most)
        return tau


def _by_joint(name, given, joints, least=0.0):
    """Return one number for each of some joints, (nv,), as given in one of the ways."""
    if isinstance(given, Mapping):
        return _by_name(name, given, joints, least)
    try:
        values = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        values = np.full(0, np.nan)
    nv = len(joints)
    if values.shape not in {(), (nv,)} or not np.isfinite(values).all():
        raise ValueError(
            f"PDDrive: {name} must be one finite number or {nv}, one for each joint in "
            f"the order {', '.join(joints)}; got {given!r}."
        )
    if least is not None and (values < least).any():
        raise ValueError(
            f"PDDrive: {name} is negative, which drives a joint away from its command; "
            f"got {given!r}."
        )
    return np.broadcast_to(values, (nv,)).copy()


def _by_name(name, given, joints, least):
    """Numbers (nv,) of joints by parts of their names."""
    found = []
    for joint in joints:
        own = [key for key in given if key in joint]
        exact = [key for key in own if key == joint]
        own = exact or own
        if len(own) != 1:
            said = f"{len(own)} of its keys are" if own else "none of its keys is"
            raise ValueError(
                f"PDDrive: {name} must have one key in each joint's name; {said} in "
                f"{joint!r}: {', '.join(map(repr, own or given))}."
            )
        found.append(given[own[0]])
    return _by_joint(name, found, joints, least)
