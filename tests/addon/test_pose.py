# SPDX-License-Identifier: GPL-3.0-or-later
"""*Apply* on a model: its Gaussians show the same afterwards, as covariances in the world say, in float64."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import mathutils  # noqa: E402

from physhdr.addon.model import attributes, model_import, pose  # noqa: E402
from physhdr.addon.model.point_cloud import read_attribute, write_attribute  # noqa: E402
from physhdr.addon.model.point_removal import select_points  # noqa: E402

#: float32 at a metre, once into the points and back.
CLOSE = 1e-6


@pytest.fixture
def target(registered, make_model, write):
    """A model that is moved, turned and three times as large."""
    found = model_import.import_model(write(make_model(count=50)))
    bpy.context.view_layer.objects.active = found
    found.select_set(True)
    found.location, found.rotation_euler, found.scale = (1.0, -2.0, 0.5), (0.3, -0.2, 1.1), (3.0,) * 3
    bpy.context.view_layer.update()
    return found


def apply(**what) -> None:
    chosen = {"location": True, "rotation": True, "scale": True, **what}
    assert bpy.ops.object.transform_apply(**chosen) == {"FINISHED"}
    settled()


def settled() -> None:
    for _ in range(2):  # what is set while Blender tells of a change is evaluated the next time
        bpy.context.view_layer.update()


def shown(target) -> tuple[np.ndarray, np.ndarray]:
    """Places ``[N, 3]`` and covariances ``[N, 3, 3]`` of the Gaussians in the world."""
    matrix = np.array(target.matrix_world, np.float64)
    linear = matrix[:3, :3]
    position, rotation, scale = (
        read_attribute(target.data, name).astype(np.float64) for name in ("position", "rotation", "scale")
    )
    w, x, y, z = rotation.T
    axes = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    half = linear @ (axes * scale[:, None])
    return position @ linear.T + matrix[:3, 3], half @ half.transpose(0, 2, 1)


def is_shown_as(target, before: tuple[np.ndarray, np.ndarray]) -> None:
    after = shown(target)
    np.testing.assert_allclose(after[0], before[0], atol=5 * CLOSE)
    np.testing.assert_allclose(after[1], before[1], atol=20 * CLOSE * np.abs(before[1]).max())


@pytest.mark.parametrize("left_out", ["", "scale", "rotation", "location", "location scale"])
@pytest.mark.parametrize("scale", [(3.0,) * 3, (1.0, 2.0, 0.5), (-2.0, 2.0, 2.0)])
def test_after_apply_it_looks_the_same(target, left_out, scale):
    target.scale = scale
    settled()
    before, matrix = shown(target), np.array(target.matrix_world)
    apply(**dict.fromkeys(left_out.split(), False))
    is_shown_as(target, before)
    # Not by other Gaussians: directions and metres of the model are those of before.
    np.testing.assert_allclose(np.array(target.matrix_world), matrix, atol=10 * CLOSE)


def test_what_hangs_on_it_and_what_it_hangs_on_stay(target):
    parent, child = (bpy.data.objects.new(name, None) for name in ("parent", "child"))
    for each in (parent, child):
        bpy.context.scene.collection.objects.link(each)
    parent.location, parent.scale = (0.0, 5.0, 0.0), (0.5,) * 3
    target.parent, child.parent = parent, target
    child.location = (0.1, 0.2, 0.3)
    settled()
    before, hangs = shown(target), np.array(child.matrix_world)
    apply()
    is_shown_as(target, before)
    np.testing.assert_allclose(np.array(child.matrix_world), hangs, atol=10 * CLOSE)


@pytest.mark.parametrize("both", [False, True])
def test_of_two_that_share_their_points_each_looks_the_same(target, both):
    """Apply gives the one a copy, or is for both; a turn of the shared points turns both."""
    other = target.copy()
    bpy.context.scene.collection.objects.link(other)
    other.location.x += 5.0
    other.select_set(both)
    settled()
    before = shown(target), shown(other)
    apply(isolate_users=True)
    assert (target.data == other.data) == both
    is_shown_as(target, before[0])
    is_shown_as(other, before[1])
    target.data = other.data
    write_attribute(other.data, attributes.POSITION, read_attribute(other.data, "position") * 2.0)
    other.data.update_tag()
    settled()
    for each in (target, other):
        assert tuple(each.scale) == pytest.approx((6.0,) * 3, rel=1e-5)


def test_an_origin_elsewhere_leaves_the_points_in_the_space_of_the_data_set(target):
    """Of a place alone Gaussians stay whole, but cameras and probes are told from that origin."""
    target.rotation_euler, target.scale = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    settled()
    before, position = shown(target), read_attribute(target.data, "position")
    apply()
    bpy.ops.object.origin_set(type="ORIGIN_GEOMETRY", center="BOUNDS")
    settled()
    is_shown_as(target, before)
    np.testing.assert_allclose(read_attribute(target.data, "position"), position, atol=CLOSE)
    assert tuple(target.location) == pytest.approx((1.0, -2.0, 0.5), abs=CLOSE)
    assert tuple(target.rotation_euler) == (0.0, 0.0, 0.0)


def test_undo_and_redo_bring_back_what_looks_the_same(target):
    """Blender's step after Apply holds the points alone: it is set right when it comes back."""
    name, before = target.name, shown(target)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.object.transform_apply() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="Apply")
    settled()
    is_shown_as(bpy.data.objects[name], before)
    bpy.ops.object.empty_add()
    bpy.ops.ed.undo_push(message="something else")
    for step in ("undo", "undo", "redo", "redo", "undo"):
        getattr(bpy.ops.ed, step)()
        settled()
        is_shown_as(bpy.data.objects[name], before)


