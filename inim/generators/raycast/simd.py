"""Vectors of neighbouring lenses, for compiled kernels.

Kernels process `LANES` lenses at once: their depths, colours and decisions are separate values
(`Lanes`), which the compiler keeps in vector registers, for any register width. Loops over arrays
would pass through memory after every step, and only some of them would be vectorised.

Bounds are not checked: a load or store reaches `LANES` elements from its index, `every4` four times
as many. Parts of 16 bits are stored at even indices.

Stored kernels are compiled again if this file changes, see `inim.system.backend.kernels`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

# Two 512-bit vectors, or four of 256; as many as a word has bits. More lenses have looser depth
# bounds and fewer searches that end early; fewer have more overhead, and more loads that straddle
# cache lines.
LANES = 32

# Edge of the square blocks that `transpose` turns: eight words fill a 256-bit vector.
BLOCK = 8

_INDEX = ir.IntType(64)
_ELEMENTS = {
    "float32": ir.FloatType(),
    "uint32": ir.IntType(32),
    "uint16": ir.IntType(16),
    "flag": ir.IntType(1),
}


class Lanes(types.Type):  # type: ignore[misc]
    """One number (float32, uint32, uint16) or flag for each lane."""

    def __init__(self, element: str, count: int) -> None:
        self.element, self.count = element, count
        self.vector = ir.VectorType(_ELEMENTS[element], count)
        super().__init__(f"{element}x{count}")

    @property
    def flags(self) -> Lanes:
        """A flag for each of these lanes."""
        return Lanes("flag", self.count)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Lanes) -> None:
        super().__init__(manager, kind, kind.vector)


def _simple(build: Callable[..., Any]) -> Callable[..., Any]:
    """Code generator that applies one instruction to the arguments."""
    return lambda context, builder, signature, arguments: build(builder, *arguments)


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Pointer to an array's first element."""
    return context.make_array(kind)(context, builder, array).data


def _loader(count: int) -> Any:
    """Intrinsic that loads elements of a flat array from an index on."""

    @intrinsic
    def load(typing, array, index):  # type: ignore[no-untyped-def]
        lanes = Lanes(str(array.dtype), count)

        def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            data = _data(context, builder, signature.args[0], arguments[0])
            place = builder.gep(data, [arguments[1]])
            return builder.load(builder.bitcast(place, lanes.vector.as_pointer()), align=4)

        return lanes(array, types.uintp), build

    return load


def _filler(count: int) -> Any:
    """Intrinsic that puts a number in each lane."""

    @intrinsic
    def same(typing, number):  # type: ignore[no-untyped-def]
        def build(builder, value):  # type: ignore[no-untyped-def]
            undefined = ir.Constant(ir.VectorType(value.type, count), ir.Undefined)
            vector = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
            return _shuffle(builder, vector, undefined, [0] * count)

        return Lanes(str(number), count)(number), _simple(build)

    return same


#: Elements from an index on, and a number in each lane; of `LANES` lanes, or of four.
load, load4 = _loader(LANES), _loader(4)
same, same4 = _filler(LANES), _filler(4)


