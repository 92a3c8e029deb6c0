# SPDX-License-Identifier: GPL-3.0-or-later
"""Published methods that ours is compared with, by the names that stand in files."""

from ...backend.methods.registry import Registered
from .gausshdr import GaussHDR, GaussHDRConfig
from .hdr_gs import HDRGS, HDRGSConfig
from .hdr_nerf import HDRNeRF, HDRNeRFConfig

METHODS = {
    GaussHDRConfig.name: Registered(GaussHDRConfig, GaussHDR),
    HDRGSConfig.name: Registered(HDRGSConfig, HDRGS),
    HDRNeRFConfig.name: Registered(HDRNeRFConfig, HDRNeRF),
}
