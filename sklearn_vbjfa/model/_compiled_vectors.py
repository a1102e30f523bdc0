"""Vectors in space for loops that Numba compiles: tuples, of numbers or of lanes.

The compiler knows, unlike of arrays, that tuples do not overlap.
"""

import numba

# The machine code is kept on disk: only the first use after an installation takes the
# seconds of the compilation. Fused multiplications and additions round once instead of
# twice.
compiled = numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"contract"}
)


@compiled
def vector(x):
    """Return three numbers as a tuple."""
    return x[0], x[1], x[2]


@compiled
def cross(x, y):
    """Cross product of two vectors."""
    return (
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    )


@compiled
def dot(x, y):
    """Scalar product of two vectors."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@compiled
def axpy(a, x, y):
    """Return a x + y."""
    return a * x[0] + y[0], a * x[1] + y[1], a * x[2] + y[2]


@compiled
def combine(a, x, y, z):
    """Return a_1 x + a_2 y + a_3 z."""
    return (
        a[0] * x[0] + a[1] * y[0] + a[2] * z[0],
        a[0] * x[1] + a[1] * y[1] + a[2] * z[1],
        a[0] * x[2] + a[1] * y[2] + a[2] * z[2],
    )


@compiled
def turn(axis, cosine, sine):
    """Return the axes of a frame turned about an axis, in that frame, by rows."""
    u, v, w = axis
    rest = 1.0 - cosine
    x, y, z = rest * u, rest * v, rest * w
    return (
        (x * u + cosine, x * v + w * sine, x * w - v * sine),
        (y * u - w * sine, y * v + cosine, y * w + u * sine),
        (z * u + v * sine, z * v - u * sine, z * w + cosine),
    )
