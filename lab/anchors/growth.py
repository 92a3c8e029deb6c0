# SPDX-License-Identifier: GPL-3.0-or-later
"""Growing and pruning of Scaffold-GS's anchors.

Where the screen gradient of a neural Gaussian is large on average, an anchor is put into its cell if there is
none, on three levels: the finer the cell, the larger the gradient must be. Anchors whose Gaussians stay
transparent go. Functions over an explicit state, as ``densify``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...backend.methods.base import Drawn, Method
from ...backend.model.morton import morton_order
from ...backend.scene.camera import Camera
from ...backend.train.growth import Growth, NoGaussiansLeftError, gradient_norm
from ...backend.train.optimisers import Optimiser
from .backbone import LARGEST_LOG_SCALE, Anchors, AnchorSplats
from .config import AnchorsConfig


@dataclass
class AnchorStatistics:
    """Since an anchor (a Gaussian of it) was last judged.

    ``opacity_sum`` and ``visits`` ``[N]``: of anchors in the frustum. ``gradient_sum`` and ``draws``
    ``[N·k]``: norms of ∂L/∂(NDC position), of Gaussians that were drawn.
    """

    opacity_sum: torch.Tensor
    visits: torch.Tensor
    gradient_sum: torch.Tensor
    draws: torch.Tensor

    @classmethod
    def empty(cls, anchors: Anchors) -> "AnchorStatistics":
        device = anchors.positions.device
        each, gaussians = (torch.zeros(n, device=device) for n in (len(anchors), anchors.gaussian_count))
        return cls(each, each.clone(), gaussians, gaussians.clone())


@dataclass(frozen=True)
class NewAnchors:
    """Where anchors are added: ``positions`` ``[A, 3]``, the ``cell`` of each ``[A]``, metres.

    ``features`` ``[A, F]``; ``parents`` ``[A]`` int64: whose other parameters they inherit.
    """

    positions: torch.Tensor
    cell: torch.Tensor
    features: torch.Tensor
    parents: torch.Tensor


def observe(
    state: AnchorStatistics,
    screen_gradient: torch.Tensor,
    drawn: Drawn,
    camera: Camera,
    config: AnchorsConfig,
) -> None:
    """Add one view's screen gradient ``[M, 2]`` (per pixel), in NDC, and the opacities to the statistics."""
    splats = drawn.splats
    assert isinstance(splats, AnchorSplats)
    k = state.draws.shape[0] // state.visits.shape[0]
    norm = gradient_norm(screen_gradient, drawn, camera, config)
    on_screen = drawn.rasterization.radii > 0
    row = splats.drawn.div(k, rounding_mode="floor")
    gaussian = splats.seen.index_select(0, row) * k + splats.drawn - row * k
    # No index comes twice, so plain assignment adds.
    state.gradient_sum[gaussian] += torch.where(on_screen, norm, torch.zeros_like(norm))
    state.draws[gaussian] += on_screen
    state.opacity_sum[splats.seen] += splats.opacity_sum
    state.visits[splats.seen] += 1.0


