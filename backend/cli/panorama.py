# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render --at``: panoramas of the light at a place in a trained model, for lighting a scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro

from ...bridge.errors import BadValueError
from ...bridge.gaussian_ply import UP_WORDS
from ...bridge.limits import check_position
from ...bridge.model_file import Model, read_model
from ...bridge.panorama import near_distance
from ...bridge.ply_model import read_ply_model
from ...bridge.probe import WIDTH, Probe, begin, check_width, finish
from ...bridge.signals import caught, interrupt
from ..evaluate.panorama import SPLATS_WIDTH, Draw, Report, lit_model, surroundings
from ..methods.base import Method
from ..project import version
from ..rasterize import Implementation
from ..runs.run import open_run
from ..scene import Camera
from ..scene.pictures import write_exr
from .options import changed_options
from .output import printer, write_json
from .rendering import Rendering

#: Printed for a model that cannot separate its lights.
NO_LIGHTS = "its lights cannot be separated: fixed.exr is all of its light, and levels do not change it"

#: A place, and a panorama's rows, are in the file's own axes, as in Blender when it imports the file.
OTHER_AXES = (
    "{} has {}: --at and the panorama are in these axes, not upright. To have +Z up, convert it to a model "
    "first: physhdr export IN OUT.safetensors"
)


@dataclass(frozen=True, kw_only=True)
class PlaceOptions:
    """The light from all directions at a place: a folder with fixed.exr and an .exr per light
    (equirectangular, scene-linear, 32 bits), which add up to the light at any levels, and probe.json."""

    #: The place: X Y Z in metres, in the model's space. For several places, repeat --at and --out.
    at: Annotated[tuple[tuple[float, float, float], ...], tyro.conf.UseAppendAction] = ()
    #: Metres: ignore Gaussians nearer than this. Default: a fiftieth of their median distance.
    near: float | None = None


@dataclass(frozen=True, kw_only=True)
class Panorama(Rendering, PlaceOptions):
    """Render light probes: the light from all directions at places in a trained model."""

    def work(self) -> dict[str, Any]:
        with caught(interrupt), torch.no_grad():
            return {"probes": self._probes()}

    def _probes(self) -> list[dict[str, Any]]:
        if len(self.at) != len(self.out):
            raise BadValueError(
                f"{len(self.at)} places for {len(self.out)} folders", "Give an --out for each --at."
            )
        for place in self.at:
            check_position(place, "--at")
        if self.near is not None and not self.near >= 0.0:
            raise BadValueError(f"--near must be 0 m or more, got {self.near}")
        width = WIDTH if self.width is None else self.width
        check_width(width)
        model = self._opened()
        results, say = [], printer(self.json)
        for number, (place, folder) in enumerate(zip(self.at, self.out, strict=True)):

            def report(done: float, number: int = number, folder: Path = folder) -> None:
                if self.json:
                    write_json(progress=(number + done) / len(self.at), message=folder.name)

            probe = self._probe(model, place, width, folder, report)
            results.append({"folder": str(folder), "unseen": probe.unseen})
            say(
                f"wrote {folder}: {', '.join(probe.files)}; {probe.unseen:.1%} of the sphere was never "
                f"seen and is filled from its rim; ignored {probe.left_out} Gaussians within "
                f"{probe.near:.3g} m or around the place"
            )
            if not probe.lights:
                say(NO_LIGHTS)
        return results

    def _opened(self) -> "_OfModel | _OfMethod":
        if self.source.is_dir():
            run = open_run(
                self.source, self.data, self.rasteriser, self.device, printer(self.json), pictures=False
            )
            return _OfMethod(run.method, run.radiance_scale)
        if changed := changed_options(self, "data", "device"):
            raise BadValueError(
                f"--{changed[0]} only applies to a run, and {self.source} is not a folder", "Leave it out."
            )
        if self.source.suffix.lower() != ".ply":
            return _OfModel(read_model(self.source), self.rasteriser)
        read, say = read_ply_model(self.source), printer(self.json)
        for note in read.notes:
            say(note)
        if read.up != "z":
            say(OTHER_AXES.format(self.source.name, UP_WORDS[read.up]))
        return _OfModel(read.model, self.rasteriser)

    def _probe(
        self,
        model: "_OfModel | _OfMethod",
        place: Sequence[float],
        width: int,
        folder: Path,
        report: Report,
    ) -> Probe:
        near = near_distance(model.positions, np.asarray(place)) if self.near is None else self.near
        begin(folder)
        found = surroundings(model.draw(place, near), place, width, report, model.drawn_width)
        x, y, z = place
        probe = Probe(
            at=(x, y, z),
            width=width,
            lights=model.lights,
            unseen=found.unseen,
            near=near,
            left_out=model.left_out,
            gaussians=len(model.positions),
            made_by=f"physhdr {version()}",
            source=str(self.source.absolute()),
        )
        for name, part in zip(probe.files, found.parts, strict=True):
            write_exr(folder / name, part)
        finish(folder, probe)
        return probe


class _OfModel:
    """A model file's light. ``left_out``: Gaussians too near to the last rendered place."""

    drawn_width = SPLATS_WIDTH

    def __init__(self, model: Model, implementation: Implementation) -> None:
        self._model = model
        self._implementation: Implementation = implementation
        self.lights = model.lights if model.light_share is not None else ()
        self.positions, self.left_out = model.position, 0

    def draw(self, place: Sequence[float], near: float) -> Draw:
        splats = lit_model(self._model, place)
        beyond = splats.beyond(place, near)
        self.left_out = len(splats.means) - len(beyond.means)
        return lambda camera: beyond.drawn(camera, self._implementation)


class _OfMethod:
    """A trained method's light times ``scale``. Its splats may differ for every image."""

    def __init__(self, method: Method, scale: float) -> None:
        self._method, self._scale, self.left_out = method, scale, 0
        self.lights = method.lights_apart
        self.positions = method.backbone.positions.detach().cpu().numpy()
        self.drawn_width = SPLATS_WIDTH if len(self.positions) else 0

    def draw(self, place: Sequence[float], near: float) -> Draw:
        self.left_out = 0

        def draw(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
            parts, alpha, left_out = self._method.parts_beyond(camera, place, near)
            self.left_out = max(self.left_out, left_out)
            return parts * self._scale, alpha

        return draw
