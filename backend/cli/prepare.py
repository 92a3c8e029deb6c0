# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare``: from a folder of bracketed photos to a data set that can be trained on."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.progress import Progress

from ...bridge.errors import BadValueError, DataMismatchError, OutputError
from ..runs.terminal import console
from ..scene.capture.brackets import Brackets, Grouping, find_brackets, time_in_words
from ..scene.capture.choice import Choice, photos_to_match, thinned
from ..scene.capture.data_set import Written, new_folder, write_data_set
from ..scene.capture.exposures import Exposures, exposures_from_exif, exposures_from_file, some_names
from ..scene.capture.gravity import rotation_to_z, up_direction
from ..scene.capture.photos import Photo, find_photos
from ..scene.capture.structure import (
    CAPTURE_REMEDY,
    FEWEST_POSES,
    Structure,
    StructureError,
    existing,
    recover,
    require_pycolmap,
)
from ..scene.lens import make_lenses

#: Exposures at one step that differ more between poses are worth a word, in EV.
DRIFT_EV = 0.1
#: A wider spread than this between neighbouring steps leaves codes that no two exposures share, in EV.
WIDEST_STEP_EV = 4.0


@dataclass(frozen=True)
class Prepare:
    """Make a data set from bracketed photos: exposures, cameras (COLMAP), pictures without distortion."""

    #: Folder of the photos: JPEG, PNG or TIFF of 8 bits, several exposures from each place.
    photos: tyro.conf.Positional[Path]
    #: Folder of the data set to make.
    out: Path
    #: Exposures where EXIF has none: JSON or CSV, file name → seconds.
    exposures: Path | None = None
    #: How photos are grouped into poses: names <pose>_<k>; order of time, with a pattern of exposures that
    #: repeats; none, each photo is a pose.
    group: Grouping = "auto"
    #: Photos in each pose, where that is not plain.
    bracket: int | None = None
    #: Which exposure the cameras are found with: the best exposed, the same for all poses or each pose's own,
    #: or a step of the bracket, 0 the darkest.
    match: Annotated[Choice, tyro.conf.arg(metavar="same|each|INT")] = "same"
    #: Model of the lens.
    camera: Literal["OPENCV", "RADIAL", "SIMPLE_RADIAL", "PINHOLE", "SIMPLE_PINHOLE"] = "OPENCV"
    #: A folder with COLMAP's sparse/0 of these photos, used instead of finding the cameras.
    poses: Path | None = None
    #: Every n-th pose is kept for the test; 0: none.
    test_every: int = 8
    #: Make the pictures smaller by this factor.
    downscale: float = 1.0
    #: Make them no wider than this, pixels; 0: no limit.
    max_width: int = 1600
    #: Go on where less than half of the poses could be placed.
    partial: bool = False
    #: Replace a data set that this command made before.
    overwrite: bool = False
    #: Threads for COLMAP; default: all cores.
    threads: int = -1

    def run(self) -> int:
        self._check()
        photos = find_photos(self.photos)
        exposures = (
            exposures_from_file(self.exposures, photos) if self.exposures else exposures_from_exif(photos)
        )
        all_steps = find_brackets(photos, exposures.seconds, self.group, self.bracket)
        brackets, steps = thinned(all_steps)
        _show_photos(photos, all_steps, exposures)
        if len(steps) < all_steps.length:
            console.print(f"of the {all_steps.length} exposures steps {', '.join(map(str, steps))} are used")
        if len(brackets.poses) < FEWEST_POSES:
            raise DataMismatchError(
                f"{self.photos} holds {len(brackets.poses)} poses; {FEWEST_POSES} are the least",
                CAPTURE_REMEDY,
            )
        require_pycolmap()
        with new_folder(self.out, self.overwrite) as folder:
            structure, words = self._structure(brackets, folder)
            _require_enough(structure, brackets, self.partial)
            up = up_direction([pose.rotation for pose in structure.registered.values()])
            structure = structure.turned(rotation_to_z(up))
            lenses = make_lenses(structure.cameras, self._scale(photos[0].width))
            origin = {
                "format": "physhdr-capture",
                "version": 1,
                "exposures": exposures.meaning,
                "brackets": brackets.how,
                "cameras": words,
                "lens": [f"{c.model_name} {c.params_to_string()}" for c in structure.cameras.values()],
                "up": "turned so that +Z is up; scale and place are structure from motion's own",
                "options": {key: _plain(value) for key, value in dataclasses.asdict(self).items()},
                "left_out": [
                    pose.name for k, pose in enumerate(brackets.poses) if k not in structure.registered
                ],
            }
            with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
                task = bar.add_task("writing pictures", total=None)
                written = write_data_set(
                    folder,
                    brackets.poses,
                    structure,
                    lenses,
                    self.test_every,
                    origin,
                    lambda done, total: bar.update(task, completed=done, total=total),
                )
            size = next((lens.width, lens.height) for lens in lenses.values())
        self._report(structure, brackets, written, size)
        return 0

    def _check(self) -> None:
        if not (math.isfinite(self.downscale) and self.downscale >= 1.0) or self.max_width < 0:
            raise BadValueError(
                f"cannot make pictures smaller by {self.downscale} and no wider than {self.max_width}",
                "Give a factor of 1 or more, and a width in pixels or 0.",
            )
        if self.test_every < 0 or self.test_every == 1:
            raise BadValueError(
                f"every {self.test_every}-th pose cannot be kept for the test",
                "Give 2 or more, or 0 for none.",
            )
        photos, out = self.photos.resolve(), self.out.resolve()
        if out == photos or out in photos.parents:
            raise OutputError(f"{self.out} holds the photos", "Give another folder for the data set.")

    def _scale(self, width: int) -> float:
        limit = self.max_width / width if self.max_width else 1.0
        return min(1.0 / self.downscale, limit, 1.0)

    def _structure(self, brackets: Brackets, folder: Path) -> tuple[Structure, str]:
        """The cameras, and in words where they are from."""
        if self.poses is not None:
            return existing(self.poses, brackets.poses), f"the reconstruction in {self.poses}"
        to_match, which = photos_to_match(brackets.poses, self.match)
        console.print(f"the cameras are found with {which}", soft_wrap=True)
        with console.status("starting COLMAP") as status:
            work = folder.parent / "colmap"
            work.mkdir()

            def say(step: str) -> None:
                status.update(f"COLMAP: {step}")
                if not console.is_terminal:
                    console.print(f"COLMAP: {step}")

            return recover(to_match, work, self.camera, self.threads, say), f"COLMAP, {which}"

    def _report(
        self, structure: Structure, brackets: Brackets, written: Written, size: tuple[int, int]
    ) -> None:
        evs = ", ".join(f"{ev:+.1f}" for ev in brackets.evs)
        console.print(
            f"wrote {self.out}: {written.train} poses for training, {written.test} for the test; "
            f"{written.pictures} pictures of {size[0]}×{size[1]}",
            soft_wrap=True,
        )
        console.print(
            f"{len(structure.registered)} of {len(brackets.poses)} poses placed, {written.points} points, "
            f"reprojection error {written.reprojection_error:.2f} pixels; exposures EV {evs}",
            soft_wrap=True,
        )
        for camera in structure.cameras.values():
            console.print(f"lens: {camera.model_name} {camera.params_to_string()}", soft_wrap=True)
        console.print("the world is turned so that +Z is up; its scale is arbitrary, not metres")
        left_out = [pose.name for k, pose in enumerate(brackets.poses) if k not in structure.registered]
        if left_out:
            _warn(f"left out, for they could not be placed: {some_names(left_out)}")
        console.print(
            f"next: physhdr inspect {self.out}, then physhdr train {self.out} --out RUN", soft_wrap=True
        )


