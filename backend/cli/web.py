# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export RUN OUT.html``, or ``--web``: writes a trained run, or a model file, as a web page."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ...bridge.data_set import CAPTURE_FILE
from ...bridge.errors import BadValueError
from ...bridge.gaussian_import import upright
from ...bridge.layouts import HDR_NERF_SYN, NERF
from ...bridge.model_file import Model, read_model
from ...bridge.ply_model import read_ply_model
from ..evaluate.sheets import as_picture
from ..export.web_page import WebPage, WebView, write_web_page
from ..runs.run import Run, open_run
from ..scene import Scene, hdr_nerf_syn
from .exporting import PAGE, Exporting
from .output import ShowProgress, printer, progress

#: Width in pixels of the image shown while the page loads.
POSTER_WIDTH = 960
#: Percent of the work for a run's model, whose confidence takes long.
MODEL_PERCENT = 60
#: Layouts with Blender's cameras.
BLENDER_LAYOUTS = (hdr_nerf_syn.OURS, HDR_NERF_SYN.name, NERF.name)


@dataclass(frozen=True, kw_only=True)
class WebPageOf(Exporting):
    """Write the web page of a run's folder or of a model file: one HTML file, or a folder."""

    def work(self) -> dict[str, Any]:
        """Raises what opening raises, and ``BadValueError`` and ``OutputError``."""
        if self.out is None:
            raise BadValueError("--web needs an output", "Give a folder, or OUT.html.")
        single_file = self.out.suffix.lower() in PAGE
        with progress("web page", "percent", self.json) as show:
            return _written(self.source, self.out, single_file, self.data, show, printer(self.json))


def _written(
    source: Path,
    out: Path,
    single_file: bool,
    data: Path | None,
    show: ShowProgress,
    say: Callable[[str], None],
) -> dict[str, Any]:
    if source.is_dir():
        run = open_run(source, data, report=say, pictures=False)
        model = run.model(lambda done, views, name: show(MODEL_PERCENT * done // max(views, 1), 100, name))
        page = page_of(run)
        remarks = page.notes[1:]
    else:
        if data is not None:
            raise BadValueError("--data only applies to a run, and this is a model file", "Leave it out.")
        model, remarks = _read(source)
        method, iteration = (model.metadata.get(name, "") for name in ("method", "iteration"))
        notes = (f"{method}, iteration {iteration}.",) if method and iteration else ()
        page = WebPage(model.metadata.get("scene") or source.stem, notes=(*notes, *remarks))
    show(MODEL_PERCENT, 100, "")

    def report(done: float) -> None:
        show(MODEL_PERCENT + round((100 - MODEL_PERCENT) * done), 100, "")

    written = write_web_page(out, model, page, single_file, report)
    hidden = f", without {written.omitted} too faint to see" if written.omitted else ""
    say(
        f"wrote {written.page}: {written.gaussians} Gaussians{hidden}, "
        f"{written.data_bytes / 1e6:.1f} MB of data, {written.page_bytes / 1e6:.1f} MB in all"
    )
    for note in (page.response[1], *remarks):
        if note:
            say(note)
    return {"out": str(written.page), "gaussians": written.gaussians, "bytes": written.page_bytes}


def page_of(run: Run) -> WebPage:
    """The page of a run apart from its model: the data set's cameras, an image, how its look differs."""
    method = run.method
    scene = run.scene
    views = [
        WebView(f"{split}/{view.index}", view.camera)
        for split in ("test", "train", "val", "lit")
        for view in scene.splits[split]
    ]
    exposure = scene.middle_exposure
    camera = views[0].camera.resized(POSTER_WIDTH)
    with torch.no_grad():
        poster = as_picture(method.ldr(camera, exposure))
    notes = (f"{run.provenance['method']}, iteration {run.iteration}.", *method.remarks)
    return WebPage(scene.name, views, notes, poster, response_words(run), exposure, is_upright(scene))


def is_upright(scene: Scene) -> bool:
    """Whether +Z is up in the data set's world, rather than arbitrary as from structure from motion.

    Cannot be found from the cameras, which may all look down, as on an arc in front of an object.
    """
    ours = bool(scene.info) or (scene.root / CAPTURE_FILE).is_file()
    return ours or scene.layout in BLENDER_LAYOUTS


def response_words(run: Run) -> tuple[str, str]:
    """The title of a run's response, and how the page's image differs from the method's, or ""."""
    method = run.method
    if not method.learns_response:
        return "sRGB (known response)", ""
    if method.curves.config.local:
        return (
            "Learned response (global)",
            "This model also has local curves, which need its networks: the page shows only its global "
            "curve. physhdr render and the live preview in Blender show both.",
        )
    if run.config.method.traits.develops_splats:
        return (
            "Learned response",
            "This method applies the response to each Gaussian before blending, the page after blending: "
            "physhdr render shows the method's own image.",
        )
    return "Learned response", ""


def _read(path: Path) -> tuple[Model, tuple[str, ...]]:
    """A model file or a PLY as a model in Blender's axes, and notes on what was lost."""
    if path.suffix.lower() != ".ply":
        return read_model(path), ()
    read = read_ply_model(path)
    return upright(read.model, read.up), read.notes
