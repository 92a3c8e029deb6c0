# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets by name: ours, and those that packages add, as ``lab/`` does."""

import dataclasses
import functools
import operator
from typing import Any

from ..kernels.ahead import Needs
from ..methods.losses import LossConfig
from ..methods.physhdr_common import PhysHDRConfig
from ..model.anchors import AnchorGrowthConfig, AnchorRates, AnchorsConfig
from ..model.tone_mapper import ToneMapperConfig
from ..tables import Table
from .config import TrainConfig
from .optimisers import OptimiserConfig

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
    growth=AnchorGrowthConfig(stop=0.6, budget=120_000),
)


def as_published(**settings: Any) -> TrainConfig:
    """Without what ``default`` alone does about its start and the pictures of an iteration."""
    published: dict[str, Any] = {
        "supervision": "one",
        "initial_points": "auto",
        "initial_opacity": 0.1,
        "initial_size_limit": 0.0,
        "initial_thickness": 1.0,
        "merged_brackets": "off",
        "poses": "off",
    }
    return TrainConfig(**published | settings)


def baseline(iterations: int = 2500) -> TrainConfig:
    """The yardstick: the image-exposure branch alone under one global tone mapper."""
    return as_published(
        iterations=iterations,
        initial_size_limit=TrainConfig().initial_size_limit,
        poses="auto",
        method=PhysHDRConfig(
            illumination_branch=False,
            tone_mapper=ToneMapperConfig(anchored=False, initial_slope=None, warm_start_steps=1000),
            loss=LossConfig(unit_weight=0.5),
        ),
        optimiser=OptimiserConfig(networks_times=10.0),
    )


def fast(iterations: int = 1250) -> TrainConfig:
    """``default`` for the impatient: half of its iterations."""
    return TrainConfig(iterations=iterations)


def high(iterations: int = 10_000) -> TrainConfig:
    """``default`` for a night: four times its iterations. More Gaussians lose (lab/notebook.md)."""
    return TrainConfig(iterations=iterations, sh_degree_every=4 * TrainConfig().sh_degree_every)


def on_anchors(config: TrainConfig, anchors: AnchorsConfig) -> TrainConfig:
    """The same method on Scaffold-GS's backbone, which has rates and a growth of its own."""
    return dataclasses.replace(config, anchors=anchors)


def default_scaffold(iterations: int = 2500) -> TrainConfig:
    """``default`` on anchors, whose iterations are dear: fewer Gaussians each, longer at half size.

    At equal iterations as good as Scaffold-GS's ten Gaussians an anchor, and cheaper (lab/notebook.md).
    """
    config = TrainConfig(iterations=iterations, half_size_until=0.3)
    return on_anchors(config, dataclasses.replace(SHORT_TRAINING, offsets=5))


#: The presets by name, and those of packages. They differ in config fields only.
PRESETS: Table[TrainConfig] = Table(
    "presets",
    {
        "default": TrainConfig(),
        "fast": fast(),
        "high": high(),
        "baseline": baseline(),
        "default-scaffold": default_scaffold(),
        "baseline-scaffold": on_anchors(baseline(), SHORT_TRAINING),
    },
)

#: Channels that are drawn by some setting or other: radiance; with its ambient part, context or depth; all.
CHANNELS = (3, 4, 6, 7, 10)


def needed_by_presets() -> Needs:
    """The CPU kernels that the presets call, and drawing as many channels as any setting asks for."""
    needs = (config.method.kernels_needed() for config in PRESETS.values())
    return functools.reduce(operator.or_, needs, Needs(channels=CHANNELS))
