# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of Gaussians in the 3D view: scene-linear, and hidden by or covering its objects by depth.

How, found in Blender 5.2.2 (OpenGL and Vulkan; Solid, Material Preview, Rendered with EEVEE and Cycles):

* A view has a scene-linear half float colour buffer, into which the engines draw, an 8-bit overlay buffer
  (grid, outlines, and the theme's background where the scene is transparent), which Blender adds *after*
  the view transform, and a depth buffer that both share.
* ``POST_VIEW`` handlers draw into the overlay buffer: no view transform, clipped at 1. ``PRE_VIEW``
  handlers draw into the colour buffer, but the engines then overwrite it.
* So: in PRE_VIEW the active framebuffer (colour and depth) is kept, and in POST_VIEW, when the engines
  are done, it is bound again. There 0.18 and 8.0 come out as a plane of that emission does, with
  Standard and AgX, and the depth test against the scene's objects works, in Cycles too.
* The overlay buffer still holds the grid and the background behind the picture. A second pass multiplies
  it by 1 − alpha, with the same depth test.

What follows from it: lines of the overlay that have a depth (wires, the grid) are in front of what is
farther, like objects. With overlays off Cycles gives the view no depth at all (``hint`` says so to people).
The depth buffer is not written. Each pixel has one depth (the mean of what covers it): an object is in front
of all that the pixel shows of the Gaussians, or behind it.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import bpy
import gpu
import numpy as np

from ...bridge.errors import DataMismatchError
from ..model.tone_curve import ToneCurve
from . import gpu_arrays, overlay_shader
from .camera import OPENGL_TO_OPENCV, ViewCamera, between, has_jumped, of_region
from .overlay_shader import Flag
from .seen import texels

#: Every so many pixels of a picture are asked for its typical depth.
_DEPTH_STRIDE = 8


@dataclass(frozen=True, eq=False)
class RenderedView:
    """What a backend rendered for a camera: colours with depths. Raises ``DataMismatchError`` where their
    sizes do not agree with it.
    """

    #: ``[H, W, 4]`` float16 or float32: scene-linear, premultiplied, top row first.
    rgba: np.ndarray
    #: ``[H, W]`` float32: metres along the optical axis; any number where alpha is 0.
    depth: np.ndarray
    #: The camera that it was rendered for; need not be where the view is now.
    camera: ViewCamera
    #: Shown through this response; ``None``: scene-linear, Blender's view transform alone.
    tone: ToneCurve | None = None

    def __post_init__(self) -> None:
        expected = (self.camera.height, self.camera.width)
        if self.rgba.shape != (*expected, 4) or self.depth.shape != expected:
            raise DataMismatchError(
                f"a picture for {expected[1]}×{expected[0]} pixels has colours {list(self.rgba.shape)} and "
                f"depths {list(self.depth.shape)}"
            )

    @cached_property
    def typical_depth(self) -> float:
        """The median depth of what it shows, metres."""
        alpha = self.rgba[::_DEPTH_STRIDE, ::_DEPTH_STRIDE, 3]
        depth = self.depth[::_DEPTH_STRIDE, ::_DEPTH_STRIDE]
        covered = depth[(alpha > 0.5) & (depth > 0.0)]
        return float(np.median(covered)) if covered.size else 1.0


@dataclass(frozen=True, eq=False)
class Layer:
    """A picture on the GPU. ``plane_depth``: where it stands for a camera that has moved since, metres."""

    colour: gpu.types.GPUTexture
    depth: gpu.types.GPUTexture
    camera: ViewCamera
    plane_depth: float
    tone: ToneCurve | None = None
    top_row_first: bool = False
    #: The depths are Σ weight · depth, to be divided by alpha.
    depth_is_sum: bool = False
    #: ``[K, 3, 4]``: what cameras saw of the world (``seen``), beyond which it is dimmed; ``None``:
    #: nothing is.
    frustums: np.ndarray | None = None

    @cached_property
    def seen(self) -> gpu.types.GPUTexture | None:
        """``frustums`` as the shader has them: uploaded once for both passes of a redraw."""
        if self.frustums is None:
            return None
        return gpu_arrays.texture(texels(self.frustums, self.camera), "RGBA32F")


#: Gives the layers of a region, the farthest first; called while it is drawn.
Source = Callable[[bpy.types.Context, ViewCamera], Iterable[Layer]]
#: Draws into the overlay buffer, over the pictures, with the view's matrices.
Annotation = Callable[[bpy.types.Context], None]


def upload(picture: RenderedView) -> Layer:
    """The picture on the GPU; needs an active GPU context (a draw handler)."""
    # Full floats: they are what Blender uploads, and the driver need not convert them.
    colour = gpu_arrays.texture(np.asarray(picture.rgba, np.float32), "RGBA32F")
    depth = gpu_arrays.texture(np.asarray(picture.depth, np.float32)[..., None], "R32F")
    return Layer(colour, depth, picture.camera, picture.typical_depth, picture.tone, top_row_first=True)


def _flags(layer: Layer, erase: bool) -> int:
    wanted = {
        Flag.ORTHOGRAPHIC: layer.camera.is_orthographic,
        Flag.TOP_ROW_FIRST: layer.top_row_first,
        Flag.DEPTH_IS_SUM: layer.depth_is_sum,
        Flag.USE_TONE: layer.tone is not None,
        Flag.ERASE: erase,
        Flag.FADE: layer.frustums is not None,
    }
    return sum(flag for flag, is_set in wanted.items() if is_set)


class Compositor:
    """Draws layers into the bound framebuffer by depth. Holds the shader and the tone curves' textures."""

    def __init__(self) -> None:
        self._shader = overlay_shader.create()
        corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
        self._card = gpu_arrays.batch("TRI_STRIP", corners)
        self._curves: dict[bytes, tuple[gpu.types.GPUTexture, float, float]] = {}
        blank = np.zeros((1, 1, 4), np.float32)
        self._no_curve = (gpu_arrays.texture(blank, "RGBA32F"), 0.0, 1.0)

    def draw(self, layer: Layer, view: ViewCamera, window_matrix: np.ndarray, *, erase: bool = False) -> None:
        """Draw over what is there, where the depth buffer allows it.

        ``view``: the region's camera now, ``window_matrix``: its projection, ``[4, 4]``. ``erase``:
        multiply by 1 − alpha instead. Leaves blending and depth test as a fresh draw handler has them.
        """
        shader, source = self._shader, layer.camera
        texture, start, step = self._curve(layer.tone)
        picture_to_clip = window_matrix @ OPENGL_TO_OPENCV @ between(source, view)
        layer.colour.filter_mode(True)
        shader.bind()
        gpu_arrays.set_matrix(shader, "picture_to_clip", picture_to_clip)
        shader.uniform_float("size_and_centre", (source.width, source.height, source.cx, source.cy))
        shader.uniform_float("focal_and_tone", (source.fx, source.fy, start, step))
        shader.uniform_float("plane_depth", layer.plane_depth)
        shader.uniform_int("flags", [_flags(layer, erase)])
        shader.uniform_sampler("picture", layer.colour)
        shader.uniform_sampler("picture_depth", layer.depth)
        shader.uniform_sampler("tone_curve", texture)
        shader.uniform_sampler("frustums", layer.seen or self._no_curve[0])
        gpu.state.blend_set("MULTIPLY" if erase else "ALPHA_PREMULT")
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.depth_mask_set(False)
        self._card.draw(shader)
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")

    def _curve(self, tone: ToneCurve | None) -> tuple[gpu.types.GPUTexture, float, float]:
        if tone is None:
            return self._no_curve
        if tone.key not in self._curves:
            values, start, step = tone.resampled(overlay_shader.TONE_SAMPLES)
            texels = np.ones((1, len(values), 4), np.float32)
            texels[0, :, :3] = values
            self._curves[tone.key] = gpu_arrays.texture(texels, "RGBA32F"), start, step
        return self._curves[tone.key]


class _Runtime:
    """What lives between two redraws. Never in the .blend."""

    def __init__(self) -> None:
        self.handlers: list[Any] = []
        self.sources: list[Source] = []
        self.annotations: dict[Source, Annotation] = {}
        self.pictures: dict[int, RenderedView] = {}
        self.layers: dict[int, tuple[RenderedView, Layer]] = {}
        self.compositor: Compositor | None = None
        self.scene_framebuffer: gpu.types.GPUFrameBuffer | None = None


_runtime = _Runtime()


def region_key(region: bpy.types.Region) -> int:
    """Tells the regions of all windows apart (a quad view has four in one area)."""
    return region.as_pointer()


def view_regions() -> Iterable[tuple[bpy.types.Area, bpy.types.Region]]:
    """Every region of every window in which a 3D view is drawn."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                yield from ((area, region) for region in area.regions if region.type == "WINDOW")


def set_picture(key: int, picture: RenderedView | None) -> None:
    """Show this in the region with that ``region_key`` from now on; ``None``: no longer. Redraws it.

    May be called from a timer: the upload happens when the region is drawn.
    """
    regions = {region_key(region): region for _, region in view_regions()}
    for known in [known for known in _runtime.pictures if known not in regions]:
        _forget(known)
    if picture is None:
        _forget(key)
    elif key in regions:
        _runtime.pictures[key] = picture
    if key in regions:
        regions[key].tag_redraw()


def clear() -> None:
    """Show no picture in any region."""
    for key in list(_runtime.pictures):
        _forget(key)
    redraw_all()


def hint(space: bpy.types.SpaceView3D, scene: bpy.types.Scene) -> str:
    """Why pictures are not hidden by the scene's objects in this view, for people; empty where they are."""
    draws_itself = scene.render.engine in ("BLENDER_EEVEE", "BLENDER_WORKBENCH")
    if space.shading.type == "RENDERED" and not draws_itself and not space.overlay.show_overlays:
        return "Objects do not hide the Gaussians: without overlays this render engine gives no depth"
    return ""


def redraw_all() -> None:
    for _, region in view_regions():
        region.tag_redraw()


def add_source(source: Source, annotation: Annotation | None = None) -> None:
    """Let ``source`` give layers whenever a 3D view is drawn, and ``annotation`` draw over all of them."""
    _runtime.sources.append(source)
    if annotation is not None:
        _runtime.annotations[source] = annotation


def remove_source(source: Source) -> None:
    _runtime.sources.remove(source)
    _runtime.annotations.pop(source, None)


def _forget(key: int) -> None:
    _runtime.pictures.pop(key, None)
    _runtime.layers.pop(key, None)


def _layers(context: bpy.types.Context, view: ViewCamera) -> list[Layer]:
    layers = [layer for source in _runtime.sources for layer in source(context, view)]
    # Until there is a picture of where a view has jumped to, none is better than a torn one.
    layers = [layer for layer in layers if not has_jumped(layer.camera, view, layer.plane_depth)]
    key = region_key(context.region)
    picture = _runtime.pictures.get(key)
    if picture is not None and not has_jumped(picture.camera, view, picture.typical_depth):
        known = _runtime.layers.get(key)
        if known is None or known[0] is not picture:
            known = _runtime.layers[key] = picture, upload(picture)
        layers.append(known[1])
    return layers


def _before_scene() -> None:
    _runtime.scene_framebuffer = gpu.state.active_framebuffer_get()


def _after_scene() -> None:
    context = bpy.context
    scene_framebuffer, _runtime.scene_framebuffer = _runtime.scene_framebuffer, None
    if scene_framebuffer is None or context.region_data is None:
        return
    view = of_region(context.region, context.region_data)
    layers = _layers(context, view)
    if not layers:
        return
    if _runtime.compositor is None:
        _runtime.compositor = Compositor()
    window_matrix = np.array(context.region_data.window_matrix, np.float64)
    with gpu_arrays.bound(scene_framebuffer):
        for layer in layers:
            _runtime.compositor.draw(layer, view, window_matrix)
    for layer in layers:
        _runtime.compositor.draw(layer, view, window_matrix, erase=True)
    for annotation in _runtime.annotations.values():
        annotation(context)


def register() -> None:
    add = bpy.types.SpaceView3D.draw_handler_add
    _runtime.handlers = [
        add(_before_scene, (), "WINDOW", "PRE_VIEW"),
        add(_after_scene, (), "WINDOW", "POST_VIEW"),
    ]


def unregister() -> None:
    for handler in _runtime.handlers:
        bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
    _runtime.__init__()
    redraw_all()
