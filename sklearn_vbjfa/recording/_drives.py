"""Drives: control laws that give torques from commands, currents or voltages."""

from collections.abc import Mapping
from dataclasses import replace
from numbers import Real

import numpy as np
from sklearn.base import BaseEstimator

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa._core._smoothing import held, interpolate
from sklearn_vbjfa.recording._recording import check_dt

# Channels of joints that are commands, by their names in `Recording.signals`.
COMMANDS = ("q_desired", "v_desired", "tau_ff", "kp", "kd")
# Channels of joints that are what motors were given.
OF_MOTORS = ("current", "voltage", "supply")
# A joint that is at its limit of torque for a larger share of the rows shows nothing
# of what it would do.
_MOSTLY = 0.5
# Frequency below which drives' velocities are compared with the positions' [Hz].
_SLOW = 10.0
# Drives set their torque at least so often, if nothing else is known [s].
_PERIOD = 1e-3
# What was commanded before a recording is not known: longest delay, as a share of it.
_UNKNOWN = 0.1


class Drive(BaseEstimator):
    """Control law of the motors: channels that it takes, and torques that it makes.

    Its method `driven` takes a recording with the channels (n_samples, nv) of the drive
    in `signals`. It returns the recording with `tau` of the law at no delay, and
    `command`; it raises a ValueError if channels are missing or do not suit the drive.
    """

    channel = ""  # channel that `RobotIdentifier.fit` takes as y
    extra_channels: tuple[str, ...] = ()  # further channels of joints, in `signals`
    uses_positions = False  # whether torques are made of measured positions
    known_delay: float | None = 0.0  # of its commands [s]; None to estimate it
    unsigned = False  # whether only sizes of torques are known
    scale_parameter = ""  # setting by which its channel is multiplied
    gains: str | None = None  # "unknown" where torques are known up to factors
    # names of its channel in files that have it in place of torques
    aliases: tuple[str, ...] = ()

    def facts(self, recording):
        """Return what a report says of the drive, a dict of numbers and lists."""
        return {}

    def split_signals(self, y, signals):
        """Split signals that were given for a fit, with y, into those of the drive."""
        others = dict(signals or {})
        own = {name: others.pop(name) for name in self.extra_channels if name in others}
        return {self.channel: y, **own}, others if own else signals

    def _channel(self, recording, name):
        """Channel (n, nv) of a recording; None if it has none."""
        if name not in recording.signals:
            return None
        values = recording.signals[name].reshape(recording.n_samples, -1)
        # One supply feeds all joints.
        if values.shape[1] != recording.nv and (name, values.shape[1]) != ("supply", 1):
            raise ValueError(
                f"{name} must have one column per joint, shape {recording.q.shape}; "
                f"got {values.shape}."
            )
        return values

    def driven(self, recording):
        """Return a recording of the torques of its channel; see `Drive`.

        Without this channel the recorded torques are taken for it. `command` is None
        until signs are known.
        """
        tau, names = self._channel(recording, self.channel), recording.joint_names
        tau = recording.tau if tau is None else tau
        factor = self._setting(self.scale_parameter, names, recording)
        tau = tau if factor is None else tau * factor
        below = np.flatnonzero((tau < 0).any(axis=0)) if self.unsigned else ()
        if len(below):
            raise ValueError(
                f"{type(self).__name__}(signed=False) expects magnitudes, and "
                f"{names[below[0]]} has negative currents; use signed=True."
            )
        return replace(recording, tau=tau, command=None if self.unsigned else tau)

    def _setting(self, name, joints, recording=None):
        """Return a setting (nv,), or the channel (n, nv) of a recording, or None."""
        given, what = getattr(self, name), f"{type(self).__name__}: {name}"
        if given is None and recording is not None:
            return self._channel(recording, name)
        if isinstance(given, str) and given == "unknown":
            return None
        if isinstance(given, Mapping):
            given = [_of_joint(what, given, joint) for joint in joints]
        try:
            values = np.broadcast_to(np.asarray(given, dtype=float), len(joints)).copy()
        except (TypeError, ValueError):
            values = np.full(1, np.nan)
        if np.isnan(values).any():
            raise ValueError(
                f"{what} must be one number, or one for each joint in the order "
                f"{', '.join(joints)}; got {given!r}."
            )
        if name != "torque_constant" and (values < 0).any():
            raise ValueError(f"{what} must not be negative; got {given!r}.")
        return values


