# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr benchmark``: methods × scenes × settings × seeds at equal budgets, and the report on them."""

import hashlib
import json
import shlex
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.live import Live

from ..backend.device import DeviceName
from ..backend.jobs.pools import LocalPool, Pool, RayPool
from ..backend.runs.files import writable_folder
from ..backend.runs.terminal import console
from ..backend.train.config import CONFIG_FILE, TrainConfig, write_config
from ..backend.train.presets import preset_named
from ..backend.train.settings import assigned, with_settings
from ..bridge.errors import BadValueError, FileMissingError, PhysHDRError
from ..bridge.regular import resolved
from ..bridge.signals import caught, interrupt
from .benchmark.job import PROGRAM
from .benchmark.live import progress_table
from .benchmark.plan import PLAN_FILE, Plan, make_plan, read_plan, setting_in, write_plan
from .benchmark.report import REPORT_FILE, holds_runs, write_report
from .benchmark.roles import require_allowed
from .benchmark.runs import PER_RUN, Store, data_fingerprint, data_folder
from .benchmark.schedule import Schedule
from .benchmark.sized import sized


@dataclass(frozen=True)
class Benchmark:
    """Train and evaluate methods on scenes at equal budgets; runs that exist are not repeated.

    Options are shorthand for a plan file (lab/benchmarking.md); without either, the plan in --out continues.
    """

    #: Folder of the benchmark: its plan, its runs, report.md and report.csv.
    out: Path
    #: A plan (TOML); the options below override it.
    plan: Path | None = None
    #: Its purpose: report (test views; the default), or tune (validation views only, to make choices).
    kind: Literal["tune", "report"] | None = None
    #: Presets, separated by commas or spaces; or 'NAME := PRESET setting=value', one per argument.
    methods: tuple[str, ...] = ()
    #: Pictures made by another program: NAME=FOLDER, with {scene} and so on (lab/compare.md).
    external: tuple[str, ...] = ()
    #: Folders of data sets; NAME=FOLDER to name one.
    scenes: tuple[str, ...] = ()
    #: How training chooses exposures: exp1, exp3.
    settings: tuple[str, ...] = ()
    #: For example 0,1,2.
    seeds: tuple[str, ...] = ()
    #: iterations=N or cpu-seconds=S, the same for every run; each one makes a table.
    budget: tuple[str, ...] = ()
    #: FIELD=VALUE for every method, such as downscale=2.
    set: tuple[str, ...] = ()
    #: Report the margins of these methods over all others, separated by commas; default: the first method.
    margins_of: tuple[str, ...] = ()
    #: LPIPS weights, as for physhdr evaluate.
    lpips_weights: Path | None = None
    #: Where to compute.
    device: DeviceName | None = None
    #: Threads of each run.
    threads_per_job: int | None = None
    #: Runs at the same time on this machine.
    jobs: int = 1
    #: Spread the runs over this Ray cluster (an address as for ray.init, or 'local' to start one).
    ray: str | None = None
    #: Also write the report (and a .csv) here.
    report: Path | None = None
    #: Run nothing: report existing evaluations, and leave the plan in --out unchanged.
    report_only: bool = False
    #: Retry failed runs.
    retry: bool = False
    #: Evaluate trained runs again.
    evaluate_again: bool = False

    def run(self) -> int:
        plan = self._plan()
        require_allowed(plan)
        presets = {method.name: configuration(plan, method.name) for method in plan.trained}
        console.print(f"computing fingerprints of {len(plan.scenes)} data sets")
        data = {scene.name: data_fingerprint(scene.data, plan.kind) for scene in plan.scenes}
        out = writable_folder(self.out)
        if not self.report_only and not _is_in(out / PLAN_FILE, plan):
            write_plan(plan, out / PLAN_FILE)
        configs = configurations(plan, presets, resolved(out))
        schedule = Schedule(
            Store(resolved(out), plan, configs, data, _weights(plan.lpips_weights)),
            log=lambda line: console.print(line, soft_wrap=True, markup=False),
            retry=self.retry,
            evaluate_again=self.evaluate_again,
            as_evaluated=self.report_only,
            program=PROGRAM,
        )
        is_written = False
        try:
            if not self.report_only:
                self._do_runs(schedule, plan)
        except KeyboardInterrupt:
            console.print("stopped; to resume, repeat the command: finished runs are not repeated")
            raise
        finally:  # also after CTRL-C
            is_written = self._write_report(schedule)
        if absent := [run for run in schedule.runs if schedule.status[run].kind == "absent"]:
            first = schedule.status[absent[0]].text
            console.print(f"{len(absent)} of {len(schedule.runs)} runs skipped: {first}", soft_wrap=True)
        bad = [run for run in schedule.runs if schedule.status[run].kind in ("failed", "blocked")]
        if bad:
            console.print(f"{len(bad)} of {len(schedule.runs)} runs failed: the report lists them; --retry")
        return 0 if is_written and not bad else 1

    def _plan(self) -> Plan:
        """The plan file (``plan``, or the one in ``out``), overridden by options."""
        stored = self.out / PLAN_FILE
        if self.plan is not None and not self.plan.is_file():
            raise FileMissingError(f"there is no plan {self.plan}", "Give a TOML file.")
        fresh = (self.methods or self.external) and self.scenes and self.budget
        source = self.plan or (stored if stored.is_file() and not fresh else None)
        content = read_plan(source) if source else {}
        flags: dict[str, Any] = {
            "kind": self.kind,
            "methods": _split(self.methods),
            "external": [_external(text) for text in self.external],
            "scenes": [word for text in self.scenes for word in _scenes(text)],
            "settings": _split(self.settings),
            "seeds": [_number(word) for word in _split(self.seeds)],
            "budgets": _split(self.budget),
            "set": list(self.set),
            "margins_of": _split(self.margins_of),
            "lpips_weights": self.lpips_weights and str(resolved(self.lpips_weights)),
            "device": self.device,
            "threads_per_job": self.threads_per_job,
        }
        typed = {key: value for key, value in flags.items() if value not in (None, [], "")}
        return make_plan(content | typed, Path.cwd())

    def _overrides(self) -> list[str]:
        """The options that override the plan file, as arguments."""
        typed: dict[str, tuple[str, ...]] = {
            "--kind": (self.kind,) if self.kind else (),
            "--methods": self.methods,
            "--external": self.external,
            "--scenes": self.scenes,
            "--settings": self.settings,
            "--seeds": self.seeds,
            "--budget": self.budget,
            "--set": self.set,
            "--margins-of": self.margins_of,
            "--lpips-weights": (self.lpips_weights.name,) if self.lpips_weights else (),
            "--device": (self.device,) if self.device else (),
            "--threads-per-job": (str(self.threads_per_job),) if self.threads_per_job else (),
        }
        return [argument for flag, values in typed.items() if values for argument in (flag, *values)]

    def _do_runs(self, schedule: Schedule, plan: Plan) -> None:
        pool: Pool = RayPool(self.ray, plan.threads_per_job) if self.ray else LocalPool(self.jobs)
        waiting = len(schedule.unsettled())
        console.print(
            f"{len(schedule.runs)} runs, {waiting} to be done; in {schedule.store.out}", soft_wrap=True
        )
        if not waiting:
            return
        with caught(interrupt):
            if not console.is_terminal:
                schedule.do_all(pool)
                return
            with Live(console=console, auto_refresh=False, transient=True) as live:
                schedule.do_all(pool, lambda: live.update(progress_table(schedule), refresh=True))

    def _write_report(self, schedule: Schedule) -> bool:
        """Write it and return True, unless it has no runs and would replace one that has."""
        copies = [self.report] if self.report else []
        places = [schedule.store.out / REPORT_FILE, *copies]
        is_any_done = any(status.kind == "done" for status in schedule.status.values())
        if not is_any_done and (older := [str(path) for path in places if holds_runs(path)]):
            console.print(
                f"no run of this plan is done: not replacing {', '.join(older)}. Choose another folder for "
                "this plan, --out, or run it without --report-only.",
                soft_wrap=True,
            )
            return False
        arguments = ["--plan", _shown(self.plan)] if self.plan else []
        arguments += self._overrides()
        arguments += ["--out", str(self.out)]
        arguments += [argument for path in copies for argument in ("--report", _shown(path))]
        command = shlex.join(["physhdr", "benchmark", *arguments])
        paths = []
        for path in places:
            paths += write_report(schedule, path, command)
        console.print("wrote " + ", ".join(str(path) for path in paths), soft_wrap=True)
        return True


