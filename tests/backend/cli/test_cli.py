# SPDX-License-Identifier: GPL-3.0-or-later
"""The command as a user calls it: what it writes, and one clear message for everything that can be wrong."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image
from plyfile import PlyData

from physhdr.backend.cli import main
from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.runs.run import open_run
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.bridge.model_file import read_model
from physhdr.bridge.ply_model import read_ply_model

#: The command, in a process of its own.
MAIN = "import sys; from physhdr.backend.cli import main; sys.exit(main())"
SHORT = ["--iterations", "30", "--set", "sh_degree_every=5"]


@pytest.fixture(
    scope="module",
    params=[
        "default",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("paper", "baseline", "fast")),
    ],
)
def run(request, tiny_data, tmp_path_factory):
    """A short run of each preset, trained by the command."""
    folder = tmp_path_factory.mktemp("runs") / request.param
    assert main(["train", str(tiny_data), "--out", str(folder), "--preset", request.param, *SHORT]) == 0
    return folder


def fails(capsys, *argv):
    """Run a command that must fail; returns its message, which must be clean."""
    status = main([str(word) for word in argv])
    message = capsys.readouterr().err
    assert status == 1 and message.startswith("error: ") and "Traceback" not in message
    return message


def test_training_leaves_configuration_checkpoint_and_logs(run):
    events = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert [event["event"] for event in events] == ["started", "progress", "progress", "saved", "finished"]
    assert events[2]["iteration"] == 30 and events[2]["monitor"]["PSNR"] > 5
    assert list((run / "tensorboard").iterdir())
    assert json.loads((run / "config.json").read_text())["config"]["iterations"] == 30


def test_evaluation_is_printed_and_saved(run, capsys):
    assert main(["evaluate", str(run)]) == 0
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("LDR-OE", "LDR-NE", "HDR", "LPIPS left out"))
    assert json.loads((run / "evaluation.json").read_text())["format"] == "physhdr-evaluation"
    assert Image.open(run / "comparison.png").size[0] > 300


def test_the_model_file_renders_as_the_method(run):
    """In Blender radiance comes from the file alone; it must be the method's own."""
    assert main(["export", str(run)]) == 0
    opened = open_run(run)
    model = read_model(run / "model.safetensors")
    camera = opened.scene.test[0].camera
    directions = model.position - camera.position
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    with torch.no_grad():
        splats = opened.method.gaussians.splats(camera, opened.method.active_sh_degree)
        exact = opened.method.composes_by_product
        ours = opened.method.radiance_of(splats, None).numpy()
        np.testing.assert_allclose(model.radiance(directions), ours, rtol=1e-3 if exact else 0.05)
        if not opened.method.can_relight:
            relit = 2.0 * ours
        elif exact:
            relit = opened.method.radiance_of(splats, (2.0,)).numpy()
        else:  # the file relights radiance at level 1 by φ's gain: c · ĉ(2)/ĉ(1)
            gain = opened.method.radiance_of(splats, (2.0,)) / opened.method.radiance_of(splats, (1.0,))
            relit = ours * gain.numpy()
        np.testing.assert_allclose(model.radiance(directions, 2.0), relit, rtol=1e-3 if exact else 0.06)


def test_the_lossless_ply_holds_the_whole_model(run, lossless):
    assert main(["export", str(run)]) == 0
    opened = open_run(run)
    ply = PlyData.read(str(run / "lossless.ply"))
    vertices = ply["vertex"]
    columns = {p.name: np.array(vertices[p.name]) for p in vertices.properties}
    gaussians = lossless.parameters_from_columns(columns)
    method = type(opened.method)(opened.config.method, gaussians, MethodSetup(opened.scene.response_anchor))
    method.load_state_dict(lossless.networks_from_comments(ply.comments))
    method.active_sh_degree = opened.method.active_sh_degree
    camera = opened.scene.test[0].camera
    assert torch.equal(method.ldr(camera, 2.0), opened.method.ldr(camera, 2.0))


