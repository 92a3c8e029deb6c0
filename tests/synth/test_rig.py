# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the cameras stand and look."""

import math
from dataclasses import replace

import numpy as np
import pytest

from physhdr.synth import rig
from physhdr.synth.errors import OptionError, UnknownNameError
from physhdr.synth.stage import CameraHints

HINTS = CameraHints(
    centre=(0.5, -2.0, 1.4),
    target=(0.2, 1.0, 0.9),
    extent=(1.5, 0.8),
    angle_x=1.0,
    orbit_radius=3.0,
    orbit_arc=1.0,
    elevation=(0.0, 0.4),
)


@pytest.mark.parametrize("name", sorted(rig.RIGS))
@pytest.mark.parametrize("views", [2, 6, 7, 35])
def test_cameras_are_rigid_upright_and_look_at_the_target(name, views):
    poses = rig.poses(name, HINTS, views, 5)
    assert len(poses.train) + len(poses.test) == views and len(poses.lit) == 5
    assert poses.train and poses.test
    for pose in [*poses.train, *poses.test, *poses.lit]:
        turn, place = pose[:3, :3], pose[:3, 3]
        assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-12) and np.linalg.det(turn) == pytest.approx(1)
        away = np.array(HINTS.target) - place
        assert np.allclose(-turn[:, 2], away / np.linalg.norm(away))  # looks down its −Z
        assert turn[2, 1] > 0 and turn[2, 0] == pytest.approx(0)  # +Y is up, the horizon is level


def test_the_grid_is_five_by_seven_and_a_chess_board():
    poses = rig.poses("grid", HINTS, 35, 12)
    assert (len(poses.train), len(poses.test)) == (18, 17)
    train = np.array([pose[:3, 3] for pose in poses.train])
    test = np.array([pose[:3, 3] for pose in poses.test])
    both = np.concatenate([train, test])
    assert len(np.unique(both[:, 2].round(9))) == 5
    assert both[:, 2].max() - both[:, 2].min() == pytest.approx(0.8)
    centre, forward = np.array(HINTS.centre), np.array(HINTS.target) - HINTS.centre
    right = np.array([forward[1], -forward[0], 0]) / np.hypot(*forward[:2])
    columns = ((both - centre) @ right).round(9)
    assert sorted(set(columns)) == pytest.approx(np.linspace(-0.75, 0.75, 7))
    assert np.allclose(both.mean(0), centre)
    for place in test:  # two neighbours at least are trained on, at one step
        gaps = np.linalg.norm(train - place, axis=1)
        assert (gaps < 0.26).sum() >= 2
    lit = np.array([pose[:3, 3] for pose in poses.lit])
    apart = np.linalg.norm(lit[:, None] - lit[None], axis=-1)[~np.eye(12, dtype=bool)]
    assert apart.min() > 0.1
    for half in (lit[:6], lit[6:]):  # both levels see the whole range
        assert np.ptp((half - centre) @ right) > 0.9 and np.ptp(half[:, 2]) > 0.4


@pytest.mark.parametrize(("name", "arc"), [("grid", 1.0), ("orbit", 1.0), ("orbit", 2 * math.pi)])
def test_validation_views_keep_off_the_others(name, arc):
    """By a quarter of a step at least: a choice that is made on them is no choice on a test view."""
    hints = replace(HINTS, orbit_arc=arc)
    poses = rig.poses(name, hints, 35, 0, 40)
    others, own = (
        np.array([pose[:3, 3] for pose in each]) for each in (poses.train + poses.test, poses.validation)
    )
    step = {"grid": 0.8 / 4, "orbit": 2 * 3.0 * math.cos(0.2) * math.sin(arc / 34 / 2)}[name]
    nearest = np.linalg.norm(own[:, None] - others[None], axis=-1).min(1)
    assert nearest.min() > 0.23 * step
    assert len(np.unique(own.round(6), axis=0)) == 40
    assert np.ptp(own, 0)[0] > 0.8 * np.ptp(others, 0)[0]


def test_arcs_keep_their_radius_and_range():
    for name in ("orbit", "hemisphere"):
        poses = rig.poses(name, HINTS, 35, 0)
        offsets = np.array([pose[:3, 3] for pose in [*poses.train, *poses.test]]) - HINTS.target
        assert np.allclose(np.linalg.norm(offsets, axis=1), 3.0)
        elevation = np.arcsin(offsets[:, 2] / 3.0)
        bounds = (0.2, 0.2) if name == "orbit" else (0.0, 0.4)
        assert (elevation.min(), elevation.max()) == pytest.approx(bounds)
        azimuth = np.arctan2(offsets[:, 1], offsets[:, 0])
        middle = math.atan2(-3.0, 0.3)
        assert (azimuth.min() - middle, azimuth.max() - middle) == pytest.approx((-0.5, 0.5))


def test_bad_requests():
    with pytest.raises(UnknownNameError, match="grid, hemisphere, orbit"):
        rig.poses("ring", HINTS, 35, 0)
    with pytest.raises(OptionError, match="at least 2"):
        rig.poses("grid", HINTS, 1, 0)


@pytest.mark.parametrize(("total", "wanted"), [(17, 4), (17, 17), (3, 1), (5, 0)])
def test_spread_indices_are_distinct_and_within(total, wanted):
    chosen = rig.spread_indices(total, wanted)
    assert len(set(chosen)) == wanted and all(0 <= k < total for k in chosen)
