# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare`` for photos: turns a folder of photos into a data set for training."""

import dataclasses
import math
import statistics
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.progress import BarColumn, Progress, TextColumn

from ...bridge.data_set import CAPTURE_FORMAT
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError, OutputError
from ...bridge.limits import THREADS_MAX, whole
from ...bridge.regular import resolved
from ...bridge.signals import catch, interrupt
from ..runs.terminal import console
from ..scene.capture import raw
from ..scene.capture.brackets import Grouping
from ..scene.capture.choice import Choice, Quality, photos_to_match, quality
from ..scene.capture.data_set import Written, new_folder, write_data_set
from ..scene.capture.exposures import some_names
from ..scene.capture.gravity import rotation_to_z, up_direction
from ..scene.capture.light_folders import LightFolder, ignored_folders, light_folders
from ..scene.capture.noise import Noise, estimated
from ..scene.capture.photos import Photo, Skipped
from ..scene.capture.progress import Report, Stages
from ..scene.capture.structure import (
    CAPTURE_REMEDY,
    FEWEST_POSES,
    RegisteredPose,
    Structure,
    StructureError,
    existing,
    recover,
    require_pycolmap,
)
from ..scene.capture.understanding import Understanding, understand
from ..scene.lens import Lens, lenses_by_size
from ..shell import as_word
from .options import changed_options
from .output import write_json
from .preparing import Preparing

#: Noise is estimated from this many raw files per ISO if the files do not state it.
NOISE_PHOTOS = 6
LIGHT_REMEDY = (
    "Take them from places of the standard photos, looking the same way, and long enough exposed to show "
    "texture."
)


@dataclass(frozen=True, kw_only=True)
class PhotoOptions:
    """Photos."""

    #: Only report what the photos are, and write nothing.
    look: bool = False
    #: A folder of photos under other light, and the light that differs there: pendant=FOLDER:off. Also on (in
    #: this folder alone), a factor (0.25, 2x), or evening, dim, unknown and so on: a level to be found.
    #: Folders in or beside the photos' that are called "pendant off" are used without it; none: they are not.
    light: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="NAME=FOLDER:WORD"), tyro.conf.UseAppendAction
    ] = ()
    #: Exposures where EXIF has none: JSON or CSV, file name → seconds.
    exposures: Path | None = None
    #: All photos have the same exposure, whatever EXIF says.
    same_exposure: bool = False
    #: How photos are grouped into poses: names, <pose>_<k>; order of time, with a repeating pattern of
    #: exposures; none, each photo is a pose.
    group: Grouping = "auto"
    #: Photos per pose, if that is ambiguous.
    bracket: int | None = None
    #: The brackets were taken without a tripod: each photo has its own pose.
    handheld: bool = False
    #: Hand-held photos that cannot be placed (black or white) take the pose of the next in their bracket.
    borrow_poses: bool = False
    #: Exposure used to find the cameras: the best exposed, the same for all poses or each pose's own, or a
    #: step of the bracket, 0 being the darkest.
    match: Annotated[Choice, tyro.conf.arg(metavar="same|each|INT")] = "same"
    #: Model of the lens.
    camera: Literal[
        "OPENCV", "RADIAL", "SIMPLE_RADIAL", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV_FISHEYE", "RADIAL_FISHEYE"
    ] = "OPENCV"
    #: A folder with COLMAP's sparse/0 of these photos, used instead of finding the cameras.
    poses: Path | None = None
    #: Reserve about one in this many places, lying between others, for testing; 0: none.
    test_every: int = 8
    #: Maximum width in pixels; 0: no limit.
    max_width: int = 1600
    #: Continue even if less than half of the poses could be placed.
    partial: bool = False


