"""What a recording without noise tells of faults in the geometry and the channels.

The robot with given faults is fitted to the torque without noise: bodies and friction
by least squares, the faults by Gauss-Newton steps, their columns by differences of
the regressor. The root of the sum of the squared rest over the squared noise is the
`distance`. Where two explanations have distances d and zero, not even the likelihood
with a known noise takes the right one always: it takes the other one in
Phi(-d / 2) of the recordings (the Neyman-Pearson lemma for a shift of a normal
distribution). Two explanations are one class here where that is more than 5 %.

Nothing here uses the code of the package.
"""

from dataclasses import dataclass

import numpy as np
from _undeclared_faults import (
    NEUTRAL,
    PARAMETERS,
    Fault,
    gains_of,
    with_faults,
    zeros_of,
)
from _undeclared_robots import regressor
from _undeclared_span import friction_shapes
from scipy.stats import norm

# Distance at which the wrong one of two explanations is likelier in 5 % of cases.
CONFUSED = 0.05
SEPARATE = -2.0 * norm.ppf(CONFUSED)
ROWS = 400
STEPS = 8
STEP = 1e-4
# Start of a fault's parameters beside what is nominal: just there, an axis along the
# gravity hides a part of a body that any tilt shows.
START = 0.01
# A candidate whose first step leaves more than this share of the squares is no rival.
HOPELESS = 0.5
MOST = {"base_tilt": 0.4, "joint_zero": 0.4, "joint_axis": 0.3, "torque_gain": 10.0}
RANK = 1e-9


@dataclass(frozen=True)
class Explanation:
    """The best that a robot with faults of given names can do."""

    faults: tuple
    distance: float
    rms: float
    std: tuple


def all_faults(nv):
    """Name and joint of every fault that a robot can have."""
    per_joint = [name for name in PARAMETERS if name != "base_tilt"]
    return [("base_tilt", 0), *((name, j) for name in per_joint for j in range(nv))]


