# SPDX-License-Identifier: GPL-3.0-or-later
"""The JSON files of a data set: poses, exposures, and dataset.json, which describes how it was made."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..bridge import data_set
from ..bridge.contents import lost_at_the_ends, stops_between
from ..bridge.lights import AMBIENT
from . import exr, folder, noise, passes, plan, settings
from .options import Options, evs
from .plan import Shot
from .progress import Report
from .response import Response
from .training_radiance import TrainingRadiance

DENOISER = "OpenImageDenoise"


def write_poses(
    out: Path, shots: list[Shot], options: Options, lights: Sequence[str], angle_x: float
) -> None:
    """transforms_*.json and exposure_*.json of each split."""
    varied = plan.varied_lights(options, lights)
    for split in data_set.SPLITS:
        chosen = [shot for shot in shots if shot.split == split]
        if not chosen:
            continue
        frames = []
        exposures = {}
        for shot in chosen:
            frame: dict[str, Any] = {
                "file_path": f"./{shot.stem}",
                "transform_matrix": shot.pose.tolist(),
            }
            if split == data_set.LIT:
                frame["lighting_level"] = shot.levels.get(AMBIENT, 1.0)
                frame["lighting_levels"] = {name: shot.levels[name] for name in varied}
            frames.append(frame)
            exposures.update({f"./{shot.bracket(k)}": t for k, t in enumerate(options.bracket)})
        transforms: dict[str, Any] = {"camera_angle_x": angle_x}
        if split == data_set.LIT:
            transforms["lights"] = varied
        for name, content in (
            (data_set.transforms_file(split), {**transforms, "frames": frames}),
            (data_set.exposure_file(split), exposures),
        ):
            if not (out / name).exists():
                folder.write_json(out / name, content)


def json_files(shots: list[Shot]) -> list[str]:
    """Names of what ``write_poses`` writes."""
    splits = dict.fromkeys(shot.split for shot in shots)
    names = (data_set.transforms_file, data_set.exposure_file)
    return [name(split) for split in splits for name in names]


def training_radiance(out: Path, shots: list[Shot], options: Options, response: Response) -> TrainingRadiance:
    """What the pixels of the training split come to."""
    chosen = [shot for shot in shots if shot.split == data_set.TRAIN]
    width, height = options.resolution
    found = TrainingRadiance(len(chosen) * width * height, options.bracket, response)
    for shot in chosen:
        found.add(exr.read(out / shot.hdr))
    return found


def judge_exposures(radiance: TrainingRadiance, report: Report) -> None:
    """Warn where many training pixels are white even at the shortest exposure, or black at the longest."""
    for lost, other in lost_at_the_ends(radiance.white, radiance.black):
        report.warn(f"{lost}: add {other} ones to --exposures")


def content(
    head: dict[str, Any],
    out: Path,
    shots: list[Shot],
    options: Options,
    response: Response,
    record: dict[str, Any],
    lights: Sequence[str],
    radiance: TrainingRadiance,
) -> dict[str, Any]:
    """The content of dataset.json, but for the noise floor, the objects and the source.

    ``head``: format, version, generator, options. ``record``: what was set for rendering. ``radiance``: of
    the training views.
    """
    counts = {split: sum(shot.split == split for shot in shots) for split in data_set.SPLITS}
    if not counts[data_set.VALIDATION]:  # the other three are always listed
        del counts[data_set.VALIDATION]
    low, high = radiance.percentile_1, radiance.maximum
    relit = next((shot.relit for shot in shots if shot.relit), ())
    return {
        "format": head["format"],
        "version": head["version"],
        "generator": head["generator"],
        "scene": options.scene,
        "seed": options.seed,
        "resolution": list(options.resolution),
        "samples": options.samples,
        **({} if options.test_samples is None else {"test_samples": options.test_samples}),
        "noise_threshold": options.noise_threshold,
        "denoised": DENOISER if options.denoise else False,
        "working_space": settings.WORKING_SPACE,
        "render_settings": record,
        "response": response.describe(),
        "camera_model": options.camera.describe(),
        "exposures": list(options.bracket),
        "evs": evs(options.bracket),
        "splits": counts,
        "lights": list(lights),
        "lit_lights": plan.varied_lights(options, lights) if counts[data_set.LIT] else [],
        "relit": [setting.describe() for setting in relit],
        "lighting_levels": {
            "lit": sorted({shot.levels.get(AMBIENT, 1.0) for shot in shots if shot.split == data_set.LIT}),
            "relit": [setting.levels[AMBIENT] for setting in relit if list(setting.levels) == [AMBIENT]],
            "relit_views": [shot.index for shot in shots if shot.relit],
        },
        "noise_estimate": noise.BY_DENOISER if options.denoise else noise.BY_LAPLACIAN,
        "frames": {f"{shot.split}/{shot.index}": _frame(out, shot, options, lights) for shot in shots},
        "dynamic_range": {"percentile_1": low, "maximum": high, "stops": stops_between(low, high)},
        "options": head["options"],
    }


def _frame(out: Path, shot: Shot, options: Options, lights: Sequence[str]) -> dict[str, Any]:
    name = shot.hdr if shot.stored else shot.passes
    entry = {"file": name, "sha256": hashlib.sha256((out / name).read_bytes()).hexdigest()}
    if shot.stored:
        return {**entry, "kept": True}
    return {**entry, **passes.read(out / name, lights, options.resolution).facts}
