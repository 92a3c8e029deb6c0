# SPDX-License-Identifier: GPL-3.0-or-later
"""A model is cleaned for good, in Object and in Edit Mode, undone, saved in our own format, read again."""

import dataclasses
import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.errors import DataMismatchError
from physhdr.bridge.model_file import read_model

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import attributes, edited_model, floaters, look, nodes, point_cloud, point_removal  # noqa: E402
from physhdr.addon.panels import cleaning as panel  # noqa: E402


@pytest.fixture
def add(registered, make_model, write):
    def add(**options):
        model = make_model(**options)
        bpy.ops.physhdr.model_import(filepath=str(write(model)))
        return model, bpy.context.object, nodes.find_modifier(bpy.context.object)

    return add


@pytest.mark.parametrize("edit_mode", [False, True])
def test_what_is_hidden_is_removed_and_comes_back_with_undo(add, edit_mode: bool):
    model, target, modifier = add(count=500)
    name = target.name
    own = target.data.attributes.new("mine", "INT", "POINT")
    own.data.foreach_set("value", np.arange(500, dtype=np.int32))
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.5)
    nodes.set_input(modifier, nodes.FARTHEST, 1.0)
    if edit_mode:
        bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.physhdr.cleaning_apply("EXEC_DEFAULT", True) == {"FINISHED"}
    target = bpy.data.objects[name]
    keep = model.opacity >= 0.5
    assert 100 < keep.sum() < 400 and len(target.data.points) == keep.sum()
    left = point_cloud.model_of(target.data)
    np.testing.assert_array_equal(left.position, model.position[keep])
    np.testing.assert_array_equal(left.light_share, model.light_share[keep])
    numbers = np.empty(keep.sum(), np.int32)
    target.data.attributes["mine"].data.foreach_get("value", numbers)
    np.testing.assert_array_equal(numbers, np.flatnonzero(keep))
    assert look.cleaning_of(target).without_camera().keeps_everything != edit_mode
    assert look.kept_of(target.data, look.cleaning_of(target)).all()
    assert look.cleaning_of(target).farthest == 1.0  # only the camera's: it stays
    bpy.ops.ed.undo()
    target = bpy.data.objects[name]
    np.testing.assert_array_equal(point_cloud.model_of(target.data).opacity, model.opacity)
    assert look.cleaning_of(target).smallest_opacity == 0.5


def test_the_unsure_are_selected_hidden_and_left_out_of_what_is_saved(add, tmp_path):
    model, target, modifier = add(count=300, confidence=True)
    assert bpy.ops.physhdr.cleaning_select(by="CONFIDENCE", limit=0.4) == {"FINISHED"}
    np.testing.assert_array_equal(point_removal.selection_of(target.data), model.confidence < np.float32(0.4))
    nodes.set_input(modifier, nodes.SMALLEST_CONFIDENCE, 0.4)
    keep = model.confidence >= np.float32(0.4)
    assert 50 < keep.sum() < 250
    assert bpy.ops.physhdr.model_save(filepath=str(tmp_path / "sure.safetensors")) == {"FINISHED"}
    saved = read_model(tmp_path / "sure.safetensors")
    np.testing.assert_array_equal(saved.confidence, model.confidence[keep])
    assert bpy.ops.physhdr.cleaning_apply() == {"FINISHED"}
    np.testing.assert_array_equal(point_cloud.model_of(target.data).confidence, model.confidence[keep])
    assert look.cleaning_of(target).smallest_confidence == 0.0


def test_a_model_that_does_not_know_its_confidence_says_so(add):
    _, target, _ = add()
    with pytest.raises(RuntimeError, match=r"does not know how sure[\s\S]*physhdr export"):
        bpy.ops.physhdr.cleaning_select(by="CONFIDENCE", limit=0.4)
    assert point_cloud.model_of(target.data).confidence is None


def test_limits_that_hide_everything_remove_nothing(add):
    _, target, modifier = add()
    nodes.set_input(modifier, nodes.LARGEST_SIZE, 1e-9)
    with pytest.raises(RuntimeError, match="everything of the model is hidden"):
        bpy.ops.physhdr.cleaning_apply()
    assert len(target.data.points) == 40


def test_of_a_model_without_gaussians_nothing_is_asked(add):
    """All of them can be deleted in Edit Mode."""
    add()[1].data.resize(0)
    for operator in (bpy.ops.physhdr.cleaning_select, bpy.ops.physhdr.cleaning_box):
        with pytest.raises(RuntimeError, match="has no Gaussians: all were deleted"):
            operator()


