# SPDX-License-Identifier: GPL-3.0-or-later
"""The lens against pictures ray cast without distortion, the vertical and rotations against closed forms."""

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from physhdr.backend.scene.capture.gravity import rotation_to_z, up_direction
from physhdr.backend.scene.lens import make_lens
from physhdr.bridge.affine import quaternion_of
from physhdr.bridge.errors import BadValueError


def camera_of(room):
    return pycolmap.Camera(
        model="OPENCV",
        width=room.WIDTH,
        height=room.HEIGHT,
        params=[room.FOCAL, room.FOCAL, room.CX, room.CY, *room.DISTORTION],
    )


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_a_straightened_photo_is_what_a_pinhole_would_have_taken(room, scale):
    """Against the same room ray cast for the pinhole: the same codes, and not shifted."""
    pose = room.arc(1)[0]
    photo = room.codes(room.picture(pose, room.rays_of_lens(), room.WIDTH, room.HEIGHT), 1.0)
    lens = make_lens(camera_of(room), scale)
    truth = room.picture(
        pose,
        room.rays_of_pinhole(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy),
        lens.width,
        lens.height,
    )

    wanted, found = room.codes(truth, 1.0) / 255.0, lens.picture(photo) / 255.0
    assert found.shape == wanted.shape
    assert -10.0 * np.log10(np.mean((found - wanted) ** 2)) > 30.0
    # found − wanted ≈ −∇wanted · shift: the shift in pixels, by least squares.
    slopes = np.stack([np.gradient(wanted, axis=1).ravel(), np.gradient(wanted, axis=0).ravel()], axis=1)
    shift = np.linalg.lstsq(slopes, (wanted - found).ravel())[0]
    assert np.abs(shift).max() < 0.03


def test_without_distortion_codes_stay_or_are_averaged():
    random = np.random.default_rng(1)
    photo = random.integers(0, 256, (40, 60, 3), dtype=np.uint8)
    camera = pycolmap.Camera(model="PINHOLE", width=60, height=40, params=[50, 51, 31, 19])
    same, half = make_lens(camera, 1.0), make_lens(camera, 0.5)
    assert (same.width, same.height, same.fx, same.cx, same.cy) == pytest.approx((60, 40, 50, 31, 19))
    np.testing.assert_array_equal(same.picture(photo), photo)
    mean = photo.reshape(20, 2, 30, 2, 3).mean(axis=(1, 3))
    assert np.abs(half.picture(photo) - mean).max() <= 0.5 + 1e-3
    assert (half.fx, half.fy, half.cx, half.cy) == pytest.approx((25, 25.5, 15.5, 9.5))


def test_keypoints_go_where_the_lens_puts_them(room):
    lens = make_lens(camera_of(room), 0.5)
    rays = np.array([[0.1, -0.2], [-0.4, 0.3], [0.0, 0.0]])
    x, y = room.distort(*rays.T)
    in_photo = np.stack([room.FOCAL * x + room.CX, room.FOCAL * y + room.CY], axis=1)
    straight = rays * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    np.testing.assert_allclose(lens.straightened(in_photo), straight, atol=1e-4)


def test_a_lens_beyond_belief_is_refused():
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=60, height=40, params=[50, 30, 20, 40.0])
    with pytest.raises(BadValueError, match="implausible"):
        make_lens(camera, 1.0)


def test_up_of_cameras_that_all_look_down(room):
    """Their own upward axes lean forward by 40°; that they are level tells the vertical all the same."""
    rotations = [
        room.look_from((np.cos(a), np.sin(a), 1.0), (0.0, 0.0, 0.2))[:, :3] for a in np.linspace(0.0, 1.2, 9)
    ]
    turn = Rotation.from_rotvec([0.3, -2.0, 1.1]).as_matrix()
    up = up_direction([rotation @ turn.T for rotation in rotations])
    np.testing.assert_allclose(rotation_to_z(up) @ turn @ [0, 0, 1], [0, 0, 1], atol=0.02)


def test_up_of_cameras_that_all_look_the_same_way():
    """Horizons say nothing of the tilt, so the cameras' own up is it."""
    turn = Rotation.from_rotvec([0.3, -2.0, 1.1]).as_matrix()
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(up_direction([level @ turn.T] * 5), turn @ [0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (0.6, 0, 0.8), (0, -0.6, -0.8)])
def test_rotation_to_z(up):
    rotation = rotation_to_z(np.array(up, float))
    np.testing.assert_allclose(rotation @ up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_quaternions_are_scipys():
    for rotation in (*Rotation.random(50, random_state=3), Rotation.from_euler("z", np.pi)):
        wxyz = quaternion_of(rotation.as_matrix())
        np.testing.assert_allclose(abs(wxyz @ np.roll(rotation.as_quat(), 1)), 1.0, atol=1e-12)
        assert wxyz[0] >= 0.0
