# SPDX-License-Identifier: GPL-3.0-or-later
"""The model file for Blender: the trained radiance in a form that needs no networks (docs/formats.md).

With the physical product and the additive modulator the file is exact. Where networks compose or modulate,
ln radiance is projected onto SH and relighting is baked at a few levels.
"""

import copy
import math
from collections.abc import Sequence

import numpy as np
import torch

from ...bridge.camera_list import ListedCamera
from ...bridge.limits import FARTHEST
from ...bridge.model_file import Model
from ...bridge.spherical_harmonics import FIT_DIRECTIONS, basis, fibonacci_sphere
from ..methods.base import Method
from ..model.backbone import Splats
from ..model.gaussians import SH_C0, Gaussians
from ..scene.camera import Camera

#: Levels at which a learned modulator is baked: 1/32 … 32, the range of exposures it was trained on.
BAKED_LEVELS = tuple(float(2.0**power) for power in range(-5, 6))


@torch.no_grad()
def log_radiance_sh(method: Method) -> np.ndarray:
    """``[N, K, 3]``: SH of ln radiance at level 1, exact for the product, least squares for a learned g."""
    g = method.gaussians
    degree = method.active_sh_degree
    coefficients = (degree + 1) ** 2
    rest = g.reflectance_rest[:, : coefficients - 1]
    sh = torch.cat([g.reflectance_dc, rest], dim=1).clone()
    if method.composes_by_product:
        sh[:, 0] += g.log_illumination / SH_C0
        return sh.numpy()
    directions = fibonacci_sphere(FIT_DIRECTIONS)
    Y = torch.from_numpy(basis(directions, degree)).float()  # [D, K]
    seen = [_splats(g, (y[:, None] * sh).sum(1)) for y in Y]
    samples = torch.stack([method.radiance_of(splats, None).log() for splats in seen])
    return torch.einsum("kd,dnc->nkc", torch.linalg.pinv(Y), samples).numpy()


def _splats(g: Gaussians, log_reflectance: torch.Tensor) -> Splats:
    """Gaussians as seen from where they have ``log_reflectance`` ``[N, 3]``."""
    share = g.light_share if "light_share_logits" in g.parameters else None
    shape = g.means, g.quaternions, g.scales, g.opacities
    return Splats(*shape, log_reflectance, g.log_illumination, share)


@torch.no_grad()
def level_log_gain(method: Method, viewpoint: torch.Tensor) -> np.ndarray:
    """``[L, N, 3]``: ln(ĉ(level) / ĉ(1)) at ``BAKED_LEVELS`` as seen from ``viewpoint`` (``[3]``, metres)."""
    g = method.gaussians
    splats = _splats(g, g.log_reflectance(viewpoint, method.active_sh_degree))
    at_one = method.radiance_of(splats, (1.0,)).log()
    gains = [method.radiance_of(splats, (level,)).log() - at_one for level in BAKED_LEVELS]
    return torch.stack(gains).numpy()


@torch.no_grad()
def tone_curve(method: Method) -> tuple[np.ndarray, np.ndarray]:
    """The learned global response: ln exposure ``[M]`` and LDR ``[M, 3]``."""
    x, y = method.tone_mapper.sampled()
    return x.numpy(), y.numpy()


def on_gaussians(method: Method, cameras: Sequence[Camera]) -> Method:
    """The method on the CPU and on plain Gaussians: itself where it is, else a copy.

    ``cameras``: those for which the Gaussians are to be right, where they are others for each view.
    """
    if method.device.type == "cpu" and method.backbone.is_fixed:
        return method
    copied = copy.deepcopy(method)
    copied.to_device(torch.device("cpu"))
    copied.backbone = copied.backbone.fixed(cameras)
    copied.backbone_networks = copied.backbone.networks
    return copied


@torch.no_grad()
def to_model(
    method: Method,
    viewpoint: np.ndarray,
    exposures: tuple[float, ...],
    metadata: dict[str, str],
    confidence: np.ndarray | None = None,
    scale: float = 1.0,
    cameras: Sequence[ListedCamera] = (),
) -> Model:
    """The file's content, of a method on plain Gaussians (``on_gaussians``).

    ``viewpoint`` ``[3]``: where baked levels are taken from, the cameras' mean. ``confidence`` ``[N]``
    (``confidence.confidence_of``); None: its pictures are missing. ``scale``: what radiance
    is multiplied by; the curve follows, so that its pictures stay the same. ``cameras``: of its pictures.
    """
    g = method.gaussians
    share = gain = None
    levels: tuple[float, ...] = ()
    if method.has_light_share:
        share = g.light_share.numpy()
    elif not method.can_relight:
        # Without an illumination branch the light is unknown: a level scales everything.
        share = np.ones((len(g), 1, 3), np.float32)
    else:
        gain, levels = level_log_gain(method, torch.as_tensor(viewpoint, dtype=torch.float32)), BAKED_LEVELS
    log_exposure, curve = tone_curve(method)
    log_radiance = log_radiance_sh(method)
    log_radiance[:, 0] += math.log(scale) / SH_C0
    return Model(
        # One runaway Gaussian, which nobody sees, must not prevent the others from being written.
        position=g.means.detach().clamp(-FARTHEST, FARTHEST).numpy(),
        rotation=torch.nn.functional.normalize(g.quaternions.detach(), dim=1).numpy(),
        scale=g.scales.clamp(max=FARTHEST).numpy(),
        opacity=g.opacities.numpy(),
        log_radiance_sh=log_radiance,
        light_share=share,
        lights=method.lights,
        level_log_gain=gain,
        levels=levels,
        tone_curve_log_exposure=log_exposure + math.log(scale),
        tone_curve=curve,
        exposures=exposures,
        metadata=metadata,
        confidence=confidence,
        cameras=tuple(cameras),
    )
