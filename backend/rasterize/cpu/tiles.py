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

from ....bridge.splatting import ALPHA_MAX, TRANSMITTANCE_MIN
from ...simd import (
    LANES,
    absolute,
    any_lane,
    ceil,
    dot_each,
    exp2_of_8,
    floor,
    fma,
    fma_each,
    kernel,
    lane_numbers,
    load,
    load_each,
    load_halves,
    lowest_bit,
    maximum,
    minimum,
    peek,
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
from .projection import (
    BIAS,
    INVERSE_L11,
    L11,
    L21,
    MARGIN,
    MEAN_X,
    MEAN_Y,
    RECORD_HEAD,
    RELATIVE_MARGIN,
    T_MIN,
    TILE_HEIGHT,
    TILE_WIDTH,
    Q,
)

BLOCK_WIDTH = LANES // 2
BLOCK_HEIGHT = 2
BLOCKS_X = TILE_WIDTH // BLOCK_WIDTH
BLOCKS_Y = TILE_HEIGHT // BLOCK_HEIGHT
BLOCKS = BLOCKS_X * BLOCKS_Y
assert BLOCKS_X == 8 and BLOCKS_Y == 8, "block (x, y) is bit 8 y + x of a uint64"

#: Gaussians whose blocks are found together, ahead of drawing them: one by one, each would wait for its own.
CHUNK = 32

#: Floats of a slot before the colours' gradients: Σ v, Σ v dx, Σ v dy, Σ v dx², Σ v dx dy, Σ v dy².
MOMENTS = 6

#: How many Gaussians ahead their records are fetched.
AHEAD = 8

_ONE = np.uint64(1)
_ZERO = np.uint64(0)


@njit(error_model="numpy")
def _blocks(mean_x, mean_y, bias, l21, q, inverse_l11, group_rows):
    """The blocks of a tile that {alpha ≥ 1/255} reaches; the mean is relative to the tile's corner.

    Lane g is the g-th row of blocks, whose pixel rows are ``group_rows`` + 0.5 and + 1.5. On a row, the
    ellipse's edges are mean_x − s dy ± √(R − q dy²)/l₁₁ (see projection.py).
    """
    extent = splat((bias - np.float32(T_MIN)) * np.float32(1.00001))
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
    """x and y of every block's corner in its tile.

    Tables, because converting an integer in the loop (vcvtsi2ss) makes every block wait for the one before:
    the instruction depends on the old value of its target register.
    """
    blocks = np.arange(BLOCKS)
    return (
        (blocks % BLOCKS_X * BLOCK_WIDTH).astype(np.float32),
        (blocks // BLOCKS_X * BLOCK_HEIGHT).astype(np.float32),
    )


@njit
def _exponent(l11, l21, minus_q, bias, dx, dy):
    """t: alpha is 2^(8 t)."""
    u = fma(l11, dx, l21 * dy)
    return fma(-u, u, fma(minus_q, dy * dy, bias))


@njit
def _blocks_inside(width, height, left, top):
    """The blocks of a tile that have pixels."""
    inside = _ZERO
    for block in range(BLOCKS):
        if left + block % BLOCKS_X * BLOCK_WIDTH < width and top + block // BLOCKS_X * BLOCK_HEIGHT < height:
            inside |= _ONE << np.uint64(block)
    return inside


@kernel
def draw(
    counter,
    tile_order,
    tile_starts,
    tile_gaussians,
    records,
    stride,
    width,
    height,
    tiles_x,
    channels,
    image,
    alpha,
    entry_blocks,
):
    """Draw the tiles whose turn it is: tickets of ``counter`` index ``tile_order``.

    ``channels``: a tuple as long as there are channels (its type is what counts). Out, flat: ``image``
    ``[C · H · W]``, ``alpha`` ``[H · W]``, of whole blocks; unless its size is 0, ``entry_blocks``
    ``[pairs]`` (zero before): the blocks that every entry of the tiles' lists may have drawn on.
    """
    step = (1 + len(channels)) * LANES  # T, channels
    state = np.empty((BLOCKS + 1) * step, np.float32)  # one block to spare, always finished
    masks = np.empty(CHUNK, np.uint64)
    columns, rows = _lane_columns(), _lane_rows()
    corner_x, corner_y = _block_corners()
    group_rows = lane_numbers() * float(BLOCK_HEIGHT)
    keep_blocks = entry_blocks.size > 0
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        left_f, top_f = np.float32(left), np.float32(top)
        state[:] = 0.0
        for block in range(BLOCKS):
            store(splat(1.0), state, block * step)
        store(splat(-1.0), state, BLOCKS * step)
        inside = _blocks_inside(width, height, left, top)
        alive = inside
        end = tile_starts[tile + 1]
        for begin in range(tile_starts[tile], end, CHUNK):
            if alive == _ZERO:
                break
            count = min(CHUNK, end - begin)
            for k in range(count):
                prefetch(records, peek(tile_gaussians, min(begin + k + AHEAD, end - 1)) * stride)
                at = peek(tile_gaussians, begin + k) * stride
                masks[k] = _blocks(
                    peek(records, at + MEAN_X) - left_f,
                    peek(records, at + MEAN_Y) - top_f,
                    peek(records, at + BIAS),
                    peek(records, at + L21),
                    peek(records, at + Q),
                    peek(records, at + INVERSE_L11),
                    group_rows,
                )
            for k in range(count):
                blocks = alive & masks[k]
                if keep_blocks:
                    entry_blocks[begin + k] = blocks
                if blocks == _ZERO:
                    continue
                at = peek(tile_gaussians, begin + k) * stride
                l11, l21 = splat(peek(records, at + L11)), splat(peek(records, at + L21))
                minus_q, bias = splat(-peek(records, at + Q)), splat(peek(records, at + BIAS))
                lane_x = columns - (peek(records, at + MEAN_X) - left_f)
                lane_y = rows - (peek(records, at + MEAN_Y) - top_f)
                colours = splat_each(channels, records, at + RECORD_HEAD)
                while blocks != _ZERO:
                    # Two blocks at a time; an odd one out is paired with the spare block.
                    bit0 = lowest_bit(blocks)
                    blocks &= blocks - _ONE
                    bit1 = lowest_bit(blocks)
                    blocks &= blocks - _ONE
                    here0, here1 = bit0 * step, bit1 * step
                    dx0, dy0 = lane_x + peek(corner_x, bit0), lane_y + peek(corner_y, bit0)
                    dx1, dy1 = lane_x + peek(corner_x, bit1), lane_y + peek(corner_y, bit1)
                    t0 = _exponent(l11, l21, minus_q, bias, dx0, dy0)
                    t1 = _exponent(l11, l21, minus_q, bias, dx1, dy1)
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
        for block in range(BLOCKS):
            if inside >> np.uint64(block) & _ONE:
                here = block * step
                at = (top + block // BLOCKS_X * BLOCK_HEIGHT) * width + left + block % BLOCKS_X * BLOCK_WIDTH
                store_halves(1.0 - absolute(load(state, here)), alpha, at, at + width)
                for _ in range(len(channels)):
                    here += LANES
                    store_halves(load(state, here), image, at, at + width)
                    at += height * width


@kernel
def draw_backward(
    counter,
    tile_order,
    tile_starts,
    tile_gaussians,
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
    entry_blocks,
    slots,
    slot_size,
    slot_drawn,
):
    """Fill ``slots[slot_size · slot :]`` of every pair that was drawn, and set ``slot_drawn[slot]``.

    Arguments as of ``draw``; ``image`` and ``alpha`` as ``draw`` made them; ``slot_drawn`` ``[pairs]`` uint8,
    zero before.
    """
    step = (4 + len(channels)) * LANES  # T, rest, v, g_A, g …
    state = np.zeros((BLOCKS + 1) * step, np.float32)
    columns, rows = _lane_columns(), _lane_rows()
    corner_x, corner_y = _block_corners()
    while True:
        ticket = take_ticket(counter)
        if ticket >= tile_order.size:
            break
        tile = tile_order[ticket]
        left, top = tile % tiles_x * TILE_WIDTH, tile // tiles_x * TILE_HEIGHT
        left_f, top_f = np.float32(left), np.float32(top)
        store(splat(-1.0), state, BLOCKS * step)
        inside = _blocks_inside(width, height, left, top)
        for block in range(BLOCKS):
            if inside >> np.uint64(block) & _ONE:
                here = block * step
                at = (top + block // BLOCKS_X * BLOCK_HEIGHT) * width + left + block % BLOCKS_X * BLOCK_WIDTH
                store(splat(1.0), state, here)
                g = load_halves(grad_alpha, at, at + width)
                rest = g * load_halves(alpha, at, at + width)
                store(g, state, here + 3 * LANES)
                for c in range(len(channels)):
                    g = load_halves(grad_image, at, at + width)
                    rest = fma(g, load_halves(image, at, at + width), rest)
                    store(g, state, here + (4 + c) * LANES)
                    at += height * width
                store(rest, state, here + LANES)

        end = tile_starts[tile + 1]
        for entry in range(tile_starts[tile], end):
            ahead = min(entry + AHEAD, end - 1)
            prefetch(records, peek(tile_gaussians, ahead) * stride)
            prefetch(slots, peek(tile_slots, ahead) * slot_size)
            visited = peek(entry_blocks, entry)
            if visited == _ZERO:
                continue
            at = peek(tile_gaussians, entry) * stride
            l11, l21 = splat(peek(records, at + L11)), splat(peek(records, at + L21))
            minus_q, bias = splat(-peek(records, at + Q)), splat(peek(records, at + BIAS))
            lane_x = columns - (peek(records, at + MEAN_X) - left_f)
            lane_y = rows - (peek(records, at + MEAN_Y) - top_f)
            colours = splat_each(channels, records, at + RECORD_HEAD)
            grad_colours = zero_each(channels)
            blocks = visited
            while blocks != _ZERO:
                bit0 = lowest_bit(blocks)
                blocks &= blocks - _ONE
                bit1 = lowest_bit(blocks)
                blocks &= blocks - _ONE
                here0, here1 = bit0 * step, bit1 * step
                dx0, dy0 = lane_x + peek(corner_x, bit0), lane_y + peek(corner_y, bit0)
                dx1, dy1 = lane_x + peek(corner_x, bit1), lane_y + peek(corner_y, bit1)
                t0 = _exponent(l11, l21, minus_q, bias, dx0, dy0)
                t1 = _exponent(l11, l21, minus_q, bias, dx1, dy1)
                e0, e1 = exp2_of_8(t0), exp2_of_8(t1)
                a0 = select(t0 >= T_MIN, minimum(e0, ALPHA_MAX), 0.0)
                a1 = select(t1 >= T_MIN, minimum(e1, ALPHA_MAX), 0.0)
                T0, T1 = load(state, here0), load(state, here1)
                after0, after1 = fma(-a0, T0, T0), fma(-a1, T1, T1)
                on0, on1 = after0 > TRANSMITTANCE_MIN, after1 > TRANSMITTANCE_MIN
                weight0, weight1 = select(on0, a0 * T0, 0.0), select(on1, a1 * T1, 0.0)
                store(select(on0, after0, -absolute(T0)), state, here0)
                store(select(on1, after1, -absolute(T1)), state, here1)
                g0 = load_each(channels, state, here0 + 4 * LANES, LANES)
                g1 = load_each(channels, state, here1 + 4 * LANES, LANES)
                q0 = dot_each(colours, g0, load(state, here0 + 3 * LANES))
                q1 = dot_each(colours, g1, load(state, here1 + 3 * LANES))
                rest0 = fma(-weight0, q0, load(state, here0 + LANES))
                rest1 = fma(-weight1, q1, load(state, here1 + LANES))
                store(rest0, state, here0 + LANES)
                store(rest1, state, here1 + LANES)
                v0 = select(on0 & (e0 <= ALPHA_MAX), a0 * fma(T0, q0, -rest0 / (1.0 - a0)), 0.0)
                v1 = select(on1 & (e1 <= ALPHA_MAX), a1 * fma(T1, q1, -rest1 / (1.0 - a1)), 0.0)
                store(v0, state, here0 + 2 * LANES)
                store(v1, state, here1 + 2 * LANES)
                grad_colours = fma_each(weight1, g1, fma_each(weight0, g0, grad_colours))
            # Moments in a loop of their own: there are registers for their sums or the colours', not both.
            sum_v, sum_x, sum_y = splat(0.0), splat(0.0), splat(0.0)
            sum_xx, sum_xy, sum_yy = splat(0.0), splat(0.0), splat(0.0)
            blocks = visited
            while blocks != _ZERO:
                bit = lowest_bit(blocks)
                blocks &= blocks - _ONE
                v = load(state, bit * step + 2 * LANES)
                dx, dy = lane_x + peek(corner_x, bit), lane_y + peek(corner_y, bit)
                vx, vy = v * dx, v * dy
                sum_v, sum_x, sum_y = sum_v + v, sum_x + vx, sum_y + vy
                sum_xx, sum_xy, sum_yy = fma(vx, dx, sum_xx), fma(vx, dy, sum_xy), fma(vy, dy, sum_yy)
            slot = peek(tile_slots, entry)
            slot_drawn[slot] = 1
            sums = (sum_v, sum_x, sum_y, sum_xx, sum_xy, sum_yy) + grad_colours
            store_totals(sums, slots, slot * slot_size)
