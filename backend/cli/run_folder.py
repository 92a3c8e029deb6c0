# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's folder as the commands use it: its data set, configuration and trained method."""

import os
from dataclasses import dataclass
from pathlib import Path

from ...bridge.errors import OutputError
from ..device import DeviceName, choose_device
from ..methods.physhdr import PhysHDR
from ..rasterize import Implementation
from ..scene import Scene, read_scene
from ..train.config import CONFIG_FILE, TrainConfig, read_config
from ..train.trainer import load_method
from .progress import console


@dataclass(frozen=True)
class Run:
    """What ``physhdr train --out`` left behind."""

    folder: Path
    preset: str
    config: TrainConfig
    scene: Scene
    method: PhysHDR
    iteration: int


def open_run(
    folder: Path, data: Path | None = None, rasteriser: Implementation = "auto", device: DeviceName = "cpu"
) -> Run:
    """Open a trained run; ``data`` stands in for the folder it was trained on, where that has moved."""
    config, trained_on, preset = read_config(folder / CONFIG_FILE)
    scene = read_scene(data or trained_on)
    method, iteration = load_method(
        folder, config, scene.response_anchor, rasteriser, choose_device(device, console.print)[0]
    )
    return Run(folder, preset, config, scene, method, iteration)


def writable_folder(path: Path) -> Path:
    """Make the folder and make sure that files can be made in it; raises ``OutputError``."""
    remedy = "Choose another --out, or make it writable."
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".physhdr-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"cannot write to {path}: {error.strerror}", remedy) from error
    if not os.access(path, os.W_OK):  # root may write anywhere, whatever the permissions say
        raise OutputError(f"cannot write to {path}: it is read-only", remedy)
    return path
