# SPDX-License-Identifier: GPL-3.0-or-later
"""A wall of Gaussians against truth that is off by a known distance and angle."""

import json
import math
from pathlib import Path
from types import ModuleType

import numpy as np
import OpenEXR
import pytest
import torch

from physhdr.backend.evaluate.geometry import geometry_rows
from physhdr.backend.evaluate.panorama import LitSplats
from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.report import to_dict, to_markdown
from physhdr.backend.evaluate.results import Evaluation, GeometryRow
from physhdr.backend.evaluate.truth import surface_truth
from physhdr.backend.scene import Camera, read_scene
from physhdr.backend.scene.scene import Scene
from physhdr.bridge.data_set import passes_file
from physhdr.tests.backend.evaluate.test_protocol import Oracle


def wall(reach: float = 6.0) -> LitSplats:
    """Flat Gaussians in the plane y = 0, five metres before the small data set's cameras; opaque."""
    x, z = np.meshgrid(np.arange(-reach, reach, 0.1), np.arange(-4.0, 6.0, 0.1))
    means = torch.tensor(np.stack([x.ravel() + 2.0, 0 * x.ravel(), z.ravel()], 1), dtype=torch.float32)
    count = len(means)
    scales = torch.tensor([[0.1, 1e-3, 0.1]]).repeat(count, 1)
    turns = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1)
    return LitSplats(means, turns, scales, torch.ones(count), torch.ones(1, count, 3))


class Wall(Oracle):
    def __init__(self, small: ModuleType, splats: LitSplats | None) -> None:
        super().__init__(small)
        self.splats = splats

    def surface_splats(self, camera: Camera) -> LitSplats | None:
        return self.splats


def write_truth(root: Path, index: int, depth: np.ndarray, normal: np.ndarray) -> None:
    path = root / passes_file("test", index)
    path.parent.mkdir(exist_ok=True)
    channels = {"depth.V": depth} | {f"normal.{axis}": normal[..., k] for k, axis in enumerate("XYZ")}
    channels = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


def towards_cameras(small: ModuleType, degrees: float = 0.0) -> np.ndarray:
    turn = math.radians(degrees)
    return np.broadcast_to([0.0, -math.cos(turn), math.sin(turn)], (small.HEIGHT, small.WIDTH, 3)).copy()


def rows_of(root: Path, small: ModuleType, splats: LitSplats | None):
    scene: Scene = read_scene(root)
    return geometry_rows(Wall(small, splats), scene, "test", lambda _: None)


def test_distances_and_angles_are_those_that_were_made(data_set: Path, small: ModuleType) -> None:
    size = (small.HEIGHT, small.WIDTH)
    depth = np.full(size, 5.04)
    depth[:9] = 5.2  # a quarter of the rows is beyond 10 cm
    normal = towards_cameras(small, 20.0)
    normal[:, :12] = towards_cameras(small, 35.0)[:, :12]  # a quarter of the columns beyond 30°
    write_truth(data_set, 1, depth, normal)
    (row,) = rows_of(data_set, small, wall())  # of pose 3 nothing is known
    assert (row.view, row.index) == ("test/r_1", 1)
    assert row.depth == pytest.approx(0.04, abs=1e-4) and row.depth_beyond == pytest.approx(0.25)
    assert row.normal == pytest.approx(20.0, abs=0.1) and row.normal_beyond == pytest.approx(0.25)


def test_sky_and_edges_are_not_compared(data_set: Path, small: ModuleType) -> None:
    depth, normal = np.full((small.HEIGHT, small.WIDTH), 5.0), towards_cameras(small)
    depth[:20], normal[:20] = 1e10, 0.0
    normal[20:30] *= 0.5
    normal[20:30, :, 0] = 0.5  # an edge between two surfaces
    write_truth(data_set, 3, depth, normal)
    (row,) = rows_of(data_set, small, wall())
    assert row.depth < 1e-3 and row.depth_beyond == 0.0
    assert row.normal < 0.1 and row.normal_beyond == 0.0


def test_what_is_not_covered_is_wrong(data_set: Path, small: ModuleType) -> None:
    write_truth(data_set, 1, np.full((small.HEIGHT, small.WIDTH), 5.0), towards_cameras(small))
    far = wall()
    far.means[:, 1] = 500.0 * -1.0  # behind the cameras
    (row,) = rows_of(data_set, small, far)
    assert row.depth == math.inf and row.depth_beyond == 1.0
    assert row.normal == pytest.approx(90.0) and row.normal_beyond == 1.0


def test_truth_of_another_size_is_sampled(data_set: Path, small: ModuleType) -> None:
    depth = np.repeat(np.repeat(np.arange(12.0).reshape(3, 4), 2, 0), 2, 1) + 1.0
    write_truth(data_set, 1, depth, np.ones((*depth.shape, 3)))
    sampled = surface_truth(data_set, "test", 1).sampled(3, 4)
    np.testing.assert_array_equal(sampled.depth, np.arange(12.0).reshape(3, 4) + 1.0)
    assert sampled.normal.shape == (3, 4, 3) and sampled.is_known.all()


def test_a_report_states_it_where_it_is_known(data_set: Path, small: ModuleType) -> None:
    scene = read_scene(data_set)
    without = evaluate(Wall(small, wall()), scene)
    assert without.geometry == [] and to_dict(without)["geometry_mean"] is None
    assert "surface" not in to_markdown(without)
    for index in (1, 3):
        write_truth(data_set, index, np.full((small.HEIGHT, small.WIDTH), 5.02), towards_cameras(small, 10.0))
    assert evaluate(Wall(small, None), scene).geometry == []  # draws no splats
    seen: list[tuple[int, int]] = []
    result = evaluate(Wall(small, wall()), scene, progress=lambda done, total, _: seen.append((done, total)))
    assert [done for done, _ in seen] == list(range(seen[-1][1] + 1))
    mean = json.loads(json.dumps(to_dict(result)))["geometry_mean"]
    assert mean == pytest.approx(
        {"depth": 0.02, "depth_beyond": 0.0, "normal": 10.0, "normal_beyond": 0.0}, abs=0.01
    )
    assert "depth 2.0 cm (median error; 0 % beyond 10 cm), normals 10.0° (0 % beyond 30°)" in to_markdown(
        result
    )


def test_a_view_of_edges_alone_leaves_the_mean_of_normals_to_others() -> None:
    rows = [GeometryRow("a", 0, 0.01, 0.1, 8.0, 0.2), GeometryRow("b", 1, 0.03, 0.3, math.nan, math.nan)]
    mean = Evaluation("s", "test", "exp3", (8, 8), [], [], [], geometry=rows).geometry_mean
    assert mean is not None and mean.depth == pytest.approx(0.02)
    assert (mean.normal, mean.normal_beyond) == (8.0, 0.2)
