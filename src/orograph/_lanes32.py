"""Sixteen int32 side by side inside kernels (``_lanes``): what only they need. Arithmetic wraps."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from orograph._lanes import INTS32, LANES32, MARKS32, SCALARS, VECTORS, _at, _joined, _spread, operation

_WORDS, _MARKS = VECTORS["int32"], VECTORS["mark32"]


@operation
def spread32(typing: Any, value: Any) -> Any:
    """The same integer in all lanes."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, context.cast(builder, args[0], sig.args[0], SCALARS["int32"]), LANES32)

    return INTS32(types.unliteral(value)), lowered


def _address(context: Any, builder: Any, array: Any, index: Any, sig: Any) -> Any:
    data = context.make_array(sig.args[0])(context, builder, array).data
    return builder.gep(data, [context.cast(builder, index, sig.args[1], types.int64)])


@operation
def load32(typing: Any, array: Any, index: Any) -> Any:
    """Sixteen elements of a flat int32 array from ``index`` on."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _address(context, builder, args[0], args[1], sig)
        return builder.load(builder.bitcast(place, _WORDS.as_pointer()), align=4)

    return INTS32(array, index), lowered


@operation
def store32(typing: Any, array: Any, index: Any, values: Any) -> Any:
    """Write sixteen numbers into a flat int32 array from ``index`` on."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _address(context, builder, args[0], args[1], sig)
        builder.store(args[2], builder.bitcast(place, _WORDS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, index, values), lowered


@operation
def gather32(typing: Any, array: Any, index: Any) -> Any:
    """Elements of a flat array of integers of at most 32 bits; indices are not negative."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        element = data.type.pointee
        found = ir.Constant(ir.VectorType(element, LANES32), ir.Undefined)
        for k in range(LANES32):
            at = builder.zext(builder.extract_element(args[1], _at(k)), ir.IntType(64))
            one = builder.load(builder.gep(data, [at]), align=element.width // 8)
            found = builder.insert_element(found, one, _at(k))
        if element.width == 32:
            return found
        return (builder.sext if array.dtype.signed else builder.zext)(found, _WORDS)

    return INTS32(array, index), lowered


@operation
def picked32(typing: Any, array: Any, index: Any, order: Any) -> Any:
    """Elements of a flat array of int32 or uint16: of the sixteen from ``index`` on, for each lane the one that
    ``order`` names (0 to 15). Processors with AVX-512 or AVX2 do this without one load for each."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _address(context, builder, args[0], args[1], sig)
        width = place.type.pointee.width
        vector = ir.VectorType(ir.IntType(width), LANES32)
        some = builder.load(builder.bitcast(place, vector.as_pointer()), align=width // 8)
        some = some if width == 32 else builder.zext(some, _WORDS)
        features = context.codegen()._tm_features.split(",")
        if "+avx512f" in features:
            return _permuted(builder, "llvm.x86.avx512.permvar.si.512", some, args[2])
        if "+avx2" in features:
            return _permuted_in_halves(builder, some, args[2])
        found = ir.Constant(_WORDS, ir.Undefined)
        for k in range(LANES32):
            found = builder.insert_element(found, builder.extract_element(some, _lane(builder, args[2], k)), _at(k))
        return found

    return INTS32(array, index, order), lowered


def _lane(builder: Any, values: Any, k: int) -> Any:
    return builder.extract_element(values, _at(k))


def _permuted(builder: Any, instruction: str, some: Any, order: Any) -> Any:
    """Of some numbers, for each lane the one that ``order`` names, by an instruction of the processor."""
    kind = ir.FunctionType(some.type, [some.type, order.type])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, instruction), [some, order])


