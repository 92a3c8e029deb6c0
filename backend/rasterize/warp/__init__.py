# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract in NVIDIA Warp: CUDA cards with nothing but their driver, and the same kernels on the CPU.

``projection`` (and its backward) → ``lists`` (torch's sorts) → ``tiles`` (and their backward), any number of
channels. Warp compiles them at their first use, with what its wheel brings: LLVM for the CPU, NVRTC for
cards. On the CPU it is an order slower than the Numba kernels: there it runs to be tested.

Against ``contract.py``: nothing differs, but that a tensor with a NaN or an infinity is refused on the CPU
only, where looking costs nothing; on a card such a Gaussian is not drawn. Gradients are added by atomics,
whose order differs from run to run on a card, unless ``torch.use_deterministic_algorithms(True)`` is in
force: then every (Gaussian, tile) pair has a row of its own, and rows are added in their order. That takes
4 (6 + C) bytes a pair, 48 for six channels, written once and read once, and blocks of 256 threads that wait
for one another.

The host waits for a card once, for the number of (Gaussian, tile) pairs.
"""

from typing import Any, NamedTuple

import torch

from ....bridge.errors import BadValueError
from ...scene.camera import Camera
from ..contract import Rasterization, refuse_what_is_not_finite
from .arrays import array, launch, wp
from .lists import Lists, make_lists
from .projection import RECORD_HEAD, TILE, View, add_pairs, project, project_backward, view_of
from .tiles import (
    MOMENTS,
    TILE_PIXELS,
    WARP,
    draw_backward_kernel,
    draw_kernel,
    record_rows,
    sums_of,
    sums_type,
)

__all__ = ["MOST_CHANNELS", "rasterize"]

#: Channels of a pass; more are drawn in several. Each takes backward five registers (docs/cuda.md).
MOST_CHANNELS = 32


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    screen_offsets: torch.Tensor | None = None,
    absolute_offsets: torch.Tensor | None = None,
) -> Rasterization:
    """See ``rasterize.rasterize``. Float32 tensors on one device, a CUDA card or the CPU.

    Raises ``BadValueError`` for other tensors, and on the CPU where one has a NaN or an infinity in it.
    """
    tensors = {
        "means": means,
        "quaternions": quaternions,
        "scales": scales,
        "opacities": opacities,
        "colours": colours,
        "screen_offsets": screen_offsets,
        "absolute_offsets": absolute_offsets,
    }
    for name, tensor in tensors.items():
        if tensor is None:
            continue
        if tensor.dtype != torch.float32 or tensor.device != means.device:
            raise BadValueError(
                f"{name} must be float32 on {means.device} here, got {tensor.dtype} on {tensor.device}",
                "Convert it, or choose the implementation 'reference' (any dtype).",
            )
    if means.device.type == "cpu":
        refuse_what_is_not_finite(tensors)
    if absolute_offsets is not None and colours.shape[1] > MOST_CHANNELS:
        raise BadValueError(
            f"absolute_offsets are for {MOST_CHANNELS} channels at most, got {colours.shape[1]}",
            "Draw in several passes: absolute values of parts do not add up to those of the whole.",
        )
    if screen_offsets is None:
        screen_offsets = means.new_zeros(len(means), 2)
    geometry = (means, quaternions, scales, opacities)
    rest = (screen_offsets, absolute_offsets)
    passes = [
        _Rasterize.apply(camera, *geometry, part, *rest) for part in colours.split(MOST_CHANNELS, dim=1)
    ]
    image, alpha, radii = passes[0]
    if len(passes) > 1:
        image = torch.cat([part for part, _, _ in passes])
    return Rasterization(image, alpha, radii)


class _Drawing(NamedTuple):
    """What the backward pass needs of a forward pass and is neither its input nor its output."""

    view: View
    lists: Lists
    tiles_x: int
    records: torch.Tensor
    radii: torch.Tensor
    ends: torch.Tensor


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, camera: Camera, *tensors: torch.Tensor | None):
        *inputs, _ = (None if t is None else t.detach().contiguous() for t in tensors)
        image, alpha, drawing = _draw(camera, inputs)
        # Not the same tensor: an output in ctx, but for what is saved, is a cycle that only gc frees.
        radii = drawing.radii.clone()
        ctx.mark_non_differentiable(radii)
        ctx.set_materialize_grads(False)
        if any(ctx.needs_input_grad):
            ctx.drawing = drawing
            ctx.save_for_backward(image, alpha, *inputs[:4])
        return image, alpha, radii

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        grad_image, grad_alpha, _ = grads
        image, alpha, *geometry = ctx.saved_tensors
        grad_image = torch.zeros_like(image) if grad_image is None else grad_image.contiguous()
        grad_alpha = torch.zeros_like(alpha) if grad_alpha is None else grad_alpha.contiguous()
        absolute = ctx.needs_input_grad[7]
        gradients = _draw_backward(ctx.drawing, absolute, image, alpha, grad_image, grad_alpha, geometry)
        wanted = zip(gradients, ctx.needs_input_grad[1:], strict=True)
        return None, *(gradient if needed else None for gradient, needed in wanted)


def _draw(camera: Camera, tensors: list[Any]) -> tuple[torch.Tensor, torch.Tensor, _Drawing]:
    means, quaternions, scales, opacities, colours, offsets = tensors
    count, channels = colours.shape
    width, height, device = camera.width, camera.height, means.device
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    tiles = tiles_x * tiles_y
    view = view_of(camera)
    rows = record_rows(channels)
    records = means.new_empty(count, 4 * rows)
    records[:, RECORD_HEAD : RECORD_HEAD + channels] = colours
    depths, radii = means.new_empty(count), means.new_empty(count)
    counts = means.new_empty(count, dtype=torch.int32)
    launch(
        project,
        count,
        [
            *(array(means, wp.vec3), array(quaternions, wp.vec4), array(scales, wp.vec3)),
            *(array(opacities, wp.float32), array(offsets, wp.vec2), view, array(records, wp.float32)),
            *(array(depths, wp.float32), array(radii, wp.float32), array(counts, wp.int32)),
        ],
        device,
    )
    lists = make_lists(depths, counts, records, view, tiles_x, tiles)
    image, alpha = means.new_empty(channels, height, width), means.new_empty(height, width)
    ends = means.new_empty(height, width, dtype=torch.int32)
    launch(
        draw_kernel(channels),
        tiles * TILE_PIXELS,
        [
            *(array(lists.tile_starts, wp.int32), array(lists.gaussians, wp.int32)),
            *(array(records.view(-1, 4), wp.vec4), width, height, tiles_x),
            *(array(image, wp.float32), array(alpha, wp.float32), array(ends, wp.int32)),
        ],
        device,
    )
    return image, alpha, _Drawing(view, lists, tiles_x, records, radii, ends)


def _draw_backward(
    drawing: _Drawing, absolute: bool, image, alpha, grad_image, grad_alpha, geometry
) -> list[torch.Tensor | None]:
    """Gradients of means, quaternions, scales, opacities, colours, screen offsets and absolute offsets."""
    means, quaternions, scales, opacities = geometry
    (channels, height, width), count, device = image.shape, len(means), means.device
    lists = drawing.lists
    ordered = torch.are_deterministic_algorithms_enabled()
    size = sums_of(channels, absolute)
    sums = means.new_zeros(count, size)
    into = means.new_zeros(len(lists.gaussians), size) if ordered else sums
    launch(
        draw_backward_kernel(channels, absolute),
        (len(lists.tile_starts) - 1) * TILE_PIXELS if len(lists.gaussians) else 0,
        [
            *(array(lists.tile_starts, wp.int32), array(lists.gaussians, wp.int32)),
            array(lists.numbers if ordered else lists.gaussians, wp.int32),
            *(array(drawing.records.view(-1, 4), wp.vec4), width, height, drawing.tiles_x),
            *(array(image, wp.float32), array(alpha, wp.float32), array(drawing.ends, wp.int32)),
            *(array(grad_image, wp.float32), array(grad_alpha, wp.float32)),
            array(into, sums_type(channels, absolute)),
        ],
        device,
        # A tile's pixels in one block: each pair has one author.
        TILE_PIXELS if ordered else WARP,
    )
    if ordered:
        _add_pairs(lists, into, sums)
    gradients = [means.new_empty(count, *shape) for shape in ((3,), (4,), (3,), (), (2,))]
    types = (wp.vec3, wp.vec4, wp.vec3, wp.float32, wp.vec2)
    launch(
        project_backward,
        count,
        [
            *(array(means, wp.vec3), array(quaternions, wp.vec4), array(scales, wp.vec3)),
            *(array(opacities, wp.float32), array(drawing.radii, wp.float32), drawing.view),
            array(sums, wp.float32),
            *(array(gradient, dtype) for gradient, dtype in zip(gradients, types, strict=True)),
        ],
        device,
    )
    *of_geometry, of_offsets = gradients
    of_colours = sums[:, MOMENTS : MOMENTS + channels].contiguous()
    of_absolute = sums[:, MOMENTS + channels :].contiguous() if absolute else None
    return [*of_geometry, of_colours, of_offsets, of_absolute]


def _add_pairs(lists: Lists, of_pairs: torch.Tensor, sums: torch.Tensor) -> None:
    launch(
        add_pairs,
        (len(sums), sums.shape[1]),
        [
            *(array(lists.order, wp.int64), array(lists.counts, wp.int32), array(lists.ends, wp.int64)),
            *(array(of_pairs, wp.float32), array(sums, wp.float32)),
        ],
        sums.device,
    )
