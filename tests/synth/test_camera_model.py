# SPDX-License-Identifier: GPL-3.0-or-later
"""A real camera's faults against closed forms: noise, vignetting, white balance, local tone mapping."""

import argparse
import json

import numpy as np
import pytest

from physhdr.bridge.srgb import to_linear
from physhdr.synth import camera_model, response
from physhdr.synth.camera_model import CameraModel
from physhdr.synth.errors import OptionError
from physhdr.synth.png import quantise

REINHARD, SRGB = response.by_name("reinhard-gamma"), response.by_name("srgb")


@pytest.fixture
def picture():
    """[48, 64, 3] radiance over 12 stops."""
    return np.exp2(np.random.default_rng(3).uniform(-8, 4, (48, 64, 3)))


def even(value: float, size: int = 400) -> np.ndarray:
    return np.full((size, size, 3), value)


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


# ---- off ---------------------------------------------------------------------------------------------


def test_the_ideal_camera_is_the_response_and_nothing_else(picture):
    model = CameraModel()
    assert model.off and model.describe() == {}
    for exposure in (0.125, 2.0, 32.0):
        expected = quantise(REINHARD(picture * exposure))
        assert np.array_equal(model.develop(picture, exposure, REINHARD, rng()), expected)
        assert np.array_equal(model.view(0, "train/r_3").develop(picture, exposure, REINHARD), expected)


@pytest.mark.parametrize(
    "on",
    [
        {"iso": 3200.0},
        {"exposure_jitter": 0.3},
        {"white_balance_jitter": 0.3},
        {"vignetting": 2.0},
        {"local_response": 0.6},
    ],
)
def test_each_fault_changes_the_picture_and_is_told(picture, on):
    model = CameraModel(**on)
    ideal = quantise(REINHARD(picture * 2.0))
    assert (model.view(0, "train/r_3").develop(picture, 2.0, REINHARD) != ideal).mean() > 0.3
    told = json.loads(json.dumps(model.describe()))
    assert {key: told[key] for key in on} == on
    assert not (set(told) - {"sensor", "local", "held_out"}) - set(on)
    assert ("held_out" in told) == bool(set(on) & {"iso", "exposure_jitter", "white_balance_jitter"})


# ---- shutter -----------------------------------------------------------------------------------------


def test_exposures_scatter_as_asked_around_those_stated():
    """Exposures measured from pictures of a grey card, against numbers drawn by another generator."""
    sigma, count, card = 0.1, 1500, np.full((2, 2, 3), 0.4)
    model = CameraModel(exposure_jitter=sigma)
    pictures = [model.view(5, f"train/r_{k}").develop(card, 0.5, SRGB)[0, 0, 0] for k in range(count)]
    stops = np.sort(np.log2(to_linear(np.array(pictures) / 255) / 0.2))
    drawn = np.sort(np.random.RandomState(11).standard_normal(count) * sigma)
    assert stops.mean() == pytest.approx(0.0, abs=4 * sigma / np.sqrt(count))
    assert stops.std() == pytest.approx(drawn.std(), rel=0.1)
    # Kolmogorov and Smirnov: two samples of one distribution are farther apart once in 1,000 times.
    both = np.concatenate([stops, drawn])
    apart = np.abs(np.searchsorted(stops, both, "right") - np.searchsorted(drawn, both, "right")) / count
    assert apart.max() < 1.95 * np.sqrt(2 / count)


def test_every_picture_has_an_exposure_error_of_its_own():
    model = CameraModel(exposure_jitter=0.2)
    stated = np.exp2(np.arange(-3.0, 5.0))
    errors = np.array(
        [[model.view(5, f"train/r_{k}").true_exposure(t) / t for t in stated] for k in range(500)]
    )
    assert len(np.unique(errors)) == errors.size
    correlation = np.corrcoef(np.log2(errors).T)
    assert np.abs(correlation[~np.eye(8, dtype=bool)]).max() < 4 / np.sqrt(500)
    view = model.view(5, "train/r_7")
    assert [view.true_exposure(t) / t for t in stated[::-1]] == list(errors[7, ::-1])


