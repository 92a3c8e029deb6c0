# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussians of a point cloud, as textures (there are no storage buffers in Blender's gpu module)."""

import itertools
import math
from dataclasses import dataclass

import bpy
import gpu
import numpy as np

from ...bridge.errors import PhysHDRError
from ...bridge.spherical_harmonics import degree_of
from ..point_cloud import IDENTITY, lights_of, read_attribute, read_shares
from . import gpu_arrays
from .overlay import ToneCurve

#: Gaussian i is texel (i mod WIDTH, i div WIDTH) of every texture.
WIDTH = 2048
#: An array texture has room for 256 layers on every GPU: one a light, and what no light turns.
LIGHTS_MAX = 255

_serial = itertools.count()

_REQUIRED = ("position", "scale", "rotation", "radiance:base", "physhdr:log_sh_0")


@dataclass(frozen=True, eq=False)
class SplatArrays:
    """Gaussians as numpy arrays, float32. Meanings and units: docs/formats.md, *Point cloud in Blender*."""

    position: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    #: ``[K, N, 3]``
    log_sh: np.ndarray
    #: ``[C, N, 3]`` shares of the C lights, or ``[L, N, 3]`` log gains at ``levels``.
    light: np.ndarray
    levels: tuple[float, ...] = ()

    @property
    def count(self) -> int:
        return len(self.position)


def is_splats(cloud: bpy.types.PointCloud) -> bool:
    """Whether the point cloud has all attributes that drawing needs, and lights that can be drawn."""
    try:
        drawable = len(lights_of(cloud)) <= LIGHTS_MAX
    except PhysHDRError:  # the panel and the bake say what is wrong with it
        return False
    return drawable and all(name in cloud.attributes for name in _REQUIRED)


def read_arrays(cloud: bpy.types.PointCloud) -> SplatArrays:
    """The attributes of a point cloud for which ``is_splats``. ``ValueError`` for a wrong number of SH."""
    base = read_attribute(cloud, "radiance:base")
    log_sh = _numbered(cloud, "physhdr:log_sh_")
    degree_of(len(log_sh))
    levels = tuple(float(level) for level in cloud.get("physhdr_levels", ()))
    gains = _numbered(cloud, "physhdr:level_log_gain_")
    if levels and len(gains) == len(levels):
        light = np.stack(gains)
    else:
        levels = ()
        try:
            light = np.stack(read_shares(cloud))
        except KeyError:
            # Nothing is known of the light: the first level scales everything, as for a baseline's model.
            light = np.zeros((len(lights_of(cloud)), len(base), 3), np.float32)
            light[0] = 1.0
    return SplatArrays(
        position=read_attribute(cloud, "position"),
        rotation=read_attribute(cloud, "rotation"),
        scale=read_attribute(cloud, "scale"),
        opacity=np.ascontiguousarray(base[:, 3]),
        log_sh=np.stack(log_sh),
        light=light,
        levels=levels,
    )


def read_tone_curve(cloud: bpy.types.PointCloud) -> ToneCurve | None:
    """The learned response that came with the model, if any."""
    places, values = cloud.get("physhdr_tone_curve_log_exposure"), cloud.get("physhdr_tone_curve")
    if places is None or values is None:
        return None
    return ToneCurve(np.array(places, np.float32), np.array(values, np.float32).reshape(-1, 3))


def identity(cloud: bpy.types.PointCloud) -> str:
    """What stays the same over undo and renaming; copies of a cloud share it, and their values."""
    return str(cloud.get(IDENTITY) or cloud.name_full)


def fingerprint(cloud: bpy.types.PointCloud) -> tuple[int, ...]:
    """Changes when points are added, deleted, moved, resized or recoloured (1 M Gaussians: 10 ms).

    Sums of the bits of the attributes that such edits change. Blender reports a changed modifier input as a
    changed point cloud; uploading again at every step of a slider would be slow.
    """
    values = (read_attribute(cloud, name) for name in ("position", "scale", "radiance:base"))
    return len(cloud.points), *(int(array.view(np.uint32).sum(dtype=np.uint64)) for array in values)


def _numbered(cloud: bpy.types.PointCloud, prefix: str) -> list[np.ndarray]:
    """Attributes ``prefix0``, ``prefix1``, … as long as there are."""
    values: list[np.ndarray] = []
    while f"{prefix}{len(values)}" in cloud.attributes:
        values.append(read_attribute(cloud, f"{prefix}{len(values)}"))
    return values


class SplatTextures:
    """Gaussians on the GPU; needs an active GPU context."""

    def __init__(self, arrays: SplatArrays) -> None:
        #: Another number for every upload.
        self.serial = next(_serial)
        self.count = arrays.count
        #: ``[N, 3]`` float32, for sorting.
        self.position = arrays.position
        self.degree = degree_of(len(arrays.log_sh))
        self.levels = arrays.levels
        self.rows = max(1, math.ceil(arrays.count / WIDTH))
        #: Layers: position and opacity; rotation (wxyz, unit); scale; SH of degree 0. Full floats.
        self.geometry = self._texture(
            "RGBA32F",
            np.column_stack([arrays.position, arrays.opacity]),
            arrays.rotation,
            arrays.scale,
            arrays.log_sh[0],
        )
        #: Layer k − 1: SH coefficient k. Half floats: 5e-4 of values around 0.5.
        self.harmonics = self._texture("RGBA16F", *(arrays.log_sh[1:] if self.degree else arrays.log_sh[:1]))
        self.lights = 0 if arrays.levels else len(arrays.light)
        layers = list(arrays.light)
        if not arrays.levels:
            # Stored, not subtracted in the shader: so it is 5e-4 of itself off, however small it is.
            layers.insert(0, np.maximum(1.0 - arrays.light.sum(axis=0), 0.0))
        #: Layers: the share that no light causes, and each light's; or the log gain at each level.
        self.light = self._texture("RGBA16F", *layers)

    def _texture(self, format: str, *layers: np.ndarray) -> gpu.types.GPUTexture:
        texels = np.zeros((len(layers), self.rows * WIDTH, 4), np.float32)
        for index, values in enumerate(layers):
            texels[index, : self.count, : values.shape[1]] = values
        return gpu_arrays.texture(texels.reshape(len(layers), self.rows, WIDTH, 4), format)
