# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract on the CPU: Numba kernels with explicit SIMD, float32, exact gradients.

``projection`` (and its backward) → ``binning`` (depth order, tile lists) → ``tiles`` (and their backward);
``simd`` is the vocabulary of the kernels, ``threads`` runs them. Bit-identical for any number of threads.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch.nn import functional

from ....bridge.errors import BadValueError
from ...scene.camera import Camera
from ...simd import LANES, ranges, run_parallel, run_ranges, set_threads, thread_count
from ..contract import Rasterization, refuse_too_many_pairs, refuse_what_is_not_finite
from .binning import fill_lists
from .projection import RECORD_HEAD, TILE_HEIGHT, TILE_WIDTH, camera_array, project, project_backward
from .tiles import BLOCK_HEIGHT, BLOCK_WIDTH, MOMENTS, draw, draw_backward

__all__ = ["rasterize", "set_threads", "thread_count"]

#: Pairs of a picture: what an int32 counts.
MOST_PAIRS = (1 << 31) - 1

#: What gradients are taken of, as ``_Rasterize`` takes them.
NAMES = ("means", "quaternions", "scales", "opacities", "colours", "screen_offsets")


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    screen_offsets: torch.Tensor | None = None,
) -> Rasterization:
    """See ``rasterize.rasterize``. Float32 tensors on the CPU.

    Raises ``BadValueError`` for other tensors, and where one has a NaN or an infinity in it.
    """
    values = (means, quaternions, scales, opacities, colours, screen_offsets)
    tensors = dict(zip(NAMES, values, strict=True))
    for name, tensor in tensors.items():
        if tensor is not None and (tensor.dtype != torch.float32 or tensor.device.type != "cpu"):
            raise BadValueError(
                f"{name} must be float32 on the CPU here, got {tensor.dtype} on {tensor.device}",
                "Convert it, or choose the implementation 'reference' (any dtype) or 'cuda'.",
            )
    image, alpha, radii = _Rasterize.apply(camera, *tensors.values())
    return Rasterization(image, alpha, radii)


class _Drawing(NamedTuple):
    """What the backward pass needs of a forward pass, flat arrays (see the kernels for their meaning)."""

    camera: np.ndarray
    tile_order: np.ndarray
    tile_starts: np.ndarray
    tile_gaussians: np.ndarray
    tile_slots: np.ndarray
    records: np.ndarray
    stride: int
    slot_starts: np.ndarray
    entry_blocks: np.ndarray


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, camera: Camera, *tensors: torch.Tensor | None):
        tensors = tuple(None if t is None else t.detach().contiguous() for t in tensors)
        keep = any(ctx.needs_input_grad)
        image, alpha, radii, drawing = _draw(camera, tensors, keep)
        ctx.mark_non_differentiable(radii)
        ctx.set_materialize_grads(False)
        if keep:
            ctx.drawing = drawing
            ctx.save_for_backward(image, alpha, *tensors[:4])
        width, height = camera.width, camera.height
        return image[:, :height, :width].contiguous(), alpha[:height, :width].contiguous(), radii

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        grad_image, grad_alpha, _ = grads
        image, alpha, *geometry = ctx.saved_tensors
        grad_image = torch.zeros_like(image) if grad_image is None else _in_whole_blocks(grad_image)
        grad_alpha = torch.zeros_like(alpha) if grad_alpha is None else _in_whole_blocks(grad_alpha)
        gradients = _draw_backward(ctx.drawing, image, alpha, grad_image, grad_alpha, geometry)
        wanted = zip(gradients, ctx.needs_input_grad[1:], strict=True)
        return None, *(gradient if needed else None for gradient, needed in wanted)


