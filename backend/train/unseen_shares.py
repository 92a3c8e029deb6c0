# SPDX-License-Identifier: GPL-3.0-or-later
"""Shares of light where no photo under that light has looked, from beside them at the end of a training.

Photographs under other light are few, and see some of the room. A share is of the light that arrives,
whatever the colour of the surface, so that neighbours on the same surface have nearly the same. With w the
pixels that a Gaussian makes in views in which a light differs, and u the median of those that make any, its
share becomes (w s + d s') / (w + d), d = ``DOUBT`` u and s' the mean of its nearest neighbours that such
views see well. What the standard photos show does not change. The ambient light, where it never
changes, is all the rest.

On a rendered room of 100×100 pixels, photos left out gained 0.75, 0.06 and −0.03 dB (three lamps) where each
lamp was seen from one place, 0.23, −0.02 and 0.02 dB from two.
"""

from dataclasses import replace
from typing import Self

import numpy as np
import torch

from ...bridge.lights import AMBIENT
from ..model.gaussians import SH_C0, Gaussians
from ..scene.scene import View
from .plan import Plan
from .state import Part, State

#: What tells of a share as much as its neighbours do, and what is too little to be asked as a neighbour, as
#: shares of u. Of less than this nothing is seen, pixels.
DOUBT, SURE, NOTHING = 0.3, 0.6, 1e-3
#: What of splats learns nothing from counting pixels.
SHAPE = ("means", "quaternions", "scales", "opacities")
#: Nearest ones that are asked.
NEIGHBOURS = 12
#: How much one counts whose surface is turned by a right angle.
TURNED = 0.05
#: Shares, and what no light turns, are never less: a logit has to be finite.
LEAST = 1e-4


class UnseenShares(Part):
    """The light shares of plain Gaussians that no view under other light sees."""

    name = "unseen_shares"

    @classmethod
    def is_wanted(cls, plan: Plan) -> bool:
        return any(view.group for view in plan.seen.views) and plan.splats

    @classmethod
    def new(cls, state: State) -> Self:
        return cls(state)

    def __init__(self, state: State) -> None:
        self._state = state

    def step(self, batch: object) -> None:
        state = self._state
        if state.iteration == state.plan.iterations and isinstance(state.method.backbone, Gaussians):
            fill(state)


@torch.no_grad()
def fill(state: State) -> None:
    """Change ``light_share_logits``, and the mean colour where the standard light would look different."""
    gaussians, standard = state.method.gaussians, state.plan.seen.standard_levels
    before = gaussians.light_share
    seen = torch.stack([pixels_in(state, _changed(state, k)) for k in range(len(standard))], dim=1)
    share = filled(
        before.double().cpu().numpy(),
        seen.double().cpu().numpy(),
        gaussians.means.double().cpu().numpy(),
        normals(gaussians),
    )
    lights = state.plan.seen.lights
    if AMBIENT in lights and not _changed(state, ambient := lights.index(AMBIENT)):
        share = with_rest(share, ambient)
    logits = np.log(share) - np.log(1.0 - share.sum(axis=1, keepdims=True))
    gaussians.light_share_logits.copy_(torch.from_numpy(logits))
    offsets = torch.tensor(standard, dtype=before.dtype, device=before.device) - 1.0
    if offsets.any():
        was, now = (1.0 + torch.einsum("ncd,c->nd", s, offsets) for s in (before, gaussians.light_share))
        gaussians.reflectance_dc[:, 0] += (was / now).log() / SH_C0


def with_rest(share: np.ndarray, ambient: int) -> np.ndarray:
    """Shares ``[N, C, 3]`` where all light is the ambient one's that no other of the C lights causes.

    Where it never changes, nothing else tells its share from that of light that cannot be turned.
    """
    result = share.copy()
    result[:, ambient] = 0.0
    result[:, ambient] = (1.0 - LEAST - result.sum(axis=1)).clip(LEAST)
    return result / np.maximum(result.sum(axis=1, keepdims=True) / (1.0 - LEAST), 1.0)


def _changed(state: State, light: int) -> list[View]:
    """The training views in which a light is not as in the standard ones."""
    return [view for view in state.views if view.lighting_levels[light] != view.standard_levels[light]]


def pixels_in(state: State, views: list[View]) -> torch.Tensor:
    """``[N]``: how many pixels of ``views`` each Gaussian makes, by its blend weights.

    Σ of the weights is the gradient of the sum of the picture with respect to a Gaussian's colour.
    """
    method = state.method
    total = torch.zeros(method.size, device=method.device)
    for view in views:
        splats = method.backbone.splats(view.camera, method.active_sh_degree)
        shape = {
            name: getattr(splats, name).detach() for name in ("means", "quaternions", "scales", "opacities")
        }
        colours = torch.zeros(len(total), 3, device=method.device, requires_grad=True)
        with torch.enable_grad():
            drawn = method.rasterize(replace(splats, **shape), colours, view.camera)
            drawn.image[0].sum().backward()
        assert colours.grad is not None
        total += colours.grad[:, 0]
    return total


def normals(gaussians: Gaussians) -> np.ndarray:
    """``[N, 3]``: the shortest axis of each Gaussian, of either sign."""
    from scipy.spatial.transform import Rotation  # here, because only this needs it

    turned = gaussians.quaternions.double().cpu().numpy()[:, [1, 2, 3, 0]]
    axes = Rotation.from_quat(turned).as_matrix()
    shortest = gaussians.scales.argmin(dim=1).cpu().numpy()
    return axes[np.arange(len(axes)), :, shortest]


def filled(share: np.ndarray, seen: np.ndarray, positions: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Shares ``[N, C, 3]``, known by as many pixels as ``seen`` ``[N, C]``, with neighbours' for the rest.

    ``positions`` ``[N, 3]`` metres, ``normal`` ``[N, 3]``. Of each Gaussian and colour they
    and what is left of 1 are at least ``LEAST``.
    """
    from scipy.spatial import KDTree  # here, because only this needs it

    result = share.copy()
    for light, pixels in enumerate(seen.T):
        if not (pixels > NOTHING).any():
            continue  # nobody saw it change
        usual = float(np.median(pixels[pixels > NOTHING]))
        sure, unsure = np.flatnonzero(pixels >= SURE * usual), np.flatnonzero(pixels < SURE * usual)
        if not len(unsure):
            continue
        count = min(NEIGHBOURS, len(sure))
        found = KDTree(positions[sure]).query(positions[unsure], k=count)
        distance, near = (np.reshape(each, (len(unsure), count)) for each in found)
        near = sure[near]
        facing = np.abs(np.einsum("nd,nkd->nk", normal[unsure], normal[near]))
        scale = distance.mean(axis=1, keepdims=True) + 1e-9
        weight = (TURNED + facing**4) / (0.1 + (distance / scale) ** 2)
        mean = np.einsum("nk,nkd->nd", weight, share[near, light]) / weight.sum(axis=1, keepdims=True)
        own = pixels[unsure, None] / usual
        result[unsure, light] = (own * share[unsure, light] + DOUBT * mean) / (own + DOUBT)
    result = result.clip(LEAST)
    return result / np.maximum(result.sum(axis=1, keepdims=True) / (1.0 - LEAST), 1.0)
