# SPDX-License-Identifier: GPL-3.0-or-later
"""A stranger's .blend makes nothing happen by itself: what it names outside it is looked at when the user
says so, and what it names in a network when the user says so of that place."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "stress"))

from torture_attacks.stranger_inside import (  # noqa: E402
    a_model,
    append_scenes,
    draw_all,
    live,
    make,
    name_everything,
    pass_time,
)
from torture_attacks.watch import COMPUTER, NETWORK, places, watched  # noqa: E402

from physhdr.addon import outside, runtime, settings  # noqa: E402
from physhdr.addon.model import origin  # noqa: E402
from physhdr.addon.model.attributes import FILE  # noqa: E402
from physhdr.addon.model.look import is_of_run  # noqa: E402
from physhdr.addon.operators.base import choices  # noqa: E402
from physhdr.addon.session.advice import LOOK_FIRST, next_step, why_not  # noqa: E402
from physhdr.bridge.errors import BadValueError  # noqa: E402
from physhdr.bridge.model_file import write_model  # noqa: E402


@pytest.fixture
def elsewhere(registered, tmp_path):
    """A folder that files name."""
    folder = tmp_path / "elsewhere"
    for name in ("data", "photos", "out"):
        (folder / name).mkdir(parents=True)
    yield folder
    for name in list(runtime.session()._tasks):
        runtime.session().cancel_task(name)


@pytest.fixture
def stranger(elsewhere, tmp_path):
    """A file that names everything, open."""
    make(tmp_path / "stranger.blend", elsewhere)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "stranger.blend"))
    bpy.context.window.scene = bpy.data.scenes["Folder"]
    return elsewhere


def test_what_is_done_to_files_is_seen(tmp_path):
    """The oracle: else nothing would be found in whatever happens."""
    file = tmp_path / "named" / "file"
    file.parent.mkdir()
    looks = {
        "open": lambda: file.write_text(""),
        "os.stat": file.exists,
        "os.lstat": lambda: os.path.realpath(file),
        "os.access": lambda: os.access(file, os.W_OK),
        "os.listdir": lambda: os.listdir(file.parent),
        "os.scandir": lambda: list(os.scandir(file.parent)),
        "subprocess.Popen": lambda: subprocess.run([sys.executable, "-c", ""], check=True),
    }
    for what, look in looks.items():
        with watched(str(file.parent)) as found:
            look()
        assert what in [line.split()[0] for line in found]
    with watched(str(file.parent)) as found:
        tmp_path.exists()
    assert found == []


def test_a_file_alone_makes_nothing_happen(elsewhere, tmp_path):
    make(tmp_path / "stranger.blend", elsewhere)
    with watched(*places(elsewhere)) as found:
        live(tmp_path / "stranger.blend")
    assert found == []


def test_the_button_looks_at_what_is_on_this_computer_until_another_file_is_open(stranger, tmp_path):
    before = choices(bpy.context)
    assert (before.data, before.out, before.photos) == ("", "", "")
    assert str(stranger / "data") in before.not_looked_at
    bpy.ops.physhdr.outside_look()
    found = choices(bpy.context)
    assert (found.data, found.out) == (str(stranger / "data"), str(stranger / "out"))
    assert found.not_looked_at == ()
    with watched(str(stranger), COMPUTER) as seen:
        runtime._attend()
        draw_all()
    assert any(f"{stranger / 'data'}" in line for line in seen) and not any(COMPUTER in line for line in seen)
    assert runtime.session().state.dataset.folder == str(stranger / "data")
    # What this session saves stays as it is; what is opened is a file again.
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    assert choices(bpy.context) == found
    bpy.ops.wm.revert_mainfile()
    assert choices(bpy.context).data == ""


def test_a_place_in_a_network_wants_a_button_of_its_own(stranger):
    bpy.context.window.scene = bpy.data.scenes["Network"]
    named = choices(bpy.context).not_looked_at
    assert f"{NETWORK}\\data" in named and all(map(outside.is_network, named))
    bpy.ops.physhdr.outside_look()
    assert choices(bpy.context).not_looked_at == named
    bpy.ops.physhdr.outside_look(path=f"{NETWORK}\\data")
    assert choices(bpy.context).data == f"{NETWORK}\\data"
    assert f"{NETWORK}\\out" in choices(bpy.context).not_looked_at


def test_a_click_on_something_else_does_not_lead_into_a_network(stranger):
    """As *Import Cameras* of a model whose data set is there, and *Prepare Photos* with a file there."""
    scene = bpy.context.window.scene = bpy.data.scenes["Network"]
    model = next(each for each in scene.objects if each.name.startswith("whole"))
    with watched(COMPUTER) as found:
        assert origin.data_of(model) is None
        with pytest.raises(BadValueError, match="another computer"):
            settings.photo_options(scene.physhdr)
        bpy.context.view_layer.objects.active = model
        with pytest.raises(RuntimeError, match="is not there"):
            bpy.ops.physhdr.cameras_import()
    assert found == []


def test_an_appended_scene_is_a_strangers(stranger, tmp_path):
    """Whatever was agreed to of the open file."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.physhdr.data = str(tmp_path / "mine")
    append_scenes(tmp_path / "stranger.blend", link=True)
    with watched(*places(stranger)) as found:
        pass_time()
    assert found == []


