# SPDX-License-Identifier: GPL-3.0-or-later
"""Pointwise kernels against float64 autograd of the same formula in plain torch."""

import pytest
import torch

from physhdr.backend.kernels import pointwise
from physhdr.tests.backend.threads import assert_same_bits

FUNCTIONS = {
    "log of exposure": (lambda x: pointwise.log_of_exposure(x, 1e-5), 1),
    "corrected": (pointwise.corrected, 2),
    "blend": (pointwise.blend, 3),
}


def gradients(function, tensors, dtype):
    tensors = [t.to(dtype).clone().requires_grad_() for t in tensors]
    output = function(*tensors)
    weights = torch.randn(output.shape, generator=torch.Generator().manual_seed(1)).to(dtype)
    return [output.detach(), *torch.autograd.grad(output, tensors, weights)]


# Fewer than a vector, a vector, a vector and some, several ranges.
@pytest.mark.parametrize("count", [3, 8, 13, 5003])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_against_float64(name, count):
    function, inputs = FUNCTIONS[name]
    generator = torch.Generator().manual_seed(0)
    # Wide enough that σ saturates, the clip clips on both sides, and exposures are negative and tiny.
    tensors = [4.0 * torch.randn(count, generator=generator) for _ in range(inputs)]
    tensors[0][0] = 0.0
    for ours, truth in zip(
        gradients(function, tensors, torch.float32), gradients(function, tensors, torch.float64), strict=True
    ):
        torch.testing.assert_close(ours.double(), truth, rtol=2e-6, atol=2e-6)


def test_extreme_exposures():
    exposure = torch.tensor([0.0, -1.0, 1e-30, 1e-5, 1.0, 1e4, 3e8, 1.0, 2.0])
    ours = pointwise.log_of_exposure(exposure, 1e-5)
    truth = (exposure.double().clamp_min(0.0) + 1e-5).log()
    torch.testing.assert_close(ours.double(), truth, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_nan_is_not_swallowed(name):
    """Wherever it comes from it must reach the loss, where training refuses it."""
    function, inputs = FUNCTIONS[name]
    for which in range(inputs):
        tensors = [torch.linspace(-2.0, 2.0, 20) for _ in range(inputs)]
        tensors[which][7] = float("nan")
        assert function(*tensors).isnan().nonzero().tolist() == [[7]]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_same_bits_for_any_number_of_threads(name):
    function, inputs = FUNCTIONS[name]
    generator = torch.Generator().manual_seed(3)
    tensors = [torch.randn(5003, generator=generator) for _ in range(inputs)]
    assert_same_bits(lambda: gradients(function, tensors, torch.float32))
