# SPDX-License-Identifier: GPL-3.0-or-later
"""Gains, balances and a lens from points, on a painted plane whose pictures are known in closed form."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from physhdr.backend.model.camera_effects import falloff_terms, lenses, widest
from physhdr.backend.model.tone_mapper import KnownResponse, ToneMapper, ToneMapperConfig
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import CAMERA, SRGB
from physhdr.backend.scene.scene import PictureCache, Points, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource
from physhdr.backend.start import photometry as photometry_module
from physhdr.backend.start.observations import observations
from physhdr.backend.start.photometry import NoPhotometry, photometry, point_effects
from physhdr.backend.start.response import point_response
from physhdr.backend.train.begin import begin
from physhdr.backend.train.nuisances import Nuisances
from physhdr.backend.train.presets import PRESETS

WIDTH, HEIGHT, FOCAL = 96, 64, 70.0
DEVIATIONS = 0.2, 0.1
STOP = math.log(2.0)
#: cos⁴'s law with a corner one stop darker, as the generator has it: (1 + (√2 − 1) ρ)⁻².
CORNER = math.sqrt(2.0) - 1.0


def paint(x, y):
    """Radiance [..., 3] of the plane z = 0."""
    waves = [np.sin(3.3 * x + 0.9 * y + 2 * c) + np.sin(4.1 * y - 1.6 * x + c) for c in range(3)]
    return 0.3 * np.exp(0.5 * np.stack(waves, axis=-1))


def cameras(count, rng):
    """Above the plane, at several heights, each looking elsewhere; the principal point is off the centre."""
    for _ in range(count):
        a, b = rng.uniform(-0.25, 0.25, 2)
        turn_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
        turn_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
        pose = np.eye(4)
        pose[:3, :3] = turn_x @ turn_y
        pose[:3, 3] = [*rng.uniform(-0.7, 0.7, 2), rng.uniform(3.0, 4.5)]
        yield Camera(pose, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2 + 3.0, HEIGHT / 2 - 2.0)


def seen_plane(camera):
    """The plane's x and y at every pixel's centre, and tan²θ there, each [H, W]."""
    u = (np.arange(WIDTH) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(HEIGHT) + 0.5 - camera.cy) / camera.fy
    u, v = np.meshgrid(u, v)
    direction = np.stack([u, -v, -np.ones_like(u)], axis=-1) @ camera.camera_to_world[:3, :3].T
    reach = -camera.position[2] / direction[..., 2]
    return (
        camera.position[0] + reach * direction[..., 0],
        camera.position[1] + reach * direction[..., 1],
        u**2 + v**2,
    )


def walk(count, rng):
    """Along the plane, a quarter of a picture's width at a time."""
    for along, camera in enumerate(cameras(count, rng)):
        pose = camera.camera_to_world.copy()
        pose[0, 3] += along
        yield replace(camera, camera_to_world=pose)


def capture(exposures: Any, response, encoding, rng, views=14, along=cameras):
    """Views of the plane by a faulty camera, with the truth: ln gains [P], ln balances [V, 2]."""
    gains, balances, made = [], [], []
    for camera in along(views, rng):
        x, y, tangent = seen_plane(camera)
        v = (1.0 + CORNER * tangent / widest(camera)) ** -2
        red, blue = rng.normal(0.0, 0.1 * STOP, 2)
        balances.append([red, blue])
        times: Any = exposures(rng) if callable(exposures) else exposures
        pictures = []
        for time in times:
            gain = rng.normal(0.0, 0.2 * STOP)
            gains.append(gain)
            light = paint(x, y) * time * math.exp(gain) * v[..., None] * np.exp([red, 0.0, blue])
            pictures.append(response(light))
        made.append(
            SimpleNamespace(
                camera=camera,
                exposures=times,
                encodings=(encoding,) * len(times),
                image=pictures.__getitem__,
                mask=lambda k: None,
            )
        )
    return made, np.array(gains), np.array(balances)


def eight_bit(light):
    return np.round(255.0 * (light / (1.0 + light)) ** (1.0 / 2.2)).astype(np.uint8)


