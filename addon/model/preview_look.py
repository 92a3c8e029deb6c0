# SPDX-License-Identifier: GPL-3.0-or-later
"""How the live preview is looked at: by the sliders of the imported model that it shows, else by its own.

There is one place for exposure and levels: where a model of the backend's run is in the scene, its modifier's
inputs; the panel shows those, and the preview follows them.
"""

from collections.abc import Iterator
from typing import Literal

import bpy

from ...bridge.errors import PhysHDRError
from ...bridge.messages import JobStatus
from ..blender import cloud_of
from ..settings import SETTINGS, PHYSHDR_Settings, preview_levels
from .look import is_of_run, look_of
from .point_cloud import lights_of

#: Exposure (EV), a level for each of the job's lights, tone mapping.
PreviewLook = tuple[float, tuple[float, ...], Literal["linear", "learned"]]


def followed(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, job: JobStatus
) -> bpy.types.Object | None:
    """The scene's model whose sliders the preview follows: one of the run that the backend holds, the active
    one if several are. None where there is none."""
    models = list(_models_of(scene, job)) if job.has_model else []
    active = view_layer.objects.active
    return active if active in models else next(iter(models), None)


def preview_look(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, job: JobStatus) -> PreviewLook:
    """What the preview of this scene is asked for with; a light that the model has no level for is at 1."""
    chosen: PHYSHDR_Settings = getattr(scene, SETTINGS)
    model = followed(scene, view_layer, job)
    if model is None:
        return chosen.exposure_ev, preview_levels(chosen, job.lights), chosen.tone
    look = look_of(model)
    levels = dict(zip(lights_of(cloud_of(model)), look.lighting_levels, strict=True))
    tone: Literal["linear", "learned"] = "learned" if look.tone_mapper else "linear"
    return look.exposure_ev, tuple(levels.get(light, 1.0) for light in job.lights), tone


def _models_of(scene: bpy.types.Scene, job: JobStatus) -> Iterator[bpy.types.Object]:
    return (each for each in scene.objects if is_of_run(each, job.run) and _has_lights(each))


def _has_lights(target: bpy.types.Object) -> bool:
    """Whether its lights can be read: one that is damaged is followed by nobody."""
    try:
        lights_of(cloud_of(target))
    except PhysHDRError:
        return False
    return True
