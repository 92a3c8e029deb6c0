# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders a run's confidence and compares it with truth, for ``physhdr render`` and ``physhdr evaluate``."""

import json
from pathlib import Path

import numpy as np
import torch

from ...bridge.atomic import atomic_path
from ...bridge.confidence import MEANING, colours
from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.limits import check_position
from ...bridge.panorama import near_distance
from ...bridge.probe import check_width
from ..evaluate import truth
from ..evaluate.confidence import CALIBRATION_FILES, PARTS, Calibration, calibration, log_error
from ..evaluate.panorama import LitSplats, surroundings
from ..evaluate.pictures import compared_everywhere
from ..evaluate.results import VIEWS_OF
from ..export.confidence import confidence_picture
from ..methods.base import Method
from ..runs.run import Run
from ..scene import Camera
from ..scene.pictures import write_exr, write_png
from .output import progress

#: Rows of the legend below a picture, and of black above it.
LEGEND, GAP = 12, 4


def gaussians_with_confidence(run: Run) -> tuple[Method, np.ndarray]:
    """The method on plain Gaussians and their confidence ``[N]``.

    Raises ``FileMissingError`` where the training pictures, from which it is computed, are missing.
    """
    method = run.on_gaussians()
    with progress("confidence", "view", as_json=False) as show:
        found = run.confidence(method, show)
    if found is None:
        raise FileMissingError(
            f"the pictures that {run.folder} was trained on are missing: {run.scene.root}",
            "Give the data set's present folder: --data DATA",
        )
    return method, found


def write_confidence(run: Run, camera: Camera, out: Path) -> list[Path]:
    """Render the confidence seen by ``camera``: numbers as .exr, colours with a legend as .png.

    ``out``: either of the two; the other is written next to it. Raises as ``gaussians_with_confidence``.
    """
    method, found = gaussians_with_confidence(run)
    return _write(confidence_picture(method, found, camera).image.numpy().transpose(1, 2, 0), out)


def write_confidence_around(run: Run, at: tuple[float, float, float], width: int, out: Path) -> list[Path]:
    """``write_confidence`` in all directions, for each pixel of the panorama of ``physhdr render --at``.

    0 where the panorama fills what was never seen. Raises as ``check_position`` and ``check_width``.
    """
    check_position(at, "--at")
    check_width(width)
    method, found = gaussians_with_confidence(run)
    sure = torch.from_numpy(found)[:, None].expand(-1, 3).contiguous()
    near = near_distance(method.gaussians.positions.detach().numpy(), np.asarray(at))

    def draw(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
        splats = method.backbone.splats(camera, method.active_sh_degree)
        shape = (splats.means, splats.quaternions, splats.scales, splats.opacities)
        parts, _ = LitSplats(*shape, sure[None]).beyond(at, near).drawn(camera, "auto")
        # All of it counts as covered: confidence 0 is a value, not a hole to fill.
        return parts, torch.ones_like(parts[0, 0])

    with torch.no_grad():
        return _write(surroundings(draw, at, width).parts[0], out)


def _write(picture: np.ndarray, out: Path) -> list[Path]:
    """Write ``[H, W, 3]`` as both files."""
    paths = [out.with_suffix(".exr"), out.with_suffix(".png")]
    # Data, not colours: colour management must not change these numbers.
    write_exr(paths[0], picture, {"physhdr": f"confidence: {MEANING}", "colorInteropID": "data"})
    write_png(paths[1], with_legend(picture[..., 0]))
    return paths


def with_legend(confidence: np.ndarray) -> np.ndarray:
    """``[H + GAP + LEGEND, W, 3]`` uint8: ``[H, W]`` in colours, below it the colours of 0 to 1."""
    width = confidence.shape[1]
    bar = np.broadcast_to(colours(np.linspace(0.0, 1.0, width)), (LEGEND, width, 3))
    shown = np.concatenate([colours(confidence), np.zeros((GAP, width, 3)), bar])
    return np.round(255.0 * shown).astype(np.uint8)


def write_calibration(run: Run, split: str, out: Path) -> Calibration:
    """Compare confidence with the true radiance of a split's views; write ``CALIBRATION_FILES`` into ``out``.

    Raises ``BadValueError`` where there are no such views, no truth for them, or too few pixels.
    """
    views = run.scene.splits[split]
    if not views or not truth.has_hdr_truth(run.scene.root, split):
        raise BadValueError(
            f"{run.scene.root} has no true radiance of {VIEWS_OF[split]} to compare confidence with",
            "Leave out --confidence, or choose the other --split.",
        )
    method, found = gaussians_with_confidence(run)
    sure, drawn, true = [], [], []
    for view in views:
        confidence = confidence_picture(method, found, view.camera).image[0]
        ours, theirs = method.hdr(view.camera), truth.hdr_truth(run.scene.root, split, view.index)
        if ours.shape != theirs.shape:
            raise BadValueError(
                f"the true radiance of {view.name} is not of the training size",
                "Train without --downscale to compare confidence with it.",
            )
        mask = compared_everywhere(view)
        mask = torch.ones_like(confidence, dtype=torch.bool) if mask is None else mask
        sure.append(confidence[mask].numpy())
        drawn.append(ours[:, mask].numpy())
        true.append(theirs[:, mask].numpy())
    if (compared := sum(len(each) for each in sure)) < PARTS:
        raise BadValueError(
            f"only {compared} pixels of the {VIEWS_OF[split]} are not masked: confidence needs {PARTS}",
            "Leave out --confidence, or mask less.",
        )
    table = calibration(np.concatenate(sure), log_error(drawn, true))
    content = {"split": split, **table.described()}
    texts = (json.dumps(content, indent=1, allow_nan=False) + "\n", table.markdown())
    for name, text in zip(CALIBRATION_FILES, texts, strict=True):
        with atomic_path(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return table
