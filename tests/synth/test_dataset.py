# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder is what docs/formats.md says, resumes, and is never half written."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from physhdr.synth import dataset, folder
from physhdr.synth.errors import ConflictError, DamagedFileError, OutputFolderError

# --import-mode=importlib: the readers live in this folder's conftest
_spec = importlib.util.spec_from_file_location("synth_readers", Path(__file__).with_name("conftest.py"))
readers = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(readers)

ROOT = Path(__file__).parents[2]
T = [0.125, 0.5, 2.0, 8.0, 32.0]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """The interior, tiny, by the command line as a user runs it."""
    out = tmp_path_factory.mktemp("interior") / "data"
    options = "--resolution 32x24 --samples 2 --views 5 --lit-views 2 --relit-views 1 --ambient-levels 1/2"
    command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--out", out, *options.split()]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out, done


def test_layout_is_the_documented_one(room):
    out, done = room
    expected = {"dataset.json", "points3d.ply"}
    for split, count in (("train", 3), ("test", 2), ("lit", 2)):
        expected |= {f"transforms_{split}.json", f"exposure_{split}.json"}
        expected |= {f"{split}_hdr/hdr_{i:03d}.exr" for i in range(count)}
        expected |= {f"{split}/r_{i}_{k}.png" for i in range(count) for k in range(5)}
    expected |= {"relit/level_0.5/hdr_001.exr"}
    assert {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} == expected
    assert "render [" in done.stdout and "s left" in done.stdout
    assert "Saved" not in done.stdout and "WARNING" not in done.stdout


def test_poses_and_exposures(room):
    out, _ = room
    for split, count in (("train", 3), ("test", 2), ("lit", 2)):
        transforms = readers.read_json(out / f"transforms_{split}.json")
        assert transforms["camera_angle_x"] == pytest.approx(np.radians(62))
        assert [f["file_path"] for f in transforms["frames"]] == [f"./{split}/r_{i}" for i in range(count)]
        for frame in transforms["frames"]:
            pose = np.array(frame["transform_matrix"])
            assert pose.shape == (4, 4) and pose[3].tolist() == [0, 0, 0, 1]
            assert ("lighting_level" in frame) == (split == "lit")
        exposures = readers.read_json(out / f"exposure_{split}.json")
        assert exposures == {f"./{split}/r_{i}_{k}.png": T[k] for i in range(count) for k in range(5)}
    assert [f["lighting_level"] for f in transforms["frames"]] == [0.25, 4.0]


def test_brackets_are_the_response_of_the_exr(room):
    out, _ = room
    for split, count in (("train", 3), ("test", 2), ("lit", 2)):
        for i in range(count):
            radiance = readers.read_exr(out / f"{split}_hdr/hdr_{i:03d}.exr").astype(np.float64)
            assert radiance.shape == (24, 32, 3)
            for k, t in enumerate(T):
                x = radiance * t
                code = np.floor(255 * (x / (1 + x)) ** (1 / 2.2) + 0.5)
                png = readers.read_png(out / f"{split}/r_{i}_{k}.png")
                assert (png[..., 3] == 255).all()
                np.testing.assert_array_equal(png[..., :3], code)


def test_dataset_json(room):
    out, _ = room
    told = readers.read_json(out / "dataset.json")
    assert (told["format"], told["version"]) == ("physhdr-dataset", 1)
    assert told["generator"]["blender"] == bpy.app.version_string
    assert (told["resolution"], told["samples"], told["scene"]) == ([32, 24], 2, "interior")
    assert told["denoised"] == "OpenImageDenoise" and told["working_space"] == "Linear Rec.709"
    assert told["exposures"] == T and told["splits"] == {"train": 3, "test": 2, "lit": 2}
    assert told["lighting_levels"] == {"lit": [0.25, 4.0], "relit": [0.5], "relit_views": [1]}
    assert told["response"] == {"name": "reinhard-gamma", "anchor": [1.0, pytest.approx(0.5 ** (1 / 2.2))]}
    settings = told["render_settings"]
    for path, value in {
        "scene.render.engine": "CYCLES",
        "scene.render.dither_intensity": 0.0,
        "scene.cycles.sample_clamp_indirect": 0.0,
        "scene.cycles.sample_clamp_direct": 0.0,
        "scene.cycles.film_exposure": 1.0,
        "scene.view_settings.view_transform": "Standard",
        "bpy.data.colorspace.working_space": "Linear Rec.709",
    }.items():
        assert settings[path] == value
    floor = told["noise_floor"]
    assert floor["seeds"][0] != floor["seeds"][1] and floor["view"] == 1
    assert len(floor["psnr"]) == 5 and all(5 < value < 99 for value in [*floor["psnr"], floor["hdr_psnr"]])
    radiance = np.stack([readers.read_exr(out / f"train_hdr/hdr_{i:03d}.exr") for i in range(3)])
    luminance = radiance.astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    ranges = told["dynamic_range"]
    assert ranges["percentile_1"] == pytest.approx(np.percentile(luminance, 1), rel=1e-6)
    assert ranges["maximum"] == pytest.approx(luminance.max(), rel=1e-6)
    assert ranges["stops"] == pytest.approx(np.log2(ranges["maximum"] / ranges["percentile_1"]), abs=0.01)


