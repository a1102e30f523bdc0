"""Effects that correct the robot model: its geometry, and the gains of its channels.

All other effects add torque to the described robot. These change the robot: its base is
tilted, the zero of an encoder or an axis is shifted, the gain of a channel differs.
The column is the derivative of the torque at the present value; the model is corrected
and linearised again until the value converges.
"""

from numbers import Real

import numpy as np
from scipy.spatial.transform import Rotation
from sklearn.base import clone

from sklearn_vbjfa._core._smoothing import interpolate
from sklearn_vbjfa.effects._base import (
    ANGLE,
    POSITION,
    TIME,
    Effect,
    InFiles,
    OfRobot,
    OnAllJoints,
)
from sklearn_vbjfa.effects._channels import Delay, model_torque

# Columns smaller than this share of the largest of the effect are rounding errors.
_ROUNDING = 1e-9
# Step of central differences of rotations.
_STEP = 1e-5
# Maximum factor of one correction of a gain without limit.
_MAX_FACTOR = 5.0


def cross_axes(direction):
    """Return two axes perpendicular to a direction (3,), ndarray (2, 3)."""
    # The two coordinate axes that are not nearest to the direction, in the order x, y,
    # z, orthogonalised against it and each other.
    n = np.asarray(direction, dtype=float)
    n = n / np.linalg.norm(n)
    first, second = np.delete(np.eye(3), np.argmax(np.abs(n)), axis=0)
    first = first - (first @ n) * n
    first /= np.linalg.norm(first)
    second = second - (second @ n) * n - (second @ first) * first
    return np.array([first, second / np.linalg.norm(second)])


def rotation(vector):
    """Return the matrix (3, 3) of a rotation vector (3,) [rad]."""
    return Rotation.from_rotvec(vector).as_matrix()


def body_rotation(vector, change):
    """Return the body-frame rotation vector (3,) by a change of a rotation vector."""
    # d of rotation(w + h c) = rotation(w) rotation(h d), to first order in h.
    step = _STEP * np.asarray(change)
    before, after = Rotation.from_rotvec([vector - step, vector + step])
    return (before.inv() * after).as_rotvec() / (2 * _STEP)


def without_rounding(columns):
    """Set negligible columns of an array (n, nv, k) to zero."""
    # A rotation about the axis of an earlier joint has no effect. Its derivative is a
    # rounding error, which a regression with scaled columns would use.
    size = np.sqrt((columns**2).sum(axis=(0, 1)))
    return np.where(size > _ROUNDING * size.max(initial=0.0), columns, 0.0)


class InModel(Effect):
    """An effect whose values are parameters of the robot model.

    The `coefficients` are parameters of ``__init__``: the present values. The columns
    are the derivatives of the torque by them; a fitted coefficient is a correction.
    `RobotIdentifier` iterates these corrections, and ``theta_`` has the values.

    Attributes
    ----------
    nominal : tuple of float
        Values of the uncorrected model.
    limit : float
        Values farther than this from the nominal ones are implausible.
    of_bodies : bool
        Whether errors of the bodies imitate it: its values are fitted with free bodies.
    precedence : int
        Of effects with equal columns, the one with the lowest precedence is reported.
    """

    needs: tuple[str, ...] = ("geometry", "load")
    nominal: tuple[float, ...] = ()
    limit = 0.0
    of_bodies = True
    precedence = 0

    @property
    def values(self):
        """Present values, ndarray (k,)."""
        return np.array([getattr(self, n) for n in self.coefficients], dtype=float)

    @property
    def corrects(self):
        """Whether the present values change the model."""
        return bool((self.values != self.nominal).any())

    def check(self):
        super().check()
        for name in self.coefficients:
            value = getattr(self, name)
            if not (isinstance(value, Real) and np.isfinite(value)):
                raise ValueError(
                    f"{name} of {self.name} must be a finite number; got {value!r}."
                )

    def correct(self, robot):
        """Correct a robot, a `CorrectedModel`, by the present values."""
        raise NotImplementedError(f"{type(self).__name__} must define correct(robot).")

    def bounds(self):
        """Return the smallest and largest values, two ndarrays (k,)."""
        return np.subtract(self.nominal, self.limit), np.add(self.nominal, self.limit)

    tuned = property(lambda self: self.coefficients)

    def natural(self, coef):
        """Whether the corrected values are within `bounds`."""
        low, high = self.bounds()
        values = self.values + np.asarray(coef)
        return bool(((low <= values) & (values <= high)).all())

    def linearised_at(self, coef):
        """Return the effect with its values corrected by coefficients (k,)."""
        return self.with_values(self.values + np.asarray(coef))

    def with_values(self, values):
        """Return the effect with other values (k,)."""
        return clone(self).set_params(
            **dict(zip(self.coefficients, map(float, values)))
        )


