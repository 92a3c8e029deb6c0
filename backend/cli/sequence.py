# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbered frames along a path of cameras: which there are already, and who draws the others.

Beside the frames stands ``NAME_####.exr.frames.json``: what each of them shows, as a digest of the model, the
camera and the light. A frame that is there is whole (it is written by a rename), and is kept where that file
says that it is the one; so an interrupted sequence goes on. It is drawn here, or by several processes, which
get their frames in a file and open the run themselves (``child.py``).
"""

import hashlib
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, DataMismatchError, OutputError, PhysHDRError
from ...bridge.regular import read_json_object
from ...bridge.run_folder import CHECKPOINT_FILE
from ...bridge.signals import caught, interrupt
from ..child import child_command
from ..device import DeviceName
from ..evaluate.pictures import finite
from ..evaluate.sheets import as_picture
from ..jobs.pools import LocalPool, Outcome
from ..jobs.process import THREAD_VARIABLES, StoppedError, end_with_parent, run_to_end
from ..rasterize import Implementation
from ..runs.run import Run, open_run
from ..scene import Camera
from ..scene.pictures import write_exr, write_png
from .layers import Sure, draw_layers, write_layers

FORMAT, VERSION = "physhdr-frames", 1
#: Seconds between looks at what the other processes have drawn.
LOOK_EVERY = 0.2

#: Called with how many frames are there, of how many, and which is next.
Show = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame to draw. ``exposure``: seconds, for PNG alone. ``layers``: all that can be told (EXR)."""

    path: Path
    camera: Camera
    exposure: float
    levels: tuple[float, ...]
    layers: bool = False

    def described(self) -> dict[str, Any]:
        """As a job's file has it; ``_frame`` is the way back."""
        camera = self.camera
        return {
            "path": str(self.path),
            "pose": camera.camera_to_world.tolist(),
            "size": [camera.width, camera.height],
            "pinhole": [camera.fx, camera.fy, camera.cx, camera.cy],
            "exposure": self.exposure,
            "levels": list(self.levels),
            "layers": self.layers,
        }

    def digest(self, model: str, confidence: bool) -> str:
        """Of all that decides how the frame looks but for its name; ``model``: that of the run's weights.

        ``confidence``: whether its layers have Confidence.
        """
        told = self.described() | {"path": self.path.suffix.lower(), "model": model, "confidence": confidence}
        if told["path"] == ".exr":
            told["exposure"] = None  # radiance has none
        return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


def _frame(told: dict[str, Any]) -> Frame:
    camera = Camera(np.array(told["pose"], np.float64), *told["size"], *told["pinhole"])
    return Frame(Path(told["path"]), camera, told["exposure"], tuple(told["levels"]), told["layers"])


# ---- names ---------------------------------------------------------------------------------------------


def numbered(out: Path, count: int) -> list[Path]:
    """``frames/name_0000.exr`` … of ``frames/name_####.exr``; raises ``BadValueError`` for another form."""
    runs = re.findall("#+", out.name)
    if count == 1 and not runs:
        return [out]
    if len(runs) != 1:
        raise BadValueError(
            f"--out of a sequence has one run of # for its frames' numbers, got {out.name}",
            "Such as frames/name_####.exr.",
        )
    return [out.with_name(out.name.replace(runs[0], f"{k:0{len(runs[0])}d}")) for k in range(count)]


def plan_file(out: Path) -> Path:
    """What stands beside the frames: ``frames/name_####.exr.frames.json`` of ``frames/name_####.exr``.

    With its #: what else is drawn here under a like name (``name_##.exr``) has its own.
    """
    return out.with_name(f"{out.name}.frames.json")


# ---- what is there -------------------------------------------------------------------------------------


def begin(frames: Sequence[Frame], plan: Path, model: str, confidence: bool, overwrite: bool) -> list[Frame]:
    """The frames that are still to be drawn, after the plan was written.

    ``model``, ``confidence``: as ``Frame.digest`` takes them.
    Raises ``OutputError`` where there are frames of something else, unless they are to be replaced.
    """
    wanted = {frame.path.name: frame.digest(model, confidence) for frame in frames}
    there = _planned(plan) if plan.exists() else {}
    stale = {name for name, digest in there.items() if wanted.get(name) != digest}
    stale = {name for name in stale if plan.with_name(name).exists()}
    unknown = {frame.path.name for frame in frames if frame.path.exists()} - set(there)
    if (stale or unknown) and not overwrite:
        first = min(stale | unknown)
        why = "shows something else" if stale else "is there, and nothing says what it shows"
        raise OutputError(
            f"{plan.with_name(first)} {why}"
            + (f" ({len(stale | unknown)} such frames)" if len(stale | unknown) > 1 else ""),
            "Give another --out, or --overwrite to draw them anew.",
        )
    drop = {name for name in (*there, *wanted)} if overwrite else stale
    for path in map(plan.with_name, sorted(drop)):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"cannot remove {path}: {error.strerror}", "Remove it by hand.") from error
    with atomic_path(plan) as temporary:
        content = {"format": FORMAT, "version": VERSION, "frames": wanted}
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return [frame for frame in frames if not frame.path.exists()]


def _planned(plan: Path) -> dict[str, str]:
    remedy = "Give another --out, or move that file away."
    content = read_json_object(plan, remedy)
    frames = content.get("frames")
    if content.get("format") != FORMAT or not isinstance(frames, dict):
        raise OutputError(f"{plan} is no {FORMAT} file", remedy)
    # Names alone: nothing outside of the folder may be touched.
    return {str(name): str(digest) for name, digest in frames.items() if Path(name).name == name}