@dataclass(frozen=True, kw_only=True)
class Photos(PhotoOptions, Preparing):
    """Make a data set from photos: exposures, cameras (COLMAP), undistorted pictures."""

    downscale: float | None = None
    overwrite: bool = False
    threads: int = -1
    json: bool = False

    def work(self) -> dict[str, Any]:
        reporter = JsonReporter() if self.json else TerminalReporter()
        lit = light_folders(self.source, self.light)
        self._check(lit)
        understood = understand(
            self.source,
            self.exposures,
            self.same_exposure,
            self.group,
            self.bracket,
            self.handheld,
            lambda done, of: reporter.progress(Report(0.0, f"reading headers: {done} of {of}")),
            lit,
        )
        self._say_folders(lit, reporter)
        for each in understood.lines:
            reporter.say(each)
        for each in understood.warnings:
            reporter.warn(each)
        if self.look:
            return understood.described()
        folder = self.folder
        if self.handheld and not understood.is_handheld:
            reporter.warn("--handheld has no effect: there are no brackets")
        if self.borrow_poses and not self.handheld:
            reporter.warn("--borrow-poses has no effect without --handheld")
        require_pycolmap()
        catch(interrupt)  # again, because pycolmap's glog treats SIGTERM as a crash
        with new_folder(folder, self.overwrite) as made, reporter:
            result = self._make(understood, made, reporter)
        reporter.say(
            f"next: physhdr inspect {as_word(folder)}, then physhdr train {as_word(folder)} --out RUN"
        )
        return {"folder": str(folder), **result}

    def _say_folders(self, lit: list[LightFolder], reporter: "Reporter") -> None:
        if named := [each for each in lit if each.is_named]:
            names = ", ".join(f"'{each.folder.name}'" for each in named)
            reporter.say(f"folders whose names say which light differs: {names}; --light none ignores them")
        if ignored := ignored_folders(self.source, lit):
            reporter.say(f"ignoring folders of photos whose names say no light: {some_names(ignored)}")

    @property
    def _smaller(self) -> float:
        return 1.0 if self.downscale is None else self.downscale

    def _check(self, lit: list[LightFolder]) -> None:
        """Raises ``BadValueError`` and ``OutputError`` for impossible options."""
        if not (math.isfinite(self._smaller) and self._smaller >= 1.0) or self.max_width < 0:
            raise BadValueError(
                f"invalid size: --downscale {self.downscale}, --max-width {self.max_width}",
                "Give a factor of 1 or more, and a width in pixels or 0.",
            )
        if self.test_every < 0 or self.test_every == 1:
            raise BadValueError(
                f"cannot reserve every {self.test_every}-th pose for testing",
                "Give 2 or more, or 0 for none.",
            )
        whole("--threads", self.threads, -1, THREADS_MAX)
        self._check_together()
        if self.look:
            return
        out = resolved(self.folder)
        for photos in map(resolved, (self.source, *(each.folder for each in lit))):
            if out == photos or out in photos.parents:
                raise OutputError(f"{self.folder} holds the photos", "Give another folder for the data set.")

    def _check_together(self) -> None:
        """Raises ``BadValueError`` for options that exclude each other."""
        if self.exposures is not None and self.same_exposure:
            raise BadValueError(
                "--exposures and --same-exposure contradict each other", "Leave one of them out."
            )
        if self.bracket is not None and self.group in ("none", "names"):
            raise BadValueError(
                f"--bracket {self.bracket} has no effect with --group {self.group}",
                "Leave one of them out.",
            )
        if self.poses is not None and (changed := changed_options(self, "match", "camera")):
            raise BadValueError(
                f"--{changed[0]} is for finding cameras, but --poses provides them", "Leave one of them out."
            )

    def _make(self, understood: Understanding, folder: Path, reporter: "Reporter") -> dict[str, Any]:
        """Fill ``folder``, whose parent also takes COLMAP's files; returns the result for programs."""
        expected = understood.seconds(self.max_width)
        if self.poses is not None:
            expected = {"looking": expected["looking"], "writing": expected["writing"]}
        stages = Stages(expected, reporter.progress)
        understood, qualities = _rated(understood, stages, reporter)
        brackets = understood.brackets
        self._groups_left_out(range(len(brackets.poses)), understood)
        structure, words = self._structure(understood, qualities, folder, stages, reporter)
        borrowed: dict[int, int] = {}
        if self.borrow_poses and understood.is_handheld:
            structure, borrowed = _borrowed(structure, understood)
        _require_enough(structure, understood, self.partial)
        dark = self._groups_left_out(structure.registered, understood)
        up = up_direction([pose.rotation for pose in structure.registered.values()])
        structure = structure.turned(rotation_to_z(up))
        lenses = self._lenses(structure)
        left_out = [pose.name for k, pose in enumerate(brackets.poses) if k not in structure.registered]
        origin = {
            "format": CAPTURE_FORMAT,
            "version": 1,
            "kind": understood.kind,
            **_encoding(understood),
            "exposures": understood.exposures.meaning,
            "brackets": brackets.how,
            "cameras": words,
            "lens": [f"{c.model_name} {c.params_to_string()}" for c in structure.cameras.values()],
            "up": "rotated so that +Z is up; scale and origin are those of structure from motion",
            "options": {
                key: _plain(value) for key, value in dataclasses.asdict(self).items() if key != "json"
            },
            "lights": understood.lights_in_words(dark),
            "left_out": left_out,
            "borrowed": {brackets.poses[k].name: brackets.poses[of].name for k, of in borrowed.items()},
            "skipped": {each.name: each.why for each in understood.skipped},
        }
        stages.begin("writing", "writing pictures")
        written = write_data_set(
            folder,
            brackets,
            structure,
            lenses,
            self.test_every,
            origin,
            lambda done, of: stages.at(done / of, f"writing pictures: {done} of {of}"),
            borrowed,
            understood.lights,
        )
        sizes = sorted({(lens.width, lens.height) for lens in lenses.values()}, reverse=True)
        self._report(understood, structure, written, sizes, reporter)
        if borrowed:
            names = [brackets.poses[k].name for k in borrowed]
            reporter.warn(
                f"{len(borrowed)} photos took the pose of the next in their bracket: {some_names(names)}"
            )
        for group in dark:
            reporter.warn(f"ignoring '{group}': none of its photos could be placed. {self._light_remedy}")
        if left_out:
            reporter.warn(f"ignoring photos that could not be placed: {some_names(left_out)}")
            if understood.is_handheld and not self.borrow_poses:
                reporter.say("--borrow-poses gives such photos the pose of the next in their bracket")
        return {
            "train": written.train,
            "test": written.test,
            "placed": len(structure.registered) - len(borrowed),
            "places": understood.places,
            "points": written.points,
            "reprojection_error": round(written.reprojection_error, 3),
            "lines": reporter.lines,
            "warnings": reporter.warnings,
        }

    def _groups_left_out(self, placed_poses: Iterable[int], understood: Understanding) -> list[str]:
        """The groups under other light of which no photo was placed; raises ``StructureError`` if all are."""
        poses = understood.brackets.poses
        groups = [group.name for group in understood.lights.groups] if understood.lights is not None else []
        placed = {poses[number].group for number in placed_poses}
        left_out = [group for group in groups if group not in placed]
        if groups and left_out == groups and not self.partial:
            raise StructureError(
                f"no photo under other light could be placed: {some_names(left_out)}",
                f"{self._light_remedy} --partial continues with the standard light alone.",
            )
        return left_out

    @property
    def _light_remedy(self) -> str:
        if self.poses is None:
            return LIGHT_REMEDY
        return f"The reconstruction in {self.poses} must have them, by their file names."

    def _lenses(self, structure: Structure) -> dict[int, Lens]:
        """A pinhole camera for each of the structure's, at the requested size."""
        widest = max(camera.width for camera in structure.cameras.values())
        limit = self.max_width / widest if self.max_width else 1.0
        scale = min(1.0 / self._smaller, limit, 1.0)
        lenses = lenses_by_size(structure.cameras, scale)
        # Undistorting a barrel makes pictures wider than the photos.
        widest = max(lens.width for lens in lenses.values())
        if 0 < self.max_width < widest:
            return lenses_by_size(structure.cameras, scale * self.max_width / widest)
        return lenses

    def _structure(
        self,
        understood: Understanding,
        qualities: dict[str, Quality],
        folder: Path,
        stages: Stages,
        reporter: "Reporter",
    ) -> tuple[Structure, str]:
        """The cameras, and a description of their origin."""
        poses = understood.brackets.poses
        if self.poses is not None:
            return existing(self.poses, poses), f"the reconstruction in {self.poses}"
        to_match, which = photos_to_match(poses, self.match, qualities)
        reporter.say(f"finding the cameras with {which}")
        work = folder.parent / "colmap"
        work.mkdir()
        stage_of = {"reading photos": "copying", "features": "features", "matching": "matching"}
        begun = ""

        def at(step: str, share: float) -> None:
            nonlocal begun
            stage = stage_of.get(step, "mapping")
            if stage != begun:
                begun = stage
                stages.begin(stage, f"COLMAP: {step}")
            stages.at(min(share, 0.999), f"COLMAP: {step}")

        structure = recover(to_match, work, self.camera, self.threads, at, understood.pairs())
        return structure, f"COLMAP, {which}"

    def _report(
        self,
        understood: Understanding,
        structure: Structure,
        written: Written,
        sizes: list[tuple[int, int]],
        reporter: "Reporter",
    ) -> None:
        brackets = understood.brackets
        of = " and ".join(f"{width}×{height}" for width, height in sizes)
        evs = ", ".join(f"{math.log2(seconds):+.1f}" for seconds in understood.steps())
        reporter.say(
            f"wrote {self.folder}: {written.train} poses for training, {written.test} for the "
            f"test; {written.pictures} pictures of {of}"
        )
        reporter.say(
            f"{len(structure.registered)} of {len(brackets.poses)} poses placed, {written.points} points, "
            f"reprojection error {written.reprojection_error:.2f} pixels; exposures EV {evs}"
        )
        for camera in structure.cameras.values():
            reporter.say(f"lens: {camera.model_name} {camera.params_to_string()}")
        understood.say_lights(structure.registered, reporter.say, reporter.warn)
        reporter.say("the world was rotated so that +Z is up; its scale is arbitrary, not metres")


