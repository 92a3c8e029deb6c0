# SPDX-License-Identifier: GPL-3.0-or-later
"""Each photo's exposure in seconds: from its EXIF, or from a file that the user gives."""

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ....bridge.errors import BadValueError, DataMismatchError, FileMissingError
from ....bridge.limits import EXPOSURE
from ....bridge.regular import damaged_where_it_fails, read_json_object, read_text
from ..exif import comparable
from .photos import Photo, alike

#: Names that a message lists before it says how many more there are.
FEW = 4
GIVE_A_FILE = (
    "Give the exposures in a file: --exposures FILE, JSON or CSV, file name → seconds; or, where all are of "
    "one exposure, --same-exposure."
)


@dataclass(frozen=True)
class Exposures:
    """``seconds`` by file name; ``meaning``: of what these are seconds, in words."""

    seconds: dict[str, float]
    meaning: str


def some_names(names: Sequence[str]) -> str:
    """The first few of ``names``, and how many more there are."""
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return ", ".join(names[:FEW]) + more


def exposures_from_exif(photos: Sequence[Photo]) -> Exposures:
    """Seconds at ISO 100 and at the photos' median aperture (``exif.comparable``).

    What no photo tells (ISO, aperture: a manual lens) is the same for all of them and cancels. Where no photo
    tells its time, what the camera metered (APEX's brightness) tells the exposure, or the bias that the
    photographer set, if it differs: seconds of no known unit then.

    Raises ``DataMismatchError`` where a time is missing, or where only some photos tell the rest,
    ``BadValueError`` where an exposure comes out absurd.
    """
    if not any(photo.shutter for photo in photos):
        relative = _by_brightness(photos) or _by_bias(photos)
        if relative is not None:
            return relative
    _require(photos, "exposure time", [photo.shutter for photo in photos])
    iso = [photo.iso for photo in photos]
    f_numbers = [photo.f_number for photo in photos]
    for what, values in (("ISO", iso), ("aperture", f_numbers)):
        if any(value is not None for value in values):
            _require(photos, what, values)
    exposures = comparable([photo.exif for photo in photos])
    at = "one ISO that EXIF does not tell" if iso[0] is None else "ISO 100"
    if exposures.f_number is None:
        aperture = "one aperture that EXIF does not tell"
    else:
        aperture = f"f/{exposures.f_number:g}"
    return Exposures(_checked(photos, exposures.seconds), f"EXIF; seconds at {at} and {aperture}")


def _by_brightness(photos: Sequence[Photo]) -> Exposures | None:
    """From APEX's Av + Tv = Bv + Sv (EXIF 2.3, annex C), of an exposure that is ``bias`` stops more.

    Time × ISO / 100 / F² is then 2^(bias − Bv − 5), whatever the three are.
    """
    if any(photo.brightness is None for photo in photos):
        return None
    stops = [(photo.bias or 0.0) - (photo.brightness or 0.0) - 5.0 for photo in photos]
    seconds = _checked(photos, [2.0**ev for ev in stops])
    return Exposures(seconds, "EXIF's brightness values alone; seconds at ISO 100 and f/1")


def _by_bias(photos: Sequence[Photo]) -> Exposures | None:
    """Relative to the one that is neither brightened nor darkened."""
    biases = [photo.bias for photo in photos]
    if any(bias is None for bias in biases) or len(set(biases)) < 2:
        return None
    seconds = _checked(photos, [2.0 ** (bias or 0.0) for bias in biases])
    return Exposures(seconds, "EXIF's exposure bias alone; relative, 1 where it is 0")


def _checked(photos: Sequence[Photo], seconds: Sequence[float]) -> dict[str, float]:
    return {
        photo.name: EXPOSURE.check(value, f"{photo.path}: the exposure by its EXIF data")
        for photo, value in zip(photos, seconds, strict=True)
    }


def same_exposures(photos: Sequence[Photo]) -> Exposures:
    """All photos of one exposure, as the user says."""
    return Exposures({photo.name: 1.0 for photo in photos}, "as asked: all the same, called 1 s")


def _require(photos: Sequence[Photo], what: str, values: Sequence[float | None]) -> None:
    """Every photo has a value; raises ``DataMismatchError``."""
    without = [photo.name for photo, value in zip(photos, values, strict=True) if value is None]
    if without:
        share = "no photo" if len(without) == len(photos) else f"{len(without)} of {len(photos)} photos"
        verb = "states" if len(without) == len(photos) else "do not state"
        raise DataMismatchError(f"{share} {verb} its {what} in EXIF: {some_names(without)}", GIVE_A_FILE)


