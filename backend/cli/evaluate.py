# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr evaluate``: the paper's protocol on the test or validation views, printed and saved."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.text import Text

from ...bridge.atomic import all_at_once, atomic_path
from ...bridge.errors import BadValueError
from ...bridge.regular import resolved
from ..device import DeviceName
from ..evaluate.comparison import SHORT_METRICS, ComparedRun, comparison_table, load_evaluation
from ..evaluate.linearity import Linearity
from ..evaluate.photos import Falloff, falloff_there
from ..evaluate.picture_folder import PictureFolder
from ..evaluate.protocol import evaluate, lpips_from
from ..evaluate.renderer import Renderer
from ..evaluate.report import METHODS_FILES, RESPONSE_FILE, SHEET_FILE, to_terminal, write_report
from ..evaluate.response import learned_response, write_response_figure
from ..evaluate.results import VIEWS_OF, Evaluation
from ..evaluate.sheets import comparison_sheet, method_sheet
from ..optional import PackageMissingError
from ..rasterize import Implementation
from ..runs.files import writable_folder
from ..runs.run import Run, open_run
from ..scene import Scene, read_scene
from ..scene.pictures import write_png
from .confidence import write_calibration
from .output import Say, printer, progress, run_and_report


@dataclass(frozen=True)
class Evaluate:
    """Compare LDR-OE, LDR-NE, HDR and relighting with the truth: tables, files and a comparison sheet.

    Evaluates a run, or pictures made by any other program (--pictures; lab/compare.md).
    """

    #: Folder of the run.
    folder: tyro.conf.Positional[Path | None] = None
    #: Instead of a run: a folder of pictures of every view, named like those of the data set (--data).
    pictures: Path | None = None
    #: Which views: test, or val, the validation views, on which choices are made.
    split: Literal["test", "val"] = "test"
    #: Folder for the results; default: that of the run or of the pictures.
    out: Path | None = None
    #: LPIPS weights (an .npz of AlexNet and the linear heads, see docs/formats.md); default: skip LPIPS.
    lpips_weights: Path | None = None
    #: Also compare a run's confidence with the true radiance (docs/light.md#confidence).
    confidence: bool = False
    #: Folders of other evaluated runs on the same data, for one table and one sheet of all of them.
    against: tuple[Path, ...] = ()
    #: The data set: required with --pictures; of a run if it has moved since training.
    data: Path | None = None
    #: With --pictures: how exposures were chosen in training, for the report.
    exposure_mode: Literal["exp1", "exp3"] | None = None
    #: With --pictures: the factor by which the data set's pictures are reduced; default: its layout's.
    downscale: float | None = None
    #: With --pictures: the colour space of a data set of radiance; default: as its files say.
    color_space: str | None = None
    rasteriser: Implementation = "auto"
    device: DeviceName = "auto"
    #: Write progress and the result or error as JSON, one object per line.
    json: bool = False

    def run(self) -> int:
        return run_and_report(self._work, self.json)

    def _work(self) -> dict[str, Any]:
        say = printer(self.json)
        subject = self._subject(say)
        out = writable_folder(self.out or subject.folder)
        lpips = lpips_from(self.lpips_weights)
        for folder in self.against:
            load_evaluation(folder)  # fail now rather than minutes later
        with progress("evaluate", "picture", self.json) as show:
            evaluation = evaluate(
                subject.renderer,
                subject.scene,
                split=self.split,
                lpips=lpips,
                exposure_mode=subject.setting,
                progress=show,
                **subject.training,
                **subject.parts,
            )
        try:
            with all_at_once(out) as unfinished:
                self._write(subject, evaluation, unfinished, say)
                names = sorted(path.name for path in unfinished.iterdir())
        finally:
            say(to_terminal(evaluation))  # even if writing fails, because the numbers took long
        say("wrote " + ", ".join(str(out / name) for name in names))
        return {"folder": str(out), "split": self.split}

    def _write(self, subject: "_Subject", evaluation: Evaluation, out: Path, say: Say) -> None:
        """Write all files of the evaluation into ``out``."""
        write_report(evaluation, out)
        name = "ours" if self.folder else subject.names[0]
        picture = comparison_sheet(
            subject.renderer,
            subject.scene,
            split=self.split,
            name=name,
            scale=evaluation.scale_ratio,
            falloff=subject.training.get("falloff") if evaluation.falloff_used else None,
            **subject.parts,
        )
        write_png(out / SHEET_FILE, picture)
        _plot_response(subject, out / RESPONSE_FILE, self.split, evaluation.linearity, say)
        if self.confidence:
            assert subject.run is not None  # pictures have none: _subject refused
            table = write_calibration(subject.run, self.split, out)
            say(table.rich(f"{subject.scene.name}, {VIEWS_OF[self.split]}"))
        if self.against:
            others = [_of_run(self._open(folder, say)) for folder in self.against]
            compared = [(subject, out), *((other, other.folder) for other in others)]
            _compare(compared, out, self.split, say)

    def _open(self, folder: Path, say: Say) -> Run:
        return open_run(folder, self.data, self.rasteriser, self.device, say)

    def _subject(self, say: Say) -> "_Subject":
        if (self.folder is None) == (self.pictures is None):
            raise BadValueError(
                "give either the folder of a run or --pictures",
                "Call: physhdr evaluate RUN, or: physhdr evaluate --pictures FOLDER --data DATA",
            )
        if self.folder is not None:
            options = ("exposure_mode", "downscale", "color_space")
            if changed := [name for name in options if getattr(self, name) is not None]:
                raise BadValueError(
                    f"--{changed[0].replace('_', '-')} only works with --pictures: a run stores its own",
                    "Leave it out.",
                )
            return _of_run(self._open(self.folder, say))
        assert self.pictures is not None
        if self.confidence:
            raise BadValueError("--confidence only works with a run: pictures have none", "Leave it out.")
        if self.data is None:
            raise BadValueError("--pictures needs the data set they show", "Give it: --data DATA")
        if self.out is None and resolved(self.pictures) == resolved(self.data):
            raise BadValueError(
                f"{self.pictures} is the data set itself, where no results are written",
                "Give a folder for them: --out FOLDER",
            )
        scene = read_scene(self.data, self.downscale, self.color_space)
        return _of_pictures(PictureFolder(self.pictures, scene, self.split), scene, self.exposure_mode)


