# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a data set (docs/formats.md): renders the poses that are missing and derives everything else."""

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..bridge import data_set
from ..bridge.lock import Claims
from . import (
    describe,
    device,
    floors,
    folder,
    objects,
    open_scene,
    passes,
    plan,
    png,
    points,
    reuse,
    rig,
    settings,
    stored_truth,
)
from .assets import Assets
from .built_in import SCENES, built
from .derive import Derivation
from .errors import NotFiniteRenderError
from .options import USERS_EVS, Options, seconds
from .passes import Passes
from .plan import Shot
from .progress import Report
from .renderer import Renderer, renderer, view_seed
from .response import by_name
from .stage import Stage
from .truth import TruthRenderer
from .workers import threads_each

GENERATOR = {"name": data_set.MAKER, "version": "0.2.0"}
FEW_POINTS = 100
#: Seconds between looks at what other processes are at work on.
WAIT = 1.0
#: The folder of what is claimed: one owner a picture, of those who fill the folder at the same time.
CLAIMS = ".claims"
#: Entries of dataset.json that are measured by rendering once more.
FLOORS = ("noise_floor", "reference_floor")
#: The claim on what is made once all poses are there.
FINISH = "finish"


def make(out: Path, options: Options, report: Report | None = None) -> dict[str, Any]:
    """Fill the folder ``out``; what is already there and whole is kept. Several processes may do it together.

    Returns:
        What a program that started us wants to know (``--progress-json``); of a part of the poses
        (``options.part``) only which one of which folder it is, and how long its pictures took.

    Raises:
        SynthError: any of its kinds, with a message for the user. Nothing that exists is overwritten.
    """
    report = report or Report()
    options.check()
    by_name(options.crf)  # before a scene is built for it
    began = time.monotonic()
    with device.chosen(options.device), _staged(options, report) as (stage, options, assets):
        if options.denoise:
            settings.check_denoiser(stage.scene)
        job = _job(out, stage, options, assets, report)
        if job.is_complete():
            (out / data_set.PARTIAL_FILE).unlink(missing_ok=True)  # of one killed between the two last steps
            info = folder.read_json(out / data_set.INFO_FILE)
            report.say(f"data set {out}: complete already, nothing to do")
            return _summary(out, info, report, began)
        users = bool(options.from_file)
        wanted = settings.ground_truth(
            options.resolution,
            options.samples,
            options.device,
            users,
            options.noise_threshold,
            threads=options.threads or (threads_each(options.workers) if options.workers > 1 else 0),
        )
        with (
            Claims(out / CLAIMS, report.say) as claims,
            settings.applied(stage.scene, wanted, None if users else settings.WORKING_SPACE) as record,
            objects.numbered(stage, report) as numbers,
            renderer(stage, options.denoise) as camera,
        ):
            took = _render(job, claims, camera, report)
            if options.part:
                report.say(f"data set {out}: part {options.part[0]} of {options.part[1]} is rendered")
                return {"folder": str(out.absolute()), "part": list(options.part), "picture_seconds": took}
            info = _finish(job, claims, camera, record, numbers, report)
    floor, stops = info["noise_floor"], info["dynamic_range"]["stops"]
    exposures = floor.get("exposures", info["exposures"])
    report.say(f"noise floor {floor['psnr']} dB at {exposures} s, HDR {floor['hdr_psnr']} dB")
    if reference := info.get("reference_floor"):
        dbs = f"{reference['psnr']} dB, HDR {reference['hdr_psnr']} dB"
        report.say(f"against {reference['samples']} samples without denoising {dbs}")
    report.say(f"dynamic range of the training views: {stops} stops")
    report.say(f"data set {out}: complete in {time.monotonic() - began:.0f} s")
    return _summary(out, info, report, began)


@dataclass(frozen=True)
class _Job:
    """A data set that is being made."""

    out: Path
    options: Options
    stage: Stage
    shots: list[Shot]
    derivation: Derivation
    #: The first entries of dataset.json.
    head: dict[str, Any]
    #: What an earlier run left in dataset.json or dataset.partial.json.
    state: dict[str, Any]
    assets: Assets
    stored: stored_truth.StoredTruth | None
    renders: reuse.Renders | None

    @property
    def lights(self) -> list[str]:
        return list(self.stage.lights)

    @property
    def ours(self) -> list[Shot]:
        """Those that are to be made: all, or every n-th, so that each part has some of every kind."""
        first, step = self.options.part or (1, 1)
        return self.shots[first - 1 :: step]

    @property
    def chunks(self) -> list[floors.Chunk]:
        """Of the reference, those that are to be made; none where its floor is known."""
        if self.floors.get("reference_floor"):
            return []
        first, step = self.options.part or (1, 1)
        return floors.chunks(self.out, self.options, floors.view(self.shots))[first - 1 :: step]

    @property
    def floors(self) -> dict[str, Any]:
        """Those that are known already."""
        known = self.stored.floors if self.stored else {}
        return known | {key: self.state[key] for key in FLOORS if self.state.get(key)}

    def passes(self, shot: Shot) -> Passes:
        if shot.stored:
            assert self.stored is not None
            return self.stored.passes(shot)
        return passes.read(self.out / shot.passes, self.lights, self.options.resolution)

    def missing(self, piece: "Shot | floors.Chunk") -> bool:
        if isinstance(piece, floors.Chunk):  # which are gone again once the data set is described
            return not piece.path.exists() and not (self.out / data_set.INFO_FILE).exists()
        return bool(self.derivation.missing(piece))

    def is_complete(self) -> bool:
        names = [data_set.POINTS_FILE, data_set.INFO_FILE, *describe.json_files(self.shots)]
        return all((self.out / name).exists() for name in names) and not any(
            self.derivation.missing(shot) for shot in self.shots
        )


