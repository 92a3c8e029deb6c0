# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives a data set that ``physhdr prepare`` made of a rendered capture the true radiance of its test views.

    .venvs/backend/bin/python lab/tools/capture_truth.py DATA CAPTURE FOLDER
    .venvs/backend/bin/python lab/tools/capture_truth.py DATA CAPTURE FOLDER \\
        --relit pendant=0 pendant=4 pendant=0,daylight=4 --called daylight=ambient

DATA was prepared from FOLDER/photos, which ``take_photos.py`` took of CAPTURE. ``DATA/test_hdr`` then has
what ``physhdr evaluate`` compares the radiance with: the renders, bent back by the lens that was *found*, as
the test pictures beside them were, so that both show the same thing at each pixel. Scale and colour
balance of photographs are unknown: the figure to look at is the one whose scale is aligned.
``DATA/relit`` has the same views under other levels of the lights, by the names that DATA has for them.
"""

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from physhdr.bridge.data_set import CAPTURE_FILE, mixture_folder
from physhdr.bridge.errors import PhysHDRError
from physhdr.synth import exr, folder
from physhdr.synth.capture import Capture, opened
from physhdr.synth.errors import DamagedFileError
from physhdr.synth.photos import STANDARD

#: Samples of the render a pixel, in each direction: the mean over its area.
OVER = 3
#: A picture of a test place, as ``physhdr prepare`` names it.
NAMED = re.compile(r"test_(\d+)_\d\.png")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--relit", nargs="*", default=[], metavar="LIGHT=LEVEL,…")
    parser.add_argument(
        "--called", nargs="*", default=[], metavar="LIGHT=LIGHT", help="DATA's name=the capture's"
    )
    given = parser.parse_args()
    try:
        relit = [_levels(mixture) for mixture in given.relit]
        called = dict(pair.split("=", 1) for pair in given.called)
        for line in attach(given.data, opened(given.capture), given.folder, relit, called):
            print(line)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1
    return 0


def _levels(mixture: str) -> dict[str, float]:
    """Of ``pendant=0,daylight=4``."""
    return {light: float(level) for light, level in (word.split("=") for word in mixture.split(","))}


def attach(
    data: Path,
    capture: Capture,
    photos: Path,
    relit: Sequence[Mapping[str, float]] = (),
    called: Mapping[str, str] | None = None,
) -> list[str]:
    """Write the truth; what was written, a line each. Raises ``DamagedFileError``, ``OutputFolderError``.

    ``relit``: levels of each further picture of a test view, by the names that ``data`` has for the lights;
    ``called``: where these are others than the capture's.
    """
    record = folder.read_json(data / CAPTURE_FILE)
    taken = {photo["file"]: photo for photo in folder.read_json(photos / "truth" / "photos.json")["photos"]}
    of_capture = {light: light for light in capture.lights} | dict(called or {})
    in_data = {light: name for name, light in of_capture.items()}
    standard = next(photo["levels"] for photo in taken.values() if photo["folder"] == STANDARD)
    places = {place.name: place for place in capture.places}
    lens = _lens(record["lens"], capture)
    model = pycolmap.Reconstruction(str(data / "sparse" / "0"))
    pinholes = {image.name: model.cameras[image.camera_id] for image in model.images.values()}
    written = []
    for picture, camera in sorted(pinholes.items()):
        match = NAMED.fullmatch(picture)
        photo = taken[Path(record["sources"][picture]).name]
        if match is None or photo["folder"] != STANDARD:
            continue
        passes, name = capture.passes(places[photo["place"]]), f"hdr_{int(match[1]):03d}.exr"
        pictures = {"test_hdr": standard}
        for changed in relit:
            levels = {**standard, **{of_capture[light]: level for light, level in changed.items()}}
            pictures[mixture_folder({in_data[light]: level for light, level in levels.items()})] = levels
        for kind, levels in pictures.items():
            seen = _straightened(passes.radiance(levels), lens, camera)
            folder.write(data / kind / name, exr.encode_rgb(seen))
            written.append(f"{data / kind / name}: {photo['place']}")
    if not written:
        raise DamagedFileError(f"'{data}' has no test pictures: prepare it with --test-every 8")
    return written


def _lens(lenses: list[str], capture: Capture) -> Any:
    """The one lens of ``prepare.json``: its model and numbers."""
    if len(lenses) != 1:
        raise DamagedFileError(f"prepare.json names {len(lenses)} lenses; a capture has one")
    name, _, numbers = lenses[0].partition(" ")
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