def test_animated_limits_are_named(add):
    _, target, modifier = add()
    target.keyframe_insert(nodes.input_data_path(modifier, nodes.LARGEST_SIZE), frame=1)
    target.driver_add(nodes.input_data_path(modifier, nodes.LARGEST_DISTANCE))
    from physhdr.addon.operators.cleaning import _reset

    assert _reset(target) == [nodes.LARGEST_SIZE, nodes.LARGEST_DISTANCE]


@pytest.mark.parametrize(
    ("by", "limit", "wanted"),
    [
        ("SIZE", 0.15, lambda m: m.scale.max(axis=1) > 0.15),
        ("OPACITY", 0.3, lambda m: m.opacity < 0.3),
        ("ELONGATION", 3.0, lambda m: np.sort(m.scale)[:, 2] > 3.0 * np.sort(m.scale)[:, 1]),
        ("DISTANCE", 0.5, lambda m: np.linalg.norm(m.position - [0.5, 0, 0], axis=1) > 0.5),
    ],
)
def test_selected_is_what_is_beyond_the_limit_and_delete_removes_it(add, scene, by, limit, wanted):
    model, target, _ = add(count=300)
    target.location.y = 2.0
    bpy.context.view_layer.update()
    scene.cursor.location = (0.5, 2.0, 0.0)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.physhdr.cleaning_select(by=by, limit=limit)
    found = wanted(model)
    assert 5 < found.sum() < 295
    np.testing.assert_array_equal(point_removal.selection_of(target.data), found)
    faint = model.opacity < 0.5
    bpy.ops.physhdr.cleaning_select(by="OPACITY", limit=0.5, action="EXTEND")
    np.testing.assert_array_equal(point_removal.selection_of(target.data), found | faint)
    bpy.ops.physhdr.cleaning_select(by="OPACITY", limit=0.5, action="SUBTRACT")
    np.testing.assert_array_equal(point_removal.selection_of(target.data), found & ~faint)
    bpy.ops.pointcloud.delete()
    np.testing.assert_array_equal(point_cloud.model_of(target.data).opacity, model.opacity[~(found & ~faint)])


def test_each_criterion_begins_with_a_limit_of_its_own(add):
    """Blender remembers what an operator was given, as it does from menus: with undo, not from a script."""
    model, target, _ = add(count=300, confidence=True)

    def select(by: str, **given) -> np.ndarray:
        assert bpy.ops.physhdr.cleaning_select("EXEC_DEFAULT", True, by=by, **given) == {"FINISHED"}
        return point_removal.selection_of(target.data)

    unsure, faint = model.confidence < np.float32(0.1), model.opacity < np.float32(0.1)
    assert 5 < unsure.sum() < 100 and 5 < faint.sum() < 100
    for limit, action in ((10.0, "REPLACE"), (10.0, "SUBTRACT")):
        select("ELONGATION", limit=limit, action=action)
        np.testing.assert_array_equal(select("OPACITY"), faint)
        np.testing.assert_array_equal(select("CONFIDENCE"), unsure)
    middle, longest = np.sort(model.scale)[:, 1:].T
    np.testing.assert_array_equal(select("ELONGATION"), longest > 10.0 * middle)
    for by in ("SIZE", "DISTANCE"):
        assert 1 <= select(by).sum() <= 100


def test_a_crop_box_fits_the_model_and_selects_what_it_hides(add):
    _, target, modifier = add(count=400)
    with pytest.raises(RuntimeError, match="no crop box"):
        bpy.ops.physhdr.cleaning_select(by="CROP")
    target.rotation_euler.z, target.scale = 0.5, (2.0,) * 3
    bpy.context.view_layer.update()
    bpy.ops.physhdr.cleaning_box()
    keep = look.kept_of(target.data, look.cleaning_of(target))
    assert 0.8 < keep.mean() < 1.0
    nodes.set_input(modifier, nodes.CROP, False)
    bpy.ops.physhdr.cleaning_select(by="CROP")
    np.testing.assert_array_equal(point_removal.selection_of(target.data), ~keep)


def test_a_crop_box_is_added_to_the_scene_in_which_it_was_asked_for(add):
    """A linked copy of the scene has the model in a collection of its own."""
    _, target, _ = add()
    first = bpy.context.scene
    bpy.ops.scene.new(type="LINK_COPY")
    second = bpy.context.scene
    bpy.context.view_layer.objects.active = target
    assert bpy.ops.physhdr.cleaning_box() == {"FINISHED"}
    box = bpy.data.objects[f"{target.name} crop"]
    assert box.name in second.objects and box.name not in first.objects


