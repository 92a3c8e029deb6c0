# SPDX-License-Identifier: GPL-3.0-or-later
"""How a run begins: with the sizes that its data call for, which are told and kept, and what is typed."""

import dataclasses
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.runs import begin as beginning
from physhdr.backend.runs.begin import Workshop, resume_run, start_run
from physhdr.backend.runs.run import open_run
from physhdr.backend.serve.engine import CancelledError
from physhdr.backend.train.config import CONFIG_FILE, TrainConfig, read_config
from physhdr.backend.train.events import Saved
from physhdr.backend.train.forecast import duration, size
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import run as train
from physhdr.bridge.errors import BadValueError, DataMismatchError, OutputError
from physhdr.bridge.run_folder import CHECKPOINT_FILE

PRESET = TrainConfig(initial_points="random", random_points=150)


@pytest.fixture
def told():
    return []


@pytest.fixture
def workshop(told):
    return Workshop(report=told.append, expect=told.append, compile_kernels=lambda needs: None, device="cpu")


@pytest.fixture(autouse=True)
def large_pictures(monkeypatch):
    """As if the presets were made for pictures a hundredth as large as these."""
    monkeypatch.setattr(size, "REFERENCE_PIXELS", 10)


@pytest.fixture(autouse=True)
def untimed(monkeypatch):
    """How long such a training takes is found by steps with as many Gaussians as it ends with."""
    monkeypatch.setattr(beginning, "time_training", lambda *_, **__: None)


def begin(data, out, workshop, config=PRESET, typed=()):
    return start_run(data, out, config, "default", typed=typed, overwrite=False, workshop=workshop)


def test_what_is_found_is_told_and_written_and_is_what_a_resume_has(tiny_data, tmp_path, workshop, told):
    with begin(tiny_data, tmp_path / "run", workshop) as (state, run):
        save(state, run.folder)
    written = read_config(tmp_path / "run" / CONFIG_FILE).config
    assert written == run.config == state.config
    assert written.iterations > PRESET.iterations and written.backbone.budget > PRESET.backbone.budget
    assert any(f"{written.iterations:,} iterations" in str(line) for line in told)
    told.clear()
    with resume_run(tmp_path / "run", None, workshop) as (resumed, _):
        assert resumed.config == written
    assert not any("megapixels" in str(line) for line in told)  # nothing is found anew


def test_a_run_whose_folder_is_moved_is_not_split_in_two(tiny_data, tmp_path, workshop):
    """What was saved last goes with the folder, and the run goes on from there."""
    out, moved = tmp_path / "run", tmp_path / "moved"
    short = dataclasses.replace(PRESET, iterations=20)
    with begin(tiny_data, out, workshop, short, ["iterations"]) as (state, run):
        told = train(state, run.folder, checkpoint_seconds=0.0)
        while not isinstance(saved := next(told), Saved):
            pass
        out.rename(moved)
        with pytest.raises(OutputError, match=f"{out} was moved or deleted") as caught:
            list(told)
    assert "resume the run there" in caught.value.hint and not out.exists()
    with resume_run(moved, None, workshop) as (resumed, _):
        assert resumed.iteration == saved.iteration


def test_what_is_stopped_before_it_can_begin_leaves_the_run_that_was_there(tiny_data, tmp_path, workshop):
    """The state was being made meanwhile, for seconds, and too short a training is not timed."""
    out = tmp_path / "run"
    with begin(tiny_data, out, workshop) as (state, run):
        save(state, run.folder)
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}

    def stop():
        raise CancelledError("stopped")

    stopped = dataclasses.replace(workshop, between=stop)
    short = dataclasses.replace(PRESET, iterations=20, seed=1)
    with (
        pytest.raises(CancelledError),
        start_run(tiny_data, out, short, "default", typed=["iterations"], overwrite=True, workshop=stopped),
    ):
        pass
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before


def test_a_run_is_not_resumed_with_another_data_set(tiny_data, tmp_path, workshop):
    out, moved = tmp_path / "run", tmp_path / "moved"
    with begin(tiny_data, out, workshop) as (state, run):
        save(state, run.folder)
    shutil.copytree(tiny_data, moved)
    with resume_run(out, moved, workshop) as (resumed, _):
        assert resumed.config == run.config
    take_from_elsewhere(moved)
    before = (out / CHECKPOINT_FILE).read_bytes()
    with pytest.raises(DataMismatchError, match="pose has changed"), resume_run(out, moved, workshop):
        pass
    assert (out / CHECKPOINT_FILE).read_bytes() == before


def test_nor_with_its_own_where_that_has_become_another(tiny_data, tmp_path, workshop, told):
    """The same folder, cameras found anew in it: nothing was asked of it, as nobody had typed it."""
    out, data = tmp_path / "run", shutil.copytree(tiny_data, tmp_path / "data")
    with begin(data, out, workshop) as (state, run):
        save(state, run.folder)
    with resume_run(out, None, workshop):
        pass
    take_from_elsewhere(data)
    with pytest.raises(DataMismatchError, match="pose has changed"), resume_run(out, None, workshop):
        pass
    with pytest.raises(DataMismatchError, match="pose has changed"):
        open_run(out)
    # It can be looked at: from where its own cameras stood.
    told.clear()
    looked_at = open_run(out, report=told.append, pictures=False)
    poses = [each.scene.train[0].camera.camera_to_world for each in (looked_at, run)]
    assert np.array_equal(*poses) and looked_at.scene.root == data
    assert looked_at.seen() is None  # the pictures that are there now are not the ones it was trained on
    assert any("opened by what the run keeps" in str(line) for line in told)


def take_from_elsewhere(data: Path) -> None:
    """The same names of pictures, one of them taken from elsewhere."""
    cameras = data / "transforms_train.json"
    content = json.loads(cameras.read_text())
    content["frames"][0]["transform_matrix"][0][3] += 0.1
    cameras.write_text(json.dumps(content))


def test_what_is_typed_is_what_is_trained(tiny_data, tmp_path, workshop):
    typed = ("iterations", "backbone.budget", "half_size_until", "random_points", "optimiser.rates_for")
    with begin(tiny_data, tmp_path / "run", workshop, typed=typed) as (state, _):
        assert state.config == PRESET


def test_how_long_it_will_take_is_told(tiny_data, tmp_path, workshop, told, monkeypatch):
    monkeypatch.setattr(duration, "SHARE", math.inf)
    monkeypatch.setattr(beginning, "time_training", duration.time_training)
    config = dataclasses.replace(PRESET, iterations=30, random_points=100)
    typed = ("iterations", "random_points")
    with begin(tiny_data, tmp_path / "run", workshop, config, typed):
        pass
    (expected,) = (line for line in told if isinstance(line, duration.Duration))
    assert f"training will take {expected}" in told and expected.seconds > 0.0


def test_a_colour_space_that_there_is_not_is_refused(tiny_data, tmp_path, workshop):
    config = dataclasses.replace(PRESET, color_space="srgb-ish")
    with pytest.raises(BadValueError), begin(tiny_data, tmp_path / "run", workshop, config):
        pass
    assert not (tmp_path / "run").exists()
