"""Joint-torque regressors of many samples at once.

A body is a cloud of points. The point with coordinates xi in the frame of its joint is
at ``p + xi_1 e_1 + xi_2 e_2 + xi_3 e_3``, with the frame's origin p and axes e_k in
world coordinates, and accelerates with ``a + xi_1 d_1 + xi_2 d_2 + xi_3 d_3``. Summing
mass times acceleration, and its moment, over the points gives all ten columns of a
body's regressor as cross products of two lists of four vectors, (p, e_1, e_2, e_3) and
(a, d_1, d_2, d_3). The torque of a joint is its screw times the forces on the bodies
that it carries: one matrix product for each sample.

Working memory of a chunk of samples.
"""

import functools
import math

import numpy as np

from sklearn_vbjfa.model._loading import import_pinocchio
from sklearn_vbjfa.physical._pseudo_inertia import pseudo_inertia

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


# Columns of xx, yy, zz and of xy, yz, zx.
_SQUARES = (4, 6, 9)
_PRODUCTS = (5, 8, 7)


@functools.cache
def load_kernel():
    """Return the compiled loop over samples, or None where Numba is not installed."""
    try:
        from sklearn_vbjfa.model._compiled import fill
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return None
    return fill


def _runs(chosen):
    """Split chosen entries into long runs (slices) and the others (indices)."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    begin, end = edges[::2], edges[1::2]
    # Slices are faster for some entries, indices for scattered ones.
    long = end - begin >= 20
    single = chosen.copy()
    runs = [slice(i, j) for i, j in zip(begin[long], end[long])]
    for run in runs:
        single[run] = False
    return runs, np.flatnonzero(single)


def _repeat(x):
    """Fill in the repeated coordinates."""
    x[3:] = x[:2]
    return x


def _cross(x, y, out, work):
    """Cross product of vectors with repeated coordinates."""
    np.multiply(x[1:4], y[2:5], out=out)
    np.multiply(x[2:5], y[1:4], out=work)
    np.subtract(out, work, out=out)
    return out


def _accumulate(terms, out, work):
    """Sum ``sign * x * y`` over triples (sign, x, y), the first one positive."""
    (_, x, y), *others = terms
    np.multiply(x, y, out=out)
    for sign, x, y in others:
        sign(out, np.multiply(x, y, out=work), out=out)
    return out


class TreeRegressor:
    """Joint-torque regressors and inverse dynamics of a tree of joints.

    Parameters
    ----------
    model : pinocchio.Model
        Robot with a fixed base whose joints have one degree of freedom each; see
        `load_model`. Its gravity and geometry are copied.
    chunk : int, default=None
        Samples computed at once by NumPy; None chooses by the number of joints.
    compiled : bool, default=None
        Whether a loop compiled by Numba computes the regressors, three times as fast
        as NumPy; None does so where Numba is installed.

    Attributes
    ----------
    nv : int
        Number of joints.
    carried : ndarray of shape (nv, nv), bool
        Whether joint j (first axis) carries body i; the other entries of a regressor
        are zero.
    """

    def __init__(self, model, chunk=None, compiled=None):
        pin = import_pinocchio()
        nv = model.nv
        self.nv = nv
        self.compiled = compiled
        self.chunk = chunk_size(nv) if chunk is None else chunk
        self._parents = [int(k) - 1 for k in model.parents][1:]
        self.carried = np.eye(nv, dtype=bool)
        for i, parent in enumerate(self._parents):
            if parent >= 0:
                self.carried[:, i] |= self.carried[:, parent]
        # Sums over the joints that carry a body, and over those that carry its parent.
        self._carried = self.carried.astype(float)
        self._to_body = self._carried.T.copy()
        self._to_parent = self._to_body - np.eye(nv)
        # Offset and axes of a joint at zero in the axes of its parent.
        self._placements = np.empty((nv, 4, 3))
        # Turn about axis 1, 2 or 3, then the product with a matrix unless that is None.
        self._about = np.full(nv, 2)
        self._realign = [None] * nv
        self._turns = np.empty((nv, 1), dtype=bool)
        self._slides = np.empty((nv, 1))
        # A base that accelerates upwards takes the place of gravity.
        self._base = -model.gravity.linear, -model.gravity.angular
        self._roots = {}
        # Working memory between calls; each call in progress has its own.
        self._spare = []
        data, zero = model.createData(), np.zeros(model.nq)
        for i in range(nv):
            # The motion of a joint in its own frame is the same everywhere.
            pin.forwardKinematics(model, data, zero, np.eye(nv)[i])
            self._set_joint(i, data.liMi[i + 1], data.v[i + 1])

    def _set_joint(self, i, placement, motion):
        """Store joint i, which moves its body by a motion from a placement."""
        turns = motion.angular.any()
        axis = motion.angular if turns else motion.linear
        length = np.linalg.norm(axis)
        axis = axis / length
        self._turns[i] = turns
        # A helical joint does both.
        self._slides[i] = motion.linear @ axis
        rotation = placement.rotation
        if axis.max() == 1.0:
            self._about[i] = np.argmax(axis)
        else:
            first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
            first /= np.linalg.norm(first)
            self._realign[i] = np.column_stack([first, np.cross(axis, first), axis])
            rotation = rotation @ self._realign[i]
        self._placements[i, 0] = placement.translation
        self._placements[i, 1:] = rotation.T
        if self._parents[i] < 0:
            # Moments about the first joint rather than the world's origin, where those
            # of a robot far away would be rounded.
            self._placements[i, 0] = 0.0
            linear, angular = self._base
            self._roots[i] = linear + np.cross(angular, placement.translation)

    def __call__(self, q, v, a, out=None, zeros=None):
        """Compute the regressor matrices.

        Parameters
        ----------
        q, v, a : ndarray of shape (n, nv)
            Positions, velocities, accelerations.
        out : ndarray of shape (n, nv, nv, k), default=None
            Where to write, C-contiguous, with k >= 10; columns after the tenth become
            zero. None makes an array with k = 10.
        zeros : ndarray of shape (nv, nv, 10), bool, default=None
            Entries to set to zero besides those of bodies that a joint does not carry.

        Returns
        -------
        ndarray of shape (n, nv, nv, k)
            Derivatives of the torque of a joint (second axis) by the parameters of a
            body (third axis): m, mc_x, mc_y, mc_z, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
        """
        n, nv = q.shape[0], self.nv
        if out is None:
            out = np.empty((n, nv, nv, 10))
        k = out.shape[-1]
        if out.shape != (n, nv, nv, k) or k < 10 or not out.flags.c_contiguous:
            raise ValueError(
                f"out must be C-contiguous, of shape ({n}, {nv}, {nv}, at least 10); "
                f"got shape {out.shape}."
            )
        kernel = None if self.compiled is False else load_kernel()
        if kernel is None and self.compiled:
            raise ImportError(
                "A compiled regressor needs Numba: pip install sklearn-vbjfa[fast]."
            )
        if kernel is not None:
            kernel(*map(np.ascontiguousarray, (q, v, a)), *self._tree(zeros), out)
            return out
        blank = np.zeros((nv, nv, k), dtype=bool)
        blank[~self.carried] = True
        if zeros is not None:
            blank[..., :10] |= zeros
        runs, single = _runs(blank.ravel())
        for chunk, rows in self._chunks(q, v, a, k):
            size = chunk.size
            wrenches, screws = chunk.wrenches_by_sample, chunk.screws_by_sample
            self._body_moments(chunk)
            wrenches[:, :3, :, :4] = chunk.fields[:3, :4].transpose(3, 0, 2, 1)
            wrenches[:, 3:, :, :10] = chunk.moments.transpose(3, 0, 2, 1)
            screws[:] = chunk.screws.transpose(2, 0, 1)
            np.matmul(
                screws.transpose(0, 2, 1),
                wrenches.reshape(size, 6, nv * k),
                out=out[rows].reshape(size, nv, nv * k),
            )
            flat = out[rows].reshape(size, -1)
            for run in runs:
                flat[:, run] = 0.0
            flat[:, single] = 0.0
        return out

    def _tree(self, zeros):
        """Return what the compiled loop needs to know of the robot."""
        realign = [np.eye(3) if turn is None else turn for turn in self._realign]
        base = np.zeros((self.nv, 3))
        for i, acceleration in self._roots.items():
            base[i] = acceleration
        entries = np.zeros((self.nv, self.nv, 10), dtype=bool)
        if zeros is not None:
            entries |= zeros
        entries[~self.carried] = False
        return (
            np.array(self._parents),
            self._about,
            self._placements,
            np.array(realign),
            np.array([turn is not None for turn in self._realign]),
            self._turns[:, 0].astype(float),
            self._slides[:, 0].copy(),
            base,
            tuple(float(x) for x in self._base[1]),
            np.argwhere(~self.carried).copy(order="C"),
            np.argwhere(entries).copy(order="C"),
        )

    def torques(self, q, v, a, inertial):
        """Compute inverse dynamics for any inertial parameters.

        Parameters
        ----------
        q, v, a : ndarray of shape (n, nv)
            Positions, velocities, accelerations.
        inertial : array-like of shape (nv, 10)
            Parameters of the bodies in the order of the regressor's columns; they need
            not belong to any distribution of mass.

        Returns
        -------
        ndarray of shape (n, nv)
            Torques of gravity and inertia, without friction and rotors.
        """
        # Mass and first moments before the second moments, as p before e_k.
        pseudo = np.roll(pseudo_inertia(inertial), 1, axis=(-2, -1))[:, None]
        torque = np.empty(q.shape)
        for chunk, rows in self._chunks(q, v, a):
            # Sums of mass times acceleration, and of that times xi_k; the products
            # with p and e_k are the moment. The memory is that of other arrays.
            shape = (5, 4, self.nv, chunk.size)
            moved = chunk.moments.reshape(-1)[: math.prod(shape)].reshape(shape)
            np.matmul(
                pseudo,
                chunk.fields[:3, :4].transpose(2, 0, 1, 3),
                out=moved[:3].transpose(2, 0, 1, 3),
            )
            places = chunk.places[:, :4]
            moment = _cross(places, _repeat(moved), chunk.squares, chunk.scratch)
            np.multiply(chunk.screws[:3], self._carried @ moved[:3, 0], out=chunk.own)
            np.add(moment[:, 0], moment[:, 1], out=chunk.step)
            chunk.step += moment[:, 2]
            chunk.step += moment[:, 3]
            np.multiply(chunk.screws[3:], self._carried @ chunk.step, out=chunk.work)
            chunk.own += chunk.work
            torque[rows] = chunk.own.sum(axis=0).T
        return torque

    def _chunks(self, q, v, a, k=0):
        """Yield arrays of places and accelerations, and the rows they are for."""
        chunk = None
        for begin in range(0, q.shape[0], self.chunk):
            rows = slice(begin, min(begin + self.chunk, q.shape[0]))
            size = rows.stop - begin
            if chunk is None or chunk.size != size:
                if chunk is not None:
                    self._spare.append(chunk.memory)
                chunk = Chunk(self.nv, size, k, self._spare)
            now = [np.ascontiguousarray(x[rows].T) for x in (q, v, a)]
            self._place(chunk, now[0])
            self._move(chunk, *now)
            yield chunk, rows
        if chunk is not None:
            self._spare.append(chunk.memory)

    def __getstate__(self):
        """Leave the working memory behind."""
        return {**self.__dict__, "_spare": []}

    def _place(self, chunk, q):
        """Fill in the frames of the bodies and the axes of the joints."""
        frames, size = chunk.frames, chunk.size
        cosine, sine = np.cos(q), np.sin(q)
        work = np.empty((2, 3, size))
        for i, parent in enumerate(self._parents):
            frame = frames[i]
            placement = self._placements[i]
            if parent < 0:
                frame[:] = placement[:, :, None]
            else:
                above = frames[parent, 1:].reshape(3, -1)
                np.matmul(placement, above, out=frame.reshape(4, -1))
            about = self._about[i]
            chunk.axes[i] = frame[1 + about]
            if self._turns[i]:
                pair = frame[(slice(2, 4), slice(3, 0, -2), slice(1, 3))[about]]
                np.multiply(pair, sine[i], out=work)
                np.multiply(pair, cosine[i], out=pair)
                pair[0] += work[1]
                pair[1] -= work[0]
            if self._realign[i] is not None:
                above = frame[1:].reshape(3, -1)
                above[:] = self._realign[i] @ above
        axis, offset, places = chunk.axis, chunk.offset, chunk.places
        axis[:3] = chunk.axes.transpose(1, 0, 2)
        offset[:3] = frames[:, 0].transpose(1, 0, 2)
        if self._slides.any():
            offset[:3] += axis[:3] * (self._slides * q)
        np.matmul(self._to_body, offset[:3], out=places[:3, 0])
        places[:3, 1:4] = frames[:, 1:].transpose(2, 1, 0, 3)
        places[:3, 4] = places[:3, 1]
        for x in (axis, offset, places):
            _repeat(x)

    def _move(self, chunk, q, v, a):
        """Fill in the accelerations of the bodies and the screws of the joints."""
        angular = self._base[1]
        axis, screws, work = chunk.axis, chunk.screws, chunk.work
        step, coriolis, own = chunk.step, chunk.coriolis, chunk.own
        sliding = self._slides.any()
        turning = (v, a) if self._turns.all() else (v * self._turns, a * self._turns)
        _cross(chunk.places[:, 0], axis, screws[:3], work)
        screws[3:] = axis[:3]
        if sliding:
            screws *= self._turns
            screws[:3] += self._slides * axis[:3]
        # Angular velocity and acceleration of the parents, then of the bodies.
        above, faster_above = chunk.velocity_above, chunk.acceleration_above
        velocity, acceleration = chunk.velocity, chunk.acceleration
        np.multiply(axis[:3], turning[0], out=step)
        np.matmul(self._to_parent, step, out=above[:3])
        np.add(above[:3], step, out=velocity[:3])
        _repeat(velocity)
        _cross(_repeat(above), axis, coriolis, work)
        np.multiply(coriolis, turning[0], out=step)
        step += np.multiply(axis[:3], turning[1], out=work)
        np.matmul(self._to_parent, step, out=faster_above[:3])
        if angular.any():
            faster_above[:3] += angular[:, None, None]
        np.add(faster_above[:3], step, out=acceleration[:3])
        _repeat(acceleration)
        # Accelerations of the origins.
        turned = chunk.turned
        _cross(above, chunk.offset, turned[:3], work)
        _cross(above, _repeat(turned), step, work)
        step += _cross(_repeat(faster_above), chunk.offset, own, work)
        if sliding:
            step += coriolis * (2.0 * self._slides * v)
            step += axis[:3] * (self._slides * a)
        for i, base in self._roots.items():
            step[:, i] += base[:, None]
        np.matmul(self._to_body, step, out=chunk.fields[:3, 0])
        self._differentiate(chunk)
        chunk.fields[:3, 4] = chunk.fields[:3, 1]
        _repeat(chunk.fields)

    def _differentiate(self, chunk):
        """Fill in d_k, the acceleration of the tip of e_k relative to its tail."""
        w, dw = chunk.velocity, chunk.acceleration
        # [dw]x + [w]x [w]x: its diagonal, and the entries one and two to the right.
        own, first, second, work = chunk.own, chunk.step, chunk.coriolis, chunk.work
        np.multiply(w[:3], w[:3], out=own)
        np.sum(own, axis=0, out=work[0])
        own -= work[0]
        np.multiply(w[:3], w[1:4], out=first)
        first -= dw[2:]
        np.multiply(w[:3], w[2:], out=second)
        second += dw[1:4]
        edges = chunk.places[:, 1:4]
        _accumulate(
            [
                (np.add, own[:, None], edges[:3]),
                (np.add, first[:, None], edges[1:4]),
                (np.add, second[:, None], edges[2:]),
            ],
            chunk.fields[:3, 1:4],
            chunk.scratch[:, :3],
        )

    def _body_moments(self, chunk):
        """Fill in the moment of each body's forces by its parameters."""
        moments, own, scratch = chunk.moments, chunk.squares, chunk.scratch
        # Coordinates that follow x, y, z, and those after them.
        x, xx = chunk.places[1:4], chunk.places[2:]
        y, yy = chunk.fields[1:4], chunk.fields[2:]
        _accumulate(
            [(np.add, x[:, :4], yy[:, :4]), (np.subtract, xx[:, :4], y[:, :4])],
            own,
            scratch,
        )
        moments[:, 0] = own[:, 0]
        _accumulate(
            [
                (np.add, x[:, :1], yy[:, 1:4]),
                (np.add, x[:, 1:4], yy[:, :1]),
                (np.subtract, xx[:, :1], y[:, 1:4]),
                (np.subtract, xx[:, 1:4], y[:, :1]),
            ],
            moments[:, 1:4],
            scratch[:, :3],
        )
        # A moment of inertia sums the squares of the other two coordinates.
        half = np.add(own[:, 1], own[:, 2], out=chunk.work)
        half += own[:, 3]
        half *= 0.5
        for k, column in enumerate(_SQUARES):
            np.subtract(half, own[:, 1 + k], out=moments[:, column])
        # A product of inertia is a mixed second moment times minus one.
        mixed = _accumulate(
            [
                (np.add, xx[:, 1:4], y[:, 2:]),
                (np.add, xx[:, 2:], y[:, 1:4]),
                (np.subtract, x[:, 1:4], yy[:, 2:]),
                (np.subtract, x[:, 2:], yy[:, 1:4]),
            ],
            own[:, :3],
            scratch[:, :3],
        )
        for k, column in enumerate(_PRODUCTS):
            moments[:, column] = mixed[:, k]
