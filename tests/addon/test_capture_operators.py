# SPDX-License-Identifier: GPL-3.0-or-later
"""Scale and ground of a capture, set in Blender: where its points are afterwards, and that pictures agree.

A room is known in metres; the model is of the same room as structure from motion would have left it, under a
similarity of which nobody knows. What is set must bring every Gaussian back to its metres.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import similarity  # noqa: E402
from physhdr.addon.blender import curves_of, to_matrix  # noqa: E402
from physhdr.addon.capture import placement  # noqa: E402
from physhdr.addon.model import attributes, nodes, origin  # noqa: E402
from physhdr.addon.model.look import cleaning_of, kept_of, shown_shape  # noqa: E402
from physhdr.addon.model.point_cloud import read_attribute  # noqa: E402
from physhdr.addon.operators import capture as operators  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.addon.viewport import live  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera  # noqa: E402
from physhdr.bridge.affine import transform_gaussians  # noqa: E402
from physhdr.bridge.gaussian_ply import write_standard_ply  # noqa: E402
from physhdr.bridge.model_file import write_model  # noqa: E402

#: The corners of the room's floor, and where its cameras stood: metres, in the true room.
FLOOR = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]])
CAMERAS = np.array([[0.5, 0.5, 1.4], [1.0, 2.0, 1.6], [2.0, 1.0, 1.7], [2.5, 3.0, 1.6], [1.5, 2.0, 1.6]])
#: float32 at a few metres, through a model file, a matrix and a decomposition.
CLOSE = 5e-6


def turned(angle: float) -> np.ndarray:
    """About a slanted axis, by Rodrigues' formula."""
    axis = np.array([0.8, -0.6, 0.1]) / math.sqrt(1.01)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


#: From the room to the capture's world: 0.37 as large, tilted by 23°, elsewhere.
LOST = np.eye(4)
LOST[:3, :3], LOST[:3, 3] = 0.37 * turned(0.4), [1.5, -0.7, 2.2]


@pytest.fixture
def run(tmp_path, make_model):
    """A run's folder with the model of the room, and its data set's cameras, both in the lost world."""
    model = make_model(count=60, seed=4)
    room = dataclasses.replace(model, position=(model.position + [1.5, 2.0, 1.0]).astype(np.float32))
    shape = transform_gaussians(LOST, room.position, room.rotation, room.scale)
    lost = dataclasses.replace(room, position=shape[0], rotation=shape[1], scale=shape[2])
    (tmp_path / "run").mkdir()
    (tmp_path / "data").mkdir()
    write_model(tmp_path / "run/model.safetensors", lost)
    config = {"config": {}, "preset": "default", "data": str(tmp_path / "data")}
    (tmp_path / "run/config.json").write_text(json.dumps(config))
    frames = [
        {"file_path": f"train/{index}", "transform_matrix": pose(place).tolist()}
        for index, place in enumerate(similarity.apply(LOST, CAMERAS))
    ]
    (tmp_path / "data/transforms_train.json").write_text(json.dumps({"frames": frames}))
    (tmp_path / "data/exposure_train.json").write_text("{}")
    return tmp_path / "run", room


