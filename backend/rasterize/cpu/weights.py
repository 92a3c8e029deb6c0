# SPDX-License-Identifier: GPL-3.0-or-later
"""What of each Gaussian's colour is in a pixel: the weights of blending, as a sparse matrix.

A picture is linear in the colours of its Gaussians, image_p = Σ_i w_pi c_i, with w = alpha T of
``tiles.draw``. Where shapes stay as they are and only colours change, these weights are found once and every
further picture, and its gradient, is a product.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numba import njit

from ....bridge.splatting import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from ...scene.camera import Camera
from ...simd import kernel, run_parallel, take_ticket
from . import _draw
from .projection import BIAS, L11, L21, MEAN_X, MEAN_Y, TILE_HEIGHT, TILE_WIDTH, Q
from .tiles import BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_X


@dataclass(frozen=True, eq=False)
class BlendWeights:
    """Row p of the matrix is ``weights[starts[p] : starts[p + 1]]``, of ``gaussians`` at the same places.

    ``starts`` ``[P + 1]`` int64; ``gaussians`` ``[W]`` int32, nearest first; ``weights`` ``[W]`` float32.
    """

    starts: np.ndarray
    gaussians: np.ndarray
    weights: np.ndarray


def blend_weights(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    camera: Camera,
    pixels: np.ndarray,
) -> BlendWeights:
    """The weights of ``pixels`` ``[P]`` (y · width + x, rising) of what ``rasterize`` would draw of these.

    Raises what ``rasterize`` raises.
    """
    count = means.shape[0]
    tensors = (means, quaternions, scales, opacities, torch.zeros(count, 1), None)
    *_, drawing = _draw(camera, tuple(None if t is None else t.detach().contiguous() for t in tensors), True)
    assert drawing is not None  # it was asked to keep it
    tiles_x = -(-camera.width // TILE_WIDTH)
    y, x = np.divmod(pixels, camera.width)
    tile = y // TILE_HEIGHT * tiles_x + x // TILE_WIDTH
    by_tile = np.argsort(tile, kind="stable")
    tile_pixels = np.searchsorted(tile[by_tile], np.arange(drawing.tile_starts.size))
    lists = drawing.tile_starts, drawing.tile_gaussians, drawing.entry_blocks
    where = by_tile, tile_pixels, x.astype(np.float32), y.astype(np.float32), tiles_x
    lengths = np.zeros(pixels.size, np.int64)
    nothing = np.empty(0, np.int64), np.empty(0, np.int32), np.empty(0, np.float32)

    def walk(starts: np.ndarray, gaussians: np.ndarray, weights: np.ndarray) -> None:
        counter = np.zeros(1, np.int64)
        run_parallel(
            lambda _: collect(
                *(counter, drawing.tile_order, *lists, drawing.records, drawing.stride, *where),
                *(lengths, starts, gaussians, weights),
            )
        )

    walk(*nothing)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    found = BlendWeights(starts, np.empty(starts[-1], np.int32), np.empty(starts[-1], np.float32))
    walk(found.starts, found.gaussians, found.weights)
    return found


@njit(error_model="numpy")
def block_of(column, row):
    """The bit of a pixel's block in ``entry_blocks``, by its place in the tile."""
    return np.uint64(row // BLOCK_HEIGHT * BLOCKS_X + column // BLOCK_WIDTH)


@njit(error_model="numpy")
def alpha_at(records, here, x, y):
    """A Gaussian's alpha at a point on the screen, by its record at ``here``; not 0 below ``ALPHA_MIN``."""
    dx, dy = x - records[here + MEAN_X], y - records[here + MEAN_Y]
    u = records[here + L11] * dx + records[here + L21] * dy
    t = records[here + BIAS] - u * u - records[here + Q] * dy * dy
    return min(np.float32(2.0) ** (np.float32(8.0) * t), np.float32(ALPHA_MAX))


@kernel
def collect(
    counter,
    tile_order,
    tile_starts,
    tile_gaussians,
    entry_blocks,
    records,
    stride,
    by_tile,
    tile_pixels,
    pixel_x,
    pixel_y,
    tiles_x,
    lengths,
    starts,
    gaussians,
    weights,
):
    """Walk the lists of the tiles whose turn it is for each of their pixels, as ``tiles.draw`` does.

    ``by_tile[tile_pixels[t] : tile_pixels[t + 1]]`` are the pixels of tile t. Where ``starts`` is empty only
    ``lengths`` ``[P]`` is written, else ``gaussians`` and ``weights`` from ``starts[p]`` on.
    """
    counting = starts.size == 0
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        for at in range(tile_pixels[tile], tile_pixels[tile + 1]):
            p = by_tile[at]
            x, y = pixel_x[p] + np.float32(0.5), pixel_y[p] + np.float32(0.5)
            block = block_of(int(pixel_x[p]) - left, int(pixel_y[p]) - top)
            through = np.float32(1.0)
            found = 0
            for entry in range(tile_starts[tile], tile_starts[tile + 1]):
                if not (entry_blocks[entry] >> block) & np.uint64(1):
                    continue
                g = tile_gaussians[entry]
                alpha = alpha_at(records, g * stride, x, y)
                if alpha < np.float32(ALPHA_MIN):
                    continue
                after = through * (np.float32(1.0) - alpha)
                if after <= np.float32(TRANSMITTANCE_MIN):
                    break
                if not counting:
                    gaussians[starts[p] + found] = g
                    weights[starts[p] + found] = alpha * through
                found += 1
                through = after
            if counting:
                lengths[p] = found
