# SPDX-License-Identifier: GPL-3.0-or-later
"""Turning Gaussians, and which of them can be drawn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.affine import matrices_of
from physhdr.bridge.errors import BadValueError, DataMismatchError
from physhdr.bridge.spherical_harmonics import basis
from physhdr.bridge.splat_files import SplatCloud, turned
from physhdr.bridge.splat_files.usable import only_usable


def cloud(count: int = 20, coefficients: int = 16) -> SplatCloud:
    rng = np.random.default_rng(2)
    rotation = rng.normal(size=(count, 4))
    arrays = (
        rng.normal(size=(count, 3)),
        rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        rng.lognormal(-3.0, 1.0, (count, 3)),
        rng.uniform(size=count),
        rng.normal(0.0, 0.3, (count, coefficients, 3)),
    )
    return SplatCloud(*(array.astype(np.float32) for array in arrays))


def rotation(seed: int) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("seed", [0, 1])
def test_turned_gaussians_are_the_same_seen_from_turned_cameras(coefficients: int, seed: int) -> None:
    here, turn = cloud(coefficients=coefficients), rotation(seed)
    there = turned(here, turn)
    np.testing.assert_allclose(there.position, here.position @ turn.T, atol=1e-5)
    axes = matrices_of(here.rotation)
    expected = (
        turn @ (axes * np.square(here.scale, dtype=np.float64)[:, None]) @ axes.transpose(0, 2, 1) @ turn.T
    )
    axes = matrices_of(there.rotation)
    found = (axes * np.square(there.scale, dtype=np.float64)[:, None]) @ axes.transpose(0, 2, 1)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    degree = int(coefficients**0.5) - 1
    for direction in np.random.default_rng(9).normal(size=(10, 3)):
        direction /= np.linalg.norm(direction)
        before = np.einsum("k,nkc->nc", basis(direction[None], degree)[0], here.colour_sh)
        after = np.einsum("k,nkc->nc", basis((turn @ direction)[None], degree)[0], there.colour_sh)
        np.testing.assert_allclose(after, before, atol=2e-6)


def test_turning_back_is_where_it_was() -> None:
    here, turn = cloud(), rotation(3)
    back = turned(turned(here, turn), turn.T)
    for name in ("position", "colour_sh"):
        np.testing.assert_allclose(getattr(back, name), getattr(here, name), atol=2e-6)
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", back.rotation, here.rotation)), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    "turn", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.eye(4), np.full((3, 3), np.nan)]
)
def test_only_rotations_turn(turn: np.ndarray) -> None:
    with pytest.raises(BadValueError, match="not a rotation"):
        turned(cloud(), turn)


@pytest.mark.parametrize(
    ("name", "shape"),
    [("rotation", (20, 3)), ("opacity", (20, 1)), ("colour_sh", (20, 5, 3)), ("scale", (19, 3))],
)
def test_arrays_that_do_not_fit(name: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(DataMismatchError, match=name):
        replace(cloud(), **{name: np.zeros(shape, np.float32)})


@pytest.mark.parametrize(
    ("name", "value", "usable"),
    [
        ("position", np.nan, False),
        ("position", 2e6, False),
        ("rotation", 0.0, False),
        ("rotation", 3e38, False),
        ("scale", 0.0, True),
        ("scale", np.inf, False),
        ("scale", -1.0, False),
        ("opacity", 1.0, True),
        ("opacity", 0.0, True),
        ("opacity", np.nan, False),
        ("opacity", 1.5, False),
        ("colour_sh", np.inf, False),
        ("colour_sh", 1e20, False),
    ],
)
def test_which_gaussians_can_be_drawn(name: str, value: float, usable: bool) -> None:
    given = cloud()
    array = getattr(given, name).copy()
    array[4] = value
    found, left_out = only_usable(Path("a.spz"), replace(given, **{name: array}))
    assert (found.count, left_out) == ((20, 0) if usable else (19, 1))
    np.testing.assert_allclose(np.linalg.norm(found.rotation, axis=1), 1.0, atol=1e-6)
