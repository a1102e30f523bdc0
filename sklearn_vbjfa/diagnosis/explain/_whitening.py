"""Rows without what a residual's own past predicts: what is left is independent."""

import itertools

import numpy as np

from sklearn_vbjfa.diagnosis.search._blocks import Bridge, fit_memory


class Whitening:
    """Rows of all joints without what the residuals' past predicts."""

    # residual (nv, m): scaled by the root (m, nv) of the weights, which is zero for a
    # row that is left out; starts: first rows of the recordings; step [s]; cutoff: of
    # the low-pass that the rows have passed [Hz]; memory: of each joint.

    @classmethod
    def of(cls, view, residual, root=None):
        """Take the memory out of residuals of a view, with its weights unless given."""
        root = view.root if root is None else root
        return cls(residual, root, view.starts, view.step, view.robot.cutoff_)

    def __init__(self, residual, root, starts, step, cutoff=np.inf):
        # Rows further apart than half a period of the cut-off are as good as not
        # correlated by the low-pass.
        self._stride = max(1, int(np.ceil(0.5 / (cutoff * step) - 1e-9)))
        self._root, self._starts = root, np.asarray(starts)
        self._used = root > 0
        self._gaps = [Bridge.of(used, self._starts) for used in self._used.T]
        self.memory = []
        for j, own in enumerate(residual):
            used = self._used[:, j]
            values = np.where(used, own / np.where(used, root[:, j], 1.0), 0.0)
            self.memory.append(
                fit_memory(values, used, self._starts, step, self._stride)
            )

    def __call__(self, rows, joints):
        """Whiten rows (nj, m, ...) of joints, scaled by the root of the weights."""
        # Missing rows are bridged by straight lines, in torques and columns alike, so
        # that what explains the one explains the other; before its first row a
        # recording counts as constant.
        out = np.empty_like(rows)
        for i, j in enumerate(joints):
            shape = (-1,) + (1,) * (rows.ndim - 2)
            phi, root = self.memory[j].phi, self._root[:, j]
            x = rows[i] / np.where(root > 0, root, 1.0).reshape(shape)
            if self._gaps[j] is not None:
                x = self._gaps[j](x)
            out[i] = x
            edges = [*self._starts, x.shape[0]]
            for a, b in itertools.pairwise(edges):
                for k, coefficient in enumerate(phi, start=1):
                    past = min(k * self._stride, b - a)
                    out[i, a + past : b] -= coefficient * x[a : b - past]
                    out[i, a : a + past] -= coefficient * x[a]
            out[i] *= root.reshape(shape)
        return out


def memory_seconds(model):
    """How long the residual of each joint of a model stays correlated, list [s]."""
    return [m.time for m in Whitening.of(model.view, model.residual).memory]
