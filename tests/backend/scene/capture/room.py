# SPDX-License-Identifier: GPL-3.0-or-later
"""A room with boxes, ray cast with numpy, photographed in brackets by a camera that is known exactly."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, TiffImagePlugin

WIDTH, HEIGHT = 400, 300
FOCAL, CX, CY = 380.0, 200.0, 150.0
#: k1, k2, p1, p2 of Brown's model, as COLMAP's OPENCV camera has them: a barrel.
DISTORTION = (-0.12, 0.03, 0.001, -0.0005)
#: Samples along each side of a pixel.
OVER = 2
#: Low corner, high corner, metres: the room itself, then what stands in it.
BOXES = (
    ((-3.0, -3.0, 0.0), (3.0, 3.0, 2.6)),
    ((-0.5, -0.4, 0.0), (0.3, 0.4, 0.7)),
    ((0.6, -0.9, 0.0), (1.1, -0.3, 1.1)),
    ((-1.3, 0.5, 0.0), (-0.8, 1.2, 0.5)),
)
EXPOSURES = (0.125, 0.5, 2.0)
#: Where a lamp is, metres: in a corner.
LAMP = (2.2, 1.8, 2.3)
#: Another one, on the other side of the room.
PENDANT = (-2.0, -1.5, 2.2)
#: When the first photo of a folder was taken.
MOMENT = datetime(2026, 5, 1, 12)


def response(exposure: np.ndarray) -> np.ndarray:
    """The camera's: (x/(1+x))^(1/2.2), from exposure × radiance to 0…1."""
    return (exposure / (1.0 + exposure)) ** (1.0 / 2.2)


def look_from(position: tuple[float, float, float], at: tuple[float, float, float]) -> np.ndarray:
    """World-to-camera ``[3, 4]`` in OpenCV axes of a level camera."""
    forward = np.subtract(at, position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return np.concatenate([rotation, -rotation @ np.reshape(position, (3, 1))], axis=1)


def arc(count: int) -> list[np.ndarray]:
    """Cameras on an arc that look down a little, at different heights."""
    poses = []
    for k in range(count):
        angle = math.radians(-150.0 + 11.0 * k)
        position = 2.4 * math.cos(angle), 2.4 * math.sin(angle), 1.3 + 0.25 * math.sin(1.7 * k)
        poses.append(look_from(position, (0.0, 0.0, 0.6)))
    return poses


def distort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brown's model on the plane z = 1 (OpenCV's documentation, "Camera Calibration")."""
    k1, k2, p1, p2 = DISTORTION
    r2 = x * x + y * y
    radial = 1.0 + k1 * r2 + k2 * r2 * r2
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


@cache
def rays_of_lens() -> np.ndarray:
    """``[n, 3]`` directions of every sample of a picture with distortion, in the camera's axes."""
    columns = ((np.arange(WIDTH * OVER) + 0.5) / OVER - CX) / FOCAL
    rows = ((np.arange(HEIGHT * OVER) + 0.5) / OVER - CY) / FOCAL
    wanted = np.meshgrid(columns, rows)
    x, y = (side.copy() for side in wanted)
    for _ in range(30):  # a fixed point: the distortion is a contraction's worth of the identity
        dx, dy = distort(x, y)
        x, y = x + wanted[0] - dx, y + wanted[1] - dy
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)


def rays_of_pinhole(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """The same of a camera without distortion."""
    columns = ((np.arange(width * OVER) + 0.5) / OVER - cx) / fx
    rows = ((np.arange(height * OVER) + 0.5) / OVER - cy) / fy
    x, y = np.meshgrid(columns, rows)
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)


