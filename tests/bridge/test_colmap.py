# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of COLMAP's camera models against COLMAP itself."""

import pytest

from physhdr.bridge.colmap import BY_NAME, MODELS

pycolmap = pytest.importorskip("pycolmap", reason="needs pycolmap")


def test_every_model_has_the_numbers_that_colmap_gives_it() -> None:
    theirs = {}
    for name, number in pycolmap.CameraModelId.__members__.items():
        if int(number) >= 0:  # −1: invalid
            camera = pycolmap.Camera.create_from_model_id(1, number, 100.0, 200, 100)
            theirs[int(number)] = name, len(camera.params), len(camera.focal_length_idxs())
    # A newer COLMAP may have more.
    assert {number: theirs[number] for number in MODELS} == MODELS
    assert len(BY_NAME) == len(MODELS)
