# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos of a capture as a camera writes them: how each is exposed, when, and what its file says of that.

A photographer brackets (one row of exposures for all places, about the middle of what they need) or leaves
the exposure to the camera, which meters each place. Numpy alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from fractions import Fraction
from typing import Any

import numpy as np

from ..bridge.contents import LUMINANCE
from . import camera_model, dng, tiff
from .camera_model import CameraModel, ViewCamera
from .capture import Place
from .lens import Lens
from .png import LARGEST_CODE_16, quantise
from .response import MIDDLE_GREY, Response

#: Cameras choose times by thirds of a stop.
STEPS_A_STOP = 3
#: Of the picture's height: the standard deviation of the weight with which a meter looks at the middle.
METERED_SHARE = 0.3
#: What the meter takes black for.
DARKEST = 1e-4
#: ISO that a camera without noise says it has: what one second means (docs/photos.md).
BASE_ISO = 100.0
F_NUMBER = Fraction(8)
MAKER, CAMERA = "PhysHDR", "Synthetic"
BEGINNING = datetime(2026, 5, 1, 10, 0, 0)
#: Seconds from one photo of a bracket to the next, and to the next place.
PAUSE, WALK = 1.0, 12.0
#: The width of 35 mm film in millimetres, which EXIF's focal length refers to.
FILM_WIDTH = 36.0
MOMENT = "%Y:%m:%d %H:%M:%S"
#: The folder of the photos under the standard light.
STANDARD = "photos"


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo before it is taken. ``levels`` of lights that are not at 1; ``folder``: where it will lie."""

    number: int
    place: Place
    #: Seconds at ISO 100, as the camera states them.
    exposure: float
    #: Stops from what the meter says.
    bias: float
    taken: datetime
    #: The camera as it is at this place; an ideal one at places for testing, whose photos are the truth.
    camera: ViewCamera
    folder: str = STANDARD
    levels: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Without its suffix."""
        return f"IMG_{self.number:04d}"


@dataclass(frozen=True)
class Group:
    """A round of photos under one light, into one folder. ``levels`` of lights that are not at 1."""

    folder: str = STANDARD
    levels: Mapping[str, float] = field(default_factory=dict)


def metered(radiance: np.ndarray, share: float = METERED_SHARE) -> float:
    """Seconds at which the centre-weighted log mean of the luminance becomes middle grey.

    ``share``: of the picture's height, how wide the meter looks about the middle; a spot meter has 0.08.
    """
    height, width = radiance.shape[:2]
    y = (np.arange(height) + 0.5 - height / 2)[:, None]
    x = (np.arange(width) + 0.5 - width / 2)[None, :]
    weight = np.exp(-(x**2 + y**2) / (2.0 * (share * height) ** 2))
    stops = np.log2(np.maximum(radiance.astype(np.float64) @ LUMINANCE, DARKEST))
    return float(MIDDLE_GREY / np.exp2((weight * stops).sum() / weight.sum()))


def on_the_dial(exposure: float) -> float:
    """The nearest exposure that a camera has: thirds of stops."""
    return float(np.exp2(np.round(STEPS_A_STOP * np.log2(exposure)) / STEPS_A_STOP))


def plan(
    places: Sequence[Place],
    meters: Sequence[float],
    evs: Sequence[float] | None,
    model: CameraModel,
    seed: int,
    group: Group = Group(),
    before: Sequence[Photo] = (),
) -> list[Photo]:
    """The photos of one group in the order in which they are taken, after those taken ``before``.

    ``meters``: ``metered`` of each place under the group's light. ``evs``: the bracket's stops about the
    median of these; where it is ``None`` each place has one photo, exposed as the camera meters it.
    """
    base = on_the_dial(float(np.median(meters)))
    clock = before[-1].taken + timedelta(seconds=WALK) if before else BEGINNING
    number, found = len(before), []
    for place, meter in zip(places, meters, strict=True):
        exposures = [on_the_dial(meter)] if evs is None else [base * 2.0**ev for ev in evs]
        # The camera has other noise and other faults when it comes by again.
        name = place.name if group.folder == STANDARD else f"{group.folder}/{place.name}"
        camera = (CameraModel() if place.test else model).view(seed, name)
        for exposure, ev in zip(exposures, evs or [0.0], strict=True):
            number += 1
            found.append(Photo(number, place, exposure, ev, clock, camera, group.folder, group.levels))
            clock += timedelta(seconds=shutter(exposure, model) + PAUSE)
        clock += timedelta(seconds=WALK)
    return found


