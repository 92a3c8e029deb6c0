# SPDX-License-Identifier: GPL-3.0-or-later
"""How large Gaussians begin."""

from dataclasses import replace

import numpy as np
import pytest

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.points import EXACT, STRUCTURE_FROM_MOTION
from physhdr.backend.scene.scene import Points
from physhdr.backend.start.initialise import largest_sizes, most_of_stereo
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS


def test_the_nearest_camera_that_sees_a_point_bounds_it():
    """A tenth of the picture's width at the point's depth, in closed form; −Z is where a camera looks."""
    near, far, wide = np.eye(4), np.eye(4), np.eye(4)
    far[2, 3] = 5.0
    cameras = [
        Camera(near, 200, 100, 400.0, 400.0, 100.0, 50.0),
        Camera(far, 200, 100, 400.0, 400.0, 100.0, 50.0),
        Camera(wide, 100, 100, 50.0, 50.0, 50.0, 50.0),
    ]
    points = np.array([[0.0, 0.0, -2.0], [0.3, 0.0, -1.0], [0.0, 0.0, 7.0], [0.0, 1.0, -1.4]])
    # In all; beside the first one's picture, and the wide one is nearer; behind all; in the wide one alone.
    wanted = [0.1 * 0.5 * 2.0, 0.1 * 2.0 * 1.0, np.inf, 0.1 * 2.0 * 1.4]
    assert largest_sizes(points, cameras, 0.1) == pytest.approx(wanted)
    assert largest_sizes(points, cameras[:2], 0.2)[3] == np.inf


@pytest.mark.parametrize(
    ("limit", "origin", "is_bounded"),
    [(0.1, STRUCTURE_FROM_MOTION, True), (0.0, STRUCTURE_FROM_MOTION, False), (0.1, EXACT, False)],
)
def test_a_point_without_neighbours_does_not_begin_as_a_fog(tiny_data, limit, origin, is_bounded):
    """One that structure from motion put before a camera; 0 is 3DGS's rule, which knows no bound."""
    scene = read_scene(tiny_data)
    camera = scene.train[0].camera
    stray = camera.position - 0.6 * camera.camera_to_world[:3, 2]
    assert scene.points is not None
    positions = np.concatenate([scene.points.positions, stray[None]]).astype(np.float32)
    colours = np.zeros((len(positions), 3), np.float32)
    scene = replace(scene, points=Points(positions, colours, origin))
    config = replace(PRESETS["default"], initial_points="file", initial_size_limit=limit)
    parameters = begin(scene, config).method.backbone.parameters
    index = int(np.abs(parameters["means"].detach().numpy() - stray).sum(axis=1).argmin())
    size = float(parameters["log_scales"].detach()[index].exp().max()) / 0.6 * camera.fx / camera.width
    assert size == pytest.approx(limit, rel=1e-4) if is_bounded else size > 0.5
    assert PRESETS["baseline"].initial_size_limit == PRESETS["default"].initial_size_limit
    assert PRESETS["paper"].initial_size_limit == 0.0


@pytest.mark.parametrize(
    ("preset", "source", "origin", "thickness"),
    [
        ("default", "file", EXACT, 0.3),
        ("default", "file", STRUCTURE_FROM_MOTION, 1.0),
        ("default", "file", "", 1.0),
        ("default", "random", EXACT, 1.0),
        ("paper", "file", EXACT, 1.0),
    ],
)
def test_gaussians_begin_flat_where_points_lie_on_surfaces(tiny_data, preset, source, origin, thickness):
    """Those of structure from motion are beside theirs; published methods begin with spheres."""
    scene = read_scene(tiny_data)
    assert scene.points is not None
    scene = replace(scene, points=replace(scene.points, origin=origin))
    config = replace(PRESETS[preset], initial_points=source, random_points=200)
    scales = begin(scene, config).method.backbone.parameters["log_scales"]
    ratio = (scales[:, 2] - scales[:, 0]).exp().detach().numpy()
    assert ratio == pytest.approx(np.full(len(ratio), thickness), rel=1e-5)


def test_stereo_leaves_densification_room():
    """Half of the budget with the data set's points, a sixth where these fill it; at most 40,000."""
    cases = {(60_000, 0): 30_000, (60_000, 17_600): 12_400, (150_000, 100_000): 25_000, (300_000, 0): 40_000}
    assert {case: most_of_stereo(*case) for case in cases} == cases
    assert most_of_stereo(0, 17_600) == 40_000
