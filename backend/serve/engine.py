# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: does what is asked, one thing at a time, in the one thread that touches torch and the model.

While it trains, it looks into the inbox between iterations: that is where previews are rendered, where a
pause is waited out and where a stop is noticed.
"""

import ctypes
import dataclasses
import gc
import logging
import math
import os
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch

from ...bridge.errors import BadValueError, FileMissingError, PhysHDRError
from ...bridge.messages import (
    Done,
    Exported,
    Failure,
    JobStatus,
    ModelExport,
    Reply,
    RunOpen,
    Shutdown,
    TrainContinue,
    TrainPause,
    TrainResume,
    TrainStart,
    TrainStop,
)
from ...bridge.model_file import SUFFIX, refuse_what_is_not_ours, write_model
from ..device import DeviceName, choose_device
from ..kernels.ahead import Needs, compile_ahead
from ..memory import is_out_of_memory
from ..methods.registry import kernels_needed
from ..rasterize.cpu import set_threads, thread_count
from ..runs.begin import Workshop, resume_run, start_run
from ..runs.files import refuse_a_run
from ..runs.log import LOG_FILE, EventLog
from ..runs.monitor import view_monitor
from ..runs.run import Run, open_run
from ..train import events
from ..train.config import CONFIG_FILE, ITERATIONS_MAX, SEED_MAX, TrainConfig
from ..train.presets import PRESETS
from ..train.trainer import CHECKPOINT_FILE, Trainer
from . import preview
from .curves import Curves, Speed
from .failures import BusyError, NoJobError, NoModelError, failure_of
from .inbox import Abandoned, Command, Ending, Inbox, Item
from .server import Server

log = logging.getLogger(__name__)

#: Seconds between two statuses while a training runs; changes of state are told at once.
STATUS_SECONDS = 0.25
#: While training, previews may take this share of the time; a large viewport must not stop the training.
PREVIEW_SHARE = 0.5
#: A preview draws radiance and depth; the kernels for so many channels are compiled with the method's own.
PREVIEW_CHANNELS = 4
THREADS_MAX = 256
#: How long the engine sleeps at most; whatever is asked wakes it before.
SLEEP_SECONDS = 1.0

#: A run that is begun, held for as long as it is trained.
Begun = AbstractContextManager[tuple[Trainer, Run]]

RUNNING = ("preparing", "training", "paused", "stopping")


class CancelledError(PhysHDRError):
    """Something was stopped before it had properly begun."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """``device``, ``threads`` (0: one a core): where requests leave it open. ``log``: a path, for people."""

    device: DeviceName = "auto"
    threads: int = 0
    log: str = ""


class Engine:
    """``run`` returns when the process shall end, with the reason; everything is saved by then."""

    def __init__(self, inbox: Inbox, server: Server, curves: Curves, options: Options) -> None:
        self._inbox, self._server, self._curves, self._options = inbox, server, curves, options
        self._default_threads = options.threads or thread_count()
        self._status = JobStatus()
        self._job: Callable[[], None] | None = None  # to be begun when its request has been answered
        self._run: Run | None = None  # what previews show
        self._trainer: Trainer | None = None
        self._speed = Speed()
        self._paused = self._stopping = False
        self._ending = ""
        self._next_status = self._next_preview = 0.0

    def run(self) -> str:
        self._set_threads(0)
        device, why = self._default_device()
        log.info("ready: %s", why)
        self._tell(JobStatus(device=device, message=f"ready, {why}"))
        while not self._ending:
            self._attend(self._inbox.wait(SLEEP_SECONDS))
            if self._job:
                job, self._job = self._job, None
                self._do(job)
        return self._ending

    # -- what is asked -----------------------------------------------------------------------------------

    def _attend(self, item: Item | None) -> None:
        """One command, if there is one, then one preview, if it is time for one."""
        if isinstance(item, Ending):
            self._ending = item.reason
            self._note_stop()
        elif isinstance(item, Abandoned):
            log.info("nobody is in control: the training stops, as was wished")
            self._note_stop()
        elif item is not None:
            self._server.answer(item, self._obey(item))
        if self._status.state != "training" or time.monotonic() >= self._next_preview:
            self._show_a_preview()

    def _attend_to_all(self) -> None:
        while (item := self._inbox.take()) is not None:
            self._attend(item)
        self._attend(None)

    def _obey(self, command: Command) -> Reply | Failure:
        message = command.message
        try:
            match message:
                case TrainStart():
                    self._refuse_if_busy()
                    self._job = self._starting(message)
                case TrainResume():
                    self._refuse_if_busy()
                    self._job = self._resuming(message)
                case RunOpen():
                    self._refuse_if_busy()
                    self._open(message)
                case ModelExport():
                    return self._export(message)
                case TrainPause():
                    self._pause(True)
                case TrainContinue():
                    self._pause(False)
                case TrainStop():
                    if self._status.state not in RUNNING:
                        raise NoJobError("no training runs that could be stopped")
                    self._note_stop()
                case Shutdown():
                    self._ending = f"{command.name} shut the backend down"
                    self._note_stop()
        except Exception as error:  # noqa: BLE001 (whatever a request does must not end a training)
            return self._failure(error)
        return Done()

    def _show_a_preview(self) -> None:
        wanted = self._inbox.take_preview()
        if wanted is None:
            return
        begun = time.monotonic()
        try:
            if self._run is None:
                raise NoModelError("there is no model to render yet", "Start a training, or open a run.")
            shown: Any = preview.render(self._run.splatting, wanted.request, self._iteration)
        except Exception as error:  # noqa: BLE001 (as above: too large a picture is no reason to stop)
            shown = self._failure(error)
        self._server.show(wanted, shown)
        now = time.monotonic()
        self._next_preview = now + (now - begun) * (1.0 / PREVIEW_SHARE - 1.0)

    def _refuse_if_busy(self) -> None:
        if self._status.state in RUNNING or self._job:
            raise BusyError(
                f"a training is {self._status.state}: {self._status.run}",
                "Stop it first, or wait for its end.",
            )

    def _pause(self, paused: bool) -> None:
        if self._status.state not in ("training", "paused"):
            what = "pause" if paused else "continue"
            raise NoJobError(f"there is no training to {what}: the state is {self._status.state}")
        assert self._trainer
        self._paused = paused
        self._speed.clear()
        self._update(
            state="paused" if paused else "training",
            iteration=self._trainer.iteration,
            gaussians=self._trainer.method.size,
            iterations_per_second=0.0,
        )

    def _note_stop(self) -> None:
        """Whatever runs shall end, saved."""
        if self._status.state in RUNNING:
            self._stopping = True
            self._update(state="stopping", message="saving")

    # -- jobs --------------------------------------------------------------------------------------------

    def _starting(self, request: TrainStart) -> Callable[[], None]:
        """The job that the request asks for; raises where it cannot be begun."""
        data, out = folder_of(request.data, "data"), folder_of(request.out, "out")
        if request.preset not in PRESETS:
            raise BadValueError(
                f"there is no preset {request.preset!r}", f"Choose from: {', '.join(PRESETS)}."
            )
        config = PRESETS[request.preset]
        changes: dict[str, Any] = {"exposure_mode": request.exposure_mode, "seed": request.seed}
        if request.iterations is not None:
            changes["iterations"] = whole("iterations", request.iterations, 1, ITERATIONS_MAX)
        whole("seed", request.seed, 0, SEED_MAX)
        whole("threads", request.threads, 0, THREADS_MAX)
        config = cast(TrainConfig, dataclasses.replace(config, **changes))
        if not data.is_dir():
            raise FileMissingError(f"the data set folder {data} does not exist", "Choose another folder.")
        if not request.overwrite:
            refuse_a_run(out)

        def start(workshop: Workshop) -> Begun:
            return start_run(
                data, out, config, request.preset, overwrite=request.overwrite, workshop=workshop
            )

        self._prepare(out, data=str(data), preset=request.preset, iterations=config.iterations)
        return lambda: self._train(start, request.device, request.threads)

    def _resuming(self, request: TrainResume) -> Callable[[], None]:
        folder = folder_of(request.run, "run")
        data = folder_of(request.data, "data") if request.data else None
        whole("threads", request.threads, 0, THREADS_MAX)
        require_run(folder)

        def resume(workshop: Workshop) -> Begun:
            return resume_run(folder, data, workshop)

        self._prepare(folder)
        return lambda: self._train(resume, request.device, request.threads)

    def _prepare(self, folder: Path, **known: Any) -> None:
        """What was open is closed, and the state is that of the new job."""
        self._close()
        self._paused = self._stopping = False
        self._curves.clear()
        self._tell(JobStatus(state="preparing", run=str(folder), message="reading the data set", **known))

    def _do(self, job: Callable[[], None]) -> None:
        """Run a job to its end, whatever that is."""
        try:
            job()
        except CancelledError:
            self._update(state="idle", message="stopped before the training began")
        except Exception as error:  # noqa: BLE001 (a failed training is a state, not the process's end)
            failure = self._failure(error)
            self._close()
            self._update(state="failed", message=failure.message, failure=failure, has_model=False, lights=())
        finally:
            self._trainer = None
            self._free_memory()

    def _train(self, begin: Callable[[Workshop], Begun], device: DeviceName, threads: int) -> None:
        self._set_threads(threads)
        with begin(self._workshop(device)) as (trainer, run):
            self._train_to_the_end(trainer, run)

    def _train_to_the_end(self, trainer: Trainer, run: Run) -> None:
        self._progress_of_preparing("starting")
        self._trainer, self._run = trainer, run
        self._curves.read(run.folder / LOG_FILE, run.iteration)
        self._speed.clear()
        self._update(
            state="training",
            message=trainer.start_message,
            data=str(run.scene.root),
            preset=run.preset,
            device=device_words(trainer.device),
            iteration=trainer.iteration,
            iterations=run.config.iterations,
            gaussians=run.method.size,
            saved_iteration=run.iteration,
            has_model=True,
            can_relight=run.method.can_relight,
            lights=run.method.lights,
        )
        told = trainer.run(
            run.folder,
            should_stop=lambda: self._stopping,
            monitor=view_monitor(run.scene),
            between=self._between_iterations,
        )
        # Closed while it can still be told what fails: it saves on its way out.
        with EventLog(run.folder) as kept, closing(told):
            for event in told:
                kept.show(event)
                self._note(event)
        self._run = dataclasses.replace(run, iteration=trainer.iteration)
        stopped = trainer.iteration < run.config.iterations
        self._update(
            state="stopped" if stopped else "finished",
            message=f"{'stopped' if stopped else 'finished'} at iteration {trainer.iteration}",
            iteration=trainer.iteration,
            gaussians=run.method.size,
            iterations_per_second=0.0,
            seconds_left=0.0,
        )

    def _between_iterations(self) -> float:
        """Look into the inbox; returns the seconds of a pause."""
        self._attend_to_all()
        held = 0.0
        if self._paused and not self._stopping:
            begun = time.perf_counter()
            while self._paused and not self._stopping:
                self._attend(self._inbox.wait(SLEEP_SECONDS))
            held = time.perf_counter() - begun
        now = time.monotonic()
        if now >= self._next_status and self._status.state == "training":
            self._next_status = now + STATUS_SECONDS
            self._update(**self._pace(now))
        return held

    def _pace(self, now: float) -> dict[str, Any]:
        assert self._trainer
        iteration, total = self._trainer.iteration, self._status.iterations
        rate = self._speed.note(now, iteration)
        return {
            "iteration": iteration,
            "gaussians": self._trainer.method.size,
            "iterations_per_second": rate,
            "seconds_left": (total - iteration) / rate if rate else 0.0,
        }

    def _note(self, event: events.Event) -> None:
        if isinstance(event, events.Progress):
            losses, monitor = finite(event.losses), finite(event.monitor)
            self._curves.add(event.iteration, losses, monitor)
            # Told with the next status: nothing is sent more often than that.
            self._status = dataclasses.replace(
                self._status, losses=losses, monitor=self._status.monitor | monitor
            )
        elif isinstance(event, events.Saved):
            self._update(saved_iteration=event.iteration)

    # -- models ------------------------------------------------------------------------------------------

    def _open(self, request: RunOpen) -> None:
        folder = folder_of(request.run, "run")
        data = folder_of(request.data, "data") if request.data else None
        require_run(folder)
        before = self._status
        self._stopping = False
        self._tell(
            JobStatus(
                state="preparing",
                run=str(folder),
                message="opening the run",
                has_model=before.has_model,
                can_relight=before.can_relight,
                lights=before.lights,
                device=before.device,
            )
        )
        try:
            run = open_run(
                folder, data, device=self._device(request.device), report=self._progress_of_preparing
            )
            if run.method.device.type != "cuda":
                self._compile(kernels_needed(run.config.method))
        except BaseException:
            self._stopping = False
            self._tell(before)
            raise
        self._close()
        self._run = run
        self._curves.read(folder / LOG_FILE, run.iteration)
        curves = self._curves.history()
        self._tell(
            JobStatus(
                state="open",
                run=str(folder),
                data=str(run.scene.root),
                preset=run.preset,
                device=device_words(run.method.device),
                message=f"open, at iteration {run.iteration}",
                iteration=run.iteration,
                iterations=run.config.iterations,
                gaussians=run.method.size,
                monitor={"PSNR": curves.psnr[-1]} if curves.psnr else {},
                saved_iteration=run.iteration,
                has_model=True,
                can_relight=run.method.can_relight,
                lights=run.method.lights,
            )
        )

    def _export(self, request: ModelExport) -> Exported:
        path = folder_of(request.path, "path")
        if path.suffix != SUFFIX:
            raise BadValueError(
                f"path is {path}, which is no name of a model file", f"Choose a name that ends in {SUFFIX}."
            )
        if self._run is None:
            raise NoModelError("there is no model to export yet", "Start a training, or open a run.")
        refuse_what_is_not_ours(path)  # before the model is made, which may take seconds
        run = dataclasses.replace(self._run, iteration=self._iteration)
        model = run.model()
        write_model(path, model)
        return Exported(path=str(path), gaussians=model.count, iteration=run.iteration)

    @property
    def _iteration(self) -> int:
        """Of the model that is shown."""
        if self._trainer:
            return self._trainer.iteration
        return self._run.iteration if self._run else 0

    def _close(self) -> None:
        self._run = self._trainer = None
        self._free_memory()

    def _free_memory(self) -> None:
        """Give back what nobody uses any more: the card's, and what the heap keeps (``simd.heap``)."""
        gc.collect()
        if torch.cuda.is_available():
            torch.cuda.empty_cache()
        if sys.platform.startswith("linux"):
            trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's
            if trim:
                trim(0)

    # -- preparing ---------------------------------------------------------------------------------------

    def _workshop(self, device: DeviceName) -> Workshop:
        return Workshop(
            report=self._progress_of_preparing, compile_kernels=self._compile, device=self._device(device)
        )

    def _device(self, asked: DeviceName) -> DeviceName:
        return self._options.device if asked == "auto" else asked

    def _compile(self, needs: Needs) -> None:
        """The kernels of a method and of its previews."""
        compile_ahead(
            needs | Needs(channels=(PREVIEW_CHANNELS,)),
            lambda what, done, total: self._progress_of_preparing(
                f"compiling kernels {done}/{total}: {what}"
            ),
        )

    def _progress_of_preparing(self, message: str) -> None:
        """Tell what is done; raises ``CancelledError`` where it is wanted no more."""
        if self._status.state == "preparing" and self._status.message != message:
            log.info(message)
            self._update(message=message)
        while (item := self._inbox.take()) is not None:
            self._attend(item)
        if self._stopping:
            raise CancelledError("it was stopped before it was ready")

    def _set_threads(self, asked: int) -> None:
        count = asked or self._default_threads
        set_threads(count)
        torch.set_num_threads(count)

    def _default_device(self) -> tuple[str, str]:
        try:
            device, why = choose_device(self._options.device, log.info)
        except BadValueError as error:
            return "", error.message  # a training that asks for another one still works
        return device_words(device), why

    # -- telling -----------------------------------------------------------------------------------------

    def _tell(self, status: JobStatus) -> None:
        if not status.device:
            status = dataclasses.replace(status, device=self._status.device)
        self._status = status
        self._server.publish(status)

    def _update(self, **changes: Any) -> None:
        self._tell(dataclasses.replace(self._status, **changes))

    def _failure(self, error: Exception) -> Failure:
        failure = failure_of(error, self._options.log, self._status.run)
        if failure.code in ("internal", "out_of_memory"):
            log.error("%s", failure.message, exc_info=error)
        else:
            log.warning("%s", error)
        if is_out_of_memory(error):
            self._free_memory()
        return failure


