# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's things as what they are: what its types say may be missing, or do not know, is there."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, cast

import bpy
import mathutils
import numpy as np

#: How near and how far the cameras see that are made here, metres.
CLIP_START, CLIP_END = 0.01, 1000.0


class Drawn(Protocol):
    """A panel, a menu, an operator's dialogue: what has a ``draw``."""

    @property
    def layout(self) -> bpy.types.UILayout | None: ...


def layout_of(drawn: Drawn) -> bpy.types.UILayout:
    """Where a class draws; there is one whenever Blender calls its ``draw``."""
    layout = drawn.layout
    assert layout is not None
    return layout


def cloud_of(target: bpy.types.Object) -> bpy.types.PointCloud:
    """The point cloud of an object that is one (``type`` is ``POINTCLOUD``)."""
    assert isinstance(target.data, bpy.types.PointCloud)
    return target.data


def takes_objects(collection: bpy.types.Collection) -> bool:
    """Whether objects can be linked into it: not if it is another file's, nor if it is an override of one."""
    return collection.is_editable and collection.override_library is None


def collection_beside(item: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Collection:
    """Where what belongs to an object goes: into one of its collections in the scene that takes it, else into
    the scene's own."""
    there = {scene.collection, *scene.collection.children_recursive}
    beside = (each for each in item.users_collection if each in there and takes_objects(each))
    return next(beside, scene.collection)


def to_matrix(array: np.ndarray) -> mathutils.Matrix:
    """Blender's matrix of a ``[4, 4]`` array."""
    return mathutils.Matrix(np.asarray(array, float).tolist())


def world_of(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> mathutils.Matrix:
    """Where an object stands: its ``matrix_world``, or with ``depsgraph`` that of a frame being drawn.

    Blender computes it for what views could show. Of an object whose monitor icon is off, or whose collection
    is off or excluded, it keeps what was last, and after loading a file nothing: then it is taken from the
    object's transform and its parents'. Keyframes, drivers and constraints of such an object are not known.
    """
    original: Any = item.original  # never None, whatever its type says
    if depsgraph is not None and depsgraph.mode == "RENDER":
        return _evaluated(item, depsgraph).matrix_world.copy()
    layer = depsgraph.view_layer if depsgraph is not None else bpy.context.view_layer
    if layer is not None and _is_computed(original, layer):
        return (_evaluated(item, depsgraph) if depsgraph is not None else item).matrix_world.copy()
    if original.parent is None:
        return original.matrix_basis.copy()
    if original.parent_type != "OBJECT":  # of bones and vertices nothing is known without the armature's pose
        return original.matrix_world.copy()
    return world_of(original.parent, depsgraph) @ original.matrix_parent_inverse @ original.matrix_basis


def put_at(item: bpy.types.Object, matrix: mathutils.Matrix) -> None:
    """Let an object stand at ``matrix``, below a parent that views do not show, too."""
    if item.parent is None or item.parent_type != "OBJECT":
        item.matrix_world = matrix
    else:
        item.matrix_basis = (world_of(item.parent) @ item.matrix_parent_inverse).inverted() @ matrix


def _evaluated(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object:
    """What an evaluated modifier names is evaluated already."""
    return item if item.is_evaluated else item.evaluated_get(depsgraph)


def _is_computed(item: bpy.types.Object, layer: bpy.types.ViewLayer) -> bool:
    """Whether Blender computes where an object stands; the eye hides it from sight alone."""
    return not item.hide_viewport and not set(item.users_collection).isdisjoint(_on(layer.layer_collection))


def _on(part: bpy.types.LayerCollection) -> Iterator[bpy.types.Collection]:
    """The collections whose objects views could show."""
    if not part.collection.hide_viewport:
        if not part.exclude:
            yield part.collection
        for child in part.children:
            yield from _on(child)


def curve_of(target: bpy.types.Object, path: str) -> Any:
    """The driver of an object's property, or its keyframes (not the NLA's); None where it has neither."""
    data = target.animation_data
    if data is None:
        return None
    curves = (*data.drivers, *curves_of(data))
    return next((curve for curve in curves if curve.data_path == path), None)


def animated_paths(target: bpy.types.Object) -> set[str]:
    """The data paths of an object's that drivers, keyframes or the NLA's strips set, but for muted ones."""
    data = target.animation_data
    if data is None:
        return set()
    tracks = [track for track in data.nla_tracks if data.use_nla and not track.mute]
    strips = [strip for track in tracks for strip in track.strips if not strip.mute]
    curves = (curve for each in (data, *strips) for curve in curves_of(each))
    return {each.data_path for each in (*data.drivers, *curves) if not each.mute}


def curves_of(animation: bpy.types.AnimData | bpy.types.NlaStrip) -> list[bpy.types.FCurve]:
    """The keyframes' curves of an object or a strip, of its slot of a layered action."""
    action, slot = animation.action, animation.action_slot
    if action is None or slot is None:
        return []
    strips = (strip for layer in action.layers for strip in layer.strips)
    bags = (cast(Any, strip).channelbag(slot) for strip in strips)
    return [curve for bag in bags if bag is not None for curve in bag.fcurves]


def render_size(scene: bpy.types.Scene, percentage: float = 100.0) -> tuple[int, int]:
    """Width and height of a render of the scene, pixels; ``percentage`` of it where that is asked for."""
    render = scene.render
    # In whole numbers, as Blender has it: 0.29 × 700 is a little less than 203.
    percent = render.resolution_percentage
    width, height = render.resolution_x * percent // 100, render.resolution_y * percent // 100
    return max(1, int(width * percentage / 100.0)), max(1, int(height * percentage / 100.0))


def settings_of_cycles(of: bpy.types.Scene | bpy.types.Material | bpy.types.World) -> Any:
    """Cycles' settings of a scene, a material or a world: Cycles registers them, as an extension does."""
    return cast(Any, of).cycles


def sample_as_no_lamp(material: bpy.types.Material) -> None:
    """Let Cycles not sample what glows in the material as lamps: it is many small things.

    Nothing where Cycles is switched off, or where Blender takes it away before it quits.
    """
    if hasattr(material, "cycles") and settings_of_cycles(material).emission_sampling != "NONE":
        settings_of_cycles(material).emission_sampling = "NONE"


@contextmanager
def marked_when_whole(made: bpy.types.ID, key: str, mark: Any) -> Iterator[None]:
    """What is built within becomes ``made``, which then gets the mark that it is found by.

    Where building fails ``made`` is removed: a half of it, marked, would be taken for the whole ever after.
    """
    try:
        yield
    except BaseException:
        bpy.data.batch_remove([made])
        raise
    made[key] = mark


#: Draws an entry: a menu's ``draw``, which Blender's types believe to take the context alone.
DrawEntry = Callable[[bpy.types.Menu, bpy.types.Context], None]


def add_entry(menu: Any, draw: DrawEntry) -> None:
    """Let ``draw`` add an entry to one of Blender's menus, a class of ``bpy.types``."""
    menu.append(draw)


def remove_entry(menu: Any, draw: DrawEntry) -> None:
    """Take away what ``add_entry`` added."""
    menu.remove(draw)


def path_properties(group: bpy.types.PropertyGroup) -> Iterator[str]:
    """Names of the properties that are paths, and may be relative to the .blend."""
    for name, rna in group.bl_rna.properties.items():
        if isinstance(rna, bpy.types.StringProperty) and rna.is_path_supports_blend_relative:
            yield name


#: What happens in Blender (bpy.app.handlers), and what is then done.
Handlers = Iterable[tuple[str, Callable[..., None]]]


def add_handlers(handlers: Handlers) -> None:
    for event, handler in handlers:
        getattr(bpy.app.handlers, event).append(handler)


def remove_handlers(handlers: Handlers) -> None:
    for event, handler in handlers:
        getattr(bpy.app.handlers, event).remove(handler)
