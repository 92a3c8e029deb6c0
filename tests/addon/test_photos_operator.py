# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr.photos_look`` and ``photos_prepare`` through a real child process that stands in for the backend.

It keeps to what ``physhdr prepare --json`` promises.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.operators import afterwards  # noqa: E402
from physhdr.addon.operators import photos as operators  # noqa: E402
from physhdr.addon.operators.base import choices  # noqa: E402
from physhdr.addon.session.advice import headline, next_step, problem_of, why_not  # noqa: E402
from physhdr.addon.session.state import DATASET, LOOK, PHOTOS, PythonChosen  # noqa: E402
from physhdr.addon.session.task import TaskEnded  # noqa: E402
from physhdr.addon.settings import photo_options  # noqa: E402

REPORT = {"versions": {"torch": "2.13.0", "pycolmap": "4.2.1"}, "missing": []}
#: Instead of backend/launch.py. What it does is written on a photo's name; what it was called with is kept.
LAUNCHER = """
import json, pathlib, sys, time
words = sys.argv[1:]
photos, out = pathlib.Path(words[1]), words[words.index("--out") + 1] if "--out" in words else ""
names = sorted(path.name for path in photos.iterdir())
calls = pathlib.Path(__file__).with_name("calls.json")
calls.write_text(json.dumps([*(json.loads(calls.read_text()) if calls.exists() else []), words]))
def say(**content):
    print(json.dumps(content), flush=True)
if not names:
    say(error={"code": "file_missing", "message": f"{photos} holds no photos", "hint": "Choose another."})
    sys.exit(1)
if "--look" in words:
    if "slowly.jpg" in names:
        time.sleep(60)
    lines = [f"{len(names)} photos of 640x480", "hand-held" if "--handheld" in words else "from a tripod"]
    skipped = [{"name": name, "why": "cannot be read"} for name in names if "bad" in name]
    say(result={"lines": lines, "warnings": ["automatic exposure"],
                "skipped": skipped, "estimate_seconds": 75.0})
    sys.exit(0)
say(progress=0.25, message="placing 1 of 2 photos", seconds_left=40.0)
if "slow.jpg" in names:
    time.sleep(60)
if "alone.jpg" in names:
    say(error={"code": "structure", "message": "only 1 of 2 places could be placed", "hint": "Take more."})
    sys.exit(1)
folder = pathlib.Path(out)
folder.mkdir(exist_ok="--overwrite" in words)
(folder / "prepare.json").write_text("{}")
say(progress=1.0, message="written")
say(result={"folder": out, "train": 1, "test": 1, "placed": 2, "places": 2,
            "lines": [f"wrote {out}: 1 place for training"], "warnings": ["ignored: bad.jpg"]})
"""


@pytest.fixture
def extension(registered, tmp_path, monkeypatch):
    """The session, with a backend that passed its check, and stands-in for the trainer."""
    from physhdr.addon import paths, runtime

    (tmp_path / "launch.py").write_text(LAUNCHER)
    monkeypatch.setattr(paths, "LAUNCHER", tmp_path / "launch.py")
    runtime.session().dispatch(PythonChosen(sys.executable, REPORT))
    return runtime.session()


@pytest.fixture
def photos(tmp_path):
    """A folder of two photos, as far as the stand-in for the backend looks."""
    folder = tmp_path / "church"
    folder.mkdir()
    for name in ("a.jpg", "b.jpg"):
        (folder / name).touch()
    return folder


def calls(tmp_path: Path) -> list[list[str]]:
    """The arguments of every call of the backend."""
    return json.loads((tmp_path / "calls.json").read_text())


