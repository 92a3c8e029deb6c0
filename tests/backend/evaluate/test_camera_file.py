# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of cameras from files, against the programs that write them: OpenUSD's frustum, nerfstudio's reader.

nerfstudio's is run where PHYSHDR_NERFSTUDIO names a folder that it is installed in (docs/other-programs.md).
"""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physhdr.backend.cli.rendering import shots_in
from physhdr.backend.cli.video import Video
from physhdr.backend.evaluate.camera_file import read_camera_file
from physhdr.backend.evaluate.camera_path import camera_of
from physhdr.backend.optional import PackageMissingError
from physhdr.backend.scene import Scene, read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.shots import Shot, Shots, write_shots

LIKE = Camera.from_field_of_view(np.eye(4), 64, 48, 0.8)
NERFSTUDIO = os.environ.get("PHYSHDR_NERFSTUDIO")


def pose(index: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.3 * index, 0.8, -0.2 * index]).as_matrix()
    matrix[:3, 3] = 0.5 * index, -2.0, 1.0 / 3.0
    return matrix


def nerfstudio_path(path: Path, count: int = 3, **changes) -> Path:
    """As the viewer exports it."""
    frames = [
        {"camera_to_world": pose(k).ravel().tolist(), "fov": 50.0 + k, "aspect": 96 / 72}
        for k in range(count)
    ]
    content = {"camera_type": "perspective", "render_height": 72, "render_width": 96, "fps": 25, "seconds": 2}
    path.write_text(json.dumps(content | {"is_cycle": False, "camera_path": frames} | changes))
    return path


def test_a_path_of_nerfstudios_viewer(tmp_path: Path) -> None:
    shots = read_camera_file(nerfstudio_path(tmp_path / "path.json"), LIKE)
    assert (shots.width, shots.height, shots.fps, len(shots.frames)) == (96, 72, 25.0, 3)
    for k, shot in enumerate(shots.frames):
        np.testing.assert_allclose(shot.camera_to_world, pose(k), atol=1e-15)
        # fov is the vertical angle.
        assert 2.0 * math.degrees(math.atan(36.0 / shot.fy)) == pytest.approx(50.0 + k, abs=1e-12)
        assert (shot.fx, shot.cx, shot.cy) == (shot.fy, 48.0, 36.0)


@pytest.mark.skipif(not NERFSTUDIO, reason="PHYSHDR_NERFSTUDIO names no folder with nerfstudio")
def test_it_is_what_nerfstudio_itself_reads(tmp_path: Path) -> None:
    file = nerfstudio_path(tmp_path / "path.json")
    code = (
        f"import sys, json; sys.path.append({NERFSTUDIO!r})\n"
        "from nerfstudio.cameras.camera_paths import get_path_from_json\n"
        "c = get_path_from_json(json.load(open(sys.argv[1])))\n"
        "print(json.dumps([c.camera_to_worlds.tolist(), c.fx.flatten().tolist(), c.cx.flatten().tolist(), "
        "c.cy.flatten().tolist()]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    poses, fx, cx, cy = json.loads(done.stdout.splitlines()[-1])
    shots = read_camera_file(file, LIKE)
    np.testing.assert_allclose(poses, [shot.camera_to_world[:3] for shot in shots.frames], atol=1e-6)
    np.testing.assert_allclose(fx, [shot.fx for shot in shots.frames], rtol=1e-6)
    np.testing.assert_allclose([cx, cy], [[48.0] * 3, [36.0] * 3])


def test_what_training_did_to_the_world_is_taken_back(tmp_path: Path) -> None:
    """x' = scale · (R x + t) is nerfstudio's space: a camera that is put there comes back."""
    turn, move, scale = Rotation.from_euler("xyz", [0.4, -0.2, 1.1]).as_matrix(), [0.5, -1.5, 2.0], 0.37
    transform = np.column_stack([turn, move])
    (tmp_path / "dataparser_transforms.json").write_text(
        json.dumps({"transform": transform.tolist(), "scale": scale})
    )
    frames = []
    for k in range(2):
        there = pose(k)
        there[:3, :3] = turn @ pose(k)[:3, :3]
        there[:3, 3] = scale * (turn @ pose(k)[:3, 3] + move)
        frames.append({"camera_to_world": there.ravel().tolist(), "fov": 50.0})
    file = nerfstudio_path(tmp_path / "path.json", camera_path=frames)
    shots = read_camera_file(file, LIKE, space=tmp_path / "dataparser_transforms.json")
    for k, shot in enumerate(shots.frames):
        np.testing.assert_allclose(shot.camera_to_world, pose(k), atol=1e-12)


def test_what_ns_process_data_did_before_stays(tmp_path: Path) -> None:
    """It writes poses that it has turned, and nerfstudio notes its own turn and that one as one.

    Our world is that of the written poses: c → s·(A c), then in training → S·(O ·), noted as O A and S s.
    """
    orient, applied = np.eye(4), np.eye(4)
    orient[:3] = np.column_stack([Rotation.from_euler("z", 0.7).as_matrix(), [-0.5, 0.0, 0.25]])
    applied[:3] = [[1, 0, 0, 0.1], [0, 0, 1, 0.2], [0, -1, 0, 0.3]]
    in_training = orient @ pose(1)
    in_training[:3, 3] *= 0.4
    frames = [{"camera_to_world": in_training.ravel().tolist(), "fov": 50.0}]
    file = nerfstudio_path(tmp_path / "path.json", camera_path=frames)
    space, poses = tmp_path / "dataparser_transforms.json", tmp_path / "transforms.json"
    space.write_text(json.dumps({"transform": (orient @ applied)[:3].tolist(), "scale": 0.4 * 2.5}))
    poses.write_text(json.dumps({"applied_transform": applied[:3].tolist(), "applied_scale": 2.5}))
    shots = read_camera_file(file, LIKE, space=space, poses=poses)
    np.testing.assert_allclose(shots.frames[0].camera_to_world, pose(1), atol=1e-12)
    # One that says nothing of it, as ours do, was left as it was.
    poses.write_text("{}")
    space.write_text(json.dumps({"transform": orient[:3].tolist(), "scale": 0.4}))
    shots = read_camera_file(file, LIKE, space=space, poses=poses)
    np.testing.assert_allclose(shots.frames[0].camera_to_world, pose(1), atol=1e-12)
    for wrong in ({"applied_transform": [[1, 2], [3, 4]]}, {"applied_scale": 0}, {"applied_scale": None}):
        poses.write_text(json.dumps(wrong))
        with pytest.raises(PhysHDRError, match=r"transforms\.json"):
            read_camera_file(file, LIKE, space=space, poses=poses)
    poses.unlink()
    with pytest.raises(FileMissingError, match=r"transforms\.json[\s\S]*--data"):
        read_camera_file(file, LIKE, space=space, poses=poses)


def filmed(scene: Scene, **options) -> list[Camera]:
    """The cameras of a video's frames."""
    video = Video(source=Path("run"), out=[Path("a.mp4")], **options)
    video._check()
    frames = video.plan(scene, SimpleNamespace(lights=("ambient",)), video.shots_of(scene))
    return [frame.camera for frame in frames]


