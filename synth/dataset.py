# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a data set (docs/formats.md): renders what is missing, brackets, points, and the JSON files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import device, exr, folder, noise, open_scene, points, rig, settings
from .errors import ConflictError, DamagedFileError
from .options import Options
from .png import decode, encode, quantise
from .progress import Report
from .renderer import Renderer, view_seed
from .response import Response, by_name
from .scenes import built
from .scenes.stage import Stage

GENERATOR = {"name": "physhdr synth", "version": "0.1.2"}
DENOISER = "OpenImageDenoise"
FEW_POINTS = 100
LOST = 0.05
"""Share of pixels without a usable exposure from which on the user is told."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


@dataclass(frozen=True, eq=False)
class Picture:
    """One EXR to be rendered, and the split whose brackets are made from it ('' for relit truth)."""

    split: str
    index: int
    pose: np.ndarray
    level: float

    @property
    def name(self) -> str:
        """Path of the EXR under the data set's folder."""
        where = f"{self.split}_hdr" if self.split else f"relit/level_{self.level:g}"
        return f"{where}/hdr_{self.index:03d}.exr"

    def bracket(self, k: int) -> str:
        """Path of the PNG of exposure ``k``, as exposure_*.json names it, without './'."""
        return f"{self.split}/r_{self.index}_{k}.png"


def make(out: Path, options: Options, report: Report | None = None) -> None:
    """Fill the folder ``out``; what is already there and whole is kept.

    Raises:
        SynthError: any of its kinds, with a message for the user. Nothing that exists is overwritten.
    """
    report = report or Report()
    options.check()
    response = by_name(options.crf)
    began = time.monotonic()
    with device.chosen(options.device), _staged(options, report) as (stage, options):
        if options.denoise:
            settings.check_denoiser(stage.scene)
        asked = {**options.as_json(), "response": response.describe()}
        if stage.fingerprint:
            asked |= {"scene": stage.scene.name, folder.FINGERPRINT: stage.fingerprint}
        state = folder.open_folder(out, asked)
        poses = stage.poses or rig.poses(options.camera_rig, stage.cameras, options.views, options.lit_views)
        pictures = plan(poses, options)
        missing = [picture for picture in pictures if not (out / picture.name).exists()]
        _check_existing(out, [picture for picture in pictures if picture not in missing], options)
        kept = len(pictures) - len(missing)
        report.say(f"data set {out}: {len(pictures)} pictures of '{options.scene}', {kept} already there")
        if (out / folder.FINAL).exists() and not missing and _is_complete(out, pictures, options):
            report.say(f"data set {out}: complete already, nothing to do")
            report.end(_summary(out, state, report, began))
            return
        maker = {**GENERATOR, "blender": bpy.app.version_string}
        if state and state.get("generator") != maker:
            raise ConflictError(
                f"'{out}' was begun by {_told(state.get('generator'))}, this is {_told(maker)}",
                "go on with that one, or choose another folder (--out; nothing was changed)",
            )
        head = {"format": folder.FORMAT, "version": folder.VERSION, "generator": maker, "options": asked}
        if not (out / folder.FINAL).exists():
            folder.write_json(out / folder.PARTIAL, {**head, "noise_floor": state.get("noise_floor")})
        _write_poses(out, pictures, options, stage.cameras.angle_x)
        users = bool(options.from_file)
        wanted = settings.ground_truth(
            options.resolution, options.samples, options.denoise, options.device, users
        )
        with settings.applied(stage.scene, wanted, None if users else settings.WORKING_SPACE) as record:
            renderer = Renderer(stage)
            _render(out, missing, renderer, options, report)
            report.finishing("exposures and points")
            _write_brackets(out, pictures, response, options)
            if not (out / "points3d.ply").exists():
                _write_points(out, pictures, stage, options, report)
            report.finishing("measuring the noise")
            floor = state.get("noise_floor") or _noise_floor(out, pictures, renderer, response, options)
        content = _describe(head, out, pictures, options, response, record, floor)
        if stage.source:
            content["source"] = {**stage.source, "warnings": report.warnings}
    _judge_exposures(out, pictures, response, options, report)
    folder.write_json(out / folder.FINAL, content)
    (out / folder.PARTIAL).unlink(missing_ok=True)
    stops = content["dynamic_range"]["stops"]
    report.say(f"noise floor {floor['psnr']} dB at {list(options.exposures)} s, HDR {floor['hdr_psnr']} dB")
    report.say(f"dynamic range of the training views: {stops} stops")
    report.say(f"data set {out}: complete in {time.monotonic() - began:.0f} s")
    report.end(_summary(out, content, report, began))


