"""Working memory of a chunk of samples."""

import math

import numpy as np

# Bodies times samples of a chunk: few enough for the arrays (8 MB) to stay in the
# processor's cache, enough for NumPy's cost per call to be small beside the work.
_CHUNK = 4000
# Where the number of samples is a power of two, columns of an array crowd a few sets
# of the cache; an odd number of cache lines spreads them.
_LINE = 8


def chunk_size(nv):
    """Return the samples of a chunk: an odd number of cache lines."""
    return _LINE * (_CHUNK // nv // _LINE // 2 * 2 + 1)


class Chunk:
    """Arrays for a chunk of samples, in world coordinates; samples along the last axis.

    The axis before it counts bodies, the first one coordinates of vectors: x, y, z,
    and often x, y again, which makes the two halves of a cross product slices. `places`
    and `fields` hold (p, e_1, e_2, e_3, e_1) and (a, d_1, d_2, d_3, d_1) along their
    second axis; the repetition makes the pairs xy, yz, zx a slice.

    Parameters
    ----------
    nv, size, k : int
        Numbers of bodies, samples, and columns by body.
    spare : list of ndarray
        Memory to use if it suffices; new memory costs as much as a chunk's work.
    """

    def __init__(self, nv, size, k, spare):
        self.size = size
        vector, repeated = (3, nv, size), (5, nv, size)
        shapes = {
            # By body, and then offset from the parent, e_1, e_2, e_3.
            "frames": (nv, 4, 3, size),
            "axes": (nv, 3, size),
            "places": (5, 5, nv, size),
            "fields": (5, 5, nv, size),
            "moments": (3, 10, nv, size),
            "screws": (6, nv, size),
            "axis": repeated,
            "offset": repeated,
            "velocity": repeated,
            "acceleration": repeated,
            "velocity_above": repeated,
            "acceleration_above": repeated,
            "turned": repeated,
            "coriolis": vector,
            "step": vector,
            "own": vector,
            "work": vector,
            "squares": (3, 4, nv, size),
            "scratch": (3, 4, nv, size),
            # Arguments of the matrix product, sample by sample.
            "wrenches_by_sample": (size, 6, nv, k),
            "screws_by_sample": (size, 6, nv),
        }
        # Whole cache lines.
        lengths = [-(-math.prod(shape) // _LINE) * _LINE for shape in shapes.values()]
        try:
            self.memory = spare.pop()
        except IndexError:
            self.memory = np.empty(0)
        if self.memory.size < sum(lengths):
            self.memory = np.empty(sum(lengths))
        end = 0
        for (name, shape), length in zip(shapes.items(), lengths):
            part = self.memory[end : end + math.prod(shape)]
            setattr(self, name, part.reshape(shape))
            end += length
        self.wrenches_by_sample[:] = 0.0
