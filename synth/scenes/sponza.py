# SPDX-License-Identifier: GPL-3.0-or-later
"""``sponza``: a court under the noon sun between two storeys of arches on columns, 6 × 14 m.

The sun comes over the right roof: it lights the left arcade and half of the floor, and cuts into the left
aisle; the right side lies in shade. Lamps: ``lanterns`` with bare bulbs in the aisles, and ``braziers``.
Ambient is sun and sky.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import sponza_colonnade as colonnade
from . import sponza_court as court
from .lighting import Lighting
from .skies import clouded

SKY_RADIANCE = 7.5
SUN_IRRADIANCE = 230.0

#: Deep blue at the zenith, pale toward the horizon, some fair-weather clouds.
SKY = clouded(
    [(0.0, (0.95, 0.92, 0.86)), (0.2, (0.55, 0.72, 0.95)), (0.8, (0.16, 0.36, 0.80))],
    clouds=(1.7, 1.65, 1.55),
    cover=(0.52, 0.66),
    scale=5.0,
    detail=4.0,
    distortion=0.5,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    lighting = Lighting(scene)
    colonnade.build_court(room)
    court.furnish(room, assets, lighting, random.Random(5))
    lighting.sky(SKY, SKY_RADIANCE)
    lighting.sun((-0.36, 0.30, -0.88), SUN_IRRADIANCE, (1.0, 0.90, 0.74), angle=0.6)
    hints = CameraHints(
        centre=(0.15, -5.3, 1.95),
        target=(0.0, 2.4, 2.35),
        extent=(3.4, 1.7),
        angle_x=math.radians(66.0),
        orbit_radius=7.4,
        orbit_arc=math.radians(30.0),
        elevation=(math.radians(-8.0), math.radians(14.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)
