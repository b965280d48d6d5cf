"""Short vectors in kernels: a few lanes side by side, each with the plain arithmetic of one.

Lanes never mix unless a function says so, and every operation is an IEEE or integer one, so the results are the same
bits whatever registers a machine has: kernels are compiled through portable LLVM IR. Outside of compiled code the
same names work on NumPy arrays, so a kernel's Python source is its own twin.

``+ - * / >> < > >=`` take two vectors of a type, or a vector and a scalar of its lanes' type. Numbers of lanes are
constants.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import types as numba_types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model

types: Any = numba_types  # it fills itself while it is imported
Array = np.ndarray[Any, Any]
Lanes = Any  # a vector, an array in NumPy's stead; where it may be a scalar, that too
_I32 = ir.IntType(32)

# Compiled into the functions that call them, which are cached with all that is in them. Neither counts references:
# arrays are their callers'.
inline = njit(error_model="numpy", forceinline=True, _nrt=False)
kernel = njit(error_model="numpy", cache=True, _nrt=False)


class Vector(numba_types.Type):
    """Numba's type of ``lanes`` values of a type."""

    def __init__(self, dtype: Any, lanes: int) -> None:
        self.dtype, self.lanes = dtype, lanes
        super().__init__(f"Vector({dtype}, {lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, ir.VectorType(manager[kind.dtype].get_value_type(), kind.lanes))


def load(array: Array, at: int, lanes: int) -> Lanes:
    """Return ``lanes`` values of a C-contiguous array from flat index ``at``."""
    return array.reshape(-1)[at : at + lanes].copy()


def store(array: Array, at: int, vector: Lanes) -> None:
    """Write a vector into a C-contiguous array from flat index ``at``; inverse of :func:`load`."""
    array.reshape(-1)[at : at + len(vector)] = vector


def prefetch(array: Array, at: int) -> None:
    """Ask for what stands at flat index ``at``, which is needed soon; nothing comes of it but time."""


def spread(value: Any, lanes: int) -> Lanes:
    """Return a scalar in every lane."""
    return np.full(lanes, value)


def pairs(array: Array, at: int, lanes: int) -> Lanes:
    """Return the two int16 values from flat index ``at`` in turns, ``lanes`` in all."""
    return np.tile(array.reshape(-1)[at : at + 2], lanes // 2)


def dot(a: Lanes, b: Lanes) -> Lanes:
    """Multiply int16 lanes and add each even product to the odd one after it: int32, half as many lanes."""
    product = a.astype(np.int32) * b.astype(np.int32)
    return product[::2] + product[1::2]


def smaller(a: Lanes, b: Lanes) -> Lanes:
    """Return the smaller of each two lanes, the second where one is not a number."""
    return np.where(a < b, a, b)


def larger(a: Lanes, b: Lanes) -> Lanes:
    """Return the larger of each two lanes, the second where one is not a number."""
    return np.where(a > b, a, b)


def join(a: Lanes, b: Lanes) -> Lanes:
    """Return the lanes of one vector and, behind them, those of another of the same type."""
    return np.concatenate([a, b])


def splice(a: Lanes, b: Lanes, n: int) -> Lanes:
    """Return the first ``n`` lanes of one vector and the others of a second one."""
    return np.concatenate([a[:n], b[n:]])


def pick(vector: Lanes, *lanes: int) -> Lanes:
    """Return some lanes of a vector, by number."""
    return vector[list(lanes)]


def lane(vector: Lanes, n: int) -> Any:
    """Return one lane."""
    return vector[n]


def push(vector: Lanes, value: Any) -> Lanes:
    """Move every lane to the one before it; the last becomes ``value``."""
    return np.append(vector[1:], value)


def of(*values: Any) -> Lanes:
    """Return scalars as lanes."""
    return np.array(values)


def choose(mask: Lanes, a: Lanes, b: Lanes) -> Lanes:
    """Return the lanes of ``a`` where a comparison is true, those of ``b`` elsewhere."""
    return np.where(mask, a, b)


def root(vector: Lanes) -> Lanes:
    """Return square roots."""
    return np.sqrt(vector)


def totals(*vectors: Lanes) -> Lanes:
    """Return the sum of each vector's lanes, a lane each: upper halves are added to lower ones until one lane is left."""
    lanes = np.stack(vectors)
    while lanes.shape[1] > 1:
        lanes = lanes[:, : lanes.shape[1] // 2] + lanes[:, lanes.shape[1] // 2 :]
    return lanes[:, 0]


def size(vector: Lanes) -> Lanes:
    """Return magnitudes of floats."""
    return np.abs(vector)


def whole(vector: Lanes) -> Lanes:
    """Return the largest integers not above floats."""
    return np.floor(vector)


def cast(vector: Lanes, like: type[np.number[Any]]) -> Lanes:
    """Return the lanes as numbers of another type; floats lose their fraction."""
    return vector.astype(like)


def bits(vector: Lanes) -> Lanes:
    """Return the bits of float32 lanes as int32."""
    return vector.view(np.int32)


def highest(vector: Lanes) -> Any:
    """Return the largest of integer lanes."""
    return vector.max()


def running(vector: Lanes) -> Lanes:
    """Return the sums of integer lanes up to each, itself included."""
    return np.cumsum(vector, dtype=vector.dtype)


def count(mask: Lanes) -> int:
    """Return how many lanes of a comparison are true."""
    return int(np.count_nonzero(mask))


def _define(
    function: Any, kinds: tuple[Any, ...], result: Callable[..., Any], emit: Callable[..., Any]
) -> None:
    """Teach the compiler a function of arguments of ``kinds``.

    ``result`` gives its type for theirs, None where it does not take them; ``emit(builder, kinds, values)`` its
    code, ``kinds`` beginning with the result's, arrays given as pointers.
    """

    class Template(AbstractTemplate):  # type: ignore[misc]
        prefer_literal = True

        def generic(self, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
            found = result(*args)
            return None if found is None else signature(found, *args)

    infer_global(function)(Template)

    @lower_builtin(function, *kinds)
    def lower(context: Any, builder: Any, given: Any, values: Any) -> Any:
        places = [
            context.make_array(kind)(context, builder, value).data if isinstance(kind, types.Array) else value
            for kind, value in zip(given.args, values, strict=True)
        ]
        return emit(builder, (given.return_type, *given.args), places)


def _common(a: Any, b: Any) -> Any:
    """The vector type of two vectors, or of a vector and a scalar."""
    vector = a if isinstance(a, Vector) else b
    same = isinstance(vector, Vector) and all(
        types.unliteral(kind) in (vector, vector.dtype) for kind in (a, b)
    )
    return vector if same else None


def _splat(builder: Any, value: Any, lanes: int) -> Any:
    one = ir.Constant(ir.VectorType(value.type, 1), ir.Undefined)
    first = builder.insert_element(one, value, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, one, ir.Constant(ir.VectorType(_I32, lanes), [0] * lanes))


def _in_lanes(builder: Any, kinds: Any, values: Any) -> list[Any]:
    lanes = next(kind.lanes for kind in kinds if isinstance(kind, Vector))
    return [
        value if isinstance(kind, Vector) else _splat(builder, value, lanes)
        for kind, value in zip(kinds[1:], values, strict=True)
    ]


def _define_each(function: Any, floats: str, integers: str, of_lanes: bool = True) -> None:
    """Define a function of two by the builder's instructions; a comparison's name is its operator."""

    def result(a: Any, b: Any) -> Any:
        vector = _common(a, b)
        return vector if vector is None or of_lanes else Vector(types.boolean, vector.lanes)

    def emit(builder: Any, kinds: Any, values: Any) -> Any:
        of_floats = any(isinstance(getattr(kind, "dtype", None), types.Float) for kind in kinds)
        name = floats if of_floats else integers
        a, b = _in_lanes(builder, kinds, values)
        if function in (smaller, larger):
            compare = builder.fcmp_ordered if of_floats else builder.icmp_signed
            return builder.select(compare(name, a, b), a, b)
        if not of_lanes:
            return (builder.fcmp_ordered if of_floats else builder.icmp_signed)(name, a, b)
        return getattr(builder, name)(a, b)

    for kinds in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        _define(function, kinds, result, emit)


for _function, _floats, _integers in (
    (operator.add, "fadd", "add"),
    (operator.sub, "fsub", "sub"),
    (operator.mul, "fmul", "mul"),
    (operator.truediv, "fdiv", ""),
    (operator.rshift, "", "ashr"),
    (smaller, "<", "<"),
    (larger, ">", ">"),
):
    _define_each(_function, _floats, _integers)
_define_each(operator.lt, "<", "<", of_lanes=False)
_define_each(operator.gt, ">", ">", of_lanes=False)
_define_each(operator.ge, ">=", ">=", of_lanes=False)


def _vector_at(builder: Any, place: Any, at: Any, kind: Any) -> Any:
    return builder.bitcast(builder.gep(place, [at]), kind.as_pointer())


def _align(kind: Vector) -> int:
    return int(kind.dtype.bitwidth) // 8


def _load(builder: Any, kinds: Any, values: Any) -> Any:
    place = _vector_at(builder, values[0], values[1], ir.VectorType(values[0].type.pointee, kinds[0].lanes))
    return builder.load(place, align=_align(kinds[0]))


def _store(builder: Any, kinds: Any, values: Any) -> Any:
    place = _vector_at(builder, values[0], values[1], values[2].type)
    builder.store(values[2], place, align=_align(kinds[3]))
    return ir.Constant(ir.IntType(8).as_pointer(), None)


def _prefetch(builder: Any, kinds: Any, values: Any) -> Any:
    byte = ir.IntType(8).as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [byte, _I32, _I32, _I32])
    name = "llvm.prefetch.p0"
    function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
    place = builder.bitcast(builder.gep(values[0], [values[1]]), byte)
    builder.call(function, [place, ir.Constant(_I32, 0), ir.Constant(_I32, 3), ir.Constant(_I32, 1)])
    return ir.Constant(byte, None)


def _pairs(builder: Any, kinds: Any, values: Any) -> Any:
    both = builder.load(_vector_at(builder, values[0], values[1], _I32), align=2)
    return builder.bitcast(
        _splat(builder, both, kinds[0].lanes // 2), ir.VectorType(ir.IntType(16), kinds[0].lanes)
    )


def _dot(builder: Any, kinds: Any, values: Any) -> Any:
    lanes = kinds[1].lanes
    wide = ir.VectorType(_I32, lanes)
    product = builder.mul(*(builder.sext(value, wide) for value in values))
    none = ir.Constant(wide, ir.Undefined)
    mask = ir.VectorType(_I32, lanes // 2)
    even, odd = (
        builder.shuffle_vector(product, none, ir.Constant(mask, list(range(first, lanes, 2))))
        for first in (0, 1)
    )
    return builder.add(even, odd)


def _of_floats(name: str) -> Callable[..., Any]:
    def emit(builder: Any, kinds: Any, values: Any) -> Any:
        full = f"llvm.{name}.v{kinds[1].lanes}f{kinds[1].dtype.bitwidth}"
        kind = values[0].type
        function = builder.module.globals.get(full) or ir.Function(
            builder.module, ir.FunctionType(kind, [kind]), full
        )
        return builder.call(function, values)

    return emit


def _shuffle(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(lanes)), lanes))


def _pick(builder: Any, kinds: Any, values: Any) -> Any:
    lanes = [kind.literal_value for kind in kinds[2:]]
    return _shuffle(builder, values[0], ir.Constant(values[0].type, ir.Undefined), lanes)


def _splice(builder: Any, kinds: Any, values: Any) -> Any:
    n, lanes = kinds[3].literal_value, kinds[0].lanes
    return _shuffle(builder, values[0], values[1], [i if i < n else lanes + i for i in range(lanes)])


def _push(builder: Any, kinds: Any, values: Any) -> Any:
    lanes = kinds[0].lanes
    moved = _shuffle(builder, values[0], values[0], [*range(1, lanes), 0])
    return builder.insert_element(moved, values[1], ir.Constant(_I32, lanes - 1))


def _totals(builder: Any, kinds: Any, values: Any) -> Any:
    lanes, none = kinds[1].lanes, ir.Constant(values[0].type, ir.Undefined)
    # So many lanes are yet to be added to one; what is left of two vectors finds room in one.
    left, apart = list(values), lanes
    while apart > 1:
        apart //= 2
        lower = [n for n in range(2 * lanes) if n // apart % 2 == 0]
        upper = [n + apart for n in lower]
        left = [
            builder.fadd(*(_shuffle(builder, a, b, half) for half in (lower, upper)))
            for a, b in zip(left[::2], [*left[1::2], none], strict=False)
        ]
    return _shuffle(builder, left[0], none, list(range(len(values))))


def _of(builder: Any, kinds: Any, values: Any) -> Any:
    vector = ir.Constant(ir.VectorType(values[0].type, kinds[0].lanes), ir.Undefined)
    for n, value in enumerate(values):
        vector = builder.insert_element(vector, value, ir.Constant(_I32, n))
    return vector


def _highest(builder: Any, kinds: Any, values: Any) -> Any:
    name = f"llvm.vector.reduce.smax.v{kinds[1].lanes}i{kinds[1].dtype.bitwidth}"
    reduce = builder.module.globals.get(name) or ir.Function(
        builder.module, ir.FunctionType(values[0].type.element, [values[0].type]), name
    )
    return builder.call(reduce, values)


def _running(builder: Any, kinds: Any, values: Any) -> Any:
    lanes, total = kinds[1].lanes, values[0]
    nothing = ir.Constant(total.type, [0] * lanes)
    shift = 1
    while shift < lanes:  # lanes of ``nothing`` come in from the left
        mask = [lanes - shift + i if i < shift else lanes + i - shift for i in range(lanes)]
        moved = builder.shuffle_vector(nothing, total, ir.Constant(ir.VectorType(_I32, lanes), mask))
        total = builder.add(total, moved)
        shift *= 2
    return total


def _count(builder: Any, kinds: Any, values: Any) -> Any:
    bits = builder.bitcast(values[0], ir.IntType(kinds[1].lanes))
    return builder.zext(builder.ctpop(bits), ir.IntType(64))


def _cast(builder: Any, kinds: Any, values: Any) -> Any:
    new, old = kinds[0].dtype, kinds[1].dtype
    wanted = ir.VectorType(ir.IntType(new.bitwidth), kinds[0].lanes)
    if isinstance(new, types.Float):
        real = ir.FloatType() if new.bitwidth == 32 else ir.DoubleType()
        return builder.sitofp(values[0], ir.VectorType(real, kinds[0].lanes))
    if isinstance(old, types.Float):
        return builder.fptosi(values[0], wanted)
    return (builder.trunc if new.bitwidth < old.bitwidth else builder.sext)(values[0], wanted)


def _bits(builder: Any, kinds: Any, values: Any) -> Any:
    return builder.bitcast(values[0], ir.VectorType(_I32, kinds[0].lanes))


_ARRAY, _WHOLE, _TYPE = types.Array, types.Integer, types.NumberClass
_define(load, (_ARRAY, _WHOLE, _WHOLE), lambda a, at, n: Vector(a.dtype, n.literal_value), _load)
_define(store, (_ARRAY, _WHOLE, Vector), lambda *_: types.none, _store)
_define(prefetch, (_ARRAY, _WHOLE), lambda *_: types.none, _prefetch)
_define(pairs, (_ARRAY, _WHOLE, _WHOLE), lambda a, at, n: Vector(a.dtype, n.literal_value), _pairs)
_define(dot, (Vector, Vector), lambda a, b: Vector(types.int32, a.lanes // 2) if a == b else None, _dot)
_define(cast, (Vector, _TYPE), lambda a, like: Vector(like.dtype, a.lanes), _cast)
_define(
    join,
    (Vector, Vector),
    lambda a, b: Vector(a.dtype, 2 * a.lanes) if a == b else None,
    lambda builder, kinds, values: _shuffle(builder, values[0], values[1], list(range(kinds[0].lanes))),
)
_define(splice, (Vector, Vector, _WHOLE), lambda a, b, n: a if a == b else None, _splice)
_define(pick, (Vector, types.VarArg(_WHOLE)), lambda a, *lanes: Vector(a.dtype, len(lanes)), _pick)
_define(
    lane,
    (Vector, _WHOLE),
    lambda a, n: a.dtype,
    lambda builder, kinds, values: builder.extract_element(values[0], values[1]),
)
_define(
    push, (Vector, types.Number), lambda a, value: a if types.unliteral(value) == a.dtype else None, _push
)
_define(
    of, (types.VarArg(types.Number),), lambda *values: Vector(types.unliteral(values[0]), len(values)), _of
)
_define(
    totals,
    (types.VarArg(Vector),),
    lambda a, *others: Vector(a.dtype, 1 + len(others)) if all(a == b for b in others) else None,
    _totals,
)
_define(
    choose,
    (Vector, Vector, Vector),
    lambda mask, a, b: a if a == b else None,
    lambda builder, kinds, values: builder.select(*values),
)
for _of_one, _name in ((root, "sqrt"), (size, "fabs"), (whole, "floor")):
    _define(_of_one, (Vector,), lambda a: a, _of_floats(_name))
_define(bits, (Vector,), lambda a: Vector(types.int32, a.lanes) if a.dtype == types.float32 else None, _bits)
_define(highest, (Vector,), lambda a: a.dtype, _highest)
_define(running, (Vector,), lambda a: a, _running)
_define(count, (Vector,), lambda mask: types.int64, _count)
_define(
    spread,
    (types.Number, _WHOLE),
    lambda value, n: Vector(types.unliteral(value), n.literal_value),
    lambda builder, kinds, values: _splat(builder, values[0], kinds[0].lanes),
)
