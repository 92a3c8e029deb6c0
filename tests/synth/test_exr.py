# SPDX-License-Identifier: GPL-3.0-or-later
"""Our EXR files: Blender reads what we write, we read what Blender writes, and half a file is none."""

import json
import os
import resource
import struct
import zlib

import bpy
import numpy as np
import pytest

from physhdr.synth import exr, folder, passes, png
from physhdr.synth.errors import ConflictError, DamagedFileError, NotFiniteError, OutputFolderError


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


def test_damage_of_any_kind_is_one_error(tmp_path, fuzzing):
    """Among 600 are offsets beyond what Python can index, and attributes of a negative size."""
    whole = exr.encode({name: np.ones((40, 12), np.float32) for name in "RG"}, {"facts": "{}"})
    for damaged in fuzzing.mutations(whole, 600, 1):
        (tmp_path / "a.exr").write_bytes(damaged)
        try:
            exr.read_channels(tmp_path / "a.exr")
        except DamagedFileError as error:
            assert "a.exr" in error.message


def test_an_offset_that_nothing_can_index(tmp_path):
    whole = exr.encode_rgb(np.ones((4, 4, 3), np.float32))
    at = _table(whole)
    (tmp_path / "a.exr").write_bytes(whole[:at] + struct.pack("<Q", 2**64 - 1) + whole[at + 8 :])
    with pytest.raises(DamagedFileError, match=r"a\.exr' is damaged"):
        exr.read(tmp_path / "a.exr")


def test_lines_that_are_there_twice_leave_others_out(tmp_path):
    """Else what happened to be in memory would be the picture's second half."""
    whole = exr.encode_rgb(np.random.default_rng(0).normal(size=(32, 8, 3)))
    at = _table(whole)
    first = whole[at : at + 8]
    (tmp_path / "a.exr").write_bytes(whole[:at] + first + first + whole[at + 16 :])
    with pytest.raises(DamagedFileError, match="has lines twice"):
        exr.read(tmp_path / "a.exr")


def test_lines_above_the_picture_are_not_the_last_ones(tmp_path):
    whole = exr.encode_rgb(np.random.default_rng(0).normal(size=(32, 8, 3)))
    (block,) = struct.unpack_from("<Q", whole, _table(whole))
    (tmp_path / "a.exr").write_bytes(whole[:block] + struct.pack("<i", -16) + whole[block + 4 :])
    with pytest.raises(DamagedFileError, match="has lines twice"):
        exr.read(tmp_path / "a.exr")


def test_an_attribute_of_a_negative_size_is_no_way_back(tmp_path, never_waits):
    """Its end would be its beginning: the header would be read for ever."""
    whole = exr.encode_rgb(np.ones((4, 4, 3), np.float32))
    head = b"compression\0compression\0"
    size = struct.pack("<i", -len(head) - 4)
    (tmp_path / "a.exr").write_bytes(whole.replace(head + struct.pack("<i", 1), head + size))
    with pytest.raises(DamagedFileError, match="impossible size"):
        exr.read(tmp_path / "a.exr")


@pytest.mark.long
def test_a_block_that_unpacks_to_more_than_its_lines_takes_no_memory(tmp_path):
    whole = exr.encode_rgb(np.zeros((4, 4, 3), np.float32))
    (block,) = struct.unpack_from("<Q", whole, _table(whole))
    bomb = zlib.compress(bytes(1 << 28), 9)
    (tmp_path / "a.exr").write_bytes(whole[:block] + struct.pack("<ii", 0, len(bomb)) + bomb)
    before = _peak()
    with pytest.raises(DamagedFileError, match="block of the wrong size"):
        exr.read(tmp_path / "a.exr")
    assert _peak() - before < 100e6


def test_pipes_are_not_waited_for(tmp_path, never_waits):
    for name, read in (("a.exr", exr.read), ("a.png", png.read), ("dataset.json", folder.read_json)):
        os.mkfifo(tmp_path / name)
        with pytest.raises(DamagedFileError, match=f"cannot read '.*{name}': it is not a file"):
            read(tmp_path / name)


def test_a_png_comes_back_or_is_damaged(tmp_path, fuzzing):
    path, image = tmp_path / "a.png", np.arange(300, dtype=np.uint8).reshape(10, 10, 3)
    whole = png.encode(image)
    path.write_bytes(whole)
    np.testing.assert_array_equal(png.read(path), image)
    for damaged in fuzzing.mutations(whole, 300, 2):
        path.write_bytes(damaged)
        try:
            png.read(path)
        except DamagedFileError as error:
            assert "a.png" in error.message


@pytest.mark.parametrize("options", [None, True, 7, [1], "text"])
def test_a_state_without_options_is_not_ours(tmp_path, options):
    state = {"format": "physhdr-dataset", "version": 1, "generator": {"name": "x"}, "options": options}
    folder.write_json(tmp_path / "dataset.json", state)
    with pytest.raises(OutputFolderError, match="is not of this program"):
        folder.open_folder(tmp_path, {"views": 3}, {"name": "x"})


@pytest.mark.parametrize("foreign", ["x" * 5000, "half \ud800", "\x1b[2J", {"a": ["x"] * 5000}])
def test_what_a_state_says_is_cut_and_shown(tmp_path, foreign):
    """Whatever it says of who made it and how: in one message that any terminal shows."""
    ours = {"format": "physhdr-dataset", "version": 1, "generator": {"name": "x"}, "options": {"views": 3}}
    for other in ({"generator": {"name": foreign}}, {"options": {"views": foreign}}):
        (tmp_path / "dataset.json").write_text(json.dumps(ours | other))
        with pytest.raises(ConflictError) as refused:
            folder.open_folder(tmp_path, {"views": 3}, {"name": "x"})
        told = refused.value
        assert len(str(told)) < 600 and f"{told.message} {told.hint}".isprintable()


def test_a_state_of_a_hundred_thousand_brackets(tmp_path):
    (tmp_path / "dataset.json").write_text("[" * 100_000)
    with pytest.raises(DamagedFileError, match=r"dataset\.json' is damaged .maximum recursion"):
        folder.read_json(tmp_path / "dataset.json")


def _table(data):
    """Where the table of the blocks' offsets is: it begins with where it ends."""
    return next(
        at for at in range(len(data) - 8) if struct.unpack_from("<Q", data, at)[0] in (at + 8, at + 16)
    )


def _peak():
    """Bytes that this process has had at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


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
