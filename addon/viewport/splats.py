# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported Gaussians in the 3D view, drawn here by shaders, relit by their modifier's inputs; no backend.

Which objects: point clouds with our attributes whose property *Viewport display* (``physhdr_viewport``) is
``SPLATS``, or ``CONFIDENCE``, which shows in colours how sure their radiance is. A change is drawn at once,
as small as is needed to keep up; when the view rests it is drawn sharp. Where the GPU is slow either happens
in portions, between which Blender stays responsive.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple, cast

import bpy
import numpy as np

from ...bridge import srgb
from ...bridge.errors import PhysHDRError
from ..blender import add_handlers, cloud_of, remove_handlers
from ..model.attributes import BY_SHADER, CAMERAS, CONFIDENCE, CONFIDENCE_SPLATS, DISPLAY, NODES, SPLATS
from ..model.cleaning import Cleaning
from ..model.drawn import fingerprint
from ..model.look import Look, is_model, kept_of, look_of
from ..model.nodes import find_modifier
from ..model.point_cloud import cameras_in, read_tone_curve
from ..model.point_removal import selection_of
from ..model.tone_curve import ToneCurve
from ..settings import SETTINGS
from . import bounds, overlay, seen, stand_in
from .camera import ViewCamera, has_jumped
from .edit_points import EditPoints, checksum
from .instances import InstanceFinder, is_visible
from .overlay import Layer
from .schedule import LOWEST_STEP, REST_SECONDS, STEP, ResolutionLadder
from .splat_data import (
    Marks,
    SplatTextures,
    confidence_arrays,
    identity,
    is_splats,
    read_arrays,
)
from .splat_renderer import Drawing, Item, SplatRenderer, Target, is_flat

#: After the last change of a model's points: until its bounds are computed again.
BOUNDS_SECONDS = 0.5
#: A redraw may spend about as long here.
BUDGET_SECONDS = 0.03
#: And after a jump of the view, whose picture before is of no use.
JUMP_SECONDS = 0.3
#: Up to as many Gaussians are always sorted exactly; more take too long while the view moves.
EXACT_SORT_COUNT = 300_000
#: The fewest Gaussians in a portion of a sharp picture, and those of the first. Fewer would not be quicker:
#: in software, whatever is drawn, reading and writing a large picture takes 15 ms.
PORTION = 8192
#: How many ways of cleaning a model are remembered: its copies may have different ones.
CLEANINGS_HELD = 8


class Shown(NamedTuple):
    """A point cloud to draw, as it is in the file; where, ``[4, 4]``, and how, as evaluated."""

    cloud: bpy.types.PointCloud
    matrix_world: np.ndarray
    look: Look
    #: Whether its points are being edited.
    is_edited: bool = False
    #: Whether its confidence is shown, not its radiance.
    confidence: bool = False


def shown_objects(
    view_layer: bpy.types.ViewLayer,
    depsgraph: bpy.types.Depsgraph,
    space: bpy.types.SpaceView3D | None = None,
) -> Iterator[Shown]:
    """What is visible and drawn as splats, in ``space`` (``None``: regardless of the view)."""
    for target in view_layer.objects:
        if not _is_drawn(target):
            continue
        if target.visible_get(view_layer=view_layer, **({"viewport": space} if space else {})):
            matrix_world = np.array(target.evaluated_get(depsgraph).matrix_world)
            look = look_of(target, depsgraph)
            yield Shown(
                cloud_of(target), matrix_world, look, target.mode == "EDIT", _shows_confidence(target)
            )
    looks: dict[int, Look] = {}  # thousands of instances have the look of one object
    for instance in _runtime.finder.instances(view_layer, depsgraph, _is_drawn):
        if is_visible(instance, view_layer, space):
            target = instance.target
            if target.session_uid not in looks:
                looks[target.session_uid] = look_of(target, depsgraph)
            look, sure = looks[target.session_uid], _shows_confidence(target)
            yield Shown(cloud_of(target), instance.matrix_world, look, confidence=sure)


