# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' formats that the backend alone reads: Gaussians as SOG, glTF, USD; paths of cameras."""

import importlib
import json
import math
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from physhdr.bridge.errors import PhysHDRError

from .cases import Target
from .files import check_model, folder_in, printable, require
from .mutate import tests_module

Attempt = Callable[[Path, str, bytes], None]
_FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
#: Gaussians in what our own writers make: few, that damage meets what describes them.
COUNT = 6
#: Seconds for text of megabytes in brackets in this process; users have OpenUSD in one that is ended.
TEXT_PATIENCE = 60.0
#: Seconds that OpenUSD's own process has for a case: it begins in half a second, on a busy machine in ten.
OPENUSD_PATIENCE = 30.0
#: A stage as people write it: nodes that move, turn and scale, halves, times, arrays of several lengths.
_STAGE = """#usda 1.0
(
    defaultPrim = "above"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 2
)
def Xform "above" (
    prepend apiSchemas = ["ColorSpaceAPI"]
)
{
    uniform token colorSpace:name = "lin_rec709_scene"
    double3 xformOp:translate = (100, 0, 0)
    float xformOp:rotateZ = 90
    float3 xformOp:scale = (1, 2, 1)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ", "xformOp:scale"]
    def ParticleField3DGaussianSplat "one"
    {
        point3f[] positions = [(100, 0, 0), (0, 200, 0)]
        float[] opacities = [ 0.25 , 0.5 ]
        quatf[] orientations = [(1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)]
        float3[] scales = [ (1, 2, 3), (4, 5, 6) ]
        uniform int radiance:sphericalHarmonicsDegree = 0
        float3[] radiance:sphericalHarmonicsCoefficients = [(1, 2, 3), (4, 5, 6), (7, 8, 9)]
    }
    def ParticleField3DGaussianSplat "two"
    {
        point3h[] positionsh = [ (0, 0, 50) ]
        half3[] scalesh = [ (1, 2, 4) ]
        half[] opacitiesh = [ 0.5 ]
        uniform int radiance:sphericalHarmonicsDegree = 1
    }
    def "three" (
        references = </above/one>
    )
    {
        point3f[] positions.timeSamples = {
            1: [(0, 0, 0)],
            2: [(0, 1, 0)],
        }
    }
}
"""
_RIG = """#usda 1.0
(
    endTimeCode = 3
    metersPerUnit = 0.01
    startTimeCode = 1
    timeCodesPerSecond = 25
    upAxis = "Y"
)
def Xform "rig"
{
    float3 xformOp:rotateXYZ = (10, 20, 30)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    def Camera "camera"
    {
        float focalLength.timeSamples = {
            1: 30,
            3: 40,
        }
        float horizontalAperture.timeSamples = {
            1: 36,
            3: 35,
        }
        float horizontalApertureOffset = 3
        float verticalAperture = 24
        token projection = "perspective"
        double3 xformOp:translate.timeSamples = {
            1: (0, 10, 200),
            3: (40, 10, 200),
        }
        matrix4d xformOp:transform = ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (5, 0, 0, 1) )
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:transform"]
    }
}
"""
_STILL = """#usda 1.0
def Camera "camera"
{
    float focalLength = 50
}
"""


def _fixture(name: str) -> bytes:
    """What another program wrote."""
    with zipfile.ZipFile(_FIXTURES / "other_formats.zip") as archive:
        return archive.read(name)


def _with_remedy(read: Attempt) -> Attempt:
    """An attempt whose refusals must say what to do."""

    def attempt(folder: Path, file: str, content: bytes) -> None:
        try:
            read(folder, file, content)
        except PhysHDRError as error:
            require(bool(error.hint), f"a refusal without a remedy: {error}")
            raise

    return attempt


def _some_cloud(degree: int) -> Any:
    return tests_module("backend/formats/conftest.py").some_cloud(COUNT, degree)


# ---- Gaussians ---------------------------------------------------------------------------------------------


