# SPDX-License-Identifier: GPL-3.0-or-later
"""A small scene in memory whose pictures are known: Gaussians seen through a known camera response."""

import dataclasses
from pathlib import Path

import numpy as np
import torch

from physhdr.backend.model.gaussians import SH_C0, Gaussians
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.scene import PictureCache, Points, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource, plain
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.state import State

from .side import Side

EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)
#: The response is (x/(1 + x))^(1/2.2).
ANCHOR = (1.0, 0.5 ** (1.0 / 2.2))
BACKGROUND = 0.01  # radiance: nothing is black
FIELD_OF_VIEW = 0.9


class InMemory(PictureCache):
    """Pictures by name, from nowhere else."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures: dict[Path, np.ndarray] = {}

    def get(self, source: PictureSource) -> Decoded:
        return Decoded(self.pictures[source.path])


def pose(x: float, z: float) -> np.ndarray:
    """Camera to world at (x, −4, z), looking at the origin, Z up."""
    position = np.array([x, -4.0, z])
    backward = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    result = np.eye(4)
    result[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=1)
    result[:3, 3] = position
    return result


def scene(size: int, gaussians: int, views: int = 12, seed: int = 0) -> Scene:
    """Every third of ``views`` poses is for testing; the points are the Gaussians' centres, a bit moved."""
    rng = np.random.default_rng(seed)
    spread = 0.6 * gaussians ** (-1 / 3)
    points = rng.uniform(-1.2, 1.2, (gaussians, 3))
    truth = [
        torch.tensor(a, dtype=torch.float32)
        for a in (
            points,
            rng.normal(size=(gaussians, 4)),
            rng.uniform(spread, 3 * spread, (gaussians, 3)),
            rng.uniform(0.5, 0.95, gaussians),
            np.exp(rng.uniform(-3.0, 1.5, (gaussians, 3))),
        )
    ]
    cache = InMemory()
    splits: dict[str, list[View]] = {"train": [], "test": []}
    for i, angle in enumerate(np.linspace(-1.0, 1.0, views)):
        camera = Camera.from_field_of_view(
            pose(1.5 * angle, 0.5 * np.sin(7.0 * angle)), size, size, FIELD_OF_VIEW
        )
        radiance = rasterize(*truth, camera).image.permute(1, 2, 0).numpy() + BACKGROUND
        split = "test" if i % 3 == 1 else "train"
        names = tuple(Path(f"{split}/r_{i}_{k}.png") for k in range(len(EXPOSURES)))
        for name, exposure in zip(names, EXPOSURES, strict=True):
            x = radiance * exposure
            cache.pictures[name] = np.round(255.0 * (x / (1.0 + x)) ** (1.0 / 2.2)).astype(np.uint8)
        splits[split].append(View(f"{split}/r_{i}", camera, EXPOSURES, plain(names), i, cache=cache))
    moved = (points + rng.normal(scale=0.3 * spread, size=points.shape)).astype(np.float32)
    first = Points(moved, np.full_like(moved, 0.5))
    return Scene(Path("in memory"), "truth", splits["train"], splits["test"], [], first, ANCHOR)


def short(preset: str, iterations: int) -> TrainConfig:
    """The preset with everything that it does over a training within ``iterations``."""
    config = PRESETS[preset]
    warm = min(config.method.tone_mapper.warm_start_steps, iterations)
    tone_mapper = dataclasses.replace(config.method.tone_mapper, warm_start_steps=warm)
    sixth = max(1, iterations // 6)
    return dataclasses.replace(
        config,
        iterations=iterations,
        sh_degree_every=sixth,
        method=dataclasses.replace(config.method, tone_mapper=tone_mapper),
        backbone=dataclasses.replace(
            config.backbone,
            start=sixth - 1,
            every=sixth,
            stop=0.7,
            reset_every=2 * sixth if config.backbone.reset_every else 0,
            prune_scale=10.0,
        ),
    )


def begin_on(scene: Scene, config: TrainConfig, side: Side) -> State:
    """A training on a side that starts from plain grey Gaussians at the scene's points.

    A training's own start looks for neighbours with SciPy, which may not be there; nor are brackets merged,
    which needs it, too.
    """
    points = scene.points
    assert points is not None

    def placing(state: State, nuisances: object) -> None:
        state.method.backbone.parameters = grey_gaussians(points.positions, config).parameters

    config = dataclasses.replace(config, merged_brackets="off")
    return begin(scene, config, side.implementation, side.device, placing)


def grey_gaussians(positions: np.ndarray, config: TrainConfig) -> Gaussians:
    """Spheres of radiance ½ at ``positions`` ``[P, 3]``, as large as their mean distance."""
    method, count = config.method, len(positions)
    extent = float(np.ptp(positions, axis=0).max())
    parameters = {
        "means": torch.tensor(positions, dtype=torch.float32),
        "log_scales": torch.full((count, 3), float(np.log(0.5 * extent * count ** (-1 / 3)))),
        "quaternions": torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        "opacity_logits": torch.zeros(count),
        "reflectance_dc": torch.full((count, 1, 3), float(np.log(0.5)) / SH_C0),
        "reflectance_rest": torch.zeros(count, (method.sh_degree + 1) ** 2 - 1, 3),
        "log_illumination": torch.zeros(count, 1),
    }
    if method.has_light_share:
        parameters["light_share_logits"] = torch.zeros(count, 1, 3)
    if method.tone_mapper.local:
        generator = torch.Generator().manual_seed(config.seed)
        size = method.tone_mapper.context_size
        parameters["context"] = 0.01 * torch.randn(count, size, generator=generator)
    return Gaussians({name: tensor.requires_grad_() for name, tensor in parameters.items()})


@torch.no_grad()
def psnr_of_test_views(state: State) -> float:
    """Mean PSNR in dB of the LDR prediction over all test views and training exposures."""
    values = []
    for view in state.plan.seen.scene.test:
        for k in state.config.training_exposures:
            picture = torch.tensor(view.image(k)).permute(2, 0, 1) / 255.0
            drawn = state.method.ldr(view.camera, view.exposures[k]).clamp(0, 1).cpu()
            values.append(-10.0 * float((drawn - picture).square().mean().log10()))
    return sum(values) / len(values)
