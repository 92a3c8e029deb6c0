# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark's report in Markdown, and every run as a line of CSV."""

import csv
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...backend.evaluate.comparison import NONE, SCALE, ComparedRun, column, comparison_table
from ...bridge.atomic import atomic_path
from ...bridge.regular import resolved
from ...bridge.words import counted
from .facts import machine_lines, scene_facts, scene_line
from .margins import CONFIDENCE, JUDGED, Margin, margin
from .plan import CPU_SECONDS, ITERATIONS, TUNE, Budget, Ladder, Plan
from .roles import role_lines, room_of
from .runs import Record, Run
from .schedule import Schedule
from .search import TOLERANCE

REPORT_FILE = "report.md"
#: Tables of the section Methods: by heading, their columns.
QUALITY = (
    *(f"{part}.{name}" for part in ("LDR-OE", "LDR-NE", "HDR") for name in ("psnr", "ssim")),
    *("HDR-aligned.psnr", *SCALE, "response"),
)
PERCEIVED = tuple(f"{part}.{name}" for part in ("LDR-OE", "LDR-NE", "HDR") for name in ("lpips", "lpips_01"))
RELIGHTING = ("relit.psnr", "relit.gain")
COSTS = ("cost.cpu_seconds", "cost.seconds", "cost.iterations", "cost.gaussians", "cost.memory_MB")
TABLES = {"": QUALITY, "LPIPS": PERCEIVED, "Relighting": RELIGHTING, "Cost": COSTS}
#: What is repeated for each scene, and for each length of training if a plan has several.
MOST = (
    *("LDR-OE.psnr", "LDR-NE.psnr", "HDR.psnr", "HDR-aligned.psnr", "LDR-OE.lpips"),
    *(*SCALE, "response", "relit.psnr"),
)
SCENE_METRICS = (*MOST, "cost.cpu_seconds", "cost.iterations", "cost.gaussians")
OF_LENGTH = (*MOST, "cost.cpu_seconds", "cost.gaussians")
#: What a row of the CSV has beside what names the run.
CSV_METRICS = (
    *(f"{part}.{name}" for part in ("LDR-OE", "LDR-NE", "HDR", "HDR-aligned") for name in ("psnr", "ssim")),
    *(f"{part}.{name}" for part in ("LDR-OE", "LDR-NE", "HDR") for name in ("lpips", "lpips_01")),
    *("scale", "response", "relit.psnr", "relit.gain"),
)
LOG_LINES = 6
#: Where the code is.
PACKAGE = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Finished:
    """A run that is done, and what tables use of it. ``gaussians``: None for a method without, or unknown."""

    run: Run
    record: Record
    entry: ComparedRun
    gaussians: int | None


def finished_runs(schedule: Schedule) -> list[Finished]:
    """Every run that is done, in the plan's order: methods, then scenes, then seeds."""
    plan = schedule.store.plan
    rooms = {scene: room_of(scene.data) for scene in plan.scenes}
    found = []
    for run in schedule.runs:
        record = schedule.store.record(run)
        evaluation = schedule.store.evaluation(run)
        if schedule.status[run].kind != "done" or record is None or evaluation is None:
            continue
        gaussians = schedule.store.gaussians(run)
        costs = {
            "cpu_seconds": record.cpu_seconds,
            "seconds": record.seconds,
            "iterations": record.iterations,
            "gaussians": gaussians,
        }
        cost = {name: float(value) for name, value in costs.items() if value is not None}
        if record.peak_memory:
            cost["memory_MB"] = record.peak_memory / 1e6
        names = run.method.name, run.scene.name, run.setting, run.seed
        entry = ComparedRun(*names, evaluation, cost, shows=rooms[run.scene])
        found.append(Finished(run, record, entry, gaussians))
    return sorted(
        found, key=lambda each: (plan.methods.index(each.run.method), plan.scenes.index(each.run.scene))
    )