def model_digest(folder: Path) -> str:
    """Of the run's weights; empty where there are none, of which ``open_run`` tells."""
    if not (folder / CHECKPOINT_FILE).is_file():
        return ""
    with open(folder / CHECKPOINT_FILE, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def require_model(folder: Path, digest: str) -> None:
    """Raises ``DataMismatchError`` where the run's weights are others than those of ``digest``.

    Called after the run was opened, with a digest from before: then what was opened is those, too.
    """
    if model_digest(folder) != digest:
        raise DataMismatchError(
            f"the model in {folder} changed while its frames were drawn",
            "Is it still being trained? Draw them when that has ended, with --overwrite.",
        )


# ---- drawing -------------------------------------------------------------------------------------------


def draw(run: Run, frame: Frame, sure: Sure | None = None) -> None:
    """Draw a frame into its file; raises ``OutputError``, ``BadValueError`` for NaN."""
    if frame.layers:
        layers = draw_layers(run.method, frame.camera, frame.levels, sure, run.radiance_scale)
        finite(layers.radiance, frame.path.name)
        write_layers(frame.path, layers, frame.levels)
    elif frame.path.suffix.lower() == ".exr":
        radiance = finite(run.method.hdr(frame.camera, frame.levels), frame.path.name) * run.radiance_scale
        write_exr(frame.path, radiance.permute(1, 2, 0).numpy())
    else:
        write_png(frame.path, as_picture(run.method.ldr(frame.camera, frame.exposure, frame.levels)))


def draw_all(run: Run, frames: Sequence[Frame], sure: Sure | None, show: Show) -> None:
    """One after the other, here."""
    for done, frame in enumerate(frames):
        show(done, len(frames), frame.path.name)
        draw(run, frame, sure)
    show(len(frames), len(frames), "")


@dataclass(frozen=True)
class Opened:
    """How another process opens the run, as ``open_run`` takes it; ``model``: the digest of its weights."""

    folder: Path
    data: Path | None
    rasteriser: Implementation
    device: DeviceName
    model: str


class WorkerError(PhysHDRError):
    """Another process that did a part of the work has failed."""


def draw_at_once(
    opened: Opened, frames: Sequence[Frame], workers: int, threads: int, sure: Sure | None, show: Show
) -> None:
    """By ``workers`` processes of ``threads`` threads each; raises ``WorkerError``.

    Whatever is raised, they have ended.
    """
    with tempfile.TemporaryDirectory(prefix="physhdr-frames-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        if sure is not None:
            np.save(folder / "confidence.npy", sure.confidence)
        with caught(interrupt), LocalPool(workers) as pool:
            for number in range(workers):
                job = folder / f"{number}.json"
                content = {
                    "threads": threads,
                    "folder": str(opened.folder),
                    "data": None if opened.data is None else str(opened.data),
                    "rasteriser": opened.rasteriser,
                    "device": opened.device,
                    "model": opened.model,
                    "confidence": None if sure is None else str(folder / "confidence.npy"),
                    "frames": [frame.described() for frame in frames[number::workers]],
                }
                job.write_text(json.dumps(content), encoding="utf-8")
                pool.submit(str(number), partial(_worked, job, threads))
            left = workers
            while left:
                time.sleep(LOOK_EVERY)
                show(sum(frame.path.exists() for frame in frames), len(frames), "")
                for _, outcome in pool.finished():
                    if outcome.kind != "done":
                        raise WorkerError(
                            f"a worker failed: {outcome.message}", "Call again with --workers 1 to see more."
                        )
                    left -= 1


def _worked(job: Path, threads: int, should_stop: Callable[[], bool]) -> Outcome:
    """Run one process to its end, in a thread that watches it."""
    log = job.with_suffix(".log")
    command = child_command(__name__, str(job))
    variables = dict.fromkeys(THREAD_VARIABLES, str(threads)) | {"PYTHONUNBUFFERED": "1"}
    try:
        status = run_to_end(command, log, should_stop, variables)
    except StoppedError:
        return Outcome("stopped", "it was stopped")
    if status == 0:
        return Outcome("done")
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    said = [line for line in lines if line.startswith("error: ")]
    return Outcome("failed", (said or lines or [f"it ended with status {status}"])[-1])


def main(argv: list[str]) -> int:
    """Draw a job's frames; what another process calls."""
    end_with_parent()
    try:
        with caught(interrupt):
            return _drawn(argv)
    except KeyboardInterrupt:
        return 130


def _drawn(argv: list[str]) -> int:
    job = json.loads(Path(argv[0]).read_text(encoding="utf-8"))
    import torch

    from ..simd.threads import set_threads

    set_threads(job["threads"])
    torch.set_num_threads(job["threads"])
    try:
        data = None if job["data"] is None else Path(job["data"])
        run = open_run(Path(job["folder"]), data, job["rasteriser"], job["device"], pictures=False)
        require_model(run.folder, job["model"])
        sure = None
        if job["confidence"] is not None:
            sure = Sure(run.on_gaussians(), np.load(job["confidence"], allow_pickle=False))
        for told in job["frames"]:
            draw(run, _frame(told), sure)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}\n")
        return 1
    return 0


def threads_each(workers: int, all_of_them: int) -> int:
    """The threads of each of ``workers``."""
    return max(1, all_of_them // workers)
