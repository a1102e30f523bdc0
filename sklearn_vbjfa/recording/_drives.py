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
# What to give where currents have no signs, as `parse_drive` reads it.
UNSIGNED = "current signed=no"
# A joint that is at its limit of torque for a larger share of the rows shows nothing
# of what it would do.
_MOSTLY = 0.5
# Frequency below which drives' velocities are compared with the positions' [Hz].
_SLOW = 10.0
# What was commanded before a recording is not known: longest delay, as a share of it.
_UNKNOWN = 0.1


class Drive(BaseEstimator):
    """Control law of the motors: channels that it takes, and torques that it makes.

    Its method `driven` takes a recording with the channels (n_samples, nv) of the drive
    in `signals`. It returns the recording with `tau` of the law at no delay, and
    `command`; it raises a ValueError if channels are missing or do not suit the drive.
    """

    told = ""  # channel that `RobotIdentifier.fit` takes as y
    beside: tuple[str, ...] = ()  # further channels of joints, in `signals`
    of_positions = False  # whether torques are made of measured positions
    waits: float | None = 0.0  # delay of its commands [s]; None if it is to be found
    unsigned = False  # whether only sizes of torques are known
    gains: str | None = None  # "unknown" where torques are known up to factors
    # names of its channel in files that have it in place of torques
    spelled: tuple[str, ...] = ()
    # settings to check if the order of magnitude of the torques is wrong
    numbers = "the numbers of the drive"

    def facts(self, recording):
        """Return what a report says of the drive, a dict of numbers and lists."""
        return {}

    def taken(self, y, signals):
        """Split signals that were given for a fit, with y, into those of the drive."""
        others = dict(signals or {})
        own = {name: others.pop(name) for name in self.beside if name in others}
        return {self.told: y, **own}, others if own else signals

    def _channel(self, recording, name):
        """Channel (n, nv) of a recording; None if it has none."""
        values = recording.signals.get(name)
        if values is None:
            return None
        shape = (recording.n_samples, recording.nv)
        values = np.asarray(values, dtype=float).reshape(len(values), -1)
        if name == "supply" and values.shape[1] == 1:
            values = np.broadcast_to(values, shape)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(
                f"{name} must have one finite row per sample and one column per joint, "
                f"shape {shape}; got {values.shape}."
            )
        return values

    def _recorded(self, recording):
        """Return the channel of the drive, else the torques as such."""
        values = self._channel(recording, self.told)
        return recording.tau if values is None else values

    def _setting(self, name, joints, recording):
        """Return a setting (nv,), else the channel (n, nv) of its name, else None."""
        if getattr(self, name) is not None:
            return self._number(name, joints)
        return None if recording is None else self._channel(recording, name)

    def _number(self, name, joints, least=0.0):
        """Return a setting as one number for each joint, (nv,)."""
        given, what = getattr(self, name), f"{type(self).__name__}: {name}"
        if isinstance(given, Mapping):
            given = _by_name(what, given, joints)
        try:
            values = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            values = np.full(1, np.nan)
        if values.shape not in {(), (len(joints),)} or np.isnan(values).any():
            raise ValueError(
                f"{what} must be one number, or one for each joint in the order "
                f"{', '.join(joints)}; got {given!r}."
            )
        if (values < least).any():
            raise ValueError(f"{what} must not be negative; got {given!r}.")
        return np.broadcast_to(values, len(joints)).copy()


