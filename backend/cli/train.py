# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr train``: run the trainer, show its events, keep its logs."""

import dataclasses
import signal
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro

from ...bridge.errors import BadValueError
from ...bridge.limits import THREADS_MAX, whole
from ...bridge.signals import caught
from ..device import DeviceName
from ..rasterize import Implementation
from ..rasterize.cpu import set_threads
from ..runs.begin import Workshop, resume_run, start_run
from ..runs.log import EventLog
from ..runs.monitor import view_monitor
from ..runs.run import Run
from ..runs.terminal import aside
from ..runs.tidy import Tidying
from ..shell import as_word
from ..train import events
from ..train.config import CONFIG_FILE, TrainConfig
from ..train.duration import Duration
from ..train.presets import PRESETS
from ..train.trainer import CHECKPOINT_SECONDS, Trainer
from .kernels import compile_kernels

#: Options, by their settings' names, that count where a run goes on: its configuration says all else.
ON_RESUMING = ("resume", "rasteriser", "device", "threads", "checkpoint_seconds")


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


def options_in(argv: list[str]) -> tuple[str, ...]:
    """The settings that the options in ``argv`` name: ``--backbone.budget 9`` is ``backbone.budget``."""
    words = (word[2:].partition("=")[0] for word in argv if word.startswith("--"))
    return tuple(word.replace("-", "_") for word in words)


@dataclass(frozen=True)
class Train:
    """Train PhysHDR-GS, or another method, on a data set. CTRL-C saves a checkpoint; --resume goes on."""

    # The flags are those of the preset's own method and backbone, without a choice of others.
    config: Annotated[TrainConfig, tyro.conf.arg(name=""), tyro.conf.AvoidSubcommands]
    #: Folder of the data set.
    data: tyro.conf.Positional[Path | None] = None
    #: Folder of the run: configuration, checkpoint, logs.
    out: Path | None = None
    #: Go on with this run, bit-identically on the CPU; its own configuration is used, no other is taken.
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
    #: Seconds between checkpoints; more where writing one would take a fiftieth of the time.
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    #: What stands on the command line: sizes of the training that do not are found from the data.
    typed: tyro.conf.Suppress[tuple[str, ...]] = ()

    def run(self) -> int:
        if whole("--threads", self.threads, 0, THREADS_MAX):
            set_threads(self.threads)
            torch.set_num_threads(self.threads)
        if not self.checkpoint_seconds >= 0.0:
            raise BadValueError(f"--checkpoint-seconds must be 0 or more, got {self.checkpoint_seconds}")
        expected: list[Duration] = []
        with self._begun(expected.append) as (trainer, run):
            stop = _StopOnRequest()
            with caught(stop.handle), EventLog(run.folder) as log:
                told = trainer.run(
                    run.folder,
                    should_stop=lambda: stop.requested,
                    monitor=view_monitor(run.scene),
                    checkpoint_seconds=self.checkpoint_seconds,
                    between=Tidying(trainer),
                )
                # Closed while it can still be told what fails: it saves on its way out.
                with closing(told):
                    for event in told:
                        log.show(_with_time_left(event, expected))
        if trainer.iteration < run.config.iterations:
            aside.print(f"stopped; go on with: physhdr train --resume {as_word(run.folder)}")
            return 130
        return 0

    def _begun(self, expect: Callable[[Duration], None]) -> AbstractContextManager[tuple[Trainer, Run]]:
        workshop = Workshop(
            report=aside.print,
            expect=expect,
            compile_kernels=compile_kernels,
            device=self.device,
            rasteriser=self.rasteriser,
        )
        if self.resume:
            self._refuse_settings(self.resume)
            return resume_run(self.resume, self.data, workshop)
        if self.data is None or self.out is None:
            raise BadValueError(
                "a data set and --out are needed",
                "Call: physhdr train DATA --out RUN, or: physhdr train --resume RUN",
            )
        return start_run(
            self.data,
            self.out,
            self.config,
            self.preset,
            typed=self.typed,
            overwrite=self.overwrite,
            workshop=workshop,
        )

    def _refuse_settings(self, run: Path) -> None:
        """Raises ``BadValueError`` where something is typed that is not read where ``run`` goes on."""
        # Two dashes alone, which end the options, name none.
        unread = [name for name in self.typed if name and name not in ON_RESUMING]
        if unread:
            counting = ", ".join(_as_typed(name) for name in ON_RESUMING[1:])
            raise BadValueError(
                f"{_as_typed(unread[0])} has no effect on a run that goes on: it trains as its own "
                f"{run / CONFIG_FILE} says",
                f"Leave it out: of the options only {counting} count then. To train otherwise, begin a new "
                "run: physhdr train DATA --out RUN",
            )


def _as_typed(setting: str) -> str:
    return f"--{setting.replace('_', '-')}"


def _with_time_left(event: events.Event, expected: list[Duration]) -> events.Event:
    """The event, its time left by what iterations cost later on, where that is known."""
    if not (expected and isinstance(event, events.Progress)):
        return event
    left = expected[0].left(event.iteration, event.iterations_per_second)
    return dataclasses.replace(event, seconds_left=left)


class _StopOnRequest:
    """Whose ``handle`` at the first signal asks for a stop after the iteration; at a second it interrupts."""

    def __init__(self) -> None:
        self.requested = False

    def handle(self, _: signal.Signals) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        aside.print("stopping after this iteration and saving; CTRL-C again to leave at once")
