# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes the photos of a capture that ``render_capture.py`` rendered, by a camera with faults or not.

    .venvs/backend/bin/python lab/tools/take_photos.py CAPTURE --out FOLDER --bracket=-4,-2,0,2,4 \\
        --iso 800 --exposure-jitter 0.2 --white-balance-jitter 0.1 --vignetting 1
    .venvs/backend/bin/python lab/tools/take_photos.py CAPTURE --out FOLDER --auto-exposure --format dng

FOLDER gets ``photos/`` with EXIF, for ``physhdr prepare``; ``truth/``: ``sparse/0`` with the true lens and
cameras (``physhdr prepare FOLDER/photos --poses FOLDER/truth``), and ``photos.json``, what each photo truly
is; and ``transforms.json``: FOLDER itself as nerfstudio has it, distorted. Photos of places for testing have
no fault. The same options give the same bytes; what is there is not made again.
"""

import argparse
import io
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from PIL import Image

from physhdr.bridge.errors import PhysHDRError
from physhdr.synth import camera_model, folder, photos, tiff, true_model
from physhdr.synth.camera_model import CameraModel
from physhdr.synth.capture import Capture, Place, opened
from physhdr.synth.errors import ConflictError, DamagedFileError, OptionError
from physhdr.synth.photos import Photo
from physhdr.synth.response import Response, by_name

#: Format → the suffix of its files.
SUFFIXES = {"jpeg": ".jpg", "tiff16": ".tif", "dng": ".dng", "cfa": ".dng"}
TRUTH_FILE = "photos.json"
#: Of the picture's height: a meter that looks at less sees a pixel.
LEAST_SPOT = 0.01


def main() -> int:
    given = _parser().parse_args()
    try:
        _take(given)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    add = made.add_argument
    add("capture", type=Path)
    add("--out", type=Path, required=True)
    exposures = made.add_mutually_exclusive_group()
    exposures.add_argument("--bracket", default="-2,0,2", metavar="EV,EV,…", help="stops about the middle")
    exposures.add_argument("--auto-exposure", action="store_true", help="one photo a place, as it is metered")
    add(
        "--metering",
        type=float,
        default=photos.METERED_SHARE,
        metavar="SHARE",
        help="of the picture's height, how wide the meter looks about the middle; a spot meter: 0.08",
    )
    add("--format", choices=list(SUFFIXES), default="jpeg", help="dng: demosaiced; cfa: as sensors are")
    add("--quality", type=int, default=95, help="of JPEG")
    add("--crf", default="filmic", help="the response, of all but raw files: a name, or the file of a curve")
    add("--seed", type=int, default=0)
    add("--every", type=int, default=1, metavar="N", help="only each N-th place that is not for testing")
    add("--partial", action="store_true", help="places that are not rendered yet are left out")
    camera_model.add_arguments(made)
    return made


def _take(given: argparse.Namespace) -> None:
    model = camera_model.from_arguments(given)
    model.check()
    if not (given.metering >= LEAST_SPOT and given.every >= 1):
        raise OptionError(f"--metering is {LEAST_SPOT} at least, and --every 1")
    capture, response = opened(given.capture), by_name(given.crf)
    evs = None if given.auto_exposure else _evs(given.bracket)
    places = _places(given, capture)
    _enter(given, model, response, capture, places)
    # Each place is read twice: once for its meter, once for its photos, so that memory holds one.
    meters = [photos.metered(capture.passes(place).radiance({}), given.metering) for place in places]
    planned = photos.plan(places, meters, evs, model, given.seed)
    suffix = SUFFIXES[given.format]
    views = []
    for place in places:
        passes = capture.passes(place)
        radiance = passes.radiance({})
        taken = [photo for photo in planned if photo.place is place]
        for photo in taken:
            path = given.out / "photos" / f"{photo.name}{suffix}"
            if not path.exists():
                folder.write(path, _encoded(given, photo, radiance, response, capture, model))
        middle = taken[len(taken) // 2]
        ideal = photos.developed(_ideal(middle), radiance, response)
        count = true_model.POINTS // len(places)
        points = true_model.visible_points(place, passes, ideal, capture.lens, count, given.seed)
        views.append((f"{middle.name}{suffix}", place, points))
        print(f"{place.name}: {', '.join(photo.name for photo in taken)}", flush=True)
    true_model.write(given.out / "truth", capture.lens, views)
    names = {photo: f"photos/{photo.name}{suffix}" for photo in planned}
    folder.write_json(given.out / "transforms.json", photos.transforms(planned, names, capture.lens))
    told = folder.read_json(given.out / "truth" / TRUTH_FILE)
    told["photos"] = [photos.describe(photo, suffix) for photo in planned]
    folder.write_json(given.out / "truth" / TRUTH_FILE, told)


def _evs(text: str) -> list[float]:
    try:
        evs = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise OptionError(f"--bracket '{text}': write -2,0,2") from error
    if evs != sorted(set(evs)):
        raise OptionError(f"--bracket '{text}': each once, the darkest first")
    return evs


def _enter(
    given: argparse.Namespace, model: CameraModel, response: Response, capture: Capture, places: list[Place]
) -> None:
    """Raises ``ConflictError`` where photos with other options are there, or of other places.

    Photos are numbered through, and exposed about the middle of all: one place more changes all others.
    """
    asked: dict[str, Any] = {
        "capture": given.capture.name,
        "rendered": capture.options,
        "places": [place.name for place in places],
        "bracket": None if given.auto_exposure else given.bracket,
        "camera": asdict(model),
        "response": response.describe(),
        **{name: getattr(given, name) for name in ("metering", "format", "quality", "seed", "every")},
    }
    path = given.out / "truth" / TRUTH_FILE
    asked = json.loads(json.dumps(asked))
    if path.exists():
        if folder.read_json(path).get("options") != asked:
            raise ConflictError(
                f"'{given.out}' has photos with other options, or of other places",
                "choose another folder (--out), or delete it",
            )
        return
    folder.write_json(path, {"options": asked})


def _places(given: argparse.Namespace, capture: Capture) -> list[Place]:
    there = [place for place in capture.places if capture.file(place).exists()]
    missing = len(capture.places) - len(there)
    if missing and not given.partial:
        raise DamagedFileError(
            f"'{given.capture}': {missing} of {len(capture.places)} places are not rendered yet",
            "let lab/tools/render_capture.py end, or give --partial",
        )
    training = [place for place in there if not place.test][:: given.every]
    return [place for place in there if place.test or place in training]


def _ideal(photo: Photo) -> Photo:
    return Photo(
        photo.number,
        photo.place,
        photo.exposure,
        photo.bias,
        photo.taken,
        CameraModel().view(0, photo.place.name),
    )


def _encoded(
    given: argparse.Namespace,
    photo: Photo,
    radiance: Any,
    response: Response,
    capture: Capture,
    model: CameraModel,
) -> bytes:
    if given.format in ("dng", "cfa"):
        return photos.raw_file(photo, radiance, capture.lens, model, mosaic=given.format == "cfa")
    if given.format == "tiff16":
        return photos.tiff_file(photo, radiance, response, capture.lens, model)
    made = io.BytesIO()
    block = b"Exif\0\0" + tiff.exif_block(*photos.tags(photo, capture.lens, model))
    picture = Image.fromarray(photos.developed(photo, radiance, response))
    picture.save(made, "JPEG", quality=given.quality, subsampling="4:2:2", exif=block)
    return made.getvalue()


if __name__ == "__main__":
    sys.exit(main())
