# SPDX-License-Identifier: GPL-3.0-or-later
"""Every layout of the peers and of users: what comes out of a folder that is whole.

Axes, quaternions, principal points and reductions are checked where it counts: a point of the world,
projected through the view's camera, must fall on the spot that was drawn for it by another formula.
"""

import json
import os
import re
import shutil
from collections.abc import Iterable, Sequence
from fnmatch import fnmatch
from io import BytesIO
from itertools import product
from pathlib import Path
from types import ModuleType

import numpy as np
import OpenImageIO
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from physhdr.addon.layouts.cameras import read_frames
from physhdr.backend.evaluate import truth
from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.inspect import inspect
from physhdr.backend.scene import Scene, View, read_scene
from physhdr.backend.scene.capture.exposures import exposures_from_exif
from physhdr.backend.scene.capture.photos import find_photos
from physhdr.backend.scene.gausshdr import published_factor
from physhdr.bridge import data_set
from physhdr.bridge.errors import BadValueError, DataMismatchError
from physhdr.bridge.layouts import layout_of
from physhdr.bridge.layouts.picture_files import SUFFIXES
from physhdr.bridge.layouts.truth_folders import FOLDERS

#: Pixels by which a spot's measured centre may be off: JPEG, 8 bits and, where reduced, resampling.
HIT = 0.06

WRITERS = ["write_syn", "write_real", "write_gausshdr", "write_hdr_gs", "write_colmap", "write_nerfstudio"]
WRITERS += ["write_nerf"]


def assert_points_are_on_their_spots(layouts: ModuleType, scene: Scene) -> None:
    for view, i in scene.pictures():
        camera = view.camera
        x, y, z, _ = camera.world_to_camera @ np.c_[layouts.POINTS, np.ones(3)].T
        assert (z > 0.0).all(), f"{view.name}: points are behind the camera"
        expected = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        found = layouts.spots(view.image(i), view.bracket[i])
        np.testing.assert_allclose(found, expected, atol=HIT, err_msg=f"{view.name}, exposure {i}")


def darkest(view: View, i: int) -> int:
    return int(np.median(view.image(i)))


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("downscale", [None, 2, 2.5])
def test_points_project_onto_their_pictures(
    layouts: ModuleType, tmp_path: Path, writer: str, downscale: float | None
) -> None:
    scene = read_scene(getattr(layouts, writer)(tmp_path / "data"), downscale)
    assert scene.train and scene.test
    assert_points_are_on_their_spots(layouts, scene)


@pytest.mark.parametrize(
    ("writer", "layout", "train", "test", "anchor"),
    [
        ("write_syn", "HDR-NeRF-Syn", [0, 2, 4], [1, 3], (1.0, 0.73)),
        ("write_real", "HDR-NeRF-Real", [0, 2, 4], [1, 3], None),
        ("write_gausshdr", "GaussHDR", [0, 2, 4], [1, 3], (1.0, 0.73)),
        # Names as text: 0, 1, 10, 11, 2, 3 … of which every second one is for testing.
        ("write_hdr_gs", "HDR-GS", [0, 10, 2, 4, 6, 8], [1, 11, 3, 5, 7, 9], (1.0, 0.73)),
        ("write_colmap", "COLMAP", [0, 1, 2, 3, 5, 6, 7, 8, 9], [4], None),
        ("write_nerfstudio", "nerfstudio", [0, 1, 2, 3, 5, 6, 7, 8], [4], None),
        ("write_nerf", "NeRF-Synthetic", [0, 2, 4, 10], [1, 3], None),
    ],
)
def test_each_layout_has_its_split_and_anchor(
    layouts: ModuleType, tmp_path: Path, writer, layout, train, test, anchor
) -> None:
    scene = read_scene(getattr(layouts, writer)(tmp_path / "dog"))
    assert (scene.layout, scene.name, scene.response_anchor) == (layout, "dog", anchor)
    assert [view.index for view in scene.train] == train
    assert [view.index for view in scene.test] == test
    assert any("split" in message for message in scene.messages)
    assert any("exposures" in message for message in scene.messages)
    assert any("pictures" in message for message in scene.messages)


@pytest.mark.parametrize("writer", WRITERS)
def test_nothing_is_read_but_what_the_table_of_layouts_names(
    layouts: ModuleType, tmp_path: Path, writer: str
) -> None:
    root = getattr(layouts, writer)(tmp_path / "data")
    layout = layout_of(root)
    before = read_scene(root)
    assert layout is not None and before.layout == layout.name
    for path in [path for path in root.rglob("*") if path.is_file() and path.suffix not in SUFFIXES]:
        if not any(fnmatch(path.relative_to(root).as_posix(), pattern) for pattern in layout.reads):
            path.unlink()
    after = read_scene(root)
    assert [view.name for view in after.train + after.test] == [
        view.name for view in before.train + before.test
    ]
    assert after.messages == before.messages
    assert (after.points is None) == (before.points is None)


@pytest.mark.parametrize("writer", WRITERS)
def test_the_extension_sees_the_cameras_that_are_trained_with(
    layouts: ModuleType, tmp_path: Path, writer: str
) -> None:
    root = getattr(layouts, writer)(tmp_path / "data")
    scene, frames = read_scene(root, 1), read_frames(root).frames
    for split in ("train", "test", "val"):
        for view in scene.splits[split]:
            pose = view.camera.camera_to_world
            same = [frame for frame in frames if np.allclose(frame.camera_to_world, pose, atol=1e-9)]
            assert same and {frame.split for frame in same} <= {split, "views"}, view.name
            scale = view.camera.width / same[0].width
            theirs = np.array([same[0].fx, same[0].fy, same[0].cx, same[0].cy]) * scale
            camera = view.camera
            np.testing.assert_allclose(theirs, [camera.fx, camera.fy, camera.cx, camera.cy], rtol=1e-6)


