# SPDX-License-Identifier: GPL-3.0-or-later
"""A sheet and a table of kept truth, a scene a row: the middle test view, and what noise is left in it.

    .venvs/backend/bin/python tools/truth_sheet.py bear dog --work FOLDER --former FOLDER

The noise is the difference to a second render, times AMPLIFIED, at the exposure where it is worst: of the
truth (``--work``: the folder of tools/keep_truth.py, which has a second one) and of pictures as test views
were before (``--former``: a folder of data sets by scene, rendered with the samples of training views).
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from contact_sheet import assemble, caption, save, shrunk
from PIL import Image, ImageDraw, ImageFont

from physhdr.backend.scene.pictures import read_exr
from physhdr.bridge.errors import PhysHDRError
from physhdr.synth.png import quantise
from physhdr.synth.response import reinhard_gamma

DATA = Path(__file__).resolve().parent.parent / "lab" / "data"
AMPLIFIED = 16
EXPOSURES = (0, 2, 4)
HEADER = (
    "| scene | passes | CPU h | views | former truth, two renders | truth, two renders | its limit |",
    "|---|---|---:|---:|---|---|---|",
)
GAP, HEAD, PAPER, INK = 4, 22, (255, 255, 255), (24, 24, 28)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--former", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("docs/images/truth.jpg"))
    parser.add_argument("--cell", type=int, default=176, help="pixels of a picture's height")
    given = parser.parse_args()
    try:
        rows = [row(scene, given.work, given.former, given.cell) for scene in given.scenes]
        quality, size = save(given.out, assemble(rows))
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    print("\n".join([*HEADER, *(line(scene, given.former) for scene in given.scenes)]))
    print(f"wrote {given.out}: {len(rows)} scenes, quality {quality}, {size / 1000:.0f} kB")
    return 0


def line(scene: str, former: Path) -> str:
    """The scene's row of the table in lab/data/README.md."""
    told = json.loads((DATA / scene / "truth.json").read_text(encoding="utf-8"))
    before = json.loads((former / scene / "dataset.json").read_text(encoding="utf-8"))
    views = len(list((DATA / scene).glob("*.exr")))
    floors = [before["noise_floor"], told["noise_floor"], told.get("reference_floor")]
    cells = [scene, ", ".join(map(str, told["passes"])), f"{told['cpu_seconds'] / 3600:.2f}", str(views)]
    cells += [in_words(floor) for floor in floors]
    return "| " + " | ".join(cells) + " |"


def in_words(floor: dict[str, Any] | None) -> str:
    """dB at the exposures, then of the radiance."""
    if floor is None:
        return "–"
    return " / ".join(f"{value:.1f}" for value in floor["psnr"]) + f", {floor['hdr_psnr']:.1f}"


def row(scene: str, work: Path, former: Path, cell: int) -> Image.Image:
    """A strip with its title. Raises ``PhysHDRError`` where a picture is missing or damaged."""
    told = json.loads((DATA / scene / "truth.json").read_text(encoding="utf-8"))
    view, exposures, floor = told["noise_floor"]["view"], told["exposures"], told["noise_floor"]["psnr"]
    truth = read_exr(DATA / scene / f"test_{view:03d}.exr")
    again = read_exr(work / scene / "again.exr")
    before = read_exr(former / scene / "test_hdr" / f"hdr_{view:03d}.exr")
    worst = int(np.argmin(floor))
    cells = [(f"{exposures[k]:g} s", developed(truth, exposures[k])) for k in EXPOSURES]
    cells += [
        (f"former truth, noise x {AMPLIFIED}", difference(before, again, exposures[worst])),
        (f"truth, noise x {AMPLIFIED}", difference(truth, again, exposures[worst])),
    ]
    strip = [caption(shrunk(picture, cell), text) for text, picture in cells]
    made = Image.new("RGB", (sum(part.width for part in strip) + GAP * (len(strip) - 1), HEAD + cell), PAPER)
    title = f"{scene}: {told['samples']} samples a pixel, two renders agree to {min(floor):.1f} dB or better"
    ImageDraw.Draw(made).text((0, HEAD - 4), title, INK, ImageFont.load_default(14), anchor="ls")
    for k, part in enumerate(strip):
        made.paste(part, (k * (cell + GAP), HEAD))
    return made


def developed(radiance: np.ndarray, exposure: float) -> np.ndarray:
    return quantise(reinhard_gamma(np.maximum(radiance.astype(np.float64), 0.0) * exposure))


def difference(first: np.ndarray, second: np.ndarray, exposure: float) -> np.ndarray:
    """Of the pictures, amplified, about middle grey."""
    codes = [developed(each, exposure).astype(np.float64) / 255.0 for each in (first, second)]
    return quantise(np.clip(0.5 + AMPLIFIED * (codes[0] - codes[1]), 0.0, 1.0))


if __name__ == "__main__":
    sys.exit(main())
