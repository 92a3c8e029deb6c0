# SPDX-License-Identifier: GPL-3.0-or-later
"""Stereo on scenes that are ray-cast here in closed form: the true depth of every pixel is known."""

import dataclasses

import numpy as np
import pytest

from physhdr.backend.scene.camera import Camera
from physhdr.backend.simd import set_threads, thread_count
from physhdr.backend.start.stereo import stereo_points, stereo_view

SIZE, ANGLE = 72, 0.9


def look_at(position, target):
    backward = (np.asarray(position) - target) / np.linalg.norm(np.asarray(position) - target)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=1)
    pose[:3, 3] = position
    return Camera.from_field_of_view(pose, SIZE, SIZE, ANGLE)


def texture(points):
    """ln radiance ``[…, 3]`` of a surface: waves in space, a few pixels to a hundred long."""
    rng = np.random.default_rng(7)
    waves = rng.normal(size=(24, 3)) * rng.uniform(2.0, 14.0, size=(24, 1))
    values = np.sin(points @ waves.T + rng.uniform(0, 6.28, 24)).mean(axis=-1)
    return 1.5 * values[..., None] + np.array([0.3, 0.0, -0.3])


def rays(camera):
    """Directions ``[H, W, 3]`` in the world, of length 1 along the optical axis."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    local = np.stack([(x - camera.cx) / camera.fx, (camera.cy - y) / camera.fy, -np.ones_like(x)], axis=-1)
    return local @ camera.camera_to_world[:3, :3].T


def room(camera):
    """A wall at y = 5 and before it, at y = 3, a board of 1 × 1: where the pixels' rays end."""
    o, d = camera.position, rays(camera)
    wall, board = (o + d * ((y - o[1]) / d[..., 1])[..., None] for y in (5.0, 3.0))
    on_board = (np.abs(board[..., 0]) < 0.5) & (np.abs(board[..., 2]) < 0.5)
    return np.where(on_board[..., None], board, wall)


def ball(camera):
    """A ball of radius 1 at the origin in a black void (NaN)."""
    o, d = camera.position, rays(camera)
    a, b, c = (d * d).sum(-1), (d * o).sum(-1), (o * o).sum() - 1.0
    with np.errstate(invalid="ignore"):
        depth = (-b - np.sqrt(b * b - a * c)) / a
    return o + d * depth[..., None]


def window(camera):
    """A wall at y = 3 with a window of 1.2 × 1.2: trees at y = 12, 0.9 high, and above them sky (inf)."""
    o, d = camera.position, rays(camera)
    wall, trees = (o + d * ((y - o[1]) / d[..., 1])[..., None] for y in (3.0, 12.0))
    open_there = np.abs(wall[..., [0, 2]]).max(axis=-1, keepdims=True) < 0.6
    return np.where(open_there, np.where(trees[..., 2:] < 0.9, trees, np.inf), wall)


def views_of(scene, cameras, offsets):
    for camera, offset in zip(cameras, offsets, strict=True):
        points = scene(camera)
        sky = np.isposinf(points)  # brighter than all else, the same everywhere
        picture = np.where(sky, 2.0, texture(np.where(sky, 0.0, points))) + offset
        known = ~np.isnan(picture[..., 0])
        yield stereo_view(camera, np.where(known[..., None], picture, -12.0), known)


@pytest.fixture(scope="module")
def room_cameras():
    return [look_at([x, 0.0, z], [0.3 * x, 4.0, 0.3 * z]) for x in (-0.4, 0.0, 0.4) for z in (-0.3, 0.3)]


@pytest.fixture(scope="module")
def room_points(room_cameras):
    # Every picture has another brightness, as if its exposure were misread by up to a factor of 1.6.
    offsets = np.random.default_rng(1).uniform(-0.5, 0.5, len(room_cameras))
    return stereo_points(list(views_of(room, room_cameras, offsets)))


def parallax_error(points):
    """How far ``points`` lie from the nearer of the room's two surfaces, in pixels of parallax, ``[P]``."""
    focal, baseline = 0.5 * SIZE / np.tan(0.5 * ANGLE), np.hypot(0.8, 0.6)
    return np.min([np.abs(1.0 / points[:, 1] - 1.0 / y) for y in (3.0, 5.0)], axis=0) * focal * baseline


def test_points_lie_on_the_surfaces(room_points):
    error = parallax_error(room_points)
    assert np.median(error) < 0.2
    assert (error < 0.5).mean() > 0.9
    # And everywhere there: in each tenth of the board's sides, and on the wall around it.
    right = room_points[error < 0.5]
    board = right[(right[:, 1] < 4.0) & (np.abs(right[:, [0, 2]]).max(axis=1) < 0.5)]
    assert len({tuple(cell) for cell in np.floor((board[:, [0, 2]] + 0.5) * 10.0).astype(int)}) >= 98
    assert (right[:, 1] > 4.0).sum() > 2000


