# SPDX-License-Identifier: GPL-3.0-or-later
"""The layout as docs/formats.md tells it, read by a program that knows nothing else: no import of physhdr.

Two data sets are rendered: the loop's own, and one that is not square and has two lights that vary.
"""

import hashlib
import json
import re
import shutil
import subprocess
from functools import cached_property
from pathlib import Path

import numpy as np
import OpenEXR
import plyfile
import pytest
from PIL import Image

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SKY = 1e9


class DataSet:
    """A data set as an outsider reads it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.info = self.json("dataset.json")

    def json(self, name: str):
        return json.loads((self.root / name).read_text(encoding="utf-8"))

    @cached_property
    def lights(self) -> list[str]:
        return self.info["lights"]

    @cached_property
    def splits(self) -> dict[str, dict]:
        names = [
            name for name in ("train", "test", "lit") if (self.root / f"transforms_{name}.json").exists()
        ]
        return {name: self.json(f"transforms_{name}.json") for name in names}

    @cached_property
    def frames(self) -> list[tuple[str, int, dict]]:
        """(split, number of the pose, its entry) of all poses."""
        return [
            (split, int(frame["file_path"].rpartition("_")[2]), frame)
            for split, content in self.splits.items()
            for frame in content["frames"]
        ]

    def levels(self, frame: dict) -> dict[str, float]:
        """Every light's level in a pose: 1 unless it says otherwise."""
        given = frame.get("lighting_levels") or {"ambient": frame.get("lighting_level", 1.0)}
        assert set(given) <= set(self.lights)
        return {light: given.get(light, 1.0) for light in self.lights}

    def rgb(self, path: str) -> np.ndarray:
        """[H, W, 3] of an EXR with R, G and B alone, 32 bit."""
        channels = exr(self.root / path)
        assert set(channels) == set("RGB"), (path, set(channels))
        return np.stack([channels[name] for name in "RGB"], -1)

    def passes(self, split: str, index: int) -> dict[str, np.ndarray]:
        """Layer → [H, W] or [H, W, 3]."""
        channels = exr(self.root / f"passes/{split}_{index:03d}.exr")
        layers: dict[str, np.ndarray] = {}
        for light in self.lights:
            layers[light] = np.stack([channels.pop(f"{light}.{c}") for c in "RGB"], -1)
        layers["normal"] = np.stack([channels.pop(f"normal.{c}") for c in "XYZ"], -1)
        layers |= {name.removesuffix(".V"): plane for name, plane in channels.items()}
        return layers

    def mixed(self, split: str, index: int, levels: dict[str, float]) -> np.ndarray:
        """Σ light × level."""
        layers = self.passes(split, index)
        return sum(layers[light].astype(np.float64) * levels.get(light, 1.0) for light in self.lights)


def exr(path: Path) -> dict[str, np.ndarray]:
    """Every channel, asserted to be 32-bit float."""
    (part,) = OpenEXR.File(str(path), separate_channels=True).parts
    planes = {name: np.asarray(channel.pixels) for name, channel in part.channels.items()}
    assert all(plane.dtype == np.float32 and np.isfinite(plane).all() for plane in planes.values()), path
    return planes


def png(path: Path) -> np.ndarray:
    """[H, W, 3] of an 8-bit RGBA PNG that is opaque."""
    with Image.open(path) as picture:
        assert picture.mode == "RGBA"
        pixels = np.asarray(picture)
    assert (pixels[..., 3] == 255).all()
    return pixels[..., :3]


@pytest.fixture(scope="module")
def two_lights(in_blender, tmp_path_factory) -> Path:
    """48×32, ambient light and the pendant vary in the lit views."""
    folder = tmp_path_factory.mktemp("layout") / "data"
    options = ["--resolution", "48x32", "--samples", 4, "--views", 6, "--lit-views", 4, "--relit-views", 1]
    in_blender(
        "synth/make_scene.py",
        "--out",
        folder,
        "--scene",
        "interior",
        *options,
        "--lit-lights",
        "ambient,pendant",
    )
    return folder


