# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbered frames along a path of cameras, rendered here or by several processes.

``NAME_####.exr.frames.json`` next to the frames stores what each shows, as a digest of the model, the camera
and the light. Existing frames are complete (they are written by a rename) and stay if their digest matches,
so an interrupted sequence resumes. Other processes read their frames from a file and open the run themselves
(``child.py``).
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
from .layers import GaussianConfidence, render_layers, write_layers
from .output import ShowProgress

FORMAT, VERSION = "physhdr-frames", 1
#: Seconds between checks of the other processes' frames.
POLL_SECONDS = 0.2


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame to render. ``exposure``: seconds, for PNG only. ``layers``: write all layers (EXR)."""

    path: Path
    camera: Camera
    exposure: float
    levels: tuple[float, ...]
    layers: bool = False

    def described(self) -> dict[str, Any]:
        """The frame as stored in a job's file; ``_frame`` is the inverse."""
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
        """Digest of everything that determines the frame's content; ``model``: digest of the run's weights.

        ``confidence``: whether its layers include Confidence.
        """
        content = self.described() | {
            "path": self.path.suffix.lower(),
            "model": model,
            "confidence": confidence,
        }
        if content["path"] == ".exr":
            content["exposure"] = None  # radiance has none
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def _frame(stored: dict[str, Any]) -> Frame:
    camera = Camera(np.array(stored["pose"], np.float64), *stored["size"], *stored["pinhole"])
    return Frame(Path(stored["path"]), camera, stored["exposure"], tuple(stored["levels"]), stored["layers"])


# ---- names ---------------------------------------------------------------------------------------------


def numbered(out: Path, count: int) -> list[Path]:
    """``frames/name_0000.exr`` … of ``frames/name_####.exr``; raises ``BadValueError`` for another form."""
    runs = re.findall("#+", out.name)
    if count == 1 and not runs:
        return [out]
    if len(runs) != 1:
        raise BadValueError(
            f"--out of a sequence needs one run of # for the frames' numbers, got {out.name}",
            "For example: frames/name_####.exr.",
        )
    return [out.with_name(out.name.replace(runs[0], f"{k:0{len(runs[0])}d}")) for k in range(count)]


def plan_file(out: Path) -> Path:
    """The file next to the frames: ``frames/name_####.exr.frames.json`` for ``frames/name_####.exr``.

    It includes the #, so that a similar sequence (``name_##.exr``) has its own.
    """
    return out.with_name(f"{out.name}.frames.json")


# ---- existing frames -----------------------------------------------------------------------------------


def begin(frames: Sequence[Frame], plan: Path, model: str, confidence: bool, overwrite: bool) -> list[Frame]:
    """Write the plan; returns the frames that are still to be rendered.

    ``model``, ``confidence``: as in ``Frame.digest``. Raises ``OutputError`` where frames with other content
    exist, unless ``overwrite``.
    """
    wanted = {frame.path.name: frame.digest(model, confidence) for frame in frames}
    planned = _planned(plan) if plan.exists() else {}
    stale = {name for name, digest in planned.items() if wanted.get(name) != digest}
    stale = {name for name in stale if plan.with_name(name).exists()}
    unknown = {frame.path.name for frame in frames if frame.path.exists()} - set(planned)
    if (stale or unknown) and not overwrite:
        first = min(stale | unknown)
        why = "shows something else" if stale else "exists, and its content is unknown"
        raise OutputError(
            f"{plan.with_name(first)} {why}"
            + (f" ({len(stale | unknown)} such frames)" if len(stale | unknown) > 1 else ""),
            "Give another --out, or --overwrite to render them again.",
        )
    drop = {name for name in (*planned, *wanted)} if overwrite else stale
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
        raise OutputError(f"{plan} is not a {FORMAT} file", remedy)
    # Names only: nothing outside the folder may be touched.
    return {str(name): str(digest) for name, digest in frames.items() if Path(name).name == name}


