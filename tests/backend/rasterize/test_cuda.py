# SPDX-License-Identifier: GPL-3.0-or-later
"""The adapter to gsplat, without a card: against a gsplat of plain torch that has gsplat 1.5.3's interface.

What the kernels themselves compute is checked on a card, by ``make gpu-check``.
"""

import inspect
import sys
import types

import numpy as np
import pytest
import torch

from physhdr.backend.kernels import compiled, evaluate_sh_reference
from physhdr.backend.kernels.mlp import curve_mlp_reference
from physhdr.backend.rasterize import cuda, reference
from physhdr.backend.rasterize.trial import try_out
from physhdr.backend.scene.camera import Camera

# -- gsplat's interface in plain torch, as its source reads ------------------------------------------------


def fully_fused_projection(
    means, covars, quats, scales, viewmats, Ks, width, height, eps2d=0.3, near_plane=0.01, far_plane=1e10,
    radius_clip=0.0, packed=False, sparse_grad=False, calc_compensations=False, camera_model="pinhole",
    opacities=None,
):  # fmt: skip
    assert covars is None and viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3)
    if len(means) == 0:
        raise FloatingPointError("gsplat divides by the number of Gaussians")
    K, view = Ks[0], viewmats[0]
    centre = means @ view[:3, :3].T + view[:3, 3]
    z = centre[:, 2]
    safe = z.clamp_min(near_plane)
    size = torch.tensor([width, height])
    focal, principal = K[[0, 1], [0, 1]], K[:2, 2]
    tan = centre[:, :2] / safe[:, None]
    margin = 0.3 * 0.5 * size / focal
    limited = tan.clamp(-(principal / focal + margin), (size - principal) / focal + margin)
    across, along = torch.diag(focal) / safe[:, None, None], -focal * limited / safe[:, None]
    J = torch.cat([across, along[:, :, None]], dim=2)
    half = reference.rotation_matrices(quats) * scales[:, None, :]
    A = J @ view[:3, :3] @ half
    covariance = A @ A.mT + eps2d * torch.eye(2, dtype=means.dtype)
    conic = torch.linalg.inv(covariance)
    screen = focal * tan + principal
    with torch.no_grad():
        extent = (2 * torch.log(opacities * 255)).clamp_min(0).sqrt().clamp_max(3.33)
        radii = torch.ceil(extent[:, None] * covariance.diagonal(dim1=1, dim2=2).sqrt())
        drawn = (z >= near_plane) & (z <= far_plane) & (opacities >= 1 / 255)
        drawn &= ((screen + radii > 0) & (screen - radii < size)).all(1)
        radii = torch.where(drawn[:, None], radii, 0.0).to(torch.int32)
    # What is not drawn is left unwritten in gsplat's buffers.
    garbage = torch.where(drawn, 0.0, torch.nan).to(means)
    conics = torch.stack([conic[:, 0, 0], conic[:, 0, 1], conic[:, 1, 1]], dim=1) + garbage[:, None]
    return radii[None], (screen + garbage[:, None])[None], (z + garbage)[None], conics[None], None


@torch.no_grad()
def isect_tiles(
    means2d, radii, depths, tile_size, tile_width, tile_height, sort=True, segmented=False, packed=False,
    n_images=None, image_ids=None, gaussian_ids=None,
):  # fmt: skip
    assert radii.dtype == torch.int32
    pairs = []
    for i in torch.nonzero(radii[0].amin(dim=1) > 0)[:, 0].tolist():
        low = ((means2d[0, i] - radii[0, i]) / tile_size).floor().clamp_min(0).int().tolist()
        high = ((means2d[0, i] + radii[0, i]) / tile_size).ceil().int().tolist()
        for y in range(low[1], min(high[1], tile_height)):
            for x in range(low[0], min(high[0], tile_width)):
                pairs.append((y * tile_width + x, float(depths[0, i]), i))
    pairs.sort()
    keys = torch.tensor([tile for tile, _, _ in pairs], dtype=torch.int64)
    return None, keys, torch.tensor([i for _, _, i in pairs], dtype=torch.int32)


