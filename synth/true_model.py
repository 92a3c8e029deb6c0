# SPDX-License-Identifier: GPL-3.0-or-later
"""The true cameras of a capture as COLMAP's text files (colmap.github.io, "Output Format").

What ``physhdr prepare --poses`` takes instead of a reconstruction. Points are drawn from the depth that was
rendered, and each lists only the place that it was drawn from. COLMAP's cameras look along +z, with y
downward; the world is Blender's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..bridge.affine import quaternion_of
from . import folder
from .capture import Place
from .lens import COEFFICIENTS, Lens
from .passes import SKY, Passes

#: Points of all places together, about as many as structure from motion finds.
POINTS = 18_000
#: Blender's camera axes (y up, z backward) in COLMAP's.
AXES = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class VisiblePoints:
    """Points that one place sees: where in its picture and in the world [M, 3], and their colours (uint8)."""

    pixels: np.ndarray
    positions: np.ndarray
    colours: np.ndarray


def visible_points(
    place: Place, passes: Passes, picture: np.ndarray, lens: Lens, count: int, seed: int
) -> VisiblePoints:
    """``count`` random points at most; none in the sky. ``picture``: [H, W, 3] uint8, what they look like."""
    dice = np.random.default_rng([seed, 0x901, place.index])
    chosen = dice.permutation(np.flatnonzero(passes.depth.ravel() < SKY))[:count]
    y, x = np.divmod(chosen, lens.width)
    pixels = np.stack([x, y], -1) + 0.5
    rays = lens.directions(pixels)
    in_camera = rays * (passes.depth[y, x] / rays[:, 2])[:, None] * AXES
    positions = in_camera @ place.pose[:3, :3].T + place.pose[:3, 3]
    return VisiblePoints(pixels, positions, picture[y, x])


def write(root: Path, lens: Lens, views: Sequence[tuple[str, Place, VisiblePoints]]) -> None:
    """``sparse/0`` in ``root``; ``views``: a picture's name of each place, and what is seen there."""
    lens_numbers = lens.describe()
    numbers = [lens_numbers[name] for name in ("fl_x", "fl_y", "cx", "cy", *COEFFICIENTS[lens.model])]
    camera = f"1 {lens.model} {lens.width} {lens.height} {_spaced(numbers)}\n"
    images, points, number = [], [], 0
    for image, (name, place, points_seen) in enumerate(views, 1):
        turn = (place.pose[:3, :3] * AXES).T
        shift = -turn @ place.pose[:3, 3]
        images.append(f"{image} {_spaced([*quaternion_of(turn), *shift])} 1 {name}")
        entries = []
        for k in range(len(points_seen.pixels)):
            number += 1
            entries.append(f"{_spaced(points_seen.pixels[k])} {number}")
            colour = " ".join(map(str, points_seen.colours[k].tolist()))
            points.append(f"{number} {_spaced(points_seen.positions[k])} {colour} 0 {image} {k}")
        images.append(" ".join(entries))
    target = root / "sparse" / "0"
    for name, lines in (("cameras", [camera.strip()]), ("images", images), ("points3D", points)):
        folder.write(target / f"{name}.txt", ("\n".join(lines) + "\n").encode("ascii"))


def _spaced(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
