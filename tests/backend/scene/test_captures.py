# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures as people have them: missing pictures, pictures on their side, several cameras, masks."""

import json
import os
import shutil
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from PIL import Image

from physhdr.backend.scene import Scene, read_scene
from physhdr.backend.scene.resize import Reduction
from physhdr.bridge.errors import BadValueError, DataMismatchError, FileMissingError

#: What a phone's camera was found to be by COLMAP, at a quarter of 1080×1920, and a picture of a board by it.
WIDTH, HEIGHT, FX, FY, CX, CY = 270, 480, 343.9, 343.6, 138.6, 241.3
DISTORTION = (0.0578, -0.0805, -0.00098, 0.00016)
#: The board's corners, in steps of ¼ m: a plane in front of the cameras.
STEP, COLUMNS, ROWS = 0.25, 7, 11


def corners() -> np.ndarray:
    """``[COLUMNS · ROWS, 3]``: places of the world."""
    x, z = np.meshgrid(np.arange(COLUMNS) - COLUMNS // 2, np.arange(ROWS) - ROWS // 2)
    return STEP * np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1).astype(float)


def pose(k: int) -> tuple[np.ndarray, np.ndarray]:
    """R and t of camera ``k`` of a walk along the board, OpenCV axes."""
    centre = np.array([-0.5 + 0.06 * k, -3.2, 0.05 * np.sin(k)])
    forward = np.array([0.2, 0.0, 0.1]) * (k % 3 - 1) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.05, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ centre


def photo(k: int) -> np.ndarray:
    """``[H, W, 3]`` uint8 of a chessboard that fades out, through the lens as OpenCV undoes it."""
    rotation, translation = pose(k)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
    places = np.stack([x.ravel(), y.ravel()], axis=1)[:, None]
    seen = cv2.undistortPoints(places, K, np.array(DISTORTION), R=np.eye(3), P=np.eye(3), criteria=criteria)
    rays = np.concatenate([seen[:, 0], np.ones((len(seen), 1))], axis=1) @ rotation
    centre = -rotation.T @ translation
    u, _, w = (centre + rays * (-centre[1] / rays[:, 1:2])).T
    board = np.tanh(8.0 * np.sin(np.pi * u / STEP)) * np.tanh(8.0 * np.sin(np.pi * w / STEP))
    codes = 128.0 + 100.0 * board * np.exp(-((u / 1.5) ** 2) - (w / 2.0) ** 2)
    return np.repeat(np.round(codes).reshape(HEIGHT, WIDTH, 1), 3, axis=2).astype(np.uint8)


