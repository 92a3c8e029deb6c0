# SPDX-License-Identifier: GPL-3.0-or-later
"""A preview: checks a request's camera, renders its image and packs it for sending."""

import math
import time

import numpy as np
import torch

from ...bridge import srgb
from ...bridge.errors import BadValueError
from ...bridge.lights import as_levels
from ...bridge.limits import EV_MAX
from ...bridge.messages import (
    PREVIEW_PIXELS_MAX,
    PREVIEW_SIDE_MAX,
    PreviewCamera,
    PreviewFrame,
    PreviewHeader,
    PreviewRequest,
)
from ..methods.base import Method
from ..scene.camera import Camera

#: The largest finite half.
HALF_MAX = 65504.0
#: How far a pose's axes may be from unit length by rounding; more is a scale.
AXIS_TOLERANCE = 0.01


def camera_of(asked: PreviewCamera) -> Camera:
    """The camera of a request, its rotation made orthonormal; raises ``BadValueError``."""
    width, height = asked.width, asked.height
    if not (0 < width <= PREVIEW_SIDE_MAX and 0 < height <= PREVIEW_SIDE_MAX):
        raise BadValueError(f"a preview of {width}×{height}", f"Sides are 1 to {PREVIEW_SIDE_MAX} pixels.")
    if width * height > PREVIEW_PIXELS_MAX:
        raise BadValueError(f"a preview of {width}×{height} does not fit a frame", "Ask for a smaller one.")
    if not (asked.fx > 0.0 and asked.fy > 0.0):
        raise BadValueError(f"focal lengths of {asked.fx} and {asked.fy} pixels", "They must be above 0.")
    if len(asked.pose) != 16:
        raise BadValueError(f"a pose of {len(asked.pose)} numbers", "Give a 4×4 matrix, row by row.")
    pose = np.array(asked.pose, np.float64).reshape(4, 4)
    left, lengths, right = np.linalg.svd(pose[:3, :3])
    rigid = np.abs(lengths - 1.0).max() <= AXIS_TOLERANCE and np.allclose(pose[3], (0, 0, 0, 1))
    if not rigid or np.linalg.det(pose[:3, :3]) < 0.0:
        raise BadValueError(
            "a preview's pose is not a rotation and a translation", "Leave out scale, shear and mirroring."
        )
    pose[:3, :3] = left @ right  # the nearest rotation
    return Camera(pose, width, height, asked.fx, asked.fy, asked.cx, asked.cy)


def levels_of(request: PreviewRequest, method: Method) -> tuple[float, ...]:
    """A level for each light, the standard one where the request has none; raises ``BadValueError``."""
    asked = request.lighting_levels
    return as_levels((*asked, *method.standard_levels[len(asked) :]), method.lights)


def srgb_to_linear(codes: torch.Tensor) -> torch.Tensor:
    """IEC 61966-2-1, on [0, 1]."""
    power = ((codes + srgb.OFFSET) / srgb.SCALE) ** srgb.POWER
    return torch.where(codes <= srgb.CODE_KNEE, codes / srgb.SLOPE, power)


@torch.no_grad()
def render(method: Method, request: PreviewRequest, iteration: int, scale: float = 1.0) -> PreviewFrame:
    """Render the frame of ``request``, as described by ``PreviewRequest``, its radiance times ``scale``.

    Raises ``BadValueError`` for what cannot be rendered.
    """
    begun = time.perf_counter()
    levels = levels_of(request, method)
    if not abs(request.exposure_ev) <= EV_MAX:
        raise BadValueError(f"an exposure of {request.exposure_ev} EV", f"Choose −{EV_MAX:g} to {EV_MAX:g}.")
    camera = camera_of(request.camera)
    exposure = math.exp2(request.exposure_ev)
    drawn = method.preview(camera, levels)
    if request.tone == "learned":
        picture, black = method.preview_ldr(drawn, camera, exposure, levels)
        seen, empty = (srgb_to_linear(codes.clamp(0.0, 1.0)) for codes in (picture, black))
        colours = (seen - (1.0 - drawn.alpha) * empty).clamp_min(0.0)
    else:
        colours = drawn.image * (exposure * scale)
    rgba = torch.empty(camera.height, camera.width, 4, dtype=torch.float16, device=colours.device)
    rgba[..., :3] = colours.clamp(max=HALF_MAX).permute(1, 2, 0)
    rgba[..., 3] = drawn.alpha
    assert drawn.depth is not None
    rgba_there, depth_there = rgba.cpu().numpy(), drawn.depth.cpu().numpy()  # waits for a card
    milliseconds = 1e3 * (time.perf_counter() - begun)
    return PreviewFrame(
        PreviewHeader(request=request, iteration=iteration, milliseconds=milliseconds),
        rgba_there,
        depth_there,
    )
