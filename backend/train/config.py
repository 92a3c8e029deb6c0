# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's whole configuration, its presets, and its file ``config.json``."""

import dataclasses
import json
import os
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError
from ..methods.physhdr import PhysHDRConfig
from ..methods.registry import MethodConfig, config_named, entry_of
from ..model.anchors import AnchorsConfig
from .densify import DensifyConfig
from .initialise import Source
from .optimisers import OptimiserConfig

CONFIG_FILE = "config.json"


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Everything that decides a run's result. Defaults are the preset ``default``."""

    iterations: int = 2500
    seed: int = 0
    #: exp3: a view is seen at all training exposures; exp1: at one of them, drawn for each view and kept.
    exposure_mode: Literal["exp3", "exp1"] = "exp3"
    #: one: an iteration compares its view at one of its exposures, drawn anew; bracket: at all that training
    #: may see, of one drawing (the radiance is the same, only its development differs).
    supervision: Literal["one", "bracket"] = "bracket"
    #: Indices of the exposures that training may see (LDR-OE of the paper).
    training_exposures: tuple[int, ...] = (0, 2, 4)
    #: Pictures are reduced by this factor as they are read; None: as the layout's publication has it.
    downscale: float | None = None
    #: Start from the data set's points, from stereo between the training views, or from random ones in the
    #: cameras' frusta; both: the data set's and, where it has none, stereo's; auto: the data set's if it has
    #: any, else stereo's.
    initial_points: Source = "both"
    random_points: int = 20_000
    #: 3DGS: 0.1. Points of surfaces are opaque; less leaves time for what lies before them to hide them.
    initial_opacity: float = 0.3
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
    anchors: AnchorsConfig | None = None
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    densify: DensifyConfig = field(default_factory=DensifyConfig)

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise BadValueError(f"--iterations must be at least 1, got {self.iterations}")
        if not self.training_exposures:
            raise BadValueError("there must be at least one training exposure", "For example 0 2 4.")


#: Settings by names they had before → as they are called now.
RENAMED = {"ambient_share_logits": "light_share_logits"}


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