def _plain(value: object) -> object:
    return str(value) if isinstance(value, Path) else value


def _warn(text: str) -> None:
    console.print(f"[yellow]warning: {text}[/yellow]", soft_wrap=True)


def _show_photos(photos: list[Photo], brackets: Brackets, exposures: Exposures) -> None:
    """What was found, before the minutes that follow, with what is worth a warning."""
    times = ", ".join(time_in_words(2.0**ev) for ev in brackets.evs)
    console.print(
        f"{len(photos)} photos of {photos[0].width}×{photos[0].height}: {len(brackets.poses)} poses with "
        f"{brackets.length} each ({brackets.how}): {times} ({exposures.meaning})",
        soft_wrap=True,
    )
    if brackets.length == 1:
        _warn("there is one exposure only: what it clips, black or white, cannot be learned (no HDR)")
    elif (widest := float(np.diff(brackets.evs).max())) > WIDEST_STEP_EV:
        _warn(f"neighbouring exposures are {widest:.1f} EV apart; {WIDEST_STEP_EV:g} or less are better")
    if brackets.drift > DRIFT_EV:
        _warn(
            f"exposures of one step differ by up to {brackets.drift:.1f} EV between poses; each is used as "
            "it is, but manual exposure is better"
        )


def _require_enough(structure: Structure, brackets: Brackets, partial: bool) -> None:
    placed, all_poses = len(structure.registered), len(brackets.poses)
    if placed < FEWEST_POSES or (2 * placed < all_poses and not partial):
        left_out = [pose.name for k, pose in enumerate(brackets.poses) if k not in structure.registered]
        raise StructureError(
            f"only {placed} of {all_poses} poses could be placed; not {some_names(left_out)}",
            CAPTURE_REMEDY + " --partial goes on with those that were placed.",
        )
