# SPDX-License-Identifier: GPL-3.0-or-later
"""What the training's operators ask the backend for: folders beside the .blend, a folder for the run that
nobody has to choose, a data set that has moved; and what another file does to the panel."""

import json
import os
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import chosen_run, runtime  # noqa: E402
from physhdr.addon.chosen_run import proposed_run  # noqa: E402
from physhdr.addon.operators import afterwards, training  # noqa: E402
from physhdr.addon.operators.base import choices  # noqa: E402
from physhdr.addon.session.advice import headline, next_step, why_not  # noqa: E402
from physhdr.addon.session.state import Connected, Found, LinkLost, PythonChosen, Received  # noqa: E402
from physhdr.bridge.messages import JobStatus, RunOpen, TrainResume, TrainStart, Welcome  # noqa: E402

WELCOME = Welcome(protocol=2, version="", pid=1, log="", device="cpu", torch="2", presets=(), in_control=True)
REPORT = {"versions": {"torch": "2.13.0"}, "missing": []}


@pytest.fixture
def asked(extension, monkeypatch):
    """The requests that were sent; the backend is there and has nothing to do."""
    monkeypatch.setattr("physhdr.addon.session.session.DATASET_SECONDS", 60.0)  # however busy the machine is
    monkeypatch.setattr(chosen_run, "PROPOSAL_SECONDS", -1.0)  # the disk changes under the tests' hands
    extension.dispatch(PythonChosen("/usr/bin/python3", REPORT))
    sent = []
    monkeypatch.setattr(type(extension), "ask", lambda self, request: sent.append(request))
    return sent


@pytest.fixture
def chosen(asked):
    return bpy.context.scene.physhdr


def folder(path):
    path.mkdir(parents=True)
    return path


def run_of(path, data, pictures=()):
    """A run as the trainer leaves it, as far as Blender looks."""
    folder(path)
    (path / "checkpoint.safetensors").write_bytes(b"weights")
    (path / "config.json").write_text(json.dumps({"data": str(data), "preset": "default", "config": {}}))
    if pictures:
        views = [{"name": name, "pictures": [name]} for name in pictures]
        (path / "views.json").write_text(json.dumps({"splits": {"train": views}}))
    return path


