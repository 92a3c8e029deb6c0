# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's method and its peers by preset: as published, and on the schedule of ``default``.

The published ones have their papers' 30,000 iterations in mind: rates, when growth starts, when opacities are
reset. ``…-short`` are the same methods on what ``default`` has for its backbone and schedule, and with faster
networks, so that a comparison at a few thousand iterations compares methods and not schedules.
"""

import dataclasses
from typing import Any

from ..backend.model.anchors import AnchorGrowthConfig, AnchorsConfig
from ..backend.train.config import TrainConfig
from ..backend.train.densify import DensifyConfig
from ..backend.train.optimisers import STOCK_3DGS, OptimiserConfig
from ..backend.train.presets import SHORT_TRAINING, as_published, baseline, on_anchors
from .peers.field import FieldConfig
from .peers.gausshdr import GaussHDRConfig
from .peers.hdr_gs import HDRGSConfig
from .peers.hdr_nerf import HDRNeRFConfig
from .peers.paper import PaperConfig

#: 3DGS's own densification, without a budget.
STOCK_DENSIFY = DensifyConfig(start=500, stop=0.5, reset_every=3000, budget=0, threshold=2e-4)


def paper(iterations: int = 30_000) -> TrainConfig:
    """The paper's Algorithm 1 with the open points filled as in lab/paper.md.

    Of photographs, too, it knows only what the paper knows.
    """
    return as_published(
        iterations=iterations,
        nuisances="off",
        far_shell="off",
        clear_cameras="off",
        half_size_until=0.0,
        sh_degree_every=1000,
        method=PaperConfig(),
        optimiser=STOCK_3DGS,
        densify=dataclasses.replace(STOCK_DENSIFY, scaling_strength=1.0),
    )


def on_3dgs(method: GaussHDRConfig | HDRGSConfig, iterations: int = 30_000) -> TrainConfig:
    """A peer on 3DGS with 3DGS's schedule, and one set of values for all scenes.

    GaussHDR on 3DGS is in its paper, but its code is not published.
    """
    return as_published(
        iterations=iterations,
        half_size_until=0.0,
        sh_degree_every=1000,
        method=method,
        optimiser=STOCK_3DGS,
        densify=STOCK_DENSIFY,
    )


def short(published: TrainConfig, iterations: int = 2500, networks_times: float = 10.0) -> TrainConfig:
    """A published method on the backbone's settings and the schedule of ``default``."""
    ours = TrainConfig()
    return dataclasses.replace(
        published,
        iterations=iterations,
        half_size_until=ours.half_size_until,
        sh_degree_every=ours.sh_degree_every,
        optimiser=OptimiserConfig(networks_times=networks_times),
        densify=dataclasses.replace(ours.densify, scaling_strength=published.densify.scaling_strength),
    )


def hdr_nerf(iterations: int = 200_000) -> TrainConfig:
    """HDR-NeRF as published for rendered data: 16 CPU seconds an iteration, which calls for a card."""
    return as_published(iterations=iterations, half_size_until=0.0, method=HDRNeRFConfig())


def hdr_nerf_small(iterations: int = 2500) -> TrainConfig:
    """HDR-NeRF in the seconds that others take on a CPU: smaller, with many short steps, and fewer octaves.

    What few steps can learn: high octaves would be noise, rays are better spent on steps than on batches.
    """
    method = HDRNeRFConfig(
        field=FieldConfig(depth=4, width=64, view_width=32, position_octaves=6, first_weights="he"),
        rays_per_iteration=64,
        coarse_samples=24,
        fine_samples=32,
        learning_rate=5e-3,
        final_rate_share=0.1,
    )
    return as_published(iterations=iterations, half_size_until=0.0, method=method)


def released_gausshdr() -> GaussHDRConfig:
    """GaussHDR on Scaffold-GS's backbone, as its released code has it: the global curve bends by ReLU."""
    config = GaussHDRConfig()
    return dataclasses.replace(config, tone_mapper=dataclasses.replace(config.tone_mapper, activation="relu"))


def equal(config: TrainConfig, **changes: Any) -> TrainConfig:
    """A method that starts where ``default`` starts, as opaque and as thin."""
    ours = TrainConfig()
    start = {name: getattr(ours, name) for name in ("initial_points", "initial_opacity", "initial_thickness")}
    return dataclasses.replace(config, **start | changes)


#: Scaffold-GS as published, and with the paper's s_a = σ(|L_a − L̂_a|) + 1 on the gradients.
PUBLISHED_ANCHORS = AnchorsConfig(base_radiance=False)
PAPER_ANCHORS = dataclasses.replace(PUBLISHED_ANCHORS, growth=AnchorGrowthConfig(scaling_strength=1.0))
SHORT_PAPER_ANCHORS = dataclasses.replace(
    SHORT_TRAINING, growth=dataclasses.replace(SHORT_TRAINING.growth, scaling_strength=1.0)
)

#: The Gaussians' are twice ``default``'s: of eight points the best for either method (plans/sweeps).
EQUAL_RATES = dataclasses.replace(
    short(paper()).optimiser,
    log_scales=2e-2,
    quaternions=8e-3,
    opacity_logits=1e-1,
    reflectance_dc=2e-2,
    reflectance_rest=2e-3,
)

PRESETS: dict[str, TrainConfig] = {
    "paper": paper(),
    "paper-scaffold": on_anchors(paper(), PAPER_ANCHORS),
    "paper-short": short(paper()),
    "paper-scaffold-short": on_anchors(short(paper()), SHORT_PAPER_ANCHORS),
    "gausshdr": on_3dgs(GaussHDRConfig()),
    "gausshdr-scaffold": on_anchors(on_3dgs(released_gausshdr()), PUBLISHED_ANCHORS),
    "hdr-gs": on_3dgs(HDRGSConfig()),
    "hdr-nerf": hdr_nerf(),
    "gausshdr-short": short(on_3dgs(GaussHDRConfig())),
    "gausshdr-scaffold-short": on_anchors(short(on_3dgs(GaussHDRConfig())), SHORT_TRAINING),
    # Its response, which nothing holds, falls where it learns faster; and all start from merged brackets.
    "hdr-gs-short": short(on_3dgs(HDRGSConfig(initial_radiance="merged")), networks_times=1.0),
    "hdr-nerf-small": hdr_nerf_small(),
    "baseline-equal": equal(baseline(), supervision="bracket"),
    "gausshdr-equal": equal(short(on_3dgs(GaussHDRConfig())), optimiser=EQUAL_RATES),
    "paper-equal": equal(short(paper()), optimiser=EQUAL_RATES),
}
