# SPDX-License-Identifier: GPL-3.0-or-later
"""What every rasteriser takes and gives, and what all of them do with a splat's limits (bridge/splatting.py).

Conventions (gsplat's, so that the CUDA path draws the same picture):

* a pixel's centre is at +0.5; a 2D covariance is low-pass filtered by + ``LOW_PASS`` on its diagonal;
* ``alpha = min(ALPHA_MAX, opacity · exp(−½ dᵀ Σ⁻¹ d))``; a contribution with less than ``ALPHA_MIN`` is
  skipped;
* front to back by camera-space depth (ties by index); a pixel is finished, *before* a Gaussian is
  added, when that Gaussian would bring its transmittance to ``TRANSMITTANCE_MIN`` or below;
* Gaussians nearer than ``NEAR_PLANE`` are not drawn;
* the Jacobian of the projection is evaluated with x/z and y/z clamped to the image plus a margin of
  ``JACOBIAN_MARGIN`` times the half field of view on every side;
* black background.
"""

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Rasterization:
    """One rendered view.

    ``image``: ``[C, H, W]`` premultiplied sum of colours. ``alpha``: ``[H, W]`` coverage in [0, 1).
    ``radii``: ``[N]`` float, half-size in pixels of each Gaussian's footprint on the screen, 0 where it
    is not drawn (no gradient). ``depth``: ``[H, W]`` mean camera-space depth in metres of what covers the
    pixel, 0 where nothing does; ``None`` unless asked for.
    """

    image: torch.Tensor
    alpha: torch.Tensor
    radii: torch.Tensor
    depth: torch.Tensor | None = None