def test_photos_are_looked_at_before_the_long_work(extension, photos, tmp_path):
    (photos / "bad.jpg").touch()
    assert bpy.ops.physhdr.photos_look(directory=str(photos)) == {"FINISHED"}
    assert calls(tmp_path) == [["prepare", str(photos), "--look", "--json"]]
    found, settings = extension.state.photos, bpy.context.scene.physhdr
    assert found.folder == settings.photos == str(photos) and found.seconds == 75.0
    assert found.lines == ("3 photos of 640x480", "from a tripod")
    assert found.warnings == ("automatic exposure", "Left out: bad.jpg, cannot be read")
    # Nothing has to be typed: the data set goes beside the photos, and nothing is there yet.
    assert settings.photos_out == str(tmp_path / "church_dataset")
    assert not Path(settings.photos_out).exists()
    assert next_step(extension.state, choices(bpy.context)) == "Prepare the photos"
    assert why_not(extension.state, "photos", choices(bpy.context)) == ""


def test_the_data_set_is_chosen_and_start_is_next(extension, photos, tmp_path):
    bpy.ops.physhdr.photos_look(directory=str(photos))
    settings = bpy.context.scene.physhdr
    settings.photos_handheld, settings.photos_width = True, 1200
    assert bpy.ops.physhdr.photos_prepare() == {"FINISHED"}
    out = str(tmp_path / "church_dataset")
    options = ["--handheld", "--max-width", "1200", "--camera", "OPENCV", "--json"]
    assert calls(tmp_path)[-1] == ["prepare", str(photos), "--out", out, *options]
    assert settings.data == out and settings.out == f"{out}_run"
    assert (settings.photos, extension.state.photos.folder) == ("", "")
    assert extension.state.prepared.warnings == ("ignored: bad.jpg",)
    assert extension.state.dataset.folder == out
    assert why_not(extension.state, "photos") == "Choose the folder of your photos"


def test_scripts_give_what_they_want_and_former_calls_do_not_count(extension, photos, tmp_path):
    out = tmp_path / "here"
    given = {"handheld": True, "borrow_poses": True, "max_width": 0, "bracket": 3, "partial": True}
    given |= {"same_exposure": True, "lens": "OPENCV_FISHEYE", "exposures": str(tmp_path / "seconds.csv")}
    made = bpy.ops.physhdr.photos_prepare(photos=str(photos), out=str(out), **given)
    assert made == {"FINISHED"} and (out / "prepare.json").exists()
    words = calls(tmp_path)[-1]
    looked = ["--handheld", "--bracket", "3", "--same-exposure", "--exposures", str(tmp_path / "seconds.csv")]
    made = ["--max-width", "0", "--camera", "OPENCV_FISHEYE", "--borrow-poses", "--partial", "--json"]
    assert words[4:] == [*looked, *made]
    assert bpy.ops.physhdr.photos_prepare(photos=str(photos), out=str(tmp_path / "there")) == {"FINISHED"}
    assert calls(tmp_path)[-1][4:] == ["--max-width", "1600", "--camera", "OPENCV", "--json"]
    # A folder that is taken is not proposed again.
    assert operators.proposed_folder(photos) == str(tmp_path / "church_dataset")
    (tmp_path / "church_dataset").mkdir()
    assert operators.proposed_folder(photos) == str(tmp_path / "church_dataset")
    (tmp_path / "church_dataset" / "kept").touch()
    assert operators.proposed_folder(photos) == str(tmp_path / "church_dataset_2")
    # A whole card has nothing beside it.
    assert Path(operators.proposed_folder(Path(tmp_path.anchor))).parent == Path.home()


