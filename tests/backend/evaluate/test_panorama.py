# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramas against closed forms, and against Gaussians evaluated densely along rays in float64."""

import math

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate import panorama
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.model_file import Model
from physhdr.bridge.panorama import directions, solid_angles
from physhdr.bridge.splatting import ALPHA_MAX, ALPHA_MIN, LOW_PASS

WIDTH = 128


def seen_by(camera: Camera, light) -> tuple[torch.Tensor, torch.Tensor]:
    """What a camera sees of ``light``, a function of directions ``[…, 3]`` → ``[…, 3]``; all is covered."""
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    own = np.stack(
        [(columns - camera.cx) / camera.fx, (camera.cy - rows) / camera.fy, -np.ones_like(rows)], -1
    )
    vectors = own @ camera.camera_to_world[:3, :3].T
    picture = light(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
    parts = torch.from_numpy(picture.astype(np.float32)).permute(2, 0, 1)[None]
    return parts, torch.ones(camera.height, camera.width)


def around(light, width: int = WIDTH) -> np.ndarray:
    return panorama.surroundings(lambda camera: seen_by(camera, light), (1.0, 2.0, 3.0), width).parts[0]


def flux(picture: np.ndarray) -> np.ndarray:
    """∫ L dω ``[3]``."""
    return np.einsum("h,hwc->c", solid_angles(picture.shape[1]), picture.astype(np.float64))


def test_a_constant_light_stays_constant():
    colour = np.array([0.25, 1.0, 7e5])
    picture = around(lambda vectors: np.broadcast_to(colour, vectors.shape))
    assert picture == pytest.approx(np.broadcast_to(colour, picture.shape), rel=1e-6)


def test_every_direction_is_in_some_picture_far_from_its_rim():
    axes = panorama.VIEWS / np.linalg.norm(panorama.VIEWS, axis=1, keepdims=True)
    farthest = np.degrees(np.arccos((directions(256) @ axes.T).max(-1).min()))
    assert farthest < 28.0 < np.degrees(panorama.HALF_VIEW)


def test_a_smooth_light_comes_out_as_it_is_and_so_does_its_sum():
    def light(vectors: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(vectors, -1, 0)
        return np.stack(
            [1.0 + 0.9 * x, np.exp(2.0 * y), 0.1 + np.exp(8.0 * (0.6 * x + 0.8 * z - 1.0))], axis=-1
        )

    picture = around(light)
    # The mean over a pixel's area, by many directions in it.
    steps = (np.arange(8) + 0.5) / 8
    rows = [np.mean([light(directions(WIDTH, c, r)) for c in steps], axis=0) for r in steps]
    weights = solid_angles(8 * WIDTH).reshape(-1, 8)
    true = np.einsum("rhwc,hr->hwc", rows, weights / weights.sum(1, keepdims=True))
    assert np.abs(picture / true - 1.0).max() < 1e-2
    # 4π; 4π sinh(2) / 2; 4π (0.1 + e^−8 sinh(8) / 8).
    sums = [1.0, math.sinh(2.0) / 2.0, 0.1 + math.exp(-8.0) * math.sinh(8.0) / 8.0]
    assert flux(picture) == pytest.approx(4.0 * math.pi * np.array(sums), rel=1e-3)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0.2, -0.9, 0.4), (0, 0, 1), (1, 1, 1)])
def test_a_lamp_as_small_as_can_be_drawn_keeps_all_of_its_light(axis):
    # The narrowest splat: a point that is widened by the rasteriser's low-pass filter alone.
    centre = np.array(axis) / np.linalg.norm(axis)
    focal = panorama.SUPERSAMPLING * 256 / (2.0 * math.pi)
    deviation, radiance = math.sqrt(LOW_PASS) / focal, 2e6  # beyond what 16 bits could hold

    def light(vectors: np.ndarray) -> np.ndarray:
        return (radiance * np.exp((vectors @ centre - 1.0) / deviation**2))[..., None] * np.ones(3)

    picture = around(light, 256)
    assert flux(picture) == pytest.approx(2.0 * math.pi * deviation**2 * radiance, rel=0.03)
    assert picture.max() > 65504.0


def splats(count: int, seed: int = 0) -> panorama.LitSplats:
    """Gaussians 1.5 to 4 metres around the origin, in two parts."""
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(count, 3))
    means = vectors / np.linalg.norm(vectors, axis=1, keepdims=True) * rng.uniform(1.5, 4.0, (count, 1))
    arrays = (
        means,
        rng.normal(size=(count, 4)),
        np.exp(rng.uniform(math.log(0.05), math.log(0.4), (count, 3))),
        rng.uniform(0.3, 1.0, count),
        np.exp(rng.normal(size=(2, count, 3))),
    )
    return panorama.LitSplats(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))


