"""bfloat16 in NumPy arrays against torch's."""

import numpy as np
import pytest
import torch

from salpcc.stages.segment.network.bfloat16 import as_numbers, as_tensor, numbers, put, take


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_numbers_are_rounded_as_torch_does(dtype: torch.dtype) -> None:
    """Halves go to even, both ways, and what is rounded over a power of two."""
    halves = np.float32([1 + 2**-8, 1 + 3 * 2**-8, -1 - 2**-8, 2 - 2**-9, 0.0, -0.0])
    values = np.concatenate([halves, np.random.default_rng(0).normal(0, 100, 1000).astype(np.float32)])
    found = numbers(values.shape, dtype)
    put(values, found)
    assert torch.equal(as_tensor(found), torch.from_numpy(values).to(dtype))
    back = np.empty_like(values)
    take(as_numbers(as_tensor(found)), back)
    assert (back == as_tensor(found).float().numpy()).all()
