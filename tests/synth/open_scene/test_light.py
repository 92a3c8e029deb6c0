# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of the user's scene at other levels: world, suns, light groups, linked libraries."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from physhdr.bridge import data_set
from physhdr.synth import dataset, open_scene
from physhdr.synth.errors import SceneError
from physhdr.synth.progress import Report
from physhdr.tests.synth import conftest as readers
from physhdr.tests.synth.open_scene.user_scene import (
    SMALL,
    add,
    background,
    light,
    lights_of,
    linked_strength,
    state_of_light,
)


@pytest.mark.parametrize(
    "prepare", [linked_strength, pytest.param(lambda scene: None, marks=pytest.mark.long)]
)
def test_a_level_scales_the_world_and_the_suns_alone(scene, tmp_path, prepare):
    """The relit truth at level 4 is lamps + 4 × ambient, both rendered apart with the light deleted."""
    prepare(scene)
    options = replace(SMALL, samples=64, lit_views=0, views=4)
    dataset.make(tmp_path / "both", options)
    relit = readers.read_exr(tmp_path / "both/relit/level_4/hdr_001.exr")
    normal = readers.read_exr(tmp_path / "both/test_hdr/hdr_001.exr")
    lamp = bpy.data.objects["lamp"]
    lamp.hide_render = True
    dataset.make(tmp_path / "ambient", replace(options, relit_views=0))
    ambient = readers.read_exr(tmp_path / "ambient/test_hdr/hdr_001.exr")
    lamp.hide_render = False
    bpy.data.objects["sun"].hide_render = True
    scene.world = None
    dataset.make(tmp_path / "lamps", replace(options, relit_views=0))
    lamps = readers.read_exr(tmp_path / "lamps/test_hdr/hdr_001.exr")
    assert ambient.mean() > 0.05 and lamps.mean() > 0.05  # both matter

    def noise(a, b):
        return float(np.mean(np.abs(a - b)) / np.mean(a))

    assert noise(normal, lamps + ambient) < 0.03
    assert noise(relit, lamps + 4.0 * ambient) < 0.03
    assert noise(relit, 4.0 * (lamps + ambient)) > 0.1  # the lamps did not follow
    assert abs(np.mean(relit - lamps - 4.0 * ambient)) < 0.01 * np.mean(relit)