def solve(views, learned_or_known, points=None):
    rng = np.random.default_rng(5)
    if points is None:
        points = np.column_stack([rng.uniform(-2.0, 2.0, (700, 2)), np.zeros(700)])
    exposures = [tuple(range(len(view.exposures))) for view in views]
    lens = lenses([view.camera for view in views])
    assert set(lens) == {0}
    reach = [max(widest(view.camera) for view in views)]
    arguments = (points, views, exposures, lens, reach)
    found = photometry(*arguments, learned_or_known, DEVIATIONS)
    return found, arguments


@pytest.mark.parametrize("kind", ["brackets of 8 bit", "automatic exposure of 8 bit", "one exposure, linear"])
def test_the_faults_of_a_camera_are_found(kind):
    rng = np.random.default_rng(3)
    exposures, response, encoding, start = {
        "brackets of 8 bit": ((0.25, 1.0, 4.0), eight_bit, CAMERA, ToneMapper(ToneMapperConfig(), None)),
        "automatic exposure of 8 bit": (
            lambda rng: (float(2.0 ** rng.uniform(-2.0, 2.0)),),
            eight_bit,
            CAMERA,
            ToneMapper(ToneMapperConfig(), None),
        ),
        "one exposure, linear": ((1.0,), SRGB.codes, SRGB, KnownResponse()),
    }[kind]
    views, gains, balances = capture(exposures, response, encoding, rng, views=20)
    found, _ = solve(views, start)
    # In the gauge: what is the same in all photos, or follows the stated exposure, is the scene's.
    times = np.log([t for view in views for t in view.exposures])
    basis = np.column_stack([np.ones_like(times), times])
    error = found.gain - gains
    error -= basis @ np.linalg.lstsq(basis, error, rcond=None)[0]
    assert np.std(error) < 0.03 * STOP < np.std(gains) / 5
    assert np.abs(basis.T @ found.gain).max() < 1e-3
    there = np.log([np.exp(np.mean(np.log(view.exposures))) for view in views])
    basis = np.column_stack([np.ones_like(there), there])
    error = found.balance - balances
    assert np.std(error - basis @ np.linalg.lstsq(basis, error, rcond=None)[0]) < 0.02 * STOP
    assert np.abs(basis.T @ found.balance).max() < (1e-2 if len(set(there)) == len(views) else 1e-3)
    rho = np.linspace(0.0, 1.0, 11)
    assert -falloff_terms(rho) @ found.vignetting[0] == pytest.approx(
        -2.0 * np.log1p(CORNER * rho), abs=0.08 * STOP
    )


@pytest.mark.parametrize(
    "exposures",
    [
        lambda r: (float(2.0 ** r.uniform(-2.0, 2.0)),),
        pytest.param(lambda r: (float(16.0 ** r.integers(-1, 2)),), marks=pytest.mark.long),
    ],
    ids=["automatic", "sixteenfold"],
)
def test_the_response_is_found_where_each_photo_has_its_own_exposure(exposures):
    """Against the camera's in closed form, ln f⁻¹(z) = ln(z²·² / (1 − z²·²)), beside all its faults."""
    rng = np.random.default_rng(3)
    views, gains, balances = capture(exposures, eight_bit, CAMERA, rng, views=30)
    found, _ = solve(views, ToneMapper(ToneMapperConfig(), None))
    # As far as gains and balances happen to follow the stated exposure, they are the response's steepness.
    times = np.log([view.exposures[0] for view in views])
    codes = np.linspace(0.12, 0.94, 100)
    inverse = np.log(codes**2.2 / (1.0 - codes**2.2))
    wanted = []
    for balance in (balances[:, 0], 0.0, balances[:, 1]):
        wanted.append(inverse / (1.0 + np.polyfit(times, gains + balance, 1)[0]))
    for anchor in ((0.3, 0.6), None):
        at, value = (128.0 / 255.0, 0.0) if anchor is None else (anchor[1], np.log(anchor[0]))
        log_exposure, logits = point_response(found, anchor)
        assert log_exposure.shape == logits.shape == (3, 254)
        assert (np.diff(log_exposure) > 0.0).all() and (np.diff(logits) > 0.0).all()
        for x, y, curve in zip(log_exposure, logits, wanted, strict=True):
            told = np.interp(curve + value - np.interp(at, codes, curve), x, y)
            assert np.abs(1.0 / (1.0 + np.exp(-told)) - codes).max() < 2.0 / 255.0
    alike, _, _ = capture((1.0,), eight_bit, CAMERA, np.random.default_rng(3), views=30)
    assert point_response(solve(alike, ToneMapper(ToneMapperConfig(), None))[0], None) is None
    assert point_response(None, None) is None


