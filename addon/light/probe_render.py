# SPDX-License-Identifier: GPL-3.0-or-later
"""A light probe without a backend: Cycles draws an imported model's ellipsoids in all directions.

The model is copied into a scene of its own, where it stands as in its file, at the levels that tell its
lights apart; whatever was edited on it counts.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.panorama import PANORAMIC_CAMERA_TURN, near_distance, too_near, unseen_share
from ...bridge.probe import Probe, begin, check_width, finish
from ...bridge.sphere_fill import filled
from ...synth import exr
from ..blender import cloud_of, settings_of_cycles
from ..model import nodes
from ..model.attributes import BASE, POSITION, ROTATION, SCALE
from ..model.look import cleaning_of, kept_of
from ..model.point_cloud import lights_of, read_attribute, read_levels, write_attribute
from ..rendering.render import check_cycles, prepare_cycles, read_exr, render_exr, set_resolution

#: Rays a pixel, spread over all of it: what is finer than a pixel is averaged.
SAMPLES = 4
#: Surfaces that a ray passes for certain; it ends at random after, as likely as it is faint. Far fewer than
#: for a picture (``render``): a third of the time, and what noise that leaves is averaged by lighting.
CERTAIN_BOUNCES = 32

Report = Callable[[float], None]


def render_probe(
    target: bpy.types.Object,
    at: tuple[float, float, float],
    width: int,
    folder: Path,
    report: Report = lambda _: None,
) -> Probe:
    """Write the panoramas of a model seen from ``at`` ``[3]``, in its own space; raises ``OutputError``, and
    ``DataMismatchError`` where Cycles is switched off."""
    check_width(width)
    check_cycles(bpy.context.scene)
    cloud = cloud_of(target)
    lights = () if read_levels(cloud) else lights_of(cloud)
    begin(folder)
    place = np.asarray(at)
    shape = [read_attribute(cloud, each.name) for each in (POSITION, ROTATION, SCALE)]
    near = near_distance(shape[0], place)
    close = too_near(shape[0], shape[1], shape[2], place, near)
    hidden = ~kept_of(cloud, cleaning_of(target).without_camera())
    # All lights off, then each alone: the first picture is what no light turns.
    settings = [tuple(float(index == lit) for index in range(len(lights))) for lit in range(-1, len(lights))]
    settings = settings if lights else [(1.0,)]
    drawn: list[np.ndarray] = []
    with _stage(target, close | hidden, at, width) as (scene, model):
        for levels in settings:
            _set_levels(model, levels)
            path = folder / "fixed.exr"  # in the place of a picture that is written there at the end
            render_exr(scene, path)
            drawn.append(read_exr(path))
            path.unlink()
            report(len(drawn) / len(settings))
    alpha = drawn[0][..., 3].clip(0.0, 1.0)
    fixed = drawn[0][..., :3]
    parts = np.stack([fixed, *(np.maximum(each[..., :3] - fixed, 0.0) for each in drawn[1:])])
    probe = Probe(
        at=at,
        width=width,
        lights=lights,
        unseen=unseen_share(alpha),
        near=near,
        left_out=int((close & ~hidden).sum()),
        gaussians=len(cloud.points),
        made_by=f"Blender {bpy.app.version_string}",
        source=target.name,
    )
    for name, part in zip(probe.files, filled(parts, alpha), strict=True):
        with atomic_path(folder / name) as temporary:
            temporary.write_bytes(exr.encode_rgb(part))
    finish(folder, probe)
    return probe


@contextmanager
def _stage(
    target: bpy.types.Object, left_out: np.ndarray, at: tuple[float, float, float], width: int
) -> Iterator[tuple[bpy.types.Scene, bpy.types.Object]]:
    """A scene with a copy of the model, as it stands in its file, and a camera that sees all round."""
    scene = bpy.data.scenes.new("PhysHDR light probe")
    lens = bpy.data.cameras.new("PhysHDR light probe")
    camera = bpy.data.objects.new("PhysHDR light probe", lens)
    model = target.copy()
    cloud: bpy.types.PointCloud | None = None
    try:
        if left_out.any():
            model.data = cloud = cloud_of(target).copy()
            base = read_attribute(cloud, BASE.name)
            base[left_out, 3] = 0.0
            write_attribute(cloud, BASE, base)
        model.animation_data_clear()
        model.constraints.clear()
        model.parent = None
        model.matrix_world = mathutils.Matrix.Identity(4)
        model.hide_render = model.is_holdout = model.is_shadow_catcher = False
        model.visible_camera = True
        _as_captured(model)
        scene.collection.objects.link(model)
        lens.type = "PANO"
        settings: Any = lens if hasattr(lens, "panorama_type") else getattr(lens, "cycles")  # noqa: B009
        settings.panorama_type = "EQUIRECTANGULAR"
        camera.location, camera.rotation_euler = at, PANORAMIC_CAMERA_TURN
        scene.collection.objects.link(camera)
        scene.camera = camera
        prepare_cycles(scene, SAMPLES, filter_width=1.0)
        settings_of_cycles(scene).min_transparent_bounces = CERTAIN_BOUNCES
        set_resolution(scene, width, width // 2)
        yield scene, model
    finally:
        for block in (model, camera):
            bpy.data.objects.remove(block)
        bpy.data.cameras.remove(lens)
        if cloud is not None:
            bpy.data.pointclouds.remove(cloud)
        bpy.data.scenes.remove(scene)


def _as_captured(model: bpy.types.Object) -> None:
    """Radiance as it is toward the camera, as ellipsoids, which are right in every direction."""
    modifier = nodes.find_modifier(model)
    assert modifier is not None
    modifier.show_render = True
    wanted: dict[str, Any] = {
        nodes.EXPOSURE: 0.0,
        nodes.TONE_MAPPER: False,
        nodes.VIEW_DEPENDENT: True,
        nodes.CAMERA_SPLATS: False,
        nodes.IMAGE_WIDTH: 0,
    }
    for label, value in wanted.items():
        if nodes.has_input(modifier, label):
            nodes.set_input(modifier, label, value)
    # What is hidden is left out already: the crop box stands where the model does, which is not here.
    for label in (*nodes.CLEANING, *nodes.CULLING):
        if label != nodes.SH_DEGREE and nodes.has_input(modifier, label):
            found = getattr(nodes.inputs_of(modifier), nodes.input_identifier(modifier, label)).value
            if isinstance(found, bool | int | float):
                nodes.set_input(modifier, label, type(found)(0))


def _set_levels(model: bpy.types.Object, levels: tuple[float, ...]) -> None:
    modifier = nodes.find_modifier(model)
    assert modifier is not None
    lights = lights_of(cloud_of(model))
    for index, level in enumerate(levels):
        nodes.set_input(modifier, nodes.level_input(lights, index), level)
