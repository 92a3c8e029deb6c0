# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets by name: ours, and those that packages add, as ``lab/`` does."""

import functools
import operator
from typing import Any

from ...bridge.errors import BadValueError
from ..kernels.ahead import Needs
from ..methods.losses import LossConfig
from ..methods.physhdr_common import PhysHDRConfig
from ..model.tone_mapper import ToneMapperConfig
from ..tables import Table
from .config import TrainConfig
from .optimisers import OptimiserConfig


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


#: The presets by name, and those of packages. They differ in config fields only.
PRESETS: Table[TrainConfig] = Table(
    "presets",
    {
        "default": TrainConfig(),
        "fast": fast(),
        "high": high(),
        "baseline": baseline(),
    },
)


def preset_named(name: str) -> TrainConfig:
    """The preset's configuration; raises ``BadValueError`` naming those that there are."""
    if name not in PRESETS:
        raise BadValueError(f"there is no preset '{name}'", f"Choose from: {', '.join(PRESETS)}.")
    return PRESETS[name]


#: Channels that are drawn by some setting or other: radiance; with its ambient part, context or depth; all.
CHANNELS = (3, 4, 6, 7, 10)


def needed_by_presets() -> Needs:
    """The CPU kernels that the presets call, and drawing as many channels as any setting asks for."""
    needs = (config.method.kernels_needed() for config in PRESETS.values())
    return functools.reduce(operator.or_, needs, Needs(channels=CHANNELS))