def pose(place: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return matrix


def load(folder, name="room"):
    """Import as the panel does, and make it the active object."""
    bpy.ops.physhdr.model_import(filepath=str(folder / "model.safetensors"), name=name)
    return bpy.data.objects[name]


def where(target) -> np.ndarray:
    """``[N, 3]``: the Gaussians' places in the world."""
    bpy.context.view_layer.update()
    return similarity.apply(
        np.array(target.matrix_world), read_attribute(target.data, "position").astype(float)
    )


def now(target, points) -> list[tuple[float, ...]]:
    """Points of the room, where they are in the scene now: what a user would pick."""
    bpy.context.view_layer.update()
    return [tuple(p) for p in similarity.apply(np.array(target.matrix_world) @ LOST, np.asarray(points))]


def set_floor(target) -> None:
    first, second, third = now(target, FLOOR)
    assert bpy.ops.physhdr.capture_floor(first=first, second=second, third=third) == {"FINISHED"}


def set_scale(target, distance=5.0) -> None:
    first, second = now(target, FLOOR[[0, 2]])  # 3-4-5
    done = bpy.ops.physhdr.capture_scale(first=first, second=second, distance=distance)
    assert done == {"FINISHED"}


def is_room(target, room) -> None:
    """Every Gaussian has its true height and all distances are true: up to a turn about z and a shift."""
    found = where(target)
    np.testing.assert_allclose(found[:, 2], room.position[:, 2], atol=CLOSE)
    for first in (0, 7):
        lengths = np.linalg.norm(found - found[first], axis=1)
        np.testing.assert_allclose(
            lengths, np.linalg.norm(room.position - room.position[first], axis=1), atol=CLOSE
        )
    # Not mirrored: the same handedness of three of them.
    a, b, c = found[1:4] - found[0]
    ours = np.linalg.det([a, b, c])
    theirs = np.linalg.det((room.position[1:4] - room.position[0]).astype(float))
    assert math.isclose(ours, theirs, rel_tol=1e-3)


def test_floor_and_two_points_bring_the_room_back(registered, run):
    folder, room = run
    target = load(folder)
    assert np.abs(where(target)[:, 2] - room.position[:, 2]).max() > 0.5
    set_floor(target)
    np.testing.assert_allclose(np.array(now(target, FLOOR))[:, 2], 0.0, atol=CLOSE)
    set_scale(target)
    is_room(target, room)
    assert similarity.scale_of(np.array(target.matrix_world)) == pytest.approx(1.0 / 0.37, rel=1e-6)


def test_the_other_order_gives_the_same(registered, run):
    folder, room = run
    target = load(folder)
    set_scale(target)
    set_floor(target)
    is_room(target, room)


def test_setting_again_corrects_and_never_adds_up(registered, run):
    folder, room = run
    target = load(folder)
    set_floor(target)
    set_scale(target, 17.0)  # a slip of the hand
    for _ in range(50):
        set_scale(target)
        set_floor(target)
    is_room(target, room)
    before = np.array(target.matrix_world)
    set_scale(target)
    set_floor(target)
    np.testing.assert_allclose(np.array(target.matrix_world), before, atol=CLOSE)


def test_the_height_of_the_cameras_sets_the_scale_on_a_known_floor(registered, run):
    folder, room = run
    target = load(folder)
    set_floor(target)
    assert bpy.ops.physhdr.capture_height(height=1.6) == {"FINISHED"}  # the median of CAMERAS, by hand
    is_room(target, room)
    # A selected camera counts instead of them.
    target.matrix_world = to_matrix(np.diag([3.0, 3.0, 3.0, 1.0])) @ target.matrix_world
    [place] = now(target, CAMERAS[:1])
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    registered.collection.objects.link(camera)
    camera.location = place
    bpy.context.view_layer.update()
    camera.select_set(True)
    assert bpy.ops.physhdr.capture_height(height=1.4) == {"FINISHED"}
    is_room(target, room)


def test_the_height_of_the_cameras_sets_the_ground_at_a_known_scale(registered, run):
    folder, room = run
    target = load(folder)
    # Level and in metres, as from a phone's tracking, but with its own idea of where 0 is.
    target.matrix_world = to_matrix(similarity.raised(-2.2) @ np.linalg.inv(LOST))
    with pytest.raises(RuntimeError, match=r"cameras are at -0\.6 m, not above the ground"):
        bpy.ops.physhdr.capture_height(height=1.6)
    assert bpy.ops.physhdr.capture_height(height=1.6, sets="GROUND") == {"FINISHED"}
    is_room(target, room)


def test_without_cameras_it_says_what_to_select(registered, run):
    target = load(run[0])
    for name in ("transforms", "exposure"):
        (run[0].parent / f"data/{name}_train.json").unlink()
    with pytest.raises(RuntimeError, match="is not a data set"):
        bpy.ops.physhdr.capture_height(height=1.6)
    (run[0].parent / "data").rmdir()
    with pytest.raises(RuntimeError, match="Select a camera that stands"):
        bpy.ops.physhdr.capture_height(height=1.6)
    set_floor(target)  # then the model itself says which side is up


def test_empties_are_points(registered, run):
    folder, room = run
    target = load(folder)

    def empties(points):
        for place in now(target, points):
            empty = bpy.data.objects.new("point", None)
            registered.collection.objects.link(empty)
            empty.location = place
            empty.select_set(True)
        bpy.context.view_layer.update()

    empties(FLOOR)
    with pytest.raises(RuntimeError, match="2 points are needed, and 3 empties are selected"):
        bpy.ops.physhdr.capture_scale(distance=5.0)
    assert bpy.ops.physhdr.capture_floor() == {"FINISHED"}
    for empty in [each for each in registered.objects if each.type == "EMPTY"]:
        bpy.data.objects.remove(empty)
    empties(FLOOR[[0, 2]])
    assert bpy.ops.physhdr.capture_scale(distance=5.0) == {"FINISHED"}
    is_room(target, room)


def test_the_scene_remembers_it_for_the_next_import_and_the_file_too(registered, run, tmp_path):
    folder, room = run
    target = load(folder)
    set_floor(target)
    set_scale(target)
    again = load(folder, "again")
    np.testing.assert_allclose(where(again), where(target), atol=CLOSE)
    # Another run on the same data comes out there, too; one on other data does not.
    for name, data in (("other_run", "data"), ("elsewhere", "other_data")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes())
        (tmp_path / name / "config.json").write_text(json.dumps({"data": str(tmp_path / data)}))
    is_room(load(tmp_path / "other_run", "other"), room)
    np.testing.assert_array_equal(np.array(load(tmp_path / "elsewhere", "else").matrix_world), np.eye(4))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    is_room(load(folder, "later"), room)
    # All models of the capture go together, and what hangs on one with it.
    child = bpy.data.objects.new("child", None)
    bpy.context.scene.collection.objects.link(child)
    child.parent = bpy.data.objects["again"]
    child.location = similarity.apply(LOST, CAMERAS[:1])[0]
    set_scale(bpy.data.objects["later"], 10.0)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(
        where(bpy.data.objects["again"]), where(bpy.data.objects["room"]), atol=2 * CLOSE
    )
    assert child.matrix_world.translation.z == pytest.approx(2.0 * CAMERAS[0, 2], abs=2 * CLOSE)
    # Taken back, it stands where it was imported first, and is remembered no more.
    assert bpy.ops.physhdr.capture_reset() == {"FINISHED"}
    np.testing.assert_allclose(np.array(bpy.data.objects["room"].matrix_world), np.eye(4), atol=1e-7)
    np.testing.assert_array_equal(np.array(load(folder, "anew").matrix_world), np.eye(4))


def test_it_is_undone_and_done_again(registered, run):
    folder, _ = run
    bpy.ops.ed.undo_push(message="begin")
    target = load(folder)
    bpy.ops.ed.undo_push(message="imported")
    first, second, third = now(target, FLOOR)
    bpy.ops.physhdr.capture_floor("EXEC_DEFAULT", True, first=first, second=second, third=third)
    bpy.ops.ed.undo_push(message="floor")
    assert len(bpy.context.scene.physhdr.captures) == 1
    for _ in range(2):
        bpy.ops.ed.undo()
        if not len(bpy.context.scene.physhdr.captures):
            break
    target = bpy.data.objects["room"]
    assert len(bpy.context.scene.physhdr.captures) == 0
    np.testing.assert_array_equal(np.array(target.matrix_world), np.eye(4))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"first": (1, 2, 3), "second": (1, 2, 3)}, "one point"),
        ({"first": (1, 2, 3)}, "2 points are needed"),
    ],
)
def test_mistakes_change_nothing(registered, run, given, told):
    target = load(run[0])
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.physhdr.capture_scale(distance=1.0, **given)
    target.scale = (1.0, 2.0, 1.0)
    with pytest.raises(RuntimeError, match="scaled differently along its axes"):
        bpy.ops.physhdr.capture_scale(first=(0, 0, 0), second=(1, 0, 0), distance=2.0)
    assert len(registered.physhdr.captures) == 0 and tuple(target.scale) == (1.0, 2.0, 1.0)
    bpy.context.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="Select an imported model first"):
        bpy.ops.physhdr.capture_floor()


