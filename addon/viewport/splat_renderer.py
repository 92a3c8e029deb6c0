# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws Gaussians of several objects into one picture: projected, sorted together, blended.

The picture is the trainer's (backend/rasterize/contract.py), except that blending goes from back to front
and so never ends early: what lies behind a transmittance of 1e-4 still counts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import gpu
import numpy as np

from ...bridge.spherical_harmonics import MAX_DEGREE
from ...bridge.splatting import NEAR_PLANE
from ..model.tone_curve import ToneCurve
from . import gpu_arrays, splat_shaders
from .camera import ViewCamera, object_to_camera
from .chunks import CHUNK
from .depth_order import back_to_front
from .overlay import Layer
from .splat_data import WIDTH, Marks, SplatTextures

#: Gaussians in one draw call. A triangle each: in software a third faster than quads for small pictures, the
#: same for large ones; and one large call, not an instance each, is what GPUs like.
TRIANGLES = 1 << 16
#: Rows of Gaussians in one picture, instances counted: numbers of texels are floats, exact up to 2²⁴.
ROWS_MAX = (1 << 24) // WIDTH
#: A map whose determinant is below this share of its largest stretch's cube is flat: it shows nothing.
FLATTEST = 1e-12


@dataclass(frozen=True, eq=False)
class Item:
    """One object to draw. ``matrix_world``: ``[4, 4]``; ``levels``: of its lights, those that are not given
    at 1; ``exposure``: EV."""

    splats: SplatTextures
    matrix_world: np.ndarray
    levels: tuple[float, ...] = ()
    exposure: float = 0.0
    #: ``False``: only the constant term of the spherical harmonics.
    view_dependent: bool = True
    #: Of the spherical harmonics only those up to this degree.
    sh_limit: int = MAX_DEGREE
    #: What is drawn, and what is drawn in the colour of a selection; ``None``: all, and nothing.
    kept: Marks | None = None
    selected: Marks | None = None

    @property
    def degree(self) -> int:
        """The degree of the spherical harmonics that are drawn."""
        return min(self.splats.degree, self.sh_limit) if self.view_dependent else 0

    @property
    def key(self) -> tuple[int, bytes, tuple[float, ...], float, int, int | None, int | None]:
        """Equal for items that look the same; hashable."""
        pose = self.matrix_world.tobytes()
        kept = self.kept.serial if self.kept else None
        selected = self.selected.serial if self.selected else None
        return self.splats.serial, pose, self.levels, self.exposure, self.degree, kept, selected


class Target:
    """A picture in the making: colour and Σ weight · depth."""

    def __init__(self, width: int, height: int, format: gpu_arrays.Texels | None = None) -> None:
        """``format`` of the colours: ``RGBA32F`` or ``RGBA16F``; the best that can be blended if ``None``."""
        self.size = width, height
        # Apple's GPUs do not blend full floats.
        format = format or ("RGBA16F" if gpu.platform.backend_type_get() == "METAL" else "RGBA32F")
        self.colour = gpu.types.GPUTexture((width, height), format=format)
        self.depth = gpu.types.GPUTexture((width, height), format="R32F")
        self.framebuffer = gpu.types.GPUFrameBuffer(color_slots=(self.colour, self.depth))
        with gpu_arrays.bound(self.framebuffer):
            self.framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))

    def wait(self) -> None:
        """Until the GPU has drawn everything so far: by reading one pixel."""
        with gpu_arrays.bound(self.framebuffer):
            self.framebuffer.read_color(0, 0, 1, 1, 4, 0, "FLOAT")

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """``[H, W, 4]`` premultiplied colour, ``[H, W]`` mean depth (0: nothing there), top row first."""
        colour = gpu_arrays.read_colour(self.framebuffer, self.size)
        total = gpu_arrays.read_colour(self.framebuffer, self.size, slot=1, channels=1)[..., 0]
        alpha = colour[..., 3]
        return colour, np.divide(total, alpha, out=np.zeros_like(total), where=alpha > 0.0)


