# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""EWA projection of Gaussians, which tiles each touches, and the exact backward pass: a thread a Gaussian.

The mathematics stand in ``cpu/projection.py``; here alpha is written with the natural logarithm:

    alpha = exp(bias − (l₁₁ dx + l₂₁ dy)² − q dy²),   bias = ln(opacity),
    l₁₁² = Σ_yy / (2 det),   l₁₁ l₂₁ = −Σ_xy / (2 det),   q = 1 / (2 Σ_yy)

A record is a multiple of four floats: mean x, mean y, l₁₁, l₂₁, q, bias, then the colours.
"""

# In kernels float(0.0) is a variable and 0.0 a constant, which no loop may change.
# ruff: noqa: RUF046, UP018

import math
import weakref

from ....bridge.splatting import ALPHA_MIN, JACOBIAN_MARGIN, LOW_PASS, NEAR_PLANE
from ...scene.camera import Camera
from .arrays import wp

#: Pixels of a tile's side.
TILE = 16
#: Floats of a record before the colours.
RECORD_HEAD = 6
#: ln alpha at which a Gaussian ends.
LOG_ALPHA_MIN = math.log(ALPHA_MIN)

#: Widening of ellipses, against rounding: pixels, and a fraction of the distances involved.
MARGIN = 0.01
RELATIVE_MARGIN = 1e-6

_EPSILON = 1e-12  # torch.nn.functional.normalize's
_INFINITY = math.inf
_MODULE = "physhdr_projection"


@wp.struct
class View:
    """A camera in kernels: world to camera (OpenCV axes), intrinsics, limits of the Jacobian."""

    R: wp.mat33
    t: wp.vec3
    fx: float
    fy: float
    cx: float
    cy: float
    width: float
    height: float
    low_x: float
    high_x: float
    low_y: float
    high_y: float


# A camera never changes (frozen, compared by identity).
_views: "weakref.WeakKeyDictionary[Camera, View]" = weakref.WeakKeyDictionary()


def view_of(camera: Camera) -> View:
    """The camera for kernels; made once."""
    view = _views.get(camera)
    if view is not None:
        return view
    view, matrix = View(), camera.world_to_camera
    view.R = wp.mat33(*matrix[:3, :3].reshape(-1).tolist())
    view.t = wp.vec3(*matrix[:3, 3].tolist())
    view.fx, view.fy, view.cx, view.cy = camera.fx, camera.fy, camera.cx, camera.cy
    view.width, view.height = float(camera.width), float(camera.height)
    margin_x = JACOBIAN_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = JACOBIAN_MARGIN * 0.5 * camera.height / camera.fy
    view.low_x, view.high_x = (
        -(camera.cx / camera.fx + margin_x),
        (camera.width - camera.cx) / camera.fx + margin_x,
    )
    view.low_y, view.high_y = (
        -(camera.cy / camera.fy + margin_y),
        (camera.height - camera.cy) / camera.fy + margin_y,
    )
    _views[camera] = view
    return view


@wp.struct
class Projected:
    """A Gaussian on the screen, and what its backward pass asks for again."""

    depth: float
    inverse_z: float
    tan_x: float
    tan_y: float
    limited_x: float
    limited_y: float
    jx: float
    jy: float
    # Rows of A = J B, and the last row of B = V R(q) diag(s).
    a: wp.vec3
    b: wp.vec3
    b2: wp.vec3
    # Σ with the low-pass filter, and its determinant.
    xx: float
    xy: float
    yy: float
    determinant: float


@wp.func
def rotation_of(n: wp.vec4):
    """The rotation matrix of a unit quaternion (w, x, y, z)."""
    w = n[0]
    x = n[1]
    y = n[2]
    z = n[3]
    return wp.mat33(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@wp.func
def unit_of(q: wp.vec4):
    return q / wp.max(wp.length(q), _EPSILON)


@wp.func
def to_screen(p: wp.vec3, rotation: wp.mat33, s: wp.vec3, view: View):
    """Paper eq. 1; behind the near plane finite and meaningless."""
    out = Projected()
    c = view.R * p + view.t
    out.depth = c[2]
    out.inverse_z = 1.0 / wp.max(c[2], NEAR_PLANE)
    out.tan_x = c[0] * out.inverse_z
    out.tan_y = c[1] * out.inverse_z
    out.limited_x = wp.clamp(out.tan_x, view.low_x, view.high_x)
    out.limited_y = wp.clamp(out.tan_y, view.low_y, view.high_y)
    out.jx = view.fx * out.inverse_z
    out.jy = view.fy * out.inverse_z
    B = view.R * rotation
    b0 = wp.cw_mul(wp.vec3(B[0, 0], B[0, 1], B[0, 2]), s)
    b1 = wp.cw_mul(wp.vec3(B[1, 0], B[1, 1], B[1, 2]), s)
    out.b2 = wp.cw_mul(wp.vec3(B[2, 0], B[2, 1], B[2, 2]), s)
    out.a = out.jx * (b0 - out.limited_x * out.b2)
    out.b = out.jy * (b1 - out.limited_y * out.b2)
    aa = wp.dot(out.a, out.a)
    bb = wp.dot(out.b, out.b)
    out.xx = aa + LOW_PASS
    out.xy = wp.dot(out.a, out.b)
    out.yy = bb + LOW_PASS
    # |a × b|² instead of xx · yy − xy²: nothing cancels for needles.
    normal = wp.cross(out.a, out.b)
    out.determinant = wp.dot(normal, normal) + LOW_PASS * (aa + bb) + LOW_PASS * LOW_PASS
    return out


@wp.func
def tiles_between(middle: float, half: float, size: float):
    """First and last tile with a pixel whose centre lies within ``middle`` ± ``half``; first > last if none.

    Clamped as floats before they become integers: huge Gaussians reach beyond what an integer holds.
    """
    wide = half + (wp.abs(middle) + half) * RELATIVE_MARGIN + MARGIN
    first = wp.max(wp.ceil(middle - wide - 0.5), 0.0)
    last = wp.min(wp.floor(middle + wide - 0.5), size - 1.0)
    if last < first:
        return wp.vec2i(0, -1)
    return wp.vec2i(int(first) // TILE, int(last) // TILE)


@wp.struct
class Footprint:
    """Where {alpha ≥ 1/255} is: an ellipse, in tiles."""

    mean_x: float
    mean_y: float
    half_width: float
    half_height: float
    inverse_l11: float
    l21: float
    q: float
    extent: float
    peak: float
    columns: wp.vec2i
    rows: wp.vec2i


@wp.func
def footprint_of(mean_x: float, mean_y: float, l11: float, l21: float, q: float, bias: float, view: View):
    out = Footprint()
    out.mean_x = mean_x
    out.mean_y = mean_y
    out.inverse_l11 = 1.0 / l11
    out.l21 = l21
    out.q = q
    out.extent = wp.max(bias - LOG_ALPHA_MIN, 0.0)
    out.half_width = wp.sqrt(out.extent * (1.0 + l21 * l21 / q)) * out.inverse_l11
    out.half_height = wp.sqrt(out.extent / q)
    # dy at which the right edge is farthest right; the left edge's is −peak (cpu/projection.py).
    out.peak = -l21 * wp.sqrt(out.extent / (q * (q + l21 * l21)))
    out.columns = tiles_between(mean_x, out.half_width, view.width)
    out.rows = tiles_between(mean_y, out.half_height, view.height)
    if out.columns[1] < out.columns[0]:
        out.rows = wp.vec2i(0, -1)
    return out


@wp.func
def columns_in_row(f: Footprint, row: int, view: View):
    """First and last tile that the ellipse touches in a row of tiles; first > last if none.

    Where the box of the ellipse is one tile wide or high, every tile of the box is touched.
    """
    if f.columns[0] == f.columns[1] or f.rows[0] == f.rows[1]:
        return f.columns
    low = float(row * TILE) + 0.5 - f.mean_y
    high = wp.min(low + float(TILE - 1), f.half_height)
    low = wp.max(low, -f.half_height)
    dy = wp.min(wp.max(f.peak, low), high)
    right = wp.sqrt(wp.max(f.extent - f.q * dy * dy, 0.0)) * f.inverse_l11 - f.l21 * f.inverse_l11 * dy
    dy = wp.min(wp.max(-f.peak, low), high)
    left = -wp.sqrt(wp.max(f.extent - f.q * dy * dy, 0.0)) * f.inverse_l11 - f.l21 * f.inverse_l11 * dy
    margin = MARGIN + RELATIVE_MARGIN * (wp.abs(f.mean_x) + f.half_width)
    first = wp.max(wp.ceil(f.mean_x + left - margin - 0.5), 0.0)
    last = wp.min(wp.floor(f.mean_x + right + margin - 0.5), view.width - 1.0)
    if last < first:
        return wp.vec2i(0, -1)
    return wp.vec2i(int(first) // TILE, int(last) // TILE)


@wp.kernel(enable_backward=False, module=_MODULE)
def project(
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[float],
    offsets: wp.array[wp.vec2],
    view: View,
    records: wp.array2d[float],
    depths: wp.array[float],
    radii: wp.array[float],
    counts: wp.array[int],
):
    """The head of every drawn Gaussian's record, its depth (∞ where it is not drawn), radius and tiles."""
    g = wp.tid()
    counts[g] = 0
    radii[g] = 0.0
    depths[g] = _INFINITY
    opacity = opacities[g]
    p = to_screen(means[g], rotation_of(unit_of(quaternions[g])), scales[g], view)
    mean_x = view.fx * p.tan_x + view.cx + offsets[g][0]
    mean_y = view.fy * p.tan_y + view.cy + offsets[g][1]
    conic = p.yy / p.determinant
    # A covariance that overflows float32 (footprints of 10^9 px) is not drawn.
    if opacity < ALPHA_MIN or p.depth < NEAR_PLANE or not (conic > 0.0) or not wp.isfinite(p.xx + p.yy):
        return
    bias = wp.log(opacity)
    reach = wp.sqrt(wp.max(2.0 * (bias - LOG_ALPHA_MIN), 0.0))
    half_width = reach * wp.sqrt(p.xx)
    half_height = reach * wp.sqrt(p.yy)
    if mean_x + half_width <= 0.0 or mean_x - half_width >= view.width:
        return
    if mean_y + half_height <= 0.0 or mean_y - half_height >= view.height:
        return
    l11 = wp.sqrt(0.5 * conic)
    l21 = -0.5 * p.xy / p.determinant / l11
    q = 0.5 / p.yy
    radii[g] = wp.max(half_width, half_height)
    records[g, 0] = mean_x
    records[g, 1] = mean_y
    records[g, 2] = l11
    records[g, 3] = l21
    records[g, 4] = q
    records[g, 5] = bias
    f = footprint_of(mean_x, mean_y, l11, l21, q, bias, view)
    count = int(0)
    for row in range(f.rows[0], f.rows[1] + 1):
        columns = columns_in_row(f, row, view)
        count += columns[1] - columns[0] + 1
    counts[g] = count
    if count > 0:
        depths[g] = p.depth


