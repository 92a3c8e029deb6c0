# SPDX-License-Identifier: GPL-3.0-or-later
"""The fitted bake against a dense least squares in float64, and against pictures of cameras it never saw."""

import numpy as np
import pytest
import torch

from physhdr.backend.export import fitted_bake
from physhdr.backend.export.fitted_bake import fitted_colour_sh, model_picture
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.simd import set_threads, thread_count
from physhdr.bridge.display import display_colour_sh
from physhdr.bridge.model_file import Model
from physhdr.bridge.spherical_harmonics import basis

SIZE = 32
COUNT = 60


def model(seed=0, count=COUNT, degree=1, spread=1.5):
    """Half transparent Gaussians of very different radiance, one behind the other, under one light."""
    random = np.random.default_rng(seed)
    coefficients = (degree + 1) ** 2
    sh = 0.2 * random.standard_normal((count, coefficients, 3))
    sh[:, 0] = spread * random.standard_normal((count, 3)) / 0.28
    x = np.linspace(-8.0, 8.0, 200)
    curve = 1.0 / (1.0 + np.exp(-1.2 * x))
    return Model(
        position=random.uniform(-1.0, 1.0, (count, 3)).astype(np.float32),
        rotation=random.standard_normal((count, 4)).astype(np.float32),
        scale=random.uniform(0.05, 0.3, (count, 3)).astype(np.float32),
        opacity=random.uniform(0.2, 0.9, count).astype(np.float32),
        log_radiance_sh=sh.astype(np.float32),
        light_share=random.uniform(0.0, 1.0, (count, 1, 3)).astype(np.float32),
        tone_curve_log_exposure=x.astype(np.float32),
        tone_curve=np.repeat(curve[:, None], 3, axis=1).astype(np.float32),
    )


def cameras(count=5, offset=0.0):
    """Round the middle, 4 m from it."""
    found = []
    for k in range(count):
        angle = offset + 0.25 * k
        back = np.array([np.sin(angle), 0.0, np.cos(angle)])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], back), [0.0, 1.0, 0.0], back], axis=1)
        pose[:3, 3] = 4.0 * back
        found.append(Camera.from_field_of_view(pose, SIZE, SIZE, 0.7))
    return found


def toward(made, camera):
    offset = made.position.astype(np.float64) - camera.position
    return offset / np.linalg.norm(offset, axis=1, keepdims=True)


def viewed(made, sh, camera):
    """What a standard viewer shows, by the reference in float64: ``[3, H, W]``."""
    colours = np.einsum("nk,nkc->nc", basis(toward(made, camera), made.sh_degree), sh) + 0.5
    arrays = made.position, made.rotation, made.scale, made.opacity, np.maximum(colours, 0.0)
    return rasterize(
        *(torch.from_numpy(each.astype(np.float64)) for each in arrays), camera, None
    ).image.numpy()


def psnr(one, other):
    return -10.0 * np.log10(np.mean(np.square(one - other)))


