# SPDX-License-Identifier: GPL-3.0-or-later
"""Views for testing are surrounded by others: on paths, rings, grids and clouds whose ends are known."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from physhdr.backend.scene import held_out_views

FORWARD = np.array([0.0, 1.0, 0.0])


def toward(positions: np.ndarray, target: np.ndarray) -> np.ndarray:
    away = target - positions
    return away / np.linalg.norm(away, axis=1, keepdims=True)


def arc(count: int, degrees: float, noise: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Around a thing in the origin, 4 m away; ``noise`` in units of the step from one view to the next."""
    angles = np.radians(np.linspace(0.0, degrees, count, endpoint=degrees < 360.0))
    step = 4.0 * abs(angles[1] - angles[0])
    positions = 4.0 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    positions += noise * step * np.random.default_rng(seed).normal(size=positions.shape)
    return positions, toward(positions, np.zeros(3))


@pytest.mark.parametrize(
    ("count", "expected"), [(11, [4]), (16, [4, 12]), (18, [4, 12]), (30, [4, 12, 20, 27])]
)
def test_along_an_arc_it_is_the_middle_of_every_eight(count: int, expected: list[int]) -> None:
    """Of 11 three are left over, less than half of eight; of 30 six, whose middle is 27."""
    assert held_out_views.held_out_places(*arc(count, 120.0)) == expected
    assert held_out_views.held_out_places(*arc(count, 360.0)) == expected


@pytest.mark.parametrize("seed", range(5))
def test_names_in_any_order_never_bring_an_end_of_the_path(seed: int) -> None:
    """Pictures of a path whose names say nothing of the order: the ends are views like others by name."""
    positions, directions = arc(40, 100.0, noise=0.1, seed=seed)
    order = np.random.default_rng(seed).permutation(40)
    chosen = order[held_out_views.held_out_places(positions[order], directions[order])]
    assert len(chosen) == 5 and not {0, 39} & set(chosen)


@pytest.mark.parametrize("seed", range(5))
def test_no_corner_of_a_cloud_is_chosen(seed: int) -> None:
    """Of 60 cameras at random in a box that all look the same way none of the hull's sharpest corners."""
    positions = np.random.default_rng(seed).uniform(-1.0, 1.0, (60, 3)) * (2.0, 0.02, 1.0)
    directions = np.tile(FORWARD, (60, 1))
    chosen = held_out_views.held_out_places(positions, directions)
    assert len(chosen) == 7
    flat = positions[:, [0, 2]]
    hull = ConvexHull(flat).vertices
    before, after = flat[np.roll(hull, 1)] - flat[hull], flat[np.roll(hull, -1)] - flat[hull]
    cosine = (before * after).sum(1) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
    corners = hull[cosine > -0.5]
    assert len(corners) and not set(corners.tolist()) & set(chosen)


def test_corners_of_a_grid_are_left_and_its_edges_are_not() -> None:
    x, z = np.meshgrid(np.arange(3.0), np.arange(3.0))
    positions = np.stack([x.ravel(), 0.0 * x.ravel(), z.ravel()], axis=1)
    directions = np.tile(FORWARD, (9, 1))
    corners, others = {0, 2, 6, 8}, {1, 3, 4, 5, 7}
    for shift in range(9):
        order = np.roll(np.arange(9), shift)
        (chosen,) = order[held_out_views.held_out_places(positions[order], directions[order])]
        assert chosen in others and chosen not in corners


def test_a_view_that_looks_elsewhere_lies_between_no_others() -> None:
    """In the middle of a path by place, but it alone looks back: nothing trains what it sees."""
    positions = np.stack([np.arange(16.0), np.zeros(16), np.zeros(16)], axis=1)
    directions = np.tile(FORWARD, (16, 1))
    directions[4] = -FORWARD
    assert held_out_views.held_out_places(positions, directions) == [3, 12]


def test_a_turn_on_the_spot_has_ends_too() -> None:
    angles = np.radians(np.linspace(0.0, 90.0, 24))
    directions = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    order = np.roll(np.arange(24), 4)  # the fourth in order is now where the turn began
    chosen = order[held_out_views.held_out_places(np.zeros((24, 3)), directions[order])]
    assert len(chosen) == 3 and not {0, 23} & set(chosen)


