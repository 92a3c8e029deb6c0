# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence against closed forms: Gaussians that fill a view, seen well, clipped, starved or not at all."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from physhdr.backend.export.confidence import (
    DOUBT,
    NOISE,
    SHAPE,
    UNKNOWN,
    Tables,
    ViewInTraining,
    blended,
    confidence_at,
    confidence_of,
    confidence_picture,
    expected_error,
    information_of,
    thinned,
)
from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.methods.registry import METHODS
from physhdr.backend.model.backbone import Splats
from physhdr.backend.model.gaussians import SH_C0, initial_gaussians
from physhdr.backend.model.tone_mapper import KnownResponse, ToneMapper, ToneMapperConfig
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import CAMERA, SRGB, LogEncoding
from physhdr.backend.scene.scene import View
from physhdr.backend.scene.source import Decoded
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.views import seen_exposures
from physhdr.bridge.confidence import TOLERANCE
from physhdr.bridge.srgb import to_linear

SIZE = (24, 20)
EXPOSURES = (0.25, 1.0)
#: In the middle of a view each, 20 metres apart.
WELL, CLIPPED, STARVED, UNSEEN = range(4)
RADIANCE = (0.3, 50.0, 1e-7, 0.3)
#: What is known of a Gaussian that no picture states anything of: by hand, of the module's formulas.
NOTHING_KNOWN = 1.0 - math.exp(-((0.1 * math.log(2.0)) ** 1.75))


class Picture:
    """A source of codes that are there already."""

    path = Path("none")

    def __init__(self, codes, encoding, mask=None):
        self.codes, self.encoding, self.mask, self.key = codes, encoding, mask, id(self)

    def read(self, reduction):
        return Decoded(self.codes, self.mask)


def camera_at(index, z=3.0):
    pose = np.eye(4)
    pose[:3, 3] = (20.0 * index, 0.0, z)
    return Camera.from_field_of_view(pose, *SIZE, 0.3)


@pytest.fixture(scope="module")
def method():
    config = PRESETS["default"].method
    positions = np.array([(20.0 * index, 0.0, 0.0) for index in range(4)])
    gaussians = initial_gaussians(
        positions,
        np.log(np.array(RADIANCE))[:, None].repeat(3, axis=1),
        sh_degree=config.sh_degree,
        opacity=0.9975,
        ambient_share=0.5,
        context_size=0,
        seed=0,
    )
    gaussians.parameters["log_scales"] = torch.full((4, 3), math.log(3.0)).requires_grad_()
    assert torch.allclose(gaussians.reflectance_dc[:, 0, 0] * SH_C0, torch.tensor(RADIANCE).log())
    return METHODS["physhdr"].make(config, gaussians, MethodSetup(None, "auto", responses="known"))


def seen_at(method, camera, exposures=EXPOSURES, factor=1.0, mask=None, dtype=np.uint16, **facts):
    """The view as the model draws it, ``factor`` times as bright, in codes of the sRGB curve."""
    drawn = method.hdr(camera).double().numpy().transpose(1, 2, 0) * factor
    largest = float(np.iinfo(dtype).max)
    codes = [np.rint(SRGB.encode(drawn * t) * largest).astype(dtype) for t in exposures]
    sources = tuple(Picture(each, SRGB, mask) for each in codes)
    view = View("train/r_0", camera, tuple(exposures), sources, 0)
    return ViewInTraining(view, tuple(range(len(exposures))), **facts)


def well_seen(method, camera, exposures):
    """The expected error of the Gaussian there, pixel by pixel in float64, of the formulas on the page."""
    drawn = method.hdr(camera)[0].double().numpy()
    alpha = drawn / RADIANCE[WELL]  # one Gaussian: its weight
    information = np.zeros_like(drawn)
    for t in exposures:
        x = drawn * t
        value = 1.055 * x ** (1.0 / 2.4) - 0.055
        slope = 1.055 / 2.4 * x ** (1.0 / 2.4)  # d value / d ln x
        information += np.where(value < 1.0, slope**2 / (1.0 / (12.0 * 65535.0**2) + (0.5 / 255.0) ** 2), 0.0)
    v = 1.0 / information
    error = np.sqrt(v / (1.0 + v))
    return float((alpha * error).sum() / alpha.sum())


