# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussian at each pixel's median: walks the lists of ``tiles.draw`` until half of the light is gone."""

import numpy as np
import torch

from ....bridge.splatting import ALPHA_MIN
from ...scene.camera import Camera
from ...simd import kernel, run_parallel, take_ticket
from ..contract import MEDIAN_TRANSMITTANCE
from . import _draw
from .projection import TILE_HEIGHT, TILE_WIDTH
from .weights import alpha_at, block_of


def median_gaussian(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    camera: Camera,
) -> torch.Tensor:
    """As the reference's, of float32 tensors on the CPU."""
    count = means.shape[0]
    geometry = [each.detach().contiguous() for each in (means, quaternions, scales, opacities)]
    *_, drawing = _draw(camera, (*geometry, torch.zeros(count, 1), None), True)
    assert drawing is not None  # it was asked to keep it
    found = np.full((camera.height, camera.width), -1, np.int32)
    counter = np.zeros(1, np.int64)
    lists = drawing.tile_order, drawing.tile_starts, drawing.tile_gaussians, drawing.entry_blocks
    run_parallel(
        lambda _: walk(counter, *lists, drawing.records, drawing.stride, found.reshape(-1), camera.width)
    )
    return torch.from_numpy(found).long()


@kernel
def walk(counter, tile_order, tile_starts, tile_gaussians, entry_blocks, records, stride, found, width):
    """Fill ``found`` ``[H · W]`` int32 with the Gaussians that bring pixels to a half, where there is one.

    Other arguments as of ``tiles.draw_backward``.
    """
    height = found.size // width
    tiles_x = -(-width // TILE_WIDTH)
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        for row in range(top, min(top + TILE_HEIGHT, height)):
            for column in range(left, min(left + TILE_WIDTH, width)):
                block = block_of(column - left, row - top)
                x, y = np.float32(column + 0.5), np.float32(row + 0.5)
                through = np.float32(1.0)
                for entry in range(tile_starts[tile], tile_starts[tile + 1]):
                    if not (entry_blocks[entry] >> block) & np.uint64(1):
                        continue
                    g = tile_gaussians[entry]
                    alpha = alpha_at(records, g * stride, x, y)
                    if alpha < np.float32(ALPHA_MIN):
                        continue
                    through *= np.float32(1.0) - alpha
                    if through <= np.float32(MEDIAN_TRANSMITTANCE):
                        found[row * width + column] = g
                        break
