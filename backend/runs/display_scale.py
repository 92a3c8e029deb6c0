# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance of photographs is multiplied by, so that they look on a display as they were taken.

Photographs leave the unit of radiance free: twice the radiance, and a response that needs twice as much,
give the same pictures. The unit is chosen so that a photo has the same mean code as its radiance times its
exposure has with sRGB's curve (Blender's view transform *Standard*). The model alone tells both.
"""

import numpy as np
import torch

from ...bridge import srgb
from ..methods.base import Method
from ..scene.camera import Camera

#: Pixels of the picture that is compared.
WIDTH = 96
#: Stops; what is asked for more has black or white pictures, which say nothing.
MOST_STOPS = 8.0
#: Halvings of that: to a thousandth of a stop.
STEPS = 14


@torch.no_grad()
def display_scale(method: Method, camera: Camera, exposure: float) -> float:
    """The scale at which ``camera``'s picture of ``exposure`` seconds looks as the method develops it.

    1 where no scale does that.
    """
    camera = camera.resized(min(WIDTH, camera.width))
    wanted = float(method.ldr(camera, exposure).double().mean())
    exposed = exposure * method.hdr(camera).double().cpu().numpy()
    low, high = -MOST_STOPS, MOST_STOPS
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        if _mean_code(exposed * 2.0**middle) < wanted:
            low = middle
        else:
            high = middle
    is_found = low > -MOST_STOPS and high < MOST_STOPS
    return 2.0 ** (0.5 * (low + high)) if is_found else 1.0


def _mean_code(linear: np.ndarray) -> float:
    return float(srgb.to_srgb(np.clip(linear, 0.0, 1.0)).mean())
