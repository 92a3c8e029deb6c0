# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive density control with illumination-guided gradient scaling (paper section 4.3).

Functions over an explicit state. A Gaussian whose mean screen gradient, times s_a, exceeds τ_p is cloned
when it is small and split when it is large; transparent and oversized ones are pruned; opacity is reset now
and then so that what nobody needs can vanish (all 3DGS's).
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import torch

from ..bounds import FromZero
from ..methods.base import Drawn, Method
from ..model.backbone import Attributes, BackboneConfig
from ..model.gaussians import Gaussians
from ..model.morton import morton_order
from ..rasterize.reference import rotation_matrices
from ..scene.camera import Camera
from .clearance import floating
from .growth import Growth, NoGaussiansLeftError, gradient_norm
from .optimisers import Optimiser

#: What a checkpoint calls the distances before which nothing is.
CLEARANCE = "clearance"
#: A split makes two, each this much smaller (3DGS).
SPLIT_SHRINK = 1.6
#: Clone up to this size, split above (share of the scene's extent).
CLONE_BELOW = 0.01
#: What a reset lowers opacities to.
RESET_OPACITY = 0.01


@dataclass(frozen=True, kw_only=True)
class GaussiansConfig(BackboneConfig):
    """3DGS's backbone: when and what to densify. Defaults: preset ``default``; see docs/method.md."""

    name: ClassVar[str] = "gaussians"
    splat_bytes: ClassVar[int] = 1000
    #: 17,600 became 162,000 to 188,000 (lab/notebook.md).
    growth_factor: ClassVar[int] = 10
    keeps_points: ClassVar[bool] = True

    #: Densification begins after this iteration.
    start: FromZero = 100
    #: Share of the training after which the number of Gaussians stays.
    stop: float = 0.6
    #: τ_p: mean norm of ∂L/∂(NDC position).
    threshold: float = 1e-4
    #: Prune Gaussians larger than this share of the extent (after the first reset). 3DGS's test of their size
    #: on the screen is not here: its program clears what that reads just before.
    prune_scale: float = 0.1
    #: Iterations between opacity resets; 0: never.
    reset_every: FromZero = 0
    #: Never more Gaussians than this; those with the largest gradients come first. 0: no bound.
    budget: FromZero = 60_000

    def stretched(self, steps: Callable[[int], int]) -> Self:
        return dataclasses.replace(
            self, start=steps(self.start), every=steps(self.every), reset_every=steps(self.reset_every)
        )

    def growing(self, iterations: int) -> tuple[int, int]:
        return self.start, round(self.stop * iterations)

    def first_gaussians(self, points: int) -> int:
        return points

    def numbers(self, attributes: Attributes) -> float:
        """Means, sizes, rotation, opacity, illumination; a colour for each coefficient; shares; context."""
        colours = (attributes.sh_degree + 1) ** 2 + attributes.lights
        return 12 + 3 * colours + attributes.context_size


@dataclass
class DensifyState:
    """Per-Gaussian statistics since the last densification."""

    gradient_sum: torch.Tensor
    visits: torch.Tensor

    @classmethod
    def empty(cls, gaussians: Gaussians) -> "DensifyState":
        zeros = torch.zeros(len(gaussians), device=gaussians.means.device)
        return cls(zeros, zeros.clone())


def observe(
    state: DensifyState,
    screen_gradient: torch.Tensor,
    drawn: Drawn,
    camera: Camera,
    config: GaussiansConfig,
) -> None:
    """Add one view's screen gradient ``[N, 2]`` (per pixel) to the statistics, in NDC and times s_a."""
    norm = gradient_norm(screen_gradient, drawn, camera, config)
    visible = drawn.rasterization.radii > 0
    state.gradient_sum += torch.where(visible, norm, torch.zeros_like(norm))
    state.visits += visible


def is_due(iteration: int, iterations: int, config: GaussiansConfig) -> bool:
    """Whether to densify after this iteration (counted from 1)."""
    return config.start < iteration < config.stop * iterations and iteration % config.every == 0


def reset_is_due(iteration: int, iterations: int, config: GaussiansConfig) -> bool:
    """Whether to reset the opacity after this iteration (counted from 1)."""
    return (
        config.reset_every > 0
        and iteration % config.reset_every == 0
        and iteration < config.stop * iterations
    )


@torch.no_grad()
def densify(
    method: Method,
    optimiser: Optimiser,
    state: DensifyState,
    iteration: int,
    config: GaussiansConfig,
    generator: torch.Generator,
    unwanted: torch.Tensor | None = None,
) -> DensifyState:
    """Clone, split and prune in one resampling, which also sorts by place (``morton``).

    ``unwanted`` ``[N]`` bool: Gaussians that go whatever they are. Returns fresh statistics. Raises
    ``NoGaussiansLeftError``, before anything is changed, where all of them would go.
    """
    gaussians, extent = method.gaussians, optimiser.extent
    count = len(gaussians)
    gradient = state.gradient_sum / state.visits.clamp_min(1.0)
    scales, opacities = gaussians.scales, gaussians.opacities
    largest = scales.max(dim=1).values

    pruned = opacities < config.prune_opacity
    if unwanted is not None:
        pruned |= unwanted
    grows = (gradient > config.threshold) & ~pruned
    if config.budget:
        room = max(config.budget - int((~pruned).sum()), 0)
        if int(grows.sum()) > room:
            kept = torch.where(grows, gradient, torch.full_like(gradient, -1.0)).topk(room).indices
            grows = torch.zeros_like(grows).index_fill_(0, kept, True)
    splits = grows & (largest > CLONE_BELOW * extent)
    oversized = torch.zeros_like(pruned)
    if config.reset_every and iteration > config.reset_every:  # what is split counts by its children's size
        size = torch.where(splits, largest / SPLIT_SHRINK, largest)
        oversized = size > config.prune_scale * extent
        pruned |= oversized

    index = torch.arange(count, device=gaussians.means.device)
    stay, clone, split = (index[~pruned & chosen] for chosen in (~splits, grows & ~splits, splits))
    source = torch.cat([stay, clone, split, split])
    if not len(source):
        raise _none_left(iteration, count, int(oversized.sum()), config.prune_scale * extent)
    fresh = torch.arange(len(source), device=source.device) >= len(stay)
    is_child = torch.arange(len(source), device=source.device) >= len(stay) + len(clone)

    rotation = rotation_matrices(gaussians.quaternions[split])
    noise = torch.randn(2, len(split), 3, generator=generator).to(scales)
    offsets = (rotation @ (noise * scales[split])[..., None]).squeeze(-1)
    means = gaussians.means.detach()[source]
    means[is_child] += offsets.reshape(-1, 3)

    # Where each Gaussian of the new list goes in memory: neighbours in space beside each other.
    order = morton_order(means)
    optimiser.resample(gaussians, source[order], fresh[order])
    gaussians.means.copy_(means[order])
    gaussians.log_scales[is_child[order]] -= math.log(SPLIT_SHRINK)
    return DensifyState.empty(gaussians)


def _none_left(iteration: int, count: int, oversized: int, limit: float) -> NoGaussiansLeftError:
    """``oversized`` of ``count`` Gaussians go because they are larger than ``limit`` (metres)."""
    return NoGaussiansLeftError(
        f"pruning after iteration {iteration} would remove all {count:,} Gaussians: {oversized:,} as larger "
        f"than {limit:.2g} m, {count - oversized:,} as nearly transparent or where nothing was photographed",
        "That size is a share of how far apart the cameras stand, next to nothing where they only turn: "
        "train again with --set backbone.reset_every=0, as the preset default has it, or with a larger "
        "--set backbone.prune_scale; where they are transparent, with a smaller "
        "--set backbone.prune_opacity. What was saved before is untouched.",
    )


@torch.no_grad()
def reset_opacity(method: Method, optimiser: Optimiser) -> None:
    """Lower every opacity to at most ``RESET_OPACITY``; what matters grows back."""
    logits = method.gaussians.opacity_logits
    limit = torch.logit(torch.tensor(RESET_OPACITY)).item()
    logits.clamp_(max=limit)
    optimiser.clear_moments(logits)


class GaussianGrowth(Growth):
    """The strategy bound to one training. ``seed``: of the places of split Gaussians.

    ``clearance`` ``[V]``, of ``cameras``: what is nearer is removed (``clearance.py``); None: nothing is.
    """

    def __init__(
        self,
        method: Method,
        optimiser: Optimiser,
        config: GaussiansConfig,
        iterations: int,
        seed: tuple[int, ...],
        cameras: Sequence[Camera] = (),
        clearance: torch.Tensor | None = None,
    ) -> None:
        self.cameras, self.clearance = cameras, clearance
        self.method, self.optimiser, self.config = method, optimiser, config
        self.iterations, self.seed = iterations, seed
        self.statistics = DensifyState.empty(method.gaussians)

    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        offsets = drawn.screen_offsets
        if (
            iteration < self.config.stop * self.iterations
            and offsets is not None
            and offsets.grad is not None
        ):
            observe(self.statistics, offsets.grad, drawn, camera, self.config)

    def control(self, iteration: int) -> None:
        if is_due(iteration, self.iterations, self.config):
            seed = np.random.SeedSequence([*self.seed, iteration]).generate_state(1)[0]
            generator = torch.Generator().manual_seed(int(seed))
            unwanted = None
            if self.clearance is not None:
                unwanted = floating(self.method.gaussians.means, self.cameras, self.clearance)
            self.statistics = densify(
                self.method, self.optimiser, self.statistics, iteration, self.config, generator, unwanted
            )
        if reset_is_due(iteration, self.iterations, self.config):
            reset_opacity(self.method, self.optimiser)

    def tensors(self) -> dict[str, torch.Tensor]:
        cleared = {} if self.clearance is None else {CLEARANCE: self.clearance}
        return dict(vars(self.statistics)) | cleared

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        self.statistics = DensifyState(**{name: tensors[name] for name in vars(self.statistics)})
        self.clearance = tensors.get(CLEARANCE)
