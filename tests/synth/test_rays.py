# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays meet what is rendered, and pass through what is not."""

from collections.abc import Callable

import bpy
import pytest
from mathutils import Vector

from physhdr.synth import in_views
from physhdr.synth.rays import Rays

EYE, AHEAD = Vector((0.0, 0.0, 5.0)), Vector((0.0, 0.0, -1.0))


def plane(name: str, height: float, collection: bpy.types.Collection) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    data.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    item = bpy.data.objects.new(name, data)
    item.location.z = height
    collection.objects.link(item)
    return item


@pytest.fixture
def veiled() -> tuple[bpy.types.Scene, bpy.types.Object, bpy.types.Collection]:
    """A floor at 0, and a veil at 1 in a collection within another one."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    around, within = bpy.data.collections.new("around"), bpy.data.collections.new("within")
    scene.collection.children.link(around)
    around.children.link(within)
    plane("floor", 0.0, scene.collection)
    return scene, plane("veil", 1.0, within), around


def first(scene: bpy.types.Scene) -> float:
    """The height that a ray from above meets."""
    met = Rays(scene, scene.view_layers[0]).first(EYE, AHEAD)
    assert met is not None
    return met[0].z


def hide(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    veil.hide_render = True


def hide_collection(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    around.hide_render = True


def hide_from_cameras(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    veil.visible_camera = False


def fill_with_smoke(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    smoke = bpy.data.materials.new("smoke")
    nodes, links = smoke.node_tree.nodes, smoke.node_tree.links
    nodes.clear()
    volume, output = nodes.new("ShaderNodeVolumePrincipled"), nodes.new("ShaderNodeOutputMaterial")
    links.new(volume.outputs[0], output.inputs["Volume"])
    veil.data.materials.append(smoke)


@pytest.mark.parametrize("away", [hide, hide_collection, hide_from_cameras, fill_with_smoke])
def test_what_is_not_rendered_is_passed_through(veiled, away: Callable) -> None:
    scene, veil, around = veiled
    assert first(scene) == pytest.approx(1.0)
    away(veil, around)
    assert first(scene) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("nearest", "farthest", "height"),
    [(0.0, 10.0, 1.0), (3.9, 10.0, 1.0), (4.1, 10.0, 0.0), (4.1, 4.9, None), (4.1, 1e30, 0.0), (6, 4, None)],
)
def test_only_what_is_between_the_clipping_distances_is_met(veiled, nearest, farthest, height) -> None:
    """Seen from 5 m above the floor: the veil is 4 m away, and what is not rendered 2 m."""
    scene, _, around = veiled
    plane("not rendered", 3.0, around).hide_render = True
    met = Rays(scene, scene.view_layers[0]).first(EYE, AHEAD, nearest, farthest)
    assert (met and met[0].z) == (height if height is None else pytest.approx(height, abs=1e-6))


@pytest.mark.parametrize("display", ["WIRE", "BOUNDS"])
def test_what_views_display_otherwise_is_met(veiled, display: str) -> None:
    scene, veil, _ = veiled
    veil.display_type = display
    assert first(scene) == pytest.approx(1.0)


def disable(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    veil.hide_viewport = True


def close_the_eye(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    veil.hide_set(True)


def disable_collection(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    around.children[0].hide_viewport = True


def close_the_eye_of_the_collection(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    bpy.context.view_layer.layer_collection.children["around"].hide_viewport = True


def disable_in_an_instance(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    veil.hide_viewport = around.hide_viewport = True
    bpy.context.scene.collection.children.unlink(around)
    holder = bpy.data.objects.new("holder", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", around
    bpy.context.scene.collection.objects.link(holder)


HIDDEN = [disable, close_the_eye, disable_collection, close_the_eye_of_the_collection, disable_in_an_instance]


@pytest.mark.parametrize("away", HIDDEN)
def test_what_views_alone_hide_is_met_while_it_is_shown(veiled, away: Callable) -> None:
    scene, veil, around = veiled
    away(veil, around)
    scene.view_layers[0].update()
    assert first(scene) == pytest.approx(0.0, abs=1e-6)
    with in_views.shown(scene, scene.view_layers[0]):
        assert first(scene) == pytest.approx(1.0)
    assert first(scene) == pytest.approx(0.0, abs=1e-6)


def test_what_is_not_rendered_stays_hidden_in_views(veiled) -> None:
    scene, veil, _ = veiled
    veil.hide_render = veil.hide_viewport = True
    with in_views.shown(scene, scene.view_layers[0]):
        assert veil.hide_viewport


def test_an_instance_of_what_is_hidden_itself_is_met(veiled) -> None:
    scene, _, around = veiled
    around.hide_render = True
    shown = bpy.data.collections.new("shown")
    plane("card", 0.0, shown)
    holder = bpy.data.objects.new("holder", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", shown
    holder.location.z = 2.0
    scene.collection.objects.link(holder)
    assert first(scene) == pytest.approx(2.0)
