# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that is on in its group alone is off where nobody says a level: in files, pictures, previews."""

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file

from physhdr.backend.cli import main
from physhdr.backend.cli.video import Video
from physhdr.backend.evaluate.camera_path import levels_of
from physhdr.backend.export.quantised import quantised
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.pictures import read_exr
from physhdr.backend.serve import preview
from physhdr.bridge.light_groups import LightGroup, LightGroups, write_light_groups
from physhdr.bridge.messages import PreviewCamera, PreviewRequest
from physhdr.bridge.model_file import read_model
from physhdr.bridge.ply_model import read_ply_model
from physhdr.bridge.run_folder import CHECKPOINT_FILE
from physhdr.bridge.shots import Shot
from physhdr.bridge.splat_files import read_splat_file
from physhdr.tests.backend.scene import layouts

LIGHTS, STANDARD = ("ambient", "flash"), (1.0, 0.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """Trained for 20 iterations on photographs, two of them lit by a flash, two of the evening."""
    folder = tmp_path_factory.mktemp("flash")
    data = layouts.write_gausshdr(folder / "data", poses=9, suffix="jpg")
    flash = LightGroup("flash on", {"flash": 1.0}, ("*_r_7", "*_r_8_*"))
    evening = LightGroup("evening", {"ambient": None}, ("*_r_5", "*_r_6"))
    write_light_groups(data, LightGroups(LIGHTS, (flash, evening), {"flash": 0.0}))
    short = ["--iterations", "20", "--initial-points", "random", "--set", "random_points=200"]
    assert main(["train", str(data), "--out", str(folder / "run"), "--preset", "fast", *short]) == 0
    return folder / "run"


def test_pictures_and_files_for_viewers_are_without_the_flash(run: Path, tmp_path: Path):
    asked = {
        "default": [],
        "off": ["--lighting-levels", "flash=0"],
        "on": ["--lighting-levels", "flash=1"],
        "ambient": ["--lighting-level", "1"],
    }
    pictures, colours = {}, {}
    for name, levels in asked.items():
        assert main(["render", str(run), "--out", str(tmp_path / f"{name}.exr"), *levels]) == 0
        pictures[name] = read_exr(tmp_path / f"{name}.exr")
        assert main(["export", str(run), str(tmp_path / f"{name}.ply"), "--quick", *levels]) == 0
        colours[name] = read_splat_file(tmp_path / f"{name}.ply").colour_sh
    for kind in (pictures, colours):
        assert np.array_equal(kind["default"], kind["off"]) and np.array_equal(kind["ambient"], kind["off"])
        assert not np.allclose(kind["default"], kind["on"])


def test_the_models_files_say_so(run: Path, tmp_path: Path):
    assert main(["export", str(run), str(tmp_path / "out"), "--quick"]) == 0
    model = read_model(tmp_path / "out" / "model.safetensors")
    assert model.lights == LIGHTS and model.standard_levels == STANDARD
    assert read_ply_model(tmp_path / "out" / "lossless.ply").model.standard_levels == STANDARD
    assert quantised(model).header["standard"] == list(STANDARD)
    # A file made of the file begins there, too.
    for name, levels in (("file.ply", []), ("off.ply", ["--lighting-levels", "flash=0"])):
        source = str(tmp_path / "out" / "model.safetensors")
        assert main(["export", source, str(tmp_path / name), *levels]) == 0
    kept, off = (read_splat_file(tmp_path / name).colour_sh for name in ("file.ply", "off.ply"))
    assert np.array_equal(kept, off)


def test_videos_paths_and_previews_begin_there(run: Path):
    opened = open_run(run, pictures=False)
    video = Video(source=run, out=[Path("x.mp4")], seconds=1.0, fps=4)
    assert {frame.levels for frame in video.plan(opened.scene, opened.method)} == {STANDARD}
    shot = Shot(np.eye(4), 50.0, 50.0, 32.0, 24.0, 0.0, (0.5,))
    assert levels_of(shot, LIGHTS, opened.method.standard_levels) == (0.5, 0.0)
    camera = opened.scene.train[0].camera
    lens = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    asked = PreviewCamera(pose=tuple(camera.camera_to_world.ravel().tolist()), **lens)
    usual, standard, lit = (
        preview.render(
            opened.method, PreviewRequest(sequence=1, camera=asked, lighting_levels=levels), 1
        ).rgba
        for levels in ((), STANDARD, (1.0, 1.0))
    )
    assert np.array_equal(usual, standard) and not np.array_equal(usual, lit)


def test_found_levels_are_kept_with_what_they_are_worth(run: Path):
    """As the checkpoint has them: exp of what is learned of the evening, whose light no other level tells."""
    (learned,) = load_file(run / CHECKPOINT_FILE)["light_levels.log_level"].exp().tolist()
    standard, *groups = json.loads(open_run(run, pictures=False).provenance["photographed_light"])
    assert standard == {"name": "standard", "levels": {"flash": 0.0}}
    assert {group["name"]: group["levels"] for group in groups} == {
        "evening": {"ambient": pytest.approx(learned), "flash": 0.0},
        "flash on": {},
    }
    assert [group.get("found") for group in groups if group["name"] == "evening"] == [
        {"ambient": "estimated"}
    ]
    assert not any("found" in group for group in groups if group["name"] != "evening")
