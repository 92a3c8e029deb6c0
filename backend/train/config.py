# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's whole configuration, its presets, and its file ``config.json``."""

import dataclasses
import hashlib
import json
import math
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ...bridge.regular import read_json_object, resolved
from ...bridge.run_folder import CONFIG_FILE as CONFIG_FILE
from ..bounds import Bounds, FromZero, bounds_of
from ..methods.base import MethodConfig
from ..methods.physhdr_common import PhysHDRConfig
from ..methods.registry import METHODS
from ..model.backbone import BackboneConfig
from ..shell import option
from ..start.initialise import Source
from ..tables import Table
from .backbones import BACKBONES
from .densify import GaussiansConfig
from .optimisers import OptimiserConfig

#: Ten million: more than anybody trains, and exact in every number that counts them.
ITERATIONS_MAX = 10_000_000
#: Characters of a preset's name, which stands in reports and exported files.
LONGEST_NAME = 100
#: No weight, rate or threshold is larger; a million times as large is still no infinity in float32.
LARGEST_NUMBER = 1e9
#: Settings whose class a name in ``config.json`` leads to: its table, and the name where there is none.
_NAMED: dict[type, tuple[Table[Any], str]] = {
    MethodConfig: (METHODS, PhysHDRConfig.name),
    BackboneConfig: (BACKBONES, GaussiansConfig.name),
}

#: auto: as the data ask for it.
Switch = Literal["auto", "on", "off"]


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Everything that decides a run's result. Defaults are the preset ``default``."""

    #: Length of the training; larger data get more unless this is given.
    iterations: Annotated[int, Bounds(1, ITERATIONS_MAX)] = 2500
    #: Of all random numbers.
    seed: FromZero = 0
    #: exp3: a view is seen at all training exposures; exp1: at one of them, drawn for each view and kept.
    exposure_mode: Literal["exp3", "exp1"] = "exp3"
    #: one: an iteration compares its view at one of its exposures, drawn anew; bracket: at all that training
    #: may see, of one drawing (the radiance is the same, only its development differs).
    supervision: Literal["one", "bracket"] = "bracket"
    #: Indices of the exposures that training may see (LDR-OE of the paper).
    training_exposures: tuple[int, ...] = (0, 2, 4)
    #: Pictures are reduced by this factor as they are read; None: as the layout's publication has it.
    downscale: float | None = None
    #: Of pictures that hold radiance (OpenEXR, .hdr), by name; None: as each file says, Linear Rec.709 where
    #: none does.
    color_space: str | None = None
    #: Where Gaussians start: at the data set's points, at stereo's of the training views, or at random in the
    #: cameras' frusta. both: the data set's and, where it has none, stereo's; auto: the data set's if it has
    #: any, else stereo's.
    initial_points: Source = "both"
    #: A PLY whose points stand for the data set's own: a file in its folder, or a whole path.
    points_file: str | None = None
    #: Points far away, for the sky and what is behind windows, where first points leave pictures uncovered;
    #: auto: of photographs.
    far_shell: Switch = "auto"
    #: Each training picture has the light of its whole bracket, which has less noise; auto: where brackets
    #: show noise.
    merged_brackets: Switch = "auto"
    #: Gaussians before a camera, nearer than anything it photographed, are removed; auto: of photographs.
    clear_cameras: Switch = "auto"
    #: Gain, white balance and vignetting of each photo are learned; auto: of photographs, not of renders.
    nuisances: Switch = "auto"
    #: Where each picture was taken from is refined; auto: of photographs.
    poses: Switch = "auto"
    #: What is known of the camera, from physhdr calibrate: response and vignetting are used as they are.
    calibration: str | None = None
    #: How many points are placed at random, where a training starts from such.
    random_points: int = 20_000
    #: Opacity of the first Gaussians (3DGS: 0.1). Points of surfaces are opaque; less leaves time for what
    #: lies before them to hide them.
    initial_opacity: float = 0.3
    #: From exact points: a Gaussian's size across its surface, over that along it (3DGS: 1, spheres).
    #: Neighbours that are beside their surface tell nothing of how it lies.
    initial_thickness: float = 0.3
    #: From points of structure from motion: no Gaussian starts larger than this share of a picture's width.
    #: It is the standard deviation, in any picture that it is in: one that has no neighbours would be a fog
    #: before the cameras, or all of what is behind a window. 0: no bound (3DGS).
    initial_size_limit: float = 0.1
    #: Share of the training at whose start views are seen at half their width and height.
    half_size_until: float = 0.1
    #: The SH degree rises by one after this many iterations (3DGS: 1000).
    sh_degree_every: int = 150
    #: The length of training that steps of the schedule are given for; 0: they are iterations, however long
    #: it is. These are sh_degree_every, and start, every and reset_every of backbone: in a training twice as
    #: long they are twice as long.
    schedule_for: FromZero = 0
    method: MethodConfig = field(default_factory=PhysHDRConfig)
    backbone: BackboneConfig = field(default_factory=GaussiansConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)

    def __post_init__(self) -> None:
        seen = self.training_exposures
        self._require("training_exposures", min(seen, default=-1) >= 0, "indices of a bracket, such as 0 2 4")
        self._require("initial_opacity", 0.0 < self.initial_opacity < 1.0, "between 0 and 1")
        self._require("initial_thickness", 0.0 < self.initial_thickness <= 1.0, "above 0 and at most 1")
        self._require("initial_size_limit", self.initial_size_limit >= 0.0, "0 or more")
        _check_numbers(self, "")
        self._check_traits()

    def _require(self, name: str, holds: bool, may_be: str) -> None:
        if not holds:
            raise BadValueError(f"{option(name)} must be {may_be}, got {getattr(self, name)}")

    @property
    def budget(self) -> int:
        """The most Gaussians that growth makes, 0 where nothing bounds it or there are none."""
        return self.backbone.budget if self.method.traits.splats else 0

    def _check_traits(self) -> None:
        """Raises ``BadValueError`` for a schedule that the method cannot follow."""
        name, traits = self.method.name, self.method.traits
        several = self.exposure_mode == "exp3" and len(self.training_exposures) > 1
        if self.supervision == "bracket" and several and not traits.brackets_at_once:
            raise BadValueError(
                f"{name}, with these settings, draws a view anew for each exposure: a bracket cannot be "
                "compared at once",
                f"Give {option('supervision', 'one')}.",
            )
        if self.half_size_until > 0.0 and not traits.half_sizes:
            raise BadValueError(
                f"{name}, with these settings, cannot learn from views at half their size",
                f"Give {option('half_size_until', 0)}.",
            )


