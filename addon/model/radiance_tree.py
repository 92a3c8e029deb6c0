# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry nodes that light the Gaussians, with no backend running; ``splat_nodes`` draws them.

For each point: ω, the direction from the active camera in the object's space; radiance at level 1,
exp(Σ_k sh_k Y_k(ω)); relit by *Lighting level*, the first light's, and *Level of …*, one for each further
light; times 2^*Exposure (EV)*; with *Learned tone mapper*, the scene-linear value that the *Standard* view
shows as the learned response's code. That is before Gaussians are blended, and the camera responded after it:
``rendering.develop`` does so to a picture.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import Any

import bpy

from ...bridge.lights import AMBIENT
from ...bridge.model_file import Model
from ...bridge.spherical_harmonics import C0, C1, C2, C3, coefficient_count
from ..blender import marked_when_whole
from .attributes import BASE, FIXED_PART, LEVEL_LOG_GAIN, LIGHT_SHARE, LOG_SH, RADIANCE, SCALE, light_part
from .cleaning_nodes import clean, declare_cleaning
from .node_builder import Field, GeometryBuilder
from .nodes import (
    CAMERA_SPLATS,
    EXPOSURE,
    IMAGE_WIDTH,
    LIGHTING_LEVEL,
    MARK,
    MODIFIER_NAME,
    SH_DEGREE,
    TONE_MAPPER,
    VIEW_DEPENDENT,
    level_input,
)
from .response_nodes import learned_response
from .splat_nodes import camera_fields, draw
from .tone_curve import ToneCurve

#: The version of this recipe, part of what marks a tree.
_RECIPE = 1


def add_modifier(target: bpy.types.Object, model: Model) -> bpy.types.NodesModifier:
    """Give a point cloud object made from ``model`` the modifier that lights and draws it."""
    modifier = target.modifiers.new(MODIFIER_NAME, "NODES")
    assert isinstance(modifier, bpy.types.NodesModifier)
    curve = None
    if model.tone_curve is not None and model.tone_curve_log_exposure is not None:
        curve = ToneCurve(model.tone_curve_log_exposure, model.tone_curve)
    modifier.node_group = radiance_tree(model.sh_degree, model.levels, curve, model.lights)
    return modifier


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
    assert isinstance(tree, bpy.types.GeometryNodeTree)
    with marked_when_whole(tree, MARK, mark):
        tree.is_modifier = True
        _declare_interface(tree, curve is not None, lights)
        declare_cleaning(tree.interface, sh_degree > 0)
        assembly = _Assembly(tree)
        try:
            assembly.build(sh_degree, levels, curve, lights)
        except BaseException:
            assembly.make.discard()
            raise
    return tree


def level_description(lights: Sequence[str], index: int) -> str:
    """The tooltip of a light's level."""
    name = "the ambient light (sky and fill)" if lights[index] == AMBIENT else f"the light {lights[index]!r}"
    others = "Lamps stay" if lights[0] == AMBIENT and len(lights) == 1 else "Other lights stay"
    return f"Strength of {name}: 1 as captured, 0 off. {others} as they are"


