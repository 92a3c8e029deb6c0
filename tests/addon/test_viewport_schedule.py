# SPDX-License-Identifier: GPL-3.0-or-later
"""When pictures are asked for, and how large. No Blender and no clock: times are given."""

import numpy as np
import pytest

from physhdr.addon.viewport.camera import ViewCamera
from physhdr.addon.viewport.schedule import (
    LOWEST_STEP,
    PATIENCE_SECONDS,
    REST_SECONDS,
    RETRY_SECONDS,
    STEP,
    PreviewSchedule,
    ResolutionLadder,
    View,
)
from physhdr.bridge.messages import PREVIEW_PIXELS_MAX, PREVIEW_SIDE_MAX


def view(angle: float = 0.0, look=None, revision=None, orthographic: bool = False) -> View:
    pose = np.eye(4)
    pose[0, 3] = angle
    return View(ViewCamera(pose, 800, 600, 900.0, 900.0, 400.0, 300.0, orthographic), look, revision)


def answer(schedule: PreviewSchedule, now: float, request, seconds: float) -> float:
    assert schedule.received(now + seconds, request.number)
    return now + seconds


def test_the_first_picture_is_sharp_and_then_there_is_peace():
    schedule = PreviewSchedule()
    request = schedule.wants(10.0, view())
    assert request is not None and request.is_sharp
    assert (request.camera.width, request.camera.height) == (800, 600)
    now = answer(schedule, 10.0, request, 0.03)
    assert schedule.wants(now, view()) is None
    assert schedule.wants(now + 100.0, view()) is None


def test_one_request_at_a_time_and_the_newest_view_wins():
    schedule = PreviewSchedule()
    first = schedule.wants(0.0, view())
    for step in range(1, 10):
        assert schedule.wants(0.01 * step, view(step)) is None
    now = answer(schedule, 0.0, first, 0.1)
    second = schedule.wants(now, view(9))
    assert second is not None and second.camera.camera_to_world[0, 3] == 9


def test_small_while_moving_sharp_at_rest():
    schedule = PreviewSchedule()
    now = answer(schedule, 0.0, schedule.wants(0.0, view()), 0.05)
    moving = schedule.wants(now, view(1.0))
    assert not moving.is_sharp and moving.camera.width < 800
    now = answer(schedule, now, moving, 0.02)
    assert schedule.wants(now, view(1.0)) is None, "not yet at rest"
    sharp = schedule.wants(0.05 + REST_SECONDS, view(1.0))
    assert sharp.is_sharp and sharp.camera.width == 800


def test_a_slider_counts_as_movement():
    schedule = PreviewSchedule()
    now = answer(schedule, 0.0, schedule.wants(0.0, view(look=1.0)), 0.05)
    request = schedule.wants(now, view(look=1.1))
    assert request is not None and request.look == 1.1 and not request.is_sharp


@pytest.mark.parametrize("pixels_per_second", [2e5, 1e6, 5e6, 5e7])
def test_it_keeps_15_frames_per_second_if_the_backend_can(pixels_per_second: float):
    """A backend that takes 10 ms and then so many pixels a second."""
    schedule = PreviewSchedule()
    now, frames = 0.0, []
    for step in range(60):
        request = schedule.wants(now, view(step))
        seconds = 0.01 + request.camera.width * request.camera.height / pixels_per_second
        now = answer(schedule, now, request, seconds)
        frames.append((seconds, request.step))
    late = frames[10:]
    slowest = max(seconds for seconds, _ in late)
    if pixels_per_second >= 1e6:
        assert slowest < 1 / 15
    else:  # even the smallest picture takes longer
        assert all(step == LOWEST_STEP for _, step in late)
    if pixels_per_second == 5e7:
        assert all(step == 0 for _, step in late), "fast enough: full size even while it moves"


def test_waits_that_fewer_pixels_do_not_shorten_do_not_cost_pixels():
    """A busy interface: the answer is seen late, but the backend worked for 20 ms only."""
    schedule, now = PreviewSchedule(), 0.0
    for step in range(20):
        request = schedule.wants(now, view(step))
        now += 0.3
        assert schedule.received(now, request.number, rendering=0.02)
    assert request.step == 0


def test_training_goes_on_under_a_resting_view():
    schedule = PreviewSchedule(refresh_seconds=0.5)
    now = answer(schedule, 0.0, schedule.wants(0.0, view(revision=1)), 0.05)
    assert schedule.wants(now, view(revision=2)) is None, "training is not to be stopped by looking"
    request = schedule.wants(0.6, view(revision=2))
    assert request.is_sharp and request.revision == 2


@pytest.mark.parametrize(("moved", "seconds"), [(1.0, 5.0), (0.0, PATIENCE_SECONDS)])
def test_a_lost_reply_is_asked_for_again(moved: float, seconds: float):
    schedule = PreviewSchedule(timeout_seconds=5.0)
    first = schedule.wants(0.0, view())
    assert schedule.wants(seconds - 0.1, view(moved)) is None
    assert schedule.wants(seconds, view(moved)) is None, "the loss is noticed; first a pause"
    second = schedule.wants(seconds + RETRY_SECONDS, view(moved))
    assert second is not None and second.number != first.number
    assert schedule.wants(seconds + 0.6, view(2.0)) is None
    assert not schedule.received(seconds + 1.0, first.number), "too late: the view has moved"
    assert schedule.received(seconds + 1.0, second.number)


