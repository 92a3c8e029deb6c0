# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method by its configuration. A new method is one file and one line here."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...bridge.errors import BadValueError
from ...bridge.lights import AMBIENT
from ..kernels.ahead import Needs
from ..model.anchors import Anchors, AnchorsConfig
from ..model.backbone import Attributes, Backbone
from ..model.gaussians import Gaussians
from ..rasterize import Implementation
from . import gausshdr, hdr_gs, hdr_nerf, physhdr
from .base import Method

#: The configurations of all methods.
MethodConfig = physhdr.PhysHDRConfig | gausshdr.GaussHDRConfig | hdr_gs.HDRGSConfig | hdr_nerf.HDRNeRFConfig


@dataclass(frozen=True)
class Facts:
    """What a method must know of the data and the machine.

    ``anchor``: a known point of the response, (exposure × radiance, code value), or None. ``lights``: names
    of those whose levels vary.
    """

    anchor: tuple[float, float] | None = None
    implementation: Implementation = "auto"
    lights: tuple[str, ...] = (AMBIENT,)


@dataclass(frozen=True)
class Entry:
    """A method: its name in files, how it is made, and what its training compiles."""

    name: str
    make: Callable[[Any, AnchorsConfig | None, Facts], Method]
    kernels_needed: Callable[[Any], Needs]


def backbone_of(attributes: Attributes, anchors: AnchorsConfig | None) -> Backbone:
    """An empty backbone: 3DGS's, or Scaffold-GS's where ``anchors`` are configured."""
    return Gaussians({}, attributes) if anchors is None else Anchors(anchors, attributes)


def _physhdr(config: physhdr.PhysHDRConfig, anchors: AnchorsConfig | None, facts: Facts) -> Method:
    backbone = backbone_of(config.attributes(facts.lights), anchors)
    return physhdr.PhysHDR(config, backbone, facts.anchor, facts.implementation, facts.lights)


def _gausshdr(config: gausshdr.GaussHDRConfig, anchors: AnchorsConfig | None, facts: Facts) -> Method:
    backbone = backbone_of(config.attributes(), anchors)
    return gausshdr.GaussHDR(config, backbone, facts.anchor, facts.implementation)


def _hdr_gs(config: hdr_gs.HDRGSConfig, anchors: AnchorsConfig | None, facts: Facts) -> Method:
    backbone = backbone_of(config.attributes(), anchors)
    return hdr_gs.HDRGS(config, backbone, facts.anchor, facts.implementation)


def _hdr_nerf(config: hdr_nerf.HDRNeRFConfig, anchors: AnchorsConfig | None, facts: Facts) -> Method:
    return hdr_nerf.HDRNeRF(config, facts.anchor)


ENTRIES: dict[type, Entry] = {
    physhdr.PhysHDRConfig: Entry("physhdr", _physhdr, physhdr.kernels_needed),
    gausshdr.GaussHDRConfig: Entry("gausshdr", _gausshdr, gausshdr.kernels_needed),
    hdr_gs.HDRGSConfig: Entry("hdr-gs", _hdr_gs, hdr_gs.kernels_needed),
    hdr_nerf.HDRNeRFConfig: Entry("hdr-nerf", _hdr_nerf, hdr_nerf.kernels_needed),
}


def entry_of(config: Any) -> Entry:
    """The method that a configuration is of."""
    return ENTRIES[type(config)]


def config_named(name: str) -> type:
    """The configuration's class of a method, as ``config.json`` names it; raises ``BadValueError``."""
    for config, entry in ENTRIES.items():
        if entry.name == name:
            return config
    names = ", ".join(entry.name for entry in ENTRIES.values())
    raise BadValueError(f"there is no method {name!r}", f"There are: {names}.")


def new_method(config: Any, anchors: AnchorsConfig | None, facts: Facts) -> Method:
    """An untrained method without primitives; raises ``BadValueError`` where it cannot be with these data."""
    return entry_of(config).make(config, anchors, facts)


def kernels_needed(config: Any) -> Needs:
    """The CPU kernels that training with ``config`` calls, so that they are compiled before."""
    return entry_of(config).kernels_needed(config)