@pytest.fixture(scope="module", params=[pytest.param("loop", marks=pytest.mark.long), "two lights"])
def them(request) -> DataSet:
    return DataSet(request.getfixturevalue("data" if request.param == "loop" else "two_lights"))


# ---- what is there -----------------------------------------------------------------------------------


def test_every_file_that_is_told_is_there_and_no_other(them):
    exposures = them.info["exposures"]
    wanted = {"dataset.json", "points3d.ply"}
    for split, index, _ in them.frames:
        wanted |= {f"transforms_{split}.json", f"exposure_{split}.json"}
        wanted |= {f"{split}_hdr/hdr_{index:03d}.exr", f"passes/{split}_{index:03d}.exr"}
        wanted |= {f"{split}/r_{index}_{k}.png" for k in range(len(exposures))}
    for entry in them.info["relit"]:
        for index in them.info["lighting_levels"]["relit_views"]:
            wanted.add(f"{entry['folder']}/hdr_{index:03d}.exr")
    there = {path.relative_to(them.root).as_posix() for path in them.root.rglob("*") if path.is_file()}
    assert there == wanted


def test_dataset_json_says_what_the_files_say(them):
    info = them.info
    assert info["format"] == "physhdr-dataset" and info["version"] == 1
    assert info["working_space"] == "Linear Rec.709"
    counts = {split: len(content["frames"]) for split, content in them.splits.items()}
    assert {split: count for split, count in info["splits"].items() if count} == counts
    assert info["lights"][0] == "ambient" and len(info["lights"]) > 1
    width, height = info["resolution"]
    assert them.rgb("train_hdr/hdr_000.exr").shape == (height, width, 3)
    train = [
        them.rgb(f"train_hdr/hdr_{index:03d}.exr") for split, index, _ in them.frames if split == "train"
    ]
    luminance = np.stack(train).astype(np.float64) @ LUMINANCE
    low, high = np.percentile(luminance, 1), luminance.max()
    told = info["dynamic_range"]
    assert told["percentile_1"] == pytest.approx(low, rel=1e-5)
    assert told["maximum"] == pytest.approx(high, rel=1e-5)
    assert told["stops"] == pytest.approx(np.log2(high / low), abs=0.006)
    assert len(info["noise_floor"]["psnr"]) == len(info["exposures"])
    # Two renders with different seeds are never the same picture.
    assert info["noise_floor"]["hdr_psnr"] < 70 and min(info["noise_floor"]["psnr"]) < 60


def test_exposures_are_seconds_that_rise(them):
    expected = them.info["exposures"]
    assert expected == sorted(expected) and expected[0] > 0
    for split, content in them.splits.items():
        exposures = them.json(f"exposure_{split}.json")
        assert len(exposures) == len(content["frames"]) * len(expected)
        for frame in content["frames"]:
            assert [exposures[f"{frame['file_path']}_{k}.png"] for k in range(len(expected))] == expected


def test_the_hashes_are_those_of_the_files(them):
    assert set(them.info["frames"]) == {f"{split}/{index}" for split, index, _ in them.frames}
    for name, frame in them.info["frames"].items():
        split, _, index = name.partition("/")
        path = f"passes/{split}_{int(index):03d}.exr"
        assert frame["file"] == path
        assert frame["sha256"] == hashlib.sha256((them.root / path).read_bytes()).hexdigest()


def test_samples_and_noise_are_stated_for_each_pose(them):
    for split, index, _ in them.frames:
        told = them.info["frames"][f"{split}/{index}"]
        assert told["samples"] == pytest.approx(them.passes(split, index)["samples"].mean(), rel=1e-3)
        assert them.info["noise_threshold"] > 0 or told["samples"] == them.info["samples"]
        assert 5 < told["noise_psnr"] < 100


# ---- light -------------------------------------------------------------------------------------------


def test_true_radiance_is_the_sum_of_the_lights_at_their_levels(them):
    for split, index, frame in them.frames:
        told = them.rgb(f"{split}_hdr/hdr_{index:03d}.exr")
        np.testing.assert_allclose(told, them.mixed(split, index, them.levels(frame)), rtol=2e-6, atol=1e-9)


