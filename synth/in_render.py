# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects renders show, by Blender's switches on objects, collections and view layers."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import bpy

from .blender import evaluated

#: Types of objects, as Blender names them; None: all.
Types = tuple[str, ...] | None


def rendered(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph | None = None
) -> dict[bpy.types.Object, Counter[bpy.types.Object]]:
    """All that a layer renders → what shows it, and how often: the object itself, and those that instance it.

    ``depsgraph``: in which nodes and particles are asked what they instance; what views show if ``None``.

    What is hidden in renders is among them where nodes or particles instance it, which show it all the same.
    """
    found: dict[bpy.types.Object, Counter[bpy.types.Object]]
    found = {item: Counter([item]) for item in in_layer(layer.layer_collection)}
    holders = [item for item in found if instanced_by(item)]
    # The layer has what views show: of the scene's own objects only those above are rendered, too.
    hidden = set(scene.objects) - set(found)
    excluded: dict[bpy.types.Object, set[bpy.types.Object]] = {}
    each: Any  # an instance's object and what brings it are there while it is looked at
    for each in (depsgraph or evaluated(layer)).object_instances:
        item = each.object.original
        if not each.is_instance or each.parent is None:
            if item not in hidden:
                found.setdefault(item, Counter([item]))
            continue
        holder = each.parent.original
        if holder not in excluded:
            excluded[holder] = _excluded(holder)
        if holder not in hidden and item not in excluded[holder]:
            found.setdefault(item, Counter())[holder] += 1
    # What views hide is not evaluated, and renders show it all the same. Of instances of collections it can
    # be derived from what they bring; of nodes and particles it cannot.
    for holder in holders:
        for item, times in Counter(_brought(holder)).items():
            if not found.setdefault(item, Counter())[holder]:
                found[item][holder] = times
    return found


def _brought(holder: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """What is rendered of the collection that an object is an instance of, and of instances within it."""
    collection = instanced_by(holder)
    if collection is not None:
        for item in in_collection(collection):
            yield item
            yield from _brought(item)


def _excluded(holder: bpy.types.Object) -> set[bpy.types.Object]:
    """What a collection has that its instance ``holder`` shows in views alone."""
    collection = instanced_by(holder)
    return set(collection.all_objects) - set(in_collection(collection)) if collection else set()


def in_layer(part: bpy.types.LayerCollection, types: Types = None) -> Iterator[bpy.types.Object]:
    """What is rendered of a layer's collections by itself: one in several of them comes several times.

    ``types``: of these alone, of many objects in half the time.
    """
    if part.collection.hide_render:
        return
    if not part.exclude:
        yield from _shown(part.collection, types)
    for child in part.children:
        yield from in_layer(child, types)


def in_collection(collection: bpy.types.Collection, types: Types = None) -> Iterator[bpy.types.Object]:
    """What is rendered of a collection where it is instanced; ``types``: of these alone."""
    if collection.hide_render:
        return
    yield from _shown(collection, types)
    for child in collection.children:
        yield from in_collection(child, types)


def instanced_by(item: bpy.types.Object) -> bpy.types.Collection | None:
    """The collection that an object is an instance of."""
    return item.instance_collection if item.instance_type == "COLLECTION" else None


def _shown(collection: bpy.types.Collection, types: Types) -> Iterator[bpy.types.Object]:
    if types is None:
        return (item for item in collection.objects if not item.hide_render)
    return (item for item in collection.objects if item.type in types and not item.hide_render)
