# SPDX-License-Identifier: GPL-3.0-or-later
"""What OpenUSD reads from a stage of unknown origin: called by ``apart`` only, in a separate process.

It answers with numbers as in the file; the caller interprets them.
"""

import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...bridge.errors import BadValueError, FileDamagedError
from ...bridge.regular import damaged_where_it_fails
from ..optional import PackageMissingError, needed
from ..shell import pip_install
from .apart import Answer
from .placed import FREE, MOST_TIMES

#: Prims of a stage that are looked at, those of instances too.
MOST_PRIMS = 100_000
INSTALL_NEWER = f"Install a newer one (26.3 or later): {pip_install('usd-core', upgrade=True)}"
REMEDY = "Export it again: it may be cut off."


def module(name: str, what: str = "a USD file") -> ModuleType:
    """A module of usd-core; raises ``PackageMissingError``: ``what`` needs it."""
    return needed(f"pxr.{name}", "usd-core", what)


def volumes() -> ModuleType:
    """``pxr.UsdVol``, in which Gaussians are; raises ``PackageMissingError`` where it has none."""
    found = module("UsdVol")
    if not hasattr(found, "ParticleField3DGaussianSplat"):
        raise PackageMissingError("this usd-core is older than Gaussians in USD", INSTALL_NEWER)
    return found


# ---- Gaussians -----------------------------------------------------------------------------------------


