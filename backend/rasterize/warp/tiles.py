# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""The pixels: a thread each. One Warp module for each number of channels, compiled at its first use.

A tile is 16 × 16 pixels, and threads are numbered so that 32 of them are 8 × 4 pixels. ``draw`` needs nothing
of other threads. ``draw_backward`` sums over the threads of its block by tile operations, whatever the
block's size is: 32 on a card (shuffles alone), 256 where every sum is to have one author, 1 on the CPU unless
``wp.config.enable_cpu_blocks`` runs a block's threads as fibers.

Every thread of a block must reach every tile operation: no ``return``, ``break`` or ``continue`` stands
before one, and what bounds a loop around one is the same for all. A test reads the source for the first, and
mutants show that fibers notice the second.
"""

# In kernels float(0.0) is a variable and 0.0 a constant, which no loop may change.
# ruff: noqa: RUF046, UP018

from functools import cache
from typing import Any

from ....bridge.splatting import ALPHA_MAX, TRANSMITTANCE_MIN
from .arrays import load4, wp
from .projection import LOG_ALPHA_MIN, RECORD_HEAD, TILE

TILE_PIXELS = TILE * TILE
#: Threads of a block of ``draw_backward``: a warp, whose sums need no barrier.
WARP = 32
#: Gradients before the colours': Σ v, Σ v dx, Σ v dy, Σ v dx², Σ v dx dy, Σ v dy² (v = ∂L/∂ ln alpha).
MOMENTS = 6


def record_rows(channels: int) -> int:
    """How many times four floats a record with so many colours has."""
    return -(-(RECORD_HEAD + channels) // 4)


@wp.func
def pixel_of(thread: int, tiles_x: int):
    """Tile, column and row of a thread's pixel."""
    tile = thread // TILE_PIXELS
    lane = thread % TILE_PIXELS
    part = lane // 32
    inner = lane % 32
    x = (tile % tiles_x) * TILE + (part % 2) * 8 + inner % 8
    y = (tile // tiles_x) * TILE + (part // 2) * 4 + inner // 8
    return tile, x, y


@cache
def draw_kernel(channels: int) -> Any:
    """The forward pass for so many channels."""
    Colour = wp.types.vector(channels, wp.float32)
    C, ROWS = channels, record_rows(channels)

    @wp.kernel(enable_backward=False, module=f"physhdr_draw_{channels}", grid_stride=False)
    def draw(
        tile_starts: wp.array[int],
        gaussians: wp.array[int],
        records: wp.array[wp.vec4],
        width: int,
        height: int,
        tiles_x: int,
        image: wp.array3d[float],
        alpha: wp.array2d[float],
        ends: wp.array2d[int],
    ):
        """Front to back; all threads of a block read the same Gaussian at a time.

        ``ends``: one past the last entry of the tile's list that the pixel took.
        """
        tile, x, y = pixel_of(wp.tid(), tiles_x)
        if x >= width or y >= height:
            return
        px = float(x) + 0.5
        py = float(y) + 0.5
        begin = tile_starts[tile]
        T = float(1.0)
        total = Colour()
        end = int(begin)
        for i in range(begin, tile_starts[tile + 1]):
            at = gaussians[i] * ROWS
            head = load4(records, at)  # mean x, mean y, l11, l21
            more = load4(records, at + 1)  # q, bias, the first two colours
            dx = px - head[0]
            dy = py - head[1]
            u = head[2] * dx + head[3] * dy
            power = more[1] - u * u - more[0] * dy * dy
            if power >= LOG_ALPHA_MIN:
                a = wp.min(wp.exp(power), ALPHA_MAX)
                after = T - a * T
                if after <= TRANSMITTANCE_MIN:
                    break
                weight = a * T
                for c in range(wp.static(min(C, 2))):
                    total[c] += weight * more[2 + c]
                for row in range(2, ROWS):
                    four = load4(records, at + row)
                    for k in range(4):
                        if 4 * row + k - RECORD_HEAD < C:
                            total[4 * row + k - RECORD_HEAD] += weight * four[k]
                T = after
                end = i + 1
        for c in range(C):
            image[c, y, x] = total[c]
        alpha[y, x] = 1.0 - T
        ends[y, x] = end

    return draw


@cache
def draw_backward_kernel(channels: int) -> Any:
    """The backward pass for so many channels."""
    Colour = wp.types.vector(channels, wp.float32)
    Sums = sums_type(channels)
    C, ROWS = channels, record_rows(channels)
    name = f"physhdr_draw_backward_{channels}"

    @wp.kernel(enable_backward=False, module=name, grid_stride=False)
    def draw_backward(
        tile_starts: wp.array[int],
        gaussians: wp.array[int],
        targets: wp.array[int],
        records: wp.array[wp.vec4],
        width: int,
        height: int,
        tiles_x: int,
        image: wp.array3d[float],
        alpha: wp.array2d[float],
        ends: wp.array2d[int],
        grad_image: wp.array3d[float],
        grad_alpha: wp.array2d[float],
        sums: wp.array[Sums],
    ):
        """Add the moments and the colours' gradients of entry i of a tile's list to ``sums[targets[i]]``.

        Front to back as well, so that the transmittance is the forward pass's to the bit: what is behind is
        the pixel's total less what has been passed. Threads outside the picture take part with zeros.
        """
        tile, x, y = pixel_of(wp.tid(), tiles_x)
        px = float(x) + 0.5
        py = float(y) + 0.5
        begin = tile_starts[tile]
        end = int(begin)
        rest = float(0.0)
        grad_a = float(0.0)
        grad = Colour()
        if x < width and y < height:
            end = ends[y, x]
            grad_a = grad_alpha[y, x]
            rest = grad_a * alpha[y, x]
            for c in range(C):
                grad[c] = grad_image[c, y, x]
                rest += grad[c] * image[c, y, x]
        last = wp.tile_max(wp.tile(end))[0]
        T = float(1.0)
        for i in range(begin, last):
            at = gaussians[i] * ROWS
            head = load4(records, at)
            more = load4(records, at + 1)
            dx = px - head[0]
            dy = py - head[1]
            u = head[2] * dx + head[3] * dy
            power = more[1] - u * u - more[0] * dy * dy
            mine = int(0)
            if i < end and power >= LOG_ALPHA_MIN:
                mine = 1
            # Most entries miss most warps: one vote instead of a sum for each number.
            if wp.tile_max(wp.tile(mine))[0] > 0:
                part = Sums()
                if mine > 0:
                    e = wp.exp(power)
                    a = wp.min(e, ALPHA_MAX)
                    weight = a * T
                    q = grad_a
                    for c in range(wp.static(min(C, 2))):
                        q += grad[c] * more[2 + c]
                        part[MOMENTS + c] = weight * grad[c]
                    for row in range(2, ROWS):
                        four = load4(records, at + row)
                        for k in range(4):
                            if 4 * row + k - RECORD_HEAD < C:
                                q += grad[4 * row + k - RECORD_HEAD] * four[k]
                                part[MOMENTS + 4 * row + k - RECORD_HEAD] = (
                                    weight * grad[4 * row + k - RECORD_HEAD]
                                )
                    rest -= weight * q
                    if e <= ALPHA_MAX:
                        v = a * (T * q - rest / (1.0 - a))
                        part[0] = v
                        part[1] = v * dx
                        part[2] = v * dy
                        part[3] = v * dx * dx
                        part[4] = v * dx * dy
                        part[5] = v * dy * dy
                    T -= weight
                whole = wp.tile_sum(wp.tile(part, preserve_type=True))
                wp.tile_atomic_add(sums, whole, offset=targets[i])

    return draw_backward


def sums_type(channels: int) -> Any:
    """A Gaussian's sums: moments and the colours' gradients."""
    return wp.types.vector(MOMENTS + channels, wp.float32)
