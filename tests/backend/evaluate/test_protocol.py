# SPDX-License-Identifier: GPL-3.0-or-later
"""The protocol with renderers whose errors are known."""

import csv
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import cast

import numpy as np
import pytest
import torch
from PIL import Image
from rich.console import Console

from physhdr.backend.evaluate import protocol, sheets, truth
from physhdr.backend.evaluate.lpips import SMALLEST_SIDE, Lpips
from physhdr.backend.evaluate.protocol import evaluate, lpips_from
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.evaluate.report import to_dict, to_markdown, to_terminal, write_report
from physhdr.backend.evaluate.results import Evaluation, HdrRow, LdrRow, Metrics
from physhdr.backend.evaluate.sheets import comparison_sheet, labelled_grid
from physhdr.backend.scene import Camera, Scene, read_scene
from physhdr.bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    OutputError,
)
from physhdr.bridge.lights import Levels, as_levels

#: As in test_metrics.py.
LPIPS_WEIGHTS = Path(os.environ.get("PHYSHDR_LPIPS_FOLDER", "lpips")) / "lpips_alex_v0.1_float32.npz"


class Oracle(Renderer):
    """Renders the small data set's own radiance, ``scale`` times too bright; ``relights`` or scales.

    ``lights``: those that it has levels for, of ambient and lamp. ``rendered``: how many HDR pictures so far.
    """

    def __init__(
        self,
        small: ModuleType,
        scale: float = 1.0,
        relights: bool = True,
        lights: tuple[str, ...] = ("ambient",),
    ) -> None:
        self.small, self.scale, self.relights, self.lights = small, scale, relights, lights
        self.rendered = 0

    def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
        index = round(float(camera.position[0]))
        self.rendered += 1
        named = dict(zip(self.lights, as_levels(lighting_level, self.lights), strict=True))
        lighting_level, lamp = named.get("ambient", 1.0), named.get("lamp", 1.0)
        if lamp != 1.0:
            light = self.small.radiance(index, lighting_level, lamp)
            return torch.from_numpy(np.float32(self.scale) * light).permute(2, 0, 1)
        light = self.small.radiance(index, lighting_level if self.relights else 1.0)
        light = light * (1.0 if self.relights else lighting_level)
        return torch.from_numpy(np.float32(self.scale) * light).permute(2, 0, 1)

    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels = 1.0) -> torch.Tensor:
        light = self.hdr(camera, lighting_level) / self.scale * exposure
        return torch.from_numpy(self.small.response(light.numpy()))


def mu_psnr(small: ModuleType, prediction: np.ndarray, truth: np.ndarray) -> float:
    """The HDR protocol once more, in numpy, from the words of ``hdr_pair``."""

    def shown(radiance: np.ndarray) -> np.ndarray:
        share = np.clip(radiance.astype(np.float64) / truth.max(), 0, 1)
        return small.to_8_bit(np.log(1 + 5000 * share) / np.log(5001)).astype(np.float64) / 255

    return -10 * np.log10(np.mean((shown(prediction) - shown(truth)) ** 2))


def test_a_perfect_renderer(data_set: Path, small: ModuleType) -> None:
    result = evaluate(Oracle(small), read_scene(data_set), exposure_mode="exp3")
    assert len(result.ldr) == 2 * 5 and len(result.hdr) == 2 and len(result.relit) == 2
    assert result.ldr_oe is not None and result.ldr_oe.psnr > 60 and result.ldr_oe.ssim > 0.9999
    assert result.hdr_mean is not None and result.hdr_mean.psnr == 100.0
    assert result.scale_ratio == pytest.approx(1.0)
    without_lpips, capped = result.messages
    assert without_lpips == "LPIPS left out: no weights were given."
    assert capped.startswith(
        "PSNR is capped at 100 dB, which was reached in LDR; HDR; HDR, scale aligned; relit:"
    )


def test_one_exact_picture_does_not_take_the_mean_away(
    data_set: Path, small: ModuleType, tmp_path: Path
) -> None:
    class ExactOnce(Oracle):
        def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
            exact = round(float(camera.position[0])) == 1
            return super().hdr(camera, lighting_level) * (1.0 if exact else 1.1)

    result = evaluate(ExactOnce(small), read_scene(data_set))
    exact, other = (row.metrics.psnr for row in result.hdr)
    assert exact == 100.0 and 36 < other < 42
    write_report(result, tmp_path / "run")
    means = json.loads((tmp_path / "run" / "evaluation.json").read_text())["means"]
    assert means["HDR"]["psnr"] == pytest.approx((100.0 + other) / 2)
    assert any("capped at 100 dB" in message for message in result.messages)
    far = evaluate(Oracle(small, scale=1.1), read_scene(data_set))
    assert not any("relit" in message or "HDR;" in message for message in far.messages)


