# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles and colour settings for ground truth: set, recorded by their RNA path, put back afterwards."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from . import animation
from .blender import cycles
from .errors import DeviceError, SceneError
from .progress import quiet

WORKING_SPACE = "Linear Rec.709"
#: What configurations of colours (OCIO) call it.
_CALLED = (
    WORKING_SPACE,
    *("Linear Rec.709 (sRGB)", "lin_rec709", "lin_rec709_srgb"),
    *("Utility - Linear - Rec.709", "Utility - Linear - sRGB"),
)
WORKING_SPACE_PATH = "bpy.data.colorspace.working_space"

_STAMPS = ("date", "time", "render_time", "frame", "camera", "scene", "filename", "memory", "hostname")


def ground_truth(
    resolution: tuple[int, int],
    samples: int,
    device: str = "CPU",
    users: bool = False,
    noise_threshold: float = 0.0,
    threads: int = 0,
) -> list[tuple[str, Any]]:
    """(RNA path under the scene, value) in the order to set them.

    ``users``: a scene of the user's. It keeps its light paths, its view transform and its colour working
    space; the pictures are converted to Linear Rec.709 as they are written. ``noise_threshold``: Cycles'
    adaptive sampling with ``samples`` as the most; 0 takes all samples everywhere. ``threads``: 0 for all.
    """
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
        ("render.use_compositing", True),  # synth/compositor.py; every light is denoised there
        ("render.compositor_device", "CPU"),
        ("render.compositor_precision", "FULL"),
        ("render.compositor_denoise_device", "CPU"),
        ("render.use_sequencer", False),
        ("render.use_stamp", False),
        # Blender writes these into every EXR: the same seed would give other bytes.
        *((f"render.use_stamp_{name}", False) for name in _STAMPS),
        ("render.use_overwrite", True),
        ("render.use_placeholder", False),
        ("render.use_file_extension", False),
        ("render.use_persistent_data", True),
        *((("render.threads_mode", "FIXED"), ("render.threads", threads)) if threads else ()),
        ("render.image_settings.media_type", "IMAGE"),
        ("render.image_settings.file_format", "OPEN_EXR"),
        ("render.image_settings.color_mode", "RGB"),
        ("render.image_settings.color_depth", "32"),
        ("render.image_settings.exr_codec", "ZIP"),
        *(_USERS if users else _FOLLOW_SCENE),
        ("cycles.device", device),
        ("cycles.samples", samples),
        ("cycles.time_limit", 0.0),
        ("cycles.use_adaptive_sampling", noise_threshold > 0.0),
        ("cycles.adaptive_threshold", noise_threshold),
        ("cycles.adaptive_min_samples", 0),
        ("cycles.sampling_pattern", "BLUE_NOISE"),
        ("cycles.scrambling_distance", 1.0),
        ("cycles.auto_scrambling_distance", False),
        ("cycles.use_animated_seed", False),
        # Path guiding learns while it renders, by which thread comes first.
        ("cycles.use_guiding", False),
        # Clamping and the approximation of ambient light are not linear in the light, and not the truth.
        ("cycles.use_fast_gi", False),
        ("cycles.sample_clamp_direct", 0.0),
        ("cycles.sample_clamp_indirect", 0.0),
        *(() if users else _LIGHT_PATHS),
        ("cycles.film_exposure", 1.0),
        ("cycles.pixel_filter_type", "BLACKMAN_HARRIS"),
        ("cycles.filter_width", 1.5),
        ("cycles.use_denoising", False),
    ]


_FOLLOW_SCENE = (
    ("render.image_settings.color_management", "FOLLOW_SCENE"),
    ("view_settings.view_transform", "Standard"),
    ("view_settings.look", "None"),
    ("view_settings.exposure", 0.0),
    ("view_settings.gamma", 1.0),
    ("view_settings.use_curve_mapping", False),
    ("view_settings.use_white_balance", False),
)

_LIGHT_PATHS = (
    # Five lights: measured, the tree costs 40 % more time for no less noise.
    ("cycles.use_light_tree", False),
    ("cycles.light_sampling_threshold", 0.0),
    ("cycles.direct_light_sampling_type", "MULTIPLE_IMPORTANCE_SAMPLING"),
    ("cycles.max_bounces", 6),
    ("cycles.diffuse_bounces", 4),
    ("cycles.glossy_bounces", 3),
    ("cycles.transmission_bounces", 4),
    ("cycles.transparent_max_bounces", 8),
    ("cycles.caustics_reflective", False),
    ("cycles.caustics_refractive", False),
    ("cycles.blur_glossy", 1.0),
)

