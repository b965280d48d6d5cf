"""Both directions of a coder in one walk: each step encodes the value that it is given, or decodes one, and returns it.

A walk goes over its symbols once for either direction, with ``writing`` as its first argument: contexts are made in one place,
and an encoder and a decoder cannot come apart. ``buffer`` is what is written, or what is read.

>>> import numpy as np
>>> from salpcc.stages.entropy.range_coder import new_bits
>>> buffer = np.zeros(64, np.uint8)
>>> state, model = start_coder(True, buffer), new_bits(256)
>>> [code_tree(True, state, buffer, model, 0, 8, value) for value in (7, 200, 7)]
[7, 200, 7]
>>> written = finish_coder(True, state, buffer)
>>> state, model = start_coder(False, buffer[:written]), new_bits(256)
>>> [code_tree(False, state, buffer[:written], model, 0, 8, 0) for _ in range(3)]
[7, 200, 7]
>>> finish_coder(False, state, buffer[:written])
0
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.stages.entropy.range_coder import (
    decode_bit,
    decode_interval,
    decode_mixed_bit,
    decode_target,
    encode_bit,
    encode_interval,
    encode_mixed_bit,
    finish_encoder,
    start_decoder,
    start_encoder,
)

State = NDArray[np.int64]
Buffer = NDArray[np.uint8]
Model = NDArray[np.uint16]

# For steps and walks: arrays are their callers', and counting references to them, a bit's worth each time, takes longer than
# the bit. So what they need is made by who calls them.
uncounted = njit(cache=True, _nrt=False)
_step = njit(cache=True, _nrt=False, inline="always")


@njit(cache=True)
def start_coder(writing: bool, buffer: Buffer) -> State:
    """Return the state of a fresh coder."""
    return start_encoder() if writing else start_decoder(buffer)


@uncounted
def failed(state: State) -> bool:
    """Tell whether the buffer was too small, or held too little."""
    return state[3] != 0


@njit(cache=True)
def finish_coder(writing: bool, state: State, buffer: Buffer) -> int:
    """Return the bytes written, 0 when reading; -1 if the buffer was too small, or held too little."""
    if writing:
        return finish_encoder(state, buffer)
    return -1 if state[3] != 0 else 0


@_step
def code_bit(writing: bool, state: State, buffer: Buffer, model: Model, context: int, bit: int) -> int:
    """Code one bit in a context of ``model``, which adapts."""
    if writing:
        encode_bit(state, buffer, model, context, bit)
        return bit
    return decode_bit(state, buffer, model, context)


@_step
def code_mixed_bit(
    writing: bool, state: State, buffer: Buffer, first: Model, i: int, second: Model, j: int, bit: int
) -> int:
    """Code one bit by the mean of two contexts, ``first[i]`` and ``second[j]``, which adapt."""
    if writing:
        encode_mixed_bit(state, buffer, first, i, second, j, bit)
        return bit
    return decode_mixed_bit(state, buffer, first, i, second, j)


@_step
def code_raw(writing: bool, state: State, buffer: Buffer, bits: int, value: int) -> int:
    """Code the lowest ``bits`` of a value as they are, up to 24 of them."""
    if writing:
        value &= (1 << bits) - 1
        encode_interval(state, buffer, value, 1, bits)
    else:
        value = decode_target(state, bits)
        decode_interval(state, buffer, value, 1, bits)
    return value


@_step
def code_tree(
    writing: bool, state: State, buffer: Buffer, model: Model, context: int, bits: int, value: int
) -> int:
    """Code a value of ``bits`` bits by the tree of its leading bits, whose nodes stand from ``model[context + 1]`` on."""
    node = 1
    for shift in range(bits - 1, -1, -1):
        bit = (np.int64(value) >> shift) & 1
        node = node << 1 | code_bit(writing, state, buffer, model, context + node, bit)
    return node - (1 << bits)


@_step
def code_mixed_tree(
    writing: bool,
    state: State,
    buffer: Buffer,
    first: Model,
    i: int,
    second: Model,
    j: int,
    bits: int,
    value: int,
) -> int:
    """Code a value of ``bits`` bits by two trees, each bit by the mean of both."""
    node = 1
    for shift in range(bits - 1, -1, -1):
        bit = (np.int64(value) >> shift) & 1
        node = node << 1 | code_mixed_bit(writing, state, buffer, first, i + node, second, j + node, bit)
    return node - (1 << bits)
