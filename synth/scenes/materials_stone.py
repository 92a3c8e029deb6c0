# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials of old buildings: rock, masonry, inlaid floors, patina, hanging cloth, water."""

import bpy

from .shading import Colour, begin, dimmed


def rock(
    name: str, dark: Colour, light: Colour, scale: float = 2.4, relief: float = 0.02, roughness: float = 0.85
) -> bpy.types.Material:
    """Carved stone: clouded, pitted, with the rain's dark runs."""
    material, graph = begin(name)
    place = graph.coordinates()
    clouds = graph.ramp(graph.noise(place, scale, 4.0, 0.5), [(0.3, dark), (0.7, light)])
    runs = graph.noise(graph.coordinates(scale=(5.0, 5.0, 0.5)), scale, 2.0)
    stain = graph.ramp(runs, [(0.32, (0.62, 0.60, 0.58)), (0.55, (1.0, 1.0, 1.0))])
    pits = graph.noise(place, scale * 7.0, 3.0)
    colour = graph.mix(1.0, clouds, stain, "MULTIPLY")
    graph.surface(colour, roughness, specular=0.25, Normal=graph.bumps(pits, relief))
    return material


def masonry(
    name: str,
    tones: tuple[Colour, Colour],
    mortar: Colour,
    block: tuple[float, float],
    joint: float,
    plane: str = "XZ",
    relief: float = 0.02,
) -> bpy.types.Material:
    """Courses of blocks, width × height in metres, on a wall in the object's ``plane`` (across, up)."""
    material, graph = begin(name)
    place = graph.coordinates()
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": place})
    flat = graph.add(
        "ShaderNodeCombineXYZ", {"X": axes.outputs[plane[0]], "Y": axes.outputs[plane[1]]}
    ).outputs[0]
    brick = graph.bricks(flat, tones, mortar, block, joint, smooth=0.3)
    clouds = graph.ramp(
        graph.noise(place, 2.2 / block[0] ** 0.5, 4.0, 0.6), [(0.3, (0.68, 0.66, 0.64)), (0.7, (1.1,) * 3)]
    )
    rough = graph.math(
        "SUBTRACT", graph.noise(place, 9.0, 3.0), graph.math("MULTIPLY", brick.outputs[1], 1.4)
    )
    colour = graph.mix(1.0, brick.outputs[0], clouds, "MULTIPLY")
    graph.surface(colour, 0.88, specular=0.2, Normal=graph.bumps(rough, relief))
    return material


def inlay(name: str, pale: Colour, dark: Colour, red: Colour, tile: float = 0.6) -> bpy.types.Material:
    """A polished court floor (object X, Y in metres): squares set on their points in a grid of bands.

    Each tile has its own tone, and dull places where many have walked.
    """
    material, graph = begin(name)
    place = graph.coordinates(scale=(1.0 / tile,) * 3)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": place})
    x, y = (graph.math("PINGPONG", axes.outputs[i], 0.5) for i in (0, 1))  # 0 at the joints, ½ in the middle
    to_edge = graph.math("MINIMUM", x, y)
    to_corner = graph.math("ADD", x, y)  # ½ on the square's sides, 1 in the middle
    cell = graph.add(
        "ShaderNodeVectorMath",
        {"Vector": graph.add("ShaderNodeVectorMath", {"Vector": place}, operation="FLOOR").outputs[0]},
        operation="ADD",
    ).outputs[0]
    own = graph.add("ShaderNodeTexWhiteNoise", {"Vector": cell}).outputs["Value"]
    lozenge = graph.mix(graph.math("GREATER_THAN", own, 0.45), dark, red)
    colour = graph.mix(graph.math("GREATER_THAN", to_corner, 0.56), pale, lozenge)
    colour = graph.mix(graph.math("GREATER_THAN", to_corner, 0.82), colour, pale)
    colour = graph.mix(graph.math("LESS_THAN", to_edge, 0.035), colour, dimmed(dark, 0.55))
    veins = graph.noise(graph.coordinates(), 5.0, 4.0, 1.5)
    shade = graph.math("ADD", graph.math("MULTIPLY", own, 0.35), graph.math("MULTIPLY", veins, 0.9))
    colour = graph.mix(1.0, colour, graph.ramp(shade, [(0.3, (0.62,) * 3), (0.9, (1.12,) * 3)]), "MULTIPLY")
    dull = graph.noise(graph.coordinates(), 0.9, 3.0)
    gloss = graph.math("ADD", graph.math("MULTIPLY", dull, 0.5), 0.08)
    graph.surface(colour, gloss, specular=0.45)
    return material


