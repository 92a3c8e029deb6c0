# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of pictures that are masked, of 16 bits, or radiance, by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio

from physhdr.backend.evaluate.pictures import notes_on, pairs
from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.evaluate.sheets import comparison_sheet
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import CAMERA, SRGB, Encoding, LogEncoding
from physhdr.backend.scene.scene import PictureCache, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource

SIZE = (40, 30)
LIGHT = np.exp(np.random.default_rng(0).uniform(-4.0, 3.0, (SIZE[1], SIZE[0], 3)))
LOG = LogEncoding(5.0)
MASK = np.ones(SIZE[::-1], bool)
MASK[:9, :20] = False


class Kept(PictureCache):
    """Pictures by their path."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures = {}

    def get(self, source):
        return self.pictures[source.path]


class Model(Renderer):
    """Radiance ``error`` times too bright; its response is a square root."""

    lights = ("ambient",)

    def __init__(self, error: float = 1.0) -> None:
        self.error = error

    def hdr(self, camera, lighting_level=1.0):
        return torch.from_numpy(LIGHT * self.error).permute(2, 0, 1).float()

    def ldr(self, camera, exposure, lighting_level=1.0):
        return (self.hdr(camera) * exposure).sqrt().clamp(0.0, 1.0)


def view_of(tmp_path, *pictures: tuple[Encoding, np.ndarray, np.ndarray | None]) -> View:
    """One view; picture k was exposed 1/2ᵏ s."""
    cache, sources = Kept(), []
    for k, (encoding, codes, mask) in enumerate(pictures):
        sources.append(PictureSource(tmp_path / str(k), encoding=encoding))
        cache.pictures[tmp_path / str(k)] = Decoded(codes, mask)
    camera = Camera.from_field_of_view(np.eye(4), *SIZE, 0.9)
    exposures = tuple(0.5**k for k in range(len(pictures)))
    return View("test/v_0", camera, exposures, tuple(sources), 0, cache=cache)


def camera_codes(exposure: float, bits: int) -> np.ndarray:
    largest = 2**bits - 1
    values = np.sqrt(LIGHT * exposure).clip(0.0, 1.0) * largest
    return np.rint(values).astype(np.uint8 if bits == 8 else np.uint16)


def test_each_picture_is_compared_in_its_own_domain(tmp_path):
    """A camera's by the response, radiance by its logarithm: a factor there is nearly a constant offset."""
    view = view_of(
        tmp_path,
        (LOG, LOG.codes(LIGHT), None),
        (CAMERA, camera_codes(0.5, 8), None),
        (SRGB, SRGB.codes(LIGHT * 0.25), None),
        (CAMERA, camera_codes(0.125, 16), None),
    )
    right = [pair.psnr() for pair in pairs(Model(), view)]
    assert right[1] == 100.0 and min(right) > 85.0
    wrong = list(pairs(Model(1.1), view))
    expected = [np.log1p(5000 * LIGHT * factor / 5.0) / math.log(5001.0) for factor in (1.1, 1.0)]
    by_hand = peak_signal_noise_ratio(expected[1], expected[0], data_range=1.0)
    assert wrong[0].psnr() == pytest.approx(by_hand, abs=0.01)
    (alone,) = pairs(Model(1.1), view, [3])
    assert alone.psnr() == wrong[3].psnr()


def test_masked_pixels_do_not_count(tmp_path):
    """A picture that is rubbish where it is masked is as good as one that is not."""
    codes = camera_codes(1.0, 8)
    spoilt = np.where(MASK[..., None], codes, 77)
    shifted = np.where(MASK[..., None], np.minimum(codes.astype(int) + 6, 255), 0).astype(np.uint8)
    view = view_of(tmp_path, (CAMERA, spoilt, MASK), (CAMERA, shifted, MASK))
    first, second = pairs(Model(), replace(view, exposures=(1.0, 1.0 + 1e-9)))
    assert first.metrics().psnr == 100.0 and first.metrics().ssim == pytest.approx(1.0, abs=1e-12)
    error = (np.minimum(codes.astype(int) + 6, 255) - codes)[MASK] / 255.0
    assert second.metrics().psnr == pytest.approx(-10.0 * math.log10(np.mean(error**2)), abs=1e-6)
    assert second.metrics().ssim < 1.0
    assert all((part[:, ~torch.from_numpy(MASK)] == 0).all() for part in second.shown())


def test_of_a_picture_that_is_masked_altogether_there_is_no_number(tmp_path):
    view = view_of(tmp_path, (CAMERA, camera_codes(1.0, 8), np.zeros_like(MASK)))
    (pair,) = pairs(Model(), view)
    assert math.isnan(pair.psnr()) and math.isnan(pair.metrics().psnr) and math.isnan(pair.metrics().ssim)


def test_a_report_says_in_which_domain_its_numbers_are(tmp_path):
    view = view_of(tmp_path, (LOG, LOG.codes(LIGHT), MASK), (CAMERA, camera_codes(0.5, 8), None))
    hidden = view_of(tmp_path, (LOG, LOG.codes(LIGHT), np.zeros_like(MASK)))
    scene = Scene(tmp_path, "mixed", [view], [view, hidden], [])
    evaluation = evaluate(Model(), scene)
    assert len(evaluation.ldr) == 2, "a picture that is masked altogether has no number"
    told = " ".join(evaluation.messages)
    assert "2 of 3 pictures are compared in their own domain: radiance" in told and "masked" in told
    assert not evaluation.eight_bit
    assert notes_on([view_of(tmp_path, (CAMERA, camera_codes(1.0, 8), None))]) == []
    assert comparison_sheet(Model(), scene, [0], (0, 1)).dtype == np.uint8
