# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets and residuals: what is drawn where, and in which colour."""

import math
from pathlib import Path
from types import ModuleType

import matplotlib
import numpy as np
import pytest
import torch
from skimage.color import rgb2lab

from physhdr.backend.evaluate.residuals import HEAT, heat, legend, residual
from physhdr.backend.evaluate.sheets import comparison_sheet, labelled_grid, method_sheet
from physhdr.backend.scene import Camera, read_scene
from physhdr.bridge.errors import BadValueError

CELL, GAP, MARGIN = 240, 14, 24


class Shifted:
    """The small data set's own pictures, their codes ``error`` too high."""

    lights = ("ambient",)

    def __init__(self, small: ModuleType, error: float) -> None:
        self.small, self.error = small, error

    def hdr(self, camera: Camera, lighting_level=1.0) -> torch.Tensor:
        return torch.from_numpy(self.small.radiance(round(float(camera.position[0])))).permute(2, 0, 1)

    def ldr(self, camera: Camera, exposure: float, lighting_level=1.0) -> torch.Tensor:
        code = self.small.to_8_bit(self.small.response(self.hdr(camera).numpy() * exposure)) / 255.0
        return torch.from_numpy(code * (1.0 - self.error))


def test_the_colours_brighten_evenly_with_the_error() -> None:
    lightness = rgb2lab(heat(np.linspace(0, 1, 101))[None] / 255.0)[0, :, 0]
    assert lightness[0] == 0.0 and lightness[-1] > 95.0
    assert (np.diff(lightness) > 0.3).all() and (np.diff(lightness) < 2.0).all()


def test_the_colours_are_infernos() -> None:
    theirs = 255.0 * matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3]
    assert np.abs(heat(np.linspace(0, 1, 256)) - theirs).max() < 8


def test_a_residual_is_the_worst_channel_times_the_gain() -> None:
    reference = torch.zeros(3, 2, 2)
    picture = reference.clone()
    picture[1, 0, 0], picture[2, 0, 1] = 0.025, -0.05
    picture[:, 1, 1] = 0.7
    shown = residual(picture, reference, gain=10.0)
    np.testing.assert_array_equal(shown[0, 0], HEAT[4])
    np.testing.assert_array_equal(shown[0, 1], HEAT[8])
    np.testing.assert_array_equal(shown[1, 0], [0, 0, 0])
    np.testing.assert_array_equal(shown[1, 1], HEAT[-1])


def test_the_legend_says_how_large_the_brightest_error_is() -> None:
    label, bar = legend(240, gain=8.0)
    assert label == "residual: 0 to 0.125 of white" and bar.shape == (20, 240, 3)
    np.testing.assert_array_equal(bar[0, [0, -1]], HEAT[[0, -1]])


def test_a_sheet_of_methods(data_set: Path, small: ModuleType, monkeypatch) -> None:
    rows = []

    def remember(given, title, note=""):
        rows.extend(given)
        return labelled_grid(given, title, note)

    monkeypatch.setattr("physhdr.backend.evaluate.sheets.labelled_grid", remember)
    methods = {"exact": Shifted(small, 0.0), "wrong": Shifted(small, 0.05)}
    sheet = method_sheet(methods, read_scene(data_set), poses=[1], exposure_indices=(2, 3))
    assert sheet.shape[1] == 2 * MARGIN + 3 * CELL + 2 * GAP
    labels = [[label for label, _ in row] for row in rows]
    assert [row[0] for row in labels] == [
        "test/r_1, LDR-OE, 2 s: truth",
        "residual: 0 to 0.1 of white",
        "test/r_1, LDR-NE, 8 s: truth",
        "residual: 0 to 0.1 of white",
        "test/r_1, HDR: truth",
        "residual: 0 to 0.1 of white",
    ]
    truth = read_scene(data_set).find("test", 1).image(2)
    np.testing.assert_array_equal(rows[0][0][1], truth)
    np.testing.assert_array_equal(rows[0][1][1], truth)
    assert not rows[1][1][1].any() and rows[1][2][1].any(), "the exact one's residual is black"
    wrong = np.floor(truth * 0.95 + 0.5) / 255.0 - truth / 255.0
    assert labels[0][1].startswith("exact: 100.00 dB, SSIM 1.0000")
    assert labels[0][2].startswith(f"wrong: {-10 * np.log10(np.mean(wrong**2)):.2f} dB, SSIM 0.9")
    assert labels[4][2].startswith("wrong: 100.00 dB"), "HDR is what hdr() gives"


def test_a_sheet_leaves_out_exposures_that_a_view_lacks(
    data_set: Path, small: ModuleType, monkeypatch
) -> None:
    from dataclasses import replace

    scene = read_scene(data_set)
    view = scene.find("test", 1)
    some = replace(view, exposures=view.exposures[::2], sources=view.sources[::2], bracket=(0, 2, 4))
    rows = []
    monkeypatch.setattr("physhdr.backend.evaluate.sheets.labelled_grid", lambda given, *_: rows.extend(given))
    method_sheet({"a": Shifted(small, 0.0)}, replace(scene, test=[some]), poses=[1], exposure_indices=(2, 3))
    assert [row[0][0] for row in rows[::2]] == ["test/r_1, LDR-OE, 2 s: truth", "test/r_1, HDR: truth"]


class Brighter(Shifted):
    """Right but for its scale of light, as a response without an anchor leaves it."""

    def hdr(self, camera: Camera, lighting_level=1.0) -> torch.Tensor:
        return 1.5 * super().hdr(camera)


@pytest.mark.parametrize(("scale", "rows_of_hdr"), [(1.5, 2), (1.01, 1), (None, 1), (math.nan, 1)])
def test_sheets_show_hdr_with_its_scale_aligned(
    data_set: Path, small: ModuleType, monkeypatch, scale, rows_of_hdr
) -> None:
    rows = []

    def remember(given, title, note=""):
        rows.extend(given)
        return labelled_grid(given, title, note)

    monkeypatch.setattr("physhdr.backend.evaluate.sheets.labelled_grid", remember)
    methods, scales = (
        {"exact": Shifted(small, 0.0), "bright": Brighter(small, 0.0)},
        {"exact": math.nan, "bright": scale},
    )
    method_sheet(methods, read_scene(data_set), poses=[1], exposure_indices=(), scales=scales)
    assert len(rows) == 2 * rows_of_hdr
    assert rows[1][2][1].any(), "as it is the bright one is off"
    if rows_of_hdr == 2:
        assert [label for label, _ in rows[2]] == [
            "test/r_1, HDR, scale aligned: truth",
            "exact: 100.00 dB, SSIM 1.0000",
            "bright / 1.5: 100.00 dB, SSIM 1.0000",
        ]
        assert not rows[3][1][1].any() and not rows[3][2][1].any()
    rows.clear()
    bright, scene = Brighter(small, 0.0), read_scene(data_set)
    comparison_sheet(bright, scene, [1], (), shows=lambda _: False, name="bright", scale=scale)
    assert len(rows) == rows_of_hdr + 1, "and the legend"
    assert rows[0][2][1].any()
    if rows_of_hdr == 2:
        assert [label for label, _ in rows[1]][:2] == [
            "test/r_1 HDR, scale aligned: truth",
            "bright / 1.5, 100.00 dB, SSIM 1.0000",
        ]
        assert not rows[1][2][1].any()


def test_a_sheet_of_no_methods(data_set: Path) -> None:
    with pytest.raises(BadValueError, match="at least one method"):
        method_sheet({}, read_scene(data_set))