def patina(name: str, metal: Colour, green: Colour, amount: float = 0.45) -> bpy.types.Material:
    """Bronze or copper: bright where it is rubbed, verdigris in the rest."""
    material, graph = begin(name)
    eaten = graph.noise(graph.coordinates(), 7.0, 4.0, 0.6)
    covered = graph.ramp(eaten, [(amount - 0.08, (1.0,) * 3), (amount + 0.08, (0.0,) * 3)])
    colour = graph.mix(covered, metal, green)
    bare = graph.math("SUBTRACT", 1.0, covered)
    roughness = graph.math("ADD", graph.math("MULTIPLY", covered, 0.5), 0.24)
    graph.surface(colour, roughness, specular=0.4, Metallic=bare)
    return material


def glazed(name: str, ground: Colour, line: Colour) -> bpy.types.Material:
    """Painted and glazed earthenware: zigzag bands round the body (object Z up, metres)."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates()})
    around = graph.math("ARCTAN2", axes.outputs["Y"], axes.outputs["X"])
    zigzag = graph.math("PINGPONG", graph.math("MULTIPLY", around, 2.546), 0.5)  # eight teeth
    up = graph.math(
        "ADD", graph.math("MULTIPLY", axes.outputs["Z"], 5.0), graph.math("MULTIPLY", zigzag, 0.9)
    )
    band = graph.math("FRACT", up, 0.0)
    colour = graph.ramp(band, [(0.0, line), (0.3, ground), (0.55, line), (0.62, ground)], "CONSTANT")
    graph.surface(colour, 0.14, specular=0.5)
    return material


def drape(name: str, colour: Colour, border: Colour, motif: Colour) -> bpy.types.Material:
    """Hanging cloth, wide in X and hung in Z: a border along its sides and foot, rows of lozenges within.

    A third of the light comes through.
    """
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    x, z = axes.outputs["X"], axes.outputs["Z"]
    aside = graph.math("SUBTRACT", 0.5, graph.math("ABSOLUTE", graph.math("SUBTRACT", x, 0.5), 0.0))
    edge = graph.math("MINIMUM", graph.math("MULTIPLY", aside, 0.9), z)
    u = graph.math("PINGPONG", graph.math("MULTIPLY", x, 5.0), 0.5)
    v = graph.math("PINGPONG", graph.math("MULTIPLY", z, 8.0), 0.5)
    lozenge = graph.math("GREATER_THAN", graph.math("ADD", u, v), 0.80)
    tone = graph.mix(lozenge, colour, motif)
    faded = graph.clouds(graph.coordinates(), 3.0, 3.0, 0.75, 1.12)
    tone = graph.mix(1.0, tone, faded, "MULTIPLY")
    trim = graph.ramp(edge, [(0.0, border), (0.03, colour), (0.045, border), (0.085, colour)], "CONSTANT")
    tone = graph.mix(graph.math("LESS_THAN", edge, 0.10), tone, trim)
    graph.finish(graph.thin_cloth(tone, 0.35))
    return material


def water(name: str, deep: Colour) -> bpy.types.Material:
    """Still, dark water: a mirror at grazing angles, hardly rippled."""
    material, graph = begin(name)
    ripples = graph.noise(graph.coordinates(), 3.5, 2.0, 0.6)
    graph.surface(deep, 0.03, specular=0.5, IOR=1.33, Normal=graph.bumps(ripples, 0.02, 0.12))
    return material
