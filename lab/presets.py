# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's method, its peers and Scaffold-GS's anchors by preset: as published, and as ``default``.

The published ones have their papers' 30,000 iterations in mind: rates, when growth starts, when opacities are
reset. ``…-short`` are the same methods on what ``default`` has for its backbone and schedule, and with faster
networks, so that a comparison at a few thousand iterations compares methods and not schedules.
"""

import dataclasses
from typing import Any

from ..backend.train.config import TrainConfig
from ..backend.train.densify import GaussiansConfig
from ..backend.train.optimisers import STOCK_3DGS, OptimiserConfig
from ..backend.train.presets import as_published, baseline
from .anchors.config import AnchorRates, AnchorsConfig
from .peers.field import FieldConfig
from .peers.gausshdr import GaussHDRConfig
from .peers.hdr_gs import HDRGSConfig
from .peers.hdr_nerf import HDRNeRFConfig
from .peers.paper import PaperConfig

#: 3DGS's own densification, without a budget.
STOCK_DENSIFY = GaussiansConfig(start=500, stop=0.5, reset_every=3000, budget=0, threshold=2e-4)


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
        backbone=dataclasses.replace(STOCK_DENSIFY, scaling_strength=1.0),
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
        backbone=STOCK_DENSIFY,
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
        backbone=GaussiansConfig(scaling_strength=published.backbone.scaling_strength),
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


#: For a tenth of the iterations and less, on a CPU, where every anchor costs an evaluation of the networks:
#: fewer anchors, and rates three times as large (lab/notebook.md has what was measured).
SHORT_TRAINING = AnchorsConfig(
    placement=32,
    rates=AnchorRates(
        features=0.0225,
        log_scaling=0.014,
        base_log_radiance=0.01,
        opacity=0.006,
        covariance=0.012,
        colour=0.024,
    ),
    stop=0.6,
    budget=120_000,
)
#: Scaffold-GS as published.
PUBLISHED_ANCHORS = AnchorsConfig(base_radiance=False)


def on_anchors(config: TrainConfig, anchors: AnchorsConfig = SHORT_TRAINING, **changes: Any) -> TrainConfig:
    """The same method on Scaffold-GS's backbone, which has rates and a growth of its own."""
    return dataclasses.replace(config, backbone=dataclasses.replace(anchors, **changes))


def default_scaffold(iterations: int = 2500) -> TrainConfig:
    """``default`` on anchors, whose iterations are dear: fewer Gaussians each, longer at half size.

    At equal iterations as good as Scaffold-GS's ten Gaussians an anchor, and cheaper (lab/notebook.md).
    """
    return on_anchors(TrainConfig(iterations=iterations, half_size_until=0.3), offsets=5)


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
    "default-scaffold": default_scaffold(),
    "baseline-scaffold": on_anchors(baseline()),
    "paper": paper(),
    # With the paper's s_a = σ(|L_a − L̂_a|) + 1 on the gradients.
    "paper-scaffold": on_anchors(paper(), PUBLISHED_ANCHORS, scaling_strength=1.0),
    "paper-short": short(paper()),
    "paper-scaffold-short": on_anchors(short(paper()), scaling_strength=1.0),
    "gausshdr": on_3dgs(GaussHDRConfig()),
    "gausshdr-scaffold": on_anchors(on_3dgs(released_gausshdr()), PUBLISHED_ANCHORS),
    "hdr-gs": on_3dgs(HDRGSConfig()),
    "hdr-nerf": hdr_nerf(),
    "gausshdr-short": short(on_3dgs(GaussHDRConfig())),
    "gausshdr-scaffold-short": on_anchors(short(on_3dgs(GaussHDRConfig()))),
    # Its response, which nothing holds, falls where it learns faster; and all start from merged brackets.
    "hdr-gs-short": short(on_3dgs(HDRGSConfig(initial_radiance="merged")), networks_times=1.0),
    "hdr-nerf-small": hdr_nerf_small(),
    "baseline-equal": equal(baseline(), supervision="bracket"),
    "gausshdr-equal": equal(short(on_3dgs(GaussHDRConfig())), optimiser=EQUAL_RATES),
    "paper-equal": equal(short(paper()), optimiser=EQUAL_RATES),
}
