# SPDX-License-Identifier: GPL-3.0-or-later
"""USD's ``ParticleField3DGaussianSplat`` (OpenUSD 26.03 and later): Gaussians with scene-linear radiance.

``positions``, ``orientations``, ``scales`` (standard deviations) and ``opacities`` are linear floats, SH a
Gaussian after the other. The schema leaves two things of the SH open; both are written as those do who write
and draw such files (NVIDIA's ovrtx and usd-convert-gsplat), which is 3DGS's way: what is described is
SH_C0·sh_0 + ½ + higher, and the direction leads from the camera to the Gaussian. What kind of colour that is
says ``colorSpace:name``: ``lin_rec709_scene`` where we write, but for display colours that are to stay what
they are. Converters of PLY files name none, though their colours are display-referred sRGB, and are read as
such.

Needs usd-core (the extra ``usd``). Files are read in a separate process (``apart.py``): OpenUSD crashes on
damaged ones.
"""

import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.affine import matrices_of
from ...bridge.atomic import atomic_path
from ...bridge.axes import Up
from ...bridge.errors import BadValueError
from ...bridge.regular import regular_file
from ...bridge.spherical_harmonics import degree_of
from ...bridge.splat_files import SplatCloud
from ..optional import needed
from .apart import apart
from .placed import joined, moved
from .usd_stage import gaussians_of, module, volumes

#: OpenUSD's names of what is written, and of 3DGS's colours; then all that is read as the one or the other.
RADIANCE, DISPLAY = "lin_rec709_scene", "srgb_rec709_scene"
LINEAR_SPACES = (RADIANCE, "lin_rec709", "raw", "identity")
SRGB_SPACES = (DISPLAY, "srgb_rec709_display", "")
#: So many standard deviations reach out of a Gaussian's middle in ``extent``, as the schema's kernel ends.
SUPPORT = 3.0
#: Arrays with a row for each Gaussian.
_OF_EACH = ("position", "rotation", "scale", "opacity")
#: Gaussians at a time where extents are worked out.
_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class UsdSplats:
    """All Gaussians of a stage, in metres and the stage's axes.

    ``is_radiance``: ``colour_sh`` describes scene-linear radiance, else colours as a screen shows them.
    """

    cloud: SplatCloud
    is_radiance: bool


def write_usd(path: Path, cloud: SplatCloud, up: Up = "z", comment: str = "", space: str = RADIANCE) -> None:
    """Write ``cloud`` as .usd, .usda, .usdc or .usdz, atomically.

    ``up``: which way is up in its axes, as the stage will say; ``comment``: the layer's; ``space``: whether
    its ``colour_sh`` are scene-linear ``RADIANCE``, or as a screen shows them, ``DISPLAY``. Raises
    ``BadValueError`` (USD's up is Y or Z), ``PackageMissingError`` and ``OutputError``.
    """
    if up not in ("y", "z"):
        raise BadValueError(f"a USD stage cannot state the up axis {up}", "Give --up z or --up y.")
    UsdVol, Usd, UsdGeom, Vt = volumes(), module("Usd"), module("UsdGeom"), module("Vt")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if up == "z" else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().comment = comment
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Gaussians")
    prim = field.GetPrim()
    stage.SetDefaultPrim(prim)
    field.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(_floats(cloud.position)))
    field.CreateOrientationsAttr(Vt.QuatfArray.FromNumpy(_floats(cloud.rotation[:, [1, 2, 3, 0]])))
    field.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(_floats(cloud.scale)))
    field.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(_floats(cloud.opacity)))
    field.CreateRadianceSphericalHarmonicsDegreeAttr(degree_of(cloud.colour_sh.shape[1]))
    flat = _floats(cloud.colour_sh.reshape(-1, 3))
    field.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(flat))
    field.CreateProjectionModeHintAttr("perspective")
    field.CreateSortingModeHintAttr("zDepth")
    field.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(_floats(extent_of(cloud))))
    Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(space)
    with atomic_path(path) as temporary:
        if path.suffix.lower() != ".usdz":
            _made("the file", stage.GetRootLayer().Export, str(temporary))
            return
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            layer = Path(folder) / f"{path.stem}.usdc"
            _made("the file for the package", stage.GetRootLayer().Export, str(layer))
            packed = module("UsdUtils").CreateNewUsdzPackage
            _made("the package", packed, module("Sdf").AssetPath(str(layer)), str(temporary))
            _made("the package", _is_whole, temporary)


