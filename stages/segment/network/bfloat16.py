"""bfloat16 in NumPy arrays, which do not know it: bits as uint16, beside float32 where a processor has none of it."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

Numbers = NDArray[np.float32] | NDArray[np.uint16]


def numbers(shape: tuple[int, ...], dtype: torch.dtype) -> Numbers:
    """Return an empty array for numbers of a type."""
    return np.empty(shape, np.uint16) if dtype == torch.bfloat16 else np.empty(shape, np.float32)


def as_tensor(array: Numbers) -> Tensor:
    """Return the numbers of an array as a tensor of their type."""
    tensor = torch.from_numpy(array)
    return tensor.view(torch.bfloat16) if array.dtype == np.uint16 else tensor


def as_numbers(tensor: Tensor) -> Numbers:
    """Inverse of :func:`as_tensor`."""
    array: Numbers = (tensor.view(torch.uint16) if tensor.dtype == torch.bfloat16 else tensor).numpy()
    return array


@njit(cache=True)
def take(numbers: Numbers, out: NDArray[np.float32]) -> None:
    """Write numbers ``(N,)`` as float32 ``(N,)``."""
    if numbers.itemsize == 2:
        bits = out.view(np.uint32)
        for i in range(len(bits)):
            bits[i] = np.uint32(numbers[i]) << np.uint32(16)
    else:
        out[:] = numbers


@njit(cache=True)
def put(values: NDArray[np.float32], out: Numbers) -> None:
    """Write values ``(N,)`` as numbers ``(N,)``, rounded to the nearest, ties to even; inverse of :func:`take`."""
    if out.itemsize == 2:
        bits = values.view(np.uint32)
        for i in range(len(bits)):
            half = np.uint32(0x7FFF) + (bits[i] >> np.uint32(16) & np.uint32(1))
            out[i] = (bits[i] + half) >> np.uint32(16)
    else:
        out[:] = values
