# SPDX-License-Identifier: GPL-3.0-or-later
"""``--json``: what a program that started a command is told."""

import dataclasses
import errno
import importlib
import json
import os
import pkgutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

from physhdr.backend import cli
from physhdr.backend.cli import error_report, main
from physhdr.backend.cli import evaluate as evaluate_command
from physhdr.backend.cli import video as video_command
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.runs.run import Run
from physhdr.backend.scene import read_scene
from physhdr.backend.train.config import TrainConfig
from physhdr.bridge.errors import FileMissingError
from physhdr.bridge.shots import Shot, Shots, write_shots

#: A file's name that no system takes, and a place.
NAME, PLACE = "a" * 300 + ".spz", ["--at", "0", "0", "0", "--out", "probe"]


class Grey(Renderer):
    """Grey by exposure and by both levels, and a pixel brighter where the camera is farther right."""

    lights = ("ambient", "lamp")

    def hdr(self, camera, lighting_level=1.0) -> torch.Tensor:
        levels = (lighting_level, 1.0) if isinstance(lighting_level, float) else lighting_level
        grey = 0.1 * levels[0] + 0.05 * levels[1] + 0.01 * float(camera.position[0])
        return torch.full((3, camera.height, camera.width), grey)

    def ldr(self, camera, exposure, lighting_level=1.0) -> torch.Tensor:
        return (self.hdr(camera, lighting_level) * exposure).clamp(max=1.0)


@pytest.fixture
def opened(tiny_data: Path, monkeypatch):
    def open_run(folder: Path, data=None, rasteriser="", device="", report=print, **_) -> Run:
        if not folder.is_dir():
            raise FileMissingError(f"there is no run in {folder}", "Choose another folder.")
        report("something was noticed")
        return Run(folder, "default", TrainConfig(iterations=10), read_scene(tiny_data), Grey(), 10)

    for command in (evaluate_command, video_command):
        monkeypatch.setattr(command, "open_run", open_run)


def told(capsys) -> list[dict]:
    """All that stands on stdout."""
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_an_evaluation_says_how_far_it_is_and_where_its_files_are(opened, tmp_path: Path, capsys) -> None:
    assert main(["evaluate", str(tmp_path), "--json"]) == 0
    *steps, last = told(capsys)
    fractions = [step["progress"] for step in steps]
    assert fractions and fractions == sorted(fractions) and fractions[-1] == 1.0
    assert steps[-1]["message"].startswith("picture ") and " of " in steps[-1]["message"]
    assert last == {"result": {"folder": str(tmp_path), "split": "test"}}
    assert (tmp_path / "evaluation.json").exists()


@pytest.mark.parametrize("command", [["evaluate"], ["render", "--out", "a.webp"]])
def test_an_error_is_told_with_its_remedy(opened, tmp_path: Path, capsys, command) -> None:
    assert main([command[0], str(tmp_path / "none"), *command[1:], "--json"]) == 1
    [line] = told(capsys)
    assert line["error"]["hint"] == "Choose another folder." and "none" in line["error"]["message"]


def test_a_video_of_shots_shows_each_frames_camera_exposure_and_lights(opened, tmp_path, capsys, tiny_data):
    """Each frame's grey is what its own numbers make of it, worked out here."""
    middle = sorted({s for view in read_scene(tiny_data).train for s in view.exposures})[2]
    frames, greys = [], []
    for index, (ev, levels) in enumerate(
        [(-2.0, ()), (-2.0, (2.0,)), (-3.0, (2.0, 0.0)), (-1.0, (0.5, 3.0))]
    ):
        pose = np.eye(4)
        pose[0, 3] = index
        frames.append(Shot(pose, 20.0, 20.0, 16.0, 8.0, ev, levels))
        ambient, lamp = (*levels, 1.0, 1.0)[:2]
        greys.append((0.1 * ambient + 0.05 * lamp + 0.01 * index) * middle * 2.0**ev)
    write_shots(tmp_path / "shots.json", Shots(32, 16, 12.5, frames))
    arguments = ["--camera", str(tmp_path / "shots.json"), "--out", str(tmp_path / "frames")]
    assert main(["render", str(tmp_path), *arguments, "--json"]) == 0
    *steps, last = [json.loads(line) for line in capsys.readouterr().out.splitlines()]  # nothing else is said
    assert steps[-1]["progress"] == 1.0 and steps[-1]["message"] == "frame 4 of 4"
    assert last["result"] == {"out": str(tmp_path / "frames"), "frames": 4}
    assert main(["render", str(tmp_path), *arguments]) == 0
    said = capsys.readouterr().out
    assert "something was noticed" in said and f"wrote {tmp_path / 'frames'}: 4 frames" in said
    pictures = [np.asarray(Image.open(path)) for path in sorted((tmp_path / "frames").glob("*.png"))]
    assert [picture.shape for picture in pictures] == [(16, 32, 3)] * 4
    found = [int(picture[0, 0, 0]) for picture in pictures]
    np.testing.assert_allclose(found, 255.0 * np.minimum(greys, 1.0), atol=0.51)


def test_shots_have_a_path_and_lights_of_their_own(opened, tmp_path, capsys) -> None:
    arguments = [
        "render",
        str(tmp_path),
        "--out",
        "a.webp",
        "--camera",
        "s.json",
        "--path",
        "orbit",
        "--json",
    ]
    assert main(arguments) == 1
    assert "--path has no effect: --camera sets every frame" in told(capsys)[0]["error"]["message"]
    frames = [Shot(np.eye(4), 20.0, 20.0, 16.0, 8.0, 0.0, (1.0, 1.0, 1.0))] * 2
    write_shots(tmp_path / "three.json", Shots(32, 16, 12.0, frames))
    out = ["--out", str(tmp_path / "a.webp")]
    assert main(["render", str(tmp_path), *out, "--camera", str(tmp_path / "three.json"), "--json"]) == 1
    assert "3 lights, the model has 2: ambient, lamp" in told(capsys)[0]["error"]["message"]


