"""The loop over samples of `sklearn_vbjfa.model._regressor`, compiled by Numba.

Numba is optional, and this module the only one to import it.  Vectors are tuples, which
the compiler, unlike arrays, knows not to overlap.
"""

import math

import numba
import numpy as np

# The machine code is kept on disk: only the first use after an installation takes the
# seconds of the compilation.  Fused multiplications and additions round once instead of
# twice.
_compiled = numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"contract"}
)


@_compiled
def _vector(x):
    """Return three numbers as a tuple."""
    return x[0], x[1], x[2]


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
def _turn(axis, angle):
    """Return the axes of a frame turned about an axis, in that frame, by rows."""
    cosine, sine = math.cos(angle), math.sin(angle)
    u, v, w = axis
    x, y, z = _axpy(1.0 - cosine, axis, (0.0, 0.0, 0.0))
    return (
        (x * u + cosine, x * v + w * sine, x * w - v * sine),
        (y * u - w * sine, y * v + cosine, y * w + u * sine),
        (z * u + v * sine, z * v - u * sine, z * w + cosine),
    )


@_compiled
def _forces_and_moments(p, x, y, z, field, w, dw):
    """Return a body's forces by m, mc, and moments about the origin by all ten."""
    # Acceleration of the tip of an axis relative to its tail: M e_k with
    # M = [dw]x + w w' - |w|^2, by its columns.
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    m1 = w[0] * w[0] - square, w[0] * w[1] + dw[2], w[0] * w[2] - dw[1]
    m2 = w[0] * w[1] - dw[2], w[1] * w[1] - square, w[1] * w[2] + dw[0]
    m3 = w[0] * w[2] + dw[1], w[1] * w[2] - dw[0], w[2] * w[2] - square
    dx = _combine(x, m1, m2, m3)
    dy = _combine(y, m1, m2, m3)
    dz = _combine(z, m1, m2, m3)
    of_m = _cross(p, field)
    of_x = _axpy(1.0, _cross(p, dx), _cross(x, field))
    of_y = _axpy(1.0, _cross(p, dy), _cross(y, field))
    of_z = _axpy(1.0, _cross(p, dz), _cross(z, field))
    # A moment of inertia sums the squares of the other two coordinates, a product of
    # inertia is a mixed second moment times minus one.
    xx, yy, zz = _cross(x, dx), _cross(y, dy), _cross(z, dz)
    half = _combine((0.5, 0.5, 0.5), xx, yy, zz)
    of_xx = _axpy(-1.0, xx, half)
    of_yy = _axpy(-1.0, yy, half)
    of_zz = _axpy(-1.0, zz, half)
    of_xy = _axpy(1.0, _cross(dx, y), _cross(dy, x))
    of_xz = _axpy(1.0, _cross(dx, z), _cross(dz, x))
    of_yz = _axpy(1.0, _cross(dy, z), _cross(dz, y))
    moments = of_m, of_x, of_y, of_z, of_xx, of_xy, of_yy, of_xz, of_yz, of_zz
    return (field, dx, dy, dz), moments


@_compiled
def _project(screw, forces, moments, out):
    """Write the torques of a joint by the parameters of a body that it carries."""
    s1, s2, s3, s4, s5, s6 = screw[0], screw[1], screw[2], screw[3], screw[4], screw[5]
    r0 = s4 * moments[0][0] + s5 * moments[0][1] + s6 * moments[0][2]
    r1 = s4 * moments[1][0] + s5 * moments[1][1] + s6 * moments[1][2]
    r2 = s4 * moments[2][0] + s5 * moments[2][1] + s6 * moments[2][2]
    r3 = s4 * moments[3][0] + s5 * moments[3][1] + s6 * moments[3][2]
    r4 = s4 * moments[4][0] + s5 * moments[4][1] + s6 * moments[4][2]
    r5 = s4 * moments[5][0] + s5 * moments[5][1] + s6 * moments[5][2]
    r6 = s4 * moments[6][0] + s5 * moments[6][1] + s6 * moments[6][2]
    r7 = s4 * moments[7][0] + s5 * moments[7][1] + s6 * moments[7][2]
    r8 = s4 * moments[8][0] + s5 * moments[8][1] + s6 * moments[8][2]
    r9 = s4 * moments[9][0] + s5 * moments[9][1] + s6 * moments[9][2]
    r0 += s1 * forces[0][0] + s2 * forces[0][1] + s3 * forces[0][2]
    r1 += s1 * forces[1][0] + s2 * forces[1][1] + s3 * forces[1][2]
    r2 += s1 * forces[2][0] + s2 * forces[2][1] + s3 * forces[2][2]
    r3 += s1 * forces[3][0] + s2 * forces[3][1] + s3 * forces[3][2]
    # All is read before anything is written.
    out[0], out[1], out[2], out[3], out[4] = r0, r1, r2, r3, r4
    out[5], out[6], out[7], out[8], out[9] = r5, r6, r7, r8, r9


