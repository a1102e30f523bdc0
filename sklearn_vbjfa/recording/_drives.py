"""Drives: control laws that map commands, currents or voltages to torques."""

from collections.abc import Mapping
from dataclasses import replace
from numbers import Real

import numpy as np
from sklearn.base import BaseEstimator

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa._core._smoothing import interpolate, zero_order_hold
from sklearn_vbjfa.recording._recording import check_dt

# Names of command channels of joints in `Recording.signals`.
COMMANDS = ("q_desired", "v_desired", "tau_ff", "kp", "kd")
# Names of motor channels: current, voltage and supply voltage.
OF_MOTORS = ("current", "voltage", "supply")
# A joint that is saturated in a larger share of the samples is refused.
_MAX_SATURATED = 0.5
# Cut-off frequency for the lag of recorded velocities against positions [Hz].
_LAG_CUTOFF = 10.0
# Control period of drives in simulation, if it is not given [s].
_DEFAULT_PERIOD = 1e-3
# Maximum delay as a share of a recording: commands before its start are unknown.
_MAX_DELAY = 0.1


class Drive(BaseEstimator):
    """Control law of the motors, which computes torques from recorded channels.

    The method `driven` takes a recording with the channels (n_samples, nv) of the drive
    in `signals`. It returns the recording with `tau` by the law without delay, and
    `command`; it raises a ValueError if channels are missing or do not fit the drive.
    """

    channel = ""  # channel passed as y to `RobotIdentifier.fit`
    extra_channels: tuple[str, ...] = ()  # further channels of joints, in `signals`
    uses_positions = False  # whether torques depend on measured positions
    known_delay: float | None = 0.0  # of its commands [s]; None to estimate it
    unsigned = False  # whether only magnitudes of torques are known
    scale_parameter = ""  # parameter that multiplies the channel
    gains: str | None = None  # "unknown" where torques are known up to factors
    # column names of the channel in files that contain it instead of torques
    aliases: tuple[str, ...] = ()

    def facts(self, recording):
        """Return data on the drive for the report, a dict of numbers and lists."""
        return {}

    def split_signals(self, y, signals):
        """Split y and the signals of a fit into channels of the drive and others."""
        others = dict(signals or {})
        channels = {x: others.pop(x) for x in self.extra_channels if x in others}
        return {self.channel: y, **channels}, others if channels else signals

    def _channel(self, recording, name):
        """Return a channel (n, nv) of a recording, None if missing."""
        if name not in recording.signals:
            return None
        values = recording.signals[name].reshape(recording.n_samples, -1)
        # A single supply voltage may feed all joints.
        if values.shape[1] != recording.nv and (name, values.shape[1]) != ("supply", 1):
            raise ValueError(
                f"{name} must have one column per joint, shape {recording.q.shape}; "
                f"got {values.shape}."
            )
        return values

    def driven(self, recording):
        """Return a recording with the torques of the channel; see `Drive`.

        If the channel is missing, the recorded torques are used instead. `command` is
        None if signs are unknown.
        """
        tau, names = self._channel(recording, self.channel), recording.joint_names
        tau = recording.tau if tau is None else tau
        factor = self._setting(self.scale_parameter, names, recording)
        tau = tau if factor is None else tau * factor
        negative = np.flatnonzero((tau < 0).any(axis=0)) if self.unsigned else ()
        if len(negative):
            raise ValueError(
                f"{type(self).__name__}(signed=False) expects magnitudes, and "
                f"{names[negative[0]]} has negative currents; use signed=True."
            )
        return replace(recording, tau=tau, command=None if self.unsigned else tau)

    def _setting(self, name, joints, recording=None):
        """Return a parameter (nv,), a recorded channel (n, nv) if not set, or None."""
        value, label = getattr(self, name), f"{type(self).__name__}: {name}"
        if value is None and recording is not None:
            return self._channel(recording, name)
        if isinstance(value, str) and value == "unknown":
            return None
        if isinstance(value, Mapping):
            value = [_joint_value(label, value, joint) for joint in joints]
        try:
            values = np.broadcast_to(np.asarray(value, dtype=float), len(joints)).copy()
        except (TypeError, ValueError):
            values = np.full(1, np.nan)
        if np.isnan(values).any():
            raise ValueError(
                f"{label} must be one number, or one for each joint in the order "
                f"{', '.join(joints)}; got {value!r}."
            )
        if name != "torque_constant" and (values < 0).any():
            raise ValueError(f"{label} must not be negative; got {value!r}.")
        return values


