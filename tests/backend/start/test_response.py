# SPDX-License-Identifier: GPL-3.0-or-later
"""The response out of brackets against the camera's own: a closed form, or one that was measured."""

from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import CAMERA, SRGB
from physhdr.backend.scene.scene import PictureCache, View
from physhdr.backend.scene.source import Decoded, PictureSource
from physhdr.backend.start.response import bracket_response, display_response

SIZE = (160, 120)
STOPS = (0.05, 0.8, 12.8)  # sixteenfold, as HDR-NeRF's synthetic scenes
EXPOSURES = (0.05, 0.2, 0.8, 3.2, 12.8)
OLYMPUS = Path(__file__).parents[3] / "lab" / "curves" / "olympus-e-m10-ii.txt"


def srgb(x):
    x = np.clip(x, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def reinhard(x):
    return (x / (1.0 + x)) ** (1.0 / 2.2)


def olympus(x):
    return np.interp(x, *np.loadtxt(OLYMPUS).T)


CAMERAS = {"srgb": srgb, "reinhard": reinhard, "olympus": olympus}


class Kept(PictureCache):
    """Pictures by their path."""

    def __init__(self, pictures):
        super().__init__()
        self.pictures = pictures

    def get(self, source):
        return self.pictures[source.path]


def views_of(responses, exposures=EXPOSURES, *, bits=8, electrons=0.0, masks=None, encoding=CAMERA, count=2):
    """Brackets of smooth light, each channel through one of ``responses``; noisy where there are electrons.

    ``masks``: one for each picture; what they hide is the square of what the camera saw.
    """
    rng = np.random.default_rng(3)
    views = []
    for index in range(count):
        waves = [
            np.outer(*(np.sin(rng.uniform(1, 9) * np.linspace(0, 6, n)) for n in SIZE[::-1])) for _ in "rgb"
        ]
        light = np.exp(4.5 * np.stack(waves, axis=-1) - 1.0)
        sources = [PictureSource(Path(f"{index}_{k}"), encoding=encoding) for k in range(len(exposures))]
        pictures = {}
        for k, exposure in enumerate(exposures):
            exposed = light * exposure
            if electrons:
                exposed = (
                    np.maximum(rng.poisson(exposed * electrons) + rng.normal(0, 2, light.shape), 0)
                    / electrons
                )
            values = np.stack([f(exposed[..., c]) for c, f in enumerate(responses)], axis=-1)
            largest = 2**bits - 1
            codes = np.rint(values * largest).astype(np.uint16 if bits == 16 else np.uint8)
            mask = None if masks is None else masks[k]
            if mask is not None:
                codes[~mask] = (largest * values[~mask] ** 2).astype(codes.dtype)
            pictures[sources[k].path] = Decoded(codes, mask)
        camera = Camera.from_field_of_view(np.eye(4), *SIZE, 0.9)
        views.append(View(f"train/v_{index}", camera, exposures, tuple(sources), index, cache=Kept(pictures)))
    return views


def error_of(found, responses):
    """Root mean square over the camera's ln exposures, in codes of 255, of each channel ``[3]``."""
    errors = []
    for x, logits, response in zip(*found, responses, strict=True):
        at = np.linspace(-6.0, 3.0, 400)
        wanted = 255.0 * response(np.exp(at))
        told = 255.0 / (1.0 + np.exp(-np.interp(at, x, logits)))
        inside = (wanted > 5.0) & (wanted < 250.0)
        errors.append(np.sqrt(np.mean((told - wanted)[inside] ** 2)))
    return np.array(errors)


def anchor_of(response, exposure=0.3):
    return exposure, float(response(np.array(exposure)))


def all_of(views):
    return [tuple(range(len(view.exposures))) for view in views]


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize(
    "taken",
    [
        {},
        {"bits": 16},
        {"exposures": STOPS, "count": 6},
        {"electrons": 2000.0, "count": 6},
    ],
    ids=["two-stops", "16-bits", "four-stops", "noise"],
)
def test_a_known_response_is_found(camera, taken):
    responses = (CAMERAS[camera],) * 3
    views = views_of(responses, **taken)
    found = bracket_response(views, all_of(views), anchor_of(CAMERAS[camera]))
    assert found is not None and found[0].shape == found[1].shape == (3, 254)
    assert (np.diff(found[0]) > 0).all() and (np.diff(found[1]) > 0).all()
    # Sixteenfold exposures tell only what is between four stops; a line through the anchor is off by tens.
    assert error_of(found, responses).max() < (2.5 if "exposures" in taken else 1.5)


def test_channels_may_differ():
    def tinted(x):
        return reinhard(1.3 * x) ** 0.9

    responses = (srgb, reinhard, tinted)
    views = views_of(responses)
    # One anchor is all channels': without one each passes white's half at exposure × radiance 1.
    found = bracket_response(views, all_of(views), None)
    half = 128.0 / 255.0
    at_half = [np.interp(np.log(half / (1.0 - half)), logits, x) for x, logits in zip(*found, strict=True)]
    assert np.allclose(at_half, 0.0, atol=1e-3)
    light = np.exp(np.linspace(-12.0, 5.0, 10_000))
    halves = [light[np.searchsorted(response(light), half)] for response in responses]
    shifted = [lambda x, f=f, h=h: f(x * h) for f, h in zip(responses, halves, strict=True)]
    assert error_of(found, shifted).max() < 2.0


def test_masked_pixels_and_pictures_that_may_not_be_seen_say_nothing():
    masks = [np.ones(SIZE[::-1], dtype=bool) for _ in EXPOSURES]
    for mask in masks[1:4]:
        mask[:, :140] = False
    views = views_of((srgb,) * 3, masks=masks, count=6)
    seen = all_of(views)
    found = bracket_response(views, seen, anchor_of(srgb))
    assert error_of(found, (srgb,) * 3).max() < 1.5
    unmasked = views_of((srgb,) * 3, masks=masks, count=6)
    for view in unmasked:  # the same pictures, and nobody says what is wrong in them
        view.cache.pictures = {path: Decoded(each.codes) for path, each in view.cache.pictures.items()}
    spoilt = bracket_response(unmasked, seen, anchor_of(srgb))
    assert spoilt is None or error_of(spoilt, (srgb,) * 3).max() > 3.0
    for view in views:
        view.cache.pictures[view.sources[1].path].codes[:] = 77
    found = bracket_response(views, [(0, 2, 3, 4)] * 6, anchor_of(srgb))
    assert error_of(found, (srgb,) * 3).max() < 1.5


def test_nothing_is_found_where_nothing_can_be():
    views = views_of((srgb,) * 3)
    anchor = anchor_of(srgb)
    assert bracket_response(views, [(1,)] * 2, anchor) is None  # one picture each
    assert bracket_response(views_of((srgb,) * 3, (0.5, 0.6)), [(0, 1)] * 2, anchor) is None  # nearly equal
    known = views_of((srgb,) * 3, bits=16, encoding=SRGB)
    assert bracket_response(known, all_of(known), anchor) is None  # nothing has to be found
    for view in views:
        for decoded in view.cache.pictures.values():
            decoded.codes[:] = 40
    assert bracket_response(views, all_of(views), anchor) is None  # all alike: no camera


@pytest.mark.parametrize("anchor", [anchor_of(srgb), (0.3, 0.4), None], ids=["its own", "another's", "none"])
def test_where_nothing_tells_it_is_srgbs(anchor):
    """A common factor of all exposures aside, by which it passes the anchor, or half of white at 1."""
    x, logits = display_response(anchor)
    at, value = (1.0, 128.0 / 255.0) if anchor is None else anchor
    factor = ((value + 0.055) / 1.055) ** 2.4 / at
    assert error_of((x, logits), (lambda light: srgb(factor * light),) * 3).max() < 0.05
    told = 1.0 / (1.0 + np.exp(-np.interp(np.log(at), x[1], logits[1])))
    assert told == pytest.approx(value, abs=1e-4)
