# SPDX-License-Identifier: GPL-3.0-or-later
"""Models as Gaussian splats that Blender 5.3 and newer draws itself, in all its engines.

What differs between versions is asked here and nowhere else: ``available``, ``is_native`` and ``_set_type``.
A native model keeps its modifier, sliders and keyframes: the node group computes the radiance at the wanted
light as before, and puts out the points instead of instances. A material reads that radiance, so that HDR
and lights are neither quantised nor decoded as sRGB. Who draws without it (Workbench) has the colours of
``radiance:base``: as captured, at EV 0, limited to what a display shows. (Geometry nodes could write it anew
for the sliders' look, but for its fourth value, the opacity: they have no node that makes four numbers one.)
"""

import math
from typing import Any, cast

import bpy

from ...bridge import native_splats
from ...bridge.errors import DataMismatchError
from ...bridge.splatting import ALPHA_MIN
from ..blender import cloud_of, marked_when_whole, sample_as_no_lamp
from .attributes import BASE, DISPLAY, LOG_SH, RADIANCE, SCALE
from .node_builder import Field, GeometryBuilder, NodeBuilder
from .nodes import CAMERA_SPLATS, MARK, find_modifier
from .point_cloud import model_of, read_attribute, write_attribute
from .radiance_tree import add_modifier

#: The first Blender that draws splats itself.
FIRST = (5, 3, 0)
#: ``PointCloud.type`` of such a cloud, as add-ons for 5.3 set it; there is no such property before.
SPLATS = "GAUSSIAN_SPLAT"
#: What a node group's mark ends with that puts out points.
_NATIVE = " native 1"
_MATERIAL_MARK, _MATERIAL_RECIPE = "physhdr_material", "native 1"


def available() -> bool:
    """Whether this Blender draws Gaussian splats itself."""
    return bpy.app.version >= FIRST


def why_not() -> str:
    """Why this Blender cannot; empty where it can."""
    if available():
        return ""
    return f"Blender {FIRST[0]}.{FIRST[1]} and newer draw Gaussian splats; this is {bpy.app.version_string}"


def is_native(cloud: bpy.types.PointCloud) -> bool:
    """Whether Blender draws this point cloud as splats."""
    return available() and cast(Any, cloud).type == SPLATS


def convert(target: bpy.types.Object) -> None:
    """Let Blender draw an imported model itself: its type, its nodes, colours and sizes that it packs.

    Also of one whose modifier was removed. Raises ``DataMismatchError`` where the model was edited into
    something else.
    """
    prepare(target)
    _set_type(cloud_of(target), SPLATS)


def revert(target: bpy.types.Object) -> None:
    """Let the extension draw it again."""
    cloud = cloud_of(target)
    kinds: Any = cloud.bl_rna.properties["type"]
    _set_type(cloud, kinds.default)
    modifier = find_modifier(target)
    if modifier is not None and modifier.node_group is not None:
        mark = str(modifier.node_group[MARK]).removesuffix(_NATIVE)
        before = _tree_marked(mark)
        if before is not None:
            modifier.node_group = before
        else:  # nothing used it any more, and the file was saved since
            target.modifiers.remove(modifier)
            add_modifier(target, model_of(cloud))
    if native_material().name in cloud.materials:
        cloud.materials.clear()
    _display(target, "SPLATS")


def prepare(target: bpy.types.Object) -> None:
    """All of ``convert`` that any Blender can do: everything but the type. Raises as that does."""
    cloud = cloud_of(target)
    if LOG_SH[0].name not in cloud.attributes:
        raise DataMismatchError(
            f"the point cloud {cloud.name!r} is no PhysHDR model",
            "Choose an imported model, or import it again.",
        )
    scale = read_attribute(cloud, SCALE.name)
    packed = native_splats.packable(scale)
    if packed is not scale:
        write_attribute(cloud, SCALE, packed)
    modifier = find_modifier(target) or add_modifier(target, model_of(cloud))
    assert modifier.node_group is not None
    modifier.node_group = native_tree(modifier.node_group)
    material = native_material()
    if material.name not in cloud.materials:
        cloud.materials.clear()
        cloud.materials.append(material)
    _display(target, "NODES")


