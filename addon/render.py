# SPDX-License-Identifier: GPL-3.0-or-later
"""Render settings that Gaussians need, a camera from a data set's pose, and pictures for comparing."""

from pathlib import Path

import bpy
import mathutils
import numpy as np

from ..bridge.errors import OutputError

#: Gaussians a ray may pass. Cycles' own limit is 1024; a ray through a trained room meets hundreds.
TRANSPARENT_BOUNCES = 1024
CLIP_START = 0.01
CLIP_END = 1000.0


def prepare_cycles(scene: bpy.types.Scene, samples: int = 1) -> None:
    """Set Cycles so that Gaussians come out as their radiance: no bounces, no clamp, no denoiser.

    One ray through the centre of each pixel: nothing in the materials is random, so the picture is free
    of noise at 1 sample, and it is what the trainer's rasterisers draw. More samples change nothing
    unless the pixel filter (``scene.cycles.filter_width``) is widened for antialiasing.
    """
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = True
    scene.render.use_motion_blur = False
    cycles = scene.cycles
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.sample_clamp_direct = 0.0
    cycles.sample_clamp_indirect = 0.0
    cycles.film_exposure = 1.0
    cycles.max_bounces = 0
    cycles.transparent_max_bounces = TRANSPARENT_BOUNCES
    # Rays are never ended at random: that would be the only noise.
    cycles.min_transparent_bounces = TRANSPARENT_BOUNCES
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 0.01
    cycles.use_light_tree = False


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
    camera.matrix_world = mathutils.Matrix(np.asarray(camera_to_world, float).tolist())
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def render_exr(scene: bpy.types.Scene, path: Path) -> None:
    """Render to a 32-bit float EXR: scene-linear, premultiplied, untouched by the view transform."""
    path.parent.mkdir(parents=True, exist_ok=True)
    settings = scene.render.image_settings
    settings.media_type = "IMAGE"
    settings.file_format = "OPEN_EXR"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"
    scene.render.use_file_extension = False
    scene.render.filepath = str(path)
    try:
        bpy.ops.render.render(write_still=True, scene=scene.name)
    except RuntimeError as error:
        raise OutputError(f"cannot render to {path}: {error}", "Check that you may write there.") from error


def read_exr(path: Path) -> np.ndarray:
    """``[H, W, 4]`` float32 scene-linear pixels of an EXR, top row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        image.colorspace_settings.name = "Non-Color"  # the numbers as they are
        image.alpha_mode = "CHANNEL_PACKED"
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]
