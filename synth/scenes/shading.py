# SPDX-License-Identifier: GPL-3.0-or-later
"""What all materials and skies of the scenes are written with: a node tree under construction."""

from collections.abc import Sequence
from typing import Any

import bpy

from ..blender import cycles

Colour = tuple[float, float, float]  # scene-linear reflectance
Socket = Any  # bpy.types.NodeSocket, or a plain value where an input takes one


class Graph:
    """A node tree under construction: each method adds a node and returns the output to link on."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        tree.nodes.clear()

    def add(self, kind: str, inputs: dict[str, Socket] | None = None, **attributes: Any) -> Any:
        """A node of type ``kind`` with attributes set; inputs (by identifier) are linked or set."""
        node: Any = self.tree.nodes.new(kind)
        for key, value in attributes.items():
            setattr(node, key, value)
        by_identifier = {socket.identifier: socket for socket in node.inputs}
        for key, value in (inputs or {}).items():
            target = by_identifier[key]
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, target)
            elif isinstance(value, tuple) and target.type == "RGBA":
                target.default_value = (*value, 1.0)
            else:
                target.default_value = value
        return node

    def coordinates(
        self, scale: Sequence[float] = (1, 1, 1), rotation: Sequence[float] = (0, 0, 0), space: str = "Object"
    ) -> Socket:
        """Texture coordinates in metres of the object (or ``Generated``: 0…1 over its bounds)."""
        source = self.add("ShaderNodeTexCoord").outputs[space]
        inputs = {"Vector": source, "Scale": tuple(scale), "Rotation": tuple(rotation)}
        return self.add("ShaderNodeMapping", inputs).outputs["Vector"]

    def noise(self, vector: Socket, scale: float, detail: float = 2.0, distortion: float = 0.0) -> Socket:
        inputs = {"Vector": vector, "Scale": scale, "Detail": detail, "Distortion": distortion}
        return self.add("ShaderNodeTexNoise", inputs).outputs["Factor"]

    def wave(
        self, vector: Socket, scale: float, distortion: float = 0.0, direction: str = "X", rings: bool = False
    ) -> Socket:
        attributes = {"wave_type": "RINGS"} if rings else {"wave_type": "BANDS", "bands_direction": direction}
        inputs = {"Vector": vector, "Scale": scale, "Distortion": distortion, "Detail": 1.0}
        return self.add("ShaderNodeTexWave", inputs, **attributes).outputs["Factor"]

    def voronoi(
        self, vector: Socket, scale: float, output: str = "Distance", randomness: float = 1.0
    ) -> Socket:
        inputs = {"Vector": vector, "Scale": scale, "Randomness": randomness}
        return self.add("ShaderNodeTexVoronoi", inputs).outputs[output]

    def ramp(
        self, factor: Socket, stops: Sequence[tuple[float, Sequence[float]]], interpolation: str = "LINEAR"
    ) -> Socket:
        """Colour looked up in a ramp of (position 0…1, colour)."""
        node = self.add("ShaderNodeValToRGB", {"Fac": factor})
        ramp = node.color_ramp
        ramp.interpolation = interpolation
        while len(ramp.elements) < len(stops):
            ramp.elements.new(0.5)
        for element, (position, colour) in zip(ramp.elements, stops, strict=True):
            element.position = position
            element.color = (*colour, 1.0)
        return node.outputs["Color"]

    def mix(self, factor: Socket, a: Socket, b: Socket, blend: str = "MIX") -> Socket:
        inputs = {"Factor_Float": factor, "A_Color": a, "B_Color": b}
        return self.add("ShaderNodeMix", inputs, data_type="RGBA", blend_type=blend).outputs[2]

    def clouds(self, vector: Socket, scale: float, detail: float, low: float, high: float) -> Socket:
        """A grey that wanders between ``low`` and ``high``: wear and stains to multiply a colour with."""
        return self.ramp(self.noise(vector, scale, detail), [(0.3, (low,) * 3), (0.7, (high,) * 3)])

    def bricks(
        self,
        vector: Socket,
        tones: tuple[Colour, Colour],
        mortar: Colour,
        size: tuple[Socket, Socket],
        joint: float,
        smooth: float = 0.1,
        offset: float = 0.5,
    ) -> Any:
        """Courses of bricks, tiles or boards in X and Y, each of a tone between two.

        ``size``: width and height with the joint; ``joint``: its width, both in metres; ``offset``: how far a
        course is moved along the next, as a share of the width. The node, whose outputs are ``Color`` and
        ``Factor`` (1: mortar).
        """
        inputs = {
            "Vector": vector,
            "Color1": tones[0],
            "Color2": tones[1],
            "Mortar": mortar,
            "Scale": 1.0,
            "Mortar Size": joint,
            "Mortar Smooth": smooth,
            "Brick Width": size[0],
            "Row Height": size[1],
        }
        return self.add("ShaderNodeTexBrick", inputs, offset=offset)

    def bumps(self, height: Socket, distance: float, strength: float = 0.6) -> Socket:
        """The normal of a surface that rises by up to ``distance`` metres where ``height`` is 1."""
        inputs = {"Height": height, "Distance": distance, "Strength": strength}
        return self.add("ShaderNodeBump", inputs).outputs["Normal"]

    def math(self, operation: str, a: Socket, b: Socket) -> Socket:
        return self.add("ShaderNodeMath", {"Value": a, "Value_001": b}, operation=operation).outputs[0]

    def finish(self, shader: Socket) -> None:
        self.add("ShaderNodeOutputMaterial", {"Surface": shader})

    def principled(
        self,
        colour: Socket,
        roughness: Socket = 0.6,
        *,
        specular: float = 0.3,
        metallic: Socket = 0.0,
        sheen: float = 0.0,
        **more: Socket,
    ) -> Socket:
        """A surface that scatters and shines; ``more``: further inputs of the node, such as ``Normal``."""
        inputs = {
            "Base Color": colour,
            "Roughness": roughness,
            "Metallic": metallic,
            "Specular IOR Level": specular,
            "Sheen Weight": sheen,
            **more,
        }
        return self.add("ShaderNodeBsdfPrincipled", inputs).outputs["BSDF"]

    def blend(self, share: Socket, first: Socket, second: Socket) -> Socket:
        """The shader ``first`` where ``share`` is 0, ``second`` where it is 1."""
        inputs = {"Fac": share, "Shader": first, "Shader_001": second}
        return self.add("ShaderNodeMixShader", inputs).outputs[0]

    def thin_cloth(self, colour: Socket, share: float) -> Socket:
        """Cloth that throws light back and lets through ``share`` of it."""
        back = self.add("ShaderNodeBsdfDiffuse", {"Color": colour}).outputs[0]
        through = self.add("ShaderNodeBsdfTranslucent", {"Color": colour}).outputs[0]
        return self.blend(share, back, through)

    def surface(self, colour: Socket, roughness: Socket = 0.6, **more: Socket) -> None:
        """End in ``principled``."""
        self.finish(self.principled(colour, roughness, **more))


def geometry_nodes(name: str) -> Graph:
    """A new tree for a modifier: given a geometry it returns one. Both its ends are still to be added."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    assert tree.interface is not None
    new_socket: Any = tree.interface.new_socket
    for way in ("INPUT", "OUTPUT"):
        new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    return Graph(tree)


def dimmed(colour: Colour, factor: float) -> Colour:
    """The same colour, ``factor`` times as bright."""
    red, green, blue = colour
    return red * factor, green * factor, blue * factor


def unsampled(material: bpy.types.Material) -> None:
    """Let Cycles send no light rays to what shines by this material: a lamp within it gives its light."""
    cycles(material).emission_sampling = "NONE"


def begin(name: str) -> tuple[bpy.types.Material, Graph]:
    """A new material and its graph, which is empty."""
    material = bpy.data.materials.new(name)
    assert material.node_tree is not None
    return material, Graph(material.node_tree)
