# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials of a living room: leather, velvet, printed cloth, thin glass, a picture that glows.

Patterns are of some centimetres in the object's own X and Y, as ``props.cushion`` lies before it is turned.
"""

import bpy

from .shading import Colour, Socket, begin, unsampled


def leather(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """Waxed hide: clouded, worn light in places, with soft creases; half shiny."""
    material, graph = begin(name)
    vector = graph.coordinates()
    clouds = graph.noise(vector, 5.0, 3.0, 0.5)
    colour = graph.ramp(clouds, [(0.3, dark), (0.72, light)])
    creases = graph.noise(graph.coordinates(scale=(1.0, 1.6, 1.0)), 14.0, 3.0, 1.5)
    graph.surface(colour, 0.36, specular=0.5, Normal=graph.bumps(creases, 0.012, 0.5))
    return material


def velvet(name: str, deep: Colour, sheen: Colour) -> bpy.types.Material:
    """Dark where looked at straight, light at grazing angles, brushed in patches."""
    material, graph = begin(name)
    facing = graph.add("ShaderNodeLayerWeight", {"Blend": 0.35}).outputs["Facing"]
    brushed = graph.noise(graph.coordinates(), 7.0, 2.0)
    amount = graph.math("MULTIPLY", facing, graph.math("ADD", brushed, 0.4))
    graph.surface(graph.mix(amount, deep, sheen), 0.95, specular=0.05)
    return material


def printed(name: str, kind: str, colours: list[Colour], period: float = 0.12) -> bpy.types.Material:
    """Cloth with a pattern that repeats every ``period`` metres in X and Y, its colours in equal shares.

    ``kind``: ``stripes``, ``chevron``, ``diamonds`` (one within the other, as in a kilim) or ``dots``.
    """
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(scale=(1.0 / period,) * 3)})
    x, y = axes.outputs["X"], axes.outputs["Y"]
    zigzag_x = graph.math("MULTIPLY", graph.math("PINGPONG", x, 0.5), 2.0)
    zigzag_y = graph.math("MULTIPLY", graph.math("PINGPONG", y, 0.5), 2.0)
    if kind == "stripes":
        value = graph.math("FRACT", x, 0.0)
    elif kind == "chevron":
        value = graph.math("FRACT", graph.math("ADD", y, graph.math("MULTIPLY", zigzag_x, 0.5)), 0.0)
    elif kind == "diamonds":
        value = graph.math("MULTIPLY", graph.math("ADD", zigzag_x, zigzag_y), 0.5)
    else:
        flat = graph.coordinates(scale=(1.0 / period, 1.0 / period, 0.0))
        value = graph.voronoi(flat, 1.0, randomness=0.0)
    stops = [(index / len(colours), colour) for index, colour in enumerate(colours)]
    worn = graph.clouds(graph.coordinates(), 22.0, 2.0, 0.8, 1.1)
    colour = graph.mix(1.0, graph.ramp(value, stops, "CONSTANT"), worn, "MULTIPLY")
    graph.surface(colour, 0.95, specular=0.05)
    return material


def parquet(name: str) -> bpy.types.Material:
    """Waxed oak for blocks with the vertex attribute ``plank``: metres along and across, the block's tone."""
    material, graph = begin(name)
    plank = graph.add("ShaderNodeAttribute", attribute_name="plank").outputs["Vector"]
    tone = graph.add("ShaderNodeSeparateXYZ", {"Vector": plank}).outputs["Z"]
    stretched = graph.add("ShaderNodeMapping", {"Vector": plank, "Scale": (4.0, 45.0, 31.0)}).outputs[0]
    grain = graph.noise(stretched, 1.0, 2.0, 0.8)
    base = graph.ramp(
        tone, [(0.0, (0.10, 0.048, 0.022)), (0.5, (0.21, 0.11, 0.052)), (1.0, (0.33, 0.19, 0.095))]
    )
    streaks = graph.ramp(grain, [(0.3, (0.72, 0.68, 0.64)), (0.7, (1.2, 1.18, 1.15))])
    graph.surface(graph.mix(1.0, base, streaks, "MULTIPLY"), 0.3, specular=0.45)
    return material


