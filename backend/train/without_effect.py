# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that were changed and that this training does not read: better said than silently accepted."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from ..model.tone_mapper import ToneMapper
from ..shell import option
from .config import TrainConfig
from .first_primitives import lie_on_surfaces, may_have_strays
from .optimisers import OptimiserConfig
from .state import State

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


def changed_without_effect(state: State, preset: TrainConfig) -> list[str]:
    """Settings, as they are typed, that are not the preset's and that ``state`` never reads."""
    unread = _unread(state)
    return [
        option(name)
        for name in _differences(state.config, preset)
        if name in unread or name.partition(".")[0] in unread
    ]


def _unread(state: State) -> set[str]:
    plan, method = state.plan, state.method
    if not plan.splats:
        return {*OF_SPLATS}
    unread = {*plan.backbone.unread}
    if plan.config.initial_points in ("stereo", "random"):
        unread.add("points_file")
    if plan.config.method.traits.initial_radiance != "merged":
        unread.add("far_shell")  # points of no colour
    if plan.merges == "on" and state.data.merged is None:
        unread.add("merged_brackets")
    if not lie_on_surfaces(plan):
        unread.add("initial_thickness")
    if not may_have_strays(plan):
        unread.add("initial_size_limit")
    mapper = method.tone_mapper
    if isinstance(mapper, ToneMapper):
        if mapper.config.initial_slope is None:
            unread.add("method.tone_mapper.initial_curve")
        elif mapper.is_measured:
            unread.add("method.tone_mapper.initial_slope")
    rates = {each.name for each in dataclasses.fields(OptimiserConfig) if each.type is float}
    own = method.rates().keys()
    learning = {name for name in state.optimiser.rates if name not in own}
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
