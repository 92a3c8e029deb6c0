# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole iteration beside its plain-torch alternative, and pictures per second."""

from collections.abc import Callable, Iterator
from functools import partial

import torch
from measure import Row, alternate
from synthetic import steady_state, trained_state

from physhdr.backend import kernels
from physhdr.backend.methods.physhdr import PhysHDR
from physhdr.backend.rasterize.reference import project
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.state import State
from physhdr.backend.train.trainer import step

#: Milliseconds that two cores are to keep to: (preset, Gaussians) → at most.
TARGETS = {
    ("default", 50_000): 35.0,
    ("paper", 50_000): 80.0,
    ("default", 200_000): 130.0,
    ("paper", 200_000): 170.0,
}
FASTER = 12.0
#: Pictures per second that the same cores are to reach, at 50 k Gaussians.
HDR_PER_SECOND, LDR_PER_SECOND = 60.0, 30.0


def plain_projection(method: PhysHDR, camera: Camera, backward: bool = True) -> None:
    """Project all Gaussians in plain torch: means, conics, and the gradients of means, rotations, scales."""
    gaussians = method.gaussians
    leaves = [t.detach().requires_grad_(backward) for t in (gaussians.means, gaussians.quaternions)]
    leaves.append(gaussians.scales.detach().requires_grad_(backward))
    screen, covariance, _ = project(leaves[0], leaves[1], leaves[2], camera)
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    conics = torch.stack([c, -b, a], dim=1) / (a * c - b * b)[:, None]
    if backward:
        torch.autograd.grad((screen, conics), leaves, (torch.ones_like(screen), torch.ones_like(conics)))


def plain_step(state: State) -> Callable[[], None]:
    """The same iteration with networks, SSIM, SH, blur and projection in plain torch.

    There is no rasteriser made of our tile kernels and a projection in torch. So the iteration runs with the
    CPU rasteriser, and the plain projection of the same Gaussians, forward and backward, runs beside it. The
    kernels' own projection is counted as well: a few milliseconds, too much for the alternative.
    """
    camera = state.views[0].camera

    def plainly() -> None:
        with kernels.plain_torch():
            step(state)
        plain_projection(state.method, camera)

    return plainly


def iteration_rows(quick: bool) -> Iterator[Row]:
    """``trainer.step`` of both presets."""
    for count in (50_000,) if quick else (50_000, 200_000):
        for preset in ("default", "paper"):
            state = trained_state(preset, count)
            ours, plain = alternate(
                partial(step, state), plain_step(state), rounds=1 if quick else 4, repeats=(9, 1)
            )
            yield Row(
                work=f"iteration, {preset}, {count // 1000} k",
                value=ours,
                plain=plain,
                at_most=TARGETS[preset, count],
                faster=FASTER,
            )


def picture_rows(quick: bool) -> Iterator[Row]:
    """Rendering without gradients: radiance, and the final LDR picture."""
    for preset in ("default", "paper"):
        state = steady_state(preset, 50_000)
        step(state)  # sets the SH degree of this iteration
        method, camera = state.method, state.views[0].camera
        draws: dict[str, tuple[Callable[[], object], float]] = {
            "HDR": (lambda m=method, c=camera: m.hdr(c), HDR_PER_SECOND),
            "LDR": (lambda m=method, c=camera: m.ldr(c, 2.0), LDR_PER_SECOND),
        }
        for what, (draw, target) in draws.items():

            def plain(draw=draw, method=method, camera=camera) -> None:
                with kernels.plain_torch(), torch.no_grad():
                    draw()
                    plain_projection(method, camera, backward=False)

            ours, theirs = alternate(draw, plain, rounds=2 if quick else 5, repeats=(9, 1))
            yield Row(
                work=f"render {what}, {preset}, 50 k",
                value=1e3 / ours,
                plain=1e3 / theirs,
                unit="/s",
                at_least=target,
            )
