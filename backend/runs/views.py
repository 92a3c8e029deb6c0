# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's data set without its pictures: ``views.json`` in the run's folder.

Rendering and exporting need only a data set's cameras, exposures, lights and the known point of the response.
With these a run can be viewed when the data set has moved or is gone; reading a picture then raises an error.
Fingerprints of the pictures (``contents``) show whether existing ones are the same. Checkpoints store the
file's digest, so that it cannot be exchanged.
"""

import hashlib
import itertools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.data_set import HELD_OUT, LIT, LIT_TEST, TEST, TRAIN, VALIDATION
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.lights import check_lights
from ...bridge.limits import EXPOSURE, LEVEL, is_number
from ...bridge.regular import read_bytes, read_json_object
from ...bridge.run_folder import CHECKPOINT_FILE, VIEWS_FILE, VIEWS_FORMAT, VIEWS_VERSION
from ..scene import Camera, Scene, View, read_scene
from ..scene.encoding import LogEncoding
from ..scene.scene import PictureCache
from ..scene.source import PictureSource, plain
from ..train.checkpoint import VIEWS, read_metadata
from .contents import Contents, contents_of, first_difference

#: What no run trains from.
NOT_TRAINED = (*HELD_OUT, LIT_TEST)

RESTORE = "Restore a copy of it, or train again with --overwrite."


def write_views(folder: Path, scene: Scene) -> str:
    """Write what rendering needs of ``scene``, and its pictures' fingerprints; raises ``OutputError``.

    Returns the SHA-256 of the file, for the run's checkpoints.
    """
    splits = {
        name: [_described(*each, scene.root) for each in zip(views, contents_of(views), strict=True)]
        for name, views in scene.splits.items()
    }
    content: dict[str, Any] = {
        "format": VIEWS_FORMAT,
        "version": VIEWS_VERSION,
        "name": scene.name,
        "layout": scene.layout,
        "anchor": scene.response_anchor,
        "lights": scene.lights,
        "standard_levels": scene.standard_levels,
        "photographs": scene.photographs,
        "splits": splits,
    }
    if (scale := _radiance_scale(scene)) is not None:
        content["radiance_scale"] = scale
    written = (json.dumps(content) + "\n").encode()
    with atomic_path(folder / VIEWS_FILE) as temporary:
        temporary.write_bytes(written)
    return hashlib.sha256(written).hexdigest()


def read_views(folder: Path, root: Path) -> Scene:
    """The scene of the run in ``folder`` without pictures, as if its data set were at ``root``.

    Raises ``FileMissingError`` if there is no such file, ``FileDamagedError``, and ``DataMismatchError`` for
    another version, or if it is not the file that the run's checkpoint was trained with.
    """
    return _scene_of(_stored(folder), folder / VIEWS_FILE, root)


def _stored(folder: Path) -> dict[str, Any]:
    """The file's content, checked against the run's checkpoint, if there is one.

    Raises as ``read_views``.
    """
    path = folder / VIEWS_FILE
    metadata = read_metadata(folder / CHECKPOINT_FILE)
    if metadata and metadata[VIEWS] != hashlib.sha256(read_bytes(path, RESTORE)).hexdigest():
        raise DataMismatchError(
            f"{path} is not the one that {folder / CHECKPOINT_FILE} was trained with: training views could "
            "pass for held-out ones",
            RESTORE,
        )
    content = read_json_object(path, RESTORE)
    if content.get("format") != VIEWS_FORMAT:
        raise FileDamagedError(f"{path} is not a {VIEWS_FORMAT} file", RESTORE)
    if content.get("version") != VIEWS_VERSION:
        raise DataMismatchError(
            f"{path} has version {content.get('version')!s:.20}, this program reads {VIEWS_VERSION}",
            "Use the version of PhysHDR that wrote it.",
        )
    return content


def _scene_of(content: Mapping[str, Any], path: Path, root: Path) -> Scene:
    """``content`` of the file at ``path`` as a scene; raises ``FileDamagedError``."""
    cache = PictureCache()
    splits: dict[str, list[View]] = {}
    try:
        lights = check_lights(content["lights"], str(path))
        standard = tuple(_level(level) for level in content["standard_levels"])
        _require(len(standard) == len(lights))
        for name, views in content["splits"].items():
            splits[name] = [_view(view, root, standard, cache) for view in views]
        anchor = content["anchor"]
        if anchor is not None:
            exposure, code = anchor
            anchor = (_number(exposure), _number(code))
            _require(anchor[0] > 0.0)
        _require(bool(splits["train"]))
        _stored_scale(content)
        _require(isinstance(content["photographs"], bool))
        return Scene(
            root,
            str(content["name"]),
            splits["train"],
            splits.get("test", []),
            splits.get("lit", []),
            response_anchor=anchor,
            lights=lights,
            layout=str(content["layout"]),
            messages=("the data set is missing: using the cameras stored in the run",),
            validation=splits.get("val", []),
            known_photographs=content["photographs"],
            lit_test=splits.get(LIT_TEST, []),
        )
    except (KeyError, TypeError, ValueError, AttributeError, BadValueError, DataMismatchError) as error:
        raise FileDamagedError(f"{path} does not hold a data set's views: {error!s:.80}", RESTORE) from error


def training_cameras(folder: Path) -> list[Camera]:
    """The cameras of the training views of a run, or of a data set. Raises what reading either raises."""
    scene = read_views(folder, folder) if (folder / VIEWS_FILE).exists() else read_scene(folder)
    return [view.camera for view in scene.train]


def as_trained(
    folder: Path,
    scene: Scene,
    report: Callable[[str], object] = lambda line: None,
    pictures: bool = True,
) -> Scene:
    """``scene``, read for the run in ``folder``, split into training and test views as in the run.

    A split may be inferred, and change if photographs are added or the rule changes, so that training views
    would be tested. Therefore the run's own split, by names of views, takes precedence, which is reported.
    If the training views are the same, the data set's present test views are used. Raises
    ``DataMismatchError`` if a training view is missing or has changed, or the known point of the response
    differs. Radiance is compared at the scale used in training, even if pictures were added since.
    ``pictures``: also compare fingerprints. Changed training pictures raise ``DataMismatchError``; changed
    held-out ones are reported.
    """
    content = _stored(folder)
    stored = _scene_of(content, folder / VIEWS_FILE, scene.root)
    if stored.lights == scene.lights and stored.standard_levels != scene.standard_levels:
        raise _other_data(folder, scene.root, "the levels of the standard light have changed")
    _require_same_anchor(stored.response_anchor, scene.response_anchor, folder, scene.root)
    scene = _at_scale(scene, _stored_scale(content), report)
    if not (_are_same(stored.train, scene.train) and _are_same(stored.lit, scene.lit)):
        scene = _divided(scene, stored, folder, report)
    return _with_known_pictures(scene, stored, content, folder, report) if pictures else scene


def _divided(scene: Scene, stored: Scene, folder: Path, report: Callable[[str], object]) -> Scene:
    """``scene`` in the splits of ``stored``; raises ``DataMismatchError``."""
    by_name: dict[str, list[View]] = {}
    for view in itertools.chain.from_iterable(scene.splits.values()):
        by_name.setdefault(view.name, []).append(view)
    for before in (*stored.train, *stored.lit):
        _require_unchanged(before, by_name.get(before.name, []), folder, scene.root)
    known = {view.name for view in (*stored.train, *stored.lit)}
    splits = {name: _unchanged(views, by_name) for name, views in stored.splits.items()}
    for name in NOT_TRAINED:
        if not stored.splits[name]:  # there were none yet, or they were hidden from a tuning plan
            splits[name] = [view for view in scene.splits[name] if view.name not in known]
    known.update(view.name for views in splits.values() for view in views)
    message = f"using the run's training and test views: {scene.root} now divides them differently"
    if unknown := len(by_name.keys() - known):
        message += f", and has {unknown} more, which are ignored"
    report(message)
    return _with_splits(scene, splits, message)


def _with_known_pictures(
    scene: Scene, stored: Scene, content: Mapping[str, Any], folder: Path, report: Callable[[str], object]
) -> Scene:
    """``scene``, its views in the order of ``stored``'s, with messages on changed held-out pictures.

    Raises ``DataMismatchError`` for a changed training picture.
    """
    for name in (TRAIN, LIT):
        if difference := first_difference(scene.splits[name], _contents(content, name)):
            raise _other_data(folder, scene.root, difference)
    for name in NOT_TRAINED:
        before = {
            view.name: each for view, each in zip(stored.splits[name], _contents(content, name), strict=True)
        }
        views = [view for view in scene.splits[name] if len(before.get(view.name, ())) == len(view.sources)]
        if difference := first_difference(views, [before[view.name] for view in views]):
            message = f"held-out pictures have changed since the run was started: {difference}"
            report(message)
            scene = replace(scene, messages=(*scene.messages, message))
    return scene


def has_its_pictures(folder: Path, scene: Scene) -> bool:
    """Whether the training pictures of ``scene``, split as the run in ``folder``, are those of the run."""
    content = _stored(folder)
    return not any(first_difference(scene.splits[name], _contents(content, name)) for name in (TRAIN, LIT))


def _contents(content: Mapping[str, Any], split: str) -> list[list[Contents]]:
    return [view["contents"] for view in content["splits"].get(split, ())]


def _radiance_scale(scene: Scene) -> float | None:
    """The scale of pictures of radiance, one for a whole data set; None without any."""
    views = itertools.chain.from_iterable(scene.splits.values())
    encodings = (encoding for view in views for encoding in view.encodings)
    return next((each.scale for each in encodings if isinstance(each, LogEncoding)), None)


def _stored_scale(content: Mapping[str, Any]) -> float | None:
    """``_radiance_scale`` in a run's file. Raises as ``_view``."""
    stored = content.get("radiance_scale")
    return None if stored is None else LogEncoding(_number(stored)).scale