def thin_glass(name: str, tint: Colour = (0.92, 0.96, 0.95)) -> bpy.types.Material:
    """A thin wall of glass: it reflects as glass does and lets light straight through, without caustics."""
    material, graph = begin(name)
    mirrored = graph.add("ShaderNodeFresnel", {"IOR": 1.5}).outputs[0]
    clear = graph.add("ShaderNodeBsdfTransparent", {"Color": tint}).outputs[0]
    shiny = graph.add("ShaderNodeBsdfGlossy", {"Color": (0.9, 0.9, 0.9), "Roughness": 0.03}).outputs[0]
    # Both walls of the vessel reflect.
    factor = graph.math("MINIMUM", graph.math("MULTIPLY", mirrored, 1.6), 1.0)
    graph.finish(graph.blend(factor, clear, shiny))
    return material


def foliage(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """Leaves, each of its own green; a third of the light comes through, so against the sun they glow."""
    material, graph = begin(name)
    own = graph.add("ShaderNodeObjectInfo").outputs["Random"]
    ribs = graph.wave(graph.coordinates(), 6.0, 1.2, "Y")
    colour = graph.mix(own, graph.ramp(ribs, [(0.2, dark), (0.9, light)]), light)
    top = graph.principled(colour, 0.4, specular=0.35)
    through = graph.add("ShaderNodeBsdfTranslucent", {"Color": colour}).outputs[0]
    graph.finish(graph.blend(0.33, top, through))
    return material


def evening_film(name: str, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """A television's picture: the sun goes down behind sails and a headland, its trail on the water.

    Returns the material and the strength its light is linear in. It is seen by cameras and mirrors only,
    and Cycles need not sample it: an area light shines for it.
    """
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    x, z = axes.outputs["X"], axes.outputs["Z"]
    sky = graph.ramp(
        z,
        [(0.40, (1.0, 0.30, 0.05)), (0.55, (0.75, 0.16, 0.10)), (0.75, (0.20, 0.10, 0.24)),
         (1.0, (0.03, 0.06, 0.20))],
    )  # fmt: skip
    streaks = graph.noise(graph.coordinates((1.5, 1.0, 9.0), space="Generated"), 2.2, 3.0, 0.4)
    sky = graph.mix(graph.ramp(streaks, [(0.5, (0,) * 3), (0.7, (0.8,) * 3)]), sky, (1.0, 0.45, 0.16))
    level = graph.add("ShaderNodeCombineXYZ", {"X": graph.math("MULTIPLY", x, 1.76), "Y": z}).outputs[0]
    away = graph.add(
        "ShaderNodeVectorMath", {"Vector": level, "Vector_001": (1.09, 0.52, 0.0)}, operation="DISTANCE"
    ).outputs["Value"]
    sky = graph.mix(graph.ramp(away, [(0.085, (1,) * 3), (0.10, (0,) * 3)]), sky, (2.6, 1.7, 0.7))
    ripples = graph.noise(graph.coordinates((5.0, 1.0, 42.0), space="Generated"), 2.0, 2.0)
    aside = graph.math("ABSOLUTE", graph.math("SUBTRACT", x, 0.62), 0.0)
    trail = graph.math("SUBTRACT", graph.math("ADD", ripples, 0.14), graph.math("MULTIPLY", aside, 2.0))
    sea = graph.ramp(
        trail, [(0.25, (0.01, 0.03, 0.07)), (0.45, (0.10, 0.06, 0.08)), (0.56, (1.3, 0.62, 0.16))]
    )
    coast = graph.math("ADD", graph.noise(graph.coordinates(space="Generated"), 5.0, 3.0), -0.52)
    headland = graph.math("ADD", 0.62, graph.math("SUBTRACT", graph.math("MULTIPLY", coast, 0.5), x))
    land = graph.math("LESS_THAN", graph.math("SUBTRACT", z, 0.40), graph.math("MULTIPLY", headland, 0.35))
    picture = graph.mix(graph.math("LESS_THAN", z, 0.42), graph.mix(land, sky, (0.006, 0.008, 0.012)), sea)
    node = graph.add("ShaderNodeEmission", {"Color": picture, "Strength": radiance})
    graph.finish(node.outputs[0])
    unsampled(material)
    return material, node.inputs["Strength"]
