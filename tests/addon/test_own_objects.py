# SPDX-License-Identifier: GPL-3.0-or-later
"""What is ours in a scene is no part of its data set: models, light, planes, probes, cameras."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from mathutils import Vector  # noqa: E402

from physhdr.addon.capture import dataset_cameras  # noqa: E402
from physhdr.addon.light import cg, lighting, probes  # noqa: E402
from physhdr.addon.model import model_import  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.synth import own_objects  # noqa: E402
from physhdr.synth.fingerprint import fingerprint  # noqa: E402


@pytest.fixture
def room(scene, look_at):
    """A floor below a grey sky, which a camera sees."""
    floor = bpy.data.meshes.new("floor")
    floor.from_pydata([(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)], [], [(0, 1, 2, 3)])
    scene.collection.objects.link(bpy.data.objects.new("floor", floor))
    scene.world = bpy.data.worlds.new("sky")
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    render.add_camera(scene, look_at(2.0, -3.0, 1.5), 0.7)
    render.set_resolution(scene, 8, 8)
    render.prepare_cycles(scene)
    scene.cycles.max_bounces = 2
    scene.render.film_transparent = False
    return scene


def put_ours(scene, model) -> None:
    lit = lighting._lit_world(scene)
    lit[lighting.MODEL] = model
    lit.node_tree.nodes["Background"].inputs["Color"].default_value = (9.0, 0.0, 0.0, 1.0)
    cg._lay_ground(scene, Vector((0.0, 0.0, 0.0)), 4.0, 0.05)
    marked = (("probe", None, probes.KNOWN), ("test/0", bpy.data.cameras.new("0"), dataset_cameras.SPLIT))
    for name, data, mark in marked:
        item = bpy.data.objects.new(name, data)
        item[mark] = "of ours"
        scene.collection.objects.link(item)


def test_a_scene_that_its_capture_lights_is_photographed_as_it_was(room, make_model, write, tmp_path):
    layer, said = room.view_layers[0], []

    def look(name: str) -> tuple[str, np.ndarray]:
        layer.update()
        render.render_exr(room, tmp_path / name)
        return fingerprint(room, layer, [np.eye(4)], (0.7,)), render.read_exr(tmp_path / name)

    before, picture = look("before.exr")
    put_ours(room, model_import.import_model(write(make_model(count=20, seed=5))))
    ours, lit = look("lit.exr")
    assert ours != before and np.abs(lit - picture).max() > 0.1
    with own_objects.hidden(room, layer, SimpleNamespace(say=said.append)) as names:
        assert room.world.name == "sky"
        during, again = look("again.exr")
    assert during == before
    np.testing.assert_array_equal(again, picture)
    assert names == ["model", "PhysHDR Ground", "PhysHDR Ground Top"]
    assert [line.partition(", ")[2].partition(":")[0] for line in said] == [
        "trained models",
        "planes for the shadow of CG",
        "the light of a capture",
    ]
    assert look("after.exr")[0] == ours
    assert lighting.is_lit(room.world) and not any(item.hide_render for item in room.objects)


def test_a_layers_own_world_that_a_capture_lights_is_given_back_too(room):
    layer = room.view_layers[0]
    sky, lit = room.world, lighting._lit_world(room)
    lit[lighting.MODEL] = room.camera
    room.world, layer.world_override = sky, lit
    with own_objects.hidden(room, layer, SimpleNamespace(say=lambda _: None)):
        assert (room.world, layer.world_override) == (sky, sky)
    assert (room.world, layer.world_override) == (sky, lit)


def test_where_there_was_no_world_there_is_none_again(room):
    room.world = None
    lit = lighting._lit_world(room)
    lit[lighting.MODEL] = room.camera
    with own_objects.hidden(room, room.view_layers[0], SimpleNamespace(say=lambda _: None)):
        assert room.world is None
    assert room.world == lit