def test_a_late_picture_of_a_view_that_is_back_is_shown():
    schedule = PreviewSchedule(timeout_seconds=5.0)
    first = schedule.wants(0.0, view())
    schedule.wants(5.0, view(1.0))
    second = schedule.wants(5.0 + RETRY_SECONDS, view(1.0))
    assert second is not None and schedule.wants(6.0, view()) is None
    assert schedule.received(7.0, first.number) and schedule.wants(7.0, view()) is None
    assert not schedule.received(8.0, second.number)


def test_a_late_refusal_is_none_of_the_request_that_followed():
    schedule = PreviewSchedule(timeout_seconds=5.0)
    first = schedule.wants(0.0, view())
    schedule.wants(5.0, view(1.0))
    second = schedule.wants(5.0 + RETRY_SECONDS, view(1.0))
    schedule.lost(first.number)
    assert schedule.received(7.0, second.number)


def simulated(schedule: PreviewSchedule, width: int, height: int, seconds: float, revision=None):
    """A minute of a resting view whose full picture takes ``seconds``: when each picture came that was to be
    shown, and its width. The backend renders one at a time."""
    camera = ViewCamera(np.eye(4), width, height, 900.0, 900.0, width / 2, height / 2)
    waiting, shown, free_at = [], [], 0.0
    for tick in range(1200):
        now = 0.05 * tick
        while waiting and waiting[0][1] <= now:
            request, _, took = waiting.pop(0)
            if schedule.received(now, request.number, took):
                shown.append((now, request.camera.width))
        request = schedule.wants(now, View(camera, None, revision and revision(now)))
        if request is not None:
            took = seconds * request.camera.width * request.camera.height / (width * height)
            free_at = max(now, free_at) + took
            waiting.append((request, free_at, took))
    return shown


@pytest.mark.parametrize("seconds", [4.0, 6.0, 20.0])
def test_a_picture_that_takes_long_is_shown_when_it_comes_and_asked_for_no_more(seconds: float):
    shown = simulated(PreviewSchedule(), 800, 600, seconds)
    assert [width for _, width in shown] == [800]
    assert shown[0][0] == pytest.approx(seconds, abs=0.1)


def test_while_training_goes_on_pictures_that_take_too_long_become_smaller():
    shown = simulated(PreviewSchedule(), 800, 600, 6.0, revision=lambda now: 1 + int(now))
    assert shown[0][1] == 800 and {width for _, width in shown[1:]} == {round(800 * STEP)}
    assert len(shown) > 10


@pytest.mark.parametrize("size", [(5120, 2100), (4100, 2500), (4480, 2400), (1000, 9000), (7680, 4320)])
def test_a_view_of_more_pixels_than_a_preview_has_is_asked_for_on_fewer(size: tuple[int, int]):
    """What the backend takes, as it checks it, and nearly all of that."""
    camera = ViewCamera(np.eye(4), *size, 900.0, 900.0, size[0] / 2, size[1] / 2)
    asked = PreviewSchedule().wants(0.0, View(camera)).camera
    sides, pixels = max(asked.width, asked.height), asked.width * asked.height
    assert sides <= PREVIEW_SIDE_MAX and pixels <= PREVIEW_PIXELS_MAX
    assert sides > 0.999 * PREVIEW_SIDE_MAX or pixels > 0.999 * PREVIEW_PIXELS_MAX
    assert asked.width / asked.height == pytest.approx(size[0] / size[1], rel=3e-3)
    assert asked.cx == pytest.approx(asked.width / 2)


def test_a_view_of_4k_is_asked_for_whole():
    camera = ViewCamera(np.eye(4), 3840, 2160, 900.0, 900.0, 1920.0, 1080.0)
    assert PreviewSchedule().wants(0.0, View(camera)).camera.width == 3840


def test_a_failing_backend_is_not_asked_at_every_tick():
    schedule = PreviewSchedule()
    asked = 0
    for tick in range(200):
        now = 0.01 * tick
        if schedule.wants(now, view()) is not None:
            asked += 1
            schedule.lost()
    assert 2 <= asked <= 2.0 / RETRY_SECONDS + 1


def test_orthographic_views_want_nothing():
    assert PreviewSchedule().wants(0.0, view(orthographic=True)) is None


def test_sharpness_is_pixels_per_pixel_of_the_region():
    assert PreviewSchedule(sharpness=0.5).wants(0.0, view()).camera.width == 400


def test_the_ladder_goes_down_at_once_and_up_step_by_step():
    ladder = ResolutionLadder(frame_seconds=0.05, step=1)
    ladder.measured(0.19, 1)
    assert ladder.step == 3, "two steps: a quarter of the pixels"
    ladder.measured(0.03, 3)
    assert ladder.step == 3, "more would be too many"
    ladder.measured(0.01, 3)
    assert ladder.step == 2
    ladder.measured(9.0, 0)
    assert ladder.step == 2, "a full picture says nothing about a small one that was measured"
