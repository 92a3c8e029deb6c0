# SPDX-License-Identifier: GPL-3.0-or-later
"""CG that stands in a capture: a ground plane whose shadow falls on the splats, by two more view layers.

A shadow catcher that stands among splats is opaque to those behind it. Here it stands in a layer of its own,
without splats, where Cycles tells for each pixel and channel the ratio S of the light on the ground with and
without the CG. A second layer draws F, what is in front of the ground: splats above it, and CG. Of the
picture C, where splats and CG are drawn together and hide each other by depth, the rest lies on the ground:

    picture = F + S (C − F)                                                          (``cg_compositor``)

This is exact where the ground scatters light evenly, in scene-linear light, for any coverage in front of it.
Where no shadow falls S is 1, and the picture is C.

Splats of a floor have a thickness, so F is cut off a little above the plane. Collections and layers of ours
bear a mark, and ``reset`` takes all of them away again.
"""

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ...bridge.affine import matrices_of
from ...bridge.blend_file import CG
from ...bridge.errors import DataMismatchError, FileMissingError
from ..blender import takes_objects, world_of
from ..capture.picking import surface_along_ray
from ..model.look import file_has_model, is_model, shown_shape
from ..rendering import cg_compositor

#: Custom property of what is ours, and what it is.
MARK = CG
GROUND, FRONT, CAPTURE = "ground", "front", "capture"
#: Custom property of a scene: the view layer whose picture gets the shadow.
BEAUTY = "physhdr_cg_layer"
SHADOW_LAYER, FRONT_LAYER = "PhysHDR Shadow", "PhysHDR Front"
#: Samples of the layer of what is in front: splats have no noise, only edges need more than one.
FRONT_SAMPLES = 16
#: Of the ground as it lights CG from below, and as it lights itself between CG: of wood and stone.
ALBEDO = 0.3
#: The plane of what is in front reaches so many times further: it is seen above the ground, and shifted.
FRONT_REACH = 4.0
#: Metres a floor is thick, where its splats do not say; the least and the most that they may say.
THICKNESS, THINNEST, THICKEST = 0.03, 0.005, 0.15
#: Of the largest deviations of a floor's splats, weighed by opacity: so many are within its thickness.
WITHIN = 0.9
#: Metres above the cursor from where the floor is looked for: the cursor may be a little below it.
ABOVE = 0.1