def test_well_seen_clipped_starved_and_unseen(method):
    seen = [seen_at(method, camera_at(index)) for index in (WELL, CLIPPED)]
    seen.append(seen_at(method, camera_at(STARVED), dtype=np.uint8))
    assert (seen[CLIPPED].view.image(0) == 65535).all() and (seen[STARVED].view.image(1) == 0).all()
    found = confidence_of(method, seen)
    expected = (well_seen(method, camera_at(WELL), EXPOSURES) + 0.05) / 1.05
    assert expected == pytest.approx(0.05, rel=0.1)  # what one view is worth
    assert found[WELL] == pytest.approx(1.0 - math.exp(-((TOLERANCE / expected) ** 1.75)), rel=1e-4)
    np.testing.assert_allclose(found[[CLIPPED, STARVED, UNSEEN]], NOTHING_KNOWN, rtol=1e-4)
    assert found[WELL] > 0.75 and NOTHING_KNOWN < 0.01


def test_one_short_exposure_tells_what_the_others_clip(method):
    """Radiance 50 is 0.5 of white at a hundredth of a second."""
    found = [
        confidence_of(method, [seen_at(method, camera_at(CLIPPED), exposures)])[CLIPPED]
        for exposures in ((0.25, 1.0), (0.01, 0.25, 1.0))
    ]
    assert found[0] == pytest.approx(NOTHING_KNOWN, rel=1e-4) and found[1] > 0.75


def test_more_views_are_surer(method):
    views = [seen_at(method, camera_at(WELL, z)) for z in (3.0, 3.1, 3.2)]
    found = [float(confidence_of(method, views[:count])[WELL]) for count in (1, 2, 3)]
    for count, each in enumerate(found, start=1):
        total = sum(well_seen(method, camera_at(WELL, z), EXPOSURES) for z in (3.0, 3.1, 3.2)[:count])
        expected = (total + DOUBT * UNKNOWN) / (count + DOUBT)
        assert each == pytest.approx(1.0 - math.exp(-((TOLERANCE / expected) ** SHAPE)), rel=1e-4)
    assert found[0] < found[1] < found[2]


def test_an_error_that_the_pictures_show_is_counted(method):
    """Pictures a fifth of a stop brighter than the model: the error is that, and one view's doubt."""
    factor = 2.0**0.2
    found = confidence_of(method, [seen_at(method, camera_at(WELL), factor=factor)])[WELL]
    expected = (0.2 * math.log(2.0) + 0.05) / 1.05
    assert found == pytest.approx(1.0 - math.exp(-((TOLERANCE / expected) ** 1.75)), abs=0.002)
    # A photo's own gain is no error of the radiance.
    photo = seen_at(method, camera_at(WELL), factor=factor, has_own_gain=True)
    plain = seen_at(method, camera_at(WELL))
    np.testing.assert_allclose(
        confidence_of(method, [photo])[WELL], confidence_of(method, [plain])[WELL], atol=0.006
    )
    # Nor is a lens that is known to pass so much more.
    effect = torch.full((1, *SIZE[::-1]), factor)
    lens = seen_at(method, camera_at(WELL), factor=factor, effect=effect)
    np.testing.assert_allclose(
        confidence_of(method, [lens])[WELL], confidence_of(method, [plain])[WELL], atol=0.006
    )


def test_masked_pixels_tell_nothing(method):
    bright = seen_at(method, camera_at(WELL), factor=4.0, mask=np.zeros(SIZE[::-1], bool))
    assert confidence_of(method, [bright])[WELL] == pytest.approx(NOTHING_KNOWN, rel=1e-4)
    half = np.zeros(SIZE[::-1], bool)
    half[:10] = True
    error, compared = expected_error(
        seen_at(method, camera_at(WELL), mask=half),
        method.hdr(camera_at(WELL)).numpy(),
        Tables(KnownResponse()),
    )
    assert (compared == half).all() and (error[half] < 0.02).all()
    np.testing.assert_allclose(error[~half], UNKNOWN, rtol=1e-5)


def test_a_picture_of_confidence_is_blended_as_colours_are(method):
    confidence = np.array([0.8, 0.1, 0.2, 0.3], np.float32)
    drawn = confidence_picture(method, confidence, camera_at(WELL))
    np.testing.assert_allclose(drawn.image[0], 0.8 * drawn.alpha, rtol=1e-5)
    away = camera_at(WELL, z=-3.0)  # looks down: nothing is there
    assert confidence_picture(method, confidence, away).image.abs().max() == 0.0


