# SPDX-License-Identifier: GPL-3.0-or-later
"""The runs of a plan, where each is stored, and which results exist.

``OUT/<budget>/<setting>/<scene>/<method>/seed_<n>/`` is the folder of ``physhdr train`` and ``evaluate``,
with ``benchmark.log`` (what they printed) and ``run.json`` (``Record``), or ``failed.json``. It appears by
one rename when complete. ``search.json`` beside the seeds: the iterations of a budget in CPU seconds.
Runs of a plan that tunes are in ``OUT/tune/`` instead, so that none is mistaken for one of a report.
"""

import dataclasses
import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

from ...backend.evaluate.comparison import load_evaluation
from ...backend.train.config import CONFIG_FILE, completed, method_of
from ...bridge import data_set
from ...bridge.atomic import atomic_path, patiently
from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError, PhysHDRError
from ...bridge.regular import resolved
from .external import pictures_digest
from .plan import CPU_SECONDS, REPORT, TUNE, Budget, Method, Plan, SceneFolder
from .without_test import link_without_test, names_without_test

RUN_FILE, FAILED_FILE, SEARCH_FILE = "run.json", "failed.json", "search.json"
RUN_LOG = "benchmark.log"
#: Suffix of a working folder's neighbour: the former result, while it is replaced.
REPLACED = ".old"
#: Fields of the configuration that the plan sets for each run.
PER_RUN = ("iterations", "seed", "exposure_mode")
#: The setting that names a file beside the data set's own.
POINTS_SETTING = "points_file"
#: Renders from which a data set was made: neither training nor evaluation reads them.
UNREAD = data_set.PASSES_FOLDER
#: In the folder of a tuning plan: each data set without its test views.
WITHOUT_TEST = "without-test"


@dataclass(frozen=True)
class Run:
    """One training with its evaluation."""

    budget: Budget
    setting: str
    scene: SceneFolder
    method: Method
    seed: int
    kind: str = REPORT

    @property
    def group(self) -> Path:
        """The folder of all its seeds."""
        place = Path(TUNE) if self.kind == TUNE else Path()
        return place / self.budget.folder / self.setting / self.scene.name / self.method.name

    @property
    def folder(self) -> Path:
        return self.group / f"seed_{self.seed}"

    @property
    def pictures(self) -> Path | None:
        """Where another program puts the pictures of this run; None for a method that we train."""
        if not self.method.pictures:
            return None
        names = {"scene": self.scene.name, "setting": self.setting, "seed": self.seed}
        return self.method.pictures_of(names | {"budget": self.budget.folder})

    @property
    def claim(self) -> str:
        """The folder as one name, different for every run: ``a__b`` / ``c`` is not ``a`` / ``b__c``."""
        return "__".join(re.sub("^_|_(?=_|$)", "~", part) for part in self.folder.parts)


@dataclass(frozen=True, kw_only=True)
class Record:
    """What ``run.json`` holds of a run that is done: what was run, and the cost of training alone.

    ``cpu_seconds``: user and system time of the training, first points included; ``seconds``: on the clock.
    ``gaussians``: at the end (0 for a method without). ``peak_memory``: bytes, of the training process. What
    is unknown of another program's pictures is None.
    ``training``, ``evaluation``: fingerprints of all that decides the result. ``note``: for the report.
    """

    iterations: int | None
    cpu_seconds: float | None
    seconds: float | None
    gaussians: int | None
    peak_memory: int | None
    training: str
    evaluation: str
    threads: int
    device: str
    machine: dict[str, Any] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Search:
    """What ``search.json`` holds: the iterations that were found, and the measurements behind them."""

    iterations: int
    training: str
    threads: int
    device: str
    measurements: list[dict[str, float]]
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Failure:
    """What ``failed.json`` holds. ``log``: the last lines that were printed."""

    stage: str
    status: int
    log: list[str]
    training: str
    evaluation: str


def has_gaussians(config: dict[str, Any]) -> bool:
    """Whether the method of a configuration (as in ``config.json``) is made of Gaussians."""
    return method_of(config.get("method", {})).traits.splats


