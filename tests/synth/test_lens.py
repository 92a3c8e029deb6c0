# SPDX-License-Identifier: GPL-3.0-or-later
"""Lenses against OpenCV's published formulas, written here a second time, and what Cycles makes of them."""

import json
import math

import numpy as np
import pytest

from physhdr.synth import settings
from physhdr.synth.errors import OptionError
from physhdr.synth.lens import Lens
from physhdr.synth.parse_lens import parse_lens
from physhdr.synth.passes import SKY
from physhdr.synth.renderer import renderer
from physhdr.synth.stage import CameraHints, Stage

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/run-blender")

SIZE, ANGLE = (60, 45), math.radians(62.0)
PHONE = "opencv:-0.18,0.06,0.003,-0.002"
WIDE = "fisheye:-0.03,0.012,-0.004,0.0006"


def published(lens: Lens, rays: np.ndarray) -> np.ndarray:
    """Pixels of rays [N, 3] by the formulas of OpenCV's documentation, one ray after the other."""
    told = lens.describe()
    pixels = []
    for x, y, z in rays.tolist():
        if told["camera_model"] == "OPENCV":
            a, b = x / z, y / z
            r = math.hypot(a, b)
            s = 1 + told["k1"] * r**2 + told["k2"] * r**4
            p = a * s + 2 * told["p1"] * a * b + told["p2"] * (r**2 + 2 * a**2)
            q = b * s + told["p1"] * (r**2 + 2 * b**2) + 2 * told["p2"] * a * b
        else:
            theta = math.atan2(math.hypot(x, y), z)
            bent = theta + sum(told[f"k{n}"] * theta ** (2 * n + 1) for n in (1, 2, 3, 4))
            p, q = (bent * side / math.hypot(x, y) for side in (x, y))
        pixels.append((told["fl_x"] * p + told["cx"], told["fl_y"] * q + told["cy"]))
    return np.array(pixels)


def middles(size: tuple[int, int]) -> np.ndarray:
    """[N, 2] of all pixels."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    return np.stack([x.ravel(), y.ravel()], -1)


@pytest.mark.parametrize("text", [PHONE, WIDE])
def test_rays_are_the_inverse_of_opencvs_formula(text):
    lens = parse_lens(text, SIZE, ANGLE)
    pixels = middles(SIZE)
    rays = lens.directions(pixels)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-12)
    assert np.abs(published(lens, rays) - pixels).max() < 1e-9
    assert np.abs(lens.project(3.7 * rays) - pixels).max() < 1e-9


def test_without_distortion_it_is_the_pinhole_and_the_equidistant_fisheye():
    corner = np.array([[0.0, 0.0]])
    half = math.tan(ANGLE / 2)
    pinhole = parse_lens("opencv:0,0,0,0", SIZE, ANGLE).directions(corner)[0]
    assert pinhole / pinhole[2] == pytest.approx([-half, -half * 0.75, 1.0])
    lens = parse_lens("fisheye:0,0,0,0", SIZE, ANGLE)
    angle = math.acos(lens.directions(corner)[0, 2])
    assert angle == pytest.approx(37.5 / lens.fx)  # 30 and 22.5 pixels from the middle


def stage_of(scene) -> Stage:
    hints = CameraHints(
        centre=(0, 0, 0),
        target=(0, 1, 0),
        extent=(0, 0),
        angle_x=ANGLE,
        orbit_radius=1.0,
        orbit_arc=1.0,
        elevation=(0, 0),
    )
    return Stage(scene=scene, cameras=hints, lights={"ambient": []}, groups={"ambient": ""})


@pytest.fixture
def compass():
    """Nothing but a world whose colour says in which direction it is seen."""
    scene = bpy.data.scenes.new("compass")
    scene.world = world = bpy.data.worlds.new("compass")
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    place, half = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeVectorMath")
    half.operation = "MULTIPLY_ADD"
    half.inputs[1].default_value = half.inputs[2].default_value = (0.5, 0.5, 0.5)
    background, end = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    links.new(place.outputs["Generated"], half.inputs[0])
    links.new(half.outputs[0], background.inputs["Color"])
    links.new(background.outputs[0], end.inputs["Surface"])
    yield stage_of(scene)
    bpy.data.scenes.remove(scene)
    bpy.data.worlds.remove(world)


def render(stage, lens, pose, samples, path):
    wanted = settings.ground_truth(SIZE, samples, threads=1)
    with settings.applied(stage.scene, wanted), renderer(stage, False, lens) as camera:
        return camera.render(pose, 1, path)


@pytest.mark.parametrize(
    "text", [PHONE, *(pytest.param(text, marks=pytest.mark.long) for text in ("opencv:0,0,0,0", WIDE))]
)
def test_cycles_sees_at_each_pixel_what_the_formula_puts_there(text, compass, tmp_path):
    """Each pixel's colour tells its direction; the formula of OpenCV says where that should be seen."""
    lens = parse_lens(text, SIZE, ANGLE)
    turned = np.eye(4)
    turned[:3, :3] = [[0.8, 0.0, 0.6], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]]
    rendered = render(compass, lens, turned, 128, tmp_path / "render.exr")
    world = 2.0 * rendered.radiance({}).reshape(-1, 3).astype(np.float64) - 1.0
    in_camera = world @ turned[:3, :3] * [1.0, -1.0, -1.0]  # Blender's camera has y up and looks down −z
    off = published(lens, in_camera) - middles(SIZE)
    # Measured: 0.018 pixels at most, which 128 samples leave of where in the pixel they were; mean 0.0005.
    assert np.abs(off).max() < 0.05
    assert np.abs(off.mean(0)).max() < 0.002
    assert (rendered.depth == SKY).all()


