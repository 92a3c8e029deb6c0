# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulations that a picture may show in another state than the user's own window does.

A second Blender that opens a file has only what was baked: all else stands as at its first frame.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

from .in_render import rendered

_WITH_CACHE = {"CLOTH", "SOFT_BODY", "FLUID", "DYNAMIC_PAINT", "PARTICLE_SYSTEM"}


def warnings(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[str]:
    """Warnings about the simulations of all that is rendered: one sentence per cause, with the names."""
    found = list(rendered(scene, layer))
    loose = [item.name for item in found if _is_loose(item)] + _rigid_bodies(scene, found)
    sentences = []
    if loose:
        sentences.append(f"simulations that are not baked may look otherwise: {_names(loose)}")
    if packed := [item.name for item in found if any(_is_packed(*each) for each in _zones(item))]:
        sentences.append(
            "simulation nodes stand as at their first frame, unless they are baked into the file: "
            f"{_names(packed)}"
        )
    lost: dict[Path, list[str]] = {}
    for item in found:
        for cache in _caches(item):
            _note_lost(cache, item, item.name, lost)
    world = scene.rigidbody_world
    if world is not None and world.enabled:
        _note_lost(world.point_cache, scene, "the rigid bodies", lost)
    sentences += [
        f"the simulation cache of {_names(names)} was not found (there is no folder '{folder}'), and what is "
        "simulated may look otherwise: put it there, or switch off Disk Cache and bake into the file"
        for folder, names in lost.items()
    ]
    return sentences


def _names(names: list[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _is_loose(item: bpy.types.Object) -> bool:
    if any(not cache.is_baked for cache in _caches(item)):
        return True
    return any(not _is_packed(*each) and not _is_on_disk(*each) for each in _zones(item))


def _caches(item: bpy.types.Object) -> Iterator[Any]:
    """The point caches of an object's modifiers; hair has none that moves it."""
    modifier: Any  # each kind has settings of its own
    for modifier in item.modifiers:
        if modifier.type in _WITH_CACHE and modifier.show_render:
            holder = modifier.particle_system if modifier.type == "PARTICLE_SYSTEM" else modifier
            cache = getattr(holder, "point_cache", None)
            hair = modifier.type == "PARTICLE_SYSTEM" and holder.settings.type == "HAIR"
            if cache is not None and not hair:
                yield cache


def _zones(item: bpy.types.Object) -> Iterator[tuple[Any, Any]]:
    """The simulation zones of an object's geometry nodes, those in groups too: modifier, what it bakes."""
    modifier: Any
    for modifier in item.modifiers:
        if modifier.type == "NODES" and modifier.show_render and modifier.node_group is not None:
            for bake in modifier.bakes:
                if isinstance(bake.node, bpy.types.GeometryNodeSimulationOutput):
                    yield modifier, bake


def _is_packed(modifier: Any, bake: Any) -> bool:
    """Whether a zone would be baked into the file; of these Blender does not tell whether they are."""
    return "PACKED" in (bake.bake_target, bake.bake_target == "INHERIT" and modifier.bake_target)


def _is_on_disk(modifier: Any, bake: Any) -> bool:
    folder = bake.directory if bake.use_custom_path else modifier.bake_directory
    if not folder:
        return False
    path = Path(bpy.path.abspath(folder, library=modifier.id_data.library))
    return _is_folder((path if bake.use_custom_path else path / str(bake.bake_id)) / "meta")


def _is_folder(path: Path) -> bool:
    """False, too, where the system refuses to look, as in another user's home: ``Path.is_dir`` raises."""
    return os.path.isdir(path)


def _rigid_bodies(scene: bpy.types.Scene, found: list[bpy.types.Object]) -> list[str]:
    """The rendered objects that a rigid body world moves, where that is not baked and has begun."""
    world = scene.rigidbody_world
    if world is None or not world.enabled or world.collection is None:
        return []
    cache = world.point_cache
    if cache.is_baked or scene.frame_current <= cache.frame_start:
        return []
    held = set(world.collection.objects)
    return [item.name for item in found if item in held and _is_moved(item.rigid_body)]


def _is_moved(body: bpy.types.RigidBodyObject | None) -> bool:
    return body is not None and body.type == "ACTIVE" and body.enabled and not body.kinematic


def _note_lost(cache: Any, owner: bpy.types.ID, name: str, lost: dict[Path, list[str]]) -> None:
    """Note a baked cache on disk whose folder is not where Blender looks for it."""
    if not cache.is_baked or not (cache.use_disk_cache or cache.use_external):
        return
    library = owner.library if cache.use_library_path else None
    file = bpy.path.abspath(library.filepath) if library else bpy.data.filepath
    if not file:
        return
    beside = Path(file).with_name(f"blendcache_{Path(file).stem}")
    external = Path(bpy.path.abspath(cache.filepath, library=library))
    folder = external if cache.use_external else beside
    if not _is_folder(folder):
        lost.setdefault(folder, []).append(name)