def write_report(schedule: Schedule, path: Path, command: str) -> list[Path]:
    """Write the report and, beside it, the CSV of all runs; returns both paths. Raises ``OutputError``."""
    finished = finished_runs(schedule)
    table = path.with_suffix(".csv")
    for file, text in (
        (path, to_markdown(schedule, finished, command, table.name)),
        (table, without_places(to_csv(finished), schedule)),
    ):
        with atomic_path(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [path, table]


def holds_runs(path: Path) -> bool:
    """Whether a report exists that has any run, by the CSV beside it."""
    table = path.with_suffix(".csv")
    return path.is_file() and table.is_file() and len(table.read_bytes().splitlines()) > 1


def to_csv(finished: Sequence[Finished]) -> str:
    """One line a run, in full precision; empty where something was not measured."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    columns = [column(key) for key in CSV_METRICS]
    names = ["budget", "setting", "scene", "method", "preset", "options", "seed", "split", *CSV_METRICS]
    names += ["cpu_seconds", "seconds", "iterations", "gaussians", "peak_memory", "threads", "host", "code"]
    writer.writerow(names)
    for each in finished:
        run, record = each.run, each.record
        line: list[object] = [run.budget, run.setting, run.scene.name, run.method.name, run.method.preset]
        line += [" ".join(run.method.assignments), run.seed, each.entry.evaluation["conditions"]["split"]]
        line += ["" if (value := one.value(each.entry)) is None else value for one in columns]
        costs = [record.cpu_seconds, record.seconds, record.iterations, each.gaussians]
        line += ["" if value is None else value for value in costs]
        threads = "" if run.pictures else record.threads
        line += [record.peak_memory or "", threads, record.machine.get("host", "")]
        line += [record.machine.get("versions", {}).get("physhdr", "")]
        writer.writerow(line)
    return stream.getvalue()


def to_markdown(schedule: Schedule, finished: Sequence[Finished], command: str, csv_name: str) -> str:
    """The whole report, without the machine's paths. ``command``: makes it again."""
    plan = schedule.store.plan
    title = "# Benchmark for tuning: validation views" if plan.kind == TUNE else "# Benchmark"
    parts = [title, _opening(schedule, finished, command, csv_name)]
    parts += ["## Conditions", _listed(_conditions(schedule, finished))]
    groups = [(budget, setting) for budget in plan.budgets for setting in plan.settings]
    sections: list[tuple[str, Callable[[Schedule, list[ComparedRun]], str]]] = [
        ("Methods", lambda _, entries: _tables(entries)),
        *([("Margins", _margins)] if len(plan.methods) > 1 else []),
        *((f"Ladder: {ladder.name}", _ladder_section(ladder)) for ladder in plan.ladders),
        (
            "Scenes",
            lambda _, entries: comparison_table(entries, metrics=SCENE_METRICS, group=["scene"]).markdown(),
        ),
    ]
    for title, section in sections:
        parts.append(f"## {title}")
        if title == "Margins":
            parts.append(_what_margins_are(_leaders(schedule)))
        for budget, setting in groups:
            chosen = [each for each in finished if (each.run.budget, each.run.setting) == (budget, setting)]
            parts.append(f"### {_in_words(budget)}, {setting}")
            missing = _missing(schedule, budget, setting)
            if missing:
                parts.append(missing)
            if chosen:
                parts.append(section(schedule, [each.entry for each in chosen]).rstrip())
    parts += _lengths(plan, finished)
    if failures := _failures(schedule):
        parts += ["## Runs without a result", failures]
    return without_places("\n\n".join(parts) + "\n", schedule)


def without_places(text: str, schedule: Schedule) -> str:
    """``text`` in which no path shows where on a machine things were, because a report is read elsewhere.

    A data set becomes its name in the plan, the benchmark's folder ``OUT``, the checkout ``physhdr``,
    the user's folder ``~``: in evaluations' messages, logs of runs that failed, options that name a file.
    """
    names = {scene.data: scene.name for scene in schedule.store.plan.scenes}
    names |= {schedule.store.data_folder(scene): scene.name for scene in schedule.store.plan.scenes}
    names |= {resolved(schedule.store.out): "OUT", schedule.store.out.absolute(): "OUT", PACKAGE: "physhdr"}
    names |= {method.place: method.place.name for method in schedule.store.plan.methods if method.place}
    names |= {Path.home(): "~"}
    for place in sorted(names, key=lambda each: len(str(each)), reverse=True):  # the innermost first
        if place != Path(place.anchor):
            text = re.sub(rf"(?<![\w./\\-]){re.escape(str(place))}(?![\w-])", names[place], text)
    return text


# ---- conditions ------------------------------------------------------------------------------------------


def _opening(schedule: Schedule, finished: Sequence[Finished], command: str, csv_name: str) -> str:
    plan, total = schedule.store.plan, len(schedule.runs)
    progress = (
        f"{len(finished)} of {total} runs are done."
        if len(finished) < total
        else f"All {total} runs are done."
    )
    factors = [
        counted(len(plan.methods), "method"),
        counted(len(plan.scenes), "scene"),
        counted(len(plan.settings), "setting"),
        counted(len(plan.seeds), "seed"),
        counted(len(plan.budgets), "budget"),
    ]
    note = f"{plan.note.strip()}\n\n" if plan.note.strip() else ""
    return (
        f"{note}Written by `{command}`; do not edit. {progress} Every run is in [{csv_name}]({csv_name}).\n\n"
        f"{' × '.join(factors)}."
    )


def _conditions(schedule: Schedule, finished: Sequence[Finished]) -> list[str]:
    plan = schedule.store.plan
    lines = [
        "kind tune: every figure is of validation views; no test view was opened"
        if plan.kind == TUNE
        else "kind report: every figure is of test views"
    ]
    lines += machine_lines(each.record for each in finished)
    for budget in plan.budgets:
        if budget.kind != CPU_SECONDS:
            lines.append(f"budget {_in_words(budget)}: `--iterations {budget.amount:.15g}` for every method")
            continue
        lines.append(
            f"budget {_in_words(budget)}: user and system time of the training, first points included. The "
            "iterations that fit come from the cost of whole runs of the method on the scene with the "
            "first seed (a "
            f"secant step where they miss it by more than {TOLERANCE:.0%}), never from quality; trials count "
            "for nothing else. The other seeds train as many iterations"
        )
        lines += _misses(budget, finished)
    lines.append(
        "CPU seconds are of the training alone, first points included, without evaluation, start, compiling "
        "and the pictures that show progress; seconds are on the clock, those pictures included"
    )
    if plan.assignments:
        lines.append(f"for every method: `{' '.join(plan.assignments)}`")
    lines += [f"method {method.name}: `{method}`" for method in plan.methods if str(method) != method.name]
    lines += [
        f"method {method.name}: another program's pictures, evaluated here; it was bound by no budget, "
        "and its cost is what its own files report"
        for method in plan.methods
        if method.pictures
    ]
    for scene in plan.scenes:
        folder = schedule.store.data_folder(scene)
        data = schedule.store.data[scene.name]
        facts = scene_facts(schedule.store.out, scene.name, folder, data, *plan.reading)
        lines.append(f"scene {scene_line(scene.name, facts)}")
    wanted = schedule.store.evaluation_fingerprint
    if others := sum(each.record.evaluation != wanted for each in finished):
        lines.append(f"{others} of {len(finished)} runs were evaluated with other LPIPS weights, or without")
    return [*lines, *role_lines(plan), *_messages(finished)]


def _messages(finished: Sequence[Finished]) -> list[str]:
    """What evaluations report beside numbers: what they omit, what a method saw that others may not see."""
    methods: dict[str, list[str]] = {}
    for each in finished:
        for message in each.entry.evaluation.get("messages", []):
            methods.setdefault(message, []).append(each.run.method.name)
    everybody = {each.run.method.name for each in finished}
    return [
        message if set(names) == everybody else f"{', '.join(dict.fromkeys(names))}: {message}"
        for message, names in methods.items()
    ]


def _misses(budget: Budget, finished: Sequence[Finished]) -> list[str]:
    """Which runs missed the budget, and by how much."""
    lines = []
    chosen = [each for each in finished if each.run.budget == budget]
    for name in dict.fromkeys(each.run.method.name for each in chosen):
        runs = [each for each in chosen if each.run.method.name == name]
        notes = {f"{each.run.scene.name}, {each.run.setting}": each.record.note for each in runs}
        for where, note in notes.items():
            if note:
                lines.append(f"{name} on {where} is {note}")
        shares = [each.record.cpu_seconds / budget.amount for each in runs if each.record.cpu_seconds]
        if max((abs(share - 1.0) for share in shares), default=0.0) > TOLERANCE:
            lines.append(
                f"{name} took {min(shares):.0%} to {max(shares):.0%} of the {budget.amount:.15g} CPU seconds"
            )
    return lines


# ---- margins and ladders -----------------------------------------------------------------------------------


def _leaders(schedule: Schedule) -> tuple[str, ...]:
    plan = schedule.store.plan
    return plan.margins_of or (plan.methods[0].name,)


def _tables(entries: list[ComparedRun]) -> str:
    """A table for each kind of figure that was measured; the notes stand below the first."""
    parts = []
    for title, metrics in TABLES.items():
        table = comparison_table(entries, metrics=metrics, title=title)
        if table.columns:
            parts.append((replace(table, notes=()) if parts else table).markdown().rstrip())
    return "\n\n".join(parts)


def _what_margins_are(leaders: Sequence[str]) -> str:
    return (
        f"{' and '.join(f'`{name}`' for name in leaders)} minus each other method, of runs on the same scene "
        "with the same seed (dB; of LPIPS less is better): the mean over scenes of the mean over seeds, in "
        f"brackets Student's interval of it ({CONFIDENCE:.0%}) by the scenes (of one scene by its seeds), "
        "and ± the standard deviation over the seeds of a scene. Several cameras in one room count as one "
        "scene. *Ahead* or *behind*: 0 is not in the interval; else *undecided*."
    )


def _margins(schedule: Schedule, entries: list[ComparedRun]) -> str:
    return "\n\n".join(_margins_of(leader, schedule, entries) for leader in _leaders(schedule))


def _margins_of(leader: str, schedule: Schedule, entries: list[ComparedRun]) -> str:
    plan = schedule.store.plan
    keys = [key for key in JUDGED if any(column(key).value(entry) is not None for entry in entries)]
    rivals = {
        name: {key: margin(entries, leader, name, key) for key in keys}
        for name in dict.fromkeys(entry.method for entry in entries)
        if name not in _leaders(schedule)
    }
    if not rivals:
        return f"`{leader}`: there is no other method that it could be ahead of."
    headings = [f"{leader} over", "pairs"]
    for key in keys:
        headings += [_part(key), "seeds", "standing"]
    rows = []
    for name, found in rivals.items():
        cells = [name, str(max(each.pairs if each else 0 for each in found.values()))]
        rows.append([*cells, *(cell for key, each in found.items() for cell in _margin_cells(key, each))])
    wanted = len(plan.scenes) * len(plan.seeds)
    lines = [*_of_which_rooms(entries), *(_verdict(key, rivals, wanted) for key in keys)]
    return "\n\n".join([_table(headings, rows), _listed(lines)])


def _of_which_rooms(entries: list[ComparedRun]) -> list[str]:
    """What intervals are over if several data sets are of one room."""
    scenes = {entry.scene for entry in entries}
    rooms = {entry.room for entry in entries}
    if len(rooms) == len(scenes):
        return []
    if len(rooms) > 1:
        return [f"{len(scenes)} data sets of {len(rooms)} rooms: means and intervals are over the rooms"]
    return [
        f"{len(scenes)} data sets of one room: the intervals are over these and say nothing about other rooms"
    ]


def _part(key: str) -> str:
    return column(key).heading.removesuffix(" PSNR")


def _verdict(key: str, rivals: dict[str, dict[str, Margin | None]], wanted: int) -> str:
    """Over which of ``rivals`` a method is ahead in a column, by its margins of ``wanted`` pairs each."""
    of_standing: dict[str, list[str]] = {"ahead": [], "undecided": [], "behind": [], "one run": []}
    missing = []
    for name, found in rivals.items():
        each = found[key]
        pairs = each.pairs if each else 0
        if pairs < wanted:
            missing.append(f"`{name}` ({pairs} of {wanted})")
        if each is not None:
            of_standing[each.standing].append(f"`{name}`")
    phrases = {
        "ahead": "ahead of",
        "undecided": "undecided against",
        "behind": "behind",
        "one run": "one run only, over",
    }
    parts = [f"{phrases[standing]} {', '.join(names)}" for standing, names in of_standing.items() if names]
    if missing:
        parts.append(f"pairs are missing: {', '.join(missing)}")
    return f"{_part(key)}: {'; '.join(parts)}"


def _margin_cells(key: str, each: Margin | None) -> list[str]:
    if each is None:
        return [NONE, NONE, NONE]
    digits = column(key).digits
    mean = f"{each.mean:+.{digits}f}"
    if each.interval is not None:
        mean += f" [{each.interval[0]:+.{digits}f}, {each.interval[1]:+.{digits}f}]"
    return [mean, NONE if each.spread is None else f"± {each.spread:.{digits}f}", each.standing]


def _lengths(plan: Plan, finished: Sequence[Finished]) -> list[str]:
    """Every method over the budgets of one kind, where the plan has three or more of it."""
    parts: list[str] = []
    for kind, name in ((ITERATIONS, "iterations"), (CPU_SECONDS, "CPU seconds")):
        budgets = sorted((each for each in plan.budgets if each.kind == kind), key=lambda each: each.amount)
        if len(budgets) < 3:
            continue
        parts.append(f"## Over {name}")
        for setting in plan.settings:
            parts.append(f"### {setting}")
            parts += [_over_budgets(key, budgets, setting, finished) for key in OF_LENGTH]
    return [part for part in parts if part]


def _over_budgets(key: str, budgets: Sequence[Budget], setting: str, finished: Sequence[Finished]) -> str:
    """A column of the tables, a row a method; empty where nothing was measured."""
    found: dict[str, list[list[ComparedRun]]] = {}
    for method in dict.fromkeys(each.run.method.name for each in finished):
        found[method] = [
            [
                each.entry
                for each in finished
                if (each.run.method.name, each.run.budget, each.run.setting) == (method, budget, setting)
            ]
            for budget in budgets
        ]
    most = max((len(runs) for row in found.values() for runs in row), default=0)
    rows = [[method, *(_mean_cell(runs, key, most) for runs in row)] for method, row in found.items()]
    if all(cell == NONE for row in rows for cell in row[1:]):
        return ""
    return _table([column(key).heading, *(f"{each.amount:,.15g}" for each in budgets)], rows)


def _ladder_section(ladder: Ladder) -> Callable[[Schedule, list[ComparedRun]], str]:
    def section(_: Schedule, entries: list[ComparedRun]) -> str:
        scenes = list(dict.fromkeys(entry.scene for entry in entries))
        parts = []
        if len(scenes) > 1:  # a step may gain on one kind of data and lose on another
            for scene in scenes:
                parts += [f"**{scene}**", _steps(ladder, [each for each in entries if each.scene == scene])]
            parts.append("**all scenes**")
        parts += [_steps(ladder, entries), "Gains: as the margins above, over the step before."]
        return "\n\n".join(parts)

    return section


def _steps(ladder: Ladder, entries: list[ComparedRun]) -> str:
    headings = ["step", "pairs"]
    keys = [key for key in JUDGED if any(column(key).value(entry) is not None for entry in entries)]
    for key in keys:
        headings += [column(key).heading, "gain", "seeds", "standing"]
    size = column("cost.gaussians")
    rows = []
    of_step = {step: [entry for entry in entries if entry.method == step] for step in ladder.steps}
    most = max(map(len, of_step.values()))
    for i, (step, runs) in enumerate(of_step.items()):
        cells, pairs = [], 0
        for key in keys:
            gain = margin(entries, step, ladder.steps[i - 1], key) if i else None
            pairs = max(pairs, gain.pairs if gain else 0)
            cells += [_mean_cell(runs, key, most), *_margin_cells(key, gain)]
        rows.append([step, str(pairs) if i else NONE, *cells, _mean_cell(runs, size.key, most)])
    return _table([*headings, size.heading], rows)


def _mean_cell(runs: list[ComparedRun], key: str, most: int) -> str:
    """The mean over the scenes of all data sets, with the number of runs if it is less than ``most``."""
    if not runs:
        return NONE
    table = comparison_table(runs, metrics=[key], group=("setting",), published=False, keep_empty=True)
    [cell] = table.rows[0].cells
    if cell.mean is None:
        return NONE
    partly = f" ({cell.runs} of {most} runs)" if cell.runs < most else ""
    return f"{column(key).text(cell.mean)}{partly}"


# ---- what is missing --------------------------------------------------------------------------------------


def _missing(schedule: Schedule, budget: Budget, setting: str) -> str:
    runs = [run for run in schedule.runs if (run.budget, run.setting) == (budget, setting)]
    counts: dict[str, int] = {}
    for run in runs:
        if schedule.status[run].kind != "done":
            counts[run.method.name] = counts.get(run.method.name, 0) + 1
    if not counts:
        return ""
    per_method = len(runs) // len(schedule.store.plan.methods)
    listed = ", ".join(f"{name} ({count} of {per_method})" for name, count in counts.items())
    return f"**Not complete.** Runs without a result: {listed}."


def _failures(schedule: Schedule) -> str:
    parts = []
    for run in schedule.runs:
        status = schedule.status[run]
        if status.kind in ("blocked", "absent"):
            parts.append(f"- `{run.folder}`: not run: {status.text}")
        elif status.kind == "failed":
            failure = schedule.store.failure(run)
            lines = failure.log[-LOG_LINES:] if failure else [status.text]
            stage = f"`physhdr {failure.stage}` ended with {failure.status}" if failure else "failed"
            log = "\n".join(f"  {line}" for line in lines)
            parts.append(f"- `{run.folder}`: {stage}\n\n  ```\n{log}\n  ```")
    return "\n".join(parts)


# ---- text --------------------------------------------------------------------------------------------------


def _in_words(budget: Budget) -> str:
    return f"{budget.amount:.15g} {'CPU seconds' if budget.kind == CPU_SECONDS else 'iterations'}"


def _listed(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    rule = "|".join([":---", *["---:"] * (len(headings) - 1)])
    lines = [f"| {' | '.join(headings)} |", f"|{rule}|", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines)