#: Of each command with --json: how it is called, and where its work begins.
COMMANDS = {
    "check": (["check"], "check.check"),
    "evaluate": (["evaluate", "run"], "evaluate.Evaluate._work"),
    "export": (["export", "run", "a.spz"], "convert.Convert.work"),
    "inspect": (["inspect", "data"], "inspect.inspect"),
    "prepare": (["prepare", "photos", "data"], "photos.understand"),
    "render": (["render", "run", "--out", "a.webp"], "video.Video.work"),
}
#: What a work may fail with: the error, its code, its words and what helps.
FAILURES = [
    (FileMissingError("there is no a.ply", "Look."), "file_missing", "there is no a.ply", "Look."),
    (OSError(errno.ENAMETOOLONG, "File name too long", "a.spz"), "path", "a.spz: File name too long", "path"),
    (OSError(errno.ENOSPC, "No space left"), "path", "No space left", "Free some space"),
    (MemoryError(), "out_of_memory", "there is not enough memory", "Close other programs"),
    (RuntimeError("CUDA out of memory"), "out_of_memory", "there is not enough memory", "Close other"),
    (ModuleNotFoundError("No module named 'a'"), "package_missing", "No module named 'a'", "physhdr check"),
    (KeyboardInterrupt(), "cancelled", "interrupted", ""),
]


def failing(monkeypatch, command: str, error: BaseException) -> list[str]:
    """How to call a command whose work raises ``error``."""

    def fail(*_, **__):
        raise error

    argv, where = COMMANDS[command]
    monkeypatch.setattr(f"physhdr.backend.cli.{where}", fail)
    monkeypatch.setattr(error_report, "address_limit", lambda: None)
    return argv


def test_all_commands_that_tell_programs_are_tried() -> None:
    found = set()
    for each in pkgutil.iter_modules(cli.__path__):
        module = importlib.import_module(f"{cli.__name__}.{each.name}")
        found |= {
            kind.__name__.lower()
            for kind in vars(module).values()
            if hasattr(kind, "run")
            and dataclasses.is_dataclass(kind)
            and "json" in {field.name for field in dataclasses.fields(kind)}
        }
    assert found == set(COMMANDS)


@pytest.mark.parametrize("failure", FAILURES, ids=lambda each: type(each[0]).__name__)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_failure_is_the_last_line_and_nothing_else_is_said(capsys, monkeypatch, command, failure) -> None:
    error, code, message, hint = failure
    argv = failing(monkeypatch, command, error)
    assert main([*argv, "--json"]) == (130 if code == "cancelled" else 1)
    said = capsys.readouterr()
    found = json.loads(said.out)["error"]
    assert (found["code"], found["message"]) == (code, message) and hint in found["hint"]
    assert said.err == ""
    assert main(argv) == (130 if code == "cancelled" else 1)
    said = capsys.readouterr()
    assert said.out == "" and message in said.err and hint in said.err


@pytest.mark.parametrize("command", COMMANDS)
def test_a_fault_of_ours_is_no_answer(capsys, monkeypatch, command) -> None:
    argv = failing(monkeypatch, command, RuntimeError("shapes do not match"))
    with pytest.raises(RuntimeError, match="shapes"):
        main([*argv, "--json"])
    assert capsys.readouterr().out == ""


def test_where_nobody_reads_a_failure_is_told_in_words(capsys, monkeypatch) -> None:
    argv = failing(monkeypatch, "inspect", FileMissingError("there is no data", "Look."))

    class Closed:
        def write(self, text: str) -> None:
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", Closed())
        assert main([*argv, "--json"]) == 1
    assert "there is no data" in capsys.readouterr().err


@pytest.mark.parametrize("nobody_reads", [True, False])
def test_on_windows_an_invalid_argument_is_that_nobody_reads_if_so(nobody_reads, capsys, monkeypatch) -> None:
    """So its C library calls what POSIX calls a broken pipe (bugs.python.org/issue35754)."""
    argv = failing(monkeypatch, "inspect", OSError(errno.EINVAL, "Invalid argument"))
    reader, writer = os.pipe()
    if nobody_reads:
        os.close(reader)
    with monkeypatch.context() as patch, open(writer, "w", encoding="utf-8") as stdout:
        theirs = SimpleNamespace(platform="win32", stdin=sys.stdin, stdout=stdout, stderr=sys.stderr)
        patch.setattr(cli, "sys", theirs)  # not for all, which would import what only Windows has
        status = main(argv)
    if not nobody_reads:
        os.close(reader)
    told = "Invalid argument" in capsys.readouterr().err
    assert (status, told) == ((141, False) if nobody_reads else (1, True))


def test_what_another_program_is_told_is_not_for_us(capsys) -> None:
    """What stands after two dashes belongs to the program that is started."""
    assert main(["synthesise", "--", "--from-file", "current", "--json"]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("error: ")


@pytest.mark.skipif(sys.platform == "win32", reason="another message there")
@pytest.mark.parametrize("command", [["export", NAME, "o.spz"], ["render", NAME, *PLACE]])
def test_a_name_that_is_too_long_is_told(capsys, tmp_path, monkeypatch, command) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*command, "--json"]) == 1
    [line] = told(capsys)
    assert line["error"]["code"] == "path" and "File name too long" in line["error"]["message"]
