# SPDX-License-Identifier: GPL-3.0-or-later
"""Primaries and curves by number (ITU-T H.273), against libheif's, published values and OpenColorIO's."""

import io

import numpy as np
import OpenImageIO
import pillow_heif
import pytest

from physhdr.backend.scene.code_points import CURVES, PRIMARIES, hlg, pq, profile_of_code_points
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.srgb import to_linear

CONFIG = "ocio://studio-config-latest"


def every_colour(steps=17):
    axis = np.rint(np.linspace(0, 65535, steps)).astype(np.uint16)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(steps, -1, 3)


def by_opencolorio(codes, of, to):
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(codes.shape[1], codes.shape[0], 3, "float"))
    buffer.set_pixels(OpenImageIO.ROI(), (codes / 65535.0).astype(np.float32))
    made = OpenImageIO.ImageBufAlgo.colorconvert(buffer, of, to, colorconfig=CONFIG)
    assert not made.geterror()
    return np.asarray(made.get_pixels()).astype(np.float64)


@pytest.mark.parametrize("number", sorted(PRIMARIES))
def test_primaries_are_those_that_libheif_has(number):
    file = pillow_heif.from_bytes("RGB", (8, 8), bytes(192))
    content = io.BytesIO()
    file.save(content, color_primaries=number, transfer_characteristics=13, matrix_coefficients=6)
    told = pillow_heif.open_heif(content.getvalue()).info["nclx_profile"]
    assert told["color_primaries"] == number
    _, ours = PRIMARIES[number]
    for name in ("red", "green", "blue", "white"):
        theirs = told[f"color_primary_{name}_x"], told[f"color_primary_{name}_y"]
        assert getattr(ours, name) == pytest.approx(theirs, abs=1e-6)


def test_pq_and_hlg_at_published_values():
    """ST 2084's luminance in units of 1000 cd/m²; 75 % of HLG is BT.2408's reference white."""
    codes = np.array([0.0, 0.149946, 0.508078, 0.580689, 0.751827, 1.0])
    np.testing.assert_allclose(pq(codes), [0.0, 0.001, 0.1, 0.203, 1.0, 10.0], rtol=3e-5)
    np.testing.assert_allclose(hlg(np.array([0.0, 0.5, 0.75, 1.0])), [0.0, 1 / 12, 0.26496, 1.0], atol=1e-5)


@pytest.mark.parametrize(
    ("numbers", "of", "to", "one"),
    [
        ((9, 16), "Rec.2100-PQ - Display", "Linear Rec.709 (sRGB)", 10.0),
        ((12, 16), "ST2084-P3-D65 - Display", "Linear Rec.709 (sRGB)", 10.0),
        ((12, 13), "sRGB Encoded P3-D65", "Linear Rec.709 (sRGB)", 1.0),
        ((9, 8), "Linear Rec.2020", "Linear Rec.709 (sRGB)", 1.0),
    ],
)
def test_colours_become_those_of_opencolorio(numbers, of, to, one):
    """``one``: what OpenColorIO has for our 1: its 1 of PQ is 100 cd/m². What is outside is clipped."""
    codes = every_colour()
    profile = profile_of_code_points(*numbers)
    assert profile is not None
    ours = to_linear(profile.to_srgb(codes) / 65535.0)
    theirs = (by_opencolorio(codes, of, to) / one).clip(0.0, 1.0)
    assert np.abs(ours - theirs).max() < 1e-4
    assert theirs.max() == 1.0 and theirs.min() == 0.0


def test_hlg_keeps_greys_and_clips_at_its_largest_code():
    codes = np.repeat(np.array([0, 32768, 49151, 65535], np.uint16)[None, :, None], 3, axis=2)
    ours = to_linear(profile_of_code_points(9, 18).to_srgb(codes) / 65535.0)[0]
    np.testing.assert_allclose(ours, np.repeat([[0.0], [1 / 12], [0.26495], [1.0]], 3, axis=1), atol=3e-5)


def test_pictures_of_srgbs_primaries_stay_as_they_are():
    """Whichever of the plain curves they have: a camera's response is learned."""
    assert [number for number in CURVES if profile_of_code_points(1, number) is not None] == []
    assert profile_of_code_points(2, 2) is None
    assert profile_of_code_points(1, 16).name == "BT.709 with PQ"
    assert profile_of_code_points(9, 14).name == "BT.2020"


@pytest.mark.parametrize("numbers", [(10, 13), (1, 9), (3, 2), (255, 13), (1, 0)])
def test_what_is_not_known_is_refused_with_a_remedy(numbers):
    with pytest.raises(BadValueError) as caught:
        profile_of_code_points(*numbers)
    assert f"primaries {numbers[0]}" in caught.value.message and caught.value.hint
