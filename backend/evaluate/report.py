# SPDX-License-Identifier: GPL-3.0-or-later
"""An evaluation as files and tables: JSON, CSV of all rows, Markdown, and tables for the terminal."""

import csv
import dataclasses
import io
import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ...bridge.atomic import atomic_path
from ...bridge.run_folder import EVALUATION_FILE, REPORT_FILE, SHEET_FILE
from .results import NOVEL, OBSERVED, OBSERVED_EXPOSURES, VIEWS_OF, Evaluation, LitMeans, Metrics, RelitMeans

#: An empty cell of a table: not computed.
NONE = "–"

#: Columns of the table of views: (heading, metric, digits) for each of OE, NE and HDR.
VIEW_METRICS = (("PSNR", "psnr", 2), ("SSIM", "ssim", 4), ("LPIPS 01", "lpips_01", 4))
METRIC_COLUMNS = ("PSNR dB", "SSIM", "LPIPS", "LPIPS 01")
RELIT_COLUMNS = ("ours", "level × truth", "best × truth", "level × ours", "gain", "light left")

LIT_COLUMNS = ("photos", "relit", "scaled photo", "scaled ours", "gain")

#: Characters in a line of a heading above numbers, on a terminal.
HEADING_WIDTH = 8

REPORT_FILES = (EVALUATION_FILE, "evaluation.csv", REPORT_FILE)
RESPONSE_FILE = "response.png"
#: Several methods in one table and one sheet.
METHODS_FILES = ("methods.md", "methods.csv", "methods.png")
#: All files that an evaluation writes into a run's folder.
FILES = (*REPORT_FILES, SHEET_FILE, RESPONSE_FILE, *METHODS_FILES)


def to_dict(evaluation: Evaluation) -> dict[str, Any]:
    """Everything, ready for JSON: the conditions, the means, then the rows. NaN becomes None."""
    content = {
        "format": "physhdr-evaluation",
        "version": 1,
        "conditions": {
            "scene": evaluation.scene,
            "data_set": evaluation.data_set,
            "split": evaluation.split,
            "exposure_mode": evaluation.exposure_mode,
            "training_exposures": evaluation.training_exposures and list(evaluation.training_exposures),
            "resolution": list(evaluation.resolution),
            "iteration": evaluation.iteration,
            "iterations": evaluation.iterations,
            "mu": evaluation.mu,
            "hdr_normaliser": "maximum of the full-resolution true picture, for each view",
            "hdr_normaliser_range": _normaliser_range(evaluation),
            "ldr_oe_exposure_indices": evaluation.parts[OBSERVED],
            "ldr_ne_exposure_indices": evaluation.parts[NOVEL],
            "eight_bit": evaluation.eight_bit,
            "vignetting": evaluation.falloff_used,
        },
        "scale_ratio": evaluation.scale_ratio,
        "linearity": evaluation.linearity and dataclasses.asdict(evaluation.linearity),
        "response": evaluation.response and dataclasses.asdict(evaluation.response),
        "means": {name: metrics and dataclasses.asdict(metrics) for name, metrics in _means(evaluation)},
        "relit_means": {
            label: _relit_dict(means) for label, means in _relit_means(evaluation) if means is not None
        },
        "lit_means": {
            label: dataclasses.asdict(means) | {"gain": means.gain} for label, means in _lit_means(evaluation)
        },
        "exposures": [dataclasses.asdict(row) for row in evaluation.exposures],
        "views": [dataclasses.asdict(row) for row in evaluation.views],
        "ldr": [dataclasses.asdict(row) for row in evaluation.ldr],
        "hdr": [dataclasses.asdict(row) for row in evaluation.hdr],
        "relit": [
            dataclasses.asdict(row)
            | {
                "condition": row.condition,
                "gain_over_scaled_truth": row.gain_over_scaled_truth,
                "gain_over_scaled_ours": row.gain_over_scaled_ours,
                "gain_over_best_scaled_truth": row.gain_over_best_scaled_truth,
            }
            for row in evaluation.relit
        ],
        "lit": [dataclasses.asdict(row) for row in evaluation.lit],
        "geometry_mean": evaluation.geometry_mean and dataclasses.asdict(evaluation.geometry_mean),
        "geometry": [dataclasses.asdict(row) for row in evaluation.geometry],
        "messages": evaluation.messages,
        "seconds": round(evaluation.seconds, 2),
    }
    return _finite(content)


