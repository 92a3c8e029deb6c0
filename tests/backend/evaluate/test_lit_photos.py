# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos under other light that were left out: the numbers of relighting, and of scaling, by hand."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.evaluate.report import to_csv, to_dict, to_markdown
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.scene import PictureCache, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource
from physhdr.bridge.lights import as_levels

SIZE = (40, 24)
RNG = np.random.default_rng(0)
RADIANCE = np.exp(RNG.uniform(-2.0, 1.0, (3, SIZE[1], SIZE[0])))
#: Of the lamp: the left half alone.
SHARE = np.where(np.arange(SIZE[0]) < SIZE[0] // 2, 0.9, 0.0)


def codes_of(radiance, seconds):
    return radiance * seconds / (1.0 + radiance * seconds)


class Model(Renderer):
    """Right but for its lamp, of which it knows a share that is a little too small."""

    lights = ("lamp",)

    def hdr(self, camera, lighting_level=1.0):
        (level,) = as_levels(lighting_level, self.lights)
        return torch.from_numpy(RADIANCE * (1.0 + 0.95 * SHARE * (level - 1.0)))

    def ldr(self, camera, exposure, lighting_level=1.0):
        return codes_of(self.hdr(camera, lighting_level), exposure)

    def response_curve(self):
        x = torch.linspace(-12.0, 12.0, 4001, dtype=torch.float64)
        return x, (x.exp() / (1.0 + x.exp()))[:, None].expand(-1, 3)


def view_at(tmp_path, name, x, level, seconds=0.8, group="") -> View:
    pose = np.eye(4)
    pose[0, 3] = x
    codes = np.rint(65535 * codes_of(RADIANCE * (1.0 + SHARE * (level - 1.0)), seconds))
    cache = PictureCache()
    cache.get = lambda source: Decoded(codes.astype(np.uint16).transpose(1, 2, 0), None)
    source = PictureSource(tmp_path / name)
    camera = Camera.from_field_of_view(pose, *SIZE, 1.0)
    return View(name, camera, (seconds,), (source,), round(x), (level,), cache, (), (1.0,), group)


@pytest.fixture
def scene(tmp_path):
    test = [view_at(tmp_path, f"test_{x}", x, 1.0) for x in (0.0, 5.0, 9.0)]
    lit = [
        view_at(tmp_path, "off_0", 5.0, 0.0, 1.6, "lamp off"),
        view_at(tmp_path, "off_1", 7.0, 0.0, 1.6, "lamp off"),
        view_at(tmp_path, "low", 0.0, 0.3, group="lamp low"),
    ]
    return Scene(tmp_path, "room", test, test, [], lights=("lamp",), lit_test=lit)


def test_relit_photos_are_compared_with_the_best_that_scaling_does(scene):
    found = evaluate(Model(), scene)
    off, elsewhere, low = found.lit
    assert [(row.group, row.view) for row in found.lit] == [
        ("lamp off", "off_0"),
        ("lamp off", "off_1"),
        ("lamp low", "low"),
    ]
    true = codes_of(RADIANCE * (1.0 - SHARE), 1.6)
    ours = codes_of(RADIANCE * (1.0 - 0.95 * SHARE), 1.6)
    assert off.ours == pytest.approx(-10 * math.log10(((ours - true) ** 2).mean()), abs=0.01)
    factors = np.exp(np.linspace(-3.0, 3.0, 4001))
    best = min(((codes_of(RADIANCE, factor) - true) ** 2).mean() for factor in factors)
    assert off.scaled_ours == pytest.approx(-10 * math.log10(best), abs=0.01)
    assert off.scaled_photo == pytest.approx(off.scaled_ours, abs=0.02), "the photo is what we render"
    assert elsewhere.scaled_photo is None and low.scaled_photo is not None
    means = found.lit_mean("lamp off")
    assert means.photos == 2 and means.scaled_photo is None and means.gain > 3.0


def test_every_report_has_them(scene):
    found = evaluate(Model(), scene)
    content = json.loads(json.dumps(to_dict(found)))
    assert list(content["lit_means"]) == ["lamp off", "lamp low", "all"] and len(content["lit"]) == 3
    assert content["lit_means"]["all"]["ours"] == pytest.approx(np.mean([row.ours for row in found.lit]))
    assert sum(line.startswith("lit,") for line in to_csv(found).splitlines()) == 3
    assert "| lamp off | 2 |" in to_markdown(found)


def test_a_model_of_other_lights_leaves_them_out(scene):
    class Unlit(Model):
        lights = ("ambient",)

    found = evaluate(Unlit(), scene)
    assert not found.lit and any("no levels for their lights" in message for message in found.messages)
    unknown = replace(scene, lit_test=[replace(scene.lit_test[0], lighting_levels=(None,))])
    assert not evaluate(Model(), unknown).lit
