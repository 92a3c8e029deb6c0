# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians, pictures and whole training runs made of random numbers: no data set is needed."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import torch

from physhdr.backend.model.morton import morton_order
from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import SRGB
from physhdr.backend.scene.scene import PictureCache, Points, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource, plain
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.optimisers import Optimiser, OptimiserConfig
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.state import State
from physhdr.backend.train.trainer import step

SIZE = 400  # pixels of a side
EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)
ANCHOR = (1.0, 0.5 ** (1.0 / 2.2))

#: Where in a training the timed iterations are: SH at its full degree, f_mix learning.
PROGRESS = 0.9

#: So small that nothing moves: every timed iteration then does the same work.
STANDSTILL = OptimiserConfig(
    **{f.name: 1e-12 for f in dataclasses.fields(OptimiserConfig) if f.type is float}
)


def gaussians(
    count: int, channels: int, size: int = SIZE, seed: int = 0
) -> tuple[list[torch.Tensor], Camera]:
    """Gaussians spread over the view, 1–5 m away; opacity 0.1–0.9; footprints of 7 px on average (at 400²).

    Means, quaternions, scales, opacities, colours as ``rasterize`` takes them, and the camera.
    """
    generator = torch.Generator().manual_seed(seed)
    depth = 1.0 + 4.0 * torch.rand(count, generator=generator)
    x, y = (torch.rand(2, count, generator=generator) - 0.5) * 1.2 * depth
    tensors = [
        torch.stack([x, y, -depth], dim=1),
        torch.randn(count, 4, generator=generator),
        0.005 * torch.exp(torch.rand(count, 3, generator=generator) * math.log(4.0)),
        0.1 + 0.8 * torch.rand(count, generator=generator),
        torch.rand(count, channels, generator=generator),
    ]
    order = morton_order(tensors[0])  # as training keeps them
    return [t[order].requires_grad_() for t in tensors], camera(np.zeros(3), size)


def camera(position: np.ndarray, size: int = SIZE) -> Camera:
    """At ``position``, looking down −Z."""
    pose = np.eye(4)
    pose[:3, 3] = position
    return Camera.from_field_of_view(pose, size, size, 2.0 * math.atan(0.5))


class MadeUpPictures(PictureCache):
    """Smooth random pictures with a little noise in place of files; each is made once and kept."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size
        self._made: dict[Path, np.ndarray] = {}

    def get(self, source: PictureSource) -> Decoded:
        path = source.path
        if path not in self._made:
            generator = torch.Generator().manual_seed(len(self._made))
            coarse = torch.rand(1, 3, 12, 12, generator=generator)
            smooth = torch.nn.functional.interpolate(coarse, (self.size, self.size), mode="bicubic")[0]
            noisy = smooth + 0.05 * torch.randn(3, self.size, self.size, generator=generator)
            self._made[path] = (255.0 * noisy.clamp(0, 1)).byte().permute(1, 2, 0).contiguous().numpy()
        return Decoded(self._made[path])


def scene(points: np.ndarray, views: int, size: int = SIZE) -> Scene:
    """``views`` training views beside each other, a bracket of five exposures each, and ``points``."""
    pictures = MadeUpPictures(size)
    train = [
        View(
            name=f"train/r_{i}",
            camera=camera(np.array([0.1 * math.cos(i), 0.1 * math.sin(i), 0.0]), size),
            exposures=EXPOSURES,
            sources=plain(Path(f"r_{i}_{k}.png") for k in range(len(EXPOSURES))),
            index=i,
            cache=pictures,
        )
        for i in range(views)
    ]
    grey = np.full_like(points, 0.5)
    return Scene(Path("synthetic"), "synthetic", train, [], [], Points(points, grey), ANCHOR)


def untrained_state(config: TrainConfig, count: int, views: int = 5, size: int = SIZE) -> State:
    """A training run of ``config`` whose Gaussians have the shapes and opacities of ``gaussians``."""
    (means, quaternions, scales, opacities, _), _ = gaussians(count, 3, size)
    # Stereo would find more in the pictures, and their exposures have nothing to do with each other.
    config = dataclasses.replace(config, initial_points="file", merged_brackets="off")
    result = begin(scene(means.detach().numpy(), views, size), config)
    parameters = result.method.gaussians.parameters
    with torch.no_grad():
        parameters["quaternions"].copy_(quaternions)
        parameters["log_scales"].copy_(scales.log())
        parameters["opacity_logits"].copy_(opacities.logit())
    return result


class DrawnPictures(PictureCache):
    """Pictures of Gaussians that are not the training's first: what a training can learn to show.

    They are developed by the sRGB curve at each view's exposures.
    """

    def __init__(self, truth: list[torch.Tensor], views: list[View]) -> None:
        super().__init__()
        self._views = {source.path: (view, k) for view in views for k, source in enumerate(view.sources)}
        self._truth, self._made = truth, dict[Path, np.ndarray]()

    def get(self, source: PictureSource) -> Decoded:
        if source.path not in self._made:
            view, k = self._views[source.path]
            with torch.no_grad():
                drawn = rasterize(*self._truth, view.camera, implementation="cpu").image
                shown = SRGB.developed(drawn * view.exposures[k])
            self._made[source.path] = (255.0 * shown).byte().permute(1, 2, 0).contiguous().numpy()
        return Decoded(self._made[source.path])


#: So many iterations a trained state has behind it.
LEARNED = 300


def trained_state(preset: str, count: int, size: int = SIZE, learned: int = LEARNED) -> State:
    """``steady_state`` after ``learned`` iterations with the preset's own rates, on pictures of Gaussians.

    An untrained state is unlike any other: of `paper` most gradients are denormal. The number of Gaussians
    stays the same.
    """
    result = steady_state(preset, count, size)
    truth, _ = gaussians(max(count // 10, 100), 3, size, seed=1)
    pictures = DrawnPictures([t.detach() for t in truth], result.views)
    for index, view in enumerate(result.views):
        result.views[index] = dataclasses.replace(view, cache=pictures)
    at_standstill = result.optimiser
    rates = PRESETS[preset].optimiser
    result.optimiser = Optimiser(result.method, rates, at_standstill.extent, result.config.iterations)
    for _ in range(learned):
        step(result)
    at_standstill.adam = result.optimiser.adam  # a training's moments, and rates that move nothing
    result.optimiser = at_standstill
    result.iteration = int(PROGRESS * result.config.iterations)
    return result


def steady_state(preset: str, count: int, size: int = SIZE) -> State:
    """A run whose every step is an iteration of late training: full SH, f_mix learning, gradients observed.

    Densification is not due, and the learning rates are next to nothing, so that the work stays the same.
    """
    config = PRESETS[preset]
    result = untrained_state(
        dataclasses.replace(
            config,
            iterations=30_000,
            optimiser=STANDSTILL,
            backbone=dataclasses.replace(config.backbone, stop=1.0, every=1 << 30, reset_every=0),
            method=dataclasses.replace(
                config.method,
                tone_mapper=dataclasses.replace(config.method.tone_mapper, warm_start_steps=0),
            ),
        ),
        count,
        size=size,
    )
    result.iteration = int(PROGRESS * result.config.iterations)
    return result