@pytest.mark.parametrize(
    ("training", "said"),
    [
        ((0, 2, 4), []),
        (
            (0, 1, 2, 3, 4),
            [
                "LDR-NE is not of novel exposures: training saw index 1 and 3 "
                "(--training-exposures 0 1 2 3 4)."
            ],
        ),
        (
            (0, 3, 4),
            [
                "LDR-NE is not of novel exposures: training saw index 3 (--training-exposures 0 3 4).",
                "LDR-OE is not of observed exposures: training did not see index 2 "
                "(--training-exposures 0 3 4).",
            ],
        ),
    ],
)
def test_parts_that_are_not_what_they_are_called_are_told(data_set: Path, small, training, said) -> None:
    result = evaluate(Oracle(small), read_scene(data_set), training_exposures=training)
    assert [message for message in result.messages if message.startswith("LDR-")] == said
    assert all(message in to_markdown(result) for message in said)


def test_an_interrupted_training_is_told_and_written(data_set: Path, small: ModuleType) -> None:
    result = evaluate(Oracle(small), read_scene(data_set), iteration=500, iterations=1000)
    assert "The training is not complete: 500 of 1000 iterations." in result.messages
    conditions = to_dict(result)["conditions"]
    assert (conditions["iteration"], conditions["iterations"]) == (500, 1000)
    result = evaluate(Oracle(small), read_scene(data_set), iteration=1000, iterations=1000)
    assert not any("iterations" in message for message in result.messages)


@pytest.mark.parametrize("curve", [[[0, 0], [1]], [["dark", 0], [1, 1]], [[0, 0], [2, 1], [1, 0.5]]])
def test_a_stated_curve_that_is_none_is_found_before_rendering(data_set: Path, small, curve) -> None:
    class Knows(Oracle):
        def response_curve(self):
            return torch.linspace(-6, 6, 50), torch.linspace(0, 1, 50)[:, None].expand(-1, 3)

    path = data_set / "dataset.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps(info | {"response": {"name": "file", "curve": curve}}))
    method = Knows(small)
    with pytest.raises(BadValueError, match=r"'curve' in dataset\.json is not a list of"):
        evaluate(method, read_scene(data_set))
    assert method.rendered == 0


def test_hdr_psnr_and_scale_of_a_renderer_that_is_too_bright(data_set: Path, small: ModuleType) -> None:
    result = evaluate(Oracle(small, scale=1.1), read_scene(data_set))
    assert result.scale_ratio == pytest.approx(1.1, rel=1e-5)
    for row in result.hdr:
        truth = small.radiance(row.index)
        assert row.normaliser == pytest.approx(truth.max())
        assert row.metrics.psnr == pytest.approx(mu_psnr(small, np.float32(1.1) * truth, truth), abs=0.05)
        assert row.aligned.psnr > 55
    assert result.hdr_mean is not None and 36 < result.hdr_mean.psnr < 42


def test_relighting_is_judged_beside_scaling(data_set: Path, small: ModuleType) -> None:
    result = evaluate(Oracle(small, scale=1.02), read_scene(data_set))
    assert result.relit_conditions == ["ambient 0.25", "ambient 4"]
    for row in result.relit:
        level = row.levels["ambient"]
        truth, standard = small.radiance(3, level), small.radiance(3)
        scaled = mu_psnr(small, np.float32(level) * standard, truth)
        assert row.index == 3 and row.factor == level
        best = float(np.median(truth / standard))
        assert row.best_factor == pytest.approx(best, rel=1e-3)
        assert row.best_scaled_truth == pytest.approx(
            mu_psnr(small, np.float32(best) * standard, truth), abs=0.05
        )
        assert row.scaled_truth == pytest.approx(scaled, abs=0.02)
        assert row.scaled_ours == pytest.approx(
            mu_psnr(small, np.float32(1.02 * level) * standard, truth), abs=0.02
        )
        assert row.gain_over_scaled_truth == pytest.approx(row.ours - scaled, abs=0.02)
        assert row.gain_over_scaled_truth > 6
        assert row.scale_ratio == pytest.approx(1.02, rel=1e-5)
    mean = result.relit_mean()
    assert mean is not None
    assert mean.gain_over_scaled_truth == pytest.approx(
        np.mean([row.gain_over_scaled_truth for row in result.relit])
    )


def test_a_renderer_that_only_scales_gains_nothing(data_set: Path, small: ModuleType) -> None:
    result = evaluate(Oracle(small, relights=False), read_scene(data_set))
    mean = result.relit_mean()
    assert mean is not None
    assert mean.gain_over_scaled_truth == pytest.approx(0.0, abs=1e-6)
    assert mean.gain_over_scaled_ours == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("left", [0.0, 0.03])
def test_what_remains_of_a_light_that_is_off(data_set: Path, small: ModuleType, left: float) -> None:
    list_relit(data_set, small, [{"lamp": 0.0}, {"lamp": 4.0}])

    class Leaks(Oracle):
        def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
            levels = as_levels(lighting_level, self.lights)
            return super().hdr(camera, tuple(max(level, left) for level in levels))

    result = evaluate(Leaks(small, lights=("ambient", "lamp")), read_scene(data_set))
    means = [result.relit_mean(condition) for condition in ("lamp 0", "lamp 4")]
    assert means[0] is not None and means[0].light_left == pytest.approx(left, abs=1e-4)
    assert means[1] is not None and means[1].light_left is None
    assert f"| {left:+.1%} |" in to_markdown(result)


