# SPDX-License-Identifier: GPL-3.0-or-later
"""Which trainings see merged brackets. What such pictures are: ``tests/backend/start``."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.encoding import CAMERA, SRGB, Encoding
from physhdr.backend.start.merged_brackets import MergedBrackets
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.state import State


@pytest.fixture
def noisy(tiny_data, tmp_path) -> Path:
    """The small scene with noise in its training pictures, in codes."""
    root = Path(shutil.copytree(tiny_data, tmp_path / "noisy"))
    rng = np.random.default_rng(1)
    for path in sorted((root / "train").glob("*.png")):
        codes = np.asarray(Image.open(path)).astype(np.float64)
        codes = np.clip(np.rint(codes + rng.normal(0.0, 8.0, codes.shape)), 0, 255).astype(np.uint8)
        Image.fromarray(codes).save(path)
    return root


def begun(root: Path, preset: str = "default", **settings) -> State:
    return begin(read_scene(root), dataclasses.replace(PRESETS[preset], iterations=20, **settings))


def test_auto_merges_noisy_brackets_alone(tiny_data, noisy):
    assert begun(tiny_data).data.merged is None
    merging = begun(noisy)
    assert merging.data.merged is not None and 4.0 < merging.data.merged.worst < 16.0
    assert "brackets merged" in merging.start_message


@pytest.mark.long
def test_published_methods_see_what_the_camera_took(noisy):
    for preset in ("baseline", "gausshdr-short", "paper-short"):
        assert begun(noisy, preset).data.merged is None


def test_one_exposure_a_view_is_no_bracket(noisy):
    assert begun(noisy, exposure_mode="exp1").data.merged is None


@pytest.mark.long
def test_pictures_are_nearer_to_those_without_noise(tiny_data, noisy):
    taken, merged, clean = (
        begun(noisy, merged_brackets="off"),
        begun(noisy, merged_brackets="on"),
        begun(tiny_data, merged_brackets="off"),
    )

    def errors(training: State) -> float:
        pairs = zip(training.views, clean.views, strict=True)
        return float(
            np.mean(
                [
                    (training.data.picture(a, k) - clean.data.picture(b, k)).square().mean().item()
                    for a, b in pairs
                    for k in (0, 2, 4)
                ]
            )
        )

    assert errors(merged) < 0.7 * errors(taken)
    picture = merged.data.recording(merged.views[0], 2).picture
    assert torch.equal(picture, merged.data.picture(merged.views[0], 2)) and picture.max() <= 1.0


def test_what_clips_under_a_known_response_stays_white(noisy):
    """A code just below white would say how bright it is, and be believed: skies of raw files turned blue."""
    for path in sorted((noisy / "train").glob("*.png")):
        Image.fromarray(np.clip(np.asarray(Image.open(path)) * 2.0, 0, 255).astype(np.uint8)).save(path)

    def whites(encoding: Encoding) -> np.ndarray:
        views = [
            dataclasses.replace(
                view, sources=tuple(dataclasses.replace(source, encoding=encoding) for source in view.sources)
            )
            for view in read_scene(noisy).train
        ]
        merged = MergedBrackets(views, [(0, 2, 4)] * len(views))
        assert merged.worth_it
        each = ((view, k, view.image(k).transpose(2, 0, 1)) for view in views for k in (0, 2, 4))
        return np.concatenate(
            [merged.codes(view, k)[codes == np.iinfo(codes.dtype).max] for view, k, codes in each]
        )

    known = whites(SRGB)
    assert len(known) > 100 and (known == 65535).all()
    assert (whites(CAMERA) < 65535).any()  # of noise, where the response is learned
