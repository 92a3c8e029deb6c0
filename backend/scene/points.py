# SPDX-License-Identifier: GPL-3.0-or-later
"""First points from a PLY, as structure from motion or our own renders give them."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plyfile

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ...bridge.limits import COORDINATE
from ...bridge.ply import open_ply
from ...bridge.regular import damaged_where_it_fails
from .scene import Points, Scene

EXACT = "exact ray hits"
STRUCTURE_FROM_MOTION = "structure from motion"
#: What a comment of a PLY begins with → the kind of its points. The first is what ``synth/points.py`` writes.
ORIGINS = {"surface points by ray casting": EXACT, STRUCTURE_FROM_MOTION: STRUCTURE_FROM_MOTION}
#: The share of points that may be out of bounds.
STRAYS = 0.01
#: Colours as floats are within 0…1, or a little beyond; where they reach this, they are bytes made floats.
BYTES_AS_FLOATS = 2.0


def read_points(path: Path) -> Points:
    """The points of a PLY with ``x y z`` and ``red green blue``, and their kind.

    Colours are of 8 or 16 bits, or floats in 0…1, or in 0…255 where they are beyond ``BYTES_AS_FLOATS``.

    Raises ``FileMissingError``, ``FileDamagedError`` (not a PLY, truncated, columns missing, no points, NaN),
    ``BadValueError`` (too many points too far away).
    """
    remedy = (
        "Make the data set again, write the points as docs/formats.md says, or delete the file: training "
        "then starts from points that stereo finds."
    )
    ply = open_ply(path, "point cloud", remedy)
    columns = ply.elements
    wanted = ("x", "y", "z", "red", "green", "blue")
    lacking = (
        [name for name in wanted if name not in (columns["vertex"].dtype.names or ())]
        if "vertex" in columns
        else ["vertex"]
    )
    if lacking:
        raise FileDamagedError(f"{path} is not a readable point cloud (no {', '.join(lacking)})", remedy)
    vertex = columns["vertex"]
    with damaged_where_it_fails(f"{path} is not a readable point cloud", remedy), np.errstate(over="ignore"):
        positions = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=-1)
        colours = _unit_colours([np.asarray(vertex[name]) for name in ("red", "green", "blue")])
    if len(positions) == 0:
        raise FileDamagedError(f"{path} holds no points", remedy)
    if not (np.isfinite(positions).all() and np.isfinite(colours).all()):
        raise FileDamagedError(f"{path} holds NaN or infinity", remedy)
    near = are_near(path, positions)
    return Points(
        positions[near].astype(np.float32),
        np.clip(colours[near], 0.0, 1.0),
        _origin(ply.comments),
        ignored=int(np.count_nonzero(~near)),
    )


def write_points(path: Path, points: Points) -> None:
    """Write the PLY that ``read_points`` reads, colours as bytes; the kind is in a comment.

    Normals are 0: loaders of the 3DGS lineage fail where there are none. Raises ``OutputError``.
    """
    columns = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    table = np.zeros(
        len(points.positions), np.dtype([*columns, *((name, "u1") for name in ("red", "green", "blue"))])
    )
    table["x"], table["y"], table["z"] = points.positions.T
    table["red"], table["green"], table["blue"] = np.rint(255.0 * points.colours).astype(np.uint8).T
    comments = [mark for mark, kind in ORIGINS.items() if kind == points.origin]
    element = plyfile.PlyElement.describe(table, "vertex")
    with atomic_path(path) as temporary:
        plyfile.PlyData([element], byte_order="<", comments=comments).write(str(temporary))


def _origin(comments: Iterable[str]) -> str:
    """The kind of points that a PLY's comments state; empty where they state none that is known."""
    kinds = (kind for comment in comments for mark, kind in ORIGINS.items() if comment.startswith(mark))
    return next(kinds, "")


def with_points_file(scene: Scene, name: str | None) -> Scene:
    """``scene`` with the points of a PLY in place of its own; None: as it is.

    ``name``: of a file in the data set's folder, or an absolute path. Raises ``FileMissingError`` with the
    remedy, and what ``read_points`` raises.
    """
    if name is None:
        return scene
    path = scene.root / name  # an absolute path stays what it is
    if not path.is_file():
        remedy = f"Make points by structure from motion: physhdr prepare {scene.root} --triangulate"
        if (here := Path(name)).is_file():
            remedy = f"Names are of files in the data set's folder; of others give all: {here.absolute()}"
        raise FileMissingError(f"there is no {path}, which --points-file names", remedy)
    points = dataclasses.replace(read_points(path), file=name)
    return with_point_message(dataclasses.replace(scene, points=points))


def are_near(path: Path, positions: np.ndarray) -> np.ndarray:
    """``[P]`` bool: which of ``positions`` ``[P, 3]``, finite, are within the bounds of coordinates.

    Structure from motion leaves a few points that two rays hardly tell from infinity: they are ignored.
    Raises ``BadValueError`` where they are more than ``STRAYS``: then the world itself is too far away.
    """
    near = np.abs(positions).max(axis=1, initial=0.0) <= COORDINATE.high
    far = np.flatnonzero(~near)
    if len(far) > STRAYS * len(positions):
        x, y, z = positions[far[0]].tolist()
        raise BadValueError(
            f"{path}: {len(far)} of {len(positions)} points are too far away, the first, {far[0]}, at "
            f"({x:g}, {y:g}, {z:g}): coordinates must be {COORDINATE} metres",
            f"{COORDINATE.remedy} Single points that far away are mistakes: delete them.",
        )
    return near


def with_point_message(scene: Scene) -> Scene:
    """The scene with a message on its points that were ignored."""
    if scene.points is None or not scene.points.ignored:
        return scene
    far, all_of_them = scene.points.ignored, scene.points.ignored + len(scene.points.positions)
    message = f"ignoring {far} of {all_of_them} points: farther away than {COORDINATE.high:g}"
    return dataclasses.replace(scene, messages=(*scene.messages, message))


def _unit_colours(channels: Sequence[np.ndarray]) -> np.ndarray:
    """``[P, 3]`` float32 of three channels of a PLY; 1 is the largest code of integers."""
    units = [_largest_code(channel.dtype) for channel in channels]
    colours = np.stack([channel / unit for channel, unit in zip(channels, units, strict=True)], axis=-1)
    if set(units) == {1.0} and np.fmax.reduce(colours, axis=None, initial=0.0) >= BYTES_AS_FLOATS:
        colours = colours / 255.0
    return colours.astype(np.float32)


def _largest_code(kind: np.dtype[Any]) -> float:
    """What stands for 1 in a column of colours, as in PLYs of Gaussians: 1 itself in floats."""
    return 1.0 if kind.kind == "f" else 65535.0 if (kind.kind, kind.itemsize) == ("u", 2) else 255.0
