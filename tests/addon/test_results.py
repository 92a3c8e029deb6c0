# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr.results_evaluate`` and ``results_video`` through a child process that stands in for the backend.

It keeps to what both commands promise with ``--json``; tests/loop has the real ones.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.operators import backend, bake  # noqa: E402
from physhdr.addon.operators import results as operators  # noqa: E402
from physhdr.addon.session import results  # noqa: E402
from physhdr.addon.session.state import PythonChosen, Received, State, TaskStarted  # noqa: E402
from physhdr.bridge.messages import JobStatus  # noqa: E402
from physhdr.bridge.run_folder import VIEWS_FILE  # noqa: E402
from physhdr.bridge.shots import read_shots  # noqa: E402

REPORT = {"versions": {"torch": "2.13.0"}, "missing": []}
LAUNCHER = """
import json, pathlib, sys, time
words = sys.argv[1:]
here = pathlib.Path(__file__)
calls = here.with_name("calls.json")
calls.write_text(json.dumps([*(json.loads(calls.read_text()) if calls.exists() else []), words]))
def say(**content):
    print(json.dumps(content), flush=True)
say(progress=0.5, message="test/3", seconds_left=2.0)
if here.with_name("slow").exists():
    time.sleep(60)
if here.with_name("broken").exists():
    say(error={"code": "data_mismatch", "message": "no test views", "hint": "Take another data set."})
    sys.exit(1)
if words[0] == "evaluate":
    content = json.loads(here.with_name("evaluation.json").read_text())
    (pathlib.Path(words[1]) / "evaluation.json").write_text(json.dumps(content))
    say(result={"folder": words[1], "split": "test"})
elif words[0] == "export":
    out = pathlib.Path(words[2])
    out = out / "index.html" if "--web" in words else out
    out.parent.mkdir(exist_ok=True)
    out.write_text("page")
    say(result={"out": str(out)})
else:
    out = pathlib.Path(words[3])
    out.write_bytes(b"") if out.suffix else out.mkdir()
    say(result={"out": str(out), "frames": 2})
"""
EVALUATION = {
    "conditions": {"iteration": 2500},
    "scale_ratio": 1.19,
    "means": {
        "LDR-OE": {"psnr": 38.4, "ssim": 0.979, "lpips": None},
        "LDR-NE": {"psnr": 31.2, "ssim": 0.9, "lpips": 0.05},
        "HDR": {"psnr": 20.0, "ssim": 0.7, "lpips": None},
        "HDR, scale aligned": {"psnr": 21.0},
    },
    "relit_means": {"all": {"ours": 33.3}},
    "views": [{}, {}, {}],
}


@pytest.fixture
def extension(registered, tmp_path, monkeypatch):
    """The session, with a backend that passed its check, and a stand-in for the trainer."""
    from physhdr.addon import paths, runtime

    (tmp_path / "launch.py").write_text(LAUNCHER)
    (tmp_path / "evaluation.json").write_text(json.dumps(EVALUATION))
    monkeypatch.setattr(paths, "LAUNCHER", tmp_path / "launch.py")
    monkeypatch.setattr(operators, "encodes", lambda current: True)
    runtime.session().dispatch(PythonChosen(sys.executable, REPORT))
    return runtime.session()


@pytest.fixture
def run(tmp_path, extension) -> Path:
    """A run's folder that is chosen in the scene, with its data set."""
    data, folder = tmp_path / "data", tmp_path / "run"
    data.mkdir()
    folder.mkdir()
    (folder / "checkpoint.safetensors").touch()
    (folder / "config.json").write_text(json.dumps({"data": str(data)}))
    bpy.context.scene.physhdr.out = str(folder)
    return folder


def calls(tmp_path: Path) -> list[list[str]]:
    return json.loads((tmp_path / "calls.json").read_text())


# ---- evaluation ------------------------------------------------------------------------------------------


