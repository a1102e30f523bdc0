"""What a motion must keep, and the refusal of one that cannot be."""

import math
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model import (
    is_prismatic,
    joint_names,
    load_model,
    nominal_parameters,
)
from sklearn_vbjfa.robot._features import RigidBodyFeatures

# A joint that turns without end gets one turn about its zero [rad].
_ONE_TURN = np.pi
# What a description says instead of "no limit".
_NO_LIMIT = 1e9
# A motion that is worth recording goes there and back through this share of the range
# of every joint, once at least.
_LEAST_SHARE = 0.25
# What is suggested where a limit is missing, over what it takes to hold still, for
# motion as well.
_TO_MOVE = 1.5
# Time to full speed of the acceleration that is proposed where there is no limit [s].
_RUN_UP = 0.5
# Poses in which the torque of holding still is looked at.
POSES = 200


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of a motion, joint by joint in the order of the robot.

    Parameters
    ----------
    position : array-like of shape (nv, 2)
        Lowest and highest positions [rad or m].
    velocity : array-like of shape (nv,)
        Largest speeds [rad/s or m/s], finite.
    acceleration : array-like of shape (nv,), default=None
        Largest accelerations [rad/s^2 or m/s^2]; None or infinity where there is no
        limit but that of the torque.
    torque : array-like of shape (nv,), default=None
        Largest torques [N m or N]; None or infinity where there is no limit but that
        of the acceleration.

    Raises
    ------
    ValueError
        If shapes differ, limits leave no room, or a joint has neither a limit of
        acceleration nor one of torque.

    Examples
    --------
    >>> from sklearn_vbjfa.design import MotionLimits
    >>> limits = MotionLimits([[-1.0, 1.0]], [2.0], torque=[10.0])
    >>> limits.acceleration
    array([inf])
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray | None = None
    torque: np.ndarray | None = None

    def __post_init__(self):
        position = np.array(self.position, dtype=float)
        if position.ndim != 2 or position.shape[1] != 2 or not position.size:
            raise ValueError(
                "position must hold the lowest and the highest position of each joint, "
                f"shape (nv, 2); got shape {position.shape}."
            )
        found = {"position": position}
        for name in ("velocity", "acceleration", "torque"):
            given = getattr(self, name)
            value = np.full(len(position), np.inf) if given is None else given
            value = np.array(value, dtype=float)
            if value.shape != position.shape[:1]:
                raise ValueError(
                    f"{name} must hold one limit per joint, shape "
                    f"({len(position)},) like position; got shape {value.shape}."
                )
            found[name] = value
        for name, value in found.items():
            object.__setattr__(self, name, value)
        self._check_room()

    def _check_room(self):
        """Refuse limits between which nothing can move."""
        low, high = self.position.T
        for j in np.flatnonzero(~(low < high)):
            raise ValueError(
                f"The limits leave joint {j + 1} no room: position from {low[j]:g} to "
                f"{high[j]:g}; the lowest must lie below the highest."
            )
        for j in np.flatnonzero(~np.isfinite(self.position).all(axis=1)):
            raise ValueError(
                f"position of joint {j + 1} has no end ({low[j]:g} to {high[j]:g}); "
                "give two finite positions, such as -3.14 and 3.14 of a joint that "
                "turns without end."
            )
        for name in ("velocity", "acceleration", "torque"):
            value = getattr(self, name)
            for j in np.flatnonzero(~(value > 0)):
                raise ValueError(
                    f"The limits leave joint {j + 1} no room: {name} of {value[j]:g}; "
                    "it must be positive."
                )
        for j in np.flatnonzero(np.isinf(self.velocity)):
            raise ValueError(
                f"velocity of joint {j + 1} has no limit; give one. Through half of "
                f"its range in one second takes {0.5 * (high - low)[j]:.3g}."
            )
        for j in np.flatnonzero(np.isinf(self.acceleration) & np.isinf(self.torque)):
            raise ValueError(
                f"joint {j + 1} has a limit neither of acceleration nor of torque; "
                f"give one. Its velocity of {self.velocity[j]:g} is reached in half a "
                f"second with an acceleration of {self.velocity[j] / _RUN_UP:.3g}."
            )

    @classmethod
    def of(cls, model, *, position=None, velocity=None, acceleration=None, torque=None):
        """Take the limits of a robot description.

        Parameters
        ----------
        model : str, os.PathLike or pinocchio.Model
            Path of a URDF file, or a model. A joint that turns without end gets one
            turn about its zero.
        position : array-like of shape (nv, 2), default=None
            Limits to take in place of those of the description; nan keeps one.
        velocity, acceleration, torque : array-like of shape (nv,), default=None
            The same. The description has none of acceleration.

        Returns
        -------
        MotionLimits
            Limits; infinite where the description has none.

        Raises
        ------
        ValueError
            If the description has no velocity limit of a joint, or, with no
            `acceleration` given, no torque limit.
        """
        model = load_model(model)
        names = joint_names(model)
        low, high = (
            np.array(model.lowerPositionLimit, dtype=float),
            np.array(model.upperPositionLimit, dtype=float),
        )
        if position is not None:
            given = np.array(position, dtype=float)
            low = np.where(np.isnan(given[:, 0]), low, given[:, 0])
            high = np.where(np.isnan(given[:, 1]), high, given[:, 1])
            for j in np.flatnonzero(~(low < high) & ~np.isnan(given).all(axis=1)):
                raise ValueError(
                    f"The limits leave {names[j]} no room: position from {low[j]:g} to "
                    f"{high[j]:g}; the lowest must lie below the highest."
                )
        endless = ~np.isfinite(low) | ~np.isfinite(high)
        endless |= (low < -_NO_LIMIT) | (high > _NO_LIMIT) | (low == high)
        sliding = np.asarray(is_prismatic(model))
        for j in np.flatnonzero(endless & sliding):
            raise MotionRefused(
                f"The description gives no range of positions of {names[j]}, which "
                "slides;",
                {},
                lacks="position",
                advice="give limits=MotionLimits(...) with its range in metres.",
            )
        low, high = (
            np.where(endless, -_ONE_TURN, low),
            np.where(endless, _ONE_TURN, high),
        )
        velocity = _given(velocity, _known(model.velocityLimit))
        if np.isinf(velocity).any():
            half = 0.5 * (high - low)
            listed = ", ".join(
                f"{names[j]} ({half[j]:.3g} {'m' if sliding[j] else 'rad'}/s)"
                for j in np.flatnonzero(np.isinf(velocity))
            )
            raise MotionRefused(
                f"The description gives no velocity limit of {listed}: in brackets, "
                "what it takes through half of the range in one second.",
                {"velocity": rounded_up(np.where(np.isinf(velocity), half, velocity))},
                lacks="velocity",
                advice="Give limits=MotionLimits(...) with velocities.",
            )
        effort = _given(torque, _known(model.effortLimit))
        acceleration = _given(acceleration, np.full(effort.shape, np.inf))
        if (np.isinf(acceleration) & np.isinf(effort)).any():
            lacking = np.flatnonzero(np.isinf(acceleration) & np.isinf(effort))
            weight = _holding(model, low, high)
            listed = ", ".join(
                f"{names[j]} ({weight[j]:.3g} {'N' if sliding[j] else 'N m'})"
                for j in lacking
            )
            wanted = np.maximum(_TO_MOVE * weight, 0.1 * _TO_MOVE * weight.max())
            raise MotionRefused(
                f"The description gives no torque limit of {listed}: in brackets, what "
                "it takes to hold the robot still in any pose.",
                {"torque": rounded_up(np.where(np.isinf(effort), wanted, effort))},
                lacks="torque",
                advice="Give limits=MotionLimits(...) with torques above that, or "
                "accelerations.",
            )
        return cls(np.column_stack([low, high]), velocity, acceleration, effort)

    def check_for(self, names):
        """Refuse limits for another number of joints than those of `names`."""
        if len(self.position) != len(names):
            raise ValueError(
                f"limits are for {len(self.position)} joints; the robot has "
                f"{len(names)}: {', '.join(names)}."
            )

    def check_start(self, start, names):
        """Return start positions (nv,), refused where they lie outside."""
        start = np.array(start, dtype=float)
        if start.shape != (len(names),):
            raise ValueError(
                f"start must hold one position per joint, shape ({len(names)},); got "
                f"shape {start.shape}."
            )
        low, high = self.position.T
        for j in np.flatnonzero(~((start >= low) & (start <= high))):
            inside = np.where(np.isnan(start), 0.5 * (low + high), start)
            inside = np.clip(inside, low, high)
            raise MotionRefused(
                f"start puts {names[j]} at {start[j]:g}, outside its limits "
                f"[{low[j]:g}, {high[j]:g}]; start where the motion may be, for "
                f"example at {inside[j]:g}.",
                {"start": tuple(inside.tolist())},
            )
        return start

    def check_duration(self, duration, names):
        """Refuse a duration that is too short for the slowest joint."""
        half = 0.5 * _LEAST_SHARE * np.ptp(self.position, axis=1)
        # half (1 - cos(2 pi t / T)) has the speed 2 pi half / T, and (2 pi / T)^2 half
        needed = (
            2
            * np.pi
            * np.maximum(half / self.velocity, np.sqrt(half / self.acceleration))
        )
        slowest = int(np.argmax(needed))
        if duration < needed[slowest]:
            raise MotionRefused(
                f"duration={duration:g} s is too short for {names[slowest]}: at most "
                f"{self.velocity[slowest]:g} fast, it takes {needed[slowest]:.3g} s "
                f"through {_LEAST_SHARE:.0%} of its range and back. Give "
                f"duration={np.ceil(needed[slowest]):g} or more, or a smaller range.",
                {"duration": float(np.ceil(needed[slowest]))},
            )


