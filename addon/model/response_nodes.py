# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera's learned response as nodes: of each Gaussian (geometry nodes), or of a picture (the compositor).

    code(L) = response(ln(L · 2^EV)), a curve for each channel

and the code is decoded from sRGB, so that Blender's *Standard* view, which encodes, shows it.
"""

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ...bridge import srgb
from ..blender import marked_when_whole
from .node_builder import Field, GeometryBuilder, NodeBuilder
from .nodes import EXPOSURE
from .tone_curve import ToneCurve

#: Blender evaluates a curve of a node by linear interpolation in a table of so many steps.
CURVE_STEPS = 256
#: No light has no logarithm: what is darker than this is as dark.
DARKEST = 1e-30
#: Alpha that a colour is divided by, at the least.
THINNEST = 1e-6
#: The inputs of the compositor's group, beside *Exposure (EV)*.
IMAGE, OVER_BLACK = "Image", "Over Black"
#: Custom property of the compositor's groups: the version of their recipe, and the response.
MARK = "physhdr_response_tree"
_RECIPE = 1
#: What makes a colour of three numbers, and three numbers of it, in a tree of either kind.
_COLOURS = {
    "GeometryNodeTree": ("FunctionNodeCombineColor", "FunctionNodeSeparateColor"),
    "CompositorNodeTree": ("CompositorNodeCombineColor", "CompositorNodeSeparateColor"),
}


class CompositorBuilder(NodeBuilder):
    """Adds compositing nodes to a tree."""

    def switch(self, condition: Field, off: Field | float, on: Field | float) -> Field:
        """One of two numbers for each pixel: the compositor's own switch is one for all."""
        return self.field("ShaderNodeMix", condition, off, on)


def learned_response(
    make: GeometryBuilder | CompositorBuilder, exposed: Sequence[Field], curve: ToneCurve
) -> list[Field]:
    """The response's codes at exposed radiance (red, green, blue), decoded from sRGB."""
    low, high = float(curve.log_exposure[0]), float(curve.log_exposure[-1])
    combine, separate = _COLOURS[make.tree.bl_idname]
    with make.frame("Learned response over ln(radiance · 2^EV)"):
        places = []
        for channel in exposed:
            positive = make.math("MAXIMUM", channel, DARKEST)
            places.append((make.math("LOGARITHM", positive, math.e) - low) / (high - low))
        # A colour of our own making: this node and its sockets only carry numbers.
        place = make.field(combine, *places)
        node = make.node("ShaderNodeRGBCurve", 1.0, place, label="response")
        assert isinstance(node, bpy.types.ShaderNodeRGBCurve) and node.mapping is not None
        set_curves(node.mapping, curve)
        parts = make.node(separate, make.output(node, "Color"))
    with make.frame("Decode sRGB"):
        decoded = []
        for channel in ("Red", "Green", "Blue"):
            code = make.output(parts, channel)
            power = make.math("POWER", (code + srgb.OFFSET) * (1.0 / srgb.SCALE), srgb.POWER)
            bright = make.math("GREATER_THAN", code, srgb.CODE_KNEE)
            decoded.append(make.switch(bright, code * (1.0 / srgb.SLOPE), power))
        return decoded


def set_curves(mapping: bpy.types.CurveMapping, curve: ToneCurve) -> None:
    """Make a colour curve node's three curves the response, 0 … 1 over its range, flat beyond.

    A point at every entry of the table that Blender makes of a curve, so that nothing is rounded twice.
    """
    mapping.extend = "HORIZONTAL"
    places = np.linspace(0.0, 1.0, CURVE_STEPS + 1)
    low, high = float(curve.log_exposure[0]), float(curve.log_exposure[-1])
    for channel in range(3):
        values = np.interp(low + places * (high - low), curve.log_exposure, curve.values[:, channel])
        points = mapping.curves[channel].points
        points[0].location, points[-1].location = (0.0, float(values[0])), (1.0, float(values[-1]))
        for place, value in zip(places[1:-1], values[1:-1], strict=True):
            points.new(float(place), float(value))
        for point in points:
            point.handle_type = "VECTOR"
    mapping.update()


def response_mark(curve: ToneCurve) -> str:
    """What marks the compositor's group of a response."""
    return f"{_RECIPE} {curve.digest}"


def response_tree(curve: ToneCurve, name: str) -> bpy.types.NodeTree:
    """The file's compositing group of a response, made when it is not there yet; ``name``: whose it is.

    In: a scene-linear picture with premultiplied alpha. Out: the scene-linear picture that *Standard* shows
    as the response's codes.
    """
    for each in bpy.data.node_groups:
        if each.get(MARK) == response_mark(curve) and each.library is None:
            return each
    tree = bpy.data.node_groups.new(f"PhysHDR Response of {name}", "CompositorNodeTree")
    with marked_when_whole(tree, MARK, response_mark(curve)):
        _declare(tree)
        _build(CompositorBuilder(tree), curve)
    return tree


def _declare(tree: bpy.types.NodeTree) -> None:
    interface: Any = tree.interface  # which types a socket may have is known only to Blender
    interface.new_socket(IMAGE, in_out="OUTPUT", socket_type="NodeSocketColor")
    picture = interface.new_socket(IMAGE, in_out="INPUT", socket_type="NodeSocketColor")
    picture.description = "Scene-linear light, as rendered"
    exposure = interface.new_socket(EXPOSURE, in_out="INPUT", socket_type="NodeSocketFloat")
    exposure.description = "The light is multiplied by 2 to this power before the response"
    exposure.min_value, exposure.max_value = -30.0, 30.0
    black = interface.new_socket(OVER_BLACK, in_out="INPUT", socket_type="NodeSocketBool")
    black.description = (
        "Black is behind what is transparent, as in the model's own pictures, and alpha is 1. Off: alpha "
        "stays, and the colour of what is there is developed, to be laid over other developed pictures"
    )


def _build(make: CompositorBuilder, curve: ToneCurve) -> None:
    with make.frame("Radiance · 2^EV, without alpha"):
        inputs = make.node("NodeGroupInput")
        parts = make.node("CompositorNodeSeparateColor", make.output(inputs, IMAGE))
        alpha, black = make.output(parts, "Alpha"), make.output(inputs, OVER_BLACK)
        covered = make.switch(black, make.math("MAXIMUM", alpha, THINNEST), 1.0)
        gain = make.math("POWER", 2.0, make.output(inputs, EXPOSURE)) / covered
        exposed = [make.output(parts, name) * gain for name in ("Red", "Green", "Blue")]
    developed = learned_response(make, exposed, curve)
    with make.frame("With alpha again"):
        kept = make.switch(black, alpha, 1.0)
        colour = make.field("CompositorNodeCombineColor", *(each * kept for each in developed), kept)
        make.node("NodeGroupOutput", colour)
    make.arrange()
