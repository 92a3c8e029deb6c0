# SPDX-License-Identifier: GPL-3.0-or-later
"""Points by structure from motion where the cameras are known: COLMAP's features, matches, triangulation.

They are what a capture's points are: sparse, with outliers (false matches, reflections) and with gaps where
nothing has texture. Nothing is cleaned beyond what COLMAP's own filter does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plyfile
from PIL import Image

from ....bridge.atomic import atomic_path
from ....bridge.errors import PhysHDRError
from ....bridge.ply import open_ply
from ..points import STRUCTURE_FROM_MOTION
from ..scene import View
from .structure import MATCH_SIDE, SMALL_SIDE, StructureError, require_pycolmap, run_colmap

#: Each view is matched with so many whose cameras are nearest, for time grows with them. In a room of 18
#: views 8 neighbours gave 94 % of the points that all gave, 12 gave 99 %; denser captures have closer ones.
NEIGHBOURS = 24
#: Fewer points are no place to start from.
FEWEST_POINTS = 100
#: What the first comment of a PLY begins with that ``write_points`` has written.
MARK = f"{STRUCTURE_FROM_MOTION}: points triangulated by COLMAP"
REMEDY = (
    "Matches want training views that show the same textured things from several places, and poses that are "
    "right. Training finds points by stereo, too: --initial-points stereo."
)


@dataclass(frozen=True, eq=False)
class Triangulated:
    """Points: ``positions`` ``[P, 3]`` metres, ``colours`` ``[P, 3]`` uint8.

    ``errors`` ``[P]``: mean reprojection error, pixels. ``views`` ``[P]``: how many views see each.
    ``words``: how they were made.
    """

    positions: np.ndarray
    colours: np.ndarray
    errors: np.ndarray
    views: np.ndarray
    words: str


def triangulate(
    views: Sequence[View],
    exposures: Sequence[tuple[int, ...]],
    folder: Path,
    threads: int = -1,
    say: Callable[[str], None] = lambda step: None,
) -> Triangulated:
    """Points seen in ``views``, whose poses and cameras are taken as they are.

    ``exposures[i]``: positions in the bracket of ``views[i]`` of the pictures to use. Each step of the
    bracket is matched for itself: dark pictures have points where bright ones clip, and matches between them
    are wrong more often. Nothing is looked for where a picture is masked. Colours are those of each view's
    middle one. ``folder``: an empty one for what COLMAP writes. ``say`` is told each step.

    Raises ``StructureError`` where there are too few points or COLMAP fails, ``OutputError`` where the disk
    is full, and what reading pictures raises.
    """
    pycolmap = require_pycolmap("points are triangulated")
    if len(views) < 2:
        raise StructureError(f"there is no triangulation in {len(views)} training view", REMEDY)
    say("reading pictures")
    (folder / "pictures").mkdir()
    (folder / "masks").mkdir()
    pictures: list[dict] = []
    shown: list[tuple[int, int]] = []  # the view of each picture, and its step of the bracket
    for number, (view, allowed) in enumerate(zip(views, exposures, strict=True)):
        camera = view.camera
        for k in allowed:
            name = f"{number:05d}_{k}.png"
            Image.fromarray(view.shown(k)).save(folder / "pictures" / name, compress_level=1)
            if (keep := view.mask(k)) is not None:
                Image.fromarray(keep).convert("L").save(folder / "masks" / f"{name}.png")
            intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy]
            pose = camera.world_to_camera[:3].tolist()
            pictures.append({"name": name, "camera": intrinsics, "world_to_camera": pose})
            shown.append((number, view.bracket[k]))
    job = {
        "folder": str(folder),
        "pictures": pictures,
        "masks": str(folder / "masks") if _masked_or_whole(folder, pictures) else "",
        "pairs": [(pictures[a]["name"], pictures[b]["name"]) for a, b in _pairs(views, shown)],
        "longest_side": MATCH_SIDE,
        "small": max(max(view.camera.width, view.camera.height) for view in views) < SMALL_SIDE,
        "threads": threads,
    }
    run_colmap(job, folder, say, REMEDY, "set TMPDIR to a folder on another disk")
    with np.load(folder / "points.npz", allow_pickle=False) as found:
        positions, errors = found["positions"], found["errors"]
        observed, places = found["observed"], found["place"]
        seen_in = np.array([view for view, _ in shown])[found["picture"]]
    if len(positions) < FEWEST_POINTS:
        raise StructureError(
            f"COLMAP found {len(positions)} points in {len(pictures)} pictures of {len(views)} training "
            f"views, fewer than {FEWEST_POINTS}",
            REMEDY,
        )
    which = np.unique(np.stack([observed, seen_in]), axis=1)[0]
    return Triangulated(
        positions,
        _colours(views, exposures, observed, seen_in, places),
        errors,
        np.bincount(which, minlength=len(positions)),
        f"{pycolmap.__version__} from {len(pictures)} pictures of {len(views)} training views",
    )


def _masked_or_whole(folder: Path, pictures: Sequence[dict]) -> bool:
    """Whether any picture has a mask; all have one then, as COLMAP wants it."""
    if not any((folder / "masks").iterdir()):
        return False
    for name in (picture["name"] for picture in pictures):
        path = folder / "masks" / f"{name}.png"
        if not path.exists():
            with Image.open(folder / "pictures" / name) as picture:
                Image.new("L", picture.size, 255).save(path)
    return True


def _pairs(views: Sequence[View], shown: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Which pictures are matched: each with those of its own step of the bracket whose views are nearest."""
    centres = np.array([views[view].camera.position for view, _ in shown])
    steps = np.array([step for _, step in shown])
    pairs = set()
    for one in range(len(shown)):
        others = np.flatnonzero(steps == steps[one])
        others = others[others != one]
        near = np.argsort(np.linalg.norm(centres[others] - centres[one], axis=1), kind="stable")[:NEIGHBOURS]
        pairs |= {(min(one, other), max(one, other)) for other in others[near].tolist()}
    return sorted(pairs)