State = Literal["done", "evaluate", "failed", "todo", "absent"]


def runs_of(plan: Plan) -> list[Run]:
    """All runs, in the order in which they begin: what others need first, and every method soon."""
    budgets = sorted(plan.budgets, key=lambda budget: budget.kind == CPU_SECONDS)
    return [
        Run(budget, setting, scene, method, seed, plan.kind)
        for budget in budgets
        for seed in plan.seeds
        for setting in plan.settings
        for scene in plan.scenes
        for method in plan.methods
    ]


@dataclass
class Store:
    """What is in the benchmark's folder, compared with the plan.

    ``configs``: the whole configuration as JSON, at the size that the data require, by the names of a trained
    method and a scene; ``data``: the data's fingerprint, by scene.
    """

    out: Path
    plan: Plan
    configs: dict[tuple[str, str], dict[str, Any]]
    data: dict[str, str]
    weights: str = ""
    _points: dict[Path, str] = field(default_factory=dict, init=False)

    def config(self, run: Run, iterations: int) -> dict[str, Any]:
        """The configuration that this run must have been trained with."""
        own = {"iterations": iterations, "seed": run.seed, "exposure_mode": run.setting}
        return self._config(run) | own

    def _config(self, run: Run) -> dict[str, Any]:
        return self.configs[run.method.name, run.scene.name]

    def training_fingerprint(self, run: Run) -> str:
        """Of what a method's runs share of the configuration, the data, and a file of points, which may be
        elsewhere.

        For another program's pictures: of these, the data, and the size at which they are compared.
        """
        if run.pictures is not None:
            pictures = [self._digest_of(run.pictures), *self.plan.picture_options]
            return fingerprint(["pictures", pictures, self.data[run.scene.name]])
        return self._fingerprint(self._config(run), run)

    def _fingerprint(self, config: dict[str, Any], run: Run) -> str:
        shared = _shared(config)
        content = [shared, self.data[run.scene.name]]
        if (name := shared.pop(POINTS_SETTING, None)) is not None:
            content.append({POINTS_SETTING: name, "sha256": self._digest(run.scene.data / name)})
        return fingerprint(content)

    def _is_this_training(self, training: str, run: Run) -> bool:
        """Whether a fingerprint is of this training, perhaps from before some setting was added."""
        if training == self.training_fingerprint(run):
            return True
        if run.pictures is not None:
            return False
        folders = [self.out / run.folder, *sorted((self.out / run.group).glob("seed_*"))]
        written = (_written_config(folder) for folder in dict.fromkeys(folders))
        return any(
            training == self._fingerprint(config, run) and _completed(config) == _shared(self._config(run))
            for config in written
            if config is not None
        )

    def _digest(self, path: Path) -> str:
        """Of a file when this was first called; "" if it is missing, which its training will report."""
        if path not in self._points:
            self._points[path] = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        return self._points[path]

    def _digest_of(self, pictures: Path) -> str:
        """As ``_digest``, for a folder."""
        if pictures not in self._points:
            self._points[pictures] = pictures_digest(pictures, self.plan.kind)
        return self._points[pictures]

    @property
    def evaluation_fingerprint(self) -> str:
        return fingerprint(["evaluation", self.weights])

    def data_folder(self, scene: SceneFolder) -> Path:
        """As ``data_folder``, for this plan."""
        return data_folder(self.out, self.plan, scene)

    # -- what exists -------------------------------------------------------------------------------------

    def record(self, run: Run, folder: Path | None = None) -> Record | None:
        """The record of a run that is done, for whichever plan; in ``folder`` if not None."""
        return _read(Record, (folder or self.out / run.folder) / RUN_FILE)

    def gaussians(self, run: Run) -> int | None:
        """Of a run that is done; None for a method without Gaussians, or if unknown."""
        record = self.record(run)
        if record is None or (run.pictures is None and not has_gaussians(self._config(run))):
            return None
        return record.gaussians

    def failure(self, run: Run) -> Failure | None:
        """How it failed, if what failed is what would be run now."""
        failure = _read(Failure, self.out / run.folder / FAILED_FILE)
        if failure is None or failure.evaluation != self.evaluation_fingerprint:
            return None
        return failure if self._is_this_training(failure.training, run) else None

    def evaluation(self, run: Run) -> dict[str, Any] | None:
        """What ``physhdr evaluate`` wrote about it; None if that is missing, damaged or of other views."""
        try:
            evaluation = load_evaluation(self.out / run.folder)
        except (FileMissingError, FileDamagedError):
            return None
        # Somebody may have evaluated the run by hand, on other views.
        return evaluation if evaluation["conditions"].get("split") == self.plan.split else None

    def search(self, run: Run) -> Search | None:
        """The search for the budget of ``run``, if it was done for the same method, data and threads."""
        found = _read(Search, self.out / run.group / SEARCH_FILE)
        wanted = (self.plan.threads_per_job, self.plan.device)
        if found is None or (found.threads, found.device) != wanted:
            return None
        return found if self._is_this_training(found.training, run) else None

    def iterations(self, run: Run) -> int | None:
        """How many the run must have; None if they have to be found first."""
        if run.budget.kind != CPU_SECONDS:
            return int(run.budget.amount)
        search = self.search(run)
        return search.iterations if search else None

    def is_trained(self, run: Run, folder: Path | None = None) -> bool:
        """Whether its training exists (in ``folder`` if not None) as it would be done now."""
        record = self.record(run, folder)
        if record is None or not self._is_this_training(record.training, run):
            return False
        return run.pictures is not None or record.iterations == self.iterations(run)

    def state(self, run: Run) -> State:
        """``evaluate``: trained, but not evaluated as it would be now. ``absent``: without pictures."""
        if run.pictures is not None and not run.pictures.is_dir():
            return "absent"
        if self.failure(run):
            return "failed"
        record = self.record(run)
        if record is None or not self.is_trained(run):
            return "todo"
        if record.evaluation != self.evaluation_fingerprint or self.evaluation(run) is None:
            return "evaluate"
        return "done"

    def changes(self, run: Run) -> list[str]:
        """Why an existing run has to be done again; [] if there is none, or nothing changed."""
        record = self.record(run)
        if record is None or (run.pictures and not run.pictures.is_dir()) or self.is_trained(run):
            return []
        if run.pictures is not None:
            return ["its pictures, their costs or the data set"]
        config = _written_config(self.out / run.folder)
        if config is None:
            return ["its configuration is missing"]
        iterations = self.iterations(run)
        wanted = self.config(run, iterations or record.iterations or 0)
        found = differences(_completed(config) or _shared(config), _shared(wanted))
        if not found and not self._is_this_training(record.training, run):
            found = ["the data set" if wanted.get(POINTS_SETTING) is None else "the data set or its points"]
        return found or ["the search for its iterations"]


