# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading a data set: what comes out, and one clear message for each way in which it can be broken."""

import json
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.scene import PictureCache
from physhdr.backend.scene.source import plain
from physhdr.bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    PhysHDRError,
)


def edit_json(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content, indent=1))


def refusal(root: Path, kind: type[PhysHDRError], *words: str) -> PhysHDRError:
    """Read, expect ``kind``, and every one of ``words`` in what the user sees, which must have a remedy."""
    with pytest.raises(kind) as caught:
        scene = read_scene(root)
        for view, k in scene.pictures():
            view.image(k)
    text = str(caught.value)
    for word in words:
        assert word in text, f"'{word}' is not in: {text}"
    assert caught.value.hint, f"no remedy in: {text}"
    return caught.value


# ---- what is read ------------------------------------------------------------------------------------


def test_a_data_set_is_read_whole(data_set: Path, small: ModuleType) -> None:
    scene = read_scene(data_set)
    assert [view.index for view in scene.train] == [0, 2, 4]
    assert [view.index for view in scene.test] == [1, 3]
    assert [view.lighting_levels for view in scene.lit] == [(0.25,), (4.0,)]
    assert scene.name == "small"
    assert scene.response_anchor == pytest.approx((1.0, 0.7297), abs=1e-4)
    view = scene.find("train", 2)
    assert view.exposures == small.EXPOSURES
    assert (view.camera.width, view.camera.height) == (small.WIDTH, small.HEIGHT)
    assert view.camera.fx == pytest.approx(0.5 * small.WIDTH / np.tan(0.4))
    np.testing.assert_array_equal(view.camera.camera_to_world, small.camera_to_world(2))
    expected = small.to_8_bit(small.response(small.radiance(2) * 8.0))
    np.testing.assert_array_equal(view.image(3), expected)
    assert view.image(3) is view.image(3), "decoded once"


def test_points_are_metres_and_colours_in_the_unit_range(data_set: Path) -> None:
    points = read_scene(data_set).points
    assert points is not None
    np.testing.assert_array_equal(points.positions, [[0, 0, 0.5], [1, 0, 0.5], [2, 0, 0.5], [3, 0, 0.5]])
    np.testing.assert_allclose(points.colours[1], [0.2, 0.0, 1.0], atol=1e-7)
    assert points.positions.dtype == points.colours.dtype == np.float32


def test_the_original_data_sets_have_less_and_are_read(small: ModuleType, tmp_path: Path) -> None:
    scene = read_scene(small.write_data_set(tmp_path / "dog", original=True))
    assert (len(scene.train), len(scene.test), len(scene.lit)) == (3, 2, 0)
    assert scene.name == "dog"
    assert scene.points is None and scene.response_anchor == (1.0, 0.73) and scene.info == {}


def test_nothing_of_the_true_radiance_is_needed(data_set: Path) -> None:
    for folder in ("train_hdr", "test_hdr", "lit_hdr", "relit"):
        shutil.rmtree(data_set / folder)
    assert len(read_scene(data_set).train) == 3


def test_exposures_that_no_pose_uses_are_ignored(data_set: Path) -> None:
    edit_json(data_set / "transforms_train.json", lambda content: content["frames"].pop())
    assert [view.index for view in read_scene(data_set).train] == [0, 2]


def test_the_picture_cache_forgets_the_oldest(data_set: Path) -> None:
    paths = plain(sorted((data_set / "train").glob("*.png")))
    size = 48 * 36 * 3
    cache = PictureCache(budget=3 * size)
    for path in paths:
        cache.get(path)
        assert cache.bytes_held <= 3 * size
    assert cache.get(paths[-1]) is cache.get(paths[-1])
    assert not cache.get(paths[0]).codes.flags.writeable


def test_an_unknown_pose_or_exposure_names_those_there_are(data_set: Path) -> None:
    scene = read_scene(data_set)
    with pytest.raises(BadValueError, match=r"no pose 7.*\n.*0, 2, 4"):
        scene.find("train", 7)
    with pytest.raises(BadValueError, match=r"no exposure 5.*\n.*0 to 4"):
        scene.train[0].image(5)


# ---- bad input: the folder ---------------------------------------------------------------------------


