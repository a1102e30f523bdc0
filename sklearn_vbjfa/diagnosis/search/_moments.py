"""Second moments by joint and band of frequency: under other weights no row is read."""

import itertools
from weakref import WeakKeyDictionary

import numpy as np


def products(edges, one, other):
    """Products of columns (n, ...) and (n, ...) in each band, (n_bands, p, q)."""
    one, other = one.reshape(len(one), -1), other.reshape(len(other), -1)
    return np.array([one[a:b].T @ other[a:b] for a, b in itertools.pairwise(edges)])


class Moments:
    """Products of c groups of k columns with others, made when they are asked for.

    Parameters
    ----------
    joints : tuple of int
        Joints that the columns act on.
    columns : ndarray of shape (nj, n, c, k)
        Their cosines, sorted by band.
    """

    def __init__(self, joints, columns):
        self.joints, self.columns = joints, columns
        self._gram = None
        self._declared, self._right = WeakKeyDictionary(), WeakKeyDictionary()
        self._others = WeakKeyDictionary()

    def gram(self, edges):
        """With themselves, group by group, (nj, n_bands, c, k, k)."""
        if self._gram is None:
            turned = self.columns.transpose(0, 2, 3, 1)
            self._gram = np.array(
                [
                    [
                        F[:, :, a:b] @ F[:, :, a:b].transpose(0, 2, 1)
                        for a, b in itertools.pairwise(edges)
                    ]
                    for F in turned
                ]
            )
        return self._gram

    def declared(self, problem):
        """With the declared columns of their joints, (nj, n_bands, r, c * k)."""
        key = problem.root
        if key not in self._declared:
            self._declared[key] = np.array(
                [
                    products(problem.cosines.edges, problem.Z[j], own)
                    for j, own in zip(self.joints, self.columns)
                ]
            )
        return self._declared[key]

    def right(self, problem):
        """With the torques of their joints, (nj, n_bands, c * k)."""
        if problem not in self._right:
            self._right[problem] = np.array(
                [
                    products(problem.cosines.edges, problem.y[j], own)[:, 0]
                    for j, own in zip(self.joints, self.columns)
                ]
            )
        return self._right[problem]

    def between(self, other, edges):
        """With those of another, (n_bands, p, q) by joint that both act on, a dict."""
        if other not in self._others:
            self._others[other] = {
                j: products(edges, own, other.columns[other.joints.index(j)])
                for j, own in zip(self.joints, self.columns)
                if j in other.joints
            }
        return self._others[other]