@pytest.mark.long
def test_points_that_err_do_not_flatten_the_response():
    """Most photos metered alike, and points that differ by a fifth from photo to photo.

    Codes err, exposures do not: taken the other way round, the response was 7% too flat.
    """
    rng = np.random.default_rng(3)

    def noisy(light):
        return eight_bit(light * np.exp(rng.normal(0.0, 0.2, light.shape)))

    def metered(r):
        return (float(2.0 ** (r.choice([-1.5, 0.0, 1.5], p=[0.1, 0.8, 0.1]) + r.uniform(-0.5, 0.5))),)

    views, gains, balances = capture(metered, noisy, CAMERA, rng, views=30)
    found, _ = solve(views, ToneMapper(ToneMapperConfig(), None))
    times = np.log([view.exposures[0] for view in views])
    error = found.gain - gains + np.polyval(np.polyfit(times, gains, 1), times)
    assert np.std(error) < 0.02 * STOP < np.std(gains) / 10
    codes = np.array([0.2, 0.8])
    wanted = np.diff(np.log(codes**2.2 / (1.0 - codes**2.2)))
    told = np.diff(found.inverse_at(np.log(codes / (1.0 - codes))))
    for told_rise, balance in zip(told, (balances[:, 0], 0.0, balances[:, 1]), strict=True):
        # As far as gains and balances happen to follow the stated exposure, they are its steepness.
        steepness = 1.0 + np.polyfit(times, gains + balance, 1)[0]
        assert told_rise * steepness == pytest.approx(wanted, rel=0.02)


def test_where_white_begins_is_found():
    """sRGB's curve ends with a corner, which no polynomial has: 0 is ln(exposure × radiance) of white."""

    def srgb_codes(light):
        clipped = np.clip(light, 0.0, 1.0)
        power = 1.055 * np.maximum(clipped, 0.0031308) ** (1.0 / 2.4) - 0.055
        return np.round(255.0 * np.where(clipped <= 0.0031308, 12.92 * clipped, power)).astype(np.uint8)

    def exposures(r):
        return (float(2.0 ** r.uniform(-2.0, 4.0)),)

    views, gains, balances = capture(exposures, srgb_codes, CAMERA, np.random.default_rng(3), views=30)
    found, _ = solve(views, ToneMapper(ToneMapperConfig(), None))
    times = np.log([view.exposures[0] for view in views])
    codes = np.linspace(0.3, 0.99, 100)
    inverse = np.log(((codes + 0.055) / 1.055) ** 2.4)
    half = np.interp(128.0 / 255.0, codes, inverse)
    x, y = point_response(found, None)
    for channel, balance in enumerate((balances[:, 0], 0.0, balances[:, 1])):
        steepness = 1.0 + np.polyfit(times, gains + balance, 1)[0]
        assert found.white[channel] == pytest.approx(-half / steepness, abs=0.03 * STOP)
        told = np.interp((inverse - half) / steepness, x[channel], y[channel])
        error = np.abs(1.0 / (1.0 + np.exp(-told)) - codes)
        assert error.max() < 8.0 / 255.0 and error[-1] < 2.0 / 255.0
    soft, _, _ = capture((0.25, 1.0), eight_bit, CAMERA, np.random.default_rng(3))
    assert np.isnan(solve(soft, ToneMapper(ToneMapperConfig(), None))[0].white).all()  # nothing is white