# ---- the work ----------------------------------------------------------------------------------------


def _rated(
    understood: Understanding, stages: Stages, reporter: "Reporter"
) -> tuple[Understanding, dict[str, Quality]]:
    """How well each photo is exposed, by name; ignores photos that cannot be decoded, with a warning.

    Raises ``FileDamagedError`` for a mask that cannot be decoded, before COLMAP may take hours.
    """
    qualities: dict[str, Quality] = {}
    damaged: list[Skipped] = []
    hidden: list[str] = []
    photos = understood.brackets.photos
    stages.begin("looking", "looking at the photos")
    for done, photo in enumerate(photos):
        stages.at(done / len(photos), f"looking at the photos: {done} of {len(photos)}")
        try:
            qualities[photo.name] = quality(photo)
        except FileDamagedError as error:
            damaged.append(Skipped(photo.name, error.message.removeprefix(f"{photo.path} ")))
        else:
            keep = photo.keep()
            if keep is not None and not keep.any():
                hidden.append(photo.name)
    if hidden:
        reporter.warn(f"ignoring photos whose masks are entirely black: {some_names(hidden)}")
    if damaged:
        understood = understood.without(damaged)
        for each in damaged:
            reporter.warn(f"ignored: {each.name} {each.why}")
        if len(understood.standard.poses) < FEWEST_POSES:
            raise DataMismatchError(
                f"only {len(understood.standard.poses)} poses have undamaged photos; at least {FEWEST_POSES} "
                "are needed",
                CAPTURE_REMEDY,
            )
    return understood, qualities


