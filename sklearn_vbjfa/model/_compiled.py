"""Joint-torque regressors sample by sample, compiled.

The algorithm is that of `sklearn_vbjfa.model._regressor`, whose docstring explains it.
There NumPy spreads every step over many samples; here a loop over samples is compiled
by Numba, which keeps all that belongs to one sample in registers and the nearest cache.
Numba is optional, and this module the only one to import it: without it NumPy does the
work. Vectors are tuples, which the compiler, unlike arrays, knows not to overlap.
"""

import math

import numba
import numpy as np

# The machine code is kept on disk: only the first use after an installation takes the
# seconds of the compilation. Fused multiplications and additions round once instead of
# twice.
_compiled = numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"contract"}
)


@_compiled
def _vector(x):
    """Return three numbers as a tuple."""
    return x[0], x[1], x[2]


@_compiled
def _store(x, out):
    """Write a vector to memory."""
    out[0], out[1], out[2] = x


@_compiled
def _cross(x, y):
    """Cross product of two vectors."""
    return (
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    )


@_compiled
def _axpy(a, x, y):
    """Return a x + y."""
    return a * x[0] + y[0], a * x[1] + y[1], a * x[2] + y[2]


@_compiled
def _combine(a, x, y, z):
    """Return a_1 x + a_2 y + a_3 z."""
    return (
        a[0] * x[0] + a[1] * y[0] + a[2] * z[0],
        a[0] * x[1] + a[1] * y[1] + a[2] * z[1],
        a[0] * x[2] + a[1] * y[2] + a[2] * z[2],
    )