def ground_of(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The scene's ground plane, where CG was put into a capture."""
    return next((each for each in scene.objects if each.get(MARK) == GROUND), None)


def top_of(ground: bpy.types.Object) -> bpy.types.Object | None:
    """The plane a little above a ground plane, up to which splats belong to the ground."""
    return next((each for each in ground.children if each.get(MARK) == FRONT), None)


def models_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects that show models: themselves, or as instances of a collection with one in it."""
    return [each for each in scene.objects if shows_model(each)] if file_has_model() else []


def shows_model(target: bpy.types.Object) -> bool:
    collection = target.instance_collection if target.instance_type == "COLLECTION" else None
    return is_model(target) or (
        collection is not None and any(shows_model(each) for each in collection.all_objects)
    )


def is_there(scene: bpy.types.Scene) -> bool:
    """Whether anything of ours is in the scene."""
    layers = any(name in scene.view_layers for name in (SHADOW_LAYER, FRONT_LAYER))
    return layers or ground_of(scene) is not None


def hindrances(scene: bpy.types.Scene) -> list[str]:
    """Why the shadow would not be drawn, or not rightly, each with its remedy; none where all is well."""
    found = []
    if scene.render.engine != "CYCLES":
        found.append("Only Cycles draws the shadow: EEVEE has no shadow catcher")
    ground = ground_of(scene)
    if (ground is None or top_of(ground) is None or _strays(scene)) or not all(
        name in scene.view_layers and scene.view_layers[name].use for name in (SHADOW_LAYER, FRONT_LAYER)
    ):
        found.append("The ground or a view layer of it is missing or off: Put CG Here again")
    elif not cg_compositor.is_connected(scene):
        found.append("The compositor does not use the shadow: Put CG Here again")
    if scene.render.use_single_layer:
        found.append("Only one view layer is rendered (View Layer properties, Render Single Layer)")
    if _is_loose(scene):
        found.append("A model was added since, and hides the ground: Put CG Here again")
    return found


def _is_loose(scene: bpy.types.Scene) -> bool:
    """Whether a model is in a collection that the layer of the shadow shows."""
    return any(
        collection.get(MARK) != CAPTURE
        for model in models_of(scene)
        for collection in _collections_in(scene, model)
    )


# ---- setting up --------------------------------------------------------------------------------------------


def put(
    scene: bpy.types.Scene,
    layer: bpy.types.ViewLayer,
    place: Vector,
    size: float = 4.0,
    thickness: float | None = None,
) -> bpy.types.Object:
    """Lay the ground, ``size`` metres wide, at ``place``, and let its shadow fall on what ``layer`` shows.

    Once more it moves the ground, and takes in models and collections that came since. ``thickness``: metres
    above the plane that belong to the ground; found from the splats there if ``None``.

    Raises what ``models_to_set_apart`` raises, with nothing changed.
    """
    models = models_to_set_apart(scene)
    if layer.name in (SHADOW_LAYER, FRONT_LAYER):
        layer = _beauty(scene)
    if thickness is None:
        thickness = floor_thickness(models, place, size / 2.0)
    for each in models:
        _set_apart(scene, each)
    ground = _lay_ground(scene, place, size, thickness)
    scene[BEAUTY] = layer.name
    _add_layers(scene, layer)
    cg_compositor.connect(scene, layer.name, SHADOW_LAYER, FRONT_LAYER)
    return ground


def models_to_set_apart(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's models, each of which can be moved into a collection that a layer leaves out.

    Raises:
        DataMismatchError: there is no model in the scene.
        FileMissingError: a model's collection is another file's, and nothing in it can be moved.
    """
    models = models_of(scene)
    if not models:
        raise DataMismatchError("there is no model in this scene", "Import a trained model first.")
    for each in models:
        for collection in _collections_in(scene, each):
            if not takes_objects(collection):
                raise FileMissingError(
                    f"{each.name} is in the collection {collection.name} of another file",
                    "Append the model instead of linking it: what is in a linked or overridden collection "
                    "cannot be moved into another.",
                )
    return models


def reset(scene: bpy.types.Scene) -> None:
    """Take ground, layers, collections and compositor nodes of ours away; models stand where they stood.

    What another scene with a ground shows, too, it keeps.
    """
    cg_compositor.disconnect(scene)
    for name in (SHADOW_LAYER, FRONT_LAYER):
        layer = scene.view_layers.get(name)
        if layer is not None and len(scene.view_layers) > 1:
            scene.view_layers.remove(layer)
    for collection in [each for each in scene.collection.children_recursive if MARK in each]:
        _dissolve(scene, collection)
    if BEAUTY in scene:
        del scene[BEAUTY]


def _dissolve(scene: bpy.types.Scene, collection: bpy.types.Collection) -> None:
    """Put what is in a collection of ours where the collection is, and take that away, planes and all.

    A linked copy of a scene shares its collections: one that has its ground still keeps them.
    """
    others = {
        each
        for other in bpy.data.scenes
        if other != scene and is_there(other)
        for each in _collections_of(other)
    }
    planes = [each for each in collection.objects if MARK in each]
    tops = {each.collection for each in bpy.data.scenes}
    for parent in (tops | set(bpy.data.collections)) - others:
        if collection not in parent.children.values() or not takes_objects(parent):
            continue
        for item in collection.objects.values():
            # By itself: a linked one may have the same name.
            if item not in planes and item not in parent.objects.values():
                parent.objects.link(item)
        for child in collection.children.values():
            if child not in parent.children.values():
                parent.children.link(child)
        parent.children.unlink(collection)
    if collection not in others:
        for each in planes:
            _remove(each)
        bpy.data.collections.remove(collection)


def _collections_of(scene: bpy.types.Scene) -> set[bpy.types.Collection]:
    return {scene.collection, *scene.collection.children_recursive}


def _remove(plane: bpy.types.Object) -> None:
    mesh = plane.data
    bpy.data.objects.remove(plane)
    if isinstance(mesh, bpy.types.Mesh) and not mesh.users:
        bpy.data.meshes.remove(mesh)


def _beauty(scene: bpy.types.Scene) -> bpy.types.ViewLayer:
    """The layer whose picture gets the shadow: the former one, else the first that is not ours."""
    known = scene.view_layers.get(str(scene.get(BEAUTY, "")))
    own = [each for each in scene.view_layers if each.name not in (SHADOW_LAYER, FRONT_LAYER)]
    return known or own[0]


def _collections_in(scene: bpy.types.Scene, item: bpy.types.Object) -> list[bpy.types.Collection]:
    """The collections of this scene that an object is in."""
    there = _collections_of(scene)
    return [each for each in item.users_collection if each in there]


def _set_apart(scene: bpy.types.Scene, model: bpy.types.Object) -> None:
    """Put a model into a collection of its own below each that it is in, so that a layer can leave it out."""
    for parent in _collections_in(scene, model):
        if parent.get(MARK) == CAPTURE:
            continue
        own = next((each for each in parent.children if each.get(MARK) == CAPTURE), None)
        if own is None:
            own = bpy.data.collections.new("PhysHDR Capture")
            own[MARK] = CAPTURE
            parent.children.link(own)
        if model not in own.objects.values():  # a linked one may have the same name
            own.objects.link(model)
        parent.objects.unlink(model)


def _lay_ground(scene: bpy.types.Scene, place: Vector, size: float, thickness: float) -> bpy.types.Object:
    """The ground and its top, each made where it is missing: either may have been deleted."""
    ground = ground_of(scene) or _new_ground(scene)
    top, strays = top_of(ground), _strays(scene)
    if top is None:
        top = strays.pop() if strays else _new_top(scene)
        top.parent = ground
        top.matrix_parent_inverse.identity()
        top.rotation_euler = (0.0, 0.0, 0.0)
    for each in strays:
        _remove(each)
    ground.location = place
    ground.scale = (size / 2.0,) * 3
    top.location = (0.0, 0.0, thickness / (size / 2.0))
    top.scale = (FRONT_REACH, FRONT_REACH, 1.0)
    return ground


def _strays(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Tops whose ground was deleted."""
    return [each for each in scene.objects if each.get(MARK) == FRONT and each.parent is None]


def _new_ground(scene: bpy.types.Scene) -> bpy.types.Object:
    ground = _plane("PhysHDR Ground", _collection(scene, GROUND, "PhysHDR Ground"), GROUND)
    ground.is_shadow_catcher = True
    ground.display_type = "WIRE"
    return ground


def _new_top(scene: bpy.types.Scene) -> bpy.types.Object:
    top = _plane("PhysHDR Ground Top", _collection(scene, FRONT, "PhysHDR Ground Top"), FRONT)
    top.is_holdout = True
    top.hide_select = True
    for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(top, f"visible_{ray}", False)
    return top


def _collection(scene: bpy.types.Scene, kind: str, name: str) -> bpy.types.Collection:
    """The scene's collection of ours of that kind, made when it is not there."""
    for each in scene.collection.children:
        if each.get(MARK) == kind:
            return each
    made = bpy.data.collections.new(name)
    made[MARK] = kind
    scene.collection.children.link(made)
    return made


def _plane(name: str, collection: bpy.types.Collection, kind: str) -> bpy.types.Object:
    """A square of 2 × 2, which the object's scale makes as large as it is."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(_material())
    item = bpy.data.objects.new(name, mesh)
    item[MARK] = kind
    collection.objects.link(item)
    return item


def _material() -> bpy.types.Material:
    """Scatters evenly: the ratio of light that it tells is that of the irradiance."""
    name = "PhysHDR Ground"
    for material in bpy.data.materials:
        if material.get(MARK) == GROUND and material.library is None:
            return material
    material = bpy.data.materials.new(name)
    material[MARK] = GROUND
    tree = material.node_tree
    assert tree is not None  # every material has one since Blender 5
    tree.nodes.clear()
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    colour: Any = diffuse.inputs["Color"]
    colour.default_value = (ALBEDO, ALBEDO, ALBEDO, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (200.0, 0.0)
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material


# ---- view layers -------------------------------------------------------------------------------------------


def _add_layers(scene: bpy.types.Scene, beauty: bpy.types.ViewLayer) -> None:
    """Our two layers show what ``beauty`` shows, less the splats and with the ground, or with its top; no
    other layer shows either."""
    shows = {SHADOW_LAYER: {GROUND}, FRONT_LAYER: {FRONT, CAPTURE}}
    for name in shows:
        if name not in scene.view_layers:
            scene.view_layers.new(name)
    for layer in scene.view_layers:
        ours = layer.name in shows
        if ours:
            _imitate(layer.layer_collection, beauty.layer_collection)
        for each in _below(layer.layer_collection):
            kind = each.collection.get(MARK)
            if kind in (GROUND, FRONT):
                each.exclude = kind not in shows.get(layer.name, ())
            elif ours and kind == CAPTURE and kind not in shows[layer.name]:
                each.exclude = True
    shadow, front = scene.view_layers[SHADOW_LAYER], scene.view_layers[FRONT_LAYER]
    shadow.cycles.use_pass_shadow_catcher = True  # type: ignore[attr-defined]  # Cycles registers it
    front.samples = FRONT_SAMPLES
    for layer in (shadow, front):
        layer.use, layer.use_pass_combined = True, True


def _below(top: bpy.types.LayerCollection) -> Iterator[bpy.types.LayerCollection]:
    for each in top.children:
        yield each
        yield from _below(each)


def _imitate(target: bpy.types.LayerCollection, source: bpy.types.LayerCollection) -> None:
    """Give the collections below one of a layer the switches that they have in another layer."""
    there = {each.collection: each for each in source.children}
    for each in target.children:
        if each.collection in there:
            for name in ("exclude", "holdout", "indirect_only", "hide_viewport"):
                wanted = getattr(there[each.collection], name)
                if getattr(each, name) != wanted:
                    setattr(each, name, wanted)
            _imitate(each, there[each.collection])


# ---- the floor ---------------------------------------------------------------------------------------------


def floor_below(scene: bpy.types.Scene, place: Vector) -> float | None:
    """The height at which a ray down from just above ``place`` meets a model; None where it meets none."""
    found = []
    for model in scene.objects:
        if not is_model(model) or not model.visible_get():
            continue
        to_world = np.array(world_of(model), np.float64)
        if not np.linalg.det(to_world):  # flat: it has no surface
            continue
        to_model = np.linalg.inv(to_world)
        start = np.array([place.x, place.y, place.z + ABOVE, 1.0])
        down = to_model[:3, :3] @ np.array([0.0, 0.0, -1.0])
        distance = surface_along_ray((to_model @ start)[:3], down, *shown_shape(model))
        if distance is not None:
            found.append(place.z + ABOVE - distance)
    return max(found, default=None)


def floor_thickness(models: list[bpy.types.Object], place: Vector, radius: float) -> float:
    """Metres: how far the splats of the ground reach above it, for those near ``place``.

    Drawn as cards that face the camera, splats of a floor stick out of it by a part of what they are wide.
    """
    sizes, weights = [], []
    for model in models:
        if not is_model(model):
            continue
        position, rotation, deviations, opacity = shown_shape(model)
        to_world = np.array(world_of(model), np.float64)
        offset = position @ to_world[:3, :3].T + to_world[:3, 3] - np.array(place)
        lying = np.abs(offset[:, 2]) <= THICKEST / 3.0
        chosen = lying & (np.hypot(offset[:, 0], offset[:, 1]) <= radius)
        axes = to_world[:3, :3] @ (matrices_of(rotation[chosen]) * deviations[chosen][:, None, :])
        upward = np.linalg.norm(axes[:, 2], axis=1)
        largest = np.linalg.norm(axes, axis=1).max(axis=1)
        sizes.append(np.maximum(largest * 0.5, upward) + np.maximum(offset[chosen, 2], 0.0))
        weights.append(opacity[chosen] * largest**2)
    size, weight = np.concatenate(sizes or [[]]), np.concatenate(weights or [[]])
    if not size.size or not weight.sum() > 0.0:
        return THICKNESS
    order = np.argsort(size)
    share = np.cumsum(weight[order]) / weight.sum()
    return float(np.clip(size[order][np.searchsorted(share, WITHIN)], THINNEST, THICKEST))