def _is_drawn(target: bpy.types.Object) -> bool:
    """Whether an object is a model that is drawn as splats wherever it is visible."""
    if target.type != "POINTCLOUD" or getattr(target, DISPLAY) not in BY_SHADER:
        return False
    cloud = cloud_of(target)
    return identity(cloud) not in _runtime.hidden and is_splats(cloud)


def _shows_confidence(target: bpy.types.Object) -> bool:
    """Whether an object's confidence is wanted and known; else its radiance is drawn, as the panel says."""
    wanted = getattr(target, DISPLAY) == CONFIDENCE_SPLATS
    return wanted and CONFIDENCE.name in cloud_of(target).attributes


def items_by_tone(shown: Iterable[Shown]) -> dict[bytes, tuple[ToneCurve | None, list[Item]]]:
    """What to draw, grouped by tone curve (``b""``: scene-linear); needs an active GPU context."""
    groups: dict[bytes, tuple[ToneCurve | None, list[Item]]] = {}
    for cloud, matrix_world, look, is_edited, confidence in shown:
        if confidence:  # neither exposure nor tones change what is known
            look = replace(look, exposure_ev=0.0, lighting_levels=(), tone_mapper=False)
        tone = read_tone_curve(cloud) if look.tone_mapper else None
        _, items = groups.setdefault(tone.key if tone else b"", (tone, []))
        held = _held(cloud)
        items.append(
            Item(
                held.confidence(cloud) if confidence else held.textures,
                matrix_world,
                look.lighting_levels,
                look.exposure_ev,
                look.view_dependent,
                look.sh_limit,
                held.kept(cloud, look.cleaning),
                held.selected(cloud) if is_edited else None,
            )
        )
    return groups


def seen_of(shown: Iterable[Shown]) -> np.ndarray | None:
    """What training's cameras saw of the world, ``[K, 3, 4]`` (``seen``); ``None`` where that is not known of
    all that is shown, or where not radiance is shown."""
    found = []
    for each in shown:
        rows = (
            None if each.confidence or is_flat(each.matrix_world) else _held(each.cloud).frustums(each.cloud)
        )
        if rows is None:
            return None
        found.append(seen.of_object(rows, each.matrix_world))
    return np.concatenate(found) if found else None


def set_hidden(identities: Iterable[str]) -> None:
    """Do not draw models with these identities (``splat_data.identity``): a live preview shows them."""
    _runtime.hidden = set(identities)
    overlay.redraw_all()