def save(path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def test_a_run_goes_beside_the_data_set_until_the_file_is_saved_and_then_beside_that(asked, chosen, tmp_path):
    assert proposed_run("") == ""
    data = folder(tmp_path / "data" / "kitchen")
    chosen.data = str(data)
    assert choices(bpy.context).out == str(tmp_path / "data" / "kitchen_run")
    save(folder(tmp_path / "shot") / "shot.blend")
    assert chosen_run.run_of(chosen) == "//kitchen_run"
    assert choices(bpy.context).out == str(tmp_path / "shot" / "kitchen_run")
    assert why_not(runtime.session().state, "start", choices(bpy.context)).startswith(
        str(data)
    )  # no data there
    bpy.ops.physhdr.train_start(wait=False)
    assert asked == [TrainStart(data=str(data), out=str(tmp_path / "shot" / "kitchen_run"))]
    assert chosen.out == "//kitchen_run"  # what was begun is the file's choice from then on


def test_what_holds_something_else_is_never_proposed(chosen, tmp_path):
    data = folder(tmp_path / "kitchen")
    chosen.data = str(data)
    run_of(tmp_path / "kitchen_run", tmp_path / "another")
    assert choices(bpy.context).out == str(tmp_path / "kitchen_run_2")
    (folder(tmp_path / "kitchen_run_2") / "notes.txt").write_text("mine")
    assert choices(bpy.context).out == str(tmp_path / "kitchen_run_3")
    run_of(tmp_path / "kitchen_run_3", data)  # this data set's own is
    found = choices(bpy.context)
    assert found.out == str(tmp_path / "kitchen_run_3") and found.out_has_run


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_beside_a_locked_card_nothing_is_proposed(chosen, tmp_path):
    data = folder(tmp_path / "card" / "kitchen")
    (tmp_path / "card").chmod(0o500)
    assert not proposed_run(str(data)).startswith(str(tmp_path / "card"))


def test_another_data_set_has_another_run(chosen, tmp_path):
    first, second = folder(tmp_path / "kitchen"), folder(tmp_path / "hall")
    chosen.data = str(first)
    chosen.out = str(run_of(tmp_path / "kitchen_run", first))
    chosen.data = str(second)
    assert chosen.out == "" and choices(bpy.context).out == str(tmp_path / "hall_run")
    # A folder that somebody chose himself stays, and so does one whose data set may be what is chosen now.
    chosen.out = mine = str(run_of(tmp_path / "mine", second))
    chosen.data = str(first)
    assert chosen.out == mine
    chosen.out = moved = str(run_of(tmp_path / "gone_run", tmp_path / "gone"))
    chosen.data = str(second)
    assert chosen.out == moved


def test_folders_beside_the_file(asked, chosen, tmp_path):
    """``//…`` is a whole path wherever it is used, and nowhere while the file is not saved."""
    chosen.data, chosen.out = "//kitchen", "//run"
    state, found = runtime.session().state, choices(bpy.context)
    assert (found.data, found.out) == ("", "") and state.dataset.folder == ""
    for action in ("start", "resume", "open"):
        assert why_not(state, action, found) == "Save the .blend first: //kitchen is beside it"
    with pytest.raises(RuntimeError, match=r"relative to a \.blend that is not saved.*\n?.*Save it first"):
        bpy.ops.physhdr.train_start(wait=False)
    data = folder(tmp_path / "kitchen")
    save(tmp_path / "shot.blend")
    found = choices(bpy.context)
    assert (found.data, found.out, found.unsaved) == (str(data), str(tmp_path / "run"), "")
    runtime._follow_scene(runtime.session())
    assert runtime.session().state.dataset.folder == str(data)
    bpy.ops.physhdr.train_start(wait=False)
    bpy.ops.physhdr.train_start(data="//../x", out="//y/", wait=False)
    assert asked[0] == TrainStart(data=str(data), out=str(tmp_path / "run"))
    assert (asked[1].data, asked[1].out) == (str(tmp_path.parent / "x"), str(tmp_path / "y"))


def test_a_run_whose_data_set_has_moved_is_opened_with_the_chosen_one(asked, chosen, tmp_path):
    pictures = [f"train/r_{k}.png" for k in range(20)]
    chosen.out = run = str(run_of(tmp_path / "run", tmp_path / "gone", pictures))
    bpy.ops.physhdr.run_open(wait=False)
    assert asked.pop() == RunOpen(run=run)  # no data set is chosen: it opens without
    moved = folder(tmp_path / "moved")
    for name in pictures:
        (moved / name).parent.mkdir(exist_ok=True)
        (moved / name).write_bytes(b"picture")
    chosen.data = str(moved)
    bpy.ops.physhdr.run_open(wait=False)
    assert asked.pop() == RunOpen(run=run, data=str(moved))
    bpy.ops.physhdr.train_resume(wait=False)
    assert asked.pop() == TrainResume(run=run, data=str(moved))
    # Another data set is not taken for it; one that is where it was needs none; what is said counts.
    chosen.data = str(folder(tmp_path / "another"))
    bpy.ops.physhdr.run_open(wait=False)
    assert asked.pop() == RunOpen(run=run)
    bpy.ops.physhdr.run_open(data=str(tmp_path / "another"), wait=False)
    assert asked.pop() == RunOpen(run=run, data=str(tmp_path / "another"))
    folder(tmp_path / "gone")
    chosen.data = str(moved)
    bpy.ops.physhdr.run_open(wait=False)
    assert asked.pop() == RunOpen(run=run)


def test_a_run_of_an_earlier_version_is_opened_with_whatever_is_chosen(asked, chosen, tmp_path):
    """It has not kept its pictures' names; the backend says what does not fit."""
    run = str(run_of(tmp_path / "run", tmp_path / "gone"))
    chosen.data = moved = str(folder(tmp_path / "moved"))
    chosen.out = run
    bpy.ops.physhdr.run_open(wait=False)
    assert asked.pop() == RunOpen(run=run, data=moved)


def test_another_file_says_nothing_of_the_former_ones_run(asked, chosen, tmp_path):
    """Opened for real: the backend stays, the preview of the former file's model does not come along."""
    data = folder(tmp_path / "kitchen")
    chosen.data, chosen.out = str(data), str(run_of(tmp_path / "run", data))
    chosen.preview = True
    save(tmp_path / "first.blend")
    chosen.out, chosen.preview = str(tmp_path / "other_run"), True
    save(tmp_path / "second.blend")
    current = runtime.session()
    job = JobStatus(
        state="open", run=str(tmp_path / "run"), data=str(data), has_model=True, iteration=3, in_control=True
    )
    current._connect = lambda: None
    for event in (Found("log", 1), Connected(WELCOME), Received(job)):
        current.dispatch(event)
    for name, shows in (("first", True), ("second", False)):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / f"{name}.blend"))
        assert headline(current.state, choices(bpy.context)) == "Ready"
        bpy.ops.physhdr.outside_look()
        found, settings_now = choices(bpy.context), bpy.context.scene.physhdr
        assert headline(current.state, found) == ("Trained model open" if shows else "Ready")
        assert (why_not(current.state, "preview", found) == "") == settings_now.preview == shows
        assert current.state.job == job and name in current.name
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    found = choices(bpy.context)
    assert headline(current.state, found) == "Ready" and "data set" in next_step(current.state, found)
    assert current.state.dataset.folder == ""


