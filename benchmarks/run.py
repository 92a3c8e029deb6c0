# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed of training and rendering on the CPU, each figure beside its plain-torch alternative and its target.

Every figure is a median; rivals are timed in turn (one of each, again and again), so that whatever else
the machine does meanwhile hits both. ``python benchmarks/run.py`` prints every row, ``--quick`` the quick
ones in less than a minute.
"""

import argparse
import dataclasses
import datetime
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# torch's OpenMP threads must not spin between operations: they would take the kernels' cores.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import torch
from iteration import iteration_rows, picture_rows
from kernel_rows import kernel_rows, rasteriser_rows
from measure import Row
from preview import preview_rows
from processes import memory_rows, start_rows
from rich.console import Console
from rich.table import Table
from shares import shares

from physhdr.backend.kernels.ahead import compile_ahead
from physhdr.backend.rasterize import cpu
from physhdr.backend.train.presets import needed_by_presets

#: Columns of the table where nobody says how wide the paper is.
WIDTH = 80

#: Sections by the name that ``--only`` takes.
SECTIONS: dict[str, tuple[str, Callable[[bool], Iterator[Row]]]] = {
    "iteration": ("A whole iteration", iteration_rows),
    "pictures": ("Pictures per second", picture_rows),
    "previews": ("Previews end to end", preview_rows),
    "rasteriser": ("Rasteriser, forward + backward", rasteriser_rows),
    "kernels": ("Other kernels, forward + backward", kernel_rows),
    "memory": ("Memory of a training process", memory_rows),
    "start": ("Compilation and start", start_rows),
}
SHARES = "shares"
#: What ``--quick`` leaves out.
SLOW = ("memory", "start")


def machine(threads: int) -> str:
    """The processor, how much of it is used, and how busy it was."""
    names = [platform.processor() or platform.machine()]
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.partition(": ")[2] for line in cpuinfo.read_text().splitlines() if "model name" in line]
    busy = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{names[0]}, {threads} threads{busy}, torch {torch.__version__}, {datetime.date.today()}"


def table_of(title: str, rows: list[Row]) -> Table:
    """Rows as a table for the terminal."""
    table = Table(title=title, title_justify="left", width=WIDTH)
    table.add_column("work", ratio=1)
    for name in ("ours", "plain torch", "ratio"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("target", no_wrap=True)
    for row in rows:
        targets = "\n".join(f"{words} {'✓' if met else '✗'}" for words, met in row.targets)
        plain = "" if row.plain is None else _number(row.plain)
        ratio = "" if row.ratio is None else f"{_number(row.ratio)} ×"
        work = row.work if not row.note else f"{row.work}\n  {row.note}"
        table.add_row(work, f"{_number(row.value)} {row.unit}", plain, ratio, targets)
    return table


def table_of_shares(preset: str, count: int, parts: dict[str, dict[str, float]]) -> Table:
    """The parts of an iteration as a table for the terminal."""
    whole = sum(sum(part.values()) for part in parts.values())
    title = f"Where an iteration's {whole:.1f} ms go: preset {preset}, {count // 1000} k Gaussians"
    table = Table(title=title, title_justify="left", width=WIDTH)
    table.add_column("part", ratio=1)
    for name in ("forward, ms", "backward, ms", "share"):
        table.add_column(name, justify="right", no_wrap=True)
    for part, times in parts.items():
        directions = [f"{times[d]:.2f}" if times[d] else "" for d in ("forward", "backward")]
        table.add_row(part, *directions, f"{100 * sum(times.values()) / whole:.0f} %")
    return table


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def measure_sections(options: argparse.Namespace, console: Console) -> dict[str, Any]:
    """Every row that is asked for, printed section by section."""
    wanted = options.only or [name for name in (*SECTIONS, SHARES) if not (options.quick and name in SLOW)]
    results: dict[str, Any] = {"rows": [], "shares": {}}
    with console.status("measuring …") as status:
        for name, (title, section) in SECTIONS.items():
            if name not in wanted:
                continue
            rows = []
            for row in section(options.quick):
                status.update(f"measured {row.work}")
                rows.append(row)
            results["rows"] += [dataclasses.asdict(row) | {"section": name} for row in rows]
            console.print(table_of(title, rows))
        if SHARES in wanted:
            for count in (50_000,) if options.quick else (50_000, 200_000):
                for preset in ("default", "paper"):
                    parts = shares(preset, count)
                    results["shares"][f"{preset} {count}"] = parts
                    console.print(table_of_shares(preset, count, parts))
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="leave out 200 k and what takes long")
    parser.add_argument("--only", nargs="+", choices=[*SECTIONS, SHARES], help="nothing but these sections")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads of both sides")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    cpu.set_threads(options.threads)
    torch.set_num_threads(options.threads)

    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    with console.status("compiling …") as status:
        start = time.perf_counter()
        compile_ahead(
            needed_by_presets(),
            lambda what, done, total: status.update(f"compiling {done}/{total}: {what}"),
        )
        ready = time.perf_counter() - start
    words = machine(options.threads)
    console.print(f"{words}; kernels ready after {ready:.1f} s\n")

    results = measure_sections(options, console)
    if options.json:
        options.json.write_text(json.dumps({"machine": words} | results, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