def _by_name(what, given, joints):
    """Return numbers that are given by parts of joints' names, a list."""
    found = []
    for joint in joints:
        keys = [joint] if joint in given else [key for key in given if key in joint]
        if len(keys) != 1:
            raise ValueError(
                f"{what} must have one key in each joint's name; {len(keys)} of "
                f"{', '.join(map(repr, given))} are in {joint!r}."
            )
        found.append(given[keys[0]])
    return found


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
        at 1 kHz has 1e-3. What it makes of positions acts half of it late, which is
        some per cent of armature and damping. None takes that for nothing.

    See Also
    --------
    RobotIdentifier : Takes it as `drive`.
    sklearn_vbjfa.effects.CommandDelay : The delay.

    Notes
    -----
    Commands are steps: a row acts from its time to that of the next one, a delay later.
    Torques at rows are the mean of the last sample period, within the band of the rows.
    The velocity is the slope of the positions, as late as `Recording.v` where there is
    one. The noise of positions is noise of the torque, K_p and K_d times, and of the
    regressor; their common part is measured from the even and the odd samples and
    subtracted from their products. Commands count as exact.

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

    told = "q_desired"
    of_positions = True
    beside = COMMANDS[1:]
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
    def waits(self):
        """Known delay [s]; None if it is to be found."""
        if isinstance(self.delay, str) and self.delay == "auto":
            return None
        if not (isinstance(self.delay, Real) and np.isfinite(self.delay)):
            raise ValueError(
                f"PDDrive: delay must be 'auto' or a time in s; got {self.delay!r}."
            )
        return float(self.delay)

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
        command = kp * aim + kd * (0.0 if rate is None else rate)
        return command + (0.0 if ahead is None else ahead)

    def driven(self, recording):
        """Return a recording of the torques that the law asks for; see `Drive`."""
        command, parts = self.commands(recording), recording.segments
        _check_commands(command, recording)
        kp, kd = self.law(recording.joint_names, recording)
        clock = recording.clock()
        if self.waits is not None:
            check_wait(self.waits, recording)
        command = held(command, parts, clock, self.waits or 0.0)
        q, v = np.asarray(recording.q), velocities(recording)
        if self.period is not None:
            # A torque that is held acts half a period late; of the command it is a
            # part of the delay.
            late = 0.5 * recording.dt / self.updates(recording.dt)
            q, v = (interpolate(x, parts, clock, late) for x in (q, v))
        tau = command - kp * q - kd * v
        shares = [np.mean(np.broadcast_to(x, tau.shape), axis=0) for x in (kp, kd)]
        made = replace(recording, tau=tau, command=command, feedback=np.array(shares))
        return made if self.saturation is None else self._saturated(made)

    def _saturated(self, recording):
        """Mark samples at the limit of torque, which the law does not tell."""
        names = recording.joint_names
        most = self.most(names)
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
        most = self.most(recording.joint_names)
        share = (np.abs(recording.tau) >= most).mean(axis=0)
        return {"delay": self.waits, "saturated": share.tolist()}

    # -- in simulation -----------------------------------------------------------------

    def updates(self, dt, usual=None):
        """Return how often torques are set in a sample period."""
        if self.period is None:
            return 1 if usual is None else max(round(dt / usual), 1)
        period = self.period if isinstance(self.period, Real) else np.nan
        # A hundredth of a period is the jitter of clocks.
        if not 0 < period <= 1.01 * dt:
            raise ValueError(
                "PDDrive: period must be a positive time in s, at most the sample "
                f"period of {dt:g} s; got {self.period!r}."
            )
        return max(round(dt / period), 1)

    def most(self, names):
        """Return the largest torque of joints, (nv,); infinite where none is given."""
        if self.saturation is None:
            return np.full(len(names), np.inf)
        return self._number("saturation", names)

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
                raise ValueError(
                    f"PDDrive: {name} of the recording must not be negative."
                )
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
        their probability where that is near zero; see Notes.

    Notes
    -----
    The sign of a torque is not that of the motion: gravity holds a joint that moves
    down. Signs are found by expectation and maximisation. With the predicted torque f
    and the variance :math:`\sigma^2` of the residual, a size m counts as
    :math:`m \tanh(m f / \sigma^2)`, the mean over both signs, and the robot is fitted
    to that until nothing moves; the first signs are, joint by joint, those with which
    rigid bodies as described, friction and an offset explain most. Signs of rows that
    were not fitted follow from the model that was.

    Examples
    --------
    >>> from sklearn_vbjfa.robot import CurrentDrive
    >>> CurrentDrive(torque_constant=5.0)
    CurrentDrive(torque_constant=5.0)
    """

    told = "current"
    spelled = ("current", "motor_current", "present_current")

    def __init__(self, torque_constant="unknown", *, signed=True):
        self.torque_constant = torque_constant
        self.signed = signed

    @property
    def gains(self):
        """Unknown, if the torque constant is."""
        constant = self.torque_constant
        is_unknown = isinstance(constant, str) and constant == "unknown"
        return "unknown" if is_unknown else None

    @property
    def unsigned(self):
        """Whether only sizes of torques are known."""
        return not self.signed

    def driven(self, recording):
        """Return a recording of the torques of the currents; see `Drive`.

        Without channels ``current`` its torques are taken for currents. `command` is
        None until the signs are known.
        """
        current = self._recorded(recording)
        if self.gains is None:
            names = recording.joint_names
            current = current * self._number("torque_constant", names, -np.inf)
        if self.signed:
            return replace(recording, tau=current, command=current)
        below = np.flatnonzero((current < 0).any(axis=0))
        if below.size:
            raise ValueError(
                "CurrentDrive(signed=False) expects magnitudes, and "
                f"{recording.joint_names[below[0]]} has negative currents; use "
                "signed=True."
            )
        return replace(recording, tau=current)


class VoltageDrive(Drive):
    r"""Motor voltage, or duty cycle times supply: hobby servos, Dynamixel in PWM mode.

    .. math:: \tau = \frac{k_t}{R} V - \frac{k_t^2}{R} v

    Torques are in volts. Their gains are found, as with ``gains="unknown"``.

    Parameters
    ----------
    supply : float, array-like of shape (nv,), dict or None, default=None
        Voltage of the supply, by which a duty cycle is multiplied; None takes the
        channel ``supply`` of the recording, or y for volts.

    Notes
    -----
    Friction of the motor and its back-EMF have one column, the speed: what is found is
    their sum, and no recording of voltages tells them apart. In a simulator with a
    voltage input the damping is the sum.

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

    told = "voltage"
    gains = "unknown"
    beside = ("supply",)
    spelled = ("voltage", "duty", "pwm", "pwm_duty", "present_pwm")

    def __init__(self, *, supply=None):
        self.supply = supply

    def driven(self, recording):
        """Return a recording of the voltages; see `Drive`.

        Without channels ``voltage`` its torques are taken for voltages.
        """
        volts = self._recorded(recording)
        supply = self._setting("supply", recording.joint_names, recording)
        volts = volts if supply is None else volts * supply
        return replace(recording, tau=volts, command=volts)