@pytest.mark.parametrize("between", [False, True])
def test_a_model_that_hangs_on_a_later_one_is_scaled_once(registered, run, between):
    """The scene has the child first; what hangs on the parent, an empty of the user's too, goes along."""
    child, parent = load(run[0], "child"), load(run[0], "parent")
    child.parent = parent
    if between:
        child.parent = empty = bpy.data.objects.new("between", None)
        registered.collection.objects.link(empty)
        empty.parent = parent
    child.location = (1.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    before = {each: np.array(each.matrix_world) for each in (child, parent)}
    bpy.context.view_layer.objects.active = parent
    bpy.ops.physhdr.capture_scale(first=(0, 0, 0), second=(1, 0, 0), distance=2.0)
    bpy.context.view_layer.update()
    for each, was in before.items():
        np.testing.assert_allclose(each.matrix_world, np.diag([2.0, 2.0, 2.0, 1.0]) @ was, atol=CLOSE)


@pytest.mark.parametrize("hangs", [False, True])
def test_what_a_models_limits_hide_stays_the_same(registered, run, hangs):
    """The crop box and the middle of the largest distance go along, each once."""
    target = load(run[0])
    modifier = nodes.find_modifier(target)
    assert bpy.ops.physhdr.cleaning_box() == {"FINISHED"}
    box, middle = nodes.get_input(modifier, nodes.CROP_BOX), bpy.data.objects.new("middle", None)
    registered.collection.objects.link(middle)
    middle.location = now(target, [[1.5, 2.0, 1.0]])[0]
    nodes.set_input(modifier, nodes.DISTANCE_FROM, middle)
    nodes.set_input(modifier, nodes.LARGEST_DISTANCE, 0.25)
    if hangs:
        box.parent = middle.parent = target
    bpy.context.view_layer.update()
    before = {each: np.array(each.matrix_world) for each in (box, middle)}
    kept = kept_of(target.data, cleaning_of(target))
    assert 0.2 < kept.mean() < 0.9
    steps = (set_floor, set_scale, lambda _: bpy.ops.physhdr.capture_height(height=2.0, sets="GROUND"))
    for step in (*steps, lambda _: bpy.ops.physhdr.capture_reset()):
        step(target)
        bpy.context.view_layer.update()
        np.testing.assert_array_equal(kept_of(target.data, cleaning_of(target)), kept)
    for each, was in before.items():
        np.testing.assert_allclose(each.matrix_world, was, atol=2.0 * CLOSE)


def test_what_is_no_mere_limit_of_a_model_stays_where_it_is(registered, run):
    """The model is hidden far from the camera of the shot, and beside a figure's own empty."""
    target = load(run[0])
    modifier = nodes.find_modifier(target)
    camera, figure, empty = (
        bpy.data.objects.new("shot", bpy.data.cameras.new("shot")),
        bpy.data.objects.new("figure", bpy.data.meshes.new("figure")),
        bpy.data.objects.new("of the figure", None),
    )
    for each in (camera, figure, empty):
        registered.collection.objects.link(each)
        each.location = (1.0, 2.0, 3.0)
    empty.parent = figure
    bpy.context.view_layer.update()
    nodes.set_input(modifier, nodes.DISTANCE_FROM, camera)
    nodes.set_input(modifier, nodes.CROP_BOX, empty)
    set_scale(target)
    bpy.context.view_layer.update()
    assert tuple(camera.location) == (1.0, 2.0, 3.0)
    assert tuple(empty.matrix_world.translation) == (2.0, 4.0, 6.0)


def test_a_crop_box_that_is_animated_is_named(registered, run):
    """On the model, as is advised, it goes along in every frame."""
    target = load(run[0])
    bpy.ops.physhdr.cleaning_box()
    box = bpy.data.objects["room crop"]
    box.keyframe_insert("scale", frame=1)
    given = {"first": (0, 0, 0), "second": (1, 0, 0), "distance": 2.0}
    with pytest.raises(
        RuntimeError, match=r"the scale of room crop is animated[\s\S]*parent it to the model"
    ):
        bpy.ops.physhdr.capture_scale(**given)
    np.testing.assert_array_equal(np.array(target.matrix_world), np.eye(4))
    kept = kept_of(target.data, cleaning_of(target))
    box.parent = target
    assert bpy.ops.physhdr.capture_scale(**given) == {"FINISHED"}
    registered.frame_set(2)
    np.testing.assert_array_equal(kept_of(target.data, cleaning_of(target)), kept)


def test_a_linked_model_has_no_scale_of_its_own_here(registered, run, tmp_path):
    """Where it stands is the other file's, and is not saved here; a library override's is."""
    load(run[0], "theirs")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "theirs.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "theirs.blend"), link=True) as (_, wanted):
        wanted.objects = ["theirs"]
    (linked,) = wanted.objects
    scene = bpy.context.scene
    scene.collection.objects.link(linked)
    bpy.context.view_layer.objects.active = linked
    given = {"first": (0, 0, 0), "second": (1, 0, 0), "distance": 2.0}
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.physhdr.capture_scale(**given)
    assert len(scene.physhdr.captures) == 0
    bpy.context.view_layer.objects.active = override = linked.override_create(remap_local_usages=True)
    assert bpy.ops.physhdr.capture_scale(**given) == {"FINISHED"}
    assert tuple(override.scale) == pytest.approx((2.0,) * 3)


def test_the_live_preview_is_drawn_where_the_model_is(registered, run):
    """A point of the capture, seen by the view's camera in the world and by the camera that is asked for."""
    from types import SimpleNamespace

    target = load(run[0])
    set_floor(target)
    set_scale(target)
    to_world = placement.matrix_of(registered, origin.key_of(str(run[0].parent / "data")))
    np.testing.assert_allclose(to_world, np.array(target.matrix_world), atol=CLOSE)
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = turned(1.1), [2.0, -3.0, 1.0]
    in_world = ViewCamera(view, 64, 48, 80.0, 81.0, 31.0, 25.0)
    asked = dataclasses.replace(in_world, camera_to_world=similarity.into_capture(to_world, view))
    points = read_attribute(target.data, "position").astype(float)
    pixels, depths = asked.project(points)
    expected, distances = in_world.project(where(target))
    np.testing.assert_allclose(pixels, expected, rtol=1e-4, atol=1e-3)
    frame = SimpleNamespace(
        rgba=np.zeros((48, 64, 4), np.float16), depth=np.full((48, 64), depths[0], np.float32)
    )
    shown = live.in_world(frame, asked, to_world)
    np.testing.assert_allclose(shown.camera.camera_to_world, view, atol=1e-6)
    np.testing.assert_allclose(shown.depth, distances[0], rtol=1e-5)


@pytest.mark.parametrize("splats", [False, True])
def test_cycles_draws_the_same_picture_of_it(registered, run, tmp_path, splats):
    """Of the lost model from a lost camera, and of the room from the true one: sizes follow the scale."""
    size, angle, pictures = 64, 0.9, []
    true = np.eye(4)
    true[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # level, looks along +Y
    true[:3, 3] = [1.5, -1.0, 1.0]
    target = load(run[0])
    for is_set in (False, True):
        if is_set:
            # The very similarity that was lost: floor, scale and heading.
            placement.move(registered, target, np.linalg.inv(LOST))
        view = true if is_set else similarity.out_of_capture(LOST, true)
        render.add_camera(registered, view, angle)
        render.set_resolution(registered, size, size)
        render.prepare_cycles(registered)
        modifier = nodes.find_modifier(target)
        nodes.set_input(modifier, nodes.CAMERA_SPLATS, splats)
        nodes.set_input(modifier, nodes.IMAGE_WIDTH, size)
        render.render_exr(registered, tmp_path / "picture.exr")
        pictures.append(render.read_exr(tmp_path / "picture.exr").astype(float))
    lost, found = pictures
    assert lost[..., 3].mean() > 0.05
    error = np.abs(found - lost)
    assert error.mean() < 1e-4 * lost.max() and error.max() < 2e-2 * lost.max()


def test_a_point_is_picked_on_the_model_wherever_it_stands(registered, run):
    """The ray of a pixel on a lone, opaque Gaussian meets it at its centre, in the world."""
    target = load(run[0])
    placement.move(registered, target, np.linalg.inv(LOST))
    *alone, _ = (each[:1] for each in shown_shape(target))
    alone.append(np.array([0.95], np.float32))
    centre = where(target)[0]
    eye = np.array([5.0, -4.0, 3.0])
    direction = (centre - eye) / np.linalg.norm(centre - eye)
    bpy.context.view_layer.update()
    found = operators.surface_point(np.array(target.matrix_world, float), alone, eye, direction)
    np.testing.assert_allclose(found, centre, atol=1e-5)
    assert operators.surface_point(np.array(target.matrix_world, float), alone, eye, -direction) is None


def test_picking_that_blender_ends_leaves_nothing_drawn(registered, run, monkeypatch):
    """As where another file is opened meanwhile: Blender calls ``cancel``."""
    removed = []
    space = SimpleNamespace(draw_handler_remove=lambda *each: removed.append(each))
    types = SimpleNamespace(SpaceView3D=space)
    monkeypatch.setattr(operators, "bpy", SimpleNamespace(types=types))
    picking = SimpleNamespace(_handler="handler")
    picking._end = lambda context: operators.PHYSHDR_OT_points_pick._end(picking, context)
    operators.PHYSHDR_OT_points_pick.cancel(picking, SimpleNamespace(workspace=None, area=None))
    assert removed == [("handler", "WINDOW")]


@pytest.mark.parametrize("active", ["second", "lamp"])
def test_points_are_for_the_model_on_which_they_were_picked(registered, run, active):
    """A click in the Outliner meanwhile makes another object active."""
    first, second = load(run[0], "first"), load(run[0], "second")
    second.data[attributes.CAPTURE] = "elsewhere"
    registered.collection.objects.link(bpy.data.objects.new("lamp", None))
    points = [np.array(each) for each in now(first, FLOOR)]
    bpy.context.view_layer.objects.active = bpy.data.objects[active]
    reports: list[str] = []
    picking = SimpleNamespace(purpose="FLOOR", _points=points, _target="first")
    picking.report = lambda _, told: reports.append(told)
    pick = operators.PHYSHDR_OT_points_pick
    picking._model = lambda: pick._model(picking)
    assert pick._hand_on(picking, bpy.context) == {"FINISHED"}
    np.testing.assert_allclose(now(first, FLOOR)[1][2], 0.0, atol=CLOSE)
    np.testing.assert_array_equal(np.array(second.matrix_world), np.eye(4))
    in_a_line = SimpleNamespace(**{**vars(picking), "_points": [np.full(3, float(i)) for i in range(3)]})
    assert pick._hand_on(in_a_line, bpy.context) == {"CANCELLED"}
    assert re.match("the three points .*line", reports.pop())
    registered.collection.objects.unlink(first)
    assert pick._hand_on(picking, bpy.context) == {"CANCELLED"}
    assert "first is no longer in this view layer" in reports[0]


@pytest.mark.parametrize(("animated", "told"), [("location", "location"), ("rotation_euler", "rotation")])
@pytest.mark.parametrize("by", ["keyframes", "strip", "driver", "camera"])
def test_what_is_animated_is_not_moved(registered, run, animated, told, by):
    """The next frame would undo it, and the scene remember a place where nothing stands."""
    target = load(run[0])
    item = target
    if by == "camera":
        item = bpy.data.objects.new("frame", bpy.data.cameras.new("frame"))
        registered.collection.objects.link(item)
        item[placement.FRAME], item[attributes.CAPTURE] = "0001", origin.capture_of(target)
    if by == "driver":
        item.driver_add(animated, 0)
    else:
        item.keyframe_insert(animated, frame=1)
    if by == "strip":
        data = item.animation_data
        data.nla_tracks.new().strips.new("moves", 1, data.action)
        data.action = None
    given = {"first": (0, 0, 0), "second": (1, 0, 0), "distance": 2.0}
    told = rf"the {told} of {item.name} is animated[\s\S]*an empty that is its parent"
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.physhdr.capture_scale(**given)
    reports: list[str] = []
    asking = SimpleNamespace(report=lambda _, said: reports.append(said))
    assert operators.pick(asking, bpy.context, "FLOOR") == {"CANCELLED"}  # before anything is picked
    assert re.search(told, reports[0])
    assert not len(registered.physhdr.captures) and tuple(target.scale) == (1.0, 1.0, 1.0)
    # Below an empty that is animated instead, each frame keeps the scale.
    item.animation_data_clear()
    target.parent = empty = bpy.data.objects.new("moves", None)
    registered.collection.objects.link(empty)
    empty.keyframe_insert("location", frame=1)
    assert bpy.ops.physhdr.capture_scale(**given) == {"FINISHED"}
    item.keyframe_insert(animated, frame=1)
    with pytest.raises(RuntimeError, match="is animated"):
        bpy.ops.physhdr.capture_reset()
    registered.frame_set(2)
    assert tuple(target.matrix_world.to_scale()) == pytest.approx((2.0,) * 3)
    assert len(registered.physhdr.captures) == 1


@pytest.mark.parametrize("by", ["curve", "track", "strip", "driver"])
def test_what_is_muted_animates_nothing(registered, run, by):
    target = load(run[0])
    if by == "driver":
        target.driver_add("location", 0)
    else:
        target.keyframe_insert("location", frame=1)
    data = target.animation_data
    if by in ("track", "strip"):
        track = data.nla_tracks.new()
        strip = track.strips.new("moves", 1, data.action)
        data.action = None
    muted = {"curve": lambda: curves_of(data), "driver": lambda: data.drivers}
    muted |= {"track": lambda: [track], "strip": lambda: [strip]}
    for each in muted[by]():
        each.mute = True
    assert bpy.ops.physhdr.capture_scale(first=(0, 0, 0), second=(1, 0, 0), distance=2.0) == {"FINISHED"}
    registered.frame_set(2)
    assert tuple(target.scale) == pytest.approx((2.0,) * 3)


def test_what_was_saved_in_the_world_is_not_moved_a_second_time(registered, run):
    """A model or a PLY that was written where it stood, into the run's own folder, as both are offered."""
    folder, _ = run
    target = load(folder)
    set_floor(target)
    set_scale(target)
    stands = where(target)
    model, ply = folder / "edited.safetensors", folder / "baked.ply"
    assert bpy.ops.physhdr.model_save(filepath=str(model), apply_transform=True) == {"FINISHED"}
    assert bpy.ops.physhdr.model_bake(filepath=str(ply), quick=True) == {"FINISHED"}
    own = folder / "own.safetensors"
    assert bpy.ops.physhdr.model_save(filepath=str(own), apply_transform=False) == {"FINISHED"}
    for path in (model, ply, own):
        bpy.ops.physhdr.model_import(filepath=str(path))
        np.testing.assert_allclose(where(bpy.context.active_object), stands, atol=CLOSE)
    # And once more from there: where such a model stands is all that its file knows.
    bpy.context.view_layer.objects.active = bpy.data.objects["edited"]
    assert bpy.ops.physhdr.model_save(filepath=str(own), apply_transform=False) == {"FINISHED"}
    bpy.ops.physhdr.model_import(filepath=str(own), name="again")
    np.testing.assert_allclose(where(bpy.data.objects["again"]), stands, atol=CLOSE)


def test_the_axes_that_the_user_names_are_turned_before_the_capture_is_placed(registered, run):
    folder, _ = run
    target = load(folder)
    set_scale(target)
    assert bpy.ops.physhdr.model_bake(filepath=str(folder / "a.ply"), quick=True, apply_transform=False) == {
        "FINISHED"
    }
    bpy.ops.physhdr.model_import(filepath=str(folder / "a.ply"), orientation="COLMAP")
    x, y, z = where(target).T
    np.testing.assert_allclose(where(bpy.context.active_object), np.stack([x, z, -y], 1), atol=CLOSE)


@pytest.fixture
def ply(tmp_path, make_model):
    """Another program's file, which is a capture of its own: its axes are COLMAP's."""
    model = make_model(count=60, seed=4)
    gaussians = model.position, model.rotation, model.scale, model.opacity, model.log_radiance_sh
    write_standard_ply(tmp_path / "plant.ply", *gaussians, up="colmap")
    return tmp_path / "plant.ply", model.position.astype(float)


def load_ply(path, name, orientation="AUTO"):
    bpy.ops.physhdr.model_import(filepath=str(path), name=name, orientation=orientation)
    return bpy.data.objects[name]


def upright(points: np.ndarray) -> np.ndarray:
    """Where COLMAP's axes are in Blender's."""
    x, y, z = points.T
    return np.stack([x, z, -y], axis=1)


def all_lie(names, at: np.ndarray) -> None:
    for name in names:
        np.testing.assert_allclose(where(bpy.data.objects[name]), at, atol=CLOSE, err_msg=name)


TWICE = {"first": (0, 0, 0), "second": (1, 0, 0), "distance": 2.0}


def test_another_programs_file_lies_on_itself_when_it_is_imported_again(registered, ply):
    path, position = ply
    load_ply(path, "first")
    bpy.ops.physhdr.capture_scale(**TWICE)
    load_ply(path, "second")
    all_lie(["first", "second"], 2.0 * upright(position))
    # Set again by the second, then a third, and all of them back.
    bpy.ops.physhdr.capture_scale(first=(0, 0, 0), second=(2, 0, 0), distance=6.0)
    load_ply(path, "third")
    all_lie(["first", "second", "third"], 6.0 * upright(position))
    assert bpy.ops.physhdr.capture_reset() == {"FINISHED"}
    all_lie(["first", "second", "third"], upright(position))


def test_other_axes_of_the_same_file_are_still_the_users_to_name(registered, ply):
    """Its scale is remembered, and the turn that was wrong is not."""
    path, position = ply
    load_ply(path, "wrong", "AS_IS")
    bpy.ops.physhdr.capture_scale(**TWICE)
    load_ply(path, "right", "COLMAP")
    all_lie(["right"], 2.0 * upright(position))
    assert bpy.ops.physhdr.capture_reset() == {"FINISHED"}
    all_lie(["right"], upright(position))


def test_the_preview_stands_where_a_turned_model_of_its_run_was_put(registered, run):
    """The capture's world is the data set's, by whichever model of it the scale was set."""
    folder, _ = run
    load(folder)
    bpy.ops.physhdr.model_bake(filepath=str(folder / "a.ply"), quick=True, apply_transform=False)
    bpy.ops.physhdr.model_import(filepath=str(folder / "a.ply"), orientation="COLMAP")
    bpy.ops.physhdr.capture_scale(**TWICE)
    stands = placement.matrix_of(registered, str(folder.parent / "data"))
    np.testing.assert_allclose(stands, np.diag([2.0, 2.0, 2.0, 1.0]), atol=CLOSE)
    again = load(folder, "again")
    np.testing.assert_allclose(again.matrix_world, np.diag([2.0, 2.0, 2.0, 1.0]), atol=CLOSE)


def test_a_linked_model_of_the_same_name_is_not_moved(registered, run, tmp_path):
    folder, _ = run
    load(folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["room"]
    [theirs] = wanted.objects
    bpy.context.scene.collection.objects.link(theirs)
    bpy.ops.physhdr.model_import(filepath=str(folder / "model.safetensors"), name="room")
    own = bpy.context.active_object
    assert own.name == theirs.name
    bpy.ops.physhdr.capture_scale(first=(0, 0, 0), second=(1, 0, 0), distance=2.0)
    bpy.context.view_layer.update()
    assert own.matrix_world.to_scale()[0] == pytest.approx(2.0)
    assert theirs.matrix_world.to_scale()[0] == pytest.approx(1.0)
