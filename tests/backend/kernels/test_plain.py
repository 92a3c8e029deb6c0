# SPDX-License-Identifier: GPL-3.0-or-later
"""The switch between fused kernels and plain torch."""

import threading

import pytest
import torch
from torch.autograd.function import BackwardCFunction

from physhdr.backend import kernels

PICTURE = torch.rand(3, 24, 20, generator=torch.Generator().manual_seed(0))
KNOWN = kernels.SsimTarget(PICTURE)
MEANS, VIEWPOINT = torch.randn(7, 3, generator=torch.Generator().manual_seed(1)), torch.zeros(3)


def leaf(*shape: int) -> torch.Tensor:
    return torch.ones(shape, requires_grad=True)


CALLS = {
    "ssim": lambda: kernels.ssim(leaf(3, 24, 20), PICTURE),
    "ssim, target known": lambda: kernels.ssim(leaf(3, 24, 20), KNOWN),
    "blur": lambda: kernels.gaussian_blur(leaf(3, 24, 20), 11, 3.0),
    "curves": lambda: kernels.curve_mlp(leaf(3, 9), *(leaf(3, 8) for _ in range(3)), leaf(3), "softplus"),
    "network": lambda: kernels.small_mlp(leaf(6, 9), leaf(8, 6), leaf(8), leaf(3, 8), leaf(3), "relu"),
    "spherical harmonics": lambda: kernels.evaluate_sh(leaf(7, 3), leaf(7, 15, 3), MEANS, VIEWPOINT, 3),
}


def is_fused(output: torch.Tensor) -> bool:
    """Whether a kernel of ours took part: only they are autograd functions written in Python."""
    nodes, seen = [output.grad_fn], set()
    while nodes:
        node = nodes.pop()
        if isinstance(node, BackwardCFunction):
            return True
        if node is not None and node not in seen:
            seen.add(node)
            nodes += [following for following, _ in node.next_functions]
    return False


@pytest.mark.parametrize("name", list(CALLS))
def test_plain_torch_reaches_every_kernel(name):
    assert is_fused(CALLS[name]())
    with kernels.plain_torch():
        assert not is_fused(CALLS[name]())
    assert is_fused(CALLS[name]())


def test_a_known_target_is_the_same_target():
    prediction = (PICTURE * 0.8 + 0.1).requires_grad_()
    with kernels.plain_torch():
        known, given = kernels.ssim(prediction, KNOWN), kernels.ssim(prediction, PICTURE)
    assert torch.equal(known, given)


def test_an_error_inside_leaves_the_switch_as_it_was():
    with pytest.raises(ZeroDivisionError), kernels.plain_torch():
        raise ZeroDivisionError
    assert kernels.can_fuse(PICTURE)


def test_other_threads_stay_fused():
    answers = []
    with kernels.plain_torch():
        thread = threading.Thread(target=lambda: answers.append(kernels.can_fuse(PICTURE)))
        thread.start()
        thread.join()
        answers.append(kernels.can_fuse(PICTURE))
    assert answers == [True, False]


def test_what_cannot_be_fused():
    assert not kernels.can_fuse(PICTURE.double())
    assert not kernels.can_fuse(PICTURE, PICTURE.double())
    assert not kernels.can_fuse(PICTURE.to("meta"))