def _job(out: Path, stage: Stage, options: Options, assets: Assets, report: Report) -> _Job:
    """Enter the folder and look at what is there already."""
    counts = options.views, options.lit_views, options.validation_views
    poses = stage.poses or rig.poses(options.camera_rig, stage.cameras, *counts)
    shots = plan.shots(poses, options, list(stage.lights))
    response = by_name(options.crf)
    asked = {**options.as_json(), "response": response.describe(), "lights": list(stage.lights)}
    if stage.fingerprint:
        asked |= {"scene": stage.scene.name, folder.FINGERPRINT: stage.fingerprint}
    if options.assets:
        asked["assets"] = assets.used
    stored = stored_truth.opened(Path(options.test_truth), asked) if options.test_truth else None
    if stored:
        shots = stored.shots(shots)
        asked["test_truth"] = stored.info["samples"]  # cleaner truth makes another data set
    maker = {**GENERATOR, "blender": bpy.app.version_string}
    state = folder.open_folder(out, asked, maker)
    head = {"format": data_set.FORMAT, "version": data_set.VERSION, "generator": maker, "options": asked}
    renders = reuse.opened(Path(options.renders_of), asked, maker) if options.renders_of else None
    derivation = Derivation(out, options, response)
    job = _Job(out, options, stage, shots, derivation, head, state, assets, stored, renders)
    there = [shot for shot in job.ours if shot.stored or (out / shot.passes).exists()]
    for shot in there:
        job.passes(shot)  # whole, and of this scene
        job.derivation.check(shot)
    report.say(f"data set {out}: {len(job.ours)} poses of '{options.scene}', {len(there)} already rendered")
    if not (out / data_set.INFO_FILE).exists():
        folder.write_json(out / data_set.PARTIAL_FILE, {**head, "noise_floor": None, **job.floors})
    describe.write_poses(out, shots, options, job.lights, stage.cameras.angle_x)
    return job


@contextmanager
def _staged(options: Options, report: Report) -> Iterator[tuple[Stage, Options, Assets]]:
    """A built-in scene or the user's own, and the options with what that scene decides filled in."""
    assets = Assets(Path(options.assets) if options.assets else None)
    if options.from_file:
        with open_scene.opened(options, report) as (stage, filled):
            yield stage, replace(_exposed(filled, USERS_EVS), scene=open_scene.name_of_file()), assets
    else:
        with built(options.scene, assets) as stage:
            yield stage, _exposed(options, SCENES[options.scene].evs), assets


def _exposed(options: Options, evs: tuple[float, ...]) -> Options:
    return options if options.exposures is not None else replace(options, exposures=seconds(evs))


def _render(job: _Job, claims: Claims, camera: Renderer, report: Report) -> list[float]:
    """Make every pose's files. What another process is at work on is waited for at the end.

    Returns the seconds that each of those took that this process made.
    """
    left = [piece for piece in (*job.ours, *job.chunks) if job.missing(piece)]
    took: list[float] = []
    if not left:
        return took
    report.begin(len(left))
    while left:
        piece = next((piece for piece in left if claims.take(piece.name)), None)
        if piece is None:
            time.sleep(WAIT)
        else:
            began = time.monotonic()
            try:
                report.start(piece.name)
                _make(job, piece, camera)
                took.append(round(time.monotonic() - began, 3))
            finally:
                claims.release(piece.name)
        still = [piece for piece in left if job.missing(piece)]
        for piece in left:
            if piece not in still:  # ours, and what other processes have done meanwhile
                report.advance(piece.name)
        left = still
    return took


def _make(job: _Job, shot: Shot | floors.Chunk, camera: Renderer) -> None:
    """Render a pose unless it has been and write what is missing of its files; or a part of the reference."""
    if isinstance(shot, floors.Chunk):
        shot.make(camera)
        return
    path = job.out / shot.passes
    if not shot.stored and not path.exists() and job.renders and job.renders.has(shot):
        job.renders.copy(shot, job.out)
    if shot.stored or path.exists():
        rendered = job.passes(shot)
    else:
        rendered = _rendered(job, shot, shot.name, camera, folder.scratch(path))
        passes.write(path, rendered)
    job.derivation.write(shot, rendered)


