# SPDX-License-Identifier: GPL-3.0-or-later
"""EWA projection of Gaussians to the screen, and its exact backward pass, ``LANES`` Gaussians at a time.

Forward (paper eq. 1–2). Camera space ``p = V m + t``; ``B = V R(q) diag(s)`` ``[3, 3]``;
``A = J B`` ``[2, 3]`` with the Jacobian J of the projection; ``Σ = A Aᵀ + 0.3 I`` px².

The rasteriser never needs Σ⁻¹ itself. With d = pixel − mean and κ = 1 / (16 ln 2),

    alpha = 2^(8 t),   t = log2(opacity)/8 − κ dᵀ Σ⁻¹ d = bias − (l₁₁ dx + l₂₁ dy)² − q dy²

where (Cholesky) l₁₁² = κ Σ_yy/det, l₁₁ l₂₁ = −κ Σ_xy/det, q = κ/Σ_yy. Written so, nothing cancels for
thin long Gaussians; and det is computed as |a₁ × a₂|² + 0.3 (|a₁|² + |a₂|²) + 0.09 (rows of A) for the
same reason.

Backward. The tiles deliver, per Gaussian, moments over its pixels of v = ∂L/∂(ln alpha):
S = Σv, S₁ = Σ v d ``[2]``, M = Σ v d dᵀ ``[2, 2]``. From ln alpha = ln o − ½ dᵀ K d with K = Σ⁻¹:

    ∂L/∂o = S/o        ∂L/∂mean₂ = K S₁        ∂L/∂K = −½ M  ⇒  ∂L/∂Σ = ½ K M K
    ∂L/∂A = 2 ∂L/∂Σ A = K M K A      ∂L/∂B = Jᵀ ∂L/∂A      ∂L/∂J = ∂L/∂A Bᵀ

and then by the product rule to s, q (through its normalisation) and p, and ∂L/∂m = Vᵀ ∂L/∂p. The clamp
of x/z and y/z inside J passes no gradient where it acts.
"""

import numpy as np
from numba import njit

from ....bridge.splatting import ALPHA_MIN, JACOBIAN_MARGIN, LOW_PASS, NEAR_PLANE
from ...scene.camera import Camera
from ...simd import (
    LANES,
    absolute,
    ceil,
    floor,
    fma,
    kernel,
    load,
    load_strided,
    log2_of_positive,
    maximum,
    minimum,
    select,
    splat,
    square_root,
    store,
    store_strided,
    store_transposed,
    total,
)

#: Floats of a Gaussian's record; its colours follow after ``RECORD_HEAD`` of them. A record of six channels
#: is one cache line.
(MEAN_X, MEAN_Y, L11, L21, Q, BIAS, INVERSE_L11) = range(7)
RECORD_HEAD = 8
assert RECORD_HEAD <= LANES

#: Pixels of a tile. 32 × 16 is 64 blocks of 4 × 2 pixels: one uint64 says which blocks matter.
TILE_WIDTH = 4 * LANES
TILE_HEIGHT = 16

#: t at which alpha = 1/255 (see above).
T_MIN = float(np.log2(ALPHA_MIN)) / 8.0

#: Widening of ellipses, against rounding: pixels, and a fraction of the distances involved.
MARGIN = 0.01
RELATIVE_MARGIN = 4e-7

KAPPA = 1.0 / (16.0 * np.log(2.0))
_EPSILON = 1e-12  # torch.nn.functional.normalize's

# Where things are in the camera's array, after the 12 floats of [V | t], row-major.
_FX, _FY, _CX, _CY, _WIDTH, _HEIGHT, _LOW_X, _HIGH_X, _LOW_Y, _HIGH_Y = range(12, 22)


def camera_array(camera: Camera) -> np.ndarray:
    """What the kernels need of a camera: ``[22]`` float32."""
    margin_x = JACOBIAN_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = JACOBIAN_MARGIN * 0.5 * camera.height / camera.fy
    return np.array(
        [
            *camera.world_to_camera[:3].reshape(-1),
            *(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height),
            *(-(camera.cx / camera.fx + margin_x), (camera.width - camera.cx) / camera.fx + margin_x),
            *(-(camera.cy / camera.fy + margin_y), (camera.height - camera.cy) / camera.fy + margin_y),
        ],
        dtype=np.float32,
    )


