# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's folder: its configuration, its checkpoint and its views, as they are opened and trained on."""

import dataclasses
import functools
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from .cases import InsaneError, Target
from .mutate import once, tests_module

#: A few iterations of every kind of method and backbone; of each what it has in its checkpoint differs.
PRESETS = ("default", "default-scaffold", "paper-short", "hdr-nerf-small")
ITERATIONS = 3
#: Digests of the files of a run and its data set, as they were written.
WHOLE = "whole.json"
#: Data that the runs were trained on: beside them, and not itself a thing that is changed.
DATA = "data-of-the-runs"


@functools.cache
def _scene(folder: Path) -> Any:
    from physhdr.backend.scene import read_scene

    return read_scene(folder)


def _data(seeds: Path) -> Path:
    """The data set beside the folder of variants; made once."""
    folder = seeds.parent / DATA
    if not folder.exists():
        tiny = tests_module("backend/tiny_scene.py")
        once(folder, lambda work: tiny.write_tiny_scene(work, size=16, gaussians=20))
    return folder


def write_runs(folder: Path) -> None:
    from physhdr.backend.runs.views import write_views
    from physhdr.backend.train.begin import begin
    from physhdr.backend.train.config import CONFIG_FILE, write_config
    from physhdr.backend.train.presets import PRESETS as ALL
    from physhdr.backend.train.trainer import run as train

    data = _data(folder)
    for preset in PRESETS:
        run = folder / preset
        run.mkdir(parents=True)
        config = dataclasses.replace(ALL[preset], iterations=ITERATIONS, random_points=50)
        if preset == "hdr-nerf-small":
            config = _small_networks(config)
        write_config(run / CONFIG_FILE, config, data, preset)
        state = begin(_scene(data), config, "reference")
        state.views_digest = write_views(run, state.plan.seen.scene)
        for _ in train(state, run, should_stop=lambda state=state: state.iteration >= ITERATIONS - 1):
            pass


def _small_networks(config: Any) -> Any:
    """HDR-NeRF's networks of a size that is damaged and read in no time."""
    field = dataclasses.replace(config.method.field, width=8, view_width=8)
    method = dataclasses.replace(
        config.method, field=field, rays_per_iteration=8, coarse_samples=4, fine_samples=4
    )
    return dataclasses.replace(config, method=method)


def load(folder: Path, file: str, _: bytes) -> None:
    """The file alone."""
    from physhdr.backend.train.checkpoint import load_checkpoint

    tensors, metadata = load_checkpoint(folder / file)
    _require(all(isinstance(value, str) for value in metadata.values()), "metadata that are not text")
    _require(all(isinstance(name, str) for name in tensors), "a tensor's name")


def open_(folder: Path, file: str, _: bytes) -> None:
    """As every command opens a run; then it is drawn."""
    from physhdr.backend.runs.run import open_run

    data = _data(folder.parent)
    run = open_run(folder, data, "reference", "cpu", report=lambda text: None)
    _require(0 <= run.iteration <= run.config.iterations, "an iteration beyond the last")
    _require(run.preset.isprintable(), "a preset's name")
    camera = run.scene.test[0].camera
    picture = run.method.hdr(camera)
    _require(tuple(picture.shape) == (3, camera.height, camera.width), "a picture's shape")
    _require(bool(picture.isfinite().all()), "radiance that is not finite")


