# SPDX-License-Identifier: GPL-3.0-or-later
"""Lighting levels, settings, and the EXR reader."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from physhdr.synth import exr, settings
from physhdr.synth.errors import DamagedFileError
from physhdr.synth.renderer import Renderer, view_seed
from physhdr.synth.rig import look_at
from physhdr.synth.scenes import built


def test_only_the_ambient_light_follows_the_level(tmp_path):
    """Light transport is linear in each light: equal steps of the level are equal steps of radiance."""
    with built("interior") as stage, settings.applied(stage.scene, settings.ground_truth((48, 48), 8, False)):
        renderer = Renderer(stage)
        hints = stage.cameras
        pose = look_at(np.array(hints.centre), np.array(hints.target))

        def shot(level: float) -> np.ndarray:
            return renderer.render(tmp_path / f"{level}.exr", pose, level, 5).astype(np.float64)

        def lamps_off() -> None:
            for group in ("pendant", "standing"):
                for knob in stage.lights.pop(group):
                    knob.set(off)

        off = 1e-6  # not 0: Cycles leaves a dark light out, and the same seed then takes other paths
        dark, one, three = shot(off), shot(1.0), shot(3.0)
        lamps_off()
        ambient = shot(1.0)
    bulb = dark > 50.0
    assert bulb.any() and dark.max() > 100  # the lamps burn without the sky
    assert np.allclose(one[bulb], dark[bulb], rtol=0.02)  # what the bulb shows does not follow
    by_ambient = one - dark
    assert (three - one).sum() == pytest.approx(2 * by_ambient.sum(), rel=1e-3)
    error = np.abs((three - one) - 2 * by_ambient)
    assert np.percentile(error, 95) < 1e-3 * np.median(by_ambient)
    assert np.percentile(np.abs(one - dark - ambient), 95) < 1e-3 * np.median(one)  # the groups add up
    assert 0.1 < np.median(ambient) / np.median(dark) < 10  # and both matter


def test_settings_come_back_after_an_error():
    scene = bpy.data.scenes.new("mine")
    try:
        wanted = settings.ground_truth((64, 48), 7, True)
        scene.cycles.samples, scene.render.dither_intensity = 123, 0.75
        scene.view_settings.view_transform = "AgX"
        before = {path: _get(scene, path) for path, _ in wanted}
        with pytest.raises(ZeroDivisionError), settings.applied(scene, wanted) as record:
            assert (scene.cycles.samples, scene.view_settings.view_transform) == (7, "Standard")
            assert record["scene.cycles.samples"] == 7
            assert {f"scene.{path}" for path, _ in wanted} <= record.keys()
            raise ZeroDivisionError
        assert {path: _get(scene, path) for path, _ in wanted} == before
    finally:
        bpy.data.scenes.remove(scene)


def test_settings_come_back_when_one_is_refused():
    scene = bpy.data.scenes.new("mine")
    try:
        samples = scene.cycles.samples
        with (
            pytest.raises(TypeError),
            settings.applied(scene, [("cycles.samples", 3), ("render.engine", "NONE")]),
        ):
            pass
        assert scene.cycles.samples == samples
    finally:
        bpy.data.scenes.remove(scene)


def _get(scene, path):
    return scene.path_resolve(path)


def test_no_two_pictures_share_a_seed():
    names = [f"{split}_hdr/hdr_{i:03d}.exr" for split in ("train", "test", "lit") for i in range(500)]
    assert len({view_seed(0, name) for name in names}) == len(names)
    assert view_seed(0, names[0]) != view_seed(1, names[0])


@pytest.mark.parametrize("codec", ["ZIP", "ZIPS", "NONE"])
def test_exr_reader_agrees_with_blenders(tmp_path, codec):
    values = np.random.default_rng(3).lognormal(0, 3, (37, 21, 3)).astype(np.float32)
    path = tmp_path / "a.exr"
    _save_exr(path, values, codec)
    np.testing.assert_array_equal(exr.read(path), values)


def test_no_part_of_an_exr_is_taken_for_the_whole(tmp_path):
    values = np.random.default_rng(3).lognormal(0, 1, (40, 16, 3)).astype(np.float32)
    path, cut = tmp_path / "a.exr", tmp_path / "cut.exr"
    _save_exr(path, values, "ZIP")
    whole = path.read_bytes()
    for length in [*range(0, len(whole) - 1, 97), len(whole) - 1]:
        cut.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError, match=r"cut\.exr"):
            exr.read(cut)


def test_values_that_are_not_finite_are_damage(tmp_path):
    values = np.ones((4, 4, 3), np.float32)
    values[1, 2, 0] = np.nan
    _save_exr(tmp_path / "nan.exr", values, "ZIP")
    with pytest.raises(DamagedFileError, match="not finite"):
        exr.read(tmp_path / "nan.exr")


def _save_exr(path, values, codec):
    """Blender writes ``values`` [height, width, 3]."""
    height, width, _ = values.shape
    scene = bpy.data.scenes.new("save")
    image = bpy.data.images.new("values", width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    flipped = np.concatenate([values[::-1], np.ones((height, width, 1), np.float32)], -1)
    image.pixels.foreach_set(flipped.ravel())
    picture = scene.render.image_settings
    picture.file_format, picture.color_mode, picture.color_depth = "OPEN_EXR", "RGB", "32"
    picture.exr_codec = codec
    image.save_render(str(path), scene=scene)
    bpy.data.images.remove(image)
    bpy.data.scenes.remove(scene)