@njit(error_model="numpy")
def _rotation(w, x, y, z):
    """The rotation matrix of a unit quaternion, row by row."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@njit(error_model="numpy")
def _dot(a, b, c, x, y, z):
    return fma(a, x, fma(b, y, c * z))


@njit(error_model="numpy")
def _to_screen(view, x, y, z, w, qx, qy, qz, s0, s1, s2):
    """(depth, 1/z, x/z, y/z, both limited, fx/z, fy/z), A row by row, B row by row (see above)."""
    px = fma(splat(view[0]), x, fma(splat(view[1]), y, fma(splat(view[2]), z, splat(view[3]))))
    py = fma(splat(view[4]), x, fma(splat(view[5]), y, fma(splat(view[6]), z, splat(view[7]))))
    depth = fma(splat(view[8]), x, fma(splat(view[9]), y, fma(splat(view[10]), z, splat(view[11]))))
    pz = maximum(depth, NEAR_PLANE)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = _rotation(w, qx, qy, qz)
    b00 = _dot(splat(view[0]), splat(view[1]), splat(view[2]), r00, r10, r20) * s0
    b01 = _dot(splat(view[0]), splat(view[1]), splat(view[2]), r01, r11, r21) * s1
    b02 = _dot(splat(view[0]), splat(view[1]), splat(view[2]), r02, r12, r22) * s2
    b10 = _dot(splat(view[4]), splat(view[5]), splat(view[6]), r00, r10, r20) * s0
    b11 = _dot(splat(view[4]), splat(view[5]), splat(view[6]), r01, r11, r21) * s1
    b12 = _dot(splat(view[4]), splat(view[5]), splat(view[6]), r02, r12, r22) * s2
    b20 = _dot(splat(view[8]), splat(view[9]), splat(view[10]), r00, r10, r20) * s0
    b21 = _dot(splat(view[8]), splat(view[9]), splat(view[10]), r01, r11, r21) * s1
    b22 = _dot(splat(view[8]), splat(view[9]), splat(view[10]), r02, r12, r22) * s2
    inverse_z = 1.0 / pz
    tan_x, tan_y = px * inverse_z, py * inverse_z
    limited_x = minimum(maximum(tan_x, view[_LOW_X]), view[_HIGH_X])
    limited_y = minimum(maximum(tan_y, view[_LOW_Y]), view[_HIGH_Y])
    jx, jy = view[_FX] * inverse_z, view[_FY] * inverse_z
    a00, a01, a02 = (b00 - limited_x * b20) * jx, (b01 - limited_x * b21) * jx, (b02 - limited_x * b22) * jx
    a10, a11, a12 = (b10 - limited_y * b20) * jy, (b11 - limited_y * b21) * jy, (b12 - limited_y * b22) * jy
    return (
        (depth, inverse_z, tan_x, tan_y, limited_x, limited_y, jx, jy),
        (a00, a01, a02, a10, a11, a12),
        (b00, b01, b02, b10, b11, b12, b20, b21, b22),
    )


@njit(error_model="numpy")
def _covariance(A):
    """Σ_xx, Σ_xy, Σ_yy with the low-pass filter, 1/det Σ, and the cross product of A's rows."""
    a00, a01, a02, a10, a11, a12 = A
    norm_x, norm_y = _dot(a00, a01, a02, a00, a01, a02), _dot(a10, a11, a12, a10, a11, a12)
    c0, c1, c2 = a01 * a12 - a02 * a11, a02 * a10 - a00 * a12, a00 * a11 - a01 * a10
    determinant = _dot(c0, c1, c2, c0, c1, c2) + (norm_x + norm_y) * LOW_PASS + LOW_PASS * LOW_PASS
    xy = _dot(a00, a01, a02, a10, a11, a12)
    return norm_x + LOW_PASS, xy, norm_y + LOW_PASS, 1.0 / determinant, (c0, c1, c2)


