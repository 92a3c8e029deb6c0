# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render``: pictures of a trained run, scene-linear EXR or LDR PNG: one, a sequence, all views."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
import tyro

from ...bridge.confidence import MEANING
from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.lights import as_levels
from ...bridge.limits import EXPOSURE, THREADS_MAX, whole
from ...bridge.probe import WIDTH
from ...bridge.shots import Shots
from ..device import DeviceName
from ..evaluate.camera_file import read_camera_file
from ..evaluate.camera_path import camera_of, levels_of
from ..evaluate.picture_folder import write_pictures
from ..evaluate.results import VIEWS_OF
from ..rasterize import Implementation
from ..runs.files import writable_folder
from ..runs.run import Run, open_run
from ..runs.terminal import console
from ..scene import Camera, Scene, nerfstudio
from .confidence import on_gaussians_and_sure, write_confidence, write_confidence_around
from .given import given_of
from .layers import Sure
from .lighting import levels_asked
from .sequence import (
    Frame,
    Opened,
    begin,
    draw,
    draw_all,
    draw_at_once,
    model_digest,
    numbered,
    plan_file,
    require_model,
    threads_each,
)
from .told import progress


def camera_named(scene: Scene, name: str | None) -> Camera:
    """The camera of ``test/3``, ``train/0`` or ``lit/2``; None: the first test view, or training view.

    Raises ``BadValueError`` naming what there is.
    """
    if name is None:
        return (scene.test or scene.train)[0].camera
    split, slash, index = name.partition("/")
    index = index.removeprefix("r_")
    if not slash or not index.isdigit():
        raise BadValueError(
            f"--view must be like test/3, got '{name}'", "SPLIT/POSE, split train, test or lit."
        )
    return scene.find(split, int(index)).camera


def shots_in(scene: Scene, file: Path, prim: str | None, space: Path | None, fewest: int = 1) -> Shots:
    """The frames of a file of cameras in the scene's world; arguments and errors as ``read_camera_file``."""
    poses = scene.root / nerfstudio.LOOKS_FOR if scene.layout == nerfstudio.NAME else None
    return read_camera_file(file, camera_named(scene, None), prim, space, fewest, poses)


