# SPDX-License-Identifier: GPL-3.0-or-later
"""The log of a training; and on a disk that takes no more: told once, with the file and what to do."""

import dataclasses
import os
import threading
from pathlib import Path

import pytest

from physhdr.backend.runs.log import LOG_FILE, TENSORBOARD_FOLDER, EventLog
from physhdr.backend.train.checkpoint import how_to_go_on
from physhdr.backend.train.events import Progress, Saved
from physhdr.bridge.errors import OutputError

resource = pytest.importorskip("resource", reason="limits of a process are POSIX's")

FULL_DISK = Path("/dev/full")
SAVED = Saved(20, "checkpoint")
PROGRESS = Progress(20, 100, 1000, {"rec": 0.5}, 10.0, 8.0, {})


def test_tensorboard_has_what_was_measured_on_a_view_that_is_not_trained(tmp_path):
    event_accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with EventLog(tmp_path) as log:
        log.show(dataclasses.replace(PROGRESS, monitor={"PSNR": 31.5}))
    board = event_accumulator.EventAccumulator(str(tmp_path / TENSORBOARD_FOLDER)).Reload()
    told = {name: board.Scalars(name)[0] for name in board.Tags()["scalars"]}
    assert (told["held-out view/PSNR"].step, told["held-out view/PSNR"].value) == (20, 31.5)
    assert set(told) == {"held-out view/PSNR", "loss/rec", "gaussians", "iterations per second"}


@pytest.mark.skipif(not FULL_DISK.exists(), reason="needs /dev/full")
def test_a_log_that_cannot_be_written_is_named_and_can_be_closed(tmp_path):
    (tmp_path / LOG_FILE).symlink_to(FULL_DISK)
    with pytest.raises(OutputError, match=LOG_FILE) as caught, EventLog(tmp_path) as log:
        log.show(SAVED)
    assert caught.value.hint == f"Free some space on its disk, then {how_to_go_on(tmp_path)}."


def test_tensorboard_that_cannot_be_written_is_named_and_tells_it_once(tmp_path, capfd, monkeypatch):
    (tmp_path / LOG_FILE).symlink_to(os.devnull)
    seen = []
    monkeypatch.setattr(threading, "excepthook", seen.append)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))  # no file may grow beyond 10 bytes
    try:
        with pytest.raises(OutputError, match="tensorboard"), EventLog(tmp_path) as log:
            log.show(PROGRESS)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not seen and "Traceback" not in capfd.readouterr().err
    assert threading.excepthook == seen.append


def test_what_tensorboard_cannot_write_at_its_end_is_not_lost_in_silence(tmp_path, monkeypatch):
    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    (tmp_path / LOG_FILE).symlink_to(os.devnull)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OutputError, match="tensorboard"), EventLog(tmp_path) as log:
            log.show(PROGRESS)
            resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
            log.show(PROGRESS)  # its thread notices now or when it ends
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_was_saved_is_to_be_resumed_and_nothing_else(tmp_path):
    assert how_to_go_on(tmp_path).startswith("start the training again")
    (tmp_path / "checkpoint.safetensors").touch()
    assert how_to_go_on(tmp_path).startswith("resume the training")