def data_folder(out: Path, plan: Plan, scene: SceneFolder) -> Path:
    """The folder of a data set for runs and reports: for a plan that tunes, one without test views, which is
    made in ``out``. Raises ``OutputError`` if it cannot be.
    """
    if plan.kind != TUNE:
        return scene.data
    return link_without_test(scene.data, out / TUNE / WITHOUT_TEST / scene.name)


# ---- files -----------------------------------------------------------------------------------------------


def write_json(path: Path, content: Record | Search | Failure) -> None:
    """Raises ``OutputError``."""
    with atomic_path(path) as temporary:
        text = json.dumps(
            {"format": "physhdr-benchmark", "version": 1} | dataclasses.asdict(content), indent=1
        )
        temporary.write_text(text + "\n", encoding="utf-8")


def put_in_place(work: Path, final: Path) -> None:
    """Let a finished working folder become ``final``, and remove what was there.

    Raises ``OutputError`` if it cannot, as on Windows while a console is in ``final`` or a file in it is
    open; ``work`` and ``final`` are then as before.
    """
    old = work.with_name(f"{work.name}{REPLACED}")
    try:
        try:
            _replace(final, work, old)
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                raise
            _replace(final, work, old)  # which another command put there, where nothing can be locked
    except OSError as error:
        raise OutputError(
            f"cannot put the result into {final}: {error.strerror or error}",
            "Close every program and console that uses that folder, and repeat the command.",
        ) from error
    shutil.rmtree(old, ignore_errors=True)