def _given(limit, described):
    """Limits that are given (nv,), and where they are nan or None those described."""
    if limit is None:
        return described
    limit = np.broadcast_to(np.asarray(limit, dtype=float), described.shape)
    return np.where(np.isnan(limit), described, limit)


def _known(limit):
    """Limits of a description, infinite where it has zero or a huge number."""
    limit = np.array(limit, dtype=float)
    return np.where((limit > 0) & (limit < _NO_LIMIT), limit, np.inf)


def _holding(model, low, high):
    """Largest torques (nv,) that hold a robot still in random poses."""
    features = RigidBodyFeatures(model, friction=()).load()
    poses = np.random.default_rng(0).uniform(low, high, size=(POSES, model.nv))
    still = np.zeros_like(poses)
    inertial = np.ascontiguousarray(nominal_parameters(model))
    return np.abs(features.torques(poses, still, still, inertial)).max(axis=0)


class MotionRefused(ValueError):
    """Limits, a start or a duration that leave no motion.

    Attributes
    ----------
    reason : str
        The message, without a full stop.
    wrong : str
        The message, without what to give as an argument.
    lacks : str
        The argument that is lacking, if one is: ``"position"``, ``"velocity"``,
        ``"torque"``.
    options : dict of str to float or tuple of float
        What would do, by the names of arguments: ``"duration"``, ``"start"``,
        ``"velocity"``, ``"torque"``.
    """

    def __init__(self, wrong, options, *, lacks="", advice=""):
        message = f"{wrong} {advice}".strip()
        super().__init__(message)
        self.reason = message.removesuffix(".")
        self.wrong, self.lacks, self.options = wrong, lacks, options


def rounded_up(limits):
    """Return limits with three digits that are no smaller, for a message."""
    found = []
    for limit in map(float, limits):
        size = 10.0 ** (math.floor(math.log10(limit)) - 2) if 0 < limit < 1e12 else 0.0
        rounded = math.ceil(limit / size - 1e-9) * size if size else limit
        found.append(float(f"{rounded:.6g}"))
    return tuple(found)
