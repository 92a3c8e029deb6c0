# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's data as what they are: of an object Blender's types say only that it has some data or none."""

from typing import Any

import bpy

#: Three numbers, in metres unless stated otherwise: a sequence, or a Vector, which is none to the stubs.
Point = Any


def cycles(owner: Any) -> Any:
    """What Cycles keeps with a scene, a layer, a light or a material: its type is made at runtime."""
    return owner.cycles


def mesh_of(item: bpy.types.Object) -> bpy.types.Mesh:
    """The mesh of an object that is one."""
    assert isinstance(item.data, bpy.types.Mesh)
    return item.data


def camera_of(item: bpy.types.Object) -> bpy.types.Camera:
    """The lens of an object that is a camera."""
    assert isinstance(item.data, bpy.types.Camera)
    return item.data


def light_of(item: bpy.types.Object) -> Any:
    """The data of an object that is a light; every kind of light has a strength and a colour of its own."""
    assert isinstance(item.data, bpy.types.Light)
    return item.data


def evaluated(layer: bpy.types.ViewLayer) -> bpy.types.Depsgraph:
    """The layer's objects as they are rendered."""
    assert layer.depsgraph is not None
    return layer.depsgraph


def instanced(layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """What a layer shows, in instances of collections too: an object as often as it is shown."""
    return [_there(_there(each.object).original) for each in evaluated(layer).object_instances]


def _there(item: bpy.types.Object | None) -> bpy.types.Object:
    assert item is not None
    return item