def _declare_interface(tree: bpy.types.NodeTree, has_curve: bool, lights: tuple[str, ...]) -> None:
    interface: Any = tree.interface  # which types a socket may have is known only to Blender

    def declare(name: str, kind: str, description: str = "", **properties: Any) -> None:
        socket = interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        socket.description = description
        for key, value in properties.items():
            setattr(socket, key, value)

    interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    declare("Geometry", "Geometry")
    declare(EXPOSURE, "Float", "Radiance is multiplied by 2 to this power", min_value=-30.0, max_value=30.0)
    for index in range(len(lights)):
        text = level_description(lights, index)
        declare(level_input(lights, index), "Float", text, default_value=1.0, min_value=0.0)
    if has_curve:
        declare(
            TONE_MAPPER,
            "Bool",
            "Show each Gaussian as the camera of the photos would have recorded it in 2^EV seconds, in "
            "Blender's Standard view. Renders blend these colours: near the camera's picture, not the same "
            "(Develop as Photographed is). The 3D view is exact. Off: scene-linear radiance",
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


class _Assembly:
    """Builds the tree, frame by frame, in the order in which it is read."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree
        self.make = GeometryBuilder(tree)

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
                "FunctionNodeSeparateColor", make.named(BASE, as_type="FLOAT_COLOR"), output="Alpha"
            ).called("opacity")
        with make.group("PhysHDR camera"):
            self.camera = camera_fields(make, self.position)
        with make.group("PhysHDR cleaning"):
            geometry = clean(
                make,
                self.inputs["Geometry"],
                self.position,
                make.named(SCALE),
                self.opacity,
                self.camera,
                self.inputs,
            )
        with make.group("PhysHDR log radiance"):
            log_radiance = self._log_radiance(sh_degree)
        geometry, radiance = self._relight(geometry, log_radiance, levels, lights)
        geometry = self._expose(geometry, radiance, curve)
        draw(make, geometry, self.opacity, self.camera, self.inputs)
        make.arrange()

    def _log_radiance(self, sh_degree: int) -> Field:
        """Σ_k sh_k Y_k(ω); only the constant term without a camera or a wish for the view."""
        make = self.make
        with make.frame("Log radiance = Σ sh_k Y_k(ω)"):
            constant = make.named(LOG_SH[0]) * C0
            if sh_degree == 0:
                return constant.called("log radiance")
            basis = self._basis(sh_degree)
            rest: Field | None = None
            for degree in range(1, sh_degree + 1):
                lower = rest
                for k in range(coefficient_count(degree - 1), coefficient_count(degree)):
                    term = make.named(LOG_SH[k]) * basis[k - 1]
                    rest = term if rest is None else rest + term
                if lower is not None:  # one value decides for all points: the other side is not computed
                    rest = make.switch(self._reaches(degree), lower, rest, "VECTOR")
            wanted = make.field(
                "FunctionNodeBooleanMath", self.inputs[VIEW_DEPENDENT], self.camera.exists, operation="AND"
            )
            wanted = make.field("FunctionNodeBooleanMath", wanted, self._reaches(1), operation="AND")
            rest = make.switch(wanted, (0.0, 0.0, 0.0), rest, "VECTOR")
            return (constant + rest).called("log radiance")

    def _reaches(self, degree: int) -> Field:
        """Whether SH of that degree are wanted."""
        return self.make.field(
            "FunctionNodeCompare",
            self.inputs[SH_DEGREE],
            degree,
            data_type="INT",
            operation="GREATER_EQUAL",
        )

    def _basis(self, sh_degree: int) -> list[Field]:
        """Y_1 … of ``bridge.spherical_harmonics.basis``, as nodes."""
        make = self.make
        parts = make.node("ShaderNodeSeparateXYZ", self.camera.direction, label="ω")
        x, y, z = (make.output(parts, axis) for axis in "XYZ")
        basis = [y * -C1, z * C1, x * -C1]
        if sh_degree == 1:
            return basis
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
            shares = [make.named(LIGHT_SHARE[index]) for index in range(len(lights))]
            rest = 1.0 - functools.reduce(Field.__add__, shares)
            if len(lights) > 1:  # shares whose sum rounds to above 1 leave no negative rest
                rest = make.vector("MAXIMUM", rest, (0.0, 0.0, 0.0))
            at_level_1 = self._exp(log_radiance)
            radiance = fixed = at_level_1 * rest
            geometry = make.store(geometry, FIXED_PART, fixed)
            for index, share in enumerate(shares):
                part = at_level_1 * share
                radiance = radiance + part * self.inputs[level_input(lights, index)]
                geometry = make.store(geometry, light_part(index), part)
        return geometry, radiance

    def _expose(self, geometry: Field, radiance: Field, curve: ToneCurve | None) -> Field:
        """Store the radiance at the wanted exposure, with the opacity in the fourth."""
        make = self.make
        with make.frame("Exposure: radiance · 2^EV"):
            radiance = radiance * make.math("POWER", 2.0, self.inputs[EXPOSURE])
        if curve is not None:
            radiance = make.switch(
                self.inputs[TONE_MAPPER], radiance, self._tone_map(radiance, curve), "VECTOR"
            )
        with make.frame("Opacity in alpha"):
            parts = make.node("ShaderNodeSeparateXYZ", radiance)
            colour = make.field(
                "FunctionNodeCombineColor", *(make.output(parts, axis) for axis in "XYZ"), self.opacity
            )
            return make.store(geometry, RADIANCE, colour)

    def _tone_map(self, exposed: Field, curve: ToneCurve) -> Field:
        """The response's code at exposed radiance, decoded from sRGB: what *Standard* encodes again."""
        parts = self.make.node("ShaderNodeSeparateXYZ", exposed)
        decoded = learned_response(self.make, [self.make.output(parts, axis) for axis in "XYZ"], curve)
        return self.make.field("ShaderNodeCombineXYZ", *decoded)

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
            term = make.named(LEVEL_LOG_GAIN[index]) * weight
            total = term if total is None else total + term
        assert total is not None
        return total
