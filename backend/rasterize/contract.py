# SPDX-License-Identifier: GPL-3.0-or-later
"""What every rasteriser takes and gives, and the constants on which all of them agree.

Conventions (gsplat's, so that the CUDA path draws the same picture):

* a pixel's centre is at +0.5; a 2D covariance is low-pass filtered by +0.3 px² on its diagonal;
* ``alpha = min(0.999, opacity · exp(−½ dᵀ Σ⁻¹ d))``; a contribution with alpha < 1/255 is skipped;
* front to back by camera-space depth (ties by index); a pixel is finished, *before* a Gaussian is
  added, when that Gaussian would bring its transmittance to 1e-4 or below;
* Gaussians nearer than the near plane are not drawn;
* the Jacobian of the projection is evaluated with x/z and y/z clamped to the image plus a margin of
  0.3 times the half field of view on every side;
* black background.
"""

from dataclasses import dataclass

import torch

LOW_PASS = 0.3
ALPHA_MAX = 0.999
ALPHA_MIN = 1.0 / 255.0
TRANSMITTANCE_MIN = 1e-4
JACOBIAN_MARGIN = 0.3


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
