# SPDX-License-Identifier: GPL-3.0-or-later
"""A contact sheet of data sets, a row each: three exposures of a test view, relit twice, and its geometry.

    .venvs/backend/bin/python lab/tools/contact_sheet.py data/bathroom data/bear --out docs/images/scenes.jpg

The relit pictures are developed at the middle exposure, as the picture between them. Relit truth is made from
the passes where there are any, else read from relit/.
"""

import argparse
import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from physhdr.backend.inspect import inspect
from physhdr.backend.inspect.findings import Inspection
from physhdr.backend.inspect.layers import read_layers
from physhdr.backend.scene.pictures import read_codes, read_exr
from physhdr.bridge.atomic import atomic_path
from physhdr.bridge.errors import BadValueError, FileMissingError, OutputError, PhysHDRError
from physhdr.synth.png import quantise
from physhdr.synth.response import BUILT_IN

EXPOSURES = (0, 2, 4)
LEVELS = (0.25, 4.0)
#: Bytes: what a still picture in docs/ may have.
LIMIT = 400_000
QUALITIES = (85, 80, 75, 70)
PAPER, INK, FAINT = (255, 255, 255), (24, 24, 28), (96, 96, 104)
MARGIN, GAP, HEAD = 10, 4, 22
#: Metres from which on a depth is no surface.
SKY = 1e9
#: Quantiles of the depth that are shown as white and as nearly black.
NEAR, FAR = 0.02, 0.98


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="data sets, one a row")
    parser.add_argument("--out", type=Path, default=Path("docs/images/scenes.jpg"), help="the JPEG to write")
    parser.add_argument("--cell", type=int, default=176, help="pixels of a picture's height")
    parser.add_argument("--view", type=int, help="number of the test pose (default: the middle relit one)")
    given = parser.parse_args()
    try:
        rows = [row(folder, given.cell, given.view) for folder in given.folders]
        quality, size = save(given.out, assemble(rows))
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    print(f"wrote {given.out}: {len(rows)} scenes, quality {quality}, {size / 1000:.0f} kB")
    return 0


# ---- one data set ------------------------------------------------------------------------------------


def row(root: Path, cell: int, view: int | None) -> Image.Image:
    """A strip with its title: pictures ``cell`` pixels high.

    Raises ``PhysHDRError`` where the data set has faults, or no such view.
    """
    found = inspect(root)
    if found.errors:
        raise BadValueError(
            f"{root} has {len(found.errors)} faults, the first: {found.errors[0]}", "See physhdr inspect."
        )
    pose = chosen_view(found, view)
    cells = [exposed(root, pose, k, found) for k in EXPOSURES if k < len(found.exposures)]
    cells += [relit(root, pose, level, found) for level in LEVELS]
    strip = [caption(shrunk(picture, cell), text) for text, picture in cells if picture is not None]
    planes = geometry(root, pose)
    if planes:
        strip.append(stacked(planes, cell))
    width = sum(part.width for part in strip) + GAP * (len(strip) - 1)
    made = Image.new("RGB", (width, HEAD + cell), PAPER)
    draw = ImageDraw.Draw(made)
    title = ImageFont.load_default(16)
    draw.text((0, HEAD - 4), found.scene, INK, title, anchor="ls")
    left = title.getlength(found.scene) + 10
    draw.text((left, HEAD - 4), summary(found), FAINT, ImageFont.load_default(13), anchor="ls")
    x = 0
    for part in strip:
        made.paste(part, (x, HEAD))
        x += part.width + GAP
    return made


def summary(found: Inspection) -> str:
    """What stands beside the scene's name."""
    parts = []
    if found.dynamic_range and found.dynamic_range.stops is not None:
        about = "about " if found.dynamic_range.estimated else ""
        parts.append(f"{about}{found.dynamic_range.stops:.1f} stops")
    parts.append("lights: " + ", ".join(found.lights))
    return "; ".join(parts)


