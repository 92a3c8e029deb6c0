# SPDX-License-Identifier: GPL-3.0-or-later
"""Plane-sweep stereo of one view: what each depth costs each pixel, and those costs made smooth.

``matching_costs`` compares patches (zero-mean normalised correlation) with neighbouring views at a series of
inverse depths; ``semi_global`` adds up the cheapest paths along eight directions (Hirschmüller 2008, eq. 13),

    L(p, d) = C(p, d) + min(L(q, d), L(q, d ± 1) + small, min_k L(q, k) + large) − min_k L(q, k)

with q the pixel before p. Both work on ``[H, W, D′]``: a vector holds ``LANES`` neighbouring depths of one
pixel, and D′ is the number of depths rounded up to whole vectors; the cost beyond the last depth is infinite.

Neither is split over threads, but they run without Python's lock, so that views can be worked on side by
side. They are not differentiable; their twins in plain torch are in the tests.
"""

import numpy as np
from llvmlite import ir
from numba import njit

from ..simd import (
    LANES,
    absolute,
    floor,
    fma,
    kernel,
    lane_numbers,
    load,
    maximum,
    minimum,
    peek,
    select,
    splat,
    square_root,
    store,
)
from ..simd.tuples import pack, tuple_of
from ..simd.vector import FLOAT, I32, I64, IVECTOR, address, intrinsic, vector

#: Sides of the patches, pixels (odd).
PATCH = 5
#: How many neighbours (the best) a pixel believes: what one side does not see, the other may.
BELIEVED = 3
#: Contrast (standard deviation of ln radiance) below which a patch is noise: a code of 8 bits is about this.
NOISE = 0.02
#: Semi-global matching: penalties for a step of one depth and for any larger one, in units of 1 − score.
SMALL_STEP, LARGE_STEP = 0.05, 0.4

_HALF = PATCH // 2
_COUNT = np.float32(PATCH**2)
_NOISE = np.float32(PATCH**4 * NOISE**2)
_SMALL, _LARGE = np.float32(SMALL_STEP), np.float32(LARGE_STEP)
_INFINITE = np.float32(np.inf)
_LARGEST = np.finfo(np.float32).max
#: Directions in which paths come from the row above: from its left, straight down, from its right.
_FROM_ABOVE = 3


