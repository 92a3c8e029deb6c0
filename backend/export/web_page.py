# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as a web page that needs no server, no build and no network (docs/other-programs.md#a-web-page).

The page is what lies in ``web/``: a template, a style, and classic scripts that are joined into one.
Browsers refuse modules and ``fetch`` from ``file://``, so the data come as base64 in classic scripts, too:
files beside the page, or in it.
"""

import base64
import contextlib
import hashlib
import io
import json
import os
import re
import stat
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...bridge import confidence, splatting
from ...bridge import spherical_harmonics as sh
from ...bridge.affine import quaternion_of
from ...bridge.atomic import atomic_path
from ...bridge.errors import OutputError
from ...bridge.limits import EV_MAX
from ...bridge.model_file import Model
from ...bridge.regular import without_waiting
from ...bridge.run_folder import WEB_INDEX
from ..project import version
from ..scene.camera import Camera
from .quantised import Quantised, quantised

ASSETS = Path(__file__).parent / "web"
#: In the order in which they need each other.
SCRIPTS = ("data.js", "sorter.js", "splats.js", "tone.js", "camera.js", "screen.js", "page.js")
#: Files beside index.html; ``hash_of`` their content stands in their names, so that none of another page's is
#: ever taken for this one's: neither by a browser that kept it, nor after an export that did not end.
VIEWER_FILE, PART_FILE = "viewer-{hash}.js", "model-{index:03d}-{hash}.js"
HASH_DIGITS = 12
#: Those names, and what such files were called before 2026-11-23, without a hash.
OUR_NAME = re.compile(rf"(viewer|model-\d{{3,}})(-[0-9a-f]{{{HASH_DIGITS}}})?\.js")
#: What a folder that holds such a page has in its index.html: another one is not replaced.
MARK = "PhysHDR web page"
#: Bytes of the file that hold it.
MARK_WITHIN = 4096
#: What the page does where a script beside it is not there, and so cannot tell it; data.js says it of parts.
MISSING = (
    "document.getElementById('loading').className = document.documentElement.dataset.state = 'failed'; "
    "document.getElementById('loading-text').textContent = '{} is missing. Load this page again; "
    "if that does not help, copy the folder of index.html again, whole.'"
)
#: Bytes of a part before base64, a multiple of 3. Each is one step of the page's progress bar.
PART_BYTES = 3_000_000
#: Cameras in the page's list; of more, so many evenly chosen ones.
MOST_CAMERAS = 400
#: Even steps of ln exposure at which a page has the learned response.
CURVE_POINTS = 1024
#: Stops that the exposure's slider goes beyond the data set's exposures, and from 1 s where there are none.
STOPS_BEYOND, STOPS = 4.0, 8.0
#: What is up in Blender's world.
UPRIGHT = np.array([0.0, 0.0, 1.0])
#: A mean up direction nearer to +Z than this cosine is +Z.
IS_UPRIGHT = np.cos(np.radians(15.0))
POSTER_QUALITY = 80


@dataclass(frozen=True)
class WebView:
    """A camera of the page's list, by its name there."""

    name: str
    camera: Camera


@dataclass(frozen=True, eq=False)
class WebPage:
    """What a page shows beside the model.

    ``notes``: sentences about it. ``poster``: ``[H, W, 3]`` uint8, seen while the page loads. ``response``:
    title of the learned response, and a note on it or "". ``exposure``: seconds at first, None: the middle
    one of the model's. ``is_upright``: whether +Z is known to be up; else the cameras, if any, tell it.
    """

    title: str
    views: Sequence[WebView] = ()
    notes: Sequence[str] = ()
    poster: np.ndarray | None = None
    response: tuple[str, str] = ("Learned response", "")
    exposure: float | None = None
    is_upright: bool = False


@dataclass(frozen=True)
class Written:
    """The page to open, and what it came to: ``data_bytes`` before base64, ``page_bytes`` in all files."""

    page: Path
    gaussians: int
    omitted: int
    data_bytes: int
    page_bytes: int


