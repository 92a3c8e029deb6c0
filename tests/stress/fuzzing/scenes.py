# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets of every layout, given to every reader of them."""

import contextlib
import io
import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from physhdr.bridge.errors import PhysHDRError

from .cases import InsaneError, Target
from .mutate import tests_module

#: No camera has more pixels on a side.
SIDE_MAX = 1 << 16


def own(folder: Path) -> None:
    small = tests_module("backend/scene/small_data_set.py")
    small.write_data_set(folder / "one-light")
    small.write_data_set(folder / "original", original=True)


def two_lights(folder: Path) -> None:
    tiny = tests_module("backend/tiny_scene.py")
    tiny.write_tiny_scene(folder / "two-lights", size=16, gaussians=8, lights=("ambient", "pendant"))


def all_own(folder: Path) -> None:
    own(folder)
    two_lights(folder)


def layout(writer: str, **options: Any) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        getattr(tests_module("backend/scene/layouts.py"), writer)(folder / "data", **options)

    return write


def colmap(folder: Path) -> None:
    layouts = tests_module("backend/scene/layouts.py")
    layouts.write_colmap(folder / "binary", poses=5)
    layouts.write_colmap(folder / "text", poses=5, form="txt")


def nerfstudio(folder: Path) -> None:
    layouts = tests_module("backend/scene/layouts.py")
    layouts.write_nerfstudio(folder / "data")
    root = layouts.write_nerfstudio(folder / "points", ply_file_path="points.ply")
    tests_module("backend/scene/small_data_set.py").write_points(root / "points.ply")
    _brackets(folder)


def _brackets(folder: Path) -> None:
    """What ``physhdr prepare --layout nerfstudio --brackets`` writes."""
    from physhdr.backend.scene import read_scene
    from physhdr.backend.scene.for_others import How, lay_out

    with tempfile.TemporaryDirectory() as scratch:
        own(Path(scratch))
        scene = read_scene(Path(scratch) / "one-light")
        (folder / "brackets").mkdir()
        lay_out(scene, folder / "brackets", How(layout="nerfstudio", brackets=True))


def read(folder: Path, file: str, _: bytes) -> None:
    """Read the scene, and the picture that was changed; all numbers must be ones."""
    from physhdr.backend.scene import read_scene

    scene = read_scene(folder)
    views = [view for views in scene.splits.values() for view in views]
    _require(bool(scene.train), "a scene without training views")
    for view in views:
        camera = view.camera
        _require(0 < camera.width <= SIDE_MAX and 0 < camera.height <= SIDE_MAX, "a camera's size")
        _require(camera.fx > 0 and camera.fy > 0, "a focal length of 0 or less")
        numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *view.exposures, *view.lighting_levels)
        _require(all(map(math.isfinite, numbers)), "a camera, an exposure or a level is not finite")
        _require(bool(np.isfinite(camera.camera_to_world).all()), "a pose is not finite")
        _require(abs(np.linalg.det(camera.camera_to_world[:3, :3]) - 1.0) < 0.01, "a pose is a mirror")
        _require(min(view.exposures) > 0.0, "an exposure of 0 or less")
        _require(min(view.lighting_levels) >= 0.0, "a level below 0")
        _require(len(view.lighting_levels) == len(scene.lights), "levels of other lights")
        for path in view.image_paths:
            _require(path.is_relative_to(folder), "a picture outside of the folder")
    if scene.points is not None:
        _require(bool(np.isfinite(scene.points.positions).all()), "a point is not finite")
        _require(bool(np.isfinite(scene.points.colours).all()), "a colour is not finite")
    if scene.response_anchor is not None:
        x, code = scene.response_anchor
        _require(math.isfinite(x) and x > 0.0 and 0.0 <= code <= 1.0, "the response's anchor")
    _printable("\n".join((scene.name, *scene.lights, *scene.messages, *(view.name for view in views))))
    changed = folder / file
    shown = [(view, view.image_paths.index(changed)) for view in views if changed in view.image_paths]
    view, k = shown[0] if shown else (views[0], 0)
    picture = view.image(k)
    _require(picture.shape == (view.camera.height, view.camera.width, 3), "a picture of another size")


def truth(folder: Path, file: str, _: bytes) -> None:
    """What evaluation reads besides."""
    from physhdr.backend.evaluate.truth import has_hdr_truth, hdr_truth, relit_truth

    for relit in relit_truth(folder):
        _require(all(math.isfinite(x) and x >= 0.0 for x in relit.levels.values()), "a relit level")
        _require(relit.path.is_relative_to(folder), "a picture outside of the folder")
        _printable(relit.condition)
        if relit.path == folder / file:
            _require(bool(relit.radiance().isfinite().all()), "true radiance is not finite")
    for split in ("train", "test", "lit"):
        if has_hdr_truth(folder, split) and file.startswith(f"{split}_hdr"):
            index = int("".join(c for c in Path(file).stem if c.isdigit()))
            _require(bool(hdr_truth(folder, split, index).isfinite().all()), "true radiance is not finite")


