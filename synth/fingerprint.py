# SPDX-License-Identifier: GPL-3.0-or-later
"""A short name for the state of a user's scene, so that a resumed run does not mix two states in one folder.

Of all that is rendered it takes in what one does between two runs: things moved, added, hidden, bent or
scattered otherwise; modifiers and hair; lights, materials and the world with their nodes; the light paths and
the other settings that are the user's own; the cameras. All is looked at as renders show it, whatever views
show. It is no proof of sameness: what is in texture files, how hair is combed, and single vertices within an
object's bounds, are not looked at.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Sequence
from functools import cache
from itertools import chain
from typing import Any

import bpy
import numpy as np

from .blender import cycles, light_of, mesh_of
from .composited import DRAWN
from .light_choice import Materials
from .own_objects import photographed
from .render_state import look
from .settings import users_own

#: What the name begins with: another one took in other things, and cannot be compared with.
KIND = "d-"
DIGITS = 4  # significant; drivers and constraints need not give the last bits twice
#: Who sees an object, and what light meets it.
_SEEN = (
    "visible_camera",
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
    "visible_shadow",
    "is_shadow_catcher",
    "show_instancer_for_render",
)
#: What of all there is a layer renders.
_OF_LAYER = ("use_sky", "use_solid", "use_strand", "use_volumes")
#: Properties that no picture shows, or that are looked at by themselves: of all data, of all nodes …
_OF_DATA = {each.identifier for each in bpy.types.ID.bl_rna.properties}
_OF_DATA |= {"animation_data", "node_tree", "use_nodes"}
_OF_NODES = {each.identifier for each in bpy.types.Node.bl_rna.properties} | {"image", "node_tree"}
#: … of modifiers, which keep what they found among their properties …
_OF_MODIFIERS = {each.identifier for each in bpy.types.Modifier.bl_rna.properties} - {"type"}
_OF_MODIFIERS |= {"levels", "sculpt_levels", "bake_directory", "bake_target"}
_OF_MODIFIERS |= {"hair_grid_min", "hair_grid_max", "hair_grid_resolution"}
#: … of hair and particles …
_OF_PARTICLES = _OF_DATA | {"display_method", "display_color", "display_size", "display_step"}
_OF_PARTICLES |= {"display_percentage", "child_percent", "color_maximum"}
_OF_PARTICLES |= {"active_texture", "active_texture_index", "active_instanceweight"}
_OF_PARTICLES |= {"active_instanceweight_index"}
_OF_SYSTEMS = {"dt_frac", "has_multiple_caches", "active_particle_target_index"}
#: … of curves, texts and metaballs, which renders may give another resolution …
_WITH_RESOLUTION = {"CURVE", "SURFACE", "FONT", "META"}
_OF_CURVES = _OF_DATA | {"resolution", "update_method", "texspace_location", "texspace_size"}
#: … and of anything.
_OF_ALL = {"rna_type", "name", "select"}


def fingerprint(
    scene: bpy.types.Scene,
    layer: bpy.types.ViewLayer,
    poses: list[np.ndarray],
    lens: Sequence[float],
) -> str:
    """``KIND`` and 16 hexadecimal digits of what is rendered at the current frame, and of the cameras.

    ``poses``: camera to world [4, 4]; ``lens``: their horizontal field of view in radians, and where they
    begin and cease to see, metres.
    """
    state = [
        [[round(value, DIGITS) + 0.0 for value in pose.ravel().tolist()] for pose in poses],
        _rounded(lens),
        *look(scene, layer, lambda depsgraph: _rendered(scene, layer, depsgraph)),
    ]
    return KIND + hashlib.sha256(json.dumps(state).encode()).hexdigest()[:16]


def _rendered(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph
) -> list[Any]:
    """All but the cameras."""
    world, override = layer.world_override or scene.world, layer.material_override
    found, known = photographed(scene, layer, depsgraph), Materials(layer, depsgraph)
    found = {item: by for item, by in found.items() if item.type != DRAWN}
    materials = {item: known.of(item) for item in found}
    lights = {light_of(item) for item in found if item.type == "LIGHT"}
    rows = []
    for item in _sorted(found):
        shown_by = sorted([holder.name_full, count] for holder, count in found[item].items())
        names = sorted(material.name_full for material in materials[item])
        rows.append([*_object(item.evaluated_get(depsgraph), layer), names, shown_by])
    return [
        rows,
        _linked(found),
        [getattr(layer, name) for name in _OF_LAYER],
        _material(override) if override else None,
        [_light(light) for light in _sorted(lights)],
        [_material(material) for material in _sorted(set(chain.from_iterable(materials.values())))],
        [_values(cycles(world)), _values(world.cycles_visibility), _tree(world.node_tree)] if world else None,
        [group.name for group in layer.lightgroups],
        [_value(scene.path_resolve(path)) for path in users_own()],
        bpy.data.colorspace.working_space,
    ]


def _sorted(blocks: Any) -> list[Any]:
    return sorted(blocks, key=lambda block: block.name_full)


def _rounded(values: Any) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") + 0.0 for value in values]


def _linked(items: Iterable[bpy.types.Object]) -> list[Any]:
    """What is in the collections that light linking names: each once, however many objects name it."""
    found = {
        collection
        for item in items
        for collection in (item.light_linking.receiver_collection, item.light_linking.blocker_collection)
        if collection
    }
    return [[collection.name_full, _members(collection)] for collection in _sorted(found)]


def _members(collection: bpy.types.Collection) -> list[Any]:
    """The objects and collections in a collection, with whether the light is linked or kept from them."""
    # How a member is linked does not tell whose it is: the members stand in the same order.
    objects = zip(collection.objects, collection.collection_objects, strict=True)
    children = zip(collection.children, collection.collection_children, strict=True)
    return [
        sorted([item.name_full, how.light_linking.link_state] for item, how in objects),
        sorted([child.name_full, how.light_linking.link_state, _members(child)] for child, how in children),
    ]


def _object(item: Any, layer: bpy.types.ViewLayer) -> list[Any]:
    size = len(mesh_of(item).vertices) if item.type == "MESH" else 0
    # The translation may be a small rest of large numbers: metres with as many digits behind the point.
    places = [*item.matrix_world, *item.bound_box]
    slots = [slot.name for slot in item.material_slots]
    ours, linking = item.original, item.light_linking
    return [
        item.name_full,
        item.type,
        [round(value, DIGITS) + 0.0 for place in places for value in place],
        size,
        slots,
        item.lightgroup,
        [getattr(item, name) for name in _SEEN],
        [ours.holdout_get(view_layer=layer), ours.indirect_only_get(view_layer=layer)],
        [_value(linking.receiver_collection), _value(linking.blocker_collection)],
        _rounded(item.color),
        _values(cycles(item)),
        [_modifier(modifier) for modifier in ours.modifiers if modifier.show_render],
        _curve(ours.data) if item.type in _WITH_RESOLUTION else None,
    ]


def _modifier(modifier: Any) -> list[Any]:
    """Its numbers and menus; what it made is in the object's bounds and vertices."""
    row = _plain(modifier, _OF_MODIFIERS)
    if modifier.type == "PARTICLE_SYSTEM":
        system = modifier.particle_system
        row += [_plain(system, _OF_SYSTEMS), _values(system.settings, _OF_PARTICLES)]
    return row