class Drawing:
    """One picture of some items, drawn at once or, where the GPU is slow, in portions."""

    def __init__(
        self,
        renderer: "SplatRenderer",
        target: Target,
        camera: ViewCamera,
        order: np.ndarray,
        depth: float,
        is_exact: bool,
    ) -> None:
        """``order`` ``[N]``: texels, the farthest first; −1 − the texel where it is selected."""
        self.target = target
        self.camera = camera
        #: Typical distance of what is drawn, metres.
        self.typical_depth = depth
        self.count = len(order)
        #: Whether the order is that of the depths to the last bit.
        self.is_exact = is_exact
        self._renderer = renderer
        self._drawn = 0
        rows = max(1, math.ceil(self.count / WIDTH))
        # As floats, the only numbers that can be uploaded: exact up to 16.7 M.
        texels = np.zeros((rows * WIDTH, 1), np.float32)
        texels[: self.count, 0] = order
        self._order = gpu_arrays.texture(texels.reshape(rows, WIDTH, 1), "R32F")

    @property
    def is_complete(self) -> bool:
        return self._drawn == self.count

    def draw(self, count: int | None = None) -> None:
        """Blend the next ``count`` Gaussians (``None``: all that are left)."""
        remaining = self.count - self._drawn
        count = remaining if count is None else min(count, remaining)
        if count > 0:
            self._renderer.blend(self.target, self._order, self._drawn, count)
        self._drawn += count

    def layer(self, tone: ToneCurve | None) -> Layer:
        """The picture, for the compositor."""
        target = self.target
        return Layer(target.colour, target.depth, self.camera, self.typical_depth, tone, depth_is_sum=True)


