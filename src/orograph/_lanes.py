"""Numbers side by side inside kernels: an operation on them acts on all of them, with vector instructions.

LLVM vectorises a loop only if it can prove that no load meets a store, which it cannot for scattered lookups. So
kernels say it: ``Lanes`` holds eight float64 (or int64, or booleans) or sixteen int32 (``_lanes32``) and has Python's
operators; a scalar operand stands for as many equal numbers. Each lane has the same bits as scalar code, on every
processor: vectors wider than the processor's are split.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from orograph._numba import Function, inlined

LANES, LANES32 = 8, 16


class Lanes(types.Type):
    """Numba's type of eight floats, integers or booleans, or sixteen of 32 bits or booleans."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        super().__init__(name=f"Lanes({kind})")


FLOATS, INTS, MARKS = Lanes("float"), Lanes("int"), Lanes("mark")
INTS32, MARKS32 = Lanes("int32"), Lanes("mark32")

VECTORS = {
    "float": ir.VectorType(ir.DoubleType(), LANES),
    "int": ir.VectorType(ir.IntType(64), LANES),
    "mark": ir.VectorType(ir.IntType(1), LANES),
    "int32": ir.VectorType(ir.IntType(32), LANES32),
    "mark32": ir.VectorType(ir.IntType(1), LANES32),
}
SCALARS = {
    "float": types.float64,
    "int": types.int64,
    "mark": types.boolean,
    "int32": types.int32,
    "mark32": types.boolean,
}


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """Stored as an LLVM vector."""

    def __init__(self, manager: Any, kind: Lanes) -> None:
        super().__init__(manager, kind, VECTORS[kind.kind])


def _spread(builder: Any, value: Any, count: int = LANES) -> Any:
    """So many times the same number."""
    one = builder.insert_element(ir.Constant(ir.VectorType(value.type, count), ir.Undefined), value, _at(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count))


def _at(lane: int) -> Any:
    return ir.Constant(ir.IntType(32), lane)


def _joined(context: Any, builder: Any, kind: Lanes, value: Any, of: Any) -> Any:
    """A value as lanes of a kind."""
    if isinstance(of, Lanes):
        return value
    return _spread(builder, context.cast(builder, value, of, SCALARS[kind.kind]), VECTORS[kind.kind].count)


def marks_of(kind: Lanes) -> Lanes:
    """The kind of what a comparison of two of a kind gives."""
    return MARKS32 if kind is INTS32 else MARKS


def _operator(function: Any, kinds: dict[Lanes, Callable[[Any, Any, Any], Any]], compares: bool = False) -> None:
    """Give lanes one of Python's operators. ``kinds``: how each kind computes it; ``compares``: it gives marks."""

    @infer_global(function)
    class Operator(AbstractTemplate):
        def generic(self, args: tuple[Any, ...], kws: object) -> Any:
            found = {a for a in args if isinstance(a, Lanes)}
            if len(args) != 2 or len(found) != 1 or not found <= kinds.keys():
                return None
            kind = found.pop()
            return signature(marks_of(kind) if compares else kind, *args)

    def lowered(context: Any, builder: Any, sig: Any, args: tuple[Any, Any]) -> Any:
        kind = next(a for a in sig.args if isinstance(a, Lanes))
        a, b = (_joined(context, builder, kind, v, of) for v, of in zip(args, sig.args))
        return kinds[kind](builder, a, b)

    for pair in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        lower_builtin(function, *pair)(lowered)


def _of(name: str, *kinds: Lanes) -> dict[Lanes, Callable[[Any, Any, Any], Any]]:
    """An instruction of LLVM for several kinds."""
    return dict.fromkeys(kinds, lambda b, x, y: getattr(b, name)(x, y))


for _add in (operator.add, operator.iadd):
    _operator(_add, _of("fadd", FLOATS) | _of("add", INTS, INTS32))
_operator(operator.sub, _of("fsub", FLOATS) | _of("sub", INTS, INTS32))
_operator(operator.mul, _of("fmul", FLOATS) | _of("mul", INTS, INTS32))
_operator(operator.truediv, _of("fdiv", FLOATS))
_operator(operator.and_, _of("and_", INTS, MARKS, INTS32, MARKS32))
_operator(operator.or_, _of("or_", MARKS, INTS32, MARKS32))
_operator(operator.xor, _of("xor", MARKS, INTS32, MARKS32))
_operator(operator.rshift, _of("ashr", INTS, INTS32))
_operator(operator.lshift, _of("shl", INTS32))