def _of_joint(what, given, joint):
    """Return the number that is given by a part of a joint's name."""
    keys = [joint] if joint in given else [key for key in given if key in joint]
    if len(keys) != 1:
        raise ValueError(
            f"{what} must have one key in each joint's name; {len(keys)} of "
            f"{', '.join(map(repr, given))} are in {joint!r}."
        )
    return given[keys[0]]


class PDDrive(Drive):
    r"""Position command with gains: motors of legged robots, position servos.

    .. math::

        \tau(t) = K_p\,(q_d(t - d) - q(t)) + K_d\,(v_d(t - d) - v(t))
                  + \tau_{ff}(t - d),

    whose gains are known and whose delay d is found: `RobotIdentifier` has it as a
    parameter ``drive:delay`` of the robot.

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
    period : float, default=None
        Time [s] for which the drive holds a torque, at most the sample period: a loop
        at 1 kHz has 1e-3. The feedback torque acts half a period late, which biases
        armature and damping by a few per cent. None neglects this.

    See Also
    --------
    RobotIdentifier : Takes it as `drive`.
    sklearn_vbjfa.effects.CommandDelay : The delay.

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
    >>> from sklearn_vbjfa.robot import PDDrive
    >>> PDDrive({"hip": 20.0, "knee": 40.0}, 1.0).law(["left_hip", "left_knee"])
    (array([20., 40.]), array([1., 1.]))
    """

    channel = "q_desired"
    uses_positions = True
    extra_channels = COMMANDS[1:]
    # settings to check if the order of magnitude of the torques is wrong
    numbers = (
        "kp [N m/rad] and kd [N m s/rad] (not per degree, nor in units of the "
        "firmware), and the unit of the positions"
    )

    def __init__(self, kp=None, kd=None, *, delay="auto", saturation=None, period=None):
        self.kp = kp
        self.kd = kd
        self.delay = delay
        self.saturation = saturation
        self.period = period

    @property
    def known_delay(self):
        """Known delay [s]; None if it is to be found."""
        if isinstance(self.delay, Real) and np.isfinite(self.delay):
            return float(self.delay)
        if not isinstance(self.delay, str) or self.delay != "auto":
            raise ValueError(
                f"PDDrive: delay must be 'auto' or a time in s; got {self.delay!r}."
            )
        return None

    def commands(self, recording):
        """Return the part of the torques (n_samples, nv) that follows from commands.

        A row acts from its time to that of the next one, a delay later [N m or N].
        """
        aim, rate, ahead = (
            self._channel(recording, name)
            for name in ("q_desired", "v_desired", "tau_ff")
        )
        if aim is None:
            raise ValueError(
                "PDDrive needs the channel 'q_desired' of each joint: give y=q_desired "
                "to fit, or columns q_desired_<joint> to the reader."
            )
        kp, kd = self.law(recording.joint_names, recording)
        command = kp * aim
        command = command if rate is None else command + kd * rate
        return command if ahead is None else command + ahead

    def driven(self, recording):
        """Return a recording of the torques that the law asks for; see `Drive`."""
        command = self.commands(recording)
        kp, kd = self.law(recording.joint_names, recording)
        parts, clock = recording.segments, recording.clock
        if _changes(recording.q, parts) and not _changes(command, parts):
            raise ValueError(
                "The commands are constant while joints move: they are not those that "
                "the robot followed. Record the commands of the same time and mode."
            )
        if self.known_delay is not None:
            check_delay(self.known_delay, recording)
        command = held(command, parts, clock, self.known_delay or 0.0)
        q, v = recording.q, velocities(recording)
        if self.period is not None:
            # A torque that is held acts half a period late; of the command it is a
            # part of the delay.
            late = 0.5 * recording.dt / self.updates_per_sample(recording.dt)
            q, v = (interpolate(x, parts, clock, late) for x in (q, v))
        tau = command - kp * q - kd * v
        shares = [np.mean(np.broadcast_to(x, tau.shape), axis=0) for x in (kp, kd)]
        made = replace(recording, tau=tau, command=command, feedback=np.array(shares))
        return made if self.saturation is None else self._saturated(made)

    def _saturated(self, recording):
        """Mark samples at the limit of torque, which the law does not tell."""
        names, most = recording.joint_names, self.torque_limits(recording.joint_names)
        full = np.abs(recording.tau) >= most
        share = full.mean(axis=0)
        j = int(np.argmax(share))
        if share[j] > _MOSTLY:
            raise ValueError(
                f"{names[j]} is at its limit of {most[j]:.4g} for "
                f"{100 * share[j]:.0f} % of the samples: its torque is unreliable. "
                "Check the limit, or record a slower motion."
            )
        weight = np.ones(full.shape) if recording.weight is None else recording.weight
        return replace(
            recording,
            tau=np.clip(recording.tau, -most, most),
            weight=np.where(full, 0.0, weight),
        )

    def facts(self, recording):
        """Delay as given [s] or None, and the share of each joint at its limit."""
        most = self.torque_limits(recording.joint_names)
        share = (np.abs(recording.tau) >= most).mean(axis=0)
        return {"delay": self.known_delay, "saturated": share.tolist()}

    # -- in simulation -----------------------------------------------------------------

    def updates_per_sample(self, dt):
        """Return how often torques are set in a sample period."""
        if self.period is None:
            return max(round(dt / _PERIOD), 1)
        # A hundredth of a period is the jitter of clocks.
        if not (isinstance(self.period, Real) and 0 < self.period <= 1.01 * dt):
            raise ValueError(
                "PDDrive: period must be a positive time in s, at most the sample "
                f"period of {dt:g} s; got {self.period!r}."
            )
        return max(round(dt / self.period), 1)

    def torque_limits(self, names):
        """Return the largest torque of joints, (nv,); infinite where none is given."""
        if self.saturation is None:
            return np.full(len(names), np.inf)
        return self._setting("saturation", names)

    def law(self, names, recording=None):
        """Gains of position and velocity, (nv,) or, if recorded, (n, nv)."""
        found = {x: self._setting(x, names, recording) for x in ("kp", "kd")}
        for name, values in found.items():
            if values is None:
                raise ValueError(
                    f"PDDrive: {name} is missing: give {name}=, a number for each of "
                    f"{', '.join(names)}, or record columns {name}_<joint> (command "
                    'line: --drive "pd kp=20,20,40 kd=...").'
                )
            if (values < 0).any():
                raise ValueError(f"PDDrive: {name} must not be negative.")
        return tuple(found.values())


