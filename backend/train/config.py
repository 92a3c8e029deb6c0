# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's whole configuration, its presets, and its file ``config.json``."""

import dataclasses
import json
import os
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError
from ..methods.gausshdr import GaussHDRConfig
from ..methods.hdr_gs import HDRGSConfig
from ..methods.hdr_nerf import HDRNeRFConfig
from ..methods.physhdr import PhysHDRConfig
from ..methods.registry import MethodConfig, config_named, entry_of
from ..model.anchors import AnchorGrowthConfig, AnchorsConfig
from ..model.field import FieldConfig
from ..model.tone_mapper import ToneMapperConfig
from .densify import DensifyConfig
from .initialise import Source
from .losses import LossConfig
from .optimisers import STOCK_3DGS, OptimiserConfig

CONFIG_FILE = "config.json"


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Everything that decides a run's result. Defaults are the preset ``default``."""

    iterations: int = 3000
    seed: int = 0
    #: exp3: every iteration draws one of the training exposures; exp1: one is drawn for each view and kept.
    exposure_mode: Literal["exp3", "exp1"] = "exp3"
    #: one: an iteration compares its view at one of its exposures; bracket: at all that training may see, of
    #: one drawing (the radiance is the same, only its development differs).
    supervision: Literal["one", "bracket"] = "one"
    #: Indices of the exposures that training may see (LDR-OE of the paper).
    training_exposures: tuple[int, ...] = (0, 2, 4)
    #: Pictures are reduced by this factor as they are read; None: as the layout's publication has it.
    downscale: float | None = None
    #: Start from the data set's points, from stereo between the training views, or from random ones in the
    #: cameras' frusta; auto: the data set's if it has any, else stereo's.
    initial_points: Source = "auto"
    random_points: int = 20_000
    initial_opacity: float = 0.1
    #: Initial size of a Gaussian over the distance to its neighbours (3DGS: 1).
    initial_scale: float = 1.0
    #: Of a data set with one light; of several each starts with as much as what no light turns.
    initial_ambient_share: float = 0.5
    #: Share of the training at whose start views are seen at half their width and height.
    half_size_until: float = 0.1
    #: The SH degree rises by one after this many iterations (3DGS: 1000).
    sh_degree_every: int = 150
    method: MethodConfig = field(default_factory=PhysHDRConfig)
    #: Scaffold-GS's backbone instead of 3DGS's.
    anchors: Annotated[AnchorsConfig | None, tyro.conf.AvoidSubcommands] = None
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    densify: DensifyConfig = field(default_factory=DensifyConfig)

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise BadValueError(f"--iterations must be at least 1, got {self.iterations}")
        if not self.training_exposures:
            raise BadValueError("there must be at least one training exposure", "For example 0 2 4.")


def paper(iterations: int = 30_000) -> TrainConfig:
    """The paper's Algorithm 1 with the open points filled as in docs/method.md; l = t."""
    return TrainConfig(
        iterations=iterations,
        half_size_until=0.0,
        sh_degree_every=1000,
        method=PhysHDRConfig(
            branches="both",
            lighting_level="exposure",
            composer="learned",
            modulator="learned",
            tone_mapper=ToneMapperConfig(
                anchored=False, initial_slope=None, local=True, mix=True, warm_start_steps=1000
            ),
            loss=LossConfig(
                pixel="mse",
                pixel_weight=0.2,
                dssim_weight=1.0,
                consistency_weight=0.5,
                consistency_domain="linear",
                unit_weight=0.5,
            ),
        ),
        optimiser=STOCK_3DGS,
        densify=DensifyConfig(
            start=500, stop=0.5, scaling_strength=1.0, reset_every=3000, budget=0, threshold=2e-4
        ),
    )


def baseline(iterations: int = 3000) -> TrainConfig:
    """The yardstick: the image-exposure branch alone under one global tone mapper."""
    return TrainConfig(
        iterations=iterations,
        method=PhysHDRConfig(
            branches="image-exposure",
            lighting_level="exposure",
            composer="product",
            tone_mapper=ToneMapperConfig(anchored=False, initial_slope=None, warm_start_steps=1000),
            loss=LossConfig(unit_weight=0.5),
        ),
    )


#: 3DGS's own densification, without a budget.
STOCK_DENSIFY = DensifyConfig(start=500, stop=0.5, reset_every=3000, budget=0, threshold=2e-4)


def gausshdr(iterations: int = 30_000) -> TrainConfig:
    """GaussHDR on 3DGS, whose code nobody has published: its tone mapper and losses, 3DGS's schedule."""
    return TrainConfig(
        iterations=iterations,
        half_size_until=0.0,
        sh_degree_every=1000,
        method=GaussHDRConfig(),
        optimiser=STOCK_3DGS,
        densify=STOCK_DENSIFY,
    )


