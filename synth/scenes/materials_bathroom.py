# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of a bathroom: glazed tiles, marble, a mirror, thin glass, terry cloth."""

import bpy

from .shading import Colour, Graph, begin, dimmed


def _position(graph: Graph) -> bpy.types.Node:
    """World coordinates, so that a pattern runs on from one piece of a wall to the next."""
    point = graph.add("ShaderNodeNewGeometry").outputs["Position"]
    return graph.add("ShaderNodeSeparateXYZ", {"Vector": point})


def tiled_wall(
    name: str, tones: tuple[Colour, Colour], band: Colour, paint: Colour, height: float
) -> bpy.types.Material:
    """Glazed tiles of 20 × 10 cm in a half bond up to ``height`` with one row of ``band``, plaster above.

    ``height``: a multiple of 0.1 m. For walls along X or Y.
    """
    material, graph = begin(name)
    at = _position(graph)
    along = graph.math("ADD", at.outputs["X"], at.outputs["Y"])
    vector = graph.add("ShaderNodeCombineXYZ", {"X": along, "Y": at.outputs["Z"]}).outputs[0]
    grout = (0.30, 0.29, 0.26)
    brick = graph.bricks(vector, tones, grout, (0.2, 0.1), 0.004, smooth=0.2)
    joint = brick.outputs["Factor"]
    z = at.outputs["Z"]
    row = graph.math(
        "MULTIPLY", graph.math("GREATER_THAN", z, height - 0.2), graph.math("LESS_THAN", z, height - 0.1)
    )
    coloured = graph.math("MULTIPLY", row, graph.math("SUBTRACT", 1.0, joint))
    glaze = graph.mix(coloured, brick.outputs["Color"], band)
    # A glaze is never flat: every highlight of a bulb breaks differently.
    waves = graph.noise(vector, 9.0, 1.0)
    relief = graph.math("SUBTRACT", graph.math("MULTIPLY", waves, 0.5), joint)
    normal = graph.bumps(relief, 0.004, 0.5)
    rough = graph.math("ADD", graph.math("MULTIPLY", joint, 0.6), 0.16)
    tiles = graph.principled(glaze, rough, specular=0.5, Normal=normal)
    cloud = graph.noise(vector, 2.6, 4.0, 0.8)
    dark = dimmed(paint, 0.78)
    wash = graph.ramp(cloud, [(0.3, dark), (0.7, paint)])
    plaster = graph.add("ShaderNodeBsdfDiffuse", {"Color": wash}).outputs[0]
    above = graph.math("GREATER_THAN", z, height)
    graph.finish(graph.blend(above, tiles, plaster))
    return material


def patterned_floor(
    name: str, light: Colour, dark: Colour, dot: Colour, size: float = 0.24
) -> bpy.types.Material:
    """Cement tiles of ``size`` in two tones, laid diagonally, with a dot where four corners meet."""
    material, graph = begin(name)
    point = graph.add("ShaderNodeNewGeometry").outputs["Position"]
    turned = graph.add(
        "ShaderNodeMapping",
        {"Vector": point, "Rotation": (0.0, 0.0, 0.7854), "Scale": (1 / size, 1 / size, 1 / size)},
    ).outputs[0]
    flat = graph.add("ShaderNodeSeparateXYZ", {"Vector": turned})
    u, v = flat.outputs["X"], flat.outputs["Y"]
    cell = graph.math("ADD", graph.math("FLOOR", u, 0.0), graph.math("FLOOR", v, 0.0))
    odd = graph.math("ABSOLUTE", graph.math("MODULO", cell, 2.0), 0.0)
    base = graph.mix(odd, light, dark)
    # 0 at a tile's edge, 0.5 in its middle.
    edges = [
        graph.math(
            "SUBTRACT",
            0.5,
            graph.math("ABSOLUTE", graph.math("SUBTRACT", graph.math("FRACT", x, 0.0), 0.5), 0.0),
        )
        for x in (u, v)
    ]
    joint = graph.math("LESS_THAN", graph.math("MINIMUM", edges[0], edges[1]), 0.018)
    corner = graph.math("LESS_THAN", graph.math("ADD", edges[0], edges[1]), 0.19)
    wear = graph.ramp(graph.noise(point, 7.0, 3.0), [(0.3, (0.78, 0.77, 0.75)), (0.7, (1.08, 1.07, 1.05))])
    colour = graph.mix(corner, graph.mix(joint, base, (0.16, 0.15, 0.14)), dot)
    colour = graph.mix(1.0, colour, wear, "MULTIPLY")
    rough = graph.math("ADD", graph.math("MULTIPLY", graph.noise(point, 12.0), 0.25), 0.2)
    graph.surface(colour, rough, specular=0.4)
    return material


def marble(name: str, ground: Colour, vein: Colour) -> bpy.types.Material:
    """Polished stone with veins of some millimetres."""
    material, graph = begin(name)
    vector = graph.coordinates(rotation=(0.3, 0.2, 0.6))
    bands = graph.wave(vector, 1.6, 11.0)
    colour = graph.ramp(bands, [(0.0, vein), (0.10, ground), (0.75, dimmed(ground, 0.88)), (1.0, ground)])
    graph.surface(colour, 0.15, specular=0.5)
    return material


def mirror(name: str) -> bpy.types.Material:
    """Silvered glass."""
    material, graph = begin(name)
    graph.finish(
        graph.add("ShaderNodeBsdfGlossy", {"Color": (0.86, 0.88, 0.87), "Roughness": 0.0}).outputs[0]
    )
    return material


def thin_glass(name: str, tint: Colour, strength: float = 1.0) -> bpy.types.Material:
    """Glass without refraction, so without caustics: it tints what is behind it and shines at its edges."""
    material, graph = begin(name)
    facing = graph.add("ShaderNodeLayerWeight", {"Blend": 0.35}).outputs["Facing"]
    shine = graph.math("ADD", graph.math("MULTIPLY", facing, 0.55 * strength), 0.05)
    clear = graph.add("ShaderNodeBsdfTransparent", {"Color": tint}).outputs[0]
    gloss = graph.add("ShaderNodeBsdfGlossy", {"Color": (0.9, 0.9, 0.9), "Roughness": 0.06}).outputs[0]
    graph.finish(graph.blend(shine, clear, gloss))
    return material


def terry(
    name: str, ground: Colour, stripe: Colour, stripes: tuple[float, float] = (0.78, 0.9)
) -> bpy.types.Material:
    """Towelling: looped cloth with one woven band near its lower end (object Z, generated 0…1)."""
    material, graph = begin(name)
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")}).outputs["Z"]
    low, high = 1.0 - stripes[1], 1.0 - stripes[0]
    band = graph.math(
        "MULTIPLY", graph.math("GREATER_THAN", height, low), graph.math("LESS_THAN", height, high)
    )
    loops = graph.clouds(graph.coordinates(), 55.0, 1.0, 0.68, 1.1)
    colour = graph.mix(1.0, graph.mix(band, ground, stripe), loops, "MULTIPLY")
    graph.finish(graph.add("ShaderNodeBsdfDiffuse", {"Color": colour}).outputs[0])
    return material


def sheer(name: str, colour: Colour) -> bpy.types.Material:
    """Voile: more light comes through than is thrown back."""
    material, graph = begin(name)
    threads = graph.ramp(
        graph.wave(graph.coordinates(), 9.0, 0.5), [(0.2, dimmed(colour, 0.8)), (0.8, colour)]
    )
    graph.finish(graph.thin_cloth(threads, 0.6))
    return material
