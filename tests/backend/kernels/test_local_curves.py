# SPDX-License-Identifier: GPL-3.0-or-later
"""The local curves against float64 autograd of their twin, and against the networks one by one."""

import pytest
import torch

from physhdr.backend import kernels
from physhdr.tests.backend.threads import assert_same_bits


def inputs(branches, points, features, seed=0):
    generator = torch.Generator().manual_seed(seed)
    shapes = [(3, branches, points), (features, points), (3, 16, 1 + features), (3, 16), (3, 16), (3,)]
    return [torch.randn(shape, generator=generator) for shape in shapes]


def run(function, tensors, dtype):
    tensors = [t.to(dtype).clone().requires_grad_() for t in tensors]
    output = function(*tensors)
    weights = torch.randn(output.shape, generator=torch.Generator().manual_seed(1)).to(dtype)
    return output, torch.autograd.grad(output, tensors, weights)


# 4096 is a job's size, 8 a vector's.
@pytest.mark.parametrize("points", [1, 7, 8, 4096, 4099])
@pytest.mark.parametrize(("branches", "features"), [(1, 4), (2, 4), (2, 1)])
def test_against_float64(branches, points, features):
    tensors = inputs(branches, points, features)
    ours, our_gradients = run(kernels.local_curves, tensors, torch.float32)
    truth, true_gradients = run(kernels.local_curves_reference, tensors, torch.float64)
    assert (ours - truth).abs().max() < 1e-4
    for a, b in zip(our_gradients, true_gradients, strict=True):
        assert (a - b).norm() <= 1e-5 * b.norm()


@pytest.mark.parametrize("which", range(6))
def test_nan_is_not_swallowed(which):
    """It must reach the loss, where training refuses it; max(NaN, 0) could make a 0 of it."""
    tensors = inputs(2, 50, 4)
    tensors[which].view(-1)[1] = float("nan")
    ours, gradients = run(kernels.local_curves, tensors, torch.float32)
    twins, true_gradients = run(kernels.local_curves_reference, tensors, torch.float64)
    for a, b in zip((ours, *gradients), (twins, *true_gradients), strict=True):
        assert torch.equal(a.isnan(), b.isnan())


def test_is_one_network_a_channel_and_branch():
    x, context, w1, b1, w2, b2 = inputs(2, 50, 4)
    result = kernels.local_curves(x, context, w1, b1, w2, b2)
    for c in range(3):
        for branch in range(2):
            seen = torch.cat([x[c, branch : branch + 1], context])
            alone = kernels.small_mlp_reference(seen, w1[c], b1[c], w2[c : c + 1], b2[c : c + 1], "relu")
            torch.testing.assert_close(result[c, branch], alone[0], rtol=1e-5, atol=1e-5)


def test_same_bits_for_any_number_of_threads():
    tensors = inputs(2, 9000, 4)

    def computed():
        output, gradients = run(kernels.local_curves, tensors, torch.float32)
        return [output.detach(), *gradients]

    assert_same_bits(computed)


@pytest.mark.parametrize("error", ["l1", "mse"])
def test_pixel_error_beside_ssim(error):
    generator = torch.Generator().manual_seed(2)
    prediction, target = torch.rand(2, 3, 21, 18, generator=generator)
    target[:, :5] = prediction[:, :5]  # where the difference is 0, so is the slope of its size
    ours, truth = prediction.clone().requires_grad_(), prediction.double().requires_grad_()
    similarity, pixel = kernels.ssim_and_error(ours, target, error)
    true_similarity, true_pixel = kernels.ssim_and_error(truth, target.double(), error)
    (0.3 * similarity + 0.7 * pixel).backward()
    (0.3 * true_similarity + 0.7 * true_pixel).backward()
    assert pixel.item() == pytest.approx(true_pixel.item(), rel=1e-5)
    assert similarity.item() == pytest.approx(true_similarity.item(), abs=1e-5)
    assert (ours.grad - truth.grad).norm() <= 1e-4 * truth.grad.norm()
