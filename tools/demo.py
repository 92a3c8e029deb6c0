#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole loop: a scene from Cycles, training, evaluation, and the relit Gaussians back in Blender.

Every step is a command that a user can call; this only calls them in order, times them, and skips what is
done already. The result is runs/demo/result.png.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import torch

from physhdr.backend.cli.run_folder import Run, open_run
from physhdr.backend.evaluate.metrics import display, hdr_pair, psnr
from physhdr.backend.evaluate.sheets import as_picture, display_white, labelled_grid
from physhdr.backend.evaluate.truth import hdr_truth, relit_truth
from physhdr.backend.scene.pictures import read_exr, write_png
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.config import CONFIG_FILE, PRESETS, read_config
from physhdr.backend.train.trainer import CHECKPOINT_FILE
from physhdr.bridge.errors import PhysHDRError

ROOT = Path(__file__).resolve().parent.parent
BLENDER = ROOT / ".venvs" / "run-blender"
PHYSHDR = ROOT / ".venvs" / "backend" / "bin" / "physhdr"
#: Lighting levels of the Cycles renders.
LEVELS = (0.25, 1.0, 4.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=ROOT / "data" / "demo")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "demo")
    arguments = parser.parse_args()
    data, out = arguments.data, arguments.out
    relit = out / "blender"
    begun = time.perf_counter()

    step("1/6 render the data set with Cycles", [BLENDER, "synth/make_scene.py", "--", "--out", data])
    if is_trained(out):
        say("2/6 train: done already")
    elif (out / CHECKPOINT_FILE).exists():
        step("2/6 train, from where it stopped", [PHYSHDR, "train", "--resume", out])
    else:
        step("2/6 train", [PHYSHDR, "train", data, "--out", out])
    step("3/6 evaluate", [PHYSHDR, "evaluate", out])
    step("4/6 export", [PHYSHDR, "export", out])
    run = open_run(out)
    pose = relit_truth(data)[0].index
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


def is_trained(out: Path) -> bool:
    """Whether ``out`` holds a finished run of the preset as it is today."""
    try:
        config, _, preset = read_config(out / CONFIG_FILE)
        _, metadata = load_checkpoint(out / CHECKPOINT_FILE)
    except PhysHDRError:
        return False
    return config == PRESETS[preset] and int(metadata["iteration"]) == config.iterations


def list_position(data: Path, pose: int) -> int:
    """Where test pose ``pose`` stands in transforms_test.json."""
    frames = json.loads((data / "transforms_test.json").read_text(encoding="utf-8"))["frames"]
    return [frame["file_path"].rpartition("_")[2] for frame in frames].index(str(pose))


def write_result(run: Run, data: Path, pose: int, relit: Path, path: Path) -> str:
    """Truth, our LDR at three exposures, our HDR, relit views and the Cycles render, labelled.

    Returns a line that says how well the Cycles render agrees with our own.
    """
    view = run.scene.find("test", pose)
    method, rows = run.method, []
    for k in (0, 2, 4):
        truth = torch.from_numpy(view.image(k).copy()).permute(2, 0, 1) / 255.0
        ours = method.ldr(view.camera, view.exposures[k])
        label = f"{view.exposures[k]:g} s"
        rows.append([(f"truth, {label}", truth), (f"ours, {psnr(ours, truth):.1f} dB", ours)])
    truth = hdr_truth(data, "test", pose)
    white = display_white(truth)

    def shown(radiance: torch.Tensor) -> torch.Tensor:
        return display(radiance, white).float()

    ours = method.hdr(view.camera)
    pair = hdr_pair(ours, truth)
    hdr_row = [("true HDR, μ-law", shown(truth))]
    hdr_row.append((f"our HDR, {psnr(pair.prediction, pair.truth):.1f} dB", shown(ours)))
    relit_rows = []
    agreement = []
    truths = {item.level: item for item in relit_truth(data) if item.index == pose}
    for level in LEVELS:
        ours = method.hdr(view.camera, level)
        cycles = torch.from_numpy(read_exr(relit / f"level_{level:g}.exr")).permute(2, 0, 1)
        pair = hdr_pair(cycles, ours)
        agreement.append(psnr(pair.prediction, pair.truth))
        true = truths[level].radiance() if level in truths else truth
        match = hdr_pair(ours, true)
        relit_rows.append(
            [
                (f"truth, ambient × {level:g}", shown(true)),
                (f"ours relit, {psnr(match.prediction, match.truth):.1f} dB", shown(ours)),
                ("the point cloud in Cycles", shown(cycles)),
            ]
        )
    grid = [
        [cell for row in rows for cell in row],
        [*hdr_row, *relit_rows[0], relit_rows[1][2]],
        [*relit_rows[1][1:2], *relit_rows[2]],
    ]
    title = f"PhysHDR: {run.scene.name}, test view {pose}, {run.iteration} iterations"
    picture = labelled_grid([[(text, as_picture(image)) for text, image in row] for row in grid], title)
    write_png(path, picture)
    values = ", ".join(
        f"{value:.1f} dB at × {level:g}" for level, value in zip(LEVELS, agreement, strict=True)
    )
    return f"the Cycles render of the point cloud against our own render (μ-law PSNR): {values}"


if __name__ == "__main__":
    sys.exit(main())
