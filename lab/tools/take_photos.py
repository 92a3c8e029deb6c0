# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes the photos of a capture that ``render_capture.py`` rendered, by a camera with faults or not.

    .venvs/backend/bin/python lab/tools/take_photos.py CAPTURE --out FOLDER --bracket=-4,-2,0,2,4 \\
        --iso 800 --exposure-jitter 0.2 --white-balance-jitter 0.1 --vignetting 1
    .venvs/backend/bin/python lab/tools/take_photos.py CAPTURE --out FOLDER --auto-exposure --format dng
    .venvs/backend/bin/python lab/tools/take_photos.py CAPTURE --out FOLDER \\
        --group "pendant off" pendant=0 8 --group "daylight evening" ambient=0.2 8

FOLDER gets ``photos/`` with EXIF, for ``physhdr prepare``; ``truth/``: ``sparse/0`` with the true lens and
cameras (``physhdr prepare FOLDER/photos --poses FOLDER/truth``), and ``photos.json``, what each photo truly
is; and ``transforms.json``: FOLDER itself as nerfstudio has it, distorted. Photos of places for testing have
no fault. Each ``--group`` is one more round of photos, of as many places for training as it says, under other
levels of the capture's lights, in a folder beside ``photos/``. The same options give the same bytes; what is
there is not made again.
"""

import argparse
import io
import json
import math
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
from physhdr.synth.photos import Group, Photo
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
    add(
        "--group",
        nargs=3,
        action="append",
        default=[],
        metavar=("FOLDER", "LIGHT=LEVEL,…", "PLACES"),
        help="photos under other light",
    )
    add(
        "--standard",
        default="",
        metavar="LIGHT=LEVEL,…",
        help="of photos/, where it is not 1: a lamp that is on in its group alone",
    )
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
    rounds = _rounds(given, capture, places)
    _enter(given, model, response, capture, places)
    planned: list[Photo] = []
    for group, chosen in rounds:
        # Each place is read once for its meter, and again for its photos, so that memory holds one.
        lit = (capture.passes(place).radiance(group.levels) for place in chosen)
        meters = [photos.metered(radiance, given.metering) for radiance in lit]
        planned += photos.plan(chosen, meters, evs, model, given.seed, group, planned)
    suffix = SUFFIXES[given.format]
    views = []
    for place in places:
        passes = capture.passes(place)
        taken = [photo for photo in planned if photo.place is place]
        for photo in taken:
            path = given.out / photo.folder / f"{photo.name}{suffix}"
            if not path.exists():
                radiance = passes.radiance(photo.levels)
                folder.write(path, _encoded(given, photo, radiance, response, capture, model))
        for group in dict.fromkeys(photo.folder for photo in taken):
            bracket = [photo for photo in taken if photo.folder == group]
            middle = bracket[len(bracket) // 2]
            ideal = photos.developed(_ideal(middle), passes.radiance(middle.levels), response)
            count = true_model.POINTS // sum(len(chosen) for _, chosen in rounds)
            points = true_model.visible_points(place, passes, ideal, capture.lens, count, given.seed)
            views.append((f"{middle.name}{suffix}", place, points))
        print(f"{place.name}: {', '.join(photo.name for photo in taken)}", flush=True)
    true_model.write(given.out / "truth", capture.lens, views)
    names = {photo: f"{photo.folder}/{photo.name}{suffix}" for photo in planned}
    folder.write_json(given.out / "transforms.json", photos.transforms(planned, names, capture.lens))
    truth = folder.read_json(given.out / "truth" / TRUTH_FILE)
    truth["photos"] = [photos.describe(photo, suffix) for photo in planned]
    folder.write_json(given.out / "truth" / TRUTH_FILE, truth)


def _evs(text: str) -> list[float]:
    try:
        evs = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise OptionError(f"--bracket '{text}': write -2,0,2") from error
    if evs != sorted(set(evs)):
        raise OptionError(f"--bracket '{text}': each once, the darkest first")
    return evs


def _rounds(
    given: argparse.Namespace, capture: Capture, places: list[Place]
) -> list[tuple[Group, list[Place]]]:
    """Each group and the places where it is photographed, the standard light first.

    Raises ``OptionError`` where ``--group`` or ``--standard`` names no light, level or number of places.
    """
    standard = _levels(given.standard, capture.lights)
    training = [place for place in places if not place.test]
    rounds = [(Group(levels=standard), places)]
    for name, levels, count in given.group:
        if not (count.isdecimal() and 1 <= int(count) <= len(training)):
            raise OptionError(f"--group '{name}': {count} places; there are {len(training)} for training")
        if name in ("", "truth") or Path(name).name != name or name in (group.folder for group, _ in rounds):
            raise OptionError(f"--group '{name}': give each a folder's name of its own")
        # Groups do not share their places, as far as there are enough.
        step = len(training) / int(count)
        shift = step * ((len(rounds) * 0.38) % 1.0)
        chosen = [training[int(shift + k * step)] for k in range(int(count))]
        rounds.append((Group(name, {**standard, **_levels(levels, capture.lights)}), chosen))
    return rounds


def _levels(text: str, lights: tuple[str, ...]) -> dict[str, float]:
    """``pendant=0,ambient=0.2``; raises ``OptionError``."""
    found = {}
    for word in filter(None, text.split(",")):
        light, _, level = word.partition("=")
        try:
            found[light] = float(level)
        except ValueError as error:
            raise OptionError(f"'{word}': write LIGHT=LEVEL, as pendant=0") from error
        if light not in lights or not 0.0 <= found[light] < math.inf:
            raise OptionError(f"'{word}': the capture has the lights {', '.join(lights)}, at levels from 0")
    return found


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
        **{
            name: getattr(given, name)
            for name in ("metering", "format", "quality", "seed", "every", "group", "standard")
        },
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
