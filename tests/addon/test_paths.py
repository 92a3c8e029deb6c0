# SPDX-License-Identifier: GPL-3.0-or-later
"""A path that somebody chose, from the root on: beside the .blend, beside where a script runs, or nowhere."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import paths  # noqa: E402
from physhdr.addon.dataset import dataset_folder  # noqa: E402
from physhdr.addon.operators import photos, training  # noqa: E402
from physhdr.addon.paths import backend_folder, user_folder, whole  # noqa: E402
from physhdr.bridge.errors import BadValueError, PhysHDRError  # noqa: E402


def test_a_chosen_path_is_whole_wherever_it_is_used(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shots" / ".." / "room.blend"))
    asked = {
        "//kitchen": tmp_path / "kitchen",
        "//../kitchen": tmp_path.parent / "kitchen",
        "kitchen/": tmp_path / "kitchen",
        str(tmp_path / "a" / ".." / "kitchen"): tmp_path / "kitchen",
    }
    for given, expected in asked.items():
        assert whole(given) == str(expected)
        assert dataset_folder.chosen_folder(given) == photos._folder(given, "the photos") == expected
        assert Path(training._whole(given, "data set", "data")) == expected
    assert whole("") == whole("  ") == ""


def test_beside_a_file_that_is_not_saved_it_is_nowhere(scene):
    ways = whole, dataset_folder.chosen_folder, lambda given: photos._folder(given, "the photos")
    for way in (*ways, lambda given: training._whole(given, "data set", "data")):
        with pytest.raises(
            BadValueError, match=r"//kitchen is relative to a \.blend that is not saved"
        ) as told:
            way("//kitchen")
        assert "Save it first" in told.value.hint
    for way in (*ways[1:], lambda given: training._whole(given, "data set", "data")):
        with pytest.raises(PhysHDRError, match="is chosen"):
            way(" ")


def test_the_backends_folder_has_a_short_path_on_windows(tmp_path, monkeypatch):
    assert backend_folder() == user_folder() / "backend"
    windows = SimpleNamespace(name="nt", environ={"LOCALAPPDATA": str(tmp_path)}, path=os.path)
    monkeypatch.setattr(paths, "os", windows)
    assert backend_folder() == tmp_path / "physhdr" / "{}.{}".format(*bpy.app.version)
    windows.environ.clear()
    assert backend_folder() == user_folder() / "backend"


def test_no_number_is_tried_where_the_system_refuses_the_name(tmp_path):
    """Such as a folder named after a file whose own name is as long as may be; it is told once it is used."""
    taken, long = tmp_path / "data", tmp_path / ("x" * 300)
    taken.mkdir()
    (taken / "file").touch()
    assert paths.first_free(taken) == tmp_path / "data_2"
    asked = []
    assert paths.first_free(long, fits=lambda path: asked.append(path) or len(asked) > 9) == long
    assert asked == [long] and paths.first_free(long) == long
