# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's data set without its pictures: ``views.json`` in the run's folder.

Cameras, exposures, lights and the known point of the response are all that drawing and exporting need of a
data set. With them a run can be looked at when the data set has moved or is gone; whoever asks for a picture
is told that it is not there.
"""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.lights import check_lights
from ...bridge.limits import EXPOSURE, LEVEL, is_number
from ...bridge.regular import read_json_object
from ...bridge.run_folder import VIEWS_FILE, VIEWS_FORMAT, VIEWS_VERSION
from ..scene import Camera, Scene, View, read_scene
from ..scene.scene import PictureCache
from ..scene.source import plain
from ..train.config import CONFIG_FILE, read_config

RESTORE = "Restore a copy, or name the run's data set."


def write_views(folder: Path, scene: Scene) -> None:
    """Keep what drawing needs of ``scene``; raises ``OutputError``."""
    content = {
        "format": VIEWS_FORMAT,
        "version": VIEWS_VERSION,
        "name": scene.name,
        "layout": scene.layout,
        "anchor": scene.response_anchor,
        "lights": scene.lights,
        "splits": {name: [_told(view, scene.root) for view in views] for name, views in scene.splits.items()},
    }
    with atomic_path(folder / VIEWS_FILE) as temporary:
        temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")


def read_views(folder: Path, root: Path) -> Scene:
    """The scene of the run in ``folder`` with no picture in reach, as if its data set still were at ``root``.

    Raises ``FileMissingError`` where the run kept none (those of earlier versions), ``FileDamagedError``, and
    ``DataMismatchError`` for another version.
    """
    path = folder / VIEWS_FILE
    content = read_json_object(path, RESTORE)
    if content.get("format") != VIEWS_FORMAT:
        raise FileDamagedError(f"{path} is none of ours", RESTORE)
    if content.get("version") != VIEWS_VERSION:
        raise DataMismatchError(
            f"{path} has version {content.get('version')!s:.20}, this program reads {VIEWS_VERSION}",
            "Use the version of PhysHDR that wrote it, or name the run's data set.",
        )
    cache = PictureCache()
    splits: dict[str, list[View]] = {}
    try:
        lights = check_lights(content["lights"], str(path))
        for name, views in content["splits"].items():
            splits[name] = [_view(told, root, len(lights), cache) for told in views]
        anchor = content["anchor"]
        if anchor is not None:
            exposure, code = anchor
            anchor = (_number(exposure), _number(code))
            _require(anchor[0] > 0.0)
        _require(bool(splits["train"]))
        return Scene(
            root,
            str(content["name"]),
            splits["train"],
            splits.get("test", []),
            splits.get("lit", []),
            response_anchor=anchor,
            lights=lights,
            layout=str(content["layout"]),
            messages=("the data set is not there: the run knows its cameras",),
            validation=splits.get("val", []),
        )
    except (KeyError, TypeError, ValueError, AttributeError, BadValueError, DataMismatchError) as error:
        raise FileDamagedError(f"{path} does not hold a data set's views: {error!s:.80}", RESTORE) from error


def training_cameras(folder: Path) -> list[Camera]:
    """The cameras of the training views of a run, or of a data set. Raises what reading either raises."""
    if (folder / VIEWS_FILE).exists():
        scene = read_views(folder, folder)
    elif (folder / CONFIG_FILE).exists():
        written = read_config(folder / CONFIG_FILE)
        scene = read_scene(written.data, written.config.downscale, written.config.color_space)
    else:
        scene = read_scene(folder)
    return [view.camera for view in scene.train]


def require_same_views(folder: Path, scene: Scene) -> None:
    """Raises ``DataMismatchError`` where the run in ``folder`` was trained on other views than ``scene`` has.

    Of runs that kept nothing nothing can be said.
    """
    if not (folder / VIEWS_FILE).exists():
        return
    kept = read_views(folder, scene.root)
    same = len(kept.train) == len(scene.train) and all(
        before.name == now.name
        and np.allclose(before.camera.camera_to_world, now.camera.camera_to_world, atol=1e-5)
        for before, now in zip(kept.train, scene.train, strict=True)
    )
    if not same:
        raise DataMismatchError(
            f"{scene.root} is not the data set that {folder} was trained on: its cameras stand elsewhere",
            "Choose the one that it was trained on, or none: it can be looked at without.",
        )


def _told(view: View, root: Path) -> dict[str, Any]:
    camera = view.camera
    return {
        "name": view.name,
        "index": view.index,
        "exposures": view.exposures,
        "bracket": view.bracket,
        "levels": view.lighting_levels,
        "pictures": [_name(path, root) for path in view.image_paths],
        "pose": camera.camera_to_world.reshape(-1).tolist(),
        "size": [camera.width, camera.height],
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
    }


def _name(path: Path, root: Path) -> str:
    """A picture's path within the data set; empty where it lies elsewhere, or is no text."""
    with suppress(ValueError):
        name = os.path.relpath(path, root) if not path.is_relative_to(root) else str(path.relative_to(root))
        name.encode("utf-8")
        return Path(name).as_posix()
    return ""


def _view(told: dict[str, Any], root: Path, lights: int, cache: PictureCache) -> View:
    """Raises ``KeyError``, ``TypeError``, ``ValueError`` and ``BadValueError`` for what is no view."""
    exposures = tuple(_number(seconds) for seconds in told["exposures"])
    levels = tuple(_number(level) for level in told["levels"])
    _require(all(seconds in EXPOSURE for seconds in exposures))
    _require(len(levels) == lights and all(level == 0.0 or level in LEVEL for level in levels))
    pose = np.array([_number(value) for value in told["pose"]], np.float64).reshape(4, 4)
    width, height = (_whole(side) for side in told["size"])
    _require(width > 0 and height > 0)
    fx, fy, cx, cy = (_number(value) for value in told["intrinsics"])
    return View(
        name=str(told["name"]),
        camera=Camera(pose, width, height, fx, fy, cx, cy),
        exposures=exposures,
        sources=plain(root / str(name) for name in told["pictures"]),
        index=_whole(told["index"]),
        lighting_levels=levels,
        cache=cache,
        bracket=tuple(_whole(place) for place in told["bracket"]),
    )


def _number(value: Any) -> float:
    _require(is_number(value))
    return float(value)


def _whole(value: Any) -> int:
    _require(type(value) is int)
    return value


def _require(is_right: bool) -> None:
    if not is_right:
        raise ValueError("a value is none that a view can have")
