# SPDX-License-Identifier: GPL-3.0-or-later
"""A benchmark's progress in the terminal: methods × scenes, a table for each budget and setting at work."""

from collections import Counter

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from .plan import Budget
from .runs import Run
from .schedule import SETTLED, Schedule, Status

STYLES = {
    "waiting": "dim",
    "running": "cyan",
    "elsewhere": "magenta",
    "done": "green",
    "failed": "bold red",
    "blocked": "red",
    "absent": "dim",
}


def progress_table(schedule: Schedule) -> Group:
    """For ``rich.live.Live``. A cell has one item a seed: waiting, progress, PSNR of LDR-OE, or failed."""
    plan = schedule.store.plan
    shown = []
    for budget in plan.budgets:
        for setting in plan.settings:
            runs = [run for run in schedule.runs if (run.budget, run.setting) == (budget, setting)]
            kinds = {schedule.status[run].kind for run in runs}
            if kinds & {"running", "elsewhere"}:
                shown.append(_table(schedule, budget, setting, runs))
    counts = Counter(status.kind for status in schedule.status.values())
    total = Text(f"{len(schedule.runs)} runs: ")
    total.append(", ".join(f"{counts[kind]} {kind}" for kind in STYLES if counts[kind]))
    return Group(*shown, total)


def _table(schedule: Schedule, budget: Budget, setting: str, runs: list[Run]) -> Table:
    settled = sum(schedule.status[run].kind in SETTLED for run in runs)
    title = f"{budget}, {setting}: {settled} of {len(runs)}"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("method")
    for scene in schedule.store.plan.scenes:
        table.add_column(scene.name, justify="right")
    for method in schedule.store.plan.methods:
        cells = []
        for scene in schedule.store.plan.scenes:
            states = [schedule.status[run] for run in runs if (run.method, run.scene) == (method, scene)]
            cells.append(Text(" ").join(_item(status) for status in states))
        table.add_row(method.name, *cells)
    return table


def _item(status: Status) -> Text:
    if status.kind == "running":
        text = f"{status.iteration}/{status.iterations}" if status.iterations else "starts"
    elif status.kind == "done":
        text = "done" if status.psnr is None else f"{status.psnr:.2f}"
    else:
        text = {"waiting": "·", "blocked": "–", "absent": "–"}.get(status.kind, status.kind)
    return Text(text, style=STYLES[status.kind])
