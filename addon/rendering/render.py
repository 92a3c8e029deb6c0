# SPDX-License-Identifier: GPL-3.0-or-later
"""What Gaussians need of an engine's settings, a camera from a data set's pose, and pictures for comparing.

What an artist's scene is given stands in ``render_setup``, which spoils nothing; here are its parts, and the
settings of a scene that holds Gaussians alone.
"""

from pathlib import Path
from typing import Any, cast

import bpy
import numpy as np

from ...bridge.errors import DataMismatchError, OutputError
from ...bridge.regular import resolved
from ..blender import CLIP_END, CLIP_START, settings_of_cycles, to_matrix

#: Gaussians a ray may pass. Cycles' own limit is 1024; a ray through a trained room meets hundreds.
TRANSPARENT_BOUNCES = 1024
#: As many it passes for certain; then Cycles ends rays at random, the only noise there is (an ellipsoid
#: counts twice, a card once). With 20 k large overlapping Gaussians 256 is as good as 1024; with 128
#: ellipsoids show bright dots, and 32 leaves 14 dB to our rasteriser.
CERTAIN_BOUNCES = 256
#: The narrowest pixel filter of Cycles: every ray goes through its pixel's centre. Pixels.
POINT_SAMPLING = 0.01


def check_cycles(scene: bpy.types.Scene) -> None:
    """Raise ``DataMismatchError`` where Cycles is switched off, as an extension can be."""
    if not hasattr(scene, "cycles"):
        raise DataMismatchError("the Cycles add-on is switched off", "Enable it in Preferences > Add-ons.")


def prepare_cycles(scene: bpy.types.Scene, samples: int = 1, filter_width: float = POINT_SAMPLING) -> None:
    """Set Cycles so that Gaussians come out as their radiance: no bounces, no clamp, no denoiser.

    One ray through the centre of each pixel: nothing in the materials is random, so the picture is free
    of noise at 1 sample, and it is what the trainer's rasterisers draw. More samples help only with a
    ``filter_width`` (in pixels) near 1, for other objects' edges. Raises what ``check_cycles`` raises.
    """
    check_cycles(scene)
    render: Any = scene.render  # engines register themselves: Blender's types know none but EEVEE
    render.engine = "CYCLES"
    scene.render.film_transparent = True
    scene.render.use_motion_blur = False
    cycles = settings_of_cycles(scene)
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.sample_clamp_indirect = 0.0
    cycles.film_exposure = 1.0
    cycles.max_bounces = 0
    cycles.use_light_tree = False
    let_rays_pass(scene)
    sample_centres(scene, filter_width)


def let_rays_pass(scene: bpy.types.Scene) -> None:
    """Let Cycles' rays through all Gaussians that they meet. Who allows more keeps it; others stay."""
    cycles = settings_of_cycles(scene)
    cycles.transparent_max_bounces = max(cycles.transparent_max_bounces, TRANSPARENT_BOUNCES)
    cycles.min_transparent_bounces = max(cycles.min_transparent_bounces, CERTAIN_BOUNCES)


def sample_centres(scene: bpy.types.Scene, filter_width: float = POINT_SAMPLING) -> None:
    """Let Cycles and EEVEE look through the pixels' centres, and leave what they saw as it is.

    ``filter_width``: pixels. Edges of other objects are jagged then.
    """
    scene.render.filter_size = filter_width
    if not hasattr(scene, "cycles"):  # it can be switched off as an extension can
        return
    cycles = settings_of_cycles(scene)
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = filter_width
    cycles.use_denoising = False
    cycles.sample_clamp_direct = 0.0


def set_resolution(scene: bpy.types.Scene, width: int, height: int) -> None:
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.use_border = False


def add_camera(
    scene: bpy.types.Scene, camera_to_world: np.ndarray, angle_x: float, name: str = "PhysHDR camera"
) -> bpy.types.Object:
    """A pinhole camera at a 4×4 pose (Blender's axes), ``angle_x`` radians wide; made the active one."""
    data = bpy.data.cameras.new(name)
    data.sensor_fit = "HORIZONTAL"
    data.angle_x = angle_x
    data.clip_start, data.clip_end = CLIP_START, CLIP_END
    camera = bpy.data.objects.new(name, data)
    camera.matrix_world = to_matrix(camera_to_world)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def render_exr(scene: bpy.types.Scene, path: Path) -> None:
    """Render to a 32-bit float EXR: scene-linear, premultiplied, untouched by the view transform."""
    _make_folder_of(path)
    settings = scene.render.image_settings
    settings.media_type = "IMAGE"
    settings.file_format = "OPEN_EXR"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"
    scene.render.use_file_extension = False
    scene.render.filepath = str(resolved(path))
    try:
        bpy.ops.render.render(write_still=True, scene=scene.name)
    except RuntimeError as error:
        raise OutputError(f"cannot render to {path}: {error}", "Check that you may write there.") from error


def save_blend(path: Path) -> None:
    """Save the open file at ``path``, packed into itself as far as Gaussians are concerned."""
    _make_folder_of(path)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(resolved(path)), check_existing=False)
    except RuntimeError as error:
        raise OutputError(f"cannot save {path}: {error}", "Check that you may write there.") from error


def _make_folder_of(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot make the folder {path.parent}: {error.strerror or error}",
            "Choose another place, or fix its permissions.",
        ) from error


def read_exr(path: Path) -> np.ndarray:
    """``[H, W, 4]`` float32 scene-linear pixels of an EXR, top row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        settings = image.colorspace_settings
        assert settings is not None
        settings.is_data = True  # the numbers as they are
        image.alpha_mode = "CHANNEL_PACKED"
        width, height = cast(Any, image.size)
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]
