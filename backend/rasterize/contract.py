# SPDX-License-Identifier: GPL-3.0-or-later
"""What every rasteriser takes and gives, and what all of them do with a splat's limits (bridge/splatting.py).

Conventions (gsplat's, so that its pictures and ours are the same):

* a pixel's centre is at +0.5; a 2D covariance is low-pass filtered by + ``LOW_PASS`` on its diagonal;
* ``alpha = min(ALPHA_MAX, opacity · exp(−½ dᵀ Σ⁻¹ d))``; a contribution with less than ``ALPHA_MIN`` is
  skipped;
* front to back by camera-space depth (ties by index); a pixel is finished, *before* a Gaussian is
  added, when that Gaussian would bring its transmittance to ``TRANSMITTANCE_MIN`` or below;
* Gaussians nearer than ``NEAR_PLANE`` are not drawn;
* the Jacobian of the projection is evaluated with x/z and y/z clamped to the image plus a margin of
  ``JACOBIAN_MARGIN`` times the half field of view on every side;
* black background;
* a pixel's median depth is that of the Gaussian that brings its transmittance to ``MEDIAN_TRANSMITTANCE`` or
  below: unlike the mean, it is never between two surfaces.

A limit of the gradients: what a pixel's light behind a splat is, the backward pass takes from what is left of
the pixel's sum. Behind something 10² times as bright the digits of float32 leave an error of 4e-4 in it,
behind 10⁴ times as bright of 3 %.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from ...bridge.errors import BadValueError

#: The transmittance at which half of what a ray meets is before it.
MEDIAN_TRANSMITTANCE = 0.5


class CannotBeDrawnError(BadValueError):
    """Gaussians are not finite, or so large that they cannot be drawn: a training of them diverged.

    To programs it is a bad value like others.
    """

    @property
    def code(self) -> str:
        return "bad_value"


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


def refuse_too_many_pairs(gaussians: int, pairs: int, most: int) -> None:
    """Raise ``CannotBeDrawnError`` where more than ``most`` pairs of a Gaussian and a tile are drawn."""
    if pairs > most:
        raise CannotBeDrawnError(
            f"{gaussians} Gaussians touch {pairs} tiles of the picture, {pairs / gaussians:.0f} each",
            "Training diverged (their scales grew), or the picture is too large: draw it in parts.",
        )


def refuse_what_is_not_finite(tensors: Mapping[str, torch.Tensor | None]) -> None:
    """Raise ``CannotBeDrawnError`` with the name, row and value of the first NaN or infinity."""
    for name, tensor in tensors.items():
        # A sum of zeros unless something is NaN or infinite: one pass, no temporary of booleans.
        if tensor is None or torch.isfinite(tensor.detach().sum()) or torch.isfinite(tensor).all():
            continue
        row = int((~torch.isfinite(tensor)).nonzero()[0, 0])
        raise CannotBeDrawnError(
            f"{name}[{row}] of the Gaussians is not finite: {tensor[row].tolist()}",
            "Training diverged or a model file is damaged: lower the learning rates, or load another.",
        )