def _at_scale(scene: Scene, scale: float | None, report: Callable[[str], object]) -> Scene:
    """``scene`` with its pictures of radiance at the run's ``scale``; None: unchanged."""
    now = _radiance_scale(scene)
    if scale is None or now is None or now == scale:
        return scene

    def scaled(source: PictureSource) -> PictureSource:
        is_radiance = isinstance(source.encoding, LogEncoding)
        return replace(source, encoding=LogEncoding(scale)) if is_radiance else source

    splits = {
        name: [replace(view, sources=tuple(map(scaled, view.sources))) for view in views]
        for name, views in scene.splits.items()
    }
    message = f"comparing radiance at the run's scale, {scale:g}: that of {scene.root} is now {now:g}"
    report(message)
    return _with_splits(scene, splits, message)


def _with_splits(scene: Scene, splits: Mapping[str, list[View]], message: str) -> Scene:
    """``scene`` with these views and a further ``message``."""
    return replace(
        scene,
        train=splits[TRAIN],
        test=splits[TEST],
        lit=splits[LIT],
        validation=splits[VALIDATION],
        lit_test=splits[LIT_TEST],
        messages=(*scene.messages, message),
    )


def _require_same_anchor(
    before: tuple[float, float] | None, now: tuple[float, float] | None, folder: Path, root: Path
) -> None:
    """Raises ``DataMismatchError`` if they differ, because learned curves are shifted to pass the point."""
    if before == now or (before is not None and now is not None and np.allclose(before, now)):
        return
    one, other = ("none" if each is None else f"{each[1]:g} at {each[0]:g}" for each in (before, now))
    raise _other_data(folder, root, f"the known point of the response was {one}, and is now {other}")


