# SPDX-License-Identifier: GPL-3.0-or-later
"""The learned response against the true one: checks whose answers are known, and the figure."""

import json
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image

from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.evaluate.response import (
    Curve,
    check_response,
    learned_response,
    measured_response,
    stated_response,
    true_response,
    write_response_figure,
)
from physhdr.backend.optional import PackageMissingError
from physhdr.backend.scene import Camera, read_scene
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.lights import Levels

LOG_EXPOSURE = np.linspace(-8.0, 5.0, 400)


class Blind(Renderer):
    """Shows nothing: its response alone is asked for."""

    lights = ("ambient",)

    def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
        raise AssertionError

    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels = 1.0) -> torch.Tensor:
        raise AssertionError


class Learned(Blind):
    """A method whose response is the small data set's, stretched by ``scale`` along its axis."""

    def __init__(self, small: ModuleType, scale: float = 1.0, ripple: float = 0.0) -> None:
        x = torch.from_numpy(LOG_EXPOSURE)
        code = torch.from_numpy(small.response(np.exp(LOG_EXPOSURE) / scale))[:, None].repeat(1, 3)
        code[:, 1] += ripple * torch.sin(20.0 * x)
        self.curve = x, code

    def response_curve(self) -> tuple[torch.Tensor, torch.Tensor]:
        return self.curve


def check_of(method: Learned, root: Path):
    learned, scene = learned_response(method), read_scene(root)
    assert learned is not None
    return check_response(learned, true_response(scene, learned))


def test_the_right_curve_has_nothing_wrong_with_it(small: ModuleType, data_set: Path) -> None:
    check = check_of(Learned(small), data_set)
    assert check.is_monotonic and check.scale == pytest.approx(1.0, abs=1e-6)
    assert check.largest_error == pytest.approx(0.0, abs=1e-6)


def test_a_curve_at_another_scale_is_found_to_be(small: ModuleType, data_set: Path) -> None:
    """f(x / 1.2): every code is reached at 1.2 times the exposure; the error is that of the closed form."""
    check = check_of(Learned(small, scale=1.2), data_set)
    assert check.is_monotonic and check.scale == pytest.approx(1.2, rel=1e-3)
    x = np.exp(LOG_EXPOSURE)
    errors = 255.0 * np.abs(small.response(x / 1.2) - small.response(x))
    assert check.largest_error == pytest.approx(errors.max(), rel=1e-6)


def test_a_curve_that_falls_is_found_to(small: ModuleType, data_set: Path) -> None:
    check = check_of(Learned(small, ripple=0.05), data_set)
    code = Learned(small, ripple=0.05).curve[1][:, 1].numpy()
    worst = max(code[:i].max() - code[i] for i in range(1, len(code)))
    assert not check.is_monotonic and check.largest_fall == pytest.approx(255.0 * worst)
    assert "FALLS" in str(check)


def test_a_collapsed_curve_has_an_error_but_no_scale(small: ModuleType, data_set: Path) -> None:
    method = Learned(small)
    method.curve = method.curve[0], torch.full_like(method.curve[1], 0.5)
    check = check_of(method, data_set)
    assert check.rms_error is not None and check.rms_error > 50 and check.scale is None
    assert str(check).endswith("exposure scale not measurable")


def test_the_data_show_their_response(small: ModuleType, data_set: Path) -> None:
    """Within one step of 8 bit and what the curve rises over half a bin (⅛ stop)."""
    curve = measured_response(read_scene(data_set))
    assert curve is not None and len(curve.exposure) > 30
    known = np.isfinite(curve.code)
    true = small.response(curve.exposure)[:, None] * np.ones(3)
    rise = small.response(curve.exposure * 2**0.125) - small.response(curve.exposure)
    assert (np.abs(curve.code - true)[known] < (rise[:, None] + 1.5 / 255.0 + 0 * true)[known]).all()


def test_where_the_true_response_comes_from(small: ModuleType, data_set: Path) -> None:
    learned = learned_response(Learned(small))
    assert learned is not None
    stated = true_response(read_scene(data_set), learned)
    assert stated is not None and stated.exposure is learned.exposure
    path = data_set / "dataset.json"
    info = json.loads(path.read_text())
    path.write_text(
        json.dumps(info | {"camera_model": {"local_response": 0.7}})
    )  # one curve is not all of it
    measured = true_response(read_scene(data_set), learned)
    assert measured is not None and len(measured.exposure) < 130
    shutil.rmtree(data_set / "test_hdr")
    assert true_response(read_scene(data_set), learned) is None
    check = check_response(learned, None)
    assert check.scale is None and check.is_monotonic and "unknown" in str(check)


