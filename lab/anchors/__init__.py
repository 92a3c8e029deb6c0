# SPDX-License-Identifier: GPL-3.0-or-later
"""Scaffold-GS's backbone, by its name in files."""

from ...backend.train.backbones import RegisteredBackbone
from .backbone import Anchors
from .config import AnchorsConfig
from .growth import AnchorGrowth

BACKBONES = {AnchorsConfig.name: RegisteredBackbone(AnchorsConfig, Anchors, AnchorGrowth)}
