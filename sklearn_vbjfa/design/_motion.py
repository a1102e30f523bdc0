"""Designed motion, a finite Fourier series, and its limits."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.model import is_prismatic, joint_names, load_model

# Range of a continuous joint, one turn about its zero [rad].
_ONE_TURN = np.pi
# Values of a description from here on mean "no limit".
_NO_LIMIT = 1e9
# Least share of each joint's range that a motion covers.
_LEAST_SHARE = 0.25
# Poses in which the static torque is checked.
POSES = 200


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DesignedMotion:
    """A motion to record, from `design_motion`.

    Attributes
    ----------
    t : ndarray of shape (n,)
        Times [s].
    q, v, a : ndarray of shape (n, nv)
        Positions [rad or m], velocities and accelerations.
    tau : ndarray of shape (n, nv)
        Torques that the model expects [N m or N].
    joint_names, slides : tuple of str, tuple of bool
        Joints, and whether each slides, so that its units are m and N.
    dt, duration : float
        Sample period and length, one period of the motion [s].
    limits : MotionLimits
        Limits that it was designed for.
    within_limits : bool
        Whether it keeps a margin of 2 % to all limits, looked at ten times as often as
        in the design.
    margins : dict of str to ndarray of shape (nv,)
        Smallest distances to the limits, over the limits (for ``"position"``, over half
        of the range): ``"position"``, ``"velocity"``, ``"acceleration"``, ``"torque"``;
        and with geometry ``"clearance"``, the smallest distance between bodies [m].
    no_clearance : str
        Why the distance between bodies is not known; empty if it is.
    condition_number, start_condition_number : float
        Condition number of the base regressor with friction: of the motion, and of the
        one that it was improved from. Columns are over their sizes at random states
        within the limits, rows over their noise: it compares motions within the same
        limits.
    noise : ndarray of shape (nv,)
        Standard deviation of the noise of each joint's equations in the band of the fit
        [N m or N].
    band : float
        That band [Hz].
    shows : tuple of ShownEffect
        Effects that the motion excites, with the least torque that is distinguishable.
    invisible : tuple of ShownEffect
        Effects that no motion excites, with `reason`.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    joint_names: tuple
    slides: tuple
    dt: float
    duration: float
    limits: object
    within_limits: bool
    margins: dict
    condition_number: float
    start_condition_number: float
    noise: np.ndarray
    band: float
    no_clearance: str = ""
    shows: tuple = ()
    invisible: tuple = ()
    curve: object = None
    coordinates: np.ndarray | None = None

    def __repr__(self):
        kept = "within limits" if self.within_limits else "NOT within limits"
        return (
            f"<DesignedMotion: {len(self.joint_names)} joints, {self.duration:g} s, "
            f"{kept}>"
        )

    def states(self, t):
        """States at any times.

        Parameters
        ----------
        t : array-like of shape (n,)
            Times [s]; the motion repeats with `duration`.

        Returns
        -------
        ndarray of shape (n, 3 * nv)
            Positions, velocities and accelerations [q | v | a].
        """
        return self.curve.states(self.coordinates, self.curve.basis(t))

    def to_csv(self, path):
        """Write the motion as CSV: ``t``, and ``q_``, ``v_``, ``a_`` of every joint.

        Parameters
        ----------
        path : str or os.PathLike
            File to write; one that exists is replaced.
        """
        import pandas as pd

        heads = [f"{kind}_{name}" for kind in "qva" for name in self.joint_names]
        rows = np.column_stack([self.t, self.q, self.v, self.a])
        table = pd.DataFrame(rows, columns=["t", *heads])
        text = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
        write_whole(path, text)


@dataclass(frozen=True, eq=False)
class FourierCurve:
    """Positions of all joints as finite Fourier series of one period T [s]."""

    # q_j(t) = s_j + sum_(k=1..K) a_jk (cos k w t - 1) + b_jk sin k w t, w = 2 pi / T,
    # with zero velocity and acceleration at its ends, sum_k k b_jk = sum_k k^2 a_jk =
    # 0. Coordinates span the pairs (a, b) that fulfil this; the last one is the start
    # s_j. K, n_harmonics, is two at least.

    period: float
    n_harmonics: int

    @cached_property
    def _free(self):
        k = np.arange(1, self.n_harmonics + 1)
        # Unit coordinates of all harmonics have about the same velocities.
        size = 1.0 / k
        zero = np.zeros(k.size)
        conditions = np.array([np.r_[k**2 * size, zero], np.r_[zero, k * size]])
        return np.tile(size, 2)[:, None] * null_space(conditions)

    @property
    def size(self):
        """Coordinates of one joint."""
        return self._free.shape[1] + 1

    @property
    def highest(self):
        """Highest frequency [Hz]."""
        return self.n_harmonics / self.period

    def basis(self, t):
        """Positions, velocities, accelerations of unit coordinates, (3, n, size)."""
        t = np.asarray(t, dtype=float)
        w = 2 * np.pi / self.period * np.arange(1, self.n_harmonics + 1)
        c, s = np.cos(np.outer(t, w)), np.sin(np.outer(t, w))
        basis = np.zeros((3, t.size, self.size))
        basis[0, :, :-1] = np.hstack([c - 1, s]) @ self._free
        basis[1, :, :-1] = np.hstack([-w * s, w * c]) @ self._free
        basis[2, :, :-1] = np.hstack([-(w**2) * c, -(w**2) * s]) @ self._free
        basis[0, :, -1] = 1.0
        return basis

    def states(self, z, basis):
        """States [q | v | a] (n, 3 nv) of coordinates (nv, size) on a `basis`."""
        return np.hstack(list(basis @ z.T))

    def pulled_back(self, by_states, basis):
        """Gradient by the coordinates (nv, size) from that by the states (n, 3 nv)."""
        parts = np.split(by_states, 3, axis=1)
        return sum(part.T @ columns for part, columns in zip(parts, basis))


