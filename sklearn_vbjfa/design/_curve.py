"""Periodic motions that stand still where they begin and end: finite Fourier series."""

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import null_space


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
