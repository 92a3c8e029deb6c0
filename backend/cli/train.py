# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr train``: runs the trainer, shows and logs its events."""

import dataclasses
import signal
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

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
from ..shell import OPTIONS, as_word, option
from ..train import events
from ..train.config import CONFIG_FILE, TrainConfig
from ..train.forecast.duration import Duration
from ..train.presets import PRESETS, preset_named
from ..train.saver import CHECKPOINT_SECONDS
from ..train.settings import Setting, as_text, assigned, settings_of, type_in_words, with_settings
from ..train.state import State
from ..train.trainer import run as train
from .kernels import compile_kernels
from .options import changed_options, option_name

#: Options with an effect when resuming: the run's own configuration sets all else.
ON_RESUMING = ("rasteriser", "device", "threads", "checkpoint_seconds")


def _option(setting: Setting) -> tuple[str, Any, Any]:
    """A field for ``setting`` as typed text, empty if the preset's value stays."""
    choices = {int: "INT", float: "FLOAT"}.get(setting.type, "TEXT")
    if get_origin(setting.type) is Literal:
        choices = "{" + ",".join(get_args(setting.type)) + "}"
    shown = tyro.conf.arg(
        help=setting.meaning, metavar=choices, help_behavior_hint=f"(default: {as_text(setting.value)})"
    )
    if isinstance(setting.value, tuple):
        return setting.name, Annotated[tuple[str, ...], shown], ()
    return setting.name, Annotated[str, shown], ""


#: Options for the settings listed in ``OPTIONS``.
Options: Any = make_dataclass(
    "Options", [_option(setting) for setting in settings_of(TrainConfig()) if setting.name in OPTIONS]
)


@dataclass(frozen=True)
class Train:
    """Train PhysHDR-GS, or another method, on a data set. CTRL-C saves a checkpoint; --resume continues.

    Choose the effort by --preset fast, default or high.
    """

    #: Folder of the data set.
    data: tyro.conf.Positional[Path | None] = None
    #: Folder of the run: configuration, checkpoint, logs.
    out: Path | None = None
    #: Resume this run with its own configuration, bit-identically on the CPU.
    resume: Path | None = None
    #: Start again where --out already holds a run, replacing it.
    overwrite: bool = False
    #: Values of all settings that are not given. fast and high are default with half and four times the
    #: iterations; the others are baselines and published methods.
    preset: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(PRESETS) + "}")] = "default"
    #: Renders the Gaussians; auto: CUDA if available, else the CPU kernels.
    rasteriser: Implementation = "auto"
    #: Where to compute; auto: a working CUDA card if there is one, else the CPU.
    device: DeviceName = "auto"
    #: CPU threads; 0: one per core. Affects the result by rounding only.
    threads: int = 0
    #: Seconds between checkpoints; more if writing one would take a fiftieth of the time.
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    options: Annotated[Any, tyro.conf.arg(name="", constructor=Options)] = field(default_factory=Options)
    #: Any other setting, such as backbone.budget=60000; may be repeated.
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE"), tyro.conf.UseAppendAction] = ()
    #: List all settings with the preset's values.
    help_all: bool = False

    @property
    def assignments(self) -> list[str]:
        """The given settings, as ``NAME=VALUE``: the other sizes follow from the data."""
        typed = {name: as_text(value) for name, value in vars(self.options).items() if value}
        return [*(f"{name}={value}" for name, value in typed.items()), *self.set]

    def run(self) -> int:
        if self.help_all:
            sys.stdout.write(_listed(preset_named(self.preset)))
            return 0
        if whole("--threads", self.threads, 0, THREADS_MAX):
            set_threads(self.threads)
            torch.set_num_threads(self.threads)
        if not self.checkpoint_seconds >= 0.0:
            raise BadValueError(f"--checkpoint-seconds must be 0 or more, got {self.checkpoint_seconds}")
        expected: list[Duration] = []
        with self._started(expected.append) as (state, run):
            stop = _StopOnRequest()
            with caught(stop.handle), EventLog(run.folder) as log:
                emitted = train(
                    state,
                    run.folder,
                    should_stop=lambda: stop.requested,
                    monitor=view_monitor(run.scene),
                    checkpoint_seconds=self.checkpoint_seconds,
                    between=Tidying(state),
                )
                # Closing saves, and must be able to log failures.
                with closing(emitted):
                    for event in emitted:
                        log.show(_with_time_left(event, expected))
        if state.iteration < run.config.iterations:
            aside.print(f"stopped; to resume: physhdr train --resume {as_word(run.folder)}")
            return 130
        return 0

    def _started(self, expect: Callable[[Duration], None]) -> AbstractContextManager[tuple[State, Run]]:
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
        preset = preset_named(self.preset)
        values = assigned(preset, self.assignments)
        return start_run(
            self.data,
            self.out,
            with_settings(preset, values),
            self.preset,
            typed=values,
            overwrite=self.overwrite,
            workshop=workshop,
        )

    def _refuse_settings(self, run: Path) -> None:
        """Raises ``BadValueError`` for an option that has no effect when resuming ``run``."""
        unread = [f"--{name}" for name in changed_options(self, "out", "overwrite", "preset")]
        unread += [option(text.partition("=")[0]) for text in self.assignments]
        if unread:
            allowed = ", ".join(f"--{option_name(name)}" for name in ON_RESUMING)
            raise BadValueError(
                f"{unread[0]} has no effect when resuming: the run uses its own {run / CONFIG_FILE}",
                f"Leave it out: only {allowed} have an effect. To train with other settings, start a new "
                "run: physhdr train DATA --out RUN",
            )


def _listed(config: TrainConfig) -> str:
    """All settings with their values in ``config``, types and meanings."""
    lines = [
        f"{f'{each.name}={as_text(each.value)}':<44} {type_in_words(each.type)}. {each.meaning}\n"
        for each in settings_of(config)
    ]
    return "".join(lines)


def _with_time_left(event: events.Event, expected: list[Duration]) -> events.Event:
    """The event, with its time left corrected for the cost of later iterations where known."""
    if not (expected and isinstance(event, events.Progress)):
        return event
    left = expected[0].left(event.iteration, event.iterations_per_second)
    return dataclasses.replace(event, seconds_left=left)


class _StopOnRequest:
    """``handle`` requests a stop after the iteration at the first signal, and interrupts at the second."""

    def __init__(self) -> None:
        self.requested = False

    def handle(self, _: signal.Signals) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        aside.print("stopping after this iteration and saving; CTRL-C again to leave at once")
