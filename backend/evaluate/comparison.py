# SPDX-License-Identifier: GPL-3.0-or-later
"""Many evaluations side by side: methods × scenes × settings × seeds → one table, as Markdown, CSV or rich.

A number is first averaged over the seeds of a scene, then over scenes. Its spread is the sample standard
deviation, over the seeds, of the mean over scenes: how much another seed changes the printed number.
"""

import csv
import io
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ...bridge.limits import is_number
from ...bridge.regular import read_json_object
from ...bridge.run_folder import EVALUATION_FILE as EVALUATION_FILE
from ...bridge.words import counted
from .published import published_means
from .results import NOVEL_EXPOSURES

FORMAT, VERSION = "physhdr-evaluation", 1
#: An empty cell of a table: not measured.
NONE = "–"

Grouping = Literal["data_set", "setting", "scene"]


@dataclass(frozen=True)
class ComparedRun:
    """One evaluated run. ``setting``: exp1, exp3. ``evaluation``: what ``load_evaluation`` returns.

    ``cost``: by any names (``cpu_seconds``, ``iterations``, ``gaussians``), for the columns ``cost.NAME``.
    ``published``: a paper's number, shown in italics with ours and never ranked. ``shows``: an id of the
    room in the data set, shared by data sets of the same room; empty: it is the only one of its room.
    """

    method: str
    scene: str
    setting: str
    seed: int | None
    evaluation: dict[str, Any]
    cost: dict[str, float] = field(default_factory=dict)
    published: bool = False
    shows: str = ""

    @property
    def data_set(self) -> str:
        """The published benchmark that the scene belongs to, else ``""``."""
        return str(self.evaluation.get("conditions", {}).get("data_set") or "")

    @property
    def room(self) -> str:
        """The room in its data set: several data sets, for example with and without noise, may share one.

        For published benchmarks the scene's name, in any layout.
        """
        if self.data_set:
            return f"{self.data_set}: {str(self.evaluation['conditions'].get('scene') or self.scene).lower()}"
        return self.shows or self.scene

    @property
    def saw_novel_exposures(self) -> bool:
        """Whether its training, according to its evaluation, used exposures of LDR-NE."""
        match self.evaluation.get("conditions", {}):
            case {"training_exposures": [*places]}:
                return any(place in NOVEL_EXPOSURES for place in places)
        return False


def load_evaluation(path: Path | str) -> dict[str, Any]:
    """The content of an ``evaluation.json``; ``path``: the file or the folder of its run.

    Raises ``FileMissingError``, or ``FileDamagedError`` where it is not an evaluation of this version.
    """
    path = Path(path)
    path = path / EVALUATION_FILE if path.is_dir() else path
    remedy = "Run physhdr evaluate on the run again."
    if not path.exists():
        raise FileMissingError(f"there is no evaluation at {path}", "Run physhdr evaluate on the run first.")
    content = read_json_object(path, remedy)
    match content:
        case {"format": "physhdr-evaluation", "version": 1, "means": {**means}, "conditions": {}}:
            relit = content.get("relit_means") or {}
            parts = [*means.values(), relit, *(relit.values() if isinstance(relit, dict) else ())]
            if all(part is None or isinstance(part, dict) for part in parts):
                return content
    raise FileDamagedError(f"{path} is not a {FORMAT} of version {VERSION}", remedy)


# ---- columns -----------------------------------------------------------------------------------------

Better = Literal["higher", "lower", "neither"]

#: Parts of an evaluation by the name that a column uses.
PARTS = {"LDR-OE": "LDR-OE", "LDR-NE": "LDR-NE", "HDR": "HDR", "HDR-aligned": "HDR, scale aligned"}
#: Their metrics: heading, digits, which is better.
METRICS: dict[str, tuple[str, int, Better]] = {
    "psnr": ("PSNR", 2, "higher"),
    "ssim": ("SSIM", 4, "higher"),
    "lpips": ("LPIPS", 4, "lower"),
    "lpips_01": ("LPIPS 01", 4, "lower"),
}
#: The absolute scale of the radiance: its mean, in which errors may cancel, its error, and whether it is the
#: same for dark and bright.
SCALE = ("scale", "scale_error", "slope")
#: Default columns: the paper's, and whether the scale is right.
PAPER_METRICS = tuple(
    f"{part}.{metric}" for part in ("LDR-OE", "LDR-NE", "HDR") for metric in ("psnr", "ssim", "lpips_01")
)
DEFAULT_METRICS = (*PAPER_METRICS, *SCALE)
#: Columns that fit an 80-column terminal with spreads.
SHORT_METRICS = ("LDR-OE.psnr", "LDR-NE.psnr", "HDR.psnr", "scale")


