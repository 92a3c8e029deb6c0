# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method by its name: ours, and those that packages add, as ``lab/`` does."""

from collections.abc import Callable
from typing import NamedTuple

from ...bridge.errors import BadValueError
from ..model.anchors import Anchors, AnchorsConfig
from ..model.backbone import Attributes, Backbone
from ..model.gaussians import Gaussians
from ..tables import Table
from .base import Facts, Method, MethodConfig
from .physhdr import PhysHDR
from .physhdr_common import PhysHDRConfig


class Registered(NamedTuple):
    """A method: its settings, and what makes it of them.

    ``make`` is called with the settings, a backbone without primitives, and the ``Facts``.
    """

    config: type[MethodConfig]
    make: Callable[..., Method]


#: By the names that stand in files.
METHODS: Table[Registered] = Table("methods", {PhysHDRConfig.name: Registered(PhysHDRConfig, PhysHDR)})


def config_named(name: str) -> type[MethodConfig]:
    """The settings' class of a method, as ``config.json`` names it; raises ``BadValueError``."""
    if name not in METHODS:
        raise BadValueError(f"there is no method {name!r}", f"There are: {', '.join(METHODS)}.")
    return METHODS[name].config


def new_method(config: MethodConfig, anchors: AnchorsConfig | None, facts: Facts) -> Method:
    """An untrained method without primitives; raises ``BadValueError`` where it cannot be with these data."""
    backbone = new_backbone(config.attributes(facts.lights), anchors)
    return METHODS[config.name].make(config, backbone, facts)


def new_backbone(attributes: Attributes, anchors: AnchorsConfig | None) -> Backbone:
    """An empty backbone: 3DGS's, or Scaffold-GS's where ``anchors`` are configured."""
    return Gaussians({}, attributes) if anchors is None else Anchors(anchors, attributes)