@_compiled
def fill(
    q,
    v,
    a,
    parents,
    about,
    placements,
    realign,
    turned,
    turns,
    slides,
    base,
    base_angular,
    blank,
    zeros,
    out,
):
    """Fill in the regressor matrices of samples.

    Parameters
    ----------
    q, v, a : ndarray of shape (n, nv)
        Positions, velocities, accelerations.
    parents : ndarray of shape (nv,)
        Number of the parent, -1 for none.
    about : ndarray of shape (nv,)
        Which of a joint's axes it turns about or slides along.
    placements : ndarray of shape (nv, 4, 3)
        Offset and axes of a joint at zero in the axes of its parent.
    realign : ndarray of shape (nv, 3, 3)
        Axes of the body in those of `placements`, where `turned`.
    turned : ndarray of shape (nv,), bool
        Whether that is not the identity.
    turns, slides : ndarray of shape (nv,)
        Radians and metres by unit of the joint's position.
    base : ndarray of shape (nv, 3)
        Acceleration that takes the place of gravity, of joints without parent.
    base_angular : tuple of 3 float
        Its angular part.
    blank : ndarray of shape (n_blank, 2)
        Pairs of a joint and a body that it does not carry.
    zeros : ndarray of shape (n_zeros, 3)
        Other entries of a matrix that are zero in every motion.
    out : ndarray of shape (n, nv, nv, k), k >= 10
        Regressor matrices.
    """
    n, nv = q.shape
    k_all = out.shape[3]
    zero = (0.0, 0.0, 0.0)
    # By body: axes, origin and its acceleration, angular velocity and acceleration.
    axes = np.empty((nv, 3, 3))
    places = np.empty((nv, 3))
    fields = np.empty((nv, 3))
    speeds = np.empty((nv, 3))
    gains = np.empty((nv, 3))
    screws = np.empty((nv, 6))
    for sample in range(n):
        matrix = out[sample]
        for j in range(nv):
            parent = parents[j]
            offset = _vector(placements[j, 0])
            x = _vector(placements[j, 1])
            y = _vector(placements[j, 2])
            z = _vector(placements[j, 3])
            if parent < 0:
                p, w, dw = zero, zero, base_angular
                field = _vector(base[j])
            else:
                e1, e2, e3 = (
                    _vector(axes[parent, 0]),
                    _vector(axes[parent, 1]),
                    _vector(axes[parent, 2]),
                )
                offset = _combine(offset, e1, e2, e3)
                x = _combine(x, e1, e2, e3)
                y = _combine(y, e1, e2, e3)
                z = _combine(z, e1, e2, e3)
                p, field = _vector(places[parent]), _vector(fields[parent])
                w, dw = _vector(speeds[parent]), _vector(gains[parent])
            cosine, sine = math.cos(q[sample, j]), math.sin(q[sample, j])
            turn, slide = turns[j], slides[j]
            if turn == 0.0:
                cosine, sine = 1.0, 0.0
            if about[j] == 0:
                axis = x
                y, z = (
                    _combine((cosine, sine, 0.0), y, z, zero),
                    _combine((-sine, cosine, 0.0), y, z, zero),
                )
            elif about[j] == 1:
                axis = y
                z, x = (
                    _combine((cosine, sine, 0.0), z, x, zero),
                    _combine((-sine, cosine, 0.0), z, x, zero),
                )
            else:
                axis = z
                x, y = (
                    _combine((cosine, sine, 0.0), x, y, zero),
                    _combine((-sine, cosine, 0.0), x, y, zero),
                )
            if turned[j]:
                x, y, z = (
                    _combine(_vector(realign[j, 0]), x, y, z),
                    _combine(_vector(realign[j, 1]), x, y, z),
                    _combine(_vector(realign[j, 2]), x, y, z),
                )
            offset = _axpy(slide * q[sample, j], axis, offset)
            p = _axpy(1.0, p, offset)
            across = _cross(w, axis)
            field = _axpy(1.0, _cross(w, _cross(w, offset)), field)
            field = _axpy(1.0, _cross(dw, offset), field)
            field = _axpy(2.0 * slide * v[sample, j], across, field)
            field = _axpy(slide * a[sample, j], axis, field)
            w = _axpy(turn * v[sample, j], axis, w)
            dw = _axpy(turn * a[sample, j], axis, dw)
            dw = _axpy(turn * v[sample, j], across, dw)
            _store(x, axes[j, 0])
            _store(y, axes[j, 1])
            _store(z, axes[j, 2])
            _store(p, places[j])
            _store(field, fields[j])
            _store(w, speeds[j])
            _store(dw, gains[j])
            lever = _cross(p, axis)
            for c in range(3):
                screws[j, c] = turn * lever[c] + slide * axis[c]
                screws[j, 3 + c] = turn * axis[c]

            # Acceleration of the tip of an axis relative to its tail: M e_k with
            # M = [dw]x + w w' - |w|^2, by its columns.
            square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
            m1 = w[0] * w[0] - square, w[0] * w[1] + dw[2], w[0] * w[2] - dw[1]
            m2 = w[0] * w[1] - dw[2], w[1] * w[1] - square, w[1] * w[2] + dw[0]
            m3 = w[0] * w[2] + dw[1], w[1] * w[2] - dw[0], w[2] * w[2] - square
            dx = _combine(x, m1, m2, m3)
            dy = _combine(y, m1, m2, m3)
            dz = _combine(z, m1, m2, m3)

            # Moments by the mass, the first moments and the moments of inertia.
            of_m = _cross(p, field)
            of_x = _axpy(1.0, _cross(p, dx), _cross(x, field))
            of_y = _axpy(1.0, _cross(p, dy), _cross(y, field))
            of_z = _axpy(1.0, _cross(p, dz), _cross(z, field))
            xx, yy, zz = _cross(x, dx), _cross(y, dy), _cross(z, dz)
            half = _combine((0.5, 0.5, 0.5), xx, yy, zz)
            of_xx = _axpy(-1.0, xx, half)
            of_yy = _axpy(-1.0, yy, half)
            of_zz = _axpy(-1.0, zz, half)
            of_xy = _axpy(1.0, _cross(dx, y), _cross(dy, x))
            of_xz = _axpy(1.0, _cross(dx, z), _cross(dz, x))
            of_yz = _axpy(1.0, _cross(dy, z), _cross(dz, y))

            # The joint itself and all those above it.
            i = j
            while i >= 0:
                s0, s1, s2 = screws[i, 0], screws[i, 1], screws[i, 2]
                s3, s4, s5 = screws[i, 3], screws[i, 4], screws[i, 5]
                target = matrix[i, j]
                r0 = s3 * of_m[0] + s4 * of_m[1] + s5 * of_m[2]
                r1 = s3 * of_x[0] + s4 * of_x[1] + s5 * of_x[2]
                r2 = s3 * of_y[0] + s4 * of_y[1] + s5 * of_y[2]
                r3 = s3 * of_z[0] + s4 * of_z[1] + s5 * of_z[2]
                r4 = s3 * of_xx[0] + s4 * of_xx[1] + s5 * of_xx[2]
                r5 = s3 * of_xy[0] + s4 * of_xy[1] + s5 * of_xy[2]
                r6 = s3 * of_yy[0] + s4 * of_yy[1] + s5 * of_yy[2]
                r7 = s3 * of_xz[0] + s4 * of_xz[1] + s5 * of_xz[2]
                r8 = s3 * of_yz[0] + s4 * of_yz[1] + s5 * of_yz[2]
                r9 = s3 * of_zz[0] + s4 * of_zz[1] + s5 * of_zz[2]
                r0 += s0 * field[0] + s1 * field[1] + s2 * field[2]
                r1 += s0 * dx[0] + s1 * dx[1] + s2 * dx[2]
                r2 += s0 * dy[0] + s1 * dy[1] + s2 * dy[2]
                r3 += s0 * dz[0] + s1 * dz[1] + s2 * dz[2]
                target[0] = r0
                target[1] = r1
                target[2] = r2
                target[3] = r3
                target[4] = r4
                target[5] = r5
                target[6] = r6
                target[7] = r7
                target[8] = r8
                target[9] = r9
                for k in range(10, k_all):
                    target[k] = 0.0
                i = parents[i]
        for pair in range(blank.shape[0]):
            target = matrix[blank[pair, 0], blank[pair, 1]]
            for k in range(k_all):
                target[k] = 0.0
        for entry in range(zeros.shape[0]):
            matrix[zeros[entry, 0], zeros[entry, 1], zeros[entry, 2]] = 0.0