def resume(folder: Path, file: str, _: bytes) -> None:
    """Resume a training to its end; one that diverges must report that and leave the checkpoint alone."""
    from physhdr.backend.train.begin import resume as resumed
    from physhdr.backend.train.config import CONFIG_FILE, read_config
    from physhdr.backend.train.state import TrainingDivergedError
    from physhdr.backend.train.trainer import run as train
    from physhdr.bridge.run_folder import CHECKPOINT_FILE

    path = folder / CHECKPOINT_FILE
    before = path.read_bytes() if path.is_file() else b""
    config = read_config(folder / CONFIG_FILE).config
    state = resumed(folder, _scene(_data(folder.parent)), config, "reference")
    _require(0 <= state.iteration <= config.iterations, "an iteration beyond the last")
    _require(math.isfinite(state.seconds) and state.seconds >= 0.0, "the seconds that it took")
    try:
        for event in train(state, folder):
            losses = getattr(event, "losses", {})
            _require(all(np.isfinite(value) for value in losses.values()), "a loss that is not a number")
    except TrainingDivergedError:
        _require(path.read_bytes() == before, "a checkpoint of what diverged")
        raise
    finally:  # for the next case
        path.write_bytes(before)


def write_run_and_data(folder: Path) -> None:
    """A run of one preset, and beside it the data set that it was trained on, with masks."""
    from physhdr.backend.runs.begin import start_run
    from physhdr.backend.train.config import TrainConfig
    from physhdr.backend.train.trainer import run as train

    home = folder / "photographs"
    layouts = tests_module("backend/scene/layouts.py")
    layouts.write_nerfstudio(home / "data", masks=True, exposure_time=0.5)
    config = TrainConfig(iterations=ITERATIONS, initial_points="random", random_points=50)
    words: dict[str, Any] = {"typed": ["iterations"], "overwrite": False, "workshop": _workshop([])}
    with start_run(home / "data", home / "run", config, "default", **words) as (state, run):
        for _ in train(state, run.folder, should_stop=lambda: state.iteration >= ITERATIONS - 1):
            pass
    digests = {str(path.relative_to(home)): _digest(path) for path in home.rglob("*") if path.is_file()}
    (home / WHOLE).write_text(json.dumps(digests))


def _digest(path: Path) -> str:
    """Of a file; of a checkpoint its own, however its header is spaced."""
    from physhdr.backend.train.checkpoint import DIGEST, read_metadata

    if path.name == CHECKPOINT[0] and (metadata := read_metadata(path)):
        return metadata[DIGEST]
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _workshop(messages: list[Any]) -> Any:
    from physhdr.backend.runs.begin import Workshop

    return Workshop(
        report=messages.append,
        expect=messages.append,
        compile_kernels=lambda needs: None,
        device="cpu",
        rasteriser="reference",
    )


def exchange(folder: Path, file: str, _: bytes) -> None:
    """As a training resumes with another file in the place of one that it has seen: never silently."""
    from physhdr.backend.runs.begin import resume_run

    messages: list[Any] = []
    with resume_run(folder / "run", folder / "data", _workshop(messages)):
        pass
    same = _digest(folder / file) == json.loads((folder / WHOLE).read_text())[file]
    # Held out pictures may be others, or be gone: then the split is not found as it was.
    lines = [str(message) for message in messages]
    reported = any("held-out pictures" in line or "divides them differently" in line for line in lines)
    _require(same or reported, "another file than it was trained with")


def _require(right: bool, what: str) -> None:
    if not right:
        raise InsaneError(f"accepted though wrong is {what}")


CHECKPOINT, CONFIG = ("checkpoint.safetensors",), ("config.json",)
SEEN = ("data/images/*", "data/masks/*", "run/views.json", "run/checkpoint.safetensors")

TARGETS = (
    Target("checkpoint: bytes", write_runs, load, 2500, chosen=CHECKPOINT),
    Target("checkpoint: open", write_runs, open_, 1200, chosen=CHECKPOINT, patience=40.0),
    Target("checkpoint: resume", write_runs, resume, 800, chosen=CHECKPOINT, patience=40.0),
    Target("run: files exchanged", write_run_and_data, exchange, 800, chosen=SEEN, patience=40.0),
    Target("config.json: open", write_runs, open_, 1000, chosen=CONFIG, patience=40.0),
    Target("config.json: resume", write_runs, resume, 700, chosen=CONFIG, patience=40.0),
)
