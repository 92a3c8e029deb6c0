# SPDX-License-Identifier: GPL-3.0-or-later
"""Training as Blender steers it: start, pause, previews, stop, resume, kill −9; the result is the same."""

import dataclasses
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from physhdr.backend.cli import main
from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.methods.physhdr import PhysHDR
from physhdr.backend.methods.physhdr_common import PhysHDRConfig
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.runs.run import open_run
from physhdr.backend.serve import control
from physhdr.backend.serve import engine as engine_module
from physhdr.backend.serve import server as server_module
from physhdr.backend.serve.curves import Curves
from physhdr.backend.serve.inbox import Abandoned, Command, Inbox
from physhdr.backend.serve.preview import camera_of, render
from physhdr.backend.train.checkpoint import load_checkpoint, save_checkpoint
from physhdr.backend.train.config import read_config, write_config
from physhdr.backend.train.forecast import duration
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.connection import Connection
from physhdr.bridge.messages import (
    ControlTake,
    Done,
    Exported,
    History,
    HistoryGet,
    ModelExport,
    PreviewCamera,
    PreviewRequest,
    RunOpen,
    StatusGet,
    TrainContinue,
    TrainPause,
    TrainResume,
    TrainStart,
    TrainStop,
    Welcome,
    WhenClosed,
)
from physhdr.bridge.model_file import read_model
from physhdr.bridge.run_folder import VIEWS_FILE

ITERATIONS = 140  # densification is due at 100
CHECKPOINT = "checkpoint.safetensors"


@pytest.fixture(scope="module")
def whole_run(tiny_data, tmp_path_factory):
    """The same training by the command line, undisturbed, on one thread as the backend's.

    In a process of its own: what tests before this one have done to torch's threads moves the last bits.
    """
    folder = tmp_path_factory.mktemp("whole") / "run"
    physhdr = Path(sys.executable).with_name("physhdr")
    command = [physhdr, "train", tiny_data, "--out", folder, "--iterations", str(ITERATIONS)]
    subprocess.run([*command, "--threads", "1"], env=os.environ | {"OMP_NUM_THREADS": "1"}, check=True)
    return folder


def camera(size: int = 40, **changes) -> PreviewCamera:
    pose = (1, 0, 0, 0.1, 0, 0, -1, -4, 0, 1, 0, 0.2, 0, 0, 0, 1)
    fields = {"pose": tuple(map(float, pose)), "width": size, "height": size - 8, "fx": 45.0, "fy": 44.0}
    return PreviewCamera(**{**fields, "cx": 0.5 * size + 3.0, "cy": 0.5 * size - 5.0, **changes})


def assert_same_weights(first, second):
    one, other = (load_checkpoint(folder / CHECKPOINT) for folder in (first, second))
    assert one[1]["iteration"] == other[1]["iteration"] and one[0].keys() == other[0].keys()
    for name, tensor in one[0].items():
        assert torch.equal(tensor, other[0][name]), name


def start_of(data, out, iterations=ITERATIONS, **changes):
    return TrainStart(data=str(data), out=str(out), iterations=iterations, **changes)


def reach(peer, iteration):
    """Wait for an iteration, asking for previews all the while."""
    sequence = 0
    while peer.status.iteration < iteration and peer.status.state == "training":
        sequence += 1
        peer.preview(
            PreviewRequest(sequence=sequence, camera=camera(), tone=("linear", "learned")[sequence % 2])
        )
    assert sequence > 0


