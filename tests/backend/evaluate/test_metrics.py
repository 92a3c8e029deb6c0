# SPDX-License-Identifier: GPL-3.0-or-later
"""Metrics against other programs and closed forms."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
import pytorch_msssim
import torch
from scipy.signal import convolve2d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from physhdr.backend.evaluate.lpips import Lpips
from physhdr.backend.evaluate.metrics import (
    PSNR_CAP,
    averaged_to,
    display,
    hdr_pair,
    mu_law,
    psnr,
    quantise,
    scale_ratio,
    ssim,
    ssim_map,
)
from physhdr.backend.scene.pictures import read_codes
from physhdr.bridge.errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError

#: A folder with LPIPS' weights and the pictures that its authors publish distances of (docs/formats.md).
LPIPS_FOLDER = Path(os.environ.get("PHYSHDR_LPIPS_FOLDER", "lpips"))
LPIPS_WEIGHTS = LPIPS_FOLDER / "lpips_alex_v0.1_float32.npz"
needs_weights = pytest.mark.skipif(
    not LPIPS_WEIGHTS.is_file(), reason="PHYSHDR_LPIPS_FOLDER names no folder with the LPIPS weights"
)


@pytest.fixture
def pair() -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth picture with an edge, and the same with noise: ``[3, 60, 80]`` in 0…1."""
    generator = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.linspace(0, 1, 60), torch.linspace(0, 1, 80), indexing="ij")
    picture = torch.stack([x * y, 0.5 + 0.4 * torch.sin(9 * x), (x > 0.5).float()])
    noise = 0.1 * torch.randn(picture.shape, generator=generator)
    return picture, (picture + noise).clamp(0, 1)


# ---- PSNR, SSIM --------------------------------------------------------------------------------------


def test_psnr_closed_form() -> None:
    zero = torch.zeros(3, 4, 4)
    assert psnr(zero, zero + 0.1) == pytest.approx(20.0, abs=1e-5)
    assert psnr(zero, zero + 1e-4) == pytest.approx(80.0, abs=1e-3)
    assert psnr(zero, zero) == psnr(zero, zero + 1e-6) == PSNR_CAP


def test_psnr_of_what_is_no_number_is_none() -> None:
    zero = torch.zeros(3, 4, 4)
    spoilt = zero.clone()
    spoilt[1, 2, 3] = math.nan
    assert math.isnan(psnr(spoilt, zero)) and math.isnan(psnr(zero[:, :0], zero[:, :0]))


def test_psnr_agrees_with_another_program(pair) -> None:
    picture, other = (each.double().numpy() for each in pair)
    assert psnr(*pair) == pytest.approx(peak_signal_noise_ratio(other, picture, data_range=1.0), abs=1e-9)


def test_ssim_is_its_definition_borders_and_all(pair) -> None:
    """3DGS's SSIM in words: 11×11 Gaussian, σ 1.5, zeros outside; every pixel of a plane, in 2-D."""
    x, y = (each[1].double().numpy() for each in pair)
    g = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    window = np.outer(g, g) / np.outer(g, g).sum()

    def mean(plane: np.ndarray) -> np.ndarray:
        return convolve2d(plane, window, mode="same", boundary="fill")

    mx, my = mean(x), mean(y)
    vx, vy, covariance = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    expected = (2 * mx * my + 1e-4) * (2 * covariance + 9e-4)
    expected /= (mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)
    np.testing.assert_allclose(ssim_map(*pair)[1].numpy(), expected, atol=1e-9)


