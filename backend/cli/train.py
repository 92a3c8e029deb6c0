# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr train``: run the trainer, show its events, keep its logs."""

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro

from ...bridge.errors import BadValueError
from ..device import DeviceName
from ..rasterize import Implementation
from ..rasterize.cpu import set_threads
from ..train.config import TrainConfig
from ..train.presets import PRESETS
from ..train.trainer import Trainer
from .monitor import view_monitor
from .progress import EventLog, console
from .training import Workshop, resume_run, start_run
from .warmup import compile_kernels


def preset_named(argv: list[str]) -> TrainConfig:
    """The configuration of the ``--preset`` in ``argv`` (the default one if there is none)."""
    name = "default"
    for i, word in enumerate(argv):
        if word == "--preset" and i + 1 < len(argv):
            name = argv[i + 1]
        elif word.startswith("--preset="):
            name = word.partition("=")[2]
    if name not in PRESETS:
        raise BadValueError(f"there is no preset '{name}'", f"Choose from: {', '.join(PRESETS)}.")
    return PRESETS[name]


@dataclass(frozen=True)
class Train:
    """Train PhysHDR-GS, or another method, on a data set. CTRL-C saves a checkpoint; --resume goes on."""

    # The flags are those of the preset's own method and backbone, without a choice of others.
    config: Annotated[TrainConfig, tyro.conf.arg(name=""), tyro.conf.AvoidSubcommands]
    #: Folder of the data set.
    data: tyro.conf.Positional[Path | None] = None
    #: Folder of the run: configuration, checkpoint, logs.
    out: Path | None = None
    #: Go on with this run, bit-identically on the CPU; its own configuration is used.
    resume: Path | None = None
    #: Start again where --out already holds a run, replacing it.
    overwrite: bool = False
    #: Where the other options' defaults come from.
    preset: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(PRESETS) + "}")] = "default"
    #: What draws the Gaussians; auto: CUDA where there is one, else the CPU kernels.
    rasteriser: Implementation = "auto"
    #: Where to compute; auto: a CUDA card if there is one that works, else the CPU.
    device: DeviceName = "auto"
    #: CPU threads; 0: one for each core. The result depends on it by rounding alone.
    threads: int = 0
    #: Iterations between checkpoints.
    checkpoint_every: int = 2000

    def run(self) -> int:
        if self.threads:
            set_threads(self.threads)
            torch.set_num_threads(self.threads)
        trainer, folder = self._begin()
        stop = _StopOnInterrupt()
        monitor = view_monitor(trainer.scene)
        with stop, EventLog(folder) as log:
            events = trainer.run(
                folder,
                should_stop=lambda: stop.requested,
                monitor=monitor,
                checkpoint_every=self.checkpoint_every,
            )
            for event in events:
                log.show(event)
        if stop.requested:
            console.print(f"stopped; go on with: physhdr train --resume {folder}")
            return 130
        return 0

    def _begin(self) -> tuple[Trainer, Path]:
        workshop = Workshop(
            report=console.print,
            compile_kernels=compile_kernels,
            device=self.device,
            rasteriser=self.rasteriser,
        )
        if self.resume:
            trainer, run = resume_run(self.resume, self.data, workshop)
        elif self.data is None or self.out is None:
            raise BadValueError(
                "a data set and --out are needed",
                "Call: physhdr train DATA --out RUN, or: physhdr train --resume RUN",
            )
        else:
            trainer, run = start_run(
                self.data, self.out, self.config, self.preset, overwrite=self.overwrite, workshop=workshop
            )
        return trainer, run.folder


class _StopOnInterrupt:
    """While active, the first CTRL-C asks for a stop after the iteration; a second one interrupts."""

    def __init__(self) -> None:
        self.requested = False

    def __enter__(self) -> "_StopOnInterrupt":
        self._previous = signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._previous)

    def _handle(self, *_: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        console.print("stopping after this iteration and saving; CTRL-C again to leave at once")