def test_a_steered_training_is_bit_identical(backend, enter, refusal, tiny_data, whole_run, tmp_path):
    """Previews all the time, a pause, an export, a stop, a resume by another client: the same weights."""
    out = tmp_path / "run"
    peer = enter(backend, "Blender")
    assert peer.ask(start_of(tiny_data, out)) == Done()
    assert peer.status.run == str(out) and peer.status.state == "preparing"  # known before the reply
    peer.wait_for("training", "failed")
    assert refusal(peer, start_of(tiny_data, tmp_path / "other")).code == "busy"
    reach(peer, 30)

    assert peer.ask(TrainPause()) == Done()
    assert peer.status.state == "paused"
    paused_at = peer.status.iteration
    frame = peer.preview(PreviewRequest(sequence=1000, camera=camera()))  # previews go on
    assert frame.header.iteration == paused_at
    time.sleep(0.5)
    assert peer.ask(StatusGet()).iteration == paused_at
    exported = peer.ask(ModelExport(path=str(tmp_path / "now.safetensors")))
    model = read_model(tmp_path / "now.safetensors")
    assert exported == Exported(path=exported.path, gaussians=model.count, iteration=paused_at)
    assert peer.ask(TrainContinue()) == Done() and peer.status.state == "training"

    reach(peer, 105)
    assert peer.ask(TrainStop()) == Done()
    stopped = peer.wait_for("stopped")
    assert 105 <= stopped.iteration == stopped.saved_iteration < ITERATIONS and stopped.has_model
    assert load_checkpoint(out / CHECKPOINT)[1]["iteration"] == str(stopped.iteration)
    peer.preview(PreviewRequest(sequence=2000, camera=camera()))
    assert refusal(peer, TrainStop()).code == "no_job"
    assert refusal(peer, TrainPause()).code == "no_job"

    other = enter(backend, "another Blender")
    other.ask(ControlTake())
    other.ask(TrainResume(run=str(out)))
    finished = other.wait_for("finished", "failed")
    assert finished.iteration == ITERATIONS and finished.saved_iteration == ITERATIONS
    assert finished.monitor["PSNR"] > 5.0 and finished.failure is None
    assert_same_weights(out, whole_run)

    history = other.ask(HistoryGet())
    assert history.iterations[0] == 20 and history.iterations[-1] == ITERATIONS  # both halves
    assert list(history.iterations) == sorted(set(history.iterations)) and history.psnr
    assert all(loss > 0 for loss in history.losses)
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [line["event"] for line in lines if line["event"] != "progress"] == [
        *("started", "saved", "finished"),
        *("started", "saved", "finished"),
    ]
    assert list((out / "tensorboard").iterdir())


@pytest.mark.long
def test_killed_in_the_middle_it_resumes_from_the_checkpoint(start, enter, tiny_data, whole_run, tmp_path):
    """kill −9: the file is whole, a new backend takes the home over, and the end is the same."""
    out, home = tmp_path / "run", tmp_path / "home"
    first = start(home=home)
    peer = enter(first)
    peer.ask(start_of(tiny_data, out))
    peer.until(lambda: peer.status.iteration >= 40)
    peer.ask(TrainStop())
    saved = peer.wait_for("stopped").iteration
    peer.ask(TrainResume(run=str(out)))
    peer.until(lambda: peer.status.iteration >= saved + 20)
    first.end(signal.SIGKILL)
    assert (home / "connection.json").exists()  # stale
    assert load_checkpoint(out / CHECKPOINT)[1]["iteration"] == str(saved)

    second = start(home=home)
    assert second.connection.token != first.connection.token
    peer = enter(second)
    peer.ask(TrainResume(run=str(out)))
    peer.until(lambda: peer.status.state == "training")
    assert peer.status.saved_iteration == saved
    peer.wait_for("finished", "failed")
    assert_same_weights(out, whole_run)
    iterations = peer.ask(HistoryGet()).iterations
    assert list(iterations) == sorted(set(iterations)) and iterations[-1] == ITERATIONS