def grown(
    anchors: Anchors,
    gradient: torch.Tensor,
    eligible: torch.Tensor,
    config: AnchorsConfig,
    generator: torch.Generator,
) -> NewAnchors:
    """New anchors for the Gaussians that need them; ``gradient`` and ``eligible`` ``[N·k]``.

    A level takes part if the one before added anchors (Scaffold-GS's rule, the coarsest always does).
    """
    k, parameters = anchors.config.offsets, anchors.parameters
    positions = anchors.positions.detach()
    room = max(config.budget // k - len(anchors), 0) if config.budget else None
    found: list[NewAnchors] = []
    for level in range(config.levels):
        chance = torch.rand(gradient.shape, generator=generator).to(gradient.device)
        wanted = eligible & (gradient >= config.threshold * 2.0**level) & (chance > 0.5 ** (level + 1))
        if level and not found:
            break
        gaussian = wanted.nonzero().squeeze(1)
        parent = gaussian.div(k, rounding_mode="floor")
        unit = parameters["log_scaling"].detach()[parent, :3].exp()
        offset = parameters["offsets"].detach().flatten(0, 1)[gaussian]
        cell = anchors.voxel_size * max(config.coarsest // config.refinement**level, 1)
        new = _in_empty_cells(
            positions[parent] + offset * unit,
            torch.cat([positions, *(each.positions for each in found)]),
            cell,
            parent,
            gradient[gaussian],
            parameters["features"].detach(),
            room,
        )
        if len(new.parents):
            found.append(new)
            room = None if room is None else room - len(new.parents)
    if not found:
        nothing = torch.zeros(0, dtype=torch.int64, device=positions.device)
        return NewAnchors(positions[:0], positions[:0, 0], parameters["features"].detach()[:0], nothing)
    columns = zip(*(vars(each).values() for each in found), strict=True)
    return NewAnchors(*(torch.cat(column) for column in columns))


def _in_empty_cells(
    candidates: torch.Tensor,
    taken: torch.Tensor,
    cell: float,
    parent: torch.Tensor,
    gradient: torch.Tensor,
    features: torch.Tensor,
    room: int | None,
) -> NewAnchors:
    """One anchor in each cell of ``candidates`` ``[M, 3]`` that none of ``taken`` is in, at most ``room``.

    The cells with the largest ``gradient`` come first. A new anchor has the largest of its candidates'
    features, channel by channel, and otherwise the candidate with the largest gradient for its parent.
    """
    cells = torch.round(torch.cat([taken, candidates]) / cell)
    unique, member = torch.unique(cells, dim=0, return_inverse=True)
    is_free = torch.ones(len(unique), dtype=torch.bool, device=unique.device)
    is_free[member[: len(taken)]] = False
    member = member[len(taken) :]
    largest = gradient.new_zeros(len(unique)).scatter_reduce(0, member, gradient, "amax")
    chosen = is_free.nonzero().squeeze(1)
    if room is not None and len(chosen) > room:
        chosen = chosen[largest[chosen].topk(room, sorted=False).indices].sort().values
    # Among candidates of one cell the last assignment would win by chance: sorted, the largest does.
    best = torch.zeros(len(unique), dtype=torch.int64, device=unique.device)
    is_best = gradient == largest[member]
    best = best.scatter_reduce(0, member[is_best], parent[is_best], "amax")
    columns = member[:, None].expand(-1, features.shape[1])
    merged = features.new_full((len(unique), features.shape[1]), -torch.inf)
    merged = merged.scatter_reduce(0, columns, features[parent], "amax")
    return NewAnchors(
        unique[chosen] * cell, torch.full_like(largest[chosen], cell), merged[chosen], best[chosen]
    )


@torch.no_grad()
def grow_and_prune(
    anchors: Anchors,
    optimiser: Optimiser,
    state: AnchorStatistics,
    config: AnchorsConfig,
    generator: torch.Generator,
) -> AnchorStatistics:
    """Both in one resampling, which also sorts by place (``morton``). Returns the statistics that remain.

    Raises ``NoGaussiansLeftError``, before anything is changed, if nothing would be left.
    """
    k, count = anchors.config.offsets, len(anchors)
    judged = state.draws > config.every * config.seen_share * 0.5
    gradient = state.gradient_sum / state.draws.clamp_min(1.0)
    new = grown(anchors, gradient, judged, config, generator)
    gradient_sum = state.gradient_sum.masked_fill(judged, 0.0)
    draws = state.draws.masked_fill(judged, 0.0)

    known = state.visits > config.every * config.seen_share
    pruned = known & (state.opacity_sum < config.prune_opacity * state.visits)
    opacity_sum, visits = state.opacity_sum.masked_fill(known, 0.0), state.visits.masked_fill(known, 0.0)

    index = torch.arange(count, device=pruned.device)
    source = torch.cat([index[~pruned], new.parents])
    if not len(source):
        raise NoGaussiansLeftError(
            f"pruning would remove all {count:,} anchors: what they draw is nearly transparent",
            "Train again with a smaller --set backbone.prune_opacity. What was saved before is untouched.",
        )
    positions = torch.cat([anchors.positions.detach()[~pruned], new.positions])
    order = morton_order(positions)
    source = source[order]
    is_new = order >= count - int(pruned.sum())
    newest = order[is_new] - (len(order) - len(new.parents))  # which of ``new`` each new row is
    optimiser.resample(anchors, source, is_new)

    parameters = anchors.parameters
    parameters["anchors"][is_new] = new.positions[newest]
    parameters["features"][is_new] = new.features[newest]
    parameters["offsets"][is_new] = 0.0
    parameters["log_scaling"][is_new] = new.cell[newest].log()[:, None]
    parameters["log_scaling"][:, 3:].clamp_(max=LARGEST_LOG_SCALE)

    def moved(statistic: torch.Tensor) -> torch.Tensor:
        return statistic[source].masked_fill(is_new, 0.0)

    def moved_each(statistic: torch.Tensor) -> torch.Tensor:
        rows = statistic.reshape(count, k)[source]
        return rows.masked_fill(is_new[:, None], 0.0).reshape(-1)

    return AnchorStatistics(moved(opacity_sum), moved(visits), moved_each(gradient_sum), moved_each(draws))


class AnchorGrowth(Growth):
    """The strategy bound to one training of a method on anchors. ``seed``: of the choice of candidates.

    No anchor is removed before a camera: ``cameras`` and ``clearance`` are ``GaussianGrowth``'s.
    """

    def __init__(
        self,
        method: Method,
        optimiser: Optimiser,
        config: AnchorsConfig,
        iterations: int,
        seed: tuple[int, ...],
        cameras: Sequence[Camera] = (),
        clearance: torch.Tensor | None = None,
    ) -> None:
        assert isinstance(method.backbone, Anchors)
        self.anchors, self.optimiser, self.config = method.backbone, optimiser, config
        self.iterations, self.seed = iterations, seed
        self.statistics = AnchorStatistics.empty(self.anchors)

    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        offsets, config = drawn.screen_offsets, self.config
        is_time = config.observe_from <= iteration / self.iterations < config.stop
        if is_time and offsets is not None and offsets.grad is not None:
            observe(self.statistics, offsets.grad, drawn, camera, config)

    def control(self, iteration: int) -> None:
        config = self.config
        is_time = config.start < iteration / self.iterations < config.stop
        if is_time and iteration % config.every == 0:
            seed = np.random.SeedSequence([*self.seed, iteration]).generate_state(1)[0]
            generator = torch.Generator().manual_seed(int(seed))
            self.statistics = grow_and_prune(self.anchors, self.optimiser, self.statistics, config, generator)

    def tensors(self) -> dict[str, torch.Tensor]:
        """The statistics, and the voxel, which depends on the points of the start."""
        voxel = torch.tensor(self.anchors.voxel_size, dtype=torch.float64)
        return dict(vars(self.statistics)) | {"voxel_size": voxel}

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        tensors = dict(tensors)
        self.anchors.voxel_size = float(tensors.pop("voxel_size"))
        self.statistics = AnchorStatistics(**tensors)
