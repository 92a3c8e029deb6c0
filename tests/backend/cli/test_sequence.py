# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render --camera``: frames along a path, kept, drawn anew, and drawn by several processes."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.cli.sequence import Frame, Opened, WorkerError, numbered, plan_file, render_in_parallel
from physhdr.backend.runs.run import Run, open_run
from physhdr.backend.scene import Scene
from physhdr.backend.scene.pictures import read_exr
from physhdr.backend.train.checkpoint import load_checkpoint, save_checkpoint
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.run_folder import CHECKPOINT_FILE, VIEWS_FILE
from physhdr.bridge.shots import Shot, Shots, write_shots


@pytest.fixture(scope="module")
def run(two_lights_data: Path, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "two"
    short = ["--iterations", "20", "--set", "sh_degree_every=5", "--preset", "fast"]
    assert main(["train", str(two_lights_data), "--out", str(folder), *short]) == 0
    return folder


@pytest.fixture(scope="module")
def scene(run: Path) -> Scene:
    return open_run(run).scene


def shots_of(scene: Scene, path: Path, count: int = 5, levels: bool = False) -> Path:
    """The first training views one after the other, and a level that rises."""
    frames = []
    for k in range(count):
        camera = scene.train[k % len(scene.train)].camera
        lit = (1.0, 0.5 * k) if levels else ()
        pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
        frames.append(Shot(camera.camera_to_world, *pinhole, exposure_ev=float(k), levels=lit))
    write_shots(path, Shots(scene.train[0].camera.width, scene.train[0].camera.height, 24.0, frames))
    return path


def render(run: Path, out: Path, *options: object) -> int:
    return main(["render", str(run), "--out", str(out), *map(str, options)])


def stamps(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("a_[0-9]*")}


def test_frames_are_what_single_cameras_give(run: Path, scene: Scene, tmp_path: Path) -> None:
    shots = shots_of(scene, tmp_path / "shots.json", levels=True)
    assert render(run, tmp_path / "a_##.exr", "--camera", shots) == 0
    assert render(run, tmp_path / "a_##.png", "--camera", shots, "--exposure", "0.5") == 0
    for k in range(5):
        one = ["--view", f"train/{scene.train[k % 3].index}", "--lighting-levels", f"pendant={0.5 * k}"]
        assert render(run, tmp_path / "one.exr", *one) == 0
        np.testing.assert_array_equal(read_exr(tmp_path / f"a_{k:02d}.exr"), read_exr(tmp_path / "one.exr"))
        assert render(run, tmp_path / "one.png", *one, "--exposure", 0.5 * 2.0**k) == 0
        frames = [np.array(Image.open(tmp_path / name)) for name in (f"a_{k:02d}.png", "one.png")]
        np.testing.assert_array_equal(*frames)


def test_a_sequence_goes_on(run: Path, scene: Scene, tmp_path: Path, capsys) -> None:
    words = ["--camera", shots_of(scene, tmp_path / "shots.json")]
    out = tmp_path / "a_####.exr"
    assert render(run, out, *words) == 0
    before = stamps(tmp_path)
    assert len(before) == 5
    (tmp_path / "a_0002.exr").unlink()
    capsys.readouterr()
    assert render(run, out, *words) == 0
    assert "wrote 1 of 5 frames" in capsys.readouterr().out
    after = stamps(tmp_path)
    assert {name for name in after if after[name] == before[name]} == set(before) - {"a_0002.exr"}

    assert render(run, out, *words, "--lighting-level", "2") == 1, "frames of something else"
    told = capsys.readouterr().err
    assert "a_0000.exr shows something else (5 such frames)" in told and "--overwrite" in told
    assert stamps(tmp_path) == after
    assert render(run, out, *words, "--lighting-level", "2", "--overwrite") == 0
    assert not set(stamps(tmp_path).values()) & set(after.values())

    shorter = shots_of(scene, tmp_path / "shorter.json", 3)
    assert render(run, out, "--camera", shorter, "--lighting-level", "2") == 1, "two frames would be left"
    assert render(run, out, "--camera", shorter, "--lighting-level", "2", "--overwrite") == 0
    assert len(stamps(tmp_path)) == 3


def test_frames_of_somebody_else_stay(run: Path, scene: Scene, tmp_path: Path, capsys) -> None:
    (tmp_path / "a_0001.exr").write_text("mine")
    words = ["--camera", shots_of(scene, tmp_path / "shots.json")]
    assert render(run, tmp_path / "a_####.exr", *words) == 1
    assert "its content is unknown" in capsys.readouterr().err
    assert (tmp_path / "a_0001.exr").read_text() == "mine" and len(stamps(tmp_path)) == 1
    plan = plan_file(tmp_path / "b_#.exr")
    plan.write_text('{"format": "other"}')
    assert render(run, tmp_path / "b_#.exr", *words) == 1
    assert plan.name in capsys.readouterr().err


def test_a_plan_names_nothing_outside_of_its_folder(run: Path, scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "mine.exr").write_text("mine")
    out = tmp_path / "frames" / "a_#.exr"
    out.parent.mkdir()
    told = {"format": "physhdr-frames", "version": 1, "frames": {"../mine.exr": "0"}}
    plan_file(out).write_text(json.dumps(told))
    assert render(run, out, "--camera", shots_of(scene, tmp_path / "shots.json"), "--overwrite") == 0
    assert (tmp_path / "mine.exr").read_text() == "mine"


def test_sequences_of_like_names_leave_each_other_alone(run: Path, scene: Scene, tmp_path: Path) -> None:
    words = ["--camera", shots_of(scene, tmp_path / "shots.json", 2)]
    names = ("a_##.exr", "a_####.exr", "a-####.exr", "a.####.exr", "a####.exr")
    for name in names:
        assert render(run, tmp_path / name, *words, "--overwrite") == 0
    assert len(list(tmp_path.glob("a*.exr"))) == 2 * len(names)


@pytest.mark.long
def test_several_processes_draw_the_same(run: Path, scene: Scene, tmp_path: Path) -> None:
    words = ["--camera", shots_of(scene, tmp_path / "shots.json", 4, levels=True), "--layers"]
    assert render(run, tmp_path / "one" / "a_#.exr", *words) == 0
    assert render(run, tmp_path / "two" / "a_#.exr", *words, "--workers", "2") == 0
    for path in sorted((tmp_path / "one").iterdir()):
        assert (tmp_path / "two" / path.name).read_bytes() == path.read_bytes(), path.name
    assert len(list((tmp_path / "two").iterdir())) == 5, "frames and what they are"


@pytest.mark.long
def test_workers_start_where_the_package_is_not_installed(run: Path, scene: Scene, tmp_path: Path) -> None:
    """As in the environment that Blender makes: it has what the package needs, and launch.py finds that."""
    other = getattr(sys, "_base_executable", sys.executable)  # reads no .pth files of this environment's
    # The kernels that these tests have compiled are beside their sources, numba's own place.
    environment = {**os.environ, "PYTHONPATH": sysconfig.get_paths()["purelib"], "NUMBA_CACHE_DIR": ""}
    if not subprocess.run(
        [other, "-P", "-c", "import physhdr"], env=environment, capture_output=True
    ).returncode:
        pytest.skip("the package is installed for every Python here")
    shots = shots_of(scene, tmp_path / "shots.json", 2)
    words = ["render", run, "--camera", shots, "--out", tmp_path / "a_#.exr", "--workers", "2"]
    launcher = Path(__file__).resolve().parents[3] / "backend" / "launch.py"
    done = subprocess.run(
        [other, launcher, *words], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.glob("a_[01].exr"))) == 2


