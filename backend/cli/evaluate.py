# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr evaluate``: the paper's protocol on the test or validation views, printed and saved."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError
from ..device import DeviceName
from ..evaluate.comparison import SHORT_METRICS, ComparedRun, comparison_table, load_evaluation
from ..evaluate.optional import PackageMissingError
from ..evaluate.protocol import evaluate, lpips_from
from ..evaluate.report import METHODS_FILES, RESPONSE_FILE, SHEET_FILE, to_terminal, write_report
from ..evaluate.response import learned_response, write_response_figure
from ..evaluate.results import VIEWS_OF
from ..evaluate.sheets import comparison_sheet, method_sheet
from ..rasterize import Implementation
from ..runs.files import writable_folder
from ..runs.run import Run, open_run
from ..runs.terminal import console
from ..scene.pictures import write_png
from .told import answered, progress


@dataclass(frozen=True)
class Evaluate:
    """LDR-OE, LDR-NE, HDR and relighting against the truth: tables, files and a comparison sheet."""

    #: Folder of the run.
    folder: tyro.conf.Positional[Path]
    #: The views: test, or val: the validation views, on which choices are made.
    split: Literal["test", "val"] = "test"
    #: Folder for the results; default: the run's own.
    out: Path | None = None
    #: LPIPS weights (an .npz of AlexNet and the linear heads, see docs/formats.md); without: skipped.
    lpips_weights: Path | None = None
    #: Folders of other runs on the same data, evaluated before: one table and one sheet of all of them.
    against: tuple[Path, ...] = ()
    #: The data set, where it has moved since training.
    data: Path | None = None
    rasteriser: Implementation = "auto"
    device: DeviceName = "auto"
    #: Say how far it is, and the result or the error, as JSON, an object a line.
    json: bool = False

    def run(self) -> int:
        return answered(self._work, self.json)

    def _work(self) -> dict[str, Any]:
        run = open_run(self.folder, self.data, self.rasteriser, self.device)
        out = writable_folder(self.out or self.folder)
        lpips = lpips_from(self.lpips_weights)
        with progress("evaluate", "picture", self.json) as show:
            evaluation = evaluate(
                run.method,
                run.scene,
                split=self.split,
                lpips=lpips,
                exposure_mode=run.config.exposure_mode,
                training_exposures=run.config.training_exposures,
                iteration=run.iteration,
                iterations=run.config.iterations,
                progress=show,
                falloff=None if run.lenses is None else run.lenses.falloff,
            )
        paths = write_report(evaluation, out)  # before anything else that can fail: the numbers took long
        console.print(to_terminal(evaluation))
        sheet = out / SHEET_FILE
        write_png(sheet, comparison_sheet(run.method, run.scene, split=self.split))
        paths = [*paths, sheet, *_draw_response(run, out / RESPONSE_FILE, self.split)]
        if self.against:
            others = [open_run(folder, self.data, self.rasteriser, self.device) for folder in self.against]
            paths += _compare([(run, out), *((other, other.folder) for other in others)], out, self.split)
        console.print("wrote " + ", ".join(str(path) for path in paths), soft_wrap=True)
        return {"folder": str(out), "split": self.split}


def _draw_response(run: Run, path: Path, split: str) -> list[Path]:
    """The figure, where the method has a response curve and there is a package to draw it."""
    learned = learned_response(run.method)
    if learned is None:
        return []
    try:
        write_response_figure(path, learned, run.scene, split)
    except PackageMissingError as error:
        console.print(f"{path.name} left out: {error}", style="yellow")
        return []
    return [path]


def _compare(runs: list[tuple[Run, Path]], out: Path, split: str) -> list[Path]:
    """Print and write the table of ``runs``, each with the folder of its evaluation, and their sheet."""
    names = _names([run for run, _ in runs])
    scene = runs[0][0].scene
    entries = []
    for name, (run, folder) in zip(names, runs, strict=True):
        if run.scene.root.resolve() != scene.root.resolve():
            raise BadValueError(
                f"{run.folder} was trained on {run.scene.root}, not on {scene.root}",
                "Compare runs on one data set, or give --data where it has moved.",
            )
        entries.append(
            ComparedRun(name, scene.name, run.config.exposure_mode, run.config.seed, load_evaluation(folder))
        )
    title = f"{scene.name}, {VIEWS_OF[split]}"
    table = comparison_table(entries, title=title)
    paths = [out / name for name in METHODS_FILES]
    for path, text in zip(paths, (table.markdown(), table.csv()), strict=False):
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    console.print(comparison_table(entries, metrics=SHORT_METRICS, title=title).rich())
    renderers = {name: run.method for name, (run, _) in zip(names, runs, strict=True)}
    write_png(paths[-1], method_sheet(renderers, scene, split=split))
    return paths


def _names(runs: list[Run]) -> list[str]:
    """Each run's preset, or where two are alike the folder's name, or where these are alike the folder."""
    for names in (
        [run.preset for run in runs],
        [run.folder.name for run in runs],
        [str(run.folder.resolve()) for run in runs],
    ):
        if len(set(names)) == len(runs):
            return names
    raise BadValueError("a run is compared with itself", "Give each folder once.")