@pytest.mark.parametrize("text", [PHONE, WIDE])
def test_depth_is_along_the_axis_whatever_the_lens(text, tmp_path):
    """A wall square to the axis, 3 m away: Cycles itself tells the distance to each point of it."""
    from physhdr.synth.scenes import materials, props

    scene = bpy.data.scenes.new("wall")
    wall = props.box(
        scene.collection, "wall", (0, 3.05, 0), (40, 0.1, 40), materials.plain("grey", (0.5,) * 3, 1.0)
    )
    forward = np.eye(4)
    forward[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    lens = parse_lens(text, SIZE, ANGLE)
    try:
        rendered = render(stage_of(scene), lens, forward, 4, tmp_path / "render.exr")
    finally:
        bpy.data.objects.remove(wall)
        bpy.data.scenes.remove(scene)
    # The first sample lies anywhere in its pixel, whose middle tells the angle.
    assert rendered.depth == pytest.approx(3.0, rel=0.01)
    assert rendered.depth.mean() == pytest.approx(3.0, rel=2e-4)
    assert rendered.normal == pytest.approx(
        np.broadcast_to([0.0, -1.0, 0.0], rendered.normal.shape), abs=1e-5
    )


def test_a_file_has_nerfstudios_names_and_may_bring_its_own_focal_length(tmp_path):
    path = tmp_path / "lens.json"
    told = {
        "camera_model": "OPENCV_FISHEYE",
        "k1": -0.02,
        "fl_x": 300.0,
        "fl_y": 310.0,
        "cx": 205.0,
        "cy": 150.0,
    }
    path.write_text(json.dumps(told | {"w": 400, "h": 300}))
    half = parse_lens(str(path), (200, 150), ANGLE)
    assert half.describe() == {
        "camera_model": "OPENCV_FISHEYE",
        **{"w": 200, "h": 150, "fl_x": 150.0, "fl_y": 155.0, "cx": 102.5, "cy": 75.0},
        **{"k1": -0.02, "k2": 0.0, "k3": 0.0, "k4": 0.0},
    }
    assert Lens.described(half.describe()) == half
    path.write_text(json.dumps({"k1": 0.1}))
    assert parse_lens(str(path), SIZE, ANGLE) == parse_lens("opencv:0.1,0,0,0", SIZE, ANGLE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("opencv:-0.6,0,0,0", "folds the picture over at"),
        ("fisheye:-0.8,0,0,0", "folds the picture over at"),
        ("opencv:1,2,3", "OPENCV has the 4 numbers k1, k2, p1, p2"),
        ("opencv:0,11,0,0", "not all within"),
        ("opencv:a,0,0,0", "'a' is not a number"),
        ("pinhole:0,0,0,0", "write opencv:k1,k2,p1,p2|cannot read"),
    ],
)
def test_lenses_that_cannot_be_are_refused(text, message):
    with pytest.raises(OptionError, match=message):
        parse_lens(text, SIZE, ANGLE)


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"camera_model": "FOV"}, "not one of OPENCV, OPENCV_FISHEYE"),
        ({"k1": "much"}, "k1 is 'much', not a number"),
        ({"fl_x": 300.0}, "say of which 'w' and 'h'"),
        ({"fl_x": -300.0, "w": 400, "h": 300}, "fl_x must be above 0"),
    ],
)
def test_files_of_lenses_that_cannot_be_are_refused(told, message, tmp_path):
    path = tmp_path / "lens.json"
    path.write_text(json.dumps(told))
    with pytest.raises(OptionError, match=message):
        parse_lens(str(path), SIZE, ANGLE)
