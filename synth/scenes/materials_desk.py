# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials of a desk: a screen with its picture, cork, written paper, thin glass, leather."""

import bpy

from .shading import Colour, Graph, Socket, begin

ROWS = 15.0  # lines of text on the screen


def screen(name: str, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """A monitor's face over an object's Generated X, Z: a sunset in an editor beside lines of text.

    Returns:
        The material, and the input its light is linear in: radiance of a white pixel.
    """
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    u, v = axes.outputs["X"], axes.outputs["Z"]
    picture = _sunset(graph, u, v)
    panel = graph.mix(graph.math("GREATER_THAN", u, 0.655), picture, _text(graph, u, v))
    bar = graph.ramp(
        u, [(0.0, (0.10, 0.11, 0.13)), (0.02, (0.9, 0.2, 0.1)), (0.035, (0.10, 0.11, 0.13))], "CONSTANT"
    )
    colour = graph.mix(graph.math("GREATER_THAN", v, 0.945), panel, bar)
    light = graph.add("ShaderNodeEmission", {"Color": colour, "Strength": radiance})
    glass = graph.principled((0.01, 0.01, 0.012), 0.18, specular=0.4)
    both = graph.add("ShaderNodeAddShader", {"Shader": light.outputs[0], "Shader_001": glass})
    graph.finish(both.outputs[0])
    return material, light.inputs["Strength"]


def _sunset(graph: Graph, u: Socket, v: Socket) -> Socket:
    """Sky, a low sun, three ridges that darken toward the front, a lake with the sun's glitter."""
    colour = graph.ramp(
        v,
        [
            (0.30, (1.0, 0.42, 0.10)),
            (0.50, (0.95, 0.30, 0.16)),
            (0.70, (0.36, 0.16, 0.34)),
            (1.0, (0.05, 0.09, 0.30)),
        ],
    )
    point = graph.add("ShaderNodeCombineXYZ", {"X": u, "Y": v}).outputs[0]
    streaks = graph.noise(
        graph.add("ShaderNodeMapping", {"Vector": point, "Scale": (2.5, 14.0, 1.0)}).outputs[0], 1.0, 3.0
    )
    cloud = graph.ramp(streaks, [(0.55, (0.0,) * 3), (0.68, (0.55,) * 3)])
    colour = graph.mix(1.0, colour, graph.mix(1.0, cloud, (1.0, 0.42, 0.30), "MULTIPLY"), "ADD")
    aside = graph.math(
        "MULTIPLY", graph.math("SUBTRACT", u, 0.26), 1.69
    )  # the screen is 1.69 times as wide as high
    across, up = graph.math("POWER", aside, 2.0), graph.math("POWER", graph.math("SUBTRACT", v, 0.52), 2.0)
    sun = graph.math("LESS_THAN", graph.math("ADD", across, up), 0.0042)
    colour = graph.mix(sun, colour, (3.2, 2.3, 1.1))
    for base, swing, scale, shade in (
        (0.38, 0.28, 4.0, (0.30, 0.10, 0.16)),
        (0.26, 0.30, 6.0, (0.10, 0.045, 0.10)),
    ):
        along = graph.add("ShaderNodeCombineXYZ", {"X": u, "Y": base}).outputs[0]
        ridge = graph.math(
            "ADD",
            graph.math("MULTIPLY", graph.math("SUBTRACT", graph.noise(along, scale, 4.0), 0.5), swing),
            base,
        )
        colour = graph.mix(graph.math("LESS_THAN", v, ridge), colour, shade)
    wave = graph.math("PINGPONG", graph.math("MULTIPLY", v, 24.0), 0.5)
    glitter = graph.math("LESS_THAN", graph.math("ABSOLUTE", aside, 0.0), graph.math("MULTIPLY", wave, 0.17))
    lake = graph.mix(glitter, (0.05, 0.04, 0.10), (1.3, 0.62, 0.20))
    return graph.mix(graph.math("LESS_THAN", v, 0.20), colour, lake)


def _text(graph: Graph, u: Socket, v: Socket) -> Socket:
    """Lines of random length and colour on a dark ground."""
    line = graph.math("MULTIPLY", v, ROWS)
    row = graph.math("FLOOR", line, 0.0)
    dice = graph.add("ShaderNodeTexWhiteNoise", {"W": row}, noise_dimensions="1D")
    end = graph.math("ADD", graph.math("MULTIPLY", dice.outputs["Value"], 0.20), 0.75)
    inked = graph.math("MULTIPLY", graph.math("LESS_THAN", u, end), graph.math("GREATER_THAN", u, 0.685))
    inked = graph.math("MULTIPLY", inked, graph.math("GREATER_THAN", graph.math("FRACT", line, 0.0), 0.5))
    hue = graph.add("ShaderNodeSeparateColor", {"Color": dice.outputs["Color"]}).outputs[1]
    ink = graph.ramp(
        hue,
        [
            (0.0, (0.75, 0.78, 0.80)),
            (0.4, (0.20, 0.75, 0.45)),
            (0.6, (0.95, 0.55, 0.15)),
            (0.8, (0.25, 0.50, 1.0)),
        ],
        "CONSTANT",
    )
    return graph.mix(inked, (0.015, 0.018, 0.026), ink)


def cork(name: str) -> bpy.types.Material:
    """Pressed cork: crumbs of three browns."""
    material, graph = begin(name)
    vector = graph.coordinates()
    crumb = graph.add("ShaderNodeSeparateColor", {"Color": graph.voronoi(vector, 48.0, "Color")}).outputs[0]
    tone = graph.ramp(
        crumb, [(0.0, (0.20, 0.10, 0.04)), (0.35, (0.40, 0.23, 0.10)), (0.8, (0.50, 0.31, 0.15))]
    )
    cloud = graph.clouds(vector, 7.0, 3.0, 0.75, 1.1)
    graph.surface(graph.mix(1.0, tone, cloud, "MULTIPLY"), 0.95, specular=0.05)
    return material


def written(
    name: str, ink: Colour = (0.06, 0.07, 0.16), rows: float = 11.0, seed: float = 0.0
) -> bpy.types.Material:
    """Paper with lines of writing over an object's Generated X, Y."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")})
    u, v = axes.outputs["X"], axes.outputs["Y"]
    line = graph.math("MULTIPLY", v, rows)
    row = graph.math("ADD", graph.math("FLOOR", line, 0.0), seed)
    length = graph.add("ShaderNodeTexWhiteNoise", {"W": row}, noise_dimensions="1D").outputs["Value"]
    inked = graph.math("LESS_THAN", u, graph.math("ADD", graph.math("MULTIPLY", length, 0.4), 0.5))
    for test, value, limit in (("GREATER_THAN", u, 0.12), ("LESS_THAN", v, 0.92), ("GREATER_THAN", v, 0.08)):
        inked = graph.math("MULTIPLY", inked, graph.math(test, value, limit))
    inked = graph.math("MULTIPLY", inked, graph.math("GREATER_THAN", graph.math("FRACT", line, 0.0), 0.55))
    words = graph.noise(graph.coordinates(scale=(1.0, 0.05, 1.0)), 95.0, 1.0)
    inked = graph.math("MULTIPLY", inked, graph.math("GREATER_THAN", words, 0.44))
    graph.surface(graph.mix(inked, (0.72, 0.69, 0.61), ink), 0.9, specular=0.1)
    return material


def thin_glass(name: str, tint: Colour = (0.86, 0.93, 0.91)) -> bpy.types.Material:
    """A thin wall of glass: mirrors at its rim, else lets everything through unbent, so without caustics."""
    material, graph = begin(name)
    edge = graph.add("ShaderNodeLayerWeight", {"Blend": 0.22}).outputs["Fresnel"]
    clear = graph.add("ShaderNodeBsdfTransparent", {"Color": tint}).outputs[0]
    shine = graph.add("ShaderNodeBsdfAnisotropic", {"Color": (1.0, 1.0, 1.0), "Roughness": 0.05}).outputs[0]
    graph.finish(graph.blend(edge, clear, shine))
    return material


def leather(name: str, colour: Colour) -> bpy.types.Material:
    """Smooth hide, rubbed here and there."""
    material, graph = begin(name)
    vector = graph.coordinates()
    rubbed = graph.noise(vector, 9.0, 3.0, 0.5)
    worn = tuple(min(1.0, 1.7 * channel + 0.01) for channel in colour)
    graph.surface(graph.ramp(rubbed, [(0.35, colour), (0.75, worn)]), 0.42, specular=0.4)
    return material
