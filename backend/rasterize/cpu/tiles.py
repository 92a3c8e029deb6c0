# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing tiles, and the gradient of that.

A tile is 64 blocks of ``LANES`` pixels; a vector holds one block. A Gaussian visits only the blocks that its
ellipse {alpha ≥ 1/255} reaches and that are not finished, which are the bits of one uint64. All state of
a tile (transmittance, channels) lies in a scratch array of a few KiB, so it stays in the L1 cache.

Forward, front to back, for pixel p and Gaussian i (``t`` as in projection.py):

    alpha = min(0.999, 2^(8 t)),  0 below 1/255      after = T (1 − alpha)
    if after > 1e-4:   C += alpha T c_i,   T = after      else: the pixel is finished

A finished pixel is marked by the sign of its T: it then fails ``after > 1e-4`` for ever.

Backward, in the *same* order, so that T is recomputed exactly and no list per pixel is kept. With g the
gradient of the pixel (``g_A`` that of its coverage Σ alpha T), q_i = ⟨c_i, g⟩ + g_A and w = alpha T:

    rest_i = ⟨C, g⟩ + A g_A − Σ_{j ≤ i} w_j q_j        (what lies behind Gaussian i)
    ∂L/∂alpha_i = T q_i − rest_i / (1 − alpha_i)       v = alpha ∂L/∂alpha = ∂L/∂(ln alpha)

