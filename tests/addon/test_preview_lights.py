# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview's sliders, one a light of the backend's model, and what they ask the backend for."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import physhdr  # noqa: E402
from physhdr.addon.settings import follow_lights, preview_levels  # noqa: E402
from physhdr.addon.viewport import live  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera  # noqa: E402
from physhdr.addon.viewport.schedule import PreviewSchedule, View  # noqa: E402
from physhdr.bridge.messages import Envelope, decode, encode  # noqa: E402

LIGHTS = ("ambient", "pendant", "Küche")


@pytest.fixture
def settings(scene):
    physhdr.register()
    yield scene.physhdr
    physhdr.unregister()


def test_each_light_has_a_level_that_it_keeps(settings):
    settings.lighting_level = 0.5
    assert preview_levels(settings, ()) == preview_levels(settings, ("ambient",)) == (0.5,)
    assert preview_levels(settings, LIGHTS) == (0.5, 1.0, 1.0)  # the sliders come with the timer's next look
    for _ in range(2):
        follow_lights(settings, LIGHTS)
    assert [light.name for light in settings.further_levels] == ["pendant", "Küche"]
    settings.further_levels["Küche"].level = 3.0
    assert preview_levels(settings, LIGHTS) == (0.5, 1.0, 3.0)
    # Another model, with its lights in another order and one more; then none.
    others = ("sun", "Küche", "screen")
    follow_lights(settings, others)
    assert preview_levels(settings, others) == (0.5, 3.0, 1.0)
    follow_lights(settings, ())
    assert preview_levels(settings, LIGHTS) == (0.5, 1.0, 3.0)


def test_levels_are_saved_with_the_scene(settings, tmp_path):
    follow_lights(settings, LIGHTS)
    settings.further_levels["pendant"].level = 0.25
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert preview_levels(bpy.context.scene.physhdr, LIGHTS) == (1.0, 0.25, 1.0)


def test_a_sliders_change_is_asked_for_with_every_level(settings):
    camera = ViewCamera(np.eye(4), 64, 48, 80.0, 80.0, 32.0, 24.0)
    follow_lights(settings, LIGHTS)
    schedule = PreviewSchedule()

    def wanted(now: float):
        look = (settings.exposure_ev, preview_levels(settings, LIGHTS), settings.tone)
        return schedule.wants(now, View(camera, look))

    first = wanted(0.0)
    assert schedule.received(0.1, first.number) and wanted(0.2) is None
    settings.further_levels["pendant"].level = 2.0
    request = live._message(7, wanted(0.3))
    assert request.lighting_levels == (1.0, 2.0, 1.0) and request.tone == "linear"
    assert decode(encode(Envelope("request", 1, request))).message == request
