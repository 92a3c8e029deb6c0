# SPDX-License-Identifier: GPL-3.0-or-later
"""lab/tools/contact_sheet.py on a tiny data set: what is drawn, and what it refuses."""

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from physhdr.backend.inspect import inspect

TOOL = Path(__file__).resolve().parents[3] / "lab" / "tools" / "contact_sheet.py"


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("contact_sheet", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def data(tiny_data, tmp_path):
    """The tiny data set with passes of test pose 0: ambient light 0.1, depth, normal, two objects."""
    root = shutil.copytree(tiny_data, tmp_path / "data")
    even = np.full((32, 32), 0.1, np.float32)
    channels = {f"ambient.{c}": even for c in "RGB"}
    channels |= {"depth.V": np.linspace(1, 3, 1024, dtype=np.float32).reshape(32, 32)}
    channels |= {"normal.X": even, "normal.Y": even, "normal.Z": even, "index.V": np.round(even * 0 + 1)}
    channels["depth.V"][0] = 1e10
    channels["index.V"][16:] = 7.0
    (root / "passes").mkdir()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(root / "passes" / "test_000.exr"))
    return root


def run(tool, monkeypatch, *argv):
    monkeypatch.setattr(sys, "argv", ["contact_sheet.py", *(str(word) for word in argv)])
    return tool.main()


def test_relit_pictures_are_developed_at_the_middle_exposure(tool, data):
    found = inspect(data)
    for level in (0.25, 4.0):
        text, picture = tool.relit(data, 0, level, found)
        x = 0.1 * level * 2.0  # EV +1
        assert text == f"ambient x {level:g}"
        assert (picture == round(255 * (x / (1 + x)) ** (1 / 2.2))).all()


def test_geometry_is_near_bright_sky_black_and_an_object_a_colour(tool, data):
    depth, normal, index = tool.geometry(data, 0)
    assert (depth[0] == 0).all() and depth[1, 0, 0] == 255 and 20 < depth[-1, -1, 0] < 30
    assert (np.diff(depth[1:].reshape(-1, 3)[:, 0].astype(int)) <= 0).all()
    assert (normal == round(255 * 0.55)).all()
    assert len(np.unique(index.reshape(-1, 3), axis=0)) == 2 and (index[0, 0] != index[-1, -1]).any()


def test_a_sheet_of_two_scenes_is_a_small_jpeg(tool, data, tiny_data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "docs" / "scenes.jpg"
    assert run(tool, monkeypatch, data, tiny_data, "--out", out, "--cell", 96) == 0
    assert "2 scenes" in capsys.readouterr().out
    with Image.open(out) as sheet:
        assert sheet.format == "JPEG"
        # With passes: five pictures and a column of three small ones; a title above each row.
        assert sheet.size == (2 * 10 + 5 * (96 + 4) + (96 - 8) // 3, 2 * 10 + 2 * (22 + 96) + 4)
    assert out.stat().st_size < 400_000


def test_a_damaged_data_set_is_one_clear_message(tool, data, tmp_path, monkeypatch, capsys):
    (data / "test" / "r_0_2.png").unlink()
    assert run(tool, monkeypatch, data, "--out", tmp_path / "sheet.jpg") == 1
    message = capsys.readouterr().err
    assert "r_0_2.png is missing" in message and "physhdr inspect" in message
    assert not (tmp_path / "sheet.jpg").exists()
