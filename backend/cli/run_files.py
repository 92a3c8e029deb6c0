# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export RUN``: the model file for Blender and the two PLY files."""

import stat
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

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
from ..runs.files import writable_folder
from ..runs.run import open_run
from .exporting import BakedLook, Exporting
from .lighting import requested_levels
from .output import printer, progress

#: Printed for a model whose training pictures are missing.
NO_CONFIDENCE = "without confidence: the training pictures are missing or have changed (--data)"
#: Within this many bytes of a PLY file's header an export writes its provenance.
HEAD_BYTES = 4096


@dataclass(frozen=True, kw_only=True)
class RunFiles(Exporting, BakedLook):
    """Write RUN/model.safetensors (for Blender), cameras.json and a standard 3DGS PLY; for Gaussians also the
    lossless PLY."""

    def work(self) -> dict[str, Any]:
        say = printer(self.json)
        if not (self.lighting_level or 0.0) >= 0.0 or not abs(self.exposure_ev or 0.0) <= EV_MAX:
            raise BadValueError(
                f"cannot bake at EV {self.exposure_ev or 0.0}, lighting level {self.lighting_level or 0.0}",
                f"Give an EV of −{EV_MAX:g} to {EV_MAX:g} and a lighting level of 0 or more.",
            )
        run = open_run(self.source, self.data, report=say, pictures=False)
        levels = requested_levels(
            self.lighting_level, self.lighting_levels, run.method.lights, run.method.standard_levels
        )
        out = writable_folder(self.out or self.source)
        refuse_others(out / CAMERAS_FILE)
        former = _former(out)
        method = run.on_gaussians()
        with progress("confidence", "view", self.json) as show:
            model = run.model(show)
        write_model(out / MODEL_FILE, model)
        for path in former:  # stale now, even if writing new ones fails
            _remove(path)
        without = "" if model.confidence is not None else f"; {NO_CONFIDENCE}"
        say(f"wrote {out / MODEL_FILE}: {method.size} Gaussians, for Blender{without}")

        write_camera_list(out / CAMERAS_FILE, run.camera_list())
        learned = "" if run.twists is None else ", with learned poses"
        say(f"wrote {out / CAMERAS_FILE}: its cameras{learned}")

        ev = model.developed_ev if self.exposure_ev is None else self.exposure_ev
        if self.quick:  # colours fitted to the method's images may have any level
            levels = model.known_levels(levels)
        look, exposure = look_words(ev, levels, model.lights), 2.0**ev
        colours = display_colour_sh(model, exposure, levels)
        if not self.quick:
            cameras = [view.camera for view in run.scene.train]
            with progress("colours", "step", self.json) as show:
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
        say(f"wrote {out / BAKED_FILE}: for any 3DGS viewer, baked at {look}")

        if not run.method.backbone.is_fixed:
            say("no lossless.ply: this run's Gaussians differ from view to view")
            return {"folder": str(out), "gaussians": method.size}
        comments.append("phys_ columns and phys_network lines hold the model, scene-linear; keep these")
        write_lossless_ply(
            out / LOSSLESS_FILE,
            standard_columns(**standard),
            parameter_columns(method.gaussians, method.lights) | confidence_column(model),
            comments + network_comments(method, model),
        )
        say(f"wrote {out / LOSSLESS_FILE}: every parameter")
        return {"folder": str(out), "gaussians": method.size}


def _former(out: Path) -> list[Path]:
    """The PLY files of an earlier export in ``out``; raises ``OutputError`` for one of another origin."""
    former = []
    for path in (out / BAKED_FILE, out / LOSSLESS_FILE):
        try:
            head = _head(path) if stat.S_ISREG(path.stat().st_mode) else b""
        except FileNotFoundError:
            continue
        except OSError:  # unreadable files are not replaced
            head = b""
        if f"\ncomment {PROVENANCE}".encode() not in head:
            raise OutputError(
                f"{path} exists, and 'physhdr export' did not write it",
                "Give another folder, or move it away.",
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
            f"cannot replace {path}, which belongs to another model: {error.strerror or error}",
            "Close the program that has it open, or remove it, and export again.",
        ) from error