def gaussians_of(name: str) -> Answer:
    """Every ``ParticleField3DGaussianSplat`` of the stage in the file ``name``.

    ``up`` ("y", "z"), ``metres`` of a unit; ``fields``: how many Gaussians and coefficients each has, whose
    arrays stand one after the other in ``position`` ``[N, 3]``, ``rotation`` ``[N, 4]`` wxyz, ``scale``
    ``[N, 3]``, ``opacity`` ``[N]``, ``colour_sh`` ``[Σ N K, 3]``, float32, in its own space; ``placed``: of
    each time that a field stands in the stage its index and its colour space, with ``matrices``
    ``[P, 4, 4]`` float64 beside. Raises ``FileDamagedError``, ``PackageMissingError``, ``BadValueError``.
    """
    Vol, Usd, Geom = volumes(), module("Usd"), module("UsdGeom")
    path = Path(name)
    with damaged_where_it_fails(f"{path} is not a readable USD file", REMEDY):
        stage = Usd.Stage.Open(str(path))
        prims = _fields(path, stage, Usd, Vol)
        cache = Geom.XformCache(Usd.TimeCode.EarliestTime())
        up = "y" if Geom.GetStageUpAxis(stage) == Geom.Tokens.y else "z"
        metres = float(Geom.GetStageMetersPerUnit(stage))
    fields: list[dict[str, np.ndarray]] = []
    numbers: dict[str, int] = {}
    placed, matrices = [], []
    total = stored = 0
    for prim in prims:
        if total > max(FREE, MOST_TIMES * stored):
            break  # who joins them says why
        original = str((prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath())
        with damaged_where_it_fails(f"{path}: {prim.GetPath()} cannot be read", REMEDY):
            if original not in numbers:
                numbers[original] = len(fields)
                fields.append(_field(path, prim, Vol, Usd.TimeCode.EarliestTime()))
                stored += len(fields[-1]["position"])
            total += len(fields[numbers[original]]["position"])
            placed.append([numbers[original], _color_space(prim)])
            matrices.append(np.array(cache.GetLocalToWorldTransform(prim), np.float64).T)
    values = {
        "up": up,
        "metres": metres,
        "fields": [[len(f["position"]), len(f["colour_sh"]) // len(f["position"])] for f in fields],
        "placed": placed,
    }
    if not fields:
        return values, {}
    arrays = {each: np.concatenate([field[each] for field in fields]) for each in fields[0]}
    return values, {**arrays, "matrices": np.stack(matrices)}


def _fields(path: Path, stage: Any, Usd: ModuleType, Vol: ModuleType) -> list[Any]:
    """All prims that are Gaussians, those of instances too, each as often as it is instanced."""
    found = []
    # Instances within instances: a few lines name more prims than could ever be visited.
    for count, prim in enumerate(stage.Traverse(Usd.TraverseInstanceProxies())):
        if count >= MOST_PRIMS:
            raise BadValueError(f"{path} has more than {MOST_PRIMS} prims", "Remove repetitions.")
        if prim.IsA(Vol.ParticleField3DGaussianSplat):
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


def _field(path: Path, prim: Any, Vol: ModuleType, time: Any) -> dict[str, np.ndarray]:
    """One prim's Gaussians, in its own space. As the schema has it positions count, longer arrays are cut,
    shorter ones are as if they were not there."""
    field = Vol.ParticleField3DGaussianSplat(prim)

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
        raise BadValueError(f"{path}: {prim.GetPath()} has SH of degree {degree}", "Use degrees 0 to 3.")

    def each_of(name: str, width: int, default: list[float], times: int = 1) -> np.ndarray:
        found = values(name, width)
        if found is None or len(found) < times * count:
            return np.tile(np.array(default, np.float32), (count, 1))
        return found[: times * count]

    coefficients = (degree + 1) ** 2
    return {
        "position": position,
        "rotation": each_of("orientations", 4, [0.0, 0.0, 0.0, 1.0])[:, [3, 0, 1, 2]],
        "scale": each_of("scales", 3, [1.0] * 3),
        "opacity": each_of("opacities", 1, [1.0])[:, 0],
        "colour_sh": each_of("radiance:sphericalHarmonicsCoefficients", 3, [0.0] * 3, coefficients),
    }


# ---- a camera ------------------------------------------------------------------------------------------


def camera_of(name: str, prim: str | None, most: int, remedy: str) -> Answer:
    """A camera at each of the stage's time codes, ``most`` at most; once where it says no range of them.

    ``prim``: which one, by its path or name. ``path`` of the camera, ``up`` ("y", "z"), ``metres`` of a unit,
    ``fps``, ``perspective``: a bool for each time; ``times`` ``[T]``, ``poses`` ``[T, 4, 4]`` camera → stage
    and ``lenses`` ``[T, 5]``: aperture across and down, their offsets, focal length. Raises
    ``FileDamagedError`` with ``remedy``, ``PackageMissingError``, ``BadValueError``.
    """
    what = f"{Path(name).name}: a USD camera"
    Usd, Geom = module("Usd", what), module("UsdGeom", what)
    unreadable = f"{name} is no USD stage that can be read"
    with damaged_where_it_fails(unreadable, remedy):
        stage = Usd.Stage.Open(name)
        cameras = [each for each in stage.Traverse() if each.IsA(Geom.Camera)]
    camera = Geom.Camera(_the_one(name, cameras, prim))
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not stage.HasAuthoredTimeCodeRange():
        first = last = 0.0
    if not (math.isfinite(first) and math.isfinite(last) and 0.0 <= last - first < most):
        raise BadValueError(
            f"{name}: its time codes are from {first:g} to {last:g}",
            f"Export from a first to a later frame, at most {most} of them.",
        )
    times = first + np.arange(math.floor(last - first) + 1)
    with damaged_where_it_fails(unreadable, remedy):
        found = [camera.GetCamera(Usd.TimeCode(float(time))) for time in times]
    values = {
        "path": str(camera.GetPath()),
        "up": "y" if Geom.GetStageUpAxis(stage) == Geom.Tokens.y else "z",
        "metres": float(Geom.GetStageMetersPerUnit(stage)),
        "fps": float(stage.GetTimeCodesPerSecond()),
        "perspective": [each.projection == each.Perspective for each in found],
    }
    lenses = [
        (
            each.horizontalAperture,
            each.verticalAperture,
            each.horizontalApertureOffset,
            each.verticalApertureOffset,
            each.focalLength,
        )
        for each in found
    ]
    # Gf's matrices multiply rows from the left.
    poses = np.stack([np.array(each.transform, np.float64).T for each in found])
    return values, {"times": times, "poses": poses, "lenses": np.array(lenses, np.float64)}


def _the_one(name: str, cameras: list[Any], prim: str | None) -> Any:
    """The camera that is asked for, or the only one."""
    names = [str(each.GetPath()) for each in cameras]
    if not cameras:
        raise BadValueError(f"{name} has no camera", "Export one: in Blender, USD with Cameras ticked.")
    if prim is None:
        if len(cameras) > 1:
            raise BadValueError(
                f"{name} has {len(cameras)} cameras", f"Choose by --camera-prim: {', '.join(names):.400}."
            )
        return cameras[0]
    found = [each for each, path in zip(cameras, names, strict=True) if prim in (path, each.GetName())]
    if len(found) != 1:
        raise BadValueError(
            f"{name} has {'no' if not found else 'several'} cameras {prim!r:.80}",
            f"There are: {', '.join(names):.400}.",
        )
    return found[0]
