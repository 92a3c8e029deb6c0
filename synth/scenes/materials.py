# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials: wood, cloth, plaster, tiles, leaves, glazes, metals, paintings, lamps.

Every pattern has its finest visible feature at some centimetres, about one pixel of a 200 × 200 picture
of a room: finer grain would only alias, and a splat could not hold it.
"""

from collections.abc import Sequence

import bpy

from .shading import Colour, Socket, begin, dimmed


def plain(name: str, colour: Colour, roughness: float = 0.6, metallic: float = 0.0) -> bpy.types.Material:
    """One colour: glaze, metal, paint."""
    material, graph = begin(name)
    graph.surface(colour, roughness, specular=0.5, metallic=metallic)
    return material


def speckled(
    name: str, base: Colour, spot: Colour, scale: float, roughness: float = 0.25
) -> bpy.types.Material:
    """Glazed ceramic with soft spots."""
    material, graph = begin(name)
    spots = graph.voronoi(graph.coordinates(), scale)
    graph.surface(graph.ramp(spots, [(0.22, spot), (0.42, base)]), roughness, specular=0.5)
    return material


def banded(name: str, bands: Sequence[Colour], roughness: float = 0.25) -> bpy.types.Material:
    """Ceramic with painted horizontal bands from foot to rim."""
    material, graph = begin(name)
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")}).outputs["Z"]
    stops = [(index / len(bands), band) for index, band in enumerate(bands)]
    graph.surface(graph.ramp(height, stops, "CONSTANT"), roughness, specular=0.5)
    return material


def wood(
    name: str, dark: Colour, light: Colour, axis: str = "X", scale: float = 5.0, roughness: float = 0.45
) -> bpy.types.Material:
    """Grain that runs along an object's ``axis``."""
    material, graph = begin(name)
    stretch = {"X": (0.22, 1.7, 1.7), "Y": (1.7, 0.22, 1.7), "Z": (1.7, 1.7, 0.22)}[axis]
    vector = graph.coordinates(scale=stretch)
    across = "Y" if axis == "X" else "X"
    grain = graph.wave(vector, scale, distortion=5.0, direction=across)
    streaks = graph.noise(vector, scale * 2.2, detail=2.0, distortion=0.6)
    colour = graph.mix(
        0.5, graph.ramp(grain, [(0.1, dark), (0.9, light)]), graph.ramp(streaks, [(0.3, dark), (0.7, light)])
    )
    graph.surface(colour, roughness)
    return material


def floorboards(name: str) -> bpy.types.Material:
    """Oak boards of 14 cm with dark joints; every board has its own tone and grain."""
    material, graph = begin(name)
    vector = graph.coordinates(rotation=(0.0, 0.0, 1.5708))
    tones, joint = ((0.36, 0.19, 0.085), (0.16, 0.075, 0.032)), (0.02, 0.01, 0.006)
    brick = graph.bricks(vector, tones, joint, (1.1, 0.14), 0.007, smooth=0.2, offset=0.37)
    grain = graph.noise(graph.coordinates(scale=(9.0, 1.1, 1.0)), 2.2, detail=3.0, distortion=1.2)
    tone = graph.ramp(grain, [(0.25, (0.45, 0.42, 0.4)), (0.75, (1.25, 1.22, 1.18))])
    colour = graph.mix(1.0, brick.outputs["Color"], tone, "MULTIPLY")
    graph.surface(colour, 0.38, specular=0.35)
    return material


def wallpaper(name: str, ground: Colour, stripe: Colour, motif: Colour) -> bpy.types.Material:
    """Broad stripes along the wall's X with a staggered motif, as printed paper."""
    material, graph = begin(name)
    vector = graph.coordinates()
    stripes = graph.wave(vector, 0.95, direction="X")
    base = graph.ramp(stripes, [(0.42, ground), (0.58, stripe)])
    cells = graph.voronoi(
        graph.coordinates(scale=(5.4, 5.4, 5.4), rotation=(0.0, 0.6, 0.0)), 1.0, randomness=0.25
    )
    printed = graph.mix(graph.ramp(cells, [(0.2, (1, 1, 1)), (0.3, (0, 0, 0))]), base, motif)
    stains = graph.ramp(graph.noise(vector, 1.6, 4.0), [(0.3, (0.78, 0.76, 0.72)), (0.7, (1.05, 1.04, 1.02))])
    graph.surface(graph.mix(1.0, printed, stains, "MULTIPLY"), 0.85, specular=0.1)
    return material


def plaster(name: str, colour: Colour, contrast: float = 0.25) -> bpy.types.Material:
    """Painted plaster with the uneven tone of a brush and a trowel."""
    material, graph = begin(name)
    vector = graph.coordinates()
    dark = dimmed(colour, 1.0 - contrast)
    cloud = graph.noise(vector, 2.6, 4.0, 0.8)
    graph.surface(graph.ramp(cloud, [(0.3, dark), (0.7, colour)]), 0.9, specular=0.1)
    return material


def cloth(
    name: str, warp: Colour, weft: Colour, scale: float = 5.0, angle: float = 0.0
) -> bpy.types.Material:
    """Plaid: two crossing sets of bands."""
    material, graph = begin(name)
    vector = graph.coordinates(rotation=(angle, angle, angle))
    first = graph.ramp(graph.wave(vector, scale, 0.4, "X"), [(0.45, warp), (0.6, weft)])
    second = graph.ramp(graph.wave(vector, scale, 0.4, "Z"), [(0.45, weft), (0.6, warp)])
    mottling = graph.clouds(vector, 14.0, 2.0, 0.72, 1.12)
    colour = graph.mix(1.0, graph.mix(0.5, first, second), mottling, "MULTIPLY")
    graph.surface(colour, 0.95, specular=0.05)
    return material


