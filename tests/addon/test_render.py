# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' pictures of Gaussians against closed forms in numpy and against the trainer's rasteriser."""

import dataclasses
import json
import math
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.axes import world_to_camera_opencv

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import model_import, nodes  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.bridge.lights import Levels  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
SIZE = 64
ANGLE_X = 0.7


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    w, x, y, z = (quaternions.astype(float) / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)


def composite(alphas: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Front to back, ``alphas`` ``[N, H, W]`` sorted: premultiplied RGBA ``[H, W, 4]``."""
    alphas = np.where(alphas >= 1 / 255, np.minimum(alphas, 0.999), 0.0)
    before = np.cumprod(np.concatenate([np.ones_like(alphas[:1]), 1 - alphas[:-1]]), axis=0)
    return np.einsum("nhw,nc->hwc", alphas * before, np.column_stack([colours, np.ones(len(colours))]))


def colours_toward(model, pose: np.ndarray, level: Levels = 1.0) -> np.ndarray:
    directions = model.position - pose[:3, 3]
    return model.radiance(directions / np.linalg.norm(directions, axis=1, keepdims=True), level)


def pixel_centres() -> tuple[np.ndarray, float]:
    """``[H, W, 2]`` pixel coordinates and the focal length in pixels."""
    axis = np.arange(SIZE) + 0.5
    return np.stack(np.meshgrid(axis, axis), axis=-1), 0.5 * SIZE / math.tan(0.5 * ANGLE_X)


def ellipsoids_in_numpy(model, pose: np.ndarray) -> np.ndarray:
    """Alpha by the Mahalanobis distance at which each pixel's ray passes each centre."""
    pixels, focal = pixel_centres()
    x, y = ((pixels - SIZE / 2) / focal).transpose(2, 0, 1)
    rays = np.stack([x, -y, -np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    alphas = []
    order = np.argsort(-(model.position - pose[:3, 3]) @ pose[:3, 2])
    for n in order:
        to_unit = rotation_matrices(model.rotation[n : n + 1])[0].T / model.scale[n][:, None]
        origin = to_unit @ (pose[:3, 3] - model.position[n])
        direction = rays @ to_unit.T
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        distance = np.linalg.norm(np.cross(origin, direction), axis=-1)
        alphas.append(model.opacity[n] * np.exp(-0.5 * distance**2))
    return composite(np.array(alphas), colours_toward(model, pose)[order])


def splats_in_numpy(model, pose: np.ndarray, level: Levels = 1.0) -> np.ndarray:
    """The trainer's rasterisation (EWA, backend/rasterize/contract.py), dense, in float64."""
    pixels, f = pixel_centres()
    view = world_to_camera_opencv(pose)
    x, y, z = (model.position @ view[:3, :3].T + view[:3, 3]).T
    limit = 1.3 * math.tan(0.5 * ANGLE_X)
    u, v = np.clip(x / z, -limit, limit), np.clip(y / z, -limit, limit)
    zero = np.zeros_like(z)
    J = np.array([[f / z, zero, -f * u / z], [zero, f / z, -f * v / z]]).transpose(2, 0, 1)
    A = J @ view[:3, :3] @ rotation_matrices(model.rotation) * model.scale[:, None, :]
    inverse = np.linalg.inv(A @ A.transpose(0, 2, 1) + 0.3 * np.eye(2))
    centres = np.stack([f * x / z, f * y / z], axis=-1) + SIZE / 2
    offsets = pixels[None] - centres[:, None, None]
    distances = np.einsum("nhwi,nij,nhwj->nhw", offsets, inverse, offsets)
    order = np.argsort(z)
    alphas = model.opacity[:, None, None] * np.exp(-0.5 * distances)
    return composite(alphas[order], colours_toward(model, pose, level)[order])


@pytest.fixture
def draw(scene, write, look_at, tmp_path):
    """Renders a model with Cycles: RGBA ``[H, W, 4]``, and the pose."""
    pose = look_at(2.0, -3.0, 1.5)

    def draw(model, splats: bool, image_width: int, levels: tuple[float, ...] = ()):
        bpy.data.batch_remove(list(bpy.data.objects))
        target = model_import.import_model(write(model))
        render.add_camera(scene, pose, ANGLE_X)
        render.set_resolution(scene, SIZE, SIZE)
        render.prepare_cycles(scene)
        nodes.set_input(target.modifiers[0], nodes.CAMERA_SPLATS, splats)
        nodes.set_input(target.modifiers[0], nodes.IMAGE_WIDTH, image_width)
        for index, level in enumerate(levels):
            nodes.set_input(target.modifiers[0], nodes.level_input(model.lights, index), level)
        render.render_exr(scene, tmp_path / "picture.exr")
        return render.read_exr(tmp_path / "picture.exr").astype(float), pose

    return draw


def apart(model):
    """Five Gaussians in a row away from the camera, apart from each other: their order is beyond doubt."""
    steps = np.linspace(-1.2, 1.2, 5)
    position = np.outer(steps, [2.0, -3.0, 1.5]) / 4 + [
        [0.2, 0, 0],
        [-0.2, 0, 0.1],
        [0, 0, 0.2],
        [0, 0, -0.2],
        [0, 0, 0],
    ]
    return dataclasses.replace(
        model, position=position.astype(np.float32), scale=model.scale * np.float32(0.7)
    )


def test_ellipsoids_match_the_closed_form(draw, make_model):
    model = apart(make_model(count=5, seed=3))
    picture, pose = draw(model, splats=False, image_width=0)
    expected = ellipsoids_in_numpy(model, pose)
    assert expected[..., 3].max() > 0.5
    error = np.abs(picture - expected)
    assert error.mean() < 2e-5 * expected.max()
    assert error.max() < 1e-2 * expected.max()  # a pixel where alpha crosses 1/255


def test_ellipsoids_are_widened_by_the_pixel_filter(draw, make_model):
    """Thin Gaussians: the widened ones come closer to the rasteriser's footprint."""
    model = apart(make_model(count=5, seed=3))
    model = dataclasses.replace(model, scale=model.scale * np.float32([1.0, 0.1, 0.1]))
    errors = {}
    for width in (0, SIZE):
        picture, pose = draw(model, splats=False, image_width=width)
        errors[width] = np.abs(picture - splats_in_numpy(model, pose)).mean()
    assert errors[SIZE] < 0.2 * errors[0]


@pytest.mark.parametrize(
    ("lights", "levels"), [(("ambient",), (1.0,)), (("ambient", "pendant", "screen"), (0.25, 4.0, 0.0))]
)
def test_camera_splats_match_the_rasterisers_formula(draw, make_model, lights, levels):
    """60 overlapping Gaussians in any order, some behind others, some off-screen, under any light."""
    model = make_model(count=60, seed=5, lights=lights)
    picture, pose = draw(model, splats=True, image_width=SIZE, levels=levels)
    expected = splats_in_numpy(model, pose, levels)
    error = np.abs(picture - expected)
    assert error.mean() < 1e-5 * expected.max()
    assert error.max() < 1e-2 * expected.max()


REFERENCE = """
import sys
import numpy as np, torch
from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera
given = np.load(sys.argv[1])
camera = Camera.from_field_of_view(given["pose"], {size}, {size}, {angle})
names = ("means", "quaternions", "scales", "opacities", "colours")
tensors = [torch.tensor(given[name], dtype=torch.float64) for name in names]
drawn = rasterize(*tensors, camera, implementation="reference")
np.save(sys.argv[2], torch.cat([drawn.image, drawn.alpha[None]]).permute(1, 2, 0).numpy())
"""


def test_camera_splats_match_the_reference_rasteriser(draw, make_model, tmp_path):
    """Law 7: all renderers agree on one small scene. Cycles to the oracle: measured 91 dB."""
    python = ROOT / ".venvs/backend/bin/python"
    if not python.exists():
        pytest.skip(f"no backend interpreter at {python}")
    model = make_model(count=300, degree=2, seed=7)
    picture, pose = draw(model, splats=True, image_width=SIZE)
    np.savez(
        tmp_path / "given.npz",
        pose=pose,
        means=model.position,
        quaternions=model.rotation,
        scales=model.scale,
        opacities=model.opacity,
        colours=colours_toward(model, pose),
    )
    code = REFERENCE.format(size=SIZE, angle=ANGLE_X)
    arguments = [str(python), "-c", code, str(tmp_path / "given.npz"), str(tmp_path / "expected.npy")]
    subprocess.run(arguments, check=True)
    expected = np.load(tmp_path / "expected.npy")
    psnr = 10 * math.log10(expected.max() ** 2 / np.square(picture - expected).mean())
    assert psnr > 80.0


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_a_camera_that_is_scaled_sees_the_same(scene, make_model, write, look_at, tmp_path, kind):
    """Blender leaves a camera's scale out of its picture; the widening by a pixel does, too."""
    target = model_import.import_model(write(make_model(count=20, seed=5)))
    target.scale = (0.5,) * 3
    camera = render.add_camera(scene, look_at(2.0, -3.0, 1.5), 0.7)
    camera.data.type, camera.data.ortho_scale = kind, 2.0
    for name, value in ((nodes.CAMERA_SPLATS, True), (nodes.IMAGE_WIDTH, 16)):
        nodes.set_input(target.modifiers[0], name, value)
    render.set_resolution(scene, 16, 16)
    render.prepare_cycles(scene)
    pictures = []
    for scale in (1.0, 2.0, 0.3):
        camera.scale = (scale,) * 3
        render.render_exr(scene, tmp_path / "picture.exr")
        pictures.append(render.read_exr(tmp_path / "picture.exr"))
    assert pictures[0][..., 3].max() > 0.3
    for other in pictures[1:]:
        np.testing.assert_allclose(other, pictures[0], rtol=1e-3, atol=1e-4)


KEYFRAMES = """
import sys
from pathlib import Path
import bpy, numpy as np
from physhdr.addon.model import look, model_import, nodes
from physhdr.addon.rendering import render

model, out, engine, width = sys.argv[1], Path(sys.argv[2]), sys.argv[3], int(sys.argv[4])
if engine == "eevee":
    import gpu

    try:
        gpu.init()
    except (RuntimeError, SystemError) as error:
        sys.exit(f"no EEVEE here: {error}")

def prepare_eevee(scene, samples):
    # Gaussians come out as their radiance, as noisy as the samples leave them: EEVEE dithers transparency.
    scene.render.engine = "BLENDER_EEVEE"
    scene.render.film_transparent = True
    scene.render.use_motion_blur = False
    scene.render.filter_size = render.POINT_SAMPLING
    scene.eevee.taa_render_samples = samples
    scene.eevee.clamp_surface_direct = scene.eevee.clamp_surface_indirect = 0.0
    scene.eevee.use_shadows = scene.eevee.use_raytracing = False  # Gaussians carry their light with them


bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
target = model_import.import_model(model)
modifier = nodes.find_modifier(target)
labels = (nodes.EXPOSURE, nodes.LIGHTING_LEVEL, "Level of pendant")
for frame, values in ((1, (0.0, 1.0, 1.0)), (11, (2.0, 0.25, 3.0))):
    for name, value in zip(labels, values):
        nodes.set_input(modifier, name, value)
        target.keyframe_insert(nodes.input_data_path(modifier, name), frame=frame)
pose = np.eye(4)
pose[2, 3] = 3.0
render.add_camera(scene, pose, 0.5)
render.set_resolution(scene, width, width)
render.prepare_cycles(scene) if engine == "cycles" else prepare_eevee(scene, 16)
for frame in (1, 6, 11):
    scene.frame_set(frame)
    render.render_exr(scene, out / "picture.exr")
    np.save(out / f"{frame}.npy", render.read_exr(out / "picture.exr"))
    shown = look.look_of(target, bpy.context.evaluated_depsgraph_get())
    np.save(out / f"{frame}_look.npy", [shown.exposure_ev, *shown.lighting_levels])
"""


@pytest.mark.parametrize(
    ("engine", "width", "tolerance"),
    [("cycles", 16, 1e-3), pytest.param("eevee", 8, 0.03, marks=pytest.mark.long)],
)
def test_keyframes_play_in_a_render(make_model, write, tmp_path, engine, width, tolerance):
    """One Gaussian that fills the picture: its radiance at every frame, relit and exposed, in numbers."""
    model = dataclasses.replace(
        make_model(count=1, degree=0, lights=("ambient", "pendant")),
        light_share=np.float32([[[0.5, 0.2, 0.7], [0.1, 0.6, 0.25]]]),
        position=np.zeros((1, 3), np.float32),
        rotation=np.float32([[1.0, 0.0, 0.0, 0.0]]),
        scale=np.float32([[50.0, 50.0, 0.1]]),
        opacity=np.float32([0.999]),
        log_radiance_sh=np.log(np.float32([[[0.5, 2.0, 30.0]]])) * np.float32(2.0 * math.sqrt(math.pi)),
    )
    arguments = [sys.executable, "-c", KEYFRAMES, str(write(model)), str(tmp_path), engine, str(width)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if "no EEVEE here" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
    for frame in (1, 6, 11):
        exposure, *levels = np.load(tmp_path / f"{frame}_look.npy")
        if frame == 6:
            assert 0.0 < exposure < 2.0 and 0.25 < levels[0] < 1.0 < levels[1] < 3.0
        else:
            assert (exposure, *levels) == {1: (0.0, 1.0, 1.0), 11: (2.0, 0.25, 3.0)}[frame]
        picture = np.load(tmp_path / f"{frame}.npy")
        radiance = 2**exposure * model.radiance(np.array([[0.0, 0.0, -1.0]]), levels)[0]
        np.testing.assert_allclose(
            picture[..., :3].mean(axis=(0, 1)), 0.999 * radiance, rtol=tolerance, err_msg=str(frame)
        )


@pytest.fixture
def relight(monkeypatch, capsys):
    """Runs the script's ``main`` here, where Blender is already; what it says, and its status."""
    script = runpy.run_path(str(ROOT / "addon/scripts/relight.py"))
    monkeypatch.setitem(script["main"].__globals__, "load_package", lambda: None)

    def relight(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = ["relight.py", "--", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", command)
        try:
            status = script["main"]()
        except SystemExit as error:  # argparse's; any other exception is what a user must not see
            status = error.code
        said = capsys.readouterr()
        return subprocess.CompletedProcess(command, status, said.out, said.err)

    return relight


@pytest.fixture
def camera_file(look_at, tmp_path) -> Path:
    frames = [{"file_path": "./test/r_0", "transform_matrix": look_at(2.0, -3.0, 1.5).tolist()}]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": ANGLE_X, "frames": frames}))
    return tmp_path / "transforms.json"


def test_script_relights_and_saves(relight, make_model, write, camera_file, tmp_path, look_at):
    model = make_model(count=30)
    out = tmp_path / "out"
    done = relight(
        *(write(model), "--camera", f"{camera_file}:0", "--out", out, "--resolution", SIZE),
        *("--levels", 0.25, 4, "--blend", out / "scene.blend"),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(" s] ") == 4
    low, high = (render.read_exr(out / f"level_{level}.exr").astype(float) for level in ("0.25", "4"))
    assert low.shape == (SIZE, SIZE, 4)
    # Linear in light: the fixed and the ambient picture can be recovered, and give level 1.
    ambient = (high - low) / 3.75
    np.testing.assert_allclose(
        (low + 0.75 * ambient)[..., :3],
        splats_in_numpy(model, look_at(2.0, -3.0, 1.5))[..., :3],
        atol=1e-2 * high.max(),
    )
    bpy.ops.wm.open_mainfile(filepath=str(out / "scene.blend"))
    assert len(bpy.data.pointclouds[0].points) == 30
    assert bpy.context.scene.camera is not None


def test_script_sets_other_lights(relight, make_model, write, camera_file, tmp_path, look_at):
    model = make_model(count=30, lights=("ambient", "pendant", "bed/side"))
    common = (write(model), "--camera", f"{camera_file}:0", "--out", tmp_path / "out", "--resolution", SIZE)
    done = relight(*common, "--levels", 0.5, "--light", "pendant=3", "--light", "bed/side=0")
    assert done.returncode == 0, done.stderr
    assert "at ambient 0.5 + pendant 3 + bed/side 0:" in done.stdout
    picture = render.read_exr(tmp_path / "out/level_0.5+pendant_3+bed_side_0.exr")
    expected = splats_in_numpy(model, look_at(2.0, -3.0, 1.5), (0.5, 3.0, 0.0))
    np.testing.assert_allclose(picture, expected, atol=1e-2 * expected.max())
    for wrong, status, told in [
        ("screen=1", 1, "there is no light 'screen'"),
        ("ambient=1", 1, "the model's first light"),
        ("pendant", 2, "'pendant'"),
        ("pendant=-1", 2, "'pendant=-1'"),
    ]:
        done = relight(*common, "--light", wrong)
        assert done.returncode == status and told in done.stderr, done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ("model", "is truncated"),
        ("no model", "there is no model file"),
        ("index", "has no camera 5"),
        ("json", "is not valid JSON"),
        ("nan", "'transform_matrix' holds NaN"),
        ("no camera", "there is no camera file"),
        ("out", "cannot"),
    ],
)
def test_script_ends_with_one_clear_message(
    relight, make_model, write, camera_file, tmp_path, spoil, message
):
    path, index, out = write(make_model()), 0, tmp_path / "out"
    if spoil == "model":
        path.write_bytes(path.read_bytes()[:-1])
    elif spoil == "no model":
        path.unlink()
    elif spoil == "index":
        index = 5
    elif spoil == "json":
        camera_file.write_text('{"frames": [')
    elif spoil == "nan":
        content = json.loads(camera_file.read_text())
        content["frames"][0]["transform_matrix"][0][0] = math.nan
        camera_file.write_text(json.dumps(content))
    elif spoil == "no camera":
        camera_file.unlink()
    elif spoil == "out":
        out.write_text("a file, not a folder")
    done = relight(path, "--camera", f"{camera_file}:{index}", "--out", out, "--resolution", 8)
    assert done.returncode == 1
    assert message in done.stderr
    assert "Traceback" not in done.stderr + done.stdout


@pytest.mark.long
def test_script_works_from_a_folder_of_any_name_without_installation(
    make_model, write, camera_file, tmp_path
):
    """A bare clone, run by a Python whose installed ``physhdr`` is out of sight."""
    clone = tmp_path / "clone-1"
    for part in ("addon", "bridge", "synth"):
        shutil.copytree(ROOT / part, clone / part)
    shutil.copy(ROOT / "__init__.py", clone)
    code = """
import runpy, sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in repr(finder)]
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
    script = clone / "addon/scripts/relight.py"
    arguments = [write(make_model(count=5)), "--camera", f"{camera_file}:0", "--out", tmp_path / "out"]
    done = subprocess.run(
        [sys.executable, "-c", code, str(script), "--", *map(str, arguments), "--resolution", "8"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out/level_1.exr").exists()
