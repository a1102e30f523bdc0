"""Several samples in one machine vector, for loops that Numba compiles.

A `Lanes` value holds one number of each of `WIDTH` samples next to each other and is
added and multiplied in one instruction. The compiler makes such vectors from loops of
its own accord only where it can prove that no two arrays overlap, which it cannot here.
"""

import operator

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

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
