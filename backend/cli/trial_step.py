# SPDX-License-Identifier: GPL-3.0-or-later
"""One training step on a synthetic scene in memory, for ``physhdr check``."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from ..device import choose_device
from ..kernels.ahead import compile_ahead
from ..scene import Camera, Points, Scene, View
from ..scene.scene import PictureCache
from ..scene.source import Decoded, PictureSource, plain
from ..train.begin import begin
from ..train.presets import PRESETS, needed_by_presets
from ..train.trainer import step
from .check_report import CheckFailedError

SIZE, VIEWS, POINTS = 48, 3, 200
EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)
ANCHOR = (1.0, 0.5 ** (1.0 / 2.2))
#: Maximum difference of two renderers, as a fraction of the largest value.
TOLERANCE = 1e-3


class MadeUpPictures(PictureCache):
    """A smooth picture for each path, brighter the longer the exposure."""

    def get(self, source: PictureSource) -> Decoded:
        y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
        radiance = np.stack([0.2 + x, 0.2 + y, 1.2 - x], axis=-1) * EXPOSURES[int(source.path.name)]
        codes = np.round(255.0 * (radiance / (1.0 + radiance)) ** (1.0 / 2.2))
        return Decoded(codes.astype(np.uint8))


def device() -> tuple[str, str]:
    """``cpu`` or ``cuda``, and why."""
    chosen, why = choose_device("auto")
    return chosen.type, why


def compile_for_presets(report: Callable[[str, int, int], None]) -> None:
    """Compile the kernels of all presets, so that each starts at once."""
    compile_ahead(needed_by_presets(), report)


def made_up_scene() -> Scene:
    """Three cameras side by side, looking at a cloud of points."""
    pictures = MadeUpPictures()
    views = []
    for index in range(VIEWS):
        pose = np.eye(4)
        pose[:3, 3] = (0.2 * (index - 1), 0.0, 3.0)
        views.append(
            View(
                name=f"train/r_{index}",
                camera=Camera.from_field_of_view(pose, SIZE, SIZE, 2.0 * math.atan(0.5)),
                exposures=EXPOSURES,
                sources=plain(Path(str(k)) for k in range(len(EXPOSURES))),
                index=index,
                cache=pictures,
            )
        )
    positions = np.random.default_rng(0).uniform(-1.0, 1.0, (POINTS, 3)).astype(np.float32)
    points = Points(positions, np.full((POINTS, 3), 0.5, np.float32))
    return Scene(Path("made up"), "made up", views, [], [], points, ANCHOR)


def one_step(where: str) -> tuple[float, int]:
    """The loss of one step of preset ``default``, and the number of Gaussians.

    Raises ``CheckFailedError`` if the loss is not finite, nothing was learned, or the fast and the reference
    renderer disagree.
    """
    scene = made_up_scene()
    state = begin(scene, PRESETS["default"], device=where)
    method, camera = state.method, scene.train[0].camera
    before = {name: t.detach().clone() for name, t in method.backbone.parameters.items()}
    loss = float(sum(step(state).values()))
    after = method.backbone.parameters
    remedy = "Please report this with the log."
    if not math.isfinite(loss):
        raise CheckFailedError(f"a training step's loss is {loss}", remedy)
    if all(torch.equal(after[name], tensor) for name, tensor in before.items()):
        raise CheckFailedError("a training step changed nothing", remedy)
    drawn = method.preview(camera).image
    method.implementation = "reference"
    plain = method.preview(camera).image
    error = float((drawn - plain).abs().max() / plain.max())
    if not error < TOLERANCE:
        raise CheckFailedError(f"the renderer is wrong by {error:.2g} of the brightest value", remedy)
    return loss, method.size
