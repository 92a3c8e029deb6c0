# SPDX-License-Identifier: GPL-3.0-or-later
"""The view as a pinhole in pixels, against Blender's own matrices."""

import math
from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.blender import to_matrix  # noqa: E402
from physhdr.addon.viewport import camera as view_camera  # noqa: E402


def blenders_pixels(points, view_matrix, window_matrix, width, height):
    """Where Blender's matrices put world points: x right, y down."""
    both = np.array(window_matrix, np.float64) @ np.array(view_matrix, np.float64)
    clip = np.column_stack([points, np.ones(len(points))]) @ both.T
    return 0.5 * (1.0 + clip[:, :2] / clip[:, 3:] * (1.0, -1.0)) * (width, height)


@pytest.fixture
def blender_camera(scene, look_at):
    data = bpy.data.cameras.new("camera")
    target = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(target)
    scene.camera = target
    target.matrix_world = to_matrix(look_at(3.0, -4.0, 2.0))
    return target


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize(("width", "height"), [(640, 480), (300, 701)])
def test_points_land_where_blender_puts_them(blender_camera, scene, kind, fit, width, height):
    data = blender_camera.data
    data.type, data.sensor_fit = kind, fit
    data.lens, data.ortho_scale = 31.0, 5.5
    data.shift_x, data.shift_y = 0.21, -0.13
    scene.render.pixel_aspect_x = 1.3
    depsgraph = bpy.context.evaluated_depsgraph_get()
    window = blender_camera.calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=scene.render.pixel_aspect_x, scale_y=1.0
    )
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (200, 3))
    view = blender_camera.matrix_world.inverted()
    ours = view_camera.from_matrices(view, window, width, height)
    expected = blenders_pixels(points, view, window, width, height)
    pixels, depth = ours.project(points)
    assert ours.is_orthographic == (kind == "ORTHO")
    np.testing.assert_allclose(pixels, expected, atol=1e-4 * max(1.0, np.abs(expected).max() / 1000))
    np.testing.assert_allclose(
        depth, -(np.array(view) @ np.column_stack([points, np.ones(200)]).T)[2], atol=1e-5
    )


def test_a_centred_camera_by_hand():
    """50 mm on a 36 mm sensor, 360 pixels wide: 500 pixels of focal length; the axis in the middle."""
    window = [[2 * 50 / 36, 0, 0, 0], [0, 2 * 50 / 27, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]]
    ours = view_camera.from_matrices(np.eye(4), window, 360, 270)
    assert (ours.fx, ours.fy, ours.cx, ours.cy) == pytest.approx((500.0, 500.0, 180.0, 135.0))
    pixels, depth = ours.project(np.array([[0.5, 0.25, -5.0]]))
    np.testing.assert_allclose(pixels, [[230.0, 110.0]])
    np.testing.assert_allclose(depth, [5.0])


def test_resizing_keeps_what_is_seen():
    window = [[2.5, 0, 0.2, 0], [0, 3.0, -0.1, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]]
    full = view_camera.from_matrices(np.eye(4), window, 400, 300)
    small = full.resized(101, 77)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3)) - (0.0, 0.0, 4.0)
    np.testing.assert_allclose(small.project(points)[0], full.project(points)[0] * (101 / 400, 77 / 300))
    assert full.scaled(1e-6).width == 1
    assert small.key != full.key and small.key == full.resized(101, 77).key


@pytest.mark.parametrize(
    ("turn", "moved", "expected"),
    [(0.0, 0.0, False), (20.0, 0.0, False), (35.0, 0.0, True), (0.0, 0.9, False), (0.0, 1.1, True)],
)
def test_a_view_has_jumped_where_the_picture_before_says_little_of_it(turn, moved, expected):
    """Of what is 2 m away."""
    before = view_camera.ViewCamera(np.eye(4), 40, 30, 50.0, 50.0, 20.0, 15.0)
    pose = np.eye(4)
    cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    pose[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    pose[0, 3] = moved
    assert view_camera.has_jumped(before, replace(before, camera_to_world=pose), 2.0) == expected
    assert view_camera.has_jumped(before, replace(before, is_orthographic=True), 2.0)


def test_between_two_cameras_a_point_is_the_same(look_at):
    window = [[2.5, 0, 0, 0], [0, 2.5, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]]
    first, second = (
        view_camera.from_matrices(np.linalg.inv(look_at(*eye)), window, 100, 100)
        for eye in [(2.0, -3.0, 1.0), (1.0, -3.5, 0.5)]
    )
    point = np.array([0.2, 0.1, -0.3, 1.0])
    moved = view_camera.between(first, second) @ (first.world_to_camera @ point)
    np.testing.assert_allclose(moved, second.world_to_camera @ point, atol=1e-12)
    assert math.isclose(np.linalg.det(view_camera.between(first, second)), 1.0)