def _borrowed(structure: Structure, understood: Understanding) -> tuple[Structure, dict[int, int]]:
    """Give hand-held photos that could not be placed the pose of the nearest step in their bracket.

    Also returns which photo took which one's pose.
    """
    place_of = understood.brackets.place_of
    registered, borrowed = dict(structure.registered), {}
    for number, place in enumerate(place_of):
        mates = [k for k in structure.registered if place_of[k] == place]
        if number in structure.registered or not mates:
            continue
        nearest = min(mates, key=lambda k, number=number: abs(k - number))
        pose = structure.registered[nearest]
        nothing = np.zeros((0, 2)), np.zeros(0, np.int64)
        registered[number] = RegisteredPose(pose.camera, pose.rotation, pose.translation, *nothing)
        borrowed[number] = nearest
    return dataclasses.replace(structure, registered=dict(sorted(registered.items()))), borrowed


def _require_enough(structure: Structure, understood: Understanding, partial: bool) -> None:
    brackets = understood.brackets
    standard = [k for k, pose in enumerate(brackets.poses) if not pose.group]
    placed, all_poses = sum(k in structure.registered for k in standard), len(standard)
    if placed < FEWEST_POSES or (2 * placed < all_poses and not partial):
        left_out = [brackets.poses[k].name for k in standard if k not in structure.registered]
        raise StructureError(
            f"only {placed} of {all_poses} poses could be placed; not {some_names(left_out)}",
            CAPTURE_REMEDY + " --partial continues with those that were placed.",
        )