@njit(error_model="numpy")
def _conditioned(A, normal, inverse_determinant):
    """P = K A: a₀ and a₁ the rows of A, (a₁ × (a₀ × a₁) + λ a₀) / det Σ and (a₀ × (a₁ × a₀) + λ a₁) / det Σ.

    K times A by its numbers loses what a needle's long axis has across it: Σ_yy a₀ − Σ_xy a₁ are two numbers
    of the length's cube, which are alike but for the width's share.
    """
    a00, a01, a02, a10, a11, a12 = A
    c0, c1, c2 = normal
    p00 = fma(LOW_PASS, a00, a11 * c2 - a12 * c1) * inverse_determinant
    p01 = fma(LOW_PASS, a01, a12 * c0 - a10 * c2) * inverse_determinant
    p02 = fma(LOW_PASS, a02, a10 * c1 - a11 * c0) * inverse_determinant
    p10 = fma(LOW_PASS, a10, c1 * a02 - c2 * a01) * inverse_determinant
    p11 = fma(LOW_PASS, a11, c2 * a00 - c0 * a02) * inverse_determinant
    p12 = fma(LOW_PASS, a12, c0 * a01 - c1 * a00) * inverse_determinant
    return p00, p01, p02, p10, p11, p12


@njit(error_model="numpy")
def _between(p, q, xx, xy, yy):
    """(p, q) M (p, q)ᵀ of a symmetric M."""
    return fma(p, fma(xx, p, 2.0 * xy * q), yy * q * q)


@njit(error_model="numpy")
def _load_gaussians(i, n, means, quaternions, scales):
    """Position, unit quaternion and scales of ``n ≤ LANES`` Gaussians from ``i`` on, and 1/|q|."""
    x, y, z = (
        load_strided(means, 3 * i, 3, n),
        load_strided(means, 3 * i + 1, 3, n),
        load_strided(means, 3 * i + 2, 3, n),
    )
    w, qx = load_strided(quaternions, 4 * i, 4, n), load_strided(quaternions, 4 * i + 1, 4, n)
    qy, qz = load_strided(quaternions, 4 * i + 2, 4, n), load_strided(quaternions, 4 * i + 3, 4, n)
    s0, s1 = load_strided(scales, 3 * i, 3, n), load_strided(scales, 3 * i + 1, 3, n)
    s2 = load_strided(scales, 3 * i + 2, 3, n)
    unit = 1.0 / maximum(square_root(w * w + qx * qx + qy * qy + qz * qz), _EPSILON)
    return x, y, z, w * unit, qx * unit, qy * unit, qz * unit, s0, s1, s2, unit


@njit(error_model="numpy")
def _pixels_between(middle, half, size):
    """First and last of ``size`` pixels whose centres lie within ``middle`` ± ``half``; first > last if none.

    As whole floats, clamped before they become integers: huge Gaussians reach beyond what an integer holds.
    """
    half = half + (absolute(middle) + half) * RELATIVE_MARGIN + MARGIN
    first, last = maximum(ceil(middle - half - 0.5), 0.0), minimum(floor(middle + half - 0.5), size - 1.0)
    return minimum(first, size), maximum(last, -1.0)


@njit(error_model="numpy")
def _tile_span(record, half_width, half_height, tile_y, width):
    """First and last tile column that a Gaussian touches in row ``tile_y``; first > last if none.

    On a pixel row at dy, the ellipse {alpha ≥ 1/255} reaches from −s dy − ρ to −s dy + ρ about its mean,
    s = l₂₁/l₁₁ and ρ = √(R − q dy²)/l₁₁ with R = bias − t_min. The right edge is concave in dy, with its
    maximum where dy = −l₂₁ √(R / (q (q + l₂₁²))), so over the rows of a tile it is largest at the dy nearest
    to that; likewise the left edge, by symmetry about the mean.
    """
    mean_x, mean_y, q, l21 = record[MEAN_X], record[MEAN_Y], record[Q], record[L21]
    inverse_l11 = record[INVERSE_L11]
    low = np.float32(tile_y * TILE_HEIGHT) + np.float32(0.5) - mean_y
    high = low + np.float32(TILE_HEIGHT - 1)
    low, high = max(low, -half_height), min(high, half_height)
    slope = l21 * inverse_l11
    extent = record[BIAS] - np.float32(T_MIN)
    peak = -l21 * np.sqrt(extent / (q * (q + l21 * l21)))
    dy = min(max(peak, low), high)
    right = np.sqrt(max(extent - q * dy * dy, np.float32(0.0))) * inverse_l11 - slope * dy
    dy = min(max(-peak, low), high)
    left = -np.sqrt(max(extent - q * dy * dy, np.float32(0.0))) * inverse_l11 - slope * dy
    margin = np.float32(MARGIN) + np.float32(RELATIVE_MARGIN) * (abs(mean_x) + half_width)
    first = max(np.ceil(mean_x + left - margin - np.float32(0.5)), np.float32(0.0))
    last = min(np.floor(mean_x + right + margin - np.float32(0.5)), np.float32(width - 1))
    if last < first:
        return 0, -1
    return int(first) // TILE_WIDTH, int(last) // TILE_WIDTH


