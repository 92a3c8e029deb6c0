# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render`` for pictures, EXR or PNG: one, a sequence, all views, or the confidence."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from ...bridge.confidence import MEANING
from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.lights import as_levels
from ...bridge.limits import EXPOSURE, THREADS_MAX, whole
from ...bridge.probe import WIDTH
from ...bridge.shots import Shots
from ..evaluate.camera_path import camera_of, levels_of
from ..evaluate.picture_folder import write_pictures
from ..evaluate.results import VIEWS_OF
from ..runs.files import writable_folder
from ..runs.run import Run, open_run
from .confidence import gaussians_with_confidence, write_confidence, write_confidence_around
from .layers import GaussianConfidence
from .lighting import requested_levels
from .options import changed_options
from .output import printer, progress
from .rendering import CameraOptions, LookOptions, Rendering, camera_named
from .sequence import (
    Frame,
    Opened,
    begin,
    model_digest,
    numbered,
    plan_file,
    render_all,
    render_frame,
    render_in_parallel,
    require_model,
    threads_each,
)

#: File name endings of pictures.
SUFFIXES = (".exr", ".png")


@dataclass(frozen=True, kw_only=True)
class PictureOptions:
    """One picture, or one per frame of --camera."""

    #: Write one .exr with all layers: radiance with alpha, depth, each light's contribution, confidence.
    #: docs/formats.md
    layers: bool = False
    #: Processes that render the frames of --camera, sharing the threads, each with its own memory.
    workers: int = 1
    #: Render all frames of --camera again; otherwise existing ones are kept.
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class Picture(Rendering, CameraOptions, LookOptions, PictureOptions):
    """Render a camera of the data set at any exposure and lighting level, or numbered frames along a path."""

    def work(self) -> dict[str, Any]:
        self._check()
        say = printer(self.json)
        if self.camera is not None:
            return self._along(self.camera, say)
        run = self._opened(say)
        levels = requested_levels(
            self.lighting_level, self.lighting_levels, run.method.lights, run.method.standard_levels
        )
        camera = camera_named(run.scene, self.view)
        if self.width is not None:
            camera = camera.resized(self.width)
        exposure = self.exposure or run.scene.middle_exposure
        render_frame(
            run, Frame(self.only_out, camera, exposure, levels, self.layers), self._confidence(run, say)
        )
        say(f"wrote {self.only_out}")
        return {"out": str(self.only_out), "frames": 1}

    def _check(self) -> None:
        """Raises ``BadValueError`` for options that do not go together."""
        kind = self.only_out.suffix.lower()
        if not (self.lighting_level or 0.0) >= 0.0:
            raise BadValueError(f"--lighting-level must be 0 or more, got {self.lighting_level}")
        if self.exposure is not None:
            EXPOSURE.check(self.exposure, "--exposure")
        whole("--workers", self.workers, 1, THREADS_MAX)
        if self.layers and (kind != ".exr" or self.exposure is not None):
            raise BadValueError(
                "--layers writes radiance: one .exr, which has no exposure",
                "Let --out end in .exr, and leave --exposure out.",
            )
        if kind == ".exr" and self.exposure is not None:
            raise BadValueError(
                f"--exposure has no effect on {self.only_out.name}, which is radiance",
                "Leave it out, or let --out end in .png.",
            )
        self.require_file()
        if self.camera is None and (changed := changed_options(self, "workers", "overwrite")):
            raise BadValueError(
                f"--{changed[0]} only works with --camera FILE", "Leave it out, or give a file."
            )
        if self.camera is not None and self.view is not None:
            raise BadValueError("--view is one camera, --camera a file of them", "Leave one of them out.")

    def _opened(self, say: Callable[[str], None]) -> Run:
        return open_run(self.source, self.data, self.rasteriser, self.device, say, pictures=False)

    def _confidence(self, run: Run, say: Callable[[str], None]) -> GaussianConfidence | None:
        """The confidence for --layers; None without it, and, with a message, where pictures are missing."""
        if not self.layers:
            return None
        try:
            return GaussianConfidence(*gaussians_with_confidence(run))
        except FileMissingError as error:
            say(f"without the layer Confidence: {error.message}")
            return None

    def _along(self, file: Path, say: Callable[[str], None]) -> dict[str, Any]:
        """Render the frames of a file of cameras."""
        model = model_digest(self.source)
        run = self._opened(say)
        require_model(self.source, model)
        out, shots = self.only_out, self.shots(run.scene, file)
        frames = self._frames(run, shots)
        if len(frames) == 1 and "#" not in out.name:
            render_frame(run, frames[0], self._confidence(run, say))
            say(f"wrote {out}")
            return {"out": str(out), "frames": 1}
        writable_folder(out.parent)
        plan = plan_file(out)
        left = begin(frames, plan, model, self.layers and run.seen() is not None, self.overwrite)
        confidence = self._confidence(run, say) if left else None
        workers = min(self.workers, len(left))
        with progress("render", "frame", self.json) as show:
            if workers > 1:
                opened = Opened(self.source, self.data, self.rasteriser, self.device, model)
                threads = threads_each(workers, torch.get_num_threads())
                render_in_parallel(opened, left, workers, threads, confidence, show)
            else:
                render_all(run, left, confidence, show)
        existing = f"; {len(frames) - len(left)} existed already" if len(left) < len(frames) else ""
        say(f"wrote {len(left)} of {len(frames)} frames, {out}{existing}")
        return {"out": str(out), "frames": len(frames)}

    def _frames(self, run: Run, shots: Shots) -> list[Frame]:
        """The frames, from the file and the options."""
        lights, standard = run.method.lights, run.method.standard_levels
        levels = requested_levels(self.lighting_level, self.lighting_levels, lights, standard)
        if any(shot.levels for shot in shots.frames):
            if changed := changed_options(self, "lighting_level", "lighting_levels"):
                raise BadValueError(f"--{changed[0]}: the file of cameras has levels", "Leave it out.")
            lit = [levels_of(shot, lights, standard) for shot in shots.frames]
        else:
            lit = [levels] * len(shots.frames)
        exposure = self.exposure or run.scene.middle_exposure
        paths = numbered(self.only_out, len(shots.frames))
        return [
            Frame(
                path,
                camera_of(shot, shots, self.width),
                exposure * 2.0**shot.exposure_ev,
                as_levels(at, lights),
                self.layers,
            )
            for path, shot, at in zip(paths, shots.frames, lit, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class Views(Rendering):
    """Every view of a split at every exposure, and its radiance."""

    split: Literal["test", "val"]

    def work(self) -> dict[str, Any]:
        if self.width is not None:
            raise BadValueError(
                "--width has no effect on --split, whose pictures have their own size", "Leave it out."
            )
        out, say = self.only_out, printer(self.json)
        run = open_run(self.source, self.data, self.rasteriser, self.device, say)
        if not run.scene.splits[self.split]:
            raise BadValueError(
                f"{run.scene.root} has no {VIEWS_OF[self.split]}", "Choose the other --split."
            )
        with progress("render", "view", self.json) as show:
            count = write_pictures(run.method, run.scene, out, self.split, show)
        say(f"wrote {count} pictures into {out}")
        return {"out": str(out), "frames": count}


@dataclass(frozen=True, kw_only=True)
class Confidence(Rendering):
    """How likely the radiance is right, from a camera or in all directions."""

    view: str | None = None
    at: tuple[tuple[float, float, float], ...] = ()

    def work(self) -> dict[str, Any]:
        out, say = self.only_out, printer(self.json)
        if out.suffix.lower() not in SUFFIXES:
            raise BadValueError(f"--out must end in .exr or .png, got {out.name}")
        if self.at and self.view is not None:
            raise BadValueError("--view is one camera, --at all directions", "Leave one of them out.")
        if len(self.at) > 1:
            raise BadValueError(f"--confidence takes one place, got {len(self.at)}", "Give one --at.")
        run = open_run(self.source, self.data, self.rasteriser, self.device, say, pictures=False)
        if self.at:
            written = write_confidence_around(run, self.at[0], self.width or WIDTH, out)
        else:
            camera = camera_named(run.scene, self.view)
            written = write_confidence(run, camera.resized(self.width) if self.width else camera, out)
        say(f"wrote {' and '.join(map(str, written))}: {MEANING}")
        return {"out": [str(path) for path in written]}