@dataclass(frozen=True)
class Column:
    """A column: ``LDR-OE.psnr``, ``relit.psnr``, ``relit.gain``, ``cost.NAME``, ``response`` or of ``SCALE``.

    ``scale_error``: 100 · |ln scale|, per cent.
    """

    key: str
    heading: str
    digits: int | None
    better: Better

    def value(self, entry: ComparedRun) -> float | None:
        """The entry's number; None where it was not measured."""
        part, _, metric = self.key.partition(".")
        if self.key == "scale":
            value = entry.evaluation.get("scale_ratio")
        elif self.key == "scale_error":
            value = _percent_off(entry.evaluation.get("scale_ratio"))
        elif self.key == "slope":
            value = (entry.evaluation.get("linearity") or {}).get("slope")
        elif self.key == "response":
            value = (entry.evaluation.get("response") or {}).get("rms_error")
        elif part == "cost":
            value = entry.cost.get(metric)
        elif part == "relit":
            means = (entry.evaluation.get("relit_means") or {}).get("all") or {}
            value = means.get("ours" if metric == "psnr" else "gain_over_scaled_truth")
        else:
            value = (entry.evaluation["means"].get(PARTS[part]) or {}).get(metric)
        return float(value) if is_number(value) else None

    def text(self, value: float, mean: float | None = None) -> str:
        """The printed value; a spread has as many decimals as its ``mean``."""
        digits = self.digits
        if digits is None:
            size = abs(value if mean is None else mean)
            digits = 0 if size >= 100.0 else 1 if size >= 10.0 else 2
        return f"{value:,.{digits}f}"

    def merit(self, value: float) -> float:
        """Higher is better, equal where the printed numbers are equal."""
        shown = float(self.text(value).replace(",", ""))
        return {"higher": shown, "lower": -shown, "neither": 0.0}[self.better]


def _percent_off(scale: object) -> float | None:
    """Symmetric: half and twice as bright are equally far off; None for black or no scale."""
    return 100.0 * abs(math.log(scale)) if is_number(scale) and scale > 0.0 else None


def column(key: str) -> Column:
    """The column named ``key``; raises ``BadValueError`` listing the columns."""
    part, _, metric = key.partition(".")
    if part in PARTS and metric in METRICS:
        heading, digits, better = METRICS[metric]
        return Column(key, f"{part} {heading}", digits, better)
    if key == "scale":
        return Column(key, "HDR scale", 3, "neither")
    if key == "scale_error":
        return Column(key, "scale off by, %", 1, "lower")
    if key == "slope":
        return Column(key, "HDR slope", 3, "neither")
    if key == "response":
        return Column(key, "response error, 1/255", 2, "lower")
    if key == "relit.psnr":
        return Column(key, "relit PSNR", 2, "higher")
    if key == "relit.gain":
        return Column(key, "relit gain", 2, "higher")
    if part == "cost" and metric:
        return Column(key, metric.replace("_", " "), None, "neither")
    raise BadValueError(
        f"comparisons have no column '{key}'",
        f"Choose PART.METRIC, of {', '.join(PARTS)} and {', '.join(METRICS)}; "
        "scale, scale_error, slope, response, relit.psnr, relit.gain or cost.NAME.",
    )


# ---- cells, rows, the table ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """One number: mean and spread (None with fewer than two seeds); how many seeds and which scenes.

    ``seeds``: those common to all scenes. ``runs``: all pairs of scene and seed. ``rank``: 1 best of its
    block, 2 second, 0 neither or not ranked. ``partial``: what there is (``1 scene``, ``2 runs``) if scenes
    or seeds are missing that others in the block have, so that it cannot be compared; "" if complete.
    """

    mean: float | None
    spread: float | None = None
    seeds: int = 0
    scenes: tuple[str, ...] = ()
    runs: int = 0
    rank: int = 0
    partial: str = ""


@dataclass(frozen=True)
class Row:
    """``labels``: one for each of the table's label columns, the method last."""

    labels: tuple[str, ...]
    cells: tuple[Cell, ...]
    published: bool = False


