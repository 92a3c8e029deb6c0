# SPDX-License-Identifier: GPL-3.0-or-later
"""What a benchmark runs: ``plan.toml``, or the same from flags; stored in the benchmark's folder.

kind = "report"                                           # or "tune": choices are made on validation views
methods = ["default", "baseline", "dim := default backbone.threshold=4e-4"]
scenes = ["../data/demo", "night=../data/bathroom"]      # beside the file, or absolute
settings = ["exp3", "exp1"]
seeds = [0, 1, 2]
budgets = ["iterations=1000", "cpu-seconds=60"]
set = ["downscale=2"]                                     # for every method
margins_of = ["default"]                                  # methods whose lead over the others is reported
note = "What the figures do not show."                    # stands at the top of the report
open_sealed = true                                        # a report may include sealed scenes (roles.py)
[[ladder]]
name = "ablation"
steps = ["baseline", "dim", "default"]
[[external]]                                              # a method of which there are only pictures
name = "theirs"
folder = "../results/theirs/{scene}/{setting}/seed_{seed}"  # of each run; {budget}, too
"""

import json
import math
import os
import re
import shlex
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...backend.shell import option
from ...bridge import data_set
from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ...bridge.limits import THREADS_MAX, whole
from ...bridge.regular import read_text, resolved

PLAN_FILE = "plan.toml"
SETTINGS = ("exp1", "exp3")
#: What a plan is for: choices, measured on validation views, or a report, on test views.
TUNE, REPORT = "tune", "report"
KINDS = (TUNE, REPORT)
ITERATIONS, CPU_SECONDS = "iterations", "cpu-seconds"
#: What identifies a run in the name of an external method's folder; a budget by the name of its own folder.
PLACEHOLDERS = ("scene", "setting", "seed", "budget")
#: Names become folders, on any system: Windows drops a last dot, and has devices of these names.
NAME = re.compile(r"[A-Za-z0-9†+_](?:[A-Za-z0-9†+_.-]*[A-Za-z0-9†+_-])?")
DEVICE = re.compile(r"(?:con|prn|aux|nul|(?:com|lpt)[0-9])(?:\..*)?", re.IGNORECASE)
#: Settings that the benchmark itself sets for each run.
OURS = ("iterations", "seed", "exposure_mode")
#: Settings of how pictures are read; also options of ``physhdr evaluate``.
OF_PICTURES = ("downscale", "color_space")


@dataclass(frozen=True)
class Method:
    """A preset under a name, with settings on top (``NAME=VALUE``); or another program's pictures.

    ``pictures``: the folder of each run's, with ``PLACEHOLDERS`` in its name; empty if we train it.
    """

    name: str
    preset: str
    assignments: tuple[str, ...] = ()
    pictures: str = ""

    @classmethod
    def parsed(cls, text: str) -> "Method":
        """``default``, or ``NAME := PRESET setting=value``."""
        name, defines, rest = text.partition(":=")
        name = _name(name.strip(), "method")
        try:
            preset, *assignments = _words(rest) if defines else [name]
        except ValueError as error:
            raise BadValueError(
                f"the method '{text}' cannot be read: {error}",
                "For example: dim := default backbone.stop=0.3",
            ) from error
        for word in assignments:
            _require_assignment(word, f"the method '{name}' sets {word}")
        return cls(name, preset, tuple(assignments))

    @classmethod
    def external(cls, content: Any, beside: Path) -> "Method":
        """``{"name": …, "folder": …}`` of a plan file; a relative folder lies in ``beside``."""
        match content:
            case {"name": str(name), "folder": str(folder), **rest} if not rest and folder:
                pass
            case _:
                raise BadValueError(
                    f"an external method is a name and a folder, got {content!r:.200}",
                    'For example name = "theirs", folder = "results/theirs/{scene}/{setting}/seed_{seed}".',
                )
        for word in re.findall(r"\{(\w*)\}", folder):
            if word not in PLACEHOLDERS:
                raise BadValueError(
                    f"the folder of '{name}' has the unknown placeholder {{{word}}}",
                    f"Choose from {', '.join(f'{{{each}}}' for each in PLACEHOLDERS)}.",
                )
        return cls(_name(name, "method"), "", pictures=os.path.abspath(beside / os.path.expanduser(folder)))

    @property
    def place(self) -> Path | None:
        """The folder that contains all of an external method's; None for a method that we train."""
        return Path(os.path.dirname(self.pictures.partition("{")[0])) if self.pictures else None

    def pictures_of(self, values: Mapping[str, object]) -> Path:
        """The folder of an external method's run; ``values``: one for each of ``PLACEHOLDERS``."""
        folder = self.pictures
        for name in PLACEHOLDERS:
            folder = folder.replace(f"{{{name}}}", str(values[name]))
        return Path(folder)

    def __str__(self) -> str:
        if self.pictures or (not self.assignments and self.name == self.preset):
            return self.name
        return f"{self.name} := {shlex.join([self.preset, *self.assignments])}"