def _colours(
    views: Sequence[View],
    exposures: Sequence[tuple[int, ...]],
    observed: np.ndarray,
    seen_in: np.ndarray,
    places: np.ndarray,
) -> np.ndarray:
    """``[P, 3]`` uint8: the mean over all observations of each point, in the middle exposure of each view."""
    total = np.zeros((observed.max() + 1, 3))
    for number in np.unique(seen_in):
        here = seen_in == number
        allowed = exposures[number]
        picture = views[number].shown(allowed[len(allowed) // 2])
        column, row = np.floor(places[here]).astype(int).T
        height, width = picture.shape[:2]
        codes = picture[row.clip(0, height - 1), column.clip(0, width - 1)]
        np.add.at(total, observed[here], codes)
    return np.round(total / np.bincount(observed)[:, None]).astype(np.uint8)


# ---- the file ------------------------------------------------------------------------------------------


def write_points(path: Path, points: Triangulated) -> None:
    """A PLY of ``x y z``, ``nx ny nz``, ``red green blue``, ``error`` (pixels) and ``views``.

    Normals are 0, as 3DGS writes them of COLMAP's points: its loader fails where there are none.
    Raises ``OutputError``.
    """
    columns = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    columns += [(name, "u1") for name in ("red", "green", "blue")]
    table = np.zeros(len(points.positions), np.dtype([*columns, ("error", "<f4"), ("views", "<u2")]))
    table["x"], table["y"], table["z"] = points.positions.T
    table["red"], table["green"], table["blue"] = points.colours.T
    table["error"], table["views"] = points.errors, points.views
    comments = [
        f"{MARK} {points.words}, PhysHDR",
        "error: mean reprojection error, pixels; views: how many see the point",
    ]
    element = plyfile.PlyElement.describe(table, "vertex")
    with atomic_path(path) as temporary:
        plyfile.PlyData([element], byte_order="<", comments=comments).write(str(temporary))


def is_ours(path: Path) -> bool:
    """Whether ``write_points`` has written the file at ``path``."""
    try:
        return any(comment.startswith(MARK) for comment in open_ply(path, "point cloud", "").comments)
    except PhysHDRError:
        return False