def test_a_checkpoint_is_written_as_time_passes(tiny_data, tmp_path, monkeypatch):
    """Every minute of training (of a clock that runs a thousand times faster), and at the end."""
    saved = set()

    class Listener:
        def publish(self, status):
            saved.add(status.saved_iteration)

        def answer(self, command, message):
            assert message == Done()

    engine = engine_module.Engine(Inbox(), Listener(), Curves(), engine_module.Options())
    engine._attend(Command(1, "test", 1, start_of(tiny_data, tmp_path / "run", 60)))
    real, begun = time.perf_counter, time.perf_counter()
    monkeypatch.setattr(time, "perf_counter", lambda: begun + 1000.0 * (real() - begun))
    engine._do(engine._job)
    assert {0, 60} < saved  # the tests above saw that without it there is one at the end only


def test_a_training_that_learned_poses_says_how_far_they_moved(tiny_data, tmp_path, monkeypatch):
    """The engine by itself; these data are renders, of which poses are learned only when asked."""
    preset = PRESETS["default"]
    learns = dataclasses.replace(preset, poses="on")
    monkeypatch.setitem(PRESETS.own, "default", learns)
    told = []
    server = SimpleNamespace(publish=told.append, answer=lambda *answered: None, show=lambda *shown: None)
    engine = engine_module.Engine(Inbox(), server, Curves(), engine_module.Options(threads=1))
    engine._attend(Command(1, "test", 1, start_of(tiny_data, tmp_path / "run", 30)))
    engine._do(engine._job)
    assert told[-1].state == "finished"
    assert re.fullmatch(
        r"finished at iteration 30; poses moved by \d\.\d\d pixels .*, \S+ by \d\.\d\d",
        told[-1].message,
    )


@pytest.fixture(scope="module")
def runs(whole_run, tiny_data, tmp_path_factory):
    """A trained run of a preset, each trained once: one picture for both tones, local curves …"""
    folders = {"default": whole_run}

    def trained(preset):
        if preset not in folders:
            folders[preset] = tmp_path_factory.mktemp(preset)
            command = ["train", str(tiny_data), "--out", str(folders[preset]), "--preset", preset]
            if hasattr(PRESETS[preset].method, "tone_mapper"):
                command += ["--set", "method.tone_mapper.warm_start_steps=0"]
            assert main([*command, "--iterations", "12"]) == 0
        return folders[preset]

    return trained


def srgb_to_linear(codes):
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize(
    "preset",
    [
        "default",
        "paper",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("default-scaffold", "gausshdr-short", "hdr-gs-short")
        ),
    ],
)
def test_previews_are_the_methods_pictures(backend, enter, runs, tmp_path, preset):
    peer = enter(backend)
    peer.ask(ControlTake())
    assert peer.ask(RunOpen(run=str(runs(preset)))) == Done()
    method = open_run(runs(preset)).method
    assert peer.status.state == "open" and peer.status.has_model
    assert (
        peer.status.can_relight == method.can_relight == (preset in ("default", "paper", "default-scaffold"))
    )
    assert peer.status.lights == ("ambient",)
    assert peer.status.preset == preset and peer.status.gaussians > 0
    asked = camera()
    ours = camera_of(asked)
    for sequence, (level, ev) in enumerate([(1.0, 0.0), (2.5, 3.0), (0.0, -1.5)], start=1):
        request = PreviewRequest(sequence=sequence, camera=asked, lighting_levels=(level,), exposure_ev=ev)
        frame = peer.preview(request)
        hdr = method.hdr(ours, level).permute(1, 2, 0).numpy() * 2.0**ev
        np.testing.assert_array_equal(frame.rgba[..., :3], np.minimum(hdr, 65504.0).astype(np.float16))
        drawn = method.preview(ours, 1.0)
        np.testing.assert_array_equal(frame.rgba[..., 3], drawn.alpha.numpy().astype(np.float16))
        np.testing.assert_array_equal(frame.depth, drawn.depth.numpy())
        assert frame.depth.shape == (32, 40) and frame.rgba[..., 3].max() > 0.5

        learned = peer.preview(dataclasses.replace(request, sequence=sequence + 100, tone="learned"))
        ldr = method.ldr(ours, 2.0**ev, level).permute(1, 2, 0).numpy()
        alpha = frame.rgba[..., 3].astype(np.float32)
        opaque = alpha > 0.995
        expected = srgb_to_linear(ldr.clip(0, 1))
        np.testing.assert_allclose(learned.rgba[opaque, :3], expected[opaque], atol=4e-3)
        assert not learned.rgba[alpha == 0].any() and learned.rgba.min() >= 0.0
        np.testing.assert_array_equal(learned.depth, frame.depth)
    exported = peer.ask(ModelExport(path=str(tmp_path / "model.safetensors")))
    assert read_model(tmp_path / "model.safetensors").count == exported.gaussians > 0