def _comparison(function: Any, sign: str) -> None:
    """Give lanes one of Python's comparisons; comparisons with NaN are false."""
    kinds: dict[Lanes, Callable[[Any, Any, Any], Any]] = {
        FLOATS: lambda b, x, y: b.fcmp_ordered(sign, x, y),
        INTS: lambda b, x, y: b.icmp_signed(sign, x, y),
        INTS32: lambda b, x, y: b.icmp_signed(sign, x, y),
    }
    _operator(function, kinds, compares=True)


_comparison(operator.lt, "<")
_comparison(operator.le, "<=")
_comparison(operator.gt, ">")
_comparison(operator.ge, ">=")
_comparison(operator.eq, "==")


@infer_global(operator.invert)
class _Invert(AbstractTemplate):
    def generic(self, args: tuple[Any, ...], kws: object) -> Any:
        return signature(*args, *args) if args in ((MARKS,), (MARKS32,)) else None


@lower_builtin(operator.invert, Lanes)
def _inverted(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.not_(args[0])


def operation(function: Function) -> Function:
    """A function that kernels call, made from its Numba typing function."""
    return cast(Function, intrinsic(function))


@operation
def spread(typing: Any, value: Any) -> Any:
    """The same number (or truth) in all lanes."""
    value = types.unliteral(value)
    kind = MARKS if value is types.boolean else INTS if isinstance(value, types.Integer) else FLOATS

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        number = context.cast(builder, args[0], value, SCALARS[kind.kind])
        return _spread(
            builder, builder.trunc(number, ir.IntType(1)) if kind is MARKS and number.type.width > 1 else number
        )

    return kind(value), lowered


@operation
def counted(typing: Any) -> Any:
    """0, 1, … 7 as floats."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return ir.Constant(ir.VectorType(ir.DoubleType(), LANES), [float(k) for k in range(LANES)])

    return FLOATS(), lowered


@operation
def where(typing: Any, marks: Any, yes: Any, no: Any) -> Any:
    """Lane by lane, ``yes`` where ``mask`` is true, else ``no``; both may be lanes or numbers."""
    numbers = INTS if isinstance(yes, types.Integer) and isinstance(no, types.Integer) else FLOATS
    numbers = INTS32 if marks == MARKS32 else numbers
    kind = next((k for k in (yes, no) if isinstance(k, Lanes)), numbers)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(args[0], *(_joined(context, builder, kind, v, of) for v, of in zip(args[1:], (yes, no))))

    return kind(marks, yes, no), lowered


@operation
def some(typing: Any, marks: Any) -> Any:
    """Whether any lane is marked."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(args[0].type.count))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(marks), lowered


@operation
def first_of(typing: Any, marks: Any) -> Any:
    """The first marked lane; undefined if there is none."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(args[0].type.count))
        return builder.zext(builder.cttz(bits, ir.Constant(ir.IntType(1), 1)), ir.IntType(64))

    return types.int64(marks), lowered


@operation
def one_of(typing: Any, values: Any, index: Any) -> Any:
    """The number of one lane."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(args[0], context.cast(builder, args[1], sig.args[1], types.int32))

    return SCALARS[values.kind](values, types.unliteral(index)), lowered


def _halved(builder: Any, values: Any, join: Callable[[Any, Any], Any]) -> Any:
    """One number of all lanes, joined pair by pair: each with the one half of the lanes further on."""
    while (half := values.type.count // 2) > 0:
        values = join(*(_picked(builder, values, values, range(k, k + half)) for k in (0, half)))
    return builder.extract_element(values, _at(0))


@operation
def largest_of(typing: Any, values: Any) -> Any:
    """The largest of eight floats that are numbers."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _halved(builder, args[0], lambda a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b))

    return types.float64(values), lowered


@operation
def sum_of(typing: Any, values: Any) -> Any:
    """The sum of eight floats, each first added to the fourth after it, and so on by halves."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _halved(builder, args[0], builder.fadd)

    return types.float64(values), lowered


@operation
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a · b + c of floats, rounded once."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = VECTORS["float"]
        kind = ir.FunctionType(vector, (vector,) * 3)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.fma.v8f64"), args)

    return FLOATS(a, b, c), lowered


@operation
def whole(typing: Any, values: Any) -> Any:
    """Floats as integers, rounded towards zero."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.fptosi(args[0], ir.VectorType(ir.IntType(64), LANES))

    return INTS(values), lowered


@operation
def real(typing: Any, values: Any) -> Any:
    """Integers as floats."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.sitofp(args[0], ir.VectorType(ir.DoubleType(), LANES))

    return FLOATS(values), lowered


@operation
def gather(typing: Any, array: Any, index: Any) -> Any:
    """Elements of a flat array of float32 or float64, as floats."""
    single = array.dtype == types.float32

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        found = ir.Constant(ir.VectorType(data.type.pointee, LANES), ir.Undefined)
        for k in range(LANES):
            place = builder.gep(data, [builder.extract_element(args[1], _at(k))])
            found = builder.insert_element(found, builder.load(place, align=4 if single else 8), _at(k))
        return builder.fpext(found, ir.VectorType(ir.DoubleType(), LANES)) if single else found

    return FLOATS(array, index), lowered


@operation
def scatter(typing: Any, array: Any, index: Any, values: Any) -> Any:
    """Write numbers into elements of a flat array of their kind; of several for one element, the last stays."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        for k in range(LANES):
            place = builder.gep(data, [builder.extract_element(args[1], _at(k))])
            builder.store(builder.extract_element(args[2], _at(k)), place, align=8)
        return context.get_dummy_value()

    return types.void(array, index, values), lowered


@operation
def corners(typing: Any, array: Any, index: Any, stride: Any) -> Any:
    """Elements i, i + 1, i + stride and i + stride + 1 of a flat float32 array, as floats."""
    result = types.UniTuple(FLOATS, 4)
    twins = ir.VectorType(ir.FloatType(), 2)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        places = [builder.gep(data, [builder.extract_element(args[1], _at(k))]) for k in range(LANES)]
        found = []
        for below in (False, True):
            parts = []
            for place in places:
                here = builder.gep(place, [args[2]]) if below else place
                parts.append(builder.load(builder.bitcast(here, twins.as_pointer()), align=4))
            while len(parts) > 1:
                parts = [_picked(builder, a, b, range(2 * a.type.count)) for a, b in zip(parts[::2], parts[1::2])]
            for first in (0, 1):
                half = _picked(builder, parts[0], parts[0], range(first, 2 * LANES, 2))
                found.append(builder.fpext(half, ir.VectorType(ir.DoubleType(), LANES)))
        return context.make_tuple(builder, result, found)

    return result(array, index, types.int64), lowered


def _picked(builder: Any, a: Any, b: Any, order: range) -> Any:
    """Pick elements of two vectors in a given order."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), list(order)))


@operation
def load(typing: Any, array: Any, index: Any) -> Any:
    """Eight elements of an array of float32, float64 or int64 from ``index`` on, counted as if it were flat."""
    single = array.dtype == types.float32

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        found = builder.load(_place(context, builder, array, args, sig), align=4 if single else 8)
        return builder.fpext(found, VECTORS["float"]) if single else found

    return (INTS if array.dtype == types.int64 else FLOATS)(array, index), lowered


@operation
def store(typing: Any, array: Any, index: Any, values: Any) -> Any:
    """Write eight numbers into a flat array of their kind from ``index`` on."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _place(context, builder, array, args, sig), align=8)
        return context.get_dummy_value()

    return types.void(array, index, values), lowered


def _place(context: Any, builder: Any, array: Any, args: Any, sig: Any) -> Any:
    """The address of eight numbers in an array."""
    data = context.make_array(array)(context, builder, args[0]).data
    index = context.cast(builder, args[1], sig.args[1], types.int64)
    place = builder.gep(data, [index])
    return builder.bitcast(place, ir.VectorType(place.type.pointee, LANES).as_pointer())


@inlined
def least(a: Any, b: Any) -> Any:
    """The smaller of two, lane by lane."""
    return where(b < a, b, a)


@inlined
def most(a: Any, b: Any) -> Any:
    """The larger of two, lane by lane."""
    return where(b > a, b, a)


@inlined
def size(a: Any) -> Any:
    """Without their signs."""
    return where(a < 0.0, 0.0 - a, a)
