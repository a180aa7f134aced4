"""Vector type of compiled code: the numbers of eight runs as one value.

:func:`load` and :func:`store` read and write one vector of an array (..., LANES) of double
precision numbers, whose last axis is the run. Vectors are added, subtracted, multiplied, divided
and negated lane by lane, and ``math.sqrt`` and ``math.floor`` accept vectors. Therefore the same
formula can be compiled for a number or for the numbers of eight runs. Vectors exist only in
compiled code and cannot be returned to Python.

A product and a sum of vectors in one expression are fused, that is rounded once. The source of each
function determines the fused operations, before the compiler inlines. Therefore the bits of a
result depend on the source alone. On processors without a fused instruction the C library computes
the same bits, but slowly.
"""

from __future__ import annotations

import math
import operator
from functools import partial
from itertools import product
from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

from .kernels import LANES

intrinsic: Any = extending.intrinsic  # untyped: only compiled code calls the results
_DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
_ALIGNMENT = 8


class _Vector(types.Type):
    """Numba type of a vector."""

    def __init__(self) -> None:
        super().__init__(name="Vector")


_vector = _Vector()


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    """Numba data model of a vector: an LLVM vector of doubles."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _DOUBLES)


def _spread(builder: Any, number: Any) -> Any:
    """Return the vector that holds a number in all lanes."""
    undefined = ir.Constant(_DOUBLES, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, mask)


def _arithmetic(name: str, builder: Any, left: Any, right: Any) -> Any:
    """Generate an arithmetic instruction; a sum with a product becomes ``llvm.fma``."""
    if name in ("fadd", "fsub"):
        if getattr(right, "opname", "") == "fmul":
            one, two = right.operands
            one = one if name == "fadd" else builder.fneg(one)
            return _call(builder, "fma", [one, two, left])
        if getattr(left, "opname", "") == "fmul":
            right = right if name == "fadd" else builder.fneg(right)
            return _call(builder, "fma", [*left.operands, right])
    return getattr(builder, name)(left, right)


def _define(function: Any, count: int, code: Any) -> None:
    """Define a compiled function of ``count`` vectors, one of which may be a number.

    ``code`` generates the instructions of the function, from a builder and the vectors.
    """

    class Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            vectors = [arg for arg in args if isinstance(arg, _Vector)]
            others = [arg for arg in args if not isinstance(arg, _Vector)]
            fits = len(args) == count and vectors and others in ([], [types.float64])
            return signature(_vector, *args) if fits else None

    infer_global(function)(Typing)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vectors = (
            arg if isinstance(kind, _Vector) else _spread(builder, arg)
            for kind, arg in zip(sig.args, args, strict=True)
        )
        return code(builder, *vectors)

    for kinds in product((_Vector, types.float64), repeat=count):
        if _Vector in kinds:
            lower_builtin(function, *kinds)(lower)


for _operation, _inplace, _instruction in (
    (operator.add, operator.iadd, "fadd"),
    (operator.sub, operator.isub, "fsub"),
    (operator.mul, operator.imul, "fmul"),
    (operator.truediv, operator.itruediv, "fdiv"),
):
    _define(_operation, 2, partial(_arithmetic, _instruction))
    _define(_inplace, 2, partial(_arithmetic, _instruction))
_define(operator.neg, 1, lambda builder, vector: builder.fneg(vector))
_define(math.sqrt, 1, lambda builder, vector: _call(builder, "sqrt", [vector]))
_define(math.floor, 1, lambda builder, vector: _call(builder, "floor", [vector]))


def _address(context: Any, builder: Any, kind: Any, value: Any, places: Any) -> Any:
    """Return the address of a vector in an array.

    ``places`` is (i, j), or the index of the vector's first number in memory order.
    """
    array = context.make_array(kind)(context, builder, value)
    offset = places[-1]
    if len(places) == 2:
        _, columns, _ = cgutils.unpack_tuple(builder, array.shape, 3)
        offset = builder.add(builder.mul(places[0], columns), offset)
        offset = builder.mul(offset, ir.Constant(offset.type, LANES))
    start = builder.gep(array.data, [offset], inbounds=True)
    return builder.bitcast(start, _DOUBLES.as_pointer())


def _call(builder: Any, name: str, args: Any) -> Any:
    """Return the result of an LLVM intrinsic function of vectors."""
    kind = ir.FunctionType(_DOUBLES, [_DOUBLES] * len(args))
    full = f"llvm.{name}.v{LANES}f64"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, full), args)


def _loading(array: Any, places: int) -> Any:
    """Return the signature and the code generator for loading a vector from an array.

    ``places`` is 2 for indices (i, j), and 1 for an index in memory order.
    """

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        where = _address(context, builder, sig.args[0], args[0], args[1:])
        return builder.load(where, align=_ALIGNMENT)

    return _vector(array, *(types.intp,) * places), code


def _storing(array: Any, places: int, value: Any) -> Any:
    """Return the signature and the code generator for storing a vector in an array.

    A number is stored in all lanes. ``places`` is as in :func:`_loading`.
    """

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        where = _address(context, builder, sig.args[0], args[0], args[1:-1])
        vector = args[-1] if isinstance(value, _Vector) else _spread(builder, args[-1])
        builder.store(vector, where, align=_ALIGNMENT)
        return context.get_dummy_value()

    return types.void(array, *(types.intp,) * places, value), code


def _is_contiguous(array: Any) -> bool:
    return isinstance(array, types.Array) and array.layout == "C"


@intrinsic
def load(typing: Any, array: Any, i: Any, j: Any) -> Any:
    """Return the vector ``array[i, j]`` of a contiguous array (rows, columns, LANES).

    Indices must not be negative.
    """
    return _loading(array, 2) if _is_contiguous(array) and array.ndim == 3 else None


@intrinsic
def store(typing: Any, array: Any, i: Any, j: Any, value: Any) -> Any:
    """Set ``array[i, j]`` to a vector or a number.

    The array is contiguous and has the shape (rows, columns, LANES).

    Indices must not be negative.
    """
    if not (isinstance(value, _Vector) or value == types.float64):
        return None
    return _storing(array, 2, value) if _is_contiguous(array) and array.ndim == 3 else None


@intrinsic
def splat(typing: Any, number: Any) -> Any:
    """Return a vector with the same number in all lanes."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, args[0])

    return _vector(types.float64), code