@pytest.mark.parametrize(
    "camera",
    [
        {"vignetting": 1.0},
        {"iso": 25600.0, "sensor": {"saturation": 4.0}, "held_out": "nothing drawn"},
        {"white_balance_jitter": 0.1, "exposure_jitter": 0.1},
    ],
)
def test_faults_before_the_response_are_no_error_of_it(camera, small: ModuleType, data_set: Path) -> None:
    """The right curve, learned of pictures whose corners are three stops darker than their radiance."""
    path = data_set / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"camera_model": camera}))
    for view in read_scene(data_set).test:
        for k, exposure in enumerate(view.exposures):
            light = small.radiance(view.index) * exposure
            light[::2] *= 2.0**-3
            Image.fromarray(small.to_8_bit(small.response(light))).save(view.sources[k].path)
    check = check_of(Learned(small), data_set)
    assert check.largest_error == pytest.approx(0.0, abs=1e-6)


def test_stated_responses() -> None:
    x = np.array([0.0, 0.002, 0.5, 1.0, 4.0])
    srgb = stated_response({"response": {"name": "srgb"}})
    assert srgb is not None
    np.testing.assert_allclose(srgb(x), [0.0, 12.92 * 0.002, 0.735357, 1.0, 1.0], atol=1e-6)
    points = stated_response({"response": {"name": "file", "curve": [[0.0, 0.0], [1.0, 0.5], [3.0, 1.0]]}})
    assert points is not None
    np.testing.assert_allclose(points(x), [0.0, 0.001, 0.25, 0.5, 1.0])
    begins_late = stated_response({"response": {"name": "file", "curve": [[0.2, 0.1], [1.0, 1.0]]}})
    assert begins_late is not None and begins_late(np.array([0.0, 0.1])) == pytest.approx([0.0, 0.05])
    assert stated_response({"response": {"name": "filmic", "curve": None}}) is None
    assert stated_response({}) is None and stated_response({"response": {"name": "filmic"}}) is None


@pytest.mark.parametrize(
    "points",
    ["abc", 3, [], [[0, 0], [1]], [["a", 0], [1, 1]], [[0, 0, 0], [1, 1, 1]], [[0, 0], [float("nan"), 1]]]
    + [[[0, 0], [2, 1], [1, 0.5]], [[0, 0], [1, 0.5], [1, 1]], [[0, 0], [10**400, 1]]],
)
def test_stated_curves_that_are_none(points) -> None:
    with pytest.raises(BadValueError, match=r"'curve' in dataset\.json is not a list of") as caught:
        stated_response({"response": {"name": "file", "curve": points}})
    assert "remove 'curve'" in caught.value.hint


@pytest.mark.parametrize(
    "curve",
    [
        (torch.zeros(3), torch.zeros(3, 3)),
        (torch.arange(3.0), torch.zeros(3, 1)),
        (torch.arange(3.0), torch.full((3, 3), torch.nan)),
    ],
)
def test_curves_that_are_none(curve) -> None:
    class Wrong(Blind):
        def response_curve(self):
            return curve

    with pytest.raises(BadValueError, match="a response curve must be finite"):
        learned_response(Wrong())


def test_methods_that_learn_no_response(small: ModuleType) -> None:
    class Given(Learned):
        learns_response = False

    assert learned_response(Blind()) is None and learned_response(Given(small)) is None


def test_the_figure_shows_curve_and_anchor(small: ModuleType, data_set: Path, tmp_path: Path) -> None:
    path = tmp_path / "out" / "response.png"
    learned = learned_response(Learned(small, scale=1.5))
    assert learned is not None
    check = write_response_figure(path, learned, read_scene(data_set))
    assert check.scale == pytest.approx(1.5, rel=1e-3)
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert min(picture.shape[:2]) > 500

    def pixels_like(colour: tuple[int, int, int]) -> int:
        return int((np.abs(picture - colour).max(axis=2) < 12).sum())

    assert pixels_like((0x2B, 0x5F, 0xC0)) > 500, "blue, drawn last, covers the other two"
    assert pixels_like((0xE0, 0xA0, 0x00)) > 150, "two stars: in the plot, in the legend"
    write_response_figure(path, Curve(learned.exposure, learned.code), read_scene(data_set))


def test_without_matplotlib_there_is_one_clear_message(small, data_set, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    learned = learned_response(Learned(small))
    assert learned is not None
    with pytest.raises(PackageMissingError, match=r"needs matplotlib[\s\S]*pip install matplotlib"):
        write_response_figure(tmp_path / "response.png", learned, read_scene(data_set))