def matching_costs(
    grey: np.ndarray,
    others: list[np.ndarray],
    at_infinity: np.ndarray,
    per_inverse_depth: np.ndarray,
    inverse_depths: np.ndarray,
) -> np.ndarray:
    """1 − the mean of the ``BELIEVED`` best correlations with ``others``, ``[H, W, D′]`` float32.

    ``grey`` ``[H, W]`` and the N ``others``: float32 pictures with a mean near 0 (float32's squares of
    large numbers would leave nothing of small ones). Where a pixel at one of the ``inverse_depths`` ``[D]``,
    w, lies in another one's picture: ``at_infinity`` ``[N, 3, H·W]`` + w · ``per_inverse_depth`` ``[N, 3]``,
    homogeneous, whose quotients are −1 … 1 across the picture and whose last is positive in front of the
    camera. The correlation is 0 where the other does not see the point; patches repeat the border outward.
    """
    height, width = grey.shape
    # One row and column more, so that a pixel's lower right neighbours are always there.
    padded = [np.pad(other, ((0, 1), (0, 1)), mode="edge") for other in others]
    starts = np.cumsum([0, *(p.size for p in padded[:-1])])
    layout = [(start, *other.shape) for start, other in zip(starts, others, strict=True)]
    depths = -(-inverse_depths.size // LANES) * LANES
    costs = np.empty((height, width, depths), np.float32)
    _matching_costs(
        *(height, width, inverse_depths.size),
        np.pad(np.asarray(inverse_depths, np.float32), (0, depths - inverse_depths.size), mode="edge"),
        np.ascontiguousarray(at_infinity, np.float32).reshape(-1),
        np.ascontiguousarray(per_inverse_depth, np.float32).reshape(-1),
        np.concatenate([p.reshape(-1) for p in padded]).astype(np.float32, copy=False),
        np.array(layout, np.int64).reshape(-1),
        np.ascontiguousarray(grey, np.float32).reshape(-1),
        costs.reshape(-1),
    )
    return costs


def semi_global(costs: np.ndarray) -> np.ndarray:
    """Sum over eight directions of the cheapest path to each pixel at each depth, ``[H, W, D′]`` float32.

    ``costs`` is as ``matching_costs`` returns it. Paths begin at the picture's border.
    """
    sums = np.empty_like(costs)
    _semi_global(*costs.shape, costs.reshape(-1), sums.reshape(-1))
    return sums


@intrinsic
def _load_pairs(typing, array, indices):
    """``array[i]`` and ``array[i + 1]`` for each lane i of ``indices`` (whole numbers ≥ 0): two vectors."""
    pair = ir.VectorType(FLOAT, 2)

    def shuffle(builder, a, b, order):
        return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(I32, len(order)), order))

    def merged(builder, parts, order):
        """Neighbouring vectors made one, which takes ``order`` of the two."""
        return [shuffle(builder, a, b, order) for a, b in zip(parts[::2], parts[1::2], strict=True)]

    def generate(context, builder, sig, args):
        array, whole = args[0], builder.fptosi(args[1], IVECTOR)
        loaded = []
        for lane in range(LANES):
            index = builder.zext(builder.extract_element(whole, ir.Constant(I32, lane)), I64)
            pointer = builder.bitcast(address(context, builder, sig.args[0], array, index), pair.as_pointer())
            loaded.append(builder.load(pointer, align=4))
        twos = merged(builder, loaded, [0, 1, 2, 3])
        sides = []
        for side in (0, 1):
            parts = merged(builder, twos, [side, side + 2, side + 4, side + 6])
            while len(parts) > 1:
                parts = merged(builder, parts, list(range(2 * parts[0].type.count)))
            sides.append(parts[0])
        return pack(builder, sides)

    return tuple_of(2)(array, vector), generate


@njit(error_model="numpy")
def _patch_statistics(height, width, grey, sums, contrasts):
    """Of each patch of ``grey``: n times its mean, and 1 / (n times its standard deviation)."""
    for y in range(height):
        for x in range(width):
            total, squares = 0.0, 0.0
            for i in range(-_HALF, _HALF + 1):
                for j in range(-_HALF, _HALF + 1):
                    row, column = min(max(y + i, 0), height - 1), min(max(x + j, 0), width - 1)
                    value = np.float64(grey[row * width + column])
                    total, squares = total + value, squares + value * value
            sums[y * width + x] = total
            contrasts[y * width + x] = 1.0 / np.sqrt(
                max(PATCH**2 * squares - total * total, 0.0) + PATCH**4 * NOISE**2
            )


@njit(error_model="numpy")
def _warp_row(
    width, area, begin, w, at_infinity, motion, picture, start, other_height, other_width, warped, seen, to
):
    """The other picture's values along a row of pixels at inverse depths ``w``, and 1 where it sees them."""
    half_width, half_height = np.float32(0.5 * other_width), np.float32(0.5 * other_height)
    last_column, last_row = np.float32(other_width - 1), np.float32(other_height - 1)
    line, first = np.float32(other_width + 1), np.float32(start)
    motion_x, motion_y, motion_z = motion
    for x in range(width):
        depth = w * motion_z + peek(at_infinity, begin + 2 * area + x)
        u = (w * motion_x + peek(at_infinity, begin + x)) / depth
        v = (w * motion_y + peek(at_infinity, begin + area + x)) / depth
        inside = (depth > 0.0) & (absolute(u) < 1.0) & (absolute(v) < 1.0)
        # In the plane of the other camera these are no numbers. Any place does, if only it is in the picture.
        u, v = select(absolute(u) <= _LARGEST, u, 2.0), select(absolute(v) <= _LARGEST, v, 2.0)
        column = minimum(maximum((u + 1.0) * half_width - 0.5, 0.0), last_column)
        row = minimum(maximum((v + 1.0) * half_height - 0.5, 0.0), last_row)
        left, top = floor(column), floor(row)
        rightward, downward = column - left, row - top
        corner = top * line + left
        upper_left, upper_right = _load_pairs(picture, corner + first)
        lower_left, lower_right = _load_pairs(picture, corner + (line + first))
        upper = fma(rightward, upper_right - upper_left, upper_left)
        lower = fma(rightward, lower_right - lower_left, lower_left)
        store(fma(downward, lower - upper, upper), warped, to + x * LANES)
        store(select(inside, splat(1.0), 0.0), seen, to + x * LANES)