def isect_offset_encode(isect_ids, n_images, tile_width, tile_height):
    tiles = torch.arange(n_images * tile_width * tile_height)
    return torch.searchsorted(isect_ids, tiles).int().reshape(n_images, tile_height, tile_width)


def rasterize_to_pixels(
    means2d, conics, colors, opacities, image_width, image_height, tile_size, isect_offsets, flatten_ids,
    backgrounds=None, masks=None, packed=False, absgrad=False,
):  # fmt: skip
    _, rows, columns = isect_offsets.shape
    starts = [*isect_offsets.flatten().tolist(), len(flatten_ids)]
    image = means2d.new_zeros(image_height, image_width, colors.shape[-1])
    alphas = means2d.new_zeros(image_height, image_width, 1)
    for tile in range(rows * columns):
        here = flatten_ids[starts[tile] : starts[tile + 1]].long()
        top, left = tile // columns * tile_size, tile % columns * tile_size
        y, x = torch.meshgrid(
            torch.arange(top, min(top + tile_size, image_height)) + 0.5,
            torch.arange(left, min(left + tile_size, image_width)) + 0.5,
            indexing="ij",
        )
        dx = means2d[0, here, 0, None, None] - x
        dy = means2d[0, here, 1, None, None] - y
        a, b, c = (conics[0, here, k, None, None] for k in range(3))
        sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        alpha = (opacities[0, here, None, None] * torch.exp(-sigma)).clamp_max(0.999)
        alpha = torch.where((sigma >= 0) & (alpha >= 1 / 255), alpha, 0.0)
        after = (1 - alpha).cumprod(0)
        before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
        weight = torch.where(after > 1e-4, alpha * before, 0.0)
        span = (slice(top, top + tile_size), slice(left, left + tile_size))
        image[span] = torch.einsum("nyx,nc->yxc", weight, colors[0, here])
        alphas[span] = weight.sum(0)[..., None]
    return image[None], alphas[None]


def spherical_harmonics(degrees_to_use, dirs, coeffs, masks=None):
    return evaluate_sh_reference(coeffs[:, :1], coeffs[:, 1:], dirs, torch.zeros(3), degrees_to_use)


INTERFACE = (
    fully_fused_projection,
    isect_tiles,
    isect_offset_encode,
    rasterize_to_pixels,
    spherical_harmonics,
)


@pytest.fixture
def plain_gsplat(monkeypatch):
    module = types.ModuleType("gsplat")
    for function in INTERFACE:
        setattr(module, function.__name__, function)
    monkeypatch.setitem(sys.modules, "gsplat", module)


def test_the_stand_in_has_gsplats_signatures():
    gsplat = pytest.importorskip("gsplat")
    for function in INTERFACE:
        real = inspect.signature(getattr(gsplat, function.__name__))
        assert list(inspect.signature(function).parameters) == list(real.parameters)


# -- the adapter ---------------------------------------------------------------------------------------------


def scene(count=150, channels=6, seed=0):
    """Gaussians around, before, behind and beside a camera that looks down −Z."""
    rng = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=rng) * torch.tensor([2.0, 2.0, 1.5]) - torch.tensor([0, 0, 3.0])
    return {
        "means": means,
        "quaternions": torch.randn(count, 4, generator=rng),
        "scales": 0.05 + 0.3 * torch.rand(count, 3, generator=rng),
        "opacities": 0.999 * torch.rand(count, generator=rng),
        "colours": torch.rand(count, channels, generator=rng),
        "screen_offsets": torch.zeros(count, 2),
    }


def draw(function, tensors, camera):
    leaves = {name: t.clone().requires_grad_() for name, t in tensors.items()}
    offsets = leaves.pop("screen_offsets")
    drawn = function(*leaves.values(), camera, screen_offsets=offsets)
    weight = torch.rand(drawn.image.shape, generator=torch.Generator().manual_seed(1))
    ((drawn.image * weight).sum() + drawn.alpha.square().sum()).backward()
    leaves["screen_offsets"] = offsets
    return drawn, {name: t.grad for name, t in leaves.items() if t.grad is not None}


