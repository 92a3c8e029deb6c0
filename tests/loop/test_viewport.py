# SPDX-License-Identifier: GPL-3.0-or-later
"""Law 7 for the viewport's shader: it draws what the CPU rasteriser draws, from the same camera."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.model_file import Model, write_model

ROOT = Path(__file__).resolve().parent.parent.parent
BLENDER = ROOT / ".venvs" / "run-blender"
EYE = np.array([1.6, -2.2, 1.1])
WIDTH, HEIGHT = 120, 90
LIGHTS = ("ambient", "pendant", "screen")

pytestmark = pytest.mark.skipif(not BLENDER.exists(), reason="no Blender side: run make setup")


def make_model(degree: int, modulator: str, lights: int = 1, count: int = 1500) -> Model:
    """Gaussians of all shapes in and around the view, radiance over about 12 stops."""
    rng = np.random.default_rng(degree)
    sh = rng.normal(0.0, 0.3, (count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-8.0, 20.0, (count, 1)) + rng.normal(0.0, 1.0, (count, 3))
    levels = (0.25, 1.0, 4.0)
    mixture = rng.dirichlet(np.ones(lights + 1), (count, 3))[..., :lights].transpose(0, 2, 1)
    light = (
        {"light_share": mixture.astype(np.float32), "lights": LIGHTS[:lights]}
        if modulator == "additive"
        else {"level_log_gain": rng.normal(0.0, 1.0, (3, count, 3)).astype(np.float32), "levels": levels}
    )
    return Model(
        position=rng.normal(0.0, 0.7, (count, 3)).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        scale=np.exp(rng.uniform(-6.0, -1.5, (count, 3))).astype(np.float32),
        opacity=rng.uniform(0.0, 1.0, count).astype(np.float32),
        log_radiance_sh=sh.astype(np.float32),
        **light,
    )


def look_at_origin(eye: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose[:3, :3] = np.column_stack([right, np.cross(back, right), back])
    pose[:3, 3] = eye
    return pose


def transform(scale: float) -> np.ndarray:
    """Turned about two axes, moved, and scaled."""
    a, b = 0.7, -0.4
    turn_z = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    turn_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    matrix = np.eye(4)
    matrix[:3, :3] = scale * turn_z @ turn_x
    matrix[:3, 3] = (0.2, -0.1, 0.15)
    return matrix


def rotated_quaternions(matrix: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """wxyz quaternions after a rotation matrix (scipy is the independent source)."""
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    own = rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    return (rotation.from_matrix(matrix) * own).as_quat()[:, [3, 0, 1, 2]]


def expected(model: Model, camera: Camera, matrix: np.ndarray, levels: tuple[float, ...], exposure: float):
    """Colour [H, W, 4] and depth [H, W] of the CPU rasteriser."""
    scale = np.linalg.norm(matrix[:3, 0])
    position = model.position @ matrix[:3, :3].T + matrix[:3, 3]
    eye = np.linalg.inv(matrix) @ np.append(camera.position, 1.0)
    directions = model.position.astype(np.float64) - eye[:3]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    arrays = (
        position,
        rotated_quaternions(matrix[:3, :3] / scale, model.rotation),
        model.scale * scale,
        model.opacity,
        2.0**exposure * model.radiance(directions, levels),
    )
    tensors = [torch.from_numpy(np.asarray(array, np.float32)) for array in arrays]
    drawn = rasterize(*tensors, camera, with_depth=True, implementation="cpu")
    colour = np.concatenate([drawn.image.permute(1, 2, 0), drawn.alpha[..., None]], axis=2)
    return colour, drawn.depth.numpy()


#: degree, modulator, a level for each light, exposure, object's scale, float format, principal point
CASES = [
    (0, "additive", (1.0,), 0.0, None, "RGBA32F", (60.0, 45.0)),
    (1, "additive", (0.25,), 2.0, 1.0, "RGBA32F", (60.0, 45.0)),
    (2, "baked-levels", (2.0,), -1.0, 1.7, "RGBA32F", (75.5, 31.25)),
    (3, "additive", (4.0,), 0.0, 0.6, "RGBA16F", (60.0, 45.0)),
    (3, "baked-levels", (0.1,), 0.0, None, "RGBA32F", (60.0, 45.0)),
    (1, "additive", (0.25, 4.0, 0.0), 1.0, 1.0, "RGBA32F", (60.0, 45.0)),
]
#: Least PSNR in dB, and the largest errors of alpha and (relative) depth. Measured with Mesa's llvmpipe:
#: 90 dB with full floats, where only the rasteriser's early end differs; 67 dB with half floats, which
#: llvmpipe truncates.
BOUNDS = {"RGBA32F": (85.0, 4e-3, 5e-3), "RGBA16F": (60.0, 8e-3, 1e-2)}


def psnr_linear(got: np.ndarray, wanted: np.ndarray) -> float:
    """dB against the brightest value wanted."""
    return float(20.0 * np.log10(wanted.max() / np.sqrt(np.mean((got - wanted) ** 2))))


def psnr_mu(got: np.ndarray, wanted: np.ndarray) -> float:
    """dB after μ-law (μ = 5000), as HDR pictures are compared: dark parts count, too."""
    top = wanted.max()
    got, wanted = (np.log1p(5000.0 * np.clip(x / top, 0.0, None)) / np.log1p(5000.0) for x in (got, wanted))
    return float(-10.0 * np.log10(np.mean((got - wanted) ** 2)))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Every case, drawn in one Blender: [(expected colour, expected depth, colour, depth)]."""
    folder = tmp_path_factory.mktemp("viewport")
    cases, pairs = [], []
    for index, (degree, modulator, levels, exposure, scale, format, centre) in enumerate(CASES):
        model = make_model(degree, modulator, len(levels))
        path = folder / f"{index}.safetensors"
        write_model(path, model)
        pose, matrix = look_at_origin(EYE), np.eye(4) if scale is None else transform(scale)
        camera = Camera(pose, WIDTH, HEIGHT, 100.0, 103.0, *centre)
        pairs.append(expected(model, camera, matrix, levels, exposure))
        intrinsics = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        cases.append(
            {
                "model": str(path),
                "camera": {"camera_to_world": pose.tolist(), **intrinsics},
                "matrix_world": matrix.tolist(),
                "levels": levels,
                "exposure": exposure,
                "format": format,
                "out": str(folder / f"{index}.npz"),
            }
        )
    (folder / "cases.json").write_text(json.dumps(cases))
    command = [BLENDER, ROOT / "tests/loop/draw_splats.py", "--", folder / "cases.json"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    results = [np.load(case["out"]) for case in cases]
    return [(*pair, result["colour"], result["depth"]) for pair, result in zip(pairs, results, strict=True)]


@pytest.mark.parametrize("case", range(len(CASES)), ids=[f"{c[1]}-{c[0]}-{c[5]}-{len(c[2])}" for c in CASES])
def test_the_shader_draws_what_the_cpu_draws(drawn, case: int):
    wanted, _, got, _ = drawn[case]
    assert wanted[..., :3].max() > 50.0, "the case must be HDR"
    least, alpha_error, _ = BOUNDS[CASES[case][5]]
    assert psnr_linear(got[..., :3], wanted[..., :3]) > least
    assert psnr_mu(got[..., :3], wanted[..., :3]) > least
    assert np.abs(got[..., 3] - wanted[..., 3]).max() < alpha_error


@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_depth_is_the_rasterisers(drawn, case: int):
    """The mean depth of what covers a pixel: what compositing with the scene compares."""
    wanted_colour, wanted, _, got = drawn[case]
    solid = wanted_colour[..., 3] > 0.5
    assert solid.mean() > 0.3
    np.testing.assert_allclose(got[solid], wanted[solid], rtol=BOUNDS[CASES[case][5]][2])
