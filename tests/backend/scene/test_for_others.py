# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets for other programs: read back by our readers, opened by pycolmap and by nerfstudio's own parsers.

nerfstudio's are run where PHYSHDR_NERFSTUDIO names a folder that its wheel is installed in, with what its
parsers import (docs/other-programs.md).
"""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.scene import Scene, View, read_scene
from physhdr.backend.scene.for_others import How, lay_out
from physhdr.backend.scene.pictures import read_codes, write_exr
from physhdr.bridge.data_set import MAKER
from physhdr.bridge.errors import BadValueError
from physhdr.lab.benchmark.roles import SEALED, role_of, room_of

#: In front of every camera of the tiny data set.
KNOWN_POINT = np.array([0.31, -0.27, 0.13])


def run(data: Path, out: Path, layout: str, *options: str) -> Path:
    assert main(["prepare", str(data), str(out), "--layout", layout, *options]) == 0
    return out


def in_order(views: list[View]) -> list[View]:
    return sorted(views, key=lambda view: view.name)


def projected(view: View, point: np.ndarray) -> np.ndarray:
    """``[2]``: by the pinhole formula, float64; the first pixel's centre is at ½."""
    x, y, z = (view.camera.world_to_camera @ [*point, 1.0])[:3]
    return np.array([view.camera.fx * x / z + view.camera.cx, view.camera.fy * y / z + view.camera.cy])


def require_alike(
    found: Scene, true: Scene, exposures: tuple[float, ...], splits: tuple[str, ...] = ("train", "test")
) -> None:
    for split in splits:
        ours, theirs = true.splits[split], in_order(found.splits[split])
        assert len(theirs) == len(ours) > 0
        for view, back in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(back.camera.camera_to_world, view.camera.camera_to_world, atol=1e-12)
            for name in ("width", "height", "fx", "fy", "cx", "cy"):
                assert getattr(back.camera, name) == getattr(view.camera, name)
            assert back.exposures == exposures
            for k, seconds in enumerate(exposures):
                at = view.exposures.index(seconds)
                np.testing.assert_array_equal(back.image(k), view.image(at))
    np.testing.assert_array_equal(found.points.positions, true.points.positions)
    np.testing.assert_allclose(found.points.colours, true.points.colours, atol=1e-6)
    assert found.response_anchor == true.response_anchor and found.name == true.name
    assert found.photographs == true.photographs


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap"])
def test_our_own_readers_read_it_back(tiny_data: Path, tmp_path: Path, layout: str, capsys) -> None:
    true = read_scene(tiny_data)
    all_of_it = true.train[0].exposures
    require_alike(read_scene(run(tiny_data, tmp_path / "one", layout)), true, all_of_it[2:3])
    assert "2 views under other light were ignored" in capsys.readouterr().out.replace("\n", " ")
    third = run(tiny_data, tmp_path / "three", layout, "--exposure", "3")
    require_alike(read_scene(third), true, all_of_it[3:4])
    require_alike(read_scene(run(tiny_data, tmp_path / "all", layout, "--brackets")), true, all_of_it)


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap"])
@pytest.mark.parametrize("source", ["syn", "real", "gausshdr", "hdr_gs", "colmap", "nerfstudio"])
def test_every_layout_that_is_read_can_be_written(tmp_path: Path, layouts, source: str, layout: str) -> None:
    data = getattr(layouts, f"write_{source}")(tmp_path / "data")
    out = run(data, tmp_path / "out", layout, "--brackets")
    true, found = read_scene(data), read_scene(out)
    for split in ("train", "test"):
        ours = sorted(true.splits[split], key=lambda view: view.index)
        for view, back in zip(ours, in_order(found.splits[split]), strict=True):
            np.testing.assert_allclose(
                projected(back, layouts.POINTS[0]), projected(view, layouts.POINTS[0]), atol=1e-6
            )
            assert back.exposures == view.exposures
            for k in range(len(view.exposures)):
                np.testing.assert_array_equal(back.image(k), view.image(k))
    assert found.response_anchor == true.response_anchor and found.photographs == true.photographs


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap"])
def test_what_it_was_rendered_from_stays_known(tiny_data: Path, tmp_path: Path, layout: str) -> None:
    """A user's own desk.blend is no built-in scene in another layout either, and a room of its own."""
    data = tmp_path / "data"
    shutil.copytree(tiny_data, data)
    info = json.loads((data / "dataset.json").read_text())
    info |= {"scene": "desk", "generator": {"name": MAKER}, "objects": {"Lamp": 1, "Top": 2}}
    own = info | {"source": {"file": "desk.blend", "scene": "Scene"}}
    for number, told in enumerate((info, own)):
        (data / "dataset.json").write_text(json.dumps(told))
        out = run(data, tmp_path / f"out{number}", layout)
        assert role_of(out) == role_of(data) == ("" if "source" in told else SEALED)
        assert room_of(out) == room_of(data)


