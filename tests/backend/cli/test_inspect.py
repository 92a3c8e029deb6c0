# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr inspect``: what it says of a whole data set, and of each kind of damage."""

import dataclasses
import hashlib
import io
import json
import math
import shutil
import sys
from contextlib import suppress

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.cli.inspect import Inspect
from physhdr.backend.inspect import inspect
from physhdr.backend.runs.terminal import console
from physhdr.backend.scene.pictures import read_exr, write_exr
from physhdr.bridge.data_set import CAPTURE_FILE, CAPTURE_FORMAT
from physhdr.bridge.errors import DataMismatchError
from physhdr.lab.benchmark.facts import scene_line
from physhdr.tests.backend.scene import layouts


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch):
    monkeypatch.setattr(console, "width", 160)


@pytest.fixture
def data(tiny_data, tmp_path):
    """A copy of the tiny data set that a test may damage."""
    return shutil.copytree(tiny_data, tmp_path / "data")


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_everything_of_a_whole_data_set_is_told(tiny_data, capsys):
    assert main(["inspect", str(tiny_data)]) == 0
    printed = capsys.readouterr().out
    assert "tiny" in printed and "32×32" in printed
    assert "3 poses, true HDR of 3" in printed and "ambient at 0.25, 4" in printed
    assert "ambient × 0.5: test poses 0" in printed
    assert "exp1 and exp3" in printed and "not measured" in printed
    rows = [line.split() for line in printed.splitlines() if line.strip()[:1].isdigit()]
    assert [row[1:3] for row in rows] == [
        ["0.125", "-3"],
        ["0.5", "-1"],
        ["2", "+1"],
        ["8", "+3"],
        ["32", "+5"],
    ]
    assert ["(OE)" in row for row in rows] == [True, False, True, False, True]


def test_what_a_code_page_lacks_is_escaped(tiny_data, tmp_path, monkeypatch):
    """As in a pipe or a file on Windows: neither a user's letters nor our own arrows end the command."""
    data = shutil.copytree(tiny_data, tmp_path / "Юрій → 🎬")
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="cp1252"))
    assert main(["inspect", str(data)]) == 0
    sys.stdout.flush()
    told = written.getvalue().decode("cp1252")
    assert "32×32" in told and "\\u042e\\u0440\\u0456\\u0439 \\u2192 \\U0001f3ac" in told