v is 0 where alpha was clamped. Per Gaussian and tile, Σ v and its moments about the Gaussian's mean, and
Σ w g (the colours' gradient), go into a slot of the pair's own: no atomics, and sums in a fixed order.
"""

import numpy as np
from numba import njit

from ..contract import ALPHA_MAX, TRANSMITTANCE_MIN
from .binning import MARGIN, RECORD_HEAD, RELATIVE_MARGIN, T_MIN, TILE_HEIGHT, TILE_WIDTH
from .projection import BIAS, INVERSE_L11, L11, L21, MEAN_X, MEAN_Y, Q
from .simd import (
    LANES,
    absolute,
    any_lane,
    ceil,
    dot_each,
    exp2_of_8,
    floor,
    fma,
    fma_each,
    lane_numbers,
    load,
    load_each,
    lowest_bit,
    maximum,
    minimum,
    prefetch,
    select,
    span_bits,
    splat,
    splat_each,
    square_root,
    store,
    store_each,
    store_totals,
    take_ticket,
    zero_each,
)

BLOCK_WIDTH = LANES // 2
BLOCK_HEIGHT = 2
BLOCKS_X = TILE_WIDTH // BLOCK_WIDTH
BLOCKS_Y = TILE_HEIGHT // BLOCK_HEIGHT
BLOCKS = BLOCKS_X * BLOCKS_Y
assert BLOCKS_X <= 8 and BLOCKS_Y == 8, "block (x, y) is bit 8 y + x of a uint64"

#: How many Gaussians ahead their records are fetched; measured, flat between 2 and 8.
AHEAD = 4

_ONE = np.uint64(1)
_ZERO = np.uint64(0)


@njit(error_model="numpy")
def _blocks(mean_x, mean_y, bias, l21, q, inverse_l11, group_rows):
    """The blocks of a tile that {alpha ≥ 1/255} reaches; the mean is relative to the tile's corner.

    Lane g is the g-th row of blocks, whose pixel rows are ``group_rows`` + 0.5 and + 1.5. On a row, the
    ellipse's edges are mean_x − s dy ± √(R − q dy²)/l₁₁ (see binning.py).
    """
    extent = splat((bias - T_MIN) * 1.00001)
    slope = splat(-l21 * inverse_l11)
    left, right = splat(1e9), splat(-1e9)
    for j in range(BLOCK_HEIGHT):
        dy = group_rows + (j + np.float32(0.5) - mean_y)
        under_root = fma(-(q * dy), dy, extent)
        centre = fma(slope, dy, splat(mean_x))
        half = square_root(maximum(under_root, 0.0)) * inverse_l11
        half = half + (absolute(centre) + half) * RELATIVE_MARGIN + MARGIN
        reached = under_root >= 0.0
        left = minimum(left, select(reached, centre - half, 1e9))
        right = maximum(right, select(reached, centre + half, -1e9))
    # First and last pixel whose centre lies between, then the blocks that hold them.
    first = floor(ceil(left - 0.5) * (1.0 / BLOCK_WIDTH))
    last = floor(floor(right - 0.5) * (1.0 / BLOCK_WIDTH)) + 1.0
    first = minimum(maximum(first, 0.0), float(BLOCKS_X))
    last = minimum(maximum(last, 0.0), float(BLOCKS_X))
    return span_bits(first, last)


@njit
def _lane_columns():
    """x of each lane's pixel centre within a block."""
    lane = lane_numbers()
    return lane - floor(lane * (1.0 / BLOCK_WIDTH)) * float(BLOCK_WIDTH) + 0.5


@njit
def _lane_rows():
    """y of each lane's pixel centre within a block."""
    return floor(lane_numbers() * (1.0 / BLOCK_WIDTH)) + 0.5


@njit
def _read_tile(image, plane, width, height, left, top, state, offset, step, outside):
    """Copy a tile of one plane of a planar image to ``state[offset + block · step :]``, block by block."""
    for row in range(TILE_HEIGHT):
        y = top + row
        for block_x in range(BLOCKS_X):
            block = (row // BLOCK_HEIGHT) * BLOCKS_X + block_x
            to = offset + block * step + (row % BLOCK_HEIGHT) * BLOCK_WIDTH
            x = left + block_x * BLOCK_WIDTH
            at = (plane * height + y) * width + x
            if y < height and x + BLOCK_WIDTH <= width:
                for i in range(BLOCK_WIDTH):
                    state[to + i] = image[at + i]
            else:
                for i in range(BLOCK_WIDTH):
                    state[to + i] = image[at + i] if y < height and x + i < width else outside


@njit
def _write_tile(image, plane, width, height, left, top, state, offset, step):
    """The way back of ``_read_tile``."""
    for row in range(min(TILE_HEIGHT, height - top)):
        for block_x in range(BLOCKS_X):
            block = (row // BLOCK_HEIGHT) * BLOCKS_X + block_x
            from_ = offset + block * step + (row % BLOCK_HEIGHT) * BLOCK_WIDTH
            x = left + block_x * BLOCK_WIDTH
            at = (plane * height + top + row) * width + x
            if x + BLOCK_WIDTH <= width:
                for i in range(BLOCK_WIDTH):
                    image[at + i] = state[from_ + i]
            else:
                for i in range(width - x):
                    image[at + i] = state[from_ + i]


@njit
def _start_tile(width, height, left, top, state, step):
    """Set T of every block: 1 inside the image, −1 (finished) outside. Returns the blocks with pixels."""
    alive = _ZERO
    for block in range(BLOCKS):
        x, y = left + block % BLOCKS_X * BLOCK_WIDTH, top + block // BLOCKS_X * BLOCK_HEIGHT
        for i in range(LANES):
            inside = x + i % BLOCK_WIDTH < width and y + i // BLOCK_WIDTH < height
            state[block * step + i] = 1.0 if inside else -1.0
        if x < width and y < height:
            alive |= _ONE << np.uint64(block // BLOCKS_X * 8 + block % BLOCKS_X)
    return alive


@njit(nogil=True, cache=True, error_model="numpy")
def draw(counter, tile_order, tile_starts, tile_ranks, tile_slots, records, stride, width, height, tiles_x,
         channels, image, alpha, slot_blocks):  # fmt: skip
    """Draw the tiles whose turn it is: tickets of ``counter`` index ``tile_order``.

    ``channels``: a tuple as long as there are channels (its type is what counts). Out, flat: ``image``
    ``[C · H · W]``, ``alpha`` ``[H · W]``; unless its size is 0, ``slot_blocks[slot]`` (zero before): the
    blocks to which the (Gaussian, tile) pair contributed.
    """
    step = (1 + len(channels)) * LANES
    state = np.empty(BLOCKS * step, np.float32)
    columns, rows = _lane_columns(), _lane_rows()
    group_rows = lane_numbers() * float(BLOCK_HEIGHT)
    keep_blocks = slot_blocks.size > 0
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        state[:] = 0.0
        alive = _start_tile(width, height, left, top, state, step)
        end = tile_starts[tile + 1]
        for entry in range(tile_starts[tile], end):
            prefetch(records, tile_ranks[min(entry + AHEAD, end - 1)] * stride)
            at = tile_ranks[entry] * stride
            mean_x, mean_y = records[at + MEAN_X] - left, records[at + MEAN_Y] - top
            scalar_l11, scalar_l21 = records[at + L11], records[at + L21]
            blocks = alive & _blocks(
                mean_x,
                mean_y,
                records[at + BIAS],
                scalar_l21,
                records[at + Q],
                records[at + INVERSE_L11],
                group_rows,
            )
            if blocks == _ZERO:
                continue
            l11, l21, minus_q = splat(scalar_l11), splat(scalar_l21), splat(-records[at + Q])
            bias = splat(records[at + BIAS])
            lane_x, lane_y = columns - mean_x, rows - mean_y
            colours = splat_each(channels, records, at + RECORD_HEAD)
            contributed = _ZERO
            while blocks != _ZERO:
                bit = lowest_bit(blocks)
                blocks &= blocks - _ONE
                here = ((bit >> 3) * BLOCKS_X + (bit & 7)) * step
                dx = lane_x + np.float32((bit & 7) * BLOCK_WIDTH)
                dy = lane_y + np.float32((bit >> 3) * BLOCK_HEIGHT)
                u = fma(l11, dx, l21 * dy)
                t = fma(-u, u, fma(minus_q, dy * dy, bias))
                a = minimum(exp2_of_8(t), ALPHA_MAX)
                seen = t >= T_MIN
                a = select(seen, a, 0.0)
                T = load(state, here)
                after = fma(-a, T, T)
                goes_on = after > TRANSMITTANCE_MIN
                weight = select(goes_on, a * T, 0.0)
                T = select(goes_on, after, -absolute(T))
                store(T, state, here)
                drawn = load_each(channels, state, here + LANES, LANES)
                store_each(fma_each(weight, colours, drawn), state, here + LANES, LANES)
                if keep_blocks and any_lane(goes_on & seen):
                    contributed |= _ONE << np.uint64(bit)
                if not any_lane(T > 0.0):
                    alive &= ~(_ONE << np.uint64(bit))
            if keep_blocks:
                slot_blocks[tile_slots[entry]] = contributed
            if alive == _ZERO:
                break
        for block in range(BLOCKS):
            store(1.0 - absolute(load(state, block * step)), state, block * step)
        _write_tile(alpha, 0, width, height, left, top, state, 0, step)
        for c in range(len(channels)):
            _write_tile(image, c, width, height, left, top, state, (1 + c) * LANES, step)


@njit(nogil=True, cache=True, error_model="numpy")
def draw_backward(counter, tile_order, tile_starts, tile_ranks, tile_slots, records, stride, width, height, tiles_x,
                  channels, image, alpha, grad_image, grad_alpha, slot_blocks,
                  slots, slot_size):  # fmt: skip
    """Fill ``slots[slot_size · slot :]`` of every pair with ``slot_blocks[slot] != 0``: see above.

    Arguments as of ``draw``; ``image`` and ``alpha`` as it drew them.
    """
    step = (3 + len(channels)) * LANES  # T, rest, g_A, g …
    state = np.empty(BLOCKS * step, np.float32)
    columns, rows = _lane_columns(), _lane_rows()
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        # rest = ⟨C, g⟩ + A g_A, with each plane of C passing through T's place.
        _read_tile(grad_alpha, 0, width, height, left, top, state, 2 * LANES, step, 0.0)
        _read_tile(alpha, 0, width, height, left, top, state, 0, step, 0.0)
        for here in range(0, BLOCKS * step, step):
            store(load(state, here) * load(state, here + 2 * LANES), state, here + LANES)
        for c in range(len(channels)):
            _read_tile(grad_image, c, width, height, left, top, state, (3 + c) * LANES, step, 0.0)
            _read_tile(image, c, width, height, left, top, state, 0, step, 0.0)
            for here in range(0, BLOCKS * step, step):
                rest = fma(load(state, here), load(state, here + (3 + c) * LANES), load(state, here + LANES))
                store(rest, state, here + LANES)
        _start_tile(width, height, left, top, state, step)

        end = tile_starts[tile + 1]
        for entry in range(tile_starts[tile], end):
            prefetch(records, tile_ranks[min(entry + AHEAD, end - 1)] * stride)
            slot = tile_slots[entry]
            blocks = slot_blocks[slot]
            if blocks == _ZERO:
                continue
            at = tile_ranks[entry] * stride
            l11, l21, minus_q = splat(records[at + L11]), splat(records[at + L21]), splat(-records[at + Q])
            bias = splat(records[at + BIAS])
            lane_x, lane_y = columns - (records[at + MEAN_X] - left), rows - (records[at + MEAN_Y] - top)
            colours = splat_each(channels, records, at + RECORD_HEAD)
            sum_v, sum_x, sum_y = splat(0.0), splat(0.0), splat(0.0)
            sum_xx, sum_xy, sum_yy = splat(0.0), splat(0.0), splat(0.0)
            grad_colours = zero_each(channels)
            while blocks != _ZERO:
                bit = lowest_bit(blocks)
                blocks &= blocks - _ONE
                here = ((bit >> 3) * BLOCKS_X + (bit & 7)) * step
                dx = lane_x + np.float32((bit & 7) * BLOCK_WIDTH)
                dy = lane_y + np.float32((bit >> 3) * BLOCK_HEIGHT)
                u = fma(l11, dx, l21 * dy)
                t = fma(-u, u, fma(minus_q, dy * dy, bias))
                unclamped = exp2_of_8(t)
                a = select(t >= T_MIN, minimum(unclamped, ALPHA_MAX), 0.0)
                T = load(state, here)
                after = fma(-a, T, T)
                goes_on = after > TRANSMITTANCE_MIN
                weight = select(goes_on, a * T, 0.0)
                store(select(goes_on, after, -absolute(T)), state, here)
                g = load_each(channels, state, here + 3 * LANES, LANES)
                q = dot_each(colours, g, load(state, here + 2 * LANES))
                rest = fma(-weight, q, load(state, here + LANES))
                store(rest, state, here + LANES)
                grad_a = fma(T, q, -rest / (1.0 - a))
                v = select(goes_on & (unclamped <= ALPHA_MAX), a * grad_a, 0.0)
                vx, vy = v * dx, v * dy
                sum_v, sum_x, sum_y = sum_v + v, sum_x + vx, sum_y + vy
                sum_xx, sum_xy, sum_yy = fma(vx, dx, sum_xx), fma(vx, dy, sum_xy), fma(vy, dy, sum_yy)
                grad_colours = fma_each(weight, g, grad_colours)
            sums = (sum_v, sum_x, sum_y, sum_xx, sum_xy, sum_yy) + grad_colours
            store_totals(sums, slots, slot * slot_size)
