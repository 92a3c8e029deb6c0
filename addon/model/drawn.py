# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model's Gaussians draw, as numbers: where these are others, the model was edited."""

import re
import zlib
from collections.abc import Iterable

import bpy
import numpy as np

from ...bridge.model_file import Model
from .attributes import (
    BASE,
    CAMERA_DISTANCE,
    CONFIDENCE,
    LEVEL_LOG_GAIN,
    LIGHT_SHARE,
    LOG_SH,
    POSITION,
    ROTATION,
    SCALE,
    TYPES,
)
from .point_cloud import attributes_of, read_attribute

#: The names of attributes that radiance is drawn by. Of ``BASE`` the opacity alone is: its colours, and the
#: confidence, are of other views.
_DRAWN = re.compile(
    "|".join(re.escape(each.name) for each in (POSITION, SCALE, ROTATION, BASE))
    + "|("
    + "|".join(re.escape(each.prefix) for each in (LOG_SH, LIGHT_SHARE, LEVEL_LOG_GAIN))
    + r")\d+"
)
#: What the 3D view draws besides. Not the radius, which changes as Blender's own drawing of points is
#: switched on and off.
_SHOWN = {CAMERA_DISTANCE.name, CONFIDENCE.name}
#: Of places in ``_sum_of_bits``: odd, so that no bit is lost.
_WEIGHTS = 2 * np.arange(4093, dtype=np.uint64) + np.uint64(1)


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
        sums[name] = f"{zlib.crc32(np.asarray(counting, np.float32).tobytes()):08x}"
    return f"{zlib.crc32(repr(sorted(sums.items())).encode()):08x}"


def fingerprint(cloud: bpy.types.PointCloud) -> tuple[int, ...]:
    """Changes when points are added, deleted, moved, turned, resized, recoloured, relit or measured (1 M
    Gaussians of degree 1: 12 ms, of degree 3: 26 ms). Sums of bits, of this session alone.

    Blender reports a changed modifier input, each step of a model's slider, as a changed point cloud: this
    tells cheaply whether what is slow to make from its Gaussians is to be made anew.
    """
    names = [each.name for each in cloud.attributes if _DRAWN.fullmatch(each.name) or each.name in _SHOWN]
    return len(cloud.points), *(_sum_of_bits(read_attribute(cloud, name)) for name in names)


def _sum_of_bits(values: np.ndarray) -> int:
    """Of 64 at a time, four times as fast as of 32; each times what tells its place, so that two that were
    exchanged are noticed, too (but for every ``len(_WEIGHTS)``-th)."""
    bits = values.reshape(-1).view(np.uint32)
    pairs = bits[: len(bits) // 2 * 2].view(np.uint64)
    whole = len(pairs) // len(_WEIGHTS) * len(_WEIGHTS)
    sums = pairs[:whole].reshape(-1, len(_WEIGHTS)).sum(axis=0)
    sums[: len(pairs) - whole] += pairs[whole:]
    return int((sums * _WEIGHTS).sum()) + int(bits[2 * len(pairs) :].sum())