def write_web_page(
    out: Path,
    model: Model,
    page: WebPage,
    single_file: bool = False,
    report: Callable[[float], None] | None = None,
) -> Written:
    """Write the page into the folder ``out``, or with ``single_file`` as the HTML file ``out``.

    ``report`` gets the share that is done, 0 to 1. Raises ``BadValueError`` (nothing to be seen) and
    ``OutputError``, also where something else has the name of a file that would be written.
    """
    target = out if single_file else out / WEB_INDEX
    refuse_what_is_not_ours(target)
    report = report or (lambda done: None)
    packed = quantised(model)
    report(0.2)
    raw = packed.raw()
    data = zlib.compress(raw, 9)
    report(0.8)
    parts = [data[at : at + PART_BYTES] for at in range(0, len(data), PART_BYTES)]
    facts = page_facts(model, page, packed)
    facts["bytes"] = len(raw)
    scripts = [_script_of_part(index, part) for index, part in enumerate(parts)]
    names = [
        "" if single_file else PART_FILE.format(index=index, hash=hash_of(text))
        for index, text in enumerate(scripts)
    ]
    facts["parts"] = [{"file": name, "size": len(part)} for name, part in zip(names, parts, strict=True)]
    script = f"window.MODEL_FACTS = {_in_script(facts)};"
    if single_file:
        html = _html(page.title, [script, viewer(), *scripts])
        sizes = [_write(target, html, refuse_what_is_not_ours)]
    else:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot make {out}: {error.strerror or error}", "Choose another place."
            ) from error
        viewer_file = VIEWER_FILE.format(hash=hash_of(viewer()))
        beside = dict(zip([*names, viewer_file], [*scripts, viewer()], strict=True))
        sizes = _write_folder(target, _html(page.title, [script], [viewer_file]), beside)
    report(1.0)
    return Written(target, model.count - packed.omitted, packed.omitted, len(data), sum(sizes))


def viewer() -> str:
    """All scripts as one classic one, in a scope of its own."""
    joined = "\n".join((ASSETS / name).read_text(encoding="utf-8") for name in SCRIPTS)
    return f'(() => {{\n"use strict";\n{joined}}})();\n'


def page_facts(model: Model, page: WebPage, packed: Quantised) -> dict[str, Any]:
    """What the page's script needs, as plain JSON, except where the data are."""
    views = list(page.views) or [WebView("overview", overview(model))]
    is_upright = page.is_upright or not page.views
    if len(views) > MOST_CAMERAS:
        views = [views[round(at)] for at in np.linspace(0, len(views) - 1, MOST_CAMERAS)]
    up = UPRIGHT if is_upright else _up_of([view.camera for view in views])
    count = f"{model.count - packed.omitted:,} Gaussians."
    return {
        **packed.header,
        "title": page.title,
        "about": [count, *page.notes, f"Made with PhysHDR {version()}."],
        "contract": contract(),
        "cameras": [_row(view) for view in views],
        "up": up.tolist(),
        "size": _size_of(model, [view.camera for view in views]),
        "exposure": _exposure(model, page.exposure),
        "curve": _curve(model, *page.response),
        "poster": "" if page.poster is None else _data_uri(page.poster),
        "confidence": _confidence(model),
    }


def contract() -> dict[str, float]:
    """The numbers on which all that draws agrees, by the names that the page's shaders have for them."""
    names = ("LOW_PASS", "ALPHA_MAX", "ALPHA_MIN", "JACOBIAN_MARGIN", "NEAR_PLANE")
    harmonics = {
        f"C{degree}_{k}": value for degree, row in ((2, sh.C2), (3, sh.C3)) for k, value in enumerate(row)
    }
    return {name: getattr(splatting, name) for name in names} | {"C0": sh.C0, "C1": sh.C1} | harmonics