@intrinsic
def store(typing, array, index, lanes):  # type: ignore[no-untyped-def]
    """Write lanes to a flat array from an index on."""

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        data = _data(context, builder, signature.args[0], arguments[0])
        place = builder.gep(data, [arguments[1]])
        builder.store(arguments[2], builder.bitcast(place, lanes.vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uintp, lanes), build


@intrinsic
def all_lanes(typing):  # type: ignore[no-untyped-def]
    """A flag set in each of `LANES`."""
    flags = Lanes("flag", LANES)
    return flags(), _simple(lambda builder: ir.Constant(flags.vector, [1] * LANES))


@intrinsic
def no_lanes(typing):  # type: ignore[no-untyped-def]
    """A flag set in none of `LANES`."""
    flags = Lanes("flag", LANES)
    return flags(), _simple(lambda builder: ir.Constant(flags.vector, [0] * LANES))


@intrinsic
def lanes_of(typing, bits):  # type: ignore[no-untyped-def]
    """Flags from the bits of an unsigned integer, lowest bit first."""
    flags = Lanes("flag", bits.bitwidth)
    return flags(bits), _simple(lambda builder, bits: builder.bitcast(bits, flags.vector))


def _operation(build: Callable[..., Any], *, compare: bool = False) -> Any:
    """Intrinsic of two arguments, lane by lane; a comparison gives flags."""

    @intrinsic
    def operation(typing, a, b):  # type: ignore[no-untyped-def]
        return (a.flags if compare else a)(a, a), _simple(build)

    return operation


#: Flags of lanes with a >= b, and with a < b; false for NaN.
at_least = _operation(lambda builder, a, b: builder.fcmp_ordered(">=", a, b), compare=True)
less = _operation(lambda builder, a, b: builder.fcmp_ordered("<", a, b), compare=True)
#: Flags of lanes with other whole numbers.
differ = _operation(lambda builder, a, b: builder.icmp_unsigned("!=", a, b), compare=True)
#: Flags, or bits, set in both arguments, in either one, and in the first only.
and_flags = _operation(lambda builder, a, b: builder.and_(a, b))
either = _operation(lambda builder, a, b: builder.or_(a, b))
but_not = _operation(lambda builder, a, b: builder.and_(a, builder.not_(b)))
#: Sums and products of whole numbers, and their bits moved to lower places.
add = _operation(lambda builder, a, b: builder.add(a, b))
multiply = _operation(lambda builder, a, b: builder.mul(a, b))
shift_right = _operation(lambda builder, a, b: builder.lshr(a, b))
#: Float32 arithmetic.
plus = _operation(lambda builder, a, b: builder.fadd(a, b))
minus = _operation(lambda builder, a, b: builder.fsub(a, b))
times = _operation(lambda builder, a, b: builder.fmul(a, b))
over = _operation(lambda builder, a, b: builder.fdiv(a, b))


@intrinsic
def any_lane(typing, flags):  # type: ignore[no-untyped-def]
    """True if a flag is set in any lane."""
    bits = ir.IntType(flags.count)

    def build_any_lane(builder, flags):  # type: ignore[no-untyped-def]
        return builder.icmp_unsigned("!=", builder.bitcast(flags, bits), ir.Constant(bits, 0))

    return types.boolean(flags), _simple(build_any_lane)


@intrinsic
def choose(typing, flags, a, b):  # type: ignore[no-untyped-def]
    """Lanes of a where the flag is set, of b elsewhere."""
    return a(flags, a, a), _simple(lambda builder, flags, a, b: builder.select(flags, a, b))


@intrinsic
def as_float(typing, a):  # type: ignore[no-untyped-def]
    """Whole numbers below 2^31 as float32."""
    floats = Lanes("float32", a.count)
    return floats(a), _simple(lambda builder, a: builder.sitofp(a, floats.vector))


@intrinsic
def as_uint16(typing, a):  # type: ignore[no-untyped-def]
    """Float32 from 0 to 2^16 - 1 as whole numbers, rounded down."""
    words, parts = Lanes("uint32", a.count), Lanes("uint16", a.count)

    def build(builder, a):  # type: ignore[no-untyped-def]
        return builder.trunc(builder.fptosi(a, words.vector), parts.vector)

    return parts(a), _simple(build)


@intrinsic
def every4(typing, array, index):  # type: ignore[no-untyped-def]
    """Load every fourth element of a flat array from an index on, `LANES` of them."""
    lanes = Lanes(str(array.dtype), LANES)

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        data = _data(context, builder, signature.args[0], arguments[0])
        place = builder.gep(data, [arguments[1]])
        whole = ir.VectorType(lanes.vector.element, 4 * LANES - 3)
        vector = builder.load(builder.bitcast(place, whole.as_pointer()), align=4)
        return _shuffle(builder, vector, vector, [4 * n for n in range(LANES)])

    return lanes(array, types.uintp), build


@intrinsic
def transpose(typing, strip, source, out, target, columns, lens):  # type: ignore[no-untyped-def]
    """Write `BLOCK` pixels under each of `BLOCK` lenses, from their lanes.

    ``out[target + columns[lens + n] + u] = strip[source + u * LANES + n]`` for n, u < `BLOCK`;
    flat uint32 arrays, and int64 columns.
    """

    def build(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        strip, source, out, target, columns, lens = arguments
        kinds = signature.args
        strip_data = _data(context, builder, kinds[0], strip)
        out_data = _data(context, builder, kinds[2], out)
        column_data = _data(context, builder, kinds[4], columns)
        block = ir.VectorType(ir.IntType(32), BLOCK)
        rows = []
        for u in range(BLOCK):
            place = builder.gep(strip_data, [builder.add(source, _INDEX(u * LANES))])
            rows.append(builder.load(builder.bitcast(place, block.as_pointer()), align=4))
        for n, row in enumerate(_transposed(builder, rows)):
            column = builder.load(builder.gep(column_data, [builder.add(lens, _INDEX(n))]))
            place = builder.gep(out_data, [builder.add(target, column)])
            builder.store(row, builder.bitcast(place, block.as_pointer()), align=4)
        return context.get_dummy_value()

    index = types.uintp
    return types.void(strip, index, out, index, columns, index), build


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """A square block's columns: quarters of it change places, then quarters of those."""
    half = 1
    while half < BLOCK:
        upper = [k if not k & half else BLOCK + (k ^ half) for k in range(BLOCK)]
        lower = [k | half if not k & half else BLOCK + k for k in range(BLOCK)]
        for i in range(BLOCK):
            if not i & half:
                a, b = rows[i], rows[i | half]
                rows[i] = _shuffle(builder, a, b, upper)
                rows[i | half] = _shuffle(builder, a, b, lower)
        half *= 2
    return rows


def _shuffle(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    """Lanes of a, then of b, in another order."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
    return builder.shuffle_vector(a, b, mask)
