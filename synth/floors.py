# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the truth can be trusted, measured on the middle test view (dataset.json's two floors).

``noise_floor``: against a second render of it with other noise. Two denoised pictures may share one bias, so
where the truth has samples of its own there is ``reference_floor``, too: against two renders without
denoising, whose own noise drops out of a mean of products (``noise.floor_of_limit``). These are made in
chunks, files of their own, so that they can be interrupted and shared.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..bridge.data_set import TEST
from . import exr, folder, noise
from .options import Options
from .passes import Passes
from .plan import Shot
from .renderer import Renderer, view_seed
from .response import Response
from .truth import TruthRenderer

#: The folder of the reference's chunks, removed once the floor is known.
CHUNKS = ".reference"


@dataclass(frozen=True)
class Chunk:
    """A part of the reference: the view once more, with noise of its own."""

    out: Path
    options: Options
    shot: Shot
    index: int
    samples: int

    @property
    def name(self) -> str:
        return f"reference_{self.index:03d}"

    @property
    def path(self) -> Path:
        return self.out / CHUNKS / f"{self.name}.exr"

    def make(self, camera: Renderer) -> None:
        """Render it. Raises what ``Renderer.render`` raises."""
        seed = view_seed(self.options.seed, f"{self.shot.name}/{self.name}")
        rendered = TruthRenderer(camera, self.samples).render(self.shot.pose, seed, folder.scratch(self.path))
        assert rendered.raw is not None
        folder.write(self.path, exr.encode_rgb(rendered.raw))


def view(shots: list[Shot]) -> Shot:
    """The middle test view, on which floors are measured."""
    tests = [shot for shot in shots if shot.split == TEST]
    return tests[len(tests) // 2]


def count(options: Options) -> int:
    """Chunks of the reference; 0 where it is not asked for."""
    if not options.reference:
        return 0
    assert options.test_samples is not None
    return max(2, round(options.reference / options.test_samples))


def chunks(out: Path, options: Options, shot: Shot) -> list[Chunk]:
    """Of ``options.reference`` samples, as many in each as the truth has; none where it is not asked for."""
    many = count(options)
    each = -(-options.reference // max(1, many))
    return [Chunk(out, options, shot, index, each) for index in range(many)]


def noise_floor(
    shot: Shot, first: Passes, second: Passes, response: Response, options: Options
) -> dict[str, Any]:
    """The entry of dataset.json of two renders of ``shot``."""
    a, b = (each.radiance(shot.levels) for each in (first, second))
    seeds = [first.facts["seed"], second.facts["seed"]]
    return {"view": shot.index, "seeds": seeds, **noise.floor(a, b, response, options.bracket)}


def halves(parts: list[Chunk]) -> tuple[np.ndarray, np.ndarray]:
    """The mean of the even and of the odd chunks, which are at least two."""
    pictures = np.stack([exr.read(part.path).astype(np.float64) for part in parts])
    return pictures[0::2].mean(0), pictures[1::2].mean(0)


def reference_floor(
    truth: np.ndarray,
    reference: tuple[np.ndarray, np.ndarray],
    response: Response,
    exposures: tuple[float, ...],
) -> dict[str, Any]:
    """``truth`` [height, width, 3] against what both halves of the reference have in common.

    ``own`` tells how noisy these are, [height, width, 3] each: what they agree to.
    """
    # Differences of passes are a rounding below 0 where a light does not reach.
    first, second = (np.maximum(each, 0.0).astype(np.float32) for each in reference)
    entry = noise.floor_of_limit(truth, (first, second), response, exposures)
    return {**entry, "own": noise.floor(first, second, response, exposures)}