def overview(model: Model) -> Camera:
    """A camera that sees the middle nine tenths of the Gaussians from the front and a little above."""
    low, high = np.percentile(model.position.astype(np.float64), [5.0, 95.0], axis=0)
    middle, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
    backward = np.array([0.0, -np.cos(0.35), np.sin(0.35)])
    right = np.array([1.0, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=1)
    pose[:3, 3] = middle + 2.2 * radius * backward
    return Camera.from_field_of_view(pose, 1600, 900, np.radians(60.0))


def refuse_what_is_not_ours(target: Path) -> None:
    """Raises ``OutputError`` where the page's file is there and is no such page, or cannot be looked at.

    Links, folders, pipes and devices are never such a page, and none of them is opened.
    """
    try:
        is_ours = _is_ours(target)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise OutputError(
            f"cannot look at {target}: {error.strerror or error}", "Choose another place."
        ) from error
    if not is_ours:
        raise OutputError(
            f"{target} exists, and PhysHDR did not write it", "Choose another place, or move it away."
        )


def _is_ours(target: Path) -> bool:
    """Whether the file is such a page; raises ``OSError`` where it is not there or cannot be looked at."""
    if not stat.S_ISREG(os.lstat(target).st_mode):
        return False
    with open(target, "rb", opener=without_waiting) as file:
        return MARK.encode() in file.read(MARK_WITHIN)


def remove_web_page(folder: Path) -> None:
    """Remove the page in ``folder``, the files that it lists, and the folder if nothing else lies in it.

    What is no such page stays. Raises ``OutputError`` where one is there and cannot be removed.
    """
    target = folder / WEB_INDEX
    try:
        if not _is_ours(target):
            return
        beside = files_of(target.read_text("utf-8", errors="replace"))
        target.unlink()
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise OutputError(
            f"cannot remove {target}: {error.strerror or error}",
            "Close the program that has it open, or choose another place.",
        ) from error
    _remove(folder / name for name in beside)
    with contextlib.suppress(OSError):  # somebody's files are in it
        folder.rmdir()


def hash_of(text: str) -> str:
    """What stands for a file's content in its name."""
    return hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]


def files_of(html: str) -> set[str]:
    """The names of the files that a page of ours has beside it."""
    found = re.search(r"^window\.MODEL_FACTS = (.*);$", html, re.MULTILINE)
    names = set(re.findall(r'<script src="([^"]*)"', html))
    if found is not None:
        # Edited by hand it may be anything: then its parts are nobody's, and stay.
        with contextlib.suppress(ValueError, TypeError, KeyError):
            names |= {part["file"] for part in json.loads(found.group(1))["parts"]}
    return {name for name in names if OUR_NAME.fullmatch(name)}


def _write_folder(target: Path, html: str, beside: dict[str, str]) -> list[int]:
    """Write a page and what belongs beside it; each file's bytes.

    The page comes last: until then an older one has all its own files. Then those are removed, by its own
    list: what else lies in the folder is somebody's. Of a page that was not written nothing stays.
    """
    folder, new, sizes = target.parent, [], []
    older = files_of(target.read_text("utf-8", errors="replace")) if target.is_file() else set()
    try:
        for name, text in beside.items():
            if not os.path.lexists(folder / name):
                new.append(folder / name)
            sizes.append(_write(folder / name, text))
        sizes.append(_write(target, html, refuse_what_is_not_ours))
    except BaseException:
        _remove(new)
        raise
    _remove(folder / name for name in older - beside.keys())
    return sizes


def _remove(paths: Iterable[Path]) -> None:
    """Remove files as far as that can be done: what stays costs space, and nothing else."""
    for path in paths:
        with contextlib.suppress(OSError):
            if stat.S_ISREG(os.lstat(path).st_mode):
                path.unlink()


def _write(path: Path, text: str, check: Callable[[Path], None] | None = None) -> int:
    content = text.encode()
    with atomic_path(path, remedy="Choose another place, or make room.", check=check) as temporary:
        temporary.write_bytes(content)
    return len(content)