@pytest.mark.long
def test_a_worker_that_fails_is_heard(scene: Scene, tmp_path: Path) -> None:
    opened = Opened(tmp_path / "no run", None, "auto", "cpu", "")
    frames = [Frame(tmp_path / "0.exr", scene.train[0].camera, 1.0, (1.0, 1.0))]
    with pytest.raises(WorkerError, match=r"a worker failed: error: .*no run"):
        render_in_parallel(opened, frames, 1, 1, None, lambda done, total, what: None)


def test_a_worker_draws_no_other_model(run: Path, scene: Scene, tmp_path: Path) -> None:
    opened = Opened(run, None, "auto", "cpu", "0" * 64)
    frames = [Frame(tmp_path / "0.exr", scene.train[0].camera, 1.0, (1.0, 1.0))]
    with pytest.raises(WorkerError, match="changed while its frames were rendered"):
        render_in_parallel(opened, frames, 1, 1, None, lambda done, total, what: None)
    assert not list(tmp_path.iterdir())


def test_frames_without_confidence_are_others(run, scene, tmp_path: Path, capsys, monkeypatch) -> None:
    words = ["--camera", shots_of(scene, tmp_path / "shots.json", 2), "--layers"]
    assert render(run, tmp_path / "a_#.exr", *words) == 0
    monkeypatch.setattr(Run, "seen", lambda self: None)  # as where the training pictures are missing
    capsys.readouterr()
    assert render(run, tmp_path / "a_#.exr", *words) == 1
    assert "a_0.exr shows something else (2 such frames)" in capsys.readouterr().err