def _made(what: str, make: Callable[..., bool], *words: Any) -> None:
    """Call what makes a file and says whether it did; raises ``OSError``, as Python's own writers do."""
    try:
        done = make(*words)
    except module("Tf").ErrorException as error:  # a full disk; its words are lines of OpenUSD's source
        raise OSError(f"OpenUSD could not write all of {what}") from error
    if not done:
        raise OSError(f"OpenUSD could not write {what}")


def _is_whole(package: Path) -> bool:
    """Whether all of a package is there: OpenUSD closes one that the disk had no room for without a word."""
    try:
        with zipfile.ZipFile(package) as archive:
            return archive.testzip() is None
    except zipfile.BadZipFile:
        return False


def extent_of(cloud: SplatCloud) -> np.ndarray:
    """``[2, 3]``: the corners of a box around all Gaussians, ``SUPPORT`` standard deviations each."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, cloud.count, _BLOCK):
        rows = slice(start, start + _BLOCK)
        axes = matrices_of(cloud.rotation[rows]) * cloud.scale[rows, None, :]
        half = SUPPORT * np.sqrt(np.square(axes).sum(axis=2))
        low = np.minimum(low, (cloud.position[rows] - half).min(axis=0))
        high = np.maximum(high, (cloud.position[rows] + half).max(axis=0))
    return np.stack([low, high])


def read_usd(path: Path) -> UsdSplats:
    """Read every ``ParticleField3DGaussianSplat`` of a stage, each where its transformation puts it.

    Raises ``FileMissingError``, ``FileDamagedError``, ``PackageMissingError``, and ``BadValueError`` where
    there are no Gaussians, or colours of an unsupported space.
    """
    path = Path(path)
    regular_file(path, "Check the path, or choose another file.")
    needed("pxr", "usd-core", "a USD file")
    values, arrays = apart(path, gaussians_of, str(path))
    if not values["placed"]:
        raise BadValueError(
            f"{path} has no Gaussians (ParticleField3DGaussianSplat)",
            "For meshes use Blender's own File > Import > Universal Scene Description.",
        )
    fields = _fields(values, arrays)
    in_metres = np.diag([values["metres"]] * 3 + [1.0])
    clouds = [
        moved(path, fields[field], in_metres @ matrix)
        for (field, _), matrix in zip(values["placed"], arrays["matrices"], strict=True)
    ]
    spaces = {space for _, space in values["placed"]}
    unknown = spaces - {*LINEAR_SPACES, *SRGB_SPACES}
    kinds = {space in LINEAR_SPACES for space in spaces}
    if unknown or len(kinds) > 1:
        raise BadValueError(
            f"{path}: its Gaussians' colours are {', '.join(sorted(spaces)):.200}",
            f"Supported are {RADIANCE} and {DISPLAY}, one of them in a file.",
        )
    cloud = joined(path, clouds, sum(field.count for field in fields))
    if "" in spaces:
        cloud = replace(cloud, notes=(*cloud.notes, _NAMES_NONE))
    return UsdSplats(cloud, kinds.pop())


_NAMES_NONE = "It names no colour space: treating its colours as sRGB, as converters of PLY files write them."


def _fields(values: dict[str, Any], arrays: dict[str, np.ndarray]) -> list[SplatCloud]:
    """What ``gaussians_of`` found, each field in its own space."""
    fields, start, start_of_sh = [], 0, 0
    for count, coefficients in values["fields"]:
        rows = slice(start, start + count)
        sh = arrays["colour_sh"][start_of_sh : start_of_sh + count * coefficients]
        position, rotation, scale, opacity = (arrays[name][rows] for name in _OF_EACH)
        sh = sh.reshape(count, coefficients, 3)
        fields.append(SplatCloud(position, rotation, scale, opacity, sh, up=values["up"]))
        start, start_of_sh = rows.stop, start_of_sh + count * coefficients
    return fields


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)