def write_fox(root: Path, listed: int = 24, without: tuple[int, ...] = (3, 7, 9, 13, 22), **top) -> Path:
    """A capture as instant-ngp publishes its example: frames without pictures, and k1, k2, p1, p2."""
    frames = []
    for k in range(listed):
        rotation, translation = pose(k)
        right, down, forward = rotation
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, -down, -forward, -rotation.T @ translation], axis=1)
        name = f"images/{k + 1:04d}.jpg"
        frames.append({"file_path": name, "sharpness": 20.0 + k, "transform_matrix": matrix.tolist()})
        if k not in without:
            (root / "images").mkdir(parents=True, exist_ok=True)
            Image.fromarray(photo(k)).save(root / name, quality=97, subsampling=0)
    content = {"camera_angle_x": 0.75, "camera_angle_y": 1.2, "fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY}
    content |= dict(zip(("k1", "k2", "p1", "p2"), DISTORTION, strict=True))
    content |= {
        "w": float(WIDTH),
        "h": float(HEIGHT),
        "aabb_scale": 4,
        "scale": 0.33,
        "offset": [0.5, 0.5, 0.5],
    }
    (root / "transforms.json").write_text(json.dumps(content | top | {"frames": frames}))
    return root


def found_corners(scene: Scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each view the board's inner corners as OpenCV finds them, and where the view's camera has them."""
    pairs = []
    for view, k in scene.pictures():
        camera = view.camera
        x, y, z, _ = camera.world_to_camera @ np.c_[corners(), np.ones(len(corners()))].T
        expected = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        inside = ((expected > 12.0) & (expected < (camera.width - 12.0, camera.height - 12.0))).all(axis=1)
        start = np.ascontiguousarray((expected[inside] - 0.5 + 0.7).astype(np.float32))
        criteria = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        grey = np.ascontiguousarray(view.image(k)[..., 0])
        found = cv2.cornerSubPix(grey, start, (5, 5), (-1, -1), criteria) + 0.5
        pairs.append((found.astype(float), expected[inside]))
    return pairs


@pytest.fixture(scope="module")
def fox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fox(tmp_path_factory.mktemp("fox"))


def test_a_published_capture_is_read_as_it_is(fox: Path) -> None:
    scene = read_scene(fox)
    assert "5 of 24 frames have no picture: skipped (first: images/0004.jpg)" in scene.messages
    assert any("the distortion of the lens OPENCV" in message for message in scene.messages)
    assert len(scene.train) + len(scene.test) == 19
    # Numbers are places among all that are listed; the ends of the walk are trained.
    assert {0, 23} <= {view.index for view in scene.train} and len(scene.test) == 2
    pairs = found_corners(scene)
    assert sum(len(found) for found, _ in pairs) > 19 * 50
    for found, expected in pairs:
        distance = np.linalg.norm(found - expected, axis=1)
        assert np.median(distance) < 0.08 and distance.max() < 0.12


def test_lines_of_the_board_are_straight(fox: Path) -> None:
    """A column of corners against the line through them; in the photo as it is they are half a pixel off."""
    scene = read_scene(fox)
    _, expected = found_corners(scene)[0]
    found = found_corners(scene)[0][0]
    rows = np.unique(np.round(expected[:, 1] / 20.0))
    assert len(rows) > 4
    for u in np.unique(np.round(expected[:, 0] / 15.0)):
        line = found[np.round(expected[:, 0] / 15.0) == u]
        if len(line) < 6:
            continue
        fit = np.polyfit(line[:, 1], line[:, 0], 1)
        assert np.abs(np.polyval(fit, line[:, 1]) - line[:, 0]).max() < 0.1


def test_fewer_than_half_of_the_pictures_are_too_few(tmp_path: Path) -> None:
    root = write_fox(tmp_path, 8, (0, 1, 2, 3))
    read_scene(root)
    (root / "images" / "0005.jpg").unlink()
    with pytest.raises(FileMissingError, match=r"5 of 8 frames have no picture that can be used"):
        read_scene(root)


def test_a_picture_whose_header_is_damaged_is_named_and_skipped(tmp_path: Path) -> None:
    root = write_fox(tmp_path, 8, ())
    (root / "images" / "0003.jpg").write_bytes(b"\xff\xd8\xff nothing more")
    scene = read_scene(root)
    (told,) = (message for message in scene.messages if "skipped" in message)
    assert told.startswith("1 of 8 frames have a picture that cannot be read: skipped (first: ")
    assert "0003.jpg" in told and len(scene.train) + len(scene.test) == 7


def test_pictures_of_a_model_that_are_missing_are_skipped(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=6)
    for name in ("shot_02_0.jpg", "shot_02_1.jpg", "shot_02_2.jpg", "shot_04_1.jpg"):
        (root / "images" / name).unlink()
    scene = read_scene(root)
    assert "2 of 16 pictures of the model have no picture: skipped (first: shot_02_1.jpg)" in scene.messages
    views = {view.name: view.bracket for view in [*scene.train, *scene.test]}
    assert "shot_02" not in views and views["shot_04"] == (0, 2) and views["shot_05"] == (0, 1, 2)


def test_pictures_that_the_model_does_not_have_are_counted(layouts: ModuleType, tmp_path: Path) -> None:
    """COLMAP has placed four of seven poses; a thumbnail of macOS and a text are no pictures."""
    root = layouts.write_colmap(tmp_path / "data", poses=4)
    for i in range(4, 7):
        for k in range(3):
            layouts.save(root / f"images/more/shot_{i:02d}_{k}.jpg", layouts.draw(i, k))
    (root / "images" / "._shot_00_0.jpg").write_bytes(b"")
    (root / "images" / "notes.txt").write_text("clouds came")
    scene = read_scene(root)
    assert (
        "9 of 21 pictures in images/ are not used: the model lacks them (first: more/shot_04_0.jpg)"
    ) in scene.messages
    assert not any(
        "are not used" in told for told in read_scene(layouts.write_colmap(tmp_path / "b")).messages
    )


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_of_several_models_the_largest_is_read(layouts: ModuleType, tmp_path: Path, form: str) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=9)
    images = {f"shot_{i:02d}_1.jpg": i for i in range(9)}
    for folder, some in (("0", list(images)[:3]), ("1", list(images)[3:]), ("10", list(images)[:3])):
        shutil.rmtree(root / "sparse" / folder, ignore_errors=True)
        layouts.write_sparse(root / "sparse" / folder, {name: images[name] for name in some}, form)
    scene = read_scene(root)
    names = [view.name for view in (*scene.train, *scene.test)]
    assert sorted(names) == [f"shot_{i:02d}" for i in range(3, 9)]
    (told,) = (message for message in scene.messages if "sparse/" in message)
    assert told.startswith(
        "sparse/1, which has the most pictures (6), is used, and not sparse/0 of 3, sparse/10 of 3"
    )
    shutil.rmtree(root / "sparse" / "1")
    assert {view.name for view in read_scene(root).train} <= {f"shot_{i:02d}" for i in range(3)}
    (root / "sparse" / "10" / f"images.{form}").write_bytes(b"\xff" * 6)  # what is damaged is not the largest
    assert read_scene(root).train[0].name == "shot_00"


@pytest.mark.parametrize("lacks", ["exposure time", "ISO"])
def test_pictures_of_unknown_exposure_are_skipped(layouts: ModuleType, tmp_path: Path, lacks: str) -> None:
    """One of a bracket, and one that is all of its bracket; a messenger has taken away what they told."""
    root = layouts.write_colmap(tmp_path / "data")
    for k in (0, 2):
        (root / f"images/shot_07_{k}.jpg").unlink()
    exif = layouts.camera_exif(0.5, None) if lacks == "ISO" else None
    for i, k in ((3, 2), (7, 1)):
        layouts.save(root / f"images/shot_{i:02d}_{k}.jpg", layouts.draw(i, k), exif=exif)
    scene = read_scene(root)
    views = {view.name: view.bracket for view in (*scene.train, *scene.test)}
    everything = {f"shot_{i:02d}": (0, 1, 2) for i in range(10) if i != 7}
    assert views == everything | {"shot_03": (0, 1)}
    (told,) = (message for message in scene.messages if message.startswith("exposures from EXIF"))
    assert "skipping 2 of 28 pictures without an exposure (first: " in told
    assert f"shot_03_2.jpg has no {lacks} in its EXIF data" in told
    assert not any("not used" in message for message in scene.messages)


def test_a_frame_of_unknown_exposure_is_skipped(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_nerfstudio(tmp_path, poses=8)
    content = json.loads((root / "transforms.json").read_text())
    for i, frame in enumerate(content["frames"]):
        frame["file_path"] = f"images/{i}.jpg"
        exif = None if i == 2 else layouts.camera_exif(0.1 + i)
        layouts.save(root / frame["file_path"], layouts.draw(i, 0), exif=exif)
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    assert sorted(view.index for view in (*scene.train, *scene.test)) == [0, 1, 3, 4, 5, 6, 7]
    assert any("skipping 1 of 8 pictures without an exposure" in message for message in scene.messages)


def test_a_pose_that_the_exposure_file_leaves_out_is_skipped(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=5, exif=False)
    seconds = {f"shot_{i:02d}_{k}.jpg": 3.0**k for i in range(5) for k in range(3) if i != 3}
    (root / "exposure.json").write_text(json.dumps(seconds))
    scene = read_scene(root)
    assert {view.name[-2:] for view in (*scene.train, *scene.test)} == {"00", "01", "02", "04"}
    assert (
        "exposure.json has no exposure for 1 of 5 poses: skipped (first: shot_03_0.jpg)"
    ) in scene.messages
    published = layouts.write_hdr_gs(tmp_path / "gs")  # whose split counts poses: one less would shift it
    seconds = json.loads((published / "exposure.json").read_text())
    left = {name: value for name, value in seconds.items() if not name.startswith("3_")}
    (published / "exposure.json").write_text(json.dumps(left))
    with pytest.raises(DataMismatchError, match=r"no exposure for '3_0\.png'"):
        read_scene(published)


# ---- pictures under other names than those that are told -----------------------------------------------


def assert_spots(layouts: ModuleType, scene: Scene) -> None:
    """Cameras and pictures belong together: the world's points are where their spots are."""
    for view, k in scene.pictures():
        camera = view.camera
        x, y, z, _ = camera.world_to_camera @ np.c_[layouts.POINTS, np.ones(3)].T
        expected = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        np.testing.assert_allclose(layouts.spots(view.image(k), view.bracket[k]), expected, atol=0.06)


def test_a_model_whose_pictures_are_kept_reduced_alone(layouts: ModuleType, tmp_path: Path) -> None:
    """images_4/ of what COLMAP has seen four times as large, as Mip-NeRF 360 is often copied; and more."""
    W, H = 4 * layouts.WIDTH, 4 * layouts.HEIGHT
    params = tuple(4.0 * value for value in (layouts.FX, layouts.FY, layouts.CX, layouts.CY))
    root = layouts.write_colmap(tmp_path / "data", params=params, size=(W, H))
    (root / "images").rename(root / "images_4")
    (root / "images_8").mkdir()
    (root / "images_low").mkdir()
    scene = read_scene(root)
    assert len(scene.train) + len(scene.test) == 10 and scene.train[0].bracket == (0, 1, 2)
    assert "pictures from images_4/, because there is no images/" in scene.messages
    assert {(view.camera.width, view.camera.height) for view in scene.train} == {(W // 4, H // 4)}
    assert_spots(layouts, scene)
    assert read_scene(root, downscale=2.0).train[0].camera.width == W // 8


@pytest.mark.parametrize("stated", [True, False])
def test_frames_whose_pictures_are_kept_reduced_alone(
    layouts: ModuleType, tmp_path: Path, stated: bool
) -> None:
    """As DL3DV's 960P; where the file does not tell w and h, either."""
    intrinsics = {"fl_x": layouts.FX, "fl_y": layouts.FY, "cx": layouts.CX, "cy": layouts.CY}
    top = {key: 4.0 * value for key, value in intrinsics.items()}
    top |= {"w": 4 * layouts.WIDTH, "h": 4 * layouts.HEIGHT} if stated else {}
    root = layouts.write_nerfstudio(tmp_path, **top)
    if not stated:
        content = json.loads((root / "transforms.json").read_text())
        del content["w"], content["h"]
        (root / "transforms.json").write_text(json.dumps(content))
    (root / "images").rename(root / "images_4")
    scene = read_scene(root)
    assert len(scene.train) + len(scene.test) == 9
    assert "pictures from images_4/, because there is no images/" in scene.messages
    assert_spots(layouts, scene)


def test_suffixes_in_capitals(layouts: ModuleType, tmp_path: Path) -> None:
    """The model, transforms.json and exposure.json say .jpg, and the camera wrote .JPG; or the reverse."""
    root = layouts.write_colmap(tmp_path / "a", poses=4)
    for path in sorted((root / "images").iterdir()):
        path.rename(path.with_suffix(".JPG"))
    scene = read_scene(root)
    assert [view.bracket for view in scene.train] == [(0, 1, 2)] * 3 and len(scene.test) == 1
    assert not any("not used" in told or "no picture" in told for told in scene.messages)
    for suffix in ("jpg", "JPG"):
        seconds = {f"shot_{i:02d}_{k}.{suffix}": 3.0**k for i in range(4) for k in range(3)}
        (root / "exposure.json").write_text(json.dumps(seconds))
        assert read_scene(root).train[0].exposures == (1.0, 3.0, 9.0)
    root = layouts.write_nerfstudio(tmp_path / "b", poses=4)
    content = json.loads((root / "transforms.json").read_text())
    for frame in content["frames"]:
        frame["file_path"] = frame["file_path"].replace(".png", ".PNG")
    (root / "transforms.json").write_text(json.dumps(content))
    assert len(read_scene(root).train) == 3


def test_times_as_names(layouts: ModuleType, tmp_path: Path) -> None:
    """2024-05-01T12:30:00.jpg is a file's name but on Windows; a drive's letter leads out of the folder."""
    if os.name == "nt":
        pytest.skip("Windows has no such names")
    names = [f"2024-05-01T12:30:{i:02d}.jpg" for i in range(5)]
    for i, name in enumerate(names):
        layouts.save(tmp_path / "images" / name, layouts.draw(i, 0))
    layouts.write_sparse(tmp_path / "sparse" / "0", {name: i for i, name in enumerate(names)})
    scene = read_scene(tmp_path)
    assert len(scene.train) == 4
    assert_spots(layouts, scene)
    for drive in ("C:x.jpg", "C:/x.jpg", "c:\\x.jpg"):
        layouts.write_sparse(tmp_path / "sparse" / "0", {drive: 0, names[0]: 1})
        with pytest.raises(BadValueError, match="is not in"):
            read_scene(tmp_path)


def test_poses_of_three_rows(layouts: ModuleType, tmp_path: Path) -> None:
    """As nerfstudio reads them, too."""
    root = layouts.write_nerfstudio(tmp_path, poses=4)
    content = json.loads((root / "transforms.json").read_text())
    for frame in content["frames"][:3]:
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    assert len(scene.train) == 3 and all(view.camera.camera_to_world.shape == (4, 4) for view in scene.train)
    assert_spots(layouts, scene)


# ---- pictures on their side --------------------------------------------------------------------------


def turned_files(root: Path, orientation: int) -> None:
    """Each picture is stored as a camera held sideways stores it, with EXIF's word for it."""
    undo = {3: (2, False), 6: (1, False), 8: (-1, False), 5: (0, True), 7: (2, True)}[orientation]
    for path in sorted((root / "images").iterdir()):
        picture = np.rot90(np.array(Image.open(path)), undo[0])
        picture = picture.swapaxes(0, 1) if undo[1] else picture
        tags = Image.Exif()
        tags[0x0112] = orientation
        Image.fromarray(picture).save(path, quality=97, subsampling=0, exif=tags)


@pytest.mark.parametrize("orientation", [6, 8, 5, 7])
def test_pictures_are_turned_where_only_turned_they_fit(tmp_path: Path, orientation: int) -> None:
    root = write_fox(tmp_path, 4, ())
    turned_files(root, orientation)
    scene = read_scene(root)
    assert {(view.camera.width < view.camera.height) for view in scene.train} == {True}
    assert all(view.sources[0].orientation == orientation for view in scene.train)
    for found, expected in found_corners(scene):
        assert np.median(np.linalg.norm(found - expected, axis=1)) < 0.08


@pytest.mark.parametrize("orientation", [3, 6])
def test_elsewhere_pictures_are_as_they_are_stored(
    layouts: ModuleType, tmp_path: Path, orientation: int
) -> None:
    """As COLMAP, nerfstudio and instant-ngp look at them; a word of EXIF alone turns nothing."""
    root = layouts.write_colmap(tmp_path / "data", poses=3)
    before = read_scene(root).train[0].image(0)
    for path in sorted((root / "images").iterdir()):
        picture = Image.open(path)
        exif = picture.getexif()
        exif[0x0112] = orientation
        picture.save(path, quality="keep", exif=exif)
    view = read_scene(root).train[0]
    assert view.sources[0].orientation == 1
    assert np.abs(view.image(0).astype(int) - before).max() <= 3, "another JPEG, but not turned"


def test_what_fits_neither_way_is_refused(tmp_path: Path) -> None:
    root = write_fox(tmp_path, 4, (), w=480.0, h=300.0)
    turned_files(root, 6)
    with pytest.raises(DataMismatchError, match="another shape"):
        read_scene(root)


# ---- several sizes -----------------------------------------------------------------------------------


def test_portrait_landscape_and_another_camera_in_one_model(layouts: ModuleType, tmp_path: Path) -> None:
    """One factor for all, found by the widest: what is a pixel in one stays comparable to the others'."""
    frames, sizes = [], [(96, 72), (72, 96), (192, 144), (96, 72), (72, 96)]
    for index, (width, height) in enumerate(sizes):
        scale = 2.0 if width == 192 else 1.0
        f, c = (80.0 * scale, 78.0 * scale), (0.5 * width + 3.0, 0.5 * height - 2.0)
        rotation, translation = layouts.world_to_camera(index)
        x, y, z = rotation @ layouts.POINTS.T + translation[:, None]
        places = np.stack([f[0] * x / z + c[0], f[1] * y / z + c[1]], axis=1)
        y, x = np.mgrid[0:height, 0:width] + 0.5
        spots = [np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / layouts.SPOT**2) for u, v in places]
        picture = layouts.background(0) + layouts.PEAK * np.stack(spots, axis=-1)
        name = f"images/{index}.png"
        layouts.save(tmp_path / name, np.round(picture).astype(np.uint8))
        matrix = layouts.camera_to_world_opengl(index).tolist()
        frames.append({"file_path": name, "transform_matrix": matrix, "w": width, "h": height})
        frames[-1] |= {"fl_x": f[0], "fl_y": f[1], "cx": c[0], "cy": c[1]}
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    for downscale in (1.0, 2.0):
        scene = read_scene(tmp_path, downscale)
        views = sorted([*scene.train, *scene.test], key=lambda view: view.index)
        found = [(view.camera.width * downscale, view.camera.height * downscale) for view in views]
        assert found == sizes
        for view in views:
            camera = view.camera
            x, y, z, _ = camera.world_to_camera @ np.c_[layouts.POINTS, np.ones(3)].T
            expected = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
            np.testing.assert_allclose(layouts.spots(view.image(0), 0), expected, atol=0.1)
        told = "pictures have 3 sizes (2 of 96×72, 2 of 72×96, 1 of 192×144)"
        assert any(message.startswith(told) for message in scene.messages)


# ---- masks -------------------------------------------------------------------------------------------


def half_black(width: int, height: int) -> Image.Image:
    mask = np.full((height, width), 255, np.uint8)
    mask[:, : width // 2] = 0
    return Image.fromarray(mask)


def test_masks_of_transforms_go_through_the_lens(tmp_path: Path) -> None:
    """Left of a line the photo is masked: only right of where the lens puts that line is compared."""
    root = write_fox(tmp_path, 4, ())
    content = json.loads((root / "transforms.json").read_text())
    (root / "masks").mkdir()
    half_black(WIDTH, HEIGHT).save(root / "masks" / "0002.png")
    content["frames"][1]["mask_path"] = "masks/0002.png"
    (root / "transforms.json").write_text(json.dumps(content))
    for downscale in (1.0, 2.0):
        scene = read_scene(root, downscale)
        assert "1 of 4 pictures have masks: black areas are not compared" in scene.messages
        views = {view.index: view for view in [*scene.train, *scene.test]}
        assert views[0].mask(0) is None
        mask = views[1].mask(0)
        assert mask is not None and mask.shape == views[1].image(0).shape[:2]
        camera = views[1].camera
        K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
        line = np.stack([np.full(HEIGHT, WIDTH // 2), np.arange(HEIGHT) + 0.5], axis=1).astype(float)
        straight = cv2.undistortPoints(line[:, None], K, np.array(DISTORTION))[:, 0]
        edge = straight * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        rows = np.arange(camera.height)
        edges = np.interp(rows + 0.5, edge[:, 1], edge[:, 0])
        first = np.array([np.flatnonzero(mask[row])[0] for row in rows])
        assert (first >= edges - 1e-3).all() and (first - edges).max() < 3.6 / downscale + 1.0
        assert all(mask[row, first[row] :].all() for row in rows)


def test_masks_beside_a_model(layouts: ModuleType, tmp_path: Path) -> None:
    """``masks/NAME.jpg.png`` as COLMAP has it, or ``masks/NAME.png``."""
    root = layouts.write_colmap(tmp_path / "data", poses=3)
    (root / "masks").mkdir()
    half_black(layouts.WIDTH, layouts.HEIGHT).save(root / "masks" / "shot_00_1.jpg.png")
    half_black(layouts.WIDTH, layouts.HEIGHT).save(root / "masks" / "shot_02_0.png")
    scene = read_scene(root, 1.0)
    assert "2 of 9 pictures have masks: black areas are not compared" in scene.messages
    views = {view.name: view for view in [*scene.train, *scene.test]}
    assert views["shot_00"].mask(0) is None and views["shot_01"].mask(1) is None
    for view, place in ((views["shot_00"], 1), (views["shot_02"], 0)):
        mask = view.mask(place)
        assert mask is not None
        np.testing.assert_array_equal(
            mask, np.arange(layouts.WIDTH)[None] >= np.full((layouts.HEIGHT, 1), 48)
        )


@pytest.mark.parametrize("factor", [2.0, 3.0, 2.5])
def test_a_reduced_mask_is_true_where_all_of_a_pixel_is(factor: float) -> None:
    """Whatever stands where it is False, the picture where it is True does not change: 8 and 16 bits."""
    rng = np.random.default_rng(0)
    mask = np.ones((60, 90), bool)
    mask[10:20, 30:33] = mask[:, :2] = mask[50, 80] = False
    for filter in ("area", "bicubic"):
        reduction = Reduction(factor, filter)
        reduced = reduction.mask(mask)
        assert reduced.shape == reduction.size(90, 60)[::-1]
        for kind in (np.uint8, np.uint16):
            photo = rng.integers(0, np.iinfo(kind).max, (60, 90, 3), dtype=kind, endpoint=True)
            other = np.where(mask[..., None], photo, np.iinfo(kind).max - photo)
            changed = (reduction.picture(photo) != reduction.picture(other)).any(axis=2)
            assert not (changed & reduced).any() and changed[~reduced].mean() > 0.5


# ---- brackets whose pictures are views by themselves ---------------------------------------------------


@pytest.mark.parametrize("layout", ["COLMAP", "nerfstudio"])
def test_no_picture_of_a_test_place_is_trained(layouts: ModuleType, tmp_path: Path, layout: str) -> None:
    """Ten places by three exposures, DSC_0001 … DSC_0030, each with poses that are a little off."""
    images = {}
    for place in range(10):
        for k, seconds in enumerate((0.1, 0.4, 1.6)):
            name = f"DSC_{3 * place + k + 1:04d}.jpg"
            images[name] = place + 2e-4 * k
            layouts.save(
                tmp_path / "images" / name, layouts.draw(place, k), exif=layouts.camera_exif(seconds)
            )
    if layout == "COLMAP":
        layouts.write_sparse(tmp_path / "sparse" / "0", images)
    else:
        frames = [
            {"file_path": f"images/{name}", "transform_matrix": layouts.camera_to_world_opengl(i).tolist()}
            for name, i in images.items()
        ]
        content = {"w": layouts.WIDTH, "h": layouts.HEIGHT, "fl_x": layouts.FX, "frames": frames}
        (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(tmp_path)
    assert scene.layout == layout and [view.name[-8:] for view in scene.test] == [
        "DSC_0013",
        "DSC_0014",
        "DSC_0015",
    ]
    trained = np.stack([view.camera.position for view in scene.train])
    for view in scene.test:
        assert np.linalg.norm(trained - view.camera.position, axis=1).min() > 0.5
    assert "(3 of 30 poses); they are of 10 places" in scene.messages[0]
    assert "'physhdr prepare' makes one view of each" in scene.messages[0]
