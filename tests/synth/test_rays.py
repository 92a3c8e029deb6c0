# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays meet what is rendered, and pass through what is not."""

from collections.abc import Callable

import bpy
import pytest
from mathutils import Vector

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
    bpy.ops.wm.read_factory_settings(use_empty=True)
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


def show_as_wire(veil: bpy.types.Object, around: bpy.types.Collection) -> None:
    veil.display_type = "WIRE"


@pytest.mark.parametrize("away", [hide, hide_collection, hide_from_cameras, show_as_wire])
def test_what_is_not_rendered_is_passed_through(veiled, away: Callable) -> None:
    scene, veil, around = veiled
    assert first(scene) == pytest.approx(1.0)
    away(veil, around)
    assert first(scene) == pytest.approx(0.0, abs=1e-6)


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