def test_previews_by_several_lights(backend, enter, two_lights_data, tmp_path):
    run = tmp_path / "run"
    assert main(["train", str(two_lights_data), "--out", str(run), "--iterations", "3"]) == 0
    peer = enter(backend)
    peer.ask(ControlTake())
    peer.ask(RunOpen(run=str(run)))
    assert peer.status.lights == ("ambient", "pendant") and peer.status.can_relight
    method, ours = open_run(run).method, camera_of(camera())
    with torch.no_grad():  # three iterations: every share is still a third
        method.gaussians.light_share_logits += torch.tensor([1.0, -1.0])[None, :, None]
    whole = [(), (4.0,), (0.25, 8.0), (0.0, 0.0)]
    for levels in whole:
        request = PreviewRequest(sequence=1, camera=camera(), lighting_levels=levels)
        shown = render(method, request, 3).rgba[..., :3]
        expected = method.preview(ours, (*levels, 1.0, 1.0)[:2]).image.permute(1, 2, 0).numpy()
        np.testing.assert_array_equal(shown, expected.astype(np.float16))
        peer.preview(dataclasses.replace(request, sequence=2))
    path = tmp_path / "model.safetensors"
    assert isinstance(peer.ask(ModelExport(path=str(path))), Exported)
    assert read_model(path).lights == ("ambient", "pendant")
    number = peer.send(PreviewRequest(sequence=3, camera=camera(), lighting_levels=(1.0, 1.0, 1.0)))
    peer.until(lambda: number in peer.answers)
    refused = peer.answers.pop(number)
    assert refused.code == "bad_value" and "ambient, pendant" in str(refused)


def test_depth_is_that_of_a_single_gaussian():
    """In metres along the axis, not along the ray, whatever covers the pixel by however much."""
    far = np.array([[0.9, 3.0, 0.1], [50.0, 50.0, 0.0], [51.0, 50.0, 0.0], [50.0, 51.0, 0.0]])
    gaussians = initial_gaussians(
        far,
        np.zeros((4, 3)),
        sh_degree=0,
        opacity=0.4,
        largest=np.full(4, 0.05),
        ambient_share=0.5,
        context_size=0,
        seed=0,
    )
    method = PhysHDR(PhysHDRConfig(sh_degree=0), gaussians, MethodSetup((1.0, 0.7)))
    frame = render(method, PreviewRequest(sequence=1, camera=camera()), 5)
    row, column = np.unravel_index(frame.rgba[..., 3].argmax(), frame.depth.shape)
    assert 0.05 < frame.rgba[row, column, 3] < 0.45
    assert frame.depth[row, column] == pytest.approx(7.0, rel=1e-4)  # from y = −4 to y = 3
    x = 45.0 * (0.9 - 0.1) / 7.0 + 23.0
    y = 44.0 * (0.2 - 0.1) / 7.0 + 15.0
    assert abs(column + 0.5 - x) <= 1.0 and abs(row + 0.5 - y) <= 1.0  # the shift of the lens is in it


