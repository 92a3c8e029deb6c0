# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera responses against closed forms, published points and Blender's own output."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from physhdr.synth import noise, response
from physhdr.synth.errors import ResponseFileError, UnknownNameError
from physhdr.synth.png import quantise

#: An in-camera JPEG's response; its header says who measured it, and how.
MEASURED = Path(__file__).parents[2] / "lab/curves/olympus-e-m10-ii.txt"
#: (raw, linear JPEG value): the knots that were published.
KNOTS = np.array([
    (0.005707, 0.004764), (0.018944, 0.024456), (0.054501, 0.129992), (0.075665, 0.211873),
    (0.119641, 0.365771), (0.173148, 0.532024), (0.247979, 0.668989), (0.357597, 0.780138),
    (0.459003, 0.839829), (0.626844, 0.904426), (0.769425, 0.948541), (0.820429, 0.964715), (1.0, 1.0),
])  # fmt: skip


def test_reinhard_gamma_meets_the_published_point():
    """HDR-NeRF's unit-exposure loss uses 0.73 at 1."""
    curve = response.by_name("reinhard-gamma")
    assert curve(np.array(1.0)) == pytest.approx(0.73, abs=5e-4)
    assert curve.anchor() == [1.0, pytest.approx(0.5 ** (1 / 2.2))]
    assert curve(np.array([0.0, 1e9])) == pytest.approx([0.0, 1.0], abs=1e-6)


def test_srgb_meets_the_standard():
    """IEC 61966-2-1: 8-bit code 128 is linear 0.21586, the linear part has slope 12.92; 1 saturates."""
    curve = response.by_name("srgb")
    assert curve(np.array(0.2158605)) == pytest.approx(128 / 255, abs=1e-5)
    assert curve(np.array(0.001)) == pytest.approx(0.01292)
    assert curve(np.array(7.0)) == pytest.approx(1.0)
    assert curve.anchor() == [0.18, pytest.approx(0.46135, abs=1e-4)]


@pytest.mark.parametrize(
    ("name", "transform", "look"), [("srgb", "Standard", "None"), ("filmic", "Filmic", "Medium Contrast")]
)
def test_blender_saves_the_same_brackets(tmp_path, name, transform, look):
    """Blender's own 8-bit save of greys over 18 stops, to one code."""
    scene = bpy.data.scenes.new("save")
    try:
        scene.view_settings.view_transform, scene.view_settings.look = transform, look
        scene.render.dither_intensity = 0.0
        picture = scene.render.image_settings
        picture.file_format, picture.color_mode, picture.color_depth = "PNG", "RGB", "8"
        grey = np.exp2(np.linspace(-12.2, 5.8, 512)).astype(np.float32)
        image = bpy.data.images.new("greys", 512, 1, float_buffer=True)
        image.colorspace_settings.name = "Linear Rec.709"
        image.pixels.foreach_set(np.stack([grey, grey, grey, np.ones_like(grey)], -1).ravel())
        image.save_render(str(tmp_path / "greys.png"), scene=scene)
        saved = bpy.data.images.load(str(tmp_path / "greys.png"))
        saved.colorspace_settings.name = "Non-Color"
        codes = np.empty(512 * 4, np.float32)
        saved.pixels.foreach_get(codes)
        bpy.data.images.remove(saved)
        bpy.data.images.remove(image)
    finally:
        bpy.data.scenes.remove(scene)
    theirs = np.round(codes.reshape(-1, 4)[:, 0] * 255)
    ours = quantise(response.by_name(name)(grey)).astype(int)
    assert theirs.min() < 10 and theirs.max() == 255
    assert np.abs(ours - theirs).max() <= 1


@pytest.mark.parametrize("name", sorted(response.BUILT_IN))
def test_a_response_rises_and_its_anchor_tells_the_scale(name):
    curve = response.by_name(name)
    x = np.concatenate([[0.0], np.exp2(np.linspace(-15, 12, 400))])
    code = curve(x)
    assert (np.diff(code) >= 0).all() and code[0] == 0 and code[-1] == pytest.approx(1.0, abs=1e-3)
    at, value = curve.anchor()
    assert value == curve(np.array(at)) and 0.1 < value < 0.95
    assert curve(np.array(at * 1.05)) > value + 1e-3  # 5 % of radiance can be told there


def test_a_curve_from_a_file(tmp_path):
    text = tmp_path / "curve.txt"
    text.write_text("# exposure code\n0.5, 0.4\n1.0, 0.6\n4.0, 0.96\n")
    curve = response.by_name(str(text))
    assert curve(np.array([0.0, 0.25, 0.75, 4.0, 100.0])) == pytest.approx([0.0, 0.2, 0.5, 0.96, 0.96])
    assert curve.describe() == {
        "name": "file",
        "anchor": [1.0, 0.6],
        "curve": [[0.5, 0.4], [1.0, 0.6], [4.0, 0.96]],
    }
    (tmp_path / "curve.json").write_text(json.dumps([[0.5, 0.4], [1.0, 0.6], [4.0, 0.96]]))
    assert response.by_name(str(tmp_path / "curve.json")).describe() == curve.describe()


