# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene hands to the renderer: its lights in groups, and where cameras may stand."""

from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

WORLD_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class CameraHints:
    """Where the camera rigs of a scene may put cameras (metres, radians, Blender world)."""

    #: Middle of the grid rig.
    centre: tuple[float, float, float]
    #: What the cameras look at.
    target: tuple[float, float, float]
    #: Width and height of the grid rig.
    extent: tuple[float, float]
    #: Horizontal field of view.
    angle_x: float
    orbit_radius: float
    #: Azimuth range of the orbit and hemisphere rigs, centred on the direction target → centre.
    orbit_arc: float
    #: Elevation range of the hemisphere rig; the orbit rig uses its middle.
    elevation: tuple[float, float]
    #: Upward in the grid rig's pictures: not the world's where the camera looks straight down.
    up: tuple[float, float, float] = WORLD_UP
    #: Nothing nearer or farther than this is seen.
    clip: tuple[float, float] = (0.01, 1000.0)


@dataclass(frozen=True)
class RigPoses:
    """Camera-to-world matrices [4, 4] of each split."""

    train: list[np.ndarray]
    test: list[np.ndarray]
    lit: list[np.ndarray]
    validation: list[np.ndarray] = field(default_factory=list)

    @property
    def all(self) -> list[np.ndarray]:
        return [*self.train, *self.test, *self.lit, *self.validation]


@dataclass(frozen=True)
class LightKnob:
    """One number of Blender's that the strength of a light is linear in."""

    owner: Any
    attribute: str
    base: float


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A built or opened scene, and its lights by group.

    Every emitter belongs to one of Cycles' light groups of the view layer. Light transport is linear in each,
    so the passes of the groups, each times a level, add up to the picture under those levels.
    """

    scene: bpy.types.Scene
    cameras: CameraHints
    #: Light → the numbers that turn it, ``bridge.lights.AMBIENT`` (sky, sun, fill) first; none in a user's
    #: scene, where nothing is turned: there the passes alone tell the lights apart.
    lights: dict[str, list[LightKnob]] = field(default_factory=dict)
    #: Light → its light group of Cycles, where that has another name; ``""`` is what remains of the picture
    #: without all others.
    groups: dict[str, str] = field(default_factory=dict)
    #: What is rendered and what rays are cast in; the scene's first view layer if ``None``.
    layer: bpy.types.ViewLayer | None = None
    #: Cameras that no rig of hints gives: those of the user's own animation.
    poses: RigPoses | None = None
    #: Where a user's scene came from, for dataset.json.
    source: dict[str, Any] = field(default_factory=dict)
    #: Of a user's scene: another value means that the scene has changed.
    fingerprint: str = ""

    @property
    def view_layer(self) -> bpy.types.ViewLayer:
        return self.layer or self.scene.view_layers[0]
