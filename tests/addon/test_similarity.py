# SPDX-License-Identifier: GPL-3.0-or-later
"""Moving captures, and picking points of them: against closed forms. No Blender."""

import math

import numpy as np
import pytest

from physhdr.addon import similarity
from physhdr.addon.capture.picking import surface_along_ray
from physhdr.bridge.errors import BadValueError, DataMismatchError


def turned(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def similar(scale: float, axis: tuple[float, float, float], angle: float, offset) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * turned(axis, angle), offset
    return matrix


def test_two_points_get_their_distance_and_the_floor_stays():
    first, second = np.array([1.0, 2.0, 0.0]), np.array([1.0, 5.0, 4.0])  # 5 apart
    change = similarity.scaled_to(first, second, 2.0)
    np.testing.assert_allclose(change, np.diag([0.4, 0.4, 0.4, 1.0]))
    moved = similarity.apply(change, np.array([first, second, [7.0, -3.0, 0.0]]))
    assert math.isclose(np.linalg.norm(moved[1] - moved[0]), 2.0) and moved[2, 2] == 0.0
    # A second time nothing is left to do.
    np.testing.assert_allclose(similarity.scaled_to(moved[0], moved[1], 2.0), np.eye(4), atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.3, 2.0, math.pi - 1e-7, math.pi])
@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2)])
def test_a_known_tilt_is_taken_back(angle, order):
    """A level floor and a point above it, tilted about a level axis: exactly that turn is undone."""
    floor = np.array([[0.0, 0.0, 0.0], [2.0, 0.5, 0.0], [-1.0, 3.0, 0.0]])[list(order)]
    above = np.array([0.3, 0.4, 1.6])
    tilt = similar(1.0, (3.0, 4.0, 0.0), angle, (5.0, -2.0, 7.0))
    change = similarity.floor_to_ground(similarity.apply(tilt, floor), similarity.apply(tilt, above[None])[0])
    np.testing.assert_allclose((change @ tilt)[:3, :3] @ [0, 0, 1], [0, 0, 1], atol=1e-9)
    if angle < math.pi - 1e-3:  # at half a turn every level axis is as good
        np.testing.assert_allclose((change @ tilt)[:3, :3], np.eye(3), atol=1e-9)
    moved = similarity.apply(change @ tilt, np.vstack([floor, above]))
    np.testing.assert_allclose(moved[:3, 2], 0.0, atol=1e-9)
    assert math.isclose(moved[3, 2], 1.6, rel_tol=1e-9)
    assert math.isclose(np.linalg.det(change[:3, :3]), 1.0, rel_tol=1e-12)  # neither mirrored nor scaled
    again = similarity.floor_to_ground(moved[:3], moved[3])
    np.testing.assert_allclose(again, np.eye(4), atol=1e-8)


@pytest.mark.parametrize("third", [(2.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 1e-9, 0.0)])
def test_points_in_line_are_no_floor(third):
    with pytest.raises(BadValueError, match="on a line"):
        similarity.floor_to_ground(np.array([[0.0, 0, 0], [1.0, 0, 0], third]), np.array([0.0, 0, 1]))


def test_one_point_and_lengths_that_are_none():
    point = np.array([3.0, 1.0, 0.0])
    with pytest.raises(BadValueError, match="one point"):
        similarity.scaled_to(point, point, 1.0)
    for length in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(BadValueError, match="times as large"):
            similarity.scaled_to(point, np.zeros(3), length)


def test_only_similarities_have_a_scale():
    assert math.isclose(similarity.scale_of(similar(2.5, (1, 2, 3), 0.7, (1, 2, 3))), 2.5)
    for wrong in ((1.0, 2.0, 1.0), (1.0, 1.0, -1.0), (0.0, 1.0, 1.0)):
        with pytest.raises(DataMismatchError):
            similarity.scale_of(np.diag([*wrong, 1.0]))


