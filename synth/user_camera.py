# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own camera: its lens, what it looks at, and the rigs around it."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Vector

from .blender import camera_of, evaluated
from .errors import OptionError, SceneError
from .objects import SURFACES
from .options import FOLLOW, LARGEST_ELEVATION, Options
from .rays import Rays
from .rig import PATH, between
from .stage import WORLD_UP, CameraHints, RigPoses

#: Width and height of the grid over the distance: a step aside, not a walk around.
GRID_SHARE = (0.5, 0.3)
ARC = 90.0
#: Degrees of the hemisphere below and above the user's own camera.
BELOW, ABOVE = 20.0, 30.0
#: Rays across the picture, and down it, that find out how far away things are.
RASTER = 15
#: The share of those rays that must meet something.
ENOUGH = 0.1
#: Beyond this |cosine| to the vertical the grid's 'up' is the camera's own, not the world's.
STEEP = 0.9
GOLDEN = 0.6180339887498949
STILL = 1e-6
#: Objects whose bounds count: a volume's are those of the air that is around everything.
BOUNDED = SURFACES - {"VOLUME"}


def checked(scene: bpy.types.Scene) -> bpy.types.Object:
    """The scene's active camera.

    Raises:
        SceneError: there is none, or none whose pictures a pinhole camera could take.
    """
    camera = scene.camera
    if camera is None or camera.type != "CAMERA":
        raise SceneError(
            f"the scene '{scene.name}' has no camera", "add one and make it the active camera (Ctrl Numpad 0)"
        )
    lens = camera_of(camera)
    if lens.type != "PERSP":
        kind = {"ORTHO": "orthographic", "PANO": "panoramic", "CUSTOM": "of a custom kind"}
        raise SceneError(
            f"the camera '{camera.name}' is {kind.get(lens.type, lens.type)}",
            "a data set needs a perspective camera: change its type under Lens",
        )
    return camera


def resolution(scene: bpy.types.Scene, asked: tuple[int, int]) -> tuple[int, int]:
    """The size of the pictures: a height that is not given follows the aspect of the user's render."""
    width, height = asked
    if height == FOLLOW:
        render = scene.render
        tall = render.resolution_y * render.pixel_aspect_y / (render.resolution_x * render.pixel_aspect_x)
        height = max(1, round(width * tall))
    return width, height


def angle_x(lens: bpy.types.Camera, size: tuple[int, int]) -> float:
    """Horizontal field of view (radians) of square pixels: which side the sensor fits depends on the size."""
    width, height = size
    fit = lens.sensor_fit
    if fit == "AUTO":
        fit, sensor = ("HORIZONTAL" if width >= height else "VERTICAL"), lens.sensor_width
    else:
        sensor = lens.sensor_width if fit == "HORIZONTAL" else lens.sensor_height
    half = sensor / (2.0 * lens.lens)  # millimetres over millimetres
    return 2.0 * math.atan(half if fit == "HORIZONTAL" else half * width / height)


def pose(camera: bpy.types.Object) -> np.ndarray:
    """Camera to world [4, 4], a rotation and a translation: scale and shear of parents are left out."""
    matrix = np.array(camera.matrix_world, np.float64)
    back = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    up = matrix[:3, 1] - back * (matrix[:3, 1] @ back)
    up /= np.linalg.norm(up)
    rigid = np.eye(4)
    rigid[:3, 0], rigid[:3, 1], rigid[:3, 2] = np.cross(up, back), up, back
    rigid[:3, 3] = matrix[:3, 3]
    return rigid


def target_distance(
    camera: bpy.types.Object, centre: np.ndarray, rays: Rays, size: tuple[int, int]
) -> tuple[float, str]:
    """Metres along the view to what the user looks at, and how that was found out.

    The focus if the camera has one, else the median depth of what it sees, else the middle of the scene.
    """
    focus = camera_of(camera).dof
    assert focus is not None
    position, forward = centre[:3, 3], -centre[:3, 2]
    if focus.use_dof and focus.focus_object is not None:
        place = focus.focus_object.evaluated_get(rays.depsgraph).matrix_world.translation
        depth = float((np.array(place) - position) @ forward)
        if depth > 0.0:
            return depth, f"the focus object '{focus.focus_object.name}'"
    elif focus.use_dof and focus.focus_distance > 0.0:
        return focus.focus_distance, "the camera's focus distance"
    depths = _depths(camera, centre, rays, size)
    if len(depths) >= ENOUGH * RASTER**2:
        return float(np.median(depths)), "what the camera sees"
    low, high = _bounds(rays.depsgraph)
    middle = (low + high) / 2.0
    depth = float((middle - position) @ forward)
    if depth <= 0.0:
        depth = float(np.linalg.norm(middle - position))
    return max(depth, 10.0 * camera_of(camera).clip_start), "the middle of the scene"


def _depths(camera: bpy.types.Object, centre: np.ndarray, rays: Rays, size: tuple[int, int]) -> list[float]:
    lens = camera_of(camera)
    half = math.tan(angle_x(lens, size) / 2.0)
    at = (np.arange(RASTER) + 0.5) * 2.0 / RASTER - 1.0
    position, forward, found = Vector(centre[:3, 3].tolist()), -centre[:3, 2], []
    for y in at:
        for x in at:
            ray = centre[:3, :3] @ [x * half, y * half * size[1] / size[0], -1.0]
            length = float(np.linalg.norm(ray))  # of what is 1 m along the axis
            way = Vector((ray / length).tolist())
            hit = rays.first(position, way, lens.clip_start * length, lens.clip_end * length)
            if hit:
                found.append(float((np.array(hit[0]) - centre[:3, 3]) @ forward))
    return found