def chosen_view(found: Inspection, view: int | None) -> int:
    """The number of the test pose that is shown."""
    if "test" not in found.splits:
        raise FileMissingError(f"{found.folder} has no test views", "Make the data set again.")
    if view is not None:
        return view
    relit_poses = sorted({pose for entry in found.relit for pose in entry["poses"]})
    return relit_poses[len(relit_poses) // 2] if relit_poses else found.splits["test"].poses // 2


def exposed(root: Path, pose: int, k: int, found: Inspection) -> tuple[str, np.ndarray]:
    return f"EV {found.exposures[k].ev:+g}", read_codes(root / "test" / f"r_{pose}_{k}.png")[0]


def relit(root: Path, pose: int, level: float, found: Inspection) -> tuple[str, np.ndarray | None]:
    """The view under other ambient light at the middle exposure; None where nothing is known of it."""
    text = f"ambient x {level:g}"
    passes = root / "passes" / f"test_{pose:03d}.exr"
    truth = [entry["folder"] for entry in found.relit if entry["levels"] == {"ambient": level}]
    if passes.is_file():
        layers = read_layers(passes)
        radiance = sum(
            np.stack([layers[f"{light}.{c}"] for c in "RGB"], -1) * (level if light == "ambient" else 1.0)
            for light in found.lights
        )
    elif truth and (root / truth[0] / f"hdr_{pose:03d}.exr").is_file():
        radiance = read_exr(root / truth[0] / f"hdr_{pose:03d}.exr")
    else:
        return text, None
    response = BUILT_IN.get(found.response)
    if response is None:
        raise BadValueError(
            f"{root}: the response '{found.response}' is none of {', '.join(BUILT_IN)}",
            "A relit picture can be developed by those only.",
        )
    seconds = found.exposures[len(found.exposures) // 2].seconds
    return text, quantise(response(np.asarray(radiance, np.float64) * seconds))


def geometry(root: Path, pose: int) -> list[np.ndarray]:
    """Depth (near is bright), normal (XYZ as RGB) and object index (a colour each) as pictures."""
    path = root / "passes" / f"test_{pose:03d}.exr"
    if not path.is_file():
        return []
    layers = read_layers(path)
    depth, index = layers["depth.V"], layers["index.V"].astype(np.int64)
    there = depth < SKY
    shown = np.zeros(depth.shape)
    if there.any():
        logarithm = np.log(np.maximum(depth, 1e-6))
        near, far = np.quantile(logarithm[there], (NEAR, FAR))
        shown[there] = 1.0 - 0.9 * np.clip((logarithm[there] - near) / max(far - near, 1e-6), 0.0, 1.0)
    normal = 0.5 + 0.5 * np.stack([layers[f"normal.{axis}"] for axis in "XYZ"], -1)
    colours = np.random.default_rng(0).uniform(0.15, 1.0, (int(index.max()) + 1, 3))
    colours[0] = 0.0
    return [quantise(np.repeat(shown[..., None], 3, -1)), quantise(normal), quantise(colours[index])]


# ---- drawing -----------------------------------------------------------------------------------------


def shrunk(picture: np.ndarray, height: int) -> Image.Image:
    """At ``height`` pixels, its shape kept."""
    width = round(height * picture.shape[1] / picture.shape[0])
    return Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS)


def caption(picture: Image.Image, text: str) -> Image.Image:
    """Write into the lower left corner, to be read on any ground."""
    draw = ImageDraw.Draw(picture)
    place = (5, picture.height - 5)
    draw.text(
        place,
        text,
        (255, 255, 255),
        ImageFont.load_default(12),
        anchor="ls",
        stroke_width=1,
        stroke_fill=(0, 0, 0),
    )
    return picture


def stacked(pictures: list[np.ndarray], height: int) -> Image.Image:
    """One above the other, ``height`` pixels together."""
    each = (height - GAP * (len(pictures) - 1)) // len(pictures)
    small = [shrunk(picture, each) for picture in pictures]
    made = Image.new("RGB", (small[0].width, height), PAPER)
    for number, picture in enumerate(small):
        made.paste(picture, (0, number * (each + GAP)))
    return made


def assemble(rows: list[Image.Image]) -> Image.Image:
    width = max(each.width for each in rows) + 2 * MARGIN
    height = sum(each.height for each in rows) + GAP * (len(rows) - 1) + 2 * MARGIN
    sheet = Image.new("RGB", (width, height), PAPER)
    y = MARGIN
    for each in rows:
        sheet.paste(each, (MARGIN, y))
        y += each.height + GAP
    return sheet


def save(path: Path, sheet: Image.Image) -> tuple[int, int]:
    """Write the JPEG in the best quality that fits; the quality and the bytes it took.

    Raises ``OutputError`` where none does, or the file cannot be written.
    """
    packed = io.BytesIO()
    for quality in QUALITIES:
        packed = io.BytesIO()
        sheet.save(packed, "JPEG", quality=quality, optimize=True, progressive=True)
        if packed.tell() <= LIMIT:
            with atomic_path(path) as temporary:
                temporary.write_bytes(packed.getvalue())
            return quality, packed.tell()
    raise OutputError(
        f"{path} would have {packed.tell() / 1000:.0f} kB, more than {LIMIT / 1000:.0f}",
        "Choose smaller pictures: --cell 150.",
    )


if __name__ == "__main__":
    sys.exit(main())
