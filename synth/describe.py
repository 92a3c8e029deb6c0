# SPDX-License-Identifier: GPL-3.0-or-later
"""The JSON files of a data set: poses, exposures, and dataset.json, which tells how all was made."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import exr, folder, noise, passes, plan, settings
from .options import Options, evs
from .plan import Shot
from .png import quantise
from .progress import Report
from .response import Response
from .stage import AMBIENT

DENOISER = "OpenImageDenoise"
LOST = 0.05
"""Share of pixels without a usable exposure from which on the user is told."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


def write_poses(
    out: Path, shots: list[Shot], options: Options, lights: Sequence[str], angle_x: float
) -> None:
    """transforms_*.json and exposure_*.json of each split."""
    varied = plan.varied_lights(options, lights)
    for split in plan.SPLITS:
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
            if split == "lit":
                frame["lighting_level"] = shot.levels.get(AMBIENT, 1.0)
                frame["lighting_levels"] = {name: shot.levels[name] for name in varied}
            frames.append(frame)
            exposures.update({f"./{shot.bracket(k)}": t for k, t in enumerate(options.exposures)})
        transforms: dict[str, Any] = {"camera_angle_x": angle_x}
        if split == "lit":
            transforms["lights"] = varied
        for name, content in (
            (f"transforms_{split}.json", {**transforms, "frames": frames}),
            (f"exposure_{split}.json", exposures),
        ):
            if not (out / name).exists():
                folder.write_json(out / name, content)


def json_files(shots: list[Shot]) -> list[str]:
    """Names of what ``write_poses`` writes."""
    splits = dict.fromkeys(shot.split for shot in shots)
    return [f"{kind}_{split}.json" for split in splits for kind in ("transforms", "exposure")]


def training_radiance(out: Path, shots: list[Shot]) -> np.ndarray:
    """[views, height, width, 3] of the training split."""
    return np.stack([exr.read(out / shot.hdr) for shot in shots if shot.split == "train"])


def judge_exposures(radiance: np.ndarray, response: Response, options: Options, report: Report) -> None:
    """Warn where many training pixels are white even at the shortest exposure, or black at the longest."""
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


def content(
    head: dict[str, Any],
    out: Path,
    shots: list[Shot],
    options: Options,
    response: Response,
    record: dict[str, Any],
    lights: Sequence[str],
    radiance: np.ndarray,
) -> dict[str, Any]:
    """The content of dataset.json, but for the noise floor, the objects and the source.

    ``head``: format, version, generator, options. ``record``: what was set for rendering. ``radiance``: that
    of the training views.
    """
    counts = {split: sum(shot.split == split for shot in shots) for split in plan.SPLITS}
    luminance = radiance.astype(np.float64) @ LUMINANCE
    low, high = float(np.percentile(luminance, 1)), float(luminance.max())
    stops = round(float(np.log2(high / low)), 2) if low > 0 else None
    relit = next((shot.relit for shot in shots if shot.relit), ())
    return {
        "format": head["format"],
        "version": head["version"],
        "generator": head["generator"],
        "scene": options.scene,
        "seed": options.seed,
        "resolution": list(options.resolution),
        "samples": options.samples,
        "noise_threshold": options.noise_threshold,
        "denoised": DENOISER if options.denoise else False,
        "working_space": settings.WORKING_SPACE,
        "render_settings": record,
        "response": response.describe(),
        "camera_model": options.camera.describe(),
        "exposures": list(options.exposures),
        "evs": evs(options.exposures),
        "splits": counts,
        "lights": list(lights),
        "lit_lights": plan.varied_lights(options, lights) if counts["lit"] else [],
        "relit": [setting.describe() for setting in relit],
        "lighting_levels": {
            "lit": sorted({shot.levels.get(AMBIENT, 1.0) for shot in shots if shot.split == "lit"}),
            "relit": [setting.levels[AMBIENT] for setting in relit if list(setting.levels) == [AMBIENT]],
            "relit_views": [shot.index for shot in shots if shot.relit],
        },
        "noise_estimate": noise.BY_DENOISER if options.denoise else noise.BY_LAPLACIAN,
        "frames": {f"{shot.split}/{shot.index}": _frame(out, shot, options, lights) for shot in shots},
        "dynamic_range": {"percentile_1": low, "maximum": high, "stops": stops},
        "options": head["options"],
    }


def _frame(out: Path, shot: Shot, options: Options, lights: Sequence[str]) -> dict[str, Any]:
    path = out / shot.passes
    facts = passes.read(path, lights, options.resolution).facts
    return {"file": shot.passes, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), **facts}
