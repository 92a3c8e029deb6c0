# SPDX-License-Identifier: GPL-3.0-or-later
"""What a second Blender shows of a simulation is told wherever it may be another state than the user's."""

from __future__ import annotations

import shutil

import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")

from physhdr.synth.progress import quiet  # noqa: E402
from physhdr.synth.simulations import warnings  # noqa: E402

PACKED = "simulation nodes stand as at their first frame, unless they are baked into the file: riser"
LOOSE = "simulations that are not baked may look otherwise: "


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 4
    return scene


def told(scene):
    scene.view_layers[0].update()
    return warnings(scene, scene.view_layers[0])


def cube(name):
    bpy.ops.mesh.primitive_cube_add(location=(0, 0, 8))
    bpy.context.object.name = name
    return bpy.context.object


def nodes(name):
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    return tree, tree.nodes.new("NodeGroupInput").outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0]


def riser():
    """A cube that rises by a metre a frame, by a simulation zone in a group of nodes."""
    inner, start, end = nodes("rising")
    before, after, up = (
        inner.nodes.new(f"GeometryNode{kind}")
        for kind in ("SimulationInput", "SimulationOutput", "Transform")
    )
    before.pair_with_output(after)
    up.inputs["Translation"].default_value = (0, 0, 1)
    inner.links.new(start, before.inputs["Geometry"])
    inner.links.new(before.outputs["Geometry"], up.inputs[0])
    inner.links.new(up.outputs[0], after.inputs["Geometry"])
    inner.links.new(after.outputs["Geometry"], end)
    outer, start, end = nodes("outer")
    group = outer.nodes.new("GeometryNodeGroup")
    group.node_tree = inner
    outer.links.new(start, group.inputs[0])
    outer.links.new(group.outputs[0], end)
    item = cube("riser")
    item.modifiers.new("nodes", "NODES").node_group = outer
    return item


def save(folder, name="file"):
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{name}.blend"))


def bake_nodes(item):
    modifier = item.modifiers["nodes"]
    baked = bpy.ops.object.geometry_node_bake_single(
        session_uid=item.session_uid, modifier_name=modifier.name, bake_id=modifier.bakes[0].bake_id
    )
    assert baked == {"FINISHED"}


def bake(cache):
    with bpy.context.temp_override(point_cache=cache):
        bpy.ops.ptcache.bake(bake=True)
    assert cache.is_baked


def test_simulation_nodes_in_groups_are_told(scene):
    """Blender does not say whether they are baked into the file, so the sentence holds in either case."""
    item = riser()
    assert told(scene) == [PACKED]
    item.hide_render = True
    assert told(scene) == []


def test_simulation_nodes_on_disk_are_told_unless_they_are_baked_there(scene, tmp_path):
    item = riser()
    item.modifiers["nodes"].bake_target = "DISK"
    assert told(scene) == [f"{LOOSE}riser"]
    save(tmp_path)
    bake_nodes(item)
    assert told(scene) == []
    shutil.rmtree(tmp_path / "blendcache_file")
    assert told(scene) == [f"{LOOSE}riser"]


def test_a_folder_that_the_system_refuses_holds_no_simulation(scene, tmp_path):
    """A name that is too long is refused to everybody, as another user's home is to most."""
    item = riser()
    modifier = item.modifiers["nodes"]
    modifier.bake_target, modifier.bake_directory = "DISK", str(tmp_path / ("b" * 300))
    assert told(scene) == [f"{LOOSE}riser"]


def test_rigid_bodies_are_told_once_they_have_moved(scene):
    cube("faller")
    bpy.ops.rigidbody.object_add()
    cube("ground")
    bpy.ops.rigidbody.object_add(type="PASSIVE")
    assert told(scene) == []  # at their first frame they stand where they are
    scene.frame_set(3)
    assert told(scene) == [f"{LOOSE}faller"]
    bake(scene.rigidbody_world.point_cache)
    assert told(scene) == []


def test_a_cache_on_disk_that_did_not_come_along_is_told(scene, tmp_path):
    """The file is copied without the folder that its cloth was baked into."""
    cache = cube("flag").modifiers.new("cloth", "CLOTH").point_cache
    cache.frame_end = 4
    save(tmp_path)
    assert told(scene) == [f"{LOOSE}flag"]
    cache.use_disk_cache = True
    bake(cache)
    assert any((tmp_path / "blendcache_file").iterdir()) and told(scene) == []
    (tmp_path / "elsewhere").mkdir()
    save(tmp_path / "elsewhere", "copy")
    assert not (tmp_path / "elsewhere/blendcache_copy").exists()
    (only,) = told(scene)
    assert "the simulation cache of flag was not found" in only
    assert f"there is no folder '{tmp_path / 'elsewhere/blendcache_copy'}'" in only
