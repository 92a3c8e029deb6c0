# SPDX-License-Identifier: GPL-3.0-or-later
"""Train on a data set in a plain loop, with the library's parts: data set in, picture and radiance out.

    .venvs/backend/bin/python docs/example.py DATA OUT [ITERATIONS]

It begins as the preset ``default`` does: at the data set's points and those of stereo, with the response that
the brackets show. The iteration is written out, to be changed: brackets, a learned response, growth, lights
that can be turned. Left out: half sizes at first, the parts that photographs need, checkpoints.
"""

import sys
from pathlib import Path

import torch

from physhdr.backend.methods.base import Drawn
from physhdr.backend.methods.losses import LossConfig, reconstruction_loss
from physhdr.backend.methods.physhdr import PhysHDR
from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.pictures import write_exr, write_png
from physhdr.backend.scene.scene import Scene, View
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.growing import Growing


def draw(method: PhysHDR, view: View, levels: tuple[float, ...], sh_degree: int = 3) -> Drawn:
    """The view's radiance ``[3, H, W]`` under ``levels`` of the lights: raster(L_a (s·l + 1 − s) · H_r)."""
    splats = method.backbone.splats(view.camera, sh_degree)
    log_light = method.modulator(splats.log_illumination, levels, splats.light_share)
    colours = method.composer(log_light, splats.log_reflectance)
    offsets = torch.zeros(len(colours), 2, requires_grad=True)  # growth reads their gradient
    shapes = splats.means, splats.quaternions, splats.scales, splats.opacities
    return Drawn(splats, rasterize(*shapes, colours, view.camera, screen_offsets=offsets), offsets)


def train(scene: Scene, iterations: int) -> PhysHDR:
    """Fit the training views and those under other light, at the exposures that training may see."""
    state = begin(scene, TrainConfig(iterations=iterations, nuisances="off", poses="off"))
    method, growing = state.method, state.part(Growing)
    assert isinstance(method, PhysHDR) and growing is not None
    for iteration in range(iterations):
        view, indices = state.draw(iteration)
        drawn = draw(method, view, view.lighting_levels, sh_degree=min(iteration // 150, 3))
        losses = []
        for k in indices:  # one rendering, developed as each exposure records it
            taken = state.data.recording(view, k)
            developed, _ = method.tone_mapper.tone_map(drawn.rasterization.image * taken.exposure, None)
            losses.append(reconstruction_loss(developed, taken.picture, LossConfig()))
        torch.stack(losses).mean().backward()
        growing.growth.observe(drawn, view.camera, iteration)
        state.optimiser.step(iteration)
        growing.growth.control(iteration + 1)
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
