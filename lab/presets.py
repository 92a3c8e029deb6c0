# SPDX-License-Identifier: GPL-3.0-or-later
"""The peers by preset: as published, and on the schedule of ``default`` (``backend/train/presets.py``)."""

import dataclasses

from ..backend.model.anchors import AnchorsConfig
from ..backend.train.config import TrainConfig
from ..backend.train.densify import DensifyConfig
from ..backend.train.optimisers import STOCK_3DGS
from ..backend.train.presets import SHORT_TRAINING, as_published, on_anchors, short
from .peers.field import FieldConfig
from .peers.gausshdr import GaussHDRConfig
from .peers.hdr_gs import HDRGSConfig
from .peers.hdr_nerf import HDRNeRFConfig

#: 3DGS's own densification, without a budget.
STOCK_DENSIFY = DensifyConfig(start=500, stop=0.5, reset_every=3000, budget=0, threshold=2e-4)


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


#: Scaffold-GS as published.
PUBLISHED_ANCHORS = AnchorsConfig(base_radiance=False)

PRESETS: dict[str, TrainConfig] = {
    "gausshdr": on_3dgs(GaussHDRConfig()),
    "gausshdr-scaffold": on_anchors(on_3dgs(released_gausshdr()), PUBLISHED_ANCHORS),
    "hdr-gs": on_3dgs(HDRGSConfig()),
    "hdr-nerf": hdr_nerf(),
    "gausshdr-short": short(on_3dgs(GaussHDRConfig())),
    "gausshdr-scaffold-short": on_anchors(short(on_3dgs(GaussHDRConfig())), SHORT_TRAINING),
    # Its response, which nothing holds, falls where it learns faster; and all start from merged brackets.
    "hdr-gs-short": short(on_3dgs(HDRGSConfig(initial_radiance="merged")), networks_times=1.0),
    "hdr-nerf-small": hdr_nerf_small(),
}