def exposures_from_file(path: Path, photos: Sequence[Photo]) -> Exposures:
    """From JSON ``{"name": seconds}`` or CSV ``name,seconds``; a name is with or without its suffix.

    Its case and the spelling of its accents do not count. Photos under other light may go by their group or
    folder, too (``pendant off/IMG_1.jpg``), and must where another folder has a file of that name.

    Raises ``FileMissingError``, ``FileDamagedError`` (neither JSON nor CSV), ``BadValueError`` (no positive
    number), ``DataMismatchError`` (a photo without an exposure).
    """
    if not path.exists():
        raise FileMissingError(f"the file of exposures {path} does not exist", GIVE_A_FILE)
    if path.suffix.lower() == ".json":
        table = read_json_object(path, GIVE_A_FILE)
    else:
        with damaged_where_it_fails(f"{path} is not readable", GIVE_A_FILE):
            table = _csv(read_text(path, GIVE_A_FILE))
    by_name = {**{alike(name): entry for name, entry in table.items()}, **table}
    seconds = {}
    folders = Counter(photo.path.stem for photo in photos)
    for photo in photos:
        names, path = [photo.name, photo.stem], photo.path
        if photo.group:
            names += [f"{path.parent.name}/{path.name}", f"{path.parent.name}/{path.stem}"]
        if photo.group and folders[path.stem] == 1:
            names += [path.name, path.stem]
        names += [alike(name) for name in names]
        entry = next((by_name[name] for name in names if by_name.get(name) is not None), None)
        if entry is not None:
            seconds[photo.name] = _seconds(entry, photo.name, path)
    without = [photo.name for photo in photos if photo.name not in seconds]
    if without:
        raise DataMismatchError(
            f"{path} has no exposure for {len(without)} of {len(photos)} photos: {some_names(without)}",
            "Add them, or move these photos away.",
        )
    return Exposures(seconds, f"{path.name}; seconds")


def _csv(text: str) -> dict[str, str]:
    """``name → seconds`` as text; a first line whose second column has no digit is a heading.

    Further columns may hold words. Where one holds numbers, which are the seconds is not plain (exiftool's
    ``SourceFile,ISO,ExposureTime``; decimal commas between commas): raises ``ValueError``, as for seconds
    that a heading calls 1/s, and for a name with two exposures.
    """
    rows = [row for row in map(_columns, text.splitlines()) if row and row[0]]
    for number, row in enumerate(rows):
        if len(row) < 2:
            raise ValueError(f"line {number + 1} is not 'name,seconds': {row[0]!r}")
    if rows and re.match(r"1\s*/\s*[^\W\d]", rows[0][1]):
        raise ValueError(f"its second column is called '{rows[0][1]}', and seconds are wanted")
    _require_one_of_numbers(rows)
    if rows and not any(character.isdigit() for character in rows[0][1]):
        rows = rows[1:]
    table: dict[str, str] = {}
    for name, seconds, *_ in rows:
        first = table.setdefault(name, seconds)
        if seconds != first and _number(seconds) != _number(first):
            raise ValueError(f"{name!r} has two exposures, {first} and {seconds}")
    return table


def _require_one_of_numbers(rows: list[list[str]]) -> None:
    below = [row for number, row in enumerate(rows) if number or math.isfinite(_number(row[1]))]
    for place in range(2, max(map(len, below), default=0)):
        cells = [row[place] for row in below if len(row) > place and row[place]]
        if cells and all(math.isfinite(_number(cell)) for cell in cells):
            raise ValueError(
                f"two columns are wanted, name and seconds, but its column {place + 1} holds numbers, too"
            )


def _columns(line: str) -> list[str]:
    """The cells of a line between tabs, semicolons or commas: the first by which the second is a number.

    Between the former two decimals may have a comma.
    """
    found: list[list[str]] = []
    for separator in "\t;,":
        cells = [cell.strip() for row in csv.reader([line], delimiter=separator) for cell in row]
        if separator != ",":
            cells[1:] = [cell.replace(",", ".") for cell in cells[1:]]
        if len(cells) > 1 and math.isfinite(_number(cells[1])):
            return cells
        found.append(cells)
    return max(found, key=len)


def _number(text: str) -> float:
    """Of ``0.5`` or ``1/60``; NaN of what is none."""
    top, _, bottom = text.partition("/")
    try:
        return float(top) / float(bottom or 1)
    except (ValueError, ZeroDivisionError):
        return math.nan


def _seconds(entry: object, name: str, path: Path) -> float:
    """A number, or text such as ``1/60``."""
    seconds = _number(str(entry))
    if isinstance(entry, bool) or not (math.isfinite(seconds) and seconds > 0.0):
        raise BadValueError(
            f"{path} gives {name} the exposure {entry!r:.80}", "Give seconds above 0: 0.5 or 1/60."
        )
    return EXPOSURE.check(seconds, f"{path}: the exposure of {name}")