def _permuted_in_halves(builder: Any, some: Any, order: Any) -> Any:
    """As ``_permuted``, by an instruction that looks at the lowest three bits of eight numbers."""
    half = LANES32 // 2
    lanes = [ir.Constant(ir.VectorType(ir.IntType(32), half), list(range(k, k + half))) for k in (0, half)]
    low, high = (builder.shuffle_vector(some, some, part) for part in lanes)
    found = []
    for part in lanes:
        own = builder.shuffle_vector(order, order, part)
        both = [_permuted(builder, "llvm.x86.avx2.permd", one, own) for one in (low, high)]
        limit = _spread(builder, ir.Constant(ir.IntType(32), half), half)
        found.append(builder.select(builder.icmp_unsigned("<", own, limit), *both))
    return builder.shuffle_vector(*found, ir.Constant(_WORDS, list(range(LANES32))))


@operation
def shifted_in(typing: Any, first: Any, values: Any) -> Any:
    """A number for the first lane, and for each other one the number of the lane before."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        order = ir.Constant(_WORDS, [0, *range(LANES32 - 1)])
        moved = builder.shuffle_vector(args[1], args[1], order)
        return builder.insert_element(moved, context.cast(builder, args[0], sig.args[0], types.int32), _at(0))

    return INTS32(types.unliteral(first), values), lowered


@operation
def lane(typing: Any, values: Any, index: Any) -> Any:
    """The number of one lane."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(args[0], context.cast(builder, args[1], sig.args[1], types.int32))

    return types.int32(values, types.unliteral(index)), lowered


@operation
def shifted_right(typing: Any, values: Any, bits: Any) -> Any:
    """Lanes as unsigned numbers, shifted to the right by so many bits (below 32)."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.lshr(args[0], _joined(context, builder, INTS32, args[1], sig.args[1]))

    return INTS32(values, types.unliteral(bits)), lowered


@operation
def marked(typing: Any, bits: Any) -> Any:
    """The lanes that the bits of an integer name, the lowest first."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(context.cast(builder, args[0], sig.args[0], types.uint16), _MARKS)

    return MARKS32(types.unliteral(bits)), lowered


@operation
def count_of(typing: Any, marks: Any) -> Any:
    """How many lanes are marked."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(LANES32))
        return builder.zext(builder.ctpop(bits), ir.IntType(64))

    return types.int64(marks), lowered


@operation
def marked_before(typing: Any, marks: Any) -> Any:
    """How many lanes before each are marked."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.zext(builder.bitcast(args[0], ir.IntType(LANES32)), ir.IntType(32))
        before = ir.Constant(_WORDS, [(1 << k) - 1 for k in range(LANES32)])
        count = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_WORDS, [_WORDS]), f"llvm.ctpop.v{LANES32}i32"
        )
        return builder.call(count, [builder.and_(_spread(builder, bits, LANES32), before)])

    return INTS32(marks), lowered


@operation
def float_bits(typing: Any, values: Any) -> Any:
    """The bits of each as a float32 number."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(builder.sitofp(args[0], ir.VectorType(ir.FloatType(), LANES32)), _WORDS)

    return INTS32(values), lowered


@operation
def least_unsigned(typing: Any, values: Any, most: Any) -> Any:
    """The smaller of two as unsigned numbers, lane by lane."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        limit = _joined(context, builder, INTS32, args[1], sig.args[1])
        return builder.select(builder.icmp_unsigned("<", args[0], limit), args[0], limit)

    return INTS32(values, types.unliteral(most)), lowered


@operation
def lengths32(typing: Any, values: Any) -> Any:
    """The number of binary digits of each as an unsigned number."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.FunctionType(_WORDS, [_WORDS, ir.IntType(1)])
        count = cgutils.get_or_insert_function(builder.module, kind, f"llvm.ctlz.v{LANES32}i32")
        zeros = builder.call(count, [args[0], ir.Constant(ir.IntType(1), 0)])
        return builder.sub(_spread(builder, ir.Constant(ir.IntType(32), 32), LANES32), zeros)

    return INTS32(values), lowered


@operation
def quotients32(typing: Any, values: Any, divisors: Any) -> Any:
    """Lanes as unsigned numbers, divided by others below 2^16; quotients are below 2^20. Floats give them with an error
    below one, and remainders correct it."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        floats = ir.VectorType(ir.FloatType(), LANES32)
        one = _spread(builder, ir.Constant(ir.FloatType(), 1.0), LANES32)
        inverse = builder.fdiv(one, builder.uitofp(args[1], floats))
        found = builder.fptosi(builder.fmul(builder.uitofp(args[0], floats), inverse), _WORDS)
        rest = builder.sub(args[0], builder.mul(found, args[1]))
        more = builder.zext(builder.icmp_signed(">=", rest, args[1]), _WORDS)
        return builder.add(builder.add(found, more), builder.ashr(rest, _spread(builder, _at(31), LANES32)))

    return INTS32(values, divisors), lowered