class _Work(NamedTuple):
    """A picture that is being drawn, or shown."""

    drawing: Drawing
    #: What it shows; equal signatures give equal pictures.
    signature: Any
    #: Step of the ladder; 0 and sorted exactly: as good as it gets.
    step: int

    @property
    def is_sharp(self) -> bool:
        return self.step == 0 and self.drawing.is_exact


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

    def tint(self, theme: bpy.types.ThemeView3D) -> None:
        """Draw what is selected in the theme's colour."""
        red, green, blue = srgb.to_linear(np.array(theme.vertex_select[:3]))
        self._renderer.selection_colour = float(red), float(green), float(blue)

    def update(self, items: list[Item], camera: ViewCamera) -> tuple[Drawing | None, float | None]:
        """The newest complete picture, and in how many seconds to ask for a better one (``None``: never)."""
        start = time.perf_counter()
        signature = camera.key, [item.key for item in items]
        if signature != self._signature:
            self._signature, self._changed_at = signature, start
        rests_in = self._changed_at + REST_SECONDS - start
        jumped = self._has_jumped(self._shown, camera)
        end = start + (JUMP_SECONDS if jumped else BUDGET_SECONDS)
        if jumped and self._has_jumped(self._next, camera):
            self._next = None
        if jumped:  # a coarse picture at once: there is nothing else to show
            self._ladder.step = LOWEST_STEP
        has_begun = self._choose(items, camera, rests_in <= 0.0)
        if self._next is not None and not (has_begun and time.perf_counter() > end):
            self._work(end)
        shown = self._shown.drawing if self._shown else None
        if self.is_sharp:
            return shown, None
        is_waiting = self._next is None and self._shown is not None and self._shown.signature == signature
        return shown, max(0.0, rests_in) if is_waiting else 0.0

    @staticmethod
    def _has_jumped(work: _Work | None, camera: ViewCamera) -> bool:
        """Whether a picture is of too far away to be shown for ``camera``."""
        return work is not None and has_jumped(work.drawing.camera, camera, work.drawing.typical_depth)

    def _choose(self, items: list[Item], camera: ViewCamera, is_resting: bool) -> bool:
        """Begin the picture that is wanted now, if it is not being drawn; whether it was begun."""
        is_shown = self._shown is not None and self._shown.signature == self._signature
        if self._next is not None:
            # A small picture of a moment ago is finished first, or a moving view would never show one.
            if self._next.signature == self._signature or not self._next.is_sharp:
                return False
            self._next = None
        if not is_shown:
            self._begin(items, camera, self._ladder.step, EXACT_SORT_COUNT)
        elif is_resting and not self.is_sharp:
            self._begin(items, camera, 0, None)
        return self._next is not None

    def _begin(self, items: list[Item], camera: ViewCamera, step: int, exact_count: int | None) -> None:
        start = time.perf_counter()
        size = camera.scaled(STEP**step)
        drawing = self._renderer.begin(items, size, Target(size.width, size.height), exact_count=exact_count)
        self._next = _Work(drawing, self._signature, step)
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


class _Held:
    """What of one point cloud is kept between redraws."""

    def __init__(self, cloud: bpy.types.PointCloud, print_now: tuple[int, ...]) -> None:
        self.fingerprint = print_now
        self.textures = SplatTextures(read_arrays(cloud))
        self._confidence: SplatTextures | None = None
        self._kept: dict[Cleaning, Marks] = {}
        self._selected: tuple[int, Marks] | None = None
        self._points: tuple[int, EditPoints] | None = None
        self._frustums: tuple[str, np.ndarray | None] | None = None

    def frustums(self, cloud: bpy.types.PointCloud) -> np.ndarray | None:
        """What the cameras that came with the model saw, in its own space; ``None`` where none did."""
        listed = str(cloud.get(CAMERAS, ""))
        if self._frustums is None or self._frustums[0] != listed:
            try:
                cameras = cameras_in(cloud)
            except PhysHDRError:  # Look Through says what is wrong with them
                cameras = ()
            self._frustums = listed, seen.frustums(cameras) if cameras else None
        return self._frustums[1]

    def confidence(self, cloud: bpy.types.PointCloud) -> SplatTextures:
        """The Gaussians in the colours of their confidence; their texels are in the order of ``textures``."""
        if self._confidence is None:
            self._confidence = SplatTextures(confidence_arrays(cloud))
        return self._confidence

    def kept(self, cloud: bpy.types.PointCloud, cleaning: Cleaning) -> Marks | None:
        """What a cleaned model keeps. Nothing is uploaded for it: what is hidden is left out of the order."""
        cleaning = cleaning.without_camera()
        if cleaning.keeps_everything:
            return None
        if cleaning not in self._kept:
            if len(self._kept) >= CLEANINGS_HELD:
                self._kept.clear()
            self._kept[cleaning] = self.textures.marks(kept_of(cloud, cleaning))
        return self._kept[cleaning]

    def selected(self, cloud: bpy.types.PointCloud) -> Marks:
        """What is selected in Edit Mode."""
        values = selection_of(cloud)
        now = checksum(values)
        if self._selected is None or self._selected[0] != now:
            self._selected = now, self.textures.marks(values)
        return self._selected[1]

    def points(self, cloud: bpy.types.PointCloud) -> EditPoints:
        """The points in Edit Mode."""
        marks = self.selected(cloud)
        if self._points is None or self._points[0] != marks.serial:
            self._points = marks.serial, EditPoints(cloud, selection_of(cloud))
        return self._points[1]


