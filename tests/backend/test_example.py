# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/example.py does what it says: a data set goes in, a picture, radiance and relit radiance come out."""

import importlib.util
from pathlib import Path

import numpy as np

from physhdr.backend.scene.pictures import read_codes, read_exr

EXAMPLE = Path(__file__).parents[2] / "docs" / "example.py"


def test_a_plain_loop_finds_the_radiance_and_its_light(tmp_path, tiny_data):
    spec = importlib.util.spec_from_file_location("example", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.main(tiny_data, tmp_path, iterations=40)
    radiance, relit = (read_exr(tmp_path / name) for name in ("radiance.exr", "relit.exr"))
    truth = read_exr(tiny_data / "test_hdr" / "hdr_000.exr")
    true_relit = read_exr(tiny_data / "relit" / "level_0.5" / "hdr_000.exr")
    assert read_codes(tmp_path / "picture.png")[0].shape == radiance.shape == truth.shape
    covered = (radiance > 0.02) & (truth > 0.05)  # the first Gaussians leave gaps
    error = np.log(radiance[covered] / truth[covered])
    assert covered.mean() > 0.5 and abs(np.median(error)) < 0.15 and np.abs(error).mean() < 0.5
    # Half of one light is neither half of the radiance nor all of it (both are off by more than 0.3).
    dimming = np.log(relit[covered] / radiance[covered])
    assert np.abs(dimming - np.log(true_relit[covered] / truth[covered])).mean() < 0.1
