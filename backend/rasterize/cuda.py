# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract on CUDA, through gsplat 1.5's kernels (Apache-2.0), called step by step.

Step by step, because ``screen_offsets`` must enter between projection and rasterisation. All channels are
drawn in one pass: gsplat has kernels for 1, 2, 3, 4, 5, 8, 9, 16, 17 … channels and pads others with zeros to
the next power of two (6 and 7 cost what 8 do, 10 and 13 what 16 do).

Read against ``contract.py`` in gsplat 1.5.3's source (``csrc/*.cu``, ``include/Utils.cuh``). The same: pixel
centres, low-pass, near plane, Jacobian and its margin (and its gradient, zero where clamped), alpha and
both of its bounds, no gradient to geometry where alpha is at its maximum, the stop at a transmittance of 1e-4
before a Gaussian is added, order by depth and then by index. Different:

* radii are whole pixels, rounded up, at most ⌈3.33 σ⌉; with them a Gaussian just off the screen may count as
  drawn. No pixel changes: what lies beyond is below 1/255;
* ``exp`` and divisions are the fast ones (about 2 units in the last place), and backward recovers the
  transmittance from ``1 − alpha`` in float32: behind saturated pixels gradients are right to about 1e-3;
* gradients are added by atomics: the last bits differ from run to run;
* what is farther than 1e10 m is not drawn;
* a Gaussian with a NaN in its geometry is not drawn and not refused; looking would make the host wait;
* without any Gaussian gsplat divides by zero and ends the process; here that case never reaches it;
* ``isect_tiles`` reads one number back (how many tiles are touched in all, to allocate for them). It is the
  only place in an iteration where the host waits for the card.
"""

import os
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import torch

from ...bridge.splatting import LOW_PASS, NEAR_PLANE
from ..scene.camera import Camera
from ..scene.resident import camera_tensors
from .contract import Rasterization
from .trial import first_line, try_out

TILE = 16


@cache
def unavailable_reason() -> str | None:
    """Why the CUDA path cannot be used here, or ``None`` where it can.

    May compile the kernels (see ``is_built``) and draws a Gaussian with them, so that a card, a compiler or a
    version of gsplat that does not fit is found out here and not in training.
    """
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    try:
        import gsplat  # noqa: F401 (is it there at all?)
        from gsplat.cuda._backend import _C
    except ImportError as error:
        return f"gsplat cannot be imported: {error}"
    except Exception as error:  # noqa: BLE001 (a build can fail in any way; the reason is passed on)
        return f"gsplat's kernels could not be built: {first_line(error)}"
    if _C is None:
        return "gsplat's kernels could not be built: there is no nvcc (NVIDIA's CUDA toolkit)"
    try:
        error = try_out(rasterize, torch.device("cuda"))
    except Exception as exception:  # noqa: BLE001 (as above)
        return f"gsplat's kernels do not run: {first_line(exception)}"
    return None if error < 1e-3 else f"gsplat's kernels draw a Gaussian wrongly (by {error:g})"


def is_built() -> bool:
    """Whether gsplat's kernels lie compiled on this machine; if not, first use compiles them (minutes)."""
    package = find_spec("gsplat")  # found, not imported: it may lack what it needs
    if package is None:
        return True  # nothing to build
    places = [Path(place) for place in package.submodule_search_locations or ()]
    if any(file.suffix in (".so", ".pyd") for place in places for file in place.glob("csrc*")):
        return True  # built when it was installed
    from torch.utils.cpp_extension import get_default_build_root

    build = Path(os.environ.get("TORCH_EXTENSIONS_DIR") or get_default_build_root())
    return any(file.suffix in (".so", ".pyd") for file in build.glob("**/gsplat_cuda/gsplat_cuda.*"))


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    screen_offsets: torch.Tensor | None = None,
) -> Rasterization:
    """See ``rasterize.rasterize``."""
    import gsplat

    width, height = camera.width, camera.height
    if len(means) == 0:
        # Connected to the inputs, so that a backward pass finds its way.
        nothing = sum(t.sum() for t in (means, quaternions, scales, opacities, colours))
        image = colours.new_zeros(colours.shape[1], height, width) + nothing
        return Rasterization(image, means.new_zeros(height, width) + nothing, means.new_zeros(0))

    placed = camera_tensors(camera, means)
    radii, screen, depths, conics, _ = gsplat.fully_fused_projection(
        means,
        None,
        quaternions,
        scales,
        placed.view[None],
        placed.intrinsics[None],
        width,
        height,
        eps2d=LOW_PASS,
        near_plane=NEAR_PLANE,
        opacities=opacities.detach(),  # for the extent of the footprint only
    )
    if screen_offsets is not None:
        screen = screen + screen_offsets[None]
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    with torch.no_grad():
        _, keys, indices = gsplat.isect_tiles(screen, radii, depths, TILE, tiles_x, tiles_y)
        offsets = gsplat.isect_offset_encode(keys, 1, tiles_x, tiles_y)
    image, alpha = gsplat.rasterize_to_pixels(
        screen, conics, colours[None], opacities[None], width, height, TILE, offsets, indices
    )
    # gsplat keeps a pixel's channels together, the contract keeps a channel's pixels together.
    image = image[0].permute(2, 0, 1).contiguous()
    return Rasterization(image, alpha[0, ..., 0], radii[0].amax(dim=-1).to(means.dtype))


def evaluate_sh(
    dc: torch.Tensor, rest: torch.Tensor, means: torch.Tensor, viewpoint: torch.Tensor, degree: int
) -> torch.Tensor:
    """``kernels.evaluate_sh`` by gsplat's kernel, which has the same basis, signs and order (3DGS's)."""
    import gsplat

    coefficients = torch.cat([dc.reshape(-1, 1, 3), rest], dim=1)
    return gsplat.spherical_harmonics(degree, means.detach() - viewpoint, coefficients)