def write_report(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write ``evaluation.json``, ``.csv`` (one line per row) and ``.md`` into ``folder``, atomically.

    Returns the three paths; raises ``OutputError``.
    """
    texts = (
        json.dumps(to_dict(evaluation), indent=1, allow_nan=False) + "\n",
        to_csv(evaluation),
        to_markdown(evaluation),
    )
    paths = []
    for name, text in zip(REPORT_FILES, texts, strict=True):
        path = Path(folder) / name
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        paths.append(path)
    return paths


def to_csv(evaluation: Evaluation) -> str:
    """One line per comparison, for spreadsheets: its labels, then its numbers."""
    columns = ["part", "view", "index", "exposure_index", "exposure", "light", "normaliser", "scale_ratio"]
    columns += ["slope"]
    columns += ["psnr", "ssim", "lpips", "lpips_01", "psnr_scaled_truth", "psnr_scaled_ours"]
    columns += ["psnr_best_scaled_truth", "factor", "best_factor", "light_left", "psnr_scaled_photo"]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, restval="", lineterminator="\n")
    writer.writeheader()
    for row in evaluation.ldr:
        content = dataclasses.asdict(row)
        writer.writerow({"part": "ldr"} | content.pop("metrics") | content)
    for row in evaluation.hdr:
        shared = {"view": row.view, "index": row.index, "normaliser": row.normaliser}
        shared |= {"scale_ratio": row.scale_ratio, "slope": row.slope}
        writer.writerow({"part": "hdr"} | shared | dataclasses.asdict(row.metrics))
        writer.writerow({"part": "hdr aligned"} | shared | dataclasses.asdict(row.aligned))
    for row in evaluation.relit:
        content = dataclasses.asdict(row)
        del content["levels"]
        content["light"] = row.condition
        content["psnr"] = content.pop("ours")
        content["psnr_best_scaled_truth"] = content.pop("best_scaled_truth")
        content["psnr_scaled_truth"] = content.pop("scaled_truth")
        content["psnr_scaled_ours"] = content.pop("scaled_ours")
        writer.writerow({"part": "relit"} | content)
    for row in evaluation.lit:
        content = dataclasses.asdict(row)
        renamed = {"light": "group", "psnr": "ours", "psnr_scaled_ours": "scaled_ours"}
        renamed["psnr_scaled_photo"] = "scaled_photo"
        writer.writerow({"part": "lit"} | {new: content.pop(old) for new, old in renamed.items()} | content)
    return stream.getvalue()


def to_markdown(evaluation: Evaluation) -> str:
    """The tables as Markdown, with the conditions below."""
    parts = [
        _markdown_table(("", *METRIC_COLUMNS), _metric_cells(evaluation)),
        _markdown_table(("LDR at", "part", *METRIC_COLUMNS), _exposure_cells(evaluation)),
    ]
    if evaluation.relit:
        parts.append(_markdown_table(("relit, dB", *RELIT_COLUMNS), _relit_cells(evaluation)))
    if evaluation.lit:
        parts.append(_markdown_table(("photos under other light, dB", *LIT_COLUMNS), _lit_cells(evaluation)))
    parts.append(_markdown_table(*_view_table(evaluation)))
    parts.append("\n".join(f"- {line}" for line in [*conditions(evaluation), *evaluation.messages]))
    return "\n\n".join(parts) + "\n"


def to_terminal(evaluation: Evaluation) -> Group:
    """The tables and conditions for ``rich.console.Console.print``."""
    parts: list[Table | Text] = [
        _rich_table(
            f"{evaluation.scene}, {VIEWS_OF[evaluation.split]}",
            ("", *METRIC_COLUMNS),
            _metric_cells(evaluation),
        ),
        _rich_table("LDR by exposure", ("", "part", *METRIC_COLUMNS), _exposure_cells(evaluation)),
    ]
    if evaluation.relit:
        title = "relit: μ-law PSNR in dB against the relit truth"
        parts.append(_rich_table(title, ("light", *RELIT_COLUMNS), _relit_cells(evaluation)))
    if evaluation.lit:
        title = "photos under other light that were left out: PSNR in dB"
        parts.append(_rich_table(title, ("group", *LIT_COLUMNS), _lit_cells(evaluation)))
    parts += [Text(line, style="dim") for line in conditions(evaluation)]
    parts += [Text(line, style="yellow") for line in evaluation.messages]
    return Group(*parts)


def _bits(evaluation: Evaluation) -> str:
    if evaluation.eight_bit:
        return "every picture through 8 bit"
    return "HDR pictures through 8 bit, others as their files have them"


def _exposures_seen(evaluation: Evaluation) -> str:
    """How training chose exposures, and from which if not the protocol's."""
    mode, seen = f"exposure mode {evaluation.exposure_mode}", evaluation.training_exposures
    if seen is None or seen == OBSERVED_EXPOSURES:
        return mode
    if len(seen) == 1:  # both modes are the same
        return f"trained on one exposure a view, index {seen[0]}"
    return f"{mode}, of exposure indices {_listed(seen)}"


def conditions(evaluation: Evaluation) -> list[str]:
    """The conditions reported with the numbers: split, exposure mode, normaliser, μ, scale ratio."""
    width, height = evaluation.resolution
    views = len({row.view for row in evaluation.ldr})
    parts = evaluation.parts
    lines = [
        f"split {evaluation.split}: {views} views at {width}×{height}; {_exposures_seen(evaluation)}; "
        f"{_bits(evaluation)}",
        f"LDR-OE: exposure indices {_listed(parts[OBSERVED])}; LDR-NE: {_listed(parts[NOVEL])}; SSIM "
        "11×11, σ 1.5, zero-padded; LPIPS: AlexNet v0.1, inputs in −1…1; LPIPS 01: "
        "inputs in 0…1, as in the paper",
    ]
    normalisers = _normaliser_range(evaluation)
    ratio = evaluation.scale_ratio
    if normalisers is not None:
        lowest, highest = normalisers
        lines.append(
            f"HDR: μ-law, μ = {evaluation.mu:g}; normaliser: maximum of each full-resolution true picture "
            f"({lowest:.4g} … {highest:.4g}); scale not aligned"
        )
    if ratio is not None:
        lines.append(f"HDR scale ratio (median of prediction / truth, median over views): {ratio:.4f}")
    if evaluation.linearity is not None:
        lines.append(str(evaluation.linearity))
    if evaluation.geometry_mean is not None:
        lines.append(str(evaluation.geometry_mean))
    if evaluation.response is not None:
        lines.append(str(evaluation.response))
    if evaluation.relit:
        lines.append("gain: ours − level × truth, the picture that scaling even the true one would give")
        lines.append(
            "level: the factor of the one light that is changed; where several are, or it is off, and for "
            "'best', the median of relit truth / truth, as good as scaling can be; lights not named are at 1"
        )
    return lines


def _means(evaluation: Evaluation) -> list[tuple[str, Metrics | None]]:
    return [
        ("LDR-OE", evaluation.ldr_oe),
        ("LDR-NE", evaluation.ldr_ne),
        ("HDR", evaluation.hdr_mean),
        ("HDR, scale aligned", evaluation.hdr_aligned_mean),
    ]


def _relit_means(evaluation: Evaluation) -> list[tuple[str, RelitMeans | None]]:
    conditions = [(name, evaluation.relit_mean(name)) for name in evaluation.relit_conditions]
    return [*conditions, ("all", evaluation.relit_mean())]


def _lit_means(evaluation: Evaluation) -> list[tuple[str, LitMeans]]:
    labels = [*((name, name) for name in evaluation.lit_groups), ("all", None)]
    means = ((label, evaluation.lit_mean(group)) for label, group in labels)
    return [(label, each) for label, each in means if each is not None]


def _lit_cells(evaluation: Evaluation) -> list[tuple[str, ...]]:
    return [
        (
            label,
            str(means.photos),
            _cell(means.ours, 2),
            _cell(means.scaled_photo, 2),
            _cell(means.scaled_ours, 2),
            f"{means.gain:+.2f}",
        )
        for label, means in _lit_means(evaluation)
    ]


def _relit_dict(means: RelitMeans) -> dict[str, float | None]:
    return dataclasses.asdict(means) | {
        "gain_over_scaled_truth": means.gain_over_scaled_truth,
        "gain_over_scaled_ours": means.gain_over_scaled_ours,
        "gain_over_best_scaled_truth": means.gain_over_best_scaled_truth,
    }


def _metric_cells(evaluation: Evaluation) -> list[tuple[str, ...]]:
    return [(name, *_four(metrics)) for name, metrics in _means(evaluation) if metrics is not None]


def _exposure_cells(evaluation: Evaluation) -> list[tuple[str, ...]]:
    return [
        (f"{row.exposure_index}: {row.exposure:.4g} s", row.part or NONE, *_four(row.metrics))
        for row in evaluation.exposures
    ]


def _four(metrics: Metrics) -> tuple[str, ...]:
    """The cells of ``METRIC_COLUMNS``."""
    numbers = ((metrics.psnr, 2), (metrics.ssim, 4), (metrics.lpips, 4), (metrics.lpips_01, 4))
    return tuple(_cell(value, digits) for value, digits in numbers)


def _view_table(evaluation: Evaluation) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and a row for each view, without empty columns."""
    views = evaluation.views
    columns: list[tuple[str, list[str]]] = []
    for heading, metric, digits in VIEW_METRICS:
        for part, name in (("OE", "ldr_oe"), ("NE", "ldr_ne"), ("HDR", "hdr")):
            cells = [_cell(getattr(getattr(view, name), metric, None), digits) for view in views]
            columns.append((f"{part} {heading}", cells))
    columns.append(("HDR scale", [_cell(view.scale_ratio, 3) for view in views]))
    columns.append(("HDR slope", [_cell(view.slope, 3) for view in views]))
    columns = [(heading, cells) for heading, cells in columns if any(cell != NONE for cell in cells)]
    rows = [(view.view, *(cells[i] for _, cells in columns)) for i, view in enumerate(views)]
    return ("view", *(heading for heading, _ in columns)), rows


def _relit_cells(evaluation: Evaluation) -> list[tuple[str, ...]]:
    return [
        (
            label,
            _cell(means.ours, 2),
            _cell(means.scaled_truth, 2),
            _cell(means.best_scaled_truth, 2),
            _cell(means.scaled_ours, 2),
            f"{means.gain_over_scaled_truth:+.2f}",
            NONE if means.light_left is None else f"{means.light_left:+.1%}",
        )
        for label, means in _relit_means(evaluation)
        if means is not None
    ]


def _cell(value: float | None, digits: int) -> str:
    return NONE if value is None else f"{value:.{digits}f}"


def _listed(indices: Sequence[int]) -> str:
    return ", ".join(str(index) for index in indices)


def _normaliser_range(evaluation: Evaluation) -> list[float] | None:
    values = [row.normaliser for row in evaluation.hdr]
    return [min(values), max(values)] if values else None


def _markdown_table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    rule = "|".join(["---"] + ["---:"] * (len(columns) - 1))
    lines = [f"| {' | '.join(columns)} |", f"|{rule}|", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines)


def _rich_table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for i, column in enumerate(columns):
        # On 80 columns, 'ambient 0.5 + pendant 2' has its place; longer names take two lines.
        heading = textwrap.fill(column, HEADING_WIDTH, break_long_words=False) if i else column
        table.add_column(heading, justify="right" if i else "left", no_wrap=i > 0)
    for row in rows:
        table.add_row(*row)
    return table


def _finite(value: Any) -> Any:
    """JSON has no NaN (the scale of a black picture) and no infinity: None."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
