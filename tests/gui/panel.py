# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel in each of its states, from no backend to an imported result, in a real window."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import Window, drive

#: More than the test waits for.
ITERATIONS = 5000
WATCH_AT = 800


def test(window: Window) -> Iterator[float]:
    options = window.options
    yield from window.open()
    session = window.module("addon.runtime").session()
    settings = bpy.context.scene.physhdr
    window.forget_backend()
    yield from window.redrawn()
    window.screenshot("1_no_backend")
    assert not bpy.ops.physhdr.train_start.poll()

    bpy.ops.physhdr.backend_use(filepath=str(options.python))
    yield from window.until(lambda: any(task.fraction > 0.2 for task in session.state.tasks), 120, "checking")
    yield from window.redrawn()
    window.screenshot("2_checking")
    yield from window.until(lambda: not session.state.tasks, 300, "checked")
    assert session.state.backend.ready, session.state.backend.problem
    settings.data = str(options.data)
    settings.out = str(Path.home() / "training")
    settings.iterations = ITERATIONS
    yield from window.redrawn()
    window.screenshot("3_ready")

    bpy.ops.physhdr.train_start()
    yield from window.until(lambda: session.state.job.message != "", 60, "preparing")
    yield from window.until(lambda: session.state.job.has_model, 300, "begun")
    window.look_through(options.data / "transforms_test.json", 8)
    settings.preview = True
    yield from window.until(lambda: session.state.job.iteration > WATCH_AT, 300, "training")
    yield from window.sharp()
    window.screenshot("4_training")
    bpy.ops.physhdr.train_pause()
    yield from window.until(lambda: session.state.job.state == "paused", 10, "paused")
    yield from window.redrawn()
    window.screenshot("5_paused")
    bpy.ops.physhdr.train_continue()

    yield from window.until(lambda: session.state.job.saved_iteration > 0, 180, "saved")
    os.kill(session.state.link.welcome.pid, signal.SIGKILL)
    yield from window.until(lambda: session.state.job.state == "failed", 5, "noticed")
    yield from window.redrawn()
    window.screenshot("6_failed")
    assert "checkpoint" in session.state.job.failure.hint

    bpy.ops.physhdr.train_resume()
    yield from window.until(lambda: session.state.job.state == "training", 120, "resumed")
    bpy.ops.physhdr.train_stop()
    yield from window.until(lambda: session.state.job.state == "stopped", 60, "stopped")
    yield from window.redrawn()
    window.screenshot("7_stopped")
    bpy.data.objects.remove(bpy.context.scene.camera)  # it would stand in the picture
    with window.override():
        bpy.ops.physhdr.result_import("INVOKE_DEFAULT")
        assert not bpy.ops.physhdr.result_import.poll()  # a double click is one import
    yield from window.until(lambda: bpy.context.object is not None, 60, "imported")
    assert not settings.preview  # the object shows itself
    yield from window.drawn()
    window.screenshot("8_imported")
    yield from window.shut_down()
    yield from window.redrawn()
    window.screenshot("9_shut_down")


drive(test)
