# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render --at``: of runs and of model files, for people and for programs; what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.cli import main
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.pictures import read_exr
from physhdr.bridge.gaussian_ply import write_standard_ply
from physhdr.bridge.panorama import directions
from physhdr.bridge.probe import PROBE_FILE, read_probe

WIDTH = 64


def trained(preset: str, data: Path, folder: Path, iterations: int = 30) -> Path:
    short = ["--iterations", str(iterations), "--set", "sh_degree_every=5"]
    assert main(["train", str(data), "--out", str(folder), "--preset", preset, *short]) == 0
    return folder


@pytest.fixture(scope="module")
def run(two_lights_data, tmp_path_factory) -> Path:
    return trained("default", two_lights_data, tmp_path_factory.mktemp("runs") / "two")


def drawn(source: Path, out: Path, *more: str, width: int = WIDTH) -> Path:
    at = ("--at", "0.2", "-3.5", "0.1")
    assert main(["render", str(source), *at, "--out", str(out), "--width", str(width), *more]) == 0
    return out


def test_a_run_and_its_model_file_have_the_same_light(run, tmp_path, capsys):
    of_run = drawn(run, tmp_path / "run")
    assert "filled from its rim" in capsys.readouterr().out
    assert main(["export", str(run)]) == 0
    of_file = drawn(run / "model.safetensors", tmp_path / "file")
    probe = read_probe(of_run)
    assert probe.lights == ("ambient", "pendant") and probe.at == (0.2, -3.5, 0.1)
    assert probe.unseen == pytest.approx(read_probe(of_file).unseen, abs=1e-4) and 0.0 < probe.unseen < 1.0
    for name in probe.files:
        ours, files = read_exr(of_run / name), read_exr(of_file / name)
        assert ours.shape == (WIDTH // 2, WIDTH, 3) and ours.max() > 0.0
        assert np.abs(ours - files).max() < 1e-3 * ours.max()


def test_lights_add_up_to_what_the_run_renders(run, tmp_path):
    """Relighting by sums of the panorama's parts, against pictures of the run's where it is densest."""
    folder = drawn(run, tmp_path / "probe", "--near", "0")
    fixed, ambient, pendant = (read_exr(folder / name) for name in read_probe(folder).files)
    method = open_run(run).method
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # along +Y
    pose[:3, 3] = 0.2, -3.5, 0.1
    camera = Camera.from_field_of_view(pose, 41, 41, 0.6)
    row, column = WIDTH // 4, WIDTH // 4  # the pixel right and below of where +Y is
    toward = pose[:3, :3].T @ directions(WIDTH)[row, column]
    x, y = (camera.fx * toward[0] / -toward[2] + 20.5, 20.5 - camera.fy * toward[1] / -toward[2])
    standard = method.preview(camera)
    assert standard.alpha[int(y), int(x)] > 0.6
    for levels in ((0.0, 1.0), (4.0, 0.25), (1.0, 8.0)):
        picture = method.hdr(camera, levels)[:, int(y), int(x)] / standard.image[:, int(y), int(x)]
        ours = fixed + levels[0] * ambient + levels[1] * pendant
        ours = ours[row, column] / (fixed + ambient + pendant)[row, column]
        assert ours == pytest.approx(picture.numpy(), rel=0.05)


def test_a_program_is_told_what_happens(run, tmp_path, capsys):
    places = ["--at", "0", "-3", "0", "--out", str(tmp_path / "a"), "--at", "1", "-3", "0", "--out"]
    assert main(["render", str(run), *places, str(tmp_path / "b"), "--width", "32", "--json"]) == 0
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    progress = [line["progress"] for line in told[:-1]]
    assert progress == sorted(progress) and progress[-1] == 1.0 and told[0]["message"] == "a"
    assert [Path(each["folder"]).name for each in told[-1]["result"]["probes"]] == ["a", "b"]
    assert read_probe(tmp_path / "b").at == (1.0, -3.0, 0.0)


@pytest.mark.parametrize(
    ("preset", "lights"),
    [
        ("baseline", ("ambient",)),
        ("paper", ()),
        pytest.param("hdr-gs", ("ambient",), marks=pytest.mark.long),
        pytest.param("default-scaffold", ("ambient",), marks=pytest.mark.long),
        pytest.param("hdr-nerf-small", (), marks=pytest.mark.long),
    ],
)
def test_methods_tell_what_they_know_of_their_light(preset, lights, tiny_data, tmp_path):
    run = trained(preset, tiny_data, tmp_path / "run", iterations=2)
    folder = drawn(run, tmp_path / "probe", width=16)
    assert read_probe(folder).lights == lights
    assert sorted(path.name for path in folder.iterdir()) == sorted([*read_probe(folder).files, PROBE_FILE])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("--width", "100"), "power of two"),
        (("--near", "-1"), "--near"),
        (("--at", "0", "0", "9e9"), "places"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_anything_is_written(run, tmp_path, capsys, change, told):
    out = tmp_path / "probe"
    assert main(["render", str(run), "--at", "0", "0", "0", "--out", str(out), *change]) == 1
    assert told in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize("option", [("--data", "x"), ("--device", "cpu")])
def test_what_is_of_a_run_is_refused_of_a_model_file(tmp_path, capsys, option):
    words = ["--at", "0", "0", "0", "--out", str(tmp_path / "probe"), *option]
    assert main(["render", "m.safetensors", *words]) == 1
    assert f"{option[0]} only applies to a run, and m.safetensors is not a folder" in capsys.readouterr().err


def test_what_is_lost_of_another_programs_file_is_told_and_its_axes(tmp_path, capsys):
    count, file = 20, tmp_path / "a.ply"
    position = np.random.default_rng(0).normal(size=(count, 3))
    rotation, scale = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.full((count, 3), 0.1)
    look = (np.full(count, 0.9), np.zeros((count, 1, 3)))
    for up, has in (("colmap", "a.ply has Y down, Z forward (COLMAP's axes)"), ("z", "")):
        write_standard_ply(file, position, rotation, scale, *look, up=up)
        drawn(file, tmp_path / up, width=16)
        told = " ".join(capsys.readouterr().out.split())
        assert "linearised as sRGB" in told
        assert ("not upright" in told) == bool(has) and has in told


def test_a_folder_of_other_things_stays_as_it_is(run, tmp_path, capsys):
    (tmp_path / "holiday.exr").write_bytes(b"mine")
    assert main(["render", str(run), "--at", "0", "0", "0", "--out", str(tmp_path), "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["error"]["code"] == "output"
    assert (tmp_path / "holiday.exr").read_bytes() == b"mine"