class SplatRenderer:
    """Holds the shaders and the projected Gaussians of one region; needs an active GPU context.

    ``begin`` overwrites what an earlier ``Drawing`` of the same renderer still needs: finish or forget it.
    """

    def __init__(self) -> None:
        self._projection = splat_shaders.create_projection()
        self._drawing = splat_shaders.create_drawing()
        self._triangles = gpu_arrays.triangles(TRIANGLES)
        self._rows = 0
        self._projected: list[gpu.types.GPUTexture] = []
        self._framebuffer: gpu.types.GPUFrameBuffer | None = None
        #: Scene-linear: selected Gaussians are drawn in shades of it.
        self.selection_colour = (1.0, 0.2, 0.0)
        #: Of the items last projected: a sampler does not keep its texture.
        self._levels: list[gpu.types.GPUTexture] = []

    def begin(
        self, items: Sequence[Item], camera: ViewCamera, target: Target, *, exact_count: int | None = None
    ) -> Drawing:
        """Project and sort what of the items a camera of the target's size may see.

        More than ``exact_count`` are sorted roughly (``back_to_front``); ``None``: never.
        """
        drawn = _in_view(items, camera)
        self._reserve(sum(item.splats.rows for item, _, _ in drawn))
        depths, texels, first_row = [np.empty(0, np.float32)], [np.empty(0, np.int64)], 0
        self._levels.clear()
        for item, to_camera, chunks in drawn:
            self._project(item, camera, to_camera, first_row, chunks)
            depth, texel = _seen(item, camera, to_camera, chunks)
            depths.append(depth)
            is_selected = item.selected.values[texel] if item.selected else None
            texel = texel + first_row * WIDTH
            texels.append(texel if is_selected is None else np.where(is_selected, -1 - texel, texel))
            first_row += item.splats.rows
        depth, texel = np.concatenate(depths), np.concatenate(texels)
        typical = float(np.median(depth[:: max(1, depth.size // 4096)])) if depth.size else 1.0
        is_exact = exact_count is None or depth.size <= exact_count
        return Drawing(self, target, camera, texel[back_to_front(depth, is_exact)], typical, is_exact)

    def render(
        self, items: Sequence[Item], camera: ViewCamera, *, format: gpu_arrays.Texels | None = None
    ) -> Target:
        """The whole picture at once."""
        target = Target(camera.width, camera.height, format)
        self.begin(items, camera, target).draw()
        return target

    def blend(self, target: Target, order: gpu.types.GPUTexture, first: int, count: int) -> None:
        """Blend Gaussians ``first`` … of ``order`` over the target."""
        shader = self._drawing
        with gpu_arrays.bound(target.framebuffer):
            shader.bind()
            shader.uniform_float("size", target.size)
            shader.uniform_float("tint", self.selection_colour)
            shader.uniform_sampler("order", order)
            for name, texture in zip(("place", "axes", "radiance"), self._projected, strict=True):
                shader.uniform_sampler(f"projected_{name}", texture)
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            gpu.state.blend_set("ALPHA_PREMULT")
            for start in range(first, first + count, TRIANGLES):
                shader.uniform_int("first", [start])
                triangles = min(TRIANGLES, first + count - start)
                self._triangles.draw_range(shader, elem_start=0, elem_count=3 * triangles)
            gpu.state.blend_set("NONE")

    def _reserve(self, rows: int) -> None:
        if rows > self._rows:
            self._projected = [gpu.types.GPUTexture((WIDTH, rows), format="RGBA32F") for _ in range(3)]
            self._framebuffer = gpu.types.GPUFrameBuffer(color_slots=tuple(self._projected))
            self._rows = rows

    def _project(
        self, item: Item, camera: ViewCamera, to_camera: np.ndarray, first_row: int, chunks: np.ndarray
    ) -> None:
        splats, shader = item.splats, self._projection
        from_camera = np.linalg.inv(to_camera)
        if camera.is_orthographic:
            eye = from_camera[:3, 2] / np.linalg.norm(from_camera[:3, 2])
        else:
            eye = from_camera[:3, 3]
        index, blend = level_place(splats.levels, item.levels[0] if item.levels else 1.0)
        # The first level that is blended, or how many lights have levels of their own.
        first = index if splats.levels else splats.lights
        flags = item.degree
        flags |= splat_shaders.ORTHOGRAPHIC if camera.is_orthographic else 0
        flags |= splat_shaders.HAS_LEVELS if splats.levels else 0
        framebuffer = self._framebuffer
        assert framebuffer is not None  # _reserve made it
        with gpu_arrays.bound(framebuffer):
            framebuffer.viewport_set(0, first_row, WIDTH, splats.rows)
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            gpu.state.blend_set("NONE")
            shader.bind()
            gpu_arrays.set_matrix(shader, "object_to_camera", to_camera)
            shader.uniform_float("lens", (camera.fx, camera.fy, camera.cx, camera.cy))
            shader.uniform_float("size_and_blend", (camera.width, camera.height, blend, 0.0))
            shader.uniform_float("eye_and_gain", (*eye, 2.0**item.exposure))
            shader.uniform_int("counts", (first_row, splats.count, first, flags))
            shader.uniform_sampler("geometry", splats.geometry)
            shader.uniform_sampler("harmonics", splats.harmonics)
            shader.uniform_sampler("light", splats.light)
            self._levels.append(levels_texture(item.levels, splats.lights))
            shader.uniform_sampler("levels", self._levels[-1])
            _rectangles(chunks, splats.rows).draw(shader)
            framebuffer.viewport_set(0, 0, WIDTH, self._rows)


def _in_view(items: Sequence[Item], camera: ViewCamera) -> list[tuple[Item, np.ndarray, np.ndarray]]:
    """The items that may show something, as many of the nearest as a picture holds, in the items' order.

    With each its ``object_to_camera`` ``[4, 4]`` and the indices of its chunks that may be seen.
    """
    found: list[tuple[Item, np.ndarray, np.ndarray]] = []
    for item in items:
        to_camera = object_to_camera(camera, item.matrix_world)
        if is_flat(to_camera):
            continue
        chunks = item.splats.chunks.visible(camera, to_camera)
        if len(chunks):
            found.append((item, to_camera, chunks))
    if sum(item.splats.rows for item, _, _ in found) <= ROWS_MAX:
        return found
    middles = [item.splats.chunks.centre[chunks].mean(axis=0) for item, _, chunks in found]
    away = [
        np.linalg.norm(to[:3, :3] @ at + to[:3, 3]) for (_, to, _), at in zip(found, middles, strict=True)
    ]
    nearest, rows = set[int](), 0
    for index in np.argsort(away, kind="stable").tolist():
        rows += found[index][0].splats.rows
        if nearest and rows > ROWS_MAX:
            break
        nearest.add(index)
    return [each for index, each in enumerate(found) if index in nearest]


def is_flat(matrix: np.ndarray) -> bool:
    """Whether a map ``[4, 4]`` makes all of space a plane, a line or a point, or is none at all."""
    linear = np.asarray(matrix, np.float64)[:3, :3]
    if not np.isfinite(matrix).all():
        return True
    return not abs(np.linalg.det(linear)) > FLATTEST * np.linalg.norm(linear) ** 3


def _seen(
    item: Item, camera: ViewCamera, to_camera: np.ndarray, chunks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depths ``[M]`` and texels ``[M]`` of what of these chunks is drawn: kept, in front of the camera."""
    splats = item.splats
    forward = to_camera[2].astype(np.float32)
    if len(chunks) == len(splats.chunks.radius):
        texel, position = np.arange(splats.count), splats.position
    else:
        texel = (chunks[:, None] * CHUNK + np.arange(CHUNK)).reshape(-1)
        if chunks[-1] == len(splats.chunks.radius) - 1:
            texel = texel[texel < splats.count]
        position = splats.position[texel]
    depth = position @ forward[:3] + forward[3]
    is_drawn = item.kept.values[texel] if item.kept else None
    if not camera.is_orthographic:
        in_front = depth >= NEAR_PLANE
        is_drawn = in_front if is_drawn is None else is_drawn & in_front
    if is_drawn is None or is_drawn.all():
        return depth, texel
    return depth[is_drawn], texel[is_drawn]


def _rectangles(chunks: np.ndarray, rows: int) -> gpu.types.GPUBatch:
    """Where the texels of chunks are in ``rows`` rows of them: two triangles for each run in a row."""
    across = WIDTH // CHUNK
    starts = np.flatnonzero((np.diff(chunks, prepend=-2) != 1) | (chunks % across == 0))
    first, last = chunks[starts], chunks[np.append(starts[1:], len(chunks)) - 1]
    left, right = 2.0 * (first % across) / across - 1.0, 2.0 * (last % across + 1) / across - 1.0
    low, high = 2.0 * (first // across) / rows - 1.0, 2.0 * (first // across + 1) / rows - 1.0
    corners = [(left, low), (right, low), (right, high), (left, low), (right, high), (left, high)]
    return gpu_arrays.batch("TRIS", np.array(corners, np.float32).transpose(2, 0, 1).reshape(-1, 2))


def levels_texture(levels: Sequence[float], lights: int) -> gpu.types.GPUTexture:
    """One texel a light: there are no more than 128 bytes of push constants, and any number of lights."""
    texels = np.ones((1, max(1, lights), 1), np.float32)
    count = min(len(levels), lights)
    texels[0, :count, 0] = levels[:count]
    return gpu_arrays.texture(texels, "R32F")


def level_place(levels: Sequence[float], level: float) -> tuple[int, float]:
    """Where ``level`` is in ``levels`` (log2 apart): the index below it and how far to the next, 0…1."""
    if not levels:
        return 0, 0.0
    limited = min(max(level, levels[0]), levels[-1])
    place = float(np.interp(math.log2(limited), np.log2(levels), np.arange(len(levels))))
    index = min(int(place), max(len(levels) - 2, 0))
    return index, place - index
