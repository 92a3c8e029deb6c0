# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract in NVIDIA Warp: CUDA cards with nothing but their driver, and the same kernels on the CPU.

``stages``: ``projection`` → ``lists`` (torch's sorts) → ``tiles``, and back; any number of channels. Warp
compiles them at their first use, with what its wheel brings: LLVM for the CPU, NVRTC for cards. On the CPU
it is an order slower than the Numba kernels: there it runs to be tested.

Against ``contract.py``: nothing differs, but that a tensor with a NaN or an infinity is refused on the CPU
only, where looking costs nothing; on a card such a Gaussian is not drawn. Gradients are added by atomics,
whose order differs from run to run on a card, unless ``torch.use_deterministic_algorithms(True)`` is in
force: then every (Gaussian, tile) pair has a row of its own, and rows are added in their order. That takes
4 (6 + C) bytes a pair, 48 for six channels, written once and read once, and blocks of 256 threads that wait
for one another.

The host waits for a card once, for the number of (Gaussian, tile) pairs.
"""

from typing import Any

import torch

from ....bridge.errors import BadValueError
from ...scene.camera import Camera
from ..contract import Rasterization, refuse_what_is_not_finite
from .stages import draw, draw_backward, project, project_backward

__all__ = ["MOST_CHANNELS", "rasterize"]

#: Channels of a pass; more are drawn in several. Each takes backward five registers (docs/performance.md).
MOST_CHANNELS = 32


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    screen_offsets: torch.Tensor | None = None,
) -> Rasterization:
    """See ``rasterize.rasterize``. Float32 tensors on one device, a CUDA card or the CPU.

    Raises ``BadValueError`` for other tensors, and on the CPU where one has a NaN or an infinity in it.
    """
    tensors = {
        "means": means,
        "quaternions": quaternions,
        "scales": scales,
        "opacities": opacities,
        "colours": colours,
        "screen_offsets": screen_offsets,
    }
    for name, tensor in tensors.items():
        if tensor is None:
            continue
        if tensor.dtype != torch.float32 or tensor.device != means.device:
            raise BadValueError(
                f"{name} must be float32 on {means.device} here, got {tensor.dtype} on {tensor.device}",
                "Convert it, or choose the implementation 'reference' (any dtype).",
            )
    if means.device.type == "cpu":
        refuse_what_is_not_finite(tensors)
    if screen_offsets is None:
        screen_offsets = means.new_zeros(len(means), 2)
    geometry = (means, quaternions, scales, opacities)
    parts = colours.split(MOST_CHANNELS, dim=1)
    passes = [_Rasterize.apply(camera, *geometry, part, screen_offsets) for part in parts]
    image, alpha, radii = passes[0]
    if len(passes) > 1:
        image = torch.cat([part for part, _, _ in passes])
    return Rasterization(image, alpha, radii)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, camera: Camera, *tensors: Any):
        means, quaternions, scales, opacities, colours, offsets = (t.detach().contiguous() for t in tensors)
        seen = project(camera, means, quaternions, scales, opacities, colours, offsets)
        drawn = draw(camera, seen, colours.shape[1])
        # Not the same tensor: an output in ctx, but for what is saved, is a cycle that only gc frees.
        radii = seen.radii.clone()
        ctx.mark_non_differentiable(radii)
        ctx.set_materialize_grads(False)
        if any(ctx.needs_input_grad):
            ctx.camera, ctx.radii = camera, seen.radii
            ctx.drawn = drawn._replace(image=None, alpha=None)
            ctx.save_for_backward(drawn.image, drawn.alpha, means, quaternions, scales, opacities)
        return drawn.image, drawn.alpha, radii

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        grad_image, grad_alpha, _ = grads
        image, alpha, means, quaternions, scales, opacities = ctx.saved_tensors
        grad_image = torch.zeros_like(image) if grad_image is None else grad_image.contiguous()
        grad_alpha = torch.zeros_like(alpha) if grad_alpha is None else grad_alpha.contiguous()
        drawn = ctx.drawn._replace(image=image, alpha=alpha)
        sums = draw_backward(drawn, grad_image, grad_alpha)
        geometry = (means, quaternions, scales, opacities)
        gradients = project_backward(ctx.camera, *geometry, ctx.radii, sums)
        wanted = zip(gradients, ctx.needs_input_grad[1:], strict=True)
        return None, *(gradient if needed else None for gradient, needed in wanted)
