# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry nodes that light and draw the Gaussians, built by code, with no backend running.

For each point: ω, the direction from the active camera in the object's space; radiance at level 1,
exp(Σ_k sh_k Y_k(ω)); relit by *Lighting level*, the first light's, and *Level of …*, one for each further
light; times 2^*Exposure (EV)*; with *Learned tone mapper*, the scene-linear value that the *Standard* view
shows as the learned response's code. Then each point becomes an instance of a proxy mesh that ``material``
shades:

* an ellipsoid, right from any direction and in reflections, or
* with *Camera splats*, a card at the centre's depth that faces the active camera and carries the
  Gaussian's projection. Rays then meet the Gaussians sorted by the depth of their centres and with the
  footprint that the trainer's rasteriser (EWA, backend/rasterize/contract.py) gave them, so the active
  camera's picture is the trainer's own.
"""

import functools
import hashlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..bridge import srgb
from ..bridge.lights import AMBIENT
from ..bridge.model_file import Model
from ..bridge.spherical_harmonics import C0, C1, C2, C3, coefficient_count
from ..bridge.splatting import ALPHA_MIN, JACOBIAN_MARGIN, LOW_PASS, NEAR_PLANE
from .material import RADIANCE_ATTRIBUTE, splat_material
from .node_builder import Field, NodeBuilder
from .point_cloud import share_attribute

MODIFIER_NAME = "PhysHDR"

EXPOSURE = "Exposure (EV)"
LIGHTING_LEVEL = "Lighting level"
TONE_MAPPER = "Learned tone mapper"
VIEW_DEPENDENT = "View dependent"
CAMERA_SPLATS = "Camera splats"
IMAGE_WIDTH = "Image width"

#: What no light turns, and the first light's part at level 1; the others' are ``light_attribute(k)``.
FIXED_ATTRIBUTE = "physhdr:fixed"
AMBIENT_ATTRIBUTE = "physhdr:ambient"

#: An icosahedron of this radius encloses the unit sphere (1 / 0.7947, its insphere's radius).
ICOSPHERE_RADIUS = 1.26

#: Blender evaluates a curve of a node by linear interpolation in a table of so many steps.
CURVE_STEPS = 256

#: Custom property that marks our trees: what they were built for, and the version of this recipe.
MARK = "physhdr_tree"
_RECIPE = 3


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """A learned response: LDR values ``[M, 3]`` at rising ln(exposure × radiance) ``[M]``."""

    log_exposure: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, model: Model) -> "ToneCurve | None":
        if model.tone_curve is None or model.tone_curve_log_exposure is None:
            return None
        return cls(model.tone_curve_log_exposure, model.tone_curve)

    @property
    def digest(self) -> str:
        """The same for the same response: models of one camera share a tree."""
        content = np.column_stack([self.log_exposure, self.values]).astype("<f4").tobytes()
        return hashlib.sha256(content).hexdigest()[:12]


def level_input(lights: Sequence[str], index: int) -> str:
    """The label of a light's level: the first is *Lighting level*, whatever the light is called."""
    return LIGHTING_LEVEL if index == 0 else f"Level of {lights[index]}"


def light_attribute(index: int) -> str:
    """Where the tree stores a light's part of the radiance at level 1."""
    return AMBIENT_ATTRIBUTE if index == 0 else f"physhdr:light_{index}"


def add_modifier(target: bpy.types.Object, model: Model) -> bpy.types.Modifier:
    """Give a point cloud object made from ``model`` the modifier that lights and draws it."""
    modifier = target.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = radiance_tree(model.sh_degree, model.levels, ToneCurve.of(model), model.lights)
    return modifier


def find_modifier(target: bpy.types.Object) -> bpy.types.Modifier | None:
    """The object's modifier with one of our trees, of any version and whatever it is called now."""
    for modifier in target.modifiers:
        if modifier.type == "NODES" and modifier.node_group and MARK in modifier.node_group:
            return modifier
    return None


def set_input(modifier: bpy.types.Modifier, name: str, value: Any) -> None:
    """Set an input of the modifier by its label, e.g. ``set_input(modifier, EXPOSURE, 1.5)``."""
    getattr(modifier.properties.inputs, input_identifier(modifier, name)).value = value
    modifier.id_data.update_tag()


def get_input(modifier: bpy.types.Modifier, name: str) -> Any:
    """The value of an input of the modifier by its label."""
    return getattr(modifier.properties.inputs, input_identifier(modifier, name)).value


