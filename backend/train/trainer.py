# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loop, top to bottom: it yields events and knows nothing of who listens."""

import json
import math
import time
from collections.abc import Callable, Generator
from pathlib import Path

import numpy as np
import torch

from ...bridge.errors import BadValueError, DataMismatchError, OutputError, PhysHDRError
from ...bridge.run_folder import CHECKPOINT_FILE, CONFIG_FILE
from ..methods.base import Batch, Facts, Method, Recording, Responses
from ..rasterize import Implementation
from ..rasterize.contract import CannotBeDrawnError
from ..scene.points import with_points_file
from ..scene.resident import Pictures
from ..scene.scene import Scene, View
from ..start.initialise import scene_extent, seen_points
from ..start.merged_brackets import MergedBrackets
from .backbones import BACKBONES, new_method
from .beginning import Seen, begin
from .calibration import freeze_response, read_calibration, use_response
from .checkpoint import (
    CONFIGURATION,
    LIGHTS,
    RANGE,
    RESPONSES,
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
)
from .config import TrainConfig, fingerprint, in_iterations
from .densify import CLEARANCE
from .events import Event, Finished, Progress, Saved, Started
from .growth import Growth
from .half_size import halved
from .learned_poses import LearnedPoses
from .nuisances import Nuisances
from .optimisers import ADAM, Optimiser
from .parts import Part, Shot
from .targets import SsimTargets
from .views import (
    STREAM_BATCH,
    STREAM_EXPOSURES,
    STREAM_GROWTH,
    STREAM_VIEWS,
    log_radiance_range,
    may_merge_brackets,
    responses_of,
    seen_exposures,
    training_lights,
    training_views,
)

#: Prefix of the backbone's parameters in a checkpoint, whichever it is.
PRIMITIVES = "gaussians."
#: Prefix of the networks of method and backbone.
NETWORKS = "networks."

#: A checkpoint is written this often (seconds), but so that writing takes a fiftieth of the time at most.
CHECKPOINT_SECONDS = 30.0
CHECKPOINT_SHARE = 0.02

#: Measures a fixed held-out view; given the method, returns named numbers.
Monitor = Callable[[Method], dict[str, float]]


class TrainingDivergedError(PhysHDRError):
    """The loss is no longer a number."""


