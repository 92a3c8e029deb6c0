# SPDX-License-Identifier: GPL-3.0-or-later
"""Anchors as plain Gaussians: what cameras see of them, fixed once, for files and viewers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch.nn.functional import normalize

from ...bridge.errors import BadValueError
from ..kernels.spherical_harmonics import Y0, evaluate_sh_reference
from ..scene.camera import Camera
from ..scene.resident import camera_tensors
from .gaussians import Gaussians

if TYPE_CHECKING:
    from .anchors import Anchors

#: Anchors that are fixed at once: the normal equations of k Gaussians each fit into memory.
CHUNK = 4096
#: Ridge on the directional coefficients, against the mean square of a view's basis (0.08 each).
RIDGE = 1e-3
#: A Gaussian that a view has switched off says little of its colour there, but more than nothing.
LEAST_WEIGHT = 1e-3
#: Opacities are kept this far from 0 and 1, where their logits end.
OPACITY_MARGIN = 1e-4


@torch.no_grad()
def fix_anchors(anchors: Anchors, cameras: Sequence[Camera]) -> Gaussians:
    """Plain Gaussians of ``anchors``, as nearly as can be what ``cameras`` see; none: ``BadValueError``.

    Opacity and covariance are those of the mean viewing direction of the cameras that have the anchor in
    their picture; ln H_r is fitted by least squares in spherical harmonics to what the network says in the
    directions that they really see it from, weighted by the opacity there; illumination, shares of light and
    context have no direction and stay. What no camera sees is left out. Lost are opacities and shapes that
    change with the direction (docs/method.md says what that costs), and details finer than the harmonics.
    """
    if not cameras:
        raise BadValueError("anchors can only be fixed for cameras", "Give the training cameras.")
    visible = torch.zeros(len(cameras), len(anchors), dtype=torch.bool, device=anchors.positions.device)
    for flags, camera in zip(visible, cameras, strict=True):
        flags[anchors.in_frustum(camera)] = True
    some = visible.any(dim=0).nonzero().squeeze(1)
    if not len(some):
        raise BadValueError("none of the cameras sees an anchor", "Give the training cameras.")
    parts = [_fix(anchors, cameras, visible, chunk) for chunk in some.split(CHUNK)]
    return Gaussians(
        {name: torch.cat([part[name] for part in parts]).requires_grad_() for name in parts[0]},
        anchors.attributes,
    )


def _fix(
    anchors: Anchors, cameras: Sequence[Camera], visible: torch.Tensor, chunk: torch.Tensor
) -> dict[str, torch.Tensor]:
    """Parameters of the Gaussians of the anchors ``chunk`` ``[A]``, each seen by a camera."""
    k, positions = anchors.config.offsets, anchors.positions[chunk]
    viewpoints = [camera_tensors(camera, positions).position for camera in cameras]
    directions = torch.stack([normalize(positions - viewpoint, dim=1) for viewpoint in viewpoints])
    mean_direction = normalize((directions * visible[:, chunk, None]).sum(0), dim=1)
    said = anchors.outputs(chunk, mean_direction)
    drawn = (said["opacity"] > 0).nonzero().squeeze(1)
    splats = anchors.neural_gaussians(said, chunk, drawn, said["opacity"].new_zeros(len(chunk)))

    coefficients = (anchors.attributes.sh_degree + 1) ** 2
    normal = positions.new_zeros(len(drawn), coefficients, coefficients)
    right = positions.new_zeros(len(drawn), coefficients, 3)
    weight_sum = positions.new_zeros(len(drawn))
    for c, viewpoint in enumerate(viewpoints):
        # The networks say it of every anchor; views that do not have it in their picture weigh nothing.
        here = anchors.outputs(chunk, directions[c])
        weight = here["opacity"][drawn].clamp_min(LEAST_WEIGHT) * visible[c, chunk][drawn // k]
        colour = here["colour"][drawn] + _base(anchors, chunk)[drawn // k]
        basis = sh_basis(splats.means, viewpoint, anchors.attributes.sh_degree)
        weighted = basis * weight[:, None]
        normal += weighted[:, :, None] * basis[:, None, :]
        right += weighted[:, :, None] * colour[:, None, :]
        weight_sum += weight
    ridge = torch.full_like(normal[0, 0], RIDGE)
    ridge[0] = 0.0
    normal += weight_sum[:, None, None] * torch.diag(ridge)
    fitted = torch.linalg.solve(normal, right)

    parameters = {
        "means": splats.means,
        "log_scales": splats.scales.log(),
        "quaternions": normalize(splats.quaternions, dim=1),
        "opacity_logits": splats.opacities.clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN).logit(),
        "reflectance_dc": fitted[:, :1],
        "reflectance_rest": fitted[:, 1:],
        "log_illumination": splats.log_illumination,
    }
    if "light_share" in said:
        parameters["light_share_logits"] = said["light_share"][drawn].reshape(len(drawn), -1, 3)
    if splats.context is not None:
        parameters["context"] = splats.context
    return {name: tensor.contiguous() for name, tensor in parameters.items()}


def _base(anchors: Anchors, chunk: torch.Tensor) -> torch.Tensor:
    """What the network's colour is added to, ``[A, 3]``."""
    base = anchors.parameters.get("base_log_radiance")
    return anchors.positions.new_zeros(len(chunk), 3) if base is None else base[chunk]


def sh_basis(means: torch.Tensor, viewpoint: torch.Tensor, degree: int) -> torch.Tensor:
    """Y₀ … of the directions from ``viewpoint`` ``[3]`` to ``means`` ``[M, 3]``: ``[M, (degree + 1)²]``.

    Read off ``evaluate_sh_reference``, three functions at a time, so that there is one definition of them.
    """
    count = (degree + 1) ** 2 - 1
    basis = means.new_full((means.shape[0], count + 1), Y0)
    for first in range(0, count, 3):
        coefficients = means.new_zeros(1, count, 3)
        for channel in range(3):
            coefficients[0, first + channel, channel] = 1.0
        rest, dc = coefficients.expand(means.shape[0], -1, -1), means.new_zeros(means.shape[0], 3)
        basis[:, 1 + first : 4 + first] = evaluate_sh_reference(dc, rest, means, viewpoint, degree)
    return basis