def test_names_of_frames() -> None:
    assert [path.name for path in numbered(Path("x/a_###.exr"), 2)] == ["a_000.exr", "a_001.exr"]
    assert [path.name for path in numbered(Path("a#.png"), 11)][9:] == ["a9.png", "a10.png"]
    assert numbered(Path("a.exr"), 1) == [Path("a.exr")]
    for name in ("a.exr", "a_#_##.exr"):
        with pytest.raises(BadValueError, match="one run of #"):
            numbered(Path(name), 2)
    assert plan_file(Path("x/a_###.exr")) == Path("x/a_###.exr.frames.json")


def test_one_frame_needs_no_number(run: Path, scene: Scene, tmp_path: Path) -> None:
    shots = shots_of(scene, tmp_path / "shots.json", 1)
    assert render(run, tmp_path / "one.exr", "--camera", shots, "--width", "16") == 0
    assert read_exr(tmp_path / "one.exr").shape == (16, 16, 3)
    assert not list(tmp_path.glob("*.frames.json"))


def test_a_space_of_nerfstudio_is_that_of_the_data_sets_poses(run: Path, tmp_path: Path, capsys) -> None:
    """What ns-process-data did to them is in transforms.json; a run whose data set has moved asks for it."""
    moved = tmp_path / "run"
    shutil.copytree(run, moved)
    config, views = (json.loads((moved / name).read_text()) for name in ("config.json", VIEWS_FILE))
    (moved / "config.json").write_text(json.dumps(config | {"data": str(tmp_path / "gone")}))
    (moved / VIEWS_FILE).write_text(json.dumps(views | {"layout": "nerfstudio"}))
    tensors, metadata = load_checkpoint(moved / CHECKPOINT_FILE)
    digest = hashlib.sha256((moved / VIEWS_FILE).read_bytes()).hexdigest()
    save_checkpoint(moved / CHECKPOINT_FILE, tensors, metadata | {"views": digest})
    frame = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 50.0}
    path, space = tmp_path / "path.json", tmp_path / "dataparser_transforms.json"
    path.write_text(json.dumps({"render_width": 8, "render_height": 6, "camera_path": [frame]}))
    space.write_text(json.dumps({"transform": np.eye(4)[:3].tolist(), "scale": 1.0}))
    assert render(moved, tmp_path / "one.exr", "--camera", path) == 0
    assert render(moved, tmp_path / "one.exr", "--camera", path, "--camera-space", space) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "transforms.json" in told and "ns-process-data" in told and "--data" in told


def test_two_who_say_the_light(run: Path, scene: Scene, tmp_path: Path, capsys) -> None:
    shots = shots_of(scene, tmp_path / "shots.json", levels=True)
    assert render(run, tmp_path / "a_#.exr", "--camera", shots, "--lighting-level", "2") == 1
    assert "--lighting-level: the file of cameras has levels" in capsys.readouterr().err


def test_a_video_takes_the_same_files(run: Path, tmp_path: Path) -> None:
    frames = [{"camera_to_world": np.eye(4).tolist(), "fov": 60.0} for _ in range(2)]
    content = {"render_width": 24, "render_height": 16, "fps": 24, "camera_path": frames}
    (tmp_path / "path.json").write_text(json.dumps(content))
    words = ["--camera", str(tmp_path / "path.json"), "--out", str(tmp_path / "video")]
    assert main(["render", str(run), *words]) == 0
    assert Image.open(tmp_path / "video" / "frame_0001.png").size == (24, 16)