def test_an_end_is_never_chosen_however_few_there_are() -> None:
    for count in range(3, 9):
        assert held_out_views.held_out_places(*arc(count, 60.0)) == [count // 2]
    for count in (0, 1, 2):
        assert held_out_views.held_out_places(np.zeros((count, 3)), np.tile(FORWARD, (count, 1))) == []


def test_where_none_is_between_others_the_nearest_to_it_is_chosen() -> None:
    """Three at the corners of a square's half: the one at its corner sees the others 90° apart."""
    positions = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 1.0]])
    assert held_out_views.held_out_places(positions, np.tile(FORWARD, (3, 1))) == [1]


def bracketed(
    positions: np.ndarray, directions: np.ndarray, exposures: int, error: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Each place ``exposures`` times in a row, as it is found from each picture: ``error`` of the spread."""
    rng = np.random.default_rng(seed)
    spread = float(np.sqrt(((positions - positions.mean(0)) ** 2).sum(1).mean()))
    places = np.repeat(positions, exposures, axis=0)
    places = places + rng.normal(0.0, error * spread, places.shape)
    looks = np.repeat(directions, exposures, axis=0) + rng.normal(0.0, error, places.shape)
    return places, looks / np.linalg.norm(looks, axis=1, keepdims=True)


@pytest.mark.parametrize("exposures", [2, 3, 5, 9])
@pytest.mark.parametrize(("places", "error"), [(12, 0.0), (12, 3e-4), (12, 3e-3), (40, 3e-4), (200, 1e-4)])
def test_the_pictures_of_a_bracket_are_tested_together(exposures: int, places: int, error: float) -> None:
    """Frames of places 1 … N of an arc, whose poses differ by their errors (and by a hand's, 3e-3)."""
    alone = arc(places, 120.0)
    chosen = held_out_views.held_out_places(*bracketed(*alone, exposures, error))
    expected = held_out_views.held_out_places(*alone)
    assert chosen == [exposures * place + k for place in expected for k in range(exposures)]


def test_brackets_in_folders_by_exposure_are_of_one_place_too() -> None:
    """bright/001 … dark/001 …: pictures of one place are far apart in the order of names."""
    positions, directions = bracketed(*arc(12, 120.0), 3, 3e-4)
    order = np.arange(36).reshape(12, 3).T.ravel()
    groups = held_out_views.same_places(positions[order], directions[order])
    assert groups == [[place, 12 + place, 24 + place] for place in range(12)]
    assert held_out_views.held_out_places(positions[order], directions[order]) == [4, 16, 28]


def test_frames_of_a_film_are_places_of_their_own() -> None:
    """Of 2000 frames on a path each is 5e-4 of the spread from the next, nearer than a bracket's are."""
    positions, directions = arc(2000, 60.0)
    assert all(len(group) == 1 for group in held_out_views.same_places(positions, directions))
    assert len(held_out_views.held_out_places(positions, directions)) == 250


def test_two_looks_from_one_place_are_two_places() -> None:
    positions, directions = arc(12, 120.0)
    turned = toward(positions, np.array([0.0, 0.0, 0.5]))
    both = np.concatenate([positions, positions]), np.concatenate([directions, turned])
    assert all(len(group) == 1 for group in held_out_views.same_places(*both))


@pytest.mark.parametrize("end", [0, -1])
def test_a_picture_more_at_an_end_of_the_path_makes_no_test_of_it(end: int) -> None:
    """Who comes back to where the path began, and takes one more there, has not made it a middle."""
    positions, directions = arc(16, 120.0)
    positions, directions = (np.concatenate([them, them[end][None]]) for them in (positions, directions))
    chosen = held_out_views.held_out_places(positions, directions)
    assert chosen == [4, 12]


def test_brackets_of_two_places_are_all_for_training() -> None:
    positions, directions = bracketed(*arc(2, 10.0), 3, 1e-4)
    assert held_out_views.held_out_places(positions, directions) == []