@pytest.mark.long
def test_against_dense_least_squares(monkeypatch):
    """With colours that stay above the floor it is linear: the normal equations say where it ends."""
    made = model(count=12, degree=1)
    views = cameras(4)
    monkeypatch.setattr(fitted_bake, "_with_places_between", lambda given: given)
    monkeypatch.setattr(fitted_bake, "STEPS", (200,))
    random = np.random.default_rng(5)
    # What is wanted is the view of other colours, near the ones that it starts from.
    start = 0.02 * random.standard_normal((12, 4, 3))
    goal = start + 0.03 * random.standard_normal((12, 4, 3))
    noise = {id(each): 0.05 * random.standard_normal((3, SIZE, SIZE)) for each in views}

    def picture(camera):
        return viewed(made, goal, camera) + noise[id(camera)]

    found = fitted_colour_sh(made, start, views, picture)

    columns, rows = [], []
    for k in range(12 * 4):  # the picture of each coefficient by itself
        one = np.zeros((12, 4, 3))
        one[k // 4, k % 4] = 1.0
        columns.append(np.concatenate([_linear(made, one, camera)[0].ravel() for camera in views]))
    matrix = np.stack(columns, axis=1)
    for c in range(3):
        wanted = np.concatenate([picture(camera)[c].ravel() for camera in views])
        shown = np.concatenate([viewed(made, start, camera)[c].ravel() for camera in views])
        normal = matrix.T @ matrix + fitted_bake.RIDGE * np.eye(48)
        rows.append(np.linalg.solve(normal, matrix.T @ (wanted - shown)).reshape(12, 4))
    expected = start + np.stack(rows, axis=2)
    assert np.abs(expected - start).max() > 0.02
    np.testing.assert_allclose(found, expected, atol=2e-4)


def _linear(made, sh, camera):
    """``viewed`` without ½ and without the floor."""
    colours = np.einsum("nk,nkc->nc", basis(toward(made, camera), made.sh_degree), sh)
    arrays = made.position, made.rotation, made.scale, made.opacity, colours
    return rasterize(
        *(torch.from_numpy(each.astype(np.float64)) for each in arrays), camera, None
    ).image.numpy()


@pytest.mark.parametrize(("exposure", "level"), [(1.0, 1.0), (4.0, 0.25), (0.25, 8.0)])
def test_pictures_of_cameras_it_never_saw(exposure, level):
    made = model(count=300, degree=2)
    start = display_colour_sh(made, exposure, level)
    picture = model_picture(made, exposure, level)
    found = fitted_colour_sh(made, start, cameras(9), picture)
    quick, fitted = [], []
    for camera in cameras(6, offset=0.12):
        own = picture(camera)
        quick.append(psnr(viewed(made, start, camera).clip(0.0, 1.0), own))
        fitted.append(psnr(viewed(made, found, camera).clip(0.0, 1.0), own))
    assert np.mean(fitted) > np.mean(quick) + 8.0, (quick, fitted)


def test_own_picture_is_the_response_of_the_blend():
    """By the reference, in float64."""
    made = model(count=80)
    camera = cameras(1)[0]
    radiance = made.radiance(toward(made, camera), 2.0)
    arrays = made.position, made.rotation, made.scale, made.opacity, radiance
    tensors = (torch.from_numpy(np.asarray(each, np.float64)) for each in arrays)
    exposed = 0.5 * rasterize(*tensors, camera, None).image.numpy()
    with np.errstate(divide="ignore"):
        expected = 1.0 / (1.0 + np.exp(-1.2 * np.maximum(np.log(exposed), -8.0)))
    # The curve's 200 samples, between which it is a straight line, are off by 2e-4.
    np.testing.assert_allclose(model_picture(made, 0.5, 2.0)(camera), expected, atol=1e-3)
    linear = model_picture(made, 0.5, 2.0, "SRGB")(camera)
    low = exposed < 0.0031308
    np.testing.assert_allclose(linear[low], 12.92 * exposed[low], atol=1e-5)
    assert exposed.max() > 2.0 and linear.max() == pytest.approx(1.0, abs=1e-6)


def test_what_no_camera_sees_stays():
    made = model(count=40)
    made.position[7] = (0.0, 0.0, 50.0)  # behind all of them
    start = display_colour_sh(made, 1.0, 1.0)
    found = fitted_colour_sh(made, start, cameras(3), model_picture(made, 1.0))
    np.testing.assert_array_equal(found[7], start[7])
    assert np.abs(found - start).max() > 0.05


def test_any_number_of_threads_and_progress():
    made = model()
    start = display_colour_sh(made, 1.0, 1.0)
    told, results, before = [], [], thread_count()
    try:
        for threads in (1, 3):
            set_threads(threads)
            show = (lambda *three: told.append(three[:2])) if threads == 1 else None
            results.append(fitted_colour_sh(made, start, cameras(4), model_picture(made, 1.0), show))
    finally:
        set_threads(before)
    np.testing.assert_array_equal(*results)
    done, of = zip(*told, strict=True)
    assert list(done) == list(range(1, len(told) + 1)) and set(of) == {len(told)}


def test_many_pixels_are_thinned(monkeypatch):
    """By what all views see, though the first one sees nothing."""
    made = model(count=200, degree=0)
    start = display_colour_sh(made, 1.0, 1.0)
    views, picture = cameras(6), model_picture(made, 1.0)
    whole = fitted_colour_sh(made, start, views, picture)
    monkeypatch.setattr(fitted_bake, "MOST_WEIGHTS", 40_000)
    sizes = []
    original = fitted_bake._view_of

    def counted(*arguments):
        view = original(*arguments)
        sizes.append(view.weights.weights.size)
        return view

    monkeypatch.setattr(fitted_bake, "_view_of", counted)
    away = Camera(
        views[0].camera_to_world @ np.diag([-1.0, 1.0, -1.0, 1.0]), SIZE, SIZE, *[40.0] * 2, *[16.0] * 2
    )
    thinned = fitted_colour_sh(made, start, [away, *views], picture)
    assert sizes[0] == 0 and 20_000 < sum(sizes) < 44_000, sizes
    camera = cameras(1, offset=0.3)[0]
    own = picture(camera)
    shown = [psnr(viewed(made, sh, camera).clip(0.0, 1.0), own) for sh in (start, thinned, whole)]
    assert shown[1] > shown[0] + 5.0 and shown[1] > shown[2] - 4.0, shown


def test_of_many_cameras_some(monkeypatch):
    monkeypatch.setattr(fitted_bake, "MOST_VIEWS", 9)
    chosen = fitted_bake._with_places_between(fitted_bake._thinned(cameras(20)))
    assert len(chosen) == 9
    between = chosen[6]
    nearest = sorted(np.linalg.norm(between.position - each.position) for each in chosen[:6])[:2]
    assert abs(nearest[0] - nearest[1]) < 1e-9
    assert between.width == 3 * SIZE and between.fx / between.width < chosen[0].fx / SIZE
    assert len(fitted_bake._with_places_between(cameras(1))) == 1