def test_units_do_not_matter(room_cameras, room_points):
    """The same pictures with every length × 1000 give the same points × 1000."""
    offsets = np.random.default_rng(1).uniform(-0.5, 0.5, len(room_cameras))
    large = []
    for camera, view in zip(room_cameras, views_of(room, room_cameras, offsets), strict=True):
        pose = camera.camera_to_world.copy()
        pose[:3, 3] *= 1000.0
        large.append(dataclasses.replace(view, camera=dataclasses.replace(camera, camera_to_world=pose)))
    points = stereo_points(large) / 1000.0
    assert abs(len(points) / len(room_points) - 1.0) < 0.02
    assert (parallax_error(points) < 0.5).mean() > 0.9


def test_points_do_not_depend_on_the_number_of_threads(room_cameras, room_points):
    offsets = np.random.default_rng(1).uniform(-0.5, 0.5, len(room_cameras))
    views, before = list(views_of(room, room_cameras, offsets)), thread_count()
    try:
        for threads in (1, 4):
            set_threads(threads)
            assert np.array_equal(stereo_points(views), room_points)
    finally:
        set_threads(before)


def test_a_sky_without_texture_is_not_where_the_window_is():
    """It has its frame's depth, for nothing tells another; views from elsewhere see trees through it."""
    cameras = [
        look_at([x, 0.0, z], [0.3 * x, 4.0, 0.1 * z]) for x in (-0.5, 0.0, 0.5) for z in (-0.5, 0.0, 0.5)
    ]
    points = stereo_points(list(views_of(window, cameras, np.zeros(len(cameras)))))
    in_the_air = (np.abs(points[:, [0, 2]]).max(axis=1) < 0.55) & (points[:, 1] > 2.0) & (points[:, 1] < 6.0)
    trees, wall = (
        np.abs(1.0 / points[:, 1] - 1.0 / 12.0) < 0.02,
        np.abs(1.0 / points[:, 1] - 1.0 / 3.0) < 0.02,
    )
    assert in_the_air.sum() < 20  # hundreds, were they kept
    assert trees.sum() > 500 and wall.sum() > 2000


@pytest.mark.long
def test_frames_of_a_video_are_compared_with_frames_that_show_parallax():
    """The six frames beside one are 0.06 away at most: points by them are off by two pixels of the others."""
    along = np.linspace(-0.6, 0.6, 60)
    cameras = [look_at([x, 0.1 * np.sin(9.0 * x), 0.1 * np.cos(7.0 * x)], [0.3 * x, 4.0, 0.0]) for x in along]
    points = stereo_points(list(views_of(room, cameras, np.zeros(len(cameras)))))
    assert len(points) > 6500 and np.median(parallax_error(points)) < 0.7


def test_a_view_is_compared_with_those_that_see_its_other_side():
    """Three places see the wall's right part; the eight nearest of each look at the middle."""
    crowd = [look_at([x, 0.0, z], [0.0, 4.0, 0.0]) for x in (-0.2, 0.0, 0.2) for z in (-0.2, 0.0, 0.2)]
    places = [1.4, 0.0, 1.0], [1.4, 0.0, -1.0], [2.9, -1.2, 0.0]
    apart = [look_at(place, [3.0, 5.0, 0.0]) for place in places]
    cameras = [*crowd, *apart]
    points = stereo_points(list(views_of(room, cameras, np.zeros(len(cameras)))))
    right = points[points[:, 0] > 2.5]
    assert len(right) > 1000
    assert (np.abs(1.0 / right[:, 1] - 1.0 / 5.0) < 0.01).mean() > 0.9


def test_a_wall_that_faces_all_cameras():
    """All of it at one depth: a range of depths that is hardly one."""

    def wall(camera):
        o, d = camera.position, rays(camera)
        return o + d * ((5.0 - o[1]) / d[..., 1])[..., None]

    cameras = [look_at([x, 0.0, z], [x, 5.0, z]) for x in (-0.4, 0.0, 0.4) for z in (-0.3, 0.3)]
    points = stereo_points(list(views_of(wall, cameras, np.zeros(len(cameras)))))
    assert len(points) > 4000
    assert (parallax_error(points) < 0.5).mean() > 0.95


def test_cameras_around_an_object():
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    cameras = [
        look_at([3.5 * np.cos(a), 3.5 * np.sin(a), 0.8 * (-1) ** i], np.zeros(3))
        for i, a in enumerate(angles)
    ]
    points = stereo_points(list(views_of(ball, cameras, np.zeros(16))))
    radius = np.linalg.norm(points, axis=1)
    assert np.median(np.abs(radius - 1.0)) < 0.02
    assert (np.abs(radius - 1.0) < 0.06).mean() > 0.9
    bearing = np.floor((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi) * 12).astype(int)
    assert set(bearing.tolist()) >= set(range(12))  # on every side


def test_where_nothing_can_be_triangulated_there_are_no_points():
    camera = look_at([0.0, 0.0, 0.0], [0.0, 4.0, 0.0])
    turned = look_at([0.0, 0.0, 0.0], [0.5, 4.0, 0.0])
    away = look_at([0.0, -1.0, 0.0], [0.0, -4.0, 0.0])
    for cameras in ([camera], [camera, turned], [camera, away]):
        assert stereo_points(list(views_of(room, cameras, np.zeros(len(cameras))))).shape == (0, 3)
