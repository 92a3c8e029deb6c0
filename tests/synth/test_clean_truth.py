# SPDX-License-Identifier: GPL-3.0-or-later
"""Test and validation pictures are clean truth: of a camera's faults they have the systematic ones alone."""

import json
from dataclasses import replace

import numpy as np
import pytest

from physhdr.bridge.data_set import FORMAT, PARTIAL_FILE, VERSION, truth_folder
from physhdr.synth import exr, folder, png, response
from physhdr.synth.camera_model import CameraModel
from physhdr.synth.derive import Derivation
from physhdr.synth.errors import ConflictError
from physhdr.synth.options import Options
from physhdr.synth.passes import Passes
from physhdr.synth.plan import Shot
from physhdr.synth.png import quantise

SRGB = response.by_name("srgb")
SECONDS = (0.5, 2.0)
#: For pictures without noise.
UNUSED = np.random.default_rng(0)


@pytest.fixture
def radiance():
    """[48, 64, 3] float32 over 12 stops."""
    return np.exp2(np.random.default_rng(3).uniform(-8, 4, (48, 64, 3))).astype(np.float32)


def bracket(out, split: str, radiance: np.ndarray, camera: CameraModel) -> np.ndarray:
    """[2, H, W, 3]: the pictures of pose 3 of a split, as a data set holds them."""
    height, width = radiance.shape[:2]
    plane = np.zeros((height, width), np.float32)
    passes = Passes({"ambient": radiance}, plane, plane[..., None] + np.zeros(3), plane, plane, {})
    options = Options(resolution=(width, height), exposures=SECONDS, crf="srgb", camera=camera)
    shot = Shot(split, 3, np.eye(4), {})
    for name in (split, truth_folder(split)):
        (out / name).mkdir(parents=True)
    Derivation(out, options, SRGB).write(shot, passes)
    assert np.array_equal(exr.read(out / shot.hdr), radiance)
    return np.stack([png.read(out / shot.bracket(k)) for k in range(len(SECONDS))])


def ideal(radiance: np.ndarray) -> np.ndarray:
    """[2, H, W, 3]: the same pictures by a camera without faults."""
    return np.stack([quantise(SRGB(radiance.astype(float) * seconds)) for seconds in SECONDS])


@pytest.mark.parametrize("split", ["test", "val"])
def test_held_out_pictures_keep_what_is_systematic_alone(tmp_path, radiance, split):
    drawn = {"iso": 3200.0, "exposure_jitter": 0.2, "white_balance_jitter": 0.2}
    assert np.array_equal(bracket(tmp_path / "drawn", split, radiance, CameraModel(**drawn)), ideal(radiance))
    lens = CameraModel(vignetting=1.5, local_response=0.4)
    both = bracket(tmp_path / "both", split, radiance, replace(lens, **drawn))
    expected = [lens.develop(radiance.astype(float), seconds, SRGB, UNUSED) for seconds in SECONDS]
    assert np.array_equal(both, expected)
    assert (both != ideal(radiance)).mean() > 0.3


@pytest.mark.parametrize("split", ["train", "lit"])
@pytest.mark.parametrize("fault", [{"iso": 3200.0}, {"exposure_jitter": 0.2}, {"white_balance_jitter": 0.2}])
def test_pictures_that_are_trained_from_are_drawn(tmp_path, radiance, split, fault):
    pictures = bracket(tmp_path, split, radiance, CameraModel(**fault))
    assert ((pictures != ideal(radiance)).mean((1, 2, 3)) > 0.2).all()


def test_a_folder_whose_test_pictures_were_drawn_is_not_gone_on_with(tmp_path):
    """Made before the rule: its options lack the line, so the same command is refused there."""
    asked = Options(camera=CameraModel(iso=3200.0)).as_json()
    former = {**asked, "camera": {k: v for k, v in asked["camera"].items() if k != "held_out"}}
    state = {"format": FORMAT, "version": VERSION, "generator": {"name": "physhdr"}}
    for name, options in (("new", asked), ("former", former)):
        (tmp_path / name).mkdir()
        folder.write_json(tmp_path / name / PARTIAL_FILE, {**state, "options": options})
    assert folder.open_folder(tmp_path / "new", asked, {"name": "physhdr"})["options"] == asked
    with pytest.raises(ConflictError, match=r"camera is .* there, .*nothing drawn"):
        folder.open_folder(tmp_path / "former", asked, {"name": "physhdr"})


def test_cameras_without_draws_are_told_as_they_were():
    """Folders made by them are gone on with: not a byte of their options is another."""
    told = CameraModel(vignetting=1.5, local_response=0.6).describe()
    assert json.dumps(told) == (
        '{"vignetting": 1.5, "local_response": 0.6, '
        '"local": {"radius": 0.08, "contrast_stops": 0.5, "limit_stops": 3.0}}'
    )
