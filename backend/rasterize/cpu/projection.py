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

from ...scene.camera import NEAR_PLANE, Camera
from ..contract import ALPHA_MIN, JACOBIAN_MARGIN, LOW_PASS
from .compiling import kernel
from .simd import (
    LANES,
    fma,
    load,
    load_strided,
    maximum,
    minimum,
    select,
    splat,
    square_root,
    store,
    store_strided,
    total,
)

#: Floats per Gaussian that ``project`` writes. Every tile kernel reads the first seven.
(MEAN_X, MEAN_Y, L11, L21, Q, BIAS, INVERSE_L11, HALF_WIDTH, HALF_HEIGHT, RIGHTMOST_Y) = range(10)
FOOTPRINT = 10

#: Key of a Gaussian that is not drawn: behind every depth.
NOT_DRAWN = np.uint32(0xFFFFFFFF)

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
    """Σ_xx, Σ_xy, Σ_yy with the low-pass filter, and 1/det Σ."""
    a00, a01, a02, a10, a11, a12 = A
    norm_x, norm_y = _dot(a00, a01, a02, a00, a01, a02), _dot(a10, a11, a12, a10, a11, a12)
    c0, c1, c2 = a01 * a12 - a02 * a11, a02 * a10 - a00 * a12, a00 * a11 - a01 * a10
    determinant = _dot(c0, c1, c2, c0, c1, c2) + (norm_x + norm_y) * LOW_PASS + LOW_PASS * LOW_PASS
    xy = _dot(a00, a01, a02, a10, a11, a12)
    return norm_x + LOW_PASS, xy, norm_y + LOW_PASS, 1.0 / determinant


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


