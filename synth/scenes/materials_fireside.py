# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials of a fireside: woven and buttoned cloth, marble, sooty bricks, embers, flames."""

import math

import bpy

from .shading import Colour, Socket, begin, unsampled


def velvet(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """Short pile: crushed here and there, bright where it turns away."""
    material, graph = begin(name)
    vector = graph.coordinates()
    crushed = graph.ramp(graph.noise(vector, 6.0, 3.0, 0.6), [(0.3, dark), (0.7, light)])
    graph.surface(crushed, 0.85, specular=0.1, sheen=0.35)
    return material


def herringbone(name: str, dark: Colour, light: Colour, scale: float = 13.0) -> bpy.types.Material:
    """Twill in zigzag, ``scale`` bands a metre of object X by Y and Z."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates()})
    along = graph.math("ADD", axes.outputs["Y"], axes.outputs["Z"])
    fold = graph.math("PINGPONG", axes.outputs["X"], 0.07)
    band = graph.math("PINGPONG", graph.math("MULTIPLY", graph.math("ADD", along, fold), scale), 0.5)
    worn = graph.clouds(graph.coordinates(), 9.0, 3.0, 0.7, 1.1)
    twill = graph.ramp(band, [(0.18, dark), (0.32, light)])
    graph.surface(graph.mix(1.0, twill, worn, "MULTIPLY"), 0.95, specular=0.05, sheen=0.15)
    return material


def knit(name: str, dark: Colour, light: Colour, scale: float = 7.0) -> bpy.types.Material:
    """Thick yarn in ribs along object Z."""
    material, graph = begin(name)
    vector = graph.coordinates()
    rib = graph.wave(vector, scale, 1.5, "Z")
    stitch = graph.noise(vector, 12.0, 2.0)
    yarn = graph.math("MULTIPLY", rib, graph.math("ADD", 0.4, stitch))
    graph.surface(graph.ramp(yarn, [(0.1, dark), (0.8, light)]), 1.0, specular=0.05, sheen=0.2)
    return material


def damask(name: str, ground: Colour, line: Colour, motif: Colour) -> bpy.types.Material:
    """Printed paper: an ogee lattice of 32 × 52 cm with a rosette in each field (object X, Z in metres)."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates()})
    x, z = axes.outputs["X"], axes.outputs["Z"]
    swing = graph.math("SINE", graph.math("MULTIPLY", z, 2.0 * math.pi / 0.52), 0.0)
    swing = graph.math("MULTIPLY", swing, 0.075)
    folds = [graph.math("PINGPONG", graph.math(sign, x, swing), 0.16) for sign in ("ADD", "SUBTRACT")]
    lattice = graph.math("MINIMUM", folds[0], graph.math("SUBTRACT", 0.16, folds[1]))
    base = graph.ramp(graph.math("MULTIPLY", lattice, 10.0), [(0.08, line), (0.22, ground)])
    petal = graph.math(
        "MULTIPLY",
        graph.math("COSINE", graph.math("MULTIPLY", x, 2.0 * math.pi / 0.16), 0.0),
        graph.math("COSINE", graph.math("MULTIPLY", z, 2.0 * math.pi / 0.26), 0.0),
    )
    printed = graph.mix(graph.ramp(petal, [(0.55, (0,) * 3), (0.68, (1,) * 3)]), base, motif)
    stains = graph.clouds(graph.coordinates(), 1.6, 4.0, 0.75, 1.05)
    graph.surface(graph.mix(1.0, printed, stains, "MULTIPLY"), 0.6, specular=0.25)
    return material


def marble(name: str, ground: Colour, vein: Colour) -> bpy.types.Material:
    """Polished stone with drifting veins."""
    material, graph = begin(name)
    vector = graph.coordinates(rotation=(0.4, 0.5, 0.3))
    drift = graph.wave(vector, 1.4, 9.0, "DIAGONAL")
    cloud = graph.noise(vector, 3.5, 4.0, 1.4)
    veins = graph.ramp(drift, [(0.02, vein), (0.16, ground)])
    colour = graph.mix(
        1.0, veins, graph.ramp(cloud, [(0.3, (0.82, 0.82, 0.84)), (0.65, (1.0,) * 3)]), "MULTIPLY"
    )
    graph.surface(colour, 0.22, specular=0.5)
    return material


def soot_bricks(name: str) -> bpy.types.Material:
    """Fire bricks, black toward the top (object X and Z in metres)."""
    material, graph = begin(name)
    vector, tones = graph.coordinates(rotation=(1.5708, 0.0, 0.0)), ((0.26, 0.10, 0.055), (0.15, 0.06, 0.04))
    brick = graph.bricks(vector, tones, (0.10, 0.08, 0.07), (0.19, 0.075), 0.010)
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")}).outputs["Z"]
    soot = graph.ramp(height, [(0.15, (0.9,) * 3), (0.95, (0.12,) * 3)])
    graph.surface(graph.mix(1.0, brick.outputs["Color"], soot, "MULTIPLY"), 0.95, specular=0.1)
    return material


def embers(name: str, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """Charred wood with glowing cracks, and the input its light is linear in."""
    material, graph = begin(name)
    vector = graph.coordinates()
    cracks = graph.voronoi(vector, 19.0)
    patches = graph.noise(vector, 7.0, 2.0)
    heat = graph.math("MULTIPLY", cracks, graph.math("MULTIPLY", patches, patches))
    glow = graph.ramp(heat, [(0.06, (0.0,) * 3), (0.14, (0.30, 0.02, 0.0)), (0.30, (1.0, 0.26, 0.03))])
    light = graph.add("ShaderNodeEmission", {"Color": glow, "Strength": radiance})
    bark = graph.ramp(cracks, [(0.1, (0.012, 0.010, 0.009)), (0.6, (0.06, 0.05, 0.045))])
    coal = graph.add("ShaderNodeBsdfDiffuse", {"Color": bark})
    both = graph.add("ShaderNodeAddShader", {"Shader": light.outputs[0], "Shader_001": coal.outputs[0]})
    graph.finish(both.outputs[0])
    unsampled(material)  # a lamp inside the fire gives its light
    return material, light.inputs["Strength"]


def flame(name: str, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """Yellow at its foot, red and thin at its tip, clear at its rim; and the input it is linear in."""
    material, graph = begin(name)
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")}).outputs["Z"]
    colour = graph.ramp(
        height, [(0.0, (0.8, 0.26, 0.04)), (0.25, (1.0, 0.46, 0.09)), (1.0, (0.5, 0.09, 0.01))]
    )
    light = graph.add("ShaderNodeEmission", {"Color": colour, "Strength": radiance})
    facing = graph.add("ShaderNodeLayerWeight", {"Blend": 0.35}).outputs["Facing"]
    thin = graph.math("MAXIMUM", facing, graph.math("MULTIPLY", height, 0.85))
    clear = graph.add("ShaderNodeBsdfTransparent").outputs[0]
    graph.finish(graph.blend(thin, light.outputs[0], clear))
    unsampled(material)
    return material, light.inputs["Strength"]