def test_an_exposure_error_is_light_before_all_else_and_changes_no_other_draw(picture):
    """A picture is the one of its true exposure; a tiny error leaves noise and balance as they were."""
    view = CameraModel(exposure_jitter=0.5, vignetting=1.0, local_response=0.3).view(1, "train/r_3")
    assert abs(np.log2(view.true_exposure(2.0) / 2.0)) > 0.05
    steady = CameraModel(vignetting=1.0, local_response=0.3).view(1, "train/r_3")
    expected = steady.develop(picture, view.true_exposure(2.0), REINHARD)
    assert np.array_equal(view.develop(picture, 2.0, REINHARD), expected)
    drawn = CameraModel(iso=6400.0, white_balance_jitter=0.2).view(1, "train/r_3")
    also = CameraModel(iso=6400.0, white_balance_jitter=0.2, exposure_jitter=1e-12).view(1, "train/r_3")
    assert np.array_equal(drawn.develop(picture, 2.0, REINHARD), also.develop(picture, 2.0, REINHARD))


# ---- sensor ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("iso", [100.0, 3200.0, 102_400.0])
@pytest.mark.parametrize("x", [0.01, 0.18, 1.0])
def test_noise_has_the_mean_and_the_variance_of_photons_and_reading(iso, x):
    """In electrons: variance = mean (Poisson) + read noise²."""
    full = 68_000 * 100 / iso
    saturation = 0.18 * 78 / 10
    mean = x / saturation * full
    variance = mean + 2.0**2 + (6.0 * 100 / iso) ** 2
    electrons = camera_model.noisy(even(x), iso, rng()) / saturation * full
    count = electrons.size
    assert electrons.mean() == pytest.approx(mean, abs=5 * np.sqrt(variance / count))
    # The variance of a sample variance is (κ − 1) σ⁴ / n, with a kurtosis κ of 3 + 1/mean at most.
    assert electrons.var() == pytest.approx(variance, abs=5 * variance * np.sqrt((2 + 1 / mean) / count))


def test_black_has_read_noise_alone():
    told = CameraModel(iso=800.0).describe()["sensor"]
    electrons_per_unit = told["electrons_at_saturation"] / told["saturation"]
    noise = camera_model.noisy(even(0.0), 800.0, rng())
    assert noise.mean() == pytest.approx(0.0, abs=5 * noise.std() / np.sqrt(noise.size))
    assert noise.std() * electrons_per_unit == pytest.approx(told["read_noise_electrons"], rel=5e-3)


def test_photons_are_counted_whole():
    """At a signal of half an electron a share e^(−½) of the pixels has seen none: Poisson, not a Gaussian."""
    iso = camera_model.FULL_WELL * 100.0  # one electron at saturation
    x = np.full((300, 300, 3), 0.5 * camera_model.SATURATION)
    model_noise = camera_model.noisy(x, iso, rng()) / camera_model.SATURATION
    read = camera_model.read_noise(iso)
    third = ((model_noise - 0.5) ** 3).mean()
    # The third central moment of a Poisson is its mean, of a Gaussian 0.
    assert third == pytest.approx(0.5, abs=5 * np.sqrt(15 * (0.5 + read**2) ** 3 / x.size))
    assert third > 0.2


def test_a_stop_of_iso_is_a_stop_of_light():
    """Where photons rule, ISO × 4 doubles the noise; longer exposure lowers it in relation to the signal."""
    quiet, loud = (camera_model.noisy(even(0.5), iso, rng()).std() for iso in (800.0, 3200.0))
    assert loud / quiet == pytest.approx(2.0, rel=0.02)
    dark, bright = (camera_model.noisy(even(x), 800.0, rng()).std() / x for x in (0.25, 1.0))
    assert dark / bright == pytest.approx(2.0, rel=0.02)


def test_the_noise_of_a_grey_card_in_codes():
    """ISO 3200 at middle grey: 272 electrons, so 6.1 % of noise, 6.5 codes through sRGB's slope there."""
    picture = CameraModel(iso=3200.0).develop(even(0.18), 1.0, SRGB, rng()).astype(float)
    slope = 255 * (SRGB(np.array(0.1801)) - SRGB(np.array(0.1799))) / 0.0002
    electrons = 0.18 / (0.18 * 7.8) * 2125
    expected = slope * 0.18 * np.sqrt(electrons + 4.0) / electrons
    assert picture.mean() == pytest.approx(255 * SRGB(np.array(0.18)), abs=0.5)
    assert picture.std() == pytest.approx(expected, rel=0.02)