def _replace(final: Path, work: Path, old: Path) -> None:
    """``work`` becomes ``final``, and ``final`` ``old``; undone if that fails. Raises ``OSError``."""
    if final.exists():
        patiently(partial(os.rename, final, old))
    try:
        patiently(partial(os.rename, work, final))
    except OSError:
        if final.exists():
            shutil.rmtree(old, ignore_errors=True)
        elif old.exists():
            patiently(partial(os.rename, old, final))
        raise


def holds_training(work: Path) -> bool:
    """Whether a working folder has a training that has ended: its record is written only then."""
    whole = (work / RUN_FILE).is_file() and (work / CONFIG_FILE).is_file()
    return whole and not work.name.endswith(REPLACED)


def _read(cls: type, path: Path) -> Any:
    """What ``write_json`` wrote; None if there is nothing, or nothing of this version."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if (content.pop("format"), content.pop("version")) != ("physhdr-benchmark", 1):
            return None
        return cls(**content)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _written_config(folder: Path) -> dict[str, Any] | None:
    """The configuration in a run's ``config.json``, as written; None if it has none."""
    try:
        config = json.loads((folder / CONFIG_FILE).read_text(encoding="utf-8"))["config"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return config if isinstance(config, dict) else None


def _shared(config: dict[str, Any]) -> dict[str, Any]:
    """What is the same in all runs of a method."""
    return {key: value for key, value in config.items() if key not in PER_RUN}


def _completed(config: dict[str, Any]) -> dict[str, Any] | None:
    """``_shared``, with defaults for settings added since; None if it is not a configuration."""
    try:
        return _shared(completed(config))
    except (ValueError, PhysHDRError):
        return None


# ---- fingerprints ----------------------------------------------------------------------------------------


def fingerprint(content: Any) -> str:
    """16 hexadecimal digits of a JSON value."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def data_fingerprint(root: Path, kind: str = REPORT) -> str:
    """Of every file that a training or an evaluation of a plan of this ``kind`` could read.

    Raises ``BadValueError`` if there are no files.
    """
    if kind == TUNE:
        tops = [root / name for name in names_without_test(root)]
        files = [path for top in tops for path in (_files_below(top) if top.is_dir() else [top])]
    else:
        files = _files_below(root)
    digests = []
    for path in sorted(files):
        parts = path.relative_to(root).parts
        if parts[0] == UNREAD or any(part.startswith(".") for part in parts) or not path.is_file():
            continue
        digests.append(["/".join(parts), hashlib.sha256(path.read_bytes()).hexdigest()])
    if not digests:
        raise BadValueError(f"{root} holds no files", "Name the folder of a data set.")
    return fingerprint(digests)


def _files_below(top: Path) -> Iterator[Path]:
    """All files in ``top`` and below it, also through links to folders, because readers follow them.

    A link to a folder that contains it is not followed: that would never end.
    """
    for place, folders, names in os.walk(top, followlinks=True):
        here = Path(place)
        around = [resolved(each) for each in (here, *here.parents)[: len(here.relative_to(top).parts) + 1]]
        real = {name: resolved(here / name) for name in folders if not name.startswith(".")}
        folders[:] = [name for name in real if not any(each.is_relative_to(real[name]) for each in around)]
        yield from (here / name for name in names)


def differences(old: Any, new: Any, name: str = "") -> list[str]:
    """``backbone.budget 60000 → 30000`` for each value that is not the same in two configurations."""
    if isinstance(old, dict) and isinstance(new, dict):
        found = []
        for key in dict.fromkeys([*old, *new]):
            inside = f"{name}.{key}" if name else key
            found += differences(old.get(key), new.get(key), inside)
        return found
    return [] if old == new else [f"{name} {old} → {new}"]
