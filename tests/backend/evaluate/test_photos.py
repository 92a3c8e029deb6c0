# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos that are not exposed as they say: what is fitted on one half is right on the other."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate import sheets
from physhdr.backend.evaluate.photos import fitted_photos
from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.model.camera_effects import squared_tangent, widest
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.scene import PictureCache, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource
from physhdr.backend.train.begin import begin
from physhdr.backend.train.learned_lens import LearnedLenses, lenses_of
from physhdr.backend.train.nuisances import Nuisances
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import learned_of_photographs, load_method, save
from physhdr.backend.train.trainer import run

SIZE = (48, 32)
CAMERA = Camera.from_field_of_view(np.eye(4), *SIZE, 1.1)
LIGHT = np.exp(np.random.default_rng(0).uniform(-3.0, 0.5, (3, SIZE[1], SIZE[0])))
GAINS = np.array([1.2, 0.9, 1.05])


class Model(Renderer):
    """The right radiance, and a response x / (1 + x)."""

    lights = ("ambient",)

    def hdr(self, camera, lighting_level=1.0):
        return torch.from_numpy(LIGHT).float()

    def ldr(self, camera, exposure, lighting_level=1.0):
        return self.photographed(camera, [exposure], [torch.ones(1, 1, 1)])[0]

    def photographed(self, camera, exposures, effects, lighting_level=1.0):
        exposed = [self.hdr(camera) * t * e for t, e in zip(exposures, effects, strict=True)]
        return [each / (1.0 + each) for each in exposed]


def falloff(camera):
    return 1.0 - 0.3 * (squared_tangent(camera, torch.zeros(1)) / widest(camera))[None]


def photo(tmp_path, mask=None, arriving=None) -> View:
    """Taken through the lens, with a gain for each channel that it does not tell."""
    arriving = falloff(CAMERA) if arriving is None else arriving
    exposed = LIGHT * 0.7 * arriving.numpy() * GAINS[:, None, None]
    codes = np.rint(65535 * exposed / (1.0 + exposed)).astype(np.uint16).transpose(1, 2, 0)
    cache = PictureCache()
    cache.get = lambda source: Decoded(codes, mask)
    return View("test/v_0", CAMERA, (0.7,), (PictureSource(tmp_path / "a"),), 0, cache=cache)


def test_gains_are_found_on_one_half_and_hold_on_the_other(tmp_path):
    found = fitted_photos(Model(), [photo(tmp_path)], falloff)
    right = LIGHT[..., SIZE[0] // 2 :] * 0.7 * falloff(CAMERA).numpy()[..., SIZE[0] // 2 :]
    stated = right / (1.0 + right)
    true = right * GAINS[:, None, None] / (1.0 + right * GAINS[:, None, None])
    assert found.stated == pytest.approx(-10 * math.log10(((stated - true) ** 2).mean()), abs=0.02)
    assert found.fitted > 80.0, "what is left is rounding to 16 bits"
    assert found.stops == pytest.approx(math.sqrt((np.log2(GAINS) ** 2).mean()), abs=1e-4)


def test_a_right_half_that_is_masked_is_no_photo(tmp_path):
    mask = np.zeros(SIZE[::-1], bool)
    mask[:, : SIZE[0] // 2] = True
    assert fitted_photos(Model(), [photo(tmp_path, mask)], falloff) is None


def test_an_evaluation_says_both(tmp_path):
    scene = Scene(tmp_path, "photos", [], [photo(tmp_path)], [])
    plain = evaluate(Model(), scene)
    through = evaluate(Model(), scene, falloff=falloff)
    assert through.ldr[0].metrics.psnr > plain.ldr[0].metrics.psnr, "its corners are dark, too"
    assert any("vignetting" in message for message in through.messages)
    assert any("left half" in message for message in through.messages)
    assert not any("left half" in message for message in plain.messages)


@pytest.mark.parametrize("arriving", [None, torch.ones(1, 1, 1)])
def test_a_sheet_has_the_numbers_of_its_evaluation(tmp_path, monkeypatch, arriving):
    """A photo through the lens, and one that was developed with its profile."""
    shown = []
    row, rows = sheets._row, sheets._method_rows
    monkeypatch.setattr(sheets, "_row", lambda *given: shown.append(given[2]) or row(*given))
    monkeypatch.setattr(sheets, "_method_rows", lambda *given: shown.append(given[1]) or rows(*given))
    scene = Scene(tmp_path, "photos", [], [photo(tmp_path, arriving=arriving)], [])
    found = evaluate(Model(), scene, falloff=falloff)
    assert found.falloff_used == (arriving is None)
    used = falloff if found.falloff_used else None
    sheets.comparison_sheet(Model(), scene, exposure_indices=(0,), falloff=used)
    both = {"with": Model(), "without": Model()}
    sheets.method_sheet(both, scene, exposure_indices=(0,), falloffs={"with": used, "without": None})
    alone, methods = shown
    measured = found.ldr[0].metrics
    assert alone.psnr == methods["with"].psnr == measured.psnr and alone.ssim == measured.ssim
    assert (methods["without"].psnr == measured.psnr) == (arriving is not None)


def test_pictures_without_the_vignetting_are_compared_without(tmp_path):
    scene = Scene(tmp_path, "corrected", [], [photo(tmp_path, arriving=torch.ones(1, 1, 1))], [])
    plain, through = evaluate(Model(), scene), evaluate(Model(), scene, falloff=falloff)
    assert through.ldr[0].metrics.psnr == plain.ldr[0].metrics.psnr
    assert any("compared without" in message for message in through.messages)


@pytest.mark.parametrize("preset", ["default", "baseline", "paper"])
def test_a_trained_lens_is_on_the_pictures_that_are_compared(tiny_data, tmp_path, preset):
    scene = read_scene(tiny_data)
    config = replace(PRESETS[preset], iterations=4, nuisances="on")
    state = begin(scene, config)
    for _ in run(state, tmp_path):
        pass
    with torch.no_grad():
        state.part(Nuisances).values["vignetting"].copy_(torch.tensor([[0.0, 0.8, 0.0]]))
    save(state, tmp_path)
    lenses = lenses_of(learned_of_photographs(tmp_path)[0], [view.camera for view in scene.train])
    method, _ = load_method(tmp_path, config, scene.response_anchor)
    view = scene.test[0]
    corner = math.exp(-0.8)  # about: half a pixel from it
    share = lenses.falloff(view.camera)
    assert share[0, 0, 0].item() == pytest.approx(corner, rel=0.1) and share.max() <= 1.0
    plain, through = (
        method.photographed(view.camera, [1.0], [effect])[0] for effect in (torch.ones(1, 1, 1), share)
    )
    assert torch.allclose(plain, method.ldr(view.camera, 1.0), atol=1e-6)
    assert (through[:, 0] < plain[:, 0]).all(), "the first row is darker"
    assert isinstance(lenses, LearnedLenses)