def test_light_without_bound_does_no_harm():
    picture = CameraModel(iso=50.0).develop(even(1e12, 8), 1e6, REINHARD, rng())
    assert (picture == 255).all()


# ---- lens --------------------------------------------------------------------------------------------


def test_vignetting_is_the_cosine_law_with_the_loss_asked_for():
    """With tan θ = √(2^(L/2) − 1) in the corner, v is cos⁴θ: L stops lost there, none in the middle."""
    height, width, stops = 101, 151, 1.7
    v = camera_model.vignette(height, width, stops)
    assert v[50, 75] == 1.0 and v.max() == 1.0
    tangent = np.sqrt(2 ** (stops / 2) - 1)
    share = np.hypot(50, 75) / np.hypot(50.5, 75.5)  # the corner pixel's centre, of the corner's distance
    assert v[0, 0] == pytest.approx(np.cos(np.arctan(tangent * share)) ** 4, rel=1e-12)
    assert np.allclose(v, v[::-1]) and np.allclose(v, v[:, ::-1])
    assert np.log2(camera_model.vignette(4001, 4001, stops)[0, 0]) == pytest.approx(-stops, abs=2e-3)


def test_vignetting_darkens_the_light_before_the_response():
    model = CameraModel(vignetting=3.0)
    flat = model.develop(even(0.4, 80), 2.0, SRGB, rng())
    assert np.array_equal(
        flat, quantise(SRGB(0.8 * camera_model.vignette(80, 80, 3.0)[..., None] * [1, 1, 1]))
    )


# ---- white balance -----------------------------------------------------------------------------------


def test_white_balance_is_drawn_once_a_view_and_green_keeps():
    model = CameraModel(white_balance_jitter=0.25)
    gains = np.array([model.view(5, f"train/r_{k}").balance for k in range(4000)])
    assert (gains[:, 1] == 1.0).all()
    stops = np.log2(gains[:, [0, 2]])
    assert np.abs(stops.mean(0)).max() < 5 * 0.25 / np.sqrt(4000)
    assert stops.std(0) == pytest.approx(0.25, rel=0.06)
    assert abs(np.corrcoef(stops.T)[0, 1]) < 0.08
    view = model.view(5, "train/r_3")
    grey = even(0.05, 4)
    for exposure in (0.5, 2.0):  # one balance for the whole bracket
        assert np.array_equal(
            view.develop(grey, exposure, SRGB), quantise(SRGB(grey * exposure * view.balance))
        )


# ---- local tone mapping ------------------------------------------------------------------------------


def test_an_even_picture_has_the_global_response_alone():
    model = CameraModel(local_response=1.0)
    for value in (0.001, 0.18, 3.0):
        flat = even(value, 40) * [1.0, 0.5, 2.0]
        assert np.array_equal(model.develop(flat, 2.0, REINHARD, rng()), quantise(REINHARD(flat * 2.0)))


