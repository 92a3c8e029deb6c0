# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of stereo against the same in plain torch, whole volumes at a time."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from physhdr.backend.kernels.stereo import BELIEVED, LARGE_STEP, NOISE, PATCH, SMALL_STEP
from physhdr.backend.kernels.stereo import matching_costs as fused_costs
from physhdr.backend.kernels.stereo import semi_global as fused_semi_global
from physhdr.backend.simd import LANES

HEIGHT, WIDTH = 23, 31


def means(stack):
    """Means over patches of ``[N, H, W]``; the border is repeated outward."""
    half = PATCH // 2
    padded = functional.pad(stack[None], (half,) * 4, mode="replicate")
    return functional.avg_pool2d(padded, PATCH, stride=1)[0]


def correlations(grey, other, homogeneous):
    """``[D, H, W]`` of ``grey`` with ``other`` at ``homogeneous`` places ``[3, D, H·W]`` (float32)."""
    shape = (homogeneous.shape[1], *grey.shape)
    x, y = homogeneous[0] / homogeneous[2], homogeneous[1] / homogeneous[2]
    inside = (homogeneous[2] > 0.0) & (x.abs() < 1.0) & (y.abs() < 1.0)
    grid = torch.stack([x, y], dim=-1).nan_to_num(2.0, 2.0, 2.0)[None].to(grey)
    warped = functional.grid_sample(other[None, None], grid, padding_mode="border", align_corners=False)
    grey, warped = grey[None], warped.view(shape)
    mean, warped_mean = means(grey), means(warped)
    variance = (means(grey * grey) - mean**2).clamp_min(0.0) + NOISE**2
    warped_variance = (means(warped * warped) - warped_mean**2).clamp_min(0.0) + NOISE**2
    covariance = means(grey * warped) - mean * warped_mean
    return torch.where(inside.view(shape), covariance / (variance * warped_variance).sqrt(), 0.0)


def matching_costs(grey, others, at_infinity, per_inverse_depth, inverse_depths):
    """``[D, H, W]`` float64, of float32 places: whether they are inside must not hang on rounding."""
    scores = [
        correlations(grey.double(), other.double(), a[:, None] + b[:, None, None] * inverse_depths[:, None])
        for other, a, b in zip(others, at_infinity, per_inverse_depth, strict=True)
    ]
    best = torch.stack(scores).sort(dim=0, descending=True).values[:BELIEVED]
    return 1.0 - best.mean(dim=0)


def semi_global(cost):
    """Sum over eight directions of the cheapest path to each pixel at each depth, ``[D, H, W]``."""
    total = torch.zeros_like(cost)
    for turned in (False, True):
        turn = (lambda x: x.transpose(-1, -2)) if turned else (lambda x: x)
        for flipped in (False, True):
            flip = (lambda x: x.flip(1)) if flipped else (lambda x: x)
            for shift in (0,) if turned else (-1, 0, 1):
                total += turn(flip(paths(flip(turn(cost)), shift)))
    return total


def paths(cost, shift):
    """The cheapest paths that come from the row above, ``shift`` columns to the side, ``[D, H, W]``."""
    result = cost.clone()
    for row in range(1, cost.shape[1]):
        before = result[:, row - 1].roll(shift, dims=-1)
        least = before.amin(dim=0, keepdim=True)
        way = torch.minimum(before, least + LARGE_STEP)
        way[1:] = torch.minimum(way[1:], before[:-1] + SMALL_STEP)
        way[:-1] = torch.minimum(way[:-1], before[1:] + SMALL_STEP)
        way -= least
        if shift:
            way[:, 0 if shift > 0 else -1] = 0.0  # paths begin at the picture's border
        result[:, row] += way
    return result


