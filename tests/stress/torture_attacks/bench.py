# SPDX-License-Identifier: GPL-3.0-or-later
"""What every attack gets: folders, commands, data to attack with; and what it returns."""

import dataclasses
import hashlib
import importlib.util
import json
import os
import shutil
import sys
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .oracle import SkipError, badly_ended
from .processes import BIN, BLENDER, ROOT, Program, Warm, WarmProgram

ROW_FILE = "row.json"
_locks: dict[str, threading.Lock] = {}
_locks_lock = threading.Lock()
#: What a command may take, seconds: long enough for a busy machine, short enough to notice that it hangs.
PATIENCE = 900.0


@dataclass
class Result:
    """The result of an attack: how often, of what, complaints (none: it was withstood), facts to note."""

    unit: str
    tries: int = 0
    complaints: list[str] = field(default_factory=list)
    facts: list[str] = field(default_factory=list)

    def complain(self, complaints: list[str], where: str = "") -> None:
        self.complaints += [f"{where}: {complaint}" if where else complaint for complaint in complaints]


@dataclass(frozen=True, kw_only=True)
class Options:
    """How much of everything. ``trainings`` × ``kills`` full-size trainings; ``tries``: of other attacks."""

    short: bool
    seed: int
    data: Path | None
    trainings: int
    kills: int
    threads: int
    jobs: int
    tries: int
    sizes: int
    soak_seconds: float


@dataclass(frozen=True)
class Material:
    """Small things that many attacks need: a data set, and a run that was trained on it."""

    data: Path
    run: Path
    iterations: int


class Bench:
    """The workbench of one attack. ``folder``: its own, within ``work``."""

    def __init__(
        self,
        name: str,
        work: Path,
        options: Options,
        material: Callable[[], Material],
        warm: Warm | None,
        say: Callable[[str], None],
    ) -> None:
        self.name, self.work, self.options, self._warm = name, work, options, warm
        self.folder = work / name
        self.folder.mkdir(parents=True, exist_ok=True)
        self.rng = np.random.default_rng([options.seed, zlib.crc32(name.encode())])
        self._material, self._say = material, say
        #: What attacks share: of this code alone, and of this size.
        self.made = work / "made" / code_fingerprint()

    @property
    def short(self) -> bool:
        return self.options.short

    @property
    def material(self) -> Material:
        return self._material()

    def making(self, name: str) -> threading.Lock:
        """Held while something that attacks share is made."""
        with _locks_lock:
            return _locks.setdefault(name, threading.Lock())

    def say(self, text: str) -> None:
        self._say(f"{self.name:<15} {text}")

    def physhdr(self, *words: object, log: Path | None = None) -> Program:
        """A command of PhysHDR's, begun."""
        command = [BIN / "physhdr", *words]
        log = log or self.folder / "commands.log"
        return WarmProgram(self._warm, command, log) if self._warm else Program(command, log)

    def cold(self, *words: object, log: Path | None = None) -> Program:
        """The same as a process of its own from its first instruction, for what a fork would not show."""
        return Program([BIN / "physhdr", *words], log or self.folder / "commands.log")

    def make_scene(self, *words: object, log: Path | None = None) -> Program:
        """``synth/make_scene.py``, begun; raises ``SkipError`` where there is no Blender."""
        if not BLENDER.exists():
            raise SkipError("there is no Blender here: make setup")
        script = ROOT / "synth" / "make_scene.py"
        return Program([BLENDER, script, "--", *words], log or self.folder / "commands.log")

    def done(self, program: Program, patience: float = PATIENCE) -> list[str]:
        """Wait for the program to end well."""
        return badly_ended(program.wait(patience), program.output())

    def must(self, program: Program, patience: float = PATIENCE) -> None:
        """The same for a preparation, without which the attack is meaningless."""
        if complaints := self.done(program, patience):
            raise RuntimeError(f"{' '.join(program.words)}: {complaints[0]} (see {program.log})")

    def empty(self, name: str) -> Path:
        """A path within our folder at which there is nothing."""
        path = self.folder / name
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
        return path


# ---- what is attacked ------------------------------------------------------------------------------------


