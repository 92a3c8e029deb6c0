# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract on the CPU: Numba kernels with explicit SIMD, float32, exact gradients.

``projection`` (and its backward) → ``binning`` (depth order, tile lists) → ``tiles`` (and their backward);
``simd`` is the vocabulary of the kernels, ``threads`` runs them. Bit-identical for any number of threads.
"""

from typing import Any, NamedTuple

import numpy as np
import torch

from ....bridge.errors import BadValueError
from ...scene.camera import Camera
from ..contract import Rasterization
from .binning import NEAR, RECORD_HEAD, TILE_HEIGHT, TILE_WIDTH, fill, gather, sort_by_depth
from .projection import FOOTPRINT, camera_array, project, project_backward
from .simd import LANES
from .threads import run_parallel, run_ranges, set_threads, thread_count
from .tiles import draw, draw_backward

__all__ = ["rasterize", "set_threads", "thread_count"]

MOMENTS = 6  # floats in a slot before the colours' gradients


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
    tensors = {
        "means": means,
        "quaternions": quaternions,
        "scales": scales,
        "opacities": opacities,
        "colours": colours,
        "screen_offsets": screen_offsets,
    }
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
    image_size: tuple[int, int, int]
    tile_order: np.ndarray
    tile_starts: np.ndarray
    tile_ranks: np.ndarray
    tile_slots: np.ndarray
    records: np.ndarray
    stride: int
    slot_starts: np.ndarray
    slot_blocks: np.ndarray


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
        return image, alpha, radii

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        grad_image, grad_alpha, _ = grads
        image, alpha, *geometry = ctx.saved_tensors
        grad_image = torch.zeros_like(image) if grad_image is None else grad_image.contiguous()
        grad_alpha = torch.zeros_like(alpha) if grad_alpha is None else grad_alpha.contiguous()
        gradients = _draw_backward(ctx.drawing, image, alpha, grad_image, grad_alpha, geometry)
        wanted = zip(gradients, ctx.needs_input_grad[1:], strict=True)
        return None, *(gradient if needed else None for gradient, needed in wanted)


def _flat(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().numpy().reshape(-1)


def _draw(camera: Camera, tensors: tuple[Any, ...], keep: bool):
    """(image, alpha, radii, drawing or None) of contiguous tensors; ``keep``: for a backward pass."""
    means, quaternions, scales, opacities, colours, offsets = tensors
    count, channels = colours.shape
    width, height = camera.width, camera.height
    image = torch.empty(channels, height, width)
    alpha = torch.empty(height, width)
    radii = torch.empty(count)

    view = camera_array(camera)
    footprints = np.empty(FOOTPRINT * count, np.float32)
    keys = np.empty(count, np.uint32)
    finite = np.ones(1, np.bool_)
    flat_offsets = np.empty(0, np.float32) if offsets is None else _flat(offsets)
    geometry = [_flat(t) for t in (means, quaternions, scales, opacities)]
    run_ranges(project, count, *geometry, flat_offsets, view, footprints, keys, _flat(radii), finite)
    if not finite[0] or not _all_finite(colours):
        _refuse(tensors)

    order, scratch_keys, scratch_order = (
        np.empty(count, np.int32),
        np.empty_like(keys),
        np.empty(count, np.int32),
    )
    drawn = sort_by_depth(keys, order, scratch_keys, scratch_order)
    order = order[:drawn]

    # Tile lists: a histogram for every worker's part of the order, then everybody's cursors.
    tiles_x, tiles_y = -(-width // TILE_WIDTH), -(-height // TILE_HEIGHT)
    tiles, workers = tiles_x * tiles_y, thread_count()
    stride = RECORD_HEAD + -(-channels // 8) * 8
    records = np.empty(drawn * stride, np.float32)
    touched = np.zeros(count + 1, np.int64)
    counts, near_tiles = np.empty(drawn, np.int32), np.empty(NEAR * drawn, np.int32)
    histograms = np.zeros((workers, tiles), np.int64)
    edges = np.linspace(0, drawn, workers + 1).astype(np.int64)
    flat_colours = _flat(colours)
    run_parallel(
        lambda i: gather(
            *(edges[i], edges[i + 1], order, footprints, flat_colours, channels, width, height, tiles_x),
            *(records, stride, touched, histograms[i], counts, near_tiles),
        )
    )
    per_tile = histograms.sum(0)
    tile_starts = np.zeros(tiles + 1, np.int64)
    np.cumsum(per_tile, out=tile_starts[1:])
    cursors = tile_starts[:-1] + np.cumsum(histograms, 0) - histograms
    pairs = int(tile_starts[-1])
    tile_ranks = np.empty(pairs, np.int32)
    tile_slots = np.empty(pairs if keep else 0, np.int32)
    slot_starts = np.zeros(count + 1 if keep else 0, np.int64)
    if keep:
        np.cumsum(touched[:-1], out=slot_starts[1:])
    run_parallel(
        lambda i: fill(
            *(edges[i], edges[i + 1], order, footprints, width, height, tiles_x, counts, near_tiles),
            *(cursors[i], slot_starts, tile_ranks, tile_slots),
        )
    )

    # The longest lists first, so that no thread is left with one at the end.
    tile_order = np.argsort(-per_tile, kind="stable")
    slot_blocks = np.zeros(pairs if keep else 0, np.uint64)
    counter = np.zeros(1, np.int64)
    marker = (0,) * channels
    run_parallel(
        lambda _: draw(
            *(
                counter,
                tile_order,
                tile_starts,
                tile_ranks,
                tile_slots,
                records,
                stride,
                width,
                height,
                tiles_x,
            ),
            *(marker, _flat(image), _flat(alpha), slot_blocks),
        )
    )
    if not keep:
        return image, alpha, radii, None
    size = (channels, height, width)
    drawing = _Drawing(
        view, size, tile_order, tile_starts, tile_ranks, tile_slots, records, stride, slot_starts, slot_blocks
    )
    return image, alpha, radii, drawing


def _draw_backward(drawing: _Drawing, image, alpha, grad_image, grad_alpha, geometry) -> list[torch.Tensor]:
    """Gradients of means, quaternions, scales, opacities, colours and screen offsets."""
    channels, height, width = drawing.image_size
    count = geometry[0].shape[0]
    slot_size = -(-(MOMENTS + channels) // LANES) * LANES
    slots = np.empty(drawing.slot_blocks.size * slot_size, np.float32)
    counter = np.zeros(1, np.int64)
    marker = (0,) * channels
    planes = [_flat(t) for t in (image, alpha, grad_image, grad_alpha)]
    run_parallel(
        lambda _: draw_backward(
            *(counter, drawing.tile_order, drawing.tile_starts, drawing.tile_ranks, drawing.tile_slots),
            *(drawing.records, drawing.stride, width, height, -(-width // TILE_WIDTH)),
            *(marker, *planes, drawing.slot_blocks, slots, slot_size),
        )
    )
    gradients = [torch.empty(count, *shape) for shape in ((3,), (4,), (3,), (), (channels,), (2,))]
    outputs = [_flat(gradients[i]) for i in (0, 1, 2, 3, 5, 4)]
    run_ranges(
        *(project_backward, count, *(_flat(t) for t in geometry), drawing.camera, drawing.slot_starts),
        *(slots, slot_size, drawing.slot_blocks, channels, *outputs),
    )
    return gradients


def _all_finite(tensor: torch.Tensor) -> bool:
    # A sum of zeros unless something is NaN or infinite: one pass, no temporary of booleans.
    return bool(torch.isfinite(tensor.sum())) or bool(torch.isfinite(tensor).all())


def _refuse(tensors: tuple[torch.Tensor | None, ...]) -> None:
    """Say which tensor is not finite."""
    names = ("means", "quaternions", "scales", "opacities", "colours", "screen_offsets")
    for name, tensor in zip(names, tensors, strict=True):
        if tensor is not None and not torch.isfinite(tensor).all():
            row = int((~torch.isfinite(tensor)).nonzero()[0, 0])
            raise BadValueError(
                f"{name}[{row}] of the Gaussians is not finite: {tensor[row].tolist()}",
                "Training diverged or a model file is damaged: lower the learning rates, or load another.",
            )