@_compiled
def fill(q, v, a, tree, out):
    """Fill in the regressor matrices (n, nv, nv, k >= 10) of samples.

    Positions, velocities and accelerations are of shape (n, nv), the robot a `Tree`.
    """
    n, nv = q.shape
    # By body: axes, origin and its acceleration, angular velocity and acceleration.
    axes = np.empty((nv, 3, 3))
    places, fields = np.empty((nv, 3)), np.empty((nv, 3))
    speeds, gains = np.empty((nv, 3)), np.empty((nv, 3))
    screws = np.empty((nv, 6))
    for sample in range(n):
        matrix = out[sample]
        matrix[:] = 0.0
        for j in range(nv):
            parent, turns, slides = tree.parents[j], tree.turns[j], tree.slides[j]
            offset = _vector(tree.offsets[j])
            if parent < 0:
                e1, e2, e3 = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
                p, w = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
                field, dw = _vector(tree.base[j]), _vector(tree.base_angular)
            else:
                e1 = _vector(axes[parent, 0])
                e2 = _vector(axes[parent, 1])
                e3 = _vector(axes[parent, 2])
                p, w = _vector(places[parent]), _vector(speeds[parent])
                field, dw = _vector(fields[parent]), _vector(gains[parent])
            # Axes of the joint at zero, about or along one direction of which it moves.
            x = _combine(_vector(tree.frames[j, 0]), e1, e2, e3)
            y = _combine(_vector(tree.frames[j, 1]), e1, e2, e3)
            z = _combine(_vector(tree.frames[j, 2]), e1, e2, e3)
            axis = _combine(_vector(tree.axes[j]), x, y, z)
            turned = _turn(_vector(tree.axes[j]), turns * q[sample, j])
            x, y, z = (
                _combine(turned[0], x, y, z),
                _combine(turned[1], x, y, z),
                _combine(turned[2], x, y, z),
            )
            offset = _combine(offset, e1, e2, e3)
            offset = _axpy(slides * q[sample, j], axis, offset)
            p = _axpy(1.0, p, offset)
            across = _cross(w, axis)
            field = _axpy(1.0, _cross(w, _cross(w, offset)), field)
            field = _axpy(1.0, _cross(dw, offset), field)
            field = _axpy(2.0 * slides * v[sample, j], across, field)
            field = _axpy(slides * a[sample, j], axis, field)
            w = _axpy(turns * v[sample, j], axis, w)
            dw = _axpy(turns * a[sample, j], axis, dw)
            dw = _axpy(turns * v[sample, j], across, dw)
            lever = _cross(p, axis)
            for c in range(3):
                axes[j, 0, c], axes[j, 1, c], axes[j, 2, c] = x[c], y[c], z[c]
                places[j, c], fields[j, c] = p[c], field[c]
                speeds[j, c], gains[j, c] = w[c], dw[c]
                screws[j, c] = turns * lever[c] + slides * axis[c]
                screws[j, 3 + c] = turns * axis[c]
            forces, moments = _forces_and_moments(p, x, y, z, field, w, dw)
            # The joint itself and all those above it.
            i = j
            while i >= 0:
                _project(screws[i], forces, moments, matrix[i, j])
                i = tree.parents[i]
        for entry in range(tree.zeros.shape[0]):
            i, j, k = tree.zeros[entry]
            matrix[i, j, k] = 0.0
