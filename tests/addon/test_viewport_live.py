# SPDX-License-Identifier: GPL-3.0-or-later
"""Which views the live preview asks for pictures, and which of the answers it shows."""

from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.session.client import PreviewRefused  # noqa: E402
from physhdr.addon.session.state import Link, State  # noqa: E402
from physhdr.addon.viewport import live, overlay  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera  # noqa: E402
from physhdr.addon.viewport.schedule import RETRY_SECONDS, TIMEOUT_SECONDS, View  # noqa: E402
from physhdr.bridge.messages import Failure, JobStatus, PreviewFrame, PreviewHeader  # noqa: E402

LOOK = (0.0, (1.0,), "linear")


class Backend:
    """A session whose backend answers when the test says so; what was asked for is in ``asked``."""

    def __init__(self):
        job = JobStatus(state="open", run="/run", has_model=True)
        self.state = State(job=job, link=Link("connected"))
        self.asked, self.answer = [], None

    def request_preview(self, request):
        self.asked.append(request)
        return True

    def take_preview(self):
        answer, self.answer = self.answer, None
        return answer

    def renders(self, request):
        shape = request.camera.height, request.camera.width
        header = PreviewHeader(request=request, iteration=0, milliseconds=6000.0)
        self.answer = PreviewFrame(header, np.zeros((*shape, 4), np.float16), np.ones(shape, np.float32))


@pytest.fixture
def watched(scene, monkeypatch):
    """A backend, and a view of it whose camera, time and pictures are at hand."""
    seen = SimpleNamespace(backend=Backend(), now=100.0, x=0.0, keys=[1], shown=[])

    def regions(job):
        pose = np.eye(4)
        pose[0, 3] = seen.x
        camera = ViewCamera(pose, 8, 6, 9.0, 9.0, 4.0, 3.0)
        return iter([live._Region(key, View(camera, LOOK), np.eye(4)) for key in seen.keys])

    monkeypatch.setattr(live, "_regions", regions)
    monkeypatch.setattr(live.time, "perf_counter", lambda: seen.now)
    monkeypatch.setattr(overlay, "set_picture", lambda key, picture: seen.shown.append(picture))
    preview = live.LivePreview()

    def tick(seconds=0.0):
        seen.now += seconds
        preview.tick(seen.backend)

    seen.tick = tick
    return seen


def test_a_picture_of_a_view_that_holds_is_shown_however_long_it_takes(watched):
    watched.tick()
    for _ in range(20):
        watched.tick(1.0)
    assert len(watched.backend.asked) == 1
    watched.backend.renders(watched.backend.asked[0])
    watched.tick(0.1)
    assert len(watched.shown) == 1 and watched.shown[0].camera.width == 8


def test_a_late_picture_of_a_view_that_has_moved_is_not(watched):
    watched.tick()
    watched.x = 1.0
    for seconds in (TIMEOUT_SECONDS + 0.1, RETRY_SECONDS + 0.1):
        watched.tick(seconds)
    first, second = watched.backend.asked
    watched.backend.renders(first)
    watched.tick(0.1)
    assert watched.shown == []
    watched.backend.renders(second)
    watched.tick(0.1)
    assert watched.shown[0].camera.camera_to_world[0, 3] == 1.0


def test_a_view_whose_picture_was_refused_late_is_asked_for_again(watched):
    watched.tick()
    watched.tick(TIMEOUT_SECONDS + 0.1)
    refusal = Failure(code="superseded", message="there is a newer request")
    watched.backend.answer = PreviewRefused(watched.backend.asked[0], refusal)
    for _ in range(3):
        watched.tick(RETRY_SECONDS)
    assert len(watched.backend.asked) == 2


def test_a_view_whose_request_another_views_has_replaced_is_asked_for_again(watched):
    """Where nobody told it: of what has come since the last look only the newest answer is taken."""
    watched.keys = [1, 2]
    watched.tick()
    watched.tick(TIMEOUT_SECONDS + 0.1)
    _, second = watched.backend.asked
    watched.backend.renders(second)
    for _ in range(3):
        watched.tick(RETRY_SECONDS)
    assert len(watched.shown) == 1 and len(watched.backend.asked) == 3


def test_a_picture_that_was_asked_for_before_the_preview_was_off_is_not_shown(watched):
    watched.tick()
    watched.keys = []
    watched.tick(0.1)
    watched.keys, watched.x = [1], 5.0
    for seconds in (0.1, TIMEOUT_SECONDS + 0.1, 0.1):
        watched.tick(seconds)
    watched.shown.clear()
    for request in (watched.backend.asked[0], watched.backend.asked[-1]):
        watched.backend.renders(request)
        watched.tick(0.1)
    assert [picture.camera.camera_to_world[0, 3] for picture in watched.shown] == [5.0]


def test_a_scene_shows_the_model_of_its_own_run_alone(registered, tmp_path):
    """The one that it has chosen, or that is proposed for its data set."""
    job = JobStatus(state="training", run=str(tmp_path / "kitchen_run"), has_model=True)
    chosen = registered.physhdr
    assert not live.is_of_job(chosen, job)
    (tmp_path / "kitchen").mkdir()
    chosen.data = str(tmp_path / "kitchen")
    assert live.is_of_job(chosen, job)
    (tmp_path / "link").symlink_to(tmp_path)
    for out, shows in (("other_run", False), ("kitchen_run", True), ("link/kitchen_run", True)):
        chosen.out = str(tmp_path / out)
        assert live.is_of_job(chosen, job) == shows


def test_views_of_another_runs_scene_ask_for_nothing(registered, tmp_path, monkeypatch):
    region = SimpleNamespace(type="WINDOW", width=64, height=48, data=object(), as_pointer=lambda: 7)
    screen = SimpleNamespace(areas=[SimpleNamespace(type="VIEW_3D", regions=[region])])
    window = SimpleNamespace(scene=registered, view_layer=registered.view_layers[0], screen=screen)
    manager = SimpleNamespace(windows=[window])
    monkeypatch.setattr(
        live, "bpy", SimpleNamespace(context=SimpleNamespace(window_manager=manager), data=bpy.data)
    )
    camera = ViewCamera(np.eye(4), 64, 48, 80.0, 80.0, 32.0, 24.0)
    monkeypatch.setattr(live, "of_region", lambda region, data: camera)
    job = JobStatus(state="training", run=str(tmp_path / "b"), has_model=True)
    registered.physhdr.preview = True
    for out, keys in (("a", []), ("b", [7])):
        registered.physhdr.out = str(tmp_path / out)
        assert [region.key for region in live._regions(job)] == keys