def _joint_value(label, settings, joint):
    """Return the value of a joint from a dict whose keys are parts of joint names."""
    keys = [joint] if joint in settings else [key for key in settings if key in joint]
    if len(keys) != 1:
        raise ValueError(
            f"{label} must have one key in each joint's name; {len(keys)} of "
            f"{', '.join(map(repr, settings))} are in {joint!r}."
        )
    return settings[keys[0]]


class PDDrive(Drive):
    r"""Position command with gains: motors of legged robots, position servos.

    .. math::

        \tau(t) = K_p\,(q_d(t - d) - q(t)) + K_d\,(v_d(t - d) - v(t))
                  + \tau_{ff}(t - d),

    with known gains and a delay d that is estimated: `RobotIdentifier` has it as the
    parameter ``drive:delay``.

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

    def __init__(self, kp=None, kd=None, *, delay="auto", saturation=None, period=None):
        self.kp = kp
        self.kd = kd
        self.delay = delay
        self.saturation = saturation
        self.period = period

    @property
    def known_delay(self):
        """Given delay [s], None if it is to be estimated."""
        if isinstance(self.delay, Real) and np.isfinite(self.delay):
            return float(self.delay)
        if not isinstance(self.delay, str) or self.delay != "auto":
            raise ValueError(
                f"PDDrive: delay must be 'auto' or a time in s; got {self.delay!r}."
            )
        return None

    def commands(self, recording):
        """Return the part of the torques (n, nv) due to commands alone [N m or N].

        Each row acts from its time to the time of the next row, plus the delay.
        """
        channels = (self._channel(recording, name) for name in COMMANDS[:3])
        position, velocity, feedforward = channels
        if position is None:
            raise ValueError(
                "PDDrive needs the channel 'q_desired' of each joint: give y=q_desired "
                "to fit, or columns q_desired_<joint> to the reader."
            )
        kp, kd = self.law(recording.joint_names, recording)
        command = kp * position
        command = command if velocity is None else command + kd * velocity
        return command if feedforward is None else command + feedforward

    def driven(self, recording):
        """Return a recording with the torques of the control law; see `Drive`."""
        command = self.commands(recording)
        kp, kd = self.law(recording.joint_names, recording)
        parts, clock = recording.segments, recording.clock
        if _varies(recording.q, parts) and not _varies(command, parts):
            raise ValueError(
                "The commands are constant while joints move: they are not those that "
                "the robot followed. Record the commands of the same time and mode."
            )
        if self.known_delay is not None:
            check_delay(self.known_delay, recording)
        command = zero_order_hold(command, parts, clock, self.known_delay or 0.0)
        q, v = recording.q, velocities(recording)
        if self.period is not None:
            # A zero-order hold delays the feedback by half a control period on average.
            # For the command, this is part of the estimated delay.
            hold_delay = 0.5 * recording.dt / self.updates_per_sample(recording.dt)
            q, v = (interpolate(x, parts, clock, hold_delay) for x in (q, v))
        tau = command - kp * q - kd * v
        gains = [np.mean(np.broadcast_to(x, tau.shape), axis=0) for x in (kp, kd)]
        driven = replace(recording, tau=tau, command=command, feedback=np.array(gains))
        return driven if self.saturation is None else self._exclude_saturated(driven)

    def _exclude_saturated(self, recording):
        """Set the weights of saturated samples to zero and clip their torques."""
        names, limits = recording.joint_names, self.torque_limits(recording.joint_names)
        mask = np.abs(recording.tau) >= limits
        share = mask.mean(axis=0)
        j = int(np.argmax(share))
        if share[j] > _MAX_SATURATED:
            raise ValueError(
                f"{names[j]} is at its limit of {limits[j]:.4g} for "
                f"{100 * share[j]:.0f} % of the samples: its torque is unreliable. "
                "Check the limit, or record a slower motion."
            )
        weight = np.ones(mask.shape) if recording.weight is None else recording.weight
        return replace(
            recording,
            tau=np.clip(recording.tau, -limits, limits),
            weight=np.where(mask, 0.0, weight),
        )

    def facts(self, recording):
        """Return the given delay [s] or None, saturated shares, and known signals."""
        limits = self.torque_limits(recording.joint_names)
        share = (np.abs(recording.tau) >= limits).mean(axis=0)
        known = {"v_desired": "v_desired" in recording.signals}
        return {"delay": self.known_delay, "saturated": share.tolist()} | known

    def updates_per_sample(self, dt):
        """Return the number of control periods in a sample period."""
        if self.period is None:
            return max(round(dt / _DEFAULT_PERIOD), 1)
        # One per cent of a period allows for clock jitter.
        if not (isinstance(self.period, Real) and 0 < self.period <= 1.01 * dt):
            raise ValueError(
                "PDDrive: period must be a positive time in s, at most the sample "
                f"period of {dt:g} s; got {self.period!r}."
            )
        return max(round(dt / self.period), 1)

    def torque_limits(self, names):
        """Return the torque limits of joints (nv,), infinite if not given."""
        if self.saturation is None:
            return np.full(len(names), np.inf)
        return self._setting("saturation", names)

    def law(self, names, recording=None):
        """Return position and velocity gains, (nv,) or, if recorded, (n, nv)."""
        gains = {x: self._setting(x, names, recording) for x in ("kp", "kd")}
        for name, values in gains.items():
            if values is None:
                raise ValueError(
                    f"PDDrive: {name} is missing: give {name}=, a number for each of "
                    f"{', '.join(names)}, or record columns {name}_<joint> (command "
                    'line: --drive "pd kp=20,20,40 kd=...").'
                )
            if (values < 0).any():
                raise ValueError(f"PDDrive: {name} must not be negative.")
        return tuple(gains.values())


class CurrentDrive(Drive):
    r"""Motor currents, signed or as magnitudes.

    .. math:: \tau = k_t \, i

    Parameters
    ----------
    torque_constant : "unknown", float or array-like of shape (nv,), default="unknown"
        Torque of the joint by current, gear ratio included, k_t [N m/A]. ``"unknown"``
        keeps y unchanged and estimates the gains, as with ``gains="unknown"``.
    signed : bool, default=True
        Whether currents are signed. False for magnitudes, as some drives log them: the
        sign is then that of the modelled torque, or, where this is near zero, both
        signs weighted by their probability.
    """

    channel = "current"
    scale_parameter = "torque_constant"
    aliases = ("current", "motor_current", "present_current")

    def __init__(self, torque_constant="unknown", *, signed=True):
        self.torque_constant = torque_constant
        self.signed = signed

    @property
    def gains(self):
        """Gains: "unknown" without a torque constant, else None."""
        return "unknown" if isinstance(self.torque_constant, str | None) else None

    @property
    def unsigned(self):
        """Whether only magnitudes of torques are known."""
        return not self.signed


class VoltageDrive(Drive):
    r"""Motor voltage, or duty cycle times supply: hobby servos, Dynamixel in PWM mode.

    .. math:: \tau = \frac{k_t}{R} V - \frac{k_t^2}{R} v

    Torques are in volts. Their gains are estimated, as with ``gains="unknown"``.

    Parameters
    ----------
    supply : float, array-like of shape (nv,), dict or None, default=None
        Voltage of the supply, by which a duty cycle is multiplied; None takes the
        channel ``supply`` of the recording, or y for volts.

    References
    ----------
    .. [1] M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended friction models for
       the physics simulation of servo actuators", ICRA 2025.
    """

    channel = "voltage"
    scale_parameter = "supply"
    gains = "unknown"
    extra_channels = ("supply",)
    aliases = ("voltage", "duty", "pwm", "pwm_duty", "present_pwm")

    def __init__(self, *, supply=None):
        self.supply = supply


def _varies(values, parts):
    """Return whether a channel (n, nv) varies within any recording."""
    return any(np.ptp(values[part], axis=0).any() for part in parts)


def check_delay(delay, recording):
    """Refuse a delay [s] that leaves too much of a recording without commands."""
    time = check_dt(recording.dt) * recording.n_samples / len(recording.segments)
    if abs(delay) > _MAX_DELAY * time:
        raise ValueError(
            f"The delay of the commands is {delay:.3g} s, more than a tenth of a "
            f"recording of {time:.3g} s: first commands are unknown. Record longer, or "
            "shift the commands; delay is in seconds."
        )


def velocities(recording):
    """Return velocities (n, nv) of states, or of positions delayed as in the drive."""
    # Drives filter the velocity of the same encoder, which delays it by milliseconds.
    # The logged velocity is noisy at all frequencies: only its lag is used.
    if recording.states is not None:
        return recording.states[:, recording.nv : 2 * recording.nv]
    q, rows = recording.q, (recording.segments, recording.clock)
    lags = velocity_lags(recording).tolist()
    return np.column_stack(
        [interpolate(q[:, j], *rows, lag, order=1) for j, lag in enumerate(lags)]
    )


def velocity_lags(recording):
    """Return the delay (nv,) of recorded velocities [s], zeros if not recorded."""
    # Least squares of the velocity difference on accelerations, at low frequencies.
    if recording.states is not None or recording.v is None:
        return np.zeros(recording.nv)
    q, parts, clock = recording.q, recording.segments, recording.clock
    lowpass = _lowpass.design(recording.dt, min(_LAG_CUTOFF, 0.2 / recording.dt))
    used = [part for part in parts if part.stop - part.start > 2 * lowpass.half]
    if not used:
        return np.zeros(recording.nv)
    # Differentiate at the full sampling rate, before the low-pass decimates.
    velocity, acceleration = (interpolate(q, parts, clock, order=k) for k in (1, 2))
    v, v_recorded, a = (
        np.concatenate([lowpass(x[part]) for part in used])
        for x in (velocity, recording.v, acceleration)
    )
    power = (a**2).sum(axis=0)
    return ((v - v_recorded) * a).sum(axis=0) / np.where(power > 0, power, 1.0)


# Drives by the first word of a text.
DRIVES = {"pd": PDDrive, "current": CurrentDrive, "voltage": VoltageDrive}


def parse_drive(text):
    """Parse a drive from a text such as "pd kp=20,20,40 kd=1 delay=auto"."""
    kind, *parts = text.split() or [""]
    if kind not in DRIVES:
        raise ValueError(
            f"drive must begin with its kind, one of {', '.join(DRIVES)}, such as "
            f'"pd kp=20,20,40 kd=1,1,2"; got {text!r}.'
        )
    allowed, params = list(DRIVES[kind]().get_params()), {}
    for part in parts:
        name, _, value = part.partition("=")
        if name not in allowed or not value or name in params:
            raise ValueError(
                f"drive has {part!r}; expected, each once, NAME=VALUE without blanks, "
                f"of {', '.join(allowed)}."
            )
        params[name] = _KEYWORDS[value] if value in _KEYWORDS else _parse(part, value)
    return DRIVES[kind](**params)


_KEYWORDS = {"none": None, "true": True, "yes": True, "false": False, "no": False}


def _parse(part, text):
    """Parse VALUE of NAME=VALUE: a number, a list, a dict by joint name, or a word."""
    joints, values = zip(*(x.rpartition(":")[::2] for x in text.split(",")))
    try:
        values = np.array(values, dtype=float).tolist()
    except ValueError:
        if joints == ("",):
            # The drive validates the word.
            return text
        values = [np.nan]
    by_joint = "" not in joints and len({*joints}) == len(joints)
    if not np.isfinite(values).all() or not (by_joint or {*joints} == {""}):
        raise ValueError(
            f"drive has {part}; expected numbers, or JOINT:NUMBER with commas between "
            "them, each joint, or part of its name, once."
        )
    if by_joint:
        return dict(zip(joints, values))
    return values if len(values) > 1 else values[0]
