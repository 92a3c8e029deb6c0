# SPDX-License-Identifier: GPL-3.0-or-later
"""Matrices of colour spaces against published ones, and where radiance's primaries come from."""

import numpy as np
import OpenEXR
import pytest

from physhdr.backend.scene.color_space import NAMES, SPACES, Chromaticities, known, space_named
from physhdr.backend.scene.source import radiance_rec709
from physhdr.bridge.errors import BadValueError

#: As the Academy's transforms have them (ACES 1.x, ACEScg and ACES2065-1 to linear sRGB, Bradford) and ITU-R
#: BT.2087 has Rec.2020's.
PUBLISHED = {
    "acescg": [
        [1.70505, -0.62179, -0.08326],
        [-0.13026, 1.14080, -0.01055],
        [-0.02400, -0.12897, 1.15297],
    ],
    "aces2065-1": [
        [2.52169, -1.13413, -0.38756],
        [-0.27648, 1.37272, -0.09624],
        [-0.01538, -0.15298, 1.16835],
    ],
    "rec2020": [
        [1.6605, -0.5876, -0.0728],
        [-0.1246, 1.1329, -0.0083],
        [-0.0182, -0.1006, 1.1187],
    ],
}


def write(path, pixels, space: Chromaticities | None) -> None:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    if space is not None:
        header["chromaticities"] = (*space.red, *space.green, *space.blue, *space.white)
    OpenEXR.File(header, {"RGB": pixels}).write(str(path))


@pytest.mark.parametrize("name", PUBLISHED)
def test_matrices_are_the_published_ones_and_keep_white(name):
    matrix = SPACES[name].to_rec709()
    assert np.abs(matrix - PUBLISHED[name]).max() < 6e-5
    assert matrix @ np.ones(3) == pytest.approx([1.0, 1.0, 1.0], abs=1e-9)


def test_a_files_primaries_are_believed_and_an_option_overrides(tmp_path):
    """The same light in three spaces reads the same; without a word it is Rec.709."""
    light = np.random.default_rng(0).uniform(0.1, 4.0, (5, 7, 3))
    for name in NAMES:
        stored = (light @ np.linalg.inv(SPACES[name].to_rec709()).T).astype(np.float32)
        write(tmp_path / f"{name}.exr", stored, SPACES[name])
        write(tmp_path / f"{name}_silent.exr", stored, None)
        read, words = radiance_rec709(tmp_path / f"{name}.exr")
        assert np.abs(read - light).max() < 1e-5 and name in words
        read, words = radiance_rec709(tmp_path / f"{name}_silent.exr", name)
        assert np.abs(read - light).max() < 1e-5 and "--color-space" in words
        read, _ = radiance_rec709(tmp_path / f"{name}_silent.exr")
        assert np.array_equal(read, stored.astype(np.float64))


def test_primaries_of_no_space_are_refused(tmp_path):
    write(tmp_path / "odd.exr", np.ones((2, 2, 3), np.float32), Chromaticities(*[(0.3, 0.3)] * 4))
    with pytest.raises(BadValueError, match="no colour space"):
        radiance_rec709(tmp_path / "odd.exr")
    with pytest.raises(BadValueError, match="acescg"):
        space_named("aces")


def test_rounded_primaries_are_known_for_what_they_are():
    rounded = Chromaticities((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290))
    assert known(rounded)[1] == "rec709"
    assert known(Chromaticities((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), (0.3127, 0.329)))[1] == ""