# -- limits ----------------------------------------------------------------------------


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
        object.__setattr__(self, "position", position)
        for name in ("velocity", "acceleration", "torque"):
            limit = getattr(self, name)
            limit = np.full(len(position), np.inf) if limit is None else limit
            limit = np.array(limit, dtype=float)
            if limit.shape != position.shape[:1]:
                raise ValueError(
                    f"{name} must hold one limit per joint, shape "
                    f"({len(position)},) like position; got shape {limit.shape}."
                )
            object.__setattr__(self, name, limit)
            _refuse(~(limit > 0), f"has no room: {name} must be positive", limit)
        low, high = position.T
        _refuse(~(low < high), "has no room: position must hold low < high", position)
        _refuse(
            ~np.isfinite(position).all(axis=1),
            "turns without end: give two finite positions, such as -3.14 and 3.14",
            position,
        )
        _refuse(np.isinf(self.velocity), "has no limit of velocity", self.velocity)
        endless = np.isinf(self.acceleration) & np.isinf(self.torque)
        _refuse(endless, "needs a limit of acceleration or of torque", self.torque)

    @classmethod
    def of(cls, model, *, velocity=None, acceleration=None, torque=None):
        """Take the limits of a robot description.

        Parameters
        ----------
        model : str, os.PathLike or pinocchio.Model
            Path of a URDF file, or a model. A joint that turns without end gets one
            turn about its zero.
        velocity, acceleration, torque : float or array-like of shape (nv,)
            Limits to take in place of those of the description, which has none of
            acceleration; None or nan keeps one.

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
        names, sliding = joint_names(model), is_prismatic(model)
        low, high = np.array([model.lowerPositionLimit, model.upperPositionLimit])
        endless = ~np.isfinite(low) | ~np.isfinite(high)
        endless |= (low < -_NO_LIMIT) | (high > _NO_LIMIT) | (low == high)
        unknown = {"range of positions": (endless & sliding, "position limits")}
        low = np.where(endless, -_ONE_TURN, low)
        high = np.where(endless, _ONE_TURN, high)
        velocity = _given("velocity", velocity, known_limits(model.velocityLimit))
        unknown["velocity limit"] = np.isinf(velocity), "--velocity"
        effort = _given("torque", torque, known_limits(model.effortLimit))
        acceleration = _given("acceleration", acceleration, np.full(len(names), np.inf))
        endless = np.isinf(acceleration) & np.isinf(effort)
        unknown["torque limit"] = endless, "--torque or --acceleration"
        missing = [
            (f"{what} of {', '.join(np.array(names)[lacking])}", option)
            for what, (lacking, option) in unknown.items()
            if lacking.any()
        ]
        if missing:
            limits, options = zip(*missing)
            raise ValueError(
                f"The description gives no {' and no '.join(limits)}. Give "
                f"limits=MotionLimits(...) (command line: {', '.join(options)})."
            )
        return cls(np.column_stack([low, high]), velocity, acceleration, effort)

    def check_for(self, names, duration):
        """Refuse another number of joints, and a duration too short for the slowest."""
        if len(self.position) != len(names):
            raise ValueError(
                f"limits are for {len(self.position)} joints; the robot has "
                f"{len(names)}: {', '.join(names)}."
            )
        half = 0.5 * _LEAST_SHARE * np.ptp(self.position, axis=1)
        # half (1 - cos(2 pi t / T)) has the speed 2 pi half / T, and (2 pi / T)^2 half
        needed = np.maximum(half / self.velocity, np.sqrt(half / self.acceleration))
        needed = 2 * np.pi * needed
        slowest = int(np.argmax(needed))
        if duration < needed[slowest]:
            enough = float(np.ceil(needed[slowest]))
            raise ValueError(
                f"A duration of {duration:g} s is too short for {names[slowest]}, "
                f"which takes {needed[slowest]:.3g} s through {_LEAST_SHARE:.0%} of "
                f"its range and back. Give a duration of {enough:g} s or more, or a "
                "smaller range."
            )


def _refuse(wrong, reason, values):
    for j in np.flatnonzero(wrong):
        raise ValueError(f"Joint {j + 1} {reason}; got {values[j]}.")


def _given(name, limit, described):
    """Limits (nv,) of the caller; those of the description for nan or None."""
    limit = np.array(np.nan if limit is None else limit, dtype=float)
    if limit.size not in (1, described.size):
        raise ValueError(
            f"{name} must hold one limit, or one for each of {described.size} joints; "
            f"got {limit.size}."
        )
    return np.where(np.isnan(limit), described, limit)


def known_limits(limit):
    """Limits of a description, infinite for zero or a huge number."""
    limit = np.array(limit, dtype=float)
    return np.where((limit > 0) & (limit < _NO_LIMIT), limit, np.inf)
