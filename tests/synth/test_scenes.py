# SPDX-License-Identifier: GPL-3.0-or-later
"""Every built-in scene: light that can be recombined, free cameras on every rig, and a range of 14 stops."""

import importlib
import pkgutil
import re
from collections.abc import Iterator

import bpy
import numpy as np
import pytest
from mathutils import Vector

from physhdr.synth import rig, scenes, settings
from physhdr.synth.built_in import SCENES, built
from physhdr.synth.rays import Rays
from physhdr.synth.renderer import renderer

NAMES = [name for name in SCENES if name != "ball"]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709
KINDS = ("objects", "meshes", "lights", "materials", "worlds", "images", "node_groups", "collections")
STOPS = 14.0


def counts() -> dict[str, int]:
    return {kind: len(getattr(bpy.data, kind)) for kind in KINDS}


def test_every_module_that_builds_a_scene_is_in_the_table_and_no_other():
    modules = {each.name: f"{scenes.__name__}.{each.name}" for each in pkgutil.iter_modules(scenes.__path__)}
    assert {name for name, path in modules.items() if hasattr(importlib.import_module(path), "build")} == {
        SCENES[name].build for name in NAMES
    }


#: Those that every run of the tests builds; each of the others takes seconds.
OFTEN = {"interior"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in OFTEN else pytest.mark.long) for name in NAMES]
)
def test_scene(name, tmp_path):
    """One build for everything: building and the first synchronisation cost more than the checks.

    What is wrong is collected as text: when pytest reports, the scene's data blocks are gone.
    """
    before = counts()
    with built(name) as stage:
        wrong = [*_lights(stage), *_cameras(stage), *_range(stage, tmp_path)]
    assert not wrong, "\n".join(wrong)
    assert counts() == before  # nothing is left behind


def _lights(stage) -> Iterator[str]:
    """Every emitter is in a group, each group can be turned, and names are fit for layers and sliders."""
    groups = list(stage.lights)
    if groups[0] != "ambient" or len(groups) < 3:
        yield f"groups are {groups}"
    yield from (f"group '{group}'" for group in groups if not re.fullmatch(r"[a-z][a-z0-9_]*", group))
    yield from (f"group '{group}' has no knob" for group in groups if not stage.lights[group])
    if {group.name for group in stage.view_layer.lightgroups} != set(groups):
        yield "the view layer has other light groups"
    if stage.scene.world.lightgroup not in groups:
        yield "the world is in no light group"
    for item in stage.scene.collection.all_objects:
        shines = item.type == "LIGHT" and not item.data.cycles.is_portal
        if item.type == "MESH":
            shines = any(_shines(slot.material) for slot in item.material_slots)
        if shines and item.lightgroup not in groups:
            yield f"{item.name} shines and is in no light group"


def _shines(material) -> bool:
    if material is None or material.node_tree is None:
        return False
    for node in material.node_tree.nodes:
        if node.type == "EMISSION":
            return True
        if node.type == "BSDF_PRINCIPLED":
            strength = node.inputs["Emission Strength"]
            if strength.is_linked or strength.default_value > 0.0:
                return True
    return False


def _cameras(stage) -> Iterator[str]:
    """No camera of any rig is within something or has something right before it."""
    rays = Rays(stage.scene, stage.view_layer)
    for name in rig.RIGS:
        poses = rig.poses(name, stage.cameras, 35, 12)
        for pose in [*poses.train, *poses.test, *poses.lit]:
            origin = Vector(pose[:3, 3])
            hit = rays.first(origin, -Vector(pose[:3, 2]))
            if hit is not None and (hit[0] - origin).length < 0.3:
                yield f"{name}: something is right before the camera at {origin}"
            outside = 0
            for axis in (pose[:3, 0], -pose[:3, 0], pose[:3, 1], -pose[:3, 1], -pose[:3, 2], pose[:3, 2]):
                hit = rays.first(origin, Vector(axis))
                outside += hit is None or hit[1].dot(Vector(axis)) <= 0.0
                if outside > 2:
                    break
            else:
                yield f"{name}: the camera at {origin} is within something"


def _range(stage, tmp_path) -> Iterator[str]:
    """At least 14 stops from the 1st percentile of luminance to its maximum, as dataset.json states it."""
    pose = rig.poses("grid", stage.cameras, 35, 0).train[9]
    wanted = settings.ground_truth((160, 160), 6)  # a bulb must fill a pixel to be as bright as it is
    # Of the sky, which no bulb is of: by itself Cycles spends longer on a map of it than on the picture.
    stage.scene.world.cycles.sampling_method, stage.scene.world.cycles.sample_map_resolution = "MANUAL", 256
    with settings.applied(stage.scene, wanted), renderer(stage, denoise=True) as camera:
        luminance = camera.render(pose, 1, tmp_path / "x.exr").radiance({}).astype(np.float64) @ LUMINANCE
    stops = np.log2(luminance.max() / np.percentile(luminance, 1))
    if not stops > STOPS:
        yield f"{stops:.1f} stops"
