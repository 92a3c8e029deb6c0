# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene: anisotropic Gaussians, each with a reflectance and an illumination."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from ...bridge.errors import BadValueError
from ..kernels.spherical_harmonics import evaluate_sh
from ..scene.camera import Camera
from ..scene.resident import camera_tensors
from .backbone import Attributes, Backbone, Splats, Start

#: SH of degree 0: a constant function of the direction.
SH_C0 = 0.28209479177387814
#: First Gaussians are as large as the distance to so many neighbours (3DGS), and lie along the surface that
#: a point and so many neighbours make: of fewer it follows their noise, of more it rounds corners.
NEAREST, NEIGHBOURS = 3, 9
#: The share that a single light begins with; of several each begins with as much as what no light turns.
AMBIENT_SHARE = 0.5
#: Scales of n times as many Gaussians are n^-SHRINK of what they were. With 0.5 they would cover as much; a
#: trained 60,000 of 18,000 cost a quarter less than that, and a sixth more than where each splits (0.68).
SHRINK = 0.6


class Gaussians(Backbone):
    """3DGS's backbone. Parameters of N Gaussians by name; every tensor is a leaf that requires a gradient.

    ========================  ==========  ==============================================================
    ``means``                 [N, 3]      metres, Blender's world
    ``log_scales``            [N, 3]      ln of the standard deviations in metres
    ``quaternions``           [N, 4]      wxyz, any length
    ``opacity_logits``        [N]
    ``reflectance_dc``        [N, 1, 3]   ln H_r(ω) = SH: the constant coefficient …
    ``reflectance_rest``      [N, K−1, 3] … and the others
    ``log_illumination``      [N, 1]      ln L_a, ambient illumination (eq. 5: no direction); or [N, 3]
    ``light_share_logits``    [N, C, 3]   only with the additive modulator: s of each of C lights
    ``context``               [N, 4]      only with a local tone mapper: what is rendered as its context
    ========================  ==========  ==============================================================
    """

    def __init__(
        self, parameters: dict[str, torch.Tensor] | None = None, attributes: Attributes | None = None
    ) -> None:
        self.parameters = parameters or {}
        self.attributes = attributes or Attributes()
        self.networks = nn.ModuleDict()

    def __getattr__(self, name: str) -> torch.Tensor:
        try:
            return self.__dict__["parameters"][name]
        except KeyError:
            raise AttributeError(f"these Gaussians have no parameter {name!r}") from None

    @property
    def positions(self) -> torch.Tensor:
        return self.parameters["means"]

    def shapes(self) -> dict[str, tuple[int, ...]]:
        wanted = self.attributes
        shapes: dict[str, tuple[int, ...]] = {
            "means": (3,),
            "log_scales": (3,),
            "quaternions": (4,),
            "opacity_logits": (),
            "reflectance_dc": (1, 3),
            "reflectance_rest": ((wanted.sh_degree + 1) ** 2 - 1, 3),
            "log_illumination": (wanted.illumination_channels,),
        }
        if wanted.lights:
            shapes["light_share_logits"] = (wanted.lights, 3)
        if wanted.context_size:
            shapes["context"] = (wanted.context_size,)
        return shapes

    def place(self, positions: np.ndarray, log_radiance: np.ndarray, start: Start) -> None:
        """3DGS's beginning, as large as the distance to the neighbours; or flat, as ``start`` says."""
        wanted = self.attributes
        self.parameters = initial_gaussians(
            positions,
            log_radiance,
            sh_degree=wanted.sh_degree,
            opacity=start.opacity,
            thickness=start.thickness,
            largest=start.largest,
            ambient_share=AMBIENT_SHARE if wanted.lights else None,
            context_size=wanted.context_size,
            seed=start.seed,
            lights=max(wanted.lights, 1),
            illumination_channels=wanted.illumination_channels,
        ).parameters

    def splats(self, camera: Camera, sh_degree: int) -> Splats:
        viewpoint = camera_tensors(camera, self.means).position
        seen_at = self.means.view_as(self.means) if self.attributes.direction_gradient else None
        return Splats(
            self.means,
            self.quaternions,
            self.scales,
            self.opacities,
            self.log_reflectance(viewpoint, sh_degree, seen_at),
            self.log_illumination,
            self.light_share if "light_share_logits" in self.parameters else None,
            self.parameters.get("context"),
            seen_at,
        )

    @property
    def is_fixed(self) -> bool:
        return True

    def fixed(self, cameras: Sequence[Camera]) -> "Gaussians":
        return self

    def scatter(self, times: float, generator: torch.Generator) -> None:
        noise = torch.randn(len(self), 3, generator=generator).to(self.means)
        self.means.add_(noise * self.scales)
        self.log_scales.sub_(SHRINK * math.log(times))

    @property
    def scales(self) -> torch.Tensor:
        """Standard deviations ``[N, 3]``, metres."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> torch.Tensor:
        """``[N]`` in (0, 1)."""
        return self.opacity_logits.sigmoid()

    @property
    def light_share(self) -> torch.Tensor:
        """``[N, C, 3]`` in (0, 1): how much of each colour's radiance each light causes.

        A softmax over the lights and what no light turns, whose logit is 0: the shares of all lights add up
        to less than 1. Of a single light it is a sigmoid.
        """
        if self.light_share_logits.shape[1] == 1:
            return self.light_share_logits.sigmoid()
        with_fixed = torch.nn.functional.pad(self.light_share_logits, (0, 0, 0, 1))
        return with_fixed.softmax(dim=1)[:, :-1]

    def log_reflectance(
        self, viewpoint: torch.Tensor, degree: int, seen_at: torch.Tensor | None = None
    ) -> torch.Tensor:
        """ln H_r(ω_o) ``[N, 3]`` as seen from ``viewpoint`` (``[3]``, metres), SH up to ``degree``.

        ``seen_at``: ``means`` under another name, to tell what gradient comes from here.
        """
        means = self.means if seen_at is None else seen_at
        arguments = self.reflectance_dc, self.reflectance_rest, means, viewpoint, degree
        if self.attributes.direction_gradient:
            return evaluate_sh(*arguments, direction_gradient=True)
        return evaluate_sh(*arguments)


def initial_gaussians(
    positions: np.ndarray,
    log_radiance: np.ndarray,
    *,
    sh_degree: int,
    opacity: float,
    thickness: float = 1.0,
    ambient_share: float | None,
    context_size: int,
    seed: int,
    lights: int = 1,
    illumination_channels: int = 1,
    largest: np.ndarray | None = None,
) -> Gaussians:
    """Gaussians at ``positions`` with the same radiance exp(``log_radiance``) in every direction.

    ``positions`` ``[P, 3]`` metres, ``log_radiance`` ``[P, 3]``. Standard deviation: the root mean square
    distance to the three nearest neighbours (3DGS's rule), at most ``largest`` ``[P]`` (metres); across the
    surface that neighbours make, ``thickness`` of that (3DGS: 1, isotropic). ``ambient_share=None`` and
    ``context_size=0`` leave those parameters out; of several ``lights`` each starts with as much as what no
    light turns, 1 / (lights + 1).
    """
    count = positions.shape[0]
    if count < 4:
        raise BadValueError(
            f"{count} initial points are too few to start from",
            "Give the data set a points3d.ply with more points, or train with --initial-points random.",
        )
    from scipy.spatial import KDTree  # here, because only this needs SciPy

    distances, near = KDTree(positions).query(positions, k=min(NEIGHBOURS + 1, count), workers=-1)
    scales = np.sqrt(np.mean(distances[:, 1 : NEAREST + 1] ** 2, axis=1)).clip(1e-5)
    if largest is not None:
        scales = np.minimum(scales, largest)
    log_scales = np.log(scales)[:, None].repeat(3, axis=1)
    quaternions = np.tile((1.0, 0.0, 0.0, 0.0), (count, 1))
    if thickness != 1.0:
        log_scales[:, 2] += np.log(thickness)
        quaternions = _across_surfaces(positions, np.asarray(near))
    generator = torch.Generator().manual_seed(seed)
    coefficients = (sh_degree + 1) ** 2
    parameters = {
        "means": torch.tensor(positions, dtype=torch.float32),
        "log_scales": torch.tensor(log_scales, dtype=torch.float32),
        "quaternions": torch.tensor(quaternions, dtype=torch.float32),
        "opacity_logits": torch.full((count,), float(np.log(opacity / (1.0 - opacity)))),
        "reflectance_dc": torch.tensor(log_radiance / SH_C0, dtype=torch.float32)[:, None, :],
        "reflectance_rest": torch.zeros(count, coefficients - 1, 3),
        "log_illumination": torch.zeros(count, illumination_channels),
    }
    if ambient_share is not None:
        logit = float(np.log(ambient_share / (1.0 - ambient_share))) if lights == 1 else 0.0
        parameters["light_share_logits"] = torch.full((count, lights, 3), logit)
    if context_size:
        parameters["context"] = 0.01 * torch.randn(count, context_size, generator=generator)
    return Gaussians({name: tensor.contiguous().requires_grad_() for name, tensor in parameters.items()})


def _across_surfaces(positions: np.ndarray, near: np.ndarray) -> np.ndarray:
    """``[P, 4]`` wxyz: turns the third axis to where ``positions`` ``[P, 3]`` spread least among ``near``.

    ``near`` ``[P, K]``: indices of each one's neighbours, itself included.
    """
    from scipy.spatial.transform import Rotation  # here, because only this needs SciPy

    around = positions[near]
    around = around - around.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(around.transpose(0, 2, 1) @ around)  # of rising spread, in columns
    axes = axes[:, :, ::-1].copy()
    axes[np.linalg.det(axes) < 0.0, :, 2] *= -1.0
    return Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