def device_words(device: torch.device) -> str:
    """``cpu``, or ``cuda (name of the card)``."""
    return "cpu" if device.type == "cpu" else f"cuda ({torch.cuda.get_device_name(device)})"


def finite(values: dict[str, float]) -> dict[str, float]:
    """Without infinities (the PSNR of equal pictures) and NaN: JSON has no words for them."""
    return {name: value for name, value in values.items() if math.isfinite(value)}


def whole(name: str, value: int, least: int, most: int) -> int:
    if not least <= value <= most:
        raise BadValueError(f"{name} is {value}", f"It must be from {least} to {most}.")
    return value


def folder_of(text: str, name: str) -> Path:
    """An absolute path: the backend's working directory is nobody's business.

    Raises ``BadValueError``, and ``OSError`` where the system will not have the path, be it too long. That
    there is nothing at it is for those to tell who need something there.
    """
    try:
        usable = "\0" not in text and bool(os.fsencode(text))
    except UnicodeEncodeError:
        usable = False
    if not usable or not Path(text).is_absolute():
        raise BadValueError(f"{name} is {text!r}, not an absolute path", "Give the whole path.")
    with suppress(FileNotFoundError, NotADirectoryError):
        os.lstat(text)
    return Path(text)


def require_run(folder: Path) -> None:
    """Raises ``FileMissingError`` where the folder holds no run."""
    for name in (CONFIG_FILE, CHECKPOINT_FILE):
        if not (folder / name).is_file():
            raise FileMissingError(
                f"{folder} is not a run: there is no {name} in it", "Choose another folder."
            )
