# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's evaluation, videos, web page and a model's bake, as the panel asks for them and says them. Pure but
for reading the figures.

All are the backend's work (``physhdr evaluate``, ``render``, ``export``), in a process of
its own.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...bridge.errors import PhysHDRError
from ...bridge.limits import is_number
from ...bridge.regular import read_json_object
from ...bridge.run_folder import CHECKPOINT_FILE, EVALUATION_FILE, same_folder
from .state import CHECK, INSTALL, State

#: The tasks' names.
EVALUATE, VIDEO, WEB, BAKE = "evaluate", "video", "web", "bake"
#: PSNR in dB at which a picture beside its photograph is …
QUALITIES = (
    (38.0, "excellent"),
    (32.0, "very close"),
    (27.0, "close, softer detail"),
    (22.0, "visibly soft"),
)
WORST = "poor"
#: What the panel calls the table's rows, short enough for its default width.
ROWS = (
    ("LDR-OE", "Learned Exposures"),
    ("LDR-NE", "New Exposures"),
    ("HDR", "HDR Radiance"),
)


@dataclass(frozen=True)
class Figure:
    """A row of the table: what was compared, how well in words, the numbers."""

    what: str
    words: str
    numbers: str


@dataclass(frozen=True)
class Evaluation:
    """What was measured of a run: ``views`` pictures that training never saw. ``is_old``: it was trained on
    since."""

    figures: tuple[Figure, ...]
    views: int
    iteration: int
    is_old: bool


@dataclass(frozen=True)
class VideoOptions:
    """What a video shows. ``shots``: a file of frames, of Blender's camera; else a ``path`` of the trainer's
    and a ``sweep``, for ``seconds`` at ``fps``. ``exposure``: seconds, 0 the data set's middle one."""

    shots: str = ""
    path: str = ""
    sweep: str = "none"
    light: str = ""
    seconds: float = 6.0
    fps: int = 30
    width: int = 0
    exposure: float = 0.0


def evaluate_command(run: str, data: str = "", lpips_weights: str = "") -> list[str]:
    """The arguments of the backend's command that evaluates; ``data``: the data set where it is now."""
    arguments = ["--lpips-weights", lpips_weights] if lpips_weights else []
    return ["evaluate", run, *_data(data), *arguments, "--json"]


def video_command(run: str, out: str, options: VideoOptions, data: str = "") -> list[str]:
    """The arguments of the backend's command that makes a video ``out``, or numbered pictures in a folder."""
    arguments = ["render", run, "--out", out, *_data(data)]
    if options.shots:
        arguments += ["--camera", options.shots]
    else:
        arguments += ["--path", options.path] if options.path else []
        arguments += ["--sweep", options.sweep] if options.sweep != "none" else []
        arguments += ["--light", options.light] if options.light else []
        arguments += ["--seconds", f"{options.seconds:g}", "--fps", str(options.fps)]
    arguments += ["--width", str(options.width)] if options.width else []
    arguments += ["--exposure", f"{options.exposure:.9g}"] if options.exposure else []
    return [*arguments, "--json"]


def web_command(run: str, out: str, data: str = "", single_file: bool = True) -> list[str]:
    """The arguments of the backend's command that writes a web page: ``out``, one file or a folder."""
    return ["export", run, out, *([] if single_file else ["--web"]), *_data(data), "--json"]


def bake_command(
    model: str, out: str, cameras: str, exposure_ev: float, levels: Mapping[str, float], tone: str
) -> list[str]:
    """The arguments of the backend's command that fits a model's display colours: ``out``, a PLY.

    ``cameras``: the run or data set from whose cameras; ``levels`` of the lights by name.
    """
    # After a space no name is taken for an option, whatever it begins with.
    settings = [f"{' ' * name.startswith('-')}{name}={level:.9g}" for name, level in levels.items()]
    look = [f"--exposure-ev={exposure_ev:.9g}", "--tone", tone.lower(), "--lighting-levels", *settings]
    return ["export", model, out, "--cameras", cameras, "--json", *look]


def why_not_on_run(state: State, task: str, run: str = "given") -> str:
    """Why a run's folder ``run`` (empty: none) cannot be evaluated, filmed or exported now; empty where it
    can."""
    busy = next((each for each in state.tasks if each.name in (INSTALL, CHECK)), None)
    if busy:
        return f"Wait for the {busy.name} to end"
    if not state.backend.ready:
        return "Install the backend, or use an existing Python, first"
    if state.task(task):
        return "It is under way"
    if not run:
        return "Train a model, or choose the folder of a run, first"
    if state.active and same_folder(state.job.run, run):
        return "This run is being trained: stop it first, or wait until it has finished"
    return ""


def evaluation_of(run: str) -> Evaluation | None:
    """What was measured of the run in a folder; None where nothing was, or nobody can read it.

    Looked at at every redraw: the file is read once for each of its versions.
    """
    path = Path(run) / EVALUATION_FILE
    try:
        changed = path.stat().st_mtime_ns
        trained = (Path(run) / CHECKPOINT_FILE).stat().st_mtime_ns
    except (OSError, ValueError):
        return None
    found = _read(path, changed)
    if found is None:
        return None
    figures, views, iteration = found
    return Evaluation(figures, views, iteration, trained > changed)


@lru_cache(maxsize=8)
def _read(path: Path, changed: int) -> tuple[tuple[Figure, ...], int, int] | None:
    try:
        content = read_json_object(path)
    except PhysHDRError:
        return None
    conditions = content.get("conditions")
    iteration = conditions.get("iteration") if isinstance(conditions, dict) else 0
    views = content.get("views")
    count = len(views) if isinstance(views, list) else 0
    return figures(content), count, int(iteration) if is_number(iteration) else 0


def figures(content: dict[str, Any]) -> tuple[Figure, ...]:
    """The main rows of an evaluation's tables; what is missing or of another kind is passed over."""
    rows = []
    means = content.get("means")
    for name, what in ROWS:
        row = means.get(name) if isinstance(means, dict) else None
        if isinstance(row, dict) and is_number(row.get("psnr")):
            rows.append(Figure(what, in_words(row["psnr"]), _numbers(row)))
    relit = content.get("relit_means")
    everything = relit.get("all") if isinstance(relit, dict) else None
    if isinstance(everything, dict) and is_number(everything.get("ours")):
        psnr = everything["ours"]
        rows.append(Figure("Other Light", in_words(psnr), f"PSNR {psnr:.1f} dB"))
    ratio = content.get("scale_ratio")
    if is_number(ratio) and ratio > 0.0:
        stops = math.log2(ratio)
        words = "as the true one" if abs(stops) < 0.05 else f"{stops:+.2f} stops from the true one"
        rows.append(Figure("Brightness", words, f"× {ratio:.3f}"))
    return tuple(rows)


def in_words(psnr: float) -> str:
    """How a picture of that PSNR looks beside the photograph."""
    return next((words for least, words in QUALITIES if psnr >= least), WORST)


def _numbers(row: dict[str, Any]) -> str:
    figures = [f"PSNR {row['psnr']:.1f} dB"]
    figures += [f"SSIM {row['ssim']:.3f}"] if is_number(row.get("ssim")) else []
    figures += [f"LPIPS {row['lpips']:.3f}"] if is_number(row.get("lpips")) else []
    return ", ".join(figures)


def _data(data: str) -> list[str]:
    return ["--data", data] if data else []