class _Runtime:
    """GPU data and pictures. Everything can be made again; nothing is in the .blend."""

    def __init__(self) -> None:
        #: By the point cloud's session_uid.
        self.held: dict[int, _Held] = {}
        #: session_uids of point clouds that may have changed since.
        self.suspects: set[int] = set()
        self.views: dict[tuple[int, bytes], _GroupView] = {}
        self.hidden: set[str] = set()
        self.finder = InstanceFinder()
        #: What is edited in the region that is being drawn.
        self.edited: list[Shown] = []


_runtime = _Runtime()


def _held(cloud: bpy.types.PointCloud) -> _Held:
    uid = cloud.session_uid
    held = _runtime.held.get(uid)
    if held is None or uid in _runtime.suspects:
        now = fingerprint(cloud)
        if held is None or held.fingerprint != now:
            # The old textures make room first.
            if _runtime.held.pop(uid, None) is not None:
                _soon(_hide_points, BOUNDS_SECONDS)  # other points may be far away now
            held = _runtime.held[uid] = _Held(cloud, now)
        _runtime.suspects.discard(uid)
    return held


def _layers(context: bpy.types.Context, camera: ViewCamera) -> list[Layer]:
    """The overlay's source: pictures of all splats in the region that is being drawn."""
    depsgraph = context.view_layer.depsgraph
    if depsgraph is None:
        return []
    shown = list(shown_objects(context.view_layer, depsgraph, context.space_data))
    _runtime.edited = [each for each in shown if each.is_edited]
    if any(stand_in.is_shown(each.cloud) for each in shown):
        # Linked, reloaded, appended by a script. Nothing may be changed while a view is drawn.
        _soon(_hide_points, 0.0)
    frustums = seen_of(shown) if getattr(context.scene, SETTINGS).dim_unseen else None
    region, layers, wake_in = overlay.region_key(context.region), [], None
    for key, (tone, items) in items_by_tone(shown).items():
        if (region, key) not in _runtime.views:
            _runtime.views[region, key] = _GroupView()
        view = _runtime.views[region, key]
        view.tint(context.preferences.themes[0].view_3d)
        drawing, better_in = view.update(items, camera)
        if drawing is not None:
            layers.append(replace(drawing.layer(tone), frustums=frustums))
        if better_in is not None:
            wake_in = better_in if wake_in is None else min(wake_in, better_in)
    if wake_in is not None:
        # A redraw asked for from within a redraw would be lost.
        _soon(overlay.redraw_all, wake_in)
    return sorted(layers, key=lambda layer: -layer.plane_depth)


def _draw_points(context: bpy.types.Context) -> None:
    """The points of what is edited, over the pictures."""
    edited, _runtime.edited = _runtime.edited, []
    theme = context.preferences.themes[0].view_3d
    for each in edited:
        _held(each.cloud).points(each.cloud).draw(each.matrix_world, theme)


def _soon(timer: Callable[[], None], seconds: float) -> None:
    """Call that once after that time, whatever time was asked for before."""
    if bpy.app.timers.is_registered(timer):
        bpy.app.timers.unregister(timer)
    bpy.app.timers.register(timer, first_interval=seconds)


def clear() -> None:
    """Forget everything on the GPU; it is made again when it is needed."""
    _runtime.held.clear()
    _runtime.finder.changed()
    _runtime.suspects.clear()
    _runtime.views.clear()


@bpy.app.handlers.persistent
def _forget_all(*_: Any) -> None:
    clear()


