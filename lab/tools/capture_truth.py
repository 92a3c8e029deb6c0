# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives a data set that ``physhdr prepare`` made of a rendered capture the true radiance of its test views.

    .venvs/backend/bin/python lab/tools/capture_truth.py DATA CAPTURE FOLDER

DATA was prepared from FOLDER/photos, which ``take_photos.py`` took of CAPTURE. ``DATA/test_hdr`` then has
what ``physhdr evaluate`` compares the radiance with: the renders, bent back by the lens that was *found*, as
the test pictures beside them were, so that both show the same thing at each pixel. Scale and colour
balance of photographs are unknown: the figure to look at is the one whose scale is aligned.
"""

import argparse
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from physhdr.bridge.data_set import CAPTURE_FILE
from physhdr.bridge.errors import PhysHDRError
from physhdr.synth import exr, folder
from physhdr.synth.capture import Capture, opened
from physhdr.synth.errors import DamagedFileError

#: Samples of the render a pixel, in each direction: the mean over its area.
OVER = 3
#: A picture of a test place, as ``physhdr prepare`` names it.
NAMED = re.compile(r"test_(\d+)_\d\.png")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    try:
        for line in attach(given.data, opened(given.capture), given.folder):
            print(line)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1
    return 0


def attach(data: Path, capture: Capture, photos: Path) -> list[str]:
    """Write the truth; what was written, a line each. Raises ``DamagedFileError``, ``OutputFolderError``."""
    told = folder.read_json(data / CAPTURE_FILE)
    place_of = {
        photo["file"]: photo["place"]
        for photo in folder.read_json(photos / "truth" / "photos.json")["photos"]
    }
    places = {place.name: place for place in capture.places}
    lens = _lens(told["lens"], capture)
    model = pycolmap.Reconstruction(str(data / "sparse" / "0"))
    pinholes = {image.name: model.cameras[image.camera_id] for image in model.images.values()}
    said = []
    for picture, camera in sorted(pinholes.items()):
        match = NAMED.fullmatch(picture)
        if match is None:
            continue
        photo = told["sources"][picture]
        radiance = capture.passes(places[place_of[photo]]).radiance({})
        seen = _straightened(radiance, lens, camera)
        path = data / "test_hdr" / f"hdr_{int(match[1]):03d}.exr"
        folder.write(path, exr.encode_rgb(seen))
        said.append(f"{path}: {place_of[photo]}")
    if not said:
        raise DamagedFileError(f"'{data}' has no test pictures: prepare it with --test-every 8")
    return said


def _lens(told: list[str], capture: Capture) -> Any:
    """The one lens of ``prepare.json``: its model and numbers."""
    if len(told) != 1:
        raise DamagedFileError(f"prepare.json tells of {len(told)} lenses; a capture has one")
    name, _, numbers = told[0].partition(" ")
    params = [float(number) for number in numbers.split(",")]
    size = {"width": capture.lens.width, "height": capture.lens.height}
    return pycolmap.Camera(model=name, params=params, **size)


def _straightened(radiance: np.ndarray, lens: Any, pinhole: Any) -> np.ndarray:
    """[H, W, 3] float32 of the pinhole's pixels: where ``lens`` shows them, the mean of bilinear samples."""
    columns = (np.arange(OVER * pinhole.width) + 0.5) / OVER
    total = np.empty((pinhole.height, pinhole.width, 3), np.float32)
    for y in range(pinhole.height):
        rows = y + (np.arange(OVER) + 0.5) / OVER
        u, v = np.meshgrid(columns, rows)
        rays = pinhole.cam_from_img(np.stack([u.ravel(), v.ravel()], -1))
        at = lens.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], -1))
        values = _bilinear(radiance, at).reshape(OVER, pinhole.width, OVER, 3)
        total[y] = values.mean((0, 2))
    return total


def _bilinear(picture: np.ndarray, at: np.ndarray) -> np.ndarray:
    """[N, 3] at places [N, 2] in pixels; the border's colour outside."""
    height, width = picture.shape[:2]
    x = np.clip(at[:, 0] - 0.5, 0.0, width - 1.0)
    y = np.clip(at[:, 1] - 0.5, 0.0, height - 1.0)
    left, top = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    a, b = (x - left)[:, None], (y - top)[:, None]
    upper = picture[top, left] * (1.0 - a) + picture[top, left + 1] * a
    lower = picture[top + 1, left] * (1.0 - a) + picture[top + 1, left + 1] * a
    return upper * (1.0 - b) + lower * b


if __name__ == "__main__":
    sys.exit(main())