def test_previews_that_cannot_be_are_refused(backend, enter, runs):
    peer = enter(backend)
    peer.ask(RunOpen(run=str(runs("default"))))

    def refused(peer=peer, **changes):
        request = PreviewRequest(**{"sequence": 1, "camera": camera(), **changes})
        number = peer.send(request)
        peer.until(lambda: number in peer.answers)
        return peer.answers.pop(number).code

    good = camera().pose
    scaled = tuple(1.5 * value if i < 12 else value for i, value in enumerate(good))
    mirrored = tuple(-value if i in (0, 4, 8) else value for i, value in enumerate(good))
    for wrong in (
        camera(width=0),
        camera(height=-3),
        camera(width=4097),
        camera(width=4096, height=4096),
        camera(fx=0.0),
        camera(pose=good[:15]),
        camera(pose=scaled),
        camera(pose=mirrored),
    ):
        assert refused(camera=wrong) == "bad_value", wrong
    assert refused(lighting_levels=(-0.1,)) == refused(exposure_ev=1000.0) == "bad_value"
    assert refused(lighting_levels=(1.0, 1.0)) == "bad_value"  # the model has one light
    bent = tuple(value * 1.004 if i < 3 else value for i, value in enumerate(good))
    straight = peer.preview(PreviewRequest(sequence=2, camera=camera()))
    fixed = peer.preview(PreviewRequest(sequence=3, camera=camera(pose=bent)))
    np.testing.assert_allclose(fixed.depth, straight.depth, atol=0.05)


def test_only_the_newest_of_many_previews_is_rendered(backend, enter, runs):
    peer = enter(backend)
    peer.ask(RunOpen(run=str(runs("default"))))
    seen = len(peer.frames)
    numbers = [peer.send(PreviewRequest(sequence=i, camera=camera(400))) for i in range(40)]
    peer.until(lambda: len(peer.frames) - seen + sum(n in peer.answers for n in numbers) == 40)
    drawn = [frame.header.request.sequence for frame in peer.frames[seen:]]
    assert drawn == sorted(drawn) and drawn[-1] == 39 and len(drawn) < 40
    assert {peer.answers[n].code for n in numbers if n in peer.answers} == {"superseded"}


def test_two_clients_are_served_in_turn(backend, enter, runs):
    one, two = enter(backend, "one"), enter(backend, "two")
    one.ask(RunOpen(run=str(runs("default"))))
    two.until(lambda: two.status.state == "open")
    for sequence in range(5):
        requests = [PreviewRequest(sequence=10 * i + sequence, camera=camera(40 + 16 * i)) for i in range(2)]
        one.send(requests[0])
        two.send(requests[1])
        for peer, request in zip((one, two), requests, strict=True):
            count = sequence + 1
            peer.until(lambda peer=peer, count=count: len(peer.frames) == count)
            assert peer.frames[-1].header.request == request


def test_no_file_of_the_users_is_replaced_by_an_export(backend, enter, refusal, runs, tmp_path):
    """Neither by one who watches, whatever is there, nor by the one who steers, where it is no model."""
    steers, watches = enter(backend, "Blender"), enter(backend, "a script that watches")
    steers.ask(RunOpen(run=str(runs("default"))))
    other = tmp_path / "other"
    shutil.copytree(runs("paper"), other)
    notes, model = tmp_path / "notes.safetensors", tmp_path / "model.safetensors"
    notes.write_text("mine")
    checkpoint = (other / CHECKPOINT).read_bytes()
    steers.ask(ModelExport(path=str(model)))
    for path in (notes, other / CHECKPOINT, model, tmp_path / "new.safetensors"):
        before = path.read_bytes() if path.exists() else None
        assert refusal(watches, ModelExport(path=str(path))).code == "not_in_control"
        assert (path.read_bytes() if path.exists() else None) == before
    for path in (notes, other / CHECKPOINT):
        failure = refusal(steers, ModelExport(path=str(path)))
        assert failure.code == "output" and str(path) in failure.message and "another name" in failure.hint
    assert notes.read_text() == "mine" and (other / CHECKPOINT).read_bytes() == checkpoint
    assert isinstance(steers.ask(ModelExport(path=str(model))), Exported)  # its own is replaced
    watches.ask(ControlTake())
    assert isinstance(watches.ask(ModelExport(path=str(model))), Exported)