def depths_first(volume, depths):
    """``[H, W, D′]`` of a kernel as ``[D, H, W]``, after a look at what lies beyond the last depth."""
    assert volume.shape[2] == -(-depths // LANES) * LANES
    assert np.isposinf(volume[..., depths:]).all()
    return torch.from_numpy(volume[..., :depths]).permute(2, 0, 1)


def pictures(sizes, seed):
    """Noise of the given sizes, smooth enough that patches resemble each other somewhere, and a flat part."""
    generator = torch.Generator().manual_seed(seed)
    for height, width in sizes:
        picture = functional.avg_pool2d(torch.randn(1, height + 2, width + 2, generator=generator), 3, 1)[0]
        picture[:6, :8] = 0.25
        yield picture - picture.mean()


def homogeneous(rotation, translation):
    """Where pixels lie, −0.8 … 0.8 across: at infinity ``[3, H·W]``, and per inverse depth ``[3]``."""
    y, x = torch.meshgrid(torch.linspace(-0.8, 0.8, HEIGHT), torch.linspace(-0.8, 0.8, WIDTH), indexing="ij")
    rays = torch.stack([x, y, torch.ones_like(x)]).reshape(3, -1)
    return torch.tensor(rotation) @ rays, torch.tensor(translation)


STRAIGHT = [[1.1, 0.0, 0.03], [0.0, 1.1, -0.02], [0.0, 0.0, 1.0]]
#: Half of what it is shown lies behind it, and the middle column in its plane.
ASIDE = [[0.9, 0.0, 0.05], [0.0, 1.1, 0.0], [1.0, 0.0, 0.0]]
NEIGHBOURS = [
    ((HEIGHT, WIDTH), homogeneous(STRAIGHT, [0.3, 0.1, 0.0])),
    ((19, 40), homogeneous(STRAIGHT, [-0.4, 0.2, 0.3])),
    ((HEIGHT, WIDTH), homogeneous(ASIDE, [-0.3, -0.2, 0.0])),
    ((30, 17), homogeneous(STRAIGHT, [0.1, -0.3, -0.9])),  # its plane is crossed at w = 1.11
    ((HEIGHT, WIDTH), homogeneous([[0.0] * 3] * 3, [0.0, 0.0, 0.0])),  # nowhere: 0 / 0
]


@pytest.mark.parametrize("depths", [3, 24, 37])
@pytest.mark.parametrize("which", [[0], [1, 3], [2], [0, 1, 2, 3, 4], [4]], ids=str)
def test_matching_costs(which, depths):
    sizes, places = zip(*(NEIGHBOURS[i] for i in which), strict=True)
    grey, *others = pictures([(HEIGHT, WIDTH), *sizes], seed=depths)
    at_infinity, per_inverse_depth = (torch.stack(part) for part in zip(*places, strict=True))
    inverse_depths = torch.linspace(0.0, 1.3, depths)
    expected = matching_costs(grey, others, at_infinity, per_inverse_depth, inverse_depths)
    costs = fused_costs(
        grey.numpy(),
        [other.numpy() for other in others],
        *(part.numpy() for part in (at_infinity, per_inverse_depth, inverse_depths)),
    )
    assert (depths_first(costs, depths) - expected).abs().max() < 1e-4
    # Something is compared, or else all costs would be 1.
    assert (which == [4]) == bool((expected == 1.0).all())


def test_a_place_that_is_no_number_is_warped_like_one_beyond_the_right_border():
    """Its own score is 0, but patches beside it hold it."""
    grey, other = pictures([(HEIGHT, WIDTH)] * 2, seed=5)
    at_infinity, per_inverse_depth = (part[None].clone() for part in homogeneous(STRAIGHT, [0.3, 0.1, 0.0]))
    for i, (x, depth) in enumerate(((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1e-30), (-1.0, 1e-30))):
        at_infinity[0, 0, 70 + 60 * i : 72 + 60 * i], at_infinity[0, 2, 70 + 60 * i : 72 + 60 * i] = x, depth
    still = torch.zeros_like(per_inverse_depth)
    arguments = at_infinity, still, torch.zeros(1)
    expected = matching_costs(grey, [other], *arguments)
    costs = fused_costs(grey.numpy(), [other.numpy()], *(part.numpy() for part in arguments))
    assert (depths_first(costs, 1) - expected).abs().max() < 1e-4


@pytest.mark.parametrize("shape", [(24, 23, 31), (37, 9, 40), (3, 1, 12), (8, 12, 1)], ids=str)
def test_semi_global(shape):
    costs = torch.rand(shape, generator=torch.Generator().manual_seed(0)) * 2.0
    depths = shape[0]
    padded = functional.pad(costs.permute(1, 2, 0), (0, -depths % LANES), value=torch.inf)
    sums = depths_first(fused_semi_global(padded.contiguous().numpy()), depths)
    assert (sums - semi_global(costs.double())).abs().max() < 1e-4
