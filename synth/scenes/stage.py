# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene hands to the renderer: its lights in two groups, and where cameras may stand."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import bpy


@dataclass(frozen=True, kw_only=True)
class CameraHints:
    """Where the camera rigs of a scene may put cameras (metres, radians, Blender world)."""

    centre: tuple[float, float, float]
    """Middle of the grid rig."""
    target: tuple[float, float, float]
    """What the cameras look at."""
    extent: tuple[float, float]
    """Width and height of the grid rig."""
    angle_x: float
    """Horizontal field of view."""
    orbit_radius: float
    orbit_arc: float
    """Azimuth range of the orbit and hemisphere rigs, centred on the direction target → centre."""
    elevation: tuple[float, float]
    """Elevation range of the hemisphere rig; the orbit rig uses its middle."""


@dataclass(frozen=True)
class LightKnob:
    """One number of Blender's that the strength of a light is linear in."""

    owner: Any
    attribute: str
    base: float

    def set(self, level: float) -> None:
        """Set to ``level`` × base; untouched where it is so already, for Cycles then keeps its scene."""
        value = self.base * level
        if abs(getattr(self.owner, self.attribute) - value) > 1e-6 * abs(value):
            setattr(self.owner, self.attribute, value)


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A built scene. Light is in two groups: ambient (sky, sun, fill) and lamps."""

    scene: bpy.types.Scene
    cameras: CameraHints
    ambient: list[LightKnob] = field(default_factory=list)
    lamps: list[LightKnob] = field(default_factory=list)

    def set_ambient(self, level: float) -> None:
        """Multiply sky, sun and fill by ``level``; lamps stay. Light transport is linear in it."""
        for knob in self.ambient:
            knob.set(level)

    def set_lamps(self, level: float) -> None:
        """Multiply the lamps by ``level``; the ambient light stays."""
        for knob in self.lamps:
            knob.set(level)
