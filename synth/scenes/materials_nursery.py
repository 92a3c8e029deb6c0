# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of a child's room: painted blocks, a striped ball, a moon, a ringed rug, a patchwork."""

import math
from collections.abc import Sequence

import bpy

from .plush import shaded, soft
from .shading import Colour, Graph, Socket, begin, unsampled


def _from_middle(graph: Graph) -> list[Socket]:
    """|x|, |y|, |z| of an object's bounds: 0 in the middle, 1 at the faces."""
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    return [
        graph.math("ABSOLUTE", graph.math("MULTIPLY", graph.math("SUBTRACT", axis, 0.5), 2.0), 0.0)
        for axis in axes.outputs
    ]


def block(name: str, paint: Colour, sign: str) -> bpy.types.Material:
    """A wooden block, each face with a painted frame and a ``sign``: disc, ring, cross or square."""
    material, graph = begin(name)
    x, y, z = _from_middle(graph)
    low, high = graph.math("MINIMUM", x, y), graph.math("MAXIMUM", x, y)
    # On a face one of the three is 1: the middle one is the larger of the other two.
    larger = graph.math("MAXIMUM", low, graph.math("MINIMUM", high, z))
    smaller = graph.math("MINIMUM", low, z)
    radius = graph.math(
        "SQRT", graph.math("ADD", graph.math("POWER", larger, 2.0), graph.math("POWER", smaller, 2.0)), 0.0
    )
    if sign == "disc":
        inside = graph.math("LESS_THAN", radius, 0.46)
    elif sign == "ring":
        inside = graph.math(
            "LESS_THAN", graph.math("ABSOLUTE", graph.math("SUBTRACT", radius, 0.4), 0.0), 0.12
        )
    elif sign == "cross":
        bar = graph.math("LESS_THAN", smaller, 0.15)
        inside = graph.math("MULTIPLY", bar, graph.math("LESS_THAN", larger, 0.52))
    else:
        inside = graph.math("LESS_THAN", larger, 0.38)
    frame = graph.math(
        "MULTIPLY", graph.math("GREATER_THAN", larger, 0.62), graph.math("LESS_THAN", larger, 0.93)
    )
    grain = graph.noise(graph.coordinates(scale=(4.0, 40.0, 40.0)), 1.0, 2.0)
    wood = graph.ramp(grain, [(0.3, (0.36, 0.22, 0.11)), (0.7, (0.58, 0.40, 0.22))])
    graph.surface(graph.mix(graph.math("MAXIMUM", inside, frame), wood, paint), 0.4, specular=0.4)
    return material


def gores(name: str, colours: Sequence[Colour]) -> bpy.types.Material:
    """A ball of gores, like a beach ball's, with a white cap (object axes, about Z)."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    x = graph.math("SUBTRACT", axes.outputs["X"], 0.5)
    y = graph.math("SUBTRACT", axes.outputs["Y"], 0.5)
    turn = graph.math("DIVIDE", graph.math("ARCTAN2", y, x), 2.0 * math.pi)
    part = graph.math("ADD", turn, 0.5)
    stripes = graph.ramp(part, [(k / len(colours), c) for k, c in enumerate(colours)], "CONSTANT")
    cap = graph.math("GREATER_THAN", axes.outputs["Z"], 0.965)
    graph.surface(graph.mix(cap, stripes, (0.7, 0.68, 0.62)), 0.18, specular=0.4)
    return material


def moon(name: str, colour: Colour, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """A lamp like the moon: seas and craters. Returns it and the input of its radiance.

    Light is not sampled on it (a point light within gives it): half of all samples would go there.
    """
    material, graph = begin(name)
    vector = graph.coordinates()
    seas = graph.ramp(graph.noise(vector, 9.0, 3.0, 0.4), [(0.38, (0.45,) * 3), (0.60, (1.15,) * 3)])
    craters = graph.ramp(graph.voronoi(vector, 26.0), [(0.12, (0.75,) * 3), (0.30, (1.15,) * 3)])
    tone = graph.mix(1.0, graph.mix(1.0, seas, craters, "MULTIPLY"), colour, "MULTIPLY")
    node = graph.add("ShaderNodeEmission", {"Color": tone, "Strength": radiance})
    unsampled(material)
    graph.finish(node.outputs[0])
    return material, node.inputs["Strength"]


def ringed(name: str, rings: Sequence[tuple[float, Colour]]) -> bpy.types.Material:
    """Tufts in rings about the object's Z: (radius in metres from which on, colour), for a round rug."""
    material, graph = begin(name)
    flat = graph.add(
        "ShaderNodeVectorMath",
        {"Vector": graph.coordinates(), "Vector_001": (1.0, 1.0, 0.0)},
        operation="MULTIPLY",
    )
    radius = graph.add("ShaderNodeVectorMath", {"Vector": flat.outputs[0]}, operation="LENGTH").outputs[
        "Value"
    ]
    colour = graph.ramp(radius, list(rings), "CONSTANT")
    own = graph.add("ShaderNodeNewGeometry").outputs["Random Per Island"]
    tone = graph.ramp(own, [(0.0, (0.78,) * 3), (1.0, (1.06,) * 3)])
    tinted = graph.mix(1.0, colour, tone, "MULTIPLY")
    graph.finish(
        graph.add("ShaderNodeBsdfDiffuse", {"Color": shaded(graph, tinted), "Normal": soft(graph)}).outputs[0]
    )
    return material


def dotted(name: str, ground: Colour, dot: Colour, scale: float) -> bpy.types.Material:
    """Cotton printed with dots."""
    material, graph = begin(name)
    cells = graph.voronoi(graph.coordinates(), scale, randomness=0.15)
    colour = graph.ramp(cells, [(0.26, dot), (0.32, ground)])
    graph.finish(graph.add("ShaderNodeBsdfDiffuse", {"Color": colour}).outputs[0])
    return material
