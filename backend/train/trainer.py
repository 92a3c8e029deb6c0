# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loop, top to bottom: it yields events and knows nothing of who listens."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from ...bridge.errors import BadValueError, DataMismatchError, PhysHDRError
from ...bridge.lights import AMBIENT
from ..methods.physhdr import PhysHDR
from ..model.gaussians import Gaussians, initial_gaussians
from ..model.tone_mapper import ToneMapper
from ..rasterize import Implementation
from ..resident import Pictures
from ..scene.scene import Scene, View
from . import densify as density
from .checkpoint import lights_of, load_checkpoint, save_checkpoint
from .config import TrainConfig
from .events import Event, Finished, Progress, Saved, Started
from .initialise import initial_points, merged_log_radiance, scene_extent
from .optimisers import Optimiser
from .warm_up import halved

CHECKPOINT_FILE = "checkpoint.safetensors"

#: Streams of random numbers, so that no two purposes draw the same ones.
STREAM_VIEWS, STREAM_EXPOSURES, STREAM_SPLIT = range(3)

#: Measures a fixed test view; given the method, returns named numbers.
Monitor = Callable[[PhysHDR], dict[str, float]]


class TrainingDivergedError(PhysHDRError):
    """The loss is no longer a number."""


class Trainer:
    """A run: the method, its optimiser, densification's statistics and the iteration.

    ``device``: where everything is computed; ``implementation`` picks the rasteriser. Raises
    ``BadValueError`` or ``DataMismatchError`` where the scene cannot be trained with ``config``.
    """

    def __init__(
        self,
        scene: Scene,
        config: TrainConfig,
        implementation: Implementation = "auto",
        device: torch.device | str = "cpu",
    ) -> None:
        self.scene, self.config, self.device = scene, config, torch.device(device)
        self.pictures = Pictures(self.device)
        self.iteration = 0
        self._sound = True  # whether the state is one that a checkpoint may hold
        uses_light = config.method.lighting_level == "view"
        self.lights = scene.lights if uses_light else (AMBIENT,)
        self.views = [*scene.train, *(scene.lit if uses_light else [])]
        if not self.views:
            raise BadValueError(f"{scene.root} has no training views")
        self.exposures = [self._allowed_exposures(view, index) for index, view in enumerate(self.views)]

        torch.manual_seed(config.seed)  # initial values of the networks
        tone_mapper = ToneMapper(config.method.tone_mapper, scene.response_anchor)
        tone_mapper.warm_start(config.seed)
        self.method = PhysHDR(
            config.method, self._start(tone_mapper), scene.response_anchor, implementation, self.lights
        )
        self.method.tone_mapper.load_state_dict(tone_mapper.state_dict())
        self.method.to_device(self.device)
        self.optimiser = Optimiser(
            self.method, config.optimiser, scene_extent(scene.train), config.iterations
        )
        self.statistics = density.DensifyState.empty(self.method.gaussians)

    def _allowed_exposures(self, view: View, index: int) -> tuple[int, ...]:
        allowed = tuple(k for k in self.config.training_exposures if k < len(view.exposures))
        if not allowed:
            raise DataMismatchError(
                f"view {view.name} has {len(view.exposures)} exposures, training wants "
                f"{list(self.config.training_exposures)}",
                "Set --training-exposures to indices that the data set has.",
            )
        if self.config.exposure_mode == "exp1":
            rng = np.random.default_rng([self.config.seed, STREAM_EXPOSURES, index])
            return (int(rng.choice(allowed)),)
        return allowed

    def _start(self, tone_mapper: ToneMapper) -> Gaussians:
        config, method = self.config, self.config.method
        # Only views under the standard light say how bright a point is at level 1.
        standard = [(v, e) for v, e in zip(self.views, self.exposures, strict=True) if v.is_standard]
        views, exposures = [v for v, _ in standard], [e for _, e in standard]
        points = initial_points(
            self.scene,
            views,
            exposures,
            tone_mapper,
            source=config.initial_points,
            random_count=config.random_points,
            seed=config.seed,
        )
        self.start_message = points.message
        return initial_gaussians(
            points.positions,
            merged_log_radiance(points.positions, views, exposures, tone_mapper),
            sh_degree=method.sh_degree,
            opacity=config.initial_opacity,
            scale_factor=config.initial_scale,
            ambient_share=config.initial_ambient_share if method.has_light_share else None,
            lights=len(self.lights),
            context_size=method.tone_mapper.context_size if method.tone_mapper.local else 0,
            seed=config.seed,
        )

    # -- one iteration -----------------------------------------------------------------------------------

    def draw(self, iteration: int) -> tuple[View, int]:
        """The view and the exposure index of an iteration (from 0): a shuffle of all views each epoch."""
        epoch, position = divmod(iteration, len(self.views))
        order = np.random.default_rng([self.config.seed, STREAM_VIEWS, epoch]).permutation(len(self.views))
        index = int(order[position])
        rng = np.random.default_rng([self.config.seed, STREAM_EXPOSURES, 1 << 32, iteration])
        return self.views[index], int(rng.choice(self.exposures[index]))

    def step(self) -> dict[str, torch.Tensor]:
        """One iteration; returns the weighted loss terms (detached)."""
        config, method, iteration = self.config, self.method, self.iteration
        view, k = self.draw(iteration)
        camera, picture = view.camera, self.pictures.get(view, k)
        if iteration < config.half_size_until * config.iterations:
            camera, picture = halved(camera, picture)
        self._follow_schedules(iteration)

        screen_offsets = torch.zeros(len(method.gaussians), 2, device=self.device, requires_grad=True)
        levels = 1.0 if view.is_standard else view.lighting_levels
        rendering = method.render(camera, view.exposures[k], levels, screen_offsets)
        terms = method.losses(rendering, picture)
        total = torch.stack(list(terms.values())).sum()
        total.backward()

        if iteration < config.densify.stop * config.iterations and screen_offsets.grad is not None:
            density.observe(self.statistics, screen_offsets.grad, rendering, camera, config.densify)
        self._sound = False
        self.optimiser.step(iteration)
        self.iteration = iteration + 1
        self._control_density()
        self._sound = True
        return {name: term.detach() for name, term in terms.items()}

    def _follow_schedules(self, iteration: int) -> None:
        """The SH degree and the freezing of f_mix at an iteration (functions of it alone)."""
        config, method = self.config, self.method
        method.active_sh_degree = min(config.method.sh_degree, iteration // config.sh_degree_every)
        if config.method.tone_mapper.mix:
            learning = iteration >= config.method.mix_frozen_until * config.iterations
            method.tone_mapper.fusion.requires_grad_(learning)

    def _control_density(self) -> None:
        config, total = self.config, self.config.iterations
        if density.is_due(self.iteration, total, config.densify):
            seed = np.random.SeedSequence([config.seed, STREAM_SPLIT, self.iteration]).generate_state(1)[0]
            generator = torch.Generator().manual_seed(int(seed))
            self.statistics = density.densify(
                self.method, self.optimiser, self.statistics, self.iteration, config.densify, generator
            )
        if density.reset_is_due(self.iteration, total, config.densify):
            density.reset_opacity(self.method, self.optimiser, config.densify)

    # -- the loop ----------------------------------------------------------------------------------------

    def run(
        self,
        folder: Path,
        *,
        should_stop: Callable[[], bool] = lambda: False,
        monitor: Monitor | None = None,
        progress_every: int = 20,
        monitor_every: int = 200,
        checkpoint_every: int = 2000,
        between: Callable[[], float] = lambda: 0.0,
    ) -> Iterator[Event]:
        """Train until done or told to stop, yielding events; a checkpoint is written on every way out.

        ``between`` is called after every iteration, when the method is whole and may be looked at. It returns
        for how many seconds it held the training up (a pause), which then count in no rate.
        """
        total = self.config.iterations
        begun, begun_cpu = time.perf_counter(), time.process_time()
        message = f"started from {self.start_message}"
        yield Started(self.iteration, total, len(self.method.gaussians), message)
        sums: dict[str, torch.Tensor] = {}
        window_start, window_first = time.perf_counter(), self.iteration
        try:
            while self.iteration < total and not should_stop():
                try:
                    terms = self.step()
                except BadValueError as error:  # the rasteriser refuses NaN and says where
                    raise self._diverged(str(error)) from error
                for name, value in terms.items():
                    sums[name] = sums.get(name, 0.0) + value
                done = self.iteration
                if done % progress_every == 0 or done == total:
                    losses = {name: float(value) / (done - window_first) for name, value in sums.items()}
                    self._refuse_nan(losses)
                    rate = (done - window_first) / (time.perf_counter() - window_start)
                    due = monitor is not None and (done % monitor_every == 0 or done == total)
                    measured = monitor(self.method) if due and monitor is not None else {}
                    yield Progress(
                        done, total, len(self.method.gaussians), losses, rate, (total - done) / rate, measured
                    )
                    sums, window_start, window_first = {}, time.perf_counter(), done
                if done % checkpoint_every == 0 and done < total:
                    yield self.save(folder)
                held = between()
                window_start, begun = window_start + held, begun + held
        finally:
            # A diverged state, or one caught in the middle of an update, is worth less than the last file.
            if self._sound:
                self.save(folder)
        yield Saved(self.iteration, str(folder / CHECKPOINT_FILE))
        yield Finished(
            self.iteration,
            time.perf_counter() - begun,
            time.process_time() - begun_cpu,
            stopped=self.iteration < total,
        )

    def _refuse_nan(self, losses: dict[str, float]) -> None:
        bad = [name for name, value in losses.items() if not math.isfinite(value)]
        if bad:
            raise self._diverged(f"the loss term '{bad[0]}' is not a number")

    def _diverged(self, what: str) -> TrainingDivergedError:
        self._sound = False
        return TrainingDivergedError(
            f"training diverged at iteration {self.iteration}: {what}",
            "Lower the learning rates, or report this with the run's config.json. "
            "The last good checkpoint is untouched.",
        )

    # -- checkpoints ---------------------------------------------------------------------------------------

    def save(self, folder: Path) -> Saved:
        """Write everything that ``resume`` needs; raises ``OutputError``."""
        tensors = {f"gaussians.{k}": v for k, v in self.method.gaussians.parameters.items()}
        tensors |= {f"networks.{k}": v for k, v in self.method.state_dict().items()}
        tensors |= {f"statistics.{k}": v for k, v in vars(self.statistics).items()}
        tensors |= self.optimiser.state_tensors()
        path = folder / CHECKPOINT_FILE
        save_checkpoint(path, tensors, {"iteration": str(self.iteration)}, self.lights)
        return Saved(self.iteration, str(path))

    def resume(self, folder: Path) -> None:
        """Go on from the checkpoint in ``folder``: the run continues bit-identically on the CPU."""
        tensors, metadata = load_checkpoint(folder / CHECKPOINT_FILE)
        lights = lights_of(metadata, folder / CHECKPOINT_FILE)
        if lights != self.lights:
            raise DataMismatchError(
                f"the run in {folder} has levels of {', '.join(lights)}, the data in {self.scene.root} of "
                f"{', '.join(self.lights)}",
                "Give the data set that it was begun with.",
            )
        restore_method(self.method, tensors)
        self.method.to_device(self.device)
        self.optimiser = Optimiser(
            self.method, self.config.optimiser, self.optimiser.extent, self.config.iterations
        )
        self.optimiser.load_state_tensors({k: v.to(self.device) for k, v in tensors.items()})
        self.statistics = density.DensifyState(
            **{
                k.removeprefix("statistics."): v.to(self.device)
                for k, v in tensors.items()
                if k.startswith("statistics.")
            }
        )
        self.iteration = int(metadata["iteration"])
        self.start_message = f"the checkpoint in {folder}"
        self._follow_schedules(self.iteration)


def restore_method(method: PhysHDR, tensors: dict[str, torch.Tensor]) -> None:
    """Put a checkpoint's Gaussians and networks into ``method``."""
    method.gaussians.parameters = {
        k.removeprefix("gaussians."): v.clone().requires_grad_()
        for k, v in tensors.items()
        if k.startswith("gaussians.")
    }
    method.load_state_dict(
        {k.removeprefix("networks."): v for k, v in tensors.items() if k.startswith("networks.")}
    )


def load_method(
    folder: Path,
    config: TrainConfig,
    anchor: tuple[float, float] | None,
    implementation: Implementation = "auto",
    device: torch.device | str = "cpu",
) -> tuple[PhysHDR, int]:
    """The trained method of a run's folder, for rendering, and the iteration it is at."""
    tensors, metadata = load_checkpoint(folder / CHECKPOINT_FILE)
    lights = lights_of(metadata, folder / CHECKPOINT_FILE)
    method = PhysHDR(config.method, Gaussians({}), anchor, implementation, lights)
    restore_method(method, tensors)
    method.to_device(torch.device(device))
    iteration = int(metadata["iteration"])
    method.active_sh_degree = min(config.method.sh_degree, max(iteration - 1, 0) // config.sh_degree_every)
    return method, iteration