@dataclass(frozen=True)
class Table:
    """A printable comparison. ``rows`` are sorted by block; ranks are within a block."""

    title: str
    label_headings: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]

    def markdown(self) -> str:
        """A GitHub table with its title above and its notes below: **best**, <u>second</u>, *published*."""
        headings = (*self.label_headings, *(each.heading for each in self.columns))
        rule = "|".join([":---"] * len(self.label_headings) + ["---:"] * len(self.columns))
        lines = [f"| {' | '.join(headings)} |", f"|{rule}|"]
        for row in self.rows:
            labels = [_escaped(label) for label in row.labels]
            if row.published:
                labels[-1] = f"*{labels[-1]}*"
            cells = [self._markdown_cell(i, cell, row.published) for i, cell in enumerate(row.cells)]
            lines.append(f"| {' | '.join([*labels, *cells])} |")
        head = [f"**{_escaped(self.title)}**"] if self.title else []
        return (
            "\n\n".join(
                [*head, "\n".join(lines), *(["\n".join(f"- {n}" for n in self.notes)] if self.notes else [])]
            )
            + "\n"
        )

    def csv(self) -> str:
        """One line per row, in full precision: each column's mean, spread, seeds and scenes."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        parts = ("", " spread", " seeds", " scenes")
        headings = [f"{each.key}{part}" for each in self.columns for part in parts]
        writer.writerow([*(name.lower() for name in self.label_headings), "published", *headings])
        for row in self.rows:
            line: list[object] = [*row.labels, int(row.published)]
            for cell in row.cells:
                line += ["" if cell.mean is None else cell.mean, "" if cell.spread is None else cell.spread]
                line += [cell.seeds, len(cell.scenes)]
            writer.writerow(line)
        return stream.getvalue()

    def rich(self) -> RichTable:
        """For ``rich.console.Console.print``: best bold, second underlined, published in italics."""
        table = RichTable(title=self.title or None, title_justify="left", box=box.SIMPLE_HEAD)
        table.caption = "\n".join(self.notes) or None
        table.caption_justify = "left"
        for heading in self.label_headings:
            table.add_column(heading)
        for each in self.columns:
            table.add_column(each.heading.replace(" ", "\n", 1), justify="right", no_wrap=True)
        for row in self.rows:
            cells = []
            for i, cell in enumerate(row.cells):
                mean, rest = self._texts(i, cell)
                style = ("", "bold", "underline")[cell.rank]
                cells.append(Text.assemble((mean, style), rest, style="italic" if row.published else ""))
            table.add_row(*row.labels, *cells)
        return table

    def _texts(self, i: int, cell: Cell) -> tuple[str, str]:
        """The mean, and what follows it."""
        if cell.mean is None:
            return NONE, ""
        each = self.columns[i]
        spread = "" if cell.spread is None else f" ± {each.text(cell.spread, cell.mean)}"
        return each.text(cell.mean), spread + (f" ({cell.partial})" if cell.partial else "")

    def _markdown_cell(self, i: int, cell: Cell, published: bool) -> str:
        mean, rest = self._texts(i, cell)
        mark = ("{}", "**{}**", "<u>{}</u>")[cell.rank]
        return f"*{mean}*{rest}" if published and cell.mean is not None else mark.format(mean) + rest


def comparison_table(
    entries: Iterable[ComparedRun],
    *,
    metrics: Sequence[str] = DEFAULT_METRICS,
    group: Sequence[Grouping] = ("data_set", "setting"),
    title: str = "",
    published: bool = True,
    keep_empty: bool = False,
) -> Table:
    """The table of ``entries``: a block for each value of ``group``, a row for each method in it.

    With ``"scene"`` in ``group`` there is one block per scene, else rows are means over scenes.
    ``published``: add the paper's numbers below ours for the same data set and scenes. Columns without any
    number are left out unless ``keep_empty``; a label column that is the same everywhere moves to the notes.
    If evaluations of one scene differ in picture size or split, a note says so and their block is not
    ranked. Methods, scenes and settings stay in the order of ``entries``. Raises ``BadValueError`` for no
    entries, two of the same run, an unknown metric, or mixed settings.
    """
    entries = list(entries)
    _require_comparable(entries, group)
    if published:
        entries += published_entries(entries)
    columns = [column(key) for key in metrics]
    if not keep_empty:
        columns = [each for each in columns if any(each.value(entry) is not None for entry in entries)]
    blocks: dict[tuple[str, ...], dict[tuple[str, bool], list[ComparedRun]]] = {}
    for entry in entries:
        key = tuple(str(getattr(entry, name)) for name in group)
        blocks.setdefault(key, {}).setdefault((entry.method, entry.published), []).append(entry)

    shown = [i for i, _ in enumerate(group) if len({key[i] for key in blocks}) > 1]
    constant = [
        f"{group[i].replace('_', ' ')}: {key}"
        for i, key in enumerate(next(iter(blocks)))
        if i not in shown and key
    ]
    rows: list[Row] = []
    differences: list[str] = []
    for key, methods in blocks.items():
        labels = tuple(key[i] or NONE for i in shown)
        block = [
            Row((*labels, method), tuple(_cell(each, runs) for each in columns), published)
            for (method, published), runs in methods.items()
        ]
        mixed = _different_pictures([run for runs in methods.values() for run in runs])
        differences += mixed
        rows += _ranked(columns, block, comparable=not mixed)
    headings = (*(group[i].replace("_", " ") for i in shown), "method")
    notes = _notes(entries, constant, rows, "scene" not in group)
    notes += dict.fromkeys(differences)
    return Table(title, headings, tuple(columns), tuple(rows), tuple(notes))


def published_entries(entries: Iterable[ComparedRun]) -> list[ComparedRun]:
    """The paper's numbers for each (data set, scene, setting) of ``entries``; [] where it has none.

    Also none where all trainings used exposures that the paper's did not.
    """
    fair = [entry for entry in entries if not entry.saw_novel_exposures]
    keys = dict.fromkeys((entry.data_set, entry.scene, entry.setting) for entry in fair)
    found = []
    for data_set, scene, setting in keys:
        for method, means in published_means(data_set, scene, setting).items():
            evaluation = {"means": means, "conditions": {"data_set": data_set}}
            found.append(
                ComparedRun(f"{method} (published)", scene, setting, None, evaluation, published=True)
            )
    return found


def _require_comparable(entries: list[ComparedRun], group: Sequence[Grouping]) -> None:
    if not entries:
        raise BadValueError("there is nothing to compare", "Give at least one evaluated run.")
    seen: set[tuple[object, ...]] = set()
    for entry in entries:
        run = (entry.method, entry.data_set, entry.scene, entry.setting, entry.seed, entry.published)
        if run in seen:
            raise BadValueError(
                f"two runs of {entry.method} on {entry.scene}, {entry.setting}, seed {entry.seed}",
                "Give each run once, or give the methods different names.",
            )
        seen.add(run)
    settings = sorted({entry.setting for entry in entries})
    if "setting" not in group and len(settings) > 1:
        raise BadValueError(
            f"a mean over the settings {', '.join(settings)} is meaningless", "Add 'setting' to group."
        )


def _cell(each: Column, runs: list[ComparedRun]) -> Cell:
    """Mean over seeds, then over scenes; the spread over the seeds that every scene has."""
    by_scene: dict[str, dict[int | None, float]] = {}
    for run in runs:
        value = each.value(run)
        if value is not None:
            by_scene.setdefault(run.scene, {})[run.seed] = value
    if not by_scene:
        return Cell(None)
    mean = statistics.fmean(statistics.fmean(seeds.values()) for seeds in by_scene.values())
    common = set.intersection(*(set(seeds) for seeds in by_scene.values()))
    over_scenes = [statistics.fmean(seeds[seed] for seeds in by_scene.values()) for seed in common]
    spread = statistics.stdev(over_scenes) if len(over_scenes) > 1 else None
    count = sum(len(seeds) for seeds in by_scene.values())
    return Cell(mean, spread, len(common), tuple(sorted(by_scene)), count)


def _different_pictures(runs: list[ComparedRun]) -> list[str]:
    """A line for each scene whose evaluations do not state the same pictures."""
    sizes: dict[tuple[str, str], dict[str, list[str]]] = {}
    views: dict[tuple[str, str], dict[frozenset[str], list[str]]] = {}
    for run in runs:
        conditions, scene = run.evaluation.get("conditions", {}), (run.data_set, run.scene)
        match conditions:
            case {"resolution": [width, height]}:
                pictures = f"{conditions.get('split', 'test')} at {width}×{height}"
                sizes.setdefault(scene, {}).setdefault(pictures, []).append(run.method)
        match run.evaluation.get("views"):
            case [{"view": _}, *_] as rows:
                names = frozenset(str(row.get("view")) for row in rows if isinstance(row, dict))
                views.setdefault(scene, {}).setdefault(names, []).append(run.method)
    differences = []
    for scene in dict.fromkeys((*sizes, *views)):
        which, many = sizes.get(scene, {}), views.get(scene, {})
        groups = list(which.items())
        if len(groups) < 2:  # of one size, but a run may have its own split
            groups = [(f"{len(names)} views of its own", methods) for names, methods in many.items()]
        if len(groups) > 1:
            each = (f"{pictures} ({', '.join(dict.fromkeys(methods))})" for pictures, methods in groups)
            differences.append(f"NOT COMPARABLE, not ranked: {scene[1]} is evaluated on {', on '.join(each)}")
    return differences


def _ranked(columns: list[Column], rows: list[Row], comparable: bool) -> list[Row]:
    """The rows of one block, with partial cells and, if ``comparable``, the best and second marked."""
    cells = [list(row.cells) for row in rows]
    for i, each in enumerate(columns):
        ours = [row.cells[i] for row in rows if not row.published]
        scenes = {scene for cell in ours for scene in cell.scenes}
        most = max((cell.runs for cell in ours), default=0)
        merits: dict[int, float] = {}
        for r, row in enumerate(rows):
            cell = row.cells[i]
            if cell.mean is None:
                continue
            partial = ""
            if len(cell.scenes) < len(scenes):
                partial = counted(len(cell.scenes), "scene")
            elif not row.published and cell.runs < most:
                partial = counted(cell.runs, "run")
            cells[r][i] = replace(cell, partial=partial)
            if not partial and not row.published and each.better != "neither":
                merits[r] = each.merit(cell.mean)
        if not comparable or len(set(merits.values())) < 2:
            continue  # a single one, or all equal: there is no best
        best_two = sorted(set(merits.values()), reverse=True)[:2]
        for r, merit in merits.items():
            if merit in best_two:
                cells[r][i] = replace(cells[r][i], rank=best_two.index(merit) + 1)
    return [Row(row.labels, tuple(cells[r]), row.published) for r, row in enumerate(rows)]


def _notes(entries: list[ComparedRun], constant: list[str], rows: list[Row], over_scenes: bool) -> list[str]:
    notes = []
    if constant:
        notes.append("; ".join(constant))
    measured = [entry for entry in entries if not entry.published]
    scenes = list(dict.fromkeys(entry.scene for entry in measured))
    if over_scenes and len(scenes) > 1:
        notes.append(f"means over {len(scenes)} scenes: {', '.join(scenes)}")
    ours = [cell for row in rows if not row.published for cell in row.cells if cell.mean is not None]
    spread_over = [cell.seeds for cell in ours if cell.spread is not None]
    if spread_over:
        what = "the mean over scenes" if over_scenes and len(scenes) > 1 else "the number"
        without = "; none where fewer than two are common to the scenes"
        notes.append(
            f"±: standard deviation of {what} over {_range(spread_over)} seeds"
            + (without if len(spread_over) < len(ours) else "")
        )
    elif measured and all(cell.runs == len(cell.scenes) for cell in ours):
        notes.append("one seed: no spread is known")
    elif measured:
        runs = [(entry.method, entry.data_set, entry.scene, entry.setting) for entry in measured]
        counts = _range([runs.count(each) for each in runs])
        notes.append(f"{counts} seeds, no two of them common to all scenes of a method: no spread is known")
    if any(cell.rank for row in rows for cell in row.cells):
        notes.append("best bold, second underlined; equal printed numbers share a place")
    if any(entry.published for entry in entries):
        notes.append(
            "published: the paper's own figures (evaluate/published.csv), other hardware; not ranked"
        )
    if any(cell.partial for row in rows for cell in row.cells):
        notes.append("numbers over fewer scenes or seeds than others have are not ranked")
    notes += dict.fromkeys(line for entry in measured if (line := _interrupted(entry)))
    notes += dict.fromkeys(
        f"{entry.method} on {entry.scene} was trained on exposures that LDR-NE is of: the published figures "
        "are not"
        for entry in measured
        if entry.data_set and entry.saw_novel_exposures
    )
    return notes


def _interrupted(entry: ComparedRun) -> str:
    match entry.evaluation.get("conditions", {}):
        case {"iteration": int(done), "iterations": int(planned)} if done < planned:
            seed = "" if entry.seed is None else f", seed {entry.seed}"
            return f"{entry.method} on {entry.scene}{seed}: {done} of {planned} iterations"
    return ""


def _range(numbers: Sequence[int]) -> str:
    least, most = min(numbers), max(numbers)
    return str(least) if least == most else f"{least} to {most}"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")