def test_relit_truth_is_the_sum_at_other_levels(them):
    assert them.info["relit"]
    for entry in them.info["relit"]:
        assert set(entry["levels"]) <= set(them.lights) and entry["levels"]
        if list(entry["levels"]) == ["ambient"]:
            assert entry["folder"] == f"relit/level_{entry['levels']['ambient']:g}"
        for index in them.info["lighting_levels"]["relit_views"]:
            told = them.rgb(f"{entry['folder']}/hdr_{index:03d}.exr")
            np.testing.assert_allclose(told, them.mixed("test", index, entry["levels"]), rtol=2e-6, atol=1e-9)
            standard = them.rgb(f"test_hdr/hdr_{index:03d}.exr")
            assert np.abs(np.log((told + 1e-4) / (standard + 1e-4))).mean() > 0.02  # another light


def test_every_light_lights(them):
    """No group is empty, and none is all of the light."""
    layers = [them.passes(split, index) for split, index, _ in them.frames if split == "train"]
    for light in them.lights:
        alone = np.mean([each[light].mean() for each in layers])
        together = np.mean([sum(each[name].mean() for name in them.lights) for each in layers])
        assert 1e-5 * together < alone < together
        assert all(each[light].min() >= 0 for each in layers)


def test_lit_views_have_levels_other_than_one(them):
    lit = them.splits["lit"]
    varied = lit.get("lights", ["ambient"])
    assert varied == them.info["lit_lights"]
    assert "lights" not in them.splits["train"]
    for frame in lit["frames"]:
        assert set(frame["lighting_levels"]) == set(varied)
        assert frame["lighting_level"] == frame["lighting_levels"].get("ambient", 1.0)
    for light in varied:
        assert len({frame["lighting_levels"][light] for frame in lit["frames"]}) > 1


def test_brackets_are_the_response_of_the_radiance(them):
    """To one code, by a formula that is written here."""
    assert them.info["response"]["name"] == "reinhard-gamma" and not them.info["camera_model"]
    at, code = them.info["response"]["anchor"]
    assert code == pytest.approx((at / (1 + at)) ** (1 / 2.2))
    for split, index, _ in them.frames:
        radiance = them.rgb(f"{split}_hdr/hdr_{index:03d}.exr").astype(np.float64)
        for k, seconds in enumerate(them.info["exposures"]):
            x = radiance * seconds
            expected = 255 * (x / (1 + x)) ** (1 / 2.2)
            picture = png(them.root / f"{split}/r_{index}_{k}.png")
            assert np.abs(picture - expected).max() <= 0.5 + 1e-6


# ---- geometry ----------------------------------------------------------------------------------------


def rays(them: DataSet, split: str, frame: dict) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] and directions [H, W, 3] in the world, one metre along the camera's axis (−Z; +Y is up)."""
    width, height = them.info["resolution"]
    focal = 0.5 * width / np.tan(0.5 * them.splits[split]["camera_angle_x"])
    x = (np.arange(width) + 0.5 - width / 2) / focal
    y = (height / 2 - np.arange(height) - 0.5) / focal
    local = np.stack([*np.meshgrid(x, y), np.full((height, width), -1.0)], -1)
    pose = np.array(frame["transform_matrix"])
    assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-5)
    assert np.linalg.det(pose[:3, :3]) > 0 and pose[3].tolist() == [0, 0, 0, 1]
    return pose[:3, 3], local @ pose[:3, :3].T


