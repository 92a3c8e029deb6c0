# SPDX-License-Identifier: GPL-3.0-or-later
"""A render in layers for compositing: radiance with alpha, depth, confidence, and each light's contribution.

All colours are scene-linear and premultiplied by alpha, as rasterisers blend them and compositors expect
them. At the rendered levels l, fixed + Σ l · light = radiance, pixel by pixel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ..export.confidence import confidence_picture
from ..methods.base import Method
from ..rasterize import median_depth
from ..scene.camera import Camera
from ..scene.pictures import write_exr_channels

#: The layer of all passes, with the name of Blender's first one. A pass's channels follow another dot, at
#: which Blender's compositor and oiiotool split names.
LAYER = "ViewLayer"
#: Depth of the background in metres, as in Blender.
NOTHING = 1e10
#: Blender cuts off names of passes after this many bytes.
LONGEST_PASS = 60


@dataclass(frozen=True, eq=False)
class GaussianConfidence:
    """Each Gaussian's confidence ``[N]``, and the method on plain Gaussians that they belong to."""

    method: Method
    confidence: np.ndarray


@dataclass(frozen=True, eq=False)
class Layers:
    """``radiance`` ``[3, H, W]`` premultiplied, ``alpha`` ``[H, W]``.

    ``depth`` ``[H, W]``: metres along the camera's axis to where half of the pixel is covered, which is on a
    surface, never between two; 0 where less than half is. ``fixed``: ``[3, H, W]`` of the radiance that no
    light changes, and ``lights``: by name, each one's contribution at level 1; None and empty if they cannot
    be separated.
    ``confidence`` ``[H, W]``, premultiplied; None if unknown.
    """

    radiance: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor
    fixed: torch.Tensor | None
    lights: Mapping[str, torch.Tensor]
    confidence: torch.Tensor | None


@torch.no_grad()
def render_layers(
    method: Method,
    camera: Camera,
    levels: tuple[float, ...],
    of_gaussians: GaussianConfidence | None = None,
    scale: float = 1.0,
) -> Layers:
    """Render what ``camera`` sees at one level per light, its radiance times ``scale``."""
    drawn = method.preview(camera, levels)
    splats = method.lit_splats(camera)
    depth = median_depth(splats.means, splats.quaternions, splats.scales, splats.opacities, camera)
    names = method.lights_apart
    fixed, lights = None, {}
    if names:
        parts, _ = splats.drawn(camera, method.implementation)
        parts = parts * scale
        fixed, lights = parts[0], dict(zip(names, parts[1:], strict=True))
    confidence = None
    if of_gaussians is not None:
        confidence = confidence_picture(of_gaussians.method, of_gaussians.confidence, camera).image[0]
    return Layers(drawn.image * scale, drawn.alpha, depth, fixed, lights, confidence)


def write_layers(path: Path, layers: Layers, levels: Sequence[float] = ()) -> None:
    """Write one OpenEXR file of all layers, 32 bits, atomically; raises ``OutputError``.

    Passes: Combined (RGBA), Depth (Z), Fixed and ``Light NAME`` (RGB), Confidence (X). ``levels``: the
    lights' levels, for the header.
    """
    planes = {
        **_rgb("Combined", layers.radiance),
        f"{LAYER}.Combined.A": layers.alpha,
        f"{LAYER}.Depth.Z": torch.where(layers.depth > 0.0, layers.depth, NOTHING),
    }
    if layers.fixed is not None:
        planes |= _rgb("Fixed", layers.fixed)
    passes = pass_names(list(layers.lights))
    for name, light in layers.lights.items():
        planes |= _rgb(passes[name], light)
    if layers.confidence is not None:
        planes[f"{LAYER}.Confidence.X"] = layers.confidence
    by_name = zip(layers.lights, levels, strict=False)
    attributes = {"physhdr:levels": ", ".join(f"{name}={level:g}" for name, level in by_name)}
    write_exr_channels(
        path, {name: plane.detach().cpu().numpy() for name, plane in planes.items()}, attributes
    )


def pass_names(lights: Sequence[str]) -> dict[str, str]:
    """The pass of each light: ``Light lamp``. Dots, which split names in the file, become underscores."""
    passes: dict[str, str] = {}
    for name in lights:
        wanted = f"Light {name.replace('.', '_')}".encode()[:LONGEST_PASS].decode(errors="ignore")
        unique, count = wanted, 2
        while unique in passes.values():
            unique, count = f"{wanted} {count}", count + 1
        passes[name] = unique
    return passes


def _rgb(name: str, image: torch.Tensor) -> dict[str, torch.Tensor]:
    return {f"{LAYER}.{name}.{channel}": image[k] for k, channel in enumerate("RGB")}