class CurrentDrive(Drive):
    r"""Motor currents, signed or as sizes.

    .. math:: \tau = k_t \, i

    Parameters
    ----------
    torque_constant : "unknown", float or array-like of shape (nv,), default="unknown"
        Torque of the joint by current, gear ratio included, k_t [N m/A]. ``"unknown"``
        does not change y and finds the gains of the channels, as ``gains="unknown"``.
    signed : bool, default=True
        Whether currents have their sign. False for sizes, as some drives log them: the
        sign is then that of the torque of the model, and both signs in proportion to
        their probability where that is near zero.

    Examples
    --------
    >>> from sklearn_vbjfa.robot import CurrentDrive
    >>> CurrentDrive(torque_constant=5.0)
    CurrentDrive(torque_constant=5.0)
    """

    channel = "current"
    scale_parameter = "torque_constant"
    aliases = ("current", "motor_current", "present_current")

    def __init__(self, torque_constant="unknown", *, signed=True):
        self.torque_constant = torque_constant
        self.signed = signed

    @property
    def gains(self):
        """Unknown, if the torque constant is."""
        return "unknown" if isinstance(self.torque_constant, str | None) else None

    @property
    def unsigned(self):
        """Whether only sizes of torques are known."""
        return not self.signed


class VoltageDrive(Drive):
    r"""Motor voltage, or duty cycle times supply: hobby servos, Dynamixel in PWM mode.

    .. math:: \tau = \frac{k_t}{R} V - \frac{k_t^2}{R} v

    Torques are in volts. Their gains are found, as with ``gains="unknown"``.

    Parameters
    ----------
    supply : float, array-like of shape (nv,), dict or None, default=None
        Voltage of the supply, by which a duty cycle is multiplied; None takes the
        channel ``supply`` of the recording, or y for volts.

    References
    ----------
    .. [1] M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended friction models for
       the physics simulation of servo actuators", ICRA 2025.

    Examples
    --------
    >>> from sklearn_vbjfa.robot import VoltageDrive
    >>> VoltageDrive(supply=7.4)
    VoltageDrive(supply=7.4)
    """

    channel = "voltage"
    scale_parameter = "supply"
    gains = "unknown"
    extra_channels = ("supply",)
    aliases = ("voltage", "duty", "pwm", "pwm_duty", "present_pwm")

    def __init__(self, *, supply=None):
        self.supply = supply