class BaseTilt(InModel, OfRobot):
    r"""The base is not level: gravity has another direction in its frame.

    Gravity in the frame of the base is g = R_y(pitch) R_x(roll) g_0, with g_0 that of
    the robot description: it is rotated about the base's x axis and then about its y
    axis. If gravity is along x or y of the base (robots on a wall), it is rotated about
    the other two axes, in their order. The base itself is tilted the opposite way.
    Source: Khalil and Dombre (2004), chapter 11.

    Parameters
    ----------
    roll, pitch : float, default=0.0
        Present values [rad].
    """

    name = "base_tilt"
    files = InFiles(urdf="the base of the file is level", mjcf="")
    label = "tilted base"
    formula = (
        r"\frac{\partial\tau}{\partial g}"
        r"\left(R_y(\mathrm{pitch})\,R_x(\mathrm{roll}) - 1\right) g_0"
    )
    coefficients = ("roll", "pitch")
    units = (ANGLE, ANGLE)
    nominal = (0.0, 0.0)
    limit = np.deg2rad(15.0)
    record = "the base measured with a level, or moves of the first joint"

    def __init__(self, joint=0, roll=0.0, pitch=0.0):
        super().__init__(joint)
        self.roll = roll
        self.pitch = pitch

    def applies(self, motion):
        if self.joint != 0:
            return "one effect of the whole robot"
        reason = super().applies(motion)
        if not reason and not np.any(motion.derivatives.nominal_gravity):
            return "the robot description has no gravity"
        return reason

    def correct(self, robot):
        _, _, roll, pitch = self._rotations(robot.nominal_gravity)
        robot.tilt(pitch @ roll)

    def _rotations(self, gravity):
        """Return the axes of roll and pitch, and both rotations, matrices (3, 3)."""
        first, second = np.delete(np.eye(3), np.argmax(np.abs(gravity)), axis=0)
        roll, pitch = rotation(self.roll * first), rotation(self.pitch * second)
        return first, second, roll, pitch

    def columns(self, motion):
        gravity = motion.derivatives.nominal_gravity
        first, second, roll, pitch = self._rotations(gravity)
        changes = [
            pitch @ np.cross(first, roll @ gravity),
            np.cross(second, pitch @ roll @ gravity),
        ]
        return without_rounding(motion.derivatives.by_gravity() @ np.transpose(changes))


class JointZero(InModel, OnAllJoints):
    r"""The zero of an encoder is off: it reads the position plus a constant.

    q = q_measured - zero in the rigid-body dynamics; velocity and acceleration do not
    change. Source: Khalil and Dombre (2004), chapter 11.

    Parameters
    ----------
    zero : float, default=0.0
        Present value [rad or m]: reading of the encoder at the joint's zero.
    """

    name = "joint_zero"
    files = InFiles(
        urdf="zeros of the file are those of the description",
        mjcf="",
        places=(("ref", "zero"),),
    )
    label = "shifted encoder zero"
    formula = r"-\frac{\partial\tau}{\partial q_j}\,\mathrm{zero}"
    coefficients = ("zero",)
    units = (POSITION,)
    nominal = (0.0,)
    limit = np.deg2rad(15.0)  # [rad], or as many metres
    precedence = 1
    record = "the joint at a mechanical reference, or moves of its neighbours"

    def __init__(self, joint=0, zero=0.0):
        super().__init__(joint)
        self.zero = zero

    def correct(self, robot):
        robot.move_zero(self.joint, self.zero)

    def columns(self, motion):
        return -motion.derivatives.by_position(self.joint)[:, :, None]


class JointAxis(InModel, OnAllJoints):
    r"""The axis of a joint differs from the robot description.

    The placement M of the joint in its parent becomes M exp(w) with the rotation vector
    w = about_x e_1 + about_y e_2, and all bodies that the joint carries move with it: a
    wrong ``rpy`` of its origin. e_1 and e_2 are x and y of the joint's frame if the
    joint's axis is z, y and z if it is x, x and z if it is y (otherwise the two
    coordinate axes that are not nearest to the joint's, orthogonalised against it).
    Source: Hayati and Mirmirani (1985), :doi:`10.1002/rob.4620020406`.

    Parameters
    ----------
    about_x, about_y : float, default=0.0
        Present values [rad].
    """

    name = "joint_axis"
    files = InFiles(urdf="", mjcf="")
    label = "turned joint axis"
    formula = (
        r"\frac{\partial\tau}{\partial w_j}\left(\mathrm{about\_x}\,e_1"
        r" + \mathrm{about\_y}\,e_2\right)"
    )
    coefficients = ("about_x", "about_y")
    units = (ANGLE, ANGLE)
    nominal = (0.0, 0.0)
    limit = np.deg2rad(10.0)
    precedence = 2
    record = "moves of the joints before it, in several poses of the joint"

    def __init__(self, joint=0, about_x=0.0, about_y=0.0):
        super().__init__(joint)
        self.about_x = about_x
        self.about_y = about_y

    def correct(self, robot):
        robot.turn(
            self.joint, rotation(self.values @ cross_axes(robot.axes[self.joint]))
        )

    def columns(self, motion):
        derivatives = motion.derivatives
        axes = cross_axes(derivatives.axes[self.joint])
        vector = self.values @ axes
        # A corrected zero moves the joint after this rotation, in the rotated axes.
        after = derivatives.nominal_rotation(self.joint) @ rotation(vector)
        after = after.T @ derivatives.rotation(self.joint)
        turns = [after.T @ body_rotation(vector, axis) for axis in axes]
        return without_rounding(derivatives.by_turn(self.joint, np.transpose(turns)))


