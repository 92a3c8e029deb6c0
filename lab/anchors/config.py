# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of Scaffold-GS's backbone, and what they mean for a training's size.

Facts about it are in docs/method.md (Lu et al., Scaffold-GS, CVPR 2024).
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Self

from ...backend.bounds import FromZero, Size
from ...backend.model.backbone import Attributes, BackboneConfig
from ...backend.model.rates import Rate, require_rates
from ...bridge.errors import BadValueError

#: A voxel for the growth is the neighbours' distance over this, if it is not set: the coarsest of
#: Scaffold-GS's three cells (16 voxels) then is as large as the distance to the neighbours.
VOXELS_PER_SPACING = 16


@dataclass(frozen=True, kw_only=True)
class AnchorRates:
    """Learning rates, Scaffold-GS's; those with an end go there exponentially. Anchors never move."""

    #: Times the scene's extent.
    offsets: float = 0.01
    #: The same at the end.
    offsets_final: float = 1e-4
    #: Of anchors' features.
    features: float = 0.0075
    #: Of anchors' sizes.
    log_scaling: float = 0.007
    #: Ours; as 3DGS's constant coefficient, in ln radiance.
    base_log_radiance: float = 0.0025
    #: Of the network for opacities.
    opacity: float = 0.002
    #: The same at the end.
    opacity_final: float = 2e-5
    #: Of the network for sizes and rotations.
    covariance: float = 0.004
    #: Of the network for colours. Also of the heads that Scaffold-GS does not have: illumination, shares of
    #: light, context.
    colour: float = 0.008
    #: The same at the end.
    colour_final: float = 5e-5

    def __post_init__(self) -> None:
        require_rates("backbone.rates", vars(self))

    def by_group(self) -> dict[str, Rate]:
        """A rate for each parameter and each network of ``Anchors``."""
        colour = Rate(start=self.colour, final=self.colour_final, shape="exponential")
        return {
            "anchors": Rate(start=0.0),
            "offsets": Rate(
                start=self.offsets, final=self.offsets_final, shape="exponential", of_extent=True
            ),
            "features": Rate(start=self.features),
            "log_scaling": Rate(start=self.log_scaling),
            "base_log_radiance": Rate(start=self.base_log_radiance),
            "opacity": Rate(start=self.opacity, final=self.opacity_final, shape="exponential"),
            "covariance": Rate(start=self.covariance),
            "colour": colour,
            "illumination": colour,
            "light_share": colour,
            "context": colour,
        }


@dataclass(frozen=True, kw_only=True)
class AnchorsConfig(BackboneConfig):
    """Sizes of the backbone, its rates and its growth. Defaults: Scaffold-GS's.

    When anchors are added and removed are shares of its 30,000 iterations: in a shorter training everything
    begins and ends earlier, or nothing would happen in it.
    """

    name: ClassVar[str] = "anchors"
    #: They come out of networks.
    splat_bytes: ClassVar[int] = 1300
    #: There are many to begin with.
    growth_factor: ClassVar[int] = 3
    #: Several points may become one anchor (``placement``).
    keeps_points: ClassVar[bool] = False
    #: Networks decide how opaque a Gaussian is and which light it has; none is removed before a camera.
    unread: ClassVar[tuple[str, ...]] = (
        "initial_opacity",
        "initial_thickness",
        "initial_size_limit",
        "clear_cameras",
    )

    #: k: Gaussians of an anchor.
    offsets: Size = 10
    #: Numbers of an anchor's feature.
    feature_size: Size = 32
    #: Width of the networks.
    hidden: Size = 32
    #: ε, metres: the unit of placement and growth. Scaffold-GS's 0.001 is in the units of each scene's own
    #: reconstruction, ours are metres: 0 takes the median distance to the neighbours over 16.
    voxel_size: float = 0.0
    #: One anchor for all points in a cell of this many voxels (Scaffold-GS: 1); more: fewer anchors.
    placement: int = 1
    #: Start from the brackets' radiance: a ln value for each channel and anchor, added to the network's.
    #: Off: the network alone (Scaffold-GS, GaussHDR), which starts near 1.
    base_radiance: bool = True
    #: λ of λ · mean(volume of the drawn Gaussians), in metres cubed.
    volume_weight: float = 0.01
    rates: AnchorRates = field(default_factory=AnchorRates)
    #: Statistics are gathered from this share of the training on (from iteration 500), …
    observe_from: float = 500 / 30_000
    #: … anchors added and removed after this one (1500), …
    start: float = 1500 / 30_000
    #: … and both end at this one (15,000).
    stop: float = 0.5
    #: τ: mean norm of ∂L/∂(NDC position) of a neural Gaussian; doubled from each level to the next finer.
    threshold: float = 2e-4
    #: Levels at which anchors are added.
    levels: Size = 3
    #: Cells of the coarsest level, in voxels.
    coarsest: int = 16
    #: How many times finer the cells of each next level are.
    refinement: int = 4
    #: A Gaussian counts when it was drawn in half of this share of ``every`` iterations; an anchor is judged
    #: after it was seen in all of it.
    seen_share: float = 0.8
    #: Anchors whose Gaussians have less opacity than this in sum, on average, go.
    prune_opacity: float = 0.005
    #: Never more Gaussians (anchors × offsets) than this; the largest gradients come first. 0: no bound.
    budget: FromZero = 0

    def __post_init__(self) -> None:
        if self.offsets < 1 or self.placement < 1:
            raise BadValueError("an anchor needs at least one Gaussian, and a cell at least one voxel")

    def stretched(self, steps: Callable[[int], int]) -> Self:
        return dataclasses.replace(self, every=steps(self.every))

    def growing(self, iterations: int) -> tuple[int, int]:
        return round(self.start * iterations), round(self.stop * iterations)

    def first_gaussians(self, points: int) -> int:
        """On surfaces, about half of the points share a cell of two spacings with another."""
        cells = points / max(1.0, self.placement / VOXELS_PER_SPACING)
        return round(cells) * self.offsets

    def numbers(self, attributes: Attributes) -> float:
        """An anchor's for each of its Gaussians: place, two sizes, brightness, features; their offsets."""
        return (3 + 6 + 3 * self.base_radiance + self.feature_size) / self.offsets + 3
