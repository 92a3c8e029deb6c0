# SPDX-License-Identifier: GPL-3.0-or-later
"""A training's state in a checkpoint: written by the clock, and read again, whole or for the method alone."""

import json
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ...bridge.errors import OutputError
from ...bridge.run_folder import CHECKPOINT_FILE, CONFIG_FILE
from ..methods.base import Method, MethodSetup
from ..rasterize import Implementation
from ..scene.scene import View
from .backbones import new_method
from .checkpoint import (
    CONFIGURATION,
    LIGHTS,
    RANGE,
    RESPONSES,
    STANDARD,
    VIEWS,
    check_tensors,
    damaged,
    lights_of,
    load_checkpoint,
    log_radiance_range_in,
    progress_of,
    refuse_others,
    require_configuration,
    responses_in,
    save_checkpoint,
    standard_levels_of,
)
from .config import TrainConfig, fingerprint, in_iterations
from .events import Saved
from .growing import Growing
from .learned_poses import LearnedPoses
from .light_levels import LightLevels, unknown_levels
from .nuisances import Nuisances
from .optimisers import ADAM
from .state import State

#: Prefix of the backbone's parameters in a checkpoint, whichever it is.
PRIMITIVES = "gaussians."
#: Prefix of the networks of method and backbone.
NETWORKS = "networks."

#: A checkpoint is written this often (seconds), but so that writing takes a fiftieth of the time at most.
CHECKPOINT_SECONDS = 30.0
CHECKPOINT_SHARE = 0.02


class Saver:
    """Saves in ``folder`` every ``seconds``, or less often: see ``CHECKPOINT_SHARE``."""

    def __init__(self, folder: Path, seconds: float) -> None:
        self._folder, self._seconds = folder, seconds
        self._is_run = (folder / CONFIG_FILE).exists()
        self._next = time.perf_counter() + seconds

    @property
    def is_due(self) -> bool:
        """Whether it is time to save."""
        return time.perf_counter() >= self._next

    def put_off(self, seconds: float) -> None:
        """Save later by so many seconds."""
        self._next += seconds

    def save(self, state: State) -> Saved:
        """Save where the run's configuration is: a checkpoint alone is no run that could go on.

        Raises ``OutputError``, and as ``save``.
        """
        if self._is_run and not (self._folder / CONFIG_FILE).exists():
            raise OutputError(
                f"{self._folder} was moved or deleted while iteration {state.iteration} was trained",
                "What was saved last is in that folder, wherever it is: resume the run there. If it is "
                "deleted, train again.",
            )
        begun = time.perf_counter()
        saved = save(state, self._folder)
        now = time.perf_counter()
        self._next = now + max(self._seconds, (now - begun) / CHECKPOINT_SHARE)
        return saved


def save(state: State, folder: Path) -> Saved:
    """Write everything that going on needs; raises ``OutputError``.

    ``TrainingDivergedError`` where a value is no number: what is in ``folder`` is worth more then.
    """
    tensors = {f"{NETWORKS}{k}": v for k, v in state.method.state_dict().items()}
    tensors |= {f"{PRIMITIVES}{k}": v for k, v in state.method.backbone.parameters.items()}
    tensors |= state.optimiser.state_tensors()
    for part in state.parts:
        tensors |= {f"{part.name}.{k}": v for k, v in part.tensors().items()}
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not tensor.isfinite().all():
            raise state.diverged(f"{name} has values that are not numbers")
    path = folder / CHECKPOINT_FILE
    metadata = {
        "iteration": str(state.iteration),
        "seconds": f"{state.seconds:.3f}",
        "cpu_seconds": f"{state.cpu_seconds:.3f}",
        CONFIGURATION: state.configuration,
        VIEWS: state.views_digest,
        LIGHTS: json.dumps(state.plan.seen.lights),
        RANGE: json.dumps(state.plan.seen.range),
        RESPONSES: state.plan.seen.responses,
    }
    if any(level != 1.0 for level in state.plan.seen.standard_levels):
        metadata[STANDARD] = json.dumps(state.plan.seen.standard_levels)
    save_checkpoint(path, tensors, metadata)
    return Saved(state.iteration, str(path))


