# SPDX-License-Identifier: GPL-3.0-or-later
"""Truth with samples of its own: what it is the sum of, how it is checked, kept and taken again."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from physhdr.bridge import data_set
from physhdr.synth import dataset, exr, floors, noise, rig, settings, several, stored_truth
from physhdr.synth.built_in import SCENES, built
from physhdr.synth.errors import (
    ConflictError,
    DamagedFileError,
    NotFiniteRenderError,
    OptionError,
    OutputFolderError,
)
from physhdr.synth.options import Options
from physhdr.synth.progress import Report
from physhdr.synth.renderer import Renderer, renderer
from physhdr.synth.response import by_name
from physhdr.synth.truth import TruthRenderer, passes_of
from physhdr.tests.synth.conftest import read_png


@pytest.fixture
def clean(small):
    return replace(
        small, test_samples=16, reference_samples=64, validation_views=2, relit_views=0, lit_views=0
    )


def readers_png(path):
    """[height, width, 3] of a picture, by the reader that shares no code with synth."""
    return read_png(path)[..., :3]


@pytest.mark.long
def test_two_pictures_of_half_of_the_lights_are_the_picture_of_all(tmp_path):
    """By linearity; here 4,096 samples against 4,096 of all lights at once, which share no noise."""
    with (
        built("ball") as stage,
        settings.applied(stage.scene, settings.ground_truth((16, 12), 4096)),
        renderer(stage, denoise=False) as camera,
    ):
        bases = [knob.base for knobs in stage.lights.values() for knob in knobs]
        pose = rig.poses("grid", stage.cameras, 2, 0).test[0]
        at_once = camera.render(pose, 1, tmp_path / "a.exr")
        in_turn = TruthRenderer(camera, 4096).render(pose, 2, tmp_path / "b.exr")
        after = [getattr(knob.owner, knob.attribute) for knobs in stage.lights.values() for knob in knobs]
    assert after == pytest.approx(bases)  # all lights are on again
    for name in stage.lights:
        np.testing.assert_allclose(
            in_turn.lights[name].mean((0, 1)), at_once.lights[name].mean((0, 1)), rtol=0.01
        )
    whole = [each.radiance({}) for each in (at_once, in_turn)]
    assert noise.floor(*whole, by_name("srgb"), (1.0,))["psnr"][0] > 35.0
    np.testing.assert_allclose(in_turn.raw, whole[1], atol=1e-4)  # nothing was denoised
    assert in_turn.facts["samples"] == 4096 * 1.375


def test_truth_takes_all_its_samples_whatever_the_threshold(tmp_path):
    with (
        built("ball") as stage,
        settings.applied(stage.scene, settings.ground_truth((16, 12), 256, noise_threshold=0.9)) as record,
        renderer(stage, denoise=False) as camera,
    ):
        pose = rig.poses("grid", stage.cameras, 2, 0).test[0]
        truth = TruthRenderer(camera, 256).render(pose, 1, tmp_path / "a.exr")
        picture = camera.render(pose, 1, tmp_path / "a.exr")
    assert record["scene.cycles.use_adaptive_sampling"] and picture.samples.max() < 256
    assert (truth.samples == 256 * 1.375).all()


def test_truth_meets_a_value_that_is_no_number(tmp_path, clean, monkeypatch):
    """Each picture fails at first, also of the second truth and of the reference; other noise does not."""
    real, seeds = Renderer.render, []

    def render(self, pose, seed, scratch):
        seeds.append(seed)
        if len(seeds) % 2:
            raise NotFiniteRenderError("NaN")
        return real(self, pose, seed, scratch)

    monkeypatch.setattr(Renderer, "render", render)
    dataset.make(tmp_path, clean)
    told = json.loads((tmp_path / data_set.INFO_FILE).read_text())
    assert told["reference_floor"]["samples"] == 64
    # Three to train on; of two test and two validation views, the second truth and four chunks two pictures.
    assert len(seeds) == 2 * (3 + 2 * (2 + 2 + 1 + 4))
    assert all(a != b for a, b in zip(seeds[0::2], seeds[1::2], strict=True))


def test_test_and_validation_views_have_samples_of_their_own(tmp_path, clean):
    dataset.make(tmp_path, clean)
    told = json.loads((tmp_path / data_set.INFO_FILE).read_text())
    assert told["samples"] == 4 and told["test_samples"] == 16
    assert told["splits"] == {"train": 3, "test": 2, "lit": 0, "val": 2}
    taken = {name.split("/")[0]: frame["samples"] for name, frame in told["frames"].items()}
    assert taken == {"train": 4.0, "test": 22.0, "val": 22.0}
    assert not (tmp_path / floors.CHUNKS).exists()
    places = [
        np.array(frame["transform_matrix"])
        for split in ("train", "test", "val")
        for frame in json.loads((tmp_path / f"transforms_{split}.json").read_text())["frames"]
    ]
    nearest = min(np.abs(a - b).max() for i, a in enumerate(places) for b in places[:i])
    assert len(places) == 7 and nearest > 0.01


def test_the_reference_is_made_of_its_chunks(tmp_path, clean):
    """Made by hand: the chunks that an interrupted run left are taken, and the floor is of both halves."""
    dataset.make(tmp_path / "a", clean)
    truth = exr.read(tmp_path / "a/test_hdr/hdr_001.exr")
    made = json.loads((tmp_path / "a" / data_set.INFO_FILE).read_text())
    half_there = tmp_path / "b"
    shutil.copytree(tmp_path / "a", half_there)
    (half_there / data_set.INFO_FILE).rename(half_there / data_set.PARTIAL_FILE)
    state = json.loads((half_there / data_set.PARTIAL_FILE).read_text())
    del state["reference_floor"]
    (half_there / data_set.PARTIAL_FILE).write_text(json.dumps(state))
    dice = np.random.default_rng(1)
    pictures = [(truth + dice.normal(0, 0.05, truth.shape)).astype(np.float32) for _ in range(4)]
    (half_there / floors.CHUNKS).mkdir()
    for k, picture in enumerate(pictures):
        (half_there / floors.CHUNKS / f"reference_{k:03d}.exr").write_bytes(exr.encode_rgb(picture))
    dataset.make(half_there, clean)
    floor = json.loads((half_there / data_set.INFO_FILE).read_text())["reference_floor"]
    assert floor["samples"] == made["reference_floor"]["samples"] == 64 and floor["view"] == 1
    halves = [np.maximum(np.mean(part, 0, dtype=np.float64), 0) for part in (pictures[::2], pictures[1::2])]
    best, first, second = (by_name("reinhard-gamma")(x * 2.0) for x in (truth.astype(np.float64), *halves))
    error = np.mean((best - first) * (best - second))
    assert floor["psnr"][2] == pytest.approx(-10 * np.log10(error), abs=0.02)
    assert made["noise_floor"] == json.loads((half_there / data_set.INFO_FILE).read_text())["noise_floor"]


@pytest.fixture
def kept_truth(tmp_path, clean):
    """A data set in a/, and its truth kept in kept/ as lab/tools/keep_truth.py does it."""
    dataset.make(tmp_path / "a", clean)
    told = json.loads((tmp_path / "a" / data_set.INFO_FILE).read_text())
    root = tmp_path / "kept"
    root.mkdir()
    for split in ("test", "val"):
        frames = json.loads((tmp_path / f"a/transforms_{split}.json").read_text())["frames"]
        for k, frame in enumerate(frames):
            radiance = exr.read(tmp_path / f"a/{split}_hdr/hdr_{k:03d}.exr")
            stored_truth.write(
                root / stored_truth.file_name(split, k),
                radiance,
                {"camera_to_world": frame["transform_matrix"]},
            )
    options = {name: told["options"][name] for name in stored_truth.SAME}
    content = {
        "format": stored_truth.FORMAT,
        "version": stored_truth.VERSION,
        "options": options,
        "samples": 16,
    }
    content["exposures"] = told["exposures"]
    floors_of = {name: told[name] for name in ("noise_floor", "reference_floor")}
    (root / stored_truth.TRUTH_FILE).write_text(json.dumps(content | floors_of))
    return root


def test_kept_truth_is_taken_instead_of_rendering(tmp_path, clean, kept_truth):
    """The same pictures but for the rounding, and no render of these views."""
    taking = replace(clean, test_samples=None, reference_samples=None, test_truth=str(kept_truth))
    dataset.make(tmp_path / "b", taking)
    first, second = (json.loads((tmp_path / x / data_set.INFO_FILE).read_text()) for x in "ab")
    for name in ("test_samples", "splits"):
        assert first[name] == second[name]
    for name in ("noise_floor", "reference_floor"):
        assert {**first[name], "exposures": first["exposures"]} == second[name]
    assert second["frames"]["test/1"]["kept"] is True
    assert not list((tmp_path / "b/passes").glob("test_*")) and not list(
        (tmp_path / "b/passes").glob("val_*")
    )
    response = by_name("reinhard-gamma")
    for split, k in (("test", 0), ("val", 1)):
        a, b = (exr.read(tmp_path / x / f"{split}_hdr/hdr_{k:03d}.exr") for x in "ab")
        np.testing.assert_allclose(b, a, rtol=2.0**-9 + 2.0**-11, atol=1e-6)
        picture = readers_png(tmp_path / f"b/{split}/r_{k}_2.png")
        exposed = response(b.astype(np.float64) * 2.0)
        np.testing.assert_array_equal(picture, np.rint(exposed * 255.0))
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "b").rglob("*")}
    dataset.make(tmp_path / "b", taking)
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "b").rglob("*")}


def test_kept_truth_of_something_else_is_refused(tmp_path, clean, kept_truth):
    taking = replace(clean, test_samples=None, reference_samples=None, test_truth=str(kept_truth))
    with pytest.raises(ConflictError, match=r"resolution is .32, 24. there, .24, 24. asked"):
        dataset.make(tmp_path / "b", replace(taking, resolution=(24, 24)))
    dataset.make(tmp_path / "f", taking)
    told = json.loads((kept_truth / stored_truth.TRUTH_FILE).read_text())
    (kept_truth / stored_truth.TRUTH_FILE).write_text(json.dumps(told | {"samples": 32}))  # cleaner since
    with pytest.raises(ConflictError, match="test_truth is 16 there, 32 asked"):
        dataset.make(tmp_path / "f", taking)
    with pytest.raises(DamagedFileError, match=r"no '.*val_002.exr'"):
        dataset.make(tmp_path / "b", replace(taking, validation_views=3))
    path = kept_truth / "val_000.exr"
    good = path.read_bytes()
    path.write_bytes((kept_truth / "val_001.exr").read_bytes())
    with pytest.raises(ConflictError, match="another place than the rig's val view 0"):
        dataset.make(tmp_path / "c", taking)
    path.write_bytes(good[:-9])
    with pytest.raises(DamagedFileError, match=r"val_000.*fetch it again"):
        dataset.make(tmp_path / "d", taking)
    with pytest.raises(DamagedFileError, match="nowhere"):
        dataset.make(tmp_path / "e", replace(taking, test_truth=str(tmp_path / "nowhere")))


def test_what_half_floats_cannot_hold_is_not_kept(tmp_path):
    with pytest.raises(OutputFolderError, match="more than half floats hold"):
        stored_truth.write(tmp_path / "a.exr", np.full((2, 2, 3), 1e5, np.float32), {})


def test_kept_radiance_has_nine_significant_bits():
    values = np.random.default_rng(5).lognormal(0, 3, 10_000).astype(np.float32)
    small = stored_truth.rounded(values)
    np.testing.assert_allclose(small, values, rtol=2.0**-9 + 2.0**-11, atol=1e-7)
    mantissa, _ = np.frexp(small.astype(np.float64))
    big = small > 1e-3  # smaller half floats lose bits by themselves
    assert (mantissa[big] * 2**9 % 1 == 0).all() and (mantissa[big] * 2**8 % 1 != 0).any()


def test_the_passes_of_a_truth_are_even():
    assert passes_of(16) == [16] and passes_of(2048) == [1024] * 2 and passes_of(2500) == [1250] * 2
    assert passes_of(3001) == [1000, 1000, 1001]


def test_a_folder_with_clean_truth_is_no_other(tmp_path, clean):
    """Also the other way round: an option that is no longer given differs from one that was."""
    dataset.make(tmp_path, clean)
    with pytest.raises(ConflictError, match="test_samples is 16 there, None asked"):
        dataset.make(tmp_path, replace(clean, test_samples=None, reference_samples=None))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"reference_samples": 64}, "--reference-samples is a check of --test-samples"),
        ({"test_samples": 0}, "--test-samples"),
        ({"test_truth": "x", "relit_views": None}, "give --relit-views 0"),
        ({"test_truth": "x", "relit_views": 0, "test_samples": 4}, "give one of them"),
        ({"validation_views": -1}, "--validation-views"),
    ],
)
def test_options_that_cannot_be(wrong, says):
    with pytest.raises(OptionError, match=says):
        Options(**wrong).check()


def test_half_floats_are_read_by_blender(tmp_path, readers):
    values = np.random.default_rng(3).lognormal(0, 2, (37, 21, 3)).astype(np.float32)
    (tmp_path / "a.exr").write_bytes(exr.encode_rgb(values, kind=exr.HALF))
    half = values.astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(readers.exr(tmp_path / "a.exr"), half)
    np.testing.assert_array_equal(exr.read(tmp_path / "a.exr"), half)


@pytest.mark.long
def test_another_camera_needs_no_new_renders(tmp_path, clean, monkeypatch):
    """The pictures are those of a data set that was rendered anew, and a render was asked for only once."""
    dataset.make(tmp_path / "a", clean)
    other = replace(clean, crf="filmic", exposures=(0.5, 1.0))
    dataset.make(tmp_path / "anew", other)
    rendered = []
    real = dataset.Renderer.render

    def counted(self, *arguments):
        rendered.append(arguments)
        return real(self, *arguments)

    monkeypatch.setattr(dataset.Renderer, "render", counted)
    dataset.make(tmp_path / "b", replace(other, renders_of=str(tmp_path / "a"), reference_samples=0))
    assert len(rendered) == 2  # one truth, of two pictures, for the noise floor
    for split, k in (("train", 2), ("test", 0), ("val", 1)):
        a, b = (read_png(tmp_path / x / f"{split}/r_{k}_1.png") for x in ("anew", "b"))
        np.testing.assert_array_equal(a, b)


def test_the_progress_of_several_scenes_counts_the_reference(tmp_path, clean, monkeypatch, capsys):
    monkeypatch.setitem(SCENES, "ball 2", SCENES["ball"])
    several.make_all(tmp_path, ["ball", "ball 2"], clean, Report())
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("render [")]
    # Seven poses and four chunks of each; the last one of all is the first that is the whole.
    assert [line for line in told if "] 22/22 " in line] == [told[-1]]
    assert told[-1].endswith("ball 2 reference_003")


@pytest.mark.parametrize("given", [{"test_truth": "x", "relit_views": 0}, {"renders_of": "x"}])
def test_what_is_of_one_scene_is_not_taken_for_several(tmp_path, given):
    with pytest.raises(OptionError, match="is of one scene, and --scene names several"):
        several.make_all(tmp_path, ["dog", "bear"], Options(**given), Report())
    assert not list(tmp_path.iterdir())


def test_renders_of_something_else_are_refused(tmp_path, clean):
    dataset.make(tmp_path / "a", clean)
    with pytest.raises(ConflictError, match=r"other options \(samples\)"):
        dataset.make(tmp_path / "b", replace(clean, samples=5, renders_of=str(tmp_path / "a")))
    path = tmp_path / "a/passes/train_000.exr"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(DamagedFileError, match=r"/a/passes/train_000.exr' is damaged"):
        dataset.make(tmp_path / "d", replace(clean, crf="srgb", renders_of=str(tmp_path / "a")))
    with pytest.raises(DamagedFileError, match="nowhere"):
        dataset.make(tmp_path / "c", replace(clean, renders_of=str(tmp_path / "nowhere")))
