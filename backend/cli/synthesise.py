# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr synthesise``: renders a data set with several Blenders at once, here or on a cluster."""

import dataclasses
import shutil
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import tyro

from ...bridge.errors import BadValueError
from ...bridge.limits import PARTS_MAX, THREADS_MAX, whole
from ...bridge.signals import caught, interrupt
from ..jobs.pools import LocalPool, Outcome, Pool, RayPool
from ..jobs.process import StoppedError, run_in_front, run_to_end
from ..runs.terminal import console

SCRIPT = Path(__file__).resolve().parents[2] / "synth" / "make_scene.py"
#: Folder, in the data set's, of the parts' logs.
LOGS = ".parts"
#: Seconds between checks of the parts; and the time limit for a program's --version.
POLL_SECONDS, VERSION_SECONDS = 0.25, 60.0
#: Options of make_scene.py that this command sets.
OURS = ("--part", "--worker-of")


@dataclass(frozen=True)
class Synthesise:
    """Render a data set in parts with several Blenders at once, and complete it.

    make_scene.py's own options follow `--`: physhdr synthesise --jobs 4 -- --out data/demo --views 35
    """

    #: Blender, or a Python with bpy; at the same path on all machines of a cluster.
    blender: str = "blender"
    #: Parts rendered at the same time on this machine.
    jobs: int = 1
    #: Spread the parts over this Ray cluster (an address as for ray.init, or 'local' to start one).
    ray: str | None = None
    #: Threads per part.
    threads_per_job: int = 1
    #: Number of parts; default: as many as can be rendered at the same time.
    parts: int | None = None
    #: make_scene.py's options.
    options: tyro.conf.Suppress[tuple[str, ...]] = ()

    def run(self) -> int:
        out = _out(self.options).absolute()  # on another machine the working folder differs
        whole("--threads-per-job", self.threads_per_job, 1, THREADS_MAX)
        if self.parts is not None:
            whole("--parts", self.parts, 1, PARTS_MAX)
        command = (*_started_by(self.blender), *self.options)
        pool: Pool = RayPool(self.ray, self.threads_per_job) if self.ray else LocalPool(self.jobs)
        try:
            with caught(interrupt):
                self._render_parts(pool, command, out / LOGS)
                # Points, the noise floor, dataset.json; and what any part could not render.
                return run_in_front(command)
        finally:
            shutil.rmtree(out / LOGS, ignore_errors=True)
            with suppress(OSError):
                out.rmdir()  # if it is empty, because make_scene.py refused

    def _render_parts(self, pool: Pool, command: tuple[str, ...], logs: Path) -> None:
        """Wait until every part has ended; failed ones are reported and left to the last step."""
        with pool:
            count = self.parts or max(1, pool.free())
            waiting, done = list(range(1, count + 1)), 0
            parts = "one part" if count == 1 else f"{count} parts, {min(count, pool.free())} at the same time"
            console.print(parts)
            while done < count:
                while waiting and pool.free() > 0:
                    number = waiting.pop(0)
                    words = (*command, "--part", f"{number}/{count}", "--threads", str(self.threads_per_job))
                    log = logs / f"{number}.log"
                    pool.submit(f"part {number} of {count}", partial(render, words, Path.cwd(), log))
                for name, outcome in pool.finished():
                    done += 1
                    message = f": {outcome.message}" if outcome.message else ""
                    console.print(f"{name}: {outcome.kind}{message}", soft_wrap=True, markup=False)
                time.sleep(POLL_SECONDS)


def render(command: tuple[str, ...], folder: Path, log: Path, should_stop: Callable[[], bool]) -> Outcome:
    """Run a command in ``folder`` with its output in ``log``, on whichever machine this is."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        status = run_to_end(command, log, should_stop, folder=folder)
    except StoppedError:
        return Outcome("stopped")
    except OSError as error:
        return Outcome("failed", str(error))
    if status == 0:
        return Outcome("done")
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    errors = [line for line in lines if line.startswith("error:")]  # Blender may print more after it
    return Outcome("failed", (errors or lines or [f"it ended with status {status}"])[-1])


def parsed(argv: list[str]) -> Synthesise:
    """The command from the arguments after ``synthesise``: ours before ``--``, make_scene.py's after it."""
    ours = argv[: argv.index("--")] if "--" in argv else argv
    command = tyro.cli(Synthesise, prog="physhdr synthesise", args=ours)
    return dataclasses.replace(command, options=tuple(argv[len(ours) + 1 :]))


def _out(options: tuple[str, ...]) -> Path:
    """The data set's folder; raises ``BadValueError`` if missing, and for what cannot be done in parts."""
    named = {}
    for option, value in pairwise((*options, "")):
        name, equals, assigned = option.partition("=")
        named[name] = assigned if equals else value
    for name in OURS:
        if name in named:
            raise BadValueError(f"{name} is set by physhdr synthesise", "Leave it out.")
    if named.get("--from-file") == "current":
        raise BadValueError(
            "--from-file current is the scene open in one Blender, which others cannot see",
            "Save it, and give the .blend file.",
        )
    if not named.get("--out"):
        raise BadValueError(
            "make_scene.py's own options are missing",
            "Give them after two dashes: physhdr synthesise --jobs 4 -- --out FOLDER --scene dog",
        )
    return Path(named["--out"])


def _started_by(blender: str) -> tuple[str, ...]:
    """The command that runs make_scene.py, up to its own options; raises ``BadValueError``."""
    program = shutil.which(blender)
    hint = "Give --blender PATH: Blender itself, or a Python with bpy."
    if program is None:
        raise BadValueError(f"there is no program '{blender}'", hint)
    try:
        result = subprocess.run(
            [program, "--version"],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=VERSION_SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BadValueError(f"'{program} --version' failed: {error}", hint) from error
    program = str(Path(program).absolute())
    if result.stdout.startswith("Blender"):
        return (program, "--background", "--python-exit-code", "1", "--python", str(SCRIPT), "--")
    if result.stdout.startswith("Python"):
        return (program, str(SCRIPT), "--")
    raise BadValueError(f"{program} is neither Blender nor a Python", hint)