class TorqueGain(InModel):
    r"""A torque channel has another gain than the others.

    It measures gain times the torque, friction included: an error of a torque constant,
    a gear ratio or the scale of a load cell. Source: Gautier and Briot (2014),
    :doi:`10.1115/1.4027506`.

    Parameters
    ----------
    gain : float, default=1.0
        Present value; 1.15 for a channel that reads 15 % too much.
    limit : float or None, default=2.5
        Gains between 1 / limit and limit count as plausible; None: all positive gains.
    """

    name = "torque_gain"
    files = InFiles(urdf="torques of the file are the true ones", mjcf="")
    label = "wrong gain of the torque channel"
    formula = r"(\mathrm{gain} - 1)\,\tau"
    coefficients = ("gain",)
    units = (("1", "1"),)
    needs = ("load",)
    nominal = (1.0,)
    record = "a known mass picked up, or moves of the joints before and after it"

    def __init__(self, joint=0, gain=1.0, limit=2.5):
        super().__init__(joint)
        self.gain = gain
        self.limit = limit

    def check(self):
        super().check()
        if not self.gain > 0:
            raise ValueError(f"gain of {self.name} must be positive; got {self.gain}.")

    def shape(self):
        """Return the gain; its limit is not a property of the channel."""
        return {"gain": self.gain}

    def bounds(self):
        # Without a limit, they limit one correction only.
        middle, limit = (1.0, self.limit) if self.limit else (self.gain, _MAX_FACTOR)
        return np.array([middle / limit]), np.array([middle * limit])

    def correct(self, robot):
        robot.read(self.joint, self.gain)

    def applies(self, motion):
        if motion.n_joints == 1:
            return "the only joint: a common gain is in every parameter"
        return super().applies(motion)

    def columns(self, motion):
        # Equations of the joint are multiplied by the gain, the derivative is not.
        return model_torque(motion, self.joint)[:, None] / self.gain


class _ClockCorrection(InModel, OfRobot):
    """A delay of all channels [s]: it corrects times instead of the robot model."""

    units = (TIME,)
    nominal = (0.0,)
    limit = 0.1
    of_bodies = False
    needs = ("command",)
    parameter_prefix = ""
    sign = 1.0  # 1 if commanded torques act later, -1 if earlier

    def correct(self, robot):
        """Leave the robot model unchanged."""

    def prefix(self, joint_name):
        return self.parameter_prefix

    def columns(self, motion):
        commands = motion.command, motion.parts, motion.t
        delay = self.sign * self.values[0]
        return self.sign * interpolate(*commands, delay, 1)[:, :, None]


class CommandDelay(_ClockCorrection):
    r"""The drive executes its commands later than logged.

    With the commanded part c(t) of the torque, K q_d + D v_d + tau_ff of a `PDDrive`,
    the torque is tau(t) + c(t - delay) - c(t), where tau(t) is the drive's law without
    delay. If the robot tracks closely, v_d is nearly v, and the delay is nearly viscous
    friction of K times the delay. Source: Bjelonic and others (2025), delay of
    the command of a drive.

    Parameters
    ----------
    delay : float, default=0.0
        Present value [s], within 0.1 s; negative if the logged positions lag.
    """

    name = "command_delay"
    parameter_prefix = "drive"
    label = "delayed command"
    files = InFiles.nowhere("torques of the file act at once")
    formula = r"c(t - \mathrm{delay}) - c(t)"
    coefficients = ("delay",)
    record = "faster commands, and some that the robot does not follow closely"

    def __init__(self, joint=0, delay=0.0):
        super().__init__(joint)
        self.delay = delay


class TorqueLag(_ClockCorrection):
    r"""All torques are recorded later than the positions.

    The torque of the motion at t is recorded as :math:`\tau(t + \mathrm{lag})`: two
    clocks, or a delay of the torque channels. `RobotIdentifier.fit` declares the effect
    if `inspect_recording` finds a lag.

    Parameters
    ----------
    lag : float, default=0.0
        Present value [s]; negative if torques are early.
    """

    name = "torque_lag"
    parameter_prefix = "torques"
    label = "lag of all torques"
    files = InFiles.nowhere("a property of the log")
    formula = r"\tau(t + \mathrm{lag})"
    coefficients = ("lag",)
    record = "faster motion"
    sign = -1.0
    corrected = Delay.corrected

    def __init__(self, joint=0, lag=0.0):
        super().__init__(joint)
        self.lag = lag