def test_a_video_along_it_is_in_the_world_of_the_run(data_set: Path, tmp_path: Path) -> None:
    """As a render: what nerfstudio's training did is taken back, what ns-process-data did stays."""
    orient, applied = np.eye(4), np.eye(4)
    orient[:3] = np.column_stack([Rotation.from_euler("z", 0.7).as_matrix(), [-0.5, 0.0, 0.25]])
    applied[:3] = [[1, 0, 0, 0.1], [0, 0, 1, 0.2], [0, -1, 0, 0.3]]
    frames = []
    for k in range(3):
        there = orient @ pose(k)
        there[:3, 3] *= 0.4
        frames.append({"camera_to_world": there.ravel().tolist(), "fov": 50.0})
    file = nerfstudio_path(tmp_path / "path.json", camera_path=frames)
    space = tmp_path / "dataparser_transforms.json"
    space.write_text(json.dumps({"transform": (orient @ applied)[:3].tolist(), "scale": 0.4 * 2.5}))
    told = {"applied_transform": applied[:3].tolist(), "applied_scale": 2.5}
    (tmp_path / "transforms.json").write_text(json.dumps(told))
    scene = replace(read_scene(data_set), layout="nerfstudio", root=tmp_path)
    drawn = shots_in(scene, file, None, space)
    for k, camera in enumerate(filmed(scene, camera=file, camera_space=space)):
        np.testing.assert_allclose(camera.camera_to_world, pose(k), atol=1e-12)
        np.testing.assert_array_equal(camera.camera_to_world, drawn.frames[k].camera_to_world)
        assert (camera.width, camera.fx) == (drawn.width, drawn.frames[k].fx)


def test_blenders_shots_may_be_one(tmp_path: Path) -> None:
    write_shots(
        tmp_path / "a.json", Shots(64, 48, 24.0, [Shot(pose(1), 60.0, 61.0, 32.0, 24.0, 1.0, (0.5,))])
    )
    (shot,) = read_camera_file(tmp_path / "a.json", LIKE).frames
    np.testing.assert_array_equal(shot.camera_to_world, pose(1))
    assert (shot.exposure_ev, shot.levels) == (1.0, (0.5,))
    with pytest.raises(BadValueError, match="from 2 to"):
        read_camera_file(tmp_path / "a.json", LIKE, fewest=2)


