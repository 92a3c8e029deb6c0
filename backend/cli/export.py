# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export``: the model file for Blender and the two PLY files, or a web page."""

import stat
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import tyro

from ...bridge.atomic import patiently
from ...bridge.camera_list import refuse_others, write_camera_list
from ...bridge.display import FITTED_COMMENT, display_colour_sh, look_comment, look_words
from ...bridge.errors import BadValueError, OutputError
from ...bridge.gaussian_ply import standard_columns, write_lossless_ply, write_standard_ply
from ...bridge.limits import EV_MAX
from ...bridge.model_file import write_model
from ...bridge.ply_model import PROVENANCE
from ..export import BAKED_FILE, CAMERAS_FILE, LOSSLESS_FILE, MODEL_FILE
from ..export.baked import confidence_column, network_comments, parameter_columns
from ..export.fitted_bake import fitted_colour_sh, method_picture
from ..model.gaussians import Gaussians
from ..runs.files import writable_folder
from ..runs.run import open_run
from ..runs.terminal import console
from .lighting import levels_asked
from .told import progress
from .web import export_web

#: Said of a model whose training pictures have gone.
NO_CONFIDENCE = "without confidence: the training pictures are not there, or are others (--data)"
#: Of a PLY file, among the first bytes of whose header an export has written where it comes from.
HEAD_BYTES = 4096


@dataclass(frozen=True)
class Export:
    """Write RUN/model.safetensors (for Blender), cameras.json and a standard 3DGS PLY; of Gaussians also the
    lossless PLY.

    With --web a web page instead, which opens from disk or from any server.
    """

    #: Folder of the run; with --web also a model file that was exported (.safetensors, .ply).
    folder: tyro.conf.Positional[Path]
    #: Folder of the web page to write, or with --single-file its HTML file. docs/other-programs.md
    web: Path | None = None
    #: One HTML file with everything in it.
    single_file: bool = False
    #: Folder to write into; default: the run's own.
    out: Path | None = None
    #: Exposure in EV (log2 of seconds) at which the standard PLY is baked; default: of the middle exposure.
    exposure_ev: float | None = None
    #: Level of the first light, the ambient one wherever that has levels, at which the standard PLY is baked.
    lighting_level: float = 1.0
    #: Lights by name for the standard PLY: NAME=VALUE …; those not named are at 1.
    lighting_levels: tuple[str, ...] = ()
    #: Convert the standard PLY's colours one by one, at once, instead of fitting them to the run's pictures
    #: from the training cameras: they then blend to other pictures, mostly too dark (docs/other-programs.md).
    quick: bool = False
    #: The data set, where it has moved since training.
    data: Path | None = None
    #: Of --web: say how far it is, and the result or the error, as JSON, an object a line.
    json: bool = False

    def run(self) -> int:
        if self.web is not None:
            return self._web(self.web)
        if self.single_file or self.json:
            raise BadValueError(
                f"--{'single-file' if self.single_file else 'json'} is of a web page", "Add --web OUT."
            )
        if not self.lighting_level >= 0.0 or not abs(self.exposure_ev or 0.0) <= EV_MAX:
            raise BadValueError(
                f"cannot bake at EV {self.exposure_ev or 0.0} and lighting level {self.lighting_level}",
                f"Give an EV of −{EV_MAX:g} to {EV_MAX:g} and a lighting level of 0 or more.",
            )
        run = open_run(self.folder, self.data, pictures=False)
        levels = levels_asked(self.lighting_level, self.lighting_levels, run.method.lights)
        out = writable_folder(self.out or self.folder)
        refuse_others(out / CAMERAS_FILE)
        former = _former(out)
        method = run.on_gaussians()
        with progress("confidence", "view", as_json=False) as show:
            model = run.model(show)
        write_model(out / MODEL_FILE, model)
        for path in former:  # they are of another model, whatever comes of the new ones
            _remove(path)
        without = "" if model.confidence is not None else f"; {NO_CONFIDENCE}"
        console.print(f"wrote {out / MODEL_FILE}: {method.size} Gaussians, for Blender{without}")

        write_camera_list(out / CAMERAS_FILE, run.camera_list())
        learned = "" if run.twists is None else ", where training has found them to be"
        console.print(f"wrote {out / CAMERAS_FILE}: its cameras{learned}")

        ev = model.developed_ev if self.exposure_ev is None else self.exposure_ev
        if self.quick:  # what is fitted to the method's pictures is at any level
            levels = model.known_levels(levels)
        look, exposure = look_words(ev, levels, model.lights), 2.0**ev
        colours = display_colour_sh(model, exposure, levels)
        if not self.quick:
            cameras = [view.camera for view in run.scene.train]
            with progress("colours", "step", as_json=False) as show:
                picture = method_picture(run.method, exposure, levels)
                colours = fitted_colour_sh(model, colours, cameras, picture, show)
        standard: dict[str, Any] = {
            "positions": model.position,
            "rotations": model.rotation,
            "scales": model.scale,
            "opacities": model.opacity,
            "colour_sh": colours,
        }
        comments = [f"{PROVENANCE}{key}: {value}" for key, value in run.provenance.items()]
        comments.append(look_comment(ev, levels, "LEARNED", model.lights))
        comments += [] if self.quick else [FITTED_COMMENT]
        write_standard_ply(out / BAKED_FILE, **standard, comments=comments)
        console.print(f"wrote {out / BAKED_FILE}: for any 3DGS viewer, baked at {look}")

        if not isinstance(run.method.backbone, Gaussians):
            console.print("no lossless.ply: this run's Gaussians are other ones for each view")
            return 0
        comments.append("phys_ columns and phys_network lines hold the model, scene-linear; keep these")
        write_lossless_ply(
            out / LOSSLESS_FILE,
            standard_columns(**standard),
            parameter_columns(method.gaussians, method.lights) | confidence_column(model),
            comments + network_comments(method, model),
        )
        console.print(f"wrote {out / LOSSLESS_FILE}: every parameter")
        return 0

    def _web(self, out: Path) -> int:
        alone = ("out", "exposure_ev", "lighting_level", "lighting_levels", "quick")
        defaults = {each.name: each.default for each in fields(self)}
        if given := [name for name in alone if getattr(self, name) != defaults[name]]:
            raise BadValueError(
                f"--{given[0].replace('_', '-')} is of the PLY files: a web page has sliders",
                "Leave it out, or leave --web out.",
            )
        return export_web(self.folder, out, self.single_file, self.data, self.json)


def _former(out: Path) -> list[Path]:
    """The PLY files that an export left in ``out``; raises ``OutputError`` where one is not of any."""
    former = []
    for path in (out / BAKED_FILE, out / LOSSLESS_FILE):
        try:
            head = _head(path) if stat.S_ISREG(path.stat().st_mode) else b""
        except FileNotFoundError:
            continue
        except OSError:  # what cannot be read is not replaced
            head = b""
        if f"\ncomment {PROVENANCE}".encode() not in head:
            raise OutputError(
                f"{path} is there, and 'physhdr export' did not write it",
                "Name another folder by --out, or move it away.",
            )
        former.append(path)
    return former


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def _remove(path: Path) -> None:
    try:
        patiently(partial(path.unlink, missing_ok=True))
    except OSError as error:
        raise OutputError(
            f"cannot replace {path}, which is of another model: {error.strerror or error}",
            "Close the program that has it open, or remove it, and export again.",
        ) from error