@kernel
def project(
    first,
    last,
    means,
    quaternions,
    scales,
    opacities,
    offsets,
    colours,
    channels,
    camera,
    tiles_x,
    records,
    stride,
    keys,
    radii,
    slot_starts,
    slot_tiles,
    histogram,
    finite,
):
    """Project Gaussians ``first … last − 1`` and find the tiles that each touches; return how many pairs.

    In: ``means`` ``[3N]``, ``quaternions`` ``[4N]``, ``scales`` ``[3N]``, ``opacities`` ``[N]``, ``offsets``
    ``[2N]`` or ``[0]``, ``colours`` ``[C · N]``, all flat; ``camera`` of ``camera_array``.
    Out: ``records[stride · g :]`` of what is drawn (with room for ``LANES`` more at the end); ``keys``
    ``[N]`` int32, the depth's bits, which sort like the depth, as it is positive; ``radii`` ``[N]`` px, 0
    where nothing is drawn; ``finite[0]`` becomes False if any input is NaN or infinite. A (Gaussian, tile)
    pair has a slot, counted here from 0 in the order of Gaussians: ``slot_starts[g]`` is Gaussian g's first,
    ``slot_tiles[slot]`` its tile (not written beyond the array's size: then call again with a larger one),
    ``histogram`` ``[tiles]`` (zero before) the pairs of every tile.
    """
    # One group of Gaussians, field by field, for what is done one by one.
    fields = np.empty((8, LANES), np.float32)
    half_widths, half_heights, first_columns, last_columns = fields[0], fields[1], fields[2], fields[3]
    first_rows, last_rows, depths, drawn = fields[4], fields[5], fields[6], fields[7]
    bits = depths.view(np.int32)
    checksum = splat(0.0)
    width, height = camera[_WIDTH], camera[_HEIGHT]
    pairs = 0
    for i in range(first, last, LANES):
        n = min(LANES, last - i)
        x, y, z, w, qx, qy, qz, s0, s1, s2, unit = _load_gaussians(i, n, means, quaternions, scales)
        opacity = load_strided(opacities, i, 1, n)
        # x · 0 is 0 for a finite x and NaN for any other.
        checksum = checksum + (x + y + z + w + qx + qy + qz + unit + s0 + s1 + s2 + opacity) * 0.0

        P, A, _ = _to_screen(camera, x, y, z, w, qx, qy, qz, s0, s1, s2)
        depth, _, tan_x, tan_y, _, _, _, _ = P
        xx, xy, yy, inverse_determinant, _ = _covariance(A)
        l11 = square_root(KAPPA * yy * inverse_determinant)
        mean_x = fma(splat(camera[_FX]), tan_x, splat(camera[_CX]))
        mean_y = fma(splat(camera[_FY]), tan_y, splat(camera[_CY]))
        if offsets.size:
            offset_x, offset_y = load_strided(offsets, 2 * i, 2, n), load_strided(offsets, 2 * i + 1, 2, n)
            checksum = checksum + (offset_x + offset_y) * 0.0
            mean_x, mean_y = mean_x + offset_x, mean_y + offset_y
        inverse_l11 = 1.0 / l11
        l21 = -(KAPPA * xy * inverse_determinant) * inverse_l11
        bias = log2_of_positive(opacity) * 0.125
        # Where alpha falls to 1/255: dᵀ Σ⁻¹ d = (bias − t_min) / κ; its bounding box.
        reach = square_root(maximum((bias - T_MIN) * (1.0 / KAPPA), 0.0))
        half_width, half_height = reach * square_root(xx), reach * square_root(yy)
        # A covariance that overflows float32 (footprints of 10^9 px) is not drawn.
        is_drawn = (opacity >= ALPHA_MIN) & (depth >= NEAR_PLANE) & (l11 > 0.0)
        is_drawn = is_drawn & (mean_x + half_width > 0.0) & (mean_x - half_width < width)
        is_drawn = is_drawn & (mean_y + half_height > 0.0) & (mean_y - half_height < height)

        store_transposed(
            (mean_x, mean_y, l11, l21, KAPPA / yy, bias, inverse_l11, splat(0.0)), records, i * stride, stride
        )
        left, right = _pixels_between(mean_x, half_width, width)
        top, bottom = _pixels_between(mean_y, half_height, height)
        store(left, first_columns, 0)
        store(right, last_columns, 0)
        store(top, first_rows, 0)
        store(bottom, last_rows, 0)
        store(half_width, half_widths, 0)
        store(half_height, half_heights, 0)
        store(depth, depths, 0)
        store(select(is_drawn, splat(1.0), 0.0), drawn, 0)

        for lane in range(n):
            g = i + lane
            slot_starts[g] = pairs
            radii[g] = 0.0
            if drawn[lane] == 0.0:
                continue
            keys[g] = bits[lane]
            radii[g] = max(half_widths[lane], half_heights[lane])
            for c in range(channels):
                records[g * stride + RECORD_HEAD + c] = colours[g * channels + c]
            if last_columns[lane] < first_columns[lane] or last_rows[lane] < first_rows[lane]:
                continue  # between the centres of pixels
            tile_left = int(first_columns[lane]) // TILE_WIDTH
            tile_right = int(last_columns[lane]) // TILE_WIDTH
            tile_top, tile_bottom = int(first_rows[lane]) // TILE_HEIGHT, int(last_rows[lane]) // TILE_HEIGHT
            in_corners = tile_left < tile_right and tile_top < tile_bottom
            for tile_y in range(tile_top, tile_bottom + 1):
                if in_corners:  # only then can a tile of the bounding box be missed by the ellipse
                    tile_left, tile_right = _tile_span(
                        records[g * stride : g * stride + RECORD_HEAD],
                        half_widths[lane],
                        half_heights[lane],
                        tile_y,
                        width,
                    )
                for tile in range(tile_y * tiles_x + tile_left, tile_y * tiles_x + tile_right + 1):
                    histogram[tile] += 1
                    if pairs < slot_tiles.size:
                        slot_tiles[pairs] = tile
                    pairs += 1
    if total(checksum) != 0.0:  # NaN is not 0 either
        finite[0] = False
    return pairs


