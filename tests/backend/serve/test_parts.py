# SPDX-License-Identifier: GPL-3.0-or-later
"""The small parts between the threads: the inbox, the curves, the speed."""

import itertools
import json

import pytest

from physhdr.backend.serve.curves import POINTS_MAX, Curves, Speed
from physhdr.backend.serve.inbox import Command, Ending, Inbox, WantedPreview
from physhdr.bridge.messages import PreviewCamera, PreviewRequest, StatusGet

CAMERA = PreviewCamera(pose=(0.0,) * 16, width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0)


def wanted(client, number):
    return WantedPreview(client, number, PreviewRequest(sequence=number, camera=CAMERA))


def test_of_each_client_the_newest_preview_alone_and_clients_in_turn():
    inbox = Inbox()
    assert inbox.offer(wanted(1, 1)) is None
    assert inbox.offer(wanted(1, 2)) == wanted(1, 1)
    inbox.offer(wanted(2, 1))
    assert inbox.wait(1.0) is None  # woken
    assert inbox.take_preview() == wanted(1, 2)
    inbox.offer(wanted(1, 3))  # its last one has not been sent: the other client's turn
    assert inbox.take_preview() == wanted(2, 1)
    assert inbox.take_preview() is None
    inbox.sent(1)
    assert inbox.take_preview() == wanted(1, 3)
    inbox.offer(wanted(1, 4))
    inbox.forget(1)
    inbox.sent(1)
    assert inbox.take_preview() is None


def test_commands_come_in_order_and_previews_wake_once():
    inbox = Inbox()
    command = Command(1, "x", 1, StatusGet())
    for number in range(1000):
        inbox.offer(wanted(1, number))
    inbox.put(command)
    inbox.put(Ending("y"))
    assert inbox.wait(1.0) is None  # a thousand previews are one call
    assert inbox.take() == command and inbox.take() == Ending("y") and inbox.take() is None
    assert inbox.take_preview() == wanted(1, 999)
    inbox.offer(wanted(2, 1))
    assert inbox.wait(1.0) is None
    assert inbox.take_preview() == wanted(2, 1)


def test_long_curves_are_thinned_and_keep_their_ends():
    curves = Curves()
    for iteration in range(1, 3 * POINTS_MAX):
        curves.add(iteration, {"rec": 2.0, "unit": 1.0}, {"PSNR": 20.0} if iteration % 10 == 0 else {})
    history = curves.history()
    assert len(history.iterations) == len(history.losses) <= POINTS_MAX
    assert history.iterations[-1] == 3 * POINTS_MAX - 1 and history.iterations[0] == 1
    steps = {b - a for a, b in itertools.pairwise(history.iterations[:-1])}
    assert len(steps) == 1 and set(history.losses) == {3.0}  # evenly
    assert history.psnr_iterations[:2] == (10, 20)
    curves.add(10**6, {"rec": float("nan")}, {"PSNR": float("inf")})  # what JSON cannot say
    assert curves.history() == history


def test_curves_of_a_killed_run_end_where_its_checkpoint_does(tmp_path):
    def progress(iteration, loss):
        return json.dumps({"event": "progress", "iteration": iteration, "losses": {"rec": loss}})

    log = tmp_path / "log.jsonl"
    lines = [json.dumps({"event": "started"}), progress(20, 4.0), progress(40, 3.0), progress(60, 2.0)]
    lines += [progress(60, 2.0), progress(80, 1.0), "[]", '{"event": "progress"}', progress(100, 0.5)[:30]]
    log.write_text("\n".join(lines))
    curves = Curves()
    curves.read(log, 80)
    assert curves.history().iterations == (20, 40, 60, 80)
    curves.read(log, 50)
    assert curves.history().losses == (4.0, 3.0)
    curves.read(tmp_path / "none", 50)
    assert curves.history().iterations == ()


def test_the_speed_is_that_of_the_last_seconds():
    speed = Speed()
    assert speed.note(0.0, 0) == 0.0
    assert speed.note(1.0, 10) == pytest.approx(10.0)
    for second in range(2, 30):
        rate = speed.note(float(second), 10 + 50 * (second - 1))
    assert rate == pytest.approx(50.0)
    speed.clear()
    assert speed.note(100.0, 5000) == 0.0