@pytest.mark.parametrize(
    ("content", "anchor"),
    [
        ("0 0\n0.1 0.5\n1 0.94\n", [1.0, 0.94]),
        ("0 0\n1 0.01\n9 1\n", [1.0, 0.01]),  # dark, and yet not black
        ("0 0\n0.36 1\n", [0.18, 0.5]),
        ("0 0\n64 0\n1024 1\n", [544.0, 0.5]),  # raw numbers of ten bits, whose black is 64
        ("0 0\n0.05 0.7\n0.1 1\n", [0.05 * 5 / 7, 0.5]),
        ("2 0\n4 0.3\n8 0.3\n", [4.0, 0.3]),
        ("0 0.9\n0.1 1\n", [0.05, 0.95]),
        ("0 0.5\n0.1 1\n", [0.05, 0.75]),
    ],
)
def test_the_anchor_is_where_the_curve_shows_something(tmp_path, content, anchor):
    """The trainer takes codes between 0 and 1 alone; x may be in any unit."""
    path = tmp_path / "curve.txt"
    path.write_text(content)
    curve = response.by_name(str(path))
    assert curve.anchor() == pytest.approx(anchor)
    assert curve(np.array(curve.anchor()[0])) == pytest.approx(anchor[1])


@pytest.mark.parametrize(("name", "text"), [("c.txt", "0 0\n1 0.5\n"), ("c.json", "[[0, 0], [1, 0.5]]")])
def test_a_mark_of_the_byte_order_is_no_part_of_the_curve(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8-sig")
    assert response.by_name(str(tmp_path / name)).anchor() == [1.0, 0.5]


def test_the_measured_curve_is_the_one_that_was_published():
    """Through every knot, within a tenth of a code of 255; middle grey gets ISO 12232's code 118.

    Between them it is near straight lines in linear light: within 4 codes.
    """

    def srgb(linear):
        return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)

    curve = response.by_name(str(MEASURED))
    raw, linear = KNOTS.T
    white = curve.curve[-1][0]
    assert np.abs(curve(raw * white) - srgb(linear)).max() * 255 < 0.1
    fine = np.linspace(0.0, 1.0, 2001)
    straight = np.interp(fine, [0.0, *raw], [0.0, *linear])
    assert np.abs(curve(fine * white) - srgb(straight)).max() * 255 < 4
    assert round(float(curve(np.array(0.18))) * 255) == 118
    assert curve(np.array([0.0, white, 50.0])) == pytest.approx([0.0, 1.0, 1.0])


@pytest.mark.parametrize("name", sorted(response.BUILT_IN))
def test_the_measured_curve_is_none_of_the_built_in_ones(name):
    """Whatever the exposure: even the best shift along the stops leaves 20 codes of 255 somewhere."""
    stops = np.linspace(-8, 4, 481)
    measured, other = response.by_name(str(MEASURED)), response.by_name(name)
    codes = measured(np.exp2(stops))
    middle = (codes > 0.05) & (codes < 0.95)
    worst = [np.abs(codes - other(np.exp2(stops + shift)))[middle].max() for shift in np.linspace(-3, 3, 121)]
    assert min(worst) * 255 > 20


@pytest.mark.parametrize(
    "content",
    [
        *("", "1 2\n", "a b\n1 2\n", "0 0\n1 0.5\n1 0.6\n", "0 0\n1 0.5\n2 0.4\n", "0 0\n1 2\n"),
        *("0 0\n1 0\n", "0 1\n1 1\n"),  # black, white
    ],
)
def test_a_bad_curve_is_refused(tmp_path, content):
    path = tmp_path / "curve.txt"
    path.write_text(content)
    with pytest.raises(ResponseFileError, match=r"curve\.txt"):
        response.by_name(str(path))


def test_unknown_names_are_told_the_known_ones():
    with pytest.raises(UnknownNameError, match="filmic, reinhard-gamma, srgb"):
        response.by_name("agx")


def test_psnr_and_mu_law_against_closed_forms():
    a = np.full((4, 4, 3), 100, np.uint8)
    assert noise.psnr(a, a + 5) == pytest.approx(20 * np.log10(255 / 5))
    assert noise.psnr(a, a) == noise.CEILING
    assert noise.mu_law(np.array([0.0, 2.0, 8.0]), 4.0) == pytest.approx([0, np.log(2501) / np.log(5001), 1])
    radiance = np.full((2, 2, 3), 1.0)
    floor = noise.floor(radiance, radiance * 3, response.by_name("srgb"), (0.05, 10.0))
    # 0.05 and 0.15 through sRGB are codes 63 and 108; at 10 both are white
    assert floor["psnr"] == [pytest.approx(20 * np.log10(255 / (108 - 63)), abs=1e-3), noise.CEILING]
