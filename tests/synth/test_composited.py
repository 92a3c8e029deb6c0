# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights add up to the picture where shadow catchers or drawings are in a scene, and the user is told."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")

from physhdr.synth import composited, open_scene, settings  # noqa: E402
from physhdr.synth.options import CURRENT, Options  # noqa: E402
from physhdr.synth.passes import Passes  # noqa: E402
from physhdr.synth.progress import Report  # noqa: E402
from physhdr.synth.renderer import renderer  # noqa: E402

OPTIONS = Options(
    from_file=CURRENT, resolution=(16, 12), samples=16, views=2, lit_views=0, relit_views=0, denoise=False
)


def add(name, data, location=(0, 0, 0)):
    item = bpy.data.objects.new(name, data)
    item.location = location
    bpy.context.scene.collection.objects.link(item)
    return item


@pytest.fixture
def scene():
    """A floor under a white sky and a lamp, from above: it fills the picture."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    floor = bpy.data.meshes.new("floor")
    floor.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    add("floor", floor)
    lamp = bpy.data.lights.new("lamp", "POINT")
    lamp.energy = 100.0
    add("lamp", lamp, (1, -1, 2))
    scene.world = bpy.data.worlds.new("sky")
    scene.camera = add("camera", bpy.data.cameras.new("camera"), (0, 0, 4))
    sky("Color", (1.0, 1.0, 1.0, 1.0))
    sky("Strength", 1.0)
    return scene


def sky(name, value):
    nodes = bpy.data.worlds["sky"].node_tree.nodes
    next(node for node in nodes if node.type == "BACKGROUND").inputs[name].default_value = value


def rendered(path) -> tuple[Passes, str, list[str]]:
    """One view of the scene, its fingerprint, and what was told."""
    report = Report()
    with open_scene.opened(OPTIONS, report) as (stage, options):
        wanted = settings.ground_truth(options.resolution, options.samples, "CPU", True, 0.0, threads=1)
        with settings.applied(stage.scene, wanted, None), renderer(stage, False) as camera:
            return camera.render(stage.poses.train[0], 1, path / "x.exr"), stage.fingerprint, report.warnings


def test_a_shadow_catcher_is_a_surface_as_any_other(scene, tmp_path):
    """Against the same render without one, and against a sky that is twice as bright; keyframed, too."""
    plain, mark, told = rendered(tmp_path)
    assert told == []
    floor = bpy.data.objects["floor"]
    floor.is_shadow_catcher = True
    floor.keyframe_insert("is_shadow_catcher", frame=1)
    caught, mark_caught, (told,) = rendered(tmp_path)
    assert "shadow catcher" in told and told.endswith(": floor")
    action = floor.animation_data.action
    assert floor.is_shadow_catcher
    assert not action.fcurve_ensure_for_datablock(floor, "is_shadow_catcher").mute
    np.testing.assert_array_equal(caught.raw, plain.raw)
    sky("Strength", 2.0)
    brighter, *_ = rendered(tmp_path)
    np.testing.assert_allclose(caught.radiance({"ambient": 2.0}), brighter.raw, rtol=1e-3, atol=1e-4)
    assert mark_caught == mark


def test_a_catcher_in_an_instance_is_a_surface_too(scene, tmp_path):
    """Cycles asks the object, and the one that instances it."""
    floor = bpy.data.objects["floor"]
    away = bpy.data.collections.new("away")
    away.objects.link(floor)
    scene.collection.objects.unlink(floor)
    holder = add("holder", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", away
    bpy.context.view_layer.update()
    plain, *_ = rendered(tmp_path)
    for item in (floor, holder):
        item.is_shadow_catcher = True
        bpy.context.view_layer.update()
        picture, _, (told,) = rendered(tmp_path)
        assert told.endswith(f": {item.name}") and item.is_shadow_catcher
        np.testing.assert_array_equal(picture.raw, plain.raw)
        np.testing.assert_allclose(picture.radiance({}), picture.raw, rtol=1e-4, atol=1e-5)
        item.is_shadow_catcher = False


def test_drawings_are_left_out(scene, tmp_path):
    """Grease Pencil is in no light group: the same bytes as without, and the same scene as without."""
    plain, mark, _ = rendered(tmp_path)
    bpy.ops.object.grease_pencil_add(type="MONKEY", location=(0, 0, 2))
    drawing = bpy.context.object
    assert drawing.type == composited.DRAWN
    drawn, mark_drawn, (told,) = rendered(tmp_path)
    np.testing.assert_array_equal(drawn.raw, plain.raw)
    np.testing.assert_allclose(drawn.radiance({}), drawn.raw, rtol=1e-4, atol=1e-5)
    assert "Grease Pencil" in told and told.endswith(f": {drawing.name}")
    assert mark_drawn == mark and scene.view_layers[0].use_grease_pencil
    drawing.hide_render = True
    assert rendered(tmp_path)[2] == []


def test_negative_light_is_told(scene, tmp_path):
    bpy.data.lights["lamp"].energy = -50.0
    picture, _, (told,) = rendered(tmp_path)
    assert "cannot hold negative light" in told and told.endswith(": lamp")
    assert picture.raw.mean() < 0.9 * picture.radiance({}).mean()  # it is lost
    bpy.data.objects["lamp"].hide_render = True
    assert rendered(tmp_path)[2] == []
