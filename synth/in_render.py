# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects renders show, by Blender's switches on objects, collections and view layers."""

from collections.abc import Iterator

import bpy


def in_layer(part: bpy.types.LayerCollection) -> Iterator[bpy.types.Object]:
    """What is rendered of a layer's collections by itself: one in several of them comes several times."""
    if part.collection.hide_render:
        return
    if not part.exclude:
        yield from _seen(part.collection)
    for child in part.children:
        yield from in_layer(child)


def in_collection(collection: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    """What is rendered of a collection where it is instanced."""
    if collection.hide_render:
        return
    yield from _seen(collection)
    for child in collection.children:
        yield from in_collection(child)


def instanced_by(item: bpy.types.Object) -> bpy.types.Collection | None:
    """The collection that an object is an instance of."""
    return item.instance_collection if item.instance_type == "COLLECTION" else None


def _seen(collection: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    return (item for item in collection.objects if not item.hide_render)