def model_digest(folder: Path) -> str:
    """Digest of the run's weights; empty where there are none, which ``open_run`` reports."""
    if not (folder / CHECKPOINT_FILE).is_file():
        return ""
    with open(folder / CHECKPOINT_FILE, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def require_model(folder: Path, digest: str) -> None:
    """Raises ``DataMismatchError`` where the run's weights differ from those of ``digest``.

    Called after opening the run with a digest from before, which proves that these weights were opened.
    """
    if model_digest(folder) != digest:
        raise DataMismatchError(
            f"the model in {folder} changed while its frames were rendered",
            "If it is still training, render them afterwards, with --overwrite.",
        )


# ---- rendering -----------------------------------------------------------------------------------------


def render_frame(run: Run, frame: Frame, confidence: GaussianConfidence | None = None) -> None:
    """Render a frame into its file; raises ``OutputError``, ``BadValueError`` for NaN."""
    if frame.layers:
        layers = render_layers(run.method, frame.camera, frame.levels, confidence, run.radiance_scale)
        finite(layers.radiance, frame.path.name)
        write_layers(frame.path, layers, frame.levels)
    elif frame.path.suffix.lower() == ".exr":
        radiance = finite(run.method.hdr(frame.camera, frame.levels), frame.path.name) * run.radiance_scale
        write_exr(frame.path, radiance.permute(1, 2, 0).numpy())
    else:
        write_png(frame.path, as_picture(run.method.ldr(frame.camera, frame.exposure, frame.levels)))


def render_all(
    run: Run, frames: Sequence[Frame], confidence: GaussianConfidence | None, show: ShowProgress
) -> None:
    """Render one after the other in this process."""
    for done, frame in enumerate(frames):
        show(done, len(frames), frame.path.name)
        render_frame(run, frame, confidence)
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
    """Another process, which did part of the work, has failed."""


def render_in_parallel(
    opened: Opened,
    frames: Sequence[Frame],
    workers: int,
    threads: int,
    confidence: GaussianConfidence | None,
    show: ShowProgress,
) -> None:
    """Render in ``workers`` processes of ``threads`` threads each; raises ``WorkerError``.

    Whatever is raised, the processes have ended.
    """
    with tempfile.TemporaryDirectory(prefix="physhdr-frames-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        if confidence is not None:
            np.save(folder / "confidence.npy", confidence.confidence)
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
                    "confidence": None if confidence is None else str(folder / "confidence.npy"),
                    "frames": [frame.described() for frame in frames[number::workers]],
                }
                job.write_text(json.dumps(content), encoding="utf-8")
                pool.submit(str(number), partial(_worked, job, threads))
            left = workers
            while left:
                time.sleep(POLL_SECONDS)
                show(sum(frame.path.exists() for frame in frames), len(frames), "")
                for _, outcome in pool.finished():
                    if outcome.kind != "done":
                        raise WorkerError(
                            f"a worker failed: {outcome.message}", "Retry with --workers 1 to see more."
                        )
                    left -= 1


def _worked(job: Path, threads: int, should_stop: Callable[[], bool]) -> Outcome:
    """Run one process to its end, watched by this thread."""
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
    errors = [line for line in lines if line.startswith("error: ")]
    return Outcome("failed", (errors or lines or [f"it ended with status {status}"])[-1])


def main(argv: list[str]) -> int:
    """Render a job's frames: the entry point of another process."""
    end_with_parent()
    try:
        with caught(interrupt):
            return _render_job(argv)
    except KeyboardInterrupt:
        return 130


def _render_job(argv: list[str]) -> int:
    job = json.loads(Path(argv[0]).read_text(encoding="utf-8"))
    import torch

    from ..simd.threads import set_threads

    set_threads(job["threads"])
    torch.set_num_threads(job["threads"])
    try:
        data = None if job["data"] is None else Path(job["data"])
        run = open_run(Path(job["folder"]), data, job["rasteriser"], job["device"], pictures=False)
        require_model(run.folder, job["model"])
        confidence = None
        if job["confidence"] is not None:
            confidence = GaussianConfidence(
                run.on_gaussians(), np.load(job["confidence"], allow_pickle=False)
            )
        for stored in job["frames"]:
            render_frame(run, _frame(stored), confidence)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}\n")
        return 1
    return 0


def threads_each(workers: int, all_of_them: int) -> int:
    """The threads of each of ``workers``."""
    return max(1, all_of_them // workers)