def test_saved_before_it_was_set_right_it_is_when_opened(target, tmp_path):
    name, before = target.name, shown(target)
    pose.unregister()
    try:
        bpy.ops.object.transform_apply()
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    finally:
        pose.register()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    settled()
    is_shown_as(bpy.data.objects[name], before)


def test_all_points_turned_in_edit_mode_turn_the_model(target):
    places, gaussians = shown(target)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.pointcloud.select_all(action="SELECT")
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    write_attribute(target.data, attributes.POSITION, read_attribute(target.data, "position") @ turn.T)
    target.data.update_tag()
    settled()
    during = read_attribute(target.data, "position")
    bpy.ops.object.mode_set(mode="OBJECT")
    target.data.update_tag()
    settled()
    assert not np.allclose(during, read_attribute(target.data, "position")), "Edit Mode is left alone"
    linear = np.array(target.matrix_world)[:3, :3] / 3.0
    was = linear @ np.linalg.inv(turn)  # the turn is in the model's space
    world = was @ turn @ np.linalg.inv(was)
    middle = np.array(target.matrix_world.translation)
    is_shown_as(target, ((places - middle) @ world.T + middle, world @ gaussians @ world.T))


def test_what_is_turned_after_some_were_deleted_turns_the_model(target):
    """In one visit of Edit Mode: of the points that are left it is known what they do together."""
    places, gaussians = shown(target)
    bpy.ops.object.mode_set(mode="EDIT")
    select_points(target.data, np.arange(50) < 10)
    bpy.ops.pointcloud.delete()
    settled()
    bpy.ops.pointcloud.select_all(action="SELECT")
    bpy.ops.transform.rotate(
        value=0.5, orient_axis="X", orient_type="GLOBAL", center_override=(1.0, -2.0, 0.5)
    )
    bpy.ops.object.mode_set(mode="OBJECT")
    settled()
    turn = np.array(mathutils.Matrix.Rotation(0.5, 3, "X"))
    middle = np.array([1.0, -2.0, 0.5])
    is_shown_as(target, ((places[10:] - middle) @ turn.T + middle, turn @ gaussians[10:] @ turn.T))


def test_a_shear_which_no_object_has_stays_in_the_points(target):
    """A turned model whose points are stretched along an axis of the world."""
    matrix, position = target.matrix_basis.copy(), read_attribute(target.data, "position")
    linear = np.array(target.matrix_world)[:3, :3]
    inside = np.linalg.inv(linear) @ np.diag([1.0, 1.0, 2.0]) @ linear
    wanted = (position @ inside.T).astype(np.float32)
    write_attribute(target.data, attributes.POSITION, wanted)
    target.data.update_tag()
    settled()
    np.testing.assert_array_equal(read_attribute(target.data, "position"), wanted)
    assert target.matrix_basis == matrix


def test_who_joins_models_is_told_that_they_are_not_one(target, make_model, write):
    other = model_import.import_model(write(make_model(count=30, seed=1)))
    settled()
    other.select_set(True)
    with pytest.MonkeyPatch.context() as patch:
        told = []
        patch.setattr(pose, "settle", lambda cloud, real=pose.settle: told.append(real(cloud)))
        assert bpy.ops.object.join() == {"FINISHED"}
        settled()
    assert len(target.data.points) == 80
    assert pose.JOINED in told


@pytest.mark.parametrize("edit", ["some", "deleted", "whole", "shuffled", "line"])
def test_other_edits_stay(target, edit):
    """Some points moved, others gone, or whoever turned axes and sizes, too."""
    cloud, matrix = target.data, target.matrix_basis.copy()
    if edit == "line":
        write_attribute(cloud, attributes.POSITION, np.linspace(0, 1, 50)[:, None] * [[1.0, 2.0, 3.0]])
        pose.remember(cloud)
    position = read_attribute(cloud, "position")
    wanted = position * np.float32(2.0)
    if edit == "some":
        wanted[:40] = position[:40]
    elif edit == "deleted":
        cloud.resize(30)
        wanted = wanted[:30]
    elif edit == "whole":
        write_attribute(cloud, attributes.SCALE, read_attribute(cloud, "scale") * 2.0)
    elif edit == "shuffled":
        wanted = position[::-1]
    write_attribute(cloud, attributes.POSITION, wanted)
    cloud.update_tag()
    settled()
    np.testing.assert_array_equal(read_attribute(cloud, "position"), wanted)
    assert target.matrix_basis == matrix
    # And what comes next is seen.
    if edit != "line":
        before = shown(target)
        apply()
        is_shown_as(target, before)


def test_models_of_before_are_kept_whole_from_the_first_look(target):
    del target.data[attributes.WITNESS]
    pose._settle_all()
    before = shown(target)
    apply()
    is_shown_as(target, before)


def test_a_slider_costs_little(registered, make_model, write, monkeypatch):
    """Blender tells of a changed cloud at every step of one: few numbers are read, however many Gaussians."""
    target = model_import.import_model(write(make_model(count=5000)))
    monkeypatch.setattr(pose, "read_attribute", None)
    monkeypatch.setattr(pose, "remember", None)
    assert len(pose._read(target.data)) == pose.WITNESSES
    assert not pose.settle(target.data)