def in_iterations(config: TrainConfig) -> TrainConfig:
    """``config`` with the steps of its schedule in iterations of this training, each at least one."""
    if not config.schedule_for or config.schedule_for == config.iterations:
        return dataclasses.replace(config, schedule_for=0)

    def stretched(steps: int) -> int:
        return steps and max(1, round(steps * config.iterations / config.schedule_for))

    return dataclasses.replace(
        config,
        schedule_for=0,
        sh_degree_every=stretched(config.sh_degree_every),
        backbone=config.backbone.stretched(stretched),
    )


def _check_numbers(config: Any, where: str) -> None:
    """Raises ``BadValueError`` for a number that no setting can be, here and in the parts of ``config``."""
    for entry in dataclasses.fields(config):
        value, name = getattr(config, entry.name), f"{where}{entry.name}"
        least, most = bounds_of(entry.type)
        if dataclasses.is_dataclass(value):
            _check_numbers(value, f"{name}.")
        elif type(value) is int and not least <= value <= most:
            raise BadValueError(f"{option(name)} must be from {least} to {most}, got {value}")
        elif isinstance(value, float) and not abs(value) <= LARGEST_NUMBER:
            raise BadValueError(f"{option(name)} must be a number up to {LARGEST_NUMBER:g}, got {value}")


class RunConfig(NamedTuple):
    """What ``config.json`` says. ``fingerprint``: of the configuration, as checkpoints name theirs."""

    config: TrainConfig
    data: Path
    preset: str
    fingerprint: str


