# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview's sliders, one a light of the backend's model, and what they ask the backend for."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import nodes  # noqa: E402
from physhdr.addon.model.preview_look import followed, preview_look  # noqa: E402
from physhdr.addon.settings import follow_exposure, follow_lights, preview_levels  # noqa: E402
from physhdr.addon.viewport import live  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera  # noqa: E402
from physhdr.addon.viewport.schedule import PreviewSchedule, View  # noqa: E402
from physhdr.bridge.messages import Envelope, JobStatus, decode, encode  # noqa: E402
from physhdr.bridge.model_file import write_model  # noqa: E402

LIGHTS, USUAL = ("ambient", "pendant", "Küche"), (1.0, 1.0, 1.0)


@pytest.fixture
def settings(registered):
    return registered.physhdr


def test_each_light_has_a_level_that_it_keeps(settings):
    settings.lighting_level = 0.5
    assert preview_levels(settings, ()) == preview_levels(settings, ("ambient",)) == (0.5,)
    assert preview_levels(settings, LIGHTS) == (0.5, 1.0, 1.0)  # the sliders come with the timer's next look
    for _ in range(2):
        follow_lights(settings, LIGHTS, USUAL)
    assert [light.name for light in settings.further_levels] == ["pendant", "Küche"]
    settings.further_levels["Küche"].level = 3.0
    assert preview_levels(settings, LIGHTS) == (0.5, 1.0, 3.0)
    # Another model, with its lights in another order and one more; then none.
    others = ("sun", "Küche", "screen")
    follow_lights(settings, others, USUAL)
    assert preview_levels(settings, others) == (0.5, 3.0, 1.0)
    follow_lights(settings, (), ())
    assert preview_levels(settings, LIGHTS) == (0.5, 1.0, 3.0)


def test_levels_begin_as_the_photographs_have_them(settings):
    """A lamp that was on in its group alone is off; what the user sets stays, also of the first light."""
    standard = (0.25, 0.0, 1.0)
    follow_lights(settings, LIGHTS, standard)
    assert preview_levels(settings, LIGHTS) == standard
    settings.lighting_level, settings.further_levels["pendant"].level = 2.0, 3.0
    follow_lights(settings, LIGHTS, standard)
    assert preview_levels(settings, LIGHTS) == (2.0, 3.0, 1.0)
    follow_lights(settings, ("ambient",), (1.0,))  # another model
    assert preview_levels(settings, ("ambient",)) == (1.0,)


def test_levels_are_saved_with_the_scene(settings, tmp_path):
    follow_lights(settings, LIGHTS, USUAL)
    settings.further_levels["pendant"].level = 0.25
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert preview_levels(bpy.context.scene.physhdr, LIGHTS) == (1.0, 0.25, 1.0)


def test_a_sliders_change_is_asked_for_with_every_level(settings):
    camera = ViewCamera(np.eye(4), 64, 48, 80.0, 80.0, 32.0, 24.0)
    follow_lights(settings, LIGHTS, USUAL)
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


def test_the_preview_follows_the_model_of_its_run_that_is_in_the_scene(settings, make_model, tmp_path):
    """One place for exposure and levels: the imported model's sliders, by its lights' names; else its own."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    steps = np.linspace(-8.0, 8.0, 32, dtype=np.float32)
    curve = np.repeat(1.0 / (1.0 + np.exp(-steps))[:, None], 3, axis=1).astype(np.float32)
    model = replace(make_model(lights=LIGHTS), tone_curve_log_exposure=steps, tone_curve=curve)
    for name in ("run", "other"):
        (tmp_path / name).mkdir()
        write_model(tmp_path / name / "model.safetensors", model)
        bpy.ops.physhdr.model_import(filepath=str(tmp_path / name / "model.safetensors"), name=name)
    follow_lights(settings, LIGHTS, USUAL)
    settings.exposure_ev, settings.lighting_level, settings.tone = 1.0, 0.25, "linear"
    own = (1.0, (0.25, 1.0, 1.0), "linear")
    # Another order of lights than the file's, and one that the file has not.
    job = JobStatus(
        state="open", run=str(tmp_path / "run"), has_model=True, lights=("Küche", "ambient", "sun")
    )
    target, other = bpy.data.objects["run"], bpy.data.objects["other"]
    modifier = nodes.find_modifier(target)
    for label, value in (
        (nodes.EXPOSURE, -2.0),
        (nodes.level_input(LIGHTS, 2), 3.0),
        (nodes.TONE_MAPPER, True),
    ):
        nodes.set_input(modifier, label, value)
    for active in (target, other, None):  # whatever is selected beside it
        layer.objects.active = active
        assert followed(scene, layer, job) == target
        assert preview_look(scene, layer, job) == (-2.0, (3.0, 1.0, 1.0), "learned")
    (tmp_path / "link").symlink_to(tmp_path / "run")
    assert followed(scene, layer, replace(job, run=str(tmp_path / "link"))) == target
    twin = target.copy()
    scene.collection.objects.link(twin)
    nodes.set_input(nodes.find_modifier(twin), nodes.EXPOSURE, 4.0)
    layer.objects.active = twin  # of two the active one
    assert preview_look(scene, layer, job)[0] == 4.0
    for gone in (replace(job, run=str(tmp_path / "third")), replace(job, has_model=False)):
        assert followed(scene, layer, gone) is None
    here = replace(job, run=str(tmp_path / "third"), lights=LIGHTS)
    assert preview_look(scene, layer, here) == own


def test_the_exposure_begins_where_photographs_look_as_they_did(settings):
    """And what is added to it stays added, whatever model comes next."""
    for _ in range(3):  # the timer looks again and again
        follow_exposure(settings, -6.907)
    assert settings.exposure_ev == pytest.approx(-6.907)
    settings.exposure_ev += 1.0
    follow_exposure(settings, -6.907)
    assert settings.exposure_ev == pytest.approx(-5.907)
    follow_exposure(settings, 0.0)
    assert settings.exposure_ev == pytest.approx(1.0, abs=1e-5)