def test_validation_views_and_both_floors_are_told(validation_data, tmp_path, capsys):
    data = shutil.copytree(validation_data, tmp_path / "data")
    floors = {
        "noise_floor": {"view": 1, "seeds": [5, 6], "psnr": [46.5, 47.25], "hdr_psnr": 45.5},
        "reference_floor": {"view": 1, "seed": 7, "samples": 65536, "psnr": [48.5, 49.0], "hdr_psnr": 47.5},
    }
    frames = {
        f"{split}/{k}": {"file": f"passes/{split}_{k:03d}.exr", "samples": samples, "noise_psnr": 30.0}
        for split, samples in (("train", 256), ("test", 4096), ("val", 4096))
        for k in range(3)
    }
    counts = {"train": 3, "test": 3, "lit": 2, "val": 3}
    edit(data / "dataset.json", lambda info: info.update(floors, frames=frames, splits=counts))
    assert main(["inspect", str(data)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "val 3 poses, true HDR of 3" in printed and "lit, val" in printed
    assert "noise floor 46.5, 47.25 dB at the exposures, HDR 45.5 dB" in printed
    assert "reference floor 48.5, 49 dB at the exposures, HDR 47.5 dB (65536 samples), not" in printed
    assert "train 256, test 4096, val 4096 samples a pixel" in printed
    line = scene_line("night", dataclasses.asdict(inspect(data)))
    assert line.startswith("night (tiny): 32×32, 3 train, 3 test, 2 lit, 3 val, ")
    assert (
        "train 256, test 4096, val 4096 samples a pixel, two renders of a test view agree to 46.5, 47" in line
    )
    assert (
        "the stored one and one without denoising to 48.5, 49 dB at the exposures, HDR 47.5 dB (65536" in line
    )
    for name in [name for name in frames if not name.startswith("train")]:
        frames[name] = {"file": f"{name.partition('/')[0]}_hdr/hdr_000.exr", "kept": True}
    edit(data / "dataset.json", lambda info: info.update(frames=frames, test_samples=8192))
    assert inspect(data).samples == {"train": [256] * 3, "test": [8192], "val": [8192]}
    (data / "val" / "r_1_2.png").unlink()
    (data / "val_hdr" / "hdr_002.exr").unlink()
    assert len(inspect(data).errors) == 2
    for name in ("transforms_test.json", "exposure_test.json"):
        (data / name).unlink()
    (error,) = [error for error in inspect(data).errors if " states " in error]
    assert "3 test poses" in error


def test_json_is_for_programs_and_agrees_with_the_truth(tiny_data, capsys):
    assert main(["inspect", str(tiny_data), str(tiny_data), "--json"]) == 0
    first, second, last = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert last == {"result": {"folders": 2}}
    first, second = first["found"], second["found"]
    assert first == second and first["errors"] == [] and first["resolution"] == [32, 32]
    assert first["splits"]["lit"] == {"poses": 2, "levels": {"ambient": [0.25, 4.0]}, "hdr": 2}
    luminance = np.stack([read_exr(tiny_data / "train_hdr" / f"hdr_{k:03d}.exr") for k in range(3)])
    luminance = luminance @ np.array([0.2126, 0.7152, 0.0722])
    expected = math.log2(luminance.max() / np.percentile(luminance, 1))
    assert first["dynamic_range"]["stops"] == pytest.approx(expected, abs=0.006)
    for k, exposure in enumerate(first["exposures"]):
        pixels = np.stack([Image.open(tiny_data / "train" / f"r_{i}_{k}.png") for i in range(3)])[..., :3]
        assert exposure["white"] == pytest.approx((pixels.max(-1) == 255).mean(), abs=1e-5)
        assert exposure["black"] == pytest.approx((pixels.max(-1) == 0).mean(), abs=1e-5)


def test_without_true_radiance_the_range_is_an_estimate_and_said_to_be_one(data, capsys):
    truth = inspect(data).dynamic_range
    shutil.rmtree(data / "train_hdr")
    estimate = inspect(data).dynamic_range
    assert estimate.estimated and not truth.estimated
    assert estimate.stops == pytest.approx(truth.stops, abs=1.0)
    assert main(["inspect", str(data)]) == 0
    assert "an estimate from the pictures" in capsys.readouterr().out


def test_a_folder_as_hdr_nerf_left_it_is_understood(data):
    """No dataset.json, no lit, no relit, no points."""
    (data / "dataset.json").unlink()
    for name in ("transforms_lit.json", "exposure_lit.json", "points3d.ply"):
        (data / name).unlink()
    for name in ("lit", "lit_hdr", "relit", "train_hdr", "test_hdr"):
        shutil.rmtree(data / name)
    found = inspect(data)
    assert found.errors == [] and found.scene == "data" and found.resolution == (32, 32)
    assert list(found.splits) == ["train", "test"] and found.relit == [] and found.points is None
    assert found.dynamic_range.estimated


def test_several_lights_are_told(data):
    """The layout of several lights as channels (docs/formats.md)."""

    def two_lights(content):
        content["lights"] = ["ambient", "lamp"]
        for frame, lamp in zip(content["frames"], (1.0, 2.0), strict=True):
            frame["lighting_levels"] = {"ambient": frame["lighting_level"], "lamp": lamp}

    edit(data / "transforms_lit.json", two_lights)
    levels = {"ambient": 4, "lamp": 0.25}
    shutil.copytree(data / "relit" / "level_2", data / "relit" / "ambient_4+lamp_0.25")
    entries = [{"folder": "relit/level_0.5", "levels": {"ambient": 0.5}}]
    entries.append({"folder": "relit/ambient_4+lamp_0.25", "levels": levels})
    edit(data / "dataset.json", lambda content: content.update(lights=["ambient", "lamp"], relit=entries))
    found = inspect(data)
    assert found.lights == ["ambient", "lamp"]
    assert found.splits["lit"].levels == {"ambient": [0.25, 4.0], "lamp": [1.0, 2.0]}
    by_folder = {entry["folder"]: entry["levels"] for entry in found.relit}
    assert by_folder["relit/ambient_4+lamp_0.25"] == levels
    assert by_folder["relit/level_2"] == {"ambient": 2.0}  # there, though dataset.json does not name it
    assert found.errors == []


def test_passes_are_read_and_their_hashes_compared(data, capsys):
    (data / "passes").mkdir()
    frames = {}
    for k in range(3):
        path = data / "passes" / f"train_{k:03d}.exr"
        write_exr(path, np.full((32, 32, 3), 0.5 + k))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        told = {"file": f"passes/{path.name}", "sha256": digest, "samples": 8 + k, "noise_psnr": 30.5}
        frames[f"train/{k}"] = told
    edit(data / "dataset.json", lambda content: content.update(frames=frames))
    found = inspect(data)
    assert found.errors == [] and found.warnings == [] and found.passes == 3
    assert main(["inspect", str(data)]) == 0
    assert "8 … 10 samples a pixel, noise 30.5 dB" in capsys.readouterr().out
    write_exr(data / "passes" / "train_001.exr", np.full((32, 32, 3), 0.25))
    (data / "passes" / "train_002.exr").unlink()
    found = inspect(data)
    (error,) = found.errors
    assert "passes/train_001.exr was changed" in error
    assert any("1 of 3 passes are missing" in warning for warning in found.warnings)


def test_every_fault_is_named_not_only_the_first(data, capsys):
    (data / "train" / "r_0_1.png").unlink()
    (data / "test" / "r_1_2.png").write_bytes((data / "test" / "r_1_2.png").read_bytes()[:60])
    Image.new("RGB", (31, 32)).save(data / "lit" / "r_1_0.png")
    (data / "train_hdr" / "hdr_001.exr").unlink()
    whole = (data / "test_hdr" / "hdr_002.exr").read_bytes()
    (data / "test_hdr" / "hdr_002.exr").write_bytes(whole[: len(whole) // 2])
    write_exr(data / "relit" / "level_0.5" / "hdr_000.exr", np.full((16, 32, 3), 0.5))
    (data / "exposure_lit.json").write_text("{")
    assert main(["inspect", str(data)]) == 1
    captured = capsys.readouterr()
    faults = [line for line in captured.out.splitlines() if line.startswith("fault:")]
    for name, why in (
        ("train/r_0_1.png", "missing"),
        ("test/r_1_2.png", "not a readable PNG"),
        ("train_hdr/hdr_001.exr", "missing"),
        ("test_hdr/hdr_002.exr", "not a readable OpenEXR"),
        ("relit/level_0.5/hdr_000.exr", "32×16"),
        ("exposure_lit.json", "not valid JSON"),
    ):
        assert sum(name in line and why in line for line in faults) == 1, (name, faults)
    assert captured.err.startswith("error: ") and captured.err.count("error:") == 1
    assert f"{len(faults)} faults, the first: " in captured.err and "Traceback" not in captured.err


@pytest.mark.parametrize("damage", ["31 wide", "no longer rigid"])
def test_what_only_training_would_notice_is_told_too(data, damage, capsys):
    if damage == "31 wide":
        Image.new("RGB", (31, 32)).save(data / "lit" / "r_1_0.png")
    else:
        edit(
            data / "transforms_test.json", lambda c: c["frames"][1]["transform_matrix"][0].__setitem__(0, 9.0)
        )
    assert main(["inspect", str(data), "--json"]) == 1
    first, last = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    (error,) = first["found"]["errors"]
    assert ("r_1_0.png is 31×32" if damage == "31 wide" else "not a rotation") in error
    assert error in last["error"]["message"]


def test_warnings_are_no_errors(data):
    white = Image.new("RGBA", (32, 32), (255, 255, 255, 255))
    black = Image.new("RGBA", (32, 32), (0, 0, 0, 255))
    for i in range(3):
        white.save(data / "train" / f"r_{i}_0.png")
        black.save(data / "train" / f"r_{i}_4.png")
    edit(data / "dataset.json", lambda content: content.update(dynamic_range={"stops": 3.0}))
    (data / "dataset.partial.json").write_text("{}")
    found = inspect(data)
    assert found.errors == []
    told = " | ".join(found.warnings)
    assert "100% of the training pixels are white even at the shortest" in told
    assert "100% of the training pixels are black even at the longest" in told
    assert "says 3.0 stops" in told and "not finished" in told
    assert main(["inspect", str(data)]) == 0


def test_one_exposure_leaves_one_exposure_mode(data):
    for split in ("train", "test", "lit"):
        path = data / f"exposure_{split}.json"
        edit(path, lambda c: [c.pop(key) for key in list(c) if not key.endswith("_0.png")])
        for png in (data / split).glob("r_*_[1-4].png"):
            png.unlink()
    found = inspect(data)
    assert found.errors == [] and found.exposure_modes == ["exp1"]
    assert any("one exposure only" in warning for warning in found.warnings)


def test_several_folders_are_a_line_each(data, tiny_data, capsys):
    assert main(["inspect", str(tiny_data), str(data)]) == 0
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines() if "32×32" in line]
    assert [row[:3] for row in rows] == [["tiny", "32×32", "3/3/2/0"]] * 2
    assert rows[0][3] == "-3…+5" and rows[0][-1] == "good"


def test_what_is_no_data_set_is_one_message(tmp_path, tiny_data, capsys):
    assert main(["inspect", str(tiny_data), str(tmp_path / "nothing")]) == 1
    captured = capsys.readouterr()
    assert "does not exist" in captured.err and "tiny" in captured.out
    assert main(["inspect", str(tmp_path)]) == 1
    assert "is empty" in capsys.readouterr().err
    assert main(["inspect"]) == 1
    assert "physhdr inspect data/demo" in capsys.readouterr().err


JUNK = [
    None,
    "x",
    [1, "x"],
    [{"folder": 3, "levels": {"ambient": "x"}}],
    {"psnr": ["x"], "ambient": []},
    [{"folder": "x", "levels": {"ambient": 10**400}}],
]


KEYS = ["generator", "resolution", "response", "camera_model", "noise_floor", "splits", "lights", "relit"]
KEYS += ["reference_floor", "test_samples"]
KEYS += ["lighting_levels", "frames", "dynamic_range", "scene", "exposures", "version"]


@pytest.mark.parametrize("key", KEYS)
def test_nonsense_in_dataset_json_ends_in_no_traceback(data, key, capsys, monkeypatch):
    whole = json.loads((data / "dataset.json").read_text())
    for junk in JUNK:
        (data / "dataset.json").write_text(json.dumps({**whole, key: junk}))
        found = inspect(data)
        monkeypatch.setattr(f"{Inspect.__module__}.inspect", lambda *_, found=found: found)
        for folders in ((data,), (data, data)):  # one is reported at length, several in a table
            with suppress(DataMismatchError):  # it names faults
                Inspect(folders).run()
            shown = capsys.readouterr().out
            assert "32×32" in shown and "pixels, not" not in shown


# ---- other layouts -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("writer", "layout", "splits", "places", "modes", "truth"),
    [
        ("write_syn", "HDR-NeRF-Syn", "3 2", [0, 1, 2, 3, 4], ["exp1", "exp3"], True),
        ("write_real", "HDR-NeRF-Real", "3 2", [0, 1, 2], ["exp1", "exp3"], False),
        ("write_gausshdr", "GaussHDR", "3 2", [0, 1, 2, 3, 4], ["exp1", "exp3"], True),
        ("write_hdr_gs", "HDR-GS", "6 6", [0, 1, 2], ["exp1", "exp3"], True),
        ("write_colmap", "COLMAP", "9 1", [0, 1, 2], ["exp1", "exp3"], False),
        ("write_nerfstudio", "nerfstudio", "8 1", [0], ["exp1"], False),
    ],
)
def test_every_layout_is_told(tmp_path, capsys, writer, layout, splits, places, modes, truth):
    root = getattr(layouts, writer)(tmp_path / "scene")
    assert main(["inspect", str(root), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[0])["found"]
    assert told["layout"] == layout and told["resolution"] == [96, 72] and told["errors"] == []
    assert " ".join(str(split["poses"]) for split in told["splits"].values()) == splits
    assert [exposure["place"] for exposure in told["exposures"]] == places
    assert told["exposure_modes"] == modes and told["dynamic_range"]["estimated"] is not truth
    assert [split["hdr"] for split in told["splits"].values()] == [
        split["poses"] if truth else 0 for split in told["splits"].values()
    ]
    if truth:  # constant pictures of 10 and the training pose's number, from 0 on
        last = 10 if layout == "HDR-GS" else 4
        assert told["dynamic_range"]["percentile_1"] == pytest.approx(10.0)
        assert told["dynamic_range"]["maximum"] == pytest.approx(10.0 + last)
    assert any("split" in message for message in told["messages"])
    assert main(["inspect", str(root)]) == 0
    printed = capsys.readouterr().out
    assert layout in printed and "split" in printed and "exposure modes" in printed


def test_missing_exposures_and_a_smaller_size_are_told(tmp_path, capsys):
    root = layouts.write_gausshdr(tmp_path / "coffee", {i: (1, 3) for i in range(5)}, "jpg")
    assert main(["inspect", str(root), "--downscale", "2"]) == 0
    printed = capsys.readouterr().out
    assert "96×72 to 48×36 (bicubic)" in printed and "48×36" in printed
    rows = [line.split() for line in printed.splitlines() if line.strip()[:1].isdigit()]
    assert [row[:2] for row in rows] == [["0", "0.125"], ["2", "2"], ["4", "32"]]
    edit(root / "exposure.json", lambda content: content.pop("train_r_2_2.jpg"))
    assert inspect(root).messages[-1] == "exposures are missing: 2 in 1 of 5 poses"


def test_faults_of_other_layouts_are_all_named(tmp_path, capsys):
    root = layouts.write_gausshdr(tmp_path / "sofa")
    for name in ("train_r_0_1.png", "test_r_3_4.png"):
        path = root / "images" / name
        path.write_bytes(path.read_bytes()[:300])
    (root / "images_hdr" / "test_hdr_001.exr").unlink()
    assert main(["inspect", str(root)]) == 1
    captured = capsys.readouterr()
    for name in ("train_r_0_1.png", "test_r_3_4.png", "test_hdr_001.exr"):
        assert sum(line.startswith("fault:") and name in line for line in captured.out.splitlines()) == 1
    assert "3 faults, the first" in captured.err
    (root / "sparse" / "0" / "cameras.bin").write_bytes(b"x")
    found = inspect(root)
    assert len(found.errors) == 1 and "cameras.bin is damaged" in found.errors[0] and found.splits == {}


def test_the_readers_remedy_is_told(tmp_path, capsys):
    """Not "make the data set again", which nobody can of photographs."""
    root = layouts.write_colmap(tmp_path / "scene", exif=False)
    assert main(["inspect", str(root)]) == 1
    told = capsys.readouterr().err
    assert "nothing states their exposures" in told and "Write exposure.json beside images/" in told
    assert "make the data set again" not in told
    assert main(["inspect", str(root), "--json"]) == 1
    found = json.loads(capsys.readouterr().out.splitlines()[0])["found"]
    assert len(found["errors"]) == len(found["remedies"]) == 1 and "exposure.json" in found["remedies"][0]


def test_faults_of_different_kinds_have_their_own_remedies(tmp_path, capsys):
    root = layouts.write_nerfstudio(tmp_path / "scene")
    for k in (0, 1):
        path = root / "images" / f"frame_0000{k}.png"
        path.write_bytes(path.read_bytes()[:200])
    edit(root / "transforms.json", lambda c: [frame.update(mask_path="mask.png") for frame in c["frames"]])
    Image.new("RGB", (50, 20)).save(root / "mask.png")
    assert main(["inspect", str(root)]) == 1
    captured = capsys.readouterr()
    assert captured.out.count("Make the mask at the picture's size") == 1, (
        "once for all that follow each other"
    )
    assert captured.out.count("Delete it and make the data set again") == 1


def test_radiance_is_inspected_in_the_colour_space_that_training_is_told(tmp_path):
    root = layouts.write_nerfstudio(tmp_path / "shot")

    def of_radiance(content):
        for frame in content["frames"]:
            frame["file_path"] = frame["file_path"].replace(".png", ".exr")
            write_exr(root / frame["file_path"], np.full((72, 96, 3), (0.2, 0.5, 0.9)))

    edit(root / "transforms.json", of_radiance)
    found = inspect(root, color_space="rec2020")
    assert any("rec2020, as --color-space says" in message for message in found.messages)
    assert found.dynamic_range.maximum != pytest.approx(inspect(root).dynamic_range.maximum, rel=1e-3)
    assert "Choose from" in inspect(root, color_space="mauve").remedies[0]


def test_no_points_is_a_warning(tmp_path):
    found = inspect(layouts.write_nerfstudio(tmp_path / "scene"))
    (warning,) = [warning for warning in found.warnings if "no first points" in warning]
    assert found.points is None and "stereo" in warning and "physhdr prepare --triangulate" in warning


def test_photos_of_automatic_exposure_are_a_bracket_over_the_views(tmp_path):
    root = layouts.write_nerfstudio(tmp_path / "walk")

    def metered(content):
        for number, frame in enumerate(content["frames"]):
            frame["exposure_time"] = 0.5 * 2.0 ** (number % 4)

    edit(root / "transforms.json", metered)
    found = inspect(root)
    assert found.over_views == pytest.approx(3.0) and "bracket of 3 stops" in found.messages[-1]
    assert not any("differ" in warning or "one exposure only" in warning for warning in found.warnings)
    edit(root / "transforms.json", lambda content: [f.update(exposure_time=1.0) for f in content["frames"]])
    same = inspect(root)
    assert same.over_views == 0.0 and any("one exposure only" in warning for warning in same.warnings)


def test_the_size_in_the_middle_is_told_and_that_there_are_others(tmp_path, capsys):
    """The first view alone is a thumbnail."""
    root = layouts.write_nerfstudio(tmp_path / "phone")
    path = root / "images" / "frame_00000.png"
    with Image.open(path) as picture:
        small = picture.resize((48, 36))
    small.save(path)

    def of_its_own(content):
        for frame in content["frames"]:
            if frame["file_path"].endswith("00000.png"):
                frame |= {"w": 48, "h": 36, "fl_x": 40.0, "fl_y": 40.0, "cx": 24.0, "cy": 18.0}

    edit(root / "transforms.json", of_its_own)
    assert main(["inspect", str(root)]) == 0
    assert "96×72, the middle one of 2 sizes" in capsys.readouterr().out


def test_of_photographs_training_sees_all_exposures(tmp_path):
    root = layouts.write_gausshdr(tmp_path / "photos")
    (root / CAPTURE_FILE).write_text(json.dumps({"format": CAPTURE_FORMAT, "version": 1}))
    assert {exposure.use for exposure in inspect(root).exposures} == {"OE"}


def test_of_published_photographs_the_exposures_between_are_for_evaluation(tmp_path):
    root = layouts.write_gausshdr(tmp_path / "photos")
    assert [exposure.use for exposure in inspect(root).exposures] == ["OE", "NE", "OE", "NE", "OE"]


def test_of_renders_training_sees_every_second_exposure(tiny_data):
    assert [exposure.use for exposure in inspect(tiny_data).exposures] == ["OE", "NE", "OE", "NE", "OE"]