def _rendered(job: _Job, shot: Shot, name: str, camera: Renderer, scratch: Path) -> Passes:
    """Once more, with other noise, where a value is no number: one path in millions may meet such a spot.

    ``name``: by which the seed is drawn.
    """
    render = _careful(job, camera) if shot.split in data_set.HELD_OUT else camera.render
    try:
        return render(shot.pose, view_seed(job.options.seed, name), scratch)
    except NotFiniteRenderError:
        return render(shot.pose, view_seed(job.options.seed, f"{name}/finite"), scratch)


def _careful(job: _Job, camera: Renderer) -> Callable[[np.ndarray, int, Path], Passes]:
    """How truth is rendered."""
    samples = job.options.test_samples
    return camera.render if samples is None else TruthRenderer(camera, samples).render


def _finish(
    job: _Job,
    claims: Claims,
    camera: Renderer,
    record: dict[str, Any],
    numbers: dict[str, int],
    report: Report,
) -> dict[str, Any]:
    """Points, noise floor and dataset.json, by one of those who fill the folder; the latter's content."""
    while not claims.take(FINISH):
        time.sleep(WAIT)
    try:
        if "splits" not in job.state and job.is_complete():  # another process was faster
            return folder.read_json(job.out / data_set.INFO_FILE)
        report.finishing("points")
        if not (job.out / data_set.POINTS_FILE).exists():
            _write_points(job, report)
        report.finishing("measuring the noise")
        measured = _floors(job, camera)
        report.finishing("describing")
        radiance = describe.training_radiance(job.out, job.shots, job.options, job.derivation.response)
        describe.judge_exposures(radiance, report)
        content = describe.content(
            job.head,
            job.out,
            job.shots,
            job.options,
            job.derivation.response,
            record,
            job.lights,
            radiance,
        )
        content |= {**measured, "objects": numbers}
        if job.stored:
            content["test_samples"] = job.stored.info["samples"]
        if job.stage.source:
            content["source"] = {**job.stage.source, "warnings": report.warnings}
        else:
            content["assets"] = job.assets.used
        folder.write_json(job.out / data_set.INFO_FILE, content)
        (job.out / data_set.PARTIAL_FILE).unlink(missing_ok=True)
        if claims.keep_others_out:  # else another may still write what we have
            folder.remove_leftovers(job.out)
            shutil.rmtree(job.out / floors.CHUNKS, ignore_errors=True)
        return content
    finally:
        claims.release(FINISH)


@dataclass(frozen=True)
class _Pictures(Sequence[np.ndarray]):
    """[height, width, 3] uint8 each, read when it is asked for: all at once may be more than memory holds."""

    paths: list[Path]

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: Any) -> Any:
        return png.read(self.paths[index])


def _write_points(job: _Job, report: Report) -> None:
    train = [shot for shot in job.shots if shot.split == data_set.TRAIN]
    middle = len(job.options.bracket) // 2
    seen = _Pictures([job.out / shot.bracket(middle) for shot in train])
    cloud = points.cast(job.stage, [shot.pose for shot in train], seen, job.options.seed)
    folder.write(job.out / data_set.POINTS_FILE, points.encode(cloud))
    if len(cloud) < FEW_POINTS:
        report.warn(
            f"only {len(cloud)} points lie on surfaces that the cameras see: are they pointed at the scene?"
        )


def _floors(job: _Job, camera: Renderer) -> dict[str, Any]:
    """The middle test view again with another seed, and against the reference if there is one."""
    shot, measured, response = floors.view(job.shots), job.floors, job.derivation.response
    if "noise_floor" not in measured:
        scratch = folder.scratch(job.out / "noise_floor.exr")
        again = _rendered(job, shot, f"{shot.name}/again", camera, scratch)
        measured["noise_floor"] = floors.noise_floor(shot, job.passes(shot), again, response, job.options)
    parts = floors.chunks(job.out, job.options, shot)
    if parts and "reference_floor" not in measured:
        truth = job.passes(shot).radiance(shot.levels)
        measured["reference_floor"] = {
            "view": shot.index,
            "samples": sum(part.samples for part in parts),
            **floors.reference_floor(truth, floors.halves(parts), response, job.options.bracket),
        }
    return measured


def _summary(out: Path, content: dict[str, Any], report: Report, began: float) -> dict[str, Any]:
    keys = (
        *("scene", "resolution", "splits", "exposures", "lights", "lighting_levels"),
        *("dynamic_range", "noise_floor"),
    )
    return {
        "folder": str(out.absolute()),
        **{key: content.get(key) for key in keys},
        "warnings": report.warnings,
        "seconds": round(time.monotonic() - began, 1),
    }
