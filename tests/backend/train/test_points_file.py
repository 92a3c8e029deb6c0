# SPDX-License-Identifier: GPL-3.0-or-later
"""``--points-file``: a PLY that stands for the data set's own points, wherever those are used."""

import dataclasses
import shutil

import numpy as np
import pytest
import torch

from physhdr.backend.cli import main
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.points import read_points, with_points_file
from physhdr.backend.train.begin import begin
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.config import CONFIG_FILE, read_config
from physhdr.backend.train.forecast.memory import sizes_of
from physhdr.backend.train.forecast.size import extent_of, found_sizes
from physhdr.backend.train.plan import planned
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.without_effect import changed_without_effect
from physhdr.bridge.errors import FileDamagedError, FileMissingError
from physhdr.bridge.run_folder import CHECKPOINT_FILE

COUNT = 40
COMMENT = "structure from motion: by somebody"


@pytest.fixture
def data(tiny_data, tmp_path):
    """A data set with a second file of points, the first's moved by four metres, fewer, and red."""
    root = tmp_path / "data"
    shutil.copytree(tiny_data, root)
    write_ply(root / "other.ply", read_points(root / "points3d.ply").positions[:COUNT] + [4.0, 0.0, 0.0])
    return root


def write_ply(path, positions):
    lines = ["ply", "format ascii 1.0", f"comment {COMMENT}", f"element vertex {len(positions)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    rows = [f"{x!r} {y!r} {z!r} 255 0 0" for x, y, z in positions.tolist()]
    path.write_text("\n".join([*lines, "end_header", *rows]) + "\n")


def short(preset="default", **changes):
    return dataclasses.replace(PRESETS[preset], iterations=4, points_file="other.ply", **changes)


def begun(data, config):
    """The trainer, and the places of its Gaussians as a set."""
    state = begin(read_scene(data), config)
    return state, {tuple(place) for place in state.method.backbone.parameters["means"].tolist()}


def places(path):
    return {tuple(place) for place in read_points(path).positions.tolist()}


@pytest.mark.parametrize("preset", ["default", "baseline", "gausshdr-short", "hdr-gs-short"])
def test_every_method_of_gaussians_starts_from_the_file(preset, data):
    state, means = begun(data, short(preset, initial_points="file"))
    assert means == places(data / "other.ply") and len(means) == COUNT
    response = ", the response as brackets tell it" if preset == "default" else ""
    assert state.start_message == f"{COUNT} points of other.ply (structure from motion){response}"
    _, means = begun(data, short(preset, initial_points="auto"))
    assert means == places(data / "other.ply")
    state, means = begun(data, short(preset, initial_points="both"))
    assert means > places(data / "other.ply")
    assert state.start_message.startswith(f"{COUNT} points of other.ply (structure from motion), ")


def test_a_method_that_starts_with_the_points_colours_has_those_of_the_file(data):
    """HDR-GS begins with ln radiance = the points' colours, which are red (1, 0, 0) there."""
    state, _ = begun(data, short("hdr-gs", initial_points="file"))
    colour = state.method.gaussians.reflectance_dc[:, 0] * 0.28209479177387814
    assert torch.allclose(colour, torch.tensor([1.0, 0.0, 0.0]).expand(COUNT, 3), atol=1e-5)


def test_anchors_are_placed_at_the_file(data):
    state = begin(read_scene(data), short("default-scaffold", initial_points="file"))
    anchors = state.method.backbone.positions.detach()
    to_file, to_own = (
        torch.cdist(anchors, torch.tensor(read_points(data / name).positions)).min(1).values.mean()
        for name in ("other.ply", "points3d.ply")
    )
    assert to_file < 0.5 * to_own


def test_rays_are_measured_by_the_file(data):
    """HDR-NeRF asks its data where the scene is."""
    state = begin(read_scene(data), short("hdr-nerf-small"))
    found = state.data.first_points(state.method.first_response)
    np.testing.assert_array_equal(found, read_points(data / "other.ply").positions)


def test_the_memory_that_is_told_is_of_the_file(data):
    scene = read_scene(data)
    assert sizes_of(planned(scene, short(initial_points="file"))).first == COUNT
    own = dataclasses.replace(short(initial_points="file"), points_file=None)
    assert sizes_of(planned(scene, own)).first == len(scene.points.positions) != COUNT


def test_sizes_that_are_found_are_of_the_file(data):
    """1.5 times its points have room, whatever the data set's own are."""
    write_ply(data / "many.ply", np.random.default_rng(0).uniform(-1.0, 1.0, (50_000, 3)))
    scene = read_scene(data)
    for name, budget in (("many.ply", 75_000), ("other.ply", 60_000), (None, 60_000)):
        config = dataclasses.replace(PRESETS["default"], points_file=name)
        assert found_sizes(extent_of(scene, config), config).backbone.budget == budget
    many = with_points_file(scene, "many.ply")
    config = dataclasses.replace(PRESETS["default"], points_file="other.ply")
    assert found_sizes(extent_of(many, config), config) == config


def test_a_resumed_run_keeps_the_file(data, tmp_path):
    """By its name in the data set's folder, which may have moved."""
    run = tmp_path / "run"
    words = ["--iterations", "6", "--threads", "1", "--points-file", "other.ply", "--initial-points", "file"]
    assert main(["train", str(data), "--out", str(run), *words]) == 0
    written = read_config(run / CONFIG_FILE)
    assert written.config.points_file == "other.ply"
    before = load_checkpoint(run / CHECKPOINT_FILE)[0]
    data.rename(tmp_path / "moved")
    assert main(["train", str(tmp_path / "moved"), "--resume", str(run)]) == 0
    after = load_checkpoint(run / CHECKPOINT_FILE)[0]
    assert all(torch.equal(tensor, after[name]) for name, tensor in before.items())


def test_a_file_elsewhere_is_named_by_its_whole_path(data, tmp_path, monkeypatch):
    path = tmp_path / "elsewhere.ply"
    shutil.move(data / "other.ply", path)
    config = short(initial_points="file")
    _, means = begun(data, dataclasses.replace(config, points_file=str(path)))
    assert means == places(path)
    with pytest.raises(FileMissingError, match=r"no .*other\.ply(.|\n)*physhdr prepare .*--triangulate"):
        begun(data, config)
    monkeypatch.chdir(tmp_path)  # what lies where the user stands is not meant, and is named
    with pytest.raises(FileMissingError, match=rf"no .*elsewhere\.ply(.|\n)*give all: {path}"):
        begun(data, dataclasses.replace(config, points_file="elsewhere.ply"))


def test_a_damaged_file_is_refused(data):
    path = data / "other.ply"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(FileDamagedError, match=r"other\.ply"):
        begun(data, short())


@pytest.mark.parametrize(
    ("source", "is_read"), [("file", True), ("both", True), ("stereo", False), ("random", False)]
)
def test_where_points_are_from_elsewhere_the_file_has_no_effect(source, is_read, data):
    state, means = begun(data, short(initial_points=source))
    preset = dataclasses.replace(state.config, points_file=None)
    assert changed_without_effect(state, preset) == ([] if is_read else ["--points-file"])
    assert (means == begun(data, preset)[1]) is not is_read
