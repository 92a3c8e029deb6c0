# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials about a hearth: stone, bark, soot, live coals, flames, leather; a dog's coat."""

from collections.abc import Sequence

import bpy

from .shading import Colour, Graph, Socket, begin, unsampled


def _random(graph: Graph, low: float, high: float) -> Socket:
    """A grey for each object of its own: stones, boards and logs that share a material differ."""
    dice = graph.add("ShaderNodeObjectInfo").outputs["Random"]
    return graph.ramp(dice, [(0.0, (low,) * 3), (1.0, (high,) * 3)])


def stone(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """Field stone with lichen; each stone has a tone of its own."""
    material, graph = begin(name)
    vector = graph.coordinates(space="Object")
    cloud = graph.ramp(graph.noise(vector, 7.0, 4.0, 0.6), [(0.3, dark), (0.7, light)])
    spots = graph.ramp(graph.voronoi(vector, 24.0), [(0.12, (0.7, 0.72, 0.68)), (0.3, (1.0, 1.0, 1.0))])
    colour = graph.mix(1.0, graph.mix(1.0, cloud, spots, "MULTIPLY"), _random(graph, 0.55, 1.25), "MULTIPLY")
    graph.surface(colour, 0.85, specular=0.15)
    return material


def bark(name: str) -> bpy.types.Material:
    """Furrowed bark along an object's Z."""
    material, graph = begin(name)
    furrows = graph.noise(graph.coordinates(scale=(3.0, 3.0, 0.5)), 12.0, 3.0, 0.5)
    colour = graph.ramp(furrows, [(0.35, (0.03, 0.018, 0.012)), (0.65, (0.20, 0.13, 0.085))])
    graph.surface(graph.mix(1.0, colour, _random(graph, 0.7, 1.3), "MULTIPLY"), 0.9, specular=0.1)
    return material


def sawn(name: str) -> bpy.types.Material:
    """The end of a log: year rings about the object's Z and a crack."""
    material, graph = begin(name)
    rings = graph.add(
        "ShaderNodeTexWave",
        {"Vector": graph.coordinates(), "Scale": 17.0, "Distortion": 1.2, "Detail": 1.0},
        wave_type="RINGS",
        rings_direction="Z",
    ).outputs["Factor"]
    colour = graph.ramp(rings, [(0.2, (0.30, 0.17, 0.075)), (0.8, (0.58, 0.40, 0.22))])
    graph.surface(graph.mix(1.0, colour, _random(graph, 0.75, 1.1), "MULTIPLY"), 0.85, specular=0.1)
    return material


def boards(name: str, colour: Colour, worn: Colour) -> bpy.types.Material:
    """Painted boards, each a little different, rubbed off in streaks along Z."""
    material, graph = begin(name)
    streaks = graph.noise(graph.coordinates(scale=(6.0, 6.0, 0.7)), 4.0, 4.0, 0.4)
    tone = graph.ramp(streaks, [(0.32, worn), (0.46, colour)])
    graph.surface(graph.mix(1.0, tone, _random(graph, 0.85, 1.1), "MULTIPLY"), 0.55, specular=0.25)
    return material


def leather(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """Worn leather: creased, lighter where it is rubbed."""
    material, graph = begin(name)
    creases = graph.voronoi(graph.coordinates(), 13.0, "Distance")
    cloud = graph.noise(graph.coordinates(), 5.0, 3.0, 0.5)
    colour = graph.mix(
        0.35, graph.ramp(cloud, [(0.3, dark), (0.7, light)]), graph.ramp(creases, [(0.1, light), (0.6, dark)])
    )
    graph.surface(colour, 0.38, specular=0.4)
    return material


def coals(name: str, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """Lumps with a grey crust that glow through its cracks and from below, up to ``radiance``."""
    material, graph = begin(name)
    vector = graph.coordinates()
    heat = graph.noise(graph.coordinates(space="Object"), 11.0, 3.0, 0.4)
    each = graph.add("ShaderNodeObjectInfo").outputs["Random"]
    warm = graph.math("ADD", heat, graph.math("MULTIPLY", graph.math("SUBTRACT", each, 0.5), 0.35))
    glow = graph.ramp(
        warm,
        [
            (0.40, (0.0, 0.0, 0.0)),
            (0.50, (0.05, 0.004, 0.0)),
            (0.62, (0.40, 0.07, 0.008)),
            (0.80, (1.0, 0.38, 0.08)),
        ],
    )
    ash = graph.ramp(
        graph.noise(vector, 16.0, 3.0), [(0.35, (0.02, 0.018, 0.017)), (0.7, (0.16, 0.15, 0.14))]
    )
    light = graph.add("ShaderNodeEmission", {"Color": glow, "Strength": radiance})
    body = graph.add("ShaderNodeBsdfDiffuse", {"Color": ash}).outputs[0]
    graph.finish(
        graph.add("ShaderNodeAddShader", {"Shader": body, "Shader_001": light.outputs[0]}).outputs[0]
    )
    unsampled(material)
    return material, light.inputs["Strength"]


def flame(name: str, radiance: float) -> tuple[bpy.types.Material, Socket]:
    """A tongue of fire (Generated Z from its root): bright and yellow below, thin at its edge and tip."""
    material, graph = begin(name)
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.coordinates(space="Generated")}).outputs["Z"]
    colour = graph.ramp(
        height, [(0.0, (1.0, 0.5, 0.14)), (0.5, (0.7, 0.24, 0.04)), (1.0, (0.25, 0.04, 0.004))]
    )
    light = graph.add("ShaderNodeEmission", {"Color": colour, "Strength": radiance})
    facing = graph.add("ShaderNodeLayerWeight", {"Blend": 0.5}).outputs["Facing"]
    thin = graph.ramp(facing, [(0.1, (0.15,) * 3), (0.85, (1.0,) * 3)])
    clear = graph.add("ShaderNodeBsdfTransparent").outputs[0]
    graph.finish(graph.blend(thin, light.outputs[0], clear))
    unsampled(material)
    return material, light.inputs["Strength"]


def coat(
    name: str, ground: Colour, patches: Sequence[tuple[Colour, Sequence[tuple[int, float, float]]]]
) -> bpy.types.Material:
    """Fur in patches. Each patch: its colour, and the (axis, from, to) of the object's metres that it covers;
    ``from`` > ``to`` covers what is below. Borders are ragged and about 2 cm wide."""
    material, graph = begin(name)
    vector = graph.coordinates()
    ragged = graph.math("MULTIPLY", graph.math("SUBTRACT", graph.noise(vector, 14.0, 3.0), 0.5), 0.07)
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": vector})
    colour: Socket = ground
    for tint, bounds in patches:
        inside: Socket = 1.0
        for axis, low, high in bounds:
            # |x| for the patches of either side
            value = graph.math("ABSOLUTE", axes.outputs[0], 0.0) if axis == 0 else axes.outputs[axis]
            ramp = graph.add(
                "ShaderNodeMapRange",
                {"Value": graph.math("ADD", value, ragged), "From Min": low, "From Max": high},
            )
            inside = graph.math("MULTIPLY", inside, ramp.outputs[0])
        colour = graph.mix(inside, colour, tint)
    fine = graph.clouds(vector, 60.0, 2.0, 0.7, 1.2)
    graph.surface(graph.mix(1.0, colour, fine, "MULTIPLY"), 0.7, specular=0.15)
    return material