def hdr_gs(iterations: int = 30_000) -> TrainConfig:
    """HDR-GS without HDR ground truth, one set of values for all scenes: 3DGS's schedule."""
    return TrainConfig(
        iterations=iterations,
        half_size_until=0.0,
        sh_degree_every=1000,
        method=HDRGSConfig(),
        optimiser=STOCK_3DGS,
        densify=STOCK_DENSIFY,
    )


def hdr_nerf(iterations: int = 200_000) -> TrainConfig:
    """HDR-NeRF as published for rendered data: 16 CPU seconds an iteration, which calls for a card."""
    return TrainConfig(iterations=iterations, half_size_until=0.0, method=HDRNeRFConfig())


def hdr_nerf_small(iterations: int = 400) -> TrainConfig:
    """HDR-NeRF within the seconds that others take on a CPU: smaller networks, fewer samples, faster rates."""
    field = FieldConfig(depth=4, width=64, view_width=32)
    method = HDRNeRFConfig(
        field=field,
        rays_per_iteration=512,
        coarse_samples=32,
        fine_samples=32,
        learning_rate=5e-3,
        final_rate_share=0.1,
    )
    return TrainConfig(iterations=iterations, half_size_until=0.0, method=method)


def fast(iterations: int = 1500) -> TrainConfig:
    """``default`` for the impatient: half of its iterations, more of them at half resolution."""
    return TrainConfig(iterations=iterations, half_size_until=0.2)


def on_anchors(config: TrainConfig, anchors: AnchorsConfig) -> TrainConfig:
    """The same method on Scaffold-GS's backbone, which has rates and a growth of its own."""
    return dataclasses.replace(config, anchors=anchors)


#: Scaffold-GS as published, with the paper's s_a = σ(|L_a − L̂_a|) + 1 on the gradients.
PAPER_ANCHORS = AnchorsConfig(growth=AnchorGrowthConfig(scaling_strength=1.0))
#: For short trainings on the CPU, where every anchor costs an evaluation of the networks.
FEWER_ANCHORS = AnchorsConfig(placement=32, growth=AnchorGrowthConfig(stop=0.6, budget=120_000))

#: Settings by names they had before → as they are called now.
RENAMED = {"ambient_share_logits": "light_share_logits"}

#: The presets by name. They differ in config fields only.
PRESETS: dict[str, TrainConfig] = {
    "default": TrainConfig(),
    "fast": fast(),
    "paper": paper(),
    "baseline": baseline(),
    "default-scaffold": on_anchors(TrainConfig(), FEWER_ANCHORS),
    "paper-scaffold": on_anchors(paper(), PAPER_ANCHORS),
    "baseline-scaffold": on_anchors(baseline(), FEWER_ANCHORS),
    "gausshdr": gausshdr(),
    "hdr-gs": hdr_gs(),
    "hdr-nerf": hdr_nerf(),
    "hdr-nerf-small": hdr_nerf_small(),
}


def write_config(path: Path, config: TrainConfig, data: Path, preset: str) -> None:
    """Write ``config.json``: with the data set it reproduces the run. Raises ``OutputError``."""
    values = dataclasses.asdict(config)
    values["method"] = {"name": entry_of(config.method).name} | values["method"]
    content = {"data": str(data.resolve()), "preset": preset, "config": values}
    temporary = path.with_suffix(".partial")
    try:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error}", "Choose another --out.") from error


def read_config(path: Path) -> tuple[TrainConfig, Path, str]:
    """The configuration, the data set's folder and the preset's name that ``write_config`` wrote."""
    if not path.is_file():
        raise FileMissingError(
            f"there is no {path}", "Name the folder of a run, as given to physhdr train --out."
        )
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        config = _from_dict(TrainConfig, content["config"])
        return config, Path(content["data"]), content["preset"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileDamagedError(f"{path} is not a run's configuration: {error}", "Train again.") from error


def _from_dict(cls: type, values: dict[str, Any]) -> Any:
    """A dataclass from the nested dictionary that ``dataclasses.asdict`` gave; unknown keys are refused."""
    hints = typing.get_type_hints(cls)
    arguments = {}
    for written, value in values.items():
        name = RENAMED.get(written, written)
        if name not in hints:
            raise KeyError(f"unknown setting {written!r}")
        hint = hints[name]
        if isinstance(value, dict) and not dataclasses.is_dataclass(hint):
            # One of several: a method says which it is (before there were others, it was PhysHDR).
            hint = config_named(value.pop("name", "physhdr")) if name == "method" else AnchorsConfig
        elif isinstance(value, dict):
            value.pop("name", None)
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            value = _from_dict(hint, value)
        elif typing.get_origin(hint) is tuple or isinstance(hint, types.GenericAlias):
            value = tuple(value)
        arguments[name] = value
    return cls(**arguments)