@intrinsic
def like(typing: Any, kind: Any, number: Any) -> Any:
    """Return ``number``; if ``kind`` is a vector, return a vector with ``number`` in all lanes."""
    if not (isinstance(kind, _Vector) or kind == types.float64):
        return None

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, args[1]) if isinstance(kind, _Vector) else args[1]

    return kind(kind, types.float64), code


@intrinsic
def with_sign(typing: Any, size: Any, sign: Any) -> Any:
    """Return a vector with the magnitudes of ``size`` and the signs of ``sign``."""
    if not isinstance(size, _Vector) or not isinstance(sign, _Vector):
        return None

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, "copysign", args)

    return _vector(size, sign), code


@intrinsic
def load_from(typing: Any, array: Any, start: Any) -> Any:
    """Return LANES consecutive numbers of a contiguous array as a vector.

    ``start`` is the index of the first number in memory order.
    """
    return _loading(array, 1) if _is_contiguous(array) else None


@intrinsic
def store_from(typing: Any, array: Any, start: Any, value: Any) -> Any:
    """Set LANES consecutive numbers of a contiguous array to a vector.

    ``start`` is the index of the first number in memory order.
    """
    return _storing(array, 1, value) if _is_contiguous(array) else None


@intrinsic
def transposed(typing: Any, rows: Any) -> Any:
    """Return the transpose of a square matrix. Argument and result are tuples of row vectors."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        rows = cgutils.unpack_tuple(builder, args[0], LANES)
        half = LANES // 2
        while half:  # blocks off the diagonal change places, the largest ones first
            for i in range(LANES):
                if i & half:
                    continue
                one, two = rows[i], rows[i + half]
                upper = [c if not c & half else LANES + c - half for c in range(LANES)]
                lower = [c + half if not c & half else LANES + c for c in range(LANES)]
                rows[i], rows[i + half] = (
                    builder.shuffle_vector(
                        one, two, ir.Constant(ir.VectorType(ir.IntType(32), LANES), mask)
                    )
                    for mask in (upper, lower)
                )
            half //= 2
        return context.make_tuple(builder, sig.return_type, rows)

    kind = types.UniTuple(_vector, LANES)
    return kind(kind), code