def test_an_export_into_the_run_says_where_its_cameras_are(backend, enter, refusal, runs, tmp_path):
    """Blender's import asks for that; elsewhere no file is written that nobody asked for."""
    run = shutil.copytree(runs("default"), tmp_path / "run")
    cameras, peer = run / "cameras.json", enter(backend, "Blender")
    cameras.unlink(missing_ok=True)
    peer.ask(RunOpen(run=str(run)))
    peer.ask(ModelExport(path=str(tmp_path / "elsewhere.safetensors")))
    assert not (tmp_path / "cameras.json").exists() and not cameras.exists()
    peer.ask(ModelExport(path=str(run / "model.safetensors")))
    views = json.loads((run / "views.json").read_text())["splits"]
    listed = {camera["img_name"] for camera in json.loads(cameras.read_text())}
    assert {view["name"] for view in views["train"]} <= listed
    cameras.write_text("another program's")
    model = (run / "model.safetensors").read_bytes()
    failure = refusal(peer, ModelExport(path=str(run / "model.safetensors")))
    assert failure.code == "output" and str(cameras) in failure.message
    assert cameras.read_text() == "another program's" and (run / "model.safetensors").read_bytes() == model


def test_a_failed_training_is_a_state_and_the_backend_lives_on(backend, enter, refusal, tiny_data, tmp_path):
    peer = enter(backend)
    damaged = tmp_path / "damaged"
    shutil.copytree(tiny_data, damaged)
    for picture in (damaged / "train").glob("r_0_*.png"):
        picture.write_bytes(picture.read_bytes()[:200])
    peer.ask(start_of(damaged, tmp_path / "out"))
    failed = peer.wait_for("failed", "finished")
    assert failed.failure.code == "file_damaged" and "r_0_" in failed.failure.message and failed.failure.hint
    assert not failed.has_model
    assert refusal(peer, ModelExport(path=str(tmp_path / "x.safetensors"))).code == "no_model"
    assert refusal(peer, PreviewRequest(sequence=1, camera=camera())).code == "no_model"

    run = tmp_path / "run"
    peer.ask(start_of(tiny_data, run, 30))
    peer.wait_for("finished", "failed")
    assert peer.status.failure is None
    assert refusal(peer, start_of(tiny_data, run, 30)).code == "data_mismatch"  # not replaced by mistake
    assert refusal(peer, ModelExport(path=str(tmp_path / "no folder" / "x.safetensors"))).code == "output"

    # A state that diverges: the error says so, and the checkpoint stays as it was.
    tensors, metadata = load_checkpoint(run / CHECKPOINT)
    tensors["networks.tone_mapper.b1"].fill_(3e38)
    save_checkpoint(run / CHECKPOINT, tensors, metadata | {"iteration": "10"})
    before = (run / CHECKPOINT).read_bytes()
    peer.ask(TrainResume(run=str(run)))
    peer.wait_for("preparing", "training")
    failed = peer.wait_for("failed", "finished")
    assert failed.failure.code == "training_diverged" and failed.state == "failed"
    assert (run / CHECKPOINT).read_bytes() == before
    peer.ask(start_of(tiny_data, run, 10, overwrite=True))
    peer.wait_for("preparing", "training")
    assert peer.wait_for("finished", "failed").state == "finished"


def test_a_path_that_fails_a_job_later_is_told_with_a_remedy(backend, enter, whole_run, tmp_path):
    """What could not be seen when it was taken on: a folder where the log of the run is to be written."""
    run = tmp_path / "run"
    shutil.copytree(whole_run, run)
    (run / "log.jsonl").unlink()
    (run / "log.jsonl").mkdir()
    peer = enter(backend)
    peer.ask(TrainResume(run=str(run)))
    peer.wait_for("preparing", "training")
    failed = peer.wait_for("failed", "finished")
    assert failed.failure.code == "output"
    assert f"{run / 'log.jsonl'}: Is a directory" in failed.failure.message
    assert failed.failure.hint.startswith("Make it writable, then resume the training")