def test_photos_under_other_light_are_a_list(extension, photos, tmp_path):
    from physhdr.addon import runtime

    for name in ("pendant off + daylight evening", "lamp 50%", "desk"):
        (tmp_path / name).mkdir()
    bpy.ops.physhdr.photos_look(directory=str(photos))
    settings = bpy.context.scene.physhdr
    for name in ("pendant off + daylight evening", "lamp 50%", "desk"):
        assert bpy.ops.physhdr.photos_light_add(directory=str(tmp_path / name)) == {"FINISHED"}
    both = tmp_path / "pendant off + daylight evening"
    wanted = [
        f"--light=pendant={both}:off",
        f"--light=daylight={both}:unknown",
        f"--light=lamp={tmp_path / 'lamp 50%'}:0.5000",
        f"--light=desk={tmp_path / 'desk'}:off",
    ]
    settings.photos_named_lights = False
    assert list(photo_options(settings).to_look) == [*wanted, "--light=none"]
    # What is added is looked at anew, as every other option that changes what photos mean.
    runtime._follow_photos(extension)
    assert extension.state.photos.options == (*wanted, "--light=none")
    extension.wait(lambda state: state.task(LOOK) is None, 60.0)
    bpy.ops.physhdr.photos_light_remove(number=2)
    settings.photos_named_lights = True
    assert bpy.ops.physhdr.photos_prepare() == {"FINISHED"}
    assert [word for word in calls(tmp_path)[-1] if word.startswith("--light")] == [*wanted[:2], wanted[3]]
    assert len(settings.photos_lights) == 0  # with the photos that it belonged to
    given = f"flash={tmp_path / 'desk'}:on"
    bpy.ops.physhdr.photos_prepare(photos=str(photos), out=str(tmp_path / "there"), lights=given)
    assert [word for word in calls(tmp_path)[-1] if word.startswith("--light")] == [f"--light={given}"]


def test_other_photos_have_other_lights(extension, photos, tmp_path):
    (tmp_path / "lamp_on").mkdir()
    (tmp_path / "hall").mkdir()
    (tmp_path / "hall" / "a.jpg").touch()
    bpy.ops.physhdr.photos_look(directory=str(photos))
    bpy.ops.physhdr.photos_light_add(directory=str(tmp_path / "lamp_on"))
    light = bpy.context.scene.physhdr.photos_lights[0]
    assert (light.light, light.word) == ("lamp", "on")
    bpy.ops.physhdr.photos_look(directory=str(photos))
    assert len(bpy.context.scene.physhdr.photos_lights) == 1
    bpy.ops.physhdr.photos_look(directory=str(tmp_path / "hall"))
    assert len(bpy.context.scene.physhdr.photos_lights) == 0


def test_a_folder_of_other_light_that_a_file_names_is_asked_for(extension, photos, tmp_path):
    """Nothing of a stranger's file is looked at before the user agrees, and paths move with the file."""
    bpy.ops.physhdr.photos_look(directory=str(photos))
    light = bpy.context.scene.physhdr.photos_lights.add()
    light.light, light["folder"] = "lamp", str(tmp_path / "elsewhere")  # as a file has it: nobody set it
    assert str(tmp_path / "elsewhere") in choices(bpy.context).not_looked_at
    light.folder = "//lamp"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    (tmp_path / "other").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other" / "mine.blend"))
    assert bpy.context.scene.physhdr.photos_lights[0].folder == "//../lamp"


def test_a_saved_file_has_the_data_set_beside_it(extension, photos, tmp_path):
    (tmp_path / "work").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work" / "mine.blend"))
    bpy.ops.physhdr.photos_look(directory=str(photos))
    assert bpy.context.scene.physhdr.photos_out == "//church_dataset"
    assert bpy.ops.physhdr.photos_prepare() == {"FINISHED"}
    assert bpy.context.scene.physhdr.data == str(tmp_path / "work" / "church_dataset")


def test_an_error_is_told_with_its_remedy_and_what_was_typed_stays(extension, photos, tmp_path):
    (photos / "alone.jpg").touch()
    bpy.ops.physhdr.photos_look(directory=str(photos))
    settings = bpy.context.scene.physhdr
    settings.photos_out = str(tmp_path / "typed")
    with pytest.raises(RuntimeError, match="only 1 of 2 places could be placed Take more"):
        bpy.ops.physhdr.photos_prepare()
    assert settings.photos == str(photos) and settings.photos_out == str(tmp_path / "typed")
    assert extension.state.photos.lines and settings.data == ""
    problem = problem_of(extension.state)
    assert problem is not None and problem.hint == "Take more." and Path(problem.log).exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"photos": ""}, "no folder is chosen for the photos"),
        ({"photos": "/no/such"}, "there is no folder /no/such"),
        ({"out": "//data"}, "not saved yet"),
        ({"out": "PHOTOS"}, "holds the photos"),
    ],
)
def test_mistakes_are_reported_before_anything_starts(extension, photos, tmp_path, change, told):
    given = {"photos": str(photos), "out": str(tmp_path / "data"), **change}
    given["out"] = given["out"].replace("PHOTOS", str(photos))
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.physhdr.photos_prepare(**given)
    assert not (tmp_path / "calls.json").exists()