def data_set(folder: Path, places: list) -> None:
    """Cameras in our own layout."""
    folder.mkdir()
    frames = []
    for place in places:
        pose = np.eye(4)
        pose[:3, 3] = place
        frames.append({"file_path": "train/a", "transform_matrix": pose.tolist()})
    (folder / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 0.8, "frames": frames}))
    (folder / "exposure_train.json").write_text(json.dumps({"./train/a_0.png": 1.0}))


def test_distances_are_to_the_nearest_camera_of_the_data_set(add, tmp_path):
    model, target, modifier = add(count=200)
    with pytest.raises(RuntimeError, match="data set of this model is not there"):
        bpy.ops.physhdr.cleaning_measure()
    places = [[0.5, 0.0, 0.0], [-0.5, 0.2, 0.1]]
    data_set(tmp_path / "data", places)
    target.data[attributes.CAPTURE] = str(tmp_path / "data")
    target.location = (5.0, 5.0, 5.0)  # the cameras go with the model
    bpy.ops.physhdr.cleaning_measure()
    expected = np.linalg.norm(model.position[:, None] - np.array(places), axis=2).min(axis=1)
    got = point_cloud.read_attribute(target.data, attributes.CAMERA_DISTANCE.name)
    np.testing.assert_allclose(got, expected, atol=1e-6)
    nodes.set_input(modifier, nodes.CLEAR_OF_PHOTOS, 0.3)
    bpy.ops.physhdr.cleaning_select(by="HIDDEN")
    np.testing.assert_array_equal(point_removal.selection_of(target.data), got < np.float32(0.3))


@pytest.mark.parametrize("turned", [0.0, 0.7])
def test_of_a_flat_model_no_camera_has_a_distance(registered, add, turned):
    _, target, _ = add(count=20)
    target.scale, target.rotation_euler = (1.0, 1.0, 0.0), (turned, turned, 0.0)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    registered.collection.objects.link(camera)
    bpy.context.view_layer.update()
    camera.select_set(True)
    with pytest.raises(RuntimeError, match="mirrored or flat"):
        bpy.ops.physhdr.cleaning_measure()
    # Mirrored and uneven it has a place for them all the same.
    target.scale = (1.0, -2.0, 1.0)
    bpy.context.view_layer.update()
    assert bpy.ops.physhdr.cleaning_measure() == {"FINISHED"}


def room(rng) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Walls of a room 4 m wide, and 40 blobs that hang before its cameras."""
    wall = rng.uniform(-2.0, 2.0, (6000, 3))
    wall[np.arange(6000), rng.integers(0, 3, 6000)] = rng.choice([-2.0, 2.0], 6000)
    blobs = rng.uniform(-0.5, 0.5, (40, 3))
    scale = np.full((6040, 3), 0.04)
    scale[6000:] = 0.2
    opacity = np.concatenate([rng.uniform(0.5, 1.0, 6000), rng.uniform(0.02, 0.2, 40)])
    return np.concatenate([wall, blobs]), scale, opacity, np.arange(6040) >= 6000


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_blobs_before_the_cameras_are_found_and_walls_are_not(size: float):
    rng = np.random.default_rng(0)
    position, scale, opacity, wanted = room(rng)
    camera_distance = np.linalg.norm(position, axis=1)
    for distance in (None, camera_distance * size):
        found = floaters.floaters(position * size, scale * size, opacity, distance)
        assert found[wanted].mean() > 0.9 and found[~wanted].mean() < 0.005


def test_one_gaussian_at_the_end_of_the_world_is_no_obstacle():
    position, scale, opacity, wanted = room(np.random.default_rng(1))
    position[0] = 1e6
    assert floaters.floaters(position, scale, opacity)[wanted].mean() > 0.9


def test_opacities_around_are_those_of_27_cells():
    rng = np.random.default_rng(2)
    position, opacity = rng.uniform(-1, 1, (300, 3)), rng.uniform(size=300)
    cells = np.floor((position - position.min(axis=0)) / 0.3).astype(int)
    near = np.abs(cells[:, None] - cells).max(axis=2) <= 1
    np.testing.assert_allclose(floaters.opacity_around(position, opacity, 0.3), near @ opacity)


def test_find_floaters_only_selects(add):
    _, target, _ = add(count=50)
    bpy.ops.physhdr.cleaning_floaters()
    assert bpy.context.mode == "EDIT_POINTCLOUD" and len(target.data.points) == 50


def test_floaters_of_a_model_that_is_not_shown_are_selected_and_it_says_how_to_see_them(add, capfd):
    _, target, _ = add(count=50)
    target.hide_viewport = True
    assert bpy.ops.physhdr.cleaning_floaters() == {"FINISHED"}
    assert bpy.context.mode == "OBJECT" and "monitor icon" in capfd.readouterr().out
    found = floaters.floaters(
        *(point_cloud.read_attribute(target.data, name) for name in ("position", "scale")),
        point_cloud.model_of(target.data).opacity,
    )
    np.testing.assert_array_equal(point_removal.selection_of(target.data), found)


def test_overridden_points_are_not_cleaned(add, tmp_path):
    """Blender saves an override's modifiers and transforms, and of its points nothing."""
    _, target, _ = add(count=50)
    name = target.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = [name]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    target = wanted.objects[0].override_create(remap_local_usages=True)
    target.data.override_create(remap_local_usages=True)
    assert target.data.override_library and target.data.is_editable
    bpy.context.view_layer.objects.active = target
    nodes.set_input(nodes.find_modifier(target), nodes.SMALLEST_OPACITY, 0.5)
    for operator in (bpy.ops.physhdr.cleaning_apply, bpy.ops.physhdr.cleaning_floaters):
        with pytest.raises(RuntimeError, match="does not save changes to the points of a library override"):
            operator()
    assert len(target.data.points) == 50
    assert look.cleaning_of(target).smallest_opacity == 0.5
    assert bpy.ops.physhdr.cleaning_box() == {"FINISHED"}  # the modifier's inputs are saved