@njit(error_model="numpy")
def _column_sums(y, height, width, grey, warped, ring, sums, squares, products):
    """Σ v, Σ v² and Σ g v down the columns of the patches around row ``y``, repeated beyond both ends."""
    for x in range(width):
        s, ss, gs = splat(0.0), splat(0.0), splat(0.0)
        for i in range(-_HALF, _HALF + 1):
            row = min(max(y + i, 0), height - 1)
            value = load(warped, ring + (row % PATCH * width + x) * LANES)
            s, ss = s + value, fma(value, value, ss)
            gs = fma(value, splat(peek(grey, row * width + x)), gs)
        at = (x + _HALF) * LANES
        store(s, sums, at)
        store(ss, squares, at)
        store(gs, products, at)
    for column in (sums, squares, products):
        first, last = load(column, _HALF * LANES), load(column, (width + _HALF - 1) * LANES)
        for i in range(_HALF):
            store(first, column, i * LANES)
            store(last, column, (width + _HALF + i) * LANES)


@njit(error_model="numpy")
def _row_sum(column, at):
    value = load(column, at)
    for i in range(1, PATCH):
        value = value + load(column, at + i * LANES)
    return value


@kernel
def _matching_costs(
    height,
    width,
    count,
    inverse_depths,
    at_infinity,
    per_inverse_depth,
    pictures,
    layout,
    grey,
    costs,
):
    """See ``matching_costs``; ``layout`` holds each picture's first element, height and width.

    A vector of depths at a time, row by row: of each neighbour the last ``PATCH`` warped rows are kept.
    """
    area, depths, neighbours = height * width, inverse_depths.size, layout.size // 3
    grey_sums, contrasts = np.empty(area, np.float32), np.empty(area, np.float32)
    _patch_statistics(height, width, grey, grey_sums, contrasts)
    row = width * LANES
    warped = np.empty(neighbours * PATCH * row, np.float32)
    seen = np.empty(neighbours * PATCH * row, np.float32)
    column = row + 2 * _HALF * LANES
    sums, squares = np.empty(column, np.float32), np.empty(column, np.float32)
    products = np.empty(column, np.float32)
    best = np.empty(BELIEVED * row, np.float32)
    believed = min(BELIEVED, neighbours)
    for depth in range(0, depths, LANES):
        w = load(inverse_depths, depth)
        beyond = lane_numbers() >= np.float32(count - depth)
        for y in range(height):
            for at in range(0, best.size, LANES):
                store(splat(-_INFINITE), best, at)
            for other in range(neighbours):
                ring = other * PATCH * row
                motion = (
                    per_inverse_depth[3 * other],
                    per_inverse_depth[3 * other + 1],
                    per_inverse_depth[3 * other + 2],
                )
                for line in range(y + _HALF if y else 0, min(y + _HALF + 1, height)):
                    _warp_row(
                        width,
                        area,
                        3 * other * area + line * width,
                        w,
                        at_infinity,
                        motion,
                        pictures,
                        layout[3 * other],
                        layout[3 * other + 1],
                        layout[3 * other + 2],
                        warped,
                        seen,
                        ring + line % PATCH * row,
                    )
                _column_sums(y, height, width, grey, warped, ring, sums, squares, products)
                for x in range(width):
                    at = x * LANES
                    total = _row_sum(sums, at)
                    # n² times the variance and the covariance.
                    variance = maximum(fma(-total, total, _row_sum(squares, at) * _COUNT), 0.0) + _NOISE
                    product = _row_sum(products, at) * _COUNT
                    covariance = fma(-total, splat(peek(grey_sums, y * width + x)), product)
                    score = covariance * peek(contrasts, y * width + x) / square_root(variance)
                    score = select(load(seen, ring + y % PATCH * row + at) > 0.5, score, 0.0)
                    for i in range(BELIEVED):
                        better = load(best, i * row + at)
                        store(maximum(better, score), best, i * row + at)
                        score = minimum(better, score)
            for x in range(width):
                mean = load(best, x * LANES)
                for i in range(1, believed):
                    mean = mean + load(best, i * row + x * LANES)
                mean = mean / np.float32(believed)
                store(select(beyond, splat(_INFINITE), 1.0 - mean), costs, (y * width + x) * depths + depth)


