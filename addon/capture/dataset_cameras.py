# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a model's data set as Blender's cameras: its pictures' own views, to render and compare.

Each stands where its picture was taken, by the pose that training has found (``cameras.json`` beside the
model's file) or else by the data set's, seen from where the model stands now, and goes along when scale and
ground of the capture are set (``placement``). A camera holds the focal length and the principal point of its
picture for every width of the render; the render's size and the shape of its pixels are the scene's, and are
set by ``take_size`` alone.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...bridge import data_set
from ...bridge.blend_file import SPLIT
from ...bridge.camera_list import read_learned_poses
from ...bridge.errors import DataMismatchError, FileMissingError
from ...bridge.run_folder import CAMERAS_FILE
from .. import outside, similarity
from ..blender import CLIP_END, CLIP_START, cloud_of, render_size, takes_objects, to_matrix, world_of
from ..layouts.cameras import Frame, Frames, read_frames
from ..layouts.views import VIEWS
from ..model import origin
from ..model.attributes import CAMERAS, CAPTURE, FILE
from ..model.point_cloud import cameras_in
from . import placement
from .placement import FRAME

#: Custom properties of a camera: its picture's width and height, and its focal lengths, in pixels.
RESOLUTION, FOCAL_LENGTHS = "physhdr_resolution", "physhdr_focal_lengths"
#: Drawn in the 3D view as large as this share of the cameras' spread, so that many do not hide each other.
DRAWN = 0.03
#: In this order one looks for a camera to look through: the first view that training has not seen.
FIRST = (data_set.TEST, VIEWS, data_set.TRAIN)
#: Said of cameras that stand where the run's ``cameras.json`` has them.
LEARNED_NOTE = "{} of {} stand where training has found their pictures to be taken from."
#: Said of cameras that came with the model's file.
OWN_NOTE = "The data set is not there: these are the training's cameras, which are in the model's file."
#: Pixels count as square where the focal lengths are as near to each other as this.
SQUARE = 1e-6


@dataclass(frozen=True)
class Imported:
    """``cameras``: all of the data set, in its order, of which ``added`` were not there before; ``notes``:
    sentences about what they are not."""

    cameras: tuple[bpy.types.Object, ...]
    added: int
    notes: tuple[str, ...]


def import_cameras(scene: bpy.types.Scene, target: bpy.types.Object, folder: Path | None = None) -> Imported:
    """Bring in the cameras of the data set of a model; those that are there already are put back.

    ``folder``: where the data set is now, if not where the model was trained from it. Where it is not there
    the cameras that came with the model are taken. Raises ``FileMissingError`` where none did,
    ``DataMismatchError`` where the model is sheared or mirrored, and what ``read_frames`` and
    ``read_learned_poses`` raise, before anything is made.
    """
    capture = origin.capture_of(target)
    found, learned = _frames(target, folder)
    bpy.context.view_layer.update()
    stands = np.array(world_of(target), np.float64)
    scale = similarity.scale_of(stands)
    there = {camera[FRAME]: camera for camera in reversed([*placement.cameras_of(scene, capture)])}
    frames = [_placed(frame, learned) for frame in found.frames]
    positions = np.array([frame.camera_to_world[:3, 3] for frame in frames])
    size = DRAWN * scale * float(np.ptp(positions, axis=0).max() if len(positions) > 1 else 1.0)
    cameras = []
    for frame in frames:
        camera = there.get(frame.name) or _new_camera(scene, capture, frame)
        _set_lens(camera, frame)
        lens = camera.data
        assert isinstance(lens, bpy.types.Camera)
        lens.clip_start, lens.clip_end = CLIP_START * min(scale, 1.0), CLIP_END * max(scale, 1.0)
        lens.display_size = max(size, 1e-3)
        camera.matrix_world = to_matrix(placement.without_scale(stands @ frame.camera_to_world))
        cameras.append(camera)
    bpy.context.view_layer.update()
    moved = sum(frame is not former for frame, former in zip(frames, found.frames, strict=True))
    notes = (*found.notes, LEARNED_NOTE.format(moved, len(frames))) if moved else found.notes
    return Imported(tuple(cameras), sum(frame.name not in there for frame in frames), notes)


def _learned(target: bpy.types.Object) -> dict[str, np.ndarray]:
    """Poses that the training of a model has found, by the frame's name; none where nobody knows its file."""
    file = str(cloud_of(target).get(FILE, ""))
    return read_learned_poses(Path(file).parent / CAMERAS_FILE) if file and outside.may_follow(file) else {}


def _placed(frame: Frame, learned: dict[str, np.ndarray]) -> Frame:
    """The frame where training has found its picture to be taken from, if it has.

    A data set may name the pictures of a bracket one by one, of which training makes one view.
    """
    pose = learned.get(frame.name, learned.get(frame.name.rpartition("_")[0]))
    return frame if pose is None else dataclasses.replace(frame, camera_to_world=pose)


def has_cameras(target: bpy.types.Object) -> bool:
    """Whether a model's cameras are known, from its data set or from its file."""
    return origin.data_of(target) is not None or CAMERAS in cloud_of(target)


def _frames(target: bpy.types.Object, folder: Path | None) -> tuple[Frames, dict[str, np.ndarray]]:
    """The cameras of a model's data set, or its own, and the poses that training has found."""
    folder = folder or origin.data_of(target)
    if folder is not None:
        return read_frames(folder), _learned(target)
    cameras = cameras_in(cloud_of(target))
    if not cameras:
        raise FileMissingError(
            f"the data set of {target.name!r} is not there: {origin.capture_of(target)}",
            "Put it back there, or choose its folder.",
        )
    frames = (
        Frame(
            each.name,
            VIEWS,
            each.camera_to_world,
            each.width,
            each.height,
            each.fx,
            each.fy,
            each.cx,
            each.cy,
        )
        for each in cameras
    )
    return Frames(tuple(frames), (OWN_NOTE,)), {}


def _new_camera(scene: bpy.types.Scene, capture: str, frame: Frame) -> bpy.types.Object:
    camera = bpy.data.objects.new(frame.name, bpy.data.cameras.new(frame.name))
    camera[FRAME], camera[CAPTURE], camera[SPLIT] = frame.name, capture, frame.split
    _collection_for(scene, capture, frame.split).objects.link(camera)
    return camera


def _collection_for(scene: bpy.types.Scene, capture: str, split: str) -> bpy.types.Collection:
    """The collection of a capture's cameras of a split, inside that of all its cameras."""
    whole = _child(scene.collection, f"Cameras of {Path(capture).name}", {CAPTURE: capture})
    return _child(whole, f"{whole.name}: {split}", {CAPTURE: capture, SPLIT: split})


def _child(parent: bpy.types.Collection, name: str, marks: dict[str, str]) -> bpy.types.Collection:
    """The collection with these custom properties, wherever the user moved it; made in ``parent``."""
    keys = (CAPTURE, SPLIT)
    for child in parent.children_recursive:
        if takes_objects(child) and all(child.get(key) == marks.get(key) for key in keys):
            return child
    made = bpy.data.collections.new(name)
    for key, value in marks.items():
        made[key] = value
    parent.children.link(made)
    return made


def _set_lens(camera: bpy.types.Object, frame: Frame) -> None:
    """The pinhole of a frame: Blender counts both shifts in widths of the picture, up and to the right."""
    lens = camera.data
    assert isinstance(lens, bpy.types.Camera)
    lens.type, lens.sensor_fit, lens.lens_unit = "PERSP", "HORIZONTAL", "MILLIMETERS"
    lens.lens = frame.fx * lens.sensor_width / frame.width
    lens.shift_x = 0.5 - frame.cx / frame.width
    lens.shift_y = (frame.cy - 0.5 * frame.height) * frame.fx / (frame.fy * frame.width)
    camera[RESOLUTION] = [frame.width, frame.height]
    camera[FOCAL_LENGTHS] = [frame.fx, frame.fy]


def first_place(target: bpy.types.Object) -> Frame | None:
    """The camera to look through first, where the model stands now; None where its cameras are not known.

    Raises as ``import_cameras``; nothing is made.
    """
    if not has_cameras(target):
        return None
    found, learned = _frames(target, None)
    for split in FIRST:
        for frame in found.frames:
            if frame.split == split:
                pose = np.array(world_of(target), np.float64) @ _placed(frame, learned).camera_to_world
                return dataclasses.replace(frame, camera_to_world=placement.without_scale(pose))
    return None


def is_of_data_set(camera: bpy.types.Object | None) -> bool:
    """Whether an object is a camera that came from a data set."""
    return camera is not None and camera.type == "CAMERA" and FRAME in camera and RESOLUTION in camera


def cameras_of(scene: bpy.types.Scene, target: bpy.types.Object) -> list[bpy.types.Object]:
    """The scene's cameras of a model's data set."""
    return list(placement.cameras_of(scene, origin.capture_of(target)))


def first_of(cameras: Iterator[bpy.types.Object] | tuple[bpy.types.Object, ...]) -> bpy.types.Object | None:
    """The camera to look through first: of a view that training has not seen, where there is one."""
    ordered = list(cameras)
    for split in FIRST:
        for camera in ordered:
            if camera.get(SPLIT) == split:
                return camera
    return ordered[0] if ordered else None


def size_of(camera: bpy.types.Object) -> tuple[int, int]:
    """Width and height of the camera's picture, pixels."""
    width, height = camera[RESOLUTION]
    return int(width), int(height)


def has_size(scene: bpy.types.Scene, camera: bpy.types.Object) -> bool:
    """Whether the scene's render has the camera's picture's width and height."""
    return render_size(scene) == size_of(camera)


def take_size(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Give the scene's render the size of the camera's picture, and its pixels' shape.

    Raises ``DataMismatchError`` for a camera that is of no data set.
    """
    if not is_of_data_set(camera):
        raise DataMismatchError(
            f"{camera.name!r} is not a camera of a data set: it has no size", "Choose one of the data set's."
        )
    render = scene.render
    render.resolution_x, render.resolution_y = size_of(camera)
    render.resolution_percentage = 100
    fx, fy = camera[FOCAL_LENGTHS]
    taller = fx / fy  # a pixel's height in its widths
    square = abs(taller - 1.0) < SQUARE
    # Blender takes numbers from 1.
    render.pixel_aspect_x = 1.0 if square or taller >= 1.0 else 1.0 / taller
    render.pixel_aspect_y = 1.0 if square or taller <= 1.0 else taller
