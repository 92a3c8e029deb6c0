# SPDX-License-Identifier: GPL-3.0-or-later
"""Our EXR files: Blender reads what we write, we read what Blender writes, and half a file is none."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from physhdr.synth import exr, passes
from physhdr.synth.errors import DamagedFileError, NotFiniteError


def made_up(height=21, width=37, lights=("ambient", "pendant")):
    dice = np.random.default_rng(3)

    def picture(*shape):
        return dice.lognormal(0, 2, (height, width, *shape)).astype(np.float32)

    return passes.Passes(
        {name: picture(3) for name in lights},
        depth=picture(),
        normal=picture(3),
        index=picture(),
        samples=picture(),
        facts={"seed": 5, "samples": 8.0, "noise_psnr": 31.25},
    )


@pytest.mark.parametrize("codec", ["ZIP", "ZIPS", "NONE"])
def test_we_read_what_blender_writes(tmp_path, codec):
    values = np.random.default_rng(3).lognormal(0, 3, (37, 21, 3)).astype(np.float32)
    path = tmp_path / "a.exr"
    _save_exr(path, values, codec)
    np.testing.assert_array_equal(exr.read(path), values)


@pytest.mark.parametrize("shape", [(37, 21), (16, 8), (1, 1)])
def test_blender_reads_what_we_write(tmp_path, readers, shape):
    values = np.random.default_rng(3).lognormal(0, 3, (*shape, 3)).astype(np.float32)
    (tmp_path / "a.exr").write_bytes(exr.encode_rgb(values))
    np.testing.assert_array_equal(readers.exr(tmp_path / "a.exr"), values)
    np.testing.assert_array_equal(exr.read(tmp_path / "a.exr"), values)


def test_passes_come_back_as_they_were(tmp_path):
    first = made_up()
    passes.write(tmp_path / "a.exr", first)
    again = passes.read(tmp_path / "a.exr", ["ambient", "pendant"], (37, 21))
    assert list(again.lights) == ["ambient", "pendant"] and again.facts == first.facts
    for name in ("depth", "normal", "index", "samples"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    for name, light in first.lights.items():
        np.testing.assert_array_equal(again.lights[name], light)
    assert passes.encode(again) == (tmp_path / "a.exr").read_bytes()
    mixed = again.radiance({"pendant": 0.5}).astype(np.float64)
    expected = first.lights["ambient"].astype(np.float64) + 0.5 * first.lights["pendant"]
    np.testing.assert_allclose(mixed, expected, rtol=1e-7)


def test_names_of_any_length(tmp_path):
    long = "a_light_with_a_name_that_is_longer_than_31_letters"
    passes.write(tmp_path / "a.exr", made_up(lights=("ambient", long)))
    assert long in passes.read(tmp_path / "a.exr", ["ambient", long], (37, 21)).lights


def test_passes_of_another_scene_or_size_are_refused(tmp_path):
    passes.write(tmp_path / "a.exr", made_up())
    with pytest.raises(DamagedFileError, match=r"passes of this scene \(pendant\.B.*delete it"):
        passes.read(tmp_path / "a.exr", ["ambient"], (37, 21))
    with pytest.raises(DamagedFileError, match="is 37 × 21, not 21 × 37: delete it"):
        passes.read(tmp_path / "a.exr", ["ambient", "pendant"], (21, 37))


def test_no_part_of_an_exr_is_taken_for_the_whole(tmp_path):
    whole = passes.encode(made_up())
    cut = tmp_path / "cut.exr"
    for length in [*range(0, len(whole) - 1, 997), len(whole) - 1]:
        cut.write_bytes(whole[:length])
        with pytest.raises(DamagedFileError, match=r"cut\.exr"):
            passes.read(cut, ["ambient", "pendant"], (37, 21))


def test_damage_within_a_block_is_noticed(tmp_path):
    """Deflate's own checksum covers every block that is compressed."""
    zeros = np.zeros((40, 64, 3), np.float32)
    zeros[::3] = 1.5
    whole = exr.encode_rgb(zeros)
    broken = bytearray(whole)
    broken[-3] ^= 0x55
    (tmp_path / "a.exr").write_bytes(bytes(broken))
    with pytest.raises(DamagedFileError):
        exr.read(tmp_path / "a.exr")


def test_a_small_file_that_claims_to_be_huge_takes_no_memory(tmp_path):
    head = bytearray(exr.encode_rgb(np.ones((4, 4, 3), np.float32)))
    at = head.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    head[at + 8 : at + 16] = (16000).to_bytes(4, "little") * 2
    (tmp_path / "bomb.exr").write_bytes(bytes(head))
    with pytest.raises(DamagedFileError, match="too short for its size"):
        exr.read(tmp_path / "bomb.exr")


def test_values_that_are_not_finite_are_damage(tmp_path):
    values = np.ones((4, 4, 3), np.float32)
    values[1, 2, 0] = np.nan
    (tmp_path / "nan.exr").write_bytes(exr.encode_rgb(values))
    with pytest.raises(NotFiniteError, match="not finite"):
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