@dataclass(frozen=True)
class SceneFolder:
    """A data set under a name."""

    name: str
    data: Path

    @classmethod
    def parsed(cls, text: str, beside: Path) -> "SceneFolder":
        """``FOLDER`` or ``NAME=FOLDER``; a relative folder lies in ``beside``."""
        name, equals, folder = text.partition("=")
        if not equals or (beside / text).exists():
            name, folder = "", text
        data = resolved(beside / os.path.expanduser(folder))
        if not data.is_dir():
            raise FileMissingError(f"there is no data set {data}", "Name the folder of a data set.")
        return cls(_name(name or data.name, "scene"), data)

    def __str__(self) -> str:
        return f"{self.name}={self.data}"


@dataclass(frozen=True)
class Budget:
    """What every method may spend on a run: ``iterations``, or ``cpu-seconds`` of its training."""

    kind: str
    amount: float

    @classmethod
    def parsed(cls, text: str) -> "Budget":
        """``iterations=1000`` or ``cpu-seconds=60``."""
        kind, _, number = text.partition("=")
        remedy = f"For example {ITERATIONS}=1000 or {CPU_SECONDS}=60."
        try:
            amount = float(number)
        except ValueError:
            amount = math.nan
        if kind not in (ITERATIONS, CPU_SECONDS) or not (amount > 0 and math.isfinite(amount)):
            raise BadValueError(f"'{text}' is not a budget", remedy)
        if kind == ITERATIONS and amount != int(amount):
            raise BadValueError(f"'{text}': iterations are counted in whole numbers", remedy)
        return cls(kind, amount)

    @property
    def folder(self) -> str:
        return f"{self.kind}-{self.amount:.15g}"

    def __str__(self) -> str:
        return f"{self.kind}={self.amount:.15g}"