LIGHTS = ("ambient", "lamp, Küche")


@pytest.mark.parametrize("options", [{}, {"lights": LIGHTS}, {"modulator": "baked-levels"}, {"degree": 3}])
def test_saved_without_edits_and_imported_again_it_is_the_same_to_the_bit(add, tmp_path, options):
    model, target, _ = add(count=3000, **options)
    first = point_cloud.model_of(target.data)
    bpy.ops.physhdr.model_save(filepath=str(tmp_path / "again.safetensors"))
    bpy.ops.physhdr.model_import(filepath=str(tmp_path / "again.safetensors"))
    second = point_cloud.model_of(bpy.context.object.data)
    assert second.tensors().keys() == model.tensors().keys()
    for name, array in first.tensors().items():
        np.testing.assert_array_equal(second.tensors()[name], array, err_msg=name)
        if name != "rotation":  # which the file need not have of unit length
            np.testing.assert_array_equal(array, getattr(model, name), err_msg=name)
    assert (second.lights, second.levels, second.exposures) == (model.lights, model.levels, model.exposures)
    edited = f"Blender {bpy.app.version_string}"
    assert dict(second.metadata) == {**model.metadata, "edited": edited}
    for shown in ("radiance:base", "radiance:sh_0"):
        clouds = target.data, bpy.context.object.data
        np.testing.assert_array_equal(*(point_cloud.read_attribute(cloud, shown) for cloud in clouds))


def test_saved_is_what_is_not_hidden(add, tmp_path):
    model, _, modifier = add(count=300, modulator="baked-levels")
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.5)
    nodes.set_input(modifier, nodes.ONLY_IN_VIEW, True)
    path = tmp_path / "cleaned.safetensors"
    bpy.ops.physhdr.model_save(filepath=str(path))
    saved, keep = read_model(path), model.opacity >= 0.5
    np.testing.assert_array_equal(saved.level_log_gain, model.level_log_gain[:, keep])
    assert f"{(~keep).sum()} of 300 Gaussians left out" in saved.metadata["edited"]
    bpy.ops.physhdr.model_save(filepath=str(path), leave_out=False)
    assert read_model(path).count == 300
    nodes.set_input(modifier, nodes.LARGEST_SIZE, 1e-9)
    with pytest.raises(RuntimeError, match="everything of the model is hidden"):
        bpy.ops.physhdr.model_save(filepath=str(path))
    assert read_model(path).count == 300  # what was there is untouched


def test_a_full_disk_is_told_and_leaves_the_file_that_was_there(add, tmp_path, monkeypatch):
    _, _, modifier = add(count=300)
    path = tmp_path / "model_edited.safetensors"
    bpy.ops.physhdr.model_save(filepath=str(path))
    before, there = path.read_bytes(), sorted(each.name for each in tmp_path.iterdir())
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.5)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RuntimeError, match=r"cannot write the model file[\s\S]*No space left[\s\S]*has room"):
        bpy.ops.physhdr.model_save(filepath=str(path))
    monkeypatch.undo()
    assert path.read_bytes() == before and sorted(each.name for each in tmp_path.iterdir()) == there