@operation
def store_before(typing: Any, array: Any, index: Any, values: Any, marks: Any) -> Any:
    """Write the lowest 16 bits of marked lanes into a flat uint16 array, in their order, the last one before ``index``.
    Sixteen elements before ``index`` may change."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        half, features = ir.IntType(16), context.codegen()._tm_features.split(",")
        if "+avx512f" in features:
            kind = ir.FunctionType(_WORDS, [_WORDS, _WORDS, _MARKS])
            name = f"llvm.x86.avx512.mask.compress.v{LANES32}i32"
            compress = cgutils.get_or_insert_function(builder.module, kind, name)
            packed = builder.call(compress, [args[2], args[2], args[3]])
            count = builder.zext(builder.ctpop(builder.bitcast(args[3], half)), ir.IntType(32))
            order = builder.add(_spread(builder, count, LANES32), ir.Constant(_WORDS, list(range(LANES32))))
            packed = _permuted(builder, "llvm.x86.avx512.permvar.si.512", packed, order)
            place = builder.gep(_address(context, builder, args[0], args[1], sig), [_at(-LANES32)])
            narrow = ir.VectorType(half, LANES32)
            builder.store(builder.trunc(packed, narrow), builder.bitcast(place, narrow.as_pointer()), align=2)
            return context.get_dummy_value()
        place = _address(context, builder, args[0], args[1], sig)
        for k in reversed(range(LANES32)):
            builder.store(builder.trunc(_lane(builder, args[2], k), half), builder.gep(place, [_at(-1)]), align=2)
            place = builder.gep(place, [builder.sext(builder.extract_element(args[3], _at(k)), ir.IntType(64))])
        return context.get_dummy_value()

    return types.void(array, index, values, marks), lowered


@operation
def transpose32(typing: Any, source: Any, index: Any, apart: Any, target: Any, at: Any, stride: Any) -> Any:
    """Put the numbers of each lane side by side: of sixteen times sixteen in a flat int32 array, which are at ``index``
    and each ``apart`` from there, those of lane i go to ``at`` + i ``stride`` of another."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _address(context, builder, args[0], args[1], sig)
        step = context.cast(builder, args[2], sig.args[2], types.int64)
        rows = []
        for _ in range(LANES32):
            rows.append(builder.load(builder.bitcast(place, _WORDS.as_pointer()), align=4))
            place = builder.gep(place, [step])
        for bit in (1, 2, 4, 8):  # (rows and columns whose numbers differ in this bit change places)
            low = ir.Constant(_WORDS, [k if k & bit == 0 else LANES32 + k - bit for k in range(LANES32)])
            high = ir.Constant(_WORDS, [k + bit if k & bit == 0 else LANES32 + k for k in range(LANES32)])
            for k in range(LANES32):
                if k & bit == 0:
                    a, b = rows[k], rows[k + bit]
                    rows[k], rows[k + bit] = builder.shuffle_vector(a, b, low), builder.shuffle_vector(a, b, high)
        data = context.make_array(sig.args[3])(context, builder, args[3]).data
        place, step = (context.cast(builder, args[k], sig.args[k], types.int64) for k in (4, 5))
        for row in rows:
            builder.store(row, builder.bitcast(builder.gep(data, [place]), _WORDS.as_pointer()), align=4)
            place = builder.add(place, step)
        return context.get_dummy_value()

    numbers = [types.unliteral(number) for number in (apart, at, stride)]
    return types.void(source, index, numbers[0], target, *numbers[1:]), lowered
