# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry nodes that leave out what people hid of a model: ``cleaning.kept``, to the last bit, as nodes.

What is left out is taken away before anything is computed of it. Every limit has a switch whose condition is
one value for all points, and Blender computes no more than the side that it takes: what is off costs nothing.
"""

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ...bridge.splatting import JACOBIAN_MARGIN
from . import nodes
from .attributes import CAMERA_DISTANCE, CONFIDENCE, Attribute
from .cleaning import ALL, REACH
from .node_builder import Field, GeometryBuilder
from .splat_nodes import CameraFields


@dataclass(frozen=True)
class Input:
    """An input of the tree: its label, kind of socket, description and what else the socket is given."""

    name: str
    kind: str
    description: str
    properties: Mapping[str, Any] = field(default_factory=dict)


_LENGTH = {"subtype": "DISTANCE", "min_value": 0.0}
_SHARE = {"subtype": "FACTOR", "min_value": 0.0, "max_value": 1.0}
#: What hides from every side …
_HIDING = (
    Input(nodes.CROP, "Bool", "Hide what is outside of the crop box"),
    Input(
        nodes.CROP_BOX,
        "Object",
        "An object whose cube from -1 to 1 along its own axes is the box: an empty shown as a cube of size "
        "1, or Blender's cube. Move, turn and scale it",
    ),
    Input(nodes.KEEP_OUTSIDE, "Bool", "Hide what is in the box instead"),
    Input(
        nodes.LARGEST_SIZE,
        "Float",
        "Hide Gaussians whose largest standard deviation is above this. 0: no limit",
        _LENGTH,
    ),
    Input(nodes.SMALLEST_OPACITY, "Float", "Hide Gaussians that are fainter than this", _SHARE),
    Input(
        nodes.LARGEST_ELONGATION,
        "Float",
        "Hide needles: Gaussians that are so many times longer than wide. 0: no limit",
        {"min_value": 0.0},
    ),
    Input(
        nodes.LARGEST_DISTANCE,
        "Float",
        "Hide what is farther than this from the object below, or from the model's origin. 0: no limit",
        _LENGTH,
    ),
    Input(nodes.DISTANCE_FROM, "Object", "Where the largest distance is measured from: an empty, say"),
    Input(
        nodes.CLEAR_OF_PHOTOS,
        "Float",
        "Hide what is nearer than this to a camera of the data set: floaters. It counts once the distances "
        "were measured",
        _LENGTH,
    ),
)
#: … what the camera that renders decides …
_CULLING = (
    Input(
        nodes.CLEAR_OF_CAMERA,
        "Float",
        "Leave out what is nearer than this to the camera that renders",
        _LENGTH,
    ),
    Input(
        nodes.FARTHEST,
        "Float",
        "Leave out what is farther than this from the camera that renders. 0: no limit",
        _LENGTH,
    ),
    Input(
        nodes.ONLY_IN_VIEW,
        "Bool",
        "Leave out what the camera that renders does not see. Mirrors and shadows then lack it, too",
    ),
    Input(
        nodes.VIEW_MARGIN,
        "Float",
        "How far beyond the picture's edge it still counts as seen, in halves of the picture",
        {"default_value": ALL.view_margin, "min_value": 0.0},
    ),
)
#: … and how finely, where a model has directions.
_DIRECTIONS = Input(
    nodes.SH_DEGREE,
    "Int",
    "How finely the radiance depends on the direction, at most: 0 not at all, 3 as trained. Less is faster",
    {"default_value": 3, "min_value": 0, "max_value": 3},
)
#: Hides from every side. Made last: the inputs of trees before it keep their places, and with them their
#: keyframes.
_CONFIDENCE = Input(
    nodes.SMALLEST_CONFIDENCE,
    "Float",
    "Hide Gaussians whose radiance is less likely than this to be within a tenth of a stop of the true "
    "one: what the photos clip, starve or hardly see. Not every model has it",
    _SHARE,
)


def declare_cleaning(interface: Any, has_directions: bool) -> None:
    """The inputs, in two panels after those that are there. ``has_directions``: SH beyond degree 0."""

    def panel(name: str, description: str) -> Any:
        return interface.new_panel(name, description=description, default_closed=True)

    def declare(parent: Any, wanted: Iterable[Input]) -> None:
        for each in wanted:
            socket = interface.new_socket(
                each.name, in_out="INPUT", socket_type=f"NodeSocket{each.kind}", parent=parent
            )
            socket.description = each.description
            for key, value in each.properties.items():
                setattr(socket, key, value)

    text = "What is hidden from every side. Lengths are those of the model's file"
    inside = panel(nodes.CLEANING_PANEL, text)
    declare(inside, _HIDING)
    renders = panel(nodes.CULLING_PANEL, "What is left out of the picture of the camera that renders")
    declare(renders, (*_CULLING, _DIRECTIONS) if has_directions else _CULLING)
    declare(inside, [_CONFIDENCE])


def clean(
    make: GeometryBuilder,
    geometry: Field,
    position: Field,
    scale: Field,
    opacity: Field,
    camera: CameraFields,
    inputs: dict[str, Field],
) -> Field:
    """The points that are kept. ``inputs``: the tree's, by labels."""
    limits = _Limits(make, inputs)
    with make.frame("Largest and middle standard deviation"):
        x, y, z = limits.parts(scale)
        smaller, larger = make.math("MINIMUM", x, y), make.math("MAXIMUM", x, y)
        largest = make.math("MAXIMUM", larger, z)
        middle = make.math("MAXIMUM", smaller, make.math("MINIMUM", larger, z))
    with make.frame("Crop box: within ±1 along each of its axes"):
        limits.crop(position)
    with make.frame("Size, opacity, elongation"):
        limits.at_most(nodes.LARGEST_SIZE, largest)
        limits.at_least(nodes.SMALLEST_OPACITY, opacity)
        on = limits.above_0(nodes.LARGEST_ELONGATION)
        limits.add(on, limits.compare("LESS_EQUAL", largest, middle * inputs[nodes.LARGEST_ELONGATION]))
    with make.frame("Distance from an object"):
        info = make.node("GeometryNodeObjectInfo", inputs[nodes.DISTANCE_FROM], transform_space="RELATIVE")
        offset = position - make.output(info, "Location")
        limits.at_most(nodes.LARGEST_DISTANCE, make.vector("LENGTH", offset))
    with make.frame("Distance from the data set's cameras, where it was measured"):
        limits.known(nodes.CLEAR_OF_PHOTOS, CAMERA_DISTANCE)
    with make.frame("Confidence, where the model knows it"):
        limits.known(nodes.SMALLEST_CONFIDENCE, CONFIDENCE)
    with make.frame("Distance from the camera that renders"):
        distance = make.vector("LENGTH", camera.offset)
        limits.at_least(nodes.CLEAR_OF_CAMERA, distance, also=camera.exists)
        limits.at_most(nodes.FARTHEST, distance, also=camera.exists)
    with make.frame("What that camera sees: balls against its four sides"):
        limits.in_view(camera, largest * REACH)
    with make.frame("Keep"):
        wanted = functools.reduce(lambda a, b: limits.both("OR", a, b), limits.on)
        keep = functools.reduce(lambda a, b: limits.both("AND", a, b), limits.keep)
        left = make.field("GeometryNodeSeparateGeometry", geometry, keep, domain="POINT")
        return make.switch(wanted, geometry, left, "GEOMETRY").called("geometry")