def restore_method(method: Method, tensors: dict[str, torch.Tensor], path: Path) -> None:
    """Put the primitives and networks of the checkpoint at ``path`` into ``method``.

    Raises ``FileDamagedError`` where they are not what ``method`` is made of.
    """
    networks = {k: v for k, v in tensors.items() if k.startswith(NETWORKS)}
    primitives = {k: v for k, v in tensors.items() if k.startswith(PRIMITIVES)}
    wanted = {f"{NETWORKS}{name}": like for name, like in method.state_dict().items()}
    # One at least, or it has no Gaussians.
    count = max((tensor.shape[0] for tensor in primitives.values() if tensor.dim()), default=0) or 1
    wanted |= {
        f"{PRIMITIVES}{name}": torch.empty(count, *shape, device="meta")
        for name, shape in method.backbone.shapes().items()
    }
    check_tensors(networks | primitives, wanted, path)
    refuse_others(networks | primitives, wanted, path)
    method.backbone.parameters = {
        k.removeprefix(PRIMITIVES): v.requires_grad_() for k, v in primitives.items()
    }
    method.load_state_dict({k.removeprefix(NETWORKS): v for k, v in networks.items()})


def restore_rest(state: State, tensors: dict[str, torch.Tensor], path: Path) -> None:
    """Put Adam's moments and the parts of the checkpoint at ``path`` into ``state``.

    Raises ``FileDamagedError`` where they are not those of such a training.
    """
    moments = {k: v for k, v in tensors.items() if k.startswith(ADAM)}
    wanted = state.optimiser.state_like(moments)
    for part in state.parts:
        wanted |= {f"{part.name}.{name}": like for name, like in part.tensors().items()}
    there = {k: v for k, v in tensors.items() if not k.startswith((NETWORKS, PRIMITIVES))}
    check_tensors(there, wanted, path)
    refuse_others(there, wanted, path)
    for name, tensor in there.items():
        counts = name.startswith((ADAM, Growing.name)) and not name.endswith(".exp_avg")
        if counts and (tensor < 0).any():
            raise damaged(path, f"{name} has values below 0")
    state.optimiser.load_state_tensors({k: v.to(state.device) for k, v in moments.items()})
    for part in state.parts:
        mine = {name: tensors[f"{part.name}.{name}"] for name in part.tensors()}
        part.restore({name: tensor.to(state.device) for name, tensor in mine.items()})


def learned_of_photographs(
    folder: Path,
) -> tuple[tuple[torch.Tensor | None, torch.Tensor | None], np.ndarray | None]:
    """What the run in ``folder`` has learned of its photographs beside the scene, if it did.

    Of the lenses vignetting ``[L, 3]`` and reach ``[L]`` (``model.camera_effects``), and how its views'
    cameras have moved (``LearnedPoses.twists``).
    """
    tensors, _ = load_checkpoint(folder / CHECKPOINT_FILE)
    vignetting, reach = (tensors.get(f"{Nuisances.name}.{name}") for name in ("vignetting", "reach"))
    twist, pixel = (tensors.get(f"{LearnedPoses.name}.{name}") for name in ("twist", "pixel"))
    return (vignetting, reach), None if twist is None or pixel is None else (twist * pixel).numpy()


def learned_levels(
    folder: Path, views: Sequence[View], lights: Sequence[str]
) -> dict[tuple[str, int], float]:
    """The levels that the run in ``folder`` has found for its training ``views``, by group and light.

    Raises ``FileDamagedError`` where they are others than the views ask for.
    """
    path = folder / CHECKPOINT_FILE
    unknown = unknown_levels(views, lights)
    if not unknown:
        return {}
    found = load_checkpoint(path)[0].get(f"{LightLevels.name}.log_level")
    if found is None or len(found) != len(unknown):
        raise damaged(path, "its levels of light are not those of its data set")
    each = zip(unknown, found.tolist(), strict=True)
    return {(level.group, level.index): math.exp(value) for level, value in each}


def load_method(
    folder: Path,
    config: TrainConfig,
    anchor: tuple[float, float] | None,
    implementation: Implementation = "auto",
    device: torch.device | str = "cpu",
    configuration: str = "",
) -> tuple[Method, int]:
    """The trained method of a run's folder, for rendering, and the iteration it is at.

    ``configuration``: the fingerprint of its config.json as it was written; by default that of ``config``.
    """
    path = folder / CHECKPOINT_FILE
    tensors, metadata = load_checkpoint(path)
    require_configuration(metadata, configuration or fingerprint(config), path)
    iteration = progress_of(metadata, config.iterations, path).iteration
    lights = lights_of(metadata, path)
    setup = MethodSetup(
        anchor,
        implementation,
        lights,
        responses_in(metadata, path),
        log_radiance_range_in(metadata, path),
        standard_levels_of(metadata, path),
    )
    method = new_method(config.method, config.backbone, setup)
    restore_method(method, tensors, path)
    method.to_device(torch.device(device))
    every = in_iterations(config).sh_degree_every
    method.follow_schedule(max(iteration - 1, 0), config.iterations, every)
    return method, iteration