def step(size: int = 200, stops: float = 4.0) -> np.ndarray:
    """[size, size, 3]: left at 2^−stops, right at 1, with a fine ripple of ±0.05 stops over both."""
    ripple = 0.05 * np.where(np.arange(size) % 4 < 2, 1.0, -1.0)
    left = np.where(np.arange(size) < size // 2, -stops, 0.0)
    return np.exp2(left + ripple)[None, :, None] * np.ones((size, 1, 3))


def test_the_base_is_compressed_details_and_edges_stay():
    x = step()
    before = np.log2(x[100, :, 0])
    after = before + camera_model.local_stops(x, 0.5)[100]
    dark, bright = slice(30, 60), slice(140, 170)  # farther from the edge than two windows
    # 4 stops become 2; the ripple is not the base's and keeps 99 % of its contrast.
    assert after[bright].mean() - after[dark].mean() == pytest.approx(2.0, abs=0.05)
    assert np.ptp(after[dark]) == pytest.approx(0.1, rel=0.02)
    # The edge is where it was, within one pixel, and its halo is less than a tenth of it.
    assert after[100] - after[99] == pytest.approx(2.0, abs=0.4)
    assert after[:100].max() < after[100:].min()
    assert np.abs(after[:100] - after[dark].mean()).max() < 0.4


def test_order_is_kept_along_a_ramp():
    x = np.exp2(np.linspace(-8, 3, 300))[None, :, None] * np.ones((200, 1, 3))
    after = np.log2(x[100, :, 0]) + camera_model.local_stops(x, 0.8)[100]
    assert (np.diff(after) > 0).all()
    assert np.ptp(after) < 0.5 * 11


def test_the_gain_is_clipped_and_the_mean_kept():
    x = step(stops=9.0)
    gain = camera_model.local_stops(x, 1.0)
    assert gain.max() == camera_model.LOCAL_LIMIT and gain.min() == -camera_model.LOCAL_LIMIT
    assert camera_model.local_stops(step(), 0.6).mean() == pytest.approx(0.0, abs=1e-9)


def test_exposure_changes_the_local_gain_only_near_black():
    x = step()
    assert np.allclose(camera_model.local_stops(x, 0.7), camera_model.local_stops(x * 64, 0.7), atol=0.02)
    in_the_dark = camera_model.local_stops(x * 2.0**-14, 0.7)
    assert np.abs(in_the_dark).max() < 0.1


def test_local_tone_mapping_does_not_depend_on_resolution():
    """The gain of a picture and of the same one at half its size differ by hundredths of a stop."""
    y, x = (np.mgrid[0:240, 0:320] + 0.5) / 240
    stops = 3 * np.sin(5 * x) * np.cos(4 * y) + 2 * np.tanh((x - 0.6) / 0.05)
    large = np.exp2(stops)[..., None] * np.ones(3)
    small = large.reshape(120, 2, 160, 2, 3).mean((1, 3))
    gain = camera_model.local_stops(large, 0.6).reshape(120, 2, 160, 2).mean((1, 3))
    difference = gain - camera_model.local_stops(small, 0.6)
    assert np.ptp(gain) > 2
    assert np.sqrt((difference**2).mean()) < 0.03


def test_windows_are_means_of_what_lies_in_the_picture():
    image = np.random.default_rng(1).normal(size=(9, 7))
    expected = [
        [image[max(0, i - 2) : i + 3, max(0, j - 2) : j + 3].mean() for j in range(7)] for i in range(9)
    ]
    assert np.allclose(camera_model.box_mean(image, 2), expected)


# ---- determinism and options -------------------------------------------------------------------------


def test_seed_name_and_exposure_decide_the_noise_not_the_order(picture):
    model = CameraModel(iso=6400.0, exposure_jitter=0.1, white_balance_jitter=0.1)
    view = model.view(1, "train/r_3")
    first = view.develop(picture, 2.0, REINHARD)
    view.develop(picture, 8.0, REINHARD)
    assert np.array_equal(first, model.view(1, "train/r_3").develop(picture, 2.0, REINHARD))
    for seed, name in ((2, "train/r_3"), (1, "train/r_4"), (1, "test/r_3")):
        assert (first != model.view(seed, name).develop(picture, 2.0, REINHARD)).mean() > 0.1
    # Two exposures of one view have independent noise.
    flat = even(0.2, 200)
    noisy_only = CameraModel(iso=6400.0).view(1, "train/r_3")
    a, b = (noisy_only.develop(flat / t, t, SRGB).astype(float) for t in (1.0, 2.0))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.02


def test_the_command_line():
    parser = argparse.ArgumentParser()
    camera_model.add_arguments(parser)
    assert camera_model.from_arguments(parser.parse_args([])).off
    words = [
        "--iso",
        "1600",
        "--exposure-jitter",
        "0.05",
        "--white-balance-jitter",
        "0.1",
        "--vignetting",
        "1.5",
        "--local-response",
        "0.6",
    ]
    asked = camera_model.from_arguments(parser.parse_args(words))
    assert asked == CameraModel(
        iso=1600, exposure_jitter=0.05, white_balance_jitter=0.1, vignetting=1.5, local_response=0.6
    )
    asked.check()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("iso", 10.0),
        ("iso", float("nan")),
        ("exposure_jitter", 2.1),
        ("exposure_jitter", float("nan")),
        ("white_balance_jitter", -0.1),
        ("vignetting", 9.0),
        ("vignetting", float("inf")),
        ("local_response", 1.01),
    ],
)
def test_what_cannot_be_is_refused_by_name(name, value):
    option = "--" + name.replace("_", "-")
    with pytest.raises(OptionError, match=f"{option}: .* is not within"):
        CameraModel(**{name: value}).check()