@kernel
def project(
    first, last, means, quaternions, scales, opacities, offsets, camera, footprints, keys, radii, finite
):
    """Project Gaussians ``first … last − 1``.

    In: ``means`` ``[3N]``, ``quaternions`` ``[4N]``, ``scales`` ``[3N]``, ``opacities`` ``[N]``, ``offsets``
    ``[2N]`` or ``[0]``, all flat; ``camera`` of ``camera_array``. Out: ``footprints`` ``[FOOTPRINT · N]``,
    ``keys`` ``[N]`` uint32: the depth's bits (which sort like the depth, as it is positive) or ``NOT_DRAWN``,
    ``radii`` ``[N]`` px; ``finite[0]`` becomes False if any input is NaN or infinite.
    """
    group = np.empty(FOOTPRINT * LANES + LANES, np.float32)  # one group of Gaussians, field by field
    bits = group.view(np.uint32)
    opacity_row, depth_row = BIAS * LANES, FOOTPRINT * LANES
    all_finite = True
    checksum = splat(0.0)
    for i in range(first, last, LANES):
        n = min(LANES, last - i)
        x, y, z, w, qx, qy, qz, s0, s1, s2, unit = _load_gaussians(i, n, means, quaternions, scales)
        opacity = load_strided(opacities, i, 1, n)
        # x · 0 is 0 for a finite x and NaN for any other.
        checksum = checksum + (x + y + z + w + qx + qy + qz + unit + s0 + s1 + s2 + opacity) * 0.0

        P, A, _ = _to_screen(camera, x, y, z, w, qx, qy, qz, s0, s1, s2)
        depth, _, tan_x, tan_y, _, _, _, _ = P
        xx, xy, yy, inverse_determinant = _covariance(A)
        l11 = square_root(KAPPA * yy * inverse_determinant)
        store(fma(splat(camera[_FX]), tan_x, splat(camera[_CX])), group, MEAN_X * LANES)
        store(fma(splat(camera[_FY]), tan_y, splat(camera[_CY])), group, MEAN_Y * LANES)
        store(l11, group, L11 * LANES)
        store(-(KAPPA * xy * inverse_determinant) / l11, group, L21 * LANES)
        store(KAPPA / yy, group, Q * LANES)
        store(opacity, group, opacity_row)
        store(1.0 / l11, group, INVERSE_L11 * LANES)
        store(square_root(xx), group, HALF_WIDTH * LANES)
        store(square_root(yy), group, HALF_HEIGHT * LANES)
        store(xy / square_root(xx), group, RIGHTMOST_Y * LANES)
        store(depth, group, depth_row)

        for lane in range(n):
            g = i + lane
            mean_x, mean_y = group[MEAN_X * LANES + lane], group[MEAN_Y * LANES + lane]
            if offsets.size:
                mean_x += offsets[2 * g]
                mean_y += offsets[2 * g + 1]
                all_finite = all_finite and np.isfinite(offsets[2 * g]) and np.isfinite(offsets[2 * g + 1])
            keys[g] = NOT_DRAWN
            radii[g] = 0.0
            opacity_here = group[opacity_row + lane]
            if not (opacity_here >= ALPHA_MIN and group[depth_row + lane] >= NEAR_PLANE):
                continue
            # Where alpha falls to 1/255: dᵀ Σ⁻¹ d = 2 ln(255 · opacity); its bounding box.
            reach = np.float32(np.sqrt(max(2.0 * np.log(opacity_here / ALPHA_MIN), 0.0)))
            half_width = reach * group[HALF_WIDTH * LANES + lane]
            half_height = reach * group[HALF_HEIGHT * LANES + lane]
            # A covariance that overflows float32 (footprints of 10^9 px) is not drawn.
            if (
                group[L11 * LANES + lane] > 0
                and mean_x + half_width > 0
                and mean_x - half_width < camera[_WIDTH]
                and mean_y + half_height > 0
                and mean_y - half_height < camera[_HEIGHT]
            ):
                at = FOOTPRINT * g
                footprints[at + MEAN_X], footprints[at + MEAN_Y] = mean_x, mean_y
                footprints[at + L11], footprints[at + L21] = (
                    group[L11 * LANES + lane],
                    group[L21 * LANES + lane],
                )
                footprints[at + Q] = group[Q * LANES + lane]
                footprints[at + BIAS] = np.log2(opacity_here) * 0.125
                footprints[at + INVERSE_L11] = group[INVERSE_L11 * LANES + lane]
                footprints[at + HALF_WIDTH], footprints[at + HALF_HEIGHT] = half_width, half_height
                footprints[at + RIGHTMOST_Y] = reach * group[RIGHTMOST_Y * LANES + lane]
                keys[g] = bits[depth_row + lane]
                radii[g] = max(half_width, half_height)
    if not (all_finite and total(checksum) == 0.0):
        finite[0] = False


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
    slot_blocks,
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
    which those with ``slot_blocks[k] == 0`` contributed nothing and were never written. Outputs are flat
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
                if slot_blocks[k] != 0:
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
        a00, a01, a02, a10, a11, a12 = A
        b20, b21, b22 = B[6:]
        xx, xy, yy, inverse_determinant = _covariance(A)

        # K = Σ⁻¹; the screen mean; G = K M K (= 2 ∂L/∂Σ); ∂L/∂A = G A.
        ka, kb, kc = yy * inverse_determinant, -xy * inverse_determinant, xx * inverse_determinant
        grad_u, grad_v = ka * sum_x + kb * sum_y, kb * sum_x + kc * sum_y
        m00, m01 = sum_xx * ka + sum_xy * kb, sum_xx * kb + sum_xy * kc
        m10, m11 = sum_xy * ka + sum_yy * kb, sum_xy * kb + sum_yy * kc
        g00, g01, g11 = ka * m00 + kb * m10, ka * m01 + kb * m11, kb * m01 + kc * m11
        ga00, ga01, ga02 = g00 * a00 + g01 * a10, g00 * a01 + g01 * a11, g00 * a02 + g01 * a12
        ga10, ga11, ga12 = g01 * a00 + g11 * a10, g01 * a01 + g11 * a11, g01 * a02 + g11 * a12

        # A = J B with J = [[jx, 0, −jx · limited_x], [0, jy, −jy · limited_y]], jx = fx/z.
        gb00, gb01, gb02 = jx * ga00, jx * ga01, jx * ga02
        gb10, gb11, gb12 = jy * ga10, jy * ga11, jy * ga12
        gb20 = -(limited_x * gb00 + limited_y * gb10)
        gb21 = -(limited_x * gb01 + limited_y * gb11)
        gb22 = -(limited_x * gb02 + limited_y * gb12)
        # Rows of A are proportional to jx and jy, so jx · ∂L/∂jx = ⟨∂L/∂a₁, a₁⟩.
        through_j = _dot(ga00, ga01, ga02, a00, a01, a02) + _dot(ga10, ga11, ga12, a10, a11, a12)
        inside_x = (tan_x >= camera[_LOW_X]) & (tan_x <= camera[_HIGH_X])
        inside_y = (tan_y >= camera[_LOW_Y]) & (tan_y <= camera[_HIGH_Y])
        limit_x = select(inside_x, -_dot(gb00, gb01, gb02, b20, b21, b22), 0.0)
        limit_y = select(inside_y, -_dot(gb10, gb11, gb12, b20, b21, b22), 0.0)
        grad_tan_x, grad_tan_y = camera[_FX] * grad_u + limit_x, camera[_FY] * grad_v + limit_y
        grad_px, grad_py = grad_tan_x * inverse_z, grad_tan_y * inverse_z
        grad_pz = -(through_j + grad_tan_x * tan_x + grad_tan_y * tan_y) * inverse_z

        # B = V R S. With C = Vᵀ ∂L/∂B: ∂L/∂s_j = Σ_i R_ij C_ij and ∂L/∂R_ij = C_ij s_j.
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = _rotation(w, qx, qy, qz)
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
        grad_s0 = _dot(r00, r10, r20, c00, c10, c20)
        grad_s1 = _dot(r01, r11, r21, c01, c11, c21)
        grad_s2 = _dot(r02, r12, r22, c02, c12, c22)
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
