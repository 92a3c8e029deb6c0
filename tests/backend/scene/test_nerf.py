# SPDX-License-Identifier: GPL-3.0-or-later
"""NeRF's synthetic scenes: split files without exposures. (Their cameras: test_layouts.py.)"""

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from physhdr.backend.inspect import inspect
from physhdr.backend.scene import read_scene
from physhdr.bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, PhysHDRError


@pytest.fixture
def lego(layouts: ModuleType, tmp_path: Path) -> Path:
    return layouts.write_nerf(tmp_path / "lego")


def edit(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_each_file_is_a_split_and_numbers_are_those_of_names(lego: Path) -> None:
    scene = read_scene(lego)
    names = {split: [view.name for view in views] for split, views in scene.splits.items()}
    assert names == {
        "train": ["train/r_0", "train/r_2", "train/r_4", "train/r_10"],  # not by text: r_10 is the last
        "test": ["test/r_1", "test/r_3"],
        "lit": [],
        "val": ["val/r_5"],
        "lit_test": [],
    }
    assert scene.find("test", 3).name == "test/r_3"
    assert scene.messages[0] == (
        "split as transforms_train.json, transforms_test.json, transforms_val.json say"
    )
    assert all(view.exposures == (1.0,) for views in scene.splits.values() for view in views)
    assert any("assuming 1 s for all pictures" in message for message in scene.messages)


def test_what_is_transparent_is_not_compared(layouts: ModuleType, lego: Path) -> None:
    view = read_scene(lego).test[0]
    mask = view.mask(0)
    assert (
        mask is not None and not mask[:, : layouts.WIDTH // 8].any() and mask[:, layouts.WIDTH // 8 :].all()
    )
    assert (view.image(0)[:, : layouts.WIDTH // 8] > 0).all()  # the colours are not composited


def test_beside_a_transforms_file_the_split_files_count(layouts: ModuleType, lego: Path) -> None:
    layouts.write_nerfstudio(lego)
    assert read_scene(lego).layout == "NeRF-Synthetic"


def test_intrinsics_of_a_file_are_of_its_frames_alone(lego: Path) -> None:
    edit(lego / "transforms_test.json", lambda c: c.update(fl_x=50.0, fl_y=51.0, cx=40.0, cy=30.0))
    scene = read_scene(lego)
    assert {view.camera.fx for view in scene.test} == {50.0}
    np.testing.assert_allclose([view.camera.fx for view in scene.train], 90.0)


def test_validation_views_that_are_test_views_are_none(lego: Path) -> None:
    (lego / "transforms_val.json").write_text((lego / "transforms_test.json").read_text())
    scene = read_scene(lego)
    assert [view.index for view in scene.test] == [1, 3] and scene.validation == []


def test_without_test_views_those_of_validation_are_the_test(lego: Path) -> None:
    (lego / "transforms_test.json").unlink()
    scene = read_scene(lego)
    assert [view.name for view in scene.test] == ["val/r_5"] and scene.validation == []


def test_they_are_renders_whose_camera_has_no_faults(lego: Path) -> None:
    assert not read_scene(lego).photographs


def test_inspect_finds_no_fault(lego: Path) -> None:
    found = inspect(lego)
    assert found.errors == [] and found.layout == "NeRF-Synthetic"
    assert {name: split.poses for name, split in found.splits.items()} == {"train": 4, "test": 2, "val": 1}


@pytest.mark.parametrize(
    ("change", "error", "words", "hint"),
    [
        (
            lambda root: edit(
                root / "transforms_test.json",
                lambda c: c["frames"].append(
                    json.loads((root / "transforms_train.json").read_text())["frames"][0]
                ),
            ),
            DataMismatchError,
            "'./train/r_0' is in transforms_train.json, too",
            "Remove it from one of them",
        ),
        (
            lambda root: edit(root / "transforms_test.json", lambda c: c.update(frames=[3])),
            FileDamagedError,
            "transforms_test.json: frame 0 is not an object: 3",
            "",
        ),
        (
            lambda root: edit(root / "transforms_test.json", lambda c: c["frames"][0].pop("file_path")),
            FileDamagedError,
            "transforms_test.json: frame 0 has no 'file_path'",
            "",
        ),
        (
            lambda root: edit(root / "transforms_val.json", lambda c: c.pop("camera_angle_x")),
            FileDamagedError,
            "frame 'val/r_5' has no focal length",
            "camera_angle_x",
        ),
        (
            lambda root: edit(root / "transforms_train.json", lambda c: c["frames"].clear()),
            DataMismatchError,
            "no frame is in",
            "",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_file(
    lego: Path, change: Callable[[Path], None], error: type[PhysHDRError], words: str, hint: str
) -> None:
    change(lego)
    with pytest.raises(error) as caught:
        read_scene(lego)
    assert words in caught.value.message and hint in caught.value.hint


def test_brackets_whose_exposures_were_lost_are_still_hdr_nerfs(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_syn(tmp_path / "data")
    for path in root.glob("exposure_*.json"):
        path.unlink()
    with pytest.raises(
        FileMissingError, match=r"exposure_train\.json is missing: train/r_0_0\.png"
    ) as caught:
        read_scene(root)
    assert "Copy it there" in caught.value.hint


def test_a_frame_without_a_picture_is_left_out_and_counted(lego: Path) -> None:
    (lego / "train" / "r_2.png").unlink()
    scene = read_scene(lego)
    assert [view.index for view in scene.train] == [0, 4, 10]
    assert any("1 of 7 frames have no picture: skipped (first: train/r_2)" in m for m in scene.messages)


def test_pictures_are_those_of_the_files(layouts: ModuleType, lego: Path) -> None:
    drawn = layouts.draw(10, 0, 1.0, (layouts.FX, layouts.FX, layouts.WIDTH / 2, layouts.HEIGHT / 2))
    np.testing.assert_array_equal(read_scene(lego).find("train", 10).image(0), drawn)