def test_points_lie_on_the_surfaces(tmp_path, small):
    """The ball has radius 1, the floor is at −1: no other place is possible, and normals follow."""
    dataset.make(tmp_path, small)
    points = readers.read_ply(tmp_path / "points3d.ply")
    place = np.stack([points[k] for k in "xyz"], -1).astype(np.float64)
    normal = np.stack([points[k] for k in ("nx", "ny", "nz")], -1).astype(np.float64)
    on_ball = np.abs(np.linalg.norm(place, axis=1) - 1) < 2e-3
    on_floor = np.abs(place[:, 2] + 1) < 1e-3
    on_bulb = np.abs(np.linalg.norm(place - [1.6, -1.5, 0.2], axis=1) - 0.35) < 1e-2
    on_rim = np.abs(np.abs(place[:, :2]).max(1) - 6) < 1e-3
    assert (on_ball | on_floor | on_bulb | on_rim).all()
    assert on_ball.sum() > 50 and on_floor.sum() > 50 and len(points) < 3 * 32 * 24
    assert (np.einsum("ij,ij->i", normal[on_ball], place[on_ball]) > 0.99).all()
    assert (normal[on_floor & ~on_ball & ~on_rim, 2] > 0.99).all()
    colour = np.stack([points[k] for k in ("red", "green", "blue")], -1)
    assert colour[on_bulb].min() == pytest.approx(255, abs=8)  # radiance 50 at t = 2 is white
    # t=2, grey (0.5, 0.4, 0.3): red is the brightest wherever there is light
    assert (colour[on_ball, 0] >= colour[on_ball, 2]).all()


def _stamps(out: Path) -> dict[str, int]:
    return {str(p.relative_to(out)): p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file()}


def test_resume_renders_only_what_is_missing_and_the_same(tmp_path, small):
    out = tmp_path / "d"
    dataset.make(out, small)
    before = _stamps(out)
    lost = out / "test_hdr/hdr_001.exr"
    radiance = readers.read_exr(lost)
    lost.unlink()
    (out / "train/r_1_2.png").unlink()
    dataset.make(out, small)
    after = _stamps(out)
    assert after.keys() == before.keys()
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"test_hdr/hdr_001.exr", "train/r_1_2.png", "dataset.json"}
    np.testing.assert_array_equal(readers.read_exr(lost), radiance)  # the same seed, the same noise


def test_a_complete_data_set_is_left_as_it_is(tmp_path, small, capsys):
    dataset.make(tmp_path / "d", small)
    before = _stamps(tmp_path / "d")
    dataset.make(tmp_path / "d", small)
    assert _stamps(tmp_path / "d") == before
    assert "complete already" in capsys.readouterr().out


def test_another_version_does_not_mix_into_a_data_set(tmp_path, small, monkeypatch):
    dataset.make(tmp_path / "d", small)
    (tmp_path / "d/test_hdr/hdr_001.exr").unlink()
    monkeypatch.setitem(dataset.GENERATOR, "version", "9.9")
    before = _stamps(tmp_path / "d")
    with pytest.raises(ConflictError, match=r"this is .*9\.9"):
        dataset.make(tmp_path / "d", small)
    assert _stamps(tmp_path / "d") == before


def test_interrupted_run_goes_on(tmp_path, small, monkeypatch):
    out = tmp_path / "d"
    calls = []
    real = dataset.Renderer.render

    def interrupted(self, path, *rest):
        calls.append(path)
        if len(calls) == 3:
            folder.temporary(path).write_bytes(b"half an EXR")  # as a kill in the middle of writing leaves it
            raise KeyboardInterrupt
        return real(self, path, *rest)

    monkeypatch.setattr(dataset.Renderer, "render", interrupted)
    with pytest.raises(KeyboardInterrupt):
        dataset.make(out, small)
    assert not (out / "dataset.json").exists() and (out / "dataset.partial.json").exists()
    del calls[:]

    def counted(self, path, *rest):
        calls.append(path)
        return real(self, path, *rest)

    monkeypatch.setattr(dataset.Renderer, "render", counted)
    dataset.make(out, small)
    assert len(calls) == 5 + 2 + 2 + 1 - 2  # all pictures and the noise floor, less the two that were whole
    assert (out / "dataset.json").exists() and not (out / "dataset.partial.json").exists()
    assert not list(out.rglob("*.tmp"))


def test_other_options_change_nothing(tmp_path, small):
    from dataclasses import replace

    out = tmp_path / "d"
    dataset.make(out, small)
    before = _stamps(out)
    for change in ({"resolution": (16, 16)}, {"seed": 1}, {"crf": "srgb"}, {"exposures": (1.0, 2.0)}):
        with pytest.raises(ConflictError, match=next(iter(change))):
            dataset.make(out, replace(small, **change))
    assert _stamps(out) == before


def test_a_damaged_exr_is_named_and_kept(tmp_path, small):
    out = tmp_path / "d"
    dataset.make(out, small)
    exr = out / "train_hdr/hdr_001.exr"
    exr.write_bytes(exr.read_bytes()[:-100])
    before = _stamps(out)
    with pytest.raises(DamagedFileError, match=r"hdr_001\.exr.*delete it"):
        dataset.make(out, small)
    assert _stamps(out) == before


def test_a_foreign_folder_is_left_alone(tmp_path, small):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(OutputFolderError, match="empty folder"):
        dataset.make(tmp_path, small)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_folder_that_cannot_be_written(tmp_path, small):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputFolderError, match="cannot write"):
        dataset.make(tmp_path / "file" / "data", small)


def test_nothing_is_left_in_blender(tmp_path, small):
    def inventory():
        kinds = ("scenes", "objects", "meshes", "materials", "lights", "cameras", "worlds", "images")
        return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}

    before = inventory()
    dataset.make(tmp_path, small)
    assert inventory() == before
    shutil.rmtree(tmp_path)
