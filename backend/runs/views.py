# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's data set without its pictures: ``views.json`` in the run's folder.

Cameras, exposures, lights and the known point of the response are all that drawing and exporting need of a
data set. With them a run can be looked at when the data set has moved or is gone; whoever asks for a picture
is told that it is not there. What its pictures held (``contents``) tells whether those that are there are the
same. A checkpoint names the file's digest, so that no other one takes its place.
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
from ...bridge.data_set import HELD_OUT, LIT, TEST, TRAIN, VALIDATION
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

RESTORE = "Restore a copy of it, or train again with --overwrite."


def write_views(folder: Path, scene: Scene) -> str:
    """Keep what drawing needs of ``scene``, and what its pictures hold; raises ``OutputError``.

    The SHA-256 of the file, for the run's checkpoints.
    """
    splits = {
        name: [_told(*each, scene.root) for each in zip(views, contents_of(views), strict=True)]
        for name, views in scene.splits.items()
    }
    content: dict[str, Any] = {
        "format": VIEWS_FORMAT,
        "version": VIEWS_VERSION,
        "name": scene.name,
        "layout": scene.layout,
        "anchor": scene.response_anchor,
        "lights": scene.lights,
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
    """The scene of the run in ``folder`` with no picture in reach, as if its data set still were at ``root``.

    Raises ``FileMissingError`` where there is no such file, ``FileDamagedError``, and ``DataMismatchError``
    for another version, and where it is not the file that the run's checkpoint was trained with.
    """
    return _scene_of(_kept(folder), folder / VIEWS_FILE, root)


def _kept(folder: Path) -> dict[str, Any]:
    """What the file says, which belongs to the checkpoint beside it, if there is one.

    Raises as ``read_views``.
    """
    path = folder / VIEWS_FILE
    metadata = read_metadata(folder / CHECKPOINT_FILE)
    if metadata and metadata[VIEWS] != hashlib.sha256(read_bytes(path, RESTORE)).hexdigest():
        raise DataMismatchError(
            f"{path} is not the one that {folder / CHECKPOINT_FILE} was trained with: what was trained on "
            "could pass for held out",
            RESTORE,
        )
    content = read_json_object(path, RESTORE)
    if content.get("format") != VIEWS_FORMAT:
        raise FileDamagedError(f"{path} is none of ours", RESTORE)
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
        for name, views in content["splits"].items():
            splits[name] = [_view(told, root, len(lights), cache) for told in views]
        anchor = content["anchor"]
        if anchor is not None:
            exposure, code = anchor
            anchor = (_number(exposure), _number(code))
            _require(anchor[0] > 0.0)
        _require(bool(splits["train"]))
        _kept_scale(content)
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
            messages=("the data set is not there: the run knows its cameras",),
            validation=splits.get("val", []),
            known_photographs=content["photographs"],
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
    """``scene``, which was read for the run in ``folder``, divided into training and test views as the run's.

    A split may have been found, not given, and comes out otherwise where photographs were added or the rule
    is another version's: what was trained on would be tested. So the run's own split stands, its views known
    by name, and it is told to ``report``. Where training views are the same, test views are those that the
    data set has now. Raises ``DataMismatchError`` where a view that was trained on is not there as it was,
    and where the known point of the response is another. Radiance is compared at the scale that it was
    trained at, whatever pictures were added since.
    ``pictures``: whether what those hold is compared, too. Others in the place of those trained on raise
    ``DataMismatchError``; where they are held out, that is reported.
    """
    content = _kept(folder)
    kept = _scene_of(content, folder / VIEWS_FILE, scene.root)
    _require_same_anchor(kept.response_anchor, scene.response_anchor, folder, scene.root)
    scene = _at_scale(scene, _kept_scale(content), report)
    if not (_are_same(kept.train, scene.train) and _are_same(kept.lit, scene.lit)):
        scene = _divided(scene, kept, folder, report)
    return _with_known_pictures(scene, kept, content, folder, report) if pictures else scene


def _divided(scene: Scene, kept: Scene, folder: Path, report: Callable[[str], object]) -> Scene:
    """``scene`` in the splits of ``kept``; raises ``DataMismatchError``."""
    there: dict[str, list[View]] = {}
    for view in itertools.chain.from_iterable(scene.splits.values()):
        there.setdefault(view.name, []).append(view)
    for before in (*kept.train, *kept.lit):
        _require_there(before, there.get(before.name, []), folder, scene.root)
    known = {view.name for view in (*kept.train, *kept.lit)}
    splits = {name: _found(views, there) for name, views in kept.splits.items()}
    for name in HELD_OUT:
        if not kept.splits[name]:  # there were none yet, or they were kept from a plan that tunes
            splits[name] = [view for view in scene.splits[name] if view.name not in known]
    known.update(view.name for views in splits.values() for view in views)
    told = f"training and test views are those of the run: {scene.root} divides them otherwise now"
    if unknown := len(there.keys() - known):
        told += f", and has {unknown} more, which are left out"
    report(told)
    return _with_splits(scene, splits, told)


def _with_known_pictures(
    scene: Scene, kept: Scene, content: Mapping[str, Any], folder: Path, report: Callable[[str], object]
) -> Scene:
    """``scene``, whose views are in the order of ``kept``'s, and in its messages which pictures are others.

    Raises ``DataMismatchError`` where one of those was trained on.
    """
    for name in (TRAIN, LIT):
        if difference := first_difference(scene.splits[name], _contents(content, name)):
            raise _other_data(folder, scene.root, difference)
    for name in HELD_OUT:
        before = {
            view.name: each for view, each in zip(kept.splits[name], _contents(content, name), strict=True)
        }
        views = [view for view in scene.splits[name] if len(before.get(view.name, ())) == len(view.sources)]
        if difference := first_difference(views, [before[view.name] for view in views]):
            told = f"held-out pictures are not those that the run was begun with: {difference}"
            report(told)
            scene = replace(scene, messages=(*scene.messages, told))
    return scene


def has_its_pictures(folder: Path, scene: Scene) -> bool:
    """Whether the training pictures of ``scene``, divided as the run in ``folder``, are those of the run."""
    content = _kept(folder)
    return not any(first_difference(scene.splits[name], _contents(content, name)) for name in (TRAIN, LIT))


def _contents(content: Mapping[str, Any], split: str) -> list[list[Contents]]:
    return [view["contents"] for view in content["splits"].get(split, ())]


def _radiance_scale(scene: Scene) -> float | None:
    """The scale of the pictures of radiance, one for a whole data set; None where there are none."""
    views = itertools.chain.from_iterable(scene.splits.values())
    encodings = (encoding for view in views for encoding in view.encodings)
    return next((each.scale for each in encodings if isinstance(each, LogEncoding)), None)


def _kept_scale(content: Mapping[str, Any]) -> float | None:
    """``_radiance_scale`` in a run's file. Raises as ``_view``."""
    kept = content.get("radiance_scale")
    return None if kept is None else LogEncoding(_number(kept)).scale


def _at_scale(scene: Scene, scale: float | None, report: Callable[[str], object]) -> Scene:
    """``scene`` with its pictures of radiance at the run's ``scale``; None: as they are."""
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
    told = f"radiance is compared at the run's scale, {scale:g}: that of {scene.root} is {now:g} now"
    report(told)
    return _with_splits(scene, splits, told)


def _with_splits(scene: Scene, splits: Mapping[str, list[View]], told: str) -> Scene:
    """``scene`` of these views, and in its messages what is ``told`` of it."""
    return replace(
        scene,
        train=splits[TRAIN],
        test=splits[TEST],
        lit=splits[LIT],
        validation=splits[VALIDATION],
        messages=(*scene.messages, told),
    )


def _require_same_anchor(
    before: tuple[float, float] | None, now: tuple[float, float] | None, folder: Path, root: Path
) -> None:
    """Raises ``DataMismatchError`` where they are not the same: learned curves are shifted to pass it."""
    if before == now or (before is not None and now is not None and np.allclose(before, now)):
        return
    one, other = ("none" if each is None else f"{each[1]:g} at {each[0]:g}" for each in (before, now))
    raise _other_data(folder, root, f"the known point of the response was {one}, and is {other}")


def _are_same(before: Sequence[View], now: Sequence[View]) -> bool:
    return len(before) == len(now) and all(
        one.name == other.name and one.bracket == other.bracket and not _difference(one, other)
        for one, other in zip(before, now, strict=True)
    )


def _found(kept: Sequence[View], there: Mapping[str, list[View]]) -> list[View]:
    """Those of ``kept`` that are as they were, with their pictures, at the places that the run counts by."""
    found = []
    for before in kept:
        same = (now for now in there.get(before.name, ()) if not _difference(before, now))
        if (now := next(same, None)) is not None:
            found.append(replace(now, bracket=before.bracket))
    return found


def _require_there(before: View, now: Sequence[View], folder: Path, root: Path) -> None:
    """Raises ``DataMismatchError`` where none of the views ``now`` is the one that was trained on."""
    different = [_difference(before, view) for view in now]
    if "" not in different:
        found = different[0] if different else "it has nothing"
        raise _other_data(folder, root, f"of view {before.name} {found}")


def _other_data(folder: Path, root: Path, difference: str) -> DataMismatchError:
    return DataMismatchError(
        f"{root} is not the data set that {folder} was trained on: {difference}",
        "Name the one that it was trained on, as it was then, or train again. Without pictures the run "
        "can be looked at all the same.",
    )


def _difference(before: View, now: View) -> str:
    """What is not the same, in words; empty where a training would see no difference but in pictures."""
    one, other = before.camera, now.camera
    if not np.allclose(one.camera_to_world, other.camera_to_world, atol=1e-5):
        return "the camera stands elsewhere"
    if (one.width, one.height) != (other.width, other.height):
        return f"the pictures were {one.width}×{one.height}, and are {other.width}×{other.height}"
    lenses = [(camera.fx, camera.fy, camera.cx, camera.cy) for camera in (one, other)]
    if not np.allclose(*lenses, rtol=1e-5, atol=1e-3):
        return "the camera's focal length or principal point is another"
    if len(before.exposures) != len(now.exposures) or not np.allclose(before.exposures, now.exposures):
        return "the exposures are others"
    # Another light of which these views have the standard level makes none of them another.
    if not (before.is_standard and now.is_standard) and before.lighting_levels != now.lighting_levels:
        return "the light is another"
    return ""


def _told(view: View, contents: list[Contents], root: Path) -> dict[str, Any]:
    camera = view.camera
    return {
        "name": view.name,
        "index": view.index,
        "exposures": view.exposures,
        "bracket": view.bracket,
        "levels": view.lighting_levels,
        "pictures": [_name(path, root) for path in view.image_paths],
        "contents": contents,
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
    contents = told["contents"]
    _require(isinstance(contents, list) and len(contents) == len(exposures))
    _require(all(isinstance(each, dict) for each in contents))
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
