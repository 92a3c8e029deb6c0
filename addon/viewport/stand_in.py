# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender itself shows of a model that the 3D view's shader draws: nothing here, its points elsewhere.

While the extension draws the Gaussians Blender's own drawing of the points would cover them: their radius is
0 and only the object's bounds are drawn. A file that is opened without the extension would then show an
empty box. So what is saved has a radius for each point and a material with its colour, and while a file is
open here the radius is 0, and what it was is kept under another name (who gave the points radii of his own
finds them again). Renders never show the points: the modifier puts out instances of its own.
"""

from typing import Any

import bpy
import numpy as np

from ...bridge.spherical_harmonics import C0
from ..blender import cloud_of, marked_when_whole, sample_as_no_lamp
from ..model.attributes import BASE, KEPT_RADIUS, LOG_SH, RADIUS, SCALE
from ..model.node_builder import NodeBuilder
from ..model.nodes import find_modifier
from ..model.point_cloud import read_attribute, write_attribute
from . import bounds

#: Points have at most so many times the median radius: a wall's few large Gaussians would hide all else.
LARGEST = 4.0
#: Metres; a radius of 0 means that the shader draws.
SMALLEST = 1e-6
_MARK = "physhdr_points_material"
_RECIPE = 1


def shown_radius(scale: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """``[N]`` float32: the radius of each point as Blender draws it, metres, from ``scale`` ``[N, 3]``.

    Twice the larger two of its three standard deviations (their geometric mean), where flat Gaussians touch
    as they do in the picture; faint ones are smaller.
    """
    ordered = np.sort(scale, axis=1)
    radius = 2.0 * np.sqrt(ordered[:, 1] * ordered[:, 2] * opacity)
    if radius.size:
        radius = np.minimum(radius, LARGEST * np.median(radius))
    return np.maximum(radius, SMALLEST).astype(np.float32)


def points_material() -> bpy.types.Material:
    """The file's material of points: each glows with its radiance at level 1, the same from everywhere."""
    for material in bpy.data.materials:
        if material.get(_MARK) == _RECIPE and material.library is None:
            return material
    material = bpy.data.materials.new("PhysHDR Points")
    with marked_when_whole(material, _MARK, _RECIPE):
        sample_as_no_lamp(material)
        assert material.node_tree is not None  # every material has one since Blender 5
        _build(material.node_tree)
    return material


def _build(tree: bpy.types.NodeTree) -> None:
    tree.nodes.clear()
    build = NodeBuilder(tree)
    with build.frame("exp(C0 · ln radiance)"):
        attribute = build.node(
            "ShaderNodeAttribute", attribute_type="GEOMETRY", attribute_name=LOG_SH[0].name
        )
        axes = build.node("ShaderNodeSeparateXYZ", build.output(attribute, "Vector"))
        parts = [build.math("EXPONENT", build.output(axes, axis) * C0) for axis in "XYZ"]
        radiance = build.field("ShaderNodeCombineColor", *parts)
    with build.frame("Surface"):
        build.node("ShaderNodeOutputMaterial", build.field("ShaderNodeEmission", radiance, 1.0))
    build.arrange()


def is_shown(cloud: bpy.types.PointCloud) -> bool:
    """Whether Blender draws the points of a point cloud."""
    radius: Any = cloud.attributes.get(RADIUS.name)
    return len(cloud.points) > 0 and (radius is None or radius.data[0].value > 0.0)


def hide(target: bpy.types.Object) -> None:
    """Leave the drawing to the shader. Of a linked object it is changed for as long as the file is open."""
    cloud, modifier = cloud_of(target), find_modifier(target)
    if modifier is not None and modifier.show_viewport:
        modifier.show_viewport = False
    if target.display_type == "TEXTURED":
        target.display_type = "BOUNDS"
    bounds.limit(target)
    if is_shown(cloud):
        # Material Preview and Rendered draw the points themselves, whatever the display type. A new attribute
        # is 0, also of linked data, whose attributes take no values.
        if (kept := cloud.attributes.get(KEPT_RADIUS.name)) is not None:
            cloud.attributes.remove(kept)
        if (radius := cloud.attributes.get(RADIUS.name)) is not None:
            radius.name = KEPT_RADIUS.name
        cloud.attributes.new(RADIUS.name, RADIUS.type, "POINT")
        cloud.update_tag()


def show(target: bpy.types.Object) -> None:
    """Let Blender draw the points, as in a file that is opened without the extension."""
    cloud = cloud_of(target)
    bounds.remove(target)
    if target.display_type == "BOUNDS":
        target.display_type = "TEXTURED"
    if is_shown(cloud) or not cloud.is_editable:  # a linked one's radius is in the file that it is of
        return
    if not restore_radius(cloud):
        opacity = read_attribute(cloud, BASE.name)[:, 3]
        write_attribute(cloud, RADIUS, shown_radius(read_attribute(cloud, SCALE.name), opacity))
    if not cloud.materials:
        cloud.materials.append(points_material())
    cloud.update_tag()


def restore_radius(cloud: bpy.types.PointCloud) -> bool:
    """Give the points back the radii that ``hide`` kept; whether there were any."""
    if KEPT_RADIUS.name not in cloud.attributes:
        return False
    if (radius := cloud.attributes.get(RADIUS.name)) is not None:
        cloud.attributes.remove(radius)
    cloud.attributes[KEPT_RADIUS.name].name = RADIUS.name
    return True
