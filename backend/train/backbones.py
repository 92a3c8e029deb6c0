# SPDX-License-Identifier: GPL-3.0-or-later
"""Every backbone by its name: 3DGS's, and those that packages add, as ``lab/`` does."""

from collections.abc import Callable
from typing import NamedTuple

from ..methods.base import Method, MethodConfig, MethodSetup
from ..methods.registry import METHODS
from ..model.backbone import Attributes, Backbone, BackboneConfig
from ..model.gaussians import Gaussians
from ..tables import Table
from .densify import GaussianGrowth, GaussiansConfig
from .growth import Growth


class RegisteredBackbone(NamedTuple):
    """A backbone: its settings, and what makes it and its growth of them.

    ``make`` is called with the settings and the ``Attributes`` that the method wants; ``growth`` as
    ``GaussianGrowth`` is.
    """

    config: type[BackboneConfig]
    make: Callable[..., Backbone]
    growth: Callable[..., Growth]


def _gaussians(config: GaussiansConfig, attributes: Attributes) -> Gaussians:
    return Gaussians({}, attributes)


#: By the names that stand in files.
BACKBONES: Table[RegisteredBackbone] = Table(
    "backbones", {GaussiansConfig.name: RegisteredBackbone(GaussiansConfig, _gaussians, GaussianGrowth)}
)


def new_method(config: MethodConfig, backbone: BackboneConfig, setup: MethodSetup) -> Method:
    """An untrained method without primitives; raises ``BadValueError`` where it cannot be with these data."""
    empty = BACKBONES[backbone.name].make(backbone, config.attributes(setup.lights))
    return METHODS[config.name].make(config, empty, setup)