def fabric(name: str, dark: Colour, light: Colour, scale: float = 11.0) -> bpy.types.Material:
    """Heavy woven cover: mottled."""
    material, graph = begin(name)
    vector = graph.coordinates()
    weave = graph.noise(vector, scale, 3.0)
    graph.surface(
        graph.ramp(weave, [(0.32, dark), (0.68, light)]),
        0.95,
        specular=0.05,
    )
    return material


def curtain(name: str, colour: Colour, stripe: Colour) -> bpy.types.Material:
    """Thin cloth: half of the light comes through."""
    material, graph = begin(name)
    height = graph.wave(graph.coordinates(), 1.6, direction="Z")
    tone = graph.ramp(height, [(0.75, colour), (0.9, stripe)])
    graph.finish(graph.thin_cloth(tone, 0.4))
    return material


def rug(name: str) -> bpy.types.Material:
    """Oriental rug: border bands and a field of diamonds (object X, Y in metres about the centre)."""
    material, graph = begin(name)
    red, blue, cream, ochre = (0.30, 0.03, 0.025), (0.02, 0.045, 0.14), (0.62, 0.52, 0.36), (0.45, 0.22, 0.04)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    distances = [
        graph.math("MULTIPLY", graph.math("ABSOLUTE", graph.math("SUBTRACT", axes.outputs[i], 0.5), 0.0), 2.0)
        for i in (0, 1)
    ]
    edge = graph.math("MAXIMUM", distances[0], distances[1])
    border = graph.ramp(
        edge,
        [(0.0, red), (0.70, ochre), (0.74, blue), (0.88, cream), (0.92, red), (0.97, blue)],
        "CONSTANT",
    )
    diamonds = graph.add(
        "ShaderNodeTexChecker",
        {
            "Vector": graph.coordinates(scale=(7.0, 7.0, 7.0), rotation=(0.0, 0.0, 0.7854)),
            "Color1": red,
            "Color2": cream,
            "Scale": 1.0,
        },
    ).outputs["Color"]
    in_field = graph.math("LESS_THAN", edge, 0.68)
    colour = graph.mix(in_field, border, diamonds)
    wear = graph.clouds(graph.coordinates(), 8.0, 3.0, 0.7, 1.15)
    graph.surface(graph.mix(1.0, colour, wear, "MULTIPLY"), 1.0, specular=0.0)
    return material


def painting(name: str, kind: str) -> bpy.types.Material:
    """A canvas: ``landscape`` (sky, hills, water) or ``abstract`` (colour fields)."""
    material, graph = begin(name)
    generated = graph.coordinates(space="Generated")
    if kind == "landscape":
        height = graph.add("ShaderNodeSeparateXYZ", {"Vector": generated}).outputs["Z"]
        ridge = graph.noise(graph.coordinates(scale=(1.0, 1.0, 0.3)), 5.0, 3.0)
        level = graph.math("ADD", height, graph.math("MULTIPLY", graph.math("SUBTRACT", ridge, 0.5), 0.35))
        colour = graph.ramp(
            level,
            [
                (0.0, (0.05, 0.09, 0.03)),
                (0.2, (0.22, 0.26, 0.05)),
                (0.38, (0.04, 0.09, 0.08)),
                (0.55, (0.12, 0.17, 0.26)),
                (0.62, (0.65, 0.42, 0.18)),
                (0.95, (0.16, 0.30, 0.50)),
            ],
            "EASE",
        )
    else:
        cells = graph.voronoi(graph.coordinates(scale=(1.0, 1.0, 1.0)), 6.0, "Color")
        value = graph.add("ShaderNodeSeparateColor", {"Color": cells}).outputs[0]
        colour = graph.ramp(
            value,
            [
                (0.0, (0.55, 0.07, 0.03)),
                (0.25, (0.70, 0.45, 0.06)),
                (0.45, (0.75, 0.68, 0.52)),
                (0.65, (0.03, 0.12, 0.22)),
                (0.85, (0.02, 0.02, 0.02)),
            ],
            "CONSTANT",
        )
    graph.surface(colour, 0.7, specular=0.1)
    return material


def leaf(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """Leaves: shiny above, veined by bands along the blade, a little light comes through."""
    material, graph = begin(name)
    veins = graph.wave(graph.coordinates(), 7.0, 1.0, "Y")
    colour = graph.ramp(veins, [(0.2, dark), (0.8, light)])
    graph.surface(colour, 0.4, specular=0.4)
    return material


def bricks(name: str) -> bpy.types.Material:
    """The house across the street."""
    material, graph = begin(name)
    vector, tones = graph.coordinates(rotation=(1.5708, 0.0, 0.0)), ((0.42, 0.15, 0.09), (0.28, 0.10, 0.07))
    brick = graph.bricks(vector, tones, (0.5, 0.46, 0.4), (1.4, 0.5), 0.05)
    graph.surface(brick.outputs["Color"], 0.9, specular=0.1)
    return material


def emission(name: str, colour: Colour, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """A luminous surface and its strength input (scene-linear radiance of a white source)."""
    material, graph = begin(name)
    node = graph.add("ShaderNodeEmission", {"Color": colour, "Strength": radiance})
    graph.finish(node.outputs[0])
    return material, node.inputs["Strength"]