def test_an_animated_sun_in_a_collection_instance_is_ambient_too(scene, tmp_path):
    """The sun is nobody's in the scene itself: only an instance brings it, and its energy is keyframed."""
    sun = bpy.data.objects["sun"]
    sun.data.keyframe_insert("energy", frame=1)
    hidden = bpy.data.collections.new("sky things")
    hidden.objects.link(sun)
    scene.collection.objects.unlink(sun)
    holder = add("instance", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", hidden
    scene.world = None
    ambient, lamps = lights_of(tmp_path / "d", replace(SMALL, samples=16))
    bpy.data.objects["lamp"].hide_render = True
    (alone, dark) = lights_of(tmp_path / "alone", replace(SMALL, samples=16))
    assert ambient.mean() > 0.05 and lamps.mean() > 0.05
    assert alone.mean() == pytest.approx(ambient.mean(), rel=0.02) and dark.max() < 1e-4
    assert sun.lightgroup == "" and sun.data.animation_data.action and len(bpy.data.lights) == 2


def test_the_users_light_groups_are_further_lights(scene, tmp_path):
    """A group with a lamp and one with a glowing cube; empty ones, and suns in one, are none."""
    layer = scene.view_layers[0]
    groups = [
        layer.lightgroups.add(name=name).name for name in ("Key Light 001", "nothing", "glow", "theirs")
    ]
    layer.active_lightgroup_index = 1
    key = light("key", "POINT", 40.0, (-2, -2, 2))
    key.lightgroup = groups[0]
    glow = bpy.data.materials.new("glow")
    glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 2.0
    cube = bpy.data.objects["cube"]
    cube.data.materials[0] = glow
    cube.lightgroup = "glow"
    bpy.data.objects["sun"].lightgroup = "theirs"
    scene.world.lightgroup = "theirs"
    before = state_of_light(scene)
    options = replace(SMALL, samples=64, lit_views=4, lit_lights=("key_light_001", "ambient"), views=4)
    names = ["ambient", "key_light_001", "glow", "lamps"]
    parts = dict(zip(names, lights_of(tmp_path / "d", options, lights=names), strict=True))
    told = readers.read_json(tmp_path / "d/dataset.json")
    assert told["lights"] == names and told["lit_lights"] == names[:2]
    assert {"folder": "relit/key_light_001_4", "levels": {"key_light_001": 4.0}} in told["relit"]
    assert state_of_light(scene) == before
    for light_name, items in (("key_light_001", ["key"]), ("glow", ["cube"]), ("lamps", ["lamp"])):
        assert parts[light_name].mean() > 0.01, items
    key.hide_render = True
    without = lights_of(
        tmp_path / "without", replace(options, lit_lights=("ambient",)), lights=[names[0], *names[2:]]
    )
    whole = sum(light.astype(np.float64) for light in parts.values())
    rest = sum(light.astype(np.float64) for light in without)
    assert np.mean(np.abs(whole - rest - parts["key_light_001"])) < 0.05 * whole.mean()


def test_a_light_group_called_level_leaves_the_ambient_lights_folders_alone(scene, tmp_path):
    bpy.data.objects["lamp"].lightgroup = scene.view_layers[0].lightgroups.add(name="Level").name
    options = replace(SMALL, views=2, lit_views=4, lit_lights=("ambient", "level_2"))
    dataset.make(tmp_path, options)
    told = readers.read_json(tmp_path / "dataset.json")
    assert told["lights"] == ["ambient", "level_2", "lamps"]
    relit = {entry["folder"]: entry["levels"] for entry in told["relit"]}
    assert relit["relit/level_4"] == {"ambient": 4.0} and relit["relit/level_2_4"] == {"level_2": 4.0}
    assert all(data_set.mixture_levels(folder) == levels for folder, levels in relit.items())


def test_light_from_a_linked_library(scene, tmp_path):
    """World and an animated sun of another file follow the level, and stay linked and as they were."""
    sun = bpy.data.objects["sun"]
    sun.data.keyframe_insert("energy", frame=1)
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {sun, scene.world}, fake_user=True)
    bpy.data.objects.remove(sun)
    bpy.data.worlds.remove(scene.world)
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects, target.worlds = ["sun"], ["sky"]
    linked = bpy.data.objects["sun"]
    scene.collection.objects.link(linked)
    scene.world = bpy.data.worlds["sky"]
    assert linked.library and scene.world.library
    options = replace(SMALL, samples=32, lit_views=0)
    dataset.make(tmp_path / "d", options)
    normal = readers.read_exr(tmp_path / "d/test_hdr/hdr_001.exr").mean()
    relit = readers.read_exr(tmp_path / "d/relit/level_4/hdr_001.exr").mean()
    bpy.data.objects["lamp"].hide_render = True
    dataset.make(tmp_path / "ambient", replace(options, relit_views=0))
    ambient = readers.read_exr(tmp_path / "ambient/test_hdr/hdr_001.exr").mean()
    assert relit - normal == pytest.approx(3.0 * ambient, rel=0.02)
    assert linked.data.library and linked.data.energy == pytest.approx(2.0)
    assert scene.world.library and background().inputs["Strength"].default_value == 0.5


def test_only_lamps_leave_nothing_to_relight(scene, tmp_path):
    scene.world = None
    bpy.data.objects["sun"].hide_render = True
    dataset.make(tmp_path, SMALL)
    told = readers.read_json(tmp_path / "dataset.json")
    assert "no ambient light" in told["source"]["warnings"][0]
    assert told["splits"] == {"train": 3, "test": 3, "lit": 0} and not (tmp_path / "relit").exists()


def test_dark_scenes_are_refused_and_emission_is_light(scene, tmp_path):
    scene.world = None
    for name in ("sun", "lamp"):
        bpy.data.objects[name].hide_render = True
    with pytest.raises(SceneError, match="has no light"):
        dataset.make(tmp_path / "d", SMALL)
    shader = bpy.data.materials["grey"].node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Strength"].default_value = 2.0
    with open_scene.opened(SMALL, Report()):
        pass