@dataclass(frozen=True)
class Ladder:
    """Methods of which each adds one thing to the one before."""

    name: str
    steps: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Everything that decides what is run and reported. Names are unique in each list, and no list is empty.

    ``assignments``: of ``--set``, for every method. ``note``: a paragraph in Markdown for the top of the
    report. ``kind``: ``tune``, which sees no test view, or ``report``. ``open_sealed``: whether a report may
    include sealed scenes.
    """

    methods: tuple[Method, ...]
    scenes: tuple[SceneFolder, ...]
    settings: tuple[str, ...] = ("exp3",)
    seeds: tuple[int, ...] = (0,)
    budgets: tuple[Budget, ...]
    assignments: tuple[str, ...] = ()
    threads_per_job: int = 1
    device: str = "auto"
    lpips_weights: Path | None = None
    margins_of: tuple[str, ...] = ()
    ladders: tuple[Ladder, ...] = ()
    note: str = ""
    kind: str = REPORT
    open_sealed: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise BadValueError(f"there is no kind of plan '{self.kind}'", f"Choose from {', '.join(KINDS)}.")
        names = [method.name for method in self.methods]
        _require_unique("method", names, "Name a variant: NAME := PRESET setting=value.")
        _require_unique("scene", [scene.name for scene in self.scenes], "Name one: NAME=FOLDER.")
        _require_unique("setting", self.settings, "Choose from exp1, exp3.")
        _require_unique("seed", self.seeds, "For example 0,1,2.")
        _require_unique("budget", [str(budget) for budget in self.budgets], "For example iterations=1000.")
        if unknown := [setting for setting in self.settings if setting not in SETTINGS]:
            raise BadValueError(f"there is no setting '{unknown[0]}'", "Choose from exp1, exp3.")
        whole("--threads-per-job", self.threads_per_job, 1, THREADS_MAX)
        _ = self.reading  # raises if a size is not a number
        steps = [step for ladder in self.ladders for step in ladder.steps]
        for name in [*self.margins_of, *steps]:
            if name not in names:
                raise BadValueError(f"the plan has no method '{name}'", f"Choose from: {', '.join(names)}.")
        for ladder in self.ladders:
            if len(ladder.steps) < 2:
                raise BadValueError(f"the ladder '{ladder.name}' has fewer than two steps")
        several = {"scene": self.scenes, "setting": self.settings, "seed": self.seeds}
        for method in self.methods:
            # Otherwise one result would count as several, and as several seeds without any spread.
            for word, values in several.items() if method.pictures else ():
                if len(values) > 1 and f"{{{word}}}" not in method.pictures:
                    raise BadValueError(
                        f"the plan has {len(values)} {word}s, the folder of '{method.name}' no {{{word}}}",
                        "Put it into the folder's name; the report lists folders that do not exist.",
                    )

    @property
    def trained(self) -> tuple[Method, ...]:
        """The methods that we train."""
        return tuple(method for method in self.methods if not method.pictures)

    @property
    def picture_options(self) -> tuple[str, ...]:
        """The options of ``physhdr evaluate --pictures`` with which it evaluates at the size of all runs."""
        values = self._values
        return tuple(word for name in OF_PICTURES if name in values for word in (option(name), values[name]))

    @property
    def reading(self) -> tuple[float | None, str | None]:
        """How every data set is read: ``downscale`` and ``color_space``; None: as its layout and files say.

        Raises ``BadValueError`` if the first is not a number.
        """
        downscale, color_space = (self._values.get(name, "none") for name in OF_PICTURES)
        try:
            smaller = None if downscale == "none" else float(downscale)
        except ValueError as error:
            raise BadValueError(
                f"--set downscale={downscale}: that is not a number", "downscale=2"
            ) from error
        return smaller, None if color_space == "none" else color_space

    @property
    def _values(self) -> dict[str, str]:
        """What is assigned for every method, as written, by setting."""
        return {setting_in(text): text.partition("=")[2].strip() for text in self.assignments}

    @property
    def split(self) -> str:
        """The views that runs are evaluated on."""
        return data_set.VALIDATION if self.kind == TUNE else data_set.TEST

    def settings_of(self, method: Method) -> tuple[str, ...]:
        """``NAME=VALUE`` of a method, the same for every run."""
        return (*self.assignments, *method.assignments)

    def training_options(self, method: Method) -> tuple[str, ...]:
        """The options of ``physhdr train`` for a method, the same for every run."""
        settings = self.settings_of(method)
        return ("--preset", method.preset, *(word for each in settings for word in ("--set", each)))


def setting_in(assignment: str) -> str:
    """The name in ``NAME=VALUE``."""
    return assignment.partition("=")[0].strip()


def _require_assignment(text: str, what: str) -> None:
    """Raises ``BadValueError``, which begins with ``what``, unless it is ``NAME=VALUE`` of a method."""
    if "=" not in text or not setting_in(text) or setting_in(text) in OURS:
        raise BadValueError(
            what, f"It takes NAME=VALUE, such as downscale=2; the plan itself says {', '.join(OURS)}."
        )


def _assignment(text: str) -> str:
    """``NAME=VALUE`` for every method; quotes hold a value with spaces together.

    Raises ``BadValueError`` as ``_require_assignment`` does, and for an unclosed quote.
    """
    _require_assignment(text, f"--set {text} cannot be used")
    try:
        return " ".join(_words(text))
    except ValueError as error:
        raise BadValueError(
            f"--set {text} cannot be read: {error}", "Close the quotes, or put others around them."
        ) from error


def _words(text: str) -> list[str]:
    """As a shell splits them, quotes included, except # and \\, which a path may contain.

    It reads what ``shlex.join`` wrote, which only quotes. Raises ``ValueError`` for an unclosed quote.
    """
    words = shlex.shlex(text, posix=True, punctuation_chars=False)
    words.whitespace_split, words.commenters, words.escape = True, "", ""
    return list(words)


# ---- from flags and files ------------------------------------------------------------------------------

#: What each key of plan.toml becomes: the field of ``Plan`` and how its value is read.
_KEYS: dict[str, tuple[str, Callable[[Any, Path], Any]]] = {
    "kind": ("kind", lambda value, _: str(value)),
    "methods": ("methods", lambda value, _: tuple(Method.parsed(text) for text in _texts(value))),
    "scenes": ("scenes", lambda value, at: tuple(SceneFolder.parsed(text, at) for text in _texts(value))),
    "settings": ("settings", lambda value, _: tuple(_texts(value))),
    "seeds": ("seeds", lambda value, _: tuple(_whole(each) for each in value)),
    "budgets": ("budgets", lambda value, _: tuple(Budget.parsed(text) for text in _texts(value))),
    "set": ("assignments", lambda value, _: tuple(map(_assignment, _texts(value)))),
    "threads_per_job": ("threads_per_job", lambda value, _: _whole(value)),
    "device": ("device", lambda value, _: str(value)),
    "lpips_weights": ("lpips_weights", lambda value, at: at / str(value)),
    "margins_of": ("margins_of", lambda value, _: tuple(_texts(value))),
    "note": ("note", lambda value, _: str(value)),
    "open_sealed": ("open_sealed", lambda value, _: _yes_or_no(value)),
    "external": ("external", lambda value, at: tuple(Method.external(each, at) for each in value)),
    "ladder": ("ladders", lambda value, _: tuple(Ladder(str(x["name"]), tuple(x["steps"])) for x in value)),
}


def make_plan(content: dict[str, Any], beside: Path) -> Plan:
    """A plan from the keys of ``plan.toml``. Relative folders lie in ``beside``.

    Raises ``BadValueError`` for what is unknown, missing or double, ``FileMissingError`` for a data set.
    """
    fields = {}
    for key, value in content.items():
        if key not in _KEYS:
            raise BadValueError(f"a plan has no '{key}'", f"Choose from: {', '.join(_KEYS)}.")
        field, read = _KEYS[key]
        try:
            fields[field] = read(value, beside)
        except (TypeError, KeyError, ValueError) as error:
            raise BadValueError(
                f"the plan's '{key}' cannot be read: {value!r:.200}", "See plan.py."
            ) from error
    fields["methods"] = (*fields.get("methods", ()), *fields.pop("external", ()))
    for key in ("methods", "scenes", "budgets"):
        if not fields.get(key):
            raise BadValueError(f"the plan names no {key}", f"Give --{key.replace('budgets', 'budget')}.")
    return Plan(**fields)


def read_plan(path: Path) -> dict[str, Any]:
    """The keys of a plan file, its folders and files made absolute."""
    remedy = "Write it as TOML, or delete it."
    if not path.exists():
        raise FileMissingError(f"there is no plan {path}", "Give --methods, --scenes, --budget.")
    try:
        content = tomllib.loads(read_text(path, remedy))
    except (ValueError, RecursionError) as error:
        raise FileDamagedError(f"{path} is not a plan: {error!s:.200}", remedy) from error
    at = resolved(path.parent)
    if isinstance(content.get("scenes"), list):
        content["scenes"] = [str(SceneFolder.parsed(str(text), at)) for text in content["scenes"]]
    if isinstance(content.get("external"), list):
        each = [Method.external(one, at) for one in content["external"]]
        content["external"] = [{"name": one.name, "folder": one.pictures} for one in each]
    if content.get("lpips_weights"):
        content["lpips_weights"] = str(at / str(content["lpips_weights"]))
    return content


def write_plan(plan: Plan, path: Path) -> None:
    """``plan.toml`` from which ``read_plan`` and ``make_plan`` make the same plan; raises ``OutputError``."""
    rows: dict[str, Any] = {
        "kind": plan.kind,
        "methods": [str(method) for method in plan.trained],
        "scenes": [str(scene) for scene in plan.scenes],
        "settings": list(plan.settings),
        "seeds": list(plan.seeds),
        "budgets": [str(budget) for budget in plan.budgets],
        "set": list(plan.assignments),
        "threads_per_job": plan.threads_per_job,
        "device": plan.device,
    }
    if plan.lpips_weights:
        rows["lpips_weights"] = str(plan.lpips_weights)
    if plan.margins_of:
        rows["margins_of"] = list(plan.margins_of)
    if plan.note:
        rows["note"] = plan.note
    if plan.open_sealed:
        rows["open_sealed"] = True
    # A string, a number, true or a list of them is the same in JSON and in TOML.
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in rows.items()]
    for ladder in plan.ladders:
        lines += ["", "[[ladder]]", f"name = {json.dumps(ladder.name, ensure_ascii=False)}"]
        lines += [f"steps = {json.dumps(list(ladder.steps), ensure_ascii=False)}"]
    for method in plan.methods:
        if method.pictures:
            lines += ["", "[[external]]", f"name = {json.dumps(method.name, ensure_ascii=False)}"]
            lines += [f"folder = {json.dumps(method.pictures, ensure_ascii=False)}"]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _texts(value: Any) -> list[str]:
    if isinstance(value, str) or not all(isinstance(text, str) for text in value):
        raise TypeError("expected a list of texts")
    return list(value)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise TypeError("expected a whole number")
    return value


def _yes_or_no(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError("expected true or false")
    return value


def _name(text: str, what: str) -> str:
    if not NAME.fullmatch(text):
        raise BadValueError(
            f"'{text}' cannot be the name of a {what}",
            "It names a folder: use letters, digits and . _ + -, with no dot at either end.",
        )
    if DEVICE.fullmatch(text):
        raise BadValueError(
            f"'{text}' cannot be the name of a {what}: it names a folder, and on Windows it is a device",
            "Choose another name.",
        )
    return text


def _require_unique(what: str, names: Iterable[object], remedy: str) -> None:
    texts = [str(name) for name in names]
    if not texts:
        raise BadValueError(f"the plan has no {what}", remedy)
    # Names become folders, and on Windows and macOS names that differ only in case are the same folder.
    folder, count = Counter(text.casefold() for text in texts).most_common(1)[0]
    alike = list(dict.fromkeys(text for text in texts if text.casefold() == folder))
    if len(alike) > 1:
        both = "' and '".join(alike)
        raise BadValueError(f"the plan's {what}s '{both}' differ only in case, and names are folders", remedy)
    if count > 1:
        raise BadValueError(f"the plan has the {what} '{alike[0]}' {count} times", remedy)
