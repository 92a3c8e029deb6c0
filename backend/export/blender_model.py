# SPDX-License-Identifier: GPL-3.0-or-later
"""The model file for Blender: the trained radiance in a form that needs no networks (docs/formats.md).

With the physical product and the additive modulator the file is exact. Where networks compose or modulate,
ln radiance is projected onto SH and relighting is baked at a few levels.
"""

import numpy as np
import torch

from ...bridge.model_file import Model
from ...bridge.spherical_harmonics import FIT_DIRECTIONS, basis, fibonacci_sphere
from ..methods.physhdr import PhysHDR
from ..model.gaussians import SH_C0

#: Levels at which a learned modulator is baked: 1/32 … 32, the range of exposures it was trained on.
BAKED_LEVELS = tuple(float(2.0**power) for power in range(-5, 6))
#: The exported response is sampled at this many ln exposures in this range.
TONE_CURVE_SAMPLES = 256
TONE_CURVE_RANGE = (-12.0, 8.0)


@torch.no_grad()
def log_radiance_sh(method: PhysHDR) -> np.ndarray:
    """``[N, K, 3]``: SH of ln radiance at level 1, exact for the product, least squares for a learned g."""
    g = method.gaussians
    degree = method.active_sh_degree
    coefficients = (degree + 1) ** 2
    rest = g.reflectance_rest[:, : coefficients - 1]
    sh = torch.cat([g.reflectance_dc, rest], dim=1).clone()
    if method.config.composer == "product":
        sh[:, 0] += g.log_illumination / SH_C0
        return sh.numpy()
    directions = fibonacci_sphere(FIT_DIRECTIONS)
    Y = torch.from_numpy(basis(directions, degree)).float()  # [D, K]
    samples = torch.stack([method.composer(g.log_illumination, (y[:, None] * sh).sum(1)).log() for y in Y])
    return torch.einsum("kd,dnc->nkc", torch.linalg.pinv(Y), samples).numpy()


@torch.no_grad()
def level_log_gain(method: PhysHDR, viewpoint: torch.Tensor) -> np.ndarray:
    """``[L, N, 3]``: ln(ĉ(level) / ĉ(1)) at ``BAKED_LEVELS`` as seen from ``viewpoint`` (``[3]``, metres)."""
    at_one = method.radiance(viewpoint, 1.0).log()
    gains = [method.radiance(viewpoint, level).log() - at_one for level in BAKED_LEVELS]
    return torch.stack(gains).numpy()


@torch.no_grad()
def tone_curve(method: PhysHDR) -> tuple[np.ndarray, np.ndarray]:
    """The learned global response: ln exposure ``[M]`` and LDR ``[M, 3]``."""
    x = torch.linspace(*TONE_CURVE_RANGE, TONE_CURVE_SAMPLES)
    y = method.tone_mapper.curve_logits(x.expand(3, -1).contiguous()).sigmoid()
    return x.numpy(), y.T.contiguous().numpy()


@torch.no_grad()
def to_model(
    method: PhysHDR, viewpoint: np.ndarray, exposures: tuple[float, ...], metadata: dict[str, str]
) -> Model:
    """The file's content. ``viewpoint`` ``[3]``: where baked levels are taken from, the cameras' mean."""
    g = method.gaussians
    share = gain = None
    levels: tuple[float, ...] = ()
    if method.config.has_light_share:
        share = g.light_share.numpy()
    elif not method.can_relight:
        # Without an illumination branch nothing is known of the light: a level scales everything.
        share = np.ones((len(g), 1, 3), np.float32)
    else:
        gain, levels = level_log_gain(method, torch.as_tensor(viewpoint, dtype=torch.float32)), BAKED_LEVELS
    log_exposure, curve = tone_curve(method)
    return Model(
        position=g.means.detach().numpy(),
        rotation=torch.nn.functional.normalize(g.quaternions.detach(), dim=1).numpy(),
        scale=g.scales.numpy(),
        opacity=g.opacities.numpy(),
        log_radiance_sh=log_radiance_sh(method),
        light_share=share,
        lights=method.lights,
        level_log_gain=gain,
        levels=levels,
        tone_curve_log_exposure=log_exposure,
        tone_curve=curve,
        exposures=exposures,
        metadata=metadata,
    )
