# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures of pictures, in seconds: from a file that states them, or from what the camera wrote (EXIF)."""

from collections.abc import Sequence
from pathlib import Path

from ...bridge.data_set import EXPOSURE_FILE, plain_name
from ...bridge.errors import DataMismatchError
from ...bridge.limits import EXPOSURE
from .checks import exposure, read_json
from .exif import comparable, read_exif
from .pictures import holds_radiance

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


def exposures_from_exif(paths: Sequence[Path], remedy: str = SAY_EXPOSURES) -> tuple[list[float], str] | None:
    """Seconds for each picture, and in words where they are from; None where no picture says its time.

    Seconds at ISO 100 and at the pictures' median aperture (``exif.comparable``). ISO or aperture, where *no*
    picture tells it, counts as constant. A picture that holds radiance counts as exposed for 1 s. Raises
    ``DataMismatchError`` with ``remedy`` where some pictures say something that others do not,
    ``BadValueError`` where an exposure comes out absurd.
    """
    everything, paths = paths, [path for path in paths if not holds_radiance(path)]
    tags = [read_exif(path) for path in paths]
    if all(tag.time is None for tag in tags):
        return None
    for what, name in (("time", "exposure time"), ("iso", "ISO"), ("f_number", "aperture")):
        known = [getattr(tag, what) is not None for tag in tags]
        if any(known) and not all(known):
            raise DataMismatchError(
                f"{paths[known.index(False)]} has no {name} in its EXIF data, {paths[known.index(True)]} has "
                f"({sum(known)} of {len(paths)} pictures have)",
                remedy,
            )
    exposures = comparable(tags)
    for path, seconds in zip(paths, exposures.seconds, strict=True):
        EXPOSURE.check(seconds, f"{path}: the exposure by its EXIF data")
    told = "exposures from EXIF, seconds at ISO 100"
    if exposures.f_number is not None:
        told += f" and f/{exposures.f_number:g}"
    if tags[0].iso is None:
        told += "; no picture tells its ISO: taken as constant"
    if exposures.f_number is None:
        told += "; no picture tells its aperture: taken as constant"
    if len(paths) < len(everything):
        told += "; pictures that hold radiance count as 1 s"
    seconds = dict(zip(paths, exposures.seconds, strict=True))
    return [seconds.get(path, 1.0) for path in everything], told
