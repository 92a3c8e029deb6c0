# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported Gaussians in the 3D view, drawn here by shaders, relit by their modifier's inputs; no backend.

Which objects: point clouds with our attributes whose property *Viewport display* (``physhdr_viewport``) is
``SPLATS``. A change is drawn at once, as small as is needed to keep up; when the view rests it is drawn
sharp, in portions between which Blender stays responsive (one portion where the GPU is fast).
"""

import time
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import bpy
import numpy as np

from ..look import Look, look_of
from ..nodes import find_modifier
from ..point_cloud import Attribute, write_attribute
from . import overlay
from .camera import ViewCamera
from .overlay import Layer, ToneCurve
from .schedule import REST_SECONDS, ResolutionLadder
from .splat_data import SplatTextures, fingerprint, identity, is_splats, read_arrays, read_tone_curve
from .splat_renderer import Drawing, Item, SplatRenderer, Target

#: A redraw may spend about as long here.
BUDGET_SECONDS = 0.03
#: Up to as many Gaussians are always sorted exactly; more take too long while the view moves.
EXACT_SORT_COUNT = 300_000
#: The fewest Gaussians in a portion of a sharp picture, and those of the first. Fewer would not be quicker:
#: in software, whatever is drawn, reading and writing a large picture takes 15 ms.
PORTION = 8192


class Shown(NamedTuple):
    """An object to draw: as evaluated, and its point cloud as it is in the file."""

    evaluated: bpy.types.Object
    cloud: bpy.types.PointCloud
    look: Look


def shown_objects(
    view_layer: bpy.types.ViewLayer,
    depsgraph: bpy.types.Depsgraph,
    space: bpy.types.SpaceView3D | None = None,
) -> Iterator[Shown]:
    """The visible objects that are drawn as splats, in ``space`` (``None``: regardless of the view)."""
    for target in view_layer.objects:
        if target.type != "POINTCLOUD" or target.physhdr_viewport != "SPLATS":
            continue
        cloud = target.data
        if identity(cloud) in _runtime.hidden or not is_splats(cloud):
            continue
        if target.visible_get(view_layer=view_layer, **({"viewport": space} if space else {})):
            yield Shown(target.evaluated_get(depsgraph), cloud, look_of(target, depsgraph))


def items_by_tone(shown: Iterable[Shown]) -> dict[bytes, tuple[ToneCurve | None, list[Item]]]:
    """What to draw, grouped by tone curve (``b""``: scene-linear); needs an active GPU context."""
    groups: dict[bytes, tuple[ToneCurve | None, list[Item]]] = {}
    for evaluated, cloud, look in shown:
        tone = read_tone_curve(cloud) if look.tone_mapper else None
        _, items = groups.setdefault(tone.key if tone else b"", (tone, []))
        matrix_world = np.array(evaluated.matrix_world)
        items.append(
            Item(_textures(cloud), matrix_world, look.lighting_level, look.exposure_ev, look.view_dependent)
        )
    return groups


def set_hidden(identities: Iterable[str]) -> None:
    """Do not draw models with these identities (``splat_data.identity``): a live preview shows them."""
    _runtime.hidden = set(identities)
    overlay.redraw_all()


class _GroupView:
    """The picture of a group of objects in one region: what is shown, and what is being drawn."""

    def __init__(self) -> None:
        self._renderer = SplatRenderer()
        self._ladder = ResolutionLadder(BUDGET_SECONDS)
        self._signature: Any = None
        self._changed_at = 0.0
        self._shown: Drawing | None = None
        self._sharper: Drawing | None = None
        self._is_sharp = False
        self._portion = PORTION

    def update(self, items: list[Item], camera: ViewCamera) -> tuple[Drawing, float | None]:
        """The newest picture, and in how many seconds to ask for a better one (``None``: it is sharp)."""
        now = time.perf_counter()
        signature = (
            camera.key,
            [(item.splats.serial, item.matrix_world.tobytes(), item.level, item.exposure) for item in items],
        )
        if signature != self._signature or self._shown is None:
            self._signature, self._changed_at = signature, now
            self._draw_quickly(items, camera)
        elif not self._is_sharp and now - self._changed_at >= REST_SECONDS:
            self._sharpen(items, camera)
        assert self._shown is not None
        if self._is_sharp:
            return self._shown, None
        resting_in = self._changed_at + REST_SECONDS - time.perf_counter()
        return self._shown, max(0.0, resting_in)

    def _draw_quickly(self, items: list[Item], camera: ViewCamera) -> None:
        start, step = time.perf_counter(), self._ladder.step
        small = camera.scaled(self._ladder.scale)
        exact = sum(item.splats.count for item in items) <= EXACT_SORT_COUNT
        target = Target(small.width, small.height)
        self._shown = self._renderer.begin(items, small, target, exact=exact)
        self._shown.draw()
        target.wait()
        self._ladder.measured(time.perf_counter() - start, step)
        self._sharper = None
        self._is_sharp = step == 0 and exact

    def _sharpen(self, items: list[Item], camera: ViewCamera) -> None:
        """A portion of the sharp picture, as much as the budget allows."""
        end = time.perf_counter() + BUDGET_SECONDS
        if self._sharper is None:
            self._sharper = self._renderer.begin(items, camera, Target(camera.width, camera.height))
        while not self._sharper.is_complete:
            start = time.perf_counter()
            self._sharper.draw(self._portion)
            self._sharper.target.wait()
            now = time.perf_counter()
            if now - start < 0.25 * BUDGET_SECONDS:
                self._portion *= 2
            elif now - start > 0.5 * BUDGET_SECONDS:
                self._portion = max(PORTION, self._portion // 2)
            if now > end:
                return
        self._shown, self._sharper, self._is_sharp = self._sharper, None, True


class _Runtime:
    """GPU data and pictures. Everything can be made again; nothing is in the .blend."""

    def __init__(self) -> None:
        #: By the point cloud's session_uid: its fingerprint then, and the textures.
        self.textures: dict[int, tuple[tuple[int, ...], SplatTextures]] = {}
        #: session_uids of point clouds that may have changed since.
        self.suspects: set[int] = set()
        self.views: dict[tuple[int, bytes], _GroupView] = {}
        self.hidden: set[str] = set()


_runtime = _Runtime()


def _textures(cloud: bpy.types.PointCloud) -> SplatTextures:
    uid = cloud.session_uid
    if uid not in _runtime.textures or uid in _runtime.suspects:
        now = fingerprint(cloud)
        if uid not in _runtime.textures or _runtime.textures[uid][0] != now:
            _runtime.textures[uid] = now, SplatTextures(read_arrays(cloud))
        _runtime.suspects.discard(uid)
    return _runtime.textures[uid][1]


def _layers(context: bpy.types.Context, camera: ViewCamera) -> list[Layer]:
    """The overlay's source: pictures of all splats in the region that is being drawn."""
    depsgraph = context.view_layer.depsgraph
    if depsgraph is None:
        return []
    shown = shown_objects(context.view_layer, depsgraph, context.space_data)
    region, layers, wake_in = overlay.region_key(context.region), [], None
    for key, (tone, items) in items_by_tone(shown).items():
        if (region, key) not in _runtime.views:
            _runtime.views[region, key] = _GroupView()
        drawing, better_in = _runtime.views[region, key].update(items, camera)
        layers.append(drawing.layer(tone))
        if better_in is not None:
            wake_in = better_in if wake_in is None else min(wake_in, better_in)
    if wake_in is not None:
        _wake(wake_in)
    return sorted(layers, key=lambda layer: -layer.plane_depth)


