# SPDX-License-Identifier: GPL-3.0-or-later
"""Train on a data set in a plain loop, with the library's parts: data set in, picture and radiance out.

    .venvs/backend/bin/python docs/example.py DATA OUT [ITERATIONS]

The core of the preset ``default``: brackets, a learned response, growth, and lights that can be turned. Left
out: points by stereo, half sizes at first, merged brackets, faults and poses of photographs, checkpoints.
"""

import sys
from pathlib import Path

import numpy as np
import torch

from physhdr.backend.methods.base import Drawn, Facts
from physhdr.backend.methods.losses import LossConfig, reconstruction_loss
from physhdr.backend.methods.physhdr import PhysHDR
from physhdr.backend.methods.physhdr_common import PhysHDRConfig
from physhdr.backend.model.backbone import Start
from physhdr.backend.model.gaussians import Gaussians
from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.pictures import write_exr, write_png
from physhdr.backend.scene.scene import Scene, View
from physhdr.backend.start.initialise import merged_log_radiance, scene_extent
from physhdr.backend.start.response import bracket_response, display_response
from physhdr.backend.train.densify import GaussianGrowth, GaussiansConfig
from physhdr.backend.train.optimisers import Optimiser, OptimiserConfig

RANGE = (-12.0, 12.0)  # of ln radiance


def begin(scene: Scene, exposures: list[tuple[int, ...]]) -> PhysHDR:
    """Gaussians at the data set's points, as bright as the brackets say, and the response that they show."""
    assert scene.points is not None
    config, anchor = PhysHDRConfig(), scene.response_anchor
    backbone = Gaussians(attributes=config.attributes(scene.lights))
    method = PhysHDR(config, backbone, Facts(anchor, lights=scene.lights, log_radiance_range=RANGE))
    response = bracket_response(scene.train, exposures, anchor) or display_response(anchor)
    method.tone_mapper.begin_with(*response)
    positions = scene.points.positions.astype(np.float64)
    log_radiance = merged_log_radiance(positions, scene.train, exposures, method.tone_mapper, RANGE)
    backbone.place(positions, log_radiance, Start(opacity=0.3))
    return method


def draw(method: PhysHDR, view: View, levels: tuple[float, ...], sh_degree: int = 3) -> Drawn:
    """The view's radiance ``[3, H, W]`` under ``levels`` of the lights: raster(L_a (s·l + 1 − s) · H_r)."""
    splats = method.backbone.splats(view.camera, sh_degree)
    log_light = method.modulator(splats.log_illumination, levels, splats.light_share)
    colours = method.composer(log_light, splats.log_reflectance)
    offsets = torch.zeros(len(colours), 2, requires_grad=True)  # growth reads their gradient
    shapes = splats.means, splats.quaternions, splats.scales, splats.opacities
    return Drawn(splats, rasterize(*shapes, colours, view.camera, screen_offsets=offsets), offsets)


def train(scene: Scene, iterations: int, seed: int = 0) -> PhysHDR:
    """Fit the training views and those under other light, at every second exposure."""
    torch.manual_seed(seed)
    views = scene.train + scene.lit
    exposures = [tuple(k for k, place in enumerate(view.bracket) if place % 2 == 0) for view in views]
    method = begin(scene, exposures[: len(scene.train)])
    optimiser = Optimiser(method, OptimiserConfig(), scene_extent(scene.train), iterations)
    growth = GaussianGrowth(method, optimiser, GaussiansConfig(), iterations, seed=(seed,))
    for iteration in range(iterations):
        at = int(np.random.default_rng([seed, iteration]).integers(len(views)))
        view = views[at]
        drawn = draw(method, view, view.lighting_levels, sh_degree=min(iteration // 150, 3))
        losses = []
        for k in exposures[at]:  # one rendering, developed as each exposure records it
            developed, _ = method.tone_mapper.tone_map(drawn.rasterization.image * view.exposures[k], None)
            picture = torch.tensor(view.values(k), dtype=torch.float32).permute(2, 0, 1).contiguous()
            losses.append(reconstruction_loss(developed, picture, LossConfig()))
        torch.stack(losses).mean().backward()
        growth.observe(drawn, view.camera, iteration)
        optimiser.step(iteration)
        growth.control(iteration + 1)
    return method


@torch.no_grad()
def main(data: Path, out: Path, iterations: int = 500) -> None:
    """Writes the first test view: ``picture.png``, ``radiance.exr``, and ``relit.exr``, lights at a half."""
    scene = read_scene(data)
    with torch.enable_grad():
        method = train(scene, iterations)
    view = scene.test[0]
    standard, half = ((level,) * len(scene.lights) for level in (1.0, 0.5))
    radiance, relit = (draw(method, view, levels).rasterization.image for levels in (standard, half))
    picture, _ = method.tone_mapper.tone_map(radiance * scene.middle_exposure, None)
    out.mkdir(parents=True, exist_ok=True)
    write_png(out / "picture.png", (picture.permute(1, 2, 0) * 255.0).round().byte().numpy())
    write_exr(out / "radiance.exr", radiance.permute(1, 2, 0).numpy())
    write_exr(out / "relit.exr", relit.permute(1, 2, 0).numpy())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:4]))
