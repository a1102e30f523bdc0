"""Second moments by joint and band of frequency, or block of time, read once."""

import copy
import functools
import itertools
from weakref import WeakKeyDictionary

import numpy as np


def products(edges, one, other):
    """Products of columns (n, ...) and (n, ...) in each band, (n_bands, p, q)."""
    one, other = one.reshape(len(one), -1), other.reshape(len(other), -1)
    return np.array([one[a:b].T @ other[a:b] for a, b in itertools.pairwise(edges)])


class Declared:
    """Declared columns and torques of all joints, in bands or blocks."""

    # Z (nv, n, r) and y (nv, n) are sorted by band; edges (n_bands + 1,): where each
    # begins, and the last one ends.

    _root = None

    def __init__(self, Z, y, edges):
        self.Z, self.y, self.edges = Z, y, edges

    @property
    def root(self):
        """The same columns with the torques that were given."""
        return self if self._root is None else self._root

    @functools.cached_property
    def gram(self):
        """Products of the columns by joint and band, (nv, n_bands, r, r)."""
        return np.array([products(self.edges, Z, Z) for Z in self.Z])

    @functools.cached_property
    def right(self):
        """Products of these with the torques, (nv, n_bands, r)."""
        pairs = zip(self.Z, self.y)
        return np.array([products(self.edges, Z, y)[:, :, 0] for Z, y in pairs])

    @functools.cached_property
    def power(self):
        """Square sums of the torques, (nv, n_bands)."""
        return np.add.reduceat(self.y**2, self.edges[:-1], axis=1)

    def with_torques(self, y):
        """Return the same columns with other torques."""
        made = copy.copy(self)
        made.y, made._root = y, self.root
        # What is made of the columns alone stays.
        for name in ("right", "power"):
            made.__dict__.pop(name, None)
        return made


class Moments:
    """Products of c groups of k columns with others, made when they are asked for."""

    # columns (nj, n, c, k), sorted by band, act on `joints`; edges: see `Declared`.

    def __init__(self, joints, columns, edges):
        self.joints, self.columns, self.edges = joints, columns, edges
        self._declared, self._right = WeakKeyDictionary(), WeakKeyDictionary()
        self._others = WeakKeyDictionary()

    def of(self, columns):
        """Return those of other columns of the same joints."""
        return Moments(self.joints, columns, self.edges)

    @functools.cached_property
    def gram(self):
        """With themselves, group by group, (nj, n_bands, c, k, k)."""
        turned = self.columns.transpose(0, 2, 3, 1)
        return np.array(
            [
                [
                    F[:, :, a:b] @ F[:, :, a:b].transpose(0, 2, 1)
                    for a, b in itertools.pairwise(self.edges)
                ]
                for F in turned
            ]
        )

    def declared(self, of):
        """With the `Declared` columns of their joints, (nj, n_bands, r, c * k)."""
        if of.root not in self._declared:
            pairs = zip(self.joints, self.columns)
            self._declared[of.root] = np.array(
                [products(self.edges, of.Z[j], own) for j, own in pairs]
            )
        return self._declared[of.root]

    def right(self, of):
        """With the torques of their joints, (nj, n_bands, c * k)."""
        if of not in self._right:
            pairs = zip(self.joints, self.columns)
            self._right[of] = np.array(
                [products(self.edges, of.y[j], own)[:, 0] for j, own in pairs]
            )
        return self._right[of]

    def between(self, other):
        """With those of another, (n_bands, p, q) by joint that both act on, a dict."""
        if other not in self._others:
            self._others[other] = {
                j: products(self.edges, own, other.columns[other.joints.index(j)])
                for j, own in zip(self.joints, self.columns)
                if j in other.joints
            }
        return self._others[other]
