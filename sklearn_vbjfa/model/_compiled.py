"""The loop over samples of `sklearn_vbjfa.model._regressor`, compiled by Numba.

Numba is optional. Some samples go through together: a `Lanes` value holds one number of
each of `WIDTH` samples next to each other and is added and multiplied in one
instruction. The compiler makes such vectors from loops of its own accord only where it
can prove that no two arrays overlap, which it cannot here. Vectors in space are tuples,
of numbers or of lanes, of which it knows that they do not overlap.
"""

import math
import operator

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

# First rows of what is known of a body: its three axes, origin, the origin's
# acceleration, angular velocity and acceleration, and its joint's screw: three rows by
# which forces do work, then three for moments.
_AXES, _ORIGIN, _FIELD, _SPEED, _GAIN, _SCREW = 0, 9, 12, 15, 18, 21
_STATE = 27
# Numbers near it are whole.
_WHOLE = 1.5 * 2.0**52
# Half a turn in three parts, of which the first two have 24 digits each: products with
# a number of half turns are exact.
_PI_1, _PI_2 = 3.141592502593994, 1.5099578831723193e-07
_PI_3 = 1.0780605716316238e-14
# As many as a register of the processor holds; where it holds fewer than four the
# compiler takes several registers.
WIDTH = 8 if binding.get_host_cpu_features().get("avx512f") else 4
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_INDEX = ir.IntType(32)


class Lanes(types.Type):
    """Numba type of a vector of `WIDTH` doubles."""

    def __init__(self):
        super().__init__(name=f"Lanes({WIDTH})")


_lanes = Lanes()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


@intrinsic
def spread(typingctx, number):
    """Return a number in all lanes."""

    def generate(context, builder, signature, args):
        value = context.cast(builder, args[0], signature.args[0], types.float64)
        first = builder.insert_element(
            ir.Constant(_VECTOR, ir.Undefined), value, _INDEX(0)
        )
        mask = ir.Constant(ir.VectorType(_INDEX, WIDTH), WIDTH * [0])
        return builder.shuffle_vector(first, first, mask)

    return _lanes(number), generate


def _element(context, builder, kind, array, indices):
    """Return a pointer to an element of an array."""
    array = context.make_array(kind)(context, builder, array)
    indices = [context.cast(builder, i, types.int64, types.intp) for i in indices]
    return cgutils.get_item_pointer(
        context, builder, kind, array, indices, wraparound=False
    )


@intrinsic
def load(typingctx, array, row, column):
    """Return the lanes that begin at an element of an array with adjacent columns."""

    def generate(context, builder, signature, args):
        place = _element(context, builder, signature.args[0], args[0], args[1:])
        place = builder.bitcast(place, _VECTOR.as_pointer())
        return builder.load(place, align=8)

    return _lanes(array, types.intp, types.intp), generate


@intrinsic
def store(typingctx, array, row, column, lanes):
    """Write lanes to an array from an element on, along its columns."""

    def generate(context, builder, signature, args):
        kind, value = signature.args[0], args[3]
        place = _element(context, builder, kind, args[0], args[1:3])
        if kind.layout == "C":
            builder.store(value, builder.bitcast(place, _VECTOR.as_pointer()), align=8)
            return context.get_dummy_value()
        array = context.make_array(kind)(context, builder, args[0])
        stride = cgutils.unpack_tuple(builder, array.strides)[1]
        for k in range(WIDTH):
            number = builder.extract_element(value, _INDEX(k))
            offset = builder.mul(stride, ir.Constant(stride.type, k))
            at = cgutils.pointer_add(builder, place, offset, return_type=place.type)
            builder.store(number, at, align=8)
        return context.get_dummy_value()

    return types.none(array, types.intp, types.intp, lanes), generate


def _arithmetic(name):
    """Return an intrinsic that does one LLVM instruction on two vectors."""

    @intrinsic
    def operation(typingctx, x, y):
        def generate(context, builder, signature, args):
            return getattr(builder, name)(*args)

        return _lanes(_lanes, _lanes), generate

    return operation


def _register(symbol, operation):
    @overload(symbol, inline="never")
    def _of(x, y):
        if isinstance(x, Lanes) and isinstance(y, Lanes):
            return lambda x, y: operation(x, y)
        if isinstance(x, Lanes) and isinstance(y, types.Float):
            return lambda x, y: operation(x, spread(y))
        if isinstance(x, types.Float) and isinstance(y, Lanes):
            return lambda x, y: operation(spread(x), y)
        return None


