# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render``: one picture from a trained run, scene-linear EXR or LDR PNG; or those of all views."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from ...bridge.confidence import MEANING
from ...bridge.errors import BadValueError
from ...bridge.probe import WIDTH
from ..device import DeviceName
from ..evaluate.picture_folder import write_pictures
from ..evaluate.results import VIEWS_OF
from ..rasterize import Implementation
from ..runs.run import open_run
from ..runs.terminal import console
from ..scene import Camera, Scene
from ..scene.pictures import write_exr, write_png
from .confidence import write_confidence, write_confidence_around
from .lighting import levels_asked
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


@dataclass(frozen=True)
class Render:
    """Render a camera of the data set at any exposure and lighting level, or all that are evaluated."""

    #: Folder of the run.
    folder: tyro.conf.Positional[Path]
    #: The picture to write: .exr (scene-linear radiance) or .png (through the learned response); with --split
    #: a folder.
    out: Path
    #: Every view of a split at every exposure, and its radiance, as physhdr evaluate --pictures takes them.
    split: Literal["test", "val"] | None = None
    #: Which camera: SPLIT/POSE; default: the first test view.
    view: str | None = None
    #: Seconds; for .png only. Default: the middle exposure of the data set.
    exposure: float | None = None
    #: The first light, which is the ambient one wherever that has levels, relative to the standard views.
    lighting_level: float = 1.0
    #: Lights by name: NAME=VALUE …; those not named are at 1.
    lighting_levels: tuple[str, ...] = ()
    #: Width in pixels (the height follows); default: the data set's.
    width: int | None = None
    #: How likely the radiance is right, instead of the radiance: --out and its like as .exr (0 to 1) and .png
    #: (in colours, with a legend). docs/confidence.md
    confidence: bool = False
    #: With --confidence: in all directions from the place X Y Z, metres, as physhdr panorama draws the light
    #: there; --width is a power of two.
    at: tuple[float, float, float] | None = None
    #: The data set, where it has moved since training.
    data: Path | None = None
    rasteriser: Implementation = "auto"
    device: DeviceName = "auto"

    def run(self) -> int:
        if self.split is not None:
            return self._all_of(self.split)
        kind = self.out.suffix.lower()
        if kind not in (".exr", ".png"):
            raise BadValueError(f"--out must end in .exr or .png, got {self.out.name}")
        if not self.lighting_level >= 0.0:
            raise BadValueError(f"--lighting-level must be 0 or more, got {self.lighting_level}")
        if self.exposure is not None and not self.exposure > 0.0:
            raise BadValueError(f"--exposure must be above 0 seconds, got {self.exposure}")
        if self.confidence:
            defaults = {each.name: each.default for each in fields(self)}
            asked = ("exposure", "lighting_level", "lighting_levels", *(("view",) if self.at else ()))
            if given := [name for name in asked if getattr(self, name) != defaults[name]]:
                raise BadValueError(
                    f"--{given[0].replace('_', '-')} changes nothing about --confidence", "Leave it out."
                )
        elif self.at is not None:
            raise BadValueError(
                "--at is of --confidence", "The light of a place is drawn by physhdr panorama RUN --at X Y Z."
            )
        run = open_run(self.folder, self.data, self.rasteriser, self.device, pictures=False)
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
        if kind == ".exr":
            write_exr(self.out, _planes_last(run.method.hdr(camera, levels).cpu().numpy()))
        else:
            exposures = run.scene.train[0].exposures
            exposure = self.exposure or exposures[len(exposures) // 2]
            ldr = _planes_last(run.method.ldr(camera, exposure, levels).cpu().numpy())
            write_png(self.out, np.round(255.0 * ldr.clip(0.0, 1.0)).astype(np.uint8))
        console.print(f"wrote {self.out}")
        return 0

    def _all_of(self, split: str) -> int:
        alone = ("view", "exposure", "lighting_level", "lighting_levels", "width", "confidence", "at")
        defaults = {each.name: each.default for each in fields(self)}
        if given := [name for name in alone if getattr(self, name) != defaults[name]]:
            raise BadValueError(
                f"--{given[0].replace('_', '-')} is of one picture, --split of all", "Leave one of them out."
            )
        run = open_run(self.folder, self.data, self.rasteriser, self.device)
        if not run.scene.splits[split]:
            raise BadValueError(f"{run.scene.root} has no {VIEWS_OF[split]}", "Choose the other --split.")
        with progress("render", "view", as_json=False) as show:
            count = write_pictures(run.method, run.scene, self.out, split, show)
        console.print(f"wrote {count} pictures into {self.out}", soft_wrap=True)
        return 0


def _planes_last(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image.transpose(1, 2, 0))
