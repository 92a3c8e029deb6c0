# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported Gaussians in the 3D view, drawn here by shaders, relit by their modifier's inputs; no backend.

Which objects: point clouds with our attributes whose property *Viewport display* (``physhdr_viewport``) is
``SPLATS``. A change is drawn at once, as small as is needed to keep up; when the view rests it is drawn
sharp. Where the GPU is slow either happens in portions, between which Blender stays responsive.
"""

import time
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, cast

import bpy
import numpy as np

from ..attributes import DISPLAY, RADIUS
from ..blender import cloud_of
from ..look import Look, look_of
from ..nodes import find_modifier
from ..point_cloud import read_tone_curve, write_attribute
from ..tone_curve import ToneCurve
from . import overlay
from .camera import ViewCamera
from .overlay import Layer
from .schedule import REST_SECONDS, STEP, ResolutionLadder
from .splat_data import SplatTextures, fingerprint, identity, is_splats, read_arrays
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
        if target.type != "POINTCLOUD" or getattr(target, DISPLAY) != "SPLATS":
            continue
        cloud = cloud_of(target)
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
            Item(_textures(cloud), matrix_world, look.lighting_levels, look.exposure_ev, look.view_dependent)
        )
    return groups


def set_hidden(identities: Iterable[str]) -> None:
    """Do not draw models with these identities (``splat_data.identity``): a live preview shows them."""
    _runtime.hidden = set(identities)
    overlay.redraw_all()


class _Work(NamedTuple):
    """A picture that is being drawn, or shown."""

    drawing: Drawing
    #: What it shows; equal signatures give equal pictures.
    signature: Any
    #: Step of the ladder; 0 and ``is_exact``: as good as it gets.
    step: int
    is_exact: bool

    @property
    def is_sharp(self) -> bool:
        return self.step == 0 and self.is_exact


class _GroupView:
    """The picture of a group of objects in one region: what is shown, and what is being drawn.

    Where the GPU is slow a picture takes several redraws. Until it is done the one before is shown, moved
    with the view (``overlay``): looking around never waits for it.
    """

    def __init__(self) -> None:
        self._renderer = SplatRenderer()
        self._ladder = ResolutionLadder(BUDGET_SECONDS)
        self._signature: Any = None
        self._changed_at = 0.0
        self._shown: _Work | None = None
        self._next: _Work | None = None
        self._seconds = 0.0
        self._portion = PORTION

    @property
    def is_sharp(self) -> bool:
        """Whether what is shown is as good as it gets."""
        shown = self._shown
        return shown is not None and shown.is_sharp and shown.signature == self._signature

    def update(self, items: list[Item], camera: ViewCamera) -> tuple[Drawing | None, float | None]:
        """The newest complete picture, and in how many seconds to ask for a better one (``None``: never)."""
        start = time.perf_counter()
        signature = camera.key, [item.key for item in items]
        if signature != self._signature:
            self._signature, self._changed_at = signature, start
        rests_in = self._changed_at + REST_SECONDS - start
        end = start + BUDGET_SECONDS
        has_begun = self._choose(items, camera, rests_in <= 0.0)
        if self._next is not None and not (has_begun and time.perf_counter() > end):
            self._work(end)
        shown = self._shown.drawing if self._shown else None
        if self.is_sharp:
            return shown, None
        is_waiting = self._next is None and self._shown is not None and self._shown.signature == signature
        return shown, max(0.0, rests_in) if is_waiting else 0.0

    def _choose(self, items: list[Item], camera: ViewCamera, is_resting: bool) -> bool:
        """Begin the picture that is wanted now, if it is not being drawn; whether it was begun."""
        is_shown = self._shown is not None and self._shown.signature == self._signature
        if self._next is not None:
            # A small picture of a moment ago is finished first, or a moving view would never show one.
            if self._next.signature == self._signature or not self._next.is_sharp:
                return False
            self._next = None
        if not is_shown:
            exact = sum(item.splats.count for item in items) <= EXACT_SORT_COUNT
            self._begin(items, camera, self._ladder.step, exact)
        elif is_resting and not self.is_sharp:
            self._begin(items, camera, 0, True)
        return self._next is not None

    def _begin(self, items: list[Item], camera: ViewCamera, step: int, exact: bool) -> None:
        start = time.perf_counter()
        size = camera.scaled(STEP**step)
        drawing = self._renderer.begin(items, size, Target(size.width, size.height), exact=exact)
        self._next = _Work(drawing, self._signature, step, exact)
        self._seconds = time.perf_counter() - start

    def _work(self, end: float) -> None:
        """Draw portions of the next picture, at least one, until it is done or the time is over."""
        assert self._next is not None
        drawing = self._next.drawing
        start = time.perf_counter()
        while not drawing.is_complete:
            drawing.draw(self._portion)
            drawing.target.wait()
            seconds = time.perf_counter() - start
            if seconds < 0.25 * BUDGET_SECONDS:
                self._portion *= 2
            elif seconds > 0.5 * BUDGET_SECONDS:
                self._portion = max(PORTION, self._portion // 2)
            self._seconds += seconds
            start += seconds
            if start > end:
                break
        if drawing.is_complete:
            self._ladder.measured(self._seconds, self._next.step)
            self._shown, self._next = self._next, None


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
        if drawing is not None:
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
            _runtime.suspects.add(cast(bpy.types.ID, update.id.original).session_uid)
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
    as_splats = getattr(target, DISPLAY) == "SPLATS"
    modifier.show_viewport = not as_splats
    target.display_type = "BOUNDS" if as_splats else "TEXTURED"
    cloud = cloud_of(target)
    if as_splats and cloud.is_editable and RADIUS.name not in cloud.attributes:
        # Material Preview and Rendered draw the points themselves, whatever the display type. The modifier
        # puts out instances only, and they have a size of their own.
        write_attribute(cloud, RADIUS, np.zeros(len(cloud.points)))


def register() -> None:
    display = bpy.props.EnumProperty(
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
    setattr(bpy.types.Object, DISPLAY, display)
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
    delattr(bpy.types.Object, DISPLAY)