class Kept(PictureCache):
    """Pictures by their path."""

    def __init__(self, pictures):
        super().__init__()
        self.pictures = pictures

    def get(self, source):
        return self.pictures[source.path]


def exposed_one_by_one():
    """A scene of 30 photos of the plane, each with an exposure of its own, and 700 points."""
    rng = np.random.default_rng(3)
    made, _, _ = capture(lambda r: (float(2.0 ** r.uniform(-2.0, 2.0)),), eight_bit, CAMERA, rng, views=30)
    cache = Kept({Path(str(index)): Decoded(view.image(0), None) for index, view in enumerate(made)})
    views = [
        View(f"train/{i}", view.camera, view.exposures, (PictureSource(Path(str(i))),), i, cache=cache)
        for i, view in enumerate(made)
    ]
    positions = np.column_stack([rng.uniform(-2.0, 2.0, (700, 2)), np.zeros(700)]).astype(np.float32)
    points = Points(positions, np.full((700, 3), 0.5, np.float32))
    anchor = (0.3, float((0.3 / 1.3) ** (1.0 / 2.2)))
    return Scene(Path(), "plane", views, [], [], points=points, response_anchor=anchor)


@pytest.mark.parametrize(
    ("mode", "error_at_most"), [("off", 0.03), pytest.param("on", 0.02, marks=pytest.mark.long)]
)
def test_a_training_of_photos_with_an_exposure_each_begins_with_it(mode, error_at_most):
    """Its curve before the first iteration, and a line, against the camera's in closed form.

    With nuisances off it takes the camera's faults, which are there, for none.
    """
    scene, preset = exposed_one_by_one(), PRESETS["default"]
    config = replace(preset, initial_points="file", nuisances=mode)

    def error(config):
        state = begin(scene, config)
        x, values = (table.detach().numpy() for table in state.method.tone_mapper.sampled())
        light = np.exp(x)
        codes = (light / (1.0 + light)) ** (1.0 / 2.2)
        inside = (codes > 0.12) & (codes < 0.94)
        return state.start_message, np.sqrt(np.mean((values - codes[:, None])[inside] ** 2))

    message, told = error(config)
    assert message == "700 points of the data set, the response as points tell it"
    assert told < error_at_most
    line = replace(config.method.tone_mapper, initial_curve="line")
    message, untold = error(replace(config, method=replace(config.method, tone_mapper=line)))
    assert message == "700 points of the data set" and untold > 1.25 * told


def test_a_training_whose_points_tell_nothing_says_why(monkeypatch):
    monkeypatch.setattr(photometry_module, "MOST_UNKNOWNS", 100)
    preset = PRESETS["default"]
    config = replace(preset, initial_points="file", nuisances="on")
    state = begin(exposed_one_by_one(), config)
    why = "no photometric estimate from the points (30 photos in 30 views are too many to solve for at once)"
    assert state.start_message == f"700 points of the data set, {why}, the response as sRGB has it"
    assert not state.part(Nuisances).values["log_gain"].any()


@pytest.mark.long
def test_a_faultless_camera_stays_faultless():
    rng = np.random.default_rng(4)
    views, _, _ = capture((0.25, 1.0, 4.0), eight_bit, CAMERA, rng)
    for view in views:  # the same pictures without any fault
        x, y, _ = seen_plane(view.camera)
        view.image = [eight_bit(paint(x, y) * time) for time in view.exposures].__getitem__
    found, _ = solve(views, ToneMapper(ToneMapperConfig(), None))
    assert np.abs(found.gain).max() < 0.02 * STOP
    assert np.abs(found.balance).max() < 0.01 * STOP
    assert falloff_terms(np.ones(())) @ found.vignetting[0] < 0.03 * STOP