def test_a_folder_without_photos_stands_beside_its_name(extension, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(RuntimeError, match=r"holds no photos: Choose another"):
        bpy.ops.physhdr.photos_look(directory=str(tmp_path / "empty"))
    assert extension.state.problem is None  # the panel shows it in the box of the photos
    assert "holds no photos" in extension.state.photos.problem.message
    assert next_step(extension.state, choices(bpy.context)) == "Choose another folder of photos"
    assert "holds no photos" in why_not(extension.state, "photos", choices(bpy.context))
    bpy.ops.physhdr.photos_forget()
    assert bpy.context.scene.physhdr.photos == "" and not extension.state.photos.folder


def test_progress_and_cancel_as_in_a_window(extension, photos, tmp_path):
    """Not waiting, the operator returns at once; the panel shows how far it is and how long it will take."""
    (photos / "slow.jpg").touch()
    began = time.monotonic()
    assert bpy.ops.physhdr.photos_prepare(photos=str(photos), wait=False) == {"FINISHED"}
    assert time.monotonic() - began < 2.0 and not bpy.ops.physhdr.photos_prepare.poll()
    assert extension.wait(lambda state: state.task(PHOTOS).seconds_left == 40.0, 20.0)
    task = extension.state.task(PHOTOS)
    assert (task.fraction, task.message) == (0.25, "placing 1 of 2 photos")
    assert headline(extension.state) == "Preparing the photos"
    bpy.ops.physhdr.task_cancel(name=PHOTOS)
    assert extension.wait(lambda state: state.task(PHOTOS) is None, 15.0)
    assert problem_of(extension.state) is None and not (tmp_path / "church_dataset").exists()
    (photos / "slow.jpg").unlink()
    assert bpy.ops.physhdr.photos_prepare(photos=str(photos)) == {"FINISHED"}


def test_another_option_is_looked_at_anew_by_the_timer(extension, photos, tmp_path):
    from physhdr.addon import runtime

    bpy.ops.physhdr.photos_look(directory=str(photos))
    runtime._follow_photos(extension)
    assert len(calls(tmp_path)) == 1  # nothing has changed
    bpy.context.scene.physhdr.photos_handheld = True
    runtime._follow_photos(extension)
    assert extension.wait(lambda state: state.task(LOOK) is None, 20.0)
    assert extension.state.photos.lines[-1] == "hand-held"
    assert calls(tmp_path)[-1] == ["prepare", str(photos), "--handheld", "--look", "--json"]


def test_choosing_and_leaving_photos_are_steps_of_undo(extension, photos):
    """Else undoing what comes next takes the choice away, or brings back what was left."""
    for operator in ("photos_look", "photos_forget"):
        assert "UNDO" in getattr(bpy.ops.physhdr, operator).bl_options


def test_a_look_that_is_cancelled_stays_so(extension, photos, tmp_path):
    from physhdr.addon import runtime

    (photos / "slowly.jpg").touch()
    bpy.ops.physhdr.photos_look(directory=str(photos), wait=False)
    bpy.ops.physhdr.task_cancel(name=LOOK)
    assert extension.wait(lambda state: state.task(LOOK) is None, 15.0)
    runtime._follow_photos(extension)
    assert extension.state.task(LOOK) is None
    assert "was cancelled" in extension.state.photos.warnings[0]


def test_a_file_that_is_saved_meanwhile_still_gets_its_data_set(extension, photos, tmp_path, monkeypatch):
    timers, pushed = [], []
    monkeypatch.setattr(operators.bpy.app.timers, "register", lambda call, **_: timers.append(call))
    monkeypatch.setattr(afterwards, "push_undo", pushed.append)
    bpy.context.scene.physhdr.photos = str(photos)
    bpy.ops.physhdr.photos_prepare(wait=False)
    bpy.context.scene.name = "Renamed meanwhile"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    assert extension.wait(lambda state: state.task(PHOTOS) is None, 20.0)
    assert [call() for call in timers] == [None]
    assert bpy.context.scene.physhdr.data == str(tmp_path / "church_dataset")
    assert pushed == ["Prepare Photos"]  # else undoing what comes next would leave the data set again


def test_a_data_set_that_is_rendered_meanwhile_is_not_taken_for_the_photos(
    extension, photos, tmp_path, monkeypatch
):
    timers = []
    monkeypatch.setattr(operators.bpy.app.timers, "register", lambda call, **_: timers.append(call))
    bpy.context.scene.physhdr.photos = str(photos)
    bpy.ops.physhdr.photos_prepare(wait=False)
    assert extension.wait(lambda state: state.task(PHOTOS) is None, 20.0)
    extension.dispatch(TaskEnded(DATASET, True, result={"folder": str(tmp_path / "rendered")}))
    assert [call() for call in timers] == [None]
    assert bpy.context.scene.physhdr.data == str(tmp_path / "church_dataset")


def test_without_a_backend_that_can_the_buttons_say_why(extension, photos):
    extension.dispatch(PythonChosen(sys.executable, {**REPORT, "missing": ["pycolmap>=4.0,<5"]}))
    assert bpy.ops.physhdr.photos_look.poll()  # looking needs no structure from motion
    with pytest.raises(RuntimeError, match=r"lacks pycolmap>=4.0,<5: add what is missing"):
        bpy.ops.physhdr.photos_prepare(photos=str(photos))
    extension.dispatch(PythonChosen(""))
    for operator in (bpy.ops.physhdr.photos_look, bpy.ops.physhdr.photos_prepare):
        with pytest.raises(RuntimeError, match="Install the backend"):
            operator()


INSTALLER = """
import json, pathlib, sys
pathlib.Path(__file__).with_name("installed.json").write_text(json.dumps(sys.argv[1:]))
environment = {environment!r}
print(json.dumps({{"result": {{"versions": {{}}, "missing": [], "environment": environment}}}}), flush=True)
"""


def test_what_is_missing_is_added_by_the_python_that_made_the_environment(
    extension, photos, tmp_path, monkeypatch
):
    import os
    import venv

    from physhdr.addon.operators import backend

    folder = tmp_path / "home" / "environment-0123"
    venv.EnvBuilder(with_pip=False, symlinks=os.name != "nt").create(folder)
    (tmp_path / "install.py").write_text(INSTALLER.format(environment=str(folder / "bin" / "python")))
    monkeypatch.setattr(backend, "INSTALL_SCRIPT", tmp_path / "install.py")
    bpy.context.preferences.system.use_online_access = True
    lacking = {"versions": {}, "missing": ["pycolmap>=4.0,<5"]}
    extension.dispatch(PythonChosen(sys.executable, lacking))
    with pytest.raises(RuntimeError, match="was not installed here: add to it by pip"):
        bpy.ops.physhdr.backend_extend()
    extension.dispatch(PythonChosen(str(folder / "bin" / "python"), lacking))
    assert bpy.ops.physhdr.backend_extend() == {"FINISHED"}
    words = json.loads((tmp_path / "installed.json").read_text())
    assert words == [
        "--target",
        str(tmp_path / "home"),
        "--launcher",
        str(tmp_path / "launch.py"),
        "--extend",
    ]
    assert extension.state.backend.missing == ()
    chosen = choices(bpy.context)
    assert why_not(extension.state, "photos", chosen) == "Choose the folder of your photos"