def list_relit(root: Path, small: ModuleType, conditions: list[dict[str, float]], poses=(1, 3)) -> None:
    """Relit truth of both test views, listed in ``dataset.json`` as data sets with several lights do."""
    shutil.rmtree(root / "relit")
    listed = []
    for levels in conditions:
        folder = "relit/" + "+".join(f"{name}_{level:g}" for name, level in levels.items())
        listed.append({"folder": folder, "levels": levels})
        for pose in poses:
            picture = small.radiance(pose, levels.get("ambient", 1.0), levels.get("lamp", 1.0))
            small.write_exr(root / folder / f"hdr_{pose:03d}.exr", picture)
    path = root / "dataset.json"
    info = json.loads(path.read_text()) | {"lights": ["ambient", "lamp", "screen"], "relit": listed}
    path.write_text(json.dumps(info))


def test_several_lights(data_set: Path, small: ModuleType) -> None:
    conditions = [{"ambient": 4.0, "lamp": 0.25}, {"lamp": 4.0}, {"ambient": 0.0}, {"lamp": 0.0}]
    conditions += [{"ambient": 2.0, "lamp": 1.0}]
    list_relit(data_set, small, conditions)
    oracle = Oracle(small, scale=1.02, lights=("ambient", "lamp"))
    result = evaluate(oracle, read_scene(data_set))
    expected = ["ambient 4 + lamp 0.25", "lamp 4", "ambient 0", "lamp 0", "ambient 2 + lamp 1"]
    assert result.relit_conditions == expected and len(result.relit) == 10
    ldr, standard = 2 * 5, 2
    assert oracle.rendered == ldr + standard + len(result.relit)  # the standard light is rendered once a view
    for row in result.relit:
        truth = small.radiance(row.index, row.levels.get("ambient", 1.0), row.levels.get("lamp", 1.0))
        standard = small.radiance(row.index)
        assert row.ours > 40 and row.scale_ratio == pytest.approx(1.02, rel=1e-4)
        factor = {"lamp 4": 4.0, "ambient 2 + lamp 1": 2.0}.get(row.condition, row.best_factor)
        assert row.factor == factor
        scaled = mu_psnr(small, np.float32(factor) * standard, truth)
        assert row.scaled_truth == pytest.approx(scaled, abs=0.05)
        # The median's factor is as good as any, but for a little where it is not the level.
        others = [mu_psnr(small, np.float32(f) * standard, truth) for f in np.geomspace(1 / 64, 64, 25)]
        assert row.best_scaled_truth > max(others) - 3.0
    content = to_dict(result)
    assert set(content["relit_means"]) == {*expected, "all"}
    assert content["relit"][0]["levels"] == {"ambient": 4.0, "lamp": 0.25}
    json.dumps(content, allow_nan=False)
    assert "| ambient 4 + lamp 0.25 |" in to_markdown(result)
    assert comparison_sheet(oracle, read_scene(data_set)).shape[2] == 3


