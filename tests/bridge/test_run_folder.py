# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender asks a run's folder."""

import os
from pathlib import Path

import pytest

from physhdr.bridge.run_folder import same_folder


def test_one_folder_by_several_ways(tmp_path: Path) -> None:
    real, link = tmp_path / "real", tmp_path / "link"
    (real / "data").mkdir(parents=True)
    (tmp_path / "other" / "data").mkdir(parents=True)
    try:
        link.symlink_to(real, target_is_directory=True)
    except OSError:
        pytest.skip("this system makes no links for this user")
    assert same_folder(link / "data", real / "data")  # as the trainer writes what Blender chose
    assert same_folder(f"{real}{os.sep}data{os.sep}", real / "x" / ".." / "data")
    assert same_folder(link / "gone", real / "gone")
    assert not same_folder(real / "data", tmp_path / "other" / "data")
    assert not same_folder(real / "data", "a\0b")