@dataclass(frozen=True)
class _Subject:
    """A run or pictures to evaluate. ``names``: for tables, the shortest first; the last is unique.

    ``training``: arguments of ``evaluate`` about training; ``parts``: arguments of it and of the sheet about
    what exists. ``run``: None for pictures.
    """

    folder: Path
    names: tuple[str, str, str]
    scene: Scene
    renderer: Renderer
    setting: str
    seed: int | None = None
    training: dict[str, Any] = field(default_factory=dict)
    parts: dict[str, Any] = field(default_factory=dict)
    run: Run | None = None


def _of_run(run: Run) -> _Subject:
    training = {
        "training_exposures": run.config.training_exposures,
        "iteration": run.iteration,
        "iterations": run.config.iterations,
        "falloff": None if run.lenses is None else run.lenses.falloff,
    }
    names = (run.preset, run.folder.name, str(resolved(run.folder)))
    mode, seed = run.config.exposure_mode, run.config.seed
    return _Subject(run.folder, names, run.scene, run.method, mode, seed, training, run=run)


def _of_pictures(pictures: PictureFolder, scene: Scene, exposure_mode: str | None) -> _Subject:
    whole = resolved(pictures.folder)
    parts = {"hdr": pictures.has_hdr, "shows": pictures.shows}
    names = (whole.name, whole.name, str(whole))
    return _Subject(pictures.folder, names, scene, pictures, exposure_mode or "unknown", parts=parts)


def _plot_response(subject: _Subject, path: Path, split: str, linearity: Linearity | None, say: Say) -> None:
    """Plot a learned response, and how linear radiance is, if the package for figures is installed."""
    learned = learned_response(subject.renderer)
    if learned is None:
        return
    try:
        write_response_figure(path, learned, subject.scene, split, linearity)
    except PackageMissingError as error:
        say(Text(f"skipping {path.name}: {error}", style="yellow"))


def _compare(subjects: list[tuple[_Subject, Path]], out: Path, split: str, say: Say) -> None:
    """Print and write the table of ``subjects``, each with the folder of its evaluation, and their sheet."""
    names = _names([subject for subject, _ in subjects])
    scene = subjects[0][0].scene
    entries = []
    for name, (subject, folder) in zip(names, subjects, strict=True):
        if resolved(subject.scene.root) != resolved(scene.root):
            raise BadValueError(
                f"{subject.folder} was trained on {subject.scene.root}, not on {scene.root}",
                "Compare runs on one data set, or give --data if it has moved.",
            )
        evaluation = load_evaluation(folder)
        entries.append(ComparedRun(name, scene.name, subject.setting, subject.seed, evaluation))
    title = f"{scene.name}, {VIEWS_OF[split]}"
    table = comparison_table(entries, title=title)
    paths = [out / name for name in METHODS_FILES]
    for path, text in zip(paths, (table.markdown(), table.csv()), strict=False):
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    say(comparison_table(entries, metrics=SHORT_METRICS, title=title).rich())
    renderers = {name: subject.renderer for name, (subject, _) in zip(names, subjects, strict=True)}
    without = [
        name for name, (subject, _) in zip(names, subjects, strict=True) if not subject.parts.get("hdr", True)
    ]
    scales = {name: entry.evaluation.get("scale_ratio") for name, entry in zip(names, entries, strict=True)}
    falloffs = {
        entry.method: _falloff(subject, split, entry.evaluation)
        for entry, (subject, _) in zip(entries, subjects, strict=True)
    }
    sheet = method_sheet(renderers, scene, split=split, without_hdr=without, scales=scales, falloffs=falloffs)
    write_png(paths[-1], sheet)


def _falloff(subject: _Subject, split: str, evaluation: dict[str, Any]) -> Falloff | None:
    """The vignetting that its evaluation compared with; of files before 2026-11-27 found as there."""
    falloff = subject.training.get("falloff")
    if falloff is None:
        return None
    used = evaluation.get("conditions", {}).get("vignetting")
    if used is None:
        used = falloff_there(subject.renderer, subject.scene.splits[split], falloff)
    return falloff if used else None


def _names(subjects: list[_Subject]) -> list[str]:
    """Each run's preset, or its folder's name where presets repeat, or its whole path where names repeat."""
    for names in zip(*(subject.names for subject in subjects), strict=True):
        if len(set(names)) == len(subjects):
            return list(names)
    raise BadValueError("a run cannot be compared with itself", "Give each folder once.")
