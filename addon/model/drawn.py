# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model's Gaussians draw, as a short text: where that is another, the model was edited."""

import re
import zlib
from collections.abc import Iterable

import bpy
import numpy as np

from ...bridge.model_file import Model
from .attributes import (
    BASE,
    LEVEL_LOG_GAIN,
    LIGHT_SHARE,
    LOG_SH,
    OLD_SHARE,
    POSITION,
    ROTATION,
    SCALE,
    TYPES,
)
from .point_cloud import attributes_of, read_attribute

#: The names of attributes that radiance is drawn by. Of ``BASE`` the opacity alone is: its colours, and the
#: confidence, are of other views.
_DRAWN = re.compile(
    "|".join(re.escape(each.name) for each in (POSITION, SCALE, ROTATION, BASE, OLD_SHARE))
    + "|("
    + "|".join(re.escape(each.prefix) for each in (LOG_SH, LIGHT_SHARE, LEVEL_LOG_GAIN))
    + r")\d+"
)


def drawn_of(cloud: bpy.types.PointCloud) -> str:
    """What a point cloud draws now: a checksum of all that counts (a million of degree 3: 0.2 s)."""
    there = (each.name for each in cloud.attributes if each.domain == "POINT" and each.data_type in TYPES)
    return _told((name, read_attribute(cloud, name)) for name in there if _DRAWN.fullmatch(name))


def drawn_of_file(model: Model) -> str:
    """What ``drawn_of`` says of a model that was just imported."""
    no_colours = model.log_radiance_sh[:, :1]  # they do not count, and take long
    attributes = attributes_of(model, no_colours)
    return _told((each.name, values) for each, values in attributes if _DRAWN.fullmatch(each.name))


def _told(attributes: Iterable[tuple[str, np.ndarray]]) -> str:
    sums = {}
    for name, values in attributes:
        counting = values[..., 3:] if name == BASE.name else values
        name = LIGHT_SHARE[0].name if name == OLD_SHARE.name else name
        sums[name] = f"{zlib.crc32(np.asarray(counting, np.float32).tobytes()):08x}"
    return f"{zlib.crc32(repr(sorted(sums.items())).encode()):08x}"
