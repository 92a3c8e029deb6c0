# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a model's surface is from the true one, and how far its normals are turned, view by view."""

from collections.abc import Callable

import numpy as np
import torch

from ..rasterize import median_depth, rasterize
from ..scene.camera import Camera
from ..scene.scene import Scene, View
from ..surface.normals import facing, point_normals
from .panorama import LitSplats
from .pictures import compared_everywhere
from .renderer import Renderer
from .results import GeometryRow
from .truth import SurfaceTruth, has_surface_truth, surface_truth

#: Errors of depth (metres) and of normals (degrees) of which the share beyond is reported.
LARGE_DEPTH, LARGE_ANGLE = 0.1, 30.0
#: The true normal is a mean over the pixel: where that is shorter the pixel has an edge, and no normal.
ONE_SURFACE = 0.9


def views_with_surface(scene: Scene, split: str) -> list[View]:
    """The views of ``split`` whose true surface is known."""
    return [view for view in scene.splits[split] if has_surface_truth(scene.root, split, view.index)]


@torch.no_grad()
def geometry_rows(
    renderer: Renderer, scene: Scene, split: str, step: Callable[[str], None]
) -> list[GeometryRow]:
    """A row for each of ``views_with_surface`` that sees any; none of a renderer without splats.

    Calls ``step`` for each view; raises what ``surface_truth`` raises.
    """
    rows = []
    normals = _Normals()
    for view in views_with_surface(scene, split):
        step(f"surface {view.name}")
        splats = renderer.surface_splats(view.camera)
        if splats is None:
            continue
        true = surface_truth(scene.root, split, view.index).sampled(view.camera.height, view.camera.width)
        mask = compared_everywhere(view)
        if mask is not None:
            true = true.within(mask.numpy())
        if true.is_known.any():
            depth_errors = np.abs(_depth(splats, view.camera) - true.depth)[true.is_known]
            angles = _angles(normals.seen(splats, view.camera), true)
            rows.append(
                GeometryRow(
                    view.name,
                    view.index,
                    depth=float(np.median(depth_errors)),
                    depth_beyond=float((depth_errors > LARGE_DEPTH).mean()),
                    normal=float(np.median(angles)),
                    normal_beyond=float((angles > LARGE_ANGLE).mean()),
                )
            )
    return rows


def _depth(splats: LitSplats, camera: Camera) -> np.ndarray:
    """``[H, W]`` metres; infinite where the splats cover less than half, which is as wrong as can be."""
    depth = median_depth(splats.means, splats.quaternions, splats.scales, splats.opacities, camera)
    return torch.where(depth > 0.0, depth, torch.inf).cpu().numpy()


def _angles(seen: np.ndarray, true: SurfaceTruth) -> np.ndarray:
    """Degrees between ``seen`` ``[H, W, 3]`` and the true normals, where a pixel has one surface.

    90, a guess's median, where nothing is seen; empty pictures of edges alone have NaN.
    """
    length = np.linalg.norm(true.normal, axis=-1)
    compared = true.is_known & (length > ONE_SURFACE)
    if not compared.any():
        return np.array([np.nan])
    seen, expected = seen[compared].astype(np.float64), true.normal[compared].astype(np.float64)
    lengths = np.linalg.norm(seen, axis=-1) * np.linalg.norm(expected, axis=-1)
    cosine = np.einsum("pi,pi->p", seen, expected) / np.maximum(lengths, 1e-12)
    return np.degrees(np.arccos(cosine.clip(-1.0, 1.0)))


class _Normals:
    """Normals of Gaussians as cameras see them; those of Gaussians that stay as they are are found once."""

    def __init__(self) -> None:
        self._positions: np.ndarray | None = None
        self._normals = np.zeros((0, 3), np.float32)

    def seen(self, splats: LitSplats, camera: Camera) -> np.ndarray:
        """``[H, W, 3]``: what ``camera`` sees of them, blended; 0 where nothing is."""
        positions = splats.means.cpu().numpy()
        if self._positions is None or not np.array_equal(self._positions, positions):
            self._positions = positions
            self._normals = point_normals(positions, splats.opacities.cpu().numpy())
        turned = torch.from_numpy(facing(self._normals, positions, camera.position)).to(splats.means)
        shape = (splats.means, splats.quaternions, splats.scales, splats.opacities)
        return rasterize(*shape, turned, camera).image.permute(1, 2, 0).cpu().numpy()