# ---- USD -------------------------------------------------------------------------------------------------


def stage_with_a_camera(path: Path, up: str, metres: float, frames: int = 3, scale: float = 1.0):
    """A camera that moves, below a parent that is turned and scaled; the stage and the camera."""
    pytest.importorskip("pxr", reason="needs usd-core (the extra usd)")
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    stage.SetStartTimeCode(10)
    stage.SetEndTimeCode(10 + frames - 1)
    stage.SetTimeCodesPerSecond(25)
    parent = UsdGeom.Xform.Define(stage, "/rig")
    parent.AddRotateXYZOp().Set(Gf.Vec3f(10, 20, 30))
    parent.AddScaleOp().Set(Gf.Vec3f(scale, scale, scale))
    camera = UsdGeom.Camera.Define(stage, "/rig/camera")
    camera.CreateHorizontalApertureAttr(36.0)
    camera.CreateVerticalApertureAttr(24.0)
    camera.CreateHorizontalApertureOffsetAttr(3.0)
    camera.CreateVerticalApertureOffsetAttr(-2.0)
    move, turn, focal = camera.AddTranslateOp(), camera.AddRotateXYZOp(), camera.CreateFocalLengthAttr()
    for k in range(frames):
        move.Set(Gf.Vec3d(0.2 * k / metres, 0.1 / metres, 2.0 / metres), 10 + k)
        turn.Set(Gf.Vec3f(5 * k, -10, 3), 10 + k)
        focal.Set(30.0 + 5 * k, 10 + k)
    return stage, camera


@pytest.mark.parametrize(("up", "metres", "suffix"), [("Z", 1.0, "usda"), ("Y", 0.01, "usdc")])
def test_a_usd_camera_sees_points_where_its_own_frustum_does(tmp_path: Path, up, metres, suffix) -> None:
    path = tmp_path / f"camera.{suffix}"
    stage, camera = stage_with_a_camera(path, up, metres, scale=2.0)
    from pxr import Gf

    stage.GetRootLayer().Save()
    shots = read_camera_file(path, LIKE)
    assert (shots.width, shots.height, shots.fps, len(shots.frames)) == (64, 43, 25.0, 3)
    rng = np.random.default_rng(2)
    for k, shot in enumerate(shots.frames):
        ours = camera_of(shot, shots)
        frustum = camera.GetCamera(10 + k).frustum
        matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        for x, y, z in rng.uniform((-0.5, -0.3, -9.0), (0.5, 0.3, -3.0), (8, 3)):
            point = (ours.camera_to_world @ [x, y, z, 1.0])[:3]  # in Blender's world, metres
            theirs = point / metres
            if up == "Y":
                theirs = np.array([theirs[0], theirs[2], -theirs[1]])
            # −1…1 to the right and up over the picture.
            device = matrix.Transform(Gf.Vec3d(*theirs.tolist()))
            expected = (64 * (0.5 + 0.5 * device[0]), 43 * (0.5 - 0.5 * device[1]))
            u, v, depth = ours.world_to_camera[:3] @ [*point, 1.0]
            found = (ours.fx * u / depth + ours.cx, ours.fy * v / depth + ours.cy)
            np.testing.assert_allclose(found, expected, atol=2e-4)  # USD's apertures are of 32 bits


@pytest.mark.long
def test_which_of_a_stages_cameras(tmp_path: Path) -> None:
    stage, _ = stage_with_a_camera(tmp_path / "a.usda", "Z", 1.0)
    from pxr import UsdGeom

    UsdGeom.Camera.Define(stage, "/other")
    stage.GetRootLayer().Save()
    with pytest.raises(BadValueError, match=r"2 cameras\n.*--camera-prim: /rig/camera, /other"):
        read_camera_file(tmp_path / "a.usda", LIKE)
    for prim in ("camera", "/rig/camera"):
        assert len(read_camera_file(tmp_path / "a.usda", LIKE, prim).frames) == 3
    with pytest.raises(BadValueError, match="no cameras 'none'"):
        read_camera_file(tmp_path / "a.usda", LIKE, "none")


