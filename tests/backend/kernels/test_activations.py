# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of Gaussians under their lights and their gradients, against float64 autograd of plain torch."""

import numpy as np
import pytest
import torch
from numba import njit

from physhdr.backend.kernels.activations import (
    DARKEST,
    LOG_RADIANCE_RANGE,
    lit_colours,
    lit_colours_reference,
)
from physhdr.backend.simd import LANES, exp, load, load_triples, store, store_triples
from physhdr.tests.backend.threads import assert_same_bits


def gaussians(count, lights, channels, seed=0):
    """ln H, ln L and shares, some of them so bright and so dark that bounds hold them."""
    generator = torch.Generator().manual_seed(seed)
    tensors = [6.0 * torch.randn(count, 3, generator=generator)]
    tensors.append(3.0 * torch.randn(count, channels, generator=generator))
    if lights:
        tensors.append(torch.randn(count, lights, 3, generator=generator).softmax(dim=1) * 0.9)
    return tensors


def both(tensors, levels):
    """Colours, deviation and gradients by the kernels in float32, and by autograd in float64."""
    results = []
    for function, dtype in ((lit_colours, torch.float32), (lit_colours_reference, torch.float64)):
        inputs = [t.to(dtype).requires_grad_() for t in tensors]
        share = inputs[2] if len(inputs) > 2 else None
        colours, deviation = function(inputs[0], inputs[1], share, levels)
        assert not deviation.requires_grad
        weights = torch.linspace(-1.0, 1.0, colours.numel(), dtype=dtype).view_as(colours)
        results.append([colours.detach(), deviation, *torch.autograd.grad((colours * weights).sum(), inputs)])
    return zip(*results, strict=True)


@pytest.mark.parametrize("count", [LANES, LANES + 3, 1000, 5003])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("levels", [(), (1.0,), (4.0,), (0.0,), (0.2, 5.0, 1.0), (0.0, 0.0)])
def test_lit_colours(count, channels, levels):
    tensors = gaussians(count, len(levels), channels)
    # Logarithms are sums of numbers up to 30, whose rounding is 2e-6.
    for name, (a, b) in zip(("colour", "deviation", "H", "L", "s"), both(tensors, levels), strict=False):
        assert a.shape == b.shape
        assert (a - b).norm() <= 1e-6 * b.norm(), name
        assert torch.allclose(a.double(), b, rtol=1e-4, atol=1e-4), name


@pytest.mark.parametrize("bounds", [LOG_RADIANCE_RANGE, (-14.5, 20.25)])
def test_bounds_pass_no_gradient(bounds):
    low, high = bounds
    reflectance = torch.tensor([[low - 1.0, 5.0, high + 1.0]]).repeat(LANES, 1).requires_grad_()
    illumination = torch.zeros(LANES, 1, requires_grad=True)
    share = torch.tensor([[0.5, 1.0, 0.5]]).repeat(LANES, 1, 1)  # of the second nothing would be left
    share.requires_grad_()
    arguments = reflectance, illumination, share, (0.0,), bounds
    colours, _ = lit_colours(*arguments)
    expected = torch.tensor([low, 5.0 + np.log(DARKEST), high], dtype=torch.float32).exp()
    assert torch.allclose(colours[0], expected, rtol=0.02)  # 1e-6 is a difference of float32's near 1
    assert torch.allclose(colours, lit_colours_reference(*arguments)[0])
    colours.sum().backward()
    assert torch.equal(reflectance.grad[:, ::2], torch.zeros(LANES, 2))
    assert torch.allclose(reflectance.grad[:, 1], colours[:, 1])
    assert torch.equal(share.grad[:, 0], torch.zeros(LANES, 3))


def test_under_the_standard_light_shares_are_not_read_and_learn_nothing():
    """The gradient is zero and not missing: Adam goes on by its moments."""
    reflectance, illumination, share = (t.requires_grad_() for t in gaussians(100, 2, 1))
    with torch.no_grad():
        share[:] = float("nan")
    colours, deviation = lit_colours(reflectance, illumination, share, (1.0, 1.0))
    colours.sum().backward()
    assert torch.equal(share.grad, torch.zeros(100, 2, 3))
    assert torch.equal(deviation, torch.zeros(100))
    without, _ = lit_colours(reflectance, illumination, None, ())
    assert torch.equal(colours, without)


@pytest.mark.parametrize(("which", "place"), [(0, (17, 1)), (1, (17, 1)), (2, (17, 0, 1))])
def test_not_a_number_stays_one(which, place):
    """The rasteriser refuses it and says where it is."""
    tensors = gaussians(100, 1, 3)
    tensors[which][place] = float("nan")
    colours, _ = lit_colours(*tensors, (3.0,))
    assert colours.isnan().nonzero().tolist() == [[17, 1]]


def test_threads():
    def lit():
        inputs = [t.requires_grad_() for t in gaussians(5003, 2, 3)]
        colours, deviation = lit_colours(*inputs, (0.3, 2.0))
        return [colours, deviation, *torch.autograd.grad(colours.square().sum(), inputs)]

    assert_same_bits(lit)


def test_exponential_and_triples():
    @njit
    def run(x, y):
        for i in range(0, x.size, LANES):
            store(exp(load(x, i)), y, i)

    x = np.linspace(-87.0, 88.0, 80_000).astype(np.float32)
    y = np.empty_like(x)
    run(x, y)
    assert np.abs(y / np.exp(x.astype(np.float64)) - 1.0).max() <= 3e-7

    @njit
    def turned(x, y):
        a, b, c = load_triples(x, 1)
        store(a, y, 0)
        store_triples((b, c, a), y, LANES)

    x = np.arange(3 * LANES + 1, dtype=np.float32)
    y = np.empty(4 * LANES, np.float32)
    turned(x, y)
    assert np.array_equal(y[:LANES], x[1::3])
    assert np.array_equal(y[LANES:].reshape(-1, 3), x[1:].reshape(-1, 3)[:, [1, 2, 0]])