def input_data_path(modifier: bpy.types.Modifier, name: str) -> str:
    """The RNA path of an input on the object, for keyframes and drivers."""
    identifier = input_identifier(modifier, name)
    return f'modifiers["{bpy.utils.escape_identifier(modifier.name)}"].properties.inputs.{identifier}.value'


def input_identifier(modifier: bpy.types.Modifier, name: str) -> str:
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name:
            return item.identifier
    raise KeyError(f"the modifier {modifier.name!r} has no input {name!r}")


def has_input(modifier: bpy.types.Modifier, name: str) -> bool:
    """Whether the modifier's tree has that input: older trees, or those without a response, lack some."""
    return any(
        item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name
        for item in modifier.node_group.interface.items_tree
    )


def radiance_tree(
    sh_degree: int,
    levels: tuple[float, ...] = (),
    curve: ToneCurve | None = None,
    lights: tuple[str, ...] = (AMBIENT,),
) -> bpy.types.NodeTree:
    """The file's node tree for models of that SH degree, made when it is not there yet.

    ``levels``: those of a baked-levels model; empty for the additive modulator. ``curve``: the learned
    response, part of the tree because no attribute can hold it: models with the same one share the tree.
    ``lights``: the model's lights; models with others have another tree, because it has an input for each.
    """
    response = curve.digest if curve else "none"
    mark = f"{_RECIPE} degree {sh_degree} levels {list(levels)} response {response} lights {list(lights)}"
    for tree in bpy.data.node_groups:
        if tree.get(MARK) == mark and tree.library is None:
            return tree
    kind = f"{len(levels)} levels" if levels else "additive"
    if len(lights) > 1:
        kind += f", {len(lights)} lights"
    tree = bpy.data.node_groups.new(f"PhysHDR radiance (degree {sh_degree}, {kind})", "GeometryNodeTree")
    tree[MARK] = mark
    tree.is_modifier = True
    _declare_interface(tree, curve is not None, lights)
    _Assembly(tree).build(sh_degree, levels, curve, lights)
    return tree


def level_description(lights: Sequence[str], index: int) -> str:
    """The tooltip of a light's level."""
    name = "the ambient light (sky and fill)" if lights[index] == AMBIENT else f"the light {lights[index]!r}"
    others = "Lamps stay" if lights[0] == AMBIENT and len(lights) == 1 else "Other lights stay"
    return f"Strength of {name}: 1 as captured, 0 off. {others} as they are"


def _declare_interface(tree: bpy.types.NodeTree, has_curve: bool, lights: tuple[str, ...]) -> None:
    def declare(name: str, kind: str, description: str = "", **properties: Any) -> None:
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        socket.description = description
        for key, value in properties.items():
            setattr(socket, key, value)

    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    declare("Geometry", "Geometry")
    declare(EXPOSURE, "Float", "Radiance is multiplied by 2 to this power", min_value=-30.0, max_value=30.0)
    for index in range(len(lights)):
        told = level_description(lights, index)
        declare(level_input(lights, index), "Float", told, default_value=1.0, min_value=0.0)
    if has_curve:
        declare(
            TONE_MAPPER,
            "Bool",
            "Show what the camera that took the pictures would have recorded in 2^EV seconds, in Blender's "
            "Standard view. Off: scene-linear radiance",
        )
    declare(
        VIEW_DEPENDENT,
        "Bool",
        "Radiance depends on the direction from the active camera. Off: the same from everywhere",
        default_value=True,
    )
    declare(
        CAMERA_SPLATS,
        "Bool",
        "Draw cards that face the active camera: its picture matches the trainer's. "
        "Off: ellipsoids, right from any side and in reflections",
    )
    declare(
        IMAGE_WIDTH,
        "Int",
        "Width in pixels of the active camera's picture, to widen small Gaussians to the pixels they were "
        "trained with. 0: do not widen",
        min_value=0,
    )


@dataclass(frozen=True, eq=False)
class _Camera:
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
    #: Length of the camera's unit vectors: 1 / the object's scale.
    unit: Field