def test_validation_views_are_nerfstudios(validation_data: Path, tmp_path: Path) -> None:
    out = run(validation_data, tmp_path / "n", "nerfstudio")
    content = json.loads((out / "transforms.json").read_text())
    assert content["val_filenames"] == [f"images/val_{index:03d}.png" for index in range(3)]
    lists = [content[f"{split}_filenames"] for split in ("train", "val", "test")]
    assert sorted(name for each in lists for name in each) == [
        frame["file_path"] for frame in content["frames"]
    ]
    true, found = read_scene(validation_data), read_scene(out)
    require_alike(found, true, true.train[0].exposures[2:3], ("train", "val", "test"))
    content["val_filenames"] = [*content["val_filenames"], content["test_filenames"][0]]
    (out / "transforms.json").write_text(json.dumps(content))
    found = read_scene(out)
    assert not found.validation and len(found.test) == len(true.test), "they must be other views"
    assert not list((run(validation_data, tmp_path / "c", "colmap") / "images").glob("val*"))


def test_without_a_view_that_is_held_out_nerfstudio_splits(tiny_data: Path, tmp_path: Path) -> None:
    """It takes lists that are there literally: of no test views none could be looked at while it trains."""
    whole = read_scene(tiny_data)
    for layout in ("nerfstudio", "colmap"):
        for name, scene in (("whole", whole), ("all", replace(whole, test=[]))):
            (out := tmp_path / layout / name).mkdir(parents=True)
            said = lay_out(scene, out, How(layout=layout))
            if layout == "nerfstudio":
                lists = [
                    key for key in json.loads((out / "transforms.json").read_text()) if "filenames" in key
                ]
            else:
                lists = [path.name for path in out.glob("*_list.txt")]
                assert len(read_scene(out).test) == len(scene.test), "by names"
            told = [line for line in said.messages if "--eval-mode all" in line]
            assert (len(lists), len(told)) == ((3, 0) if name == "whole" else (0, 1))


def test_pictures_are_linked_copied_or_made(tiny_data: Path, tmp_path: Path, layouts) -> None:
    linked = run(tiny_data, tmp_path / "linked", "nerfstudio", "--link") / "images" / "train_001.png"
    assert linked.samefile(tiny_data / "train" / "r_1_2.png"), "one file, where one disk has both"
    copied = run(tiny_data, tmp_path / "copied", "nerfstudio") / "images" / "train_001.png"
    assert not copied.samefile(linked) and copied.read_bytes() == linked.read_bytes()
    small = run(tiny_data, tmp_path / "small", "nerfstudio", "--downscale", "2") / "images" / "train_001.png"
    np.testing.assert_array_equal(
        np.array(Image.open(small)), read_scene(tiny_data, downscale=2.0).train[1].image(2)
    )

    see_through = np.dstack([layouts.draw(0, 0), np.full((layouts.HEIGHT, layouts.WIDTH), 255, np.uint8)])
    see_through[:9, :, 3] = 0
    data = layouts.write_nerfstudio(tmp_path / "data")
    Image.fromarray(see_through).save(data / "images" / "frame_00000.png")
    for layout in ("nerfstudio", "colmap"):
        out = run(data, tmp_path / f"masked-{layout}", layout)
        views = {view.name: view for view in read_scene(out).train}
        assert len(list((out / "masks").iterdir())) == len(list((out / "images").iterdir())), "all or none"
        view = views["images/train_000" if layout == "nerfstudio" else "train_000"]
        np.testing.assert_array_equal(view.image(0), see_through[..., :3])
        np.testing.assert_array_equal(view.mask(0), see_through[..., 3] > 0)


@pytest.mark.parametrize(
    ("suffix", "mode"),
    [("png", "L"), ("png", "P"), ("png", "1"), ("jpg", "L"), ("jpg", "RGB"), ("png", "RGB")],
)
def test_what_is_written_has_three_channels(tmp_path: Path, layouts, suffix: str, mode: str) -> None:
    data = layouts.write_nerfstudio(tmp_path / "data")
    for path in sorted((data / "images").iterdir()):
        picture = Image.open(path).convert(mode)
        path.unlink()
        picture.save(path.with_suffix(f".{suffix}"))
    transforms = data / "transforms.json"
    transforms.write_text(transforms.read_text().replace(".png", f".{suffix}"))
    out = run(data, tmp_path / "out", "nerfstudio")
    written = {path.stem: path for path in (out / "images").iterdir()}
    for view in read_scene(data).train:
        path = written[f"train_{view.index:03d}"]
        assert path.suffix == (f".{suffix}" if mode == "RGB" else ".png")
        with Image.open(path) as picture:
            assert picture.mode == "RGB"
            if path.suffix == ".png":
                np.testing.assert_array_equal(np.array(picture), view.image(0))


