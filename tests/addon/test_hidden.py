# SPDX-License-Identifier: GPL-3.0-or-later
"""What views do not show still stands where it stands, though Blender computes that no more, and after
loading a file not at all."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.blender import put_at, world_of  # noqa: E402
from physhdr.addon.capture import placement  # noqa: E402
from physhdr.addon.model import model_import, origin  # noqa: E402
from physhdr.addon.model.attributes import CAPTURE  # noqa: E402
from physhdr.addon.model.look import cleaning_of, kept_of  # noqa: E402
from physhdr.bridge.model_file import read_model  # noqa: E402


@pytest.fixture
def target(registered, make_model, write):
    """A model of 200 Gaussians, moved."""
    found = model_import.import_model(write(make_model(count=200)))
    bpy.context.view_layer.objects.active = found
    found.select_set(True)
    found.location = (5.0, 1.0, 0.0)
    bpy.context.view_layer.update()
    return found


def monitor(*items) -> None:
    for item in items:
        item.hide_viewport = True


def eye(*items) -> None:
    for item in items:
        item.hide_set(True)


def off(*items) -> None:
    _away(items).collection.hide_viewport = True


def excluded(*items) -> None:
    _away(items).exclude = True


def _away(items):
    """The layer's part of a collection that has these objects alone."""
    made = bpy.data.collections.new("away")
    bpy.context.scene.collection.children.link(made)
    for item in items:
        for each in item.users_collection:
            each.objects.unlink(item)
        made.objects.link(item)
    return bpy.context.view_layer.layer_collection.children["away"]


def opened_again(path, *names):
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return [bpy.data.objects[name] for name in names]


@pytest.fixture(params=[eye, monitor, off, excluded])
def hide(request):
    return request.param


def test_a_hidden_crop_box_crops_as_before(target, hide, tmp_path):
    bpy.ops.physhdr.cleaning_box()
    (box,) = (each for each in bpy.data.objects if each.type == "EMPTY")
    box.scale.x *= 0.5
    bpy.context.view_layer.update()

    def count(target):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return [int(kept_of(target.data, cleaning_of(target, each)).sum()) for each in (None, depsgraph)]

    shown = count(target)
    assert 20 < shown[0] == shown[1] < 180
    hide(box)
    (target,) = opened_again(tmp_path / "boxed.blend", target.name)
    assert count(target) == shown


def test_where_a_child_of_what_is_hidden_stands(registered, hide, tmp_path):
    """Against what Blender itself says while all is shown; delta transforms and a mirrored parent too."""
    parent, child = (bpy.data.objects.new(name, None) for name in ("parent", "child"))
    for each in (parent, child):
        registered.collection.objects.link(each)
    parent.location, parent.rotation_euler, parent.scale = (1.0, 2.0, 3.0), (0.3, 0.4, 0.5), (2.0, -1.0, 0.5)
    parent.delta_location = (0.5, 0.0, 0.0)
    bpy.context.view_layer.update()
    child.parent, child.matrix_parent_inverse = parent, parent.matrix_world.inverted()
    child.location, child.rotation_euler, child.delta_scale = (
        (-1.0, 0.5, 4.0),
        (0.2, 0.1, 1.0),
        (1.0, 2.0, 3.0),
    )
    bpy.context.view_layer.update()
    expected = [np.array(each.matrix_world) for each in (parent, child)]
    hide(parent)
    both = opened_again(tmp_path / "child.blend", "parent", "child")
    for each, matrix in zip(both, expected, strict=True):
        np.testing.assert_allclose(np.array(world_of(each)), matrix, atol=1e-5)
    wanted = world_of(both[1]).copy()
    wanted.translation.x += 1.0
    put_at(both[1], wanted)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(world_of(both[1])), np.array(wanted), atol=1e-5)


def test_a_capture_moves_with_its_hidden_cameras(target, hide, tmp_path):
    cameras = [bpy.data.objects.new(f"camera {k}", bpy.data.cameras.new("camera")) for k in range(2)]
    for k, camera in enumerate(cameras):
        camera[placement.FRAME], camera[CAPTURE] = str(k), origin.capture_of(target)
        camera.location = (5.0 + k, -2.0 * k, 1.0)
        bpy.context.scene.collection.objects.link(camera)
    bpy.context.view_layer.update()
    hide(*cameras)
    target, *cameras = opened_again(tmp_path / "cameras.blend", target.name, "camera 0", "camera 1")
    placement.move(bpy.context.scene, target, np.diag([2.0, 2.0, 2.0, 1.0]))
    places = [np.array(world_of(camera).translation) for camera in cameras]
    np.testing.assert_allclose(places, [(10.0, 0.0, 2.0), (12.0, -4.0, 2.0)], atol=1e-5)


def test_a_hidden_model_is_saved_where_it_stands(target, hide, tmp_path):
    middle = world_of(target).translation
    hide(target)
    (target,) = opened_again(tmp_path / "model.blend", target.name)
    with bpy.context.temp_override(active_object=target, object=target):
        bpy.ops.physhdr.model_save(filepath=str(tmp_path / "out.safetensors"), apply_transform=True)
    found = read_model(tmp_path / "out.safetensors").position.mean(axis=0)
    np.testing.assert_allclose(found, np.array(middle), atol=0.2)