def _are_same(before: Sequence[View], now: Sequence[View]) -> bool:
    return len(before) == len(now) and all(
        one.name == other.name and one.bracket == other.bracket and not _difference(one, other)
        for one, other in zip(before, now, strict=True)
    )


def _unchanged(stored: Sequence[View], by_name: Mapping[str, list[View]]) -> list[View]:
    """The unchanged ones of ``stored``, with their pictures, and the run's own places in the bracket."""
    found = []
    for before in stored:
        same = (now for now in by_name.get(before.name, ()) if not _difference(before, now))
        if (now := next(same, None)) is not None:
            found.append(replace(now, bracket=before.bracket))
    return found


def _require_unchanged(before: View, now: Sequence[View], folder: Path, root: Path) -> None:
    """Raises ``DataMismatchError`` if none of the views ``now`` is the one that was trained on."""
    different = [_difference(before, view) for view in now]
    if "" not in different:
        found = different[0] if different else "it is missing"
        raise _other_data(folder, root, f"view {before.name}: {found}")


def _other_data(folder: Path, root: Path, difference: str) -> DataMismatchError:
    return DataMismatchError(
        f"{root} is not the data set that {folder} was trained on: {difference}",
        "Give the original data set, unchanged, or train again. The run can still be viewed without "
        "pictures.",
    )


