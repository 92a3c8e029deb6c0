# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets in other programs' layouts: nerfstudio's ``transforms.json``, or a COLMAP folder (gsplat, 3DGS).

Whatever a scene was read from, it becomes pinhole cameras, pictures with plain names, first points and
the split. A picture's file is copied as it is where that is the camera's own picture (an opaque RGB
PNG or JPEG, at its size); else what training sees is written as PNG: without distortion, upright, reduced.
Radiance and linear pictures, which those programs cannot read, go through the sRGB curve, clipped at 1.

Our own readers read both layouts back, with the split, the exposures and a known point of the response.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from ...bridge import data_set
from ...bridge.errors import BadValueError, DataMismatchError
from ...bridge.layouts.picture_files import MASKS
from ...bridge.regular import resolved
from .camera import Camera
from .colmap_model import write_pinholes
from .encoding import SRGB
from .pictures import has_alpha, holds_radiance, is_rgb, kind_of, read_codes, write_png
from .points import write_points
from .scene import Scene, View
from .source import PictureSource

Layout = Literal["nerfstudio", "colmap"]
IMAGES = "images"
#: Where nerfstudio's own programs have the points.
NERFSTUDIO_POINTS = "sparse_pc.ply"
#: Brackets are named by one digit: ``train_003_9.png``.
MOST_EXPOSURES = 10
#: In these kinds other programs read the pictures that are not written anew, with these suffixes.
PLAIN = {"PNG": ".png", "JPEG": ".jpg"}


@dataclass(frozen=True, kw_only=True)
class How:
    """What is written. ``exposure``: a place in the brackets; None: the middle one. ``brackets``: all places.

    ``link``: files that are copied unchanged become hard links where the disk allows it.
    """

    layout: Layout
    exposure: int | None = None
    brackets: bool = False
    link: bool = False


@dataclass
class LaidOut:
    """What was written: views by split, pictures by how they were made, and messages."""

    views: dict[str, int]
    copied: int = 0
    linked: int = 0
    made: int = 0
    messages: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Picture:
    """A picture to be written: its view and exposure, and its name in ``images/`` without the suffix."""

    view: View
    k: int
    split: str
    stem: str
    is_main: bool