def _check_commands(command, recording):
    """Refuse commands (n, nv) none of which changes while joints move."""
    parts = recording.segments
    changes = any((np.ptp(command[part], axis=0) > 0).any() for part in parts)
    moves = any((np.ptp(recording.q[part], axis=0) > 0).any() for part in parts)
    if moves and not changes:
        raise ValueError(
            "The commands are constant while joints move: they are not those that the "
            "robot followed. Record the commands of the same time and mode."
        )


def check_wait(delay, recording):
    """Refuse a delay [s] before which too much of a recording has no known command."""
    pieces = len(recording.segments)
    time = check_dt(recording.dt) * recording.n_samples
    if abs(delay) * pieces > _UNKNOWN * time:
        each = f"{pieces} recordings of {time:.3g} s in all"
        raise ValueError(
            f"The delay of the commands is {delay:.3g} s, more than a tenth of "
            f"{each if pieces > 1 else f'a recording of {time:.3g} s'}: first commands "
            "are unknown. Record longer, or shift the commands; delay is in seconds."
        )


def velocities(recording):
    """Velocities (n, nv): those of states, or slopes of the positions, as they came."""
    # Drives make theirs of the same encoder, some milliseconds late by a filter, and
    # what they log has noise of the whole band: only its lag is taken.
    if recording.states is not None:
        return recording.states[:, recording.nv : 2 * recording.nv]
    parts, q, clock = recording.segments, np.asarray(recording.q), recording.clock()
    late = [
        interpolate(q[:, j : j + 1], parts, clock, one, order=1)
        for j, one in enumerate(velocity_lags(recording).tolist())
    ]
    return np.hstack(late)


def velocity_lags(recording):
    """Delay (nv,) of recorded velocities [s], zeros where there are none."""
    # By least squares on accelerations, where the motion is.
    if recording.states is not None or recording.v is None:
        return np.zeros(recording.nv)
    parts, q, clock = recording.segments, np.asarray(recording.q), recording.clock()
    slope = interpolate(q, parts, clock, order=1)
    lowpass = _lowpass.design(recording.dt, min(_SLOW, 0.2 / recording.dt))
    long = [part for part in parts if part.stop - part.start > 2 * lowpass.half]
    if not long:
        return np.zeros(recording.nv)
    # Accelerations of all rows: behind the low-pass they are further apart.
    own, theirs, faster = (
        np.concatenate([lowpass(np.asarray(x[part])) for part in long])
        for x in (slope, recording.v, interpolate(q, parts, clock, order=2))
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
        name, equals, value = part.partition("=")
        if name not in known or not equals or not value or name in given:
            raise ValueError(
                f"drive has {part!r}; expected, each once, NAME=VALUE without blanks, "
                f"of {', '.join(known)}."
            )
        given[name] = _parsed_value(name, value)
    return DRIVES[kind](**given)


_SWITCHES = {"none": None, "true": True, "yes": True, "false": False, "no": False}


def _parsed_value(name, text):
    """Return a number, some of them, some by joints' names, a word or a switch."""
    if text in _SWITCHES:
        return _SWITCHES[text]
    pairs = [one.rpartition(":")[::2] for one in text.split(",")]
    joints, values = [joint for joint, _ in pairs], []
    try:
        values = [float(one) for _, one in pairs]
    except ValueError:
        if len(pairs) == 1 and not any(joints):
            # A word, which the drive knows or refuses.
            return text
    by_joint = all(joints) and len(set(joints)) == len(joints)
    if not (values and np.isfinite(values).all() and (by_joint or not any(joints))):
        raise ValueError(
            f"drive has {name}={text}; expected numbers, or JOINT:NUMBER with commas "
            "between them, each joint, or part of its name, once."
        )
    if by_joint:
        return dict(zip(joints, values))
    return values[0] if len(values) == 1 else values