def inspect(folder: Path, _: str, __: bytes) -> None:
    """``physhdr inspect``, as people and as programs get it: all faults in one error."""
    from physhdr.backend.cli.inspect import Inspect
    from physhdr.backend.runs.terminal import console

    for as_json in (True, False):
        output = io.BytesIO()
        printed = io.TextIOWrapper(output, encoding="utf-8")
        with contextlib.redirect_stdout(printed):
            before, console.file = console.file, printed
            refused = None
            try:
                Inspect(folders=(folder,), json=as_json).run()
            except PhysHDRError as error:
                refused = error
            finally:
                console.file = before
        printed.flush()
        if as_json:
            if not output.getvalue().startswith(b"{"):
                raise InsaneError(f"inspect --json: no object but {output.getvalue()[:200]!r}: {refused}")
            found = json.loads(output.getvalue().splitlines()[0])["found"]
            _require(found["folder"] == str(folder), "the JSON of physhdr inspect")
    if refused is not None:
        raise refused


def summarise(folder: Path, _: str, __: bytes) -> None:
    """What Blender's panel shows."""
    from physhdr.addon.layouts.summary import summarise

    summary = summarise(folder)
    _printable("\n".join((*summary.lines, *summary.warnings)))
    numbers = (*summary.evs, *summary.levels, *summary.relit_levels, summary.stops or 0.0)
    _require(all(map(math.isfinite, numbers)), "a number that a panel shows is not finite")


def pose(folder: Path, file: str, _: bytes) -> None:
    """A camera for Blender."""
    from physhdr.addon.layouts.cameras import read_pose

    found = read_pose(folder / "transforms_train.json", 1)
    _require(bool(np.isfinite(found.camera_to_world).all()), "a pose is not finite")
    _require(0.0 < found.angle_x < math.pi, "an angle")
    _printable(found.name)


def camera_list(folder: Path) -> None:
    from physhdr.bridge.camera_list import ListedCamera, write_camera_list

    listed = [
        ListedCamera(f"train_{index:03d}", turned, 64, 48, 50.0, 51.0, 32.0, 24.0, is_learned=index % 2 == 0)
        for index, turned in enumerate((np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0]), np.eye(4)))
    ]
    (folder / "run").mkdir(parents=True)
    write_camera_list(folder / "run" / "cameras.json", listed)


def learned_poses(folder: Path, file: str, _: bytes) -> None:
    """A run's cameras for Blender."""
    from physhdr.bridge.camera_list import read_learned_poses

    for name, found in read_learned_poses(folder / file).items():
        _require(bool(np.isfinite(found).all()), "a pose is not finite")
        _require(bool(np.linalg.det(found[:3, :3]) > 0.9), "a rotation is none")
        _printable(name)


def paths(_: Path, __: str, content: bytes) -> None:
    """Camera paths among any cameras that a reader would accept."""
    from scipy.spatial.transform import Rotation

    from physhdr.backend.evaluate.camera_path import orbit_path, spline_path
    from physhdr.backend.scene.camera import Camera

    poses = np.frombuffer(content[: len(content) // 48 * 48], "<f8").reshape(-1, 6)
    poses = poses[np.isfinite(poses).all(axis=1) & (np.abs(poses) < 1e6).all(axis=1)]
    cameras = []
    for row in poses[:40]:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = Rotation.from_rotvec(row[3:]).as_matrix(), row[:3]
        cameras.append(Camera(matrix, 8, 8, 8.0, 8.0, 4.0, 4.0))
    for found in (spline_path(cameras, 7), spline_path(cameras, 7, closed=True), orbit_path(cameras, 7)):
        _require(len(found) == 7, "the number of frames")
        for camera in found:  # Camera itself refuses what is no rotation
            _require(bool(np.isfinite(camera.camera_to_world).all()), "a pose is not finite")


def _write_paths(folder: Path) -> None:
    rng = np.random.default_rng(0)
    some = rng.normal(size=(6, 6))
    variants = {
        "ring": some,
        "same": np.repeat(some[:1], 4, axis=0),
        "one": some[:1],
        "line": np.concatenate([np.arange(5.0)[:, None] * some[:1, :3], np.zeros((5, 3))], axis=1),
        "opposite": np.array([[0, 0, 0, 0, 0, 0], [0, 0, 0, 0, np.pi, 0], [1, 0, 0, 0, -np.pi, 0]], float),
    }
    for name, poses in variants.items():
        (folder / name).mkdir(parents=True)
        (folder / name / "poses.f8").write_bytes(poses.astype("<f8").tobytes())


def _require(right: bool, what: str) -> None:
    if not right:
        raise InsaneError(f"accepted though wrong is {what}")


def _printable(text: str) -> None:
    """What cannot be encoded ends the command that prints it."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise InsaneError(f"text that cannot be printed: {error}") from error


TARGETS = (
    Target("data set: own", all_own, read, 2000),
    Target("data set: truth", all_own, truth, 600, chosen=("dataset.json", "*_hdr/*", "relit/*")),
    Target("data set: inspect", all_own, inspect, 500, names_place=False),
    Target("data set: panel", all_own, summarise, 1000),
    Target("data set: HDR-NeRF-Syn", layout("write_syn"), read, 800),
    Target("data set: HDR-NeRF-Real", layout("write_real", scale=1.0), read, 500),
    Target("data set: GaussHDR", layout("write_gausshdr"), read, 800),
    Target("data set: HDR-GS", layout("write_hdr_gs", poses=6), read, 600),
    Target("data set: NeRF", layout("write_nerf"), read, 800),
    Target("data set: COLMAP", colmap, read, 1000),
    Target("data set: nerfstudio", nerfstudio, read, 1000),
    Target("camera file", own, pose, 600, chosen=("transforms_train.json",)),
    Target("cameras of a run", camera_list, learned_poses, 600),
    Target("camera paths", _write_paths, paths, 400, in_memory=True, names_place=False),
)