def _bounds(depsgraph: bpy.types.Depsgraph) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of all that has a surface."""
    corners = [
        np.array([instance.matrix_world @ Vector(corner) for corner in instance.object.bound_box])
        for instance in depsgraph.object_instances
        if instance.object and instance.object.type in BOUNDED
    ]
    if not corners:
        raise SceneError("the scene has nothing to look at", "add objects, or give --rig-distance")
    everything = np.concatenate(corners)
    return everything.min(0), everything.max(0)


def hints(camera: bpy.types.Object, centre: np.ndarray, distance: float, options: Options) -> CameraHints:
    """Rigs about the point ``distance`` in front of the user's camera, which is their middle."""
    lens, position, back = camera_of(camera), centre[:3, 3], centre[:3, 2]
    target = position - distance * back
    own = math.degrees(math.asin(float(np.clip(back[2], -1.0, 1.0))))
    if options.camera_rig == "orbit":
        low = high = own
    else:
        low, high = options.rig_elevation or (own - BELOW, own + ABOVE)
        if options.rig_elevation is None and own > 0.0:
            low = max(low, min(own, 0.0))  # a camera that looks down stays above what it looks at
    low, high = (float(np.clip(angle, -LARGEST_ELEVATION, LARGEST_ELEVATION)) for angle in (low, high))
    up = WORLD_UP if abs(back[2]) < STEEP else _three(centre[:3, 1])
    return CameraHints(
        centre=_three(position),
        target=_three(target),
        extent=options.rig_extent or (GRID_SHARE[0] * distance, GRID_SHARE[1] * distance),
        angle_x=angle_x(lens, options.resolution),
        orbit_radius=distance,
        orbit_arc=math.radians(ARC if options.rig_arc is None else options.rig_arc),
        elevation=(math.radians(low), math.radians(high)),
        up=up,
        clip=(lens.clip_start, lens.clip_end),
    )


def _three(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def path(
    scene: bpy.types.Scene, camera: bpy.types.Object, options: Options, *, aside: bool = False
) -> RigPoses:
    """The camera's own animation, whatever moves it: views evenly over the scene's frames.

    Every second one is a test view; lit and validation views lie between, spread over the whole way.

    Setting the scene to a frame and back, as is done, gives it the cameras of markers and takes the places
    that have no keyframe. ``aside`` leaves it as it is: of drivers, those that read the scene's own frame
    (not ``frame``) and simulated bodies then stand still.

    Raises:
        OptionError: the camera stands still.
    """
    first, last = scene.frame_start, scene.frame_end
    shares = [k / (options.views - 1) for k in range(options.views)]
    lit = [(0.5 + (k + 1) * GOLDEN) % 1.0 for k in range(options.lit_views)]
    validation = [between((k + 1) * GOLDEN % 1.0, options.views - 1) for k in range(options.validation_views)]
    with (_poses_aside if aside else _poses)(scene, camera) as pose_at:
        places = [pose_at(first + share * (last - first)) for share in [*shares, *lit, *validation]]
    views = places[: options.views]
    if max(np.abs(place - views[0]).max() for place in views) < STILL:
        raise OptionError(
            f"--camera-rig {PATH}: the camera '{camera.name}' stands still over the frames {first} … {last}",
        )
    rest = places[options.views :]
    return RigPoses(views[0::2], views[1::2], rest[: options.lit_views], rest[options.lit_views :])


@contextmanager
def _poses(scene: bpy.types.Scene, camera: bpy.types.Object) -> Iterator[Callable[[float], np.ndarray]]:
    """The camera's pose at a frame, to which the scene is set; in the end it is put back."""
    layer = bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]
    assert layer is not None

    def pose_at(frame: float) -> np.ndarray:
        whole = math.floor(frame)
        scene.frame_set(whole, subframe=frame - whole)
        return pose(camera.evaluated_get(evaluated(layer)))

    former = scene.frame_current, scene.frame_subframe
    try:
        yield pose_at
    finally:
        scene.frame_set(former[0], subframe=former[1])


@contextmanager
def _poses_aside(scene: bpy.types.Scene, camera: bpy.types.Object) -> Iterator[Callable[[float], np.ndarray]]:
    """The camera's pose at a frame of another scene, in which is nothing but the camera and what moves it."""
    aside = bpy.data.scenes.new(camera.name)
    try:
        aside.camera, aside.active_clip = camera, scene.active_clip  # the clip: of constraints that track
        for name in ("fps", "fps_base", "frame_map_old", "frame_map_new"):
            setattr(aside.render, name, getattr(scene.render, name))
        # ViewLayer.update() would make this the graph whose animation is written into the objects themselves,
        # and frame_set() calls the handlers of the user's add-ons. To count what is there makes a graph, too.
        aside.statistics(aside.view_layers[0])
        graph = evaluated(aside.view_layers[0])

        def pose_at(frame: float) -> np.ndarray:
            aside.frame_float = frame
            graph.update()
            return pose(camera.evaluated_get(graph))

        yield pose_at
    finally:
        bpy.data.scenes.remove(aside)
