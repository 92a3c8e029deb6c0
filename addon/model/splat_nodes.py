# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry nodes that draw the Gaussians: each point becomes an instance of a proxy that ``material`` shades.

* An ellipsoid, right from any direction and in reflections, or
* with *Camera splats*, a card at the centre's depth that faces the active camera and carries the
  Gaussian's projection. Rays then meet the Gaussians sorted by the depth of their centres and with the
  footprint that the trainer's rasteriser (EWA, backend/rasterize/contract.py) gave them, so the active
  camera's picture is the trainer's own.
"""

import math
from dataclasses import dataclass, fields

from ...bridge.splatting import ALPHA_MIN, JACOBIAN_MARGIN, LOW_PASS, NEAR_PLANE
from .attributes import ROTATION, SCALE
from .cleaning import EVEN
from .material import splat_material
from .node_builder import Field, GeometryBuilder
from .nodes import CAMERA_SPLATS, IMAGE_WIDTH

#: An icosahedron of this radius encloses the unit sphere (1 / 0.7947, its insphere's radius).
ICOSPHERE_RADIUS = 1.26


@dataclass(frozen=True, eq=False)
class CameraFields:
    """The active camera's fields, in the object's space."""

    exists: Field
    is_orthographic: Field
    #: From the camera to the point: metres, and of unit length.
    offset: Field
    direction: Field
    #: Unit axes of the camera; it looks along −back.
    right: Field
    up: Field
    back: Field
    #: Distance along the optical axis.
    depth: Field
    #: ½ width and ½ height of the picture at distance 1 (orthographic: anywhere).
    half_width: Field
    half_height: Field
    #: Of the projection: the inverse of those, and what moves the picture (perspective; orthographic).
    slope_x: Field
    slope_y: Field
    shift_x: Field
    shift_y: Field
    move_x: Field
    move_y: Field
    #: Length of a metre of the scene: 1 / the object's scale, whatever the camera's own scale is.
    unit: Field
    #: Whether the object has one scale. Where not, the camera's axes are not at right angles in its space.
    is_even: Field
    #: Nearest depth that is drawn.
    near: Field

    def __post_init__(self) -> None:
        for each in fields(self):  # what node groups call them
            getattr(self, each.name).name = each.name.replace("_", " ")


def camera_fields(make: GeometryBuilder, position: Field) -> CameraFields:
    """The nodes that find the active camera, for points at ``position``."""
    with make.frame("Active camera, in the object's space"):
        active = make.field("GeometryNodeInputActiveCamera")
        info = make.node("GeometryNodeObjectInfo", active, transform_space="RELATIVE")
        transform = make.output(info, "Transform")
        lens = make.node("GeometryNodeCameraInfo", active)
        is_orthographic = make.output(lens, "Is Orthographic")
        offset = position - make.output(info, "Location")

        def axis(*components: float) -> Field:
            return make.field("FunctionNodeTransformDirection", components, transform)

        in_scene = make.node("GeometryNodeObjectInfo", active, transform_space="ORIGINAL")
        own_scale = make.field(
            "FunctionNodeTransformDirection", (1.0, 0.0, 0.0), make.output(in_scene, "Transform")
        )
        right, up, back = axis(1.0, 0.0, 0.0), axis(0.0, 1.0, 0.0), axis(0.0, 0.0, 1.0)
        unit_back = make.vector("NORMALIZE", back, label="back")
        direction = make.vector("NORMALIZE", offset)
        matrix = make.node("FunctionNodeSeparateMatrix", make.output(lens, "Projection Matrix"))
        unit = make.vector("LENGTH", right) / make.vector("LENGTH", own_scale)
        return CameraFields(
            # A missing camera has a focal length of 0.
            exists=make.math("GREATER_THAN", make.output(lens, "Focal Length"), 0.0, label="exists"),
            is_orthographic=is_orthographic,
            offset=offset,
            direction=make.switch(is_orthographic, direction, unit_back * -1.0, "VECTOR"),
            right=make.vector("NORMALIZE", right, label="right"),
            up=make.vector("NORMALIZE", up, label="up"),
            back=unit_back,
            depth=make.dot(offset, unit_back * -1.0),
            half_width=1.0 / make.output(matrix, "Column 1 Row 1"),
            half_height=1.0 / make.output(matrix, "Column 2 Row 2"),
            slope_x=make.output(matrix, "Column 1 Row 1"),
            slope_y=make.output(matrix, "Column 2 Row 2"),
            shift_x=make.output(matrix, "Column 3 Row 1"),
            shift_y=make.output(matrix, "Column 3 Row 2"),
            move_x=make.output(matrix, "Column 4 Row 1"),
            move_y=make.output(matrix, "Column 4 Row 2"),
            unit=unit,
            is_even=_is_even(make),
            near=unit * NEAR_PLANE,
        )


def _is_even(make: GeometryBuilder) -> Field:
    this = make.node(
        "GeometryNodeObjectInfo", make.field("GeometryNodeSelfObject"), transform_space="ORIGINAL"
    )
    parts = make.node("ShaderNodeSeparateXYZ", make.output(this, "Scale"))
    x, y, z = (make.math("ABSOLUTE", make.output(parts, axis)) for axis in "XYZ")
    lowest = make.math("MINIMUM", make.math("MINIMUM", x, y), z)
    highest = make.math("MAXIMUM", make.math("MAXIMUM", x, y), z)
    return make.field(
        "FunctionNodeCompare", highest, lowest * EVEN, data_type="FLOAT", operation="LESS_EQUAL"
    )


def draw(
    make: GeometryBuilder, geometry: Field, opacity: Field, camera: CameraFields, inputs: dict[str, Field]
) -> None:
    """Put out instances: a proxy with its material on every point. ``inputs``: the tree's, by labels."""
    splats = inputs[CAMERA_SPLATS]
    with make.frame("Size of a pixel at the point"):
        pixel = camera.half_width * 2.0 / make.math("MAXIMUM", inputs[IMAGE_WIDTH], 1.0)
        pixel = pixel * make.switch(camera.is_orthographic, camera.depth, camera.unit)
        wanted = make.math("GREATER_THAN", inputs[IMAGE_WIDTH], 0.0)
        widening = (pixel * pixel * (wanted * LOW_PASS) * camera.exists).called("widening")
    with make.frame("Reach: standard deviations to alpha = 1/255"):
        reach = make.math("SQRT", make.math("LOGARITHM", opacity * (1.0 / ALPHA_MIN), math.e) * 2.0)
        visible = make.math("GREATER_THAN", opacity, ALPHA_MIN)
    rotation = make.named(ROTATION)
    scale = make.named(SCALE)
    with make.frame("Ellipsoid: σ² + widening"):
        ellipsoid_scale = make.vector("POWER", scale * scale + widening, 0.5) * reach
        icosphere = make.field("GeometryNodeMeshIcoSphere", ICOSPHERE_RADIUS, 1)
        ellipsoid = make.field("GeometryNodeSetMaterial", icosphere, None, splat_material("ellipsoid"))
    with make.group("PhysHDR card"):
        card_rotation, card_scale = _card(make, camera, rotation, scale, widening)
    with make.frame("Camera splat: a card"):
        card_scale = card_scale * reach
        card = make.field("GeometryNodeMeshCircle", 8, 1.0823922, fill_type="NGON")
        card = make.field("GeometryNodeSetMaterial", card, None, splat_material("splat"))
        in_front = make.math("GREATER_THAN", camera.depth, camera.near)
    with make.frame("Instances"):
        usable = make.field("FunctionNodeBooleanMath", splats, camera.exists, operation="AND")
        # A card of a stretched object would be sheared with it.
        usable = make.field("FunctionNodeBooleanMath", usable, camera.is_even, operation="AND")
        visible = visible * make.switch(usable, 1.0, in_front)
        instances = make.field(
            "GeometryNodeInstanceOnPoints",
            geometry,
            visible,
            make.switch(usable, ellipsoid, card, "GEOMETRY"),
            None,
            None,
            make.switch(usable, rotation, card_rotation, "ROTATION"),
            make.switch(usable, ellipsoid_scale, card_scale, "VECTOR"),
        )
        make.node("NodeGroupOutput", instances)