def write_sogs(folder: Path) -> None:
    """Both versions as a zip, and as pictures beside their ``meta.json``."""
    sogs = tests_module("backend/formats/test_sog.py")
    for version in (1, 2):
        files = sogs.a_set(version)
        sogs.write(folder_in(folder, f"zip-{version}") / "splats.sog", files)
        for name, raw in files.items():
            (folder_in(folder, f"set-{version}") / name).write_bytes(raw)
    (folder_in(folder, "zip-other") / "splats.sog").write_bytes(_fixture("gaussians.sog"))


def write_gltfs(folder: Path) -> None:
    from physhdr.backend.formats.gltf import write_gltf

    write_gltf(folder_in(folder, "glb") / "splats.glb", _some_cloud(1))
    (folder_in(folder, "glb-other") / "splats.glb").write_bytes(_fixture("gaussians.glb"))
    path = folder_in(folder, "gltf") / "splats.gltf"
    write_gltf(path, _some_cloud(0), "lin_rec709_display")
    content = json.loads(path.read_text(encoding="utf-8"))
    half = math.sqrt(0.5)
    content["nodes"] = [
        {"children": [1, 2]},
        {"mesh": 0, "translation": [1.0, 2.0, 3.0], "rotation": [0.0, half, 0.0, half], "scale": [2, 2, 2]},
        {"mesh": 0, "matrix": [0, 0, -1, 0, 0, 2, 0, 0, 1, 0, 0, 0, 5, 6, 7, 1]},
    ]
    (folder_in(folder, "nodes") / "splats.gltf").write_text(json.dumps(content), encoding="utf-8")


def _here(read: Attempt) -> Attempt:
    """``read``, with OpenUSD in this process: milliseconds a try. Not for binary stages: they crash it."""

    def attempt(folder: Path, file: str, whole: bytes) -> None:
        from physhdr.backend.evaluate import camera_file
        from physhdr.backend.formats import usd

        def at_once(_: Path, function: Callable[..., Any], *words: Any) -> Any:
            return function(*words)

        with patch.object(usd, "apart", at_once), patch.object(camera_file, "apart", at_once):
            read(folder, file, whole)

    return attempt


def _soon(read: Attempt) -> Attempt:
    """``read``, with OpenUSD ended sooner than users have it."""

    def attempt(folder: Path, file: str, whole: bytes) -> None:
        with patch("physhdr.backend.formats.apart.PATIENCE", OPENUSD_PATIENCE):
            read(folder, file, whole)

    return attempt


def write_binary_usds(folder: Path) -> None:
    from physhdr.backend.formats.usd import write_usd

    for suffix in ("usdc", "usdz"):
        write_usd(folder_in(folder, suffix) / f"splats.{suffix}", _some_cloud(1))


def write_usds(folder: Path) -> None:
    """As text."""
    from physhdr.backend.formats.usd import write_usd

    write_usd(folder_in(folder, "ours") / "splats.usda", _some_cloud(1))
    with tempfile.TemporaryDirectory() as scratch:
        binary = Path(scratch) / "other.usdc"
        binary.write_bytes(_fixture("gaussians.usdc"))
        stage = importlib.import_module("pxr.Usd").Stage.Open(str(binary))
        stage.Export(str(folder_in(folder, "other") / "splats.usda"))
    (folder_in(folder, "nodes") / "splats.usda").write_text(_STAGE, encoding="utf-8")


def read_gaussians(folder: Path, file: str, _: bytes) -> None:
    """As ``physhdr export`` reads them, and as a model of ours."""
    from physhdr.backend.cli.convert import read_source
    from physhdr.bridge.ply_model import model_of_cloud
    from physhdr.bridge.splat_files import turned

    path = folder / ("meta.json" if folder.name.startswith("set-") else file)
    source = read_source(path)
    cloud = source.cloud
    require(source.model is None and cloud is not None, "a file of Gaussians")
    assert cloud is not None
    printable(" ".join(source.notes))
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    found = model_of_cloud(path, turned(cloud, turn), "LINEAR" if source.is_linear else "SRGB")
    check_model(found.model)
    printable(" ".join(found.notes))


