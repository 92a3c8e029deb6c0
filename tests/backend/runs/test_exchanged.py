# SPDX-License-Identifier: GPL-3.0-or-later
"""Other pictures under a run, of the same names and sizes, or another list of its views: never silent."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.runs.begin import Workshop, resume_run, start_run
from physhdr.backend.runs.contents import contents_of
from physhdr.backend.runs.run import open_run
from physhdr.backend.runs.views import training_cameras
from physhdr.backend.scene import read_scene
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.trainer import run as train
from physhdr.bridge.errors import DataMismatchError, FileMissingError
from physhdr.bridge.run_folder import CHECKPOINT_FILE, VIEWS_FILE
from physhdr.tests.backend.scene import layouts

CONFIG = TrainConfig(iterations=8, initial_points="random", random_points=50)


def workshop(report=lambda line: None) -> Workshop:
    return Workshop(report=report, expect=report, compile_kernels=lambda needs: None, device="cpu")


@pytest.fixture(scope="module")
def begun(tmp_path_factory) -> Path:
    """``data``: photographs through a lens, each with a mask; ``run``: a training on them, stopped."""
    home = tmp_path_factory.mktemp("begun")
    layouts.write_nerfstudio(home / "data", masks=True, exposure_time=0.5, k1=0.02)
    words = {"typed": ["iterations"], "overwrite": False, "workshop": workshop()}
    with start_run(home / "data", home / "run", CONFIG, "default", **words) as (state, run):
        for _ in train(state, run.folder, should_stop=lambda: state.iteration >= 3):
            pass
    return home


@pytest.fixture
def home(begun, tmp_path) -> Path:
    return Path(shutil.copytree(begun, tmp_path / "home"))


def invert(path: Path) -> None:
    """A negative of the same size in pixels."""
    Image.fromarray(255 - np.asarray(Image.open(path))).save(path)


def trained(home: Path) -> list[Path]:
    return [view.image_paths[0] for view in read_scene(home / "data").train]


def all_negative(home: Path) -> str:
    for path in (home / "data" / "images").iterdir():
        invert(path)
    return trained(home)[0].name


def two_swapped(home: Path) -> str:
    one, other = trained(home)[1], trained(home)[3]
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)
    return one.name


def one_pixel(home: Path) -> str:
    path = trained(home)[2]
    pixels = np.asarray(Image.open(path)).copy()
    pixels[30, 40, 1] ^= 1
    Image.fromarray(pixels).save(path)
    return path.name


def one_mask(home: Path) -> str:
    path = trained(home)[2]
    invert(home / "data" / "masks" / path.name)
    return f"{path.name} has a different mask"


def one_mask_removed(home: Path) -> str:
    transforms = home / "data" / "transforms.json"
    content = json.loads(transforms.read_text())
    name = trained(home)[2].name
    for frame in content["frames"]:
        if frame["file_path"].endswith(name):
            del frame["mask_path"]
    transforms.write_text(json.dumps(content))
    return f"{name} has a different mask"


def another_lens(home: Path) -> str:
    """So little that the camera without distortion is as good as the same."""
    transforms = home / "data" / "transforms.json"
    transforms.write_text(transforms.read_text().replace('"p1": 0.0', '"p1": 1e-06'))
    return "a different lens"


EXCHANGES = (all_negative, two_swapped, one_pixel, one_mask, one_mask_removed, another_lens)


@pytest.mark.parametrize("exchange", EXCHANGES)
def test_other_pictures_are_not_trained_on(exchange, home):
    checkpoint = (home / "run" / CHECKPOINT_FILE).read_bytes()
    said = exchange(home)
    with (
        pytest.raises(DataMismatchError, match=f"is not the data set that .* was trained on: .*{said}"),
        resume_run(home / "run", home / "data", workshop()),
    ):
        pass
    with pytest.raises(DataMismatchError, match=said):
        open_run(home / "run", home / "data", report=lambda line: None)  # to evaluate it
    assert (home / "run" / CHECKPOINT_FILE).read_bytes() == checkpoint
    # It can be looked at, and nothing is told by pictures that are not its own.
    run = open_run(home / "run", home / "data", report=lambda line: None, pictures=False)
    assert run.iteration == 3 and run.seen() is None


def test_the_same_pictures_elsewhere_are(home):
    data = home / "data"
    data.rename(home / "moved")
    with resume_run(home / "run", home / "moved", workshop()) as (state, run):
        assert state.iteration == 3 and len(run.seen()) == len(run.scene.train)


def test_other_held_out_pictures_are_reported(home):
    path = read_scene(home / "data").test[0].image_paths[0]
    invert(path)
    told = []
    with resume_run(home / "run", home / "data", workshop(told.append)) as (state, run):
        assert state.iteration == 3
    (line,) = (line for line in told if "held-out" in str(line))
    assert str(path) in line and line in run.scene.messages


def test_what_is_done_to_pictures_is_told_but_for_rounding(home):
    """Machines round differently in the last digit."""
    view = read_scene(home / "data").train[0]
    (source,) = view.sources

    def told(fx: float) -> object:
        lens = dataclasses.replace(source.lens, fx=fx)
        return contents_of([dataclasses.replace(view, sources=(dataclasses.replace(source, lens=lens),))])

    fx = source.lens.fx
    assert told(np.nextafter(fx, 1e9)) == told(fx) == contents_of([view])
    assert told(fx * 1.001) != told(fx)


# ---- views.json ------------------------------------------------------------------------------------------


def swap(content: dict) -> None:
    splits = content["splits"]
    splits["train"], splits["test"] = splits["test"], splits["train"]


def move(content: dict) -> None:
    content["splits"]["train"][0]["pose"][3] += 0.1


@pytest.mark.parametrize("change", [swap, move, lambda content: None])
def test_a_list_of_views_belongs_to_its_checkpoint(change, home):
    """With train and test swapped, views that were trained on would be reported as held out."""
    path, checkpoint = home / "run" / VIEWS_FILE, (home / "run" / CHECKPOINT_FILE).read_bytes()
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content, indent=1))
    opened = {"report": lambda line: None, "data": home / "data"}
    for read in (
        lambda: resume_run(home / "run", home / "data", workshop()).__enter__(),
        lambda: open_run(home / "run", **opened),
        lambda: open_run(home / "run", pictures=False, **opened),
        lambda: training_cameras(home / "run"),
    ):
        with pytest.raises(DataMismatchError, match=f"{VIEWS_FILE} is not the one that .* was trained with"):
            read()
    path.unlink()
    with pytest.raises(FileMissingError, match=VIEWS_FILE):
        open_run(home / "run", **opened)
    assert (home / "run" / CHECKPOINT_FILE).read_bytes() == checkpoint


def test_of_a_run_that_has_saved_nothing_yet_the_list_is_what_there_is(home):
    (home / "run" / CHECKPOINT_FILE).unlink()
    assert len(training_cameras(home / "run")) == len(trained(home))
    with pytest.raises(FileMissingError, match="no checkpoint"):
        open_run(home / "run", home / "data", report=lambda line: None)


def test_what_is_resumed_stays_bound(home):
    with resume_run(home / "run", home / "data", workshop()) as (state, run):
        for _ in train(state, run.folder):
            pass
    assert open_run(home / "run", home / "data", report=lambda line: None).iteration == CONFIG.iterations