def test_ssim_agrees_with_two_other_programs_where_there_is_no_padding(pair) -> None:
    picture, other = pair
    ours = ssim_map(picture, other)[:, 5:-5, 5:-5].mean().item()
    msssim = pytorch_msssim.ssim(picture[None].double(), other[None].double(), data_range=1.0).item()
    _, skimage_map = structural_similarity(
        picture.permute(1, 2, 0).double().numpy(),
        other.permute(1, 2, 0).double().numpy(),
        channel_axis=2,
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    assert ours == pytest.approx(msssim, abs=1e-5)
    assert ours == pytest.approx(skimage_map[5:-5, 5:-5].mean(), abs=1e-5)
    assert 0.2 < ours < 0.9


def test_ssim_counts_the_padding_as_black(pair) -> None:
    picture, other = pair
    pad = torch.nn.ZeroPad2d(5)
    padded = pytorch_msssim.ssim(
        pad(picture)[None].double(), pad(other)[None].double(), data_range=1.0
    ).item()
    assert ssim(picture, other) == pytest.approx(padded, abs=1e-5)


def test_pictures_of_different_size_are_refused(pair) -> None:
    with pytest.raises(DataMismatchError, match=r"\(3, 60, 80\) and \(3, 60, 79\)"):
        psnr(pair[0], pair[1][:, :, :-1])


def test_quantising_rounds_as_png_does() -> None:
    values = torch.tensor([-1.0, 0.0, 0.4 / 255, 0.5 / 255, 0.6 / 255, 1.0, 7.0])
    np.testing.assert_array_equal(quantise(values).numpy() * 255, [0, 0, 0, 1, 1, 255, 255])


# ---- HDR ---------------------------------------------------------------------------------------------


def test_mu_law_closed_form() -> None:
    x = torch.tensor([0.0, 1.0, 0.01], dtype=torch.float64)
    np.testing.assert_allclose(mu_law(x), [0.0, 1.0, np.log(51.0) / np.log(5001.0)], rtol=1e-12)


@pytest.mark.parametrize(("error", "decibel"), [(0.05, 45), (0.1, 39), (0.5, 27), (1.0, 22)])
def test_an_error_of_scale_caps_the_hdr_psnr_as_was_measured(error: float, decibel: float) -> None:
    """The scale is not aligned: an error of 5/10/50/100 % caps PSNR near 45/39/27/22 dB."""
    generator = torch.Generator().manual_seed(0)
    truth = torch.rand((3, 80, 80), generator=generator) * 0.3
    truth[0, 0, 0] = 1.0
    pair = hdr_pair(truth * (1.0 + error), truth)
    assert psnr(pair.prediction, pair.truth) == pytest.approx(decibel, abs=1.0)


def test_the_hdr_normaliser_is_the_maximum_before_resizing() -> None:
    truth = torch.full((3, 40, 60), 0.5)
    truth[1, 7, 11] = 80.0
    prediction = torch.full((3, 20, 30), 0.5)
    pair = hdr_pair(prediction, truth)
    assert pair.normaliser == 80.0
    expected = np.floor(255 * np.log1p(5000 * 0.5 / 80) / np.log(5001) + 0.5) / 255
    np.testing.assert_allclose(pair.prediction, expected, rtol=1e-12)
    assert pair.truth.shape == pair.prediction.shape
    assert pair.truth[0, 0, 0].item() == pytest.approx(expected)


def test_the_prediction_is_clipped_at_the_normaliser() -> None:
    shown = display(torch.tensor([-1.0, 5.0, 50.0]), 10.0)
    np.testing.assert_allclose(shown, [0.0, np.log1p(2500.0) / np.log(5001.0), 1.0], rtol=1e-12)


def test_truth_of_another_aspect_is_refused() -> None:
    with pytest.raises(DataMismatchError, match="40×40, the render 30×20"):
        hdr_pair(torch.ones(3, 20, 30), torch.ones(3, 40, 40))


def test_a_smaller_camera_sees_means_over_areas() -> None:
    """Of whole blocks and of parts of pixels: 6 → 4 is 12 half pixels in threes, each axis by itself."""
    generator = np.random.default_rng(0)
    truth = generator.lognormal(0.0, 3.0, (3, 36, 48))
    halves = truth.reshape(3, 18, 2, 24, 2).mean((2, 4))
    np.testing.assert_allclose(averaged_to(torch.from_numpy(truth), 18, 24), halves, rtol=1e-12)
    parts = truth.repeat(2, axis=1).repeat(2, axis=2).reshape(3, 24, 3, 32, 3).mean((2, 4))
    np.testing.assert_allclose(averaged_to(torch.from_numpy(truth), 24, 32), parts, rtol=1e-12)
    odd = averaged_to(torch.from_numpy(truth), 23, 31)
    np.testing.assert_allclose(odd.mean(), truth.mean(), rtol=1e-12)
    np.testing.assert_array_equal(averaged_to(torch.from_numpy(truth), 36, 48), truth)


def test_what_a_perfect_camera_of_half_the_size_sees_is_perfect() -> None:
    """Also on edges and lamps; GaussHDR's way keeps the corners' pixels and misses what lies between."""
    generator = np.random.default_rng(1)
    truth = torch.from_numpy(generator.lognormal(0.0, 2.0, (3, 40, 60)).astype(np.float32))
    seen = torch.from_numpy(truth.numpy().reshape(3, 20, 2, 30, 2).mean((2, 4)))
    pair = hdr_pair(seen, truth)
    assert psnr(pair.prediction, pair.truth) > 80 and scale_ratio(seen, truth) == pytest.approx(1.0)
    published = hdr_pair(seen, truth, published=True)
    assert psnr(published.prediction, published.truth) < 30
    corners = published.truth[:, ::19, ::29]
    np.testing.assert_array_equal(corners, quantise(display(truth, pair.normaliser))[:, ::39, ::59])


def test_black_truth_is_refused() -> None:
    with pytest.raises(BadValueError, match=r"nothing to normalise by\n.*not black"):
        hdr_pair(torch.ones(3, 20, 30), torch.zeros(3, 20, 30))


def test_scale_ratio_is_the_median_over_what_is_lit() -> None:
    truth = torch.ones(3, 10, 10)
    truth[:, :4] = 1e-6  # black: says nothing
    prediction = 1.25 * truth
    prediction[:, :4] = 0.3
    prediction[:, 9] = 100.0  # a few wrong pixels
    assert scale_ratio(prediction, truth) == pytest.approx(1.25)
    assert math.isnan(scale_ratio(prediction, torch.zeros_like(truth)))


# ---- LPIPS -------------------------------------------------------------------------------------------


def example(name: str) -> torch.Tensor:
    return torch.from_numpy(read_codes(LPIPS_FOLDER / name)[0]).permute(2, 0, 1).float() / 255.0


@needs_weights
@pytest.mark.parametrize(("name", "distance"), [("ex_p0.png", 0.721881), ("ex_p1.png", 0.137566)])
def test_lpips_gives_the_reference_implementation_s_numbers(name: str, distance: float) -> None:
    lpips = Lpips.from_file(LPIPS_WEIGHTS)
    canonical, _ = lpips.both(example(name), example("ex_ref.png"))
    assert canonical == pytest.approx(distance, abs=1e-5)


@needs_weights
def test_both_conventions_of_lpips_differ_and_vanish_for_equal_pictures() -> None:
    lpips = Lpips.from_file(LPIPS_WEIGHTS)
    reference, other = example("ex_ref.png"), example("ex_p1.png")
    canonical, unscaled = lpips.both(other, reference)
    assert unscaled < canonical
    assert lpips.both(reference, reference) == (0.0, 0.0)


@needs_weights
def test_the_two_conventions_differ_by_the_range_of_the_pictures_alone() -> None:
    lpips = Lpips.from_file(LPIPS_WEIGHTS)
    reference, other = example("ex_ref.png"), example("ex_p0.png")
    _, unscaled = lpips.both(other, reference)
    canonical, _ = lpips.both((other + 1.0) / 2.0, (reference + 1.0) / 2.0)  # which is fed as 0…1
    assert unscaled == pytest.approx(canonical, abs=1e-5)


@needs_weights
def test_lpips_refuses_pictures_that_vanish() -> None:
    lpips = Lpips.from_file(LPIPS_WEIGHTS)
    lpips.both(torch.zeros(3, 31, 31), torch.zeros(3, 31, 31))
    with pytest.raises(BadValueError, match="at least 31"):
        lpips.both(torch.zeros(3, 30, 31), torch.zeros(3, 30, 31))


def test_lpips_weights_that_are_missing_or_damaged(tmp_path: Path) -> None:
    with pytest.raises(FileMissingError, match=r"none.npz are missing\n.*skip LPIPS"):
        Lpips.from_file(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(FileDamagedError, match=r"bad.npz does not hold the weights[\s\S]*skip LPIPS"):
        Lpips.from_file(tmp_path / "bad.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(FileDamagedError, match=r"other.npz does not hold the weights"):
        Lpips.from_file(tmp_path / "other.npz")