@pytest.mark.parametrize("channels", [3, 6, 10])
def test_the_adapter_draws_the_contracts_picture(plain_gsplat, channels):
    tensors = scene(channels=channels)
    camera = Camera(np.eye(4), 37, 29, 30.0, 33.0, 17.0, 16.0)
    drawn, gradients = draw(cuda.rasterize, tensors, camera)
    expected, expected_gradients = draw(reference.rasterize, tensors, camera)
    assert expected.alpha.max() > 0.9  # there is something to see
    assert (expected.radii == 0).sum() > 5  # and something that is not drawn
    torch.testing.assert_close(drawn.image, expected.image, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(drawn.alpha, expected.alpha, rtol=1e-4, atol=1e-5)
    assert drawn.image.is_contiguous()
    for name, gradient in expected_gradients.items():
        error = (gradients[name] - gradient).norm() / gradient.norm()
        assert error < 1e-4, f"{name}: {error:.1e}"


def test_radii_are_the_contracts_rounded_up(plain_gsplat):
    tensors = scene()
    camera = Camera(np.eye(4), 37, 29, 30.0, 33.0, 17.0, 16.0)
    drawn, _ = draw(cuda.rasterize, tensors, camera)
    expected, _ = draw(reference.rasterize, tensors, camera)
    both = (drawn.radii > 0) & (expected.radii > 0)
    torch.testing.assert_close(drawn.radii[both], expected.radii[both].ceil())
    # One more may count as drawn, beside the screen; none less.
    assert (drawn.radii[expected.radii > 0] > 0).all()


def test_no_gaussian_at_all_never_reaches_gsplat(plain_gsplat):
    camera = Camera(np.eye(4), 5, 4, 5.0, 5.0, 2.5, 2.0)
    drawn, gradients = draw(cuda.rasterize, scene(count=0), camera)
    assert drawn.image.shape == (6, 4, 5) and not drawn.image.any() and not drawn.alpha.any()
    assert gradients["means"].shape == (0, 3)


def test_spherical_harmonics_go_to_gsplat_in_its_layout(plain_gsplat):
    rng = torch.Generator().manual_seed(2)
    dc, rest = torch.randn(9, 1, 3, generator=rng), torch.randn(9, 15, 3, generator=rng)
    means, viewpoint = torch.randn(9, 3, generator=rng), torch.tensor([0.5, -1.0, 2.0])
    for degree in (1, 2, 3):
        value = cuda.evaluate_sh(dc, rest, means, viewpoint, degree)
        expected = evaluate_sh_reference(dc, rest, means, viewpoint, degree)
        torch.testing.assert_close(value, expected, rtol=1e-5, atol=1e-5)


def test_trying_out_finds_kernels_that_draw_wrongly(plain_gsplat, monkeypatch):
    assert try_out(cuda.rasterize, torch.device("cpu")) < 1e-4
    monkeypatch.setattr(sys.modules["gsplat"], "rasterize_to_pixels", _dimmed)
    assert try_out(cuda.rasterize, torch.device("cpu")) > 1e-3


def _dimmed(*arguments, **named):
    image, alpha = rasterize_to_pixels(*arguments, **named)
    return 0.9 * image, alpha


# -- compiling ---------------------------------------------------------------------------------------------


def test_a_compiled_twin_takes_any_number_of_points(monkeypatch):
    """Dynamo alone ("eager"): what is tested is that one compiled copy serves all sizes, and its results."""
    monkeypatch.setattr(compiled, "BACKEND", "eager")
    rng = torch.Generator().manual_seed(3)
    weights = [torch.randn(3, 8, generator=rng) for _ in range(3)] + [torch.randn(3, generator=rng)]
    twin = curve_mlp_reference.__wrapped__
    copy = compiled.compiled(twin, "test")
    for points in (40, 41, 1):
        x = torch.randn(3, points, generator=rng)
        torch.testing.assert_close(copy(x, *weights, "softplus"), twin(x, *weights, "softplus"))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a card")
def test_where_nothing_can_be_compiled_a_warning_says_so():
    with pytest.warns(UserWarning, match=r"torch\.compile does not work here .*networks run unfused"):
        assert not compiled._works.__wrapped__()
