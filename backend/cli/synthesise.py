# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr synthesise``: a data set that several Blenders render at once, here or on a cluster."""

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
#: Of the data set's folder: what the parts say while they are rendered.
LOGS = ".parts"
#: Seconds between looks at what is done; and those that a program has to say which it is.
LOOK_EVERY, ANSWERS_WITHIN = 0.25, 60.0
#: Options of make_scene.py that are this command's to give.
OURS = ("--part", "--worker-of")


@dataclass(frozen=True)
class Synthesise:
    """Render a data set in parts, by several Blenders at the same time, and complete it.

    After `--` stand make_scene.py's own options: physhdr synthesise --jobs 4 -- --out data/demo --views 35
    """

    #: Blender, or a Python that has bpy; on a cluster's machines at the same path.
    blender: str = "blender"
    #: Parts that are rendered at the same time on this machine.
    jobs: int = 1
    #: Spread the parts over this Ray cluster (an address as for ray.init, or 'local' to start one).
    ray: str | None = None
    #: Threads of each part.
    threads_per_job: int = 1
    #: How many parts there are; default: as many as can be rendered at the same time.
    parts: int | None = None
    #: make_scene.py's.
    options: tyro.conf.Suppress[tuple[str, ...]] = ()

    def run(self) -> int:
        out = _out(self.options).absolute()  # a part on another machine begins in another folder
        whole("--threads-per-job", self.threads_per_job, 1, THREADS_MAX)
        if self.parts is not None:
            whole("--parts", self.parts, 1, PARTS_MAX)
        command = (*_started_by(self.blender), *self.options)
        pool: Pool = RayPool(self.ray, self.threads_per_job) if self.ray else LocalPool(self.jobs)
        try:
            with caught(interrupt):
                self._render_parts(pool, command, out / LOGS)
                # Points, the noise floor, dataset.json; and whatever a part could not render.
                return run_in_front(command)
        finally:
            shutil.rmtree(out / LOGS, ignore_errors=True)
            with suppress(OSError):
                out.rmdir()  # if there is nothing in it: make_scene.py has refused

    def _render_parts(self, pool: Pool, command: tuple[str, ...], logs: Path) -> None:
        """Until every part has ended; one that failed is told of and left to the last step."""
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
                    said = f": {outcome.message}" if outcome.message else ""
                    console.print(f"{name}: {outcome.kind}{said}", soft_wrap=True, markup=False)
                time.sleep(LOOK_EVERY)


def render(command: tuple[str, ...], folder: Path, log: Path, should_stop: Callable[[], bool]) -> Outcome:
    """Run a command in ``folder``, what it says going to ``log``, on whichever machine this is."""
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
    errors = [line for line in lines if line.startswith("error:")]  # Blender may have more to say after it
    told = errors or lines
    return Outcome("failed", told[-1] if told else f"it ended with status {status}")


def parsed(argv: list[str]) -> Synthesise:
    """The command of the words after ``synthesise``: our own until ``--``, make_scene.py's after it."""
    ours = argv[: argv.index("--")] if "--" in argv else argv
    command = tyro.cli(Synthesise, prog="physhdr synthesise", args=ours)
    return dataclasses.replace(command, options=tuple(argv[len(ours) + 1 :]))


def _out(options: tuple[str, ...]) -> Path:
    """The data set's folder; raises ``BadValueError`` for none, and for what cannot be done in parts."""
    named = {}
    for option, value in pairwise((*options, "")):
        name, equals, given = option.partition("=")
        named[name] = given if equals else value
    for name in OURS:
        if name in named:
            raise BadValueError(f"{name} is for physhdr synthesise to give", "Leave it out.")
    if named.get("--from-file") == "current":
        raise BadValueError(
            "--from-file current is the scene that is open in a Blender, and others cannot see it",
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
    hint = "Give --blender PATH: Blender's own program, or a Python that has bpy."
    if program is None:
        raise BadValueError(f"there is no program '{blender}'", hint)
    try:
        said = subprocess.run(
            [program, "--version"],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=ANSWERS_WITHIN,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BadValueError(f"{program} does not say what it is: {error}", hint) from error
    program = str(Path(program).absolute())
    if said.stdout.startswith("Blender"):
        return (program, "--background", "--python-exit-code", "1", "--python", str(SCRIPT), "--")
    if said.stdout.startswith("Python"):
        return (program, str(SCRIPT), "--")
    raise BadValueError(f"{program} is neither Blender nor a Python", hint)