def module_of(path: Path) -> ModuleType:
    """A helper of the tests, which are no packages."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Store:
    """Makes the material once, when it is first needed; it stays in ``work`` for the next time."""

    def __init__(self, work: Path, short: bool, start: Callable[..., Program]) -> None:
        self.folder = work / "made" / "material"
        self._short, self._start = short, start
        self._lock = threading.Lock()
        self._made: Material | None = None

    def __call__(self) -> Material:
        with self._lock:
            if self._made is None:
                self._made = self._make()
            return self._made

    def _make(self) -> Material:
        size, gaussians, views, iterations = (32, 60, 6, 150) if self._short else (64, 120, 8, 400)
        data, run = self.folder / "data", self.folder / "run"
        if not (data / "dataset.json").is_file():
            shutil.rmtree(data, ignore_errors=True)
            tiny = module_of(ROOT / "tests" / "backend" / "tiny_scene.py")
            tiny.write_tiny_scene(data, size, gaussians, views)
        words = ["train", data, "--out", run, "--overwrite", "--iterations", iterations, "--threads", 1]
        program = self._start(*words, log=self.folder / "commands.log")
        if complaints := badly_ended(program.wait(PATIENCE), program.output()):
            raise RuntimeError(f"the small run cannot be trained: {complaints[0]} (see {program.log})")
        return Material(data, run, iterations)


def code_fingerprint() -> str:
    """Of all code that runs here: another version's results are no reference."""
    digest = hashlib.sha256()
    for room in ("bridge", "backend", "lab", "synth", "addon"):
        for path in sorted((ROOT / room).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


# ---- the table -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One line of the table. ``verdict``: ok, FAILED or skipped. ``when``: seconds since 1970."""

    name: str
    what: str
    count: str
    verdict: str
    outcome: str
    seconds: float
    when: float
    code: str

    def write(self, folder: Path) -> None:
        path = folder / ROW_FILE
        pending = path.with_suffix(".partial")
        pending.write_text(json.dumps(dataclasses.asdict(self), indent=1), encoding="utf-8")
        os.replace(pending, path)


def rows_in(work: Path) -> list[Row]:
    """All rows that were written under ``work``, by this call of the tool or by others."""
    found = []
    for path in sorted(work.glob(f"*/{ROW_FILE}")):
        try:
            found.append(Row(**json.loads(path.read_text(encoding="utf-8"))))
        except (OSError, ValueError, TypeError):
            continue
    return found


def row_of(name: str, what: str, attack: Callable[[Bench], Result], bench: Bench, code: str) -> Row:
    """Do it; anything it raises except a skip and CTRL-C is a failure of the row."""
    begun = time.monotonic()

    def row(count: str, verdict: str, outcome: str) -> Row:
        return Row(name, what, count, verdict, outcome, time.monotonic() - begun, time.time(), code)

    try:
        result = attack(bench)
    except SkipError as reason:
        return row("–", "skipped", str(reason))
    except Exception as error:  # noqa: BLE001 (one attack that cannot be done must not hide the others)
        return row("–", "FAILED", f"{type(error).__name__}: {error}")
    facts = "; ".join(result.facts)
    if not result.complaints:
        return row(f"{result.tries} {result.unit}", "ok", facts or "as it should be")
    shown = "; ".join(result.complaints[:3])
    more = f"; and {len(result.complaints) - 3} more" if len(result.complaints) > 3 else ""
    outcome = f"{len(result.complaints)} complaints: {shown}{more}" + (f" ({facts})" if facts else "")
    return row(f"{result.tries} {result.unit}", "FAILED", outcome)


def table(rows: list[Row]) -> str:
    """Markdown."""

    def cell(value: Any) -> str:
        return " ".join(str(value).replace("|", "\\|").split())

    lines = ["| attack | what is done | count | verdict | outcome | took |", "|---|---|---|---|---|---|"]
    for row in rows:
        took = f"{row.seconds:.0f} s" if row.seconds < 600 else f"{row.seconds / 60:.0f} min"
        cells = (row.name, row.what, row.count, row.verdict, row.outcome, took)
        lines.append("| " + " | ".join(cell(value) for value in cells) + " |")
    return "\n".join(lines) + "\n"