def shutter(exposure: float, model: CameraModel) -> float:
    """Seconds of the shutter at the camera's ISO, for seconds at ISO 100."""
    return exposure * BASE_ISO / (model.iso or BASE_ISO)


def tags(photo: Photo, lens: Lens, model: CameraModel) -> tuple[tiff.Tags, tiff.Tags]:
    """What the file says: TIFF's tags, and EXIF's."""
    moment = photo.taken.strftime(MOMENT)
    first = {tiff.MAKE: MAKER, tiff.MODEL: CAMERA, tiff.ORIENTATION: 1, tiff.MOMENT: moment}
    exif = {
        tiff.EXPOSURE_TIME: tiff.fraction(shutter(photo.exposure, model)),
        tiff.F_NUMBER: F_NUMBER,
        tiff.ISO: round(model.iso or BASE_ISO),
        tiff.EXIF_VERSION: b"0230",
        tiff.TAKEN: moment,
        tiff.EXPOSURE_BIAS: tiff.signed(photo.bias),
        tiff.FOCAL_35MM: round(lens.fx / max(lens.width, lens.height) * FILM_WIDTH),
    }
    return first, exif


def developed(photo: Photo, radiance: np.ndarray, response: Response) -> np.ndarray:
    """Picture [H, W, 3] uint8 as the camera develops it."""
    return photo.camera.develop(radiance.astype(np.float64), photo.exposure, response)


def tiff_file(
    photo: Photo, radiance: np.ndarray, response: Response, lens: Lens, model: CameraModel
) -> bytes:
    """The same with 16 bits a channel."""
    code = photo.camera.code(radiance.astype(np.float64), photo.exposure, response)
    first, exif = tags(photo, lens, model)
    return tiff.picture(quantise(code, LARGEST_CODE_16), {**first, tiff.PHOTOMETRIC: tiff.RGB}, exif)


def raw_file(photo: Photo, radiance: np.ndarray, lens: Lens, model: CameraModel, mosaic: bool) -> bytes:
    """A DNG: what the sensor counted, before white balance and response. ``mosaic``: one channel a pixel."""
    sensed = photo.camera.sensed(radiance.astype(np.float64) * dng.DAYLIGHT, photo.exposure)
    counted = sensed / camera_model.SATURATION
    iso = photo.camera.model.iso
    noise = None
    if iso is not None:
        electrons = camera_model.electrons_at_saturation(iso)
        noise = 1.0 / electrons, (camera_model.read_noise(iso) / electrons) ** 2
    first, exif = tags(photo, lens, model)
    shown = dng.mosaic(counted) if mosaic else counted
    return dng.encode(shown, photo.camera.balance, first, exif, noise)


def describe(photo: Photo, suffix: str) -> dict[str, Any]:
    """The truth about a photo."""
    return {
        "file": photo.name + suffix,
        "folder": photo.folder,
        "levels": dict(photo.levels),
        "place": photo.place.name,
        "test": photo.place.test,
        "exposure": photo.exposure,
        "true_exposure": photo.camera.true_exposure(photo.exposure),
        "white_balance": photo.camera.balance.tolist(),
    }


def transforms(photos: Sequence[Photo], names: Mapping[Photo, str], lens: Lens) -> dict[str, Any]:
    """nerfstudio's ``transforms.json`` of the photos with their true cameras; its axes are Blender's."""
    return {
        **lens.describe(),
        "frames": [
            {
                "file_path": names[photo],
                "transform_matrix": photo.place.pose.tolist(),
                "exposure_time": photo.exposure,
                **({"lighting_levels": dict(photo.levels)} if photo.levels else {}),
            }
            for photo in photos
        ],
        "train_filenames": [names[photo] for photo in photos if not photo.place.test],
        "test_filenames": [names[photo] for photo in photos if photo.place.test],
    }
