# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures of pictures, in seconds: from a file that states them, or from what the camera wrote (EXIF)."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...bridge.data_set import EXPOSURE_FILE, plain_name
from ...bridge.errors import DataMismatchError
from ...bridge.layouts.checks import exposure, read_json
from ...bridge.limits import EXPOSURE
from .exif import Exif, comparable, read_exif
from .pictures import holds_radiance

#: This share of the pictures may be of unknown exposure, and is skipped; of more, the user must state them.
MOST_UNKNOWN = 0.25
#: What to do where an exposure is unknown.
SAY_EXPOSURES = (
    f'Write {EXPOSURE_FILE} beside images/: {{"pose_0.jpg": 0.125, …}}, seconds for each picture; or use '
    "pictures that still have the camera's EXIF data."
)


def read_exposure_file(path: Path) -> dict[str, float]:
    """Seconds by picture name (relative to ``images/``, forward slashes).

    Raises what ``read_json`` raises, ``BadValueError`` where an exposure is no number within the bounds.
    """
    return {
        plain_name(key).removeprefix("images/"): exposure(path, value, key)
        for key, value in read_json(path).items()
    }


def exposures_from_exif(
    paths: Sequence[Path], remedy: str = SAY_EXPOSURES
) -> tuple[list[float | None], str] | None:
    """Seconds for each picture, and a message on their origin; None where no picture states its time.

    Seconds at ISO 100 and at the pictures' median aperture (``exif.comparable``). An ISO or aperture that
    *no* picture states counts as constant. A picture that holds radiance counts as exposed for 1 s. One that
    lacks what others state is of unknown exposure (None) and counted in the message; raises
    ``DataMismatchError`` with ``remedy`` where these are more than ``MOST_UNKNOWN``, ``BadValueError`` where
    an exposure comes out absurd.
    """
    tags = {path: read_exif(path) for path in paths if not holds_radiance(path)}
    if all(tag.time is None for tag in tags.values()):
        return None
    lacking = _lacking(tags, remedy)
    known = {path: tag for path, tag in tags.items() if path not in lacking}
    exposures = comparable(list(known.values()))
    seconds: dict[Path, float | None] = dict.fromkeys(paths, 1.0) | dict.fromkeys(lacking)
    for path, value in zip(known, exposures.seconds, strict=True):
        seconds[path] = EXPOSURE.check(value, f"{path}: the exposure by its EXIF data")
    message = "exposures from EXIF, seconds at ISO 100"
    if exposures.f_number is not None:
        message += f" and f/{exposures.f_number:g}"
    if all(tag.iso is None for tag in known.values()):
        message += "; no picture states its ISO: assuming it is constant"
    if exposures.f_number is None:
        message += "; no picture states its aperture: assuming it is constant"
    if len(tags) < len(paths):
        message += "; pictures that hold radiance count as 1 s"
    if lacking:
        first, why = min(lacking.items())
        message += f"; skipping {len(lacking)} of {len(tags)} pictures without an exposure "
        message += f"(first: {first} has {why})"
    return [seconds[path] for path in paths], message


def _lacking(tags: Mapping[Path, Exif], remedy: str) -> dict[Path, str]:
    """The pictures that lack what others state, and what that is; raises as ``exposures_from_exif``."""
    lacking: dict[Path, str] = {}
    for what, name in (("time", "exposure time"), ("iso", "ISO"), ("f_number", "aperture")):
        known = [path for path, tag in tags.items() if getattr(tag, what) is not None]
        without = [path for path, tag in tags.items() if known and getattr(tag, what) is None]
        for path in without:
            lacking.setdefault(path, f"no {name} in its EXIF data, {known[0]} has")
        if len(lacking) > MOST_UNKNOWN * len(tags):
            raise DataMismatchError(
                f"{without[0]} has no {name} in its EXIF data, {known[0]} has ({len(known)} of {len(tags)} "
                "pictures have)",
                remedy,
            )
    return lacking
