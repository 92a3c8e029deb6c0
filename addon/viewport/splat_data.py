# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussians of a point cloud, as textures (there are no storage buffers in Blender's gpu module)."""

import itertools
import math
from dataclasses import dataclass

import bpy
import gpu
import numpy as np

from ...bridge import confidence, srgb
from ...bridge.errors import PhysHDRError
from ...bridge.model_file import DARKEST
from ...bridge.spherical_harmonics import C0, degree_of
from ..model.attributes import (
    BASE,
    CONFIDENCE,
    IDENTITY,
    LEVEL_LOG_GAIN,
    LOG_SH,
    POSITION,
    ROTATION,
    SCALE,
)
from ..model.point_cloud import lights_of, read_attribute, read_levels, read_numbered, read_shares
from . import gpu_arrays
from .chunks import CHUNK, Chunks, chunks_of, morton_order

#: Texel i is (i mod WIDTH, i div WIDTH) of every texture; a row has a whole number of chunks.
WIDTH = 4 * CHUNK
#: An array texture has room for 256 layers on every GPU: one a light, and what no light turns.
LIGHTS_MAX = 255

_serial = itertools.count()

_REQUIRED = (POSITION, SCALE, ROTATION, BASE, LOG_SH[0])


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
    return drawable and all(attribute.name in cloud.attributes for attribute in _REQUIRED)


def read_arrays(cloud: bpy.types.PointCloud) -> SplatArrays:
    """The attributes of a point cloud for which ``is_splats``. ``ValueError`` for a wrong number of SH."""
    base = read_attribute(cloud, BASE.name)
    log_sh = read_numbered(cloud, LOG_SH)
    degree_of(len(log_sh))
    levels = read_levels(cloud)
    gains = read_numbered(cloud, LEVEL_LOG_GAIN)
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
        position=read_attribute(cloud, POSITION.name),
        rotation=read_attribute(cloud, ROTATION.name),
        scale=read_attribute(cloud, SCALE.name),
        opacity=np.ascontiguousarray(base[:, 3]),
        log_sh=np.stack(log_sh),
        light=light,
        levels=levels,
    )


def confidence_arrays(cloud: bpy.types.PointCloud) -> SplatArrays:
    """The Gaussians of a model that knows its confidence in the colours of that (``bridge.confidence``),
    scene-linear, as if it were what they shine: the same from all sides and at every level."""
    shown = srgb.to_linear(confidence.colours(read_attribute(cloud, CONFIDENCE.name)))
    log_radiance = np.log(np.maximum(shown, DARKEST)).astype(np.float32)
    return SplatArrays(
        position=read_attribute(cloud, POSITION.name),
        rotation=read_attribute(cloud, ROTATION.name),
        scale=read_attribute(cloud, SCALE.name),
        opacity=np.ascontiguousarray(read_attribute(cloud, BASE.name)[:, 3]),
        log_sh=log_radiance[None] / np.float32(C0),
        light=np.ones((1, *log_radiance.shape), np.float32),
    )


def identity(cloud: bpy.types.PointCloud) -> str:
    """What stays the same over undo and renaming; copies of a cloud share it, and their values."""
    return str(cloud.get(IDENTITY) or cloud.name_full)


@dataclass(frozen=True, eq=False)
class Marks:
    """Which Gaussians something is true of: kept of a cleaned model, selected in Edit Mode."""

    #: Bool ``[N]``, in the order of the texels.
    values: np.ndarray
    #: Another number for other marks.
    serial: int


class SplatTextures:
    """Gaussians on the GPU, neighbours beside each other; needs an active GPU context."""

    def __init__(self, arrays: SplatArrays) -> None:
        #: Another number for every upload.
        self.serial = next(_serial)
        self.count = arrays.count
        #: ``[N]``: which Gaussian of the cloud each texel is.
        self.source = morton_order(arrays.position)
        #: ``[N, 3]`` float32, in the order of the texels, for sorting.
        self.position = arrays.position[self.source]
        self.chunks: Chunks = chunks_of(self.position, arrays.scale[self.source])
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

    @property
    def texture_bytes(self) -> int:
        """What the textures take on the GPU."""
        texel = {"geometry": 16, "harmonics": 8, "light": 8}
        layers = {"geometry": 4, "harmonics": max(1, (self.degree + 1) ** 2 - 1)}
        layers["light"] = len(self.levels) or self.lights + 1
        return sum(self.rows * WIDTH * size * layers[name] for name, size in texel.items())

    def marks(self, values: np.ndarray) -> Marks:
        """Marks of ``[N]`` booleans in the cloud's order."""
        return Marks(values[self.source], next(_serial))

    def _texture(self, format: gpu_arrays.Texels, *layers: np.ndarray) -> gpu.types.GPUTexture:
        texels = np.zeros((len(layers), self.rows * WIDTH, 4), np.float32)
        for index, values in enumerate(layers):
            texels[index, : self.count, : values.shape[1]] = values[self.source]
        return gpu_arrays.texture(texels.reshape(len(layers), self.rows, WIDTH, 4), format)
