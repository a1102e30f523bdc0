"""A designed motion: a finite Fourier series, and what can be asked of it."""

import csv
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import null_space

from sklearn_vbjfa._core import write_whole


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
    joint_names : tuple of str
        Joints.
    slides : tuple of bool
        Whether each slides, so that its units are m and N.
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
        Why nothing is known of the distance between bodies; empty if it is.
    condition_number, start_condition_number : float
        Condition number of the base regressor with friction: of the motion, and of the
        one that it was improved from. Columns are over their sizes at random states
        within the limits, which are the same for all motions; rows are over their
        noise. With columns in other units it is another number, so that it compares
        motions within these limits and nothing else.
    noise : ndarray of shape (nv,)
        Deviation of the noise that the equations of each joint were weighted by, in the
        band of the fit [N m or N].
    band : float
        That band [Hz].
    shows : tuple of Visible
        Effects that the motion will show, joint by joint.
    parts : tuple of Parted
        Pairs of effects that it was asked to tell apart.
    invisible : tuple of Invisible
        Effects that no motion shows, or not this one, and why.
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
    parts: tuple = ()
    invisible: tuple = ()
    curve: object = field(default=None)
    coordinates: np.ndarray | None = field(default=None)

    def __repr__(self):
        """Tell its size, and whether it keeps its limits."""
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
        heads = ["t"] + [
            f"{kind}_{name}" for kind in ("q", "v", "a") for name in self.joint_names
        ]
        rows = np.column_stack([self.t, self.q, self.v, self.a])
        write_whole(path, _csv(heads, rows))


def _csv(heads, rows):
    """Write a table as text."""
    import io

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows([[f"{value:.9g}" for value in row] for row in rows.tolist()])
    return text.getvalue()


@dataclass(frozen=True, eq=False)
class FourierCurve:
    """Positions of all joints as finite Fourier series of one period T [s]."""

    # q_j(t) = s_j + sum_(k=1..K) a_jk (cos k w t - 1) + b_jk sin k w t, w = 2 pi / T,
    # with zero velocity and acceleration at its ends, sum_k k b_jk = sum_k k^2 a_jk =
    # 0. What is free are the coordinates of the pairs (a, b) that fulfil this, and the
    # start s (nv,) where it is None. K, n_harmonics, is two at least.

    period: float
    n_harmonics: int
    n_joints: int
    start: np.ndarray | None = None
    _free: np.ndarray = field(init=False, repr=False)

    def __post_init__(self):
        k = np.arange(1, self.n_harmonics + 1)
        # Unit coordinates have about the same velocities, whatever their harmonics.
        size = 1.0 / k
        zero = np.zeros(k.size)
        held = np.array([np.r_[k**2 * size, zero], np.r_[zero, k * size]])
        free = np.tile(size, 2)[:, None] * null_space(held)
        object.__setattr__(self, "_free", free)

    @property
    def size(self):
        """Coordinates of one joint."""
        return self._free.shape[1] + (self.start is None)

    @property
    def highest(self):
        """Highest frequency [Hz]."""
        return self.n_harmonics / self.period

    def basis(self, t):
        """Positions, velocities, accelerations of unit coordinates, (3, n, size)."""
        # The start comes last, where it is free.
        t = np.asarray(t, dtype=float)
        w = 2 * np.pi / self.period * np.arange(1, self.n_harmonics + 1)
        c, s = np.cos(np.outer(t, w)), np.sin(np.outer(t, w))
        made = np.array(
            [
                np.hstack([c - 1, s]) @ self._free,
                np.hstack([-w * s, w * c]) @ self._free,
                np.hstack([-(w**2) * c, -(w**2) * s]) @ self._free,
            ]
        )
        if self.start is None:
            constant = np.zeros((3, t.size, 1))
            constant[0] = 1.0
            made = np.concatenate([made, constant], axis=2)
        return made

    def states(self, z, basis):
        """States [q | v | a] (n, 3 nv) of coordinates (nv, size) on a `basis`."""
        q, v, a = basis @ z.T
        if self.start is not None:
            q = q + self.start
        return np.hstack([q, v, a])

    def pulled_back(self, by_states, basis):
        """Gradient by the coordinates (nv, size) from that by the states (n, 3 nv)."""
        parts = np.split(by_states, 3, axis=1)
        return sum(part.T @ one for part, one in zip(parts, basis))
