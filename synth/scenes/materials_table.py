# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of a dining room: linen, thin glass, rush, parquet, damask, silver."""

import bpy

from .shading import Colour, Socket, begin, dimmed


def linen(name: str, ground: Colour, figure: Colour, hem: Colour, hem_height: float) -> bpy.types.Material:
    """A tablecloth: woven figures, two stripes at ``hem_height`` (object Z, metres); light comes through."""
    material, graph = begin(name)
    vector = graph.coordinates()
    cells = graph.voronoi(graph.coordinates(scale=(9.0, 9.0, 9.0)), 1.0, randomness=0.15)
    woven = graph.mix(graph.ramp(cells, [(0.22, (1, 1, 1)), (0.34, (0, 0, 0))]), ground, figure)
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": vector}).outputs["Z"]
    off = graph.math("ABSOLUTE", graph.math("SUBTRACT", height, hem_height), 0.0)
    stripes = graph.ramp(off, [(0.0, (0, 0, 0)), (0.008, (1, 1, 1)), (0.024, (0, 0, 0))], "CONSTANT")
    colour = graph.mix(stripes, woven, hem)
    tone = graph.clouds(vector, 5.0, 3.0, 0.86, 1.0)
    colour = graph.mix(1.0, colour, tone, "MULTIPLY")
    through = graph.add("ShaderNodeBsdfTranslucent", {"Color": colour}).outputs[0]
    body = graph.principled(colour, 0.9, specular=0.1)
    graph.finish(graph.blend(0.12, body, through))
    return material


def glass(name: str, tint: Colour = (0.93, 0.95, 0.94), roughness: float = 0.06) -> bpy.types.Material:
    """A thin wall of glass: it mirrors toward its edges and is clear elsewhere. Nothing is refracted."""
    material, graph = begin(name)
    facing = graph.add("ShaderNodeLayerWeight", {"Blend": 0.35}).outputs["Facing"]
    share = graph.ramp(facing, [(0.0, (0.06,) * 3), (0.6, (0.14,) * 3), (1.0, (0.75,) * 3)])
    clear = graph.add("ShaderNodeBsdfTransparent", {"Color": tint}).outputs[0]
    shine = graph.add(
        "ShaderNodeBsdfAnisotropic", {"Color": (0.95, 0.95, 0.95), "Roughness": roughness}
    ).outputs[0]
    graph.finish(graph.blend(share, clear, shine))
    return material


def rush(name: str, dark: Colour, light: Colour, spacing: float = 0.02) -> bpy.types.Material:
    """A woven seat: strands of ``spacing`` (metres) in four triangles that meet in the middle."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates()})
    x, y = (graph.math("ABSOLUTE", axes.outputs[i], 0.0) for i in (0, 1))
    side = graph.math("GREATER_THAN", x, y)
    # In each triangle the strands run toward the nearest edge's neighbours: bands of the farther coordinate.
    reach = graph.math("MAXIMUM", x, y)
    band = graph.math("PINGPONG", reach, spacing / 2)
    strand = graph.ramp(graph.math("MULTIPLY", band, 2.0 / spacing), [(0.1, dark), (0.7, light)])
    tone = graph.mix(side, (0.85, 0.85, 0.85), (1.0, 1.0, 1.0))
    colour = graph.mix(1.0, strand, tone, "MULTIPLY")
    worn = graph.clouds(graph.coordinates(), 18.0, 2.0, 0.75, 1.1)
    graph.surface(graph.mix(1.0, colour, worn, "MULTIPLY"), 0.8, specular=0.15)
    return material


def parquet(name: str, tile: float = 0.42) -> bpy.types.Material:
    """Square panels of boards, laid alternately along and across."""
    material, graph = begin(name)

    def boards(turn: float) -> Socket:
        vector = graph.coordinates(rotation=(0.0, 0.0, turn))
        tones, joint = ((0.30, 0.145, 0.06), (0.15, 0.065, 0.028)), (0.018, 0.009, 0.005)
        made = graph.bricks(vector, tones, joint, (tile, tile / 4), 0.004, smooth=0.3, offset=0.0)
        return made.outputs["Color"]

    checks = graph.add(
        "ShaderNodeTexChecker",
        {"Vector": graph.coordinates(), "Color1": (0, 0, 0), "Color2": (1, 1, 1), "Scale": 1.0 / tile},
    ).outputs["Color"]
    colour = graph.mix(checks, boards(0.0), boards(1.570796))
    grain = graph.noise(graph.coordinates(scale=(4.0, 4.0, 1.0)), 3.0, 3.0, 1.0)
    tone = graph.ramp(grain, [(0.25, (0.6, 0.58, 0.55)), (0.75, (1.25, 1.2, 1.15))])
    graph.surface(graph.mix(1.0, colour, tone, "MULTIPLY"), 0.28, specular=0.4)
    return material


def damask(name: str, ground: Colour, figure: Colour, cell: float = 0.26) -> bpy.types.Material:
    """Wallpaper with staggered ogees and their kernels (object X + Y and Z in metres)."""
    material, graph = begin(name)
    vector = graph.coordinates()
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": vector})
    turn = 6.283185 / cell
    across = graph.math("MULTIPLY", graph.math("ADD", axes.outputs[0], axes.outputs[1]), turn)
    up = graph.math("MULTIPLY", axes.outputs[2], turn * 0.62)
    # The zero lines of cos + cos are a net of ogees, its peaks the kernels.
    net = graph.math("ADD", graph.math("COSINE", across, 0.0), graph.math("COSINE", up, 0.0))
    level = graph.math("ABSOLUTE", net, 0.0)
    lines = graph.ramp(
        level,
        [(0.0, (1, 1, 1)), (0.16, (0.9, 0.9, 0.9)), (0.24, (0, 0, 0)), (0.78, (0, 0, 0)), (0.9, (1, 1, 1))],
    )
    colour = graph.mix(lines, ground, figure)
    stains = graph.clouds(vector, 1.7, 4.0, 0.78, 1.05)
    graph.surface(graph.mix(1.0, colour, stains, "MULTIPLY"), 0.7, specular=0.2)
    return material


def metal(name: str, colour: Colour, roughness: float, worn: float = 0.0) -> bpy.types.Material:
    """Silver, brass, a mirror. ``worn``: how much darker its tarnish is."""
    material, graph = begin(name)
    tint = colour
    if worn > 0.0:
        dark = dimmed(colour, 1.0 - worn)
        tint = graph.ramp(graph.noise(graph.coordinates(), 16.0, 3.0), [(0.35, dark), (0.6, colour)])
    graph.surface(tint, roughness, specular=0.5, metallic=1.0)
    return material


def wicker(name: str, dark: Colour, light: Colour, scale: float = 26.0) -> bpy.types.Material:
    """Basketry: withies over and under each other (object X + Y across, Z up)."""
    material, graph = begin(name)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates()})
    around = graph.add(
        "ShaderNodeMath", {"Value": axes.outputs[1], "Value_001": axes.outputs[0]}, operation="ARCTAN2"
    ).outputs[0]
    columns = graph.math("SINE", graph.math("MULTIPLY", around, 18.0), 0.0)
    rows = graph.math("SINE", graph.math("MULTIPLY", axes.outputs[2], scale * 6.283185), 0.0)
    weave = graph.math("MULTIPLY", columns, rows)
    colour = graph.ramp(
        graph.math("ADD", graph.math("MULTIPLY", weave, 0.5), 0.5), [(0.2, dark), (0.7, light)]
    )
    graph.surface(colour, 0.7, specular=0.2)
    return material