class Trainer:
    """A run: the method, its optimiser, its growth and the iteration.

    ``device``: where everything is computed; ``implementation`` picks the rasteriser. ``resumed``: a run's
    folder, to go on from its checkpoint, bit-identically on the CPU. ``configuration``: the fingerprint of
    its config.json as it was written; by default that of ``config``. Raises
    ``BadValueError`` or ``DataMismatchError`` where the scene cannot be trained with ``config``, and what
    reading a checkpoint raises.
    """

    def __init__(
        self,
        scene: Scene,
        config: TrainConfig,
        implementation: Implementation = "auto",
        device: torch.device | str = "cpu",
        resumed: Path | None = None,
        configuration: str = "",
    ) -> None:
        self.scene = with_points_file(scene, config.points_file)
        self.config, self.device = config, torch.device(device)
        self.schedule = in_iterations(config)
        self.configuration = configuration or fingerprint(config)
        self.pictures = Pictures(self.device)
        self.targets = SsimTargets()
        self.iteration = 0
        #: SHA-256 of the run's views.json, which its checkpoints belong to; empty: there is none.
        self.views_digest = ""
        #: What training took so far, the search for the first points included, in all its parts.
        self.seconds = self.cpu_seconds = 0.0
        self._sound = True  # whether the state is one that a checkpoint may hold
        self.lights = training_lights(scene, config)
        self.views = training_views(scene, config)
        if not self.views:
            raise BadValueError(f"{scene.root} has no training views")
        self.exposures = seen_exposures(self.views, config)
        torch.manual_seed(config.seed)  # initial values of the networks
        self.responses: Responses = responses_of(self.views, self.exposures)
        #: Pictures with the light of their whole brackets; None where they stay as they were taken.
        self.merged = self._new_merged()
        self.pictures.instead = None if self.merged is None else self.merged.codes
        #: Bounds of ln radiance.
        self.range = log_radiance_range(self.views, self.exposures)
        facts = Facts(scene.response_anchor, implementation, self.lights, self.responses, self.range)
        self.method = new_method(config.method, self.schedule.backbone, facts)
        state = self._restore(resumed) if resumed else {}
        #: What is learned of each photo; None where nothing is.
        self.nuisances = self._new_nuisances()
        #: Before these depths nothing was photographed; None where Gaussians may be anywhere.
        self._clearance = state.get(f"{Growth.name}.{CLEARANCE}")
        if not resumed:
            self._begin()
        elif self._clearance is not None and self._clearance.shape != (len(self.views),):
            raise damaged(resumed / CHECKPOINT_FILE, "its clearances are not one a view")
        #: Where the views were taken from, as it is learned; None where it is taken as stated.
        self.poses = self._new_poses()
        self.method.to_device(self.device)
        if config.calibration is not None:
            freeze_response(self.method)
        self.optimiser = Optimiser(
            self.method, config.optimiser, scene_extent(scene.train), config.iterations
        )
        #: How primitives are added and removed; None of methods without any.
        self.growth = self._new_growth()
        rows = (self.poses, self.nuisances, self.growth)
        self.parts: tuple[Part, ...] = tuple(part for part in rows if part is not None)
        if resumed:
            self._restore_state(state, resumed / CHECKPOINT_FILE)
            self._follow_schedule(self.iteration)

    def _require_something_seen(self) -> None:
        """Raises ``DataMismatchError`` where masks or alpha hide all of all pictures: nothing is compared."""
        for view, indices in zip(self.views, self.exposures, strict=True):
            for k in indices:
                mask = self.pictures.mask(view, k)
                if mask is None or bool(mask.any()):
                    return
        raise DataMismatchError(
            f"{self.scene.root}: masks or alpha hide all pixels of all training pictures",
            "Masks are white where a picture is to be looked at, alpha is not 0 there; or remove them.",
        )

    def _begin(self) -> None:
        """The state at iteration 0."""
        self._require_something_seen()
        self.method.prepare(self.config.seed)
        begun, begun_cpu = time.perf_counter(), time.process_time()
        self.start_message = "random networks"
        if self.config.calibration is not None:
            self._calibrate(self.config.calibration)
        if self.config.method.traits.splats:
            self._place()
        self.seconds = time.perf_counter() - begun
        self.cpu_seconds = time.process_time() - begun_cpu

    def _place(self) -> None:
        """Put the backbone's first primitives where the scene is (``beginning``)."""
        seen = Seen(
            self.scene,
            self.views,
            self.exposures,
            self.responses,
            self.range,
            self.merged,
            self.nuisances,
        )
        first = begin(self.method, seen, self.config)
        self.start_message, self._clearance = first.message, first.clearance

    def _new_growth(self) -> Growth | None:
        config, method = self.schedule, self.method
        if not config.method.traits.splats:
            return None
        return BACKBONES[config.backbone.name].growth(
            method,
            self.optimiser,
            config.backbone,
            config.iterations,
            seed=(config.seed, STREAM_GROWTH),
            cameras=[view.camera for view in self.views],
            clearance=self._clearance,
        )

    def _new_merged(self) -> MergedBrackets | None:
        """As the configuration says, where brackets show noise; None where there is nothing to merge."""
        # Networks learn from the pictures' own pixels.
        if not (may_merge_brackets(self.config) and self.config.method.traits.splats):
            return None
        merged = MergedBrackets(self.views, self.exposures)
        is_wanted = self.config.merged_brackets == "on" and merged.worst > 0.0  # 0: none has a bracket
        return merged if is_wanted or merged.worth_it else None

    def _new_nuisances(self) -> Nuisances | None:
        """As the configuration says."""
        mode, traits = self.config.nuisances, self.config.method.traits
        if mode == "on" and not traits.effects:
            raise BadValueError(
                f"{self.config.method.name} knows of no gain, white balance or vignetting of a photo",
                "Leave out --nuisances on.",
            )
        # Merged radiance and renders in EXR have no exposure or white balance of their own any more.
        taken = any(encoding.clips for view in self.views for encoding in view.encodings)
        asked = (self.scene.photographs and taken) or self.config.calibration is not None
        wanted = mode == "on" or (mode == "auto" and asked and traits.effects)
        if not wanted:
            return None
        return Nuisances(
            self.views,
            self.exposures,
            self.device,
            response_is_known=self.config.calibration is not None,
        )

    def _new_poses(self) -> LearnedPoses | None:
        """As the configuration says."""
        mode, can_learn = self.config.poses, self.config.method.traits.splats
        if mode == "on" and not can_learn:
            raise BadValueError(f"{self.config.method.name} cannot learn poses", "Leave out --poses on.")
        if mode == "off" or (mode == "auto" and not (can_learn and self.scene.photographs)):
            return None
        return LearnedPoses(self.views, self.method.backbone.positions)

    def _calibrate(self, path: str) -> None:
        """Response and vignetting as the file at ``path`` has them."""
        calibration = read_calibration(Path(path))
        use_response(self.method, calibration, path)
        if calibration.vignetting is None or not calibration.reach:
            return
        if self.nuisances is not None:
            self.nuisances.know_lens(calibration.vignetting, calibration.reach)
        elif any(calibration.vignetting):
            is_off = self.config.nuisances == "off" and self.config.method.traits.effects
            raise BadValueError(
                f"{path} knows the lens's vignetting, which this training would take no notice of",
                "Leave out --nuisances off; of a preset that has it, set --nuisances auto."
                if is_off
                else f"{self.config.method.name} knows of none: leave out --calibration.",
            )

    # -- one iteration -----------------------------------------------------------------------------------

    def draw(self, iteration: int) -> Shot:
        """The view of an iteration (from 0), a shuffle of all views each epoch, and its pictures.

        One position in its bracket, drawn anew; with ``supervision`` "bracket" all that training may see.
        """
        epoch, position = divmod(iteration, len(self.views))
        order = np.random.default_rng([self.config.seed, STREAM_VIEWS, epoch]).permutation(len(self.views))
        index = int(order[position])
        if self.config.supervision == "bracket":
            return Shot(self.views[index], self.exposures[index])
        rng = np.random.default_rng([self.config.seed, STREAM_EXPOSURES, 1 << 32, iteration])
        return Shot(self.views[index], (int(rng.choice(self.exposures[index])),))

    def picture(self, view: View, k: int) -> torch.Tensor:
        """``[3, H, W]`` in [0, 1], on the device: what methods that sample all pictures ask for."""
        return self.pictures.get(view, k)

    def first_points(self) -> np.ndarray:
        """``[P, 3]`` metres: what methods ask for that start elsewhere, but must know where the scene is."""
        if self.scene.points is not None:
            return self.scene.points.positions.astype(np.float64)
        return seen_points(self.views, self.exposures, self.method.first_response)

    def recording(self, view: View, k: int) -> Recording:
        """The picture at position ``k`` of the view's bracket, and how it was taken."""
        return Recording(
            exposure=view.exposures[k],
            encoding=view.encodings[k],
            picture=self.pictures.get(view, k),
            mask=self.pictures.mask(view, k),
        )

    def batch(self, iteration: int) -> Batch:
        """What an iteration (from 0) sees."""
        config = self.config
        shot = view, indices = self.draw(iteration)
        camera, recordings = view.camera, [self.recording(view, k) for k in indices]
        is_half = iteration < config.half_size_until * config.iterations
        if is_half:
            camera, recordings = halved(camera, recordings)
        recordings = [
            self.targets.noted(view, k, recording, is_half)
            for k, recording in zip(indices, recordings, strict=True)
        ]
        batch = Batch(
            camera=camera,
            recordings=tuple(recordings),
            levels=tuple(1.0 for _ in self.lights) if view.is_standard else view.lighting_levels,
            iteration=iteration,
            pool=self,
            seed=(config.seed, STREAM_BATCH, iteration),
            index=view.index,
            progress=iteration / config.iterations,
        )
        for part in self.parts:
            batch = part.before(batch, shot)
        return batch

    def step(self) -> dict[str, torch.Tensor]:
        """One iteration; returns the weighted loss terms (detached)."""
        batch = self.batch(self.iteration)
        self._follow_schedule(self.iteration)
        outcome = self.method.training_outcome(batch)
        added = {part.name: term for part in self.parts if (term := part.term(outcome)) is not None}
        terms = outcome.terms | added
        torch.stack(list(terms.values())).sum().backward()
        for part in self.parts:
            part.after(outcome, batch)
        self._sound = False
        self.optimiser.step(self.iteration)
        self.iteration += 1
        for part in self.parts:
            part.step(batch)
        self._sound = True
        return {name: term.detach() for name, term in terms.items()}

    def _follow_schedule(self, iteration: int) -> None:
        self.method.follow_schedule(iteration, self.config.iterations, self.schedule.sh_degree_every)

    # -- the loop ----------------------------------------------------------------------------------------

    def run(
        self,
        folder: Path,
        *,
        should_stop: Callable[[], bool] = lambda: False,
        monitor: Monitor | None = None,
        progress_every: int = 20,
        monitor_every: int = 200,
        checkpoint_seconds: float = CHECKPOINT_SECONDS,
        between: Callable[[], float] = lambda: 0.0,
    ) -> Generator[Event, None, None]:
        """Train until done or told to stop, yielding events; a checkpoint is written on every way out.

        And every ``checkpoint_seconds``, or less often where writing would take more than
        ``CHECKPOINT_SHARE`` of the time. ``between`` is called after every iteration, when the method is
        whole and may be looked at. It returns for how many seconds it held the training up (a pause), which
        then count in no rate. Raises ``OutputError`` where the run's folder is not there any more.
        """
        is_run = (folder / CONFIG_FILE).exists()
        total = self.config.iterations
        begun, begun_cpu = time.perf_counter() - self.seconds, time.process_time() - self.cpu_seconds
        message = ". ".join([f"started from {self.start_message}", *self.scene.messages])
        yield Started(self.iteration, total, self.method.size, message)
        sums: dict[str, torch.Tensor] = {}
        window_start, window_first = time.perf_counter(), self.iteration
        next_save = time.perf_counter() + checkpoint_seconds
        try:
            while self.iteration < total and not should_stop():
                try:
                    terms = self.step()
                except CannotBeDrawnError as error:  # which says where they are NaN
                    raise self._diverged(str(error)) from error
                for name, value in terms.items():
                    sums[name] = sums.get(name, 0.0) + value
                done = self.iteration
                if done % progress_every == 0 or done == total:
                    losses = {name: float(value) / (done - window_first) for name, value in sums.items()}
                    self._refuse_nan(losses)
                    rate = (done - window_first) / (time.perf_counter() - window_start)
                    due = monitor is not None and (done % monitor_every == 0 or done == total)
                    begun_watching = time.process_time()
                    measured = monitor(self.method) if due and monitor is not None else {}
                    begun_cpu += time.process_time() - begun_watching  # training does not need it
                    yield Progress(
                        done, total, self.method.size, losses, rate, (total - done) / rate, measured
                    )
                    sums, window_start, window_first = {}, time.perf_counter(), done
                self.seconds, self.cpu_seconds = time.perf_counter() - begun, time.process_time() - begun_cpu
                if time.perf_counter() >= next_save and done < total:
                    # A loss that is no number would be noticed at the next event only.
                    self._refuse_nan({name: float(value) for name, value in sums.items()})
                    saving = time.perf_counter()
                    saved = self._save_in_place(folder, is_run)
                    now = time.perf_counter()
                    next_save = now + max(checkpoint_seconds, (now - saving) / CHECKPOINT_SHARE)
                    yield saved
                held = between()
                window_start, begun, next_save = window_start + held, begun + held, next_save + held
        finally:
            # A diverged state, or one caught in the middle of an update, is worth less than the last file.
            if self._sound:
                self._save_in_place(folder, is_run)
        yield Saved(self.iteration, str(folder / CHECKPOINT_FILE))
        message = "" if self.poses is None else str(self.poses)
        stopped = self.iteration < total
        yield Finished(self.iteration, self.seconds, self.cpu_seconds, stopped, message)

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

    def _save_in_place(self, folder: Path, is_run: bool) -> Saved:
        """Save where the run's configuration is: a checkpoint alone is no run that could go on."""
        if is_run and not (folder / CONFIG_FILE).exists():
            raise OutputError(
                f"{folder} was moved or deleted while iteration {self.iteration} was trained",
                "What was saved last is in that folder, wherever it is: resume the run there. If it is "
                "deleted, train again.",
            )
        return self.save(folder)

    # -- checkpoints ---------------------------------------------------------------------------------------

    def save(self, folder: Path) -> Saved:
        """Write everything that going on needs; raises ``OutputError``.

        ``TrainingDivergedError`` where a value is no number: what is in ``folder`` is worth more then.
        """
        tensors = {f"{NETWORKS}{k}": v for k, v in self.method.state_dict().items()}
        tensors |= {f"{PRIMITIVES}{k}": v for k, v in self.method.backbone.parameters.items()}
        tensors |= self.optimiser.state_tensors()
        for part in self.parts:
            tensors |= {f"{part.name}.{k}": v for k, v in part.tensors().items()}
        for name, tensor in tensors.items():
            if tensor.is_floating_point() and not tensor.isfinite().all():
                raise self._diverged(f"{name} has values that are not numbers")
        path = folder / CHECKPOINT_FILE
        metadata = {
            "iteration": str(self.iteration),
            "seconds": f"{self.seconds:.3f}",
            "cpu_seconds": f"{self.cpu_seconds:.3f}",
            CONFIGURATION: self.configuration,
            VIEWS: self.views_digest,
            LIGHTS: json.dumps(self.lights),
            RANGE: json.dumps(self.range),
            RESPONSES: self.responses,
        }
        save_checkpoint(path, tensors, metadata)
        return Saved(self.iteration, str(path))

    def _restore(self, folder: Path) -> dict[str, torch.Tensor]:
        """The method as the checkpoint in ``folder`` has it; returns the checkpoint's tensors."""
        path = folder / CHECKPOINT_FILE
        tensors, metadata = load_checkpoint(path)
        self.start_message = f"the checkpoint in {folder}"
        require_configuration(metadata, self.configuration, path)
        progress = progress_of(metadata, self.config.iterations, path)
        lights = lights_of(metadata, path)
        if lights != self.lights:
            raise DataMismatchError(
                f"the run in {folder} has levels of {', '.join(lights)}, the data in {self.scene.root} of "
                f"{', '.join(self.lights)}",
                "Give the data set that it was begun with.",
            )
        if responses_in(metadata, path) != self.responses:
            raise DataMismatchError(
                f"the run in {folder} was begun with other pictures than those in {self.scene.root}: the "
                "response is learned of a camera's, and known of radiance and of developed raw files",
                "Give the data set that it was begun with.",
            )
        if not np.allclose(log_radiance_range_in(metadata, path), self.range):
            raise DataMismatchError(
                f"the run in {folder} was begun with other pictures than those in {self.scene.root}: these "
                "ask for other bounds of radiance than it learned within",
                "Give the data set that it was begun with, as it was then.",
            )
        restore_method(self.method, tensors, path)
        self.views_digest = metadata[VIEWS]
        self.iteration = progress.iteration
        self.seconds, self.cpu_seconds = progress.seconds, progress.cpu_seconds
        return tensors

    def _restore_state(self, tensors: dict[str, torch.Tensor], path: Path) -> None:
        """Adam's moments and the parts as the checkpoint at ``path`` has them."""
        moments = {k: v for k, v in tensors.items() if k.startswith(ADAM)}
        wanted = self.optimiser.state_like(moments)
        for part in self.parts:
            wanted |= {f"{part.name}.{name}": like for name, like in part.tensors().items()}
        there = {k: v for k, v in tensors.items() if not k.startswith((NETWORKS, PRIMITIVES))}
        check_tensors(there, wanted, path)
        refuse_others(there, wanted, path)
        for name, tensor in there.items():
            counts = name.startswith((ADAM, Growth.name)) and not name.endswith(".exp_avg")
            if counts and (tensor < 0).any():
                raise damaged(path, f"{name} has values below 0")
        self.optimiser.load_state_tensors({k: v.to(self.device) for k, v in moments.items()})
        for part in self.parts:
            mine = {name: tensors[f"{part.name}.{name}"] for name in part.tensors()}
            part.restore({name: tensor.to(self.device) for name, tensor in mine.items()})


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


def load_method(
    folder: Path,
    config: TrainConfig,
    anchor: tuple[float, float] | None,
    implementation: Implementation = "auto",
    device: torch.device | str = "cpu",
    configuration: str = "",
) -> tuple[Method, int]:
    """The trained method of a run's folder, for rendering, and the iteration it is at.

    ``configuration``: as ``Trainer`` takes it.
    """
    path = folder / CHECKPOINT_FILE
    tensors, metadata = load_checkpoint(path)
    require_configuration(metadata, configuration or fingerprint(config), path)
    iteration = progress_of(metadata, config.iterations, path).iteration
    lights = lights_of(metadata, path)
    facts = Facts(
        anchor, implementation, lights, responses_in(metadata, path), log_radiance_range_in(metadata, path)
    )
    method = new_method(config.method, config.backbone, facts)
    restore_method(method, tensors, path)
    method.to_device(torch.device(device))
    every = in_iterations(config).sh_degree_every
    method.follow_schedule(max(iteration - 1, 0), config.iterations, every)
    return method, iteration
