#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole loop: a scene from Cycles, training, evaluation, and the relit Gaussians back in Blender.

Every step is a command that a user can call; this only calls them in order, times them, and skips what is
done already. The result is runs/demo/result.png.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import torch

from physhdr.backend.evaluate.metrics import display, hdr_pair, psnr
from physhdr.backend.evaluate.sheets import as_picture, display_white, labelled_grid
from physhdr.backend.evaluate.truth import hdr_truth, relit_truth
from physhdr.backend.runs.run import Run, open_run
from physhdr.backend.scene.pictures import read_exr, write_png
from physhdr.backend.train.checkpoint import load_checkpoint, require_configuration
from physhdr.backend.train.config import CONFIG_FILE, read_config
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.run_folder import CHECKPOINT_FILE

ROOT = Path(__file__).resolve().parent.parent
BLENDER = ROOT / ".venvs" / "run-blender"
PHYSHDR = ROOT / ".venvs" / "backend" / "bin" / "physhdr"
#: Lighting levels of the Cycles renders: as captured, and beyond those that the data have for training.
LEVELS = (0.125, 1.0, 8.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=ROOT / "data" / "demo")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "demo")
    arguments = parser.parse_args()
    data, out = arguments.data, arguments.out
    relit = out / "blender"
    begun = time.perf_counter()

    workers = min(8, os.cpu_count() or 1)  # pictures as small as these keep one core busy each
    if (data / "dataset.json").is_file():
        say("1/6 render the data set: done already")
    else:
        step(
            "1/6 render the data set with Cycles",
            [BLENDER, "synth/make_scene.py", "--", "--out", data, "--workers", workers],
        )
    iteration = trained_iterations(out)
    if iteration == PRESETS["default"].iterations:
        say("2/6 train: done already")
    elif iteration:
        step("2/6 train, from where it stopped", [PHYSHDR, "train", "--resume", out])
    else:
        step("2/6 train", [PHYSHDR, "train", data, "--out", out, "--overwrite"])
    step("3/6 evaluate", [PHYSHDR, "evaluate", out])
    step("4/6 export", [PHYSHDR, "export", out])
    run = open_run(out)
    poses = sorted({item.index for item in relit_truth(data)})
    pose = poses[len(poses) // 2]
    camera = f"{data / 'transforms_test.json'}:{list_position(data, pose)}"
    step(
        "5/6 the Gaussians back in Blender, rendered with Cycles at three lighting levels",
        [BLENDER, "addon/scripts/relight.py", "--", out / "model.safetensors", "--camera", camera]
        + ["--resolution", str(run.scene.test[0].camera.width), "--out", relit]
        + ["--levels", *(f"{level:g}" for level in LEVELS), "--blend", out / "relit.blend"],
    )
    say("6/6 the result picture")
    note = write_result(run, data, pose, relit, out / "result.png")

    table = (out / "evaluation.md").read_text(encoding="utf-8")
    sys.stdout.write(f"\n{table}\n{note}\n\n")
    for name in (
        "result.png",
        "comparison.png",
        "evaluation.json",
        "model.safetensors",
        "baked.ply",
        "relit.blend",
    ):
        sys.stdout.write(f"{out / name}\n")
    say(f"demo finished in {time.perf_counter() - begun:.0f} s")
    return 0


def say(text: str) -> None:
    sys.stdout.write(f"[demo] {text}\n")
    sys.stdout.flush()


def step(title: str, command: list) -> None:
    """Run one command, its output shown, and print how long it took; its failure is ours."""
    say(title)
    begun = time.perf_counter()
    status = subprocess.call([str(part) for part in command], cwd=ROOT)
    if status:
        say(f"failed: {' '.join(str(part) for part in command)}")
        sys.exit(status)
    say(f"    took {time.perf_counter() - begun:.0f} s")


def trained_iterations(out: Path) -> int:
    """How far ``out`` is with the preset as it is today; 0 where it holds no such run."""
    try:
        written = read_config(out / CONFIG_FILE)
        _, metadata = load_checkpoint(out / CHECKPOINT_FILE)
        require_configuration(metadata, written.fingerprint, out / CHECKPOINT_FILE)
    except PhysHDRError:
        return 0
    is_todays = (written.config, written.preset) == (PRESETS["default"], "default")
    return int(metadata["iteration"]) if is_todays else 0


def list_position(data: Path, pose: int) -> int:
    """Where test pose ``pose`` stands in transforms_test.json."""
    frames = json.loads((data / "transforms_test.json").read_text(encoding="utf-8"))["frames"]
    return [frame["file_path"].rpartition("_")[2] for frame in frames].index(str(pose))


def write_result(run: Run, data: Path, pose: int, relit: Path, path: Path) -> str:
    """Truth, our LDR at three exposures, our HDR, relit views and the Cycles render, labelled.

    Returns a line that says how well the Cycles render agrees with our own.
    """
    view, method = run.scene.find("test", pose), run.method
    truths = {item.level: item.radiance() for item in relit_truth(data) if item.index == pose}
    truths[1.0] = hdr_truth(data, "test", pose)
    ours = {level: method.hdr(view.camera, level) for level in LEVELS}
    cycles = {level: read_cycles(relit / f"level_{level:g}.exr") for level in LEVELS}

    exposures = []
    for k in (0, 2, 4):
        truth = torch.from_numpy(view.values(k)).permute(2, 0, 1).float()
        picture = method.ldr(view.camera, view.exposures[k])
        label = f"{view.exposures[k]:g} s"
        exposures += [(f"truth, {label}", truth), (f"ours, {psnr(picture, truth):.1f} dB", picture)]

    white = display_white(truths[1.0])
    hdr = [("true HDR, μ-law", display(truths[1.0], white).float())]
    hdr.append((f"our HDR, {decibels(ours[1.0], truths[1.0])}", display(ours[1.0], white).float()))
    exposure = view.exposures[len(view.exposures) // 2]

    def developed(radiance: torch.Tensor) -> torch.Tensor:
        return method.tone_mapper.tone_map(radiance * exposure, None)[0].detach()

    rows = [exposures]
    for level in sorted({level for level in LEVELS if level in truths and level != 1.0}):
        rows.append(
            [
                (f"truth, ambient × {level:g}", developed(truths[level])),
                (f"ours relit, {decibels(ours[level], truths[level])}", developed(ours[level])),
                ("its point cloud in Cycles", developed(cycles[level])),
                (f"not relighting: truth × {level:g}", developed(level * truths[1.0])),
            ]
        )
    rows[1] += hdr
    rows[-1] += [("ours, ambient × 1", developed(ours[1.0])), ("the same in Cycles", developed(cycles[1.0]))]
    title = f"PhysHDR: {run.scene.name}, test view {pose}, {run.iteration} iterations"
    note = f"relit pictures: {exposure:g} s through the learned response; dB: μ-law PSNR of the HDR pictures"
    grid = [[(text, as_picture(image)) for text, image in row] for row in rows]
    write_png(path, labelled_grid(grid, title, note))
    agreement = ", ".join(f"{decibels(cycles[level], ours[level])} at × {level:g}" for level in LEVELS)
    return f"the Cycles render of the point cloud against our own render (μ-law PSNR): {agreement}"


def read_cycles(path: Path) -> torch.Tensor:
    """A render of relight.py as ``[3, H, W]``."""
    return torch.from_numpy(read_exr(path)).permute(2, 0, 1).contiguous()


def decibels(radiance: torch.Tensor, truth: torch.Tensor) -> str:
    """μ-law PSNR by the paper's protocol, in words."""
    pair = hdr_pair(radiance, truth)
    return f"{psnr(pair.prediction, pair.truth):.1f} dB"


if __name__ == "__main__":
    sys.exit(main())
