# SPDX-License-Identifier: GPL-3.0-or-later
"""How files of a data set are called: as docs/formats.md says, and back again."""

import re
from pathlib import Path

import pytest

from physhdr.bridge import data_set
from physhdr.bridge.atomic import atomic_path
from physhdr.bridge.errors import BadValueError, FileDamagedError

ROOT = Path(__file__).parents[2]


def test_the_names_are_those_of_the_documentation() -> None:
    said = set(re.findall(r"`([^`]+)`", (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")))
    for split in data_set.SPLITS:
        assert {data_set.transforms_file(split), data_set.exposure_file(split)} <= said
    stem = data_set.pose_stem(data_set.TRAIN, 3)
    assert data_set.picture_file(stem, 0) in said and data_set.passes_file(data_set.TRAIN, 3) in said
    for split in (data_set.TRAIN, data_set.TEST):
        assert f"{data_set.truth_folder(split)}/{data_set.truth_file(3)}" in said
    for levels in ({"ambient": 0.25}, {"ambient": 4.0, "pendant": 0.25}):
        assert f"{data_set.mixture_folder(levels)}/{data_set.truth_file(3)}" in said
    assert {data_set.POINTS_FILE, data_set.INFO_FILE} <= said


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("./train/r_3_0.png", ("train/r_3", 0)),
        (".\\lit\\r_12_4.png", ("lit/r_12", 4)),
        ("r_3_0.jpg", None),
        ("train/r.png", None),
        ("train/r_" + "9" * 5000 + ".png", None),
    ],
)
def test_a_picture_tells_its_pose_and_place(name: str, parts: tuple[str, int] | None) -> None:
    assert data_set.stem_and_place(name) == parts


def test_a_validation_split_without_exposures_is_one_only_in_data_of_ours(tmp_path: Path) -> None:
    for name in ("transforms_train.json", "exposure_lit.json", "transforms_val.json"):
        (tmp_path / name).touch()
    assert data_set.splits_there(tmp_path) == ["train", "lit"]  # NeRF's own data have such a file
    (tmp_path / "dataset.json").touch()
    assert data_set.splits_there(tmp_path) == ["train", "lit", "val"]
    (tmp_path / "dataset.json").unlink()
    (tmp_path / "exposure_val.json").touch()
    assert data_set.splits_there(tmp_path) == ["train", "lit", "val"]


@pytest.mark.parametrize("beside", ["exposure_test.json", "dataset.json", "dataset.partial.json"])
def test_poses_alone_are_nerfs(tmp_path: Path, beside: str) -> None:
    (tmp_path / beside).touch()
    assert not data_set.is_layout(tmp_path)
    (tmp_path / "transforms_train.json").touch()
    assert data_set.is_layout(tmp_path)
    (tmp_path / beside).unlink()
    assert not data_set.is_layout(tmp_path)


def test_what_is_no_number_of_a_pose_is_none() -> None:
    assert [data_set.truth_number(name) for name in ("hdr_003.exr", "hdr_1234.exr")] == [3, 1234]
    for name in ("hdr_.exr", "hdr_x.exr", "hdr_003.png", "hdr_" + "9" * 5000 + ".exr"):
        assert data_set.truth_number(name) is None
    assert data_set.number_of("train/front") is None


@pytest.mark.parametrize("levels", [{"ambient": 1e6}, {"ambient": 1e6, "pendant": 1e-6}, {"a_lamp": 0.0}])
def test_a_folder_tells_the_levels_that_it_was_named_by(levels: dict[str, float]) -> None:
    assert data_set.mixture_levels(data_set.mixture_folder(levels)) == levels


def test_a_folder_of_another_name_tells_no_levels() -> None:
    for name in ("relit/level_high", "relit/notes", "relit/ambient_4+lamp"):
        assert data_set.mixture_levels(name) == {}


def test_only_our_own_versions_up_to_this_one_are_read(tmp_path: Path) -> None:
    assert data_set.read_info(tmp_path, "Fix it.") == {}
    path = tmp_path / data_set.INFO_FILE
    path.write_text('{"scene": "attic"}')
    assert data_set.scene_name(tmp_path, data_set.read_info(tmp_path, "Fix it.")) == "attic"
    path.write_text("{}")
    assert data_set.scene_name(tmp_path, data_set.read_info(tmp_path, "Fix it.")) == tmp_path.name
    for text, told in (
        ('{"format": "x"}', "format 'x'"),
        ('{"version": 2}', "version 2"),
        ('{"version": "1"}', "'version' must be a finite number"),
    ):
        path.write_text(text)
        with pytest.raises(BadValueError, match=told):
            data_set.read_info(tmp_path, "Fix it.")
    path.write_text("{")
    with pytest.raises(FileDamagedError, match="Fix it"):
        data_set.read_info(tmp_path, "Fix it.")


def test_renders_that_are_being_written_are_not_counted(tmp_path: Path) -> None:
    whole = tmp_path / data_set.passes_file(data_set.TRAIN, 3)
    whole.parent.mkdir()
    whole.touch()
    with atomic_path(tmp_path / data_set.passes_file(data_set.TRAIN, 4)):
        assert len(list(whole.parent.iterdir())) == 2
        assert data_set.passes_files(tmp_path) == [whole]
    assert len(data_set.passes_files(tmp_path)) == 2
