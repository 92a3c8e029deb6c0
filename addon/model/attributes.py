# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model's point cloud carries, by name: a row for each attribute and property (docs/formats.md).

Attributes without ``physhdr:`` are named as Blender 5.3 names those of Gaussians.
"""

from dataclasses import dataclass
from typing import Literal

from ...bridge.blend_file import MODEL_IDENTITY

AttributeType = Literal["FLOAT", "FLOAT_VECTOR", "FLOAT4", "FLOAT_COLOR", "QUATERNION"]

#: Blender's attribute type → (numbers a point, property that ``foreach_set`` fills).
TYPES: dict[AttributeType, tuple[int, str]] = {
    "FLOAT": (1, "value"),
    "FLOAT_VECTOR": (3, "vector"),
    "FLOAT4": (4, "vector"),
    "FLOAT_COLOR": (4, "color"),
    "QUATERNION": (4, "value"),
}


@dataclass(frozen=True)
class Attribute:
    """An attribute of every point: its name and its type."""

    name: str
    type: AttributeType


@dataclass(frozen=True)
class Numbered:
    """Attributes of one type whose names are ``prefix`` and a number."""

    prefix: str
    type: AttributeType

    def __getitem__(self, index: int) -> Attribute:
        return Attribute(f"{self.prefix}{index}", self.type)


POSITION = Attribute("position", "FLOAT_VECTOR")
#: Standard deviations, metres.
SCALE = Attribute("scale", "FLOAT_VECTOR")
#: Unit, wxyz.
ROTATION = Attribute("rotation", "QUATERNION")
#: What Blender 5.3 shows: the SH coefficient of degree 0 of a display's code, and the opacity in the fourth.
BASE = Attribute("radiance:base", "FLOAT4")
#: The others: ``[k − 1]`` is coefficient k.
SHOWN_SH = Numbered("radiance:sh_", "FLOAT_VECTOR")
#: Of a point as Blender draws points, metres.
RADIUS = Attribute("radius", "FLOAT")
#: That radius while the 3D view's shader draws the Gaussians, and Blender nothing (``viewport.stand_in``).
KEPT_RADIUS = Attribute("physhdr:radius", "FLOAT")

#: SH coefficients of ln radiance at level 1.
LOG_SH = Numbered("physhdr:log_sh_", "FLOAT_VECTOR")
#: The share of the radiance that a light causes, by the light's place in ``LIGHTS``.
LIGHT_SHARE = Numbered("physhdr:light_share_", "FLOAT_VECTOR")
#: ln of the gain at each of a baked-levels model's ``LEVELS``.
LEVEL_LOG_GAIN = Numbered("physhdr:level_log_gain_", "FLOAT_VECTOR")
#: How likely the radiance is right, 0 to 1 (``bridge.confidence``); of models whose file has it.
CONFIDENCE = Attribute("physhdr:confidence", "FLOAT")
#: Metres to the nearest camera of the data set, in the model's space; there once it was measured.
CAMERA_DISTANCE = Attribute("physhdr:camera_distance", "FLOAT")

#: What the modifier computes: radiance toward the active camera, the opacity in alpha …
RADIANCE = Attribute("physhdr:radiance", "FLOAT_COLOR")
#: … and its parts at level 1: what no light turns, the first light's, and each further light's by its place.
FIXED_PART = Attribute("physhdr:fixed", "FLOAT_COLOR")
FIRST_PART = Attribute("physhdr:ambient", "FLOAT_COLOR")
FURTHER_PART = Numbered("physhdr:light_", "FLOAT_COLOR")

#: Custom property with the model's identity; survives undo, copies and appending, unlike a reference.
IDENTITY = MODEL_IDENTITY
#: Custom property of an object: the identity of the model that it shows (``parts``).
SHOWS = "physhdr_shows"
#: Custom property: the file that the model was imported from.
FILE = "physhdr_file"
#: Custom property: the data set's folder of the model's run, else the model's file (``origin``).
CAPTURE = "physhdr_capture"
#: Custom property: the turn about X, in radians, that the object was given for the axes of its file.
TURN = "physhdr_turn"
#: Custom property: some of the Gaussians, as they were when they were last known to be whole (``pose``).
WITNESS = "physhdr_witness"
#: Custom property, in Edit Mode alone: points were moved since ``WITNESS`` was taken.
MOVED = "physhdr_moved"
#: Custom property: what the colours of another program's PLY were taken for.
COLOR_SPACE = "physhdr_color_space"
#: Custom property: the names of the lights, as JSON (Blender has no lists of texts).
LIGHTS = "physhdr_lights"
#: Custom properties with fields of ``bridge.model_file.Model``.
MODULATOR, SH_DEGREE = "physhdr_modulator", "physhdr_sh_degree"
LEVELS, EXPOSURES = "physhdr_levels", "physhdr_exposures"
#: Custom property: the cameras of the training's pictures, as the model file has them.
CAMERAS = "physhdr_cameras"
#: Custom properties with the learned response: ln exposure ``[M]``, and values ``[M, 3]`` row by row.
TONE_CURVE_LOG_EXPOSURE, TONE_CURVE = "physhdr_tone_curve_log_exposure", "physhdr_tone_curve"

#: Property of an object, registered by ``viewport.splats``: how the 3D view draws it.
DISPLAY = "physhdr_viewport"
#: Its values: the shader draws radiance, or confidence; or the modifier's instances are shown.
SPLATS, CONFIDENCE_SPLATS, NODES = "SPLATS", "CONFIDENCE", "NODES"
#: Those of the shader.
BY_SHADER = (SPLATS, CONFIDENCE_SPLATS)


def light_part(index: int) -> Attribute:
    """Where the modifier stores a light's part of the radiance at level 1."""
    return FIRST_PART if index == 0 else FURTHER_PART[index]


def metadata_property(key: str) -> str:
    """The custom property with an entry of a model's metadata (scene, method, iteration)."""
    return f"physhdr_{key}"