def test_blend_weights_are_those_of_the_picture():
    """Σ_p w_p q_p of three Gaussians behind each other, against one picture a Gaussian in float64."""
    rng = np.random.default_rng(1)
    camera = camera_at(0)
    means = torch.tensor(rng.uniform(-0.2, 0.2, (3, 3)) + [[0, 0, 0.5], [0, 0, 0], [0, 0, -0.5]])
    scales = torch.tensor(rng.uniform(0.05, 0.2, (3, 3)))
    quaternions = torch.tensor(rng.normal(size=(3, 4)))
    opacities = torch.tensor([0.5, 0.7, 0.9], dtype=torch.float64)
    planes = rng.uniform(0.0, 2.0, (3, SIZE[1], SIZE[0]))
    shape = [part.float() for part in (means, quaternions, scales, opacities)]
    found = blended(Splats(*shape, torch.zeros(3, 3), torch.zeros(3, 1)), camera, planes)
    # Channel i of the picture is how much Gaussian i has of each pixel.
    weights = rasterize(means, quaternions, scales, opacities, torch.eye(3).double(), camera).image.numpy()
    np.testing.assert_allclose(found, np.einsum("ihw,qhw->iq", weights, planes), rtol=1e-4)


def test_what_codes_tell_by_a_learned_response():
    """At its start the response is logit(value) = 0.6 (ln x − ln 2) + logit(0.7): every slope is known."""
    response = ToneMapper(ToneMapperConfig(), (2.0, 0.7))
    told = information_of(CAMERA, response, np.dtype(np.uint8))
    values = np.arange(256) / 255.0
    inside = slice(20, 236)
    logit = np.log(values[inside] / (1.0 - values[inside]))
    log_exposed = (logit - math.log(0.7 / 0.3)) / 0.6 + math.log(2.0)
    slope = 0.6 * values[inside] * (1.0 - values[inside])
    for channel in range(3):
        np.testing.assert_allclose(told.log_exposed[inside, channel], log_exposed, atol=2e-3)
        expected = slope**2 / (1.0 / (12.0 * 255.0**2) + NOISE**2)
        np.testing.assert_allclose(told.information[inside, channel], expected, rtol=5e-3)
    assert (told.information[[0, 255]] == 0.0).all() and (told.information >= 0.0).all()


def test_what_codes_tell_by_known_encodings():
    linear = information_of(SRGB, KnownResponse(), np.dtype(np.uint16))
    codes = np.array([1000, 20000, 60000])
    np.testing.assert_allclose(np.exp(linear.log_exposed[codes, 0]), to_linear(codes / 65535.0), rtol=1e-5)
    assert (linear.information[[0, 65535]] == 0.0).all()
    # Radiance does not clip, and is known to the same share of itself wherever it is above scale / 5000.
    radiance = information_of(LogEncoding(4.0), KnownResponse(), np.dtype(np.uint16))
    assert radiance.information[65535, 0] > 0.0 and radiance.information[0, 0] == 0.0
    expected = (1.0 / math.log(5001.0)) ** 2 / (1.0 / (12.0 * 32767.5**2) + NOISE**2)
    np.testing.assert_allclose(radiance.information[40000:, 0], expected, rtol=1e-2)


def test_of_large_captures_evenly_spread_views_are_looked_at(method):
    def views(count, width):
        camera = Camera.from_field_of_view(np.eye(4), width, width, 0.3)
        return [
            ViewInTraining(View(str(index), camera, (1.0,), (Picture(None, SRGB),), index), (0,))
            for index in range(count)
        ]

    assert thinned(few := views(200, 200)) is few
    chosen = [each.view.index for each in thinned(views(400, 1000))]
    assert len(chosen) == 100 and (chosen[0], chosen[-1]) == (0, 399)
    assert set(np.diff(chosen)) <= {4, 5}
    assert len(thinned(views(40, 4000))) == 32 and len(thinned(views(20, 4000))) == 20


def test_confidence_is_a_probability_of_the_error():
    expected = np.array([0.0, 0.01, TOLERANCE, 1.0, 2.0])
    found = confidence_at(expected)
    assert found[0] == 1.0 and (np.diff(found) <= 0.0).all()
    assert found[2] == pytest.approx(1.0 - 1.0 / math.e)


@pytest.mark.parametrize("mode", ["exp1", "exp3"])
def test_what_training_saw_is_what_the_trainer_drew(tiny_data, mode):
    scene = read_scene(tiny_data)
    config = dataclasses.replace(PRESETS["fast"], exposure_mode=mode, iterations=1, seed=3)
    state = begin(scene, config)
    assert seen_exposures(state.views, config) == state.data.exposures
    drawn = [(np.random.default_rng([3, 1, i]).choice([0, 2, 4]),) for i in range(len(state.views))]
    assert state.data.exposures == (drawn if mode == "exp1" else [(0, 2, 4)] * len(drawn))