def test_the_quick_standard_ply_is_each_gaussians_look(run):
    """A viewer blends display colours; where one Gaussian dominates, that is our own picture."""
    assert main(["export", str(run), "--quick", "--exposure-ev", "3", "--lighting-level", "2"]) == 0
    opened = open_run(run)
    vertices = PlyData.read(str(run / "baked.ply"))["vertex"]
    assert [p.name for p in vertices.properties][:6] == ["x", "y", "z", "nx", "ny", "nz"]
    dc = np.stack([vertices[f"f_dc_{c}"] for c in range(3)], axis=1)
    colour = 0.28209479177387814 * dc + 0.5  # the mean over directions
    model = read_model(run / "model.safetensors")
    rng = np.random.default_rng(0)
    total = np.zeros_like(colour)
    for direction in rng.normal(size=(200, 3)):
        toward = np.broadcast_to(direction / np.linalg.norm(direction), (model.count, 3))
        x = torch.tensor(np.log(model.radiance(toward, 2.0) * 8.0).T, dtype=torch.float32)
        with torch.no_grad():
            total += opened.method.tone_mapper.curve_logits(x.contiguous()).sigmoid().T.numpy()
    np.testing.assert_allclose(colour, total / 200, atol=0.03)


def test_the_standard_ply_shows_our_picture(run, viewer):
    """As 3DGS draws it: by the reference in float64, of a file that plyfile reads, from a test camera.

    These 60 Gaussians cover little; where nothing is, a viewer is black and the response of no light is not.
    """
    opened = open_run(run)
    camera = opened.scene.test[0].camera
    with torch.no_grad():
        own = opened.method.ldr(camera, 8.0, 2.0).double()
    far = []
    for words in ([], ["--quick"]):
        assert main(["export", str(run), *words, "--exposure-ev", "3", "--lighting-level", "2"]) == 0
        ply = PlyData.read(str(run / "baked.ply"))
        assert any("fitted to pictures" in line for line in ply.comments) == (not words)
        shown = viewer.viewed(ply["vertex"], camera)
        far.append(float((shown.clamp(0.0, 1.0) - own).square().mean().sqrt()))
    assert far[0] < 0.35 * far[1], far


def test_render_writes_radiance_and_pictures(run, tmp_path):
    assert main(["render", str(run), "--out", str(tmp_path / "a.exr"), "--lighting-level", "2"]) == 0
    assert (
        main(["render", str(run), "--out", str(tmp_path / "a.png"), "--exposure", "8", "--width", "50"]) == 0
    )
    opened = open_run(run)
    radiance = OpenEXR.File(str(tmp_path / "a.exr")).channels()["RGB"].pixels
    expected = opened.method.hdr(opened.scene.test[0].camera, 2.0).numpy().transpose(1, 2, 0)
    np.testing.assert_array_equal(radiance, expected)
    assert Image.open(tmp_path / "a.png").size == (50, 50)


