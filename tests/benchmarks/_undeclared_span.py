"""What the declared columns of a robot can explain, with its true states."""

import numpy as np
from _undeclared_robots import regressor


class DeclaredSpan:
    """Torques that the declared columns can explain, with the true states."""

    def __init__(self, model, states, declared, torque_noise):
        n, nv = states.shape[0], torque_noise.size
        # every few samples are enough for a variance and leave the reversals in
        self.rows_ = np.arange(0, n, max(1, n // 2500))
        self.torque_noise = torque_noise
        q, v, a = np.split(states[self.rows_], 3, axis=1)
        shapes = friction_shapes(declared, v, a)
        blocks = [shape[:, :, None] * np.eye(nv) for shape in shapes.values()]
        Phi = np.concatenate([regressor(model, q, v, a), *blocks], axis=2)
        Phi = (Phi / torque_noise[:, None]).reshape(-1, Phi.shape[2])
        length = np.linalg.norm(Phi, axis=0)
        Phi = Phi[:, length > 0] / length[length > 0]
        U, s, _ = np.linalg.svd(Phi, full_matrices=False)
        self.basis_ = U[:, s > 1e-9 * s[0]]

    def residual(self, torque, others=()):
        """Part of a torque (n, nv) outside the span and other torques, whitened."""
        basis = self.basis_
        r = self._without(self._white(torque), basis)
        if len(others):
            rest = [self._without(self._white(x), basis) for x in others]
            U, s, _ = np.linalg.svd(np.column_stack(rest), full_matrices=False)
            r = self._without(r, U[:, s > 1e-9 * max(s[0], 1e-300)])
        return r

    def share(self, torque, others=()):
        """Share of the RMS of a torque outside the span and other torques."""
        whole = np.linalg.norm(self._white(torque))
        return float(np.linalg.norm(self.residual(torque, others)) / max(whole, 1e-300))

    def _white(self, torque):
        return (torque[self.rows_] / self.torque_noise).ravel()

    @staticmethod
    def _without(x, basis):
        # twice, since one pass leaves rounding errors of the size of x
        x = x - basis @ (basis.T @ x)
        return x - basis @ (basis.T @ x)


def friction_shapes(declared, v, a=None):
    """Columns of the declared terms, each (n, nv), as they are in the torque."""
    shapes = {
        "viscous": v,
        "coulomb": np.sign(v),
        "offset": np.ones_like(v),
        "rotor_inertia": a,
    }
    return {name: shapes[name] for name in declared}
