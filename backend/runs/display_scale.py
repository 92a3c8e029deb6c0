# SPDX-License-Identifier: GPL-3.0-or-later
"""The scale of photographs' radiance that makes renders look on a display like the photos.

Photographs leave the unit of radiance undetermined: twice the radiance, with a response that needs twice as
much, gives the same pictures. The unit is chosen so that a photo has the same mean code as its radiance times
its exposure through sRGB's curve (Blender's view transform *Standard*). Both come from the model alone.
"""

import numpy as np
import torch

from ...bridge import srgb
from ..methods.base import Method
from ..scene.camera import Camera

#: Width of the compared image, pixels.
WIDTH = 96
#: Limit in stops: larger scales come from black or white pictures, which are uninformative.
MOST_STOPS = 8.0
#: Bisection steps, to a thousandth of a stop.
STEPS = 14


@torch.no_grad()
def display_scale(method: Method, camera: Camera, exposure: float) -> float:
    """The scale at which ``camera``'s image at ``exposure`` seconds looks as through the method's response.

    1 if no scale does that.
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