@dataclass(frozen=True)
class Render:
    """Render a camera of the data set at any exposure and lighting level, or all that are evaluated.

    Or numbered frames along a path of cameras (--camera), with layers for compositing (--layers).
    """

    #: Folder of the run.
    folder: tyro.conf.Positional[Path]
    #: The picture to write: .exr (scene-linear radiance) or .png (through the learned response); with --split
    #: a folder; with --camera one for each frame: frames/name_####.exr.
    out: Path
    #: Every view of a split at every exposure, and its radiance, as physhdr evaluate --pictures takes them.
    split: Literal["test", "val"] | None = None
    #: Which camera: SPLIT/POSE; default: the first test view.
    view: str | None = None
    #: A file of cameras instead: Blender's panel's, a path of nerfstudio's viewer (JSON), or a USD camera.
    camera: Path | None = None
    #: Which of a USD file's cameras, by its path or name; it may have one alone.
    camera_prim: str | None = None
    #: dataparser_transforms.json of the nerfstudio training whose viewer made the path: its world is another.
    camera_space: Path | None = None
    #: Seconds; for .png only. Default: the middle exposure of the data set.
    exposure: float | None = None
    #: The first light, which is the ambient one wherever that has levels, relative to the standard views.
    lighting_level: float = 1.0
    #: Lights by name: NAME=VALUE …; those not named are at 1.
    lighting_levels: tuple[str, ...] = ()
    #: Width in pixels (the height follows); default: the data set's, or that of the file of cameras.
    width: int | None = None
    #: One .exr of all that can be told: radiance with alpha, depth, what each light causes, confidence.
    #: docs/formats.md
    layers: bool = False
    #: How likely the radiance is right, instead of the radiance: --out and its like as .exr (0 to 1) and .png
    #: (in colours, with a legend). docs/light.md
    confidence: bool = False
    #: With --confidence: in all directions from the place X Y Z, metres, as physhdr panorama draws the light
    #: there; --width is a power of two.
    at: tuple[float, float, float] | None = None
    #: Processes that draw the frames of --camera, each with a part of the threads and memory of its own.
    workers: int = 1
    #: Draw all frames of --camera anew; else those that are there already are kept.
    overwrite: bool = False
    #: The data set, where it has moved since training.
    data: Path | None = None
    rasteriser: Implementation = "auto"
    device: DeviceName = "auto"

    def run(self) -> int:
        if self.split is not None:
            return self._all_of(self.split)
        self._check()
        if self.camera is not None:
            return self._along(self.camera)
        run = self._opened()
        levels = levels_asked(self.lighting_level, self.lighting_levels, run.method.lights)
        camera = camera_named(run.scene, self.view)
        if self.width is not None and self.at is None:
            camera = camera.resized(self.width)
        if self.confidence:
            if self.at is None:
                written = write_confidence(run, camera, self.out)
            else:
                written = write_confidence_around(run, self.at, self.width or WIDTH, self.out)
            console.print(f"wrote {' and '.join(map(str, written))}: {MEANING}", soft_wrap=True)
            return 0
        exposure = self.exposure or run.scene.middle_exposure
        frame = Frame(self.out, camera, exposure, levels, self.layers)
        draw(run, frame, self._sure(run))
        console.print(f"wrote {self.out}")
        return 0

    def _check(self) -> None:
        """Raises ``BadValueError`` where options mean nothing together."""
        kind = self.out.suffix.lower()
        if kind not in (".exr", ".png"):
            raise BadValueError(f"--out must end in .exr or .png, got {self.out.name}")
        if not self.lighting_level >= 0.0:
            raise BadValueError(f"--lighting-level must be 0 or more, got {self.lighting_level}")
        if self.exposure is not None:
            EXPOSURE.check(self.exposure, "--exposure")
        whole("--workers", self.workers, 1, THREADS_MAX)
        if self.confidence:
            asked = ("exposure", "lighting_level", "lighting_levels", *(("view",) if self.at else ()))
            if given := given_of(self, *asked, "camera", "layers"):
                raise BadValueError(f"--{given[0]} changes nothing about --confidence", "Leave it out.")
        elif self.at is not None:
            raise BadValueError(
                "--at only works with --confidence",
                "The light of a place is drawn by physhdr panorama RUN --at X Y Z.",
            )
        if self.layers and (kind != ".exr" or self.exposure is not None):
            raise BadValueError(
                "--layers are of radiance: one .exr, which has no exposure",
                "Let --out end in .exr, and leave --exposure out.",
            )
        if kind == ".exr" and not self.confidence and self.exposure is not None:
            raise BadValueError(
                f"--exposure changes nothing about {self.out.name}, which is radiance",
                "Leave it out, or let --out end in .png.",
            )
        if self.camera is None and (
            given := given_of(self, "camera_prim", "camera_space", "workers", "overwrite")
        ):
            raise BadValueError(
                f"--{given[0]} only works with --camera FILE", "Leave it out, or give a file."
            )
        if self.camera is not None and self.view is not None:
            raise BadValueError("--view is one camera, --camera a file of them", "Leave one of them out.")

    def _opened(self) -> Run:
        return open_run(self.folder, self.data, self.rasteriser, self.device, pictures=False)

    def _sure(self, run: Run) -> Sure | None:
        """The confidence for --layers; None without, and, which is told, where no picture tells it."""
        if not self.layers:
            return None
        try:
            return Sure(*on_gaussians_and_sure(run))
        except FileMissingError as error:
            console.print(f"without the layer Confidence: {error.message}", soft_wrap=True)
            return None

    def _along(self, file: Path) -> int:
        """The frames of a file of cameras."""
        model = model_digest(self.folder)
        run = self._opened()
        require_model(self.folder, model)
        shots = shots_in(run.scene, file, self.camera_prim, self.camera_space)
        frames = self._frames(run, shots)
        if len(frames) == 1 and "#" not in self.out.name:
            draw(run, frames[0], self._sure(run))
            console.print(f"wrote {self.out}")
            return 0
        writable_folder(self.out.parent)
        plan = plan_file(self.out)
        left = begin(frames, plan, model, self.layers and run.seen() is not None, self.overwrite)
        sure = self._sure(run) if left else None
        workers = min(self.workers, len(left))
        with progress("render", "frame", as_json=False) as show:
            if workers > 1:
                opened = Opened(self.folder, self.data, self.rasteriser, self.device, model)
                threads = threads_each(workers, torch.get_num_threads())
                draw_at_once(opened, left, workers, threads, sure, show)
            else:
                draw_all(run, left, sure, show)
        kept = f"; {len(frames) - len(left)} were there already" if len(left) < len(frames) else ""
        console.print(f"wrote {len(left)} of {len(frames)} frames, {self.out}{kept}", soft_wrap=True)
        return 0

    def _frames(self, run: Run, shots: Shots) -> list[Frame]:
        """What each frame shows, by the file and the options."""
        lights = run.method.lights
        levels = levels_asked(self.lighting_level, self.lighting_levels, lights)
        if any(shot.levels for shot in shots.frames):
            if given := given_of(self, "lighting_level", "lighting_levels"):
                raise BadValueError(f"--{given[0]}: the file of cameras has levels", "Leave it out.")
            lit = [levels_of(shot, lights) for shot in shots.frames]
        else:
            lit = [levels] * len(shots.frames)
        exposure = self.exposure or run.scene.middle_exposure
        paths = numbered(self.out, len(shots.frames))
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

    def _all_of(self, split: str) -> int:
        alone = ("view", "exposure", "lighting_level", "lighting_levels", "width", "confidence", "at")
        alone += ("camera", "camera_prim", "camera_space", "layers", "workers", "overwrite")
        if given := given_of(self, *alone):
            raise BadValueError(f"--{given[0]} is of one picture, --split of all", "Leave one of them out.")
        run = open_run(self.folder, self.data, self.rasteriser, self.device)
        if not run.scene.splits[split]:
            raise BadValueError(f"{run.scene.root} has no {VIEWS_OF[split]}", "Choose the other --split.")
        with progress("render", "view", as_json=False) as show:
            count = write_pictures(run.method, run.scene, self.out, split, show)
        console.print(f"wrote {count} pictures into {self.out}", soft_wrap=True)
        return 0
