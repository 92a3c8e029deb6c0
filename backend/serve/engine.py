# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: handles requests one at a time, in the only thread that uses torch and the model.

While training, it checks the inbox between iterations, where it also renders previews, pauses and stops.
"""

import logging
import time
from dataclasses import dataclass
from typing import Any

from ...bridge.camera_list import refuse_others, write_camera_list
from ...bridge.errors import PhysHDRError
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
from ...bridge.model_file import refuse_what_is_not_ours, write_model
from ...bridge.run_folder import CAMERAS_FILE, same_folder
from ..device import DeviceName
from ..kernels.ahead import Needs
from ..memory import is_out_of_memory
from ..runs.begin import Workshop
from ..runs.log import LOG_FILE
from ..runs.run import Run, open_run
from ..train.forecast.duration import Duration
from . import preview
from .curves import Curves
from .failures import BusyError, NoJobError, NoModelError, failure_of
from .inbox import Abandoned, Command, Ending, Inbox, Item
from .machine import Machine, compile_kernels, free_memory
from .requests import Job, model_path, new_training, require_run, resumed_training, run_and_data
from .server import Server
from .status import Status, device_words
from .training import Training

log = logging.getLogger(__name__)

#: While training, previews may take this share of the time; a large viewport must not stop the training.
PREVIEW_SHARE = 0.5
#: How long the engine sleeps at most; any request wakes it.
SLEEP_SECONDS = 1.0


class CancelledError(PhysHDRError):
    """Something was stopped before it had started."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """``device``, ``threads`` (0: one per core): defaults for requests. ``log``: a path, for people."""

    device: DeviceName = "auto"
    threads: int = 0
    log: str = ""


class Engine:
    """``run`` returns the reason when the process should end; by then everything is saved."""

    def __init__(self, inbox: Inbox, server: Server, curves: Curves, options: Options) -> None:
        self._inbox, self._server, self._curves, self._log = inbox, server, curves, options.log
        self._machine = Machine(options.device, options.threads)
        self._status = Status(server.publish)
        self._job: Job | None = None  # starts when its request has been answered
        self._run: Run | None = None  # shown by previews
        self._training: Training | None = None
        self._expected: Duration | None = None  # of the training that starts
        self._stopping = False
        self._is_beginning = False  # while a training is prepared
        self._pause_first = False  # pause requested before training started
        self._ending = ""
        self._next_preview = 0.0

    def run(self) -> str:
        self._machine.use_threads(0)
        device, why = self._machine.default_device()
        log.info("ready: %s", why)
        self._status.replace(JobStatus(device=device, message=f"ready, {why}"))
        while not self._ending:
            self.wait()
            if self._job:
                job, self._job = self._job, None
                self._do(job)
        return self._ending

    # -- requests ----------------------------------------------------------------------------------------

    def _attend(self, item: Item | None) -> None:
        """Handle one command, if there is one, then render one preview, if one is due."""
        if isinstance(item, Ending):
            self._ending = item.reason
            self._note_stop()
        elif isinstance(item, Abandoned):
            log.info("nobody is in control: the training stops, as requested")
            self._note_stop()
        elif item is not None:
            self._server.answer(item, self._obey(item))
        if self._status.now.state != "training" or time.monotonic() >= self._next_preview:
            self._show_a_preview()

    def look(self) -> None:
        """Handle all waiting requests, and show a preview if one is due."""
        while (item := self._inbox.take()) is not None:
            self._attend(item)
        self._attend(None)

    def wait(self) -> None:
        """Handle the next request; returns after a second if there is none."""
        self._attend(self._inbox.wait(SLEEP_SECONDS))

    @property
    def stopping(self) -> bool:
        """Whether the current work should end."""
        return self._stopping

    def _obey(self, command: Command) -> Reply | Failure:
        message = command.message
        try:
            match message:
                case TrainStart():
                    self._refuse_if_busy()
                    self._prepare(new_training(message))
                case TrainResume():
                    self._refuse_if_busy()
                    self._prepare(resumed_training(message))
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
                    if not self._status.is_running:
                        raise NoJobError("there is no training to stop")
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
            scale = (self._training or self._run).radiance_scale
            shown: Any = preview.render(self._run.method, wanted.request, self._iteration, scale)
        except Exception as error:  # noqa: BLE001 (as above: too large a picture is no reason to stop)
            shown = self._failure(error)
        self._server.show(wanted, shown)
        now = time.monotonic()
        self._next_preview = now + (now - begun) * (1.0 / PREVIEW_SHARE - 1.0)

    def _refuse_if_busy(self) -> None:
        if self._status.is_running or self._job:
            raise BusyError(
                f"a training is {self._status.now.state}: {self._status.now.run}",
                "Stop it first, or wait for its end.",
            )

    def _pause(self, paused: bool) -> None:
        if self._job or self._is_beginning:
            self._pause_first = paused
            self._status.change(message="pausing when it starts" if paused else "not pausing when it starts")
            return
        if self._status.now.state not in ("training", "paused"):
            what = "pause" if paused else "continue"
            raise NoJobError(f"there is no training to {what}: the state is {self._status.now.state}")
        assert self._training
        self._training.pause(paused)

    def _note_stop(self) -> None:
        """Save and end what is running."""
        if self._status.is_running:
            self._stopping = True
            self._status.change(state="stopping", message="saving")

    # -- jobs --------------------------------------------------------------------------------------------

    def _prepare(self, job: Job) -> None:
        """Close what was open, and show the state of the new job."""
        self._close()
        self._stopping = self._pause_first = False
        self._curves.clear()
        self._status.replace(
            JobStatus(state="preparing", run=str(job.folder), message="reading the data set", **job.known)
        )
        self._job = job

    def _do(self, job: Job) -> None:
        """Run a job until it finishes, stops or fails."""
        try:
            self._train(job)
        except CancelledError:
            self._status.change(state="idle", message="stopped before the training began")
        except Exception as error:  # noqa: BLE001 (a failed training is a state, not the process's end)
            failure = self._failure(error)
            self._close()
            self._status.change(
                state="failed",
                message=failure.message,
                failure=failure,
                has_model=False,
                lights=(),
                standard_levels=(),
            )
        finally:
            self._training, self._is_beginning = None, False
            free_memory()

    def _train(self, job: Job) -> None:
        self._machine.use_threads(job.threads)
        self._expected = None
        workshop = Workshop(
            report=self._report_preparing,
            expect=self._expect,
            compile_kernels=self._compile,
            device=self._machine.device_for(job.device),
            between=lambda: self._report_preparing(self._status.now.message),
        )
        self._is_beginning = True
        with job.begin(workshop) as (state, run):
            self._report_preparing("starting")
            self._is_beginning = False
            self._training = Training(state, run, self, self._status, self._curves, self._expected)
            self._run = run
            self._run = self._training.run_to_the_end(paused=self._pause_first)

    def _expect(self, duration: Duration) -> None:
        self._expected = duration

    def _compile(self, needs: Needs) -> None:
        compile_kernels(needs, self._report_preparing)

    def _report_preparing(self, message: str) -> None:
        """Report progress; raises ``CancelledError`` if it was stopped."""
        if self._status.now.state == "preparing" and self._status.now.message != message:
            log.info(message)
            self._status.change(message=message)
        while (item := self._inbox.take()) is not None:
            self._attend(item)
        if self._stopping:
            raise CancelledError("it was stopped before it was ready")

    # -- models ------------------------------------------------------------------------------------------

    def _open(self, request: RunOpen) -> None:
        folder, data = run_and_data(request)
        require_run(folder)
        before = self._status.now
        self._stopping = False
        self._status.replace(
            JobStatus(
                state="preparing",
                run=str(folder),
                message="opening the run",
                has_model=before.has_model,
                can_relight=before.can_relight,
                lights=before.lights,
                standard_levels=before.standard_levels,
                photographed_ev=before.photographed_ev,
                device=before.device,
            )
        )
        try:
            run = open_run(
                folder,
                data,
                device=self._machine.device_for(request.device),
                report=self._report_preparing,
                pictures=False,
            )
            if run.method.device.type != "cuda":
                self._compile(run.config.method.kernels_needed())
        except BaseException:
            self._stopping = False
            self._status.replace(before)
            raise
        self._close()
        self._run = run
        self._curves.read(folder / LOG_FILE, run.iteration)
        curves = self._curves.history()
        without = "" if run.scene.root.exists() else ", without its data set, which is missing"
        self._status.replace(
            JobStatus(
                state="open",
                run=str(folder),
                data=str(run.scene.root),
                preset=run.preset,
                device=device_words(run.method.device),
                message=f"open, at iteration {run.iteration}{without}",
                iteration=run.iteration,
                iterations=run.config.iterations,
                gaussians=run.method.size,
                monitor={"PSNR": curves.psnr[-1]} if curves.psnr else {},
                saved_iteration=run.iteration,
                has_model=True,
                can_relight=run.method.can_relight,
                lights=run.method.lights,
                standard_levels=run.method.standard_levels,
                photographed_ev=run.photographed_ev,
            )
        )

    def _export(self, request: ModelExport) -> Exported:
        path = model_path(request)
        if self._run is None:
            raise NoModelError("there is no model to export yet", "Start a training, or open a run.")
        refuse_what_is_not_ours(path)  # before the model is made, which may take seconds
        run = self._training.run if self._training else self._run
        beside = path.with_name(CAMERAS_FILE) if same_folder(path.parent, run.folder) else None
        if beside:
            refuse_others(beside)
        model = run.model()
        write_model(path, model)
        if beside:
            write_camera_list(beside, run.camera_list())
        return Exported(path=str(path), gaussians=model.count, iteration=run.iteration)

    @property
    def _iteration(self) -> int:
        """The iteration of the displayed model."""
        if self._training:
            return self._training.iteration
        return self._run.iteration if self._run else 0

    def _close(self) -> None:
        self._run = self._training = None
        free_memory()

    # -- failures ----------------------------------------------------------------------------------------

    def _failure(self, error: Exception) -> Failure:
        failure = failure_of(error, self._log, self._status.now.run)
        if failure.code in ("internal", "out_of_memory"):
            log.error("%s", failure.message, exc_info=error)
        else:
            log.warning("%s", error)
        if is_out_of_memory(error):
            free_memory()
        return failure
