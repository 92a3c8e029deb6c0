# SPDX-License-Identifier: GPL-3.0-or-later
"""What carries a scene (3DGS's Gaussians, or what packages add), and what it gives to be drawn.

A method asks its backbone for the splats of a view and never cares where they come from; a backbone knows
nothing of exposures, tone mapping or losses. Its settings say what others must know of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import torch
from torch import nn

from ..bounds import FromZero
from ..scene.camera import Camera
from .rates import Rate


@dataclass(frozen=True, kw_only=True)
class Attributes:
    """What each splat carries beside geometry and reflectance, as the method asks for it.

    ``context_size``: channels of the feature that local tone mapping reads, 0 for none. ``lights``: how many
    lights have a share of its radiance, 0 for none. ``illumination_channels``: of L_a, 1 or 3.
    ``direction_gradient``: whether positions learn from how reflectance changes with the viewing direction.
    """

    sh_degree: int = 3
    illumination_channels: int = 1
    direction_gradient: bool = False
    context_size: int = 0
    lights: int = 0


@dataclass(frozen=True, kw_only=True)
class Start:
    """How a backbone begins; lab/notebook.md says what was measured.

    ``opacity`` in (0, 1); ``thickness``: the standard deviation across the surface that the neighbours make,
    over that along it; ``largest`` ``[P]`` metres: no standard deviation is larger, None: no bound.
    """

    opacity: float = 0.1
    thickness: float = 1.0
    largest: np.ndarray | None = None
    seed: int = 0


@dataclass(frozen=True)
class Splats:
    """M Gaussians as one view sees them, before light is composed into colour.

    ``means`` ``[M, 3]`` metres; ``quaternions`` ``[M, 4]`` wxyz; ``scales`` ``[M, 3]`` metres; ``opacities``
    ``[M]``; ``log_reflectance`` ``[M, 3]``: ln H_r toward the camera; ``log_illumination`` ``[M, 1 or 3]``;
    ``light_share`` ``[M, C, 3]`` and ``context`` ``[M, K]`` where ``Attributes`` asks for them.
    ``seen_at`` ``[M, 3]``: ``means`` as ``log_reflectance`` read them, where means learn from it
    (``Attributes.direction_gradient``); its gradient is the part that goes through the viewing direction.
    """

    means: torch.Tensor
    quaternions: torch.Tensor
    scales: torch.Tensor
    opacities: torch.Tensor
    log_reflectance: torch.Tensor
    log_illumination: torch.Tensor
    light_share: torch.Tensor | None = None
    context: torch.Tensor | None = None
    seen_at: torch.Tensor | None = None


@dataclass(frozen=True, kw_only=True)
class BackboneConfig(ABC):
    """What a backbone is made of and how it grows: its settings, which stand in ``config.json``.

    Those that contradict each other are refused by ``__post_init__``, with ``BadValueError``.
    """

    #: What ``config.json`` calls the backbone.
    name: ClassVar[str]
    #: An iteration's bytes for each Gaussian: activations, gradients, what is projected.
    splat_bytes: ClassVar[int]
    #: Where growth has no bound, so many Gaussians come of each at the start.
    growth_factor: ClassVar[int]
    #: Whether each of the data set's points becomes a primitive, so that many call for a larger budget.
    keeps_points: ClassVar[bool]
    #: Settings of a training (``TrainConfig``) that this backbone does not read.
    unread: ClassVar[tuple[str, ...]] = ()

    #: Primitives are added and removed every so many iterations.
    every: int = 100
    #: Share of the training after which their number stays.
    stop: float
    #: τ_p: mean norm of ∂L/∂(NDC position) above which a Gaussian calls for more.
    threshold: float
    #: s of s_a = s·σ(|L_a − L̂_a|) + 1 (eq. 17), times the gradient; 0 switches the scaling off.
    scaling_strength: float = 0.0
    #: Gaussians that are more transparent than this go.
    prune_opacity: float = 0.005
    #: Never more Gaussians than this; those with the largest gradients come first. 0: no bound.
    budget: FromZero

    @abstractmethod
    def stretched(self, steps: Callable[[int], int]) -> Self:
        """The same with ``steps`` of every setting that is a number of iterations."""

    @abstractmethod
    def growing(self, iterations: int) -> tuple[int, int]:
        """After which iteration of a training of so many it begins to grow, and at which it ends."""

    @abstractmethod
    def first_gaussians(self, points: int) -> int:
        """How many Gaussians it begins with at so many points, about."""

    @abstractmethod
    def numbers(self, attributes: Attributes) -> float:
        """How many numbers are learned for each Gaussian."""


class Backbone(ABC):
    """``parameters``: leaf tensors by name, one row a primitive (what growth adds and removes).

    ``networks``: shared by all primitives; empty where there are none.
    """

    parameters: dict[str, torch.Tensor]
    networks: nn.ModuleDict

    @abstractmethod
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The axes of each of ``parameters`` after the first, which counts the primitives."""

    @abstractmethod
    def place(self, positions: np.ndarray, log_radiance: np.ndarray, start: Start) -> None:
        """Begin at ``positions`` ``[P, 3]`` (metres) with ln radiance ``[P, 3]``; few: ``BadValueError``."""

    @abstractmethod
    def splats(self, camera: Camera, sh_degree: int) -> Splats:
        """What ``camera`` sees; ``sh_degree`` bounds the directional detail where it is SH."""

    def regulariser(self, splats: Splats) -> torch.Tensor | None:
        """A loss term of the backbone's own, weighted, of the splats of a view; None where it has none."""
        return None

    def rates(self) -> dict[str, Rate]:
        """Learning rates that are the backbone's own, by group; the others are ``OptimiserConfig``'s."""
        return {}

    @abstractmethod
    def fixed(self, cameras: Sequence[Camera]) -> "Backbone":
        """The same as plain Gaussians (``gaussians.Gaussians``), for files and viewers that know no others.

        Where the splats depend on the view, they are those that ``cameras`` see, as nearly as can be.
        """

    @property
    def is_fixed(self) -> bool:
        """Whether its splats are the same for every view, but for their colours."""
        return False

    def scatter(self, times: float, generator: torch.Generator) -> None:  # noqa: B027 (networks place theirs)
        """Move primitives that were copied so many ``times`` as growth would: for a trial of its cost."""

    @property
    @abstractmethod
    def positions(self) -> torch.Tensor:
        """``[N, 3]`` metres: where the primitives are, also for their device."""

    def __len__(self) -> int:
        """How many primitives there are."""
        return self.positions.shape[0]

    @property
    def gaussian_count(self) -> int:
        """How many Gaussians can be drawn at once: what is compared with other methods."""
        return len(self)

    def to_device(self, device: torch.device) -> None:
        """Move the primitives' parameters; the networks move with the method that holds them."""
        for name, tensor in self.parameters.items():
            self.parameters[name] = tensor.detach().to(device).requires_grad_()