def write_config(path: Path, config: TrainConfig, data: Path, preset: str) -> None:
    """Write ``config.json``: with the data set it reproduces the run. Raises ``OutputError``."""
    content = {"data": str(resolved(data)), "preset": preset, "config": _values(config)}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def read_config(path: Path) -> RunConfig:
    """What ``write_config`` wrote; raises ``FileMissingError`` and ``FileDamagedError``."""
    if not path.is_file():
        raise FileMissingError(
            f"there is no {path}", "Name the folder of a run, as given to physhdr train --out."
        )
    remedy = "Train again, or restore a copy."
    content = read_json_object(path, remedy)
    try:
        values = content["config"]
        # As it is written, not as it is understood: a setting that is added some day leaves it alone.
        written = fingerprint_of(values)
        config = _from_json(TrainConfig, values, "config")
        data, preset = (_from_json(str, content[name], name) for name in ("data", "preset"))
        if not (preset.isprintable() and len(preset) <= LONGEST_NAME):
            raise ValueError(f"its preset is called {preset[:LONGEST_NAME]!r}")
        return RunConfig(config, Path(data), preset, written)
    except (ValueError, KeyError, OverflowError, BadValueError) as error:
        why = error.message if isinstance(error, BadValueError) else str(error)
        raise FileDamagedError(f"{path} is not a run's configuration: {why}", remedy) from error


def fingerprint(config: TrainConfig) -> str:
    """What a checkpoint of a run with ``config`` names as its configuration: the data's path has no part."""
    return fingerprint_of(json.loads(json.dumps(_values(config))))


def fingerprint_of(values: Any) -> str:
    """SHA-256 of a configuration as ``config.json`` holds it, whatever the order of its settings."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def completed(values: Any) -> dict[str, Any]:
    """A configuration as ``config.json`` holds it, with what was added since then at its default.

    A setting that is added means at its default what was before it. Raises ``ValueError`` or
    ``BadValueError`` for what is no configuration.
    """
    return json.loads(json.dumps(_values(_from_json(TrainConfig, values, "config"))))


def _values(config: TrainConfig) -> dict[str, Any]:
    values = dataclasses.asdict(config)
    for part in ("method", "backbone"):
        values[part] = {"name": getattr(config, part).name} | values[part]
    return values


def _from_json(hint: Any, value: Any, where: str) -> Any:
    """``value`` as the annotation ``hint`` wants it; raises ``ValueError`` and what dataclasses refuse."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint in _NAMED:
        return _named(hint, value, where)
    if origin is Literal:
        if value in arguments:
            return value
    elif origin in (types.UnionType, typing.Union):
        if value is None and type(None) in arguments:
            return None
        kind, *_ = (each for each in arguments if each is not type(None))
        return _from_json(kind, value, where)
    elif origin is tuple:
        if isinstance(value, list):
            return tuple(_from_json(arguments[0], item, where) for item in value)
    elif dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if isinstance(value, dict):
            return _dataclass(hint, value, where)
    elif hint is float:
        if type(value) in (int, float) and math.isfinite(value):
            return value
    elif type(value) is hint:
        return value
    raise ValueError(f"{where} is {json.dumps(value)[:60]}, which it cannot be")


def method_of(value: Any) -> MethodConfig:
    """The settings of a method as ``config.json`` holds them; without a ``name``, PhysHDR's.

    Raises ``ValueError``, and ``BadValueError`` for a method that does not exist or cannot be so.
    """
    return _named(MethodConfig, value, "method")


def _named(hint: type, value: Any, where: str) -> Any:
    """The settings of a method or a backbone, which its ``name`` leads to; raises as ``method_of``."""
    if not isinstance(value, dict):
        raise ValueError(f"{where} is {json.dumps(value)[:60]}, which it cannot be")
    table, usual = _NAMED[hint]
    name = _from_json(str, value.get("name", usual), f"{where}.name")
    if name not in table:
        raise BadValueError(f"there is no {where} {name!r}", f"There are: {', '.join(table)}.")
    return _dataclass(table[name].config, {key: item for key, item in value.items() if key != "name"}, where)


def _dataclass(cls: type, values: dict[str, Any], where: str) -> Any:
    """A dataclass from what ``dataclasses.asdict`` gave; unknown names are refused, missing ones default."""
    hints, names = typing.get_type_hints(cls), {each.name for each in dataclasses.fields(cls)}
    arguments = {}
    for name, value in values.items():
        if name not in names:
            raise ValueError(f"there is no setting {where}.{name}")
        arguments[name] = _from_json(hints[name], value, f"{where}.{name}")
    return cls(**arguments)