def test_several_lights_from_training_to_files(two_lights_data, tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", str(two_lights_data), "--out", str(run), *SHORT]) == 0
    method = open_run(run).method
    assert method.lights == ("ambient", "pendant")

    picture = tmp_path / "a.exr"
    render = ["render", str(run), "--out", str(picture)]
    camera = open_run(run).scene.test[0].camera
    for words, levels in [
        (["--lighting-levels", "ambient=4", "pendant=0.25"], (4.0, 0.25)),
        (["--lighting-level", "0.5", "--lighting-levels", "pendant=8"], (0.5, 8.0)),
        (["--lighting-levels", "pendant=0"], (1.0, 0.0)),
        (["--lighting-level", "0"], (0.0, 1.0)),
    ]:
        assert main([*render, *words]) == 0
        radiance = OpenEXR.File(str(picture)).channels()["RGB"].pixels
        np.testing.assert_array_equal(radiance, method.hdr(camera, levels).numpy().transpose(1, 2, 0))

    asked = [*render, "--lighting-levels"]
    assert "The lights are: ambient, pendant" in fails(capsys, *asked, "pendant")
    assert "The lights are" in fails(capsys, *asked, "pendant=bright")
    message = fails(capsys, *asked, "sun=2")
    assert "no light 'sun'" in message and "ambient, pendant" in message
    assert "pendant" in fails(capsys, *asked, "pendant=-1")
    assert "twice" in fails(capsys, *render, "--lighting-level", "2", "--lighting-levels", "ambient=3")

    assert main(["export", str(run), "--lighting-levels", "pendant=0.25"]) == 0
    model = read_model(run / "model.safetensors")
    assert model.lights == ("ambient", "pendant")
    lossless = read_ply_model(run / "lossless.ply").model
    assert lossless.lights == model.lights
    np.testing.assert_allclose(lossless.light_share, model.light_share, rtol=1e-5, atol=1e-6)
    comments = PlyData.read(str(run / "baked.ply")).comments
    assert any(line.endswith("lighting levels ambient 1 + pendant 0.25") for line in comments)

    capsys.readouterr()
    assert main(["evaluate", str(run)]) == 0
    printed = capsys.readouterr().out
    assert "ambient 0.5" in printed and "ambient 0…" not in printed  # on 80 columns, a name is not cut off
    assert "| ambient 0.5 + pendant 2 |" in (run / "evaluation.md").read_text()
    rows = json.loads((run / "evaluation.json").read_text())["relit"]
    assert [row["levels"] for row in rows][2] == {"ambient": 8.0, "pendant": 0.0}


def test_an_interrupt_saves_and_resume_finishes(tiny_data, tmp_path):
    """A real CTRL-C; other signals, and repeated ones: tests/bridge/test_signals.py."""
    folder = tmp_path / "run"
    physhdr = Path(sys.executable).with_name("physhdr")
    command = [physhdr, "train", tiny_data, "--out", folder]
    process = subprocess.Popen([str(c) for c in command] + ["--iterations", "150"], stdout=subprocess.PIPE)
    deadline = time.monotonic() + 120
    while not (folder / "log.jsonl").exists() or '"progress"' not in (folder / "log.jsonl").read_text():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 130 and b"--resume" in output
    stopped_at = int(load_checkpoint(folder / "checkpoint.safetensors")[1]["iteration"])
    assert 0 < stopped_at < 150
    assert main(["train", "--resume", str(folder)]) == 0
    assert load_checkpoint(folder / "checkpoint.safetensors")[1]["iteration"] == "150"


def test_an_option_that_a_resumed_run_would_not_read_is_refused(run, tiny_data, capsys):
    """Its own configuration is used: whoever types another number of iterations would never know."""
    for words in (
        ["--iterations", "60"],
        ["--set", "backbone.budget=9"],
        ["--set", "method.loss.unit_weight=1"],
        ["--preset", "paper"],
        ["--out", str(run)],
        ["--overwrite"],
    ):
        message = fails(capsys, "train", "--resume", run, "--threads", "1", *words)
        option = " ".join(words[:2]).partition("=")[0] if words[0] == "--set" else words[0]
        assert f"{option} has no effect" in message and "--checkpoint-seconds have an effect" in message
    read = ["--rasteriser", "cpu", "--device", "cpu", "--threads", "1", "--checkpoint_seconds", "9"]
    assert main(["train", "--resume", str(run), *read, "--", str(tiny_data)]) == 0


def test_a_run_is_not_overwritten_by_mistake(tiny_data, tmp_path, capsys):
    command = ["train", str(tiny_data), "--out", str(tmp_path), "--iterations", "3"]
    assert main(command) == 0
    before = (tmp_path / "checkpoint.safetensors").read_bytes()
    assert "--overwrite" in fails(capsys, *command)
    assert (tmp_path / "checkpoint.safetensors").read_bytes() == before
    assert main([*command, "--overwrite", "--seed", "1"]) == 0
    assert (tmp_path / "checkpoint.safetensors").read_bytes() != before


@pytest.mark.skipif(sys.platform != "linux", reason="only there are names any bytes")
def test_names_that_are_no_text_are_refused_before_anything_is_done(tiny_data, tmp_path, capsys, monkeypatch):
    """Safetensors cannot save under them: a training would have come to its end and been lost."""
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/run\xff"))
    message = fails(capsys, "train", tiny_data, "--out", odd, "--iterations", "3")
    assert "not UTF-8" in message and "run\\udcff" in message and not odd.exists()
    odd.mkdir()
    monkeypatch.chdir(odd)  # the same by another way
    assert "not UTF-8" in fails(capsys, "train", tiny_data, "--out", "run", "--iterations", "3")
    assert list(odd.iterdir()) == []
    assert "not UTF-8" in fails(capsys, "evaluate", odd)


def test_bad_input_is_one_clear_message(tiny_data, tmp_path, capsys):
    out = tmp_path / "out"
    train = ("train", tiny_data, "--out", out)
    assert "does not exist" in fails(capsys, "train", tmp_path / "nothing", "--out", out)
    (tmp_path / "empty").mkdir()
    assert "empty" in fails(capsys, "train", tmp_path / "empty", "--out", out)
    assert "'nonsense'" in fails(capsys, *train, "--preset", "nonsense")
    assert "--out" in fails(capsys, "train", tiny_data)
    assert "f_mix" in fails(capsys, *train, "--preset", "paper", "--set", "method.tone_mapper.local=false")
    assert "iterations" in fails(capsys, *train, "--iterations", "0")
    (tmp_path / "file").touch()
    assert "cannot write" in fails(capsys, "train", tiny_data, "--out", tmp_path / "file" / "run")
    assert "config.json" in fails(capsys, "evaluate", tmp_path / "empty")
    assert not out.exists()

    damaged = tmp_path / "damaged"
    shutil.copytree(tiny_data, damaged)
    picture = damaged / "train" / "r_0_2.png"
    picture.write_bytes(picture.read_bytes()[:200])
    assert "r_0_2.png" in fails(capsys, "train", damaged, "--out", out, *SHORT)


def test_render_and_export_refuse_bad_values(tiny_data, tmp_path, capsys):
    assert main(["train", str(tiny_data), "--out", str(tmp_path), "--iterations", "2"]) == 0
    render = ("render", tmp_path, "--out")
    assert ".exr or .png" in fails(capsys, *render, tmp_path / "x.jpg")
    assert "test/3" in fails(capsys, *render, tmp_path / "x.png", "--view", "third")
    assert "no pose 99" in fails(capsys, *render, tmp_path / "x.png", "--view", "test/99")
    assert "--lighting-level" in fails(capsys, *render, tmp_path / "x.png", "--lighting-level", "-1")
    assert "--exposure" in fails(capsys, *render, tmp_path / "x.png", "--exposure", "0")
    assert "lighting level" in fails(capsys, "export", tmp_path, "--lighting-level", "-1")
    if not torch.cuda.is_available():
        message = fails(capsys, *render, tmp_path / "x.png", "--device", "cuda")
        assert "cannot compute on CUDA" in message
    assert not list(tmp_path.glob("x.*"))


def test_the_version_is_said(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"physhdr \d+\.\d+\.\d+\n", capsys.readouterr().out)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has another error for it")
@pytest.mark.parametrize(
    "words",
    [
        ["--version"],
        pytest.param(["train", "--help"], marks=pytest.mark.long),
        pytest.param(["inspect", "{data}"], marks=pytest.mark.long),
    ],
)
def test_a_reader_that_has_enough_is_no_error(words, tiny_data):
    """physhdr train --help | head"""
    command = [sys.executable, "-c", MAIN]
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        done = subprocess.run(
            [*command, *(word.format(data=tiny_data) for word in words)],
            stdout=theirs,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    finally:
        os.close(theirs)
    assert (done.stderr, done.returncode) == ("", 141)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX shells close streams so")
def test_without_standard_streams_a_training_is_done(tiny_data, tmp_path):
    train = ["train", str(tiny_data), "--out", str(tmp_path / "run"), "--iterations", "2"]
    command = shlex.join([sys.executable, "-c", MAIN, *train])
    done = subprocess.run(
        ["sh", "-c", f"{command} <&- >&- 2>&-"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "run" / "checkpoint.safetensors").exists()


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX shells close streams so")
@pytest.mark.parametrize(
    ("words", "status"), [("--version", 0), ("inspect nowhere", 1), ("inspect --nonsense", 2)]
)
def test_without_standard_streams_the_exit_status_is_right(words, status):
    command = f"{shlex.join([sys.executable, '-c', MAIN])} {words} >&-"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == status and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        "train data --out run --threads 100000",
        "serve --home home --threads 100000",
        "prepare photos data --threads 100000",
        "prepare . --triangulate --threads 100000",
        "render run --out a.exr --workers 100000",
        "synthesise --threads-per-job 100000 -- --out data",
        "benchmark --out b --scenes data --methods fast --budget iterations=1 --threads-per-job 100000",
    ],
)
def test_more_threads_than_any_library_survives_are_refused(words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    assert re.search(r"--[a-z-]+ is 100000\n  It must be from -?\d to 256", fails(capsys, *words.split()))


def test_a_render_too_large_for_any_memory_is_refused(run, tmp_path, capsys):
    message = fails(capsys, "render", run, "--out", tmp_path / "x.exr", "--width", "10000000")
    assert "too large" in message and "smaller width" in message


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no folder that a process is in")
def test_a_working_folder_that_is_gone_is_named(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    command = f"rmdir {shlex.quote(str(gone))}; {shlex.join([sys.executable, '-c', MAIN])} inspect data"
    done = subprocess.run(["sh", "-c", command], cwd=gone, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "working folder no longer exists" in done.stderr