def test_links_that_lead_to_themselves(backend, enter, refusal, tiny_data, tmp_path):
    """The server said "a bug in PhysHDR" of the RuntimeError that pathlib raises."""
    (tmp_path / "loop").symlink_to("loop")
    loop, peer = tmp_path / "loop", enter(backend)
    for request in (
        start_of(tiny_data, loop / "run"),
        start_of(loop, tmp_path / "run"),
        TrainResume(run=str(loop)),
        RunOpen(run=str(loop)),
    ):
        failure = refusal(peer, request)
        assert "loop" in failure.message and "bug" not in failure.message, failure
    peer.ask(start_of(tiny_data, loop))  # taken on: there is no run
    failure = peer.wait_for("failed", "finished").failure
    assert failure.code == "output" and "loop" in failure.message and failure.hint


def test_a_run_whose_data_have_moved_opens_with_their_new_place(backend, enter, refusal, tiny_data, tmp_path):
    moved = tmp_path / "moved"
    shutil.copytree(tiny_data, moved)
    peer = enter(backend)
    peer.ask(start_of(tiny_data, tmp_path / "run", 3))
    peer.wait_for("finished", "failed")
    config = tmp_path / "run" / "config.json"
    write_config(config, read_config(config).config, tmp_path / "gone", "default")
    assert peer.ask(RunOpen(run=str(tmp_path / "run"), data=str(moved))) == Done()
    assert peer.status.state == "open" and peer.status.iteration == 3 and peer.status.data == str(moved)
    assert "without" not in peer.status.message
    # Another data set is not taken for it: the pictures' names are the same, the cameras are not.
    other = tmp_path / "other"
    shutil.copytree(tiny_data, other)
    transforms = json.loads((other / "transforms_train.json").read_text())
    transforms["frames"][0]["transform_matrix"][2][3] += 0.5
    (other / "transforms_train.json").write_text(json.dumps(transforms))
    assert refusal(peer, RunOpen(run=str(tmp_path / "run"), data=str(other))).code == "data_mismatch"
    (tmp_path / "run" / VIEWS_FILE).unlink()  # and it cannot be looked at without
    failure = refusal(peer, RunOpen(run=str(tmp_path / "run")))
    assert failure.code == "file_missing" and VIEWS_FILE in failure.message and failure.hint
    assert peer.ask(StatusGet()).state == "open" and peer.status.has_model  # what was open stays


@pytest.mark.parametrize("preset", ["default", pytest.param("default-scaffold", marks=pytest.mark.long)])
def test_a_run_is_looked_at_without_its_data(backend, enter, refusal, tiny_data, runs, tmp_path, preset):
    """To the bit as with them: pictures, levels, the learned response, the exported model."""
    run, data = tmp_path / "run", tmp_path / "gone"
    shutil.copytree(runs(preset), run)
    write_config(run / "config.json", read_config(run / "config.json").config, data, preset)
    assert (run / VIEWS_FILE).is_file()
    peer, asked = enter(backend), PreviewRequest(sequence=1, camera=camera(), exposure_ev=1.0)
    asked = [dataclasses.replace(asked, tone=tone, lighting_levels=(2.0,)) for tone in ("linear", "learned")]
    seen = {}
    for name, where in (("with", str(tiny_data)), ("without", "")):
        assert peer.ask(RunOpen(run=str(run), data=where)) == Done()
        path = tmp_path / f"{name}.safetensors"
        assert peer.ask(ModelExport(path=str(path))).gaussians > 0
        seen[name] = [peer.preview(request).rgba for request in asked], read_model(path)
    assert peer.status.state == "open" and "without its data set" in peer.status.message
    assert peer.status.data == str(data)  # where it was
    for one, other in zip(*(seen[name][0] for name in seen), strict=True):
        assert one.any() and np.array_equal(one, other)
    one, other = (seen[name][1] for name in seen)
    assert one.exposures == other.exposures and np.array_equal(one.log_radiance_sh, other.log_radiance_sh)
    assert np.array_equal(one.tone_curve, other.tone_curve)
    # What needs the pictures says so.
    peer.ask(TrainResume(run=str(run)))
    failed = peer.wait_for("failed").failure
    assert failed.code == "file_missing" and str(data) in failed.message