def _changes(values, parts):
    """Whether a channel (n, nv) changes inside any recording."""
    return any(np.ptp(values[part], axis=0).any() for part in parts)


def check_delay(delay, recording):
    """Refuse a delay [s] before which too much of a recording has no known command."""
    time = check_dt(recording.dt) * recording.n_samples / len(recording.segments)
    if abs(delay) > _UNKNOWN * time:
        raise ValueError(
            f"The delay of the commands is {delay:.3g} s, more than a tenth of a "
            f"recording of {time:.3g} s: first commands are unknown. Record longer, or "
            "shift the commands; delay is in seconds."
        )


def velocities(recording):
    """Velocities (n, nv): those of states, or slopes of the positions, as they came."""
    # Drives make theirs of the same encoder, some milliseconds late by a filter, and
    # what they log has noise of the whole band: only its lag is taken.
    if recording.states is not None:
        return recording.states[:, recording.nv : 2 * recording.nv]
    q, known = recording.q, (recording.segments, recording.clock)
    lags = velocity_lags(recording).tolist()
    return np.column_stack(
        [interpolate(q[:, j], *known, lag, order=1) for j, lag in enumerate(lags)]
    )


def velocity_lags(recording):
    """Delay (nv,) of recorded velocities [s], zeros where there are none."""
    # By least squares on accelerations, where the motion is.
    if recording.states is not None or recording.v is None:
        return np.zeros(recording.nv)
    q, parts, clock = recording.q, recording.segments, recording.clock
    lowpass = _lowpass.design(recording.dt, min(_SLOW, 0.2 / recording.dt))
    long = [part for part in parts if part.stop - part.start > 2 * lowpass.half]
    if not long:
        return np.zeros(recording.nv)
    # Accelerations of all rows: filtered ones are further apart.
    slope, bend = (interpolate(q, parts, clock, order=k) for k in (1, 2))
    own, theirs, faster = (
        np.concatenate([lowpass(x[part]) for part in long])
        for x in (slope, recording.v, bend)
    )
    power = (faster**2).sum(axis=0)
    return ((own - theirs) * faster).sum(axis=0) / np.where(power > 0, power, 1.0)


# Drives by the name that a text begins with.
DRIVES = {"pd": PDDrive, "current": CurrentDrive, "voltage": VoltageDrive}


def parse_drive(text):
    """Return the drive that a text says, such as "pd kp=20,20,40 kd=1 delay=auto"."""
    kind, *parts = text.split() or [""]
    if kind not in DRIVES:
        raise ValueError(
            f"drive must begin with its kind, one of {', '.join(DRIVES)}, such as "
            f'"pd kp=20,20,40 kd=1,1,2"; got {text!r}.'
        )
    known, given = list(DRIVES[kind]().get_params()), {}
    for part in parts:
        name, _, value = part.partition("=")
        if name not in known or not value or name in given:
            raise ValueError(
                f"drive has {part!r}; expected, each once, NAME=VALUE without blanks, "
                f"of {', '.join(known)}."
            )
        given[name] = _SWITCHES[value] if value in _SWITCHES else _numbers(part, value)
    return DRIVES[kind](**given)


_SWITCHES = {"none": None, "true": True, "yes": True, "false": False, "no": False}


def _numbers(part, text):
    """Return the number of NAME=VALUE, several, several by joints' names, or a word."""
    pairs = [x.rpartition(":")[::2] for x in text.split(",")]
    joints, values = {joint for joint, _ in pairs}, [value for _, value in pairs]
    try:
        values = np.array(values, dtype=float).tolist()
    except ValueError:
        if len(pairs) == 1 and joints == {""}:
            # The drive knows the word or refuses it.
            return text
        values = [np.nan]
    by_joint = "" not in joints and len(joints) == len(pairs)
    if not np.isfinite(values).all() or not (by_joint or joints == {""}):
        raise ValueError(
            f"drive has {part}; expected numbers, or JOINT:NUMBER with commas between "
            "them, each joint, or part of its name, once."
        )
    if by_joint:
        return {joint: value for (joint, _), value in zip(pairs, values)}
    return values if len(values) > 1 else values[0]
