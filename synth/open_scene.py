# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own scene as a stage: their camera, their lights, and nothing of theirs changed afterwards.

The file is never saved. What must be turned meanwhile (render settings are ``settings.applied``'s) is put
back on the way out, also after an error or CTRL-C.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector

from ..bridge.lights import AMBIENT
from ..bridge.regular import resolved
from . import (
    active_camera,
    composited,
    in_views,
    own_objects,
    plan,
    rig,
    simulations,
    user_camera,
    user_light,
)
from .blender import camera_of, cycles, evaluated
from .errors import SceneError, SceneFileError
from .fingerprint import fingerprint
from .options import CURRENT, Options
from .progress import Report, quiet
from .rays import Rays
from .stage import CameraHints, Stage

_OURS = ("objects", "cameras", "worlds", "lights", "node_groups")
#: Share of a rig's cameras behind or within things from which on the user is warned.
CROWDED = 0.2


@contextmanager
def opened(options: Options, report: Report) -> Iterator[tuple[Stage, Options]]:
    """The scene that ``options`` ask for, and the options with what follows from the scene filled in.

    Raises:
        SceneFileError: no such file, not a .blend file, no such scene.
        SceneError: no usable camera, no light, or none where one was chosen.
        UnknownNameError: no such light group or collection.
    """
    _open_file(options.from_file, options.allow_scripts)
    scene = _scene(options.scene_name)
    with ExitStack() as undo:
        _set(undo, [(window, "scene", scene) for window in _windows() if window.scene != scene])
        camera = user_camera.checked(scene)
        # A marker's camera would replace ours, and the user's as soon as another marker loses its own.
        undo.callback(setattr, scene, "camera", camera)
        _set(undo, [(marker, "camera", None) for marker in scene.timeline_markers if marker.camera])
        scene.camera = camera
        layer = _view_layer(scene, undo)
        undo.callback(setattr, cycles(scene), "seed", cycles(scene).seed)  # set for each picture
        former = scene.frame_current, scene.frame_subframe
        undo.callback(scene.frame_set, former[0], subframe=former[1])
        scene.frame_set(former[0], subframe=former[1])
        models = undo.enter_context(own_objects.hidden(scene, layer, report))
        undo.enter_context(in_views.shown(scene, layer))
        layer.update()
        undo.enter_context(composited.taken_in(scene, layer, report))
        if not user_light.any_light(scene, layer):
            raise SceneError(
                f"the scene '{scene.name}' has no light: the pictures would be black",
                "add a light, or give the world a strength",
            )
        options = replace(options, resolution=user_camera.resolution(scene, options.resolution))
        options.check()
        _tell_what_is_missing(scene, layer, report)
        hints, source = _cameras(scene, layer, camera, options, report)
        if models:
            source["left_out"] = models
        if options.camera_rig == rig.PATH:
            poses = user_camera.path(scene, camera, options)
        else:
            counts = options.views, options.lit_views, options.validation_views
            poses = rig.poses(options.camera_rig, hints, *counts)
        mark = fingerprint(scene, layer, poses.all, (hints.angle_x, *hints.clip))
        # What is ours goes last on the way out's list, that is first: before the user's is put back.
        undo.enter_context(_ours_removed())
        lights = undo.enter_context(user_light.grouped(scene, layer, options.light_choices))
        for note in lights.notes:
            report.warn(note)
        plan.check_lights(options, list(lights.groups))
        if not lights.has_ambient:
            options = _without_ambient(options, report)
            poses = poses if options.lit_views else replace(poses, lit=[])
        # Adaptive subdivision would else follow our camera, and give every view another surface.
        dicing = cycles(scene).dicing_camera or camera
        _set(undo, [(cycles(scene), "dicing_camera", dicing)])
        undo.enter_context(active_camera.replaced(scene, layer, camera, report))
        yield (
            Stage(
                scene=scene,
                cameras=hints,
                lights={name: [] for name in lights.groups},
                groups=lights.groups,
                layer=layer,
                poses=poses,
                source=source,
                fingerprint=mark,
            ),
            options,
        )


def _without_ambient(options: Options, report: Report) -> Options:
    """What is left to do where nothing is ambient: other lights may still vary."""
    others = tuple(name for name in options.lit_lights if name != AMBIENT)
    if options.relit_views == 0 and not options.lit_views:
        return options
    if others:
        report.warn("the scene has no ambient light (world or sun): only its other lights get other levels")
        return replace(options, lit_lights=others)
    report.warn(
        "the scene has no ambient light (world or sun), only lamps: there is nothing to relight, and "
        "no relit truth and no views at other levels are made"
    )
    return replace(options, relit_views=0, lit_views=0)


def _set(undo: ExitStack, wanted: list[tuple[Any, str, Any]]) -> None:
    """Set attributes; the former values come back when ``undo`` closes."""
    for owner, attribute, value in wanted:
        undo.callback(setattr, owner, attribute, getattr(owner, attribute))
        setattr(owner, attribute, value)


def _open_file(name: str | None, allow_scripts: bool) -> None:
    if name in (None, CURRENT):
        return
    path = Path(name)
    if not path.is_file():
        raise SceneFileError(f"there is no file '{path}'", "give --from-file the path of a .blend file")
    try:
        with quiet():
            allowed: Any = {"use_scripts": True} if allow_scripts else {}  # else as Blender was started
            bpy.ops.wm.open_mainfile(filepath=str(resolved(path)), load_ui=False, **allowed)
    except RuntimeError as error:
        reason = str(error).removeprefix("Error: ").strip()
        raise SceneFileError(
            f"Blender cannot open '{path}' ({reason})",
            "is it a .blend file, whole, and of a Blender no newer than this one?",
        ) from error


def _scene(name: str) -> bpy.types.Scene:
    if not name:
        return bpy.context.scene
    scene = bpy.data.scenes.get(name)
    if scene is None:
        known = ", ".join(sorted(scene.name for scene in bpy.data.scenes))
        raise SceneFileError(f"the file has no scene '{name}'", f"choose one of {known}")
    return scene


def _windows() -> list[bpy.types.Window]:
    """Their scene is the one whose animated values Blender shows in the data."""
    return [window for manager in bpy.data.window_managers for window in manager.windows]


def _view_layer(scene: bpy.types.Scene, undo: ExitStack) -> bpy.types.ViewLayer:
    """The layer that is rendered: the active one if it is in use, else the first that is; alone."""
    used = [layer for layer in scene.view_layers if layer.use]
    if not used:
        raise SceneError(
            f"no view layer of the scene '{scene.name}' is used for rendering",
            "switch on 'Use for Rendering' in the View Layer properties",
        )
    active = next((window.view_layer for window in _windows() if window.scene == scene), None)
    layer = active if active in used else used[0]
    _set(undo, [(other, "use", False) for other in used if other != layer])
    _set(undo, [(layer, "samples", 0), (cycles(layer), "use_denoising", True)])
    return layer


@contextmanager
def _ours_removed() -> Iterator[None]:
    """Data that is added meanwhile is removed."""
    before = {kind: set(getattr(bpy.data, kind)) for kind in _OURS}
    try:
        yield
    finally:
        for kind in _OURS:
            bpy.data.batch_remove([block for block in getattr(bpy.data, kind) if block not in before[kind]])


def _cameras(
    scene: bpy.types.Scene,
    layer: bpy.types.ViewLayer,
    camera: bpy.types.Object,
    options: Options,
    report: Report,
) -> tuple[CameraHints, dict[str, Any]]:
    """Where the rig stands, and its description in dataset.json."""
    rays = Rays(scene, layer)
    centre = user_camera.pose(camera.evaluated_get(evaluated(layer)))
    distance, found_by = options.rig_distance, "--rig-distance"
    if distance is None and options.camera_rig != rig.PATH:
        distance, found_by = user_camera.target_distance(camera, centre, rays, options.resolution)
    hints = user_camera.hints(camera, centre, distance or 1.0, options)
    lens = camera_of(camera)
    if lens.shift_x or lens.shift_y:
        report.warn(
            f"the lens shift of '{camera.name}' is left out: a data set's principal point is in the middle"
        )
    source: dict[str, Any] = {
        "file": Path(bpy.data.filepath).name,
        "scene": scene.name,
        "view_layer": layer.name,
        "frame": scene.frame_current,
        "camera": camera.name,
    }
    if options.camera_rig == rig.PATH:
        source["frames"] = [scene.frame_start, scene.frame_end]
        report.say(
            f"the camera '{camera.name}' over frames {scene.frame_start} … {scene.frame_end}; "
            f"all else stands still at frame {scene.frame_current}"
        )
        if lens.animation_data and (lens.animation_data.action or lens.animation_data.drivers):
            report.warn(
                f"the lens of '{camera.name}' is animated: all views have its angle at frame "
                f"{scene.frame_current}"
            )
    else:
        assert distance is not None
        source["rig_distance"] = round(distance, 6)
        report.say(f"the rig looks at a point {distance:.3g} m before '{camera.name}' ({found_by})")
        _tell_of_obstacles(hints, rays, options, report)
    return hints, source


def _tell_of_obstacles(hints: CameraHints, rays: Rays, options: Options, report: Report) -> None:
    """Warn where the rig goes through walls: seen from the user's camera, a place of the rig is hidden."""
    places = rig.poses(options.camera_rig, hints, options.views, 0)
    centre = Vector(hints.centre)
    hidden = 0
    everywhere = [pose[:3, 3] for pose in [*places.train, *places.test]]
    for place in everywhere:
        way = Vector(place.tolist()) - centre
        if way.length > 1e-6 and rays.first(centre, way.normalized(), hints.clip[0], way.length):
            hidden += 1
    if hidden > CROWDED * len(everywhere):
        smaller = "--rig-extent" if options.camera_rig == "grid" else "--rig-arc or --rig-distance"
        report.warn(
            f"{hidden} of {len(everywhere)} cameras stand behind or within things, seen from the middle of "
            f"the rig: if pictures show walls from within, use a smaller {smaller}"
        )


def _tell_what_is_missing(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, report: Report) -> None:
    """Warn of what the pictures would lack or show wrongly."""
    lost = [library.name for library in bpy.data.libraries if library.is_missing]
    for image in bpy.data.images:
        if image.source == "FILE" and image.users and not image.packed_file and image.filepath:
            path = bpy.path.abspath(image.filepath, library=image.library)
            # Path.exists raises where the system refuses to look: in another user's home, at too long a name.
            if "<" not in Path(path).name and not os.path.exists(path):
                lost.append(image.name)
    if lost:
        report.warn(f"missing files (File > External Data): {', '.join(sorted(set(lost)))}")
    if bpy.app.autoexec_fail:
        report.warn(
            "Python in this file was not run, because nobody allowed it (Trusted Source on opening it, -y, "
            "or Preferences > Save & Load > Auto Run Python Scripts): what its drivers steer may look "
            "otherwise"
        )
    for warning in simulations.warnings(scene, layer):
        report.warn(warning)


def name_of_file() -> str:
    """The open file's name without its ending; 'untitled' where it has none."""
    return Path(bpy.data.filepath).stem or "untitled"