@wp.kernel(enable_backward=False, module=_MODULE)
def emit(
    order: wp.array[wp.int64],
    counts: wp.array[int],
    ends: wp.array[wp.int64],
    records: wp.array2d[float],
    view: View,
    tiles_x: int,
    nowhere: int,
    tiles: wp.array[int],
    gaussians: wp.array[int],
):
    """Every (Gaussian, tile) pair, Gaussians in the order of their depth.

    What ``project`` counted is what is written, whatever a compiler makes of the same lines in another
    kernel (it may fuse other products and sums): pairs that are not found are ``nowhere``, which sorts last.
    """
    i = wp.tid()
    g = int(order[i])
    count = counts[g]
    if count == 0:
        return
    end = int(ends[i])
    at = end - count
    f = footprint_of(
        records[g, 0], records[g, 1], records[g, 2], records[g, 3], records[g, 4], records[g, 5], view
    )
    for row in range(f.rows[0], f.rows[1] + 1):
        columns = columns_in_row(f, row, view)
        for column in range(columns[0], columns[1] + 1):
            if at < end:
                tiles[at] = row * tiles_x + column
                gaussians[at] = g
                at += 1
    while at < end:
        tiles[at] = nowhere
        gaussians[at] = g
        at += 1


@wp.kernel(enable_backward=False, module=_MODULE)
def project_backward(
    means: wp.array[wp.vec3],
    quaternions: wp.array[wp.vec4],
    scales: wp.array[wp.vec3],
    opacities: wp.array[float],
    radii: wp.array[float],
    view: View,
    sums: wp.array2d[float],
    grad_means: wp.array[wp.vec3],
    grad_quaternions: wp.array[wp.vec4],
    grad_scales: wp.array[wp.vec3],
    grad_opacities: wp.array[float],
    grad_offsets: wp.array[wp.vec2],
):
    """From the moments S, Sx, Sy, Sxx, Sxy, Syy of ``sums`` to the inputs (cpu/projection.py derives it)."""
    g = wp.tid()
    if radii[g] == 0.0:
        grad_means[g] = wp.vec3()
        grad_quaternions[g] = wp.vec4()
        grad_scales[g] = wp.vec3()
        grad_opacities[g] = 0.0
        grad_offsets[g] = wp.vec2()
        return
    s = scales[g]
    q = quaternions[g]
    n = unit_of(q)
    rotation = rotation_of(n)
    p = to_screen(means[g], rotation, s, view)

    # K = Σ⁻¹; P = K A without what cancels in it; ∂L/∂A = K (M P).
    inverse = 1.0 / p.determinant
    K = wp.mat22(p.yy * inverse, -p.xy * inverse, -p.xy * inverse, p.xx * inverse)
    grad_uv = K * wp.vec2(sums[g, 1], sums[g, 2])
    normal = wp.cross(p.a, p.b)
    p0 = (wp.cross(p.b, normal) + LOW_PASS * p.a) * inverse
    p1 = (wp.cross(normal, p.a) + LOW_PASS * p.b) * inverse
    mp0 = sums[g, 3] * p0 + sums[g, 4] * p1
    mp1 = sums[g, 4] * p0 + sums[g, 5] * p1
    ga = K[0, 0] * mp0 + K[0, 1] * mp1
    gb = K[1, 0] * mp0 + K[1, 1] * mp1
    # ⟨∂L/∂A, A⟩ by columns, which is each scale's own gradient times it.
    by_scale = wp.cw_mul(p0, mp0) + wp.cw_mul(p1, mp1)

    # A = J B with J = [[jx, 0, −jx · limited_x], [0, jy, −jy · limited_y]], jx = fx/z.
    gb0 = p.jx * ga
    gb1 = p.jy * gb
    gb2 = -(p.limited_x * gb0 + p.limited_y * gb1)
    # Rows of A are proportional to jx and jy, so jx · ∂L/∂jx = ⟨∂L/∂a, a⟩.
    through_j = by_scale[0] + by_scale[1] + by_scale[2]
    grad_tan_x = view.fx * grad_uv[0]
    grad_tan_y = view.fy * grad_uv[1]
    # The clamp lets no gradient through where it acts.
    if p.tan_x >= view.low_x and p.tan_x <= view.high_x:
        grad_tan_x -= wp.dot(gb0, p.b2)
    if p.tan_y >= view.low_y and p.tan_y <= view.high_y:
        grad_tan_y -= wp.dot(gb1, p.b2)
    grad_z = -(through_j + grad_tan_x * p.tan_x + grad_tan_y * p.tan_y) * p.inverse_z
    to_world = wp.transpose(view.R)
    grad_means[g] = to_world * wp.vec3(grad_tan_x * p.inverse_z, grad_tan_y * p.inverse_z, grad_z)

    grad_scales[g] = wp.vec3(
        wp.where(s[0] != 0.0, by_scale[0] / s[0], 0.0),
        wp.where(s[1] != 0.0, by_scale[1] / s[1], 0.0),
        wp.where(s[2] != 0.0, by_scale[2] / s[2], 0.0),
    )

    # B = V R S. With C = Vᵀ ∂L/∂B: ∂L/∂R_ij = C_ij s_j.
    C = to_world * wp.matrix_from_rows(gb0, gb1, gb2)
    D = C * wp.diag(s)
    w = n[0]
    x = n[1]
    y = n[2]
    z = n[3]
    # ∂R/∂(unit quaternion), half of it; then q/|q| lets only what is orthogonal to it through.
    half = wp.vec4(
        x * (D[2, 1] - D[1, 2]) + y * (D[0, 2] - D[2, 0]) + z * (D[1, 0] - D[0, 1]),
        y * (D[0, 1] + D[1, 0]) + z * (D[0, 2] + D[2, 0]) + w * (D[2, 1] - D[1, 2])
        - 2.0 * x * (D[1, 1] + D[2, 2]),
        x * (D[0, 1] + D[1, 0]) + z * (D[1, 2] + D[2, 1]) + w * (D[0, 2] - D[2, 0])
        - 2.0 * y * (D[0, 0] + D[2, 2]),
        x * (D[0, 2] + D[2, 0]) + y * (D[1, 2] + D[2, 1]) + w * (D[1, 0] - D[0, 1])
        - 2.0 * z * (D[0, 0] + D[1, 1]),
    )  # fmt: skip
    grad_quaternions[g] = (2.0 / wp.max(wp.length(q), _EPSILON)) * (half - wp.dot(n, half) * n)
    grad_opacities[g] = sums[g, 0] / opacities[g]
    grad_offsets[g] = grad_uv


@wp.kernel(enable_backward=False, module=_MODULE)
def add_pairs(
    order: wp.array[wp.int64],
    counts: wp.array[int],
    ends: wp.array[wp.int64],
    of_pairs: wp.array2d[float],
    sums: wp.array2d[float],
):
    """The sums of every Gaussian over its pairs, always in the same order. A thread a number."""
    i, column = wp.tid()
    g = int(order[i])
    end = int(ends[i])
    total = float(0.0)
    for pair in range(end - counts[g], end):
        total += of_pairs[pair, column]
    sums[g, column] = total