def along_rays(drawn: panorama.LitSplats, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radiance ``[P, R, 3]`` and coverage ``[R]`` along unit rays ``[R, 3]`` from the origin, in float64.

    A Gaussian's alpha is that of the point of the ray where it is densest; nearest centres come first.
    """
    means, quaternions, scales, opacities, parts = (
        each.double().numpy()
        for each in (drawn.means, drawn.quaternions, drawn.scales, drawn.opacities, drawn.parts)
    )
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    to_sphere = rotation.transpose(0, 2, 1) / scales[:, :, None]
    start = -np.einsum("nij,nj->ni", to_sphere, means)[:, None]
    along = np.einsum("nij,rj->nri", to_sphere, rays)
    way = -(along * start).sum(-1) / (along * along).sum(-1)
    nearest = np.where(way > 0, np.square(start + way[..., None] * along).sum(-1), np.inf)
    alpha = np.minimum(opacities[:, None] * np.exp(-0.5 * nearest), ALPHA_MAX)
    alpha[alpha < ALPHA_MIN] = 0.0
    order = np.argsort(np.linalg.norm(means, axis=1))
    alpha = alpha[order]
    before = np.cumprod(np.concatenate([np.ones_like(alpha[:1]), 1.0 - alpha[:-1]]), axis=0)
    weight = before * alpha
    return np.einsum("nr,pnc->prc", weight, parts[:, order]), weight.sum(0)


def test_gaussians_are_where_rays_find_them(monkeypatch):
    drawn = splats(200)
    seen: list[np.ndarray] = []

    def unfilled(parts: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        seen.append(alpha)
        return parts

    monkeypatch.setattr(panorama, "filled", unfilled)
    found = panorama.surroundings(lambda camera: drawn.drawn(camera, "cpu"), (0.0, 0.0, 0.0), 512)
    row, column = np.random.default_rng(1).integers(0, [[256], [512]], (2, 600))
    rays = [directions(512, c, r)[row, column] for r in (0.25, 0.75) for c in (0.25, 0.75)]
    every = [along_rays(drawn, ray) for ray in rays]
    true, alpha = np.mean([each[0] for each in every], axis=0), np.mean([each[1] for each in every], axis=0)
    error = found.parts[:, row, column] - true
    psnr = 10.0 * math.log10(true.max() ** 2 / np.square(error).mean())
    # 39.9 dB and 0.038: a splat's affine projection is too large away from the picture's axis. Six faces of a
    # cube, whose corners are 55 degrees away, have 30.8 dB and 0.150.
    assert psnr > 39.5
    assert np.abs(seen[0][row, column] - alpha).mean() < 0.04
    assert found.unseen == pytest.approx(1.0 - (solid_angles(512)[:, None] * seen[0]).sum() / (4 * math.pi))


def test_what_is_too_near_is_left_out():
    drawn = splats(5)
    drawn.means[0] = torch.tensor([0.005, 0.0, 0.0])
    drawn.means[1], drawn.scales[1] = torch.tensor([1.0, 0.0, 0.0]), torch.tensor([2.0, 2.0, 2.0])
    kept = drawn.beyond((0.0, 0.0, 0.0), 0.01)
    assert torch.equal(kept.means, drawn.means[2:]) and torch.equal(kept.parts, drawn.parts[:, 2:])
    assert drawn.beyond((50.0, 0.0, 0.0), 0.01) is drawn


def test_a_models_parts_are_its_light():
    rng = np.random.default_rng(2)
    count, lights = 30, ("ambient", "lamp")
    shares = rng.dirichlet(np.ones(3), (count, 3))[..., :2].transpose(0, 2, 1).astype(np.float32)
    model = Model(
        position=rng.normal(size=(count, 3)).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        scale=np.full((count, 3), 0.1, np.float32),
        opacity=np.full(count, 0.5, np.float32),
        log_radiance_sh=rng.normal(size=(count, 9, 3)).astype(np.float32),
        light_share=shares,
        lights=lights,
    )
    at = np.array([0.3, -0.2, 0.1])
    parts = panorama.lit_model(model, at).parts.numpy()
    toward = model.position - at
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    for levels in ((1.0, 1.0), (0.0, 0.0), (4.0, 0.25)):
        together = parts[0] + levels[0] * parts[1] + levels[1] * parts[2]
        assert together == pytest.approx(model.radiance(toward, levels), rel=1e-4)
