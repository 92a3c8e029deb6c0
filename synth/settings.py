# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles and colour settings for ground truth: set, recorded by their RNA path, put back afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from .progress import quiet

WORKING_SPACE = "Linear Rec.709"
WORKING_SPACE_PATH = "bpy.data.colorspace.working_space"

_STAMPS = ("date", "time", "render_time", "frame", "camera", "scene", "filename", "memory", "hostname")


def ground_truth(resolution: tuple[int, int], samples: int, denoise: bool) -> list[tuple[str, Any]]:
    """(RNA path under the scene, value) in the order to set them."""
    return [
        ("render.engine", "CYCLES"),
        ("render.resolution_x", resolution[0]),
        ("render.resolution_y", resolution[1]),
        ("render.resolution_percentage", 100),
        ("render.pixel_aspect_x", 1.0),
        ("render.pixel_aspect_y", 1.0),
        ("render.use_border", False),
        ("render.use_motion_blur", False),
        ("render.film_transparent", False),
        ("render.dither_intensity", 0.0),
        ("render.use_compositing", False),
        ("render.use_sequencer", False),
        ("render.use_stamp", False),
        # Blender writes these into every EXR: the same seed would give other bytes.
        *((f"render.use_stamp_{name}", False) for name in _STAMPS),
        ("render.use_overwrite", True),
        ("render.use_placeholder", False),
        ("render.use_file_extension", False),
        ("render.use_persistent_data", True),
        ("render.image_settings.media_type", "IMAGE"),
        ("render.image_settings.file_format", "OPEN_EXR"),
        ("render.image_settings.color_mode", "RGB"),
        ("render.image_settings.color_depth", "32"),
        ("render.image_settings.exr_codec", "ZIP"),
        ("render.image_settings.color_management", "FOLLOW_SCENE"),
        ("view_settings.view_transform", "Standard"),
        ("view_settings.look", "None"),
        ("view_settings.exposure", 0.0),
        ("view_settings.gamma", 1.0),
        ("view_settings.use_curve_mapping", False),
        ("view_settings.use_white_balance", False),
        ("cycles.device", "CPU"),
        ("cycles.samples", samples),
        ("cycles.time_limit", 0.0),
        ("cycles.use_adaptive_sampling", False),
        ("cycles.sampling_pattern", "BLUE_NOISE"),
        ("cycles.scrambling_distance", 1.0),
        ("cycles.auto_scrambling_distance", False),
        ("cycles.use_animated_seed", False),
        # Five lights: measured, the tree costs 40 % more time for no less noise.
        ("cycles.use_light_tree", False),
        ("cycles.light_sampling_threshold", 0.0),
        ("cycles.direct_light_sampling_type", "MULTIPLE_IMPORTANCE_SAMPLING"),
        ("cycles.use_guiding", False),
        ("cycles.use_fast_gi", False),
        ("cycles.sample_clamp_direct", 0.0),
        ("cycles.sample_clamp_indirect", 0.0),
        ("cycles.max_bounces", 6),
        ("cycles.diffuse_bounces", 4),
        ("cycles.glossy_bounces", 3),
        ("cycles.transmission_bounces", 4),
        ("cycles.transparent_max_bounces", 8),
        ("cycles.caustics_reflective", False),
        ("cycles.caustics_refractive", False),
        ("cycles.blur_glossy", 1.0),
        ("cycles.film_exposure", 1.0),
        ("cycles.pixel_filter_type", "BLACKMAN_HARRIS"),
        ("cycles.filter_width", 1.5),
        ("cycles.use_denoising", denoise),
        ("cycles.denoiser", "OPENIMAGEDENOISE"),
        ("cycles.denoising_input_passes", "RGB_ALBEDO_NORMAL"),
        # Measured: "ACCURATE" costs a third of a second a frame and gains 0.2 dB.
        ("cycles.denoising_prefilter", "FAST"),
        ("cycles.denoising_quality", "HIGH"),
        ("cycles.denoising_use_gpu", False),
    ]


def _owner(scene: bpy.types.Scene, path: str) -> tuple[Any, str]:
    holder, _, attribute = path.rpartition(".")
    return (scene.path_resolve(holder) if holder else scene), attribute


def _set_working_space(name: str) -> None:
    if bpy.data.colorspace.working_space != name:
        bpy.ops.wm.set_working_color_space(working_space=name, convert_colors=False)


@contextmanager
def applied(scene: bpy.types.Scene, settings: list[tuple[str, Any]]) -> Iterator[dict[str, Any]]:
    """Set everything, yield the record {RNA path: value as Blender keeps it}; put all back, also on error."""
    former_space = bpy.data.colorspace.working_space
    # All are read before the first is set: a file format changes the depth by itself.
    with quiet():  # asking for the denoiser makes Cycles look for GPUs and say so
        former = [(path, scene.path_resolve(path)) for path, _ in settings]
    try:
        with quiet():
            _set_working_space(WORKING_SPACE)
            for path, value in settings:
                owner, attribute = _owner(scene, path)
                setattr(owner, attribute, value)
        record = {WORKING_SPACE_PATH: bpy.data.colorspace.working_space}
        for path, _ in settings:
            owner, attribute = _owner(scene, path)
            record[f"scene.{path}"] = getattr(owner, attribute)
        yield record
    finally:
        for path, value in former:  # forward again: the format decides which depths there are
            owner, attribute = _owner(scene, path)
            setattr(owner, attribute, value)
        _set_working_space(former_space)