@pytest.mark.parametrize(
    ("lost", "told"),
    [
        (LinkLost("the connection broke"), "The backend is gone: the connection broke"),
        (LinkLost("it said good-bye", clean=True), "the backend has ended: open the run again"),
    ],
)
def test_an_import_ends_with_the_backend_that_was_to_write_the_model(asked, monkeypatch, lost, told):
    current = runtime.session()
    current._connect = lambda: None
    job = JobStatus(state="open", run="/run", has_model=True, in_control=True)

    def connect():
        for event in (Found("log", 1), Connected(WELCOME), Received(job)):
            current.dispatch(event)

    # In a window: the timer of the operator, which is under way.
    operator = training.PHYSHDR_OT_result_import
    reports, timer = [], SimpleNamespace(type="TIMER")
    self = SimpleNamespace(
        report=lambda kind, text: reports.append(text),
        _is_late=lambda: False,
        _finish=lambda context, result: result,
    )
    connect()
    assert operator.modal(self, bpy.context, timer) == {"PASS_THROUGH"}
    current.dispatch(lost)
    assert operator.modal(self, bpy.context, timer) == {"CANCELLED"} and reports[0].startswith(told)
    # In a script, which waits.
    connect()
    monkeypatch.setattr(training, "ANSWER_SECONDS", 1.0)
    monkeypatch.setattr(current, "pump", lambda: current.dispatch(lost))
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.physhdr.result_import()
    assert [type(request).__name__ for request in asked] == ["ModelExport"]


def test_a_second_click_while_the_model_is_written_imports_nothing(asked, monkeypatch):
    """Each import in flight would take the same file into the scene once more."""
    current = runtime.session()
    current._connect = lambda: None
    job = JobStatus(state="open", run="/run", has_model=True, in_control=True)
    for event in (Found("log", 1), Connected(WELCOME), Received(job)):
        current.dispatch(event)
    assert bpy.ops.physhdr.result_import.poll()
    under_way = SimpleNamespace(bl_idname="PHYSHDR_OT_result_import")
    window = SimpleNamespace(modal_operators=[SimpleNamespace(bl_idname="VIEW3D_OT_rotate")])
    manager = SimpleNamespace(windows=[window])
    monkeypatch.setattr(afterwards, "bpy", SimpleNamespace(context=SimpleNamespace(window_manager=manager)))
    assert bpy.ops.physhdr.result_import.poll()
    window.modal_operators.append(under_way)
    with pytest.raises(RuntimeError, match="The backend writes the model: it is imported once it is there"):
        bpy.ops.physhdr.result_import("INVOKE_DEFAULT")
    assert asked == []