def test_an_evaluation_is_told_in_words_and_figures(extension, run, tmp_path):
    assert results.evaluation_of(str(run)) is None
    assert bpy.ops.physhdr.results_evaluate() == {"FINISHED"}
    assert calls(tmp_path) == [["evaluate", str(run), "--json"]]
    found = results.evaluation_of(str(run))
    assert (found.views, found.iteration, found.is_old) == (3, 2500, False)
    assert [(f.what, f.words, f.numbers) for f in found.figures] == [
        ("Learned Exposures", "excellent", "PSNR 38.4 dB, SSIM 0.979"),
        ("New Exposures", "close, softer detail", "PSNR 31.2 dB, SSIM 0.900, LPIPS 0.050"),
        ("HDR Radiance", "poor", "PSNR 20.0 dB, SSIM 0.700"),
        ("Other Light", "very close", "PSNR 33.3 dB"),
        ("Brightness", f"{math.log2(1.19):+.2f} stops from the true one", "× 1.190"),
    ]
    assert bpy.ops.physhdr.results_evaluate(lpips_weights="/w.npz") == {"FINISHED"}
    assert calls(tmp_path)[-1] == ["evaluate", str(run), "--lpips-weights", "/w.npz", "--json"]
    found = results.evaluation_of(str(run))
    later = time.time() + 10.0
    os.utime(run / "checkpoint.safetensors", (later, later))
    assert results.evaluation_of(str(run)).is_old


def test_a_data_set_that_moved_is_sent_along_and_one_that_is_gone_is_named(extension, run, tmp_path):
    (tmp_path / "data").rename(tmp_path / "moved")
    with pytest.raises(RuntimeError, match=r"not there any more: .*data[\s\S]*Choose in Data Set"):
        bpy.ops.physhdr.results_evaluate()
    bpy.context.scene.physhdr.data = str(tmp_path / "moved")
    assert bpy.ops.physhdr.results_evaluate() == {"FINISHED"}
    assert calls(tmp_path) == [["evaluate", str(run), "--data", str(tmp_path / "moved"), "--json"]]


def test_an_error_of_the_backend_is_reported_with_its_remedy(extension, run, tmp_path):
    (tmp_path / "broken").touch()
    with pytest.raises(RuntimeError, match="no test views Take another data set"):
        bpy.ops.physhdr.results_evaluate()
    assert extension.state.problem.log.endswith("evaluate.log")


def test_it_tells_how_far_it_is_and_can_be_cancelled(extension, run, tmp_path):
    (tmp_path / "slow").touch()
    assert bpy.ops.physhdr.results_evaluate(wait=False) == {"FINISHED"}
    assert extension.wait(lambda state: state.task("evaluate").fraction > 0.0, 30.0)
    task = extension.state.task("evaluate")
    assert (task.fraction, task.message, task.seconds_left) == (0.5, "test/3", 2.0)
    assert not bpy.ops.physhdr.results_evaluate.poll() and bpy.ops.physhdr.results_video.poll()
    assert bpy.ops.physhdr.task_cancel(name="evaluate") == {"FINISHED"}
    assert extension.wait(lambda state: state.task("evaluate") is None, 30.0)
    assert extension.state.problem is None and results.evaluation_of(str(run)) is None


# ---- a script that waits, and for longer than it may -----------------------------------------------------

SOONEST = 0.2


@pytest.fixture
def impatient(extension, tmp_path, monkeypatch):
    """The stand-in takes a minute, whatever it is asked for, and scripts wait for an instant."""
    (tmp_path / "slow").touch()
    monkeypatch.setattr(operators, "WAIT_SECONDS", SOONEST)
    monkeypatch.setattr(backend, "INSTALL_SECONDS", SOONEST)
    monkeypatch.setattr(backend, "CHECK_SECONDS", SOONEST)
    monkeypatch.setattr(bake, "WAIT_SECONDS", SOONEST)
    monkeypatch.setattr(backend, "INSTALL_SCRIPT", tmp_path / "launch.py")
    yield extension
    for task in extension.state.tasks:
        extension.cancel_task(task.name)
    assert extension.wait(lambda state: not state.tasks, 30.0)


def test_what_goes_on_is_not_told_as_done(impatient, run):
    """Each of them for an hour at least, in truth; and it does go on."""
    for task, call in {
        "evaluate": lambda: bpy.ops.physhdr.results_evaluate(wait=True),
        "video": lambda: bpy.ops.physhdr.results_video(path="SPLINE", wait=True),
        "check": lambda: bpy.ops.physhdr.backend_check(wait=True),
    }.items():
        with pytest.raises(RuntimeError, match=f"{task} has not ended within 0 s: see its log .*{task}.log"):
            call()
        assert impatient.state.task(task) and impatient.state.problem is None