def _flat(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().numpy().reshape(-1)


def _whole_blocks(width: int, height: int) -> tuple[int, int]:
    """The size of an image that is not cut by its border in the middle of a block."""
    return -(-width // BLOCK_WIDTH) * BLOCK_WIDTH, -(-height // BLOCK_HEIGHT) * BLOCK_HEIGHT


def _in_whole_blocks(planes: torch.Tensor) -> torch.Tensor:
    """``planes`` ``[…, H, W]``, contiguous, with zeros at the right and below up to whole blocks."""
    height, width = planes.shape[-2:]
    whole_width, whole_height = _whole_blocks(width, height)
    return functional.pad(planes, (0, whole_width - width, 0, whole_height - height)).contiguous()


def _draw(camera: Camera, tensors: tuple[Any, ...], keep: bool):
    """(image, alpha, radii, drawing or None) of contiguous tensors; ``keep``: for a backward pass.

    Image and alpha are as large as ``_whole_blocks`` says.
    """
    *geometry, colours, offsets = tensors
    count, channels = colours.shape
    width, height = camera.width, camera.height
    tiles_x, tiles_y = -(-width // TILE_WIDTH), -(-height // TILE_HEIGHT)
    tiles = tiles_x * tiles_y
    whole_width, whole_height = size = _whole_blocks(width, height)
    image, alpha = torch.empty(channels, whole_height, whole_width), torch.empty(whole_height, whole_width)
    radii = torch.empty(count)

    view = camera_array(camera)
    stride = RECORD_HEAD + -(-channels // 8) * 8
    records = np.empty((count + LANES) * stride, np.float32)
    keys, slot_starts = np.empty(count, np.int32), np.empty(count + 1, np.int32)
    edges = ranges(count)
    finite = np.ones(1, np.bool_)
    flat = [_flat(t) for t in geometry]
    flat += [np.empty(0, np.float32) if offsets is None else _flat(offsets), _flat(colours)]

    def project_part(part: int, slot_tiles: np.ndarray):
        histogram = np.zeros(tiles, np.int32)
        pairs = project(
            *(edges[part], edges[part + 1], *flat, channels, view, tiles_x, records, stride, keys),
            *(_flat(radii), slot_starts, slot_tiles, histogram, finite),
        )
        return pairs, slot_tiles[:pairs], histogram

    # Most Gaussians touch one or two tiles; where that is too few, the part is done again.
    parts = run_parallel(lambda i: project_part(i, np.empty(2 * (edges[i + 1] - edges[i]) + 64, np.int32)))
    needed = [pairs for pairs, _, _ in parts]
    refuse_too_many_pairs(count, sum(needed), MOST_PAIRS)
    whole = [tiles_of_part.size == pairs for pairs, tiles_of_part, _ in parts]
    if not all(whole):
        tried = parts
        parts = run_parallel(
            lambda i: tried[i] if whole[i] else project_part(i, np.empty(needed[i], np.int32))
        )
    if not finite[0] or not _all_finite(colours):
        refuse_what_is_not_finite(dict(zip(NAMES, tensors, strict=True)))
    slot_tiles = np.concatenate([tiles_of_part for _, tiles_of_part, _ in parts])
    before = 0
    for pairs, first, last in zip(needed, edges, edges[1:], strict=False):
        slot_starts[first:last] += before
        before += pairs
    slot_starts[count] = pairs = before
    per_tile = np.sum([histogram for _, _, histogram in parts], axis=0)
    tile_starts = np.zeros(tiles + 1, np.int64)
    np.cumsum(per_tile, out=tile_starts[1:])

    tile_gaussians = np.empty(pairs, np.int32)
    tile_slots = np.empty(pairs if keep else 0, np.int32)
    # Ranges of tiles with about as many pairs.
    shares = np.searchsorted(tile_starts, np.linspace(0, pairs, thread_count() + 1)[1:-1])
    bounds = [0, *shares, tiles]
    scratch = np.empty((thread_count(), 4, count), np.int32)
    run_parallel(
        lambda i: fill_lists(
            *(bounds[i], bounds[i + 1], keys, slot_starts, slot_tiles, tile_starts),
            *(scratch[i], tile_gaussians, tile_slots),
        )
    )

    # The longest lists first, so that no thread is left with one at the end.
    tile_order = np.argsort(-per_tile, kind="stable")
    entry_blocks = np.zeros(pairs if keep else 0, np.uint64)
    counter = np.zeros(1, np.int64)
    lists = (tile_order, tile_starts, tile_gaussians)
    targets = ((0,) * channels, _flat(image), _flat(alpha), entry_blocks)
    run_parallel(lambda _: draw(counter, *lists, records, stride, *size, tiles_x, *targets))
    if not keep:
        return image, alpha, radii, None
    drawing = _Drawing(view, *lists, tile_slots, records, stride, slot_starts, entry_blocks)
    return image, alpha, radii, drawing


def _draw_backward(drawing: _Drawing, image, alpha, grad_image, grad_alpha, geometry) -> list[torch.Tensor]:
    """Gradients of means, quaternions, scales, opacities, colours and screen offsets."""
    channels, height, width = image.shape
    count, pairs = geometry[0].shape[0], drawing.entry_blocks.size
    slot_size = -(-(MOMENTS + channels) // LANES) * LANES
    slots, slot_drawn = np.empty(pairs * slot_size, np.float32), np.zeros(pairs, np.uint8)
    counter = np.zeros(1, np.int64)
    marker = (0,) * channels
    planes = [_flat(t) for t in (image, alpha, grad_image, grad_alpha)]
    run_parallel(
        lambda _: draw_backward(
            *(counter, drawing.tile_order, drawing.tile_starts, drawing.tile_gaussians, drawing.tile_slots),
            *(drawing.records, drawing.stride, width, height, -(-width // TILE_WIDTH)),
            *(marker, *planes, drawing.entry_blocks, slots, slot_size, slot_drawn),
        )
    )
    gradients = [torch.empty(count, *shape) for shape in ((3,), (4,), (3,), (), (channels,), (2,))]
    outputs = [_flat(gradients[i]) for i in (0, 1, 2, 3, 5, 4)]
    run_ranges(
        *(project_backward, count, *(_flat(t) for t in geometry), drawing.camera, drawing.slot_starts),
        *(slots, slot_size, slot_drawn, channels, *outputs),
    )
    return gradients


def _all_finite(tensor: torch.Tensor) -> bool:
    # A sum of zeros unless something is NaN or infinite: one pass, no temporary of booleans.
    return bool(torch.isfinite(tensor.sum())) or bool(torch.isfinite(tensor).all())