def test_a_transform_moves_the_radiance_too(add, tmp_path):
    """In world space the saved model has, toward any direction, what the moved object has."""
    model, target, _ = add(degree=3)
    target.location, target.rotation_euler, target.scale = (1, -2, 3), (0.3, -0.8, 1.9), (2.5,) * 3
    bpy.context.view_layer.update()
    matrix = np.array(target.matrix_world, np.float64)
    bpy.ops.physhdr.model_save(filepath=str(tmp_path / "moved.safetensors"), apply_transform=True)
    saved = read_model(tmp_path / "moved.safetensors")
    np.testing.assert_allclose(saved.position, model.position @ matrix[:3, :3].T + matrix[:3, 3], atol=2e-6)
    np.testing.assert_allclose(saved.scale, 2.5 * model.scale, rtol=1e-6)
    for direction in np.random.default_rng(0).normal(size=(20, 3)):
        world = np.broadcast_to(direction / np.linalg.norm(direction), (model.count, 3))
        local = world @ (matrix[:3, :3] / 2.5)
        np.testing.assert_allclose(saved.radiance(world, 0.3), model.radiance(local, 0.3), rtol=2e-4)
    target.scale.z = 1.0
    with pytest.raises(RuntimeError, match=r"scaled differently along its axes[\s\S]*same scale"):
        bpy.ops.physhdr.model_save(filepath=str(tmp_path / "b.safetensors"), apply_transform=True)
    assert not (tmp_path / "b.safetensors").exists()
    bpy.ops.physhdr.model_save(
        filepath=str(tmp_path / "b.safetensors")
    )  # in the data set's space it is itself
    np.testing.assert_array_equal(read_model(tmp_path / "b.safetensors").position, model.position)
    with pytest.raises(DataMismatchError, match="mirrored"):
        edited_model.transformed(model, np.diag([1.0, 1.0, -1.0, 1.0]))


def test_a_bake_has_what_is_shown(add, tmp_path):
    from physhdr.bridge.gaussian_ply import read_ply

    model, _, modifier = add(count=300, degree=3)
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.5)
    nodes.set_input(modifier, nodes.SH_DEGREE, 1)
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"))
    columns = read_ply(tmp_path / "a.ply").columns
    assert len(columns["x"]) == (model.opacity >= 0.5).sum()
    assert sum(name.startswith("f_rest_") for name in columns) == 9


def test_the_panels_number_is_counted_once_for_each_set_of_limits(add, monkeypatch):
    model, target, modifier = add(count=300)
    assert panel.hidden.of(target.data, look.cleaning_of(target)) == 0
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.5)
    wanted = look.cleaning_of(target)
    assert panel.hidden.of(target.data, wanted) is None
    panel.hidden.count()  # what the timer calls
    assert panel.hidden.of(target.data, wanted) == (model.opacity < 0.5).sum()
    assert panel.hidden.of(target.data, dataclasses.replace(wanted, smallest_opacity=0.6)) is None


def test_a_slider_that_moves_puts_the_counting_off(add):
    """One timer waits, begun anew at every step; none is left when the extension goes."""
    _, target, modifier = add()
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.5)
    first = look.cleaning_of(target)
    waits = panel._count_hidden
    for step in range(3):
        panel.hidden.of(target.data, dataclasses.replace(first, smallest_opacity=0.1 * step + 0.1))
        assert bpy.app.timers.is_registered(waits)
    bpy.app.timers.unregister(waits)  # all there was
    assert not bpy.app.timers.is_registered(waits)
    panel.hidden.of(target.data, first)
    panel.hidden.forget()
    assert not bpy.app.timers.is_registered(waits)


def test_the_panels_number_is_counted_anew_when_distances_are_measured_anew(add):
    _, target, modifier = add(count=300)
    nodes.set_input(modifier, nodes.CLEAR_OF_PHOTOS, 0.5)
    wanted, counts = look.cleaning_of(target), []
    for largest in (1.0, 0.6):
        distance = np.linspace(0.0, largest, 300, dtype=np.float32)
        point_cloud.write_attribute(target.data, attributes.CAMERA_DISTANCE, distance)
        assert panel.hidden.of(target.data, wanted) is None
        panel.hidden.count()
        counts.append(panel.hidden.of(target.data, wanted))
        assert counts[-1] == (distance < np.float32(0.5)).sum()
    assert counts[0] < counts[1]
