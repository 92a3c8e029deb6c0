# SPDX-License-Identifier: GPL-3.0-or-later
"""Published methods, including the paper's own, by their names in files."""

from ...backend.methods.base import MethodSetup
from ...backend.methods.registry import Registered
from ...backend.model.backbone import Backbone
from .gausshdr import GaussHDR, GaussHDRConfig
from .hdr_gs import HDRGS, HDRGSConfig
from .hdr_nerf import HDRNeRF, HDRNeRFConfig
from .paper import PaperConfig, new_paper


def _hdr_nerf(config: HDRNeRFConfig, _: Backbone, setup: MethodSetup) -> HDRNeRF:
    return HDRNeRF(config, setup)


METHODS = {
    PaperConfig.name: Registered(PaperConfig, new_paper),
    GaussHDRConfig.name: Registered(GaussHDRConfig, GaussHDR),
    HDRGSConfig.name: Registered(HDRGSConfig, HDRGS),
    HDRNeRFConfig.name: Registered(HDRNeRFConfig, _hdr_nerf),
}
