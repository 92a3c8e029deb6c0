# SPDX-License-Identifier: GPL-3.0-or-later
"""How a training begins: the trainer and its folder, for the command line and for the server alike."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from ...bridge.errors import DataMismatchError
from ..device import DeviceName, choose_device
from ..kernels.warmup import Needs
from ..methods.registry import kernels_needed
from ..rasterize import Implementation
from ..scene import Scene, read_scene
from ..train.config import CONFIG_FILE, TrainConfig, read_config, write_config
from ..train.presets import PRESETS
from ..train.trainer import CHECKPOINT_FILE, Trainer
from ..train.without_effect import changed_without_effect
from .progress import EventLog
from .run_folder import Run, writable_folder


@dataclass(frozen=True, kw_only=True)
class Workshop:
    """Where and with what a training is done, and who is told of it.

    ``report``: what happens, in words. ``compile_kernels``: makes sure that the CPU's kernels are there.
    """

    report: Callable[[str], None]
    compile_kernels: Callable[[Needs], object]
    device: DeviceName = "auto"
    rasteriser: Implementation = "auto"

    def place(self, config: TrainConfig) -> torch.device:
        """The device, ready for ``config``'s method."""
        device, why = choose_device(self.device, self.report)
        self.report(f"computing {why}")
        if device.type == "cpu" and self.rasteriser in ("auto", "cpu"):
            # Before the trainer is made, which calls some of them.
            self.compile_kernels(kernels_needed(config.method))
        return device

    def trainer(self, scene: Scene, config: TrainConfig, resumed: Path | None = None) -> Trainer:
        return Trainer(scene, config, self.rasteriser, self.place(config), resumed)


def refuse_a_run(folder: Path) -> None:
    """Raises ``DataMismatchError`` where the folder holds a run already."""
    if (folder / CHECKPOINT_FILE).exists():
        raise DataMismatchError(
            f"{folder} already holds a run",
            "Go on with it by --resume, replace it by --overwrite, or choose another --out.",
        )


def start_run(
    data: Path, out: Path, config: TrainConfig, preset: str, *, overwrite: bool, workshop: Workshop
) -> tuple[Trainer, Run]:
    """A new run in ``out``, at iteration 0; raises what reading, training and writing raise."""
    if not overwrite:
        refuse_a_run(out)
    scene = read_scene(data, config.downscale)
    folder = writable_folder(out)
    trainer = workshop.trainer(scene, config)
    if preset in PRESETS and (options := changed_without_effect(trainer, PRESETS[preset])):
        workshop.report(f"this method, on its backbone, does not read {', '.join(options)}")
    EventLog.clear(folder)
    write_config(folder / CONFIG_FILE, config, data, preset)
    return trainer, Run(folder, preset, config, scene, trainer.method, 0)


def resume_run(folder: Path, data: Path | None, workshop: Workshop) -> tuple[Trainer, Run]:
    """A run from its checkpoint; ``data`` stands in for its data set, where that has moved."""
    config, trained_on, preset = read_config(folder / CONFIG_FILE)
    trainer = workshop.trainer(read_scene(data or trained_on, config.downscale), config, folder)
    run = Run(writable_folder(folder), preset, config, trainer.scene, trainer.method, trainer.iteration)
    return trainer, run