def _difference(before: View, now: View) -> str:
    """A description of the first difference that matters in training, apart from pictures; empty if none."""
    one, other = before.camera, now.camera
    if not np.allclose(one.camera_to_world, other.camera_to_world, atol=1e-5):
        return "the camera's pose has changed"
    if (one.width, one.height) != (other.width, other.height):
        return f"the pictures were {one.width}×{one.height}, and are now {other.width}×{other.height}"
    lenses = [(camera.fx, camera.fy, camera.cx, camera.cy) for camera in (one, other)]
    if not np.allclose(*lenses, rtol=1e-5, atol=1e-3):
        return "the camera's focal length or principal point has changed"
    if len(before.exposures) != len(now.exposures) or not np.allclose(before.exposures, now.exposures):
        return "the exposures have changed"
    # A further light at the standard level does not change views.
    if not (before.is_standard and now.is_standard) and before.lighting_levels != now.lighting_levels:
        return "the light has changed"
    if before.group != now.group:
        return "its group of light has changed"
    return ""


def _described(view: View, contents: list[Contents], root: Path) -> dict[str, Any]:
    camera = view.camera
    return {
        "name": view.name,
        "index": view.index,
        "exposures": view.exposures,
        "bracket": view.bracket,
        "levels": view.lighting_levels,
        "group": view.group,
        "pictures": [_name(path, root) for path in view.image_paths],
        "contents": contents,
        "pose": camera.camera_to_world.reshape(-1).tolist(),
        "size": [camera.width, camera.height],
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
    }


def _name(path: Path, root: Path) -> str:
    """A picture's path within the data set; empty if it is elsewhere, or not text."""
    with suppress(ValueError):
        name = os.path.relpath(path, root) if not path.is_relative_to(root) else str(path.relative_to(root))
        name.encode("utf-8")
        return Path(name).as_posix()
    return ""


def _view(stored: dict[str, Any], root: Path, standard: tuple[float, ...], cache: PictureCache) -> View:
    """Raises ``KeyError``, ``TypeError``, ``ValueError`` and ``BadValueError`` for an invalid view."""
    exposures = tuple(_number(seconds) for seconds in stored["exposures"])
    levels = tuple(None if level is None else _level(level) for level in stored["levels"])
    _require(all(seconds in EXPOSURE for seconds in exposures))
    _require(len(levels) == len(standard))
    pose = np.array([_number(value) for value in stored["pose"]], np.float64).reshape(4, 4)
    width, height = (_whole(side) for side in stored["size"])
    _require(width > 0 and height > 0)
    fx, fy, cx, cy = (_number(value) for value in stored["intrinsics"])
    contents = stored["contents"]
    _require(isinstance(contents, list) and len(contents) == len(exposures))
    _require(all(isinstance(each, dict) for each in contents))
    return View(
        name=str(stored["name"]),
        camera=Camera(pose, width, height, fx, fy, cx, cy),
        exposures=exposures,
        sources=plain(root / str(name) for name in stored["pictures"]),
        index=_whole(stored["index"]),
        lighting_levels=levels,
        cache=cache,
        bracket=tuple(_whole(place) for place in stored["bracket"]),
        standard_levels=standard,
        group=str(stored["group"]),
    )


def _number(value: Any) -> float:
    _require(is_number(value))
    return float(value)


def _level(value: Any) -> float:
    level = _number(value)
    _require(level == 0.0 or level in LEVEL)
    return level


def _whole(value: Any) -> int:
    _require(type(value) is int)
    return value


def _require(is_right: bool) -> None:
    if not is_right:
        raise ValueError("a value is invalid")
