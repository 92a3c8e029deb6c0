# SPDX-License-Identifier: GPL-3.0-or-later
"""How a training begins: its state and its folder, for the command line and for the server alike."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import torch

from ...bridge.regular import require_text, resolved
from ..device import DeviceName, choose_device
from ..kernels.ahead import Needs
from ..rasterize import Implementation
from ..scene import Scene, read_scene
from ..scene.prefetch import reading_ahead
from ..train.begin import begin, resume
from ..train.config import CONFIG_FILE, TrainConfig, read_config, write_config
from ..train.forecast.duration import Duration, time_training
from ..train.forecast.memory import check_memory
from ..train.forecast.size import sized
from ..train.plan import planned
from ..train.presets import PRESETS
from ..train.state import State
from ..train.without_effect import changed_without_effect
from .files import holds_a_run, refuse_a_run, remove_results, remove_unfinished, writable_folder
from .lock import hold
from .log import EventLog
from .run import Run
from .views import as_trained, write_views


@dataclass(frozen=True, kw_only=True)
class Workshop:
    """Where and with what a training is done, and who is told of it.

    ``report``: what happens, in words. ``expect``: how long it will take, where that was found out.
    ``compile_kernels``: makes sure that the CPU's kernels are there. ``between``: called while it is
    timed, so that a stop need not wait for that, and before a run that was there goes; what it raises
    ends it.
    """

    report: Callable[[str], None]
    expect: Callable[[Duration], None]
    compile_kernels: Callable[[Needs], object]
    device: DeviceName = "auto"
    rasteriser: Implementation = "auto"
    between: Callable[[], object] = lambda: None

    def begin(self, scene: Scene, config: TrainConfig) -> State:
        """A training at its beginning; raises ``NotEnoughMemoryError`` before anything that takes long."""
        device = self._ready(scene, config)
        return self._timed(begin(scene, config, self.rasteriser, device))

    def resume(self, folder: Path, scene: Scene, config: TrainConfig, configuration: str) -> State:
        """That of ``folder`` from its checkpoint (``train.begin.resume``); raises as ``begin``."""
        device = self._ready(scene, config, resumed=True)
        return self._timed(resume(folder, scene, config, self.rasteriser, device, configuration))

    def _ready(self, scene: Scene, config: TrainConfig, *, resumed: bool = False) -> torch.device:
        """The device, which has the memory for it, and the kernels that a beginning calls, too."""
        device, why = choose_device(self.device)
        self.report(f"computing {why}")
        check_memory(planned(scene, config), device, self.report, resumed=resumed)
        if device.type == "cpu" and self.rasteriser in ("auto", "cpu"):
            self.compile_kernels(config.method.kernels_needed())
        return device

    def _timed(self, state: State) -> State:
        duration = time_training(state, between=self.between)
        if duration is not None:
            self.report(f"training will take {duration}")
            self.expect(duration)
        return state


@contextmanager
def start_run(
    data: Path,
    out: Path,
    config: TrainConfig,
    preset: str,
    *,
    typed: Collection[str],
    overwrite: bool,
    workshop: Workshop,
) -> Iterator[tuple[State, Run]]:
    """A new run in ``out``, at iteration 0; nobody else trains there while this is active.

    What of ``config`` follows from the data, and is not among the ``typed`` settings, is found here
    (``train/forecast/size.py``); the run's own configuration has it.
    A run that was there stays as it is until the new one can begin, and is gone from then on. Raises what
    reading, training and writing raise.
    """
    for path in (data, out):
        require_text(str(resolved(path)))  # as config.json will have it: the working directory counts
    if not overwrite:
        refuse_a_run(out)
    holds_a_run(out)
    with _folder(out) as folder, hold(folder, workshop.report):
        if not overwrite:  # another training may have ended just now
            refuse_a_run(folder)
        scene = read_scene(data, config.downscale, config.color_space)
        config, found = sized(scene, config, typed)
        if found:
            workshop.report(found)
        state = workshop.begin(scene, config)
        if preset in PRESETS and (options := changed_without_effect(state, PRESETS[preset])):
            workshop.report(f"this method, on its backbone, does not read {', '.join(options)}")
        workshop.between()  # the last moment at which the run that was there can stay
        # In this order: old weights must never lie beside a new configuration, whenever this is killed.
        if holds_a_run(folder):
            remove_results(folder)
            EventLog.clear(folder)
        write_config(folder / CONFIG_FILE, config, data, preset)
        state.views_digest = write_views(folder, scene)
        with reading_ahead(state, config.iterations):
            yield state, Run(folder, preset, config, scene, state.method, 0)


@contextmanager
def resume_run(folder: Path, data: Path | None, workshop: Workshop) -> Iterator[tuple[State, Run]]:
    """A run from its checkpoint; nobody else trains there while this is active.

    ``data`` stands in for its data set, where that has moved. The views are those that it was begun with.
    Raises ``DataMismatchError``, before anything is changed, where the data set is another, or another by
    now: what was learned would be trained away.
    """
    read_config(folder / CONFIG_FILE)  # or there is no run, and nothing to hold
    with hold(writable_folder(folder), workshop.report):
        remove_unfinished(folder)
        written = read_config(folder / CONFIG_FILE)
        scene = read_scene(data or written.data, written.config.downscale, written.config.color_space)
        scene = as_trained(folder, scene, workshop.report)
        state = workshop.resume(folder, scene, written.config, written.fingerprint)
        run = Run(folder, written.preset, written.config, scene, state.method, state.iteration)
        with reading_ahead(state, run.config.iterations):
            yield state, run


@contextmanager
def _folder(out: Path) -> Iterator[Path]:
    """The folder, made where there is none; it does not stay where nothing was put into it."""
    is_new = not out.exists()
    try:
        yield writable_folder(out)
    finally:
        if is_new:
            with suppress(OSError):  # it holds a run
                out.rmdir()
