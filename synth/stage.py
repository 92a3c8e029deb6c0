# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene hands to the renderer: its lights in groups, and where cameras may stand."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

WORLD_UP = (0.0, 0.0, 1.0)
AMBIENT = "ambient"
"""The group of sky, sun and fill: what the data set's plain ``lighting_level`` turns."""


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
    up: tuple[float, float, float] = WORLD_UP
    """Upward in the grid rig's pictures: not the world's where the camera looks straight down."""
    clip: tuple[float, float] = (0.01, 1000.0)
    """Nothing nearer or farther than this is seen."""


@dataclass(frozen=True)
class RigPoses:
    """Camera-to-world matrices [4, 4] of each split."""

    train: list[np.ndarray]
    test: list[np.ndarray]
    lit: list[np.ndarray]


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
    """A built or opened scene, and its lights by group.

    Every emitter belongs to one of Cycles' light groups of the view layer. Light transport is linear in each,
    so the passes of the groups, each times a level, add up to the picture under those levels.
    """

    scene: bpy.types.Scene
    cameras: CameraHints
    lights: dict[str, list[LightKnob]] = field(default_factory=dict)
    """Light → the numbers that turn it, ``AMBIENT`` (sky, sun, fill) first; none in a user's scene, where
    nothing is turned: there the passes alone tell the lights apart."""
    groups: dict[str, str] = field(default_factory=dict)
    """Light → its light group of Cycles, where that has another name; ``""`` is what remains of the picture
    without all others."""
    layer: bpy.types.ViewLayer | None = None
    """What is rendered and what rays are cast in; the scene's first view layer if ``None``."""
    poses: RigPoses | None = None
    """Cameras that no rig of hints gives: those of the user's own animation."""
    source: dict[str, Any] = field(default_factory=dict)
    """Where a user's scene came from, for dataset.json."""
    fingerprint: str = ""
    """Of a user's scene: another value means that the scene has changed."""

    @property
    def view_layer(self) -> bpy.types.ViewLayer:
        return self.layer or self.scene.view_layers[0]

    def set_levels(self, levels: Mapping[str, float]) -> None:
        """Multiply each named group by its level, and every other by 1."""
        for group, knobs in self.lights.items():
            for knob in knobs:
                knob.set(levels.get(group, 1.0))