def lay_out(
    scene: Scene,
    folder: Path,
    how: How,
    show: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> LaidOut:
    """Write ``scene`` into ``folder``, which is empty; ``show`` gets each picture.

    Raises ``BadValueError`` where no training view has the exposure, or brackets are too long for names,
    ``OutputError``, and what reading pictures raises.
    """
    chosen, messages = _chosen(scene, how)
    said = LaidOut({split: len({p.view.name for p in chosen if p.split == split}) for split in _splits(how)})
    said.messages = [*messages, *_ignored(scene, how)]
    if any(view.encodings[0].is_known for view in scene.train):
        said.messages.append(
            "radiance and linear pictures were developed by the sRGB curve and clip at 1: choose exposures "
            "by that"
        )
    if all(picture.split == data_set.TRAIN for picture in chosen):
        said.messages.append(
            "no view is held out: nerfstudio then splits by itself; --eval-mode all trains on all of them, "
            "which fewer than ten pictures need"
        )
    masked = any(_may_mask(p.view.sources[p.k]) and p.view.mask(p.k) is not None for p in chosen)
    names: dict[_Picture, str] = {}
    for done, picture in enumerate(chosen):
        show(done, len(chosen), picture.view.name)
        names[picture] = _write_picture(picture, folder / IMAGES, how, said)
        if masked:
            _write_mask(picture, folder / MASKS / f"{picture.stem}.png")
    show(len(chosen), len(chosen), "")
    if scene.points is None:
        said.messages.append(
            "there are no points, from which gsplat and splatfacto start: "
            "physhdr prepare --triangulate makes some"
        )
    if how.layout == "nerfstudio":
        _write_nerfstudio(scene, folder, names, masked)
    else:
        _write_colmap(scene, folder, names, how)
    _write_json(folder / data_set.INFO_FILE, _info(scene, how))
    return said


# ---- which pictures ------------------------------------------------------------------------------------


def _splits(how: How) -> tuple[str, ...]:
    """The splits that a layout can have."""
    more = (data_set.VALIDATION,) if how.layout == "nerfstudio" else ()
    return (data_set.TRAIN, data_set.TEST, *more)


def _ignored(scene: Scene, how: How) -> Iterable[str]:
    """Messages on what the layout cannot hold."""
    if lit := len(scene.lit) + len(scene.lit_test):
        yield f"{lit} views under other light were ignored: no such program supports them"
    if scene.validation and data_set.VALIDATION not in _splits(how):
        yield f"{len(scene.validation)} validation views were ignored: a COLMAP folder has no such split"


def _chosen(scene: Scene, how: How) -> tuple[list[_Picture], list[str]]:
    """The pictures of all splits, sorted by name, and messages on the choice."""
    places = sorted({place for view in scene.train for place in view.bracket})
    if not places:
        raise DataMismatchError(f"{scene.root} has no training views", "Give another data set.")
    main = places[len(places) // 2] if how.exposure is None else how.exposure
    if main not in places:
        raise BadValueError(
            f"no training view has exposure {main}", f"Choose from {', '.join(map(str, places))}."
        )
    if how.brackets and places[-1] >= MOST_EXPOSURES:
        raise BadValueError(
            f"brackets have up to {places[-1] + 1} exposures, of which names tell {MOST_EXPOSURES}",
            "Leave out --brackets and choose one by --exposure.",
        )
    chosen, without = [], 0
    for split in _splits(how):
        for view in scene.splits[split]:
            at = view.place_of(main)
            if at is None and not how.brackets:
                without += 1
                continue
            base = f"{split}_{view.index:03d}"
            which = range(len(view.exposures)) if how.brackets else [at or 0]
            # In a bracket that lacks the exposure its middle one stands for it.
            middle = len(view.exposures) // 2 if at is None else at
            chosen += [
                _Picture(view, k, split, _stem(base, view.bracket[k], how), k == middle) for k in which
            ]
    messages = [f"{without} views have no exposure {main}: ignored"] if without else []
    return sorted(chosen, key=lambda picture: picture.stem), messages


def _stem(base: str, place: int, how: How) -> str:
    """``train_003``, ``train_003_2`` in brackets; ``train_003_0`` alone in a COLMAP folder.

    There a lone digit at the end is GaussHDR's, which is how our reader would read such a folder.
    """
    if how.brackets:
        return f"{base}_{place}"
    return f"{base}_0" if how.layout == "colmap" else base


# ---- pictures ------------------------------------------------------------------------------------------


def _write_picture(picture: _Picture, folder: Path, how: How, said: LaidOut) -> str:
    """Copy, link or make the file; its name."""
    view, k = picture.view, picture.k
    suffix = _plain_suffix(view, k)
    if suffix is None:
        path = folder / f"{picture.stem}.png"
        write_png(path, _developed(view, k))
        said.made += 1
        return path.name
    source, path = view.sources[k].path, folder / f"{picture.stem}{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    if how.link and _linked(source, path):
        said.linked += 1
    else:
        shutil.copyfile(source, path)
        said.copied += 1
    return path.name


def _linked(source: Path, path: Path) -> bool:
    """Whether the disk could link the file; not to another disk, and some support no links."""
    try:
        os.link(resolved(source), path)
    except OSError:
        return False
    return True


def _plain_suffix(view: View, k: int) -> str | None:
    """The suffix for a picture's file as it is; None where another has to be made of it."""
    source, reduction = view.sources[k], view.cache.reduction
    is_whole = reduction.factor == 1.0 and source.lens is None and source.orientation == 1
    if not is_whole or source.encoding.is_known or source.profile is not None:
        return None
    suffix = PLAIN.get(kind_of(source.path))
    # Those programs read one number a pixel from grey and palettes, where they want three.
    is_plain = suffix is not None and is_rgb(source.path) and _is_opaque(source.path)
    return suffix if is_plain else None


def _is_opaque(path: Path) -> bool:
    """Whether programs that apply alpha and those that ignore it show the same."""
    if not has_alpha(path):
        return True
    _, alpha = read_codes(path, with_alpha=True)
    return alpha is None or bool((alpha == 1.0).all())


def _developed(view: View, k: int) -> np.ndarray:
    """``[H, W, 3]`` uint8 or uint16 as training sees it, known encodings by the sRGB curve."""
    codes, encoding = view.image(k), view.encodings[k]
    if not encoding.is_known or encoding == SRGB:
        return codes
    return SRGB.codes(encoding.exposed(codes))


def _may_mask(source: PictureSource) -> bool:
    """Whether a picture can have pixels that are not compared, found without decoding it."""
    own = source.alpha and (holds_radiance(source.path) or has_alpha(source.path))
    return own or source.mask_path is not None


def _write_mask(picture: _Picture, path: Path) -> None:
    """Black where the picture is not compared; white all over where it has no mask."""
    mask = picture.view.mask(picture.k)
    if mask is None:
        mask = np.ones((picture.view.camera.height, picture.view.camera.width), bool)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(255 * mask.astype(np.uint8)).save(path)


# ---- nerfstudio ----------------------------------------------------------------------------------------


def _write_nerfstudio(scene: Scene, folder: Path, names: Mapping[_Picture, str], masked: bool) -> None:
    """``transforms.json``: intrinsics once where all have the same, and the split by names.

    Poses are camera to world with OpenGL axes, as here, and the world is +Z up, as there: nothing is applied.
    """
    lenses = [_intrinsics(picture.view.camera) for picture in names]
    alike = all(lens == lenses[0] for lens in lenses)
    frames = []
    for (picture, name), lens in zip(names.items(), lenses, strict=True):
        frames.append(
            {
                "file_path": f"{IMAGES}/{name}",
                **({"mask_path": f"{MASKS}/{picture.stem}.png"} if masked else {}),
                "exposure_time": picture.view.exposures[picture.k],
                **({} if alike else lens),
                "transform_matrix": picture.view.camera.camera_to_world.tolist(),
            }
        )
    lists = {
        split: [f"{IMAGES}/{name}" for picture, name in names.items() if picture.split == split]
        for split in (data_set.TRAIN, data_set.VALIDATION, data_set.TEST)
    }
    # nerfstudio looks at its validation views while it trains: without any it takes those of the test.
    lists[data_set.VALIDATION] = lists[data_set.VALIDATION] or lists[data_set.TEST]
    content: dict[str, Any] = {"camera_model": "PINHOLE", **(lenses[0] if alike else {})}
    if scene.points is not None:
        write_points(folder / NERFSTUDIO_POINTS, scene.points)
        content["ply_file_path"] = NERFSTUDIO_POINTS
    if lists[data_set.VALIDATION]:  # nerfstudio takes an empty list literally, and then fails in training
        content |= {f"{split}_filenames": listed for split, listed in lists.items()}
    _write_json(folder / "transforms.json", content | {"frames": frames})


def _intrinsics(camera: Camera) -> dict[str, float]:
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
    }


# ---- COLMAP --------------------------------------------------------------------------------------------


def _write_colmap(scene: Scene, folder: Path, names: Mapping[_Picture, str], how: How) -> None:
    """``sparse/0`` with one picture a pose, ``exposure.json``, and nerfstudio's lists of the split."""
    cameras = {name: picture.view.camera for picture, name in names.items() if picture.is_main}
    write_pinholes(folder / "sparse" / "0", cameras, scene.points)
    exposures = {name: picture.view.exposures[picture.k] for picture, name in names.items()}
    _write_json(folder / data_set.EXPOSURE_FILE, exposures)
    if all(picture.split == data_set.TRAIN for picture in names):
        return  # as in transforms.json: no lists rather than empty ones
    for split, of in (("train", data_set.TRAIN), ("val", data_set.TEST), ("test", data_set.TEST)):
        listed = [name for picture, name in names.items() if picture.is_main and picture.split == of]
        (folder / f"{split}_list.txt").write_text("".join(f"{name}\n" for name in listed), encoding="utf-8")


# ---- what both have ------------------------------------------------------------------------------------


def _info(scene: Scene, how: How) -> dict[str, Any]:
    """``dataset.json``, for what pictures and poses do not state: the scene's name, its anchor."""
    info: dict[str, Any] = {
        "format": data_set.FORMAT,
        "version": data_set.VERSION,
        "scene": scene.name,
        "laid_out": {"layout": how.layout, "from": scene.layout, "brackets": how.brackets},
    }
    # What it was rendered from, by which `physhdr benchmark` knows built-in scenes and rooms.
    info |= {
        key: told
        for key in ("generator", "source", "objects")
        if isinstance(told := scene.info.get(key), dict)
    }
    if scene.response_anchor is not None:
        info["response"] = {"anchor": list(scene.response_anchor)}
    return info


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