def _wake(seconds: float) -> None:
    """Redraw after that time; a redraw asked for from within a redraw would be lost."""
    if bpy.app.timers.is_registered(overlay.redraw_all):
        bpy.app.timers.unregister(overlay.redraw_all)
    bpy.app.timers.register(overlay.redraw_all, first_interval=seconds)


def clear() -> None:
    """Forget everything on the GPU; it is made again when it is needed."""
    _runtime.textures.clear()
    _runtime.suspects.clear()
    _runtime.views.clear()


@bpy.app.handlers.persistent
def _forget_all(*_: Any) -> None:
    clear()


@bpy.app.handlers.persistent
def _note_changes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not _runtime.textures:
        return
    for update in depsgraph.updates:
        if isinstance(update.id, bpy.types.PointCloud) and update.is_updated_geometry:
            _runtime.suspects.add(update.id.original.session_uid)
    existing = {cloud.session_uid for cloud in bpy.data.pointclouds}
    for gone in [uid for uid in _runtime.textures if uid not in existing]:
        del _runtime.textures[gone]
        _runtime.suspects.discard(gone)
    regions = {overlay.region_key(region) for _, region in overlay.view_regions()}
    for closed in [key for key in _runtime.views if key[0] not in regions]:
        del _runtime.views[closed]


def _apply_display(target: bpy.types.Object, context: bpy.types.Context | None) -> None:
    """Either the shader draws the Gaussians or the modifier's instances do, never both."""
    modifier = find_modifier(target)
    if modifier is None:
        return
    as_splats = target.physhdr_viewport == "SPLATS"
    modifier.show_viewport = not as_splats
    target.display_type = "BOUNDS" if as_splats else "TEXTURED"
    cloud = target.data
    if as_splats and cloud.is_editable and "radius" not in cloud.attributes:
        # Material Preview and Rendered draw the points themselves, whatever the display type. The modifier
        # puts out instances only, and they have a size of their own.
        write_attribute(cloud, Attribute("radius", "FLOAT", np.zeros(len(cloud.points), np.float32)))


def register() -> None:
    bpy.types.Object.physhdr_viewport = bpy.props.EnumProperty(
        name="Viewport display",
        description="How the Gaussians of a PhysHDR model are drawn in the 3D view. Renders are not affected",
        items=[
            ("SPLATS", "Splats", "As the trainer draws them: fast, exact, scene-linear"),
            (
                "NODES",
                "Geometry nodes",
                "The instances that Cycles and EEVEE render: slow for many Gaussians",
            ),
        ],
        default="NODES",
        update=_apply_display,
    )
    handlers = bpy.app.handlers
    handlers.depsgraph_update_post.append(_note_changes)
    for event in (handlers.undo_post, handlers.redo_post, handlers.load_pre):
        event.append(_forget_all)
    overlay.add_source(_layers)


def unregister() -> None:
    overlay.remove_source(_layers)
    handlers = bpy.app.handlers
    for event in (handlers.undo_post, handlers.redo_post, handlers.load_pre):
        event.remove(_forget_all)
    handlers.depsgraph_update_post.remove(_note_changes)
    if bpy.app.timers.is_registered(overlay.redraw_all):
        bpy.app.timers.unregister(overlay.redraw_all)
    clear()
    _runtime.hidden.clear()
    del bpy.types.Object.physhdr_viewport