def test_an_installation_that_goes_on_is_not_told_as_done(impatient):
    told = []
    operator = SimpleNamespace(report=lambda kind, text: told.append((kind, text)))
    done = backend.install(operator, Path(sys.executable), [], True, "The backend is installed")
    assert done == {"CANCELLED"} and impatient.state.task("install")
    assert len(told) == 1 and told[0][0] == {"ERROR"} and "install has not ended" in told[0][1]


def test_a_bake_that_takes_too_long_is_cancelled_with_its_files(impatient, run, make_model, write, tmp_path):
    """What it makes would be taken by nobody, and what it reads is removed."""
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())))
    bpy.context.object.data["physhdr_file"] = str(run / "model.safetensors")
    (run / VIEWS_FILE).write_text("{}")
    with pytest.raises(RuntimeError, match="bake has not ended"):
        bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "baked.ply"), wait=True)
    assert impatient.state.task("bake").cancelling
    assert impatient.wait(lambda state: not state.tasks, 30.0)
    assert not (tmp_path / "baked.ply").exists() and not list(Path(bpy.app.tempdir).glob("physhdr_bake_*"))


def test_what_another_version_wrote_is_passed_over(tmp_path):
    assert results.figures({}) == ()
    assert results.figures({"means": [], "relit_means": 3, "scale_ratio": "x"}) == ()
    assert results.figures({"means": {"HDR": {"psnr": None}, "LDR-OE": {"psnr": float("nan")}}}) == ()
    assert results.figures({"scale_ratio": 10**400}) == (), "no float holds it"
    (tmp_path / "checkpoint.safetensors").touch()
    (tmp_path / "evaluation.json").write_text("no json")
    assert results.evaluation_of(str(tmp_path)) is None


# ---- when ------------------------------------------------------------------------------------------------


def test_why_it_cannot_be_done(tmp_path):
    ready = State()
    assert "Install the backend" in results.why_not_on_run(ready, "evaluate")
    from physhdr.addon.session.transition import transition

    ready, _ = transition(ready, PythonChosen(sys.executable, REPORT))
    assert results.why_not_on_run(ready, "evaluate", str(tmp_path)) == ""
    assert "choose the folder of a run" in results.why_not_on_run(ready, "video", "")
    busy, _ = transition(ready, TaskStarted("video", ""))
    assert results.why_not_on_run(busy, "video") == "It is under way" and not results.why_not_on_run(
        busy, "evaluate"
    )
    checking, _ = transition(ready, TaskStarted("check", ""))
    assert results.why_not_on_run(checking, "video") == "Wait for the check to end"
    training, _ = transition(ready, Received(JobStatus(state="training", run=str(tmp_path))))
    assert "being trained" in results.why_not_on_run(training, "evaluate", str(tmp_path))
    assert results.why_not_on_run(training, "evaluate", str(tmp_path / "other")) == ""


def test_a_folder_without_a_run(extension, tmp_path):
    with pytest.raises(RuntimeError, match="choose the folder of a run, first"):
        bpy.ops.physhdr.results_evaluate()
    with pytest.raises(RuntimeError, match="no trained run in"):
        bpy.ops.physhdr.results_video(run_folder=str(tmp_path))


# ---- videos ----------------------------------------------------------------------------------------------