def test_missing_folder(tmp_path: Path) -> None:
    refusal(tmp_path / "nowhere", FileMissingError, "nowhere", "does not exist", "make_scene.py")


def test_empty_folder(tmp_path: Path) -> None:
    refusal(tmp_path, FileMissingError, str(tmp_path), "is empty", "exposure_train.json (HDR-NeRF-Syn)")


def test_a_folder_of_something_else(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    refusal(tmp_path, FileMissingError, "is not a data set", "transforms_train.json")


def test_a_file_instead_of_a_folder(data_set: Path) -> None:
    refusal(data_set / "dataset.json", FileMissingError, "dataset.json", "is a file", "folder of a data set")


# ---- bad input: JSON ---------------------------------------------------------------------------------


def test_missing_exposure_file(data_set: Path) -> None:
    (data_set / "exposure_train.json").unlink()
    refusal(data_set, FileMissingError, "exposure_train.json is missing", "Make the data set again")


def test_half_a_split_is_an_error(data_set: Path) -> None:
    (data_set / "transforms_lit.json").unlink()
    refusal(data_set, FileMissingError, "transforms_lit.json is missing")


def test_damaged_json_names_the_line(data_set: Path) -> None:
    path = data_set / "transforms_test.json"
    lines = path.read_text().splitlines()
    lines[4] = lines[4] + " oops"
    path.write_text("\n".join(lines))
    refusal(data_set, FileDamagedError, "transforms_test.json", "line 5", "Fix that line")


def test_binary_json(data_set: Path) -> None:
    (data_set / "exposure_test.json").write_bytes(b"\xff\xfe\x00\x01")
    refusal(data_set, FileDamagedError, "exposure_test.json", "cannot be read as JSON")


def test_json_of_another_kind(data_set: Path) -> None:
    (data_set / "exposure_test.json").write_text("[1, 2]")
    refusal(data_set, FileDamagedError, "exposure_test.json holds a list")


@pytest.mark.parametrize("key", ["camera_angle_x", "frames"])
def test_missing_key(data_set: Path, key: str) -> None:
    edit_json(data_set / "transforms_train.json", lambda content: content.pop(key))
    refusal(data_set, FileDamagedError, "transforms_train.json", f"has no '{key}'", "docs/formats.md")


@pytest.mark.parametrize("key", ["file_path", "transform_matrix"])
def test_missing_key_in_a_frame(data_set: Path, key: str) -> None:
    edit_json(data_set / "transforms_train.json", lambda content: content["frames"][1].pop(key))
    refusal(data_set, FileDamagedError, "transforms_train.json", "frame 1", f"has no '{key}'")


def test_lit_views_must_say_their_level(data_set: Path) -> None:
    edit_json(data_set / "transforms_lit.json", lambda content: content["frames"][0].pop("lighting_level"))
    refusal(data_set, FileDamagedError, "transforms_lit.json", "frame 0", "lit/r_0", "no 'lighting_level'")


def name_lights(data_set: Path, lights: object, levels: list[object], keep_ambient: bool = True) -> None:
    """Write ``lights`` and each lit frame's ``lighting_levels``, as docs/formats.md has them."""

    def change(content: dict) -> None:
        content["lights"] = lights
        for frame, named in zip(content["frames"], levels, strict=True):
            frame["lighting_levels"] = named
            if not keep_ambient:
                del frame["lighting_level"]

    edit_json(data_set / "transforms_lit.json", change)


def test_two_lights(data_set: Path) -> None:
    levels = [{"ambient": 0.25, "pendant": 2.0}, {"ambient": 4.0}]
    name_lights(data_set, ["ambient", "pendant"], levels)
    scene = read_scene(data_set)
    assert scene.lights == ("ambient", "pendant")
    assert [view.lighting_levels for view in scene.lit] == [(0.25, 2.0), (4.0, 1.0)]
    assert all(view.lighting_levels == (1.0, 1.0) for view in [*scene.train, *scene.test])
    assert scene.train[0].is_standard and not scene.lit[1].is_standard


def test_a_lamp_may_be_all_that_varies(data_set: Path) -> None:
    name_lights(data_set, ["pendant"], [{"pendant": 0.0}, {"pendant": 2.0, "ambient": 1}], keep_ambient=False)
    scene = read_scene(data_set)
    assert scene.lights == ("pendant",) and [view.lighting_levels for view in scene.lit] == [(0.0,), (2.0,)]


def test_without_names_it_is_the_ambient_light(data_set: Path) -> None:
    scene = read_scene(data_set)
    assert scene.lights == ("ambient",) and [v.lighting_levels for v in scene.lit] == [(0.25,), (4.0,)]


@pytest.mark.parametrize(
    ("lights", "levels", "kind", "words"),
    [
        ("ambient", {"ambient": 0.25}, BadValueError, ["list of names", "'ambient'"]),
        ([], {"ambient": 0.25}, BadValueError, ["list of names"]),
        (["ambient", 3], {"ambient": 0.25}, BadValueError, ["list of names"]),
        (["ambient", "ambient"], {"ambient": 0.25}, BadValueError, ["name twice"]),
        (["ambient", "lamp"], {"sun": 2}, BadValueError, ["frame 0", "no light 'sun'", "ambient, lamp"]),
        (["ambient", "lamp"], {"lamp": -1}, BadValueError, ["frame 0", "'lamp' is -1", "negative"]),
        (["ambient", "lamp"], {"lamp": "2"}, BadValueError, ["frame 0", "'lamp' must be a finite number"]),
        (["ambient", "lamp"], [1, 2], BadValueError, ["frame 0", "'lighting_levels'", "not an object"]),
        (["ambient", "lamp"], {"ambient": 3}, DataMismatchError, ["0.25", "has 3 for ambient"]),
        (["lamp"], {"lamp": 2}, BadValueError, ["no light 'ambient'", "It has: lamp"]),
    ],
)
def test_lights_that_mean_nothing(data_set: Path, lights, levels, kind, words) -> None:
    name_lights(data_set, lights, [levels, {}])
    refusal(data_set, kind, "transforms_lit.json", *words)


def test_lit_views_must_say_their_levels(data_set: Path) -> None:
    name_lights(data_set, ["ambient", "lamp"], [{"lamp": 2.0}, {}], keep_ambient=False)
    assert read_scene(data_set).lit[1].lighting_levels == (1.0, 1.0)  # said: none of them is changed
    edit_json(data_set / "transforms_lit.json", lambda content: content["frames"][1].pop("lighting_levels"))
    refusal(data_set, FileDamagedError, "transforms_lit.json", "frame 1", "no 'lighting_levels'")


@pytest.mark.parametrize("split", ["train", "test"])
def test_other_views_are_under_the_standard_light(data_set: Path, split: str) -> None:
    path = data_set / f"transforms_{split}.json"
    edit_json(path, lambda content: content["frames"][1].update(lighting_level=1.0))
    read_scene(data_set)
    edit_json(path, lambda content: content["frames"][1].update(lighting_levels={"ambient": 1, "lamp": 4}))
    refusal(data_set, BadValueError, path.name, "frame 1", "lamp 4", "at 1", "'lit'")


def test_no_frames(data_set: Path) -> None:
    edit_json(data_set / "transforms_train.json", lambda content: content.update(frames=[]))
    refusal(data_set, FileDamagedError, "transforms_train.json", "at least one frame")


def test_repeated_pose_number(data_set: Path) -> None:
    edit_json(
        data_set / "transforms_train.json", lambda content: content["frames"].append(content["frames"][0])
    )
    refusal(data_set, DataMismatchError, "transforms_train.json", "pose number 0", "without repetition")


@pytest.mark.parametrize("angle", [0.0, 4.0, float("nan"), "wide"])
def test_impossible_field_of_view(data_set: Path, angle: object) -> None:
    edit_json(data_set / "transforms_train.json", lambda content: content.update(camera_angle_x=angle))
    error = refusal(data_set, BadValueError, "transforms_train.json")
    assert "camera_angle_x" in str(error)


def test_dataset_json_of_the_future(data_set: Path) -> None:
    edit_json(data_set / "dataset.json", lambda content: content.update(version=2))
    refusal(data_set, BadValueError, "dataset.json", "version 2", "Update PhysHDR")


def test_bad_anchor(data_set: Path) -> None:
    edit_json(data_set / "dataset.json", lambda content: content["response"].update(anchor=[1.0, 1.0]))
    refusal(data_set, BadValueError, "dataset.json", "response.anchor", "neither black nor saturated")


# ---- bad input: poses --------------------------------------------------------------------------------


def spoil_pose(data_set: Path, row: int, column: int, value: float) -> None:
    def change(content: dict) -> None:
        content["frames"][1]["transform_matrix"][row][column] = value

    edit_json(data_set / "transforms_train.json", change)


def test_nan_pose(data_set: Path) -> None:
    spoil_pose(data_set, 0, 3, float("nan"))
    refusal(data_set, BadValueError, "transforms_train.json", "train/r_2", "NaN", "Fix 'transform_matrix'")


@pytest.mark.parametrize(
    ("row", "column", "value"),
    [(0, 0, 2.0), (0, 0, -1.0), (3, 3, 2.0)],
    ids=["scaled", "mirrored", "last row"],
)
def test_non_rigid_pose(data_set: Path, row: int, column: int, value: float) -> None:
    spoil_pose(data_set, row, column, value)
    refusal(
        data_set, BadValueError, "transforms_train.json", "train/r_2", "not a rotation", "scale and shear"
    )


def test_pose_that_is_no_matrix(data_set: Path) -> None:
    edit_json(
        data_set / "transforms_train.json",
        lambda content: content["frames"][0].update(transform_matrix=[[1, 2], "x"]),
    )
    refusal(data_set, BadValueError, "transforms_train.json", "train/r_0", "not a 4×4 matrix")


def test_names_of_any_length_are_cut_in_messages(data_set: Path) -> None:
    long = {"file_path": "./train/" + "x" * 5000, "transform_matrix": 5}
    edit_json(data_set / "transforms_train.json", lambda content: content["frames"][0].update(long))
    error = refusal(data_set, BadValueError, "transforms_train.json: frame 0 ('train/xx", "not a 4×4 matrix")
    assert len(error.message) < 500


def test_numbers_of_any_length_in_names(data_set: Path) -> None:
    """Python makes no number of more than 4300 digits."""
    name = "./train/r_" + "9" * 5000
    edit_json(data_set / "transforms_train.json", lambda content: content["frames"][0].update(file_path=name))
    refusal(data_set, PhysHDRError, "has exposures")
    edit_json(data_set / "exposure_train.json", lambda content: content.update({f"{name}.png": 1.0}))
    refusal(data_set, PhysHDRError, "exposure_train.json: './train/r_9", "is not of the form")


# ---- bad input: exposures ----------------------------------------------------------------------------


def test_pose_without_exposures(data_set: Path) -> None:
    edit_json(
        data_set / "exposure_train.json",
        lambda content: [content.pop(key) for key in list(content) if "r_2_" in key],
    )
    refusal(data_set, DataMismatchError, "exposure_train.json", "train/r_2", "none", "remove the pose")


def test_bracket_with_a_gap(data_set: Path) -> None:
    edit_json(data_set / "exposure_train.json", lambda content: content.pop("./train/r_2_1.png"))
    refusal(data_set, DataMismatchError, "exposure_train.json", "train/r_2", "[0, 2, 3, 4]")


def test_picture_without_exposure(data_set: Path) -> None:
    edit_json(data_set / "exposure_train.json", lambda content: content.pop("./train/r_2_4.png"))
    refusal(data_set, DataMismatchError, "exposure_train.json", "r_2_4.png", "remove the picture")


def test_brackets_of_different_length(data_set: Path) -> None:
    edit_json(data_set / "exposure_train.json", lambda content: content.pop("./train/r_2_4.png"))
    (data_set / "train" / "r_2_4.png").unlink()
    refusal(data_set, DataMismatchError, "exposure_train.json", "train/r_2", "has 4 exposures", "same number")


@pytest.mark.parametrize("seconds", [0.0, -1.0])
def test_exposure_that_is_not_positive(data_set: Path, seconds: float) -> None:
    edit_json(
        data_set / "exposure_train.json", lambda content: content.update({"./train/r_2_1.png": seconds})
    )
    words = ("exposure_train.json", "r_2_1.png", f"is {seconds:g} s", "longer than 0 s")
    refusal(data_set, BadValueError, *words)


@pytest.mark.parametrize("seconds", [float("inf"), "1/8", None, True])
def test_exposure_that_is_no_number(data_set: Path, seconds: object) -> None:
    edit_json(
        data_set / "exposure_train.json", lambda content: content.update({"./train/r_2_1.png": seconds})
    )
    refusal(data_set, BadValueError, "exposure_train.json", "r_2_1.png", "finite number")


def test_exposure_key_of_another_form(data_set: Path) -> None:
    edit_json(data_set / "exposure_train.json", lambda content: content.update({"nonsense": 1.0}))
    refusal(data_set, FileDamagedError, "exposure_train.json", "'nonsense'", "./train/r_3_0.png")


# ---- bad input: pictures -----------------------------------------------------------------------------


def test_missing_picture(data_set: Path) -> None:
    (data_set / "train" / "r_2_1.png").unlink()
    refusal(data_set, FileMissingError, "r_2_1.png is missing", "Restore the file")


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n", b"this is not a picture"])
def test_damaged_picture(data_set: Path, content: bytes) -> None:
    (data_set / "train" / "r_2_1.png").write_bytes(content)
    refusal(data_set, FileDamagedError, "r_2_1.png is not a readable PNG", "Delete it")


def test_truncated_picture_is_found_when_it_is_decoded(data_set: Path) -> None:
    path = data_set / "train" / "r_2_1.png"
    path.write_bytes(path.read_bytes()[:-120])
    scene = read_scene(data_set)  # the header is whole
    with pytest.raises(FileDamagedError, match=r"r_2_1.png is not a readable PNG[\s\S]*Delete it"):
        scene.find("train", 2).image(1)


def test_wrong_sized_picture_in_a_bracket(data_set: Path) -> None:
    Image.new("RGB", (8, 9)).save(data_set / "train" / "r_2_1.png")
    refusal(data_set, DataMismatchError, "r_2_1.png is 8×9", "r_2_0.png is 48×36", "one size")


def test_wrong_sized_bracket(data_set: Path) -> None:
    for k in range(5):
        Image.new("RGB", (8, 9)).save(data_set / "test" / f"r_3_{k}.png")
    refusal(data_set, DataMismatchError, "r_3_0.png is 8×9", "one size")


def test_picture_that_changed_after_opening(data_set: Path) -> None:
    scene = read_scene(data_set)
    Image.new("RGB", (8, 9)).save(data_set / "train" / "r_2_1.png")
    with pytest.raises(DataMismatchError, match=r"r_2_1.png is 8×9"):
        scene.find("train", 2).image(1)


# ---- bad input: points -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spoil",
    [
        lambda raw: b"",
        lambda raw: b"not a ply",
        lambda raw: raw[:-10],
        lambda raw: raw.replace(b"element vertex 4", b"element vertex 4000000000"),
        lambda raw: raw.replace(b"element vertex", b"element shmertex"),
        lambda raw: raw.replace(b"float x", b"float w"),
        lambda raw: raw.replace(b"uchar red", b"uchar rot"),
    ],
    ids=["empty", "text", "truncated", "bomb", "no vertices", "no x", "no colour"],
)
def test_damaged_points(data_set: Path, spoil) -> None:
    path = data_set / "points3d.ply"
    path.write_bytes(spoil(path.read_bytes()))
    refusal(data_set, FileDamagedError, "points3d.ply", "delete the file")


def test_nan_points(data_set: Path) -> None:
    path = data_set / "points3d.ply"
    raw = bytearray(path.read_bytes())
    raw[-27:-23] = np.float32("nan").tobytes()
    path.write_bytes(raw)
    refusal(data_set, FileDamagedError, "points3d.ply", "NaN")


def test_no_points(data_set: Path) -> None:
    path = data_set / "points3d.ply"
    header = path.read_bytes().split(b"end_header\n")[0].replace(b"vertex 4", b"vertex 0")
    path.write_bytes(header + b"end_header\n")
    refusal(data_set, FileDamagedError, "points3d.ply", "holds no points")
