# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a data set in the 3D views: while its dialog is open, or until the toggle is pressed again.

They are computed when something has changed, not while a view is drawn: rays into the scene, and the frames
of the camera's animation, are nothing for a draw handler.
"""

from contextlib import suppress
from types import SimpleNamespace
from typing import Any, ClassVar

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader

from ...bridge.errors import PhysHDRError
from .. import changes
from ..runtime import redraw
from . import rig_cameras
from .dataset_settings import DATASET, chosen, settings_of

#: As the switch's description names them.
COLOURS = {"train": (1.0, 0.5, 0.1, 0.9), "test": (0.2, 0.65, 1.0, 0.9), "lit": (1.0, 0.9, 0.2, 0.9)}
LINE_WIDTH = 1.5
#: Seconds after a change of the scene until the cameras follow.
FOLLOW_SECONDS = 0.1


class _Shown:
    """What is drawn, and why. Nothing of it is in the file."""

    def __init__(self) -> None:
        self.in_dialog = self.pinned = False
        self.scene = ""
        #: ``[…, 2, 3]`` float32 ends of lines of each kind, and those of them that are on the GPU.
        self.lines: dict[str, np.ndarray] = {}
        self.batches: dict[str, Any] = {}
        self.handler: Any = None
        self.state: tuple[Any, ...] = ()


_shown = _Shown()


def dialog_opened(context: bpy.types.Context) -> None:
    """The dialog shows, and with it the cameras."""
    _shown.in_dialog = True
    refresh(context)


def dialog_closed() -> None:
    """It is gone, by whatever button."""
    _shown.in_dialog = False
    refresh()


def pinned() -> bool:
    """Whether they are shown without the dialog."""
    return _shown.pinned


def wanted(scene: bpy.types.Scene) -> bool:
    return _shown.pinned or (_shown.in_dialog and settings_of(scene).show_cameras)


def refresh(context: bpy.types.Context | None = None) -> None:
    """Compute the cameras anew, if they are to be seen and anything of them has changed."""
    context = context or bpy.context
    scene, layer = context.scene, context.view_layer
    if scene is None or layer is None or not hasattr(bpy.types.Scene, DATASET) or not wanted(scene):
        _clear()
        return
    values = chosen(scene)
    state = _state(scene, layer, values)
    # Not again and again where there can be none: to look along the camera's animation calls the handlers.
    if state != _shown.state:
        _shown.state, _shown.scene = state, scene.name
        _shown.lines, _shown.batches = lines(scene, layer, values), {}
    if _shown.handler is None and not bpy.app.background:
        _shown.handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    redraw()


def lines(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, values: SimpleNamespace
) -> dict[str, np.ndarray]:
    """``[…, 2, 3]`` float32: ends of the lines of each kind of camera; none where there can be no cameras."""
    try:
        found = rig_cameras.of(scene, layer, values)
    except PhysHDRError:
        return {}  # the dialog says what is wrong
    depth = rig_cameras.DEPTH * found.distance
    return {
        kind: rig_cameras.frustums(
            rig_cameras.thinned(getattr(found, kind)), found.angle_x, found.aspect, depth
        ).astype(np.float32)
        for kind in COLOURS
    }


def _state(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, values: SimpleNamespace) -> tuple[Any, ...]:
    """What the cameras depend on, as far as it is cheap to look at."""
    camera, render = scene.camera, scene.render
    place: tuple[Any, ...] = ()
    if camera is not None and camera.type == "CAMERA":
        lens: Any = camera.data
        focus = lens.dof.focus_object
        place = (camera.name, lens.lens, lens.sensor_width, lens.sensor_height, lens.sensor_fit, lens.type)
        place += (lens.dof.use_dof, lens.dof.focus_distance, focus.name if focus else "")
        if values.rig != "PATH":
            place += tuple(number for row in camera.matrix_world for number in row)
    aspect = render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y
    frames = scene.frame_start, scene.frame_end
    named = ("rig", "views", "rig_distance", "rig_width", "rig_height", "rig_arc", "lit_views")
    sizes = values.resolution_x, values.resolution_y
    return (scene.name, place, aspect, frames, sizes, *(getattr(values, name) for name in named))


def _draw() -> None:
    if bpy.context.scene.name != _shown.scene or not _shown.lines:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    region: Any = bpy.context.region
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    shader.uniform_float("lineWidth", LINE_WIDTH * bpy.context.preferences.system.ui_scale)
    for kind, ends in _shown.lines.items():
        if len(ends):
            if kind not in _shown.batches:
                places: Any = {"pos": ends.reshape(-1, 3)}
                _shown.batches[kind] = batch_for_shader(shader, "LINES", places)
            shader.uniform_float("color", COLOURS[kind])
            _shown.batches[kind].draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _clear() -> None:
    if _shown.handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_shown.handler, "WINDOW")
    _shown.handler, _shown.lines, _shown.batches, _shown.state = None, {}, {}, ()
    redraw()


def _changed() -> None:
    """Something was chosen otherwise: the update of a property, where the scene may be looked at."""
    refresh()


@persistent
def _scene_changed(*_: object) -> None:
    if _shown.pinned and not bpy.app.timers.is_registered(_follow):
        bpy.app.timers.register(_follow, first_interval=FOLLOW_SECONDS)


def _follow() -> None:
    with suppress(ReferenceError):
        refresh()


@persistent
def _file_opened(*_: object) -> None:
    _shown.in_dialog = _shown.pinned = False
    _clear()


class PHYSHDR_OT_rig_show(bpy.types.Operator):
    """Show the cameras of a data set of this scene, as its dialog is set, in the 3D view; again: hide them"""

    bl_idname = "physhdr.rig_show"
    bl_label = "Show Cameras"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.camera is None and not _shown.pinned:
            cls.poll_message_set("Add a camera to the scene first: the views are taken around it")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        _shown.pinned = not _shown.pinned
        refresh(context)
        if _shown.pinned and not _shown.lines:
            _shown.pinned = False
            _clear()
            self.report({"ERROR"}, "These settings give no cameras: Render from This Scene says why")
            return {"CANCELLED"}
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(PHYSHDR_OT_rig_show)
    changes.rig.follow(_changed)
    bpy.app.handlers.depsgraph_update_post.append(_scene_changed)
    bpy.app.handlers.load_post.append(_file_opened)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_file_opened)
    bpy.app.handlers.depsgraph_update_post.remove(_scene_changed)
    changes.rig.leave(_changed)
    _shown.in_dialog = _shown.pinned = False
    _clear()
    bpy.utils.unregister_class(PHYSHDR_OT_rig_show)