# ---- cameras -----------------------------------------------------------------------------------------------


def _pose(index: int) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.3 * index, 0.8, -0.2 * index]).as_matrix()
    matrix[:3, 3] = 0.5 * index, -2.0, 1.0
    return matrix


def write_camera_files(folder: Path) -> None:
    """nerfstudio's, alone and with what its training did to the world, and Blender's."""
    from physhdr.bridge.shots import Shot, Shots, write_shots

    frames = [{"camera_to_world": _pose(k).ravel().tolist(), "fov": 50.0 + k} for k in range(3)]
    content = {"camera_type": "perspective", "render_height": 72, "render_width": 96, "fps": 25}
    text = json.dumps(content | {"camera_path": frames})
    for name in ("nerfstudio", "world"):
        (folder_in(folder, name) / "path.json").write_text(text)
    space = {"transform": _pose(2)[:3].tolist(), "scale": 0.37}
    (folder / "world" / "dataparser_transforms.json").write_text(json.dumps(space))
    shots = [Shot(_pose(k), 60.0, 61.0, 32.0, 24.0, float(k), (0.5, 2.0)) for k in range(3)]
    write_shots(folder_in(folder, "shots") / "path.json", Shots(64, 48, 24.0, shots))


def write_camera_stages(folder: Path) -> None:
    """As text."""
    (folder_in(folder, "moving") / "path.usda").write_text(_RIG, encoding="utf-8")
    (folder_in(folder, "still") / "path.usda").write_text(_STILL, encoding="utf-8")


def read_cameras(folder: Path, file: str, _: bytes) -> None:
    """As ``physhdr render --camera`` reads them, and a camera of each frame."""
    from physhdr.backend.evaluate.camera_file import read_camera_file
    from physhdr.backend.evaluate.camera_path import camera_of
    from physhdr.backend.scene.camera import Camera

    like = Camera.from_field_of_view(np.eye(4), 64, 48, 0.8)
    is_world = folder.name == "world"
    path = folder / ("path.json" if is_world else file)
    shots = read_camera_file(path, like, space=folder / "dataparser_transforms.json" if is_world else None)
    require(bool(shots.frames), "a path without frames")
    require(math.isfinite(shots.fps) and shots.fps > 0.0, "frames a second")
    for shot in shots.frames:
        try:
            camera = camera_of(shot, shots)
            projection = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
            pixels = projection[:2] * np.array([0.1, -0.1]) + projection[2:]
        except PhysHDRError as error:  # the reader promises frames that can be drawn
            raise AssertionError(f"no camera can be made of a frame: {error}") from error
        require(camera.width > 0 and camera.height > 0, "a picture's size")
        require(camera.fx > 0.0 and camera.fy > 0.0, "a focal length of 0 or less")
        require(bool((np.abs([*pixels, *camera.position]) < 1e12).all()), "a camera beyond all limits")
        require(bool(np.isfinite(camera.world_to_camera).all()), "a pose, which is not finite")
        require(math.isfinite(shot.exposure_ev) and all(level >= 0.0 for level in shot.levels), "a level")


TARGETS = (
    Target("Gaussians: SOG", write_sogs, _with_remedy(read_gaussians), 3000),
    Target("Gaussians: glTF", write_gltfs, _with_remedy(read_gaussians), 3000),
    Target(
        "Gaussians: USD",
        write_usds,
        _with_remedy(_here(read_gaussians)),
        3000,
        needs="pxr",
        patience=TEXT_PATIENCE,
    ),
    Target(
        "Gaussians: binary USD",
        write_binary_usds,
        _with_remedy(_soon(read_gaussians)),
        150,
        needs="pxr",
        patience=2.0 * OPENUSD_PATIENCE,
    ),
    Target("camera paths: JSON", write_camera_files, _with_remedy(read_cameras), 2000),
    Target(
        "camera paths: USD",
        write_camera_stages,
        _with_remedy(_here(read_cameras)),
        1500,
        needs="pxr",
        patience=TEXT_PATIENCE,
    ),
)