@pytest.mark.parametrize("writer", ["write_syn", "write_gausshdr", "write_hdr_gs"])
def test_truth_is_found_by_evaluation_and_never_opened_by_readers(
    layouts: ModuleType, tmp_path: Path, writer: str
) -> None:
    root = getattr(layouts, writer)(tmp_path / "data")
    for split, index in (("train", 2), ("test", 3)):
        assert truth.has_hdr_truth(root, split)
        assert float(truth.hdr_truth(root, split, index).mean()) == 10.0 + index
    for path in root.rglob("*.exr"):
        path.write_bytes(b"law 6")
    scene = read_scene(root)
    for view, i in scene.pictures():
        view.image(i)


def test_the_number_of_a_pose_names_its_truth_whoever_reads_it(layouts: ModuleType, tmp_path: Path) -> None:
    """A stray entry makes GaussHDR's packaging a plain COLMAP folder: test_r_11 comes before test_r_3."""
    root = layouts.write_gausshdr(tmp_path / "sofa", poses=13)
    stated = json.loads((root / "exposure.json").read_text())
    (root / "exposure.json").write_text(json.dumps(stated | {"greycard_0.png": 1.0}))
    scene = read_scene(root)
    assert scene.layout == "COLMAP"
    assert [view.index for view in scene.test] == [1, 11, 3, 5, 7, 9]
    for split in ("train", "test"):
        for view in scene.splits[split]:
            shown = int(view.name.rsplit("_", 1)[1])
            assert float(truth.hdr_truth(root, split, view.index).mean()) == 10.0 + shown