def test_what_is_chosen_in_the_interface_may_be_looked_at(elsewhere):
    chosen = bpy.context.scene.physhdr
    for name in ("data", "out", "photos", "photos_out", "photos_exposures"):
        setattr(chosen, name, str(elsewhere / name))
    bpy.context.scene.physhdr_dataset.out = str(elsewhere / "rendered")
    bpy.context.scene.physhdr_dataset.response_file = str(elsewhere / "response")
    assert choices(bpy.context).not_looked_at == ()
    assert outside.may_look(elsewhere / "data" / "images" / "1.png")
    assert not outside.may_look(elsewhere) and not outside.may_look(f"{elsewhere / 'data'}2")
    assert not outside.may_look(elsewhere / "data" / ".." / "secret")


def test_what_is_beside_a_file_that_is_not_saved_yet_stays_chosen(elsewhere, tmp_path):
    bpy.context.scene.physhdr.data = "//elsewhere/data"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    assert choices(bpy.context).data == str(elsewhere / "data")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "elsewhere" / "mine.blend"))
    assert choices(bpy.context).data == str(elsewhere / "data")


def test_a_button_that_is_about_a_folder_chooses_it(stranger):
    """In scripts as well, where nobody presses *Look at Them* before."""
    assert choices(bpy.context).out == choices(bpy.context).data == ""
    with pytest.raises(RuntimeError, match=r"there is no .*model\.safetensors"):
        bpy.ops.physhdr.result_import()
    assert choices(bpy.context).out == str(stranger / "out")
    assert choices(bpy.context).photos == ""


def test_the_panel_says_what_to_do_first(stranger):
    pass_time()
    state, found = runtime.session().state, choices(bpy.context)
    assert next_step(state, found) == LOOK_FIRST
    for action in ("start", "resume", "open"):
        assert why_not(state, action, found) != ""


@pytest.mark.parametrize(
    ("path", "is_one"),
    [
        ("\\\\server\\share\\data", True),
        ("//server/share", True),
        ("\\\\?\\UNC\\server\\share", True),
        ("C:\\data", False),
        ("/data", False),
        ("data", False),
    ],
)
def test_places_in_a_network(path, is_one):
    assert outside.is_network(path) == is_one
    assert outside.may_follow(path) == (not is_one)


def test_only_folders_that_are_named_alike_are_one_where_nobody_may_look(elsewhere, tmp_path):
    """A model of the run that the trainer holds is known by its file's name; no links are followed for it."""
    write_model(tmp_path / "model.safetensors", a_model())
    name_everything(bpy.context.scene, f"{elsewhere}/", tmp_path / "model.safetensors")
    model = next(each for each in bpy.context.scene.objects if each.name == "whole")
    (elsewhere / "run").mkdir()
    link = tmp_path / "link"
    link.symlink_to(elsewhere / "run", target_is_directory=True)
    assert is_of_run(model, str(elsewhere / "run")) and not is_of_run(model, str(link))
    outside.choose(str(model.data[FILE]))
    assert is_of_run(model, str(link))