def test_a_video_takes_one_of_a_stages_cameras(data_set: Path, tmp_path: Path) -> None:
    stage, _ = stage_with_a_camera(tmp_path / "a.usda", "Z", 1.0)
    from pxr import UsdGeom

    UsdGeom.Camera.Define(stage, "/other")
    stage.GetRootLayer().Save()
    scene = read_scene(data_set)
    with pytest.raises(BadValueError, match="--camera-prim"):
        filmed(scene, camera=tmp_path / "a.usda")
    found = filmed(scene, camera=tmp_path / "a.usda", camera_prim="/rig/camera")
    assert len({camera.camera_to_world.tobytes() for camera in found}) == 3
    still = filmed(scene, camera=tmp_path / "a.usda", camera_prim="other")
    assert len({camera.camera_to_world.tobytes() for camera in still}) == 1


@pytest.mark.long
def test_stages_that_have_no_path(tmp_path: Path) -> None:
    stage, camera = stage_with_a_camera(tmp_path / "a.usda", "Z", 1.0)
    camera.CreateProjectionAttr("orthographic")
    stage.GetRootLayer().Save()
    with pytest.raises(BadValueError, match="orthographic"):
        read_camera_file(tmp_path / "a.usda", LIKE)

    stage, _ = stage_with_a_camera(tmp_path / "long.usda", "Z", 1.0)
    stage.SetEndTimeCode(1e15)
    stage.GetRootLayer().Save()
    with pytest.raises(BadValueError, match="time codes"):
        read_camera_file(tmp_path / "long.usda", LIKE)

    stage, camera = stage_with_a_camera(tmp_path / "sheared.usda", "Z", 1.0)
    parent = camera.GetPrim().GetParent()
    parent.GetAttribute("xformOp:scale").Set((1.0, 3.0, 1.0))
    stage.GetRootLayer().Save()
    with pytest.raises(BadValueError, match="sheared"):
        read_camera_file(tmp_path / "sheared.usda", LIKE)

    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    with pytest.raises(BadValueError, match="has no camera"):
        read_camera_file(tmp_path / "empty.usda", LIKE)
    for name, content in (
        ("torn.usda", b"#usda 1.0\ndef Camera {"),
        ("torn.usdc", b"PXR-USDC\0\0"),
        ("a.usdz", b""),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileDamagedError, match="no USD stage"):
            read_camera_file(tmp_path / name, LIKE)


def test_without_usd_core_it_says_what_to_install(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    for name in ("pxr", "pxr.Usd"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(PackageMissingError, match=r"pip install usd-core"):
        read_camera_file(tmp_path / "a.usda", LIKE)


# ---- what is no path -------------------------------------------------------------------------------------

NAN = [[math.nan] * 4] * 4


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"camera_path": []}, BadValueError, "has 0 frames"),
        ({"camera_path": 3}, FileDamagedError, "not a list"),
        ({"camera_path": [7]}, FileDamagedError, "frame 0 is not an object"),
        ({"camera_path": [{"camera_to_world": [1.0] * 15, "fov": 50}]}, BadValueError, "not a 4×4 matrix"),
        ({"camera_path": [{"camera_to_world": NAN, "fov": 50}]}, BadValueError, "NaN"),
        ({"camera_path": [{"camera_to_world": [2.0] * 16, "fov": 50}]}, BadValueError, "not a rotation"),
        ({"camera_path": [{"camera_to_world": np.eye(4).tolist()}]}, BadValueError, "'fov'"),
        (
            {"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": 180}]},
            BadValueError,
            "between 0 and 180",
        ),
        ({"camera_type": "equirectangular"}, BadValueError, "equirectangular"),
        ({"render_width": 0}, BadValueError, "render_width"),
        ({"render_height": None}, BadValueError, "render_height"),
        ({"fps": 0}, BadValueError, "fps"),
    ],
)
def test_what_is_wrong_with_a_path_is_named(tmp_path: Path, changes, error, message) -> None:
    with pytest.raises(error, match=message) as raised:
        read_camera_file(nerfstudio_path(tmp_path / "path.json", **changes), LIKE)
    assert "path.json" in str(raised.value)


def test_files_that_are_no_paths(tmp_path: Path) -> None:
    with pytest.raises(FileMissingError):
        read_camera_file(tmp_path / "none.json", LIKE)
    for content in ("{", "[]", "{}", '{"frames": []}', "\0\0"):
        (tmp_path / "a.json").write_text(content)
        with pytest.raises(FileDamagedError, match=r"a\.json"):
            read_camera_file(tmp_path / "a.json", LIKE)
    (tmp_path / "bad.json").write_text('{"transform": [[1, 2], [3, 4]], "scale": 1}')
    path = nerfstudio_path(tmp_path / "path.json")
    with pytest.raises(PhysHDRError, match=r"bad\.json"):
        read_camera_file(path, LIKE, space=tmp_path / "bad.json")
    with pytest.raises(BadValueError, match="--camera-prim is for USD"):
        read_camera_file(path, LIKE, prim="camera")
