# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that were changed and that this training does not read: better said than silently accepted."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from ..model.tone_mapper import ToneMapper
from ..shell import option
from .beginning import lie_on_surfaces, may_have_strays
from .config import TrainConfig
from .optimisers import OptimiserConfig
from .trainer import Trainer

#: Networks begin at random values, and a batch of rays is drawn from all pictures.
OF_SPLATS = (
    "backbone",
    "optimiser",
    "random_points",
    "initial_points",
    "initial_opacity",
    "initial_thickness",
    "initial_size_limit",
    "half_size_until",
    "sh_degree_every",
    "schedule_for",
    "supervision",
    "far_shell",
    "clear_cameras",
    "merged_brackets",
)


def changed_without_effect(trainer: Trainer, preset: TrainConfig) -> list[str]:
    """Settings, as they are typed, that are not the preset's and that ``trainer`` never reads."""
    unread = _unread(trainer)
    return [
        option(name)
        for name in _differences(trainer.config, preset)
        if name in unread or name.partition(".")[0] in unread
    ]


def _unread(trainer: Trainer) -> set[str]:
    method = trainer.method
    if not trainer.config.method.traits.splats:
        return {*OF_SPLATS}
    unread = {*trainer.config.backbone.unread}
    if trainer.config.initial_points in ("stereo", "random"):
        unread.add("points_file")
    if trainer.config.method.traits.initial_radiance != "merged":
        unread.add("far_shell")  # points of no colour
    if trainer.config.merged_brackets == "on" and trainer.merged is None:
        unread.add("merged_brackets")
    if not lie_on_surfaces(trainer.scene, trainer.config):
        unread.add("initial_thickness")
    if not may_have_strays(trainer.scene, trainer.config):
        unread.add("initial_size_limit")
    mapper = method.tone_mapper
    if isinstance(mapper, ToneMapper):
        if mapper.config.initial_slope is None:
            unread.add("method.tone_mapper.initial_curve")
        elif mapper.is_measured:
            unread.add("method.tone_mapper.initial_slope")
    rates = {each.name for each in dataclasses.fields(OptimiserConfig) if each.type is float}
    own = method.rates().keys()
    learning = {name for name in trainer.optimiser.rates if name not in own}
    if learning <= {"means", "radiance_networks", "tone_mapper"}:
        unread.add("optimiser.rates_for")
    if "means" in learning:
        learning.add("means_final")
    unread |= {f"optimiser.{name}" for name in rates - learning - {"networks_times"}}
    return unread


def _differences(config: Any, other: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of the fields whose values differ; a field that is there once only is itself different."""
    for each in dataclasses.fields(config):
        here, there = getattr(config, each.name), getattr(other, each.name)
        if dataclasses.is_dataclass(here) and type(here) is type(there):
            yield from _differences(here, there, f"{prefix}{each.name}.")
        elif here != there:
            yield prefix + each.name
