# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw Gaussians: one function, one contract (``contract.py``), three implementations.

``reference`` is plain torch and the oracle of the tests; ``cpu`` is Numba; ``warp`` is NVIDIA Warp, for
CUDA cards, and for tests on the CPU. Nothing outside this package knows which one runs.
"""

from collections.abc import Callable
from typing import Literal

import torch

from ...bridge.errors import BadValueError
from ..scene.camera import Camera
from .card import warp_rasterize, warp_takes
from .contract import Rasterization
from .depth import depth_of

Implementation = Literal["auto", "reference", "cpu", "warp"]

__all__ = ["Implementation", "Rasterization", "median_depth", "rasterize"]


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    *,
    screen_offsets: torch.Tensor | None = None,
    with_depth: bool = False,
    implementation: Implementation = "auto",
) -> Rasterization:
    """Render Gaussians from a camera, differentiable in every tensor argument.

    ``means`` ``[N, 3]`` metres; ``quaternions`` ``[N, 4]`` wxyz, normalised here; ``scales`` ``[N, 3]``
    standard deviations in metres; ``opacities`` ``[N]`` in [0, 1]; ``colours`` ``[N, C]``, any values.
    ``screen_offsets`` ``[N, 2]``: added to the projected means, in pixels. Pass zeros that require a
    gradient to read ∂L/∂(screen position) from their ``.grad`` (densification does).
    Raises ``BadValueError`` for wrong shapes.
    """
    count = means.shape[0]
    expected = {
        "means": (means, (count, 3)),
        "quaternions": (quaternions, (count, 4)),
        "scales": (scales, (count, 3)),
        "opacities": (opacities, (count,)),
        "colours": (colours, (count, colours.shape[-1])),
    }
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape:
            raise BadValueError(f"{name} must have shape {list(shape)}, got {list(tensor.shape)}")

    if with_depth:
        view = camera.view_matrix(means)
        depths = means.detach() @ view[2, :3] + view[2, 3]
        colours = torch.cat([colours, depths[:, None]], dim=1)
    draw = _implementation(_chosen(implementation, means), means)
    result = draw(means, quaternions, scales, opacities, colours, camera, screen_offsets)
    if not with_depth:
        return result
    covered = result.alpha.detach() > 0
    depth = torch.where(covered, result.image[-1].detach() / result.alpha.detach().clamp_min(1e-12), 0.0)
    return Rasterization(result.image[:-1], result.alpha, result.radii, depth)


@torch.no_grad()
def median_depth(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    camera: Camera,
    *,
    implementation: Literal["auto", "reference", "cpu"] = "auto",
) -> torch.Tensor:
    """``[H, W]``: where along the camera's axis (metres) the transmittance of each pixel falls to one half.

    0 where less than half is covered. Arguments as of ``rasterize``; no gradient. ``auto``: of float64 by the
    reference, else on the CPU, where the result is then.
    """
    if implementation == "auto":
        implementation = "reference" if means.dtype == torch.float64 else "cpu"
    if implementation == "reference":
        from .reference import median_gaussian
    else:
        from .cpu.median import median_gaussian

        means, quaternions, scales, opacities = (
            each.cpu() for each in (means, quaternions, scales, opacities)
        )
    which = median_gaussian(means, quaternions, scales, opacities, camera)
    return depth_of(which, means, quaternions, scales, camera)


def _chosen(name: Implementation, means: torch.Tensor) -> Implementation:
    """What ``auto`` is: by where the tensors are, and their precision."""
    if name != "auto":
        return name
    if warp_takes(means):
        return "warp"
    return "reference" if means.is_cuda or means.dtype == torch.float64 else "cpu"


def _implementation(name: Implementation, means: torch.Tensor) -> Callable[..., Rasterization]:
    """The drawing function of that name."""
    # Imported late: Numba and Warp are heavy, and only one of them is needed.
    if name == "warp":
        draw = warp_rasterize()
    elif name == "cpu":
        from .cpu import rasterize as draw
    elif name == "reference":
        from .reference import rasterize as draw
    else:
        raise BadValueError(f"no rasteriser is called {name!r}", "Choose auto, reference, cpu or warp.")
    return draw