class _Limits:
    """The limits one by one: whether each is on, one value for all points, and whom it keeps."""

    def __init__(self, make: GeometryBuilder, inputs: dict[str, Field]) -> None:
        self.make = make
        self.inputs = inputs
        self.on: list[Field] = []
        self.keep: list[Field] = []

    def add(self, on: Field, keep: Field) -> None:
        self.on.append(on)
        self.keep.append(self.make.switch(on, True, keep, "BOOLEAN"))

    def compare(self, operation: str, a: Field, b: Any) -> Field:
        return self.make.field("FunctionNodeCompare", a, b, data_type="FLOAT", operation=operation)

    def both(self, operation: str, a: Field, b: Field) -> Field:
        return self.make.field("FunctionNodeBooleanMath", a, b, operation=operation)

    def inverted(self, a: Field) -> Field:
        return self.make.field("FunctionNodeBooleanMath", a, operation="NOT")

    def above_0(self, name: str, also: Field | None = None) -> Field:
        on = self.compare("GREATER_THAN", self.inputs[name], 0.0)
        return on if also is None else self.both("AND", on, also)

    def at_most(self, name: str, value: Field, also: Field | None = None) -> None:
        self.add(self.above_0(name, also), self.compare("LESS_EQUAL", value, self.inputs[name]))

    def at_least(self, name: str, value: Field, also: Field | None = None) -> None:
        self.add(self.above_0(name, also), self.compare("GREATER_EQUAL", value, self.inputs[name]))

    def parts(self, vector: Field) -> list[Field]:
        parts = self.make.node("ShaderNodeSeparateXYZ", vector)
        return [self.make.output(parts, axis) for axis in "XYZ"]

    def crop(self, position: Field) -> None:
        make = self.make
        info = make.node("GeometryNodeObjectInfo", self.inputs[nodes.CROP_BOX], transform_space="RELATIVE")
        inverse = make.node("FunctionNodeInvertMatrix", make.output(info, "Transform"))
        # No object has a scale of 0; a flat box has no inside.
        size = make.vector("LENGTH", make.output(info, "Scale"))
        is_box = self.both("AND", self.compare("GREATER_THAN", size, 0.0), make.output(inverse, "Invertible"))
        on = self.both("AND", self.inputs[nodes.CROP], is_box)
        place = make.field("FunctionNodeTransformPoint", position, make.output(inverse, "Matrix"))
        within = [self.compare("LESS_EQUAL", make.math("ABSOLUTE", part), 1.0) for part in self.parts(place)]
        inside = functools.reduce(lambda a, b: self.both("AND", a, b), within)
        self.add(on, self.both("XOR", inside, self.inputs[nodes.KEEP_OUTSIDE]))

    def known(self, name: str, attribute: Attribute) -> None:
        """The input ``name`` is the least of an attribute; where there is none it hides nothing."""
        make = self.make
        node = make.node(
            "GeometryNodeInputNamedAttribute",
            attribute.name,
            data_type=attribute.type,
            label=attribute.name,
        )
        enough = self.compare("GREATER_EQUAL", make.output(node, "Attribute"), self.inputs[name])
        self.add(self.above_0(name), self.both("OR", enough, self.inverted(make.output(node, "Exists"))))

    def in_view(self, camera: CameraFields, radius: Field) -> None:
        """A ball's reach toward a slanted side is bounded by the triangle inequality: it errs by keeping."""
        make = self.make
        on = self.both("AND", self.inputs[nodes.ONLY_IN_VIEW], camera.exists)
        on = self.both("AND", on, camera.is_even)
        widened = self.inputs[nodes.VIEW_MARGIN] + 1.0
        keep = self.compare("GREATER_EQUAL", camera.depth + radius, camera.near)
        sides = (
            (camera.right, camera.slope_x, camera.shift_x, camera.move_x),
            (camera.up, camera.slope_y, camera.shift_y, camera.move_y),
        )
        for axis, slope, shift, move in sides:
            across = make.dot(camera.offset, axis) * slope
            slant = slope + (widened + make.math("ABSOLUTE", shift) + JACOBIAN_MARGIN)
            seen = self.compare(
                "LESS_EQUAL",
                make.math("ABSOLUTE", across - camera.depth * shift),
                camera.depth * widened + radius * slant,
            )
            # An orthographic picture is so many of the scene's metres wide, wherever something is.
            per_length = slope / camera.unit
            along = make.dot(camera.offset, axis) * per_length
            straight = self.compare(
                "LESS_EQUAL", make.math("ABSOLUTE", along + move), widened + radius * per_length
            )
            keep = self.both("AND", keep, make.switch(camera.is_orthographic, seen, straight, "BOOLEAN"))
        self.add(on, keep)