class _Assembly:
    """Builds the tree, frame by frame, in the order in which it is read."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        self.make = NodeBuilder(tree)

    def build(
        self,
        sh_degree: int,
        levels: tuple[float, ...],
        curve: ToneCurve | None,
        lights: tuple[str, ...],
    ) -> None:
        make = self.make
        with make.frame("Model"):
            inputs = make.node("NodeGroupInput")
            self.inputs = {socket.name: Field(make, socket) for socket in inputs.outputs if socket.name}
            self.position = make.field("GeometryNodeInputPosition")
            self.opacity = make.field(
                "FunctionNodeSeparateColor", self.named("radiance:base", "FLOAT_COLOR"), output="Alpha"
            )
        self.camera = self._camera()
        log_radiance = self._log_radiance(sh_degree)
        geometry, radiance = self._relight(self.inputs["Geometry"], log_radiance, levels, lights)
        self._draw(self._expose(geometry, radiance, curve))
        make.arrange()

    def named(self, name: str, kind: str = "FLOAT_VECTOR") -> Field:
        return self.make.field("GeometryNodeInputNamedAttribute", name, data_type=kind, label=name)

    def store(self, geometry: Field, name: str, kind: str, value: Field) -> Field:
        return self.make.field(
            "GeometryNodeStoreNamedAttribute", geometry, None, name, value, data_type=kind, label=name
        )

    def switch(self, condition: Field, off: Any, on: Any, kind: str = "FLOAT") -> Field:
        return self.make.field("GeometryNodeSwitch", condition, off, on, input_type=kind)

    def _camera(self) -> _Camera:
        make = self.make
        with make.frame("Active camera, in the object's space"):
            active = make.field("GeometryNodeInputActiveCamera")
            info = make.node("GeometryNodeObjectInfo", active, transform_space="RELATIVE")
            transform = make.output(info, "Transform")
            lens = make.node("GeometryNodeCameraInfo", active)
            is_orthographic = make.output(lens, "Is Orthographic")
            offset = self.position - make.output(info, "Location")

            def axis(*components: float) -> Field:
                return make.field("FunctionNodeTransformDirection", components, transform)

            right, up, back = axis(1.0, 0.0, 0.0), axis(0.0, 1.0, 0.0), axis(0.0, 0.0, 1.0)
            unit_back = make.vector("NORMALIZE", back, label="back")
            direction = make.vector("NORMALIZE", offset)
            matrix = make.node("FunctionNodeSeparateMatrix", make.output(lens, "Projection Matrix"))
            return _Camera(
                # A missing camera has a focal length of 0.
                exists=make.math("GREATER_THAN", make.output(lens, "Focal Length"), 0.0, label="exists"),
                is_orthographic=is_orthographic,
                offset=offset,
                direction=self.switch(is_orthographic, direction, unit_back * -1.0, "VECTOR"),
                right=make.vector("NORMALIZE", right, label="right"),
                up=make.vector("NORMALIZE", up, label="up"),
                back=unit_back,
                depth=make.dot(offset, unit_back * -1.0),
                half_width=1.0 / make.output(matrix, "Column 1 Row 1"),
                half_height=1.0 / make.output(matrix, "Column 2 Row 2"),
                unit=make.vector("LENGTH", right),
            )

    def _log_radiance(self, sh_degree: int) -> Field:
        """Σ_k sh_k Y_k(ω); only the constant term without a camera or a wish for the view."""
        make = self.make
        with make.frame("Log radiance = Σ sh_k Y_k(ω)"):
            constant = self.named("physhdr:log_sh_0") * C0
            if sh_degree == 0:
                return constant
            basis = self._basis(sh_degree)
            rest: Field | None = None
            for k in range(1, coefficient_count(sh_degree)):
                term = self.named(f"physhdr:log_sh_{k}") * basis[k - 1]
                rest = term if rest is None else rest + term
            wanted = make.field(
                "FunctionNodeBooleanMath", self.inputs[VIEW_DEPENDENT], self.camera.exists, operation="AND"
            )
            return constant + self.switch(wanted, (0.0, 0.0, 0.0), rest, "VECTOR")

    def _basis(self, sh_degree: int) -> list[Field]:
        """Y_1 … of ``bridge.spherical_harmonics.basis``, as nodes."""
        make = self.make
        parts = make.node("ShaderNodeSeparateXYZ", self.camera.direction, label="ω")
        x, y, z = (make.output(parts, axis) for axis in "XYZ")
        basis = [y * -C1, z * C1, x * -C1]
        if sh_degree >= 2:
            xx, yy, zz = x * x, y * y, z * z
            basis += [x * y * C2[0], y * z * C2[1], (zz * 2.0 - xx - yy) * C2[2], x * z * C2[3]]
            basis += [(xx - yy) * C2[4]]
        if sh_degree >= 3:
            ring = zz * 4.0 - xx - yy
            basis += [
                y * (xx * 3.0 - yy) * C3[0],
                x * y * z * C3[1],
                y * ring * C3[2],
                z * (zz * 2.0 - xx * 3.0 - yy * 3.0) * C3[3],
                x * ring * C3[4],
                z * (xx - yy) * C3[5],
                x * (xx - yy * 3.0) * C3[6],
            ]
        return basis

    def _relight(
        self, geometry: Field, log_radiance: Field, levels: tuple[float, ...], lights: tuple[str, ...]
    ) -> tuple[Field, Field]:
        """The radiance at the wanted lighting levels; its parts are stored where the model knows them."""
        make = self.make
        if levels:
            with make.frame("Lighting level: log gains, linear over log2(level)"):
                return geometry, self._exp(log_radiance + self._log_gain(levels))
        with make.frame("Lighting levels: fixed + Σ level · light"):
            shares = [self.named(share_attribute(index)) for index in range(len(lights))]
            rest = 1.0 - functools.reduce(Field.__add__, shares)
            if len(lights) > 1:  # shares whose sum rounds to above 1 leave no negative rest
                rest = make.vector("MAXIMUM", rest, (0.0, 0.0, 0.0))
            at_level_1 = self._exp(log_radiance)
            radiance = fixed = at_level_1 * rest
            geometry = self.store(geometry, FIXED_ATTRIBUTE, "FLOAT_COLOR", fixed)
            for index, share in enumerate(shares):
                part = at_level_1 * share
                radiance = radiance + part * self.inputs[level_input(lights, index)]
                geometry = self.store(geometry, light_attribute(index), "FLOAT_COLOR", part)
        return geometry, radiance

    def _expose(self, geometry: Field, radiance: Field, curve: ToneCurve | None) -> Field:
        """Store the radiance at the wanted exposure, with the opacity in the fourth."""
        make = self.make
        with make.frame("Exposure: radiance · 2^EV"):
            radiance = radiance * make.math("POWER", 2.0, self.inputs[EXPOSURE])
        if curve is not None:
            radiance = self.switch(
                self.inputs[TONE_MAPPER], radiance, self._tone_map(radiance, curve), "VECTOR"
            )
        with make.frame("Opacity in alpha"):
            parts = make.node("ShaderNodeSeparateXYZ", radiance)
            colour = make.field(
                "FunctionNodeCombineColor", *(make.output(parts, axis) for axis in "XYZ"), self.opacity
            )
            return self.store(geometry, RADIANCE_ATTRIBUTE, "FLOAT_COLOR", colour)

    def _tone_map(self, exposed: Field, curve: ToneCurve) -> Field:
        """The response's code at exposed radiance, decoded from sRGB: what *Standard* encodes again."""
        make = self.make
        low, high = float(curve.log_exposure[0]), float(curve.log_exposure[-1])
        with make.frame("Learned response over ln(radiance · 2^EV)"):
            parts = make.node("ShaderNodeSeparateXYZ", exposed)
            places = []
            for axis in "XYZ":
                positive = make.math("MAXIMUM", make.output(parts, axis), 1e-30)
                places.append((make.math("LOGARITHM", positive, math.e) - low) / (high - low))
            # A colour of our own making: this node and its sockets only carry numbers.
            place = make.field("FunctionNodeCombineColor", *places)
            node = make.node("ShaderNodeRGBCurve", 1.0, place, label="response")
            _set_curves(node.mapping, curve)
            parts = make.node("FunctionNodeSeparateColor", make.output(node, "Color"))
        with make.frame("Decode sRGB"):
            decoded = []
            for channel in ("Red", "Green", "Blue"):
                code = make.output(parts, channel)
                power = make.math("POWER", (code + srgb.OFFSET) * (1.0 / srgb.SCALE), srgb.POWER)
                bright = make.math("GREATER_THAN", code, srgb.CODE_KNEE)
                decoded.append(self.switch(bright, code * (1.0 / srgb.SLOPE), power))
            return make.field("ShaderNodeCombineXYZ", *decoded)

    def _exp(self, vector: Field) -> Field:
        """e to the power of each component: vector math has no exponential."""
        make = self.make
        parts = make.node("ShaderNodeSeparateXYZ", vector)
        powers = [make.math("EXPONENT", make.output(parts, axis)) for axis in "XYZ"]
        return make.field("ShaderNodeCombineXYZ", *powers, label="exp")

    def _log_gain(self, levels: tuple[float, ...]) -> Field:
        """Σ_l weight_l · gain_l: each weight is the rise to its level minus the rise to the next."""
        make = self.make
        limited = make.math("MAXIMUM", self.inputs[LIGHTING_LEVEL], levels[0])
        stops = make.math("LOGARITHM", limited, 2.0)
        rises: list[Field | float] = [1.0]
        for low, high in itertools.pairwise(levels):
            start = make.math("LOGARITHM", low, 2.0)
            end = make.math("LOGARITHM", high, 2.0)
            rises.append(make.field("ShaderNodeMapRange", stops, start, end, 0.0, 1.0, clamp=True))
        rises.append(0.0)
        total: Field | None = None
        for index in range(len(levels)):
            weight = make.math("SUBTRACT", rises[index], rises[index + 1])
            term = self.named(f"physhdr:level_log_gain_{index}") * weight
            total = term if total is None else total + term
        assert total is not None
        return total

    def _draw(self, geometry: Field) -> None:
        """Instance the proxy on every point and give it its material."""
        make, splats = self.make, self.inputs[CAMERA_SPLATS]
        with make.frame("Size of a pixel at the point"):
            pixel = self.camera.half_width * 2.0 / make.math("MAXIMUM", self.inputs[IMAGE_WIDTH], 1.0)
            pixel = pixel * self.switch(self.camera.is_orthographic, self.camera.depth, self.camera.unit)
            wanted = make.math("GREATER_THAN", self.inputs[IMAGE_WIDTH], 0.0)
            widening = pixel * pixel * (wanted * LOW_PASS) * self.camera.exists
        with make.frame("Reach: standard deviations to alpha = 1/255"):
            reach = make.math("SQRT", make.math("LOGARITHM", self.opacity * (1.0 / ALPHA_MIN), math.e) * 2.0)
            visible = make.math("GREATER_THAN", self.opacity, ALPHA_MIN)
        rotation = self.named("rotation", "QUATERNION")
        scale = self.named("scale")
        with make.frame("Ellipsoid: σ² + widening"):
            ellipsoid_scale = make.vector("POWER", scale * scale + widening, 0.5) * reach
            icosphere = make.field("GeometryNodeMeshIcoSphere", ICOSPHERE_RADIUS, 1)
            ellipsoid = make.field("GeometryNodeSetMaterial", icosphere, None, splat_material("ellipsoid"))
        card_rotation, card_scale = self._card(rotation, scale, widening)
        with make.frame("Camera splat: a card"):
            card_scale = card_scale * reach
            card = make.field("GeometryNodeMeshCircle", 8, 1.0823922, fill_type="NGON")
            card = make.field("GeometryNodeSetMaterial", card, None, splat_material("splat"))
            in_front = make.math("GREATER_THAN", self.camera.depth, NEAR_PLANE)
        with make.frame("Instances"):
            usable = make.field("FunctionNodeBooleanMath", splats, self.camera.exists, operation="AND")
            visible = visible * self.switch(usable, 1.0, in_front)
            instances = make.field(
                "GeometryNodeInstanceOnPoints",
                geometry,
                visible,
                self.switch(usable, ellipsoid, card, "GEOMETRY"),
                None,
                None,
                self.switch(usable, rotation, card_rotation, "ROTATION"),
                self.switch(usable, ellipsoid_scale, card_scale, "VECTOR"),
            )
            make.node("NodeGroupOutput", instances)

    def _card(self, rotation: Field, scale: Field, widening: Field) -> tuple[Field, Field]:
        """Rotation of a card facing the camera along the splat's axes, and its standard deviations.

        The EWA projection, in the plane through the centre at its depth: with A = S Rᵀ J (columns a, b),
        the covariance there is AᵀA plus the widening; J's columns are right − tan_x forward and
        up − tan_y forward.
        """
        make, camera = self.make, self.camera
        with make.frame("Camera splat: covariance in the plane at its depth"):
            perspective = 1.0 - camera.is_orthographic
            inverse_rotation = make.field("FunctionNodeInvertRotation", rotation)

            def projected(axis: Field, half: Field) -> Field:
                limit = half * (1.0 + JACOBIAN_MARGIN)
                tangent = make.dot(camera.offset, axis) / make.math("MAXIMUM", camera.depth, NEAR_PLANE)
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
        return turn, deviations


def _set_curves(mapping: bpy.types.CurveMapping, curve: ToneCurve) -> None:
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