@kernel
def project_backward(
    first,
    last,
    means,
    quaternions,
    scales,
    opacities,
    camera,
    slot_starts,
    slots,
    slot_size,
    slot_drawn,
    channels,
    grad_means,
    grad_quaternions,
    grad_scales,
    grad_opacities,
    grad_offsets,
    grad_colours,
):
    """Sum the gradients of Gaussians ``first … last − 1`` over their tiles and take them to the inputs.

    ``slots[slot_size · k :]`` has the moments S, Sx, Sy, Sxx, Sxy, Syy and then the colour gradients from
    the k-th (Gaussian, tile) pair; Gaussian g has the pairs ``slot_starts[g] … slot_starts[g + 1] − 1``, of
    which those with ``slot_drawn[k] == 0`` contributed nothing and were never written. Outputs are flat
    arrays as in ``project``, ``grad_colours`` ``[C · N]``.
    """
    moments = np.empty(LANES * slot_size, np.float32)
    active = np.empty(LANES, np.float32)
    v0, v1, v2 = splat(camera[0]), splat(camera[1]), splat(camera[2])
    v3, v4, v5 = splat(camera[4]), splat(camera[5]), splat(camera[6])
    v6, v7, v8 = splat(camera[8]), splat(camera[9]), splat(camera[10])
    for i in range(first, last, LANES):
        n = min(LANES, last - i)
        moments[:] = 0.0
        active[:] = 0.0
        any_active = False
        for lane in range(n):
            for k in range(slot_starts[i + lane], slot_starts[i + lane + 1]):
                if slot_drawn[k] != 0:
                    active[lane] = 1.0
                    any_active = True
                    for part in range(0, slot_size, LANES):
                        at = lane * slot_size + part
                        store(load(moments, at) + load(slots, k * slot_size + part), moments, at)
            for c in range(channels):
                grad_colours[(i + lane) * channels + c] = moments[lane * slot_size + 6 + c]
        if not any_active:
            grad_means[3 * i : 3 * (i + n)] = 0.0
            grad_quaternions[4 * i : 4 * (i + n)] = 0.0
            grad_scales[3 * i : 3 * (i + n)] = 0.0
            grad_opacities[i : i + n] = 0.0
            grad_offsets[2 * i : 2 * (i + n)] = 0.0
            continue
        drawn = load(active, 0) > 0.0
        sum_v, sum_x = load_strided(moments, 0, slot_size, n), load_strided(moments, 1, slot_size, n)
        sum_y, sum_xx = load_strided(moments, 2, slot_size, n), load_strided(moments, 3, slot_size, n)
        sum_xy, sum_yy = load_strided(moments, 4, slot_size, n), load_strided(moments, 5, slot_size, n)

        x, y, z, w, qx, qy, qz, s0, s1, s2, unit = _load_gaussians(i, n, means, quaternions, scales)
        P, A, B = _to_screen(camera, x, y, z, w, qx, qy, qz, s0, s1, s2)
        _, inverse_z, tan_x, tan_y, limited_x, limited_y, jx, jy = P
        b20, b21, b22 = B[6:]
        xx, xy, yy, inverse_determinant, normal = _covariance(A)

        # K = Σ⁻¹; the screen mean; P = K A; ∂L/∂A = K (M P), with M the sum of d dᵀ ∂L/∂v over the pixels.
        ka, kb, kc = yy * inverse_determinant, -xy * inverse_determinant, xx * inverse_determinant
        grad_u, grad_v = ka * sum_x + kb * sum_y, kb * sum_x + kc * sum_y
        p00, p01, p02, p10, p11, p12 = _conditioned(A, normal, inverse_determinant)
        q00, q10 = sum_xx * p00 + sum_xy * p10, sum_xy * p00 + sum_yy * p10
        q01, q11 = sum_xx * p01 + sum_xy * p11, sum_xy * p01 + sum_yy * p11
        q02, q12 = sum_xx * p02 + sum_xy * p12, sum_xy * p02 + sum_yy * p12
        ga00, ga01, ga02 = ka * q00 + kb * q10, ka * q01 + kb * q11, ka * q02 + kb * q12
        ga10, ga11, ga12 = kb * q00 + kc * q10, kb * q01 + kc * q11, kb * q02 + kc * q12
        # ⟨∂L/∂A, A⟩ by columns, which is each scale's own gradient times it: with no K that is not in P.
        by_s0 = _between(p00, p10, sum_xx, sum_xy, sum_yy)
        by_s1 = _between(p01, p11, sum_xx, sum_xy, sum_yy)
        by_s2 = _between(p02, p12, sum_xx, sum_xy, sum_yy)

        # A = J B with J = [[jx, 0, −jx · limited_x], [0, jy, −jy · limited_y]], jx = fx/z.
        gb00, gb01, gb02 = jx * ga00, jx * ga01, jx * ga02
        gb10, gb11, gb12 = jy * ga10, jy * ga11, jy * ga12
        gb20 = -(limited_x * gb00 + limited_y * gb10)
        gb21 = -(limited_x * gb01 + limited_y * gb11)
        gb22 = -(limited_x * gb02 + limited_y * gb12)
        # Rows of A are proportional to jx and jy, so jx · ∂L/∂jx = ⟨∂L/∂a₁, a₁⟩.
        through_j = by_s0 + by_s1 + by_s2
        inside_x = (tan_x >= camera[_LOW_X]) & (tan_x <= camera[_HIGH_X])
        inside_y = (tan_y >= camera[_LOW_Y]) & (tan_y <= camera[_HIGH_Y])
        limit_x = select(inside_x, -_dot(gb00, gb01, gb02, b20, b21, b22), 0.0)
        limit_y = select(inside_y, -_dot(gb10, gb11, gb12, b20, b21, b22), 0.0)
        grad_tan_x, grad_tan_y = camera[_FX] * grad_u + limit_x, camera[_FY] * grad_v + limit_y
        grad_px, grad_py = grad_tan_x * inverse_z, grad_tan_y * inverse_z
        grad_pz = -(through_j + grad_tan_x * tan_x + grad_tan_y * tan_y) * inverse_z

        # B = V R S. With C = Vᵀ ∂L/∂B: ∂L/∂R_ij = C_ij s_j.
        c00, c10, c20 = (
            _dot(v0, v3, v6, gb00, gb10, gb20),
            _dot(v1, v4, v7, gb00, gb10, gb20),
            _dot(v2, v5, v8, gb00, gb10, gb20),
        )
        c01, c11, c21 = (
            _dot(v0, v3, v6, gb01, gb11, gb21),
            _dot(v1, v4, v7, gb01, gb11, gb21),
            _dot(v2, v5, v8, gb01, gb11, gb21),
        )
        c02, c12, c22 = (
            _dot(v0, v3, v6, gb02, gb12, gb22),
            _dot(v1, v4, v7, gb02, gb12, gb22),
            _dot(v2, v5, v8, gb02, gb12, gb22),
        )
        grad_s0 = select(absolute(s0) > 0.0, by_s0 / s0, 0.0)
        grad_s1 = select(absolute(s1) > 0.0, by_s1 / s1, 0.0)
        grad_s2 = select(absolute(s2) > 0.0, by_s2 / s2, 0.0)
        c00, c10, c20 = c00 * s0, c10 * s0, c20 * s0
        c01, c11, c21 = c01 * s1, c11 * s1, c21 * s1
        c02, c12, c22 = c02 * s2, c12 * s2, c22 * s2
        # ∂R/∂(unit quaternion), half of it; then q/|q| lets only what is orthogonal to it through.
        hw = qx * (c21 - c12) + qy * (c02 - c20) + qz * (c10 - c01)
        hx = qy * (c01 + c10) + qz * (c02 + c20) + w * (c21 - c12) - 2.0 * qx * (c11 + c22)
        hy = qx * (c01 + c10) + qz * (c12 + c21) + w * (c02 - c20) - 2.0 * qy * (c00 + c22)
        hz = qx * (c02 + c20) + qy * (c12 + c21) + w * (c10 - c01) - 2.0 * qz * (c00 + c11)
        along = w * hw + qx * hx + qy * hy + qz * hz
        twice = 2.0 * unit

        store_strided(
            select(drawn, _dot(v0, v3, v6, grad_px, grad_py, grad_pz), 0.0), grad_means, 3 * i, 3, n
        )
        store_strided(
            select(drawn, _dot(v1, v4, v7, grad_px, grad_py, grad_pz), 0.0), grad_means, 3 * i + 1, 3, n
        )
        store_strided(
            select(drawn, _dot(v2, v5, v8, grad_px, grad_py, grad_pz), 0.0), grad_means, 3 * i + 2, 3, n
        )
        store_strided(select(drawn, twice * (hw - w * along), 0.0), grad_quaternions, 4 * i, 4, n)
        store_strided(select(drawn, twice * (hx - qx * along), 0.0), grad_quaternions, 4 * i + 1, 4, n)
        store_strided(select(drawn, twice * (hy - qy * along), 0.0), grad_quaternions, 4 * i + 2, 4, n)
        store_strided(select(drawn, twice * (hz - qz * along), 0.0), grad_quaternions, 4 * i + 3, 4, n)
        store_strided(select(drawn, grad_s0, 0.0), grad_scales, 3 * i, 3, n)
        store_strided(select(drawn, grad_s1, 0.0), grad_scales, 3 * i + 1, 3, n)
        store_strided(select(drawn, grad_s2, 0.0), grad_scales, 3 * i + 2, 3, n)
        opacity = load_strided(opacities, i, 1, n)
        store_strided(select(drawn, sum_v / opacity, 0.0), grad_opacities, i, 1, n)
        store_strided(select(drawn, grad_u, 0.0), grad_offsets, 2 * i, 2, n)
        store_strided(select(drawn, grad_v, 0.0), grad_offsets, 2 * i + 1, 2, n)