def test_a_camera_sees_in_the_capture_what_it_sees_in_the_world():
    """The same pixels, and depths by the scale: projected by hand."""
    to_world = similar(2.5, (1.0, 2.0, 3.0), 0.7, (4.0, -1.0, 2.0))
    camera = similar(1.0, (0.2, 1.0, -0.4), 1.9, (3.0, 2.0, 1.0))
    inside = similarity.into_capture(to_world, camera)
    np.testing.assert_allclose(inside[:3, :3].T @ inside[:3, :3], np.eye(3), atol=1e-12)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))

    def seen(pose: np.ndarray, at: np.ndarray) -> np.ndarray:
        return similarity.apply(np.linalg.inv(pose), at)

    in_world, in_capture = seen(camera, similarity.apply(to_world, points)), seen(inside, points)
    np.testing.assert_allclose(in_world, 2.5 * in_capture, atol=1e-12)
    np.testing.assert_allclose(similarity.out_of_capture(to_world, inside), camera, atol=1e-12)


# ---- picking -----------------------------------------------------------------------------------------------


def gaussians(*rows: tuple[tuple[float, float, float], float, float]):
    """Balls: place, deviation, opacity."""
    position, scale, opacity = (np.array([row[k] for row in rows], np.float64) for k in range(3))
    return position, np.tile([1.0, 0, 0, 0], (len(rows), 1)), np.tile(scale[:, None], 3), opacity


EYE, AHEAD = np.zeros(3), np.array([0.0, 0.0, -1.0])


def test_the_first_that_hides_half_is_met():
    wall = ((0.0, 0.0, -5.0), 0.1, 0.9)
    assert surface_along_ray(EYE, AHEAD, *gaussians(wall)) == pytest.approx(5.0)
    # Haze in front counts, but is not met: 0.8 are left of it, then 0.08.
    assert surface_along_ray(EYE, AHEAD, *gaussians(wall, ((0, 0, -2.0), 0.1, 0.2))) == pytest.approx(5.0)
    # Two of 0.3 leave 0.49: the second is met.
    two = ((0, 0, -3.0), 0.1, 0.3), ((0, 0, -2.0), 0.1, 0.3)
    assert surface_along_ray(EYE, AHEAD, *gaussians(wall, *two)) == pytest.approx(3.0)
    # What is behind the eye, beside the ray, or too thin is not.
    assert surface_along_ray(EYE, AHEAD, *gaussians(((0, 0, 4.0), 0.1, 0.9))) is None
    assert surface_along_ray(EYE, AHEAD, *gaussians(((1.0, 0, -4.0), 0.1, 0.9))) is None
    assert surface_along_ray(EYE, AHEAD, *gaussians(((0, 0, -4.0), 0.1, 0.4))) is None


def test_an_edge_is_where_its_alpha_is_a_half():
    """0.9 exp(−x²/2σ²) = ½ at x = σ √(2 ln 1.8)."""
    edge = 0.1 * math.sqrt(2.0 * math.log(1.8))
    for x, is_met in ((0.99 * edge, True), (1.01 * edge, False)):
        met = surface_along_ray(np.array([x, 0.0, 0.0]), AHEAD, *gaussians(((0, 0, -4.0), 0.1, 0.9)))
        assert (met is not None) == is_met


def test_a_slanted_disc_is_met_on_its_plane():
    """A flat Gaussian turned by 60° about Y: a ray beside its middle meets the plane of the disc."""
    angle = math.radians(60.0)
    quaternion = np.array([[math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0]])
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    centre = np.array([0.1, 0.2, -5.0])
    for x in (-0.3, 0.0, 0.4):
        origin = np.array([x, 0.2, 0.0])
        met = surface_along_ray(
            origin, 2.0 * AHEAD, centre[None], quaternion, np.array([[2.0, 2.0, 1e-5]]), np.array([0.9])
        )
        expected = (centre - origin) @ normal / (2.0 * AHEAD @ normal)
        assert met == pytest.approx(expected, rel=1e-6)