_register(operator.add, _arithmetic("fadd"))
_register(operator.sub, _arithmetic("fsub"))
_register(operator.mul, _arithmetic("fmul"))


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


@compiled
def _read(array, row, column):
    """Return three rows of lanes as a vector."""
    return (
        load(array, row, column),
        load(array, row + 1, column),
        load(array, row + 2, column),
    )


@compiled
def _write(array, row, vector):
    """Write a vector of lanes to three rows."""
    store(array, row, 0, vector[0])
    store(array, row + 1, 0, vector[1])
    store(array, row + 2, 0, vector[2])


@compiled
def _nearest(x):
    """Return the nearest whole number: what is left where one has no more digits."""
    return (x + _WHOLE) - _WHOLE


@compiled
def _cosine_sine(angle):
    """Return cosine and sine of an angle, to 3e-16."""
    # Those of half the angle less half turns, by the polynomials of the Cephes
    # library on [-pi / 4, pi / 4], and then of twice that.
    turns = _nearest((1 / math.pi) * angle)
    rest = ((angle - _PI_1 * turns) - _PI_2 * turns) - _PI_3 * turns
    x = 0.5 * rest
    z = x * x
    p = 1.58962301576546568060e-10 * z - 2.50507477628578072866e-8
    p = (p * z + 2.75573136213857245213e-6) * z - 1.98412698295895385996e-4
    p = (p * z + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1
    sine = x + x * z * p
    p = -1.13585365213876817300e-11 * z + 2.08757008419747316778e-9
    p = (p * z - 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5
    p = (p * z - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2
    cosine = 1.0 - 0.5 * z + z * z * p
    # An odd number of half turns changes both signs.
    odd = turns - 2.0 * _nearest(0.5 * turns)
    sign = 1.0 - 2.0 * (odd * odd)
    return sign * (1.0 - 2.0 * (sine * sine)), sign * (2.0 * (sine * cosine))


@compiled
def _forces_and_moments(p, x, y, z, field, w, dw):
    """Return a body's forces by m, mc, and moments about the origin by all ten."""
    # Acceleration of the tip of an axis relative to its tail: M e_k with
    # M = [dw]x + w w' - |w|^2, by its columns.
    square = dot(w, w)
    m1 = w[0] * w[0] - square, w[0] * w[1] + dw[2], w[0] * w[2] - dw[1]
    m2 = w[0] * w[1] - dw[2], w[1] * w[1] - square, w[1] * w[2] + dw[0]
    m3 = w[0] * w[2] + dw[1], w[1] * w[2] - dw[0], w[2] * w[2] - square
    dx = combine(x, m1, m2, m3)
    dy = combine(y, m1, m2, m3)
    dz = combine(z, m1, m2, m3)
    of_m = cross(p, field)
    of_x = axpy(1.0, cross(p, dx), cross(x, field))
    of_y = axpy(1.0, cross(p, dy), cross(y, field))
    of_z = axpy(1.0, cross(p, dz), cross(z, field))
    # A moment of inertia sums the squares of the other two coordinates, a product of
    # inertia is a mixed second moment times minus one.
    xx, yy, zz = cross(x, dx), cross(y, dy), cross(z, dz)
    half = combine((0.5, 0.5, 0.5), xx, yy, zz)
    of_xx = axpy(-1.0, xx, half)
    of_yy = axpy(-1.0, yy, half)
    of_zz = axpy(-1.0, zz, half)
    of_xy = axpy(1.0, cross(dx, y), cross(dy, x))
    of_xz = axpy(1.0, cross(dx, z), cross(dz, x))
    of_yz = axpy(1.0, cross(dy, z), cross(dz, y))
    moments = of_m, of_x, of_y, of_z, of_xx, of_xy, of_yy, of_xz, of_yz, of_zz
    return (field, dx, dy, dz), moments


@compiled
def _project(state, screw, forces, moments, places, out, sample):
    """Write the torques of a joint by the parameters of a body that it carries."""
    f, m = _read(state, screw, 0), _read(state, screw + 3, 0)
    for k in range(10):
        place = places[k]
        if place >= 0:
            torque = dot(m, moments[k])
            if k < 4:
                torque = torque + dot(f, forces[k])
            store(out, place, sample, torque)


def fill(q, v, a, tree, places, out):
    """Fill in entries of the regressor matrices of n samples, q, v, a (n, nv)."""
    # places (nv, nv, 10): row of `out` (n_entries, n) for each torque, body and
    # parameter, -1 for none. Rows without an entry are left alone; C-contiguous is
    # fastest.
    n = q.shape[0]
    if n == 0:
        return
    if n < WIDTH:
        # Too few to fill the lanes: some samples go in more than once.
        again = np.arange(WIDTH) % n
        full = np.empty((out.shape[0], WIDTH))
        fill(q[again], v[again], a[again], tree, places, full)
        written = places[places >= 0]
        out[written] = full[written, :n]
        return
    q, v, a = (np.ascontiguousarray(x.T) for x in (q, v, a))
    _fill(q, v, a, tree, places, out)


@compiled
def _fill(q, v, a, tree, places, out):
    """Do so from arrays (nv, n), with n at least `WIDTH`."""
    nv, n = q.shape
    # One row of `_STATE` for the base, in front of those of the bodies.
    state = np.zeros(((nv + 1) * _STATE, WIDTH))
    for k in range(3):
        store(state, _AXES + 4 * k, 0, spread(1.0))
        store(state, _GAIN + k, 0, spread(tree.base_angular[k]))
    for first in range(0, n, WIDTH):
        # The last lanes may be ones that were done before.
        sample = min(first, n - WIDTH)
        for j in range(nv):
            turns, slides = tree.turns[j], tree.slides[j]
            above, own = (tree.parents[j] + 1) * _STATE, (j + 1) * _STATE
            e1 = _read(state, above + _AXES, 0)
            e2 = _read(state, above + _AXES + 3, 0)
            e3 = _read(state, above + _AXES + 6, 0)
            w, dw = _read(state, above + _SPEED, 0), _read(state, above + _GAIN, 0)
            position = load(q, j, sample)
            velocity, acceleration = load(v, j, sample), load(a, j, sample)
            # Axes of the joint at zero, about or along one direction of which it moves.
            x = combine(vector(tree.frames[j, 0]), e1, e2, e3)
            y = combine(vector(tree.frames[j, 1]), e1, e2, e3)
            z = combine(vector(tree.frames[j, 2]), e1, e2, e3)
            direction = vector(tree.axes[j])
            axis = combine(direction, x, y, z)
            turned = turn(direction, *_cosine_sine(turns * position))
            x, y, z = (
                combine(turned[0], x, y, z),
                combine(turned[1], x, y, z),
                combine(turned[2], x, y, z),
            )
            offset = combine(vector(tree.offsets[j]), e1, e2, e3)
            offset = axpy(slides * position, axis, offset)
            p = axpy(1.0, _read(state, above + _ORIGIN, 0), offset)
            across = cross(w, axis)
            field = axpy(1.0, _read(state, above + _FIELD, 0), vector(tree.base[j]))
            field = axpy(1.0, cross(w, cross(w, offset)), field)
            field = axpy(1.0, cross(dw, offset), field)
            field = axpy(2.0 * slides * velocity, across, field)
            field = axpy(slides * acceleration, axis, field)
            w = axpy(turns * velocity, axis, w)
            dw = axpy(turns * acceleration, axis, dw)
            dw = axpy(turns * velocity, across, dw)
            _write(state, own + _AXES, x)
            _write(state, own + _AXES + 3, y)
            _write(state, own + _AXES + 6, z)
            _write(state, own + _ORIGIN, p)
            _write(state, own + _FIELD, field)
            _write(state, own + _SPEED, w)
            _write(state, own + _GAIN, dw)
            none = spread(0.0), spread(0.0), spread(0.0)
            force = axpy(slides, axis, none)
            _write(state, own + _SCREW, axpy(turns, cross(p, axis), force))
            _write(state, own + _SCREW + 3, axpy(turns, axis, none))
            forces, moments = _forces_and_moments(p, x, y, z, field, w, dw)
            # The joint itself and all those above it.
            i = j
            while i >= 0:
                screw = (i + 1) * _STATE + _SCREW
                _project(state, screw, forces, moments, places[i, j], out, sample)
                i = tree.parents[i]
