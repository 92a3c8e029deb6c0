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
from .compiling import kernel
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
    load_halves,
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
    store_halves,
    store_totals,
    take_ticket,
    zero_each,
)

BLOCK_WIDTH = LANES // 2
BLOCK_HEIGHT = 2
BLOCKS_X = TILE_WIDTH // BLOCK_WIDTH
BLOCKS_Y = TILE_HEIGHT // BLOCK_HEIGHT
BLOCKS = BLOCKS_X * BLOCKS_Y
assert BLOCKS_X == 8 and BLOCKS_Y == 8, "block (x, y) is bit 8 y + x of a uint64"

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
def _block_corners():
    """x and y of every block's corner in its tile, by bit.

    Tables, because converting an integer in the inner loop (vcvtsi2ss) makes every block wait for the one
    before: the instruction depends on the old value of its target register. Measured: about 10 % slower.
    """
    bits = np.arange(BLOCKS + 1)
    return (bits % 8 * BLOCK_WIDTH).astype(np.float32), (bits // 8 * BLOCK_HEIGHT).astype(np.float32)


@njit
def _exponent(l11, l21, minus_q, bias, dx, dy):
    """t: alpha is 2^(8 t)."""
    u = fma(l11, dx, l21 * dy)
    return fma(-u, u, fma(minus_q, dy * dy, bias))


@njit
def _read_edge_block(image, at, x, y, width, height, pixels):
    """A block of a plane that the image's border cuts, zero outside; ``at``: its pixel (x, y)."""
    for i in range(LANES):
        inside = x + i % BLOCK_WIDTH < width and y + i // BLOCK_WIDTH < height
        pixels[i] = image[at + i // BLOCK_WIDTH * width + i % BLOCK_WIDTH] if inside else 0.0
    return load(pixels, 0)


@njit
def _write_edge_block(value, image, at, x, y, width, height, pixels):
    """The way back of ``_read_edge_block``."""
    store(value, pixels, 0)
    for i in range(LANES):
        if x + i % BLOCK_WIDTH < width and y + i // BLOCK_WIDTH < height:
            image[at + i // BLOCK_WIDTH * width + i % BLOCK_WIDTH] = pixels[i]


@njit
def _start_tile(width, height, left, top, state, step):
    """Set T of every block: 1 inside the image, −1 (finished) outside. Returns the blocks with pixels."""
    state[BLOCKS * step : BLOCKS * step + LANES] = -1.0  # the spare block
    alive = _ZERO
    for block in range(BLOCKS):
        x, y = left + block % BLOCKS_X * BLOCK_WIDTH, top + block // BLOCKS_X * BLOCK_HEIGHT
        if x < width and y < height:
            alive |= _ONE << np.uint64(block)
        if x + BLOCK_WIDTH <= width and y + BLOCK_HEIGHT <= height:
            store(splat(1.0), state, block * step)
        else:
            for i in range(LANES):
                inside = x + i % BLOCK_WIDTH < width and y + i // BLOCK_WIDTH < height
                state[block * step + i] = 1.0 if inside else -1.0
    return alive


@kernel
def draw(
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
    channels,
    image,
    alpha,
    slot_blocks,
):
    """Draw the tiles whose turn it is: tickets of ``counter`` index ``tile_order``.

    ``channels``: a tuple as long as there are channels (its type is what counts). Out, flat: ``image``
    ``[C · H · W]``, ``alpha`` ``[H · W]``; unless its size is 0, ``slot_blocks[slot]`` (zero before): the
    blocks that the (Gaussian, tile) pair visited.
    """
    step = (1 + len(channels)) * LANES
    state = np.zeros((BLOCKS + 1) * step, np.float32)
    edge = np.empty(LANES, np.float32)
    columns, rows = _lane_columns(), _lane_rows()
    corner_x, corner_y = _block_corners()
    group_rows = lane_numbers() * float(BLOCK_HEIGHT)
    keep_blocks = slot_blocks.size > 0
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        left_f, top_f = np.float32(left), np.float32(top)
        state[: BLOCKS * step] = 0.0
        alive = _start_tile(width, height, left, top, state, step)
        end = tile_starts[tile + 1]
        for entry in range(tile_starts[tile], end):
            prefetch(records, tile_ranks[min(entry + AHEAD, end - 1)] * stride)
            at = tile_ranks[entry] * stride
            mean_x, mean_y = records[at + MEAN_X] - left_f, records[at + MEAN_Y] - top_f
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
            if keep_blocks:
                slot_blocks[tile_slots[entry]] = blocks
            while blocks != _ZERO:
                # Two blocks at a time; an odd one out is paired with the spare block, which is finished.
                bit0 = lowest_bit(blocks)
                blocks &= blocks - _ONE
                bit1 = lowest_bit(blocks)
                blocks &= blocks - _ONE
                here0, here1 = bit0 * step, bit1 * step
                dx0, dy0 = lane_x + corner_x[bit0], lane_y + corner_y[bit0]
                dx1, dy1 = lane_x + corner_x[bit1], lane_y + corner_y[bit1]
                t0, t1 = (
                    _exponent(l11, l21, minus_q, bias, dx0, dy0),
                    _exponent(l11, l21, minus_q, bias, dx1, dy1),
                )
                T0, T1 = load(state, here0), load(state, here1)
                a0 = select(t0 >= T_MIN, minimum(exp2_of_8(t0), ALPHA_MAX), 0.0)
                a1 = select(t1 >= T_MIN, minimum(exp2_of_8(t1), ALPHA_MAX), 0.0)
                after0, after1 = fma(-a0, T0, T0), fma(-a1, T1, T1)
                on0, on1 = after0 > TRANSMITTANCE_MIN, after1 > TRANSMITTANCE_MIN
                weight0, weight1 = select(on0, a0 * T0, 0.0), select(on1, a1 * T1, 0.0)
                T0, T1 = select(on0, after0, -absolute(T0)), select(on1, after1, -absolute(T1))
                store(T0, state, here0)
                store(T1, state, here1)
                drawn0 = fma_each(weight0, colours, load_each(channels, state, here0 + LANES, LANES))
                drawn1 = fma_each(weight1, colours, load_each(channels, state, here1 + LANES, LANES))
                store_each(drawn0, state, here0 + LANES, LANES)
                store_each(drawn1, state, here1 + LANES, LANES)
                if not any_lane(T0 > 0.0):
                    alive &= ~(_ONE << np.uint64(bit0))
                if bit1 < BLOCKS and not any_lane(T1 > 0.0):
                    alive &= ~(_ONE << np.uint64(bit1))
            if alive == _ZERO:
                break
        for block in range(BLOCKS):
            x, y = left + block % BLOCKS_X * BLOCK_WIDTH, top + block // BLOCKS_X * BLOCK_HEIGHT
            if x >= width or y >= height:
                continue
            whole = x + BLOCK_WIDTH <= width and y + BLOCK_HEIGHT <= height
            for plane in range(1 + len(channels)):
                value, at = load(state, block * step + plane * LANES), y * width + x
                if plane == 0:
                    value, target = 1.0 - absolute(value), alpha
                else:
                    target, at = image, at + (plane - 1) * height * width
                if whole:
                    store_halves(value, target, at, at + width)
                else:
                    _write_edge_block(value, target, at, x, y, width, height, edge)


@kernel
def draw_backward(
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
    channels,
    image,
    alpha,
    grad_image,
    grad_alpha,
    slot_blocks,
    slots,
    slot_size,
):
    """Fill ``slots[slot_size · slot :]`` of every pair with ``slot_blocks[slot] != 0``: see above.

    Arguments as of ``draw``; ``image`` and ``alpha`` as it drew them.
    """
    step = (3 + len(channels)) * LANES  # T, rest, g_A, g …
    state = np.zeros((BLOCKS + 1) * step, np.float32)
    edge = np.empty(LANES, np.float32)
    columns, rows = _lane_columns(), _lane_rows()
    corner_x, corner_y = _block_corners()
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        left_f, top_f = np.float32(left), np.float32(top)
        for block in range(BLOCKS):
            x, y = left + block % BLOCKS_X * BLOCK_WIDTH, top + block // BLOCKS_X * BLOCK_HEIGHT
            if x >= width or y >= height:
                continue
            whole = x + BLOCK_WIDTH <= width and y + BLOCK_HEIGHT <= height
            here, at = block * step, y * width + x
            if whole:
                g, drawn = load_halves(grad_alpha, at, at + width), load_halves(alpha, at, at + width)
            else:
                g = _read_edge_block(grad_alpha, at, x, y, width, height, edge)
                drawn = _read_edge_block(alpha, at, x, y, width, height, edge)
            store(g, state, here + 2 * LANES)
            rest = drawn * g
            for c in range(len(channels)):
                if whole:
                    g, drawn = load_halves(grad_image, at, at + width), load_halves(image, at, at + width)
                else:
                    g = _read_edge_block(grad_image, at, x, y, width, height, edge)
                    drawn = _read_edge_block(image, at, x, y, width, height, edge)
                store(g, state, here + (3 + c) * LANES)
                rest = fma(drawn, g, rest)
                at += height * width
            store(rest, state, here + LANES)
        _start_tile(width, height, left, top, state, step)

        end = tile_starts[tile + 1]
        for entry in range(tile_starts[tile], end):
            prefetch(records, tile_ranks[min(entry + AHEAD, end - 1)] * stride)
            prefetch(slot_blocks, tile_slots[min(entry + AHEAD, end - 1)])
            slot = tile_slots[entry]
            blocks = slot_blocks[slot]
            prefetch(slots, slot * slot_size)
            if blocks == _ZERO:
                continue
            at = tile_ranks[entry] * stride
            l11, l21, minus_q = splat(records[at + L11]), splat(records[at + L21]), splat(-records[at + Q])
            bias = splat(records[at + BIAS])
            lane_x, lane_y = columns - (records[at + MEAN_X] - left_f), rows - (records[at + MEAN_Y] - top_f)
            colours = splat_each(channels, records, at + RECORD_HEAD)
            sum_v, sum_x, sum_y = splat(0.0), splat(0.0), splat(0.0)
            sum_xx, sum_xy, sum_yy = splat(0.0), splat(0.0), splat(0.0)
            grad_colours = zero_each(channels)
            while blocks != _ZERO:
                bit0 = lowest_bit(blocks)
                blocks &= blocks - _ONE
                bit1 = lowest_bit(blocks)
                blocks &= blocks - _ONE
                here0, here1 = bit0 * step, bit1 * step
                dx0, dy0 = lane_x + corner_x[bit0], lane_y + corner_y[bit0]
                dx1, dy1 = lane_x + corner_x[bit1], lane_y + corner_y[bit1]
                t0, t1 = (
                    _exponent(l11, l21, minus_q, bias, dx0, dy0),
                    _exponent(l11, l21, minus_q, bias, dx1, dy1),
                )
                e0, e1 = exp2_of_8(t0), exp2_of_8(t1)
                a0 = select(t0 >= T_MIN, minimum(e0, ALPHA_MAX), 0.0)
                a1 = select(t1 >= T_MIN, minimum(e1, ALPHA_MAX), 0.0)
                T0, T1 = load(state, here0), load(state, here1)
                after0, after1 = fma(-a0, T0, T0), fma(-a1, T1, T1)
                on0, on1 = after0 > TRANSMITTANCE_MIN, after1 > TRANSMITTANCE_MIN
                weight0, weight1 = select(on0, a0 * T0, 0.0), select(on1, a1 * T1, 0.0)
                store(select(on0, after0, -absolute(T0)), state, here0)
                store(select(on1, after1, -absolute(T1)), state, here1)
                g0 = load_each(channels, state, here0 + 3 * LANES, LANES)
                g1 = load_each(channels, state, here1 + 3 * LANES, LANES)
                q0 = dot_each(colours, g0, load(state, here0 + 2 * LANES))
                q1 = dot_each(colours, g1, load(state, here1 + 2 * LANES))
                rest0 = fma(-weight0, q0, load(state, here0 + LANES))
                rest1 = fma(-weight1, q1, load(state, here1 + LANES))
                store(rest0, state, here0 + LANES)
                store(rest1, state, here1 + LANES)
                v0 = select(on0 & (e0 <= ALPHA_MAX), a0 * fma(T0, q0, -rest0 / (1.0 - a0)), 0.0)
                v1 = select(on1 & (e1 <= ALPHA_MAX), a1 * fma(T1, q1, -rest1 / (1.0 - a1)), 0.0)
                vx0, vx1, vy0, vy1 = v0 * dx0, v1 * dx1, v0 * dy0, v1 * dy1
                sum_v, sum_x, sum_y = sum_v + (v0 + v1), sum_x + (vx0 + vx1), sum_y + (vy0 + vy1)
                sum_xx = fma(vx1, dx1, fma(vx0, dx0, sum_xx))
                sum_xy = fma(vx1, dy1, fma(vx0, dy0, sum_xy))
                sum_yy = fma(vy1, dy1, fma(vy0, dy0, sum_yy))
                grad_colours = fma_each(weight1, g1, fma_each(weight0, g0, grad_colours))
            sums = (sum_v, sum_x, sum_y, sum_xx, sum_xy, sum_yy) + grad_colours
            store_totals(sums, slots, slot * slot_size)
