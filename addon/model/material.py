# SPDX-License-Identifier: GPL-3.0-or-later
"""How one Gaussian is shaded: two materials built by code, for Cycles and EEVEE.

Every Gaussian is an instance of a proxy mesh, scaled so that the Gaussian's alpha is 1/255 at distance
1 from the centre in the instance's space; with d that distance, alpha = o · exp(−½ reach² d²) with
reach² = 2 ln(255 o), which is o · (255 o)^(−d²). Radiance and opacity come from the instance.
"""

from typing import Any, Literal

import bpy

from ...bridge.splatting import ALPHA_MAX, ALPHA_MIN
from ..blender import marked_when_whole, sample_as_no_lamp
from .attributes import RADIANCE
from .node_builder import Field, NodeBuilder

Shape = Literal["ellipsoid", "splat"]


#: Custom property that marks our materials, with the version of this file's recipe.
_MARK = "physhdr_material"
_RECIPE = 2
#: How EEVEE draws them. BLENDED sorts instances by the depth of their centres along the view's axis, as the
#: trainer's rasteriser does, and blends each once: no grain. But each is a draw call of its own, and what is
#: seen through others is its only depth. DITHERED draws all in one call, each in a share of the samples.
_EEVEE: dict[Shape, Literal["DITHERED", "BLENDED"]] = {"ellipsoid": "DITHERED", "splat": "BLENDED"}
_NAMES: dict[Shape, str] = {"ellipsoid": "PhysHDR Ellipsoid", "splat": "PhysHDR Splat"}


def splat_material(shape: Shape) -> bpy.types.Material:
    """The file's material for that shape, made when it is not there yet.

    ``ellipsoid``: d is the distance at which the view ray passes the centre: right from everywhere.
    ``splat``: d is measured in the plane of a card that geometry nodes turn to the active camera.
    """
    mark = f"{shape} {_RECIPE}"
    for material in bpy.data.materials:
        if material.get(_MARK) == mark and material.library is None:
            return material
    material = bpy.data.materials.new(_NAMES[shape])
    with marked_when_whole(material, _MARK, mark):
        material.surface_render_method = _EEVEE[shape]
        material.use_transparency_overlap = True  # else EEVEE blends the nearest alone
        # Gaussians carry their light with them. Sampling each as a lamp would only cost time.
        sample_as_no_lamp(material)
        assert material.node_tree is not None  # every material has one since Blender 5
        _build(material.node_tree, shape)
    return material


def materials_in(tree: bpy.types.NodeTree | None, shape: Shape) -> list[bpy.types.Material]:
    """The materials of that shape which a model's node tree uses, of any version of this recipe."""
    setters: list[Any] = [node for node in tree.nodes if node.type == "SET_MATERIAL"] if tree else []
    found = (node.inputs["Material"].default_value for node in setters)
    return [each for each in found if each is not None and str(each.get(_MARK, "")).startswith(f"{shape} ")]


def _build(tree: bpy.types.NodeTree, shape: Shape) -> None:
    tree.nodes.clear()
    build = NodeBuilder(tree)
    with build.frame("Distance from the centre, squared; 1 where alpha is 1/255"):
        squared = _ray_distance_squared(build) if shape == "ellipsoid" else _card_distance_squared(build)
    with build.frame("Alpha = opacity · (255 opacity)^(−d²)"):
        attribute = build.node(
            "ShaderNodeAttribute", attribute_type="INSTANCER", attribute_name=RADIANCE.name
        )
        radiance, opacity = build.output(attribute, "Color"), build.output(attribute, "Alpha")
        falloff = build.math("POWER", opacity * (1.0 / ALPHA_MIN), 0.0 - squared)
        alpha = build.math("MINIMUM", opacity * falloff, ALPHA_MAX)
        alpha = alpha * build.math("LESS_THAN", squared, 1.0, label="alpha > 1/255")
        if shape == "ellipsoid":
            # A ray meets the proxy twice and must see the Gaussian once.
            backfacing = build.field("ShaderNodeNewGeometry", output="Backfacing")
            alpha = alpha * (1.0 - backfacing)
    with build.frame("Surface"):
        transparent = build.field("ShaderNodeBsdfTransparent", (1.0, 1.0, 1.0, 1.0))
        emission = build.field("ShaderNodeEmission", radiance, 1.0)
        surface = build.field("ShaderNodeMixShader", alpha, transparent, emission)
        build.node("ShaderNodeOutputMaterial", surface)
    build.arrange()


def _ray_distance_squared(build: NodeBuilder) -> Field:
    """|p × r|² of a point p on the view ray and its unit direction r, in the instance's space."""
    geometry = build.node("ShaderNodeNewGeometry")

    def to_instance(vector: Field, kind: str) -> Field:
        return build.field(
            "ShaderNodeVectorTransform", vector, vector_type=kind, convert_from="WORLD", convert_to="OBJECT"
        )

    point = to_instance(build.output(geometry, "Position"), "POINT")
    ray = build.vector("NORMALIZE", to_instance(build.output(geometry, "Incoming"), "VECTOR"))
    offset = build.vector("CROSS_PRODUCT", point, ray)
    return build.dot(offset, offset)


def _card_distance_squared(build: NodeBuilder) -> Field:
    """|p|² of the hit point p in the card's own coordinates."""
    coordinates = build.field("ShaderNodeTexCoord", output="Object")
    # The card is flat: z is rounding noise of the transform.
    in_plane = coordinates * (1.0, 1.0, 0.0)
    return build.dot(in_plane, in_plane)
