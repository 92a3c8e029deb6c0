# SPDX-License-Identifier: GPL-3.0-or-later
"""The four stages of a picture: ``project`` → ``draw`` → ``draw_backward`` → ``project_backward``.

What goes from one to the next is numbers alone: to ``draw`` records, depths and counts of tiles, back a row
of sums for each Gaussian. Only the outer two know what Gaussians are made of; who draws a view need not own
them (lab/scale.md).
"""

from typing import NamedTuple

import torch

from ...scene.camera import Camera
from . import projection
from .arrays import Array, launch, wp
from .lists import Lists, make_lists
from .projection import RECORD_HEAD, TILE, view_of
from .tiles import (
    MOMENTS,
    TILE_PIXELS,
    WARP,
    draw_backward_kernel,
    draw_kernel,
    record_rows,
    sums_type,
)


class Projected(NamedTuple):
    """Gaussians on a camera's screen: ``records`` ``[N, 4 R]``, ``depths`` ``[N]`` (∞: not drawn), ``radii``
    ``[N]`` in pixels, and how many tiles each touches, ``counts`` ``[N]`` int32."""

    records: torch.Tensor
    depths: torch.Tensor
    radii: torch.Tensor
    counts: torch.Tensor


class Drawn(NamedTuple):
    """A picture ``[C, H, W]``, its coverage ``[H, W]``, and what it was made of."""

    image: torch.Tensor
    alpha: torch.Tensor
    lists: Lists
    tiles_x: int
    records: torch.Tensor
    ends: torch.Tensor


class Gradients(NamedTuple):
    """Of every tensor that ``rasterize`` takes."""

    means: torch.Tensor
    quaternions: torch.Tensor
    scales: torch.Tensor
    opacities: torch.Tensor
    colours: torch.Tensor
    offsets: torch.Tensor


def project(
    camera: Camera,
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    offsets: torch.Tensor,
) -> Projected:
    """Gaussians as ``rasterize`` has them, contiguous; ``offsets`` ``[N, 2]`` on the screen in pixels."""
    count, channels = colours.shape
    records = means.new_empty(count, 4 * record_rows(channels))
    records[:, RECORD_HEAD : RECORD_HEAD + channels] = colours
    depths, radii = means.new_empty(count), means.new_empty(count)
    counts = means.new_empty(count, dtype=torch.int32)
    launch(
        projection.project,
        count,
        [
            *(Array(means, wp.vec3), Array(quaternions, wp.vec4), Array(scales, wp.vec3)),
            *(Array(opacities, wp.float32), Array(offsets, wp.vec2), view_of(camera)),
            *(Array(records, wp.float32), Array(depths, wp.float32)),
            *(Array(radii, wp.float32), Array(counts, wp.int32)),
        ],
        means.device,
    )
    return Projected(records, depths, radii, counts)


def draw(camera: Camera, seen: Projected, channels: int) -> Drawn:
    """The picture of what was projected. The host waits for the device once (``make_lists``)."""
    records, depths, _, counts = seen
    width, height, device = camera.width, camera.height, records.device
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    tiles = tiles_x * tiles_y
    lists = make_lists(depths, counts, records, view_of(camera), tiles_x, tiles)
    image, alpha = records.new_empty(channels, height, width), records.new_empty(height, width)
    ends = records.new_empty(height, width, dtype=torch.int32)
    launch(
        draw_kernel(channels),
        tiles * TILE_PIXELS,
        [
            *(Array(lists.tile_starts, wp.int32), Array(lists.gaussians, wp.int32)),
            *(Array(records.view(-1, 4), wp.vec4), width, height, tiles_x),
            *(Array(image, wp.float32), Array(alpha, wp.float32), Array(ends, wp.int32)),
        ],
        device,
    )
    return Drawn(image, alpha, lists, tiles_x, records, ends)


def draw_backward(drawn: Drawn, grad_image: torch.Tensor, grad_alpha: torch.Tensor) -> torch.Tensor:
    """Moments and gradients of colours of each Gaussian that was projected, ``[N, MOMENTS + C]``."""
    image, alpha, lists, tiles_x, records, ends = drawn
    channels, height, width = image.shape
    ordered = torch.are_deterministic_algorithms_enabled()
    size = MOMENTS + channels
    sums = records.new_zeros(len(records), size)
    into = records.new_zeros(len(lists.gaussians), size) if ordered else sums
    launch(
        draw_backward_kernel(channels),
        (len(lists.tile_starts) - 1) * TILE_PIXELS if len(lists.gaussians) else 0,
        [
            *(Array(lists.tile_starts, wp.int32), Array(lists.gaussians, wp.int32)),
            Array(lists.numbers if ordered else lists.gaussians, wp.int32),
            *(Array(records.view(-1, 4), wp.vec4), width, height, tiles_x),
            *(Array(image, wp.float32), Array(alpha, wp.float32), Array(ends, wp.int32)),
            *(Array(grad_image, wp.float32), Array(grad_alpha, wp.float32)),
            Array(into, sums_type(channels)),
        ],
        records.device,
        # A tile's pixels in one block: each pair has one author.
        TILE_PIXELS if ordered else WARP,
    )
    if ordered:
        launch(
            projection.add_pairs,
            (len(sums), size),
            [
                *(Array(lists.order, wp.int64), Array(lists.counts, wp.int32), Array(lists.ends, wp.int64)),
                *(Array(into, wp.float32), Array(sums, wp.float32)),
            ],
            sums.device,
        )
    return sums


def project_backward(
    camera: Camera,
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    radii: torch.Tensor,
    sums: torch.Tensor,
) -> Gradients:
    """From ``draw_backward``'s sums to the inputs of ``project``."""
    count = len(means)
    made = [means.new_empty(count, *shape) for shape in ((3,), (4,), (3,), (), (2,))]
    types = (wp.vec3, wp.vec4, wp.vec3, wp.float32, wp.vec2)
    launch(
        projection.project_backward,
        count,
        [
            *(Array(means, wp.vec3), Array(quaternions, wp.vec4), Array(scales, wp.vec3)),
            *(Array(opacities, wp.float32), Array(radii, wp.float32), view_of(camera)),
            Array(sums, wp.float32),
            *(Array(gradient, dtype) for gradient, dtype in zip(made, types, strict=True)),
        ],
        means.device,
    )
    of_means, of_quaternions, of_scales, of_opacities, of_offsets = made
    of_colours = sums[:, MOMENTS:].contiguous()
    return Gradients(of_means, of_quaternions, of_scales, of_opacities, of_colours, of_offsets)