def configurations(
    plan: Plan, presets: dict[str, TrainConfig], out: Path
) -> dict[tuple[str, str], dict[str, Any]]:
    """By method and scene, the content of its runs' ``config.json``, without what is specific to a run.

    ``presets``: each method's ``configuration``. Raises ``OutputError``.
    """
    # Settings that differ between runs also count as typed.
    typed = {each.name: (*map(setting_in, plan.settings_of(each)), *PER_RUN) for each in plan.trained}
    found = {}
    for scene in plan.scenes:
        for name, config in sized(presets, typed, data_folder(out, plan, scene)).items():
            found[name, scene.name] = _as_written(config)
    return found


def configuration(plan: Plan, name: str) -> TrainConfig:
    """The whole configuration of a method for training, before its sizes are found from the data.

    Raises ``BadValueError`` for an unknown preset or setting, and for an invalid value.
    """
    method = next(method for method in plan.methods if method.name == name)
    try:
        preset = preset_named(method.preset)
        return with_settings(preset, assigned(preset, plan.settings_of(method)))
    except BadValueError as error:
        raise BadValueError(f"the method '{name}': {error.message}", error.hint) from error


def _as_written(config: TrainConfig) -> dict[str, Any]:
    """As in ``config.json``."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = Path(folder) / CONFIG_FILE
        write_config(path, config, Path(folder), "")
        return json.loads(path.read_text(encoding="utf-8"))["config"]


def _shown(path: Path) -> str:
    """As typed; only the name of an absolute path, because the location of a checkout is private."""
    return path.name if path.is_absolute() else str(path)


def _is_in(path: Path, plan: Plan) -> bool:
    """Whether the file has this plan; a hand-written one may have comments and relative folders."""
    try:
        return make_plan(read_plan(path), path.parent) == plan
    except PhysHDRError:
        return False


def _weights(path: Path | None) -> str:
    if path is None:
        return ""
    if not path.is_file():
        raise FileMissingError(f"there are no LPIPS weights at {path}", "See docs/formats.md.")
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _split(words: tuple[str, ...]) -> list[str]:
    """Split words at commas; a defined method stays whole."""
    parts = [part for word in words for part in ([word] if ":=" in word else word.split(","))]
    return [part.strip() for part in parts if part.strip()]


def _scenes(text: str) -> list[str]:
    return [text] if Path(text).is_dir() else _split((text,))


def _external(text: str) -> dict[str, str]:
    name, _, folder = text.partition("=")
    return {"name": name.strip(), "folder": folder.strip()}


def _number(word: str) -> int:
    try:
        return int(word)
    except ValueError as error:
        raise BadValueError(f"'{word}' is not a seed", "Give whole numbers: --seeds 0,1,2") from error


if __name__ == "__main__":
    sys.exit(tyro.cli(Benchmark).run())


#: Added to the command line (``backend/tables.py``).
COMMANDS = {"benchmark": Benchmark}
