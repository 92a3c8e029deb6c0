# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of docs/photos.md: one view taken by the ideal camera, then with each fault of a real one.

.venvs/backend/bin/python lab/tools/camera_sheet.py data/demo --out docs/images/camera.jpg
"""

import argparse
import sys
from pathlib import Path

from contact_sheet import GAP, assemble, caption, save, shrunk
from PIL import Image

from physhdr.backend.inspect import inspect
from physhdr.backend.scene.pictures import read_exr
from physhdr.bridge.errors import PhysHDRError
from physhdr.synth.camera_model import CameraModel
from physhdr.synth.response import by_name

ROWS = (
    {
        "ideal": CameraModel(),
        "iso 3200": CameraModel(iso=3200.0),
        "iso 51200": CameraModel(iso=51200.0),
        "vignetting 3": CameraModel(vignetting=3.0),
    },
    {
        "white balance jitter 0.4": CameraModel(white_balance_jitter=0.4),
        "the same, another view": CameraModel(white_balance_jitter=0.4),
        "local response 0.4": CameraModel(local_response=0.4),
        "local response 0.8": CameraModel(local_response=0.8),
    },
)
CELL = 230


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="a data set")
    parser.add_argument("--view", type=int, default=8, help="number of the test pose")
    parser.add_argument("--out", type=Path, default=Path("docs/images/camera.jpg"), help="the JPEG to write")
    given = parser.parse_args()
    try:
        found = inspect(given.folder)
        radiance = read_exr(given.folder / "test_hdr" / f"hdr_{given.view:03d}.exr").astype(float)
        seconds, response = found.exposures[len(found.exposures) // 2].seconds, by_name(found.response)
        rows = []
        for cameras in ROWS:
            strip = []
            for text, model in cameras.items():
                picture = model.view(0, text).develop(radiance, seconds, response)
                strip.append(caption(shrunk(picture, CELL), text))
            row = Image.new("RGB", (sum(p.width + GAP for p in strip) - GAP, CELL), (255, 255, 255))
            for number, picture in enumerate(strip):
                row.paste(picture, (number * (picture.width + GAP), 0))
            rows.append(row)
        quality, size = save(given.out, assemble(rows))
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    print(f"wrote {given.out}: quality {quality}, {size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