def _encoding(understood: Understanding) -> dict[str, Any]:
    """The meaning of the pictures' codes, for readers of the data set (docs/formats.md)."""
    if not understood.is_raw:
        return {"encoding": "camera"}
    photos = understood.brackets.photos
    noise: dict[str, Any] = {}
    for iso in sorted({photo.iso for photo in photos}, key=lambda iso: iso or 0.0):
        found, words = _noise([photo for photo in photos if photo.iso == iso])
        if found is not None:
            noise[f"{iso:g}" if iso else "unknown"] = {**dataclasses.asdict(found), "from": words}
    return {
        "encoding": "linear",
        "clip": 1.0,
        "primaries": "Linear Rec.709",
        "white_balance": list(photos[0].white_balance or ()),
        "noise": {
            "meaning": "by ISO: variance = slope × signal + offset of one photosite, signal 0…1 from black "
            "to white level, before white balance",
            **noise,
        },
    }


def _noise(photos: list[Photo]) -> tuple[Noise | None, str]:
    """The noise of raw files of one ISO, and a description of its origin."""
    stated = [photo.noise for photo in photos if photo.noise is not None]
    if stated:
        slope, offset = (
            statistics.median(getattr(each, name) for each in stated) for name in ("slope", "offset")
        )
        return Noise(slope, offset), "the files' NoiseProfile"
    some = photos[:: max(1, len(photos) // NOISE_PHOTOS)][:NOISE_PHOTOS]
    found = estimated(plane for photo in some for plane in raw.photosites(photo.path))
    return found, f"flat areas of {len(some)} raw files"


def _plain(value: object) -> object:
    return str(value) if isinstance(value, Path) else value


# ---- output ------------------------------------------------------------------------------------------


class Reporter:
    """Reports to people or a program. Active (``with``) during the long work."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.warnings: list[str] = []

    def say(self, line: str) -> None:
        self.lines.append(line)

    def warn(self, line: str) -> None:
        self.warnings.append(line)

    def progress(self, report: Report) -> None:
        """Show the progress."""

    def __enter__(self) -> "Reporter":
        return self

    def __exit__(self, *_: object) -> None:
        pass


class JsonReporter(Reporter):
    """Writes JSON to stdout, one object per line, as ``addon/session/task.py`` reads it."""

    def progress(self, report: Report) -> None:
        left = {} if report.seconds_left is None else {"seconds_left": report.seconds_left}
        write_json(progress=report.fraction, message=report.message, **left)


class TerminalReporter(Reporter):
    """Shows a bar with the time left or, without a terminal, a line for each step."""

    def __init__(self) -> None:
        super().__init__()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=1.0, left="")
        self._last = ""

    def say(self, line: str) -> None:
        super().say(line)
        console.print(line)

    def warn(self, line: str) -> None:
        super().warn(line)
        console.print(f"warning: {line}", style="yellow")

    def progress(self, report: Report) -> None:
        left = "" if report.seconds_left is None else f"{report.seconds_left:.0f} s left"
        self._bar.update(self._task, completed=report.fraction, description=report.message, left=left)
        step = report.message.split(": ")
        if not console.is_terminal and step[0] == "COLMAP" and report.message != self._last:
            self._last = report.message
            console.print(report.message)

    def __enter__(self) -> Reporter:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