def _texture(seed: int, texels: int) -> np.ndarray:
    """``[texels, texels, 3]`` albedo with detail at every size."""
    random = np.random.default_rng(seed)
    albedo = np.full((texels, texels, 3), 0.45, np.float32)
    for size, strength in ((32, 0.2), (8, 0.25), (2, 0.35)):
        noise = random.uniform(-1.0, 1.0, (texels // size, texels // size, 3)).astype(np.float32)
        albedo += strength * noise.repeat(size, axis=0).repeat(size, axis=1)
    return np.clip(albedo, 0.03, 0.95)


#: Nothing repeats within the room: each texture is larger than its face, metres.
TILES = (6.4, 1.4, 1.4, 1.4)
TEXELS = (768, 256, 256, 256)


@cache
def textures() -> list[np.ndarray]:
    return [_texture(seed, TEXELS[seed // 6]) for seed in range(6 * len(BOXES))]


def albedo_at(texture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """``[n, 3]`` at ``places`` ``[n, 2]`` in texels, bilinear."""
    corner = np.floor(places).astype(np.int64)
    u, v = (places - corner).T[..., None]
    i, j = np.clip(corner, 0, len(texture) - 2).T
    upper = texture[i, j] * (1.0 - v) + texture[i, j + 1] * v
    lower = texture[i + 1, j] * (1.0 - v) + texture[i + 1, j + 1] * v
    return upper * (1.0 - u) + lower * u


def surfaces(position: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and albedos ``[n, 3]`` of what is seen from ``position`` in ``directions`` ``[n, 3]``."""
    nearest = np.full(len(directions), np.inf)
    face = np.zeros(len(directions), np.int64)
    along = np.ascontiguousarray(directions.T)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / along
    for number, (low, high) in enumerate(BOXES):
        first, second = ((np.array(end) - position)[:, None] * inverse for end in (low, high))
        entries, exits = np.minimum(first, second), np.maximum(first, second)
        # The room is seen from inside, what stands in it from outside.
        axis = exits.argmin(axis=0) if number == 0 else entries.argmax(axis=0)
        distance = np.choose(axis, exits if number == 0 else entries)
        hit = (exits.min(axis=0) > np.maximum(entries.max(axis=0), 0.0)) & (distance > 1e-6)
        hit &= distance < nearest
        nearest[hit] = distance[hit]
        face[hit] = (6 * number + 2 * axis + (np.choose(axis, along) > 0.0))[hit]
    places = position + directions * nearest[:, None]
    albedo = np.empty((len(directions), 3), np.float32)
    for one in np.unique(face):
        here, box, normal = face == one, one // 6, (one % 6) // 2
        across = [axis for axis in range(3) if axis != normal]
        plane = places[here][:, across] - np.array(BOXES[box][0])[across]
        albedo[here] = albedo_at(textures()[one], plane * (TEXELS[box] / TILES[box]))
    return places, albedo


def pictures(
    pose: np.ndarray, rays: np.ndarray, width: int, height: int, lamps: Sequence[tuple[float, float, float]]
) -> list[np.ndarray]:
    """``[height, width, 3]`` mean radiance over each pixel by each of the lamps alone."""
    places, albedo = surfaces(-pose[:, :3].T @ pose[:, 3], rays @ pose[:, :3])
    # From bright to dark over five stops.
    squares = [((np.array(lamp) - places) ** 2).sum(axis=1, keepdims=True) for lamp in lamps]
    seen = [albedo * 6.0 / (0.15 + square) for square in squares]
    return [one.reshape(height, OVER, width, OVER, 3).mean(axis=(1, 3)) for one in seen]


def picture(pose: np.ndarray, rays: np.ndarray, width: int, height: int) -> np.ndarray:
    """``[height, width, 3]`` mean radiance over each pixel by the lamp in the corner."""
    return pictures(pose, rays, width, height, [LAMP])[0]


@dataclass
class Capture:
    """What was photographed: poses ``[3, 4]`` world to camera, and the radiance of each."""

    poses: list[np.ndarray] = field(default_factory=list)
    radiance: list[np.ndarray] = field(default_factory=list)


def photograph(count: int) -> Capture:
    capture, rays = Capture(), rays_of_lens()
    for pose in arc(count):
        capture.poses.append(pose)
        capture.radiance.append(picture(pose, rays, WIDTH, HEIGHT))
    return capture


def codes(seen: np.ndarray, exposure: float) -> np.ndarray:
    return np.round(255.0 * response(exposure * seen)).astype(np.uint8)


def write_photo(
    path: Path,
    pixels: np.ndarray,
    seconds: float | None = None,
    taken: datetime | None = None,
    iso: int | None = None,
    f_number: float | None = None,
    **more: int,
) -> None:
    """A photo with what EXIF is asked for; ``more``: further tags by their EXIF names."""
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "Room"
    inner = exif.get_ifd(ExifTags.IFD.Exif)
    if seconds is not None:
        inner[ExifTags.Base.ExposureTime] = TiffImagePlugin.IFDRational(round(seconds * 1_000_000), 1_000_000)
    if taken is not None:
        inner[ExifTags.Base.DateTimeOriginal] = taken.strftime("%Y:%m:%d %H:%M:%S")
    if iso is not None:
        inner[ExifTags.Base.ISOSpeedRatings] = iso
    if f_number is not None:
        inner[ExifTags.Base.FNumber] = TiffImagePlugin.IFDRational(round(f_number * 10), 10)
    for name, value in more.items():
        (exif if name == "Orientation" else inner)[ExifTags.Base[name]] = value
    options = {"quality": 95, "subsampling": 0} if path.suffix == ".jpg" else {}
    Image.fromarray(pixels).save(path, exif=exif.tobytes(), **options)


def write_bracket(
    folder: Path, number: int, seen: np.ndarray, exposures: tuple[float, ...] = EXPOSURES
) -> None:
    """One place's photos; the camera's counter begins anew in each folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, seconds in enumerate(exposures):
        moment = MOMENT + timedelta(seconds=30 * number + 4 * k)
        path = folder / f"IMG_{len(exposures) * number + k:04d}.jpg"
        write_photo(path, codes(seen, seconds), seconds, moment, 100, 8.0)


def write_brackets(folder: Path, capture: Capture, order: tuple[int, ...] = (1, 0, 2)) -> None:
    """Photos as a camera names them, each bracket in automatic bracketing's order (0, −, +)."""
    folder.mkdir()
    moment, number = MOMENT, 9997  # the camera's counter runs over on the way
    for seen in capture.radiance:
        for k in order:
            pixels = codes(seen, EXPOSURES[k])
            path = folder / f"DSC_{number % 10000:04d}.jpg"
            write_photo(path, pixels, EXPOSURES[k], moment, iso=100, f_number=8.0)
            moment, number = moment + timedelta(seconds=1 + EXPOSURES[k]), number + 1
        moment += timedelta(seconds=20)
