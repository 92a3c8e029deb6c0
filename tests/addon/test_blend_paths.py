# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders beside the .blend are the same ones after it was saved in another folder: in Blender, in the file,
and after an undo. The disk says which they are: each folder holds a file of its own name."""

import os

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import blend_paths, runtime  # noqa: E402
from physhdr.addon.dataset import dataset_folder  # noqa: E402
from physhdr.addon.paths import absolute  # noqa: E402


@pytest.fixture
def chosen(registered, tmp_path):
    """The scene's settings; the .blend is saved in folder ``a``, beside a data set and a run."""
    for name in ("a/kitchen", "a/kitchen_run", "a/photos", "b/deep"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / os.path.basename(name)).touch()
    save(tmp_path / "a" / "shot.blend")
    of_scene = bpy.context.scene.physhdr
    of_scene.data, of_scene.out = "//kitchen", "//kitchen_run"
    bpy.context.scene.physhdr_dataset.out = "//rendered/"
    return of_scene


def save(path, **how):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **how)


def leads_to(path, name):
    return os.path.isfile(os.path.join(absolute(path), name))


def shown():
    return bpy.context.scene.physhdr


def test_the_run_and_the_data_set_are_found_from_another_folder(chosen, tmp_path):
    chosen.photos, chosen.photos_out = str(tmp_path / "a" / "photos"), ""
    save(tmp_path / "b" / "deep" / "shot.blend")
    for _ in range(2):  # in this Blender, and in the one that opens the file
        assert shown().out == os.path.join("//..", "..", "a", "kitchen_run")
        assert leads_to(shown().out, "kitchen_run") and leads_to(shown().data, "kitchen")
        assert absolute(bpy.context.scene.physhdr_dataset.out) == str(tmp_path / "a" / "rendered")
        assert shown().photos == str(tmp_path / "a" / "photos") and shown().photos_out == ""
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b" / "deep" / "shot.blend"))
    save(tmp_path / "a" / "again.blend")
    assert (shown().data, shown().out) == ("//kitchen", "//kitchen_run")


def test_nothing_is_chosen_anew_by_it(chosen, tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(runtime.session(), "choose_dataset", told.append)
    save(tmp_path / "b" / "shot.blend")
    assert told == []


def test_a_copy_leads_there_and_the_open_file_keeps_what_it_had(chosen, tmp_path):
    save(tmp_path / "b" / "copy.blend", copy=True)
    assert (chosen.data, chosen.out) == ("//kitchen", "//kitchen_run")
    assert bpy.context.scene.physhdr_dataset.out == "//rendered/"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b" / "copy.blend"))
    assert leads_to(shown().out, "kitchen_run")


def test_a_file_that_could_not_be_saved_keeps_what_it_had(chosen, tmp_path):
    with pytest.raises(RuntimeError):
        save(tmp_path / "none" / "shot.blend")
    assert chosen.out == "//kitchen_run"
    save(tmp_path / "b" / "shot.blend")
    assert leads_to(shown().out, "kitchen_run")


def test_an_undo_brings_back_the_folder_and_not_how_it_was_spelled(chosen, tmp_path):
    bpy.ops.ed.undo_push(message="chosen")
    chosen.iterations = 7
    bpy.ops.ed.undo_push(message="iterations")
    save(tmp_path / "b" / "shot.blend")
    bpy.ops.ed.undo()
    assert shown().iterations == 0 and leads_to(shown().out, "kitchen_run")
    bpy.ops.ed.redo()
    assert shown().iterations == 7 and leads_to(shown().out, "kitchen_run")


def test_a_folder_that_was_moved_with_its_file_is_found_where_it_is(chosen, tmp_path):
    """The disk moves both: what is beside the file is beside it there."""
    save(tmp_path / "b" / "shot.blend")
    save(tmp_path / "a" / "shot.blend")
    (tmp_path / "a").rename(tmp_path / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "moved" / "shot.blend"))
    assert shown().out == "//kitchen_run" and leads_to(shown().out, "kitchen_run")


def test_a_scene_that_was_added_later_and_one_of_another_file(chosen, tmp_path):
    added = bpy.data.scenes.new("Added")
    added.physhdr.out = "//kitchen_run"
    save(tmp_path / "a" / "other.blend", copy=True)
    with bpy.data.libraries.load(str(tmp_path / "a" / "other.blend"), link=True) as (there, here):
        here.scenes = there.scenes[:1]
    linked = next(scene for scene in bpy.data.scenes if scene.library)
    save(tmp_path / "b" / "shot.blend")
    assert leads_to(added.physhdr.out, "kitchen_run") and linked.physhdr.out == "//kitchen_run"


def test_a_scene_that_was_appended_keeps_the_paths_that_it_came_with(chosen, tmp_path):
    """Which folder they were beside, this session does not know."""
    save(tmp_path / "b" / "other.blend")
    save(tmp_path / "a" / "other.blend")
    shown().out, bpy.context.scene.name = "//kitchen_run", "Other"
    save(tmp_path / "a" / "other.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a" / "shot.blend"))
    save(tmp_path / "b" / "shot.blend")
    save(tmp_path / "a" / "shot.blend")
    with bpy.data.libraries.load(str(tmp_path / "a" / "other.blend")) as (_, here):
        here.scenes = ["Other"]
    save(tmp_path / "a" / "shot.blend")
    assert bpy.data.scenes["Other"].physhdr.out == "//kitchen_run"


def test_a_folder_that_was_proposed_for_the_former_file_is_not_the_next_ones(chosen, tmp_path):
    settings = bpy.context.scene.physhdr_dataset
    settings.out = ""
    dataset_folder.propose(settings)
    assert settings.out == "//shot_dataset"
    save(tmp_path / "b" / "next.blend")
    dataset_folder.propose(settings)
    assert settings.out == "//next_dataset"


def test_what_is_beside_a_file_that_was_never_saved_is_beside_it_then(registered, tmp_path):
    (tmp_path / "kitchen").mkdir()
    (tmp_path / "kitchen" / "kitchen").touch()
    registered.physhdr.data = "//kitchen"
    save(tmp_path / "shot.blend")
    assert shown().data == "//kitchen" and leads_to(shown().data, "kitchen")


def test_on_another_drive_a_path_is_whole(monkeypatch):
    """As Windows' own ``relpath`` has it, which knows no way from one drive to another."""

    def refuse(path, start):
        raise ValueError("path is on mount 'C:', start on mount 'D:'")

    monkeypatch.setattr(blend_paths.os.path, "relpath", refuse)
    assert blend_paths.moved("//run", "/a", "/b") == os.path.normpath("/a/run")
