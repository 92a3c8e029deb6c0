# SPDX-License-Identifier: GPL-3.0-or-later
"""Models that a scene shows without having them among its own objects: in instances of collections (linked
ones, too), on points, vertices and faces, and in a background set.

Blender tells all instances of a scene only by going through all of them, which may be millions. So it is
asked only where something that can make instances uses a model, and again only when the scene has changed.
"""

import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, cast

import bpy
import numpy as np

#: Going through the instances that takes less is done anew at every redraw; else after changes only.
QUICK_SECONDS = 0.002

#: A name in the file, and the file of the library that it is linked from.
Key = tuple[str, str | None]
_USERS = {"OBJECT", "COLLECTION", "NODETREE", "PARTICLE"}


@dataclass(frozen=True)
class Instance:
    """A model's object, who shows it (``None``: a background set), and where: ``[4, 4]`` float64."""

    target: bpy.types.Object
    parent: bpy.types.Object | None
    matrix_world: np.ndarray


@dataclass(frozen=True, eq=False)
class _Found:
    """An ``Instance`` that can be kept: no reference to Blender's data lives longer than a redraw."""

    target: Key
    parent: Key | None
    matrix_world: np.ndarray


class InstanceFinder:
    """Finds the instances of models; remembers them where looking takes long."""

    def __init__(self) -> None:
        self._found: dict[Key, list[_Found]] = {}

    def changed(self) -> None:
        """Something in the file is not as it was."""
        self._found.clear()

    def instances(
        self,
        view_layer: bpy.types.ViewLayer,
        depsgraph: bpy.types.Depsgraph,
        is_model: Callable[[bpy.types.Object], bool],
    ) -> Iterator[Instance]:
        """The instances of objects for which ``is_model``, whether or not they can be seen."""
        layer = cast(bpy.types.Scene, depsgraph.scene).name_full, view_layer.name
        found = self._found.get(layer)
        if found is None:
            start = time.perf_counter()
            found = list(_find(view_layer, depsgraph, is_model))
            if time.perf_counter() - start > QUICK_SECONDS:
                self._found[layer] = found
        objects = functools.cache(_object)  # which looks through all of the file's
        for each in found:
            target = objects(each.target)
            if target is not None:
                yield Instance(target, each.parent and objects(each.parent), each.matrix_world)


def is_visible(
    instance: Instance, view_layer: bpy.types.ViewLayer, space: bpy.types.SpaceView3D | None
) -> bool:
    """Whether an instance is seen in ``space`` (``None``: regardless of the view): as who shows it is."""
    parent = instance.parent
    if parent is None or parent.name not in view_layer.objects:
        # Of a set, whose objects are in no local view.
        return space is None or space.local_view is None
    return parent.visible_get(view_layer=view_layer, **({"viewport": space} if space else {}))


def _find(
    view_layer: bpy.types.ViewLayer,
    depsgraph: bpy.types.Depsgraph,
    is_model: Callable[[bpy.types.Object], bool],
) -> Iterator[_Found]:
    models = [each for each in bpy.data.objects if each.type == "POINTCLOUD" and is_model(each)]
    if not models or not _may_be_instanced(models, cast(bpy.types.Scene, depsgraph.scene)):
        return
    own = set(view_layer.objects)
    for each in depsgraph.object_instances:
        shown: Any = each.instance_object if each.is_instance else each.object
        if shown is None or shown.type != "POINTCLOUD":
            continue
        target = shown.original
        if target not in models or (not each.is_instance and target in own):
            continue
        parent = each.parent.original if each.parent else None
        matrix = np.array(each.matrix_world, np.float64)
        yield _Found(_key(target), _key(parent) if parent else None, matrix)


def _may_be_instanced(models: list[bpy.types.Object], scene: bpy.types.Scene) -> bool:
    """Whether an object that can make instances uses one of the models, by whatever way."""
    if scene.background_set is not None:
        return True
    if any(each.parent is not None and each.parent.instance_type != "NONE" for each in models):
        return True
    seen: set[bpy.types.ID] = set(models)
    frontier: set[bpy.types.ID] = set(models)
    while frontier:
        users: dict[bpy.types.ID, set[bpy.types.ID]]
        users = bpy.data.user_map(subset=list(frontier), value_types=_USERS)
        frontier = set().union(*users.values()) - seen
        seen |= frontier
        if any(isinstance(user, bpy.types.Object) and _makes_instances(user) for user in frontier):
            return True
    return False


def _makes_instances(user: bpy.types.Object) -> bool:
    is_alive = any(each.type in ("NODES", "PARTICLE_SYSTEM") for each in user.modifiers)
    return user.instance_type != "NONE" or is_alive


def _key(target: bpy.types.Object) -> Key:
    return target.name, target.library.filepath if target.library else None


def _object(key: Key) -> bpy.types.Object | None:
    objects: Any = bpy.data.objects  # which takes a pair, too
    return objects.get(key)
