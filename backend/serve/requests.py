# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks requests before they are carried out."""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.limits import THREADS_MAX, whole
from ...bridge.messages import ModelExport, RunOpen, TrainResume, TrainStart
from ...bridge.model_file import SUFFIX
from ...bridge.run_folder import CHECKPOINT_FILE, CONFIG_FILE
from ..bounds import WHOLE_MAX
from ..device import DeviceName
from ..runs.begin import Workshop, resume_run, start_run
from ..runs.files import refuse_a_run
from ..runs.run import Run
from ..train.config import ITERATIONS_MAX
from ..train.presets import preset_named
from ..train.settings import with_settings
from ..train.state import State

#: A started run, held while it trains.
Begun = AbstractContextManager[tuple[State, Run]]


@dataclass(frozen=True, kw_only=True)
class Job:
    """A training to start in ``folder``; ``known``: its status before anything is read."""

    folder: Path
    begin: Callable[[Workshop], Begun]
    device: DeviceName
    threads: int
    known: dict[str, Any] = field(default_factory=dict)


def new_training(request: TrainStart) -> Job:
    """The requested job; raises ``PhysHDRError`` if it cannot start."""
    data, out = folder_of(request.data, "data"), folder_of(request.out, "out")
    config = preset_named(request.preset)
    changes: dict[str, Any] = {"exposure_mode": request.exposure_mode, "seed": request.seed}
    if request.iterations is not None:
        changes["iterations"] = whole("iterations", request.iterations, 1, ITERATIONS_MAX)
    whole("seed", request.seed, 0, WHOLE_MAX)
    whole("threads", request.threads, 0, THREADS_MAX)
    config = with_settings(config, changes)
    if not data.is_dir():
        raise FileMissingError(f"the data set folder {data} does not exist", "Choose another folder.")
    if not request.overwrite:
        refuse_a_run(out)

    def start(workshop: Workshop) -> Begun:
        return start_run(
            data,
            out,
            config,
            request.preset,
            typed=tuple(changes),
            overwrite=request.overwrite,
            workshop=workshop,
        )

    return Job(
        folder=out,
        begin=start,
        device=request.device,
        threads=request.threads,
        known={"data": str(data), "preset": request.preset, "iterations": config.iterations},
    )


def resumed_training(request: TrainResume) -> Job:
    """As ``new_training``, for an existing run."""
    folder, data = run_and_data(request)
    whole("threads", request.threads, 0, THREADS_MAX)
    require_run(folder)

    def resume(workshop: Workshop) -> Begun:
        return resume_run(folder, data, workshop)

    return Job(folder=folder, begin=resume, device=request.device, threads=request.threads)


def run_and_data(request: TrainResume | RunOpen) -> tuple[Path, Path | None]:
    """The run's folder, and its data set's if that has moved."""
    return folder_of(request.run, "run"), folder_of(request.data, "data") if request.data else None


def model_path(request: ModelExport) -> Path:
    """Where to write the model; raises ``BadValueError`` if that is not the name of a model file."""
    path = folder_of(request.path, "path")
    if path.suffix != SUFFIX:
        raise BadValueError(
            f"path is {path}, which is not the name of a model file", f"Choose a name that ends in {SUFFIX}."
        )
    return path


def folder_of(text: str, name: str) -> Path:
    """An absolute path, because clients do not know the backend's working directory. It need not exist.

    Raises ``BadValueError``, and ``OSError`` where the system refuses the path, for example as too long.
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