def _curve(data: Any) -> list[Any]:
    """What a curve, a text or a metaball says of itself; its points are in the object's bounds."""
    # Where renders have a resolution of their own, that of views does not matter.
    unused = {f"resolution_{axis}" for axis in "uv" if getattr(data, f"render_resolution_{axis}", 0)}
    return _plain(data, _OF_CURVES | unused)


def _plain(owner: Any, but: Collection[str]) -> list[Any]:
    """Of the properties those that have no parts, and do not tell of a state (``is_bound``) or of panels."""
    parts = _parts(type(owner))
    return [
        [name, _value(getattr(owner, name))]
        for name, _ in _properties(type(owner))
        if name not in but and name not in parts and not name.startswith(("is_", "open_"))
    ]


@cache
def _parts(kind: Any) -> set[str]:
    """The names of a type's properties that are parts of its data, and not data of their own (``ID``)."""
    return {
        each.identifier
        for each in kind.bl_rna.properties
        if each.type == "COLLECTION" or (each.type == "POINTER" and not _is_data(each.fixed_type))
    }


def _is_data(struct: Any) -> bool:
    return struct is not None and (struct.identifier == "ID" or _is_data(struct.base))


def _light(light: Any) -> list[Any]:
    return [light.name_full, _values(light, _OF_DATA), _tree(light.node_tree)]


def _material(material: bpy.types.Material) -> list[Any]:
    return [material.displacement_method, _values(cycles(material)), _tree(material.node_tree)]


def _image(image: Any) -> list[str]:
    # The folder is another one in the copy of a file.
    space = image.colorspace_settings.name
    return [image.name_full, bpy.path.basename(image.filepath), space, image.alpha_mode]


def _values(owner: Any, but: Collection[str] = ()) -> list[Any]:
    """What the properties of a part of Blender's data are, those of its own parts too."""
    return [
        [name, bpy.path.basename(getattr(owner, name)) if is_path else _value(getattr(owner, name))]
        for name, is_path in _properties(type(owner))
        if name not in but
    ]


@cache
def _properties(kind: Any) -> list[tuple[str, bool]]:
    """The names of a type's properties that may matter, and whether they are paths."""
    return [
        (each.identifier, each.type == "STRING" and each.subtype in ("FILE_PATH", "DIR_PATH"))
        for each in kind.bl_rna.properties
        if each.identifier not in _OF_ALL and not each.identifier.startswith("show_")
    ]


def _value(value: Any) -> Any:
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return _rounded([value])[0]
    if isinstance(value, bpy.types.ID | bpy.types.Node):
        return value.name_full if isinstance(value, bpy.types.ID) else value.name
    if isinstance(value, set):
        return sorted(value)
    if isinstance(value, bpy.types.bpy_prop_collection):
        return [_value(each) for each in value]
    if isinstance(value, bpy.types.bpy_struct):
        return _values(value)
    return _rounded(np.ravel(value).tolist())


def _tree(tree: bpy.types.NodeTree | None) -> list[Any]:
    if tree is None:
        return []
    rows = []
    node: Any  # each kind of node and of socket has attributes of its own
    for node in tree.nodes:
        # Of a colour or a number alone it is the output that has it.
        inputs = [_socket(socket) for socket in node.inputs or node.outputs]
        image = _image(node.image) if getattr(node, "image", None) else []
        inside = _tree(node.node_tree) if node.type == "GROUP" else []
        rows.append([node.name, node.bl_idname, node.mute, inputs, image, inside, _values(node, _OF_NODES)])
    return sorted(rows, key=lambda row: row[0])


def _socket(socket: Any) -> Any:
    if socket.is_linked and not socket.is_output:
        return [f"{link.from_node.name}.{link.from_socket.identifier}" for link in socket.links]
    return _value(getattr(socket, "default_value", None))