def seen_at(them: DataSet, split: str, frame: dict, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Depth [N] along the camera's axis, and row and column [N] of the pixels that points [N, 3] fall on."""
    width, height = them.info["resolution"]
    focal = 0.5 * width / np.tan(0.5 * them.splits[split]["camera_angle_x"])
    pose = np.array(frame["transform_matrix"])
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    depth = -local[:, 2]
    column = np.floor(width / 2 + focal * local[:, 0] / depth).astype(int)
    row = np.floor(height / 2 - focal * local[:, 1] / depth).astype(int)
    return depth, row, column


def on_surfaces(them: DataSet, points: np.ndarray) -> np.ndarray:
    """[N] whether some training view sees each point at its depth, within 2 %."""
    width, height = them.info["resolution"]
    found = np.zeros(len(points), bool)
    for split, index, frame in them.frames:
        if split == "train":
            depth, row, column = seen_at(them, split, frame, points)
            inside = (depth > 0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            plane = them.passes(split, index)["depth"]
            found[inside] |= np.abs(plane[row[inside], column[inside]] / depth[inside] - 1) < 0.02
    return found


def test_poses_angle_and_depth_put_surfaces_where_other_views_see_them(them):
    """What a test view sees, most training views see at the same place; with a pose mirrored none would."""
    split, index, frame = next(entry for entry in them.frames if entry[0] == "test")
    origin, directions = rays(them, split, frame)
    depth = them.passes(split, index)["depth"]
    there = depth < SKY
    points = origin + directions[there] * depth[there][:, None]
    assert on_surfaces(them, points).mean() > 0.9
    turned = {**frame, "transform_matrix": (np.array(frame["transform_matrix"]) * [-1, 1, 1, 1]).tolist()}
    pose = np.array(turned["transform_matrix"])
    mirrored = origin + ((points - origin) @ np.array(frame["transform_matrix"])[:3, :3]) @ pose[:3, :3].T
    assert on_surfaces(them, mirrored).mean() < 0.5


def test_points_lie_on_what_the_training_views_see(them):
    vertex = plyfile.PlyData.read(str(them.root / "points3d.ply"))["vertex"]
    names = {p.name: p.val_dtype for p in vertex.properties}
    assert names == {
        **dict.fromkeys(("x", "y", "z", "nx", "ny", "nz"), "f4"),
        **dict.fromkeys(("red", "green", "blue"), "u1"),
    }
    points = np.stack([vertex[axis] for axis in "xyz"], -1).astype(np.float64)
    assert len(points) > 100
    assert on_surfaces(them, points).mean() > 0.8
    normals = np.stack([vertex[axis] for axis in ("nx", "ny", "nz")], -1)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)


def test_normals_are_in_the_world_and_face_the_camera(them):
    for split, index, frame in them.frames[::3]:
        layers = them.passes(split, index)
        length = np.linalg.norm(layers["normal"], axis=-1)
        assert length.max() < 1.001
        whole = (length > 0.99) & (layers["depth"] < SKY)
        assert whole.mean() > 0.3
        _, directions = rays(them, split, frame)
        facing = (layers["normal"] * directions).sum(-1)[whole]
        assert (facing < 0).mean() > 0.97


def test_the_index_names_objects(them):
    numbers = them.info["objects"]
    known = {0, *numbers.values()}
    assert len(known) == len(numbers) + 1  # from 1, each once
    seen: set[float] = set()
    for split, index, _ in them.frames:
        seen |= set(np.unique(them.passes(split, index)["index"]).tolist())
    assert seen <= known and len(seen) > 3


# ---- other programs ----------------------------------------------------------------------------------


def kinds(root: Path) -> list[Path]:
    """One EXR of each kind."""
    folders = {path.parent: path for path in sorted(root.rglob("*.exr"))}
    return list(folders.values())


@pytest.mark.parametrize("command", [["exrinfo", "-v", "-s"], ["oiiotool", "--info", "-v", "--stats"]])
def test_other_programs_read_the_exrs(them, command):
    if not shutil.which(command[0]):
        pytest.skip(f"{command[0]} is not installed (Debian: openexr, openimageio-tools)")
    width, height = them.info["resolution"]
    for path in kinds(them.root):
        done = subprocess.run([*command, str(path)], capture_output=True, text=True, timeout=60)
        told = done.stdout + done.stderr
        # exrinfo 3.1.5 exits with a random status (seen: 0 and 222 for one file); its text is what counts.
        assert done.returncode == 0 or command[0] == "exrinfo", told
        assert "error" not in told.lower(), told
        for name in exr(path):
            assert re.search(rf"(^|[\s,'\"]){re.escape(name)}\b", told, re.MULTILINE), (name, told)
        if command[0] == "oiiotool":
            assert re.search(rf"\b{width} x +{height}, ", told), told
            for bad in ("NanCount", "InfCount"):
                (counts,) = re.findall(rf"Stats {bad}: ([\d ]+)", told)
                assert set(counts.split()) == {"0"}
