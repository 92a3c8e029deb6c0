# SPDX-License-Identifier: GPL-3.0-or-later
"""What is separated from a model in Edit Mode is a model, with the lights and the response of the whole."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import attributes, model_import, pose  # noqa: E402
from physhdr.addon.model.look import is_model  # noqa: E402
from physhdr.addon.model.point_removal import select_points  # noqa: E402
from physhdr.bridge.model_file import read_model  # noqa: E402

COUNT, TAKEN = 50, 20


@pytest.fixture
def model(make_model):
    x = np.linspace(-8.0, 4.0, 20).astype(np.float32)
    curve = np.repeat(np.linspace(0.0, 1.0, 20, dtype=np.float32)[:, None], 3, axis=1)
    found = make_model(count=COUNT, lights=("ambient", "lamp"))
    return dataclasses.replace(found, tone_curve_log_exposure=x, tone_curve=curve)


@pytest.fixture
def whole(registered, model, write):
    found = model_import.import_model(write(model), name="room")
    bpy.context.view_layer.objects.active = found
    found.select_set(True)
    return found


def separated(whole):
    bpy.ops.object.mode_set(mode="EDIT")
    select_points(whole.data, np.arange(COUNT) < TAKEN)
    assert bpy.ops.pointcloud.separate() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    (part,) = (each for each in bpy.data.objects if each.type == "POINTCLOUD" and each != whole)
    return part


def test_a_part_saves_as_what_the_whole_had_there(whole, model, tmp_path):
    part = separated(whole)
    for target, chosen in ((part, slice(None, TAKEN)), (whole, slice(TAKEN, None))):
        assert is_model(target)
        path = tmp_path / f"{target.name}.safetensors"
        with bpy.context.temp_override(active_object=target, object=target):
            assert bpy.ops.physhdr.model_save(filepath=str(path)) == {"FINISHED"}
        found = read_model(path)
        assert found.lights == model.lights
        np.testing.assert_array_equal(found.position, model.position[chosen])
        np.testing.assert_allclose(found.log_radiance_sh, model.log_radiance_sh[chosen], atol=1e-6)
        np.testing.assert_array_equal(found.tone_curve, model.tone_curve)


def test_the_two_are_told_apart(whole):
    part = separated(whole)
    assert part.data[attributes.IDENTITY] != whole.data[attributes.IDENTITY]
    assert part[attributes.SHOWS] == part.data[attributes.IDENTITY]


def test_what_was_separated_without_us_is_one_when_opened(whole, tmp_path):
    pose.unregister()
    try:
        name = separated(whole).name
        assert not is_model(bpy.data.objects[name])
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "parts.blend"))
    finally:
        pose.register()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "parts.blend"))
    assert is_model(bpy.data.objects[name])


def test_other_point_clouds_stay_what_they_are(whole):
    other = bpy.data.objects.new("other", bpy.data.pointclouds.new("other"))
    bpy.context.scene.collection.objects.link(other)
    other.data.resize(3)
    bpy.context.view_layer.update()
    assert not is_model(other)