def test_pycolmap_sees_a_point_where_our_cameras_do(tiny_data: Path, tmp_path: Path) -> None:
    out = run(tiny_data, tmp_path / "out", "colmap", "--brackets", "--exposure", "1")
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    true = read_scene(tiny_data)
    views = {
        f"{split}_{view.index:03d}_1.png": view for split in ("train", "test") for view in true.splits[split]
    }
    assert {image.name for image in model.images.values()} == set(views)
    for image in model.images.values():
        found = image.project_point(KNOWN_POINT)
        np.testing.assert_allclose(found, projected(views[image.name], KNOWN_POINT), atol=1e-9)
        assert (out / "images" / image.name).is_file()
    assert len(model.points3D) == len(true.points.positions)
    assert len(list((out / "images").iterdir())) == 5 * len(views), "the brackets lie beside"


def test_what_gsplats_loader_asks_of_pycolmap(tiny_data: Path, tmp_path: Path) -> None:
    """The calls of its ``examples/datasets/colmap.py``, which is no package, in their order."""
    out = run(tiny_data, tmp_path / "out", "colmap")
    manager = pycolmap.Reconstruction(str(out / "sparse/0/"))
    matrices, names = [], []
    for number in manager.images:
        image = manager.images[number]
        matrices.append(np.vstack([image.cam_from_world().matrix(), [0.0, 0.0, 0.0, 1.0]]))
        names.append(image.name)
        camera = manager.cameras[image.camera_id]
        assert camera.model == pycolmap.CameraModelId.PINHOLE
        assert list(image.get_observation_points2D()) == []
    files = sorted(path.name for path in (out / "images").iterdir())
    assert sorted(names) == files, "it pairs sorted names with sorted files"
    poses = np.linalg.inv(np.stack(matrices))[np.argsort(names)]
    scene = read_scene(tiny_data)
    ours = [view.camera.camera_to_world @ np.diag([1, -1, -1, 1]) for view in [*scene.test, *scene.train]]
    np.testing.assert_allclose(poses, ours, atol=1e-12)
    intrinsics = manager.cameras[1].calibration_matrix()
    camera = scene.train[0].camera
    np.testing.assert_array_equal(
        intrinsics, [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    )
    in_order = [manager.points3D[number] for number in sorted(manager.points3D.keys())]
    points = np.array([point.xyz for point in in_order], np.float32)
    np.testing.assert_array_equal(points, scene.points.positions)
    colours = np.array([point.color for point in in_order], np.uint8)
    np.testing.assert_array_equal(colours, np.rint(255.0 * scene.points.colours))


def test_a_bent_lens_is_straight_afterwards(tmp_path: Path, layouts) -> None:
    """Of a folder with a lens that bends lines what is written is a pinhole's, and its spots fit it."""
    distortion = (-0.05, 0.01, 0.0, 0.0)
    intrinsics = (layouts.FX, layouts.FY, layouts.CX, layouts.CY)
    lens = {"model": "OPENCV", "params": (*intrinsics, *distortion)}
    data = layouts.write_colmap(tmp_path / "data", poses=9, suffix="png", exif=False, **lens)
    seconds = {path.name: 2.0 ** int(path.stem[-1]) for path in (data / "images").iterdir()}
    (data / "exposure.json").write_text(json.dumps(seconds))
    real = pycolmap.Camera(
        model="OPENCV", width=layouts.WIDTH, height=layouts.HEIGHT, params=(*intrinsics, *distortion)
    )
    y, x = np.mgrid[0 : layouts.HEIGHT, 0 : layouts.WIDTH] + 0.5
    for path in (data / "images").iterdir():
        index, k = int(path.stem[5:7]), int(path.stem[-1])
        rotation, translation = layouts.world_to_camera(index)
        seen = layouts.POINTS @ rotation.T + translation
        picture = np.empty((layouts.HEIGHT, layouts.WIDTH, 3))
        for channel, (u, v) in enumerate(real.img_from_cam(seen)):
            distance = ((x - u) ** 2 + (y - v) ** 2) / layouts.SPOT**2
            picture[..., channel] = layouts.background(k) + layouts.PEAK * np.exp(-0.5 * distance)
        Image.fromarray(np.round(picture).astype(np.uint8)).save(path)

    out = run(data, tmp_path / "out", "colmap")
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    assert {camera.model for camera in model.cameras.values()} == {pycolmap.CameraModelId.PINHOLE}
    for image in model.images.values():
        picture = np.array(Image.open(out / "images" / image.name))
        expected = [image.project_point(point) for point in layouts.POINTS]
        np.testing.assert_allclose(layouts.spots(picture, 1), expected, atol=0.1)


def test_radiance_is_developed(tmp_path: Path, layouts) -> None:
    """What other programs cannot read is the sRGB curve of exposure × radiance, clipped, with 16 bits."""
    data = layouts.write_nerfstudio(tmp_path / "data", w=16, h=12)
    content = json.loads((data / "transforms.json").read_text())
    exposed = np.geomspace(0.01, 4.0, 12 * 16 * 3).reshape(12, 16, 3)
    for frame in content["frames"]:
        (data / frame["file_path"]).unlink()
        frame["file_path"] = frame["file_path"].replace(".png", ".exr")
        frame["exposure_time"] = 0.5
        write_exr(data / frame["file_path"], exposed)
    (data / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(data)
    (tmp_path / "out").mkdir()
    said = lay_out(scene, tmp_path / "out", How(layout="colmap"))
    assert said.made == len(content["frames"]) and any("clip at 1" in line for line in said.messages)
    codes, _ = read_codes(next((tmp_path / "out" / "images").iterdir()))
    assert codes.dtype == np.uint16
    srgb = np.where(exposed <= 0.0031308, 12.92 * exposed, 1.055 * exposed ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(codes / 65535.0, srgb.clip(0.0, 1.0), atol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--exposure", "7"), r"no training view has exposure 7\n.*0, 1, 2, 3, 4"),
        (("--exposure", "-1"), "--exposure counts from 0"),
        (("--brackets", "--exposure", "1"), "--exposure is one picture per pose"),
    ],
)
def test_what_cannot_be_written(tiny_data: Path, tmp_path: Path, options, message, capsys) -> None:
    assert main(["prepare", str(tiny_data), str(tmp_path / "out"), "--layout", "nerfstudio", *options]) == 1
    assert re.search(message, capsys.readouterr().err) and not (tmp_path / "out").exists()


def test_a_folder_that_holds_something_stays(tiny_data: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["prepare", str(tiny_data), str(tmp_path), "--layout", "colmap"]) == 1
    assert "is not empty" in capsys.readouterr().err and [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_names_tell_ten_exposures(tiny_data: Path, tmp_path: Path) -> None:
    scene = read_scene(tiny_data)
    view = scene.train[0]
    longer = replace(view, exposures=view.exposures[:2], sources=view.sources[:2], bracket=(0, 11))
    with pytest.raises(BadValueError, match="up to 12 exposures"):
        lay_out(replace(scene, train=[longer]), tmp_path, How(layout="colmap", brackets=True))


# ---- nerfstudio's own parsers ----------------------------------------------------------------------------

NERFSTUDIO = os.environ.get("PHYSHDR_NERFSTUDIO")
PARSE = """
import json, sys
from pathlib import Path
from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig
from nerfstudio.data.dataparsers.colmap_dataparser import ColmapDataParserConfig
NAMES = ("fx", "fy", "cx", "cy", "width", "height")
kind, data, as_is = sys.argv[1], Path(sys.argv[2]), sys.argv[3] == "as-is"
options = dict(orientation_method="none", center_method="none", auto_scale_poses=False) if as_is else {}
options["load_3D_points"] = True  # as splatfacto has it
if kind == "colmap":
    options["colmap_path"] = Path("sparse/0")
    if as_is:
        options["assume_colmap_world_coordinate_convention"] = False
config = (ColmapDataParserConfig if kind == "colmap" else NerfstudioDataParserConfig)(data=data, **options)
parser, found = config.setup(), {}
for split in ("train", "val", "test"):
    out = parser.get_dataparser_outputs(split)
    cameras = out.cameras
    found[split] = {
        "files": [Path(name).name for name in out.image_filenames],
        "poses": cameras.camera_to_worlds.tolist(),
        "intrinsics": [[float(getattr(cameras, name)[i]) for name in NAMES] for i in range(len(cameras))],
        "masks": [str(name) for name in out.mask_filenames or []],
        "points": out.metadata["points3D_xyz"].tolist(),
        "colours": out.metadata["points3D_rgb"].tolist(),
        "transform": out.dataparser_transform.tolist(),
        "scale": out.dataparser_scale,
    }
Path(sys.argv[4]).write_text(json.dumps(found))
"""


def parsed(kind: str, data: Path, how: str, answer: Path) -> dict:
    # After the packages of this environment, of which torch and numpy are taken.
    code = f"import sys; sys.path.append({NERFSTUDIO!r})\n{PARSE}"
    command = [sys.executable, "-c", code, kind, str(data), how, str(answer)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(answer.read_text())


@pytest.mark.skipif(
    not NERFSTUDIO, reason="PHYSHDR_NERFSTUDIO names no folder with nerfstudio (docs/other-programs.md)"
)
@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
@pytest.mark.parametrize("how", ["as-is", "by-default"])
def test_nerfstudios_own_parser_opens_it(tiny_data: Path, tmp_path: Path, kind: str, how: str) -> None:
    """``how``: its world left as it is, or oriented, centred and scaled, as ``ns-train`` does."""
    found = parsed(kind, run(tiny_data, tmp_path / "out", kind), how, tmp_path / "answer.json")
    scene = read_scene(tiny_data)
    suffix = "_0.png" if kind == "colmap" else ".png"
    for split, views in (("train", scene.train), ("val", scene.test), ("test", scene.test)):
        told = found[split]
        its = "test" if split == "val" else split
        assert told["files"] == [f"{its}_{view.index:03d}{suffix}" for view in views]
        transform, scale = np.array(told["transform"]), told["scale"]
        assert how != "as-is" or (scale == 1.0 and np.array_equal(transform, np.eye(4)[:3]))
        for view, pose, intrinsics in zip(views, told["poses"], told["intrinsics"], strict=True):
            expected = transform[:, :3] @ view.camera.camera_to_world[:3]
            expected[:, 3] = scale * (expected[:, 3] + transform[:, 3])
            np.testing.assert_allclose(pose, expected, atol=2e-6)
            camera = view.camera
            np.testing.assert_allclose(
                intrinsics, [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height]
            )
        expected = scale * (scene.points.positions @ transform[:, :3].T + transform[:, 3])
        np.testing.assert_allclose(told["points"], expected, atol=2e-6)
        # It truncates 255 × what it has divided by 255.
        np.testing.assert_allclose(told["colours"], 255.0 * scene.points.colours, atol=1.001)


@pytest.mark.skipif(not NERFSTUDIO, reason="PHYSHDR_NERFSTUDIO names no folder with nerfstudio")
def test_nerfstudio_takes_each_picture_of_a_bracket_for_a_view(tiny_data: Path, tmp_path: Path) -> None:
    out = run(tiny_data, tmp_path / "out", "nerfstudio", "--brackets")
    found = parsed("nerfstudio", out, "as-is", tmp_path / "answer.json")
    assert found["train"]["files"] == [f"train_{i:03d}_{k}.png" for i in range(3) for k in range(5)]


# ---- brackets in transforms.json -------------------------------------------------------------------------


def frames_named_like_brackets(layouts, root: Path, seconds: tuple[float, ...], moved: bool = False) -> Scene:
    """Nine frames of three poses, named ``shot_<pose>_<k>``; ``moved``: each has a camera of its own."""
    data = layouts.write_nerfstudio(root)
    content = json.loads((data / "transforms.json").read_text())
    frames = sorted(content["frames"], key=lambda frame: frame["file_path"])
    for number, frame in enumerate(frames):
        name = f"images/shot_{number // 3}_{number % 3}.png"
        (data / frame["file_path"]).rename(data / name)
        frame["file_path"], frame["exposure_time"] = name, seconds[number % 3]
        if not moved:
            frame["transform_matrix"] = frames[number - number % 3]["transform_matrix"]
    (data / "transforms.json").write_text(json.dumps(content))
    return read_scene(data)


def test_frames_are_brackets_only_where_all_says_so(tmp_path: Path, layouts) -> None:
    def views(scene: Scene) -> list[tuple[float, ...]]:
        return [view.exposures for view in [*scene.train, *scene.test]]

    bracket = (0.5, 2.0, 8.0)
    assert views(frames_named_like_brackets(layouts, tmp_path / "a", bracket)) == [bracket] * 3
    assert len(views(frames_named_like_brackets(layouts, tmp_path / "b", bracket, moved=True))) == 9
    assert len(views(frames_named_like_brackets(layouts, tmp_path / "c", (0.5, 2.0, 2.0)))) == 9