@njit(error_model="numpy")
def _onward(cost, paths, before, least):
    """The cheapest paths to a pixel at ``LANES`` depths, from those ``before`` it."""
    same = minimum(load(paths, before), least + _LARGE)
    beside = minimum(load(paths, before - 1), load(paths, before + 1)) + _SMALL
    return cost + (minimum(same, beside) - least)


@njit(error_model="numpy")
def _lowest(value, lanes):
    store(value, lanes, 0)
    result = lanes[0]
    for i in range(1, LANES):
        result = min(result, lanes[i])
    return result


@kernel
def _semi_global(height, width, depths, costs, sums):
    """See ``semi_global``: four directions on the way down, the other four on the way back.

    The paths of a row and of the one before are kept, [direction, row, column, depth], with a column on
    either side for the border, and infinite paths before the first and after the last depth.
    """
    area = height * width
    pixel = depths + LANES
    line = (width + 2) * pixel
    paths = np.empty(LANES + 2 * _FROM_ABOVE * line, np.float32)
    least = np.empty((_FROM_ABOVE, 2, width + 2), np.float32)
    along = np.empty(LANES + 2 * pixel, np.float32)
    lanes = np.empty(LANES, np.float32)
    for backward in range(2):
        # Where no path has been, nothing is to pay: that is how paths begin.
        least[:] = 0.0
        for array in (paths, along):
            for at in range(0, array.size, LANES):
                between = at % pixel == 0
                store(splat(_INFINITE if between else np.float32(0.0)), array, at)
        for y in range(height):
            here, above = y % 2 * line, (y + 1) % 2 * line
            # Along the row: its border first.
            least_along = np.float32(0.0)
            for d in range(0, depths, LANES):
                store(splat(0.0), along, LANES + pixel + d)
            for x in range(width):
                number = y * width + x
                at = (area - 1 - number if backward else number) * depths
                to = LANES + here + (x + 1) * pixel
                from_left = LANES + above + x * pixel
                from_top = 2 * line + from_left + pixel
                from_right = 4 * line + from_left + 2 * pixel
                now, before = LANES + x % 2 * pixel, LANES + (x + 1) % 2 * pixel
                least_left = splat(least[0, (y + 1) % 2, x])
                least_top = splat(least[1, (y + 1) % 2, x + 1])
                least_right = splat(least[2, (y + 1) % 2, x + 2])
                least_before = splat(least_along)
                low_left = low_top = low_right = low_along = splat(_INFINITE)
                for d in range(0, depths, LANES):
                    cost = load(costs, at + d)
                    value = _onward(cost, along, before + d, least_before)
                    store(value, along, now + d)
                    low_along, total = minimum(value, low_along), value
                    value = _onward(cost, paths, from_left + d, least_left)
                    store(value, paths, to + d)
                    low_left, total = minimum(value, low_left), total + value
                    value = _onward(cost, paths, from_top + d, least_top)
                    store(value, paths, to + 2 * line + d)
                    low_top, total = minimum(value, low_top), total + value
                    value = _onward(cost, paths, from_right + d, least_right)
                    store(value, paths, to + 4 * line + d)
                    low_right, total = minimum(value, low_right), total + value
                    if backward:
                        total = total + load(sums, at + d)
                    store(total, sums, at + d)
                least_along = _lowest(low_along, lanes)
                least[0, y % 2, x + 1] = _lowest(low_left, lanes)
                least[1, y % 2, x + 1] = _lowest(low_top, lanes)
                least[2, y % 2, x + 1] = _lowest(low_right, lanes)