def _html(title: str, inline: Sequence[str], files: Sequence[str] = ()) -> str:
    """The template with everything in its place; a title that looks like one of its marks stays a title."""
    scripts = [f"<script>\n{text}\n</script>" for text in inline]
    scripts += [f'<script src="{name}" onerror="{MISSING.format(name)}"></script>' for name in files]
    escaped = title
    for mark, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        escaped = escaped.replace(mark, entity)
    before, after = (ASSETS / "page.html").read_text(encoding="utf-8").split("@SCRIPTS@")
    style = (ASSETS / "page.css").read_text(encoding="utf-8")
    before = before.replace("@GENERATOR@", f"{MARK} {version()}").replace("@CSS@", style)
    return before.replace("@TITLE@", escaped) + "\n".join(scripts) + after


def _in_script(content: Any) -> str:
    """JSON that ends no script, whatever its texts are."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _script_of_part(index: int, part: bytes) -> str:
    return f'MODEL_PART({index},"{base64.b64encode(part).decode()}");'


def _data_uri(picture: np.ndarray) -> str:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=POSTER_QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def _row(view: WebView) -> dict[str, Any]:
    camera = view.camera
    w, h = camera.width, camera.height
    return {
        "name": view.name,
        "eye": [float(f"{value:.8g}") for value in camera.position],
        "turn": [round(float(value), 8) for value in quaternion_of(camera.camera_to_world[:3, :3])],
        "lens": [camera.fx / w, camera.fy / h, camera.cx / w, camera.cy / h, w / h],
    }


def _up_of(cameras: Sequence[Camera]) -> np.ndarray:
    """What is up: +Z, or where the cameras agree on something else, their mean up."""
    mean = np.sum([camera.camera_to_world[:3, 1] for camera in cameras], axis=0)
    length = np.linalg.norm(mean)
    if length < 0.3 * len(cameras) or mean @ UPRIGHT > IS_UPRIGHT * length:
        return UPRIGHT
    return mean / length


def _size_of(model: Model, cameras: Sequence[Camera]) -> float:
    """How far one goes in a step: the cameras' median distance from their middle, or from the Gaussians'."""
    positions = np.array([camera.position for camera in cameras])
    spread = float(np.median(np.linalg.norm(positions - positions.mean(axis=0), axis=1)))
    if spread > 1e-3:
        return spread
    middle = np.median(model.position, axis=0)
    return max(float(np.linalg.norm(positions[0] - middle)), 1e-3)


def _exposure(model: Model, first: float | None) -> dict[str, Any]:
    """The slider of exposure, in EV (log2 of seconds)."""
    known = sorted(model.exposures)
    start = first or 2.0**model.developed_ev
    beyond = STOPS_BEYOND if known else STOPS
    evs = np.log2([*known, start])
    low, high = max(evs.min() - beyond, -EV_MAX), min(evs.max() + beyond, EV_MAX)
    # The slider has steps of 0.01 from its lowest value.
    low, high = float(np.floor(low)), float(np.ceil(high))
    return {"start": round(float(np.log2(start)), 2), "range": [low, high]}


def _curve(model: Model, title: str, note: str) -> dict[str, Any] | None:
    """The learned response at even steps of ln exposure, constant outside; None where there is none."""
    x, y = model.tone_curve_log_exposure, model.tone_curve
    if x is None or y is None:
        return None
    even = np.linspace(x[0], x[-1], CURVE_POINTS)
    rows = np.stack([np.interp(even, x, y[:, channel]) for channel in range(3)], axis=1)
    return {
        "title": title,
        "note": note,
        "span": [float(x[0]), float(x[-1])],
        "rows": np.round(rows, 6).tolist(),
    }


def _confidence(model: Model) -> dict[str, Any] | None:
    """What the colours of the confidence are and mean, of a model that has one."""
    if model.confidence is None:
        return None
    return {"ramp": np.round(confidence.RAMP, 4).tolist(), "meaning": confidence.MEANING}
