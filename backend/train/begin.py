# SPDX-License-Identifier: GPL-3.0-or-later
"""How a training's state comes to be: at its beginning from a scene, or resumed from a checkpoint."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from ...bridge.errors import DataMismatchError
from ...bridge.run_folder import CHECKPOINT_FILE
from ..methods.base import MethodSetup
from ..rasterize import Implementation
from ..scene.scene import Scene
from ..start.initialise import scene_extent
from .backbones import new_method
from .calibration import calibrate, freeze_response
from .checkpoint import (
    VIEWS,
    lights_of,
    load_checkpoint,
    log_radiance_range_in,
    progress_of,
    require_configuration,
    responses_in,
)
from .config import TrainConfig, fingerprint
from .data import Data
from .first_primitives import place
from .growing import Growing
from .learned_poses import LearnedPoses
from .light_levels import LightLevels
from .nuisances import Nuisances
from .optimisers import Optimiser
from .plan import Plan, planned
from .saver import restore_method, restore_rest
from .state import Part, State
from .unseen_shares import UnseenShares

#: What can take part in a training, in the order in which an iteration asks it.
PARTS: tuple[type[Part], ...] = (LearnedPoses, Nuisances, LightLevels, Growing, UnseenShares)


def begin(
    scene: Scene,
    config: TrainConfig,
    implementation: Implementation = "auto",
    device: torch.device | str = "cpu",
    placing: Callable[[State, Nuisances | None], None] = place,
) -> State:
    """The state before the first iteration.

    ``implementation`` picks the rasteriser; ``placing`` puts the first primitives where they are.
    Raises ``BadValueError`` or ``DataMismatchError`` where the scene cannot be trained with ``config``.
    """
    state, kinds = _empty(planned(scene, config), implementation, device, fingerprint(config))
    state.data.require_something_seen()
    state.method.prepare(config.seed)
    begun, begun_cpu = time.perf_counter(), time.process_time()
    nuisances = Nuisances.new(state) if Nuisances in kinds else None
    if config.calibration is not None:
        calibrate(state.method, nuisances, config)
    if state.plan.splats:
        placing(state, nuisances)
    state.seconds, state.cpu_seconds = time.perf_counter() - begun, time.process_time() - begun_cpu
    _complete(state, kinds, nuisances)
    return state


def resume(
    folder: Path,
    scene: Scene,
    config: TrainConfig,
    implementation: Implementation = "auto",
    device: torch.device | str = "cpu",
    configuration: str = "",
) -> State:
    """The state in which the run in ``folder`` was saved; on the CPU it resumes bit-identically.

    ``configuration``: the fingerprint of its config.json as it was written; by default that of ``config``.
    Raises as ``begin``, and what reading a checkpoint raises.
    """
    configuration = configuration or fingerprint(config)
    state, kinds = _empty(planned(scene, config), implementation, device, configuration)
    path = folder / CHECKPOINT_FILE
    tensors, metadata = load_checkpoint(path)
    require_configuration(metadata, configuration, path)
    progress = progress_of(metadata, config.iterations, path)
    _require_same_data(metadata, state.plan, path)
    restore_method(state.method, tensors, path)
    state.start_message = f"the checkpoint in {folder}"
    state.views_digest, state.iteration = metadata[VIEWS], progress.iteration
    state.seconds, state.cpu_seconds = progress.seconds, progress.cpu_seconds
    if state.plan.clears_cameras:
        state.clearance = torch.zeros(len(state.views))  # the growth restores its own
    _complete(state, kinds)
    restore_rest(state, tensors, path)
    state.follow_schedule()
    return state


def _empty(
    plan: Plan, implementation: Implementation, device: torch.device | str, configuration: str
) -> tuple[State, tuple[type[Part], ...]]:
    """A state without primitives, and the kinds of its parts."""
    kinds = tuple(kind for kind in PARTS if kind.is_wanted(plan))
    device, seen = torch.device(device), plan.seen
    data = Data(plan, device)
    setup = MethodSetup(
        seen.scene.response_anchor,
        implementation,
        seen.lights,
        seen.responses,
        seen.range,
        seen.standard_levels,
    )
    torch.manual_seed(plan.config.seed)  # initial values of the networks
    method = new_method(plan.config.method, plan.backbone, setup)
    return State(plan, data, method, device, configuration), kinds


def _complete(state: State, kinds: tuple[type[Part], ...], nuisances: Nuisances | None = None) -> None:
    """Make what depends on the primitives, which are there now."""
    config, method = state.config, state.method
    method.to_device(state.device)
    if config.calibration is not None:
        freeze_response(method)
    extent = scene_extent(state.plan.seen.scene.train)
    state.optimiser = Optimiser(method, config.optimiser, extent, config.iterations)
    state.parts = tuple(nuisances if nuisances and kind is Nuisances else kind.new(state) for kind in kinds)


def _require_same_data(metadata: dict[str, str], plan: Plan, path: Path) -> None:
    """Raises ``DataMismatchError`` where the run at ``path`` was begun with other pictures."""
    seen, lights = plan.seen, lights_of(metadata, path)
    if lights != seen.lights:
        raise DataMismatchError(
            f"the run in {path.parent} has levels of {', '.join(lights)}, the data in {seen.scene.root} of "
            f"{', '.join(seen.lights)}",
            "Give the data set that it was begun with.",
        )
    if responses_in(metadata, path) != seen.responses:
        raise DataMismatchError(
            f"the run in {path.parent} was begun with other pictures than those in {seen.scene.root}: the "
            "response is learned of a camera's, and known of radiance and of developed raw files",
            "Give the data set that it was begun with.",
        )
    if not np.allclose(log_radiance_range_in(metadata, path), seen.range):
        raise DataMismatchError(
            f"the run in {path.parent} was begun with other pictures than those in {seen.scene.root}: these "
            "ask for other bounds of radiance than it learned within",
            "Give the data set that it was begun with, as it was then.",
        )