def test_stopped_while_preparing_nothing_is_trained(backend, enter, tiny_data, tmp_path):
    peer = enter(backend)
    peer.send(start_of(tiny_data, tmp_path / "run", 100_000))
    peer.send(TrainStop())
    peer.wait_for("preparing")
    ended = peer.wait_for("idle", "stopped")
    assert ended.iteration < 1000
    peer.ask(StatusGet())


def test_a_stop_and_a_pause_do_not_wait_for_the_timing(tiny_data, tmp_path, monkeypatch):
    """The engine by itself, for a training whose timing takes a while: what is asked then is done at once."""
    monkeypatch.setattr(duration, "SHARE", math.inf)
    for asked, ended in ((TrainStop(), "idle"), (TrainPause(), "paused")):
        inbox, told, timed = Inbox(), [], []
        server = SimpleNamespace(publish=told.append, answer=lambda *answered: None, show=lambda *shown: None)
        engine = engine_module.Engine(inbox, server, Curves(), engine_module.Options(threads=1))

        def step(state, asked=asked, inbox=inbox, timed=timed, step=duration.step):
            timed.append(state.iteration)
            if len(timed) == 2:
                inbox.put(Command(1, "test", 1, asked))
            return step(state)

        with monkeypatch.context() as patched:
            patched.setattr(duration, "step", step)
            engine._obey(Command(1, "test", 0, start_of(tiny_data, tmp_path / ended, 30)))
            patched.setattr(engine, "wait", lambda engine=engine: engine._note_stop())  # the pause is reached
            engine._do(engine._job)
        states = [status.state for status in told]
        assert len(timed) >= 2 and ended in states
        if ended == "idle":
            assert len(timed) == 2 and "training" not in states  # of eight that would have been timed
        else:
            assert told[states.index("paused")].iteration == 0 and states[-1] == "stopped"


@pytest.mark.long
def test_training_ends_with_its_blender_if_so_wished(start, enter, tiny_data, tmp_path):
    """``keep`` (the default): it goes on. ``stop``: it is saved and stopped a few seconds later."""
    backend = start()
    peer = enter(backend, "Blender")
    peer.ask(start_of(tiny_data, tmp_path / "run", 100_000))
    peer.wait_for("training")
    peer.socket.close()
    peer = enter(backend, "a later Blender")
    assert peer.welcome.in_control and peer.status.state == "training"
    assert peer.ask(WhenClosed(training="stop")) == Done()
    peer.socket.close()
    deadline = time.monotonic() + 20.0
    while "training stops" not in backend.log.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.2)
    peer = enter(backend, "and later")
    stopped = peer.wait_for("stopped")
    assert stopped.saved_iteration == stopped.iteration > 0


@pytest.mark.parametrize(("taken_over", "stops"), [(False, True), (True, False)])
def test_who_takes_over_in_time_keeps_the_training(taken_over, stops, enter, monkeypatch):
    monkeypatch.setattr(control, "ABANDONED_SECONDS", 0.3)
    inbox = Inbox()
    welcome = Welcome(
        protocol=1, version="", pid=0, log="", device="", torch="", presets=(), in_control=False
    )
    server = server_module.Server(inbox, "secret", welcome, History)
    here = SimpleNamespace(connection=Connection(1, server.start(), "secret", 0, "", ""))
    first = enter(here)
    first.ask(WhenClosed(training="stop"))
    first.socket.close()
    if taken_over:
        enter(here)
    assert isinstance(inbox.wait(1.0), Abandoned) == stops
    server.close("the test is over")