@contextmanager
def _staged(options: Options, report: Report) -> Iterator[tuple[Stage, Options]]:
    """A built-in scene or the user's own, and the options with what that scene decides filled in."""
    if options.from_file:
        with open_scene.opened(options, report) as (stage, filled):
            yield stage, replace(filled, scene=open_scene.name_of_file())
    else:
        with built(options.scene) as stage:
            yield stage, options


def _summary(out: Path, content: dict[str, Any], report: Report, began: float) -> dict[str, Any]:
    """What a program that started us wants to know (``--progress-json``)."""
    keys = ("scene", "resolution", "splits", "exposures", "lighting_levels", "dynamic_range", "noise_floor")
    return {
        "folder": str(out.absolute()),
        **{key: content.get(key) for key in keys},
        "warnings": report.warnings,
        "seconds": round(time.monotonic() - began, 1),
    }


def plan(poses: rig.RigPoses, options: Options) -> list[Picture]:
    """All EXRs of the data set, in the order they are rendered."""
    train = [Picture("train", k, pose, 1.0) for k, pose in enumerate(poses.train)]
    test = [Picture("test", k, pose, 1.0) for k, pose in enumerate(poses.test)]
    levels = options.lit_levels
    lit = [
        Picture("lit", k, pose, levels[k * len(levels) // len(poses.lit)]) for k, pose in enumerate(poses.lit)
    ]
    relit = [
        Picture("", k, poses.test[k], level)
        for level in options.ambient_levels
        for k in rig.spread_indices(len(test), options.relit_views)
    ]
    return [*train, *test, *lit, *relit]


def _told(maker: Any) -> str:
    return (
        ", ".join(f"{value}" for value in maker.values()) if isinstance(maker, dict) else "an unknown version"
    )


def _is_complete(out: Path, pictures: list[Picture], options: Options) -> bool:
    """Whether everything beside the EXRs is there."""
    splits = {picture.split for picture in pictures if picture.split}
    names = [
        "points3d.ply",
        *(f"{kind}_{split}.json" for split in splits for kind in ("transforms", "exposure")),
    ]
    names += [p.bracket(k) for p in pictures if p.split for k in range(len(options.exposures))]
    return all((out / name).exists() for name in names)


def _check_existing(out: Path, pictures: list[Picture], options: Options) -> None:
    width, height = options.resolution
    for picture in pictures:
        shape = exr.read(out / picture.name).shape
        if shape != (height, width, 3):
            raise DamagedFileError(
                f"'{out / picture.name}' is {shape[1]} × {shape[0]}, not {width} × {height}: "
                "delete it and run again"
            )


def _render(out: Path, missing: list[Picture], renderer: Renderer, options: Options, report: Report) -> None:
    if not missing:
        return
    report.begin(len(missing))
    order = {picture.level: at for at, picture in reversed(list(enumerate(missing)))}
    for picture in sorted(missing, key=lambda picture: order[picture.level]):  # a new level costs a new sync
        report.start(picture.name)
        renderer.render(
            out / picture.name, picture.pose, picture.level, view_seed(options.seed, picture.name)
        )
        report.advance(picture.name)


def _write_brackets(out: Path, pictures: list[Picture], response: Response, options: Options) -> None:
    """Every bracket is made from the EXR as it is on disk, so that both agree to the last bit."""
    for picture in pictures:
        if not picture.split:
            continue
        absent = [k for k in range(len(options.exposures)) if not (out / picture.bracket(k)).exists()]
        if absent:
            radiance = exr.read(out / picture.name).astype(np.float64)
            for k in absent:
                folder.write(
                    out / picture.bracket(k), encode(quantise(response(radiance * options.exposures[k])))
                )


def _write_points(out: Path, pictures: list[Picture], stage: Stage, options: Options, report: Report) -> None:
    train = [picture for picture in pictures if picture.split == "train"]
    middle = len(options.exposures) // 2
    seen = [decode((out / picture.bracket(middle)).read_bytes()) for picture in train]
    cloud = points.cast(stage, [picture.pose for picture in train], seen, options.seed)
    folder.write(out / "points3d.ply", points.encode(cloud))
    report.say(f"points3d.ply: {len(cloud)} points")
    if len(cloud) < FEW_POINTS:
        report.warn(
            f"only {len(cloud)} points lie on surfaces that the cameras see: are they pointed at the scene?"
        )


def _noise_floor(
    out: Path, pictures: list[Picture], renderer: Renderer, response: Response, options: Options
) -> dict[str, Any]:
    """Render the middle test view again with another seed and compare."""
    tests = [picture for picture in pictures if picture.split == "test"]
    picture = tests[len(tests) // 2]
    seeds = [view_seed(options.seed, picture.name), view_seed(options.seed, f"{picture.name}/again")]
    again = out / ".noise_floor.exr"
    second = renderer.render(again, picture.pose, picture.level, seeds[1])
    again.unlink()
    first = exr.read(out / picture.name)
    return {"view": picture.index, "seeds": seeds, **noise.floor(first, second, response, options.exposures)}


def _write_poses(out: Path, pictures: list[Picture], options: Options, angle_x: float) -> None:
    """transforms_*.json and exposure_*.json of each split."""
    for split in ("train", "test", "lit"):
        chosen = [picture for picture in pictures if picture.split == split]
        if not chosen:
            continue
        frames = []
        exposures = {}
        for picture in chosen:
            stem = f"./{split}/r_{picture.index}"
            frame: dict[str, Any] = {"file_path": stem, "transform_matrix": picture.pose.tolist()}
            if split == "lit":
                frame["lighting_level"] = picture.level
            frames.append(frame)
            exposures.update({f"{stem}_{k}.png": t for k, t in enumerate(options.exposures)})
        for name, content in (
            (f"transforms_{split}.json", {"camera_angle_x": angle_x, "frames": frames}),
            (f"exposure_{split}.json", exposures),
        ):
            if not (out / name).exists():
                folder.write_json(out / name, content)


def _judge_exposures(
    out: Path, pictures: list[Picture], response: Response, options: Options, report: Report
) -> None:
    """Warn where many training pixels are white even at the shortest exposure, or black at the longest."""
    radiance = np.stack([exr.read(out / picture.name) for picture in pictures if picture.split == "train"])
    brightest = radiance.max(-1).astype(np.float64)
    white = float((quantise(response(brightest * options.exposures[0])) == 255).mean())
    black = float((quantise(response(brightest * options.exposures[-1])) == 0).mean())
    for share, what, which, other in (
        (white, "white", "shortest", "shorter"),
        (black, "black", "longest", "longer"),
    ):
        if share > LOST:
            report.warn(
                f"{share:.0%} of the training pixels are {what} even at the {which} exposure: "
                f"add {other} ones to --exposures"
            )


def _describe(
    head: dict[str, Any],
    out: Path,
    pictures: list[Picture],
    options: Options,
    response: Response,
    record: dict[str, Any],
    floor: dict[str, Any],
) -> dict[str, Any]:
    """The content of dataset.json."""
    counts = {
        split: sum(picture.split == split for picture in pictures) for split in ("train", "test", "lit")
    }
    radiance = [exr.read(out / picture.name) for picture in pictures if picture.split == "train"]
    luminance = np.stack(radiance).astype(np.float64) @ LUMINANCE
    low, high = float(np.percentile(luminance, 1)), float(luminance.max())
    stops = round(float(np.log2(high / low)), 2) if low > 0 else None
    return {
        "format": head["format"],
        "version": head["version"],
        "generator": head["generator"],
        "scene": options.scene,
        "seed": options.seed,
        "resolution": list(options.resolution),
        "samples": options.samples,
        "denoised": DENOISER if options.denoise else False,
        "working_space": settings.WORKING_SPACE,
        "render_settings": record,
        "response": response.describe(),
        "exposures": list(options.exposures),
        "splits": counts,
        "lighting_levels": {
            "lit": sorted({picture.level for picture in pictures if picture.split == "lit"}),
            "relit": list(options.ambient_levels) if options.relit_views else [],
            "relit_views": sorted({picture.index for picture in pictures if not picture.split}),
        },
        "noise_floor": floor,
        "dynamic_range": {"percentile_1": low, "maximum": high, "stops": stops},
        "options": head["options"],
    }