def native_tree(tree: bpy.types.NodeTree) -> bpy.types.NodeTree:
    """The node group that does what ``tree``, one of ours, does, and puts out points instead of instances.

    A copy: its inputs are the same, so values, keyframes and drivers stay. It is made once a file.
    """
    mark = str(tree[MARK])
    if mark.endswith(_NATIVE):
        return tree
    found = _tree_marked(mark + _NATIVE)
    if found is not None:
        return found
    copy = tree.copy()
    with marked_when_whole(copy, MARK, mark + _NATIVE):
        copy.name = f"{tree.name}, native"
        _put_out_points(copy)
    return copy


def _put_out_points(tree: bpy.types.NodeTree) -> None:
    """Replace the instances: points that are seen, with the sizes that the instances had."""
    [instances] = [node for node in tree.nodes if node.bl_idname == "GeometryNodeInstanceOnPoints"]
    output = next(node for node in tree.nodes if node.bl_idname == "NodeGroupOutput")
    make = GeometryBuilder(tree)

    def source(name: str) -> Field:
        [link] = instances.inputs[name].links or [None]
        if link is None or link.from_socket is None:
            raise DataMismatchError(
                f"the node group {tree.name!r} was edited", "Import the model again, then convert it."
            )
        return Field(make, link.from_socket)

    # Cards toward a camera are no business of splats: what they are for is left at its default, off.
    for link in list(tree.links):
        if (
            link.from_node is not None
            and link.from_node.bl_idname == "NodeGroupInput"
            and link.from_socket is not None
            and link.from_socket.name == CAMERA_SPLATS
        ):
            tree.links.remove(link)
    geometry, scale = source("Points"), source("Scale")
    with make.frame("Blender's own splats"):
        geometry = make.field("GeometryNodeSeparateGeometry", geometry, source("Selection"), domain="POINT")
        opacity = make.field(
            "FunctionNodeSeparateColor", make.named(BASE, as_type="FLOAT_COLOR"), output="Alpha"
        )
        # Instances are scaled by their reach, so many standard deviations.
        reach = make.math("SQRT", make.math("LOGARITHM", opacity * (1.0 / ALPHA_MIN), math.e) * 2.0)
        geometry = make.store(geometry, SCALE, scale / reach)
    geometry = make.field("GeometryNodeSetMaterial", geometry, None, native_material())
    tree.links.new(geometry.socket, output.inputs[0])
    tree.nodes.remove(instances)


def native_material() -> bpy.types.Material:
    """The file's material of native splats: it glows with the radiance that the node group computes.

    Opacity and the falloff are Blender's own.
    """
    for material in bpy.data.materials:
        if material.get(_MATERIAL_MARK) == _MATERIAL_RECIPE and material.library is None:
            return material
    material = bpy.data.materials.new("PhysHDR Native Splats")
    with marked_when_whole(material, _MATERIAL_MARK, _MATERIAL_RECIPE):
        sample_as_no_lamp(material)
        assert material.node_tree is not None  # every material has one since Blender 5
        material.node_tree.nodes.clear()
        build = NodeBuilder(material.node_tree)
        attribute = build.node("ShaderNodeAttribute", attribute_type="GEOMETRY", attribute_name=RADIANCE.name)
        emission = build.field("ShaderNodeEmission", build.output(attribute, "Color"), 1.0)
        build.node("ShaderNodeOutputMaterial", emission)
        build.arrange()
    return material


def _tree_marked(mark: str) -> bpy.types.NodeTree | None:
    for tree in bpy.data.node_groups:
        if tree.get(MARK) == mark and tree.library is None:
            return tree
    return None


def _display(target: bpy.types.Object, how: str) -> None:
    """Whether our shader draws it in the 3D view, where that is registered."""
    if hasattr(target, DISPLAY):
        setattr(target, DISPLAY, how)


def _set_type(cloud: bpy.types.PointCloud, kind: str) -> None:
    cast(Any, cloud).type = kind
