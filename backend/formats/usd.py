# SPDX-License-Identifier: GPL-3.0-or-later
"""USD's ``ParticleField3DGaussianSplat`` (OpenUSD 26.03 and later): Gaussians with scene-linear radiance.

``positions``, ``orientations``, ``scales`` (standard deviations) and ``opacities`` are linear floats, SH a
Gaussian after the other. The schema leaves two things of the SH open; both are written as those do who write
and draw such files (NVIDIA's ovrtx and usd-convert-gsplat), which is 3DGS's way: what is described is
SH_C0·sh_0 + ½ + higher, and the direction leads from the camera to the Gaussian. What kind of colour that is
says ``colorSpace:name``: ``lin_rec709_scene`` where we write. Converters of PLY files name none, though their
colours are display-referred sRGB, and are read as such.

Needs usd-core (the extra ``usd``), which is imported only here.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.affine import matrices_of
from ...bridge.atomic import atomic_path
from ...bridge.axes import Up
from ...bridge.errors import BadValueError, FileDamagedError
from ...bridge.regular import damaged_where_it_fails, regular_file
from ...bridge.spherical_harmonics import degree_of
from ...bridge.splat_files import SplatCloud
from ..optional import PackageMissingError, needed
from .placed import FREE, MOST_TIMES, joined, moved

#: OpenUSD's names of what is written, and of 3DGS's colours; then all that is read as the one or the other.
RADIANCE, DISPLAY = "lin_rec709_scene", "srgb_rec709_scene"
LINEAR_SPACES = (RADIANCE, "lin_rec709", "raw", "identity")
SRGB_SPACES = (DISPLAY, "srgb_rec709_display", "")
#: So many standard deviations reach out of a Gaussian's middle in ``extent``, as the schema's kernel ends.
SUPPORT = 3.0
#: Prims of a stage that are looked at, those of instances too.
MOST_PRIMS = 100_000
#: Gaussians at a time where extents are worked out.
_BLOCK = 1 << 16
NEEDS = "Install it into the backend's Python: pip install 'physhdr[usd]' (usd-core 26.3 or newer)."
REMEDY = "Export it again: it may be cut off."


@dataclass(frozen=True, eq=False)
class UsdSplats:
    """All Gaussians of a stage, in metres and the stage's axes.

    ``is_radiance``: ``colour_sh`` describes scene-linear radiance, else colours as a screen shows them.
    """

    cloud: SplatCloud
    is_radiance: bool


def write_usd(path: Path, cloud: SplatCloud, up: Up = "z", comment: str = "") -> None:
    """Write ``cloud``, whose ``colour_sh`` are scene-linear radiance, as .usd, .usda, .usdc or .usdz.

    Atomically. ``up``: which way is up in its axes, as the stage will say; ``comment``: the layer's. Raises
    ``BadValueError`` (USD's up is Y or Z), ``PackageMissingError`` and ``OutputError``.
    """
    if up not in ("y", "z"):
        raise BadValueError(f"a USD stage cannot say that its up is {up}", "Give --up z or --up y.")
    pxr = _pxr("Gf", "Sdf", "Usd", "UsdGeom", "UsdUtils", "UsdVol", "Vt")
    Vt = pxr["Vt"]
    stage = pxr["Usd"].Stage.CreateInMemory()
    UsdGeom = pxr["UsdGeom"]
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if up == "z" else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().comment = comment
    field = pxr["UsdVol"].ParticleField3DGaussianSplat.Define(stage, "/Gaussians")
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
    pxr["Usd"].ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(RADIANCE)
    with atomic_path(path) as temporary:
        if path.suffix.lower() != ".usdz":
            stage.GetRootLayer().Export(str(temporary))
            return
        with tempfile.TemporaryDirectory() as folder:
            layer = Path(folder) / f"{path.stem}.usdc"
            stage.GetRootLayer().Export(str(layer))
            if not pxr["UsdUtils"].CreateNewUsdzPackage(pxr["Sdf"].AssetPath(str(layer)), str(temporary)):
                raise OSError("usd-core could not make the package")


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
    there are no Gaussians, or colours of a space that is not known here.
    """
    path = Path(path)
    regular_file(path, "Check the path, or choose another file.")
    pxr = _pxr("Usd", "UsdGeom", "UsdVol")
    with damaged_where_it_fails(f"{path} is not a readable USD file", REMEDY):
        stage = pxr["Usd"].Stage.Open(str(path))
        prims = _fields(pxr, path, stage)
        cache = pxr["UsdGeom"].XformCache(pxr["Usd"].TimeCode.EarliestTime())
        up: Up = "y" if pxr["UsdGeom"].GetStageUpAxis(stage) == pxr["UsdGeom"].Tokens.y else "z"
        metres = pxr["UsdGeom"].GetStageMetersPerUnit(stage)
    if not prims:
        raise BadValueError(
            f"{path} has no Gaussians (ParticleField3DGaussianSplat)",
            "For meshes use Blender's own File > Import > Universal Scene Description.",
        )
    clouds, spaces, fields = [], set(), dict[str, SplatCloud]()
    total = stored = 0
    for prim in prims:
        if total > max(FREE, MOST_TIMES * stored):
            break  # joined() says why
        original = str((prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath())
        with damaged_where_it_fails(f"{path}: {prim.GetPath()} cannot be read", REMEDY):
            if original not in fields:
                fields[original] = replace(_field(pxr, path, prim), up=up)
                stored += fields[original].count
            cloud = fields[original]
            total += cloud.count
            spaces.add(_color_space(prim))
            matrix = np.array(cache.GetLocalToWorldTransform(prim), np.float64).T
        clouds.append(moved(path, cloud, np.diag([metres, metres, metres, 1.0]) @ matrix))
    unknown = spaces - {*LINEAR_SPACES, *SRGB_SPACES}
    kinds = {space in LINEAR_SPACES for space in spaces}
    if unknown or len(kinds) > 1:
        raise BadValueError(
            f"{path}: its Gaussians' colours are {', '.join(sorted(spaces)):.200}",
            f"What is read: {RADIANCE} and {DISPLAY}, one of them in a file.",
        )
    cloud = joined(path, clouds, stored)
    if "" in spaces:
        cloud = replace(cloud, notes=(*cloud.notes, _NAMES_NONE))
    return UsdSplats(cloud, kinds.pop())


_NAMES_NONE = (
    "It names no colour space: its colours were taken as sRGB, as converters of PLY files write them."
)


def _fields(pxr: dict[str, Any], path: Path, stage: Any) -> list[Any]:
    """All prims that are Gaussians, those of instances too, each as often as it is instanced."""
    found = []
    # Instances within instances: a few lines name more prims than could ever be visited.
    for count, prim in enumerate(stage.Traverse(pxr["Usd"].TraverseInstanceProxies())):
        if count >= MOST_PRIMS:
            raise BadValueError(f"{path} has more than {MOST_PRIMS} prims", "Leave repetitions out.")
        if prim.IsA(pxr["UsdVol"].ParticleField3DGaussianSplat):
            found.append(prim)
    return found


def _color_space(prim: Any) -> str:
    """What the coefficients say of themselves, or else the nearest prim above them that says it; or ""."""
    coefficients = prim.GetAttribute("radiance:sphericalHarmonicsCoefficients")
    if coefficients.HasColorSpace():
        return str(coefficients.GetColorSpace())
    while prim:
        name = prim.GetAttribute("colorSpace:name")
        if name and name.HasAuthoredValue():
            return str(name.Get())
        prim = prim.GetParent()
    return ""


def _field(pxr: dict[str, Any], path: Path, prim: Any) -> SplatCloud:
    """One prim's Gaussians, in its own space. As the schema has it positions count, longer arrays are cut,
    shorter ones are as if they were not there."""
    field = pxr["UsdVol"].ParticleField3DGaussianSplat(prim)
    time = pxr["Usd"].TimeCode.EarliestTime()

    def values(name: str, width: int) -> np.ndarray | None:
        for each in (name, f"{name}h"):
            found = prim.GetAttribute(each).Get(time)
            if found is not None and len(found):
                return np.array(found).reshape(len(found), -1)[:, :width].astype(np.float32)
        return None

    position = values("positions", 3)
    if position is None:
        raise FileDamagedError(f"{path}: {prim.GetPath()} has no positions", REMEDY)
    count = len(position)
    degree = field.GetRadianceSphericalHarmonicsDegreeAttr().Get(time)
    if degree not in (0, 1, 2, 3):
        raise BadValueError(f"{path}: {prim.GetPath()} has SH of degree {degree}", "Degrees 0 to 3 are read.")

    def each_of(name: str, width: int, default: list[float], times: int = 1) -> np.ndarray:
        found = values(name, width)
        if found is None or len(found) < times * count:
            return np.tile(np.array(default, np.float32), (count, 1))
        return found[: times * count]

    coefficients = (degree + 1) ** 2
    sh = each_of("radiance:sphericalHarmonicsCoefficients", 3, [0.0] * 3, coefficients)
    return SplatCloud(
        position=position,
        rotation=each_of("orientations", 4, [0.0, 0.0, 0.0, 1.0])[:, [3, 0, 1, 2]],
        scale=each_of("scales", 3, [1.0] * 3),
        opacity=each_of("opacities", 1, [1.0])[:, 0],
        colour_sh=sh.reshape(count, -1, 3),
    )


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _pxr(*names: str) -> dict[str, Any]:
    """Modules of usd-core by name; raises ``PackageMissingError`` without them, or without the schema."""
    modules = {name: needed(f"pxr.{name}", "usd-core", "usd", "a USD file") for name in names}
    if not hasattr(modules["UsdVol"], "ParticleField3DGaussianSplat"):
        raise PackageMissingError("this usd-core is older than Gaussians in USD", NEEDS)
    return modules