def test_a_points_effect_is_the_mean_over_the_photos_that_have_it_in_frame():
    views, _, _ = capture((1.0, 4.0), eight_bit, CAMERA, np.random.default_rng(6), views=10)
    found, (points, _, exposures, lens, reach) = solve(views, ToneMapper(ToneMapperConfig(), None))
    effects = point_effects(points[:50], views, exposures, lens, reach, found)
    for point, effect in zip(points[:50], effects, strict=True):
        each = []
        for place, view in enumerate(views):
            camera = view.camera
            x, y, depth = (camera.world_to_camera @ [*point, 1.0])[:3]
            column, row = camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy
            if 0.5 <= column < WIDTH - 0.5 and 0.5 <= row < HEIGHT - 0.5:
                falling = falloff_terms((x**2 + y**2) / depth**2 / reach[0]) @ found.vignetting[0]
                red, blue = found.balance[place]
                each += [found.gain[2 * place + k] + np.array([red, 0, blue]) - falling for k in (0, 1)]
        assert effect == pytest.approx(np.mean(each, axis=0) if each else np.zeros(3), abs=1e-9)


def test_random_points_tell_nothing():
    views, _, _ = capture((0.25, 1.0, 4.0), eight_bit, CAMERA, np.random.default_rng(7))
    rng = np.random.default_rng(8)
    nowhere = np.column_stack([rng.uniform(-1.0, 1.0, (700, 2)), rng.uniform(0.3, 2.8, 700)])
    found, _ = solve(views, ToneMapper(ToneMapperConfig(), None), nowhere)
    assert found == NoPhotometry("photos disagree too much about how bright points are")
    few, _ = solve(views, ToneMapper(ToneMapperConfig(), None), nowhere[:5])
    assert isinstance(few, NoPhotometry) and "42 photos show points with only" in few.reason


def test_a_walk_in_which_each_point_is_in_few_photos_tells_of_all_of_them(monkeypatch):
    """As many points are asked as are needed, not as many as if each photo saw them all."""
    rng = np.random.default_rng(3)
    count = 60
    views, gains, _ = capture((1.0,), SRGB.codes, SRGB, rng, views=count, along=walk)
    points = np.column_stack(
        [rng.uniform(-2.0, count + 1.0, 4000), rng.uniform(-2.0, 2.0, 4000), np.zeros(4000)]
    )
    monkeypatch.setattr(photometry_module, "POINTS", 300)
    monkeypatch.setattr(photometry_module, "OBSERVATIONS", 100 * count)
    found, _ = solve(views, KnownResponse(), points)
    assert np.std(found.gain - gains) < 0.03 * STOP < np.std(gains) / 5
    monkeypatch.setattr(photometry_module, "MOST_UNKNOWNS", 200)
    found, _ = solve(views, KnownResponse(), points)
    assert found == NoPhotometry("60 photos in 60 views are too many to solve for at once")


def test_a_value_that_any_masked_pixel_has_part_in_is_not_seen():
    """It is interpolated from four pixels: one of them is masked, black in one picture, white in another."""
    camera = next(cameras(1, np.random.default_rng(3)))
    row, column = HEIGHT // 2, WIDTH // 2
    mask = np.ones((HEIGHT, WIDTH), dtype=bool)
    mask[row, column] = False
    x, y, _ = seen_plane(camera)
    ends = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    for masked_value, others in ((255, 128), (0, 255)):
        picture = np.full((HEIGHT, WIDTH, 3), others, dtype=np.uint8)
        picture[row, column] = masked_value
        view: Any = SimpleNamespace(
            camera=camera,
            exposures=(1.0,),
            encodings=(CAMERA,),
            image=[picture].__getitem__,
            mask=[mask].__getitem__,
        )
        # Half a pixel from the masked one's centre on every side, and two pixels.
        for step, is_seen in ((1, False), (3, True)):
            corners = [
                (x[row + step * j, column + step * i], y[row + step * j, column + step * i]) for j, i in ends
            ]
            points = np.array(
                [[0.5 * (px + x[row, column]), 0.5 * (py + y[row, column]), 0.0] for px, py in corners]
            )
            reach = [widest(camera)]
            seen, bright = observations(points, np.ones(4, bool), [view], [(0,)], [0], reach)
            assert len(seen.code) + len(bright.code) == (12 if is_seen else 0)