_USERS = (
    # Not FOLLOW_SCENE: where the user overrides, going back to it would fill in the scene's once more.
    ("render.image_settings.color_management", "OVERRIDE"),
    ("render.image_settings.linear_colorspace_settings.name", WORKING_SPACE),
    ("render.use_crop_to_border", False),
    ("render.use_freestyle", False),
    ("render.use_multiview", False),
    # What is culled depends on the camera: the views would not show one and the same scene.
    ("cycles.use_camera_cull", False),
    ("cycles.use_distance_cull", False),
    ("cycles.use_sample_subset", False),
)

#: What a picture of a user's scene depends on, besides the light paths, and is not set.
_USERS_OWN = (
    "cycles.min_light_bounces",
    "cycles.min_transparent_bounces",
    "cycles.volume_bounces",
    "cycles.volume_step_rate",
    "cycles.volume_max_steps",
    "cycles.volume_biased",
    "cycles.use_pixel_jitter",
    "cycles.shading_system",
    "cycles.dicing_rate",
    "cycles.offscreen_dicing_scale",
    "cycles.max_subdivisions",
    "cycles.texture_limit_render",
    "cycles.texture_resolution_render",
    "render.use_simplify",
    "render.simplify_subdivision_render",
    "render.simplify_child_particles_render",
    "render.simplify_volumes",
)


def users_own() -> list[str]:
    """RNA paths, under the scene, of the settings that a user's scene keeps and its pictures depend on."""
    return [*(path for path, _ in _LIGHT_PATHS), *_USERS_OWN]


def _owner(scene: bpy.types.Scene, path: str) -> tuple[Any, str]:
    holder, _, attribute = path.rpartition(".")
    return (scene.path_resolve(holder) if holder else scene), attribute


def called_here(owner: Any, attribute: str) -> str:
    """What ``WORKING_SPACE`` is called in the menu ``attribute``, which the configuration of colours fills.

    Raises:
        SceneError: there is no such space in it.
    """
    for name in _CALLED:
        if bpy.types.UILayout.enum_item_name(owner, attribute, name):
            return name
    raise SceneError(
        f"the configuration of colours (OCIO) has no space '{WORKING_SPACE}', in which radiance is written",
        "start Blender with its own configuration: without the variable OCIO",
    )


def _here(value: Any, owner: Any, attribute: str) -> Any:
    return called_here(owner, attribute) if value == WORKING_SPACE else value


def _set_working_space(name: str) -> None:
    if bpy.data.colorspace.working_space != name:
        bpy.ops.wm.set_working_color_space(working_space=name, convert_colors=False)


def check_denoiser(scene: bpy.types.Scene) -> None:
    """
    Raises:
        DeviceError: this Blender has no denoiser.
    """
    with quiet():  # asking for it makes Cycles look for GPUs and say so
        there = bool(cycles(scene).denoiser)
    if not there:
        raise DeviceError(
            "this Blender was built without the denoiser OpenImageDenoise",
            "render without denoising and with more samples (--no-denoise), or use blender.org's Blender",
        )


@contextmanager
def applied(
    scene: bpy.types.Scene, settings: list[tuple[str, Any]], working_space: str | None = WORKING_SPACE
) -> Iterator[dict[str, Any]]:
    """Set everything, yield the record {RNA path: value as Blender keeps it}; put all back, also on error.

    Keyframes and drivers of the scene on these paths are muted meanwhile.
    ``working_space``: ``None`` leaves the file's, in which its colours are given.
    """
    paths = {path for path, _ in settings}
    with animation.muted(scene, paths), _set(scene, settings, working_space) as record:
        yield record


@contextmanager
def _set(
    scene: bpy.types.Scene, settings: list[tuple[str, Any]], working_space: str | None
) -> Iterator[dict[str, Any]]:
    former_space = bpy.data.colorspace.working_space
    # All are read before the first is set: a file format changes the depth by itself.
    with quiet():  # asking for the denoiser makes Cycles look for GPUs and say so
        former = [(path, scene.path_resolve(path)) for path, _ in settings]
    try:
        with quiet():
            if working_space:
                _set_working_space(_here(working_space, bpy.data.colorspace, "working_space"))
            for path, value in settings:
                owner, attribute = _owner(scene, path)
                setattr(owner, attribute, _here(value, owner, attribute))
        record: dict[str, Any] = {WORKING_SPACE_PATH: bpy.data.colorspace.working_space}
        for path, _ in settings:
            owner, attribute = _owner(scene, path)
            record[f"scene.{path}"] = getattr(owner, attribute)
        for path, _ in _LIGHT_PATHS:  # where they are the user's own, they are recorded all the same
            record[f"scene.{path}"] = scene.path_resolve(path)
        yield record
    finally:
        for path, value in former:  # forward again: the format decides which depths there are
            owner, attribute = _owner(scene, path)
            # A menu without a choice follows the file format by itself.
            if value not in ("", getattr(owner, attribute)):
                setattr(owner, attribute, value)
        if working_space:
            _set_working_space(former_space)