def camera_that_moves() -> bpy.types.Object:
    """Frames 1 to 3, 1 m to the right each, 90° wide at first and narrower then."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 3, 1
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 200, 100, 50
    scene.render.fps, scene.render.fps_base = 24, 1.0
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.scale = (2.0, 2.0, 2.0)  # which does nothing to what it sees
    for frame in (1, 3):
        camera.location = (float(frame), -4.0, 1.0)
        camera.data.angle_x = math.radians(90.0 if frame == 1 else 53.130102)
        camera.keyframe_insert("location", frame=frame)
        camera.data.keyframe_insert("lens", frame=frame)
    bpy.context.scene.frame_set(2)
    return camera


def test_a_video_follows_the_scenes_camera_its_lens_and_the_sliders(extension, run, tmp_path):
    camera_that_moves()
    settings = bpy.context.scene.physhdr
    for frame, (ev, level) in ((1, (-1.0, 2.0)), (3, (1.0, 0.0))):
        settings.exposure_ev, settings.lighting_level = ev, level
        settings.keyframe_insert("exposure_ev", frame=frame)
        settings.keyframe_insert("lighting_level", frame=frame)
    assert bpy.ops.physhdr.results_video(format="WEBP") == {"FINISHED"}
    assert bpy.context.scene.frame_current == 2, "the scene is as it was"
    [call] = calls(tmp_path)
    shots = Path(bpy.app.tempdir) / operators.SHOTS_FILE
    assert call == ["render", str(run), "--out", str(run / "video.webp"), "--camera", str(shots), "--json"]
    assert operators.made_of(str(run)) == str(run / "video.webp")
    found = read_shots(shots)
    assert (found.width, found.height, found.fps, len(found.frames)) == (100, 50, 24.0, 3)
    first, _, last = found.frames
    at_first = [[1, 0, 0, 1], [0, 1, 0, -4], [0, 0, 1, 1], [0, 0, 0, 1]]
    np.testing.assert_allclose(first.camera_to_world, at_first, atol=1e-6)
    np.testing.assert_allclose(last.camera_to_world[:3, 3], (3.0, -4.0, 1.0), atol=1e-6)
    # Half the width over the tangent of half the angle: tan 45° = 1, tan 26.565° = 0.5.
    np.testing.assert_allclose([first.fx, first.fy, last.fx], [50.0, 50.0, 100.0], rtol=1e-4)
    np.testing.assert_allclose([first.cx, first.cy], [50.0, 25.0])
    assert (first.exposure_ev, first.levels) == (-1.0, (2.0,))
    assert (last.exposure_ev, last.levels) == (1.0, (0.0,))
    assert bpy.ops.physhdr.results_video(format="WEBP") == {"FINISHED"}
    assert calls(tmp_path)[-1][3] == str(run / "video_2.webp"), "an earlier one is not written over"


def test_a_video_leaves_what_was_posed_without_keyframes(extension, run):
    """A frame that is set gives everything its keyed value, and the scene the camera of a marker."""
    scene, bound = bpy.context.scene, camera_that_moves()
    scene.timeline_markers.new("cut", frame=1).camera = bound
    ball = bpy.data.objects.new("ball", bpy.data.meshes.new("ball"))
    mine = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    rig = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    for each in (ball, mine, rig):
        scene.collection.objects.link(each)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones.new("a.b").tail = (0.0, 0.0, 1.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    paint = bpy.data.materials.new("paint").node_tree.nodes["Principled BSDF"].inputs["Roughness"]
    ball['a "b".c'] = 1.5
    bone, custom = rig.pose.bones["a.b"], '["a \\"b\\".c"]'
    keyed = [(ball, "location"), (ball, custom), (ball, "rotation_mode"), (bone, "scale")]
    for each, path in (*keyed, (paint, "default_value")):
        each.keyframe_insert(path, frame=0)
    ball.animation_data.action.layers[0].strips[0].channelbags[0].fcurves.new('modifiers["gone"].strength')
    ball.location, ball['a "b".c'], ball.rotation_mode = (5.0, 5.0, 5.0), 2.5, "ZYX"
    bone.scale, paint.default_value, scene.camera = (2.0, 2.0, 2.0), 0.75, mine
    for _ in range(2):
        assert bpy.ops.physhdr.results_video(format="WEBP") == {"FINISHED"}
        bpy.context.view_layer.update()
        assert tuple(ball.matrix_world.translation) == (5.0, 5.0, 5.0)
        assert (ball['a "b".c'], ball.rotation_mode, paint.default_value) == (2.5, "ZYX", 0.75)
        assert tuple(bone.scale) == (2.0, 2.0, 2.0)
        assert (scene.frame_current, scene.camera) == (2, mine)
    scene.frame_set(3)  # the keyframes are there all the same
    assert tuple(ball.location) == (0.0, 0.0, 0.0) and scene.camera == bound


@pytest.mark.parametrize(
    ("format", "given", "written"),
    [
        ("WEBP", "take1.5", "take1.5.webp"),
        ("WEBP", "old.mp4", "old.webp"),
        ("WEBP", "x.WEBP", "x.WEBP"),
        ("PNG", "v1.2", "v1.2"),
        ("PNG", "old.mp4", "old"),
    ],
)
def test_a_video_is_written_where_it_was_said(extension, run, tmp_path, format, given, written):
    camera_that_moves()
    operator = bpy.ops.physhdr.results_video
    assert operator(format=format, filepath=str(tmp_path / given)) == {"FINISHED"}
    assert calls(tmp_path)[-1][2:4] == ["--out", str(tmp_path / written)]
    with pytest.raises(RuntimeError, match="is not saved yet"):  # else it were the root of the disk
        operator(format=format, filepath=f"//{given}")


def test_where_the_model_stands_is_taken_out_of_the_camera(extension, run, tmp_path, make_model):
    """A model that stands 10 m away, twice as large, looks as it does at home from half as far."""
    from physhdr.addon.model.model_import import import_model
    from physhdr.addon.model.nodes import EXPOSURE, LIGHTING_LEVEL, find_modifier, set_input
    from physhdr.bridge.model_file import write_model

    write_model(run / "model.safetensors", make_model())
    target = import_model(run / "model.safetensors")
    target.location, target.scale = (10.0, 0.0, 0.0), (2.0, 2.0, 2.0)
    set_input(find_modifier(target), EXPOSURE, 1.5)
    set_input(find_modifier(target), LIGHTING_LEVEL, 0.25)
    camera_that_moves()
    assert bpy.ops.physhdr.results_video(format="PNG") == {"FINISHED"}
    assert calls(tmp_path)[-1][2:4] == ["--out", str(run / "video")]
    shot = read_shots(Path(bpy.app.tempdir) / operators.SHOTS_FILE).frames[0]
    np.testing.assert_allclose(shot.camera_to_world[:3, 3], ((1.0 - 10.0) / 2, -2.0, 0.5), atol=1e-6)
    np.testing.assert_allclose(shot.camera_to_world[:3, :3], np.eye(3), atol=1e-6)
    assert (shot.exposure_ev, shot.levels) == (1.5, (0.25,))
    (tmp_path / "link").symlink_to(run)
    assert operators.filmed(bpy.context, str(tmp_path / "link"), "") == target
    assert operators.filmed(bpy.context, str(tmp_path), "") is None


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (1.0, 3.0, 1.0), (0.0, 0.0, 0.0)])
def test_a_model_that_no_camera_sees_alike_is_not_filmed(extension, run, tmp_path, make_model, scale):
    """A mirrored one would be filmed the other way round, a sheared one not at all."""
    from physhdr.addon.model.model_import import import_model
    from physhdr.bridge.model_file import write_model

    write_model(run / "model.safetensors", make_model())
    import_model(run / "model.safetensors").scale = scale
    camera_that_moves()
    with pytest.raises(RuntimeError, match=r"the model is (mirrored or flat|scaled differently)"):
        bpy.ops.physhdr.results_video(format="PNG")


def test_the_videos_dialog_says_what_0_means():
    drawn = {}
    column = SimpleNamespace(prop=lambda _, name, text="": drawn.update({name: text}))
    layout = SimpleNamespace(column=lambda: column)
    for path, width, exposure, words in (
        ("CAMERA", 0, 0.0, ("Width (0: as rendered)", "Exposure (0: middle)")),
        ("ORBIT", 0, 0.0, ("Width (0: as photos)", "Exposure (0: middle)")),
        ("ORBIT", 640, 0.5, ("Width", "Exposure (s)")),
    ):
        dialog = SimpleNamespace(layout=layout, path=path, width=width, exposure=exposure)
        operators.PHYSHDR_OT_results_video.draw(dialog, bpy.context)
        assert (drawn["width"], drawn["exposure"]) == words


def test_a_video_past_the_photographs_is_asked_of_the_trainer(extension, run, tmp_path):
    out = tmp_path / "orbit"
    options = {"path": "ORBIT", "sweep": "lighting", "seconds": 2.5, "fps": 25, "width": 320}
    assert bpy.ops.physhdr.results_video(filepath=str(out), exposure=0.5, **options) == {"FINISHED"}
    told = ["--path", "orbit", "--sweep", "lighting", "--seconds", "2.5", "--fps", "25", "--width", "320"]
    assert calls(tmp_path) == [
        ["render", str(run), "--out", f"{out}.mp4", *told, "--exposure", "0.5", "--json"]
    ]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda camera: bpy.data.objects.remove(camera), "the scene has no camera"),
        (lambda camera: setattr(camera.data, "type", "PANO"), "not a perspective camera"),
        (
            lambda camera: (camera.animation_data_clear(), camera.data.animation_data_clear()),
            "nothing is animated",
        ),
    ],
)
def test_what_cannot_be_filmed(extension, run, spoil, message):
    spoil(camera_that_moves())
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.physhdr.results_video()
    assert bpy.context.scene.frame_current == 2


def test_without_an_encoder_it_says_what_to_take(extension, run, monkeypatch):
    monkeypatch.undo()
    extension.dispatch(PythonChosen(str(run / "no_python"), REPORT))
    with pytest.raises(RuntimeError, match=r"no package av[\s\S]*WebP or Pictures"):
        bpy.ops.physhdr.results_video(path="ORBIT")
    with pytest.raises(RuntimeError, match="nothing moves"):
        bpy.ops.physhdr.results_video(path="STILL", format="WEBP")


# ---- web pages -------------------------------------------------------------------------------------------


@pytest.fixture
def opened(monkeypatch) -> list[str]:
    """The addresses that a browser was asked for."""
    addresses: list[str] = []
    monkeypatch.setattr(operators.webbrowser, "open", addresses.append)
    return addresses


def test_a_web_page_is_written_and_opens(extension, run, tmp_path, opened):
    assert operators.page_of(str(run)) == ""
    assert bpy.ops.physhdr.results_web() == {"FINISHED"}
    assert calls(tmp_path) == [["export", str(run), str(run / "web.html"), "--json"]]
    assert operators.page_of(str(run)) == str(run / "web.html")
    assert opened == [], "a script has no use for a browser"
    assert bpy.ops.physhdr.results_web(single_file=False, show=True) == {"FINISHED"}
    assert calls(tmp_path)[-1] == ["export", str(run), str(run / "web"), "--web", "--json"]
    assert opened == [(run / "web" / "index.html").as_uri()]
    assert operators.page_of(str(run)) == str(run / "web" / "index.html")


def test_a_web_page_that_failed_does_not_open(extension, run, tmp_path, opened):
    (run / "web.html").write_text("an older one")
    os.utime(run / "web.html", (time.time() - 60.0,) * 2)
    (tmp_path / "broken").touch()
    with pytest.raises(RuntimeError, match="no test views"):
        bpy.ops.physhdr.results_web(show=True)
    assert opened == []


def test_a_web_page_opens_once_it_is_there(extension, run, tmp_path, opened, monkeypatch):
    looks = []
    monkeypatch.setattr(operators, "take_when_ended", lambda task, take, message: looks.append((task, take)))
    assert bpy.ops.physhdr.results_web(wait=False, show=True) == {"FINISHED"}
    assert extension.wait(lambda state: state.task("web") is None, 30.0)
    [(task, take)] = looks
    assert task == "web" and opened == []
    assert take() is False, "nothing in the scene is to be undone"
    assert opened == [(run / "web.html").as_uri()]


@pytest.mark.parametrize(
    ("single", "given", "written"),
    [(True, "a.b", "a.b.html"), (True, "a.HTM", "a.HTM"), (False, "site", "site"), (False, "a.html", "a")],
)
def test_a_web_page_is_written_where_it_was_said(extension, run, tmp_path, single, given, written):
    done = bpy.ops.physhdr.results_web(single_file=single, filepath=str(tmp_path / given))
    assert done == {"FINISHED"}
    assert calls(tmp_path)[-1][2] == str(tmp_path / written)


def test_a_light_whose_name_begins_with_a_dash_is_not_taken_for_an_option() -> None:
    words = results.bake_command("m", "o.ply", "run", 1.0, {"-key": 0.5, "lamp": 2.0}, "SRGB")
    assert words[-3:] == ["--lighting-levels", " -key=0.5", "lamp=2"]