def test_nerfstudio_beside_true_radiance_counts_by_names(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_nerfstudio(tmp_path / "data")
    content = json.loads((root / "transforms.json").read_text())
    content["frames"] = [frame for frame in content["frames"] if "00003" not in frame["file_path"]]
    (root / "transforms.json").write_text(json.dumps(content))
    assert [view.index for view in read_scene(root).train] == [0, 1, 2, 3, 5, 6, 7]
    (root / "test_hdr").mkdir()
    assert [view.index for view in read_scene(root).train] == [0, 1, 2, 4, 6, 7, 8]


def test_readers_know_where_evaluation_looks_for_truth() -> None:
    looked = {
        place.folder(split): place.file(split, 3) for place in truth._PLACES for split in data_set.SPLITS
    }
    assert looked.keys() == FOLDERS.keys()
    of_test = {place.folder("test"): place.file("test", 3) for place in truth._PLACES}
    assert all(re.fullmatch(FOLDERS[folder], name) for folder, name in of_test.items())


def test_a_folder_of_exrs_beside_photographs_is_neither_a_layout_nor_truth(
    layouts: ModuleType, tmp_path: Path
) -> None:
    """Merged brackets, a shot's frames, a renderer's passes: names are those of the user's photographs."""
    plain = read_scene(layouts.write_colmap(tmp_path / "plain"))
    root = layouts.write_colmap(tmp_path / "photos")
    for folder in ("exr", "images_hdr", "test_hdr"):
        for index in range(10):
            layouts.write_truth(root / folder / f"shot_{index:02d}.exr", 1.0)
            layouts.write_truth(root / folder / f"{index}.exr", 1.0)
    scene = read_scene(root)
    assert (scene.layout, scene.response_anchor, scene.photographs) == ("COLMAP", None, True)
    for split in ("train", "test"):
        assert [view.name for view in scene.splits[split]] == [view.name for view in plain.splits[split]]
        assert not truth.has_hdr_truth(root, split)
    found = inspect(root)
    assert found.errors == [] and found.layout == "COLMAP"


def test_a_views_own_picture_is_not_its_truth(layouts: ModuleType, tmp_path: Path) -> None:
    """``transforms.json`` of a shot names ``exr/shot_1001.exr``; of our own data's truth it is refused."""
    root = layouts.write_nerfstudio(tmp_path / "shot")
    content = json.loads((root / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        frame["file_path"] = f"exr/shot_{1001 + index}.exr"
        layouts.write_truth(root / frame["file_path"], 1.0 + index)
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    assert scene.layout == "nerfstudio" and len(scene.train) == 8
    assert not truth.has_hdr_truth(root, "test") and inspect(root).errors == []
    for index, frame in enumerate(content["frames"]):
        frame["file_path"] = f"train_hdr/hdr_{index:03d}.exr"
        layouts.write_truth(root / frame["file_path"], 1.0 + index)
    (root / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(
        DataMismatchError, match=r"train_hdr/hdr_00\d\.exr is a view's picture, and by its name true"
    ):
        read_scene(root)


@pytest.mark.parametrize("change", ["none is there", "one is missing", "others are there, too"])
def test_hdr_gs_is_known_by_any_of_its_truth(layouts: ModuleType, tmp_path: Path, change: str) -> None:
    root = layouts.write_hdr_gs(tmp_path / "dog")
    for path in {"none is there": list(root.glob("exr/*")), "one is missing": [root / "exr/3.exr"]}.get(
        change, []
    ):
        path.unlink()
    if change == "others are there, too":
        layouts.write_truth(root / "exr/99.exr", 1.0)
        (root / "images/.DS_Store").touch()
    assert read_scene(root).layout == "HDR-GS" and truth.has_hdr_truth(root, "test")


@pytest.mark.parametrize("writer", ["write_real", "write_colmap", "write_nerfstudio"])
def test_photographs_have_no_truth(layouts: ModuleType, tmp_path: Path, writer: str) -> None:
    root = getattr(layouts, writer)(tmp_path / "data")
    assert not truth.has_hdr_truth(root, "train") and not truth.has_hdr_truth(root, "test")


@pytest.mark.parametrize("factor", [0.5, 0.0, -2.0, float("nan"), float("inf")])
def test_pictures_are_not_enlarged(layouts: ModuleType, tmp_path: Path, factor: float) -> None:
    root = layouts.write_nerfstudio(tmp_path / "data")
    with pytest.raises(BadValueError, match=r"cannot be reduced by[\s\S]*2 is half the size"):
        read_scene(root, factor)


# ---- reduction ---------------------------------------------------------------------------------------


def replace_all(paths: Iterable[Path], picture: np.ndarray) -> None:
    """Each of these files becomes ``picture``."""
    content = BytesIO()
    Image.fromarray(picture).save(content, "PNG", compress_level=1)
    for path in list(paths):
        path.write_bytes(content.getvalue())


def test_the_originals_of_hdr_nerf_are_halved_by_averaging_areas(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_syn(tmp_path / "bear", exposures=(1.0,))
    noise = np.random.default_rng(0).integers(0, 256, (800, 800, 4), dtype=np.uint8)
    replace_all(root.glob("t*/*.png"), noise)
    scene = read_scene(root)
    view = scene.train[0]
    assert (view.camera.width, view.camera.height) == (400, 400)
    assert view.camera.fx == pytest.approx(layouts.FX * 400 / layouts.WIDTH) and view.camera.cx == 200.0
    mean = noise[..., :3].astype(float).reshape(400, 2, 400, 2, 3).mean((1, 3))
    assert np.abs(view.image(0) - mean).max() <= 0.5
    assert "pictures are reduced by 2, 800×800 to 400×400 (area average)" in scene.messages
    assert read_scene(root, 1).train[0].camera.width == 800
    info = {"format": "physhdr-dataset", "version": 1, "scene": "mine"}
    (root / "dataset.json").write_text(json.dumps(info))
    assert read_scene(root).train[0].camera.width == 800, "ours is read as it is"


def test_gausshdr_reduces_as_its_paper(layouts: ModuleType, tmp_path: Path) -> None:
    assert [published_factor(*size) for size in ((800, 800), (3216, 2136), (5952, 4476))] == [2, 4, 6]
    # Others: 3DGS's rule, at most 1600 wide.
    assert [published_factor(*size) for size in ((400, 400), (1600, 1200), (4000, 3000))] == [1, 1, 2.5]
    root = layouts.write_gausshdr(tmp_path / "sofa")
    noise = np.random.default_rng(0).integers(0, 256, (800, 800, 3), dtype=np.uint8)
    replace_all(root.glob("images/*.png"), noise)
    layouts.write_sparse(  # as COLMAP has them at that size
        root / "sparse" / "0",
        {f"{('train', 'test')[i % 2]}_r_{i}_0.png": i for i in range(5)},
        params=(750.0, 750.0, 400.0, 400.0),
        size=(800, 800),
    )
    view = read_scene(root).train[0]
    # GaussHDR's: Pillow's resize with its default filter.
    np.testing.assert_array_equal(view.image(0), np.array(Image.fromarray(noise).resize((400, 400))))
    assert (view.camera.fx, view.camera.cx) == (375.0, 200.0)
    (root / "prepare.json").write_text("{}")
    assert read_scene(root).train[0].camera.width == 800, "a user's own photographs of that size"


def test_only_reduced_pictures_are_kept(layouts: ModuleType, tmp_path: Path) -> None:
    view = read_scene(layouts.write_gausshdr(tmp_path / "data"), 2).train[0]
    assert view.image(1) is view.image(1) and not view.image(1).flags.writeable
    assert view.cache.bytes_held == 36 * 48 * 3


def test_cameras_that_were_found_at_another_size_are_fitted(layouts: ModuleType, tmp_path: Path) -> None:
    """COLMAP may have been run on pictures of half the size."""
    half = tuple(value / 2 for value in (layouts.FX, layouts.FY, layouts.CX, layouts.CY))
    root = layouts.write_colmap(tmp_path / "data", params=half, size=(48, 36))
    assert_points_are_on_their_spots(layouts, read_scene(root))


# ---- HDR-NeRF-Real -----------------------------------------------------------------------------------


def test_hdr_nerf_real_takes_pictures_that_are_reduced_already(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_real(tmp_path / "flower", poses=2, scale=8.0)
    for path in list((root / "input_images").glob("*.jpg")):
        with Image.open(path) as picture:
            small = np.array(picture.reduce(4))
        layouts.save(root / "input_images_4" / f"{path.stem}.png", small)
        path.unlink()
    scene = read_scene(root)
    view = scene.test[0]
    assert view.image_paths[0].name == "001_0.png" and view.camera.width == 192
    assert view.exposures == (2.0, 0.5, 0.125) and view.bracket == (0, 1, 2)
    assert_points_are_on_their_spots(layouts, scene)
    assert any("input_images_4/" in message for message in scene.messages)


def test_hdr_nerf_real_with_colmaps_cameras(layouts: ModuleType, tmp_path: Path) -> None:
    """As HDR-GS packages it: cameras and points of sparse/0; a pose that COLMAP lost is named."""
    root = layouts.write_real(tmp_path / "box")
    rows = np.load(root / "poses_bounds_exps.npy")
    rows[:, 3] += 5.0  # other cameras than the model's
    np.save(root / "poses_bounds_exps.npy", rows)
    params = (layouts.FX, layouts.FX, layouts.WIDTH / 2, layouts.HEIGHT / 2)
    layouts.write_sparse(root / "sparse" / "0", {f"{i:03d}_0.jpg": i for i in (0, 1, 2, 4)}, params=params)
    scene = read_scene(root)
    assert_points_are_on_their_spots(layouts, scene)
    assert [view.index for view in scene.train] == [0, 2, 4] and [view.index for view in scene.test] == [1]
    assert scene.points is not None and any(
        "ignoring poses that it lacks: 003" in message for message in scene.messages
    )


# ---- GaussHDR ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_exposures_that_were_not_taken_keep_the_others_places(
    layouts: ModuleType, tmp_path: Path, suffix: str, form: str
) -> None:
    root = layouts.write_gausshdr(tmp_path / "coffee", {0: (1, 3), 1: (1, 3), 2: (4,)}, suffix, form)
    scene = read_scene(root)
    first = scene.find("train", 0)
    assert first.bracket == (0, 2, 4) and first.exposures == (0.125, 2.0, 32.0)
    assert [darkest(first, i) for i in range(3)] == pytest.approx([10, 50, 90], abs=1)
    assert first.place_of(2) == 1 and first.place_of(3) is None
    assert scene.find("train", 2).bracket == (0, 1, 2, 3)
    assert scene.find("test", 3).bracket == (0, 1, 2, 3, 4)
    assert "exposures are missing: 1 in 2, 3 in 2, 4 in 1 of 5 poses" in scene.messages
    assert scene.points is not None
    np.testing.assert_array_equal(scene.points.positions, layouts.POINTS.astype(np.float32))
    np.testing.assert_allclose(scene.points.colours[2], [0.0, 0.0, 0.2], atol=1e-7)
    assert_points_are_on_their_spots(layouts, scene)


class Grey(Renderer):
    """A model that shows the same grey everywhere, radiance 12."""

    lights = ("ambient",)

    def hdr(self, camera, lighting_level=1.0):
        return torch.full((3, camera.height, camera.width), 12.0)

    def ldr(self, camera, exposure, lighting_level=1.0):
        return torch.full((3, camera.height, camera.width), 0.25)


def test_evaluation_counts_by_the_place_in_the_bracket(layouts: ModuleType, tmp_path: Path) -> None:
    """Test poses 1 and 3, of which one has no exposures 1 and 3: LDR-NE is of the other alone."""
    root = layouts.write_gausshdr(tmp_path / "coffee", {1: (1, 3)})
    result = evaluate(Grey(), read_scene(root, 2))
    rows = [(row.index, row.exposure_index, row.exposure) for row in result.ldr]
    exposures = layouts.EXPOSURES
    assert rows == [*((1, k, exposures[k]) for k in (0, 2, 4)), *((3, k, exposures[k]) for k in range(5))]
    # HDR truth at full size, the constant 10 + pose's number: found, and reduced to the prediction.
    assert [(row.index, row.normaliser) for row in result.hdr] == [(1, 11.0), (3, 13.0)]
    assert [row.scale_ratio for row in result.hdr] == pytest.approx([12 / 11, 12 / 13], rel=1e-6)


def test_without_true_radiance_nothing_is_known_of_the_response(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_gausshdr(tmp_path / "plant", suffix="jpg")
    assert read_scene(root).response_anchor is None
    info = {"scene": "mine", "response": {"anchor": [1.0, 0.5]}}
    (root / "dataset.json").write_text(json.dumps(info))
    scene = read_scene(root)
    assert (scene.name, scene.response_anchor) == ("mine", (1.0, 0.5))


# ---- COLMAP ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["bin", "txt"])
@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_PINHOLE", lambda L: (L.FX, L.CX, L.CY)),
        ("PINHOLE", lambda L: (L.FX, L.FY, L.CX, L.CY)),
        ("OPENCV", lambda L: (L.FX, L.FY, L.CX, L.CY, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_pinhole_cameras_of_colmap(layouts: ModuleType, tmp_path: Path, form, model, params) -> None:
    root = layouts.write_colmap(tmp_path / "data", form=form, model=model, params=params(layouts), poses=2)
    camera = read_scene(root).train[0].camera
    fy = layouts.FX if model == "SIMPLE_PINHOLE" else layouts.FY
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (layouts.FX, fy, layouts.CX, layouts.CY)


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_points_of_colmap_say_of_what_kind_they_are(layouts: ModuleType, tmp_path: Path, form) -> None:
    points = read_scene(layouts.write_colmap(tmp_path / "data", form=form, poses=2)).points
    assert str(points) == f"{len(layouts.POINTS)} points of the data set (structure from motion)"


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_exposures_are_read_from_exif(layouts: ModuleType, tmp_path: Path, suffix: str) -> None:
    """Time × ISO / 100 × (F / f)², F the median: double ISO is double time, one stop down is half."""
    root = layouts.write_colmap(tmp_path / "data", poses=2, suffix=suffix)
    told = {0: (0.01, 100, 8.0), 1: (0.01, 400, 8.0), 2: (0.64, 100, 16.0)}
    for index in range(2):
        for k, tags in told.items():
            exif = layouts.camera_exif(*tags)
            layouts.save(
                root / "images" / f"shot_{index:02d}_{k}.{suffix}", layouts.draw(index, k), exif=exif
            )
    scene = read_scene(root)
    assert scene.train[0].exposures == pytest.approx((0.01, 0.04, 0.16), rel=1e-3)
    assert "exposures from EXIF, seconds at ISO 100 and f/8" in scene.messages


def test_times_of_tiffs_by_another_program_are_read(layouts: ModuleType, tmp_path: Path) -> None:
    """Automatic exposure, of 16 bits, as raw converters write them: not "1 s for all pictures"."""
    root = layouts.write_nerfstudio(tmp_path / "data", poses=4)
    content = json.loads((root / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        path = (root / frame["file_path"]).with_suffix(".tif")
        codes = np.asarray(Image.open(path.with_suffix(".png"))).astype(np.uint16) * 257
        spec = OpenImageIO.ImageSpec(codes.shape[1], codes.shape[0], 3, "uint16")
        spec["ExposureTime"], spec["FNumber"] = 0.1 * 2**index, 8.0
        writer = OpenImageIO.ImageOutput.create(str(path))
        assert writer.open(str(path), spec) and writer.write_image(codes)
        writer.close()
        frame["file_path"] = f"images/{path.name}"
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    times = {view.name: view.exposures[0] for views in scene.splits.values() for view in views}
    expected = [0.1 * 2**index for index in range(4)]
    assert [times[frame["file_path"][:-4]] for frame in content["frames"]] == pytest.approx(expected)
    assert any("exposures from EXIF" in message for message in scene.messages)


def test_high_iso_and_apex_times_are_read_as_prepare_reads_them(layouts: ModuleType, tmp_path: Path) -> None:
    """ISO 204800: 65535 in the old tag; a time of 2^-Tv alone."""
    root = layouts.write_colmap(tmp_path / "data", poses=2)
    told = [{0x829A: 0.01}, {0x9201: 5.0}, {0x9201: 3.0}]
    for path in sorted((root / "images").glob("*.jpg")):
        k = int(path.stem[-1])
        tags = {0x8827: 65535, 0x8832: 204800} | told[k]
        layouts.save(path, layouts.draw(int(path.stem[5:7]), k), exif=tags)
    expected = (20.48, 2048 / 32, 2048 / 8)
    assert read_scene(root).train[0].exposures == pytest.approx(expected, rel=1e-3)
    prepared = exposures_from_exif(find_photos(root / "images").photos).seconds
    assert [prepared[f"shot_00_{k}.jpg"] for k in range(3)] == pytest.approx(expected, rel=1e-3)


def test_what_no_picture_tells_counts_as_constant(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=2)
    for path in sorted((root / "images").glob("*.jpg")):
        k = int(path.stem[-1])
        exif = layouts.camera_exif(0.1 * 2**k, None, 0.0)  # a lens without contacts has F 0
        layouts.save(path, layouts.draw(int(path.stem[5:7]), k), exif=exif)
    scene = read_scene(root)
    assert scene.train[0].exposures == pytest.approx((0.1, 0.2, 0.4), rel=1e-3)
    assert any(
        "no picture states its ISO" in m and "no picture states its aperture" in m for m in scene.messages
    )


def test_a_stated_exposure_comes_before_exif(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=3)
    stated = {f"images/shot_{i:02d}_{k}.jpg": 3.0 ** (k + 1) for i in range(3) for k in range(3)}
    del stated["images/shot_01_1.jpg"]
    (root / "exposure.json").write_text(json.dumps(stated))
    scene = read_scene(root)
    assert scene.layout == "COLMAP" and scene.train[0].exposures == (3.0, 9.0, 27.0)
    assert scene.find("test", 1).bracket == (0, 2), "a picture without an entry is left out"


def test_the_camera_of_a_bracket_is_that_with_the_most_points(layouts: ModuleType, tmp_path: Path) -> None:
    """All pictures of the brackets are in the model, each where structure from motion put it."""
    root = layouts.write_colmap(tmp_path / "data", registered=(0, 1, 2), poses=4)
    images = {f"shot_{i:02d}_{k}.jpg": i if k == 1 else i + 0.05 for i in range(4) for k in range(3)}
    most = {name: 9 for name in images if name.endswith("_1.jpg")}
    for form in ("bin", "txt"):
        shutil.rmtree(root / "sparse")
        layouts.write_sparse(root / "sparse" / "0", images, form, observations=most)
        scene = read_scene(root)
        assert_points_are_on_their_spots(layouts, scene)
        assert any("cameras of one bracket are up to" in message for message in scene.messages)


def test_pictures_that_are_no_brackets_are_views(layouts: ModuleType, tmp_path: Path) -> None:
    """frame_00012 is a number, not a bracket; frame_1 … frame_9 of nine places are none either."""
    for name, message in (("frame_{:05d}.jpg", "one exposure a view"), ("frame_{}.jpg", "are far apart")):
        root = tmp_path / str(len(name))
        images = {name.format(i): i for i in range(9)}
        for file, i in images.items():
            layouts.save(root / "images" / file, layouts.draw(i, 0), exif=layouts.camera_exif(0.02))
        layouts.write_sparse(root / "sparse", images)  # as image_undistorter leaves it, without the 0
        scene = read_scene(root)
        assert len(scene.train) == 8 and [view.index for view in scene.test] == [4]
        assert all(view.exposures == pytest.approx((0.02,)) for view in [*scene.train, *scene.test])
        assert any(message in told for told in scene.messages)
        assert_points_are_on_their_spots(layouts, scene)


@pytest.mark.parametrize("exif", [True, False])
def test_nine_places_are_no_bracket(layouts: ModuleType, tmp_path: Path, exif: bool) -> None:
    """img_1 … img_9 of a walk with automatic exposure, or without EXIF; beside a bracket that is one."""
    walk = {f"img_{i}.jpg": float(i) for i in range(1, 10)}
    for name, i in walk.items():
        tags = layouts.camera_exif(0.01 * i) if exif else None
        layouts.save(tmp_path / "images" / name, layouts.draw(int(i), 0), exif=tags)
    layouts.write_sparse(tmp_path / "sparse" / "0", walk)
    scene = read_scene(tmp_path)
    views = {view.name: view.exposures for view in (*scene.train, *scene.test)}
    expected = {f"img_{i}": pytest.approx((0.01 * i if exif else 1.0,)) for i in range(1, 10)}
    assert views == expected
    assert any("cameras of 'img_…' are far apart" in message for message in scene.messages)
    if exif:
        held = {f"hand_{k}.jpg": 4.0 + 0.02 * k for k in range(3)}
        for k, name in enumerate(held):
            layouts.save(tmp_path / "images" / name, layouts.draw(4, k), exif=layouts.camera_exif(0.1 * 4**k))
        layouts.write_sparse(tmp_path / "sparse" / "0", walk | held)
        scene = read_scene(tmp_path)
        views = {view.name: view.exposures for view in (*scene.train, *scene.test)}
        assert views == expected | {"hand": pytest.approx((0.1, 0.4, 1.6))}
    assert_points_are_on_their_spots(layouts, scene)


def turned_on_tripods(layouts: ModuleType, root: Path, degrees: Sequence[float]) -> Scene:
    """Six stands in a row, at each of which a camera takes a picture in each of four directions."""
    lines = []
    for stand, (k, angle) in product(range(6), enumerate(degrees)):
        name = f"stand{stand}_{k}.jpg"
        exif = layouts.camera_exif(0.01 * (1 + (7 * stand + 5 * k) % 11))  # as an automatic camera has it
        layouts.save(root / "images" / name, layouts.draw(stand, 0), exif=exif)
        rotation = Rotation.from_euler("y", angle, degrees=True)
        x, y, z, w = rotation.as_quat().tolist()
        place = " ".join(map(repr, (-rotation.apply([stand, 0.3, 0.0])).tolist()))
        lines += [f"{len(lines) + 1} {w} {x} {y} {z} {place} 7 {name}", ""]
    layouts.write_sparse(root / "sparse" / "0", {}, "txt")
    (root / "sparse" / "0" / "images.txt").write_text("\n".join(lines) + "\n")
    return read_scene(root)


def test_views_around_from_one_place_are_no_bracket(layouts: ModuleType, tmp_path: Path) -> None:
    """stand0_0 … stand0_3 look north, east, south and west: one camera would be wrong for three of them."""
    scene = turned_on_tripods(layouts, tmp_path, (0.0, 90.0, 180.0, 270.0))
    views = [*scene.train, *scene.test]
    assert len(views) == 24 and {view.bracket for view in views} == {(0,)}
    looks = {tuple(np.rint(view.camera.camera_to_world[:3, 2]).tolist()) for view in views}
    assert len(looks) == 4
    assert any("'stand5_…' look in different directions: each of their" in told for told in scene.messages)


def test_a_bracket_that_turned_a_little_is_one_and_says_so(layouts: ModuleType, tmp_path: Path) -> None:
    scene = turned_on_tripods(layouts, tmp_path, (0.0, 1.0, 2.0, 3.0))
    assert {view.bracket for view in [*scene.train, *scene.test]} == {(0, 1, 2, 3)}
    assert (
        "cameras of one bracket are turned by up to 3°: each view takes that of the picture with the most "
        "points"
    ) in scene.messages


def test_a_bracket_of_which_one_picture_is_turned_wrongly_stays_one(
    layouts: ModuleType, tmp_path: Path
) -> None:
    """COLMAP finds few points in a dark picture; half of a bracket is no longer one."""
    for name, angles, brackets in (
        ("one", (0.0, 12.0, 0.0, 0.0), {(0, 1, 2, 3)}),
        ("half", (0.0, 12.0, 24.0, 0.0), {(0,)}),
    ):
        scene = turned_on_tripods(layouts, tmp_path / name, angles)
        assert {view.bracket for view in [*scene.train, *scene.test]} == brackets
        told = "6 of 24 pictures of the model are turned by more than 10° against most of their bracket"
        assert any(told in message for message in scene.messages) == (name == "one")
        if name == "one":
            looks = [view.camera.camera_to_world[:3, 2] for view in (*scene.train, *scene.test)]
            np.testing.assert_allclose(looks, [(0.0, 0.0, -1.0)] * 6, atol=1e-9)


def test_a_stray_picture_leaves_brackets_as_they_are(layouts: ModuleType, tmp_path: Path) -> None:
    """shot_00_0 … shot_09_2, of which the model has the middle ones, and an overview, bright as place 2."""
    root = layouts.write_colmap(tmp_path / "data")
    layouts.save(root / "images/overview.jpg", layouts.draw(4.4, 2), exif=layouts.camera_exif(1.9))
    images = {f"shot_{i:02d}_1.jpg": float(i) for i in range(10)} | {"overview.jpg": 4.4}
    layouts.write_sparse(root / "sparse" / "0", images)
    scene = read_scene(root)
    views = {view.name: view.bracket for view in (*scene.train, *scene.test)}
    assert views == {f"shot_{i:02d}": (0, 1, 2) for i in range(10)} | {"overview": (2,)}
    assert (
        "1 of 11 pictures of the model are not named as brackets: each is a separate view "
        "(first: overview.jpg)"
    ) in scene.messages
    assert not any("exposures are missing" in message for message in scene.messages)
    assert_points_are_on_their_spots(layouts, scene)


def test_numbers_of_one_and_of_two_digits_are_no_brackets(layouts: ModuleType, tmp_path: Path) -> None:
    """img_1 … img_12 of a walk, of which COLMAP has placed one of the first nine; and a pair beside many."""
    images = {f"img_{i}.jpg": 0.3 * i for i in range(1, 13)}
    for i, name in enumerate(images):
        layouts.save(tmp_path / "a" / "images" / name, layouts.draw(i, 0), exif=layouts.camera_exif(0.01 + i))
    layouts.write_sparse(
        tmp_path / "a" / "sparse/0", {n: i for n, i in images.items() if i > 2.5 or i == 0.6}
    )
    scene = read_scene(tmp_path / "a")
    assert {view.name for view in (*scene.train, *scene.test)} == {
        "img_2",
        *(f"img_{i}" for i in range(9, 13)),
    }
    images = {f"DSC{i:04d}.jpg": float(i) for i in range(8)} | {"flash_1.jpg": 4.01, "flash_2.jpg": 4.02}
    for i, name in enumerate(images):
        layouts.save(tmp_path / "b" / "images" / name, layouts.draw(i, 0))
    layouts.write_sparse(tmp_path / "b" / "sparse/0", images)
    scene = read_scene(tmp_path / "b")
    assert {len(view.exposures) for view in scene.train} == {1} and len(scene.train) + len(scene.test) == 10


def test_pictures_of_one_exposure_are_no_bracket(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=4)
    for path in sorted((root / "images").glob("*.jpg")):
        layouts.save(path, layouts.draw(int(path.stem[5:7]), 0), exif=layouts.camera_exif(0.02))
    scene = read_scene(root)
    assert [view.name for view in scene.train] == ["shot_00_1", "shot_01_1", "shot_03_1"]
    assert any("have one exposure" in message for message in scene.messages)


def test_plain_pictures_without_exif_are_ldr(layouts: ModuleType, tmp_path: Path) -> None:
    images = {f"cam/view {i:03d}.png": i for i in range(3)}
    for file, i in images.items():
        layouts.save(tmp_path / "images" / file, layouts.draw(i, 0))
    layouts.write_sparse(tmp_path / "sparse" / "0", images, "txt")
    scene = read_scene(tmp_path)
    assert scene.train[1].exposures == (1.0,) and scene.train[1].name == "cam/view 002"
    assert any("no exposures are known" in message for message in scene.messages)
    assert_points_are_on_their_spots(layouts, scene)


def test_names_decide_the_split_only_as_words(layouts: ModuleType, tmp_path: Path) -> None:
    for names, test in (
        (["train/a.png", "test/b.png", "train/c.png"], ["test/b"]),
        (["latest_a.png", "latest_b.png", "trainer_c.png"], ["latest_b"]),  # no words: one between the others
        (["a_train.png", "b_train.png", "c_train.png"], ["b_train"]),  # pictures of a railway
    ):
        root = tmp_path / test[0].replace("/", "")
        for i, name in enumerate(names):
            layouts.save(root / "images" / name, layouts.draw(i, 0))
        layouts.write_sparse(root / "sparse" / "0", {name: i for i, name in enumerate(names)})
        assert [view.name for view in read_scene(root).test] == test


# ---- nerfstudio --------------------------------------------------------------------------------------


def test_nerfstudio_with_intrinsics_in_each_frame(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_nerfstudio(tmp_path / "data")
    content = json.loads((root / "transforms.json").read_text())
    for frame in content["frames"]:
        frame |= {key: content[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
        frame["exposure_time"] = 0.25
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        content[key] = 7.0
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    assert scene.train[0].exposures == (0.25,)
    assert "exposures from 'exposure_time' in transforms.json" in scene.messages
    assert_points_are_on_their_spots(layouts, scene)


def test_nerfstudio_with_names_that_go_out_of_the_folder_and_back(
    layouts: ModuleType, tmp_path: Path
) -> None:
    """Programs write names as seen from where they were called, absolute ones, and those of Windows."""
    root = layouts.write_nerfstudio(tmp_path / "data")
    content = json.loads((root / "transforms.json").read_text())
    written = ("./../data/{}", "{root}/{}", "images/../{}", "./{}", "{}")
    for k, frame in enumerate(content["frames"]):
        name = written[k % 5].format(frame["file_path"], root=root)
        frame["file_path"] = name.replace("/", "\\") if k == 4 else name
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    assert len(scene.train) + len(scene.test) == 9 and not any("skipped" in m for m in scene.messages)
    assert_points_are_on_their_spots(layouts, scene)


@pytest.mark.skipif(os.name == "nt", reason="links want a privilege there")
def test_nerfstudio_with_absolute_names_through_a_link(layouts: ModuleType, tmp_path: Path) -> None:
    """A data set on another disk, linked to: named as it was opened, or as it lies, and opened either way."""
    root = layouts.write_nerfstudio(tmp_path / "disk" / "data")
    (tmp_path / "link").symlink_to(root)
    content = json.loads((root / "transforms.json").read_text())
    for k, frame in enumerate(content["frames"]):
        frame["file_path"] = str((root, tmp_path / "link")[k % 2] / frame["file_path"])
    (root / "transforms.json").write_text(json.dumps(content))
    for opened in (root, tmp_path / "link"):
        scene = read_scene(opened)
        assert len(scene.train) + len(scene.test) == 9


def test_intrinsics_beside_exposures_are_those_of_transforms_json(
    layouts: ModuleType, tmp_path: Path
) -> None:
    """A camera that was measured, in HDR-NeRF-Syn's layout: two focal lengths, a middle beside, a lens."""
    root = layouts.write_syn(tmp_path, exposures=(0.5, 2.0))
    for path in root.glob("t*/r_*.png"):
        _, index, k = path.stem.split("_")
        layouts.save(path, layouts.draw(int(index), int(k)), alpha=True)
    measured = {"w": layouts.WIDTH, "h": layouts.HEIGHT, "fl_x": layouts.FX, "fl_y": layouts.FY}
    measured |= {"cx": layouts.CX, "cy": layouts.CY, "k2": None}
    for split in ("train", "test"):
        shutil.rmtree(root / f"{split}_hdr")
    for k1 in (0.0, -0.1):
        for path in root.glob("transforms_*.json"):
            path.write_text(json.dumps(json.loads(path.read_text()) | measured | {"k1": k1}))
        scene = read_scene(root)
        assert scene.layout == "HDR-NeRF-Syn"
        if k1 == 0.0:
            assert_points_are_on_their_spots(layouts, scene)
        assert any("the distortion of the lens" in told for told in scene.messages) == (k1 != 0.0)


@pytest.mark.parametrize("folder", ["test_hdr", "relit/level_0.25"])
def test_true_radiance_behind_a_lens_is_refused_beside_exposures(
    layouts: ModuleType, tmp_path: Path, folder: str
) -> None:
    """Pictures lose their distortion and radiance would not: HDR would compare two geometries."""
    root = layouts.write_syn(tmp_path, exposures=(0.5, 2.0))
    stated = {"w": layouts.WIDTH, "h": layouts.HEIGHT, "fl_x": layouts.FX}
    for k1 in (0.0, -0.1):
        for path in root.glob("transforms_*.json"):
            path.write_text(json.dumps(json.loads(path.read_text()) | stated | {"k1": k1}))
        if k1 == 0.0:
            read_scene(root)
    shutil.rmtree(root / "train_hdr")
    (root / "test_hdr").rename(tmp_path / "moved")
    assert read_scene(root).test
    (root / folder).parent.mkdir(exist_ok=True)
    (tmp_path / "moved").rename(root / folder)
    with pytest.raises(DataMismatchError, match=rf"OPENCV.*{folder}/.*\n.*move {folder}/ away"):
        read_scene(root)


@pytest.mark.parametrize(
    "beside",
    [
        {"fl_x": 800.0, "fl_y": 800.0, "cx": 400.0, "cy": 400.0, "k1": -0.1},  # of a picture of any size
        {"w": 1920, "h": 1080},
        {"w": 1920},
        {"w": "800", "h": "800", "fl_x": 800.0},
        {"w": None, "h": None, "fl_x": None},
        {"camera_angle_y": 0.3, "cx": 0.5, "cy": 0.5},
        {"camera_model": "PERSP"},
    ],
)
@pytest.mark.parametrize("in_frames", [False, True])
def test_intrinsics_of_no_stated_size_are_ignored_beside_exposures(
    layouts: ModuleType, tmp_path: Path, beside: dict[str, object], in_frames: bool
) -> None:
    """HDR-NeRF looks at camera_angle_x alone, so that what stands beside it may be of other pictures."""
    root = layouts.write_syn(tmp_path, exposures=(0.5, 2.0))
    for path in root.glob("transforms_*.json"):
        content = json.loads(path.read_text())
        for entry in content["frames"] if in_frames else [content]:
            entry.update(beside)
        path.write_text(json.dumps(content))
    assert_points_are_on_their_spots(layouts, read_scene(root))


def test_intrinsics_beside_exposures_are_of_the_size_that_is_stated(
    layouts: ModuleType, tmp_path: Path
) -> None:
    """Pictures that were reduced after their cameras were found; another shape is refused."""
    root = layouts.write_syn(tmp_path, exposures=(0.5, 2.0))
    width, height = 2 * layouts.WIDTH, 2 * layouts.HEIGHT
    for h, is_refused in ((height, False), (height // 2, True)):
        for path in root.glob("transforms_*.json"):
            stated = {"w": width, "h": h, "fl_x": 2 * layouts.FX, "cx": width / 2, "cy": height / 2}
            path.write_text(json.dumps(json.loads(path.read_text()) | stated))
        if is_refused:
            with pytest.raises(DataMismatchError, match=r"another shape\n.*'w' and 'h'"):
                read_scene(root)
        else:
            assert_points_are_on_their_spots(layouts, read_scene(root))


@pytest.mark.parametrize("lists", [("test",), ("val",), ("val", "test")])
def test_nerfstudio_never_trains_on_frames_that_are_listed_for_something_else(
    layouts: ModuleType, tmp_path: Path, lists: tuple[str, ...]
) -> None:
    """Without train_filenames: views that are held out would else be trained on and praise the result."""
    listed = {f"{split}_filenames": [f"images/frame_0000{k}.png"] for k, split in enumerate(lists, start=2)}
    scene = read_scene(layouts.write_nerfstudio(tmp_path, **listed))
    held_out = list(range(2, 2 + len(lists)))
    assert [view.index for view in scene.train] == [k for k in range(9) if k not in held_out]
    assert [view.index for view in scene.test] == held_out[-1:]
    assert [view.index for view in scene.validation] == held_out[:-1]
    assert scene.messages[0] == (
        f"split as {' and '.join(sorted(listed))} say: training on the other {9 - len(lists)} frames, "
        "because no list says which to train on"
    )


def test_nerfstudio_with_fields_of_view_lists_and_points(layouts: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "sparse_pc.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 0 51 255\n"
    )
    root = layouts.write_nerfstudio(
        tmp_path,
        camera_angle_x=2.0 * np.arctan(0.5 * layouts.WIDTH / layouts.FX),
        camera_angle_y=2.0 * np.arctan(0.5 * layouts.HEIGHT / layouts.FY),
        train_filenames=["images/frame_00001.png", "./images/frame_00002.png"],
        test_filenames=["images/frame_00005.png"],
        ply_file_path="sparse_pc.ply",
    )
    content = json.loads((root / "transforms.json").read_text())
    del content["fl_x"], content["fl_y"]
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    assert [view.index for view in scene.train] == [1, 2] and [view.index for view in scene.test] == [5]
    assert any("6 frames are in neither" in message for message in scene.messages)
    assert scene.points is not None and scene.points.positions.tolist() == [[1, 2, 3]]
    assert_points_are_on_their_spots(layouts, scene)