@bpy.app.handlers.persistent
def _note_changes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    _runtime.finder.changed()
    clouds = [each.id for each in depsgraph.updates if isinstance(each.id, bpy.types.PointCloud)]
    if clouds:
        _runtime.suspects.update(cast(bpy.types.ID, each.original).session_uid for each in clouds)
    if not _runtime.held:
        _runtime.suspects.clear()
        return
    existing = {cloud.session_uid for cloud in bpy.data.pointclouds}
    for gone in [uid for uid in _runtime.held if uid not in existing]:
        del _runtime.held[gone]
        _runtime.suspects.discard(gone)
    regions = {overlay.region_key(region) for _, region in overlay.view_regions()}
    for closed in [key for key in _runtime.views if key[0] not in regions]:
        del _runtime.views[closed]


@bpy.app.handlers.persistent
def _note_frame(*_: Any) -> None:
    _runtime.finder.changed()


@bpy.app.handlers.persistent
def _hide_points(*_: Any) -> None:
    """Leave all models that are drawn here to the shader: of a file that was opened, linked or saved."""
    for target in _models():
        stand_in.hide(target)


@bpy.app.handlers.persistent
def _show_points(*_: Any) -> None:
    """What is saved shows the points to who opens the file without the extension."""
    for target in _models():
        if target.library is None:
            stand_in.show(target)


def _models() -> list[bpy.types.Object]:
    # While extensions are enabled at Blender's start there are no data yet.
    objects: Iterable[bpy.types.Object] = getattr(bpy.data, "objects", ())
    chosen = (each for each in objects if is_model(each) and getattr(each, DISPLAY) in BY_SHADER)
    return [each for each in chosen if is_splats(cloud_of(each))]


def _apply_display(target: bpy.types.Object, context: bpy.types.Context | None) -> None:
    """Either the shader draws the Gaussians or the modifier's instances do, never both."""
    if target.type != "POINTCLOUD" or (modifier := find_modifier(target)) is None:
        return
    if getattr(target, DISPLAY) in BY_SHADER:
        stand_in.hide(target)
    else:
        modifier.show_viewport = True
        target.display_type = "TEXTURED"
        bounds.remove(target)
        if cloud_of(target).is_editable and stand_in.restore_radius(cloud_of(target)):
            cloud_of(target).update_tag()


#: What happens in Blender, and what is then done.
_HANDLERS = (
    ("depsgraph_update_post", _note_changes),
    ("frame_change_post", _note_frame),
    ("undo_post", _forget_all),
    ("redo_post", _forget_all),
    ("load_pre", _forget_all),
    ("load_post", _hide_points),
    ("blend_import_post", _hide_points),
    ("save_pre", _show_points),
    ("save_post", _hide_points),
    ("save_post_fail", _hide_points),
)


def register() -> None:
    display = bpy.props.EnumProperty(
        name="Viewport display",
        description="How the Gaussians of a PhysHDR model are drawn in the 3D view. "
        "Renders are not affected; a playblast (View, Render Playblast) needs Geometry nodes",
        items=[
            (SPLATS, "Splats", "As the trainer draws them: fast, exact, scene-linear"),
            (NODES, "Geometry nodes", "The instances that Cycles and EEVEE render: slow for many Gaussians"),
            (
                CONFIDENCE_SPLATS,
                "Confidence",
                "How likely the radiance is right within a tenth of a stop: violet 0, green 0.6, yellow 1",
            ),
        ],
        default=NODES,
        update=_apply_display,
    )
    setattr(bpy.types.Object, DISPLAY, display)
    add_handlers(_HANDLERS)
    overlay.add_source(_layers, _draw_points)
    _hide_points()


def unregister() -> None:
    _show_points()
    overlay.remove_source(_layers)
    remove_handlers(_HANDLERS)
    for timer in (overlay.redraw_all, _hide_points):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    clear()
    _runtime.hidden.clear()
    delattr(bpy.types.Object, DISPLAY)
