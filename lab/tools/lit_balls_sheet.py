# SPDX-License-Identifier: GPL-3.0-or-later
"""The table and the picture of lab/tools/lit_balls.py: how right CG is that a capture lights.

    .venvs/backend/bin/python lab/tools/lit_balls_sheet.py BALLS --image docs/images/lit_balls.jpg

Of each ball at each level its pixels against the truth: PSNR after the μ-law of the project's HDR comparison
(M: the largest true value of the ball at that level), and of sRGB codes at ``EXPOSURE``. Nothing is aligned;
``--aligned`` scales each kind by one number, over both balls and all levels, and says by which.
"""

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np
import torch
from contact_sheet import assemble, caption, save
from PIL import Image

from physhdr.backend.evaluate.metrics import display, psnr, quantise
from physhdr.backend.scene.pictures import read_exr
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.lights import AMBIENT
from physhdr.bridge.srgb import to_srgb
from physhdr.synth import passes

BALLS = ("chrome", "grey")
LEVELS = (0.25, 1.0, 4.0)
NAMES = {
    "truth": "truth",
    "around": "captured around",
    "demo": "captured from one side",
    "panorama": "true panorama",
    "scaled": "scaled HDRI",
}
#: Seconds, by level: what a photographer would choose.
EXPOSURE = {0.25: 4.0, 1.0: 2.0, 4.0: 0.5}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("balls", type=Path)
    parser.add_argument("--image", type=Path, help="write a sheet of the pictures there")
    parser.add_argument("--cell", type=int, default=190)
    given = parser.parse_args()
    try:
        print("\n".join(table(given.balls)))
        if given.image:
            quality, size = save(given.image, assemble(rows(given.balls, given.cell)))
            print(f"wrote {given.image}: quality {quality}, {size / 1000:.0f} kB")
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1
    return 0


def kinds(root: Path) -> list[str]:
    """What is compared with the truth, those of the table's names first."""
    found = {each.name for each in root.iterdir() if (each / f"grey_{LEVELS[0]:g}.exr").exists()}
    return [name for name in NAMES if name in found] + sorted(found - set(NAMES))


def radiance(root: Path, kind: str, ball: str, level: float) -> np.ndarray:
    """[H, W, 3] float64."""
    if kind != "truth":
        return read_exr(root / kind / f"{ball}_{level:g}.exr").astype(np.float64)
    path = root / "truth" / f"{ball}.exr"
    about = json.loads((root / "balls.json").read_text(encoding="utf-8"))
    size = tuple(about["size"])
    return passes.read(path, about["lights"], size).radiance({AMBIENT: level}).astype(np.float64)


def ball_pixels(root: Path) -> np.ndarray:
    """[H, W] bool: where the ball covers all of a pixel."""
    about = json.loads((root / "balls.json").read_text(encoding="utf-8"))
    width, height = about["size"]
    # The ball stands in the middle of the picture: its outline by perspective, less two pixels.
    sine = about["radius"] / about["distance"]
    radius = math.tan(math.asin(sine)) / math.tan(about["angle"] / 2.0) * width / 2.0 - 2.0
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2.0, np.arange(height) + 0.5 - height / 2.0)
    return np.hypot(x, y) < radius


def decibels(shown: np.ndarray, truth: np.ndarray, level: float) -> tuple[float, float]:
    """PSNR of [N, 3] radiance: after the μ-law, and of sRGB codes at the level's exposure."""
    largest = float(truth.max())
    pair = [quantise(display(torch.from_numpy(each), largest)) for each in (shown, truth)]
    codes = [quantise(torch.from_numpy(coded(each, level))) for each in (shown, truth)]
    return psnr(*pair), psnr(*codes)


def coded(values: np.ndarray, level: float) -> np.ndarray:
    return to_srgb(np.clip(values * EXPOSURE[level], 0.0, 1.0))


def scale_of(root: Path, kind: str) -> float:
    """The median of truth over what is shown, of both balls at level 1."""
    inside = ball_pixels(root)
    pairs = [(radiance(root, "truth", b, 1.0)[inside], radiance(root, kind, b, 1.0)[inside]) for b in BALLS]
    return float(np.median(np.concatenate([(t / np.maximum(s, 1e-9)).ravel() for t, s in pairs])))


def table(root: Path) -> list[str]:
    """The lines of a table in Markdown: a row a ball and level, a column a kind."""
    shown, inside = kinds(root), ball_pixels(root)
    lines = ["| ball, level | " + " | ".join(NAMES.get(kind, kind) for kind in shown) + " |"]
    lines.append("|---" * (1 + len(shown)) + "|")
    for aligned in (False, True):
        for ball in BALLS:
            for level in LEVELS:
                truth = radiance(root, "truth", ball, level)[inside]
                cells = []
                for kind in shown:
                    values = radiance(root, kind, ball, level)[inside]
                    both = decibels(values * (scale_of(root, kind) if aligned else 1.0), truth, level)
                    cells.append(f"{both[0]:.1f} / {both[1]:.1f}")
                name = f"{ball}, {level:g}" + (", aligned" if aligned else "")
                lines.append(f"| {name} | " + " | ".join(cells) + " |")
    scales = [f"{NAMES.get(kind, kind)} {scale_of(root, kind):.3f}" for kind in shown]
    return [*lines, "scales that align: " + ", ".join(scales)]


def rows(root: Path, cell: int) -> list[Image.Image]:
    """A strip for each ball and level, the truth first."""
    strips = []
    inside = ball_pixels(root)[..., None]
    for ball in BALLS:
        for level in LEVELS:
            cells = []
            truth = radiance(root, "truth", ball, level)
            for kind in ("truth", *kinds(root)):
                values = radiance(root, kind, ball, level)
                text = f"{NAMES.get(kind, kind)}"
                if kind == "truth":
                    text = f"truth, level {level:g}"
                else:
                    values = np.where(inside, values, truth)
                    text += f" {decibels(values[inside[..., 0]], truth[inside[..., 0]], level)[0]:.1f} dB"
                picture = (coded(values, level) * 255.0 + 0.5).astype(np.uint8)
                scaled = Image.fromarray(picture).resize((cell, cell), Image.Resampling.LANCZOS)
                cells.append(caption(scaled, text))
            strip = Image.new("RGB", (sum(each.width for each in cells), cell))
            for k, each in enumerate(cells):
                strip.paste(each, (k * cell, 0))
            strips.append(strip)
    return strips


if __name__ == "__main__":
    sys.exit(main())
