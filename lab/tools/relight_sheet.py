# SPDX-License-Identifier: GPL-3.0-or-later
"""The light switch in one picture: a test view as photographed and with each light off, truth above ours.

.venvs/backend/bin/python lab/tools/relight_sheet.py FOLDER/bear/places_8/run --out docs/images/switched.jpg

RUN is one of relight_photos.py. All pictures have one exposure and sRGB's curve.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from contact_sheet import GAP, assemble, caption, save, shrunk
from PIL import Image

from physhdr.backend.evaluate.metrics import scale_ratio
from physhdr.backend.evaluate.truth import hdr_truth, relit_truth
from physhdr.backend.runs.run import open_run
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.srgb import to_srgb

#: The share of the true picture under the standard light that white is above.
WHITE = 0.95


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--view", type=int, help="number of the test pose (default: the first relit one)")
    parser.add_argument("--out", type=Path, required=True, help="the JPEG to write")
    parser.add_argument("--cell", type=int, default=200, help="pixels of a picture's height")
    given = parser.parse_args()
    try:
        rows = pictures(given.run, given.view)
        strips = [strip(row, given.cell) for row in rows]
        quality, size = save(given.out, assemble(strips))
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    print(f"wrote {given.out}: quality {quality}, {size / 1000:.0f} kB")
    return 0


@torch.no_grad()
def pictures(folder: Path, pose: int | None) -> list[dict[str, np.ndarray]]:
    """Two rows, truth and ours, of ``[H, W, 3]`` uint8 by what they show."""
    run = open_run(folder)
    scene, renderer = run.scene, run.method
    relit = [item for item in relit_truth(scene.root) if list(item.levels.values()) == [0.0]]
    pose = relit[0].index if pose is None else pose
    view, standard = scene.find("test", pose), hdr_truth(scene.root, "test", pose)
    usual = renderer.hdr(view.camera)
    scale = scale_ratio(usual, standard)
    truth, ours = {"as photographed": standard}, {"as photographed": usual / scale}
    for item in relit:
        if item.index == pose:
            (light,) = item.levels
            levels = item.levels_of(renderer.lights, renderer.standard_levels)
            truth[f"{light} off"] = item.radiance()
            ours[f"{light} off"] = renderer.hdr(view.camera, levels) / scale
    white = float(torch.quantile(standard.double().flatten(), WHITE))
    rows = []
    for name, row in (("truth", truth), ("ours", ours)):
        rows.append({f"{name}, {light}": developed(radiance, white) for light, radiance in row.items()})
    return rows


def developed(radiance: torch.Tensor, white: float) -> np.ndarray:
    codes = to_srgb((radiance.double() / white).clamp(0.0, 1.0).permute(1, 2, 0).numpy())
    return np.round(255.0 * codes).astype(np.uint8)


def strip(row: dict[str, np.ndarray], height: int) -> Image.Image:
    cells = [caption(shrunk(picture, height), text) for text, picture in row.items()]
    made = Image.new("RGB", (sum(cell.width + GAP for cell in cells) - GAP, height), (255, 255, 255))
    for number, cell in enumerate(cells):
        made.paste(cell, (number * (cell.width + GAP), 0))
    return made


if __name__ == "__main__":
    sys.exit(main())