class Teller:
    """Tells apart what explains a torque."""

    def __init__(self, nominal, states, tau, noise, declared, further=()):
        n, nv = tau.shape
        rows = np.unique(np.linspace(0, n - 1, min(ROWS, n)).round().astype(int))
        self.nominal, self.nv, self.noise = nominal, nv, noise
        self.rows, self.weight = rows, np.sqrt(n / rows.size)
        self.n_rows = rows.size
        self.q, self.v, self.a = np.split(states[rows], 3, axis=1)
        self.y = (tau[rows] / noise).ravel()
        plain = [name for name in declared if name != "offset"]
        shapes = list(friction_shapes(plain, self.v).values())
        if "offset" in declared:
            shapes.append(np.ones_like(self.v))
        blocks = [shape[:, :, None] * np.eye(nv) for shape in shapes]
        blocks += [torque[rows][:, :, None] for torque in further]
        self.fixed = np.concatenate(blocks, axis=2) if blocks else None

    def _columns(self, faults):
        model = with_faults(self.nominal, faults)
        q = self.q - zeros_of(faults, self.nv)
        Phi = regressor(model, q, self.v, self.a)
        if self.fixed is not None:
            Phi = np.concatenate([Phi, self.fixed], axis=2)
        Phi = Phi * (gains_of(faults, self.nv) / self.noise)[:, None]
        return Phi.reshape(-1, Phi.shape[2])

    def _fitted(self, Phi):
        length = np.linalg.norm(Phi, axis=0)
        # a column of rounding errors has no direction
        used = length > RANK * length.max()
        U, s, Vt = np.linalg.svd(Phi[:, used] / length[used], full_matrices=False)
        kept = s > RANK * s[0]
        U = U[:, kept]
        theta = np.zeros(Phi.shape[1])
        along = U.T @ self.y
        theta[used] = (Vt[kept].T @ (along / s[kept])) / length[used]
        return U, theta, self.y - U @ along

    def _derivatives(self, faults, theta):
        out = []
        for i, fault in enumerate(faults):
            for k in range(len(fault.values)):
                pair = []
                for h in (STEP, -STEP):
                    values = list(fault.values)
                    values[k] += h
                    moved = Fault(*fault.key, tuple(values))
                    pair.append(
                        self._columns([*faults[:i], moved, *faults[i + 1 :]]) @ theta
                    )
                out.append((pair[0] - pair[1]) / (2 * STEP))
        return np.column_stack(out)

    def torque_of(self, faults, theta):
        """Torques in the channels of a robot with given faults and coefficients."""
        return (self._columns(faults) @ theta).reshape(-1, self.nv) * self.noise

    def coefficients(self):
        """Fit bodies and friction by least squares, with no fault."""
        return self._fitted(self._columns([]))[1]

    def explain(self, keys, start=None, hopeless=None):
        """Fit the robot with faults of given names and joints."""
        faults = [
            Fault(*key, tuple(NEUTRAL[key[0]] + START for _ in PARAMETERS[key[0]]))
            for key in keys
        ]
        known = {fault.key: fault for fault in start or ()}
        faults = [known.get(fault.key, fault) for fault in faults]
        U, theta, rest = self._fitted(self._columns(faults))
        std = ()
        for step in range(STEPS if faults else 0):
            D = self._derivatives(faults, theta)
            D = D - U @ (U.T @ D)
            change, *_ = np.linalg.lstsq(D, rest, rcond=1e-6)
            left = rest - D @ change
            if hopeless is not None and step == 0 and left @ left > hopeless:
                return self._explanation(faults, left, ())
            for _ in range(6):
                trial = _moved(faults, change)
                found = self._fitted(self._columns(trial))
                if found[2] @ found[2] <= rest @ rest:
                    break
                change = 0.3 * change
            else:
                break
            gained = rest @ rest - found[2] @ found[2]
            faults, (U, theta, rest) = trial, found
            if gained * self.weight**2 < 1e-3:
                break
        if faults:
            D = self._derivatives(faults, theta)
            std = _spread(self.weight * (D - U @ (U.T @ D)), faults)
        return self._explanation(faults, rest, std)

    def _explanation(self, faults, rest, std):
        squares = float(rest @ rest)
        return Explanation(
            tuple(faults),
            self.weight * np.sqrt(squares),
            np.sqrt(squares / self.n_rows),
            std,
        )

    def rivals(self, fault, others=()):
        """Name and joint of all that explains as well what a fault does."""
        kept = [other.key for other in others]
        without = self.explain(kept, start=others)
        most = HOPELESS * (without.distance / self.weight) ** 2
        found = {}
        for key in all_faults(self.nv):
            if key == fault.key or key in kept:
                continue
            told = self.explain([*kept, key], start=others, hopeless=most)
            if told.distance < SEPARATE:
                found[key] = told.distance
        return found


def _moved(faults, change):
    moved, at = [], 0
    for fault in faults:
        values = np.array(fault.values) + change[at : at + len(fault.values)]
        at += len(fault.values)
        most = MOST[fault.name]
        low = 1.0 / most if fault.name == "torque_gain" else -most
        moved.append(Fault(*fault.key, tuple(np.clip(values, low, most).tolist())))
    return moved


def _spread(D, faults):
    """Return standard errors of each fault's values from their whitened columns."""
    length = np.linalg.norm(D, axis=0)
    std = np.full(length.size, np.inf)
    used = length > RANK
    if used.any():
        _, s, Vt = np.linalg.svd(D[:, used] / length[used], full_matrices=False)
        variance = (Vt.T**2) @ (1.0 / np.maximum(s, 1e-12) ** 2)
        std[used] = np.sqrt(variance) / length[used]
    out, at = [], 0
    for fault in faults:
        out.append(std[at : at + len(fault.values)])
        at += len(fault.values)
    return tuple(out)