def _card(
    make: GeometryBuilder, camera: CameraFields, rotation: Field, scale: Field, widening: Field
) -> tuple[Field, Field]:
    """Rotation of a card facing the camera along the splat's axes, and its standard deviations.

    The EWA projection, in the plane through the centre at its depth: with A = S Rᵀ J (columns a, b),
    the covariance there is AᵀA plus the widening; J's columns are right − tan_x forward and
    up − tan_y forward.
    """
    with make.frame("Camera splat: covariance in the plane at its depth"):
        perspective = 1.0 - camera.is_orthographic
        inverse_rotation = make.field("FunctionNodeInvertRotation", rotation)

        def projected(axis: Field, half: Field) -> Field:
            limit = half * (1.0 + JACOBIAN_MARGIN)
            tangent = make.dot(camera.offset, axis) / make.math("MAXIMUM", camera.depth, camera.near)
            tangent = make.math("MAXIMUM", make.math("MINIMUM", tangent, limit), limit * -1.0)
            column = axis + camera.back * (tangent * perspective)
            return make.field("FunctionNodeRotateVector", column, inverse_rotation) * scale

        a = projected(camera.right, camera.half_width)
        b = projected(camera.up, camera.half_height)
        xx, xy, yy = make.dot(a, a), make.dot(a, b), make.dot(b, b)
        cross = make.vector("CROSS_PRODUCT", a, b)
    with make.frame("Camera splat: its axes"):
        # |a × b|² is det(AᵀA) without the cancellation of xx yy − xy².
        determinant = make.dot(cross, cross) + widening * (xx + yy) + widening * widening
        half_difference = (xx - yy) * 0.5
        radius = make.math("SQRT", half_difference * half_difference + xy * xy)
        largest = (xx + yy) * 0.5 + radius + widening
        smallest = determinant / largest
        deviations = make.field(
            "ShaderNodeCombineXYZ", make.math("SQRT", largest), make.math("SQRT", smallest), 1e-3
        )
        angle = make.math("ARCTAN2", xy, half_difference) * 0.5
        main_axis = camera.right * make.math("COSINE", angle) + camera.up * make.math("SINE", angle)
        turn = make.field(
            "FunctionNodeAxesToRotation",
            camera.back,
            main_axis,
            primary_axis="Z",
            secondary_axis="X",
        )
    return turn.called("rotation"), deviations.called("standard deviations")
