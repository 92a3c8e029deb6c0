# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders what methods are measured against, with less noise than the views that are trained on.

Two things make it cheap, both measured on the built-in scenes (lab/data/README.md).

- *In turn.* Light transport is linear in each light, so a picture is the sum of one under the ambient light
  alone and one under the lamps alone. Nearly all noise is of the sun and the sky by way of a bounce, and
  while many lamps burn Cycles seldom asks for the sun; alone, the ambient light has 1 to 7 dB less noise for
  the same samples, and the lamps are good enough with a part of them.
- *In passes of* ``PASS`` *samples*, each denoised by itself, of which the truth is the mean. One denoised
  picture gains 1.5 dB with every doubling of its samples: the denoiser trusts them more and smooths less.
  A mean of denoised ones gains 3 dB, until their common bias is all that is left: passes must be large enough
  that it is small.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np

from ..bridge.lights import AMBIENT
from . import compositor, noise
from .blender import cycles
from .errors import NotFiniteRenderError
from .passes import Passes
from .renderer import Renderer, view_seed
from .stage import Stage

#: Samples of what is denoised at once. Measured in ``interior`` at the longest exposure: the bias of 256 is
#: 43.8 dB, that of 1,024 is 47.2.
PASS = 1024
#: Of the samples of the ambient light, those of the lamps.
LAMPS_SHARE = 0.375


def passes_of(samples: int) -> list[int]:
    """Samples of each pass, as even as can be."""
    count = max(1, round(samples / PASS))
    return [samples * (k + 1) // count - samples * k // count for k in range(count)]


@dataclass(frozen=True)
class TruthRenderer:
    """Renders with ``samples`` a pixel under the ambient light, and a share of them under the lamps.

    Lights that nothing turns, as in a user's scene, all shine at once, with ``samples``.
    """

    camera: Renderer
    samples: int

    def render(self, pose: np.ndarray, seed: int, scratch: Path) -> Passes:
        """As ``Renderer.render``, with the samples of all pictures together. Raises what that raises."""
        done = [
            self.once(samples, pose, pass_seed(seed, k), scratch)
            for k, samples in enumerate(passes_of(self.samples))
        ]
        weights = [samples / self.samples for samples in passes_of(self.samples)]
        lights = {name: _mean([each.lights[name] for each in done], weights) for name in done[0].lights}
        raw = _mean([_raw(each) for each in done], weights)
        whole = reduce(np.add, lights.values()) if self.camera.denoise else None
        taken = reduce(np.add, [each.samples for each in done])
        return Passes(
            lights,
            depth=done[0].depth,
            normal=_mean([each.normal for each in done], weights),
            index=done[0].index,
            samples=taken,
            facts={
                "seed": seed,
                "samples": round(float(taken.mean()), 3),
                "noise_psnr": noise.estimate(raw, whole),
            },
            raw=raw,
        )

    def once(self, samples: int, pose: np.ndarray, seed: int, scratch: Path) -> Passes:
        """One pass. Raises what ``Renderer.render`` raises."""
        with self._careful():
            parts = [
                (names, self._part(names, count, pose, seed, scratch))
                for names, count in self._turns(samples)
            ]
        lights = {name: part.lights[name] for names, part in parts for name in names}
        first = parts[0][1]
        return Passes(
            {name: lights[name] for name in self.camera.stage.lights},
            depth=first.depth,
            normal=first.normal,
            index=first.index,
            samples=reduce(np.add, [part.samples for _, part in parts]),
            facts=first.facts,
            raw=reduce(np.add, [_raw(part) for _, part in parts]),
        )

    def _turns(self, samples: int) -> list[tuple[tuple[str, ...], int]]:
        """The lights that shine together, and the samples for them; all at once where none can be turned."""
        stage = self.camera.stage
        lamps = tuple(name for name in stage.lights if name != AMBIENT)
        if AMBIENT not in stage.lights or not lamps or not all(stage.lights.values()):
            return [(tuple(stage.lights), samples)]
        return [((AMBIENT,), samples), (lamps, max(1, round(LAMPS_SHARE * samples)))]

    def _part(
        self, names: tuple[str, ...], samples: int, pose: np.ndarray, seed: int, scratch: Path
    ) -> Passes:
        """All samples in every pixel; once more, with other noise, where a value is no number."""
        settings = cycles(self.camera.stage.scene)
        former = settings.samples, settings.use_adaptive_sampling
        settings.samples, settings.use_adaptive_sampling = samples, False
        try:
            with _only(self.camera.stage, names):
                try:
                    return self.camera.render(pose, seed, scratch)
                except NotFiniteRenderError:
                    return self.camera.render(pose, view_seed(seed, "finite"), scratch)
        finally:
            settings.samples, settings.use_adaptive_sampling = former

    @contextmanager
    def _careful(self) -> Iterator[None]:
        """Guides that are denoised before the picture: 0.5 to 0.8 dB, at the cost of a second per picture."""
        outlet = self.camera.outlet
        outlet.prefilter(compositor.BEFORE)
        try:
            yield
        finally:
            outlet.prefilter(compositor.TOGETHER)


def pass_seed(seed: int, index: int) -> int:
    """Cycles seed of a pass: the first has the view's own."""
    return seed if index == 0 else view_seed(seed, f"pass {index}")


@contextmanager
def _only(stage: Stage, names: tuple[str, ...]) -> Iterator[None]:
    """Every light but these is off."""
    off = [knob for name, knobs in stage.lights.items() if name not in names for knob in knobs]
    try:
        for knob in off:
            setattr(knob.owner, knob.attribute, 0.0)
        yield
    finally:
        for knob in off:
            setattr(knob.owner, knob.attribute, knob.base)


def _raw(rendered: Passes) -> np.ndarray:
    assert rendered.raw is not None
    return rendered.raw


def _mean(pictures: list[np.ndarray], weights: list[float]) -> np.ndarray:
    total = sum(
        weight * picture.astype(np.float64) for weight, picture in zip(weights, pictures, strict=True)
    )
    return np.asarray(total, np.float32)
