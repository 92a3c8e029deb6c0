# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance merged from pictures of every kind, and from what masks leave of them."""

import math

import numpy as np
import pytest
import torch

from physhdr.backend.kernels.activations import LOG_RADIANCE_RANGE
from physhdr.backend.model.tone_mapper import KnownResponse, ToneMapper, ToneMapperConfig
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import SRGB, LogEncoding
from physhdr.backend.scene.scene import PictureCache, View
from physhdr.backend.scene.source import Decoded, PictureSource
from physhdr.backend.start.brackets import Votes, log_radiance_picture
from physhdr.backend.start.initialise import merged_log_radiance

SIZE = (20, 16)
LIGHT = np.exp(np.random.default_rng(2).uniform(-3.0, 2.0, (SIZE[1], SIZE[0], 3)))
LOG = LogEncoding(4.0)
EXPOSURES = (0.05, 0.3)


class Kept(PictureCache):
    """Pictures by their path."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures = {}

    def get(self, source):
        return self.pictures[source.path]


def view_of(tmp_path, encoding, masks=(None, None), spoilt=False) -> View:
    cache = Kept()
    sources = tuple(PictureSource(tmp_path / str(k), encoding=encoding) for k in range(2))
    for source, exposure, mask in zip(sources, EXPOSURES, masks, strict=True):
        codes = encoding.codes(LIGHT * exposure)
        if spoilt and mask is not None:
            codes = np.where(mask[..., None], codes, 30_000).astype(np.uint16)
        cache.pictures[source.path] = Decoded(codes, mask)
    pose = np.eye(4)
    camera = Camera.from_field_of_view(pose, *SIZE, 0.9)
    return View("train/v_0", camera, EXPOSURES, sources, 0, cache=cache)


@pytest.mark.parametrize("encoding", [LOG, SRGB], ids=str)
def test_known_encodings_tell_radiance_without_a_response(tmp_path, encoding):
    view = view_of(tmp_path, encoding)
    merged, known = log_radiance_picture(view, (0, 1), Votes(KnownResponse()))
    sure = LIGHT * EXPOSURES[0] < 0.9  # clipped in neither, of those that clip
    assert np.abs(merged - np.log(LIGHT))[sure].max() < (2e-2 if encoding.clips else 1e-3)
    assert known.mean() > 0.95


def test_16_bits_of_a_camera_vote_as_8_do():
    torch.manual_seed(0)
    votes = Votes(ToneMapper(ToneMapperConfig(), (1.0, 0.73)))
    codes = np.arange(256, dtype=np.uint8)[:, None].repeat(3, axis=1)
    coarse = votes.cast(codes, 0.5)
    fine = votes.cast(codes.astype(np.uint16) * np.uint16(257), 0.5)
    assert np.allclose(coarse[1], fine[1], atol=1e-9)
    assert np.allclose(coarse[0], fine[0], atol=1e-5)


def test_masked_pixels_have_no_vote(tmp_path):
    """What one picture hides the other tells; what both hide is not known, and no edge for stereo."""
    one, both = np.ones(SIZE[::-1], bool), np.ones(SIZE[::-1], bool)
    one[:8], both[:4] = False, False
    view = view_of(tmp_path, LOG, (one, both), spoilt=True)
    merged, known = log_radiance_picture(view, (0, 1), Votes(KnownResponse()))
    assert np.array_equal(known, both)
    assert np.abs(merged - np.log(LIGHT))[both].max() < 1e-3
    assert np.allclose(merged[~both], merged[both].mean(axis=0))


def test_points_take_their_colour_from_what_is_seen(tmp_path):
    hidden = np.ones(SIZE[::-1], bool)
    hidden[:, :10] = False
    view = view_of(tmp_path, LOG, (hidden, hidden), spoilt=True)
    camera = view.camera
    columns, rows = np.array([3, 15]), np.array([8, 8])
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    points = np.stack([x, -y, -np.ones(2)], axis=1) * 2.0
    radiance = merged_log_radiance(points, [view], [(0, 1)], KnownResponse(), LOG_RADIANCE_RANGE)
    assert radiance[1] == pytest.approx(np.log(LIGHT[8, 15]), abs=1e-3)
    assert radiance[0] == pytest.approx(radiance[1]), "nobody sees it: the mean of the rest"
    assert math.isfinite(radiance.sum())
