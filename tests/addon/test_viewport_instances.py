# SPDX-License-Identifier: GPL-3.0-or-later
"""Models that other objects show: collections, linked files, points, sets; what the 3D view is to draw."""

import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
import gpu  # noqa: E402

from physhdr.addon import viewport  # noqa: E402
from physhdr.addon.model import model_import, nodes  # noqa: E402
from physhdr.addon.viewport import instances, splats  # noqa: E402


@pytest.fixture
def target(scene, make_model, write):
    gpu.init()
    viewport.register()
    target = model_import.import_model(write(make_model(count=30)))
    target.physhdr_viewport = "SPLATS"
    yield target
    viewport.unregister()


def shown() -> list:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return list(splats.shown_objects(bpy.context.view_layer, depsgraph))


def places() -> list[tuple[float, ...]]:
    return sorted(tuple(float(x) for x in each.matrix_world[:3, 3].round(5)) for each in shown())


def away(target) -> "bpy.types.Collection":
    """The object out of the scene, into a collection of its own."""
    collection = bpy.data.collections.new("Set piece")
    for owner in target.users_collection:
        owner.objects.unlink(target)
    collection.objects.link(target)
    return collection


def show(collection, location=(0.0, 0.0, 0.0), into=None):
    empty = bpy.data.objects.new("Instance", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.location = location
    (into or bpy.context.scene.collection).objects.link(empty)
    return empty


def test_an_instance_of_a_collection(target):
    collection = away(target)
    assert places() == []
    target.location = (0.0, 0.0, 1.0)
    empties = [show(collection, (x, 0.0, 0.0)) for x in (2.0, 3.0)]
    assert places() == [(2.0, 0.0, 1.0), (3.0, 0.0, 1.0)]
    collection.instance_offset = (0.0, 0.0, 1.0)
    empties[0].scale = (2.0, 2.0, 2.0)
    assert places() == [(2.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
    assert sorted(float(np.linalg.norm(each.matrix_world[:3, 0])) for each in shown()) == [1.0, 2.0]
    empties[0].hide_set(True)
    assert places() == [(3.0, 0.0, 0.0)]
    empties[1].hide_viewport = True
    assert places() == []
    empties[1].hide_viewport = False
    target.physhdr_viewport = "NODES"
    assert places() == []


def test_the_look_is_the_instanced_objects_own(target):
    show(away(target))
    nodes.set_input(nodes.find_modifier(target), nodes.EXPOSURE, 1.5)
    nodes.set_input(nodes.find_modifier(target), nodes.LIGHTING_LEVEL, 0.25)
    (only,) = shown()
    assert only.look.exposure_ev == 1.5 and only.look.lighting_levels == (0.25,)


def test_a_collection_in_a_collection_in_a_hidden_one(target):
    outer = bpy.data.collections.new("Outer")
    show(away(target), (0.0, 5.0, 0.0), outer)
    shelf = bpy.data.collections.new("Shelf")
    bpy.context.scene.collection.children.link(shelf)
    show(outer, (1.0, 0.0, 0.0), shelf)
    assert places() == [(1.0, 5.0, 0.0)]
    bpy.context.view_layer.layer_collection.children["Shelf"].hide_viewport = True
    assert places() == []


def test_on_vertices(target):
    mesh = bpy.data.meshes.new("two")
    mesh.from_pydata([(1, 0, 0), (2, 0, 0)], [], [])
    parent = bpy.data.objects.new("two", mesh)
    parent.instance_type = "VERTS"
    bpy.context.scene.collection.objects.link(parent)
    target.parent = parent
    assert (1.0, 0.0, 0.0) in places() and (2.0, 0.0, 0.0) in places()


def test_in_geometry_nodes(target):
    away(target)
    tree = bpy.data.node_groups.new("shows it", "GeometryNodeTree")
    tree.is_modifier = True
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    info, output = tree.nodes.new("GeometryNodeObjectInfo"), tree.nodes.new("NodeGroupOutput")
    info.inputs["Object"].default_value = target
    info.inputs["As Instance"].default_value = True
    tree.links.new(info.outputs["Geometry"], output.inputs[0])
    holder = bpy.data.objects.new("holder", bpy.data.meshes.new("nothing"))
    holder.modifiers.new("shows it", "NODES").node_group = tree
    holder.location.x = 7.0
    bpy.context.scene.collection.objects.link(holder)
    assert places() == [(7.0, 0.0, 0.0)]


def test_a_background_set(target):
    other = bpy.data.scenes.new("Background")
    for owner in target.users_collection:
        owner.objects.unlink(target)
    other.collection.objects.link(target)
    target.location.x = 4.0
    assert places() == []
    bpy.context.scene.background_set = other
    assert places() == [(4.0, 0.0, 0.0)]


def test_linked_and_overridden(target, tmp_path):
    """A collection of another file, instanced, then overridden; and its points are not drawn by Blender."""
    collection = away(target)
    show(collection)
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.link(directory=f"{path}/Collection/", filename="Set piece", instance_collections=False)
    (collection,) = (each for each in bpy.data.collections if each.library)
    for owner in (bpy.context.scene.collection, *bpy.data.collections):
        if collection.name in owner.children:
            owner.children.unlink(collection)
    empty = show(collection, (0.0, 0.0, 3.0))
    assert places() == [(0.0, 0.0, 3.0)]
    (linked,) = (each for each in bpy.data.objects if each.library)
    assert not splats.stand_in.is_shown(linked.data)
    bpy.data.objects.remove(empty)
    collection.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    (override,) = (each for each in bpy.context.view_layer.objects if each.type == "POINTCLOUD")
    assert override.override_library is not None
    override.location.x = 6.0
    assert places() == [(6.0, 0.0, 0.0)]


def test_with_what_ordinary_scenes_have_nobody_looks(target):
    """A thousand objects and a model among them: all instances of the scene are never asked for."""
    mesh = bpy.data.meshes.new("m")
    for index in range(1000):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(f"{index}", mesh))
    child = bpy.data.objects.new("child", None)
    child.parent = target
    bpy.context.scene.collection.objects.link(child)
    bpy.context.view_layer.update()

    class Unasked:
        """A depsgraph whose instances nobody may go through."""

        scene = bpy.context.scene
        object_instances = property(lambda self: pytest.fail("went through all instances"))

    assert not list(instances._find(bpy.context.view_layer, Unasked(), splats._is_drawn))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    seconds = []
    for _ in range(10):
        start = time.perf_counter()
        assert len(list(splats.shown_objects(bpy.context.view_layer, depsgraph))) == 1
        seconds.append(time.perf_counter() - start)
    # 1 ms on a machine that does nothing else; the bound only keeps it from becoming another order.
    assert min(seconds) < 0.01


def test_what_takes_long_is_found_once_and_again_after_a_change(target, monkeypatch):
    monkeypatch.setattr(instances, "QUICK_SECONDS", -1.0)
    empty = show(away(target), (1.0, 0.0, 0.0))
    assert places() == [(1.0, 0.0, 0.0)]
    monkeypatch.setattr(instances, "_find", lambda *_: pytest.fail("looked again"))
    assert places() == [(1.0, 0.0, 0.0)]
    monkeypatch.undo()
    empty.location.x = 2.0
    bpy.context.view_layer.update()
    assert places() == [(2.0, 0.0, 0.0)]
    bpy.data.objects.remove(target)
    assert places() == []
