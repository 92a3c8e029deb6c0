# SPDX-License-Identifier: GPL-3.0-or-later
"""What geometry nodes make of the active camera stands still, wherever a data set's camera is."""

from __future__ import annotations

from contextlib import contextmanager

import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")

from physhdr.synth import active_camera  # noqa: E402
from physhdr.synth.progress import Report  # noqa: E402


def add(name, data, location=(0, 0, 0)):
    item = bpy.data.objects.new(name, data)
    item.location = location
    bpy.context.scene.collection.objects.link(item)
    return item


def follower():
    """A cube where the active camera is, by way of a reroute in a group of nodes."""
    inner = bpy.data.node_groups.new("inner", "GeometryNodeTree")
    outer = bpy.data.node_groups.new("outer", "GeometryNodeTree")
    for tree in (inner, outer):
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    asks, info, cube, moved = (
        inner.nodes.new(f"GeometryNode{kind}")
        for kind in ("InputActiveCamera", "ObjectInfo", "MeshCube", "Transform")
    )
    reroute, end = inner.nodes.new("NodeReroute"), inner.nodes.new("NodeGroupOutput")
    inner.links.new(asks.outputs[0], reroute.inputs[0])
    inner.links.new(reroute.outputs[0], info.inputs["Object"])
    inner.links.new(info.outputs["Location"], moved.inputs["Translation"])
    inner.links.new(cube.outputs[0], moved.inputs[0])
    inner.links.new(moved.outputs[0], end.inputs[0])
    group = outer.nodes.new("GeometryNodeGroup")
    group.node_tree = inner
    outer.links.new(group.outputs[0], outer.nodes.new("NodeGroupOutput").inputs[0])
    item = add("follower", bpy.data.meshes.new("follower"))
    item.modifiers.new("nodes", "NODES").node_group = outer
    return item


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.camera = add("mine", bpy.data.cameras.new("mine"), (3, 0, 0))
    add("other", bpy.data.cameras.new("other"), (-5, 0, 0))
    return scene


def place(item):
    """Where along x the middle of the evaluated cube is, seen by the camera of the scene."""
    seen = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
    return sum(vertex.co.x for vertex in seen) / len(seen)


def state(tree):
    return sorted(tree.nodes.keys()), sorted((link.from_node.name, link.to_node.name) for link in tree.links)


@contextmanager
def kept(scene, report):
    layer = scene.view_layers[0]
    layer.update()
    with active_camera.replaced(scene, layer, bpy.data.objects["mine"], report):
        yield


def test_the_users_camera_is_the_active_one_until_the_way_out(scene):
    item, report = follower(), Report()
    before = state(bpy.data.node_groups["inner"])
    with kept(scene, report):
        scene.camera = bpy.data.objects["other"]
        assert place(item) == pytest.approx(3.0)
    assert place(item) == pytest.approx(-5.0)
    assert state(bpy.data.node_groups["inner"]) == before and report.warnings == []


def test_nodes_of_a_library_that_follow_the_camera_are_told(scene, tmp_path):
    follower()
    file = str(tmp_path / "nodes.blend")
    bpy.data.libraries.write(file, {bpy.data.node_groups["outer"]})
    bpy.data.node_groups.remove(bpy.data.node_groups["outer"])
    bpy.data.node_groups.remove(bpy.data.node_groups["inner"])
    with bpy.data.libraries.load(file, link=True) as (_, into):
        into.node_groups = ["outer"]
    bpy.data.objects["follower"].modifiers["nodes"].node_group = bpy.data.node_groups["outer"]
    report = Report()
    with kept(scene, report):
        pass
    (told,) = report.warnings
    assert "follow the active camera" in told and told.endswith(": follower")