def test_a_perfect_renderer_of_half_the_size(
    data_set: Path, small: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light adds up over a pixel's area. What is compared beside the model has the same ceiling as it."""
    sharp = {k: np.random.default_rng(k).lognormal(0.0, 2.0, (36, 48, 3)).astype(np.float32) for k in (1, 3)}
    for k, picture in sharp.items():
        small.write_exr(data_set / "test_hdr" / f"hdr_{k:03d}.exr", picture)
    small.write_exr(data_set / "relit" / "level_4" / "hdr_003.exr", 4.0 * sharp[3])

    class Smaller(Oracle):
        def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
            (level,) = as_levels(lighting_level, self.lights)
            picture = sharp[round(float(camera.position[0]))].reshape(18, 2, 24, 2, 3).mean((1, 3))
            return torch.from_numpy(np.float32(level) * picture).permute(2, 0, 1)

    scene, renderer = read_scene(data_set, 2.0), Smaller(small)
    result = evaluate(renderer, scene)
    assert all(row.metrics.psnr > 80 and row.aligned.psnr > 80 for row in result.hdr)
    assert result.scale_ratio == pytest.approx(1.0)
    (relit,) = (row for row in result.relit if row.levels == {"ambient": 4.0})
    assert min(relit.ours, relit.scaled_truth, relit.scaled_ours) > 80 and relit.best_factor == 4.0
    true = truth.hdr_truth(data_set, "test", 3)
    assert sheets._hdr(renderer, scene.find("test", 3), 1.0, true).psnr > 80

    # The figures of a published benchmark are of truth that was μ-law'd and then resized.
    monkeypatch.setattr(protocol, "data_set_of", lambda scene: "HDR-NeRF-Syn")
    assert all(row.metrics.psnr < 40 and row.aligned.psnr < 40 for row in evaluate(renderer, scene).hdr)


def masked(scene: Scene, hidden: dict[int, np.ndarray], folder: Path) -> Scene:
    """``scene`` whose test pictures have masks: by pose, the pixels that they hide."""
    views = []
    for view in scene.test:
        path = folder / f"mask_{view.index}.png"
        folder.mkdir(exist_ok=True)
        Image.fromarray(np.where(hidden[view.index], 0, 255).astype(np.uint8)).save(path)
        views.append(replace(view, sources=tuple(replace(each, mask_path=path) for each in view.sources)))
    return replace(scene, test=views)


def test_radiance_is_not_compared_where_the_views_pictures_are_masked(
    data_set: Path, small: ModuleType, tmp_path: Path
) -> None:
    """A model that is right where anything is compared: no number knows what it shows elsewhere."""

    class RightOnTheRight(Oracle):
        def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
            picture = super().hdr(camera, lighting_level).clone()
            picture[..., : 3 * camera.width // 4] *= 8.0
            return picture

    scene = read_scene(data_set)
    whole = scene.test[0].camera
    hidden = np.zeros((whole.height, whole.width), bool)
    hidden[:, : 3 * whole.width // 4] = True
    renderer = RightOnTheRight(small)
    assert evaluate(renderer, scene).scale_ratio == pytest.approx(8.0)
    of_all = masked(scene, {view.index: hidden for view in scene.test}, tmp_path / "all")
    result = evaluate(renderer, of_all)
    assert [row.metrics.psnr for row in result.hdr] == [row.aligned.psnr for row in result.hdr] == [100.0] * 2
    assert result.scale_ratio == pytest.approx(1.0)
    assert [(row.ours, row.scale_ratio) for row in result.relit] == [(100.0, pytest.approx(1.0))] * 2
    shown = sheets._hdr(
        renderer, of_all.test[0], 1.0, truth.hdr_truth(data_set, "test", of_all.test[0].index)
    )
    assert shown.psnr == 100.0 and not shown.reference[:, hidden].any()

    first, second = (view.index for view in scene.test)
    of_one = masked(scene, {first: np.ones_like(hidden), second: hidden}, tmp_path / "one")
    result = evaluate(renderer, of_one)
    assert [row.index for row in result.hdr] == [second], "a view that is masked altogether has no number"
    everything = dict.fromkeys((first, second), np.ones_like(hidden))
    of_none = masked(scene, everything, tmp_path / "none")
    none = evaluate(renderer, of_none)
    assert (none.hdr, none.relit, none.scale_ratio) == ([], [], None)
    of_relit = truth.relit_truth(data_set)
    assert of_relit[0].index == second
    only_first = masked(scene, {first: hidden, second: everything[second]}, tmp_path / "first")
    assert sheets._poses(only_first, "test", None, of_relit) == [first]
    assert sheets._poses(of_none, "test", None, of_relit) == [second]
    nothing = sheets._ldr(renderer, of_none.test[0], 0, None)
    assert sheets._numbers(nothing) == "masked, not compared" and not nothing.reference.any()


def test_a_view_of_which_only_black_is_compared_leaves_the_scale_to_the_others(
    data_set: Path, small: ModuleType, tmp_path: Path
) -> None:
    """It has no ratio: the others' is the common one, and its own numbers are of black beside black."""
    scene = read_scene(data_set)
    first, second = (view.index for view in scene.test)
    alone = replace(scene, test=scene.test[1:])
    expected = evaluate(Oracle(small, scale=1.5), alone)
    path = truth.hdr_truth_path(data_set, "test", first)
    radiance = small.radiance(first)
    radiance[:, :8] = 0.0
    small.write_exr(path, radiance)
    hidden = np.ones(radiance.shape[:2], bool)
    hidden[:, :8] = False
    of_black = masked(scene, {first: hidden, second: np.zeros_like(hidden)}, tmp_path)
    result = evaluate(Oracle(small, scale=1.5), of_black)
    assert result.scale_ratio == pytest.approx(1.5) == expected.scale_ratio
    assert np.isnan(result.hdr[0].scale_ratio) and result.hdr[1].aligned == expected.hdr[0].aligned
    name = scene.test[0].name
    assert any(f"the truth of {name} is black wherever it is compared" in said for said in result.messages)
    assert "HDR scale ratio (median of prediction / truth, median over views): 1.5000" in to_markdown(result)
    of_relit = [number for row in result.relit for number in (row.scaled_truth, row.best_scaled_truth)]
    assert len(of_relit) == 4 and np.isfinite(of_relit).all() and max(of_relit) < 100.0


def test_other_light_in_which_a_view_is_black_ends_no_evaluation(data_set: Path, small: ModuleType) -> None:
    """Where every light is off nothing can be compared: the other pictures are."""
    path = data_set / "relit" / f"level_{small.RELIT_LEVELS[0]:g}" / "hdr_003.exr"
    small.write_exr(path, np.zeros_like(small.radiance(3)))
    result = evaluate(Oracle(small), read_scene(data_set))
    assert len(result.relit) == 1 and len(result.hdr) == 2
    (said,) = (message for message in result.messages if message.startswith("Relit"))
    assert said == f"Relit ambient {small.RELIT_LEVELS[0]:g} of test/r_3 left out: its truth is black."
    assert comparison_sheet(Oracle(small), read_scene(data_set)).dtype == np.uint8


def test_lights_that_the_model_does_not_know_are_left_out(data_set: Path, small: ModuleType) -> None:
    list_relit(data_set, small, [{"ambient": 4.0, "lamp": 0.25}, {"ambient": 0.25}])
    result = evaluate(Oracle(small), read_scene(data_set))
    assert result.relit_conditions == ["ambient 0.25"]
    assert any("no level for a light of it: ambient 4 + lamp 0.25." in line for line in result.messages)
    assert comparison_sheet(Oracle(small), read_scene(data_set)).shape[2] == 3


@pytest.mark.parametrize(
    ("relit", "kind", "message"),
    [
        ({"ambient": 4}, BadValueError, "'relit' is a dict"),
        ([{"folder": "relit/level_4"}], BadValueError, "relit 0 is"),
        ([{"folder": "relit/level_4", "levels": {}}], BadValueError, "relit 0 is"),
        ([{"folder": "../other", "levels": {"ambient": 4}}], BadValueError, "not in the data set"),
        ([{"folder": "relit/level_4", "levels": {"sun": 4}}], BadValueError, "no light 'sun'"),
        ([{"folder": "relit/level_4", "levels": {"ambient": -1}}], BadValueError, "0 or more"),
        ([{"folder": "relit/level_4", "levels": {"ambient": "4"}}], BadValueError, "0 or more"),
        ([{"folder": "relit/level_9", "levels": {"ambient": 9}}], FileMissingError, "level_9, listed in"),
        ([{"folder": "relit/level_4", "levels": {"ambient": "x" * 5000}}], BadValueError, "0 or more"),
        ([{"folder": "relit/level_4", "levels": {"ambient": 10**400}}], BadValueError, "0 or more"),
        ([{"folder": "x" * 5000, "levels": {"ambient": 4}}], FileMissingError, "xx, listed in"),
        (["x" * 5000], BadValueError, "relit 0 is"),
    ],
)
def test_lists_of_relit_truth_that_mean_nothing(data_set: Path, small, relit, kind, message) -> None:
    path = data_set / "dataset.json"
    path.write_text(
        json.dumps(json.loads(path.read_text()) | {"lights": ["ambient", "lamp"], "relit": relit})
    )
    with pytest.raises(kind, match=message) as caught:
        evaluate(Oracle(small), read_scene(data_set))
    assert caught.value.hint and len(caught.value.message) < 1000


def test_missing_exposures_keep_their_place_in_the_bracket(data_set: Path, small: ModuleType) -> None:
    """A view with brackets 0 and 3 alone (GaussHDR's packaging) counts for OE and NE, not for 0 and 1."""
    scene = read_scene(data_set)
    first, second = scene.test
    some = replace(
        first,
        exposures=(first.exposures[0], first.exposures[3]),
        sources=(first.sources[0], first.sources[3]),
        bracket=(0, 3),
    )
    result = evaluate(Oracle(small), replace(scene, test=[some, second]))
    rows = [(row.index, row.exposure_index, row.exposure) for row in result.ldr]
    assert rows[:2] == [(first.index, 0, 0.125), (first.index, 3, 8.0)] and len(rows) == 7
    assert [(each.exposure_index, each.part, each.views) for each in result.exposures] == [
        (0, "LDR-OE", 2),
        (1, "LDR-NE", 1),
        (2, "LDR-OE", 1),
        (3, "LDR-NE", 2),
        (4, "LDR-OE", 1),
    ]
    assert result.ldr_oe is not None and result.ldr_oe.psnr > 50


def test_means_of_exposures_and_views() -> None:
    rows = [LdrRow(f"r_{i}", i, k, 2.0**k, Metrics(10.0 * k + i, 0.1 * k)) for i in (0, 1) for k in range(5)]
    hdr = [HdrRow("r_1", 1, 8.0, 1.25, Metrics(33.0, 0.9), Metrics(34.0, 0.9))]
    result = Evaluation("s", "test", "exp3", (8, 8), rows, hdr, [])
    assert [(each.exposure, each.metrics.psnr) for each in result.exposures] == [
        (2.0**k, 10.0 * k + 0.5) for k in range(5)
    ]
    first, second = result.views
    assert first.ldr_oe == Metrics(pytest.approx(20.0), pytest.approx(0.2)) and first.hdr is None
    assert second.ldr_ne is not None and second.ldr_ne.psnr == 21.0
    assert second.hdr is not None and (second.hdr.psnr, second.scale_ratio) == (33.0, 1.25)
    text, content = to_markdown(result), to_dict(result)
    assert "| 3: 8 s | LDR-NE | 30.50 | 0.3000 | – | – |" in text
    assert "| r_1 | 21.00 | 21.00 | 33.00 | 0.2000 | 0.2000 | 0.9000 | 1.250 |" in text
    assert content["exposures"][4]["metrics"]["psnr"] == 40.5 and content["views"][0]["hdr"] is None


def test_of_longer_brackets_no_exposure_is_left_out() -> None:
    """Seven, as a camera takes them: 0, 2, 4, 6 and 1, 3, 5."""
    rows = [LdrRow("r_0", 0, k, 2.0**k, Metrics(10.0 * k, 0.1 * k)) for k in range(7)]
    result = Evaluation("s", "test", "exp3", (8, 8), rows, [], [], training_exposures=tuple(range(7)))
    assert result.ldr_oe is not None and result.ldr_oe.psnr == pytest.approx(10.0 * (0 + 2 + 4 + 6) / 4)
    assert result.ldr_ne is not None and result.ldr_ne.psnr == pytest.approx(10.0 * (1 + 3 + 5) / 3)
    (view,) = result.views
    assert (view.ldr_oe, view.ldr_ne) == (result.ldr_oe, result.ldr_ne)
    assert "LDR-OE: exposure indices 0, 2, 4, 6; LDR-NE: 1, 3, 5;" in to_markdown(result)
    assert to_dict(result)["conditions"]["ldr_ne_exposure_indices"] == [1, 3, 5]


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (None, "exposure mode exp3"),
        ((0, 2, 4), "exposure mode exp3"),
        ((0, 1, 2), "exposure mode exp3, of exposure indices 0, 1, 2"),
        ((0,), "trained on one exposure a view, index 0"),
    ],
)
def test_which_exposures_were_trained_on_is_told(seen, said: str) -> None:
    rows = [LdrRow("r_0", 0, 0, 1.0, Metrics(10.0, 0.1))]
    result = Evaluation("s", "test", "exp3", (8, 8), rows, [], [], training_exposures=seen)
    assert f"; {said}; every picture through 8 bit" in to_markdown(result)


def test_lpips_is_left_out_where_any_picture_is_too_small(data_set: Path, small: ModuleType) -> None:
    """Not by the size of the first view alone, whose network fails at a smaller one after it."""
    scene = read_scene(data_set)
    first, second = scene.test
    tiny = replace(second, camera=replace(second.camera, width=SMALLEST_SIDE - 1))
    assert min(first.camera.width, first.camera.height) >= SMALLEST_SIDE
    given = cast(Lpips, object())
    for views, left_out in (([first, second], False), ([first, tiny], True), ([tiny, first], True)):
        said = protocol._skipped(replace(scene, test=views), "test", given, False, [], [], "")
        assert any(line.startswith("LPIPS left out: there are") for line in said) == left_out


def test_a_bracket_is_rendered_at_once_where_the_method_can(data_set: Path, small: ModuleType) -> None:
    class Together(Oracle):
        asked = 0

        def ldr_bracket(self, camera, exposures, lighting_level=1.0):
            Together.asked += 1
            return [super(Together, self).ldr(camera, t, lighting_level) for t in exposures]

        def ldr(self, *_):
            raise AssertionError("one by one")

    together = evaluate(Together(small), read_scene(data_set))
    assert together.ldr == evaluate(Oracle(small), read_scene(data_set)).ldr and Together.asked == 2


def test_the_response_of_the_method_is_checked(data_set: Path, small: ModuleType) -> None:
    class Knows(Oracle):
        def response_curve(self):
            x = torch.linspace(-6, 6, 50)
            return x, torch.from_numpy(small.response(x.exp().numpy() / 1.1))[:, None].expand(-1, 3)

    result = evaluate(Knows(small), read_scene(data_set))
    assert result.response is not None and result.response.scale == pytest.approx(1.1, rel=5e-3)
    assert to_dict(result)["response"]["largest_fall"] == 0.0 and "response: rises" in to_markdown(result)


def test_oe_and_ne_average_each_exposure_first() -> None:
    rows = [LdrRow(f"r_{i}", i, k, 2.0**k, Metrics(10.0 * k + i, 0.1 * k)) for i in (0, 1) for k in range(5)]
    result = Evaluation("s", "test", "exp3", (8, 8), rows, [], [])
    assert result.ldr_oe == Metrics(pytest.approx(20.5), pytest.approx(0.2))
    assert result.ldr_ne == Metrics(pytest.approx(20.5), pytest.approx(0.2))
    only_first = [row for row in rows if row.exposure_index < 2]
    result = Evaluation("s", "test", "exp3", (8, 8), only_first, [], [])
    assert result.ldr_oe == Metrics(pytest.approx(0.5), 0.0)
    assert result.ldr_ne == Metrics(pytest.approx(10.5), pytest.approx(0.1))


@pytest.mark.skipif(not LPIPS_WEIGHTS.is_file(), reason="PHYSHDR_LPIPS_FOLDER names none")
def test_lpips_is_in_every_row_where_weights_are_given(data_set: Path, small: ModuleType) -> None:
    result = evaluate(Oracle(small, scale=1.5), read_scene(data_set), lpips=lpips_from(LPIPS_WEIGHTS))
    assert not any("LPIPS" in message for message in result.messages)
    assert result.hdr_mean is not None and result.ldr_oe is not None
    assert result.hdr_mean.lpips is not None and result.hdr_mean.lpips_01 is not None
    assert result.hdr_mean.lpips > 1e-4 and result.ldr_oe.lpips is not None


def test_without_truth_parts_are_absent_with_a_message(small: ModuleType, tmp_path: Path) -> None:
    root = small.write_data_set(tmp_path / "dog", original=True)
    result = evaluate(Oracle(small), read_scene(root))
    assert result.hdr and not result.relit
    assert any("Relit left out" in message for message in result.messages)
    shutil.rmtree(root / "test_hdr")
    result = evaluate(Oracle(small), read_scene(root))
    assert not result.hdr and result.ldr and result.scale_ratio is None and result.hdr_mean is None
    assert any("HDR and relit left out" in said and "true radiance" in said for said in result.messages)
    assert "HDR" not in to_markdown(result).split("\n\n")[0]


def test_progress_counts_to_the_end(data_set: Path, small: ModuleType) -> None:
    seen: list[tuple[int, int, str]] = []
    evaluate(Oracle(small), read_scene(data_set), progress=lambda *step: seen.append(step))
    assert [done for done, _, _ in seen] == list(range(7))
    assert {total for _, total, _ in seen} == {6} and seen[-1][2] == "done"


# ---- reports -----------------------------------------------------------------------------------------


def test_reports(data_set: Path, small: ModuleType, tmp_path: Path) -> None:
    result = evaluate(Oracle(small, scale=1.1), read_scene(data_set), exposure_mode="exp3")
    paths = write_report(result, tmp_path / "run")
    assert [path.name for path in paths] == ["evaluation.json", "evaluation.csv", "evaluation.md"]
    content = json.loads(paths[0].read_text())
    assert content["means"]["HDR"]["psnr"] == pytest.approx(result.hdr_mean.psnr)  # type: ignore[union-attr]
    assert content["conditions"]["exposure_mode"] == "exp3" and content["conditions"]["mu"] == 5000
    assert content["scale_ratio"] == pytest.approx(1.1, rel=1e-5)
    assert set(content["relit_means"]) == {"ambient 0.25", "ambient 4", "all"}
    with paths[1].open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["part"] for row in rows].count("ldr") == 10
    assert float(rows[0]["psnr"]) == result.ldr[0].metrics.psnr
    assert {row["part"] for row in rows} == {"ldr", "hdr", "hdr aligned", "relit"}
    console = Console(width=160, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(to_terminal(result))
    for text in (paths[2].read_text(), console.export_text()):
        for word in (
            "LDR-OE",
            "LDR-NE",
            "HDR, scale aligned",
            "μ = 5000",
            "1.1000",
            "exp3",
            "split test",
            "ambient 4",
            "best ×",
        ):
            assert word in text


def test_what_is_no_number_becomes_null_in_json() -> None:
    hdr = [HdrRow("r_1", 1, 8.0, float("nan"), Metrics(33.0, 0.9), Metrics(34.0, 0.9))]
    content = to_dict(Evaluation("s", "test", "exp3", (8, 8), [], hdr, []))
    assert content["hdr"][0]["scale_ratio"] is None and content["scale_ratio"] is None
    json.dumps(content, allow_nan=False)


def test_a_report_that_cannot_be_written(data_set: Path, small: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "run").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write .*evaluation.json"):
        write_report(evaluate(Oracle(small), read_scene(data_set)), tmp_path / "run")


# ---- bad input ---------------------------------------------------------------------------------------


def test_missing_truth_of_one_view(data_set: Path, small: ModuleType) -> None:
    (data_set / "test_hdr" / "hdr_003.exr").unlink()
    with pytest.raises(FileMissingError, match=r"test_hdr/hdr_003.exr is missing\n"):
        evaluate(Oracle(small), read_scene(data_set))


def test_relit_photographs_are_at_the_scale_of_the_standard_views(data_set: Path, small: ModuleType) -> None:
    """Where the unit of radiance is free, it costs no dB under other light either."""
    off = evaluate(Oracle(small, scale=1.1), read_scene(data_set)).relit
    (data_set / "prepare.json").write_text(json.dumps({"format": "physhdr-capture"}))
    aligned = evaluate(Oracle(small, scale=1.1), read_scene(data_set)).relit
    exact = evaluate(Oracle(small), read_scene(data_set)).relit
    assert [row.ours for row in aligned] == pytest.approx([row.ours for row in exact])
    assert [row.scaled_ours for row in aligned] == pytest.approx([row.scaled_ours for row in exact], abs=0.1)
    assert all(mine.ours < right.ours for mine, right in zip(off, exact, strict=True))


def test_sheets_show_relit_photographs_at_that_scale(data_set: Path, small: ModuleType, monkeypatch) -> None:
    labels: list[str] = []
    monkeypatch.setattr(sheets, "labelled_grid", lambda rows, *_: labels.extend(r[1][0] for r in rows[:-1]))
    (data_set / "prepare.json").write_text(json.dumps({"format": "physhdr-capture"}))
    comparison_sheet(Oracle(small, scale=1.5), read_scene(data_set), [3], (), scale=1.5)
    assert len(labels) > 2 and all(", 100.00 dB" in label for label in labels[1:]), labels


def test_folders_of_relit_truth_go_by_their_names_where_nothing_lists_them(tmp_path: Path) -> None:
    for name in ("pendant_4", "level_0.25", "ambient_0.2+pendant_0"):
        (tmp_path / "relit" / name).mkdir(parents=True)
        (tmp_path / "relit" / name / "hdr_003.exr").touch()
    assert [(item.levels, item.index) for item in truth.relit_truth(tmp_path)] == [
        ({"ambient": 0.25}, 3),
        ({"pendant": 4.0}, 3),
        ({"ambient": 0.2, "pendant": 0.0}, 3),
    ]


def test_damaged_relit_truth(data_set: Path, small: ModuleType) -> None:
    (data_set / "relit" / "level_4" / "hdr_003.exr").write_bytes(b"v/1\x01 nothing")
    with pytest.raises(FileDamagedError, match=r"level_4/hdr_003.exr is not a readable OpenEXR"):
        evaluate(Oracle(small), read_scene(data_set))


def test_relit_names_that_mean_nothing(data_set: Path, small: ModuleType) -> None:
    shutil.copytree(data_set / "relit" / "level_4", data_set / "relit" / "level_bright")
    with pytest.raises(BadValueError, match=r"level_bright does not name lighting levels\n.*Rename"):
        evaluate(Oracle(small), read_scene(data_set))
    shutil.rmtree(data_set / "relit" / "level_bright")
    path = data_set / "relit" / "level_4" / "hdr_003.exr"
    path.rename(path.with_name("hdr_007.exr"))
    with pytest.raises(BadValueError, match=r"no pose 7 in split 'test'\n.*1, 3"):
        evaluate(Oracle(small), read_scene(data_set))


def test_no_test_views(data_set: Path, small: ModuleType) -> None:
    (data_set / "transforms_test.json").unlink()
    (data_set / "exposure_test.json").unlink()
    with pytest.raises(DataMismatchError, match=r"has no test views\n.*transforms_test.json"):
        evaluate(Oracle(small), read_scene(data_set))


def test_a_model_that_renders_nan(data_set: Path, small: ModuleType) -> None:
    with pytest.raises(BadValueError, match=r"renders NaN or infinity: test/r_1 at 0.125 s\n.*Train again"):
        evaluate(Oracle(small, scale=float("nan")), read_scene(data_set))


# ---- sheets ------------------------------------------------------------------------------------------


def test_comparison_sheet_has_a_row_for_each_thing_compared(data_set: Path, small: ModuleType) -> None:
    scene = read_scene(data_set)
    whole = comparison_sheet(Oracle(small), scene)
    ldr_only = comparison_sheet(Oracle(small), scene, poses=[3], exposure_indices=(2,))
    assert whole.dtype == np.uint8 and whole.shape[2] == 3
    assert whole.shape[1] == ldr_only.shape[1]
    row = (whole.shape[0] - ldr_only.shape[0]) / 2
    assert row > 180, "six rows against four: the difference is two"
    # a perfect renderer: the last residual (third column, above the legend) is black
    cell = 240
    column = slice(24 + 2 * (cell + 14) + 10, 24 + 2 * (cell + 14) + cell - 10)
    assert (whole[-160:-120, column] == 0).all()


def test_labelled_grid_keeps_pictures_as_they_are() -> None:
    rng = np.random.default_rng(0)
    large = rng.integers(0, 256, (30, 300, 3), dtype=np.uint8)
    small = rng.integers(0, 256, (20, 60, 3), dtype=np.uint8)
    sheet = labelled_grid(
        [[("large", large)], [("small, μ × 4", small), ("more", small)]], "A title", "a note"
    )
    assert find(sheet, large) and find(sheet, small.repeat(4, 0).repeat(4, 1))
    assert (sheet[:10] == 255).all() and (sheet[-10:] == 255).all() and (sheet[:, :10] == 255).all()


def find(sheet: np.ndarray, picture: np.ndarray) -> bool:
    height, width = picture.shape[:2]
    windows = np.lib.stride_tricks.sliding_window_view(sheet[..., 0], (width,), axis=1)
    ys, xs = np.nonzero((windows[:, :, :50] == picture[0, :50, 0]).all(axis=2))
    return any(
        np.array_equal(sheet[y : y + height, x : x + width], picture) for y, x in zip(ys, xs, strict=True)
    )


def test_labelled_grid_of_nothing() -> None:
    with pytest.raises(BadValueError, match="at least one picture"):
        labelled_grid([[]], "nothing")
    with pytest.raises(BadValueError, match="cell 'x'"):
        labelled_grid([[("x", np.zeros((4, 4), np.uint8))]], "wrong")
