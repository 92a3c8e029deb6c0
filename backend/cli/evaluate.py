# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr evaluate``: the paper's protocol on the test split, printed and saved."""

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.progress import Progress

from ..device import DeviceName
from ..evaluate.protocol import evaluate, lpips_from
from ..evaluate.report import to_terminal, write_report
from ..evaluate.sheets import comparison_sheet
from ..rasterize import Implementation
from ..scene.pictures import write_png
from .progress import console
from .run_folder import open_run, writable_folder

SHEET_FILE = "comparison.png"


@dataclass(frozen=True)
class Evaluate:
    """LDR-OE, LDR-NE, HDR and relighting against the truth: tables, files and a comparison sheet."""

    #: Folder of the run.
    folder: tyro.conf.Positional[Path]
    #: Folder for the results; default: the run's own.
    out: Path | None = None
    #: LPIPS weights (an .npz of AlexNet and the linear heads, see docs/formats.md); without: skipped.
    lpips_weights: Path | None = None
    #: The data set, where it has moved since training.
    data: Path | None = None
    rasteriser: Implementation = "auto"
    device: DeviceName = "auto"

    def run(self) -> int:
        run = open_run(self.folder, self.data, self.rasteriser, self.device)
        out = writable_folder(self.out or self.folder)
        lpips = lpips_from(self.lpips_weights)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
            task = bar.add_task("evaluate", total=None)

            def show(done: int, total: int, what: str) -> None:
                bar.update(task, completed=done, total=total, description=f"evaluate {what}")

            evaluation = evaluate(
                run.method, run.scene, lpips=lpips, exposure_mode=run.config.exposure_mode, progress=show
            )
        console.print(to_terminal(evaluation))
        paths = write_report(evaluation, out)
        sheet = out / SHEET_FILE
        write_png(sheet, comparison_sheet(run.method, run.scene))
        console.print("wrote " + ", ".join(str(path) for path in [*paths, sheet]), soft_wrap=True)
        return 0
